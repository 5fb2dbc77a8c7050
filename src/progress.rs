//! Progress reports and cancellation for long work.
//!
//! Every long function takes a [`Task`]: it reports how far it is and asks, at least every 100 ms of work,
//! whether it should stop. The faces decide what a report looks like.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The work was interrupted on request; nothing was produced.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("interrupted")]
pub struct Cancelled;

/// A flag that several threads share: once set, the work that watches it stops.
#[derive(Debug, Clone, Default)]
pub struct CancelToken(Arc<AtomicBool>);

impl CancelToken {
    /// Asks the work to stop.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether the work was asked to stop.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Receives progress: units done, units in all.
pub type ProgressSink<'a> = dyn Fn(u64, u64) + Sync + 'a;

/// What a long function gets from its caller: where to report and when to stop.
#[derive(Clone)]
pub struct Task<'a> {
    sink: &'a ProgressSink<'a>,
    cancel: CancelToken,
}

impl std::fmt::Debug for Task<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Task").field("cancel", &self.cancel).finish_non_exhaustive()
    }
}

impl Task<'static> {
    /// A task that reports nowhere and is never cancelled.
    #[must_use]
    pub fn quiet() -> Self {
        Self { sink: &|_, _| {}, cancel: CancelToken::default() }
    }
}

impl<'a> Task<'a> {
    /// A task that reports to `sink` and stops when `cancel` is set.
    #[must_use]
    pub fn new(sink: &'a ProgressSink<'a>, cancel: CancelToken) -> Self {
        Self { sink, cancel }
    }

    /// Reports `done` of `total` units of work.
    pub fn report(&self, done: u64, total: u64) {
        (self.sink)(done, total);
    }

    /// Returns an error once the work was asked to stop.
    ///
    /// # Errors
    /// [`Cancelled`] after [`CancelToken::cancel`].
    pub fn check(&self) -> Result<(), Cancelled> {
        if self.cancel.is_cancelled() { Err(Cancelled) } else { Ok(()) }
    }
}
