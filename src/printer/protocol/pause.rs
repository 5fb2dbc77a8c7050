//! Pauses: the operator's, the printer's own, and those within a line that waits for the user.
//!
//! In a pause no more lines are sent; those that were sent once are brought to their end. The host may then send lines of its own
//! (parking), for which the job's lines that were never sent are given up: they are given again when it goes on. While it lasts the
//! printer is asked for its temperatures now and then, so that a board that dies in a pause is noticed, and the firmware's
//! time-out for hosts that are gone, which would end a long pause, is taken back.

use super::prompt::Button;
use super::{BUSY_INTERVAL, Command, Core, Event, Fault, NextOk, SILENCE_FACTOR, State};
use crate::printer::policy::{self, Action, Trouble};
use crate::profile::Dialect;
use std::time::Duration;

/// In a pause the printer is asked for a sign of life this often.
const ALIVE_INTERVAL: Duration = Duration::from_secs(5);

/// Where it does not answer, it is asked ever more rarely, up to so many doublings.
const MAX_DOUBLINGS: u32 = 6;

/// Signs of life in a pause.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Pulse {
    asked: super::Instant,
    /// Questions since one was answered.
    pub(super) n_unanswered: u32,
}

impl Core {
    /// Nothing is in flight any more.
    pub(super) fn paused(&mut self) {
        self.state = State::Paused;
        self.pulse = Pulse { asked: self.now, n_unanswered: 0 };
    }

    /// The job's lines that were never sent are given up; the host's own take their numbers.
    pub(super) fn park(&mut self) {
        self.wire.drop_unsent();
        self.wire.reopen();
        self.state = State::Parking;
    }

    pub(super) fn go_on(&mut self) {
        if self.state != State::Pausing {
            self.guard(true);
        }
        self.state = if self.wire.is_whole() { State::Finishing } else { State::Streaming };
        self.continue_for_user();
        self.events.push_back(Event::Resumed);
    }

    /// When the next sign of life is due, in a pause.
    pub(super) fn pulse_due(&self) -> super::Instant {
        let n_doublings = self.pulse.n_unanswered.saturating_sub(1).min(MAX_DOUBLINGS);
        let ask = self.pulse.asked + ALIVE_INTERVAL * (1 << n_doublings);
        ask.min(self.heard + self.silence_in_a_pause())
    }

    /// Asks for a sign of life, or gives up.
    pub(super) fn feel_pulse(&mut self) {
        let after = self.now.since(self.heard);
        if after < ALIVE_INTERVAL {
            // It speaks by itself: nothing needs to be asked, and what it cannot take now would overrun it.
            self.pulse = Pulse { asked: self.now, n_unanswered: 0 };
            return;
        }
        if after >= self.silence_in_a_pause() {
            self.silent(after);
            return;
        }
        self.pulse = Pulse { asked: self.now, n_unanswered: self.pulse.n_unanswered + 1 };
        self.urgent.push_back("M105\n".to_owned());
        // Nothing is in flight: the next `ok` is for this.
        self.next_ok = NextOk::EndsRefusal;
    }

    /// Whoever says `busy` cannot be silent and alive. The others may be at something that somebody has begun at the printer: that
    /// takes its time, and a pause is not given up for it.
    fn silence_in_a_pause(&self) -> Duration {
        if self.is_talkative() { self.config.response * SILENCE_FACTOR } else { self.config.slow_command }
    }

    /// A pause may take the night: the time-out is for hosts that died. Nothing is in flight, so the next `ok` is for this.
    pub(super) fn guard(&mut self, is_set: bool) {
        if let Some([set, clear]) = &self.config.guard {
            self.urgent.push_back(format!("{}\n", if is_set { set } else { clear }));
            self.next_ok = NextOk::EndsRefusal;
        }
    }

    pub(super) fn on_busy(&mut self, what: &str) {
        self.quiet_since = self.now + BUSY_INTERVAL;
        self.events.push_back(Event::Busy(what.to_owned()));
        let Some(oldest) = self.oldest.as_mut().filter(|_| what.contains("user")) else { return };
        // Somebody changes filament or reads a prompt: that may take the night.
        oldest.since = self.now;
        let number = oldest.number;
        if self.state.has_job() && self.user_awaited_at != Some(number) {
            // It stands still, within a line, until somebody presses its button or the operator says to go on.
            self.events.push_back(Event::Paused);
        }
        self.user_awaited_at = Some(number);
    }

    /// Tells a firmware that waits for the user within a line to go on; anywhere else the word would end the wait for a
    /// temperature.
    pub(super) fn continue_for_user(&mut self) {
        let awaited = self.user_awaited_at.take();
        if awaited.is_some() && awaited == self.oldest.map(|oldest| oldest.number) {
            self.urgent.push_back("M108\n".to_owned());
        }
    }

    pub(super) fn on_action(&mut self, action: &str) {
        self.events.push_back(Event::Action(action.to_owned()));
        if let Some(prompt) = self.prompts.take(action) {
            self.events.push_back(Event::Prompt(prompt));
            return;
        }
        // What follows the word is why: `pause filament_runout 0`.
        let trouble = match action.split_ascii_whitespace().next().unwrap_or_default() {
            "pause" | "paused" => Trouble::FilamentOut,
            "cancel" => Trouble::StopRequested,
            "resume" | "resumed" => {
                // The printer's own wish may come at any time; where it has no meaning there is nothing to do.
                self.handle_command(self.now, Command::Resume).ok();
                return;
            }
            _ => return,
        };
        let command = match policy::action(self.state.phase(), trouble) {
            Action::Pause => Command::Pause,
            Action::Stop => Command::Cancel,
            _ => return,
        };
        self.handle_command(self.now, command).ok();
    }

    /// Answers the printer's question; where there is none, or it has no such button, nothing is said.
    pub(super) fn answer(&mut self, button_idx: usize) {
        let Some(Button { label, gcode }) = self.prompts.answered(button_idx) else { return };
        let is_klipper = self.config.firmware.dialect == Dialect::Klipper;
        let text = match gcode {
            Some(gcode) if gcode.is_ascii() => gcode,
            None if is_klipper && label.is_ascii() => label,
            Some(_) | None if is_klipper => return,
            _ => format!("M876 S{button_idx}"),
        };
        self.urgent.push_back(text + "\n");
        self.n_emergencies_owed += 1;
        self.events.push_back(Event::Prompt(None));
    }

    /// Nothing was heard, or nothing but noise.
    pub(super) fn silent(&mut self, after: Duration) {
        self.fail(if self.n_garbled > 0 { Fault::Garbled { after } } else { Fault::Silent { after } });
    }
}
