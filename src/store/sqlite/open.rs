//! A database file: opened with care, brought to the newest format, trusted only after a look.

use super::Tx;
use crate::store::Error;
use crate::store::sql;
use rusqlite::{Connection, ErrorCode, OpenFlags, Transaction, TransactionBehavior};
use rustix::fs::{Access, access};
use std::cell::Cell;
use std::fs::OpenOptions;
use std::io;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::time::Instant;

/// What a database is made from: each step brings it one version on, in a transaction of its own. Steps are never changed, only added.
pub(super) const STEPS: &[&str] = &[include_str!("v1.sql")];
/// "LFab": that it is ours.
pub(super) const APPLICATION_ID: i64 = 0x4c46_6162;
/// How long another program is waited for.
pub(super) const PATIENCE: Duration = Duration::from_secs(5);
/// The same once it was waited for in vain, until it lets somebody write: else all who ask would wait one behind the other.
const LESS_PATIENCE: Duration = Duration::from_millis(50);
/// How often the mode is asked for while others open the new file, too.
const MOST_ATTEMPTS: u32 = 20;
/// A larger file is not read whole when it is opened, which would take longer than anybody waits for a start.
const MOST_CHECKED_BYTES: u64 = 1 << 23;

/// An open database.
#[derive(Debug)]
pub struct Db {
    pub(super) connection: Connection,
    pub(super) path: PathBuf,
    /// The version that this program reads and writes.
    version: i64,
    /// Which file it is, whatever its name becomes.
    file: Option<(u64, u64)>,
    /// Since when another program keeps it locked.
    locked_since: Cell<Option<Instant>>,
}

/// Statements that are kept ready: all there are.
const MOST_PREPARED: usize = 64;

impl Db {
    /// Opens the file, or makes it; readable by its owner alone.
    pub(super) fn open(path: &Path, steps: &[&str]) -> Result<Self, Error> {
        make(path)?;
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(path, flags).map_err(|e| told(path, &e))?;
        let mut db = Self::of(connection, path, steps);
        db.connection.busy_timeout(PATIENCE).map_err(|e| told(path, &e))?;
        db.check_whose(steps)?;
        db.set_modes()?;
        db.migrate(steps)?;
        db.check()?;
        Ok(db)
    }

    /// A second look at the same file that only reads, so that long reading holds nobody up.
    pub(super) fn open_to_read(path: &Path) -> Result<Self, Error> {
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(path, flags).map_err(|e| told(path, &e))?;
        let careful = "PRAGMA trusted_schema = OFF; PRAGMA cell_size_check = ON; PRAGMA temp_store = MEMORY;";
        connection
            .busy_timeout(PATIENCE)
            .and_then(|()| connection.execute_batch(careful))
            .map_err(|e| told(path, &e))?;
        Ok(Self::of(connection, path, STEPS))
    }

    /// A copy of one moment, without the pages that are not used any more.
    pub(super) fn copy_to(&self, to: &Path) -> Result<(), Error> {
        self.connection
            .execute("VACUUM INTO ?1", [to.to_string_lossy()])
            .map(|_n_rows| ())
            .map_err(|e| told(to, &e))
    }

    fn of(connection: Connection, path: &Path, steps: &[&str]) -> Self {
        connection.set_prepared_statement_cache_capacity(MOST_PREPARED);
        Self {
            connection,
            path: path.to_owned(),
            version: version(steps.len()),
            file: identity(path),
            locked_since: Cell::new(None),
        }
    }

    /// Refuses another program's database, and a later version's, before anything is written.
    fn check_whose(&mut self, steps: &[&str]) -> Result<(), Error> {
        let (id, found, n_tables) = self.marks().map_err(|e| told(&self.path, &e))?;
        let is_new = id == 0 && found == 0 && n_tables == 0;
        if !is_new && id != APPLICATION_ID {
            return Err(Error::Foreign { path: self.path.clone() });
        }
        let known = version(steps.len());
        if found > known {
            return Err(Error::Newer { path: self.path.clone(), found, known });
        }
        Ok(())
    }

    /// That it is still the file that was opened: another process may have brought it to a later version, or put another one in its
    /// place, and what is written then would be wrong, or lost.
    fn check_still(&self, tx: &Connection) -> Result<(), Error> {
        let path = self.path.clone();
        if self.file.is_none() || identity(&path) != self.file {
            let problem =
                "the file was taken away or replaced while it was open; start lumenfab again".into();
            return Err(Error::Io { path, problem });
        }
        let found = tx.pragma_query_value(None, "user_version", |row| row.get(0));
        let (found, known): (i64, i64) = (found.map_err(|e| told(&path, &e))?, self.version);
        if found > known { Err(Error::Newer { path, found, known }) } else { Ok(()) }
    }

    /// Whose it is, its version, and how much is in it, all at one moment: others may just be making it.
    fn marks(&mut self) -> rusqlite::Result<(i64, i64, i64)> {
        let tx = self.connection.transaction()?;
        let pragma = |name| tx.pragma_query_value(None, name, |row| row.get(0));
        let n_tables = tx.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))?;
        Ok((pragma("application_id")?, pragma("user_version")?, n_tables))
    }

    fn set_modes(&self) -> Result<(), Error> {
        let found = self.set_wal().map_err(|e| told(&self.path, &e))?;
        if !found.eq_ignore_ascii_case("wal") {
            return Err(Error::NoWal { path: self.path.clone(), found });
        }
        self.connection
            .execute_batch(
                "PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON; PRAGMA trusted_schema = OFF;
                 PRAGMA cell_size_check = ON; PRAGMA temp_store = MEMORY;",
            )
            .map_err(|e| told(&self.path, &e))
    }

    /// The mode that the database is in then. Whoever makes the same file at the same moment is waited for.
    fn set_wal(&self) -> rusqlite::Result<String> {
        let ask = || self.connection.pragma_update_and_check(None, "journal_mode", "wal", |row| row.get(0));
        for _ in 1..MOST_ATTEMPTS {
            match ask() {
                Err(e) if e.sqlite_error_code() == Some(ErrorCode::DatabaseBusy) => {
                    self.connection.execute_batch("BEGIN IMMEDIATE; COMMIT")?;
                }
                other => return other,
            }
        }
        ask()
    }

    /// Brings it to the newest version, step by step. Where that is done nothing is locked: what another program keeps to itself, and
    /// what is on a full disk, can be opened and read all the same.
    fn migrate(&mut self, steps: &[&str]) -> Result<(), Error> {
        let (_, found, _) = self.marks().map_err(|e| told(&self.path, &e))?;
        for (idx, step) in steps.iter().enumerate().filter(|(idx, _)| version(*idx) >= found) {
            self.step(version(idx), step).map_err(|e| told(&self.path, &e))?;
        }
        Ok(())
    }

    /// Does a step, unless it is done.
    fn step(&mut self, before: i64, statements: &str) -> rusqlite::Result<()> {
        let tx = self.connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
        let found: i64 = tx.pragma_query_value(None, "user_version", |row| row.get(0))?;
        if found == before {
            tx.execute_batch(statements)?;
            tx.pragma_update(None, "user_version", before + 1)?;
            tx.pragma_update(None, "application_id", APPLICATION_ID)?;
        }
        tx.commit()
    }

    /// Whether the history ends where it was left and, in a file that is read in no time, whether pages are sound.
    fn check(&mut self) -> Result<(), Error> {
        if std::fs::metadata(&self.path).is_ok_and(|file| file.len() <= MOST_CHECKED_BYTES) {
            self.check_pages("quick_check")?;
        }
        self.read(|tx| Ok(sql::last(tx)?.check_end(sql::head(tx)?)?))
    }

    /// Whether pages are sound (`quick_check`), and also what indices say (`integrity_check`): reads the whole file.
    pub(super) fn check_pages(&self, how: &str) -> Result<(), Error> {
        let found: String = self
            .connection
            .pragma_query_value(None, how, |row| row.get(0))
            .map_err(|e| told(&self.path, &e))?;
        if found == "ok" { Ok(()) } else { Err(Error::Damaged { path: self.path.clone(), problem: found }) }
    }

    /// Looks at one moment of the database.
    pub(super) fn read<T>(
        &mut self,
        look: impl FnOnce(&Tx<'_>) -> Result<T, sql::Error>,
    ) -> Result<T, Error> {
        let tx = self.connection.unchecked_transaction().map_err(|e| told(&self.path, &e))?;
        self.check_still(&tx)?;
        look(&Tx::of(&tx, &self.path)).map_err(|e| e.at(&self.path))
    }

    /// Does something as a whole or not at all; it is on the disk when this returns.
    pub(super) fn write<T>(
        &mut self,
        work: impl FnOnce(&Tx<'_>) -> Result<T, sql::Error>,
    ) -> Result<T, Error> {
        let begun = Transaction::new_unchecked(&self.connection, TransactionBehavior::Immediate);
        let tx = self.let_in(begun)?;
        self.check_still(&tx)?;
        let done = work(&Tx::of(&tx, &self.path)).map_err(|e| e.at(&self.path))?;
        tx.commit().map_err(|e| told(&self.path, &e))?;
        Ok(done)
    }

    /// Takes note of whether another program lets this one write: the first who asks waits for it, the next ones hear so at once.
    fn let_in<T>(&self, begun: rusqlite::Result<T>) -> Result<T, Error> {
        let error = match begun {
            Ok(begun) => {
                if self.locked_since.take().is_some() {
                    self.be_patient(PATIENCE)?;
                }
                return Ok(begun);
            }
            Err(error) => told(&self.path, &error),
        };
        let Error::Locked { path, .. } = error else { return Err(error) };
        let now = Instant::now();
        let since = self.locked_since.get().unwrap_or_else(|| now.checked_sub(PATIENCE).unwrap_or(now));
        if self.locked_since.replace(Some(since)).is_none() {
            self.be_patient(LESS_PATIENCE)?;
        }
        Err(Error::Locked { path, waited_s: now.duration_since(since).as_secs() })
    }

    fn be_patient(&self, patience: Duration) -> Result<(), Error> {
        self.connection.busy_timeout(patience).map_err(|e| told(&self.path, &e))
    }
}

/// Which file a name leads to.
fn identity(path: &Path) -> Option<(u64, u64)> {
    std::fs::metadata(path).ok().map(|file| (file.dev(), file.ino()))
}

/// The version behind so many steps.
fn version(n_steps: usize) -> i64 {
    i64::try_from(n_steps).unwrap_or(i64::MAX)
}

/// Makes an empty file where there is none. One that is there is never opened here: closing it again would take away the locks that
/// another connection of this process has on it.
fn make(path: &Path) -> Result<(), Error> {
    match OpenOptions::new().write(true).create_new(true).mode(0o600).open(path) {
        Ok(_) => Ok(()),
        Err(e) if e.kind() == io::ErrorKind::AlreadyExists => Ok(()),
        Err(e) if e.kind() == io::ErrorKind::ReadOnlyFilesystem && path.exists() => Ok(()),
        Err(e) if matches!(e.kind(), io::ErrorKind::ReadOnlyFilesystem | io::ErrorKind::PermissionDenied) => {
            Err(Error::ReadOnly { path: path.to_owned() })
        }
        Err(e) if e.kind() == io::ErrorKind::StorageFull => Err(Error::Full { path: path.to_owned() }),
        Err(e) => Err(Error::Io { path: path.to_owned(), problem: e.to_string() }),
    }
}

/// What SQLite says, in words that tell what to do.
pub(super) fn told(path: &Path, error: &rusqlite::Error) -> Error {
    let path = path.to_owned();
    match error.sqlite_error_code() {
        Some(ErrorCode::DiskFull) => Error::Full { path },
        Some(ErrorCode::ReadOnly | ErrorCode::PermissionDenied) => Error::ReadOnly { path },
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => {
            Error::Locked { path, waited_s: PATIENCE.as_secs() }
        }
        Some(ErrorCode::CannotOpen) if path.exists() && cannot_be_written(&path) => Error::ReadOnly { path },
        Some(ErrorCode::NotADatabase) => Error::NotADatabase { path },
        Some(ErrorCode::DatabaseCorrupt) => Error::Damaged { path, problem: error.to_string() },
        _ => Error::Io { path, problem: error.to_string() },
    }
}

/// Whether the system lets the file, or others beside it, not be written.
fn cannot_be_written(path: &Path) -> bool {
    let beside = path.parent().filter(|dir| !dir.as_os_str().is_empty()).unwrap_or(Path::new("."));
    [path, beside].iter().any(|place| access(*place, Access::WRITE_OK).is_err())
}
