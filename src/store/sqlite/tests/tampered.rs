//! Whatever is changed by hand shows.

use super::*;
use crate::queue::{Break, Subject};

const UNGUARDED: &str = "DROP TRIGGER history_is_not_changed; DROP TRIGGER history_is_not_cut;";

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
        let refused =
            db.execute_batch(&format!("PRAGMA recursive_triggers = ON; {sql}")).unwrap_err().to_string();
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
}
