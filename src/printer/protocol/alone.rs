//! The only line in flight, where the firmware counts no lines (RepRapFirmware): whether it was executed.
//!
//! Neither its `ok` nor a request to send it again can be relied on: both may be lost, and newer versions ask for nothing again. So in
//! doubt the printer is asked where it is (M114, then M105, whose answer no other line has). It tells the end of the last command
//! that it has taken, and that is either the place before the line or the one behind it: then the line is sent again, or is done.
//! Answers come in order, so nothing is decided before all questions are answered: none of their `ok` can be taken for a line's.
//!
//! # Limits
//!
//! A line that moves nothing leaves no trace. If nothing was heard of it, it is sent again where that does no harm (of two damages in
//! a row, of which one leaves an `ok`, it may be missing); else, where the firmware
//! asks for damaged lines, its `ok` counts as lost, and where it does not the print is given up.
//! A byte that becomes `;` takes the checksum away with all that follows, and this firmware then obeys the rest: nothing asks for such
//! a line, and it shows only when the printer is asked where it is for another reason.

use super::{Acknowledgement, Core, Event, Fault, Position, State};
use crate::printer::replay::Modal;
use crate::printer::resume::may_be_repeated;
use crate::profile::Dialect;

/// A place is one that the job has brought about, or is none of it, mm: numbers are rounded on both sides.
const NEAR_MM: f64 = 0.02;

/// A place that is neither may be a damaged answer: it must be told so often.
const MAX_ELSEWHERE: u32 = 3;

/// Places that differ by no more of their last digit are alike.
const ALIKE_STEPS: f64 = 2.0;

/// What leaves no trace, and takes nothing but time when it is done twice: dwelling, homing, levelling, heating.
const LONG: [&str; 8] = ["G4", "G28", "G29", "G32", "M109", "M116", "M190", "M191"];

/// Whether a line that has left no trace may be sent again.
fn may_come_twice(command: &str) -> bool {
    may_be_repeated(command)
        || command.split_ascii_whitespace().next().is_some_and(|word| LONG.contains(&word))
}

/// What is known of the line.
#[derive(Debug)]
pub(super) struct Alone {
    /// Where the machine is behind all lines acknowledged.
    modal: Modal,
    /// Questions that are not answered in full.
    question: Option<Where>,
    /// It may have been refused.
    pub(super) is_suspect: bool,
    /// It has asked for a line that it must refuse.
    asks_again: bool,
}

/// A question for the place, asked several times perhaps.
#[derive(Debug, Clone, Copy, Default)]
struct Where {
    n_asked: u32,
    n_answered: u32,
    /// An `ok` came before any place: the line's own.
    has_ok: bool,
    place: Option<Position>,
    /// How often the place was none of the two.
    n_elsewhere: u32,
}

/// What a place says of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    /// It is behind the line.
    Done,
    /// It is before the line.
    Missing,
    /// Both are the same.
    Alike,
    /// It is neither.
    Elsewhere,
}

impl Alone {
    pub(super) fn new(dialect: Dialect) -> Self {
        let mut modal = Modal::new(dialect);
        modal.at_mm = [None; 4];
        Self { modal, question: None, is_suspect: false, asks_again: false }
    }

    /// What the place says of `command`.
    fn judge(&self, command: &str, place: Position) -> Verdict {
        let [x, y, z] = place.xyz_mm;
        let told = [Some(x), Some(y), Some(z), place.e_mm];
        let mut behind = self.modal.clone();
        behind.apply(command);
        let (mut gap_mm, mut off_before_mm, mut off_behind_mm) = (0.0_f64, 0.0_f64, 0.0_f64);
        for ((told, before), behind) in told.into_iter().zip(self.modal.at_mm).zip(behind.at_mm) {
            let (Some(told), Some(behind)) = (told, behind) else { continue };
            // It was anywhere else.
            let unknown = if (told - behind).abs() <= NEAR_MM { f64::INFINITY } else { told };
            let before = before.unwrap_or(unknown);
            gap_mm = gap_mm.max((behind - before).abs());
            off_before_mm = off_before_mm.max((told - before).abs());
            off_behind_mm = off_behind_mm.max((told - behind).abs());
        }
        if gap_mm <= ALIKE_STEPS * place.step_mm {
            Verdict::Alike
        } else if off_before_mm.min(off_behind_mm) > NEAR_MM {
            Verdict::Elsewhere
        } else if off_behind_mm < off_before_mm {
            Verdict::Done
        } else {
            Verdict::Missing
        }
    }
}

impl Core {
    /// Whether lines go one by one, and are looked for by the place.
    pub(super) const fn is_one_by_one(&self) -> bool {
        self.config.firmware.line_numbers && !self.config.firmware.counts_lines()
    }

    /// Behind the line that the printer has named as its last, or that its place has told, it is in this state.
    pub fn is_behind(&mut self, modal: &Modal) {
        let at_mm = self.alone.modal.at_mm;
        self.alone.modal = modal.clone();
        for (at, told) in self.alone.modal.at_mm.iter_mut().zip(at_mm) {
            *at = told.or(*at);
        }
    }

    /// The printer has said where it is, and nothing is in flight.
    pub(super) const fn stands_at(&mut self, place: Position) {
        let [x, y, z] = place.xyz_mm;
        self.alone.modal.at_mm = [Some(x), Some(y), Some(z), place.e_mm];
    }

    /// The question, behind whatever ends a half line.
    pub(super) fn ask_where(&mut self, text: &mut String) {
        let question = self.alone.question.get_or_insert_default();
        question.n_asked += 1;
        // With a checksum: what a damaged one would do nobody knows.
        self.wire.write_far(text, "M114");
        self.wire.write_far(text, "M105");
    }

    /// A place is told. False where nobody has asked for one.
    pub(super) fn hear_place(&mut self, place: Position) -> bool {
        let Some(question) = &mut self.alone.question else { return false };
        question.place = Some(place);
        if self.wire.in_flight() == 0 {
            self.stands_at(place);
        }
        true
    }

    /// A greeting is answered, perhaps an earlier one.
    pub(super) fn hear_greeting(&mut self) {
        if let Some(question) = &mut self.alone.question {
            question.n_answered += 1;
            self.alone.question = Some(*question).filter(|question| question.n_answered < question.n_asked);
        }
    }

    /// What was asked before is no longer waited for.
    pub(super) const fn forget_question(&mut self) {
        self.alone.question = None;
    }

    /// Whether an answer is still awaited.
    pub(super) const fn is_asked_where(&self) -> bool {
        self.alone.question.is_some()
    }

    /// An `ok` while the question is open. False where none is.
    pub(super) fn hear_ok_in_doubt(&mut self, ok: &Acknowledgement) -> bool {
        let Some(question) = &mut self.alone.question else { return false };
        if ok.temperatures.is_some() {
            question.n_answered += 1;
        } else {
            question.has_ok |= question.place.is_none();
        }
        if question.place.is_some() && question.n_answered >= question.n_asked {
            self.decide();
        }
        true
    }

    /// Nothing more is heard, and the place is known: that is decided. False where it is not known.
    pub(super) fn decide_in_silence(&mut self) -> bool {
        let is_told = self.alone.question.is_some_and(|question| question.place.is_some());
        if is_told {
            self.decide();
        }
        is_told
    }

    /// The firmware has asked for a line that it must refuse: it asks for those that are damaged.
    pub(super) fn hear_that_it_asks(&mut self) {
        self.alone.asks_again = true;
    }

    /// The first line is about to be sent.
    pub(super) fn tell_whether_it_asks(&mut self) {
        if self.is_one_by_one() && !self.alone.asks_again {
            self.events.push_back(Event::NeverAsksAgain);
        }
    }

    /// The line has come back as one that no firmware understands, or is asked for again. In doubt the place says so.
    pub(super) fn refused_alone(&mut self) {
        if self.alone.question.is_some() {
            self.alone.is_suspect = true;
        } else if self.wire.in_flight() > 0 {
            self.go_back(self.wire.acked() + 1, true);
        }
    }

    /// The line is done.
    pub(super) fn acknowledge_alone(&mut self) {
        if !self.is_one_by_one() {
            self.wire.ack_oldest();
            return;
        }
        self.follow();
        self.alone.is_suspect &= !self.wire.ack_oldest();
    }

    /// The machine is behind the line.
    fn follow(&mut self) {
        if let Some(command) = self.wire.oldest_command() {
            self.alone.modal.apply(command);
        }
    }

    fn decide(&mut self) {
        let Some(question) = self.alone.question.take() else { return };
        self.probe = None;
        self.owed.forget();
        let Some(command) = self.wire.oldest_command() else {
            self.complete();
            return;
        };
        let verdict = question.place.map_or(Verdict::Elsewhere, |place| self.alone.judge(command, place));
        let n_elsewhere = question.n_elsewhere + u32::from(verdict == Verdict::Elsewhere);
        if verdict == Verdict::Elsewhere && n_elsewhere < MAX_ELSEWHERE {
            self.alone.question =
                Some(Where { n_asked: 0, n_answered: 0, place: None, n_elsewhere, ..question });
            self.ask();
            return;
        }
        let is_suspect = std::mem::take(&mut self.alone.is_suspect);
        let is_cancelled = self.state == State::Cancelling;
        let asks = self.alone.asks_again && (verdict == Verdict::Alike || self.alone.modal.beyond.is_some());
        match verdict {
            Verdict::Done => self.done_alone(question.has_ok),
            Verdict::Missing => self.refused_alone(),
            Verdict::Alike | Verdict::Elsewhere if is_suspect => self.refused_alone(),
            Verdict::Alike | Verdict::Elsewhere if question.has_ok => self.done_alone(true),
            Verdict::Alike if may_come_twice(command) => self.refused_alone(),
            _ if asks || is_cancelled => self.done_alone(false),
            _ => {
                let command = command.to_owned();
                self.fail(Fault::Unsure { command });
            }
        }
    }

    fn done_alone(&mut self, has_ok: bool) {
        self.quiet_since = self.now;
        if has_ok {
            self.acknowledge_alone();
        } else {
            self.follow();
            self.lost_oks();
        }
        self.complete();
    }
}
