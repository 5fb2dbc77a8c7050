//! What may or may not be executed when a print breaks off, and what follows for the place of the nozzle.

use crate::printer::journal::Progress;
use crate::printer::journal::recorder::INTERVAL;
use crate::printer::replay::Modal;
use crate::profile::Dialect;

/// What may or may not be executed: from the last certain line to the last one that may have been begun.
#[derive(Debug)]
pub(super) struct Doubt {
    modal: Modal,
    n_certain: u64,
    /// Lines that may have been begun, as far as the journal knows.
    n_begun: u64,
    /// Time since then: behind these a line is begun only when the moves before it have ended.
    left_s: f64,
    /// Lines that may have been begun, in all.
    pub(super) n: u64,
    /// The state behind the last certain line.
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

/// Somebody may have turned the speed up at the printer, by half: moves take no less than this share of the time they are told.
const TURNED_UP: f64 = 0.67;

impl Doubt {
    pub(super) const fn new(dialect: Dialect, n_certain: u64, n_begun: u64, since_s: f64) -> Self {
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

    pub(super) fn take(&mut self, command: &str) {
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
