//! Makes the borders of a slab's patches and the ends of the tubes beside it one and the same curves.
//!
//! The end ring of a tube is a uniform periodic cubic; the rows of a lateral patch interpolate the same contour at other
//! sites, so that both agree only as far as splines do. Here the corners A, B, P, Q are put on the rings, the rings' arcs
//! between them are cut out exactly, the laterals' u is made to run as on the arcs, they are refined to the knots of both their arcs (both by [`Basis`]' exact
//! refinement), and every control row is moved by the difference between arc and border, falling linearly to the
//! opposite border. The saddle follows its seams by a Coons blend of their motion. Afterwards the patches' borders
//! have the control points of the curves they share, to rounding.
//!
//! The interior moves by no more than the borders were apart. The seam u = 0 of a tube is moved round to stay clear of
//! the corners.

use super::event::{Crotch, Slab};
use super::skin::{End, Tube};
use super::slab::least_area;
use super::tangent::{Leaning, MOST_SLOPE, followed, leaned, normals_of};
use crate::geom::{Point2, Point3, Vector3};
use crate::spline::{Basis, Curve, PatchRow, PatchSurface, SectionCurve, Side};
use serde::{Deserialize, Serialize};

/// A corner nearer than this to a knot of its ring, in knot spacings, is put onto it: shorter knot intervals say nothing.
const SNAP_SPACINGS: f64 = 1e-4;
/// Knots of unit intervals that are one but for rounding.
const SAME_KNOT: f64 = 1e-9;
/// A welded saddle has no cell smaller than this share of the mean one, seen along z.
const LEAST_AREA: f64 = 0.03;
/// A lateral that is moved by more than this to meet the tubes, mm, is brought into step with them anew.
const MOST_MOVED_MM: f64 = 5e-4;
/// Most slope that is added to a lateral of a crease over its whole height, mm per mm of that: from a parabola's end, at
/// which v is stated, it falls by twice as much.
const MOST_LEAN: f64 = 0.2;
/// Chords along which the length of a ring's arc is taken.
const LENGTH_SAMPLES: usize = 2048;
/// The seam of a tube stays where it is if no corner is nearer than this share of the way round.
const SEAM_CLEARANCE: f64 = 1.0 / 16.0;

/// Where the corners of a slab's patches lie on the rings of the tubes beside it.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Weld {
    /// Tubes on the side of the waist and of either daughter.
    pub tubes: [usize; 3],
    /// Parameters u of A and B on the waist, both in [0, 1).
    pub waist_u: [f64; 2],
    /// Parameters u of P and Q on the rings of the daughters.
    pub daughter_u: [f64; 2],
}

/// The ring of a slab on one of its tubes.
fn ring(tubes: &[Tube], tube: usize, end: End) -> (SectionCurve, f64) {
    let z = end_z_mm(&tubes[tube], end);
    (tubes[tube].surface.section(z), z)
}

fn end_z_mm(tube: &Tube, end: End) -> f64 {
    let [low, high] = tube.surface.z_range_mm();
    if tube.bottom == end { low } else { high }
}

/// What the tubes on the side of the waist and of either daughter end in.
pub(super) fn ends_of(slab: usize) -> [End; 3] {
    [End::Waist { slab }, End::Daughter { slab, side: 0 }, End::Daughter { slab, side: 1 }]
}

/// Welds all slabs to their tubes; with how far the patches of each were moved at most, mm.
pub(super) fn weld(tubes: &mut [Tube], slabs: &mut [Slab]) -> (Vec<Weld>, Vec<f64>) {
    let mut welds: Vec<Weld> =
        slabs.iter().enumerate().map(|(i, slab)| corners(tubes, slab, ends_of(i))).collect();
    for (idx, tube) in tubes.iter_mut().enumerate() {
        let n = tube.surface.section(tube.surface.z_range_mm()[0]).len();
        let steps = seam_steps(&welds, idx, n);
        if steps > 0 {
            let turned = |u: f64| (u - steps as f64 / n as f64).rem_euclid(1.0);
            tube.surface = tube.surface.clone().turned(steps);
            welds.iter_mut().for_each(|w| w.on_tube(idx).for_each(|u| *u = turned(*u)));
        }
        welds.iter_mut().for_each(|w| w.on_tube(idx).for_each(|u| *u = snapped(*u, n)));
    }
    let mut moved_mm = vec![0.0; slabs.len()];
    for (i, (slab, weld)) in slabs.iter().zip(&welds).enumerate() {
        if matches!(slab.crotch, Crotch::Crease) {
            join_at_apex(tubes, weld, ends_of(i), &mut moved_mm[i]);
        }
    }
    for (i, (slab, weld)) in slabs.iter_mut().zip(&welds).enumerate() {
        let rings = [0, 1, 2].map(|k| {
            let tube = &tubes[weld.tubes[k]];
            let z_mm = end_z_mm(tube, ends_of(i)[k]);
            Ring { z_mm, leaning: Leaning::of(&tube.surface, z_mm) }
        });
        let sides = [0, 1].map(|side| {
            let [from, to] = if side == 0 { weld.waist_u } else { [weld.waist_u[1], weld.waist_u[0]] };
            let p = weld.daughter_u[side];
            let to = if to > from { to } else { to + 1.0 };
            [(&rings[0], [from, to]), (&rings[1 + side], [p, p + 1.0])]
        });
        weld_slab(slab, sides, &mut moved_mm[i]);
    }
    (welds, moved_mm)
}

/// The end of a tube.
struct Ring {
    z_mm: f64,
    leaning: Leaning,
}

/// The part of a ring between two corners.
type RingArc<'a> = (&'a Ring, [f64; 2]);

/// Makes the rings of both daughters pass through one point, the apex of their crease.
fn join_at_apex(tubes: &mut [Tube], weld: &Weld, ends: [End; 3], moved_mm: &mut f64) {
    let places: Vec<Point2> = (0..2)
        .map(|side| ring(tubes, weld.tubes[side + 1], ends[side + 1]).0.at(weld.daughter_u[side]))
        .collect();
    let apex = nalgebra::center(&places[0], &places[1]);
    for (side, place) in places.into_iter().enumerate() {
        let tube = &mut tubes[weld.tubes[side + 1]];
        let end = if tube.bottom == ends[side + 1] { Side::First } else { Side::Last };
        tube.surface.pull_end(end, weld.daughter_u[side], apex - place);
        *moved_mm = moved_mm.max((apex - place).norm());
    }
}

impl Weld {
    /// Parameters of the corners that lie on a tube.
    fn on_tube(&mut self, tube: usize) -> impl Iterator<Item = &mut f64> {
        let [waist, first, second] = self.tubes.map(|t| t == tube);
        let [a, b] = &mut self.waist_u;
        let [p, q] = &mut self.daughter_u;
        [(waist, a), (waist, b), (first, p), (second, q)].into_iter().filter_map(|(on, u)| on.then_some(u))
    }
}

/// The corners' places on the rings: nearest to where the patches have them.
fn corners(tubes: &[Tube], slab: &Slab, ends: [End; 3]) -> Weld {
    let found = ends.map(|end| tubes.iter().position(|t| t.bottom == end || t.top == end));
    let tubes_of = found.map(|t| t.expect("each border of a slab is the end of a tube"));
    let rings = [0, 1, 2].map(|i| ring(tubes, tubes_of[i], ends[i]).0);
    let [low, high] = slab.w_mm.map(|w| slab.v_of(w));
    let corner = |side: usize, v: f64| -> Point2 { slab.laterals[side].at(0.0, v).xy() };
    Weld {
        tubes: tubes_of,
        waist_u: [rings[0].nearest(corner(0, low)), rings[0].nearest(corner(1, low))],
        daughter_u: [rings[1].nearest(corner(0, high)), rings[2].nearest(corner(1, high))],
    }
}

/// By how many knots the seam of a tube is moved on: as far from all corners as can be.
fn seam_steps(welds: &[Weld], tube: usize, n: usize) -> usize {
    let corners: Vec<f64> =
        welds.iter().copied().flat_map(|mut w| w.on_tube(tube).map(|u| *u).collect::<Vec<_>>()).collect();
    let clearance = |step: &usize| {
        let apart = |u: &f64| {
            let d = (u - *step as f64 / n as f64).rem_euclid(1.0);
            d.min(1.0 - d)
        };
        corners.iter().map(apart).fold(0.5, f64::min)
    };
    if clearance(&0) >= SEAM_CLEARANCE {
        return 0;
    }
    (0..n).max_by(|a, b| clearance(a).total_cmp(&clearance(b)).then(b.cmp(a))).unwrap_or(0)
}

/// A parameter that all but is a knot becomes the knot.
fn snapped(u: f64, n: usize) -> f64 {
    let knot = (u * n as f64).round();
    if (u * n as f64 - knot).abs() >= SNAP_SPACINGS {
        return u;
    }
    if knot >= n as f64 { 0.0 } else { knot / n as f64 }
}

/// Inner knots of a basis on the unit interval.
fn unit_inner(basis: &Basis) -> Vec<f64> {
    basis.over([0.0, 1.0]).inner_knots().to_vec()
}

/// The given knots, ascending, those that are one but for rounding once: the first one given stays.
fn merged(lists: &[Vec<f64>]) -> Vec<f64> {
    let mut all: Vec<f64> = Vec::new();
    for &knot in lists.iter().flatten() {
        let i = all.partition_point(|k| *k < knot);
        let near = |k: Option<&f64>| k.is_some_and(|k| (k - knot).abs() < SAME_KNOT);
        if !(near(all.get(i)) || i > 0 && near(all.get(i - 1))) {
            all.insert(i, knot);
        }
    }
    all
}

/// The patch with inner knots, stated on the unit interval, moved by rounding onto those of `target` and then refined
/// to them.
fn onto(patch: &PatchSurface, target: [&[f64]; 2]) -> PatchSurface {
    let finer = |basis: &Basis, inner: &[f64]| {
        let clamped = Basis::clamped(basis.degree(), [0.0, 1.0], inner);
        let moved = unit_inner(basis).into_iter().map(|knot| {
            let i = inner.partition_point(|k| *k < knot - SAME_KNOT);
            inner.get(i).copied().unwrap_or(knot)
        });
        let own = Basis::clamped(basis.degree(), [0.0, 1.0], &moved.collect::<Vec<_>>());
        (own.over(basis.range()), clamped.over(basis.range()))
    };
    let [u, v] = patch.bases();
    let ((own_u, finer_u), (own_v, finer_v)) = (finer(u, target[0]), finer(v, target[1]));
    let points: Vec<Point3> = patch.control().collect();
    PatchSurface::with_control(own_u, own_v, &points).refined(&finer_u, &finer_v)
}

/// Welds the patches of one slab to the arcs `[side][waist or daughter]` of the rings. The patches lean as the tubes do
/// as far as the saddle between them can follow: where a tube and the patch that it meets disagree by more than the
/// saddle has room for, they keep some of their own slope, or all of it.
fn weld_slab(slab: &mut Slab, sides: [[RingArc<'_>; 2]; 2], moved_mm: &mut f64) {
    let along = seam_knots(slab);
    let weld_one = |k: usize| welded(&slab.laterals[k], &sides[k], &along);
    let (first, second) = rayon::join(|| weld_one(0), || weld_one(1));
    *moved_mm = moved_mm.max(first.1).max(second.1);
    let welded = [first.0, second.0];
    match &mut slab.crotch {
        Crotch::Saddle(saddle) => {
            let refined = onto(saddle, [&along, &along]);
            let mut best: Option<(f64, Joined)> = None;
            for (most_slope, follows) in [(MOST_SLOPE, true), (0.2, true), (0.0, true), (0.0, false)] {
                let joined = joined(&refined, &welded, &sides, most_slope, follows);
                let area = least_area(&joined.saddle);
                if best.as_ref().is_none_or(|(least, _)| area > *least) {
                    best = Some((area, joined));
                }
                if area > LEAST_AREA {
                    break;
                }
            }
            if let Some((_, joined)) = best {
                *moved_mm = moved_mm.max(joined.moved_mm);
                (slab.laterals, *saddle) = (joined.laterals, joined.saddle);
            }
        }
        // Both laterals have the crease: what is between their curves is taken.
        Crotch::Crease => {
            let most_slope = MOST_LEAN * (slab.w_mm[1] - slab.w_mm[0]);
            let [first, second] = [0, 1].map(|k| {
                leaned(&welded[k], sides[k].map(|(ring, range)| (&ring.leaning, range)), most_slope)
            });
            let sides = [[&first, &second], [&second, &first]].map(|[one, other]| {
                let (own, others) = (one.border_column(Side::First), other.border_column(Side::Last));
                *moved_mm = moved_mm.max(apart_mm(&own, &others));
                middle(&own, &others)
            });
            let [left, right] = sides;
            slab.laterals = [with_columns(&first, &left, &right), with_columns(&second, &right, &left)];
        }
    }
}

/// A lateral between the arcs of its rings, with how far it was moved at most, mm.
fn welded(lateral: &PatchSurface, side: &[RingArc<'_>; 2], along: &[f64]) -> (PatchSurface, f64) {
    let arcs = side.map(|(ring, range)| ring.leaning.section.arc(range, ring.z_mm));
    let [u, _] = lateral.bases();
    let knots = merged(&[unit_inner(arcs[0].basis()), unit_inner(arcs[1].basis()), unit_inner(u)]);
    let to_knots = |patch: &PatchSurface| onto(patch, [&knots, along]);
    let usual = with_borders(&to_knots(&in_step(lateral, &arcs)), &arcs);
    if usual.1 <= MOST_MOVED_MM {
        return usual;
    }
    // The arcs run less evenly than few columns can follow.
    let finer = with_borders(&in_step(&to_knots(lateral), &arcs), &arcs);
    if finer.1 < usual.1 { finer } else { usual }
}

/// The curve half-way between two over the same knots.
fn middle(a: &Curve, b: &Curve) -> Curve {
    let points = a.control().iter().zip(b.control()).map(|(p, q)| nalgebra::center(p, q));
    Curve::new(a.basis().clone(), points.collect())
}

/// How far the control points of two curves over the same knots lie apart, at most.
fn apart_mm(a: &Curve, b: &Curve) -> f64 {
    a.control().iter().zip(b.control()).map(|(p, q)| (p - q).norm()).fold(0.0, f64::max)
}

/// The laterals and the saddle with common seams.
struct Joined {
    laterals: [PatchSurface; 2],
    saddle: PatchSurface,
    moved_mm: f64,
}

/// Gives the welded laterals up to `most_slope` of the slope of their tubes, the saddle their seams, and, if it `follows`,
/// their normals.
fn joined(
    saddle: &PatchSurface,
    welded: &[PatchSurface; 2],
    sides: &[[RingArc<'_>; 2]; 2],
    most_slope: f64,
    follows: bool,
) -> Joined {
    let laterals =
        [0, 1].map(|k| leaned(&welded[k], sides[k].map(|(ring, range)| (&ring.leaning, range)), most_slope));
    let [first, second] = laterals;
    let [ap, bp] = [first.border_column(Side::First), first.border_column(Side::Last)];
    let [bq, aq] = [second.border_column(Side::First), second.border_column(Side::Last)];
    let mut moved_mm = 0.0;
    let closed = with_seams(saddle, [ap, bq.reversed(), aq, bp.reversed()], &mut moved_mm);
    // Seams A-P, Q-B, A-Q, P-B.
    let (ap, qb) = (normals_of(&first, false, false), normals_of(&second, false, true));
    let (aq, pb) = (normals_of(&second, true, false), normals_of(&first, true, true));
    let saddle = if follows { followed(&closed, [&ap, &qb, &aq, &pb]) } else { closed.clone() };
    Joined { laterals: [first.clone(), second.clone()], saddle, moved_mm }
}

/// The lateral with u running as it does on the arcs of the rings, linearly changing between them: points of its borders
/// are to move across the arcs and not along them, because what is along a border is across the rows farther in.
fn in_step(lateral: &PatchSurface, arcs: &[Curve; 2]) -> PatchSurface {
    let [u, v] = lateral.bases();
    let (columns, rows) = (u.greville(), v.greville());
    let [low, high] = v.range();
    let strides = [0, 1].map(|k| {
        let border = lateral.row([low, high][k]);
        let arc = arcs[k].over(u.range());
        let about = shares_of_length(&arc, &columns);
        let foot = |(&t, share): (&f64, f64)| foot(&border, u.range(), share, arc.at(t)) - t;
        columns.iter().zip(about).map(foot).collect::<Vec<f64>>()
    });
    let points = rows.iter().flat_map(|&at| {
        let (row, share) = (lateral.row(at), (at - low) / (high - low));
        let strides = &strides;
        let point =
            move |(i, t): (usize, &f64)| row.at(t + strides[0][i] * (1.0 - share) + strides[1][i] * share);
        columns.iter().enumerate().map(point).collect::<Vec<Point3>>()
    });
    PatchSurface::interpolating(u.clone(), v.clone(), &points.collect::<Vec<_>>())
}

/// The shares of a curve's length at which parameters lie.
fn shares_of_length(curve: &Curve, parameters: &[f64]) -> Vec<f64> {
    let [low, high] = curve.range();
    let at = |k: usize| low + (high - low) * k as f64 / LENGTH_SAMPLES as f64;
    let mut passed = vec![0.0];
    for k in 0..LENGTH_SAMPLES {
        passed.push(passed[k] + (curve.at(at(k + 1)) - curve.at(at(k))).norm());
    }
    let share = |t: &f64| {
        let place = (t - low) / (high - low) * LENGTH_SAMPLES as f64;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to an index")]
        let k = place.clamp(0.0, (LENGTH_SAMPLES - 1) as f64) as usize;
        (passed[k] + (passed[k + 1] - passed[k]) * (place - k as f64)) / passed[LENGTH_SAMPLES].max(1e-300)
    };
    parameters.iter().map(share).collect()
}

/// The parameter at which a border is nearest to a point that lies about at a share of its length, in which its
/// parameter runs; the ends stay.
fn foot(border: &PatchRow<'_>, [first, last]: [f64; 2], share: f64, point: Point3) -> f64 {
    let about = first + (last - first) * share;
    if about <= first || about >= last {
        return about.clamp(first, last);
    }
    let mut at = about;
    for _ in 0..12 {
        let (off, along) = (point - border.at(at), border.derivative_at(at));
        let by = off.dot(&along) / along.norm_squared().max(1e-300);
        at = (at + by).clamp(first, last);
        if by.abs() < 1e-14 {
            break;
        }
    }
    let is_nearer = (point - border.at(at)).norm() <= (point - border.at(about)).norm();
    if is_nearer { at } else { about }
}

/// Inner knots along the seams, on the unit interval and the same in both directions.
fn seam_knots(slab: &Slab) -> Vec<f64> {
    let mut lists: Vec<Vec<f64>> = slab.laterals.iter().map(|l| unit_inner(l.bases()[1])).collect();
    if let Crotch::Saddle(saddle) = &slab.crotch {
        lists.extend(saddle.bases().map(unit_inner));
        let turned: Vec<Vec<f64>> = lists.iter().map(|l| l.iter().map(|k| 1.0 - k).collect()).collect();
        lists.extend(turned);
    }
    merged(&lists)
}

/// The lateral with the arcs as its first and last row. Heights of all rows stay, to the last bit those of the rings at
/// the ends. With how far it was moved at most, mm.
fn with_borders(lateral: &PatchSurface, arcs: &[Curve; 2]) -> (PatchSurface, f64) {
    let [u, v] = lateral.bases();
    let unit = u.over([0.0, 1.0]);
    let borders = arcs.each_ref().map(|arc| arc.over([0.0, 1.0]).refined(unit.clone()));
    let points: Vec<Point3> = lateral.control().collect();
    let (n, m) = (u.len(), v.len());
    let shifts: [Vec<Vector3>; 2] = [0, m - 1].map(|row| {
        let border = &borders[usize::from(row > 0)];
        (0..n).map(|i| border.control()[i] - points[row * n + i]).collect()
    });
    let moved_mm = shifts.iter().flatten().map(|s| s.norm()).fold(0.0, f64::max);
    let shares = v.over([0.0, 1.0]).greville();
    let mut out = Vec::with_capacity(points.len());
    for (row, share) in shares.iter().enumerate() {
        for i in 0..n {
            let point = if row == 0 || row + 1 == m {
                borders[usize::from(row > 0)].control()[i]
            } else {
                let at = points[row * n + i] + shifts[0][i] * (1.0 - share) + shifts[1][i] * *share;
                Point3::new(at.x, at.y, points[row * n].z)
            };
            out.push(point);
        }
    }
    (PatchSurface::with_control(u.clone(), v.clone(), &out), moved_mm)
}

/// The lateral with other columns at its sides.
fn with_columns(lateral: &PatchSurface, first: &Curve, last: &Curve) -> PatchSurface {
    let [u, v] = lateral.bases();
    let n = u.len();
    let mut points: Vec<Point3> = lateral.control().collect();
    for row in 0..v.len() {
        points[row * n] = first.control()[row];
        points[row * n + n - 1] = last.control()[row];
    }
    PatchSurface::with_control(u.clone(), v.clone(), &points)
}

/// The saddle with the given curves as borders: v first and last (over u), u first and last (over v). What lies between
/// moves by the Coons blend of its borders' motion.
fn with_seams(
    saddle: &PatchSurface,
    [bottom, top, left, right]: [Curve; 4],
    moved_mm: &mut f64,
) -> PatchSurface {
    let [u, v] = saddle.bases();
    let points: Vec<Point3> = saddle.control().collect();
    let (n, m) = (u.len(), v.len());
    let shift = |curve: &Curve, k: usize, i: usize, j: usize| curve.control()[k] - points[j * n + i];
    let (s, t) = (u.over([0.0, 1.0]).greville(), v.over([0.0, 1.0]).greville());
    let corner = |i: usize, j: usize| shift(if j == 0 { &bottom } else { &top }, i, i, j);
    let mut out = Vec::with_capacity(points.len());
    for j in 0..m {
        for i in 0..n {
            let along = shift(&bottom, i, i, 0) * (1.0 - t[j]) + shift(&top, i, i, m - 1) * t[j];
            let across = shift(&left, j, 0, j) * (1.0 - s[i]) + shift(&right, j, n - 1, j) * s[i];
            let bilinear = (corner(0, 0) * (1.0 - s[i]) + corner(n - 1, 0) * s[i]) * (1.0 - t[j])
                + (corner(0, m - 1) * (1.0 - s[i]) + corner(n - 1, m - 1) * s[i]) * t[j];
            let by = along + across - bilinear;
            *moved_mm = moved_mm.max(by.norm());
            out.push(match (i, j) {
                (i, 0) => bottom.control()[i],
                (i, j) if j + 1 == m => top.control()[i],
                (0, j) => left.control()[j],
                (i, j) if i + 1 == n => right.control()[j],
                _ => points[j * n + i] + by,
            });
        }
    }
    PatchSurface::with_control(u.clone(), v.clone(), &out)
}
