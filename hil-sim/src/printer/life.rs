//! Stops, restarts and thermal faults: what the firmware says, and what is left afterwards.
//!
//! A reset leaves nothing of what the firmware knew: line numbers begin anew, heaters are off, axes are not home. What lies on
//! the bed stays, and so do the axes (the motors let go, nothing pushes) and, but for cooling, the temperatures.
//!
//! | firmware | M112 | heater fault | way out |
//! |---|---|---|---|
//! | Marlin, Prusa | halted, silent | the same | reset |
//! | Klipper | shutdown: commands are refused with the reason | the same | `FIRMWARE_RESTART` |
//! | RepRapFirmware | halted, silent | heater off, the rest goes on | M999, reset |
//! | Repetier | the board resets | every command repeats the error | M999, reset |
//! | Smoothieware | `!!` to every command | the same | M999, reset |

use super::{CHECK_S, HeaterName, Life, Printer, commands::Outcome, idle::Idle, motion::Motion};
use crate::{
    dialect::{Family, Halt},
    gcode::Command,
    planner::Planner,
};

/// Why the firmware stops.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Cause {
    /// M112.
    Order,
    /// A button, or something that nobody explains.
    Button,
    /// A heater.
    Heater,
    /// Too long without a command (M85).
    Idle,
}

impl Cause {
    const fn name(self) -> &'static str {
        match self {
            Self::Order => "order",
            Self::Button => "button",
            Self::Heater => "heater",
            Self::Idle => "idle",
        }
    }
}

/// What Klipper adds to each reason for a shutdown.
const KLIPPER_ADVICE: [&str; 4] = [
    "// Once the underlying issue is corrected, use the",
    "// \"FIRMWARE_RESTART\" command to reset the firmware, reload the",
    "// config, and restart the host software.",
    "// Printer is shutdown",
];

/// M-codes that Smoothieware obeys while it is halted, as far as they are known here.
const ALLOWED_IN_ALARM: [u32; 7] = [105, 106, 107, 114, 115, 119, 503];
/// Those that Klipper obeys in shutdown.
const ALLOWED_IN_SHUTDOWN: [u32; 5] = [105, 110, 112, 114, 115];

impl Printer {
    /// M112.
    pub(super) fn kill_by_order(&mut self) {
        if self.profile.dialect.family == Family::Repetier {
            // KILL_METHOD 1: the watchdog bites.
            self.state("killed", Cause::Order.name().to_owned());
            return self.reset();
        }
        for line in self.profile.dialect.kill_order {
            self.say(line);
        }
        "Shutdown due to M112 command".clone_into(&mut self.halt_reason);
        self.kill(Cause::Order);
    }

    /// Stops for good.
    pub(super) fn kill(&mut self, cause: Cause) {
        match (self.profile.dialect.halt, cause) {
            (Halt::Alarm, Cause::Heater) => {}
            (Halt::Alarm, Cause::Button | Cause::Idle) => {
                self.say("ALARM: Kill button pressed - reset or M999 to continue");
            }
            _ => self.say_all(self.profile.dialect.halted),
        }
        self.stop_motion();
        self.motion.take_position_from_motors();
        self.heaters_off();
        if matches!(self.profile.dialect.halt, Halt::Silent | Halt::SilentUntilM999) {
            self.forget_commands();
            self.receiver.clear();
        }
        // What is queued elsewhere is refused, line by line.
        self.wait = None;
        self.change = None;
        self.life = if self.profile.dialect.halt == Halt::Silent { Life::Killed } else { Life::Halted };
        self.motion.homed = [false; 3];
        self.state("killed", cause.name().to_owned());
    }

    fn forget_commands(&mut self) {
        self.queue.clear();
        self.wait = None;
        self.change = None;
        self.judge.pause();
        self.ran_dry = false;
    }

    /// A reset of the board, however it came about.
    pub(super) fn board_resets(&mut self) {
        if self.profile.dialect.halt == Halt::Klipper && self.life == Life::Running {
            // The board is gone; the host part of the firmware lives and notices.
            "MCU 'mcu' spontaneous restart".clone_into(&mut self.halt_reason);
            return self.kill(Cause::Button);
        }
        self.reset();
    }

    /// The board has no power, or its boot loader runs: nothing is heard, heated or driven until then.
    pub(super) fn board_is_down(&mut self, until_s: f64) {
        self.stop_motion();
        self.heaters_off();
        self.forget_commands();
        self.receiver.clear();
        self.outgoing.clear(self.now_s);
        self.boots_s = until_s;
        // A firmware whose host part lives on is silent meanwhile, and notices afterwards.
        if self.profile.dialect.halt == Halt::Klipper {
            self.silent_until_s = until_s;
        } else {
            self.life = Life::Down;
        }
        self.state("down", String::new());
    }

    /// Starts anew: all the firmware knew is gone; what lies on the bed stays, and so do axes and temperatures.
    pub(super) fn reset(&mut self) {
        self.stop_motion();
        self.heaters_off();
        for axis in 0..3 {
            self.deposit.shift_mm[axis] += self.motion.driven[axis];
        }
        self.motion = Motion::new(&self.profile);
        self.planner = Planner::new(self.profile.planner_blocks).with_queue_s(self.profile.queue_s);
        self.planner.release(self.now_s);
        self.forget_commands();
        self.receiver.reset();
        self.judge.numbering_begins_anew();
        self.report_interval_s = 0.0;
        self.keepalive_s = 2.0;
        self.fan = 0;
        self.idle = Idle::new(self.profile.dialect, self.now_s);
        self.life = Life::Running;
        self.state("booted", String::new());
        self.say_all(self.profile.dialect.boot);
    }

    pub(super) fn heaters_off(&mut self) {
        self.note_unattended();
        for heater in &mut self.heaters {
            heater.set_target(self.now_s, 0.0);
        }
    }

    pub(super) fn check_heaters(&mut self) {
        self.next_check_s = self.now_s + CHECK_S;
        let now_s = self.now_s;
        let mut looks = self.heaters.iter_mut().enumerate();
        let Some((index, fault)) = looks.find_map(|(index, heater)| Some((index, heater.check(now_s)?)))
        else {
            return;
        };
        for text in self.fault_texts(fault, index) {
            self.say(&text);
        }
        if self.profile.dialect.family == Family::RepRapFirmware {
            // Only the heater stops; what needs it is refused from now on.
            self.note_unattended();
            self.heaters[index].fail(now_s);
            let id = self.heaters[index].model.id;
            return self.state("heater-fault", format!("{id} {fault}"));
        }
        self.halt_reason = klipper_reason(fault, is_hotend(index));
        self.kill(Cause::Heater);
    }

    /// What is said of a heater that has run out of control.
    fn fault_texts(&self, fault: &str, index: usize) -> Vec<String> {
        let heater = &self.heaters[index];
        let (id, hotend) = (heater.model.id, is_hotend(index));
        match self.profile.dialect.family {
            Family::Marlin => vec![format!("Error:{fault}, system stopped! Heater_ID: {id}")],
            // It is told when the next command is refused.
            Family::Klipper => Vec::new(),
            Family::RepRapFirmware => {
                let temperatures = [heater.target_c, heater.reading_c(self.now_s)];
                vec![reprap_fault(fault, u8::from(hotend), temperatures)]
            }
            Family::Repetier => {
                let what = if hotend { "Extruder" } else { "Heated bed" };
                vec![
                    format!("Error:{what} {fault}"),
                    "Disabling all heaters due to detected sensor defect.".to_owned(),
                ]
            }
            Family::Smoothie => vec![smoothie_fault(fault, if hotend { "T" } else { "B" })],
        }
    }

    /// A firmware that has stopped refuses most commands; none: this one is obeyed.
    pub(super) fn refuse_when_halted(&mut self, command: &Command<'_>) -> Option<Outcome> {
        let is_m = command.letter == b'M';
        let restarts = is_m && command.code == 999;
        match self.profile.dialect.halt {
            Halt::Silent => Some(Outcome::Answered),
            Halt::SilentUntilM999 => {
                if restarts {
                    self.reset();
                }
                Some(Outcome::Answered)
            }
            Halt::Klipper => self.refuse_in_shutdown(command),
            Halt::RepeatsError | Halt::Alarm if restarts => Some(self.end_halt()),
            Halt::RepeatsError => {
                self.say_all(self.profile.dialect.halted);
                Some(Outcome::Done)
            }
            Halt::Alarm if is_m && ALLOWED_IN_ALARM.contains(&command.code) => None,
            Halt::Alarm => {
                self.say("!!");
                Some(Outcome::Answered)
            }
        }
    }

    /// M999: it goes on where it stands, not home.
    fn end_halt(&mut self) -> Outcome {
        self.life = Life::Running;
        self.idle.touch(self.now_s);
        if self.profile.dialect.halt == Halt::Alarm {
            self.say("WARNING: After HALT you should HOME as position is currently unknown");
        }
        self.state("resumed", String::new());
        Outcome::Done
    }

    fn refuse_in_shutdown(&mut self, command: &Command<'_>) -> Option<Outcome> {
        let asks = command.letter == b'M' && ALLOWED_IN_SHUTDOWN.contains(&command.code);
        if asks || [&b"FIRMWARE_RESTART"[..], b"RESTART"].contains(&command.text) {
            return None;
        }
        self.say_shutdown_reason();
        Some(Outcome::Done)
    }

    /// Why Klipper is shut down, as information and as an error.
    pub(super) fn say_shutdown_reason(&mut self) {
        let reason = self.halt_reason.clone();
        self.say(&format!("// {reason}"));
        self.say_all(&KLIPPER_ADVICE);
        self.say(&format!("!! {reason}"));
    }

    /// `FIRMWARE_RESTART`, `RESTART`.
    pub(super) fn restart_firmware(&mut self) {
        self.say("// Klipper state: Disconnect");
        self.reset();
    }
}

const fn is_hotend(index: usize) -> bool {
    index == HeaterName::Hotend as usize
}

fn klipper_reason(fault: &str, hotend: bool) -> String {
    if fault == "MINTEMP triggered" {
        return "MCU 'mcu' shutdown: ADC out of range".to_owned();
    }
    format!("Heater {} not heating at expected rate", if hotend { "extruder" } else { "heater_bed" })
}

fn reprap_fault(fault: &str, heater: u8, [target_c, reading_c]: [f64; 2]) -> String {
    match fault {
        "MINTEMP triggered" => {
            format!("Error: Temperature reading fault on heater {heater}: sensor open circuit")
        }
        "Heating failed" => format!(
            "Error: Heating fault on heater {heater}, temperature rising much more slowly than the expected \
             1.2\u{b0}C/sec"
        ),
        _ => format!(
            "Error: Heating fault on heater {heater}, temperature excursion exceeded 15.0\u{b0}C \
             (target {target_c:.1}\u{b0}C, actual {reading_c:.1}\u{b0}C)"
        ),
    }
}

fn smoothie_fault(fault: &str, name: &str) -> String {
    match fault {
        "MINTEMP triggered" => {
            format!("ERROR: MINTEMP or MAXTEMP triggered on {name}. Check your temperature sensors!")
        }
        "Heating failed" => format!(
            "ERROR: Temperature took too long to be reached on {name}, HALT asserted, TURN POWER OFF IMMEDIATELY - \
             reset or M999 required"
        ),
        _ => format!(
            "ERROR: Temperature runaway on {name}, HALT asserted, TURN POWER OFF IMMEDIATELY - reset or M999 required"
        ),
    }
}
