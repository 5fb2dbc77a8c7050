//! What the parts of a server share: the queue, the state directory, the clock, the end, the news.

use super::config::OnStop;
use super::notify::News;
use super::place::{BootClock, Layout};
use super::printing::Identities;
use crate::http::events::Events;
use crate::http::metrics::Counters;
use crate::queue::{Actor, Change, Claim, Job, Name, Reason, Refusal, Request};
use crate::store::{Error, Store};
use jiff::Timestamp;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// Between two attempts to have something recorded, at least and at most.
const AGAIN: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(30)];
/// How often the queue is told that a holder is alive, and the same, where it did not hear.
const BEAT: Duration = Duration::from_secs(20);
const BEAT_AGAIN: Duration = Duration::from_secs(5);
/// Attempts before the end of a server that is asked to stop.
const LAST_ATTEMPTS: u32 = 5;

/// See the module. Clones are the same.
#[derive(Debug, Clone)]
pub(super) struct Kit<S> {
    pub(super) store: S,
    pub(super) layout: Arc<Layout>,
    pub(super) clock: fn() -> Timestamp,
    pub(super) boot_clock: BootClock,
    pub(super) identities: Identities,
    /// This program, which children are started with.
    pub(super) program: PathBuf,
    /// Whether and how the server ends.
    pub(super) stopping: watch::Receiver<Option<OnStop>>,
    pub(super) events: Events,
    pub(super) counters: Counters,
    pub(super) news: News,
}

impl<S: Store> Kit<S> {
    pub(super) fn now(&self) -> Timestamp {
        (self.clock)()
    }

    pub(super) fn stopping(&self) -> Option<OnStop> {
        *self.stopping.borrow()
    }

    /// Changes a job that this process has in hand.
    pub(super) async fn change(
        &self,
        claim: &Claim,
        change: Change,
        asked_by: Option<&Name>,
        why: &str,
    ) -> Result<Job, Error> {
        let actor = Actor::Holder { claim: claim.clone(), asked_by: asked_by.cloned() };
        let request = Request { change, actor, why: reason(why), now: self.now() };
        let changed = self.store.change(claim.job, request).await;
        self.events.look();
        changed
    }

    /// The same, until the queue has taken it, or refuses it, or has ended.
    pub(super) async fn insist(
        &self,
        claim: &Claim,
        change: Change,
        asked_by: Option<&Name>,
        why: &str,
    ) -> Result<Job, Error> {
        let [mut rest, longest] = AGAIN;
        let mut n_left = LAST_ATTEMPTS;
        loop {
            let error = match self.change(claim, change.clone(), asked_by, why).await {
                Err(error @ (Error::Refused(_) | Error::Gone)) => return Err(error),
                Err(error) => error,
                done => return done,
            };
            tracing::error!(job = %claim.job, change = %change.kind(), "queue: {error}; it is tried again");
            n_left -= u32::from(self.stopping().is_some());
            if n_left == 0 {
                return Err(error);
            }
            tokio::time::sleep(rest).await;
            rest = (2 * rest).min(longest);
        }
    }

    /// Tells the queue that the holder of a claim is alive, again and again, until the claim is lost.
    pub(super) async fn keep(self, claim: Claim) {
        loop {
            let rest = match self.store.renew(claim.clone(), self.now()).await {
                Ok(_) => BEAT,
                Err(Error::Refused(Refusal::ClaimLost)) => return,
                Err(error) => {
                    tracing::warn!(job = %claim.job, "print: the claim was not renewed: {error}");
                    BEAT_AGAIN
                }
            };
            tokio::time::sleep(rest).await;
        }
    }
}

/// Whether something can be tried again: the disk is full or read-only, another program keeps the queue to itself.
pub(super) const fn can_be_mended(error: &Error) -> bool {
    matches!(
        error,
        Error::Full { .. }
            | Error::ReadOnly { .. }
            | Error::Locked { .. }
            | Error::Io { .. }
            | Error::Server { .. }
    )
}

/// A reason, cut to what the queue takes.
pub(super) fn reason(text: &str) -> Reason {
    let cut: String = text.chars().take(500).collect();
    Reason::try_new(&cut).unwrap_or_default()
}

/// Once the server ends.
pub(super) async fn ended(stopping: &mut watch::Receiver<Option<OnStop>>) {
    // Where the sender is gone, it has ended, too.
    stopping.wait_for(Option::is_some).await.ok();
}

/// Does something that waits for a disk, or for a share that may not answer for ever, beside the async tasks.
pub(super) async fn on_disk<T: Send + 'static>(
    work: impl FnOnce() -> io::Result<T> + Send + 'static,
) -> io::Result<T> {
    tokio::task::spawn_blocking(work).await.unwrap_or_else(|panicked| Err(io::Error::other(panicked)))
}
