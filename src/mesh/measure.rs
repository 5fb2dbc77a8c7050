//! What a mesh of a solid is worth: how far the surface is from its triangles, and their shape.
//!
//! The deviation is measured, not derived: the surfaces are sampled several times as finely as the mesh, by length on the
//! surface, and each sample's distance to the nearest triangle is taken. Flat caps need no samples: they have their triangles in their plane.

use super::TriMesh;
use super::bvh::Bvh;
use crate::geom::Point3;
use crate::progress::{Cancelled, Task};
use crate::solid::{Crotch, Skin, SkinChoice, Slab, Solid, Tube};
use crate::spline::PatchSurface;
use rayon::prelude::*;
use serde::Serialize;
use std::sync::atomic::{AtomicU64, Ordering};

/// Samples of the surface along a median edge of the mesh.
const SAMPLES_AN_EDGE: f64 = 4.0;
/// Most samples in one direction of a face, and about how many on all of a mesh: rows of slender triangles have short edges
/// one way only, and samples that close both ways take hours.
const MOST: f64 = 20_000.0;
const MOST_OF_ALL: f64 = 4e6;
/// Intervals into which what lies between two sections of a tube, a whole turn and a side of a patch are parted to
/// measure lengths.
const PARTS_A_SECTION: usize = 8;
const PARTS_A_TURN: usize = 256;
const PARTS_A_SIDE: usize = 128;
/// Lines along which they are measured.
const LINES: usize = 32;

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

/// Where the surface is farthest from the triangles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviation {
    /// How far, mm.
    pub mm: f64,
    /// The point of the surface, stack frame, mm.
    pub at: Point3,
}

impl Deviation {
    fn farther(self, other: Self) -> Self {
        if other.mm > self.mm { other } else { self }
    }
}

/// Measures a mesh of a solid's skins. No surface is near to a mesh without triangles.
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
    let (_, mut angles_deg) = shape(mesh);
    Ok(MeasuredMesh {
        deflection_mm,
        n_triangles: mesh.triangles.len(),
        largest_deviation_mm: farthest(solid, skin, mesh, deflection_mm, task)?.mm,
        volume_mm3: mesh.volume_mm3(),
        min_angle_p5_deg: quantile(&mut angles_deg, 0.05),
    })
}

/// The sample of a solid's skins that is farthest from a mesh of them, which should be within the deflection.
///
/// # Errors
/// [`Cancelled`].
pub(super) fn farthest(
    solid: &Solid,
    skin: SkinChoice,
    mesh: &TriMesh,
    deflection_mm: f64,
    task: &Task<'_>,
) -> Result<Deviation, Cancelled> {
    if mesh.triangles.is_empty() {
        return Ok(Deviation { mm: f64::INFINITY, at: Point3::origin() });
    }
    let spacing_mm = spacing_mm(mesh);
    let outer = solid.outer.as_ref().filter(|_| skin == SkinChoice::All);
    let bvh = Bvh::of(mesh);
    let most = Most::default();
    let off = |p: Point3| {
        // What is nearer than the farthest so far need not be known.
        let mm = if bvh.is_within(mesh, p, most.mm()) { 0.0 } else { distance(&bvh, mesh, p, deflection_mm) };
        most.raise(mm);
        Deviation { mm, at: p }
    };
    let mut found = Deviation { mm: 0.0, at: Point3::origin() };
    for face in std::iter::once(&solid.lumen).chain(outer).flat_map(|skin| faces(skin, spacing_mm)) {
        let row = |i: usize| {
            task.check()?;
            Ok(face.row(i).into_iter().map(off).reduce(Deviation::farther))
        };
        let rows: Vec<Result<_, Cancelled>> = (0..face.n_rows()).into_par_iter().map(row).collect();
        for row in rows {
            found = row?.map_or(found, |row| found.farther(row));
        }
    }
    Ok(found)
}

/// The greatest of lengths seen by several threads. The bits of floats that are not negative are in their order.
#[derive(Default)]
struct Most(AtomicU64);

impl Most {
    fn mm(&self) -> f64 {
        f64::from_bits(self.0.load(Ordering::Relaxed))
    }

    fn raise(&self, mm: f64) {
        self.0.fetch_max(mm.max(0.0).to_bits(), Ordering::Relaxed);
    }
}

/// Distance of a point to the mesh; the first try looks no farther than the mesh should be.
fn distance(bvh: &Bvh, mesh: &TriMesh, p: Point3, deflection_mm: f64) -> f64 {
    let near = bvh.nearest(mesh, p, 2.0 * deflection_mm).or_else(|| bvh.nearest(mesh, p, f64::INFINITY));
    near.map_or(f64::INFINITY, |n| n.distance_mm)
}

/// How far apart the samples are that tell what a mesh is worth.
fn spacing_mm(mesh: &TriMesh) -> f64 {
    let fine_mm = quantile(&mut shape(mesh).0, 0.5) / SAMPLES_AN_EDGE;
    fine_mm.max((mesh.area_mm2() / MOST_OF_ALL).sqrt())
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

/// A face to be sampled row by row, at these parameters.
enum Face<'a> {
    Tube { tube: &'a Tube, u: Vec<f64>, z_mm: Vec<f64> },
    Patch { patch: &'a PatchSurface, u: Vec<f64>, v: Vec<f64> },
}

fn faces(skin: &Skin, spacing_mm: f64) -> Vec<Face<'_>> {
    let tubes = skin.tubes.iter().map(|tube| Face::of_tube(tube, spacing_mm));
    let patches = skin.slabs.iter().flat_map(slab_patches).map(|patch| Face::of_patch(patch, spacing_mm));
    tubes.chain(patches).collect()
}

fn slab_patches(slab: &Slab) -> impl Iterator<Item = &PatchSurface> {
    let saddle = match &slab.crotch {
        Crotch::Saddle(saddle) => Some(saddle),
        Crotch::Crease => None,
    };
    slab.laterals.iter().chain(saddle)
}

/// Equal steps from one number to another.
fn steps([low, high]: [f64; 2], n: usize) -> Vec<f64> {
    (0..=n).map(|i| low + (high - low) * i as f64 / n as f64).collect()
}

/// Parameters no farther from each other than `spacing_mm` on the surface: on each line across, whose points at a parameter
/// `across` gives. Between two stops the surface runs about evenly.
fn spread(stops: &[f64], spacing_mm: f64, across: impl Fn(f64) -> Vec<Point3>) -> Vec<f64> {
    let lines: Vec<Vec<Point3>> = stops.iter().map(|&t| across(t)).collect();
    let apart =
        |pair: &[Vec<Point3>]| pair[0].iter().zip(&pair[1]).map(|(p, q)| (q - p).norm()).fold(0.0, f64::max);
    let lengths_mm: Vec<f64> = lines.windows(2).map(apart).collect();
    let spacing_mm = spacing_mm.max(lengths_mm.iter().sum::<f64>() / MOST).max(f64::MIN_POSITIVE);
    let mut parameters = Vec::new();
    for (pair, length_mm) in stops.windows(2).zip(lengths_mm) {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most MOST")]
        let n = (length_mm / spacing_mm).ceil().max(1.0) as usize;
        parameters.extend(steps([pair[0], pair[1]], n).into_iter().take(n));
    }
    parameters.extend(stops.last());
    parameters
}

impl<'a> Face<'a> {
    fn of_tube(tube: &'a Tube, spacing_mm: f64) -> Self {
        let net = tube.surface.net();
        let between = |z: &[f64]| steps([z[0], z[1]], PARTS_A_SECTION).into_iter().take(PARTS_A_SECTION);
        let mut heights: Vec<f64> = tube.surface.section_z_mm().windows(2).flat_map(between).collect();
        heights.extend(tube.surface.section_z_mm().last());
        let (around, turn) = (steps([0.0, 1.0], LINES), steps([0.0, 1.0], PARTS_A_TURN));
        let along = steps(tube.surface.z_range_mm(), LINES);
        let z_mm = spread(&heights, spacing_mm, |z| around.iter().map(|&u| net.at(u, z)).collect());
        let u = spread(&turn, spacing_mm, |u| along.iter().map(|&z| net.at(u, z)).collect());
        Face::Tube { tube, u, z_mm }
    }

    fn of_patch(patch: &'a PatchSurface, spacing_mm: f64) -> Self {
        let [u, v] = [patch.u_range(), patch.v_range()];
        let (across, along) = (steps(u, LINES), steps(v, LINES));
        let rows: Vec<_> = along.iter().map(|&v| patch.row(v)).collect();
        let u = spread(&steps(u, PARTS_A_SIDE), spacing_mm, |u| rows.iter().map(|row| row.at(u)).collect());
        let v = spread(&steps(v, PARTS_A_SIDE), spacing_mm, |v| {
            let row = patch.row(v);
            across.iter().map(|&u| row.at(u)).collect()
        });
        Face::Patch { patch, u, v }
    }

    fn n_rows(&self) -> usize {
        let (Self::Tube { z_mm: rows, .. } | Self::Patch { v: rows, .. }) = self;
        rows.len()
    }

    fn row(&self, i: usize) -> Vec<Point3> {
        match self {
            Self::Tube { tube, u, z_mm } => {
                let (section, z) = (tube.surface.section(z_mm[i]), z_mm[i]);
                u.iter().map(|&u| section.at(u)).map(|p| Point3::new(p.x, p.y, z)).collect()
            }
            Self::Patch { patch, u, v } => {
                let row = patch.row(v[i]);
                u.iter().map(|&u| row.at(u)).collect()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{Contour, Point2, RigidTransform};
    use crate::sections::{PlaneSections, SectionStack};
    use crate::solid::{Body, Params, build};

    /// A tube that widens within two of its twenty millimetres from 2 to 6.
    fn funnel() -> Solid {
        let radius = |z: f64| 4.0 + 2.0 * (2.0 * (z - 10.0)).tanh();
        let plane = |k: u32| {
            let z_mm = 0.5 * f64::from(k);
            PlaneSections { z_mm, contours: vec![Contour::circle(Point2::origin(), radius(z_mm), 128)] }
        };
        let stack = SectionStack {
            planes: (0..41).map(plane).collect(),
            patient_from_stack: RigidTransform::identity(),
        };
        build(&stack, &Params::new(Body::Cast), &Task::quiet()).unwrap().solid
    }

    #[test]
    fn a_mesh_without_triangles_is_near_to_nothing() {
        let found = measure(&funnel(), SkinChoice::All, &TriMesh::default(), 0.01, &Task::quiet()).unwrap();
        assert_eq!((found.n_triangles, found.largest_deviation_mm), (0, f64::INFINITY));
    }

    #[test]
    fn samples_are_as_close_as_asked_on_the_surface_however_flat_it_runs() {
        let solid = funnel();
        let spacing_mm = 0.2;
        let mut n_steep = 0;
        for face in faces(&solid.lumen, spacing_mm) {
            let rows: Vec<Vec<Point3>> = (0..face.n_rows()).map(|i| face.row(i)).collect();
            for pair in rows.windows(2) {
                let along = pair[0].iter().zip(&pair[1]).map(|(p, q)| (q - p).norm());
                let round = pair[0].windows(2).map(|p| (p[1] - p[0]).norm());
                let farthest = along.chain(round).fold(0.0, f64::max);
                assert!(farthest < 1.1 * spacing_mm, "z {}: {farthest}", pair[0][0].z);
                n_steep += usize::from(pair[1][0].z - pair[0][0].z < 0.6 * spacing_mm);
            }
        }
        assert!(n_steep > 10, "{n_steep}");
    }
}
