//! Whatever is changed by hand shows.

use super::*;
use crate::queue::tests::loaded;
use crate::queue::{Break, Evidence, Loaded, Reason, Subject, Wishes};

const UNGUARDED: &str = "DROP TRIGGER history_is_not_changed; DROP TRIGGER history_is_not_cut; DROP TRIGGER history_is_not_replaced;";

/// What is found where somebody has changed the file of three jobs.
fn found(sql: &str) -> Break {
    let folder = Folder::with_jobs(3);
    folder.by_hand(&format!("PRAGMA foreign_keys = OFF; {UNGUARDED} {sql}"));
    match Sqlite::open(&folder.db()).and_then(|store| run(store.verify())) {
        Err(Error::History(found)) => found,
        other => panic!("{sql}: {other:?}"),
    }
}

#[test]
fn records_are_neither_changed_nor_taken_out_by_accident() {
    let folder = Folder::with_jobs(1);
    let db = Connection::open(folder.db()).unwrap();
    for sql in [
        "UPDATE history SET body = '{}'",
        "DELETE FROM history",
        "INSERT OR REPLACE INTO history VALUES (1, '', '', '')",
    ] {
        let refused = db.execute_batch(sql).unwrap_err().to_string();
        assert!(refused.contains("the history is only added to"), "{sql}: {refused}");
    }
}

#[test]
fn a_changed_record_is_named() {
    let changed = "UPDATE history SET body = replace(body, 'Ada', 'Eve') WHERE seq = 3";
    assert_eq!(found(changed), Break::Changed { seq: 3 });
    assert_eq!(found("DELETE FROM history WHERE seq = 2"), Break::Missing { seq: 2, found: 3 });
    let swapped = "UPDATE history SET seq = 100 WHERE seq = 2; UPDATE history SET seq = 2 WHERE seq = 3;
                   UPDATE history SET seq = 3 WHERE seq = 100";
    assert_eq!(found(swapped), Break::Changed { seq: 2 });
    assert_eq!(found("DELETE FROM history WHERE seq = 6"), Break::End { found: 5, expected: 6 });
    let head = "UPDATE head SET digest = (SELECT digest FROM history WHERE seq = 5)";
    assert_eq!(found(head), Break::OtherEnd { seq: 6 });
}

#[test]
fn a_job_or_printer_that_is_not_what_its_records_come_to_is_named() {
    let differs = Break::Differs { subject: Subject::Job(id(2)) };
    let of = |set: &str| format!("UPDATE jobs SET {set} WHERE id = '{}'", id(2));
    for set in [
        "body = replace(body, '\"queued\"', '\"held\"')",
        "body = replace(body, '\"copies\":1', '\"copies\":2')",
        "urgency = -5",
        "waits = NULL",
        "waits = 'prepare'",
        "over_seq = 3",
        "filament_mm3 = 1",
    ] {
        assert_eq!(found(&of(set)), differs, "{set}");
    }
    assert_eq!(found(&format!("UPDATE specs SET bytes = x'00' WHERE job = '{}'", id(2))), differs);
    assert_eq!(found(&format!("INSERT INTO claims VALUES ('{}', 'left', 9, 0)", id(2))), differs);
    let gone = format!("DELETE FROM specs WHERE job = '{0}'; DELETE FROM jobs WHERE id = '{0}'", id(2));
    assert_eq!(found(&gone), differs);
    assert_eq!(found(&format!("DELETE FROM specs WHERE job = '{}'", id(2))), differs);
}

/// The triggers, as they were made.
fn guards() -> &'static str {
    let made = STEPS[0];
    let from = made.find("CREATE TRIGGER").unwrap();
    &made[from..made.find("CREATE TABLE head").unwrap()]
}

/// A file in which one of everything has happened, and job 2 is in print.
fn busy() -> Folder {
    let folder = Folder::new();
    run(async {
        let store = Folder::open(folder.dir());
        let left = name("left");
        let loaded = Loaded { left_mm3: None, ..loaded() };
        store.say(left.clone(), Said::Loaded(loaded), operator(0)).await.unwrap();
        store.say(left.clone(), Said::BedInDoubt, operator(0)).await.unwrap();
        store.say(left.clone(), Said::BedClear(Evidence::Word), operator(0)).await.unwrap();
        for number in 1..=3 {
            let not_before = (number == 3).then(|| at(5000));
            let wishes = Wishes { not_before, ..Wishes::default() };
            store.add(Ticket { wishes, ..ticket(number) }, true, operator(0)).await.unwrap();
        }
        let actor = Actor::Operator { name: name("Ada"), saw: State::Queued };
        let cancel = Change::Cancel { used_mm3: None };
        let cancelled = Request { change: cancel, actor, why: Reason::default(), now: at(1) };
        store.change(id(1), cancelled).await.unwrap();
        store.claim(Claimant::Printer(left), at(2)).await.unwrap().unwrap();
        store.verify().await.unwrap();
        store.close().await;
    });
    folder
}

/// What is found in a busy file after that.
fn is_found(sql: &str) -> bool {
    let folder = busy();
    folder.by_hand(&format!("PRAGMA foreign_keys = OFF; {sql}"));
    let checked = Sqlite::open(&folder.db()).and_then(|store| run(store.verify()));
    matches!(checked, Err(Error::History(_) | Error::Damaged { .. }))
}

#[track_caller]
fn assert_all_show<'a>(changed: impl Iterator<Item = &'a str>) {
    let missed: Vec<_> = changed.filter(|sql| !is_found(sql)).collect();
    assert!(missed.is_empty(), "not found: {missed:#?}");
}

#[test]
fn whatever_row_is_changed_by_hand_shows() {
    let (first, second, third) = (id(1), id(2), id(3));
    let changed = [
        // When jobs are looked at, and how they are listed.
        format!("UPDATE jobs SET due_ms = due_ms + 3600000 WHERE id = '{third}'"),
        format!("UPDATE jobs SET due_ms = 1 WHERE id = '{second}'"),
        format!("UPDATE jobs SET over_seq = over_seq + 1 WHERE id = '{first}'"),
        format!("UPDATE jobs SET needs = 999 WHERE id = '{third}'"),
        "INSERT INTO needs (body) VALUES ('{}')".to_owned(),
        "UPDATE needs SET body = replace(body, 'null', '\"left\"')".to_owned(),
        // A job under another name, or two of it.
        format!("UPDATE jobs SET id = upper(id) WHERE id = '{second}'"),
        "INSERT INTO jobs SELECT 'x', body, urgency, 'y', needs, 0, waits, due_ms, over_seq FROM jobs LIMIT 1".to_owned(),
        // Claims.
        "UPDATE claims SET holder = 'right'".to_owned(),
        "UPDATE claims SET token = token + 1".to_owned(),
        "DELETE FROM claims".to_owned(),
        format!("INSERT INTO claims VALUES ('{}', 'left', 9, 0)", id(9)),
        format!("INSERT INTO claims VALUES ('{third}', 'left', 9, 0)"),
        // Specifications.
        format!("UPDATE specs SET kind = '\"mesh\"' WHERE job = '{first}'"),
        format!("UPDATE specs SET bytes = zeroblob(70000) WHERE job = '{first}'"),
        format!("INSERT INTO specs VALUES ('{}', '\"gcode\"', x'00')", id(9)),
        // Printers.
        "UPDATE printers SET body = replace(body, 'ABS', 'PLA')".to_owned(),
        format!("UPDATE printers SET body = replace(body, '{{\"taken\":\"{second}\"}}', '\"clear\"')"),
        "INSERT INTO printers SELECT 'right', body FROM printers".to_owned(),
        "UPDATE printers SET name = 'right'".to_owned(),
        "DELETE FROM printers".to_owned(),
        "INSERT INTO printers SELECT 'right', replace(body, '\"left\"', '\"right\"') FROM printers".to_owned(),
        // The end of the history.
        "DELETE FROM head".to_owned(),
        "UPDATE head SET seq = seq - 1".to_owned(),
        // What guards the history, and what finds rows.
        "DROP TRIGGER history_is_not_changed".to_owned(),
        "DROP INDEX jobs_to_print".to_owned(),
        "CREATE TRIGGER later AFTER INSERT ON history BEGIN DELETE FROM claims; END".to_owned(),
    ];
    assert_all_show(changed.iter().map(String::as_str));
}

#[test]
fn whatever_record_is_changed_by_hand_shows() {
    let changed = [
        // Records that change nothing else: a doubt about a bed of which nothing is known.
        "DELETE FROM history WHERE seq = 2",
        "UPDATE history SET subject = 'printer right' WHERE seq = 2",
        "UPDATE history SET subject = (SELECT subject FROM history WHERE seq = 4) WHERE seq = 2",
        // The last one, with the head that goes with what is left.
        "DELETE FROM history WHERE seq = (SELECT max(seq) FROM history);
         UPDATE head SET seq = seq - 1, digest = (SELECT digest FROM history ORDER BY seq DESC LIMIT 1)",
        // A second job of the same name.
        "INSERT INTO history SELECT seq + 100, subject, body, digest FROM history WHERE seq = 4",
    ];
    let changed = changed.map(|sql| format!("{UNGUARDED} {sql}; {}", guards()));
    assert_all_show(changed.iter().map(String::as_str));
}

#[test]
fn a_head_that_was_kept_elsewhere_tells_what_the_file_alone_cannot() {
    let folder = busy();
    let head = |folder: &Folder| run(Folder::open(folder.dir()).head()).unwrap();
    let kept = head(&folder);
    let part = |folder: &Folder| {
        let store = Folder::open(folder.dir());
        run(store.verify_part(Progress::behind(kept)))
    };
    assert!(part(&folder).unwrap().is_some());
    // Somebody says the bed of a printer is in doubt, and takes that out again; then something else in its place.
    let doubted = run(async {
        let store = Folder::open(folder.dir());
        store.say(name("left"), Said::BedInDoubt, operator(8)).await.unwrap();
        store.say(name("left"), Said::BedInDoubt, operator(9)).await.unwrap();
        let head = store.head().await.unwrap();
        store.close().await;
        head
    });
    let cut = "DELETE FROM history WHERE seq = (SELECT max(seq) FROM history);
               UPDATE head SET seq = seq - 1, digest = (SELECT digest FROM history ORDER BY seq DESC LIMIT 1)";
    folder.by_hand(&format!("{UNGUARDED} {cut}; {}", guards()));
    let store = Folder::open(folder.dir());
    run(store.verify()).unwrap();
    let missing = run(store.verify_part(Progress::behind(doubted))).unwrap_err();
    let expected = Break::End { found: doubted.seq - 1, expected: doubted.seq };
    assert!(matches!(missing, Error::History(found) if found == expected));
    run(store.say(name("left"), Said::BedInDoubt, operator(10))).unwrap();
    run(store.verify()).unwrap();
    let other = run(store.verify_part(Progress::behind(doubted))).unwrap_err();
    assert!(matches!(other, Error::History(Break::Changed { seq }) if seq == doubted.seq));
}

#[test]
fn a_long_history_is_checked_in_parts_of_bounded_length() {
    const N_WORDS: u64 = 10_000;
    let folder = busy();
    let mut db = Db::open(&folder.db(), STEPS).unwrap();
    let said = db.write(|tx| {
        for _ in 0..N_WORDS {
            sql::say(tx, &name("left"), &Said::BedInDoubt, &operator(9))?;
        }
        Ok(())
    });
    said.unwrap();
    drop(db);
    let store = Folder::open(folder.dir());
    let mut n_parts = 0;
    let mut next = Some(Progress::default());
    while let Some(from) = next {
        next = run(store.verify_part(from)).unwrap();
        n_parts += 1;
        // Others go on meanwhile.
        run(store.say(name("left"), Said::BedInDoubt, operator(10))).unwrap();
    }
    // Chain and printer in three each, tables and the rest.
    assert!((10..=16).contains(&n_parts), "{n_parts}");
    let last = N_WORDS + 5;
    let changed = format!("UPDATE history SET body = replace(body, 'Ada', 'Eve') WHERE seq = {last}");
    folder.by_hand(&format!("{UNGUARDED} {changed}; {}", guards()));
    let found = run(store.verify()).unwrap_err();
    assert!(matches!(found, Error::History(Break::Changed { seq }) if seq == last), "{found}");
}

/// A job that is as it should be, but that nobody finds any more.
#[test]
fn an_index_that_lacks_a_row_shows() {
    let folder = Folder::with_jobs(3);
    let waits = |value: &str| format!("UPDATE jobs SET waits = {value} WHERE id = '{}'", id(2));
    folder.by_hand(&waits("NULL"));
    let index = "SELECT tbl_name, rootpage, sql FROM sqlite_schema WHERE name = 'jobs_to_print'";
    let db = Connection::open(folder.db()).unwrap();
    let (table, page, sql): (String, i64, String) =
        db.query_row(index, [], |row| Ok((row.get(0)?, row.get(1)?, row.get(2)?))).unwrap();
    drop(db);
    let hide = "DELETE FROM sqlite_schema WHERE name = 'jobs_to_print'";
    folder.by_hand(&format!("PRAGMA writable_schema = ON; {hide}"));
    folder.by_hand(&waits("'print'"));
    let sql = sql.replace('\'', "''");
    let show =
        format!("INSERT INTO sqlite_schema VALUES ('index', 'jobs_to_print', '{table}', {page}, '{sql}')");
    folder.by_hand(&format!("PRAGMA writable_schema = ON; {show}"));
    let found = run(Folder::open(folder.dir()).verify()).unwrap_err();
    assert!(matches!(&found, Error::Damaged { problem, .. } if problem.contains("jobs_to_print")), "{found}");
}
