//! The three patches of an elementary event, in a thin slab round the saddle point of a field.
//!
//! Two lateral patches, whose rows are iso-curves, and a saddle patch over the quadrilateral A-P-B-Q share four seams
//! (the published construction). All of them interpolate one field, so that normals agree across seams without
//! further construction.
//!
//! One closed curve (the waist) becomes two (the legs). Where a branch parts, all three are outlines; where an
//! outline closes round a hole, the waist is the C-shaped outline and the legs are the outline and the hole. In both
//! cases the curves run with the inside to their left, and every patch follows from that.

use super::corners::Corners;
use super::event::{EventFault, EventSource};
use super::iso::{self, settled};
use super::lean::{Lean, Leans};
use super::notch::denser;
use super::sites::{closer, halved, misses};
use super::sweep::Saddle;
use crate::geom::{Contour, Point2, Point3, SegmentIndex, Vector2};
use crate::spline::PatchSurface;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Rows of the lateral patches and of the saddle's grid.
const ROWS: usize = 13;
/// Intervals along u of the lateral patches: as many as keep their borders near to the field between them.
const ARC_INTERVALS: [usize; 4] = [64, 128, 256, 512];
/// Where none of these do, in how many rounds, and up to how many, sites are set closer where they are needed.
const CLOSER_ROUNDS: usize = 6;
const MOST_SITES: usize = 2048;
/// Spacing of a ring's vertices at its corners over the size of the saddle.
const NOTCH_SPACING: f64 = 0.02;

/// Slabs are tried at these shares of the thickness asked for, until a saddle has no cell smaller than
/// [`LEAST_AREA`] of the mean one, seen along z, and its seams rise by [`LEAST_RISE`].
const THINNESS: [f64; 6] = [1.0, 0.5, 0.25, 0.12, 0.06, 0.03];
const LEAST_AREA: f64 = 0.1;
/// Sine of the angle at which chords leave the waist and reach the legs at least. Along a seam that grazes its ring the
/// laterals' points run along the ring as the root of the height does, which no spline through their rows follows.
const LEAST_RISE: f64 = 0.1;
/// Intervals, each way, at which that is measured.
const AREA_SAMPLES: usize = 16;
/// Of a thinner slab neither side is thicker than this many times the other one; from that many times on it is made thinner.
const MOST_ASYMMETRY: f64 = 2.0;
const LOPSIDED: f64 = 8.0;
/// Sections beside a thinner slab follow each other at distances from the apex that grow by this factor.
const GROWTH: f64 = 1.7;
/// Steps along a lateral's row over the distance from the apex, and the shortest one over the longest.
const TRACE_GROWTH: f64 = 0.1;
const LEAST_TRACE: f64 = 1e-4;
/// Over how much of a slab's height the derivative of its field by the height is taken.
const LEAN_STEP: f64 = 1e-3;

/// What closes the gap between the two lateral patches of an event.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Crotch {
    /// A patch between them: corners A (0, 0), P (1, 0), Q (0, 1), B (1, 1).
    Saddle(PatchSurface),
    /// Nothing: they meet in a crease, one edge that rises from A to the apex (where P and Q are one point) and
    /// falls to B. The first lateral's side u = 0 is the second one's side u = 1 and the other way round.
    Crease,
}

/// The patches of an event.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Slab {
    /// Whether the daughters lie above (a split) or below (a merge).
    pub upward: bool,
    /// Heights of the waist and of the daughters' ends along w, mm.
    pub w_mm: [f64; 2],
    /// Lateral patches, daughter 0 first: u along the arc from 0 to 1, v as [`Slab::v_of`] says.
    pub laterals: [PatchSurface; 2],
    /// Between the laterals.
    pub crotch: Crotch,
}

/// A slab with the closed curves at its borders, set more closely beside the corners.
#[derive(Debug)]
pub(super) struct Bordered {
    pub(super) slab: Slab,
    /// Heights of the waist and of the legs along the source's w.
    pub(super) w: [f64; 2],
    pub(super) waist: Contour,
    pub(super) legs: [Contour; 2],
    /// Where the slab is thinner than asked for: sections of the waist's and of the legs' branches beside it.
    pub(super) beside: Beside,
    /// How the field leans along the waist and the legs.
    pub(super) leans: Leans,
}

/// Sections beside a slab that was made thinner, heights along the source's w.
#[derive(Debug, Default)]
pub(super) struct Beside {
    pub(super) waist: Vec<(f64, Contour)>,
    pub(super) legs: [Vec<(f64, Contour)>; 2],
}

/// Cosine-spaced numbers from 0 to 1.
fn cosine_spaced(n: usize) -> Vec<f64> {
    let angle = |i: usize| std::f64::consts::PI * i as f64 / (n - 1) as f64;
    (0..n).map(|i| 0.5 * (1.0 - angle(i).cos())).collect()
}

/// Builds the three patches between the waist's height and the legs', both seen along the source's w; `upward` says
/// whether the source's w is z.
///
/// Where the published corners make a saddle that all but folds (the surface is steep there, and a chord from the waist
/// to a leg first leads down) or seams that graze a ring, corners are looked for from which all chords rise, those on
/// the principal directions at the apex among them, and the slab is made thinner: the nearer to the apex, the more
/// symmetric is the surface.
pub(super) fn build_slab(
    source: &dyn EventSource,
    saddle: &Saddle,
    upward: bool,
) -> Result<Bordered, EventFault> {
    let view = View { source, along: saddle.along, sign: if saddle.opens { 1.0 } else { -1.0 } };
    let mut best: Option<(Saddle, Trial)> = None;
    for thinness in THINNESS {
        let is_as_asked = thinness == 1.0 && !saddle.is_lopsided();
        let thinner = if is_as_asked { Some(saddle.clone()) } else { saddle.thinner(source, thinness) };
        let Some(thinner) = thinner else { continue };
        let Ok(published) = Corners::published(source, &thinner) else { continue };
        let turned = || Some(published.turned(source, &thinner));
        let principal = || Corners::principal(source, &thinner).ok();
        let others = [&turned as &dyn Fn() -> Option<Corners>, &principal];
        for corners in std::iter::once(published).chain(others.iter().filter_map(|f| f())) {
            let trial = view.trial(&thinner, corners, upward)?;
            if best.as_ref().is_none_or(|(_, b)| trial.fitness > b.fitness) {
                best = Some((thinner.clone(), trial));
            }
            if best.as_ref().is_some_and(|(_, b)| b.fitness > 1.0) {
                break;
            }
        }
        if best.as_ref().is_some_and(|(_, b)| b.fitness > 1.0) {
            break;
        }
    }
    let (thinner, trial) = best.ok_or(EventFault::NoWaist)?;
    let beside = if thinner.reaches() == saddle.reaches() {
        Beside::default()
    } else {
        saddle.sections_towards(source, &thinner)
    };
    view.bordered(&thinner, trial, upward, beside)
}

/// Which row of a slab.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    Waist,
    Between,
    Legs,
}

impl Place {
    fn of_rows() -> [Self; ROWS] {
        let mut places = [Self::Between; ROWS];
        (places[0], places[ROWS - 1]) = (Self::Waist, Self::Legs);
        places
    }
}

/// The smallest area of a patch's grid cells, seen along z, by the mean one; negative where it folds.
pub(super) fn least_area(patch: &PatchSurface) -> f64 {
    let n = AREA_SAMPLES;
    let at = |k: usize| k as f64 / n as f64;
    let area = |i: usize, j: usize| {
        let jet = patch.jet(at(i), at(j));
        jet.by_u.xy().perp(&jet.by_v.xy())
    };
    let areas: Vec<f64> = (0..=n).flat_map(|j| (0..=n).map(move |i| area(i, j))).collect();
    let mean = areas.iter().sum::<f64>() / areas.len() as f64;
    areas.iter().map(|a| a / mean).fold(f64::INFINITY, f64::min)
}

/// A source seen from the waist towards the legs, so that its field rises at the saddle.
struct View<'a> {
    source: &'a dyn EventSource,
    along: f64,
    sign: f64,
}

/// Corners with the saddle patch between them.
struct Trial {
    corners: Corners,
    seams: Seams,
    patch: PatchSurface,
    /// More than 1 where neither the smallest area of the saddle's grid cells nor the rise of its seams is too little.
    fitness: f64,
}

impl View<'_> {
    /// Heights of the rows.
    fn heights(saddle: &Saddle) -> Vec<f64> {
        let w_mm = saddle.w_mm();
        cosine_spaced(ROWS).iter().map(|f| w_mm[0] + f * (w_mm[1] - w_mm[0])).collect()
    }

    /// The saddle patch between given corners.
    fn trial(&self, saddle: &Saddle, corners: Corners, upward: bool) -> Result<Trial, EventFault> {
        let heights = Self::heights(saddle);
        let seams: Vec<[Point2; 4]> = heights
            .par_iter()
            .zip(Place::of_rows())
            .map(|(&w, place)| self.seams(&corners, w, place))
            .collect();
        let seam = |k: usize| seams.iter().map(|r| r[k]).collect();
        let seams = Seams { ap: seam(0), bp: seam(1), aq: seam(2), bq: seam(3) };
        let sign = saddle.sign(upward);
        let patch = self.saddle(&seams, &heights, &cosine_spaced(ROWS), sign)?;
        let rise = corners.least_rise(self.source, saddle) / LEAST_RISE;
        let fitness = rise.min(least_area(&patch) / LEAST_AREA);
        Ok(Trial { corners, seams, patch, fitness })
    }

    /// The slab round a saddle patch.
    fn bordered(
        &self,
        saddle: &Saddle,
        trial: Trial,
        upward: bool,
        beside: Beside,
    ) -> Result<Bordered, EventFault> {
        let Trial { corners, seams, patch, .. } = trial;
        let heights = Self::heights(saddle);
        let u = self.arc_sites(saddle, &seams, &heights)?;
        let rows = heights
            .par_iter()
            .enumerate()
            .zip(Place::of_rows())
            .map(|((i, &w), place)| self.laterals(saddle, seams.at(i), w, place, &u));
        let rows: Vec<[Vec<Point2>; 2]> = rows.collect::<Result<_, _>>()?;
        let sign = saddle.sign(upward);
        let lateral = |side: usize| {
            let at = |(row, &w): (&[Vec<Point2>; 2], &f64)| -> Vec<Point3> {
                row[side].iter().map(|p| Point3::new(p.x, p.y, sign * w)).collect()
            };
            PatchSurface::through(&u, &heights, &rows.iter().zip(&heights).map(at).collect::<Vec<_>>())
        };
        let laterals = [lateral(0)?, lateral(1)?];
        let slab = Slab { upward: sign > 0.0, w_mm: saddle.w_mm(), laterals, crotch: Crotch::Saddle(patch) };
        let Saddle { w_waist, w_legs, .. } = *saddle;
        let refined = |w: f64| {
            let field = self.source.slice(w);
            move |p: Point2, along: Vector2| settled(self.source.refine(p, w), p, along, &*field)
        };
        let least_mm = NOTCH_SPACING * corners.size_mm();
        let waist = denser(&saddle.waist, &[corners.a, corners.b], least_mm, refined(w_waist));
        let [first, second] = &saddle.legs;
        let legs = [(first, corners.p), (second, corners.q)]
            .map(|(contour, tip)| denser(contour, &[tip], least_mm, refined(w_legs)));
        let leans = {
            let step_w = LEAN_STEP * (w_legs - w_waist).abs();
            let lean = |curve, w| Lean::of(self.source, curve, w, step_w, if upward { 1.0 } else { -1.0 });
            let of_leg = |k: usize| lean(&legs[k], w_legs);
            let (waist, (first, second)) =
                rayon::join(|| lean(&waist, w_waist), || rayon::join(|| of_leg(0), || of_leg(1)));
            [waist, first, second]
        };
        Ok(Bordered { slab, w: [w_waist, w_legs], waist, legs, beside, leans })
    }

    /// The seams' points A-P, B-P, A-Q, B-Q at a height.
    fn seams(&self, corners: &Corners, w: f64, place: Place) -> [Point2; 4] {
        let field = self.source.slice(self.along * w);
        let Corners { a, b, p, q } = *corners;
        let seam = |from: Point2, to: Point2| match place {
            Place::Waist => from,
            Place::Legs => to,
            Place::Between => {
                let at = |t: f64| from + (to - from) * t;
                at(root(|t| -self.sign * field(at(t)).value, 0.0, 1.0))
            }
        };
        [seam(a, p), seam(b, p), seam(a, q), seam(b, q)]
    }

    /// The sites along u with which the laterals' borders keep to the field: cosine-spaced ones where they do, else closer
    /// where they do not.
    fn arc_sites(&self, saddle: &Saddle, seams: &Seams, heights: &[f64]) -> Result<Vec<f64>, EventFault> {
        let mut sites = Vec::new();
        for n in ARC_INTERVALS {
            sites = cosine_spaced(n + 1);
            if !self.missed(saddle, seams, heights, &cosine_spaced(2 * n + 1))?.contains(&true) {
                return Ok(sites);
            }
        }
        for _ in 0..CLOSER_ROUNDS {
            let missed = self.missed(saddle, seams, heights, &halved(&sites))?;
            if !missed.contains(&true) || sites.len() > MOST_SITES {
                break;
            }
            sites = closer(&sites, &missed);
        }
        Ok(sites)
    }

    /// Between which of every second one of these sites the borders of the laterals do not keep to the field.
    fn missed(
        &self,
        saddle: &Saddle,
        seams: &Seams,
        heights: &[f64],
        finer: &[f64],
    ) -> Result<Vec<bool>, EventFault> {
        let mut missed = vec![false; finer.len() / 2];
        for (row, place) in [(0, Place::Waist), (ROWS - 1, Place::Legs)] {
            for border in self.laterals(saddle, seams.at(row), heights[row], place, finer)? {
                missed.iter_mut().zip(misses(&border, finer)).for_each(|(all, own)| *all |= own);
            }
        }
        Ok(missed)
    }

    /// The laterals' points at a height between the seams, at sites along u.
    fn laterals(
        &self,
        saddle: &Saddle,
        [ap, bp, aq, bq]: [Point2; 4],
        w: f64,
        place: Place,
        u: &[f64],
    ) -> Result<[Vec<Point2>; 2], EventFault> {
        let field = self.source.slice(self.along * w);
        let refine =
            |p: Point2, along: Vector2| settled(self.source.refine(p, self.along * w), p, along, &*field);
        let arcs = [Arc { start: ap, end: bp, place }, Arc { start: bq, end: aq, place }];
        let loops = match place {
            Place::Waist => [saddle.waist.clone(), saddle.waist.clone()],
            Place::Legs => saddle.legs.clone(),
            Place::Between => {
                if let [Some(first), Some(second)] = arcs.each_ref().map(|arc| self.traced(saddle, arc, w)) {
                    return Ok([first, second].map(|polyline| Arc::along(&polyline, u, refine)));
                }
                self.loops(saddle, w)?
            }
        };
        let lateral = |side: usize| Arc::along(&arcs[side].polyline(&loops[side]), u, refine);
        Ok([lateral(0), lateral(1)])
    }

    /// The arc by steps along the zero, short ones beside the apex: there the curves that pass each other are as near as
    /// can be, and on no grid it could be told which is which. `None` where it does not lead from start to end.
    fn traced(&self, saddle: &Saddle, arc: &Arc, w: f64) -> Option<Vec<Point2>> {
        let longest_mm = self.source.frame()?.step_mm;
        let most_mm =
            2.0 * (saddle.waist.perimeter_mm() + saddle.legs.iter().map(Contour::perimeter_mm).sum::<f64>());
        let field = self.source.slice(self.along * w);
        let mut polyline = vec![arc.start];
        let (mut at, mut passed_mm) = (arc.start, 0.0);
        while passed_mm < most_mm {
            let slope = field(at).slope.try_normalize(1e-9)?;
            let forward = Vector2::new(-slope.y, slope.x);
            let from_apex = (at - saddle.apex.at).norm();
            let step_mm = (TRACE_GROWTH * from_apex).clamp(LEAST_TRACE * longest_mm, longest_mm);
            let left = arc.end - at;
            if left.norm() <= step_mm && left.dot(&forward) > 0.0 {
                polyline.push(arc.end);
                return Some(polyline);
            }
            let (next, step_mm) = iso::stepped(&*field, at, forward, [step_mm, LEAST_TRACE * longest_mm])?;
            passed_mm += step_mm;
            at = next;
            polyline.push(at);
        }
        None
    }

    /// The curves that pass each leg: one and the same on the waist's side of the saddle.
    fn loops(&self, saddle: &Saddle, w: f64) -> Result<[Contour; 2], EventFault> {
        let contours = self.source.contours(self.along * w);
        let found = saddle.legs.each_ref().map(|leg| {
            let cost = |c: &&Contour| distance_from(leg, c);
            contours.iter().min_by(|a, b| cost(a).total_cmp(&cost(b))).cloned()
        });
        match found {
            [Some(a), Some(b)] => Ok([a, b]),
            _ => Err(EventFault::Components { found: contours.len(), expected: 2 }),
        }
    }

    /// The saddle patch: a Coons grid in the plane, lifted onto the field.
    fn saddle(
        &self,
        seams: &Seams,
        heights: &[f64],
        fractions: &[f64],
        sign: f64,
    ) -> Result<PatchSurface, EventFault> {
        let m = ROWS - 1;
        let [low, high] = [heights[0], heights[m]];
        let (a, p, q, b) = (seams.ap[0], seams.ap[m], seams.aq[m], seams.bp[0]);
        let place = |i: usize, j: usize| -> Point3 {
            let at = |xy: Point2, row: usize| Point3::new(xy.x, xy.y, sign * heights[row]);
            match (i, j) {
                (i, 0) => at(seams.ap[i], i),
                (0, j) => at(seams.aq[j], j),
                (i, j) if i == m => at(seams.bp[m - j], m - j),
                (i, j) if j == m => at(seams.bq[m - i], m - i),
                _ => {
                    let (s, t) = (fractions[i], fractions[j]);
                    let along = seams.ap[i].coords * (1.0 - t) + seams.bq[m - i].coords * t;
                    let across = seams.aq[j].coords * (1.0 - s) + seams.bp[m - j].coords * s;
                    let bilinear = a.coords * ((1.0 - s) * (1.0 - t))
                        + p.coords * (s * (1.0 - t))
                        + q.coords * ((1.0 - s) * t)
                        + b.coords * (s * t);
                    let xy: Point2 = (along + across - bilinear).into();
                    let w = root(|w| self.sign * self.source.value(xy, self.along * w), low, high);
                    Point3::new(xy.x, xy.y, sign * w)
                }
            }
        };
        let grid: Vec<Vec<Point3>> = (0..=m).map(|j| (0..=m).map(|i| place(i, j)).collect()).collect();
        Ok(PatchSurface::through(fractions, fractions, &grid)?)
    }
}

/// Seam points at every height, from the waist's corner to the daughter's.
struct Seams {
    ap: Vec<Point2>,
    bp: Vec<Point2>,
    aq: Vec<Point2>,
    bq: Vec<Point2>,
}

impl Seams {
    /// The points of a row: A-P, B-P, A-Q, B-Q.
    fn at(&self, row: usize) -> [Point2; 4] {
        [&self.ap, &self.bp, &self.aq, &self.bq].map(|seam| seam[row])
    }
}

impl Saddle {
    /// Heights of the waist and the legs, rising from the one to the other.
    fn w_mm(&self) -> [f64; 2] {
        [self.w_waist, self.w_legs].map(|w| w * self.along)
    }

    /// By what heights w are multiplied to give z, when `upward` says whether the source's w is z.
    fn sign(&self, upward: bool) -> f64 {
        if upward == (self.along > 0.0) { 1.0 } else { -1.0 }
    }

    /// Distances of the waist and of the legs from the apex.
    fn reaches(&self) -> [f64; 2] {
        [self.w_waist, self.w_legs].map(|w| (w - self.apex.w).abs())
    }

    /// Whether one side is so much thicker than the other that the quadrilateral of the corners is all but a line.
    fn is_lopsided(&self) -> bool {
        let [waist, legs] = self.reaches();
        waist.max(legs) > LOPSIDED * waist.min(legs)
    }

    /// The same saddle with less height; `None` where its curves are not found.
    fn thinner(&self, source: &dyn EventSource, share: f64) -> Option<Self> {
        let [waist, legs] = self.reaches();
        let reach = [waist.min(MOST_ASYMMETRY * legs), legs.min(MOST_ASYMMETRY * waist)].map(|r| r * share);
        self.at_reach(source, reach)
    }

    fn at_reach(&self, source: &dyn EventSource, [waist, legs]: [f64; 2]) -> Option<Self> {
        let (w_waist, w_legs) = (self.apex.w - self.along * waist, self.apex.w + self.along * legs);
        // The neck and the gap are as wide as the root of the distance from the apex.
        let finer = |k: usize, reach: f64| (self.reaches()[k] / reach).sqrt().max(1.0);
        let waist = following(&source.contours_on(w_waist, finer(0, waist)), &self.waist)?;
        let there = source.contours_on(w_legs, finer(1, legs));
        let [first, second] = self.legs.each_ref().map(|leg| following(&there, leg));
        let legs = [first?, second?];
        (legs[0] != legs[1]).then(|| Self { w_waist, w_legs, waist, legs, ..self.clone() })
    }

    /// Sections between the borders of this slab, which stay sections, and those of a thinner one.
    fn sections_towards(&self, source: &dyn EventSource, thinner: &Self) -> Beside {
        let [from, to] = [thinner.reaches(), self.reaches()];
        let reaches = |side: usize| {
            let grown = std::iter::successors(Some(from[side] * GROWTH), |r| Some(r * GROWTH));
            grown.take_while(|r| *r < to[side] / GROWTH.sqrt()).collect::<Vec<f64>>()
        };
        let mut beside = Beside::default();
        for reach in reaches(0) {
            let w = self.apex.w - self.along * reach;
            beside.waist.extend(
                following(&source.contours_on(w, (to[0] / reach).sqrt()), &self.waist).map(|c| (w, c)),
            );
        }
        for reach in reaches(1) {
            let w = self.apex.w + self.along * reach;
            let there = source.contours_on(w, (to[1] / reach).sqrt());
            for (sections, leg) in beside.legs.iter_mut().zip(&self.legs) {
                sections.extend(following(&there, leg).map(|c| (w, c)));
            }
        }
        beside.waist.push((self.w_waist, self.waist.clone()));
        for (sections, leg) in beside.legs.iter_mut().zip(&self.legs) {
            sections.push((self.w_legs, leg.clone()));
        }
        beside
    }
}

/// The one of the contours that continues another one.
fn following(contours: &[Contour], other: &Contour) -> Option<Contour> {
    let cost = |c: &&Contour| distance_from(other, c) + distance_from(c, other);
    let alike = contours.iter().filter(|c| c.is_ccw() == other.is_ccw());
    alike.min_by(|a, b| cost(a).total_cmp(&cost(b))).cloned()
}

/// A zero of a function that rises from `low` to `high`, by the Illinois variant of the regula falsi (an end that
/// stays twice counts for half, so that both ends close in); the nearer end where there is none.
pub(super) fn root(f: impl Fn(f64) -> f64, low: f64, high: f64) -> f64 {
    let (mut a, mut b) = (low, high);
    let (mut fa, mut fb) = (f(a), f(b));
    if fa >= 0.0 {
        return a;
    }
    if fb <= 0.0 {
        return b;
    }
    let mut low_moved = None;
    for _ in 0..60 {
        let middle = ((a * fb - b * fa) / (fb - fa)).clamp(a, b);
        let value = f(middle);
        if value.abs() < 1e-11 || b - a < 1e-12 {
            return middle;
        }
        if value < 0.0 {
            (a, fa) = (middle, value);
            fb *= if low_moved == Some(true) { 0.5 } else { 1.0 };
        } else {
            (b, fb) = (middle, value);
            fa *= if low_moved == Some(false) { 0.5 } else { 1.0 };
        }
        low_moved = Some(value < 0.0);
    }
    0.5 * (a + b)
}

/// Mean distance of a curve's points from another curve, mm, from some of its points.
pub(super) fn distance_from(curve: &Contour, other: &Contour) -> f64 {
    const SAMPLES: usize = 24;
    let Some(index) = SegmentIndex::try_new(std::slice::from_ref(other)) else { return f64::INFINITY };
    let n = curve.len().min(SAMPLES);
    let point = |i: usize| curve.points[i * curve.len() / n];
    (0..n).map(|i| index.nearest(point(i)).distance_mm).sum::<f64>() / n as f64
}

/// An arc of a contour, along its direction.
struct Arc {
    start: Point2,
    end: Point2,
    /// On the legs start and end are one point, and the arc is the whole loop.
    place: Place,
}

impl Arc {
    /// Points on a polyline at the fractions u of its length, the inner ones refined.
    fn along(polyline: &[Point2], u: &[f64], refine: impl Fn(Point2, Vector2) -> Point2) -> Vec<Point2> {
        let mut lengths = vec![0.0];
        for pair in polyline.windows(2) {
            lengths.push(lengths[lengths.len() - 1] + (pair[1] - pair[0]).norm());
        }
        let whole = lengths[lengths.len() - 1];
        let at = |fraction: f64| {
            let target = fraction * whole;
            let i = lengths.partition_point(|&l| l <= target).clamp(1, polyline.len() - 1);
            let piece = (lengths[i] - lengths[i - 1]).max(1e-12);
            let along = polyline[i] - polyline[i - 1];
            refine(polyline[i - 1] + along * ((target - lengths[i - 1]) / piece), along)
        };
        let inner = u[1..u.len() - 1].iter().map(|&f| at(f));
        std::iter::once(polyline[0]).chain(inner).chain(polyline.last().copied()).collect()
    }

    fn polyline(&self, contour: &Contour) -> Vec<Point2> {
        let n = contour.len();
        let Some(index) = SegmentIndex::try_new(std::slice::from_ref(contour)) else {
            return vec![self.start, self.end];
        };
        let place = |p: Point2| {
            let foot = index.nearest(p);
            let from = contour.points[foot.edge_idx];
            let length = (contour.points[(foot.edge_idx + 1) % n] - from).norm().max(1e-12);
            foot.edge_idx as f64 + ((foot.point - from).norm() / length).min(1.0)
        };
        let (s, mut e) = (place(self.start), place(self.end));
        let whole = self.place == Place::Legs;
        if whole || e <= s {
            e = if whole { s + n as f64 } else { e + n as f64 };
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "indices of vertices")]
        let (first, last) = (s.floor() as usize + 1, e.ceil() as usize);
        // Vertices that all but coincide with an end would make a kink of rounding.
        let apart = |p: &Point2| (p - self.start).norm() > 1e-6 && (p - self.end).norm() > 1e-6;
        let between = (first..last).map(|i| contour.points[i % n]).filter(apart);
        std::iter::once(self.start).chain(between).chain(std::iter::once(self.end)).collect()
    }
}
