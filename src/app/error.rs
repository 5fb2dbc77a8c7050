//! What can go wrong on the way, and the exit code it means.

use super::atomic::FileError;
use super::case::CaseError;
use super::settings::SettingError;
use super::volume_file::VolumeFileError;
use crate::{
    brep, ct, mesh, model, motion, phantom, preview, printer, profile, progress, ready, report, sections,
    segment, slice, solid, toolpath, topology, view,
};
use std::path::{Path, PathBuf};

/// Why a case could not be worked on.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operator asked to stop.
    #[error(transparent)]
    Interrupted(#[from] progress::Cancelled),
    /// A parameter cannot be used; as the flag that gives it.
    #[error("{}: {}", shown(&.0.name), .0.fault)]
    Setting(#[from] SettingError),
    /// A case file cannot be used. Its path is the operator's own, and may name a patient.
    #[error("{}: {problem}", path.display())]
    CaseFile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// A file that the operator named as input cannot be read. Its path may name a patient.
    #[error(transparent)]
    InputFile(FileError),
    /// A document of contours that the operator named as input cannot be used. Its path may name a patient.
    #[error("{}: {source}", path.display())]
    InputSections {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: sections::format::FormatError,
    },
    /// There is nothing at the place of the CT.
    #[error("--ct: found nothing at {}, expected a folder with the DICOM files of a series", .0.display())]
    CtMissing(PathBuf),
    /// There is nothing at the place of the ready segmentation.
    #[error("--segmentation: found nothing at {}, expected a label map, a DICOM SEG or an RTSTRUCT", .0.display())]
    SegmentationMissing(PathBuf),
    /// The ready segmentation of a case is not known on this machine.
    #[error("where the segmentation of {} lies is not known on this machine: name it with --segmentation", .0.display())]
    SegmentationUnknown(PathBuf),
    /// The CT of a case is not known on this machine.
    #[error("where the CT of {} lies is not known on this machine: name it with --ct", .0.display())]
    CtUnknown(PathBuf),
    /// The CT that a report is to be filed with is not the one that the case was made from. The path may name a patient.
    #[error(
        "--source: the files at {} are not the CT that {} was made from: its report is filed in the study of that CT only",
        .ct.display(),
        .case.display()
    )]
    NotItsCt {
        /// What was named.
        ct: PathBuf,
        /// The case directory.
        case: PathBuf,
    },
    /// The report could not be filed in the patient's study. A fault of the CT names its files.
    #[error(transparent)]
    Filing(report::filing::Error),
    /// The scan of the replica could not be read.
    #[error("--scan: {0}")]
    Scan(#[source] ct::Error),
    /// The system gave no threads or no program.
    #[error("cannot start what the print needs: {0}: close other programs and try again")]
    Runtime(#[source] std::io::Error),
    /// The case directory.
    #[error(transparent)]
    Case(#[from] CaseError),
    /// A file.
    #[error(transparent)]
    File(#[from] FileError),
    /// The kept part of the CT.
    #[error("{}: {source}: run `lumenfab segment` on the case again", path.display())]
    Volume {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: VolumeFileError,
    },
    /// The case's document of contours.
    #[error("{}: {source}", path.display())]
    SectionsFile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: sections::format::FormatError,
    },
    /// A model that another program made.
    #[error("{}: {source}", path.display())]
    Model {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: model::Error,
    },
    /// A model that cannot be printed.
    #[error("{}: {source}", path.display())]
    ModelJob {
        /// The file.
        path: PathBuf,
        /// Why.
        source: Box<Self>,
    },
    /// Reading the CT.
    #[error(transparent)]
    Ct(#[from] ct::Error),
    /// Making the synthetic CT.
    #[error(transparent)]
    Phantom(#[from] phantom::Error),
    /// Finding the lumen.
    #[error(transparent)]
    Segment(#[from] segment::Error),
    /// The region left the vessel: the case is kept with a picture of the place.
    #[error("{leak}; {} shows it", picture.display())]
    Leaked {
        /// Where it left the vessel.
        leak: segment::Error,
        /// The picture.
        picture: PathBuf,
    },
    /// Taking over a ready segmentation.
    #[error(transparent)]
    Ready(#[from] ready::Error),
    /// Finding the contours.
    #[error(transparent)]
    Sections(#[from] sections::Error),
    /// Building the solid.
    #[error(transparent)]
    Solid(#[from] solid::Error),
    /// The solid is not one.
    #[error(transparent)]
    Invalid(#[from] brep::Invalid),
    /// Cutting the layers.
    #[error(transparent)]
    Slice(#[from] slice::Error),
    /// Planning the toolpaths.
    #[error(transparent)]
    Toolpath(#[from] toolpath::Error),
    /// Estimating the job.
    #[error(transparent)]
    Motion(#[from] motion::Error),
    /// The profile.
    #[error(transparent)]
    Profile(#[from] profile::Error),
    /// A job that leaves the build space of the printer that it is for.
    #[error(
        "{}: {leaving} of the profile {profile}; nothing was sent: slice it for this printer, name the one that it was made for, or let it go there with --beyond-bed",
        job.display()
    )]
    BuildSpace {
        /// The job.
        job: PathBuf,
        /// The printer's profile.
        profile: String,
        /// Where.
        leaving: motion::Leaving,
    },
    /// Printing.
    #[error(transparent)]
    Printer(#[from] printer::Error),
    /// The report.
    #[error(transparent)]
    Report(#[from] report::Error),
    /// The folder for pictures of layers is none, or holds something.
    #[error("--preview: {} is not an empty folder: name a new or empty one", .0.display())]
    PreviewFolder(PathBuf),
    /// Drawing the layers.
    #[error(transparent)]
    Preview(#[from] preview::Error),
    /// Drawing the solid.
    #[error(transparent)]
    View(#[from] view::Error),
    /// Writing the mesh.
    #[error(transparent)]
    Mesh(#[from] mesh::Error),
}

/// A parameter as it is given: on the command line a flag; a key of a table in the case file only.
fn shown(name: &str) -> String {
    if name.contains('.') { name.to_owned() } else { format!("--{}", name.replace('_', "-")) }
}

impl Error {
    /// Whether the work ended because the operator asked it to, in whatever words a stage says so. A fault that shows
    /// itself meanwhile is none of these: a printer that vanished may still be hot.
    #[must_use]
    pub const fn is_interruption(&self) -> bool {
        matches!(
            self,
            Self::Interrupted(_)
                | Self::Ct(ct::Error::Cancelled(_))
                | Self::Phantom(phantom::Error::Cancelled(_))
                | Self::Segment(segment::Error::Cancelled(_))
                | Self::Ready(ready::Error::Cancelled(_) | ready::Error::Image(ct::Error::Cancelled(_)))
                | Self::Sections(sections::Error::Cancelled(_))
                | Self::Solid(solid::Error::Cancelled(_))
                | Self::Mesh(mesh::Error::Cancelled(_))
                | Self::View(view::Error::Cancelled(_))
                | Self::Preview(preview::Error::Cancelled(_))
                | Self::Slice(slice::Error::Cancelled(_))
                | Self::Toolpath(toolpath::Error::Cancelled(_))
                | Self::Motion(motion::Error::Cancelled(_))
                | Self::Report(report::Error::Cancelled(_))
                | Self::Scan(ct::Error::Cancelled(_))
                | Self::Filing(report::filing::Error::Source(ct::Error::Cancelled(_)))
                | Self::Printer(printer::Error::Left { .. })
        ) || matches!(self, Self::Printer(printer::Error::Cancelled { heat }) if heat.is_safe())
    }

    /// The message without the paths of inputs (CT, segmentation, case file, contours, model) and the names of structures, which may hold a
    /// patient's: for what is written or sent on. The operator's own screen shows the whole message.
    #[must_use]
    pub fn text_without_sources(&self) -> String {
        match self {
            Self::Ct(e) | Self::Filing(report::filing::Error::Source(e)) => {
                e.text_with(|_| "a file of the CT".into())
            }
            Self::Scan(e) => format!("--scan: {}", e.text_with(|_| "a file of the scan".into())),
            Self::NotItsCt { .. } => {
                "--source: the files there are not the CT that the case was made from".into()
            }
            Self::CtMissing(_) => {
                "--ct: found nothing there, expected a folder with the DICOM files of a series".into()
            }
            Self::Ready(e) => e.text_without_path(),
            Self::SegmentationMissing(_) => {
                "--segmentation: found nothing there, expected a label map, a DICOM SEG or an RTSTRUCT".into()
            }
            Self::CaseFile { problem, .. } => format!("the case file: {problem}"),
            Self::InputFile(FileError { action, source, .. }) => {
                FileError { action, path: "the input file".into(), source: source.kind().into() }.to_string()
            }
            Self::InputSections { source, .. } => format!("the contours: {source}"),
            Self::Model { source, .. } => format!("the model: {source}"),
            Self::ModelJob { source, .. } => format!("the model: {}", source.text_without_sources()),
            // Paths of these are the case's, a profile's, or those that the operator names for results.
            Self::Interrupted(_)
            | Self::Setting(_)
            | Self::SegmentationUnknown(_)
            | Self::CtUnknown(_)
            | Self::Runtime(_)
            | Self::Case(_)
            | Self::File(_)
            | Self::Volume { .. }
            | Self::SectionsFile { .. }
            | Self::Phantom(_)
            | Self::Segment(_)
            | Self::Leaked { .. }
            | Self::Sections(_)
            | Self::Solid(_)
            | Self::Invalid(_)
            | Self::Slice(_)
            | Self::Toolpath(_)
            | Self::Motion(_)
            | Self::Profile(_)
            | Self::BuildSpace { .. }
            | Self::Printer(_)
            | Self::Report(_)
            | Self::Filing(_)
            | Self::PreviewFolder(_)
            | Self::Preview(_)
            | Self::View(_)
            | Self::Mesh(_) => self.to_string(),
        }
    }

    /// The fault's stable name for programs, where the stage that found it gives it one.
    #[must_use]
    pub const fn code(&self) -> Option<&'static str> {
        match self {
            Self::Ct(e) => Some(e.code()),
            Self::Phantom(e) => Some(e.code()),
            Self::Segment(e) => Some(e.code()),
            Self::Leaked { leak, .. } => Some(leak.code()),
            Self::Ready(e) => Some(e.code()),
            Self::Sections(e) => Some(e.code()),
            Self::Printer(e) => Some(e.code()),
            // What prepares jobs of the queue does the stages that are missing.
            Self::Case(CaseError::Stale { .. }) => Some("case.stale"),
            _ => None,
        }
    }

    /// The same fault with the model's file that has it; an interruption is none.
    #[must_use]
    pub(crate) fn of_model(self, path: &Path) -> Self {
        if self.is_interruption() {
            self
        } else {
            Self::ModelJob { path: path.to_owned(), source: Box::new(self) }
        }
    }

    /// An interruption in one word; every other error as it is, and the end of a print too: it tells what became of the heaters.
    pub(crate) fn or_interrupted(self) -> Self {
        let is_of_printer = matches!(self, Self::Printer(_));
        if self.is_interruption() && !is_of_printer { Self::Interrupted(progress::Cancelled) } else { self }
    }

    /// The process's exit code: 1 the work failed, 2 wrong usage or configuration, 130 interrupted.
    #[must_use]
    pub const fn exit_code(&self) -> u8 {
        match self {
            interrupted if interrupted.is_interruption() => 130,
            Self::Ct(e) | Self::Scan(e) if e.is_choice() => 2,
            Self::Ready(e) if e.is_choice() => 2,
            Self::Segment(e) if e.is_choice() => 2,
            Self::Phantom(
                phantom::Error::OutOfRange { .. }
                | phantom::Error::TooLarge { .. }
                | phantom::Error::WithoutVessel { .. },
            ) => 2,
            Self::Setting(_)
            | Self::CaseFile { .. }
            | Self::CtMissing(_)
            | Self::CtUnknown(_)
            | Self::SegmentationMissing(_)
            | Self::SegmentationUnknown(_)
            | Self::NotItsCt { .. }
            | Self::Filing(report::filing::Error::Object(_))
            | Self::PreviewFolder(_)
            | Self::Profile(_)
            | Self::Solid(solid::Error::Topology(topology::Error::Decision { .. }))
            | Self::Case(
                CaseError::Missing(_)
                | CaseError::NotACase(_)
                | CaseError::Occupied(_)
                | CaseError::OtherSource(_)
                | CaseError::Edited { .. }
                | CaseError::ContoursLost(_)
                | CaseError::NotYet { .. }
                | CaseError::Stale { .. },
            ) => 2,
            _ => 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_path_of_a_model_is_for_the_operators_eyes_alone() {
        let job = Error::Slice(slice::Error::from(progress::Cancelled));
        let error = Error::ModelJob { path: "DOE_JANE.stl".into(), source: Box::new(job) };
        assert!(error.to_string().starts_with("DOE_JANE.stl: "), "{error}");
        let told = error.text_without_sources();
        assert!(told.starts_with("the model: ") && !told.contains("DOE"), "{told}");
    }

    #[test]
    fn only_an_interruption_is_one() {
        let heat = printer::protocol::Heat::Obeyed;
        let cancelled = Error::Printer(printer::Error::Cancelled { heat });
        assert_eq!(cancelled.exit_code(), 130);
        let told = cancelled.or_interrupted().to_string();
        assert!(told.starts_with("the print was cancelled") && told.contains("heaters"), "{told}");
        let sliced = Error::Slice(progress::Cancelled.into());
        assert_eq!(sliced.exit_code(), 130);
        assert!(matches!(sliced.or_interrupted(), Error::Interrupted(_)));
        let vanished = Error::Printer(printer::Error::PortVanished { port: "p".into() });
        assert_eq!(vanished.exit_code(), 1);
        let told = vanished.or_interrupted().to_string();
        assert!(told.contains("whether the heaters are on is unknown"), "{told}");
    }
}
