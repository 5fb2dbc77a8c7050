//! One line of text to a command with its parameters, as Marlin reads it.
//!
//! Leading blanks and a line number `N123` are skipped; what follows `*` is not part of the command. The command letter
//! must be G, M or T with a number behind it, anything else is unknown. Parameters are one capital letter with an
//! optional decimal number; a number has no exponent (`E` opens a parameter). Letters come last-wins. M117 and its kin
//! take the rest of the line as text; for the others the text is what begins with the first parameter without a number.
//!
//! Not done: quoted strings, sub-codes (`G92.1` reads as `G92`), lower-case commands (Marlin refuses them too).

/// A command as read.
#[derive(Debug, Clone, PartialEq)]
pub struct Command<'a> {
    /// `G`, `M` or `T`; `?` for what is none.
    pub letter: u8,
    /// The number behind it.
    pub code: u32,
    /// Number of its line, where it has one.
    pub number: Option<i64>,
    /// Letters seen, bit 0 = A.
    seen: u32,
    /// Letters with a number.
    valued: u32,
    values: [f64; 26],
    /// Without line number, checksum and trailing blanks.
    pub text: &'a [u8],
    /// Free text, for the commands that take it.
    pub argument: &'a [u8],
}

impl Command<'_> {
    /// Whether parameter `letter` is there, with or without a number.
    #[must_use]
    pub const fn seen(&self, letter: u8) -> bool {
        self.seen >> (letter - b'A') & 1 == 1
    }

    /// The number behind parameter `letter`.
    #[must_use]
    pub fn value(&self, letter: u8) -> Option<f64> {
        (self.valued >> (letter - b'A') & 1 == 1).then(|| self.values[usize::from(letter - b'A')])
    }
}

/// Reads one line.
#[must_use]
pub fn parse(line: &[u8]) -> Command<'_> {
    let (number, text) = command_text(line);
    let mut command =
        Command { letter: b'?', code: 0, number, seen: 0, valued: 0, values: [0.0; 26], text, argument: &[] };
    let Some((&letter @ (b'G' | b'M' | b'T'), rest)) = text.split_first() else { return command };
    let rest = skip_blanks(rest);
    let digits = rest.iter().take_while(|b| b.is_ascii_digit()).count();
    if digits == 0 {
        return command;
    }
    command.letter = letter;
    command.code =
        rest[..digits].iter().fold(0, |n: u32, b| n.saturating_mul(10).saturating_add(u32::from(b - b'0')));
    let rest = match &rest[digits..] {
        [b'.', sub @ ..] => &sub[sub.iter().take_while(|b| b.is_ascii_digit()).count()..],
        plain => plain,
    };
    let rest = skip_blanks(rest);
    if letter == b'M' && matches!(command.code, 16 | 23 | 28 | 30 | 117 | 118 | 928) {
        command.argument = rest;
    } else {
        read_parameters(&mut command, rest);
    }
    command
}

fn read_parameters<'a>(command: &mut Command<'a>, mut rest: &'a [u8]) {
    while let Some((&letter, tail)) = rest.split_first() {
        let here = rest;
        let tail = skip_blanks(tail);
        let number = if letter.is_ascii_uppercase() { decimal(tail) } else { None };
        if letter.is_ascii_uppercase() {
            let index = letter - b'A';
            command.seen |= 1 << index;
            command.valued &= !(1 << index);
            if let Some((value, _)) = number {
                command.valued |= 1 << index;
                command.values[usize::from(index)] = value;
            }
        }
        if number.is_none() && command.argument.is_empty() {
            command.argument = here;
        }
        rest = skip_blanks(&tail[number.map_or(0, |(_, length)| length)..]);
    }
}

/// The line number, and the command without blanks in front, checksum and blanks behind.
fn command_text(line: &[u8]) -> (Option<i64>, &[u8]) {
    let mut text = skip_blanks(line);
    let mut number = None;
    if let [b'N', head @ (b'0'..=b'9' | b'-'), tail @ ..] = text {
        let (digits, rest) = tail.split_at(tail.iter().take_while(|b| b.is_ascii_digit()).count());
        let first = if *head == b'-' { 0 } else { i64::from(head - b'0') };
        let size = digits.iter().fold(first, |n, b| n.saturating_mul(10).saturating_add(i64::from(b - b'0')));
        number = Some(if *head == b'-' { -size } else { size });
        text = skip_blanks(rest);
    }
    let star = text.iter().position(|&b| b == b'*').unwrap_or(text.len());
    let text = &text[..star];
    (number, &text[..text.iter().rposition(|&b| b != b' ').map_or(0, |last| last + 1)])
}

fn skip_blanks(text: &[u8]) -> &[u8] {
    &text[text.iter().take_while(|&&b| b == b' ').count()..]
}

/// The decimal number at the head of `text`, and its length; none if there is no digit.
#[must_use]
pub fn decimal(text: &[u8]) -> Option<(f64, usize)> {
    /// Powers of ten that a double holds exactly.
    const POWERS: [f64; 16] =
        [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15];
    let negative = text.first() == Some(&b'-');
    let mut at = usize::from(matches!(text.first(), Some(b'-' | b'+')));
    let (mut mantissa, mut digits, mut decimals, mut point) = (0_u64, 0_usize, 0_usize, false);
    while let Some(&byte) = text.get(at) {
        match byte {
            // Digits beyond what the mantissa holds exactly are far below a step of any machine.
            b'0'..=b'9' => {
                digits += 1;
                if mantissa < 100_000_000_000_000 {
                    mantissa = mantissa * 10 + u64::from(byte - b'0');
                    decimals += usize::from(point);
                } else if !point {
                    mantissa = mantissa.saturating_mul(10);
                }
            }
            b'.' if !point => point = true,
            _ => break,
        }
        at += 1;
    }
    if digits == 0 {
        return None;
    }
    let size = mantissa as f64 / POWERS[decimals.min(15)];
    Some((if negative { -size } else { size }, at))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn numbered_move_is_read() {
        let command = parse(b"N12 G1 X10.5 Y-3 E0.01234 F1800*97");
        assert_eq!((command.letter, command.code), (b'G', 1));
        assert_eq!(command.number, Some(12));
        assert_eq!(command.value(b'X'), Some(10.5));
        assert_eq!(command.value(b'Y'), Some(-3.0));
        assert_eq!(command.value(b'E'), Some(0.01234));
        assert_eq!(command.value(b'F'), Some(1800.0));
        assert_eq!(command.value(b'Z'), None);
        assert_eq!(command.text, b"G1 X10.5 Y-3 E0.01234 F1800");
    }

    #[test]
    fn blanks_are_optional() {
        let command = parse(b"  N3G1X1Y2 Z  3");
        assert_eq!(command.code, 1);
        assert_eq!([b'X', b'Y', b'Z'].map(|l| command.value(l)), [Some(1.0), Some(2.0), Some(3.0)]);
    }

    #[test]
    fn letters_without_number_are_seen() {
        let command = parse(b"G28 X Y");
        assert!(command.seen(b'X') && command.seen(b'Y') && !command.seen(b'Z'));
        assert_eq!(command.value(b'X'), None);
    }

    #[test]
    fn damaged_line_number_is_unknown() {
        for line in [&b"O12 G1 X1*3"[..], b"n12 G1 X1", b"12 G1 X1", b"X10", b"G", b"GX1", b"", b"FOO"] {
            assert_eq!(parse(line).letter, b'?', "{}", String::from_utf8_lossy(line));
        }
        assert_eq!(parse(b"O12 G1 X1*3").text, b"O12 G1 X1");
    }

    #[test]
    fn message_is_the_rest_of_the_line() {
        assert_eq!(parse(b"M117 Layer 3 of 690*12").argument, b"Layer 3 of 690");
        assert_eq!(parse(b"M0 S2 wait").value(b'S'), Some(2.0));
        assert_eq!(parse(b"M0 wait").argument, b"wait");
    }

    proptest! {
        #[test]
        fn decimals_agree_with_the_standard_reader(text in "[-+]?[0-9]{1,6}(\\.[0-9]{0,6})?") {
            let (value, length) = decimal(text.as_bytes()).unwrap();
            prop_assert_eq!(length, text.len());
            prop_assert_eq!(value, text.parse::<f64>().unwrap());
        }

        #[test]
        fn any_bytes_are_read_without_panic(line in proptest::collection::vec(any::<u8>(), 0..120)) {
            prop_assert!(parse(&line).text.len() <= line.len());
        }
    }
}
