//! A job: G-code from any reader, checked in full before the first line of it is sent.
//!
//! Comments, blank lines, the job's own line numbers and checksums are left out, as is `M110`: the session has its own
//! numbers. Commands that a firmware obeys the moment they arrive (`M108`, `M112`, `M410`) have no place in a job that
//! is sent ahead. The reader is read twice, so memory does not grow with the job.

use crate::profile::Firmware;
use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Read, Seek};
use std::path::Path;

/// A line longer than this, comments included, is not G-code.
const MAX_RAW_BYTES: u64 = 1 << 16;

/// Lines that the session adds before the job.
const LINES_BEFORE: u64 = 16;

/// What is wrong with a job. Lines count from 1.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// It cannot be read.
    #[error("{name}: the job cannot be read: {source}")]
    Read {
        /// The job.
        name: String,
        /// Why.
        source: std::io::Error,
    },
    /// There is nothing in it.
    #[error("{name}: the job has no commands")]
    Empty {
        /// The job.
        name: String,
    },
    /// There are commands in it, but none that any printer has.
    #[error(
        "{name}: is no print job: found {n_commands} lines and not one G or M command among them, expected G-code; a case is printed \
         by the name of its directory"
    )]
    NotGcode {
        /// The job.
        name: String,
        /// What would have been sent.
        n_commands: u64,
    },
    /// A line that the firmware would cut.
    #[error(
        "{name}:{line}: {n_bytes} bytes, but the firmware takes {max_bytes} with number and checksum; shorten it"
    )]
    LineTooLong {
        /// The job.
        name: String,
        /// The line.
        line: u64,
        /// Its length on the wire.
        n_bytes: usize,
        /// The longest that is taken.
        max_bytes: usize,
    },
    /// A byte that no command has.
    #[error("{name}:{line}: byte {byte:#04x} outside a comment; a job is plain text")]
    NotText {
        /// The job.
        name: String,
        /// The line.
        line: u64,
        /// The byte.
        byte: u8,
    },
    /// A command that would be obeyed out of order.
    #[error("{name}:{line}: {command} acts the moment it arrives, before the lines ahead of it; take it out")]
    ActsAtOnce {
        /// The job.
        name: String,
        /// The line.
        line: u64,
        /// The command.
        command: String,
    },
    /// `M110` inside a command: firmwares look for it anywhere in a line, and would number their lines anew.
    #[error("{name}:{line}: M110 within a command renumbers the lines; take it out")]
    Renumbers {
        /// The job.
        name: String,
        /// The line.
        line: u64,
    },
    /// The file was changed between check and print.
    #[error("{name}: the job was changed while it was printed")]
    Changed {
        /// The job.
        name: String,
    },
}

impl Error {
    /// A stable name for programs.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Read { .. } => "printer.job_unreadable",
            Self::Empty { .. } => "printer.job_empty",
            Self::NotGcode { .. } => "printer.job_not_gcode",
            Self::LineTooLong { .. } => "printer.job_line_too_long",
            Self::NotText { .. } => "printer.job_not_text",
            Self::ActsAtOnce { .. } => "printer.job_acts_at_once",
            Self::Renumbers { .. } => "printer.job_renumbers",
            Self::Changed { .. } => "printer.job_changed",
        }
    }
}

/// A checked job.
#[derive(Debug)]
pub struct Job<R> {
    source: Source<R>,
    n_lines: u64,
    n_given: u64,
    /// The last command is given once more.
    is_put_back: bool,
}

impl Job<Cursor<Vec<u8>>> {
    /// A job from memory; `name` is what errors call it.
    ///
    /// # Errors
    /// See [`Error`].
    pub fn from_text(text: impl Into<Vec<u8>>, name: &str, firmware: &Firmware) -> Result<Self, Error> {
        Self::try_new(Cursor::new(text.into()), name, firmware)
    }
}

impl Job<BufReader<File>> {
    /// A job from a file.
    ///
    /// # Errors
    /// See [`Error`].
    pub fn from_file(path: &Path, firmware: &Firmware) -> Result<Self, Error> {
        let name = path.display().to_string();
        let file = File::open(path).map_err(|source| Error::Read { name: name.clone(), source })?;
        Self::try_new(BufReader::new(file), &name, firmware)
    }
}

impl<R: BufRead + Seek> Job<R> {
    /// Checks the whole of `reader`, then goes back to its beginning.
    ///
    /// # Errors
    /// See [`Error`]; nothing was sent.
    pub fn try_new(reader: R, name: &str, firmware: &Firmware) -> Result<Self, Error> {
        let mut source = Source {
            reader,
            name: name.to_owned(),
            line: 0,
            n_commands: 0,
            numbered: firmware.line_numbers,
            max_bytes: firmware.line_bytes,
            raw: Vec::new(),
            range: 0..0,
        };
        let mut is_gcode = false;
        while source.advance()? {
            is_gcode = is_gcode || is_code(source.command());
        }
        let n_lines = source.n_commands;
        if n_lines == 0 {
            return Err(Error::Empty { name: source.name });
        }
        if !is_gcode {
            return Err(Error::NotGcode { name: source.name, n_commands: n_lines });
        }
        source.rewind()?;
        Ok(Self { source, n_lines, n_given: 0, is_put_back: false })
    }

    /// Commands in the job.
    #[must_use]
    pub const fn n_lines(&self) -> u64 {
        self.n_lines
    }

    /// Lines given so far.
    #[must_use]
    pub const fn n_given(&self) -> u64 {
        self.n_given
    }

    /// Goes back to the beginning and gives the first `n_lines` commands to `see`; [`Self::next_command`] goes on behind them.
    ///
    /// # Errors
    /// As [`Self::next_command`].
    pub fn replay(&mut self, n_lines: u64, mut see: impl FnMut(&str)) -> Result<(), Error> {
        self.source.rewind()?;
        (self.n_given, self.is_put_back) = (0, false);
        while self.n_given < n_lines {
            match self.next_command()? {
                Some(command) => see(command),
                None => break,
            }
        }
        Ok(())
    }

    /// The next command.
    ///
    /// # Errors
    /// [`Error::Read`] and [`Error::Changed`]: the rest was checked, but is checked again.
    pub fn next_command(&mut self) -> Result<Option<&str>, Error> {
        if self.n_given == self.n_lines {
            return Ok(None);
        }
        if !std::mem::take(&mut self.is_put_back) && !self.source.advance()? {
            return Err(Error::Changed { name: self.source.name.clone() });
        }
        self.n_given += 1;
        Ok(Some(self.source.command()))
    }

    /// The command given last is to be given again: it was not used.
    pub(super) fn put_back(&mut self) {
        debug_assert!(self.n_given > 0 && !self.is_put_back, "one command at most can be put back");
        self.n_given = self.n_given.saturating_sub(1);
        self.is_put_back = true;
    }
}

#[derive(Debug)]
struct Source<R> {
    reader: R,
    name: String,
    /// The line read last, from 1.
    line: u64,
    n_commands: u64,
    numbered: bool,
    max_bytes: usize,
    raw: Vec<u8>,
    /// Where the command stands in `raw`.
    range: std::ops::Range<usize>,
}

impl<R: BufRead + Seek> Source<R> {
    fn rewind(&mut self) -> Result<(), Error> {
        self.line = 0;
        self.n_commands = 0;
        self.reader.rewind().map_err(|source| Error::Read { name: self.name.clone(), source })
    }

    /// Goes on to the next command; false at the end.
    fn advance(&mut self) -> Result<bool, Error> {
        loop {
            self.raw.clear();
            let limited = (&mut self.reader).take(MAX_RAW_BYTES).read_until(b'\n', &mut self.raw);
            let n_bytes = limited.map_err(|source| Error::Read { name: self.name.clone(), source })?;
            if n_bytes == 0 {
                return Ok(false);
            }
            self.line += 1;
            if n_bytes as u64 == MAX_RAW_BYTES && !self.raw.ends_with(b"\n") {
                return Err(self.too_long(n_bytes));
            }
            self.range = command_in(&self.raw);
            if !self.range.is_empty() && !is_renumbering(&self.raw[self.range.clone()]) {
                self.n_commands += 1;
                self.check()?;
                return Ok(true);
            }
        }
    }

    fn command(&self) -> &str {
        std::str::from_utf8(&self.raw[self.range.clone()]).expect("the check lets nothing but ASCII pass")
    }

    fn check(&self) -> Result<(), Error> {
        let command = &self.raw[self.range.clone()];
        let (name, line) = (|| self.name.clone(), self.line);
        if let Some(&byte) = command.iter().find(|&&b| !(b' '..0x7f).contains(&b) && b != b'\t') {
            return Err(Error::NotText { name: name(), line, byte });
        }
        let word = first_word(command);
        if [&b"M108"[..], b"M112", b"M410"].contains(&word) {
            let command = String::from_utf8_lossy(word).into_owned();
            return Err(Error::ActsAtOnce { name: name(), line, command });
        }
        if command.windows(4).any(|word| word == b"M110") {
            return Err(Error::Renumbers { name: name(), line });
        }
        let n_bytes = command.len() + self.overhead();
        if n_bytes > self.max_bytes { Err(self.too_long(n_bytes)) } else { Ok(()) }
    }

    /// Bytes of `N`, number, blank, asterisk and checksum.
    fn overhead(&self) -> usize {
        if !self.numbered {
            return 0;
        }
        let number = self.n_commands + LINES_BEFORE;
        "N *255".len() + number.ilog10() as usize + 1
    }

    fn too_long(&self, n_bytes: usize) -> Error {
        Error::LineTooLong { name: self.name.clone(), line: self.line, n_bytes, max_bytes: self.max_bytes }
    }
}

/// The command in a raw line, without comment, number, checksum and outer blanks; empty if there is none.
fn command_in(raw: &[u8]) -> std::ops::Range<usize> {
    let mut end = raw.iter().position(|&b| b == b';').unwrap_or(raw.len());
    let mut start = 0;
    // Some editors put a byte order mark before the first line.
    if raw.starts_with(b"\xef\xbb\xbf") {
        start = 3;
    }
    trim(raw, &mut start, &mut end);
    if raw[start..end].first() == Some(&b'N') {
        let n_digits = raw[start + 1..end].iter().take_while(|b| b.is_ascii_digit()).count();
        if n_digits > 0 {
            start += 1 + n_digits;
            end = raw[start..end].iter().rposition(|&b| b == b'*').map_or(end, |star| start + star);
            trim(raw, &mut start, &mut end);
        }
    }
    start..end
}

fn trim(raw: &[u8], start: &mut usize, end: &mut usize) {
    while *start < *end && raw[*start].is_ascii_whitespace() {
        *start += 1;
    }
    while *start < *end && raw[*end - 1].is_ascii_whitespace() {
        *end -= 1;
    }
}

fn first_word(command: &[u8]) -> &[u8] {
    command.split(u8::is_ascii_whitespace).next().unwrap_or_default()
}

/// Whether a command is one of the standard's, and no macro.
fn is_code(command: &str) -> bool {
    matches!(command.as_bytes(), [b'G' | b'M', digit, ..] if digit.is_ascii_digit())
}

fn is_renumbering(command: &[u8]) -> bool {
    first_word(command) == b"M110"
}

#[cfg(test)]
mod tests {
    use super::*;

    fn firmware() -> Firmware {
        crate::profile::builtin("marlin").unwrap().firmware
    }

    fn commands(text: &str) -> Result<Vec<String>, Error> {
        let mut job = Job::from_text(text, "job.gcode", &firmware())?;
        let mut out = Vec::new();
        while let Some(command) = job.next_command()? {
            out.push(command.to_owned());
        }
        assert_eq!(job.n_lines(), out.len() as u64);
        Ok(out)
    }

    fn error_of(text: &str) -> String {
        commands(text).unwrap_err().to_string()
    }

    #[test]
    fn comments_blanks_numbers_and_checksums_are_left_out() {
        let text = "\u{feff}; head\r\n\nG28 ; home\n  G1 X1\t\nN5 M110 N5*3\nN6 G1 X2 *77\n;end\nM84";
        assert_eq!(commands(text).unwrap(), ["G28", "G1 X1", "G1 X2", "M84"]);
    }

    #[test]
    fn a_comment_may_hold_anything() {
        assert_eq!(commands("G28 ; \u{e9}\u{1f600}\n").unwrap(), ["G28"]);
    }

    #[test]
    fn a_job_without_commands_is_refused() {
        assert_eq!(error_of("; nothing\n\n"), "job.gcode: the job has no commands");
    }

    #[test]
    fn a_file_of_something_else_is_no_job() {
        let error = error_of("# a case\nct = \"../head\"\nwall_mm = 1.4\n[print]\n");
        assert!(
            error.starts_with("job.gcode: is no print job: found 4 lines and not one G or M command"),
            "{error}"
        );
        assert!(!error.contains("head"), "{error}");
        assert!(commands("START_PRINT BED=60\nG1 X1\nEND_PRINT\n").is_ok());
    }

    #[test]
    fn a_line_that_is_too_long_is_named_before_anything_is_sent() {
        let text = format!("G28\nM117 {}\n", "x".repeat(90));
        assert_eq!(
            error_of(&text),
            "job.gcode:2: 103 bytes, but the firmware takes 95 with number and checksum; shorten it"
        );
        assert!(error_of(&"x".repeat(200_000)).starts_with("job.gcode:1: 65536 bytes"));
        assert!(commands(&format!("G28\nM117 {}\n", "x".repeat(82))).is_ok());
    }

    #[test]
    fn a_byte_that_is_no_text_is_named() {
        assert_eq!(
            error_of("G28\nG1 X\u{1}\n"),
            "job.gcode:2: byte 0x01 outside a comment; a job is plain text"
        );
        assert!(error_of("M117 caf\u{e9}\n").contains("byte 0xc3"));
    }

    #[test]
    fn commands_that_act_at_once_are_refused() {
        for command in ["M112", "M108", "M410"] {
            let error = commands(&format!("G28\n{command} ; now\n")).unwrap_err();
            assert!(matches!(error, Error::ActsAtOnce { line: 2, .. }), "{error}");
        }
        assert!(commands("M1120\n").is_ok());
        assert!(matches!(commands("G28\nM117 M110\n"), Err(Error::Renumbers { line: 2, .. })));
    }

    #[test]
    fn a_file_that_changes_while_it_is_printed_is_noticed() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("job.gcode");
        std::fs::write(&path, "G28\nG1 X1\n").unwrap();
        let mut job = Job::from_file(&path, &firmware()).unwrap();
        std::fs::write(&path, "").unwrap();
        assert!(matches!(job.next_command(), Err(Error::Changed { .. })));
    }

    #[test]
    fn a_file_that_is_not_there_is_named() {
        let error = Job::from_file(Path::new("/nonexistent/j.gcode"), &firmware()).unwrap_err();
        assert!(error.to_string().starts_with("/nonexistent/j.gcode: the job cannot be read"), "{error}");
        assert!(error.code().starts_with("printer.job_"));
    }

    proptest::proptest! {
        #[test]
        fn any_bytes_are_a_job_or_an_error(bytes in proptest::collection::vec(0_u8.., 0..300)) {
            if let Ok(mut job) = Job::from_text(bytes, "x", &firmware()) {
                while let Some(command) = job.next_command().unwrap() {
                    proptest::prop_assert!(!command.is_empty() && !command.contains(['\n', ';']));
                }
            }
        }
    }
}
