//! B-spline basis functions up to degree three: evaluation, derivatives, interpolation, exact refinement.

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

/// Numbers that were read and make no B-spline.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("no B-spline: {0}")]
pub struct Malformed(pub(super) &'static str);

/// The four basis functions that do not vanish at a parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span {
    /// Index of the first of the four control points.
    pub first: usize,
    /// Their weights.
    pub weights: [f64; DEGREE + 1],
}

/// A B-spline basis: a knot vector and a degree of at most three.
///
/// The parameter runs from the knot `degree` to the knot `degree` from the end; a clamped basis repeats its ends there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawBasis")]
pub struct Basis {
    knots: Vec<f64>,
    degree: usize,
}

/// A basis as it was read.
#[derive(Deserialize)]
struct RawBasis {
    knots: Vec<f64>,
    degree: usize,
}

impl TryFrom<RawBasis> for Basis {
    type Error = Malformed;

    fn try_from(RawBasis { knots, degree }: RawBasis) -> Result<Self, Malformed> {
        if !(1..=DEGREE).contains(&degree) {
            return Err(Malformed("its degree is not 1, 2 or 3"));
        }
        if knots.len() < 2 * (degree + 1) {
            return Err(Malformed("it has too few knots"));
        }
        if !knots.iter().all(|k| k.is_finite()) || !knots.is_sorted() {
            return Err(Malformed("its knots do not ascend"));
        }
        let basis = Self { knots, degree };
        let [first, last] = basis.range();
        let is_inside = |k: &f64| *k > first && *k < last;
        if first < last && basis.inner_knots().iter().all(is_inside) {
            Ok(basis)
        } else {
            Err(Malformed("its knots leave no range"))
        }
    }
}

impl Basis {
    /// The basis whose interpolant through `sites` is the not-a-knot cubic spline: as many control points as
    /// sites, no extra end conditions. With fewer than four sites the degree drops (line, parabola).
    ///
    /// # Errors
    /// Fewer than two sites, or sites that do not ascend strictly.
    pub fn not_a_knot(sites: &[f64]) -> Result<Self, SplineError> {
        Self::for_sites(sites, [false, false])
    }

    /// The basis for values at `sites` and, where `is_sloped`, the derivative at the first or last one: a control point
    /// for each. At an end without derivative the site beside it is no knot. With fewer than four values and derivatives
    /// the degree drops.
    ///
    /// # Errors
    /// Fewer than two sites, or sites that do not ascend strictly.
    pub fn for_sites(sites: &[f64], is_sloped: [bool; 2]) -> Result<Self, SplineError> {
        if sites.len() < 2 {
            return Err(SplineError::TooFew { found: sites.len(), needed: 2 });
        }
        let falls = |i: &usize| !sites[*i].is_finite() || sites[*i] <= sites[i - 1];
        if let Some(index) = (1..sites.len()).find(falls) {
            return Err(SplineError::NotAscending { index, value: sites[index] });
        }
        let n_given = sites.len() + is_sloped.iter().filter(|s| **s).count();
        let degree = DEGREE.min(n_given - 1);
        let (first, last) = (sites[0], sites[sites.len() - 1]);
        let mut knots = vec![first; degree + 1];
        // With a lower degree there are no inner knots at all.
        if n_given > DEGREE + 1 {
            let [from, to] = is_sloped.map(|sloped| if sloped { 1 } else { 2 });
            knots.extend_from_slice(&sites[from..sites.len() - to]);
        }
        knots.extend(std::iter::repeat_n(last, degree + 1));
        Ok(Self { knots, degree })
    }

    /// The clamped basis with the given inner knots, each below the next one and all inside `range`.
    #[must_use]
    pub fn clamped(degree: usize, [first, last]: [f64; 2], inner: &[f64]) -> Self {
        debug_assert!((1..=DEGREE).contains(&degree) && first < last);
        let mut knots = vec![first; degree + 1];
        knots.extend_from_slice(inner);
        knots.extend(std::iter::repeat_n(last, degree + 1));
        Self { knots, degree }
    }

    /// The uniform cubic basis whose knots are `k / n` for k from -3 to `n_spans` + 3: control point i is centred on
    /// the parameter (i - 1) / n.
    #[must_use]
    pub(super) fn uniform(n: usize, n_spans: usize) -> Self {
        let knots = (0..n_spans + 2 * DEGREE + 1).map(|k| (k as f64 - DEGREE as f64) / n as f64).collect();
        Self { knots, degree: DEGREE }
    }

    /// How many control points belong to it.
    #[must_use]
    pub fn len(&self) -> usize {
        self.knots.len() - self.degree - 1
    }

    /// Never true: a basis has at least two functions.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The knots inside the parameter's range.
    #[must_use]
    pub fn inner_knots(&self) -> &[f64] {
        &self.knots[self.degree + 1..self.knots.len() - self.degree - 1]
    }

    /// The parameters at which the control points of the identity lie (Greville abscissae): t is reproduced exactly,
    /// and the first and last of a clamped basis are its ends to the last bit.
    #[must_use]
    pub fn greville(&self) -> Vec<f64> {
        let p = self.degree;
        let mean = |i: usize| {
            let base = self.knots[i + 1];
            base + self.knots[i + 1..=i + p].iter().map(|k| k - base).sum::<f64>() / p as f64
        };
        (0..self.len()).map(mean).collect()
    }

    /// The same functions over another parameter, which runs linearly from the range's start to its end.
    #[must_use]
    pub fn over(&self, [first, last]: [f64; 2]) -> Self {
        let [a, b] = self.range();
        let moved = |t: f64| {
            if t <= a {
                first
            } else if t >= b {
                last
            } else {
                first + (last - first) * ((t - a) / (b - a))
            }
        };
        Self { knots: self.knots.iter().map(|&t| moved(t)).collect(), degree: self.degree }
    }

    /// The same functions of the parameter read backwards: what was at the range's start is at its end.
    #[must_use]
    pub fn reversed(&self) -> Self {
        let [a, b] = self.range();
        let turned = |t: f64| {
            if t <= a {
                b
            } else if t >= b {
                a
            } else {
                a + (b - t)
            }
        };
        Self { knots: self.knots.iter().rev().map(|&t| turned(t)).collect(), degree: self.degree }
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
        [self.knots[self.degree], self.knots[self.knots.len() - self.degree - 1]]
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
        let j = self.interval(t);
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

    /// Index of the knot that begins the interval in which t lies; beyond the ends the first or last one.
    fn interval(&self, t: f64) -> usize {
        self.degree + self.inner_knots().partition_point(|&k| k <= t)
    }

    /// Each control point of `finer` as weights of this basis' control points: exact knot insertion, and cutting where
    /// `finer` spans a part of the range only. Every knot of this basis inside the range of `finer` must be one of its
    /// knots, of at least the same multiplicity.
    ///
    /// A control point is the blossom of any polynomial piece in its support (Ramshaw 1989); with all pieces alike in
    /// exact arithmetic, the one in the middle of the support is taken.
    #[must_use]
    pub fn refinement(&self, finer: &Self) -> Vec<Span> {
        let p = self.degree;
        debug_assert_eq!(p, finer.degree);
        let piece = |i: usize| {
            let wide = |m: &usize| finer.knots[*m] < finer.knots[m + 1];
            let off_centre = |m: &usize| (2 * m + 1).abs_diff(2 * i + p + 1);
            let m = (i..=i + p).filter(wide).min_by_key(off_centre).unwrap_or(i);
            self.interval(0.5 * (finer.knots[m] + finer.knots[m + 1]))
        };
        (0..finer.len()).map(|i| self.blossom(piece(i), &finer.knots[i + 1..=i + p])).collect()
    }

    /// Weights of the control points in the blossom of the piece that begins at knot j.
    fn blossom(&self, j: usize, arguments: &[f64]) -> Span {
        let p = self.degree;
        let mut rows = [[0.0; DEGREE + 1]; DEGREE + 1];
        (0..=p).for_each(|r| rows[r][r] = 1.0);
        for (l, t) in arguments.iter().enumerate().map(|(k, t)| (k + 1, t)) {
            for r in (l..=p).rev() {
                let (left, right) = (self.knots[j + r - p], self.knots[j + 1 + r - l]);
                let share = (t - left) / (right - left);
                let (below, above) = (rows[r - 1], rows[r]);
                (0..=p).for_each(|k| rows[r][k] = (1.0 - share) * below[k] + share * above[k]);
            }
        }
        Span { first: j - p, weights: rows[p] }
    }

    /// Control rows of the spline that takes the given `rows` at `sites`, one row a site, each of `width` numbers.
    ///
    /// # Panics
    /// Where there are not as many sites and rows as control points.
    #[must_use]
    pub fn interpolate(&self, sites: &[f64], rows: &[f64], width: usize) -> Vec<f64> {
        self.interpolate_sloped(sites, rows, [None, None], width)
    }

    /// As [`Basis::interpolate`], with the derivative at the first and at the last site where one is given
    /// ([`Basis::for_sites`]).
    ///
    /// # Panics
    /// Where there are not as many rows and derivatives as control points.
    #[must_use]
    pub fn interpolate_sloped(
        &self,
        sites: &[f64],
        rows: &[f64],
        slopes: [Option<&[f64]>; 2],
        width: usize,
    ) -> Vec<f64> {
        let mut matrix: Vec<Span> = sites.iter().map(|&t| self.at(t)).collect();
        let mut control = rows.to_vec();
        // The first derivative stands behind the first row, the last one before the last row: no pivoting is needed.
        let [first, last] = slopes;
        if let (Some(slope), Some(&site)) = (last, sites.last()) {
            let at = matrix.len() - 1;
            matrix.insert(at, self.derivative_at(site));
            control.splice(at * width..at * width, slope.iter().copied());
        }
        if let (Some(slope), Some(&site)) = (first, sites.first()) {
            matrix.insert(1, self.derivative_at(site));
            control.splice(width..width, slope.iter().copied());
        }
        assert!(
            matrix.len() == self.len() && control.len() == matrix.len() * width,
            "one row a control point"
        );
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
        assert!(basis.len() == control.len());
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
            let control = basis.interpolate(&sites, &rows, 1);
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
            let control = basis.interpolate(&sites, &rows, 1);
            for (t, row) in sites.iter().zip(&rows) {
                prop_assert!((value(&basis, &control, basis.at(*t)) - row).abs() < 1e-9);
            }
        }
    }

    proptest! {
        #[test]
        fn derivatives_given_at_the_ends_are_met_and_cubics_reproduced(
            steps in prop::collection::vec(0.05..4.0f64, 2..20), a in prop::array::uniform4(-2.0..2.0f64), seed in 0u64..1000,
        ) {
            let sites = ascending(&steps);
            let ends = [sites[0], sites[sites.len() - 1]];
            for is_sloped in [[true, false], [false, true], [true, true]] {
                let basis = Basis::for_sites(&sites, is_sloped).unwrap();
                let solve = |rows: &[f64], slopes: [f64; 2]| {
                    let given = [0, 1].map(|k| is_sloped[k].then(|| std::slice::from_ref(&slopes[k])));
                    basis.interpolate_sloped(&sites, rows, given, 1)
                };
                let rows: Vec<f64> = (0..sites.len()).map(|i| ((i as f64 + seed as f64) * 1.7).sin()).collect();
                let control = solve(&rows, [0.3, -0.8]);
                for (t, row) in sites.iter().zip(&rows) {
                    prop_assert!((value(&basis, &control, basis.at(*t)) - row).abs() < 1e-9);
                }
                for k in (0..2).filter(|k| is_sloped[*k]) {
                    let slope = value(&basis, &control, basis.derivative_at(ends[k]));
                    prop_assert!((slope - [0.3, -0.8][k]).abs() < 1e-9);
                }
                if basis.degree() == 3 {
                    let cubic = |t: f64| a[0] + t * (a[1] + t * (a[2] + t * a[3]));
                    let rows: Vec<f64> = sites.iter().map(|&t| cubic(t)).collect();
                    let scale = 1.0 + rows.iter().fold(0.0f64, |m, r| m.max(r.abs()));
                    let control = solve(&rows, ends.map(|t| a[1] + t * (2.0 * a[2] + 3.0 * t * a[3])));
                    let t = 0.5 * (ends[0] + ends[1]);
                    prop_assert!((value(&basis, &control, basis.at(t)) - cubic(t)).abs() < 1e-8 * scale);
                }
            }
        }

        #[test]
        fn a_refined_or_cut_spline_is_the_same_curve(
            steps in prop::collection::vec(0.05..4.0f64, 2..20), cut in prop::array::uniform2(0.0..1.0f64),
            extra in prop::collection::vec(0.0..1.0f64, 0..8), seed in 0u64..1000,
        ) {
            let sites = ascending(&steps);
            let basis = Basis::not_a_knot(&sites).unwrap();
            let control: Vec<f64> = (0..basis.len()).map(|i| ((i as f64 + seed as f64) * 1.7).sin()).collect();
            let [lo, hi] = basis.range();
            let at = |share: f64| lo + share * (hi - lo);
            let (a, b) = (at(0.5 * cut[0]), at(0.55 + 0.45 * cut[1]));
            let mut inner: Vec<f64> = basis.inner_knots().to_vec();
            inner.extend(extra.iter().map(|&s| at(s)));
            inner.retain(|t| *t > a && *t < b);
            inner.sort_by(f64::total_cmp);
            inner.dedup();
            let finer = Basis::clamped(basis.degree(), [a, b], &inner);
            let mut out = Vec::new();
            let refined: Vec<f64> = basis.refinement(&finer).into_iter().map(|span| {
                Basis::combine(span, &control, 1, &mut out);
                out[0]
            }).collect();
            for k in 0..=50 {
                let t = a + (b - a) * f64::from(k) / 50.0;
                let (x, y) = (value(&basis, &control, basis.at(t)), value(&finer, &refined, finer.at(t)));
                prop_assert!((x - y).abs() < 1e-12, "{t}: {x} {y}");
            }
        }
    }

    #[test]
    fn a_reversed_or_rescaled_basis_has_the_same_functions() {
        let basis = Basis::not_a_knot(&[0.0, 1.0, 1.5, 3.0, 4.0, 4.5]).unwrap();
        let (turned, wide) = (basis.reversed(), basis.over([10.0, 19.0]));
        for t in [0.0, 0.3, 1.6, 3.2, 4.5] {
            let (s, r, w) = (basis.at(t), turned.at(4.5 - t), wide.at(10.0 + 2.0 * t));
            let weight = |span: &Span, i: usize| entry(span, i);
            for i in 0..basis.len() {
                assert!((weight(&s, i) - weight(&r, basis.len() - 1 - i)).abs() < 1e-14);
                assert!((weight(&s, i) - weight(&w, i)).abs() < 1e-14);
            }
        }
        let greville = basis.greville();
        assert_eq!([greville[0], greville[5]].map(f64::to_bits), basis.range().map(f64::to_bits));
        assert!((value(&basis, &greville, basis.at(2.2)) - 2.2).abs() < 1e-14);
    }

    #[test]
    fn a_basis_that_was_read_is_one() {
        let basis = Basis::not_a_knot(&[0.0, 1.0, 1.5, 3.0, 4.0, 4.5]).unwrap();
        let read = |text: &str| serde_json::from_str::<Basis>(text).map_err(|e| e.to_string());
        assert_eq!(read(&serde_json::to_string(&basis).unwrap()), Ok(basis));
        for (text, fault) in [
            (r#"{"knots":[0,0,0,0,1,1,1,1],"degree":0}"#, "degree"),
            (r#"{"knots":[0,0,0,0,1,1,1,1],"degree":4}"#, "degree"),
            (r#"{"knots":[0,0,0,1,1,1,1],"degree":3}"#, "too few knots"),
            (r#"{"knots":[0,0,0,0,1,1,0.5,1],"degree":3}"#, "ascend"),
            (r#"{"knots":[0,0,0,0,0,0,0,0],"degree":3}"#, "no range"),
            (r#"{"knots":[0,0,0,0,1,1,1,1,1],"degree":3}"#, "no range"),
        ] {
            assert!(read(text).is_err_and(|e| e.contains(fault)), "{text}: {:?}", read(text));
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
