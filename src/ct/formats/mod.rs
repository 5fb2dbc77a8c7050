//! Image files that are no DICOM: bytes of NIfTI-1/2, MetaImage and NRRD to a [`Header`], and its values. Pure.
//!
//! What a file is, is told by its content ([`recognise`]), never by its name. A header says how large the image is, how its
//! values are packed and where its voxels lie in the patient: always as LPS millimetres here, whatever the format counts in. The
//! size is checked against the bytes that are there before any memory is asked for ([`values`]).
//!
//! It deliberately resamples nothing: a grid whose axes are not at right angles is refused ([`grid`]). Texts that a header may hold
//! (descriptions, names, comments) are not read: they may name a patient.
//!
//! Limits: up to 8192 columns, rows and planes; scalar values only, no colours, complex or 128-bit numbers.

mod fault;
pub(crate) mod grid;
mod metaimage;
mod nifti;
mod nrrd;
#[cfg(test)]
mod tests;
mod text;
pub(crate) mod values;

pub use fault::Fault;

use super::quote::told;
use super::{LONGEST_SIDE, Warning};
use grid::Grid;
use values::{Endian, Packing, Scalar};

/// More volumes in one file are not believed.
const MOST_VOLUMES: usize = 65_536;

/// What a file says about its image.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Header {
    /// The format's name, for the operator.
    pub(crate) format: &'static str,
    /// Where the voxels lie, LPS, mm.
    pub(crate) grid: Grid,
    /// Images of that grid in the file: time steps, channels.
    pub(crate) n_volumes: usize,
    /// Whether the volumes' values alternate voxel by voxel; else one volume follows the other.
    pub(crate) is_interleaved: bool,
    pub(crate) scalar: Scalar,
    pub(crate) endian: Endian,
    /// Intensity = slope x value + intercept.
    pub(crate) rescale: [f64; 2],
    pub(crate) place: DataPlace,
    /// The DICOM name of the modality, where the file states it.
    pub(crate) modality: Option<&'static str>,
    /// Thickness of the slab that a plane averages over, where the file states it, mm.
    pub(crate) slab_thickness_mm: Option<f64>,
    pub(crate) warnings: Vec<Warning>,
}

/// Where the values are.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct DataPlace {
    /// Another file, as the header names it; `None`: the header's own.
    pub(crate) file: Option<DataFile>,
    pub(crate) packing: Packing,
    /// Bytes before the (packed) values.
    pub(crate) skip: Skip,
}

/// The file that holds the values of a header that stands alone.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum DataFile {
    /// Named in the header, relative to it.
    Named(String),
    /// The header's own name with another ending, the first that exists.
    Beside(&'static [&'static str]),
}

/// What stands before the values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Skip {
    /// This many bytes of the file.
    File(usize),
    /// The file's first bytes, then lines of what follows, then bytes again.
    Lines {
        /// Where the first line begins.
        start: usize,
        /// How many lines.
        n_lines: usize,
        /// Bytes after them.
        n_bytes: usize,
    },
    /// This many bytes of what the file unpacks to.
    Unpacked(u64),
    /// Everything but the last bytes of the file, as many as the values need.
    AllButValues,
}

impl Header {
    /// Voxels of one volume.
    pub(crate) fn n_voxels(&self) -> usize {
        self.grid.dims.iter().product()
    }

    /// Format and packing in words.
    pub(crate) fn encoding(&self) -> String {
        let endian = match (self.scalar.n_bytes(), self.place.packing, self.endian) {
            (1, ..) | (_, Packing::Text, _) => "",
            (.., Endian::Little) => " little endian",
            (.., Endian::Big) => " big endian",
        };
        format!("{}, {}{endian}, {}", self.format, self.scalar.name(), self.place.packing.name())
    }
}

/// Reads a header where the bytes are one of the formats; `None` where they are something else.
///
/// # Errors
/// [`Fault`] where they are one of the formats but cannot be used.
pub(crate) fn recognise(bytes: &[u8]) -> Result<Option<Header>, Fault> {
    if nrrd::is_one(bytes) {
        nrrd::header(bytes).map(Some)
    } else if metaimage::is_one(bytes) {
        metaimage::header(bytes).map(Some)
    } else {
        nifti::header(bytes)
    }
}

/// Checks the sides of an image and multiplies the further ones.
fn checked_sides(
    format: &'static str,
    field: &'static str,
    sides: &[i64],
) -> Result<([usize; 3], usize), Fault> {
    let fault = |expected| Fault::Field { format, field, found: told(sides), expected };
    let sides: Option<Vec<usize>> =
        sides.iter().map(|&n| usize::try_from(n).ok().filter(|&n| n > 0)).collect();
    let sides = sides.ok_or_else(|| fault("sizes from 1"))?;
    let [columns, rows, planes, further @ ..] = sides.as_slice() else {
        return Err(fault("three sizes at least: a volume of planes"));
    };
    if [columns, rows, planes].into_iter().any(|&n| n > LONGEST_SIDE.into()) {
        return Err(fault("sides up to 8192 voxels"));
    }
    if *planes < 2 {
        return Err(fault("two planes at least"));
    }
    let n_volumes = further.iter().try_fold(1_usize, |n, &m| n.checked_mul(m)).filter(|&n| n <= MOST_VOLUMES);
    Ok(([*columns, *rows, *planes], n_volumes.ok_or_else(|| fault("up to 65536 volumes"))?))
}
