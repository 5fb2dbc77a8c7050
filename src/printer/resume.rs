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

use super::job::{self, Job};
use super::journal::recorder::INTERVAL;
use super::journal::{Log, Place, Progress, Track};
use super::protocol::{Position, Temperatures};
use super::replay::{Beyond, Modal, Tail};
use crate::profile::{Dialect, Profile, ResumePoint};
use serde::Serialize;
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
/// One that has cooled by more than this holds none, K.
const COLD_K: f64 = 30.0;
/// How far above the part the nozzle travels, mm.
const CLEARANCE_MM: f64 = 5.0;

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
    /// How long ago it broke off, s, where that is known.
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

/// Why it cannot go on exactly.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum Why {
    /// It counts from the beginning.
    #[error("the printer has started anew")]
    Restarted,
    /// Targets are 0.
    #[error("the heaters were switched off meanwhile, and with them perhaps the motors")]
    HeatersOff,
    /// It is at another place than the job.
    #[error("the printer is at another place than the job was")]
    Elsewhere,
    /// Its numbers are not those of the print.
    #[error("the printer names a line that is none of this print")]
    OtherNumbers,
}

/// Going on after a reset.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Recovery {
    /// Why not exactly.
    pub why: Why,
    /// Lines of the job that are certainly executed: it goes on behind them.
    pub n_done: u64,
    /// Lines of the job.
    pub n_lines: u64,
    /// Lines that may be executed a second time, at most.
    pub n_twice: u64,
    /// Printed way in them, mm.
    pub twice_mm: f64,
    /// Where it goes on, mm.
    pub xyz_mm: [f64; 3],
    /// How far the bed has cooled below what the job wants, K, where that is enough for a part to come loose.
    pub cooled_k: Option<f64>,
    /// What is sent before the job.
    pub commands: Vec<String>,
    /// The picture of where it goes on, where there is one.
    pub picture: Option<String>,
    /// The state there.
    pub modal: Modal,
}

impl std::fmt::Display for Recovery {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [x, y, z] = self.xyz_mm;
        write!(
            f,
            "{}; it would go on behind line {} of {}, at X {x:.2} Y {y:.2} Z {z:.2} mm, warm up, home X and Y, prime aside and \
             come down from above; up to {} lines ({:.1} mm of bead) may be printed twice, nothing is left out",
            self.why, self.n_done, self.n_lines, self.n_twice, self.twice_mm
        )?;
        let set: Vec<_> =
            self.modal.settings.iter().filter_map(|s| s.line.split_ascii_whitespace().next()).collect();
        if !set.is_empty() {
            write!(f, "; what the job had set is set again: {}", set.join(", "))?;
        }
        if let Some(cooled_k) = self.cooled_k {
            write!(f, "; the bed has cooled by {cooled_k:.0} K: see whether the part still holds")?;
        }
        if let Some(picture) = &self.picture {
            write!(f, "; {picture} shows where")?;
        }
        Ok(())
    }
}

/// Why it cannot go on.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The print was not interrupted.
    #[error("the print was finished: there is nothing to resume")]
    Finished,
    /// It was given up on request.
    #[error(
        "the print was cancelled, which throws moves away that the printer had taken: where it stopped is not known; print the job anew"
    )]
    Cancelled,
    /// The last attempt to go on broke off before it was back at the part.
    #[error(
        "{why}, while it was on its way back to the part: the height of the nozzle is not known; print the job anew"
    )]
    WithinRecovery {
        /// Why not exactly.
        why: Why,
    },
    /// Nothing was printed.
    #[error("{why}, and nothing was printed before: print the job with `lumenfab print`")]
    NothingPrinted {
        /// Why not exactly.
        why: Why,
    },
    /// The height of the nozzle is not known.
    #[error(
        "{why}, and Z may be anywhere from {low_mm:.2} to {high_mm:.2} mm: it moved within the {n_lines} lines of which it is not \
         known whether they were executed"
    )]
    HeightUnknown {
        /// Why not exactly.
        why: Why,
        /// Lowest, mm.
        low_mm: f64,
        /// Highest, mm.
        high_mm: f64,
        /// Lines in doubt.
        n_lines: u64,
    },
    /// A reset has taken something away that cannot be brought about again.
    #[error("{why}, and the job {beyond}: print it anew")]
    Beyond {
        /// Why not exactly.
        why: Why,
        /// What.
        beyond: Beyond,
    },
    /// The part has let go of the bed, or soon will.
    #[error(
        "{why}, and the bed has cooled by {cooled_k:.0} K below what the job wants: the part no longer holds; print it anew"
    )]
    PartCold {
        /// Why not exactly.
        why: Why,
        /// By how much, K.
        cooled_k: f64,
    },
    /// The profile does not say how.
    #[error("{why}, and the profile has no scripts.recovery to find its place again")]
    NoScript {
        /// Why not exactly.
        why: Why,
    },
    /// Without line numbers the place is not clear.
    #[error(
        "the printer's position fits {n_places} places of the job, the first behind line {first}: which one it is cannot be told"
    )]
    Ambiguous {
        /// How many.
        n_places: usize,
        /// The first.
        first: u64,
    },
}

impl Refusal {
    /// Why not exactly, where it would otherwise have gone on.
    #[must_use]
    pub const fn why(&self) -> Option<Why> {
        match self {
            Self::WithinRecovery { why }
            | Self::NothingPrinted { why }
            | Self::HeightUnknown { why, .. }
            | Self::Beyond { why, .. }
            | Self::PartCold { why, .. }
            | Self::NoScript { why } => Some(*why),
            Self::Finished | Self::Cancelled | Self::Ambiguous { .. } => None,
        }
    }

    /// A stable name for programs.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Finished => "printer.resume_finished",
            Self::Cancelled => "printer.resume_cancelled",
            Self::WithinRecovery { .. } => "printer.resume_within_recovery",
            Self::NothingPrinted { .. } => "printer.resume_nothing_printed",
            Self::HeightUnknown { .. } => "printer.resume_height_unknown",
            Self::Beyond { .. } => "printer.resume_beyond",
            Self::PartCold { .. } => "printer.resume_part_cold",
            Self::NoScript { .. } => "printer.resume_no_script",
            Self::Ambiguous { .. } => "printer.resume_ambiguous",
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
    let mut plan = Plan { job, profile, known, survey };
    match survey.last {
        Some(last) => plan.numbered(last),
        None => plan.unnumbered(),
    }
}

struct Plan<'a, R> {
    job: &'a mut Job<R>,
    profile: &'a Profile,
    known: &'a Known,
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
            None => {}
        }
        let place = if let Place::Job(n) = place { Place::Job(n.min(self.job.n_lines())) } else { place };
        Ok(Decision::Exact(Box::new(Exact { place, track: track.clone(), modal, tail })))
    }

    /// Whether a printer whose heaters are off still is where it was: its motors hold as long as a print is waited for, and the bed
    /// has not let go of the part.
    fn holds_its_place(&self, modal: &Modal) -> bool {
        let is_soon = self.known.away_s.is_some_and(|away_s| away_s < self.profile.firmware.orphan_hold_s);
        let bed_c = self.survey.temperatures.bed.map(|bed| bed.actual_c);
        let is_warm = modal.bed_c.zip(bed_c).is_none_or(|(wanted_c, bed_c)| wanted_c - bed_c <= COOLED_K);
        is_soon && is_warm && self.profile.motors_gcode().is_some()
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
        let track = Track { first_number: last + 1, prelude, n_before, n_twice: track.n_twice };
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
    fn is_cold(&self, modal: &Modal) -> Option<Why> {
        let target_c = self.survey.temperatures.hotend.map(|hotend| hotend.target_c);
        let is_off = modal.hotend_c.is_some_and(|c| c > 0.0) && target_c.is_some_and(|c| c <= 0.0);
        is_off.then_some(Why::HeatersOff)
    }

    /// By position: the first line from the last acknowledged one on behind which the job is exactly there.
    fn unnumbered(&mut self) -> Result<Decision, job::Error> {
        let first = self.known.progress.n_acked;
        let end = self.known.progress.n_sent.max(first) + self.unrecorded();
        let Some(position) = self.survey.position else { return self.recover(Why::Elsewhere) };
        // It says so in no other way: nothing is warm, and all places are 0, the filament's too.
        let is_at_zero = position.xyz_mm == [0.0; 3] && position.e_mm == Some(0.0);
        if is_at_zero && self.survey.temperatures.are_off() == Some(true) {
            return self.recover(Why::Restarted);
        }
        if let Some(exact) = self.within_prelude(position)? {
            return Ok(match self.is_cold(&exact.modal) {
                Some(why) => self.recover(why)?,
                None => Decision::Exact(Box::new(exact)),
            });
        }
        if let Some(exact) = self.before_the_first_move(first, end)? {
            return Ok(Decision::Exact(Box::new(exact)));
        }
        let mut modal = Modal::new(self.profile.firmware.dialect);
        let mut tail = Tail::default();
        let mut runs = Runs::default();
        let (mut n, mut found) = (0, None);
        if first == 0 {
            runs.see(0, is_exactly(&modal, position));
        }
        self.job.replay(end.min(self.job.n_lines()), |command| {
            tail.push(modal.apply(command));
            n += 1;
            if n >= first && runs.see(n, is_exactly(&modal, position)) && found.is_none() {
                found = Some((modal.clone(), tail.clone()));
            }
        })?;
        match (runs.starts.as_slice(), found) {
            ([n], Some((modal, tail))) => match self.is_cold(&modal) {
                Some(why) => self.recover(why),
                None => {
                    let track = Track {
                        first_number: self.first_number(),
                        prelude: Vec::new(),
                        n_before: *n,
                        n_twice: self.known.track.n_twice,
                    };
                    Ok(Decision::Exact(Box::new(Exact { place: Place::Job(*n), track, modal, tail })))
                }
            },
            ([first, _, ..], _) => {
                Ok(Decision::Refuse(Refusal::Ambiguous { n_places: runs.starts.len(), first: *first }))
            }
            _ => self.recover(Why::Elsewhere),
        }
    }

    /// Before anything is printed the place says nothing; but heating, homing and modes may be done once more.
    fn before_the_first_move(&mut self, n_done: u64, end: u64) -> Result<Option<Exact>, job::Error> {
        const HARMLESS: [&str; 14] = [
            "M104", "M109", "M140", "M190", "G28", "G90", "G91", "M82", "M83", "G21", "M106", "M107", "M220",
            "M221",
        ];
        let (modal, tail) = self.state_after(n_done)?;
        let (mut n, mut is_harmless) = (0, true);
        self.job.replay(end.min(self.job.n_lines()), |command| {
            n += 1;
            let word = command.split_ascii_whitespace().next().unwrap_or_default();
            is_harmless &= n <= n_done || HARMLESS.contains(&word);
        })?;
        let is_cold = self.is_cold(&modal).is_some();
        Ok((is_harmless && !is_cold && modal.top_mm.is_none() && modal.at_mm[0].is_none()).then(|| {
            let n_twice = self.known.track.n_twice;
            let track =
                Track { first_number: self.first_number(), prelude: Vec::new(), n_before: n_done, n_twice };
            Exact { place: Place::Job(n_done), track, modal, tail }
        }))
    }

    /// What the next line is numbered by, where the firmware counts none.
    const fn first_number(&self) -> u64 {
        if self.profile.firmware.line_numbers { self.known.progress.number + 1 } else { 1 }
    }

    /// The host's own lines of a pause bring the nozzle away and back: behind which of them it is there. Where several are alike, the
    /// last: what follows sets modes, and may be said twice.
    fn within_prelude(&mut self, position: Position) -> Result<Option<Exact>, job::Error> {
        let Track { prelude, n_before, n_twice, .. } = self.known.track.clone();
        if n_before == 0 || self.known.progress.n_sent > n_before {
            return Ok(None);
        }
        let (modal, tail) = self.state_after(n_before)?;
        let mut at = modal.clone();
        let mut behind = None;
        for (i, line) in prelude.iter().enumerate() {
            at.apply(line);
            behind = if is_exactly(&at, position) { Some(i + 1) } else { behind };
        }
        Ok(behind.map(|n| {
            let track = Track {
                first_number: self.first_number(),
                prelude: prelude[n..].to_vec(),
                n_before,
                n_twice,
            };
            Exact { place: Place::Prelude(0), track, modal, tail }
        }))
    }

    fn recover(&mut self, why: Why) -> Result<Decision, job::Error> {
        if self.is_within_recovery() {
            return Ok(Decision::Refuse(Refusal::WithinRecovery { why }));
        }
        let Known { progress, .. } = self.known;
        let n_done = progress.n_certain;
        let n_lines = self.job.n_lines();
        let n_sent = progress.n_sent.max(n_done).min(n_lines) + self.unrecorded();
        let since_s = progress.begun_s + if self.known.is_behind { behind_s(progress) } else { 0.0 };
        let n_begun = progress.n_begun.max(n_done).min(n_lines);
        let mut doubt = Doubt::new(self.profile.firmware.dialect, n_done, n_begun, since_s);
        self.job.replay(n_sent, |command| doubt.take(command))?;
        let n_sent = doubt.n;
        let Some(modal) = doubt.at.take().filter(|modal| modal.top_mm.is_some()) else {
            return Ok(Decision::Refuse(Refusal::NothingPrinted { why }));
        };
        let ([Some(x), Some(y), Some(z), _], Some(hotend_c)) = (modal.at_mm, modal.hotend_c) else {
            return Ok(Decision::Refuse(Refusal::NothingPrinted { why }));
        };
        if self.profile.scripts.recovery.is_empty() {
            return Ok(Decision::Refuse(Refusal::NoScript { why }));
        }
        if let Some(beyond) = modal.beyond {
            return Ok(Decision::Refuse(Refusal::Beyond { why, beyond }));
        }
        let bed_c = modal.bed_c.unwrap_or(0.0);
        let cooled_k = self.survey.temperatures.bed.map(|bed| bed_c - bed.actual_c);
        if let Some(cooled_k) = cooled_k.filter(|k| *k > COLD_K) {
            return Ok(Decision::Refuse(Refusal::PartCold { why, cooled_k }));
        }
        let n_lines = n_sent - n_done;
        if let Some(told_mm) = self.told_height().filter(|_| why != Why::Restarted) {
            // Elsewhere, somebody has moved it, or it has gone on further than is known.
            let is_there = (told_mm - z).abs() <= MOTOR_STEP_MM;
            let told_mm = if is_there { z } else { told_mm };
            (doubt.low_mm, doubt.high_mm) = (told_mm.min(z), told_mm.max(z));
        }
        if doubt.high_mm - doubt.low_mm > 1e-6 && !self.homes_z() {
            let Doubt { low_mm, high_mm, .. } = doubt;
            return Ok(Decision::Refuse(Refusal::HeightUnknown { why, low_mm, high_mm, n_lines }));
        }
        let point = ResumePoint {
            xyz_mm: [x, y, z],
            clear_z_mm: modal.top_mm.unwrap_or(z).max(z) + CLEARANCE_MM,
            hotend_c,
            bed_c,
        };
        let mut commands = self.profile.recovery_gcode(&point);
        commands.extend(restoring(&modal));
        let cooled_k = cooled_k.filter(|k| *k > COOLED_K);
        Ok(Decision::Recover(Box::new(Recovery {
            why,
            n_done,
            n_lines: self.job.n_lines(),
            n_twice: n_lines,
            twice_mm: doubt.printed_mm,
            xyz_mm: point.xyz_mm,
            cooled_k,
            commands,
            picture: None,
            modal,
        })))
    }

    /// Whether the last session was to find the part again and may not have come to it: the nozzle stands anywhere above.
    fn is_within_recovery(&self) -> bool {
        let Known { track, progress, .. } = self.known;
        let finds_again = track.prelude.iter().any(|line| line.starts_with("G92"));
        finds_again && progress.n_certain <= track.n_before
    }

    /// Z by the printer's own word, mm.
    fn told_height(&self) -> Option<f64> {
        self.survey.position.map(|position| position.xyz_mm[2])
    }

    /// Whether the profile's recovery finds the height again by itself.
    fn homes_z(&self) -> bool {
        let homes = |line: &String| {
            let mut words = line.split_ascii_whitespace();
            let is_homing = words.next() == Some("G28");
            let axes: Vec<_> = words.collect();
            is_homing && (axes.is_empty() || axes.iter().any(|axis| axis.starts_with('Z')))
        };
        self.profile.scripts.recovery.iter().any(homes)
    }
}

fn is_exactly(modal: &Modal, position: Position) -> bool {
    let Some(e_mm) = position.e_mm else { return false };
    let [x, y, z] = position.xyz_mm;
    let is_near =
        |at: &Option<f64>, told: f64| at.is_some_and(|at| (at - told).abs() <= SAME_STEPS * position.step_mm);
    modal.at_mm.iter().zip([x, y, z, e_mm]).all(|(at, told)| is_near(at, told))
}

/// Stretches of lines behind which the job is at one place.
#[derive(Debug, Default)]
struct Runs {
    starts: Vec<u64>,
    is_in: bool,
}

impl Runs {
    /// Whether a stretch begins here.
    fn see(&mut self, n: u64, is_there: bool) -> bool {
        let begins = is_there && !self.is_in;
        if begins {
            self.starts.push(n);
        }
        self.is_in = is_there;
        begins
    }
}

/// What may or may not be executed: from the last certain line to the last one that may have been begun.
#[derive(Debug)]
struct Doubt {
    modal: Modal,
    n_certain: u64,
    /// Lines that may have been begun, as far as the journal knows.
    n_begun: u64,
    /// Time since then: behind these a line is begun only when the moves before it have ended.
    left_s: f64,
    n: u64,
    /// The state at the last certain line.
    at: Option<Modal>,
    low_mm: f64,
    high_mm: f64,
    printed_mm: f64,
}

/// How far a journal is behind that has not told how long the disk takes, s.
const BEHIND_S: f64 = 1.25;
/// What a disk may take longer than it ever has, s; and how many times as long.
const SLOWER_S: f64 = 0.25;
const SLOWER: f64 = 2.0;

/// How far the journal may have been behind when the host broke off too, s.
fn behind_s(progress: &Progress) -> f64 {
    if progress.delay_s > 0.0 {
        SLOWER.mul_add(progress.delay_s, INTERVAL.as_secs_f64() + SLOWER_S)
    } else {
        BEHIND_S
    }
}
/// Somebody may have turned the speed up at the printer, by half: moves take no less than this share of the time they are told.
const TURNED_UP: f64 = 0.67;

impl Doubt {
    const fn new(dialect: Dialect, n_certain: u64, n_begun: u64, since_s: f64) -> Self {
        Self {
            modal: Modal::new(dialect),
            n_certain,
            n_begun,
            left_s: since_s,
            n: 0,
            at: None,
            low_mm: f64::INFINITY,
            high_mm: f64::NEG_INFINITY,
            printed_mm: 0.0,
        }
    }

    fn take(&mut self, command: &str) {
        if self.n >= self.n_begun && self.left_s <= 0.0 {
            return;
        }
        let before = self.modal.at_mm;
        let effect = self.modal.apply(command);
        self.n += 1;
        if self.n > self.n_begun {
            self.left_s -= TURNED_UP * effect.least_s();
        }
        if self.n == self.n_certain {
            self.at = Some(self.modal.clone());
        }
        if self.n >= self.n_certain {
            self.doubt(before);
        }
    }

    fn doubt(&mut self, before: [Option<f64>; 4]) {
        if let Some(z_mm) = self.modal.at_mm[2] {
            self.low_mm = self.low_mm.min(z_mm);
            self.high_mm = self.high_mm.max(z_mm);
        }
        let way = |axis: usize| self.modal.at_mm[axis].zip(before[axis]).map_or(0.0, |(to, from)| to - from);
        let way_mm = way(0).hypot(way(1)).hypot(way(2));
        if self.n > self.n_certain && way(3) > 0.0 {
            self.printed_mm += way_mm;
        }
    }
}

/// Heat and fan as the job left them.
fn warming(modal: &Modal) -> Vec<String> {
    let heats = |set: &str, celsius: Option<f64>| celsius.filter(|c| *c > 0.0).map(|c| format!("{set} S{c}"));
    let heat =
        [("M140", modal.bed_c), ("M104", modal.hotend_c), ("M190", modal.bed_c), ("M109", modal.hotend_c)];
    let fan = modal.fan.filter(|fan| *fan > 0.0).map(|fan| format!("M106 S{fan}"));
    heat.into_iter().filter_map(|(set, celsius)| heats(set, celsius)).chain(fan).collect()
}

/// Limits and factors, the filament drawn back, modes, its place, fan and speed as the job left them.
fn restoring(modal: &Modal) -> Vec<String> {
    let rounded = |value: f64| (value * 1e5).round() / 1e5;
    let mut lines: Vec<_> = modal.settings.iter().map(|setting| setting.line.clone()).collect();
    if modal.drawn_mm > 0.0 {
        lines.push("M83".to_owned());
        lines.push(format!("G1 E-{} F1800", rounded(modal.drawn_mm)));
    }
    lines.extend(modal.at_mm[3].map(|e| format!("G92 E{}", rounded(e))));
    lines.push(if modal.absolute_xyz { "G90" } else { "G91" }.to_owned());
    lines.push(if modal.absolute_e { "M82" } else { "M83" }.to_owned());
    lines.extend(modal.fan.map(|fan| if fan > 0.0 { format!("M106 S{fan}") } else { "M107".to_owned() }));
    lines.extend(modal.feedrate_mm_min.map(|feedrate| format!("G1 F{}", rounded(feedrate))));
    lines
}

#[cfg(test)]
mod tests;
