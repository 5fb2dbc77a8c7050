//! The appliance: what `lumenfab serve` is.
//!
//! ```text
//!  clients ──socket── http ──▶ store ◀── preparing (workers, each job a child process)
//!                      │         ▲  ▲
//!                      │ wishes  │  └── watch (a folder)
//!                      ▼         │
//!                   printing ────┘──thread──▶ printer::driver ──▶ printer
//! ```
//!
//! - [`place`]: the state directory, which one server has alone;
//! - [`config`]: what the operator decides (pure);
//! - [`serve()`]: the parts, and the graceful end; `watchman`: they are started again when they fail;
//! - `printing`: a part for each printer, with the order of a print that makes it safe;
//! - `preparing`: jobs to G-code; `survey`: what G-code tells (pure);
//! - `live`: what printers are doing, for the faces; `notify`: a webhook; `clearing`: the program that clears a bed; `watch`: a folder
//!   whose files become jobs; `keeping`: what is over goes from the disk; `system`: the service manager;
//! - `heat`: which printers may be hot, on the disk; [`guard`]: what is done about it where no server is;
//! - `kit`: what they share;
//! - [`backup()`], [`restore()`]: the directory as one file, and back; [`doctor`]: what is wrong with all of it.
//!
//! Asked to stop, the server takes no new work, gives back what is not begun, and finishes, parks or cancels its prints as
//! the configuration says; it never drops one cold, and does not either where a part of it cannot be started any more: it ends then as if
//! it had been asked to. Killed, it leaves to the next server what is in the queue, the journals and the
//! job folders: see `printing`.

mod backup;
mod clearing;
pub mod config;
pub mod doctor;
mod error;
pub mod guard;
mod heat;
mod keeping;
mod kit;
mod live;
mod notify;
pub mod place;
mod preparing;
mod printing;
mod serve;
mod survey;
mod system;
#[cfg(test)]
mod tests;
mod watch;
mod watchman;

pub use backup::{Restored, Saved, backup, restore};
pub use error::Error;
pub use serve::{Setup, serve};
