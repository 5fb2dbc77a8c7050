//! The state as a screen. Only what is seen is drawn; what can be clicked is told back.

mod canvas;
mod dashboard;
mod frame;
mod overlay;
mod printer;
mod queue;

use super::message::Target;
use super::state::{Link, Screen, State};
use canvas::Canvas;
use ratatui::Frame;
use ratatui::layout::{Position, Rect, Size};

/// Least size of a terminal on which everything has its place.
pub(super) const LEAST: Size = Size { width: 80, height: 24 };
/// From this width on details stand beside the list.
const WIDE: u16 = 120;

/// Something that can be clicked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Hit {
    area: Rect,
    target: Target,
}

/// All that can be clicked, what lies on top last.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Hits(Vec<Hit>);

impl Hits {
    /// What is there.
    pub(super) fn at(&self, position: Position) -> Option<Target> {
        self.0.iter().rev().find(|hit| hit.area.contains(position)).map(|hit| hit.target)
    }
}

/// Draws the whole screen.
pub(super) fn draw(state: &State, frame: &mut Frame<'_>) -> Hits {
    let mut canvas = Canvas::new(state, frame);
    let area = canvas.area();
    if !fits(area.as_size()) {
        frame::small(&mut canvas);
        return canvas.hits();
    }
    let places = frame::Places::of(state, area);
    frame::head(&mut canvas, &places);
    match (&state.link, state.screen) {
        (Link::Up | Link::Lost { .. }, Screen::Dashboard) => dashboard::draw(&mut canvas, places.body),
        (Link::Up | Link::Lost { .. }, Screen::Queue) => queue::draw(&mut canvas, places.body),
        (Link::Up | Link::Lost { .. }, Screen::Printer) => printer::draw(&mut canvas, places.body),
        _ => frame::no_server(&mut canvas, places.body),
    }
    frame::foot(&mut canvas, &places);
    overlay::draw(&mut canvas, places.body);
    canvas.hits()
}

/// Whether everything has its place.
pub(super) const fn fits(size: Size) -> bool {
    size.width >= LEAST.width && size.height >= LEAST.height
}

/// Rows of the list of jobs that are seen at once.
pub(super) fn rows_of_list(state: &State) -> usize {
    let body = frame::Places::of(state, Rect::from((Position::ORIGIN, state.size))).body;
    queue::rows(state, body)
}

/// Whether details of the chosen job are seen.
pub(super) const fn shows_details(state: &State) -> bool {
    state.size.width >= WIDE || state.browsing.details
}
