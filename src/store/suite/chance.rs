//! Anything, asked of anybody by anybody at any time.

use super::*;
use std::collections::{BTreeMap, BTreeSet};

const N_STEPS: u64 = 6000;
/// After so many, four jobs are asked for no more, and four new ones are.
const N_STEPS_OF_A_JOB: u64 = 800;

/// Anything, asked of anybody by anybody at any time: a refusal or a change of the table, never anything else; history and state
/// stay one, and what lies on beds is what was laid there.
pub(in crate::store) async fn whatever_happens_history_and_state_are_one<T: Site>(site: &T) {
    let store = T::open(site.dir());
    let mut dice = Dice(11);
    let mut claims = Vec::new();
    let mut seen = Seen::default();
    let mut clock = 0;
    for n in 0..N_STEPS {
        // Now and then it is set back.
        clock += i64::try_from(dice.below(40)).unwrap() - if dice.below(50) == 0 { 3600 } else { 0 };
        // New jobs all the time: those that are finished stay so.
        let number = u16::try_from(n / N_STEPS_OF_A_JOB * 4 + dice.below(6)).unwrap();
        match step(&store, &mut dice, &mut claims, number, clock).await {
            Ok(()) | Err(Error::Refused(_)) => {}
            Err(other) => panic!("{other}"),
        }
        seen.look(&store).await;
        seen.assert_beds_and_jobs_agree(&store).await;
    }
    let never: Vec<_> = Kind::ALL.into_iter().filter(|kind| !seen.kinds.contains(kind)).collect();
    assert!(never.is_empty(), "never happened: {never:?}");
    store.verify().await.unwrap();
}

/// What the records tell, by rules of their own.
#[derive(Default)]
struct Seen {
    seq: u64,
    kinds: BTreeSet<Kind>,
    /// Beds on which something lies, or that somebody has doubted.
    not_clear: BTreeSet<Name>,
    /// Copies that count.
    n_printed: BTreeMap<JobId, u16>,
}

impl Seen {
    async fn look(&mut self, store: &impl Store) {
        for sealed in store.history(None, self.seq, u32::MAX).await.unwrap() {
            self.seq = sealed.seq;
            match sealed.record().unwrap().fact {
                Fact { what: What::Job { id, change, from, to }, who, .. } => {
                    assert_eq!(state::next(from, change.kind()), Some(to), "{change:?}");
                    self.see(id, &change, &who);
                }
                Fact { what: What::Printer { name, change: PrinterChange::Clear(_) }, .. } => {
                    self.not_clear.remove(&name);
                }
                Fact { what: What::Printer { name, change: PrinterChange::Doubt }, .. } => {
                    self.not_clear.insert(name);
                }
                _ => {}
            }
        }
    }

    fn see(&mut self, id: JobId, change: &Change, who: &Who) {
        self.kinds.insert(change.kind());
        match (change, who) {
            (Change::Lay, Who::Appliance(printer)) => {
                assert!(self.not_clear.insert(printer.clone()), "laid onto a bed that is not clear: {id}");
            }
            (Change::Printed { .. }, _) => *self.n_printed.entry(id).or_default() += 1,
            (Change::Reject, _) => drop(self.n_printed.insert(id, 0)),
            _ => {}
        }
    }

    /// No bed is clear by itself; a job that is printed, or is, has one bed; as many copies count as were printed.
    async fn assert_beds_and_jobs_agree(&self, store: &impl Store) {
        let printers = store.printers().await.unwrap();
        for printer in printers.iter().filter(|printer| printer.bed == Bed::Clear) {
            assert!(!self.not_clear.contains(&printer.name), "{printer:?}");
        }
        for job in store.list(Which::Live, None, 1000).await.unwrap() {
            assert_eq!(job.n_printed, self.n_printed.get(&job.id).copied().unwrap_or(0), "{job:?}");
            let is_waiting = matches!(job.state, State::Queued | State::Held);
            assert!(job.n_printed < job.wishes.copies || !is_waiting, "{job:?}");
            if job.state.is_at_printer() || job.state == State::AwaitingBedClear {
                let is_its = |p: &&Printer| p.bed == Bed::Taken(job.id) && job.is_on(&p.name);
                assert_eq!(printers.iter().filter(is_its).count(), 1, "{job:?}");
            }
        }
    }
}

async fn step(
    store: &impl Store,
    dice: &mut Dice,
    claims: &mut Vec<Claim>,
    number: u16,
    clock: i64,
) -> Result<(), Error> {
    let host = name(["left", "right"][usize::from(dice.below(2) == 0)]);
    let keep =
        |claimed: Vec<Claimed>, claims: &mut Vec<Claim>| claims.extend(claimed.into_iter().map(|c| c.claim));
    match dice.below(10) {
        0 => store.add(any_ticket(number, dice, clock), dice.below(2) == 0, operator(clock)).await.map(drop),
        1 => store.say(host, any_word(dice), operator(clock)).await.map(drop),
        2 => {
            keep(store.claim(Claimant::Worker(host), at(clock)).await?.into_iter().collect(), claims);
            Ok(())
        }
        3 => {
            keep(claim_as_the_rule_says(store, host, clock).await?.into_iter().collect(), claims);
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
            let (job, _) = store.job(claim.job).await?;
            let change =
                if dice.below(3) > 0 { what_comes_next(&job, dice) } else { any_change(dice, clock) };
            store.change(claim.job, holds(&claim, change, clock)).await.map(drop)
        }
        _ => {
            let saw = store.job(id(number)).await?.0.state;
            let change = match (saw, dice.below(4)) {
                (State::AwaitingSignOff, 0 | 1) => Change::Accept,
                (State::AwaitingSignOff, _) => Change::Reject,
                (State::Failed | State::Cancelled, 0 | 1) => Change::Retry,
                (State::Held, 0 | 1) => Change::Release,
                _ => any_change(dice, clock),
            };
            store.change(id(number), asks(change, saw, clock)).await.map(drop)
        }
    }
}

/// What a printer is given is what the rule of the schedule gives it.
async fn claim_as_the_rule_says(
    store: &impl Store,
    host: Name,
    clock: i64,
) -> Result<Option<Claimed>, Error> {
    let (jobs, printers) = (store.list(Which::Live, None, 1000).await?, store.printers().await?);
    let printer = printers.iter().find(|printer| printer.name == host);
    let expected =
        printer.and_then(|printer| schedule::next(printer, &jobs, at(clock)).ok()).map(|job| job.id);
    let claimed = store.claim(Claimant::Printer(host), at(clock)).await;
    let found = claimed.as_ref().ok().and_then(|claimed| claimed.as_ref()).map(|claimed| claimed.job.id);
    assert_eq!(found, expected);
    claimed
}

fn any_claim(claims: &[Claim], dice: &mut Dice) -> Claim {
    let newest = claims.len().saturating_sub(4);
    let n = u64::try_from(claims.len() - newest).unwrap();
    claims[newest + usize::try_from(dice.below(n)).unwrap()].clone()
}

fn any_ticket(number: u16, dice: &mut Dice, clock: i64) -> Ticket {
    let not_before = (dice.below(4) == 0).then(|| at(clock + 100));
    let copies = u16::try_from(dice.below(4)).unwrap();
    let wishes = Wishes { copies, not_before, sign_off: dice.below(3) > 0, ..Wishes::default() };
    let made = (dice.below(2) == 0).then(|| any_made(dice));
    Ticket { wishes, made, ..ticket(number) }
}

fn any_made(dice: &mut Dice) -> Made {
    let mut made = made();
    made.needs.material = (dice.below(3) == 0).then(|| Material::try_new("PLA").unwrap());
    made.estimate.filament_mm3 *= 1 + dice.below(4);
    made
}

fn any_word(dice: &mut Dice) -> Said {
    match dice.below(6) {
        0 => Said::BedInDoubt,
        1 | 2 => {
            let material = Material::try_new(["ABS", "PLA"][usize::from(dice.below(3) == 0)]).unwrap();
            let left_mm3 = [None, Some(25_000), Some(1_000_000)][usize::try_from(dice.below(3)).unwrap()];
            Said::Loaded(Loaded { material, left_mm3, ..loaded() })
        }
        _ => Said::BedClear(Evidence::Word),
    }
}

/// What an appliance asks for where all goes well.
fn what_comes_next(job: &Job, dice: &mut Dice) -> Change {
    match job.state {
        State::Preparing => Change::Prepared(any_made(dice)),
        State::Paused => Change::GoOn,
        _ if !job.is_laid => Change::Lay,
        _ if dice.below(6) == 0 => Change::Pause,
        _ => Change::Printed { used_mm3: None },
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
        9 => Change::Prepared(any_made(dice)),
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
