//! What is asked of the store, each within one transaction.

use super::rows::{self, Error, parsed, signed};
use super::{Param, Sql};
use crate::queue::act::{self, Bedside, Outcome, Scene};
use crate::queue::{
    Actor, Bed, By, Change, Claim, Claimant, Edit, Job, JobId, Name, Needs, Printer, Rank, Reason, Refusal,
    Request, Said, Sealed, Subject, Ticket,
};
use crate::store::{Claimed, Place, Which};
use jiff::Timestamp;

pub(in crate::store) fn add(
    db: &dyn Sql,
    ticket: &Ticket,
    is_submitted: bool,
    by: &By,
) -> Result<Job, Error> {
    if let Some(known) = rows::find(db, ticket.id)? {
        return same(known, ticket);
    }
    let outcome = act::add(ticket, rank(db, Place::Last)?, is_submitted, by)?;
    let scene = rows::put(db, outcome)?;
    rows::put_spec(db, ticket.id, &ticket.spec)?;
    Ok(scene.job)
}

/// The job that was added with this ticket before: a lost answer does not print twice.
fn same(known: Job, ticket: &Ticket) -> Result<Job, Error> {
    if known.spec == ticket.spec.mark() { Ok(known) } else { Err(Refusal::IdTaken { id: ticket.id }.into()) }
}

pub(in crate::store) fn change(db: &dyn Sql, job: JobId, request: &Request) -> Result<Job, Error> {
    let outcome = act::change(&rows::scene(db, job, None)?, request)?;
    Ok(rows::put(db, outcome)?.job)
}

pub(in crate::store) fn place(
    db: &dyn Sql,
    job: JobId,
    place: Place,
    actor: Actor,
    why: Reason,
    now: Timestamp,
) -> Result<Job, Error> {
    if matches!(place, Place::Before(other) | Place::Behind(other) if other == job) {
        return rows::job(db, job);
    }
    let change = Change::Edit(Edit::Rank(rank(db, place)?));
    let request = Request { change, actor, why, now };
    let outcome = act::place(&rows::scene(db, job, None)?, &request)?;
    Ok(rows::put(db, outcome)?.job)
}

/// A new place.
fn rank(db: &dyn Sql, place: Place) -> Result<Rank, Error> {
    const FIRST: &str = "SELECT rank FROM jobs ORDER BY rank LIMIT 1";
    const LAST: &str = "SELECT rank FROM jobs ORDER BY rank DESC LIMIT 1";
    const BEFORE: &str = "SELECT rank FROM jobs WHERE rank < ?1 ORDER BY rank DESC LIMIT 1";
    const BEHIND: &str = "SELECT rank FROM jobs WHERE rank > ?1 ORDER BY rank LIMIT 1";
    let (before, behind) = match place {
        Place::First => (None, rows::neighbour(db, FIRST, None)?),
        Place::Last => (rows::neighbour(db, LAST, None)?, None),
        Place::Before(other) => {
            let rank = rows::job(db, other)?.rank;
            (rows::neighbour(db, BEFORE, Some(&rank))?, Some(rank))
        }
        Place::Behind(other) => {
            let rank = rows::job(db, other)?.rank;
            let behind = rows::neighbour(db, BEHIND, Some(&rank))?;
            (Some(rank), behind)
        }
    };
    Ok(Rank::between(before.as_ref(), behind.as_ref()))
}

pub(in crate::store) fn claim(
    db: &dyn Sql,
    claimant: &Claimant,
    now: Timestamp,
) -> Result<Option<Claimed>, Error> {
    let token = rows::head(db)?.seq + 1;
    match claimant {
        Claimant::Worker(_) => match first_to_prepare(db)? {
            Some(id) => taken(db, act::claim(&rows::scene(db, id, None)?, claimant, token, now)?).map(Some),
            None => Ok(None),
        },
        Claimant::Printer(name) => claim_print(db, claimant, name, token, now),
    }
}

fn claim_print(
    db: &dyn Sql,
    claimant: &Claimant,
    name: &Name,
    token: u64,
    now: Timestamp,
) -> Result<Option<Claimed>, Error> {
    let printer = rows::printer(db, name)?.ok_or_else(|| Refusal::NoPrinter { printer: name.clone() })?;
    if printer.bed != Bed::Clear {
        return Err(Refusal::BedNotClear { printer: name.clone() }.into());
    }
    db.run("UPDATE jobs SET due_ms = NULL WHERE due_ms <= ?1", &[now.as_millisecond().into()])?;
    while let Some(id) = first_to_print(db, &printer)? {
        match act::claim(&rows::scene(db, id, Some(name))?, claimant, token, now) {
            Ok(outcome) => return taken(db, outcome).map(Some),
            // The clock was set back: it has to wait again.
            Err(Refusal::NotDue { until }) => wait_again(db, id, until)?,
            Err(refusal) => return Err(refusal.into()),
        }
    }
    Ok(None)
}

fn wait_again(db: &dyn Sql, id: JobId, until: Timestamp) -> Result<(), Error> {
    // A part of a millisecond is waited for whole, lest it be due and not due at once.
    let until_ms = until.as_millisecond() + 1;
    db.run("UPDATE jobs SET due_ms = ?2 WHERE id = ?1", &[(&id.to_string()).into(), until_ms.into()])?;
    Ok(())
}

fn taken(db: &dyn Sql, outcome: Outcome) -> Result<Claimed, Error> {
    let Scene { job, claim, .. } = rows::put(db, outcome)?;
    let claim = claim.ok_or_else(|| Error::Row("a job was taken without a claim".into()))?;
    Ok(Claimed { job, claim })
}

fn id_of(text: String) -> Result<JobId, Error> {
    JobId::try_from(text).map_err(|e| Error::Row(format!("a job's name cannot be read: {e}")))
}

fn first_to_prepare(db: &dyn Sql) -> Result<Option<JobId>, Error> {
    let sql = "SELECT id FROM jobs WHERE waits = 'prepare' ORDER BY urgency, rank LIMIT 1";
    db.row(sql, &[])?.map(|mut row| id_of(row.text(0)?)).transpose()
}

/// The first job that fits. What jobs need is kept once for all that need the same, so that those that do not fit are not looked at
/// one by one.
fn first_to_print(db: &dyn Sql, printer: &Printer) -> Result<Option<JobId>, Error> {
    let sql = "SELECT urgency, rank, id FROM jobs WHERE waits = 'print' AND due_ms IS NULL AND needs = ?1
               AND filament_mm3 <= ?2 ORDER BY urgency, rank LIMIT 1";
    let left_mm3 = printer.loaded.as_ref().and_then(|loaded| loaded.left_mm3).map_or(i64::MAX, signed);
    let mut first: Option<(i64, String, String)> = None;
    for needs in fitting(db, printer)? {
        let found = db.row(sql, &[needs.into(), left_mm3.into()])?;
        let found =
            found.map(|mut row| Ok::<_, Error>((row.int(0)?, row.text(1)?, row.text(2)?))).transpose()?;
        first = first.into_iter().chain(found).min();
    }
    first.map(|(_, _, id)| id_of(id)).transpose()
}

/// All kinds of needs that a printer meets.
fn fitting(db: &dyn Sql, printer: &Printer) -> Result<Vec<i64>, Error> {
    let mut fitting = Vec::new();
    for mut row in db.rows("SELECT id, body FROM needs", &[])? {
        let needs: Needs = parsed("what a job needs", &row.text(1)?)?;
        if needs.check_kind(printer.loaded.as_ref()).is_ok() {
            fitting.push(row.int(0)?);
        }
    }
    Ok(fitting)
}

pub(in crate::store) fn renew(db: &dyn Sql, claim: &Claim, now: Timestamp) -> Result<Claim, Error> {
    let until = Claim::until(now);
    let sql = "UPDATE claims SET until_ms = ?4 WHERE job = ?1 AND holder = ?2 AND token = ?3";
    let (job, holder, token) = (claim.job.to_string(), claim.holder.as_str(), signed(claim.token));
    let n_renewed =
        db.run(sql, &[(&job).into(), holder.into(), token.into(), until.as_millisecond().into()])?;
    if n_renewed == 0 { Err(Refusal::ClaimLost.into()) } else { Ok(Claim { until, ..claim.clone() }) }
}

pub(in crate::store) fn adopt(db: &dyn Sql, holder: &Name, now: Timestamp) -> Result<Vec<Claimed>, Error> {
    let ids = ids(db, "SELECT job FROM claims WHERE holder = ?1 ORDER BY job", holder.as_str().into())?;
    let mut adopted = Vec::new();
    for id in ids {
        let token = rows::head(db)?.seq + 1;
        let Scene { job, claim, .. } =
            rows::put(db, act::adopt(&rows::scene(db, id, None)?, holder, token, now)?)?;
        adopted.extend(claim.map(|claim| Claimed { job, claim }));
    }
    Ok(adopted)
}

pub(in crate::store) fn sweep(db: &dyn Sql, now: Timestamp) -> Result<Vec<Job>, Error> {
    // Claims that only a clock which was set back since could have made are believed no longer than ones made now.
    let most_ms = Claim::until(now).as_millisecond();
    db.run("UPDATE claims SET until_ms = ?1 WHERE until_ms > ?1", &[most_ms.into()])?;
    let sql = "SELECT job FROM claims WHERE until_ms <= ?1 ORDER BY until_ms, job";
    let lapsed = ids(db, sql, now.as_millisecond().into())?;
    let mut changed = Vec::new();
    for id in lapsed {
        if let Some(outcome) = act::lost(&rows::scene(db, id, None)?, now)? {
            changed.push(rows::put(db, outcome)?.job);
        }
    }
    Ok(changed)
}

fn ids(db: &dyn Sql, sql: &'static str, by: Param<'_>) -> Result<Vec<JobId>, Error> {
    db.rows(sql, &[by])?.into_iter().map(|mut row| id_of(row.text(0)?)).collect()
}

pub(in crate::store) fn say(db: &dyn Sql, name: &Name, said: &Said, by: &By) -> Result<Printer, Error> {
    let printer = rows::printer(db, name)?.unwrap_or_else(|| Printer::new(name.clone()));
    let job = match printer.bed {
        Bed::Taken(id) => Some(rows::job(db, id)?),
        Bed::Clear | Bed::Unknown => None,
    };
    let before = Bedside { printer, job };
    let (after, facts) = act::say(&before, said, by)?;
    let head = rows::record(db, facts)?;
    rows::put_printer(db, &after.printer)?;
    if let Some(job) = after.job.filter(|job| before.job.as_ref() != Some(job)) {
        rows::put_job(db, &job, head.seq)?;
    }
    Ok(after.printer)
}

pub(in crate::store) fn printers(db: &dyn Sql) -> Result<Vec<Printer>, Error> {
    let found = db.rows("SELECT body FROM printers ORDER BY name", &[])?;
    found.into_iter().map(|mut row| parsed("a printer", &row.text(0)?)).collect()
}

pub(in crate::store) fn list(
    db: &dyn Sql,
    which: Which,
    behind: Option<JobId>,
    most: u32,
) -> Result<Vec<Job>, Error> {
    let (number, rank) = listed_behind(db, which, behind)?;
    let (number, most) = (number.into(), i64::from(most).into());
    let found = match which {
        Which::Live => {
            let sql = "SELECT body FROM jobs WHERE over_seq IS NULL AND (urgency, rank) > (?1, ?2)
                       ORDER BY urgency, rank LIMIT ?3";
            db.rows(sql, &[number, (&rank).into(), most])?
        }
        Which::Over => {
            let sql = "SELECT body FROM jobs WHERE over_seq IS NOT NULL AND over_seq < ?1 ORDER BY over_seq DESC LIMIT ?2";
            db.rows(sql, &[number, most])?
        }
    };
    found.into_iter().map(|mut row| parsed("a job", &row.text(0)?)).collect()
}

/// Where a listing goes on: urgency and rank, or the record.
fn listed_behind(db: &dyn Sql, which: Which, behind: Option<JobId>) -> Result<(i64, String), Error> {
    let Some(id) = behind else {
        let from = if which == Which::Live { i64::MIN } else { i64::MAX };
        return Ok((from, String::new()));
    };
    let sql = match which {
        Which::Live => "SELECT urgency, rank FROM jobs WHERE id = ?1",
        Which::Over => "SELECT over_seq, rank FROM jobs WHERE id = ?1 AND over_seq IS NOT NULL",
    };
    let mut row = db.row(sql, &[(&id.to_string()).into()])?.ok_or(Refusal::NoJob { id })?;
    Ok((row.int(0)?, row.text(1)?))
}

pub(in crate::store) fn history(
    db: &dyn Sql,
    of: Option<&Subject>,
    after: u64,
    most: u32,
) -> Result<Vec<Sealed>, Error> {
    let (after, most) = (signed(after).into(), i64::from(most).into());
    let found = match of {
        Some(subject) => {
            let sql =
                "SELECT seq, body, digest FROM history WHERE subject = ?1 AND seq > ?2 ORDER BY seq LIMIT ?3";
            db.rows(sql, &[(&subject.to_string()).into(), after, most])?
        }
        None => {
            let sql = "SELECT seq, body, digest FROM history WHERE seq > ?1 ORDER BY seq LIMIT ?2";
            db.rows(sql, &[after, most])?
        }
    };
    found.into_iter().map(|mut row| rows::sealed(&mut row)).collect()
}
