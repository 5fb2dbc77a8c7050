//! Cubic B-spline basis on a clamped knot vector, and interpolation through given parameters.

use serde::{Deserialize, Serialize};

const DEGREE: usize = 3;

/// No spline runs through these parameters.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SplineError {
    /// Too few parameters.
    #[error("a spline needs at least {needed} parameters; found {found}")]
    TooFew {
        /// How many there are.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// Parameters must ascend strictly and be finite.
    #[error("spline parameter {index} ({value}) does not ascend")]
    NotAscending {
        /// The first parameter that is not above the one before it.
        index: usize,
        /// Its value.
        value: f64,
    },
}

/// The four basis functions that do not vanish at a parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span {
    /// Index of the first of the four control points.
    pub first: usize,
    /// Their weights.
    pub weights: [f64; DEGREE + 1],
}

/// A cubic B-spline basis whose knots were chosen for interpolation at `sites`.
///
/// With fewer than four sites the degree drops (line, parabola) but the control points stay as many as the sites.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Basis {
    sites: Vec<f64>,
    knots: Vec<f64>,
    degree: usize,
}

impl Basis {
    /// The basis whose interpolant through `sites` is the not-a-knot cubic spline: as many control points as
    /// sites, no extra end conditions.
    ///
    /// # Errors
    /// Fewer than two sites, or sites that do not ascend strictly.
    pub fn not_a_knot(sites: &[f64]) -> Result<Self, SplineError> {
        if sites.len() < 2 {
            return Err(SplineError::TooFew { found: sites.len(), needed: 2 });
        }
        let falls = |i: &usize| !sites[*i].is_finite() || sites[*i] <= sites[i - 1];
        if let Some(index) = (1..sites.len()).find(falls) {
            return Err(SplineError::NotAscending { index, value: sites[index] });
        }
        let degree = DEGREE.min(sites.len() - 1);
        let (first, last) = (sites[0], sites[sites.len() - 1]);
        let mut knots = vec![first; degree + 1];
        // The second and the last but one site are no knots; with a lower degree there are no inner knots at all.
        if degree == DEGREE && sites.len() > 4 {
            knots.extend_from_slice(&sites[2..sites.len() - 2]);
        }
        knots.extend(std::iter::repeat_n(last, degree + 1));
        Ok(Self { sites: sites.to_vec(), knots, degree })
    }

    /// Parameters of interpolation.
    #[must_use]
    pub fn sites(&self) -> &[f64] {
        &self.sites
    }

    /// The knot vector, ends repeated.
    #[must_use]
    pub fn knots(&self) -> &[f64] {
        &self.knots
    }

    /// Polynomial degree: 3, less where there are fewer than four sites.
    #[must_use]
    pub const fn degree(&self) -> usize {
        self.degree
    }

    /// First and last parameter.
    #[must_use]
    pub fn range(&self) -> [f64; 2] {
        [self.sites[0], self.sites[self.sites.len() - 1]]
    }

    /// Values of the basis functions at `t`; beyond the ends the end polynomials go on.
    #[must_use]
    pub fn at(&self, t: f64) -> Span {
        self.span(t, self.degree)
    }

    /// Derivatives of the basis functions at `t`.
    #[must_use]
    pub fn derivative_at(&self, t: f64) -> Span {
        let p = self.degree;
        let lower = self.span(t, p - 1);
        // The lower basis has one function less in the span; its first index is one higher.
        let first = lower.first - 1;
        let mut weights = [0.0; DEGREE + 1];
        for (k, &w) in lower.weights.iter().take(p).enumerate() {
            let i = first + 1 + k;
            let slope = p as f64 / (self.knots[i + p] - self.knots[i]) * w;
            weights[k + 1] += slope;
            weights[k] -= slope;
        }
        Span { first, weights }
    }

    /// Cox-de Boor recursion for the functions of degree `p` (at most the basis' own) at `t`.
    fn span(&self, t: f64, p: usize) -> Span {
        let inner = &self.knots[self.degree + 1..self.knots.len() - self.degree - 1];
        let j = self.degree + inner.partition_point(|&k| k <= t);
        let mut weights = [0.0; DEGREE + 1];
        weights[0] = 1.0;
        for d in 1..=p {
            let mut saved = 0.0;
            for (r, weight) in weights[..d].iter_mut().enumerate() {
                let (left, right) = (self.knots[j + 1 + r - d], self.knots[j + 1 + r]);
                let term = *weight / (right - left);
                *weight = saved + (right - t) * term;
                saved = (t - left) * term;
            }
            weights[d] = saved;
        }
        Span { first: j - p, weights }
    }

    /// Control rows of the spline through `rows`, one row a site, each of `width` numbers.
    ///
    /// # Panics
    /// Where `rows` does not hold one row a site.
    #[must_use]
    pub fn interpolate(&self, rows: &[f64], width: usize) -> Vec<f64> {
        assert_eq!(rows.len(), self.sites.len() * width, "one row a site");
        let mut matrix: Vec<Span> = self.sites.iter().map(|&t| self.at(t)).collect();
        let mut control = rows.to_vec();
        eliminate(&mut matrix, &mut control, width);
        substitute_back(&matrix, &mut control, width);
        control
    }

    /// The row at the given span: weights times control rows.
    pub fn combine(span: Span, control: &[f64], width: usize, out: &mut Vec<f64>) {
        out.clear();
        out.resize(width, 0.0);
        for (k, &w) in span.weights.iter().enumerate() {
            if w.to_bits() << 1 == 0 {
                continue;
            }
            let row = &control[(span.first + k) * width..(span.first + k + 1) * width];
            out.iter_mut().zip(row).for_each(|(o, c)| *o += w * c);
        }
    }
}

/// Forward elimination of the collocation matrix without pivoting: it is totally positive (de Boor, ch. XIII).
fn eliminate(matrix: &mut [Span], control: &mut [f64], width: usize) {
    for i in 0..matrix.len() {
        let pivot = matrix[i];
        let diagonal = entry(&pivot, i);
        for j in i + 1..(i + DEGREE + 1).min(matrix.len()) {
            let factor = entry(&matrix[j], i) / diagonal;
            if factor.to_bits() << 1 == 0 {
                continue;
            }
            let row = &mut matrix[j];
            for column in i..pivot.first + DEGREE + 1 {
                if let Some(slot) = column.checked_sub(row.first).and_then(|c| row.weights.get_mut(c)) {
                    *slot -= factor * entry(&pivot, column);
                }
            }
            let (above, below) = control.split_at_mut(j * width);
            let source = &above[i * width..(i + 1) * width];
            below[..width].iter_mut().zip(source).for_each(|(b, a)| *b -= factor * a);
        }
    }
}

fn substitute_back(matrix: &[Span], control: &mut [f64], width: usize) {
    for i in (0..matrix.len()).rev() {
        let row = &matrix[i];
        let (head, tail) = control.split_at_mut((i + 1) * width);
        let target = &mut head[i * width..];
        for column in i + 1..(row.first + DEGREE + 1).min(matrix.len()) {
            let w = entry(row, column);
            let source = &tail[(column - i - 1) * width..(column - i) * width];
            target.iter_mut().zip(source).for_each(|(t, s)| *t -= w * s);
        }
        let diagonal = entry(row, i);
        target.iter_mut().for_each(|t| *t /= diagonal);
    }
}

fn entry(row: &Span, column: usize) -> f64 {
    column.checked_sub(row.first).and_then(|c| row.weights.get(c)).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn value(basis: &Basis, control: &[f64], span: Span) -> f64 {
        let mut out = Vec::new();
        Basis::combine(span, control, 1, &mut out);
        assert!(basis.sites().len() == control.len());
        out[0]
    }

    fn ascending(steps: &[f64]) -> Vec<f64> {
        steps
            .iter()
            .scan(-3.0, |t, s| {
                *t += s;
                Some(*t)
            })
            .collect()
    }

    proptest! {
        #[test]
        fn cubics_are_reproduced_with_their_derivatives(
            steps in prop::collection::vec(0.05..4.0f64, 4..40), a in prop::array::uniform4(-2.0..2.0f64), at in 0.0..1.0f64,
        ) {
            let sites = ascending(&steps);
            let basis = Basis::not_a_knot(&sites).unwrap();
            let cubic = |t: f64| a[0] + t * (a[1] + t * (a[2] + t * a[3]));
            let slope = |t: f64| a[1] + t * (2.0 * a[2] + 3.0 * t * a[3]);
            let rows: Vec<f64> = sites.iter().map(|&t| cubic(t)).collect();
            let control = basis.interpolate(&rows, 1);
            let [lo, hi] = basis.range();
            let t = lo + at * (hi - lo);
            let scale = 1.0 + rows.iter().fold(0.0f64, |m, r| m.max(r.abs()));
            prop_assert!((value(&basis, &control, basis.at(t)) - cubic(t)).abs() < 1e-8 * scale);
            prop_assert!((value(&basis, &control, basis.derivative_at(t)) - slope(t)).abs() < 1e-6 * scale);
        }

        #[test]
        fn data_are_met_at_the_sites(steps in prop::collection::vec(0.05..4.0f64, 2..60), seed in 0u64..1000) {
            let sites = ascending(&steps);
            let basis = Basis::not_a_knot(&sites).unwrap();
            let rows: Vec<f64> = (0..sites.len()).map(|i| ((i as f64 + seed as f64) * 1.7).sin()).collect();
            let control = basis.interpolate(&rows, 1);
            for (t, row) in sites.iter().zip(&rows) {
                prop_assert!((value(&basis, &control, basis.at(*t)) - row).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn bad_sites_are_refused() {
        assert_eq!(Basis::not_a_knot(&[1.0]), Err(SplineError::TooFew { found: 1, needed: 2 }));
        let error = Basis::not_a_knot(&[0.0, 1.0, 1.0]).unwrap_err();
        assert_eq!(error.to_string(), "spline parameter 2 (1) does not ascend");
        assert!(Basis::not_a_knot(&[0.0, f64::NAN, 1.0]).is_err());
    }
}
