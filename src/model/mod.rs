//! Models that other programs made, as triangle meshes.
//!
//! [`stl`] and [`threemf`] take the file apart; here its corners are welded and everything is put into one order: vertices by their
//! coordinates, triangles by their vertices. The same triangles in any order of the file are the same [`Model`], bit for
//! bit, and so is all that is made of it.
//!
//! Corners are one vertex where their bits are (-0.0 and 0.0 are one), and at open edges where they all but coincide
//! (`seams`); both that and edges that stay open are told. Nothing is rotated, scaled or moved. Triangles that face the other
//! way than their neighbours are turned (`orient`), and so is a mesh that faces inward; both is said. So are copies of triangles,
//! which are dropped (`doubles`).
//!
//! Cost: O(n log n), by parallel sorting.

mod doubles;
mod orient;
mod package;
mod seams;
pub mod stl;
pub mod threemf;

pub use package::PackageError;

use crate::ct::Warning;
use crate::geom::Point3;
use crate::mesh::TriMesh;
use crate::units::counted;
use orient::Turned;
use rayon::prelude::*;
use seams::Seams;

/// A triangle as files hold it: three corners in 32-bit floats, mm, counter-clockwise from outside.
pub type Facet = [[f32; 3]; 3];

/// Farthest that a coordinate may lie from the origin, mm: what is farther out was not meant in millimetres, and is more
/// than the integer grid of boolean operations holds.
const FARTHEST_MM: f32 = 5000.0;

/// What is wrong with a model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The file is no STL.
    #[error(transparent)]
    Stl(#[from] stl::StlError),
    /// The file is no 3MF.
    #[error(transparent)]
    ThreeMf(#[from] threemf::ThreeMfError),
    /// It is named as a 3MF.
    #[error("it is no 3MF, which is a zip archive: export the model again")]
    NoPackage,
    /// There is nothing in it.
    #[error("it holds no triangle: export the model again")]
    Empty,
    /// A coordinate is no number, or no length in mm.
    #[error(
        "triangle {facet} has a corner at ({}, {}, {}): expected numbers within {FARTHEST_MM} mm; are the units millimetres?",
        at_mm[0], at_mm[1], at_mm[2]
    )]
    Coordinate {
        /// The triangle, counted from 0 in the file.
        facet: usize,
        /// The corner, mm.
        at_mm: [f32; 3],
    },
    /// All triangles lie in one plane.
    #[error("it encloses no volume: a solid body is needed")]
    Flat,
    /// More vertices than can be numbered.
    #[error("it has more than four thousand million corners: reduce the mesh")]
    TooLarge,
}

/// A mesh in the order that does not depend on the file's.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// The triangles, mm; corners run counter-clockwise seen from outside.
    pub mesh: TriMesh,
    /// What was odd.
    pub warnings: Vec<Warning>,
}

/// What a file holds.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Contents {
    /// The triangles of all that is to be printed.
    pub facets: Vec<Facet>,
    /// What was left out.
    pub warnings: Vec<Warning>,
}

/// The triangles of a file, STL or 3MF by how it begins.
///
/// # Errors
/// [`Error`] where it is neither.
pub fn read(bytes: &[u8]) -> Result<Contents, Error> {
    if threemf::is_package(bytes) {
        Ok(threemf::read(bytes)?)
    } else {
        Ok(Contents { facets: stl::read(bytes)?, warnings: Vec::new() })
    }
}

impl Model {
    /// Welds facets.
    ///
    /// # Errors
    /// [`Error`] where there is nothing, where a coordinate cannot be used, or where the mesh encloses nothing.
    pub fn of(facets: &[Facet]) -> Result<Self, Error> {
        check(facets)?;
        let mut mesh = welded(facets)?;
        let mut warnings = Vec::new();
        let n_flat = facets.len() - mesh.triangles.len();
        if n_flat > 0 {
            let text = format!("{n_flat} triangle(s) without area were left out");
            warnings.push(Warning::new("model.flat_triangles", text));
        }
        let n_doubled = doubles::dropped(&mut mesh);
        if n_doubled > 0 {
            let text = format!(
                "{} that the file holds more than once {} dropped",
                counted(n_doubled, "triangle"),
                if n_doubled == 1 { "was" } else { "were" }
            );
            warnings.push(Warning::new("model.doubled", text));
        }
        let Seams { n_joined, n_open, n_torn } = seams::joined(&mut mesh);
        if n_joined > 0 {
            let text =
                format!("{n_joined} corner(s) at open edges were joined with others less than 0.01 mm away");
            warnings.push(Warning::new("model.corners_joined", text));
        }
        if n_open > 0 {
            let text = format!(
                "the surface is open: {n_open} edge(s) have a triangle on one side only; what is missing there is closed layer by layer, \
                 or not seen: repair the model"
            );
            warnings.push(Warning::new("model.open", text));
        }
        let turned = if n_torn > 0 { orient::oriented(&mut mesh) } else { Turned::default() };
        let volume_mm3 = mesh.volume_mm3();
        if volume_mm3.is_nan() || volume_mm3 == 0.0 {
            return Err(Error::Flat);
        }
        warnings.extend(facing(&mut mesh, turned, volume_mm3 < 0.0));
        Ok(Self { mesh, warnings })
    }

    /// The model turned about an axis through the origin by an angle, right-handed.
    #[must_use]
    pub fn turned(mut self, axis: Axis, angle_deg: f64) -> Self {
        let angle = angle_deg.to_radians();
        let (sin, cos) = angle.sin_cos();
        let [i, j] = axis.plane();
        self.mesh.vertices.par_iter_mut().for_each(|p| {
            let (a, b) = (p[i], p[j]);
            p[i] = cos * a - sin * b;
            p[j] = sin * a + cos * b;
        });
        self
    }
}

/// An axis of the model's frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    /// To the right.
    X,
    /// To the back.
    Y,
    /// Up.
    Z,
}

impl Axis {
    /// The coordinates that turn about it, the first towards the second.
    const fn plane(self) -> [usize; 2] {
        match self {
            Self::X => [1, 2],
            Self::Y => [2, 0],
            Self::Z => [0, 1],
        }
    }
}

fn check(facets: &[Facet]) -> Result<(), Error> {
    if facets.is_empty() {
        return Err(Error::Empty);
    }
    // Written so that what is no number is caught too.
    let is_good = |corner: &[f32; 3]| corner.iter().all(|c| c.abs() <= FARTHEST_MM);
    let bad = facets.par_iter().enumerate().find_map_first(|(facet, corners)| {
        let bad = corners.iter().find(|c| !is_good(c))?;
        Some(Error::Coordinate { facet, at_mm: *bad })
    });
    bad.map_or(Ok(()), Err)
}

/// The order of numbers as an order of bits.
fn ordered(value: f32) -> u32 {
    // -0.0 + 0.0 is 0.0.
    let bits = (value + 0.0).to_bits();
    if bits >> 31 == 1 { !bits } else { bits | 0x8000_0000 }
}

/// Turns a mesh inside out where it encloses less than nothing, and tells what has been turned in all.
fn facing(mesh: &mut TriMesh, turned: Turned, is_inward: bool) -> Vec<Warning> {
    let (n, Turned { mut n_turned, n_torn }) = (mesh.triangles.len(), turned);
    let mut warnings = Vec::new();
    if is_inward {
        n_turned = n - n_turned;
        let all = if n_turned == n && orient::all_face_inward(mesh) {
            "all surfaces faced inward"
        } else {
            "most of the surface faced inward"
        };
        mesh.triangles.par_iter_mut().for_each(|t| t.swap(1, 2));
        mesh.triangles.par_sort_unstable();
        warnings.push(Warning::new("model.inverted", format!("{all}: the model was turned inside out")));
    } else if n_turned > 0 {
        let text =
            format!("{n_turned} of {n} triangles faced the other way than their neighbours and were turned");
        warnings.push(Warning::new("model.turned", text));
    }
    if n_torn > 0 {
        let text = format!(
            "at {n_torn} edge(s) the triangles face different ways and cannot be turned to agree, as the surface has one side only or more \
             than two triangles meet there; what is missing there is closed layer by layer, or not seen: repair the model"
        );
        warnings.push(Warning::new("model.one_sided", text));
    }
    warnings
}

/// The edges of a triangle in its direction.
const fn edges(t: &[u32; 3]) -> [[u32; 2]; 3] {
    [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]]
}

fn welded(facets: &[Facet]) -> Result<TriMesh, Error> {
    let n_corners = u32::try_from(3 * facets.len()).or(Err(Error::TooLarge))?;
    let at = |corner: u32| &facets[corner as usize / 3][corner as usize % 3];
    let mut corners: Vec<([u32; 3], u32)> =
        (0..n_corners).into_par_iter().map(|corner| (at(corner).map(ordered), corner)).collect();
    corners.par_sort_unstable();
    let mut vertex_of = vec![0_u32; corners.len()];
    let mut vertices: Vec<Point3> = Vec::with_capacity(facets.len() / 2 + 2);
    let mut before = None;
    for &(key, corner) in &corners {
        if before != Some(key) {
            before = Some(key);
            vertices.push(Point3::from(at(corner).map(|c| f64::from(c + 0.0))));
        }
        #[expect(clippy::cast_possible_truncation, reason = "no more vertices than corners")]
        let vertex = vertices.len() as u32 - 1;
        vertex_of[corner as usize] = vertex;
    }
    drop(corners);
    let mut triangles: Vec<[u32; 3]> =
        vertex_of.par_chunks_exact(3).map(|t| from_least([t[0], t[1], t[2]])).filter(has_area).collect();
    triangles.par_sort_unstable();
    Ok(TriMesh { vertices, triangles })
}

/// The same triangle, its least vertex first.
fn from_least([a, b, c]: [u32; 3]) -> [u32; 3] {
    if a <= b && a <= c {
        [a, b, c]
    } else if b <= a && b <= c {
        [b, c, a]
    } else {
        [c, a, b]
    }
}

const fn has_area([a, b, c]: &[u32; 3]) -> bool {
    *a != *b && *b != *c && *a != *c
}

#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
