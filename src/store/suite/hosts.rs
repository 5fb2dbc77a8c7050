//! Hosts that print until nothing is left, many at once: as threads, and as processes of their own.

use super::*;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

/// What was laid, line by line: `JOB COPY`. A printer's bed, which no crash takes away.
fn beds(dir: &Path) -> PathBuf {
    dir.join("beds.txt")
}

/// Lays a copy, and says so where it cannot be taken back.
fn lay(dir: &Path, job: &Job) {
    let mut file = std::fs::OpenOptions::new().create(true).append(true).open(beds(dir)).unwrap();
    file.write_all(format!("{} {}\n", job.id, job.n_printed + 1).as_bytes()).unwrap();
}

/// How often each copy was laid.
pub(super) fn laid(dir: &Path) -> BTreeMap<String, usize> {
    let mut n_laid = BTreeMap::new();
    for line in std::fs::read_to_string(beds(dir)).unwrap_or_default().lines() {
        *n_laid.entry(line.to_owned()).or_default() += 1;
    }
    n_laid
}

/// A host that prepares and prints until nothing is left.
pub(super) async fn print_all(store: &impl Store, dir: &Path, printer: &str) {
    load(store, printer).await;
    take_up(store, dir, printer).await;
    // What it held may have been cleared, or not have lain there yet.
    clear(store, printer, 1).await.unwrap();
    let worker = Claimant::Worker(name(printer));
    while let Some(Claimed { job, claim }) = store.claim(worker.clone(), at(2)).await.unwrap() {
        store.change(job.id, holds(&claim, Change::Prepared(made()), 2)).await.unwrap();
    }
    while let Some(Claimed { job, claim }) =
        store.claim(Claimant::Printer(name(printer)), at(2)).await.unwrap()
    {
        store.change(job.id, holds(&claim, Change::Lay, 3)).await.unwrap();
        lay(dir, &job);
        store.change(job.id, holds(&claim, Change::Printed { used_mm3: None }, 4)).await.unwrap();
        clear(store, printer, 5).await.unwrap();
    }
}

/// What a printer does with what it had when its appliance was killed: a print that had begun goes on by its journal.
async fn take_up(store: &impl Store, dir: &Path, printer: &str) {
    for Claimed { job, claim } in store.adopt(name(printer), at(1)).await.unwrap() {
        let change =
            if job.is_laid { Change::Printed { used_mm3: None } } else { Change::GiveBack { lost: false } };
        if job.is_laid && !laid(dir).contains_key(&format!("{} {}", job.id, job.n_printed + 1)) {
            lay(dir, &job);
        }
        store.change(job.id, holds(&claim, change, 1)).await.unwrap();
    }
}

/// That each copy of each job was laid once, and all is finished.
pub(super) async fn assert_all_printed_once(store: &impl Store, dir: &Path, n_jobs: u16, copies: u16) {
    let expected: BTreeMap<_, _> = (1..=n_jobs)
        .flat_map(|job| (1..=copies).map(move |copy| (format!("{} {copy}", id(job)), 1)))
        .collect();
    assert_eq!(laid(dir), expected);
    assert_eq!(live(store).await, []);
    let over = store.list(Which::Over, None, u32::MAX).await.unwrap();
    assert_eq!(over.len(), usize::from(n_jobs));
    assert!(over.iter().all(|job| job.state == State::Finished && job.n_printed == copies));
    store.verify().await.unwrap();
}

async fn with_copies<T: Site>(site: &T, n_jobs: u16, copies: u16) -> T::Store {
    let store = T::open(site.dir());
    for number in 1..=n_jobs {
        let wishes = Wishes { copies, ..Wishes::default() };
        store.add(Ticket { wishes, ..ticket(number) }, true, operator(0)).await.unwrap();
    }
    store
}

pub(in crate::store) async fn each_copy_is_printed_once_by_many_threads<T: Site>(site: &T) {
    let store = with_copies(site, 12, 2).await;
    let dir = site.dir();
    std::thread::scope(|scope| {
        for printer in ["a", "b", "c", "d"] {
            scope.spawn(move || run(print_all(&T::open(dir), dir, printer)));
        }
    });
    // A job whose copy was in print when the others found nothing more.
    print_all(&store, site.dir(), "a").await;
    assert_all_printed_once(&store, site.dir(), 12, 2).await;
}

pub(in crate::store) async fn each_copy_is_printed_once_by_many_processes<T: Site>(site: &T) {
    let store = with_copies(site, 12, 2).await;
    let children = ["a", "b", "c", "d"].map(|printer| spawn::<T>(site.dir(), &format!("print {printer}")));
    for child in children {
        ends_well(child);
    }
    assert!(laid(site.dir()).len() >= 12, "the processes did not print");
    print_all(&store, site.dir(), "a").await;
    assert_all_printed_once(&store, site.dir(), 12, 2).await;
}

const TASK: &str = "LUMENFAB_TEST_STORE_TASK";
const DIR: &str = "LUMENFAB_TEST_STORE_DIR";

/// This program again, with a task.
pub(in crate::store) fn again<T: Site>(dir: &Path, task: &str) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args([T::CHILD, "--exact", "--nocapture"]).env(TASK, task).env(DIR, dir);
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// What a process says when it has done what it was told: a name of a test that is not there does nothing, and ends well, too.
const DONE: &str = "the task is done";

pub(in crate::store) fn say_done() {
    writeln!(std::io::stdout(), "{DONE}").unwrap();
}

pub(super) fn spawn<T: Site>(dir: &Path, task: &str) -> Child {
    again::<T>(dir, task).spawn().unwrap()
}

#[track_caller]
pub(in crate::store) fn ends_well(child: Child) {
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(String::from_utf8_lossy(&output.stdout).contains(DONE), "nothing was done: {said}");
}

/// What this process is told to do; nothing unless it was told.
pub(in crate::store) fn child<T: Site>() {
    let (Ok(task), Some(dir)) = (std::env::var(TASK), std::env::var_os(DIR)) else { return };
    let dir = PathBuf::from(dir);
    match task.split_once(' ').unwrap_or((&task, "")) {
        ("print", printer) => run(print_all(&T::open(&dir), &dir, printer)),
        ("fill", _) => run(fill(&T::open(&dir))),
        // It is told what to do by other names.
        ("", _) => return,
        other => panic!("no such task: {other:?}"),
    }
    say_done();
}

/// Adds jobs until the store refuses; that has to be for want of room, and nothing that was answered may be lost.
async fn fill(store: &impl Store) {
    let wide = Spec::try_new(SpecKind::Mesh, vec![7; 1 << 14]).unwrap();
    for number in 1..=u16::MAX {
        let added = store.add(Ticket { spec: wide.clone(), ..ticket(number) }, true, operator(0)).await;
        let Err(error) = added else { continue };
        assert!(matches!(error, Error::Full { .. } | Error::Io { .. }), "{error}");
        eprintln!("{error}");
        assert_eq!(live(store).await.len(), usize::from(number - 1).min(1000));
        store.verify().await.unwrap();
        assert!(number > 1, "found room for no job at all");
        return;
    }
    panic!("the disk was never full");
}
