//! A face's surface and how far its triangles may lie from it.

use super::net::{Net, Piece};
use crate::geom::{Point2, Point3, Vector2, Vector3};
use crate::spline::{PatchSurface, TubeSurface};

/// Pieces along a patch that may bend on their own: more come from the knots of the rings it is welded to.
const MOST_PIECES: usize = 64;

/// Pieces along a patch by which its extent is measured.
const LENGTH_SAMPLES: u32 = 12;

/// A surface and its parameters.
#[derive(Debug)]
pub(super) enum Chart {
    /// Parameters u (periodic in 1) and z.
    Tube {
        /// The surface, u from 0 to 1.
        net: Net,
        /// Pieces round it.
        n_u: f64,
    },
    /// Parameters u and v of the patch.
    Patch {
        /// The surface.
        net: Net,
        /// Pieces for a unit of either parameter.
        pieces: [f64; 2],
    },
    /// A horizontal plane; parameters x and y.
    Flat {
        /// Its height.
        z_mm: f64,
    },
}

impl Chart {
    /// The surface of a tube.
    pub(super) fn of_tube(surface: &TubeSurface) -> Self {
        Self::Tube { net: Net::of(&surface.clamped()), n_u: surface.net().n_u() as f64 }
    }

    /// The surface of a patch.
    pub(super) fn of_patch(patch: &PatchSurface) -> Self {
        let [n_u, n_v] = patch.n_functions().map(|n| n.min(MOST_PIECES) as f64);
        let ([u0, u1], [v0, v1]) = (patch.u_range(), patch.v_range());
        Self::Patch { net: Net::of(patch), pieces: [n_u / (u1 - u0), n_v / (v1 - v0)] }
    }

    /// The point at a pair of parameters.
    pub(super) fn at(&self, p: Point2) -> Point3 {
        self.at_near(p, &mut self.piece(p))
    }

    /// The piece of the surface in which a pair of parameters lies.
    pub(super) fn piece(&self, p: Point2) -> Piece {
        match self {
            Self::Tube { net, .. } => net.piece(Point2::new(wrapped(p.x), p.y)),
            Self::Patch { net, .. } => net.piece(p),
            Self::Flat { .. } => Piece::default(),
        }
    }

    /// The point at a pair of parameters, for many that are near each other.
    pub(super) fn at_near(&self, p: Point2, near: &mut Piece) -> Point3 {
        match self {
            Self::Tube { net, .. } => {
                let point = net.at(Point2::new(wrapped(p.x), p.y), near);
                Point3::new(point.x, point.y, p.y)
            }
            Self::Patch { net, .. } => net.at(p, near),
            Self::Flat { z_mm } => Point3::new(p.x, p.y, *z_mm),
        }
    }

    /// Whether the first parameter is periodic in 1.
    pub(super) const fn is_periodic(&self) -> bool {
        matches!(self, Self::Tube { .. })
    }

    /// How many pieces of the spline lie side by side over a step of the parameters. Between two of its knots a
    /// spline has no more than one bend; over many it may have many.
    pub(super) fn n_pieces(&self, from: Point2, to: Point2) -> f64 {
        let step: Vector2 = to - from;
        match self {
            Self::Tube { net, n_u } => (step.x.abs() * n_u).max(net.n_rows(from.y, to.y) as f64),
            Self::Patch { pieces, .. } => (step.x * pieces[0]).abs().max((step.y * pieces[1]).abs()),
            Self::Flat { .. } => 0.0,
        }
    }

    /// Mean lengths of a unit of either parameter, mm, where the surface is a patch.
    pub(super) fn unit_lengths(&self) -> Option<[f64; 2]> {
        let Self::Patch { net, .. } = self else { return None };
        let [[u0, u1], [v0, v1]] = net.ranges();
        let at = |i: u32, j: u32| {
            let share = |k: u32| f64::from(k) / f64::from(LENGTH_SAMPLES);
            self.at(Point2::new(u0 + (u1 - u0) * share(i), v0 + (v1 - v0) * share(j)))
        };
        let mut length = [0.0; 2];
        for i in 0..LENGTH_SAMPLES {
            for j in 0..LENGTH_SAMPLES {
                length[0] += (at(i + 1, j) - at(i, j)).norm();
                length[1] += (at(i, j + 1) - at(i, j)).norm();
            }
        }
        let lines = f64::from(LENGTH_SAMPLES);
        Some([length[0] / (lines * (u1 - u0)), length[1] / (lines * (v1 - v0))])
    }

    /// Derivatives along both parameters.
    pub(super) fn tangents(&self, p: Point2) -> [Vector3; 2] {
        match self {
            Self::Tube { net, .. } => net.tangents(Point2::new(wrapped(p.x), p.y)),
            Self::Patch { net, .. } => net.tangents(p),
            Self::Flat { .. } => [Vector3::x(), Vector3::y()],
        }
    }
}

/// A periodic parameter in [0, 1).
fn wrapped(u: f64) -> f64 {
    // Most are already: the rounding functions cost more than all the rest.
    if (0.0..1.0).contains(&u) { u } else { u - u.floor() }
}

/// How fast the deflection grows with the distance from a place where it is smaller.
const GROWTH: f64 = 0.1;

/// A place where triangles have to keep closer to the surface, because they would meet others otherwise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Finer {
    /// Its middle.
    pub(super) at: Point3,
    /// How far it reaches, mm.
    pub(super) radius_mm: f64,
    /// Deflection in it, mm.
    pub(super) deflection_mm: f64,
}

impl Finer {
    /// The deflection that the place allows at p, mm.
    pub(super) fn allows(&self, p: Point3) -> f64 {
        self.deflection_mm + GROWTH * ((p - self.at).norm() - self.radius_mm).max(0.0)
    }
}

/// The deflection allowed on a face, mm.
#[derive(Debug, Clone)]
pub(super) struct Allowed<'a> {
    /// What is asked for.
    pub(super) asked: Asked,
    /// Where less is allowed.
    pub(super) finer: &'a [Finer],
}

/// The deflection asked for on a face, mm.
#[derive(Debug, Clone)]
pub(super) enum Asked {
    /// The same everywhere.
    Everywhere(f64),
    /// By height: ascending heights and the deflection at each.
    ByHeight(Vec<(f64, f64)>),
}

impl Allowed<'_> {
    /// The deflection allowed at a point.
    pub(super) fn at(&self, p: Point3) -> f64 {
        self.finer.iter().map(|f| f.allows(p)).fold(self.asked.at(p.z), f64::min)
    }
}

impl Asked {
    /// The deflection asked for at height z.
    pub(super) fn at(&self, z_mm: f64) -> f64 {
        match self {
            Self::Everywhere(d) => *d,
            Self::ByHeight(table) => {
                let i = table.partition_point(|row| row.0 <= z_mm).clamp(1, table.len() - 1);
                let ((za, da), (zb, db)) = (table[i - 1], table[i]);
                da + (db - da) * ((z_mm - za) / (zb - za)).clamp(0.0, 1.0)
            }
        }
    }
}
