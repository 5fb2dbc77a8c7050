//! Deviations to colours: blue where the deposited lumen is too narrow, pale where it is right, red where it is too wide,
//! grey where it is not known. Told apart by those who see no red or no green.

use super::super::plate::Sample;

/// The ends of the scale and its middle.
const NARROW: [f64; 3] = [33.0, 102.0, 172.0];
const RIGHT: [f64; 3] = [247.0, 247.0, 247.0];
const WIDE: [f64; 3] = [178.0, 24.0, 43.0];
/// Not known.
const UNKNOWN: [u8; 3] = [128, 128, 128];

/// The deviation that has full colour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Range {
    pub(super) most_mm: f64,
}

impl Range {
    /// A round one that holds 98 % of the places; not below 0.1 mm, so that what is small looks small.
    pub(super) fn of<'a>(samples: impl Iterator<Item = &'a Sample>) -> Self {
        let mut sizes: Vec<f64> = samples.filter_map(|s| s.off_mm).map(f64::abs).collect();
        sizes.sort_by(f64::total_cmp);
        let most = if sizes.is_empty() { 0.0 } else { super::super::deviation::quantile(&sizes, 0.98) };
        let round = [0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0, 5.0].into_iter().find(|r| *r >= most);
        Self { most_mm: round.unwrap_or(10.0) }
    }

    pub(super) fn colour(self, off_mm: Option<f64>) -> [u8; 3] {
        let Some(off_mm) = off_mm else { return UNKNOWN };
        let part = (off_mm / self.most_mm).clamp(-1.0, 1.0);
        let end = if part < 0.0 { NARROW } else { WIDE };
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between two bytes")]
        let channel = |i: usize| (RIGHT[i] + (end[i] - RIGHT[i]) * part.abs()).round() as u8;
        [channel(0), channel(1), channel(2)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Point2;

    #[test]
    fn the_scale_is_round_and_its_sides_differ() {
        let at = |off_mm| Sample { at: Point2::origin(), contour_idx: 0, off_mm };
        let mut samples = vec![at(Some(0.12)); 99];
        samples.extend([at(Some(7.0)), at(None)]);
        let range = Range::of(samples.iter());
        assert!((range.most_mm - 0.2).abs() < 1e-12);
        assert!((Range::of([].iter()).most_mm - 0.1).abs() < 1e-12);
        assert_eq!(range.colour(Some(0.0)), [247; 3]);
        assert_eq!(range.colour(Some(9.0)), [178, 24, 43]);
        assert_eq!(range.colour(Some(-0.2)), [33, 102, 172]);
        assert_eq!(range.colour(None), UNKNOWN);
    }
}
