//! What is drawn on: a frame, a theme, and what can be clicked.

use super::{Hit, Hits};
use crate::tui::command::{Command, entry_of};
use crate::tui::message::Target;
use crate::tui::state::State;
use crate::tui::theme::Role;
use ratatui::Frame;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Clear, Paragraph, Widget, Wrap};

pub(super) struct Canvas<'a, 'f> {
    pub(super) state: &'a State,
    pub(super) frame: &'a mut Frame<'f>,
    hits: Hits,
}

impl<'a, 'f> Canvas<'a, 'f> {
    pub(super) fn new(state: &'a State, frame: &'a mut Frame<'f>) -> Self {
        let area = frame.area();
        frame.buffer_mut().set_style(area, state.theme.style(Role::Text));
        Self { state, frame, hits: Hits::default() }
    }

    pub(super) fn hits(self) -> Hits {
        self.hits
    }

    pub(super) fn area(&self) -> Rect {
        self.frame.area()
    }

    pub(super) const fn style(&self, role: Role) -> Style {
        self.state.theme.style(role)
    }

    pub(super) fn span(&self, text: impl Into<String>, role: Role) -> Span<'static> {
        Span::styled(text.into(), self.style(role))
    }

    pub(super) fn draw(&mut self, widget: impl Widget, area: Rect) {
        self.frame.render_widget(widget, area);
    }

    /// One line at the top of an area; returns the columns that it takes.
    pub(super) fn line(&mut self, area: Rect, line: impl Into<Line<'static>>) -> u16 {
        let line = line.into();
        let area = row(area, 0);
        if area.is_empty() {
            return 0;
        }
        let (x, _) = self.frame.buffer_mut().set_line(area.x, area.y, &line, area.width);
        x - area.x
    }

    /// The same, at the right end.
    pub(super) fn line_right(&mut self, area: Rect, line: Line<'static>) {
        self.draw(line.right_aligned(), row(area, 0));
    }

    /// Lines under each other, wrapped where they are too long.
    pub(super) fn lines(&mut self, area: Rect, lines: Vec<Line<'static>>) {
        let style = self.style(Role::Text);
        self.draw(Paragraph::new(lines).style(style).wrap(Wrap { trim: true }), area);
    }

    /// A frame with a title; returns what is within.
    pub(super) fn panel(&mut self, area: Rect, title: &str) -> Rect {
        let title = self.span(format!(" {title} "), Role::Strong);
        let block = Block::bordered().border_style(self.style(Role::Border)).title(Line::from(title));
        let inner = block.inner(area);
        self.draw(block, area);
        inner
    }

    /// The same over something else.
    pub(super) fn window(&mut self, area: Rect, title: &str) -> Rect {
        let style = self.style(Role::Text);
        self.draw(Clear, area);
        self.frame.buffer_mut().set_style(area, style);
        self.panel(area, title)
    }

    pub(super) fn clickable(&mut self, area: Rect, target: Target) {
        self.hits.0.push(Hit { area, target });
    }

    /// What lies below cannot be clicked any more.
    pub(super) fn cover(&mut self) {
        self.hits.0.clear();
    }

    /// `key name`, clickable; returns the columns that it takes, with a gap.
    pub(super) fn hint(&mut self, area: Rect, command: Command) -> u16 {
        let entry = entry_of(command);
        let key = entry.keys.first().map(ToString::to_string).unwrap_or_default();
        let line =
            Line::from(vec![self.span(key, Role::Key), self.span(format!(" {}", entry.name), Role::Text)]);
        let width = u16::try_from(line.width()).unwrap_or(u16::MAX);
        if width > area.width {
            return area.width;
        }
        self.line(area, line);
        self.clickable(Rect { width, height: 1, ..area }, Target::Command(command));
        width.saturating_add(2).min(area.width)
    }
}

/// One row of an area.
pub(super) fn row(area: Rect, n: u16) -> Rect {
    Rect { y: area.y.saturating_add(n), height: 1, ..area }.intersection(area)
}

/// What is left of an area behind so many columns.
pub(super) fn behind(area: Rect, columns: u16) -> Rect {
    let columns = columns.min(area.width);
    Rect { x: area.x + columns, width: area.width - columns, ..area }
}

/// What is left of an area below so many rows.
pub(super) fn below(area: Rect, rows: u16) -> Rect {
    let rows = rows.min(area.height);
    Rect { y: area.y + rows, height: area.height - rows, ..area }
}
