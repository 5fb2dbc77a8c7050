//! Outlines to a region whose contours do not cross.
//!
//! A sound mesh gives outer outlines counter-clockwise and holes clockwise, none crossing, by turns in each other: that is
//! tested, as a boolean operation costs many times as much. What is not so is united by winding number.

use crate::geom::{Contour, Point2, Region};
use robust::{Coord, orient2d};

/// Outlines that enclose less than this are no feature, mm².
const LEAST_MM2: f64 = 1e-6;

/// The region of these outlines, and whether it had to be united.
pub(super) fn tidied(mut contours: Vec<Contour>) -> (Region, bool) {
    contours.iter_mut().for_each(without_repeats);
    contours.retain(|c| c.signed_area_mm2().abs() > LEAST_MM2);
    // What comes of them does not depend on which edge of the mesh came first.
    contours.iter_mut().for_each(from_least_point);
    contours.sort_by(|a, b| key(a).partial_cmp(&key(b)).unwrap_or(std::cmp::Ordering::Equal));
    if is_sound(&contours) {
        return (Region::new(contours), false);
    }
    (Region::union_all([&Region::new(contours)]), true)
}

/// Whether outlines are those of a region: by turns outer ones and holes, none crossing.
pub(super) fn is_sound(contours: &[Contour]) -> bool {
    is_nested(contours) && !do_cross(contours)
}

/// A plane through a vertex meets all of its edges in one point.
fn without_repeats(contour: &mut Contour) {
    contour.points.dedup();
    while contour.points.len() > 1 && contour.points.first() == contour.points.last() {
        contour.points.pop();
    }
}

fn key(c: &Contour) -> (f64, f64, usize) {
    (c.points[0].x, c.points[0].y, c.points.len())
}

fn from_least_point(contour: &mut Contour) {
    let points = &mut contour.points;
    let least = (0..points.len())
        .min_by(|&a, &b| points[a].x.total_cmp(&points[b].x).then(points[a].y.total_cmp(&points[b].y)));
    points.rotate_left(least.unwrap_or(0));
}

/// Whether outlines that lie in an even number of others are outer ones, and the rest holes.
fn is_nested(contours: &[Contour]) -> bool {
    contours.iter().enumerate().all(|(k, c)| {
        let around = |(j, other): (usize, &Contour)| j != k && other.contains(c.points[0]);
        let depth = contours.iter().enumerate().filter(|&other| around(other)).count();
        c.is_ccw() == depth.is_multiple_of(2)
    })
}

/// An edge of an outline, its ends by x.
#[derive(Clone, Copy)]
struct Edge {
    ends: [Point2; 2],
    /// Lowest and highest y.
    y: [f64; 2],
}

/// Whether any two edges cross; such as only share an end do not. A sweep along x.
fn do_cross(contours: &[Contour]) -> bool {
    let edges = contours.iter().flat_map(Contour::edges).map(|(a, b)| Edge {
        ends: if a.x <= b.x { [a, b] } else { [b, a] },
        y: [a.y.min(b.y), a.y.max(b.y)],
    });
    let mut edges: Vec<Edge> = edges.collect();
    edges.sort_by(|a, b| a.ends[0].x.total_cmp(&b.ends[0].x));
    let mut open: Vec<Edge> = Vec::new();
    for edge in edges {
        open.retain(|o| o.ends[1].x >= edge.ends[0].x);
        if open.iter().any(|o| o.y[0] <= edge.y[1] && edge.y[0] <= o.y[1] && meet(o.ends, edge.ends)) {
            return true;
        }
        open.push(edge);
    }
    false
}

/// Whether two segments have a point in common other than a common end.
fn meet([a, b]: [Point2; 2], [c, d]: [Point2; 2]) -> bool {
    if a == c || a == d || b == c || b == d {
        return false;
    }
    let side = |p: Point2, q: Point2, r: Point2| {
        let coord = |p: Point2| Coord { x: p.x, y: p.y };
        orient2d(coord(p), coord(q), coord(r))
    };
    let straddles = |p, q, r, s| side(p, q, r) * side(p, q, s) <= 0.0;
    straddles(a, b, c, d) && straddles(c, d, a, b)
}
