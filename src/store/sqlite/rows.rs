//! Rows to what they mean, and back.

use super::open::told;
use crate::queue::act::{Outcome, Scene};
use crate::queue::history::Head;
use crate::queue::{
    Break, Claim, Digest, Fact, Job, JobId, Name, Needs, Printer, Rank, Refusal, Sealed, Spec, SpecKind,
    State, What,
};
use crate::store;
use jiff::Timestamp;
use rusqlite::{Connection, OptionalExtension, Row, params};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;

/// Why something was not done within a transaction.
#[derive(Debug)]
pub(super) enum Error {
    /// SQLite says so.
    Sqlite(rusqlite::Error),
    /// The queue says so.
    Refused(Refusal),
    /// The history says so.
    Break(Break),
    /// A row is not what this program writes.
    Row(String),
}

impl From<rusqlite::Error> for Error {
    fn from(error: rusqlite::Error) -> Self {
        Self::Sqlite(error)
    }
}

impl From<Refusal> for Error {
    fn from(refusal: Refusal) -> Self {
        Self::Refused(refusal)
    }
}

impl From<Break> for Error {
    fn from(found: Break) -> Self {
        Self::Break(found)
    }
}

impl Error {
    /// With the file it happened to.
    pub(super) fn at(self, path: &Path) -> store::Error {
        match self {
            Self::Sqlite(error) => told(path, &error),
            Self::Refused(refusal) => refusal.into(),
            Self::Break(found) => found.into(),
            Self::Row(problem) => store::Error::Damaged { path: path.to_owned(), problem },
        }
    }
}

pub(super) fn json(value: &impl Serialize) -> String {
    serde_json::to_string(value).expect("rows are numbers, names and lists of them")
}

pub(super) fn parsed<T: DeserializeOwned>(what: &str, body: &str) -> Result<T, Error> {
    serde_json::from_str(body).map_err(|e| Error::Row(format!("{what} cannot be read: {e}")))
}

fn digest(text: String) -> Result<Digest, Error> {
    Digest::try_from(text).map_err(|e| Error::Row(e.to_string()))
}

/// SQLite's whole numbers have a sign; amounts that large mean "more than there is".
pub(super) fn signed(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

fn unsigned(number: i64) -> Result<u64, Error> {
    u64::try_from(number)
        .map_err(|_negative| Error::Row(format!("found the number {number}, expected none below 0")))
}

/// What a queued job waits for.
fn waits(job: &Job) -> Option<&'static str> {
    (job.state == State::Queued).then_some(if job.made.is_some() { "print" } else { "prepare" })
}

/// The columns by which a job is found.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Columns {
    pub(super) urgency: i64,
    pub(super) rank: String,
    pub(super) filament_mm3: i64,
    pub(super) waits: Option<String>,
    pub(super) over_seq: Option<i64>,
    pub(super) needs: String,
}

impl Columns {
    /// Of a job that was last changed by record `seq`.
    pub(super) fn of(job: &Job, seq: u64) -> Self {
        Self {
            urgency: -i64::from(job.wishes.priority),
            rank: job.rank.as_str().to_owned(),
            filament_mm3: signed(job.estimate().map_or(0, |estimate| estimate.filament_mm3)),
            waits: waits(job).map(str::to_owned),
            over_seq: job.state.is_over().then_some(signed(seq)),
            needs: json(job.needs()),
        }
    }
}

/// Until when a job is not known to be due; nothing is kept once it is, and a millisecond more where the clock was set back.
pub(super) fn due_ms(job: &Job) -> Option<i64> {
    job.wishes.not_before.filter(|_| waits(job) == Some("print")).map(Timestamp::as_millisecond)
}

/// Where the history was left.
pub(super) fn head(db: &Connection) -> Result<Head, Error> {
    let found = db
        .prepare_cached("SELECT seq, digest FROM head WHERE id = 1")?
        .query_row([], |row| Ok((row.get(0)?, row.get(1)?)))
        .optional()?;
    found.map_or(Ok(Head::EMPTY), |(seq, text)| Ok(Head { seq: unsigned(seq)?, digest: digest(text)? }))
}

/// Where it really ends.
pub(super) fn last(db: &Connection) -> Result<Head, Error> {
    let found = db
        .prepare_cached("SELECT seq, digest FROM history ORDER BY seq DESC LIMIT 1")?
        .query_row([], |row| Ok((row.get(0)?, row.get(1)?)))
        .optional()?;
    found.map_or(Ok(Head::EMPTY), |(seq, text)| Ok(Head { seq: unsigned(seq)?, digest: digest(text)? }))
}

/// Adds records; gives the end of the history.
pub(super) fn record(db: &Connection, facts: Vec<Fact>) -> Result<Head, Error> {
    let mut head = head(db)?;
    let mut insert =
        db.prepare_cached("INSERT INTO history (seq, subject, body, digest) VALUES (?1, ?2, ?3, ?4)")?;
    for fact in facts {
        let subject = fact.subject().to_string();
        let sealed = head.seal(fact);
        insert.execute(params![signed(sealed.seq), subject, sealed.body, sealed.digest.to_string()])?;
        head = sealed.head();
    }
    db.prepare_cached("INSERT OR REPLACE INTO head (id, seq, digest) VALUES (1, ?1, ?2)")?
        .execute(params![signed(head.seq), head.digest.to_string()])?;
    Ok(head)
}

/// A record as it is kept; columns `seq, body, digest`.
pub(super) fn sealed(row: &Row<'_>) -> Result<Sealed, Error> {
    Ok(Sealed { seq: unsigned(row.get(0)?)?, body: row.get(1)?, digest: digest(row.get(2)?)? })
}

/// A job, where it is there.
pub(super) fn find(db: &Connection, id: JobId) -> Result<Option<Job>, Error> {
    let body: Option<String> = db
        .prepare_cached("SELECT body FROM jobs WHERE id = ?1")?
        .query_row([id.to_string()], |row| row.get(0))
        .optional()?;
    body.map(|body| parsed("a job", &body)).transpose()
}

pub(super) fn job(db: &Connection, id: JobId) -> Result<Job, Error> {
    find(db, id)?.ok_or_else(|| Refusal::NoJob { id }.into())
}

/// What jobs ask of a printer, by number.
fn needs_id(db: &Connection, needs: &Needs) -> Result<i64, Error> {
    let body = json(needs);
    let find = "SELECT id FROM needs WHERE body = ?1";
    if let Some(id) = db.prepare_cached(find)?.query_row([&body], |row| row.get(0)).optional()? {
        return Ok(id);
    }
    db.prepare_cached("INSERT INTO needs (body) VALUES (?1)")?.execute([&body])?;
    Ok(db.last_insert_rowid())
}

/// Writes a job that was last changed by record `seq`, its own.
pub(super) fn put_job(db: &Connection, job: &Job, seq: u64) -> Result<(), Error> {
    let needs = needs_id(db, job.needs())?;
    let columns = Columns::of(job, seq);
    db.prepare_cached(
        "INSERT INTO jobs (id, body, urgency, rank, needs, filament_mm3, waits, due_ms, over_seq)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)
         ON CONFLICT (id) DO UPDATE SET body = ?2, urgency = ?3, rank = ?4, needs = ?5, filament_mm3 = ?6, waits = ?7,
         due_ms = ?8, over_seq = ?9",
    )?
    .execute(params![
        job.id.to_string(),
        json(job),
        columns.urgency,
        columns.rank,
        needs,
        columns.filament_mm3,
        columns.waits,
        due_ms(job),
        columns.over_seq,
    ])?;
    Ok(())
}

/// Who has a job.
pub(super) fn claim(db: &Connection, job: JobId) -> Result<Option<Claim>, Error> {
    let found: Option<(String, i64, i64)> = db
        .prepare_cached("SELECT holder, token, until_ms FROM claims WHERE job = ?1")?
        .query_row([job.to_string()], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?)))
        .optional()?;
    let Some((holder, token, until_ms)) = found else { return Ok(None) };
    let until = Timestamp::from_millisecond(until_ms).map_err(|e| Error::Row(e.to_string()))?;
    let holder = Name::try_new(&holder).map_err(|e| Error::Row(format!("a claim's holder: {e}")))?;
    Ok(Some(Claim { job, holder, token: unsigned(token)?, until }))
}

pub(super) fn put_claim(db: &Connection, job: JobId, claim: Option<&Claim>) -> Result<(), Error> {
    let Some(claim) = claim else {
        db.prepare_cached("DELETE FROM claims WHERE job = ?1")?.execute([job.to_string()])?;
        return Ok(());
    };
    let (token, until_ms) = (signed(claim.token), claim.until.as_millisecond());
    db.prepare_cached(
        "INSERT OR REPLACE INTO claims (job, holder, token, until_ms) VALUES (?1, ?2, ?3, ?4)",
    )?
    .execute(params![job.to_string(), claim.holder.as_str(), token, until_ms])?;
    Ok(())
}

/// A printer, where it is known.
pub(super) fn printer(db: &Connection, name: &Name) -> Result<Option<Printer>, Error> {
    let body: Option<String> = db
        .prepare_cached("SELECT body FROM printers WHERE name = ?1")?
        .query_row([name.as_str()], |row| row.get(0))
        .optional()?;
    body.map(|body| parsed("a printer", &body)).transpose()
}

pub(super) fn put_printer(db: &Connection, printer: &Printer) -> Result<(), Error> {
    db.prepare_cached("INSERT OR REPLACE INTO printers (name, body) VALUES (?1, ?2)")?
        .execute(params![printer.name.as_str(), json(printer)])?;
    Ok(())
}

/// What a change of a job touches. `at`: the printer that is about to take it.
pub(super) fn scene(db: &Connection, id: JobId, at: Option<&Name>) -> Result<Scene, Error> {
    let job = job(db, id)?;
    let holder = job.holder.as_ref().filter(|_| job.state.is_at_printer());
    let printer = at.or(holder).map(|name| printer(db, name)).transpose()?.flatten();
    Ok(Scene { claim: claim(db, id)?, printer, job })
}

/// Writes what was decided, with its records.
pub(super) fn put(db: &Connection, Outcome { scene, facts }: Outcome) -> Result<Scene, Error> {
    let is_printers = |fact: &&Fact| matches!(fact.what, What::Printer { .. });
    let n_behind: u64 = facts.iter().rev().take_while(is_printers).map(|_| 1).sum();
    let head = record(db, facts)?;
    put_job(db, &scene.job, head.seq - n_behind)?;
    put_claim(db, scene.job.id, scene.claim.as_ref())?;
    if let Some(printer) = &scene.printer {
        put_printer(db, printer)?;
    }
    Ok(scene)
}

pub(super) fn put_spec(db: &Connection, job: JobId, spec: &Spec) -> Result<(), Error> {
    db.prepare_cached("INSERT INTO specs (job, kind, bytes) VALUES (?1, ?2, ?3)")?.execute(params![
        job.to_string(),
        json(&spec.kind()),
        spec.bytes()
    ])?;
    Ok(())
}

pub(super) fn spec(db: &Connection, id: JobId) -> Result<Option<Spec>, Error> {
    let found: Option<(String, Vec<u8>)> = db
        .prepare_cached("SELECT kind, bytes FROM specs WHERE job = ?1")?
        .query_row([id.to_string()], |row| Ok((row.get(0)?, row.get(1)?)))
        .optional()?;
    let Some((kind, bytes)) = found else { return Ok(None) };
    let spec = Spec::try_new(parsed::<SpecKind>("a specification", &kind)?, bytes);
    spec.map(Some).map_err(|e| Error::Row(e.to_string()))
}

/// The place before or behind another, or at an end, of all jobs; `None` where there is none.
pub(super) fn neighbour(db: &Connection, sql: &str, rank: Option<&Rank>) -> Result<Option<Rank>, Error> {
    let mut select = db.prepare_cached(sql)?;
    let found: Option<String> = match rank {
        Some(rank) => select.query_row([rank.as_str()], |row| row.get(0)),
        None => select.query_row([], |row| row.get(0)),
    }
    .optional()?;
    found.map(|text| Rank::try_from(text).map_err(|e| Error::Row(e.to_string()))).transpose()
}
