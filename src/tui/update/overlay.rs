//! Keys while something lies over the screen: help, palette, search, a question.

use super::{bed_is, does, hand};
use crate::queue::State as JobState;
use crate::tui::command::{self, Command, Entry};
use crate::tui::form::{About, Ask, Outcome};
use crate::tui::message::Effect;
use crate::tui::state::{Overlay, State};
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

/// Rows of a page of the help.
const PAGE: i16 = 10;

pub(super) fn press(state: &mut State, key: KeyEvent) -> Vec<Effect> {
    match state.overlay.take() {
        Some(Overlay::Help(from)) => help(state, key, from),
        Some(Overlay::Palette(text, at)) => return palette(state, key, text, at),
        Some(Overlay::Search(text)) => search(state, key, text),
        Some(Overlay::Console(text, back)) => return console(state, key, text, back),
        Some(Overlay::Form(mut form)) => match form.press(key) {
            Outcome::Open => state.overlay = Some(Overlay::Form(form)),
            Outcome::Left => {}
            Outcome::Asks(request) => {
                hand::note(state, &request);
                return does::ask(state, request);
            }
        },
        None => {}
    }
    Vec::new()
}

fn help(state: &mut State, key: KeyEvent, from: u16) {
    let by = match key.code {
        KeyCode::Down | KeyCode::Char('j') => 1,
        KeyCode::Up | KeyCode::Char('k') => -1,
        KeyCode::PageDown | KeyCode::Char(' ') => PAGE,
        KeyCode::PageUp => -PAGE,
        KeyCode::Home | KeyCode::Char('g') => i16::MIN,
        KeyCode::End | KeyCode::Char('G') => i16::MAX,
        // Any other key leaves it.
        _ => return,
    };
    // It has no more lines than commands and headings.
    let most = u16::try_from(command::TABLE.len()).unwrap_or(u16::MAX);
    state.overlay = Some(Overlay::Help(from.saturating_add_signed(by).min(most)));
}

/// Commands whose names or words hold a text, those of other screens included.
pub(in crate::tui) fn matching(text: &str) -> Vec<&'static Entry> {
    let text = text.trim().to_lowercase();
    let words: Vec<_> = text.split_whitespace().collect();
    let fits = |entry: &&Entry| {
        let all = format!("{} {}", entry.name, entry.words).to_lowercase();
        words.iter().all(|word| all.contains(word))
    };
    let mut found: Vec<_> = command::TABLE.iter().filter(fits).collect();
    // What is called so comes before what is only told with these words.
    found.sort_by_key(|entry| !entry.name.contains(&text));
    found
}

fn palette(state: &mut State, key: KeyEvent, mut text: String, at: usize) -> Vec<Effect> {
    let last = matching(&text).len().saturating_sub(1);
    let at = match key.code {
        KeyCode::Esc => return Vec::new(),
        KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => return Vec::new(),
        KeyCode::Enter => {
            state.overlay = Some(Overlay::Palette(text, at));
            return choose(state, at);
        }
        KeyCode::Down | KeyCode::Tab => (at + 1).min(last),
        KeyCode::Up | KeyCode::BackTab => at.saturating_sub(1),
        KeyCode::Backspace => {
            text.pop();
            0
        }
        KeyCode::Char(c) => {
            text.push(c);
            0
        }
        _ => at,
    };
    state.overlay = Some(Overlay::Palette(text, at));
    Vec::new()
}

/// Does what a row of the palette says.
pub(super) fn choose(state: &mut State, at: usize) -> Vec<Effect> {
    let Some(Overlay::Palette(text, _)) = state.overlay.take() else { return Vec::new() };
    let Some(entry) = matching(&text).get(at).copied() else {
        state.overlay = Some(Overlay::Palette(text, 0));
        return Vec::new();
    };
    if !entry.scope.contains(&state.screen) {
        state.screen = entry.scope[0];
    }
    does::it(state, entry.command)
}

fn search(state: &mut State, key: KeyEvent, mut text: String) {
    match key.code {
        KeyCode::Esc => return,
        KeyCode::Enter => {
            state.browsing.sought = text;
            return does::find(state, 1, true);
        }
        KeyCode::Backspace => drop(text.pop()),
        KeyCode::Char(c) if !key.modifiers.contains(KeyModifiers::CONTROL) => text.push(c),
        KeyCode::Char(_) => return,
        _ => {}
    }
    state.overlay = Some(Overlay::Search(text));
}

/// Takes a question back whose answer has come from elsewhere.
pub(super) fn look_again(state: &mut State) {
    let Some(Overlay::Form(form)) = &state.overlay else { return };
    let is_past = match &form.about {
        About::ClearBed(printer, on_bed) => !bed_is(state, printer, *on_bed),
        About::DoubtBed(_) => false,
        About::Heat(_) | About::Extrude(_) => does::why_not(state, Command::Heat).is_some(),
        About::Job(id, saw, ask) => state.job(*id).is_none_or(|job| match ask {
            Ask::Cancel | Ask::Copies(_) | Ask::Priority(_) => job.state.is_over(),
            Ask::Retry => !matches!(job.state, JobState::Failed | JobState::Cancelled),
            Ask::SignOff => job.state != *saw,
        }),
    };
    if is_past {
        state.overlay = None;
        state.say("that was done meanwhile by somebody else, or is past: nothing was asked", true);
    }
}

/// Opens the palette.
pub(super) fn open_palette(state: &mut State) {
    state.overlay = Some(Overlay::Palette(String::new(), 0));
}

/// A line of G-code that is written; Up and Down go through those that were sent.
fn console(state: &mut State, key: KeyEvent, mut text: String, mut back: usize) -> Vec<Effect> {
    match key.code {
        KeyCode::Esc => return Vec::new(),
        KeyCode::Enter if text.trim().is_empty() => return Vec::new(),
        KeyCode::Enter => {
            // It stays open for the next line.
            state.overlay = Some(Overlay::Console(String::new(), 0));
            return does::command_lines(state, vec![text.trim().to_owned()]);
        }
        KeyCode::Up | KeyCode::Down => {
            let earlier: Vec<_> =
                state.by_hand.sent.iter().flat_map(|sent| sent.lines.iter().rev()).collect();
            let by = if key.code == KeyCode::Up { 1 } else { -1 };
            back = back.saturating_add_signed(by).min(earlier.len());
            text = back.checked_sub(1).and_then(|n| earlier.get(n)).map(|s| (*s).clone()).unwrap_or_default();
        }
        KeyCode::Backspace => drop(text.pop()),
        KeyCode::Char(c) if c.is_ascii_graphic() || c == ' ' => text.push(c),
        _ => {}
    }
    state.overlay = Some(Overlay::Console(text, back));
    Vec::new()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_palette_finds_names_first_and_words_then() {
        assert_eq!(matching("").len(), command::TABLE.len());
        assert_eq!(matching("bed is")[0].command, Command::ClearBed);
        assert_eq!(matching("heaters off")[0].command, Command::HeatersOff);
        assert_eq!(matching("heaters off").len(), 3);
        assert!(matching("pay rise").is_empty());
    }
}
