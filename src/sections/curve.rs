//! Smooth closed curves as evenly spaced points: smoothing along the arc, normals, curvature, resampling.

use crate::geom::{Contour, Point2, Vector2};

/// Points of a chord that the resampling walks along: the interpolation between two points is cut this often.
const SUBDIVISIONS: usize = 8;

/// Weights of a Gaussian around 0, summing to 1, cut off at three standard deviations.
pub(super) fn gaussian(sigma_samples: f64) -> Vec<f64> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let half = (3.0 * sigma_samples).ceil().clamp(0.0, 4096.0) as usize;
    let weight = |m: usize| {
        let d = m as f64 - half as f64;
        if half == 0 { 1.0 } else { (-0.5 * (d / sigma_samples).powi(2)).exp() }
    };
    let weights: Vec<f64> = (0..=2 * half).map(weight).collect();
    let sum: f64 = weights.iter().sum();
    weights.iter().map(|w| w / sum).collect()
}

/// Convolution of a closed sequence with a kernel of odd length.
pub(super) fn smoothed_closed<T>(values: &[T], kernel: &[f64]) -> Vec<T>
where
    T: Copy + std::ops::Mul<f64, Output = T> + std::ops::Add<Output = T>,
{
    let (n, half) = (values.len(), kernel.len() / 2);
    // `half` may exceed the length: the sequence is then walked around more than once.
    let start = n * half.div_ceil(n.max(1)) - half;
    let around: Vec<T> = values.iter().copied().cycle().skip(start).take(n + 2 * half).collect();
    let mut smooth: Vec<T> = around.iter().take(n).map(|&v| v * kernel[0]).collect();
    for (m, &weight) in kernel.iter().enumerate().skip(1) {
        smooth.iter_mut().zip(&around[m..]).for_each(|(sum, &v)| *sum = *sum + v * weight);
    }
    smooth
}

/// Unit normals that point to the right of the direction of travel: away from the region, for outer contours
/// and holes alike.
pub(super) fn normals(points: &[Point2]) -> Vec<Vector2> {
    let n = points.len();
    (0..n)
        .map(|i| {
            let t = points[(i + 1) % n] - points[(i + n - 1) % n];
            let length = t.norm();
            if length > 0.0 { Vector2::new(t.y, -t.x) / length } else { Vector2::zeros() }
        })
        .collect()
}

/// Curvature, 1/mm, positive where the curve turns left (the region is convex there).
pub(super) fn curvatures(points: &[Point2]) -> Vec<f64> {
    let n = points.len();
    (0..n)
        .map(|i| {
            let (a, b, c) = (points[(i + n - 1) % n], points[i], points[(i + 1) % n]);
            // Menger curvature: that of the circle through the three points.
            let sides = (b - a).norm() * (c - b).norm() * (c - a).norm();
            if sides > 0.0 { 2.0 * (b - a).perp(&(c - b)) / sides } else { 0.0 }
        })
        .collect()
}

/// `n_points` evenly spaced points of the smooth curve through the points (Catmull & Rom, 1974: cubic, fourth
/// order in the spacing), starting at its leftmost point.
pub(super) fn evenly_spaced(points: &[Point2], n_points: usize) -> Contour {
    let mut dense = subdivided(points);
    let leftmost = (0..dense.len()).min_by(|&a, &b| {
        let key = |i: usize| (dense[i].x, dense[i].y);
        key(a).0.total_cmp(&key(b).0).then(key(a).1.total_cmp(&key(b).1))
    });
    dense.rotate_left(leftmost.unwrap_or(0));
    Contour::new(dense).resampled(n_points)
}

fn subdivided(points: &[Point2]) -> Vec<Point2> {
    let n = points.len();
    let at = |i: usize| points[i % n].coords;
    let mut dense = Vec::with_capacity(n * SUBDIVISIONS);
    for i in 0..n {
        let (p0, p1, p2, p3) = (at(i + n - 1), at(i), at(i + 1), at(i + 2));
        for s in 0..SUBDIVISIONS {
            let t = s as f64 / SUBDIVISIONS as f64;
            let linear = p2 - p0;
            let square = p0 * 2.0 - p1 * 5.0 + p2 * 4.0 - p3;
            let cube = (p1 - p2) * 3.0 + p3 - p0;
            let moved = (linear * t + square * (t * t) + cube * (t * t * t)) * 0.5;
            dense.push((p1 + moved).into());
        }
    }
    dense
}

/// How many evenly spaced points keep the chords within the tolerance of the curve: s² κ / 8 for the spacing s.
pub(super) fn n_points_for(points: &[Point2], tolerance_mm: f64, at_least: usize, at_most: usize) -> usize {
    let length = Contour::new(points.to_vec()).perimeter_mm();
    let sharpest = curvatures(points).iter().fold(0.0_f64, |a, k| a.max(k.abs()));
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped by the caller's limits"
    )]
    let needed = (length * (sharpest / (8.0 * tolerance_mm)).sqrt()).ceil() as usize;
    needed.clamp(at_least, at_most)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn circle(n: usize) -> Vec<Point2> {
        Contour::circle(Point2::new(3.0, -2.0), 2.5, n).points
    }

    #[test]
    fn normals_and_curvature_of_a_circle() {
        let points = circle(90);
        for ((p, n), k) in points.iter().zip(normals(&points)).zip(curvatures(&points)) {
            assert!(((p - Point2::new(3.0, -2.0)).normalize() - n).norm() < 1e-9);
            assert!((k - 0.4).abs() < 1e-9);
        }
        let hole: Vec<Point2> = points.into_iter().rev().collect();
        assert!(curvatures(&hole).iter().all(|k| (k + 0.4).abs() < 1e-9));
    }

    #[test]
    fn resampling_starts_leftmost_and_stays_on_the_circle() {
        let c = evenly_spaced(&circle(200), 128);
        assert!(c.points.iter().all(|p| p.x >= c.points[0].x));
        assert!(c.points.iter().all(|p| ((p - Point2::new(3.0, -2.0)).norm() - 2.5).abs() < 2e-5));
    }

    #[test]
    fn smoothing_keeps_a_constant_and_wraps_around() {
        let kernel = gaussian(9.0);
        assert!(smoothed_closed(&[4.0; 7], &kernel).iter().all(|v| (v - 4.0).abs() < 1e-12));
        let mut spike = vec![0.0; 50];
        spike[0] = 1.0;
        let smooth = smoothed_closed(&spike, &gaussian(2.0));
        assert!((smooth[1] - smooth[49]).abs() < 1e-15 && (smooth.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn chord_tolerance_is_kept() {
        let n = n_points_for(&circle(400), 1e-3, 16, 4096);
        let sagitta = 2.5 * (1.0 - (std::f64::consts::PI / n as f64).cos());
        assert!(sagitta <= 1.01e-3 && sagitta > 0.9e-3, "{n} {sagitta}");
    }
}
