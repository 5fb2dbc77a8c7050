//! Supervision: parts are started again when they fail; where one cannot be, the others end as they would anyway, and the server after them.

use super::Error;
use super::config::OnStop;
use super::kit::ended;
use super::system::System;
use crate::http::metrics::Counters;
use crate::store;
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::{JoinError, JoinHandle, JoinSet};
use tokio::time::{Instant, sleep};

/// A part that ended is started again after so long, longer each time; one that lived so long starts from the beginning.
pub(super) const REST: [Duration; 2] = [Duration::from_millis(200), Duration::from_secs(30)];
pub(super) const LONG_LIFE: Duration = Duration::from_secs(60);
/// So often in a row; then the server ends once its prints have, and whoever started it starts it anew: see `StartLimitBurst=` of the unit.
pub(super) const MOST_RESTARTS: u32 = 10;

/// Whether and how something ends.
pub(super) type End = watch::Receiver<Option<OnStop>>;

/// Parts of a server.
pub(super) type Parts = JoinSet<Result<(), Error>>;

/// How long a part that fails rests before it is started again, and how often it is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patience {
    pub(super) rest: Duration,
    pub(super) n_left: u32,
}

impl Default for Patience {
    fn default() -> Self {
        let [rest, _] = REST;
        Self { rest, n_left: MOST_RESTARTS }
    }
}

impl Patience {
    /// How long a part rests that lived so long; `None`: it is given up.
    pub(super) fn rest_after(&mut self, lived: Duration) -> Option<Duration> {
        if lived > LONG_LIFE {
            *self = Self::default();
        }
        self.n_left = self.n_left.checked_sub(1)?;
        let [_, longest] = REST;
        let rest = self.rest;
        self.rest = (2 * rest).min(longest);
        Some(rest)
    }
}

/// A part that is started again when it fails.
#[derive(Debug, Clone)]
pub(super) struct Guarded {
    part: &'static str,
    counters: Counters,
    end: End,
    patience: Patience,
}

impl Guarded {
    /// Once `end` is told it is not started again.
    pub(super) fn new(part: &'static str, counters: Counters, end: End) -> Self {
        Self { part, counters, end, patience: Patience::default() }
    }

    pub(super) async fn run<F, E>(mut self, mut start: impl FnMut() -> F + Send) -> Result<(), Error>
    where
        F: Future<Output = Result<(), E>> + Send + 'static,
        E: Into<Error> + Send + 'static,
    {
        loop {
            let began = Instant::now();
            // A task of its own: a panic ends it alone.
            let mut part = AbortOnDrop(tokio::spawn(start()));
            match (&mut part.0).await.map(|ended| ended.map_err(Into::into)) {
                Ok(Ok(())) => return Ok(()),
                Ok(Err(error @ Error::Store(store::Error::Gone))) => return Err(error),
                Ok(Err(error)) => tracing::error!("server: {} ended: {error}", self.part),
                Err(panicked) => tracing::error!("server: {} ended: {panicked}", self.part),
            }
            self.counters.count_restart();
            let gave_up = Error::GaveUp { part: self.part };
            let rest = self.patience.rest_after(began.elapsed()).ok_or(gave_up)?;
            tokio::select! {
                () = sleep(rest) => {}
                () = ended(&mut self.end) => return Ok(()),
            }
        }
    }
}

/// A task that ends with whoever waits for it.
struct AbortOnDrop<E>(JoinHandle<Result<(), E>>);

impl<E> Drop for AbortOnDrop<E> {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// Watches over all parts, and says when they end.
pub(super) struct Watchman {
    pub(super) system: System,
    /// What prints and prepares: the server lives until they have all ended.
    pub(super) works: Parts,
    /// What serves them meanwhile: faces, webhook.
    pub(super) servants: Parts,
    /// What somebody asks for from outside.
    pub(super) asked: End,
    /// What the parts are told.
    pub(super) end: watch::Sender<Option<OnStop>>,
    /// How prints end where nobody has asked.
    pub(super) on_stop: OnStop,
}

impl Watchman {
    /// Until all works have ended. One that gave up ends the others as `on_stop` says, so that no print is dropped.
    ///
    /// # Errors
    /// Why the first one gave up that did.
    pub(super) async fn run(&mut self, status: impl Fn() -> String) -> Result<(), Error> {
        let mut watchdog = tokio::time::interval(self.system.watchdog_interval());
        let mut gave_up = None;
        self.system.ready();
        tracing::info!("server: ready");
        let asked = *self.asked.borrow_and_update();
        self.pass_on(asked);
        loop {
            let failed = tokio::select! {
                work = self.works.join_next() => match work {
                    None => return gave_up.map_or(Ok(()), Err),
                    Some(ended) => failed(ended),
                },
                Some(ended) = self.servants.join_next() => failed(ended),
                // This loop lives. Whether the queue can be written is another matter: no restart would mend it, and it would end prints.
                _ = watchdog.tick() => {
                    self.system.alive(&status());
                    None
                }
                Ok(()) = self.asked.changed() => {
                    let asked = *self.asked.borrow_and_update();
                    self.pass_on(asked);
                    None
                }
            };
            if let Some(error) = failed {
                tracing::error!("server: {error}; it ends once its prints have ended ({:?})", self.on_stop);
                gave_up.get_or_insert(error);
                self.pass_on(Some(self.on_stop));
            }
        }
    }

    /// Tells the parts how they end; the strictest counts.
    fn pass_on(&self, wish: Option<OnStop>) {
        let is_stricter = self.end.send_if_modified(|now| {
            let is_stricter = wish > *now;
            *now = wish.max(*now);
            is_stricter
        });
        if is_stricter {
            self.system.stopping();
        }
    }
}

fn failed(ended: Result<Result<(), Error>, JoinError>) -> Option<Error> {
    match ended {
        Ok(ended) => ended.err(),
        Err(panicked) => {
            tracing::error!("server: {panicked}");
            Some(Error::GaveUp { part: "a part" })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

    type Asked = Arc<std::sync::Mutex<Option<OnStop>>>;

    /// A watchman of a server with one print, which ends when it is asked to; how it was asked, once it has.
    fn watched() -> (Watchman, watch::Sender<Option<OnStop>>, Asked) {
        let (ask, asked) = watch::channel(None);
        let (end, mut ending) = watch::channel(None);
        let printed = Arc::new(std::sync::Mutex::new(None));
        let (mut works, tells) = (Parts::new(), Arc::clone(&printed));
        works.spawn(async move {
            ended(&mut ending).await;
            // A print takes its time.
            tokio::task::yield_now().await;
            *tells.lock().unwrap() = *ending.borrow();
            Ok(())
        });
        let system = System::default();
        let watchman = Watchman { system, works, servants: Parts::new(), asked, end, on_stop: OnStop::Park };
        (watchman, ask, printed)
    }

    #[tokio::test]
    async fn a_part_that_gives_up_lets_prints_end_first() {
        for is_servant in [false, true] {
            let (mut watchman, _ask, printed) = watched();
            let parts = if is_servant { &mut watchman.servants } else { &mut watchman.works };
            parts.spawn(async { Err(Error::GaveUp { part: "a worker" }) });
            let error = watchman.run(String::new).await.unwrap_err();
            assert!(matches!(error, Error::GaveUp { part: "a worker" }), "{error}");
            assert_eq!(*printed.lock().unwrap(), Some(OnStop::Park), "the print was dropped");
        }
    }

    #[tokio::test]
    async fn a_part_that_panics_lets_prints_end_first() {
        let (mut watchman, _ask, printed) = watched();
        watchman.works.spawn(async { panic!("as asked for") });
        assert_eq!(watchman.run(String::new).await.unwrap_err().code(), "serve.gave_up");
        assert_eq!(*printed.lock().unwrap(), Some(OnStop::Park));
    }

    #[tokio::test]
    async fn whoever_asks_is_heeded_and_the_strictest_counts() {
        let (mut watchman, ask, printed) = watched();
        ask.send_replace(Some(OnStop::Cancel));
        watchman.servants.spawn(async { Err(Error::GaveUp { part: "the webhook" }) });
        watchman.run(String::new).await.unwrap_err();
        assert_eq!(*printed.lock().unwrap(), Some(OnStop::Cancel));
    }

    #[tokio::test]
    async fn a_part_is_started_again_some_times_in_a_row_and_then_given_up() {
        let (_end, ending) = watch::channel(None);
        let patience = Patience { rest: Duration::ZERO, n_left: MOST_RESTARTS };
        let guarded = Guarded { patience, ..Guarded::new("a part", Counters::default(), ending) };
        let n_starts = Arc::new(AtomicU32::new(0));
        let counted = Arc::clone(&n_starts);
        let start = move || {
            let number = counted.fetch_add(1, Relaxed);
            async move {
                assert!(number.is_multiple_of(2), "as asked for");
                Err(store::Error::Address)
            }
        };
        let error = guarded.clone().run(start).await.unwrap_err();
        assert!(matches!(error, Error::GaveUp { part: "a part" }), "{error}");
        assert_eq!(n_starts.load(Relaxed), 1 + MOST_RESTARTS);
        let gone = guarded.run(|| async { Err::<(), _>(store::Error::Gone) }).await.unwrap_err();
        assert_eq!(gone.code(), "store.gone");
    }
}
