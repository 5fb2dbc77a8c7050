//! How long the core waits for what: each timer of a session, set anew from what is owed.

use super::{BUSY_INTERVAL, Core, Fault, Instant, Oldest, SILENCE_FACTOR, State, Timer};
use crate::profile::Dialect;
use std::time::Duration;

/// How much longer than the interval `busy` may take.
const BUSY_GRACE: Duration = Duration::from_millis(500);

/// After going back the answer is expected soon: asking early costs nothing, waiting does.
const REWOUND_PATIENCE: Duration = Duration::from_millis(250);

/// A cancelled job's heaters-off must get through within this time.
const CANCEL_LIMIT: Duration = Duration::from_secs(120);

/// What is asked when no line is in flight.
const QUESTION: &str = "M105";

impl Core {
    pub(super) fn command_timeout(&mut self) {
        let command = self.wire.oldest_command().unwrap_or(QUESTION).to_owned();
        let after = self.oldest.map_or(Duration::ZERO, |oldest| self.now.since(oldest.since));
        self.fail(Fault::CommandTimeout { command, after });
    }

    pub(super) fn track_oldest(&mut self) {
        let number = self.wire.acked() + 1;
        if self.wire.in_flight() == 0 && self.probe.is_none() {
            self.oldest = None;
        } else if self.oldest.is_none_or(|oldest| oldest.number != number) {
            self.oldest = Some(Oldest { number, since: self.now });
            self.end_wait_of_cancelled();
        }
    }

    /// The word that ended the wait under way says nothing to the next one, which the firmware has already.
    fn end_wait_of_cancelled(&mut self) {
        if self.state == State::Cancelling && self.wire.oldest_waits() {
            self.say_now("M108");
        }
    }

    /// Sets the session's timers anew from what is owed.
    pub(super) fn arm(&mut self) {
        let Some(oldest) = self.oldest.filter(|_| self.state.has_job()) else {
            self.arm_for_nothing_owed();
            return;
        };
        self.timers.stop(Timer::Pulse);
        let is_slow = self.wire.oldest_is_slow();
        self.timers.set(Timer::Response, self.quiet_since + self.patience(is_slow));
        let is_alive = self.is_talkative() && self.heard > oldest.since;
        let silence =
            if is_slow && !is_alive { self.silence_limit() } else { self.config.response * SILENCE_FACTOR };
        self.timers.set(Timer::Silence, self.heard_or_sent() + silence);
        self.timers.set(Timer::Command, oldest.since + self.command_limit());
    }

    fn arm_for_nothing_owed(&mut self) {
        match self.state {
            // These have timers of their own.
            State::Handshake(_) | State::Asking(_) | State::Faulted(_) | State::SwitchingOff => {}
            State::Paused => {
                self.timers.stop_all();
                self.timers.set(Timer::Pulse, self.pulse_due());
            }
            _ => {
                self.timers.stop_all();
                self.lift_due().into_iter().for_each(|due| self.timers.set(Timer::Pulse, due));
            }
        }
    }

    /// How long a command may take of which nothing is heard.
    fn silence_limit(&self) -> Duration {
        match self.state {
            State::Cancelling => self.cancel_limit(),
            _ => self.command_limit(),
        }
    }

    fn command_limit(&self) -> Duration {
        match self.state {
            _ if self.wire.in_flight() == 0 => self.question_limit(),
            // It tells its temperatures; where nothing can end its wait, heaters-off stands behind it.
            State::Cancelling if !self.wire.oldest_waits_for_heat() => self.cancel_limit(),
            _ => self.config.slow_command + self.wire.oldest_dwell(),
        }
    }

    /// The question stands behind lines that are acknowledged and may still be to come.
    fn question_limit(&self) -> Duration {
        let (n_slow, dwell) = self.wire.slow_before_question(self.ahead().n_lines);
        match self.state {
            State::Cancelling if n_slow == 0 => self.cancel_limit(),
            _ => self.config.slow_command * n_slow.max(1) + dwell,
        }
    }

    fn cancel_limit(&self) -> Duration {
        self.config.slow_command.min(CANCEL_LIMIT)
    }

    /// Whether the firmware says `busy` in the middle of what takes its time. One word of another (a temperature, "// probe at")
    /// promises no next one.
    pub(super) const fn is_talkative(&self) -> bool {
        match self.config.firmware.dialect {
            Dialect::Marlin | Dialect::Marlin1 | Dialect::Repetier => true,
            Dialect::Klipper | Dialect::RepRapFirmware | Dialect::Smoothie => false,
        }
    }

    /// How long to wait for a sign of progress before asking.
    fn patience(&self, is_slow: bool) -> Duration {
        if let Some(probe) = &self.probe {
            return self.config.response * (1 << (probe.tries.saturating_sub(1)).min(4));
        }
        if is_slow {
            return self.config.response.max(BUSY_INTERVAL + BUSY_GRACE);
        }
        if self.rewind.is_some() {
            return self.config.response.min(REWOUND_PATIENCE);
        }
        self.config.response
    }

    /// Since when the firmware could have said something.
    pub(super) fn heard_or_sent(&self) -> Instant {
        self.oldest.map_or(self.heard, |oldest| oldest.since.max(self.heard))
    }
}
