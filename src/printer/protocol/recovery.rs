//! What is done about answers that are missing, damaged, doubled or not meant for us.

use crate::profile::Dialect;

use super::wire::{Origin, VOID, VOID_NUMBER};
use super::{Acknowledgement, Core, Event, Fault, Recovery, Refusal, ResendStyle, State};

/// A line that is refused so often in a row does not get through.
const MAX_TRIES: u32 = 40;

/// So many `ok` of damaged lines may be taken for ours.
pub(super) const FALSE_OKS: u64 = 8;

/// Words of the core's own that not every firmware knows.
fn is_urgent(text: &str) -> bool {
    ["M108", "M410", "M876"].iter().any(|word| text.starts_with(word))
}

/// What the next `ok` means.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum NextOk {
    /// A line is done.
    #[default]
    Acknowledges,
    /// It only ends a refusal.
    EndsRefusal,
    /// It ends a command that we never sent: one of our lines, damaged.
    EndsForeignCommand,
    /// It ends a command that was one of our lines, damaged, where no more than one is in flight.
    EndsDamagedLine,
}

/// The core went back to a line that was refused.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rewind {
    /// That line.
    pub(super) from: u64,
    /// How often it was refused.
    n_refusals: u32,
    /// Lines that were on their way behind it.
    n_behind: u32,
}

/// Refusals of probes that are still to come: a firmware that was at a long command answers all of them when it is done, the first tells
/// what the others tell again.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Late {
    n_owed: u32,
    /// The line that the first of them asked for.
    number: Option<u64>,
}

impl Late {
    const fn asked(&mut self, n_refusals: u32) {
        self.n_owed = self.n_owed.saturating_add(n_refusals);
    }

    /// Whether this is one of the others; `is_awaited` where it is the first.
    fn takes(&mut self, number: u64, is_awaited: bool) -> bool {
        if self.n_owed == 0 {
            return false;
        }
        self.n_owed -= 1;
        if is_awaited {
            self.number = Some(number);
            return false;
        }
        let is_told_again = self.number == Some(number);
        if !is_told_again {
            *self = Self::default();
        }
        is_told_again
    }

    /// Answers come in order: what was owed before a line that was sent behind the first of them has come, or is lost.
    pub(super) fn acknowledged(&mut self, acked: u64) {
        if self.number.is_some_and(|number| number <= acked) {
            *self = Self::default();
        }
    }
}

/// The firmware was asked for its last line.
#[derive(Debug, Clone, Copy)]
pub(super) struct Probe {
    /// How often, in this attempt.
    pub(super) tries: u32,
    /// Answers that could not be used.
    garbled: u32,
    /// Everything is read, and it is asked for temperatures: it answers behind all that it still has to do.
    is_in_order: bool,
}

impl Probe {
    pub(super) const fn new(is_in_order: bool) -> Self {
        Self { tries: 1, garbled: 0, is_in_order }
    }
}

impl Core {
    /// Asks the firmware for its last line. No numbered line is sent until it answers: the refusal would take it along.
    pub(super) fn ask(&mut self) {
        match &mut self.probe {
            Some(probe) => probe.tries += 1,
            None => self.probe = Some(Probe::new(false)),
        }
        self.stats.n_probes += 1;
        self.quiet_since = self.now;
        // What was sent last may have lost its line feed.
        let obeys_halves =
            matches!(self.config.firmware.dialect, Dialect::RepRapFirmware | Dialect::Smoothie);
        let mut text = if obeys_halves { VOID } else { "\n" }.to_owned();
        if self.is_one_by_one() {
            self.ask_where(&mut text);
        } else if self.probe.is_some_and(|probe| probe.is_in_order) {
            text.push_str("M105\n");
            self.late.asked(u32::from(obeys_halves));
        } else {
            self.wire.write_probe(&mut text);
            // The void line is refused too.
            self.late.asked(if obeys_halves { 2 } else { 1 });
        }
        self.urgent.push_back(text);
    }

    /// Asks because an answer could not be used.
    fn ask_in_doubt(&mut self) {
        if let Some(probe) = &mut self.probe {
            probe.garbled += 1;
            if probe.garbled > MAX_TRIES {
                let (line, tries) = (self.wire.next(), probe.garbled);
                self.fail(Fault::ResendLimit { line, tries });
                return;
            }
        }
        self.ask();
    }

    pub(super) fn on_unknown_command(&mut self, text: &str, line: &str) {
        self.events.push_back(Event::Message(line.to_owned()));
        if let Some(origin) = self.wire.origin_in_flight(text) {
            self.stats.n_unknown_commands += u64::from(origin == Origin::Job);
            return;
        }
        if self.config.firmware.counts_lines() {
            self.next_ok = NextOk::EndsForeignCommand;
        } else if self.wire.is_damaged_copy(text) {
            // Of the only line in flight; it was not executed.
            self.next_ok = NextOk::EndsDamagedLine;
        } else if self.is_asked_where() {
            // A question, damaged.
            self.next_ok = NextOk::EndsRefusal;
        } else if self.wire.in_flight() > 0 && !is_urgent(text) {
            // A line of ours, damaged: it was not executed, and nothing asks for it again.
            self.fail(Fault::CommandRefused { text: line.to_owned() });
        }
    }

    pub(super) fn on_ok(&mut self, ok: Acknowledgement) {
        if let Some(temperatures) = ok.temperatures {
            self.events.push_back(Event::Temperatures(temperatures));
        }
        if ok.temperatures.is_some() && self.probe.is_some_and(|probe| probe.is_in_order) {
            self.all_done();
            return;
        }
        let lone_refusal = self.refused.take().is_some();
        match std::mem::take(&mut self.next_ok) {
            // The Resend between refusal and ok was lost.
            NextOk::EndsRefusal if lone_refusal => self.ask_in_doubt(),
            NextOk::EndsRefusal => {}
            NextOk::EndsForeignCommand => {
                self.stats.n_foreign_commands += 1;
                if self.wire.in_flight() > 0 || self.probe.is_some() {
                    self.ask_in_doubt();
                }
            }
            NextOk::EndsDamagedLine => self.refused_alone(),
            NextOk::Acknowledges => self.acknowledge(ok),
        }
    }

    fn acknowledge(&mut self, ok: Acknowledgement) {
        if self.is_owed(&ok) {
            return;
        }
        if !self.config.firmware.counts_lines() {
            self.acknowledge_unnumbered(ok);
            return;
        }
        let is_progress = match ok.line {
            Some(number) => {
                self.is_advanced = true;
                self.wire.ack_through(number.0, ok.slots_free)
            }
            None if self.is_advanced => {
                self.unnumbered_ok();
                false
            }
            // The late answer to a question that was asked again.
            None if ok.temperatures.is_some() && self.wire.oldest_command() != Some("M105") => false,
            None => self.wire.ack_oldest(),
        };
        if let Some(free) = ok.planner_free.filter(|_| is_progress) {
            self.planner.heard(free, self.wire.acked(), self.now);
            self.wire.planner_has_room(self.now, free);
        }
        if is_progress {
            self.late.acknowledged(self.wire.acked());
            self.quiet_since = self.now;
            self.wire.measure(self.now);
        }
    }

    /// Repetier says `ok` as it takes a line, and the temperatures when their turn comes.
    pub(super) fn on_temperatures(&mut self) {
        self.heats_visibly();
        let is_late = self.config.firmware.dialect == Dialect::Repetier;
        if is_late && self.probe.is_some_and(|probe| probe.is_in_order) {
            self.all_done();
        }
    }

    /// Firmware that reports temperatures only while a line waits for one shows by each that it still does: there is nothing to ask.
    fn heats_visibly(&mut self) {
        let reports_always = self.is_talkative() || self.config.firmware.temperature_report_s > 0.0;
        if !reports_always && self.probe.is_none() && self.wire.oldest_waits_for_heat() {
            self.quiet_since = self.now;
        }
    }

    /// The answer to a question in order has come: whatever was sent before is done.
    fn all_done(&mut self) {
        self.probe = None;
        self.refused = None;
        self.next_ok = NextOk::Acknowledges;
        self.quiet_since = self.now;
        self.owed.forget();
        self.lost_oks();
        self.complete();
    }

    /// An `ok` without number where others have one, and none is owed: of a damaged line.
    fn unnumbered_ok(&mut self) {
        if self.wire.in_flight() > 0 {
            self.stats.n_foreign_commands += 1;
            self.ask_in_doubt();
        }
    }

    /// Without numbers the answer to M105 proves that all before it is done: answers come in order.
    fn acknowledge_unnumbered(&mut self, ok: Acknowledgement) {
        self.quiet_since = self.now;
        if self.hear_ok_in_doubt(&ok) {
            return;
        }
        if self.probe.is_some() && ok.temperatures.is_some() {
            self.probe = None;
            self.owed.forget();
            self.lost_oks();
            self.complete();
        } else if ok.temperatures.is_none() || self.wire.oldest_command() == Some("M105") {
            // Else it is the late answer to a greeting or to an earlier question.
            self.acknowledge_alone();
        }
    }

    /// Smoothieware's refusal has no `ok` of its own.
    pub(super) fn after_refusal(&self) -> NextOk {
        match self.config.firmware.dialect {
            Dialect::Smoothie | Dialect::RepRapFirmware => NextOk::Acknowledges,
            _ => NextOk::EndsRefusal,
        }
    }

    pub(super) fn on_refusal(&mut self, reason: Refusal, last: u64) {
        self.refused = Some((reason, last));
        self.next_ok = self.after_refusal();
    }

    pub(super) fn on_resend(&mut self, number: u64) {
        self.next_ok = self.after_refusal();
        let refused = self.refused.take();
        if !self.config.firmware.counts_lines() {
            self.on_resend_uncounted(number);
            return;
        }
        let agrees = match refused {
            Some((_, last)) => last.checked_add(1) == Some(number),
            None => self.config.firmware.resend_style == ResendStyle::Rs,
        };
        if !agrees || number == 0 {
            self.stats.n_doubtful_resends += 1;
            self.ask_in_doubt();
            return;
        }
        // The others throw away what they have received when they refuse a line: there it is sent again on each of these.
        let keeps_lines = self.config.firmware.dialect == Dialect::Smoothie;
        if self.late.takes(number, self.probe.is_some()) && keeps_lines {
            return;
        }
        self.on_last_line(number, matches!(refused, Some((Refusal::Damaged, _))));
    }

    /// Its own number is that of the line in flight. Another one is that of a line whose number was damaged, or means nothing: the answer
    /// to a question behind it tells.
    fn on_resend_uncounted(&mut self, number: u64) {
        if number == VOID_NUMBER {
            self.hear_that_it_asks();
            return;
        }
        // It is asked again when no answer comes.
        let is_of_question = self.is_asked_where() && number == self.wire.far();
        if self.wire.in_flight() == 0 || is_of_question {
            return;
        }
        if number == self.wire.acked() + 1 {
            self.refused_alone();
        } else {
            self.alone.is_suspect = true;
            self.stats.n_doubtful_resends += 1;
            self.ask();
        }
    }

    /// The firmware wants line `number` next, and both its answers say so.
    fn on_last_line(&mut self, number: u64, is_damaged: bool) {
        let says_reset = self.is_of_a_reset(number);
        let was_said = std::mem::replace(&mut self.may_be_reset, says_reset);
        if says_reset && !was_said && self.config.firmware.resend_style == ResendStyle::Rs {
            // One word alone: a byte of its number may have been lost.
            self.ask();
        } else if says_reset {
            self.fail(Fault::FirmwareReset);
        } else if number > self.wire.next().max(self.wire.highest() + 1) || number < self.wire.oldest() {
            self.unavailable(number);
        } else if number >= self.wire.next() && self.rewind.is_none_or(|rewind| rewind.from != number) {
            self.wire.skip_to(number);
            self.everything_read();
        } else {
            self.go_back(number, is_damaged);
        }
    }

    /// Whether the firmware has forgotten lines that it surely had: it counts from 0 again, and its `start` was lost. An
    /// `ok` may be taken for a line or two too many, not for more than it has slots.
    fn is_of_a_reset(&self, number: u64) -> bool {
        let doubtful = self.config.firmware.command_slots as u64 + FALSE_OKS;
        number == 1 && self.wire.acked() > doubtful
    }

    /// Asks once more before it gives up: two answers might be damaged alike.
    fn unavailable(&mut self, asked: u64) {
        match self.probe {
            Some(probe) if probe.garbled > 1 => {
                let (oldest, newest) = (self.wire.oldest(), self.wire.next() - 1);
                self.fail(Fault::LineUnavailable { asked, oldest, newest });
            }
            Some(_) => self.ask_in_doubt(),
            None => {
                self.ask();
                self.probe = self.probe.map(|probe| Probe { garbled: 1, ..probe });
            }
        }
    }

    fn everything_read(&mut self) {
        self.owed.forget();
        self.wire.all_read();
        self.rewind = None;
        self.quiet_since = self.now;
        match self.probe.take() {
            None => {}
            // It has everything, but may still be at it.
            Some(probe) if self.wire.in_flight() > 0 => {
                self.probe = Some(Probe { tries: 0, is_in_order: true, ..probe });
                self.ask();
            }
            Some(_) => self.complete(),
        }
    }

    pub(super) fn lost_oks(&mut self) {
        let count = self.wire.in_flight();
        if count > 0 {
            self.wire.all_acked();
            self.planner.forget();
            self.stats.n_lost_oks += count;
            self.events.push_back(Event::Recovered(Recovery::LostOk { count }));
        }
    }

    /// The firmware has said that it has everything that was sent.
    pub(super) fn complete(&mut self) {
        if self.wire.unsent() > 0 {
            return;
        }
        match self.state {
            State::Finishing => self.events.push_back(Event::Finished),
            State::Cancelling => self.events.push_back(Event::Cancelled),
            _ => return,
        }
        self.state = State::Idle;
    }

    /// Sends `number` again, alone until it is acknowledged. What was on its way behind it is refused too, and each of these
    /// refusals may empty the receive buffer with a copy of the line in it. So copies follow on later refusals: on each of
    /// the first few, then ever more rarely, and on the last one expected. A copy too many is passed over in silence.
    pub(super) fn go_back(&mut self, number: u64, is_damaged: bool) {
        let was_asked = self.probe.take().is_some();
        let mut rewind = match self.rewind {
            Some(rewind) if rewind.from == number => rewind,
            _ => self.first_refusal(number),
        };
        self.stats.n_echoes += u64::from(rewind.n_refusals > 0);
        rewind.n_refusals += 1;
        self.rewind = Some(rewind);
        if rewind.n_refusals > rewind.n_behind.saturating_mul(2).saturating_add(MAX_TRIES) {
            self.fail(Fault::ResendLimit { line: number, tries: rewind.n_refusals });
            return;
        }
        let is_last = rewind.n_refusals == rewind.n_behind.saturating_add(1);
        if is_damaged || was_asked || is_last || rewind.n_refusals.is_power_of_two() {
            self.wire.rewind(number);
            self.owed.forget_from(number);
            self.planner.forget();
            self.quiet_since = self.now;
        }
    }

    fn first_refusal(&mut self, number: u64) -> Rewind {
        self.stats.n_resends += 1;
        self.wire.narrow();
        self.events.push_back(Event::Recovered(Recovery::Resent { line: number }));
        let n_behind = u32::try_from(self.wire.next().saturating_sub(number + 1)).unwrap_or(u32::MAX);
        Rewind { from: number, n_refusals: 0, n_behind }
    }
}
