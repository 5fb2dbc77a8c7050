//! The greeting: both sides agree that the last line was number 0, and the printer proves that it checks numbers.

use super::recovery::Late;
use super::{Core, Event, Fault, NextOk, Reply, ResendStyle, State, Timer};
use crate::printer::protocol::wire::{VOID, write_numbered};

/// Where the greeting is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Greeting {
    /// The board was reset; its `start` is awaited.
    AwaitStart,
    /// `M110 N0` was sent for the n-th time; its `ok` is awaited.
    AwaitOk(u32),
    /// A probe was sent; it must be refused with `Last Line: 0`.
    AwaitProof(u32),
    /// A probe was sent for the n-th time; its refusal names the last line of whoever was here before.
    AwaitLast(u32),
}

/// A number that is not the next one.
const PROOF_NUMBER: u64 = 1000;

/// A board that was reset by the opening is up by then.
const TRIES_UNTOLD: u32 = 3;

/// A printer may repeat a line once; what repeats every line is none.
const MAX_ECHOED: u32 = 2;

/// Whether a line can only be one that we have sent.
fn is_ours(line: &str) -> bool {
    let is_numbered = |word| line.starts_with('N') && line.contains(word);
    line == "M105" || is_numbered(" M105*") || is_numbered(" M110 N0*")
}

impl Core {
    pub(super) fn connect(&mut self) {
        if self.config.firmware.reset_on_open {
            self.state = State::Handshake(Greeting::AwaitStart);
            self.timers.set(Timer::Handshake, self.now + self.config.boot);
        } else {
            self.greet(1);
        }
    }

    /// Sends the greeting for the `tries`-th time. The line feed ends a half line that somebody left.
    pub(super) fn greet(&mut self, tries: u32) {
        self.timers.stop_all();
        let mut text = "\n".to_owned();
        if self.config.firmware.counts_lines() {
            write_numbered(&mut text, 0, "M110 N0");
        } else if self.is_one_by_one() {
            VOID.clone_into(&mut text);
            self.ask_where(&mut text);
        } else {
            text.push_str("M105\n");
        }
        self.urgent.push_back(text);
        self.refused = None;
        self.next_ok = NextOk::Acknowledges;
        self.state = State::Handshake(Greeting::AwaitOk(tries));
        self.timers.set(Timer::Handshake, self.now + self.config.response);
    }

    pub(super) fn greeting_reply(&mut self, greeting: Greeting, reply: Reply<'_>, line: &str) {
        match (reply, greeting) {
            (Reply::Start, Greeting::AwaitStart) => self.greet(1),
            (Reply::Start, Greeting::AwaitOk(tries) | Greeting::AwaitProof(tries)) => self.greet_again(tries),
            (Reply::Start, Greeting::AwaitLast(tries)) => self.inquire_again(tries),
            // Of a half line, or of the line that must be refused, where lines are not counted.
            (Reply::Resend(_), _) if !self.config.firmware.counts_lines() => self.hear_that_it_asks(),
            (Reply::Resend(number), Greeting::AwaitLast(tries)) => self.on_named(tries, number.0),
            // It takes no notice of a wrong number where it waits for a line: it is asked until it does.
            (Reply::Skipped(_), Greeting::AwaitLast(tries)) => {
                self.inquire_again(tries);
                self.next_ok = self.after_refusal();
            }
            (Reply::Ok(ok), Greeting::AwaitLast(tries)) => self.on_inquiry_ok(ok, tries),
            // It is busy with what somebody else has left it: it answers when that is done.
            (Reply::Busy(what), _) => self.busy_before(what),
            (Reply::Halted(text), _) => self.fail(Fault::Halted { text: text.to_owned() }),
            (Reply::LineRefused { reason, last }, _) => self.refused = Some((reason, last.0)),
            (Reply::Resend(number), Greeting::AwaitProof(tries)) => {
                self.proof(tries, number.0);
                self.next_ok = self.after_refusal();
            }
            (Reply::Resend(_), Greeting::AwaitOk(tries)) => {
                self.greet_again(tries);
                self.next_ok = self.after_refusal();
            }
            // That of the place; temperatures are the answer.
            (Reply::Ok(ok), Greeting::AwaitOk(_)) if self.is_one_by_one() && ok.temperatures.is_none() => {}
            (Reply::Ok(_), Greeting::AwaitOk(tries)) => self.greeting_ok(tries),
            (Reply::Position(place), _) if self.hear_place(place) => {}
            (Reply::Temperatures(temperatures), _) => {
                self.events.push_back(Event::Temperatures(temperatures))
            }
            (Reply::Unknown(_), _) if is_ours(line) => self.n_echoed += 1,
            (Reply::Unknown(_), _) => {
                self.stats.n_unknown_lines += u64::from(line.contains('\u{fffd}'));
                self.events.push_back(Event::Message(line.to_owned()));
            }
            _ => {}
        }
    }

    fn greeting_ok(&mut self, tries: u32) {
        if std::mem::take(&mut self.next_ok) != NextOk::Acknowledges {
            return;
        }
        if !self.config.firmware.counts_lines() {
            self.hear_greeting();
            self.connected();
            return;
        }
        let mut probe = String::new();
        write_numbered(&mut probe, PROOF_NUMBER, "M105");
        self.urgent.push_back(probe);
        self.state = State::Handshake(Greeting::AwaitProof(tries));
        self.timers.set(Timer::Handshake, self.now + self.config.response);
    }

    fn proof(&mut self, tries: u32, number: u64) {
        let last = self.refused.take().map(|(_, last)| last);
        let agrees = self.config.firmware.resend_style == ResendStyle::Rs || last == Some(0);
        if agrees && number == 1 {
            self.connected();
        } else {
            self.greet_again(tries);
        }
    }

    fn connected(&mut self) {
        self.timers.stop_all();
        self.next_ok =
            if self.config.firmware.counts_lines() { self.after_refusal() } else { NextOk::Acknowledges };
        self.refused = None;
        self.n_echoed = 0;
        self.late = Late::default();
        self.user_awaited = None;
        self.state = State::Idle;
        self.stats.n_unknown_lines = 0;
        self.events.push_back(Event::Connected);
    }

    pub(super) fn greeting_timeout(&mut self) {
        match self.state {
            State::Handshake(Greeting::AwaitStart) => self.greet(1),
            State::Handshake(Greeting::AwaitOk(tries) | Greeting::AwaitProof(tries)) => {
                self.greet_again(tries)
            }
            State::Handshake(Greeting::AwaitLast(tries)) => self.inquire_again(tries),
            _ => {}
        }
    }

    fn greet_again(&mut self, tries: u32) {
        self.tell_no_answer(tries);
        if self.n_echoed > MAX_ECHOED {
            self.fail(Fault::Echo);
        } else if tries < self.max_greetings() {
            self.greet(tries + 1);
        } else if matches!(self.state, State::Handshake(Greeting::AwaitProof(_))) {
            self.fail(Fault::NoLineNumbers);
        } else {
            self.unanswered();
        }
    }

    /// Told once: who waits half a minute at a printer that is off should know for what.
    pub(super) fn tell_no_answer(&mut self, tries: u32) {
        if tries == TRIES_UNTOLD {
            self.events.push_back(Event::NoAnswerYet);
        }
    }

    pub(super) fn unanswered(&mut self) {
        self.fail(Fault::NoAnswer { is_garbled: self.stats.n_unknown_lines > 0 });
    }

    /// Enough to outlast a board that boots, and a few more.
    pub(super) fn max_greetings(&self) -> u32 {
        let during_boot = self.config.boot.as_secs_f64() / self.config.response.as_secs_f64();
        // Both are checked by the profile: the quotient is far below the limit of the type.
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "see above")]
        let during_boot = during_boot.ceil() as u32;
        8 + during_boot
    }
}
