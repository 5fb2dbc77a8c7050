//! Why a change is not made; each with a stable code.

use super::fit::Misfit;
use super::state::{Kind, Role, State};
use super::{JobId, Name};
use jiff::Timestamp;

/// Why the queue does not do what it is asked for. Nothing is changed then.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// The table has no such change.
    #[error("a job that is {state} cannot take \"{change}\"")]
    NotInState {
        /// What the job is at.
        state: State,
        /// What was asked for.
        change: Kind,
    },
    /// Somebody else has to ask for it.
    #[error("\"{change}\" is not for this part ({}) to ask", role.words())]
    NotForYou {
        /// What was asked for.
        change: Kind,
        /// By whom.
        role: Role,
    },
    /// The job has gone on since it was looked at.
    #[error("the job was {saw} when it was looked at, it is {found} now: look again")]
    ChangedMeanwhile {
        /// What the asker saw.
        saw: State,
        /// What it is.
        found: State,
    },
    /// The claim has gone to somebody else, or is given up.
    #[error(
        "the claim is lost: the job is not this appliance's any more, and nothing more of it may be laid"
    )]
    ClaimLost,
    /// An appliance that is alive has the job: it has to be asked to stop.
    #[error("{holder} has the job and is alive: it has to stop first")]
    InHand {
        /// The printer that has it.
        holder: Name,
    },
    /// What has been laid lies there: the job never goes back into the queue by itself.
    #[error(
        "material was laid: the job does not go back into the queue by itself; look at the bed, then `retry`"
    )]
    MaterialLaid,
    /// No material was announced.
    #[error("a copy is not printed before material was laid")]
    NothingLaid,
    /// The G-code is not made yet.
    #[error("the job is not prepared yet")]
    NotPrepared,
    /// There is nothing to prepare.
    #[error("the job is prepared already")]
    IsPrepared,
    /// As many copies as asked for are printed.
    #[error("all copies are printed")]
    NoCopyLeft,
    /// Copies are left.
    #[error("copies are left to print")]
    CopiesLeft,
    /// Whether somebody signs off is decided when the job is added.
    #[error("sign-off is {}", if *.wanted { "asked for" } else { "not asked for" })]
    SignOff {
        /// Whether it is.
        wanted: bool,
    },
    /// Fewer copies than begun, or none.
    #[error("found {found} copies, expected at least {least}")]
    Copies {
        /// What was asked for.
        found: u16,
        /// What is possible.
        least: u16,
    },
    /// It is not time yet.
    #[error("not before {until}")]
    NotDue {
        /// When.
        until: Timestamp,
    },
    /// The bed of the printer is not known to be clear.
    #[error(
        "the bed of {printer} is not known to be clear; clear it and say so with `lumenfab queue clear-bed`"
    )]
    BedNotClear {
        /// The printer.
        printer: Name,
    },
    /// Another job has that bed, or a print is under way on it.
    #[error(
        "job {job} has the bed of {printer}: where it is at its end, take the part off and say so of this job"
    )]
    BedInUse {
        /// The printer.
        printer: Name,
        /// The job.
        job: JobId,
    },
    /// A bed is clear by a person's word, or by a routine that was confirmed.
    #[error("a bed is not clear by the word of an appliance: a sensor or a hook program has to confirm it")]
    NoEvidence,
    /// The printer is not the right one.
    #[error(transparent)]
    Misfit(#[from] Misfit),
    /// No such printer.
    #[error("there is no printer {printer}; say what it has loaded first")]
    NoPrinter {
        /// What was asked for.
        printer: Name,
    },
    /// Places are given by the store, so that no two jobs have the same.
    #[error("a job is moved by naming its neighbour, not its place")]
    PlaceByHand,
    /// A reason is needed.
    #[error("\"{change}\" needs a reason")]
    NoReason {
        /// What was asked for.
        change: Kind,
    },
    /// A text is empty where it may not be, too long, or not one line.
    #[error(
        "{what} has to be one line of at most {longest} characters, and not empty where it names something"
    )]
    Text {
        /// Of what.
        what: &'static str,
        /// Characters.
        longest: usize,
    },
    /// A specification is too large.
    #[error(
        "found a specification of {found} bytes, expected at most {most}: it names files, it does not hold them"
    )]
    SpecTooLarge {
        /// Bytes.
        found: usize,
        /// Bytes.
        most: usize,
    },
    /// Another job has this id.
    #[error("another job has the id {id}")]
    IdTaken {
        /// The id.
        id: JobId,
    },
    /// No such job.
    #[error("there is no job {id}")]
    NoJob {
        /// What was asked for.
        id: JobId,
    },
}

impl Refusal {
    /// A stable name for programs.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::NotInState { .. } => "queue.not_in_state",
            Self::NotForYou { .. } => "queue.not_for_you",
            Self::ChangedMeanwhile { .. } => "queue.changed_meanwhile",
            Self::ClaimLost => "queue.claim_lost",
            Self::InHand { .. } => "queue.in_hand",
            Self::MaterialLaid => "queue.material_laid",
            Self::NothingLaid => "queue.nothing_laid",
            Self::NotPrepared => "queue.not_prepared",
            Self::IsPrepared => "queue.is_prepared",
            Self::NoCopyLeft => "queue.no_copy_left",
            Self::CopiesLeft => "queue.copies_left",
            Self::SignOff { .. } => "queue.sign_off",
            Self::Copies { .. } => "queue.copies",
            Self::NotDue { .. } => "queue.not_due",
            Self::BedNotClear { .. } => "queue.bed_not_clear",
            Self::BedInUse { .. } => "queue.bed_in_use",
            Self::NoEvidence => "queue.no_evidence",
            Self::Misfit(_) => "queue.misfit",
            Self::NoPrinter { .. } => "queue.no_printer",
            Self::PlaceByHand => "queue.place_by_hand",
            Self::NoReason { .. } => "queue.no_reason",
            Self::Text { .. } => "queue.text",
            Self::SpecTooLarge { .. } => "queue.spec_too_large",
            Self::IdTaken { .. } => "queue.id_taken",
            Self::NoJob { .. } => "queue.no_job",
        }
    }
}
