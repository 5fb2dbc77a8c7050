//! The case directory: everything that is known about one vessel, from its contours to its report.
//!
//! | entry | made by | what it is |
//! |---|---|---|
//! | `case.toml` | the first stage | all parameters, defaults filled in; neither a name nor a source path |
//! | `stages.toml` | every stage | the hashes (BLAKE3) of what each stage was made from and of what it made |
//! | `volume.bin` | segment | the CT around the lumen, for the report's pictures ([`super::volume_file`]) |
//! | `segmentation.json` | segment | window, polarity and planes that the lumen was found with |
//! | `leak.png` | segment | where the region left the vessel, instead of all others of segment |
//! | `sections.json` | segment | contours per CT plane |
//! | `planes/` | solid | pictures of the planes, where their contours make no solid |
//! | `solid.bin` | solid | what the solid consists of ([`super::packed`]) |
//! | `topology.json` | solid | which contour continues which, and why |
//! | `wall.json` | solid | how thick the wall is, as built; `null` for a cast |
//! | `job.gcode`, `layers.json` | slice | the print job; layers against CT planes, `bed_from_stack` |
//! | `record/`, `print.json` | print | what the simulated printer laid down; how the print went |
//! | `seal.toml` | every stage | signature of `case.toml` and `stages.toml` ([`super::seal`]) |
//! | `report/` | report | `index.html`, `report.json`, pictures |
//!
//! A stage writes into a hidden directory beside its outputs; when it is through, these are flushed to the disk and
//! renamed into place, and only then `stages.toml` says so. A new case is put together beside its place and
//! renamed there with its first stage done: a first stage that fails leaves nothing behind, unless the region leaked, which is
//! to be corrected in `case.toml`. One process works on a case at a time (a lock on `stages.lock`).

use super::atomic::{self, FileError, failed};
use super::event::Stage;
use super::seal::{self, KeyFile};
use super::settings::{CaseFile, Settings};
use serde::{Deserialize, Serialize};
use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::fs::{self, File, TryLockError};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// The file that makes a directory a case.
pub const CASE_FILE: &str = "case.toml";
pub(super) const MANIFEST_FILE: &str = "stages.toml";
const LOCK_FILE: &str = "stages.lock";
/// The result that operators are told to correct by hand.
pub(crate) const CONTOURS_FILE: &str = "sections.json";
/// Begins the name of everything that is not finished.
const UNFINISHED: &str = ".lumenfab-";

/// The directory cannot serve as a case.
#[derive(Debug, thiserror::Error)]
pub enum CaseError {
    /// There is nothing at that place.
    #[error("no case at {}: start one with `lumenfab run` or `lumenfab segment`, each with --ct and --out", .0.display())]
    Missing(PathBuf),
    /// There is something else.
    #[error("{} is no case directory (it has no {CASE_FILE}): name another one; to start a case from a CT: segment --ct PATH --out CASE", .0.display())]
    NotACase(PathBuf),
    /// There is something else where a case is to be made.
    #[error("{} exists, is not empty and is no case: name a new or empty directory with --out", .0.display())]
    Occupied(PathBuf),
    /// There is a case already.
    #[error("{} is a case already, made from another source: choose another --out, or delete that directory", .0.display())]
    OtherSource(PathBuf),
    /// A result was changed since it was made; making it again would lose that.
    #[error("{} was changed by hand since it was made: {}", path.display(), how_to_keep(path))]
    Edited {
        /// The result.
        path: PathBuf,
    },
    /// The contours that a case was started from are gone.
    #[error(
        "{} has lost the contours it was started from: run `lumenfab solid --sections FILE --out {}` with them",
        .0.display(), .0.display()
    )]
    ContoursLost(PathBuf),
    /// Another process works on it.
    #[error("{} is being worked on by another lumenfab: wait until that one has ended", .0.display())]
    InUse(PathBuf),
    /// A stage's output is not there.
    #[error("{} has no {file} yet: run `lumenfab {stage} {}` first", dir.display(), dir.display())]
    NotYet {
        /// The case.
        dir: PathBuf,
        /// What is missing.
        file: &'static str,
        /// The stage that makes it.
        stage: Stage,
    },
    /// A stage's output is older than what it is made from.
    #[error(
        "the output of {stage} in {} is {}: run `lumenfab {stage} {}` first, or `lumenfab run {}`",
        dir.display(), stale(changed), dir.display(), dir.display()
    )]
    Stale {
        /// The case.
        dir: PathBuf,
        /// The stage to do again.
        stage: Stage,
        /// What has changed since; nothing where it was never done.
        changed: Vec<String>,
    },
    /// A file of the case does not say what it should.
    #[error("{}: {problem}", path.display())]
    Corrupt {
        /// The file.
        path: PathBuf,
        /// What is wrong with it, one line.
        problem: String,
    },
    /// A file or directory could not be read or written.
    #[error(transparent)]
    File(#[from] FileError),
}

/// What to do with a result that was changed by hand.
fn how_to_keep(path: &Path) -> String {
    let shown = path.display();
    if path.file_name().is_some_and(|name| name == CONTOURS_FILE) {
        format!(
            "to go on from it, run `lumenfab solid --sections {shown} --out NEW`; to have it made again, delete it"
        )
    } else {
        "move it away to keep it; it is then made again".into()
    }
}

fn stale(changed: &[String]) -> String {
    if changed.is_empty() {
        return "missing".into();
    }
    format!("out of date ({} changed)", changed.join(", "))
}

/// The things a stage is made from: a name for each, and its hash.
pub type MadeFrom = BTreeMap<&'static str, String>;

/// What a stage was made from and what it made, by name.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
struct Record {
    made_from: BTreeMap<String, String>,
    made: BTreeMap<String, String>,
}

type Manifest = BTreeMap<Stage, Record>;

/// A new case while it is put together; removed with all that is in it unless it is published.
#[derive(Debug)]
struct Draft {
    dir: TempDir,
    /// Tells it from one whose process was killed.
    lock: File,
    /// After `dir`, so that they are empty when their turn comes.
    parents: NewParents,
}

impl Draft {
    fn beside(place: &Path) -> Result<Self, CaseError> {
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
struct NewParents(Vec<PathBuf>);

impl NewParents {
    /// Those that are missing now.
    fn above(place: &Path) -> Self {
        Self(atomic::parent(place).ancestors().take_while(|p| !p.exists()).map(Path::to_owned).collect())
    }

    fn keep(mut self) {
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
fn sweep_drafts(parent: &Path) {
    let is_draft = |p: &PathBuf| is_unfinished(p) && p.join(LOCK_FILE).is_file();
    for draft in atomic::entries(parent).unwrap_or_default().into_iter().filter(is_draft) {
        // Somebody else's, or at work: it is left alone.
        if let Err(e) = lock(&draft).and_then(|_lock| Ok(atomic::remove(&draft)?)) {
            tracing::debug!("an unfinished case stays: {e}");
        }
    }
}

fn is_unfinished(path: &Path) -> bool {
    path.file_name().is_some_and(|n| n.to_string_lossy().starts_with(UNFINISHED))
}

/// A case directory, locked for this process.
#[derive(Debug)]
pub struct Case {
    /// Where the case is, or will be once its first stage is done.
    dir: PathBuf,
    /// Where it is put together while it is new.
    draft: Option<OnceCell<Draft>>,
    id: String,
    settings: Settings,
    /// Whether they differ from what is written down.
    has_new_settings: bool,
    manifest: Manifest,
    /// What it is sealed with, where there is a place for a key.
    key: Option<KeyFile>,
    /// Held as long as the case is open.
    lock: Option<File>,
}

/// A stage that could not be done.
#[derive(Debug, Clone, Copy)]
pub struct Refused<'a> {
    /// The stage.
    pub stage: Stage,
    /// What it would have been made from.
    pub made_from: &'a MadeFrom,
}

/// What a stage's parameters are called among what it was made from.
pub(crate) const PARAMETERS: &str = "parameters";

impl Case {
    /// A case that does not exist yet: nothing is written before its first stage is done, or refused with something to look at.
    ///
    /// # Errors
    /// [`CaseError::Occupied`] where something else is in its place.
    pub fn create(dir: &Path, id: String, settings: Settings) -> Result<Self, CaseError> {
        if !is_vacant(dir)? {
            return Err(CaseError::Occupied(dir.to_owned()));
        }
        let draft = Some(OnceCell::new());
        sweep_drafts(atomic::parent(dir));
        Ok(Self {
            dir: dir.to_owned(),
            draft,
            id,
            settings,
            has_new_settings: true,
            manifest: Manifest::new(),
            key: None,
            lock: None,
        })
    }

    /// Opens a case and locks it; leftovers of a process that was killed are removed.
    ///
    /// # Errors
    /// [`CaseError`] where there is no case, where its files are damaged, or where another process has it open.
    pub fn open(dir: &Path) -> Result<Self, CaseError> {
        if !is_case(dir) {
            let vacant = is_vacant(dir)?;
            return Err(if vacant { CaseError::Missing } else { CaseError::NotACase }(dir.to_owned()));
        }
        let lock = lock(dir)?;
        atomic::entries(dir)?.iter().filter(|p| is_unfinished(p)).try_for_each(|p| atomic::remove(p))?;
        let (id, settings) = read_settings(&dir.join(CASE_FILE))?;
        let manifest = read_manifest(&dir.join(MANIFEST_FILE))?;
        Ok(Self {
            dir: dir.to_owned(),
            draft: None,
            id,
            settings,
            has_new_settings: false,
            manifest,
            key: None,
            lock: Some(lock),
        })
    }

    /// Seals the case with this key whenever it changes from now on.
    pub fn seal_with(&mut self, key: KeyFile) {
        self.key = Some(key);
    }

    /// Where the case is, or will be once its first stage is done.
    #[must_use]
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// The name the case was given; tells nothing about the patient.
    #[must_use]
    pub fn id(&self) -> &str {
        &self.id
    }

    /// The parameters.
    #[must_use]
    pub const fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Changes the parameters; written with the next stage that is done, or by [`Case::keep_settings`].
    pub fn set_settings(&mut self, settings: Settings) {
        self.has_new_settings |= self.settings != settings;
        self.settings = settings;
    }

    /// Writes changed parameters down, once they were of use to a stage.
    ///
    /// # Errors
    /// [`FileError`] where `case.toml` cannot be written.
    pub fn keep_settings(&mut self) -> Result<(), CaseError> {
        if self.has_new_settings && self.draft.is_none() {
            self.write_settings(&self.dir)?;
            self.has_new_settings = false;
            self.seal(&self.dir)?;
        }
        Ok(())
    }

    /// Path of a file or directory of the case, whether it is there or not.
    #[must_use]
    pub fn path(&self, name: &str) -> PathBuf {
        self.dir.join(name)
    }

    /// Path of something that a stage made.
    ///
    /// # Errors
    /// [`CaseError::NotYet`], naming the stage to run first.
    pub fn output(&self, stage: Stage, file: &'static str) -> Result<PathBuf, CaseError> {
        let path = self.path(file);
        if path.exists() { Ok(path) } else { Err(CaseError::NotYet { dir: self.dir.clone(), file, stage }) }
    }

    /// The hash of something that a stage made, as it is on the disk now.
    ///
    /// # Errors
    /// [`CaseError::NotYet`] where it is not there; [`FileError`] where it cannot be read.
    pub fn output_hash(&self, stage: Stage, file: &'static str) -> Result<String, CaseError> {
        Ok(atomic::hash_of_path(&self.output(stage, file)?)?)
    }

    /// Whether any stage is done.
    #[must_use]
    pub fn has_results(&self) -> bool {
        self.manifest.values().any(|record| !record.made.is_empty())
    }

    /// What a stage was made from when it was last done, by name.
    #[must_use]
    pub fn made_from(&self, stage: Stage) -> Option<&BTreeMap<String, String>> {
        self.manifest.get(&stage).map(|r| &r.made_from)
    }

    /// Why a stage has to be done: the names of what is new or changed since it was last done; `None` where it is
    /// up to date. What it made counts too: what was removed is made again.
    ///
    /// # Errors
    /// [`CaseError::Edited`] where a file it made was changed by hand; [`FileError`] where one cannot be read.
    pub fn outdated(&self, stage: Stage, made_from: &MadeFrom) -> Result<Option<Vec<String>>, CaseError> {
        let Some(record) = self.manifest.get(&stage) else { return Ok(Some(Vec::new())) };
        let changed = |(name, hash): &(&&str, &String)| record.made_from.get(**name) != Some(*hash);
        let mut reasons: Vec<String> = made_from.iter().filter(changed).map(|(n, _)| (*n).into()).collect();
        for (name, hash) in &record.made {
            let path = self.path(name);
            if path.exists() && atomic::hash_of_path(&path)? == *hash {
                continue;
            }
            if path.is_file() {
                return Err(CaseError::Edited { path });
            }
            reasons.push(name.clone());
        }
        Ok((!reasons.is_empty()).then_some(reasons))
    }

    /// A place for a stage to write its outputs to before they are made part of the case.
    ///
    /// # Errors
    /// [`FileError`] where the directory cannot be written.
    pub fn staging(&self) -> Result<Staging, CaseError> {
        let base = self.base()?;
        let made = tempfile::Builder::new().prefix(UNFINISHED).tempdir_in(base);
        Ok(Staging(made.map_err(failed("create a directory in", base))?))
    }

    /// Makes what a stage wrote part of the case, under the same names; the first stage brings the case into being.
    ///
    /// # Errors
    /// [`FileError`] where a disk is full or a directory cannot be written.
    pub fn commit(&mut self, stage: Stage, made_from: &MadeFrom, staging: Staging) -> Result<(), CaseError> {
        atomic::sync_tree(staging.path())?;
        let base = self.base()?.to_owned();
        let mut record = Record {
            made_from: made_from.iter().map(|(k, v)| ((*k).to_owned(), v.clone())).collect(),
            made: BTreeMap::new(),
        };
        // Until the new outputs are all in place, the stage counts as not done.
        let previous = self.manifest.remove(&stage).unwrap_or_default();
        for file in atomic::entries(staging.path())? {
            let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
            record.made.insert(name.clone(), atomic::hash_of_path(&file)?);
            replace(&file, &base.join(&name))?;
        }
        for gone in previous.made.keys().filter(|name| !record.made.contains_key(*name)) {
            atomic::remove(&base.join(gone))?;
        }
        // Gone before the draft is renamed: its guard would not find it afterwards.
        drop(staging);
        atomic::sync_dir(&base)?;
        self.manifest.insert(stage, record);
        if self.has_new_settings {
            self.write_settings(&base)?;
            self.has_new_settings = false;
        }
        self.write_manifest(&base)?;
        self.seal(&base)?;
        self.publish()
    }

    /// Keeps a picture of why a stage could not be done; a case that does not exist yet comes into being, so that the
    /// operator has a `case.toml` to correct. It keeps what it was started from, without which no other one would be refused;
    /// the parameters are left out: the stage stays to be done.
    ///
    /// # Errors
    /// [`FileError`] where a disk is full or a directory cannot be written.
    pub fn keep_refused(
        &mut self,
        name: &str,
        picture: &[u8],
        refused: Refused<'_>,
    ) -> Result<(), CaseError> {
        let base = self.base()?.to_owned();
        atomic::write(&base.join(name), picture)?;
        if self.draft.is_some() {
            let made_from = refused.made_from.iter().filter(|(name, _)| **name != PARAMETERS);
            let made_from = made_from.map(|(name, hash)| ((*name).to_owned(), hash.clone())).collect();
            self.manifest.insert(refused.stage, Record { made_from, made: BTreeMap::new() });
            self.write_settings(&base)?;
            self.has_new_settings = false;
            self.write_manifest(&base)?;
            self.seal(&base)?;
        }
        self.publish()
    }

    /// The directory that is written to: the case, or its draft.
    fn base(&self) -> Result<&Path, CaseError> {
        let Some(draft) = &self.draft else { return Ok(&self.dir) };
        if let Some(made) = draft.get() {
            return Ok(made.dir.path());
        }
        let made = Draft::beside(&self.dir)?;
        Ok(draft.get_or_init(|| made).dir.path())
    }

    /// Brings a new case to its place.
    fn publish(&mut self) -> Result<(), CaseError> {
        let Some(made) = self.draft.take().and_then(OnceCell::into_inner) else { return Ok(()) };
        atomic::sync_dir(made.dir.path())?;
        // Renaming onto an empty directory replaces it; one that has been filled meanwhile is left alone.
        fs::rename(made.dir.path(), &self.dir).map_err(failed("create", &self.dir))?;
        // What the guard of the draft would remove is not there any more.
        let _moved = made.dir.keep();
        made.parents.keep();
        // The lock has moved with the directory.
        self.lock = Some(made.lock);
        Ok(atomic::sync_dir(atomic::parent(&self.dir))?)
    }

    fn write_settings(&self, base: &Path) -> Result<(), CaseError> {
        let file = CaseFile::of_case(&self.id, &self.settings);
        Ok(atomic::write(&base.join(CASE_FILE), file.to_toml().as_bytes())?)
    }

    fn write_manifest(&self, base: &Path) -> Result<(), CaseError> {
        let text = toml::to_string(&self.manifest).expect("a map of strings can be written as TOML");
        Ok(atomic::write(&base.join(MANIFEST_FILE), text.as_bytes())?)
    }
}

impl Case {
    fn seal(&self, base: &Path) -> Result<(), CaseError> {
        let is_whole = base.join(MANIFEST_FILE).exists();
        self.key.as_ref().filter(|_| is_whole).map_or(Ok(()), |key| seal::seal(base, key))
    }
}

/// The results that a case's record names, each with its hash.
pub(super) fn made(dir: &Path) -> Result<Vec<(String, String)>, CaseError> {
    let manifest = read_manifest(&dir.join(MANIFEST_FILE))?;
    Ok(manifest.into_values().flat_map(|record| record.made).collect())
}

/// Whether there is a case that nobody works on; nothing in it is changed.
pub(super) fn check_readable(dir: &Path) -> Result<(), CaseError> {
    if !is_case(dir) {
        return Err(if is_vacant(dir)? { CaseError::Missing } else { CaseError::NotACase }(dir.to_owned()));
    }
    match lock(dir) {
        Err(in_use @ CaseError::InUse(_)) => Err(in_use),
        _ => Ok(()),
    }
}

/// Where a stage writes; removed with all that is in it unless it is committed.
#[derive(Debug)]
pub struct Staging(TempDir);

impl Staging {
    /// The directory to write to.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.0.path()
    }

    /// Writes a file under the name it will have in the case.
    ///
    /// # Errors
    /// [`FileError`] where the disk is full.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), FileError> {
        let path = self.path().join(name);
        fs::write(&path, bytes).map_err(failed("write", &path))
    }
}

/// Whether there is a case directory at the path.
#[must_use]
pub fn is_case(dir: &Path) -> bool {
    dir.join(CASE_FILE).is_file()
}

/// Whether a case could be made there: nothing, or an empty directory.
fn is_vacant(dir: &Path) -> Result<bool, FileError> {
    match fs::read_dir(dir) {
        Ok(mut entries) => Ok(entries.next().is_none()),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(true),
        Err(e) if e.kind() == std::io::ErrorKind::NotADirectory => Ok(false),
        Err(e) => Err(failed("list", dir)(e)),
    }
}

fn is_read_only(error: &std::io::Error) -> bool {
    matches!(error.kind(), std::io::ErrorKind::PermissionDenied | std::io::ErrorKind::ReadOnlyFilesystem)
}

fn lock(dir: &Path) -> Result<File, CaseError> {
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

fn read_settings(path: &Path) -> Result<(String, Settings), CaseError> {
    let corrupt = |problem| CaseError::Corrupt { path: path.to_owned(), problem };
    let file = CaseFile::from_toml(&atomic::read_text(path)?).map_err(corrupt)?;
    let id =
        file.id.clone().ok_or_else(|| corrupt("id is missing: this is no case directory's copy".into()))?;
    let settings = Settings::try_from(file).map_err(|e| corrupt(e.to_string()))?;
    Ok((id, settings))
}

fn read_manifest(path: &Path) -> Result<Manifest, CaseError> {
    if !path.exists() {
        return Ok(Manifest::new());
    }
    let parsed = toml::from_str(&atomic::read_text(path)?);
    parsed.map_err(|e| CaseError::Corrupt { path: path.to_owned(), problem: e.message().to_owned() })
}

/// Puts a finished file or directory in the place of the old one.
fn replace(new: &Path, place: &Path) -> Result<(), FileError> {
    if !place.is_dir() {
        return fs::rename(new, place).map_err(failed("create", place));
    }
    // A directory cannot be renamed over one that is not empty: the old one steps aside first, into the staging
    // directory, where it is removed together with it.
    let aside = new.with_file_name(format!("{UNFINISHED}old"));
    fs::rename(place, &aside).map_err(failed("replace", place))?;
    fs::rename(new, place).map_err(failed("create", place))?;
    atomic::remove(&aside)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings() -> Settings {
        Settings::try_from(CaseFile::default()).unwrap()
    }

    fn made_from(hash: &str) -> MadeFrom {
        MadeFrom::from([("ct", hash.to_owned()), ("parameters", "p".into())])
    }

    fn do_stage(case: &mut Case, hash: &str, files: &[(&str, &str)]) {
        let staging = case.staging().unwrap();
        for (name, text) in files {
            staging.write(name, text.as_bytes()).unwrap();
        }
        case.commit(Stage::Segment, &made_from(hash), staging).unwrap();
    }

    fn new_case(dir: &Path) -> Case {
        Case::create(dir, "id-1".into(), settings()).unwrap()
    }

    #[test]
    fn a_new_case_comes_into_being_with_its_first_stage() {
        let root = tempfile::tempdir().unwrap();
        let dir = root.path().join("deep/case");
        let mut case = new_case(&dir);
        assert!(!root.path().join("deep").exists());
        do_stage(&mut case, "1", &[("sections.json", "{}")]);
        assert_eq!(case.outdated(Stage::Segment, &made_from("1")).unwrap(), None);
        drop(case);
        let case = Case::open(&dir).unwrap();
        assert_eq!((case.id(), case.settings()), ("id-1", &settings()));
        assert_eq!(case.outdated(Stage::Segment, &made_from("1")).unwrap(), None);
        let names: Vec<_> = fs::read_dir(&dir).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(names.len(), 4, "{names:?}");
        assert_eq!(atomic::entries(&root.path().join("deep")).unwrap(), [dir]);
    }

    #[test]
    fn a_first_stage_that_fails_leaves_nothing_behind() {
        let root = tempfile::tempdir().unwrap();
        let case = new_case(&root.path().join("deep/down/case"));
        let staging = case.staging().unwrap();
        staging.write("sections.json", b"{").unwrap();
        drop(staging);
        drop(case);
        assert!(atomic::entries(root.path()).unwrap().is_empty());
    }

    #[test]
    fn a_stage_is_outdated_when_what_it_was_made_from_or_what_it_made_changes() {
        let root = tempfile::tempdir().unwrap();
        let mut case = new_case(&root.path().join("case"));
        assert_eq!(case.outdated(Stage::Segment, &made_from("1")).unwrap(), Some(vec![]));
        do_stage(&mut case, "1", &[("sections.json", "{}"), ("volume.bin", "v")]);
        assert_eq!(case.outdated(Stage::Segment, &made_from("2")).unwrap(), Some(vec!["ct".into()]));
        fs::remove_file(case.path("volume.bin")).unwrap();
        let reasons = case.outdated(Stage::Segment, &made_from("1")).unwrap().unwrap();
        assert_eq!(reasons, ["volume.bin"]);
    }

    #[test]
    fn a_result_that_was_changed_by_hand_is_not_made_again() {
        let root = tempfile::tempdir().unwrap();
        let mut case = new_case(&root.path().join("case"));
        do_stage(&mut case, "1", &[("sections.json", "{}"), ("volume.bin", "v")]);
        fs::write(case.path("sections.json"), "{ }").unwrap();
        let message = case.outdated(Stage::Segment, &made_from("2")).unwrap_err().to_string();
        assert!(message.contains("/case/sections.json was changed by hand"), "{message}");
        assert!(message.contains("run `lumenfab solid --sections /"), "{message}");
    }

    #[test]
    fn parameters_are_written_down_when_a_stage_had_use_for_them() {
        let root = tempfile::tempdir().unwrap();
        let dir = root.path().join("case");
        do_stage(&mut new_case(&dir), "1", &[("a", "1")]);
        let other = Settings { port: "/dev/ttyUSB0".into(), ..settings() };
        let mut case = Case::open(&dir).unwrap();
        case.set_settings(other.clone());
        drop(case);
        let mut case = Case::open(&dir).unwrap();
        assert_eq!(case.settings(), &settings());
        case.set_settings(other.clone());
        case.keep_settings().unwrap();
        drop(case);
        assert_eq!(Case::open(&dir).unwrap().settings(), &other);
    }

    #[test]
    fn drafts_of_killed_processes_are_swept_and_those_of_others_stay() {
        let root = tempfile::tempdir().unwrap();
        let killed = root.path().join(".lumenfab-killed");
        fs::create_dir(&killed).unwrap();
        fs::write(killed.join(LOCK_FILE), "").unwrap();
        let working = new_case(&root.path().join("one"));
        let staging = working.staging().unwrap();
        drop(new_case(&root.path().join("two")));
        assert!(staging.path().exists() && !killed.exists());
    }

    #[test]
    fn what_a_stage_made_is_replaced_and_what_it_no_longer_makes_is_removed() {
        let root = tempfile::tempdir().unwrap();
        let mut case = new_case(&root.path().join("case"));
        do_stage(&mut case, "1", &[("a", "1"), ("b", "1")]);
        for text in ["1", "2"] {
            let staging = case.staging().unwrap();
            fs::create_dir(staging.path().join("record")).unwrap();
            fs::write(staging.path().join("record/x"), text).unwrap();
            case.commit(Stage::Segment, &made_from(text), staging).unwrap();
            assert_eq!(atomic::read_text(&case.path("record/x")).unwrap(), text);
        }
        assert!(!case.path("a").exists() && !case.path("b").exists());
    }

    #[test]
    fn other_directories_are_left_alone() {
        let root = tempfile::tempdir().unwrap();
        let dir = root.path().join("thesis");
        fs::create_dir(&dir).unwrap();
        assert!(matches!(Case::open(&dir), Err(CaseError::Missing(_))));
        fs::write(dir.join("chapter1.tex"), "").unwrap();
        assert!(matches!(Case::open(&dir), Err(CaseError::NotACase(_))));
        assert!(matches!(Case::create(&dir, "i".into(), settings()), Err(CaseError::Occupied(_))));
        let file = dir.join("chapter1.tex");
        assert!(matches!(Case::create(&file, "i".into(), settings()), Err(CaseError::Occupied(_))));
    }

    #[test]
    fn two_processes_do_not_work_on_one_case_and_leftovers_are_swept() {
        let root = tempfile::tempdir().unwrap();
        let dir = root.path().join("case");
        let mut case = new_case(&dir);
        do_stage(&mut case, "1", &[("a", "1")]);
        assert!(matches!(Case::open(&dir), Err(CaseError::InUse(_))));
        drop(case);
        fs::create_dir(dir.join(".lumenfab-killed")).unwrap();
        Case::open(&dir).unwrap();
        assert!(!dir.join(".lumenfab-killed").exists());
    }

    #[test]
    fn a_damaged_case_file_is_named_with_its_line() {
        let root = tempfile::tempdir().unwrap();
        fs::write(root.path().join(CASE_FILE), "format = 1\nwall = 3\n").unwrap();
        let message = Case::open(root.path()).unwrap_err().to_string();
        assert!(message.contains("case.toml: line 2: unknown field `wall`"), "{message}");
    }

    #[test]
    fn a_missing_output_says_which_stage_to_run() {
        let root = tempfile::tempdir().unwrap();
        let mut case = new_case(&root.path().join("case"));
        do_stage(&mut case, "1", &[("a", "1")]);
        let message = case.output(Stage::Slice, "job.gcode").unwrap_err().to_string();
        assert!(message.contains("has no job.gcode yet: run `lumenfab slice "), "{message}");
    }
}
