//! What waits for the journal's disk, and for how long.
//!
//! Two kinds of records are on the disk before anything more is sent: one that begins a session, and one that allows the height to
//! change. A disk that is slow is not asked for the second kind for a while; one that does not answer at all is waited for once.

use super::super::journal::Record;
use super::super::protocol::Instant;
use super::super::resume;
use super::{PrintEvent, Session, Stage};
use std::io::{BufRead, Seek};
use std::time::Duration;

/// How long a print waits for its journal's disk before it goes on without.
const LIMIT: Duration = Duration::from_secs(3);

/// A disk that takes longer lets the nozzle stand still wherever the height changes.
const SLOW: Duration = Duration::from_millis(100);

/// For so long the height changes without leave, then.
const DISTRUST: Duration = Duration::from_secs(600);

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Disk {
    /// Whether there is a journal.
    is_kept: bool,
    /// How often something was to be on the disk first.
    n_asked: u64,
    /// Since when the last of it is waited for.
    since: Option<Instant>,
    /// It has not answered in time, and not since.
    hangs: bool,
    trusted_from: Instant,
}

impl<R: BufRead + Seek> Session<R> {
    /// Its records are written down: what must be on the disk first is waited for ([`Self::awaits_disk`]).
    pub fn keep_journal(&mut self) {
        self.disk.is_kept = true;
    }

    /// Which of the things that are to be on the disk first is waited for, counted from 1. Once all records are handed over and on the
    /// disk, or failed, it is to be told with this number ([`Self::handle_flushed`]).
    #[must_use]
    pub fn awaits_disk(&self) -> Option<u64> {
        let Disk { n_asked, since, hangs, .. } = self.disk;
        (since.is_some() || hangs).then_some(n_asked)
    }

    /// All records up to this one are on the disk, or could not be written.
    pub fn handle_flushed(&mut self, now: Instant, number: u64, is_written: bool) {
        self.now = now;
        if number != self.disk.n_asked {
            return;
        }
        if std::mem::take(&mut self.disk.hangs) && is_written {
            self.events.push_back(PrintEvent::JournalWorks);
        }
        let waited = self.disk.since.take().map_or(Duration::ZERO, |since| now.since(since));
        // A promise that cannot be written down is none.
        if waited > SLOW || !is_written {
            self.distrust_disk();
        }
    }

    /// The disk did not answer.
    pub(super) fn disk_timeout(&mut self) {
        if self.disk_due().is_none_or(|due| due > self.now) {
            return;
        }
        self.disk.since = None;
        self.disk.hangs = true;
        let why = format!("the disk has not answered for {} s", LIMIT.as_secs());
        self.events.push_back(PrintEvent::JournalFailed(why));
        self.distrust_disk();
    }

    /// When it is no longer waited for.
    pub(super) fn disk_due(&self) -> Option<Instant> {
        self.disk.since.map(|since| since + LIMIT)
    }

    /// Whether nothing may be sent yet; what ends the print always may.
    pub(super) const fn waits_for_disk(&self) -> bool {
        self.disk.since.is_some() && !self.is_giving_up()
    }

    /// A record that is to be on the disk before anything more is sent.
    pub(super) fn write_first(&mut self, record: Record) {
        self.records.push_back(record);
        if self.disk.is_kept && !self.disk.hangs {
            self.disk.n_asked += 1;
            self.disk.since.get_or_insert(self.now);
        }
    }

    /// Lets the height change by leave of the journal alone, where that is of use and the disk is quick.
    pub(super) fn guard_z(&mut self) {
        let is_trusted = self.disk.is_kept && !self.disk.hangs && self.now >= self.disk.trusted_from;
        if is_trusted && !self.recorder.guards_z() && resume::needs_height(&self.profile) {
            self.recorder.guard_z();
        }
    }

    fn distrust_disk(&mut self) {
        self.disk.trusted_from = self.now + DISTRUST;
        if self.recorder.guards_z() && matches!(self.stage, Stage::Printing) && !self.is_cancelled {
            let record = self.recorder.allow_all(self.now, self.core.progress());
            self.write_first(record);
        }
    }
}
