//! The case directory: everything that is known about one vessel, from its contours to its report.
//!
//! | entry | made by | what it is |
//! |---|---|---|
//! | `case.toml` | the first stage | all parameters, defaults filled in; neither a name nor a source path |
//! | `stages.toml` | every stage | the hashes (BLAKE3) of what each stage was made from and of what it made; its summary and warnings |
//! | `volume.bin` | segment | the CT around the lumen, for the report's pictures ([`super::volume_file`]) |
//! | `segmentation.json` | segment | window, polarity and planes that the lumen was found with |
//! | `contours.png` | segment | some planes of the CT with their contours, to look at |
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

mod draft;
#[cfg(test)]
mod tests;

use super::atomic::{self, FileError, failed};
use super::event::Stage;
use super::seal::{self, KeyFile, Standing};
use super::settings::{CaseFile, Settings};
use crate::ct::Warning;
use draft::{Draft, is_unfinished, lock};
use serde::{Deserialize, Serialize};
use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// The file that makes a directory a case.
pub const CASE_FILE: &str = "case.toml";
pub(super) const MANIFEST_FILE: &str = "stages.toml";
/// The result that operators are told to correct by hand.
pub(crate) const CONTOURS_FILE: &str = "sections.json";
/// What a print leaves beside the job.
pub(super) const JOURNAL_FILE: &str = "job.gcode.journal";
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
    /// The record of the case is not the one that was sealed.
    #[error(
        "the seal of {} does not hold ({file}: {problem}): no stage goes on from it. `lumenfab verify {}` tells what was changed; put the case back from a copy, or start a new one from its source with --out",
        dir.display(), dir.display()
    )]
    SealBroken {
        /// The case.
        dir: PathBuf,
        /// The file that is not as it was.
        file: String,
        /// What is wrong with it.
        problem: seal::Problem,
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

/// What a stage was made from and what it made, by name, and what it told.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
struct Record {
    made_from: BTreeMap<String, String>,
    made: BTreeMap<String, String>,
    /// What lay beside the results when the stage was done, and what it was made from rests on: the journal of a print.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    beside: BTreeMap<String, String>,
    #[serde(default)]
    told: Told,
}

/// A case as it lies there, looked at without holding it.
#[derive(Debug, Clone, PartialEq)]
pub struct Look {
    /// Its parameters, defaults filled in.
    pub parameters: CaseFile,
    /// The stages that were done, in order, and what each told. Whether they are up to date is not looked at.
    pub told: Vec<(Stage, Told)>,
}

/// Looks at a case, which another process may be working on.
///
/// # Errors
/// [`CaseError`] where its files are damaged.
pub fn look(dir: &Path) -> Result<Look, CaseError> {
    let (id, settings) = read_settings(&dir.join(CASE_FILE))?;
    let manifest = read_manifest(&dir.join(MANIFEST_FILE))?;
    let told = manifest.into_iter().map(|(stage, record)| (stage, record.told)).collect();
    Ok(Look { parameters: CaseFile::of_case(&id, &settings), told })
}

/// What a stage told the operator once it was done; told again where it is kept.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Told {
    /// What came out, one line.
    #[serde(default)]
    pub summary: String,
    /// What was odd.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<Warning>,
}

type Manifest = BTreeMap<Stage, Record>;

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
        draft::sweep(atomic::parent(dir));
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
            self.standing()?;
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

    /// What a stage told when it was done.
    #[must_use]
    pub fn told(&self, stage: Stage) -> Told {
        self.manifest.get(&stage).map(|record| record.told.clone()).unwrap_or_default()
    }

    /// Makes what a stage wrote part of the case, under the same names; the first stage brings the case into being.
    ///
    /// # Errors
    /// [`FileError`] where a disk is full or a directory cannot be written.
    pub fn commit(
        &mut self,
        stage: Stage,
        made_from: &MadeFrom,
        staging: Staging,
        told: Told,
    ) -> Result<(), CaseError> {
        self.standing()?;
        atomic::sync_tree(staging.path())?;
        let base = self.base()?.to_owned();
        let mut record = Record {
            made_from: made_from.iter().map(|(k, v)| ((*k).to_owned(), v.clone())).collect(),
            made: BTreeMap::new(),
            beside: BTreeMap::new(),
            told,
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
        self.keep_journal(stage, &base, &mut record)?;
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
            self.manifest.insert(refused.stage, Record { made_from, ..Record::default() });
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
        let text = toml::to_string(&self.manifest).expect("maps and texts can be written as TOML");
        if let Some(key) = &self.key {
            seal::announce(base, key, &text)?;
        }
        Ok(atomic::write(&base.join(MANIFEST_FILE), text.as_bytes())?)
    }
}

impl Case {
    /// Whether the record is the sealed one, so that a stage may go on from it; by whom it is sealed.
    ///
    /// # Errors
    /// [`CaseError::SealBroken`] where it is not.
    pub(super) fn standing(&self) -> Result<Standing, CaseError> {
        let key = self.key.as_ref().filter(|_| self.draft.is_none());
        key.map_or(Ok(Standing::Own), |key| seal::standing(&self.dir, key))
    }

    /// The journal as it is when a stage is done that rests on it; an earlier stage may have seen less of it.
    fn keep_journal(&mut self, stage: Stage, base: &Path, record: &mut Record) -> Result<(), CaseError> {
        if !matches!(stage, Stage::Print | Stage::Report) {
            return Ok(());
        }
        self.manifest.values_mut().for_each(|earlier| earlier.beside.clear());
        let path = base.join(JOURNAL_FILE);
        if path.exists() {
            record.beside.insert(JOURNAL_FILE.into(), atomic::hash_of_path(&path)?);
        }
        Ok(())
    }

    /// What is wrong with the journal against the one that the record keeps; a case without either has nothing that could be.
    pub(super) fn journal_problem(&self) -> Result<Option<seal::Problem>, CaseError> {
        let kept = self.manifest.values().find_map(|record| record.beside.get(JOURNAL_FILE));
        let Some(kept) = kept.filter(|_| self.key.is_some()) else { return Ok(None) };
        let path = self.dir.join(JOURNAL_FILE);
        if !path.exists() {
            return Ok(Some(seal::Problem::Missing));
        }
        Ok((atomic::hash_of_path(&path)? != *kept).then_some(seal::Problem::Changed))
    }

    /// Refuses a journal that is not the one that the record keeps.
    ///
    /// # Errors
    /// [`CaseError::SealBroken`].
    pub(super) fn check_journal(&self) -> Result<(), CaseError> {
        let broken =
            |problem| CaseError::SealBroken { dir: self.dir.clone(), file: JOURNAL_FILE.into(), problem };
        self.journal_problem()?.map_or(Ok(()), |problem| Err(broken(problem)))
    }

    /// Seals the journal of a print that broke off in the place of the one that the record keeps: the program itself has changed it.
    ///
    /// # Errors
    /// [`CaseError`] where the record is not the sealed one, or cannot be written.
    pub(super) fn keep_broken_print(&mut self) -> Result<(), CaseError> {
        if !matches!(self.journal_problem()?, Some(seal::Problem::Changed)) {
            return Ok(());
        }
        self.standing()?;
        let hash = atomic::hash_of_path(&self.dir.join(JOURNAL_FILE))?;
        let kept = self.manifest.values_mut().filter_map(|record| record.beside.get_mut(JOURNAL_FILE));
        kept.for_each(|own| own.clone_from(&hash));
        let dir = self.dir.clone();
        self.write_manifest(&dir)?;
        self.seal(&dir)
    }

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

/// What lay beside the results when they were made, with the hash that it had.
pub(super) fn beside(dir: &Path) -> Result<Vec<(String, String)>, CaseError> {
    let manifest = read_manifest(&dir.join(MANIFEST_FILE))?;
    Ok(manifest.into_values().flat_map(|record| record.beside).collect())
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
