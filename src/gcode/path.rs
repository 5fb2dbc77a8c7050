//! A bead's centre line to the moves that draw it: arcs where the firmware has them, straight segments where not, thinned
//! and slowed where they are denser than wire and planner take.
//!
//! Slowed are runs of moves of one bead, as long as half of the planner's buffer; a shorter bead may be denser than asked.
//!
//! - Where the profile says so, a run of segments that lies on a circle becomes an arc through its two ends. The circle is the
//!   best one through both ends (least squares over vertices and middles of the segments). It is taken where every point of every
//!   segment is within the profile's tolerance of it, less what the firmware's own chords leave it by, and less what the
//!   bead's edges move because an arc has one width.
//! - Segments that would take less than the planner's least time are joined while what is left out lies within the
//!   tolerance.
//! - Where segments are still too dense, the run is driven slower; so is a bead of which the hotend would have to melt more
//!   than it can. What a short layer is slowed down by comes on top of that.
//!
//! Filament is kept: a move carries what its segments would have. Places are the steps of 1 um that are written.

use crate::geom::Point2;
use crate::geom::distance::nearest_on_segment;
use crate::profile::Profile;
use crate::toolpath::{BeadModel, BeadPoint};
use crate::units::on_grid_mm;
use std::f64::consts::PI;

/// A move along a bead.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Piece {
    /// Where it ends, mm.
    pub(super) to: Point2,
    /// What it lays down, mm³.
    pub(super) mm3: f64,
    /// Its way, mm.
    pub(super) length_mm: f64,
    /// Where it is an arc.
    pub(super) arc: Option<Arc>,
    /// How fast it is driven, mm/s.
    pub(super) speed_mm_s: f64,
}

impl Piece {
    /// How long it takes, accelerations left out, s.
    pub(super) fn time_s(&self) -> f64 {
        self.length_mm / self.speed_mm_s
    }
}

/// An arc.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Arc {
    /// Its centre, mm.
    pub(super) centre: Point2,
    /// Against the clock, seen from above.
    pub(super) is_ccw: bool,
}

/// Fewer segments than this are no arc: nothing is won.
const FEWEST_SEGMENTS: usize = 4;
/// An arc turns no farther than this, rad: its ends must not come near each other, where rounding would make it a whole circle
/// or none.
const MOST_TURN_RAD: f64 = 1.5 * PI;
/// Larger radii are straight lines to a planner, mm.
const LARGEST_RADIUS_MM: f64 = 500.0;

/// How fast a bead is to be driven.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pace {
    /// What the profile gives beads of its kind, mm/s.
    pub(super) speed_mm_s: f64,
    /// What that, or what the hotend melts where that is less, is multiplied by so that the layer takes its time; 1 at most.
    pub(super) slow_down: f64,
    /// No bead is slowed down below this, mm/s.
    pub(super) least_mm_s: f64,
}

impl Pace {
    fn slowed_mm_s(self, speed_mm_s: f64) -> f64 {
        (speed_mm_s * self.slow_down).max(self.least_mm_s.min(speed_mm_s))
    }
}

/// The moves along `points`.
pub(super) fn pieces(points: &[BeadPoint], model: BeadModel, pace: Pace, profile: &Profile) -> Vec<Piece> {
    let firmware = &profile.firmware;
    let shortest_mm = pace.slowed_mm_s(pace.speed_mm_s) / firmware.segments_per_s;
    let tolerance_mm = profile.print.tolerance_mm;
    let mut pieces = Vec::with_capacity(points.len());
    let mut from = 0;
    while from + 1 < points.len() {
        let arc = if firmware.arcs { longest_arc(points, from, profile) } else { None };
        let (to, arc) = match arc {
            Some((to, arc)) => (to, Some(arc)),
            None => (joined(points, from, shortest_mm, tolerance_mm), None),
        };
        let piece = piece(&points[from..=to], arc, model, pace.speed_mm_s);
        let area_mm2 = piece.mm3 / piece.length_mm.max(1e-9);
        let within_flow_mm_s = profile.filament.speed_within_flow_mm_s(pace.speed_mm_s, area_mm2);
        pieces.push(Piece { speed_mm_s: pace.slowed_mm_s(within_flow_mm_s), ..piece });
        from = to;
    }
    limit_density(&mut pieces, profile);
    pieces
}

fn piece(run: &[BeadPoint], arc: Option<Arc>, model: BeadModel, speed_mm_s: f64) -> Piece {
    let (begin, to) = (run[0].at, run[run.len() - 1].at);
    let length_mm = arc.map_or((to - begin).norm(), |arc| (begin - arc.centre).norm() * turn(begin, to, arc));
    Piece { to, mm3: run.windows(2).map(|pair| model.volume_mm3(pair)).sum(), length_mm, arc, speed_mm_s }
}

/// By how much an arc turns, rad.
fn turn(begin: Point2, end: Point2, arc: Arc) -> f64 {
    let angle = |p: Point2| (p.y - arc.centre.y).atan2(p.x - arc.centre.x);
    let ccw = angle(end) - angle(begin);
    (if arc.is_ccw { ccw } else { -ccw }).rem_euclid(2.0 * PI)
}

/// The end of the straight segment that begins at `from`: farther than the next vertex only where that is too near, and no
/// farther than the tolerance holds.
fn joined(points: &[BeadPoint], from: usize, shortest_mm: f64, tolerance_mm: f64) -> usize {
    let a = points[from].at;
    let mut to = from + 1;
    while to + 1 < points.len() && (points[to].at - a).norm() < shortest_mm {
        let b = points[to + 1].at;
        let inside = &points[from + 1..=to];
        let near = inside.iter().all(|p| distance_mm(p.at, a, b) <= tolerance_mm);
        // Both edges move by half of the spread.
        if !near || width_spread_mm(&points[from..=to]) / 2.0 > tolerance_mm {
            break;
        }
        to += 1;
    }
    to
}

/// By how much the widths of segments differ at most, mm.
fn width_spread_mm(segments: &[BeadPoint]) -> f64 {
    let widths = segments.iter().map(|p| p.width_mm);
    widths.clone().fold(0.0, f64::max) - widths.fold(f64::INFINITY, f64::min)
}

fn distance_mm(p: Point2, a: Point2, b: Point2) -> f64 {
    let along = b - a;
    let t = ((p - a).dot(&along) / along.norm_squared().max(1e-18)).clamp(0.0, 1.0);
    (p - a - along * t).norm()
}

/// The longest arc that begins at `from`, found by doubling, then by bisection.
fn longest_arc(points: &[BeadPoint], from: usize, profile: &Profile) -> Option<(usize, Arc)> {
    let last = points.len() - 1;
    let fit = |to: usize| fit(&points[from..=to], profile);
    let mut good = (from + FEWEST_SEGMENTS, fit_at(from + FEWEST_SEGMENTS, last, &fit)?);
    let mut bad = last + 1;
    let mut step = FEWEST_SEGMENTS;
    while good.0 < last {
        let to = (good.0 + step).min(last);
        match fit(to) {
            Some(arc) => good = (to, arc),
            None => {
                bad = to;
                break;
            }
        }
        step *= 2;
    }
    while bad - good.0 > 1 && bad <= last {
        let to = usize::midpoint(good.0, bad);
        match fit(to) {
            Some(arc) => good = (to, arc),
            None => bad = to,
        }
    }
    // What is straight within the tolerance needs no arc.
    let (begin, end) = (points[from].at, points[good.0].at);
    let bulges = |p: &BeadPoint| distance_mm(p.at, begin, end) > profile.print.tolerance_mm;
    points[from..=good.0].iter().any(bulges).then_some(good)
}

fn fit_at(to: usize, last: usize, fit: &impl Fn(usize) -> Option<Arc>) -> Option<Arc> {
    if to <= last { fit(to) } else { None }
}

/// The arc through the ends of a run that keeps within the tolerance of all of it.
fn fit(run: &[BeadPoint], profile: &Profile) -> Option<Arc> {
    let (begin, end) = (run[0].at, run[run.len() - 1].at);
    let half = (end - begin) / 2.0;
    let middle = begin + half;
    let h2 = half.norm_squared();
    let normal = nalgebra::Vector2::new(-half.y, half.x) / h2.sqrt().max(1e-9);
    let vertices = run[1..run.len() - 1].iter().map(|p| p.at);
    let middles = run.windows(2).map(|pair| nalgebra::center(&pair[0].at, &pair[1].at));
    let samples: Vec<Point2> = vertices.chain(middles).collect();
    let (mut ab, mut bb) = (0.0, 0.0);
    for p in &samples {
        let d = p - middle;
        let (a, b) = (d.norm_squared() - h2, 2.0 * d.dot(&normal));
        (ab, bb) = (ab + a * b, bb + b * b);
    }
    // On a straight line there is no centre.
    let centre = (middle + normal * (ab / bb.max(1e-18))).map(on_grid_mm);
    let radius = (begin - centre).norm();
    let by_width_mm = width_spread_mm(&run[..run.len() - 1]) / 2.0;
    let room_mm = profile.print.tolerance_mm - firmware_deviation_mm(radius, profile) - by_width_mm;
    let is_round = radius < LARGEST_RADIUS_MM && room_mm > 0.0;
    // A segment is nearest to the centre at the foot of it, farthest at an end.
    let is_off = |p: Point2| ((p - centre).norm() - radius).abs() > room_mm;
    let is_segment_off =
        |pair: &[BeadPoint]| is_off(pair[1].at) || is_off(nearest_on_segment(centre, pair[0].at, pair[1].at));
    if !is_round || run.windows(2).any(is_segment_off) {
        return None;
    }
    let sides = run.windows(2).map(|pair| (pair[0].at - centre).perp(&(pair[1].at - centre)));
    let is_ccw = (run[0].at - centre).perp(&(run[1].at - centre)) > 0.0;
    let arc = Arc { centre, is_ccw };
    let mut turned = 0.0;
    for (pair, side) in run.windows(2).zip(sides) {
        if (side > 0.0) != is_ccw {
            return None;
        }
        turned += turn(pair[0].at, pair[1].at, arc);
    }
    (turned <= MOST_TURN_RAD).then_some(arc)
}

/// How far the firmware's chords leave an arc, mm.
fn firmware_deviation_mm(radius_mm: f64, profile: &Profile) -> f64 {
    profile.firmware.arc_chord_mm(radius_mm).powi(2) / (8.0 * radius_mm)
}

/// Slows moves down so that no run of them, wherever it begins, asks the planner for more a second than it takes. Half of its
/// buffer evens out what is denser for a moment, and a bead of fewer moves.
fn limit_density(pieces: &mut [Piece], profile: &Profile) {
    let n_together = (profile.firmware.planner_moves / 2).max(4);
    let lengths: Vec<f64> = pieces.iter().map(|p| p.length_mm).collect();
    for (first, run) in lengths.windows(n_together).enumerate() {
        let mean_mm = run.iter().sum::<f64>() / n_together as f64;
        let fastest = (mean_mm * profile.firmware.segments_per_s).max(SLOWEST_MM_S);
        pieces[first..first + n_together].iter_mut().for_each(|p| p.speed_mm_s = p.speed_mm_s.min(fastest));
    }
}

/// No move is driven slower than this, mm/s.
const SLOWEST_MM_S: f64 = 1.0;

#[cfg(test)]
mod tests;
