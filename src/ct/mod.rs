//! DICOM files, or an image file, to a [`Volume`]: intensities on a grid whose planes are stacked along z.
//!
//! [`reader::load`] reads one series, [`reader::inspect`] says what is there and whether it can be used. Headers are
//! read first; the images are grouped into series, put in order along the planes' normal and checked; then the pixels are decoded in parallel and rescaled.
//!
//! Frames: the stack's z runs along the planes' normal, its x along the rows, its y along the columns; for a
//! transaxial CT the stack is the patient's LPS frame itself (images stored from right to left or from back to front
//! are turned over for that). Planes need not lie at equal distances. Lengths in mm, intensities in HU.
//!
//! Pixels stay as they are, with one exception: planes that lie beside each other (gantry tilt) are moved
//! within themselves by whole pixels and a band-limited fraction, so that every later room may take for granted that planes lie over
//! each other along the normal. Nothing is interpolated between planes.
//!
//! A series that lacks a plane or holds images that do not fit is refused with the place named. Colour is not read.
//!
//! Nothing that identifies a patient is shown by this room or given away to be kept: no name, number or date; file names occur in errors
//! only. The UID of the frame of reference leaves it within [`FrameOfReference`], which can be compared and nothing else.

pub(crate) mod axes;
pub mod codec;
mod encoding;
mod error;
pub(crate) mod formats;
mod grouping;
mod inspection;
pub(crate) mod quote;
pub mod reader;
mod series;
mod shift;
mod slabs;
mod stack;
mod traits;
mod voxels;

pub use error::Error;
pub use formats::Fault as ImageFault;
pub use inspection::{Inspection, Orientation, PixelReport, SeriesReport, Verdict};
pub(crate) use stack::{Gap, gaps_among};
pub use voxels::Voxels;

use crate::geom::{Point3, RigidTransform};
use std::borrow::Cow;

/// Longest side of an image that is believed, pixels.
pub(crate) const LONGEST_SIDE: u16 = 8192;
/// Positions nearer than this are the same place: twice what two decimals in a header may be off, mm.
pub(crate) const SAME_PLACE_MM: f64 = 0.01;
/// Largest slope and intercept that are believed: counts of other modalities reach some 100,000, and 16-bit values rescaled by more
/// would leave no digit of a 32-bit number for a fraction.
pub(crate) const LARGEST_RESCALE: f64 = 1e6;
/// Heights that are written with three decimals still meet their plane, mm.
pub(crate) const HEIGHT_SLACK_MM: f64 = 1e-3;

/// The file with exact contours that lies beside a phantom's series; the reader passes over it.
pub const PHANTOM_TRUTH_FILE: &str = "truth.json";

/// Intensities on a regular grid of planes.
#[derive(Debug, Clone, PartialEq)]
pub struct Volume {
    /// Columns, rows, planes.
    pub dims: [usize; 3],
    /// HU, plane by plane, x fastest, then y.
    pub hu: Voxels,
    /// Stack coordinates of the centre of voxel (0, 0) of every plane, mm.
    pub origin_xy_mm: [f64; 2],
    /// Distance between neighbouring columns (along x) and rows (along y), mm.
    pub pixel_spacing_xy_mm: [f64; 2],
    /// z of the middle of each plane in the stack frame, mm, ascending.
    pub plane_z_mm: Vec<f64>,
    /// Thickness of the slab that a plane averages over, mm.
    pub slab_thickness_mm: f64,
    /// Where the stack lies in the patient; the identity for a transaxial CT.
    pub patient_from_stack: RigidTransform,
}

/// Something that was odd about the input but could be used.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Warning {
    /// A stable name such as `ct.duplicate_plane`.
    pub code: String,
    /// What was found and what was done about it, for the operator. Names no patient and no path.
    pub text: String,
}

impl Warning {
    /// A warning with a stable name and a text for the operator.
    #[must_use]
    pub fn new(code: &str, text: impl Into<String>) -> Self {
        Self { code: code.to_owned(), text: text.into() }
    }
}

/// Which series of a folder is meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SeriesChoice {
    /// The only one; several are an error that lists them.
    #[default]
    Only,
    /// The one of that number in the list of [`reader::inspect`], from 1.
    ByNumber(usize),
}

/// How a series is asked for where it is to be found again.
#[derive(Clone, PartialEq, Eq)]
pub enum SeriesName {
    /// By its number in the list of [`reader::inspect`], from 1.
    Number(usize),
    /// By its SeriesInstanceUID, which must not be kept.
    Uid(String),
    /// By what [`SeriesMark`] kept of it.
    Mark(SeriesMark),
}

impl std::fmt::Debug for SeriesName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Number(number) => f.debug_tuple("Number").field(number).finish(),
            Self::Uid(_) => f.write_str("Uid(..)"),
            Self::Mark(mark) => f.debug_tuple("Mark").field(mark).finish(),
        }
    }
}

/// What may be kept of a series that was chosen: its number and a hash that only proves it to be the same one again.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct SeriesMark {
    /// Its number, from 1.
    pub number: usize,
    /// A keyed hash of its identity, 128 bits in hexadecimal digits.
    pub check: String,
}

/// The frame of reference that coordinates are in (FrameOfReferenceUID, PS3.3 C.7.4.1): to be compared, never shown or kept, since
/// it leads to the patient.
#[derive(Clone, PartialEq, Eq, Default)]
pub struct FrameOfReference(String);

impl FrameOfReference {
    /// The frame of a UID; an empty one is unknown.
    #[must_use]
    pub fn new(uid: &str) -> Self {
        Self(uid.trim_matches(['\0', ' ']).to_owned())
    }

    /// Whether it is stated at all.
    #[must_use]
    pub const fn is_known(&self) -> bool {
        !self.0.is_empty()
    }
}

impl std::fmt::Debug for FrameOfReference {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FrameOfReference").field("is_known", &self.is_known()).finish_non_exhaustive()
    }
}

/// A series that was read.
#[derive(Debug, Clone, PartialEq)]
pub struct Loaded {
    /// Its intensities.
    pub volume: Volume,
    /// What was odd about it.
    pub warnings: Vec<Warning>,
    /// The DICOM modality, such as `CT`.
    pub modality: String,
    /// Files that the volume was made of.
    pub n_files: usize,
    /// What its coordinates refer to; unknown for other formats than DICOM.
    pub frame: FrameOfReference,
}

/// Labels on a regular grid of planes, as a segmentation made elsewhere gives them.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelMap {
    /// Columns, rows, planes.
    pub dims: [usize; 3],
    /// Labels, 0 for nothing; x fastest, then y, then z.
    pub labels: Vec<u32>,
    /// Stack coordinates of the centre of voxel (0, 0) of every plane, mm.
    pub origin_xy_mm: [f64; 2],
    /// Distance between neighbouring columns and rows, mm.
    pub pixel_spacing_xy_mm: [f64; 2],
    /// z of the middle of each plane in the stack frame, mm, ascending.
    pub plane_z_mm: Vec<f64>,
    /// Where the stack lies in the patient.
    pub patient_from_stack: RigidTransform,
    /// What was odd about the file.
    pub warnings: Vec<Warning>,
}

impl Volume {
    /// HU of voxel (i, j, k).
    ///
    /// # Panics
    /// Where an index is out of range.
    #[must_use]
    pub fn at(&self, i: usize, j: usize, k: usize) -> f32 {
        self.hu.at(j * self.dims[0] + i, k)
    }

    /// The pixels of plane k, row by row.
    ///
    /// # Panics
    /// Where k is out of range.
    #[must_use]
    pub fn plane(&self, k: usize) -> Cow<'_, [f32]> {
        self.hu.plane(k)
    }

    /// Side of a square pixel of the same area, mm.
    #[must_use]
    pub fn pixel_mm(&self) -> f64 {
        let [x, y] = self.pixel_spacing_xy_mm;
        (x * y).sqrt()
    }

    /// Stack coordinates of the centre of voxel (i, j, k), mm; columns and rows may be broken numbers and lie outside.
    ///
    /// # Panics
    /// Where k is out of range.
    #[must_use]
    pub fn stack_from_voxel(&self, i: f64, j: f64, k: usize) -> Point3 {
        Point3::new(
            self.origin_xy_mm[0] + i * self.pixel_spacing_xy_mm[0],
            self.origin_xy_mm[1] + j * self.pixel_spacing_xy_mm[1],
            self.plane_z_mm[k],
        )
    }

    /// The voxel nearest to a point of the stack frame; `None` outside the volume (more than half a voxel or
    /// half a plane interval beyond the outermost centres).
    #[must_use]
    pub fn voxel_from_stack(&self, p: Point3) -> Option<[usize; 3]> {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "range checked first")]
        let nearest = |offset: f64, spacing: f64, n: usize| {
            let at = (offset / spacing).round();
            (at >= 0.0 && at < n as f64).then_some(at as usize)
        };
        let i = nearest(p.x - self.origin_xy_mm[0], self.pixel_spacing_xy_mm[0], self.dims[0])?;
        let j = nearest(p.y - self.origin_xy_mm[1], self.pixel_spacing_xy_mm[1], self.dims[1])?;
        let nearest_plane = (0..self.dims[2])
            .min_by(|&a, &b| (self.plane_z_mm[a] - p.z).abs().total_cmp(&(self.plane_z_mm[b] - p.z).abs()))?;
        let interval = self.plane_interval_mm(nearest_plane);
        let k = ((self.plane_z_mm[nearest_plane] - p.z).abs() <= 0.5 * interval + 1e-9)
            .then_some(nearest_plane)?;
        Some([i, j, k])
    }

    /// The planes between two heights of the stack frame, mm, both included; empty where there is none.
    #[must_use]
    pub fn planes_between(&self, [lo, hi]: [f64; 2]) -> std::ops::Range<usize> {
        let start = self.plane_z_mm.partition_point(|&z| z < lo - HEIGHT_SLACK_MM);
        start..self.plane_z_mm.partition_point(|&z| z <= hi + HEIGHT_SLACK_MM).max(start)
    }

    /// Distance from plane k to its farther neighbour, mm; the slab thickness where there is one plane only.
    ///
    /// # Panics
    /// Where k is out of range.
    #[must_use]
    pub fn plane_interval_mm(&self, k: usize) -> f64 {
        let below = k.checked_sub(1).map(|b| self.plane_z_mm[k] - self.plane_z_mm[b]);
        let above = self.plane_z_mm.get(k + 1).map(|z| z - self.plane_z_mm[k]);
        match (below, above) {
            (Some(a), Some(b)) => a.max(b),
            (Some(d), None) | (None, Some(d)) => d,
            (None, None) => self.slab_thickness_mm,
        }
    }
}
