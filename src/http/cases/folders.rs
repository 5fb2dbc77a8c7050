//! Folders with CTs, under names of chance (IO): a folder's own name may be a patient's.

use super::super::error::Problem;
use super::super::wire::case::{FolderView, Handle};
use super::{new_handle, nothing_of_this_name};
use axum::http::StatusCode;
use jiff::Timestamp;
use std::collections::{BTreeMap, VecDeque};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Folders of one answer, and folders that are remembered.
const MOST_SHOWN: usize = 1000;
const MOST_KNOWN: usize = 20_000;

/// What has been shown so far.
#[derive(Debug, Default)]
struct Known {
    paths: BTreeMap<Handle, PathBuf>,
    handles: BTreeMap<PathBuf, Handle>,
    /// The oldest first.
    order: VecDeque<Handle>,
}

#[derive(Debug)]
pub(super) struct Folders {
    roots: Vec<PathBuf>,
    known: Mutex<Known>,
}

impl Folders {
    pub(super) fn new(roots: Vec<PathBuf>) -> Self {
        Self { roots, known: Mutex::default() }
    }

    /// The folders that the server was told. Blocks.
    pub(super) fn roots(&self) -> Result<Vec<FolderView>, Problem> {
        self.shown(self.roots.iter().filter_map(|root| root.canonicalize().ok()).collect())
    }

    /// The folders in a folder. Blocks.
    pub(super) fn within(&self, folder: &Handle) -> Result<Vec<FolderView>, Problem> {
        let path = self.path(folder)?;
        let mut found = Vec::new();
        for entry in fs::read_dir(path).map_err(|e| unreadable(&e))? {
            let entry = entry.map_err(|e| unreadable(&e))?;
            // Links may lead out of what is allowed, and are not followed.
            if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                found.push(entry.path());
            }
        }
        self.shown(found)
    }

    /// A folder by its path, wherever it lies below those that are allowed. Blocks.
    pub(super) fn find(&self, path: &Path) -> Result<FolderView, Problem> {
        let path = path.canonicalize().ok().filter(|path| path.is_dir() && self.is_allowed(path));
        let outside = || {
            let message =
                "found no folder below those of [cases] ct_folders: look into config.toml of the server";
            Problem::new(StatusCode::FORBIDDEN, "http.outside", message)
        };
        Ok(self.shown(vec![path.ok_or_else(outside)?])?.remove(0))
    }

    /// Where a folder lies; looked at again, for links may have been put in its way. Blocks.
    pub(super) fn path(&self, folder: &Handle) -> Result<PathBuf, Problem> {
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner).paths.get(folder).cloned();
        let path = known.and_then(|path| path.canonicalize().ok());
        path.filter(|path| self.is_allowed(path)).ok_or_else(nothing_of_this_name)
    }

    fn is_allowed(&self, path: &Path) -> bool {
        self.roots.iter().any(|root| root.canonicalize().is_ok_and(|root| path.starts_with(root)))
    }

    /// The one that changed last first.
    fn shown(&self, paths: Vec<PathBuf>) -> Result<Vec<FolderView>, Problem> {
        let changed = |path: &PathBuf| fs::metadata(path).and_then(|found| found.modified()).ok();
        let mut paths: Vec<_> = paths.into_iter().map(|path| (changed(&path), path)).collect();
        paths.sort_by(|a, b| b.cmp(a));
        paths.truncate(MOST_SHOWN);
        let view = |(changed, path): (Option<std::time::SystemTime>, PathBuf)| {
            let (n_files, n_folders) = counted(&path);
            let changed = changed.and_then(|at| Timestamp::try_from(at).ok());
            Ok(FolderView { id: self.handle(path)?, n_files, n_folders, changed })
        };
        paths.into_iter().map(view).collect()
    }

    fn handle(&self, path: PathBuf) -> Result<Handle, Problem> {
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(handle) = known.handles.get(&path) {
            return Ok(handle.clone());
        }
        if known.order.len() == MOST_KNOWN
            && let Some(oldest) = known.order.pop_front()
            && let Some(path) = known.paths.remove(&oldest)
        {
            known.handles.remove(&path);
        }
        let handle = new_handle()?;
        known.paths.insert(handle.clone(), path.clone());
        known.handles.insert(path, handle.clone());
        known.order.push_back(handle.clone());
        Ok(handle)
    }
}

/// Files and folders in a folder; none where it cannot be read.
fn counted(path: &Path) -> (u64, u64) {
    let Ok(entries) = fs::read_dir(path) else { return (0, 0) };
    let kinds = entries.filter_map(|entry| entry.ok()?.file_type().ok());
    kinds.fold((0, 0), |(n_files, n_folders), kind| {
        (n_files + u64::from(kind.is_file()), n_folders + u64::from(kind.is_dir()))
    })
}

fn unreadable(error: &io::Error) -> Problem {
    let message = format!("the folder cannot be read by the server ({}): check its rights", error.kind());
    Problem::bad("http.unreadable", message)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn only_what_lies_below_the_folders_is_found_and_nothing_tells_its_name() {
        let dir = tempfile::tempdir().unwrap();
        let (root, outside) = (dir.path().join("ct"), dir.path().join("other"));
        fs::create_dir_all(root.join("MEIER/series")).unwrap();
        fs::create_dir_all(&outside).unwrap();
        fs::write(root.join("MEIER/series/1.dcm"), "x").unwrap();
        symlink(&outside, root.join("way out")).unwrap();
        let folders = Folders::new(vec![root.clone()]);
        let top = folders.roots().unwrap().remove(0);
        assert_eq!((top.n_files, top.n_folders), (0, 1));
        let patient = folders.within(&top.id).unwrap().remove(0);
        let series = folders.within(&patient.id).unwrap().remove(0);
        assert_eq!((series.n_files, series.n_folders), (1, 0));
        assert!(!serde_json::to_string(&[&top, &patient, &series]).unwrap().contains("MEIER"));
        assert_eq!(folders.find(&root.join("MEIER/series")).unwrap(), series, "one name for one folder");
        let paths = [
            root.join("way out"),
            root.join("MEIER/../../other"),
            outside.clone(),
            "/etc".into(),
            root.join("none"),
        ];
        for path in paths {
            assert_eq!(folders.find(&path).unwrap_err().code, "http.outside", "{}", path.display());
        }
        // A link that was put in its way meanwhile.
        fs::remove_dir_all(root.join("MEIER")).unwrap();
        symlink(&outside, root.join("MEIER")).unwrap();
        assert_eq!(folders.path(&patient.id).unwrap_err().status.as_u16(), 404);
        assert_eq!(folders.path(&Handle::of([7; 16])).unwrap_err().status.as_u16(), 404);
        assert!(Folders::new(Vec::new()).roots().unwrap().is_empty());
    }
}
