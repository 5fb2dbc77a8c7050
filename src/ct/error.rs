//! Why a series cannot be read. One line each: which file, what was found, what to do.

use super::codec::Fault;
use crate::progress::Cancelled;
use std::path::{Path, PathBuf};

/// Why no volume was made.
///
/// Texts name the file that the operator must look at, and never what identifies a patient inside it; the messages of
/// the DICOM library are left out because they may quote attribute values.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The path is a file or something else.
    #[error("{} is no folder, no DICOM and no image file (NIfTI, MetaImage, NRRD): name the folder that holds the DICOM files of the series, or an image file", .0.display())]
    NotAFolder(PathBuf),
    /// The system does not let it be read.
    #[error("cannot read {}: {source}: check that it exists and may be read", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// There is no file at all.
    #[error("{} holds no file: name the folder that holds the DICOM files of the series", .0.display())]
    Empty(PathBuf),
    /// There are files but none is DICOM.
    #[error("{} holds no DICOM file among its {n_files}: {}", path.display(), instead(*n_image_files))]
    NoDicom {
        /// The folder.
        path: PathBuf,
        /// Files in it.
        n_files: usize,
        /// How many of them are NIfTI, MetaImage or NRRD.
        n_image_files: usize,
    },
    /// There are DICOM files but no image with a place in the patient.
    #[error("{} holds DICOM files but no image of a series of planes (localizers and reports do not count): choose another folder; a DICOM SEG or RTSTRUCT is given with --segmentation", .0.display())]
    NoImages(PathBuf),
    /// A DICOM file that cannot be parsed or decoded.
    #[error("{}: damaged DICOM file ({what}): copy or export it again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: &'static str,
    },
    /// Compressed pixels that give no image.
    #[error("{}{}: {fault} ({syntax}): copy or export it again, uncompressed (explicit VR little endian) if it persists", path.display(), frame.map_or(String::new(), |n| format!(", frame {n}")))]
    Undecodable {
        /// The file.
        path: PathBuf,
        /// Number of the frame from 1, where the file holds several.
        frame: Option<usize>,
        /// Name of the transfer syntax.
        syntax: &'static str,
        /// What is wrong.
        fault: Fault,
    },
    /// A directory of files none of which is there.
    #[error("{}: none of the {n_named} files that this DICOMDIR names is there: copy the whole medium, folders included", path.display())]
    DirectoryWithoutFiles {
        /// The directory.
        path: PathBuf,
        /// Images that it names.
        n_named: usize,
    },
    /// A file ends before its pixels do.
    #[error("{}: truncated: {found_bytes} bytes, its pixels need {expected_bytes}: copy or export it again", path.display())]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Bytes present.
        found_bytes: usize,
        /// Bytes that rows, columns and bits ask for.
        expected_bytes: usize,
    },
    /// An attribute without which the image cannot be placed or read.
    #[error("{}: attribute {attribute} is missing: export the series again with complete headers", path.display())]
    MissingAttribute {
        /// The file.
        path: PathBuf,
        /// The attribute's DICOM keyword.
        attribute: &'static str,
    },
    /// An attribute that makes no sense.
    #[error("{}: attribute {attribute} is {found}, expected {expected}: export the series again", path.display())]
    BadAttribute {
        /// The file.
        path: PathBuf,
        /// The attribute's DICOM keyword.
        attribute: &'static str,
        /// The numbers found.
        found: String,
        /// What is allowed.
        expected: &'static str,
    },
    /// A kind of image that is not read.
    #[error("{}: {what} cannot be read: export the series as single-frame monochrome images of 8 or 16 bits", path.display())]
    UnsupportedImage {
        /// The file.
        path: PathBuf,
        /// What it is.
        what: String,
    },
    /// A compression that is not built in.
    #[error("{}: compressed as {syntax}, which is not supported: export the series uncompressed (explicit VR little endian)", path.display())]
    UnsupportedSyntax {
        /// The file.
        path: PathBuf,
        /// Name of the transfer syntax.
        syntax: String,
    },
    /// More than one series and none chosen.
    #[error("{n} series in the folder ({listing}): choose one by its number, or give each its own folder")]
    SeveralSeries {
        /// How many.
        n: usize,
        /// The series, numbered.
        listing: String,
    },
    /// The chosen number does not exist.
    #[error("there is no series number {number} ({listing}): choose one of these numbers")]
    NoSuchSeries {
        /// The number asked for.
        number: usize,
        /// The series, numbered.
        listing: String,
    },
    /// No series of the folder has the given UID.
    #[error(
        "no series of the folder has the given SeriesInstanceUID ({listing}): choose one of these by its number"
    )]
    NoSeriesOfUid {
        /// The series, numbered.
        listing: String,
    },
    /// The series that a case was made from is not there any more.
    #[error(
        "the folder no longer holds the series that the case was made from (it was number {number}; now: {listing}): start a new case with another --out"
    )]
    SeriesGone {
        /// Its number when the case was made.
        number: usize,
        /// The series that are there, numbered.
        listing: String,
    },
    /// An image of other size, orientation or pixel spacing than the rest of its series.
    #[error("{}: {found}, but the other {n_others} images of its series have {expected}: remove the file, or export the series again", path.display())]
    OddImage {
        /// The file.
        path: PathBuf,
        /// Its size, spacing, orientation.
        found: String,
        /// Theirs.
        expected: String,
        /// How many the others are.
        n_others: usize,
    },
    /// A volume needs two planes.
    #[error("the series has {0} plane, expected at least 2: name the folder of the whole series")]
    TooFewPlanes(usize),
    /// Two different images at one place.
    #[error("{} and {} lie both at z = {z_mm:.3} mm but differ (several phases or reconstructions in one series?): keep one of them", first.display(), second.display())]
    ConflictingPlanes {
        /// One file.
        first: PathBuf,
        /// The other.
        second: PathBuf,
        /// Their place along the normal.
        z_mm: f64,
    },
    /// Planes are missing.
    #[error("{n_missing} plane(s) missing between z = {below_mm:.3} and {above_mm:.3} mm (planes lie {step_mm:.3} mm apart{}): \
             export the series again, or have the gap bridged with --allow-gaps", if *n_gaps > 1 { format!("; {n_gaps} such gaps") } else { String::new() })]
    MissingPlanes {
        /// Last plane before the first gap.
        below_mm: f64,
        /// First plane after it.
        above_mm: f64,
        /// How many seem to be missing there.
        n_missing: usize,
        /// The usual distance.
        step_mm: f64,
        /// Gaps in all.
        n_gaps: usize,
    },
    /// The planes are sheared against their normal by more than any gantry tilts.
    #[error(
        "the planes lie on a line {angle_deg:.2} degrees off their normal, expected at most 45 (a gantry tilt): \
             export the series again, its positions or orientation are wrong"
    )]
    GantryTilt {
        /// Angle between the planes' normal and the line on which they are stacked.
        angle_deg: f64,
    },
    /// One plane lies beside the others.
    #[error("{}: the image lies {offset_mm:.3} mm beside the line of the others: remove the file, or export the series again", path.display())]
    ShiftedPlane {
        /// The file.
        path: PathBuf,
        /// How far.
        offset_mm: f64,
    },
    /// The volume does not fit into memory.
    #[error("the volume of {} x {} x {} voxels is too large for this machine's memory: export fewer planes", dims[0], dims[1], dims[2])]
    TooLarge {
        /// Columns, rows, planes.
        dims: [usize; 3],
    },
    /// An image file that is no DICOM and cannot be used.
    #[error("{}: {fault}", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        fault: super::ImageFault,
    },
    /// An image file with several volumes and none chosen.
    #[error("{} holds {n} volumes ({listing}): choose one of them with --series N", path.display())]
    SeveralVolumes {
        /// The file.
        path: PathBuf,
        /// How many.
        n: usize,
        /// What they are.
        listing: String,
    },
    /// The work was interrupted.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// What to name in the place of a folder without DICOM files.
fn instead(n_image_files: usize) -> String {
    match n_image_files {
        0 => "name the folder of a series as the scanner or archive exports it".into(),
        1 => "one of them is an image file (NIfTI, MetaImage, NRRD), name that file itself".into(),
        n => format!("{n} of them are image files (NIfTI, MetaImage, NRRD), name one of those itself"),
    }
}

impl Error {
    /// The message with every path in it replaced: paths may hold a patient's name, and are for the operator's own eyes only.
    #[must_use]
    pub fn text_with(&self, name: impl Fn(&Path) -> String) -> String {
        let mut text = self.to_string();
        for path in self.paths() {
            text = text.replace(&path.display().to_string(), &name(path));
        }
        text
    }

    /// The paths that the message names. Without a wildcard: who adds a variant has to think of it.
    fn paths(&self) -> Vec<&Path> {
        match self {
            Self::NotAFolder(path) | Self::Empty(path) | Self::NoImages(path) => vec![path],
            Self::Read { path, .. }
            | Self::NoDicom { path, .. }
            | Self::Damaged { path, .. }
            | Self::Truncated { path, .. }
            | Self::MissingAttribute { path, .. }
            | Self::BadAttribute { path, .. }
            | Self::UnsupportedImage { path, .. }
            | Self::UnsupportedSyntax { path, .. }
            | Self::Undecodable { path, .. }
            | Self::DirectoryWithoutFiles { path, .. }
            | Self::OddImage { path, .. }
            | Self::Image { path, .. }
            | Self::SeveralVolumes { path, .. }
            | Self::ShiftedPlane { path, .. } => vec![path],
            // The longer one first: it may begin with the other.
            Self::ConflictingPlanes { first, second, .. } => {
                if first.as_os_str().len() < second.as_os_str().len() {
                    vec![second, first]
                } else {
                    vec![first, second]
                }
            }
            Self::SeveralSeries { .. }
            | Self::NoSuchSeries { .. }
            | Self::NoSeriesOfUid { .. }
            | Self::SeriesGone { .. }
            | Self::TooFewPlanes(_)
            | Self::MissingPlanes { .. }
            | Self::GantryTilt { .. }
            | Self::TooLarge { .. }
            | Self::Cancelled(_) => Vec::new(),
        }
    }
}
