//! Where a loop along the lumen begins and ends, and how.
//!
//! The place wanders around the circumference from layer to layer by a fixed irrational share, so that seams never stack to a
//! ridge and never repeat. It goes on to where the loop does not turn sharply, for in a corner the beads' round ends would
//! show, and to where no seam of the layer below is near: where a lumen changes its shape, the place might else stay.
//!
//! A loop leads in from inside the wall, with a narrow bead as long as its own bead reaches into the wall, and its end stops
//! short of its begin by as much material. The round ends meet all the same: the notch that is left is a gap's square over
//! four widths deep, 7 um in a bead of 0.45 mm.

use super::fill::{FillParams, Vertex, shorten};
use crate::geom::{Point2, Vector2};
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
/// Shortest lead-in, mm.
const SHORTEST_LEAD_MM: f64 = 0.03;
/// Most of its width by which a loop stops short of its begin: its ends are round and still meet.
const MOST_GAP: f64 = 0.25;

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

    /// The vertex at which the `nth` loop along a lumen begins: so far around from its easternmost vertex as the layer says, or
    /// the next one beyond that is good.
    pub(super) fn place(&self, vertices: &[Vertex], nth: usize) -> usize {
        let n = vertices.len();
        let east = (0..n).max_by(|&a, &b| vertices[a].at.x.total_cmp(&vertices[b].at.x)).unwrap_or(0);
        let step = |i: usize| (vertices[(i + 1) % n].at - vertices[i % n].at).norm();
        let around_mm: f64 = (0..n).map(step).sum();
        let mut left = around_mm * (self.layer as f64 * SEAM_STEP + nth as f64 * 0.5).fract();
        let mut first = east;
        while left > step(first) && first < east + n {
            left -= step(first);
            first += 1;
        }
        let apart_mm = APART_MM.min(APART_SHARE * around_mm);
        let is_free = |p: Point2| self.below.iter().all(|below| (below - p).norm() >= apart_mm);
        let candidates = || (first..first + n).map(|i| i % n).filter(|&i| is_free(vertices[i].at));
        let even = candidates().find(|&i| is_even(vertices, i, around_mm));
        even.or_else(|| candidates().next()).unwrap_or(first % n)
    }
}

/// Whether a loop turns no more about a vertex than it does on the whole, but for a little.
fn is_even(vertices: &[Vertex], at: usize, around_mm: f64) -> bool {
    let n = vertices.len();
    let step = |i: usize| vertices[(i + 1) % n].at - vertices[i % n].at;
    let turn = |i: usize| step(i + n - 1).perp(&step(i)).atan2(step(i + n - 1).dot(&step(i)));
    // The directions of the steps ahead, then of those behind, against that of the next step.
    let (mut heading, mut range, mut passed_mm) = (0.0f64, [0.0f64; 2], step(at).norm());
    for i in (at + 1..at + n).take_while(|&i| walks_on(&mut passed_mm, step(i).norm())) {
        heading += turn(i);
        range = [range[0].min(heading), range[1].max(heading)];
    }
    (heading, passed_mm) = (0.0, 0.0);
    for i in (at + 1..=at + n).rev().take_while(|&i| walks_on(&mut passed_mm, step(i + n - 1).norm())) {
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

/// Begins a loop with a narrow lead-in out of the wall, as long as the bead itself reaches into it, and
/// ends it short by the same material.
pub(super) fn led_in(mut vertices: Vec<Vertex>, params: &FillParams) -> Vec<Vertex> {
    let begin = vertices[0];
    let width_mm = params.limits_mm[0].min(begin.width_mm);
    let model = params.model;
    let lead_mm = begin.room_mm - model.pitch_mm(width_mm) / 2.0;
    if lead_mm < SHORTEST_LEAD_MM {
        return vertices;
    }
    let along = (vertices[1].at - vertices[vertices.len() - 2].at).normalize();
    let into_wall = Vector2::new(-along.y, along.x);
    let gap = lead_mm * model.area_mm2(width_mm) / model.area_mm2(begin.width_mm);
    shorten(&mut vertices, gap.min(MOST_GAP * begin.width_mm));
    vertices.insert(0, Vertex { at: begin.at + into_wall * lead_mm, width_mm, room_mm: 0.0 });
    // The width of a segment is the mean of its ends': a second vertex at the same place makes the
    // lead-in's its own.
    vertices.insert(1, Vertex { at: begin.at, width_mm, room_mm: begin.room_mm });
    vertices
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{Contour, Region};

    fn vertices(contour: &Contour) -> Vec<Vertex> {
        contour.points.iter().map(|&at| Vertex { at, width_mm: 0.5, room_mm: 0.25 }).collect()
    }

    fn place(vertices: &[Vertex], layer: usize) -> usize {
        Seams::of(layer, &[]).place(vertices, 1)
    }

    #[test]
    fn seams_spread_over_the_circumference() {
        let loop_of = vertices(&Contour::circle(Point2::origin(), 3.0, 100));
        let mut hits = [0; 10];
        (0..690).for_each(|layer| hits[place(&loop_of, layer) / 10] += 1);
        assert!(hits.iter().all(|&h| (60..=78).contains(&h)), "{hits:?}");
        for layer in 0..50 {
            let (a, b) = (place(&loop_of, layer), place(&loop_of, layer + 1));
            let apart = (loop_of[a].at - loop_of[b].at).norm();
            assert!(apart > 2.0, "layers {layer} and the next: {apart} mm");
        }
    }

    #[test]
    fn no_seam_lies_in_a_corner() {
        // Two circles of radius 3 that overlap: the lumen where two vessels part, with two sharp corners.
        let disc = |x: f64| Region::new(vec![Contour::circle(Point2::new(x, 0.0), 3.0, 120)]);
        let loop_of = vertices(&disc(-2.0).union(&disc(2.0)).contours[0]);
        let corner = Point2::new(0.0, 5.0_f64.sqrt());
        for layer in 0..200 {
            let at = loop_of[place(&loop_of, layer)].at;
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
            let at = loop_of[place(&loop_of, layer)].at;
            assert!((Point2::new(at.x, at.y.abs()) - corner).norm() > 0.6, "layer {layer}");
        }
    }

    #[test]
    fn a_seam_keeps_away_from_those_below() {
        let loop_of = vertices(&Contour::circle(Point2::origin(), 3.0, 100));
        for layer in 0..50 {
            let wanted = loop_of[place(&loop_of, layer)].at;
            let moved = loop_of[Seams::of(layer, &[wanted]).place(&loop_of, 1)].at;
            let apart_mm = (moved - wanted).norm();
            assert!((APART_MM..APART_MM + 0.2).contains(&apart_mm), "layer {layer}: {apart_mm} mm");
        }
        // A narrow one has room for none that far away: a share of its circumference.
        let narrow = vertices(&Contour::circle(Point2::origin(), 0.5, 60));
        let wanted = narrow[place(&narrow, 7)].at;
        let moved = narrow[Seams::of(7, &[wanted]).place(&narrow, 1)].at;
        assert!((0.3..0.45).contains(&(moved - wanted).norm()));
    }
}
