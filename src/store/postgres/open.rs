//! A connection: made when it is needed, the tables brought to the newest format, transactions.

use super::tx::Tx;
use crate::store::{Error, sql};
use postgres::error::SqlState;
use postgres::{Client, Config, IsolationLevel, NoTls, Statement, Transaction};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// What the tables are made from: each step brings them one version on, in a transaction of its own. Steps are never changed, only added.
pub(super) const STEPS: &[&str] = &[include_str!("v1.sql")];
/// The schema in which all of it is.
pub(super) const SCHEMA: &str = "lumenfab";
/// How long the server is waited for.
const PATIENCE: Duration = Duration::from_secs(5);
/// What each connection is made with: waits are bounded, an answer is on the disk.
const OPTIONS: &str = "-c search_path=lumenfab -c lock_timeout=5s -c statement_timeout=60s \
     -c idle_in_transaction_session_timeout=60s -c synchronous_commit=on -c client_min_messages=warning";

/// Whose time counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Clock {
    /// The server's.
    Server,
    /// The callers', who make theirs up.
    #[cfg(test)]
    Callers,
}

/// A server and the connection to it, if there is one.
pub struct Db {
    config: Config,
    clock: Clock,
    place: PathBuf,
    link: Option<Link>,
    /// The version that this program reads and writes.
    version: i64,
}

/// A connection, and the statements that it knows.
pub(super) struct Link {
    client: Client,
    statements: HashMap<&'static str, Statement>,
}

/// Without the address, which may hold a password.
impl std::fmt::Debug for Db {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Db")
            .field("place", &self.place)
            .field("version", &self.version)
            .finish_non_exhaustive()
    }
}

impl Db {
    /// A server, not connected yet.
    pub(super) fn at(address: &str, clock: Clock, steps: &[&str]) -> Result<Self, Error> {
        let mut config: Config = address.parse().map_err(|_quoted: postgres::Error| Error::Address)?;
        let options =
            config.get_options().map_or_else(|| OPTIONS.to_owned(), |own| format!("{own} {OPTIONS}"));
        config.options(&options).application_name("lumenfab").connect_timeout(PATIENCE);
        config.tcp_user_timeout(2 * PATIENCE).keepalives_idle(2 * PATIENCE);
        let place = place_of(&config);
        Ok(Self { config, clock, place, link: None, version: version(steps.len()) })
    }

    /// With its tables of the newest format. Not from within a task: it waits.
    pub(super) fn connected(mut self, steps: &[&str]) -> Result<Self, Error> {
        self.migrate(steps)?;
        self.read(|tx| Ok(sql::last(tx)?.check_end(sql::head(tx)?)?))?;
        Ok(self)
    }

    /// The same server, not connected yet.
    pub(super) fn unconnected(&self) -> Self {
        Self { config: self.config.clone(), place: self.place.clone(), link: None, ..*self }
    }

    /// The server and database, as errors name them.
    pub(super) fn place(&self) -> &Path {
        &self.place
    }

    pub(super) fn read<T>(
        &mut self,
        look: impl FnOnce(&dyn sql::Sql) -> Result<T, sql::Error>,
    ) -> Result<T, Error> {
        self.with(true, look)
    }

    pub(super) fn write<T>(
        &mut self,
        work: impl FnOnce(&dyn sql::Sql) -> Result<T, sql::Error>,
    ) -> Result<T, Error> {
        self.with(false, work)
    }

    fn with<T>(
        &mut self,
        is_reading: bool,
        work: impl FnOnce(&dyn sql::Sql) -> Result<T, sql::Error>,
    ) -> Result<T, Error> {
        let (place, clock, known) = (self.place.clone(), self.clock, self.version);
        let config = self.config.clone();
        let link = self.link()?;
        let mut begun = begin(&mut link.client, is_reading).map_err(|e| told(&place, &e))?;
        let format =
            if is_reading { "SELECT version FROM format" } else { "SELECT version FROM format FOR UPDATE" };
        let row = begun.query_one(format, &[]).map_err(|e| told(&place, &e))?;
        let found: i64 = row.try_get(0).map_err(|e| told(&place, &e))?;
        if found > known {
            return Err(Error::Newer { path: place, found, known });
        }
        let tx = Tx::of(begun, &mut link.statements, &place, clock, &config);
        let done = work(&tx).map_err(|e| e.at(&place))?;
        tx.commit()?;
        Ok(done)
    }

    /// A connection that was good a moment ago, made anew where there is none.
    fn link(&mut self) -> Result<&mut Link, Error> {
        let is_good = |link: &mut Link| !link.client.is_closed() && link.client.simple_query("").is_ok();
        if !self.link.as_mut().is_some_and(is_good) {
            self.link = None;
            let client = self.config.connect(NoTls).map_err(|e| told(&self.place, &e))?;
            self.link = Some(Link { client, statements: HashMap::new() });
        }
        self.link.as_mut().ok_or(Error::Gone)
    }

    /// Brings the tables to the newest version, step by step; others who do the same are waited for.
    fn migrate(&mut self, steps: &[&str]) -> Result<(), Error> {
        let (place, known) = (self.place.clone(), self.version);
        let client = &mut self.link()?.client;
        let found = migrated(client, steps).map_err(|e| told(&place, &e))?;
        match found {
            None => Err(Error::Foreign { path: place }),
            Some(found) if found > known => Err(Error::Newer { path: place, found, known }),
            Some(_) => Ok(()),
        }
    }
}

/// The version that the tables are of in the end; `None` where the schema is another program's.
fn migrated(client: &mut Client, steps: &[&str]) -> Result<Option<i64>, postgres::Error> {
    let mut tx = client.transaction()?;
    // "LFab": whoever makes the same tables at the same moment is waited for.
    tx.batch_execute("SELECT pg_advisory_xact_lock(1279680866)")?;
    let sql = "SELECT to_regnamespace($1) IS NOT NULL, to_regclass($1 || '.format') IS NOT NULL";
    let row = tx.query_one(sql, &[&SCHEMA])?;
    let (is_there, is_ours): (bool, bool) = (row.try_get(0)?, row.try_get(1)?);
    if is_there && !is_ours {
        return Ok(None);
    }
    if !is_there {
        tx.batch_execute(&format!("CREATE SCHEMA {SCHEMA}"))?;
    }
    let mut found: i64 =
        if is_ours { tx.query_one("SELECT version FROM format", &[])?.try_get(0)? } else { 0 };
    for (idx, step) in steps.iter().enumerate() {
        if found == version(idx) {
            tx.batch_execute(step)?;
            found += 1;
            let put =
                "INSERT INTO format (id, version) VALUES (1, $1) ON CONFLICT (id) DO UPDATE SET version = $1";
            tx.execute(put, &[&found])?;
        }
    }
    tx.commit()?;
    Ok(Some(found))
}

/// Readers see one moment; a writer sees what was done before it got its turn.
fn begin(client: &mut Client, is_reading: bool) -> Result<Transaction<'_>, postgres::Error> {
    let level = if is_reading { IsolationLevel::RepeatableRead } else { IsolationLevel::ReadCommitted };
    client.build_transaction().isolation_level(level).read_only(is_reading).start()
}

/// The version behind so many steps.
fn version(n_steps: usize) -> i64 {
    i64::try_from(n_steps).unwrap_or(i64::MAX)
}

/// Server and database, without user and password.
fn place_of(config: &Config) -> PathBuf {
    use postgres::config::Host;
    let host = match config.get_hosts().first() {
        Some(Host::Tcp(name)) => name.clone(),
        Some(Host::Unix(path)) => path.display().to_string(),
        None => config.get_hostaddrs().first().map(ToString::to_string).unwrap_or_default(),
    };
    let database = config.get_dbname().or_else(|| config.get_user()).unwrap_or_default();
    PathBuf::from(format!("postgresql://{host}/{database}"))
}

/// What the server says, in words that tell what to do.
pub(super) fn told(place: &Path, error: &postgres::Error) -> Error {
    let path = place.to_owned();
    match error.code() {
        Some(&SqlState::DISK_FULL) => Error::Full { path },
        Some(&SqlState::READ_ONLY_SQL_TRANSACTION) => Error::ReadOnly { path },
        Some(&SqlState::LOCK_NOT_AVAILABLE) => {
            let problem =
                format!("another session has kept the queue to itself for {} s", PATIENCE.as_secs());
            Error::Server { path, problem }
        }
        Some(_) => Error::Server {
            path,
            problem: error.as_db_error().map_or_else(String::new, |e| e.message().to_owned()),
        },
        None => Error::Server { path, problem: with_causes(error) },
    }
}

/// An error and what it comes from.
fn with_causes(error: &postgres::Error) -> String {
    let mut text = error.to_string();
    let mut cause = std::error::Error::source(error);
    while let Some(error) = cause {
        let said = error.to_string();
        if !text.contains(&said) {
            text = format!("{text}: {said}");
        }
        cause = error.source();
    }
    text
}
