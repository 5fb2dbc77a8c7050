//! A full disk, a read-only one, a database that another program keeps locked.

#![expect(clippy::print_stderr, reason = "what could not be tested is said")]

use super::*;
use crate::store::sql::Sql as _;
use crate::store::suite::{again, ends_well, say_done};
use std::process::{Command, Stdio};

const CODE: &str = "LUMENFAB_TEST_STORE_CODE";
const DB: &str = "LUMENFAB_TEST_STORE_DB";

/// What a process of its own does here: opens a file that cannot be opened for the reason it was told.
pub(super) fn child() {
    let (Ok(code), Some(db)) = (std::env::var(CODE), std::env::var_os(DB)) else { return };
    let refused = Sqlite::open(Path::new(&db)).unwrap_err();
    assert_eq!(refused.code(), code, "{refused}");
    say_done();
}

/// A command, run by a shell that prepares something first; `None` where this machine does not let it.
fn prepared(wrapper: &[&str], preparation: &str, command: &Command) -> Option<Command> {
    let shell = |script: &str| {
        let mut shell = Command::new(wrapper[0]);
        shell.args(&wrapper[1..]).args(["sh", "-c", script]);
        shell
    };
    let tried = shell(preparation).stderr(Stdio::null()).status();
    if !tried.is_ok_and(|status| status.success()) {
        eprintln!("not tested: `{preparation}` is not possible here");
        return None;
    }
    let mut prepared = shell(&format!("{preparation} && exec \"$0\" \"$@\""));
    prepared.arg(command.get_program()).args(command.get_args());
    prepared.envs(command.get_envs().filter_map(|(key, value)| Some((key, value?))));
    prepared.stdout(Stdio::piped()).stderr(Stdio::piped());
    Some(prepared)
}

#[test]
fn a_full_disk_is_said_and_loses_nothing() {
    let folder = Folder::new();
    let fill = again::<Folder>(folder.dir(), "fill");
    let mount = format!("mount -t tmpfs -o size=600k none '{}'", folder.dir().display());
    if let Some(mut command) = prepared(&["unshare", "-m"], &mount, &fill) {
        ends_well(command.spawn().unwrap());
    }
    // Files of the queue may grow to so many blocks of 512 bytes.
    let limited = prepared(&["env"], "trap '' XFSZ; ulimit -f 1000", &fill);
    ends_well(limited.expect("any shell can limit files").spawn().unwrap());
    let store = Folder::open(folder.dir());
    run(async {
        store.verify().await.unwrap();
        let n_before = store.list(Which::Live, None, 10_000).await.unwrap().len();
        assert!(n_before > 0);
        store.add(ticket(9999), true, operator(0)).await.unwrap();
        assert_eq!(store.list(Which::Live, None, 10_000).await.unwrap().len(), n_before + 1);
    });
}

#[test]
fn a_read_only_disk_is_said() {
    let folder = Folder::with_jobs(1);
    let dir = folder.dir().display().to_string();
    let open = |db: PathBuf| {
        let mut command = again::<Folder>(folder.dir(), "");
        command.env(CODE, "store.read_only").env(DB, db);
        command
    };
    let mount = format!("mount --bind '{dir}' '{dir}' && mount -o remount,ro,bind '{dir}'");
    for file in ["queue.db", "new.db"] {
        if let Some(mut command) = prepared(&["unshare", "-m"], &mount, &open(folder.dir().join(file))) {
            ends_well(command.spawn().unwrap());
        }
    }
    run(Folder::open(folder.dir()).verify()).unwrap();
}

#[test]
fn a_database_that_another_program_locks_is_waited_for_and_then_said() {
    let folder = Folder::with_jobs(1);
    let store = Folder::open(folder.dir());
    let other = Connection::open(folder.db()).unwrap();
    other.execute_batch("BEGIN IMMEDIATE").unwrap();
    run(async {
        let refused = store.add(ticket(2), true, operator(0)).await.unwrap_err();
        let said = refused.to_string();
        assert_eq!(refused.code(), "store.locked");
        assert!(said.contains("queue.db: another program has kept it locked for 5 s"), "{said}");
        // Who only reads is not held up.
        assert_eq!(store.list(Which::Live, None, 9).await.unwrap().len(), 1);
        other.execute_batch("COMMIT").unwrap();
        store.add(ticket(2), true, operator(0)).await.unwrap();
        store.verify().await.unwrap();
    });
}

/// How long the thread that writes would wait for another program, ms.
async fn patience_ms(store: &Sqlite) -> i64 {
    let asked = store.on_thread(|db| {
        let ms = db.connection.pragma_query_value(None, "busy_timeout", |row| row.get(0));
        ms.map_err(|_unreadable| Error::Gone)
    });
    asked.await.unwrap()
}

#[test]
fn only_the_first_waits_for_a_program_that_keeps_the_database_locked() {
    let folder = Folder::with_jobs(1);
    let store = Folder::open(folder.dir());
    let other = Connection::open(folder.db()).unwrap();
    other.execute_batch("BEGIN IMMEDIATE").unwrap();
    run(async {
        assert_eq!(patience_ms(&store).await, 5000);
        for _ in 0..2 {
            let refused = store.add(ticket(2), true, operator(0)).await.unwrap_err();
            assert_eq!(refused.code(), "store.locked");
            assert_eq!(patience_ms(&store).await, 50);
        }
        other.execute_batch("COMMIT").unwrap();
        store.add(ticket(2), true, operator(0)).await.unwrap();
        assert_eq!(patience_ms(&store).await, 5000);
    });
}

#[test]
fn whoever_looks_does_not_wait_behind_those_who_cannot_write() {
    let folder = Folder::with_jobs(1);
    let store = Folder::open(folder.dir());
    let other = Connection::open(folder.db()).unwrap();
    other.execute_batch("BEGIN IMMEDIATE").unwrap();
    run(async {
        let write = |number| {
            let store = store.clone();
            tokio::spawn(async move { store.add(ticket(number), true, operator(0)).await })
        };
        let writes: Vec<_> = (2..14).map(write).collect();
        tokio::task::yield_now().await;
        store.head().await.unwrap();
        assert_eq!(store.list(Which::Live, None, 9).await.unwrap().len(), 1);
        assert!(writes.iter().all(|write| !write.is_finished()), "somebody who writes was waited for");
        for write in writes {
            assert_eq!(write.await.unwrap().unwrap_err().code(), "store.locked");
        }
    });
}

#[test]
fn a_fault_of_this_program_changes_nothing_and_the_queue_lives_on() {
    let folder = Folder::with_jobs(1);
    let store = Folder::open(folder.dir());
    run(async {
        let broken = store.on_thread(|db| -> Result<(), Error> {
            db.write(|tx| {
                tx.run("UPDATE jobs SET urgency = 99", &[])?;
                panic!("as asked for");
            })
        });
        assert_eq!(broken.await.unwrap_err().code(), "store.panicked");
        store.verify().await.unwrap();
        store.add(ticket(2), true, operator(0)).await.unwrap();
    });
}
