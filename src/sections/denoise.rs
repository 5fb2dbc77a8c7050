//! Noise taken out of a closed curve without shrinking it: a Wiener filter on its Fourier descriptors.
//!
//! A closed curve x + i y of n evenly spaced points is a sum of c_j exp(2 pi i j s / L). On a circle, a
//! displacement along the normal with m waves around shows in the coefficients j = 1 + m and j = 1 - m: size and
//! place are m = 0 and 1 and always kept. Noise of the image displaces the boundary with the same power in
//! every mode, a vessel's shape with a power that falls steeply: each mode is kept by the share of its power
//! that is shape, P / (P + v). The noise v is what stands in the short waves, the same for all contours of a
//! stack; the height of the shape's spectrum is the likeliest for each contour.
//!
//! What it does not do: it does not smooth corners that rise above the noise; without noise it changes nothing.

use super::curve::evenly_spaced;
use crate::geom::{Point2, Vector2};
use nalgebra::Complex;

/// The shape's power falls with this power of the number of waves.
const FALL: i32 = 5;
/// Waves from this many to this many smoothing lengths long show the noise.
const NOISE_BAND: [f64; 2] = [6.5, 12.0];
/// Fewer waves around than this are shape.
const LEAST_NOISE_WAVES: usize = 6;

/// The Fourier descriptors of a curve.
#[derive(Debug, Clone)]
pub(super) struct Spectrum {
    /// c_j for j = -half ..= half.
    coefficients: Vec<Complex<f64>>,
    half: usize,
    length_mm: f64,
    n_points: usize,
    /// Holes run clockwise: their modes count the other way round.
    is_hole: bool,
}

impl Spectrum {
    pub(super) fn of(points: &[Point2]) -> Self {
        let even = evenly_spaced(points, points.len());
        let (n, length_mm, is_hole) = (even.len(), even.perimeter_mm(), !even.is_ccw());
        let half = n / 4;
        let roots = roots_of_unity(n);
        let coefficient = |s: usize| {
            // The exponent j = s - half, kept positive modulo n.
            let j = s + n - half;
            let sum: Complex<f64> = even
                .points
                .iter()
                .enumerate()
                .map(|(p, at)| Complex::new(at.x, at.y) * roots[(j * p) % n].conj())
                .sum();
            sum / n as f64
        };
        let coefficients = (0..=2 * half).map(coefficient).collect();
        Self { coefficients, half, length_mm, n_points: n, is_hole }
    }

    /// Number of waves around the contour that coefficient s stands for.
    fn waves(&self, s: usize) -> usize {
        let first = if self.is_hole { self.half - 1 } else { self.half + 1 };
        s.abs_diff(first)
    }

    /// Power of the noise per mode, times the length (so that contours of any length compare), mm³; `None` where
    /// the contour is too short to tell it from shape.
    pub(super) fn noise_mm3(&self, smoothing_mm: f64) -> Option<f64> {
        let waves = NOISE_BAND.map(|b| self.length_mm / (b * smoothing_mm));
        let in_band = |m: usize| m >= LEAST_NOISE_WAVES && (m as f64) <= waves[0] && (m as f64) >= waves[1];
        let powers: Vec<f64> = (0..self.coefficients.len())
            .filter(|&s| in_band(self.waves(s)))
            .map(|s| self.coefficients[s].norm_sqr())
            .collect();
        (powers.len() >= 4).then(|| powers.iter().sum::<f64>() / powers.len() as f64 * self.length_mm)
    }

    /// The points without the noise.
    pub(super) fn filtered(mut self, noise_mm3: f64) -> Vec<Point2> {
        let noise = noise_mm3 / self.length_mm;
        if noise > 0.0 {
            let shape = self.likeliest_shape(noise);
            for s in 0..self.coefficients.len() {
                let m = self.waves(s);
                if m >= 2 {
                    let power = shape * (m as f64).powi(-FALL);
                    self.coefficients[s] *= power / (power + noise);
                }
            }
        }
        self.points()
    }

    /// Height of the shape's spectrum for which the coefficients are likeliest (Whittle's likelihood).
    fn likeliest_shape(&self, noise: f64) -> f64 {
        let modes: Vec<(f64, f64)> = (0..self.coefficients.len())
            .map(|s| (self.waves(s), self.coefficients[s].norm_sqr()))
            .filter(|&(m, _)| (2..=self.half / 2).contains(&m))
            .map(|(m, power)| ((m as f64).powi(-FALL), power))
            .collect();
        let cost = |shape: f64| {
            let term = |&(fall, power): &(f64, f64)| {
                let expected = shape * fall + noise;
                expected.ln() + power / expected
            };
            modes.iter().map(term).sum::<f64>()
        };
        // From a hundredth of the noise up to anything, in steps of 12 %.
        let heights = (0..200).map(|i| 0.01 * noise * 1.12_f64.powi(i));
        heights.map(|h| (h, cost(h))).min_by(|a, b| a.1.total_cmp(&b.1)).map_or(noise, |(h, _)| h)
    }

    fn points(&self) -> Vec<Point2> {
        let n = self.n_points;
        let roots = roots_of_unity(n);
        let at = |p: usize| {
            let term = |(s, c): (usize, &Complex<f64>)| c * roots[((s + n - self.half) * p) % n];
            let sum: Complex<f64> = self.coefficients.iter().enumerate().map(term).sum();
            Point2::from(Vector2::new(sum.re, sum.im))
        };
        (0..n).map(at).collect()
    }
}

fn roots_of_unity(n: usize) -> Vec<Complex<f64>> {
    let root = |p: usize| Complex::from_polar(1.0, std::f64::consts::TAU * p as f64 / n as f64);
    (0..n).map(root).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Contour;

    /// A lobed circle with pseudo-random displacements.
    fn noisy(seed: u64, amplitude_mm: f64) -> Vec<Point2> {
        let mut state = seed;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        let point = |i: usize| {
            let a = std::f64::consts::TAU * i as f64 / 240.0;
            let r = lobed(a) + amplitude_mm * random();
            Point2::new(10.0 + r * a.cos(), -4.0 + r * a.sin())
        };
        (0..240).map(point).collect()
    }

    fn lobed(a: f64) -> f64 {
        3.0 * (1.0 + 0.05 * (2.0 * a).cos() + 0.02 * (3.0 * a - 0.4).cos())
    }

    fn rms_error(points: &[Point2]) -> f64 {
        let error = |p: &Point2| {
            let d = p - Point2::new(10.0, -4.0);
            (d.norm() - lobed(d.y.atan2(d.x))).powi(2)
        };
        (points.iter().map(error).sum::<f64>() / points.len() as f64).sqrt()
    }

    #[test]
    fn without_noise_nothing_changes() {
        let spectrum = Spectrum::of(&noisy(1, 0.0));
        assert!(rms_error(&spectrum.filtered(0.0)) < 1e-4);
    }

    #[test]
    fn noise_falls_and_the_area_stays() {
        // White noise of 0.1 mm / sqrt(12) on 240 points: its power per mode is the variance / 240.
        let (variance, length) = (0.01 / 12.0, 19.0);
        for seed in 1..6 {
            let points = noisy(seed, 0.1);
            let smooth = Spectrum::of(&points).filtered(variance / 240.0 * length);
            assert!(
                rms_error(&smooth) < 0.45 * rms_error(&points),
                "{} {}",
                rms_error(&smooth),
                rms_error(&points)
            );
            let area = |p: &[Point2]| Contour::new(p.to_vec()).signed_area_mm2();
            assert!((area(&smooth) / area(&points) - 1.0).abs() < 2e-3);
        }
    }

    #[test]
    fn a_hole_is_filtered_like_an_outer_contour() {
        let points = noisy(3, 0.1);
        let back: Vec<Point2> = points.iter().rev().copied().collect();
        let errors = [points, back].map(|p| rms_error(&Spectrum::of(&p).filtered(6.6e-5)));
        assert!((errors[0] - errors[1]).abs() < 1e-3, "{errors:?}");
    }
}
