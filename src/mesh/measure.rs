//! What a mesh of a solid is worth: how far the surface is from its triangles, and their shape.
//!
//! The deviation is measured, not derived: the surfaces are sampled several times as finely as the mesh, and each sample's
//! distance to the nearest triangle is taken. Flat caps need no samples: they have their triangles in their plane.

use super::bvh::Bvh;
use super::{SkinChoice, TriMesh};
use crate::geom::Point3;
use crate::progress::{Cancelled, Task};
use crate::solid::{Crotch, Skin, Slab, Solid, Tube};
use crate::spline::PatchSurface;
use rayon::prelude::*;
use serde::Serialize;

/// Samples of the surface along a median edge of the mesh.
const SAMPLES_AN_EDGE: f64 = 4.0;
/// Fewest and most samples in one direction of a face.
const FEWEST: f64 = 8.0;
const MOST: f64 = 20_000.0;

/// A mesh in numbers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MeasuredMesh {
    /// The deflection that was asked for, mm.
    pub deflection_mm: f64,
    /// Triangles.
    pub n_triangles: usize,
    /// Farthest that a sample of the surface is from the triangles, mm.
    pub largest_deviation_mm: f64,
    /// Enclosed volume, mm³.
    pub volume_mm3: f64,
    /// Of the triangles' smallest angles the 5th percentile, degrees.
    pub min_angle_p5_deg: f64,
}

impl std::fmt::Display for MeasuredMesh {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { deflection_mm, n_triangles, largest_deviation_mm, volume_mm3, min_angle_p5_deg } = self;
        write!(
            f,
            "deflection {deflection_mm} mm: {n_triangles} triangles, at most {largest_deviation_mm:.5} mm off, \
             {volume_mm3:.2} mm3, smallest angle (5th percentile) {min_angle_p5_deg:.1} deg"
        )
    }
}

/// Measures a mesh of a solid's skins.
///
/// # Errors
/// [`Cancelled`].
pub fn measure(
    solid: &Solid,
    skin: SkinChoice,
    mesh: &TriMesh,
    deflection_mm: f64,
    task: &Task<'_>,
) -> Result<MeasuredMesh, Cancelled> {
    let (mut edges_mm, mut angles_deg) = shape(mesh);
    let spacing_mm = quantile(&mut edges_mm, 0.5) / SAMPLES_AN_EDGE;
    let outer = solid.outer.as_ref().filter(|_| skin == SkinChoice::All);
    let bvh = Bvh::of(mesh);
    let farthest = |points: Vec<Point3>| {
        points.iter().map(|&p| distance(&bvh, mesh, p, deflection_mm)).fold(0.0, f64::max)
    };
    let mut largest_deviation_mm: f64 = 0.0;
    for skin in std::iter::once(&solid.lumen).chain(outer) {
        for face in faces(skin, spacing_mm) {
            let row = |i: usize| {
                task.check()?;
                Ok(farthest(face.row(i)))
            };
            let rows: Vec<Result<f64, Cancelled>> = (0..face.n_rows()).into_par_iter().map(row).collect();
            for deviation in rows {
                largest_deviation_mm = largest_deviation_mm.max(deviation?);
            }
        }
    }
    Ok(MeasuredMesh {
        deflection_mm,
        n_triangles: mesh.triangles.len(),
        largest_deviation_mm,
        volume_mm3: mesh.volume_mm3(),
        min_angle_p5_deg: quantile(&mut angles_deg, 0.05),
    })
}

/// Which triangles of a mesh lie on another surface: their middles are no farther from it than `within_mm`.
#[must_use]
pub fn triangles_on(mesh: &TriMesh, surface: &TriMesh, within_mm: f64) -> Vec<bool> {
    if surface.triangles.is_empty() {
        return vec![false; mesh.triangles.len()];
    }
    let bvh = Bvh::of(surface);
    let is_on = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| mesh.vertices[v as usize].coords);
        bvh.nearest(surface, ((a + b + c) / 3.0).into(), within_mm).is_some()
    };
    mesh.triangles.par_iter().map(is_on).collect()
}

/// Distance of a point to the mesh; the first try looks no farther than the mesh should be.
fn distance(bvh: &Bvh, mesh: &TriMesh, p: Point3, deflection_mm: f64) -> f64 {
    let near = bvh.nearest(mesh, p, 2.0 * deflection_mm).or_else(|| bvh.nearest(mesh, p, f64::INFINITY));
    near.map_or(f64::INFINITY, |n| n.distance_mm)
}

/// Lengths of all edges, mm, and the smallest angle of each triangle, degrees.
fn shape(mesh: &TriMesh) -> (Vec<f64>, Vec<f64>) {
    let of = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| mesh.vertices[v as usize]);
        let sides = [(b - a).norm(), (c - b).norm(), (a - c).norm()];
        let doubled_area = (b - a).cross(&(c - a)).norm();
        // The smallest angle lies between the two longer sides.
        let product = sides[0] * sides[1] * sides[2] / sides.iter().copied().fold(f64::INFINITY, f64::min);
        (sides, (doubled_area / product).min(1.0).asin().to_degrees())
    };
    let (sides, angles): (Vec<_>, Vec<_>) = mesh.triangles.par_iter().map(of).unzip();
    (sides.into_iter().flatten().collect(), angles)
}

/// The value below which this part of the values lies; 0 where there are none.
fn quantile(values: &mut [f64], part: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
    let k = ((values.len() - 1) as f64 * part).round() as usize;
    *values.select_nth_unstable_by(k, f64::total_cmp).1
}

/// A face to be sampled row by row.
enum Face<'a> {
    Tube { tube: &'a Tube, n: [usize; 2] },
    Patch { patch: &'a PatchSurface, n: [usize; 2] },
}

fn faces(skin: &Skin, spacing_mm: f64) -> Vec<Face<'_>> {
    let tubes = skin.tubes.iter().map(|tube| {
        let [low, high] = tube.surface.z_range_mm();
        let round = [low, 0.5 * (low + high), high].map(|z| perimeter_mm(&tube.surface.section(z).points()));
        let longest = round.into_iter().fold(0.0, f64::max);
        Face::Tube { tube, n: [count(longest, spacing_mm), count(high - low, spacing_mm)] }
    });
    let patches = skin.slabs.iter().flat_map(slab_patches).map(|patch| {
        let along = patch.row(patch.v_range()[0]);
        let [u0, u1] = patch.u_range();
        let points: Vec<Point3> = (0..=32).map(|i| along.at(u0 + (u1 - u0) * f64::from(i) / 32.0)).collect();
        let length: f64 = points.windows(2).map(|p| (p[1] - p[0]).norm()).sum();
        let up = (patch.at(u0, patch.v_range()[1]) - patch.at(u0, patch.v_range()[0])).norm();
        Face::Patch { patch, n: [count(length, spacing_mm), count(up, spacing_mm)] }
    });
    tubes.chain(patches).collect()
}

fn slab_patches(slab: &Slab) -> impl Iterator<Item = &PatchSurface> {
    let saddle = match &slab.crotch {
        Crotch::Saddle(saddle) => Some(saddle),
        Crotch::Crease => None,
    };
    slab.laterals.iter().chain(saddle)
}

fn perimeter_mm(points: &[crate::geom::Point2]) -> f64 {
    crate::geom::Contour::new(points.to_vec()).perimeter_mm()
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
fn count(length_mm: f64, spacing_mm: f64) -> usize {
    (length_mm / spacing_mm).ceil().clamp(FEWEST, MOST) as usize
}

impl Face<'_> {
    fn n_rows(&self) -> usize {
        let (Self::Tube { n, .. } | Self::Patch { n, .. }) = self;
        n[1] + 1
    }

    fn row(&self, i: usize) -> Vec<Point3> {
        let at = |[low, high]: [f64; 2], i: usize, n: usize| low + (high - low) * i as f64 / n as f64;
        match self {
            Self::Tube { tube, n } => {
                let z = at(tube.surface.z_range_mm(), i, n[1]);
                let section = tube.surface.section(z);
                (0..n[0])
                    .map(|k| section.at(k as f64 / n[0] as f64))
                    .map(|p| Point3::new(p.x, p.y, z))
                    .collect()
            }
            Self::Patch { patch, n } => {
                let row = patch.row(at(patch.v_range(), i, n[1]));
                (0..=n[0]).map(|k| row.at(at(patch.u_range(), k, n[0]))).collect()
            }
        }
    }
}
