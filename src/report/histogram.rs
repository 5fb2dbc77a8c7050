//! How the signed distances of a stage are spread.

use super::deviation::{Comparison, quantile, round_to_micro};
use serde::Serialize;

/// Bins of a histogram; odd, so that the middle one lies about zero.
pub const N_BINS: usize = 41;
/// The bins hold this part of the distances at least.
const INSIDE: f64 = 0.995;
/// The narrowest bin, mm.
const NARROWEST_MM: f64 = 1e-4;

/// Numbers of samples by signed distance, as [`Figures`](super::Figures) pools them: all planes, both ways, every sample weighing the
/// same; outside positive.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Histogram {
    /// Where the first bin begins, mm.
    pub from_mm: f64,
    /// Width of a bin, mm: 1, 2 or 5 times a power of ten.
    pub bin_mm: f64,
    /// Samples in each bin.
    pub counts: Vec<usize>,
    /// Samples below the first bin and beyond the last.
    pub beyond: [usize; 2],
}

impl Histogram {
    /// Of all samples; `None` without any.
    pub(super) fn of<'a>(comparisons: impl Iterator<Item = &'a Comparison> + Clone) -> Option<Self> {
        let distances = || comparisons.clone().flat_map(|c| c.distances_mm.iter().copied());
        let mut sizes: Vec<f64> = distances().map(f64::abs).collect();
        if sizes.is_empty() {
            return None;
        }
        sizes.sort_by(f64::total_cmp);
        let bin_mm = round_width(quantile(&sizes, INSIDE) / (0.5 * N_BINS as f64));
        let from_mm = -0.5 * N_BINS as f64 * bin_mm;
        let mut histogram = Self {
            from_mm: round_to_micro(from_mm),
            bin_mm: round_to_micro(bin_mm),
            counts: vec![0; N_BINS],
            beyond: [0; 2],
        };
        for distance in distances() {
            let place = (distance - from_mm) / bin_mm;
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "not negative")]
            let count = if place < 0.0 { None } else { histogram.counts.get_mut(place as usize) };
            match count {
                Some(count) => *count += 1,
                None => histogram.beyond[usize::from(place >= 0.0)] += 1,
            }
        }
        Some(histogram)
    }
}

/// The least of the round widths that is not below `least_mm`.
fn round_width(least_mm: f64) -> f64 {
    let least_mm = least_mm.max(NARROWEST_MM);
    let power = 10f64.powf(least_mm.log10().floor());
    [1.0, 2.0, 5.0].into_iter().map(|m| m * power).find(|w| *w >= least_mm).unwrap_or(10.0 * power)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_counted_where_they_lie() {
        let mut distances_mm = vec![0.0; 900];
        distances_mm.extend(vec![0.1; 60]);
        distances_mm.extend(vec![-0.1; 38]);
        distances_mm.extend([9.0, -9.0]);
        let comparison = Comparison { distances_mm, ..Comparison::default() };
        let h = Histogram::of([comparison].iter()).unwrap();
        assert!((h.bin_mm - 0.005).abs() < 1e-9 && (h.from_mm + 0.1025).abs() < 1e-9, "{h:?}");
        assert_eq!((h.counts[20], h.counts[40], h.counts[0], h.beyond), (900, 60, 38, [1, 1]));
        assert_eq!(h.counts.iter().sum::<usize>() + 2, 1000);
        assert!(Histogram::of([].iter()).is_none());
    }
}
