//! The files that a path means, and what each of them is.
//!
//! A folder means all files below it, and a DICOMDIR (PS3.10 8) those and the ones that it names; any other DICOM file
//! means itself. A DICOMDIR in a folder is heeded too: what it names and is not there, is told.

use super::super::series::{Header, Series};
use super::super::{Error, PHANTOM_TRUTH_FILE, Warning};
use super::beginning::{self, Beginning};
use super::header::{self, Content};
use super::{image, in_parallel, left_out, lengths};
use crate::progress::Task;
use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// What a folder holds.
#[derive(Debug)]
pub(super) struct Folder {
    /// Headers of the images, in the order of their paths, frames of a file in their order.
    pub(super) images: Vec<Header>,
    /// All files that were looked at.
    pub(super) files: Vec<PathBuf>,
    /// About what was left out.
    pub(super) warnings: Vec<Warning>,
    /// DICOM files that cannot be read.
    pub(super) damages: Vec<Damage>,
}

/// A DICOM file that cannot be read.
#[derive(Debug)]
pub(super) struct Damage {
    pub(super) fault: Error,
    path: PathBuf,
    /// Its SeriesInstanceUID, where that can be read in spite of it; compared, never shown.
    series: Option<String>,
}

impl Damage {
    /// Whether it may be a plane of that series: unless it says that it is one of another series of the folder, or the images
    /// beside it, in its own folder, are all of others.
    pub(super) fn concerns(&self, series: &Series, all: &[Series]) -> bool {
        if self.is_of_one_of(all) {
            return self.series.as_ref().is_some_and(|uid| series.has_uid(uid));
        }
        self.lies_beside(series) || !all.iter().any(|s| self.lies_beside(s))
    }

    /// The same with a way out where there are series and the file names none of them: it may be no plane at all.
    pub(super) fn beside(self, all: &[Series]) -> Self {
        if all.is_empty() || self.is_of_one_of(all) {
            return self;
        }
        Self { fault: Error::DamagedBeside { fault: Box::new(self.fault) }, ..self }
    }

    fn lies_beside(&self, series: &Series) -> bool {
        series.images.iter().any(|image| image.path.parent() == self.path.parent())
    }

    pub(super) fn is_of_one_of(&self, all: &[Series]) -> bool {
        self.series.as_ref().is_some_and(|uid| all.iter().any(|s| s.has_uid(uid)))
    }
}

/// What one file is.
enum Kind {
    Foreign,
    /// NIfTI, MetaImage or NRRD.
    Image,
    Dicom(Result<Content, Box<Damage>>),
    /// The same without preamble and mark.
    Bare(Result<Content, Box<Damage>>),
}

/// Looks at all files that a path means.
pub(super) fn scan(path: &Path, task: &Task<'_>) -> Result<Folder, Error> {
    let metadata = fs::metadata(path).map_err(|e| unreadable(path, e))?;
    if metadata.is_dir() {
        return scan_folder(path, task);
    }
    // A pipe or a device may never end.
    if !metadata.is_file() {
        return Err(Error::NotAFolder(path.to_owned()));
    }
    let kind = look_at(path, task);
    task.check()?;
    match kind {
        Kind::Foreign | Kind::Image => Err(Error::NotAFolder(path.to_owned())),
        Kind::Dicom(found) if matches!(found, Ok(Content::Directory(_))) || is_called_directory(path) => {
            match path.parent() {
                Some(folder) if folder != Path::new("") => scan_folder(folder, task),
                _ => scan_folder(Path::new("."), task),
            }
        }
        kind => Ok(Finding::default().with(path, kind).into_folder(vec![path.to_owned()])),
    }
}

/// Looks at all files below a folder.
fn scan_folder(folder: &Path, task: &Task<'_>) -> Result<Folder, Error> {
    let mut files = list(folder)?;
    if files.is_empty() {
        return Err(Error::Empty(folder.to_owned()));
    }
    let mut finding = look_at_all(&files, Finding::default(), task)?;
    let named = finding.named(&files);
    finding = look_at_all(&named.unlisted, finding, task)?;
    files.extend(named.unlisted);
    if finding.is_without_dicom() {
        let n_image_files = finding.n_image_files;
        return Err(Error::NoDicom { path: folder.to_owned(), n_files: files.len(), n_image_files });
    }
    if let (Some(missing), true) = (named.missing, finding.folder.images.is_empty()) {
        finding.folder.damages.push(Damage { fault: missing, path: folder.to_owned(), series: None });
    }
    finding.folder.images.sort_by(|a, b| (&a.path, a.frame.number).cmp(&(&b.path, b.frame.number)));
    finding.folder.warnings.extend(named.warning);
    Ok(finding.into_folder(files))
}

fn look_at_all(files: &[PathBuf], finding: Finding, task: &Task<'_>) -> Result<Finding, Error> {
    let kinds = in_parallel(files, task, |path| look_at(path, task))?;
    // A file whose reading was interrupted is no damaged one.
    task.check()?;
    Ok(files.iter().zip(kinds).fold(finding, |finding, (path, kind)| finding.with(path, kind)))
}

/// What was found so far.
struct Finding {
    folder: Folder,
    n_bare: usize,
    n_foreign: usize,
    n_image_files: usize,
    n_localizers: usize,
    n_captures: usize,
    n_others: usize,
    /// Each directory's path and what it names.
    directories: Vec<(PathBuf, Vec<Vec<String>>)>,
}

/// What directories name.
struct Named {
    /// Files outside those that were listed.
    unlisted: Vec<PathBuf>,
    warning: Option<Warning>,
    /// What is wrong where nothing that was named is there.
    missing: Option<Error>,
}

impl Default for Finding {
    fn default() -> Self {
        let folder =
            Folder { images: Vec::new(), files: Vec::new(), warnings: Vec::new(), damages: Vec::new() };
        Self {
            folder,
            n_bare: 0,
            n_foreign: 0,
            n_image_files: 0,
            n_localizers: 0,
            n_captures: 0,
            n_others: 0,
            directories: Vec::new(),
        }
    }
}

impl Finding {
    fn with(mut self, path: &Path, kind: Kind) -> Self {
        match kind {
            Kind::Bare(content) => {
                self.n_bare += usize::from(content.is_ok());
                return self.with(path, Kind::Dicom(content));
            }
            Kind::Dicom(Ok(Content::Images(headers))) => self.folder.images.extend(headers),
            Kind::Dicom(Ok(Content::Localizer)) => self.n_localizers += 1,
            Kind::Dicom(Ok(Content::SecondaryCapture)) => self.n_captures += 1,
            Kind::Dicom(Ok(Content::Other)) => self.n_others += 1,
            Kind::Dicom(Ok(Content::Directory(named))) => self.directories.push((path.to_owned(), named)),
            Kind::Dicom(Err(_)) if is_called_directory(path) => self.folder.warnings.push(Warning::new(
                "ct.directory_damaged",
                "a DICOMDIR cannot be read: whether all files that it names are there is not known",
            )),
            Kind::Dicom(Err(damage)) => self.folder.damages.push(*damage),
            Kind::Foreign if path.file_name().is_some_and(|n| n == PHANTOM_TRUTH_FILE) => {}
            Kind::Foreign => self.n_foreign += 1,
            Kind::Image => self.n_image_files += 1,
        }
        self
    }

    const fn is_without_dicom(&self) -> bool {
        let Self { folder, n_localizers, n_captures, n_others, directories, .. } = self;
        folder.images.is_empty()
            && folder.damages.is_empty()
            && *n_localizers + *n_captures + *n_others == 0
            && directories.is_empty()
    }

    /// Where the files are that the directories name.
    fn named(&self, listed: &[PathBuf]) -> Named {
        let by_plain_name: BTreeMap<PathBuf, &PathBuf> = listed.iter().map(|p| (plain(p), p)).collect();
        let mut named = Named { unlisted: Vec::new(), warning: None, missing: None };
        let (mut n_named, mut n_missing) = (0, 0);
        for (directory, records) in &self.directories {
            for components in records {
                n_named += 1;
                let path = resolve(directory, components);
                match path {
                    Some(path) if by_plain_name.contains_key(&plain(&path)) => {}
                    Some(path) if path.is_file() => named.unlisted.push(path),
                    _ => n_missing += 1,
                }
            }
        }
        named.unlisted.sort();
        named.unlisted.dedup();
        if n_missing > 0 {
            let text = format!(
                "{n_missing} of the {n_named} images that the DICOMDIR names are not there: planes may be missing; copy the whole medium"
            );
            named.warning = Some(Warning::new("ct.directory_incomplete", text));
        }
        if n_missing == n_named && n_named > 0 {
            let path = self.directories[0].0.clone();
            named.missing = Some(Error::DirectoryWithoutFiles { path, n_named });
        }
        named
    }

    fn into_folder(self, files: Vec<PathBuf>) -> Folder {
        let mut warnings: Vec<Warning> = Vec::new();
        warnings.extend(left_out("ct.not_dicom", self.n_foreign, "file(s) that are not DICOM"));
        let images =
            "image file(s) that are not DICOM (NIfTI, MetaImage, NRRD: to use one, name the file itself)";
        warnings.extend(left_out("ct.image_file", self.n_image_files, images));
        warnings.extend(left_out("ct.localizer", self.n_localizers, "localizer image(s)"));
        warnings.extend(left_out("ct.secondary_capture", self.n_captures, "picture(s) of a screen"));
        warnings.extend(left_out(
            "ct.not_an_image_plane",
            self.n_others,
            "DICOM object(s) that are no image planes",
        ));
        if self.n_bare > 0 {
            let text = format!(
                "{} file(s) begin without the preamble and mark of DICOM: they were taken for what their first elements say",
                self.n_bare
            );
            warnings.push(Warning::new("ct.no_preamble", text));
        }
        warnings.extend(self.folder.warnings);
        Folder { files, warnings, ..self.folder }
    }
}

/// The file that a record names, below the directory's folder; none for a name that leads elsewhere.
fn resolve(directory: &Path, components: &[String]) -> Option<PathBuf> {
    let is_plain = |c: &String| !c.is_empty() && c != "." && c != ".." && !c.contains(['/', '\\', ':', '\0']);
    let leads_down = !components.is_empty() && components.iter().all(is_plain);
    leads_down.then(|| {
        components.iter().fold(directory.parent().unwrap_or(Path::new("")).to_owned(), |p, c| p.join(c))
    })
}

/// A path without what media of old change in names: case, the version behind a semicolon, a dot at the end.
fn plain(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    let name = name.split(';').next().unwrap_or_default().trim_end_matches('.');
    let folder = path.parent().unwrap_or(Path::new("")).to_string_lossy().to_lowercase();
    Path::new(&folder).join(name)
}

/// All regular files below a folder, sorted, hidden ones left out.
fn list(folder: &Path) -> Result<Vec<PathBuf>, Error> {
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

fn look_at(path: &Path, task: &Task<'_>) -> Kind {
    let content = match beginning::of(path) {
        Err(e) => Err(unreadable(path, e)),
        Ok(Some(Beginning::Marked)) => header::read(path, task),
        Ok(Some(_)) => return Kind::Bare(told(path, header::read(path, task))),
        // A file that is called DICOM and is not was damaged: it may have been a plane.
        Ok(None) if is_called_dicom(path) => {
            Err(Error::Damaged { path: path.to_owned(), what: "the mark DICM is missing" })
        }
        Ok(None) if image::is_one(path) => return Kind::Image,
        Ok(None) => return Kind::Foreign,
    };
    Kind::Dicom(told(path, content))
}

/// What a file holds, or whose it is in spite of its damage.
fn told(path: &Path, content: Result<Content, Error>) -> Result<Content, Box<Damage>> {
    let damage = |fault| Damage { fault, path: path.to_owned(), series: lengths::series_of(path) };
    content.map_err(|fault| Box::new(damage(fault)))
}

/// Whether a file begins as DICOM does, with or without its preamble (PS3.10 7.1).
pub(crate) fn is_dicom(path: &Path) -> io::Result<bool> {
    Ok(beginning::of(path)?.is_some())
}

/// The name that PS3.10 8.6 prescribes.
fn is_called_directory(path: &Path) -> bool {
    path.file_name().is_some_and(|n| n.eq_ignore_ascii_case("DICOMDIR"))
}

fn is_called_dicom(path: &Path) -> bool {
    let is_one_of = |e: &std::ffi::OsStr| ["dcm", "dicom", "ima"].iter().any(|n| e.eq_ignore_ascii_case(n));
    path.extension().is_some_and(is_one_of)
}
