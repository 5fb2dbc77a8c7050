//! Time as the core sees it: how long ago the driver began. The core never reads a clock.

use std::ops::Add;
use std::time::Duration;

/// A moment, counted from when the driver began.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub struct Instant(Duration);

impl Instant {
    /// The moment `elapsed` after the driver began.
    #[must_use]
    pub const fn after(elapsed: Duration) -> Self {
        Self(elapsed)
    }

    /// How much later this is than `earlier`; zero if it is not later.
    #[must_use]
    pub const fn since(self, earlier: Self) -> Duration {
        self.0.saturating_sub(earlier.0)
    }
}

impl Add<Duration> for Instant {
    type Output = Self;

    fn add(self, later: Duration) -> Self {
        Self(self.0.saturating_add(later))
    }
}

/// What a deadline is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Timer {
    /// Lines are unacknowledged and nothing happened: ask the firmware where it is.
    Response,
    /// Nothing at all was heard: the firmware is gone.
    Silence,
    /// One command has not ended.
    Command,
    /// The firmware has not answered the greeting.
    Handshake,
    /// A sign of life is due, in a pause.
    Pulse,
    /// The answer to heaters-off is due.
    Secure,
}

/// At most one deadline for each [`Timer`].
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Timers([Option<Instant>; 6]);

impl Timers {
    const ALL: [Timer; 6] =
        [Timer::Response, Timer::Silence, Timer::Command, Timer::Handshake, Timer::Pulse, Timer::Secure];

    pub(super) fn set(&mut self, timer: Timer, deadline: Instant) {
        self.0[timer as usize] = Some(deadline);
    }

    pub(super) fn stop(&mut self, timer: Timer) {
        self.0[timer as usize] = None;
    }

    pub(super) fn stop_all(&mut self) {
        *self = Self::default();
    }

    /// The earliest deadline.
    pub(super) fn next(&self) -> Option<Instant> {
        self.0.iter().flatten().min().copied()
    }

    /// Takes one timer whose deadline has come.
    pub(super) fn expired(&mut self, now: Instant) -> Option<Timer> {
        let due = |timer: &Timer| self.0[*timer as usize].is_some_and(|deadline| deadline <= now);
        let timer = Self::ALL.into_iter().find(due)?;
        self.stop(timer);
        Some(timer)
    }
}
