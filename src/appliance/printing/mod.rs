//! Printing: a part of the server for each printer.
//!
//! A print goes in this order, and none of its steps before the one above:
//!
//! 1. the bed is known to be clear, and the printer takes a job ([`Store::claim`](crate::store::Store::claim));
//! 2. the port is opened, the journal begun; the job homes and heats;
//! 3. before the first line that may lay material the printer stands still until the queue has recorded that some is laid
//!    ([`Change::Lay`](crate::queue::Change::Lay)), which it does only where the claim still holds and nobody doubts the bed;
//! 4. the rest is printed; the end is recorded; the bed awaits somebody, or a program, that clears it.
//!
//! What was in print when a server died is taken up by the next one: of which nothing was laid goes back into the queue, the heaters
//! are switched off; what can be gone on with waits for an operator's word, warm as long as its profile's `orphan_hold_s`; the
//! rest has failed. Nothing is ever printed twice.
//!
//! - `press`: the thread that speaks to the printer;
//! - `bed`: what is known of its bed, and the program that clears it;
//! - `commands`: lines that somebody asks for while it does not print;
//! - `attend`: standing by it: claim, limits, wishes;
//! - `outcome`: what becomes of the job then (pure);
//! - `waiting`: a print that broke off, until somebody says what becomes of it;
//! - `port`: the port while nobody speaks to the printer, and whether its bed is watched; `identity`: which machine it is;
//! - `heaters`: heaters that nobody owns; `stop`: emergency stop where no print is under way;
//! - `station`: all of it, for one printer.

mod attend;
mod bed;
mod commands;
mod heaters;
mod identity;
mod outcome;
mod port;
mod press;
mod station;
mod stop;
mod waiting;

pub(super) use identity::Identities;
pub(super) use press::Machine;
pub(super) use station::{Kept, Memory, Station, machine};

use crate::queue::Claim;
use std::path::PathBuf;

/// A job that a printer has in hand.
#[derive(Debug)]
struct Held {
    claim: Claim,
    gcode: PathBuf,
    /// Whether the queue knows that material was laid.
    is_laid: bool,
    /// Whether the printer stands.
    is_paused: bool,
    shown: Shown,
    /// The printer could go on, but not exactly, and somebody has been told so.
    needs_consent: bool,
    print_s: u32,
    n_first_layer: Option<u64>,
}

/// What the queue has a job down as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shown {
    Printing,
    Paused,
    /// One of them: the last change may or may not have been recorded.
    Unknown,
}
