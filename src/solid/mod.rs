//! The boundary representation of the vessel and its exact sections.

use crate::geom::Region;

/// What a horizontal plane cuts out of the body. Stack frame, mm.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CrossSection {
    /// What is enclosed by the outer skin (for a cast: by the lumen's skin, which is then the outer one).
    pub outer: Region,
    /// The lumen inside a hollow wall; empty for a cast.
    pub lumen: Region,
}

impl CrossSection {
    /// What is to be filled with material: the outer region without the lumen.
    #[must_use]
    pub fn material(&self) -> Region {
        self.outer.difference(&self.lumen)
    }
}

/// A body that can be cut at any height.
pub trait Sectioned: Sync {
    /// Lowest and highest z of the body in the stack frame, mm.
    fn z_range_mm(&self) -> [f64; 2];

    /// The section at `z_mm`; the polygons' vertices lie on the surface, their chords within `tolerance_mm` of it.
    /// Empty outside the z range.
    fn section(&self, z_mm: f64, tolerance_mm: f64) -> CrossSection;
}
