//! The distance of single points from the lumen, found on its surfaces themselves: a judge of the cloud of samples that
//! places the wall and measures it ([`super::feet`]).
//!
//! On every tube and patch near a point, Newton's method on the squared distance from the nearest point of a grid. Each
//! distance is that of a point of the surface: the true one is never larger.

use crate::geom::{Point3, Vector3};
use crate::solid::event::Crotch;
use crate::solid::skin::Skin;
use crate::spline::{PatchSurface, TubeNet};

/// Intervals of the grid round a surface, and over its height within reach.
const ROUND: usize = 64;
const OVER: usize = 16;
/// Newton steps at most, the step of difference quotients as a share of a parameter's range, and the step that is none, mm.
const MOST_STEPS: usize = 20;
const QUOTIENT: f64 = 1e-3;
const SETTLED_MM: f64 = 1e-7;

/// A surface and its parameters.
enum Face<'a> {
    Tube(TubeNet<'a>),
    Patch(&'a PatchSurface),
}

impl Face<'_> {
    fn at(&self, [u, v]: [f64; 2]) -> Point3 {
        match self {
            Self::Tube(net) => net.at(u, v),
            Self::Patch(patch) => patch.at(u, v),
        }
    }

    /// The parameters within the surface's ranges.
    fn inside(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let within = |t: f64, [low, high]: [f64; 2]| t.clamp(low, high);
        match self {
            Self::Tube(net) => [u, within(v, net.z_range_mm())],
            Self::Patch(patch) => [within(u, patch.u_range()), within(v, patch.v_range())],
        }
    }

    fn u_range(&self) -> [f64; 2] {
        match self {
            Self::Tube(_) => [0.0, 1.0],
            Self::Patch(patch) => patch.u_range(),
        }
    }

    /// The part of v in which the surface may be within reach of a height.
    fn v_range(&self, z_mm: f64, reach_mm: f64) -> [f64; 2] {
        match self {
            Self::Tube(net) => {
                let [low, high] = net.z_range_mm();
                [low.max(z_mm - reach_mm), high.min(z_mm + reach_mm)]
            }
            Self::Patch(patch) => patch.v_range(),
        }
    }

    /// The distance of a point, mm.
    fn distance_mm(&self, p: Point3, reach_mm: f64) -> f64 {
        let (round, over) = (self.u_range(), self.v_range(p.z, reach_mm));
        let place = |[low, high]: [f64; 2], k: usize, n: usize| low + (high - low) * k as f64 / n as f64;
        let nodes =
            (0..=OVER).flat_map(|j| (0..=ROUND).map(move |i| [place(round, i, ROUND), place(over, j, OVER)]));
        let far = |at: &[f64; 2]| (self.at(*at) - p).norm_squared();
        let start = nodes.map(|at| (far(&at), at)).min_by(|a, b| a.0.total_cmp(&b.0));
        let spacing = [(round[1] - round[0]) / ROUND as f64, (over[1] - over[0]) / OVER as f64];
        start.map_or(f64::INFINITY, |(least, at)| least.sqrt().min(self.descended_mm(p, at, spacing)))
    }

    /// The least distance on the way down from a place, no step longer than the grid's.
    fn descended_mm(&self, p: Point3, start: [f64; 2], spacing: [f64; 2]) -> f64 {
        let (mut at, mut least_mm) = (start, f64::INFINITY);
        for _ in 0..MOST_STEPS {
            let [du, dv] = spacing.map(|s| QUOTIENT * s.max(1e-9));
            let near = |i: f64, j: f64| self.at([at[0] + i * du, at[1] + j * dv]).coords;
            let here = near(0.0, 0.0);
            let (left, right, below, above) =
                (near(-1.0, 0.0), near(1.0, 0.0), near(0.0, -1.0), near(0.0, 1.0));
            let off = p.coords - here;
            least_mm = least_mm.min(off.norm());
            let (by_u, by_v) = (0.5 * (right - left), 0.5 * (above - below));
            let (uu, vv) = (right + left - here * 2.0, above + below - here * 2.0);
            let uv = 0.25 * (near(1.0, 1.0) + near(-1.0, -1.0) - near(1.0, -1.0) - near(-1.0, 1.0));
            let Some([s, t]) = step(off, [by_u, by_v], [uu, uv, vv]) else { break };
            let by = [s * du, t * dv];
            let share = (0..2).map(|k| spacing[k] / by[k].abs().max(1e-300)).fold(1.0, f64::min);
            let next = self.inside([at[0] + share * by[0], at[1] + share * by[1]]);
            let moved_mm = (self.at(next).coords - here).norm();
            at = next;
            if moved_mm < SETTLED_MM {
                break;
            }
        }
        least_mm.min((self.at(at) - p).norm())
    }
}

/// Newton's step, in steps of the difference quotients, to where the way `off` to a point is square to the surface; where
/// the squared distance is not convex, without the surface's bend.
fn step(off: Vector3, [by_u, by_v]: [Vector3; 2], [uu, uv, vv]: [Vector3; 3]) -> Option<[f64; 2]> {
    let slope = [off.dot(&by_u), off.dot(&by_v)];
    let flat = [by_u.norm_squared(), by_u.dot(&by_v), by_v.norm_squared()];
    let bent = [flat[0] - off.dot(&uu), flat[1] - off.dot(&uv), flat[2] - off.dot(&vv)];
    let determinant = |[a, b, c]: [f64; 3]| a * c - b * b;
    let is_convex = bent[0] > 0.0 && determinant(bent) > 1e-6 * determinant(flat);
    let [a, b, c] = if is_convex { bent } else { flat };
    let determinant = determinant([a, b, c]);
    (determinant > 0.0)
        .then(|| [(c * slope[0] - b * slope[1]) / determinant, (a * slope[1] - b * slope[0]) / determinant])
}

/// The distance of a point from the lumen's tubes and patches, mm; those farther than `reach_mm` above or below it are not
/// looked at. Infinite where there are none.
pub(super) fn distance_mm(lumen: &Skin, p: Point3, reach_mm: f64) -> f64 {
    let tubes = lumen.tubes.iter().map(|tube| Face::Tube(tube.surface.net()));
    let near = tubes.filter(|face| {
        let [low, high] = face.v_range(p.z, reach_mm);
        low < high
    });
    let beside = |[low, high]: [f64; 2]| low < p.z + reach_mm && high > p.z - reach_mm;
    let slabs = lumen.slabs.iter().filter(|slab| {
        let [a, b] = slab.w_mm.map(|w| slab.z_of(w));
        beside([a.min(b), a.max(b)])
    });
    let patches = slabs.flat_map(|slab| {
        let saddle = match &slab.crotch {
            Crotch::Saddle(saddle) => Some(saddle),
            Crotch::Crease => None,
        };
        slab.laterals.iter().chain(saddle).map(Face::Patch)
    });
    near.chain(patches).map(|face| face.distance_mm(p, reach_mm)).fold(f64::INFINITY, f64::min)
}
