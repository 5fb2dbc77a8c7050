//! Vertices of a slab's closed curves beside the corners of its patches, where the curves bend sharply.

use crate::geom::{Contour, Point2, SegmentIndex, Vector2};

/// Spacing of vertices beside a corner over the distance from it, and how often an edge is halved at most.
const GROWTH: f64 = 0.12;
const MOST_HALVINGS: usize = 8;

/// The contour with the corners among its vertices, and with more vertices beside them, where it bends more sharply than
/// its vertices are set: their spacing grows with the distance from the nearest corner, from `least_mm` on. `refine` moves
/// a point onto the curve where that runs in about the given direction.
pub(super) fn denser(
    contour: &Contour,
    corners: &[Point2],
    least_mm: f64,
    refine: impl Fn(Point2, Vector2) -> Point2,
) -> Contour {
    let Some(index) = SegmentIndex::try_new(std::slice::from_ref(contour)) else { return contour.clone() };
    let feet: Vec<usize> = corners.iter().map(|c| edge_of(contour, index.nearest(*c).edge_idx, *c)).collect();
    let spacing_mm = |p: Point2| {
        let d = corners.iter().map(|c| (c - p).norm()).fold(f64::INFINITY, f64::min);
        (GROWTH * d).max(least_mm)
    };
    let mut points = Vec::with_capacity(2 * contour.len());
    for (k, (from, to)) in contour.edges().enumerate() {
        let mut stops = vec![from];
        let mut inner: Vec<Point2> =
            corners.iter().zip(&feet).filter(|(_, foot)| **foot == k).map(|(c, _)| *c).collect();
        inner.sort_by(|a, b| (a - from).norm().total_cmp(&(b - from).norm()));
        let apart = |p: &Point2| (p - from).norm() > 0.3 * least_mm && (p - to).norm() > 0.3 * least_mm;
        stops.extend(inner.into_iter().filter(apart));
        stops.push(to);
        for pair in stops.windows(2) {
            points.push(pair[0]);
            halved([pair[0], pair[1]], MOST_HALVINGS, &spacing_mm, &refine, &mut points);
        }
    }
    Contour::new(points)
}

/// The edge of a contour, that nearest to a corner or one beside it, into which the corner goes with the least detour. Where
/// the contour cuts across a notch the nearest point of the contour to a corner in there is a vertex, and of the two edges that end
/// in it the nearest one may be the wrong one: the contour would run to the corner and back.
fn edge_of(contour: &Contour, nearest: usize, corner: Point2) -> usize {
    let n = contour.len();
    let detour_mm = |k: &usize| {
        let (from, to) = (contour.points[*k], contour.points[(k + 1) % n]);
        (corner - from).norm() + (to - corner).norm() - (to - from).norm()
    };
    let beside = [nearest, (nearest + n - 1) % n, (nearest + 1) % n];
    beside.into_iter().min_by(|a, b| detour_mm(a).total_cmp(&detour_mm(b))).unwrap_or(nearest)
}

/// Points between two of a curve, as far apart as asked for.
fn halved(
    [from, to]: [Point2; 2],
    most: usize,
    spacing_mm: &impl Fn(Point2) -> f64,
    refine: &impl Fn(Point2, Vector2) -> Point2,
    points: &mut Vec<Point2>,
) {
    let middle = nalgebra::center(&from, &to);
    let length = (to - from).norm();
    if most == 0 || length <= spacing_mm(middle) {
        return;
    }
    let on_curve = refine(middle, to - from);
    // What is not between the two is on another piece of the curve.
    if (on_curve - middle).norm() > length {
        return;
    }
    halved([from, on_curve], most - 1, spacing_mm, refine, points);
    points.push(on_curve);
    halved([on_curve, to], most - 1, spacing_mm, refine, points);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corner_in_a_notch_that_the_contour_cuts_across_lies_between_its_neighbours() {
        let points = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 1.0], [0.0, 4.0]].map(Point2::from);
        let contour = Contour::new(points.to_vec());
        // Beyond the notch's vertex that is the nearest point of both edges.
        for (corner, expected) in [([2.05, 0.9], 2), ([1.95, 0.9], 3)] {
            let corner = Point2::from(corner);
            let found = denser(&contour, &[corner], 0.3, |p, _| p).points;
            let place = |p: Point2| found.iter().position(|q| *q == p).expect("every vertex stays");
            let [before, at, after] = [points[expected], corner, points[expected + 1]].map(place);
            assert!(before < at && at < after, "{before} {at} {after}");
        }
    }
}
