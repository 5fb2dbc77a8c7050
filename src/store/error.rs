//! What can go wrong with a store, with a stable code and a next step for each.

use crate::queue::{Break, Refusal};
use std::path::PathBuf;

/// Why a store did not do what it was asked for. Nothing is changed then.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The queue refuses it.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// History and what is kept do not fit.
    #[error(
        "{0}; what is printing may end, but keep a copy of the database and find out who changed it before anything else"
    )]
    History(#[from] Break),
    /// The disk is full.
    #[error("{}: the disk is full: make room; nothing of the queue is lost", path.display())]
    Full {
        /// The database.
        path: PathBuf,
    },
    /// It cannot be written.
    #[error("{}: can only be read, but has to be written: check its rights, its folder's, and how the disk is mounted", path.display())]
    ReadOnly {
        /// The database.
        path: PathBuf,
    },
    /// Another program keeps it to itself.
    #[error("{}: another program has kept it locked for {waited_s} s: end that program (`fuser -v` names it)", path.display())]
    Locked {
        /// The database.
        path: PathBuf,
        /// How long it was waited for, s.
        waited_s: u64,
    },
    /// It is a file of another kind.
    #[error("{}: found a file that is no SQLite database, expected a queue of lumenfab: name another state directory", path.display())]
    NotADatabase {
        /// The file.
        path: PathBuf,
    },
    /// Another program's database.
    #[error("{}: found a database of another program, expected a queue of lumenfab: name another state directory", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
    },
    /// A later version has written it.
    #[error("{}: found version {found} of the queue's format, this program knows versions up to {known}: install a newer lumenfab, or restore a backup of its time", path.display())]
    Newer {
        /// The database.
        path: PathBuf,
        /// Its version.
        found: i64,
        /// The newest known.
        known: i64,
    },
    /// It cannot be trusted.
    #[error("{}: the database is damaged ({problem}): stop, keep a copy, and restore the last backup", path.display())]
    Damaged {
        /// The database.
        path: PathBuf,
        /// What was found.
        problem: String,
    },
    /// The file system cannot do what a safe queue needs.
    #[error("{}: found journal mode {found}, expected wal: the queue has to be on a local disk, not on a network share", path.display())]
    NoWal {
        /// The database.
        path: PathBuf,
        /// The journal mode.
        found: String,
    },
    /// It cannot be opened, read or written for another reason.
    #[error("{}: {problem}; check that its folder is there and the disk is in order", path.display())]
    Io {
        /// The database.
        path: PathBuf,
        /// What the system says.
        problem: String,
    },
    /// The address of a database server cannot be read.
    #[error(
        "the address of the queue's database cannot be read: expected postgresql://USER@HOST/DATABASE or host=HOST dbname=DATABASE user=USER"
    )]
    Address,
    /// A database server does not do it.
    #[error("{}: {problem}; check that the server runs, and that address and user are right", path.display())]
    Server {
        /// Server and database.
        path: PathBuf,
        /// What it says.
        problem: String,
    },
    /// A fault of this program in the middle of something, which is as if it had not been begun.
    #[error(
        "the queue has a fault that is lumenfab's own: nothing was changed; look into the log, and report it"
    )]
    Panicked,
    /// The store has been closed.
    #[error("the store of the queue has ended; start lumenfab again")]
    Gone,
}

impl Error {
    /// A stable name for programs.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Refused(refusal) => refusal.code(),
            Self::History(_) => "store.history",
            Self::Full { .. } => "store.full",
            Self::ReadOnly { .. } => "store.read_only",
            Self::Locked { .. } => "store.locked",
            Self::NotADatabase { .. } => "store.not_a_database",
            Self::Foreign { .. } => "store.foreign",
            Self::Newer { .. } => "store.newer",
            Self::Damaged { .. } => "store.damaged",
            Self::NoWal { .. } => "store.no_wal",
            Self::Io { .. } => "store.io",
            Self::Address => "store.address",
            Self::Server { .. } => "store.server",
            Self::Panicked => "store.panicked",
            Self::Gone => "store.gone",
        }
    }
}
