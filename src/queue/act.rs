//! One change as a whole: who may ask for it, the job after it, its claim, the bed, and what is to be recorded.
//!
//! Pure: a store reads a [`Scene`], asks here, and writes the [`Outcome`] in the same transaction, so that every store decides
//! the same. The safety of unattended printing is decided here:
//!
//! - a printer takes a job only onto a bed that is known to be clear, and the bed is taken from then on;
//! - material is laid only under a claim that is still good, with what fits still loaded, onto a bed that nobody has doubted since it
//!   was taken, and recorded before it is laid;
//! - a bed that was taken, or doubted, is clear again by a word, a sensor or a hook alone, or where a job that nobody doubted leaves
//!   it without having laid anything;
//! - a job of which material was laid goes back into the queue only by an operator's `retry`;
//! - what a printer has in hand is ended by that printer, or by an operator once it has not been heard of for too long.

use super::claim::{Claim, Claimant, MOST_LOST};
use super::fact::{Fact, What, Who};
use super::fit;
use super::job::{Change, Edit, Job, Ticket};
use super::printer::{Evidence, Printer, PrinterChange};
use super::state::{Kind, Role, State};
use super::{JobId, Loaded, Name, Rank, Reason, Refusal};
use jiff::Timestamp;

/// Who asks for a change.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Actor {
    /// A person, who acts upon what the job was at when it was looked at.
    Operator {
        /// The person.
        name: Name,
        /// What the job was at.
        saw: State,
    },
    /// The appliance that has the job.
    Holder {
        /// Its claim.
        claim: Claim,
        /// The person who asked the appliance for it.
        asked_by: Option<Name>,
    },
    /// A rule of the program.
    Policy {
        /// The rule.
        name: Name,
        /// What the job was at.
        saw: State,
    },
}

impl Actor {
    const fn role(&self) -> Role {
        match self {
            Self::Operator { .. } => Role::Operator,
            Self::Holder { .. } => Role::Holder,
            Self::Policy { .. } => Role::Policy,
        }
    }

    fn who(&self) -> Who {
        match self {
            Self::Operator { name, .. } | Self::Holder { asked_by: Some(name), .. } => {
                Who::Operator(name.clone())
            }
            Self::Holder { claim, asked_by: None } => Who::Appliance(claim.holder.clone()),
            Self::Policy { name, .. } => Who::Policy(name.clone()),
        }
    }
}

/// Something that is asked of a job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Request {
    /// What.
    pub change: Change,
    /// By whom.
    pub actor: Actor,
    /// Why.
    pub why: Reason,
    /// When.
    pub now: Timestamp,
}

/// Something that is said of a printer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Said {
    /// This is what it is fitted with from now on.
    Loaded(Loaded),
    /// Its bed is clear, whatever lay there.
    BedClear(Evidence),
    /// Its bed is clear of this job: what is said once more, because the answer was lost, does not clear the bed of the next one.
    BedClearOf(JobId, Evidence),
    /// Whether its bed is clear is not known any more.
    BedInDoubt,
}

/// Who does something that needs no look at a job, and when.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct By {
    /// Who.
    pub who: Who,
    /// Why.
    pub why: Reason,
    /// When.
    pub now: Timestamp,
}

impl By {
    fn records(&self, what: What) -> Fact {
        Fact { at: self.now, who: self.who.clone(), why: self.why.clone(), what }
    }
}

/// What a change of a job touches.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Scene {
    /// The job.
    pub job: Job,
    /// Who has it.
    pub claim: Option<Claim>,
    /// The printer that has it, or is about to.
    pub printer: Option<Printer>,
}

/// What is to be written, all or nothing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outcome {
    /// The job, its claim and its printer as they are now.
    pub scene: Scene,
    /// What is to be recorded, in this order.
    pub facts: Vec<Fact>,
}

/// A new job: a draft, or in the queue at once.
///
/// # Errors
/// [`Refusal`] where its wishes cannot be.
pub fn add(ticket: &Ticket, rank: Rank, is_submitted: bool, by: &By) -> Result<Outcome, Refusal> {
    let Ticket { id, spec, wishes, made } = ticket;
    let (spec, wishes, made) = (spec.mark(), wishes.clone(), made.clone());
    let job = Job::new(*id, spec, wishes.clone(), made.clone(), rank.clone(), by.now)?;
    let added = by.records(What::Added { id: *id, spec, wishes, made, rank });
    let scene = Scene { job, claim: None, printer: None };
    if !is_submitted {
        return Ok(Outcome { scene, facts: vec![added] });
    }
    let Outcome { scene, mut facts } = happen(&scene, &Change::Submit, None, by)?;
    facts.insert(0, added);
    Ok(Outcome { scene, facts })
}

/// What is asked of a job, but for moving it.
///
/// # Errors
/// [`Refusal`].
pub fn change(scene: &Scene, request: &Request) -> Result<Outcome, Refusal> {
    match request.change {
        Change::Edit(Edit::Rank(_)) => Err(Refusal::PlaceByHand),
        _ => place(scene, request),
    }
}

/// The same, to a place that the store has found free as well.
///
/// # Errors
/// [`Refusal`].
pub fn place(scene: &Scene, request: &Request) -> Result<Outcome, Refusal> {
    authorise(scene, request)?;
    let kind = request.change.kind();
    if matches!(kind, Kind::Accept | Kind::Reject | Kind::Fail) && request.why.is_empty() {
        return Err(Refusal::NoReason { change: kind });
    }
    if kind == Kind::Lay && scene.job.state.is_at_printer() {
        check_lay(scene)?;
    }
    let by = By { who: request.actor.who(), why: request.why.clone(), now: request.now };
    happen(scene, &request.change, scene.claim.clone(), &by)
}

fn authorise(scene: &Scene, request: &Request) -> Result<(), Refusal> {
    let (change, role) = (request.change.kind(), request.actor.role());
    if !change.is_open_to(role) {
        return Err(Refusal::NotForYou { change, role });
    }
    match &request.actor {
        Actor::Holder { claim, .. } => check_claim(scene, claim),
        Actor::Operator { saw, .. } | Actor::Policy { saw, .. } if *saw != scene.job.state => {
            Err(Refusal::ChangedMeanwhile { saw: *saw, found: scene.job.state })
        }
        Actor::Operator { .. } if scene.job.state.is_at_printer() && change != Kind::Edit => {
            check_lapsed(scene, request.now)
        }
        Actor::Policy { .. } if scene.job.state.is_claimed() => check_lapsed(scene, request.now),
        Actor::Operator { .. } | Actor::Policy { .. } => Ok(()),
    }
}

/// What held when the printer took the job holds still: minutes went by since, while it warmed up.
fn check_lay(scene: &Scene) -> Result<(), Refusal> {
    let Some(holder) = &scene.job.holder else { return Err(Refusal::ClaimLost) };
    check_printer(scene, holder)?.check_lay(scene.job.id)
}

/// The claim that is shown is the one that holds.
fn check_claim(scene: &Scene, shown: &Claim) -> Result<(), Refusal> {
    let is_good = scene.claim.as_ref().is_some_and(|held| {
        held.job == shown.job && held.token == shown.token && held.holder == shown.holder
    });
    if is_good { Ok(()) } else { Err(Refusal::ClaimLost) }
}

/// What an appliance has in hand is not taken from it while it lives.
fn check_lapsed(scene: &Scene, now: Timestamp) -> Result<(), Refusal> {
    match &scene.claim {
        Some(claim) if !claim.has_lapsed(now) => Err(Refusal::InHand { holder: claim.holder.clone() }),
        _ => Ok(()),
    }
}

/// An appliance takes a job; `token` is the number that the first record of this will have. For a printer, the scene has it.
///
/// # Errors
/// [`Refusal`] where the job is not to be had, not due, does not fit, or the bed is not known to be clear.
pub fn claim(scene: &Scene, claimant: &Claimant, token: u64, now: Timestamp) -> Result<Outcome, Refusal> {
    let by = By { who: Who::Appliance(claimant.name().clone()), why: Reason::default(), now };
    let change = match claimant {
        Claimant::Worker(name) => Change::Prepare { worker: name.clone() },
        Claimant::Printer(name) => {
            check_printer(scene, name)?;
            Change::Start { printer: name.clone() }
        }
    };
    happen(scene, &change, Some(new_claim(scene, claimant.name(), token, now)), &by)
}

fn new_claim(scene: &Scene, holder: &Name, token: u64, now: Timestamp) -> Claim {
    Claim { job: scene.job.id, holder: holder.clone(), token, until: Claim::until(now) }
}

/// The printer of this name, where the job fits it.
fn check_printer<'a>(scene: &'a Scene, name: &Name) -> Result<&'a Printer, Refusal> {
    let found = scene.printer.as_ref().filter(|printer| printer.name == *name);
    let printer = found.ok_or_else(|| Refusal::NoPrinter { printer: name.clone() })?;
    let made = scene.job.made.as_ref().ok_or(Refusal::NotPrepared)?;
    fit::check(&made.needs, &made.estimate, printer.loaded.as_ref())?;
    Ok(printer)
}

/// The appliance that had a job has come back and takes it up again under a new claim; the old one is void. Only whoever has made sure
/// that no other process of this name lives may ask for it. A job of which nothing was laid, and in the middle of which one holder after
/// the other ended, is given up instead: there is no claim then.
///
/// # Errors
/// [`Refusal::ClaimLost`] where the job is not this appliance's any more.
pub fn adopt(scene: &Scene, holder: &Name, token: u64, now: Timestamp) -> Result<Outcome, Refusal> {
    if scene.claim.as_ref().is_none_or(|claim| claim.holder != *holder) {
        return Err(Refusal::ClaimLost);
    }
    let (change, why) = if has_lost_too_many(&scene.job) {
        (Change::Fail { used_mm3: Some(0) }, "one holder after the other ended in the middle of it")
    } else {
        (Change::Adopt, "")
    };
    let by = By { who: Who::Appliance(holder.clone()), why: Reason::try_new(why)?, now };
    happen(scene, &change, Some(new_claim(scene, holder, token, now)), &by)
}

/// Whether the job, once more without a holder, is not left to do to the next one what it has done to those before. Not where material
/// was laid: only its own printer can go on.
fn has_lost_too_many(job: &Job) -> bool {
    !job.is_laid && job.n_lost.saturating_add(1) >= MOST_LOST
}

/// What becomes of a job whose holder has not been heard of for too long. `None`: nothing; material was laid, and only its own printer
/// can go on, or an operator can end it.
///
/// # Errors
/// [`Refusal`] where nobody has the job.
pub fn lost(scene: &Scene, now: Timestamp) -> Result<Option<Outcome>, Refusal> {
    let is_lapsed = scene.claim.as_ref().is_some_and(|claim| claim.has_lapsed(now));
    if scene.job.is_laid || !is_lapsed {
        return Ok(None);
    }
    let (change, why) = if has_lost_too_many(&scene.job) {
        (Change::Fail { used_mm3: Some(0) }, "one holder after the other was not heard of any more")
    } else {
        (Change::GiveBack { lost: true }, "its holder was not heard of any more")
    };
    let by = By { who: Who::Policy(Name::try_new("lease")?), why: Reason::try_new(why)?, now };
    happen(scene, &change, scene.claim.clone(), &by).map(Some)
}

/// Makes a change happen that somebody may ask for. `claim` holds on as long as the job is such that it can be claimed.
fn happen(scene: &Scene, change: &Change, claim: Option<Claim>, by: &By) -> Result<Outcome, Refusal> {
    let (mut job, fact) = step(&scene.job, change, by)?;
    let mut facts = vec![fact];
    let mut printer = scene.printer.clone();
    if let (Some(change), Some(before)) = (at_printer(&scene.job, change), &scene.printer) {
        printer = Some(before.apply(&change)?);
        facts.push(by.records(What::Printer { name: before.name.clone(), change }));
    }
    if job.is_printed_out() {
        let (ended, fact) = step(&job, &job.when_cleared(), by)?;
        job = ended;
        facts.push(fact);
    }
    let claim = claim.filter(|_| job.state.is_claimed());
    Ok(Outcome { scene: Scene { job, claim, printer }, facts })
}

/// A job after a change, and the record of it.
fn step(job: &Job, change: &Change, by: &By) -> Result<(Job, Fact), Refusal> {
    let after = job.apply(change, by.now)?;
    let what = What::Job { id: job.id, change: change.clone(), from: job.state, to: after.state };
    Ok((after, by.records(what)))
}

/// What a change of a job does to the printer that has it, or takes it.
fn at_printer(before: &Job, change: &Change) -> Option<PrinterChange> {
    let all_mm3 = before.estimate().map_or(0, |estimate| estimate.filament_mm3);
    match change {
        Change::Start { .. } => Some(PrinterChange::Take(before.id)),
        _ if !before.state.is_at_printer() => None,
        Change::GiveBack { .. } => Some(PrinterChange::Free(before.id)),
        // Whoever has used filament has laid it somewhere, whether that was recorded or not.
        Change::Cancel { used_mm3 } | Change::Fail { used_mm3 }
            if !before.is_laid && used_mm3.is_none_or(|used_mm3| used_mm3 == 0) =>
        {
            Some(PrinterChange::Free(before.id))
        }
        Change::Cancel { used_mm3 } | Change::Fail { used_mm3 } | Change::Printed { used_mm3 } => {
            Some(PrinterChange::Use(used_mm3.unwrap_or(all_mm3)))
        }
        _ => None,
    }
}

/// A printer, and the job on its bed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Bedside {
    /// The printer.
    pub printer: Printer,
    /// The job on its bed.
    pub job: Option<Job>,
}

/// What is said of a printer. Where a printed job waits for its bed, it goes on with it; one whose remains lie there does not.
///
/// # Errors
/// [`Refusal::NoEvidence`], [`Refusal::BedInUse`].
pub fn say(before: &Bedside, said: &Said, by: &By) -> Result<(Bedside, Vec<Fact>), Refusal> {
    let change = match said {
        Said::Loaded(loaded) => PrinterChange::Load(loaded.clone()),
        Said::BedInDoubt => PrinterChange::Doubt,
        Said::BedClear(evidence) => clear(*evidence, &by.who)?,
        Said::BedClearOf(job, evidence) => {
            before.printer.check_no_other(*job)?;
            clear(*evidence, &by.who)?
        }
    };
    let its = before.job.as_ref().filter(|job| job.is_on(&before.printer.name));
    let (job, fact) = match (&change, its) {
        (PrinterChange::Clear(_), Some(job)) => cleared(&before.printer, job, by)?,
        _ => (before.job.clone(), None),
    };
    let printer = before.printer.apply(&change)?;
    let said = by.records(What::Printer { name: printer.name.clone(), change });
    Ok((Bedside { printer, job }, std::iter::once(said).chain(fact).collect()))
}

fn clear(evidence: Evidence, who: &Who) -> Result<PrinterChange, Refusal> {
    match (evidence, who) {
        (Evidence::Word, Who::Operator(_)) | (Evidence::Sensor | Evidence::Hook, _) => {
            Ok(PrinterChange::Clear(evidence))
        }
        (Evidence::Word, Who::Appliance(_) | Who::Policy(_)) => Err(Refusal::NoEvidence),
    }
}

/// What the job becomes that a printer has, or whose last copy lay on its bed, which is clear now.
fn cleared(printer: &Printer, job: &Job, by: &By) -> Result<(Option<Job>, Option<Fact>), Refusal> {
    if job.state.is_at_printer() {
        return Err(Refusal::BedInUse { printer: printer.name.clone(), job: job.id });
    }
    let (after, fact) = step(job, &job.when_cleared(), by)?;
    Ok((Some(after), Some(fact)))
}
