//! Where the points round a tube's sections are set, as fractions of the way round: the same ones on all sections.
//!
//! They begin even, but closer in the notches at the tube's ends. Where the splines through them leave a section
//! they are set closer there, and the distance between neighbours then grows slowly with the distance from that
//! place; an error falls with the fourth power of the points' distance once a bend is resolved, which tells how much
//! closer. So a sharp bend costs some dozen points, wherever it is, and not a multiple of all of them.
//!
//! Cost: linear in the sections that are not followed yet, a few rounds.

use crate::geom::Point2;
use crate::spline::{ClosedCurve, SectionCurve};
use rayon::prelude::*;

/// Points round a tube's section to begin with. 128 at the waist cost a factor of four in accuracy.
pub(super) const SECTION_POINTS: usize = 256;
/// Most of them.
const MOST_POINTS: usize = 4096;
/// How far a section may leave the closed spline through its contour, mm; and with more than an ample number of points.
const TOLERANCE_MM: f64 = 3e-4;
const LOOSE_TOLERANCE_MM: f64 = 6e-4;
const AMPLE_POINTS: usize = 1024;
/// How often points are set anew.
const ROUNDS: usize = 12;
/// By how much neighbouring distances differ at most, over their length.
const GROWTH: f64 = 0.12;
/// By which factor points are set closer in one round, at least and at most.
const CLOSER: [f64; 2] = [0.8, 0.3];
/// Least distance of points on computed sections, as a fraction of the way round, but for notches: the corners of outer
/// outlines wander round from one to the next, and points that follow them more sharply than they wander would overtake
/// each other in between.
pub(super) const LEAST_COMPUTED: f64 = 1.0 / 1024.0;
/// Most that points are closer in a notch than elsewhere, to begin with.
const MOST_DENSITY: f64 = 8.0;

/// A closed curve that a section follows, from a start on it.
#[derive(Debug)]
pub(super) struct Round<'a> {
    pub(super) curve: &'a ClosedCurve,
    pub(super) start_mm: f64,
}

impl Round<'_> {
    fn at(&self, fraction: f64) -> Point2 {
        self.curve.at_length(self.start_mm + fraction * self.curve.length_mm())
    }

    /// The points at the fractions.
    pub(super) fn placed(&self, fractions: &[f64]) -> Vec<Point2> {
        fractions.iter().map(|f| self.at(*f)).collect()
    }

    /// How far the closed spline through the points at the fractions is from the curve, at most, behind each of them: half-way
    /// to the next one, and at the points that the curve itself was made through, where it bends most.
    fn off_mm(&self, fractions: &[f64]) -> Vec<f64> {
        let n = fractions.len();
        let section = SectionCurve::through_points(&self.placed(fractions));
        let gap = |i: usize| next(fractions, i) - fractions[i];
        let off = |i: usize, share: f64, p: Point2| section.distance_mm(p, (i as f64 + share) / n as f64);
        let mut all: Vec<f64> = (0..n).map(|i| off(i, 0.5, self.at(fractions[i] + 0.5 * gap(i)))).collect();
        for (length_mm, p) in self.curve.given() {
            let at = ((length_mm - self.start_mm) / self.curve.length_mm()).rem_euclid(1.0);
            let i = fractions.partition_point(|f| *f <= at).max(1) - 1;
            all[i] = all[i].max(off(i, (at - fractions[i]) / gap(i), p));
        }
        all
    }
}

/// The fraction behind the i-th one, in the next turn behind the last one.
fn next(fractions: &[f64], i: usize) -> f64 {
    fractions.get(i + 1).copied().unwrap_or(1.0 + fractions[0])
}

/// A place on the end of a tube where its contour bends sharply: a corner of the patches that meet it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Notch {
    /// Fraction of the way round at which it lies.
    at: f64,
    /// How much denser than elsewhere points are set in it.
    density: f64,
    /// Half its width as a fraction of the way round.
    width: f64,
}

impl Notch {
    /// The notch at the corner of a contour.
    pub(super) fn at_corner(round: &Round<'_>, corner: Point2) -> Self {
        let whole = round.curve.length_mm();
        let spacing_mm = whole / SECTION_POINTS as f64;
        let n = 8 * SECTION_POINTS;
        let at_mm = |i: usize| whole * i as f64 / n as f64;
        let off = |i: &usize| (round.curve.at_length(at_mm(*i)) - corner).norm_squared();
        let nearest_mm = at_mm((0..n).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(0));
        let h = 0.5 * spacing_mm;
        let [before, here, after] = [-h, 0.0, h].map(|d| round.curve.at_length(nearest_mm + d).coords);
        let curvature = ((before - here * 2.0 + after) / (h * h)).norm();
        let density = (3.0 * spacing_mm * curvature).clamp(1.0, MOST_DENSITY);
        let width = (3.5 / (curvature * whole).max(1e-9)).clamp(0.004, 0.03);
        Self { at: ((nearest_mm - round.start_mm) / whole).rem_euclid(1.0), density, width }
    }
}

/// The fractions at which the splines through the points keep to all curves of a tube, as far as they can with points that
/// are set no closer than `least`.
pub(super) fn fractions(rounds: &[Round<'_>], notches: &[Notch], least: f64) -> Vec<f64> {
    let mut fractions = begun(notches);
    let mut open: Vec<&Round<'_>> = rounds.iter().collect();
    for _ in 0..ROUNDS {
        let all_are_open = open.len() == rounds.len();
        let off: Vec<Vec<f64>> = open.par_iter().map(|round| round.off_mm(&fractions)).collect();
        let tolerance_mm = if fractions.len() < AMPLE_POINTS { TOLERANCE_MM } else { LOOSE_TOLERANCE_MM };
        let leaves = |off: &Vec<f64>| off.iter().any(|mm| *mm > tolerance_mm);
        open = open.into_iter().zip(&off).filter(|(_, off)| leaves(off)).map(|(round, _)| round).collect();
        if open.is_empty() && all_are_open {
            break;
        }
        if open.is_empty() {
            // Points that were moved for some curves may have left others.
            open = rounds.iter().collect();
            continue;
        }
        let most = (0..fractions.len()).map(|i| off.iter().map(|mm| mm[i]).fold(0.0, f64::max));
        let closer = Spacing::of(&fractions, &most.collect::<Vec<_>>(), tolerance_mm, least).fractions();
        if !(fractions.len() + 1..=MOST_POINTS).contains(&closer.len()) {
            break;
        }
        fractions = closer;
    }
    fractions
}

/// The fractions to begin with: even, but closer in the notches.
fn begun(notches: &[Notch]) -> Vec<f64> {
    let passed = |s: f64| {
        let one = |n: &Notch| {
            // Its images in the turns before and after make the density periodic.
            let turns = [-1.0, 0.0, 1.0].map(|k: f64| ((s - n.at - k) / n.width).atan());
            (n.density - 1.0) * n.width * turns.iter().sum::<f64>()
        };
        s + notches.iter().map(one).sum::<f64>()
    };
    let (first, whole) = (passed(0.0), passed(1.0) - passed(0.0));
    let place = |i: usize| {
        let target = first + whole * i as f64 / SECTION_POINTS as f64;
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..50 {
            let middle = 0.5 * (low + high);
            if passed(middle) < target { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    };
    if notches.is_empty() {
        return (0..SECTION_POINTS).map(|i| i as f64 / SECTION_POINTS as f64).collect();
    }
    (0..SECTION_POINTS).map(place).collect()
}

/// The distance that points are to have, linear between the sites, periodic.
struct Spacing {
    sites: Vec<f64>,
    /// At each site, as a fraction of the way round.
    wanted: Vec<f64>,
}

impl Spacing {
    /// The distances that points have, less where the spline through them is off behind them by more than the tolerance, and
    /// growing slowly from there.
    fn of(fractions: &[f64], off_mm: &[f64], tolerance_mm: f64, least: f64) -> Self {
        let n = fractions.len();
        let gaps: Vec<f64> = (0..n).map(|i| next(fractions, i) - fractions[i]).collect();
        let factor = |i: usize| {
            let [least, most] = CLOSER;
            let needed = (tolerance_mm / off_mm[i].max(1e-300)).powf(0.25);
            if off_mm[i] > tolerance_mm { (0.9 * needed).clamp(most, least) } else { 1.0 }
        };
        let closer: Vec<f64> = (0..n).map(|i| (gaps[i] * factor(i)).max(least.min(gaps[i]))).collect();
        let mut wanted: Vec<f64> = (0..n).map(|i| closer[i].min(closer[(i + n - 1) % n])).collect();
        // Twice round either way: from the closest place on, no distance grows faster than it may.
        for k in 0..2 * n {
            let (i, before) = (k % n, (k + n - 1) % n);
            wanted[i] = wanted[i].min(wanted[before] + GROWTH * gaps[before]);
        }
        for k in (0..2 * n).rev() {
            let (i, after) = (k % n, (k + 1) % n);
            wanted[i] = wanted[i].min(wanted[after] + GROWTH * gaps[i]);
        }
        Self { sites: fractions.to_vec(), wanted }
    }

    /// Fractions that lie as far apart as wanted, from the first site on.
    fn fractions(&self) -> Vec<f64> {
        let n = self.sites.len();
        // Between two sites the distance runs linearly from a to b: so many points lie there.
        let piece =
            |i: usize| (self.wanted[i], self.wanted[(i + 1) % n], next(&self.sites, i) - self.sites[i]);
        let count = |(a, b, gap): (f64, f64, f64)| {
            let by = (b - a) / a;
            gap / a * if by.abs() > 1e-6 { by.ln_1p() / by } else { 1.0 - 0.5 * by }
        };
        let mut passed = vec![0.0];
        (0..n).for_each(|i| passed.push(passed[i] + count(piece(i))));
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of points")]
        let n_points = passed[n].ceil() as usize;
        let place = |k: usize| {
            let target = passed[n] * k as f64 / n_points as f64;
            let i = passed.partition_point(|p| *p <= target).clamp(1, n) - 1;
            let ((a, b, gap), rest) = (piece(i), target - passed[i]);
            let by = (b - a) / gap;
            let way = if (by * rest).abs() > 1e-9 { a * (by * rest).exp_m1() / by } else { a * rest };
            self.sites[i] + way.clamp(0.0, gap)
        };
        (0..n_points).map(place).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Contour;

    /// A disk of radius 3 mm with a spike, 0.05 mm wide, pointing outward.
    fn spiked() -> ClosedCurve {
        let point = |k: u32| {
            let angle = std::f64::consts::TAU * f64::from(k) / 512.0;
            let spike = (-((angle - 1.0) / 0.02).powi(2)).exp();
            Point2::new(angle.cos(), angle.sin()) * (3.0 + 0.4 * spike)
        };
        ClosedCurve::through(&Contour::new((0..512).map(point).collect())).expect("a closed curve")
    }

    fn worst_mm(round: &Round<'_>, fractions: &[f64]) -> f64 {
        let section = SectionCurve::through_points(&round.placed(fractions));
        let points: Vec<Point2> = (0..40_000).map(|i| section.at(f64::from(i) / 40_000.0)).collect();
        let index = crate::geom::SegmentIndex::try_new(&[Contour::new(points)]).expect("a contour");
        let at = |k: u32| round.at(f64::from(k) / 5000.0);
        (0..5000).map(|k| index.nearest(at(k)).distance_mm).fold(0.0, f64::max)
    }

    #[test]
    fn a_sharp_bend_is_followed_with_few_points() {
        let curve = spiked();
        let round = Round { curve: &curve, start_mm: 1.0 };
        assert!(worst_mm(&round, &begun(&[])) > 10.0 * TOLERANCE_MM, "even points round it off");
        let fractions = fractions(&[round], &[], 0.0);
        let round = Round { curve: &curve, start_mm: 1.0 };
        let worst = worst_mm(&round, &fractions);
        assert!(worst < 1.2 * TOLERANCE_MM, "{worst} mm with {} points", fractions.len());
        assert!(fractions.len() < 400, "{}", fractions.len());
    }

    #[test]
    fn distances_of_points_change_slowly_and_add_up_to_one_turn() {
        let even: Vec<f64> = (0..100).map(|i| f64::from(i) / 100.0).collect();
        let mut off_mm = vec![0.0; 100];
        (off_mm[0], off_mm[99], off_mm[40]) = (1.0, 1.0, 1.0);
        let closer = Spacing::of(&even, &off_mm, 1e-3, 0.0).fractions();
        assert!(closer[0] == 0.0 && closer.is_sorted() && closer[closer.len() - 1] < 1.0);
        let gaps: Vec<f64> = (0..closer.len()).map(|i| next(&closer, i) - closer[i]).collect();
        assert!((gaps.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        let change = |i: usize| gaps[(i + 1) % gaps.len()] / gaps[i];
        assert!((0..gaps.len()).all(|i| (change(i) - 1.0).abs() < 1.3 * GROWTH), "{gaps:?}");
        let least = gaps.iter().copied().fold(f64::INFINITY, f64::min);
        assert!(least > 0.9 * CLOSER[1] / 100.0 && least < 1.1 * CLOSER[1] / 100.0, "{least}");
    }

    #[test]
    fn circles_keep_even_points() {
        let curve = ClosedCurve::through(&Contour::circle(Point2::origin(), 3.0, 128)).expect("a circle");
        let found = fractions(&[Round { curve: &curve, start_mm: 0.0 }], &[], 0.0);
        assert_eq!(found, begun(&[]));
    }
}
