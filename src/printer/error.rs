//! What can go wrong on the way to the printer, with a stable code and a next step for each.

use super::protocol::{Fault, Heat};
use super::resume::{Recovery, Refusal};
use super::{job, journal};

/// Why a port could not be opened.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PortProblem {
    /// There is nothing by this name.
    #[error("does not exist")]
    Missing,
    /// It begins like a device's name, and is none.
    #[error("is no usb:VENDOR:PRODUCT[:SERIAL] with four hexadecimal digits for vendor and product")]
    Malformed,
    /// The user may not open it.
    #[error("may not be opened by this user")]
    NoRights,
    /// Another program has it; which one, where that can be seen.
    #[error("is in use by another program{}", .0.as_ref().map_or_else(String::new, |holder| format!(" ({holder})")))]
    Busy(Option<String>),
    /// It is a file, a folder or a device of another kind.
    #[error("is not a serial port")]
    NotAPort,
    /// So many devices are plugged in that it may be.
    #[error("may be any of {0} like devices")]
    Ambiguous(usize),
    /// The device behind it is gone or does not answer.
    #[error("cannot be opened: {0}")]
    Other(String),
}

/// A job that could not be read any more in the middle of its print, which was given up.
#[derive(Debug, thiserror::Error)]
#[error("{source}; {heat}")]
pub struct JobLost {
    /// Why.
    pub source: job::Error,
    /// What is known of the printer's heaters.
    pub heat: Heat,
}

impl From<job::Error> for JobLost {
    fn from(source: job::Error) -> Self {
        Self { source, heat: Heat::default() }
    }
}

/// A print that was not done.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The job cannot be sent as it is.
    #[error(transparent)]
    Job(#[from] job::Error),
    /// The job could not be read any more while it was printed.
    #[error(transparent)]
    JobLost(#[from] JobLost),
    /// The port cannot be opened.
    #[error("port {port} {problem}; {}", next_step_of(problem))]
    Open {
        /// The port.
        port: String,
        /// Why.
        problem: PortProblem,
    },
    /// The journal cannot be used.
    #[error(transparent)]
    Journal(#[from] journal::Error),
    /// Another process prints this very job.
    #[error(
        "{job}: is being printed by another lumenfab; wait for its end, or stop that one; a copy of the job can be printed elsewhere"
    )]
    BeingPrinted {
        /// The job.
        job: String,
    },
    /// The job is not the one of the journal.
    #[error(
        "{job}: found another job than the journal {journal} tells of, expected the same bytes; free the bed and begin the new one \
         with `lumenfab print --anew`; if the printer is hot, `lumenfab safe-off` switches its heaters off"
    )]
    OtherJob {
        /// The job.
        job: String,
        /// The journal.
        journal: String,
    },
    /// The print can go on, but not exactly.
    #[error("not resumed: {recovery}; to do so, look at the part and give --after-reset; {heat}")]
    NeedsConsent {
        /// How it would go on.
        recovery: Box<Recovery>,
        /// The heaters, which are as they were.
        heat: Heat,
    },
    /// The print cannot go on, which the journal tells; the printer was not asked.
    #[error(
        "not resumed: {0}; nothing was sent to the printer: if it is hot, `lumenfab safe-off` switches its heaters off"
    )]
    NotResumable(#[from] Refusal),
    /// The print cannot go on, which the printer has told; its heaters were switched off.
    #[error("not resumed: {refusal}; {heat}")]
    Refused {
        /// Why not.
        refusal: Refusal,
        /// What is known of its heaters.
        heat: Heat,
    },
    /// The port vanished while printing.
    #[error(
        "port {port} vanished during the print; whether the heaters are on is unknown: check the cable, and switch \
         the printer off if it is hot; `lumenfab resume` goes on once the port is back"
    )]
    PortVanished {
        /// The port.
        port: String,
    },
    /// Nothing says which firmware it is.
    #[error("port {port}: nothing answers M115; {}", NOBODY)]
    Nobody {
        /// The port.
        port: String,
    },
    /// The print was given up.
    #[error("printer on {port}: {fault}; {heat}; {}", next_step_after(fault, heat))]
    Fault {
        /// The port.
        port: String,
        /// Why.
        fault: Fault,
        /// What is known of its heaters.
        heat: Heat,
    },
    /// Heaters-off was sent, but the targets are not 0.
    #[error("the printer on {port} answers, but its heaters are still on after heaters-off: switch it off")]
    StillHeating {
        /// The port.
        port: String,
    },
    /// Given up on request.
    #[error("the print was cancelled; {heat}; {}", next_step_after_stop(heat))]
    Cancelled {
        /// What is known of the printer's heaters.
        heat: Heat,
    },
    /// The last print of this job broke off, and its part may be on the bed.
    #[error(
        "the last print of {job} broke off behind line {n_done} of {n_lines} or a little later: go on with `lumenfab resume {job}`, or free the bed \
         and give --anew"
    )]
    Unfinished {
        /// The job.
        job: String,
        /// Lines of it that are certainly executed.
        n_done: u64,
        /// Lines of it.
        n_lines: u64,
    },
    /// Given up on request before anything was sent.
    #[error(
        "stopped before anything was sent to {port}: the printer is as it was; {heat}; `lumenfab safe-off` switches them off"
    )]
    Left {
        /// The port.
        port: String,
        /// What is known of its heaters.
        heat: Heat,
    },
    /// The journal's print was made by another profile, or on another printer.
    #[error("not resumed: the print began with {expected}, found {found}; give the one with which it began")]
    OtherMachine {
        /// What was given.
        found: String,
        /// What the journal tells of.
        expected: String,
    },
    /// The simulated printer did not start or ended badly.
    #[error("the simulated printer {problem}")]
    Simulator {
        /// What happened.
        problem: String,
    },
}

impl Error {
    /// A stable name for programs.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Job(error) => error.code(),
            Self::JobLost(lost) => lost.source.code(),
            Self::Open { problem: PortProblem::Missing, .. } => "printer.port_missing",
            Self::Open { problem: PortProblem::Malformed, .. } => "printer.port_malformed",
            Self::Open { problem: PortProblem::NoRights, .. } => "printer.port_no_rights",
            Self::Open { problem: PortProblem::Busy(_), .. } => "printer.port_busy",
            Self::Open { problem: PortProblem::NotAPort, .. } => "printer.not_a_port",
            Self::Open { problem: PortProblem::Ambiguous(_), .. } => "printer.port_ambiguous",
            Self::Open { problem: PortProblem::Other(_), .. } => "printer.port_failed",
            Self::Journal(error) => error.code(),
            Self::BeingPrinted { .. } => "printer.being_printed",
            Self::OtherJob { .. } => "printer.other_job",
            Self::NeedsConsent { .. } => "printer.resume_needs_consent",
            Self::NotResumable(refusal) | Self::Refused { refusal, .. } => refusal.code(),
            Self::Nobody { .. } => "printer.nobody",
            Self::PortVanished { .. } => "printer.port_vanished",
            Self::Fault { fault, .. } => fault.code(),
            Self::StillHeating { .. } => "printer.still_heating",
            Self::Cancelled { heat } if heat.is_safe() => "printer.cancelled",
            Self::Cancelled { .. } => "printer.cancel_unconfirmed",
            Self::Unfinished { .. } => "printer.unfinished",
            Self::Left { .. } => "printer.left",
            Self::OtherMachine { .. } => "printer.other_machine",
            Self::Simulator { .. } => "printer.simulator",
        }
    }

    /// What the operator should do next.
    #[must_use]
    pub fn next_step(&self) -> &'static str {
        match self {
            Self::Job(_) => "correct the job, or choose the profile it was made for",
            Self::JobLost(JobLost { heat, .. }) if !heat.is_safe() => "switch the printer off if it is hot",
            Self::JobLost(_) => {
                "see that the job can be read; `lumenfab resume` then tells whether its print can go on"
            }
            Self::Open { problem, .. } => next_step_of(problem),
            Self::BeingPrinted { .. } => "wait for its end, or stop that one",
            Self::Journal(journal::Error::Io { action: "written", .. }) => {
                "make room on that disk, or put the job into a folder that you may write"
            }
            Self::Journal(_) | Self::OtherJob { .. } => {
                "free the bed and print the job from its beginning with --anew"
            }
            Self::NeedsConsent { .. } => "look at the part; then resume with --after-reset, or print anew",
            Self::NotResumable(_) | Self::Refused { .. } => "take the part off the bed and print anew",
            Self::Nobody { .. } => NOBODY,
            Self::PortVanished { .. } => Fault::LinkLost.next_step(),
            Self::Fault { fault, heat, .. } => next_step_after(fault, heat),
            Self::StillHeating { .. } => "switch the printer off",
            Self::Cancelled { heat } => next_step_after_stop(heat),
            Self::Unfinished { .. } => "go on with `lumenfab resume`, or free the bed and print with --anew",
            Self::Left { .. } => {
                "switch the heaters off with `lumenfab safe-off`, or go on with `lumenfab resume`"
            }
            Self::OtherMachine { .. } => "give the printer and the profile with which the print began",
            Self::Simulator { .. } => "run the simulator by hand to see what it says",
        }
    }
}

/// Heat without an owner goes before everything else.
fn next_step_after(fault: &Fault, heat: &Heat) -> &'static str {
    match heat {
        Heat::Off(_) | Heat::Obeyed | Heat::Halted => fault.next_step(),
        Heat::On(_) => "switch the printer off",
        Heat::Unknown(_) => match fault {
            Fault::NoAnswer { .. } | Fault::NoLineNumbers | Fault::OtherFirmware { .. } | Fault::Echo => {
                fault.next_step()
            }
            _ => "switch the printer off if it is hot, then look what is wrong with it and its cable",
        },
    }
}

const fn next_step_after_stop(heat: &Heat) -> &'static str {
    match heat {
        Heat::Off(_) | Heat::Obeyed => "take the part off the bed before the next print",
        Heat::Halted => "reset the printer, and take the part off the bed before the next print",
        Heat::On(_) => "switch the printer off",
        Heat::Unknown(_) => "switch the printer off if it is hot",
    }
}

/// What to do where nothing answers at all.
const NOBODY: &str = "check that this is the printer's port, that it is on, and its rate (--baud); where it has stopped for \
                      good (M112, an error on its display) reset it or switch it off and on";

const fn next_step_of(problem: &PortProblem) -> &'static str {
    match problem {
        PortProblem::Ambiguous(_) => "name one by its serial number or by its path",
        PortProblem::Missing => "check that the printer is on and connected, and the name of its port",
        PortProblem::Malformed => "`lsusb` lists vendor and product of each device",
        PortProblem::NoRights => {
            "add the user to the group that owns the port (often dialout) and log in again"
        }
        PortProblem::Busy(_) => "close the other program",
        PortProblem::NotAPort => "give the path of a serial device, for example /dev/ttyUSB0",
        PortProblem::Other(_) => "unplug the printer, plug it in again and check its port",
    }
}
