//! Whether and where a print that broke off can go on.
//!
//! Pure: the journal, the job and what the printer says of itself go in, a decision comes out.
//!
//! - **Exactly**, where the firmware lives. It names its last line, which the journal's numbering leads back to a line of the
//!   job; and its position must be that of the job behind this line. Firmware without line numbers (Klipper) is found by its
//!   position alone: the one place behind the last line acknowledged where the job is there, filament included.
//! - **By recovery**, where it started anew, or has switched the heaters off: it knows nothing any more. Then the print goes on behind
//!   the last line that was certainly executed. What lies between that and the last line sent may be printed twice, nothing is
//!   left out; how much that is at most is said before. It needs the operator's word.
//! - **Not at all**, and says why.
//!
//! Not known here: whether somebody has moved the axes, or taken the part off.

mod doubt;
mod places;
mod recovery;
mod restore;
mod words;

pub(super) use places::may_be_repeated;
pub(super) use recovery::needs_height;
pub(super) use restore::warming;
pub use words::{Recovery, Refusal, Why};

use super::job::{self, Job};
use super::journal::{Log, Place, Progress, Track};
use super::protocol::{Heater, Position, Temperatures};
use super::replay::{Modal, Tail};
use crate::profile::Profile;
use doubt::Reach;
use std::io::{BufRead, Seek};

/// Lines that may have been sent since the journal's last record, where its end is missing, at most: what the fastest link
/// carries in a second.
const UNRECORDED_LINES: u64 = 60_000;
/// An `ok` may be taken for a line too many, by a few.
const DOUBTFUL_LINES: u64 = 16;
/// A place is the same where it differs by no more than so many of the last digit's units: half of one is the rounding.
const SAME_STEPS: f64 = 0.6;
/// Firmware that calculates in steps of its motors tells places that are off by some, mm.
const MOTOR_STEP_MM: f64 = 0.005;
/// A bed that has cooled by more than this lets go of parts, K.
const COOLED_K: f64 = 15.0;

/// What the printer says of itself.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Survey {
    /// The last line that it has; `None` where it counts none.
    pub last: Option<u64>,
    /// Where it is.
    pub position: Option<Position>,
    /// How warm it is.
    pub temperatures: Temperatures,
}

/// What is known of the print that broke off.
#[derive(Debug, Clone, PartialEq)]
pub struct Known {
    /// How its lines were numbered.
    pub track: Track,
    /// How far it was.
    pub progress: Progress,
    /// Whether there may have been more than `progress` tells: the host broke off as well.
    pub is_behind: bool,
    /// How long ago it broke off, s, infinite where nobody knows; `None` within the session that it broke.
    pub away_s: Option<f64>,
}

impl From<&Log> for Known {
    fn from(log: &Log) -> Self {
        Self { track: log.track.clone(), progress: log.progress, is_behind: log.end.is_none(), away_s: None }
    }
}

/// What is done.
#[derive(Debug, Clone, PartialEq)]
pub enum Decision {
    /// It goes on exactly there.
    Exact(Box<Exact>),
    /// It can go on, with the operator's word.
    Recover(Box<Recovery>),
    /// It cannot.
    Refuse(Refusal),
}

/// Where it goes on, each move once.
#[derive(Debug, Clone, PartialEq)]
pub struct Exact {
    /// Where in the session.
    pub place: Place,
    /// How its lines are numbered from now on.
    pub track: Track,
    /// The state there.
    pub modal: Modal,
    /// The lines before it.
    pub tail: Tail,
}

impl Exact {
    /// Lines of the job that are done.
    #[must_use]
    pub fn n_done(&self) -> u64 {
        match self.place {
            Place::Job(n) => n,
            Place::Prelude(_) => self.track.n_before,
        }
    }
}

/// Decides.
///
/// # Errors
/// The job cannot be read any more.
pub fn decide<R: BufRead + Seek>(
    job: &mut Job<R>,
    profile: &Profile,
    known: &Known,
    survey: &Survey,
) -> Result<Decision, job::Error> {
    let reach = Reach::of(known);
    // Where it goes on, the pause is over.
    let known = &Known { track: known.track.clone().gone_on(), ..known.clone() };
    let mut plan = Plan { job, profile, known, reach, survey };
    match survey.last {
        Some(last) => plan.numbered(last),
        None => plan.unnumbered(),
    }
}

/// How lines are numbered behind line `last`, `n_before` lines of the job being done.
fn behind(last: u64, n_before: u64, track: &Track) -> Track {
    Track { first_number: last + 1, n_before, n_twice: track.n_twice, ..Track::default() }
}

struct Plan<'a, R> {
    job: &'a mut Job<R>,
    profile: &'a Profile,
    known: &'a Known,
    reach: Reach,
    survey: &'a Survey,
}

impl<R: BufRead + Seek> Plan<'_, R> {
    fn numbered(&mut self, last: u64) -> Result<Decision, job::Error> {
        let Known { track, progress, .. } = self.known;
        let place = track.place(last).filter(|_| last <= progress.number + self.unrecorded());
        let Some(place) = place.filter(|_| last > 0) else {
            return self.recover(if last == 0 { Why::Restarted } else { Why::OtherNumbers });
        };
        let n_done = track.n_job_lines(last).min(self.job.n_lines());
        if n_done + DOUBTFUL_LINES < progress.n_acked {
            return self.recover(Why::OtherNumbers);
        }
        let (modal, tail) = self.state_after(n_done)?;
        let is_there = matches!(place, Place::Prelude(_)) || self.is_at(&modal);
        match self.is_cold(&modal) {
            Some(_) if is_there && self.holds_its_place(&modal) => {
                return Ok(self.exact_when_warm(last, place, modal, tail));
            }
            Some(why) => return self.recover(why),
            None if !is_there => return self.recover(Why::Elsewhere),
            None if self.has_let_go(last) => return self.recover(Why::MotorsOff),
            None => {}
        }
        let (place, track) = match place {
            Place::Prelude(_) => (place, track.clone()),
            // What was sent before is behind it: a session of its own begins there.
            Place::Job(_) => (Place::Job(n_done), behind(last, n_done, track)),
        };
        Ok(Decision::Exact(Box::new(Exact { place, track, modal, tail })))
    }

    /// Whether a printer whose heaters are off still is where it was: its motors hold as long as a print is waited for, and the bed
    /// has not let go of the part.
    fn holds_its_place(&self, modal: &Modal) -> bool {
        let is_soon = self.known.away_s.is_some_and(|away_s| away_s < self.profile.firmware.orphan_hold_s);
        let bed_c = self.survey.temperatures.bed.map(|bed| bed.actual_c);
        let is_warm = modal.bed_c.zip(bed_c).is_none_or(|(wanted_c, bed_c)| wanted_c - bed_c <= COOLED_K);
        is_soon && is_warm && self.profile.motors_gcode().is_some()
    }

    /// Whether the motors have let go of the axes for want of moves: what the firmware tells of its place then is what it was.
    fn has_let_go(&self, last: u64) -> bool {
        let track = &self.known.track;
        let n_own = usize::try_from(track.n_prelude_lines(last)).unwrap_or(usize::MAX);
        let mut set =
            track.prelude.iter().take(n_own).filter_map(|line| line.strip_prefix("M84 S")?.parse().ok());
        let hold_s = set.next_back().unwrap_or(self.profile.firmware.orphan_hold_s);
        self.profile.motors_gcode().is_some() && self.known.away_s.is_some_and(|away_s| away_s > hold_s)
    }

    /// It is warmed up where it stands; then what was left of the host's own lines, and the job.
    fn exact_when_warm(&self, last: u64, place: Place, modal: Modal, tail: Tail) -> Decision {
        let track = &self.known.track;
        let n_before = track.n_job_lines(last).min(self.job.n_lines());
        let left = match place {
            Place::Prelude(n) => track.prelude[n..].to_vec(),
            Place::Job(_) => Vec::new(),
        };
        let prelude = warming(&modal).into_iter().chain(left).collect();
        let track =
            Track { first_number: last + 1, prelude, n_before, n_twice: track.n_twice, ..Track::default() };
        Decision::Exact(Box::new(Exact { place: Place::Prelude(0), track, modal, tail }))
    }

    /// Lines that may be on their way without the journal knowing.
    const fn unrecorded(&self) -> u64 {
        if self.known.is_behind { UNRECORDED_LINES } else { 0 }
    }

    fn state_after(&mut self, n_lines: u64) -> Result<(Modal, Tail), job::Error> {
        let mut modal = Modal::new(self.profile.firmware.dialect);
        let mut tail = Tail::default();
        self.job.replay(n_lines, |command| tail.push(modal.apply(command)))?;
        Ok((modal, tail))
    }

    /// Whether the printer is where the job is, as far as both say.
    fn is_at(&self, modal: &Modal) -> bool {
        let Some(position) = self.survey.position else { return false };
        let is_near = |(at, told): (&Option<f64>, f64)| {
            at.is_none_or(|at| (at - told).abs() <= SAME_STEPS * position.step_mm + MOTOR_STEP_MM)
        };
        modal.at_mm[..3].iter().zip(position.xyz_mm).all(is_near)
    }

    /// Where the job wants heat and the printer's target is 0, somebody has switched it off: the firmware's own time-out, or a reset.
    /// Once something is printed, the bed counts as well, and so does a target that is lower than anybody would tune it. Before, what
    /// the printer has taken may still wait for what heats up.
    fn is_cold(&self, modal: &Modal) -> Option<Why> {
        let Temperatures { hotend, bed } = self.survey.temperatures;
        let is_printed = modal.top_mm.is_some();
        let is_off = |wanted_c: Option<f64>, heater: Option<Heater>| {
            wanted_c.zip(heater).is_some_and(|(wanted_c, Heater { target_c, .. })| {
                let lacks_k = wanted_c - target_c;
                lacks_k > 0.0 && (target_c <= 0.0 || is_printed && lacks_k > COOLED_K)
            })
        };
        let is_cold = is_off(modal.hotend_c, hotend) || is_printed && is_off(modal.bed_c, bed);
        is_cold.then_some(Why::HeatersOff)
    }
}

#[cfg(test)]
mod tests;
