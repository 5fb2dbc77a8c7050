//! The command line: a face of [`crate::app`].

/// Runs the command and returns its exit code.
#[must_use]
pub fn main() -> std::process::ExitCode {
    std::process::ExitCode::from(2)
}
