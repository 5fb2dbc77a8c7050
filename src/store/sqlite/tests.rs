//! The suite, and what only a file can go through.

mod disk;
mod statements;
mod tampered;

use super::open::{APPLICATION_ID, STEPS};
use super::*;
use crate::queue::tests::{at, id, name, operator, ticket};
use crate::queue::{Actor, Change, Claim, Claimant, Reason, Request, Said, State, Subject, Ticket};
use crate::store::suite::{self, Site, run};
use crate::store::{Place, Progress, Store, Which};
use rusqlite::Connection;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;

/// A folder with the database in it.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn db(&self) -> PathBuf {
        self.dir().join("queue.db")
    }

    /// With so many jobs, and nobody who has it open.
    fn with_jobs(n_jobs: u16) -> Self {
        let folder = Self::new();
        run(async {
            let store = Self::open(folder.dir());
            for number in 1..=n_jobs {
                store.add(ticket(number), true, operator(0)).await.unwrap();
            }
            store.close().await;
        });
        folder
    }

    /// Another program's hand on the file.
    fn by_hand(&self, sql: &str) {
        Connection::open(self.db()).unwrap().execute_batch(sql).unwrap();
    }

    #[track_caller]
    fn refused(&self) -> Error {
        Sqlite::open(&self.db()).expect_err("it must not be opened")
    }
}

impl Site for Folder {
    type Store = Sqlite;
    const CHILD: &'static str = "store::sqlite::tests::child";

    fn fresh() -> Option<Self> {
        Some(Self::new())
    }

    fn dir(&self) -> &Path {
        self.0.path()
    }

    fn open(dir: &Path) -> Sqlite {
        Sqlite::open(&dir.join("queue.db")).unwrap()
    }
}

suite::every_behaviour!(Folder);

/// Not a test by itself: what processes of their own do.
#[test]
fn child() {
    disk::child();
    suite::child::<Folder>();
}

/// The whole number; a sample is in the suite.
#[test]
#[ignore = "takes minutes"]
fn five_hundred_kills_lose_nothing_and_print_nothing_twice() {
    run(suite::kills(&Folder::new(), 500));
}

#[test]
fn the_file_is_its_owners_alone() {
    let folder = Folder::new();
    let store = Folder::open(folder.dir());
    run(store.add(ticket(1), true, operator(0))).unwrap();
    for file in ["queue.db", "queue.db-wal"] {
        let mode = fs::metadata(folder.dir().join(file)).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600, "{file}");
    }
}

#[test]
fn what_is_closed_is_one_file_and_refuses_further_calls() {
    let folder = Folder::with_jobs(3);
    let store = Folder::open(folder.dir());
    let other = store.clone();
    run(async {
        store.add(ticket(4), true, operator(0)).await.unwrap();
        store.close().await;
        assert!(matches!(other.head().await, Err(Error::Gone)));
    });
    let files: Vec<_> = fs::read_dir(folder.dir()).unwrap().map(|file| file.unwrap().file_name()).collect();
    assert_eq!(files, ["queue.db"]);
    let again = Folder::open(folder.dir());
    assert_eq!(run(again.list(Which::Live, None, 10)).unwrap().len(), 4);
}

#[test]
fn many_may_open_a_new_file_at_once() {
    let folder = Folder::new();
    std::thread::scope(|scope| {
        for number in 1..=8 {
            let folder = &folder;
            scope.spawn(move || {
                run(Folder::open(folder.dir()).add(ticket(number), true, operator(0))).unwrap()
            });
        }
    });
    let store = Folder::open(folder.dir());
    assert_eq!(run(store.list(Which::Live, None, 10)).unwrap().len(), 8);
    run(store.verify()).unwrap();
}

#[test]
fn other_files_are_refused_and_left_as_they_are() {
    let folder = Folder::new();
    folder.by_hand("CREATE TABLE songs (title TEXT)");
    let before = fs::read(folder.db()).unwrap();
    let said = folder.refused().to_string();
    assert!(said.contains("queue.db: found a database of another program"), "{said}");
    assert_eq!(fs::read(folder.db()).unwrap(), before);

    fs::write(folder.db(), "Dear diary, ".repeat(100)).unwrap();
    assert!(matches!(folder.refused(), Error::NotADatabase { .. }));
    assert_eq!(fs::read(folder.db()).unwrap().len(), 1200);

    let missing = Sqlite::open(&folder.dir().join("none/queue.db")).unwrap_err().to_string();
    assert!(missing.contains("none/queue.db: No such file or directory"), "{missing}");
}

#[test]
fn a_later_versions_file_is_refused_and_left_as_it_is() {
    let folder = Folder::with_jobs(1);
    folder.by_hand("PRAGMA user_version = 99");
    let before = fs::read(folder.db()).unwrap();
    let refused = folder.refused();
    let said = refused.to_string();
    let known = STEPS.len();
    assert!(said.contains(&format!(
        "found version 99 of the queue's format, this program knows versions up to {known}"
    )));
    assert_eq!((refused.code(), fs::read(folder.db()).unwrap()), ("store.newer", before));
}

#[test]
fn a_file_that_a_later_version_takes_over_is_not_written_any_more() {
    let folder = Folder::with_jobs(1);
    let store = Folder::open(folder.dir());
    folder.by_hand("PRAGMA user_version = 99");
    let refused = run(store.add(ticket(2), true, operator(0))).unwrap_err();
    assert_eq!(refused.code(), "store.newer");
    assert_eq!(run(store.head()).unwrap_err().code(), "store.newer");
}

#[test]
fn a_file_that_is_replaced_while_it_is_open_is_not_written_any_more() {
    let folder = Folder::with_jobs(1);
    let backup = folder.dir().join("backup.db");
    fs::copy(folder.db(), &backup).unwrap();
    let store = Folder::open(folder.dir());
    run(store.add(ticket(2), true, operator(0))).unwrap();
    fs::rename(&backup, folder.db()).unwrap();
    let said = run(store.add(ticket(3), true, operator(0))).unwrap_err().to_string();
    assert!(said.contains("queue.db: the file was taken away or replaced while it was open"), "{said}");
    fs::remove_file(folder.db()).unwrap();
    assert_eq!(run(store.head()).unwrap_err().code(), "store.io");
}

#[test]
fn a_damaged_file_is_refused() {
    let folder = Folder::with_jobs(200);
    let mut bytes = fs::read(folder.db()).unwrap();
    let n_bytes = bytes.len();
    for byte in &mut bytes[n_bytes / 2..n_bytes / 2 + 8192] {
        *byte = 0xa5;
    }
    fs::write(folder.db(), bytes).unwrap();
    let refused = folder.refused();
    assert!(matches!(refused, Error::Damaged { .. }), "{refused}");
}

#[test]
fn what_another_program_keeps_to_itself_can_be_opened_and_read() {
    let folder = Folder::with_jobs(3);
    let other = Connection::open(folder.db()).unwrap();
    other.execute_batch("BEGIN IMMEDIATE").unwrap();
    let store = Folder::open(folder.dir());
    assert_eq!(run(store.list(Which::Live, None, 10)).unwrap().len(), 3);
    let refused = run(store.add(ticket(4), true, operator(0))).unwrap_err();
    assert_eq!(refused.code(), "store.locked");
    other.execute_batch("COMMIT").unwrap();
    run(store.add(ticket(4), true, operator(0))).unwrap();
}

#[test]
fn each_step_is_done_once_and_whole() {
    let folder = Folder::with_jobs(2);
    let version = |db: &Db| -> (i64, i64) {
        let pragma = |name| db.connection.pragma_query_value(None, name, |row| row.get(0)).unwrap();
        (pragma("user_version"), pragma("application_id"))
    };
    let n_steps = i64::try_from(STEPS.len()).unwrap();
    let half = "CREATE TABLE extra (a INTEGER) STRICT; INSERT INTO nowhere VALUES (1)";
    let broken = [STEPS, &[half]].concat();
    let said = Db::open(&folder.db(), &broken).unwrap_err().to_string();
    assert!(said.contains("no such table: nowhere"), "{said}");
    let before = Db::open(&folder.db(), STEPS).unwrap();
    assert_eq!(version(&before), (n_steps, APPLICATION_ID));
    let tables = "SELECT count(*) FROM sqlite_schema WHERE name = 'extra'";
    let n_tables = |db: &Db| db.connection.query_row(tables, [], |row| row.get::<_, i64>(0)).unwrap();
    assert_eq!(n_tables(&before), 0);
    drop(before);
    let good = [STEPS, &["CREATE TABLE extra (a INTEGER) STRICT"]].concat();
    for _ in 0..2 {
        let db = Db::open(&folder.db(), &good).unwrap();
        assert_eq!((version(&db).0, n_tables(&db)), (n_steps + 1, 1));
    }
    assert!(matches!(Sqlite::open(&folder.db()), Err(Error::Newer { .. })));
}
