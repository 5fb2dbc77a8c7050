//! G-code to a printer: every line executed exactly once, or a fault that says so.
//!
//! [`protocol`] is the conversation, a pure state machine; [`driver`] is the only code that touches a port;
//! [`link`] and [`serial`] are ports; [`job`] checks G-code before the first line of it is sent; [`sim`] runs the simulated
//! printer as a process of its own. Nothing here knows of layers or meshes.
//!
//! A journal of what was sent and acknowledged will hook into the driver, where lines go out and
//! [`protocol::Core::progress`] is read; the core's numbering (from 1, one number for each line of the job and a few of
//! the host's) is what a resumed session would go on with.

pub mod driver;
mod error;
pub mod job;
pub mod journal;
pub mod link;
pub mod protocol;
pub mod replay;
pub mod serial;
pub mod sim;

pub use error::{Error, PortProblem};
