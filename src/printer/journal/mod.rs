//! The journal of a print: enough on disk to go on with it after whatever broke it off.
//!
//! A file beside the job (`JOB.gcode.journal`), readable by its owner alone. It begins with one line that names the format;
//! each further line is a record: sixteen hexadecimal digits of its BLAKE3 sum, a blank, JSON, perhaps blanks. First job, machine
//! and session; then eight lines of one length, which take the records of progress in turn, each over the oldest: so the file
//! stays as long as it is, needs no room on a disk that fills up, and is read in no time after however many hours. The record of
//! the latest moment counts, wherever it stands. What the state of the printer was at some line is not written down: it follows
//! from the job's text ([`super::replay`]), whose sum the journal holds. No name of the job's file is kept, nor a path.
//!
//! A record that was torn (power cut, full disk) or damaged is passed over and counted; the others stay readable. Records of
//! progress are whole by themselves, so that one that is lost costs as much time as lies between two of them, and nothing else.
//! Each tells the longest time that one before it took to the disk: what was lost at most follows from it.
//!
//! This module is pure; [`writer`] is the thread that owns the file, [`recorder`] decides what is written when.

pub mod recorder;
pub mod writer;

use super::protocol::{Heater, Temperatures};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The first line of every journal.
const HEADER: &str = "lumenfab print journal 2";
/// What the first lines of all versions have in common.
const ANY_HEADER: &str = "lumenfab print journal ";
/// Digits of a sum.
const SUM_DIGITS: usize = 16;
/// A longer file is no journal of ours, bytes.
const MAX_BYTES: u64 = 1 << 24;
/// Lines for progress, and their length with the line feed, bytes.
const N_SLOTS: u64 = 8;
const SLOT_BYTES: usize = 512;

/// Which job it is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobId {
    /// BLAKE3 of its bytes.
    pub hash: String,
    /// Its commands.
    pub n_lines: u64,
}

/// What it is printed on.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Machine {
    /// The profile as the operator named it.
    pub profile: String,
    /// BLAKE3 of all its values.
    pub profile_hash: String,
    /// The port as the operator named it.
    pub port: String,
    /// What is behind the port: vendor, product and serial number of a USB device, where it is one.
    pub device: Option<String>,
}

/// How the lines of a session are numbered: the prelude, then the job from one of its lines on.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Track {
    /// Number of the first line.
    pub first_number: u64,
    /// The host's own lines before the job's.
    pub prelude: Vec<String>,
    /// Lines of the job that were done before this session.
    pub n_before: u64,
    /// Lines that may have been executed twice in all sessions so far, at most.
    pub n_twice: u64,
    /// Lines of the host's own that end a pause: neither they nor the job's are sent before a session without these begins.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub back: Vec<String>,
}

/// A place in a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// So many lines of the prelude are done, not all.
    Prelude(usize),
    /// So many lines of the job are done.
    Job(u64),
}

impl Track {
    /// What is done when the firmware has taken all lines up to `number`; `None` where that was before this session.
    #[must_use]
    pub fn place(&self, number: u64) -> Option<Place> {
        let n_done = (number + 1).checked_sub(self.first_number)?;
        let n_prelude = self.prelude.len() as u64;
        Some(match n_done.checked_sub(n_prelude) {
            // Bounded by the length of the prelude.
            None => Place::Prelude(usize::try_from(n_done).unwrap_or(usize::MAX)),
            Some(n_of_job) => Place::Job(self.n_before + n_of_job),
        })
    }

    /// The same, the pause being over.
    #[must_use]
    pub fn gone_on(mut self) -> Self {
        self.prelude.append(&mut self.back);
        self
    }

    /// Lines of the prelude among those up to `number`.
    #[must_use]
    pub fn n_prelude_lines(&self, number: u64) -> u64 {
        (number + 1).saturating_sub(self.first_number).min(self.prelude.len() as u64)
    }

    /// Lines of the job among those up to `number`, before this session included.
    #[must_use]
    pub fn n_job_lines(&self, number: u64) -> u64 {
        match self.place(number) {
            Some(Place::Job(n)) => n,
            _ => self.n_before,
        }
    }
}

/// How far a print is. Lines are the job's, counted from its beginning.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Progress {
    /// Since the session began, s.
    pub t_s: f64,
    /// Number on the wire of the last line sent.
    pub number: u64,
    /// Lines sent.
    pub n_sent: u64,
    /// Lines acknowledged.
    pub n_acked: u64,
    /// Lines certainly executed.
    pub n_certain: u64,
    /// Lines of the host's own before the job's that are certainly executed.
    #[serde(default)]
    pub n_prelude: u64,
    /// Lines that may have been begun, at most, so long ago: all that were sent, where the firmware does not say what it holds.
    pub n_begun: u64,
    /// See above, s.
    pub begun_s: f64,
    /// The printer has brought the nozzle away from the part by itself, nobody knows where.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub is_away: bool,
    /// The longest that a record has taken to the disk so far, s; 0 where none has.
    pub delay_s: f64,
    /// A promise, where one is made: no line of the job behind this one that changes the height is sent before a later record is on
    /// the disk. So what is lost of the journal leaves the height known. A disk that fails, and never takes the record that takes the
    /// promise back, leaves it untrue: the operator is told then that the journal cannot be written.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub z_allowed_to: Option<u64>,
    /// Nozzle, actual and wanted, °C.
    pub hotend_c: Option<[f64; 2]>,
    /// Bed, actual and wanted, °C.
    pub bed_c: Option<[f64; 2]>,
}

impl Progress {
    /// Takes over what is heard of temperatures.
    pub fn set_temperatures(&mut self, t: Temperatures) {
        let pair = |heater: Heater| [heater.actual_c, heater.target_c];
        self.hotend_c = t.hotend.map(pair).or(self.hotend_c);
        self.bed_c = t.bed.map(pair).or(self.bed_c);
    }
}

/// How a session ended.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ending {
    /// Every line is executed.
    Finished,
    /// Given up on request; the heaters are off.
    Cancelled,
    /// Given up, with the fault's code.
    Faulted(String),
}

/// One line of a journal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Record {
    /// First of all.
    Job(JobId),
    /// Second.
    Machine(Machine),
    /// A session begins.
    Session(Track),
    /// How far it is.
    Progress(Progress),
    /// The session has ended.
    End(Ending),
}

/// Why a journal cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The system did not let us.
    #[error("{}: the journal cannot be {action}: {source}{}", path.display(), next_after(action))]
    Io {
        /// The journal.
        path: PathBuf,
        /// `read`, `written`.
        action: &'static str,
        /// Why.
        source: std::io::Error,
    },
    /// Something else has this name.
    #[error("{}: found a file that is no print journal, expected one or none; move it away", .0.display())]
    Foreign(PathBuf),
    /// Of another version of the program.
    #[error("{}: found the format {found:?}, expected {HEADER:?}; resume with the version that wrote it, or print from the beginning with --anew", path.display())]
    Version {
        /// The journal.
        path: PathBuf,
        /// Its first line.
        found: String,
    },
    /// There is none.
    #[error("{}: there is no journal, so nothing is known of a print of this job; print it with `lumenfab print`", .0.display())]
    Missing(PathBuf),
    /// It broke off before the print began.
    #[error("{}: the journal names no job and no session: the print had not begun; print it with `lumenfab print`", .0.display())]
    NotBegun(PathBuf),
}

impl Error {
    /// A stable name for programs.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Io { .. } => "printer.journal_io",
            Self::Foreign(_) => "printer.journal_foreign",
            Self::Version { .. } => "printer.journal_version",
            Self::Missing(_) => "printer.journal_missing",
            Self::NotBegun(_) => "printer.journal_not_begun",
        }
    }
}

/// What to do where the system does not let us. Nothing is sent before the journal has begun.
fn next_after(action: &str) -> &'static str {
    match action {
        "written" => {
            "; nothing was sent to the printer: make room on that disk, or put the job into a folder that you may write"
        }
        _ => "",
    }
}

/// Where the journal of a job is.
#[must_use]
pub fn path_for(job: &Path) -> PathBuf {
    let mut name = job.as_os_str().to_owned();
    name.push(".journal");
    name.into()
}

/// The first line, with its line feed.
#[must_use]
pub fn header() -> Vec<u8> {
    format!("{HEADER}\n").into_bytes()
}

/// A record as a line.
#[must_use]
pub fn encode(record: &Record) -> Vec<u8> {
    let json = serde_json::to_string(record).expect("a record has only keys that are texts");
    format!("{} {json}\n", sum(json.as_bytes())).into_bytes()
}

/// A record as one of the lines for progress; `None` where it is longer.
fn encode_slot(record: &Record) -> Option<Vec<u8>> {
    let mut line = encode(record);
    let n_blanks = SLOT_BYTES.checked_sub(line.len())?;
    line.pop();
    line.extend(std::iter::repeat_n(b' ', n_blanks));
    line.push(b'\n');
    Some(line)
}

fn sum(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex()[..SUM_DIGITS].to_owned()
}

/// `None` for a line that is torn or damaged.
fn decode(line: &[u8]) -> Option<Record> {
    let line = line.trim_ascii_end();
    let (found, json) = (line.get(..SUM_DIGITS)?, line.get(SUM_DIGITS + 1..)?);
    if line[SUM_DIGITS] != b' ' || found != sum(json).as_bytes() {
        return None;
    }
    serde_json::from_slice(json).ok()
}

/// What a journal comes to.
#[derive(Debug, Clone, PartialEq)]
pub struct Log {
    /// The job.
    pub job: JobId,
    /// What it was printed on.
    pub machine: Machine,
    /// The last session.
    pub track: Track,
    /// How far it came.
    pub progress: Progress,
    /// How it ended; `None` where it broke off.
    pub end: Option<Ending>,
    /// Lines that were torn or damaged, and passed over.
    pub n_damaged: usize,
}

impl Log {
    /// Reads a whole journal; `path` is what errors call it.
    ///
    /// # Errors
    /// [`Error::Foreign`], [`Error::Version`], [`Error::NotBegun`]; never because of a torn or damaged record.
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self, Error> {
        let mut lines = bytes.split(|&b| b == b'\n');
        check_header(lines.next().unwrap_or_default(), path)?;
        let mut fold = Fold::default();
        for line in lines.filter(|line| !line.trim_ascii().is_empty()) {
            match decode(line) {
                Some(record) => fold.take(record),
                None => fold.n_damaged += 1,
            }
        }
        fold.log().ok_or_else(|| Error::NotBegun(path.to_owned()))
    }

    /// What a journal holds before its last session: job, machine, and the last progress of the session before.
    fn head(bytes: &[u8]) -> Vec<Record> {
        let mut fold = Fold::default();
        bytes.split(|&b| b == b'\n').filter_map(decode).for_each(|record| fold.take(record));
        let progress = fold.track.is_some().then_some(Record::Progress(fold.progress));
        fold.job
            .map(Record::Job)
            .into_iter()
            .chain(fold.machine.map(Record::Machine))
            .chain(progress)
            .collect()
    }

    /// Reads the journal at `path`.
    ///
    /// # Errors
    /// As [`Self::parse`]; [`Error::Missing`], [`Error::Io`].
    pub fn read(path: &Path) -> Result<Self, Error> {
        Self::parse(&writer::read(path)?, path)
    }
}

fn check_header(line: &[u8], path: &Path) -> Result<(), Error> {
    let text = String::from_utf8_lossy(line);
    if text == HEADER {
        return Ok(());
    }
    if HEADER.starts_with(&*text) {
        return Err(Error::NotBegun(path.to_owned()));
    }
    if text.starts_with(ANY_HEADER) {
        let found: String = text.chars().take(60).collect();
        return Err(Error::Version { path: path.to_owned(), found });
    }
    Err(Error::Foreign(path.to_owned()))
}

#[derive(Debug, Default)]
struct Fold {
    job: Option<JobId>,
    machine: Option<Machine>,
    track: Option<Track>,
    progress: Progress,
    end: Option<Ending>,
    n_damaged: usize,
}

impl Fold {
    fn take(&mut self, record: Record) {
        match record {
            Record::Job(job) => self.job = Some(job),
            Record::Machine(machine) => self.machine = Some(machine),
            Record::Session(track) => {
                let n = track.n_before;
                // Behind a pause or a cable that was out, `n` lines are acknowledged, and a few of them not yet executed.
                let is_known = self.track.is_some() || self.progress.n_acked > 0;
                let n_certain = if is_known { self.progress.n_certain.min(n) } else { n };
                self.progress = Progress {
                    t_s: 0.0,
                    n_sent: n,
                    n_acked: n,
                    n_certain,
                    n_prelude: 0,
                    n_begun: n,
                    begun_s: 0.0,
                    z_allowed_to: None,
                    is_away: false,
                    ..self.progress
                };
                self.track = Some(track);
                self.end = None;
            }
            // The lines for progress are taken in turn: the latest of them may stand anywhere.
            Record::Progress(progress) if progress.t_s < self.progress.t_s => {}
            Record::Progress(progress) => {
                self.progress = progress;
                // Where moves were thrown away, nothing behind tells where it is.
                self.end = self.end.take().filter(|end| *end == Ending::Cancelled);
            }
            Record::End(end) => self.end = Some(end),
        }
    }

    fn log(self) -> Option<Log> {
        let Self { job, machine, track, progress, end, n_damaged } = self;
        Some(Log { job: job?, machine: machine?, track: track?, progress, end, n_damaged })
    }
}

#[cfg(test)]
mod tests;
