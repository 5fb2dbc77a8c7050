//! Parallel curves of closed polylines: raw offset, trimmed by distance, cleaned by winding number.
//!
//! The raw offset moves every vertex along the mitre of its edges (or round an arc where the offset side is
//! convex). A raw vertex nearer than the offset distance to any contour cannot lie on the boundary of the
//! result; a run of such vertices is thinned out, because only the crossings at its two ends matter. What is left
//! crosses itself in few places, and the non-zero-positive winding rule removes the loops. Without the thinning a
//! contour offset close to its collapse crosses itself O(n²) times. The middle of a long edge is a vertex of its own: both
//! ends may lie too near, what is between them not.
//!
//! Edges shorter than a quarter of the tolerance are left out, as their directions are chance.
//!
//! Cost: O(n) plus the boolean clean-up of the few crossings. Accuracy: the given chord tolerance for arcs and for mitres, to
//! the polyline without such edges elsewhere, and the grid of [`super::region`].

use super::{Contour, Point2, SegmentIndex, Vector2};
use std::f64::consts::TAU;

/// How many vertices of a run that cannot lie on the result are kept at most, besides its ends.
const KEPT_PER_TRIMMED_RUN: usize = 6;

/// An edge of a contour, with the unit normal to its right.
struct Edge {
    from: Point2,
    normal: Vector2,
    length_mm: f64,
}

impl Edge {
    /// None where both ends are the same.
    fn try_new(from: Point2, to: Point2) -> Option<Self> {
        let along = (to - from).try_normalize(1e-12)?;
        Some(Self { from, normal: Vector2::new(along.y, -along.x), length_mm: (to - from).norm() })
    }

    fn middle(&self) -> Point2 {
        self.from + Vector2::new(-self.normal.y, self.normal.x) * (self.length_mm / 2.0)
    }
}

/// An outline that turns back on itself is gone round on either side: what lies within the distance belongs to the result, and
/// on which side it turns may be chance.
const TURNED_BACK_COS: f64 = -0.99;
/// Edges shorter than this share of the tolerance are left out.
const HAIR_SHARE: f64 = 0.25;

/// The offset to compute.
#[derive(Debug, Clone, Copy)]
pub(super) struct Offset {
    /// Signed distance, mm: positive to the right of the direction of travel (outward for outer contours).
    pub(super) distance_mm: f64,
    /// Chord error of arcs, mm.
    pub(super) tolerance_mm: f64,
}

impl Offset {
    /// How much nearer than the offset distance a vertex of the result may lie, mm: rounding to the grid and
    /// the chords of arcs.
    fn slack_mm(self) -> f64 {
        0.5 * self.tolerance_mm + 3e-5
    }

    /// Whether a point may lie on the boundary of the result.
    pub(super) fn admits(self, index: &SegmentIndex, p: Point2) -> bool {
        self.is_far(index.nearest(p).distance_mm)
    }

    fn is_far(self, off_mm: f64) -> bool {
        off_mm >= self.distance_mm.abs() - self.slack_mm()
    }

    /// The trimmed raw offset of a contour; `None` where none of it can lie on the result.
    pub(super) fn trimmed(self, contour: &Contour, index: &SegmentIndex) -> Option<Contour> {
        let raw = self.raw(contour);
        let off_mm: Vec<f64> = raw.iter().map(|&p| index.nearest(p).distance_mm).collect();
        let start = off_mm.iter().position(|&mm| self.is_far(mm))?;
        let mut points = Vec::with_capacity(raw.len());
        let mut run: Vec<(Point2, f64)> = Vec::new();
        for i in (start..raw.len()).chain(0..=start) {
            if self.is_far(off_mm[i]) {
                points.extend(self.thinned(std::mem::take(&mut run)));
                points.push(raw[i]);
            } else {
                run.push((raw[i], off_mm[i]));
            }
        }
        points.pop();
        Some(Contour::new(points))
    }

    /// Both ends of a run and a few vertices between. A long one keeps no corner of the outline itself: without what lies to both
    /// sides of it in the run, it would lead the result out there.
    fn thinned(self, mut run: Vec<(Point2, f64)>) -> impl Iterator<Item = Point2> {
        if run.len() > KEPT_PER_TRIMMED_RUN {
            run.retain(|&(_, off_mm)| off_mm > self.slack_mm());
        }
        let (n, stride) = (run.len(), run.len().div_ceil(KEPT_PER_TRIMMED_RUN).max(1));
        run.into_iter().enumerate().filter(move |(i, _)| i % stride == 0 || i + 1 == n).map(|(_, (p, _))| p)
    }

    fn raw(self, contour: &Contour) -> Vec<Point2> {
        let edges = self.edges(contour);
        let mut points = Vec::with_capacity(edges.len() + 16);
        for (i, edge) in edges.iter().enumerate() {
            self.join(&edges[(i + edges.len() - 1) % edges.len()], edge, &mut points);
            // Both ends may be too near to other edges, what lies between them not.
            if edge.length_mm > self.distance_mm.abs() {
                points.push(edge.middle() + edge.normal * self.distance_mm);
            }
        }
        points
    }

    /// The edges of a contour without hairs: where one so short points is chance, and its turns would be taken for the outline's.
    fn edges(self, contour: &Contour) -> Vec<Edge> {
        let hair_mm = HAIR_SHARE * self.tolerance_mm;
        let mut corners: Vec<Point2> = Vec::with_capacity(contour.points.len());
        for &p in &contour.points {
            if corners.last().is_none_or(|last| (p - last).norm() > hair_mm) {
                corners.push(p);
            }
        }
        while corners.len() > 1 && (corners[0] - corners[corners.len() - 1]).norm() <= hair_mm {
            corners.pop();
        }
        let ends = corners.iter().skip(1).chain(corners.first());
        corners.iter().zip(ends).filter_map(|(&a, &b)| Edge::try_new(a, b)).collect()
    }

    /// Appends the offset of the vertex between two edges.
    fn join(self, before: &Edge, after: &Edge, points: &mut Vec<Point2>) {
        let (at, d) = (after.from, self.distance_mm);
        let cos = before.normal.dot(&after.normal);
        let sin = before.normal.perp(&after.normal);
        // The mitre leaves the true distance by d (1 / cos(half turn) - 1).
        let mitre_error =
            if cos > -0.5 { d.abs() * ((2.0 / (1.0 + cos)).sqrt() - 1.0) } else { f64::INFINITY };
        if mitre_error <= self.tolerance_mm {
            points.push(at + (before.normal + after.normal) * (d / (1.0 + cos)));
        } else if sin * d > 0.0 || cos < TURNED_BACK_COS {
            self.arc(at, before.normal, after.normal, points);
        } else if d.abs() * sin.abs() <= before.length_mm.min(after.length_mm) * (1.0 + cos) {
            // On the inner side the mitre is the crossing of both offset edges,
            points.push(at + (before.normal + after.normal) * (d / (1.0 + cos)));
        } else {
            // which lies beyond them where they are short: a spike that no boolean operation would take away.
            points.extend([at + before.normal * d, at, at + after.normal * d]);
        }
    }

    fn arc(self, at: Point2, before: Vector2, after: Vector2, points: &mut Vec<Point2>) {
        let turn = before.perp(&after).atan2(before.dot(&after));
        let turn = if turn * self.distance_mm < 0.0 { turn + TAU.copysign(self.distance_mm) } else { turn };
        let radius = self.distance_mm.abs();
        let step = 2.0 * (1.0 - (self.tolerance_mm / radius).min(0.5)).acos();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most a turn over a positive step"
        )]
        let n_steps = ((turn.abs() / step).ceil() as usize).clamp(1, 2048);
        for k in 0..=n_steps {
            let (sin, cos) = (turn * k as f64 / n_steps as f64).sin_cos();
            let direction = Vector2::new(cos * before.x - sin * before.y, sin * before.x + cos * before.y);
            points.push(at + direction * self.distance_mm);
        }
    }
}
