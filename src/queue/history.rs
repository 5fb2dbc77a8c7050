//! The history: records that are only ever added, each with the sum of all before it.
//!
//! A record is its number and a [`Fact`] as JSON; its sum is BLAKE3 over the sum of the record before it and the bytes of the
//! record, under a purpose of its own. The sum of the last one is kept beside as the [`Head`], so that records cut off at the
//! end show, too. What was written is what is summed, byte by byte: a later version that writes facts otherwise does
//! not change old ones. Whoever can write all records and the head can forge them: a copy of the head elsewhere tells.
//!
//! [`replay_job`] and [`replay_printer`] bring back what a job or a printer is from its records alone.

use super::fact::{Fact, Subject, What};
use super::job::Job;
use super::printer::Printer;
use super::{Digest, Refusal};
use serde::{Deserialize, Serialize};

/// What these sums are for.
const PURPOSE: &str = "lumenfab queue history 1";

/// A record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    /// Its number, from 1.
    pub seq: u64,
    /// What it tells.
    pub fact: Fact,
}

/// A record as it is kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sealed {
    /// Its number.
    pub seq: u64,
    /// A [`Record`] as JSON.
    pub body: String,
    /// Of the body and all before it.
    pub digest: Digest,
}

/// The end of the history.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Head {
    /// Number of the last record; 0: there is none.
    pub seq: u64,
    /// Its sum.
    pub digest: Digest,
}

/// The first record that does not fit.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Break {
    /// Its bytes were changed, or those of its sum.
    #[error("record {seq} does not fit the sum it was written with: it was changed")]
    Changed {
        /// The record.
        seq: u64,
    },
    /// It is not there.
    #[error("record {seq} is missing: the next one found is {found}")]
    Missing {
        /// The record.
        seq: u64,
        /// What stands in its place.
        found: u64,
    },
    /// The last ones are not there, or some that nobody wrote are.
    #[error(
        "the history ends with record {found}, expected {expected}: records were cut off or added at its end"
    )]
    End {
        /// The last one that is there.
        found: u64,
        /// The last one that was written.
        expected: u64,
    },
    /// As many as there should be, but of another history.
    #[error("the last record, {seq}, is not the one that was written last")]
    OtherEnd {
        /// The record.
        seq: u64,
    },
    /// It fits its sum, but cannot be read.
    #[error("record {seq} cannot be read: {problem}")]
    Unreadable {
        /// The record.
        seq: u64,
        /// Why.
        problem: String,
    },
    /// It tells of something that cannot follow what the ones before it tell.
    #[error("record {seq} cannot follow what is recorded of {subject} before it: {problem}")]
    Impossible {
        /// The record.
        seq: u64,
        /// The job or printer.
        subject: Subject,
        /// Why.
        problem: String,
    },
    /// What is kept of a job or a printer is not what its records come to.
    #[error("{subject} is not what its records come to: it was changed")]
    Differs {
        /// The job or printer.
        subject: Subject,
    },
}

impl Head {
    /// Of a history without records.
    pub const EMPTY: Self = Self { seq: 0, digest: Digest::zero() };

    /// The next record, which is the new end.
    #[must_use]
    pub fn seal(self, fact: Fact) -> Sealed {
        let seq = self.seq + 1;
        let body =
            serde_json::to_string(&Record { seq, fact }).expect("facts are numbers, names and lists of them");
        let digest = Digest::chained(PURPOSE, &self.digest, body.as_bytes());
        Sealed { seq, body, digest }
    }

    /// The end behind a record, where it follows this one.
    ///
    /// # Errors
    /// [`Break`] where it does not.
    pub fn follow(self, sealed: &Sealed) -> Result<Self, Break> {
        let seq = self.seq + 1;
        if sealed.seq != seq {
            return Err(Break::Missing { seq, found: sealed.seq });
        }
        if Digest::chained(PURPOSE, &self.digest, sealed.body.as_bytes()) != sealed.digest {
            return Err(Break::Changed { seq });
        }
        if sealed.record()?.seq != seq {
            return Err(Break::Changed { seq });
        }
        Ok(sealed.head())
    }

    /// Whether this is where the history was left.
    ///
    /// # Errors
    /// [`Break`] where it is not.
    pub fn check_end(self, expected: Self) -> Result<(), Break> {
        if self.seq != expected.seq {
            return Err(Break::End { found: self.seq, expected: expected.seq });
        }
        if self == expected { Ok(()) } else { Err(Break::OtherEnd { seq: self.seq }) }
    }
}

impl Sealed {
    /// What it tells.
    ///
    /// # Errors
    /// [`Break::Unreadable`].
    pub fn record(&self) -> Result<Record, Break> {
        serde_json::from_str(&self.body)
            .map_err(|e| Break::Unreadable { seq: self.seq, problem: e.to_string() })
    }

    /// The end of a history that ends with it.
    #[must_use]
    pub const fn head(&self) -> Head {
        Head { seq: self.seq, digest: self.digest }
    }
}

/// Whether a history is whole and as it was written.
///
/// # Errors
/// [`Break`], the first record that does not fit.
pub fn verify<'a>(records: impl IntoIterator<Item = &'a Sealed>, head: Head) -> Result<(), Break> {
    records.into_iter().try_fold(Head::EMPTY, Head::follow)?.check_end(head)
}

/// What a job's records come to; those of printers are passed over. `None`: it has none.
///
/// # Errors
/// [`Break::Impossible`].
pub fn replay_job<'a>(records: impl IntoIterator<Item = &'a Record>) -> Result<Option<Job>, Break> {
    records.into_iter().try_fold(None, follow_job)
}

/// A job behind one more record; `None`: before its first.
///
/// # Errors
/// [`Break::Impossible`].
pub fn follow_job(job: Option<Job>, record: &Record) -> Result<Option<Job>, Break> {
    step_job(job, record).map_err(|e| impossible(record, &e))
}

fn step_job(job: Option<Job>, Record { fact, .. }: &Record) -> Result<Option<Job>, Impossible> {
    match (&fact.what, job) {
        (What::Added { id, spec, wishes, made, rank }, None) => {
            Ok(Some(Job::new(*id, *spec, wishes.clone(), made.clone(), rank.clone(), fact.at)?))
        }
        (What::Job { id, change, from, to }, Some(job)) if job.id == *id && job.state == *from => {
            let after = job.apply(change, fact.at)?;
            if after.state == *to { Ok(Some(after)) } else { Err(Impossible::States) }
        }
        (What::Printer { .. }, job) => Ok(job),
        _ => Err(Impossible::States),
    }
}

/// What a printer's records come to; those of jobs are passed over. `None`: it has none.
///
/// # Errors
/// [`Break::Impossible`].
pub fn replay_printer<'a>(records: impl IntoIterator<Item = &'a Record>) -> Result<Option<Printer>, Break> {
    records.into_iter().try_fold(None, follow_printer)
}

/// A printer behind one more record; `None`: before its first.
///
/// # Errors
/// [`Break::Impossible`].
pub fn follow_printer(printer: Option<Printer>, record: &Record) -> Result<Option<Printer>, Break> {
    match &record.fact.what {
        What::Printer { name, change } => {
            let before = printer.unwrap_or_else(|| Printer::new(name.clone()));
            before.apply(change).map(Some).map_err(|e| impossible(record, &e.into()))
        }
        What::Added { .. } | What::Job { .. } => Ok(printer),
    }
}

/// Why a record cannot follow.
#[derive(Debug, thiserror::Error)]
enum Impossible {
    #[error("the states do not follow each other")]
    States,
    #[error(transparent)]
    Refused(#[from] Refusal),
}

fn impossible(record: &Record, problem: &Impossible) -> Break {
    Break::Impossible { seq: record.seq, subject: record.fact.subject(), problem: problem.to_string() }
}
