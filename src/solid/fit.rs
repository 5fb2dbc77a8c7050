//! Nonlinear least squares by Levenberg-Marquardt for a handful of parameters.

use nalgebra::{DMatrix, DVector};

const MOST_STEPS: usize = 40;
/// Relative decrease of the sum of squares below which the fit has converged.
const CONVERGED: f64 = 1e-7;

/// Sums over all residuals: of their squares, of their gradients times them, of the products of their gradients.
#[derive(Debug, Clone)]
pub(super) struct Normal {
    sum: f64,
    gradient: DVector<f64>,
    matrix: DMatrix<f64>,
}

impl Normal {
    fn zero(n: usize) -> Self {
        Self { sum: 0.0, gradient: DVector::zeros(n), matrix: DMatrix::zeros(n, n) }
    }

    /// Adds a residual with its derivatives by the parameters from `first` on; the others' are zero.
    pub(super) fn add(&mut self, residual: f64, first: usize, slopes: &[f64]) {
        self.sum += residual * residual;
        for (a, &slope) in slopes.iter().enumerate() {
            self.gradient[first + a] += slope * residual;
            for (b, &other) in slopes[..=a].iter().enumerate() {
                self.matrix[(first + a, first + b)] += slope * other;
            }
        }
    }

    /// As [`Normal::add`], with derivatives by further parameters from `then` on, behind the others.
    pub(super) fn add_with(
        &mut self,
        residual: f64,
        first: usize,
        slopes: &[f64],
        then: usize,
        more: &[f64],
    ) {
        self.add(residual, first, slopes);
        for (a, &slope) in more.iter().enumerate() {
            self.gradient[then + a] += slope * residual;
            for (b, &other) in slopes.iter().enumerate() {
                self.matrix[(then + a, first + b)] += slope * other;
            }
            for (b, &other) in more[..=a].iter().enumerate() {
                self.matrix[(then + a, then + b)] += slope * other;
            }
        }
    }

    fn symmetric(mut self) -> Self {
        self.matrix.fill_upper_triangle_with_lower_triangle();
        self
    }
}

/// Parameters that minimise the sum of the squares of the residuals that `model` adds, starting from `start`.
pub(super) fn least_squares(start: &[f64], model: impl Fn(&[f64], &mut Normal)) -> Vec<f64> {
    let n = start.len();
    let evaluate = |x: &[f64]| {
        let mut normal = Normal::zero(n);
        model(x, &mut normal);
        normal.symmetric()
    };
    let mut x = start.to_vec();
    let mut at = evaluate(&x);
    let mut damping = 1e-3;
    for _ in 0..MOST_STEPS {
        let before = at.sum;
        let mut improved = false;
        while damping < 1e8 {
            let mut damped = at.matrix.clone();
            for i in 0..n {
                damped[(i, i)] += damping * at.matrix[(i, i)].max(1e-9);
            }
            let Some(step) = damped.cholesky().map(|c| c.solve(&at.gradient)) else {
                damping *= 10.0;
                continue;
            };
            let trial: Vec<f64> = x.iter().zip(step.iter()).map(|(a, s)| a - s).collect();
            let there = evaluate(&trial);
            if there.sum < before {
                (x, at) = (trial, there);
                damping = (damping * 0.2).max(1e-9);
                improved = true;
                break;
            }
            damping *= 5.0;
        }
        if !improved || before - at.sum <= CONVERGED * before {
            break;
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_decaying_exponential_is_found() {
        let found = least_squares(&[1.0, 0.1], |x, normal| {
            for i in 0..20 {
                let t = f64::from(i);
                let fading = (-x[1] * t).exp();
                let residual = x[0] * fading - 3.0 * (-0.4 * t).exp();
                normal.add_with(residual, 0, &[fading], 1, &[-t * x[0] * fading]);
            }
        });
        assert!((found[0] - 3.0).abs() < 1e-6 && (found[1] - 0.4).abs() < 1e-6);
    }
}
