//! The queue on a PostgreSQL server: several appliances and workers draw from one.
//!
//! A connection and a thread of its own, as for SQLite (`thread`); a connection that broke is made anew with the next call.
//! Everything is in a schema of its own, `lumenfab`, made at the first start.
//!
//! Whoever writes takes the row of `format` first and keeps it to the end of its transaction: the history is one chain, so writers
//! follow each other anyway, and with one lock none can wait for another in a circle; a claim finds what others have taken already,
//! and takes what is first. A commit is on the server's disk when it returns (`synchronous_commit`).
//!
//! Times are the server's: machines whose clocks differ believe each other's claims equally long.

mod made;
mod open;
#[cfg(test)]
mod tests;
mod tx;

use super::thread::{Again, Database, OnThread};
use super::{Error, sql};
pub use open::Db;
use open::{Clock, STEPS};

/// The queue on a PostgreSQL server.
pub type Postgres = OnThread<Db>;

impl Postgres {
    /// Connects to the server at an address, `postgresql://user@host/database` or `host=... dbname=...`; makes the tables, or brings
    /// them to the newest format. Blocks as long as that takes.
    ///
    /// # Errors
    /// [`Error`]: the address cannot be read, nobody answers there, the user may not, or the tables are another program's, a later
    /// version's, or damaged. No error quotes the address: it may hold a password.
    pub fn connect(address: &str) -> Result<Self, Error> {
        Self::by_the_clock_of(Clock::Server, address)
    }

    fn by_the_clock_of(clock: Clock, address: &str) -> Result<Self, Error> {
        let server = Db::at(address, clock, STEPS)?;
        let place = server.place().to_owned();
        Self::start(&place, move || server.connected(STEPS))
    }
}

impl Database for Db {
    fn read<T>(&mut self, look: impl FnOnce(&dyn sql::Sql) -> Result<T, sql::Error>) -> Result<T, Error> {
        Self::read(self, look)
    }

    fn write<T>(&mut self, work: impl FnOnce(&dyn sql::Sql) -> Result<T, sql::Error>) -> Result<T, Error> {
        Self::write(self, work)
    }

    fn again(&self) -> Again<Self> {
        let again = self.unconnected();
        Box::new(move || Ok(again))
    }

    /// The server sees to its own files; tables and indices are compared with the history anyway.
    fn check_sound(&mut self) -> Result<(), Error> {
        Ok(())
    }
}
