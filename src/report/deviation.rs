//! Two outlines of one plane to the figures of their difference.
//!
//! Both outlines are walked in steps of [`STEP_MM`]; every step measures the exact distance to the other one
//! (point to polyline). Both ways are pooled, so each figure weighs the two curves by their length. The signed
//! distance is positive where the tested outline lies outside the reference. Mean, RMS and bias err by less
//! than a micrometre through the sampling where the outlines are smooth; the maximum may miss a corner
//! between two steps by half a step.

use crate::geom::distance::Foot;
use crate::geom::{Contour, Point2, Region, SegmentIndex};
use serde::Serialize;

/// Distance of the samples along the outlines, mm.
pub const STEP_MM: f64 = 0.05;

/// A boundary in a plane, of which some vertices may be guesses that bridge gaps.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Outline {
    /// Outer contours counter-clockwise, holes clockwise.
    pub(super) region: Region,
    /// For every contour and vertex whether it was measured; `None`: all were.
    pub(super) measured: Option<Vec<Vec<bool>>>,
}

impl From<Region> for Outline {
    fn from(region: Region) -> Self {
        Self { region, measured: None }
    }
}

impl Outline {
    fn edge_is_measured(&self, contour_idx: usize, edge_idx: usize) -> bool {
        let Some(measured) = &self.measured else { return true };
        measured.get(contour_idx).is_none_or(|of_vertex| {
            let n = of_vertex.len();
            n == 0 || (of_vertex[edge_idx % n] && of_vertex[(edge_idx + 1) % n])
        })
    }

    /// Whether a foot lies on a measured edge, and not on its very end beside a guessed one: there, what is
    /// nearest may be a part that was not seen.
    fn foot_is_measured(&self, foot: &Foot) -> bool {
        if self.measured.is_none() {
            return true;
        }
        let contour = &self.region.contours[foot.contour_idx];
        let (n, i) = (contour.len(), foot.edge_idx);
        let at = |vertex: usize| (contour.points[vertex % n] - foot.point).norm() < 1e-9;
        self.edge_is_measured(foot.contour_idx, i)
            && (!at(i) || self.edge_is_measured(foot.contour_idx, (i + n - 1) % n))
            && (!at(i + 1) || self.edge_is_measured(foot.contour_idx, (i + 1) % n))
    }

    /// Whether the enclosed area is known: at least half of every contour was measured.
    fn area_is_known(&self) -> bool {
        self.measured.iter().flatten().all(|m| 2 * m.iter().filter(|&&found| found).count() >= m.len())
    }

    /// Points along the measured edges, [`STEP_MM`] apart within each edge's share of the length.
    fn samples(&self) -> Vec<Point2> {
        let mut samples = Vec::new();
        for (contour_idx, contour) in self.region.contours.iter().enumerate() {
            self.sample_contour(contour_idx, contour, &mut samples);
        }
        samples
    }

    fn sample_contour(&self, contour_idx: usize, contour: &Contour, samples: &mut Vec<Point2>) {
        // The first sample stands half a step in, so that each represents one step of length.
        let mut next = 0.5 * STEP_MM;
        for (edge_idx, (a, b)) in contour.edges().enumerate() {
            let length = (b - a).norm();
            let keep = self.edge_is_measured(contour_idx, edge_idx);
            while next < length {
                if keep {
                    samples.push(a + (b - a) * (next / length));
                }
                next += STEP_MM;
            }
            next -= length;
        }
    }
}

/// What a comparison measured, before it is condensed; several can be pooled.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Comparison {
    /// Signed distances of all samples, both ways, mm: positive where the tested outline is outside.
    pub(super) distances_mm: Vec<f64>,
    /// Where each of them was taken, on either outline.
    pub(super) places: Vec<Point2>,
    /// Areas; `None` where one of them is not known.
    pub(super) areas: Option<Areas>,
}

/// Areas of two regions and of what they share, mm².
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Areas {
    pub(super) reference_mm2: f64,
    pub(super) tested_mm2: f64,
    pub(super) common_mm2: f64,
    /// Length of the outlines of both, mm.
    pub(super) outlines_mm: f64,
}

impl Areas {
    pub(super) fn of(reference: &Region, tested: &Region) -> Self {
        let outlines = reference.contours.iter().chain(&tested.contours);
        Self {
            outlines_mm: outlines.map(Contour::perimeter_mm).sum(),
            reference_mm2: reference.area_mm2(),
            tested_mm2: tested.area_mm2(),
            common_mm2: reference.intersection(tested).area_mm2(),
        }
    }

    pub(super) fn sum<'a>(areas: impl Iterator<Item = &'a Self>) -> Self {
        areas.fold(Self::default(), |a, b| Self {
            reference_mm2: a.reference_mm2 + b.reference_mm2,
            tested_mm2: a.tested_mm2 + b.tested_mm2,
            common_mm2: a.common_mm2 + b.common_mm2,
            outlines_mm: a.outlines_mm + b.outlines_mm,
        })
    }

    /// 2 |A and B| / (|A| + |B|); `None` where both are empty.
    pub(super) fn dice(self) -> Option<f64> {
        let both = self.reference_mm2 + self.tested_mm2;
        (both > 0.0).then(|| 2.0 * self.common_mm2 / both)
    }

    /// |A and B| / |A or B|; `None` where both are empty.
    pub(super) fn iou(self) -> Option<f64> {
        let either = self.reference_mm2 + self.tested_mm2 - self.common_mm2;
        (either > 0.0).then(|| self.common_mm2 / either)
    }

    /// How much larger the tested area is, percent; `None` without a reference.
    pub(super) fn error_percent(self) -> Option<f64> {
        (self.reference_mm2 > 0.0).then(|| 100.0 * (self.tested_mm2 / self.reference_mm2 - 1.0))
    }
}

/// Measures `tested` against `reference`.
///
/// # Errors
/// A sentence for the reader where there is nothing to measure.
pub(super) fn compare(reference: &Outline, tested: &Outline) -> Result<Comparison, &'static str> {
    let reference_index = SegmentIndex::try_new(&reference.region.contours).ok_or("no reference outline")?;
    let tested_index = SegmentIndex::try_new(&tested.region.contours).ok_or("no outline to be tested")?;
    let known = reference.area_is_known() && tested.area_is_known();
    let mut comparison = Comparison {
        areas: known.then(|| Areas::of(&reference.region, &tested.region)),
        ..Comparison::default()
    };
    one_way(tested, reference, &reference_index, 1.0, &mut comparison);
    one_way(reference, tested, &tested_index, -1.0, &mut comparison);
    if comparison.distances_mm.is_empty() {
        return Err("no part of the outline was measured");
    }
    Ok(comparison)
}

/// Distances of the samples of `from` to `to`, outside positive times `sign`; feet on guessed edges do not count.
fn one_way(from: &Outline, to: &Outline, index: &SegmentIndex, sign: f64, comparison: &mut Comparison) {
    for p in from.samples() {
        let foot = index.nearest(p);
        if to.foot_is_measured(&foot) {
            let signed = if index.contains(p) { -foot.distance_mm } else { foot.distance_mm };
            comparison.distances_mm.push(sign * signed);
            comparison.places.push(p);
        }
    }
}

/// The figures of one plane or of all; `None` (JSON `null`) is what could not be measured.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Figures {
    /// Mean unsigned distance, both ways, mm.
    #[serde(serialize_with = "rounded")]
    pub mean_mm: Option<f64>,
    /// Root mean square distance, mm.
    #[serde(serialize_with = "rounded")]
    pub rms_mm: Option<f64>,
    /// 95th percentile of the unsigned distance, mm.
    #[serde(serialize_with = "rounded")]
    pub p95_mm: Option<f64>,
    /// Largest unsigned distance, mm.
    #[serde(serialize_with = "rounded")]
    pub max_mm: Option<f64>,
    /// Mean signed distance, mm: positive where the later stage is outside the earlier one.
    #[serde(serialize_with = "rounded")]
    pub bias_mm: Option<f64>,
    /// Overlap of the enclosed areas, 0 to 1.
    #[serde(serialize_with = "rounded")]
    pub dice: Option<f64>,
    /// How much larger the later area is, percent.
    #[serde(serialize_with = "rounded")]
    pub area_error_percent: Option<f64>,
    /// How uncertain each of them is.
    pub uncertainty: FigureUncertainty,
}

/// Standard uncertainties of [`Figures`], each in the unit of its figure; `None` where the figure is not known.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct FigureUncertainty {
    /// Of the mean, mm.
    #[serde(serialize_with = "rounded")]
    pub mean_mm: Option<f64>,
    /// Of the root mean square, mm.
    #[serde(serialize_with = "rounded")]
    pub rms_mm: Option<f64>,
    /// Of the 95th percentile, mm.
    #[serde(serialize_with = "rounded")]
    pub p95_mm: Option<f64>,
    /// Of the largest distance, mm.
    #[serde(serialize_with = "rounded")]
    pub max_mm: Option<f64>,
    /// Of the bias, mm.
    #[serde(serialize_with = "rounded")]
    pub bias_mm: Option<f64>,
    /// Of Dice.
    #[serde(serialize_with = "rounded")]
    pub dice: Option<f64>,
    /// Of the area's error, percentage points.
    #[serde(serialize_with = "rounded")]
    pub area_error_percent: Option<f64>,
}

impl Figures {
    /// Condenses comparisons, all samples weighing the same.
    pub(super) fn of<'a>(comparisons: impl Iterator<Item = &'a Comparison> + Clone) -> Self {
        let distances: Vec<f64> = comparisons.clone().flat_map(|c| c.distances_mm.iter().copied()).collect();
        let areas = Areas::sum(comparisons.filter_map(|c| c.areas.as_ref()));
        Self {
            dice: areas.dice(),
            area_error_percent: areas.error_percent(),
            ..Self::of_distances(&distances)
        }
    }

    pub(super) fn of_distances(signed_mm: &[f64]) -> Self {
        if signed_mm.is_empty() {
            return Self::default();
        }
        let n = signed_mm.len() as f64;
        let mut unsigned: Vec<f64> = signed_mm.iter().map(|d| d.abs()).collect();
        unsigned.sort_by(f64::total_cmp);
        Self {
            mean_mm: Some(unsigned.iter().sum::<f64>() / n),
            rms_mm: Some((unsigned.iter().map(|d| d * d).sum::<f64>() / n).sqrt()),
            p95_mm: Some(quantile(&unsigned, 0.95)),
            max_mm: unsigned.last().copied(),
            bias_mm: Some(signed_mm.iter().sum::<f64>() / n),
            ..Self::default()
        }
    }
}

/// The quantile of ascending values, linear between neighbours.
pub(super) fn quantile(ascending: &[f64], part: f64) -> f64 {
    let at = part * (ascending.len().saturating_sub(1)) as f64;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "below the length")]
    let below = at as usize;
    let above = (below + 1).min(ascending.len() - 1);
    ascending[below] + (ascending[above] - ascending[below]) * (at - below as f64)
}

/// Writes a figure with six decimals: a nanometre is more than any method here is worth.
///
/// # Errors
/// Those of the serializer.
pub(super) fn rounded<S: serde::Serializer>(value: &Option<f64>, serializer: S) -> Result<S::Ok, S::Error> {
    match value {
        Some(v) if v.is_finite() => serializer.serialize_f64(round_to_micro(*v)),
        _ => serializer.serialize_none(),
    }
}

/// The value to six decimals, without a negative zero.
pub(super) fn round_to_micro(value: f64) -> f64 {
    (value * 1e6).round() / 1e6 + 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn disk(x: f64, radius_mm: f64) -> Outline {
        Region::new(vec![Contour::circle(Point2::new(x, 0.0), radius_mm, 720)]).into()
    }

    fn figures(reference: &Outline, tested: &Outline) -> Figures {
        Figures::of(std::iter::once(&compare(reference, tested).unwrap()))
    }

    #[test]
    fn a_larger_circle_is_off_by_the_difference_of_radii() {
        let f = figures(&disk(0.0, 3.0), &disk(0.0, 3.3));
        for value in [f.mean_mm, f.rms_mm, f.p95_mm, f.max_mm, f.bias_mm] {
            assert!((value.unwrap() - 0.3).abs() < 1e-3, "{f:?}");
        }
        assert!((f.area_error_percent.unwrap() - 21.0).abs() < 0.01);
        assert!((f.dice.unwrap() - 2.0 * 9.0 / (9.0 + 10.89)).abs() < 1e-4);
        let back = figures(&disk(0.0, 3.3), &disk(0.0, 3.0));
        assert!((back.bias_mm.unwrap() + 0.3).abs() < 1e-3);
    }

    #[test]
    fn a_shifted_circle_has_no_bias_and_the_closed_form_mean() {
        let shift = 0.2;
        let f = figures(&disk(0.0, 3.0), &disk(shift, 3.0));
        // |d cos(t)| has mean 2 d / pi and RMS d / sqrt(2), to first order in d / r.
        assert!((f.mean_mm.unwrap() - 2.0 * shift / std::f64::consts::PI).abs() < 1e-3, "{f:?}");
        assert!((f.rms_mm.unwrap() - shift / 2f64.sqrt()).abs() < 1e-3);
        assert!((f.max_mm.unwrap() - shift).abs() < 1e-3);
        assert!(f.bias_mm.unwrap().abs() < 1e-3);
    }

    #[test]
    fn guessed_vertices_are_left_out_of_the_distances() {
        let mut guessed = disk(0.0, 3.0);
        let contour = &mut guessed.region.contours[0];
        let n = contour.len();
        for p in &mut contour.points[..n / 8] {
            p.coords *= 1.5;
        }
        guessed.measured = Some(vec![(0..n).map(|i| i >= n / 8).collect()]);
        let f = figures(&guessed, &disk(0.0, 3.1));
        assert!((f.max_mm.unwrap() - 0.1).abs() < 0.02 && (f.bias_mm.unwrap() - 0.1).abs() < 0.01, "{f:?}");
    }

    #[test]
    fn nothing_to_compare_is_said() {
        assert!(compare(&Outline::default(), &disk(0.0, 1.0)).is_err());
        assert!(compare(&disk(0.0, 1.0), &Outline::default()).is_err());
    }

    #[test]
    fn samples_are_even_and_cover_the_length() {
        let outline = disk(0.0, 2.0);
        let n = outline.samples().len() as f64;
        assert!((n - outline.region.contours[0].perimeter_mm() / STEP_MM).abs() <= 1.0);
    }

    #[test]
    fn quantiles_interpolate() {
        assert!((quantile(&[0.0, 1.0, 2.0, 3.0], 0.5) - 1.5).abs() < 1e-12);
        assert!((quantile(&[7.0], 0.95) - 7.0).abs() < 1e-12);
    }
}
