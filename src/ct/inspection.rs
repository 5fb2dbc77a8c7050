//! What a folder holds and whether it can be used, for the operator.
//!
//! A report tells nothing that identifies a patient: no path, no file name, no attribute but numbers and codes. A file that is at
//! fault is called by its place among the images of its series, sorted by path.

mod table;

use super::series::{Header, Series};
use super::stack::{Stack, median};
use super::{Error, Warning};
use crate::geom::Vector3;
use serde::Serialize;
use std::fmt;

/// The series of a folder.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Inspection {
    /// Files found.
    pub n_files: usize,
    /// The series, numbered from 1 in the order of the folder's files.
    pub series: Vec<SeriesReport>,
    /// What was odd about the folder as a whole.
    pub warnings: Vec<Warning>,
    /// What is wrong, with the paths of the files: for the operator's own eyes, never written.
    #[serde(skip)]
    pub faults: Vec<String>,
}

/// One series.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SeriesReport {
    /// Its number, from 1: what [`super::SeriesChoice::ByNumber`] takes.
    pub number: usize,
    /// DICOM modality.
    pub modality: String,
    /// What tells it from other series with the same UID, such as `cardiac phase 70 %`.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub distinction: String,
    /// Images in it.
    pub n_images: usize,
    /// Planes that they make; `null` where they make no stack.
    pub n_planes: Option<usize>,
    /// Columns and rows.
    pub columns_rows: [usize; 2],
    /// Distance of columns and of rows, mm.
    pub pixel_spacing_xy_mm: [f64; 2],
    /// Thickness of the slab of the first image, mm.
    pub slab_thickness_mm: Option<f64>,
    /// What lies unseen between slabs where planes lie at their usual distance, mm; negative where slabs overlap.
    pub slab_gap_mm: Option<f64>,
    /// Least and largest distance between neighbouring planes along their normal, mm; `null` where the planes make no stack.
    pub plane_step_mm: Option<[f64; 2]>,
    /// First and last plane along the normal, mm; `null` where the planes make no stack.
    pub z_range_mm: Option<[f64; 2]>,
    /// How the planes lie.
    pub orientation: Orientation,
    /// Unit normal of the planes, patient coordinates (LPS).
    pub normal_lps: [f64; 3],
    /// Angle of a tilted gantry, degrees; `null` where there is none.
    pub gantry_tilt_deg: Option<f64>,
    /// How the pixels are stored.
    pub pixels: PixelReport,
    /// Transfer syntax, by name.
    pub encoding: String,
    /// Whether it can be used.
    pub verdict: Verdict,
    /// Why it cannot be used, and what to do.
    pub reason: Option<String>,
    /// What was odd about it.
    pub warnings: Vec<Warning>,
    /// What to type next, PATH being the path that was inspected; `null` where it cannot be used.
    pub next: Option<String>,
}

/// How stored values become intensities.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PixelReport {
    /// Bits of the word.
    pub bits_allocated: u16,
    /// Bits that hold the value.
    pub bits_stored: u16,
    /// Whether values may be negative.
    pub signed: bool,
    /// Slope and intercept of the first image; `null` where it has none.
    pub rescale: Option<[f64; 2]>,
    /// Stored values that mean "outside the image", both ends included; `null` where none are named.
    pub padding: Option<[i32; 2]>,
}

/// How planes lie in the patient.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Orientation {
    /// Across the long axis of the body.
    Transaxial,
    /// Seen from the front.
    Coronal,
    /// Seen from the side.
    Sagittal,
    /// None of these within half a degree.
    Oblique,
}

impl Orientation {
    /// The orientation of planes with that normal.
    pub(super) fn of(normal: Vector3) -> Self {
        let is = |v: f64| v.abs() > 0.5_f64.to_radians().cos();
        match (is(normal.x), is(normal.y), is(normal.z)) {
            (true, ..) => Self::Sagittal,
            (_, true, _) => Self::Coronal,
            (.., true) => Self::Transaxial,
            _ => Self::Oblique,
        }
    }
}

impl fmt::Display for Orientation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Transaxial => "transaxial",
            Self::Coronal => "coronal",
            Self::Sagittal => "sagittal",
            Self::Oblique => "oblique",
        })
    }
}

/// Whether a series can be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Yes.
    Usable,
    /// Yes, after a look at the warnings.
    UsableWithWarnings,
    /// No.
    Unusable,
}

impl Verdict {
    /// Of what was found.
    pub(super) fn of(fault: Option<&Error>, warnings: &[Warning]) -> Self {
        match (fault, warnings) {
            (Some(_), _) => Self::Unusable,
            (None, []) => Self::Usable,
            (None, _) => Self::UsableWithWarnings,
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Usable => "usable",
            Self::UsableWithWarnings => "usable with warnings",
            Self::Unusable => "unusable",
        })
    }
}

impl PixelReport {
    fn of(header: &Header) -> Self {
        Self {
            bits_allocated: header.pixels.bits_allocated,
            bits_stored: header.pixels.bits_stored,
            signed: header.pixels.is_signed,
            rescale: header.rescale,
            padding: header.padding,
        }
    }
}

impl SeriesReport {
    /// The report of a series, its stack where it makes one, and what stands against its use, if anything. `is_one_of_several`:
    /// whether it has to be chosen by its number.
    pub(super) fn new(
        number: usize,
        series: &Series,
        stack: Option<&Stack>,
        fault: Option<&Error>,
        is_one_of_several: bool,
    ) -> Self {
        let first = &series.images[0];
        let warnings = stack.map(|s| s.warnings.clone()).unwrap_or_default();
        let steps = stack.map(|s| s.plane_z_mm.windows(2).map(|w| w[1] - w[0]).collect::<Vec<_>>());
        let normal = first.shape.normal();
        Self {
            number,
            modality: first.modality.clone(),
            distinction: series.distinction.clone(),
            n_images: series.images.len() + series.odd.len(),
            n_planes: stack.map(|s| s.images.len()),
            columns_rows: [first.shape.columns, first.shape.rows],
            pixel_spacing_xy_mm: first.shape.spacing_xy_mm,
            slab_thickness_mm: first.believed_slab_mm(),
            slab_gap_mm: steps
                .as_deref()
                .zip(first.believed_slab_mm())
                .map(|(s, t)| median(s.iter().copied()) - t),
            plane_step_mm: steps.map(|s| extremes(s.into_iter())),
            z_range_mm: stack.map(|s| extremes(s.plane_z_mm.iter().copied())),
            orientation: Orientation::of(normal),
            normal_lps: normal.into(),
            gantry_tilt_deg: stack.and_then(|s| s.tilt_deg),
            pixels: PixelReport::of(first),
            encoding: first.syntax.name.to_owned(),
            verdict: Verdict::of(fault, &warnings),
            reason: fault.map(|f| without_paths(f, series)),
            warnings,
            next: next_command(number, fault, is_one_of_several),
        }
    }
}

/// What an error says, every path in it replaced by the image's place in its series.
fn without_paths(error: &Error, series: &Series) -> String {
    error.text_with(|path| match series.images.iter().position(|h| h.path == path) {
        Some(i) => format!("image {} of {} (by file name)", i + 1, series.images.len()),
        None if series.odd.iter().any(|h| h.path == path) => "an image of the series".into(),
        None => "a file of the folder".into(),
    })
}

pub(super) fn next_command(number: usize, fault: Option<&Error>, is_one_of_several: bool) -> Option<String> {
    let gaps = match fault {
        None => "",
        Some(Error::MissingPlanes { .. }) => " --allow-gaps",
        Some(_) => return None,
    };
    let series = if is_one_of_several { format!(" --series {number}") } else { String::new() };
    Some(format!("lumenfab run --ct PATH{series}{gaps} --seed-mm auto --out my-case"))
}

fn extremes(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], v| [a.min(v), b.max(v)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orientation_is_named_within_half_a_degree() {
        let tilted = |deg: f64| Vector3::new(0.0, -deg.to_radians().sin(), deg.to_radians().cos());
        assert_eq!(Orientation::of(tilted(0.3)), Orientation::Transaxial);
        assert_eq!(Orientation::of(tilted(2.0)), Orientation::Oblique);
        assert_eq!(Orientation::of(tilted(90.0)), Orientation::Coronal);
        assert_eq!(Orientation::of(-Vector3::x()), Orientation::Sagittal);
    }
}
