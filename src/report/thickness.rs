//! The wall around the lumen: how thick, and how well filled.
//!
//! From places [`STEP_MM`] apart along the lumen's outline the exact distance to the outline of the whole part is taken, in the
//! plane: where the wall stands obliquely, that is more than its thickness in space. Pores are not seen by it;
//! `filled_percent` tells them.

use super::deviation::{quantile, rounded};
use crate::geom::{Region, SegmentIndex};
use serde::Serialize;

/// Distance of the places along the lumen, mm.
const STEP_MM: f64 = 0.1;

/// The wall of one stage.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WallStage {
    /// `solid`, `layers`, `planned` or `recorded`.
    pub stage: &'static str,
    /// All planes together.
    pub overall: Option<Wall>,
    /// Plane by plane.
    pub planes: Vec<PlaneWall>,
}

/// The wall of one plane.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlaneWall {
    /// CT plane.
    pub plane: usize,
    /// The wall.
    #[serde(flatten)]
    pub wall: Wall,
}

/// Figures of a wall.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Wall {
    /// Mean thickness, mm.
    #[serde(serialize_with = "rounded")]
    pub mean_mm: Option<f64>,
    /// Least thickness, mm.
    #[serde(serialize_with = "rounded")]
    pub min_mm: Option<f64>,
    /// The thickness that 5 % of the places do not reach, mm.
    #[serde(serialize_with = "rounded")]
    pub p5_mm: Option<f64>,
    /// Largest thickness, mm.
    #[serde(serialize_with = "rounded")]
    pub max_mm: Option<f64>,
    /// Material over all between the outlines, percent.
    #[serde(serialize_with = "rounded")]
    pub filled_percent: Option<f64>,
}

/// What is measured of one plane before it is condensed.
#[derive(Debug, Clone, Default)]
pub(super) struct Measured {
    distances_mm: Vec<f64>,
    material_mm2: f64,
    between_mm2: f64,
}

/// Measures from the outline of `lumen` to that of all that `material` and lumen take together.
pub(super) fn measured(lumen: &Region, material: &Region) -> Measured {
    let whole = material.union(lumen).without_holes();
    let Some(index) = SegmentIndex::try_new(&whole.contours) else { return Measured::default() };
    let mut distances_mm = Vec::new();
    for contour in &lumen.contours {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "outlines of a vessel")]
        let n = (contour.perimeter_mm() / STEP_MM).ceil().clamp(12.0, 10_000.0) as usize;
        distances_mm.extend(contour.resampled(n).points.iter().map(|p| index.nearest(*p).distance_mm));
    }
    if lumen.is_empty() {
        return Measured::default();
    }
    Measured {
        distances_mm,
        material_mm2: material.difference(lumen).area_mm2(),
        between_mm2: whole.difference(lumen).area_mm2(),
    }
}

/// One stage, plane by plane; planes that have no wall are left out.
pub(super) fn stage(stage: &'static str, planes: &[Option<Measured>]) -> WallStage {
    let known = || planes.iter().flatten();
    let single = |(plane, own): (usize, &Option<Measured>)| {
        Some(PlaneWall { plane, wall: wall(std::iter::once(own.as_ref()?))? })
    };
    WallStage {
        stage,
        overall: wall(known()),
        planes: planes.iter().enumerate().filter_map(single).collect(),
    }
}

fn wall<'a>(planes: impl Iterator<Item = &'a Measured> + Clone) -> Option<Wall> {
    let mut all: Vec<f64> = planes.clone().flat_map(|p| p.distances_mm.iter().copied()).collect();
    all.sort_by(f64::total_cmp);
    let (material, between) = planes.fold((0.0, 0.0), |(m, b), p| (m + p.material_mm2, b + p.between_mm2));
    (!all.is_empty()).then(|| Wall {
        mean_mm: Some(all.iter().sum::<f64>() / all.len() as f64),
        min_mm: all.first().copied(),
        p5_mm: Some(quantile(&all, 0.05)),
        max_mm: all.last().copied(),
        filled_percent: (between > 0.0).then(|| 100.0 * material / between),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{Contour, Point2};

    #[test]
    fn an_eccentric_ring_has_its_thickness_and_its_pores() {
        let disk = |x: f64, r: f64| Region::new(vec![Contour::circle(Point2::new(x, 0.0), r, 1440)]);
        let (lumen, pore) = (disk(0.0, 3.0), disk(3.6, 0.2));
        let ring = disk(0.2, 4.2).difference(&lumen).difference(&pore);
        let found = stage("recorded", &[None, Some(measured(&lumen, &ring))]);
        let wall = found.planes[0].wall;
        assert_eq!((found.planes[0].plane, found.planes.len()), (1, 1));
        // Along the radius of the outer circle the distance is R - |p - c|: mean over the inner circle 1.2 - e² / (4 r).
        let near = |value: Option<f64>, expected: f64| (value.unwrap() - expected).abs() < 1e-3;
        assert!(near(wall.min_mm, 1.0) && near(wall.max_mm, 1.4), "{wall:?}");
        assert!(near(wall.mean_mm, 1.2 - 0.04 / 12.0), "{wall:?}");
        let between = std::f64::consts::PI * (4.2 * 4.2 - 9.0);
        let filled = 100.0 * (1.0 - std::f64::consts::PI * 0.04 / between);
        assert!((wall.filled_percent.unwrap() - filled).abs() < 0.01, "{wall:?}");
        assert_eq!(found.overall, Some(wall));
    }
}
