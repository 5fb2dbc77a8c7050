//! The patches of an event: their shared edges, and each patch inside its own edges.

use super::chart::{Allowed, Chart};
use super::curve::{Chords, spaced};
use super::face::{Corner, Face};
use super::keep::keep;
use super::remesh::{self, Size};
use super::tube::{RingVertex, SharedRing};
use super::{Error, TriMesh};
use crate::geom::{Point2, Point3};
use crate::progress::Task;
use crate::solid::{Crotch, Slab, Weld};
use crate::spline::PatchSurface;

/// Edges along a seam are not longer than this many of the rings' edges.
const LONGEST_SEAM: f64 = 1.3;

/// A vertex on a shared edge: its parameter along it, its number and place.
#[derive(Debug, Clone, Copy, PartialEq)]
struct OnEdge {
    t: f64,
    vertex: u32,
    point: Point3,
}

/// The vertices on the edges of an event's patches. Both ends are part of each edge.
#[derive(Debug)]
pub(super) struct SlabEdges {
    /// Rows of the two laterals at the waist, by u.
    waist: [Vec<OnEdge>; 2],
    /// Their rows at the daughters' ends.
    daughters: [Vec<OnEdge>; 2],
    /// Sides u = 0 and u = 1 of the two laterals, by the fraction of v from the waist.
    sides: [[Vec<OnEdge>; 2]; 2],
}

impl SlabEdges {
    /// Samples the edges and adds their vertices.
    pub(super) fn sampled(slab: &Slab, allowed: &Allowed<'_>, mesh: &mut TriMesh) -> Result<Self, Error> {
        let [low, high] = slab.w_mm.map(|w| slab.v_of(w));
        let row_at = |side: usize, v: f64, fewest: usize| {
            let patch = &slab.laterals[side];
            let curve = |u: f64| patch.at(u, v);
            let how = Chords { allowed, longest_mm: f64::INFINITY, fewest };
            let points: Vec<(f64, Point3)> =
                spaced(&curve, patch.u_range(), how).into_iter().map(|u| (u, curve(u))).collect();
            points
        };
        let waist = [0, 1].map(|side| row_at(side, low, 2));
        let tops = [0, 1].map(|side| row_at(side, high, 4));
        let chords = waist.iter().chain(&tops).flat_map(|row| row.windows(2));
        let (n, length) =
            chords.fold((0usize, 0.0), |(n, l), pair| (n + 1, l + (pair[1].1 - pair[0].1).norm()));
        let how = Chords { allowed, longest_mm: LONGEST_SEAM * length / n as f64, fewest: 1 };
        let seam = |side: usize, u_end: usize| {
            let patch = &slab.laterals[side];
            let u = patch.u_range()[u_end];
            let curve = |t: f64| patch.at(u, low + (high - low) * t);
            let points: Vec<(f64, Point3)> =
                spaced(&curve, [0.0, 1.0], how).into_iter().map(|t| (t, curve(t))).collect();
            points
        };
        let mut push = |p: Point3| mesh.push(p);
        let ap = placed(&seam(0, 0), None, None, &mut push)?;
        let (a, p) = (ap[0].vertex, ap[ap.len() - 1].vertex);
        let is_crease = matches!(slab.crotch, Crotch::Crease);
        let bp = placed(&seam(0, 1), None, Some(p), &mut push)?;
        let b = bp[0].vertex;
        let (bq, aq) = if is_crease {
            (bp.clone(), ap.clone())
        } else {
            let bq = placed(&seam(1, 0), Some(b), None, &mut push)?;
            let q = bq[bq.len() - 1].vertex;
            let aq = placed(&seam(1, 1), Some(a), Some(q), &mut push)?;
            (bq, aq)
        };
        let q = bq[bq.len() - 1].vertex;
        let first = placed(&waist[0], Some(a), Some(b), &mut push)?;
        let second = placed(&waist[1], Some(b), Some(a), &mut push)?;
        let daughters =
            [placed(&tops[0], Some(p), Some(p), &mut push)?, placed(&tops[1], Some(q), Some(q), &mut push)?];
        // One vertex, one place: both patches at an edge see the same.
        let mut edges = Self { waist: [first, second], daughters, sides: [[ap, bp], [bq, aq]] };
        let all = edges.waist.iter_mut().chain(&mut edges.daughters).chain(edges.sides.iter_mut().flatten());
        all.flatten().for_each(|e| e.point = mesh.vertices[e.vertex as usize]);
        Ok(edges)
    }

    /// The waist as a closed ring, by the parameter of its tube.
    pub(super) fn waist_ring(&self, slab: &Slab, weld: &Weld) -> SharedRing {
        let [a, b] = weld.waist_u;
        let ends = [[a, b], [b, a]];
        (0..2)
            .flat_map(|side| on_tube(&self.waist[side], slab.laterals[side].u_range(), ends[side]))
            .collect()
    }

    /// A daughter's end as a closed ring, by the parameter of its tube.
    pub(super) fn daughter_ring(&self, slab: &Slab, weld: &Weld, side: usize) -> SharedRing {
        let p = weld.daughter_u[side];
        on_tube(&self.daughters[side], slab.laterals[side].u_range(), [p, p]).collect()
    }
}

/// The vertices of a row without the last one: welded to its tube, a row is the arc from one parameter on to another.
fn on_tube(
    row: &[OnEdge],
    [u0, u1]: [f64; 2],
    [from, to]: [f64; 2],
) -> impl Iterator<Item = RingVertex> + '_ {
    let length = if to > from { to - from } else { to - from + 1.0 };
    let place = move |e: &OnEdge| RingVertex {
        u: (from + (e.t - u0) / (u1 - u0) * length).rem_euclid(1.0),
        vertex: e.vertex,
        point: e.point,
    };
    row[..row.len() - 1].iter().map(place)
}

/// Numbers for the points of an edge; its ends may have theirs already.
fn placed(
    points: &[(f64, Point3)],
    first: Option<u32>,
    last: Option<u32>,
    push: &mut impl FnMut(Point3) -> Result<u32, Error>,
) -> Result<Vec<OnEdge>, Error> {
    let n = points.len() - 1;
    let number = |(k, &(t, point)): (usize, &(f64, Point3))| {
        let given = if k == 0 {
            first
        } else if k == n {
            last
        } else {
            None
        };
        let vertex = given.map_or_else(|| push(point), Ok)?;
        Ok(OnEdge { t, vertex, point })
    };
    points.iter().enumerate().map(number).collect()
}

/// A patch to mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Patch {
    /// The lateral of a daughter.
    Lateral(usize),
    /// The saddle between them.
    Saddle,
}

/// Vertices of a patch's border: from the corner (0, 0) along u then v, and along v then u, to (1, 1).
struct Border {
    lower: Vec<(Point2, OnEdge)>,
    upper: Vec<(Point2, OnEdge)>,
    /// How the places of two vertices on the chains are compared: weights of u and v.
    along: [f64; 2],
}

/// Meshes a patch. Triangles run counter-clockwise in its parameters.
pub(super) fn mesh_patch<'a>(
    chart: &'a Chart,
    slab: &Slab,
    patch: Patch,
    edges: &SlabEdges,
    allowed: &Allowed<'_>,
    task: &Task<'_>,
) -> Result<(Face<'a>, bool), Error> {
    let border = match (patch, &slab.crotch) {
        (Patch::Lateral(side), _) => lateral_border(slab, side, edges),
        (Patch::Saddle, _) => saddle_border(edges),
    };
    let (corners, triangles) = zipped(&border);
    let mut face = Face::new(chart, corners, triangles);
    let size = Size::of_border(&face);
    remesh::fill(&mut face, &size, task)?;
    let kept = keep(&mut face, allowed, task)?;
    Ok((face, kept))
}

/// The surface of a patch; a crease has no saddle.
pub(super) fn surface(slab: &Slab, patch: Patch) -> Option<&PatchSurface> {
    match (patch, &slab.crotch) {
        (Patch::Lateral(side), _) => Some(&slab.laterals[side]),
        (Patch::Saddle, Crotch::Saddle(saddle)) => Some(saddle),
        (Patch::Saddle, Crotch::Crease) => None,
    }
}

fn lateral_border(slab: &Slab, side: usize, edges: &SlabEdges) -> Border {
    let [low, high] = slab.w_mm.map(|w| slab.v_of(w));
    let [u0, u1] = slab.laterals[side].u_range();
    let row = |edge: &[OnEdge], v: f64| edge.iter().map(|e| (Point2::new(e.t, v), *e)).collect::<Vec<_>>();
    let wall = |edge: &[OnEdge], u: f64| {
        let at = |e: &OnEdge| Point2::new(u, low + (high - low) * e.t);
        edge.iter().map(|e| (at(e), *e)).collect::<Vec<_>>()
    };
    Border {
        lower: joined(row(&edges.waist[side], low), wall(&edges.sides[side][1], u1)),
        upper: joined(wall(&edges.sides[side][0], u0), row(&edges.daughters[side], high)),
        along: [1.0 / (u1 - u0), 0.0],
    }
}

fn saddle_border(edges: &SlabEdges) -> Border {
    let [[ap, bp], [bq, aq]] = &edges.sides;
    let ahead =
        |edge: &[OnEdge], at: &dyn Fn(f64) -> Point2| edge.iter().map(|e| (at(e.t), *e)).collect::<Vec<_>>();
    let back = |edge: &[OnEdge], at: &dyn Fn(f64) -> Point2| {
        edge.iter().rev().map(|e| (at(1.0 - e.t), *e)).collect::<Vec<_>>()
    };
    Border {
        lower: joined(ahead(ap, &|t| Point2::new(t, 0.0)), back(bp, &|t| Point2::new(1.0, t))),
        upper: joined(ahead(aq, &|t| Point2::new(0.0, t)), back(bq, &|t| Point2::new(t, 1.0))),
        along: [0.5, 0.5],
    }
}

fn joined(mut first: Vec<(Point2, OnEdge)>, second: Vec<(Point2, OnEdge)>) -> Vec<(Point2, OnEdge)> {
    first.extend(second.into_iter().skip(1));
    first
}

/// Triangles between the two chains of a border: every one has corners on both, so that none lies on one side.
fn zipped(border: &Border) -> (Vec<Corner>, Vec<[u32; 3]>) {
    let (n, m) = (border.lower.len(), border.upper.len());
    // Both ends are shared: the upper chain's inner vertices follow the lower chain's.
    let corners: Vec<Corner> = border
        .lower
        .iter()
        .chain(&border.upper[1..m - 1])
        .map(|(param, e)| Corner { param: *param, point: e.point, is_pole: false, shared: Some(e.vertex) })
        .collect();
    let number = |i: usize| u32::try_from(i).unwrap_or(u32::MAX);
    let upper = |j: usize| {
        number(if j == 0 {
            0
        } else if j == m - 1 {
            n - 1
        } else {
            n + j - 1
        })
    };
    let place = |p: &(Point2, OnEdge)| border.along[0] * p.0.x + border.along[1] * p.0.y;
    let mut triangles = vec![[0, 1, upper(1)]];
    let (mut i, mut j) = (1, 1);
    while i + 2 < n || j + 2 < m {
        let by_lower = j + 2 >= m || i + 2 < n && place(&border.lower[i + 1]) <= place(&border.upper[j + 1]);
        if by_lower {
            triangles.push([number(i), number(i + 1), upper(j)]);
            i += 1;
        } else {
            triangles.push([number(i), upper(j + 1), upper(j)]);
            j += 1;
        }
    }
    triangles.push([number(i), number(n - 1), upper(j)]);
    (corners, triangles)
}
