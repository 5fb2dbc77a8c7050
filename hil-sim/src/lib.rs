//! `hil-sim`: a simulated FDM printer on a pseudo-terminal that records what it deposits.
//!
//! It is the other end of the wire and the judge of the host: it has its own G-code parser, motion planner, heaters and
//! recorder, and shares no code with the program that talks to it, so that one bug cannot hide on both sides.
//!
//! ```text
//! host ──pty──> [pty, driver] ──bytes, time──> wire ─> receive ─> gcode ─> printer ─> planner ─> deposit
//!                    ^                                                        │           │          │
//!                    └──────────── replies ───────────────────────────────────┘        thermal    events
//!                                                                                                    │
//!                                       beads.csv, events.jsonl, summary.json <── record <───────────┘
//! ```
//!
//! | module | one line |
//! |---|---|
//! | [`profile`] | machines as data: bed, limits, heaters, buffers, dialect |
//! | [`dialect`] | what a firmware says, word by word |
//! | [`spec`] | faults: `KIND[:key=value,...]`, their keys, when they strike |
//! | [`wire`] | baud rate, and the line faults both ways |
//! | [`receive`] | receive ring, line buffer, line numbers and checksums |
//! | [`gcode`] | one line of text to a command with its parameters |
//! | [`planner`] | moves to trapezoids with junction speeds and look-ahead |
//! | [`thermal`] | first-order heaters and the firmware's protection of them |
//! | [`deposit`] | executed moves to beads |
//! | [`printer`] | the machine: commands, waits, replies, simulated time |
//! | [`event`] | what is recorded |
//! | [`scenario`] | options and faults from a TOML file |
//! | [`record`], [`pty`], [`driver`], [`cli`], [`replay`] | the only parts that touch files, terminals and clocks |
//!
//! # Invariants
//!
//! - The core (all but the last row) knows no clock, file, thread or random source: bytes and simulated time in, bytes and
//!   events out. The same bytes at the same simulated times with the same seed give the same bytes and events.
//! - Without a baud rate the link is like USB: flow-controlled, and a line is delivered whole. Time then passes only
//!   while a command waits (for room in the planner, a temperature, a dwell), so that what is recorded follows from the
//!   sequence of commands alone, however the host's writes were cut. With a baud rate every byte takes its time, and
//!   bytes that find the receive ring full are lost, as on a UART.
//! - Lengths mm, speeds mm/s, times s, temperatures °C, unless a name says otherwise. Positions are in the bed frame.

pub mod cli;
pub mod deposit;
pub mod dialect;
pub mod driver;
pub mod error;
pub mod event;
pub mod gcode;
pub mod planner;
pub mod printer;
pub mod profile;
pub mod pty;
pub mod receive;
pub mod record;
pub mod replay;
pub mod rng;
pub mod scenario;
pub mod spec;
pub mod thermal;
mod whole;
pub mod wire;

pub use error::Error;
