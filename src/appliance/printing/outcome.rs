//! What becomes of a job, and of the heaters, when its print has ended: pure.
//!
#![doc = include_str!("outcome.md")]
//!
//! [`outcome`] is the table, exhaustive; a test keeps the text above the same. Three things hold in all of it: what somebody has said, or
//! a limit, ends the print for good, however it ended in fact; what can be gone on with is kept as long as nobody has; no
//! heater is left on but that of a print that waits, which has a deadline.

use crate::printer::Error;
use crate::queue::{Change, Name, Reason};

/// Why a print was asked to stop.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Cause {
    /// A person wants it.
    Asked {
        /// Who.
        by: Name,
        /// Why.
        why: Reason,
    },
    /// The server ends.
    Stopping,
    /// It went beyond a limit, in these words.
    Limit(String),
    /// It may not lay material, for this reason.
    NotLet(String),
    /// It is not this printer's any more.
    ClaimLost,
}

impl Cause {
    /// For the log: what people write may name somebody, and stays in the queue.
    pub(super) const fn word(&self) -> &'static str {
        match self {
            Self::Asked { .. } => "asked",
            Self::Stopping => "stopping",
            Self::Limit(_) => "limit",
            Self::NotLet(_) => "not let",
            Self::ClaimLost => "claim lost",
        }
    }
}

/// How a print ended, as far as it matters for its job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Manner {
    /// The printer says that all is done.
    Finished,
    /// It was given up on request.
    GivenUp,
    /// The job cannot be printed as it is.
    BadJob,
    /// Port, journal or printer failed.
    Failed,
}

impl Manner {
    pub(super) const fn of(error: &Error) -> Self {
        match error {
            Error::Cancelled { .. } | Error::Left { .. } => Self::GivenUp,
            Error::Job(_) | Error::JobLost(_) => Self::BadJob,
            _ => Self::Failed,
        }
    }
}

/// What lies on the bed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    /// Nothing, as the queue knows.
    Nothing,
    /// A part that its journal knows how to go on with.
    Unfinished,
    /// A part that nobody can go on with.
    Dead,
}

/// Whether the print began, or went on with one that had broken off: then the printer was warm before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Begun {
    Anew,
    Again,
}

/// What is known of the heaters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Heat {
    /// They are off.
    Off,
    /// Nothing was sent: they are as they were before the print.
    Untouched,
    /// They may be on.
    Unknown,
}

impl Heat {
    pub(super) const fn of(error: &Error) -> Self {
        let told = match error {
            Error::Cancelled { heat } | Error::Fault { heat, .. } | Error::Refused { heat, .. } => heat,
            Error::JobLost(lost) => &lost.heat,
            Error::Job(_)
            | Error::Open { .. }
            | Error::Journal(_)
            | Error::BeingPrinted { .. }
            | Error::OtherJob { .. }
            | Error::NeedsConsent { .. }
            | Error::NotResumable(_)
            | Error::Unfinished { .. }
            | Error::Left { .. }
            | Error::OtherMachine { .. } => return Self::Untouched,
            Error::PortVanished { .. }
            | Error::Nobody { .. }
            | Error::StillHeating { .. }
            | Error::Simulator { .. } => return Self::Unknown,
        };
        if told.is_safe() { Self::Off } else { Self::Unknown }
    }
}

/// What is known of a print that has ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Facts {
    pub(super) manner: Manner,
    /// What went wrong, in words without paths.
    pub(super) said: String,
    /// Why it was asked to stop.
    pub(super) cause: Option<Cause>,
    pub(super) part: Part,
    pub(super) begun: Begun,
    pub(super) heat: Heat,
}

/// What is to be done.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Outcome {
    pub(super) job: Job,
    pub(super) heaters: Heaters,
}

impl Outcome {
    /// The print waits, warm, for this reason.
    pub(super) const fn waits(why: String) -> Self {
        Self { job: Job::Waits(why), heaters: Heaters::Keep }
    }
}

/// What becomes of the job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Job {
    /// This is recorded.
    Change { change: Change, by: Option<Name>, why: String },
    /// It waits for an operator's word, for this reason.
    Waits(String),
    /// Nothing: it is somebody else's.
    Lost,
}

/// What is done about the heaters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Heaters {
    /// Nothing: they are off.
    Off,
    /// Nothing yet: a print waits, and has a deadline.
    Keep,
    /// They are switched off, at once.
    SwitchOff,
}

/// Decides.
pub(super) fn outcome(facts: Facts) -> Outcome {
    let (heat, begun) = (facts.heat, facts.begun);
    let job = job(facts);
    let heaters = match (heat, begun) {
        (Heat::Off, _) | (Heat::Untouched, Begun::Anew) => Heaters::Off,
        _ if matches!(job, Job::Waits(_)) => Heaters::Keep,
        (Heat::Untouched, Begun::Again) | (Heat::Unknown, _) => Heaters::SwitchOff,
    };
    Outcome { job, heaters }
}

fn job(facts: Facts) -> Job {
    let Facts { manner, said, cause, part, .. } = facts;
    let used_mm3 = if part == Part::Nothing { Some(0) } else { None };
    let record = |change, by, why| Job::Change { change, by, why };
    let failed = |why| record(Change::Fail { used_mm3 }, None, why);
    let given_back = |why| record(Change::GiveBack { lost: false }, None, why);
    match (manner, part, cause) {
        (_, _, Some(Cause::ClaimLost)) => Job::Lost,
        (Manner::Finished, Part::Nothing, _) => {
            failed("the job has ended without laying material".to_owned())
        }
        (Manner::Finished, _, _) => record(Change::Printed { used_mm3: None }, None, String::new()),
        (_, _, Some(Cause::Asked { by, why })) => {
            record(Change::Cancel { used_mm3 }, Some(by), why.as_str().to_owned())
        }
        (_, _, Some(Cause::Limit(why))) => failed(why),
        (Manner::BadJob, _, _) => failed(said),
        (_, Part::Nothing, Some(Cause::NotLet(why))) => given_back(why),
        (_, _, Some(Cause::NotLet(why))) => failed(why),
        (_, Part::Nothing, Some(Cause::Stopping)) => given_back("the server ends".to_owned()),
        (Manner::GivenUp, _, Some(Cause::Stopping)) => failed("the server was asked to stop".to_owned()),
        (Manner::GivenUp, _, None) => failed("it was stopped at the printer".to_owned()),
        (Manner::Failed, Part::Nothing, None) => given_back(said),
        (Manner::Failed, Part::Unfinished, _) => Job::Waits(said),
        (Manner::Failed, Part::Dead, _) => failed(said),
    }
}

#[cfg(test)]
mod tests;
