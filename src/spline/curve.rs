//! Open B-spline curves in space.

use super::Basis;
use crate::geom::{Point3, Vector3};

/// A B-spline curve in space on a clamped basis, mm.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    basis: Basis,
    control: Vec<Point3>,
}

impl Curve {
    /// The curve with the given control points.
    ///
    /// # Panics
    /// Where there are not as many control points as basis functions.
    #[must_use]
    pub fn new(basis: Basis, control: Vec<Point3>) -> Self {
        assert_eq!(basis.len(), control.len(), "one control point for each function");
        Self { basis, control }
    }

    /// Its basis.
    #[must_use]
    pub const fn basis(&self) -> &Basis {
        &self.basis
    }

    /// Its control points, mm.
    #[must_use]
    pub fn control(&self) -> &[Point3] {
        &self.control
    }

    /// First and last parameter.
    #[must_use]
    pub fn range(&self) -> [f64; 2] {
        self.basis.range()
    }

    /// The first and the last point.
    #[must_use]
    pub fn ends(&self) -> [Point3; 2] {
        [self.control[0], self.control[self.control.len() - 1]]
    }

    /// The point at t.
    #[must_use]
    pub fn at(&self, t: f64) -> Point3 {
        let span = self.basis.at(t);
        let terms = span.weights.iter().zip(&self.control[span.first..]);
        terms.fold(Vector3::zeros(), |sum, (w, p)| sum + p.coords * *w).into()
    }

    /// Length of the polygon of control points, mm: at least the curve's own length, and zero only with it.
    #[must_use]
    pub fn polygon_length_mm(&self) -> f64 {
        self.control.windows(2).map(|p| (p[1] - p[0]).norm()).sum()
    }

    /// The same curve over another parameter, which runs linearly over `range`.
    #[must_use]
    pub fn over(&self, range: [f64; 2]) -> Self {
        Self { basis: self.basis.over(range), control: self.control.clone() }
    }

    /// The same curve run through backwards, over the same range.
    #[must_use]
    pub fn reversed(&self) -> Self {
        Self { basis: self.basis.reversed(), control: self.control.iter().rev().copied().collect() }
    }

    /// The part over `range`, exactly.
    #[must_use]
    pub fn part(&self, range: [f64; 2]) -> Self {
        let inside = |t: &f64| *t > range[0] && *t < range[1];
        let inner: Vec<f64> = self.basis.inner_knots().iter().copied().filter(inside).collect();
        self.refined(Basis::clamped(self.basis.degree(), range, &inner))
    }

    /// The same curve, or a part of it, on a basis that holds all knots of this one ([`Basis::refinement`]).
    #[must_use]
    pub fn refined(&self, finer: Basis) -> Self {
        let point = |span: super::Span| {
            let terms = span.weights.iter().zip(&self.control[span.first..]);
            terms.fold(Vector3::zeros(), |sum, (w, p)| sum + p.coords * *w).into()
        };
        let control = self.basis.refinement(&finer).into_iter().map(point).collect();
        Self { basis: finer, control }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arch() -> Curve {
        let basis = Basis::not_a_knot(&[0.0, 0.4, 1.0, 1.3, 2.0, 3.0]).unwrap();
        let control = (0..6).map(f64::from).map(|i| Point3::new(i, (1.3 * i).sin(), 0.1 * i * i)).collect();
        Curve::new(basis, control)
    }

    #[test]
    fn parts_meet_on_the_curve_and_the_reversed_one_runs_back() {
        let curve = arch();
        let (low, high) = (curve.part([0.0, 1.1]), curve.part([1.1, 3.0]));
        assert!((low.ends()[1] - high.ends()[0]).norm() < 1e-14);
        let turned = curve.reversed();
        for k in 0..=30 {
            let t = 0.1 * f64::from(k);
            let part = if t < 1.1 { &low } else { &high };
            assert!((part.at(t) - curve.at(t)).norm() < 1e-13);
            assert!((turned.at(3.0 - t) - curve.at(t)).norm() < 1e-13);
            assert!((curve.over([5.0, 5.5]).at(5.0 + t / 6.0) - curve.at(t)).norm() < 1e-13);
        }
    }
}
