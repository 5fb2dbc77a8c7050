//! Files of jobs in the state directory, under generated names (IO).
//!
//! A file comes in as a `Part`: written beside, flushed, then given its name in one step; whatever goes wrong, nothing is left. Of the name that it
//! had only the ending is looked at. A case directory stays where it is: the state directory, which is its owner's alone, keeps a
//! link to it under the job's name. What the queue keeps is a [`FileSpec`].

use super::error::Problem;
use crate::queue::{Digest, JobId, Refusal, Spec, SpecKind};
use crate::store::{self, Store};
use axum::http::StatusCode;
use rustix::fs::OFlags;
use serde::{Deserialize, Serialize};
use std::io::{self, Read, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, symlink};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tempfile::NamedTempFile;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Ending of what is being written.
const PART: &str = ".part";
/// Endings of what is kept.
const ENDINGS: [&str; 4] = ["gcode", "stl", "3mf", "case"];
/// Bytes that are copied at once.
const CHUNK: usize = 1 << 18;

/// What is accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Largest file, bytes.
    pub max_bytes: u64,
    /// Longest upload.
    pub max_time: Duration,
    /// Longest silence within an upload.
    pub max_silence: Duration,
    /// Uploads at once.
    pub at_once: usize,
    /// Nothing is taken while less would be left free: queue and journals have to be written whatever comes in, bytes.
    pub reserve_bytes: u64,
}

impl Default for Limits {
    /// A week of printing is some hundred MB of G-code; a slow wireless link takes minutes for it.
    fn default() -> Self {
        Self {
            max_bytes: 2 << 30,
            max_time: Duration::from_secs(30 * 60),
            max_silence: Duration::from_secs(30),
            at_once: 4,
            reserve_bytes: 512 << 20,
        }
    }
}

/// What a file is, by its ending.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileKind {
    /// G-code.
    Gcode,
    /// A mesh as STL.
    Stl,
    /// A mesh as 3MF.
    ThreeMf,
}

impl FileKind {
    /// Of the name that a file had; nothing else of it is kept.
    pub(super) fn of(name: &str) -> Result<Self, Problem> {
        let is_path = name.contains(['/', '\\', '\0']) || name == "..";
        if is_path {
            return Err(Problem::bad("http.bad_name", "found a path, expected the name of a file alone"));
        }
        let ending = name.rsplit_once('.').map(|(_, ending)| ending.to_ascii_lowercase());
        match ending.as_deref() {
            Some("gcode" | "gco" | "g") => Ok(Self::Gcode),
            Some("stl") => Ok(Self::Stl),
            Some("3mf") => Ok(Self::ThreeMf),
            _ => {
                let message =
                    "found a file of another kind, expected G-code (.gcode, .gco, .g) or a mesh (.stl, .3mf)";
                Err(Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, "http.unknown_kind", message))
            }
        }
    }

    const fn ending(self) -> &'static str {
        match self {
            Self::Gcode => "gcode",
            Self::Stl => "stl",
            Self::ThreeMf => "3mf",
        }
    }

    const fn spec(self) -> SpecKind {
        match self {
            Self::Gcode => SpecKind::Gcode,
            Self::Stl | Self::ThreeMf => SpecKind::Mesh,
        }
    }
}

/// The specification of a job that was made of a file, as JSON in the queue.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileSpec {
    /// Its name in the folder of files.
    pub file: String,
    /// Its sum and size; `null` for a case, which has sums of its own.
    pub bytes: Option<FileSum>,
}

/// What shows that a file is as it came.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileSum {
    /// BLAKE3.
    pub blake3: Digest,
    /// Bytes.
    pub len: u64,
}

/// The folder of files. Clones are the same.
#[derive(Debug, Clone)]
pub struct Files {
    dir: PathBuf,
    limits: Limits,
    uploads: Arc<Semaphore>,
}

impl Files {
    /// Opens the folder, or makes it, for its owner alone; removes what an earlier process left half written. One process at a time.
    ///
    /// # Errors
    /// What the system says.
    pub fn open(dir: &Path, limits: Limits) -> io::Result<Self> {
        std::fs::DirBuilder::new().recursive(true).mode(0o700).create(dir)?;
        for entry in std::fs::read_dir(dir)? {
            let path = entry?.path();
            if path.extension().is_some_and(|ending| ending == &PART[1..]) {
                std::fs::remove_file(path)?;
            }
        }
        Ok(Self { dir: dir.to_owned(), limits, uploads: Arc::new(Semaphore::new(limits.at_once)) })
    }

    /// The jobs that files are kept for now, each with its file.
    ///
    /// # Errors
    /// What the system says.
    pub fn jobs(&self) -> io::Result<Vec<(JobId, PathBuf)>> {
        let mut found = Vec::new();
        for entry in std::fs::read_dir(&self.dir)? {
            let path = entry?.path();
            let id = path.file_stem().and_then(|stem| stem.to_str()?.parse().ok());
            found.extend(id.map(|id| (id, path)));
        }
        Ok(found)
    }

    /// Removes files of which no job was made, because the program was ended in between. `found` is from before the first new one.
    pub(super) async fn tidy<S: Store>(&self, store: &S, found: Vec<(JobId, PathBuf)>) {
        for (id, path) in found {
            if let Err(store::Error::Refused(Refusal::NoJob { .. })) = store.job(id).await
                && let Err(error) = tokio::fs::remove_file(path).await
            {
                tracing::warn!("removing a file of no job, {id}: {error}");
            }
        }
    }

    /// What is accepted.
    #[must_use]
    pub const fn limits(&self) -> Limits {
        self.limits
    }

    /// Where the file of a specification lies; `None`: the name is not one that is given here.
    #[must_use]
    pub fn path(&self, spec: &FileSpec) -> Option<PathBuf> {
        let (id, ending) = spec.file.split_once('.')?;
        let is_ours = id.parse::<JobId>().is_ok() && ENDINGS.contains(&ending);
        is_ours.then(|| self.dir.join(&spec.file))
    }

    /// Bytes that are free for files, beside the reserve.
    ///
    /// # Errors
    /// What the system says.
    pub fn free_bytes(&self) -> io::Result<u64> {
        let found = rustix::fs::statvfs(&self.dir)?;
        Ok(found.f_bavail.saturating_mul(found.f_frsize).saturating_sub(self.limits.reserve_bytes))
    }

    /// Removes everything that is kept for a job. Blocks.
    ///
    /// # Errors
    /// What the system says.
    pub fn remove(&self, id: JobId) -> io::Result<()> {
        for ending in ENDINGS {
            match std::fs::remove_file(self.dir.join(format!("{id}.{ending}"))) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                _ => {}
            }
        }
        Ok(())
    }

    /// Begins a file. Blocks.
    pub(super) fn begin(&self) -> Result<Part, Problem> {
        self.check_room(1)?;
        let busy = |_all_taken| {
            Problem::busy("http.too_many_uploads", "other files are being uploaded: try again soon", 5)
        };
        let permit = Arc::clone(&self.uploads).try_acquire_owned().map_err(busy)?;
        let temporary =
            tempfile::Builder::new().suffix(PART).tempfile_in(&self.dir).map_err(|e| failed(&e))?;
        Ok(Part { files: self.clone(), temporary, hasher: Box::default(), n_bytes: 0, _permit: permit })
    }

    /// Refuses what would leave less than the reserve. Blocks.
    pub(super) fn check_room(&self, n_bytes: u64) -> Result<(), Problem> {
        if self.free_bytes().map_err(|e| failed(&e))? >= n_bytes { Ok(()) } else { Err(disk_full()) }
    }

    /// Takes a file of this machine. Blocks.
    pub(super) fn copy(&self, from: &Path, id: JobId) -> Result<Kept, Problem> {
        let name = from.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let kind = FileKind::of(name)?;
        // Something else, such as a pipe at whose other end nobody writes, would be waited for for ever.
        let waits_for_nobody = OFlags::NONBLOCK.bits().cast_signed();
        let opened = std::fs::File::options().read(true).custom_flags(waits_for_nobody).open(from);
        let mut file = opened.map_err(|e| unreadable(&e))?;
        let found = file.metadata().map_err(|e| unreadable(&e))?;
        if !found.is_file() {
            return Err(Problem::bad(
                "http.no_file",
                "found something that is no file, expected G-code or a mesh",
            ));
        }
        self.check_room(found.len())?;
        let mut part = self.begin()?;
        let mut chunk = vec![0; CHUNK];
        loop {
            match file.read(&mut chunk).map_err(|e| unreadable(&e))? {
                0 => return part.keep(id, kind),
                n_bytes => part.write(&chunk[..n_bytes])?,
            }
        }
    }

    /// Links to a case directory. Blocks.
    pub(super) fn link(&self, case: &Path, id: JobId) -> Result<Kept, Problem> {
        if !case.join("case.toml").is_file() {
            let message = "found a folder without case.toml, expected a case directory of lumenfab";
            return Err(Problem::bad("http.no_case", message));
        }
        let file = format!("{id}.case");
        let path = self.dir.join(&file);
        let is_new = match symlink(case, &path) {
            Ok(()) => true,
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists && links_to(&path, case) => false,
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => return Err(other_file(id)),
            Err(e) => return Err(failed(&e)),
        };
        let kept = Kept { path, is_new, kind: SpecKind::Case, spec: FileSpec { file, bytes: None } };
        flush(&self.dir).map_err(|e| kept.discarded(&e))?;
        Ok(kept)
    }
}

fn links_to(link: &Path, case: &Path) -> bool {
    std::fs::read_link(link).is_ok_and(|found| found == case)
}

fn flush(dir: &Path) -> io::Result<()> {
    std::fs::File::open(dir)?.sync_all()
}

fn failed(error: &io::Error) -> Problem {
    if error.kind() == io::ErrorKind::StorageFull {
        return disk_full();
    }
    Problem::inside("writing a file", error)
}

fn disk_full() -> Problem {
    let message = "the disk of the server is full, but for what queue and prints need: make room, then send the file again";
    Problem::new(StatusCode::INSUFFICIENT_STORAGE, "http.disk_full", message)
}

fn unreadable(error: &io::Error) -> Problem {
    // The path is the caller's, and may hold a name: neither log nor answer repeat it.
    let message = format!("the file cannot be read by the server ({}): check its rights", error.kind());
    Problem::bad("http.unreadable", message)
}

fn other_file(id: JobId) -> Problem {
    Problem::conflict("queue.id_taken", format!("another job has the id {id}"))
}

/// A file that is being written; dropped, it is gone.
#[derive(Debug)]
pub(super) struct Part {
    files: Files,
    temporary: NamedTempFile,
    hasher: Box<blake3::Hasher>,
    n_bytes: u64,
    _permit: OwnedSemaphorePermit,
}

impl Part {
    /// Blocks as long as the disk takes.
    pub(super) fn write(&mut self, bytes: &[u8]) -> Result<(), Problem> {
        self.n_bytes += bytes.len() as u64;
        let max_bytes = self.files.limits.max_bytes;
        if self.n_bytes > max_bytes {
            return Err(too_large(max_bytes));
        }
        self.files.check_room(bytes.len() as u64)?;
        self.hasher.update(bytes);
        self.temporary.write_all(bytes).map_err(|e| failed(&e))
    }

    /// Gives it its name, once it is on the disk. Blocks.
    pub(super) fn keep(self, id: JobId, kind: FileKind) -> Result<Kept, Problem> {
        if self.n_bytes == 0 {
            return Err(Problem::bad("http.empty_file", "found an empty file, expected G-code or a mesh"));
        }
        self.temporary.as_file().sync_all().map_err(|e| failed(&e))?;
        let blake3 = Digest::from(*self.hasher.finalize().as_bytes());
        let file = format!("{id}.{}", kind.ending());
        let dir = &self.files.dir;
        let path = dir.join(&file);
        let is_new = match self.temporary.persist_noclobber(&path) {
            Ok(_) => true,
            Err(e) if e.error.kind() == io::ErrorKind::AlreadyExists => false,
            Err(e) => return Err(failed(&e.error)),
        };
        let sum = FileSum { blake3, len: self.n_bytes };
        let kept = Kept { path, is_new, kind: kind.spec(), spec: FileSpec { file, bytes: Some(sum) } };
        if is_new {
            flush(dir).map_err(|e| kept.discarded(&e))?;
        }
        Ok(kept)
    }
}

/// The file is larger than allowed.
pub(super) fn too_large(max_bytes: u64) -> Problem {
    let message =
        format!("found a file of more than {} MB: raise the server's limit if it is right", max_bytes >> 20);
    Problem::new(StatusCode::PAYLOAD_TOO_LARGE, "http.too_large", message)
}

/// A file that has its name.
#[derive(Debug)]
pub(super) struct Kept {
    path: PathBuf,
    /// Whether it was not there before.
    is_new: bool,
    kind: SpecKind,
    spec: FileSpec,
}

impl Kept {
    /// What the queue keeps of it. Where the same name was given before to other bytes, the queue refuses this one.
    pub(super) fn spec(&self) -> Result<Spec, Problem> {
        let bytes = serde_json::to_vec(&self.spec).map_err(|e| Problem::inside("writing a job", &e))?;
        Ok(Spec::try_new(self.kind, bytes)?)
    }

    /// No job was made of it.
    pub(super) fn discard(&self) {
        if self.is_new
            && let Err(error) = std::fs::remove_file(&self.path)
        {
            tracing::warn!("removing {}: {error}", self.spec.file);
        }
    }

    fn discarded(&self, error: &io::Error) -> Problem {
        self.discard();
        failed(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::queue::tests::id;

    fn code(name: &str) -> &'static str {
        FileKind::of(name).map_or_else(|problem| problem.code, FileKind::ending)
    }

    #[test]
    fn of_a_name_only_the_ending_counts_and_paths_are_refused() {
        assert_eq!([code("Müller.GCODE"), code("a.b.gco"), code("x.3mf")], ["gcode", "gcode", "3mf"]);
        for path in ["../x.gcode", "/etc/x.gcode", "a\\b.gcode", "..", "a\0.gcode"] {
            assert_eq!(code(path), "http.bad_name", "{path:?}");
        }
        for other in ["", "gcode", "x.exe", "x."] {
            assert_eq!(code(other), "http.unknown_kind", "{other:?}");
        }
    }

    #[test]
    fn what_an_earlier_process_left_half_written_is_removed() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("abc.part"), "half").unwrap();
        std::fs::write(dir.path().join("whole.gcode"), "G28").unwrap();
        Files::open(dir.path(), Limits::default()).unwrap();
        let left: Vec<_> = std::fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(left, ["whole.gcode"]);
    }

    #[test]
    fn nothing_is_taken_that_leaves_less_than_the_reserve_and_nothing_is_left_of_it() {
        let dir = tempfile::tempdir().unwrap();
        let (folder, job) = (dir.path().join("files"), dir.path().join("a.gcode"));
        std::fs::write(&job, "G28\n").unwrap();
        let free = Files::open(&folder, Limits::default()).unwrap();
        free.copy(&job, id(1)).unwrap();
        let full = Files::open(&folder, Limits { reserve_bytes: u64::MAX, ..Limits::default() }).unwrap();
        let refused = full.copy(&job, id(2)).unwrap_err();
        assert_eq!((refused.status.as_u16(), refused.code), (507, "http.disk_full"));
        assert_eq!(full.begin().unwrap_err().code, "http.disk_full");
        let mut part = free.begin().unwrap();
        part.files = full;
        assert_eq!(part.write(b"G28\n").unwrap_err().code, "http.disk_full");
        drop(part);
        assert_eq!(free.jobs().unwrap(), [(id(1), folder.join(format!("{}.gcode", id(1))))]);
        free.remove(id(1)).unwrap();
        free.remove(id(1)).unwrap();
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 0);
    }

    #[test]
    fn what_is_no_file_is_refused_and_not_waited_for() {
        let dir = tempfile::tempdir().unwrap();
        let files = Files::open(&dir.path().join("files"), Limits::default()).unwrap();
        let pipe = dir.path().join("pipe.gcode");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status().unwrap();
        assert!(made.success());
        assert_eq!(files.copy(&pipe, id(1)).unwrap_err().code, "http.no_file");
    }

    #[test]
    fn a_specification_leads_to_no_file_but_those_given_here() {
        let dir = tempfile::tempdir().unwrap();
        let files = Files::open(dir.path(), Limits::default()).unwrap();
        let path = |file: &str| files.path(&FileSpec { file: file.into(), bytes: None });
        assert_eq!(path(&format!("{}.gcode", id(1))), Some(dir.path().join(format!("{}.gcode", id(1)))));
        for bad in ["../x.gcode", "x.gcode", "", &format!("{}./../../x", id(1))] {
            assert_eq!(path(bad), None, "{bad}");
        }
    }
}
