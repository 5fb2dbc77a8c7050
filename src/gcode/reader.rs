//! One line of G-code to its command, and the checksum that Marlin's protocol wants.
//!
//! A line is `[N number] command words [*checksum] [; comment]`. Comments in parentheses are skipped.
//! Words may stand with or without blanks between them, letters in either case. `M117` and its like carry
//! text in place of words: it is kept as it stands.

use std::borrow::Cow;
use std::fmt;
use std::io::{self, BufRead};
use std::ops::ControlFlow;
use std::str::FromStr;

/// What a line asks the printer to do.
#[derive(Debug, Clone, PartialEq)]
pub struct Command {
    /// `G`, `M` or `T`, upper case.
    pub letter: char,
    /// The number behind it.
    pub code: u32,
    /// The number behind the point, as in `G29.1`.
    pub subcode: Option<u32>,
    /// The words in order: letter in upper case, number where there is one.
    pub words: Vec<(char, Option<f64>)>,
    /// The text of commands that take text.
    pub text: Option<String>,
}

/// A line taken apart.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Line {
    /// The number behind `N`.
    pub number: Option<u64>,
    /// The command, if there is one.
    pub command: Option<Command>,
    /// A command that is a name, as Klipper has them (`SET_VELOCITY_LIMIT ACCEL=1000`), with all behind it.
    pub named: Option<String>,
    /// The number behind `*`.
    pub checksum: Option<u8>,
    /// What stands behind `;`, without it.
    pub comment: Option<String>,
}

/// What a line cannot be read for.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// The line begins with something that is no command.
    #[error("column {column}: found `{found}`; expected G, M or T and a number")]
    NoCommand {
        /// Where, counted from 1 in characters.
        column: usize,
        /// What stands there.
        found: String,
    },
    /// A letter is followed by something that is no number.
    #[error("column {column}: `{found}` is no word of a letter and a number")]
    BadWord {
        /// Where, counted from 1 in characters.
        column: usize,
        /// What stands there.
        found: String,
    },
}

/// Commands whose words are text.
const TEXT_COMMANDS: [(char, u32); 5] = [('M', 16), ('M', 23), ('M', 28), ('M', 117), ('M', 118)];

impl Command {
    /// Whether this is, say, `G1` or `M104`.
    #[must_use]
    pub fn is(&self, letter: char, code: u32) -> bool {
        self.letter == letter && self.code == code && self.subcode.is_none()
    }

    /// The number of a word; `None` where the word is missing or has none.
    #[must_use]
    pub fn value(&self, letter: char) -> Option<f64> {
        self.words.iter().find(|(l, _)| *l == letter).and_then(|(_, v)| *v)
    }

    /// Whether a word stands there, with a number or without.
    #[must_use]
    pub fn has(&self, letter: char) -> bool {
        self.words.iter().any(|(l, _)| *l == letter)
    }
}

impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.letter, self.code)?;
        if let Some(sub) = self.subcode {
            write!(f, ".{sub}")?;
        }
        for (letter, value) in &self.words {
            match value {
                Some(v) => write!(f, " {letter}{v}")?,
                None => write!(f, " {letter}")?,
            }
        }
        self.text.as_ref().map_or(Ok(()), |text| write!(f, " {text}"))
    }
}

/// Takes a line apart.
///
/// # Errors
/// Something that is neither command, word nor comment.
pub fn parse(line: &str) -> Result<Line, Error> {
    let (code, comment) = split_comment(line);
    let comment = comment.map(str::to_owned);
    let (code, checksum) = split_checksum(code);
    let code = without_parentheses(code);
    let mut scanner = Scanner::new(&code);
    let number = scanner.line_number();
    let named = is_named(scanner.rest).then(|| scanner.found());
    let command = if named.is_some() { None } else { scanner.command()? };
    Ok(Line { number, command, named, checksum, comment })
}

/// Whether a command is a name: capitals, digits and at least one underscore.
fn is_named(code: &str) -> bool {
    let name = code.split_ascii_whitespace().next().unwrap_or_default();
    name.starts_with(|c: char| c.is_ascii_uppercase())
        && name.contains('_')
        && name.bytes().all(|b| b.is_ascii_uppercase() || b.is_ascii_digit() || b == b'_')
}

/// A longer line is no G-code, bytes.
const MAX_LINE: u64 = 1 << 16;

/// Gives the lines of a job with their numbers, from 1, until `see` has seen enough. Bytes that are no text become U+FFFD.
///
/// # Errors
/// What the system says; [`InvalidData`](io::ErrorKind::InvalidData) for a line that is too long for G-code.
pub fn each_line(mut job: impl BufRead, mut see: impl FnMut(u64, &str) -> ControlFlow<()>) -> io::Result<()> {
    let mut raw = Vec::new();
    for number in 1.. {
        raw.clear();
        let n_bytes = io::Read::take(&mut job, MAX_LINE).read_until(b'\n', &mut raw)? as u64;
        if n_bytes == 0 {
            break;
        }
        if n_bytes == MAX_LINE {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "a line is too long for G-code"));
        }
        if see(number, &String::from_utf8_lossy(&raw)).is_break() {
            break;
        }
    }
    Ok(())
}

/// The part before the comment, with trailing blanks and a checksum kept; what stands behind the semicolon.
#[must_use]
pub fn split_comment(line: &str) -> (&str, Option<&str>) {
    match line.split_once(';') {
        Some((code, comment)) => (code, Some(comment.trim_end_matches(['\r', '\n']))),
        None => (line.trim_end_matches(['\r', '\n']), None),
    }
}

fn split_checksum(code: &str) -> (&str, Option<u8>) {
    let Some((before, after)) = code.rsplit_once('*') else { return (code, None) };
    after.trim().parse().map_or((code, None), |sum| (before, Some(sum)))
}

fn without_parentheses(code: &str) -> Cow<'_, str> {
    if !code.contains('(') {
        return Cow::Borrowed(code);
    }
    let mut inside = false;
    let keep = |c: &char| {
        let was_inside = inside;
        inside = *c == '(' || (inside && *c != ')');
        !inside && !was_inside
    };
    Cow::Owned(code.chars().filter(keep).collect())
}

/// The part of a line that is not yet read.
struct Scanner<'a> {
    whole: &'a str,
    rest: &'a str,
}

impl<'a> Scanner<'a> {
    fn new(whole: &'a str) -> Self {
        Self { whole, rest: whole.trim_start() }
    }

    fn column(&self) -> usize {
        self.whole[..self.whole.len() - self.rest.len()].chars().count() + 1
    }

    fn found(&self) -> String {
        self.rest.trim_end().to_owned()
    }

    fn letter(&mut self) -> Option<char> {
        let letter = self.rest.chars().next().filter(char::is_ascii_alphabetic)?;
        self.rest = &self.rest[1..];
        Some(letter.to_ascii_uppercase())
    }

    /// The longest run of bytes of a kind.
    fn take(&mut self, wanted: impl Fn(u8) -> bool) -> &'a str {
        let n = self.rest.bytes().take_while(|&b| wanted(b)).count();
        let (taken, rest) = self.rest.split_at(n);
        self.rest = rest;
        taken
    }

    fn digits<T: FromStr>(&mut self) -> Option<T> {
        self.take(|b| b.is_ascii_digit()).parse().ok()
    }

    fn line_number(&mut self) -> Option<u64> {
        let before = self.rest;
        let number = self.letter().filter(|&l| l == 'N').and_then(|_| self.digits());
        self.rest = if number.is_some() { self.rest.trim_start() } else { before };
        number
    }

    fn command(&mut self) -> Result<Option<Command>, Error> {
        if self.rest.is_empty() {
            return Ok(None);
        }
        let no_command = Self { ..*self };
        let no_command = || Error::NoCommand { column: no_command.column(), found: no_command.found() };
        let letter = self.letter().filter(|l| matches!(l, 'G' | 'M' | 'T')).ok_or_else(no_command)?;
        let code = self.digits().ok_or_else(no_command)?;
        let mut subcode = None;
        if let Some(rest) = self.rest.strip_prefix('.') {
            self.rest = rest;
            subcode = self.digits();
        }
        let (words, text) = if TEXT_COMMANDS.contains(&(letter, code)) {
            (Vec::new(), Some(self.rest.trim().to_owned()))
        } else {
            (self.words()?, None)
        };
        Ok(Some(Command { letter, code, subcode, words, text }))
    }

    fn words(&mut self) -> Result<Vec<(char, Option<f64>)>, Error> {
        let mut words = Vec::with_capacity(5);
        loop {
            self.rest = self.rest.trim_start();
            if self.rest.is_empty() {
                return Ok(words);
            }
            let before = Self { ..*self };
            let bad_word = || Error::BadWord { column: before.column(), found: before.found() };
            let letter = self.letter().ok_or_else(bad_word)?;
            let value = match self.take(|b| b.is_ascii_digit() || matches!(b, b'.' | b'-' | b'+')) {
                "" => None,
                number => Some(number.parse().ok().ok_or_else(bad_word)?),
            };
            words.push((letter, value));
        }
    }
}

/// The checksum of Marlin's protocol: all bytes of `N.. command ` combined by exclusive or.
#[must_use]
pub fn checksum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, b| sum ^ b)
}

/// A line as it goes over the wire: numbered, with its checksum, without line feed.
#[must_use]
pub fn numbered(number: crate::units::LineNumber, code: &str) -> String {
    let line = format!("N{} {}", number.0, code.trim());
    format!("{line}*{}", checksum(line.as_bytes()))
}

/// Whether the line's checksum is right; `None` where it has none.
#[must_use]
pub fn checksum_holds(line: &str) -> Option<bool> {
    let (code, _) = split_comment(line);
    let (before, sum) = split_checksum(code);
    sum.map(|sum| checksum(before.as_bytes()) == sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::LineNumber;
    use proptest::prelude::*;

    fn command(line: &str) -> Command {
        parse(line).unwrap().command.unwrap()
    }

    #[test]
    fn move_is_taken_apart() {
        let line = parse("N12 g1X10.5 Y-3 E.02 F1800*99 ; go").unwrap();
        assert_eq!((line.number, line.checksum), (Some(12), Some(99)));
        assert_eq!(line.comment.as_deref(), Some(" go"));
        let c = line.command.unwrap();
        assert!(c.is('G', 1));
        assert_eq!(c.value('X'), Some(10.5));
        assert_eq!(c.value('E'), Some(0.02));
        assert_eq!(c.to_string(), "G1 X10.5 Y-3 E0.02 F1800");
    }

    #[test]
    fn text_flags_subcodes_and_comments_are_kept() {
        assert_eq!(command("M117 Layer 3 of 690").text.as_deref(), Some("Layer 3 of 690"));
        assert!(command("G28 X Y").has('Y') && command("G28 X Y").value('Y').is_none());
        assert_eq!(command("G29.1 P1").subcode, Some(1));
        assert_eq!(command("G1 (to the right) X5").value('X'), Some(5.0));
        assert_eq!(parse(";LAYER:3").unwrap().comment.as_deref(), Some("LAYER:3"));
        assert_eq!(parse("  ").unwrap(), Line::default());
    }

    #[test]
    fn named_commands_are_kept_whole() {
        let line = parse("SET_VELOCITY_LIMIT ACCEL=1000 ; gently").unwrap();
        assert_eq!(line.named.as_deref(), Some("SET_VELOCITY_LIMIT ACCEL=1000"));
        assert!(line.command.is_none() && line.comment.as_deref() == Some(" gently"));
        assert!(parse("HELLO").is_err() && parse("set_x").is_err());
    }

    #[test]
    fn nonsense_is_refused_with_its_place() {
        let none = parse("hello").unwrap_err();
        assert_eq!(none, Error::NoCommand { column: 1, found: "hello".into() });
        assert!(none.to_string().contains("expected G, M or T"));
        let bad = parse("G1 X1.2.3").unwrap_err();
        assert_eq!(bad, Error::BadWord { column: 4, found: "X1.2.3".into() });
        assert!(bad.to_string().contains("X1.2.3"));
    }

    #[test]
    fn checksum_is_marlins() {
        assert_eq!(numbered(LineNumber(3), "T0"), "N3 T0*57");
        assert_eq!(checksum_holds("N3 T0*57"), Some(true));
        assert_eq!(checksum_holds("N3 T1*57"), Some(false));
        assert_eq!(checksum_holds("G28"), None);
    }

    proptest! {
        #[test]
        fn no_line_makes_it_panic(line in "\\PC{0,80}") {
            let _ignored = parse(&line);
            let _ignored = checksum_holds(&line);
        }

        #[test]
        fn commands_survive_writing_and_reading(x in -999.0..999.0f64, e in 0.0..5.0f64, code in 0u32..999) {
            let words = vec![('X', Some(x)), ('E', Some(e))];
            let c = Command { letter: 'G', code, subcode: None, words, text: None };
            prop_assert_eq!(parse(&c.to_string()).unwrap().command.unwrap(), c);
        }
    }
}
