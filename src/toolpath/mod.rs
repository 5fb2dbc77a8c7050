//! Layers to beads and travels, in the bed frame.

use crate::geom::{Point2, Region, RigidTransform};
use crate::slice::LayerSlot;
use serde::{Deserialize, Serialize};

/// What a bead is for; the names are those that G-code viewers know.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum BeadKind {
    /// The contour at the outer skin or at the lumen.
    ExternalPerimeter,
    /// A contour inside the wall.
    Perimeter,
    /// Raster inside.
    InternalInfill,
    /// Raster of a floor or roof, or wherever the fill is 100 %.
    SolidInfill,
    /// Loops around the part that prime the nozzle or hold the part down.
    SkirtBrim,
}

impl BeadKind {
    /// The text behind `;TYPE:`.
    #[must_use]
    pub const fn gcode_name(self) -> &'static str {
        match self {
            Self::ExternalPerimeter => "External perimeter",
            Self::Perimeter => "Perimeter",
            Self::InternalInfill => "Internal infill",
            Self::SolidInfill => "Solid infill",
            Self::SkirtBrim => "Skirt/Brim",
        }
    }
}

/// A vertex of a bead's centre line, with the width of the bead there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BeadPoint {
    /// Place on the bed, mm.
    pub at: Point2,
    /// Extrusion width from here to the next vertex, mm.
    pub width_mm: f64,
}

/// An extruded path. A closed loop repeats its first point at the end.
#[derive(Debug, Clone, PartialEq)]
pub struct Bead {
    /// What it is for.
    pub kind: BeadKind,
    /// Its centre line.
    pub points: Vec<BeadPoint>,
}

/// The beads of one layer in the order in which they are printed.
#[derive(Debug, Clone, PartialEq)]
pub struct LayerPaths {
    /// The layer's place in the grid (stack frame heights).
    pub slot: LayerSlot,
    /// Height of the nozzle above the bed while this layer is printed, mm: the layer's top.
    pub z_mm: f64,
    /// The beads in order.
    pub beads: Vec<Bead>,
    /// What was to be filled, on the bed: for the report and for travels.
    pub material: Region,
    /// The lumen on the bed: travels keep out of it where a way round exists.
    pub lumen: Region,
}

/// A whole job on the bed.
#[derive(Debug, Clone, PartialEq)]
pub struct Toolpaths {
    /// Where the stack lies on the bed: a translation.
    pub bed_from_stack: RigidTransform,
    /// Layers from the bed upward.
    pub layers: Vec<LayerPaths>,
}
