//! G-code to a printer: every line executed exactly once, or a fault that says so.
//!
//! ```text
//!  job ──▶ session ──▶ protocol ──bytes──▶ driver ──▶ link (serial, device) ──▶ printer
//!            │ ▲                             │
//!            ▼ └── resume ◀── replay         └── clock
//!         journal ──thread──▶ JOB.gcode.journal
//! ```
//!
//! [`protocol`] is the conversation, a pure state machine; [`session`] is one print over all that may break off in between,
//! pure as well; [`driver`] is the only code that touches a port; [`link`], [`serial`] and [`device`] are ports; [`job`] checks
//! G-code before the first line of it is sent; [`journal`] keeps on disk how far a print is, [`replay`] what that means for
//! the machine, [`resume`] whether and where it can go on, [`picture`] the layer where it does; [`paper`] is a job from a file
//! with what is kept beside it; [`policy`] is what is done when something goes wrong, [`control`] what the operator asks for
//! meanwhile, and whether material may be laid yet ([`laying`]); [`ask`] asks a printer that is not printing; [`sim`] runs the simulated printer as a process of its own. Nothing
//! here knows of layers or meshes.

pub mod ask;
pub mod control;
pub mod device;
pub mod driver;
mod error;
pub mod holder;
pub mod identity;
pub mod job;
pub mod journal;
pub mod laying;
pub mod link;
pub mod paper;
pub mod picture;
pub mod policy;
pub mod protocol;
pub mod replay;
pub mod resume;
pub mod serial;
pub mod session;
pub mod sim;

pub use error::{Error, JobLost, PortProblem};
