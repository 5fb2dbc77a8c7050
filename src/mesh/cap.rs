//! Flat caps: a rim with holes filled by ear clipping (through `geo`), no vertices added.

use super::{Error, TriMesh};
use geo::{Coord, LineString, Polygon, TriangulateEarcut};

/// A closed row of vertices, counter-clockwise seen from above.
pub(super) type Rim = Vec<u32>;

/// Fills the region inside `outer` and outside `holes`, all at one height; the normals point up, or down with
/// `downward`.
pub(super) fn fill(mesh: &mut TriMesh, outer: &Rim, holes: &[Rim], downward: bool) -> Result<(), Error> {
    let line = |rim: &Rim| -> LineString<f64> {
        rim.iter()
            .map(|&v| {
                let p = mesh.vertices[v as usize];
                Coord { x: p.x, y: p.y }
            })
            .collect()
    };
    let polygon = Polygon::new(line(outer), holes.iter().map(line).collect());
    let raw = polygon.earcut_triangles_raw();
    // The triangulation counts vertices ring by ring, each with its closing point repeated.
    let closed = |rim: &Rim| rim.iter().copied().chain(rim.first().copied()).collect::<Vec<u32>>();
    let order: Vec<u32> = std::iter::once(outer).chain(holes).flat_map(closed).collect();
    let z_mm = mesh.vertices[outer[0] as usize].z;
    let n_expected = outer.len() + holes.iter().map(|h| h.len() + 2).sum::<usize>() - 2;
    let mut triangles = Vec::with_capacity(n_expected);
    for t in raw.triangle_indices.chunks_exact(3) {
        let mut triangle = [order[t[0]], order[t[1]], order[t[2]]];
        let [a, b, c] = triangle.map(|v| mesh.vertices[v as usize].xy());
        let up = (b - a).perp(&(c - a)) > 0.0;
        if up == downward {
            triangle.swap(1, 2);
        }
        triangles.push(triangle);
    }
    if triangles.len() != n_expected {
        return Err(Error::Cap { z_mm });
    }
    mesh.triangles.extend(triangles);
    Ok(())
}
