//! Tessellation of the solid, what is wrong with a mesh, and files for other programs.
//!
//! Every edge (a ring at a waist or a daughter's end, a seam, the rim of a cap) is sampled once and its vertices
//! are shared by the faces on both sides: the mesh is watertight by construction, not by repair. Faces are filled with
//! nearly equilateral triangles, which are divided until every one keeps the deflection; where the triangles of two places
//! meet, both are meshed again more finely.

mod bodies;
mod bvh;
mod cap;
mod chart;
mod check;
pub mod colour;
mod curve;
mod face;
pub mod intersect;
mod keep;
mod lattice;
mod measure;
mod net;
mod plain;
mod remesh;
mod ribbon;
mod rows;
mod slab;
mod sound;
pub mod stl;
pub mod sweep;
mod tessellate;
#[cfg(test)]
mod tests;
pub mod threemf;
mod tube;

pub use bodies::bodies;
pub use check::{Closedness, closedness};
pub use intersect::{Intersection, self_intersections};
pub use measure::{Deviation, MeasuredMesh, measure};
pub use sound::{parted, tessellate};
pub use tessellate::{DEFLECTION_MM, DEFLECTION_RELATIVE, Deflection, Tessellation};

use crate::geom::Point3;
use crate::progress::{Cancelled, Task};

pub use crate::solid::SkinChoice;

/// Triangles over shared vertices, mm; seen from outside their vertices run counter-clockwise.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TriMesh {
    /// Vertices.
    pub vertices: Vec<Point3>,
    /// Indices of the vertices of each triangle.
    pub triangles: Vec<[u32; 3]>,
}

/// No mesh can be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A deflection must be a length.
    #[error(
        "deflection is {0} mm: it must lie between {least} and {most} mm",
        least = DEFLECTION_MM[0], most = DEFLECTION_MM[1]
    )]
    Deflection(f64),
    /// A relative deflection must be a fraction of the size.
    #[error(
        "relative deflection is {0}: it must lie between {least} and {most} of the local radius",
        least = DEFLECTION_RELATIVE[0], most = DEFLECTION_RELATIVE[1]
    )]
    Fraction(f64),
    /// A face cannot be approached by triangles.
    #[error(
        "the surface between z {} and {} mm stays farther from its triangles than the deflection: look at the contours there, or ask for a larger deflection",
        z_mm[0],
        z_mm[1]
    )]
    NotKept {
        /// Lowest and highest z of the face.
        z_mm: [f64; 2],
        /// Middle and radius, mm, of a face between edges that it shares all round: more points on those may help.
        patch: Option<(Point3, f64)>,
    },
    /// All that was sound is farther off.
    #[error(
        "the surface at x {:.3} y {:.3} z {:.3} mm is {:.5} mm from its triangles, more than the deflection of {asked_mm} \
         mm: look at the contours near that height, or ask for a larger deflection",
        found.at.x, found.at.y, found.at.z, found.mm
    )]
    Deviates {
        /// What was asked for, mm.
        asked_mm: f64,
        /// What was found, and where.
        found: Deviation,
    },
    /// More vertices than an index can name.
    #[error("the mesh would have more than 2^32 vertices: ask for a larger deflection")]
    TooLarge,
    /// The rim of a cap cannot be filled.
    #[error(
        "the cap at z {z_mm} mm cannot be triangulated: its rim crosses or touches itself; look at the contour there"
    )]
    Cap {
        /// Height of the cap.
        z_mm: f64,
    },
    /// The work was interrupted.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
    /// The mesh meets itself.
    #[error(
        "the mesh meets itself in {}{n} pair(s) of triangles, the first at x {:.3} y {:.3} z {:.3} mm: nothing was written; ask \
         for a smaller deflection, and look at the contours near that height",
        if *n < intersect::MOST_INTERSECTIONS { "" } else { "at least " }, at.x, at.y, at.z
    )]
    SelfIntersecting {
        /// Pairs of triangles; no more than [`intersect::MOST_INTERSECTIONS`] are counted.
        n: usize,
        /// Where the first of them have a point in common.
        at: Point3,
    },
    /// The mesh has a free, doubled or misoriented edge.
    #[error("the mesh is not closed: {0}")]
    Open(Closedness),
}

/// What a triangle of a solid's mesh bounds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// The lumen: its skin, and its flat ends inside the body.
    Lumen,
    /// The outside of a wall.
    Outer,
    /// A flat end of the body.
    Cap,
}

/// A mesh of a solid, and what is known of it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Parted {
    /// The mesh.
    pub mesh: TriMesh,
    /// What each of its triangles bounds, in their order.
    pub parts: Vec<Part>,
    /// Where the surface is farthest from the triangles, where that is more than the deflection asked for.
    pub deviation: Option<Deviation>,
}

impl Parted {
    /// Takes all triangles that are not taken yet for this part.
    fn fill_up(&mut self, part: Part) {
        self.parts.resize(self.mesh.triangles.len(), part);
    }

    /// The same with another mesh of the same triangles.
    fn with(self, mesh: TriMesh) -> Self {
        Self { mesh, ..self }
    }
}

/// The mesh as files of 32-bit floats hold it, found to be closed and to meet itself nowhere.
///
/// # Errors
/// [`Error::Open`], [`Error::SelfIntersecting`], [`Error::Cancelled`].
pub fn fit_for_files(mesh: &TriMesh, task: &Task<'_>) -> Result<TriMesh, Error> {
    let mesh = closed_in_files(mesh)?;
    let found = self_intersections(&mesh, task)?;
    match found.first() {
        Some(first) => Err(Error::SelfIntersecting { n: found.len(), at: first.at }),
        None => Ok(mesh),
    }
}

/// The mesh as files of 32-bit floats hold it, found to be closed.
fn closed_in_files(mesh: &TriMesh) -> Result<TriMesh, Error> {
    let mesh = mesh.in_single_precision();
    let edges = closedness(&mesh);
    if edges.is_closed() { Ok(mesh) } else { Err(Error::Open(edges)) }
}

impl TriMesh {
    /// Lowest and highest x, y and z of its vertices, mm; infinite, the wrong way round, where there are none.
    #[must_use]
    pub fn extent_mm(&self) -> [[f64; 2]; 3] {
        [0, 1, 2].map(|k| {
            let all = self.vertices.iter().map(|p| p[k]);
            [all.clone().fold(f64::INFINITY, f64::min), all.fold(f64::NEG_INFINITY, f64::max)]
        })
    }

    /// Enclosed volume, mm³ (divergence theorem), positive where triangles face outward.
    #[must_use]
    pub fn volume_mm3(&self) -> f64 {
        // Relative to the first vertex: large coordinates would cost digits.
        let Some(&origin) = self.vertices.first() else { return 0.0 };
        let corner = |i: u32| self.vertices[i as usize] - origin;
        let six_fold: f64 =
            self.triangles.iter().map(|t| corner(t[0]).dot(&corner(t[1]).cross(&corner(t[2])))).sum();
        six_fold / 6.0
    }

    /// Area of all triangles, mm².
    fn area_mm2(&self) -> f64 {
        let doubled = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| self.vertices[i as usize]);
            (b - a).cross(&(c - a)).norm()
        };
        0.5 * self.triangles.iter().map(doubled).sum::<f64>()
    }

    /// The mesh as a file of 32-bit floats holds it: vertices that fall together there are one.
    #[must_use]
    pub fn in_single_precision(&self) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "the precision of the file")]
        let single = |v: f64| v as f32 + 0.0;
        let rounded: Vec<[u32; 3]> =
            self.vertices.iter().map(|p| [single(p.x), single(p.y), single(p.z)].map(f32::to_bits)).collect();
        let mut order: Vec<u32> = (0..).take(rounded.len()).collect();
        order.sort_unstable_by_key(|&i| (rounded[i as usize], i));
        // Each vertex stands for the first one with the same bits.
        let mut first = order.clone();
        for group in order.chunk_by(|&a, &b| rounded[a as usize] == rounded[b as usize]) {
            group.iter().for_each(|&i| first[i as usize] = group[0]);
        }
        let vertices = rounded.iter().map(|bits| {
            let [x, y, z] = bits.map(|b| f64::from(f32::from_bits(b)));
            Point3::new(x, y, z)
        });
        let triangles = self.triangles.iter().map(|t| t.map(|i| first[i as usize])).collect();
        Self { vertices: vertices.collect(), triangles }
    }

    /// Adds a vertex and returns its index.
    ///
    /// # Errors
    /// [`Error::TooLarge`] beyond 2^32 vertices.
    pub(crate) fn push(&mut self, vertex: Point3) -> Result<u32, Error> {
        let index = u32::try_from(self.vertices.len()).or(Err(Error::TooLarge))?;
        self.vertices.push(vertex);
        Ok(index)
    }
}
