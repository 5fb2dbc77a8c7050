//! Words that go without a number, before all other lines, and the `ok` that the firmware owes for each.
//!
//! Answers come in the order of what they answer. So the `ok` of such a word is the one that follows when all lines sent before it
//! are acknowledged: it acknowledges no line, and is no sign of a damaged one. Where it is lost, that of the next line is taken for
//! it: an acknowledgement too late, which the next question puts right, never one too early.

use super::{Acknowledgement, Core};
use std::collections::VecDeque;

/// More than that are never owed at once by a firmware that answers.
const MAX_OWED: usize = 16;

/// The `ok` of a word without a number.
#[derive(Debug, Clone, Copy)]
pub(super) struct Owed {
    /// The last line sent before it.
    after: u64,
    /// Whether it brings temperatures.
    is_question: bool,
}

/// The oldest first.
#[derive(Debug, Clone, Default)]
pub(super) struct Debts(VecDeque<Owed>);

impl Debts {
    fn push(&mut self, owed: Owed) {
        self.0.truncate(MAX_OWED - 1);
        self.0.push_back(owed);
    }

    /// The firmware has answered a later question: what is still owed was lost.
    pub(super) fn forget(&mut self) {
        self.0.clear();
    }

    /// What was said behind line `number` was thrown away with it.
    pub(super) fn forget_from(&mut self, number: u64) {
        self.0.retain(|owed| owed.after < number);
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Whether an `ok` without a number is one of these, now that lines up to `acked` are acknowledged.
    fn pay(&mut self, ok: &Acknowledgement, acked: u64) -> bool {
        while let Some(owed) = self.0.front().copied().filter(|owed| owed.after <= acked) {
            self.0.pop_front();
            // Temperatures answer nothing but a question: what was owed before is lost.
            if owed.is_question || ok.temperatures.is_none() {
                return true;
            }
        }
        false
    }

    /// Where lines are acknowledged by their numbers, an `ok` without one is of these wherever it comes.
    fn pay_any(&mut self) -> bool {
        self.0.pop_front().is_some()
    }
}

impl Core {
    /// Says a word without a number, before all lines that wait.
    pub(super) fn say_now(&mut self, text: &str) {
        self.urgent.push_back(format!("{text}\n"));
        let after = self.wire.next() - 1;
        self.owed.push(Owed { after, is_question: text == "M105" });
    }

    /// Whether an `ok` is one that is owed for such a word.
    pub(super) fn is_owed(&mut self, ok: &Acknowledgement) -> bool {
        if ok.line.is_some() {
            return false;
        }
        if self.is_advanced { self.owed.pay_any() } else { self.owed.pay(ok, self.wire.acked()) }
    }
}
