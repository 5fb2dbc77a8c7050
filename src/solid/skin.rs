//! A closed skin: tubes between events, slabs of three patches at the events, flat caps at the ends.

use super::between::between;
use super::event::{Crotch, Slab};
use super::mend::mended;
use super::spacing::{LEAST_COMPUTED, Notch, Round, SECTION_POINTS, fractions};
use super::weld::{Weld, weld};
use crate::geom::{Contour, Point2, Point3};
use crate::spline::{ClosedCurve, PatchSurface, SectionCurve, SplineError, TubeSurface};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Samples along a lateral patch's row from which its bending is taken.
const ARC_SAMPLES: usize = 64;
/// Grid on which the saddle patch is cut by a plane.
const SADDLE_GRID: usize = 48;

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

/// Skins every strand and joins the tubes to the slabs. Between measured sections, further ones are added where they
/// ask for them; between any, those without which tubes would cross.
pub(super) fn skin(
    strands: Vec<Strand>,
    mut slabs: Vec<Slab>,
    correspondence: Correspondence,
    is_measured: bool,
) -> Result<Skin, SplineError> {
    let least = if is_measured { 0.0 } else { LEAST_COMPUTED };
    let loft = |strand: &Strand| tube(strand, &slabs, correspondence, least);
    let lofted: Vec<Result<(Strand, Tube), SplineError>> =
        strands.into_par_iter().map(|s| completed(s, &loft, correspondence, is_measured)).collect();
    let lofted = lofted.into_iter().collect::<Result<Vec<_>, _>>()?;
    let mut tubes = match correspondence {
        Correspondence::LeastTwist => mended(lofted, loft)?,
        Correspondence::Published => lofted.into_iter().map(|(_, tube)| tube).collect(),
    };
    let (welds, moved_mm) = weld(&mut tubes, &mut slabs);
    Ok(Skin { tubes, slabs, welds, moved_mm })
}

/// A strand with the tube through its sections and through those that they ask for in between where they are measured.
fn completed(
    mut strand: Strand,
    loft: &impl Fn(&Strand) -> Result<Tube, SplineError>,
    correspondence: Correspondence,
    is_measured: bool,
) -> Result<(Strand, Tube), SplineError> {
    strand.sections.sort_by(|a, b| a.0.total_cmp(&b.0));
    // Two sections at one height (a virtual one on a plane) would make the spline steep: the first one stays.
    strand.sections.dedup_by(|b, a| b.0 - a.0 < 1e-6);
    let tube = loft(&strand)?;
    if correspondence == Correspondence::Published || !is_measured {
        return Ok((strand, tube));
    }
    let further = between(&tube.surface, &strand.sections);
    if further.is_empty() {
        return Ok((strand, tube));
    }
    strand.sections.extend(further);
    strand.sections.sort_by(|a, b| a.0.total_cmp(&b.0));
    let tube = loft(&strand)?;
    Ok((strand, tube))
}

/// The tube through the sections of a strand, points round them set no closer than `least` of the way round.
fn tube(
    strand: &Strand,
    slabs: &[Slab],
    correspondence: Correspondence,
    least: f64,
) -> Result<Tube, SplineError> {
    let z: Vec<f64> = strand.sections.iter().map(|s| s.0).collect();
    let curves: Vec<ClosedCurve> =
        strand.sections.par_iter().filter_map(|s| ClosedCurve::through(&s.1)).collect();
    let needed = z.len().max(2);
    if curves.len() < needed {
        return Err(SplineError::TooFew { found: curves.len(), needed });
    }
    if curves.len() < 2 {
        return Err(SplineError::TooFew { found: curves.len(), needed: 2 });
    }
    let starts_mm = starts_mm(&curves, correspondence);
    let rounds: Vec<Round<'_>> =
        curves.iter().zip(starts_mm).map(|(curve, start_mm)| Round { curve, start_mm }).collect();
    let ends = [(strand.bottom, &rounds[0]), (strand.top, &rounds[rounds.len() - 1])];
    let notches: Vec<Notch> = ends.into_iter().flat_map(|(end, round)| notches(end, slabs, round)).collect();
    let fractions = fractions(&rounds, &notches, least);
    let sections: Vec<Vec<Point2>> = rounds.par_iter().map(|round| round.placed(&fractions)).collect();
    Ok(Tube { surface: TubeSurface::through(&z, &sections)?, bottom: strand.bottom, top: strand.top })
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
    let cost = |shift: usize| -> f64 {
        let (head, tail) = points.split_at(shift % n);
        previous.iter().zip(tail.iter().chain(head)).map(|(p, q)| (p - q).norm_squared()).sum()
    };
    let costs: Vec<f64> = (0..n).map(cost).collect();
    let best = (0..n).min_by(|&a, &b| costs[a].total_cmp(&costs[b])).unwrap_or(0);
    let (before, at, after) = (costs[(best + n - 1) % n], costs[best], costs[(best + 1) % n]);
    let bend = before - 2.0 * at + after;
    let fraction = if bend > 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
    curve.length_mm() * (best as f64 + fraction) / n as f64
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

    /// The closed curves at height z as polylines with chords within the tolerance: outlines run counter-clockwise,
    /// holes clockwise.
    #[must_use]
    pub fn section(&self, z_mm: f64, tolerance_mm: f64) -> Vec<Contour> {
        let mut contours: Vec<Contour> = self
            .tubes
            .iter()
            .filter(|t| {
                let [low, high] = t.surface.z_range_mm();
                z_mm >= low && z_mm <= high
            })
            .map(|t| polyline(&t.surface.section(z_mm), tolerance_mm))
            .collect();
        for slab in &self.slabs {
            let w = slab.w_of(z_mm);
            // At its borders the tubes have the section already.
            if w > slab.w_mm[0] && w < slab.w_mm[1] {
                contours.extend(slab.section(w, tolerance_mm));
            }
        }
        contours
    }
}

/// Most chords of a curve: beyond it a tolerance below what contours know.
const MOST_CHORDS: f64 = 4096.0;

/// How many equal steps of the parameter keep a curve within the tolerance of its chords, from its largest second
/// derivative over a parameter from 0 to 1: a chord over a step h leaves the curve by at most bend h² / 8.
fn n_chords(bend_mm: f64, tolerance_mm: f64) -> usize {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let n = (bend_mm / (8.0 * tolerance_mm)).sqrt().ceil().clamp(16.0, MOST_CHORDS) as usize;
    n
}

fn polyline(curve: &SectionCurve, tolerance_mm: f64) -> Contour {
    let n = n_chords(curve.bend_mm(), tolerance_mm);
    Contour::new((0..n).map(|i| curve.at(i as f64 / n as f64)).collect())
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

    /// The corners A, B on the waist (`end` 0) or P, Q on the daughters (1).
    fn corners_at(&self, end: usize) -> [Point2; 2] {
        let v = self.v_of(self.w_mm[end]);
        self.laterals.each_ref().map(|l| l.at(0.0, v).xy())
    }

    /// The closed curves at height w inside the slab.
    #[must_use]
    pub fn section(&self, w: f64, tolerance_mm: f64) -> Vec<Contour> {
        let laterals = self.laterals.each_ref().map(|patch| {
            let row = patch.row(self.v_of(w));
            let at = |u: f64| {
                let p: Point3 = row.at(u);
                Point2::new(p.x, p.y)
            };
            let samples: Vec<Point2> = (0..=ARC_SAMPLES).map(|i| at(i as f64 / ARC_SAMPLES as f64)).collect();
            let bends = samples.windows(3).map(|s| ((s[2] - s[1]) - (s[1] - s[0])).norm());
            let bend_mm = bends.fold(0.0, f64::max) * (ARC_SAMPLES * ARC_SAMPLES) as f64;
            let n = n_chords(bend_mm, tolerance_mm);
            (0..=n).map(|i| at(i as f64 / n as f64)).collect::<Vec<_>>()
        });
        let between = match &self.crotch {
            Crotch::Saddle(saddle) => self.saddle_curves(saddle, w),
            Crotch::Crease => Vec::new(),
        };
        close_loops(laterals.to_vec(), between)
    }

    /// The curves in which the plane at height w cuts the saddle patch.
    fn saddle_curves(&self, saddle: &PatchSurface, w: f64) -> Vec<Vec<Point2>> {
        let n = SADDLE_GRID;
        let parameter = |i: usize| i as f64 / n as f64;
        let height: Vec<Vec<f64>> = (0..=n)
            .map(|j| {
                let row = saddle.row(parameter(j));
                (0..=n).map(|i| self.w_of(row.at(parameter(i)).z) - w).collect()
            })
            .collect();
        let at = |i: usize, j: usize| height[j][i];
        let cross = |a: (usize, usize), b: (usize, usize)| {
            let (fa, fb) = (at(a.0, a.1), at(b.0, b.1));
            ((fa < 0.0) != (fb < 0.0)).then(|| {
                let t = fa / (fa - fb);
                let mix = |p: usize, q: usize| parameter(p) + (parameter(q) - parameter(p)) * t;
                saddle.at(mix(a.0, b.0), mix(a.1, b.1))
            })
        };
        let mut pieces = Vec::new();
        for i in 0..n {
            for j in 0..n {
                // Two triangles a cell: no ambiguous case.
                for triangle in [[(i, j), (i + 1, j), (i + 1, j + 1)], [(i, j), (i + 1, j + 1), (i, j + 1)]] {
                    let ends: Vec<Point2> = (0..3)
                        .filter_map(|k| {
                            let (a, b) = (triangle[k], triangle[(k + 1) % 3]);
                            // Both triangles of an edge must find the same point, to the last bit.
                            if a < b { cross(a, b) } else { cross(b, a) }
                        })
                        .map(|p| Point2::new(p.x, p.y))
                        .collect();
                    if let [a, b] = ends[..] {
                        pieces.push(vec![a, b]);
                    }
                }
            }
        }
        chained(pieces)
    }
}

/// Joins polylines that share end points into longer ones.
fn chained(mut pieces: Vec<Vec<Point2>>) -> Vec<Vec<Point2>> {
    let mut curves = Vec::new();
    while let Some(mut curve) = pieces.pop() {
        loop {
            let (head, tail) = (curve[0], curve[curve.len() - 1]);
            let joins = |piece: &Vec<Point2>| {
                let (a, b) = (piece[0], piece[piece.len() - 1]);
                a == tail || b == tail || a == head || b == head
            };
            let Some(i) = pieces.iter().position(joins) else { break };
            let mut piece = pieces.swap_remove(i);
            if piece[0] == head || piece[piece.len() - 1] == head {
                curve.reverse();
            }
            if piece[piece.len() - 1] == curve[curve.len() - 1] {
                piece.reverse();
            }
            curve.extend_from_slice(&piece[1..]);
        }
        curves.push(curve);
    }
    curves
}

/// Joins directed open curves, by bridges of either direction, to closed contours, nearest ends first.
fn close_loops(mut open: Vec<Vec<Point2>>, mut bridges: Vec<Vec<Point2>>) -> Vec<Contour> {
    let mut closed = Vec::new();
    while let Some(mut contour) = open.pop() {
        loop {
            let (head, tail) = (contour[0], contour[contour.len() - 1]);
            let candidates = open.iter().chain(&bridges);
            let gap =
                |curve: &Vec<Point2>| (curve[0] - tail).norm().min((curve[curve.len() - 1] - tail).norm());
            let nearest = candidates.enumerate().min_by(|a, b| gap(a.1).total_cmp(&gap(b.1)));
            let Some((i, curve)) = nearest else { break };
            if gap(curve) >= (head - tail).norm() && contour.len() > 2 {
                break;
            }
            let mut next =
                if i < open.len() { open.swap_remove(i) } else { bridges.swap_remove(i - open.len()) };
            if (next[0] - tail).norm() > (next[next.len() - 1] - tail).norm() {
                next.reverse();
            }
            contour.extend(next);
        }
        contour.dedup_by(|a, b| (*a - *b).norm() < 1e-7);
        if contour.len() > 1 && (contour[0] - contour[contour.len() - 1]).norm() < 1e-7 {
            contour.pop();
        }
        let contour = Contour::new(contour);
        if contour.len() >= 3 {
            closed.push(contour);
        }
    }
    closed
}

#[cfg(test)]
mod tests {
    use super::*;

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
