//! One tube's triangles: rows of the lattice, joined row by row, then measured and mended.

use super::Error;
use super::chart::{Allowed, Chart};
use super::curve::{CHORD_SHARE, sag};
use super::face::{Corner, Face};
use super::keep::keep;
use super::lattice::{Profile, Row};
use super::remesh;
use super::ribbon::{Station, between_rings};
use crate::geom::{Point2, Point3};
use crate::progress::Task;
use crate::spline::TubeNet;

/// Most vertices of a cap's rim.
const MOST_RIM: usize = 50_000;

/// A vertex of a ring that is shared with a slab.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct RingVertex {
    /// Parameter round the tube, in [0, 1).
    pub(super) u: f64,
    /// Number in the whole mesh.
    pub(super) vertex: u32,
    pub(super) point: Point3,
}

/// A ring that is shared with a slab, in the direction of the tube's parameter.
pub(super) type SharedRing = Vec<RingVertex>;

/// A tube's triangles and the rings at its ends as indices of its corners; a ring of one is the tip of a dome.
#[derive(Debug)]
pub(super) struct MeshedTube<'a> {
    pub(super) face: Face<'a>,
    pub(super) ends: [Vec<u32>; 2],
    /// Whether the deflection is kept.
    pub(super) is_kept: bool,
}

/// The vertices and triangles of a tube while they are laid out.
struct Layout<'n> {
    chart: &'n Chart,
    profile: Profile,
    corners: Vec<Corner>,
    places: Vec<Point3>,
    triangles: Vec<[u32; 3]>,
}

/// Meshes a tube between the given rings; where one is missing the tube ends in a cap and gets a ring of its own.
pub(super) fn mesh_tube<'a>(
    chart: &'a Chart,
    net: &TubeNet<'_>,
    allowed: &Allowed<'_>,
    shared: [Option<SharedRing>; 2],
    task: &Task<'_>,
) -> Result<MeshedTube<'a>, Error> {
    let profile = Profile::of(net, allowed);
    let mut layout =
        Layout { chart, profile, corners: Vec::new(), places: Vec::new(), triangles: Vec::new() };
    let points = layout.profile.ends_in_points();
    let points = [0, 1].map(|k| points[k] && shared[k].is_none());
    let [bottom, top] = shared;
    let [low, high] = net.z_range_mm();
    let mut end = |ring: Option<SharedRing>, k: usize, z: f64| match ring {
        Some(ring) => layout.shared_ring(&ring, z),
        None if points[k] => layout.point(z),
        None => layout.end_ring(k == 1, z, allowed),
    };
    let (bottom, top) = (end(bottom, 0, low)?, end(top, 1, high)?);
    let mut below = bottom.clone();
    for row in layout.profile.rows(points) {
        task.check()?;
        let ring = layout.row(&row)?;
        layout.join(&below, &ring);
        below = ring;
    }
    layout.join(&below, &top);
    let ends = [&bottom, &top].map(|ring| ring.iter().map(|s| s.vertex).collect());
    let mut face = Face::new(chart, layout.corners, layout.triangles);
    face.flip_everywhere();
    remesh::smooth_everywhere(&mut face, 2);
    let is_kept = keep(&mut face, allowed, task)?;
    Ok(MeshedTube { face, ends, is_kept })
}

impl Layout<'_> {
    fn add(&mut self, corner: Corner) -> Result<Station, Error> {
        let vertex = u32::try_from(self.corners.len()).or(Err(Error::TooLarge))?;
        self.corners.push(corner);
        self.places.push(corner.point);
        Ok(Station { u: corner.param.x, v: corner.param.y, vertex })
    }

    fn at(&mut self, u: f64, z: f64) -> Result<Station, Error> {
        let u = u.rem_euclid(1.0);
        let (param, point) = (Point2::new(u, z), self.chart.at(Point2::new(u, z)));
        self.add(Corner { param, point, is_pole: false, shared: None })
    }

    /// A slab's ring.
    fn shared_ring(&mut self, ring: &SharedRing, z: f64) -> Result<Vec<Station>, Error> {
        let corner = |v: &RingVertex| Corner {
            param: Point2::new(v.u, z),
            point: v.point,
            is_pole: false,
            shared: Some(v.vertex),
        };
        ring.iter().map(|v| self.add(corner(v))).collect()
    }

    /// The tip of a dome: the middle of its tiny section.
    fn point(&mut self, z: f64) -> Result<Vec<Station>, Error> {
        let sum: nalgebra::Vector3<f64> =
            (0..8).map(|i| self.chart.at(Point2::new(f64::from(i) / 8.0, z)).coords).sum();
        let corner =
            Corner { param: Point2::new(0.0, z), point: (sum / 8.0).into(), is_pole: true, shared: None };
        Ok(vec![self.add(corner)?])
    }

    /// A plain ring whose chords keep the deflection: the rim of a cap.
    fn end_ring(&mut self, is_top: bool, z: f64, allowed: &Allowed<'_>) -> Result<Vec<Station>, Error> {
        let steps = if is_top { f64::INFINITY } else { 0.0 };
        let mut n = self.profile.end_columns(is_top);
        loop {
            let u: Vec<f64> = (0..n).map(|k| self.profile.u(steps, k as f64 / n as f64)).collect();
            let curve = |u: f64| self.chart.at(Point2::new(u, z));
            let is_kept = |k: usize| {
                let next = if k + 1 == n { 1.0 + u[0] } else { u[k + 1] };
                sag(&curve, u[k], next) <= CHORD_SHARE * allowed.at(curve(0.5 * (u[k] + next)))
            };
            if n > MOST_RIM || (0..n).all(is_kept) {
                return u.into_iter().map(|u| self.at(u, z)).collect();
            }
            n += 2 * (n / 24 + 1);
        }
    }

    fn row(&mut self, row: &Row) -> Result<Vec<Station>, Error> {
        let lift = |k: usize| match (row.is_staggered, k % 2) {
            (false, _) => row.step,
            (true, 0) => row.step - 0.25,
            (true, _) => row.step + 0.25,
        };
        let turn = if row.is_turned { 0.5 } else { 0.0 };
        let heights = [lift(0), lift(1)].map(|s| self.profile.z_mm(s));
        let columns = |steps: &dyn Fn(usize) -> f64| -> Vec<f64> {
            (0..row.n).map(|k| self.profile.u(steps(k), (k as f64 + turn) / row.n as f64)).collect()
        };
        let mut u = columns(&lift);
        // Where columns run together within a row's height, those at its middle are in order.
        if u.windows(2).any(|pair| pair[1] <= pair[0]) || u[row.n - 1] >= 1.0 + u[0] {
            u = columns(&|_| row.step);
        }
        u.into_iter().enumerate().map(|(k, u)| self.at(u, heights[k % 2])).collect()
    }

    fn join(&mut self, lower: &[Station], upper: &[Station]) {
        match (lower, upper) {
            ([tip], ring) => {
                let n = ring.len();
                self.triangles.extend((0..n).map(|k| [tip.vertex, ring[(k + 1) % n].vertex, ring[k].vertex]));
            }
            (ring, [tip]) => {
                let n = ring.len();
                self.triangles.extend((0..n).map(|k| [ring[k].vertex, ring[(k + 1) % n].vertex, tip.vertex]));
            }
            _ => between_rings(lower, upper, &self.places, &mut self.triangles),
        }
    }
}
