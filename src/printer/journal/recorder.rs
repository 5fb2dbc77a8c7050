//! What is written into the journal, and when.
//!
//! Pure: time and the core's numbers go in, records come out. A record of progress is due every half second while something has
//! changed, so that the journal, written by a thread that may need as long again, is no more than a second behind.
//!
//! A line that changes the height needs a record that allows it, which is to be on the disk before it is sent
//! ([`Progress::z_allowed_to`]). One record allows all that follow within a few lines, so that a lift and the way down again cost one;
//! where the next one is needed soon, it allows twice as many.

use super::{Progress, Record, Track};
use crate::printer::protocol::{self, Instant, Temperatures};
use crate::printer::replay::{Modal, Queue, Tail};
use crate::profile::Dialect;
use std::time::Duration;

/// Between two records of progress.
pub const INTERVAL: Duration = Duration::from_millis(500);

/// Lines that one record allows to change the height, at least and at most.
const ALLOWED_AT_ONCE: [u64; 2] = [32, 4096];

/// Records that allow a change of height should lie so far apart, or they will allow more.
const SELDOM: Duration = Duration::from_millis(500);

/// Follows a session.
#[derive(Debug)]
pub struct Recorder {
    track: Track,
    modal: Modal,
    tail: Tail,
    /// The track's own lines before the job's.
    prelude: Tail,
    began: Instant,
    written: Option<(Instant, Progress)>,
    /// The last record has not reached the journal.
    is_due: bool,
    /// What is heard of the printer.
    heard: Progress,
    dialect: Dialect,
    /// Up to which line of the job the height may change; `None`: it always may.
    z_allowed_to: Option<u64>,
    /// How many lines the last record allowed that, and when.
    allowed: (u64, Option<Instant>),
    /// The last line of the job that was given.
    n_fed: u64,
    /// The last one that changed the height.
    last_height: u64,
}

impl Recorder {
    /// For a session that goes along `track`; `modal` and `tail` are those of the lines of the job that are done.
    #[must_use]
    pub fn new(track: Track, modal: Modal, tail: Tail, now: Instant) -> Self {
        let dialect = modal.dialect();
        let prelude = prelude_of(&track, &modal);
        let heard = Progress::default();
        let n_fed = tail.n_lines();
        Self {
            track,
            modal,
            tail,
            prelude,
            began: now,
            written: None,
            is_due: false,
            heard,
            dialect,
            z_allowed_to: None,
            allowed: (ALLOWED_AT_ONCE[0], None),
            n_fed,
            last_height: n_fed,
        }
    }

    /// One for a job from its beginning.
    #[must_use]
    pub fn fresh(dialect: Dialect, track: Track, now: Instant) -> Self {
        let tail = Tail::after(track.n_before);
        Self::new(track, Modal::new(dialect), tail, now)
    }

    /// The same lines done, in a session that goes along another track.
    #[must_use]
    pub fn on(self, track: Track, now: Instant) -> Self {
        Self { heard: self.heard, ..Self::new(track, self.modal, self.tail, now) }
    }

    /// The same lines done, from now on along a track with other lines of the host's own.
    pub fn follow(&mut self, track: Track, now: Instant) {
        self.prelude = prelude_of(&track, &self.modal);
        (self.track, self.began, self.written) = (track, now, None);
    }

    /// The state behind the lines of the job that were given.
    #[must_use]
    pub const fn modal(&self) -> &Modal {
        &self.modal
    }

    /// How the session's lines are numbered.
    #[must_use]
    pub const fn track(&self) -> &Track {
        &self.track
    }

    /// The next line of the job is given to the core.
    pub fn feed(&mut self, command: &str) {
        let before = self.modal.at_mm[2];
        let effect = self.modal.apply(command);
        self.tail.push(effect);
        self.n_fed += 1;
        if self.modal.at_mm[2] != before {
            self.last_height = self.n_fed;
        }
    }

    /// From now on the height changes by leave of a record only.
    pub const fn guard_z(&mut self) {
        if self.z_allowed_to.is_none() {
            self.z_allowed_to = Some(self.n_fed);
        }
    }

    /// Whether it does.
    #[must_use]
    pub const fn guards_z(&self) -> bool {
        self.z_allowed_to.is_some()
    }

    /// Whether the next line of the job may only be given once a record allows it.
    #[must_use]
    pub fn needs_leave(&self, command: &str) -> bool {
        self.z_allowed_to.is_some_and(|to| self.n_fed >= to) && self.modal.changes_height(command)
    }

    /// The record that allows the next line, and some behind it, to change the height.
    pub fn allow_z(&mut self, now: Instant, core: protocol::Progress) -> Record {
        let (n, at) = self.allowed;
        let [least, most] = ALLOWED_AT_ONCE;
        let is_soon = at.is_some_and(|at| now.since(at) < SELDOM);
        let n = if is_soon { (2 * n).min(most) } else { least };
        self.allowed = (n, Some(now));
        self.z_allowed_to = Some(self.n_fed + n);
        self.write(now, self.progress(now, core))
    }

    /// The record that allows every line to change the height.
    pub fn allow_all(&mut self, now: Instant, core: protocol::Progress) -> Record {
        self.z_allowed_to = None;
        self.write(now, self.progress(now, core))
    }

    fn write(&mut self, now: Instant, progress: Progress) -> Record {
        (self.written, self.is_due) = (Some((now, progress)), false);
        Record::Progress(progress)
    }

    /// The printer has brought the nozzle away from the part by itself, or back.
    pub const fn set_away(&mut self, is_away: bool) {
        self.heard.is_away = is_away;
    }

    /// What was heard of temperatures.
    pub fn hear(&mut self, temperatures: Temperatures) {
        self.heard.set_temperatures(temperatures);
    }

    /// How far the print is now.
    #[must_use]
    pub fn progress(&self, now: Instant, core: protocol::Progress) -> Progress {
        let n_acked = self.track.n_job_lines(core.n_acked);
        let n_sent = self.track.n_job_lines(core.n_sent);
        let queue = Queue::of(self.dialect, core.ahead);
        let n_prelude = self.prelude.n_certain(self.track.n_prelude_lines(core.n_acked), queue);
        // The prelude stands behind these.
        let n_least = if n_prelude > 0 { self.track.n_before } else { 0 };
        let held = core.ahead.held.filter(|held| held.n_moves > 0);
        let n_begun = held.map_or(n_sent, |held| self.tail.n_begun(n_acked, held.n_moves));
        let begun_s = held.map_or(0.0, |held| now.since(held.at).as_secs_f64());
        let t_s = (now.since(self.began).as_secs_f64() * 1e3).round();
        // Of two records of one moment the later one counts.
        let least = self.written.map_or(0.0, |(_, before)| (before.t_s * 1e3).round() + 1.0);
        Progress {
            t_s: t_s.max(least) / 1e3,
            number: core.n_sent,
            n_sent,
            n_acked,
            n_certain: self.tail.n_certain(n_acked, queue).max(n_least),
            n_prelude,
            n_begun,
            begun_s: (begun_s * 1e3).ceil() / 1e3,
            z_allowed_to: self.z_allowed_to,
            ..self.heard
        }
    }

    /// The record that is due, if one is.
    pub fn poll(&mut self, now: Instant, core: protocol::Progress) -> Option<Record> {
        let is_recent = |at: Instant| now.since(at) < INTERVAL && !self.is_due;
        // Nearly always.
        if self.written.is_some_and(|(at, last)| is_recent(at) && last.n_certain >= self.last_height) {
            return None;
        }
        let progress = self.progress(now, core);
        let has_arrived = progress.n_certain >= self.last_height;
        if self.written.is_some_and(|(at, _)| is_recent(at) && !has_arrived) {
            return None;
        }
        let same = |(_, last): (Instant, Progress)| {
            Progress { t_s: progress.t_s, begun_s: progress.begun_s, ..last } == progress
        };
        if self.written.is_some_and(same) && !self.is_due {
            return None;
        }
        Some(self.write(now, progress))
    }

    /// The record that was given out last did not reach the journal: the next one is due at once.
    pub fn not_written(&mut self) {
        self.is_due = true;
    }
}

/// What the lines of a prelude do, behind what the job has done.
fn prelude_of(track: &Track, modal: &Modal) -> Tail {
    let mut modal = modal.clone();
    let mut tail = Tail::default();
    track.prelude.iter().for_each(|line| tail.push(modal.apply(line)));
    tail
}
