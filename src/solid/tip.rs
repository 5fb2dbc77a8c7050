//! The dome round a tip inside an event's field: closed curves that shrink towards the point where a hole closes or a
//! branch ends.

use super::critical::{Critical, hessian};
use super::event::EventSource;
use crate::geom::{Contour, Point2, Vector2};

/// Curves of a dome; the distance to the tip is halved from one to the next, the radius shrinks by its square root.
const CURVES: i32 = 20;
/// Points of a curve.
const POINTS: usize = 128;
/// The share of the way to the next critical point that a dome may take.
const SHARE: f64 = 0.6;

/// Curves round a tip, the farthest one first; `room` is the signed distance in w to the next critical point on the
/// side on which the branch lies.
pub(super) fn from_field(source: &dyn EventSource, tip: &Critical, room: f64) -> Option<Vec<(f64, Contour)>> {
    let at = |k: i32| tip.w + SHARE * room * 0.5f64.powi(k);
    // Where the curves are no longer seen whole from the tip, the dome ends.
    let first = (0..6).find(|&k| rays(source, tip.at, at(k)).is_some())?;
    (first..first + CURVES).map(|k| Some((at(k), rays(source, tip.at, at(k))?))).collect()
}

/// The closed curve round a point at height w, by rays; the inside to the left.
fn rays(source: &dyn EventSource, centre: Point2, w: f64) -> Option<Contour> {
    let field = source.slice(w);
    let middle = field(centre);
    let h = source.frame()?.step_mm;
    let bend = hessian(&*field, centre, 0.1 * h).trace().abs() * 0.5;
    let expected = (2.0 * middle.value.abs() / bend.max(1e-9)).sqrt();
    let sign = middle.value.signum();
    let on_ray = |k: usize| {
        let (sin, cos) = (std::f64::consts::TAU * k as f64 / POINTS as f64).sin_cos();
        let unit = Vector2::new(cos, sin);
        let value = |t: f64| -sign * field(centre + unit * t).value;
        let step = 0.25 * expected;
        let beyond = (1..24).map(|m| step * f64::from(m)).find(|&t| value(t) >= 0.0)?;
        Some(centre + unit * super::slab::root(value, beyond - step, beyond))
    };
    let points: Vec<Point2> = (0..POINTS).map(on_ray).collect::<Option<_>>()?;
    let contour = Contour::new(points);
    Some(if middle.value < 0.0 { contour } else { contour.reversed() })
}
