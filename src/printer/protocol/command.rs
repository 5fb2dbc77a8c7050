//! What the owner may ask for, and what the core is doing.

use crate::printer::policy::Phase;

use super::{Fault, Greeting, Inquiry, Question};

/// What the owner asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command<'a> {
    /// The port is open: greet the printer.
    Connect,
    /// The port is open, and the printer may still hold lines of an earlier session: ask it for its last line, and change
    /// nothing. No line of that session was numbered higher than `beyond`.
    Inquire {
        /// See above.
        beyond: u64,
    },
    /// Ask something.
    Ask(Question),
    /// Begin a job: the profile's lines before it ([`Core::prelude`](super::Core::prelude)), then the job's.
    Begin,
    /// Go on with a job behind the line that the printer has named as its last.
    GoOn,
    /// A line of the host's own before the next one of the job. Only while [`Core::wants_line`](super::Core::wants_line), and while
    /// parking.
    HostLine(&'a str),
    /// The next line of the job, without number, checksum or line end. Only while [`Core::wants_line`](super::Core::wants_line).
    Line(&'a str),
    /// The job has no more lines.
    EndOfJob,
    /// Send no more lines.
    Pause,
    /// The job is paused, and its lines that were not sent will be given again: the next ones are the host's, sent in the pause.
    Park,
    /// Go on.
    Resume,
    /// The operator's answer to the printer's question: the n-th of its buttons, counted from 0.
    Answer(usize),
    /// Give the job up: stop the moves, heaters off.
    Cancel,
    /// Switch the heaters off, and look whether they are; no job is running.
    HeatersOff,
    /// Stop everything at once; the firmware needs a reset afterwards (M112).
    EmergencyStop,
}

impl Command<'_> {
    /// What it is called in a refusal.
    pub(super) const fn name(&self) -> &'static str {
        match self {
            Self::Connect => "connecting",
            Self::Inquire { .. } | Self::Ask(_) => "asking the printer",
            Self::Begin => "beginning a job",
            Self::GoOn => "going on with a job",
            Self::Line(_) | Self::HostLine(_) => "sending a line",
            Self::EndOfJob => "ending the job",
            Self::Pause => "pausing",
            Self::Park => "parking",
            Self::Resume => "resuming",
            Self::Answer(_) => "answering",
            Self::Cancel => "cancelling",
            Self::HeatersOff => "switching the heaters off",
            Self::EmergencyStop => "an emergency stop",
        }
    }
}

/// The command does not fit the state.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{command} is not possible while {state}")]
pub struct Refused {
    /// What was asked for.
    pub command: &'static str,
    /// What the core is doing.
    pub state: &'static str,
}

/// What the core is doing. Going back to a refused line is not a state of its own: it happens in several of them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum State {
    /// No port.
    Disconnected,
    /// Greeting the printer.
    Handshake(Greeting),
    /// Ready for a job.
    Idle,
    /// An answer is awaited.
    Asking(Inquiry),
    /// Lines are sent.
    Streaming,
    /// All lines are given; the proof that they are executed is awaited.
    Finishing,
    /// No more lines are sent; those in flight are awaited.
    Pausing,
    /// The job is paused; the host's own lines are sent.
    Parking,
    /// Nothing is in flight.
    Paused,
    /// The job was given up; the proof that the heaters are off is awaited.
    Cancelling,
    /// The job was given up because of a fault; heaters-off is sent until it is confirmed.
    Faulted(Fault),
    /// Heaters-off is sent until it is confirmed, without a fault.
    SwitchingOff,
}

impl State {
    /// What the core is doing, in words.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Disconnected => "disconnected",
            Self::Handshake(_) => "greeting the printer",
            Self::Idle => "idle",
            Self::Asking(_) => "asking the printer",
            Self::Streaming => "printing",
            Self::Finishing => "finishing",
            Self::Pausing | Self::Parking => "pausing",
            Self::Paused => "paused",
            Self::Cancelling => "cancelling",
            Self::Faulted(_) => "faulted",
            Self::SwitchingOff => "switching the heaters off",
        }
    }

    pub(super) const fn has_job(&self) -> bool {
        matches!(
            self,
            Self::Streaming
                | Self::Finishing
                | Self::Pausing
                | Self::Parking
                | Self::Paused
                | Self::Cancelling
        )
    }

    /// Whether the job waits for the operator.
    pub(in crate::printer) const fn is_paused(&self) -> bool {
        matches!(self, Self::Pausing | Self::Parking | Self::Paused)
    }

    /// What it is for the table of [`crate::printer::policy`].
    pub(in crate::printer) const fn phase(&self) -> Phase {
        match self {
            Self::Disconnected | Self::Handshake(_) | Self::Idle | Self::Asking(_) => Phase::Greeting,
            Self::Streaming | Self::Finishing => Phase::Printing,
            Self::Pausing | Self::Parking | Self::Paused => Phase::Paused,
            Self::Cancelling | Self::Faulted(_) | Self::SwitchingOff => Phase::Stopping,
        }
    }
}
