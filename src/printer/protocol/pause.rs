//! Pauses: the operator's, the printer's own, and those within a line that waits for the user.
//!
//! In a pause no more lines are sent; those that were sent once are brought to their end. The host may then send lines of its own
//! (parking), for which the job's lines that were never sent are given up: they are given again when it goes on. While it lasts the
//! printer is asked for its temperatures now and then, so that a board that dies in a pause is noticed, and the firmware's
//! time-out for hosts that are gone, which would end a long pause, is set anew: so a host that dies in a pause leaves no heat either.

use super::prompt::Button;
use super::{BUSY_INTERVAL, Command, Core, Event, Fault, SILENCE_FACTOR, State, Timer};
use crate::printer::policy::{self, Action, Trouble};
use crate::profile::Dialect;
use std::time::Duration;

/// In a pause the printer is asked for a sign of life this often.
const ALIVE_INTERVAL: Duration = Duration::from_secs(5);

/// Where it does not answer, it is asked ever more rarely, up to so many doublings.
const MAX_DOUBLINGS: u32 = 6;

/// A line or a question within which the firmware says that it waits for the user: noise can make `M1 5` of `M105`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Awaited {
    /// Its number, as [`super::Oldest`] has it; 0 where it is a line of somebody who is gone.
    number: u64,
    /// Whether it was heard since it was told to go on.
    is_waiting: bool,
}

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
        self.renew_guard();
    }

    /// The job's lines that were never sent are given up; the host's own take their numbers.
    pub(super) fn park(&mut self) {
        self.wire.drop_unsent();
        self.wire.reopen();
        self.state = State::Parking;
    }

    pub(super) fn go_on(&mut self) {
        self.state = if self.wire.is_whole() { State::Finishing } else { State::Streaming };
        self.continue_for_user();
        self.events.push_back(Event::Resumed);
    }

    /// When the next sign of life is due, in a pause.
    pub(super) fn pulse_due(&self) -> super::Instant {
        let n_doublings = self.pulse.n_unanswered.saturating_sub(1).min(MAX_DOUBLINGS);
        let ask = self.pulse.asked + ALIVE_INTERVAL * (1 << n_doublings);
        let dead = self.heard + self.silence_in_a_pause();
        self.guard_due().into_iter().chain([ask, dead]).fold(ask, super::Instant::min)
    }

    /// Asks for a sign of life, or gives up.
    pub(super) fn feel_pulse(&mut self) {
        if self.lift_again() {
            return;
        }
        if self.guard_due().is_some_and(|due| due <= self.now) {
            self.renew_guard();
        }
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
        self.say_now("M105");
    }

    /// Whoever says `busy` cannot be silent and alive. The others may be at something that somebody has begun at the printer: that
    /// takes its time, and a pause is not given up for it.
    pub(super) fn silence_in_a_pause(&self) -> Duration {
        if self.is_talkative() { self.config.response * SILENCE_FACTOR } else { self.config.slow_command }
    }

    pub(super) fn on_busy(&mut self, what: &str) {
        self.quiet_since = self.now + BUSY_INTERVAL;
        self.events.push_back(Event::Busy(what.to_owned()));
        let Some(oldest) = self.oldest.as_mut().filter(|_| what.contains("user")) else { return };
        if self.state == State::Cancelling {
            // Heaters-off stands behind it, and whoever has stopped the print waits for nobody.
            self.say_now("M108");
            return;
        }
        // Somebody changes filament or reads a prompt: that may take the night.
        oldest.since = self.now;
        let number = oldest.number;
        let is_known = self.user_awaited.is_some_and(|awaited| awaited.number == number);
        if self.state.has_job() && !is_known {
            // It stands still, within a line, until somebody presses its button or the operator says to go on.
            self.events.push_back(Event::Paused);
        }
        self.user_awaited = Some(Awaited { number, is_waiting: true });
    }

    /// Tells a firmware that waits for the user within a line to go on; anywhere else the word would end the wait for a temperature.
    pub(super) fn continue_for_user(&mut self) {
        let oldest = self.oldest.map(|oldest| oldest.number);
        let Some(awaited) = self.user_awaited.as_mut().filter(|awaited| Some(awaited.number) == oldest)
        else {
            return;
        };
        if std::mem::take(&mut awaited.is_waiting) {
            self.say_now("M108");
        }
    }

    /// The line within which the user was awaited is done: by the operator's word, or because somebody has pressed the printer's own
    /// button.
    pub(super) fn hear_the_user(&mut self) {
        let is_at = |number| self.oldest.is_some_and(|oldest| oldest.number <= number);
        let is_done = self.user_awaited.is_some_and(|awaited| !is_at(awaited.number));
        if !is_done || !self.state.has_job() {
            return;
        }
        self.user_awaited = None;
        if matches!(self.state, State::Streaming | State::Finishing) {
            self.events.push_back(Event::Resumed);
        }
    }

    /// Before anything is sent: it may be within a line of a host that is gone.
    pub(super) fn busy_before(&mut self, what: &str) {
        self.timers.set(Timer::Handshake, self.now + BUSY_INTERVAL + self.config.response);
        let awaited = Awaited { number: 0, is_waiting: true };
        if what.contains("user") && self.user_awaited.replace(awaited).is_none() {
            self.events.push_back(Event::Busy(what.to_owned()));
            self.events.push_back(Event::Paused);
        }
    }

    /// See above. What it answers then tells whether it does.
    pub(super) fn continue_for_another(&mut self) {
        if self.user_awaited.as_mut().is_some_and(|awaited| std::mem::take(&mut awaited.is_waiting)) {
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

    /// Whether the printer waits, within a line, for somebody.
    #[must_use]
    pub const fn is_user_awaited(&self) -> bool {
        self.user_awaited.is_some()
    }

    /// Whether it has asked something, with such a button.
    #[must_use]
    pub fn is_asking(&self, button_idx: usize) -> bool {
        self.prompts.has(button_idx)
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
        self.say_now(&text);
        self.events.push_back(Event::Prompt(None));
    }

    /// Nothing was heard, or nothing but noise.
    pub(super) fn silent(&mut self, after: Duration) {
        self.fail(if self.n_garbled > 0 { Fault::Garbled { after } } else { Fault::Silent { after } });
    }
}
