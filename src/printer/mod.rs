//! G-code lines to a printer.
pub mod protocol;
