//! The use cases: a case directory, the stages on it, and the whole way from CT to report.
//!
//! A [`Session`] works on one [`case`]: it does the stages that are asked for, each only when something it is made from
//! has changed, and tells what happens as [`Event`]s. Faces (the command line, later others) give it parameters as a
//! [`settings::CaseFile`] and show events and the [`Outcome`].
//!
//! IO lives here: files of the case, the clock for the time per stage, the generated name of a case.

pub mod atomic;
pub mod case;
pub mod commanded;
pub mod errand;
pub mod error;
pub mod event;
pub mod packed;
pub mod seal;
pub mod session;
pub mod settings;
pub mod source;
pub mod stages;
pub mod volume_file;

pub use error::Error;
pub use event::{Event, EventSink, Stage, StageOutcome};
pub use session::{Context, Outcome, Session};
pub use stages::ask::{SafeOff, detect, safe_off};
pub use stages::export::{Deflection, Export, Exported, Skin, SteppedSolid};
pub use stages::model::{ModelJob, SlicedModel, is_model, slice_model};
pub use stages::print::{FilePrinter, Printed, Printer, ResumePrinter, print_file, resume_file};
pub use stages::report::ReportPlace;
pub use stages::view::{Colouring, View};

use settings::{CaseFile, Seed, Seeds, SeriesKey, Settings};
use std::path::{Path, PathBuf};

/// Reads an input case file; a relative `ct` in it is taken from the file's own directory.
///
/// # Errors
/// [`Error::CaseFile`] where it says something that cannot be used, [`Error::File`] where it cannot be read.
pub fn read_case_file(path: &Path) -> Result<CaseFile, Error> {
    let problem = |problem| Error::CaseFile { path: path.to_owned(), problem };
    let text = match atomic::read_text(path) {
        Err(e) if e.source.kind() == std::io::ErrorKind::NotFound => {
            return Err(problem("not found: expected a case directory or a case file (TOML)".into()));
        }
        other => other.map_err(Error::InputFile)?,
    };
    let mut file = CaseFile::from_toml(&text).map_err(problem)?;
    if file.id.is_some() {
        return Err(problem("this is the copy inside a case: name its directory instead".into()));
    }
    // What flags may still add is no fault of the file; what it says has to be right.
    let any_seed = || file.segmentation.is_none().then(|| Seeds(vec![Seed::Point([0.0; 3])]));
    let seed_mm = file.seed_mm.clone().or_else(any_seed);
    let ct = file.ct.clone().or_else(|| file.phantom.is_none().then(PathBuf::new));
    // A UID is looked up once the CT is known.
    let series = file.series.clone().map(|key| match key {
        SeriesKey::Uid(_) => SeriesKey::Number(1),
        number @ SeriesKey::Number(_) => number,
    });
    Settings::try_from(CaseFile { ct, seed_mm, series, ..file.clone() })
        .map_err(|e| problem(e.to_string()))?;
    file.ct = file.ct.map(|ct| atomic::parent(path).join(ct));
    file.segmentation = file.segmentation.map(|other| atomic::parent(path).join(other));
    Ok(file)
}
