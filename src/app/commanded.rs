//! What the acknowledged lines of a print have told the printer to lay: its journal and its job, without a word from the printer.
//!
//! Only lines that the firmware has acknowledged count: after a print that was given up or broke off, the rest is not told. What is
//! acknowledged is in the firmware's hands, and nearly always done; where a print was cancelled, its last moves may have been thrown
//! away. A move pushes what goes beyond all filament pushed before it: what a retraction draws back and the next push gives again
//! lays nothing. Whether anything came out of the nozzle, where the axes really were, and what the operator did at the printer is
//! not known here.
//!
//! Frame: that of the job, mm. Arcs are taken as straight and counted.

use super::atomic;
use super::error::Error;
use crate::gcode::reader;
use crate::printer;
use crate::printer::job::Job;
use crate::printer::journal::{self, Ending, Log, path_for};
use crate::printer::paper;
use crate::printer::replay::{Effect, Modal};
use crate::profile::{Dialect, Firmware};
use std::path::Path;

/// Less filament than this is rounding, mm.
const LEAST_MM: f64 = 1e-6;

/// A straight way on which fresh filament is pushed. mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Push {
    /// Where it begins: x, y, z.
    pub from_mm: [f64; 3],
    /// Where it ends.
    pub to_mm: [f64; 3],
    /// Length of filament.
    pub filament_mm: f64,
}

/// How far a print came, by its journal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Extent {
    /// Lines acknowledged, and lines of the job.
    pub n_lines: [u64; 2],
    /// Lines that may have been executed twice, after a reset.
    pub n_twice: u64,
    /// Whether it ended with every line executed.
    pub is_finished: bool,
    /// Whether it was given up for good.
    pub is_cancelled: bool,
}

/// What a print was told to lay.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Commanded {
    /// How much of it.
    pub extent: Extent,
    /// In the order of the job.
    pub pushes: Vec<Push>,
    /// Filament pushed, on the spot too, mm.
    pub filament_mm: f64,
    /// Arcs that were taken as straight.
    pub n_arcs: u64,
}

/// How far the last print of this very job came; `None` where no journal tells of one that has begun.
///
/// # Errors
/// [`Error::Printer`], [`Error::File`] where a file cannot be read.
pub fn extent(job: &Path) -> Result<Option<Extent>, Error> {
    let log = match paper::log_of(job) {
        Ok(log) => log,
        Err(printer::Error::Journal(journal::Error::Missing(_) | journal::Error::NotBegun(_))) => {
            return Ok(None);
        }
        Err(error) => return Err(error.into()),
    };
    let is_it = log.progress.n_acked > 0 && log.job.hash == atomic::hash_of_path(job)?;
    Ok(is_it.then(|| Extent::of(&log)))
}

impl Extent {
    fn of(log: &Log) -> Self {
        let is_finished = log.end == Some(Ending::Finished);
        let n_done = if is_finished { log.job.n_lines } else { log.progress.n_acked.min(log.job.n_lines) };
        Self {
            n_lines: [n_done, log.job.n_lines],
            n_twice: log.track.n_twice,
            is_finished,
            is_cancelled: log.end == Some(Ending::Cancelled),
        }
    }
}

/// Reads the journal of a job and follows its lines as far as they were acknowledged.
///
/// # Errors
/// [`Error::Printer`], [`Error::File`] where a file cannot be read or the journal is another job's.
pub fn read(job: &Path, firmware: &Firmware) -> Result<Commanded, Error> {
    let log = paper::log_of(job)?;
    if log.job.hash != atomic::hash_of_path(job)? {
        let journal = path_for(job).display().to_string();
        return Err(printer::Error::OtherJob { job: job.display().to_string(), journal }.into());
    }
    Ok(Commanded { extent: Extent::of(&log), ..followed(job, firmware, Extent::of(&log).n_lines[0])? })
}

/// Follows all lines of a job, printed or not; how far a print came is left out.
///
/// # Errors
/// [`Error::Printer`], [`Error::File`] where the file cannot be read.
pub fn whole(job: &Path, firmware: &Firmware) -> Result<Commanded, Error> {
    followed(job, firmware, u64::MAX)
}

fn followed(job: &Path, firmware: &Firmware, n_lines: u64) -> Result<Commanded, Error> {
    let mut lines = Job::from_file(job, firmware).map_err(printer::Error::from)?;
    let mut follower = Follower::new(firmware.dialect);
    lines.replay(n_lines, |command| follower.take(command)).map_err(printer::Error::from)?;
    Ok(follower.commanded)
}

/// The nozzle as the lines move it.
struct Follower {
    modal: Modal,
    /// Filament pushed, net of retractions, and the most of it so far; mm.
    net_mm: f64,
    most_mm: f64,
    /// M221.
    flow: f64,
    commanded: Commanded,
}

impl Follower {
    fn new(dialect: Dialect) -> Self {
        let commanded = Commanded::default();
        Self { modal: Modal::new(dialect), net_mm: 0.0, most_mm: 0.0, flow: 1.0, commanded }
    }

    fn take(&mut self, command: &str) {
        let before = self.modal.at_mm;
        let effect = self.modal.apply(command);
        match effect {
            Effect::Block { .. } | Effect::Short { .. } => self.moved(before),
            Effect::Arc { .. } => {
                self.commanded.n_arcs += 1;
                self.moved(before);
            }
            Effect::Drains | Effect::Other => self.set_flow(command),
        }
    }

    fn set_flow(&mut self, command: &str) {
        if let Ok(reader::Line { command: Some(c), .. }) = reader::parse(command)
            && c.is('M', 221)
            && let Some(percent) = c.value('S')
        {
            self.flow = percent / 100.0;
        }
    }

    fn moved(&mut self, before: [Option<f64>; 4]) {
        let after = self.modal.at_mm;
        let [Some(e0), Some(e1)] = [before[3], after[3]] else { return };
        let pulled = (e1 - e0) * self.flow;
        let net_before = self.net_mm;
        self.net_mm += pulled;
        let fresh_mm = self.net_mm - self.most_mm;
        if fresh_mm <= LEAST_MM {
            return;
        }
        let begun = ((self.most_mm - net_before) / pulled).clamp(0.0, 1.0);
        self.most_mm = self.net_mm;
        self.commanded.filament_mm += fresh_mm;
        let place = |at: [Option<f64>; 4]| Some([at[0]?, at[1]?, at[2]?]);
        // Where the nozzle is after homing is not known until the next absolute move: nothing is laid there.
        let (Some(from), Some(to_mm)) = (place(before), place(after)) else { return };
        let from_mm = std::array::from_fn(|axis| from[axis] + (to_mm[axis] - from[axis]) * begun);
        self.commanded.pushes.push(Push { from_mm, to_mm, filament_mm: fresh_mm });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn followed(lines: &[&str]) -> Commanded {
        let mut follower = Follower::new(Dialect::Marlin);
        lines.iter().for_each(|line| follower.take(line));
        follower.commanded
    }

    #[test]
    fn a_retraction_and_the_push_that_makes_up_for_it_lay_nothing() {
        let commanded = followed(&[
            "G28",
            "G90",
            "M83",
            "G1 X0 Y0 Z0.2 F1800",
            "G1 X10 E1",
            "G1 E-2",
            "G1 X20",
            "G1 E2",
            "G1 X30 E1.5",
            "G92 E0",
            "M221 S200",
            "G1 X40 E1",
        ]);
        let lengths: Vec<f64> = commanded.pushes.iter().map(|p| p.filament_mm).collect();
        assert_eq!(lengths, [1.0, 1.5, 2.0]);
        assert_eq!(commanded.pushes[1].from_mm, [20.0, 0.0, 0.2]);
        assert!((commanded.filament_mm - 4.5).abs() < 1e-12);
    }

    #[test]
    fn a_push_that_begins_within_a_move_begins_there() {
        let commanded = followed(&["G90", "M82", "G1 X0 Y0 Z0.2", "G1 X10 E1", "G1 E0.5", "G1 X20 E1.5"]);
        assert_eq!(commanded.pushes[1].from_mm, [15.0, 0.0, 0.2]);
        assert!((commanded.pushes[1].filament_mm - 0.5).abs() < 1e-12);
    }

    #[test]
    fn where_the_nozzle_is_not_known_nothing_is_placed() {
        let commanded = followed(&["G28", "G91", "G1 X10 E1", "G90", "G1 X0 Y0 Z1", "G1 X5 E1"]);
        assert!(commanded.pushes.len() <= 1 && commanded.filament_mm > 0.0, "{commanded:?}");
    }
}
