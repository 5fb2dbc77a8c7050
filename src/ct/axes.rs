//! Direction cosines to two orthogonal unit vectors. Pure; patient coordinates (LPS).
//!
//! Headers write cosines with few digits, so they are never quite orthonormal. The nearest orthonormal pair is taken, which
//! moves row and column by the same angle (Löwdin's symmetric orthonormalisation; for two unit vectors: sum and difference are
//! orthogonal, and are brought to the same length).

use crate::geom::Vector3;

/// Cosines farther from orthonormal are refused: two decimals are off by no more in all but rare directions.
pub(crate) const REFUSED: f64 = 1e-2;
/// Cosines farther from orthonormal are told: three decimals, the fewest that scanners write, are off by no more.
pub(super) const TOLD: f64 = 2e-3;
/// Axes this near to the patient's are the patient's: over 500 mm that is 0.005 mm.
const ALIGNED: f64 = 1e-5;

/// Whether a direction is that axis (true) or its opposite (false).
pub(super) fn along(direction: Vector3, axis: Vector3) -> Option<bool> {
    let is = |d: Vector3| (d - axis).abs().max() < ALIGNED;
    if is(direction) {
        Some(true)
    } else if is(-direction) {
        Some(false)
    } else {
        None
    }
}

/// How far two vectors are from orthonormal: the largest of what their lengths differ from one and of their scalar product.
/// For small faults that is an angle in radians.
pub(super) fn fault(row: Vector3, column: Vector3) -> f64 {
    (row.norm() - 1.0).abs().max((column.norm() - 1.0).abs()).max(row.dot(&column).abs())
}

/// The nearest orthonormal pair and how far the given one was from it.
///
/// # Errors
/// How far the vectors are from orthonormal, where that is more than [`REFUSED`].
pub(crate) fn orthonormal(row: Vector3, column: Vector3) -> Result<([Vector3; 2], f64), f64> {
    let is_finite = row.iter().chain(&column).all(|c| c.is_finite());
    let fault = if is_finite { fault(row, column) } else { f64::INFINITY };
    if fault > REFUSED {
        return Err(fault);
    }
    let (row, column) = (row / row.norm(), column / column.norm());
    let (sum, difference) = (row + column, row - column);
    let (sum, difference) = (sum / sum.norm(), difference / difference.norm());
    let half = std::f64::consts::FRAC_1_SQRT_2;
    Ok(([(sum + difference) * half, (sum - difference) * half], fault))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rounded(v: Vector3, decimals: i32) -> Vector3 {
        let unit = 10_f64.powi(decimals);
        v.map(|x| (x * unit).round() / unit)
    }

    #[test]
    fn rounded_cosines_are_made_orthonormal_within_their_rounding() {
        for degrees in 0..90 {
            let angle = f64::from(degrees).to_radians();
            let row = Vector3::new(angle.cos(), 0.6 * angle.sin(), 0.8 * angle.sin());
            let column = Vector3::new(0.0, 0.8, -0.6);
            let (axes, fault) = orthonormal(rounded(row, 3), rounded(column, 3)).unwrap();
            assert!(fault <= TOLD, "{degrees}: {fault}");
            assert!(super::fault(axes[0], axes[1]) < 1e-15);
            assert!((axes[0] - row).norm() < 1.5e-3 && (axes[1] - column).norm() < 1.5e-3);
        }
    }

    #[test]
    fn both_vectors_turn_by_the_same_angle() {
        let skew = Vector3::new(0.004, 1.0, 0.0);
        let ([row, column], fault) = orthonormal(Vector3::x(), skew).unwrap();
        assert!((fault - 0.004).abs() < 1e-4);
        assert!((row.angle(&Vector3::x()) - column.angle(&skew)).abs() < 1e-8);
    }

    #[test]
    fn what_is_no_pair_of_axes_is_refused_with_its_fault() {
        for (row, column, expected) in [
            (Vector3::x(), Vector3::x(), 1.0),
            (Vector3::zeros(), Vector3::y(), 1.0),
            (Vector3::x() * 1.02, Vector3::y(), 0.02),
            (Vector3::x(), Vector3::new(0.05, 1.0, 0.0), 0.05),
        ] {
            assert!((orthonormal(row, column).unwrap_err() - expected).abs() < 1e-12);
        }
        assert!(orthonormal(Vector3::x() * f64::NAN, Vector3::y()).is_err());
    }
}
