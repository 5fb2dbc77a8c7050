//! How planes lie beside each other: in line with their normal, leaning (gantry tilt), or each for itself. Pure; mm, stack frame.
//!
//! The line on which the first pixels lie is found by the median of the slopes between planes (Theil and Sen), so that one
//! plane out of place does not bend it. Planes that lean are given their places on that line, which takes the rounding of the
//! headers out; planes that scatter about it are given the places that their headers state.

use super::super::{Error, Warning};
use super::{SAME_PLACE_MM, median};
use crate::geom::{Point2, Point3, Vector2};

/// No gantry leans by less than this: so small a lean is the rounding of the cosines. Scanners tilt in half degrees.
const LEAST_TILT_DEG: f64 = 0.1;
/// No gantry leans by more than this (most reach 30 degrees).
const MOST_TILT_DEG: f64 = 45.0;
/// Slopes between all planes are taken up to so many planes; beyond, between planes half the stack apart.
const MOST_FOR_ALL_PAIRS: usize = 64;

/// How the planes of a stack lie beside each other.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Sideways {
    /// Over each other.
    Straight {
        /// The first pixel of all of them.
        origin: Point2,
    },
    /// Leaning less than any gantry does: the normal has to be turned by this, mm sideways per mm.
    Turned {
        /// Sideways travel per mm of height.
        lean: Vector2,
        /// The middle of the planes' origins.
        origin: Point2,
    },
    /// Each at a place of its own.
    Moved {
        /// The first pixel of each.
        origins: Vec<Point2>,
        /// The lean, where it is one.
        tilt_deg: Option<f64>,
    },
}

/// A plane that does not belong where its header says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct OutOfPlace {
    pub(super) plane: usize,
    pub(super) offset_mm: f64,
}

/// Judges planes, ascending in z and two at least.
///
/// # Errors
/// The outer one for a lean that is no gantry's; the inner one for a plane more than half a pixel beside the line of the others.
pub(super) fn judge(
    planes: &[Point3],
    pixel_mm: f64,
    warnings: &mut Vec<Warning>,
) -> Result<Result<Sideways, OutOfPlace>, Error> {
    let near = (0.1 * pixel_mm).max(SAME_PLACE_MM);
    let height = planes[planes.len() - 1].z - planes[0].z;
    // An axis along which the whole stack leans less than can be seen does not lean.
    let lean = slope(planes).map(|s| if s.abs() * height <= near { 0.0 } else { s });
    let flat: Vec<Point2> = planes.iter().map(|p| p.xy() - lean * p.z).collect();
    let middle = Point2::new(median(flat.iter().map(|p| p.x)), median(flat.iter().map(|p| p.y)));
    let offsets = flat.iter().map(|p| (p - middle).norm());
    let (plane, offset_mm) =
        offsets.enumerate().max_by(|a, b| a.1.total_cmp(&b.1)).expect("there are two planes at least");
    if offset_mm > 0.5 * pixel_mm {
        return Ok(Err(OutOfPlace { plane, offset_mm }));
    }
    let angle_deg = lean.norm().atan().to_degrees();
    if angle_deg > MOST_TILT_DEG {
        return Err(Error::GantryTilt { angle_deg });
    }
    let tilt_deg = (angle_deg > LEAST_TILT_DEG).then_some(angle_deg);
    if offset_mm > near {
        let text = format!(
            "planes lie up to {offset_mm:.3} mm beside their line; each was moved to where its header says it lies"
        );
        warnings.push(Warning::new("ct.plane_offset", text));
        return Ok(Ok(Sideways::Moved { origins: planes.iter().map(|p| p.xy()).collect(), tilt_deg }));
    }
    Ok(Ok(match (tilt_deg, lean == Vector2::zeros()) {
        (_, true) => Sideways::Straight { origin: middle },
        (None, false) => Sideways::Turned { lean, origin: middle },
        (Some(_), false) => {
            Sideways::Moved { origins: planes.iter().map(|p| middle + lean * p.z).collect(), tilt_deg }
        }
    }))
}

/// How far the planes lie sideways per mm of height.
fn slope(planes: &[Point3]) -> Vector2 {
    let n = planes.len();
    let pairs: Vec<(usize, usize)> = if n <= MOST_FOR_ALL_PAIRS {
        (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j))).collect()
    } else {
        (0..n - n / 2).map(|i| (i, i + n / 2)).collect()
    };
    let along = |axis: usize| {
        let slopes = pairs.iter().map(|&(i, j)| {
            let step = planes[j] - planes[i];
            step[axis] / step.z
        });
        gentlest_median(slopes.collect())
    };
    Vector2::new(along(0), along(1))
}

/// The middle value; of two middle ones the smaller in size: half of the pairs of a short stack may hold a plane out of place.
fn gentlest_median(mut slopes: Vec<f64>) -> f64 {
    slopes.sort_by(f64::total_cmp);
    let (a, b) = (slopes[(slopes.len() - 1) / 2], slopes[slopes.len() / 2]);
    if a.abs() < b.abs() { a } else { b }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn planes(at: impl Fn(f64) -> [f64; 2]) -> Vec<Point3> {
        (0..12).map(|k| 3.0 * f64::from(k)).map(|z| Point3::new(at(z)[0], at(z)[1], z)).collect()
    }

    fn judged(planes: &[Point3]) -> (Sideways, Vec<Warning>) {
        let mut warnings = Vec::new();
        (judge(planes, 0.5, &mut warnings).unwrap().unwrap(), warnings)
    }

    #[test]
    fn planes_over_each_other_are_straight() {
        let expected = Sideways::Straight { origin: Point2::new(1.5, -2.0) };
        assert_eq!(judged(&planes(|_| [1.5, -2.0])).0, expected);
        // Rounding of the positions is no lean.
        let rounded = planes(|z| [1.5 + 0.02 * (z * 17.0).sin(), -2.0]);
        assert!(matches!(judged(&rounded).0, Sideways::Straight { .. }));
    }

    #[test]
    fn a_tilt_is_measured_and_its_rounding_taken_out() {
        let lean = 12_f64.to_radians().tan();
        let rounded = planes(|z| [0.0, (100.0 * lean * z).round() / 100.0]);
        let (Sideways::Moved { origins, tilt_deg: Some(deg) }, _) = judged(&rounded) else {
            panic!("no tilt")
        };
        assert!((deg - 12.0).abs() < 0.02, "{deg}");
        assert!(origins.iter().zip(&rounded).all(|(o, p)| o.x == 0.0 && (o.y - lean * p.z).abs() < 0.01));
    }

    #[test]
    fn a_lean_less_than_any_gantry_s_turns_the_normal() {
        let lean = 0.095_f64.to_radians().tan();
        let found = judged(&planes(|z| [lean * z, 0.0])).0;
        assert!(
            matches!(found, Sideways::Turned { lean: v, .. } if v.y == 0.0 && (v.x - lean).abs() < 1e-12),
            "{found:?}"
        );
    }

    #[test]
    fn planes_that_scatter_a_little_are_moved_and_one_that_does_much_is_named_wherever_it_lies() {
        let scattered = planes(|z| [if z == 9.0 { 0.2 } else { 0.0 }, 0.0]);
        let (Sideways::Moved { origins, tilt_deg: None }, warnings) = judged(&scattered) else {
            panic!("not moved")
        };
        assert_eq!((origins[3].x, warnings[0].code.as_str()), (0.2, "ct.plane_offset"));
        for plane in 0..12 {
            let z_out = 3.0 * plane as f64;
            let out = planes(|z| [0.3 * z + if z == z_out { 5.0 } else { 0.0 }, 0.0]);
            let found = judge(&out, 0.5, &mut Vec::new()).unwrap().unwrap_err();
            assert!(found.plane == plane && (found.offset_mm - 5.0).abs() < 1e-9, "{found:?}");
        }
    }

    #[test]
    fn a_lean_beyond_any_gantry_is_refused() {
        let error = judge(&planes(|z| [0.0, 1.2 * z]), 0.5, &mut Vec::new()).unwrap_err();
        assert!(matches!(error, Error::GantryTilt { angle_deg } if (angle_deg - 50.19).abs() < 0.01));
    }
}
