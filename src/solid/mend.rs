//! Sections added where a tube crosses itself between two of its sections.
//!
//! A tube joins points at the same share of their contours' lengths by a spline. Where two neighbouring contours have
//! little in common (a neck has just closed, a steep branch just come out of the trunk), points that do not correspond are
//! joined, and the curves between the two may cross themselves. The zero of the signed distances, interpolated linearly
//! between the two contours, knows no correspondence and lies between them: where it is one contour it is added as a
//! section half-way, until no interval crosses itself any more.
//!
//! A tube that is sound is left as it is. What crosses itself still is found by `brep::check`.
//!
//! Cost: linear in the sections, three curves of each interval; some thousand distances where a section is added.

use super::grid::Jet;
use super::iso;
use super::skin::{GivenSection, Strand, Tube};
use crate::geom::{Contour, Point2, SegmentIndex, Vector2};
use crate::spline::{SplineError, TubeSurface};
use crate::topology::meets_itself;
use rayon::prelude::*;

/// Shares of an interval at which it is looked at.
const SHARES: [f64; 3] = [0.5, 0.25, 0.75];
/// Times that intervals are halved: a neck's last interval then is as short as those beside it.
const ROUNDS: usize = 7;
/// Points of a section at which it is looked at, about.
const POINTS: usize = 256;
/// Steps of the grid of an added section to its size.
const STEPS: f64 = 160.0;

/// The tube, through as many further sections as it does not cross itself between them with, or as can be told.
///
/// # Errors
/// Those of `loft`.
pub(super) fn mended(
    mut strand: Strand,
    mut tube: Tube,
    loft: impl Fn(&Strand) -> Result<Tube, SplineError>,
) -> Result<Tube, SplineError> {
    for _ in 0..ROUNDS {
        let further = further(&tube.surface, &strand.sections);
        if further.is_empty() {
            break;
        }
        strand.sections.extend(further);
        strand.sections.sort_by(|a, b| a.0.total_cmp(&b.0));
        tube = loft(&strand)?;
    }
    Ok(tube)
}

/// Sections in the middle of the intervals in which the tube crosses itself.
fn further(surface: &TubeSurface, sections: &[GivenSection]) -> Vec<GivenSection> {
    let crosses = |pair: &[GivenSection]| {
        let at = |share: f64| pair[0].0 + share * (pair[1].0 - pair[0].0);
        SHARES.into_iter().any(|share| crosses_itself(surface, at(share)))
    };
    let halved = |pair: &[GivenSection]| crosses(pair).then(|| halfway(&pair[0], &pair[1])).flatten();
    sections.par_windows(2).filter_map(halved).collect()
}

fn crosses_itself(surface: &TubeSurface, z_mm: f64) -> bool {
    let points = surface.section(z_mm).points();
    let stride = (points.len() / POINTS).max(1);
    meets_itself(&Contour::new(points.into_iter().step_by(stride).collect()))
}

/// The zero of the mean of two contours' signed distances; `None` where it is not one contour.
fn halfway((low_z, low): &GivenSection, (high_z, high): &GivenSection) -> Option<GivenSection> {
    // Those of a hole run clockwise: seen from outside, it is negative inside like any other.
    let is_hole = !low.is_ccw();
    let around = |c: &Contour| if is_hole { c.reversed() } else { c.clone() };
    let indices = [low, high].map(|c| SegmentIndex::try_new(std::slice::from_ref(&around(c))));
    let [Some(below), Some(above)] = &indices else { return None };
    let value = |p: Point2| 0.5 * (below.signed_distance_mm(p) + above.signed_distance_mm(p));
    let bounds = low.bounds()?.union(high.bounds()?);
    let step_mm = (bounds.max - bounds.min).amax() / STEPS;
    let field = |p: Point2| {
        let h = 1e-3 * step_mm;
        let along = |d: Vector2| (value(p + d) - value(p - d)) / (2.0 * h);
        let slope = Vector2::new(along(Vector2::new(h, 0.0)), along(Vector2::new(0.0, h)));
        Jet { value: value(p), slope }
    };
    let found = iso::contours(&field, bounds.grown(4.0 * step_mm), step_mm);
    let [contour] = <[Contour; 1]>::try_from(found).ok()?;
    contour.is_ccw().then(|| (0.5 * (low_z + high_z), around(&contour)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_section_half_way_between_two_disks_lies_between_them() {
        let disk = |x: f64, r: f64| Contour::circle(Point2::new(x, 0.0), r, 128);
        let (z_mm, middle) = halfway(&(1.0, disk(0.0, 2.0)), &(2.0, disk(0.0, 3.0))).expect("a ring between");
        assert!((z_mm - 1.5).abs() < 1e-12);
        assert!(middle.points.iter().all(|p| (p.coords.norm() - 2.5).abs() < 2e-3));
        let hole = |r: f64| disk(0.0, r).reversed();
        let (_, middle) = halfway(&(1.0, hole(2.0)), &(2.0, hole(3.0))).expect("a hole between");
        assert!(
            !middle.is_ccw() && (middle.signed_area_mm2() + 2.5 * 2.5 * std::f64::consts::PI).abs() < 0.05
        );
        assert!(halfway(&(0.0, disk(0.0, 1.0)), &(1.0, disk(9.0, 1.0))).is_none(), "nothing lies between");
    }
}
