//! Anything, asked of anybody by anybody at any time.

use super::*;

const N_STEPS: u32 = 1500;

/// Anything, asked of anybody by anybody at any time: a refusal or a change of the table, never anything else; history and state
/// stay one.
pub(in crate::store) async fn whatever_happens_history_and_state_are_one<T: Site>(site: &T) {
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
            store.change(claim.job, holds(&claim, any_change(dice, clock), clock)).await.map(drop)
        }
        _ => {
            let saw = store.job(id(number)).await?.0.state;
            store.change(id(number), asks(any_change(dice, clock), saw, clock)).await.map(drop)
        }
    }
}

/// What a printer is given is what the rule of the schedule gives it.
async fn claim_as_the_rule_says(
    store: &impl Store,
    host: Name,
    clock: i64,
) -> Result<Option<Claimed>, Error> {
    let (jobs, printers) = (store.list(Which::Live, None, 100).await?, store.printers().await?);
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
    let wishes = Wishes { copies, not_before, sign_off: dice.below(2) == 0, ..Wishes::default() };
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
