//! A face's surface and how far its triangles may lie from it.

use crate::geom::{Point2, Point3, Vector2, Vector3};
use crate::spline::{PatchSurface, TubeNet};

/// Pieces along a patch that may bend on their own: more come from the knots of the rings it is welded to.
const MOST_PIECES: usize = 64;

/// Pieces along a patch by which its extent is measured.
const LENGTH_SAMPLES: u32 = 12;

/// A surface and its parameters.
#[derive(Debug)]
pub(super) enum Chart<'a> {
    /// Parameters u (periodic in 1) and z.
    Tube(TubeNet<'a>),
    /// Parameters u and v of the patch.
    Patch(&'a PatchSurface),
    /// A horizontal plane; parameters x and y.
    Flat {
        /// Its height.
        z_mm: f64,
    },
}

impl Chart<'_> {
    /// The point at a pair of parameters.
    pub(super) fn at(&self, p: Point2) -> Point3 {
        match self {
            Self::Tube(net) => net.at(p.x, p.y),
            Self::Patch(patch) => patch.at(p.x, p.y),
            Self::Flat { z_mm } => Point3::new(p.x, p.y, *z_mm),
        }
    }

    /// Whether the first parameter is periodic in 1.
    pub(super) const fn is_periodic(&self) -> bool {
        matches!(self, Self::Tube(_))
    }

    /// How many pieces of the spline lie side by side over a step of the parameters. Between two of its knots a
    /// spline has no more than one bend; over many it may have many.
    pub(super) fn n_pieces(&self, step: Vector2) -> f64 {
        match self {
            Self::Tube(net) => step.x.abs() * net.n_u() as f64,
            Self::Patch(patch) => {
                let ([u0, u1], [v0, v1]) = (patch.u_range(), patch.v_range());
                let [n_u, n_v] = patch.n_functions().map(|n| n.min(MOST_PIECES));
                (step.x / (u1 - u0) * n_u as f64).abs().max((step.y / (v1 - v0) * n_v as f64).abs())
            }
            Self::Flat { .. } => 0.0,
        }
    }

    /// Mean lengths of a unit of either parameter, mm, where the surface is a patch.
    pub(super) fn unit_lengths(&self) -> Option<[f64; 2]> {
        let Self::Patch(patch) = self else { return None };
        let ([u0, u1], [v0, v1]) = (patch.u_range(), patch.v_range());
        let at = |i: u32, j: u32| {
            let share = |k: u32| f64::from(k) / f64::from(LENGTH_SAMPLES);
            patch.at(u0 + (u1 - u0) * share(i), v0 + (v1 - v0) * share(j))
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

    /// Derivatives along both parameters by difference quotients inside the ranges.
    pub(super) fn tangents(&self, p: Point2) -> [Vector3; 2] {
        let [[u0, u1], [v0, v1]] = match self {
            Self::Tube(net) => [[f64::NEG_INFINITY, f64::INFINITY], net.z_range_mm()],
            Self::Patch(patch) => [patch.u_range(), patch.v_range()],
            Self::Flat { .. } => return [Vector3::x(), Vector3::y()],
        };
        let step = |low: f64, high: f64| 1e-5 * (high - low).min(1.0);
        let (hu, hv) = (step(u0, u1), step(v0, v1));
        let (ua, ub, va, vb) =
            ((p.x - hu).max(u0), (p.x + hu).min(u1), (p.y - hv).max(v0), (p.y + hv).min(v1));
        [
            (self.at(Point2::new(ub, p.y)) - self.at(Point2::new(ua, p.y))) / (ub - ua),
            (self.at(Point2::new(p.x, vb)) - self.at(Point2::new(p.x, va))) / (vb - va),
        ]
    }
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
