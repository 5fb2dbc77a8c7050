//! A change as a whole, and the rules of safety.

mod beds;
mod copies;
mod doubts;

use super::act::{self, Bedside, Outcome, Scene};
use super::*;
use crate::queue::claim::LEASE_S;
use jiff::{SignedDuration, Timestamp};

pub(crate) fn at(seconds: i64) -> Timestamp {
    Timestamp::UNIX_EPOCH + SignedDuration::from_hours(24 * 365 * 50) + SignedDuration::from_secs(seconds)
}

pub(crate) fn id(number: u16) -> JobId {
    let [a, b] = number.to_be_bytes();
    JobId::at(at(0), [0, 0, 0, 0, 0, 0, 0, 0, a, b])
}

pub(crate) fn name(text: &str) -> Name {
    Name::try_new(text).unwrap()
}

pub(crate) fn because(text: &str) -> Reason {
    Reason::try_new(text).unwrap()
}

pub(crate) fn operator(seconds: i64) -> By {
    By { who: Who::Operator(name("Ada")), why: Reason::default(), now: at(seconds) }
}

pub(crate) fn loaded() -> Loaded {
    let (profile, material) = (name("abs-enclosed"), Material::try_new("ABS").unwrap());
    Loaded { profile, material, nozzle_um: 400, left_mm3: Some(100_000) }
}

pub(crate) fn made() -> Made {
    let estimate = Estimate { print_s: 3600, filament_mm3: 10_000 };
    Made { gcode: Digest::of(b"G28"), estimate, needs: Needs::default() }
}

/// A ticket for one copy of ready G-code.
pub(crate) fn ticket(number: u16) -> Ticket {
    let spec = Spec::try_new(SpecKind::Gcode, number.to_be_bytes().to_vec()).unwrap();
    Ticket { id: id(number), spec, wishes: Wishes::default(), made: Some(made()) }
}

fn queued(ticket: &Ticket) -> Job {
    act::add(ticket, Rank::between(None, None), true, &operator(0)).unwrap().scene.job
}

fn printer(bed: Bed) -> Printer {
    Printer { bed, loaded: Some(loaded()), ..Printer::new(name("left")) }
}

fn scene(job: Job) -> Scene {
    Scene { job, claim: None, printer: Some(printer(Bed::Clear)) }
}

fn started(job: Job) -> Scene {
    act::claim(&scene(job), &Claimant::Printer(name("left")), 7, at(10)).unwrap().scene
}

fn held_by(scene: &Scene, change: Change, seconds: i64) -> Result<Outcome, Refusal> {
    let claim = scene.claim.clone().unwrap();
    let actor = Actor::Holder { claim, asked_by: None };
    act::change(scene, &Request { change, actor, why: because("so"), now: at(seconds) })
}

fn asked(scene: &Scene, change: Change, seconds: i64) -> Result<Outcome, Refusal> {
    let actor = Actor::Operator { name: name("Ada"), saw: scene.job.state };
    act::change(scene, &Request { change, actor, why: because("so"), now: at(seconds) })
}

fn cleared(scene: &Scene, seconds: i64) -> Result<Bedside, Refusal> {
    let before = Bedside { printer: scene.printer.clone().unwrap(), job: Some(scene.job.clone()) };
    act::say(&before, &CLEAR, &operator(seconds)).map(|(after, _)| after)
}

const CLEAR: Said = Said::BedClear(Evidence::Word);

fn said(printer: &Printer, job: &Job, said: &Said) -> Result<Bedside, Refusal> {
    let before = Bedside { printer: printer.clone(), job: Some(job.clone()) };
    act::say(&before, said, &operator(80)).map(|(after, _)| after)
}

fn laid(job: Job) -> Scene {
    held_by(&started(job), Change::Lay, 20).unwrap().scene
}

#[test]
fn a_job_of_two_copies_goes_its_whole_way() {
    let mut ticket = ticket(1);
    ticket.wishes = Wishes { copies: 2, sign_off: true, ..Wishes::default() };
    let mut job = queued(&ticket);
    for copy in 1..=2 {
        let printed = held_by(&laid(job), Change::Printed { used_mm3: Some(9_000) }, 30).unwrap().scene;
        assert_eq!((printed.job.state, printed.job.n_printed), (State::AwaitingBedClear, copy));
        assert_eq!(printed.claim, None);
        let after = cleared(&printed, 40).unwrap();
        assert_eq!(after.printer.bed, Bed::Clear);
        assert_eq!(after.printer.loaded.unwrap().left_mm3, Some(91_000));
        job = after.job.unwrap();
        let expected = if copy == 1 { State::Queued } else { State::AwaitingSignOff };
        assert_eq!((job.state, job.holder.as_ref()), (expected, None));
    }
    let accepted = asked(&scene(job), Change::Accept, 50).unwrap();
    assert_eq!(accepted.scene.job.state, State::Finished);
}

#[test]
fn nothing_starts_on_a_bed_that_is_not_known_to_be_clear() {
    for bed in [Bed::Unknown, Bed::Taken(id(2)), Bed::Taken(id(1))] {
        let scene = Scene { printer: Some(printer(bed)), ..scene(queued(&ticket(1))) };
        let refused = act::claim(&scene, &Claimant::Printer(name("left")), 7, at(10)).unwrap_err();
        assert_eq!(refused, Refusal::BedNotClear { printer: name("left") });
    }
}

#[test]
fn a_bed_is_clear_by_a_persons_word_or_a_confirmation_but_not_by_the_appliances() {
    let before = Bedside { printer: printer(Bed::Unknown), job: None };
    let appliance = By { who: Who::Appliance(name("left")), ..operator(0) };
    let word = act::say(&before, &Said::BedClear(Evidence::Word), &appliance);
    assert_eq!(word, Err(Refusal::NoEvidence));
    for evidence in [Evidence::Sensor, Evidence::Hook] {
        let (after, facts) = act::say(&before, &Said::BedClear(evidence), &appliance).unwrap();
        assert_eq!((after.printer.bed, facts.len()), (Bed::Clear, 1));
    }
}

#[test]
fn the_bed_of_a_running_print_is_not_clear_whatever_is_said() {
    for scene in [started(queued(&ticket(1))), laid(queued(&ticket(1)))] {
        let refused = cleared(&scene, 30).unwrap_err();
        assert_eq!(refused, Refusal::BedInUse { printer: name("left"), job: id(1) });
    }
}

#[test]
fn what_was_laid_goes_back_into_the_queue_by_an_operator_alone() {
    let scene = laid(queued(&ticket(1)));
    assert_eq!(held_by(&scene, Change::GiveBack { lost: false }, 30).unwrap_err(), Refusal::MaterialLaid);
    assert_eq!(act::lost(&scene, at(1000)), Ok(None));
    let failed = held_by(&scene, Change::Fail { used_mm3: None }, 30).unwrap().scene;
    let after = failed.printer.clone().unwrap();
    assert_eq!((after.bed, after.loaded.unwrap().left_mm3), (Bed::Taken(id(1)), Some(90_000)));
    let again = asked(&failed, Change::Retry, 40).unwrap().scene;
    assert_eq!((again.job.state, again.job.is_laid), (State::Queued, false));
    let refused = act::claim(&again, &Claimant::Printer(name("left")), 9, at(50)).unwrap_err();
    assert_eq!(refused, Refusal::BedNotClear { printer: name("left") });
}

#[test]
fn an_appliance_that_comes_back_cannot_begin_the_copy_anew() {
    let adopted = act::adopt(&laid(queued(&ticket(1))), &name("left"), 9, at(30)).unwrap().scene;
    assert_eq!(held_by(&adopted, Change::Lay, 31).unwrap_err(), Refusal::MaterialLaid);
}

#[test]
fn a_job_is_moved_by_the_store_alone() {
    let edit = Change::Edit(Edit::Rank(Rank::between(None, None)));
    assert_eq!(asked(&scene(queued(&ticket(1))), edit, 1).unwrap_err(), Refusal::PlaceByHand);
}

#[test]
fn a_job_that_laid_nothing_leaves_the_bed_as_clear_as_it_was() {
    let scene = started(queued(&ticket(1)));
    for change in
        [Change::GiveBack { lost: false }, Change::Fail { used_mm3: None }, Change::Cancel { used_mm3: None }]
    {
        let after = held_by(&scene, change, 30).unwrap().scene.printer.unwrap();
        assert_eq!((after.bed, after.loaded.unwrap().left_mm3), (Bed::Clear, Some(100_000)));
    }
}

#[test]
fn a_lost_holder_loses_what_it_has_not_begun_and_can_lay_nothing_any_more() {
    let before = started(queued(&ticket(1)));
    assert_eq!(act::lost(&before, at(10 + LEASE_S - 1)), Ok(None));
    let given_back = act::lost(&before, at(10 + LEASE_S)).unwrap().unwrap().scene;
    assert_eq!((given_back.job.state, given_back.job.n_lost), (State::Queued, 1));
    let actor = Actor::Holder { claim: before.claim.clone().unwrap(), asked_by: None };
    let late = Request { change: Change::Lay, actor, why: Reason::default(), now: at(100) };
    assert_eq!(act::change(&given_back, &late).unwrap_err(), Refusal::ClaimLost);
    let again = act::claim(&given_back, &Claimant::Printer(name("left")), 8, at(90)).unwrap().scene;
    assert_eq!(act::change(&again, &late).unwrap_err(), Refusal::ClaimLost);
}

#[test]
fn a_job_that_loses_one_holder_after_the_other_is_given_up() {
    let mut job = queued(&ticket(1));
    for n_lost in 1..=3 {
        let after = act::lost(&started(job), at(1000)).unwrap().unwrap().scene;
        let expected = if n_lost < 3 { State::Queued } else { State::Failed };
        assert_eq!(after.job.state, expected);
        assert_eq!(after.printer.unwrap().bed, Bed::Clear);
        job = after.job;
    }
}

#[test]
fn a_print_in_hand_is_ended_by_its_printer_or_once_that_is_not_heard_of() {
    let scene = laid(queued(&ticket(1)));
    let cancel = Change::Cancel { used_mm3: None };
    assert_eq!(asked(&scene, cancel.clone(), 30).unwrap_err(), Refusal::InHand { holder: name("left") });
    let late = asked(&scene, cancel.clone(), 10 + LEASE_S).unwrap().scene;
    assert_eq!((late.job.state, late.claim), (State::Cancelled, None));
    assert_eq!(late.printer.unwrap().bed, Bed::Taken(id(1)));
    let claim = scene.claim.clone().unwrap();
    let actor = Actor::Holder { claim, asked_by: Some(name("Ada")) };
    let by_printer = Request { change: cancel, actor, why: Reason::default(), now: at(30) };
    let outcome = act::change(&scene, &by_printer).unwrap();
    assert_eq!(outcome.facts[0].who, Who::Operator(name("Ada")));
}

#[test]
fn only_its_own_printer_takes_a_print_up_again() {
    let scene = laid(queued(&ticket(1)));
    assert_eq!(act::adopt(&scene, &name("right"), 9, at(30)).unwrap_err(), Refusal::ClaimLost);
    let adopted = act::adopt(&scene, &name("left"), 9, at(30)).unwrap().scene;
    assert!(adopted.job.is_laid && adopted.claim.as_ref().unwrap().token == 9);
    let actor = Actor::Holder { claim: scene.claim.unwrap(), asked_by: None };
    let old = Request { change: Change::Pause, actor, why: Reason::default(), now: at(31) };
    assert_eq!(act::change(&adopted, &old).unwrap_err(), Refusal::ClaimLost);
}

#[test]
fn operators_act_upon_what_they_have_seen() {
    let scene = scene(queued(&ticket(1)));
    let actor = Actor::Operator { name: name("Ada"), saw: State::Held };
    let request = Request { change: Change::Hold, actor, why: Reason::default(), now: at(1) };
    let refused = act::change(&scene, &request).unwrap_err();
    assert_eq!(refused, Refusal::ChangedMeanwhile { saw: State::Held, found: State::Queued });
    let start = Change::Start { printer: name("left") };
    let refused = asked(&scene, start, 1).unwrap_err();
    assert_eq!(refused, Refusal::NotForYou { change: Kind::Start, role: Role::Operator });
}

#[test]
fn a_rule_takes_nothing_from_an_appliance_that_lives() {
    let scene = started(queued(&ticket(1)));
    let actor = Actor::Policy { name: name("tidy"), saw: State::Printing };
    let change = Change::GiveBack { lost: true };
    let request = Request { change, actor, why: Reason::default(), now: at(20) };
    assert_eq!(act::change(&scene, &request).unwrap_err(), Refusal::InHand { holder: name("left") });
}

#[test]
fn a_sign_off_has_a_name_and_a_reason() {
    let mut job = queued(&Ticket { wishes: Wishes { sign_off: true, ..Wishes::default() }, ..ticket(1) });
    job.state = State::AwaitingSignOff;
    job.n_printed = 1;
    let before = scene(job);
    let actor = Actor::Operator { name: name("Ada"), saw: State::AwaitingSignOff };
    let silent = Request { change: Change::Reject, actor, why: Reason::default(), now: at(1) };
    assert_eq!(act::change(&before, &silent).unwrap_err(), Refusal::NoReason { change: Kind::Reject });
    let rejected = asked(&before, Change::Reject, 1).unwrap();
    assert_eq!((rejected.scene.job.state, rejected.facts[0].why.as_str()), (State::Failed, "so"));
    let again = asked(&rejected.scene, Change::Retry, 2).unwrap().scene.job;
    assert_eq!((again.state, again.n_left()), (State::Queued, 1));
}

#[test]
fn a_copy_is_printed_only_after_material_was_announced() {
    let refused = held_by(&started(queued(&ticket(1))), Change::Printed { used_mm3: None }, 20).unwrap_err();
    assert_eq!(refused, Refusal::NothingLaid);
}

#[test]
fn what_is_not_prepared_not_due_or_does_not_fit_does_not_start() {
    let claim = |job: Job| act::claim(&scene(job), &Claimant::Printer(name("left")), 7, at(10)).unwrap_err();
    assert_eq!(claim(queued(&Ticket { made: None, ..ticket(1) })), Refusal::NotPrepared);
    let wishes = Wishes { not_before: Some(at(11)), ..Wishes::default() };
    assert_eq!(claim(queued(&Ticket { wishes, ..ticket(1) })), Refusal::NotDue { until: at(11) });
    let mut ticket = ticket(1);
    ticket.made.as_mut().unwrap().needs.nozzle_um = Some(250);
    assert!(matches!(claim(queued(&ticket)), Refusal::Misfit(Misfit::Nozzle { .. })));
}

#[test]
fn preparing_is_held_back_and_called_off_at_once() {
    let job = queued(&Ticket { made: None, ..ticket(1) });
    let taken = act::claim(&Scene { printer: None, ..scene(job) }, &Claimant::Worker(name("w")), 3, at(1));
    let preparing = taken.unwrap().scene;
    let done = held_by(&preparing, Change::Prepared(made()), 2).unwrap().scene;
    assert_eq!((done.job.state, done.job.made.is_some(), done.claim), (State::Queued, true, None));
    let held = asked(&preparing, Change::Hold, 2).unwrap().scene;
    let actor = Actor::Holder { claim: preparing.claim.unwrap(), asked_by: None };
    let late = Request { change: Change::Prepared(made()), actor, why: Reason::default(), now: at(3) };
    assert_eq!(act::change(&held, &late).unwrap_err(), Refusal::ClaimLost);
}

mod chain {
    use super::*;

    fn facts() -> Vec<Fact> {
        let mut ticket = ticket(1);
        ticket.wishes.copies = 2;
        let added = act::add(&ticket, Rank::between(None, None), true, &operator(0)).unwrap();
        let before = scene(added.scene.job);
        let start = act::claim(&before, &Claimant::Printer(name("left")), 3, at(10)).unwrap();
        let lay = held_by(&start.scene, Change::Lay, 20).unwrap();
        let printed = held_by(&lay.scene, Change::Printed { used_mm3: None }, 30).unwrap();
        [added.facts, start.facts, lay.facts, printed.facts].concat()
    }

    fn sealed() -> (Vec<Sealed>, Head) {
        let mut head = Head::EMPTY;
        let mut seal = |fact| {
            let sealed = head.seal(fact);
            head = sealed.head();
            sealed
        };
        let records: Vec<_> = facts().into_iter().map(&mut seal).collect();
        (records, head)
    }

    #[test]
    fn a_history_as_it_was_written_fits() {
        let (records, head) = sealed();
        assert_eq!(history::verify(&records, head), Ok(()));
        assert_eq!(history::verify(&[], Head::EMPTY), Ok(()));
    }

    #[test]
    fn a_changed_record_is_named() {
        let (records, head) = sealed();
        for idx in 0..records.len() {
            let seq = records[idx].seq;
            let mut changed = records.clone();
            changed[idx].body = changed[idx].body.replace("Ada", "Eve").replace("left", "lest");
            assert_eq!(history::verify(&changed, head), Err(Break::Changed { seq }));
        }
    }

    #[test]
    fn a_record_that_was_taken_out_or_cut_off_shows() {
        let (records, head) = sealed();
        let mut missing = records.clone();
        missing.remove(1);
        assert_eq!(history::verify(&missing, head), Err(Break::Missing { seq: 2, found: 3 }));
        let cut = &records[..records.len() - 1];
        let expected = head.seq;
        assert_eq!(history::verify(cut, head), Err(Break::End { found: expected - 1, expected }));
        let other = Head { digest: Digest::of(b"other"), ..head };
        assert_eq!(history::verify(&records, other), Err(Break::OtherEnd { seq: head.seq }));
    }

    #[test]
    fn records_bring_back_what_a_job_is() {
        let (sealed, _) = sealed();
        let records: Vec<Record> = sealed.iter().map(|s| s.record().unwrap()).collect();
        let of_job: Vec<_> = records.iter().filter(|r| r.fact.subject() == Subject::Job(id(1))).collect();
        let job = history::replay_job(of_job.iter().copied()).unwrap().unwrap();
        assert_eq!((job.state, job.n_printed, job.revision), (State::AwaitingBedClear, 1, 4));
        let jumped = history::replay_job([of_job[0], of_job[3]]).unwrap_err();
        assert!(matches!(jumped, Break::Impossible { .. }), "{jumped}");
    }
}

mod plans {
    use super::schedule::{self, Lane, Unplanned, WhyNot};
    use super::*;
    use jiff::tz::TimeZone;

    fn jobs(n: u16) -> Vec<Job> {
        let mut rank = None;
        let mut job = |number| {
            let next = Rank::between(rank.as_ref(), None);
            rank = Some(next.clone());
            act::add(&ticket(number), next, true, &operator(0)).unwrap().scene.job
        };
        (1..=n).map(&mut job).collect()
    }

    fn lane(bed: Bed) -> Lane {
        Lane { printer: printer(bed), ends: None, clearing_s: 600 }
    }

    #[test]
    fn the_first_that_is_ready_due_and_fits_is_next() {
        let mut jobs = jobs(5);
        jobs[0].state = State::Held;
        jobs[1].made = None;
        jobs[2].wishes.not_before = Some(at(1000));
        jobs[3].made.as_mut().unwrap().needs.material = Material::try_new("PLA").ok();
        let next = |jobs: &[Job]| schedule::next(&printer(Bed::Clear), jobs, at(0)).map(|job| job.id);
        assert_eq!(next(&jobs), Ok(id(5)));
        let why = next(&jobs[..4]).unwrap_err().to_string();
        let expected = format!(
            "no job can begin: 1 held, 1 not prepared yet, 1 not due before {}, 1 that do not fit (job {}: it needs PLA, ABS is loaded)",
            at(1000),
            id(4)
        );
        assert_eq!(why, expected);
        assert_eq!(next(&[]), Err(WhyNot::Empty));
    }

    #[test]
    fn a_bed_that_is_not_clear_is_said_before_anything_else() {
        let jobs = [laid(queued(&ticket(1))).job];
        let why = |bed, jobs: &[Job]| schedule::next(&printer(bed), jobs, at(0)).unwrap_err();
        assert!(matches!(why(Bed::Unknown, &jobs), WhyNot::BedUnknown { .. }));
        assert!(matches!(why(Bed::Taken(id(1)), &jobs), WhyNot::Printing { .. }));
        assert!(matches!(why(Bed::Taken(id(1)), &[]), WhyNot::BedTaken { .. }));
    }

    #[test]
    fn jobs_end_one_after_the_other_with_the_bed_cleared_between_them() {
        let plan = schedule::plan(&[lane(Bed::Clear)], &jobs(3), at(0));
        let times: Vec<_> = plan.slots.iter().map(|slot| (slot.starts, slot.ends)).collect();
        assert_eq!(times, [(at(0), at(3600)), (at(4200), at(7800)), (at(8400), at(12_000))]);
        assert_eq!(plan.end_of(id(2)), Some(at(7800)));
        // 1970 and 50 years of 365 days later it was Friday, 20 December 2019.
        let words = |now| plan.end_words(now, &TimeZone::UTC);
        assert_eq!(words(at(0)).as_deref(), Some("the last job ends Friday 03:20"));
        let long_before = words(at(-7 * 86_400));
        assert_eq!(long_before.as_deref(), Some("the last job ends Friday 20 December 2019 03:20"));
    }

    #[test]
    fn two_printers_share_the_queue_but_not_the_copies_of_a_job() {
        let mut jobs = jobs(2);
        jobs[0].wishes.copies = 2;
        let right =
            Lane { printer: Printer { name: name("right"), ..printer(Bed::Clear) }, ..lane(Bed::Clear) };
        let plan = schedule::plan(&[lane(Bed::Clear), right], &jobs, at(0));
        let slots: Vec<_> = plan.slots.iter().map(|s| (s.job, s.copy, s.starts)).collect();
        assert_eq!(slots, [(id(1), 1, at(0)), (id(2), 1, at(0)), (id(1), 2, at(4200))]);
    }

    #[test]
    fn what_is_in_print_and_what_is_not_due_is_waited_for() {
        let mut jobs = jobs(2);
        jobs[0] = laid(jobs[0].clone()).job;
        jobs[1].wishes.not_before = Some(at(50_000));
        let lane = Lane { ends: Some(at(900)), ..lane(Bed::Taken(id(1))) };
        let plan = schedule::plan(&[lane], &jobs, at(100));
        let slots: Vec<_> = plan.slots.iter().map(|s| (s.job, s.starts, s.ends)).collect();
        assert_eq!(slots, [(id(1), at(100), at(900)), (id(2), at(50_000), at(53_600))]);
    }

    #[test]
    fn a_plan_stays_small_whatever_is_queued() {
        let mut jobs = jobs(3);
        for job in &mut jobs {
            job.wishes.copies = u16::MAX;
        }
        let endless = Printer { loaded: Some(Loaded { left_mm3: None, ..loaded() }), ..printer(Bed::Clear) };
        let plan = schedule::plan(&[Lane { printer: endless, ..lane(Bed::Clear) }], &jobs, at(0));
        assert_eq!(plan.slots.len(), schedule::MOST_SLOTS);
        assert_eq!(plan.unplanned, jobs.iter().map(|job| (job.id, Unplanned::TooFar)).collect::<Vec<_>>());
    }

    #[test]
    fn what_has_no_place_is_told_with_its_reason() {
        let mut jobs = jobs(4);
        jobs[0].state = State::Held;
        jobs[1].made = None;
        jobs[2].made.as_mut().unwrap().estimate.filament_mm3 = 60_000;
        jobs[2].wishes.copies = 2;
        jobs[3].made.as_mut().unwrap().needs.nozzle_um = Some(250);
        let plan = schedule::plan(&[lane(Bed::Clear)], &jobs, at(0));
        assert_eq!(plan.slots.len(), 1);
        let told: Vec<_> = plan.unplanned.iter().map(|(_, why)| why.to_string()).collect();
        let expected = [
            "it is held",
            "how long it takes is known once it is prepared",
            "it needs 120.0 cm³ of filament, 100.0 cm³ are left on the spool",
            "it needs a nozzle of 0.25 mm, one of 0.40 mm is fitted",
        ];
        assert_eq!(told, expected);
        assert_eq!(schedule::plan(&[], &jobs[3..], at(0)).unplanned[0].1, Unplanned::NoPrinter);
    }
}
