//! What every store has to do: one suite, for each of them.
//!
//! A [`Site`] is a place where a store is kept: it can be opened again and by others, also in processes of their own. These are this
//! very program, told by the environment what to do ([`hosts`]).

mod chance;
mod hosts;
mod kills;

pub(super) use chance::whatever_happens_history_and_state_are_one;
pub(super) use hosts::{
    again, child, each_copy_is_printed_once_by_many_processes, each_copy_is_printed_once_by_many_threads,
    ends_well, say_done,
};
pub(super) use kills::{a_kill_at_any_moment_loses_nothing_and_prints_nothing_twice, kills};

use super::{Claimed, Error, Place, Store, Which};
use crate::queue::tests::{at, because, id, loaded, made, name, operator, ticket};
use crate::queue::*;
use std::path::Path;

/// Where a store is kept.
pub(super) trait Site: Sized {
    /// The store.
    type Store: Store;
    /// The test that calls [`hosts`] for this kind of store.
    const CHILD: &'static str;

    /// A place where nothing is yet; `None`, having said why, where this kind of store cannot be had.
    fn fresh() -> Option<Self>;
    /// A folder for what the tests write beside.
    fn dir(&self) -> &Path;
    /// The store that is kept in a folder.
    fn open(dir: &Path) -> Self::Store;
}

/// Runs something to its end on this thread.
pub(super) fn run<T>(work: impl Future<Output = T>) -> T {
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(work)
}

/// Every behaviour as a test of its own.
macro_rules! suite {
    ($site:ty: $($behaviour:ident),* $(,)?) => {
        $(
            #[test]
            fn $behaviour() {
                let Some(site) = <$site as $crate::store::suite::Site>::fresh() else { return };
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
            many_tickets_are_added_all_or_none,
            a_job_goes_its_whole_way,
            a_job_ends_when_no_more_copies_are_wanted_and_holds_nothing_up,
            jobs_are_taken_by_priority_and_place,
            listings_go_on_where_they_ended,
            a_job_waits_for_its_time_also_when_the_clock_is_set_back,
            held_jobs_and_those_that_do_not_fit_are_passed_over,
            an_unknown_printer_and_an_uncleared_bed_take_nothing,
            remains_on_one_bed_are_no_copy_on_another,
            what_was_seen_has_to_be_so_still,
            a_refusal_changes_nothing,
            a_lapsed_claim_is_taken_away_where_nothing_was_laid,
            a_claim_of_a_clock_that_was_ahead_lapses_in_one_lease,
            whoever_comes_back_takes_up_what_it_had,
            a_job_that_ends_its_host_again_and_again_is_given_up,
            each_copy_is_printed_once_by_many_threads,
            each_copy_is_printed_once_by_many_processes,
            whatever_happens_history_and_state_are_one,
            a_kill_at_any_moment_loses_nothing_and_prints_nothing_twice,
        }
    };
}
pub(super) use every_behaviour;

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

/// Numbers that look like chance, the same each time.
pub(super) struct Dice(pub(super) u64);

impl Dice {
    pub(super) fn below(&mut self, n: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % n
    }
}

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

pub(super) async fn many_tickets_are_added_all_or_none<T: Site>(site: &T) {
    let store = with_jobs(site, 1).await;
    let none = Ticket { wishes: Wishes { copies: 0, ..Wishes::default() }, ..ticket(3) };
    let refused = refusal(store.add_all(vec![ticket(2), none], true, operator(1)).await);
    assert_eq!(refused, Refusal::Copies { found: 0, least: 1 });
    assert_eq!(live(&store).await, ids(&[1]));
    let added = store.add_all(vec![ticket(3), ticket(1), ticket(2)], true, operator(1)).await.unwrap();
    assert_eq!(added.iter().map(|job| job.id).collect::<Vec<_>>(), ids(&[3, 1, 2]));
    assert_eq!(live(&store).await, ids(&[1, 3, 2]));
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

pub(super) async fn a_job_ends_when_no_more_copies_are_wanted_and_holds_nothing_up<T: Site>(site: &T) {
    let store = with_jobs(site, 0).await;
    let wishes = Wishes { copies: 3, ..Wishes::default() };
    store.add(Ticket { wishes, ..ticket(1) }, true, operator(0)).await.unwrap();
    store.add(ticket(2), true, operator(0)).await.unwrap();
    assert_eq!(print_next(&store, 1).await, Some(id(1)));
    let enough = Change::Edit(Edit::Copies(1));
    store.change(id(1), asks(enough, State::Queued, 2)).await.unwrap();
    assert_eq!(print_next(&store, 3).await, Some(id(2)));
    let (job, _) = store.job(id(1)).await.unwrap();
    assert_eq!((job.state, job.n_printed), (State::Finished, 1));
    store.verify().await.unwrap();
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

pub(super) async fn remains_on_one_bed_are_no_copy_on_another<T: Site>(site: &T) {
    let store = with_jobs(site, 1).await;
    load(&store, "right").await;
    clear(&store, "right", 0).await.unwrap();
    // The left printer falls silent in the middle of it; somebody gives it up, and lets it be tried again.
    let silent = taken(&store, 1).await.unwrap();
    store.change(id(1), holds(&silent.claim, Change::Lay, 2)).await.unwrap();
    store.sweep(at(100)).await.unwrap();
    store.change(id(1), asks(Change::Fail { used_mm3: None }, State::Printing, 100)).await.unwrap();
    store.change(id(1), asks(Change::Retry, State::Failed, 101)).await.unwrap();
    let right = store.claim(Claimant::Printer(name("right")), at(102)).await.unwrap().unwrap();
    store.change(id(1), holds(&right.claim, Change::Lay, 103)).await.unwrap();
    let printed = Change::Printed { used_mm3: None };
    let late = store.change(id(1), holds(&silent.claim, printed.clone(), 104)).await;
    assert_eq!(refusal(late), Refusal::ClaimLost);
    store.change(id(1), holds(&right.claim, printed, 105)).await.unwrap();
    assert_eq!(clear(&store, "left", 106).await.unwrap().bed, Bed::Clear);
    assert_eq!(state(&store, 1).await, State::AwaitingBedClear);
    clear(&store, "right", 107).await.unwrap();
    let (job, _) = store.job(id(1)).await.unwrap();
    assert_eq!((job.state, job.n_printed), (State::Finished, 1));
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
    let not_for_holders = Refusal::NotForYou { change: Kind::Start, role: Role::Holder };
    for (asked, expected) in [
        (holds(&other, Change::Lay, 2), Refusal::ClaimLost),
        (holds(&claim, Change::Printed { used_mm3: None }, 2), Refusal::NothingLaid),
        (holds(&claim, Change::Start { printer: name("left") }, 2), not_for_holders),
        (
            asks(Change::Cancel { used_mm3: None }, State::Printing, 2),
            Refusal::InHand { holder: name("left") },
        ),
    ] {
        assert_eq!(refusal(store.change(id(1), asked).await), expected);
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

pub(super) async fn a_job_that_ends_its_host_again_and_again_is_given_up<T: Site>(site: &T) {
    let store = with_jobs(site, 2).await;
    for n_crashes in 1..=3 {
        assert_eq!(taken(&store, n_crashes).await.unwrap().job.id, id(1));
        let adopted = store.adopt(name("left"), at(n_crashes)).await.unwrap();
        assert_eq!(adopted.len(), usize::from(n_crashes < 3));
        for Claimed { claim, .. } in adopted {
            store.change(id(1), holds(&claim, Change::GiveBack { lost: false }, n_crashes)).await.unwrap();
        }
    }
    assert_eq!(state(&store, 1).await, State::Failed);
    assert_eq!(print_next(&store, 4).await, Some(id(2)));
    // Only crashes in a row count.
    store.change(id(1), asks(Change::Retry, State::Failed, 5)).await.unwrap();
    let claimed = taken(&store, 6).await.unwrap();
    store.change(id(1), holds(&claimed.claim, Change::Lay, 7)).await.unwrap();
    for n_crashes in 8..12 {
        assert_eq!(store.adopt(name("left"), at(n_crashes)).await.unwrap().len(), 1);
    }
    store.verify().await.unwrap();
}
