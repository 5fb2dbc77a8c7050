//! A folder whose files become jobs (IO).
//!
//! A file is taken once its size has stood still between two looks, and added over the server's own socket, so that the same rules hold
//! as for everybody. Its job's name follows from the file, so that a server which ends between adding and moving adds it once. It is moved to
//! `taken/` then, or to `refused/`; neither log nor queue learns its name.

use super::config::Watch;
use super::kit::{Kit, ended};
use crate::client::{self, Client};
use crate::http::wire::{Added, WishesBody};
use crate::queue::{JobId, Reason};
use crate::store::Store;
use jiff::Timestamp;
use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, UNIX_EPOCH};
use tokio::time::sleep;

/// How often the folder is looked at.
const LOOK: Duration = Duration::from_secs(2);
/// Endings that are taken.
const ENDINGS: [&str; 5] = ["gcode", "gco", "g", "stl", "3mf"];

/// What a file was like at a look.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Look {
    len: u64,
    modified_ms: i64,
    inode: u64,
}

impl Look {
    fn at(path: &Path) -> io::Result<Option<Self>> {
        let found = fs::symlink_metadata(path)?;
        if !found.is_file() || found.len() == 0 {
            return Ok(None);
        }
        let since = found.modified()?.duration_since(UNIX_EPOCH).unwrap_or_default();
        let modified_ms = i64::try_from(since.as_millis()).unwrap_or(0);
        Ok(Some(Self { len: found.len(), modified_ms, inode: found.ino() }))
    }

    /// The job's name: of this file alone.
    fn id(self, path: &Path) -> JobId {
        let text = format!("{}\n{}\n{}\n{}", path.display(), self.len, self.modified_ms, self.inode);
        let mut chance = [0; 10];
        chance.copy_from_slice(&blake3::hash(text.as_bytes()).as_bytes()[..10]);
        JobId::at(Timestamp::from_millisecond(self.modified_ms).unwrap_or(Timestamp::UNIX_EPOCH), chance)
    }
}

/// Takes files until the server ends.
pub(super) async fn run<S: Store>(watch: Watch, kit: Kit<S>) {
    let client = Client::over_socket(kit.layout.socket());
    let mut stopping = kit.stopping.clone();
    let mut seen = BTreeMap::new();
    while kit.stopping().is_none() {
        match ready(&watch.folder, &mut seen) {
            Ok(files) => {
                for (path, look) in files {
                    take(&watch, &client, &path, look).await;
                }
            }
            Err(error) => tracing::warn!("watch folder: it cannot be read: {}", error.kind()),
        }
        tokio::select! {
            () = sleep(LOOK) => {}
            () = ended(&mut stopping) => {}
        }
    }
}

/// Files that are as they were at the last look.
fn ready(folder: &Path, seen: &mut BTreeMap<PathBuf, Look>) -> io::Result<Vec<(PathBuf, Look)>> {
    let mut now = BTreeMap::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
        if !ending.is_some_and(|ending| ENDINGS.contains(&&*ending)) {
            continue;
        }
        // One that has gone meanwhile is nobody's concern.
        if let Ok(Some(look)) = Look::at(&path) {
            now.insert(path, look);
        }
    }
    let ready = now.iter().filter(|(path, look)| seen.get(*path) == Some(look));
    let ready = ready.map(|(path, look)| (path.clone(), *look)).collect();
    *seen = now;
    Ok(ready)
}

async fn take(watch: &Watch, client: &Client, path: &Path, look: Look) {
    let id = look.id(path);
    let added = Added {
        path: path.display().to_string(),
        id: Some(id),
        wishes: WishesBody::default(),
        submit: watch.submit,
        why: Reason::try_new("from the watched folder").unwrap_or_default(),
    };
    let folder = match client.add(&added).await {
        Ok(_) => {
            tracing::info!(job = %id, "watch folder: a file was taken");
            "taken"
        }
        Err(client::Error::Refused { status, fault }) if status < 500 && status != 429 => {
            tracing::warn!(code = fault.code, "watch folder: a file was refused: {}", fault.message);
            "refused"
        }
        Err(error) => return tracing::warn!("watch folder: a file was not taken yet: {error}"),
    };
    if let Err(error) = put_away(path, &watch.folder.join(folder), id) {
        tracing::warn!(job = %id, "watch folder: a file cannot be moved to {folder}: {}", error.kind());
    }
}

/// Under the job's name, for two files may have the same one.
fn put_away(path: &Path, folder: &Path, id: JobId) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    let ending = path.extension().unwrap_or_default().to_string_lossy().into_owned();
    fs::rename(path, folder.join(format!("{id}.{ending}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_taken_once_it_stands_still() {
        let dir = tempfile::tempdir().unwrap();
        let mut seen = BTreeMap::new();
        let mut look =
            || ready(dir.path(), &mut seen).unwrap().into_iter().map(|(path, _)| path).collect::<Vec<_>>();
        let (job, note) = (dir.path().join("a.GCODE"), dir.path().join("note.txt"));
        fs::write(&job, "G28\n").unwrap();
        fs::write(&note, "x").unwrap();
        fs::write(dir.path().join("empty.stl"), "").unwrap();
        fs::create_dir(dir.path().join("folder.gcode")).unwrap();
        assert_eq!(look(), [""; 0].map(PathBuf::from));
        fs::write(&job, "G28\nG1\n").unwrap();
        assert_eq!(look(), [""; 0].map(PathBuf::from), "it grew");
        assert_eq!(look(), std::slice::from_ref(&job));
        fs::remove_file(&job).unwrap();
        assert_eq!(look(), [""; 0].map(PathBuf::from));
    }

    #[test]
    fn one_file_is_one_job_and_another_of_its_name_another() {
        let dir = tempfile::tempdir().unwrap();
        let job = dir.path().join("a.gcode");
        let id = |text: &str| {
            fs::write(&job, text).unwrap();
            Look::at(&job).unwrap().unwrap().id(&job)
        };
        let first = id("G28\n");
        assert_eq!(first, Look::at(&job).unwrap().unwrap().id(&job));
        assert_ne!(first, id("G28\nG1\n"));
    }
}
