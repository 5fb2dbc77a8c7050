//! A folder whose files become jobs (IO).
//!
//! A file is taken once it has stood still for a while, and added over the server's own socket, so that the same rules hold
//! as for everybody. Its job's name follows from the file: a server that ends between adding and moving adds it once, and none reads
//! it again that the queue knows already. It is moved to `taken/` then, or to `refused/`; neither log nor queue learns its name.
//!
//! The folder may lie on a share that does not answer: it is looked at beside the async tasks, and the server's end does not wait for it.

use super::Error;
use super::config::Watch;
use super::kit::{Kit, ended, on_disk};
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
use tokio::time::{Instant, sleep};

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

/// What the queue has said of a file: the folder that it is moved to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    Taken,
    Refused,
}

impl Verdict {
    const fn folder(self) -> &'static str {
        match self {
            Self::Taken => "taken",
            Self::Refused => "refused",
        }
    }
}

/// A file that is there.
#[derive(Debug, Clone, Copy)]
struct Seen {
    look: Look,
    /// As it is for so long.
    since: Instant,
    verdict: Option<Verdict>,
    /// Whether somebody was told that it cannot be moved.
    is_told: bool,
}

/// The files of the folder, over several looks.
#[derive(Debug, Default)]
struct Inbox(BTreeMap<PathBuf, Seen>);

impl Inbox {
    /// Takes over what is there now; gives those that have not changed for so long.
    fn see(&mut self, found: BTreeMap<PathBuf, Look>, now: Instant, still: Duration) -> Vec<PathBuf> {
        let mut before = std::mem::take(&mut self.0);
        for (path, look) in found {
            let fresh = Seen { look, since: now, verdict: None, is_told: false };
            let seen = before.remove(&path).filter(|seen| seen.look == look).unwrap_or(fresh);
            self.0.insert(path, seen);
        }
        let stands = |seen: &Seen| now.duration_since(seen.since) >= still;
        self.0.iter().filter(|(_, seen)| stands(seen)).map(|(path, _)| path.clone()).collect()
    }
}

/// Takes files until the server ends.
pub(super) async fn run<S: Store>(watch: Watch, kit: Kit<S>) -> Result<(), Error> {
    let mut stopping = kit.stopping.clone();
    let watching = async {
        let client = Client::over_socket(kit.layout.socket());
        let mut inbox = Inbox::default();
        loop {
            let folder = watch.folder.clone();
            match on_disk(move || looked(&folder)).await {
                Ok(found) => {
                    for path in inbox.see(found, Instant::now(), watch.still) {
                        if let Some(seen) = inbox.0.get_mut(&path) {
                            take(&watch, &client, &path, seen).await;
                        }
                    }
                }
                Err(error) => tracing::warn!("watch folder: it cannot be read: {}", error.kind()),
            }
            sleep(LOOK).await;
        }
    };
    tokio::select! {
        () = watching => {}
        () = ended(&mut stopping) => {}
    }
    Ok(())
}

/// Files of jobs that lie in a folder.
fn looked(folder: &Path) -> io::Result<BTreeMap<PathBuf, Look>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
        if !ending.is_some_and(|ending| ENDINGS.contains(&&*ending)) {
            continue;
        }
        // One that has gone meanwhile is nobody's concern.
        if let Ok(Some(look)) = Look::at(&path) {
            found.insert(path, look);
        }
    }
    Ok(found)
}

async fn take(watch: &Watch, client: &Client, path: &Path, seen: &mut Seen) {
    let id = seen.look.id(path);
    if seen.verdict.is_none() {
        seen.verdict = asked(watch, client, path, id).await;
    }
    let Some(verdict) = seen.verdict else { return };
    let (from, to) = (path.to_owned(), watch.folder.join(verdict.folder()));
    match on_disk(move || put_away(&from, &to, id)).await {
        Ok(()) => {}
        Err(error) if !std::mem::replace(&mut seen.is_told, true) => {
            let (folder, kind) = (verdict.folder(), error.kind());
            tracing::error!(job = %id, "watch folder: a file cannot be moved to {folder}, and is left where it is: {kind}");
        }
        Err(_told_before) => {}
    }
}

/// Has a file added, unless the queue has it; `None`: it is asked again at the next look.
async fn asked(watch: &Watch, client: &Client, path: &Path, id: JobId) -> Option<Verdict> {
    match client.job(id).await {
        Ok(_) => return Some(Verdict::Taken),
        Err(client::Error::Refused { status: 404, .. }) => {}
        Err(error) => {
            tracing::warn!("watch folder: a file was not taken yet: {error}");
            return None;
        }
    }
    let added = Added {
        path: path.display().to_string(),
        id: Some(id),
        wishes: WishesBody::default(),
        submit: watch.submit,
        why: Reason::try_new("from the watched folder").unwrap_or_default(),
    };
    match client.add(&added).await {
        Ok(_) => {
            tracing::info!(job = %id, "watch folder: a file was taken");
            Some(Verdict::Taken)
        }
        Err(client::Error::Refused { status, fault }) if status < 500 && status != 429 => {
            tracing::warn!(code = fault.code, "watch folder: a file was refused: {}", fault.message);
            Some(Verdict::Refused)
        }
        Err(error) => {
            tracing::warn!("watch folder: a file was not taken yet: {error}");
            None
        }
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

    const STILL: Duration = Duration::from_secs(30);

    #[test]
    fn a_file_is_taken_once_it_has_stood_still_for_long_enough() {
        let dir = tempfile::tempdir().unwrap();
        let (job, note) = (dir.path().join("a.GCODE"), dir.path().join("note.txt"));
        let (mut inbox, start) = (Inbox::default(), Instant::now());
        let mut look =
            |second| inbox.see(looked(dir.path()).unwrap(), start + Duration::from_secs(second), STILL);
        fs::write(&job, "G28\n").unwrap();
        fs::write(&note, "x").unwrap();
        fs::write(dir.path().join("empty.stl"), "").unwrap();
        fs::create_dir(dir.path().join("folder.gcode")).unwrap();
        let none: [PathBuf; 0] = [];
        assert_eq!(look(0), none);
        assert_eq!(look(20), none, "the share may only be slow");
        fs::write(&job, "G28\nG1\n").unwrap();
        assert_eq!(look(40), none, "it grew");
        assert_eq!(look(69), none);
        assert_eq!(look(70), std::slice::from_ref(&job));
        fs::remove_file(&job).unwrap();
        assert_eq!(look(72), none);
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
