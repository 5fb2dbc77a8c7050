//! The firmware's own time-out, which switches the heaters off where a host is gone (`M85`): it is set at the beginning of a job, set anew
//! in a pause, and lifted while the firmware waits for somebody.
//!
//! Within a line such as `M0` or `M600` it takes no command, and its time-out would end the print of whoever changes filament slowly. So
//! it is lifted before such a line, which goes only when that is answered, and set again behind it. A host that dies within the
//! line leaves what the firmware itself does about heat that nobody needs.

use super::{Core, State};
use std::time::Duration;

/// A time-out that is not answered is set ever more rarely, up to so many doublings.
const MAX_RENEWAL_DOUBLINGS: u32 = 4;

/// How often the time-out is set anew in a pause: a few times may be lost.
pub(super) fn renewal(hold_s: f64) -> Option<Duration> {
    Duration::try_from_secs_f64(hold_s / 6.0).ok()
}

/// What sets and lifts it, and how often it is set in a pause.
#[derive(Debug, Clone)]
pub(super) struct Words {
    pub(super) set: String,
    /// Nothing where it need not be.
    pub(super) lift: Option<String>,
    pub(super) every: Duration,
}

/// The firmware's time-out.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Guard {
    /// When it was set last.
    set: super::Instant,
    /// How often, since anything was answered.
    pub(super) n_unanswered: u32,
    lifting: Lifting,
}

/// Whether it is lifted for a line that waits for somebody.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Lifting {
    #[default]
    Set,
    /// The answer is awaited.
    Asked(super::Instant),
    /// Until this line is done.
    Lifted(u64),
}

impl Core {
    /// The firmware counts anew from here: a pause may take the night, and a host that dies in it is noticed all the same.
    pub(super) fn renew_guard(&mut self) {
        if let Some(set) = self.config.guard.as_ref().map(|words| words.set.clone()) {
            let n_unanswered = self.guard.n_unanswered + 1;
            self.guard = Guard { set: self.now, n_unanswered, lifting: Lifting::Set };
            self.say_now(&set);
        }
    }

    /// When that is due; ever more rarely where nothing is answered: what takes nothing now would be overrun.
    pub(super) fn guard_due(&self) -> Option<super::Instant> {
        let words = self.config.guard.as_ref()?;
        let n_doublings = self.guard.n_unanswered.saturating_sub(1).min(MAX_RENEWAL_DOUBLINGS);
        Some(self.guard.set + words.every * (1 << n_doublings))
    }

    /// Whether the next line may go. Before one that waits for somebody the time-out is lifted first.
    pub(super) fn is_guard_out_of_the_way(&mut self) -> bool {
        let is_needed = self.wire.next_waits_for_user()
            && self.config.guard.as_ref().is_some_and(|words| words.lift.is_some());
        match self.guard.lifting {
            _ if !is_needed => true,
            Lifting::Lifted(number) => number == self.wire.next(),
            Lifting::Set if self.wire.in_flight() == 0 => {
                self.lift_guard();
                false
            }
            Lifting::Set | Lifting::Asked(_) => false,
        }
    }

    fn lift_guard(&mut self) {
        if let Some(lift) = self.config.guard.as_ref().and_then(|words| words.lift.clone()) {
            self.guard.lifting = Lifting::Asked(self.now);
            self.say_now(&lift);
            self.arm();
        }
    }

    /// When the answer to that is overdue.
    pub(super) fn lift_due(&self) -> Option<super::Instant> {
        match self.guard.lifting {
            Lifting::Asked(at) if self.state == State::Streaming || self.state == State::Finishing => {
                Some(at + self.config.response)
            }
            _ => None,
        }
    }

    /// It is lifted again, or nobody is there. False where no answer is awaited.
    pub(super) fn lift_again(&mut self) -> bool {
        let is_awaited = self.lift_due().is_some();
        let after = self.now.since(self.heard);
        if is_awaited && after >= self.silence_in_a_pause() {
            self.silent(after);
        } else if is_awaited {
            self.lift_guard();
        }
        is_awaited
    }

    /// The answer has come, or the line is done.
    pub(super) fn follow_guard(&mut self) {
        match self.guard.lifting {
            Lifting::Asked(_) if self.owed.is_empty() => {
                self.guard.lifting = Lifting::Lifted(self.wire.next());
            }
            Lifting::Lifted(number) if self.wire.acked() >= number && self.state.has_job() => {
                self.renew_guard();
            }
            _ => {}
        }
    }
}
