//! The queue: what becomes of jobs, from a draft to the sign-off, on printers that nobody watches.
//!
//! Everything here is pure: time arrives as an argument, chance as bytes; nothing is read or written. [`crate::store`] keeps what is
//! decided here, each change in one transaction together with its records.
//!
//! - [`state`]: the states of a job and the one table of what may follow what, and by whom;
//! - [`job`]: a job, its opaque specification, and how a change changes it;
//! - [`fit`]: what it needs against what a printer has loaded;
//! - [`printer`], [`claim`]: whether a bed is clear, who has a job and for how long that is believed;
//! - [`act`]: a change as a whole, and all rules of safety;
//! - [`fact`], [`history`]: who did what, when and why; records that show when one of them was changed;
//! - [`schedule`]: which job is next, why none is, when each of them ends.
//!
//! The life of a job: a draft is submitted; a worker takes it and makes its G-code; a printer whose bed is clear and that fits
//! takes it, records that material is about to be laid, prints a copy; the bed is cleared; the next copy, the sign-off or the end
//! follows. Each copy is printed at most once: a print that broke off after material was laid begins again only by an
//! operator's `retry`.
//!
//! What it does not do: it knows no mesh, no G-code and no file, and no names that files had. Nothing here starts a
//! printer; what is decided is what may be done.

pub mod act;
pub mod claim;
mod digest;
pub mod fact;
pub mod fit;
pub mod history;
pub mod job;
pub mod printer;
mod rank;
mod refusal;
pub mod schedule;
pub mod state;
#[cfg(test)]
pub(crate) mod tests;
mod text;
#[cfg(test)]
mod week;

pub use act::{Actor, By, Request, Said};
pub use claim::{Claim, Claimant};
pub use digest::{Digest, NoDigest};
pub use fact::{Fact, Subject, What, Who};
pub use fit::{Estimate, Loaded, Misfit, Needs};
pub use history::{Break, Head, Record, Sealed};
pub use job::{Change, Edit, Job, JobId, Made, Spec, SpecKind, SpecMark, Ticket, Wishes};
pub use printer::{Bed, Evidence, Printer, PrinterChange};
pub use rank::{NoRank, Rank};
pub use refusal::Refusal;
pub use state::{Kind, Role, State};
pub use text::{Material, Name, Reason};
