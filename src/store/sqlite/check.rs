//! Whether a database is what its history comes to.

use super::rows::{self, Columns, Error, parsed};
use crate::queue::{Break, Head, Job, Name, Record, Sealed, Subject, history};
use rusqlite::Connection;

/// The chain of records first, then every job and printer against its own records.
pub(super) fn check(db: &Connection) -> Result<(), Error> {
    check_chain(db)?;
    check_jobs(db)?;
    check_printers(db)?;
    check_none_is_missing(db)
}

fn check_chain(db: &Connection) -> Result<(), Error> {
    let mut select = db.prepare("SELECT seq, body, digest FROM history ORDER BY seq")?;
    let mut found = select.query([])?;
    let mut end = Head::EMPTY;
    while let Some(row) = found.next()? {
        end = end.follow(&rows::sealed(row)?)?;
    }
    Ok(end.check_end(rows::head(db)?)?)
}

fn records_of(db: &Connection, subject: &Subject) -> Result<Vec<Record>, Error> {
    let sealed = super::work::history(db, Some(subject), 0, u32::MAX)?;
    Ok(sealed.iter().map(Sealed::record).collect::<Result<_, _>>()?)
}

fn differs_unless(is_same: bool, subject: Subject) -> Result<(), Error> {
    if is_same { Ok(()) } else { Err(Break::Differs { subject }.into()) }
}

fn check_jobs(db: &Connection) -> Result<(), Error> {
    let mut select = db.prepare(
        "SELECT j.id, j.body, urgency, rank, filament_mm3, waits, over_seq IS NOT NULL, n.body
         FROM jobs j JOIN needs n ON n.id = j.needs ORDER BY j.id",
    )?;
    let mut found = select.query([])?;
    while let Some(row) = found.next()? {
        let job: Job = parsed("a job", &row.get::<_, String>(1)?)?;
        let columns = Columns {
            urgency: row.get(2)?,
            rank: row.get(3)?,
            filament_mm3: row.get(4)?,
            waits: row.get(5)?,
            is_over: row.get(6)?,
            needs: row.get(7)?,
        };
        let is_found_rightly = row.get::<_, String>(0)? == job.id.to_string() && columns == Columns::of(&job);
        differs_unless(is_found_rightly, Subject::Job(job.id))?;
        check_job(db, &job)?;
    }
    Ok(())
}

fn check_job(db: &Connection, job: &Job) -> Result<(), Error> {
    let subject = Subject::Job(job.id);
    let replayed = history::replay_job(&records_of(db, &subject)?)?;
    let is_same = replayed.as_ref() == Some(job)
        && rows::claim(db, job.id)?.is_some() == job.state.is_claimed()
        && rows::spec(db, job.id)?.mark() == job.spec;
    differs_unless(is_same, subject)
}

fn check_printers(db: &Connection) -> Result<(), Error> {
    for printer in super::work::printers(db)? {
        let subject = Subject::Printer(printer.name.clone());
        let replayed = history::replay_printer(&records_of(db, &subject)?)?;
        differs_unless(replayed.as_ref() == Some(&printer), subject)?;
    }
    Ok(())
}

/// Whatever has records is there.
fn check_none_is_missing(db: &Connection) -> Result<(), Error> {
    let mut select = db.prepare(
        "SELECT DISTINCT subject FROM history WHERE subject NOT IN (SELECT 'job ' || id FROM jobs)
         AND subject NOT IN (SELECT 'printer ' || name FROM printers) ORDER BY subject LIMIT 1",
    )?;
    let mut found = select.query([])?;
    let Some(row) = found.next()? else { return Ok(()) };
    let text: String = row.get(0)?;
    let job = text.strip_prefix("job ").and_then(|id| id.parse().ok()).map(Subject::Job);
    let printer =
        text.strip_prefix("printer ").and_then(|name| Name::try_new(name).ok()).map(Subject::Printer);
    let subject = job.or(printer).ok_or_else(|| Error::Row(format!("found records of {text:?}")))?;
    Err(Break::Differs { subject }.into())
}
