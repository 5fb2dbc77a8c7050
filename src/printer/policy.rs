//! What is done about what goes wrong: one table, state by event.
//!
#![doc = include_str!("policy.md")]
//!
//! [`action`] is the table, exhaustive; a test keeps the text above the same. The session asks it when the port goes and when a stop
//! is asked for; the other rows say what the protocol core does by itself, which the fault matrix shows for most of them. Details of
//! the wire (lost or damaged lines) are no troubles: the core puts them right.

use super::protocol::Fault;
use std::fmt::Write as _;

/// What a print is doing, as far as it matters when something goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Nothing of the job is sent yet.
    Greeting,
    /// Lines are sent.
    Printing,
    /// Nothing is sent; the heaters are on.
    Paused,
    /// The operator has asked to stop; heaters-off is on its way.
    Stopping,
    /// The port has vanished in the middle of the job.
    Detached,
}

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Trouble {
    /// The firmware's own protection has struck, or somebody has stopped it for good (kill, M112).
    Halted,
    /// The firmware has started anew.
    Reset,
    /// Nothing is heard.
    Silence,
    /// The port is gone.
    PortGone,
    /// The port is back, and the firmware names a line of this print.
    PortBack,
    /// Noise, but no answer: the wrong baud rate.
    Garbage,
    /// Another program has the port, or writes to it too.
    PortShared,
    /// The filament has run out.
    FilamentOut,
    /// The operator, or the printer's own buttons, ask to stop.
    StopRequested,
    /// A line does not get through, or a command is refused or never ends.
    Stuck,
}

/// What is done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Heaters-off is sent twice, the print is given up, the operator told.
    GiveUp,
    /// The print is given up before anything was sent; the operator is told.
    Refuse,
    /// Nobody can be told to switch the heaters off: the port is awaited for `orphan_hold_s`, the operator told at once;
    /// the firmware's own time-out watches meanwhile.
    Await,
    /// It goes on behind the line that the firmware names, each move once.
    GoOn,
    /// No more lines are sent; the heaters stay on; the operator is told.
    Pause,
    /// Moves end, heaters-off is sent and confirmed.
    Stop,
    /// Given up; whether the heaters are on is unknown, and said so.
    GiveUpUnknown,
    /// Nothing more than what is being done.
    Nothing,
}

impl Phase {
    const ALL: [Self; 5] = [Self::Greeting, Self::Printing, Self::Paused, Self::Stopping, Self::Detached];

    const fn words(self) -> &'static str {
        match self {
            Self::Greeting => "greeting",
            Self::Printing => "printing",
            Self::Paused => "paused",
            Self::Stopping => "stopping",
            Self::Detached => "port gone",
        }
    }
}

impl Trouble {
    const ALL: [Self; 10] = [
        Self::Halted,
        Self::Reset,
        Self::Silence,
        Self::PortGone,
        Self::PortBack,
        Self::Garbage,
        Self::PortShared,
        Self::FilamentOut,
        Self::StopRequested,
        Self::Stuck,
    ];

    const fn words(self) -> &'static str {
        match self {
            Self::Halted => "thermal fault, kill",
            Self::Reset => "firmware reset",
            Self::Silence => "silence",
            Self::PortGone => "port gone",
            Self::PortBack => "port back, same session",
            Self::Garbage => "garbage, wrong baud",
            Self::PortShared => "another program",
            Self::FilamentOut => "filament out",
            Self::StopRequested => "asked to stop",
            Self::Stuck => "line or command stuck",
        }
    }

    /// What a fault of the protocol is.
    #[must_use]
    pub const fn of(fault: &Fault) -> Self {
        match fault {
            Fault::LinkLost => Self::PortGone,
            Fault::NoAnswer { is_garbled: true } => Self::Garbage,
            Fault::NoAnswer { is_garbled: false } | Fault::Silent { .. } => Self::Silence,
            Fault::FirmwareReset => Self::Reset,
            Fault::Halted { .. } => Self::Halted,
            Fault::LineUnavailable { .. } => Self::PortShared,
            Fault::NoLineNumbers
            | Fault::CommandRefused { .. }
            | Fault::CommandTimeout { .. }
            | Fault::ResendLimit { .. } => Self::Stuck,
        }
    }
}

impl Action {
    const fn words(self) -> &'static str {
        match self {
            Self::GiveUp => "heaters off, give up",
            Self::Refuse => "refuse",
            Self::Await => "await the port, heaters guarded",
            Self::GoOn => "go on, each move once",
            Self::Pause => "pause, heaters on",
            Self::Stop => "stop, heaters off confirmed",
            Self::GiveUpUnknown => "give up, heaters unknown",
            Self::Nothing => "-",
        }
    }
}

/// The table.
#[must_use]
pub const fn action(phase: Phase, trouble: Trouble) -> Action {
    use Action as A;
    use Phase as P;
    use Trouble as T;
    match (phase, trouble) {
        (_, T::Halted) | (P::Printing | P::Paused | P::Stopping | P::Detached, T::Reset) => A::GiveUp,
        // A board that starts when its port is opened: it is greeted again.
        (P::Greeting, T::Reset) => A::Nothing,
        (P::Greeting, T::PortGone | T::Silence | T::Garbage | T::PortShared) => A::Refuse,
        (P::Printing | P::Paused, T::PortGone) => A::Await,
        (P::Stopping, T::PortGone) => A::GiveUpUnknown,
        (P::Detached, T::PortGone | T::PortShared) => A::Await,
        (P::Detached, T::PortBack) => A::GoOn,
        (_, T::PortBack) => A::Nothing,
        (P::Printing | P::Paused | P::Stopping | P::Detached, T::Silence | T::Garbage) => A::GiveUp,
        (P::Printing | P::Paused | P::Stopping, T::PortShared) => A::GiveUp,
        (P::Printing, T::FilamentOut) => A::Pause,
        (P::Greeting | P::Paused | P::Stopping | P::Detached, T::FilamentOut) => A::Nothing,
        (P::Printing | P::Paused, T::StopRequested) => A::Stop,
        (P::Greeting, T::StopRequested) => A::Refuse,
        (P::Stopping, T::StopRequested) => A::Nothing,
        (P::Detached, T::StopRequested) => A::GiveUpUnknown,
        (P::Greeting, T::Stuck) => A::Refuse,
        (P::Printing | P::Paused | P::Stopping | P::Detached, T::Stuck) => A::GiveUp,
    }
}

/// The table as it stands in the documentation: states along, events down.
#[must_use]
pub fn table() -> String {
    let mut text = "| event |".to_owned();
    for phase in Phase::ALL {
        write!(text, " {} |", phase.words()).expect("writing to a string cannot fail");
    }
    text.push_str("\n|---|---|---|---|---|---|\n");
    for trouble in Trouble::ALL {
        write!(text, "| {} |", trouble.words()).expect("writing to a string cannot fail");
        for phase in Phase::ALL {
            write!(text, " {} |", action(phase, trouble).words()).expect("writing to a string cannot fail");
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_documentation_shows_the_table() {
        let shown = include_str!("policy.md");
        assert_eq!(shown, table(), "write the right side into src/printer/policy.md");
    }

    #[test]
    fn nothing_goes_on_blindly_and_no_heater_is_left_to_itself() {
        for phase in [Phase::Printing, Phase::Paused, Phase::Detached] {
            for trouble in
                [Trouble::Halted, Trouble::Reset, Trouble::Silence, Trouble::Garbage, Trouble::Stuck]
            {
                assert_eq!(action(phase, trouble), Action::GiveUp, "{phase:?} {trouble:?}");
            }
            assert!(matches!(action(phase, Trouble::PortGone), Action::Await));
        }
        let going_on: Vec<_> = Phase::ALL
            .into_iter()
            .flat_map(|phase| Trouble::ALL.map(|trouble| (phase, trouble)))
            .filter(|&(phase, trouble)| action(phase, trouble) == Action::GoOn)
            .collect();
        assert_eq!(going_on, [(Phase::Detached, Trouble::PortBack)]);
    }
}
