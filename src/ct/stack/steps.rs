//! The distances between neighbouring planes: which are uneven, and where planes are missing. Pure; mm along the normal.
//!
//! Planes need not lie at equal distances: they are used where they are. A plane counts as missing where another one would fit
//! in between: where a distance is at least twice the one that is usual in the series, or twice both its neighbours. Unless the
//! slabs on both sides are so thick that they meet, and the others overlap no more than these: then the scanner was set to it and
//! nothing was left unseen. Where all slabs overlap (planes resampled, or taken half a slab apart), one that is missing shows all the same.

use super::super::{Error, Warning};
use super::median;

/// More planes than this are not put into one gap: its heights are no steps of a scan.
const MOST_PLANES: f64 = 10_000.0;

/// A plane, as far as distances go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Slab {
    pub(super) z_mm: f64,
    /// As the header states it.
    pub(super) thickness_mm: Option<f64>,
}

/// What is done where planes are missing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::ct) enum Gaps {
    /// They are refused.
    Refused,
    /// They are refused where they touch these heights, mm: nothing outside is used.
    RefusedWithin([f64; 2]),
    /// They are told.
    Told,
}

impl From<bool> for Gaps {
    fn from(are_allowed: bool) -> Self {
        if are_allowed { Self::Told } else { Self::Refused }
    }
}

impl Gaps {
    /// Whether a gap between these heights is refused.
    fn refuse(self, below_mm: f64, above_mm: f64) -> bool {
        match self {
            Self::Refused => true,
            Self::RefusedWithin([lo, hi]) => above_mm > lo && below_mm < hi,
            Self::Told => false,
        }
    }
}

/// Checks the distances between planes, ascending in z and two at least, and returns their median.
///
/// # Errors
/// [`Error::MissingPlanes`] where there are gaps and they are refused.
pub(super) fn check(
    slabs: &[Slab],
    allowed: impl Into<Gaps>,
    warnings: &mut Vec<Warning>,
) -> Result<f64, Error> {
    let allowed = allowed.into();
    let steps: Vec<f64> = slabs.windows(2).map(|w| w[1].z_mm - w[0].z_mm).collect();
    // What is missing only ever lengthens a distance: of two middle ones the lower.
    let usual = median(steps.iter().copied());
    let overlap_mm = median((0..steps.len()).map(|i| overlap_mm(slabs, &steps, i)));
    let is_gap = |i: &usize| is_gap(&steps, *i, usual) && !is_excused(slabs, &steps, *i, usual, overlap_mm);
    let gaps = counted(&steps, (0..steps.len()).filter(is_gap).collect());
    let refused: Vec<Gap> = gaps
        .iter()
        .copied()
        .filter(|g| allowed.refuse(slabs[g.after].z_mm, slabs[g.after + 1].z_mm))
        .collect();
    if let Some(first) = refused.first() {
        return Err(Error::MissingPlanes {
            below_mm: slabs[first.after].z_mm,
            above_mm: slabs[first.after + 1].z_mm,
            n_missing: first.n_missing,
            step_mm: first.beside_mm,
            n_gaps: refused.len(),
        });
    }
    if let Some(first) = gaps.first() {
        let (below_mm, above_mm, n_gaps) = (slabs[first.after].z_mm, slabs[first.after + 1].z_mm, gaps.len());
        let what = match allowed {
            Gaps::RefusedWithin(_) => "outside the heights that are used",
            Gaps::Told | Gaps::Refused => "the shape there is interpolated",
        };
        let n_missing: usize = gaps.iter().map(|g| g.n_missing).sum();
        let text = format!(
            "{n_missing} plane(s) missing in {n_gaps} gap(s) in the stack, the first between z = {below_mm:.3} and {above_mm:.3} mm; {what}"
        );
        warnings.push(Warning::new("ct.missing_planes", text));
    }
    let is_uneven =
        |i: &usize| gaps.iter().all(|g| g.after != *i) && (steps[*i] - usual).abs() > rounding(usual);
    let n_uneven = (0..steps.len()).filter(is_uneven).count();
    if n_uneven > 0 {
        let text = format!(
            "{n_uneven} distance(s) between planes differ from the usual {usual:.3} mm; the true ones were used"
        );
        warnings.push(Warning::new("ct.irregular_spacing", text));
    }
    Ok(usual)
}

/// A distance in which planes are missing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Gap {
    /// The plane below it.
    pub(crate) after: usize,
    /// How many seem to be missing: 1 at least.
    pub(crate) n_missing: usize,
    /// The distance of the planes beside it.
    beside_mm: f64,
}

/// The gaps among the distances between planes, by these alone.
#[must_use]
pub(crate) fn gaps_among(steps: &[f64]) -> Vec<Gap> {
    let usual = median(steps.iter().copied());
    counted(steps, (0..steps.len()).filter(|&i| is_gap(steps, i, usual)).collect())
}

/// How many planes are missing in each gap: as many as lie beside it, where planes lie nearer to each other in one part of a stack
/// than in another.
fn counted(steps: &[f64], gaps: Vec<usize>) -> Vec<Gap> {
    let usual = median(steps.iter().copied());
    let is_whole = |i: &usize| *i < steps.len() && gaps.binary_search(i).is_err();
    let of = |&after: &usize| {
        let beside = [after.checked_sub(1), Some(after + 1)].into_iter().flatten().filter(is_whole);
        let beside_mm = beside.map(|i| steps[i]).reduce(f64::min).unwrap_or(usual);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded, not negative")]
        let n_parts = (steps[after] / beside_mm).round().min(MOST_PLANES) as usize;
        Gap { after, n_missing: n_parts.saturating_sub(1).max(1), beside_mm }
    };
    gaps.iter().map(of).collect()
}

/// How far a distance may be off because headers often round positions to a tenth of a millimetre.
fn rounding(step_mm: f64) -> f64 {
    (0.05 * step_mm).max(0.11)
}

fn is_gap(steps: &[f64], i: usize, usual: f64) -> bool {
    let step = steps[i];
    let fits_twice = |other: f64| step >= 2.0 * other - rounding(other).min(0.5 * other);
    let neighbours = i.checked_sub(1).and_then(|below| Some(steps[below].max(*steps.get(i + 1)?)));
    fits_twice(usual) || neighbours.is_some_and(fits_twice)
}

/// By how much the slabs below and above a step overlap, mm; below zero where they do not meet.
fn overlap_mm(slabs: &[Slab], steps: &[f64], i: usize) -> f64 {
    let half = |slab: &Slab| 0.5 * slab.thickness_mm.unwrap_or(0.0);
    half(&slabs[i]) + half(&slabs[i + 1]) - steps[i]
}

/// Whether the slabs below and above a step leave nothing between them unseen, and overlap as much as the others do.
fn is_excused(slabs: &[Slab], steps: &[f64], i: usize, usual: f64, usual_overlap_mm: f64) -> bool {
    let own_mm = overlap_mm(slabs, steps, i);
    own_mm >= -rounding(steps[i]) && own_mm >= usual_overlap_mm - rounding(usual).min(0.5 * usual)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slabs(z: &[f64], thickness: f64) -> Vec<Slab> {
        z.iter().map(|&z_mm| Slab { z_mm, thickness_mm: Some(thickness) }).collect()
    }

    /// z of planes at these distances.
    fn at(steps: &[f64]) -> Vec<f64> {
        let mut z = vec![0.0];
        z.extend(steps.iter().scan(0.0, |at, s| {
            *at += s;
            Some(*at)
        }));
        z
    }

    /// Gaps found going up; checks that going down finds as many.
    fn n_gaps(z: &[f64], thickness: f64) -> usize {
        let count = |z: &[f64]| match check(&slabs(z, thickness), false, &mut Vec::new()) {
            Ok(_) => 0,
            Err(Error::MissingPlanes { n_gaps, .. }) => n_gaps,
            Err(other) => panic!("{other}"),
        };
        let turned: Vec<f64> = z.iter().rev().map(|v| -v).collect();
        assert_eq!(count(z), count(&turned));
        count(z)
    }

    #[test]
    fn a_gap_outside_the_heights_that_are_used_is_told_only() {
        let all = slabs(&at(&[3.0, 6.0, 3.0, 3.0]), 2.0);
        for (heights, is_refused) in
            [([9.0, 15.0], false), ([8.9, 15.0], true), ([0.0, 3.0], false), ([4.0, 5.0], true)]
        {
            let mut warnings = Vec::new();
            let found = check(&all, Gaps::RefusedWithin(heights), &mut warnings);
            assert_eq!(found.is_err(), is_refused, "{heights:?}");
            assert_eq!(
                warnings.iter().filter(|w| w.text.contains("outside the heights")).count(),
                usize::from(!is_refused)
            );
        }
    }

    #[test]
    fn a_plane_is_missing_where_another_would_fit() {
        assert_eq!(n_gaps(&at(&[3.0, 3.0, 6.0, 3.0]), 2.0), 1);
        assert_eq!(n_gaps(&at(&[3.0, 3.0, 9.0, 3.0, 6.0, 3.0]), 2.0), 2);
        assert_eq!(n_gaps(&at(&[3.0, 6.0, 6.0, 3.0]), 2.0), 2);
        assert_eq!(n_gaps(&at(&[3.0, 3.0, 7.4, 3.0]), 2.0), 1);
        // Positions rounded to tenths.
        assert_eq!(n_gaps(&at(&[0.6, 0.6, 1.2, 0.7, 0.6]), 0.6), 1);
    }

    #[test]
    fn uneven_planes_are_not_missing() {
        assert_eq!(n_gaps(&at(&[3.0, 3.0, 5.0, 5.0, 5.0]), 2.0), 0);
        assert_eq!(n_gaps(&at(&[3.0, 3.4, 2.6, 3.0]), 2.0), 0);
        assert_eq!(n_gaps(&at(&[1.0, 1.2, 1.4, 1.7, 2.0, 2.4, 2.9]), 1.0), 0);
    }

    #[test]
    fn a_plane_missing_in_the_finer_part_is_found() {
        let steps = [2.5, 2.5, 2.5, 5.0, 2.5, 2.5, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0];
        let slabs: Vec<Slab> = at(&steps)
            .into_iter()
            .map(|z_mm| Slab { z_mm, thickness_mm: Some(if z_mm > 17.0 { 5.0 } else { 2.5 }) })
            .collect();
        let error = check(&slabs, false, &mut Vec::new()).unwrap_err();
        let Error::MissingPlanes { below_mm, above_mm, n_missing, n_gaps, .. } = error else {
            panic!("{error}")
        };
        assert_eq!((below_mm, above_mm, n_missing, n_gaps), (7.5, 12.5, 1, 1));
    }

    #[test]
    fn a_plane_missing_under_overlapping_slabs_is_found() {
        // Taken half a slab apart; resampled, the thickness that of the original.
        assert_eq!(n_gaps(&at(&[1.0, 1.0, 2.0, 1.0, 1.0]), 2.0), 1);
        assert_eq!(n_gaps(&at(&[0.5, 0.5, 0.5, 1.0, 0.5, 0.5, 1.5, 0.5]), 5.0), 2);
        assert_eq!(n_gaps(&at(&[0.1, 0.1, 0.1, 0.2, 0.1]), 3.0), 1);
        assert_eq!(n_gaps(&at(&[1.0, 1.0, 1.2, 1.0]), 2.0), 0);
    }

    #[test]
    fn planes_missing_in_the_coarser_part_are_counted_by_those_beside_it() {
        let steps = [[1.0; 12].as_slice(), &[5.0, 5.0, 10.0, 5.0, 5.0]].concat();
        let slabs: Vec<Slab> = at(&steps)
            .into_iter()
            .map(|z_mm| Slab { z_mm, thickness_mm: Some(if z_mm >= 12.0 { 5.0 } else { 1.0 }) })
            .collect();
        let error = check(&slabs, false, &mut Vec::new()).unwrap_err();
        let Error::MissingPlanes { below_mm, n_missing, step_mm, n_gaps, .. } = error else {
            panic!("{error}")
        };
        assert_eq!((below_mm, n_missing, step_mm, n_gaps), (22.0, 1, 5.0, 1));
        let mut warnings = Vec::new();
        check(&slabs, true, &mut warnings).unwrap();
        assert!(
            warnings[0].text.starts_with("1 plane(s) missing in 1 gap(s) in the stack, "),
            "{warnings:?}"
        );
    }

    #[test]
    fn slabs_that_grow_with_the_distance_are_a_protocol() {
        let z = at(&[2.5, 2.5, 2.5, 2.5, 5.0, 5.0]);
        let thickness = |z: f64| if z > 10.0 { 5.0 } else { 2.5 };
        let grown: Vec<Slab> =
            z.iter().map(|&z| Slab { z_mm: z, thickness_mm: Some(thickness(z)) }).collect();
        let mut warnings = Vec::new();
        assert!(
            check(&grown, false, &mut warnings).is_err(),
            "between the last thin slab and the first thick one"
        );
        let grown: Vec<Slab> = z
            .iter()
            .map(|&z| Slab { z_mm: z, thickness_mm: Some(if z >= 10.0 { 7.5 } else { 2.5 }) })
            .collect();
        assert_eq!(check(&grown, false, &mut warnings).unwrap(), 2.5);
        assert_eq!(warnings[0].code, "ct.irregular_spacing");
    }
}
