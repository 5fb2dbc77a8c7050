//! What every store has to do: one suite, for each of them.
//!
//! A [`Site`] is a place where a store is kept: it can be opened again and by others, also in processes of their own. These are this
//! very program, told by the environment what to do ([`child`]).

use super::{Claimed, Error, Place, Store, Which};
use crate::queue::tests::{at, because, id, loaded, made, name, operator, ticket};
use crate::queue::*;
use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// Where a store is kept.
pub(super) trait Site: Sized {
    /// The store.
    type Store: Store;
    /// The test that calls [`child`] for this kind of store.
    const CHILD: &'static str;

    /// A place where nothing is yet.
    fn fresh() -> Self;
    /// A folder for what the tests write beside.
    fn dir(&self) -> &Path;
    /// The store that is kept in a folder.
    fn open(dir: &Path) -> Self::Store;
}

/// Runs something to its end on this thread.
pub(super) fn run<T>(work: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap().block_on(work)
}

/// Every behaviour as a test of its own.
macro_rules! suite {
    ($site:ty: $($behaviour:ident),* $(,)?) => {
        $(
            #[test]
            fn $behaviour() {
                let site = <$site as $crate::store::suite::Site>::fresh();
                $crate::store::suite::run($crate::store::suite::$behaviour(&site));
            }
        )*
    };
}
pub(super) use suite;

/// All of them.
macro_rules! every_behaviour {
    ($site:ty) => {
        $crate::store::suite::suite! { $site:
            a_ticket_is_added_once,
            a_job_goes_its_whole_way,
            jobs_are_taken_by_priority_and_place,
            listings_go_on_where_they_ended,
            a_job_waits_for_its_time_also_when_the_clock_is_set_back,
            held_jobs_and_those_that_do_not_fit_are_passed_over,
            an_unknown_printer_and_an_uncleared_bed_take_nothing,
            what_was_seen_has_to_be_so_still,
            a_refusal_changes_nothing,
            a_lapsed_claim_is_taken_away_where_nothing_was_laid,
            a_claim_of_a_clock_that_was_ahead_lapses_in_one_lease,
            whoever_comes_back_takes_up_what_it_had,
            each_copy_is_printed_once_by_many_threads,
            each_copy_is_printed_once_by_many_processes,
            whatever_happens_history_and_state_are_one,
            a_kill_at_any_moment_loses_nothing_and_prints_nothing_twice,
        }
    };
}
pub(super) use every_behaviour;

// ---------------------------------------------------------------- what the tests do over and over

fn printer() -> Claimant {
    Claimant::Printer(name("left"))
}

fn sees(saw: State) -> Actor {
    Actor::Operator { name: name("Ada"), saw }
}

fn asks(change: Change, saw: State, seconds: i64) -> Request {
    Request { change, actor: sees(saw), why: because("so"), now: at(seconds) }
}

fn holds(claim: &Claim, change: Change, seconds: i64) -> Request {
    let actor = Actor::Holder { claim: claim.clone(), asked_by: None };
    Request { change, actor, why: because("so"), now: at(seconds) }
}

async fn load(store: &impl Store, printer: &str) {
    let loaded = Loaded { left_mm3: None, ..loaded() };
    store.say(name(printer), Said::Loaded(loaded), operator(0)).await.unwrap();
}

async fn clear(store: &impl Store, printer: &str, seconds: i64) -> Result<Printer, Error> {
    store.say(name(printer), Said::BedClear(Evidence::Word), operator(seconds)).await
}

/// A store with a printer that is ready, and so many jobs.
async fn with_jobs<T: Site>(site: &T, n_jobs: u16) -> T::Store {
    let store = T::open(site.dir());
    load(&store, "left").await;
    clear(&store, "left", 0).await.unwrap();
    for number in 1..=n_jobs {
        store.add(ticket(number), true, operator(0)).await.unwrap();
    }
    store
}

async fn taken(store: &impl Store, seconds: i64) -> Option<Claimed> {
    store.claim(printer(), at(seconds)).await.unwrap()
}

/// Prints what is next to its end and clears the bed.
async fn print_next(store: &impl Store, seconds: i64) -> Option<JobId> {
    let Claimed { job, claim } = taken(store, seconds).await?;
    store.change(job.id, holds(&claim, Change::Lay, seconds)).await.unwrap();
    store.change(job.id, holds(&claim, Change::Printed { used_mm3: None }, seconds)).await.unwrap();
    clear(store, "left", seconds).await.unwrap();
    Some(job.id)
}

fn refusal<T: std::fmt::Debug>(result: Result<T, Error>) -> Refusal {
    match result {
        Err(Error::Refused(refusal)) => refusal,
        other => panic!("found {other:?}, expected a refusal"),
    }
}

async fn state(store: &impl Store, number: u16) -> State {
    store.job(id(number)).await.unwrap().0.state
}

async fn live(store: &impl Store) -> Vec<JobId> {
    store.list(Which::Live, None, 1000).await.unwrap().iter().map(|job| job.id).collect()
}

fn ids(numbers: &[u16]) -> Vec<JobId> {
    numbers.iter().map(|&number| id(number)).collect()
}

// ---------------------------------------------------------------- behaviours

pub(super) async fn a_ticket_is_added_once<T: Site>(site: &T) {
    let store = with_jobs(site, 1).await;
    let again = store.add(ticket(1), true, operator(5)).await.unwrap();
    assert_eq!((again.added, again.state), (at(0), State::Queued));
    let other = Ticket { spec: ticket(2).spec, ..ticket(1) };
    assert_eq!(refusal(store.add(other, true, operator(5)).await), Refusal::IdTaken { id: id(1) });
    assert_eq!(store.spec(id(1)).await.unwrap(), ticket(1).spec);
    let none = Ticket { wishes: Wishes { copies: 0, ..Wishes::default() }, ..ticket(2) };
    assert_eq!(refusal(store.add(none, true, operator(5)).await), Refusal::Copies { found: 0, least: 1 });
    assert_eq!(live(&store).await, ids(&[1]));
    store.verify().await.unwrap();
}

pub(super) async fn a_job_goes_its_whole_way<T: Site>(site: &T) {
    let store = with_jobs(site, 0).await;
    let wishes = Wishes { copies: 2, sign_off: true, ..Wishes::default() };
    store.add(Ticket { wishes, made: None, ..ticket(1) }, false, operator(0)).await.unwrap();
    assert!(taken(&store, 1).await.is_none());
    store.change(id(1), asks(Change::Submit, State::Draft, 1)).await.unwrap();
    assert!(taken(&store, 1).await.is_none());
    let worker = Claimant::Worker(name("worker"));
    let Claimed { claim, .. } = store.claim(worker.clone(), at(2)).await.unwrap().unwrap();
    assert_eq!(store.claim(worker, at(2)).await.unwrap(), None);
    store.change(id(1), holds(&claim, Change::Prepared(made()), 3)).await.unwrap();
    assert_eq!(print_next(&store, 4).await, Some(id(1)));
    assert_eq!(print_next(&store, 5).await, Some(id(1)));
    assert_eq!(print_next(&store, 6).await, None);
    store.change(id(1), asks(Change::Accept, State::AwaitingSignOff, 7)).await.unwrap();
    assert_eq!(state(&store, 1).await, State::Finished);
    let records = store.history(Some(Subject::Job(id(1))), 0, 100).await.unwrap();
    let kinds: Vec<_> = records.iter().filter_map(|sealed| kind_of(&sealed.record().unwrap())).collect();
    let copy = [Kind::Start, Kind::Lay, Kind::Printed];
    let expected = [
        &[Kind::Submit, Kind::Prepare, Kind::Prepared][..],
        &copy[..],
        &[Kind::NextCopy],
        &copy,
        &[Kind::AskSignOff, Kind::Accept],
    ];
    assert_eq!(kinds, expected.concat());
    store.verify().await.unwrap();
}

fn kind_of(record: &Record) -> Option<Kind> {
    match &record.fact.what {
        What::Job { change, .. } => Some(change.kind()),
        What::Added { .. } | What::Printer { .. } => None,
    }
}

pub(super) async fn jobs_are_taken_by_priority_and_place<T: Site>(site: &T) {
    let store = with_jobs(site, 5).await;
    let place = async |number, place| {
        let moved = store.place(id(number), place, sees(State::Queued), Reason::default(), at(1)).await;
        moved.unwrap();
    };
    place(5, Place::First).await;
    place(1, Place::Behind(id(2))).await;
    place(4, Place::Before(id(1))).await;
    place(2, Place::Last).await;
    place(3, Place::Before(id(3))).await;
    assert_eq!(live(&store).await, ids(&[5, 4, 1, 3, 2]));
    let urgent = Change::Edit(Edit::Priority(3));
    store.change(id(3), asks(urgent, State::Queued, 2)).await.unwrap();
    store.change(id(5), asks(Change::Edit(Edit::Priority(-1)), State::Queued, 2)).await.unwrap();
    assert_eq!(live(&store).await, ids(&[3, 4, 1, 2, 5]));
    let mut printed = Vec::new();
    while let Some(job) = print_next(&store, 10).await {
        printed.push(job);
    }
    assert_eq!(printed, ids(&[3, 4, 1, 2, 5]));
    let over: Vec<_> = store.list(Which::Over, None, 9).await.unwrap().iter().map(|job| job.id).collect();
    assert_eq!(over, ids(&[5, 2, 1, 4, 3]));
    store.verify().await.unwrap();
}

pub(super) async fn listings_go_on_where_they_ended<T: Site>(site: &T) {
    let store = with_jobs(site, 7).await;
    for number in [1, 2, 3] {
        store.change(id(number), asks(Change::Cancel { used_mm3: None }, State::Queued, 1)).await.unwrap();
    }
    let page = async |which, behind| -> Vec<JobId> {
        store.list(which, behind, 2).await.unwrap().iter().map(|job| job.id).collect()
    };
    assert_eq!(page(Which::Live, None).await, ids(&[4, 5]));
    assert_eq!(page(Which::Live, Some(id(5))).await, ids(&[6, 7]));
    assert_eq!(page(Which::Live, Some(id(7))).await, []);
    assert_eq!(page(Which::Over, None).await, ids(&[3, 2]));
    assert_eq!(page(Which::Over, Some(id(2))).await, ids(&[1]));
    assert_eq!(refusal(store.list(Which::Over, Some(id(9)), 2).await), Refusal::NoJob { id: id(9) });
    let all = store.history(None, 0, 1000).await.unwrap();
    assert_eq!(store.history(None, all[4].seq, 2).await.unwrap(), all[5..7]);
    assert_eq!(store.head().await.unwrap(), all.last().unwrap().head());
    assert_eq!(history::verify(&all, store.head().await.unwrap()), Ok(()));
}

pub(super) async fn a_job_waits_for_its_time_also_when_the_clock_is_set_back<T: Site>(site: &T) {
    let store = with_jobs(site, 0).await;
    let wishes = |seconds| Wishes { not_before: Some(at(seconds)), ..Wishes::default() };
    store.add(Ticket { wishes: wishes(4000), ..ticket(1) }, true, operator(0)).await.unwrap();
    store.add(Ticket { wishes: wishes(9000), ..ticket(2) }, true, operator(0)).await.unwrap();
    assert_eq!(taken(&store, 3999).await, None);
    // The time comes while the bed is not clear; then the clock is set back an hour.
    let claimed = taken(&store, 4000).await.unwrap();
    store.change(id(1), holds(&claimed.claim, Change::GiveBack { lost: false }, 4001)).await.unwrap();
    assert_eq!(taken(&store, 401).await, None);
    assert_eq!(taken(&store, 3999).await, None);
    assert_eq!(print_next(&store, 4000).await, Some(id(1)));
    assert_eq!(print_next(&store, 8999).await, None);
    let now = Change::Edit(Edit::NotBefore(None));
    store.change(id(2), asks(now, State::Queued, 9)).await.unwrap();
    assert_eq!(print_next(&store, 10).await, Some(id(2)));
    store.verify().await.unwrap();
}

pub(super) async fn held_jobs_and_those_that_do_not_fit_are_passed_over<T: Site>(site: &T) {
    let store = with_jobs(site, 1).await;
    store.change(id(1), asks(Change::Hold, State::Queued, 1)).await.unwrap();
    let with = |change: fn(&mut Made)| {
        let mut made = made();
        change(&mut made);
        Some(made)
    };
    let others = [
        with(|made| made.needs.material = Material::try_new("PLA").ok()),
        with(|made| made.needs.nozzle_um = Some(250)),
        with(|made| made.needs.profile = Name::try_new("marlin").ok()),
        with(|made| made.estimate.filament_mm3 = 100_001),
        with(|made| made.needs.material = Material::try_new("abs").ok()),
    ];
    for (number, made) in (2..).zip(others) {
        store.add(Ticket { made, ..ticket(number) }, true, operator(1)).await.unwrap();
    }
    store.say(name("left"), Said::Loaded(loaded()), operator(2)).await.unwrap();
    assert_eq!(print_next(&store, 3).await, Some(id(6)));
    assert_eq!(taken(&store, 4).await, None);
    // 10 cm³ were used up.
    assert_eq!(store.printers().await.unwrap()[0].loaded.as_ref().unwrap().left_mm3, Some(90_000));
    load(&store, "left").await;
    assert_eq!(print_next(&store, 5).await, Some(id(5)));
    store.change(id(1), asks(Change::Release, State::Held, 6)).await.unwrap();
    assert_eq!(print_next(&store, 7).await, Some(id(1)));
    store.verify().await.unwrap();
}

pub(super) async fn an_unknown_printer_and_an_uncleared_bed_take_nothing<T: Site>(site: &T) {
    let store = with_jobs(site, 2).await;
    let unknown = store.claim(Claimant::Printer(name("right")), at(1)).await;
    assert_eq!(refusal(unknown), Refusal::NoPrinter { printer: name("right") });
    let not_clear = Refusal::BedNotClear { printer: name("left") };
    store.say(name("left"), Said::BedInDoubt, operator(2)).await.unwrap();
    assert_eq!(refusal(store.claim(printer(), at(3)).await), not_clear);
    clear(&store, "left", 4).await.unwrap();
    let Claimed { job, claim } = taken(&store, 5).await.unwrap();
    assert_eq!(refusal(store.claim(printer(), at(5)).await), not_clear);
    let in_use = Refusal::BedInUse { printer: name("left"), job: id(1) };
    assert_eq!(refusal(clear(&store, "left", 6).await), in_use);
    store.change(job.id, holds(&claim, Change::Lay, 7)).await.unwrap();
    store.change(job.id, holds(&claim, Change::Fail { used_mm3: None }, 8)).await.unwrap();
    assert_eq!(refusal(store.claim(printer(), at(9)).await), not_clear);
    clear(&store, "left", 10).await.unwrap();
    assert_eq!(state(&store, 1).await, State::Failed);
    assert_eq!(print_next(&store, 11).await, Some(id(2)));
    store.verify().await.unwrap();
}

pub(super) async fn what_was_seen_has_to_be_so_still<T: Site>(site: &T) {
    let store = with_jobs(site, 1).await;
    let held = asks(Change::Hold, State::Queued, 1);
    store.change(id(1), held.clone()).await.unwrap();
    let refused = refusal(store.change(id(1), held).await);
    assert_eq!(refused, Refusal::ChangedMeanwhile { saw: State::Queued, found: State::Held });
    let missing = store.change(id(9), asks(Change::Hold, State::Queued, 1)).await;
    assert_eq!(refusal(missing), Refusal::NoJob { id: id(9) });
    let by_hand = Change::Edit(Edit::Rank(store.job(id(1)).await.unwrap().0.rank));
    assert_eq!(refusal(store.change(id(1), asks(by_hand, State::Held, 2)).await), Refusal::PlaceByHand);
}

pub(super) async fn a_refusal_changes_nothing<T: Site>(site: &T) {
    let store = with_jobs(site, 1).await;
    let Claimed { claim, .. } = taken(&store, 1).await.unwrap();
    let before = (store.head().await.unwrap(), store.job(id(1)).await.unwrap());
    let other = Claim { token: claim.token + 1, ..claim.clone() };
    for refused in [
        holds(&other, Change::Lay, 2),
        holds(&claim, Change::Printed { used_mm3: None }, 2),
        holds(&claim, Change::Start { printer: name("left") }, 2),
        asks(Change::Cancel { used_mm3: None }, State::Printing, 2),
    ] {
        refusal(store.change(id(1), refused).await);
    }
    assert_eq!((store.head().await.unwrap(), store.job(id(1)).await.unwrap()), before);
}

pub(super) async fn a_lapsed_claim_is_taken_away_where_nothing_was_laid<T: Site>(site: &T) {
    let store = with_jobs(site, 2).await;
    load(&store, "right").await;
    clear(&store, "right", 0).await.unwrap();
    let first = taken(&store, 0).await.unwrap();
    let second = store.claim(Claimant::Printer(name("right")), at(0)).await.unwrap().unwrap();
    store.change(second.job.id, holds(&second.claim, Change::Lay, 1)).await.unwrap();
    assert_eq!(store.sweep(at(claim::LEASE_S - 1)).await.unwrap(), []);
    let renewed = store.renew(first.claim.clone(), at(30)).await.unwrap();
    assert_eq!(store.sweep(at(claim::LEASE_S)).await.unwrap(), []);
    assert!(renewed.until > first.claim.until);
    let swept = store.sweep(at(30 + claim::LEASE_S)).await.unwrap();
    assert_eq!(swept.iter().map(|job| job.id).collect::<Vec<_>>(), [first.job.id]);
    assert_eq!((state(&store, 1).await, state(&store, 2).await), (State::Queued, State::Printing));
    assert_eq!(refusal(store.renew(first.claim.clone(), at(91)).await), Refusal::ClaimLost);
    let late = store.change(id(1), holds(&first.claim, Change::Lay, 91)).await;
    assert_eq!(refusal(late), Refusal::ClaimLost);
    let again = taken(&store, 92).await.unwrap();
    assert_eq!((again.job.id, again.job.n_lost), (id(1), 1));
    // The other one goes on where its printer is heard of again.
    store.renew(second.claim.clone(), at(93)).await.unwrap();
    store.change(id(2), holds(&second.claim, Change::Printed { used_mm3: None }, 94)).await.unwrap();
    store.verify().await.unwrap();
}

pub(super) async fn a_claim_of_a_clock_that_was_ahead_lapses_in_one_lease<T: Site>(site: &T) {
    let store = with_jobs(site, 1).await;
    taken(&store, 3600).await.unwrap();
    assert_eq!(store.sweep(at(0)).await.unwrap(), []);
    assert_eq!(store.sweep(at(claim::LEASE_S)).await.unwrap().len(), 1);
    assert_eq!(state(&store, 1).await, State::Queued);
    store.verify().await.unwrap();
}

pub(super) async fn whoever_comes_back_takes_up_what_it_had<T: Site>(site: &T) {
    let store = with_jobs(site, 2).await;
    let before = taken(&store, 1).await.unwrap();
    store.change(id(1), holds(&before.claim, Change::Lay, 2)).await.unwrap();
    drop(store);
    let store = T::open(site.dir());
    assert_eq!(store.adopt(name("right"), at(3)).await.unwrap(), []);
    let after = store.adopt(name("left"), at(3)).await.unwrap();
    assert!(after.len() == 1 && after[0].job.is_laid && after[0].claim.token > before.claim.token);
    assert_eq!(refusal(store.renew(before.claim, at(4)).await), Refusal::ClaimLost);
    let printed = holds(&after[0].claim, Change::Printed { used_mm3: None }, 5);
    assert_eq!(store.change(id(1), printed).await.unwrap().state, State::AwaitingBedClear);
    store.verify().await.unwrap();
}

// ---------------------------------------------------------------- many at once

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
fn laid(dir: &Path) -> BTreeMap<String, usize> {
    let mut n_laid = BTreeMap::new();
    for line in std::fs::read_to_string(beds(dir)).unwrap_or_default().lines() {
        *n_laid.entry(line.to_owned()).or_default() += 1;
    }
    n_laid
}

/// A printer that prints until nothing is left.
async fn print_all(store: &impl Store, dir: &Path, printer: &str) {
    load(store, printer).await;
    take_up(store, dir, printer).await;
    // What it held may have been cleared, or not have lain there yet.
    clear(store, printer, 1).await.unwrap();
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
async fn assert_all_printed_once(store: &impl Store, dir: &Path, n_jobs: u16, copies: u16) {
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

pub(super) async fn each_copy_is_printed_once_by_many_threads<T: Site>(site: &T) {
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

pub(super) async fn each_copy_is_printed_once_by_many_processes<T: Site>(site: &T) {
    let store = with_copies(site, 12, 2).await;
    let children = ["a", "b", "c", "d"].map(|printer| spawn::<T>(site.dir(), &format!("print {printer}")));
    for child in children {
        ends_well(child);
    }
    assert!(laid(site.dir()).len() >= 12, "the processes did not print");
    print_all(&store, site.dir(), "a").await;
    assert_all_printed_once(&store, site.dir(), 12, 2).await;
}

// ---------------------------------------------------------------- processes of their own

const TASK: &str = "LUMENFAB_TEST_STORE_TASK";
const DIR: &str = "LUMENFAB_TEST_STORE_DIR";

/// This program again, with a task.
pub(super) fn again<T: Site>(dir: &Path, task: &str) -> Command {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args([T::CHILD, "--exact", "--nocapture"]).env(TASK, task).env(DIR, dir);
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    command
}

fn spawn<T: Site>(dir: &Path, task: &str) -> Child {
    again::<T>(dir, task).spawn().unwrap()
}

#[track_caller]
pub(super) fn ends_well(mut child: Child) {
    let is_good = child.wait().unwrap().success();
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert!(is_good, "{said}");
}

/// What this process is told to do; nothing unless it was told.
pub(super) fn child<T: Site>() {
    let (Ok(task), Some(dir)) = (std::env::var(TASK), std::env::var_os(DIR)) else { return };
    let dir = PathBuf::from(dir);
    match task.split_once(' ').unwrap_or((&task, "")) {
        ("print", printer) => {
            std::fs::write(begun(&dir), "").unwrap();
            run(print_all(&T::open(&dir), &dir, printer));
        }
        ("", _) => {}
        ("fill", _) => run(fill(&T::open(&dir))),
        other => panic!("no such task: {other:?}"),
    }
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

// ---------------------------------------------------------------- kills

/// Kills in the default run.
const N_KILLS: u32 = 20;
const N_JOBS: u16 = 150;

/// Numbers that look like chance, the same each time.
pub(super) struct Dice(pub(super) u64);

impl Dice {
    pub(super) fn below(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % n
    }
}

pub(super) async fn a_kill_at_any_moment_loses_nothing_and_prints_nothing_twice<T: Site>(site: &T) {
    kills(site, N_KILLS).await;
}

/// A host that prints is killed, comes back, is killed again; the first ones before there is any file.
pub(super) async fn kills<T: Site>(site: &T, n_kills: u32) {
    let mut dice = Dice(7);
    let mut n_killed = 0;
    let mut n_rounds = 0;
    while n_killed < n_kills {
        n_rounds += 1;
        let dir = site.dir().join(n_rounds.to_string());
        std::fs::create_dir(&dir).unwrap();
        n_killed += kills_of_one_queue::<T>(&dir, &mut dice, n_kills - n_killed).await;
    }
}

/// As many kills as one queue lasts for, at most so many.
async fn kills_of_one_queue<T: Site>(dir: &Path, dice: &mut Dice, most: u32) -> u32 {
    let mut n_killed = 0;
    let mut is_filled = false;
    while n_killed < most {
        let mut child = spawn::<T>(dir, "print left");
        wait_for_begin(dir);
        // Every fourth while it opens the store or takes up what it had.
        wait_ms(if dice.below(4) == 0 { dice.below(15) } else { dice.below(250) });
        child.kill().unwrap();
        let status = child.wait().unwrap();
        if status.success() && is_filled {
            break;
        }
        assert!(status.success() || status.code().is_none(), "the host ended by itself: {status}");
        n_killed += u32::from(!status.success());
        let store = T::open(dir);
        store.verify().await.unwrap();
        assert!(laid(dir).values().all(|&n| n == 1), "{:?}", laid(dir));
        is_filled = true;
        // The same tickets again: those that are there stay as they are.
        for number in 1..=N_JOBS {
            store.add(ticket(number), true, operator(0)).await.unwrap();
        }
    }
    assert!(most < 10 || laid(dir).len() > 10, "the hosts did not print");
    let store = T::open(dir);
    print_all(&store, dir, "left").await;
    assert_all_printed_once(&store, dir, N_JOBS, 1).await;
    n_killed
}

/// Until a process of its own has come so far that it opens the store.
fn wait_for_begin(dir: &Path) {
    while std::fs::remove_file(begun(dir)).is_err() {
        wait_ms(1);
    }
}

fn begun(dir: &Path) -> PathBuf {
    dir.join("begun")
}

fn wait_ms(ms: u64) {
    std::thread::park_timeout(Duration::from_millis(ms));
}

// ---------------------------------------------------------------- chance

const N_STEPS: u32 = 1500;

/// Anything, asked of anybody by anybody at any time: a refusal or a change of the table, never anything else; history and state
/// stay one.
pub(super) async fn whatever_happens_history_and_state_are_one<T: Site>(site: &T) {
    let store = T::open(site.dir());
    let mut dice = Dice(11);
    let mut claims = Vec::new();
    let mut n_done = 0;
    let mut clock = 0;
    for _ in 0..N_STEPS {
        // Now and then it is set back.
        clock += i64::try_from(dice.below(40)).unwrap() - if dice.below(50) == 0 { 3600 } else { 0 };
        match step(&store, &mut dice, &mut claims, clock).await {
            Ok(()) => n_done += 1,
            Err(Error::Refused(_)) => {}
            Err(other) => panic!("{other}"),
        }
        assert_beds_and_jobs_agree(&store).await;
    }
    assert!(n_done > N_STEPS / 8, "only {n_done} of {N_STEPS} were not refused");
    store.verify().await.unwrap();
    assert_steps_are_of_the_table(&store).await;
}

/// A bed that is clear has no job on it, and no bed has two.
async fn assert_beds_and_jobs_agree(store: &impl Store) {
    let printers = store.printers().await.unwrap();
    for job in store.list(Which::Live, None, 100).await.unwrap() {
        if job.state.is_at_printer() || job.state == State::AwaitingBedClear {
            let beds: Vec<_> = printers.iter().filter(|p| p.bed == Bed::Taken(job.id)).collect();
            assert_eq!(beds.len(), 1, "{job:?}");
            assert_eq!(Some(&beds[0].name), job.holder.as_ref());
        }
    }
}

async fn assert_steps_are_of_the_table(store: &impl Store) {
    for sealed in store.history(None, 0, u32::MAX).await.unwrap() {
        if let What::Job { change, from, to, .. } = sealed.record().unwrap().fact.what {
            assert_eq!(state::next(from, change.kind()), Some(to), "{change:?}");
        }
    }
}

async fn step(store: &impl Store, dice: &mut Dice, claims: &mut Vec<Claim>, clock: i64) -> Result<(), Error> {
    let number = u16::try_from(dice.below(6)).unwrap();
    let host = name(["left", "right"][usize::from(dice.below(2) == 0)]);
    let keep =
        |claimed: Vec<Claimed>, claims: &mut Vec<Claim>| claims.extend(claimed.into_iter().map(|c| c.claim));
    match dice.below(10) {
        0 => store.add(any_ticket(number, dice, clock), dice.below(2) == 0, operator(clock)).await.map(drop),
        1 => store.say(host, any_word(dice), operator(clock)).await.map(drop),
        2 | 3 => {
            let claimant = if dice.below(2) == 0 { Claimant::Worker(host) } else { Claimant::Printer(host) };
            keep(store.claim(claimant, at(clock)).await?.into_iter().collect(), claims);
            Ok(())
        }
        4 => store.sweep(at(clock)).await.map(drop),
        5 if dice.below(4) == 0 => {
            keep(store.adopt(host, at(clock)).await?, claims);
            Ok(())
        }
        6 if !claims.is_empty() => {
            let claim = any_claim(claims, dice);
            store.renew(claim, at(clock)).await.map(drop)
        }
        7 if dice.below(3) == 0 => {
            let place =
                [Place::First, Place::Last, Place::Behind(id(0))][usize::try_from(dice.below(3)).unwrap()];
            let saw = store.job(id(number)).await?.0.state;
            store.place(id(number), place, sees(saw), Reason::default(), at(clock)).await.map(drop)
        }
        8 | 9 if !claims.is_empty() => {
            let claim = any_claim(claims, dice);
            store.change(claim.job, holds(&claim, any_change(dice, clock), clock)).await.map(drop)
        }
        _ => {
            let saw = store.job(id(number)).await?.0.state;
            store.change(id(number), asks(any_change(dice, clock), saw, clock)).await.map(drop)
        }
    }
}

fn any_claim(claims: &[Claim], dice: &mut Dice) -> Claim {
    let newest = claims.len().saturating_sub(4);
    let n = u64::try_from(claims.len() - newest).unwrap();
    claims[newest + usize::try_from(dice.below(n)).unwrap()].clone()
}

fn any_ticket(number: u16, dice: &mut Dice, clock: i64) -> Ticket {
    let not_before = (dice.below(4) == 0).then(|| at(clock + 100));
    let copies = u16::try_from(dice.below(4)).unwrap();
    let wishes = Wishes { copies, not_before, sign_off: dice.below(2) == 0, ..Wishes::default() };
    let made = (dice.below(2) == 0).then(made);
    Ticket { wishes, made, ..ticket(number) }
}

fn any_word(dice: &mut Dice) -> Said {
    match dice.below(6) {
        0 => Said::BedInDoubt,
        1 | 2 => Said::Loaded(Loaded { left_mm3: Some(1_000_000), ..loaded() }),
        _ => Said::BedClear(Evidence::Word),
    }
}

fn any_change(dice: &mut Dice, clock: i64) -> Change {
    let used_mm3 = (dice.below(2) == 0).then_some(5);
    match dice.below(22) {
        0 => Change::Submit,
        1 => Change::Edit(Edit::Priority(i8::try_from(dice.below(5)).unwrap())),
        2 => Change::Edit(Edit::Copies(u16::try_from(dice.below(4)).unwrap())),
        3 => Change::Edit(Edit::NotBefore((dice.below(2) == 0).then(|| at(clock + 50)))),
        4 => Change::Hold,
        5 => Change::Release,
        6 => Change::Cancel { used_mm3 },
        7 => Change::Retry,
        8 => Change::Prepare { worker: name("left") },
        9 => Change::Prepared(made()),
        10 => Change::Start { printer: name("left") },
        11 => Change::Lay,
        12 => Change::Pause,
        13 => Change::GoOn,
        14 => Change::Printed { used_mm3 },
        15 => Change::GiveBack { lost: dice.below(2) == 0 },
        16 => Change::Fail { used_mm3 },
        17 => Change::Accept,
        18 => Change::Reject,
        19 => Change::NextCopy,
        20 => Change::Lay,
        _ => Change::Printed { used_mm3 },
    }
}
