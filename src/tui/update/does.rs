//! What each command does, and why it cannot be done now.

use super::{hand, overlay};
use crate::http::wire::{Activity, Anew, BedView, JobView, Move, PrinterView, Turn};
use crate::queue::{JobId, Reason, State as JobState, state::Kind, state::next};
use crate::tui::awaits::{bed_to_clear, paused_job};
use crate::tui::command::{Command, entry_of};
use crate::tui::form::{About, Ask, COPIES, DECISION, Field, Form, NAME, PRIORITY, REASON, Takes};
use crate::tui::message::{Effect, Request};
use crate::tui::state::{Link, Listing, Overlay, Screen, State};
use crate::tui::{view, words};

/// Does it, or says why not.
pub(super) fn it(state: &mut State, command: Command) -> Vec<Effect> {
    if let Some(why) = why_not(state, command) {
        state.say(format!("{}: {why}", entry_of(command).name), true);
        return Vec::new();
    }
    state.notice = None;
    match command {
        Command::Dashboard => show(state, Screen::Dashboard),
        Command::Queue => show(state, Screen::Queue),
        Command::Printer => show(state, Screen::Printer),
        Command::EmergencyStop => hand::emergency_stop(state),
        Command::Seen => {
            state.see();
            Vec::new()
        }
        Command::Home
        | Command::Left
        | Command::Right
        | Command::Back
        | Command::Forth
        | Command::Raise
        | Command::Lower
        | Command::LongerStep
        | Command::ShorterStep
        | Command::Heat
        | Command::HeatersOff
        | Command::Extrude
        | Command::Console
        | Command::Connect
        | Command::Disconnect => hand::it(state, command),
        Command::NextScreen => show(state, state.screen.further(1)),
        Command::PreviousScreen => show(state, state.screen.further(Screen::ALL.len() - 1)),
        Command::NextPrinter => {
            turn_to_printer(state, 1);
            Vec::new()
        }
        Command::PreviousPrinter => {
            turn_to_printer(state, state.printers.len().saturating_sub(1));
            Vec::new()
        }
        Command::Quit => vec![Effect::Quit],
        Command::Start => {
            state.link = Link::NoServer { is_starting: true };
            vec![Effect::Ask(Request::Start)]
        }
        Command::Help => open(state, Overlay::Help(0)),
        Command::Palette => {
            overlay::open_palette(state);
            Vec::new()
        }
        Command::Search => open(state, Overlay::Search(String::new())),
        Command::Theme => {
            state.theme = state.theme.next();
            state.say(format!("theme: {}", state.theme.name()), false);
            Vec::new()
        }
        Command::ClearBed | Command::DoubtBed | Command::SignOff => ask_about(state, command),
        Command::Cancel | Command::CancelPrint | Command::Retry | Command::Copies | Command::Priority => {
            ask_about(state, command)
        }
        Command::Pause => of_print(state, Turn::Pause),
        Command::GoOn => {
            let job = paused_job(state).cloned();
            job.map_or_else(Vec::new, |job| change(state, &job, Turn::GoOn, None))
        }
        Command::Submit => of_chosen(state, Turn::Submit, None),
        Command::Hold => of_chosen(state, Turn::Hold, Some(Turn::Release)),
        Command::Release => of_chosen(state, Turn::Release, Some(Turn::Hold)),
        Command::MoveUp => shift(state, -1),
        Command::MoveDown => shift(state, 1),
        Command::MoveFirst => of_chosen(state, Turn::Move(Move::First), way_back(state)),
        Command::MoveLast => of_chosen(state, Turn::Move(Move::Last), way_back(state)),
        Command::Undo => undo(state),
        Command::Up => moved(state, -1),
        Command::Down => moved(state, 1),
        Command::PageUp => moved(state, -page(state)),
        Command::PageDown => moved(state, page(state)),
        Command::First => choose(state, 0),
        Command::Last => choose(state, usize::MAX),
        Command::Details => {
            state.browsing.details = !state.browsing.details;
            history_of_chosen(state)
        }
        Command::Over => {
            state.browsing.listing = match state.browsing.listing {
                Listing::Live => Listing::Over,
                Listing::Over => Listing::Live,
            };
            (state.browsing.chosen, state.browsing.row) = (None, 0);
            history_of_chosen(state)
        }
        Command::NextMatch => found(state, 1),
        Command::PreviousMatch => found(state, -1),
    }
}

/// Why it cannot be done now, in plain words; `None`: it can.
pub(in crate::tui) fn why_not(state: &State, command: Command) -> Option<String> {
    let why: Result<(), String> = match command {
        Command::Start => match state.link {
            Link::NoServer { is_starting: false } => Ok(()),
            Link::NoServer { is_starting: true } => Err("it is being started".to_owned()),
            _ => Err("one runs".to_owned()),
        },
        Command::ClearBed => connected(state)
            .and_then(|()| bed_to_clear(state).map(drop).ok_or_else(|| "no bed waits for it".to_owned())),
        Command::DoubtBed => connected(state)
            .and_then(|()| state.printer().map(drop).ok_or_else(|| "there is no printer".to_owned())),
        Command::SignOff => connected(state)
            .and_then(|()| to_sign(state).map(drop).ok_or_else(|| "no report waits for it".to_owned())),
        Command::Pause => connected(state).and_then(|()| match state.doing().map(|live| live.activity) {
            Some(Activity::Printing) if state.in_print().is_some() => Ok(()),
            _ => Err("nothing is printing here".to_owned()),
        }),
        Command::GoOn => connected(state)
            .and_then(|()| paused_job(state).map(drop).ok_or_else(|| "nothing is paused".to_owned())),
        Command::CancelPrint => connected(state)
            .and_then(|()| state.in_print().map(drop).ok_or_else(|| "nothing is printing here".to_owned())),
        Command::Submit => of_job(state, Kind::Submit),
        Command::Hold => of_job(state, Kind::Hold),
        Command::Release => of_job(state, Kind::Release),
        Command::Cancel => of_job(state, Kind::Cancel),
        Command::Retry => of_job(state, Kind::Retry),
        Command::Copies | Command::Priority => of_job(state, Kind::Edit),
        Command::MoveFirst | Command::MoveLast => of_job(state, Kind::Edit),
        Command::MoveUp => of_job(state, Kind::Edit).and_then(|()| neighbour(state, -1).map(drop)),
        Command::MoveDown => of_job(state, Kind::Edit).and_then(|()| neighbour(state, 1).map(drop)),
        Command::Undo => connected(state)
            .and_then(|()| state.undo.as_ref().map(drop).ok_or_else(|| "nothing to take back".to_owned())),
        Command::EmergencyStop => Ok(()),
        Command::Seen if state.stop.is_none() && state.failed.is_empty() => {
            Err("there is nothing".to_owned())
        }
        Command::Home
        | Command::Left
        | Command::Right
        | Command::Back
        | Command::Forth
        | Command::Raise
        | Command::Lower
        | Command::Heat
        | Command::HeatersOff
        | Command::Extrude
        | Command::Console => hand::may_move(state),
        Command::Connect | Command::Disconnect => hand::may_connect(state, command),
        Command::NextMatch | Command::PreviousMatch if state.browsing.sought.trim().is_empty() => {
            Err("nothing was looked for: / first".to_owned())
        }
        Command::NextPrinter | Command::PreviousPrinter if state.printers.len() < 2 => {
            Err("there is no other one".to_owned())
        }
        _ => Ok(()),
    };
    why.err()
}

pub(super) fn connected(state: &State) -> Result<(), String> {
    match state.link {
        Link::Up => Ok(()),
        _ => Err("there is no connection to the server".to_owned()),
    }
}

/// Whether the table of states lets the chosen job be changed so.
fn of_job(state: &State, kind: Kind) -> Result<(), String> {
    connected(state)?;
    let job = state.chosen().ok_or_else(|| "there is no job".to_owned())?;
    match next(job.state, kind) {
        Some(_) => Ok(()),
        None => Err(format!("the job is {}", job.state)),
    }
}

fn open(state: &mut State, overlay: Overlay) -> Vec<Effect> {
    state.overlay = Some(overlay);
    Vec::new()
}

fn show(state: &mut State, screen: Screen) -> Vec<Effect> {
    state.screen = screen;
    history_of_chosen(state)
}

fn turn_to_printer(state: &mut State, by: usize) {
    let at = state.printer().and_then(|shown| state.printers.iter().position(|p| p.name == shown.name));
    let next = (at.unwrap_or(0) + by) % state.printers.len().max(1);
    state.shown = state.printers.get(next).map(|printer| printer.name.clone());
}

pub(super) use hand::{command_lines, ordered};

/// Asks the server.
pub(super) fn ask(state: &mut State, request: Request) -> Vec<Effect> {
    if let Err(why) = connected(state) {
        state.say(why, true);
        return Vec::new();
    }
    vec![Effect::Ask(request)]
}

fn change(state: &mut State, job: &JobView, turn: Turn, back: Option<Turn>) -> Vec<Effect> {
    let anew = Anew { turn, saw: Some(job.state), name: None, why: Reason::default() };
    ask(state, Request::Change(job.id, anew, back))
}

fn of_chosen(state: &mut State, turn: Turn, back: Option<Turn>) -> Vec<Effect> {
    let job = state.chosen().cloned();
    job.map_or_else(Vec::new, |job| change(state, &job, turn, back))
}

fn of_print(state: &mut State, turn: Turn) -> Vec<Effect> {
    let job = state.in_print().cloned();
    job.map_or_else(Vec::new, |job| change(state, &job, turn, None))
}

fn undo(state: &mut State) -> Vec<Effect> {
    let Some(undo) = state.undo.take() else { return Vec::new() };
    let anew = Anew { turn: undo.turn, saw: None, name: None, why: Reason::default() };
    ask(state, Request::Change(undo.job, anew, None))
}

/// The neighbour of the chosen job of the same priority.
fn neighbour(state: &State, by: isize) -> Result<JobId, String> {
    let row = state.row();
    let other = row.checked_add_signed(by).and_then(|row| state.live.jobs.get(row));
    let is_equal = |other: &&JobView| state.chosen().is_some_and(|job| job.priority == other.priority);
    other.filter(is_equal).map(|other| other.id).ok_or_else(|| "it is there already".to_owned())
}

fn shift(state: &mut State, by: isize) -> Vec<Effect> {
    let Ok(other) = neighbour(state, by) else { return Vec::new() };
    let to = if by < 0 { Move::Before(other) } else { Move::Behind(other) };
    let back = if by < 0 { Move::Behind(other) } else { Move::Before(other) };
    of_chosen(state, Turn::Move(to), Some(Turn::Move(back)))
}

/// Where the chosen job stands now, among those of its priority.
fn way_back(state: &State) -> Option<Turn> {
    let before = neighbour(state, 1).map(Move::Before);
    Some(Turn::Move(before.or_else(|_| neighbour(state, -1).map(Move::Behind)).ok()?))
}

/// The job to be signed off: the chosen one, else the first one.
fn to_sign(state: &State) -> Option<&JobView> {
    let is_so = |job: &&JobView| job.state == JobState::AwaitingSignOff;
    let chosen = state.chosen().filter(|_| state.screen == Screen::Queue).filter(is_so);
    chosen.or_else(|| state.in_state(JobState::AwaitingSignOff).next())
}

fn ask_about(state: &mut State, command: Command) -> Vec<Effect> {
    let form = match command {
        Command::ClearBed => bed_to_clear(state).map(|printer| clear_bed(state, printer)),
        Command::DoubtBed => state.printer().map(doubt_bed),
        Command::SignOff => to_sign(state).map(sign_off),
        Command::CancelPrint => state.in_print().map(cancel),
        Command::Cancel => state.chosen().map(cancel),
        Command::Retry => state.chosen().map(retry),
        Command::Copies => state.chosen().map(copies),
        Command::Priority => state.chosen().map(priority),
        _ => None,
    };
    state.overlay = form.map(|form| Overlay::Form(Box::new(form)));
    Vec::new()
}

fn clear_bed(state: &State, printer: &PrinterView) -> Form {
    let name = &printer.name;
    let (on_bed, what) = match printer.bed {
        BedView::Taken(id) => {
            let of = state.job(id).map(words::copies).filter(|copies| !copies.is_empty());
            let of = of.map(|copies| format!(" ({copies})")).unwrap_or_default();
            (Some(id), format!("Job {}{of} lies on the bed of {name}.", words::short(id)))
        }
        BedView::Clear | BedView::Unknown => (None, format!("Nobody knows what lies on the bed of {name}.")),
    };
    let says = vec![
        what,
        "The next print starts by itself once you have said that the bed is clear.".to_owned(),
        "Look at it. Take off what lies there, and what sticks to it.".to_owned(),
    ];
    let word = Field::new("type clear", Takes::OneOf(&["clear"]));
    let fields = vec![word, Field::new(REASON, Takes::Text)];
    Form::new(About::ClearBed(name.clone(), on_bed), format!("Is the bed of {name} clear?"), says, fields)
}

fn doubt_bed(printer: &PrinterView) -> Form {
    let name = &printer.name;
    let says = vec![format!("Nothing will start on {name} before somebody has said that its bed is clear.")];
    let fields = vec![Field::new(REASON, Takes::Text)];
    Form::new(About::DoubtBed(name.clone()), format!("May the bed of {name} not be clear?"), says, fields)
}

fn about(job: &JobView, ask: Ask) -> About {
    About::Job(job.id, job.state, ask)
}

fn sign_off(job: &JobView) -> Form {
    let says = vec![
        format!("Job {} is printed, {} of {} copies.", words::short(job.id), job.n_printed, job.copies),
        "Read its report first: slices against the CT, worst plane first.".to_owned(),
        "Your word goes into the history under your name. A rejected job has failed.".to_owned(),
    ];
    let fields = vec![
        Field::new(DECISION, Takes::OneOf(&["accept", "reject"])),
        Field::new(NAME, Takes::Needed),
        Field::new(REASON, Takes::Needed),
    ];
    Form::new(about(job, Ask::SignOff), "Sign off".to_owned(), says, fields)
}

fn cancel(job: &JobView) -> Form {
    let short = words::short(job.id);
    let mut fields = vec![Field::new(REASON, Takes::Text)];
    let says = if job.state.is_at_printer() {
        fields.insert(0, Field::new("type cancel", Takes::OneOf(&["cancel"])));
        vec![
            format!("Job {short} is {}. It is stopped for good, and the heaters go off.", job.state),
            "What was laid stays on the bed until somebody takes it off.".to_owned(),
        ]
    } else {
        vec![format!("Job {short} is {}. It can be retried later (R).", job.state)]
    };
    Form::new(about(job, Ask::Cancel), format!("Call job {short} off?"), says, fields)
}

fn retry(job: &JobView) -> Form {
    let short = words::short(job.id);
    let says = vec![format!(
        "Job {short} goes into the queue again, from the copy that failed: {} of {} are printed.",
        job.n_printed, job.copies
    )];
    let fields = vec![Field::new(REASON, Takes::Text)];
    Form::new(about(job, Ask::Retry), format!("Print job {short} again?"), says, fields)
}

fn copies(job: &JobView) -> Form {
    let mut field = Field::new(COPIES, Takes::Number(1, 65_535));
    field.value = job.copies.to_string();
    let says = vec![format!("{} of them are printed.", job.n_printed)];
    let title = format!("How often is job {} printed?", words::short(job.id));
    Form::new(about(job, Ask::Copies(job.copies)), title, says, vec![field])
}

fn priority(job: &JobView) -> Form {
    let mut field = Field::new(PRIORITY, Takes::Number(-128, 127));
    field.value = job.priority.to_string();
    let says = vec!["Higher goes first; 0 is usual.".to_owned()];
    let title = format!("Priority of job {}", words::short(job.id));
    Form::new(about(job, Ask::Priority(job.priority)), title, says, vec![field])
}

fn page(state: &State) -> isize {
    isize::try_from(view::rows_of_list(state)).unwrap_or(1).max(1)
}

fn moved(state: &mut State, by: isize) -> Vec<Effect> {
    choose(state, state.row().saturating_add_signed(by))
}

/// The wheel: over the queue it goes through the jobs.
pub(super) fn step(state: &mut State, rows: i32) {
    if state.screen == Screen::Queue {
        let by = isize::try_from(rows).unwrap_or(0);
        set_row(state, state.row().saturating_add_signed(by));
    }
}

fn set_row(state: &mut State, row: usize) {
    let row = row.min(state.listed().jobs.len().saturating_sub(1));
    (state.browsing.row, state.browsing.chosen) = (row, state.listed().jobs.get(row).map(|job| job.id));
}

/// Chooses the job of a row.
pub(super) fn choose(state: &mut State, row: usize) -> Vec<Effect> {
    set_row(state, row);
    history_of_chosen(state)
}

/// Asks for the history of the chosen job, where it is shown and not there yet.
pub(super) fn history_of_chosen(state: &mut State) -> Vec<Effect> {
    let is_shown = state.screen == Screen::Queue && view::shows_details(state);
    let Some(id) = state.chosen().map(|job| job.id).filter(|_| is_shown && state.link == Link::Up) else {
        return Vec::new();
    };
    if state.browsing.history.as_ref().is_some_and(|(of, ..)| *of == id) {
        return Vec::new();
    }
    // Once: what is asked for counts as there, with nothing in it yet.
    state.browsing.history = Some((id, Vec::new(), false));
    vec![Effect::Ask(Request::History(id))]
}

fn found(state: &mut State, by: isize) -> Vec<Effect> {
    find(state, by, false);
    history_of_chosen(state)
}

/// The next job that holds what is looked for, from the chosen one on or behind it.
pub(super) fn find(state: &mut State, by: isize, from_here: bool) {
    let n_jobs = state.listed().jobs.len();
    let (row, skip) = (state.row(), usize::from(!from_here));
    let at = |n: usize| match by {
        0.. => (row + n) % n_jobs,
        _ => (row + n_jobs - n) % n_jobs,
    };
    let rows = (skip..n_jobs + skip).map(at);
    let hit = rows.into_iter().find(|row| matches(&state.listed().jobs[*row], &state.browsing.sought));
    match hit {
        Some(row) => set_row(state, row),
        None => state.say(format!("no job holds {:?}", state.browsing.sought), true),
    }
}

fn matches(job: &JobView, sought: &str) -> bool {
    let material = job.needs.material.as_ref().map(ToString::to_string).unwrap_or_default();
    let holder = job.holder.as_ref().map(ToString::to_string).unwrap_or_default();
    let all = format!("{} {} {} {material} {holder}", job.id, words::state(job), words::kind(job.kind));
    let all = all.to_lowercase();
    sought.to_lowercase().split_whitespace().all(|word| all.contains(word))
}
