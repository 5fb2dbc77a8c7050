//! Why a ready segmentation cannot be used. One line each.

use super::Structure;
use crate::ct;
use crate::progress::Cancelled;
use std::fmt::Write;
use std::path::PathBuf;

/// Why there are no contours.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A label map that cannot be read.
    #[error(transparent)]
    Image(#[from] ct::Error),
    /// None of the kinds.
    #[error("{} is no segmentation: expected a label map (NIfTI, MetaImage, NRRD), a DICOM SEG or an RTSTRUCT", .0.display())]
    Foreign(PathBuf),
    /// Nothing is segmented.
    #[error("{} holds no structure: every voxel is 0, or there is no closed contour", .0.display())]
    Nothing(PathBuf),
    /// Several structures and none chosen.
    #[error("{} holds {} structures: {}: choose one with --label N", path.display(), found.len(), named(found))]
    SeveralLabels {
        /// The file.
        path: PathBuf,
        /// All that there are.
        found: Vec<Structure>,
    },
    /// The chosen one does not exist.
    #[error("{} holds no such structure: there is {}: choose one of these with --label N", path.display(), named(found))]
    NoSuchLabel {
        /// The file.
        path: PathBuf,
        /// All that there are.
        found: Vec<Structure>,
    },
    /// An image in the place of a label map.
    #[error(
        "{} holds more than {most} different values: a label map is needed, not an image: export the segmentation as labels", path.display()
    )]
    NoLabelMap {
        /// The file.
        path: PathBuf,
        /// Most labels that are believed.
        most: usize,
    },
    /// Contours that somebody has left out.
    #[error("the structure has no contour {places}: draw it there, or have it led across with --allow-gaps")]
    MissingPlanes {
        /// All gaps.
        places: String,
    },
    /// A DICOM object that cannot be used.
    #[error("{}: {what}", path.display())]
    Dicom {
        /// The file.
        path: PathBuf,
        /// What was found, what was expected, what to do.
        what: String,
    },
    /// Planes that are inclined against the CT's.
    #[error(
        "the planes of the segmentation are inclined by {angle_deg:.2} degrees against the CT's: resample it to the CT, or leave --ct out"
    )]
    Inclined {
        /// Angle between the normals.
        angle_deg: f64,
    },
    /// A contour between two planes of the CT.
    #[error(
        "a contour lies at z = {z_mm:.3} mm, {off_mm:.3} mm off the nearest plane of the CT: choose the CT it was drawn on, or leave --ct out"
    )]
    OffPlane {
        /// Its height along the CT's normal.
        z_mm: f64,
        /// Distance from the nearest plane.
        off_mm: f64,
    },
    /// Two planes that would become one.
    #[error(
        "two planes of the segmentation lie at z = {z_mm:.3} mm of the CT: export it with one for each plane of the CT, or leave --ct out"
    )]
    SamePlane {
        /// Their height along the CT's normal.
        z_mm: f64,
    },
    /// Made on another image.
    #[error(
        "the segmentation's FrameOfReferenceUID is not the CT's: it was made on another image, perhaps of another patient: choose the CT it was made on, or leave --ct out"
    )]
    OtherFrame,
    /// Nothing in common with the CT.
    #[error("the segmentation lies outside the CT ({what}): choose the CT it was made on, or leave --ct out")]
    Elsewhere {
        /// Where it lies and where the CT does.
        what: String,
    },
    /// Nothing between the heights.
    #[error("the segmentation has planes from z = {} to {} mm, none of them between {} and {} mm: change --z-mm", found[0], found[1], asked[0], asked[1])]
    OutsideZRange {
        /// First and last plane.
        found: [f64; 2],
        /// What was asked for.
        asked: [f64; 2],
    },
    /// The work was interrupted.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl Error {
    /// A stable name for programs.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Image(error) => error.code(),
            Self::Foreign(_) => "ready.foreign",
            Self::Nothing(_) => "ready.nothing",
            Self::SeveralLabels { .. } => "ready.several_labels",
            Self::NoSuchLabel { .. } => "ready.no_such_label",
            Self::NoLabelMap { .. } => "ready.no_label_map",
            Self::MissingPlanes { .. } => "ready.missing_planes",
            Self::Dicom { .. } => "ready.dicom",
            Self::Inclined { .. } => "ready.inclined",
            Self::OffPlane { .. } => "ready.off_plane",
            Self::SamePlane { .. } => "ready.same_plane",
            Self::OtherFrame => "ready.other_frame",
            Self::Elsewhere { .. } => "ready.elsewhere",
            Self::OutsideZRange { .. } => "ready.outside_z_range",
            Self::Cancelled(_) => "ready.cancelled",
        }
    }

    /// Whether another choice of structure, series or heights mends it, and nothing is wrong with the files.
    #[must_use]
    pub const fn is_choice(&self) -> bool {
        match self {
            Self::Image(fault) => fault.is_choice(),
            Self::SeveralLabels { .. } | Self::NoSuchLabel { .. } | Self::OutsideZRange { .. } => true,
            _ => false,
        }
    }

    /// The message without the file's path and the structures' names, which may hold a patient's: for what is written or sent on.
    #[must_use]
    pub fn text_without_path(&self) -> String {
        let plain =
            |found: &[Structure]| found.iter().map(|s| Structure { name: None, ..s.clone() }).collect();
        let path = PathBuf::from("the segmentation");
        match self {
            Self::Image(fault) => fault.text_with(|_| "the segmentation".to_owned()),
            Self::SeveralLabels { found, .. } => {
                Self::SeveralLabels { path, found: plain(found) }.to_string()
            }
            Self::NoSuchLabel { found, .. } => Self::NoSuchLabel { path, found: plain(found) }.to_string(),
            Self::Foreign(_) => Self::Foreign(path).to_string(),
            Self::Nothing(_) => Self::Nothing(path).to_string(),
            Self::NoLabelMap { most, .. } => Self::NoLabelMap { path, most: *most }.to_string(),
            Self::Dicom { what, .. } => Self::Dicom { path, what: what.clone() }.to_string(),
            Self::MissingPlanes { .. }
            | Self::Inclined { .. }
            | Self::OffPlane { .. }
            | Self::SamePlane { .. }
            | Self::OtherFrame
            | Self::Elsewhere { .. }
            | Self::OutsideZRange { .. }
            | Self::Cancelled(_) => self.to_string(),
        }
    }
}

/// Numbers, names and sizes of structures, in one line.
fn named(structures: &[Structure]) -> String {
    let mut text = String::new();
    for Structure { number, name, size, unit } in structures {
        let gap = if text.is_empty() { "" } else { ", " };
        let name = name.as_ref().map_or(String::new(), |n| format!(" {:?}", n.trim()));
        write!(text, "{gap}{number}{name} ({size} {unit})").expect("a string takes every text");
    }
    text
}
