//! The parameters of a case: what an operator may ask for, with defaults and ranges.
//!
//! [`CaseFile`] is the document: every key may be absent. Flags of the command line and an input case file are such
//! documents too, laid one [over](CaseFile::over) the other. [`Settings`] is what it comes to once the defaults are
//! filled in and every value was checked. Keys are the flags' names with underscores, units included.

mod file;
#[cfg(test)]
mod tests;
mod values;

pub use file::{CaseFile, SolidKeys, SourceName};
pub use values::*;

use crate::phantom;
use crate::ready::Label;
use crate::sections::Boundary;
use crate::segment::{Corrections, OnLeak, Polarity};
use crate::solid::Correspondence;
use crate::topology::Decisions;
use serde::Serialize;

/// The number of the format that `case.toml` is written in.
const FORMAT: u32 = 1;
/// `--wall-mm` where nothing is said.
pub const DEFAULT_WALL_MM: f64 = 1.0;
/// `--layer-mm` where nothing is said.
pub const DEFAULT_LAYER_MM: f64 = 0.2;
/// `--profile` where nothing is said.
pub const DEFAULT_PROFILE: &str = "marlin";
/// `--port` where nothing is said: the simulated printer.
pub const SIMULATED_PORT: &str = "sim";

/// Where the contours come from.
#[derive(Debug, Clone, PartialEq)]
pub enum Source {
    /// A CT; where it lies is kept apart from the case ([`super::source`]).
    Ct,
    /// A synthetic CT, made anew when it is needed.
    Phantom(phantom::Params),
    /// A segmentation made elsewhere; where it lies is kept apart, as for a CT.
    Ready {
        /// Whether there is a CT as well, to compare with.
        has_ct: bool,
        /// Which structure; `None`: the only one.
        label: Option<Label>,
    },
    /// A ready `sections.json`: there is no image.
    Sections,
}

/// How the lumen is found in the CT.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SegmentSettings {
    /// Number of the series in the folder, from 1; `None`: the only one.
    pub series: Option<usize>,
    /// Whether a stack with missing planes is used.
    pub allow_gaps: bool,
    /// Points inside the lumen, LPS, mm; none for a phantom, which knows its own, or where the vessel is found.
    pub seed_mm: Vec<[f64; 3]>,
    /// Whether the vessel is found by itself.
    pub auto_seed: bool,
    /// Intensities of the lumen; `None`: found from the seed's neighbourhood.
    pub window_hu: Option<[f64; 2]>,
    /// Whether the lumen is brighter or darker than its wall.
    pub polarity: Polarity,
    /// What is done where the region leaves the vessel.
    #[serde(skip_serializing_if = "OnLeak::is_default")]
    pub on_leak: OnLeak,
    /// Which grey value the boundary is.
    pub boundary: Boundary,
    /// Heights along the stack's normal that are used; `None`: all.
    pub z_mm: Option<[f64; 2]>,
    /// What the operator has corrected.
    pub corrections: Corrections,
}

/// What is printed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Body {
    /// A hollow vessel with a wall of this thickness, mm.
    WallMm(f64),
    /// The lumen as a solid body.
    Cast,
}

/// Every parameter of a case, checked.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Where the contours come from.
    pub source: Source,
    /// How the lumen is found.
    pub segment: SegmentSettings,
    /// What is printed.
    pub body: Body,
    /// Which points of neighbouring sections correspond.
    pub correspondence: Correspondence,
    /// What the operator has decided about the topology.
    pub decisions: Decisions,
    /// Layer height, mm.
    pub layer_mm: f64,
    /// The printer's profile: a name, or the path of a profile file.
    pub profile: String,
    /// The printer's port: a path, or `sim`.
    pub port: String,
}
