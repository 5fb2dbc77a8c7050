//! What lies over a screen. What awaits the operator stays seen above it, so that a fault shows while a question is open.

use super::canvas::{Canvas, below, row};
use crate::tui::command::{ANY, TABLE, entry_of};
use crate::tui::form::Form;
use crate::tui::message::Target;
use crate::tui::state::Overlay;
use crate::tui::theme::Role;
use crate::tui::update::{matching, why_not};
use crate::tui::words;
use ratatui::layout::{Constraint, Position, Rect};
use ratatui::text::Line;
use std::cmp::Reverse;
use std::collections::BTreeSet;

/// Widths of windows.
const HELP: u16 = 100;
const WINDOW: u16 = 72;

pub(super) fn draw(canvas: &mut Canvas<'_, '_>, body: Rect) {
    match &canvas.state.overlay {
        None => {}
        Some(Overlay::Help(from)) => help(canvas, body, *from),
        Some(Overlay::Palette(text, at)) => palette(canvas, body, text, *at),
        Some(Overlay::Search(text)) => line(canvas, body, "look for (Enter finds, Esc leaves)", ("/", text)),
        Some(Overlay::Console(text, _)) => {
            line(canvas, body, "G-code (Enter sends, Up earlier ones, Esc leaves)", (">", text));
        }
        Some(Overlay::Form(asked)) => form(canvas, body, asked),
    }
}

fn help(canvas: &mut Canvas<'_, '_>, body: Rect, from: u16) {
    canvas.cover();
    let area = body.centered_horizontally(Constraint::Max(HELP));
    let inner = canvas.window(area, "keys (j and k scroll, any other key leaves)");
    let mut lines = Vec::new();
    // What is of use everywhere comes first.
    let scopes: BTreeSet<_> = TABLE.iter().map(|entry| (Reverse(entry.scope.len()), entry.scope)).collect();
    for (_, scope) in scopes {
        let names: Vec<_> = scope.iter().map(|screen| entry_of(screen.command()).name).collect();
        let title = if scope == ANY { "everywhere".to_owned() } else { names.join(" and ") };
        lines.push(Line::from(canvas.span(title, Role::Strong)));
        for entry in TABLE.iter().filter(|entry| entry.scope == scope) {
            let keys: Vec<_> = entry.keys.iter().map(ToString::to_string).collect();
            lines.push(Line::from(vec![
                canvas.span(format!("  {:<17}", keys.join("  ")), Role::Key),
                canvas.span(entry.words, Role::Text),
            ]));
        }
    }
    let most = lines.len().saturating_sub(usize::from(inner.height));
    let from = usize::from(from).min(most);
    for (n, line) in (0u16..inner.height).zip(lines.into_iter().skip(from)) {
        canvas.line(row(inner, n), line);
    }
}

fn palette(canvas: &mut Canvas<'_, '_>, body: Rect, text: &str, at: usize) {
    canvas.cover();
    let area = body.centered_horizontally(Constraint::Max(WINDOW));
    let inner = canvas.window(area, "command (Enter does it, Esc leaves)");
    input(canvas, row(inner, 0), ":", text);
    let rows = below(inner, 1);
    let found = matching(text);
    if found.is_empty() {
        let line = canvas.span("no command is called so", Role::Dim);
        canvas.line(rows, line);
    }
    let page = usize::from(rows.height).max(1);
    let first = at / page * page;
    for (n, (index, entry)) in (0u16..rows.height).zip(found.into_iter().enumerate().skip(first)) {
        let why = why_not(canvas.state, entry.command);
        let role = match (index == at, &why) {
            (true, _) => Role::Chosen,
            (false, Some(_)) => Role::Dim,
            (false, None) => Role::Text,
        };
        let key = entry.keys.first().map(ToString::to_string).unwrap_or_default();
        let words = why.unwrap_or_else(|| entry.words.to_owned());
        let room = usize::from(rows.width).saturating_sub(29);
        let text = format!("{:<19} {key:<9}{}", entry.name, words::cut(&words, room));
        let line = canvas.span(text, role);
        canvas.line(row(rows, n), line);
        canvas.clickable(row(rows, n), Target::Choice(index));
    }
}

fn line(canvas: &mut Canvas<'_, '_>, body: Rect, title: &str, (mark, text): (&str, &str)) {
    canvas.cover();
    let area = Rect { height: 3, ..body.centered_horizontally(Constraint::Max(WINDOW)) };
    let inner = canvas.window(area, title);
    input(canvas, inner, mark, text);
}

/// A line that is written, with the cursor at its end.
fn input(canvas: &mut Canvas<'_, '_>, area: Rect, mark: &str, text: &str) {
    let room = usize::from(area.width).saturating_sub(mark.chars().count() + 2);
    let skipped = text.chars().count().saturating_sub(room);
    let seen: String = text.chars().skip(skipped).collect();
    let line = vec![canvas.span(format!("{mark} "), Role::Key), canvas.span(seen, Role::Text)];
    let width = canvas.line(area, Line::from(line));
    canvas.frame.set_cursor_position(Position::new(area.x + width, area.y));
}

fn form(canvas: &mut Canvas<'_, '_>, body: Rect, form: &Form) {
    canvas.cover();
    let says = u16::try_from(form.says.iter().map(|text| rows_of(text)).sum::<usize>()).unwrap_or(4);
    let fields = u16::try_from(form.fields.len()).unwrap_or(1);
    let area = body.centered(Constraint::Max(WINDOW), Constraint::Length(says + fields + 6));
    let inner = canvas.window(area, &form.title);
    let lines = form.says.iter().map(|text| Line::from(text.clone())).collect();
    canvas.lines(Rect { height: says.min(inner.height), ..inner }, lines);
    let rows = below(inner, says + 1);
    for (n, field) in (0u16..).zip(&form.fields) {
        let mark = format!("{:<17}", field.label);
        let place = row(rows, n);
        if usize::from(n) == form.focus {
            input(canvas, place, &mark, &field.value);
        } else {
            let line = vec![
                canvas.span(format!("{mark} "), Role::Dim),
                canvas.span(field.value.clone(), Role::Text),
            ];
            canvas.line(place, Line::from(line));
        }
    }
    let foot = below(rows, fields + 1);
    let (text, role) = match &form.problem {
        Some(problem) => (problem.clone(), Role::Bad),
        None => ("Enter goes on, Esc leaves everything as it is".to_owned(), Role::Dim),
    };
    let line = canvas.span(text, role);
    canvas.line(foot, line);
}

/// Rows of a text in a window: never too few.
fn rows_of(text: &str) -> usize {
    text.chars().count() / (usize::from(WINDOW) - 12) + 1
}
