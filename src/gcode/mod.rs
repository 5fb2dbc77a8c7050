//! G-code: the command type, the writer for jobs, the reader for lines, checksums.
//!
//! [`write`](writer::write) turns [`Toolpaths`](crate::toolpath::Toolpaths) into the text of a job in the Marlin dialect; [`reader`] takes any line of G-code
//! apart. Only words of one letter and a number are understood (NIST RS-274 as printers use it); expressions and
//! macros are kept as text.

pub mod reader;
mod writer;

pub use reader::{Command, Line};
pub use writer::{Header, PLACEHOLDERS, unknown_placeholder, write};
