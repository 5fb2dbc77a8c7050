//! The boundary representation of a body: vertices, edges, coedges, loops, faces, shells.
//!
//! [`Brep::of`] turns the skins of a [`Solid`](crate::solid::Solid) into faces on B-spline surfaces and planes. Every edge has one curve in
//! space, an exact B-spline, and each use of it (a coedge) a straight trace in the parameters of its face; the two
//! surfaces beside it have that curve exactly, because the solid's patches are welded to its tubes. A tube is one face
//! that is closed in u, with a seam edge used twice; flat ends are planes with one loop or several.
//!
//! Loops run counter-clockwise seen from outside, with the face to the left. Stack frame, mm.
//!
//! [`check`] tests what the definition of a valid solid asks; [`Brep::volume_mm3`] is exact to rounding.
//!
//! What it does not do: boolean operations, healing. Everything is linear in the number of control points.

mod build;
mod caps;
mod check;
mod clearance;
mod fault;
mod near;
mod patch;
mod sections;
#[cfg(test)]
mod tests;
mod volume;

pub use check::{check, examined};
pub(crate) use clearance::{Meeting, meetings};
pub use fault::{Fault, Invalid, Kind};

use crate::geom::{Point3, Vector3};
use crate::spline::{Curve, Jet, PatchSurface};

/// Farthest that curves may be from their vertices and surfaces, and what is as good as nothing, mm.
const TOLERANCE_MM: f64 = 1e-6;

/// Rows whose height changes by less than this share of a patch's, per share of its parameter, stand still.
const STILL: f64 = 1e-6;

/// A point where edges end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vertex {
    /// Its place, mm.
    pub point: Point3,
}

/// A curve between two vertices (one and the same for a ring).
#[derive(Debug, Clone, PartialEq)]
pub struct Edge {
    /// The curve from `start` to `end`.
    pub curve: Curve,
    /// Index of the vertex at the curve's first parameter.
    pub start: usize,
    /// Index of the vertex at its last one.
    pub end: usize,
}

/// A use of an edge by a face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coedge {
    /// Index of the edge.
    pub edge: usize,
    /// Whether the loop runs along the edge's curve or against it.
    pub is_forward: bool,
    /// The surface's (u, v) at the first and the last parameter of the edge's curve; a straight line between. Planes
    /// take x and y for their parameters, whatever stands here.
    pub trace: [[f64; 2]; 2],
}

/// A closed chain of coedges.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Loop {
    /// Each begins where the one before ends.
    pub coedges: Vec<Coedge>,
}

/// Where a face lies.
#[derive(Debug, Clone, PartialEq)]
pub enum Surface {
    /// A tube: closed in u, v is z.
    Tube(PatchSurface),
    /// A lateral patch of an event: its height depends on v alone.
    Lateral(PatchSurface),
    /// The saddle between two laterals.
    Saddle(PatchSurface),
    /// The horizontal plane at this height, mm; its normal points up.
    Plane(f64),
}

impl Surface {
    /// The B-spline surface; a plane has none.
    #[must_use]
    pub const fn spline(&self) -> Option<&PatchSurface> {
        match self {
            Self::Tube(s) | Self::Lateral(s) | Self::Saddle(s) => Some(s),
            Self::Plane(_) => None,
        }
    }

    /// What it is, for messages.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Tube(_) => "tube",
            Self::Lateral(_) => "lateral patch",
            Self::Saddle(_) => "saddle patch",
            Self::Plane(_) => "cap",
        }
    }
}

/// A bounded part of a surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Face {
    /// Where it lies.
    pub surface: Surface,
    /// Whether the surface's own normal (u cross v) points out of the body.
    pub is_outward: bool,
    /// Its borders, the outer one first.
    pub loops: Vec<Loop>,
}

/// Faces that close.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shell {
    /// Indices of its faces, ascending.
    pub faces: Vec<usize>,
}

/// A connected piece of material.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Body {
    /// Its border to the outside.
    pub outer: Shell,
    /// Its borders to closed hollows inside it.
    pub voids: Vec<Shell>,
}

/// A boundary representation.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Brep {
    /// Vertices.
    pub vertices: Vec<Vertex>,
    /// Edges.
    pub edges: Vec<Edge>,
    /// Faces.
    pub faces: Vec<Face>,
    /// Bodies that do not touch each other.
    pub bodies: Vec<Body>,
}

impl Edge {
    /// The vertex at which a use of it begins, and the one at which that ends.
    #[must_use]
    pub const fn ends(&self, is_forward: bool) -> [usize; 2] {
        if is_forward { [self.start, self.end] } else { [self.end, self.start] }
    }
}

impl Brep {
    /// All shells.
    pub fn shells(&self) -> impl Iterator<Item = &Shell> {
        self.bodies.iter().flat_map(|b| std::iter::once(&b.outer).chain(&b.voids))
    }

    /// Farthest that normals on both sides of an edge point apart, degrees, and where; edges of caps and of creases
    /// (whose laterals meet without a saddle) left out. `samples` points an edge.
    #[must_use]
    pub fn normal_jump_deg(&self, samples: usize) -> Option<(f64, Point3)> {
        let mut uses: Vec<Vec<(Vector3Field<'_>, f64)>> = vec![Vec::new(); self.edges.len()];
        for face in &self.faces {
            let Some(spline) = face.surface.spline() else { continue };
            let sign = if face.is_outward { 1.0 } else { -1.0 };
            for coedge in face.loops.iter().flat_map(|l| &l.coedges) {
                let is_lateral = matches!(face.surface, Surface::Lateral(_));
                uses[coedge.edge].push((Vector3Field { spline, trace: coedge.trace, is_lateral }, sign));
            }
        }
        let jump = |(edge, sides): (&Edge, &Vec<(Vector3Field<'_>, f64)>)| {
            let [(first, s), (second, t)] = &sides[..] else { return None };
            if first.is_lateral && second.is_lateral {
                return None;
            }
            let at = |k: usize| {
                let share = (k as f64 + 0.5) / samples as f64;
                let (m, n) = (first.normal(share) * *s, second.normal(share) * *t);
                let [a, b] = edge.curve.range();
                (m.angle(&n).to_degrees(), edge.curve.at(a + (b - a) * share))
            };
            (0..samples).map(at).max_by(|a, b| a.0.total_cmp(&b.0))
        };
        self.edges.iter().zip(&uses).filter_map(jump).max_by(|a, b| a.0.total_cmp(&b.0))
    }
}

/// The normals of a surface along a trace.
#[derive(Debug, Clone, Copy)]
struct Vector3Field<'a> {
    spline: &'a PatchSurface,
    trace: [[f64; 2]; 2],
    is_lateral: bool,
}

impl Vector3Field<'_> {
    fn normal(&self, share: f64) -> Vector3 {
        let [u, v] = along(self.trace, share);
        let at = |v: f64| self.spline.jet(u, v);
        let jet = if self.is_lateral { at(self.moving(v)) } else { at(v) };
        jet.by_u.cross(&jet.by_v)
    }

    /// The parameter v, or that at which the rows of a lateral are [`TOLERANCE_MM`] away in height from a border on which
    /// they stand still: at the apex of a crease height falls with the square of v, points move along their row, and only
    /// the limit of the normals is one.
    fn moving(&self, v: f64) -> f64 {
        let [low, high] = self.spline.v_range();
        let [bottom, top] = [low, high].map(|end| self.spline.jet(0.0, end));
        let height_mm = (top.point.z - bottom.point.z).abs();
        let is_still = |jet: &Jet| jet.by_v.z.abs() * (high - low) < STILL * height_mm;
        let by = (high - low) * (TOLERANCE_MM / height_mm).sqrt().min(1.0);
        if v >= high && is_still(&top) {
            high - by
        } else if v <= low && is_still(&bottom) {
            low + by
        } else {
            v
        }
    }
}

/// The point of a trace at a share of its way.
pub(crate) fn along([from, to]: [[f64; 2]; 2], share: f64) -> [f64; 2] {
    [0, 1].map(|k| from[k] + (to[k] - from[k]) * share)
}
