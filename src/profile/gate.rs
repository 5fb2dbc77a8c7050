//! What a replica must keep to: the table `[gate]` of a profile.
//!
//! It is read by itself and is no part of [`Profile`]: what a finished print is judged by changes neither job nor print.

use super::{Error, Profile};
use serde::{Deserialize, Serialize};

/// Name of the table.
pub(super) const TABLE: &str = "gate";

/// The limits that a replica must keep to pass.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gate {
    /// Total 95th percentile, mm; what is beyond it, but within a pixel of the image, is not judged.
    pub total_p95_mm: f64,
    /// Mean distance of every stage, mm; against the image, what is within half a pixel is not judged.
    pub stage_mean_mm: f64,
    /// Least overlap (Dice) of the deposited lumen with that of the image.
    pub total_dice: f64,
    /// Least IoU of deposited against planned material, each layer.
    pub layer_iou: f64,
    /// Farthest that a stage's outline may lie off the one before on any plane, mm; against the image, what is within half
    /// a pixel is not judged.
    pub outline_mm: f64,
    /// Farthest that the deposited lumen's volume may be off that of the contours, percent.
    pub lumen_volume_percent: f64,
    /// Farthest that a branch's least diameter may be off that of the contours as deposited, percent.
    pub diameter_percent: f64,
    /// Farthest that a degree of stenosis (NASCET) may be off that of the contours as deposited, percentage points.
    pub stenosis_points: f64,
    /// Least thickness of the deposited wall, percent of the solid's least.
    pub wall_percent: f64,
    /// Farthest that a layer may lie beside its place, mm.
    pub layer_shift_mm: f64,
    /// Farthest that a layer's material may be off the planned amount, percent.
    pub flow_percent: f64,
    /// Most material beside the planned beads, outside of the lumen, mm³; in the lumen none is allowed.
    pub extra_mm3: f64,
}

/// A profile and its gate: all that a profile's file says.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Whole {
    /// What job and print depend on.
    #[serde(flatten)]
    pub profile: Profile,
    /// What the report judges by.
    pub gate: Gate,
}

/// The gate of a built-in profile.
///
/// # Errors
/// [`Error::UnknownName`].
pub fn builtin(name: &str) -> Result<Gate, Error> {
    Ok(super::builtin_whole(name)?.gate)
}
