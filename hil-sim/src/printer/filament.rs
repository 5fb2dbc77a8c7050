//! The filament runs out, and is changed (M600).
//!
//! Where the machine has a sensor, what is between it and the nozzle still prints. Marlin and Prusa then change the filament
//! by themselves: the axes stop, the user is waited for, the nozzle goes cold after a while; M108 (or the answer to the
//! prompt) goes on: the nozzle is heated again, filament loaded. The others tell the host and go on with what it sends.

use super::{After, HeatWait, HeaterName, Printer, Queued, Wait, commands::Outcome};

/// Filament between sensor and nozzle, mm.
const BEHIND_SENSOR_MM: f64 = 50.0;
/// Parking and unloading, s.
pub(super) const UNLOAD_S: f64 = 15.0;
/// Loading and going back, s.
const LOAD_S: f64 = 20.0;
/// After this long the nozzle goes cold (`PAUSE_PARK_NOZZLE_TIMEOUT`), s.
const NOZZLE_S: f64 = 45.0;

/// A change of filament under way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Change {
    /// The nozzle's target before it.
    target_c: f64,
    /// When the nozzle goes cold.
    pub(super) cold_s: f64,
    /// The user is there.
    going_on: bool,
}

impl Printer {
    /// Nothing comes from the spool any more.
    pub(super) fn filament_ends(&mut self) {
        let dialect = self.profile.dialect;
        self.filament_out = true;
        let has_sensor = dialect.runout_changes || !dialect.runout.is_empty();
        self.deposit.left_mm = if has_sensor { BEHIND_SENSOR_MM } else { 0.0 };
        self.say_all(dialect.runout);
        if dialect.runout_changes && self.change.is_none() {
            // Behind the command under way.
            let at = usize::from(self.wait.is_some()).min(self.queue.len());
            self.queue.insert(at, Queued { text: b"M600".to_vec(), is_answered: true });
        }
    }

    pub(super) const fn filament_is_back(&mut self) {
        self.filament_out = false;
        self.deposit.left_mm = f64::INFINITY;
    }

    /// M600.
    pub(super) fn begin_change(&mut self) -> Outcome {
        if self.profile.dialect.prompts {
            self.say("//action:paused");
            self.tell_prompt(b"Pause", "Dismiss");
        }
        Outcome::Wait(Wait::Drain(After::Unload))
    }

    /// It is parked and unloaded: the user's turn.
    pub(super) fn wait_for_filament(&mut self) -> Wait {
        let target_c = self.heaters[HeaterName::Hotend as usize].target_c;
        self.change = Some(Change { target_c, cold_s: self.now_s + NOZZLE_S, going_on: false });
        if self.profile.dialect.prompts {
            self.tell_prompt(b"Nozzle Parked", "Continue");
        }
        self.state("paused-for-user", "filament".to_owned());
        Wait::User { until_s: f64::INFINITY }
    }

    /// The user takes too long: the nozzle goes cold.
    pub(super) fn cool_while_changing(&mut self) {
        let Some(change) = self.change.as_mut().filter(|change| change.cold_s <= self.now_s) else { return };
        change.cold_s = f64::INFINITY;
        self.set_target(HeaterName::Hotend, 0.0);
        if self.profile.dialect.prompts {
            self.tell_prompt(b"HeaterTimeout", "Reheat");
        }
    }

    /// M108, or the answer to the prompt.
    pub(super) fn go_on_changing(&mut self) -> Option<Wait> {
        let change = self.change.as_mut()?;
        change.going_on = true;
        let target_c = change.target_c;
        self.filament_is_back();
        if self.heaters[HeaterName::Hotend as usize].target_c < target_c {
            self.set_target(HeaterName::Hotend, target_c);
            let next_tick_s = self.now_s + 1.0;
            return Some(Wait::Heat(HeatWait { heater: HeaterName::Hotend, next_tick_s, reached_s: None }));
        }
        Some(Wait::Until { t_s: self.now_s + LOAD_S, then: After::Nothing })
    }

    /// A command is done: if it was the change, that is told.
    pub(super) fn end_change(&mut self) {
        if self.change.take_if(|change| change.going_on).is_some() {
            self.state("filament-changed", String::new());
            if self.profile.dialect.prompts {
                self.say("//action:prompt_end");
                self.say("//action:resumed");
            }
        }
    }
}
