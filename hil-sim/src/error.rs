//! Everything that can go wrong outside the simulated printer itself.

use std::{io, path::PathBuf};

/// Why the simulator could not start, go on or draw.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// No such machine.
    #[error("unknown profile `{name}`: choose one of {known}")]
    UnknownProfile {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// A fault SPEC that cannot be read.
    #[error("fault `{spec}`: {problem}")]
    Fault {
        /// The SPEC as given.
        spec: String,
        /// What is wrong with it and what is expected.
        problem: String,
    },
    /// An option or scenario value that makes no sense.
    #[error("{option}: {problem}")]
    Option {
        /// The option or key.
        option: String,
        /// What is wrong with it and what is expected.
        problem: String,
    },
    /// The scenario file is not what it should be.
    #[error("scenario {}: {problem}", path.display())]
    Scenario {
        /// The file.
        path: PathBuf,
        /// What the TOML reader says, with line and column.
        problem: String,
    },
    /// The place of the link is taken.
    #[error("link {}: there is already {found}; choose another path or remove it", path.display())]
    LinkTaken {
        /// The path asked for.
        path: PathBuf,
        /// What is there.
        found: &'static str,
    },
    /// The operating system refused something.
    #[error("{action} {}: {source}", path.display())]
    Io {
        /// What was tried, for example `write`.
        action: &'static str,
        /// The file, directory or terminal.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A line of `beads.csv` that is not of its form.
    #[error("{} line {line}: {problem}", path.display())]
    Beads {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What was found and what is expected.
        problem: String,
    },
    /// The layer asked for does not exist.
    #[error("{}: there is no layer {layer}; the record has {n_layers} (counted from 0)", path.display())]
    NoLayer {
        /// The record.
        path: PathBuf,
        /// The layer asked for.
        layer: usize,
        /// How many there are.
        n_layers: usize,
    },
}

impl Error {
    /// The operating system's refusal to do `action` on `path`.
    pub(crate) fn io(action: &'static str, path: impl Into<PathBuf>, source: impl Into<io::Error>) -> Self {
        Self::Io { action, path: path.into(), source: source.into() }
    }

    /// 2 for wrong usage or configuration, 1 for work that failed.
    #[must_use]
    pub const fn exit_code(&self) -> u8 {
        match self {
            Self::UnknownProfile { .. }
            | Self::Fault { .. }
            | Self::Option { .. }
            | Self::Scenario { .. }
            | Self::LinkTaken { .. }
            | Self::NoLayer { .. } => 2,
            Self::Io { .. } | Self::Beads { .. } => 1,
        }
    }
}
