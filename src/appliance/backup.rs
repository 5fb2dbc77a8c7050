//! A state directory as one file, and back again (IO).
//!
//! A backup is a ZIP archive: a snapshot of the queue (taken by SQLite, while the server goes on), configuration, keys, uploaded files,
//! what was made of jobs, the cases that were begun over the API and where their CTs lie, and `manifest.json` with the hash of each. It is
//! written whole or not at all, readable by its owner alone; it holds the hashes of keys, and paths of CTs, which may name a
//! patient. Other cases are not in it, only where they lie: paths that an operator has named. Nor is the key that cases are sealed
//! with. A case that a task works on meanwhile may be caught half done: its next stage is done again.
//!
//! Restored is into a directory that holds nothing, only when all of it is found to be as it was written, and again whole or not at all.
//! What the queue did after the backup it cannot know: jobs that were queued then, or taken and not begun, may have been printed since. They
//! are held until somebody releases them, and every bed is in doubt until somebody has looked. What was in print waits for a word,
//! as after every end of a server.

use super::Error;
use super::place::Layout;
use crate::queue::{Actor, By, Change, Job, Name, Reason, Request, Said, State, Who};
use crate::store::{self, Sqlite, Store, Which};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, Write};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Component, Path, PathBuf};
use tempfile::{NamedTempFile, TempDir};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipArchive, ZipWriter};

/// What a backup's manifest is called, and the newest kind of it.
const MANIFEST: &str = "manifest.json";
const FORMAT: u32 = 3;
/// A larger manifest is none, bytes.
const MOST_MANIFEST: u64 = 1 << 28;
/// The queue's file, and what else lies beside it; what is not named (socket, lock, sign of life) belongs to a living server.
const QUEUE: &str = "queue.db";
const FILES: [&str; 2] = ["config.toml", "keys.toml"];
const FOLDERS: [&str; 4] = ["cases", "files", "jobs", "sources"];
/// What links to cases are called.
const CASE: &str = ".case";
/// Jobs asked for at once.
const PAGE: u32 = 500;
/// Bytes copied at once.
const BLOCK: usize = 1 << 16;
/// Who holds jobs after a restore, in the history.
const RULE: &str = "restore";

/// What a backup says of itself.
#[derive(Debug, Serialize, Deserialize)]
struct Manifest {
    format: u32,
    made_by: String,
    made_at: Timestamp,
    entries: Vec<Entry>,
    /// Since format 2.
    #[serde(default)]
    cases: Vec<CaseLink>,
}

/// A link to a case.
#[derive(Debug, Serialize, Deserialize)]
struct CaseLink {
    name: String,
    /// Relative to the state directory for a case that lies in it, since format 3.
    leads_to: String,
}

#[derive(Debug, Serialize, Deserialize)]
struct Entry {
    name: String,
    bytes: u64,
    blake3: String,
}

/// A backup that was made.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Saved {
    /// Files in it.
    pub n_files: usize,
    /// Size of the archive, bytes.
    pub bytes: u64,
}

/// A state directory that was made from a backup.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Restored {
    /// When the backup was made.
    pub made_at: Timestamp,
    /// Files in it.
    pub n_files: usize,
    /// Jobs that are held now: they were queued, or taken and not begun.
    pub n_held: usize,
}

/// Writes all that a state directory holds into one file; a server may live there. Replaces an older backup of that name.
///
/// # Errors
/// [`Error::Backup`] where there is no queue, where the file would lie within the directory; [`Error::Io`], [`Error::Store`].
pub fn backup(dir: &Path, to: &Path, now: Timestamp) -> Result<Saved, Error> {
    let layout = Layout::of(dir);
    if !layout.queue().is_file() {
        return Err(refused(dir, "holds no queue: name the state directory with --state"));
    }
    let target = std::path::absolute(to).map_err(failed(to))?;
    let home = std::path::absolute(dir).map_err(failed(dir))?;
    if target.starts_with(&home) {
        return Err(refused(to, "lies in the state directory: a backup belongs on another disk"));
    }
    let folder = target.parent().unwrap_or(Path::new("/"));
    let mut archive = Archive::new(NamedTempFile::new_in(folder).map_err(failed(folder))?);
    let scratch = tempfile::tempdir_in(folder).map_err(failed(folder))?;
    let snapshot = scratch.path().join(QUEUE);
    Sqlite::snapshot(&layout.queue(), &snapshot)?;
    archive.add(QUEUE, &snapshot)?;
    let Contents { files, cases } = contents(&home)?;
    for (name, path) in files {
        archive.add(&name, &path)?;
    }
    archive.end(cases, now, &target)
}

/// What lies in a state directory beside the queue, sorted by name.
#[derive(Debug, Default)]
struct Contents {
    /// Name in the backup, path.
    files: Vec<(String, PathBuf)>,
    cases: Vec<CaseLink>,
}

fn contents(dir: &Path) -> Result<Contents, Error> {
    let of_root = FILES.iter().map(|name| ((*name).to_owned(), dir.join(name)));
    let mut found =
        Contents { files: of_root.filter(|(_, path)| path.is_file()).collect(), cases: Vec::new() };
    let mut folders: Vec<String> =
        FOLDERS.iter().map(|name| (*name).to_owned()).filter(|name| dir.join(name).is_dir()).collect();
    while let Some(folder) = folders.pop() {
        let path = dir.join(&folder);
        let Some(entries) = there(std::fs::read_dir(&path)).map_err(failed(&path))? else { continue };
        for entry in entries {
            let entry = entry.map_err(failed(&path))?;
            let Some(kind) = there(entry.file_type()).map_err(failed(&path))? else { continue };
            // A name that is no text is none of ours.
            let Ok(name) = entry.file_name().into_string() else { continue };
            let name = format!("{folder}/{name}");
            if kind.is_dir() {
                folders.push(name);
            } else if kind.is_file() {
                found.files.push((name, entry.path()));
            } else if kind.is_symlink() && is_case(&name) {
                found.cases.extend(case_link(dir, name, &entry.path())?);
            }
        }
    }
    found.files.sort();
    found.cases.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(found)
}

/// Whether a case is linked by this name; other links are none of ours.
fn is_case(name: &str) -> bool {
    name.strip_prefix("files/").is_some_and(|rest| rest.ends_with(CASE) && !rest.contains('/'))
}

fn case_link(dir: &Path, name: String, path: &Path) -> Result<Option<CaseLink>, Error> {
    let Some(case) = there(std::fs::read_link(path)).map_err(failed(path))? else { return Ok(None) };
    let case = case.strip_prefix(dir).map(Path::to_owned).unwrap_or(case);
    let no_text =
        |_| refused(path, "leads to a case whose path is no text: give it another name, and add it again");
    let leads_to = case.into_os_string().into_string().map_err(no_text)?;
    Ok(Some(CaseLink { name, leads_to }))
}

/// What a living server has just removed is not missed.
fn there<T>(found: io::Result<T>) -> io::Result<Option<T>> {
    match found {
        Ok(found) => Ok(Some(found)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// An archive that is being written.
struct Archive {
    zip: ZipWriter<NamedTempFile>,
    entries: Vec<Entry>,
}

impl Archive {
    fn new(file: NamedTempFile) -> Self {
        Self { zip: ZipWriter::new(file), entries: Vec::new() }
    }

    fn options() -> SimpleFileOptions {
        // Sizes are not known before.
        SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .last_modified_time(DateTime::default())
            .large_file(true)
    }

    fn add(&mut self, name: &str, path: &Path) -> Result<(), Error> {
        let Some(mut file) = there(File::open(path)).map_err(failed(path))? else { return Ok(()) };
        self.zip.start_file(name, Self::options()).map_err(io::Error::from).map_err(failed(path))?;
        let (bytes, blake3) = copied(&mut file, &mut self.zip).map_err(failed(path))?;
        self.entries.push(Entry { name: name.to_owned(), bytes, blake3 });
        Ok(())
    }

    /// Writes the manifest and lets the file appear.
    fn end(mut self, cases: Vec<CaseLink>, now: Timestamp, to: &Path) -> Result<Saved, Error> {
        let n_files = self.entries.len();
        let made_by = concat!("lumenfab ", env!("CARGO_PKG_VERSION")).to_owned();
        let manifest = Manifest { format: FORMAT, made_by, made_at: now, entries: self.entries, cases };
        let finish = || {
            self.zip.start_file(MANIFEST, Self::options())?;
            serde_json::to_writer_pretty(&mut self.zip, &manifest)?;
            let file = self.zip.finish()?;
            file.as_file().sync_all()?;
            let bytes = file.as_file().metadata()?.len();
            file.persist(to).map_err(|e| e.error)?;
            Ok(bytes)
        };
        let bytes = finish().map_err(failed(to))?;
        Ok(Saved { n_files, bytes })
    }
}

/// Copies all there is; how much, and its hash.
fn copied(from: &mut impl Read, to: &mut impl Write) -> io::Result<(u64, String)> {
    let (mut hasher, mut bytes, mut block) = (blake3::Hasher::new(), 0, vec![0; BLOCK]);
    loop {
        let n = from.read(&mut block)?;
        if n == 0 {
            return Ok((bytes, hasher.finalize().to_hex().to_string()));
        }
        hasher.update(&block[..n]);
        to.write_all(&block[..n])?;
        bytes += n as u64;
    }
}

/// Makes a state directory from a backup, where there is none or an empty one.
///
/// # Errors
/// [`Error::Backup`] where the directory holds something, or where the file is no backup or damaged; [`Error::Io`], [`Error::Store`].
pub async fn restore(from: &Path, dir: &Path, now: Timestamp) -> Result<Restored, Error> {
    let is_free =
        there(std::fs::read_dir(dir)).map_err(failed(dir))?.is_none_or(|mut found| found.next().is_none());
    if !is_free {
        return Err(refused(
            dir,
            "holds something already: move it aside first, or name another directory with --state",
        ));
    }
    let home = std::path::absolute(dir).map_err(failed(dir))?;
    let folder = home.parent().unwrap_or(Path::new("/"));
    super::place::make(folder)?;
    let mut staging = tempfile::Builder::new();
    staging.prefix(".lumenfab-restore-").permissions(PermissionsExt::from_mode(0o700));
    let staging = staging.tempdir_in(folder).map_err(failed(folder))?;
    let manifest = unpack(from, &staging, &home)?;
    let n_held = check_and_hold(&staging.path().join(QUEUE), &manifest, now).await?;
    // Renaming onto an empty directory replaces it.
    std::fs::rename(staging.path(), &home).map_err(failed(&home))?;
    Ok(Restored { made_at: manifest.made_at, n_files: manifest.entries.len(), n_held })
}

/// Unpacks what the manifest names, and nothing else; it will lie at `home`.
fn unpack(from: &Path, into: &TempDir, home: &Path) -> Result<Manifest, Error> {
    let file = File::open(from).map_err(failed(from))?;
    let no_backup = || refused(from, "is no backup of lumenfab, or only a part of one");
    let mut archive = ZipArchive::new(BufReader::new(file)).map_err(|_no_archive| no_backup())?;
    let manifest = manifest_of(&mut archive).ok_or_else(no_backup)?;
    if manifest.format > FORMAT {
        return Err(refused(from, "was made by a later version: restore it with that one"));
    }
    if !manifest.entries.iter().any(|entry| entry.name == QUEUE) {
        return Err(no_backup());
    }
    for entry in &manifest.entries {
        let path = placed(into.path(), &entry.name)
            .ok_or_else(|| refused(from, "names a file outside the state directory"))?;
        let damaged = || refused(from, &format!("is damaged: {} is not what was written", entry.name));
        let packed = archive.by_name(&entry.name).map_err(|_missing| damaged())?;
        if let Some(folder) = path.parent() {
            super::place::make(folder)?;
        }
        let mut file = File::create_new(&path).map_err(failed(&path))?;
        file.set_permissions(PermissionsExt::from_mode(0o600)).map_err(failed(&path))?;
        // No more than was said: an archive can promise little and hold much.
        let found = copied(&mut packed.take(entry.bytes + 1), &mut file).map_err(failed(&path))?;
        if found != (entry.bytes, entry.blake3.clone()) {
            return Err(damaged());
        }
        file.sync_all().map_err(failed(&path))?;
    }
    for CaseLink { name, leads_to } in &manifest.cases {
        if !is_case(name) {
            return Err(refused(from, &format!("is damaged: {name} is no name of a case")));
        }
        let path = into.path().join(name);
        path.parent().map_or(Ok(()), super::place::make)?;
        symlink(home.join(leads_to), &path).map_err(failed(&path))?;
    }
    Ok(manifest)
}

fn manifest_of(archive: &mut ZipArchive<impl Read + Seek>) -> Option<Manifest> {
    let file = archive.by_name(MANIFEST).ok()?;
    serde_json::from_reader(file.take(MOST_MANIFEST)).ok()
}

/// Where a file of a backup belongs; none for a name that leads out of the directory.
fn placed(dir: &Path, name: &str) -> Option<PathBuf> {
    let path = Path::new(name);
    let is_within = path.components().all(|part| matches!(part, Component::Normal(_)));
    let is_known = name == QUEUE
        || FILES.contains(&name)
        || FOLDERS.iter().any(|folder| name.strip_prefix(folder).is_some_and(|rest| rest.starts_with('/')));
    (is_within && is_known).then(|| dir.join(path))
}

/// Whether the queue is sound, with all of its history; holds what may have been printed since, and doubts all beds. How many are held.
async fn check_and_hold(queue: &Path, manifest: &Manifest, now: Timestamp) -> Result<usize, Error> {
    let store = Sqlite::open(queue)?;
    let held = async {
        store.verify().await?;
        let why =
            format!("restored from the backup of {}: see whether it was printed since", manifest.made_at);
        let by = By { who: Who::Policy(Name::try_new(RULE)?), why: Reason::try_new(&why)?, now };
        // Before anything is given back: no bed is clear by that.
        for printer in store.printers().await? {
            store.say(printer.name, Said::BedInDoubt, by.clone()).await?;
        }
        give_back(&store, &by).await?;
        hold(&store, &by).await
    };
    let held = held.await;
    store.close().await;
    held
}

/// What was being prepared, or warmed up, is in nobody's hand any more.
async fn give_back(store: &Sqlite, by: &By) -> Result<(), Error> {
    let live = all_live(store).await?;
    let in_hand = live.into_iter().filter(|job| job.state.is_claimed() && !job.is_laid);
    let holders: BTreeSet<Name> = in_hand.filter_map(|job| job.holder).collect();
    for holder in holders {
        // Whoever held it, it was in another state directory: no other process has this one's queue.
        let adopted = store.adopt(holder, by.now).await?;
        for store::Claimed { job, claim } in adopted.into_iter().filter(|claimed| !claimed.job.is_laid) {
            let actor = Actor::Holder { claim, asked_by: None };
            let change = Change::GiveBack { lost: false };
            store.change(job.id, Request { change, actor, why: by.why.clone(), now: by.now }).await?;
        }
    }
    Ok(())
}

async fn hold(store: &Sqlite, by: &By) -> Result<usize, Error> {
    let mut n_held = 0;
    for job in all_live(store).await?.into_iter().filter(|job| job.state == State::Queued) {
        let actor = Actor::Policy { name: Name::try_new(RULE)?, saw: job.state };
        let request = Request { change: Change::Hold, actor, why: by.why.clone(), now: by.now };
        store.change(job.id, request).await?;
        n_held += 1;
    }
    Ok(n_held)
}

async fn all_live(store: &Sqlite) -> Result<Vec<Job>, Error> {
    let mut jobs: Vec<Job> = Vec::new();
    loop {
        let page = store.list(Which::Live, jobs.last().map(|job| job.id), PAGE).await?;
        if page.is_empty() {
            return Ok(jobs);
        }
        jobs.extend(page);
    }
}

fn failed(path: &Path) -> impl Fn(io::Error) -> Error {
    let path = path.to_owned();
    move |source| Error::Io { path: path.clone(), source }
}

fn refused(path: &Path, problem: &str) -> Error {
    Error::Backup { path: path.to_owned(), problem: problem.to_owned() }
}

#[cfg(test)]
mod tests;
