//! Rows to what they mean, and back.

use super::{Row, Sql};
use crate::queue::act::{Outcome, Scene};
use crate::queue::history::Head;
use crate::queue::{
    Break, Claim, Digest, Fact, Job, JobId, Name, Needs, Printer, Rank, Refusal, Sealed, Spec, SpecKind,
    State, What,
};
use crate::store;
use jiff::Timestamp;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;

/// Why something was not done within a transaction.
#[derive(Debug)]
pub enum Error {
    /// The database says so.
    Store(store::Error),
    /// A row is not what this program writes.
    Row(String),
}

impl From<store::Error> for Error {
    fn from(error: store::Error) -> Self {
        Self::Store(error)
    }
}

impl From<Refusal> for Error {
    fn from(refusal: Refusal) -> Self {
        Self::Store(refusal.into())
    }
}

impl From<Break> for Error {
    fn from(found: Break) -> Self {
        Self::Store(found.into())
    }
}

impl Error {
    /// With the database it happened to.
    pub(in crate::store) fn at(self, path: &Path) -> store::Error {
        match self {
            Self::Store(error) => error,
            Self::Row(problem) => store::Error::Damaged { path: path.to_owned(), problem },
        }
    }
}

pub(in crate::store) fn json(value: &impl Serialize) -> String {
    serde_json::to_string(value).expect("rows are numbers, names and lists of them")
}

pub(in crate::store) fn parsed<T: DeserializeOwned>(what: &str, body: &str) -> Result<T, Error> {
    serde_json::from_str(body).map_err(|e| Error::Row(format!("{what} cannot be read: {e}")))
}

fn digest(text: String) -> Result<Digest, Error> {
    Digest::try_from(text).map_err(|e| Error::Row(e.to_string()))
}

/// A database's whole numbers have a sign; amounts that large mean "more than there is".
pub(in crate::store) fn signed(number: u64) -> i64 {
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
    pub(in crate::store) fn of(job: &Job, seq: u64) -> Self {
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
pub(in crate::store) fn due_ms(job: &Job) -> Option<i64> {
    job.wishes.not_before.filter(|_| waits(job) == Some("print")).map(Timestamp::as_millisecond)
}

/// Where the history was left.
pub(in crate::store) fn head(db: &dyn Sql) -> Result<Head, Error> {
    head_in(db.row("SELECT seq, digest FROM head WHERE id = 1", &[])?)
}

/// Where it really ends.
pub(in crate::store) fn last(db: &dyn Sql) -> Result<Head, Error> {
    head_in(db.row("SELECT seq, digest FROM history ORDER BY seq DESC LIMIT 1", &[])?)
}

fn head_in(row: Option<Row>) -> Result<Head, Error> {
    let Some(mut row) = row else { return Ok(Head::EMPTY) };
    Ok(Head { seq: unsigned(row.int(0)?)?, digest: digest(row.text(1)?)? })
}

/// Adds records; gives the end of the history.
pub(in crate::store) fn record(db: &dyn Sql, facts: Vec<Fact>) -> Result<Head, Error> {
    let mut head = head(db)?;
    let insert = "INSERT INTO history (seq, subject, body, digest) VALUES (?1, ?2, ?3, ?4)";
    for fact in facts {
        let subject = fact.subject().to_string();
        let sealed = head.seal(fact);
        let digest = sealed.digest.to_string();
        db.run(
            insert,
            &[signed(sealed.seq).into(), (&subject).into(), (&sealed.body).into(), (&digest).into()],
        )?;
        head = sealed.head();
    }
    let sql = "INSERT INTO head (id, seq, digest) VALUES (1, ?1, ?2)
               ON CONFLICT (id) DO UPDATE SET seq = excluded.seq, digest = excluded.digest";
    db.run(sql, &[signed(head.seq).into(), (&head.digest.to_string()).into()])?;
    Ok(head)
}

/// A record as it is kept; columns `seq, body, digest`.
pub(in crate::store) fn sealed(row: &mut Row) -> Result<Sealed, Error> {
    Ok(Sealed { seq: unsigned(row.int(0)?)?, body: row.text(1)?, digest: digest(row.text(2)?)? })
}

/// A job, where it is there.
pub(in crate::store) fn find(db: &dyn Sql, id: JobId) -> Result<Option<Job>, Error> {
    let found = db.row("SELECT body FROM jobs WHERE id = ?1", &[(&id.to_string()).into()])?;
    found.map(|mut row| parsed("a job", &row.text(0)?)).transpose()
}

pub(in crate::store) fn job(db: &dyn Sql, id: JobId) -> Result<Job, Error> {
    find(db, id)?.ok_or_else(|| Refusal::NoJob { id }.into())
}

/// What jobs ask of a printer, by number.
fn needs_id(db: &dyn Sql, needs: &Needs) -> Result<i64, Error> {
    let body = json(needs);
    if let Some(mut row) = db.row("SELECT id FROM needs WHERE body = ?1", &[(&body).into()])? {
        return row.int(0);
    }
    let made = db.row("INSERT INTO needs (body) VALUES (?1) RETURNING id", &[(&body).into()])?;
    made.ok_or_else(|| Error::Row("what a job needs was not written".into()))?.int(0)
}

/// Writes a job that was last changed by record `seq`, its own.
pub(in crate::store) fn put_job(db: &dyn Sql, job: &Job, seq: u64) -> Result<(), Error> {
    let needs = needs_id(db, job.needs())?;
    let columns = Columns::of(job, seq);
    let (id, body) = (job.id.to_string(), json(job));
    let sql = "INSERT INTO jobs (id, body, urgency, rank, needs, filament_mm3, waits, due_ms, over_seq)
               VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9)
               ON CONFLICT (id) DO UPDATE SET body = excluded.body, urgency = excluded.urgency, rank = excluded.rank,
               needs = excluded.needs, filament_mm3 = excluded.filament_mm3, waits = excluded.waits,
               due_ms = excluded.due_ms, over_seq = excluded.over_seq";
    let params = [
        (&id).into(),
        (&body).into(),
        columns.urgency.into(),
        (&columns.rank).into(),
        needs.into(),
        columns.filament_mm3.into(),
        columns.waits.as_ref().into(),
        due_ms(job).into(),
        columns.over_seq.into(),
    ];
    db.run(sql, &params)?;
    Ok(())
}

/// Who has a job.
pub(in crate::store) fn claim(db: &dyn Sql, job: JobId) -> Result<Option<Claim>, Error> {
    let sql = "SELECT holder, token, until_ms FROM claims WHERE job = ?1";
    let Some(mut row) = db.row(sql, &[(&job.to_string()).into()])? else { return Ok(None) };
    let until = Timestamp::from_millisecond(row.int(2)?).map_err(|e| Error::Row(e.to_string()))?;
    let holder = Name::try_new(&row.text(0)?).map_err(|e| Error::Row(format!("a claim's holder: {e}")))?;
    Ok(Some(Claim { job, holder, token: unsigned(row.int(1)?)?, until }))
}

pub(in crate::store) fn put_claim(db: &dyn Sql, job: JobId, claim: Option<&Claim>) -> Result<(), Error> {
    let job = job.to_string();
    let Some(claim) = claim else {
        db.run("DELETE FROM claims WHERE job = ?1", &[(&job).into()])?;
        return Ok(());
    };
    let sql = "INSERT INTO claims (job, holder, token, until_ms) VALUES (?1, ?2, ?3, ?4)
               ON CONFLICT (job) DO UPDATE SET holder = excluded.holder, token = excluded.token, until_ms = excluded.until_ms";
    let (token, until_ms) = (signed(claim.token), claim.until.as_millisecond());
    db.run(sql, &[(&job).into(), claim.holder.as_str().into(), token.into(), until_ms.into()])?;
    Ok(())
}

/// A printer, where it is known.
pub(in crate::store) fn printer(db: &dyn Sql, name: &Name) -> Result<Option<Printer>, Error> {
    let found = db.row("SELECT body FROM printers WHERE name = ?1", &[name.as_str().into()])?;
    found.map(|mut row| parsed("a printer", &row.text(0)?)).transpose()
}

pub(in crate::store) fn put_printer(db: &dyn Sql, printer: &Printer) -> Result<(), Error> {
    let sql = "INSERT INTO printers (name, body) VALUES (?1, ?2) ON CONFLICT (name) DO UPDATE SET body = excluded.body";
    db.run(sql, &[printer.name.as_str().into(), (&json(printer)).into()])?;
    Ok(())
}

/// What a change of a job touches. `at`: the printer that is about to take it.
pub(in crate::store) fn scene(db: &dyn Sql, id: JobId, at: Option<&Name>) -> Result<Scene, Error> {
    let job = job(db, id)?;
    let holder = job.holder.as_ref().filter(|_| job.state.is_at_printer());
    let printer = at.or(holder).map(|name| printer(db, name)).transpose()?.flatten();
    Ok(Scene { claim: claim(db, id)?, printer, job })
}

/// Writes what was decided, with its records.
pub(in crate::store) fn put(db: &dyn Sql, Outcome { scene, facts }: Outcome) -> Result<Scene, Error> {
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

pub(in crate::store) fn put_spec(db: &dyn Sql, job: JobId, spec: &Spec) -> Result<(), Error> {
    let sql = "INSERT INTO specs (job, kind, bytes) VALUES (?1, ?2, ?3)";
    db.run(sql, &[(&job.to_string()).into(), (&json(&spec.kind())).into(), spec.bytes().into()])?;
    Ok(())
}

pub(in crate::store) fn spec(db: &dyn Sql, id: JobId) -> Result<Option<Spec>, Error> {
    let sql = "SELECT kind, bytes FROM specs WHERE job = ?1";
    let Some(mut row) = db.row(sql, &[(&id.to_string()).into()])? else { return Ok(None) };
    let kind = parsed::<SpecKind>("a specification", &row.text(0)?)?;
    let spec = Spec::try_new(kind, row.bytes(1)?);
    spec.map(Some).map_err(|e| Error::Row(e.to_string()))
}

/// The place before or behind another, or at an end, of all jobs; `None` where there is none.
pub(in crate::store) fn neighbour(
    db: &dyn Sql,
    sql: &'static str,
    rank: Option<&Rank>,
) -> Result<Option<Rank>, Error> {
    let found = match rank {
        Some(rank) => db.row(sql, &[rank.as_str().into()])?,
        None => db.row(sql, &[])?,
    };
    found.map(|mut row| Rank::try_from(row.text(0)?).map_err(|e| Error::Row(e.to_string()))).transpose()
}
