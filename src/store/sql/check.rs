//! Whether a database is what its history comes to, a part at a time.

use super::Sql;
use super::rows::{self, Columns, Error, parsed};
use crate::queue::{Break, Head, Job, JobId, Kind, Name, Needs, Record, Subject, What, history};
use crate::store::Progress;
use crate::store::progress::{Replay, Stage};

/// Records, or rows, of one part.
const MOST: i64 = 4096;

/// Tables whose rows all have records: how rows and their subjects are found from a key on.
const TABLES: [&str; 4] = [
    "SELECT id, 'job ' || id FROM jobs WHERE id >= ?1 ORDER BY id LIMIT ?2",
    "SELECT job, 'job ' || job FROM specs WHERE job >= ?1 ORDER BY job LIMIT ?2",
    "SELECT job, 'job ' || job FROM claims WHERE job >= ?1 ORDER BY job LIMIT ?2",
    "SELECT name, 'printer ' || name FROM printers WHERE name >= ?1 ORDER BY name LIMIT ?2",
];

/// One part, within one transaction: the chain of records, then every job and printer against its own records, then whatever has none.
pub(in crate::store) fn part(db: &dyn Sql, Progress(stage): Progress) -> Result<Option<Progress>, Error> {
    let next = match stage {
        Stage::Chain(head) => chain(db, head)?,
        Stage::Subjects { from } => subjects(db, from)?,
        Stage::Within(replay) => within(db, *replay)?,
        Stage::Rows { table, from } => rows_of(db, table, from)?,
        Stage::Rest => return rest(db).map(|()| None),
    };
    Ok(Some(Progress(next)))
}

/// The key behind another one: no key has a character below the space.
fn behind(key: &str) -> String {
    format!("{key}\u{1}")
}

fn chain(db: &dyn Sql, head: Head) -> Result<Stage, Error> {
    check_anchor(db, head)?;
    let sql = "SELECT seq, body, digest, subject FROM history WHERE seq > ?1 ORDER BY seq LIMIT ?2";
    let (mut end, mut n_found) = (head, 0);
    for mut row in db.rows(sql, &[rows::signed(head.seq).into(), MOST.into()])? {
        let sealed = rows::sealed(&mut row)?;
        end = end.follow(&sealed)?;
        if row.text(3)? != sealed.record()?.fact.subject().to_string() {
            return Err(Break::Changed { seq: sealed.seq }.into());
        }
        n_found += 1;
    }
    if n_found == MOST {
        return Ok(Stage::Chain(end));
    }
    end.check_end(rows::head(db)?)?;
    Ok(Stage::Subjects { from: String::new() })
}

/// That the chain is still what it was up to a head, and has nothing before its first record.
fn check_anchor(db: &dyn Sql, head: Head) -> Result<(), Error> {
    if head == Head::EMPTY {
        let sql = "SELECT seq FROM history WHERE seq < 1 ORDER BY seq LIMIT 1";
        return db.row(sql, &[])?.map_or(Ok(()), |mut row| {
            Err(Error::Row(format!("found a record {}, expected none below 1", row.int(0)?)))
        });
    }
    let sql = "SELECT seq, body, digest FROM history WHERE seq = ?1";
    let found = db.row(sql, &[rows::signed(head.seq).into()])?;
    match found.map(|mut row| rows::sealed(&mut row)).transpose()? {
        Some(sealed) if sealed.head() == head => Ok(()),
        Some(_) => Err(Break::Changed { seq: head.seq }.into()),
        None => Err(Break::End { found: rows::last(db)?.seq, expected: head.seq }.into()),
    }
}

fn subjects(db: &dyn Sql, mut from: String) -> Result<Stage, Error> {
    let sql = "SELECT subject FROM history WHERE subject >= ?1 ORDER BY subject LIMIT 1";
    let mut n_left = MOST;
    while n_left > 0 {
        let Some(mut row) = db.row(sql, &[(&from).into()])? else {
            return Ok(Stage::Rows { table: 0, from: String::new() });
        };
        let text = row.text(0)?;
        let mut replay = Replay { subject: subject(&text)?, seq: 0, token: 0, job: None, printer: None };
        let n_found = go_on(db, &mut replay, n_left)?;
        if n_found == n_left {
            return Ok(Stage::Within(Box::new(replay)));
        }
        check_kept(db, &replay)?;
        n_left -= n_found;
        from = behind(&text);
    }
    Ok(Stage::Subjects { from })
}

fn within(db: &dyn Sql, mut replay: Replay) -> Result<Stage, Error> {
    if go_on(db, &mut replay, MOST)? == MOST {
        return Ok(Stage::Within(Box::new(replay)));
    }
    check_kept(db, &replay)?;
    Ok(Stage::Subjects { from: behind(&replay.subject.to_string()) })
}

fn subject(text: &str) -> Result<Subject, Error> {
    let job = text.strip_prefix("job ").and_then(|id| id.parse().ok()).map(Subject::Job);
    let name = || text.strip_prefix("printer ").and_then(|name| Name::try_new(name).ok());
    job.or_else(|| name().map(Subject::Printer))
        .filter(|subject| subject.to_string() == text)
        .ok_or_else(|| Error::Row(format!("found {text:?}, expected the name of a job or printer")))
}

/// Replays some more records; gives how many were there.
fn go_on(db: &dyn Sql, replay: &mut Replay, most: i64) -> Result<i64, Error> {
    let sql = "SELECT seq, body, digest FROM history WHERE subject = ?1 AND seq > ?2 ORDER BY seq LIMIT ?3";
    let subject = replay.subject.to_string();
    let mut n_found = 0;
    for mut row in db.rows(sql, &[(&subject).into(), rows::signed(replay.seq).into(), most.into()])? {
        take(replay, &rows::sealed(&mut row)?.record()?)?;
        n_found += 1;
    }
    Ok(n_found)
}

fn take(replay: &mut Replay, record: &Record) -> Result<(), Error> {
    replay.seq = record.seq;
    replay.job = history::follow_job(replay.job.take(), record)?;
    replay.printer = history::follow_printer(replay.printer.take(), record)?;
    if let What::Job { change, .. } = &record.fact.what
        && matches!(change.kind(), Kind::Prepare | Kind::Start | Kind::Adopt)
    {
        replay.token = record.seq;
    }
    Ok(())
}

/// What is kept is what its records come to.
fn check_kept(db: &dyn Sql, replay: &Replay) -> Result<(), Error> {
    let is_same = match &replay.subject {
        Subject::Job(id) => is_job_kept(db, *id, replay)?,
        Subject::Printer(name) => rows::printer(db, name)? == replay.printer,
    };
    if is_same { Ok(()) } else { Err(Break::Differs { subject: replay.subject.clone() }.into()) }
}

fn is_job_kept(db: &dyn Sql, id: JobId, replay: &Replay) -> Result<bool, Error> {
    let Some(job) = &replay.job else { return Ok(false) };
    Ok(rows::find(db, id)?.as_ref() == Some(job)
        && is_found_rightly(db, job, replay.seq)?
        && is_claimed_rightly(db, job, replay.token)?
        && rows::spec(db, id)?.is_some_and(|spec| spec.mark() == job.spec))
}

/// The columns by which a job is found are those that it was written with by its last record.
fn is_found_rightly(db: &dyn Sql, job: &Job, seq: u64) -> Result<bool, Error> {
    let sql = "SELECT urgency, rank, filament_mm3, waits, over_seq, n.body, due_ms
               FROM jobs j LEFT JOIN needs n ON n.id = j.needs WHERE j.id = ?1";
    let Some(mut row) = db.row(sql, &[(&job.id.to_string()).into()])? else { return Ok(false) };
    let columns = Columns {
        urgency: row.int(0)?,
        rank: row.text(1)?,
        filament_mm3: row.int(2)?,
        waits: row.maybe_text(3)?,
        over_seq: row.maybe_int(4)?,
        needs: row.maybe_text(5)?.unwrap_or_default(),
    };
    let due_ms = row.maybe_int(6)?;
    let is_due_rightly = match (rows::due_ms(job), due_ms) {
        (_, None) => true,
        (written, Some(found)) => written.is_some_and(|written| found == written || found == written + 1),
    };
    Ok(columns == Columns::of(job, seq) && is_due_rightly)
}

fn is_claimed_rightly(db: &dyn Sql, job: &Job, token: u64) -> Result<bool, Error> {
    let found = rows::claim(db, job.id)?.map(|claim| (claim.holder, claim.token));
    let holder = job.holder.clone().filter(|_| job.state.is_claimed());
    Ok(found == holder.map(|holder| (holder, token)))
}

fn rows_of(db: &dyn Sql, table: usize, from: String) -> Result<Stage, Error> {
    let Some(sql) = TABLES.get(table) else { return Ok(Stage::Rest) };
    let recorded = "SELECT seq FROM history WHERE subject = ?1 LIMIT 1";
    let found = db.rows(sql, &[(&from).into(), MOST.into()])?;
    let (mut last, mut n_found) = (from, 0);
    for mut row in found {
        let text = row.text(1)?;
        if db.row(recorded, &[(&text).into()])?.is_none() {
            return Err(Break::Differs { subject: subject(&text)? }.into());
        }
        last = behind(&row.text(0)?);
        n_found += 1;
    }
    let is_all = n_found < MOST;
    Ok(if is_all {
        Stage::Rows { table: table + 1, from: String::new() }
    } else {
        Stage::Rows { table, from: last }
    })
}

/// What jobs need can be read, and tables, indices and triggers are those that were made.
fn rest(db: &dyn Sql) -> Result<(), Error> {
    for mut row in db.rows("SELECT body FROM needs", &[])? {
        let body = row.text(0)?;
        if rows::json(&parsed::<Needs>("what a job needs", &body)?) != body {
            return Err(Error::Row(format!("found {body}, which no job can need")));
        }
    }
    db.check_made()
}
