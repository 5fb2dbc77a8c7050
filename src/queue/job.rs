//! A job, and how a change changes it.
//!
//! A [`Job`] is what its history comes to: [`Job::new`], then [`Job::apply`] for each [`Change`]. Both are pure, so that a
//! history can be replayed. Who may ask for a change, and what becomes of claims and beds, is in [`super::act`].

use super::fit::{Estimate, Needs};
use super::state::{self, Kind, State};
use super::{Digest, Name, Rank, Refusal};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::str::FromStr;
use uuid::Uuid;

/// Longest specification, bytes.
const MAX_SPEC_BYTES: usize = 1 << 16;

/// A job's generated name (UUID version 7): tells when it was added, and nothing else.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct JobId(Uuid);

impl JobId {
    /// A new name, of the time and of chance. Times before 1970 count as 1970.
    #[must_use]
    pub fn at(now: Timestamp, chance: [u8; 10]) -> Self {
        let ms = u64::try_from(now.as_millisecond()).unwrap_or(0);
        Self(uuid::Builder::from_unix_timestamp_millis(ms, &chance).into_uuid())
    }
}

impl FromStr for JobId {
    type Err = uuid::Error;

    fn from_str(text: &str) -> Result<Self, uuid::Error> {
        Uuid::from_str(text).map(Self)
    }
}

impl TryFrom<String> for JobId {
    type Error = uuid::Error;

    fn try_from(text: String) -> Result<Self, uuid::Error> {
        text.parse()
    }
}

impl From<JobId> for String {
    fn from(id: JobId) -> Self {
        id.to_string()
    }
}

impl std::fmt::Display for JobId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.hyphenated().fmt(f)
    }
}

impl std::fmt::Debug for JobId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        std::fmt::Display::fmt(self, f)
    }
}

/// What a specification describes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SpecKind {
    /// A case directory.
    Case,
    /// A file of G-code.
    Gcode,
    /// A mesh with parameters.
    Mesh,
}

/// What is to be made, in words that only whoever prepares it understands: names of files under generated ids and parameters, never
/// meshes, never the names that files had.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Spec {
    kind: SpecKind,
    bytes: Vec<u8>,
}

impl Spec {
    /// A specification of at most 64 KiB.
    ///
    /// # Errors
    /// [`Refusal::SpecTooLarge`].
    pub fn try_new(kind: SpecKind, bytes: Vec<u8>) -> Result<Self, Refusal> {
        if bytes.len() > MAX_SPEC_BYTES {
            return Err(Refusal::SpecTooLarge { found: bytes.len(), most: MAX_SPEC_BYTES });
        }
        Ok(Self { kind, bytes })
    }

    /// What it describes.
    #[must_use]
    pub const fn kind(&self) -> SpecKind {
        self.kind
    }

    /// As it was given.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// What a job keeps of it.
    #[must_use]
    pub fn mark(&self) -> SpecMark {
        SpecMark { kind: self.kind, digest: Digest::of(&self.bytes) }
    }
}

/// Which specification a job has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpecMark {
    /// What it describes.
    pub kind: SpecKind,
    /// Of its bytes.
    pub digest: Digest,
}

/// G-code that is ready to print.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Made {
    /// Of its bytes: what is printed is what was prepared.
    pub gcode: Digest,
    /// What a copy takes.
    pub estimate: Estimate,
    /// What it asks of the printer.
    pub needs: Needs,
}

/// What an operator decides about a job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Wishes {
    /// Higher goes first.
    pub priority: i8,
    /// No copy starts before this time.
    pub not_before: Option<Timestamp>,
    /// How often it is printed, from 1.
    pub copies: u16,
    /// Whether somebody accepts or rejects the report at the end.
    pub sign_off: bool,
    /// What it asks of the printer, as far as that is known before it is prepared.
    pub needs: Needs,
    /// What a copy will take, as far as that is known before it is prepared.
    pub estimate: Option<Estimate>,
}

impl Default for Wishes {
    fn default() -> Self {
        let needs = Needs::default();
        Self { priority: 0, not_before: None, copies: 1, sign_off: false, needs, estimate: None }
    }
}

/// A job to be added.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Ticket {
    /// Its name; the same ticket added twice is one job.
    pub id: JobId,
    /// What is to be made.
    pub spec: Spec,
    /// What the operator decides.
    pub wishes: Wishes,
    /// Where there is nothing to prepare.
    pub made: Option<Made>,
}

/// What an operator changes about a job that is not over.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Edit {
    /// Higher goes first.
    Priority(i8),
    /// Its place among jobs of the same priority.
    Rank(Rank),
    /// No copy starts before this time.
    NotBefore(Option<Timestamp>),
    /// How often it is printed.
    Copies(u16),
}

/// What happens to a job. [`state`] has the table.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Change {
    /// See [`Kind::Submit`].
    Submit,
    /// See [`Kind::Edit`].
    Edit(Edit),
    /// See [`Kind::Hold`].
    Hold,
    /// See [`Kind::Release`].
    Release,
    /// See [`Kind::Cancel`].
    Cancel {
        /// Filament that was used up, mm³; `None`: not known, all that a copy takes is reckoned with.
        used_mm3: Option<u64>,
    },
    /// See [`Kind::Retry`].
    Retry,
    /// See [`Kind::Prepare`].
    Prepare {
        /// Who prepares it.
        worker: Name,
    },
    /// See [`Kind::Prepared`].
    Prepared(Made),
    /// See [`Kind::Start`].
    Start {
        /// Who prints it.
        printer: Name,
    },
    /// See [`Kind::Lay`].
    Lay,
    /// See [`Kind::Pause`].
    Pause,
    /// See [`Kind::GoOn`].
    GoOn,
    /// See [`Kind::Adopt`].
    Adopt,
    /// See [`Kind::Printed`].
    Printed {
        /// Filament that was used up, mm³; `None`: what was estimated.
        used_mm3: Option<u64>,
    },
    /// See [`Kind::GiveBack`].
    GiveBack {
        /// Whether its holder has not been heard of any more.
        lost: bool,
    },
    /// See [`Kind::Fail`].
    Fail {
        /// Filament that was used up, mm³; `None`: not known, all that a copy takes is reckoned with.
        used_mm3: Option<u64>,
    },
    /// See [`Kind::NextCopy`].
    NextCopy,
    /// See [`Kind::AskSignOff`].
    AskSignOff,
    /// See [`Kind::Complete`].
    Complete,
    /// See [`Kind::Accept`].
    Accept,
    /// See [`Kind::Reject`].
    Reject,
}

impl Change {
    /// Its row in the table.
    #[must_use]
    pub const fn kind(&self) -> Kind {
        match self {
            Self::Submit => Kind::Submit,
            Self::Edit(_) => Kind::Edit,
            Self::Hold => Kind::Hold,
            Self::Release => Kind::Release,
            Self::Cancel { .. } => Kind::Cancel,
            Self::Retry => Kind::Retry,
            Self::Prepare { .. } => Kind::Prepare,
            Self::Prepared(_) => Kind::Prepared,
            Self::Start { .. } => Kind::Start,
            Self::Lay => Kind::Lay,
            Self::Pause => Kind::Pause,
            Self::GoOn => Kind::GoOn,
            Self::Adopt => Kind::Adopt,
            Self::Printed { .. } => Kind::Printed,
            Self::GiveBack { .. } => Kind::GiveBack,
            Self::Fail { .. } => Kind::Fail,
            Self::NextCopy => Kind::NextCopy,
            Self::AskSignOff => Kind::AskSignOff,
            Self::Complete => Kind::Complete,
            Self::Accept => Kind::Accept,
            Self::Reject => Kind::Reject,
        }
    }
}

/// A job.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Job {
    /// Its name.
    pub id: JobId,
    /// What it is at.
    pub state: State,
    /// Which specification it has.
    pub spec: SpecMark,
    /// What the operator decides.
    pub wishes: Wishes,
    /// Its place among jobs of the same priority.
    pub rank: Rank,
    /// Its G-code; `None`: to be prepared.
    pub made: Option<Made>,
    /// Copies that are printed.
    pub n_printed: u16,
    /// Whether material of the present copy was laid, or may have been.
    pub is_laid: bool,
    /// How often in a row whoever held it was lost, or ended and came back, before anything came of it.
    pub n_lost: u8,
    /// Who has it: the worker that prepares it, or the printer on whose bed it is.
    pub holder: Option<Name>,
    /// When it was added.
    pub added: Timestamp,
    /// When it changed last.
    pub changed: Timestamp,
    /// How often it has changed.
    pub revision: u32,
}

impl Job {
    /// A draft.
    ///
    /// # Errors
    /// [`Refusal::Copies`] where it is to be printed no time.
    pub fn new(
        id: JobId,
        spec: SpecMark,
        wishes: Wishes,
        made: Option<Made>,
        rank: Rank,
        now: Timestamp,
    ) -> Result<Self, Refusal> {
        if wishes.copies == 0 {
            return Err(Refusal::Copies { found: 0, least: 1 });
        }
        Ok(Self {
            id,
            state: State::Draft,
            spec,
            wishes,
            rank,
            made,
            n_printed: 0,
            is_laid: false,
            n_lost: 0,
            holder: None,
            added: now,
            changed: now,
            revision: 0,
        })
    }

    /// What it asks of a printer, as far as that is known.
    #[must_use]
    pub fn needs(&self) -> &Needs {
        self.made.as_ref().map_or(&self.wishes.needs, |made| &made.needs)
    }

    /// What a copy takes, as far as that is known.
    #[must_use]
    pub fn estimate(&self) -> Option<Estimate> {
        self.made.as_ref().map(|made| made.estimate).or(self.wishes.estimate)
    }

    /// Copies still to be printed, the one in print included.
    #[must_use]
    pub const fn n_left(&self) -> u16 {
        self.wishes.copies.saturating_sub(self.n_printed)
    }

    /// Where it stands in the queue: less is printed earlier.
    #[must_use]
    pub fn order(&self) -> (i16, &Rank) {
        (-i16::from(self.wishes.priority), &self.rank)
    }

    /// Whether this printer has it, or has its last copy on the bed. Remains of a print that broke off are not meant: with them on
    /// one bed, the job may be in print on another.
    #[must_use]
    pub fn is_on(&self, printer: &Name) -> bool {
        (self.state.is_at_printer() || self.state == State::AwaitingBedClear)
            && self.holder.as_ref() == Some(printer)
    }

    /// Whether it waits, but for nothing: fewer copies are wanted now than were when the last one was printed.
    #[must_use]
    pub const fn is_printed_out(&self) -> bool {
        matches!(self.state, State::Queued | State::Held) && self.n_left() == 0
    }

    /// What follows once the bed is clear of its last copy, or no more are wanted: exactly one of three.
    #[must_use]
    pub const fn when_cleared(&self) -> Change {
        if self.n_left() > 0 {
            Change::NextCopy
        } else if self.wishes.sign_off {
            Change::AskSignOff
        } else {
            Change::Complete
        }
    }

    /// The job after a change.
    ///
    /// # Errors
    /// [`Refusal`] where the table has no such change or the job is not such that it can happen.
    pub fn apply(&self, change: &Change, now: Timestamp) -> Result<Self, Refusal> {
        let kind = change.kind();
        let refused = Refusal::NotInState { state: self.state, change: kind };
        let state = state::next(self.state, kind).ok_or(refused)?;
        self.check(change, now)?;
        let mut after =
            Self { state, changed: now, revision: self.revision.saturating_add(1), ..self.clone() };
        after.take(change);
        if !(state.is_claimed() || state == State::AwaitingBedClear) {
            after.holder = None;
        }
        Ok(after)
    }

    /// What a change asks for besides the state.
    fn check(&self, change: &Change, now: Timestamp) -> Result<(), Refusal> {
        match change {
            Change::Edit(Edit::Copies(found)) => self.check_copies(*found),
            Change::Prepare { .. } if self.made.is_some() => Err(Refusal::IsPrepared),
            Change::Start { .. } => self.check_start(now),
            Change::Lay | Change::GiveBack { .. } if self.is_laid => Err(Refusal::MaterialLaid),
            Change::Printed { .. } if !self.is_laid => Err(Refusal::NothingLaid),
            Change::NextCopy if self.n_left() == 0 => Err(Refusal::NoCopyLeft),
            Change::AskSignOff | Change::Complete if self.n_left() > 0 => Err(Refusal::CopiesLeft),
            Change::AskSignOff if !self.wishes.sign_off => Err(Refusal::SignOff { wanted: false }),
            Change::Complete if self.wishes.sign_off => Err(Refusal::SignOff { wanted: true }),
            _ => Ok(()),
        }
    }

    fn check_copies(&self, found: u16) -> Result<(), Refusal> {
        let n_begun = self.n_printed.saturating_add(u16::from(self.state.is_at_printer()));
        let least = n_begun.max(1);
        if found >= least { Ok(()) } else { Err(Refusal::Copies { found, least }) }
    }

    fn check_start(&self, now: Timestamp) -> Result<(), Refusal> {
        match self.wishes.not_before {
            _ if self.made.is_none() => Err(Refusal::NotPrepared),
            _ if self.is_laid => Err(Refusal::MaterialLaid),
            _ if self.n_left() == 0 => Err(Refusal::NoCopyLeft),
            Some(until) if now < until => Err(Refusal::NotDue { until }),
            _ => Ok(()),
        }
    }

    fn take(&mut self, change: &Change) {
        match change {
            Change::Edit(edit) => self.edit(edit),
            Change::Prepare { worker: holder } | Change::Start { printer: holder } => {
                self.holder = Some(holder.clone());
            }
            Change::Prepared(made) => {
                self.made = Some(made.clone());
                self.n_lost = 0;
            }
            Change::Lay => {
                self.is_laid = true;
                self.n_lost = 0;
            }
            Change::Printed { .. } => {
                self.n_printed = self.n_printed.saturating_add(1);
                self.is_laid = false;
            }
            // Whoever comes back to it has ended in the middle of it.
            Change::Adopt => self.n_lost = self.n_lost.saturating_add(u8::from(!self.is_laid)),
            Change::GiveBack { lost } => self.n_lost = self.n_lost.saturating_add(u8::from(*lost)),
            Change::Retry => {
                self.is_laid = false;
                self.n_lost = 0;
            }
            // None of its copies counts.
            Change::Reject => self.n_printed = 0,
            _ => {}
        }
    }

    fn edit(&mut self, edit: &Edit) {
        match edit {
            Edit::Priority(priority) => self.wishes.priority = *priority,
            Edit::Rank(rank) => self.rank = rank.clone(),
            Edit::NotBefore(until) => self.wishes.not_before = *until,
            Edit::Copies(copies) => self.wishes.copies = *copies,
        }
    }
}
