//! The three patches of an elementary event, in a thin slab round the saddle point of a field.
//!
//! Two lateral patches, whose rows are iso-curves, and a saddle patch over the quadrilateral A-P-B-Q share four seams
//! (the published construction). All of them interpolate one field, so that normals agree across seams without
//! further construction.
//!
//! One closed curve (the waist) becomes two (the legs). Where a branch parts, all three are outlines; where an
//! outline closes round a hole, the waist is the C-shaped outline and the legs are the outline and the hole. In both
//! cases the curves run with the inside to their left, and every patch follows from that.

use super::event::{EventFault, EventSource};
use super::sweep::Saddle;
use crate::geom::{Contour, Point2, Point3, SegmentIndex, Vector2};
use crate::spline::PatchSurface;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Rows of the lateral patches and of the saddle's grid.
const ROWS: usize = 13;
/// Intervals along u of a lateral patch.
const ARC_INTERVALS: usize = 64;
/// The share of a ring's length, to either side of its corners, in which it may bend sharply, and the pieces into
/// which its edges are cut there.
const NOTCH_SHARE: f64 = 0.03;
const NOTCH_PIECES: usize = 6;

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

/// The corners of the saddle in the plane.
#[derive(Debug, Clone, Copy)]
struct Corners {
    a: Point2,
    b: Point2,
    p: Point2,
    q: Point2,
}

impl Corners {
    /// Moves the corners: each with whether it lies on the waist.
    fn map(self, move_to: impl Fn(Point2, bool) -> Point2) -> Self {
        let Self { a, b, p, q } = self;
        Self { a: move_to(a, true), b: move_to(b, true), p: move_to(p, false), q: move_to(q, false) }
    }
}

/// A slab with the closed curves at its borders, set more closely beside the corners.
#[derive(Debug)]
pub(super) struct Bordered {
    pub(super) slab: Slab,
    pub(super) waist: Contour,
    pub(super) legs: [Contour; 2],
}

/// Cosine-spaced numbers from 0 to 1.
fn cosine_spaced(n: usize) -> Vec<f64> {
    let angle = |i: usize| std::f64::consts::PI * i as f64 / (n - 1) as f64;
    (0..n).map(|i| 0.5 * (1.0 - angle(i).cos())).collect()
}

/// Builds the three patches between the waist's height and the legs', both seen along the source's w; `upward` says
/// whether the source's w is z.
pub(super) fn build_slab(
    source: &dyn EventSource,
    saddle: &Saddle,
    upward: bool,
) -> Result<Bordered, EventFault> {
    let view = View { source, along: saddle.along, sign: if saddle.opens { 1.0 } else { -1.0 } };
    let w_mm = [saddle.w_waist, saddle.w_legs].map(|w| w * saddle.along);
    let fractions = cosine_spaced(ROWS);
    let heights: Vec<f64> = fractions.iter().map(|f| w_mm[0] + f * (w_mm[1] - w_mm[0])).collect();
    let refine =
        |p: Point2, is_waist: bool| source.refine(p, if is_waist { saddle.w_waist } else { saddle.w_legs });
    let corners = corners(&saddle.waist, &saddle.legs, saddle.opens)?.map(refine);
    let rows = heights.par_iter().enumerate().map(|(i, &w)| {
        let place = if i == 0 {
            Place::Waist
        } else if i + 1 == ROWS {
            Place::Legs
        } else {
            Place::Between
        };
        view.row(saddle, &corners, w, place)
    });
    let rows: Vec<Row> = rows.collect::<Result<_, _>>()?;
    let u = cosine_spaced(ARC_INTERVALS + 1);
    let upward = upward == (saddle.along > 0.0);
    let sign = if upward { 1.0 } else { -1.0 };
    let lateral = |side: usize| {
        let at = |(row, &w): (&Row, &f64)| -> Vec<Point3> {
            row.laterals[side].iter().map(|p| Point3::new(p.x, p.y, sign * w)).collect()
        };
        PatchSurface::through(&u, &heights, &rows.iter().zip(&heights).map(at).collect::<Vec<_>>())
    };
    let laterals = [lateral(0)?, lateral(1)?];
    let seam = |k: usize| rows.iter().map(|r| r.seams[k]).collect();
    let seams = Seams { ap: seam(0), bp: seam(1), aq: seam(2), bq: seam(3) };
    let patch = view.saddle(&seams, &heights, &fractions, sign)?;
    let slab = Slab { upward, w_mm, laterals, crotch: Crotch::Saddle(patch) };
    let waist = denser(&saddle.waist, [corners.a, corners.b], |p| refine(p, true));
    let [first, second] = &saddle.legs;
    let legs = [(first, corners.p), (second, corners.q)]
        .map(|(contour, tip)| denser(contour, [tip; 2], |p| refine(p, false)));
    Ok(Bordered { slab, waist, legs })
}

/// The contour with more vertices beside the corners, where it bends more sharply than its vertices are set.
fn denser(contour: &Contour, corners: [Point2; 2], refine: impl Fn(Point2) -> Point2) -> Contour {
    let reach_mm = NOTCH_SHARE * contour.perimeter_mm();
    let mut points = Vec::with_capacity(2 * contour.len());
    for (from, to) in contour.edges() {
        points.push(from);
        let middle = nalgebra::center(&from, &to);
        if corners.iter().any(|c| (c - middle).norm() < reach_mm) {
            let inner = (1..NOTCH_PIECES).map(|k| from + (to - from) * (k as f64 / NOTCH_PIECES as f64));
            points.extend(inner.map(&refine));
        }
    }
    Contour::new(points)
}

/// Which row of a slab.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    Waist,
    Between,
    Legs,
}

/// One height of a slab: the seams' points A-P, B-P, A-Q, B-Q and the laterals' points.
struct Row {
    seams: [Point2; 4],
    laterals: [Vec<Point2>; 2],
}

/// A source seen from the waist towards the legs, so that its field rises at the saddle.
struct View<'a> {
    source: &'a dyn EventSource,
    along: f64,
    sign: f64,
}

impl View<'_> {
    fn row(&self, saddle: &Saddle, corners: &Corners, w: f64, place: Place) -> Result<Row, EventFault> {
        let field = self.source.slice(self.along * w);
        let loops = match place {
            Place::Waist => [saddle.waist.clone(), saddle.waist.clone()],
            Place::Legs => saddle.legs.clone(),
            Place::Between => self.loops(saddle, w)?,
        };
        let Corners { a, b, p, q } = *corners;
        let seam = |from: Point2, to: Point2| match place {
            Place::Waist => from,
            Place::Legs => to,
            Place::Between => {
                let at = |t: f64| from + (to - from) * t;
                at(root(|t| -self.sign * field(at(t)).value, 0.0, 1.0))
            }
        };
        let seams = [seam(a, p), seam(b, p), seam(a, q), seam(b, q)];
        let u = cosine_spaced(ARC_INTERVALS + 1);
        let lateral = |side: usize, start: Point2, end: Point2| {
            let arc = Arc { start, end, whole: place == Place::Legs };
            arc.sampled(&loops[side], &u, |p| self.source.refine(p, self.along * w))
        };
        let laterals = [lateral(0, seams[0], seams[1]), lateral(1, seams[3], seams[2])];
        Ok(Row { seams, laterals })
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

/// P, Q: the nearest points of the legs; A, B: where the perpendicular through the middle of PQ cuts the waist, A on
/// the side from which the waist runs round the first leg: left of P -> Q where the field opens, else right.
fn corners(waist: &Contour, legs: &[Contour; 2], opens: bool) -> Result<Corners, EventFault> {
    let [first, second] = legs;
    let index = SegmentIndex::try_new(std::slice::from_ref(second)).ok_or(EventFault::NoWaist)?;
    let other = SegmentIndex::try_new(std::slice::from_ref(first)).ok_or(EventFault::NoWaist)?;
    let gap = |p: &Point2| index.nearest(*p).distance_mm;
    let rough = first.points.iter().min_by(|a, b| gap(a).total_cmp(&gap(b))).ok_or(EventFault::NoWaist)?;
    // Alternating projections settle between the vertices.
    let (mut p, mut q) = (*rough, index.nearest(*rough).point);
    for _ in 0..20 {
        p = other.nearest(q).point;
        q = index.nearest(p).point;
    }
    let middle = nalgebra::center(&p, &q);
    let along = (q - p).try_normalize(1e-12).ok_or(EventFault::NoWaist)?;
    let left = Vector2::new(-along.y, along.x);
    let crossings: Vec<f64> =
        waist.edges().filter_map(|(s, e)| crossing(middle, along, left, s, e)).collect();
    let nearest = |positive: bool| {
        let side = crossings.iter().copied().filter(|t| (*t > 0.0) == positive);
        side.min_by(|a, b| a.abs().total_cmp(&b.abs())).ok_or(EventFault::NoWaist)
    };
    Ok(Corners { a: middle + left * nearest(opens)?, b: middle + left * nearest(!opens)?, p, q })
}

/// Where the line `middle + t left` crosses the edge; `along` is normal to the line.
fn crossing(middle: Point2, along: Vector2, left: Vector2, start: Point2, end: Point2) -> Option<f64> {
    let (ds, de) = ((start - middle).dot(&along), (end - middle).dot(&along));
    ((ds < 0.0) != (de < 0.0)).then(|| {
        let at = start + (end - start) * (ds / (ds - de));
        (at - middle).dot(&left)
    })
}

/// Seam points at every height, from the waist's corner to the daughter's.
struct Seams {
    ap: Vec<Point2>,
    bp: Vec<Point2>,
    aq: Vec<Point2>,
    bq: Vec<Point2>,
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
    /// Start and end are one point, and the arc is the whole loop.
    whole: bool,
}

impl Arc {
    /// Points on the arc at the fractions u of its length, the inner ones refined.
    fn sampled(&self, contour: &Contour, u: &[f64], refine: impl Fn(Point2) -> Point2) -> Vec<Point2> {
        let polyline = self.polyline(contour);
        let mut lengths = vec![0.0];
        for pair in polyline.windows(2) {
            lengths.push(lengths[lengths.len() - 1] + (pair[1] - pair[0]).norm());
        }
        let whole = lengths[lengths.len() - 1];
        let at = |fraction: f64| {
            let target = fraction * whole;
            let i = lengths.partition_point(|&l| l <= target).clamp(1, polyline.len() - 1);
            let piece = (lengths[i] - lengths[i - 1]).max(1e-12);
            polyline[i - 1] + (polyline[i] - polyline[i - 1]) * ((target - lengths[i - 1]) / piece)
        };
        let inner = u[1..u.len() - 1].iter().map(|&f| refine(at(f)));
        std::iter::once(self.start).chain(inner).chain(std::iter::once(self.end)).collect()
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
        if self.whole || e <= s {
            e = if self.whole { s + n as f64 } else { e + n as f64 };
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "indices of vertices")]
        let (first, last) = (s.floor() as usize + 1, e.ceil() as usize);
        // Vertices that all but coincide with an end would make a kink of rounding.
        let apart = |p: &Point2| (p - self.start).norm() > 1e-6 && (p - self.end).norm() > 1e-6;
        let between = (first..last).map(|i| contour.points[i % n]).filter(apart);
        std::iter::once(self.start).chain(between).chain(std::iter::once(self.end)).collect()
    }
}
