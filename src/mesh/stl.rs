//! Binary STL, written and read.
//!
//! Coordinates are 32-bit floats: vertices that are one in the mesh stay one bit pattern in the file, because the
//! rounding depends on the coordinate alone; -0.0 is written as 0.0.

use super::TriMesh;
use std::io::{self, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use stl_io::{Normal, Triangle, Vertex};

/// Writes a mesh as binary STL.
///
/// # Errors
/// What the writer returns.
pub fn write_to(writer: &mut impl Write, mesh: &TriMesh) -> io::Result<()> {
    #[expect(clippy::cast_possible_truncation, reason = "STL holds 32-bit floats")]
    let single = |v: f64| v as f32 + 0.0;
    let vertex = |i: u32| {
        let p = mesh.vertices[i as usize];
        Vertex::new([single(p.x), single(p.y), single(p.z)])
    };
    let triangles: Vec<Triangle> = mesh
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|i| mesh.vertices[i as usize]);
            let n = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_default();
            Triangle { normal: Normal::new([single(n.x), single(n.y), single(n.z)]), vertices: t.map(vertex) }
        })
        .collect();
    stl_io::write_stl(writer, triangles.iter())
}

/// Writes a mesh to a file, which appears whole or not at all.
///
/// # Errors
/// What the file system returns.
pub fn write(path: &Path, mesh: &TriMesh) -> io::Result<()> {
    let dir = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    // The operator's own file: its rights are those of any new one (umask), not a temporary file's.
    let permissions = std::fs::Permissions::from_mode(0o666);
    let mut file = tempfile::Builder::new().permissions(permissions).tempfile_in(dir)?;
    let mut writer = io::BufWriter::with_capacity(1 << 20, file.as_file_mut());
    write_to(&mut writer, mesh)?;
    writer.flush()?;
    drop(writer);
    file.as_file().sync_all()?;
    file.persist(path)?;
    Ok(())
}
