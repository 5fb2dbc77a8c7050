//! Closed contours per CT plane: the type, its exchange format, and how it is got from mask and grey values.

#[cfg(test)]
mod accuracy;
mod base;
mod consistency;
mod curve;
mod denoise;
mod detached;
pub(crate) mod edge;
pub mod extract;
mod fit;
pub mod format;
pub(crate) mod march;
mod model;
mod modelled;
mod outline;
mod parting;
pub mod picture;
pub mod ready;
mod refine;
mod spikes;
#[cfg(test)]
mod tests;
mod warnings;

pub use extract::{Boundary, Error, Extracted, Params, extract};

use crate::geom::{Contour, Region, RigidTransform};
use serde::{Deserialize, Serialize};

/// The contours of one plane.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlaneSections {
    /// Height of the plane in the stack frame, mm.
    pub z_mm: f64,
    /// Outer contours counter-clockwise seen from +z, holes clockwise; mm, stack frame.
    pub contours: Vec<Contour>,
}

impl PlaneSections {
    /// The region that the contours bound.
    #[must_use]
    pub fn region(&self) -> Region {
        Region::new(self.contours.clone())
    }
}

/// The contours of all planes, ascending in z.
#[derive(Debug, Clone, PartialEq)]
pub struct SectionStack {
    /// Planes in ascending order of z.
    pub planes: Vec<PlaneSections>,
    /// Where the stack lies in the patient (LPS); the identity for a transaxial CT.
    pub patient_from_stack: RigidTransform,
}

impl SectionStack {
    /// Heights of the planes, mm, ascending.
    #[must_use]
    pub fn plane_z_mm(&self) -> Vec<f64> {
        self.planes.iter().map(|p| p.z_mm).collect()
    }
}
