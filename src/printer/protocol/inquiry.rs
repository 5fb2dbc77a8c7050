//! Questions to a printer that is not printing, or that was left in the middle of a job by somebody who is gone.
//!
//! The last line: a numbered line far ahead cannot be accepted, and its refusal names the last one that was. Firmware
//! that counts no lines is asked for temperatures only: what it has taken shows in its position. Where the link broke within a line, its
//! first half waits in the firmware, and might be obeyed: what is put behind it makes it a line that no firmware understands.

use super::recovery::Late;
use super::wire::{VOID, Wire};
use super::{Acknowledgement, Core, Event, Fault, Greeting, NextOk, Reply, ResendStyle, State, Timer};
use crate::profile::Dialect;

/// What a printer can be asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Question {
    /// Where it is: M114.
    Position,
    /// How warm it is: M105.
    Temperatures,
}

impl Question {
    const fn command(self) -> &'static str {
        match self {
            Self::Position => "M114\n",
            Self::Temperatures => "M105\n",
        }
    }
}

/// A question under way.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Inquiry {
    /// What was asked.
    pub question: Question,
    /// How often.
    tries: u32,
    /// Whether the answer has come.
    is_told: bool,
    /// Whether an `ok` has come: before the answer where a firmware says it as it takes a line (Repetier), else with or behind it.
    is_acked: bool,
}

/// So many answers to the first probes may be of earlier questions.
const MAX_LATE: u32 = 2;

/// A question is repeated so often.
const MAX_TRIES: u32 = 8;

/// A firmware in the middle of long moves takes its time for the first answer.
const EXTRA_TRIES: u32 = 16;

/// Behind a half line: makes it one that no firmware understands. The digits, because the first half of `M105` is `M1`, which
/// waits for the user; then no number, because `M104 S` is a half line too; then X, because Klipper takes over a move's axes up to
/// the first that is no number, and reads X first.
const SPOILER: &str = "99?X?\n";

impl Core {
    /// Asks for the last line of an earlier session.
    pub(super) fn inquire(&mut self, beyond: u64) {
        self.inquired_beyond = Some(beyond);
        self.forget_question();
        self.wire = Wire::new(&self.config.firmware);
        self.wire.begin_after(beyond);
        self.inquire_again(0);
    }

    pub(super) fn inquire_again(&mut self, tries: u32) {
        self.tell_no_answer(tries);
        if tries >= self.max_greetings() + EXTRA_TRIES {
            self.unanswered();
            return;
        }
        let is_summed = self.config.firmware.dialect == Dialect::RepRapFirmware;
        let mut text = if is_summed { VOID } else { SPOILER }.to_owned();
        self.wire.write_probe(&mut text);
        self.urgent.push_back(text);
        self.refused = None;
        self.next_ok = NextOk::Acknowledges;
        self.state = State::Handshake(Greeting::AwaitLast(tries + 1));
        self.timers.set(Timer::Handshake, self.now + self.config.response);
    }

    /// The firmware wants this line next.
    pub(super) fn on_named(&mut self, tries: u32, number: u64) {
        let refused = self.refused.take();
        self.next_ok = self.after_refusal();
        let agrees = match refused {
            Some((_, last)) => last.checked_add(1) == Some(number),
            None => self.config.firmware.resend_style == ResendStyle::Rs,
        };
        if !agrees {
            self.inquire_again(tries);
            return;
        }
        // Smoothieware begins at 0.
        let last = number.saturating_sub(1);
        self.wire.begin_after(last);
        self.found(Some(last));
    }

    /// Without numbers the temperatures are the answer; with them an `ok` that brings temperatures means that the probe was
    /// obeyed instead of refused.
    pub(super) fn on_inquiry_ok(&mut self, ok: Acknowledgement, tries: u32) {
        let is_of_refusal = std::mem::take(&mut self.next_ok) == NextOk::EndsRefusal;
        if ok.temperatures.is_none() || is_of_refusal {
            return;
        }
        if self.config.firmware.counts_lines() {
            // The first may be late answers to somebody else.
            if tries > MAX_LATE {
                self.fail(Fault::NoLineNumbers);
            }
            return;
        }
        // Where numbers are sent and not counted they go on: whoever reads the wire can tell the lines apart.
        let last = if self.config.firmware.line_numbers { self.wire.highest() } else { 0 };
        self.wire.begin_after(last);
        self.events.extend(ok.temperatures.map(Event::Temperatures));
        self.found(None);
    }

    fn found(&mut self, last: Option<u64>) {
        self.timers.stop_all();
        self.refused = None;
        self.stats.n_unknown_lines = 0;
        self.late = Late::default();
        self.user_awaited = None;
        self.state = State::Idle;
        self.events.push_back(Event::Found(last));
    }

    /// Sends a question for the `tries`-th time.
    pub(super) fn put(&mut self, question: Question, tries: u32) {
        self.urgent.push_back(question.command().to_owned());
        self.state = State::Asking(Inquiry { question, tries, is_told: false, is_acked: false });
        self.timers.set(Timer::Handshake, self.now + self.config.response);
    }

    pub(super) fn inquiry_timeout(&mut self, inquiry: Inquiry) {
        if inquiry.tries < MAX_TRIES {
            self.put(inquiry.question, inquiry.tries + 1);
        } else {
            self.unanswered();
        }
    }

    pub(super) fn inquiry_reply(&mut self, inquiry: Inquiry, reply: Reply<'_>, line: &str) {
        let question = inquiry.question;
        match reply {
            Reply::Ok(ok) => self.answer_ok(inquiry, ok),
            Reply::Position(position) => {
                self.stands_at(position);
                self.events.push_back(Event::Position(position));
                self.told(inquiry, question == Question::Position);
            }
            Reply::Temperatures(temperatures) => {
                self.events.push_back(Event::Temperatures(temperatures));
                self.told(inquiry, question == Question::Temperatures);
            }
            Reply::Busy(what) => self.busy_before(what),
            Reply::Halted(text) => self.fail(Fault::Halted { text: text.to_owned() }),
            // The board has only just started: what it said before is no longer true.
            Reply::Start => self.inquire(self.wire.highest()),
            Reply::Resend(_) | Reply::LineRefused { .. } | Reply::Wait => {}
            _ => self.events.push_back(Event::Message(line.to_owned())),
        }
    }

    fn told(&mut self, inquiry: Inquiry, is_asked: bool) {
        self.conclude(Inquiry { is_told: inquiry.is_told || is_asked, ..inquiry });
    }

    fn answer_ok(&mut self, inquiry: Inquiry, ok: Acknowledgement) {
        self.events.extend(ok.temperatures.map(Event::Temperatures));
        self.events.extend(ok.position.map(Event::Position));
        let tells = match inquiry.question {
            Question::Temperatures => ok.temperatures.is_some(),
            Question::Position => ok.position.is_some(),
        };
        self.conclude(Inquiry { is_told: inquiry.is_told || tells, is_acked: true, ..inquiry });
    }

    fn conclude(&mut self, inquiry: Inquiry) {
        if !(inquiry.is_told && inquiry.is_acked) {
            self.state = State::Asking(inquiry);
            return;
        }
        self.timers.stop_all();
        self.next_ok = NextOk::Acknowledges;
        self.state = State::Idle;
        self.events.push_back(Event::Answered);
    }
}
