//! Keys for callers over TCP: a file of hashes, each with a name and what it allows.
//!
//! A key is told once, when it is made; the file keeps its Argon2id hash (RFC 9106) and a mark of 32 bits by which its line is found, so
//! that one hash is reckoned, not one for each line, and none for a key whose mark no line has. Keys that were good once are remembered
//! under a fast keyed hash of this process, at most `MOST_REMEMBERED`, so that a request costs microseconds.
//!
//! Wrong keys are counted by address (`limit`), so that nobody can guess; behind a server that does TLS all callers have one
//! address, so that this keeps no key out whose mark is in the file. Requests are counted by key. Weak keys are refused before anything is
//! reckoned (`strength`). The file has to be its owner's alone.

mod limit;
mod memory;
mod strength;

use super::error::Problem;
use super::wire::{Access, KeyView, NewKey};
use crate::queue::Name;
use argon2::password_hash::phc::PasswordHash;
use argon2::password_hash::{PasswordHasher, PasswordVerifier};
use argon2::{Algorithm, Argon2, Params, Version};
use axum::http::StatusCode;
use limit::{Limit, Rate, network};
use memory::Memory;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::net::IpAddr;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use strength::Weak;
use tokio::sync::Semaphore;
use tokio::time::Instant;

/// Keys that are remembered as good.
const MOST_REMEMBERED: usize = 64;
/// Memory of one hash, KiB: keys are random, so this has to slow nobody down, and the appliance is small.
const HASH_KIB: u32 = 8 * 1024;
/// Wrong keys of an address.
const WRONG_KEYS: Rate = Rate { most: 10, refill: Duration::from_secs(6) };
/// Requests with one key: far more than a screen that looks again at every event, and few enough that a flood leaves a core to the printer.
const REQUESTS: Rate = Rate { most: 200, refill: Duration::from_millis(20) };
/// For the marks of keys alone.
const MARK_PURPOSE: &str = "lumenfab key mark 1";

/// Why the keys cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum KeysError {
    /// Others can read or write the file.
    #[error("{}: found rights {mode:o}, expected 600: `chmod 600` it, and make new keys if others may have read it", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// Its rights.
        mode: u32,
    },
    /// It is not what this program writes.
    #[error("{}: {problem}: mend the file, or delete it and make new keys", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Why.
        problem: String,
    },
    /// The system refuses.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// There is one already.
    #[error("there is a key named {name} already: remove it first, or take another name")]
    Taken {
        /// The name.
        name: Name,
    },
    /// There is none.
    #[error("there is no key named {name}")]
    NoKey {
        /// The name.
        name: Name,
    },
    /// It could be guessed.
    #[error(transparent)]
    Weak(#[from] Weak),
}

/// A line of the file.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    name: Name,
    access: Access,
    /// By which the line is found.
    mark: String,
    /// Argon2id, in the PHC's format.
    hash: String,
}

#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct File {
    key: Vec<Line>,
}

/// All keys. Clones are the same.
#[derive(Debug, Clone)]
pub struct Keys(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    path: PathBuf,
    file: Mutex<File>,
    memory: Mutex<Memory>,
    wrong: Mutex<Limit<IpAddr>>,
    requests: Mutex<Limit<Name>>,
    /// One hash at a time: memory stays small, and a flood of wrong keys leaves a core to the printer.
    hashing: Semaphore,
    started: Instant,
}

impl Keys {
    /// Reads the file; none: there are no keys.
    ///
    /// # Errors
    /// [`KeysError`].
    pub fn open(path: &Path) -> Result<Self, KeysError> {
        let mut seed = [0; 32];
        let no_chance = |e: getrandom::Error| std::io::Error::other(e.to_string());
        getrandom::fill(&mut seed).map_err(no_chance).map_err(|source| io(path, source))?;
        Ok(Self(Arc::new(Inner {
            path: path.to_owned(),
            file: Mutex::new(read(path)?),
            memory: Mutex::new(Memory::new(seed, MOST_REMEMBERED)),
            wrong: Mutex::new(Limit::new(WRONG_KEYS)),
            requests: Mutex::new(Limit::new(REQUESTS)),
            hashing: Semaphore::new(1),
            started: Instant::now(),
        })))
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        lock(&self.0.file).key.is_empty()
    }

    /// All of them, by name.
    #[must_use]
    pub fn list(&self) -> Vec<KeyView> {
        let mut keys: Vec<_> = lock(&self.0.file)
            .key
            .iter()
            .map(|line| KeyView { name: line.name.clone(), access: line.access })
            .collect();
        keys.sort_by(|a, b| a.name.cmp(&b.name));
        keys
    }

    /// Makes a key of 192 bits of chance; this is the only time it is told. Takes as long as a hash: not for an async task.
    ///
    /// # Errors
    /// [`KeysError`].
    pub fn add(&self, name: Name, access: Access) -> Result<NewKey, KeysError> {
        let mut chance = [0; 24];
        let no_chance = |e: getrandom::Error| std::io::Error::other(e.to_string());
        getrandom::fill(&mut chance).map_err(no_chance).map_err(|source| io(&self.0.path, source))?;
        let key = chance.iter().map(|byte| format!("{byte:02X}")).collect::<String>();
        self.add_given(name.clone(), access, &key)?;
        Ok(NewKey { name, key })
    }

    /// Takes a key that was made elsewhere.
    ///
    /// # Errors
    /// [`KeysError`]; [`KeysError::Weak`] where it could be guessed.
    pub fn add_given(&self, name: Name, access: Access, key: &str) -> Result<(), KeysError> {
        strength::check(key)?;
        let hash = hasher().hash_password(key.as_bytes()).map_err(|e| unreadable(&self.0.path, &e))?;
        let line = Line { name, access, mark: mark(key), hash: hash.to_string() };
        let mut file = lock(&self.0.file);
        if file.key.iter().any(|known| known.name == line.name) {
            return Err(KeysError::Taken { name: line.name });
        }
        let mut after = file.clone();
        after.key.push(line);
        write(&self.0.path, &after)?;
        *file = after;
        Ok(())
    }

    /// Makes a key void at once.
    ///
    /// # Errors
    /// [`KeysError`].
    pub fn remove(&self, name: &Name) -> Result<(), KeysError> {
        let mut file = lock(&self.0.file);
        let mut after = file.clone();
        after.key.retain(|line| line.name != *name);
        if after.key.len() == file.key.len() {
            return Err(KeysError::NoKey { name: name.clone() });
        }
        write(&self.0.path, &after)?;
        *file = after;
        // Still under the lock of the file, so that no check in between remembers what is void.
        lock(&self.0.memory).forget();
        Ok(())
    }

    /// Whose key it is and what it allows.
    ///
    /// # Errors
    /// 401 where it is weak or wrong; 429 where too many of this address were, or too much was asked with this key.
    pub(super) async fn check(&self, key: &str, address: IpAddr) -> Result<(Name, Access), Problem> {
        let known = lock(&self.0.memory).find(key);
        let whose = match known {
            Some(known) => Some(known),
            None => match self.line(key) {
                Some(line) => self.compare(key, line).await?,
                None => None,
            },
        };
        let (name, access) = whose.ok_or_else(|| self.refuse(key, address))?;
        self.count_request(&name)?;
        Ok((name, access))
    }

    /// One request more with this key.
    fn count_request(&self, name: &Name) -> Result<(), Problem> {
        let now = self.0.started.elapsed();
        let mut requests = lock(&self.0.requests);
        requests.check(name, now).map_err(|wait| {
            let message = "too many requests with this key: ask less often; events tell what has changed";
            too_many("http.too_many_requests", message, wait)
        })?;
        requests.count(name.clone(), now);
        Ok(())
    }

    /// What whoever has a wrong key is told.
    fn refuse(&self, key: &str, address: IpAddr) -> Problem {
        let (now, network) = (self.0.started.elapsed(), network(address));
        let mut wrong = lock(&self.0.wrong);
        if let Err(wait) = wrong.check(&network, now) {
            let message = "too many wrong keys from this address: wait, then use a good one";
            return too_many("http.too_many_wrong_keys", message, wait);
        }
        wrong.count(network, now);
        let (code, message) = match strength::check(key) {
            Ok(()) => ("http.wrong_key", "this key is not known, or was removed: make a new one".to_owned()),
            Err(weak) => ("http.weak_key", weak.to_string()),
        };
        Problem::new(StatusCode::UNAUTHORIZED, code, message)
    }

    /// Whether a key is that of the line that has its mark; `None`: it is not, or the line has gone meanwhile.
    async fn compare(&self, key: &str, line: Line) -> Result<Option<(Name, Access)>, Problem> {
        let _one_at_a_time =
            self.0.hashing.acquire().await.map_err(|closed| Problem::inside("checking a key", &closed))?;
        let (given, hash) = (key.to_owned(), line.hash.clone());
        let is_good = tokio::task::spawn_blocking(move || is_of(&given, &hash)).await;
        if !is_good.map_err(|panicked| Problem::inside("checking a key", &panicked))? {
            return Ok(None);
        }
        let file = lock(&self.0.file);
        if !file.key.iter().any(|known| known.hash == line.hash) {
            return Ok(None);
        }
        lock(&self.0.memory).remember(key, (line.name.clone(), line.access));
        Ok(Some((line.name, line.access)))
    }

    fn line(&self, key: &str) -> Option<Line> {
        let mark = mark(key);
        lock(&self.0.file).key.iter().find(|line| line.mark == mark).cloned()
    }
}

fn too_many(code: &'static str, message: &str, wait: Duration) -> Problem {
    let problem = Problem::new(StatusCode::TOO_MANY_REQUESTS, code, message);
    Problem { retry_after_s: Some(wait.as_secs() + 1), ..problem }
}

/// What is behind the lock is whole at any time.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn hasher() -> Argon2<'static> {
    let params = Params::new(HASH_KIB, 2, 1, None).expect("the parameters are within Argon2's limits");
    Argon2::new(Algorithm::Argon2id, Version::V0x13, params)
}

/// Compares in constant time.
fn is_of(key: &str, hash: &str) -> bool {
    PasswordHash::new(hash).is_ok_and(|hash| hasher().verify_password(key.as_bytes(), &hash).is_ok())
}

fn mark(key: &str) -> String {
    let sum = blake3::derive_key(MARK_PURPOSE, key.as_bytes());
    sum[..4].iter().map(|byte| format!("{byte:02x}")).collect()
}

fn io(path: &Path, source: std::io::Error) -> KeysError {
    KeysError::Io { path: path.to_owned(), source }
}

fn unreadable(path: &Path, problem: &dyn std::fmt::Display) -> KeysError {
    KeysError::Unreadable { path: path.to_owned(), problem: problem.to_string() }
}

fn read(path: &Path) -> Result<File, KeysError> {
    let mode = match std::fs::metadata(path) {
        Ok(found) => found.permissions().mode() & 0o777,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(File::default()),
        Err(e) => return Err(io(path, e)),
    };
    if mode & 0o077 != 0 {
        return Err(KeysError::Open { path: path.to_owned(), mode });
    }
    let text = std::fs::read_to_string(path).map_err(|e| io(path, e))?;
    toml::from_str(&text).map_err(|e| unreadable(path, &e.message()))
}

/// All or nothing; readable for the owner alone from the first byte.
fn write(path: &Path, file: &File) -> Result<(), KeysError> {
    let text = toml::to_string(file).map_err(|e| unreadable(path, &e))?;
    let dir = path.parent().unwrap_or(Path::new("."));
    let put = || {
        let mut temporary = tempfile::NamedTempFile::new_in(dir)?;
        temporary.write_all(text.as_bytes())?;
        temporary.as_file().sync_all()?;
        temporary.persist(path).map_err(|e| e.error)?;
        std::fs::File::open(dir)?.sync_all()
    };
    put().map_err(|e| io(path, e))
}
