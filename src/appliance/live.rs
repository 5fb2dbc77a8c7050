//! What a printer is doing, for the faces: folded from what a print tells, published no oftener than twice a second.

use crate::http::wire::{Activity, Heat, Live};
use crate::printer::driver::PrintEvent;
use crate::printer::protocol::{Event, Heater, Temperatures};
use crate::queue::{JobId, Name};
use jiff::{SignedDuration, Timestamp};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;

/// Between two reports of progress and temperatures.
const SELDOM: SignedDuration = SignedDuration::from_millis(500);
/// From this part of a print on its own pace tells when it ends, not the estimate.
const PACE_FROM: f64 = 0.05;

/// All printers of a server. Clones are the same.
pub(super) type Lives = Arc<watch::Sender<Vec<Live>>>;

/// A print, as far as its end can be told.
#[derive(Debug, Clone, Copy)]
struct Course {
    began: Timestamp,
    estimated_s: f64,
}

/// One printer's part of the lives.
#[derive(Debug)]
pub(super) struct Board {
    live: Live,
    lives: Lives,
    course: Option<Course>,
    /// When numbers were shown last.
    shown: Option<Timestamp>,
}

impl Board {
    /// A printer of which nothing is known yet.
    pub(super) fn new(live: Live, lives: Lives) -> Self {
        let board = Self { live, lives, course: None, shown: None };
        board.publish();
        board
    }

    pub(super) const fn name(&self) -> &Name {
        &self.live.name
    }

    pub(super) const fn activity(&self) -> Activity {
        self.live.activity
    }

    /// It does something else now; that is told at once.
    pub(super) fn set(&mut self, activity: Activity, says: Option<String>) {
        if self.live.activity == activity && self.live.says == says {
            return;
        }
        self.live.activity = activity;
        self.live.says = says;
        self.publish();
    }

    /// A print begins.
    pub(super) fn begin(&mut self, now: Timestamp, job: JobId, estimated_s: u32) {
        self.live.job = Some(job);
        self.course = Some(Course { began: now, estimated_s: estimated_s.into() });
        (self.live.done, self.live.printed_s) = (Some(0.0), Some(0));
        self.live.ends = Some(later(now, estimated_s.into()));
        self.set(Activity::Printing, None);
    }

    /// It broke off, and waits for somebody's word.
    pub(super) fn waits(&mut self, job: JobId, says: String) {
        self.end(Activity::Paused, Some(says));
        self.live.job = Some(job);
        self.publish();
    }

    /// It is over, or not begun.
    pub(super) fn end(&mut self, activity: Activity, says: Option<String>) {
        (self.course, self.live.job) = (None, None);
        (self.live.done, self.live.printed_s, self.live.ends) = (None, None, None);
        (self.live.activity, self.live.says) = (activity, says);
        self.publish();
    }

    /// Takes over what a print tells.
    pub(super) fn hear(&mut self, event: &PrintEvent, now: Timestamp) {
        match event {
            PrintEvent::Progress { n_lines_done, n_lines } => self.progress(*n_lines_done, *n_lines, now),
            PrintEvent::Session(Event::Temperatures(told)) => self.heat(*told, now),
            PrintEvent::Session(Event::Paused) => self.set(Activity::Paused, None),
            PrintEvent::Session(Event::Resumed) | PrintEvent::WentOn { .. } => {
                self.set(Activity::Printing, None)
            }
            PrintEvent::PortLost { hold } => {
                let says =
                    format!("the port vanished: check the cable; it is waited for {} s", hold.as_secs());
                self.set(self.live.activity, Some(says));
            }
            PrintEvent::JournalFailed(_) => {
                self.set(self.live.activity, Some("the journal of the print cannot be written".to_owned()));
            }
            PrintEvent::JournalWorks => self.set(self.live.activity, None),
            _ => {}
        }
    }

    fn progress(&mut self, n_done: u64, n_lines: u64, now: Timestamp) {
        let Some(course) = self.course else { return };
        let done = n_done as f64 / n_lines.max(1) as f64;
        let elapsed_s = now.duration_since(course.began).as_secs_f64().max(0.0);
        let left_s = if done >= PACE_FROM {
            elapsed_s * (1.0 - done) / done
        } else {
            course.estimated_s * (1.0 - done)
        };
        self.live.done = Some(done);
        #[expect(clippy::cast_possible_truncation, reason = "seconds of a print")]
        let printed_s = elapsed_s as u64;
        self.live.printed_s = Some(printed_s);
        self.live.ends = Some(later(now, left_s));
        self.show_numbers(now);
    }

    fn heat(&mut self, told: Temperatures, now: Timestamp) {
        let heat = |heater: Heater| Heat { actual_c: heater.actual_c, target_c: heater.target_c };
        self.live.hotend = told.hotend.map(heat).or(self.live.hotend);
        self.live.bed = told.bed.map(heat).or(self.live.bed);
        self.show_numbers(now);
    }

    /// Unless others were shown just now; a clock that was set back holds nothing up.
    fn show_numbers(&mut self, now: Timestamp) {
        let is_due = |at: Timestamp| !(SignedDuration::ZERO..SELDOM).contains(&now.duration_since(at));
        if self.shown.is_none_or(is_due) {
            self.shown = Some(now);
            self.publish();
        }
    }

    /// Lets everybody see it.
    fn publish(&self) {
        let live = &self.live;
        self.lives.send_modify(|lives| match lives.iter_mut().find(|other| other.name == live.name) {
            Some(shown) => *shown = live.clone(),
            None => lives.push(live.clone()),
        });
    }
}

/// As the printer is before anything is known of it.
pub(super) fn idle(name: Name, port: String, clearing: Duration) -> Live {
    let clearing_s = u32::try_from(clearing.as_secs()).unwrap_or(u32::MAX);
    Live { activity: Activity::Idle, port: Some(port), clearing_s, ..Live::offline(name) }
}

fn later(now: Timestamp, seconds: f64) -> Timestamp {
    let left = SignedDuration::try_from_secs_f64(seconds).unwrap_or(SignedDuration::MAX);
    now.checked_add(left).unwrap_or(Timestamp::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: i64) -> Timestamp {
        Timestamp::from_second(seconds).unwrap()
    }

    fn board() -> (Board, watch::Receiver<Vec<Live>>) {
        let (lives, seen) = watch::channel(Vec::new());
        let name = Name::try_new("left").unwrap();
        (Board::new(idle(name, "sim".into(), Duration::ZERO), Arc::new(lives)), seen)
    }

    fn job() -> JobId {
        JobId::at(at(0), [7; 10])
    }

    fn progress(n_lines_done: u64) -> PrintEvent {
        PrintEvent::Progress { n_lines_done, n_lines: 1000 }
    }

    #[test]
    fn the_end_follows_the_estimate_first_and_the_pace_then() {
        let (mut board, seen) = board();
        board.begin(at(0), job(), 1000);
        let ends = || seen.borrow()[0].ends;
        assert_eq!(ends(), Some(at(1000)));
        board.hear(&progress(10), at(5));
        assert_eq!(ends(), Some(at(995)));
        board.hear(&progress(500), at(400));
        assert_eq!((ends(), seen.borrow()[0].printed_s), (Some(at(800)), Some(400)));
    }

    #[test]
    fn the_job_in_hand_is_shown_as_long_as_it_is() {
        let (mut board, seen) = board();
        let shown = || seen.borrow()[0].job;
        assert_eq!(shown(), None);
        board.begin(at(0), job(), 10);
        assert_eq!(shown(), Some(job()));
        board.waits(job(), "it broke off".into());
        assert_eq!((shown(), seen.borrow()[0].activity), (Some(job()), Activity::Paused));
        board.end(Activity::Idle, None);
        assert_eq!(shown(), None);
    }

    #[test]
    fn numbers_are_shown_twice_a_second_and_changes_at_once() {
        let (mut board, mut seen) = board();
        board.begin(at(0), job(), 10);
        board.hear(&progress(1), at(1));
        seen.mark_unchanged();
        for n in 2..=10 {
            board.hear(&progress(n), at(1));
        }
        assert!(!seen.has_changed().unwrap());
        board.hear(&PrintEvent::Session(Event::Paused), at(1));
        assert!(seen.has_changed().unwrap());
        assert_eq!(seen.borrow_and_update()[0].activity, Activity::Paused);
        board.hear(&progress(11), at(2));
        assert_eq!(seen.borrow_and_update()[0].done, Some(0.011));
        board.hear(&progress(12), at(-3600));
        assert_eq!(seen.borrow()[0].done, Some(0.012), "the clock was set back");
    }
}
