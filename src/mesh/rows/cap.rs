//! Flat caps: a rim with holes filled by ear clipping (through `geo`), no vertices added.
//!
//! Ear clipping passes over vertices on a straight line, but every vertex of a rim is shared with the tube below
//! it. Where that happens the rim is clipped once more with its vertices moved by a nanometre; the mesh keeps the true
//! places.

use crate::mesh::{Error, TriMesh};
use geo::{Coord, LineString, Polygon, TriangulateEarcut};

/// A closed row of vertices, counter-clockwise seen from above.
pub(super) type Rim = Vec<u32>;

/// How far vertices are moved so that no three of them lie on a line, mm: below what a file of 32-bit floats holds.
const SHAKE_MM: f64 = 1e-6;

/// Fills the region inside `outer` and outside `holes`, all at one height; the normals point up, or down with
/// `downward`.
pub(super) fn fill(mesh: &mut TriMesh, outer: &Rim, holes: &[Rim], downward: bool) -> Result<(), Error> {
    let z_mm = mesh.vertices[outer[0] as usize].z;
    let n_expected = outer.len() + holes.iter().map(|h| h.len() + 2).sum::<usize>() - 2;
    let mut triangles = [0.0, SHAKE_MM]
        .into_iter()
        .map(|shake_mm| clipped(mesh, outer, holes, shake_mm))
        .find(|triangles| triangles.len() == n_expected)
        .ok_or(Error::Cap { z_mm })?;
    // The clipping turns all triangles the same way round; single ones may have no area to tell it by.
    let doubled_area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| mesh.vertices[v as usize].xy());
        (b - a).perp(&(c - a))
    };
    if (triangles.iter().map(doubled_area).sum::<f64>() > 0.0) == downward {
        triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    mesh.triangles.extend(triangles);
    Ok(())
}

fn clipped(mesh: &TriMesh, outer: &Rim, holes: &[Rim], shake_mm: f64) -> Vec<[u32; 3]> {
    let line = |rim: &Rim| -> LineString<f64> {
        let coord = |&v: &u32| {
            let p = mesh.vertices[v as usize];
            let (dx, dy) = ((f64::from(v) * 12.9898).sin(), (f64::from(v) * 78.233).sin());
            Coord { x: p.x + shake_mm * dx, y: p.y + shake_mm * dy }
        };
        rim.iter().map(coord).collect()
    };
    let polygon = Polygon::new(line(outer), holes.iter().map(line).collect());
    // The triangulation counts vertices ring by ring, closing points left out.
    let order: Vec<u32> = std::iter::once(outer).chain(holes).flatten().copied().collect();
    let indices = polygon.earcut_triangles_raw().triangle_indices;
    indices.chunks_exact(3).map(|t| [order[t[0]], order[t[1]], order[t[2]]]).collect()
}
