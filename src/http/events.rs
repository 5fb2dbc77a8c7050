//! What happens, as server-sent events (WHATWG HTML, 9.2).
//!
//! An event `record` is a record of the history; its id is the record's number, so that a reader that was cut off goes on where it was
//! (`Last-Event-ID`), however long ago and whatever restarted meanwhile. An event `printer` tells what printers are doing, an event `task` how
//! far a task is, both without an id.
//! `hello` comes first. A reader that is more than `MOST_BEHIND` records behind gets `reset` instead of all of them: it has to look
//! again. One that does not keep up is dropped once `MOST_WAITING` events wait for it; nobody else waits for it.

use super::appliance::Appliance;
use super::error::Problem;
use super::wire::HistoryView;
use super::wire::case::TaskView;
use crate::queue::Sealed;
use crate::store::{Error, Store};
use axum::response::sse::Event;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore, broadcast, watch};

/// Events that may wait for one reader.
const MOST_WAITING: usize = 256;
/// Records that a reader may be behind.
const MOST_BEHIND: u64 = 1000;
/// Records that are read at once.
const PAGE: u32 = 100;
/// Readers at once.
const MOST_READERS: usize = 128;
/// How often the history is looked at for records of other processes.
const LOOK: Duration = Duration::from_secs(1);
/// How long a reader waits until it comes back.
const RETRY: Duration = Duration::from_secs(3);

/// Something that has happened.
#[derive(Debug, Clone)]
enum News {
    Record(u64, Arc<str>),
    Printers(Arc<str>),
    Task(Arc<str>),
}

/// The news of one server. Clones are the same.
#[derive(Debug, Clone)]
pub struct Events(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    news: broadcast::Sender<News>,
    look: Notify,
    readers: Arc<Semaphore>,
    is_ending: watch::Sender<bool>,
}

impl Default for Events {
    fn default() -> Self {
        Self(Arc::new(Inner {
            news: broadcast::Sender::new(MOST_WAITING),
            look: Notify::new(),
            readers: Arc::new(Semaphore::new(MOST_READERS)),
            is_ending: watch::Sender::new(false),
        }))
    }
}

impl Events {
    /// The history may have grown: looks at once instead of within a second.
    pub fn look(&self) {
        self.0.look.notify_one();
    }

    /// Lets streams begin, again after an end.
    pub(super) fn begin(&self) {
        self.0.is_ending.send_replace(false);
    }

    /// Ends all streams.
    pub fn end(&self) {
        self.0.is_ending.send_replace(true);
    }

    /// Finds out what happens behind record `at` and tells all readers, until [`Events::end`]. Readers that came before it began may miss
    /// what happened meanwhile.
    pub(super) async fn tell<S: Store>(&self, app: &Appliance<S>, mut at: u64) {
        let mut ending = self.0.is_ending.subscribe();
        let mut lives = app.printers.lives.clone();
        loop {
            if let Err(error) = self.tell_records(&app.store, &mut at).await {
                tracing::warn!("events: {error}");
            }
            tokio::select! {
                () = self.0.look.notified() => {}
                () = tokio::time::sleep(LOOK) => {}
                Ok(()) = lives.changed() => {
                    let told = serde_json::to_string(&*lives.borrow_and_update());
                    self.send(told.map(|json| News::Printers(json.into())));
                }
                () = ended(&mut ending) => return,
            }
        }
    }

    /// Tells what was recorded behind number `at`, which moves on.
    async fn tell_records<S: Store>(&self, store: &S, at: &mut u64) -> Result<(), Error> {
        loop {
            let records = store.history(None, *at, PAGE).await?;
            let Some(last) = records.last() else { return Ok(()) };
            *at = last.seq;
            for sealed in &records {
                self.send(json(sealed).map(|json| News::Record(sealed.seq, json)));
            }
        }
    }

    /// Tells how far a task is.
    pub(super) fn task(&self, task: &TaskView) {
        self.send(serde_json::to_string(task).map(|json| News::Task(json.into())));
    }

    /// Whether anybody reads does not matter.
    fn send<E: std::fmt::Display>(&self, news: Result<News, E>) {
        match news {
            Ok(news) => drop(self.0.news.send(news)),
            Err(error) => tracing::error!("events: {error}"),
        }
    }

    /// Readers that are there.
    #[must_use]
    pub fn n_readers(&self) -> usize {
        MOST_READERS - self.0.readers.available_permits()
    }

    /// A reader that has seen the record `seen`, or begins now.
    pub(super) async fn read<S: Store>(&self, store: S, seen: Option<u64>) -> Result<Reader<S>, Problem> {
        let too_many = |_all_taken| {
            Problem::busy("http.too_many_streams", "too many streams of events are open: close some", 10)
        };
        let permit = Arc::clone(&self.0.readers).try_acquire_owned().map_err(too_many)?;
        // First listen, then look, lest something be missed in between.
        let (news, ending) = (self.0.news.subscribe(), self.0.is_ending.subscribe());
        let last = store.head().await?.seq;
        let is_reset = seen.is_some_and(|seen| seen > last || last - seen > MOST_BEHIND);
        let at = seen.filter(|_| !is_reset).unwrap_or(last);
        let first = Event::default().event(if is_reset { "reset" } else { "hello" }).id(at.to_string());
        let first = VecDeque::from([first.retry(RETRY).data("{}")]);
        let state = if at < last { Reading::Behind } else { Reading::Live };
        Ok(Reader { store, news, ending, at, waiting: first, state, _permit: permit })
    }
}

fn json(sealed: &Sealed) -> Result<Arc<str>, Error> {
    let fact = sealed.record()?.fact;
    let view = HistoryView::new(sealed.seq, fact, sealed.digest);
    Ok(serde_json::to_string(&view).expect("records are numbers, names and lists of them").into())
}

/// How far a reader is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Reading {
    /// Records that are in the history already.
    Behind,
    /// What happens now.
    Live,
}

/// One reader of the news.
#[derive(Debug)]
pub(super) struct Reader<S> {
    store: S,
    news: broadcast::Receiver<News>,
    ending: watch::Receiver<bool>,
    /// Last record that it has.
    at: u64,
    waiting: VecDeque<Event>,
    state: Reading,
    _permit: OwnedSemaphorePermit,
}

impl<S: Store> Reader<S> {
    /// As a stream; ends when the reader is too slow, or the server ends.
    pub(super) fn stream(self) -> impl futures_util::Stream<Item = Result<Event, Infallible>> + Send {
        futures_util::stream::unfold(self, |mut reader| async {
            let event = reader.next().await?;
            Some((Ok(event), reader))
        })
    }

    async fn next(&mut self) -> Option<Event> {
        loop {
            if let Some(event) = self.waiting.pop_front() {
                return Some(event);
            }
            match self.state {
                Reading::Behind => self.catch_up().await?,
                Reading::Live => self.hear().await?,
            }
        }
    }

    /// `None`: the history cannot be read; the reader comes back.
    async fn catch_up(&mut self) -> Option<()> {
        let records = self.store.history(None, self.at, PAGE).await.ok()?;
        let Some(last) = records.last() else {
            self.state = Reading::Live;
            return Some(());
        };
        self.at = last.seq;
        self.waiting = records.iter().filter_map(|s| Some(record(s.seq, &json(s).ok()?))).collect();
        Some(())
    }

    /// `None`: too slow, or the end.
    async fn hear(&mut self) -> Option<()> {
        let news = tokio::select! {
            news = self.news.recv() => news.ok()?,
            () = ended(&mut self.ending) => return None,
        };
        match news {
            News::Printers(json) => self.waiting.push_back(Event::default().event("printer").data(&*json)),
            News::Task(json) => self.waiting.push_back(Event::default().event("task").data(&*json)),
            News::Record(seq, json) if seq == self.at + 1 => {
                self.at = seq;
                self.waiting.push_back(record(seq, &json));
            }
            News::Record(seq, _) if seq > self.at => self.state = Reading::Behind,
            News::Record(..) => {}
        }
        Some(())
    }
}

async fn ended(ending: &mut watch::Receiver<bool>) {
    ending.wait_for(|&is_ending| is_ending).await.ok();
}

fn record(seq: u64, json: &str) -> Event {
    Event::default().event("record").id(seq.to_string()).data(json)
}
