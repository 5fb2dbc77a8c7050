//! Where loops along the skins begin and end.
//!
//! Along a lumen the place wanders around the circumference from layer to layer by a fixed irrational share, so that seams never
//! stack to a ridge and never repeat; it may lie anywhere on a straight edge. It goes on to where the loop does not turn sharply,
//! for in a corner the beads' round ends would show, and to where no seam of the layer below is near: where a lumen changes its
//! shape, the place might else stay. How the loop begins and ends there says the module `lead`.
//!
//! A loop along an outer skin begins in its sharpest corner that turns into the material, where a seam shows least; of several
//! about as sharp in the nearest. Without one it begins beside the nozzle, which comes from a lumen's seam and so wanders with it;
//! where there is no lumen, at a place that wanders as those do. It avoids sharp turns outward and the seams below in the same way.

use super::fill::Vertex;
use super::ring;
use crate::geom::Point2;
use std::f64::consts::TAU;

/// Share of the circumference by which seams wander from layer to layer: the golden ratio to the power of
/// -4, about 4 mm on a carotid. Far enough that neighbouring seams do not touch, near enough for short
/// travels.
const SEAM_STEP: f64 = 0.145_898_033_750_315_46;
/// Nearest seams of neighbouring layers, mm,
const APART_MM: f64 = 1.5;
/// or, around a narrow lumen, the share of its circumference.
const APART_SHARE: f64 = 0.1;
/// So far to either side of a seam the loop must not turn sharply, mm,
const EVEN_MM: f64 = 1.0;
/// that is by so many times what it turns there if it is a circle.
const MOST_TURN: f64 = 2.5;
/// Steps in which a better place is sought, mm.
const STEP_MM: f64 = 0.1;

/// An outer skin turns so much into the material at a corner that hides a seam, rad (30 degrees),
const HIDING_RAD: f64 = 0.52;
/// within this length of it to either side, mm;
const CORNER_MM: f64 = 0.3;
/// corners that turn by so much less than the sharpest are as good, rad (15 degrees).
const AS_SHARP_RAD: f64 = 0.26;

/// What decides where the seams of a layer lie.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seams<'a> {
    layer: usize,
    below: &'a [Point2],
}

impl<'a> Seams<'a> {
    /// Of a layer, over one with seams `below`.
    pub(super) const fn of(layer: usize, below: &'a [Point2]) -> Self {
        Self { layer, below }
    }

    /// The `nth` loop along a lumen from its begin: so far around from its easternmost vertex as the layer says, or the next
    /// place beyond that is good.
    pub(super) fn begun(&self, vertices: &[Vertex], nth: usize) -> Vec<Vertex> {
        let n = vertices.len();
        let east = (0..n).max_by(|&a, &b| vertices[a].at.x.total_cmp(&vertices[b].at.x)).unwrap_or(0);
        let around_mm = ring::around_mm(vertices);
        let wanted_mm = around_mm * (self.layer as f64 * SEAM_STEP + nth as f64 * 0.5).fract();
        let begun = |mm: f64| ring::begun_at(vertices, ring::along(vertices, east, mm.rem_euclid(around_mm)));
        self.first_good(begun, wanted_mm, around_mm)
    }

    /// The `nth` loop along an outer skin from its begin. `at`: where the nozzle comes from, if from a lumen of the same island.
    pub(super) fn outer_begun(&self, vertices: &[Vertex], nth: usize, at: Option<Point2>) -> Vec<Vertex> {
        if let Some(corner) = hiding_corner(vertices, at) {
            return ring::begun_at(vertices, ring::Place { edge: corner, share: 0.0 });
        }
        let Some(at) = at else { return self.begun(vertices, nth) };
        let near = ring::begun_at(vertices, ring::nearest(vertices, at).0);
        let around_mm = ring::around_mm(&near);
        let begun = |mm: f64| ring::begun_at(&near, ring::along(&near, 0, mm.rem_euclid(around_mm)));
        self.first_good(begun, 0.0, around_mm)
    }

    /// The loop from the first place at or beyond `from_mm` that is free and even, else free, else from there.
    fn first_good(&self, begun: impl Fn(f64) -> Vec<Vertex>, from_mm: f64, around_mm: f64) -> Vec<Vertex> {
        let apart_mm = APART_MM.min(APART_SHARE * around_mm);
        let is_free = |p: Point2| self.below.iter().all(|below| (below - p).norm() >= apart_mm);
        let places = || (0..).map(|k| f64::from(k) * STEP_MM).take_while(|&mm| mm < around_mm);
        let free = || places().map(|mm| begun(from_mm + mm)).filter(|v| is_free(v[0].at));
        let even = free().find(|v| is_even(v, around_mm));
        even.or_else(|| free().next()).unwrap_or_else(|| begun(from_mm))
    }
}

/// The vertex of the sharpest corner that turns into the material, or the one nearest to the nozzle of those about as sharp.
fn hiding_corner(vertices: &[Vertex], at: Option<Point2>) -> Option<usize> {
    let turns: Vec<f64> = (0..vertices.len()).map(|i| inward_turn(vertices, i)).collect();
    let sharpest = turns.iter().copied().fold(0.0, f64::max);
    let as_sharp = (0..vertices.len()).filter(|&i| turns[i] > HIDING_RAD.max(sharpest - AS_SHARP_RAD));
    let away_mm = |i: usize| at.map_or(0.0, |at| (vertices[i].at - at).norm());
    as_sharp.min_by(|&a, &b| away_mm(a).total_cmp(&away_mm(b)).then(turns[b].total_cmp(&turns[a])))
}

/// How much a loop turns into the material (on its left) about a vertex, where the vertex itself turns so most of all, rad.
fn inward_turn(vertices: &[Vertex], at: usize) -> f64 {
    let n = vertices.len();
    let step = |i: usize| vertices[(i + 1) % n].at - vertices[i % n].at;
    let turn = |i: usize| -step(i + n - 1).perp(&step(i)).atan2(step(i + n - 1).dot(&step(i)));
    let own = turn(at);
    if own <= 0.0 {
        return 0.0;
    }
    let reach = |steps: &mut dyn Iterator<Item = (usize, f64)>| -> f64 {
        let mut passed_mm = 0.0;
        let within = steps.take_while(|(_, mm)| {
            passed_mm += mm;
            passed_mm < CORNER_MM
        });
        within.map(|(i, _)| turn(i)).sum()
    };
    let ahead = reach(&mut (at + 1..at + n).map(|i| (i, step(i + n - 1).norm())));
    let behind = reach(&mut (at + 1..at + n).rev().map(|i| (i, step(i).norm())));
    own + ahead + behind
}

/// Whether a loop turns no more about its first vertex than it does on the whole, but for a little.
fn is_even(vertices: &[Vertex], around_mm: f64) -> bool {
    let n = vertices.len();
    let step = |i: usize| vertices[(i + 1) % n].at - vertices[i % n].at;
    let turn = |i: usize| step(i + n - 1).perp(&step(i)).atan2(step(i + n - 1).dot(&step(i)));
    // The directions of the steps ahead, then of those behind, against that of the next step.
    let (mut heading, mut range, mut passed_mm) = (0.0f64, [0.0f64; 2], step(0).norm());
    for i in (1..n).take_while(|&i| walks_on(&mut passed_mm, step(i).norm())) {
        heading += turn(i);
        range = [range[0].min(heading), range[1].max(heading)];
    }
    (heading, passed_mm) = (0.0, 0.0);
    for i in (1..=n).rev().take_while(|&i| walks_on(&mut passed_mm, step(i + n - 1).norm())) {
        heading -= turn(i);
        range = [range[0].min(heading), range[1].max(heading)];
    }
    range[1] - range[0] < MOST_TURN * TAU * 2.0 * EVEN_MM / around_mm
}

/// Goes on by a step unless what must be even is passed.
fn walks_on(passed_mm: &mut f64, step_mm: f64) -> bool {
    let is_within = *passed_mm < EVEN_MM;
    *passed_mm += step_mm;
    is_within
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{Contour, Region};

    fn vertices(contour: &Contour) -> Vec<Vertex> {
        contour.points.iter().map(|&at| Vertex { at, width_mm: 0.5, room_mm: 0.25 }).collect()
    }

    fn place(vertices: &[Vertex], layer: usize) -> Point2 {
        Seams::of(layer, &[]).begun(vertices, 1)[0].at
    }

    #[test]
    fn seams_spread_over_the_circumference() {
        let loop_of = vertices(&Contour::circle(Point2::origin(), 3.0, 100));
        let mut hits = [0; 10];
        (0..690).for_each(|layer| {
            let at = place(&loop_of, layer);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 9")]
            let tenth = (10.0 * at.y.atan2(at.x).rem_euclid(TAU) / TAU) as usize % 10;
            hits[tenth] += 1;
        });
        assert!(hits.iter().all(|&h| (60..=78).contains(&h)), "{hits:?}");
        for layer in 0..50 {
            let (a, b) = (place(&loop_of, layer), place(&loop_of, layer + 1));
            let apart = (a - b).norm();
            assert!(apart > 2.0, "layers {layer} and the next: {apart} mm");
        }
    }

    #[test]
    fn seams_of_a_straight_sided_hole_lie_on_its_sides_and_spread() {
        let square =
            Contour::new([(0., 0.), (0., 8.), (8., 8.), (8., 0.)].map(|(x, y)| Point2::new(x, y)).into());
        let loop_of = vertices(&square);
        let places: Vec<Point2> = (0..50).map(|layer| place(&loop_of, layer)).collect();
        let to_corner =
            |p: &Point2| square.points.iter().map(|c| (c - p).norm()).fold(f64::INFINITY, f64::min);
        assert!(places.iter().all(|p| to_corner(p) > 0.9));
        assert!(places.windows(2).all(|p| (p[1] - p[0]).norm() > APART_MM));
        // On each side, and not in one place of it.
        for middle in [(0., 4.), (4., 8.), (8., 4.), (4., 0.)].map(|(x, y)| Point2::new(x, y)) {
            let on_it: Vec<&Point2> = places.iter().filter(|p| (*p - middle).norm() < 3.5).collect();
            let nearest = |p: &Point2| {
                on_it.iter().map(|o| (*o - p).norm()).filter(|&d| d > 0.0).fold(f64::INFINITY, f64::min)
            };
            assert!((8..=17).contains(&on_it.len()), "{} at {middle}", on_it.len());
            assert!(on_it.iter().map(|p| nearest(p)).fold(0.0, f64::max) < 1.5);
        }
    }

    #[test]
    fn no_seam_lies_in_a_corner() {
        // Two circles of radius 3 that overlap: the lumen where two vessels part, with two sharp corners.
        let disc = |x: f64| Region::new(vec![Contour::circle(Point2::new(x, 0.0), 3.0, 120)]);
        let loop_of = vertices(&disc(-2.0).union(&disc(2.0)).contours[0]);
        let corner = Point2::new(0.0, 5.0_f64.sqrt());
        for layer in 0..200 {
            let at = place(&loop_of, layer);
            let off_mm = (Point2::new(at.x, at.y.abs()) - corner).norm();
            assert!(off_mm > 0.6, "layer {layer}: {off_mm} mm from a corner");
        }
    }

    #[test]
    fn an_outline_that_is_rough_everywhere_is_no_corner() {
        // A tenth of a radian to and fro at each vertex: its corners are avoided all the same.
        let rough = |(i, p): (usize, &Point2)| p + p.coords * if i % 2 == 0 { 0.002 } else { -0.002 };
        let disc = |x: f64| Region::new(vec![Contour::circle(Point2::new(x, 0.0), 3.0, 120)]);
        let eight = &disc(-2.0).union(&disc(2.0)).contours[0];
        let loop_of = vertices(&Contour::new(eight.points.iter().enumerate().map(rough).collect()));
        let corner = Point2::new(0.0, 5.0_f64.sqrt());
        for layer in 0..50 {
            let at = place(&loop_of, layer);
            assert!((Point2::new(at.x, at.y.abs()) - corner).norm() > 0.6, "layer {layer}");
        }
    }

    #[test]
    fn a_seam_keeps_away_from_those_below() {
        let loop_of = vertices(&Contour::circle(Point2::origin(), 3.0, 100));
        for layer in 0..50 {
            let wanted = place(&loop_of, layer);
            let moved = Seams::of(layer, &[wanted]).begun(&loop_of, 1)[0].at;
            let apart_mm = (moved - wanted).norm();
            assert!(
                (APART_MM..APART_MM + STEP_MM + 0.03).contains(&apart_mm),
                "layer {layer}: {apart_mm} mm"
            );
        }
        // A narrow one has room for none that far away: a share of its circumference.
        let narrow = vertices(&Contour::circle(Point2::origin(), 0.5, 60));
        let wanted = place(&narrow, 7);
        let moved = Seams::of(7, &[wanted]).begun(&narrow, 1)[0].at;
        assert!((0.3..0.45).contains(&(moved - wanted).norm()));
    }

    #[test]
    fn an_outer_seam_hides_in_a_corner_that_turns_inward() {
        // An L: one such corner. Wherever the nozzle is and whatever the layer, the loop begins there.
        let ell = [(0., 0.), (9., 0.), (9., 4.), (4., 4.), (4., 9.), (0., 9.)];
        let loop_of = vertices(&Contour::new(ell.map(|(x, y)| Point2::new(x, y)).into()));
        for (layer, at) in [(0, None), (1, Some(Point2::new(8.0, 1.0))), (7, Some(Point2::new(1.0, 8.0)))] {
            let begun = Seams::of(layer, &[Point2::new(4.0, 4.0)]).outer_begun(&loop_of, 1, at);
            assert_eq!(begun[0].at, Point2::new(4.0, 4.0));
        }
        // Where two vessels part there are two, rounded by many vertices: the nearer one.
        let disc = |x: f64| Region::new(vec![Contour::circle(Point2::new(x, 0.0), 3.0, 120)]);
        let loop_of = vertices(&disc(-2.0).union(&disc(2.0)).contours[0]);
        for y in [-1.0f64, 1.0] {
            let begun = Seams::of(3, &[]).outer_begun(&loop_of, 1, Some(Point2::new(0.5, y)));
            assert!((begun[0].at - Point2::new(0.0, y * 5.0_f64.sqrt())).norm() < 0.2, "{}", begun[0].at);
        }
    }

    #[test]
    fn an_outer_seam_without_such_a_corner_is_beside_the_nozzle_or_wanders() {
        let square = [(0., 0.), (8., 0.), (8., 8.), (0., 8.)].map(|(x, y)| Point2::new(x, y));
        let loop_of = vertices(&Contour::new(square.into()));
        let begun =
            |layer: usize, at: Option<Point2>| Seams::of(layer, &[]).outer_begun(&loop_of, 1, at)[0].at;
        assert!((begun(0, Some(Point2::new(3.0, 1.0))) - Point2::new(3.0, 0.0)).norm() < 1e-9);
        // Not in the corner, which shows from two sides.
        let beside_corner = begun(0, Some(Point2::new(7.9, 0.1)));
        let off_mm = (beside_corner - square[1]).norm();
        assert!((1.0 - 1e-9..1.5).contains(&off_mm), "{off_mm}");
        // Nor on the seam below.
        let taken = Point2::new(3.0, 0.0);
        let moved = Seams::of(1, &[taken]).outer_begun(&loop_of, 1, Some(Point2::new(3.0, 1.0)))[0].at;
        assert!((APART_MM..2.0).contains(&(moved - taken).norm()));
        let wandering: Vec<Point2> = (0..30).map(|layer| begun(layer, None)).collect();
        assert!(wandering.windows(2).all(|p| (p[1] - p[0]).norm() > APART_MM));
    }
}
