//! What becomes of a job when its print has ended: pure.

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
    /// The port could not be opened.
    NoPort,
    /// Port or printer failed.
    Failed,
}

impl Manner {
    pub(super) const fn of(error: &Error) -> Self {
        match error {
            Error::Cancelled { .. } | Error::Left { .. } => Self::GivenUp,
            Error::Job(_) | Error::JobLost(_) => Self::BadJob,
            Error::Open { .. } => Self::NoPort,
            _ => Self::Failed,
        }
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
    /// Whether the queue knows that material was laid.
    pub(super) is_laid: bool,
    /// Whether its journal knows how to go on.
    pub(super) is_resumable: bool,
}

/// What becomes of its job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Outcome {
    /// This is recorded.
    Change { change: Change, by: Option<Name>, why: String },
    /// It waits for an operator's word, for this reason.
    Waits(String),
    /// Nothing: it is somebody else's.
    Lost,
}

/// Decides.
pub(super) fn outcome(facts: Facts) -> Outcome {
    let Facts { manner, said, cause, is_laid, is_resumable } = facts;
    let used_mm3 = if is_laid { None } else { Some(0) };
    let record = |change, why| Outcome::Change { change, by: None, why };
    let failed = |why| record(Change::Fail { used_mm3 }, why);
    let given_back = |why| record(Change::GiveBack { lost: false }, why);
    match (manner, cause) {
        (Manner::Finished, _) if is_laid => record(Change::Printed { used_mm3: None }, String::new()),
        (Manner::Finished, _) => failed("the job has ended without laying material".to_owned()),
        (_, Some(Cause::ClaimLost)) if !is_laid => Outcome::Lost,
        (Manner::Failed, _) if is_laid && is_resumable => Outcome::Waits(said),
        (_, Some(Cause::Asked { by, why })) => Outcome::Change {
            change: Change::Cancel { used_mm3 },
            by: Some(by),
            why: why.as_str().to_owned(),
        },
        (Manner::BadJob, _) => failed(said),
        (_, Some(Cause::Limit(why))) => failed(why),
        (_, Some(Cause::NotLet(why))) if !is_laid => given_back(why),
        (_, Some(Cause::Stopping)) if !is_laid => given_back("the server ends".to_owned()),
        (_, Some(Cause::NotLet(why))) => failed(why),
        (_, Some(Cause::Stopping)) => failed("the server was asked to stop".to_owned()),
        (Manner::GivenUp, _) => failed("it was stopped at the printer".to_owned()),
        _ if is_laid => failed(said),
        _ => given_back(said),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::queue::state::Kind;

    const MANNERS: [Manner; 5] =
        [Manner::Finished, Manner::GivenUp, Manner::BadJob, Manner::NoPort, Manner::Failed];

    fn causes() -> Vec<Option<Cause>> {
        let by = Name::try_new("Ada").unwrap();
        let asked = Cause::Asked { by, why: Reason::try_new("wrong part").unwrap() };
        let other =
            [Cause::Stopping, Cause::Limit("hot".into()), Cause::NotLet("doubt".into()), Cause::ClaimLost];
        [None, Some(asked)].into_iter().chain(other.map(Some)).collect()
    }

    fn all() -> impl Iterator<Item = (Facts, Outcome)> {
        MANNERS.into_iter().flat_map(|manner| {
            causes().into_iter().flat_map(move |cause| {
                [(false, false), (true, false), (true, true)].map(|(is_laid, is_resumable)| {
                    let said = "said".to_owned();
                    let facts = Facts { manner, said, cause: cause.clone(), is_laid, is_resumable };
                    (facts.clone(), outcome(facts))
                })
            })
        })
    }

    fn kind(outcome: &Outcome) -> Option<Kind> {
        match outcome {
            Outcome::Change { change, .. } => Some(change.kind()),
            Outcome::Waits(_) | Outcome::Lost => None,
        }
    }

    #[test]
    fn what_was_laid_never_goes_back_and_nothing_is_printed_that_was_not_laid() {
        for (facts, outcome) in all() {
            match kind(&outcome) {
                Some(Kind::GiveBack) => assert!(!facts.is_laid, "{facts:?}"),
                Some(Kind::Printed) => {
                    assert!(facts.is_laid && facts.manner == Manner::Finished, "{facts:?}")
                }
                Some(Kind::Fail | Kind::Cancel) => {}
                Some(other) => panic!("{other} for {facts:?}"),
                None => {}
            }
        }
    }

    #[test]
    fn filament_is_reckoned_with_where_some_was_laid() {
        for (facts, outcome) in all() {
            if let Outcome::Change {
                change: Change::Fail { used_mm3 } | Change::Cancel { used_mm3 }, ..
            } = outcome
            {
                assert_eq!(used_mm3.is_none(), facts.is_laid, "{facts:?}");
            }
        }
    }

    #[test]
    fn a_print_that_can_go_on_waits_and_nothing_else_does() {
        for (facts, outcome) in all() {
            let can_go_on = facts.is_laid && facts.is_resumable && facts.manner == Manner::Failed;
            assert_eq!(matches!(outcome, Outcome::Waits(_)), can_go_on, "{facts:?}");
        }
    }

    #[test]
    fn a_job_of_which_nothing_was_laid_is_not_failed_by_the_end_of_the_server_or_a_lost_port() {
        for (facts, outcome) in all().filter(|(facts, _)| !facts.is_laid) {
            let is_innocent = facts.cause == Some(Cause::Stopping) && facts.manner != Manner::BadJob
                || facts.cause.is_none() && matches!(facts.manner, Manner::NoPort | Manner::Failed);
            if is_innocent && facts.manner != Manner::Finished {
                assert_eq!(kind(&outcome), Some(Kind::GiveBack), "{facts:?}");
            }
            if facts.cause == Some(Cause::ClaimLost) && facts.manner != Manner::Finished {
                assert_eq!(outcome, Outcome::Lost, "{facts:?}");
            }
        }
    }

    #[test]
    fn who_cancelled_it_and_why_is_kept() {
        let asked = causes().remove(1);
        let said = "said".to_owned();
        let facts = Facts { manner: Manner::GivenUp, said, cause: asked, is_laid: true, is_resumable: false };
        let Outcome::Change { change, by, why } = outcome(facts) else { panic!() };
        assert_eq!((change.kind(), by.unwrap().as_str(), &*why), (Kind::Cancel, "Ada", "wrong part"));
    }
}
