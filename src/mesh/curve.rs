//! Points along a curve that faces share: as few as keep the chords within the deflection.

use super::chart::Allowed;
use crate::geom::Point3;

/// Samples from which a curve's curvature is taken.
const SAMPLES: usize = 128;
/// Points between two chosen ones at which the chord is measured.
const CHECKS: usize = 6;
/// Share of the deflection for the chords of a shared edge: triangles on both sides add their own.
pub(super) const CHORD_SHARE: f64 = 0.6;
/// Points grow no farther apart than this, in units of their mean distance where the curve is evenly bent.
const MOST_STRETCH: f64 = 1.7;

/// What the points of a curve have to keep.
#[derive(Debug, Clone, Copy)]
pub(super) struct Chords<'a> {
    /// Deflection.
    pub(super) allowed: &'a Allowed<'a>,
    /// Longest chord, mm.
    pub(super) longest_mm: f64,
    /// Fewest chords.
    pub(super) fewest: usize,
}

/// Parameters along a curve over `range`, both ends included, spaced by the square root of curvature.
pub(super) fn spaced(curve: &dyn Fn(f64) -> Point3, [start, end]: [f64; 2], how: Chords<'_>) -> Vec<f64> {
    let allowed_mm = |p: Point3| CHORD_SHARE * how.allowed.at(p);
    let at = |k: usize| start + (end - start) * k as f64 / SAMPLES as f64;
    let samples: Vec<Point3> = (0..=SAMPLES).map(|k| curve(at(k))).collect();
    let length: f64 = samples.windows(2).map(|s| (s[1] - s[0]).norm()).sum();
    // Curvature of the circle through three samples.
    let bend = |k: usize| {
        let (a, b, c) = (samples[k - 1], samples[k], samples[k + 1]);
        let product = (b - a).norm() * (c - b).norm() * (c - a).norm();
        2.0 * (b - a).cross(&(c - a)).norm() / product.max(1e-300)
    };
    let bends: Vec<f64> = (0..=SAMPLES).map(|k| bend(k.clamp(1, SAMPLES - 1))).collect();
    let asked = |p: &Point3| CHORD_SHARE * how.allowed.asked.at(p.z);
    let wanted: Vec<f64> = bends.iter().zip(&samples).map(|(k, p)| (k / (8.0 * asked(p))).sqrt()).collect();
    let mean = (0..SAMPLES)
        .map(|k| 0.5 * (wanted[k] + wanted[k + 1]) * (samples[k + 1] - samples[k]).norm())
        .sum::<f64>()
        / length.max(f64::MIN_POSITIVE);
    let least = (1.0 / how.longest_mm).max(mean / MOST_STRETCH);
    // A spike of rounding must not draw all points to itself; true ones are found by measuring the chords.
    let most = (8.0 * mean).max(least);
    let mut passed = vec![0.0];
    for k in 0..SAMPLES {
        let density = 0.5 * (wanted[k].clamp(least, most) + wanted[k + 1].clamp(least, most));
        let middle = nalgebra::center(&samples[k], &samples[k + 1]);
        let density = density * (asked(&middle) / allowed_mm(middle)).sqrt();
        passed.push(passed[k] + density * (samples[k + 1] - samples[k]).norm().max(1e-12 * length));
    }
    let whole = passed[SAMPLES];
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of chords")]
    let mut n = (whole.min(1e6).ceil() as usize).max(how.fewest);
    loop {
        let parameters: Vec<f64> = (0..=n)
            .map(|k| {
                if k == n {
                    return end;
                }
                let target = whole * k as f64 / n as f64;
                let i = passed.partition_point(|&p| p <= target).clamp(1, SAMPLES);
                let share = (target - passed[i - 1]) / (passed[i] - passed[i - 1]).max(f64::MIN_POSITIVE);
                start + (end - start) * (i as f64 - 1.0 + share) / SAMPLES as f64
            })
            .collect();
        if n > 100_000
            || parameters.windows(2).all(|p| sag(curve, p[0], p[1]) <= allowed_mm(curve(0.5 * (p[0] + p[1]))))
        {
            return parameters;
        }
        n += n / 12 + 1;
    }
}

/// Farthest that the curve is from the chord between two parameters.
pub(super) fn sag(curve: &dyn Fn(f64) -> Point3, from: f64, to: f64) -> f64 {
    let (a, b) = (curve(from), curve(to));
    let chord = b - a;
    let off = |k: usize| {
        let p = curve(from + (to - from) * k as f64 / (CHECKS + 1) as f64) - a;
        (p - chord * (p.dot(&chord) / chord.norm_squared().max(1e-300)).clamp(0.0, 1.0)).norm()
    };
    (1..=CHECKS).map(off).fold(0.0, f64::max)
}
