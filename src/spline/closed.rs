//! Closed cubic splines round a contour.

use crate::geom::{Contour, Point2, Vector2};

/// Control points of the uniform periodic cubic B-spline through the points: control point i belongs to the
/// curve point i, which is `(c[i-1] + 4 c[i] + c[i+1]) / 6`. `values` holds rows of `width` numbers.
///
/// Cyclic tridiagonal solve by Sherman-Morrison, O(n).
///
/// # Panics
/// Where there are fewer than three rows.
#[must_use]
pub fn periodic_control_points(values: &[f64], width: usize) -> Vec<f64> {
    let n = values.len() / width;
    assert!(n >= 3, "a closed spline needs three points");
    let right: Vec<f64> = values.iter().map(|v| 6.0 * v).collect();
    cyclic_solve(&vec![1.0; n], &vec![4.0; n], &vec![1.0; n], &right, width)
}

/// Solves `lower[i] x[i-1] + diagonal[i] x[i] + upper[i] x[i+1] = right[i]`, indices cyclic.
fn cyclic_solve(lower: &[f64], diagonal: &[f64], upper: &[f64], right: &[f64], width: usize) -> Vec<f64> {
    let n = diagonal.len();
    let gamma = -diagonal[0];
    let mut main = diagonal.to_vec();
    main[0] -= gamma;
    main[n - 1] -= upper[n - 1] * lower[0] / gamma;
    let mut correction = vec![0.0; n];
    correction[0] = gamma;
    correction[n - 1] = upper[n - 1];
    let z = tridiagonal_solve(lower, &main, upper, &correction, 1);
    let mut x = tridiagonal_solve(lower, &main, upper, right, width);
    let ratio = lower[0] / gamma;
    let denominator = 1.0 + z[0] + ratio * z[n - 1];
    for k in 0..width {
        let factor = (x[k] + ratio * x[(n - 1) * width + k]) / denominator;
        for i in 0..n {
            x[i * width + k] -= factor * z[i];
        }
    }
    x
}

fn tridiagonal_solve(
    lower: &[f64],
    diagonal: &[f64],
    upper: &[f64],
    right: &[f64],
    width: usize,
) -> Vec<f64> {
    let n = diagonal.len();
    let mut x = right.to_vec();
    let mut scaled_upper = vec![0.0; n];
    let mut pivot = diagonal[0];
    x[..width].iter_mut().for_each(|v| *v /= pivot);
    for i in 1..n {
        scaled_upper[i - 1] = upper[i - 1] / pivot;
        pivot = diagonal[i] - lower[i] * scaled_upper[i - 1];
        for k in 0..width {
            x[i * width + k] = (x[i * width + k] - lower[i] * x[(i - 1) * width + k]) / pivot;
        }
    }
    for i in (0..n - 1).rev() {
        for k in 0..width {
            x[i * width + k] -= scaled_upper[i] * x[(i + 1) * width + k];
        }
    }
    x
}

/// The closed C2 cubic spline through measured points, parametrised by chord length.
#[derive(Debug, Clone)]
pub struct ClosedCurve {
    points: Vec<Point2>,
    /// Second derivatives at the points.
    bends: Vec<Vector2>,
    /// Chord lengths from each point to the next.
    chords: Vec<f64>,
    /// Arc length from the first point to each point; the whole length last.
    arc: Vec<f64>,
}

impl ClosedCurve {
    /// The curve through the vertices of a contour; repeated neighbours are passed over. `None` where fewer than
    /// three distinct points are left.
    #[must_use]
    pub fn through(contour: &Contour) -> Option<Self> {
        let mut points: Vec<Point2> = Vec::with_capacity(contour.len());
        for &p in &contour.points {
            if points.last().is_none_or(|&q: &Point2| (p - q).norm() > 1e-9) {
                points.push(p);
            }
        }
        while points.len() > 1 && (points[0] - points[points.len() - 1]).norm() <= 1e-9 {
            points.pop();
        }
        if points.len() < 3 {
            return None;
        }
        let n = points.len();
        let chords: Vec<f64> = (0..n).map(|i| (points[(i + 1) % n] - points[i]).norm()).collect();
        let before = |i: usize| chords[(i + n - 1) % n];
        let mut right = Vec::with_capacity(2 * n);
        for i in 0..n {
            let ahead = (points[(i + 1) % n] - points[i]) / chords[i];
            let behind = (points[i] - points[(i + n - 1) % n]) / before(i);
            right.extend_from_slice((6.0 * (ahead - behind)).as_slice());
        }
        let lower: Vec<f64> = (0..n).map(before).collect();
        let diagonal: Vec<f64> = (0..n).map(|i| 2.0 * (before(i) + chords[i])).collect();
        let bends = cyclic_solve(&lower, &diagonal, &chords, &right, 2);
        let bends = bends.chunks_exact(2).map(|b| Vector2::new(b[0], b[1])).collect();
        let mut curve = Self { points, bends, chords, arc: Vec::new() };
        curve.measure();
        Some(curve)
    }

    /// Arc lengths by three-point Gauss quadrature on each piece.
    fn measure(&mut self) {
        const NODES: [(f64, f64); 3] =
            [(0.112_701_665_379_258_3, 5.0 / 18.0), (0.5, 8.0 / 18.0), (0.887_298_334_620_741_7, 5.0 / 18.0)];
        let mut arc = vec![0.0];
        for i in 0..self.points.len() {
            let piece: f64 = NODES.iter().map(|&(t, w)| w * self.speed(i, t)).sum();
            arc.push(arc[i] + piece);
        }
        self.arc = arc;
    }

    /// Whole arc length, mm.
    #[must_use]
    pub fn length_mm(&self) -> f64 {
        self.arc[self.points.len()]
    }

    /// The points that it was made through, each with its arc length from the first one, mm.
    pub fn given(&self) -> impl Iterator<Item = (f64, Point2)> + '_ {
        self.arc.iter().copied().zip(self.points.iter().copied())
    }

    /// The point at fraction `t` of piece `i`.
    fn at(&self, i: usize, t: f64) -> Point2 {
        let j = (i + 1) % self.points.len();
        let (s, h2) = (1.0 - t, self.chords[i] * self.chords[i] / 6.0);
        let line = self.points[i].coords * s + self.points[j].coords * t;
        (line + (self.bends[i] * (s * s * s - s) + self.bends[j] * (t * t * t - t)) * h2).into()
    }

    /// Length of the derivative with respect to the fraction of piece `i`.
    fn speed(&self, i: usize, t: f64) -> f64 {
        let j = (i + 1) % self.points.len();
        let (s, h2) = (1.0 - t, self.chords[i] * self.chords[i] / 6.0);
        let line = self.points[j] - self.points[i];
        (line + (self.bends[i] * (1.0 - 3.0 * s * s) + self.bends[j] * (3.0 * t * t - 1.0)) * h2).norm()
    }

    /// The point at an arc length from the first point, mm; any real number, the curve is closed.
    #[must_use]
    pub fn at_length(&self, length_mm: f64) -> Point2 {
        let whole = self.length_mm();
        let target = length_mm.rem_euclid(whole);
        let i = (self.arc.partition_point(|&a| a <= target).max(1) - 1).min(self.points.len() - 1);
        let piece = self.arc[i + 1] - self.arc[i];
        let rest = target - self.arc[i];
        let mut t = (rest / piece).clamp(0.0, 1.0);
        // One Newton step on the length, by Simpson's rule on the passed part: pieces are nearly uniform in speed.
        let passed = t / 6.0 * (self.speed(i, 0.0) + 4.0 * self.speed(i, 0.5 * t) + self.speed(i, t));
        t = (t + (rest - passed) / self.speed(i, t).max(1e-12)).clamp(0.0, 1.0);
        self.at(i, t)
    }

    /// `n_points` points evenly spaced by arc length, the first one at `start_mm`.
    #[must_use]
    pub fn resampled(&self, n_points: usize, start_mm: f64) -> Vec<Point2> {
        let step = self.length_mm() / n_points as f64;
        (0..n_points).map(|i| self.at_length(start_mm + step * i as f64)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ellipse(n: usize) -> Contour {
        let circle = Contour::circle(Point2::new(7.0, -2.0), 1.0, n);
        Contour::new(circle.points.iter().map(|p| Point2::new(3.0 * p.x, 2.0 * p.y)).collect())
    }

    #[test]
    fn closed_curve_is_close_to_the_ellipse_it_was_sampled_from() {
        let curve = ClosedCurve::through(&ellipse(128)).unwrap();
        let off = |p: Point2| ((p.x / 3.0 - 7.0).hypot(p.y / 2.0 + 2.0) - 1.0).abs();
        let points = curve.resampled(1000, 0.37);
        assert!(points.iter().all(|&p| off(p) < 1e-6));
        let gaps: Vec<f64> = Contour::new(points).edges().map(|(a, b)| (b - a).norm()).collect();
        let mean = gaps.iter().sum::<f64>() / 1000.0;
        assert!(gaps.iter().all(|g| (g / mean - 1.0).abs() < 2e-4));
    }

    #[test]
    fn periodic_control_points_reproduce_their_points() {
        let values: Vec<f64> = (0..37).flat_map(|i| [(f64::from(i) * 0.9).sin(), f64::from(i % 5)]).collect();
        let control = periodic_control_points(&values, 2);
        for i in 0..37 {
            for k in 0..2 {
                let at = |j: usize| control[(j % 37) * 2 + k];
                let point = (at(i + 36) + 4.0 * at(i) + at(i + 1)) / 6.0;
                assert!((point - values[i * 2 + k]).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn repeated_points_are_passed_over() {
        let mut contour = ellipse(16);
        contour.points.insert(3, contour.points[2]);
        contour.points.push(contour.points[0]);
        let clean = ClosedCurve::through(&ellipse(16)).unwrap();
        assert!((ClosedCurve::through(&contour).unwrap().length_mm() - clean.length_mm()).abs() < 1e-12);
        assert!(ClosedCurve::through(&Contour::new(vec![Point2::origin(); 5])).is_none());
    }
}
