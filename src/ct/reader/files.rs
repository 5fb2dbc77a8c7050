//! The files below a folder, and what each of them is.

use super::super::series::Header;
use super::super::{Error, PHANTOM_TRUTH_FILE, Warning};
use super::header::{self, Content};
use super::{in_parallel, left_out};
use crate::progress::Task;
use std::fs::{self, File};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// What a folder holds.
#[derive(Debug)]
pub(super) struct Folder {
    /// Headers of the images, in the order of their paths.
    pub(super) images: Vec<Header>,
    pub(super) n_files: usize,
    /// About what was left out.
    pub(super) warnings: Vec<Warning>,
    /// DICOM files that cannot be read.
    pub(super) faults: Vec<Error>,
}

/// What one file is.
enum Kind {
    Foreign,
    Dicom(Result<Content, Error>),
}

/// Looks at all files below the folder.
pub(super) fn scan(folder: &Path, task: &Task<'_>) -> Result<Folder, Error> {
    let files = list(folder)?;
    if files.is_empty() {
        return Err(Error::Empty(folder.to_owned()));
    }
    let kinds = in_parallel(&files, task, |path| look_at(path))?;
    if kinds.iter().all(|k| matches!(k, Kind::Foreign)) {
        return Err(Error::NoDicom { path: folder.to_owned(), n_files: files.len() });
    }
    let mut found =
        Folder { images: Vec::new(), n_files: files.len(), warnings: Vec::new(), faults: Vec::new() };
    let (mut n_foreign, mut n_localizers, mut n_captures, mut n_others) = (0, 0, 0, 0);
    for (path, kind) in files.iter().zip(kinds) {
        match kind {
            Kind::Dicom(Ok(Content::Image(header))) => found.images.push(*header),
            Kind::Dicom(Ok(Content::Localizer)) => n_localizers += 1,
            Kind::Dicom(Ok(Content::SecondaryCapture)) => n_captures += 1,
            Kind::Dicom(Ok(Content::Other)) => n_others += 1,
            Kind::Dicom(Err(fault)) => found.faults.push(fault),
            Kind::Foreign if path.file_name().is_some_and(|n| n == PHANTOM_TRUTH_FILE) => {}
            Kind::Foreign => n_foreign += 1,
        }
    }
    found.warnings.extend(left_out("ct.not_dicom", n_foreign, "file(s) that are not DICOM"));
    found.warnings.extend(left_out("ct.localizer", n_localizers, "localizer image(s)"));
    found.warnings.extend(left_out("ct.secondary_capture", n_captures, "picture(s) of a screen"));
    found.warnings.extend(left_out(
        "ct.not_an_image_plane",
        n_others,
        "DICOM object(s) that are no image planes",
    ));
    Ok(found)
}

/// All regular files below a folder, sorted, hidden ones left out.
fn list(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let metadata = fs::metadata(folder).map_err(|e| unreadable(folder, e))?;
    if !metadata.is_dir() {
        return Err(Error::NotAFolder(folder.to_owned()));
    }
    let mut files = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(&next).map_err(|e| unreadable(&next, e))? {
            let entry = entry.map_err(|e| unreadable(&next, e))?;
            if entry.file_name().to_string_lossy().starts_with('.') {
                continue;
            }
            // Links to folders are not followed: they may lead round in a circle.
            let kind = entry.file_type().map_err(|e| unreadable(&entry.path(), e))?;
            if kind.is_dir() {
                folders.push(entry.path());
            } else if kind.is_file() || (kind.is_symlink() && entry.path().is_file()) {
                files.push(entry.path());
            }
        }
    }
    files.sort();
    Ok(files)
}

pub(super) fn unreadable(path: &Path, source: io::Error) -> Error {
    Error::Read { path: path.to_owned(), source }
}

fn look_at(path: &Path) -> Kind {
    match has_dicom_mark(path) {
        Err(e) => Kind::Dicom(Err(unreadable(path, e))),
        Ok(true) => Kind::Dicom(header::read(path)),
        // A file that is called DICOM and is not was damaged: it may have been a plane.
        Ok(false) if is_called_dicom(path) => {
            Kind::Dicom(Err(Error::Damaged { path: path.to_owned(), what: "the mark DICM is missing" }))
        }
        Ok(false) => Kind::Foreign,
    }
}

/// Whether "DICM" stands behind the preamble of 128 bytes (PS3.10 7.1).
fn has_dicom_mark(path: &Path) -> io::Result<bool> {
    let mut start = Vec::with_capacity(132);
    File::open(path)?.take(132).read_to_end(&mut start)?;
    Ok(start.get(128..) == Some(b"DICM"))
}

fn is_called_dicom(path: &Path) -> bool {
    let is_one_of = |e: &std::ffi::OsStr| ["dcm", "dicom", "ima"].iter().any(|n| e.eq_ignore_ascii_case(n));
    path.extension().is_some_and(is_one_of)
}
