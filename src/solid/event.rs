//! Elementary events: where two branches part, and the three patches built there.
//!
//! Everything is seen along w, the height rising towards the daughters: w = z for a split, w = -z for a merge.
//! An [`EventSource`] is the implicit surface around the event. The saddle point of its field is the apex of the
//! crotch; in a thin slab round it the published three patches are built on the field: two lateral patches
//! whose rows are iso-curves, and a saddle patch over the quadrilateral A-P-B-Q, sharing four seams. All of them
//! interpolate one field, so that normals agree across seams without further construction.

use super::grid::Jet;
use crate::geom::{Bounds2, Contour, Point2, Point3, SegmentIndex, Vector2};
use crate::spline::{PatchSurface, SplineError};
use serde::{Deserialize, Serialize};

/// Rows of the lateral patches and of the saddle's grid.
const ROWS: usize = 13;
/// Intervals along u of a lateral patch.
const ARC_INTERVALS: usize = 64;
/// The share of a ring's length, to either side of its corners, in which it may bend sharply, and the pieces into
/// which its edges are cut there.
const NOTCH_SHARE: f64 = 0.03;
const NOTCH_PIECES: usize = 6;

/// The contours of one plane that take part in an event, and its height rising towards the daughters.
#[derive(Debug, Clone)]
pub(super) struct Plane {
    pub(super) w: f64,
    pub(super) contours: Vec<Contour>,
}

/// The planes around an event.
#[derive(Debug, Clone)]
pub(super) struct EventPlanes {
    /// The parent's planes, the nearest to the event first; one contour each.
    pub(super) parents: Vec<Plane>,
    /// The daughters' planes, the nearest first; one contour a daughter, always in the same order.
    pub(super) daughters: Vec<Plane>,
}

impl EventPlanes {
    /// Mean radius of the daughters by area, on their nearest plane.
    pub(super) fn mean_radius_mm(&self) -> f64 {
        let contours = &self.daughters[0].contours;
        let radius = |c: &Contour| (c.signed_area_mm2() / std::f64::consts::PI).sqrt();
        contours.iter().map(radius).sum::<f64>() / contours.len() as f64
    }

    /// The box around all contours.
    pub(super) fn bounds(&self) -> Option<Bounds2> {
        let all = self.parents.iter().chain(&self.daughters).flat_map(|p| &p.contours);
        all.filter_map(Contour::bounds).reduce(Bounds2::union)
    }
}

/// The implicit surface around an event: negative inside.
pub(super) trait EventSource: Sync {
    /// The field, near to a signed distance, mm.
    fn value(&self, p: Point2, w: f64) -> f64;
    /// The field with its gradient in the plane.
    fn jet(&self, p: Point2, w: f64) -> Jet {
        const H: f64 = 1e-4;
        let along = |d: Vector2| (self.value(p + d, w) - self.value(p - d, w)) / (2.0 * H);
        let slope = Vector2::new(along(Vector2::new(H, 0.0)), along(Vector2::new(0.0, H)));
        Jet { value: self.value(p, w), slope }
    }
    /// Its closed zero contours at height w, counter-clockwise.
    fn contours(&self, w: f64) -> Vec<Contour>;
    /// Moves a point that is nearly on the zero at height w onto it.
    fn refine(&self, p: Point2, w: f64) -> Point2;
    /// A point inside daughter i at height w.
    fn anchor(&self, i: usize, w: f64) -> Point2;
}

/// Why an event could not be built.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EventFault {
    /// The apex is not where the sections say it must be.
    #[error("the crotch cannot be located between the planes")]
    NoApex,
    /// Three or more branches part at one height.
    #[error(
        "more than two branches part at the same height: move one of the contours a little, or add a plane"
    )]
    Simultaneous,
    /// The sections beside the apex do not have the expected number of contours.
    #[error("{found} contours where {expected} were expected beside the crotch")]
    Components {
        /// Contours found.
        found: usize,
        /// Contours expected.
        expected: usize,
    },
    /// The plane through the crotch does not cut the parent's contour on both sides.
    #[error("the parent's contour does not enclose the crotch")]
    NoWaist,
    /// Surfaces cannot be interpolated.
    #[error(transparent)]
    Spline(#[from] SplineError),
}

/// The saddle point between two daughters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Apex {
    pub(super) w: f64,
    pub(super) lobes: [usize; 2],
}

/// The apex between lobes i and j in (low, high); `None` where the field has no sign change there.
pub(super) fn apex(source: &dyn EventSource, lobes: [usize; 2], [low, high]: [f64; 2]) -> Option<Apex> {
    let neck = |w: f64| neck_value(source, lobes, w);
    let (mut a, mut b) = (low, high);
    let (mut fa, mut fb) = (neck(a), neck(b));
    if fa >= 0.0 || fb <= 0.0 {
        return None;
    }
    // Illinois variant of the regula falsi: an end that stays twice counts for half, so that both ends close in.
    let mut root = a;
    let mut low_end_moved = None;
    for _ in 0..40 {
        root = (a * fb - b * fa) / (fb - fa);
        let f = neck(root);
        if f.abs() < 1e-6 || b - a < 1e-6 {
            break;
        }
        if f < 0.0 {
            (a, fa) = (root, f);
            fb *= if low_end_moved == Some(true) { 0.5 } else { 1.0 };
        } else {
            (b, fb) = (root, f);
            fa *= if low_end_moved == Some(false) { 0.5 } else { 1.0 };
        }
        low_end_moved = Some(f < 0.0);
    }
    Some(Apex { w: root, lobes })
}

/// The field's value at its saddle in the plane w: the highest value that a path from lobe to lobe must cross.
/// Nested golden sections, because the field may have a crease there.
fn neck_value(source: &dyn EventSource, [i, j]: [usize; 2], w: f64) -> f64 {
    let (from, to) = (source.anchor(i, w), source.anchor(j, w));
    let along = to - from;
    let across = Vector2::new(-along.y, along.x);
    let ridge = |y: f64| {
        let value = |x: f64| source.value(from + along * x + across * y, w);
        let best = (1..24)
            .map(|k| f64::from(k) / 24.0)
            .max_by(|a, b| value(*a).total_cmp(&value(*b)))
            .unwrap_or(0.5);
        -minimum(|x| -value(x), best - 1.0 / 24.0, best + 1.0 / 24.0)
    };
    let lowest =
        (-6..=6).map(|k| f64::from(k) / 15.0).min_by(|a, b| ridge(*a).total_cmp(&ridge(*b))).unwrap_or(0.0);
    minimum(ridge, lowest - 1.0 / 15.0, lowest + 1.0 / 15.0)
}

/// The least value of a unimodal function on an interval, by golden section.
fn minimum(f: impl Fn(f64) -> f64, mut a: f64, mut b: f64) -> f64 {
    const RATIO: f64 = 0.618_033_988_749_894_9;
    let (mut c, mut d) = (b - RATIO * (b - a), a + RATIO * (b - a));
    let (mut fc, mut fd) = (f(c), f(d));
    for _ in 0..18 {
        if fc < fd {
            (b, d, fd) = (d, c, fc);
            c = b - RATIO * (b - a);
            fc = f(c);
        } else {
            (a, c, fc) = (c, d, fd);
            d = a + RATIO * (b - a);
            fd = f(d);
        }
    }
    fc.min(fd)
}

/// The contour at height w that belongs to daughter i: the one that holds its anchor, else the nearest one.
pub(super) fn component(contours: &[Contour], anchor: Point2) -> Option<(usize, &Contour)> {
    let distance = |c: &Contour| {
        let index = SegmentIndex::try_new(std::slice::from_ref(c));
        index.map_or(f64::INFINITY, |i| i.signed_distance_mm(anchor))
    };
    contours.iter().enumerate().min_by(|a, b| distance(a.1).total_cmp(&distance(b.1)))
}

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

/// A slab with the contours at its borders.
#[derive(Debug, Clone)]
pub(super) struct BuiltSlab {
    pub(super) slab: Slab,
    /// The parent's contour at the waist.
    pub(super) waist: Contour,
    /// The daughters' contours at their ends.
    pub(super) daughters: [Contour; 2],
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

/// Cosine-spaced numbers from 0 to 1.
fn cosine_spaced(n: usize) -> Vec<f64> {
    let angle = |i: usize| std::f64::consts::PI * i as f64 / (n - 1) as f64;
    (0..n).map(|i| 0.5 * (1.0 - angle(i).cos())).collect()
}

/// Builds the three patches in the slab w[0]..w[1] around an apex.
pub(super) fn build_slab(
    source: &dyn EventSource,
    apex: Apex,
    w_mm: [f64; 2],
    upward: bool,
) -> Result<BuiltSlab, EventFault> {
    let fractions = cosine_spaced(ROWS);
    let heights: Vec<f64> = fractions.iter().map(|f| w_mm[0] + f * (w_mm[1] - w_mm[0])).collect();
    let anchors = |w: f64| apex.lobes.map(|i| source.anchor(i, w));
    let sections: Vec<[Contour; 2]> =
        heights.iter().map(|&w| pair_of_components(source, w, anchors(w))).collect::<Result<_, _>>()?;
    let [waist, other] = &sections[0];
    if waist != other {
        return Err(EventFault::Components { found: 2, expected: 1 });
    }
    let daughters = sections[ROWS - 1].clone();
    if daughters[0] == daughters[1] {
        return Err(EventFault::Components { found: 1, expected: 2 });
    }
    let corners =
        corners(waist, &daughters)?.map(|p, is_waist| source.refine(p, w_mm[usize::from(!is_waist)]));
    let seam = |from: Point2, to: Point2| -> Vec<Point2> {
        heights.iter().map(|&w| seam_point(source, from, to, w)).collect()
    };
    let seams = Seams {
        ap: pinned(seam(corners.a, corners.p), corners.a, corners.p),
        bp: pinned(seam(corners.b, corners.p), corners.b, corners.p),
        aq: pinned(seam(corners.a, corners.q), corners.a, corners.q),
        bq: pinned(seam(corners.b, corners.q), corners.b, corners.q),
    };
    let sign = if upward { 1.0 } else { -1.0 };
    let lateral = |side: usize, starts: &[Point2], ends: &[Point2]| -> Result<PatchSurface, EventFault> {
        let u = cosine_spaced(ARC_INTERVALS + 1);
        let rows: Vec<Vec<Point3>> = (0..ROWS)
            .map(|i| {
                let arc = Arc { start: starts[i], end: ends[i], whole: i + 1 == ROWS };
                let points = arc.sampled(&sections[i][side], &u, |p| source.refine(p, heights[i]));
                points.into_iter().map(|p| Point3::new(p.x, p.y, sign * heights[i])).collect()
            })
            .collect();
        Ok(PatchSurface::through(&u, &heights, &rows)?)
    };
    let laterals = [lateral(0, &seams.ap, &seams.bp)?, lateral(1, &seams.bq, &seams.aq)?];
    let saddle = saddle(source, &seams, &heights, &fractions, sign)?;
    let waist = denser(waist, [corners.a, corners.b], |p| source.refine(p, w_mm[0]));
    let [first, second] = &daughters;
    let daughters = [(first, corners.p), (second, corners.q)]
        .map(|(contour, tip)| denser(contour, [tip; 2], |p| source.refine(p, w_mm[1])));
    Ok(BuiltSlab { slab: Slab { upward, w_mm, laterals, crotch: Crotch::Saddle(saddle) }, waist, daughters })
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

/// The components that hold the two anchors: the same one twice below the apex.
fn pair_of_components(
    source: &dyn EventSource,
    w: f64,
    anchors: [Point2; 2],
) -> Result<[Contour; 2], EventFault> {
    let contours = source.contours(w);
    let missing = EventFault::Components { found: contours.len(), expected: 2 };
    let found = anchors.map(|anchor| component(&contours, anchor).map(|(_, c)| c.clone()));
    match found {
        [Some(a), Some(b)] => Ok([a, b]),
        _ => Err(missing),
    }
}

/// P, Q: the nearest points of the daughters; A, B: where the perpendicular through the middle of PQ cuts the waist,
/// A to the left of P -> Q.
fn corners(waist: &Contour, daughters: &[Contour; 2]) -> Result<Corners, EventFault> {
    let [first, second] = daughters;
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
    Ok(Corners { a: middle + left * nearest(true)?, b: middle + left * nearest(false)?, p, q })
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

/// The point of the chord `from`..`to` at which the field vanishes at height w: it is positive at the waist's
/// corner and negative at the daughter's.
fn seam_point(source: &dyn EventSource, from: Point2, to: Point2, w: f64) -> Point2 {
    let at = |t: f64| from + (to - from) * t;
    at(bisect(|t| -source.value(at(t), w), 0.0, 1.0))
}

/// A zero of a function that rises from `low` to `high`; the nearer end where there is none.
fn bisect(f: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    for _ in 0..40 {
        let middle = 0.5 * (low + high);
        if f(middle) < 0.0 { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

fn pinned(mut seam: Vec<Point2>, from: Point2, to: Point2) -> Vec<Point2> {
    let last = seam.len() - 1;
    seam[0] = from;
    seam[last] = to;
    seam
}

/// A counter-clockwise arc of a contour.
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

/// The saddle patch: a Coons grid in the plane, lifted onto the field.
fn saddle(
    source: &dyn EventSource,
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
                let w = bisect(|w| source.value(xy, w), low, high);
                Point3::new(xy.x, xy.y, sign * w)
            }
        }
    };
    let grid: Vec<Vec<Point3>> = (0..=m).map(|j| (0..=m).map(|i| place(i, j)).collect()).collect();
    Ok(PatchSurface::through(fractions, fractions, &grid)?)
}
