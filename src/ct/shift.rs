//! A plane moved sideways by a fraction of its pixels. Pure; lengths in pixels.
//!
//! The whole part of the shift moves pixels as they are. The fraction is a convolution, along rows and then along columns, with
//! a sinc under a Kaiser window ([`TAPS`] taps, 60 dB): up to three quarters of the highest frequency that the pixels can hold it
//! keeps amplitude and place within 0.1 %, where linear or cubic interpolation would blur. What a scanner
//! reconstructs holds little beyond that. Constants stay constant.

use std::f64::consts::PI;

/// Pixels that a shifted one is made of, along each axis.
const TAPS: usize = 20;
/// Shape of the window: side lobes 60 dB down (Kaiser's formula, 0.1102 (A - 8.7)).
const BETA: f64 = 5.65;
/// Fractions below this move nothing that a 16-bit value could show.
const NO_FRACTION: f64 = 1e-6;

/// How a plane is moved.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Shift {
    axes: [AxisShift; 2],
}

#[derive(Debug, Clone, PartialEq)]
struct AxisShift {
    /// Index of the pixel that comes to lie at index 0, or just below it.
    whole: i64,
    /// `None` where no fraction is left.
    taps: Option<[f64; TAPS]>,
}

impl Shift {
    /// The shift that fetches pixel i from place i + `from` of the source, columns and rows.
    pub(super) fn new(from: [f64; 2]) -> Self {
        Self { axes: from.map(AxisShift::new) }
    }

    /// Moves a plane of `size` columns and rows into one of `size_moved`; what it does not reach becomes `outside`.
    pub(super) fn apply(
        &self,
        plane: &[f32],
        size: [usize; 2],
        moved: &mut [f32],
        size_moved: [usize; 2],
        outside: f32,
    ) {
        let [along_rows, along_columns] = &self.axes;
        let n = size_moved[0];
        let columns: Vec<_> = (0..n).map(|i| along_rows.sources(i, size[0])).collect();
        // Rows first, into a plane of the new width and the old height.
        let mut wide = vec![outside; n * size[1]];
        for (source, target) in plane.chunks_exact(size[0]).zip(wide.chunks_exact_mut(n)) {
            gather(source, &columns, target);
        }
        moved.fill(outside);
        for (j, target) in moved.chunks_exact_mut(n).enumerate() {
            if let Some(rows) = along_columns.sources(j, size[1]) {
                combine(&wide, n, &rows, target);
            }
        }
    }
}

impl AxisShift {
    fn new(from: f64) -> Self {
        let nearest = from.round();
        if (from - nearest).abs() < NO_FRACTION {
            return Self { whole: to_index(nearest), taps: None };
        }
        Self { whole: to_index(from.floor()), taps: Some(taps(from - from.floor())) }
    }

    /// Indices and weights of what pixel `i` is made of, the outermost pixels repeated; `None` outside the source.
    fn sources(&self, i: usize, n: usize) -> Option<Vec<(usize, f64)>> {
        let (at, last) = (self.whole.checked_add(i64::try_from(i).ok()?)?, i64::try_from(n).ok()? - 1);
        // A pixel reaches half its width beyond its centre: the fraction may lie beyond the first or last centre.
        let is_inside = match &self.taps {
            None => (0..=last).contains(&at),
            Some(_) => (-1..=last).contains(&at),
        };
        let clamped = |index: i64| usize::try_from(index.clamp(0, last)).ok();
        match (&self.taps, is_inside) {
            (_, false) => None,
            (None, true) => Some(vec![(clamped(at)?, 1.0)]),
            (Some(taps), true) => {
                let first = at - (TAPS as i64 / 2 - 1);
                (0_i64..).zip(taps).map(|(t, &w)| Some((clamped(first + t)?, w))).collect()
            }
        }
    }
}

/// Pixels of a row, each a weighted sum of others; those made of none stay.
fn gather(source: &[f32], columns: &[Option<Vec<(usize, f64)>>], target: &mut [f32]) {
    for (value, parts) in target.iter_mut().zip(columns) {
        if let Some(parts) = parts {
            *value = sum(parts.iter().map(|&(at, w)| w * f64::from(source[at])));
        }
    }
}

/// A weighted sum of rows.
fn combine(rows: &[f32], n: usize, parts: &[(usize, f64)], target: &mut [f32]) {
    for (i, value) in target.iter_mut().enumerate() {
        *value = sum(parts.iter().map(|&(row, w)| w * f64::from(rows[row * n + i])));
    }
}

#[expect(clippy::cast_possible_truncation, reason = "an intensity of 24 bits")]
fn sum(parts: impl Iterator<Item = f64>) -> f32 {
    parts.sum::<f64>() as f32
}

#[expect(clippy::cast_possible_truncation, reason = "saturates: so far away nothing is reached")]
fn to_index(whole: f64) -> i64 {
    whole as i64
}

/// Weights of the pixels around a place that lies `fraction` behind the middle one; they add up to one.
fn taps(fraction: f64) -> [f64; TAPS] {
    let half = TAPS as f64 / 2.0;
    let mut taps = std::array::from_fn(|t| {
        let x = t as f64 - (half - 1.0) - fraction;
        let window = bessel_i0(BETA * (1.0 - (x / half).powi(2)).max(0.0).sqrt());
        (PI * x).sin() / (PI * x) * window
    });
    let total: f64 = taps.iter().sum();
    taps.iter_mut().for_each(|w| *w /= total);
    taps
}

/// Modified Bessel function of order 0 by its power series; arguments up to [`BETA`].
fn bessel_i0(x: f64) -> f64 {
    let quarter = 0.25 * x * x;
    let mut term = 1.0;
    let mut total = 1.0;
    for k in 1..=30 {
        term *= quarter / f64::from(k * k);
        total += term;
    }
    total
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(size: [usize; 2], frequency: [f64; 2], at: [f64; 2]) -> Vec<f32> {
        let [nx, ny] = size;
        let value = |i: usize| {
            let (x, y) = ((i % nx) as f64 + at[0], (i / nx) as f64 + at[1]);
            #[expect(clippy::cast_possible_truncation, reason = "a test image")]
            let v = (1000.0 * (PI * (frequency[0] * x + frequency[1] * y)).cos()) as f32;
            v
        };
        (0..nx * ny).map(value).collect()
    }

    /// Largest difference from the truth at least a kernel away from the edges.
    fn fault(frequency: [f64; 2], from: [f64; 2]) -> f32 {
        let size = [48, 40];
        let mut moved = vec![0.0; 48 * 40];
        Shift::new(from).apply(&wave(size, frequency, [0.0; 2]), size, &mut moved, size, 0.0);
        let truth = wave(size, frequency, from);
        let inner = |i: &usize| (12..36).contains(&(i % 48)) && (12..28).contains(&(i / 48));
        (0..moved.len()).filter(inner).map(|i| (moved[i] - truth[i]).abs()).fold(0.0, f32::max)
    }

    #[test]
    fn waves_up_to_three_quarters_of_the_highest_frequency_keep_amplitude_and_place() {
        for tenth in 1..10 {
            let shift = f64::from(tenth) / 10.0;
            for frequency in [0.1, 0.3, 0.5, 0.7, 0.75] {
                let along_x = fault([frequency, 0.0], [shift, 0.0]);
                let along_both = fault([frequency, 0.3], [-shift, 1.0 + shift]);
                assert!(along_x < 2.0 && along_both < 4.0, "{frequency} {shift}: {along_x} {along_both}");
            }
        }
    }

    #[test]
    fn whole_shifts_move_pixels_as_they_are() {
        let plane: Vec<f32> = (0..6_u8).map(f32::from).collect();
        let moved = |from: [f64; 2], size: [usize; 2]| {
            let mut moved = vec![0.0; size[0] * size[1]];
            Shift::new(from).apply(&plane, [3, 2], &mut moved, size, -9.0);
            moved
        };
        assert_eq!(moved([0.0, 0.0], [3, 2]), plane);
        assert_eq!(moved([1.0, 0.0], [3, 2]), [1.0, 2.0, -9.0, 4.0, 5.0, -9.0]);
        assert_eq!(moved([0.0, -1.0], [3, 3]), [-9.0, -9.0, -9.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        assert_eq!(moved([1e300, 0.0], [3, 1]), [-9.0; 3]);
    }

    #[test]
    fn constants_stay_constant_up_to_the_edge() {
        let mut moved = vec![0.0; 20 * 21];
        Shift::new([0.3, -0.6]).apply(&[40.0; 400], [20, 20], &mut moved, [20, 21], -1024.0);
        assert!(moved.iter().all(|v| (v - 40.0).abs() < 1e-4));
    }
}
