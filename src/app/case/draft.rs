//! New cases while they are put together, and the lock that tells a case at work from one that was left.

use super::{CaseError, UNFINISHED};
use crate::app::atomic::{self, failed};
use std::fs::{self, File, TryLockError};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

pub(super) const LOCK_FILE: &str = "stages.lock";

/// A new case while it is put together; removed with all that is in it unless it is published.
#[derive(Debug)]
pub(super) struct Draft {
    pub(super) dir: TempDir,
    /// Tells it from one whose process was killed.
    pub(super) lock: File,
    /// After `dir`, so that they are empty when their turn comes.
    pub(super) parents: NewParents,
}

impl Draft {
    pub(super) fn beside(place: &Path) -> Result<Self, CaseError> {
        let parent = atomic::parent(place);
        let parents = NewParents::above(place);
        fs::create_dir_all(parent).map_err(failed("create", parent))?;
        // Private to its owner: it holds a patient's images, though not the patient's name.
        let dir = tempfile::Builder::new()
            .prefix(UNFINISHED)
            .permissions(fs::Permissions::from_mode(0o700))
            .tempdir_in(parent)
            .map_err(failed("create a directory in", parent))?;
        let lock = lock(dir.path())?;
        Ok(Self { dir, lock, parents })
    }
}

/// Directories that were made for a case, the deepest first; removed again where the case never came into being.
#[derive(Debug)]
pub(super) struct NewParents(Vec<PathBuf>);

impl NewParents {
    /// Those that are missing now.
    fn above(place: &Path) -> Self {
        Self(atomic::parent(place).ancestors().take_while(|p| !p.exists()).map(Path::to_owned).collect())
    }

    pub(super) fn keep(mut self) {
        self.0.clear();
    }
}

impl Drop for NewParents {
    fn drop(&mut self) {
        for dir in &self.0 {
            // One that somebody else has put something into meanwhile stays.
            if let Err(e) = fs::remove_dir(dir) {
                tracing::debug!("an empty directory stays: {e}");
            }
        }
    }
}

/// Removes what processes that were killed left of new cases: drafts that nobody has locked.
pub(super) fn sweep(parent: &Path) {
    let is_draft = |p: &PathBuf| is_unfinished(p) && p.join(LOCK_FILE).is_file();
    for draft in atomic::entries(parent).unwrap_or_default().into_iter().filter(is_draft) {
        // Somebody else's, or at work: it is left alone.
        if let Err(e) = lock(&draft).and_then(|_lock| Ok(atomic::remove(&draft)?)) {
            tracing::debug!("an unfinished case stays: {e}");
        }
    }
}

pub(super) fn is_unfinished(path: &Path) -> bool {
    path.file_name().is_some_and(|n| n.to_string_lossy().starts_with(UNFINISHED))
}

fn is_read_only(error: &std::io::Error) -> bool {
    matches!(error.kind(), std::io::ErrorKind::PermissionDenied | std::io::ErrorKind::ReadOnlyFilesystem)
}

pub(super) fn lock(dir: &Path) -> Result<File, CaseError> {
    let path = dir.join(LOCK_FILE);
    let file = match File::options().create(true).truncate(false).write(true).open(&path) {
        // A case that may only be read, as one in an archive, is read; what is to be written says so itself.
        Err(e) if is_read_only(&e) => File::open(&path),
        opened => opened,
    };
    let file = file.map_err(failed("open", &path))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(CaseError::InUse(dir.to_owned())),
        Err(TryLockError::Error(e)) => Err(failed("lock", &path)(e).into()),
    }
}
