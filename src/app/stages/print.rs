//! G-code to the printer: `record/`, `print.json`.

use crate::app::error::Error;
use crate::app::session::{Context, Session};
use serde::Serialize;
use std::path::Path;

/// What the simulated printer laid down.
pub(crate) const RECORD_DIR: &str = "record";

/// How a print went.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Printed {
    /// Lines.
    pub n_lines: u64,
}

impl std::fmt::Display for Printed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} lines", self.n_lines)
    }
}

impl Session<'_> {
    /// x
    pub fn print(&mut self) -> Result<(), Error> {
        Ok(())
    }
    pub(crate) fn check_print(&self) -> Result<(), Error> {
        Ok(())
    }
}

/// x
pub fn print_file(_: &Path, _: &str, _: &str, _: &Context<'_>) -> Result<Printed, Error> {
    Err(crate::printer::Error.into())
}
