//! The queue in one SQLite file: nothing to set up, safe against whatever ends the program.
//!
//! A thread of its own has the connection (`thread`). Write-ahead log, flushed at every commit: what a call has answered survives a power cut. Other
//! processes may use the same file (`lumenfab work`, backups); whoever writes waits for the others, five seconds at most.
//!
//! Cost: one transaction a change. Taking, listing and changing jobs goes by indices, so that none depends on the length of
//! the queue or on how much is over; only jobs that need more filament than the spool has are passed over one by one, within the index.
//! Opening checks the end of the history and, in a file of up to 8 MiB, all pages; [`verify`](super::Store::verify) reads everything however
//! much it is, over a connection of its own that holds up nobody: pages and indices in one go, then records and rows some thousand
//! at a time, each time at another moment of the file, so that the log can be taken in between. A face asks for it from time to time.

mod open;
#[cfg(test)]
mod tests;
mod tx;

use super::thread::{Again, Database, OnThread};
use super::{Error, sql};
pub use open::Db;
use std::path::Path;
use tx::Tx;

/// The queue in a SQLite file.
pub type Sqlite = OnThread<Db>;

impl Sqlite {
    /// Opens the file, or makes it; brings it to the newest format. Blocks as long as that takes.
    ///
    /// # Errors
    /// [`Error`]: it cannot be opened or written, is another program's, a later version's, or damaged.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let file = path.to_owned();
        Self::start(path, move || Db::open(&file, open::STEPS))
    }

    /// Writes what the file holds at one moment to a new file, while others go on with it. Blocks as long as that takes.
    ///
    /// # Errors
    /// [`Error`]: it cannot be read, or the new file not be written, or is there already.
    pub fn snapshot(path: &Path, to: &Path) -> Result<(), Error> {
        Db::open_to_read(path)?.copy_to(to)
    }
}

impl Database for Db {
    fn read<T>(&mut self, look: impl FnOnce(&dyn sql::Sql) -> Result<T, sql::Error>) -> Result<T, Error> {
        Self::read(self, |tx| look(tx))
    }

    fn write<T>(&mut self, work: impl FnOnce(&dyn sql::Sql) -> Result<T, sql::Error>) -> Result<T, Error> {
        Self::write(self, |tx| work(tx))
    }

    fn again(&self) -> Again<Self> {
        let path = self.path.clone();
        Box::new(move || Self::open_to_read(&path))
    }

    fn check_sound(&mut self) -> Result<(), Error> {
        self.check_pages("integrity_check")
    }
}
