//! What is done about what goes wrong: one table, state by event.
//!
#![doc = include_str!("policy.md")]
//!
//! [`action`] is the table, exhaustive; a test keeps the text above the same. Core and session ask it whenever one of these happens,
//! and the tests of the session drive a print into every cell of it. Details of the wire (lost or damaged lines) are no troubles: the
//! core puts them right.

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
    /// It is there again, and the printer is asked where it is.
    Returned,
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
    /// The port is there again, the same device behind it.
    PortBack,
    /// The printer has said where it is, and it is exactly where the print was.
    PlaceFound,
    /// The printer has said where it is, and the print cannot go on exactly, or its heaters were switched off meanwhile.
    PlaceLost,
    /// Noise, but no answer: the wrong baud rate.
    Garbage,
    /// Another program writes to the port too, or there is no printer but an echo.
    PortShared,
    /// The filament has run out.
    FilamentOut,
    /// The operator, or the printer's own buttons, ask to stop.
    StopRequested,
    /// The operator wants it to stop at once.
    EmergencyStop,
    /// A line does not get through, a command is refused or never ends, or a question is never answered.
    Stuck,
}

/// What is done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// The print is given up; heaters-off is sent until the printer confirms it, ten seconds at most (half a minute where no fault
    /// ended it, and what is under way may take a while); the operator is told whether it has.
    GiveUp,
    /// It is stopped for good (M112) until it says so, and the print is given up as above.
    StopAtOnce,
    /// The print is given up before anything of it was sent; the printer stays as it is, and the operator is told how warm it is.
    Leave,
    /// Nobody can be told to switch the heaters off: the port is awaited for `orphan_hold_s`, the operator told at once;
    /// the firmware's own time-out watches meanwhile.
    Await,
    /// The printer is asked for its last line and its place; nothing else is sent.
    Ask,
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
    pub(super) const ALL: [Self; 6] =
        [Self::Greeting, Self::Printing, Self::Paused, Self::Stopping, Self::Detached, Self::Returned];

    const fn words(self) -> &'static str {
        match self {
            Self::Greeting => "greeting",
            Self::Printing => "printing",
            Self::Paused => "paused",
            Self::Stopping => "stopping",
            Self::Detached => "port gone",
            Self::Returned => "port back",
        }
    }
}

impl Trouble {
    pub(super) const ALL: [Self; 13] = [
        Self::Halted,
        Self::Reset,
        Self::Silence,
        Self::PortGone,
        Self::PortBack,
        Self::PlaceFound,
        Self::PlaceLost,
        Self::Garbage,
        Self::PortShared,
        Self::FilamentOut,
        Self::StopRequested,
        Self::EmergencyStop,
        Self::Stuck,
    ];

    const fn words(self) -> &'static str {
        match self {
            Self::Halted => "thermal fault, kill",
            Self::Reset => "firmware reset",
            Self::Silence => "silence",
            Self::PortGone => "port gone",
            Self::PortBack => "port back, same device",
            Self::PlaceFound => "place found",
            Self::PlaceLost => "place lost",
            Self::Garbage => "garbage, wrong baud",
            Self::PortShared => "another program",
            Self::FilamentOut => "filament out",
            Self::StopRequested => "asked to stop",
            Self::EmergencyStop => "asked to stop at once",
            Self::Stuck => "line or command stuck",
        }
    }

    /// What a fault of the protocol is.
    #[must_use]
    pub const fn of(fault: &Fault) -> Self {
        match fault {
            Fault::LinkLost => Self::PortGone,
            Fault::NoAnswer { is_garbled: true } | Fault::Garbled { .. } => Self::Garbage,
            Fault::NoAnswer { is_garbled: false } | Fault::Silent { .. } => Self::Silence,
            Fault::FirmwareReset => Self::Reset,
            Fault::Halted { .. } => Self::Halted,
            Fault::LineUnavailable { .. } | Fault::Echo => Self::PortShared,
            Fault::LostPlace { .. } => Self::PlaceLost,
            Fault::EmergencyStop => Self::EmergencyStop,
            Fault::NoLineNumbers
            | Fault::OtherFirmware { .. }
            | Fault::CommandRefused { .. }
            | Fault::Unsure { .. }
            | Fault::CommandTimeout { .. }
            | Fault::ResendLimit { .. } => Self::Stuck,
        }
    }
}

impl Action {
    const fn words(self) -> &'static str {
        match self {
            Self::GiveUp => "heaters off, give up",
            Self::StopAtOnce => "stop at once, give up",
            Self::Leave => "leave it as it is",
            Self::Await => "await the port, heaters guarded",
            Self::Ask => "ask where it is",
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
        (P::Detached, T::PortBack) => A::Ask,
        (P::Detached, T::PortGone) => A::Await,
        (P::Detached, T::EmergencyStop | T::StopRequested) => A::GiveUpUnknown,
        // Nobody is there to say anything.
        (P::Detached, _) => A::Nothing,
        (_, T::EmergencyStop) => A::StopAtOnce,
        // A board that starts when its port is opened: it is greeted again.
        (P::Greeting, T::Reset) => A::Nothing,
        (_, T::Halted | T::Reset | T::Silence | T::Garbage | T::PortShared | T::Stuck) => A::GiveUp,
        (P::Greeting | P::Stopping, T::PortGone) => A::GiveUpUnknown,
        (P::Printing | P::Paused | P::Returned, T::PortGone) => A::Await,
        (P::Returned, T::PlaceFound) => A::GoOn,
        (P::Returned, T::PlaceLost) => A::GiveUp,
        (_, T::PortBack | T::PlaceFound | T::PlaceLost) => A::Nothing,
        (P::Printing, T::FilamentOut) => A::Pause,
        (_, T::FilamentOut) => A::Nothing,
        (P::Printing | P::Paused | P::Returned, T::StopRequested) => A::Stop,
        (P::Greeting, T::StopRequested) => A::Leave,
        (P::Stopping, T::StopRequested) => A::Nothing,
    }
}

/// The table as it stands in the documentation: states along, events down.
#[must_use]
pub fn table() -> String {
    let mut text = "| event |".to_owned();
    for phase in Phase::ALL {
        write!(text, " {} |", phase.words()).expect("writing to a string cannot fail");
    }
    text.push_str("\n|---|---|---|---|---|---|---|\n");
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
        for phase in Phase::ALL.into_iter().filter(|&phase| phase != Phase::Detached) {
            for trouble in [Trouble::Halted, Trouble::Silence, Trouble::Garbage, Trouble::Stuck] {
                assert_eq!(action(phase, trouble), Action::GiveUp, "{phase:?} {trouble:?}");
            }
        }
        let all = Phase::ALL.into_iter().flat_map(|phase| Trouble::ALL.map(|trouble| (phase, trouble)));
        let going_on: Vec<_> =
            all.filter(|&(phase, trouble)| action(phase, trouble) == Action::GoOn).collect();
        assert_eq!(going_on, [(Phase::Returned, Trouble::PlaceFound)]);
    }
}
