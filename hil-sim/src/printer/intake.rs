//! Lines come in: taken into the command queue, passed over, or refused.

use super::{Emergency, Event, Family, Numbering, Printer, Queued, Received, receive};

impl Printer {
    /// Reads lines while the command queue has room.
    pub(super) fn fetch(&mut self) -> bool {
        let mut read = false;
        while self.queue.len() < self.profile.command_slots
            && self.listens()
            && !self.is_silent()
            && let Some(line) = self.receiver.next_line()
        {
            read = true;
            self.summary.lines_received += 1;
            match line {
                Received::Command(text) => self.accept(text),
                Received::Repeated(text) => self.pass_over(text),
                Received::Refused(text, reason) => {
                    self.say_refusal(&text, reason);
                    if self.profile.dialect.numbering == Numbering::SumOnly {
                        self.request_line(receive::number_of(&text));
                    } else {
                        self.request_resend();
                    }
                    self.record_refused(text, reason.trim_end_matches(", Last Line: "));
                }
            }
            self.strike_machine(true);
        }
        read
    }

    /// A line that is there already.
    fn pass_over(&mut self, text: Vec<u8>) {
        self.summary.repeated_lines += 1;
        if self.profile.dialect.numbering == Numbering::CheckedRepeatsSkipped {
            self.say(&format!("skip {}", receive::number_of(&text)));
            self.say("ok");
        }
        self.record_refused(text, "repeated");
    }

    fn accept(&mut self, text: Vec<u8>) {
        if self.record_commands {
            self.events.push(Event::Command { t_s: self.now_s, text: text.clone() });
        }
        if let Some(order) = early_order(&text).filter(|o| self.profile.dialect.urgent.by_line.contains(o)) {
            self.emergency(order);
            if order == Emergency::Kill {
                return;
            }
        }
        let is_answered = self.profile.dialect.ok_when_taken;
        if is_answered {
            let number = self.receiver.last_line;
            self.say(&format!("ok {number}"));
        }
        self.queue.push_back(Queued { text, is_answered });
        self.strike_spurious_resend();
    }

    fn record_refused(&mut self, text: Vec<u8>, reason: &'static str) {
        if self.record_commands {
            self.events.push(Event::Refused { t_s: self.now_s, text, reason });
        }
    }

    /// Asks for the line after the last.
    pub(super) fn request_resend(&mut self) {
        self.request_line(self.receiver.last_line + 1);
    }

    fn request_line(&mut self, wanted: i64) {
        let error = self.resend_error.take().unwrap_or(0);
        let number = (wanted + error).max(0);
        if self.profile.dialect.resend.is_empty() {
            return;
        }
        self.summary.resend_requests += 1;
        if self.profile.dialect.family == Family::Repetier {
            self.say("");
        }
        self.say(&format!("{}{number}", self.profile.dialect.resend));
        if self.profile.dialect.ok_after_resend {
            self.say("ok");
        }
    }
}

/// The order in a line, for firmware that looks at lines rather than bytes.
fn early_order(text: &[u8]) -> Option<Emergency> {
    match text.get(..4)? {
        b"M108" => Some(Emergency::Continue),
        b"M112" => Some(Emergency::Kill),
        b"M410" => Some(Emergency::QuickStop),
        _ => None,
    }
}
