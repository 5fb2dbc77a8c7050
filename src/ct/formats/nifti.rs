//! NIfTI-1 and NIfTI-2 headers (nifti1.h of 2004, nifti2.h of 2011, nifti.nimh.nih.gov), plain or within gzip.
//!
//! Coordinates are RAS and become LPS here. Where both transforms are stated, the sform places the volume, as in nibabel and ITK; a
//! qform that differs is told. Where neither is, the voxel axes are taken as right, front, up, and that is told too.

use super::grid::{self, Grid};
use super::values::{Endian, GZIP_MAGIC, Packing, Scalar};
use super::{DataFile, DataPlace, Fault, Header, Skip, checked_sides};
use crate::ct::quote::told;
use crate::ct::{LARGEST_RESCALE, Warning};
use crate::geom::{Point3, Vector3};
use flate2::read::MultiGzDecoder;
use std::io::Read;

/// Endings of the values' file beside a header that stands alone.
const IMAGE_ENDINGS: [&str; 2] = ["img", "img.gz"];
/// Placings that differ by less than this share of a pixel are the same.
const SAME_PLACE_PIXELS: f64 = 0.1;

/// The two versions differ in where things stand and how wide they are.
struct Version {
    name: &'static str,
    n_bytes: usize,
    /// Values in the header's own file begin behind its extension flag.
    least_offset: u64,
    magic_at: usize,
    magics: [&'static [u8]; 2],
    /// Of dim, datatype, pixdim, vox_offset, scl_slope, qform_code, quatern_b, srow_x, xyzt_units.
    at: [usize; 9],
    is_wide: bool,
}

const NIFTI_1: Version = Version {
    name: "NIfTI-1",
    n_bytes: 348,
    least_offset: 352,
    magic_at: 344,
    magics: [b"n+1\0", b"ni1\0"],
    at: [40, 70, 76, 108, 112, 252, 256, 280, 123],
    is_wide: false,
};

const NIFTI_2: Version = Version {
    name: "NIfTI-2",
    n_bytes: 540,
    least_offset: 544,
    magic_at: 4,
    magics: [b"n+2\0\r\n\x1a\n", b"ni2\0\r\n\x1a\n"],
    at: [16, 12, 104, 168, 176, 344, 352, 400, 500],
    is_wide: true,
};

/// Reads a header where the bytes begin with one, packed or not; `None` where they do not.
pub(super) fn header(bytes: &[u8]) -> Result<Option<Header>, Fault> {
    let is_packed = bytes.starts_with(&GZIP_MAGIC);
    let mut start = Vec::with_capacity(NIFTI_2.n_bytes);
    if is_packed {
        // A stream that cannot be unpacked is no header; a header that breaks off is told below.
        let _broken = MultiGzDecoder::new(bytes).take(NIFTI_2.n_bytes as u64).read_to_end(&mut start);
    } else {
        start.extend_from_slice(&bytes[..bytes.len().min(NIFTI_2.n_bytes)]);
    }
    let Some(fields) = Fields::of(&start) else { return Ok(None) };
    let version = fields.version;
    if start.len() < version.n_bytes {
        return Err(Fault::HeaderTruncated { format: version.name, found_bytes: start.len() });
    }
    let magic = &start[version.magic_at..];
    let is_alone = match version.magics.map(|m| magic.starts_with(m)) {
        [true, _] => false,
        [_, true] => true,
        _ if version.is_wide => return Ok(None),
        _ => {
            return Err(unsupported(
                "ANALYZE 7.5",
                "no mark of NIfTI",
                "convert it to NIfTI, which states its orientation",
            ));
        }
    };
    fields.header(is_alone, is_packed).map(Some)
}

fn unsupported(format: &'static str, what: impl Into<String>, instead: &'static str) -> Fault {
    Fault::Unsupported { format, what: what.into(), instead }
}

/// The numbers of a header.
struct Fields<'a> {
    bytes: &'a [u8],
    version: &'static Version,
    endian: Endian,
}

impl<'a> Fields<'a> {
    /// The header's length, its first number, tells version and byte order.
    fn of(bytes: &'a [u8]) -> Option<Self> {
        let length = *bytes.first_chunk::<4>()?;
        let of = |n: i32| match (n == i32::from_le_bytes(length), n == i32::from_be_bytes(length)) {
            (true, _) => Some(Endian::Little),
            (_, true) => Some(Endian::Big),
            _ => None,
        };
        let one = |version: &'static Version, n| of(n).map(|endian| Self { bytes, version, endian });
        one(&NIFTI_1, 348).or_else(|| one(&NIFTI_2, 540))
    }

    /// N bytes from a place, the lowest first; what is not there counts as zero.
    fn raw<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut b = [0; N];
        if let Some(found) = self.bytes.get(at..at + N) {
            b.copy_from_slice(found);
        }
        if self.endian == Endian::Big {
            b.reverse();
        }
        b
    }

    /// A real number: four bytes wide, or eight in version 2.
    fn real(&self, at: usize, index: usize) -> f64 {
        if self.version.is_wide {
            f64::from_le_bytes(self.raw(at + 8 * index))
        } else {
            f64::from(f32::from_le_bytes(self.raw(at + 4 * index)))
        }
    }

    /// A size: two bytes wide, or eight in version 2.
    fn size(&self, at: usize, index: usize) -> i64 {
        if self.version.is_wide {
            i64::from_le_bytes(self.raw(at + 8 * index))
        } else {
            i64::from(i16::from_le_bytes(self.raw(at + 2 * index)))
        }
    }

    /// The codes of qform and sform.
    fn code(&self, index: usize) -> i32 {
        let at = self.version.at[5];
        if self.version.is_wide {
            i32::from_le_bytes(self.raw(at + 4 * index))
        } else {
            i32::from(i16::from_le_bytes(self.raw(at + 2 * index)))
        }
    }

    fn fault(&self, field: &'static str, found: impl ToString, expected: &'static str) -> Fault {
        Fault::Field { format: self.version.name, field, found: told(&[found]), expected }
    }

    fn spans_nothing(&self, field: &'static str, expected: &'static str) -> Fault {
        grid::spans_nothing(self.version.name, field, expected)
    }

    fn header(&self, is_alone: bool, is_packed: bool) -> Result<Header, Fault> {
        let (dims, n_volumes) = self.dims()?;
        let mut warnings = Vec::new();
        let grid = self.grid(dims, &mut warnings)?;
        let rescale = self.rescale(&mut warnings)?;
        Ok(Header {
            format: self.version.name,
            grid,
            n_volumes,
            is_interleaved: false,
            scalar: self.scalar()?,
            endian: self.endian,
            rescale,
            place: self.place(is_alone, is_packed)?,
            modality: None,
            slab_thickness_mm: None,
            warnings,
        })
    }

    fn dims(&self) -> Result<([usize; 3], usize), Fault> {
        let at = self.version.at[0];
        let n = self.size(at, 0);
        let n_dims = usize::try_from(n).ok().filter(|n| (1..=7).contains(n));
        let n_dims = n_dims.ok_or_else(|| self.fault("dim[0]", n, "1 to 7 dimensions"))?;
        let sides: Vec<i64> = (1..=n_dims).map(|i| self.size(at, i)).collect();
        checked_sides(self.version.name, "dim", &sides)
    }

    fn scalar(&self) -> Result<Scalar, Fault> {
        let code = i16::from_le_bytes(self.raw(self.version.at[1]));
        Ok(match code {
            2 => Scalar::U8,
            4 => Scalar::I16,
            8 => Scalar::I32,
            16 => Scalar::F32,
            64 => Scalar::F64,
            256 => Scalar::I8,
            512 => Scalar::U16,
            768 => Scalar::U32,
            1024 => Scalar::I64,
            1280 => Scalar::U64,
            1 | 32 | 128 | 1536 | 1792 | 2048 | 2304 => {
                let what = format!("data type {code} (bits, colours, complex or 128-bit numbers)");
                return Err(unsupported(self.version.name, what, "convert it to integers or floats"));
            }
            _ => return Err(self.fault("datatype", code, "a code of the standard")),
        })
    }

    fn place(&self, is_alone: bool, is_packed: bool) -> Result<DataPlace, Fault> {
        let at = self.version.at[3];
        let offset = if self.version.is_wide { self.size(at, 0) as f64 } else { self.real(at, 0) };
        let least = if is_alone { 0 } else { self.version.least_offset };
        if !(offset >= least as f64 && offset < 1e9 && offset.fract() == 0.0) {
            return Err(self.fault("vox_offset", offset, "a place behind the header"));
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a whole number in range"
        )]
        let skip = Skip::Unpacked(offset as u64);
        let packing = if is_packed { Packing::Gzip } else { Packing::Raw };
        let file = is_alone.then_some(DataFile::Beside(&IMAGE_ENDINGS));
        Ok(DataPlace { file, packing, skip })
    }

    /// A slope of zero means that values stand as they are.
    fn rescale(&self, warnings: &mut Vec<Warning>) -> Result<[f64; 2], Fault> {
        let [slope, intercept] = [0, 1].map(|i| self.real(self.version.at[4], i));
        if slope == 0.0 {
            return Ok([1.0, 0.0]);
        }
        for (field, value) in [("scl_slope", slope), ("scl_inter", intercept)] {
            if value.is_finite() && value.abs() > LARGEST_RESCALE {
                return Err(self.fault(field, value, "a number within 1000000"));
            }
        }
        if slope.is_finite() && intercept.is_finite() {
            return Ok([slope, intercept]);
        }
        let text = "slope and intercept of the values are no numbers: the values were taken as they stand";
        warnings.push(Warning::new("ct.no_rescale", text));
        Ok([1.0, 0.0])
    }

    /// Millimetres that the header's unit of length is.
    fn unit_mm(&self, warnings: &mut Vec<Warning>) -> Result<f64, Fault> {
        let code = self.raw::<1>(
            self.version.at[8] + if self.version.is_wide && self.endian == Endian::Big { 3 } else { 0 },
        )[0] & 7;
        Ok(match code {
            1 => 1000.0,
            2 => 1.0,
            3 => 0.001,
            0 => {
                let text = "the file does not state its unit of length; mm was taken";
                warnings.push(Warning::new("ct.no_unit", text));
                1.0
            }
            _ => return Err(self.fault("xyzt_units", code, "metres, millimetres or micrometres")),
        })
    }

    fn grid(&self, dims: [usize; 3], warnings: &mut Vec<Warning>) -> Result<Grid, Fault> {
        let unit_mm = self.unit_mm(warnings)?;
        let [q, s] = [0, 1].map(|i| self.code(i) > 0);
        let qform = q.then(|| self.qform(dims, unit_mm)).filter(Grid::is_sound);
        let sform = s.then(|| self.sform(dims, unit_mm)).filter(Grid::is_sound);
        match (sform, qform) {
            (Some(sform), Some(qform)) => {
                let apart_mm = sform.farthest_mm(&qform);
                if apart_mm > SAME_PLACE_PIXELS * sform.axes_mm[0].norm().min(sform.axes_mm[1].norm()) {
                    let text = format!(
                        "sform and qform place voxels up to {apart_mm:.3} mm apart; the sform was used"
                    );
                    warnings.push(Warning::new("ct.transforms_disagree", text));
                }
                Ok(sform)
            }
            (Some(grid), None) | (None, Some(grid)) => Ok(grid),
            (None, None) if q || s => Err(self.spans_nothing("its transform", "three axes in mm")),
            (None, None) => {
                let text = "the file does not state how the volume lies in the patient; columns were taken to run right, rows to the front, planes up";
                warnings.push(Warning::new("ct.no_orientation", text));
                let grid = self.plain(dims, unit_mm);
                let odd = || self.spans_nothing("pixdim", "three distances in mm");
                grid.is_sound().then_some(grid).ok_or_else(odd)
            }
        }
    }

    fn pixdim(&self, index: usize) -> f64 {
        self.real(self.version.at[2], index)
    }

    fn plain(&self, dims: [usize; 3], unit_mm: f64) -> Grid {
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
        let axes = [0, 1, 2].map(|i| axes[i] * self.pixdim(i + 1).abs());
        lps(dims, Point3::origin(), axes, unit_mm)
    }

    fn qform(&self, dims: [usize; 3], unit_mm: f64) -> Grid {
        let [b, c, d, x, y, z] = [0, 1, 2, 3, 4, 5].map(|i| self.real(self.version.at[6], i));
        // Unit length gives the first component. Near a half turn it is lost in the rounding of the others, whose square root
        // it is: it is then none, and the others are brought to unit length.
        let rest = b.mul_add(b, c.mul_add(c, d * d));
        let rounding = if self.version.is_wide { 16.0 * f64::EPSILON } else { 3.0 * f64::from(f32::EPSILON) };
        let (a, b, c, d) = if rest < 1.0 - rounding {
            ((1.0 - rest).sqrt(), b, c, d)
        } else {
            let length = rest.sqrt();
            (0.0, b / length, c / length, d / length)
        };
        let rotated = [
            Vector3::new(a * a + b * b - c * c - d * d, 2.0 * (b * c + a * d), 2.0 * (b * d - a * c)),
            Vector3::new(2.0 * (b * c - a * d), a * a + c * c - b * b - d * d, 2.0 * (c * d + a * b)),
            Vector3::new(2.0 * (b * d + a * c), 2.0 * (c * d - a * b), a * a + d * d - b * b - c * c),
        ];
        let handed = if self.pixdim(0) < 0.0 { -1.0 } else { 1.0 };
        let lengths = [self.pixdim(1), self.pixdim(2), self.pixdim(3) * handed];
        lps(dims, Point3::new(x, y, z), [0, 1, 2].map(|i| rotated[i] * lengths[i]), unit_mm)
    }

    fn sform(&self, dims: [usize; 3], unit_mm: f64) -> Grid {
        let at = |row: usize, column: usize| self.real(self.version.at[7], 4 * row + column);
        let column = |c: usize| Vector3::new(at(0, c), at(1, c), at(2, c));
        lps(dims, column(3).into(), [0, 1, 2].map(column), unit_mm)
    }
}

/// A grid given in RAS.
fn lps(dims: [usize; 3], origin: Point3, axes: [Vector3; 3], unit_mm: f64) -> Grid {
    let turned = |v: Vector3| Vector3::new(-v.x, -v.y, v.z) * unit_mm;
    Grid { dims, origin: turned(origin.coords).into(), axes_mm: axes.map(turned) }
}
