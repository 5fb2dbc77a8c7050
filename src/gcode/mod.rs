//! G-code: the command type, the writer for jobs, the reader for lines, checksums.
//!
//! [`write()`] turns [`Toolpaths`](crate::toolpath::Toolpaths) into the text of a job in the Marlin
//! dialect; [`reader`] takes any line of G-code apart. Only words of one letter and a number are
//! understood (NIST RS-274 as printers use it); expressions and macros are not.

pub mod reader;
mod writer;

pub use reader::{Command, Line};
pub use writer::{Header, volume_mm3, write};
