//! Jobs: how they are listed, added and changed.

use crate::queue::fact::{Subject, What};
use crate::queue::{
    Digest, Estimate, Fact, Job, JobId, Material, Name, Needs, Reason, SpecKind, State, Wishes,
};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What a job asks of the printer; `null`: any will do.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NeedsView {
    /// The profile its G-code is made for.
    #[schema(value_type = Option<String>)]
    pub profile: Option<Name>,
    /// The material.
    #[schema(value_type = Option<String>)]
    pub material: Option<Material>,
    /// Diameter of the nozzle, µm.
    pub nozzle_um: Option<u32>,
}

impl From<Needs> for NeedsView {
    fn from(Needs { profile, material, nozzle_um }: Needs) -> Self {
        Self { profile, material, nozzle_um }
    }
}

impl From<NeedsView> for Needs {
    fn from(NeedsView { profile, material, nozzle_um }: NeedsView) -> Self {
        Self { profile, material, nozzle_um }
    }
}

/// What a copy takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EstimateView {
    /// Print time, s.
    pub print_s: u32,
    /// Filament, mm³.
    pub filament_mm3: u64,
}

impl From<Estimate> for EstimateView {
    fn from(Estimate { print_s, filament_mm3 }: Estimate) -> Self {
        Self { print_s, filament_mm3 }
    }
}

/// What an operator decides about a new job; all of it may be left out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WishesBody {
    /// Higher goes first.
    pub priority: i8,
    /// No copy starts before this time.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub not_before: Option<Timestamp>,
    /// How often it is printed, from 1.
    pub copies: u16,
    /// Whether somebody accepts or rejects the report at the end.
    pub sign_off: bool,
    /// What it asks of the printer.
    pub needs: NeedsView,
}

impl Default for WishesBody {
    fn default() -> Self {
        let needs = NeedsView::default();
        Self { priority: 0, not_before: None, copies: 1, sign_off: false, needs }
    }
}

impl From<WishesBody> for Wishes {
    fn from(body: WishesBody) -> Self {
        let WishesBody { priority, not_before, copies, sign_off, needs } = body;
        Self { priority, not_before, copies, sign_off, needs: needs.into(), estimate: None }
    }
}

/// A job to be made of something on the server's own disk.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Added {
    /// Absolute path of a case directory, a G-code file or a mesh; it is kept nowhere but in the private state directory.
    pub path: String,
    /// The job's name, a UUID version 7, where the caller makes it: the same again adds nothing.
    #[serde(default)]
    #[schema(value_type = Option<String>)]
    pub id: Option<JobId>,
    /// What is decided about it.
    #[serde(default)]
    pub wishes: WishesBody,
    /// Whether it goes into the queue at once, or waits as a draft.
    #[serde(default)]
    pub submit: bool,
    /// Why.
    #[serde(default)]
    #[schema(value_type = String)]
    pub why: Reason,
}

/// A job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct JobView {
    /// Its name.
    #[schema(value_type = String)]
    pub id: JobId,
    /// What it is at.
    #[schema(value_type = String, example = "queued")]
    pub state: State,
    /// What its specification describes: `case`, `gcode` or `mesh`.
    #[schema(value_type = String, example = "gcode")]
    pub kind: SpecKind,
    /// Higher goes first.
    pub priority: i8,
    /// No copy starts before this time.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub not_before: Option<Timestamp>,
    /// How often it is printed.
    pub copies: u16,
    /// Copies that are printed.
    pub n_printed: u16,
    /// Whether somebody accepts or rejects the report at the end.
    pub sign_off: bool,
    /// What it asks of the printer.
    pub needs: NeedsView,
    /// What a copy takes, as far as that is known.
    pub estimate: Option<EstimateView>,
    /// Whether its G-code is ready.
    pub is_prepared: bool,
    /// Whether material of the present copy was laid, or may have been.
    pub is_laid: bool,
    /// The worker or printer that has it, or on whose bed it lies.
    #[schema(value_type = Option<String>)]
    pub holder: Option<Name>,
    /// When it was added.
    #[schema(value_type = String, format = DateTime)]
    pub added: Timestamp,
    /// When it changed last.
    #[schema(value_type = String, format = DateTime)]
    pub changed: Timestamp,
    /// How often it has changed.
    pub revision: u32,
}

impl From<&Job> for JobView {
    fn from(job: &Job) -> Self {
        Self {
            id: job.id,
            state: job.state,
            kind: job.spec.kind,
            priority: job.wishes.priority,
            not_before: job.wishes.not_before,
            copies: job.wishes.copies,
            n_printed: job.n_printed,
            sign_off: job.wishes.sign_off,
            needs: job.needs().clone().into(),
            estimate: job.estimate().map(Into::into),
            is_prepared: job.made.is_some(),
            is_laid: job.is_laid,
            holder: job.holder.clone(),
            added: job.added,
            changed: job.changed,
            revision: job.revision,
        }
    }
}

/// A part of a listing.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct JobList {
    /// Live ones in the order of the queue; those that are over, the last one first.
    pub jobs: Vec<JobView>,
    /// Whether there are more behind the last one.
    pub more: bool,
}

/// Where a job is moved to, among those of its priority.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Move {
    /// Before all others.
    First,
    /// Behind all others.
    Last,
    /// Just before this one.
    Before(JobId),
    /// Just behind this one.
    Behind(JobId),
}

/// What is asked of a job. What a printer has in hand is asked of that printer: `cancel`, `pause` and `go-on` are answered with 202 then,
/// and happen when the printer has done so.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Turn {
    /// A draft goes into the queue.
    Submit,
    /// Keep it back.
    Hold,
    /// No longer.
    Release,
    /// Call it off.
    Cancel,
    /// Once more, from the copy that failed.
    Retry,
    /// Give it up: its printer is not heard of any more. Needs a reason.
    Fail,
    /// Stop for a while.
    Pause,
    /// Go on.
    GoOn,
    /// Sign off: the report is good. Needs a name and a reason.
    Accept,
    /// Sign off: the report is not. Needs a name and a reason.
    Reject,
    /// Higher goes first.
    Priority(i8),
    /// No copy starts before this time.
    NotBefore {
        /// Then; `null`: at any time.
        #[schema(value_type = Option<String>, format = DateTime)]
        at: Option<Timestamp>,
    },
    /// How often it is printed.
    Copies(u16),
    /// To another place.
    Move(Move),
}

/// A change of a job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Anew {
    /// What.
    pub turn: Turn,
    /// What the job was at when it was looked at: refused where it has gone on since. Left out: whatever it is at.
    #[serde(default)]
    #[schema(value_type = Option<String>)]
    pub saw: Option<State>,
    /// The person who decides, where that is not whoever has the key.
    #[serde(default)]
    #[schema(value_type = Option<String>)]
    pub name: Option<Name>,
    /// Why.
    #[serde(default)]
    #[schema(value_type = String)]
    pub why: Reason,
}

/// A record of the history.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct HistoryView {
    /// Its number.
    pub seq: u64,
    /// When, by the clock of whoever did it.
    #[schema(value_type = String, format = DateTime)]
    pub at: Timestamp,
    /// Who did it.
    pub who: String,
    /// Why.
    #[schema(value_type = String)]
    pub why: Reason,
    /// The job, where it is one's.
    #[schema(value_type = Option<String>)]
    pub job: Option<JobId>,
    /// The printer, where it is one's.
    #[schema(value_type = Option<String>)]
    pub printer: Option<Name>,
    /// What was done.
    #[schema(value_type = Object)]
    pub what: What,
    /// Of this record and all before it.
    #[schema(value_type = String)]
    pub digest: Digest,
}

impl HistoryView {
    /// A record as it is shown.
    #[must_use]
    pub fn new(seq: u64, fact: Fact, digest: Digest) -> Self {
        let (job, printer) = match fact.subject() {
            Subject::Job(id) => (Some(id), None),
            Subject::Printer(name) => (None, Some(name)),
        };
        let Fact { at, who, why, what } = fact;
        Self { seq, at, who: who.to_string(), why, job, printer, what, digest }
    }
}

/// A part of the history.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct HistoryPage {
    /// In the order in which they were made.
    pub records: Vec<HistoryView>,
    /// Whether there are more behind the last one.
    pub more: bool,
}
