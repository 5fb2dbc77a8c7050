//! What follows from a message: another state, and what is to be done outside.

mod does;
mod hand;
mod overlay;

use super::command::{self, Command};
use super::message::{Effect, LinkNews, Message, News, Request, Target};
use super::state::{Jobs, Link, Overlay, State, Undo};
use super::{awaits, view};
use crate::http::wire::BedView;
use crate::store::Which;
use jiff::Timestamp;
use ratatui::crossterm::event::KeyEvent;

pub(super) use does::why_not;
pub(super) use overlay::matching;

/// Takes a message.
pub(super) fn update(state: &mut State, message: Message) -> Vec<Effect> {
    match message {
        Message::Key(key) => press(state, key),
        Message::Click(target) => click(state, target),
        Message::Scroll(rows) => {
            scroll(state, rows);
            Vec::new()
        }
        Message::Resize(size) => {
            state.size = size;
            Vec::new()
        }
        Message::Tick(now) => {
            tick(state, now);
            Vec::new()
        }
        Message::Link(news) => {
            link(state, news);
            Vec::new()
        }
        Message::News(news) => hear(state, news),
        Message::Answered(request, answer) => {
            match answer {
                Ok(answer) => answered(state, &request, answer),
                Err(problem) => refused(state, &request, problem),
            }
            Vec::new()
        }
    }
}

fn press(state: &mut State, key: KeyEvent) -> Vec<Effect> {
    // From everywhere, whatever is open, however small the screen is.
    if command::entry_of(Command::EmergencyStop).keys.iter().any(|stop| stop.is(key)) {
        return does::it(state, Command::EmergencyStop);
    }
    if state.overlay.is_some() && view::fits(state.size) {
        return overlay::press(state, key);
    }
    match command::meant(key, state.screen) {
        // What nobody sees is not done.
        Some(command) if !view::fits(state.size) && command != Command::Quit => Vec::new(),
        Some(command) => does::it(state, command),
        None => Vec::new(),
    }
}

fn click(state: &mut State, target: Target) -> Vec<Effect> {
    match target {
        Target::Command(command) => {
            // Whoever clicks sees what is asked, and leaves it by that.
            state.overlay = None;
            does::it(state, command)
        }
        Target::Row(row) => does::choose(state, row),
        Target::Choice(at) => overlay::choose(state, at),
    }
}

fn scroll(state: &mut State, rows: i32) {
    match &mut state.overlay {
        Some(Overlay::Help(from)) => *from = from.saturating_add_signed(clamped(rows)),
        Some(_) => {}
        None => does::step(state, rows),
    }
}

fn clamped(rows: i32) -> i16 {
    i16::try_from(rows).unwrap_or(if rows < 0 { i16::MIN } else { i16::MAX })
}

fn tick(state: &mut State, now: Timestamp) {
    state.now = now;
    if state.notice.as_ref().is_some_and(|notice| notice.until <= now) {
        state.notice = None;
    }
}

fn link(state: &mut State, news: LinkNews) {
    match news {
        LinkNews::Up(status, me) => {
            if matches!(state.link, Link::Lost { .. }) {
                state.say("connected again", false);
            }
            state.link = Link::Up;
            state.me = Some(me);
            state.printers = status.printers;
            state.browsing.history = None;
        }
        LinkNews::NoServer => match state.link {
            // It ran before: what was seen stays to be seen.
            Link::Up => lost(state, "the server has ended".to_owned()),
            Link::NoServer { .. } | Link::Lost { .. } => {}
            Link::Looking | Link::OtherVersion(_) => state.link = Link::NoServer { is_starting: false },
        },
        LinkNews::OtherVersion(found) => state.link = Link::OtherVersion(found),
        LinkNews::Lost(why) => lost(state, why),
    }
}

fn lost(state: &mut State, why: String) {
    let since = match &state.link {
        Link::Lost { since, .. } => *since,
        _ => state.now,
    };
    state.link = Link::Lost { since, why };
}

fn hear(state: &mut State, news: News) -> Vec<Effect> {
    match news {
        News::Jobs(which, jobs, more) => {
            let listing = match which {
                Which::Live => &mut state.live,
                Which::Over => &mut state.over,
            };
            *listing = Jobs { jobs, more };
        }
        News::Changed(jobs) => jobs.into_iter().for_each(|job| state.take_job(job)),
        News::Printers(printers) => {
            let lives = printers.iter().filter_map(|printer| printer.live.clone()).collect();
            state.printers = printers;
            state.take_lives(lives);
        }
        News::Lives(lives) => state.take_lives(lives),
        News::Record(record) => state.take_record(*record),
        News::Schedule(schedule) => state.schedule = Some(*schedule),
    }
    overlay::look_again(state);
    does::history_of_chosen(state)
}

fn answered(state: &mut State, request: &Request, answer: super::message::Answer) {
    match request {
        Request::Change(job, _, Some(back)) => {
            state.undo = Some(Undo { job: *job, turn: *back });
        }
        Request::ClearBed(printer, _) => state.say(format!("the bed of {printer} is clear"), false),
        Request::Order(_, ordered) => does::ordered(state, &ordered.order, Ok(())),
        Request::DoubtBed(printer, _) => {
            state.say(format!("nothing starts on {printer} before its bed is said to be clear"), false);
        }
        _ => {}
    }
    state.take_answer(request, answer);
}

fn refused(state: &mut State, request: &Request, problem: String) {
    match request {
        Request::Start => state.link = Link::NoServer { is_starting: false },
        Request::Order(_, ordered) => does::ordered(state, &ordered.order, Err(problem.clone())),
        _ => {}
    }
    state.say(problem, true);
}

/// Whether a bed is still as it was when the operator was asked about it.
pub(super) fn bed_is(
    state: &State,
    printer: &crate::queue::Name,
    on_bed: Option<crate::queue::JobId>,
) -> bool {
    let found = state.printers.iter().find(|other| other.name == *printer);
    found.is_some_and(|printer| {
        let lies = match printer.bed {
            BedView::Taken(job) => Some(job),
            BedView::Unknown => None,
            BedView::Clear => return false,
        };
        lies == on_bed && awaits::wants_clearing(state, printer)
    })
}
