//! Which job is next and, where none is, why not; when each job ends.
//!
//! [`next`] is the rule by which a printer draws: the first job, by priority and place, that is ready, due and fits. What does not fit
//! is passed over and holds nothing up. [`plan`] lets every printer draw by this rule, from the estimates, on a clock of its
//! own; a printer draws again as soon as its bed can be expected to be clear. A job has one copy in print at a time.
//!
//! Jobs that are still to be prepared are reckoned with as if they were ready when their turn comes. Cost of a plan: copies times the
//! jobs that are passed over for each; so many copies at most that a plan stays small whatever is queued.

use super::fit::{self, Misfit};
use super::job::Job;
use super::printer::{Bed, Printer};
use super::state::State;
use super::{JobId, Name};
use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp};
use std::fmt;

/// Copies in a plan: more than anybody looks at.
pub const MOST_SLOTS: usize = 4096;

/// What stands in the way of all jobs that a printer could draw.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Obstacles {
    /// Jobs that are kept back.
    pub n_held: usize,
    /// Jobs that are not prepared yet.
    pub n_unprepared: usize,
    /// Jobs that another printer has, or that wait for a bed or a person.
    pub n_elsewhere: usize,
    /// Jobs that are not due, and when the first of them is.
    pub later: Option<(usize, Timestamp)>,
    /// Jobs that do not fit, and why the first of them does not.
    pub misfits: Option<(usize, JobId, Misfit)>,
}

/// Why a printer draws no job.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum WhyNot {
    /// It is printing.
    #[error("{printer} is printing job {job}")]
    Printing {
        /// The printer.
        printer: Name,
        /// The job.
        job: JobId,
    },
    /// What was printed lies there.
    #[error(
        "the bed of {printer} is not clear of job {job}: take the part off and say so with `lumenfab queue clear-bed`"
    )]
    BedTaken {
        /// The printer.
        printer: Name,
        /// The job.
        job: JobId,
    },
    /// Nobody knows.
    #[error(
        "whether the bed of {printer} is clear is not known: look, and say so with `lumenfab queue clear-bed`"
    )]
    BedUnknown {
        /// The printer.
        printer: Name,
    },
    /// There is no job.
    #[error("the queue is empty")]
    Empty,
    /// There are jobs, but none that can begin.
    #[error("no job can begin: {0}")]
    Obstacles(Box<Obstacles>),
}

impl fmt::Display for Obstacles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let count = |n: usize, words: &str| (n > 0).then(|| format!("{n} {words}"));
        let later = self.later.map(|(n, at)| format!("{n} not due before {at}"));
        let misfits =
            self.misfits.as_ref().map(|(n, job, why)| format!("{n} that do not fit (job {job}: {why})"));
        let all = [
            count(self.n_held, "held"),
            count(self.n_unprepared, "not prepared yet"),
            later,
            misfits,
            count(self.n_elsewhere, "in print or waiting for somebody"),
        ];
        f.write_str(&all.into_iter().flatten().collect::<Vec<_>>().join(", "))
    }
}

/// The job that a printer draws, of those in the order of the queue.
///
/// # Errors
/// [`WhyNot`] where there is none.
pub fn next<'a>(printer: &Printer, jobs: &'a [Job], now: Timestamp) -> Result<&'a Job, WhyNot> {
    check_bed(printer, jobs)?;
    let mut obstacles = Obstacles::default();
    for job in jobs {
        if obstacles.take(printer, job, now) {
            return Ok(job);
        }
    }
    Err(if obstacles == Obstacles::default() {
        WhyNot::Empty
    } else {
        WhyNot::Obstacles(Box::new(obstacles))
    })
}

fn check_bed(printer: &Printer, jobs: &[Job]) -> Result<(), WhyNot> {
    let name = printer.name.clone();
    match printer.bed {
        Bed::Clear => Ok(()),
        Bed::Unknown => Err(WhyNot::BedUnknown { printer: name }),
        Bed::Taken(id) if jobs.iter().any(|job| job.state.is_at_printer() && job.is_on(&name)) => {
            Err(WhyNot::Printing { printer: name, job: id })
        }
        Bed::Taken(id) => Err(WhyNot::BedTaken { printer: name, job: id }),
    }
}

impl Obstacles {
    /// Whether a job can begin; if not, it is counted.
    fn take(&mut self, printer: &Printer, job: &Job, now: Timestamp) -> bool {
        match (job.state, &job.made, job.wishes.not_before) {
            (State::Draft | State::Finished | State::Failed | State::Cancelled, ..) => {}
            (State::Held, ..) => self.n_held += 1,
            (State::Preparing, ..) | (State::Queued, None, _) => self.n_unprepared += 1,
            (State::Queued, _, Some(at)) if now < at => self.take_later(at),
            (State::Queued, Some(made), _) => {
                match fit::check(&made.needs, &made.estimate, printer.loaded.as_ref()) {
                    Ok(()) => return true,
                    Err(misfit) => self.take_misfit(job.id, misfit),
                }
            }
            (State::Printing | State::Paused | State::AwaitingBedClear | State::AwaitingSignOff, ..) => {
                self.n_elsewhere += 1;
            }
        }
        false
    }

    fn take_later(&mut self, at: Timestamp) {
        let (n, first) = self.later.unwrap_or((0, at));
        self.later = Some((n + 1, first.min(at)));
    }

    fn take_misfit(&mut self, job: JobId, misfit: Misfit) {
        match &mut self.misfits {
            Some((n, ..)) => *n += 1,
            none @ None => *none = Some((1, job, misfit)),
        }
    }
}

/// A printer as a plan begins.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lane {
    /// The printer.
    pub printer: Printer,
    /// When what it prints will end, where it prints.
    pub ends: Option<Timestamp>,
    /// How long it takes from the end of a copy until its bed can be expected to be clear, s.
    pub clearing_s: u32,
}

/// A copy in a plan.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Slot {
    /// The job.
    pub job: JobId,
    /// Which copy, from 1.
    pub copy: u16,
    /// The printer.
    pub printer: Name,
    /// When it begins; for one that is in print, the time of the plan.
    pub starts: Timestamp,
    /// When it ends.
    pub ends: Timestamp,
}

/// Why a job, or some of its copies, has no place in a plan.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Unplanned {
    /// It is a draft or kept back, or a printer has it that the plan does not know.
    #[error("it is {0}")]
    NotQueued(State),
    /// Nobody knows how long it takes.
    #[error("how long it takes is known once it is prepared")]
    NoEstimate,
    /// No printer fits, the last one for this reason.
    #[error(transparent)]
    Misfit(Misfit),
    /// There is no printer.
    #[error("there is no printer")]
    NoPrinter,
    /// As many copies as are planned come before it.
    #[error("too many copies come before it: {MOST_SLOTS} are planned ahead")]
    TooFar,
}

/// When each job ends.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Plan {
    /// Copies, by the time at which they begin.
    pub slots: Vec<Slot>,
    /// What has no place.
    pub unplanned: Vec<(JobId, Unplanned)>,
}

impl Plan {
    /// When a job's last copy ends.
    #[must_use]
    pub fn end_of(&self, job: JobId) -> Option<Timestamp> {
        self.slots.iter().filter(|slot| slot.job == job).map(|slot| slot.ends).max()
    }

    /// When everything is printed, as far as it has a place.
    #[must_use]
    pub fn end(&self) -> Option<Timestamp> {
        self.slots.iter().map(|slot| slot.ends).max()
    }

    /// "the last job ends Thursday 04:10", on the clocks of a place; with the date where it is six days away or more.
    #[must_use]
    pub fn end_words(&self, now: Timestamp, place: &TimeZone) -> Option<String> {
        let end = self.end()?;
        let is_near = end.duration_since(now) < SignedDuration::from_hours(6 * 24);
        let format = if is_near { "%A %H:%M" } else { "%A %-d %B %Y %H:%M" };
        Some(format!("the last job ends {}", end.to_zoned(place.clone()).strftime(format)))
    }
}

/// A job in the making of a plan.
struct Waiting<'a> {
    job: &'a Job,
    /// Copies that have no place yet.
    n_left: u16,
    /// Its next copy does not begin before.
    from: Timestamp,
}

/// A printer in the making of a plan.
struct Drawing {
    printer: Printer,
    from: Timestamp,
    clearing_s: u32,
}

/// Lets all printers draw from the queue, whose jobs come in its order.
#[must_use]
pub fn plan(lanes: &[Lane], jobs: &[Job], now: Timestamp) -> Plan {
    let mut plan = Plan::default();
    let mut waiting = plan.begin(lanes, jobs, now);
    let mut drawing: Vec<Drawing> = lanes.iter().map(|lane| lane.drawing(now)).collect();
    let mut n_done = 0;
    let mut is_full = false;
    while let Some(idx) = (0..drawing.len()).min_by_key(|&idx| drawing[idx].from) {
        is_full = plan.slots.len() >= MOST_SLOTS;
        if is_full {
            break;
        }
        n_done += waiting[n_done..].iter().take_while(|w| w.n_left == 0).count();
        match drawing[idx].draw(&mut waiting[n_done..]) {
            Some(Draw::Copy(slot)) => plan.slots.push(slot),
            Some(Draw::Later(from)) => drawing[idx].from = from,
            None => drop(drawing.remove(idx)),
        }
    }
    for left in waiting.iter().filter(|w| w.n_left > 0) {
        let why = if is_full { Unplanned::TooFar } else { why_unplanned(left.job, lanes) };
        plan.unplanned.push((left.job.id, why));
    }
    plan.slots.sort_by_key(|slot| slot.starts);
    plan
}

fn why_unplanned(job: &Job, lanes: &[Lane]) -> Unplanned {
    let Some(estimate) = job.estimate() else { return Unplanned::NoEstimate };
    let mut checked = lanes.iter().map(|l| fit::check(job.needs(), &estimate, l.printer.loaded.as_ref()));
    match checked.next_back() {
        None => Unplanned::NoPrinter,
        Some(Err(misfit)) => Unplanned::Misfit(misfit),
        // It fits as the printer is now, but the jobs before it will have emptied the spool.
        Some(Ok(())) => Unplanned::Misfit(Misfit::Filament {
            needed_mm3: estimate.filament_mm3.saturating_mul(job.n_left().into()),
            left_mm3: lanes.iter().filter_map(|l| l.printer.loaded.as_ref()?.left_mm3).max().unwrap_or(0),
        }),
    }
}

impl Plan {
    /// What is in print already gets its place; what can never get one is told.
    fn begin<'a>(&mut self, lanes: &[Lane], jobs: &'a [Job], now: Timestamp) -> Vec<Waiting<'a>> {
        let mut waiting = Vec::with_capacity(jobs.len());
        for job in jobs.iter().filter(|job| !job.state.is_over() && job.state != State::AwaitingSignOff) {
            if matches!(job.state, State::Draft | State::Held) {
                self.unplanned.push((job.id, Unplanned::NotQueued(job.state)));
                continue;
            }
            let lane = lanes.iter().find(|lane| job.is_on(&lane.printer.name));
            let is_on_a_bed = job.state.is_at_printer() || job.state == State::AwaitingBedClear;
            if is_on_a_bed && lane.is_none() && job.n_left() > 0 {
                self.unplanned.push((job.id, Unplanned::NotQueued(job.state)));
                continue;
            }
            let n_in_print = u16::from(job.state.is_at_printer());
            let from = lane.map_or(now, |lane| lane.free_from(now)).max(job.wishes.not_before.unwrap_or(now));
            waiting.push(Waiting { job, n_left: job.n_left().saturating_sub(n_in_print), from });
            if let Some(lane) = lane.filter(|_| n_in_print > 0) {
                let ends = lane.ends.unwrap_or(now);
                let (printer, copy) = (lane.printer.name.clone(), job.n_printed + 1);
                self.slots.push(Slot { job: job.id, copy, printer, starts: now, ends });
            }
        }
        waiting
    }
}

impl Lane {
    /// When its bed can be expected to be clear.
    fn free_from(&self, now: Timestamp) -> Timestamp {
        match self.printer.bed {
            Bed::Clear => now,
            Bed::Unknown | Bed::Taken(_) => later(self.ends.unwrap_or(now).max(now), self.clearing_s),
        }
    }

    fn drawing(&self, now: Timestamp) -> Drawing {
        Drawing { printer: self.printer.clone(), from: self.free_from(now), clearing_s: self.clearing_s }
    }
}

/// What a printer draws.
enum Draw {
    Copy(Slot),
    /// Nothing before this time.
    Later(Timestamp),
}

impl Drawing {
    /// `None`: nothing any more.
    fn draw(&mut self, waiting: &mut [Waiting<'_>]) -> Option<Draw> {
        let fits = |w: &Waiting<'_>| w.n_left > 0 && self.fits(w.job);
        let Some(idx) = waiting.iter().position(|w| w.from <= self.from && fits(w)) else {
            return waiting.iter().filter(|w| fits(w)).map(|w| w.from).min().map(Draw::Later);
        };
        let first = &mut waiting[idx];
        let estimate = first.job.estimate()?;
        let (starts, ends) = (self.from, later(self.from, estimate.print_s));
        let copy = first.job.wishes.copies - first.n_left + 1;
        first.n_left -= 1;
        self.from = later(ends, self.clearing_s);
        first.from = self.from;
        let left_mm3 = self.printer.loaded.as_mut().and_then(|loaded| loaded.left_mm3.as_mut());
        if let Some(left_mm3) = left_mm3 {
            *left_mm3 = left_mm3.saturating_sub(estimate.filament_mm3);
        }
        let (job, printer) = (first.job.id, self.printer.name.clone());
        Some(Draw::Copy(Slot { job, copy, printer, starts, ends }))
    }

    fn fits(&self, job: &Job) -> bool {
        job.estimate().is_some_and(|e| fit::check(job.needs(), &e, self.printer.loaded.as_ref()).is_ok())
    }
}

fn later(at: Timestamp, seconds: u32) -> Timestamp {
    at.checked_add(SignedDuration::from_secs(seconds.into())).unwrap_or(Timestamp::MAX)
}

/// Jobs in the order of the queue.
pub fn sort(jobs: &mut [Job]) {
    jobs.sort_by(|a, b| a.order().cmp(&b.order()));
}
