//! What may or may not be executed when a print breaks off, and what follows for the place of the nozzle.

use super::Known;
use crate::printer::journal::Progress;
use crate::printer::journal::recorder::INTERVAL;
use crate::printer::replay::Modal;
use crate::profile::Dialect;

/// How far a session came, in lines of the job and of the host's prelude, in the order in which they are executed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reach {
    n_certain: u64,
    /// Lines that may have been begun, as far as the journal knows.
    n_begun: u64,
    /// Lines of the prelude that were sent.
    pub(super) n_prelude: u64,
    /// In a pause: none of the job's lines was sent behind these.
    pub(super) is_waiting: bool,
}

impl Reach {
    pub(super) fn of(known: &Known) -> Self {
        let Known { track, progress, is_behind, .. } = known;
        let n_before = track.n_before;
        let n_all = track.prelude.len() as u64;
        let is_past = progress.n_sent > n_before || *is_behind;
        let n_prelude = if is_past { n_all } else { track.n_prelude_lines(progress.number) };
        let n_certain =
            if progress.n_certain > n_before { n_all } else { progress.n_prelude } + progress.n_certain;
        // Moves that are held are counted in lines of the job: where these may be before the prelude, all of it may be begun.
        let n_begun = progress.n_begun.max(n_before) + n_prelude;
        Self { n_certain, n_begun: n_begun.max(n_certain), n_prelude, is_waiting: !track.back.is_empty() }
    }
}

/// What may or may not be executed: from the last certain line to the last one that may have been begun.
#[derive(Debug)]
pub(super) struct Doubt {
    /// The state behind the job's lines alone.
    modal: Modal,
    /// The same, and what the prelude has changed.
    nozzle: Modal,
    reach: Reach,
    /// Lines of the job that are certainly executed.
    n_done: u64,
    /// Lines of either kind so far.
    n_taken: u64,
    /// See [`Progress::z_allowed_to`].
    z_allowed_to: Option<u64>,
    /// The next line of the job was not sent: it is not let yet.
    is_held: bool,
    /// Time since then: behind these a line is begun only when the moves before it have ended.
    left_s: f64,
    /// Lines of the job that may have been begun, in all.
    pub(super) n: u64,
    /// The state behind the last certain line of the job.
    pub(super) at: Option<Modal>,
    /// Lowest and highest place of the nozzle from there on.
    pub(super) low_mm: f64,
    pub(super) high_mm: f64,
    /// Way of beads from there on.
    pub(super) printed_mm: f64,
}

/// How far a journal is behind that has not told how long the disk takes, s.
const BEHIND_S: f64 = 1.25;
/// What a disk may take longer than it ever has, s; and how many times as long.
const SLOWER_S: f64 = 0.25;
const SLOWER: f64 = 2.0;

/// How far the journal may have been behind when the host broke off too, s.
pub(super) fn behind_s(progress: &Progress) -> f64 {
    if progress.delay_s > 0.0 {
        SLOWER.mul_add(progress.delay_s, INTERVAL.as_secs_f64() + SLOWER_S)
    } else {
        BEHIND_S
    }
}

/// Commands in which the firmware brings the nozzle away from the part, and back at their end: filament changes, parking, cleaning.
const MOVE_AWAY: [&str; 7] = ["M600", "M125", "M701", "M702", "G12", "G27", "PAUSE"];

fn moves_away(command: &str) -> bool {
    MOVE_AWAY.contains(&command.split_ascii_whitespace().next().unwrap_or_default())
}

/// Somebody may have turned the speed up at the printer, by half: moves take no less than this share of the time they are told.
const TURNED_UP: f64 = 0.67;

impl Doubt {
    pub(super) const fn new(dialect: Dialect, progress: &Progress, reach: Reach, since_s: f64) -> Self {
        Self {
            modal: Modal::new(dialect),
            nozzle: Modal::new(dialect),
            reach,
            n_done: progress.n_certain,
            n_taken: 0,
            z_allowed_to: progress.z_allowed_to,
            is_held: false,
            left_s: since_s,
            n: 0,
            at: None,
            low_mm: f64::INFINITY,
            high_mm: f64::NEG_INFINITY,
            printed_mm: 0.0,
        }
    }

    /// The next line of the job.
    pub(super) fn take(&mut self, command: &str) {
        let is_let = self.z_allowed_to.is_none_or(|to| self.n < to);
        self.is_held |= !is_let && self.modal.changes_height(command);
        if self.is_over() {
            return;
        }
        self.n += 1;
        self.modal.apply(command);
        if self.n == self.n_done {
            self.at = Some(self.modal.clone());
        }
        self.go(command);
    }

    /// The next line of the host's own.
    pub(super) fn take_own(&mut self, command: &str) {
        if !self.is_over() {
            self.go(command);
        }
    }

    /// Whether no line can have been begun any more.
    fn is_over(&self) -> bool {
        self.is_held || self.n_taken >= self.reach.n_begun && self.left_s <= 0.0
    }

    fn go(&mut self, command: &str) {
        let moves_away = moves_away(command);
        let before = self.nozzle.at_mm;
        let effect = self.nozzle.apply(command);
        self.n_taken += 1;
        if self.n_taken > self.reach.n_begun {
            self.left_s -= TURNED_UP * effect.least_s();
        }
        if self.n_taken >= self.reach.n_certain {
            self.doubt(before);
        }
        if moves_away && self.n_taken > self.reach.n_certain {
            self.high_mm = f64::INFINITY;
        }
    }

    fn doubt(&mut self, before: [Option<f64>; 4]) {
        match self.nozzle.at_mm[2] {
            Some(z_mm) => (self.low_mm, self.high_mm) = (self.low_mm.min(z_mm), self.high_mm.max(z_mm)),
            // Homing, for one, brings it nobody knows how high.
            None => self.high_mm = f64::INFINITY,
        }
        let way = |axis: usize| self.nozzle.at_mm[axis].zip(before[axis]).map_or(0.0, |(to, from)| to - from);
        let way_mm = way(0).hypot(way(1)).hypot(way(2));
        if self.n_taken > self.reach.n_certain && way(3) > 0.0 {
            self.printed_mm += way_mm;
        }
    }
}
