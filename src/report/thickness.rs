//! The wall around the lumen: how thick, and how well filled.
//!
//! From places [`STEP_MM`] apart along the lumen's outline the exact distance to the outline of the whole part is taken, in the
//! plane: where the wall stands obliquely, that is more than its thickness in space. Pores are not seen by it;
//! `filled_percent` tells them.

use super::deviation::{quantile, rounded};
use crate::geom::{Contour, Region, SegmentIndex};
use serde::Serialize;

/// Distance of the places along the lumen, mm.
const STEP_MM: f64 = 0.1;

/// The wall of one stage.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WallStage {
    /// `solid`, `layers`, `planned`, `recorded` or `scanned`.
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
    /// How uncertain each of them is.
    pub uncertainty: WallUncertainty,
}

/// Standard uncertainties of [`Wall`]: both outlines as this stage has them, and the places along the lumen.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct WallUncertainty {
    /// Of the mean, mm.
    #[serde(serialize_with = "rounded")]
    pub mean_mm: Option<f64>,
    /// Of the least, mm.
    #[serde(serialize_with = "rounded")]
    pub min_mm: Option<f64>,
    /// Of the thickness that 5 % do not reach, mm.
    #[serde(serialize_with = "rounded")]
    pub p5_mm: Option<f64>,
    /// Of the largest, mm.
    #[serde(serialize_with = "rounded")]
    pub max_mm: Option<f64>,
    /// Of the filled part, percentage points.
    #[serde(serialize_with = "rounded")]
    pub filled_percent: Option<f64>,
}

/// What is measured of one plane before it is condensed.
#[derive(Debug, Clone, Default)]
pub(super) struct Measured {
    distances_mm: Vec<f64>,
    material_mm2: f64,
    between_mm2: f64,
    outlines_mm: f64,
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
        outlines_mm: material.contours.iter().map(Contour::perimeter_mm).sum(),
    }
}

/// One stage, plane by plane; planes that have no wall are left out. `place_mm` is how well a place of its outlines is known.
pub(super) fn stage(stage: &'static str, planes: &[Option<Measured>], place_mm: Option<f64>) -> WallStage {
    let of = |own: &[&Measured]| {
        let wall = figures(own, |_| true)?;
        let uncertainty = place_mm.map_or_else(WallUncertainty::default, |mm| uncertainty(own, wall, mm));
        Some(Wall { uncertainty, ..wall })
    };
    let single =
        |(plane, own): (usize, &Option<Measured>)| Some(PlaneWall { plane, wall: of(&[own.as_ref()?])? });
    WallStage {
        stage,
        overall: of(&planes.iter().flatten().collect::<Vec<_>>()),
        planes: planes.iter().enumerate().filter_map(single).collect(),
    }
}

/// The figures of the places whose number along the lumen is `taken`.
fn figures(planes: &[&Measured], taken: fn(usize) -> bool) -> Option<Wall> {
    let of = |p: &&Measured| {
        p.distances_mm.iter().enumerate().filter(|(i, _)| taken(*i)).map(|(_, d)| *d).collect::<Vec<_>>()
    };
    let mut all: Vec<f64> = planes.iter().flat_map(of).collect();
    all.sort_by(f64::total_cmp);
    let (material, between) =
        planes.iter().fold((0.0, 0.0), |(m, b), p| (m + p.material_mm2, b + p.between_mm2));
    (!all.is_empty()).then(|| Wall {
        mean_mm: Some(all.iter().sum::<f64>() / all.len() as f64),
        min_mm: all.first().copied(),
        p5_mm: Some(quantile(&all, 0.05)),
        max_mm: all.last().copied(),
        filled_percent: (between > 0.0).then(|| 100.0 * material / between),
        uncertainty: WallUncertainty::default(),
    })
}

/// Half of what the figure differs between every second place and the others, and both outlines, which may be off the same way.
fn uncertainty(planes: &[&Measured], wall: Wall, place_mm: f64) -> WallUncertainty {
    let halves = [figures(planes, |i| i % 2 == 0), figures(planes, |i| i % 2 == 1)];
    let both_mm = place_mm * 2f64.sqrt();
    let of = |value: fn(&Wall) -> Option<f64>| {
        let [even, odd] = halves.map(|h| h.as_ref().and_then(value));
        even.zip(odd).map(|(a, b)| (0.5 * (a - b)).hypot(both_mm))
    };
    let (outlines, between) =
        planes.iter().fold((0.0, 0.0), |(o, b), p| (o + p.outlines_mm, b + p.between_mm2));
    WallUncertainty {
        mean_mm: of(|w| w.mean_mm),
        min_mm: of(|w| w.min_mm),
        p5_mm: of(|w| w.p5_mm),
        max_mm: of(|w| w.max_mm),
        filled_percent: wall.filled_percent.map(|_| 100.0 * outlines * place_mm / between),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Point2;

    #[test]
    fn an_eccentric_ring_has_its_thickness_and_its_pores() {
        let disk = |x: f64, r: f64| Region::new(vec![Contour::circle(Point2::new(x, 0.0), r, 1440)]);
        let (lumen, pore) = (disk(0.0, 3.0), disk(3.6, 0.2));
        let ring = disk(0.2, 4.2).difference(&lumen).difference(&pore);
        let found = stage("recorded", &[None, Some(measured(&lumen, &ring))], Some(0.01));
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
        // Both outlines are known to 0.01 mm; neighbouring places differ by less than their distance tells.
        let off = wall.uncertainty;
        assert!(
            (0.0141..0.0142).contains(&off.mean_mm.unwrap()) && (0.0141..0.02).contains(&off.min_mm.unwrap()),
            "{off:?}"
        );
        assert!(off.filled_percent.unwrap() > 0.0);
        assert_eq!(
            stage("recorded", &[Some(measured(&lumen, &ring))], None).planes[0].wall.uncertainty,
            WallUncertainty::default()
        );
    }
}
