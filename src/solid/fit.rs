//! Nonlinear least squares by Levenberg-Marquardt with a numerical Jacobian, for a handful of parameters.

use nalgebra::{DMatrix, DVector};

const MOST_STEPS: usize = 40;
/// Relative decrease of the sum of squares below which the fit has converged.
const CONVERGED: f64 = 1e-9;

/// Parameters that minimise the sum of the squares that `residuals` appends, starting from `start`.
pub(super) fn least_squares(start: &[f64], residuals: impl Fn(&[f64], &mut Vec<f64>)) -> Vec<f64> {
    let evaluate = |x: &[f64]| {
        let mut out = Vec::new();
        residuals(x, &mut out);
        DVector::from_vec(out)
    };
    let mut x = start.to_vec();
    let mut r = evaluate(&x);
    let mut damping = 1e-3;
    for _ in 0..MOST_STEPS {
        let jacobian = jacobian(&x, &r, &evaluate);
        let normal = jacobian.transpose() * &jacobian;
        let gradient = jacobian.transpose() * &r;
        let before = r.norm_squared();
        let mut improved = false;
        while damping < 1e8 {
            let mut damped = normal.clone();
            for i in 0..x.len() {
                damped[(i, i)] += damping * normal[(i, i)].max(1e-9);
            }
            let Some(step) = damped.cholesky().map(|c| c.solve(&gradient)) else {
                damping *= 10.0;
                continue;
            };
            let trial: Vec<f64> = x.iter().zip(step.iter()).map(|(a, s)| a - s).collect();
            let trial_r = evaluate(&trial);
            if trial_r.norm_squared() < before {
                (x, r) = (trial, trial_r);
                damping = (damping * 0.2).max(1e-9);
                improved = true;
                break;
            }
            damping *= 5.0;
        }
        if !improved || before - r.norm_squared() <= CONVERGED * before {
            break;
        }
    }
    x
}

fn jacobian(x: &[f64], r: &DVector<f64>, evaluate: &impl Fn(&[f64]) -> DVector<f64>) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(r.len(), x.len());
    for i in 0..x.len() {
        let mut moved = x.to_vec();
        let h = 1e-6 * x[i].abs().max(1.0);
        moved[i] += h;
        matrix.set_column(i, &((evaluate(&moved) - r) / h));
    }
    matrix
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decaying_exponential_is_found() {
        let found = least_squares(&[1.0, 0.1], |x, out| {
            out.extend(
                (0..20).map(|i| x[0] * (-x[1] * f64::from(i)).exp() - 3.0 * (-0.4 * f64::from(i)).exp()),
            );
        });
        assert!((found[0] - 3.0).abs() < 1e-6 && (found[1] - 0.4).abs() < 1e-6);
    }
}
