//! What is written into the journal, and when.
//!
//! Pure: time and the core's numbers go in, records come out. A record of progress is due every half second while something has
//! changed, so that the journal, written by a thread that may need as long again, is no more than a second behind.

use super::{Progress, Record, Track};
use crate::printer::protocol::{self, Instant, Temperatures};
use crate::printer::replay::{Modal, Queue, Tail};
use crate::profile::Dialect;
use std::time::Duration;

/// Between two records of progress.
pub const INTERVAL: Duration = Duration::from_millis(500);

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
    temperatures: Progress,
    dialect: Dialect,
}

impl Recorder {
    /// For a session that goes along `track`; `modal` and `tail` are those of the lines of the job that are done.
    #[must_use]
    pub fn new(track: Track, modal: Modal, tail: Tail, now: Instant) -> Self {
        let dialect = modal.dialect();
        let prelude = prelude_of(&track, &modal);
        let temperatures = Progress::default();
        Self { track, modal, tail, prelude, began: now, written: None, temperatures, dialect }
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
        Self { temperatures: self.temperatures, ..Self::new(track, self.modal, self.tail, now) }
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
        let effect = self.modal.apply(command);
        self.tail.push(effect);
    }

    /// What was heard of temperatures.
    pub fn hear(&mut self, temperatures: Temperatures) {
        self.temperatures.set_temperatures(temperatures);
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
        Progress {
            t_s: (now.since(self.began).as_secs_f64() * 1e3).round() / 1e3,
            number: core.n_sent,
            n_sent,
            n_acked,
            n_certain: self.tail.n_certain(n_acked, queue).max(n_least),
            n_prelude,
            n_begun,
            begun_s: (begun_s * 1e3).ceil() / 1e3,
            ..self.temperatures
        }
    }

    /// The record that is due, if one is.
    pub fn poll(&mut self, now: Instant, core: protocol::Progress) -> Option<Record> {
        if self.written.is_some_and(|(at, _)| now.since(at) < INTERVAL) {
            return None;
        }
        let progress = self.progress(now, core);
        let same = |(_, last): (Instant, Progress)| {
            Progress { t_s: progress.t_s, begun_s: progress.begun_s, ..last } == progress
        };
        if self.written.is_some_and(same) {
            return None;
        }
        self.written = Some((now, progress));
        Some(Record::Progress(progress))
    }

    /// The record that was given out last did not reach the journal: the next one is due at once.
    pub fn not_written(&mut self) {
        self.written = None;
    }
}

/// What the lines of a prelude do, behind what the job has done.
fn prelude_of(track: &Track, modal: &Modal) -> Tail {
    let mut modal = modal.clone();
    let mut tail = Tail::default();
    track.prelude.iter().for_each(|line| tail.push(modal.apply(line)));
    tail
}
