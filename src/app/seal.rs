//! The seal of a case: whoever changes anything in it afterwards is found out.
//!
//! `stages.toml` holds the hash of every result, `case.toml` all parameters. `seal.toml` holds the hashes of these two and a
//! signature of them (Ed25519, RFC 8032) by a key that is made once for each installation and kept beside
//! the sources, readable by its owner alone. It is written anew with every stage that is done; it says nothing of the patient.
//!
//! [`verify`] only reads: a case on a read-only medium can be verified too.
//!
//! No stage goes on from a case whose record is not the sealed one (`standing`): what was forged would be sealed with the next result.
//! A record and its seal are two files: the seal is written first, with the hash of the record that is there and of the one to
//! come, so that the record is a sealed one whenever the power goes. `case.toml` is the operator's to correct and is not looked at here: every stage
//! compares its parameters by itself.
//!
//! A print leaves its journal beside the job; `stages.toml` keeps the hash that it had when print or report were done, or when a print
//! broke off that had begun with the sealed one. No report is made from another journal.

use super::atomic::{self, FileError, failed, hash_of_bytes};
use super::case::{self, CASE_FILE, CaseError, JOURNAL_FILE, MANIFEST_FILE};
use ed25519_dalek::{Signature, Signer, SigningKey, Verifier, VerifyingKey};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fmt;
use std::fs::{self, DirBuilder};
use std::io::ErrorKind;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

/// The seal's file in a case.
pub(super) const SEAL_FILE: &str = "seal.toml";
/// What comes and goes in a case beside the results of its stages.
const NOT_SEALED: [&str; 6] =
    [CASE_FILE, MANIFEST_FILE, SEAL_FILE, "stages.lock", JOURNAL_FILE, "job.gcode.resume.svg"];

/// The place of an installation's key.
#[derive(Debug, Clone)]
pub struct KeyFile(PathBuf);

impl KeyFile {
    /// In the given file, which need not be there yet.
    #[must_use]
    pub const fn at(path: PathBuf) -> Self {
        Self(path)
    }

    /// The key; made where there is none yet.
    fn key(&self) -> Result<SigningKey, CaseError> {
        if let Some(key) = self.existing()? {
            return Ok(key);
        }
        let mut secret = [0; 32];
        getrandom::fill(&mut secret)
            .map_err(|e| failed("make", &self.0)(std::io::Error::other(e.to_string())))?;
        self.keep(&secret)?;
        // Another process may have been quicker.
        self.existing()?.ok_or_else(|| failed("read", &self.0)(ErrorKind::NotFound.into()).into())
    }

    fn existing(&self) -> Result<Option<SigningKey>, CaseError> {
        let text = match fs::read_to_string(&self.0) {
            Err(e) if e.kind() == ErrorKind::NotFound => return Ok(None),
            text => text.map_err(failed("read", &self.0))?,
        };
        let problem = "expected the 64 hexadecimal digits of this installation's key: put its copy back, or move it away to have a new \
                       one made (cases sealed with the old one then need --key)";
        let secret = bytes_of_hex(text.trim())
            .ok_or_else(|| CaseError::Corrupt { path: self.0.clone(), problem: problem.into() })?;
        Ok(Some(SigningKey::from_bytes(&secret)))
    }

    /// Writes a new key whole, unless there is one.
    fn keep(&self, secret: &[u8; 32]) -> Result<(), FileError> {
        let dir = atomic::parent(&self.0);
        DirBuilder::new().recursive(true).mode(0o700).create(dir).map_err(failed("create", dir))?;
        // Created readable by its owner alone.
        let new = tempfile::NamedTempFile::new_in(dir).map_err(failed("create a file in", dir))?;
        fs::write(new.path(), hex(secret)).map_err(failed("write", &self.0))?;
        new.as_file().sync_all().map_err(failed("write", &self.0))?;
        match new.persist_noclobber(&self.0) {
            Err(e) if e.error.kind() != ErrorKind::AlreadyExists => Err(failed("write", &self.0)(e.error)),
            _ => Ok(()),
        }
    }
}

/// What the file says.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Seal {
    /// BLAKE3 of `case.toml` and of `stages.toml`.
    case: String,
    stages: String,
    /// That of the `stages.toml` before it, until the new one is in its place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    before: Option<String>,
    /// Public key of the installation, and its signature of both hashes.
    key: String,
    signature: String,
}

impl Seal {
    fn signed_text(&self) -> String {
        let before = self.before.as_ref().map_or_else(String::new, |hash| format!("{hash}\n"));
        format!("lumenfab seal 1\n{}\n{}\n{before}", self.case, self.stages)
    }

    fn has(&self, stages: &str) -> bool {
        self.stages == stages || self.before.as_deref() == Some(stages)
    }

    fn is_genuine(&self) -> bool {
        let key = bytes_of_hex(&self.key).and_then(|bytes| VerifyingKey::from_bytes(&bytes).ok());
        let signature = bytes_of_hex(&self.signature).map(|bytes| Signature::from_bytes(&bytes));
        let text = self.signed_text();
        key.zip(signature).is_some_and(|(key, signature)| key.verify(text.as_bytes(), &signature).is_ok())
    }
}

/// Seals a case as it is.
///
/// # Errors
/// [`CaseError`] where the key cannot be read or made, or the case cannot be written.
pub(super) fn seal(dir: &Path, key: &KeyFile) -> Result<(), CaseError> {
    let stages = atomic::hash_of_path(&dir.join(MANIFEST_FILE))?;
    write_seal(dir, key, stages, None)
}

/// Seals a case whose `stages.toml` is about to be replaced by `text`; nothing where none is there yet.
///
/// # Errors
/// As [`seal`].
pub(super) fn announce(dir: &Path, key: &KeyFile, text: &str) -> Result<(), CaseError> {
    let path = dir.join(MANIFEST_FILE);
    if !path.exists() {
        return Ok(());
    }
    write_seal(dir, key, hash_of_bytes(text.as_bytes()), Some(atomic::hash_of_path(&path)?))
}

fn write_seal(dir: &Path, key: &KeyFile, stages: String, before: Option<String>) -> Result<(), CaseError> {
    let key = key.key()?;
    let mut seal = Seal {
        case: atomic::hash_of_path(&dir.join(CASE_FILE))?,
        stages,
        before,
        key: hex(key.verifying_key().as_bytes()),
        signature: String::new(),
    };
    seal.signature = hex(&key.sign(seal.signed_text().as_bytes()).to_bytes());
    let text = toml::to_string(&seal).expect("strings can be written as TOML");
    Ok(atomic::write(&dir.join(SEAL_FILE), text.as_bytes())?)
}

/// How a case's record stands to its seal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Standing {
    /// There is nothing yet that could be sealed, or it is sealed with this installation's key.
    Own,
    /// Sealed by another installation.
    OfAnother,
}

/// Whether the record of a case is the sealed one.
///
/// # Errors
/// [`CaseError::SealBroken`] where it is not; [`FileError`] where something cannot be read.
pub(super) fn standing(dir: &Path, key: &KeyFile) -> Result<Standing, CaseError> {
    let path = dir.join(MANIFEST_FILE);
    if !path.exists() || case::made(dir)?.is_empty() {
        return Ok(Standing::Own);
    }
    let broken =
        |file: &str, problem| CaseError::SealBroken { dir: dir.to_owned(), file: file.into(), problem };
    let seal = read_seal(dir)?.map_err(|problem| broken(SEAL_FILE, problem))?;
    if !seal.has(&atomic::hash_of_path(&path)?) {
        return Err(broken(MANIFEST_FILE, Problem::Changed));
    }
    let own = key.existing()?.map(|key| hex(key.verifying_key().as_bytes()));
    Ok(if own.as_ref() == Some(&seal.key) { Standing::Own } else { Standing::OfAnother })
}

/// The seal of a case, or why there is none that counts.
fn read_seal(dir: &Path) -> Result<Result<Seal, Problem>, CaseError> {
    let text = match fs::read_to_string(dir.join(SEAL_FILE)) {
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(Err(Problem::NotSealed)),
        Err(e) if e.kind() == ErrorKind::InvalidData => String::new(),
        text => text.map_err(failed("read", &dir.join(SEAL_FILE)))?,
    };
    Ok(toml::from_str::<Seal>(&text).ok().filter(Seal::is_genuine).ok_or(Problem::NotGenuine))
}

/// What is wrong with a file of a case.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Problem {
    /// The case was never sealed, or the seal was taken away.
    NotSealed,
    /// The seal cannot be read, or its signature is not that of its key.
    NotGenuine,
    /// The seal is that of another installation.
    OtherKey,
    /// The file is not what it was when it was sealed.
    Changed,
    /// The file is gone.
    Missing,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotSealed => "there is no seal",
            Self::NotGenuine => "the seal is damaged or forged: the signature does not fit",
            Self::OtherKey => "sealed by another installation: give its key with --key to check against it",
            Self::Changed => "changed since it was made",
            Self::Missing => "gone",
        })
    }
}

/// Something that is wrong.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// The file, within the case.
    pub file: String,
    /// What is wrong with it.
    pub problem: Problem,
}

/// What came of looking at a case.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Verified {
    /// The case directory.
    pub case: PathBuf,
    /// Whether everything is as it was sealed.
    pub passed: bool,
    /// Public key of the installation that sealed it.
    pub key: Option<String>,
    /// Results that were looked at.
    pub n_files: usize,
    /// What is wrong.
    pub findings: Vec<Finding>,
    /// Files that no stage has made: nothing is known of them.
    pub unknown: Vec<String>,
}

impl fmt::Display for Verified {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for finding in &self.findings {
            writeln!(f, "{:<20} {}", finding.file, finding.problem)?;
        }
        for file in &self.unknown {
            writeln!(f, "{file:<20} made by no stage, nothing is known of it")?;
        }
        let verdict = if self.passed { "unchanged" } else { "NOT as it was sealed" };
        writeln!(f, "{}: {} results, {verdict}", self.case.display(), self.n_files)?;
        self.key.as_ref().map_or(Ok(()), |key| writeln!(f, "sealed with key {key}"))
    }
}

/// Compares a case with what was sealed. `expected` is the public key it must be sealed with (64 hexadecimal digits), else
/// that of this installation.
///
/// # Errors
/// [`CaseError`] where there is no case, where another process works on it, or where something cannot be read.
pub fn verify(dir: &Path, own: Option<&KeyFile>, expected: Option<&str>) -> Result<Verified, CaseError> {
    case::check_readable(dir)?;
    let mut found = Findings(Vec::new());
    let key = found.look_at_seal(dir, own, expected)?;
    let made = case::made(dir).unwrap_or_default();
    let beside = case::beside(dir).unwrap_or_default();
    for (name, hash) in made.iter().chain(&beside) {
        found.compare(dir, name, hash)?;
    }
    let known: BTreeSet<&str> = made.iter().map(|(name, _)| name.as_str()).chain(NOT_SEALED).collect();
    let unknown = atomic::entries(dir)?
        .iter()
        .filter_map(|path| path.file_name().map(|name| name.to_string_lossy().into_owned()))
        .filter(|name| !known.contains(name.as_str()))
        .collect();
    let findings = found.0;
    Ok(Verified {
        case: dir.to_owned(),
        passed: findings.is_empty(),
        key,
        n_files: made.len(),
        findings,
        unknown,
    })
}

struct Findings(Vec<Finding>);

impl Findings {
    fn add(&mut self, file: &str, problem: Problem) {
        self.0.push(Finding { file: file.to_owned(), problem });
    }

    /// The key of the seal, where there is one.
    fn look_at_seal(
        &mut self,
        dir: &Path,
        own: Option<&KeyFile>,
        expected: Option<&str>,
    ) -> Result<Option<String>, CaseError> {
        let seal = match read_seal(dir)? {
            Ok(seal) => seal,
            Err(problem) => {
                self.add(SEAL_FILE, problem);
                return Ok(None);
            }
        };
        let own = own.map(KeyFile::existing).transpose()?.flatten();
        let expected =
            expected.map(str::to_lowercase).or_else(|| own.map(|key| hex(key.verifying_key().as_bytes())));
        if expected.as_ref() != Some(&seal.key) {
            self.add(SEAL_FILE, Problem::OtherKey);
        }
        self.compare(dir, CASE_FILE, &seal.case)?;
        // Between the seal of a new record and the record itself, the old one is still a sealed one.
        let stages = seal.before.as_ref().filter(|b| is_now(dir, MANIFEST_FILE, b)).unwrap_or(&seal.stages);
        self.compare(dir, MANIFEST_FILE, stages)?;
        Ok(Some(seal.key))
    }

    fn compare(&mut self, dir: &Path, name: &str, hash: &str) -> Result<(), CaseError> {
        let path = dir.join(name);
        if !path.exists() {
            self.add(name, Problem::Missing);
        } else if atomic::hash_of_path(&path)? != hash {
            self.add(name, Problem::Changed);
        }
        Ok(())
    }
}

fn is_now(dir: &Path, name: &str, hash: &str) -> bool {
    atomic::hash_of_path(&dir.join(name)).is_ok_and(|now| now == hash)
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The bytes of so many pairs of hexadecimal digits.
fn bytes_of_hex<const N: usize>(text: &str) -> Option<[u8; N]> {
    let digits: Option<Vec<u8>> =
        text.chars().map(|c| c.to_digit(16).and_then(|d| u8::try_from(d).ok())).collect();
    let pairs: Vec<u8> = digits?.chunks_exact(2).map(|pair| 16 * pair[0] + pair[1]).collect();
    (text.len() == 2 * N).then(|| pairs.try_into().ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::case::Case;
    use crate::app::event::{Event, Stage};
    use crate::app::settings::{CaseFile, Settings};
    use crate::app::source::Sources;
    use crate::app::{Context, Session};
    use crate::printer::control::Controls;
    use crate::progress::{CancelToken, Cancelled, Task};

    struct Place(tempfile::TempDir);

    impl Place {
        fn new() -> Self {
            Self(tempfile::tempdir().unwrap())
        }

        fn key(&self) -> KeyFile {
            KeyFile::at(self.0.path().join("state/signing.key"))
        }

        fn case(&self) -> PathBuf {
            self.0.path().join("case")
        }

        fn file(&self, name: &str) -> PathBuf {
            self.case().join(name)
        }

        /// A case with one stage done.
        fn with_case() -> Self {
            let place = Self::new();
            let settings = Settings::try_from(CaseFile::default()).unwrap();
            let mut case = Case::create(&place.case(), "id".into(), settings).unwrap();
            case.seal_with(place.key());
            let staging = case.staging().unwrap();
            staging.write("sections.json", b"contours").unwrap();
            case.commit(Stage::Segment, &case::MadeFrom::new(), staging, case::Told::default()).unwrap();
            place
        }

        fn findings(&self) -> Vec<(String, Problem)> {
            let verified = verify(&self.case(), Some(&self.key()), None).unwrap();
            assert_eq!(verified.passed, verified.findings.is_empty());
            verified.findings.into_iter().map(|f| (f.file, f.problem)).collect()
        }
    }

    #[test]
    fn a_case_that_nobody_touched_passes() {
        let place = Place::with_case();
        assert_eq!(place.findings(), []);
        let verified = verify(&place.case(), Some(&place.key()), None).unwrap();
        assert_eq!((verified.n_files, verified.unknown), (1, vec![]));
        let key = verified.key.unwrap();
        assert!(verify(&place.case(), None, Some(&key)).unwrap().passed, "on another machine, by the key");
    }

    #[test]
    fn every_change_is_found() {
        for name in ["case.toml", "stages.toml", "sections.json"] {
            let place = Place::with_case();
            let mut bytes = fs::read(place.file(name)).unwrap();
            bytes.extend(b" ");
            fs::write(place.file(name), bytes).unwrap();
            assert_eq!(place.findings(), [(name.to_owned(), Problem::Changed)]);
            fs::remove_file(place.file(name)).unwrap();
            if name != "case.toml" {
                assert!(place.findings().contains(&(name.to_owned(), Problem::Missing)));
            }
        }
    }

    #[test]
    fn a_seal_cannot_be_forged_taken_away_or_made_elsewhere() {
        let seal = |problem| vec![(SEAL_FILE.to_owned(), problem)];
        let place = Place::with_case();
        let text = fs::read_to_string(place.file(SEAL_FILE)).unwrap();
        let seal_of: Seal = toml::from_str(&text).unwrap();
        for forged in
            [text.replace(&seal_of.case, &seal_of.stages), text.replace("key", "kez"), "\u{1}".into()]
        {
            fs::write(place.file(SEAL_FILE), forged).unwrap();
            assert_eq!(place.findings(), seal(Problem::NotGenuine));
        }
        fs::remove_file(place.file(SEAL_FILE)).unwrap();
        assert_eq!(place.findings(), seal(Problem::NotSealed));
        super::seal(&place.case(), &KeyFile::at(place.0.path().join("other.key"))).unwrap();
        assert_eq!(place.findings(), seal(Problem::OtherKey));
    }

    /// The case opened again, its next stage done.
    fn go_on(place: &Place) -> Result<(), CaseError> {
        let mut case = Case::open(&place.case()).unwrap();
        case.seal_with(place.key());
        let staging = case.staging()?;
        staging.write("print.json", b"{}")?;
        case.commit(Stage::Print, &case::MadeFrom::new(), staging, case::Told::default())
    }

    #[test]
    fn no_stage_goes_on_from_a_record_whose_seal_does_not_hold() {
        let place = Place::with_case();
        let stages = fs::read_to_string(place.file("stages.toml")).unwrap();
        let seal_of = fs::read_to_string(place.file(SEAL_FILE)).unwrap();
        let refused = |place: &Place, file: &str| {
            let error = go_on(place).unwrap_err().to_string();
            assert!(error.contains(file) && error.contains("lumenfab verify"), "{error}");
            assert!(!place.file("print.json").exists());
        };
        let hash = |text: &str| text.split('"').find(|t| t.len() == 64).unwrap().to_owned();
        fs::write(place.file("stages.toml"), stages.replace(&hash(&stages), &"0".repeat(64))).unwrap();
        refused(&place, "stages.toml");
        assert_eq!(place.findings()[0], ("stages.toml".into(), Problem::Changed), "and it is still told");
        fs::write(place.file("stages.toml"), &stages).unwrap();
        fs::remove_file(place.file(SEAL_FILE)).unwrap();
        refused(&place, SEAL_FILE);
        fs::write(place.file(SEAL_FILE), seal_of.replace(&hash(&seal_of), &"0".repeat(64))).unwrap();
        refused(&place, SEAL_FILE);
        fs::write(place.file(SEAL_FILE), &seal_of).unwrap();
        go_on(&place).unwrap();
        assert_eq!(place.findings(), []);
    }

    #[test]
    fn a_record_is_a_sealed_one_whenever_the_power_goes() {
        let place = Place::with_case();
        let stages = fs::read_to_string(place.file("stages.toml")).unwrap();
        // The new seal is there, the new record is not.
        announce(&place.case(), &place.key(), "[print]\n").unwrap();
        assert_eq!(place.findings(), []);
        // Both are.
        fs::write(place.file("stages.toml"), "[print]\n").unwrap();
        assert_eq!(place.findings(), []);
        fs::write(place.file("stages.toml"), "[slice]\n").unwrap();
        assert_eq!(place.findings(), [("stages.toml".into(), Problem::Changed)]);
        fs::write(place.file("stages.toml"), stages).unwrap();
        go_on(&place).unwrap();
        assert!(!fs::read_to_string(place.file(SEAL_FILE)).unwrap().contains("before"));
    }

    #[test]
    fn a_changed_journal_is_found() {
        let place = Place::with_case();
        fs::write(place.file("job.gcode.journal"), "acknowledged 100\n").unwrap();
        assert_eq!(place.findings(), [], "while it is no print's yet");
        go_on(&place).unwrap();
        assert_eq!(place.findings(), []);
        let changed = |problem| vec![("job.gcode.journal".to_owned(), problem)];
        fs::write(place.file("job.gcode.journal"), "acknowledged 200\n").unwrap();
        assert_eq!(place.findings(), changed(Problem::Changed));
        fs::remove_file(place.file("job.gcode.journal")).unwrap();
        assert_eq!(place.findings(), changed(Problem::Missing));
    }

    #[test]
    fn a_forged_journal_is_refused_and_that_of_a_broken_print_is_sealed() {
        let place = Place::with_case();
        fs::write(place.file("job.gcode.journal"), "acknowledged 100\n").unwrap();
        go_on(&place).unwrap();
        let context = Context {
            events: &|_: Event| {},
            cancel: CancelToken::default(),
            controls: Controls::default(),
            sources: Sources::in_dir(place.0.path().join("state/sources")),
        };
        let redo = |stage, write: &dyn Fn()| {
            let mut session = Session::open(&place.case(), CaseFile::default(), context.clone()).unwrap();
            let work = |_: &mut Session<'_>, _: &Task<'_>| {
                write();
                Err(Cancelled.into())
            };
            session.redo(stage, &case::MadeFrom::new(), Vec::new(), work).unwrap_err()
        };
        let changed = || vec![("job.gcode.journal".to_owned(), Problem::Changed)];
        let journal = |text: &str| fs::write(place.file("job.gcode.journal"), text).unwrap();
        redo(Stage::Print, &|| journal("acknowledged 50\n"));
        assert_eq!(place.findings(), [], "the program itself has changed it");
        journal("acknowledged 200\n");
        let refused = redo(Stage::Report, &|| panic!("no report is made from it")).to_string();
        assert!(refused.contains("job.gcode.journal") && refused.contains("lumenfab verify"), "{refused}");
        assert_eq!(place.findings(), changed());
        redo(Stage::Print, &|| {});
        assert_eq!(place.findings(), changed(), "a print that was refused vouches for nothing");
    }

    #[test]
    fn what_no_stage_has_made_is_named() {
        let place = Place::with_case();
        fs::write(place.file("notes.txt"), "mine").unwrap();
        assert_eq!(verify(&place.case(), Some(&place.key()), None).unwrap().unknown, ["notes.txt"]);
    }

    #[test]
    fn a_key_is_made_once_and_a_damaged_one_is_told() {
        use std::os::unix::fs::PermissionsExt;
        let place = Place::new();
        let key = place.key().key().unwrap();
        assert_eq!(place.key().key().unwrap().to_bytes(), key.to_bytes());
        let path = place.0.path().join("state/signing.key");
        assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
        fs::write(&path, "no key").unwrap();
        assert!(place.key().key().unwrap_err().to_string().contains("64 hexadecimal digits"));
    }
}
