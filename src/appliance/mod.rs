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
//! - [`serve()`]: the parts, started again when they fail, and the graceful end;
//! - `printing`: a part for each printer, with the order of a print that makes it safe;
//! - `preparing`: jobs to G-code; `survey`: what G-code tells (pure);
//! - `live`: what printers are doing, for the faces; `notify`: a webhook; `clearing`: the program that clears a bed; `watch`: a folder
//!   whose files become jobs; `system`: the service manager;
//! - `heat`: which printers may be hot, on the disk; [`guard`]: what is done about it where no server is;
//! - `kit`: what they share;
//! - [`backup()`], [`restore()`]: the directory as one file, and back; [`doctor`]: what is wrong with all of it.
//!
//! Asked to stop, the server takes no new work, gives back what is not begun, and finishes, parks or cancels its prints as
//! the configuration says; it never drops one cold. Killed, it leaves to the next server what is in the queue, the journals and the
//! job folders: see `printing`.

mod backup;
mod clearing;
pub mod config;
pub mod doctor;
mod error;
pub mod guard;
mod heat;
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

pub use backup::{Restored, Saved, backup, restore};
pub use error::Error;
pub use serve::{Setup, serve};
