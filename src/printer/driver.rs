//! The only code that touches a port: reads, feeds the core, writes what it gives, keeps its time.
//!
//! One task, one loop. Bytes are written in as few calls as the core's window allows; events go out over a bounded
//! channel, and a listener that is slow loses progress and temperatures, never a fault, and never holds up the
//! print. The task reads the job from its file as it goes; that is the page cache's business, not the disk's.

use super::Error;
use super::job::{self, Job};
use super::link::Link;
use super::protocol::{Command, Core, Event, Fault, Instant, LineSplitter, State, Stats};
use crate::profile::Profile;
use crate::progress::CancelToken;
use std::collections::VecDeque;
use std::io::{BufRead, Seek};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::sync::mpsc;
use tokio::time::MissedTickBehavior;

/// How exactly time-outs are kept and how soon a request to cancel is seen.
const TICK: Duration = Duration::from_millis(20);

/// Progress is told every so many ticks.
const TICKS_PER_PROGRESS: u32 = 5;

/// How long heaters-off may take to be written after a fault.
const LAST_WORDS: Duration = Duration::from_secs(2);

/// Events kept for a listener that does not listen; beyond that the oldest message is dropped.
const MAX_PENDING_EVENTS: usize = 1024;

/// What a print tells while it runs.
#[derive(Debug, Clone, PartialEq)]
pub enum PrintEvent {
    /// What the session tells.
    Session(Event),
    /// How far the job is.
    Progress {
        /// Lines acknowledged.
        n_lines_done: u64,
        /// Lines in all.
        n_lines: u64,
    },
}

/// A print that was done.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Printed {
    /// Lines of the job, each executed once.
    pub n_lines: u64,
    /// What happened on the wire.
    pub stats: Stats,
    /// From greeting to proof.
    pub elapsed: Duration,
}

/// Sends `job` over `link` and waits until the printer says that all of it is executed.
///
/// # Errors
/// [`Error::PortVanished`], [`Error::Fault`], [`Error::Cancelled`] once heaters-off is confirmed, [`Error::Job`] if the job's
/// file changed meanwhile (the print is cancelled first).
pub async fn print<R: BufRead + Seek, L: Link>(
    job: Job<R>,
    link: L,
    profile: &Profile,
    events: &mpsc::Sender<PrintEvent>,
    cancel: &CancelToken,
) -> Result<Printed, Error> {
    let port = link.name().to_owned();
    let n_lines = job.n_lines();
    let mut session = Session::new(job, profile, events, cancel);
    session.command(Command::Connect);
    let end = session.run(link.into_stream()).await;
    session.tell(PrintEvent::Progress { n_lines_done: session.core.progress().n_lines_done, n_lines });
    session.deliver();
    match (end, session.job_error.take()) {
        (End::Finished, _) => {
            Ok(Printed { n_lines, stats: session.core.stats(), elapsed: session.clock.elapsed() })
        }
        (End::Cancelled, Some(error)) => Err(error.into()),
        (End::Cancelled, None) => Err(Error::Cancelled),
        (End::Faulted(Fault::LinkLost), _) => Err(Error::PortVanished { port }),
        (End::Faulted(fault), _) => Err(Error::Fault { port, fault }),
    }
}

enum End {
    Finished,
    Cancelled,
    Faulted(Fault),
}

struct Session<'a, R> {
    core: Core,
    job: Job<R>,
    job_error: Option<job::Error>,
    clock: Clock,
    splitter: LineSplitter,
    /// Bytes for the port, from `n_written` on.
    out: Vec<u8>,
    n_written: usize,
    end: Option<End>,
    events: &'a mpsc::Sender<PrintEvent>,
    pending: VecDeque<PrintEvent>,
    cancel: &'a CancelToken,
}

impl<'a, R: BufRead + Seek> Session<'a, R> {
    fn new(
        job: Job<R>,
        profile: &Profile,
        events: &'a mpsc::Sender<PrintEvent>,
        cancel: &'a CancelToken,
    ) -> Self {
        Self {
            core: Core::new(profile),
            job,
            job_error: None,
            clock: Clock::start(),
            splitter: LineSplitter::default(),
            out: Vec::new(),
            n_written: 0,
            end: None,
            events,
            pending: VecDeque::new(),
            cancel,
        }
    }

    async fn run(&mut self, stream: impl tokio::io::AsyncRead + tokio::io::AsyncWrite + Unpin) -> End {
        let (mut reader, mut writer) = tokio::io::split(stream);
        let mut ticks = tokio::time::interval(TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let mut n_ticks = 0_u32;
        let mut buffer = vec![0; 16 * 1024];
        loop {
            self.exchange();
            if let Some(end) = self.end.take() {
                self.say_last_words(&mut writer).await;
                return end;
            }
            tokio::select! {
                biased;
                written = writer.write(&self.out[self.n_written..]), if !self.out.is_empty() => match written {
                    Ok(n) if n > 0 => self.wrote(n),
                    _ => self.lost(),
                },
                read = reader.read(&mut buffer) => match read {
                    Ok(n) if n > 0 => self.heard(&buffer[..n]),
                    _ => self.lost(),
                },
                _ = ticks.tick() => {
                    n_ticks = n_ticks.wrapping_add(1);
                    self.tick(n_ticks.is_multiple_of(TICKS_PER_PROGRESS));
                }
            }
        }
    }

    /// Drains the core, and feeds it until it wants no more.
    fn exchange(&mut self) {
        loop {
            while let Some(line) = self.core.poll_transmit() {
                self.out.extend_from_slice(line.bytes);
            }
            while let Some(event) = self.core.poll_event() {
                self.on_event(event);
            }
            if !self.feed() {
                return;
            }
        }
    }

    /// Gives the core the next lines of the job; false if it wants none.
    fn feed(&mut self) -> bool {
        if !self.core.wants_line() {
            return false;
        }
        let now = self.clock.now();
        while self.core.wants_line() {
            let command = match self.job.next_command() {
                Ok(Some(line)) => Command::Line(line),
                Ok(None) => Command::EndOfJob,
                Err(error) => {
                    self.job_error = Some(error);
                    Command::Cancel
                }
            };
            self.core.handle_command(now, command).expect("a core that wants lines takes these commands");
        }
        true
    }

    /// A command whose refusal means that it is too late for it.
    fn command(&mut self, command: Command<'_>) {
        self.core.handle_command(self.clock.now(), command).ok();
    }

    fn heard(&mut self, bytes: &[u8]) {
        let now = self.clock.now();
        let Self { splitter, core, out, .. } = self;
        let mut events = Vec::new();
        splitter.feed(bytes, |line| {
            core.handle_line(now, line);
            while let Some(line) = core.poll_transmit() {
                out.extend_from_slice(line.bytes);
            }
            events.extend(std::iter::from_fn(|| core.poll_event()));
        });
        for event in events {
            self.on_event(event);
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
        self.splitter.clear();
        self.core.handle_disconnect(self.clock.now());
        if matches!(self.core.state(), State::Disconnected) {
            self.end = Some(End::Faulted(Fault::LinkLost));
        }
    }

    fn tick(&mut self, tells_progress: bool) {
        let now = self.clock.now();
        if self.core.poll_timeout().is_some_and(|due| due <= now) {
            self.core.handle_timeout(now);
            self.exchange();
        }
        if self.cancel.is_cancelled() && !matches!(self.core.state(), State::Cancelling) {
            self.command(Command::Cancel);
        }
        if tells_progress && matches!(self.core.state(), State::Streaming | State::Finishing) {
            let n_lines_done = self.core.progress().n_lines_done;
            self.tell(PrintEvent::Progress { n_lines_done, n_lines: self.job.n_lines() });
        }
        self.deliver();
    }

    fn on_event(&mut self, event: Event) {
        match &event {
            Event::Connected => self.command(Command::Begin),
            Event::Finished => self.end = Some(End::Finished),
            Event::Cancelled => self.end = Some(End::Cancelled),
            Event::Faulted(fault) => self.end = Some(End::Faulted(fault.clone())),
            _ => {}
        }
        self.tell(PrintEvent::Session(event));
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
    async fn say_last_words(&mut self, writer: &mut (impl tokio::io::AsyncWrite + Unpin)) {
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
struct Clock(tokio::time::Instant);

impl Clock {
    fn start() -> Self {
        Self(tokio::time::Instant::now())
    }

    fn elapsed(&self) -> Duration {
        self.0.elapsed()
    }

    fn now(&self) -> Instant {
        Instant::after(self.elapsed())
    }
}

#[cfg(test)]
mod tests;
