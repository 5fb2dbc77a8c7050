//! The bead model: how width, spacing and cross-section of a bead belong together.
//!
//! A rectangular bead of width w and height h holds w h; its neighbours lie w away. A rounded one
//! (stadium) holds (w - h) h + pi h² / 4; laid w - h (1 - pi / 4) apart, neighbours press together into a
//! solid sheet of the right volume. That spacing is called the pitch.

use super::BeadPoint;
use crate::profile::BeadShape;
use std::f64::consts::FRAC_PI_4;

/// The cross-section of beads in a layer of one height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BeadModel {
    shape: BeadShape,
    height_mm: f64,
}

impl BeadModel {
    /// The model for beads of a shape in a layer of `height_mm`.
    #[must_use]
    pub const fn new(shape: BeadShape, height_mm: f64) -> Self {
        Self { shape, height_mm }
    }

    /// By how much neighbouring beads overlap in width, mm.
    #[must_use]
    pub fn overlap_mm(self) -> f64 {
        match self.shape {
            BeadShape::Rectangle => 0.0,
            BeadShape::Stadium => self.height_mm * (1.0 - FRAC_PI_4),
        }
    }

    /// Distance of neighbouring beads of a width, mm.
    #[must_use]
    pub fn pitch_mm(self, width_mm: f64) -> f64 {
        width_mm - self.overlap_mm()
    }

    /// Cross-section of a bead, mm²: what flows per millimetre of path.
    #[must_use]
    pub fn area_mm2(self, width_mm: f64) -> f64 {
        match self.shape {
            BeadShape::Rectangle => width_mm * self.height_mm,
            // Narrower than it is high, a bead is a round thread.
            BeadShape::Stadium if width_mm < self.height_mm => FRAC_PI_4 * width_mm * width_mm,
            BeadShape::Stadium => {
                (width_mm - self.height_mm) * self.height_mm + FRAC_PI_4 * self.height_mm * self.height_mm
            }
        }
    }

    /// What a segment from the first of two vertices to the second lays down, mm³.
    #[must_use]
    pub fn volume_mm3(self, pair: &[BeadPoint]) -> f64 {
        (pair[1].at - pair[0].at).norm() * self.area_mm2(pair[0].width_mm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sheet_of_beads_at_their_pitch_has_the_volume_of_the_sheet() {
        for shape in [BeadShape::Rectangle, BeadShape::Stadium] {
            let model = BeadModel::new(shape, 0.2);
            let per_height = model.area_mm2(0.45) / 0.2;
            assert!((per_height - model.pitch_mm(0.45)).abs() < 1e-12, "{shape:?}");
        }
    }

    #[test]
    fn stadium_area_is_continuous_where_it_becomes_a_thread() {
        let model = BeadModel::new(BeadShape::Stadium, 0.2);
        assert!((model.area_mm2(0.2 - 1e-9) - model.area_mm2(0.2 + 1e-9)).abs() < 1e-8);
    }
}
