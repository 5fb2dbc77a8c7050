//! Makes welded patches meet their neighbours with common normals.
//!
//! Patches, tubes and rings interpolate one field, so that normals agree as far as splines through its points do: in
//! the notches at A, B, P, Q, which bend over less than a tenth of a millimetre, that is some degrees. What is left is
//! taken out here: across each border the derivative of a patch is given the component along the neighbour's normal
//! that it lacks (tangent plane continuity; G. Farin, "Curves and Surfaces for CAGD", ch. 21), at all sites of the
//! border's basis, by moving the row of control points beside the border; borders stay.
//!
//! A lateral follows the tubes along its rings; heights of its rows stay. The saddle follows the laterals along its
//! seams. At a corner the two seams ask for one twist, in which the laterals agree only as far as their second
//! derivatives do: both pairs of seams share it. The row is near to the border there, so that patches move by less
//! than a micrometre, and the twist that is left turns normals by tenths of a degree.

use crate::geom::{Vector2, Vector3};
use crate::spline::{Basis, PatchSurface, SectionCurve, TubeSurface};

/// Passes over the pairs of opposite seams of a saddle.
const PASSES: usize = 2;
/// Most slope that is added to a patch: more is a fault of the patch, and would fold it.
pub(super) const MOST_SLOPE: f64 = 1.0;

/// The end of a tube: its section and how that leans.
#[derive(Debug, Clone)]
pub(super) struct Leaning {
    pub(super) section: SectionCurve,
    /// Derivative of the section by z.
    pub(super) slope: SectionCurve,
}

impl Leaning {
    pub(super) fn of(tube: &TubeSurface, z_mm: f64) -> Self {
        Self { section: tube.section(z_mm), slope: tube.section_slope(z_mm) }
    }
}

/// The control row beside the first or last one of a basis, and what a slope of 1 there moves it by.
fn beside(basis: &Basis, at_last: bool) -> (usize, f64) {
    let sites = basis.greville();
    let end = if at_last { sites.len() - 1 } else { 0 };
    let row = if at_last { end - 1 } else { 1 };
    (row, sites[row] - sites[end])
}

/// The lateral with the slopes of the tubes at its first and last row, which run over the given ranges of their rings.
/// At most `most_slope` is added.
pub(super) fn leaned(
    lateral: &PatchSurface,
    ends: [(&Leaning, [f64; 2]); 2],
    most_slope: f64,
) -> PatchSurface {
    let [u, v] = lateral.bases();
    let sites = u.over([0.0, 1.0]).greville();
    let added = [0, 1].map(|k| {
        let (ring, [a, b]) = ends[k];
        let slope = lateral.row_slope(v.range()[k]);
        let lacking = u.greville().into_iter().zip(&sites).flat_map(|(at, &share)| {
            let place = (a + (b - a) * share).rem_euclid(1.0);
            let along = ring.section.derivative_at(place).try_normalize(1e-12).unwrap_or_default();
            let normal = Vector2::new(along.y, -along.x);
            let own = slope.at(at).coords;
            let lacks = (ring.slope.at(place).coords * own.z - own.xy()).dot(&normal);
            let by = normal * lacks.clamp(-most_slope, most_slope);
            [by.x, by.y]
        });
        u.interpolate(&u.greville(), &lacking.collect::<Vec<_>>(), 2)
    });
    let rows = [false, true].map(|at_last| beside(v, at_last));
    let n = u.len();
    let points: Vec<_> = lateral
        .control()
        .enumerate()
        .map(|(k, mut point)| {
            let (i, j) = (k % n, k / n);
            for (added, (_, by)) in added.iter().zip(&rows).filter(|(_, (row, _))| *row == j) {
                point.x += added[2 * i] * by;
                point.y += added[2 * i + 1] * by;
            }
            point
        })
        .collect();
    PatchSurface::with_control(u.clone(), v.clone(), &points)
}

/// Normals along a border, by the share of the way along it.
pub(super) type Normals<'a> = &'a dyn Fn(f64) -> Vector3;

/// The normals of a lateral along its first or last column, from low to high v or back.
pub(super) fn normals_of(lateral: &PatchSurface, is_last: bool, is_back: bool) -> impl Fn(f64) -> Vector3 {
    let u = lateral.u_range()[usize::from(is_last)];
    let [low, high] = lateral.v_range();
    move |share| {
        let jet = lateral.jet(u, low + (high - low) * if is_back { 1.0 - share } else { share });
        jet.by_u.cross(&jet.by_v).try_normalize(1e-300).unwrap_or_default()
    }
}

/// The saddle with the given normals along its borders: v first and last, u first and last.
pub(super) fn followed(saddle: &PatchSurface, normals: [Normals<'_>; 4]) -> PatchSurface {
    let [first, last] = [[normals[0], normals[1]], [normals[2], normals[3]]];
    let mut patch = saddle.clone();
    for _ in 0..PASSES {
        patch = follow_pair(&follow_pair(&patch, false, first), true, last);
    }
    // Neither pair has the last word on the corners' twist.
    let other = follow_pair(&patch, false, first);
    let [u, v] = patch.bases();
    let points: Vec<_> =
        patch.control().zip(other.control()).map(|(p, q)| nalgebra::center(&p, &q)).collect();
    PatchSurface::with_control(u.clone(), v.clone(), &points)
}

/// One pass over the borders at the first and last v (or u, where the patch is `across`).
fn follow_pair(patch: &PatchSurface, across: bool, normals: [Normals<'_>; 2]) -> PatchSurface {
    let [u, v] = patch.bases();
    let (along, over) = if across { (v, u) } else { (u, v) };
    let (sites, shares) = (along.greville(), along.over([0.0, 1.0]).greville());
    let last = sites.len() - 1;
    let added = [0, 1].map(|end| {
        let border = over.range()[end];
        let lacking = sites.iter().zip(&shares).enumerate().flat_map(|(k, (&site, &at))| {
            if k == 0 || k == last {
                return [0.0; 3];
            }
            let jet = if across { patch.jet(border, site) } else { patch.jet(site, border) };
            let normal = normals[end](at);
            let slope = if across { jet.by_u } else { jet.by_v };
            (-normal * slope.dot(&normal)).into()
        });
        along.interpolate(&sites, &lacking.collect::<Vec<_>>(), 3)
    });
    let rows = [false, true].map(|at_last| beside(over, at_last));
    let (n, m) = (u.len(), v.len());
    let points: Vec<_> = patch
        .control()
        .enumerate()
        .map(|(k, mut point)| {
            let (i, j) = (k % n, k / n);
            if i > 0 && j > 0 && i + 1 < n && j + 1 < m {
                let (along, over) = if across { (j, i) } else { (i, j) };
                for (added, (_, by)) in added.iter().zip(&rows).filter(|(_, (row, _))| *row == over) {
                    point += Vector3::from_column_slice(&added[3 * along..3 * along + 3]) * *by;
                }
            }
            point
        })
        .collect();
    PatchSurface::with_control(u.clone(), v.clone(), &points)
}
