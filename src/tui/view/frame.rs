//! What is the same on every screen: head, what awaits the operator, tabs, foot; and what is shown where there is no screen.

use super::LEAST;
use super::canvas::{Canvas, behind, row};
use crate::http::wire::{API, Live};
use crate::tui::awaits::{Awaited, awaited};
use crate::tui::command::{self, ANY, Command, Scope, entry_of};
use crate::tui::message::Target;
use crate::tui::state::{Link, Screen, State};
use crate::tui::theme::Role;
use crate::tui::update::why_not;
use crate::tui::words;
use ratatui::layout::Rect;
use ratatui::text::Line;

/// Rows for what awaits the operator.
const MOST_AWAITED: usize = 3;

/// Where things are.
pub(super) struct Places {
    title: Rect,
    awaited: Rect,
    tabs: Rect,
    pub(super) body: Rect,
    notice: Rect,
    keys: Rect,
}

impl Places {
    pub(super) fn of(state: &State, area: Rect) -> Self {
        let n_awaited = awaited(state).len().clamp(1, MOST_AWAITED);
        let n_awaited = u16::try_from(n_awaited).unwrap_or(1);
        let at = |y: u16, height: u16| Rect { y: area.y + y, height, ..area }.intersection(area);
        let top = 2 + n_awaited;
        let height = area.height.saturating_sub(top + 2);
        Self {
            title: at(0, 1),
            awaited: at(1, n_awaited),
            tabs: at(1 + n_awaited, 1),
            body: at(top, height),
            notice: at(top + height, 1),
            keys: at(top + height + 1, 1),
        }
    }
}

pub(super) fn head(canvas: &mut Canvas<'_, '_>, places: &Places) {
    title(canvas, places.title);
    awaits(canvas, places.awaited);
    tabs(canvas, places.tabs);
}

fn title(canvas: &mut Canvas<'_, '_>, area: Rect) {
    let state = canvas.state;
    let mut spans = vec![canvas.span(" lumenfab ", Role::Strong)];
    spans.extend(state.printers.iter().filter_map(|printer| {
        let live = printer.live.as_ref()?;
        Some(canvas.span(format!("  {}: {}", printer.name, in_short(state, live)), Role::Text))
    }));
    canvas.line(area, Line::from(spans));
    let who = state.me.as_ref().map(|me| format!("{}  ", me.name)).unwrap_or_default();
    let (link, role) = match state.link {
        Link::Up => ("● connected", Role::Good),
        Link::Looking => ("○ looking for the server", Role::Warn),
        Link::NoServer { .. } => ("○ no server", Role::Bad),
        Link::OtherVersion(_) => ("○ other version", Role::Bad),
        Link::Lost { .. } => ("○ no connection", Role::Bad),
    };
    let clock = words::clock(state.now, state.now, &state.zone);
    let right = vec![
        canvas.span(format!(" {who}"), Role::Dim),
        canvas.span(link, role),
        canvas.span(format!("  {clock} "), Role::Text),
    ];
    canvas.line_right(area, Line::from(right));
}

/// A printer in a few words.
pub(super) fn in_short(state: &State, live: &Live) -> String {
    let mut text = words::activity(live.activity).to_owned();
    if let Some(done) = live.done {
        text += &format!(" {:.0} %", 100.0 * done);
    }
    if let Some(ends) = live.ends {
        text += &format!(", ends {}", words::clock(ends, state.now, &state.zone));
    }
    text
}

fn awaits(canvas: &mut Canvas<'_, '_>, area: Rect) {
    let all = awaited(canvas.state);
    if all.is_empty() {
        let text = match canvas.state.link {
            Link::Up => " Nothing awaits you.",
            _ => "",
        };
        let line = canvas.span(text, Role::Good);
        canvas.line(area, line);
        return;
    }
    let n_shown = usize::from(area.height);
    for (n, one) in (0u16..).zip(all.iter().take(n_shown)) {
        let more = all.len() - n_shown;
        let more = if usize::from(n) + 1 == n_shown && more > 0 { Some(more) } else { None };
        await_line(canvas, row(area, n), one, more);
    }
}

/// A line in full width: the key first, then what, in as many words as there is room for.
fn await_line(canvas: &mut Canvas<'_, '_>, area: Rect, one: &Awaited, more: Option<usize>) {
    let role = if one.is_bad { Role::Bad } else { Role::Await };
    let style = canvas.style(role);
    canvas.frame.buffer_mut().set_style(area, style);
    let key = one.command.and_then(|command| entry_of(command).keys.first().copied());
    let key = key.map_or_else(|| " ▲ ".to_owned(), |key| format!(" {key} "));
    let more = more.map(|more| format!(" and {more} more ")).unwrap_or_default();
    let room = usize::from(area.width).saturating_sub(key.chars().count() + 1 + more.chars().count());
    let key = canvas.span(key, if one.command.is_some() { Role::Chosen } else { role });
    let text = canvas.span(format!(" {}", words::cut(&one.text, room)), role);
    canvas.line(area, Line::from(vec![key, text]));
    let more = canvas.span(more, role);
    canvas.line_right(area, Line::from(more));
    if let Some(command) = one.command {
        canvas.clickable(area, Target::Command(command));
    }
}

fn tabs(canvas: &mut Canvas<'_, '_>, area: Rect) {
    let mut at = 1;
    for screen in Screen::ALL {
        let entry = entry_of(screen.command());
        let key = entry.keys.first().map(ToString::to_string).unwrap_or_default();
        let role = if screen == canvas.state.screen { Role::Chosen } else { Role::Text };
        let text = format!(" {key} {} ", entry.name);
        let place = behind(area, at);
        let tab = canvas.span(text, role);
        let width = canvas.line(place, tab);
        canvas.clickable(Rect { width, ..place }, Target::Command(screen.command()));
        at += width + 1;
    }
    let text = summary(canvas.state);
    let text = canvas.span(format!("{text} "), Role::Dim);
    canvas.line_right(behind(area, at), Line::from(text));
}

/// The queue in a few words.
fn summary(state: &State) -> String {
    if matches!(state.link, Link::Looking | Link::NoServer { .. } | Link::OtherVersion(_)) {
        return String::new();
    }
    let ends = state.schedule.as_ref().and_then(|schedule| schedule.ends);
    let ends = ends.filter(|ends| *ends > state.now);
    let ends = ends.map(|ends| format!(", all printed {}", words::clock(ends, state.now, &state.zone)));
    let more = if state.live.more { "more than " } else { "" };
    match state.live.jobs.len() {
        0 => "the queue is empty".to_owned(),
        1 => format!("1 job{}", ends.unwrap_or_default()),
        n => format!("{more}{n} jobs{}", ends.unwrap_or_default()),
    }
}

pub(super) fn foot(canvas: &mut Canvas<'_, '_>, places: &Places) {
    if let Some(notice) = &canvas.state.notice {
        let role = if notice.is_bad { Role::Bad } else { Role::Good };
        let text = words::cut(&notice.text, usize::from(places.notice.width).saturating_sub(2));
        let line = canvas.span(format!(" {text}"), role);
        canvas.line(places.notice, line);
    }
    let mut area = behind(places.keys, 1);
    for command in of_use(canvas.state) {
        if area.is_empty() {
            return;
        }
        let width = canvas.hint(area, command);
        area = behind(area, width);
    }
}

/// Commands that can be given now, those of this screen first; moving about needs no words.
fn of_use(state: &State) -> impl Iterator<Item = Command> {
    const UNSAID: &[Command] = &[
        Command::Up,
        Command::Down,
        Command::PageUp,
        Command::PageDown,
        Command::First,
        Command::Last,
        Command::Dashboard,
        Command::Queue,
        Command::Printer,
        Command::NextScreen,
        Command::PreviousScreen,
        Command::PreviousPrinter,
        Command::PreviousMatch,
        Command::DoubtBed,
        Command::Theme,
        // These stand above, where they are of use.
        Command::Seen,
        Command::SignOff,
        Command::Home,
        Command::Left,
        Command::Right,
        Command::Back,
        Command::Forth,
        Command::Raise,
        Command::Lower,
        Command::Heat,
        Command::HeatersOff,
        Command::Extrude,
        Command::Connect,
        Command::Disconnect,
    ];
    const ALWAYS: [Command; 3] = [Command::Help, Command::Palette, Command::Quit];
    let has_screen = matches!(state.link, Link::Up | Link::Lost { .. });
    let is_here = move |scope: Scope| scope == ANY || (has_screen && scope.contains(&state.screen));
    let can = move |entry: &&command::Entry| {
        is_here(entry.scope)
            && !UNSAID.contains(&entry.command)
            && !ALWAYS.contains(&entry.command)
            && why_not(state, entry.command).is_none()
    };
    ALWAYS.into_iter().chain(command::TABLE.iter().filter(can).map(|entry| entry.command))
}

/// Where there is no server to be shown.
pub(super) fn no_server(canvas: &mut Canvas<'_, '_>, body: Rect) {
    let state = canvas.state;
    let place = &state.place;
    let said = match &state.link {
        Link::NoServer { is_starting: false } => vec![
            format!("No lumenfab server runs at {place}."),
            "Press S to start one: it owns printers and queue, and goes on when this screen is left."
                .to_owned(),
            "Or start it elsewhere (`lumenfab serve`): it is looked for once a second.".to_owned(),
        ],
        Link::NoServer { is_starting: true } => vec![format!("A server is being started at {place} ...")],
        Link::OtherVersion(found) => vec![
            format!(
                "The server at {place} speaks version {found} of the interface, this program version {API}."
            ),
            "Install the same lumenfab on both sides; nothing is shown or asked until then.".to_owned(),
        ],
        _ => vec![format!("Looking for the server at {place} ...")],
    };
    let inner = canvas.panel(body, "lumenfab");
    let lines = said.into_iter().flat_map(|text| [Line::default(), Line::from(text)]).collect();
    canvas.lines(inner, lines);
}

/// Where nothing has its place: what matters most.
pub(super) fn small(canvas: &mut Canvas<'_, '_>) {
    let area = canvas.area();
    let state = canvas.state;
    let mut lines = vec![Line::from(canvas.span(
        format!("{}x{}: lumenfab needs {}x{}", area.width, area.height, LEAST.width, LEAST.height),
        Role::Warn,
    ))];
    let all = awaited(state);
    if let Some(first) = all.first() {
        lines.push(Line::from(canvas.span(first.text.clone(), Role::Strong)));
    }
    lines.extend(state.printers.iter().filter_map(|printer| {
        let live = printer.live.as_ref()?;
        Some(Line::from(format!("{}: {}", printer.name, in_short(state, live))))
    }));
    canvas.lines(area, lines);
}
