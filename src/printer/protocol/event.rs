//! What the core tells its owner.

use super::fault::Fault;
use super::planner::Held;
use super::prompt::Prompt;
use super::reply::{Position, Temperatures};
use super::safety::Heat;

/// Something that happened.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// The printer answers, and numbers its lines from 0.
    Connected,
    /// New temperatures.
    Temperatures(Temperatures),
    /// The printer answers, and named the last line that it has; without a number where it counts none.
    Found(Option<u64>),
    /// What was asked is answered: where it is.
    Position(Position),
    /// The answer to what was asked is complete.
    Answered,
    /// The firmware's long command goes on; its own word.
    Busy(String),
    /// The printer wishes something (`//action:`).
    Action(String),
    /// The printer asks the operator; nothing where the question is over.
    Prompt(Option<Prompt>),
    /// Nothing has answered for some seconds; it is asked on.
    NoAnswerYet,
    /// What the firmware calls itself (M115).
    Firmware(String),
    /// A line that means nothing to the protocol: kept for the log.
    Message(String),
    /// The firmware asks for no line again: a damaged one is found by its place.
    NeverAsksAgain,
    /// Something went wrong on the wire and was put right.
    Recovered(Recovery),
    /// All lines sent so far are executed, no more will be sent until resumed.
    Paused,
    /// The job goes on.
    Resumed,
    /// Every line of the job was executed, and the firmware says so.
    Finished,
    /// The job was given up on request; the heaters are off, and the firmware says so.
    Cancelled,
    /// The job was given up; heaters-off is on its way.
    Faulted(Fault),
    /// Heaters-off was sent until it was confirmed, or as long as that made sense: what is known of them.
    Secured(Heat),
}

/// What was put right.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Recovery {
    /// The firmware refused a line; it and all after it are sent again.
    Resent {
        /// The line's number on the wire.
        line: u64,
    },
    /// So many `ok` were lost.
    LostOk {
        /// How many.
        count: u64,
    },
}

/// What happened in a session, in numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct Stats {
    /// Numbered lines sent, repeats included.
    pub n_lines_sent: u64,
    /// How often the core went back to a refused line.
    pub n_resends: u64,
    /// Further requests for the same line, mostly echoes from lines on their way behind it.
    pub n_echoes: u64,
    /// Requests to send again that only one of two lines vouched for.
    pub n_doubtful_resends: u64,
    /// How often the firmware was asked where it is.
    pub n_probes: u64,
    /// `ok` that never came.
    pub n_lost_oks: u64,
    /// Damaged lines that the firmware took for commands of their own.
    pub n_foreign_commands: u64,
    /// Commands of the job that the firmware does not know.
    pub n_unknown_commands: u64,
    /// Lines from the firmware that were not understood.
    pub n_unknown_lines: u64,
}

impl Stats {
    /// Whether anything was damaged or lost, as far as it was noticed.
    pub(super) const fn are_of_a_noisy_wire(&self) -> bool {
        self.n_unknown_lines > 0
            || self.n_resends > 0
            || self.n_doubtful_resends > 0
            || self.n_lost_oks > 0
            || self.n_foreign_commands > 0
    }

    /// The numbers of two sessions of one print.
    #[must_use]
    pub const fn plus(self, other: Self) -> Self {
        Self {
            n_lines_sent: self.n_lines_sent + other.n_lines_sent,
            n_resends: self.n_resends + other.n_resends,
            n_echoes: self.n_echoes + other.n_echoes,
            n_doubtful_resends: self.n_doubtful_resends + other.n_doubtful_resends,
            n_probes: self.n_probes + other.n_probes,
            n_lost_oks: self.n_lost_oks + other.n_lost_oks,
            n_foreign_commands: self.n_foreign_commands + other.n_foreign_commands,
            n_unknown_commands: self.n_unknown_commands + other.n_unknown_commands,
            n_unknown_lines: self.n_unknown_lines + other.n_unknown_lines,
        }
    }
}

/// How far the job is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Progress {
    /// Lines of the job that the firmware has acknowledged in this session.
    pub n_lines_done: u64,
    /// The highest number of a line sent.
    pub n_sent: u64,
    /// The number of the last line acknowledged.
    pub n_acked: u64,
    /// What of it may not be executed yet.
    pub ahead: Ahead,
}

/// What a firmware may have before it of the lines that it has acknowledged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Ahead {
    /// The last so many lines may not even be begun.
    pub n_lines: u64,
    /// Moves before these that the planner may still hold, at most.
    pub n_moves: u32,
    /// Moves that it surely held, where it says so.
    pub held: Option<Held>,
}
