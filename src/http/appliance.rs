//! What the faces are given by whoever starts them: the queue, the printers, a place for files, keys, the news.
//!
//! The faces know no meshes and talk to no printer. What printers are doing comes in over a `watch` channel, what is asked of them goes
//! out over a bounded one: whoever talks to a printer is never held up by a face.

use super::cases::Cases;
use super::events::Events;
use super::files::Files;
use super::keys::Keys;
use super::metrics::Counters;
use super::wire::Live;
use crate::queue::{JobId, Name, Reason};
use crate::store::Store;
use jiff::Timestamp;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::{mpsc, oneshot, watch};

/// Wishes that may wait for whoever talks to the printers.
const MOST_WISHES: usize = 16;
/// How long an answer is waited for: a printer's part of the program answers at once that it has understood.
const PATIENCE: Duration = Duration::from_secs(5);

/// Something that is asked of a printer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Wish {
    /// Stop for a while.
    Pause,
    /// Go on.
    GoOn,
    /// Give up what it prints.
    Cancel,
    /// Stop everything at once; the printer has to be reset afterwards.
    EmergencyStop,
    /// Lines of G-code, each one command.
    Commands(Vec<String>),
    /// Open the port.
    Connect,
    /// Close it.
    Disconnect,
}

/// Why it is not done.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Unheard {
    /// There is no such printer here.
    #[error("{printer} is not a printer of this server")]
    NoPrinter {
        /// Its name.
        printer: Name,
    },
    /// It cannot do so now; why, in plain words.
    #[error("{0}")]
    NotNow(String),
    /// Whoever talks to it does not answer.
    #[error("the printer's part of lumenfab does not answer: look into its log")]
    NoAnswer,
}

/// A wish on its way.
#[derive(Debug)]
pub struct Wished {
    /// To which printer.
    pub printer: Name,
    /// About which job; the wish is void where the printer has another.
    pub job: Option<JobId>,
    /// What.
    pub wish: Wish,
    /// The person who asks.
    pub by: Name,
    /// Why.
    pub why: Reason,
    /// Whether it has been understood and will be done.
    pub answer: oneshot::Sender<Result<(), Unheard>>,
}

/// The other end of [`Printers`]: for whoever talks to the printers.
#[derive(Debug)]
pub struct PrinterDesk {
    /// What each printer of this server is doing.
    pub lives: watch::Sender<Vec<Live>>,
    /// What is asked of them.
    pub wishes: mpsc::Receiver<Wished>,
}

/// The printers, as the faces know them.
#[derive(Debug, Clone)]
pub struct Printers {
    pub(super) lives: watch::Receiver<Vec<Live>>,
    wishes: mpsc::Sender<Wished>,
}

impl Printers {
    /// Both ends.
    #[must_use]
    pub fn channel() -> (Self, PrinterDesk) {
        let (lives_in, lives) = watch::channel(Vec::new());
        let (wishes, wishes_out) = mpsc::channel(MOST_WISHES);
        (Self { lives, wishes }, PrinterDesk { lives: lives_in, wishes: wishes_out })
    }

    /// What the printers are doing.
    #[must_use]
    pub fn all(&self) -> Vec<Live> {
        self.lives.borrow().clone()
    }

    /// What one of them is doing.
    #[must_use]
    pub fn find(&self, name: &Name) -> Option<Live> {
        self.lives.borrow().iter().find(|live| live.name == *name).cloned()
    }

    /// Asks a printer for something; done once it has said that it will.
    pub(super) async fn ask(&self, wish: WishOf) -> Result<(), Unheard> {
        let (answer, answered) = oneshot::channel();
        let WishOf { printer, job, wish, by, why } = wish;
        if self.find(&printer).is_none() {
            return Err(Unheard::NoPrinter { printer });
        }
        let wished = Wished { printer, job, wish, by, why, answer };
        self.wishes.try_send(wished).map_err(|_full_or_closed| Unheard::NoAnswer)?;
        let answered = tokio::time::timeout(PATIENCE, answered).await;
        answered.map_err(|_late| Unheard::NoAnswer)?.map_err(|_dropped| Unheard::NoAnswer)?
    }
}

/// A [`Wished`] without the way back.
#[derive(Debug)]
pub(super) struct WishOf {
    pub(super) printer: Name,
    pub(super) job: Option<JobId>,
    pub(super) wish: Wish,
    pub(super) by: Name,
    pub(super) why: Reason,
}

/// Everything the faces need. Clones are the same.
#[derive(Debug, Clone)]
pub struct Appliance<S> {
    /// The queue.
    pub store: S,
    /// The printers.
    pub printers: Printers,
    /// Where files of jobs are kept.
    pub files: Files,
    /// Who may ask over TCP.
    pub keys: Keys,
    /// Cases, where this server works on some.
    pub cases: Option<Cases>,
    /// What happens.
    pub events: Events,
    /// What was done since the start.
    pub counters: Counters,
    /// The clock.
    pub clock: fn() -> Timestamp,
    started: Timestamp,
    /// The job that a client of the OctoPrint part has selected; gone with the process, as there.
    selected: Arc<Mutex<Option<JobId>>>,
}

impl<S: Store> Appliance<S> {
    /// Of its parts.
    #[must_use]
    pub fn new(store: S, printers: Printers, files: Files, keys: Keys) -> Self {
        let events = Events::default();
        Self {
            store,
            printers,
            files,
            keys,
            cases: None,
            events,
            counters: Counters::default(),
            clock: Timestamp::now,
            started: Timestamp::now(),
            selected: Arc::default(),
        }
    }

    /// The time.
    pub(super) fn now(&self) -> Timestamp {
        (self.clock)()
    }

    pub(super) const fn started(&self) -> Timestamp {
        self.started
    }

    pub(super) fn selected(&self) -> Option<JobId> {
        *self.selected.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn select(&self, job: Option<JobId>) {
        *self.selected.lock().unwrap_or_else(PoisonError::into_inner) = job;
    }

    /// A new name for a job.
    pub(super) fn new_id(&self) -> Result<JobId, getrandom::Error> {
        let mut chance = [0; 10];
        getrandom::fill(&mut chance)?;
        Ok(JobId::at(self.now(), chance))
    }
}
