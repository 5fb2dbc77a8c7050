//! A closed sequence of evenly spaced values as a sum of waves.

use std::f64::consts::TAU;

/// Cosines and sines of all multiples of a circle's n-th part.
#[derive(Debug, Clone)]
pub(in crate::sections) struct Circle {
    unit: Vec<[f64; 2]>,
}

impl Circle {
    pub(in crate::sections) fn new(n: usize) -> Self {
        let at = |i: usize| {
            let (sin, cos) = (TAU * i as f64 / n as f64).sin_cos();
            [cos, sin]
        };
        Self { unit: (0..n).map(at).collect() }
    }

    pub(in crate::sections) fn len(&self) -> usize {
        self.unit.len()
    }

    /// Cosine and sine of the i-th angle.
    pub(in crate::sections) fn at(&self, i: usize) -> [f64; 2] {
        self.unit[i % self.unit.len()]
    }

    /// Cosine and sine amplitudes of 0 to `most` waves around; the mean comes first, its sine is 0.
    pub(in crate::sections) fn waves(&self, values: &[f64], most: usize) -> Vec<[f64; 2]> {
        let n = values.len() as f64;
        let wave = |m: usize| {
            let sum = values.iter().enumerate().fold([0.0; 2], |[a, b], (i, v)| {
                let [cos, sin] = self.at(m * i);
                [a + v * cos, b + v * sin]
            });
            let scale = if m == 0 { 1.0 } else { 2.0 } / n;
            [sum[0] * scale, sum[1] * scale]
        };
        (0..=most).map(wave).collect()
    }

    /// The values that the waves sum to.
    pub(in crate::sections) fn values(&self, waves: &[[f64; 2]]) -> Vec<f64> {
        let at = |i: usize| {
            let term = |(m, w): (usize, &[f64; 2])| {
                let [cos, sin] = self.at(m * i);
                w[0] * cos + w[1] * sin
            };
            waves.iter().enumerate().map(term).sum()
        };
        (0..self.len()).map(at).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waves_of_a_sum_of_waves_are_its_amplitudes() {
        let circle = Circle::new(64);
        let waves = [[2.0, 0.0], [0.3, -0.1], [0.0, 0.05], [0.2, 0.0]];
        let back = circle.waves(&circle.values(&waves), 3);
        for (a, b) in waves.iter().flatten().zip(back.iter().flatten()) {
            assert!((a - b).abs() < 1e-12, "{a} {b}");
        }
    }
}
