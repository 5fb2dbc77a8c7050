//! Outlines of the outer skin: the curves at a height on which the distance to the lumen is t, followed point by
//! point. Where the foot on the lumen jumps, two sheets of the parallel surface meet in a corner; it is found as the
//! point at distance t from both.
//!
//! Predictor along the tangent, corrector by Newton steps in the plane (the distance's gradient is the normal).

use super::feet::{Feet, Foot};
use crate::geom::{Contour, Point2, Point3, Vector2};

/// Corrector steps at most, and the error at which they end, mm.
const MOST_STEPS: usize = 8;
const SETTLED_MM: f64 = 1e-6;
/// Where the wall is flatter than this (horizontal part of the normal), a horizontal section of it is ill defined.
const LEAST_HORIZONTAL: f64 = 0.02;
/// Turn to the inside between neighbouring points that may hide a corner, and the least turn of a corner; sines.
const SUSPECT_TURN: f64 = 0.03;
const LEAST_TURN: f64 = 0.02;
/// Turn over one step beyond which the step is halved, cosine; and how often.
const MOST_TURN_COS: f64 = 0.8;
const MOST_HALVINGS: u32 = 5;
/// How much nearer or farther than t, in t, the surface may seem where it is not: the feet's accuracy.
const CLEAR: f64 = 5e-4;
/// How far beyond a corner a vertex may lie that was set before it was noticed, in steps.
const PASSED: f64 = 0.3;
const MOST_VERTICES: usize = 4_000;

/// A point of an outline.
#[derive(Debug, Clone, Copy)]
pub(super) struct Vertex {
    pub(super) p: Point2,
    /// Feet for the pieces before and after; the same but at a corner.
    pub(super) feet: [Foot; 2],
    pub(super) is_corner: bool,
}

impl Vertex {
    const fn smooth(p: Point2, foot: Foot) -> Self {
        Self { p, feet: [foot; 2], is_corner: false }
    }
}

/// The horizontal direction counter-clockwise round the body beside a foot.
fn along(foot: &Foot) -> Vector2 {
    let n = foot.normal;
    Vector2::new(-n.y, n.x).try_normalize(1e-12).unwrap_or_default()
}

/// Appends a corner; it takes the place of a vertex that all but coincides with it or lies beyond it already.
fn push_corner(vertices: &mut Vec<Vertex>, corner: Vertex, least_mm: f64) {
    let passed = |v: &Vertex| (corner.p - v.p).dot(&along(&v.feet[1])) < 0.0;
    let near = |v: &Vertex| (v.p - corner.p).norm() < least_mm;
    let doubled = vertices.last().is_some_and(|v| !v.is_corner && (near(v) || passed(v)));
    if doubled && vertices.len() > 1 {
        vertices.pop();
    }
    vertices.push(corner);
}

/// Lifts a point of the plane at z into space.
pub(super) fn at_height(p: Point2, z: f64) -> Point3 {
    Point3::new(p.x, p.y, z)
}

/// Follows outlines.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tracer<'a> {
    pub(super) feet: &'a Feet,
    pub(super) wall_mm: f64,
    pub(super) step_mm: f64,
}

impl Tracer<'_> {
    /// Moves a point in its plane until its distance is t; `sheet` keeps to the part of the lumen round it.
    pub(super) fn settle(&self, start: Point2, z: f64, sheet: Option<Point3>) -> Option<(Point2, Foot)> {
        let mut p = start;
        let mut near = sheet;
        for _ in 0..MOST_STEPS {
            let at = at_height(p, z);
            let foot = near.map_or_else(|| self.feet.foot(at), |near| self.feet.foot_beside(at, near));
            let error = foot.distance_mm - self.wall_mm;
            if error.abs() < SETTLED_MM {
                return Some((p, foot));
            }
            let flat = foot.normal.xy();
            let steepness2 = flat.norm_squared();
            if steepness2 < LEAST_HORIZONTAL * LEAST_HORIZONTAL {
                return None;
            }
            let step = flat * (error / steepness2);
            p -= step * (0.5 * self.wall_mm / step.norm().max(1e-300)).min(1.0);
            near = near.map(|_| foot.at);
        }
        // The nearest sample may alternate between two; what is left is their disagreement.
        let foot = near.map_or_else(
            || self.feet.foot(at_height(p, z)),
            |near| self.feet.foot_beside(at_height(p, z), near),
        );
        ((foot.distance_mm - self.wall_mm).abs() < 1e-3 * self.wall_mm).then_some((p, foot))
    }

    /// The point near `p` at distance t from the surfaces round both feet.
    pub(super) fn corner(&self, start: Point2, z: f64, feet: [Foot; 2]) -> Option<(Point2, [Foot; 2])> {
        let mut p = start;
        let mut feet = feet;
        for _ in 0..2 * MOST_STEPS {
            let at = at_height(p, z);
            feet = feet.map(|f| self.feet.foot_beside(at, f.at));
            let errors = feet.map(|f| self.wall_mm - f.distance_mm);
            if errors[0].abs().max(errors[1].abs()) < SETTLED_MM {
                return Some((p, feet));
            }
            let [a, b] = feet.map(|f| f.normal.xy());
            let det = a.perp(&b);
            if det.abs() < 1e-4 {
                return None;
            }
            let step =
                Vector2::new(errors[0] * b.y - errors[1] * a.y, errors[1] * a.x - errors[0] * b.x) / det;
            p += step * (self.step_mm / step.norm().max(1e-300)).min(1.0);
        }
        let left = feet.map(|f| (f.distance_mm - self.wall_mm).abs());
        (left[0].max(left[1]) < 1e-3 * self.wall_mm).then_some((p, feet))
    }

    /// The vertices from `from` on: round the whole outline back to it, or up to `to` (a corner, not included).
    pub(super) fn follow(&self, from: Vertex, to: Option<Point2>, z: f64) -> Option<Vec<Vertex>> {
        let goal = to.unwrap_or(from.p);
        let mut vertices = vec![from];
        let mut passed = 0.0;
        while vertices.len() < MOST_VERTICES {
            let last = vertices[vertices.len() - 1];
            let ahead = goal - last.p;
            let distance = ahead.norm();
            if passed > 2.5 * self.step_mm
                && distance < 1.3 * self.step_mm
                && ahead.dot(&along(&last.feet[1])) > -0.1 * self.step_mm
            {
                if distance < 0.3 * self.step_mm && !last.is_corner && vertices.len() > 1 {
                    vertices.pop();
                }
                return Some(vertices);
            }
            let before = vertices.len();
            self.advance(&mut vertices, z)?;
            // The corner at the end may have been found already.
            let at_goal = |v: &Vertex| v.is_corner && (v.p - goal).norm() < 0.2 * self.step_mm;
            if passed > 2.5 * self.step_mm
                && let Some(end) = (before..vertices.len()).find(|&i| at_goal(&vertices[i]))
            {
                vertices.truncate(end);
                return Some(vertices);
            }
            passed +=
                (before..vertices.len()).map(|i| (vertices[i].p - vertices[i - 1].p).norm()).sum::<f64>();
        }
        None
    }

    /// Appends the next vertex, with the corner before it if there is one.
    fn advance(&self, vertices: &mut Vec<Vertex>, z: f64) -> Option<()> {
        let last = vertices[vertices.len() - 1];
        let direction = along(&last.feet[1]);
        let mut step = self.step_mm;
        if let Some(next) = self.along_sheet(&last, step, z) {
            vertices.push(next);
            return Some(());
        }
        let mut any = None;
        for halving in 0..=MOST_HALVINGS {
            let ahead = last.p + direction * step;
            let settled = self.settle(ahead, z, None);
            let moved = settled.filter(|(p, _)| {
                (p - last.p).dot(&direction) > 0.2 * step && (p - last.p).norm() < 2.0 * step
            });
            let turns = |next: &Foot| direction.perp(&along(next)) < -SUSPECT_TURN;
            if moved.is_none_or(|(_, next)| turns(&next))
                && let Some(corner) = self.corner_ahead(&last, settled.map(|s| s.1), ahead, z)
            {
                push_corner(vertices, corner, 0.3 * step);
                // Going on from the corner may come out before it again: then the next point starts there.
                if let Some((p, next)) = settled
                    && (p - corner.p).dot(&along(&corner.feet[1])) > 0.3 * step
                    && (p - corner.p).norm() < 2.0 * step
                    && along(&next).dot(&along(&corner.feet[1])) > MOST_TURN_COS
                {
                    vertices.push(Vertex::smooth(p, next));
                }
                return Some(());
            }
            if let Some((p, next)) = moved
                && (direction.dot(&along(&next)) > MOST_TURN_COS || halving == MOST_HALVINGS)
            {
                vertices.push(Vertex::smooth(p, next));
                return Some(());
            }
            // A tight bend without a corner: where the curve goes on beyond it.
            let progress = |(p, next): &(Point2, Foot)| {
                let by = p - last.p;
                by.norm() > 0.1 * step && by.norm() < 2.0 * step && by.dot(&(direction + along(next))) > 0.0
            };
            any = any.or(settled.filter(progress));
            step *= 0.5;
        }
        let (p, next) = any?;
        vertices.push(Vertex::smooth(p, next));
        Some(())
    }

    /// The next vertex on the same sheet, where that bends little and nothing else is nearer.
    fn along_sheet(&self, last: &Vertex, step: f64, z: f64) -> Option<Vertex> {
        let own = last.feet[1];
        let direction = along(&own);
        let (p, next) = self.settle(last.p + direction * step, z, Some(own.at))?;
        let bends_little = direction.dot(&along(&next)) > MOST_TURN_COS;
        let forward = (p - last.p).dot(&direction) > 0.5 * step && (p - last.p).norm() < 1.5 * step;
        // Nearer is another sheet; farther than a foot of one's own the surface never is: that one is none.
        let is_own = || (self.feet.foot(at_height(p, z)).distance_mm / self.wall_mm - 1.0).abs() < CLEAR;
        (bends_little && forward && is_own()).then(|| Vertex::smooth(p, next))
    }

    /// A corner between the last vertex and a point ahead of it. The other sheet is the one on which that point
    /// settled, or the one to which it is too near.
    fn corner_ahead(&self, last: &Vertex, settled: Option<Foot>, ahead: Point2, z: f64) -> Option<Vertex> {
        let own = last.feet[1];
        let differs = |f: &Foot| f.normal.dot(&own.normal) < 1.0 - 1e-4;
        let intruder = self.feet.foot(at_height(ahead, z));
        let candidates = [settled, Some(intruder)].into_iter().flatten().filter(differs);
        let reach = (ahead - last.p).norm() + self.step_mm;
        let valid = |(corner, feet): &(Point2, [Foot; 2])| {
            let [a, b] = feet.each_ref().map(along);
            let ahead_mm = (corner - last.p).dot(&along(&own));
            // A turn of nearly half a circle has a small sine, too. A corner that was passed before its other sheet was
            // noticed must turn the right way, or it is the one that the outline comes from.
            let turns = a.perp(&b) < -LEAST_TURN || (a.dot(&b) < 0.0 && ahead_mm > 0.0);
            let forward = ahead_mm > -PASSED * self.step_mm && !(last.is_corner && ahead_mm <= 0.0);
            let clear = self.feet.foot(at_height(*corner, z)).distance_mm > self.wall_mm * (1.0 - 2e-3);
            turns && forward && clear && (corner - last.p).norm() < reach
        };
        let mut corners = candidates
            .filter_map(|other| self.corner(nalgebra::center(&last.p, &ahead), z, [own, other]))
            .filter(valid);
        corners.next().map(|(p, feet)| Vertex { p, feet, is_corner: true })
    }

    /// The whole outline through a point near it.
    pub(super) fn outline(&self, near: Point2, z: f64) -> Option<Vec<Vertex>> {
        let (p, foot) = self.settle(near, z, None)?;
        self.follow(Vertex::smooth(p, foot), None, z)
    }

    /// Points of a polyline of vertices at fractions of its length, each settled on its own sheet; the ends are kept.
    pub(super) fn resampled(&self, vertices: &[Vertex], fractions: &[f64], z: f64) -> Option<Vec<Point2>> {
        let mut lengths = vec![0.0];
        for pair in vertices.windows(2) {
            lengths.push(lengths[lengths.len() - 1] + (pair[1].p - pair[0].p).norm());
        }
        let last = vertices.len() - 1;
        let whole = lengths[last];
        fractions
            .iter()
            .enumerate()
            .map(|(k, fraction)| {
                if k == 0 {
                    return Some(vertices[0].p);
                }
                if k + 1 == fractions.len() {
                    return Some(vertices[last].p);
                }
                let target = fraction * whole;
                let i = lengths.partition_point(|&l| l <= target).clamp(1, last);
                let share =
                    ((target - lengths[i - 1]) / (lengths[i] - lengths[i - 1]).max(1e-12)).clamp(0.0, 1.0);
                let (a, b) = (&vertices[i - 1], &vertices[i]);
                let sheet = a.feet[1].at + (b.feet[0].at - a.feet[1].at) * share;
                let p = a.p + (b.p - a.p) * share;
                Some(self.settle(p, z, Some(sheet)).map_or(p, |(p, _)| p))
            })
            .collect()
    }
}

/// The contour of a closed outline.
pub(super) fn contour(vertices: &[Vertex]) -> Contour {
    Contour::new(vertices.iter().map(|v| v.p).collect())
}
