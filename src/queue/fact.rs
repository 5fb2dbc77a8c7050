//! What is recorded: who did what, when and why.

use super::job::{Change, Made, SpecMark, Wishes};
use super::printer::PrinterChange;
use super::state::State;
use super::{JobId, Name, Rank, Reason};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

/// Who did it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Who {
    /// A person.
    Operator(Name),
    /// A printer or a worker.
    Appliance(Name),
    /// A rule of the program.
    Policy(Name),
}

impl std::fmt::Display for Who {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Operator(name) => write!(f, "{name}"),
            Self::Appliance(name) => write!(f, "appliance {name}"),
            Self::Policy(name) => write!(f, "policy {name}"),
        }
    }
}

/// What was done.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum What {
    /// A job was added, as a draft.
    Added {
        /// The job.
        id: JobId,
        /// Its specification.
        spec: SpecMark,
        /// What the operator decided.
        wishes: Wishes,
        /// Its G-code, where it brought any.
        made: Option<Made>,
        /// Its place.
        rank: Rank,
    },
    /// A job changed.
    Job {
        /// The job.
        id: JobId,
        /// How.
        change: Change,
        /// What it was at.
        from: State,
        /// What it is at.
        to: State,
    },
    /// A printer changed.
    Printer {
        /// The printer.
        name: Name,
        /// How.
        change: PrinterChange,
    },
}

/// Whose history something is part of.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Subject {
    /// A job's.
    Job(JobId),
    /// A printer's.
    Printer(Name),
}

impl std::fmt::Display for Subject {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Job(id) => write!(f, "job {id}"),
            Self::Printer(name) => write!(f, "printer {name}"),
        }
    }
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fact {
    /// When, by the clock of whoever did it.
    pub at: Timestamp,
    /// Who did it.
    pub who: Who,
    /// Why.
    pub why: Reason,
    /// What was done.
    pub what: What,
}

impl Fact {
    /// Whose history it is part of.
    #[must_use]
    pub fn subject(&self) -> Subject {
        match &self.what {
            What::Added { id, .. } | What::Job { id, .. } => Subject::Job(*id),
            What::Printer { name, .. } => Subject::Printer(name.clone()),
        }
    }
}
