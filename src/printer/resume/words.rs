//! What is told of a print that broke off: how it would go on, or why it cannot.

use crate::printer::replay::{Beyond, Modal};
use serde::Serialize;

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
    /// Nothing has moved for longer than they hold.
    #[error("the printer's motors have let go of its axes meanwhile")]
    MotorsOff,
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
        "{why}, and Z may be anywhere from {low_mm:.2} mm{}: it moved within the {n_lines} lines of which it is not known whether \
         they were executed, or the printer had brought it away from the part", up_to(*high_mm)
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

fn up_to(high_mm: f64) -> String {
    if high_mm.is_finite() { format!(" to {high_mm:.2} mm") } else { " upwards".to_owned() }
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
