//! `volume.bin`: the CT around the lumen, so that reports can be drawn without the source.
//!
//! A line `lumenfab volume 1`, a line of JSON (dimensions, spacing, place; nothing about the patient), then the
//! intensities as little-endian `f32`, x fastest, then y, then z.

use crate::ct::{Volume, Voxels};
use crate::geom::{Bounds2, RigidTransform};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::Path;

/// Farther from the origin nothing lies, mm.
const FARTHEST_MM: f64 = 1e6;

const MAGIC: &[u8] = b"lumenfab volume 1\n";

/// How far the kept image reaches beyond the lumen: a thick wall and something of what surrounds it, mm.
pub const MARGIN_MM: f64 = 12.0;

#[derive(Debug, Serialize, Deserialize)]
struct Header {
    dims: [usize; 3],
    origin_xy_mm: [f64; 2],
    pixel_spacing_xy_mm: [f64; 2],
    plane_z_mm: Vec<f64>,
    slab_thickness_mm: f64,
    patient_from_stack: RigidTransform,
}

impl Header {
    /// Checks what all that is done with a volume takes for granted.
    fn check(&self) -> Result<(), VolumeFileError> {
        let is_length = |mm: &f64| mm.is_finite() && *mm > 0.0;
        let numbers = || self.origin_xy_mm.iter().chain(&self.pixel_spacing_xy_mm).chain(&self.plane_z_mm);
        let faults = [
            (self.dims.contains(&0), "a volume needs a voxel along every axis"),
            (self.plane_z_mm.len() != self.dims[2], "one height a plane is needed"),
            (!self.pixel_spacing_xy_mm.iter().all(is_length), "pixels need a size above 0"),
            (!is_length(&self.slab_thickness_mm), "planes need a thickness above 0"),
            (!self.plane_z_mm.windows(2).all(|z| z[0] < z[1]), "heights of planes must ascend"),
            (numbers().any(|v| v.abs() > FARTHEST_MM), "coordinates must lie within a kilometre"),
        ];
        match faults.into_iter().find(|(is_fault, _)| *is_fault) {
            Some((_, fault)) => Err(VolumeFileError::Header(fault.into())),
            None => Ok(()),
        }
    }
}

/// The bytes are no volume.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum VolumeFileError {
    /// The file does not begin as it should.
    #[error("not a volume of this version of lumenfab")]
    Foreign,
    /// The header is damaged.
    #[error("damaged header: {0}")]
    Header(String),
    /// There is more or less than the header says.
    #[error("found {found} bytes of intensities, expected {expected}: the file is damaged")]
    Length {
        /// Bytes that are there.
        found: usize,
        /// Bytes that the header promises.
        expected: usize,
    },
}

/// The part of a volume within `bounds`, in the given planes.
///
/// # Panics
/// Where `planes` reaches beyond the volume.
#[must_use]
pub fn crop(volume: &Volume, bounds: Bounds2, planes: Range<usize>) -> Volume {
    let columns = range(volume, 0, bounds.min.x, bounds.max.x);
    let rows = range(volume, 1, bounds.min.y, bounds.max.y);
    let mut hu = Vec::with_capacity(columns.len() * rows.len() * planes.len());
    for k in planes.clone() {
        let plane = volume.plane(k);
        for j in rows.clone() {
            let start = j * volume.dims[0];
            hu.extend_from_slice(&plane[start + columns.start..start + columns.end]);
        }
    }
    let corner = volume.stack_from_voxel(columns.start as f64, rows.start as f64, planes.start);
    Volume {
        dims: [columns.len(), rows.len(), planes.len()],
        hu: Voxels::new(&hu, columns.len() * rows.len()),
        origin_xy_mm: [corner.x, corner.y],
        pixel_spacing_xy_mm: volume.pixel_spacing_xy_mm,
        plane_z_mm: volume.plane_z_mm[planes].to_vec(),
        slab_thickness_mm: volume.slab_thickness_mm,
        patient_from_stack: volume.patient_from_stack,
    }
}

/// Indices along an axis whose centres lie between two coordinates; at least one.
fn range(volume: &Volume, axis: usize, from_mm: f64, to_mm: f64) -> Range<usize> {
    let last = volume.dims[axis] - 1;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the volume")]
    let at = |mm: f64, round: fn(f64) -> f64| {
        let index = (mm - volume.origin_xy_mm[axis]) / volume.pixel_spacing_xy_mm[axis];
        round(index).clamp(0.0, last as f64) as usize
    };
    at(from_mm, f64::floor)..at(to_mm, f64::ceil) + 1
}

/// The bytes of the file.
#[must_use]
pub fn to_bytes(volume: &Volume) -> Vec<u8> {
    let mut bytes = Vec::new();
    write(volume, &mut bytes).expect("memory takes all that is written");
    bytes
}

/// Writes the file.
///
/// # Errors
/// What the system says.
pub fn write(volume: &Volume, to: &mut impl Write) -> io::Result<()> {
    let header = Header {
        dims: volume.dims,
        origin_xy_mm: volume.origin_xy_mm,
        pixel_spacing_xy_mm: volume.pixel_spacing_xy_mm,
        plane_z_mm: volume.plane_z_mm.clone(),
        slab_thickness_mm: volume.slab_thickness_mm,
        patient_from_stack: volume.patient_from_stack,
    };
    to.write_all(MAGIC)?;
    serde_json::to_writer(&mut *to, &header)?;
    to.write_all(b"\n")?;
    volume.hu.iter().try_for_each(|hu| to.write_all(&hu.to_le_bytes()))?;
    to.flush()
}

/// Longest header that is believed, bytes.
const MAX_HEADER: u64 = 1 << 20;

/// A plane across an axis of the volume's voxels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Across {
    /// All rows and columns of a plane of the CT.
    Z,
    /// The same row of all planes.
    Y,
    /// The same column of all planes.
    X,
}

/// A volume file of which single planes are read (IO).
#[derive(Debug)]
pub struct Planes {
    file: File,
    header: Header,
    /// Where the intensities begin, bytes.
    start: u64,
}

impl Planes {
    /// Opens a file; its header is checked against its length.
    ///
    /// # Errors
    /// What the system says; `InvalidData` where it is no volume file.
    pub fn open(path: &Path) -> io::Result<Self> {
        let wrong = |e: VolumeFileError| io::Error::new(io::ErrorKind::InvalidData, e);
        let mut reader = BufReader::new(File::open(path)?);
        let mut magic = vec![0; MAGIC.len()];
        reader.read_exact(&mut magic)?;
        let mut line = Vec::new();
        reader.by_ref().take(MAX_HEADER).read_until(b'\n', &mut line)?;
        if magic != MAGIC {
            return Err(wrong(VolumeFileError::Foreign));
        }
        let header: Header =
            serde_json::from_slice(&line).map_err(|e| wrong(VolumeFileError::Header(e.to_string())))?;
        header.check().map_err(wrong)?;
        let (start, file) = (reader.stream_position()?, reader.into_inner());
        let expected = header.dims.iter().try_fold(4_u64, |product, &n| product.checked_mul(n as u64));
        if expected.is_none_or(|expected| file.metadata().is_ok_and(|found| found.len() != start + expected))
        {
            return Err(wrong(VolumeFileError::Header("the file is not as long as it says".into())));
        }
        Ok(Self { file, header, start })
    }

    /// Columns, rows, planes.
    #[must_use]
    pub const fn dims(&self) -> [usize; 3] {
        self.header.dims
    }

    /// Distance of columns and of rows, mm.
    #[must_use]
    pub const fn pixel_spacing_xy_mm(&self) -> [f64; 2] {
        self.header.pixel_spacing_xy_mm
    }

    /// Heights of the planes along their normal, mm.
    #[must_use]
    pub fn plane_z_mm(&self) -> &[f64] {
        &self.header.plane_z_mm
    }

    /// From the stack's frame, in which pixels lie at `origin_xy_mm` and on, to the patient's (LPS).
    #[must_use]
    pub const fn place(&self) -> ([f64; 2], RigidTransform) {
        (self.header.origin_xy_mm, self.header.patient_from_stack)
    }

    /// Intensities of a plane of the CT, row by row.
    ///
    /// # Errors
    /// What the system says; `InvalidInput` where there is no such plane.
    pub fn plane(&mut self, k: usize) -> io::Result<Vec<f32>> {
        self.cut(Across::Z, k)
    }

    /// Intensities of a plane across an axis, row by row; across x and y a row is a plane of the CT, the lowest first.
    ///
    /// # Errors
    /// What the system says; `InvalidInput` where there is no such plane.
    pub fn cut(&mut self, across: Across, index: usize) -> io::Result<Vec<f32>> {
        let [nx, ny, nz] = self.dims();
        let n = match across {
            Across::Z => nz,
            Across::Y => ny,
            Across::X => nx,
        };
        if index >= n {
            let problem = format!("found plane {index}, expected one from 0 to {}", n - 1);
            return Err(io::Error::new(io::ErrorKind::InvalidInput, problem));
        }
        match across {
            Across::Z => self.values(index * nx * ny, nx * ny),
            Across::Y => {
                let rows: io::Result<Vec<_>> =
                    (0..nz).map(|k| self.values((k * ny + index) * nx, nx)).collect();
                Ok(rows?.concat())
            }
            Across::X => {
                let mut all = Vec::with_capacity(ny * nz);
                for k in 0..nz {
                    let plane = self.values(k * nx * ny, nx * ny)?;
                    all.extend(plane.iter().skip(index).step_by(nx));
                }
                Ok(all)
            }
        }
    }

    fn values(&mut self, first: usize, n: usize) -> io::Result<Vec<f32>> {
        self.file.seek(SeekFrom::Start(self.start + 4 * first as u64))?;
        let mut bytes = vec![0; 4 * n];
        self.file.read_exact(&mut bytes)?;
        Ok(bytes.chunks_exact(4).map(|c| f32::from_le_bytes([c[0], c[1], c[2], c[3]])).collect())
    }
}

/// Reads the file.
///
/// # Errors
/// [`VolumeFileError`] where the bytes are not what [`to_bytes`] makes; the header is checked against the length
/// before it is believed.
pub fn from_bytes(bytes: &[u8]) -> Result<Volume, VolumeFileError> {
    let rest = bytes.strip_prefix(MAGIC).ok_or(VolumeFileError::Foreign)?;
    let end = rest.iter().position(|&b| b == b'\n');
    let end = end.ok_or_else(|| VolumeFileError::Header("it does not end".into()))?;
    let header: Header =
        serde_json::from_slice(&rest[..end]).map_err(|e| VolumeFileError::Header(e.to_string()))?;
    header.check()?;
    let values = &rest[end + 1..];
    let expected = header.dims.iter().try_fold(4_usize, |product, &n| product.checked_mul(n));
    let expected = expected.ok_or_else(|| VolumeFileError::Header("dimensions beyond any memory".into()))?;
    if values.len() != expected {
        return Err(VolumeFileError::Length { found: values.len(), expected });
    }
    let hu: Vec<f32> = values.chunks_exact(4).map(|c| f32::from_le_bytes([c[0], c[1], c[2], c[3]])).collect();
    Ok(Volume {
        dims: header.dims,
        hu: Voxels::new(&hu, header.dims[0] * header.dims[1]),
        origin_xy_mm: header.origin_xy_mm,
        pixel_spacing_xy_mm: header.pixel_spacing_xy_mm,
        plane_z_mm: header.plane_z_mm,
        slab_thickness_mm: header.slab_thickness_mm,
        patient_from_stack: header.patient_from_stack,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Point2;

    fn volume() -> Volume {
        Volume {
            dims: [5, 4, 3],
            hu: Voxels::new(&(0..60_u8).map(f32::from).collect::<Vec<f32>>(), 20),
            origin_xy_mm: [-10.0, 20.0],
            pixel_spacing_xy_mm: [0.5, 2.0],
            plane_z_mm: vec![1.0, 4.0, 7.0],
            slab_thickness_mm: 2.0,
            patient_from_stack: RigidTransform::identity(),
        }
    }

    #[test]
    fn a_volume_reads_back() {
        assert_eq!(from_bytes(&to_bytes(&volume())).unwrap(), volume());
    }

    #[test]
    fn single_planes_are_read_from_the_disk_across_any_axis() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("volume.bin");
        std::fs::write(&path, to_bytes(&volume())).unwrap();
        let mut planes = Planes::open(&path).unwrap();
        assert_eq!((planes.dims(), planes.plane_z_mm()), ([5, 4, 3], &[1.0, 4.0, 7.0][..]));
        let numbers = |values: Range<u8>| values.map(f32::from).collect::<Vec<_>>();
        assert_eq!(planes.plane(1).unwrap(), numbers(20..40));
        let rows = [numbers(5..10), numbers(25..30), numbers(45..50)].concat();
        assert_eq!(planes.cut(Across::Y, 1).unwrap(), rows);
        let columns = [2, 7, 12, 17, 22, 27, 32, 37, 42, 47, 52, 57].map(|n| n as f32);
        assert_eq!(planes.cut(Across::X, 2).unwrap(), columns);
        assert_eq!(planes.plane(3).unwrap_err().kind(), io::ErrorKind::InvalidInput);
        std::fs::write(&path, &to_bytes(&volume())[..300]).unwrap();
        assert_eq!(Planes::open(&path).unwrap_err().kind(), io::ErrorKind::InvalidData);
        std::fs::write(&path, "x").unwrap();
        assert!(Planes::open(&path).is_err());
    }

    #[test]
    fn a_crop_keeps_every_voxel_in_its_place() {
        let bounds = Bounds2 { min: Point2::new(-9.6, 21.9), max: Point2::new(-8.6, 23.9) };
        let cropped = crop(&volume(), bounds, 1..3);
        assert_eq!(cropped.dims, [4, 3, 2]);
        let p = volume().stack_from_voxel(2.0, 1.0, 2);
        let [i, j, k] = cropped.voxel_from_stack(p).unwrap();
        assert_eq!(cropped.at(i, j, k), volume().at(2, 1, 2));
        let everything = Bounds2 { min: Point2::new(-1e9, -1e9), max: Point2::new(1e9, 1e9) };
        assert_eq!(crop(&volume(), everything, 0..3), volume());
    }

    #[test]
    fn damaged_files_are_refused() {
        let bytes = to_bytes(&volume());
        assert_eq!(from_bytes(b"PK").unwrap_err(), VolumeFileError::Foreign);
        assert_eq!(
            from_bytes(&bytes[..bytes.len() - 1]).unwrap_err(),
            VolumeFileError::Length { found: 239, expected: 240 }
        );
        assert!(matches!(from_bytes(&bytes[..40]).unwrap_err(), VolumeFileError::Header(_)));
        let odd = |from: &str, to: &str| {
            let text = String::from_utf8_lossy(&bytes[..bytes.len() - 240]).into_owned();
            assert!(text.contains(from), "{text}");
            from_bytes(&[text.replace(from, to).as_bytes(), &bytes[bytes.len() - 240..]].concat())
        };
        for (from, to, fault) in [
            ("[5,4,3]", "[5,0,3]", "a volume needs a voxel along every axis"),
            ("[1.0,4.0,7.0]", "[1.0,4.0]", "one height a plane is needed"),
            ("[1.0,4.0,7.0]", "[1.0,4.0,4.0]", "heights of planes must ascend"),
            ("[0.5,2.0]", "[0.5,-2.0]", "pixels need a size above 0"),
            ("[0.5,2.0]", "[0.0,2.0]", "pixels need a size above 0"),
            ("\"slab_thickness_mm\":2.0", "\"slab_thickness_mm\":0.0", "planes need a thickness above 0"),
            ("[-10.0,20.0]", "[-10.0,2e9]", "coordinates must lie within a kilometre"),
        ] {
            assert_eq!(odd(from, to).unwrap_err(), VolumeFileError::Header(fault.into()));
        }
        let empty = "{\"dims\":[0,0,0],\"origin_xy_mm\":[0,0],\"pixel_spacing_xy_mm\":[1,1],\"plane_z_mm\":[],\"slab_thickness_mm\":1,\"patient_from_stack\":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}\n";
        assert!(matches!(
            from_bytes(&[MAGIC, empty.as_bytes()].concat()).unwrap_err(),
            VolumeFileError::Header(_)
        ));
        let huge = [MAGIC, b"{\"dims\":[4294967295,4294967295,4294967295]}\n"].concat();
        assert!(matches!(from_bytes(&huge).unwrap_err(), VolumeFileError::Header(_)));
    }
}
