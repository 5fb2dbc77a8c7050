//! How far a check of a store has come.

use crate::queue::{Head, Job, Printer, Subject};

/// How far [`super::Store::verify_part`] has come. The default is the beginning.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Progress(pub(super) Stage);

impl Default for Progress {
    fn default() -> Self {
        Self::behind(Head::EMPTY)
    }
}

impl Progress {
    /// Behind a head that was kept elsewhere: the records up to it are not read again for their sums, but the last of them has to be
    /// there as it was. Everything else is checked from the beginning.
    #[must_use]
    pub const fn behind(head: Head) -> Self {
        Self(Stage::Chain(head))
    }
}

/// What is checked, one after the other. Keys are those from which to go on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Stage {
    /// The chain of records, good up to here.
    Chain(Head),
    /// What is kept of each job and printer against its records.
    Subjects {
        /// The first one to look at.
        from: String,
    },
    /// The same, in the middle of one with many records.
    Within(Box<Replay>),
    /// That each row has records.
    Rows {
        /// Which of the tables.
        table: usize,
        /// The first row to look at.
        from: String,
    },
    /// What is no row of a job or printer.
    Rest,
}

/// What some records of a job or printer come to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Replay {
    /// Whose they are.
    pub(super) subject: Subject,
    /// The last one.
    pub(super) seq: u64,
    /// The last one with which an appliance took the job; 0: none did.
    pub(super) token: u64,
    /// Where it is a job.
    pub(super) job: Option<Job>,
    /// Where it is a printer.
    pub(super) printer: Option<Printer>,
}
