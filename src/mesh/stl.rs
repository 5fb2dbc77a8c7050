//! A mesh as binary STL: 80 bytes of heading, the number of triangles, 50 bytes a triangle.
//!
//! Coordinates are 32-bit floats: vertices that are one in the mesh stay one bit pattern in the file, because the
//! rounding depends on the coordinate alone; -0.0 is written as 0.0. STL knows no unit: the heading names it, and does not
//! begin with the word that marks the format's text form.

use super::{Error, TriMesh};
use crate::geom::Point3;
use rayon::prelude::*;

const HEADING_BYTES: usize = 80;
const TRIANGLE_BYTES: usize = 50;
/// Triangles that a thread writes at once.
const BLOCK: usize = 4096;
const HEADING: &str = concat!("lumenfab ", env!("CARGO_PKG_VERSION"), ", binary STL, units: mm");

/// The file's bytes.
///
/// # Errors
/// [`Error::TooLarge`] beyond 2^32 triangles.
pub fn to_bytes(mesh: &TriMesh) -> Result<Vec<u8>, Error> {
    let n = u32::try_from(mesh.triangles.len()).or(Err(Error::TooLarge))?;
    let start = HEADING_BYTES + size_of::<u32>();
    let mut bytes = vec![0; start + TRIANGLE_BYTES * mesh.triangles.len()];
    bytes[..HEADING.len()].copy_from_slice(HEADING.as_bytes());
    bytes[HEADING_BYTES..start].copy_from_slice(&n.to_le_bytes());
    let blocks = bytes[start..].par_chunks_mut(TRIANGLE_BYTES * BLOCK);
    blocks.zip(mesh.triangles.par_chunks(BLOCK)).for_each(|(bytes, triangles)| {
        for (record, t) in bytes.chunks_exact_mut(TRIANGLE_BYTES).zip(triangles) {
            write_triangle(record, t.map(|v| mesh.vertices[v as usize]));
        }
    });
    Ok(bytes)
}

/// Normal, three corners, two bytes that mean nothing.
fn write_triangle(record: &mut [u8], [a, b, c]: [Point3; 3]) {
    let normal = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_default();
    let numbers = [normal, a.coords, b.coords, c.coords];
    for (place, value) in record.chunks_exact_mut(4).zip(numbers.iter().flat_map(|v| v.iter())) {
        #[expect(clippy::cast_possible_truncation, reason = "STL holds 32-bit floats")]
        let single = *value as f32 + 0.0;
        place.copy_from_slice(&single.to_le_bytes());
    }
}
