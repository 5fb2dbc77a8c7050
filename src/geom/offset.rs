//! Parallel curves of closed polylines: raw offset, trimmed by distance, cleaned by winding number.
//!
//! The raw offset moves every vertex along the mitre of its edges (or round an arc where the offset side is
//! convex). A raw vertex nearer than the offset distance to any contour cannot lie on the boundary of the
//! result; a run of such vertices is thinned out, because only the crossings at its two ends matter. What is left
//! crosses itself in few places, and the non-zero-positive winding rule removes the loops. Without the thinning a
//! contour offset close to its collapse crosses itself O(n²) times.
//!
//! Cost: O(n) plus the boolean clean-up of the few crossings. Accuracy: the given chord tolerance for arcs, exact
//! distance to the polyline elsewhere, and the grid of [`super::region`].

use super::{Contour, Point2, SegmentIndex, Vector2};

/// How many vertices of a run that cannot lie on the result are kept at most, besides its ends.
const KEPT_PER_TRIMMED_RUN: usize = 6;

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
        index.nearest(p).distance_mm >= self.distance_mm.abs() - self.slack_mm()
    }

    /// The trimmed raw offset of a contour; `None` where none of it can lie on the result.
    pub(super) fn trimmed(self, contour: &Contour, index: &SegmentIndex) -> Option<Contour> {
        let raw = self.raw(contour);
        let valid: Vec<bool> = raw.iter().map(|&p| self.admits(index, p)).collect();
        let start = valid.iter().position(|&v| v)?;
        let mut points = Vec::with_capacity(raw.len());
        let mut run: Vec<Point2> = Vec::new();
        for i in (start..raw.len()).chain(0..=start) {
            if valid[i] {
                points.extend(thinned(&run));
                run.clear();
                points.push(raw[i]);
            } else {
                run.push(raw[i]);
            }
        }
        points.pop();
        Some(Contour::new(points))
    }

    fn raw(self, contour: &Contour) -> Vec<Point2> {
        let edges: Vec<(Point2, Vector2)> = contour
            .edges()
            .filter_map(|(a, b)| (b - a).try_normalize(1e-12).map(|t| (a, Vector2::new(t.y, -t.x))))
            .collect();
        let mut points = Vec::with_capacity(edges.len() + 16);
        for (i, &(at, normal)) in edges.iter().enumerate() {
            let before = edges[(i + edges.len() - 1) % edges.len()].1;
            self.join(at, before, normal, &mut points);
        }
        points
    }

    /// Appends the offset of one vertex between edges with the given right-hand normals.
    fn join(self, at: Point2, before: Vector2, after: Vector2, points: &mut Vec<Point2>) {
        let d = self.distance_mm;
        let cos = before.dot(&after);
        let convex = before.perp(&after) * d > 0.0;
        // The mitre leaves the true distance by d (1 / cos(half turn) - 1).
        let mitre_error =
            if cos > -0.5 { d.abs() * ((2.0 / (1.0 + cos)).sqrt() - 1.0) } else { f64::INFINITY };
        // On the inner side the mitre is the crossing of both offset edges, however far off it lies; a spike that
        // turns right back has none.
        if mitre_error <= self.tolerance_mm || (!convex && cos > -0.999) {
            points.push(at + (before + after) * (d / (1.0 + cos)));
        } else if convex {
            self.arc(at, before, after, points);
        } else {
            points.extend([at + before * d, at + after * d]);
        }
    }

    fn arc(self, at: Point2, before: Vector2, after: Vector2, points: &mut Vec<Point2>) {
        let turn = before.perp(&after).atan2(before.dot(&after));
        let radius = self.distance_mm.abs();
        let step = 2.0 * (1.0 - (self.tolerance_mm / radius).min(0.5)).acos();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most half a turn over a positive step"
        )]
        let n_steps = ((turn.abs() / step).ceil() as usize).clamp(1, 2048);
        for k in 0..=n_steps {
            let (sin, cos) = (turn * k as f64 / n_steps as f64).sin_cos();
            let direction = Vector2::new(cos * before.x - sin * before.y, sin * before.x + cos * before.y);
            points.push(at + direction * self.distance_mm);
        }
    }
}

/// Both ends of a run and a few vertices between.
fn thinned(run: &[Point2]) -> impl Iterator<Item = Point2> + '_ {
    let stride = run.len().div_ceil(KEPT_PER_TRIMMED_RUN).max(1);
    run.iter().enumerate().filter(move |(i, _)| i % stride == 0 || i + 1 == run.len()).map(|(_, &p)| p)
}
