//! Everything that the terminal UI knows. Nothing here reads a clock, asks a server or draws.

use super::command::Command;
use super::form::Form;
use super::heats::Heats;
use super::message::{Answer, Request};
use super::theme::Theme;
use crate::http::wire::{Activity, BedView, HistoryView, JobView, Live, PrinterView, Schedule, Turn, Whoami};
use crate::queue::{JobId, Name, State as JobState, What};
use jiff::Timestamp;
use jiff::tz::TimeZone;
use ratatui::layout::Size;
use std::collections::VecDeque;

/// Records that are kept to be shown.
const MOST_NEWS: usize = 50;

/// A screen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Screen {
    Dashboard,
    Queue,
    Printer,
}

impl Screen {
    /// All of them, in the order of their tabs.
    pub(super) const ALL: [Self; 3] = [Self::Dashboard, Self::Queue, Self::Printer];

    pub(super) const fn command(self) -> Command {
        match self {
            Self::Dashboard => Command::Dashboard,
            Self::Queue => Command::Queue,
            Self::Printer => Command::Printer,
        }
    }

    /// The one so many tabs further on.
    pub(super) fn further(self, by: usize) -> Self {
        let at = Self::ALL.iter().position(|screen| *screen == self).unwrap_or(0);
        Self::ALL[(at + by) % Self::ALL.len()]
    }
}

/// The connection.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Link {
    /// It is looked for.
    Looking,
    /// There is a server.
    Up,
    /// None runs here; whether one is being started.
    NoServer { is_starting: bool },
    /// It is of another version.
    OtherVersion(u32),
    /// It was there; since when it is not, and why, in plain words.
    Lost { since: Timestamp, why: String },
}

/// Which jobs are listed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Listing {
    /// Those that are not over, in the order of the queue.
    Live,
    /// Those that are, the last one first.
    Over,
}

/// A listing as far as it is known.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Jobs {
    pub(super) jobs: Vec<JobView>,
    /// Whether there are more behind the last one.
    pub(super) more: bool,
}

impl Jobs {
    pub(super) fn find(&self, id: JobId) -> Option<&JobView> {
        self.jobs.iter().find(|job| job.id == id)
    }
}

/// What is looked at in the queue.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Browsing {
    pub(super) listing: Listing,
    /// The chosen job; `None`: the first one.
    pub(super) chosen: Option<JobId>,
    /// Where it was in the list, should it vanish.
    pub(super) row: usize,
    /// Whether details are shown, where there is room for one thing only.
    pub(super) details: bool,
    /// What was looked for.
    pub(super) sought: String,
    /// The history of one job.
    pub(super) history: Option<(JobId, Vec<HistoryView>, bool)>,
}

/// What lies over the screen.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Overlay {
    /// All keys; from this line on.
    Help(u16),
    /// Commands whose names hold a text; which of them is chosen.
    Palette(String, usize),
    /// What is being looked for.
    Search(String),
    /// A line of G-code that is written; how many lines back in those that were sent.
    Console(String, usize),
    /// A question.
    Form(Box<Form>),
}

/// Something that is said for a while.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Notice {
    pub(super) text: String,
    pub(super) is_bad: bool,
    pub(super) until: Timestamp,
}

/// How the last change is taken back.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Undo {
    pub(super) job: JobId,
    pub(super) turn: Turn,
}

/// An emergency stop, until somebody has seen what came of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Stop {
    pub(super) printer: Name,
    pub(super) asked: Timestamp,
    pub(super) came: Came,
    /// A printer that does nothing, as it was shown when it was asked for: as long as it is, nothing has come of it.
    pub(super) before: Option<Shown>,
}

/// What a printer is shown to do, and what is said of it.
pub(super) type Shown = (Activity, Option<String>);

/// Whether a printer does something that can be stopped.
pub(super) const fn works(activity: Activity) -> bool {
    matches!(activity, Activity::Printing | Activity::Pausing | Activity::Cancelling)
}

/// What came of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Came {
    /// It is on its way to the server.
    Nothing,
    /// The server sends it; the printer has not said anything yet.
    Sent,
    /// The printer does not work any more; what it says, where it says something.
    Stopped(Option<String>),
    /// It was not done: why.
    Refused(String),
}

/// Lines that were sent to a printer, and what the server said.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Sent {
    pub(super) at: Timestamp,
    pub(super) lines: Vec<String>,
    /// `None`: no answer yet.
    pub(super) answer: Option<Result<(), String>>,
}

/// Moving by hand.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct ByHand {
    /// Which of [`STEPS_MM`].
    pub(super) step: usize,
    /// The newest first.
    pub(super) sent: VecDeque<Sent>,
}

/// Steps of a move by hand, mm.
pub(super) const STEPS_MM: [&str; 4] = ["0.1", "1", "10", "50"];

/// See the module.
#[derive(Debug, Clone)]
pub(super) struct State {
    pub(super) now: Timestamp,
    pub(super) zone: TimeZone,
    pub(super) size: Size,
    pub(super) theme: Theme,
    /// Where the server is looked for, in words.
    pub(super) place: String,
    pub(super) link: Link,
    pub(super) me: Option<Whoami>,
    pub(super) printers: Vec<PrinterView>,
    pub(super) heats: Heats,
    pub(super) live: Jobs,
    pub(super) over: Jobs,
    pub(super) schedule: Option<Schedule>,
    /// What happened last, the newest first.
    pub(super) news: VecDeque<HistoryView>,
    pub(super) screen: Screen,
    /// The printer that is shown; `None`: the first one.
    pub(super) shown: Option<Name>,
    pub(super) browsing: Browsing,
    pub(super) overlay: Option<Overlay>,
    pub(super) notice: Option<Notice>,
    pub(super) undo: Option<Undo>,
    pub(super) stop: Option<Stop>,
    /// Jobs that have failed by themselves, and why, until somebody has seen it; the oldest first.
    pub(super) failed: Vec<(JobId, String)>,
    pub(super) by_hand: ByHand,
}

/// How it begins.
#[derive(Debug, Clone)]
pub(super) struct Beginning {
    pub(super) now: Timestamp,
    pub(super) zone: TimeZone,
    pub(super) size: Size,
    pub(super) theme: Theme,
    pub(super) place: String,
}

impl State {
    pub(super) fn new(Beginning { now, zone, size, theme, place }: Beginning) -> Self {
        let browsing = Browsing {
            listing: Listing::Live,
            chosen: None,
            row: 0,
            details: false,
            sought: String::new(),
            history: None,
        };
        Self {
            now,
            zone,
            size,
            theme,
            place,
            link: Link::Looking,
            me: None,
            printers: Vec::new(),
            heats: Heats::default(),
            live: Jobs::default(),
            over: Jobs::default(),
            schedule: None,
            news: VecDeque::new(),
            screen: Screen::Dashboard,
            shown: None,
            browsing,
            overlay: None,
            notice: None,
            undo: None,
            stop: None,
            failed: Vec::new(),
            by_hand: ByHand { step: 1, ..ByHand::default() },
        }
    }

    /// The printer that is shown.
    pub(super) fn printer(&self) -> Option<&PrinterView> {
        let named = self.printers.iter().find(|printer| Some(&printer.name) == self.shown.as_ref());
        named.or_else(|| self.printers.first())
    }

    /// What it is doing.
    pub(super) fn doing(&self) -> Option<&Live> {
        self.printer()?.live.as_ref()
    }

    /// The job on a printer's bed.
    pub(super) fn job_on(&self, printer: &PrinterView) -> Option<&JobView> {
        match printer.bed {
            BedView::Taken(id) => self.job(id),
            BedView::Clear | BedView::Unknown => None,
        }
    }

    /// A job that is known.
    pub(super) fn job(&self, id: JobId) -> Option<&JobView> {
        self.live.find(id).or_else(|| self.over.find(id))
    }

    /// The jobs that are listed.
    pub(super) const fn listed(&self) -> &Jobs {
        match self.browsing.listing {
            Listing::Live => &self.live,
            Listing::Over => &self.over,
        }
    }

    /// The row of the chosen job.
    pub(super) fn row(&self) -> usize {
        let jobs = &self.listed().jobs;
        let at = |id| jobs.iter().position(|job| job.id == id);
        let known = self.browsing.chosen.and_then(at);
        known.unwrap_or(self.browsing.row).min(jobs.len().saturating_sub(1))
    }

    /// The chosen job.
    pub(super) fn chosen(&self) -> Option<&JobView> {
        self.listed().jobs.get(self.row())
    }

    /// The one that is in print on the shown printer.
    pub(super) fn in_print(&self) -> Option<&JobView> {
        self.job_on(self.printer()?).filter(|job| job.state.is_at_printer())
    }

    /// Says something for a while.
    pub(super) fn say(&mut self, text: impl Into<String>, is_bad: bool) {
        /// Long enough to be read.
        const SHOWN_S: i64 = 8;
        let until = self.now + jiff::SignedDuration::from_secs(SHOWN_S);
        self.notice = Some(Notice { text: text.into(), is_bad, until });
    }

    /// Takes a job over as it is now.
    pub(super) fn take_job(&mut self, job: JobView) {
        let is_over = job.state.is_over();
        let (here, there) =
            if is_over { (&mut self.over, &mut self.live) } else { (&mut self.live, &mut self.over) };
        there.jobs.retain(|other| other.id != job.id);
        match here.jobs.iter_mut().find(|other| other.id == job.id) {
            Some(known) if known.revision > job.revision => {}
            Some(known) => *known = job,
            None if is_over => here.jobs.insert(0, job),
            None => here.jobs.push(job),
        }
    }

    /// Takes over what printers of this server are doing.
    pub(super) fn take_lives(&mut self, lives: Vec<Live>) {
        for live in lives {
            self.heats.take(&live, self.now);
            if let Some(printer) = self.printers.iter_mut().find(|printer| printer.name == live.name) {
                printer.live = Some(live);
            }
        }
        self.look_after_stop();
    }

    /// An emergency stop that was sent is done once the printer does not work any more; what it says then is its word.
    pub(super) fn look_after_stop(&mut self) {
        let Some(stop) = self.stop.as_mut() else { return };
        let printer = self.printers.iter().find(|printer| printer.name == stop.printer);
        let Some(live) = printer.and_then(|printer| printer.live.as_ref()) else { return };
        let is_as_before = |(activity, says): &Shown| (*activity, says) == (live.activity, &live.says);
        if stop.before.as_ref().is_some_and(is_as_before) {
            return;
        }
        stop.before = None;
        if stop.came == Came::Sent && !works(live.activity) {
            stop.came = Came::Stopped(live.says.clone());
        }
    }

    /// Keeps a record to be shown.
    pub(super) fn take_record(&mut self, record: HistoryView) {
        if let Some((job, records, _)) = &mut self.browsing.history
            && record.job == Some(*job)
            && records.last().is_none_or(|last| last.seq < record.seq)
        {
            records.push(record.clone());
        }
        self.note_failure(&record);
        self.news.push_front(record);
        self.news.truncate(MOST_NEWS);
    }

    /// A job that fails by itself is told; one that is taken up again is not any more.
    fn note_failure(&mut self, record: &HistoryView) {
        /// Older ones are history.
        const RECENT: jiff::SignedDuration = jiff::SignedDuration::from_hours(24);
        let What::Job { id, to, .. } = &record.what else { return };
        self.failed.retain(|(failed, _)| failed != id);
        let is_by_itself = record.who.starts_with("appliance ") || record.who.starts_with("policy ");
        if *to == JobState::Failed && is_by_itself && self.now.duration_since(record.at) < RECENT {
            self.failed.push((*id, record.why.to_string()));
        }
    }

    /// Takes off what somebody has seen.
    pub(super) fn see(&mut self) {
        if self.stop.take().is_none() && !self.failed.is_empty() {
            self.failed.remove(0);
        }
    }

    /// Takes over what was asked for.
    pub(super) fn take_answer(&mut self, request: &Request, answer: Answer) {
        if let (Request::History(job), Answer::History(page)) = (request, answer) {
            self.browsing.history = Some((*job, page.records, page.more));
        }
    }

    /// Jobs that are in some state, in the order of the queue.
    pub(super) fn in_state(&self, state: JobState) -> impl Iterator<Item = &JobView> {
        self.live.jobs.iter().filter(move |job| job.state == state)
    }
}
