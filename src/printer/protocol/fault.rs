//! Why a print was given up.

use std::time::Duration;

/// The end of a print that the core could not go on with. Heaters-off follows on every path here, except where there is nobody to
/// send it to.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// The link is gone.
    #[error("the link to the printer was lost; whether its heaters are on is unknown")]
    LinkLost,
    /// Nothing answers the greeting.
    #[error("no printer answers{}", if *.is_garbled { ", but there is noise on the line" } else { "" })]
    NoAnswer {
        /// Whether unreadable bytes were heard.
        is_garbled: bool,
    },
    /// What is sent comes back.
    #[error("what is behind the port repeats what it is sent: no printer, but an echo or another program")]
    Echo,
    /// It answers, but does not check line numbers.
    #[error("the printer answers, but does not check line numbers as its profile says")]
    NoLineNumbers,
    /// The profile is that of another firmware.
    #[error("the printer's firmware is {found}, but its profile is for {expected}")]
    OtherFirmware {
        /// The name of the built-in profile for what it says to be.
        found: &'static str,
        /// The same of what its profile says.
        expected: &'static str,
    },
    /// The firmware started anew.
    #[error("the printer restarted in the middle of the job")]
    FirmwareReset,
    /// The port was away, and the print cannot go on exactly where it was.
    #[error("after the port was away the print cannot go on: {why}")]
    LostPlace {
        /// Why not.
        why: String,
    },
    /// The operator wanted it to stop at once.
    #[error("emergency stop by the operator")]
    EmergencyStop,
    /// The firmware stopped for good.
    #[error("the printer stopped: {text}")]
    Halted {
        /// What it said.
        text: String,
    },
    /// A command was not executed, and nothing asks for it again.
    #[error("the printer refused a command of the job: {text}")]
    CommandRefused {
        /// What it said.
        text: String,
    },
    /// Nothing tells whether a command was executed, and it must not be executed twice.
    #[error("nothing tells whether the printer has executed {command:?}")]
    Unsure {
        /// The command.
        command: String,
    },
    /// Nothing was heard any more.
    #[error("the printer has been silent for {:.0} s", after.as_secs_f64())]
    Silent {
        /// For how long.
        after: Duration,
    },
    /// Nothing but noise was heard any more.
    #[error("nothing but noise has come from the printer for {:.0} s", after.as_secs_f64())]
    Garbled {
        /// For how long.
        after: Duration,
    },
    /// One command did not end.
    #[error("{command:?} has not ended after {:.0} s", after.as_secs_f64())]
    CommandTimeout {
        /// The command.
        command: String,
        /// For how long it ran.
        after: Duration,
    },
    /// The same line was asked for again and again.
    #[error("line {line} could not be brought across in {tries} attempts")]
    ResendLimit {
        /// The line's number on the wire.
        line: u64,
        /// How often it was sent.
        tries: u32,
    },
    /// A line was asked for that was never sent, or that is long done.
    #[error("the printer asks for line {asked}, but only {oldest} to {newest} can be sent")]
    LineUnavailable {
        /// The line asked for.
        asked: u64,
        /// The oldest line kept.
        oldest: u64,
        /// The last line sent.
        newest: u64,
    },
}

impl Fault {
    /// A stable name for programs.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::LinkLost => "printer.link_lost",
            Self::NoAnswer { .. } => "printer.no_answer",
            Self::Echo => "printer.echo",
            Self::NoLineNumbers => "printer.no_line_numbers",
            Self::OtherFirmware { .. } => "printer.other_firmware",
            Self::LostPlace { .. } => "printer.lost_place",
            Self::EmergencyStop => "printer.emergency_stop",
            Self::Garbled { .. } => "printer.garbled",
            Self::FirmwareReset => "printer.firmware_reset",
            Self::Halted { .. } => "printer.halted",
            Self::CommandRefused { .. } => "printer.command_refused",
            Self::Unsure { .. } => "printer.unsure",
            Self::Silent { .. } => "printer.silent",
            Self::CommandTimeout { .. } => "printer.command_timeout",
            Self::ResendLimit { .. } => "printer.resend_limit",
            Self::LineUnavailable { .. } => "printer.line_unavailable",
        }
    }

    /// What the operator should do next.
    #[must_use]
    pub const fn next_step(&self) -> &'static str {
        match self {
            Self::LinkLost => "check the cable and switch the printer off if it is hot",
            Self::NoAnswer { is_garbled: true } => "check the baud rate of the profile",
            Self::NoAnswer { is_garbled: false } => {
                "check that the printer is on and that this is its port; where it has stopped for good (M112, an error on its \
                 display), reset it or switch it off and on; `lumenfab profiles detect` tells which profile it needs"
            }
            Self::Echo => "check that this is the printer's port, and that no other program uses it",
            Self::LostPlace { .. } => {
                "look at the part; `lumenfab resume` says whether and where it can be continued"
            }
            Self::EmergencyStop => "look at the printer, then reset it",
            Self::Garbled { .. } => "check the cable, the baud rate, and that no other program uses the port",
            Self::NoLineNumbers | Self::OtherFirmware { .. } => {
                "choose the profile of the printer's firmware"
            }
            Self::FirmwareReset => {
                "check the printer's power supply; `lumenfab resume` says whether and where the part can be continued"
            }
            Self::CommandRefused { .. } => {
                "correct the job or the printer's limits; a part with a move missing is no replica"
            }
            Self::Unsure { .. } => "look at the printer and the part; check the cable before the next print",
            Self::Halted { .. } => "look at the printer, put right what it reports, then reset it",
            Self::Silent { .. } => "switch the printer off if it is hot, then check it and the cable",
            Self::CommandTimeout { .. } => "look at the printer",
            Self::ResendLimit { .. } => {
                "check the cable (shielding, length, mains nearby) or use a lower baud rate"
            }
            Self::LineUnavailable { .. } => "make sure that no other program uses the port, then print again",
        }
    }
}
