//! A week of printing that nobody watches, on a made-up clock, with faults by chance: nothing unsafe ever happens.
//!
//! Two appliances draw from one queue while they crash, lose their clocks' time, fall silent, and see their prints fail. What truly is
//! on each bed is kept apart from what the queue believes, by its own rules; a person comes by now and then.

use super::act::{self, Bedside, Outcome, Scene};
use super::claim::{HEARTBEAT_S, LEASE_S};
use super::tests::{at, because, loaded, name, operator, ticket};
use super::*;
use std::collections::BTreeMap;

const WEEK_S: i64 = 7 * 24 * 3600;
const STEP_S: i64 = 10;

/// Numbers that look like chance, the same each time.
struct Dice(u64);

impl Dice {
    /// Something that happens once in so many times.
    fn once_in(&mut self, n: u64) -> bool {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33).is_multiple_of(n)
    }
}

/// What is kept: a store in a few lines.
#[derive(Default)]
struct Kept {
    jobs: BTreeMap<JobId, Job>,
    claims: BTreeMap<JobId, Claim>,
    printers: BTreeMap<Name, Printer>,
    records: Vec<Sealed>,
}

impl Kept {
    fn head(&self) -> Head {
        self.records.last().map_or(Head::EMPTY, Sealed::head)
    }

    fn record(&mut self, facts: Vec<Fact>) {
        for fact in facts {
            self.records.push(self.head().seal(fact));
        }
    }

    fn scene(&self, job: JobId, printer: Option<&Name>) -> Scene {
        let job = self.jobs[&job].clone();
        let at = printer.or(job.holder.as_ref().filter(|_| job.state.is_at_printer()));
        let printer = at.map(|name| self.printers[name].clone());
        Scene { claim: self.claims.get(&job.id).cloned(), printer, job }
    }

    fn put(&mut self, Outcome { scene, facts }: Outcome) {
        self.record(facts);
        match scene.claim {
            Some(claim) => drop(self.claims.insert(scene.job.id, claim)),
            None => drop(self.claims.remove(&scene.job.id)),
        }
        if let Some(printer) = scene.printer {
            self.printers.insert(printer.name.clone(), printer);
        }
        self.jobs.insert(scene.job.id, scene.job);
    }

    fn say(&mut self, printer: &Name, said: &Said, by: &By) -> Result<(), Refusal> {
        let known = self.printers.get(printer).cloned();
        let printer = known.unwrap_or_else(|| Printer::new(printer.clone()));
        let job = match printer.bed {
            Bed::Taken(id) => self.jobs.get(&id).cloned(),
            Bed::Clear | Bed::Unknown => None,
        };
        let (after, facts) = act::say(&Bedside { printer, job }, said, by)?;
        self.record(facts);
        self.printers.insert(after.printer.name.clone(), after.printer);
        self.jobs.extend(after.job.map(|job| (job.id, job)));
        Ok(())
    }

    fn in_order(&self) -> Vec<Job> {
        let mut jobs: Vec<_> = self.jobs.values().cloned().collect();
        schedule::sort(&mut jobs);
        jobs
    }

    fn sweep(&mut self, now: i64) -> usize {
        let jobs: Vec<_> = self.claims.keys().copied().collect();
        let lost = jobs.into_iter().filter_map(|job| act::lost(&self.scene(job, None), at(now)).unwrap());
        let lost: Vec<_> = lost.collect();
        let n_lost = lost.len();
        lost.into_iter().for_each(|outcome| self.put(outcome));
        n_lost
    }
}

/// An appliance: what it believes, and what really is.
struct Host {
    printer: Name,
    /// What it prints, and how far it is, s.
    work: Option<(Claim, i64)>,
    /// It is down, or not heard of, until then; whether it forgets what it did.
    away: Option<(i64, bool)>,
    last_beat: i64,
    /// How far its clock is off, s.
    clock_off: i64,
    /// What really lies on the bed.
    on_bed: Option<(JobId, u16)>,
    /// Somebody has doubted that the bed is clear, and nobody has looked since.
    is_doubted: bool,
}

/// What happened.
#[derive(Debug, Default, PartialEq, Eq)]
struct Summary {
    n_printed: usize,
    n_failed: usize,
    n_crashes: usize,
    n_silences: usize,
    n_clock_faults: usize,
    n_requeued: usize,
    n_taken_up: usize,
    n_claims_lost: usize,
    n_human_calls: usize,
    /// A doubt about a bed, said at any time.
    n_doubts: usize,
    /// A job was refused at the last moment, because the bed was doubted since it was taken.
    n_not_laid: usize,
    /// A copy was laid onto something, onto a bed in doubt, or twice without anybody's word; or the queue believes what is not so.
    n_unsafe: usize,
}

struct Week {
    kept: Kept,
    dice: Dice,
    hosts: Vec<Host>,
    summary: Summary,
    /// How often each copy was laid since an operator's last word on the job.
    laid: BTreeMap<(JobId, u16), usize>,
}

impl Week {
    fn new(seed: u64) -> Self {
        let host = |printer| Host {
            printer: name(printer),
            work: None,
            away: None,
            last_beat: 0,
            clock_off: 0,
            on_bed: None,
            is_doubted: false,
        };
        let hosts = vec![host("left"), host("right")];
        let mut week = Self {
            kept: Kept::default(),
            dice: Dice(seed),
            hosts,
            summary: Summary::default(),
            laid: BTreeMap::new(),
        };
        for number in 1..=80 {
            week.add(number);
        }
        for host in ["left", "right"] {
            let said = Said::Loaded(Loaded { left_mm3: None, ..loaded() });
            week.kept.say(&name(host), &said, &operator(0)).unwrap();
        }
        week
    }

    fn add(&mut self, number: u16) {
        let wishes = Wishes { copies: 1 + number % 3, ..Wishes::default() };
        let last = self.kept.in_order().last().map(|job| job.rank.clone());
        let rank = Rank::between(last.as_ref(), None);
        let by = operator(0);
        self.kept.put(act::add(&Ticket { wishes, ..ticket(number) }, rank, true, &by).unwrap());
    }

    fn run(mut self) -> Self {
        for now in (0..WEEK_S).step_by(10) {
            self.summary.n_requeued += self.kept.sweep(now);
            for idx in 0..self.hosts.len() {
                self.faults(idx, now);
                self.host(idx, now);
            }
            self.look_at_beds();
            if now % 1800 == 0 {
                self.person(now);
            }
        }
        self
    }

    /// What goes wrong, each now and then.
    fn faults(&mut self, idx: usize, now: i64) {
        let host = &mut self.hosts[idx];
        if host.away.is_some() {
            return;
        }
        let is_warming_up = host.work.as_ref().is_some_and(|(_, done_s)| *done_s <= 120);
        if self.dice.once_in(1500) {
            host.away = Some((now + 30 + LEASE_S * i64::from(self.dice.once_in(2)), true));
            self.summary.n_crashes += 1;
        } else if self.dice.once_in(2000) {
            host.away = Some((now + 3 * LEASE_S, false));
            self.summary.n_silences += 1;
        } else if self.dice.once_in(3000) {
            host.clock_off = if host.clock_off == 0 { -3600 } else { 0 };
            self.summary.n_clock_faults += 1;
        } else if self.dice.once_in(if is_warming_up { 60 } else { 1500 }) {
            host.is_doubted = true;
            self.summary.n_doubts += 1;
            self.kept.say(&host.printer, &Said::BedInDoubt, &operator(now)).unwrap();
        }
    }

    fn host(&mut self, idx: usize, now: i64) {
        match self.hosts[idx].away {
            // One that is only not heard of goes on with what it does, and asks for what it may do.
            Some((until, is_down)) if now < until => {
                if !is_down {
                    self.print(idx, now);
                }
                return;
            }
            Some((_, true)) => self.come_back(idx, now),
            Some((_, false)) | None => {}
        }
        self.hosts[idx].away = None;
        self.beat(idx, now);
        self.print(idx, now);
        if self.hosts[idx].work.is_none() {
            self.draw(idx, now);
        }
    }

    /// By its own clock.
    fn time(&self, idx: usize, now: i64) -> i64 {
        now + self.hosts[idx].clock_off
    }

    fn beat(&mut self, idx: usize, now: i64) {
        let until = Claim::until(at(self.time(idx, now)));
        let host = &mut self.hosts[idx];
        if now - host.last_beat < HEARTBEAT_S {
            return;
        }
        host.last_beat = now;
        let Some((claim, _)) = &host.work else { return };
        if let Some(kept) = self.kept.claims.get_mut(&claim.job).filter(|kept| kept.token == claim.token) {
            kept.until = until;
        }
    }

    /// After a crash: what was begun goes on, as its journal says; what was not is given back.
    fn come_back(&mut self, idx: usize, now: i64) {
        self.hosts[idx].work = None;
        let printer = self.hosts[idx].printer.clone();
        let held: Vec<_> = self.kept.claims.values().filter(|c| c.holder == printer).map(|c| c.job).collect();
        for job in held {
            let (token, time) = (self.kept.head().seq + 1, at(self.time(idx, now)));
            let outcome = act::adopt(&self.kept.scene(job, None), &printer, token, time).unwrap();
            let (claim, is_laid) = (outcome.scene.claim.clone(), outcome.scene.job.is_laid);
            self.kept.put(outcome);
            let Some(claim) = claim else { continue };
            self.summary.n_taken_up += 1;
            if is_laid {
                self.hosts[idx].work = Some((claim, 1800));
            } else {
                self.ask(idx, &claim, Change::GiveBack { lost: false }, now).unwrap();
            }
        }
    }

    fn draw(&mut self, idx: usize, now: i64) {
        let (printer, time) = (self.hosts[idx].printer.clone(), at(self.time(idx, now)));
        if matches!(self.kept.printers[&printer].bed, Bed::Taken(_)) {
            return;
        }
        let jobs = self.kept.in_order();
        let Ok(job) = schedule::next(&self.kept.printers[&printer], &jobs, time) else { return };
        let (token, claimant) = (self.kept.head().seq + 1, Claimant::Printer(printer.clone()));
        let outcome = act::claim(&self.kept.scene(job.id, Some(&printer)), &claimant, token, time).unwrap();
        self.hosts[idx].work = Some((outcome.scene.claim.clone().unwrap(), 0));
        self.kept.put(outcome);
    }

    fn ask(&mut self, idx: usize, claim: &Claim, change: Change, now: i64) -> Result<(), Refusal> {
        let actor = Actor::Holder { claim: claim.clone(), asked_by: None };
        let request = Request { change, actor, why: because("so it is"), now: at(self.time(idx, now)) };
        let outcome = act::change(&self.kept.scene(claim.job, None), &request)?;
        self.kept.put(outcome);
        Ok(())
    }

    /// Ten seconds of a print: two minutes to warm up, then material, an hour in all.
    fn print(&mut self, idx: usize, now: i64) {
        let Some((claim, done_s)) = self.hosts[idx].work.clone() else { return };
        self.hosts[idx].work = Some((claim.clone(), done_s + STEP_S));
        let asked = match done_s {
            120 => self.ask(idx, &claim, Change::Lay, now).map(|()| self.lay(idx, claim.job)),
            3600 => {
                self.hosts[idx].work = None;
                let printed = self.ask(idx, &claim, Change::Printed { used_mm3: None }, now);
                self.summary.n_printed += usize::from(printed.is_ok());
                printed
            }
            _ if self.dice.once_in(4000) => {
                self.hosts[idx].work = None;
                let failed = self.ask(idx, &claim, Change::Fail { used_mm3: None }, now);
                self.summary.n_failed += usize::from(failed.is_ok());
                failed
            }
            _ => Ok(()),
        };
        match asked {
            Ok(()) => {}
            Err(Refusal::ClaimLost) => {
                self.hosts[idx].work = None;
                self.summary.n_claims_lost += 1;
            }
            Err(Refusal::BedNotClear { .. }) => {
                self.hosts[idx].work = None;
                self.summary.n_not_laid += 1;
                self.ask(idx, &claim, Change::GiveBack { lost: false }, now).unwrap();
            }
            Err(other) => panic!("{other}"),
        }
    }

    /// Material really is laid.
    fn lay(&mut self, idx: usize, job: JobId) {
        let copy = self.kept.jobs[&job].n_printed + 1;
        let n_laid = self.laid.entry((job, copy)).or_default();
        *n_laid += 1;
        let host = &self.hosts[idx];
        self.summary.n_unsafe += usize::from(*n_laid > 1 || host.on_bed.is_some() || host.is_doubted);
        self.hosts[idx].on_bed = Some((job, copy));
    }

    /// What the queue believes of beds holds for what truly lies on them.
    fn look_at_beds(&mut self) {
        for host in &self.hosts {
            let believed = self.kept.printers[&host.printer].bed;
            self.summary.n_unsafe += usize::from(believed == Bed::Clear && host.on_bed.is_some());
        }
        for job in self.kept.jobs.values().filter(|job| job.state == State::AwaitingBedClear) {
            let lies_there =
                |host: &Host| job.is_on(&host.printer) && host.on_bed == Some((job.id, job.n_printed));
            self.summary.n_unsafe += usize::from(!self.hosts.iter().any(lies_there));
        }
    }

    /// Somebody comes by: clears beds where nothing prints, and lets failed jobs be tried again.
    fn person(&mut self, now: i64) {
        for host in &mut self.hosts {
            if host.work.is_none()
                && host.away.is_none()
                && self.kept.printers[&host.printer].bed != Bed::Clear
            {
                let cleared = self.kept.say(&host.printer, &Said::BedClear(Evidence::Word), &operator(now));
                if cleared.is_ok() {
                    (host.on_bed, host.is_doubted) = (None, false);
                    self.summary.n_human_calls += 1;
                }
            }
        }
        let failed: Vec<_> =
            self.kept.jobs.values().filter(|job| job.state == State::Failed).cloned().collect();
        for job in failed {
            let actor = Actor::Operator { name: name("Ada"), saw: State::Failed };
            let request = Request { change: Change::Retry, actor, why: Reason::default(), now: at(now) };
            let outcome = act::change(&self.kept.scene(job.id, None), &request).unwrap();
            self.kept.put(outcome);
            self.laid.remove(&(job.id, job.n_printed + 1));
            self.summary.n_human_calls += 1;
        }
    }

    fn assert_history_tells_all(&self) {
        history::verify(&self.kept.records, self.kept.head()).unwrap();
        let records: Vec<Record> = self.kept.records.iter().map(|sealed| sealed.record().unwrap()).collect();
        for job in self.kept.jobs.values() {
            let of_job = records.iter().filter(|r| r.fact.subject() == Subject::Job(job.id));
            assert_eq!(history::replay_job(of_job).unwrap().as_ref(), Some(job));
        }
        for printer in self.kept.printers.values() {
            let of_printer =
                records.iter().filter(|r| r.fact.subject() == Subject::Printer(printer.name.clone()));
            assert_eq!(history::replay_printer(of_printer).unwrap().as_ref(), Some(printer));
        }
    }
}

#[test]
fn a_week_with_faults_is_never_unsafe() {
    for seed in 1..=5 {
        let week = Week::new(seed).run();
        let summary = &week.summary;
        assert_eq!(summary.n_unsafe, 0, "{summary:?}");
        assert!(summary.n_printed > 80 && summary.n_failed > 5 && summary.n_taken_up > 5, "{summary:?}");
        assert!(
            summary.n_crashes > 50 && summary.n_silences > 20 && summary.n_clock_faults > 10,
            "{summary:?}"
        );
        assert!(summary.n_doubts > 50 && summary.n_not_laid > 0, "{summary:?}");
        assert!(summary.n_requeued > 0 && summary.n_claims_lost > 0, "{summary:?}");
        week.assert_history_tells_all();
    }
}
