//! Outlines that lie off at a part of their length only: a dent, a bulge, a piece that another stage does not have.
//!
//! Offset and shift of an outline are fitted robustly, so that a part of it may lie anywhere. Here stretches of the samples that lie
//! farther off than is allowed are sought, along the outline; a stretch shorter than [`STRETCH_MM`] is a corner. And the diameter of
//! the circle of the same area is compared, branch by branch.

use super::outlines::{StagePair, plane_runs};
use super::{Finding, Kind, Place, Size, told};
use crate::geom::{Point2, Region};
use crate::report::deviation::{Comparison, STEP_MM};
use std::ops::Range;

/// Shortest stretch of an outline that counts, mm, or pixels.
const STRETCH_MM: f64 = 1.0;
const STRETCH_PIXELS: f64 = 2.0;
/// A stretch is told by the outline's offset or shift where it lies off by less than this many times as much.
const TOLD_BY_WHOLE: f64 = 1.5;

/// What the outlines of a stage are allowed.
#[derive(Debug, Clone, Copy)]
pub(in crate::report) struct Allowed {
    /// Farther off than this, a stretch is told, mm.
    pub(in crate::report) outline_mm: f64,
    /// More than this, a diameter is told, percent.
    pub(in crate::report) diameter_percent: f64,
    /// Side of the image's pixels, mm; 0 between exact outlines.
    pub(in crate::report) pixel_mm: f64,
}

/// Stretches that lie off, plane by plane; `known` are the stage's other findings.
pub(in crate::report) fn stretches(
    pair: &StagePair<'_>,
    planes: &[Option<&Comparison>],
    z_mm: &[f64],
    allowed: Allowed,
    known: &[Finding],
) -> Vec<Finding> {
    let least_mm = allowed.outline_mm.max(allowed.pixel_mm);
    let length_mm = STRETCH_MM.max(STRETCH_PIXELS * allowed.pixel_mm);
    let farthest = |k: usize| {
        let off_mm = worst_stretch(planes[k]?, pair.meant_mm, least_mm, length_mm)?;
        (!is_told(known, k, off_mm)).then_some(off_mm)
    };
    let off: Vec<Option<f64>> = (0..planes.len()).map(farthest).collect();
    let found: Vec<usize> = (0..planes.len()).filter(|&k| off[k].is_some()).collect();
    let finding = |[first, last]: [usize; 2]| {
        let most = off[first..=last].iter().flatten().copied().max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
        let [from, to] = pair.stage.sides();
        let way = if most > 0.0 { "outside" } else { "inside" };
        let text = format!(
            "a part of {to} lies up to {:.3} mm {way} of {from}, {}",
            most.abs(),
            told("plane", [first, last])
        );
        let uncertainty = (0.3 * allowed.pixel_mm).max(0.5 * STEP_MM);
        let size = Size { size: most, unit: "mm", uncertainty };
        Some(pair.finding(Kind::PartOff, Place::of_planes(z_mm, first, last), size, text))
    };
    plane_runs(&found).into_iter().filter_map(finding).collect()
}

/// The signed distance farthest off among stretches of samples that all lie off by more than `least_mm`, the same way.
fn worst_stretch(comparison: &Comparison, meant_mm: f64, least_mm: f64, length_mm: f64) -> Option<f64> {
    let of_chain = |chain: Range<usize>| {
        let mut off_mm: Vec<f64> =
            comparison.distances_mm[chain.clone()].iter().map(|d| d - meant_mm).collect();
        if follows(&comparison.places, chain.end - 1, chain.start) {
            // It has no start: a stretch that goes on beyond it is one.
            let first = off_mm.iter().position(|d| d.abs() <= least_mm).unwrap_or(0);
            off_mm.rotate_left(first);
        }
        worst_of_line(&off_mm, least_mm, length_mm)
    };
    let worst = chains(&comparison.places).into_iter().filter_map(of_chain);
    worst.max_by(|a, b| a.abs().total_cmp(&b.abs()))
}

/// Samples that follow one another along one outline: contours, and the two ways, have nothing to do with each other.
fn chains(places: &[Point2]) -> Vec<Range<usize>> {
    let breaks = (1..places.len()).filter(|&i| !follows(places, i - 1, i));
    let starts: Vec<usize> = std::iter::once(0).chain(breaks).collect();
    let ends = starts.iter().skip(1).copied().chain([places.len()]);
    starts.iter().copied().zip(ends).map(|(a, b)| a..b).filter(|c| !c.is_empty()).collect()
}

/// Whether two samples are neighbours; where an outline closes they are up to one and a half steps apart.
fn follows(places: &[Point2], before: usize, after: usize) -> bool {
    (places[after] - places[before]).norm() < 1.6 * STEP_MM
}

fn worst_of_line(off_mm: &[f64], least_mm: f64, length_mm: f64) -> Option<f64> {
    let mut worst: Option<f64> = None;
    let (mut n, mut most): (usize, f64) = (0, 0.0);
    for distance in off_mm.iter().copied().chain([0.0]) {
        let goes_on = distance.abs() > least_mm && (n == 0 || distance * most > 0.0);
        if !goes_on {
            if n as f64 * STEP_MM >= length_mm && most.abs() > worst.map_or(0.0, f64::abs) {
                worst = Some(most);
            }
            (n, most) = (0, 0.0);
        }
        if distance.abs() > least_mm {
            n += 1;
            most = if distance.abs() > most.abs() { distance } else { most };
        }
    }
    worst
}

/// Whether the stage's other findings tell what lies off in a plane.
fn is_told(known: &[Finding], plane: usize, off_mm: f64) -> bool {
    let here = |f: &&Finding| f.place.planes.is_some_and(|[first, last]| (first..=last).contains(&plane));
    let of_whole: f64 = known
        .iter()
        .filter(here)
        .filter(|f| matches!(f.kind, Kind::BoundaryMoved | Kind::OutlineShifted))
        .filter_map(|f| f.size)
        .map(|s| s.size.abs())
        .sum();
    off_mm.abs() < TOLD_BY_WHOLE * of_whole
        || known.iter().filter(here).any(|f| !matches!(f.kind, Kind::BoundaryMoved | Kind::OutlineShifted))
}

/// Lumina wider or narrower than those of the stage before, by the diameter of the circle of the same area, where that is known.
pub(in crate::report) fn calibres(
    pair: &StagePair<'_>,
    names: &[String],
    planes: &[Option<&Comparison>],
    z_mm: &[f64],
    allowed: Allowed,
    known: &[Finding],
) -> Vec<Finding> {
    let diameter_mm = |region: &Region| 2.0 * (region.area_mm2() / std::f64::consts::PI).sqrt();
    let mut findings = Vec::new();
    for (branch, name) in names.iter().enumerate() {
        let off = |k: usize| {
            // Where too little of a boundary was seen, what it encloses is not known.
            planes[k]?.areas?;
            let (reference, tested) = (pair.reference[k][branch].as_ref()?, pair.tested[k][branch].as_ref()?);
            let (meant, own) = (diameter_mm(reference), diameter_mm(tested));
            let (by_mm, percent) = (own - meant, 100.0 * (own / meant - 1.0));
            let is_off = percent.abs() > allowed.diameter_percent && 0.5 * by_mm.abs() > pair.least_mm;
            (is_off && !is_told(known, k, 0.5 * by_mm)).then_some((percent, by_mm))
        };
        let off: Vec<Option<(f64, f64)>> = (0..z_mm.len()).map(off).collect();
        let found: Vec<usize> = (0..off.len()).filter(|&k| off[k].is_some()).collect();
        let finding = |[first, last]: [usize; 2]| {
            let all = off[first..=last].iter().flatten();
            let (percent, by_mm) = all.copied().max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))?;
            let [from, to] = pair.stage.sides();
            let than = if percent > 0.0 { "wider" } else { "narrower" };
            let text = format!(
                "{to} is up to {:.1} % {than} than {from} (diameter of the same area, {by_mm:+.2} mm), {}, {name}",
                percent.abs(),
                told("plane", [first, last])
            );
            let uncertainty = (100.0 * 0.3 * allowed.pixel_mm / (by_mm / (0.01 * percent))).abs();
            let size = Size { size: percent, unit: "percent", uncertainty };
            let place = Place { branch: Some(name.clone()), ..Place::of_planes(z_mm, first, last) };
            let found = pair.finding(Kind::CalibreOff, place, size, text);
            Some(Finding { judged: 0.5 * by_mm.abs() > pair.told_mm, ..found })
        };
        findings.extend(plane_runs(&found).into_iter().filter_map(finding));
    }
    findings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Contour;
    use crate::report::Stage;
    use crate::report::deviation::compare;

    fn circle(radius_mm: f64) -> Region {
        Region::new(vec![Contour::circle(Point2::origin(), radius_mm, 400)])
    }

    /// A circle of 3 mm with a dent about 2 mm long, its contour begun at another of its points.
    fn dented(start: usize) -> Region {
        let mut points = circle(3.0).contours[0].points.clone();
        for p in &mut points {
            let along = p.y.atan2(p.x) * 3.0;
            let depth_mm = 0.5 * (1.0 - along * along).max(0.0);
            *p -= p.coords * (depth_mm / p.coords.norm());
        }
        points.rotate_left(start);
        Region::new(vec![Contour::new(points)])
    }

    #[test]
    fn a_dent_is_found_wherever_the_contour_begins() {
        for start in (0..8).map(|i| 50 * i) {
            let comparison = compare(&circle(3.0).into(), &dented(start).into()).unwrap();
            let worst = worst_stretch(&comparison, 0.0, 0.15, 1.0).unwrap_or_else(|| panic!("{start}"));
            assert!((worst + 0.5).abs() < 0.02, "{start}: {worst}");
        }
    }

    #[test]
    fn the_end_of_a_contour_and_the_start_of_another_are_no_stretch() {
        let line = |x: f64| (0..12).map(move |i| Point2::new(x + STEP_MM * f64::from(i), 0.0));
        let pooled = Comparison {
            distances_mm: vec![0.4; 24],
            places: line(0.0).chain(line(9.0)).collect(),
            ..Comparison::default()
        };
        let length_mm = 18.0 * STEP_MM;
        assert_eq!(worst_stretch(&pooled, 0.0, 0.15, length_mm), None);
        assert!(worst_stretch(&pooled, 0.0, 0.15, 0.5 * length_mm).is_some());
    }

    #[test]
    fn of_a_boundary_that_was_hardly_seen_no_calibre_is_told() {
        let [image, contours] = [3.0, 3.6].map(|r| vec![vec![Some(circle(r))]]);
        let pair = StagePair {
            stage: Stage::Segmentation,
            reference: &image,
            tested: &contours,
            meant_mm: 0.0,
            least_mm: 0.05,
            gate_mm: 0.2,
            gate_percent: None,
            told_mm: 0.0,
            ends_mm: None,
        };
        let allowed = Allowed { outline_mm: 0.2, diameter_percent: 5.0, pixel_mm: 0.3 };
        let seen = compare(&circle(3.0).into(), &circle(3.6).into()).unwrap();
        let unseen = Comparison { areas: None, ..seen.clone() };
        let told =
            |c: &Comparison| calibres(&pair, &["branch 1".into()], &[Some(c)], &[0.0], allowed, &[]).len();
        assert_eq!([told(&seen), told(&unseen)], [1, 0]);
    }
}
