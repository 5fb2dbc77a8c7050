//! Why the server did not do it, in words for whoever sits at the terminal.

use crate::http::wire::{API, Fault};
use std::path::PathBuf;

/// Why a call came to nothing.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Nobody listens at the socket.
    #[error("no lumenfab server at {}: start it with `lumenfab serve`, or name its state directory with --state", path.display())]
    NoServer {
        /// The socket.
        path: PathBuf,
    },
    /// The socket is somebody else's.
    #[error("{} belongs to another user: work as the user under whom `lumenfab serve` runs", path.display())]
    NotYours {
        /// The socket.
        path: PathBuf,
    },
    /// It is there, but cannot be talked to.
    #[error("the lumenfab server at {place} cannot be reached: {problem}; look whether it runs")]
    Unreachable {
        /// Socket or address.
        place: String,
        /// Why.
        problem: String,
    },
    /// It does not answer.
    #[error("the lumenfab server at {place} has not answered for {waited_s} s: look whether it is well")]
    Late {
        /// Socket or address.
        place: String,
        /// How long, s.
        waited_s: u64,
    },
    /// It speaks another version.
    #[error(
        "the server speaks version {found} of the interface, this program version {API}: install the same lumenfab on both sides"
    )]
    OtherVersion {
        /// The server's.
        found: u32,
    },
    /// It is no lumenfab.
    #[error("{place} answered something that is no answer of lumenfab ({problem}): is that the right place?")]
    NotLumenfab {
        /// Socket or address.
        place: String,
        /// What was found.
        problem: String,
    },
    /// It says no.
    #[error("{}", fault.message)]
    Refused {
        /// Status of the answer.
        status: u16,
        /// What it says.
        fault: Fault,
    },
    /// The file to be sent cannot be read. Its path is for the terminal alone.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

impl Error {
    /// A stable name for programs.
    #[must_use]
    pub fn code(&self) -> &str {
        match self {
            Self::NoServer { .. } => "client.no_server",
            Self::NotYours { .. } => "client.not_yours",
            Self::Unreachable { .. } => "client.unreachable",
            Self::Late { .. } => "client.late",
            Self::OtherVersion { .. } => "client.other_version",
            Self::NotLumenfab { .. } => "client.not_lumenfab",
            Self::Refused { fault, .. } => &fault.code,
            Self::File { .. } => "client.file",
        }
    }
}
