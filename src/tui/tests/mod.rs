//! What follows from what, and how it looks: whole screens as files in `tests/golden/tui`.
//!
//! `UPDATE_GOLDEN=1 cargo test tui::tests` writes them anew.

mod flow;
mod screens;

use super::message::{Effect, LinkNews, Message, News};
use super::state::{Beginning, State};
use super::theme::Theme;
use super::update::update;
use super::view::{self, Hits};
use crate::http::wire::{
    API, Access, Activity, BedView, EstimateView, Heat, HistoryView, JobView, Live, LoadedBody, NeedsView,
    NextView, PrinterView, Schedule, SlotView, Status, Whoami,
};
use crate::queue::{Change, Digest, JobId, Material, Name, Reason, SpecKind, State as JobState, What};
use crate::store::Which;
use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp};
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use ratatui::layout::Size;

/// A Saturday afternoon.
fn now() -> Timestamp {
    "2026-11-28T14:30:00Z".parse().unwrap()
}

fn later(seconds: i64) -> Timestamp {
    now() + SignedDuration::from_secs(seconds)
}

fn name(text: &str) -> Name {
    Name::try_new(text).unwrap()
}

fn id(n: u8) -> JobId {
    JobId::at(later(-3600 + i64::from(n)), [n; 10])
}

fn job(n: u8, state: JobState) -> JobView {
    let material = Some(Material::try_new("PLA").unwrap());
    JobView {
        id: id(n),
        state,
        kind: if n.is_multiple_of(3) { SpecKind::Case } else { SpecKind::Gcode },
        priority: 0,
        not_before: None,
        copies: 1,
        n_printed: 0,
        sign_off: false,
        needs: NeedsView { profile: Some(name("marlin")), material, nozzle_um: Some(400) },
        estimate: Some(EstimateView { print_s: 5400, filament_mm3: 12_100 }),
        is_prepared: state != JobState::Preparing,
        is_laid: false,
        holder: state.is_at_printer().then(|| name("left")),
        added: later(-3600),
        changed: later(-60),
        revision: 3,
    }
}

fn printing() -> Live {
    Live {
        activity: Activity::Printing,
        port: Some("sim".to_owned()),
        done: Some(0.43),
        printed_s: Some(4320),
        ends: Some(later(5727)),
        hotend: Some(Heat { actual_c: 208.4, target_c: 210.0 }),
        bed: Some(Heat { actual_c: 59.9, target_c: 60.0 }),
        ..Live::offline(name("left"))
    }
}

fn printer(bed: BedView, live: Live) -> PrinterView {
    let loaded = LoadedBody {
        profile: name("marlin"),
        material: Material::try_new("PLA").unwrap(),
        nozzle_um: 400,
        left_mm3: Some(512_000),
    };
    PrinterView { name: live.name.clone(), loaded: Some(loaded), bed, live: Some(live) }
}

fn record(seq: u64, job: JobId, from: JobState, to: JobState, change: Change) -> HistoryView {
    HistoryView {
        seq,
        at: later(-600 + i64::try_from(seq).unwrap()),
        who: "Ada".to_owned(),
        why: Reason::try_new("wanted for Tuesday").unwrap(),
        job: Some(job),
        printer: None,
        what: What::Job { id: job, change, from, to },
        digest: Digest::of(b""),
    }
}

/// A screen under test.
struct Desk {
    state: State,
    effects: Vec<Effect>,
}

impl Desk {
    /// Before anything is heard.
    fn new(width: u16, height: u16, theme: Theme) -> Self {
        let size = Size { width, height };
        let place = "/var/lib/lumenfab".to_owned();
        let state = State::new(Beginning { now: now(), zone: TimeZone::UTC, size, theme, place });
        Self { state, effects: Vec::new() }
    }

    /// With a server that prints the first of some jobs.
    fn printing(width: u16, height: u16, theme: Theme) -> Self {
        let mut desk = Self::new(width, height, theme);
        let jobs = vec![
            JobView { copies: 2, sign_off: true, ..job(1, JobState::Printing) },
            JobView { priority: 5, ..job(2, JobState::Queued) },
            job(3, JobState::Preparing),
            job(4, JobState::Held),
            job(5, JobState::Draft),
        ];
        desk.up(vec![printer(BedView::Taken(id(1)), printing())], jobs);
        for second in 0..540 {
            let warm = f64::from(second).min(200.0);
            let heat = |target_c: f64, actual_c: f64| Some(Heat { actual_c, target_c });
            desk.hear(Message::Tick(later(i64::from(second) - 540)));
            let live =
                Live { hotend: heat(210.0, 8.4 + warm), bed: heat(60.0, 20.0 + 0.2 * warm), ..printing() };
            desk.hear(Message::News(News::Lives(vec![live])));
        }
        desk.hear(Message::Tick(now()));
        desk.hear(Message::News(News::Lives(vec![printing()])));
        desk
    }

    fn up(&mut self, printers: Vec<PrinterView>, jobs: Vec<JobView>) {
        let status = Status {
            api: API,
            version: "0.1.0".to_owned(),
            started: later(-86_400),
            now: now(),
            last_record: 9,
            printers: printers.clone(),
        };
        let me = Whoami { name: name("lab"), access: Access::Admin };
        self.hear(Message::Link(LinkNews::Up(Box::new(status), me)));
        for (seq, from, to, change) in [
            (7, JobState::Draft, JobState::Queued, Change::Submit),
            (8, JobState::Queued, JobState::Printing, Change::Start { printer: name("left") }),
            (9, JobState::Printing, JobState::Printing, Change::Lay),
        ] {
            self.hear(Message::News(News::Record(Box::new(record(seq, id(1), from, to, change)))));
        }
        let slots = jobs.iter().take(2).zip(1..).map(|(job, n)| SlotView {
            job: job.id,
            copy: 1,
            printer: name("left"),
            starts: later(6000 * n),
            ends: later(6000 * n + 5400),
        });
        let schedule = Schedule {
            next: vec![NextView {
                printer: name("left"),
                job: None,
                why_not: Some("nothing waits that fits".to_owned()),
            }],
            slots: slots.collect(),
            unplanned: Vec::new(),
            ends: Some(later(60_000)),
            ends_words: None,
            is_cut: false,
        };
        self.hear(Message::News(News::Jobs(Which::Live, jobs, false)));
        let over = vec![job(9, JobState::Finished), job(8, JobState::Failed)];
        self.hear(Message::News(News::Jobs(Which::Over, over, false)));
        self.hear(Message::News(News::Printers(printers)));
        self.hear(Message::News(News::Schedule(Box::new(schedule))));
    }

    fn hear(&mut self, message: Message) {
        self.effects.extend(update(&mut self.state, message));
    }

    /// Presses keys: signs as they are, `\r` Enter, `\u{1b}` Esc, `\t` Tab.
    fn press(&mut self, keys: &str) {
        for c in keys.chars() {
            let code = match c {
                '\r' => KeyCode::Enter,
                '\u{1b}' => KeyCode::Esc,
                '\t' => KeyCode::Tab,
                c => KeyCode::Char(c),
            };
            self.hear(Message::Key(KeyEvent::new(code, KeyModifiers::NONE)));
        }
    }

    /// What was asked since the last look.
    fn asked(&mut self) -> Vec<Effect> {
        std::mem::take(&mut self.effects)
    }

    fn draw(&self) -> (Buffer, Hits) {
        let Size { width, height } = self.state.size;
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        let mut hits = Hits::default();
        terminal.draw(|frame| hits = view::draw(&self.state, frame)).unwrap();
        (terminal.backend().buffer().clone(), hits)
    }

    fn text(&self) -> String {
        lines(&self.draw().0).join("\n")
    }
}

/// The letters of a screen.
fn lines(buffer: &Buffer) -> Vec<String> {
    let width = usize::from(buffer.area.width);
    let line = |cells: &[ratatui::buffer::Cell]| cells.iter().map(|cell| cell.symbol()).collect::<String>();
    buffer.content.chunks(width).map(|cells| line(cells).trim_end().to_owned()).collect()
}
