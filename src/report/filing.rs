//! The report of a case into the patient's study: headers of the CT and the document from files, the DICOM object to a file.

use super::dicom::{self, Instance};
use crate::ct::reader;
use crate::progress::Task;
use dicom_dictionary_std::tags;
use dicom_object::{InMemDicomObject, OpenFileOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Why a report could not be filed.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The CT cannot be read. The message may name files of the patient's.
    #[error(transparent)]
    Source(#[from] crate::ct::Error),
    /// The headers fit no study, or the object cannot be made.
    #[error(transparent)]
    Object(#[from] dicom::Error),
    /// A file of the report.
    #[error("cannot {action} {}: {source}", path.display())]
    File {
        /// What was tried.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

/// Writes `report.pdf` of a report's directory as an Encapsulated PDF into `dir`, in the study of the CT at `source`. The file is
/// named after its own new identifier. Gives its path.
///
/// # Errors
/// [`Error`]: a CT that cannot be read, images of several studies, no document, a folder that cannot be written.
pub fn file(
    report_dir: &Path,
    source: &Path,
    dir: &Path,
    instance: &Instance,
    task: &Task<'_>,
) -> Result<PathBuf, Error> {
    let pdf_path = report_dir.join("report.pdf");
    let pdf = std::fs::read(&pdf_path).map_err(|e| failed("read", &pdf_path, e))?;
    let object = dicom::encapsulated(&headers(source, task)?, &pdf, instance)?;
    let mut bytes = Vec::with_capacity(pdf.len() + 4096);
    let unwritable = |_private| dicom::Error::Object("a value of its header cannot be encoded".into());
    object.write_all(&mut bytes).map_err(unwritable)?;
    std::fs::create_dir_all(dir).map_err(|e| failed("make", dir, e))?;
    let path = dir.join(format!("{}.dcm", instance.instance_uid));
    put(dir, &path, &bytes).map_err(|e| failed("write", &path, e))?;
    Ok(path)
}

/// The headers of all images of a CT, without their pixels.
fn headers(source: &Path, task: &Task<'_>) -> Result<Vec<InMemDicomObject>, Error> {
    let mut headers = Vec::new();
    for path in reader::files_of(source, task)? {
        // Files beside the images are no images.
        let opened = OpenFileOptions::new().read_until(tags::PIXEL_DATA).open_file(path);
        headers.extend(opened.ok().map(dicom_object::FileDicomObject::into_inner).filter(|h| {
            h.get(tags::SOP_INSTANCE_UID).is_some() && h.get(tags::PIXEL_REPRESENTATION).is_some()
        }));
    }
    Ok(headers)
}

/// Complete or not at all; readable by its owner alone, for it says who the patient is.
fn put(dir: &Path, path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut fresh = tempfile::NamedTempFile::new_in(dir)?;
    fresh.write_all(bytes)?;
    fresh.as_file().sync_data()?;
    fresh.persist_noclobber(path)?;
    Ok(())
}

fn failed(action: &'static str, path: &Path, source: std::io::Error) -> Error {
    Error::File { action, path: path.to_owned(), source }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dicom_dictionary_std::uids;

    fn instance() -> Instance {
        Instance::of_uuids(1, 2, jiff::civil::date(2026, 5, 6).at(7, 8, 9, 0))
    }

    #[test]
    fn a_report_is_filed_in_the_study_of_its_ct() {
        let place = tempfile::tempdir().unwrap();
        let params =
            crate::phantom::Params { n_planes: 4, n_pixels: 64, ..crate::phantom::Params::default() };
        let ct = place.path().join("ct");
        crate::phantom::series::write(&ct, &params, &Task::quiet()).unwrap();
        let report = place.path().join("report");
        std::fs::create_dir(&report).unwrap();
        let filed = |report: &Path| file(report, &ct, &place.path().join("out"), &instance(), &Task::quiet());
        assert!(matches!(filed(&report), Err(Error::File { action: "read", .. })));
        std::fs::write(report.join("report.pdf"), b"%PDF-1.7 x").unwrap();
        let path = filed(&report).unwrap();
        assert!(path.ends_with("2.25.2.dcm"));
        let object = dicom_object::open_file(&path).unwrap();
        let image = dicom_object::open_file(ct.join("IM0001.dcm")).unwrap();
        let study = |o: &InMemDicomObject| {
            o.element(tags::STUDY_INSTANCE_UID).unwrap().to_str().unwrap().into_owned()
        };
        assert_eq!(study(&object), study(&image));
        assert_eq!(object.element(tags::SOURCE_INSTANCE_SEQUENCE).unwrap().items().unwrap().len(), 4);
        assert_eq!(
            object.meta().media_storage_sop_class_uid.trim_end_matches('\0'),
            uids::ENCAPSULATED_PDF_STORAGE
        );
        // A second time under the same identifier would replace an object that others may know.
        assert!(matches!(filed(&report), Err(Error::File { action: "write", .. })));
    }
}
