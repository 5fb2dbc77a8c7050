//! The only code that touches a port: reads, feeds the session, writes what it gives, keeps its time.
//!
//! One task, one loop. Bytes are written in as few calls as the core's window allows; events go out over a bounded
//! channel, and a listener that is slow loses progress and temperatures, never a fault, and never holds up the
//! print. The journal is another thread's, and nothing here ever waits for it but by looking now and then whether it is
//! done. The task reads the job from its file as it goes; that is the page cache's business, not the disk's. A port that vanished
//! is tried again a few times a second, as long as the session waits for it.

use super::Error;
use super::control::Controls;
use super::job::Job;
use super::journal::writer::{Flush, Journal};
use super::link::Link;
use super::protocol::{Event, Fault, Instant, Stats};
use super::session::{End, Session, Start};
use crate::profile::Profile;
use crate::progress::CancelToken;
use std::collections::VecDeque;
use std::io::{BufRead, Seek};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::sync::mpsc;
use tokio::time::MissedTickBehavior;

pub use super::session::PrintEvent;

/// How exactly time-outs are kept and how soon what the operator asks for is seen.
const TICK: Duration = Duration::from_millis(20);

/// Progress is told every so many ticks.
const TICKS_PER_PROGRESS: u32 = 5;

/// Between two attempts to open a port that vanished.
const KNOCK: Duration = Duration::from_millis(200);

/// How long heaters-off may take to be written after a fault.
const LAST_WORDS: Duration = Duration::from_secs(2);

/// How long the end of a print waits for its last records to reach the disk.
const LAST_FLUSH: Duration = Duration::from_secs(3);

/// Events kept for a listener that does not listen; beyond that the oldest message is dropped.
const MAX_PENDING_EVENTS: usize = 1024;

/// A print that was done.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Printed {
    /// Lines of the job, each executed once but for the next ones.
    pub n_lines: u64,
    /// Lines that may have been executed twice, after a reset; 0 for any other print.
    pub n_twice: u64,
    /// What happened on the wire.
    pub stats: Stats,
    /// From greeting to proof.
    pub elapsed: Duration,
}

/// A print to be done.
#[derive(Debug)]
pub struct Order<R> {
    /// The job.
    pub job: Job<R>,
    /// Where it begins.
    pub start: Start,
    /// Where it is written down.
    pub journal: Option<Journal>,
    /// What the operator asks for meanwhile.
    pub controls: Controls,
}

/// Sends `job` over `link` and waits until the printer says that all of it is executed; no journal is kept.
///
/// # Errors
/// As [`run`].
pub async fn print<R: BufRead + Seek, L: Link>(
    job: Job<R>,
    link: L,
    profile: &Profile,
    events: &mpsc::Sender<PrintEvent>,
    cancel: &CancelToken,
) -> Result<Printed, Error> {
    let order = Order { job, start: Start::Fresh, journal: None, controls: Controls::default() };
    run(order, link, profile, events, cancel).await
}

/// Prints, or goes on with a print, and waits until the printer says that all of it is executed.
///
/// # Errors
/// [`Error::Open`], [`Error::PortVanished`], [`Error::Fault`], [`Error::Cancelled`], which tells whether heaters-off was confirmed,
/// [`Error::Job`] if the job's file changed meanwhile (the print is cancelled first); for a print that is resumed also
/// [`Error::NeedsConsent`], nothing having been sent, and [`Error::Refused`], the heaters having been switched off.
pub async fn run<R: BufRead + Seek, L: Link>(
    order: Order<R>,
    mut link: L,
    profile: &Profile,
    events: &mpsc::Sender<PrintEvent>,
    cancel: &CancelToken,
) -> Result<Printed, Error> {
    let port = link.name().to_owned();
    let stream = link.open().await?;
    let clock = Clock::start();
    let is_fresh = matches!(order.start, Start::Fresh);
    let mut session = Session::new(order.job, profile, order.start, clock.now());
    if is_fresh && order.controls.is_laying_held() {
        session.hold_laying();
    }
    let _hearing = order.controls.hear();
    let mut driver = Driver::new(session, order.journal, clock, events, cancel);
    driver.controls = order.controls;
    let end = driver.serve(stream, &mut link).await;
    let n_lines = driver.session.n_lines();
    let heat = driver.session.heat().clone();
    match end {
        End::Finished => {
            let (n_twice, stats) = (driver.session.n_twice(), driver.session.stats());
            Ok(Printed { n_lines, n_twice, stats, elapsed: driver.clock.elapsed() })
        }
        End::Job(error) => Err(error.into()),
        End::Cancelled | End::CancelUnconfirmed => Err(Error::Cancelled { heat }),
        End::Left => Err(Error::Left { port, heat }),
        End::Faulted(Fault::LinkLost) => Err(Error::PortVanished { port }),
        End::Faulted(fault) => Err(Error::Fault { port, fault, heat }),
        End::NeedsConsent(recovery) => Err(Error::NeedsConsent { recovery, heat }),
        End::Refused(refusal) => Err(Error::Refused { refusal, heat }),
    }
}

struct Driver<'a, R> {
    session: Session<R>,
    journal: Option<Journal>,
    clock: Clock,
    /// Bytes for the port, from `n_written` on.
    out: Vec<u8>,
    n_written: usize,
    n_ticks: u32,
    ticked: Instant,
    events: &'a mpsc::Sender<PrintEvent>,
    pending: VecDeque<PrintEvent>,
    cancel: &'a CancelToken,
    is_cancelled: bool,
    controls: Controls,
    /// What the session waits for to be on the disk, and the answer to come.
    flush: Option<(u64, Flush)>,
    journal_fails: bool,
}

impl<'a, R: BufRead + Seek> Driver<'a, R> {
    fn new(
        mut session: Session<R>,
        journal: Option<Journal>,
        clock: Clock,
        events: &'a mpsc::Sender<PrintEvent>,
        cancel: &'a CancelToken,
    ) -> Self {
        if journal.is_some() {
            session.keep_journal();
        }
        Self {
            session,
            journal,
            ticked: clock.now(),
            clock,
            out: Vec::new(),
            n_written: 0,
            n_ticks: 0,
            events,
            pending: VecDeque::new(),
            cancel,
            is_cancelled: false,
            controls: Controls::default(),
            flush: None,
            journal_fails: false,
        }
    }

    async fn serve<L: Link>(&mut self, stream: L::Stream, link: &mut L) -> End {
        let mut stream = Some(stream);
        while !self.session.is_over() {
            match stream.take() {
                Some(open) => self.converse(open).await,
                None => stream = self.knock(link).await,
            }
        }
        self.record();
        let last = self.session.progress();
        self.tell(last);
        self.deliver();
        self.await_journal().await;
        self.session.take_end().expect("a session that is over has an end")
    }

    /// The last records are on the disk before the end is told, unless the disk does not answer.
    async fn await_journal(&mut self) {
        let Some(journal) = &self.journal else { return };
        let limit = self.clock.now() + LAST_FLUSH;
        let mut flush = None;
        while self.clock.now() < limit {
            flush = flush.or_else(|| journal.ask_flush());
            if flush.as_ref().and_then(Flush::outcome).is_some() {
                return;
            }
            tokio::time::sleep(TICK).await;
        }
    }

    /// Talks until the session is over or the port is gone.
    async fn converse(&mut self, stream: impl AsyncRead + AsyncWrite + Unpin) {
        let (mut reader, mut writer) = tokio::io::split(stream);
        let mut ticks = tokio::time::interval(TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let mut buffer = vec![0; 16 * 1024];
        while !self.session.wants_port() {
            // Where a port is flooded there is always something to read, and the runtime never gets to its timers.
            if self.clock.now().since(self.ticked) > TICK * 2 {
                self.tick();
            }
            self.exchange();
            if self.session.is_over() {
                self.say_last_words(&mut writer).await;
                return;
            }
            tokio::select! {
                biased;
                _ = ticks.tick() => self.tick(),
                written = writer.write(&self.out[self.n_written..]), if !self.out.is_empty() => match written {
                    Ok(n) if n > 0 => self.wrote(n),
                    _ => self.lost(),
                },
                read = reader.read(&mut buffer) => match read {
                    Ok(n) if n > 0 => self.session.handle_bytes(self.clock.now(), &buffer[..n]),
                    _ => self.lost(),
                },
            }
        }
    }

    /// Tries to open the port again, once.
    async fn knock<L: Link>(&mut self, link: &mut L) -> Option<L::Stream> {
        tokio::time::sleep(KNOCK).await;
        self.tick();
        self.exchange();
        if !self.session.wants_port() {
            return None;
        }
        // Why it does not open now does not matter: it is tried until the session gives up.
        let stream = link.open().await.ok()?;
        self.session.handle_port(self.clock.now());
        Some(stream)
    }

    /// Takes from the session what it has to say.
    fn exchange(&mut self) {
        loop {
            let is_told = self.record();
            self.session.transmit(&mut self.out);
            if !is_told || !self.session.has_records() {
                break;
            }
        }
        while let Some(event) = self.session.poll_event() {
            self.tell(event);
        }
    }

    /// Hands records to the journal; never waits. False where it takes no more for now.
    fn record(&mut self) -> bool {
        while let Some(record) = self.session.poll_record() {
            if self.journal.as_ref().is_some_and(|journal| !journal.append(&record)) {
                self.session.not_written(record);
                return false;
            }
        }
        self.watch_flush();
        self.watch_journal();
        true
    }

    /// Tells the session what it waits for.
    fn watch_flush(&mut self) {
        let (Some(journal), Some(number)) = (&self.journal, self.session.awaits_disk()) else { return };
        if self.flush.as_ref().is_none_or(|(of, _)| *of != number) {
            self.flush = journal.ask_flush().map(|flush| (number, flush));
        }
        if let Some(is_written) = self.flush.as_ref().and_then(|(_, flush)| flush.outcome()) {
            self.flush = None;
            self.session.handle_flushed(self.clock.now(), number, is_written);
        }
    }

    /// Tells that the journal cannot be written, and that it can again: each once.
    fn watch_journal(&mut self) {
        let Some(failure) = self.journal.as_ref().map(Journal::failure) else { return };
        let was_failing = std::mem::replace(&mut self.journal_fails, failure.is_some());
        match failure {
            Some(why) if !was_failing => self.tell(PrintEvent::JournalFailed(why)),
            None if was_failing => self.tell(PrintEvent::JournalWorks),
            _ => {}
        }
    }

    fn wrote(&mut self, n_bytes: usize) {
        self.n_written += n_bytes;
        if self.n_written >= self.out.len() {
            self.out.clear();
            self.n_written = 0;
        }
    }

    fn lost(&mut self) {
        self.out.clear();
        self.n_written = 0;
        self.session.handle_lost(self.clock.now());
    }

    fn tick(&mut self) {
        let now = self.clock.now();
        self.ticked = now;
        self.n_ticks = self.n_ticks.wrapping_add(1);
        if self.session.poll_timeout().is_some_and(|due| due <= now) {
            self.session.handle_timeout(now);
        }
        if self.cancel.is_cancelled() && !self.is_cancelled {
            self.is_cancelled = true;
            self.session.cancel(now);
        }
        while let Some(control) = self.controls.take() {
            self.session.control(now, control);
        }
        if self.session.asks_to_lay() && !self.controls.is_laying_held() {
            self.session.let_lay();
        }
        if self.n_ticks.is_multiple_of(TICKS_PER_PROGRESS) && self.session.is_printing() {
            let progress = self.session.progress();
            self.tell(progress);
        }
        self.deliver();
    }

    /// Hands an event to the listener, or keeps it if it must not be lost and there is no room.
    fn tell(&mut self, event: PrintEvent) {
        let may_be_lost = matches!(
            event,
            PrintEvent::Progress { .. } | PrintEvent::Session(Event::Temperatures(_) | Event::Busy(_))
        );
        if self.pending.is_empty() {
            match self.events.try_send(event) {
                Err(mpsc::error::TrySendError::Full(event)) if !may_be_lost => self.pending.push_back(event),
                _ => {}
            }
        } else if !may_be_lost {
            self.pending.push_back(event);
            if self.pending.len() > MAX_PENDING_EVENTS {
                self.drop_oldest_message();
            }
        }
    }

    fn drop_oldest_message(&mut self) {
        let is_message = |e: &PrintEvent| matches!(e, PrintEvent::Session(Event::Message(_)));
        let oldest = self.pending.iter().position(is_message).unwrap_or(0);
        self.pending.remove(oldest);
    }

    fn deliver(&mut self) {
        while let Some(event) = self.pending.pop_front() {
            if let Err(mpsc::error::TrySendError::Full(event)) = self.events.try_send(event) {
                self.pending.push_front(event);
                return;
            }
        }
    }

    /// Writes what is left, heaters-off after a fault, but does not wait for ever.
    async fn say_last_words(&mut self, writer: &mut (impl AsyncWrite + Unpin)) {
        self.exchange();
        let words = async {
            writer.write_all(&self.out[self.n_written..]).await?;
            writer.flush().await
        };
        // The job has ended one way or the other; a port that takes nothing any more changes nothing about it.
        drop(tokio::time::timeout(LAST_WORDS, words).await);
    }
}

/// The driver's clock: the only one in this room.
#[derive(Debug, Clone, Copy)]
pub(super) struct Clock(tokio::time::Instant);

impl Clock {
    pub(super) fn start() -> Self {
        Self(tokio::time::Instant::now())
    }

    fn elapsed(&self) -> Duration {
        self.0.elapsed()
    }

    pub(super) fn now(&self) -> Instant {
        Instant::after(self.elapsed())
    }
}

#[cfg(test)]
mod tests;
