//! Why the appliance does not run, with a stable code and a next step for each.

use super::config::Faults;
use crate::http::keys::KeysError;
use crate::http::serve::{BindError, ServeError};
use crate::{profile, store};
use std::path::PathBuf;

/// Why a server could not be started, or ended.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The environment names no place.
    #[error("neither STATE_DIRECTORY, XDG_STATE_HOME nor HOME is set: name the state directory with --state")]
    NoHome,
    /// Another server has the state directory.
    #[error("{}: another lumenfab serves from this directory: stop it first, or name another one with --state", dir.display())]
    InUse {
        /// The directory.
        dir: PathBuf,
    },
    /// The configuration cannot be used.
    #[error(transparent)]
    Config(#[from] Faults),
    /// The profile of a printer cannot be used.
    #[error("printer {printer}: {source}")]
    Profile {
        /// The printer.
        printer: String,
        /// Why.
        source: Box<profile::Error>,
    },
    /// A file or directory.
    #[error("{}: {source}: check its rights and the disk", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A backup cannot be made, or not be restored.
    #[error("{}: {problem}", path.display())]
    Backup {
        /// The backup, or the state directory.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// The queue.
    #[error(transparent)]
    Store(#[from] store::Error),
    /// The keys.
    #[error(transparent)]
    Keys(#[from] KeysError),
    /// What is listened to.
    #[error(transparent)]
    Bind(#[from] BindError),
    /// The faces.
    #[error(transparent)]
    Faces(#[from] ServeError),
    /// The system gives no threads.
    #[error("cannot start what the server needs: {0}: close other programs and try again")]
    Runtime(std::io::Error),
    /// A part of the server ended again and again.
    #[error(
        "{part} ended too often: look into the log; what printed has ended as on_stop says, or is taken up by the next server"
    )]
    GaveUp {
        /// The part.
        part: &'static str,
    },
}

impl From<crate::queue::Refusal> for Error {
    fn from(refusal: crate::queue::Refusal) -> Self {
        Self::Store(refusal.into())
    }
}

impl Error {
    /// A stable name for programs.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::NoHome => "serve.no_home",
            Self::InUse { .. } => "serve.in_use",
            Self::Config(_) => "serve.config",
            Self::Profile { .. } => "serve.profile",
            Self::Io { .. } => "serve.io",
            Self::Backup { .. } => "serve.backup",
            Self::Store(error) => error.code(),
            Self::Keys(_) => "serve.keys",
            Self::Bind(_) => "serve.bind",
            Self::Faces(_) => "serve.faces",
            Self::Runtime(_) => "serve.runtime",
            Self::GaveUp { .. } => "serve.gave_up",
        }
    }

    /// 2 where what was said to it is wrong, 1 where the work failed.
    #[must_use]
    pub const fn exit_code(&self) -> u8 {
        match self {
            Self::NoHome | Self::Config(_) | Self::Profile { .. } => 2,
            _ => 1,
        }
    }
}
