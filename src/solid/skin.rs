//! A closed skin: tubes between events, slabs of three patches at the events, flat caps at the ends.

use super::Error;
use super::between::between;
use super::event::{Crotch, Slab};
use super::lean::{Leans, end_slopes};
use super::mend::{COARSER, mended};
use super::spacing::{LEAST_COMPUTED, Notch, Round, SECTION_POINTS, fractions};
use super::steady::steadying;
use super::weld::{Weld, weld};
use crate::geom::{Contour, Point2};
use crate::spline::{ClosedCurve, SplineError, TubeSurface};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Every how many points a turn of a section is tried first, and after how many points it may be given up.
const TWIST_STRIDE: usize = 8;
const TWIST_CHUNK: usize = 32;
/// Patches that miss their neighbours by more than this, mm, show another surface.
const MOST_MOVED_MM: f64 = 0.2;

/// Which points of neighbouring sections of a tube are joined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Correspondence {
    /// The start of each section is turned until the tube twists least.
    #[default]
    LeastTwist,
    /// The published rule, for comparison: the first section of a branch starts where x is least, every further one at
    /// the point nearest to the start of the one before. Nothing is added between sections.
    Published,
}

/// What a tube ends in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum End {
    /// A flat cap.
    Cap,
    /// The parent's side of a slab.
    Waist {
        /// Which slab.
        slab: usize,
    },
    /// A daughter's side of a slab.
    Daughter {
        /// Which slab.
        slab: usize,
        /// Which of its daughters, 0 or 1.
        side: usize,
    },
}

impl End {
    /// Height of the slab's border at which it ends; `None` for a cap.
    pub(super) fn z_mm(self, slabs: &[Slab]) -> Option<f64> {
        let border = |slab: usize, end: usize| slabs[slab].z_of(slabs[slab].w_mm[end]);
        match self {
            Self::Cap => None,
            Self::Waist { slab } => Some(border(slab, 0)),
            Self::Daughter { slab, .. } => Some(border(slab, 1)),
        }
    }
}

/// A branch between two events or ends.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tube {
    /// Its surface.
    pub surface: TubeSurface,
    /// What it ends in below.
    pub bottom: End,
    /// What it ends in above.
    pub top: End,
}

/// A closed surface.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(try_from = "super::stored::RawSkin")]
pub struct Skin {
    /// Branches.
    pub tubes: Vec<Tube>,
    /// Events.
    pub slabs: Vec<Slab>,
    /// Where the corners of each event's patches lie on the ends of the tubes.
    pub welds: Vec<Weld>,
    /// Farthest that a patch was moved to meet its neighbours exactly, mm.
    pub moved_mm: f64,
}

/// A height and the contour there.
pub(super) type GivenSection = (f64, Contour);

/// The sections of a branch before it is skinned.
#[derive(Debug, Clone)]
pub(super) struct Strand {
    /// Heights and contours, in any order.
    pub(super) sections: Vec<GivenSection>,
    pub(super) bottom: End,
    pub(super) top: End,
}

impl Strand {
    /// Its lowest and highest section; the events at its ends where there is none.
    fn z_range_mm(&self, slabs: &[Slab]) -> [f64; 2] {
        let sections = self.sections.iter().map(|s| s.0);
        let ends = [self.bottom, self.top].into_iter().filter_map(|end| end.z_mm(slabs));
        sections
            .chain(ends)
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], z| [low.min(z), high.max(z)])
    }
}

/// Skins every strand and joins the tubes to the slabs. Between measured sections, further ones are added where they
/// ask for them; between any, those without which tubes would cross. The tubes lean as `leans` say, one for each slab.
pub(super) fn skin(
    strands: Vec<Strand>,
    slabs: Vec<Slab>,
    leans: &[Leans],
    correspondence: Correspondence,
    is_measured: bool,
) -> Result<Skin, Error> {
    let least = if is_measured { 0.0 } else { LEAST_COMPUTED };
    let loft_with =
        |strand: &Strand, least: f64| tube(strand, &slabs, leans, Points { correspondence, least });
    let loft = |strand: &Strand| loft_with(strand, least);
    let lofted: Vec<Result<(Strand, Tube), Error>> =
        strands.into_par_iter().map(|s| completed(s, &loft, correspondence, is_measured)).collect();
    let lofted = lofted.into_iter().collect::<Result<Vec<_>, _>>()?;
    let welded = match correspondence {
        Correspondence::LeastTwist => {
            let loft = |strand: &Strand, coarser: f64| loft_with(strand, least.max(coarser));
            // What was measured must be met.
            let farther_apart: &[f64] = if is_measured { &[] } else { &COARSER };
            mended(lofted, farther_apart, loft, |tubes| Welded::of(tubes, slabs.clone()))?
        }
        Correspondence::Published => {
            Welded::of(lofted.into_iter().map(|(_, tube)| tube).collect(), slabs.clone())
        }
    };
    let Welded { tubes, slabs, welds, moved_mm } = welded;
    if let Some((slab, moved_mm)) = slabs.iter().zip(&moved_mm).find(|(_, mm)| **mm > MOST_MOVED_MM) {
        let z_mm = slab.w_mm.map(|w| slab.z_of(w));
        let fault = BranchFault::Torn { moved_mm: *moved_mm };
        return Err(Error::Branch { z_mm: [z_mm[0].min(z_mm[1]), z_mm[0].max(z_mm[1])], fault });
    }
    let moved_mm = moved_mm.into_iter().fold(0.0, f64::max);
    Ok(Skin { tubes, slabs, welds, moved_mm })
}

/// Tubes and slabs that have the curves between them in common.
#[derive(Clone)]
pub(super) struct Welded {
    pub(super) tubes: Vec<Tube>,
    pub(super) slabs: Vec<Slab>,
    welds: Vec<Weld>,
    /// How far the patches of each slab were moved at most, mm.
    moved_mm: Vec<f64>,
}

impl Welded {
    fn of(mut tubes: Vec<Tube>, mut slabs: Vec<Slab>) -> Self {
        let (welds, moved_mm) = weld(&mut tubes, &mut slabs);
        Self { tubes, slabs, welds, moved_mm }
    }
}

/// A strand with the tube through its sections and through those that they ask for in between where they are measured.
fn completed(
    mut strand: Strand,
    loft: &impl Fn(&Strand) -> Result<Tube, Error>,
    correspondence: Correspondence,
    is_measured: bool,
) -> Result<(Strand, Tube), Error> {
    strand.sections.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Two sections at one height (a virtual one on a plane) would make the spline steep: the first one stays.
    strand.sections.dedup_by(|b, a| b.0 - a.0 < 1e-6);
    let mut tube = loft(&strand)?;
    if correspondence == Correspondence::Published || !is_measured {
        return Ok((strand, tube));
    }
    for ask in [steadying, between] {
        let further = ask(&tube.surface, &strand);
        if !further.is_empty() {
            strand.sections.extend(further);
            strand.sections.sort_by(|a, b| a.0.total_cmp(&b.0));
            tube = loft(&strand)?;
        }
    }
    Ok((strand, tube))
}

/// Why a branch has no surface.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BranchFault {
    /// A contour is none.
    #[error("its contour at z {z_mm:.3} mm has fewer than three distinct points")]
    Degenerate {
        /// Height of the contour.
        z_mm: f64,
    },
    /// There are too few sections.
    #[error("it has {found} section(s) where two are needed")]
    TooFew {
        /// How many there are.
        found: usize,
    },
    /// Its patches and those beside it follow different curves.
    #[error("its patches would have to be moved by {moved_mm:.2} mm to meet their neighbours")]
    Torn {
        /// How far, mm.
        moved_mm: f64,
    },
    /// Its sections cannot be joined.
    #[error(transparent)]
    Spline(#[from] SplineError),
}

/// How points are set round the sections of a tube.
#[derive(Debug, Clone, Copy)]
struct Points {
    correspondence: Correspondence,
    /// No closer than this part of the way round.
    least: f64,
}

/// The tube through the sections of a strand.
fn tube(strand: &Strand, slabs: &[Slab], leans: &[Leans], points: Points) -> Result<Tube, Error> {
    let surface = lofted(strand, slabs, leans, points)
        .map_err(|fault| Error::Branch { z_mm: strand.z_range_mm(slabs), fault })?;
    Ok(Tube { surface, bottom: strand.bottom, top: strand.top })
}

fn lofted(
    strand: &Strand,
    slabs: &[Slab],
    leans: &[Leans],
    points: Points,
) -> Result<TubeSurface, BranchFault> {
    let curve = |(z_mm, contour): &GivenSection| {
        ClosedCurve::through(contour).ok_or(BranchFault::Degenerate { z_mm: *z_mm })
    };
    let curves: Vec<Result<ClosedCurve, BranchFault>> = strand.sections.par_iter().map(curve).collect();
    // The lowest fault is reported, on any number of threads.
    let curves = curves.into_iter().collect::<Result<Vec<_>, _>>()?;
    if curves.len() < 2 {
        return Err(BranchFault::TooFew { found: curves.len() });
    }
    let z: Vec<f64> = strand.sections.iter().map(|s| s.0).collect();
    let starts_mm = starts_mm(&curves, points.correspondence);
    let rounds: Vec<Round<'_>> =
        curves.iter().zip(starts_mm).map(|(curve, start_mm)| Round { curve, start_mm }).collect();
    let ends = [(strand.bottom, &rounds[0]), (strand.top, &rounds[rounds.len() - 1])];
    let mut notches: Vec<Notch> =
        ends.into_iter().flat_map(|(end, round)| notches(end, slabs, round)).collect();
    if points.least > LEAST_COMPUTED {
        notches.clear();
    }
    let fractions = fractions(&rounds, &notches, points.least);
    let sections: Vec<Vec<Point2>> = rounds.par_iter().map(|round| round.placed(&fractions)).collect();
    let mut seen: Vec<(f64, &[Point2])> = z.iter().copied().zip(sections.iter().map(Vec::as_slice)).collect();
    let bottom = end_slopes(strand.bottom, leans, &seen);
    seen.reverse();
    let top = end_slopes(strand.top, leans, &seen);
    Ok(TubeSurface::sloped(&z, &sections, [bottom.as_deref(), top.as_deref()])?)
}

/// Where each curve of a tube starts, by arc length.
fn starts_mm(curves: &[ClosedCurve], correspondence: Correspondence) -> Vec<f64> {
    let n_points = SECTION_POINTS;
    let mut starts_mm: Vec<f64> = Vec::with_capacity(curves.len());
    let mut previous: Vec<Point2> = Vec::new();
    for curve in curves {
        let start_mm = match (previous.first(), correspondence) {
            (None, _) => least_x_start(curve, n_points),
            (Some(start), Correspondence::Published) => nearest_start(curve, *start),
            (Some(_), Correspondence::LeastTwist) => least_twist_start(curve, &previous),
        };
        previous = curve.resampled(n_points, start_mm);
        starts_mm.push(start_mm);
    }
    starts_mm
}

/// The notches on the section at the end of a tube. Points as far apart as elsewhere would round them off.
fn notches(end: End, slabs: &[Slab], round: &Round<'_>) -> Vec<Notch> {
    let corners = match end {
        End::Cap => Vec::new(),
        End::Waist { slab } => slabs[slab].corners_at(0).to_vec(),
        End::Daughter { slab, side } => vec![slabs[slab].corners_at(1)[side]],
    };
    corners.into_iter().map(|corner| Notch::at_corner(round, corner)).collect()
}

/// The published rule for the first section of a branch: start where x is least.
fn least_x_start(curve: &ClosedCurve, n_points: usize) -> f64 {
    let points = curve.resampled(n_points, 0.0);
    let least = (0..n_points).min_by(|&a, &b| points[a].x.total_cmp(&points[b].x)).unwrap_or(0);
    curve.length_mm() * least as f64 / n_points as f64
}

/// The published rule for every further section: start at the point nearest to the start before.
fn nearest_start(curve: &ClosedCurve, start: Point2) -> f64 {
    let n = 4 * SECTION_POINTS;
    let step_mm = curve.length_mm() / n as f64;
    let off = |s: f64| (curve.at_length(s) - start).norm_squared();
    let nearest =
        (0..n).map(|i| i as f64 * step_mm).min_by(|a, b| off(*a).total_cmp(&off(*b))).unwrap_or(0.0);
    // The squared distance is a parabola there.
    let (before, at, after) = (off(nearest - step_mm), off(nearest), off(nearest + step_mm));
    let bend = before - 2.0 * at + after;
    let fraction = if bend > 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
    nearest + fraction * step_mm
}

/// The start for which the sum of squared distances to the neighbour's points is least, over a continuous shift.
pub(super) fn least_twist_start(curve: &ClosedCurve, previous: &[Point2]) -> f64 {
    let n = previous.len();
    let points = curve.resampled(n, 0.0);
    let twist = Twist { previous, twice: points.repeat(2) };
    let best = twist.least();
    let [before, at, after] =
        [best + n - 1, best, best + 1].map(|shift| twist.cost(shift % n, f64::INFINITY));
    let bend = before - 2.0 * at + after;
    let fraction = if bend > 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
    curve.length_mm() * (best as f64 + fraction) / n as f64
}

/// Points of a section and, twice round, as many of the next one.
struct Twist<'a> {
    previous: &'a [Point2],
    twice: Vec<Point2>,
}

impl Twist<'_> {
    /// The sum of squared distances to the points that begin at a shift, or some part of it that exceeds `most`.
    fn cost(&self, shift: usize, most: f64) -> f64 {
        let mut sum = 0.0;
        let shifted = self.twice[shift..].chunks(TWIST_CHUNK);
        for (own, other) in self.previous.chunks(TWIST_CHUNK).zip(shifted) {
            sum = own.iter().zip(other).fold(sum, |sum, (p, q)| sum + (p - q).norm_squared());
            if sum > most {
                break;
            }
        }
        sum
    }

    /// The shift of the least cost; the first of several. Every few points are tried first, so that most others are
    /// given up soon.
    fn least(&self) -> usize {
        let n = self.previous.len();
        let coarse = (0..n).step_by(TWIST_STRIDE);
        let rest = (0..n).filter(|shift| shift % TWIST_STRIDE != 0);
        let mut best = (f64::INFINITY, 0);
        for shift in coarse.chain(rest) {
            let cost = self.cost(shift, best.0);
            if cost < best.0 || (cost <= best.0 && shift < best.1) {
                best = (cost, shift);
            }
        }
        best.1
    }
}

impl Skin {
    /// Lowest and highest z, mm.
    #[must_use]
    pub fn z_range_mm(&self) -> [f64; 2] {
        self.tubes
            .iter()
            .map(|t| t.surface.z_range_mm())
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], [a, b]| [low.min(a), high.max(b)])
    }
}

impl Slab {
    /// The height along w of a height z.
    #[must_use]
    pub fn w_of(&self, z_mm: f64) -> f64 {
        if self.upward { z_mm } else { -z_mm }
    }

    /// The height z of a height along w.
    #[must_use]
    pub fn z_of(&self, w_mm: f64) -> f64 {
        if self.upward { w_mm } else { -w_mm }
    }

    /// The laterals' parameter v at height w. At a saddle it is w itself. A crease rises to the apex with a
    /// horizontal tangent, so that there w falls with the square of the distance from v = 1 and v runs from 0 to 1.
    #[must_use]
    pub fn v_of(&self, w_mm: f64) -> f64 {
        let [low, high] = self.w_mm;
        match self.crotch {
            Crotch::Saddle(_) => w_mm,
            Crotch::Crease => 1.0 - ((high - w_mm) / (high - low)).max(0.0).sqrt(),
        }
    }

    /// The height w at the laterals' parameter v.
    #[must_use]
    pub fn w_at(&self, v: f64) -> f64 {
        let [low, high] = self.w_mm;
        match self.crotch {
            Crotch::Saddle(_) => v,
            Crotch::Crease => high - (high - low) * (1.0 - v) * (1.0 - v),
        }
    }

    /// The middle of either side at height w.
    pub(super) fn sides_at(&self, w_mm: f64) -> [Point2; 2] {
        let v = self.v_of(w_mm);
        self.laterals.each_ref().map(|l| {
            let [first, last] = l.u_range();
            l.at(0.5 * (first + last), v).xy()
        })
    }

    /// The corners A, B on the waist (`end` 0) or P, Q on the daughters (1).
    fn corners_at(&self, end: usize) -> [Point2; 2] {
        let v = self.v_of(self.w_mm[end]);
        self.laterals.each_ref().map(|l| l.at(0.0, v).xy())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_branch_without_a_surface_is_named_with_its_place() {
        let disk = |z: f64| (z, Contour::circle(Point2::origin(), 2.0, 64));
        let built = |sections: Vec<GivenSection>| {
            let strand = Strand { sections, bottom: End::Cap, top: End::Cap };
            skin(vec![strand], Vec::new(), &[], Correspondence::default(), true).unwrap_err().to_string()
        };
        let point = (2.0, Contour::new(vec![Point2::origin(); 5]));
        assert_eq!(
            built(vec![disk(1.0), point, disk(3.0)]),
            "the branch from z 1.00 to 3.00 mm: its contour at z 2.000 mm has fewer than three distinct points: look at the \
             contours there and correct them"
        );
        assert!(
            built(vec![disk(4.5)]).contains("z 4.50 to 4.50 mm: it has 1 section(s) where two are needed")
        );
    }

    #[test]
    fn the_least_twist_is_found_among_all_turns() {
        // Two of the turns of a two-fold shape are alike but for a bump.
        let previous: Vec<Point2> = (0..100)
            .map(|k| {
                let angle = std::f64::consts::TAU * f64::from(k) / 100.0;
                Point2::new((3.0 + 0.1 * (-(angle - 1.0).powi(2)).exp()) * angle.cos(), 2.0 * angle.sin())
            })
            .collect();
        for turn in 0..100 {
            let (head, tail) = previous.split_at(turn);
            let turned = Twist { previous: &previous, twice: [tail, head, tail, head].concat() };
            let costs: Vec<f64> = (0..100).map(|shift| turned.cost(shift, f64::INFINITY)).collect();
            let least = costs.iter().copied().fold(f64::INFINITY, f64::min);
            assert_eq!((turned.least(), costs[turned.least()]), ((100 - turn) % 100, least));
        }
    }

    #[test]
    fn the_published_rule_starts_at_least_x_and_then_at_the_nearest_point() {
        // Each contour's points begin elsewhere, and the branch drifts away from where x is least.
        let circle = |x: f64, y: f64| {
            let contour = Contour::circle(Point2::new(x, y), 2.0, 128);
            ClosedCurve::through(&contour).expect("a circle")
        };
        let curves = [circle(0.0, 0.0), circle(0.0, 1.0), circle(0.0, 2.0)];
        let starts = starts_mm(&curves, Correspondence::Published);
        let at: Vec<Point2> = curves.iter().zip(&starts).map(|(c, s)| c.at_length(*s)).collect();
        assert!((at[0] - Point2::new(-2.0, 0.0)).norm() < 1e-3, "{}", at[0]);
        // The point of a circle nearest to another lies on the way to its centre.
        for k in [1, 2] {
            let centre = Point2::new(0.0, k as f64);
            let expected = centre + (at[k - 1] - centre).normalize() * 2.0;
            assert!((at[k] - expected).norm() < 1e-3, "{} {expected}", at[k]);
        }
    }
}
