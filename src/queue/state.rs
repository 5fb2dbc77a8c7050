//! The states of a job and what may follow what: one table, change by state.
//!
#![doc = include_str!("state.md")]
//!
//! [`next`] is the table, exhaustive; a test keeps the text above the same. A cell names the state that follows; `-` is refused.
//! [`Kind::is_open_to`] is the column "by": an operator, the holder of the job's claim (the appliance that prints or prepares it),
//! a claimant (an appliance that takes the job), a policy (a rule of the program), or whoever clears the bed. What
//! else a change asks for (nothing laid yet, a clear bed, ..) is in [`super::job`] and [`super::act`]. A queued or held job is "all
//! printed" where an edit leaves no copy to print: that follows by itself, in the same transaction.

use serde::{Deserialize, Serialize};
use std::fmt::Write as _;

/// What a job is at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// Being put together; nobody works on it.
    Draft,
    /// In the queue: to be prepared, or to be printed, or one of its copies.
    Queued,
    /// Kept back until it is released.
    Held,
    /// Its G-code is being made.
    Preparing,
    /// A printer has it, from warming up to the last line.
    Printing,
    /// A printer has it; no lines are sent.
    Paused,
    /// A copy is printed and lies on the bed.
    AwaitingBedClear,
    /// All copies are printed; the report is to be accepted or rejected.
    AwaitingSignOff,
    /// Done.
    Finished,
    /// Given up, or rejected.
    Failed,
    /// Called off.
    Cancelled,
}

/// The kind of a change; what it carries is in [`super::Change`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// A draft is complete.
    Submit,
    /// Priority, place, copies or time are changed.
    Edit,
    /// Keep it back.
    Hold,
    /// No longer.
    Release,
    /// Call it off.
    Cancel,
    /// Once more, from the copy that failed.
    Retry,
    /// A worker takes it.
    Prepare,
    /// Its G-code is made.
    Prepared,
    /// A printer takes it.
    Start,
    /// Material is about to be laid: recorded before the first line that extrudes.
    Lay,
    /// No more lines.
    Pause,
    /// Go on.
    GoOn,
    /// The appliance that held it has come back and takes it up again.
    Adopt,
    /// A copy is printed.
    Printed,
    /// Back into the queue: nothing came of it.
    GiveBack,
    /// Give it up.
    Fail,
    /// The bed is clear; a copy is left to print.
    NextCopy,
    /// The bed is clear, or no more copies are wanted; all is printed and to be signed off.
    AskSignOff,
    /// The bed is clear, or no more copies are wanted; all is printed and nobody is to be asked.
    Complete,
    /// The report is accepted.
    Accept,
    /// The report is rejected.
    Reject,
}

/// In which part somebody changes a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Role {
    /// A person.
    Operator,
    /// The appliance that holds the job.
    Holder,
    /// An appliance that takes the job.
    Claimant,
    /// A rule of the program.
    Policy,
    /// Whoever clears the bed.
    Clearer,
}

impl State {
    /// All states, in the order of a job's life.
    pub const ALL: [Self; 11] = [
        Self::Draft,
        Self::Queued,
        Self::Held,
        Self::Preparing,
        Self::Printing,
        Self::Paused,
        Self::AwaitingBedClear,
        Self::AwaitingSignOff,
        Self::Finished,
        Self::Failed,
        Self::Cancelled,
    ];

    /// In plain words.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Draft => "draft",
            Self::Queued => "queued",
            Self::Held => "held",
            Self::Preparing => "preparing",
            Self::Printing => "printing",
            Self::Paused => "paused",
            Self::AwaitingBedClear => "awaiting bed-clear",
            Self::AwaitingSignOff => "awaiting sign-off",
            Self::Finished => "finished",
            Self::Failed => "failed",
            Self::Cancelled => "cancelled",
        }
    }

    /// Whether nothing more happens unless somebody asks for it.
    #[must_use]
    pub const fn is_over(self) -> bool {
        matches!(self, Self::Finished | Self::Failed | Self::Cancelled)
    }

    /// Whether an appliance has it, under a claim.
    #[must_use]
    pub const fn is_claimed(self) -> bool {
        matches!(self, Self::Preparing | Self::Printing | Self::Paused)
    }

    /// Whether a printer has it.
    #[must_use]
    pub const fn is_at_printer(self) -> bool {
        matches!(self, Self::Printing | Self::Paused)
    }
}

impl std::fmt::Display for State {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.words())
    }
}

impl Kind {
    /// All kinds, in the order of a job's life.
    pub const ALL: [Self; 21] = [
        Self::Submit,
        Self::Edit,
        Self::Hold,
        Self::Release,
        Self::Cancel,
        Self::Retry,
        Self::Prepare,
        Self::Prepared,
        Self::Start,
        Self::Lay,
        Self::Pause,
        Self::GoOn,
        Self::Adopt,
        Self::Printed,
        Self::GiveBack,
        Self::Fail,
        Self::NextCopy,
        Self::AskSignOff,
        Self::Complete,
        Self::Accept,
        Self::Reject,
    ];

    /// In plain words.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Submit => "submit",
            Self::Edit => "edit",
            Self::Hold => "hold",
            Self::Release => "release",
            Self::Cancel => "cancel",
            Self::Retry => "retry",
            Self::Prepare => "prepare",
            Self::Prepared => "prepared",
            Self::Start => "start",
            Self::Lay => "lay material",
            Self::Pause => "pause",
            Self::GoOn => "go on",
            Self::Adopt => "take up again",
            Self::Printed => "printed",
            Self::GiveBack => "give back",
            Self::Fail => "fail",
            Self::NextCopy => "bed clear, next copy",
            Self::AskSignOff => "all printed, sign-off",
            Self::Complete => "all printed, done",
            Self::Accept => "accept",
            Self::Reject => "reject",
        }
    }

    /// Whether somebody in this part may ask for it at all.
    #[must_use]
    pub const fn is_open_to(self, role: Role) -> bool {
        match role {
            Role::Operator => self.is_open_to_operators(),
            Role::Holder => matches!(
                self,
                Self::Prepared
                    | Self::Lay
                    | Self::Pause
                    | Self::GoOn
                    | Self::Printed
                    | Self::GiveBack
                    | Self::Fail
                    | Self::Cancel
            ),
            Role::Claimant => matches!(self, Self::Prepare | Self::Start | Self::Adopt),
            Role::Policy => matches!(self, Self::Submit | Self::Hold | Self::GiveBack | Self::Fail),
            Role::Clearer => matches!(self, Self::NextCopy | Self::AskSignOff | Self::Complete),
        }
    }

    const fn is_open_to_operators(self) -> bool {
        matches!(
            self,
            Self::Submit
                | Self::Edit
                | Self::Hold
                | Self::Release
                | Self::Cancel
                | Self::Retry
                | Self::Fail
                | Self::Accept
                | Self::Reject
        )
    }
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.words())
    }
}

impl Role {
    /// All parts.
    pub const ALL: [Self; 5] = [Self::Operator, Self::Holder, Self::Claimant, Self::Policy, Self::Clearer];

    /// In plain words.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Operator => "operator",
            Self::Holder => "holder",
            Self::Claimant => "claimant",
            Self::Policy => "policy",
            Self::Clearer => "whoever clears the bed",
        }
    }
}

/// The table: the state that follows, or `None` where the change is refused.
#[must_use]
pub const fn next(state: State, change: Kind) -> Option<State> {
    use Kind as K;
    use State as S;
    Some(match (state, change) {
        (S::Draft, K::Submit) | (S::Held, K::Release) => S::Queued,
        (S::Failed | S::Cancelled, K::Retry) => S::Queued,
        (S::Preparing, K::Prepared) | (S::AwaitingBedClear, K::NextCopy) => S::Queued,
        (S::Preparing | S::Printing | S::Paused, K::GiveBack) => S::Queued,
        (S::Queued | S::Preparing, K::Hold) => S::Held,
        (S::Queued, K::Prepare) => S::Preparing,
        (S::Queued, K::Start) | (S::Printing, K::Lay) | (S::Paused, K::GoOn) => S::Printing,
        (S::Printing, K::Pause) => S::Paused,
        (S::Preparing | S::Printing | S::Paused, K::Adopt) => state,
        (S::Printing, K::Printed) => S::AwaitingBedClear,
        (S::AwaitingBedClear | S::Queued | S::Held, K::AskSignOff) => S::AwaitingSignOff,
        (S::AwaitingBedClear | S::Queued | S::Held, K::Complete) => S::Finished,
        (S::AwaitingSignOff, K::Accept) => S::Finished,
        (S::Preparing | S::Printing | S::Paused, K::Fail) | (S::AwaitingSignOff, K::Reject) => S::Failed,
        (S::Draft | S::Queued | S::Held | S::Preparing | S::Printing | S::Paused, K::Cancel) => S::Cancelled,
        (
            S::Draft | S::Queued | S::Held | S::Preparing | S::Printing | S::Paused | S::AwaitingBedClear,
            K::Edit,
        ) => state,
        _ => return None,
    })
}

/// The table as it stands in the documentation: states along, changes down.
#[must_use]
pub fn table() -> String {
    const WRITES: &str = "writing to a string cannot fail";
    let mut text = "| change | by |".to_owned();
    for state in State::ALL {
        write!(text, " {state} |").expect(WRITES);
    }
    text.push_str("\n|---|---|---|---|---|---|---|---|---|---|---|---|---|\n");
    for change in Kind::ALL {
        let by: Vec<_> =
            Role::ALL.into_iter().filter(|&role| change.is_open_to(role)).map(Role::words).collect();
        write!(text, "| {change} | {} |", by.join(", ")).expect(WRITES);
        for state in State::ALL {
            write!(text, " {} |", next(state, change).map_or("-", State::words)).expect(WRITES);
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cells() -> impl Iterator<Item = (State, Kind, Option<State>)> {
        State::ALL.into_iter().flat_map(|s| Kind::ALL.map(|k| (s, k, next(s, k))))
    }

    #[test]
    fn the_documentation_shows_the_table() {
        let shown = include_str!("state.md");
        assert_eq!(shown, table(), "write the right side into src/queue/state.md");
    }

    #[test]
    fn every_state_but_the_first_is_reached_and_every_change_happens_somewhere() {
        for state in State::ALL.into_iter().filter(|&s| s != State::Draft) {
            assert!(cells().any(|(from, _, to)| from != state && to == Some(state)), "{state}");
        }
        for kind in Kind::ALL {
            assert!(cells().any(|(_, k, to)| k == kind && to.is_some()), "{kind}");
            assert!(Role::ALL.into_iter().any(|role| kind.is_open_to(role)), "{kind}");
        }
    }

    #[test]
    fn what_is_over_is_taken_up_by_an_operator_alone() {
        let taken_up: Vec<_> = cells().filter(|(s, _, to)| s.is_over() && to.is_some()).collect();
        let again = |state| (state, Kind::Retry, Some(State::Queued));
        assert_eq!(taken_up, [again(State::Failed), again(State::Cancelled)]);
        let roles = Role::ALL.into_iter().filter(|&role| Kind::Retry.is_open_to(role));
        assert_eq!(roles.collect::<Vec<_>>(), [Role::Operator]);
    }

    #[test]
    fn a_print_begins_at_a_claim_and_nowhere_else() {
        let into_print =
            cells().filter(|(from, _, to)| !from.is_at_printer() && to.is_some_and(State::is_at_printer));
        assert_eq!(into_print.map(|(s, k, _)| (s, k)).collect::<Vec<_>>(), [(State::Queued, Kind::Start)]);
    }

    #[test]
    fn a_printed_copy_lies_on_the_bed_until_the_bed_is_cleared() {
        for (_, kind, to) in cells().filter(|(s, _, _)| *s == State::AwaitingBedClear) {
            let leaves = to.is_some_and(|to| to != State::AwaitingBedClear);
            assert_eq!(leaves, kind.is_open_to(Role::Clearer), "{kind}");
        }
    }

    #[test]
    fn only_people_sign_off() {
        for (_, kind, to) in cells().filter(|(s, _, _)| *s == State::AwaitingSignOff) {
            assert_eq!(to.is_some(), matches!(kind, Kind::Accept | Kind::Reject));
        }
        for role in Role::ALL {
            assert_eq!(Kind::Accept.is_open_to(role), role == Role::Operator);
            assert_eq!(Kind::Reject.is_open_to(role), role == Role::Operator);
        }
    }
}
