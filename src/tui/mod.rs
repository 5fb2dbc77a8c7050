//! The terminal UI: one screen of the appliance, a face of [`crate::client`]. Leaving it changes nothing at the server.
//!
//! ```text
//!  keys, mouse, size ─┐                            ┌─▶ view ─▶ terminal
//!  clock ─────────────┼─ Message ─▶ update ─▶ State ┘
//!  client ────────────┘               └─▶ Effect ─▶ client
//! ```
//!
//! The core is pure: `state` is all that is known, `message` what can happen and what can be asked for, `update` what follows, `view` how it
//! looks; `command` is the one table of keys, names and words. It reads no clock (time comes as a message) and does no IO. The edge
//! is thin: `edge` has the terminal and puts it back on every way out, `link` the connection, which is looked for again and again.
//!
//! The screen is drawn after something has happened, thirty times a second at most, and only what differs is sent. A list of any length costs what
//! is seen of it. What needs the API of cases (new case, report) is not here yet; nor is the layer that is printed: the API does not give it.

mod awaits;
mod command;
mod edge;
mod form;
mod heats;
mod link;
mod message;
mod state;
#[cfg(test)]
mod tests;
mod theme;
mod update;
mod view;
mod words;

pub use edge::{Error, Options, run};
pub use theme::Theme;
