//! One print from greeting to proof, over all that may break off in between: pure, on any clock.
//!
//! The session owns the protocol core, the job and what goes into the journal; bytes, time, and the coming and going of the port go
//! in, bytes, events, records and the next deadline come out. [`super::driver`] gives it a real port and a clock, tests a
//! simulated printer and a made-up one.
//!
//! **Contract.** After every `handle_*`, drain [`Session::poll_record`] first: a record that begins a session, or lets the height change
//! ([`Progress::z_allowed_to`](super::journal::Progress::z_allowed_to)), must be in the journal before anything more is sent. Then
//! [`Session::transmit`], and both again while it has left records ([`Session::has_records`]); then [`Session::poll_event`].
//!
//! When the port vanishes in the middle of the job, the session asks for it again ([`Session::wants_port`]) for
//! `orphan_hold_s`; then it asks the printer where it is and decides as [`super::resume`] does: exactly, or not at all. A
//! printer that has started anew meanwhile is never sent the job again.

mod disk;
mod feed;
mod hold;
mod survey;

use super::control::Control;
use super::error::JobLost;
use super::job::{self, Job};
use super::journal::recorder::Recorder;
use super::journal::{Ending, Record, Track};
use super::policy::{self, Action, Phase, Trouble};
use super::protocol::{Command, Core, Event, Fault, Heat, Instant, LineSplitter, State, Stats, Temperatures};
use super::resume::{Known, Recovery, Refusal, Survey};
use crate::profile::Profile;
use disk::Disk;
use std::collections::VecDeque;
use std::io::{BufRead, Seek};
use std::time::Duration;

/// Asked before a job: a profile of another firmware leaves out what keeps a print exact.
const WHICH_FIRMWARE: &str = "M115";

/// What the firmware calls itself, which the job waits for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Name {
    ToBeAsked,
    /// The question is sent; it is awaited until then.
    Asked(Instant),
    /// Or not told in time: then it is believed.
    Known,
}

/// Whether the job may lay material.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Laying {
    Free,
    /// Not yet; it has laid none.
    Held,
    /// The next line may lay some, and waits.
    Asked,
}

/// How many times the time for an answer the job waits for this one: on a bad wire it may come to be sent again.
const NAME_PATIENCE: u32 = 2;

/// What a print tells while it runs.
#[derive(Debug, Clone, PartialEq)]
pub enum PrintEvent {
    /// What the protocol tells.
    Session(Event),
    /// How far the job is.
    Progress {
        /// Lines acknowledged.
        n_lines_done: u64,
        /// Lines in all.
        n_lines: u64,
    },
    /// The port vanished; it is awaited.
    PortLost {
        /// For so long.
        hold: Duration,
    },
    /// The print goes on exactly where it was.
    WentOn {
        /// Behind this line of the job.
        n_lines_done: u64,
    },
    /// The operator has asked for something.
    Asked(Control),
    /// The operator has asked for something that changes nothing.
    NothingToDo(Control),
    /// The operator has asked again for a pause that begins when the printer has done what it has.
    StillPausing,
    /// The next line may lay material, and waits until that is allowed.
    AsksToLay,
    /// The journal cannot be written; the print goes on.
    JournalFailed(String),
    /// It can be written again.
    JournalWorks,
    /// The job's last word leaves heaters on.
    LeftHot {
        /// What the nozzle was set to, °C; 0 where it is off.
        hotend_c: f64,
        /// The bed.
        bed_c: f64,
    },
}

/// How a session ended.
#[derive(Debug)]
pub enum End {
    /// Every line is executed, and the printer says so.
    Finished,
    /// Given up on request; heaters-off is confirmed.
    Cancelled,
    /// Given up on request; [`Session::heat`] tells that the heaters are on, or that nobody knows.
    CancelUnconfirmed,
    /// Given up on request before anything was sent: the printer is as it was.
    Left,
    /// Given up; what is known of the heaters then tells [`Session::heat`].
    Faulted(Fault),
    /// The job cannot be read any more; the heaters were switched off.
    Job(JobLost),
    /// It can go on, but not exactly; nothing was sent, and the heaters are as they were.
    NeedsConsent(Box<Recovery>),
    /// It cannot go on; the heaters were switched off.
    Refused(Refusal),
}

/// How a session begins.
#[derive(Debug, Clone)]
pub enum Start {
    /// With the first line.
    Fresh,
    /// Where an earlier one broke off; after a reset only with the operator's consent.
    Resume {
        /// What the journal knows.
        known: Box<Known>,
        /// Whether recovery is allowed.
        after_reset: bool,
    },
}

#[derive(Debug)]
enum Stage {
    /// The printer is greeted; then these lines are sent before the job.
    Greeting {
        host_lines: Vec<String>,
    },
    /// The printer is asked what it has.
    Surveying {
        known: Box<Known>,
        survey: Survey,
        manner: Manner,
    },
    Printing,
    Detached {
        until: Instant,
        /// What was known when the port went, where it went again before the printer had said where it is.
        known: Option<Box<Known>>,
    },
    Over,
}

/// What is known, and allowed, when a printer is asked where it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Manner {
    /// The port was away within this session.
    Reattach {
        /// How long the port was waited for; it may go again.
        until: Instant,
    },
    /// An earlier session is resumed.
    Resume { after_reset: bool },
}

/// See the module.
#[derive(Debug)]
pub struct Session<R> {
    profile: Profile,
    core: Core,
    job: Job<R>,
    recorder: Recorder,
    stage: Stage,
    splitter: LineSplitter,
    records: VecDeque<Record>,
    events: VecDeque<PrintEvent>,
    end: Option<End>,
    stats: Stats,
    now: Instant,
    /// Why the job is being cancelled, where it is not the operator's wish.
    job_error: Option<job::Error>,
    /// Lines that may have been executed twice, after a reset.
    n_twice: u64,
    /// The operator, or the printer, wants a pause: also while the port is away.
    is_held: bool,
    /// The printer has paused by itself, and moves by itself in it.
    parks_itself: bool,
    /// What brings the nozzle back from where it waits.
    parked: Option<Vec<String>>,
    /// The firmware was told to throw moves away (M410): from then on the job says no more where it is, however this ends.
    is_cancelled: bool,
    disk: Disk,
    name: Name,
    laying: Laying,
    /// The record given out last was none of `records`.
    is_polled: bool,
    /// How it ends once the heaters are seen to.
    pending: Option<End>,
    heat: Heat,
    temperatures: Temperatures,
}

impl<R: BufRead + Seek> Session<R> {
    /// A session over a port that is open.
    #[must_use]
    pub fn new(job: Job<R>, profile: &Profile, start: Start, now: Instant) -> Self {
        let core = Core::new(profile);
        let mut session = Self {
            recorder: Recorder::fresh(profile.firmware.dialect, Track::default(), now),
            profile: profile.clone(),
            core,
            job,
            stage: Stage::Over,
            splitter: LineSplitter::default(),
            records: VecDeque::new(),
            events: VecDeque::new(),
            end: None,
            stats: Stats::default(),
            now,
            job_error: None,
            n_twice: 0,
            is_held: false,
            parks_itself: false,
            parked: None,
            is_cancelled: false,
            disk: Disk::default(),
            name: Name::Known,
            laying: Laying::Free,
            is_polled: false,
            pending: None,
            heat: Heat::default(),
            temperatures: Temperatures::default(),
        };
        match start {
            Start::Fresh => {
                session.stage = Stage::Greeting { host_lines: vec![WHICH_FIRMWARE.to_owned()] };
                session.name = Name::ToBeAsked;
                session.command(Command::Connect);
            }
            Start::Resume { known, after_reset } => {
                session.n_twice = known.track.n_twice;
                session.survey(*known, Manner::Resume { after_reset });
            }
        }
        session.settle();
        session
    }

    /// Bytes from the port.
    pub fn handle_bytes(&mut self, now: Instant, bytes: &[u8]) {
        self.now = now;
        let Self { splitter, core, .. } = self;
        splitter.feed(bytes, |line| core.handle_line(now, line));
        self.settle();
    }

    /// What is due is done.
    pub fn handle_timeout(&mut self, now: Instant) {
        self.now = now;
        if let Stage::Detached { until, .. } = self.stage {
            if until <= now {
                self.over(End::Faulted(Fault::LinkLost));
            }
        } else if self.core.poll_timeout().is_some_and(|due| due <= now) {
            self.core.handle_timeout(now);
        }
        self.disk_timeout();
        self.name_timeout();
        self.settle();
    }

    /// The port is gone.
    pub fn handle_lost(&mut self, now: Instant) {
        self.now = now;
        self.splitter.clear();
        if matches!(self.stage, Stage::Detached { .. } | Stage::Over) {
            return;
        }
        if self.pending.is_some() {
            self.core.handle_disconnect(now);
            self.settle();
            return;
        }
        let action = policy::action(self.phase(), Trouble::PortGone);
        if let Stage::Surveying { known, manner: Manner::Reattach { until }, .. } = &self.stage {
            // This core has counted nothing yet.
            self.stage = Stage::Detached { until: *until, known: Some(known.clone()) };
            return;
        }
        self.note_progress();
        self.is_held = self.core.state().is_paused();
        let hold = Duration::from_secs_f64(self.profile.firmware.orphan_hold_s);
        match action {
            Action::Await if !hold.is_zero() => {
                self.events.push_back(PrintEvent::PortLost { hold });
                self.stage = Stage::Detached { until: now + hold, known: None };
            }
            _ => self.over(End::Faulted(Fault::LinkLost)),
        }
    }

    /// The port is there again, the same device behind it.
    pub fn handle_port(&mut self, now: Instant) {
        self.now = now;
        let Stage::Detached { until, known } = &self.stage else { return };
        let manner = Manner::Reattach { until: *until };
        let known = known.as_deref().cloned().unwrap_or_else(|| Known {
            track: self.recorder.track().clone(),
            progress: self.recorder.progress(now, self.core.progress()),
            is_behind: false,
            // The hold is not over: heaters that are off were switched off by somebody, and it takes his word (`resume`) to heat
            // them again.
            away_s: None,
        });
        self.stats = self.stats.plus(self.core.stats());
        self.core = Core::new(&self.profile);
        self.survey(known, manner);
        self.settle();
    }

    /// Appends what is to be written to the port. May leave records behind, which are to be written down before it goes on.
    pub fn transmit(&mut self, out: &mut Vec<u8>) {
        while !self.waits_for_disk() {
            while let Some(line) = self.core.poll_transmit() {
                out.extend_from_slice(line.bytes);
            }
            if !self.feed() {
                return;
            }
        }
    }

    /// A record for the journal, if there is one.
    pub fn poll_record(&mut self) -> Option<Record> {
        if let Some(record) = self.records.pop_front() {
            self.is_polled = false;
            return Some(record);
        }
        self.is_polled = true;
        let is_printing = matches!(self.stage, Stage::Printing) && !self.is_cancelled;
        is_printing.then(|| self.recorder.poll(self.now, self.core.progress())).flatten()
    }

    /// Whether there are records that what is to be sent next may wait for.
    #[must_use]
    pub fn has_records(&self) -> bool {
        !self.records.is_empty()
    }

    /// The record given out last was not taken: it will come again.
    pub fn not_written(&mut self, record: Record) {
        if self.is_polled {
            self.recorder.not_written();
        } else {
            self.records.push_front(record);
        }
    }

    /// Something to tell, if there is anything.
    pub fn poll_event(&mut self) -> Option<PrintEvent> {
        self.events.pop_front()
    }

    /// When [`Self::handle_timeout`] is due.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        let due = match self.stage {
            Stage::Detached { until, .. } => Some(until),
            Stage::Over => return None,
            _ => self.core.poll_timeout(),
        };
        due.into_iter().chain(self.disk_due()).chain(self.name_due()).min()
    }

    /// Whether the port is to be opened again.
    #[must_use]
    pub const fn wants_port(&self) -> bool {
        matches!(self.stage, Stage::Detached { .. })
    }

    /// Whether the session has ended; what is to be transmitted and recorded still is.
    #[must_use]
    pub const fn is_over(&self) -> bool {
        self.end.is_some()
    }

    /// Whether what is to be sent ends the print: that never waits for anything.
    #[must_use]
    pub const fn is_giving_up(&self) -> bool {
        self.is_over() || matches!(self.phase(), Phase::Stopping)
    }

    /// How it ended.
    pub fn take_end(&mut self) -> Option<End> {
        self.end.take()
    }

    /// What is known of the heaters at the end.
    #[must_use]
    pub const fn heat(&self) -> &Heat {
        &self.heat
    }

    /// Lines of the job acknowledged, and in all.
    #[must_use]
    pub fn progress(&self) -> PrintEvent {
        let n_acked = self.recorder.track().n_job_lines(self.core.progress().n_acked);
        let n_lines = self.job.n_lines();
        PrintEvent::Progress { n_lines_done: n_acked.min(n_lines), n_lines }
    }

    /// Whether lines of the job are being sent.
    #[must_use]
    pub const fn is_printing(&self) -> bool {
        matches!(self.core.state(), State::Streaming | State::Finishing)
    }

    /// What happened on the wire.
    #[must_use]
    pub const fn stats(&self) -> Stats {
        self.stats.plus(self.core.stats())
    }

    /// Lines that may have been executed twice, because the print went on after a reset.
    #[must_use]
    pub const fn n_twice(&self) -> u64 {
        self.n_twice
    }

    /// Commands in the job.
    #[must_use]
    pub const fn n_lines(&self) -> u64 {
        self.job.n_lines()
    }

    const fn phase(&self) -> Phase {
        match &self.stage {
            _ if self.pending.is_some() => Phase::Stopping,
            Stage::Detached { .. } => Phase::Detached,
            Stage::Surveying { manner: Manner::Reattach { .. }, .. } => Phase::Returned,
            Stage::Greeting { .. } | Stage::Surveying { .. } | Stage::Over => Phase::Greeting,
            Stage::Printing => match self.core.state().phase() {
                // Between the greeting's end and the first line.
                Phase::Greeting => Phase::Printing,
                phase => phase,
            },
        }
    }

    /// A command whose refusal means that it is too late for it.
    fn command(&mut self, command: Command<'_>) {
        self.core.handle_command(self.now, command).ok();
    }

    fn settle(&mut self) {
        while let Some(event) = self.core.poll_event() {
            self.on_event(&event);
            self.events.push_back(PrintEvent::Session(event));
        }
        self.note_cancel();
    }

    /// A cancel goes into the journal as soon as it is given, and no progress behind it.
    fn note_cancel(&mut self) {
        let is_new = !self.is_cancelled && *self.core.state() == State::Cancelling;
        if is_new && matches!(self.stage, Stage::Printing) {
            self.note_progress();
            self.is_cancelled = true;
            self.records.push_back(Record::End(Ending::Cancelled));
        }
    }

    fn on_event(&mut self, event: &Event) {
        match event {
            Event::Connected => self.begin(),
            Event::Found(last) => self.found(*last),
            Event::Answered => self.answered(),
            Event::Position(position) => {
                if let Stage::Surveying { survey, .. } = &mut self.stage {
                    survey.position = Some(*position);
                }
            }
            Event::Temperatures(temperatures) => {
                self.temperatures = *temperatures;
                self.recorder.hear(*temperatures);
                if let Stage::Surveying { survey, .. } = &mut self.stage {
                    survey.temperatures = *temperatures;
                }
            }
            Event::Finished => self.over(End::Finished),
            Event::Cancelled => {
                self.heat = Heat::Obeyed;
                self.over(End::Cancelled);
            }
            Event::Faulted(fault) => self.pending = Some(End::Faulted(fault.clone())),
            Event::Secured(heat) => {
                self.heat = heat.clone();
                match self.pending.take() {
                    Some(End::Cancelled) if !heat.is_safe() => self.over(End::CancelUnconfirmed),
                    Some(end) => self.over(end),
                    None => {}
                }
            }
            Event::Paused => {
                self.paused();
                // It waits within a line of the job, or parks as it likes.
                let is_away = self.parks_itself || *self.core.state() != State::Paused;
                self.recorder.set_away(is_away && self.parked.is_none());
            }
            Event::Resumed => {
                self.resumed();
                self.recorder.set_away(false);
            }
            Event::Firmware(told) => self.hear_name(told),
            Event::Action(action) => {
                self.parks_itself = hold::parks_itself(action).unwrap_or(self.parks_itself);
            }
            _ => {}
        }
    }

    fn begin(&mut self) {
        let Stage::Greeting { host_lines } = &mut self.stage else { return };
        let host_lines = std::mem::take(host_lines);
        self.stage = Stage::Printing;
        let n_before = self.job.n_given();
        let prelude = self.core.prelude().iter().chain(&host_lines).cloned().collect();
        let track = Track { first_number: 1, prelude, n_before, n_twice: self.n_twice, ..Track::default() };
        self.write_first(Record::Session(track.clone()));
        let dialect = self.profile.firmware.dialect;
        let mut recorder = Recorder::fresh(dialect, track.clone(), self.now);
        if n_before > 0 {
            recorder = std::mem::replace(&mut self.recorder, recorder).on(track, self.now);
        }
        self.recorder = recorder;
        self.command(Command::Begin);
        for line in &host_lines {
            self.command(Command::HostLine(line));
        }
        if self.is_held {
            self.command(Command::Pause);
        }
    }

    /// It is over as soon as the heaters are seen to.
    fn switch_off(&mut self, end: End) {
        self.pending = Some(end);
        self.command(Command::HeatersOff);
    }

    /// The last numbers before the connection is forgotten.
    fn note_progress(&mut self) {
        if matches!(self.stage, Stage::Printing) && !self.is_cancelled {
            let progress = self.recorder.progress(self.now, self.core.progress());
            self.records.push_back(Record::Progress(progress));
        }
    }

    fn over(&mut self, end: End) {
        if matches!(self.stage, Stage::Over) {
            return;
        }
        self.note_progress();
        let is_of_this_print = matches!(
            self.stage,
            Stage::Printing
                | Stage::Detached { .. }
                | Stage::Surveying { manner: Manner::Reattach { .. }, .. }
        );
        let end = match (end, self.job_error.take()) {
            (End::Cancelled, Some(error)) => End::Job(error.into()),
            (end, _) => end,
        };
        if is_of_this_print && !self.is_cancelled {
            self.records.extend(ending(&end).map(Record::End));
        }
        self.stage = Stage::Over;
        self.heat = match (&end, std::mem::take(&mut self.heat)) {
            // Nothing was sent: what was heard last still holds.
            (End::NeedsConsent(_) | End::Left, _) => Heat::told(self.temperatures),
            (_, Heat::Unknown(None)) if self.temperatures.hotend.is_some() => {
                Heat::Unknown(Some(self.temperatures))
            }
            (_, heat) => heat,
        };
        self.end = Some(match end {
            End::Job(lost) => End::Job(JobLost { heat: self.heat.clone(), ..lost }),
            end => end,
        });
    }
}

/// What the journal keeps of an end.
fn ending(end: &End) -> Option<Ending> {
    match end {
        End::Finished => Some(Ending::Finished),
        End::Cancelled => Some(Ending::Cancelled),
        End::CancelUnconfirmed => Some(Ending::Faulted("printer.cancel_unconfirmed".to_owned())),
        End::Faulted(fault) => Some(Ending::Faulted(fault.code().to_owned())),
        End::Job(lost) => Some(Ending::Faulted(lost.source.code().to_owned())),
        End::NeedsConsent(_) | End::Refused(_) | End::Left => None,
    }
}

#[cfg(test)]
mod tests;
