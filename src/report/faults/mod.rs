//! Defects: what is wrong, which stage it arose in, where, how much.
//!
//! Pure detectors over what the comparison has. `deposition`: recorded against planned beads, layer by layer. `outlines`:
//! the outlines of one stage against those of the stage before, plane by plane and branch by branch. `branches`: lumina
//! that one stage has and the next has not. `local`: a part of an outline that lies off, and the calibre. `order`: planes in a wrong order, mirrored images and parts.
//!
//! Where a stage deviates and the next one deviates back by as much, the defect belongs to the first: what came after it
//! was not made from it. Findings never change the figures: nothing is fitted away.
//!
//! What cannot be known here is said in [`NOT_SEEN`].

mod bead;
mod branches;
mod deposition;
mod heights;
mod local;
mod matched;
mod order;
mod outlines;
mod series;
mod similarity;
#[cfg(test)]
mod tests;

pub(super) use branches::{Made, changed_islands, odd_layers, plugged};
pub(super) use deposition::{deposited, volumes_mm3};
pub(super) use local::{Allowed, calibres, stretches};
pub(super) use order::{BrokenCourse, Compared, Seen, broken_course, out_of_order, unlike, unlike_image};
pub(super) use outlines::{Ends, StagePair, moved, plane_runs, without_echoes};

use super::deviation::rounded;
use crate::slice::LayerSlot;
use serde::Serialize;

/// What no comparison of this kind can see, for the reader.
pub const NOT_SEEN: [&str; 5] = [
    "An image that is mirrored, or whose planes are all in reverse order, before it was segmented: image, contours and replica then agree. Compare the orientation letters with the patient.",
    "Planes exchanged before the segmentation are seen only where the vessel's course breaks; a straight vessel looks the same in any order.",
    "A lumen that the image does not show, or shows beside the contours by more than a few pixels, where no contour leads there.",
    "What the solid does between two CT planes, unless it closes the lumen: there is no image to compare it with. Branches that were joined the wrong way between two planes look right in both.",
    "What a printer does beyond its record: the deposition is what was recorded, or only what was commanded. What was really made is seen where a scan of the replica is given, as far as its voxels and blur show it.",
];

/// What kind of defect.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// The boundary lies inward or outward all round, mm (outward positive).
    BoundaryMoved,
    /// The outline lies beside its place, mm.
    OutlineShifted,
    /// A part of the outline lies off, mm (outward positive).
    PartOff,
    /// The lumen is wider or narrower, percent of its diameter.
    CalibreOff,
    /// Larger or smaller, percent.
    Scaled,
    /// Heights larger or smaller, percent.
    Stretched,
    /// Turned about the vertical, degrees.
    Turned,
    /// A mirror image.
    Mirrored,
    /// Planes of other places.
    WrongPlaneOrder,
    /// The lumen of a branch is closed.
    Plugged,
    /// An island within the lumen is gone, mm².
    IslandLost,
    /// An island within the lumen was added, mm².
    IslandAdded,
    /// From a layer on all lies beside its place, mm.
    LayerShift,
    /// Layers lie beside their places more and more, mm at the worst.
    GradualShift,
    /// Less material than planned, percent.
    UnderExtrusion,
    /// More material than planned, percent.
    OverExtrusion,
    /// Layers without material, number.
    MissingLayers,
    /// Nothing from a layer to the top, number of layers.
    PrintStopped,
    /// Some of the beads of layers are missing, percent of their length.
    MissingBeads,
    /// The model's material is not there, mm³.
    MissingMaterial,
    /// Material in the open lumen, mm³.
    MaterialInLumen,
    /// Material beside the part, mm³.
    MaterialOutside,
    /// Material in the wall that was not planned, mm³.
    MaterialInWall,
    /// Layers lie too high or too low, mm.
    WrongHeight,
    /// Layers are thicker or thinner, percent.
    LayerThickness,
    /// Material at heights that belong to no layer, mm³.
    BetweenLayers,
    /// The recorded lines are not the planned ones.
    Unrecognised,
}

/// A size with its unit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Size {
    /// The size.
    #[serde(serialize_with = "rounded_value")]
    pub size: f64,
    /// `mm`, `percent`, `degrees`, `mm2`, `mm3`, `layers` or `planes`.
    pub unit: &'static str,
    /// Standard uncertainty of the size.
    #[serde(serialize_with = "rounded_value")]
    pub uncertainty: f64,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
fn rounded_value<S: serde::Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    rounded(&Some(*value), serializer)
}

/// Where a defect is.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Place {
    /// First and last layer, 0 on the bed.
    pub layers: Option<[usize; 2]>,
    /// First and last CT plane.
    pub planes: Option<[usize; 2]>,
    /// From where to where, stack frame, mm.
    pub z_mm: Option<[f64; 2]>,
    /// The branch, where not all are meant.
    pub branch: Option<String>,
}

impl Place {
    /// Layers and the CT planes among them.
    pub(super) fn of_layers(slots: &[LayerSlot], first: usize, last: usize) -> Self {
        let own = &slots[first..=last];
        let planes: Vec<usize> = own.iter().filter_map(|s| s.ct_plane).collect();
        let low = own[0].z_mid_mm - 0.5 * own[0].height_mm;
        let high = own[own.len() - 1].z_mid_mm + 0.5 * own[own.len() - 1].height_mm;
        Self {
            layers: Some([first, last]),
            planes: planes.first().zip(planes.last()).map(|(&a, &b)| [a, b]),
            z_mm: Some([low, high]),
            branch: None,
        }
    }

    /// CT planes.
    pub(super) fn of_planes(z_mm: &[f64], first: usize, last: usize) -> Self {
        Self {
            layers: None,
            planes: Some([first, last]),
            z_mm: Some([z_mm[first], z_mm[last]]),
            branch: None,
        }
    }
}

/// A defect.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// Where it arose: `image`, or one of the stages' names.
    pub stage: &'static str,
    /// What it is.
    pub kind: Kind,
    /// Where it is.
    #[serde(flatten)]
    pub place: Place,
    /// How large it is.
    #[serde(flatten)]
    pub size: Option<Size>,
    /// Which way, bed or stack frame (their axes are parallel), mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vector_mm: Option<[f64; 2]>,
    /// Whether it is beyond what the gate allows.
    pub beyond_gate: bool,
    /// Whether pixels or voxels tell it from what the gate allows; what they do not is not judged.
    pub judged: bool,
    /// The whole in one sentence.
    pub text: String,
}

/// `layer 7`, `layers 7 to 12`.
pub(super) fn told(what: &str, [first, last]: [usize; 2]) -> String {
    if first == last { format!("{what} {first}") } else { format!("{what}s {first} to {last}") }
}
