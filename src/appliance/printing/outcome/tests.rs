use super::*;
use crate::queue::state::Kind;
use std::fmt::Write as _;

const MANNERS: [(Manner, &str); 4] = [
    (Manner::Finished, "finished"),
    (Manner::GivenUp, "given up"),
    (Manner::BadJob, "bad job"),
    (Manner::Failed, "port or printer failed"),
];
const PARTS: [(Part, &str); 3] = [
    (Part::Nothing, "nothing"),
    (Part::Unfinished, "can be gone on with"),
    (Part::Dead, "cannot be gone on with"),
];
const HEATS: [(Heat, &str); 3] =
    [(Heat::Off, "off"), (Heat::Untouched, "nothing was sent"), (Heat::Unknown, "unknown")];
const BEGUN: [(Begun, &str); 2] = [(Begun::Anew, "began"), (Begun::Again, "went on")];

fn causes() -> [(Option<Cause>, &'static str); 6] {
    let by = Name::try_new("Ada").unwrap();
    let asked = Cause::Asked { by, why: Reason::try_new("wrong part").unwrap() };
    [
        (None, "no word"),
        (Some(asked), "an operator's word"),
        (Some(Cause::Stopping), "the server ends"),
        (Some(Cause::Limit("hot".into())), "a limit"),
        (Some(Cause::NotLet("doubt".into())), "may not lay"),
        (Some(Cause::ClaimLost), "claim lost"),
    ]
}

fn facts(manner: Manner, part: Part, cause: Option<Cause>) -> Facts {
    Facts { manner, said: "said".into(), cause, part, begun: Begun::Anew, heat: Heat::Unknown }
}

fn all() -> impl Iterator<Item = (Facts, Outcome)> {
    let heats = HEATS.into_iter().flat_map(|(heat, _)| BEGUN.map(|(begun, _)| (heat, begun)));
    let heats: Vec<_> = heats.collect();
    MANNERS.into_iter().flat_map(move |(manner, _)| {
        let heats = heats.clone();
        PARTS.into_iter().flat_map(move |(part, _)| {
            let heats = heats.clone();
            causes().into_iter().flat_map(move |(cause, _)| {
                let of = move |(heat, begun)| Facts { heat, begun, ..facts(manner, part, cause.clone()) };
                heats.clone().into_iter().map(of).map(|facts| (facts.clone(), outcome(facts)))
            })
        })
    })
}

fn kind(outcome: &Outcome) -> Option<Kind> {
    match &outcome.job {
        Job::Change { change, .. } => Some(change.kind()),
        Job::Waits(_) | Job::Lost => None,
    }
}

fn word(job: &Job) -> &'static str {
    match job {
        Job::Waits(_) => "**waits**",
        Job::Lost => "nobody's",
        Job::Change { change: Change::GiveBack { .. }, .. } => "given back",
        Job::Change { change: Change::Printed { .. }, .. } => "printed",
        Job::Change { change: Change::Fail { .. }, .. } => "failed",
        Job::Change { change: Change::Cancel { .. }, .. } => "cancelled",
        Job::Change { change, .. } => panic!("{change:?}"),
    }
}

/// The tables as they stand in the documentation.
fn tables() -> String {
    let mut text = "| the print | on the bed |".to_owned();
    for (_, words) in causes() {
        write!(text, " {words} |").unwrap();
    }
    text.push_str("\n|---|---|---|---|---|---|---|---|\n");
    for (manner, how) in MANNERS {
        for (part, what) in PARTS {
            write!(text, "| {how} | {what} |").unwrap();
            for (cause, _) in causes() {
                write!(text, " {} |", word(&outcome(facts(manner, part, cause)).job)).unwrap();
            }
            text.push('\n');
        }
    }
    text.push_str("\n| heaters | the print | it waits | anything else |\n|---|---|---|---|\n");
    for (heat, known) in HEATS {
        for (begun, how) in BEGUN {
            let heaters = |manner| {
                let facts = Facts { heat, begun, ..facts(manner, Part::Unfinished, None) };
                match outcome(facts).heaters {
                    Heaters::Off => "off",
                    Heaters::Keep => "warm until the deadline",
                    Heaters::SwitchOff => "switched off at once",
                }
            };
            let (waits, else_) = (heaters(Manner::Failed), heaters(Manner::GivenUp));
            writeln!(text, "| {known} | {how} | {waits} | {else_} |").unwrap();
        }
    }
    text
}

#[test]
fn the_documentation_shows_the_tables() {
    let shown = include_str!("../outcome.md");
    assert_eq!(shown, tables(), "write the right side into src/appliance/printing/outcome.md");
}

#[test]
fn what_was_laid_never_goes_back_and_nothing_is_printed_that_was_not_laid() {
    for (facts, outcome) in all() {
        let is_laid = facts.part != Part::Nothing;
        match kind(&outcome) {
            Some(Kind::GiveBack) => assert!(!is_laid, "{facts:?}"),
            Some(Kind::Printed) => assert!(is_laid && facts.manner == Manner::Finished, "{facts:?}"),
            Some(Kind::Fail | Kind::Cancel) | None => {}
            Some(other) => panic!("{other} for {facts:?}"),
        }
    }
}

#[test]
fn filament_is_reckoned_with_where_some_was_laid() {
    for (facts, outcome) in all() {
        if let Job::Change { change: Change::Fail { used_mm3 } | Change::Cancel { used_mm3 }, .. } =
            outcome.job
        {
            assert_eq!(used_mm3.is_none(), facts.part != Part::Nothing, "{facts:?}");
        }
    }
}

#[test]
fn a_print_that_can_go_on_waits_where_nobody_has_ended_it_and_nothing_else_does() {
    for (facts, outcome) in all() {
        let is_ended = !matches!(facts.cause, None | Some(Cause::Stopping));
        let waits = facts.part == Part::Unfinished && facts.manner == Manner::Failed;
        // Nothing is laid by one that may not.
        let is_possible = !matches!(facts.cause, Some(Cause::NotLet(_)));
        assert_eq!(matches!(outcome.job, Job::Waits(_)), waits && !is_ended && is_possible, "{facts:?}");
    }
}

#[test]
fn somebody_s_word_and_a_limit_hold_however_the_print_ended() {
    for (facts, outcome) in all().filter(|(facts, _)| facts.manner != Manner::Finished) {
        match facts.cause {
            Some(Cause::Asked { .. }) => assert_eq!(kind(&outcome), Some(Kind::Cancel), "{facts:?}"),
            Some(Cause::Limit(_)) => {
                let Job::Change { change, why, .. } = &outcome.job else { panic!("{facts:?}") };
                assert_eq!((change.kind(), &**why), (Kind::Fail, "hot"), "{facts:?}");
            }
            _ => {}
        }
    }
}

#[test]
fn heaters_that_may_be_on_are_left_on_for_a_print_that_waits_alone() {
    for (facts, outcome) in all() {
        let may_be_on =
            facts.heat == Heat::Unknown || (facts.heat, facts.begun) == (Heat::Untouched, Begun::Again);
        let expected = match outcome.job {
            _ if !may_be_on => Heaters::Off,
            Job::Waits(_) => Heaters::Keep,
            _ => Heaters::SwitchOff,
        };
        assert_eq!(outcome.heaters, expected, "{facts:?}");
    }
}

#[test]
fn a_job_of_which_nothing_was_laid_is_not_failed_by_the_end_of_the_server_or_a_lost_port() {
    for (facts, outcome) in all().filter(|(facts, _)| facts.part == Part::Nothing) {
        let is_innocent = facts.cause == Some(Cause::Stopping) && facts.manner != Manner::BadJob
            || facts.cause.is_none() && facts.manner == Manner::Failed;
        if is_innocent && facts.manner != Manner::Finished {
            assert_eq!(kind(&outcome), Some(Kind::GiveBack), "{facts:?}");
        }
    }
}

#[test]
fn a_job_that_is_somebody_else_s_is_not_touched() {
    for (facts, outcome) in all() {
        assert_eq!(outcome.job == Job::Lost, facts.cause == Some(Cause::ClaimLost), "{facts:?}");
    }
}

#[test]
fn who_cancelled_it_and_why_is_kept() {
    let [_, (asked, _), ..] = causes();
    let Job::Change { change, by, why } = outcome(facts(Manner::Failed, Part::Unfinished, asked)).job else {
        panic!()
    };
    assert_eq!((change.kind(), by.unwrap().as_str(), &*why), (Kind::Cancel, "Ada", "wrong part"));
}

#[test]
fn an_error_before_anything_was_sent_leaves_the_heaters_as_they_were() {
    use crate::printer::PortProblem;
    use crate::printer::protocol;
    let port = || "port".to_owned();
    let open = Error::Open { port: port(), problem: PortProblem::Missing };
    let left = Error::Left { port: port(), heat: protocol::Heat::default() };
    for error in [open, left] {
        assert_eq!(Heat::of(&error), Heat::Untouched, "{error}");
    }
    assert_eq!(Heat::of(&Error::PortVanished { port: port() }), Heat::Unknown);
    assert_eq!(Heat::of(&Error::Cancelled { heat: protocol::Heat::Obeyed }), Heat::Off);
    assert_eq!(Heat::of(&Error::Cancelled { heat: protocol::Heat::Unknown(None) }), Heat::Unknown);
}
