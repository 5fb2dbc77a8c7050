//! The firmware's receiving end: ring, line buffer, line numbers, checksums.
//!
//! As Marlin does it. Bytes wait in the ring until the command queue has room. A line ends at LF or CR; `;` begins a
//! comment; a backspace takes a byte back; `\` protects the next byte; what exceeds the line buffer is dropped. A line that
//! begins with `N` must have the next number, then a checksum (the XOR of all before the last `*`); the number is looked at
//! first. One that does not begin with `N` is taken as it is, `*` or not. On an error Marlin empties the ring, so a
//! line that has come in half is taken, later, for what its second half says. The others differ as their dialect says.

use crate::dialect::{Dialect, Numbering};
use std::collections::VecDeque;

/// What a line turned out to be.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Received {
    /// A command to be queued.
    Command(Vec<u8>),
    /// A numbered line that is there already: it is dropped.
    Repeated(Vec<u8>),
    /// A line that must be sent again; the text is the firmware's.
    Refused(Vec<u8>, &'static str),
}

/// A number other than the expected one.
pub const WRONG_NUMBER: &str = "Line Number is not Last Line Number+1, Last Line: ";
/// A checksum that does not fit.
pub const WRONG_CHECKSUM: &str = "checksum mismatch, Last Line: ";
/// A number without a checksum.
pub const NO_CHECKSUM: &str = "No Checksum with line number, Last Line: ";

/// An order that acts when it arrives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Emergency {
    /// M108: stop waiting.
    Continue,
    /// M112: stop for good.
    Kill,
    /// M410: stop moving.
    QuickStop,
}

/// How many numbers back Repetier takes a line for one it has.
const REMEMBERED_LINES: i64 = 40;
/// How many wrong lines Repetier skips after a request to send again before it asks anew.
const SKIPPED_LINES: u32 = 14;

/// Looks at every byte that arrives for M108, M112, M410 and M876 (the answer to a prompt), with or without a line number.
#[derive(Debug, Clone, Default)]
struct EmergencyParser {
    /// What has matched of `M108` etc.; letters and digits only.
    matched: Vec<u8>,
    ignoring: bool,
}

impl EmergencyParser {
    fn feed(&mut self, byte: u8) -> Option<Emergency> {
        if matches!(byte, b'\n' | b'\r') {
            let order = match self.matched.as_slice() {
                b"M108" | b"M876" => Some(Emergency::Continue),
                b"M112" => Some(Emergency::Kill),
                b"M410" => Some(Emergency::QuickStop),
                _ => None,
            };
            self.matched.clear();
            self.ignoring = false;
            return order;
        }
        // Whatever follows the complete word is not looked at.
        if !self.ignoring && self.matched.len() < 4 {
            self.extend(byte);
        }
        None
    }

    fn extend(&mut self, byte: u8) {
        const WORDS: [&[u8]; 4] = [b"M108", b"M112", b"M410", b"M876"];
        match (self.matched.as_slice(), byte) {
            (b"" | b"N", b' ') | (b"N", b'0'..=b'9' | b'-') => {}
            (b"", b'N') => self.matched.push(b'N'),
            (b"N", b'M') => self.matched[0] = b'M',
            (before, _) => {
                let fits = |word: &&[u8]| word.starts_with(before) && word.get(before.len()) == Some(&byte);
                if WORDS.iter().any(fits) {
                    self.matched.push(byte);
                } else {
                    self.ignoring = true;
                }
            }
        }
    }
}

/// What the character filter is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Filter {
    #[default]
    Normal,
    /// Until the line ends: comment or overflow.
    Skipping,
    /// The next byte is taken as it is.
    Escaped,
}

/// Ring, line buffer and last line number.
#[derive(Debug, Clone)]
pub struct Receiver {
    ring: VecDeque<u8>,
    ring_bytes: usize,
    line: Vec<u8>,
    line_bytes: usize,
    filter: Filter,
    emergency: EmergencyParser,
    dialect: &'static Dialect,
    /// How many wrong lines are still skipped after a request to send again.
    to_skip: u32,
    /// Number of the last line accepted.
    pub last_line: i64,
}

impl Receiver {
    /// An empty one.
    #[must_use]
    pub fn new(ring_bytes: usize, line_bytes: usize, dialect: &'static Dialect) -> Self {
        Self {
            ring: VecDeque::with_capacity(ring_bytes),
            ring_bytes,
            line: Vec::with_capacity(line_bytes),
            line_bytes,
            filter: Filter::Normal,
            emergency: EmergencyParser::default(),
            dialect,
            to_skip: 0,
            last_line: dialect.first_last_line,
        }
    }

    /// Room in the ring, bytes.
    #[must_use]
    pub fn room(&self) -> usize {
        self.ring_bytes.saturating_sub(self.ring.len())
    }

    /// Whether nothing waits in the ring.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.ring.is_empty()
    }

    /// A byte arrives; the caller has looked whether there is room.
    pub fn push(&mut self, byte: u8) -> Option<Emergency> {
        self.ring.push_back(byte);
        self.emergency.feed(byte)
    }

    /// The next complete line that is not empty, judged.
    pub fn next_line(&mut self) -> Option<Received> {
        while let Some(byte) = self.ring.pop_front() {
            if matches!(byte, b'\n' | b'\r') {
                self.filter = Filter::Normal;
                if !self.line.is_empty() {
                    let text = std::mem::take(&mut self.line);
                    return Some(self.judge(text));
                }
            } else {
                self.filter_byte(byte);
            }
        }
        None
    }

    fn filter_byte(&mut self, byte: u8) {
        match (self.filter, byte) {
            (Filter::Skipping, _) => return,
            (Filter::Escaped, _) => self.filter = Filter::Normal,
            (Filter::Normal, b'\\') => {
                self.filter = Filter::Escaped;
                return;
            }
            (Filter::Normal, b';') => {
                self.filter = Filter::Skipping;
                return;
            }
            _ => {}
        }
        if byte == 0x08 {
            self.line.pop();
        } else {
            self.line.push(byte);
            if self.line.len() >= self.line_bytes - 1 {
                self.filter = Filter::Skipping;
            }
        }
    }

    fn judge(&mut self, text: Vec<u8>) -> Received {
        if self.dialect.numbering == Numbering::Ignored {
            return Received::Command(text);
        }
        let start = text.iter().take_while(|&&b| b == b' ').count();
        let command = &text[start..];
        if command.first() != Some(&b'N') {
            return Received::Command(text);
        }
        let sets_number = command.windows(4).any(|word| word == b"M110");
        let number = stated_number(command, sets_number && self.dialect.m110_takes_second);
        match self.dialect.numbering {
            Numbering::SumOnly => self.judge_by_sum(text, number),
            // The sum is looked at first, then the number.
            Numbering::CheckedRepeatsSkipped => match wrong_sum(command) {
                Some(reason) if reason == WRONG_CHECKSUM => self.refuse(text, reason),
                _ if sets_number || number == self.last_line + 1 => self.take(text, number),
                _ => self.skip_or_refuse(text, number),
            },
            _ if !sets_number && number != self.last_line + 1 => self.wrong_number(text, number),
            _ => match wrong_sum(command) {
                Some(reason) if reason == WRONG_CHECKSUM || self.dialect.demands_checksum() => {
                    self.refuse(text, reason)
                }
                _ => self.take(text, number),
            },
        }
    }

    /// RepRapFirmware: what follows the first `*` and its digits is not looked at. Not done: its other check, a CRC of five
    /// digits.
    fn judge_by_sum(&mut self, text: Vec<u8>, number: i64) -> Received {
        let start = text.iter().take_while(|&&b| b == b' ').count();
        let command = &text[start..];
        let digits = command.iter().position(|&b| b == b'*').map(|star| {
            let n = command[star + 1..].iter().take_while(|b| b.is_ascii_digit()).count();
            (n, wrong_sum(&command[..=star + n]))
        });
        match digits {
            Some((1..=3, None)) | None => self.take(text, number),
            _ => self.refuse(text, WRONG_CHECKSUM),
        }
    }

    fn take(&mut self, text: Vec<u8>, number: i64) -> Received {
        self.last_line = number;
        self.to_skip = 0;
        Received::Command(text)
    }

    fn wrong_number(&mut self, text: Vec<u8>, number: i64) -> Received {
        let repeated = (self.last_line - 1..=self.last_line).contains(&number);
        if repeated && self.dialect.numbering == Numbering::CheckedRepeatsSilent {
            Received::Repeated(text)
        } else {
            self.refuse(text, WRONG_NUMBER)
        }
    }

    /// Repetier passes over what it has, and over what was under way when it asked for a line.
    fn skip_or_refuse(&mut self, text: Vec<u8>, number: i64) -> Received {
        if (0..REMEMBERED_LINES).contains(&(self.last_line - number)) {
            return Received::Repeated(text);
        }
        match self.to_skip.checked_sub(1) {
            Some(left) => {
                self.to_skip = left;
                Received::Repeated(text)
            }
            None => self.refuse(text, WRONG_NUMBER),
        }
    }

    fn refuse(&mut self, text: Vec<u8>, reason: &'static str) -> Received {
        if self.dialect.clears_on_refusal {
            self.ring.clear();
        }
        if self.dialect.numbering == Numbering::CheckedRepeatsSkipped {
            self.to_skip = SKIPPED_LINES;
        }
        Received::Refused(text, reason)
    }

    /// Whether a line was begun and not ended, or one was asked for and has not come.
    #[must_use]
    pub const fn is_waiting_for_more(&self) -> bool {
        !self.line.is_empty() || self.to_skip > 0
    }

    /// Forgets what has come in; the last line number stays.
    pub fn clear(&mut self) {
        self.ring.clear();
        self.line.clear();
        self.filter = Filter::Normal;
        self.to_skip = 0;
    }

    /// Forgets a line that was begun.
    pub fn drop_line(&mut self) {
        self.line.clear();
        self.filter = Filter::Normal;
    }

    /// Forgets everything, as a reset does.
    pub fn reset(&mut self) {
        self.clear();
        self.emergency = EmergencyParser::default();
        self.last_line = self.dialect.first_last_line;
    }
}

/// What is wrong with the checksum of a numbered line.
fn wrong_sum(command: &[u8]) -> Option<&'static str> {
    let Some(star) = command.iter().rposition(|&b| b == b'*') else { return Some(NO_CHECKSUM) };
    let sum = command[..star].iter().fold(0, |sum, byte| sum ^ byte);
    (leading_integer(&command[star + 1..]) != i64::from(sum)).then_some(WRONG_CHECKSUM)
}

/// The number that a numbered line gives itself.
#[must_use]
pub fn number_of(text: &[u8]) -> i64 {
    let start = text.iter().take_while(|&&b| b == b' ').count();
    stated_number(&text[start..], false)
}

/// The number after the first `N`, or after the second if there is one and it counts.
fn stated_number(command: &[u8], takes_second: bool) -> i64 {
    let second = command.iter().skip(4).position(|&b| b == b'N').filter(|_| takes_second);
    leading_integer(&command[second.map_or(1, |at| at + 5)..])
}

/// The integer at the head of `text` as C's `strtol` reads it: blanks, sign, digits; 0 if there is none.
fn leading_integer(text: &[u8]) -> i64 {
    let text = &text[text.iter().take_while(|b| b.is_ascii_whitespace()).count()..];
    let (negative, digits) = match text {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        _ => (false, text),
    };
    let size = digits
        .iter()
        .take_while(|b| b.is_ascii_digit())
        .fold(0_i64, |n, b| n.saturating_mul(10).saturating_add(i64::from(b - b'0')));
    if negative { -size } else { size }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::{MARLIN, REPETIER, REPRAPFIRMWARE, SMOOTHIE};
    use proptest::prelude::*;

    fn receiver() -> Receiver {
        Receiver::new(128, 96, &MARLIN)
    }

    fn feed(receiver: &mut Receiver, text: &[u8]) -> Vec<Received> {
        for &byte in text {
            receiver.push(byte);
        }
        std::iter::from_fn(|| receiver.next_line()).collect()
    }

    fn numbered(n: i64, text: &str) -> Vec<u8> {
        let body = format!("N{n} {text}");
        let sum = body.bytes().fold(0, |sum, b| sum ^ b);
        format!("{body}*{sum}\n").into_bytes()
    }

    fn reason(received: &[Received]) -> &'static str {
        match received {
            [Received::Command(_)] => "command",
            [Received::Repeated(_)] => "repeated",
            [Received::Refused(_, reason)] => reason,
            _ => "several",
        }
    }

    #[test]
    fn numbered_lines_follow_each_other() {
        let mut receiver = receiver();
        for n in 1..5 {
            assert_eq!(reason(&feed(&mut receiver, &numbered(n, "G1 X1"))), "command");
        }
        assert_eq!(receiver.last_line, 4);
    }

    #[test]
    fn wrong_lines_get_the_firmware_s_reason() {
        let mut receiver = receiver();
        for n in 1..4 {
            feed(&mut receiver, &numbered(n, "G28"));
        }
        for (line, expected) in [
            (&b"N4 G1 X1*1\n"[..], WRONG_CHECKSUM),
            (b"N4 G1 X1\n", NO_CHECKSUM),
            (&numbered(6, "G1"), WRONG_NUMBER),
            (&numbered(1, "G28"), WRONG_NUMBER),
            (&numbered(2, "G28"), "repeated"),
            (&numbered(3, "G28"), "repeated"),
            // The number is looked at first: a damaged repetition is silent too.
            (b"N3 G28*1\n", "repeated"),
            (b"G1 X1*200\n", "command"),
            (&numbered(4, "M110 N77"), "command"),
        ] {
            assert_eq!(reason(&feed(&mut receiver, line)), expected, "{}", String::from_utf8_lossy(line));
        }
        assert_eq!(receiver.last_line, 77);
    }

    #[test]
    fn repetier_skips_what_it_has_and_what_was_under_way() {
        let mut receiver = Receiver::new(1000, 96, &REPETIER);
        for n in 1..4 {
            feed(&mut receiver, &numbered(n, "G28"));
        }
        for (n, expected) in
            [(2, "repeated"), (6, WRONG_NUMBER), (7, "repeated"), (4, "command"), (9, WRONG_NUMBER)]
        {
            assert_eq!(reason(&feed(&mut receiver, &numbered(n, "G28"))), expected, "{n}");
        }
        // The first number of a line counts, and a numbered line needs no checksum.
        assert_eq!(reason(&feed(&mut receiver, b"N5 G28\n")), "command");
        assert_eq!(reason(&feed(&mut receiver, &numbered(30, "M110 N3"))), "command");
        assert_eq!(receiver.last_line, 30);
    }

    #[test]
    fn reprapfirmware_checks_sums_and_no_numbers() {
        let mut receiver = Receiver::new(1000, 96, &REPRAPFIRMWARE);
        for n in [1, 7, 7, 3] {
            assert_eq!(reason(&feed(&mut receiver, &numbered(n, "G28"))), "command", "{n}");
        }
        assert_eq!(reason(&feed(&mut receiver, b"N4 G28*1\n")), WRONG_CHECKSUM);
        assert_eq!(reason(&feed(&mut receiver, b"N4 G28\n")), "command");
        // Two lines that run together: the first is done, the second is gone.
        let mut both = numbered(5, "G28");
        both.pop();
        both.extend(numbered(6, "G29"));
        let received = feed(&mut receiver, &both);
        assert_eq!(reason(&received), "command");
        let [Received::Command(text)] = received.as_slice() else { panic!() };
        assert_eq!(crate::gcode::parse(text).text, b"G28");
    }

    #[test]
    fn smoothie_s_first_line_is_number_0() {
        let mut receiver = Receiver::new(1000, 96, &SMOOTHIE);
        assert_eq!(reason(&feed(&mut receiver, &numbered(1, "G28"))), WRONG_NUMBER);
        assert_eq!(reason(&feed(&mut receiver, &numbered(0, "M110 N7"))), "command");
        assert_eq!(receiver.last_line, 0);
    }

    #[test]
    fn damaged_n_runs_as_an_unnumbered_line() {
        let mut receiver = receiver();
        let mut line = numbered(1, "G1 X1");
        line[0] = b'F';
        assert_eq!(reason(&feed(&mut receiver, &line)), "command");
        assert_eq!(receiver.last_line, 0);
        assert_eq!(reason(&feed(&mut receiver, &numbered(2, "G1 X2"))), WRONG_NUMBER);
    }

    #[test]
    fn two_lines_run_together_are_refused() {
        let mut line = numbered(1, "G1 X1");
        line.pop();
        line.extend(numbered(2, "G1 X2"));
        assert_eq!(reason(&feed(&mut receiver(), &line)), WRONG_CHECKSUM);
    }

    #[test]
    fn refusal_empties_the_ring() {
        let mut text = b"N1 G1 X1*1\n".to_vec();
        text.extend(numbered(2, "G1 X2"));
        text.extend(b"N3 G1");
        let mut receiver = receiver();
        assert_eq!(reason(&feed(&mut receiver, &text)), WRONG_CHECKSUM);
        // The rest of line 3 now stands alone.
        assert_eq!(feed(&mut receiver, b" X3*9\n"), [Received::Command(b" X3*9".to_vec())]);
    }

    #[test]
    fn comments_blank_lines_and_overlong_lines() {
        let mut receiver = Receiver::new(1000, 96, &MARLIN);
        let received = feed(&mut receiver, b"\r\n\n; nothing\nG28 ; home\r\n");
        assert_eq!(received, [Received::Command(b"G28 ".to_vec())]);
        let long = [b"M117 ".to_vec(), vec![b'x'; 200], b"\n".to_vec()].concat();
        let Some(Received::Command(text)) = feed(&mut receiver, &long).pop() else { panic!() };
        assert_eq!(text.len(), 95);
    }

    #[test]
    fn emergency_orders_are_seen_as_they_arrive() {
        let order = |text: &[u8]| {
            let mut receiver = receiver();
            text.iter().filter_map(|&byte| receiver.push(byte)).collect::<Vec<_>>()
        };
        assert_eq!(order(b"M112\n"), [Emergency::Kill]);
        assert_eq!(order(b"N12 M410*37\n"), [Emergency::QuickStop]);
        assert_eq!(order(b" M108\r\n"), [Emergency::Continue]);
        assert_eq!(order(b"M117 M112\nM11 2\nM1\nGM112\n"), []);
    }

    proptest! {
        #[test]
        fn no_single_flipped_bit_changes_what_a_numbered_line_does(
            x in 0_u32..2_000_000, byte in 0_usize..64, bit in 0_u32..8,
        ) {
            let good = numbered(1, &format!("G1 X{}.{:04} Y20.125 E0.0421", x / 10_000, x % 10_000));
            let mut bad = good.clone();
            let at = byte % good.len();
            bad[at] ^= 1 << bit;
            bad.extend(b"\n");
            let mut receiver = receiver();
            for received in feed(&mut receiver, &bad) {
                if let Received::Command(text) = received {
                    let command = crate::gcode::parse(&text);
                    // Either it is the same command (only its end was hit), or it does nothing.
                    let same = crate::gcode::parse(&good[..good.len() - 1]).text == command.text;
                    prop_assert!(command.letter == b'?' || same, "{:?}", text);
                }
            }
        }

        #[test]
        fn any_bytes_are_taken_without_panic(text in proptest::collection::vec(any::<u8>(), 0..400)) {
            let mut receiver = receiver();
            let _ = feed(&mut receiver, &text);
        }
    }
}
