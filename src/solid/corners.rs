//! The four corners of a saddle patch: P and Q on the legs, A and B on the waist.
//!
//! The published rule takes the nearest pair P, Q, and A, B where the perpendicular through its middle cuts the waist.
//! It is right where the surface is symmetric about its apex. Where it is steep, a chord from A to P may graze the waist or
//! even lead below it at first, and no seam over it rises steadily. There the corners are moved along their curves
//! until the chord that grazes most does so least.
//!
//! Or they are taken on the principal directions of the field at the apex: near to it the field is its quadratic form
//! (Morse's lemma), and over the chords between such corners that rises steadily whatever its coefficients are.

use super::critical::hessian;
use super::event::{EventFault, EventSource};
use super::grid::Jet;
use super::slab::root;
use super::sweep::Saddle;
use crate::geom::{Contour, Point2, SegmentIndex, Vector2};

/// Candidates to either side of a corner, and how often their spacing is halved.
const CANDIDATES: i32 = 6;
const HALVINGS: i32 = 6;
/// How far a corner may move at first, in diagonals of the quadrilateral.
const FIRST_REACH: f64 = 0.6;
/// Steps in which a corner is looked for, in distances at which the quadratic form has it, and how many.
const PRINCIPAL_STEP: f64 = 0.25;
const PRINCIPAL_STEPS: u32 = 12;

/// The corners in the plane.
#[derive(Debug, Clone, Copy)]
pub(super) struct Corners {
    pub(super) a: Point2,
    pub(super) b: Point2,
    pub(super) p: Point2,
    pub(super) q: Point2,
}

impl Corners {
    /// P, Q: the nearest points of the legs; A, B: where the perpendicular through the middle of PQ cuts the waist, A on
    /// the side from which the waist runs round the first leg: left of P -> Q where the field opens, else right.
    pub(super) fn published(source: &dyn EventSource, saddle: &Saddle) -> Result<Self, EventFault> {
        let Saddle { waist, legs: [first, second], opens, w_waist, w_legs, .. } = saddle;
        let index = |c: &Contour| SegmentIndex::try_new(std::slice::from_ref(c)).ok_or(EventFault::NoWaist);
        let (other, index) = (index(first)?, index(second)?);
        let gap = |p: &Point2| index.nearest(*p).distance_mm;
        let rough =
            first.points.iter().min_by(|a, b| gap(a).total_cmp(&gap(b))).ok_or(EventFault::NoWaist)?;
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
        let on_waist = |t: f64| source.refine(middle + left * t, *w_waist);
        let (a, b) = (on_waist(nearest(*opens)?), on_waist(nearest(!*opens)?));
        Ok(Self { a, b, p: source.refine(p, *w_legs), q: source.refine(q, *w_legs) })
    }

    /// The corners on the principal directions of the field at the apex.
    pub(super) fn principal(source: &dyn EventSource, saddle: &Saddle) -> Result<Self, EventFault> {
        let Saddle { apex, opens, w_waist, w_legs, legs, .. } = saddle;
        let size = legs.iter().map(Contour::perimeter_mm).fold(f64::INFINITY, f64::min);
        let sign = if *opens { 1.0 } else { -1.0 };
        let form = (hessian(&*source.slice(apex.w), apex.at, 1e-3 * size) * sign).symmetric_eigen();
        let towards_legs = form.eigenvalues.imin();
        // From the apex along a principal direction to the zero at a height, where the field's sign changes.
        let corner = |which: usize, w: f64, backward: bool| -> Result<Point2, EventFault> {
            let field = source.slice(w);
            let along = form.eigenvectors.column(which) * if backward { -1.0 } else { 1.0 };
            let side = if which == towards_legs { -sign } else { sign };
            let value = |t: f64| side * field(apex.at + along * t).value;
            let expected = (2.0 * value(0.0).abs() / form.eigenvalues[which].abs().max(1e-12)).sqrt();
            let step = PRINCIPAL_STEP * expected;
            let beyond = (1..=PRINCIPAL_STEPS).map(|k| step * f64::from(k)).find(|&t| value(t) >= 0.0);
            let beyond = beyond.filter(|_| value(0.0) < 0.0).ok_or(EventFault::NoWaist)?;
            Ok(apex.at + along * root(value, beyond - step, beyond))
        };
        let ends = [corner(towards_legs, *w_legs, false)?, corner(towards_legs, *w_legs, true)?];
        let sides = [corner(1 - towards_legs, *w_waist, false)?, corner(1 - towards_legs, *w_waist, true)?];
        let first = SegmentIndex::try_new(std::slice::from_ref(&legs[0])).ok_or(EventFault::NoWaist)?;
        let [is_first, is_other] = ends.map(|p| first.nearest(p).distance_mm < 1e-3 * size);
        let [p, q] = match (is_first, is_other) {
            (true, false) => ends,
            (false, true) => [ends[1], ends[0]],
            _ => return Err(EventFault::NoWaist),
        };
        let is_left = (q - p).perp(&(sides[0] - sides[1])) > 0.0;
        let [a, b] = if is_left == *opens { sides } else { [sides[1], sides[0]] };
        Ok(Self { a, b, p, q })
    }

    /// The shorter diagonal.
    pub(super) fn size_mm(&self) -> f64 {
        (self.b - self.a).norm().min((self.q - self.p).norm())
    }

    /// The sine of the angle at which that chord which grazes the curves most leaves the waist or reaches a leg.
    pub(super) fn least_rise(&self, source: &dyn EventSource, saddle: &Saddle) -> f64 {
        let rise = rise(source, saddle);
        let Self { a, b, p, q } = *self;
        rise(a, p).min(rise(b, p)).min(rise(a, q)).min(rise(b, q))
    }

    /// The corners moved so that their chords graze the curves least.
    pub(super) fn turned(self, source: &dyn EventSource, saddle: &Saddle) -> Self {
        let rise = rise(source, saddle);
        let mut all = self;
        let first = FIRST_REACH * (self.b - self.a).norm().max((self.q - self.p).norm());
        for halving in 0..HALVINGS {
            let reach = first * 0.5f64.powi(halving);
            let best = |at: Point2, w: f64, curve: &Contour, cost: &dyn Fn(Point2) -> f64| {
                let places = beside(curve, at, reach).into_iter().map(|p| source.refine(p, w));
                let all = std::iter::once(at).chain(places);
                all.max_by(|x, y| cost(*x).total_cmp(&cost(*y))).unwrap_or(at)
            };
            let Self { p, q, .. } = all;
            all.a = best(all.a, saddle.w_waist, &saddle.waist, &|a| rise(a, p).min(rise(a, q)));
            all.b = best(all.b, saddle.w_waist, &saddle.waist, &|b| rise(b, p).min(rise(b, q)));
            let Self { a, b, .. } = all;
            all.p = best(p, saddle.w_legs, &saddle.legs[0], &|p| rise(a, p).min(rise(b, p)));
            all.q = best(q, saddle.w_legs, &saddle.legs[1], &|q| rise(a, q).min(rise(b, q)));
        }
        all
    }
}

/// The sine of the angle at which a chord leaves the waist and reaches the leg, the smaller one.
fn rise<'a>(source: &'a dyn EventSource, saddle: &Saddle) -> impl Fn(Point2, Point2) -> f64 + 'a {
    let (waist, legs) = (source.slice(saddle.w_waist), source.slice(saddle.w_legs));
    let sign = if saddle.opens { 1.0 } else { -1.0 };
    let inward = move |field: &dyn Fn(Point2) -> Jet, p: Point2| {
        -sign * field(p).slope.try_normalize(1e-12).unwrap_or_default()
    };
    move |from, to| {
        let chord = (to - from).try_normalize(1e-12).unwrap_or_default();
        inward(&*waist, from).dot(&chord).min(inward(&*legs, to).dot(&chord))
    }
}

/// Points of a curve to either side of one of it, no farther along it than `reach`.
fn beside(curve: &Contour, at: Point2, reach: f64) -> Vec<Point2> {
    let Some(index) = SegmentIndex::try_new(std::slice::from_ref(curve)) else { return Vec::new() };
    let (n, edge) = (curve.len(), index.nearest(at).edge_idx);
    let mut places = Vec::new();
    for forward in [true, false] {
        let mut from = at;
        let (mut passed, mut k) = (0.0, 1);
        for step in 1..=CANDIDATES {
            let target = reach * f64::from(step) / f64::from(CANDIDATES);
            let mut to = curve.points[if forward { edge + k } else { edge + n + 1 - k } % n];
            while passed + (to - from).norm() < target && k < n {
                passed += (to - from).norm();
                from = to;
                k += 1;
                to = curve.points[if forward { edge + k } else { edge + n + 1 - k } % n];
            }
            let length = (to - from).norm().max(1e-12);
            places.push(from + (to - from) * ((target - passed) / length).clamp(0.0, 1.0));
        }
    }
    places
}

/// Where the line `middle + t left` crosses the edge; `along` is normal to the line.
fn crossing(middle: Point2, along: Vector2, left: Vector2, start: Point2, end: Point2) -> Option<f64> {
    let (ds, de) = ((start - middle).dot(&along), (end - middle).dot(&along));
    ((ds < 0.0) != (de < 0.0)).then(|| {
        let at = start + (end - start) * (ds / (ds - de));
        (at - middle).dot(&left)
    })
}
