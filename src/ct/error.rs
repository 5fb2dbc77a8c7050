//! Why a series cannot be read. One line each: which file, what was found, what to do.

use super::codec::Fault;
use crate::progress::Cancelled;
use std::path::{Path, PathBuf};

/// Why no volume was made.
///
/// Messages are made by [`Error::text_with`]. Texts name the file that the operator must look at, and never what identifies a patient inside it; the messages of
/// the DICOM library are left out because they may quote attribute values.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The path is a file or something else.
    NotAFolder(PathBuf),
    /// The system does not let it be read.
    Read {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// There is no file at all.
    Empty(PathBuf),
    /// There are files but none is DICOM.
    NoDicom {
        /// The folder.
        path: PathBuf,
        /// Files in it.
        n_files: usize,
        /// How many of them are NIfTI, MetaImage or NRRD.
        n_image_files: usize,
    },
    /// There are DICOM files but no image with a place in the patient.
    NoImages(PathBuf),
    /// A DICOM file that cannot be parsed or decoded.
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: &'static str,
    },
    /// Compressed pixels that give no image.
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
    /// A damaged file that names none of the series that could be read.
    DamagedBeside {
        /// What is wrong with it.
        fault: Box<Self>,
    },
    /// A directory of files none of which is there.
    DirectoryWithoutFiles {
        /// The directory.
        path: PathBuf,
        /// Images that it names.
        n_named: usize,
    },
    /// A file ends before its pixels do.
    Truncated {
        /// The file.
        path: PathBuf,
        /// Bytes present.
        found_bytes: usize,
        /// Bytes that rows, columns and bits ask for.
        expected_bytes: usize,
    },
    /// An attribute without which the image cannot be placed or read.
    MissingAttribute {
        /// The file.
        path: PathBuf,
        /// The attribute's DICOM keyword.
        attribute: &'static str,
    },
    /// An attribute that makes no sense.
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
    UnsupportedImage {
        /// The file.
        path: PathBuf,
        /// What it is.
        what: String,
    },
    /// A compression that is not built in.
    UnsupportedSyntax {
        /// The file.
        path: PathBuf,
        /// Name of the transfer syntax.
        syntax: String,
    },
    /// More than one series and none chosen.
    SeveralSeries {
        /// How many.
        n: usize,
        /// The series, numbered.
        listing: String,
    },
    /// The chosen number does not exist.
    NoSuchSeries {
        /// The number asked for.
        number: usize,
        /// The series, numbered.
        listing: String,
    },
    /// No series of the folder has the given UID.
    NoSeriesOfUid {
        /// The series, numbered.
        listing: String,
    },
    /// The series that a case was made from is not there any more.
    SeriesGone {
        /// Its number when the case was made.
        number: usize,
        /// The series that are there, numbered.
        listing: String,
    },
    /// An image of other size, orientation or pixel spacing than the rest of its series.
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
    TooFewPlanes(usize),
    /// Two different images at one place.
    ConflictingPlanes {
        /// One file.
        first: PathBuf,
        /// The other.
        second: PathBuf,
        /// Their place along the normal.
        z_mm: f64,
    },
    /// Planes are missing.
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
    GantryTilt {
        /// Angle between the planes' normal and the line on which they are stacked.
        angle_deg: f64,
    },
    /// One plane lies beside the others.
    ShiftedPlane {
        /// The file.
        path: PathBuf,
        /// How far.
        offset_mm: f64,
    },
    /// The volume does not fit into memory.
    TooLarge {
        /// Columns, rows, planes.
        dims: [usize; 3],
    },
    /// An image file that is no DICOM and cannot be used.
    Image {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        fault: super::ImageFault,
    },
    /// An image file with several volumes and none chosen.
    SeveralVolumes {
        /// The file.
        path: PathBuf,
        /// How many.
        n: usize,
        /// What they are.
        listing: String,
    },
    /// The work was interrupted.
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

impl std::fmt::Display for Error {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.text_with(|path| path.display().to_string()))
    }
}

impl Error {
    /// A stable name for programs.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::NotAFolder(_) => "ct.not_a_folder",
            Self::Read { .. } => "ct.read",
            Self::Empty(_) => "ct.empty",
            Self::NoDicom { .. } => "ct.no_dicom",
            Self::NoImages(_) => "ct.no_images",
            Self::Damaged { .. } => "ct.damaged",
            Self::DamagedBeside { fault } => fault.code(),
            Self::Undecodable { .. } => "ct.undecodable",
            Self::DirectoryWithoutFiles { .. } => "ct.directory_without_files",
            Self::Truncated { .. } => "ct.truncated",
            Self::MissingAttribute { .. } => "ct.missing_attribute",
            Self::BadAttribute { .. } => "ct.bad_attribute",
            Self::UnsupportedImage { .. } => "ct.unsupported_image",
            Self::UnsupportedSyntax { .. } => "ct.unsupported_syntax",
            Self::SeveralSeries { .. } => "ct.several_series",
            Self::NoSuchSeries { .. } => "ct.no_such_series",
            Self::NoSeriesOfUid { .. } => "ct.no_series_of_uid",
            Self::SeriesGone { .. } => "ct.series_gone",
            Self::OddImage { .. } => "ct.odd_image",
            Self::TooFewPlanes(_) => "ct.too_few_planes",
            Self::ConflictingPlanes { .. } => "ct.conflicting_planes",
            Self::MissingPlanes { .. } => "ct.missing_planes",
            Self::GantryTilt { .. } => "ct.gantry_tilt",
            Self::ShiftedPlane { .. } => "ct.shifted_plane",
            Self::TooLarge { .. } => "ct.too_large",
            Self::Image { fault, .. } => fault.code(),
            Self::SeveralVolumes { .. } => "ct.several_volumes",
            Self::Cancelled(_) => "ct.cancelled",
        }
    }

    /// Whether another choice of series mends it, and nothing is wrong with the files.
    #[must_use]
    pub const fn is_choice(&self) -> bool {
        matches!(
            self,
            Self::SeveralSeries { .. }
                | Self::NoSuchSeries { .. }
                | Self::NoSeriesOfUid { .. }
                | Self::SeveralVolumes { .. }
        )
    }

    /// The message with every path in it named as asked: paths may hold a patient's name, and are for the operator's own eyes only.
    #[must_use]
    pub fn text_with(&self, name: impl Fn(&Path) -> String) -> String {
        match self {
            Self::NotAFolder(path) => format!(
                "{} is no folder, no DICOM and no image file (NIfTI, MetaImage, NRRD): name the folder that holds the DICOM files of the series, or an image file",
                name(path)
            ),
            Self::DamagedBeside { fault } => format!(
                "{}; it names no series that could be read here: if it is none of the planes that are wanted, take it out of the folder",
                fault.text_with(name)
            ),
            Self::Read { path, source } => {
                format!("cannot read {}: {source}: check that it exists and may be read", name(path))
            }
            Self::Empty(path) => format!(
                "{} holds no file: name the folder that holds the DICOM files of the series",
                name(path)
            ),
            Self::NoDicom { path, n_files, n_image_files } => {
                let instead = instead(*n_image_files);
                format!("{} holds no DICOM file among its {n_files}: {instead}", name(path))
            }
            Self::NoImages(path) => format!(
                "{} holds DICOM files but no image of a series of planes (localizers and reports do not count): choose another folder; a DICOM SEG or RTSTRUCT is given with --segmentation",
                name(path)
            ),
            Self::Damaged { path, what } => {
                format!("{}: damaged DICOM file ({what}): copy or export it again", name(path))
            }
            Self::Undecodable { path, frame, syntax, fault } => {
                let frame = frame.map_or(String::new(), |n| format!(", frame {n}"));
                format!(
                    "{}{frame}: {fault} ({syntax}): copy or export it again, uncompressed (explicit VR little endian) if it persists",
                    name(path)
                )
            }
            Self::DirectoryWithoutFiles { path, n_named } => format!(
                "{}: none of the {n_named} files that this DICOMDIR names is there: copy the whole medium, folders included",
                name(path)
            ),
            Self::Truncated { path, found_bytes, expected_bytes } => format!(
                "{}: truncated: {found_bytes} bytes, its pixels need {expected_bytes}: copy or export it again",
                name(path)
            ),
            Self::MissingAttribute { path, attribute } => format!(
                "{}: attribute {attribute} is missing: export the series again with complete headers",
                name(path)
            ),
            Self::BadAttribute { path, attribute, found, expected } => format!(
                "{}: attribute {attribute} is {found}, expected {expected}: export the series again",
                name(path)
            ),
            Self::UnsupportedImage { path, what } => format!(
                "{}: {what} cannot be read: export the series as single-frame monochrome images of 8 or 16 bits",
                name(path)
            ),
            Self::UnsupportedSyntax { path, syntax } => format!(
                "{}: compressed as {syntax}, which is not supported: export the series uncompressed (explicit VR little endian)",
                name(path)
            ),
            Self::SeveralSeries { n, listing } => format!(
                "{n} series in the folder ({listing}): choose one with --series N or its SeriesInstanceUID, or give each its own folder"
            ),
            Self::NoSuchSeries { number, listing } => {
                format!("there is no series number {number} ({listing}): choose one of these with --series N")
            }
            Self::NoSeriesOfUid { listing } => format!(
                "no series of the folder has the given SeriesInstanceUID ({listing}): choose one of these with --series N"
            ),
            Self::SeriesGone { number, listing } => format!(
                "the folder no longer holds the series that the case was made from (it was number {number}; now: {listing}): start a new case with another --out"
            ),
            Self::OddImage { path, found, expected, n_others } => format!(
                "{}: {found}, but the other {n_others} images of its series have {expected}: remove the file, or export the series again",
                name(path)
            ),
            Self::TooFewPlanes(n) => {
                format!("the series has {n} plane, expected at least 2: name the folder of the whole series")
            }
            Self::ConflictingPlanes { first, second, z_mm } => format!(
                "{} and {} lie both at z = {z_mm:.3} mm but differ (several phases or reconstructions in one series?): keep one of them",
                name(first),
                name(second)
            ),
            Self::MissingPlanes { below_mm, above_mm, n_missing, step_mm, n_gaps } => {
                let gaps = if *n_gaps > 1 { format!("; {n_gaps} such gaps") } else { String::new() };
                format!(
                    "{n_missing} plane(s) missing between z = {below_mm:.3} and {above_mm:.3} mm (planes lie {step_mm:.3} mm apart{gaps}): \
                     export the series again, or have the gap bridged with --allow-gaps"
                )
            }
            Self::GantryTilt { angle_deg } => format!(
                "the planes lie on a line {angle_deg:.2} degrees off their normal, expected at most 45 (a gantry tilt): \
                 export the series again, its positions or orientation are wrong"
            ),
            Self::ShiftedPlane { path, offset_mm } => format!(
                "{}: the image lies {offset_mm:.3} mm beside the line of the others: remove the file, or export the series again",
                name(path)
            ),
            Self::TooLarge { dims: [nx, ny, nz] } => format!(
                "the volume of {nx} x {ny} x {nz} voxels is too large for this machine's memory: export fewer planes"
            ),
            Self::Image { path, fault } => format!("{}: {fault}", name(path)),
            Self::SeveralVolumes { path, n, listing } => {
                format!("{} holds {n} volumes ({listing}): choose one of them with --series N", name(path))
            }
            Self::Cancelled(cancelled) => cancelled.to_string(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_hidden_and_nothing_else_whatever_it_is_called() {
        let found = "1 x 1".to_owned();
        let error = Error::OddImage { path: "1".into(), found, expected: "11 x 1".into(), n_others: 11 };
        assert!(error.to_string().starts_with("1: 1 x 1, but the other 11 images"), "{error}");
        let text = error.text_with(|_| "a file".into());
        assert!(
            text.starts_with("a file: 1 x 1, but the other 11 images of its series have 11 x 1:"),
            "{text}"
        );
        let error = Error::ConflictingPlanes { first: "a".into(), second: "an".into(), z_mm: 0.0 };
        let text = error.text_with(|path| format!("<{}>", path.display()));
        assert!(text.starts_with("<a> and <an> lie both at z = 0.000 mm"), "{text}");
    }
}
