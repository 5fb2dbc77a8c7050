//! G-code: the command type, the writer for jobs, the reader for lines, checksums.
//!
//! [`write()`] turns [`Toolpaths`](crate::toolpath::Toolpaths) into the text of a job in the profile's dialect, [`timed`] tells
//! it how long it takes; [`reader`] takes any line of G-code apart. Only words of one letter and a number are understood
//! (NIST RS-274 as printers use it); expressions and macros are not.

mod cool;
mod head;
mod label;
mod limits;
mod path;
pub mod reader;
mod thumbnail;
mod timing;
mod writer;

pub use head::profile_in_head;
pub use reader::{Command, Line};
pub use thumbnail::Thumbnail;
pub use timing::{Mark, Timing, timed};
pub use writer::{Header, volume_mm3, write};
