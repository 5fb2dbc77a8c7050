//! Where a firmware without line numbers is: the stretches of a job behind which it would be at the place that it tells.

use super::{Decision, Exact, Plan, Refusal, SAME_STEPS, Why};
use crate::printer::job;
use crate::printer::journal::{Place, Track};
use crate::printer::protocol::Position;
use crate::printer::replay::{Modal, Tail};
use std::io::{BufRead, Seek};

impl<R: BufRead + Seek> Plan<'_, R> {
    /// By position: the first line from the last acknowledged one on behind which the job is exactly there.
    pub(super) fn unnumbered(&mut self) -> Result<Decision, job::Error> {
        // Behind the last line of the job comes one of the host's.
        let first = self.known.progress.n_acked.min(self.job.n_lines());
        let end = self.known.progress.n_sent.max(first) + self.unrecorded();
        let Some(position) = self.survey.position else { return self.recover(Why::Elsewhere) };
        // It says so in no other way: nothing is warm, and all places are 0, the filament's too.
        let is_at_zero = position.xyz_mm == [0.0; 3] && position.e_mm == Some(0.0);
        if is_at_zero && self.survey.temperatures.are_off() == Some(true) {
            return self.recover(Why::Restarted);
        }
        if let Some(exact) = self.within_prelude(position)? {
            return Ok(match self.has_changed(&exact.modal) {
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
            runs.see(0, is_exactly(&modal, position), true);
        }
        self.job.replay(end.min(self.job.n_lines()), |command| {
            tail.push(modal.apply(command));
            n += 1;
            let is_there = is_exactly(&modal, position);
            if n >= first && runs.see(n, is_there, may_be_repeated(command)) && found.is_none() {
                found = Some((modal.clone(), tail.clone()));
            }
        })?;
        match (runs.starts.as_slice(), found) {
            ([n], Some((modal, tail))) => self.exact_by_place(*n, modal, tail),
            ([first, _, ..], _) => {
                Ok(Decision::Refuse(Refusal::Ambiguous { n_places: runs.starts.len(), first: *first }))
            }
            _ => self.recover(Why::Elsewhere),
        }
    }

    fn exact_by_place(&mut self, n_before: u64, modal: Modal, tail: Tail) -> Result<Decision, job::Error> {
        if let Some(why) = self.has_changed(&modal) {
            return self.recover(why);
        }
        Ok(Decision::Exact(Box::new(self.exact_behind(n_before, modal, tail))))
    }

    /// What has become of heaters and motors meanwhile.
    fn has_changed(&self, modal: &Modal) -> Option<Why> {
        let has_let_go = self.has_let_go(self.known.progress.number);
        self.is_cold(modal).or_else(|| has_let_go.then_some(Why::MotorsOff))
    }

    /// Before the first move the place says nothing; but heating, homing and modes may be done once more.
    fn before_the_first_move(&mut self, n_before: u64, end: u64) -> Result<Option<Exact>, job::Error> {
        let (modal, tail) = self.state_after(n_before)?;
        let (mut n, mut is_harmless) = (0, true);
        self.job.replay(end.min(self.job.n_lines()), |command| {
            n += 1;
            let word = command.split_ascii_whitespace().next().unwrap_or_default();
            is_harmless &= n <= n_before || BEFORE_MOVES.contains(&word);
        })?;
        let is_cold = self.is_cold(&modal).is_some();
        let is_before = modal.top_mm.is_none() && modal.at_mm[0].is_none();
        Ok((is_harmless && !is_cold && is_before).then(|| self.exact_behind(n_before, modal, tail)))
    }

    /// On with the job behind so many of its lines.
    fn exact_behind(&self, n_before: u64, modal: Modal, tail: Tail) -> Exact {
        let n_twice = self.known.track.n_twice;
        let track = Track { first_number: self.first_number(), n_before, n_twice, ..Track::default() };
        Exact { place: Place::Job(n_before), track, modal, tail }
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
                ..Track::default()
            };
            Exact { place: Place::Prelude(0), track, modal, tail }
        }))
    }
}

/// What stands behind the first line that brings a printer to a place may have been executed or not. These do no harm twice.
const HARMLESS: [&str; 33] = [
    "G0",
    "M18",
    "M84",
    "G1",
    "G21",
    "G90",
    "G91",
    "G92",
    "M73",
    "M82",
    "M83",
    "M104",
    "M105",
    "M115",
    "M106",
    "M107",
    "M117",
    "M118",
    "M140",
    "M201",
    "M203",
    "M204",
    "M205",
    "M220",
    "M221",
    "M400",
    "M900",
    "SET_VELOCITY_LIMIT",
    "SET_PRESSURE_ADVANCE",
    "SET_FAN_SPEED",
    "EXCLUDE_OBJECT_START",
    "EXCLUDE_OBJECT_END",
    "EXCLUDE_OBJECT_DEFINE",
];

/// What may be done once more before the first move.
const BEFORE_MOVES: [&str; 15] = [
    "G21", "G28", "G90", "G91", "M82", "M83", "M104", "M105", "M106", "M107", "M109", "M117", "M140", "M190",
    "M400",
];

/// Macros, changes of filament and whatever else is not known may not.
pub(in crate::printer) fn may_be_repeated(command: &str) -> bool {
    command.split_ascii_whitespace().next().is_none_or(|word| HARMLESS.contains(&word))
}

/// Whether the printer is just where the job is, filament included. Before the first bead an axis may only be home: the job does not say
/// where that is.
pub(super) fn is_exactly(modal: &Modal, position: Position) -> bool {
    let Some(e_mm) = position.e_mm else { return false };
    let [x, y, z] = position.xyz_mm;
    let is_near =
        |at: Option<f64>, told: f64| at.is_some_and(|at| (at - told).abs() <= SAME_STEPS * position.step_mm);
    let [at_x, at_y, at_z, at_e] = modal.at_mm;
    let is_home = |at: Option<f64>| at.is_none() && modal.is_homed && modal.top_mm.is_none();
    let is_there = |at, told| is_near(at, told) || is_home(at);
    is_there(at_x, x) && is_there(at_y, y) && is_near(at_z, z) && is_near(at_e, e_mm)
}

/// Stretches of lines behind which the job is at one place.
#[derive(Debug, Default)]
pub(super) struct Runs {
    starts: Vec<u64>,
    is_in: bool,
}

impl Runs {
    /// Whether a stretch begins behind this line. One that may not be repeated begins another one at the same place.
    fn see(&mut self, n: u64, is_there: bool, may_be_repeated: bool) -> bool {
        let begins = is_there && !(self.is_in && may_be_repeated);
        if begins {
            self.starts.push(n);
        }
        self.is_in = is_there;
        begins
    }
}
