//! What limits the accuracy of lengths, and what follows from it for the vessel's measures and for the figures of the stages.
//!
//! A figure of a stage has three parts, added by their squares. Sampling: half of what it differs between every second sample and
//! the others. What all places of an outline have in common (chords, round ends of beads, the pose of a scan): in full. What differs from
//! place to place (the boundary in the image: noise and pixels; a scan's voxels): in full for the maximum and the 95th percentile, which
//! rest on few places; for figures that all places share over the root of the number of planes, which are
//! independent images. Dice and area: that length times the outlines' length, over the areas. What all planes of an image have in common (the half-way
//! level, the model of its blur) is in none of them.

use super::anatomy::{Anatomy, StageMeasures};
use super::course::Angles;
use super::course::DIVISION_MM;
use super::deviation::{Areas, Comparison, FigureUncertainty, Figures, STEP_MM, rounded};
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
    pub(super) fn place_mm(&self, stage: &str, scanned_mm: Option<f64>) -> Option<f64> {
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
        for angles in anatomy.divisions.iter_mut().flat_map(|d| &mut d.angles) {
            if let Some(place_mm) = self.place_mm(angles.stage, scanned_mm) {
                state_angles(angles, place_mm);
            }
        }
    }

    /// How well the outlines of both sides of a stage are known; `None` where that is not known of the image.
    pub(super) fn sides(&self, stage: Stage) -> Option<Sides> {
        let common = |one_mm: f64, other_mm: f64| Sides { common_mm: one_mm.hypot(other_mm), local_mm: 0.0 };
        let image = |other_mm| self.image_place.map(|local_mm| Sides { common_mm: other_mm, local_mm });
        match stage {
            Stage::Segmentation => image(self.grid),
            Stage::Reconstruction => Some(common(self.grid, self.section)),
            Stage::Slicing => Some(common(self.section, self.section)),
            Stage::Toolpath => Some(common(self.section, self.bead)),
            Stage::Deposition => Some(common(self.bead, self.bead)),
            Stage::Total => image(self.bead),
            Stage::Scan => None,
        }
    }
}

/// How well a place of the two outlines of a stage is known, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sides {
    /// What all places have in common.
    pub(super) common_mm: f64,
    /// What differs from place to place, and from plane to plane.
    pub(super) local_mm: f64,
}

impl Sides {
    /// Of figures that rest on these planes; `areas` are those that Dice and area were taken from.
    pub(super) fn of(
        self,
        figures: &Figures,
        planes: &[&Comparison],
        areas: Option<Areas>,
    ) -> FigureUncertainty {
        let shared_mm = self.common_mm.hypot(self.local_mm / (planes.len().max(1) as f64).sqrt());
        let single_mm = self.common_mm.hypot(self.local_mm);
        let halves = [0, 1].map(|odd| every_second(planes, odd));
        let with = |value: fn(&Figures) -> Option<f64>, sides_mm: f64| {
            let [even, odd] = halves.each_ref().map(value);
            let sampling = even.zip(odd).map_or(0.0, |(a, b)| 0.5 * (a - b));
            value(figures).map(|_| sampling.hypot(sides_mm))
        };
        // Both sides are known together: either outline of them moves by it.
        let off_mm2 = areas.map(|a| 0.5 * a.outlines_mm * shared_mm);
        let both_mm2 = areas.map(|a| a.reference_mm2 + a.tested_mm2).filter(|a| *a > 0.0);
        let reference_mm2 = areas.map(|a| a.reference_mm2).filter(|a| *a > 0.0);
        FigureUncertainty {
            mean_mm: with(|f| f.mean_mm, shared_mm),
            rms_mm: with(|f| f.rms_mm, shared_mm),
            bias_mm: with(|f| f.bias_mm, shared_mm),
            p95_mm: with(|f| f.p95_mm, single_mm),
            max_mm: with(|f| f.max_mm, single_mm),
            dice: figures.dice.and(off_mm2.zip(both_mm2).map(|(off, both)| off / both)),
            area_error_percent: figures
                .area_error_percent
                .and(off_mm2.zip(reference_mm2).map(|(off, area)| 100.0 * off / area)),
        }
    }
}

/// The figures of every second sample of each plane.
fn every_second(planes: &[&Comparison], odd: usize) -> Figures {
    let of = |c: &&Comparison| c.distances_mm.iter().skip(odd).step_by(2).copied().collect::<Vec<_>>();
    Figures::of_distances(&planes.iter().flat_map(of).collect::<Vec<_>>())
}

/// The two directions that are least sure.
fn state_angles(angles: &mut Angles, place_mm: f64) {
    let mut off: Vec<f64> =
        angles.directions.iter().map(|d| d.scatter.hypot(d.per_mm * place_mm).to_degrees()).collect();
    off.sort_by(|a, b| b.total_cmp(a));
    angles.uncertainty_deg = if let [a, b, ..] = off[..] { Some(a.hypot(b)) } else { None };
}

/// Both ends of a diameter, and all of an outline, may be off the same way.
fn state(measures: &mut StageMeasures, place_mm: f64) {
    let diameter_mm = 2.0 * place_mm;
    measures.diameter_uncertainty_mm = measures.minimum_diameter_mm.map(|_| diameter_mm);
    measures.lumen_area_uncertainty_mm2 =
        measures.equivalent_diameter_mm.map(|d| std::f64::consts::PI * d * place_mm);
    let line = &mut measures.centreline;
    // Its length by its own uncertainty, its ends by their places.
    line.tortuosity_uncertainty = line.tortuosity.zip(line.chord_mm).map(|(_, chord_mm)| {
        line.length_uncertainty_mm.unwrap_or(0.0).hypot(2f64.sqrt() * place_mm) / chord_mm
    });
    let round = |area_mm2: f64| (4.0 * std::f64::consts::PI * area_mm2).sqrt() * place_mm / area_mm2;
    let stenosis = &mut measures.stenosis;
    stenosis.stenosis_area_uncertainty_percent =
        stenosis.stenosis_throat.zip(stenosis.stenosis_reference).map(|(throat, reference)| {
            let part = throat.lumen_area_mm2 / reference.lumen_area_mm2;
            100.0 * part * round(throat.lumen_area_mm2).hypot(round(reference.lumen_area_mm2))
        });
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
        measures.stenosis.stenosis_throat =
            Some(Throat { plane: 3, z_mm: 9.0, diameter_mm: 2.0, lumen_area_mm2: std::f64::consts::PI });
        measures.stenosis.stenosis_reference =
            Some(Reference { planes: [5, 7], diameter_mm: 4.0, lumen_area_mm2: 4.0 * std::f64::consts::PI });
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
        // A quarter of the area: its throat is known to 10 %, its reference to 5 %.
        assert!(is(found.stenosis.stenosis_area_uncertainty_percent, 25.0 * 0.1f64.hypot(0.05)));
        uncertainty.image_place = None;
        let mut unknown = anatomy.clone();
        unknown.branches[0].stages[0].diameter_uncertainty_mm = None;
        uncertainty.state(&mut unknown, None);
        assert_eq!(unknown.branches[0].stages[0].diameter_uncertainty_mm, None);
    }

    #[test]
    fn figures_are_as_uncertain_as_their_sides_and_their_samples() {
        let plane = Comparison { distances_mm: vec![0.1, 0.2, 0.1, 0.2], ..Comparison::default() };
        let areas = Areas { reference_mm2: 10.0, tested_mm2: 10.0, common_mm2: 9.0, outlines_mm: 20.0 };
        let planes = [&plane; 4];
        let figures = Figures { dice: Some(0.9), ..Figures::of(planes.into_iter()) };
        let sides = Sides { common_mm: 0.03, local_mm: 0.08 };
        let found = sides.of(&figures, &planes, Some(areas));
        let is = |value: Option<f64>, expected: f64| value.is_some_and(|v| (v - expected).abs() < 1e-9);
        // Sampling 0.05, common 0.03; local 0.08 for the single place, 0.04 for what four planes share.
        assert!(is(found.mean_mm, 0.05f64.hypot(0.03).hypot(0.04)), "{found:?}");
        assert!(is(found.max_mm, 0.05f64.hypot(0.03).hypot(0.08)), "{found:?}");
        // 10 mm of outline off by 0.05 mm, of 20 mm².
        assert!(is(found.dice, 0.025) && found.area_error_percent.is_none(), "{found:?}");
        assert_eq!(sides.of(&Figures::default(), &[], None), FigureUncertainty::default());
    }
}
