//! The printer by hand: what it is doing, what can be asked of it, what was sent.

use super::canvas::{Canvas, behind, row};
use super::dashboard;
use crate::tui::command::Command;
use crate::tui::state::STEPS_MM;
use crate::tui::theme::Role;
use crate::tui::update::why_not;
use crate::tui::words;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::text::Line;

/// Columns of a key and its name.
const COLUMN: u16 = 17;

pub(super) fn draw(canvas: &mut Canvas<'_, '_>, body: Rect) {
    let [left, right] = Layout::horizontal([Constraint::Fill(1), Constraint::Fill(1)]).areas(body);
    let [printer, chart] =
        Layout::vertical([Constraint::Length(dashboard::PRINTER_ROWS), Constraint::Fill(1)]).areas(left);
    dashboard::printer(canvas, printer);
    dashboard::temperatures(canvas, chart);
    let [keys, log] = Layout::vertical([Constraint::Length(9), Constraint::Fill(1)]).areas(right);
    by_hand(canvas, keys);
    sent(canvas, log);
}

fn by_hand(canvas: &mut Canvas<'_, '_>, area: Rect) {
    const KEYS: [[Command; 2]; 6] = [
        [Command::Left, Command::Right],
        [Command::Forth, Command::Back],
        [Command::Lower, Command::Raise],
        [Command::Home, Command::Heat],
        [Command::Extrude, Command::HeatersOff],
        [Command::Connect, Command::Disconnect],
    ];
    let inner = canvas.panel(area, "by hand");
    let step = STEPS_MM[canvas.state.by_hand.step];
    let (first, role) = match why_not(canvas.state, Command::Home) {
        Some(why) => (format!("Not now: {why}."), Role::Warn),
        None => (format!("A step is {step} mm (+ and -). Home first."), Role::Text),
    };
    let first = canvas.span(words::cut(&first, usize::from(inner.width)), role);
    canvas.line(inner, first);
    for (n, pair) in (1u16..).zip(KEYS) {
        for (column, command) in (0u16..).zip(pair) {
            canvas.hint(behind(row(inner, n), column * COLUMN), command);
        }
    }
}

/// Lines that were sent, the newest first.
fn sent(canvas: &mut Canvas<'_, '_>, area: Rect) {
    let state = canvas.state;
    let inner = canvas.panel(area, "sent");
    if state.by_hand.sent.is_empty() {
        let text = "Nothing yet. g writes a line. What the printer answers is not told by the server: look at the printer.";
        let text = vec![Line::from(canvas.span(text, Role::Dim))];
        canvas.lines(inner, text);
        return;
    }
    for (n, sent) in (0u16..inner.height).zip(&state.by_hand.sent) {
        let (answer, role) = match &sent.answer {
            None => ("...".to_owned(), Role::Dim),
            Some(Ok(())) => ("taken".to_owned(), Role::Good),
            Some(Err(why)) => (why.clone(), Role::Bad),
        };
        let at = words::clock(sent.at, state.now, &state.zone);
        let lines = sent.lines.join(" | ");
        let room = usize::from(inner.width).saturating_sub(at.chars().count() + lines.chars().count() + 3);
        let line = vec![
            canvas.span(format!("{at} "), Role::Dim),
            canvas.span(format!("{lines}  "), Role::Strong),
            canvas.span(words::cut(&answer, room), role),
        ];
        canvas.line(row(inner, n), Line::from(line));
    }
}
