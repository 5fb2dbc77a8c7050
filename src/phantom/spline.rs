//! The natural cubic spline through given knots: C2, straight beyond its ends.
//!
//! Method: the tridiagonal system for the second derivatives (de Boor, A Practical Guide to Splines, ch. IV),
//! solved by the Thomas algorithm. Only the phantom's own tables go in, so knots ascend by construction.

/// Interpolates (z, value) knots; z in mm.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct NaturalSpline {
    knots: Vec<(f64, f64)>,
    /// Second derivative at each knot; zero at both ends.
    curvature: Vec<f64>,
}

impl NaturalSpline {
    /// The spline through knots that ascend in z.
    pub(super) fn new(knots: &[(f64, f64)]) -> Self {
        Self { knots: knots.to_vec(), curvature: second_derivatives(knots) }
    }

    /// The value at height z.
    pub(super) fn at(&self, z: f64) -> f64 {
        let inside = z.clamp(self.knots[0].0, self.knots[self.knots.len() - 1].0);
        let (value, slope) = self.value_and_slope(inside);
        value + slope * (z - inside)
    }

    fn value_and_slope(&self, z: f64) -> (f64, f64) {
        let n = self.knots.len();
        if n == 1 {
            return (self.knots[0].1, 0.0);
        }
        let i = self.knots.partition_point(|k| k.0 <= z).clamp(1, n - 1) - 1;
        let ((z0, v0), (z1, v1)) = (self.knots[i], self.knots[i + 1]);
        let (m0, m1) = (self.curvature[i], self.curvature[i + 1]);
        let h = z1 - z0;
        let (a, b) = ((z1 - z) / h, (z - z0) / h);
        let value = a * v0 + b * v1 + ((a * a * a - a) * m0 + (b * b * b - b) * m1) * h * h / 6.0;
        let slope = (v1 - v0) / h + ((3.0 * b * b - 1.0) * m1 - (3.0 * a * a - 1.0) * m0) * h / 6.0;
        (value, slope)
    }
}

fn second_derivatives(knots: &[(f64, f64)]) -> Vec<f64> {
    let n = knots.len();
    let mut m = vec![0.0; n];
    // Forward sweep: `c` is the upper diagonal after elimination, `m` the right-hand side.
    let mut c = vec![0.0; n];
    for i in 1..n.saturating_sub(1) {
        let (h0, h1) = (knots[i].0 - knots[i - 1].0, knots[i + 1].0 - knots[i].0);
        let rhs = 6.0 * ((knots[i + 1].1 - knots[i].1) / h1 - (knots[i].1 - knots[i - 1].1) / h0);
        let pivot = 2.0 * (h0 + h1) - h0 * c[i - 1];
        c[i] = h1 / pivot;
        m[i] = (rhs - h0 * m[i - 1]) / pivot;
    }
    for i in (1..n.saturating_sub(1)).rev() {
        m[i] -= c[i] * m[i + 1];
    }
    m
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passes_through_its_knots_and_goes_on_straight() {
        let knots = [(0.0, 1.0), (2.0, 4.0), (3.0, 3.5), (7.0, -1.0)];
        let spline = NaturalSpline::new(&knots);
        assert!(knots.iter().all(|&(z, v)| (spline.at(z) - v).abs() < 1e-12));
        let (a, b, c) = (spline.at(8.0), spline.at(9.0), spline.at(10.0));
        assert!((a - 2.0 * b + c).abs() < 1e-12);
    }

    #[test]
    fn first_and_second_derivative_are_continuous_at_knots() {
        let spline = NaturalSpline::new(&[(0.0, 1.0), (2.0, 4.0), (3.0, 3.5), (7.0, -1.0), (9.0, 0.0)]);
        let e = 1e-3;
        for z in [2.0, 3.0, 7.0] {
            let second = |at: f64| (spline.at(at - e) - 2.0 * spline.at(at) + spline.at(at + e)) / (e * e);
            assert!((second(z - e) - second(z + e)).abs() < 0.02);
        }
    }

    #[test]
    fn one_knot_is_a_constant() {
        let spline = NaturalSpline::new(&[(5.0, 2.5)]);
        assert_eq!((spline.at(-3.0), spline.at(40.0)), (2.5, 2.5));
    }
}
