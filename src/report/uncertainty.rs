//! What limits the accuracy of lengths, and what follows from it for the vessel's measures.

use super::anatomy::{Anatomy, StageMeasures};
use super::course::DIVISION_MM;
use super::deviation::{STEP_MM, rounded};
use super::image::median;
use super::stages::{PlaneWork, SECTION_TOLERANCE_MM};
use super::{Stage, strokes};
use serde::Serialize;

/// Grid of the boolean operations, mm.
const GRID_MM: f64 = 1e-5;

/// What limits the accuracy of lengths, mm. Figures of a stage rest on those of its two sides.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Uncertainty {
    /// A place of the boundary in the image: standard deviation of what contours that lie on it on average are off
    /// locally (noise, pixels); `null` without an image.
    #[serde(serialize_with = "rounded")]
    pub image_place: Option<f64>,
    /// Distance of the samples along the outlines; a maximum may miss a corner by half of it.
    pub sampling: f64,
    /// Chord error of the solid's sections.
    pub section: f64,
    /// Grid of the boolean operations that areas, Dice and IoU rest on.
    pub grid: f64,
    /// Round ends and joints of beads.
    pub bead: f64,
    /// Heights of divisions.
    pub division: f64,
}

impl Uncertainty {
    /// The local scatter of the boundary in the image: contours that follow it are off by it, wherever they lie on average.
    pub(super) fn of(planes: &[PlaneWork]) -> Self {
        let scatter = planes
            .iter()
            .filter_map(|p| p.comparisons[Stage::Segmentation as usize].as_ref().ok())
            .map(|c| {
                let n = c.distances_mm.len().max(1) as f64;
                let mean = c.distances_mm.iter().sum::<f64>() / n;
                (c.distances_mm.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / n).sqrt()
            });
        Self {
            image_place: median(scatter),
            sampling: STEP_MM,
            section: SECTION_TOLERANCE_MM,
            grid: GRID_MM,
            bead: strokes::ARC_MM,
            division: DIVISION_MM,
        }
    }

    /// Of a place on the outline that a stage has, mm.
    fn place_mm(&self, stage: &str, scanned_mm: Option<f64>) -> Option<f64> {
        match stage {
            "scanned" => scanned_mm,
            "image" => self.image_place,
            "contours" => Some(self.grid),
            "solid" | "layers" => Some(self.section),
            _ => Some(self.bead),
        }
    }

    /// Gives the vessel's measures theirs; `scanned_mm` is that of a place in a scan of the replica.
    pub(super) fn state(&self, anatomy: &mut Anatomy, scanned_mm: Option<f64>) {
        for stage in anatomy.branches.iter_mut().flat_map(|b| &mut b.stages) {
            if let Some(place_mm) = self.place_mm(stage.stage, scanned_mm) {
                state(stage, place_mm);
            }
        }
    }
}

/// Both ends of a diameter, and all of an outline, may be off the same way.
fn state(measures: &mut StageMeasures, place_mm: f64) {
    let diameter_mm = 2.0 * place_mm;
    measures.diameter_uncertainty_mm = measures.minimum_diameter_mm.map(|_| diameter_mm);
    measures.lumen_area_uncertainty_mm2 =
        measures.equivalent_diameter_mm.map(|d| std::f64::consts::PI * d * place_mm);
    let stenosis = &mut measures.stenosis;
    stenosis.stenosis_uncertainty_percent =
        stenosis.stenosis_throat.zip(stenosis.stenosis_reference).map(|(throat, reference)| {
            let part = throat.diameter_mm / reference.diameter_mm;
            100.0 * diameter_mm / reference.diameter_mm * part.hypot(1.0)
        });
}

#[cfg(test)]
mod tests {
    use super::super::{Branch, Reference, Throat};
    use super::*;

    #[test]
    fn measures_are_as_uncertain_as_the_places_that_they_rest_on() {
        let mut measures = StageMeasures {
            stage: "image",
            equivalent_diameter_mm: Some(4.0),
            minimum_diameter_mm: Some(2.0),
            ..StageMeasures::default()
        };
        measures.stenosis.stenosis_throat = Some(Throat { plane: 3, z_mm: 9.0, diameter_mm: 2.0 });
        measures.stenosis.stenosis_reference = Some(Reference { planes: [5, 7], diameter_mm: 4.0 });
        let branch = Branch { stages: vec![measures], ..Branch::default() };
        let mut anatomy = Anatomy { branches: vec![branch], divisions: Vec::new() };
        let mut uncertainty = Uncertainty { image_place: Some(0.05), ..Uncertainty::of(&[]) };
        uncertainty.state(&mut anatomy, None);
        let found = &anatomy.branches[0].stages[0];
        let is = |value: Option<f64>, expected: f64| value.is_some_and(|v| (v - expected).abs() < 1e-9);
        assert!(is(found.diameter_uncertainty_mm, 0.1));
        assert!(is(found.lumen_area_uncertainty_mm2, 0.2 * std::f64::consts::PI));
        // Throat and reference are both off by 0.1 mm: 2.5 percentage points, half of that more for the reference.
        assert!(is(found.stenosis.stenosis_uncertainty_percent, 2.5 * 1.25f64.sqrt()));
        uncertainty.image_place = None;
        let mut unknown = anatomy.clone();
        unknown.branches[0].stages[0].diameter_uncertainty_mm = None;
        uncertainty.state(&mut unknown, None);
        assert_eq!(unknown.branches[0].stages[0].diameter_uncertainty_mm, None);
    }
}
