//! Every command, once: its keys, its name in the palette, its words in the help. Keys, footer, palette and help follow from
//! [`TABLE`].

use super::state::Screen;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

/// Something that the operator can ask for by one key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Command {
    /// See [`TABLE`]; and so for each.
    Dashboard,
    Queue,
    Printer,
    EmergencyStop,
    Seen,
    NextScreen,
    PreviousScreen,
    NextPrinter,
    PreviousPrinter,
    ClearBed,
    DoubtBed,
    SignOff,
    Pause,
    GoOn,
    CancelPrint,
    Start,
    Up,
    Down,
    PageUp,
    PageDown,
    First,
    Last,
    Details,
    Submit,
    Hold,
    Release,
    MoveUp,
    MoveDown,
    MoveFirst,
    MoveLast,
    Copies,
    Priority,
    Cancel,
    Retry,
    Over,
    Search,
    NextMatch,
    PreviousMatch,
    Undo,
    Home,
    Left,
    Right,
    Back,
    Forth,
    Raise,
    Lower,
    LongerStep,
    ShorterStep,
    Heat,
    HeatersOff,
    Extrude,
    Console,
    Connect,
    Disconnect,
    Theme,
    Palette,
    Help,
    Quit,
}

/// The screens on which a command means something.
pub(super) type Scope = &'static [Screen];

/// A key.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Key {
    /// A letter or sign; capitals are keys of their own.
    Char(char),
    /// The same with Ctrl.
    Ctrl(char),
    /// Another one.
    Code(KeyCode),
}

impl Key {
    /// Whether it was this one.
    #[must_use]
    pub(super) fn is(self, event: KeyEvent) -> bool {
        let has_ctrl = event.modifiers.intersects(KeyModifiers::CONTROL | KeyModifiers::ALT);
        match self {
            Self::Char(c) => event.code == KeyCode::Char(c) && !has_ctrl,
            Self::Ctrl(c) => {
                event.code == KeyCode::Char(c) && event.modifiers.contains(KeyModifiers::CONTROL)
            }
            Self::Code(code) => event.code == code && !has_ctrl,
        }
    }
}

impl std::fmt::Display for Key {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Char(c) => write!(f, "{c}"),
            Self::Ctrl(c) => write!(f, "Ctrl-{c}"),
            Self::Code(code) => f.write_str(match code {
                KeyCode::Up => "↑",
                KeyCode::Down => "↓",
                KeyCode::Left => "←",
                KeyCode::Right => "→",
                KeyCode::Esc => "Esc",
                KeyCode::PageUp => "PgUp",
                KeyCode::PageDown => "PgDn",
                KeyCode::BackTab => "Shift-Tab",
                KeyCode::Tab => "Tab",
                KeyCode::Home => "Home",
                KeyCode::End => "End",
                KeyCode::Enter => "Enter",
                _ => "?",
            }),
        }
    }
}

/// A command and all that is said of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Entry {
    /// The command.
    pub(super) command: Command,
    /// Where it means something.
    pub(super) scope: Scope,
    /// Its keys, the one to be shown first.
    pub(super) keys: &'static [Key],
    /// A word or two: for footer and palette.
    pub(super) name: &'static str,
    /// What it does: for the help.
    pub(super) words: &'static str,
}

const fn entry(
    scope: Scope,
    command: Command,
    keys: &'static [Key],
    name: &'static str,
    words: &'static str,
) -> Entry {
    Entry { command, scope, keys, name, words }
}

/// Every screen.
pub(super) const ANY: Scope = &Screen::ALL;
const LIST: Scope = &[Screen::Queue];
const PRINTER: Scope = &[Screen::Printer];
const PRINTING: Scope = &[Screen::Dashboard, Screen::Printer];

use Command as C;
use Key::{Char, Code, Ctrl};

/// All commands, in the order in which they are shown.
pub(super) const TABLE: &[Entry] = &[
    entry(
        ANY,
        C::EmergencyStop,
        &[Char('!')],
        "EMERGENCY STOP",
        "Stops the printer at once (M112); it has to be reset then",
    ),
    entry(
        ANY,
        C::Seen,
        &[Code(KeyCode::Esc)],
        "seen",
        "Takes a failed job, or the word on a stop, off the screen",
    ),
    entry(ANY, C::Start, &[Char('S')], "start the server", "Starts a server here, where none runs"),
    entry(
        ANY,
        C::ClearBed,
        &[Char('b')],
        "bed is clear",
        "Says that a bed is clear, once you have looked at it",
    ),
    entry(
        ANY,
        C::SignOff,
        &[Char('s')],
        "sign off",
        "Accepts or rejects the report of a job that is printed",
    ),
    entry(ANY, C::GoOn, &[Char('c')], "go on", "Lets a paused print go on, or one that broke off"),
    entry(ANY, C::Pause, &[Char('p')], "pause", "Pauses the print, heaters on"),
    entry(PRINTING, C::CancelPrint, &[Char('x')], "give up the print", "Stops what is printed, heaters off"),
    entry(
        LIST,
        C::Details,
        &[Code(KeyCode::Enter)],
        "details",
        "Shows or hides all that is known of the job",
    ),
    entry(LIST, C::Submit, &[Char('u')], "submit", "Puts a draft into the queue"),
    entry(LIST, C::Hold, &[Char('h')], "hold", "Keeps the job back"),
    entry(LIST, C::Release, &[Char('r')], "release", "Lets a job go that was kept back"),
    entry(LIST, C::MoveUp, &[Char('K')], "earlier", "Moves the job before the one above, of its priority"),
    entry(LIST, C::MoveDown, &[Char('J')], "later", "Moves the job behind the one below, of its priority"),
    entry(LIST, C::MoveFirst, &[Char('H')], "first", "Moves the job before all others of its priority"),
    entry(LIST, C::MoveLast, &[Char('L')], "last", "Moves the job behind all others of its priority"),
    entry(LIST, C::Copies, &[Char('o')], "copies", "Says how often the job is printed"),
    entry(LIST, C::Priority, &[Char('i')], "priority", "Higher goes first, -128 to 127"),
    entry(LIST, C::Cancel, &[Char('x')], "cancel", "Calls the job off; a print is stopped, heaters off"),
    entry(LIST, C::Retry, &[Char('R')], "retry", "Prints a job again that failed or was called off"),
    entry(LIST, C::Undo, &[Char('z')], "undo", "Takes back the last hold, release, move, copies, priority"),
    entry(LIST, C::Over, &[Char('v')], "over or not", "Shows the jobs that are over, or those that are not"),
    entry(LIST, C::Search, &[Char('/')], "search", "Looks for jobs: name, state, kind, printer, material"),
    entry(LIST, C::NextMatch, &[Char('n')], "next match", "The next job that was looked for"),
    entry(LIST, C::PreviousMatch, &[Char('N')], "previous match", "The one before"),
    entry(LIST, C::Up, &[Char('k'), Code(KeyCode::Up)], "up", "One row up"),
    entry(LIST, C::Down, &[Char('j'), Code(KeyCode::Down)], "down", "One row down"),
    entry(LIST, C::PageUp, &[Code(KeyCode::PageUp), Ctrl('b'), Ctrl('u')], "page up", "One page up"),
    entry(LIST, C::PageDown, &[Code(KeyCode::PageDown), Ctrl('f'), Ctrl('d')], "page down", "One page down"),
    entry(LIST, C::First, &[Char('g'), Code(KeyCode::Home)], "top", "The first row"),
    entry(LIST, C::Last, &[Char('G'), Code(KeyCode::End)], "bottom", "The last row"),
    entry(PRINTER, C::Home, &[Char('H')], "home", "Moves all axes to their ends (G28)"),
    entry(
        PRINTER,
        C::Left,
        &[Char('h'), Code(KeyCode::Left)],
        "X -",
        "Moves the nozzle by a step towards smaller X",
    ),
    entry(PRINTER, C::Right, &[Char('l'), Code(KeyCode::Right)], "X +", "The same towards larger X"),
    entry(PRINTER, C::Forth, &[Char('j'), Code(KeyCode::Down)], "Y -", "The same towards smaller Y"),
    entry(PRINTER, C::Back, &[Char('k'), Code(KeyCode::Up)], "Y +", "The same towards larger Y"),
    entry(
        PRINTER,
        C::Lower,
        &[Char('d'), Code(KeyCode::PageDown)],
        "Z -",
        "Brings the nozzle nearer to the bed by a step",
    ),
    entry(
        PRINTER,
        C::Raise,
        &[Char('u'), Code(KeyCode::PageUp)],
        "Z +",
        "Takes it away from the bed by a step",
    ),
    entry(PRINTER, C::LongerStep, &[Char('+')], "longer step", "0.1, 1, 10, 50 mm"),
    entry(PRINTER, C::ShorterStep, &[Char('-')], "shorter step", "The other way"),
    entry(PRINTER, C::Heat, &[Char('e')], "heat", "Sets nozzle and bed to temperatures, within limits"),
    entry(PRINTER, C::HeatersOff, &[Char('O')], "heaters off", "Sets both to 0"),
    entry(
        PRINTER,
        C::Extrude,
        &[Char('f')],
        "extrude",
        "Heats the nozzle, then moves filament by so many mm",
    ),
    entry(PRINTER, C::Console, &[Char('g')], "G-code", "Sends a line as it is; Up brings earlier ones"),
    entry(PRINTER, C::Connect, &[Char('C')], "connect", "Opens the printer's port, and takes jobs again"),
    entry(
        PRINTER,
        C::Disconnect,
        &[Char('D')],
        "disconnect",
        "Closes the port: nothing is printed until it is open",
    ),
    entry(
        ANY,
        C::DoubtBed,
        &[Char('B')],
        "bed in doubt",
        "Says that a bed may not be clear: nothing starts there",
    ),
    entry(ANY, C::NextPrinter, &[Char(']')], "next printer", "Shows the next printer"),
    entry(ANY, C::PreviousPrinter, &[Char('[')], "previous printer", "Shows the one before"),
    entry(ANY, C::Dashboard, &[Char('1')], "dashboard", "The printer, and what is next"),
    entry(ANY, C::Queue, &[Char('2')], "queue", "All jobs"),
    entry(ANY, C::Printer, &[Char('3')], "printer", "The printer by hand: home, heat, move, extrude, G-code"),
    entry(ANY, C::NextScreen, &[Code(KeyCode::Tab)], "next screen", "The next screen"),
    entry(ANY, C::PreviousScreen, &[Code(KeyCode::BackTab)], "previous screen", "The one before"),
    entry(ANY, C::Theme, &[Char('t')], "theme", "Dark, light, no colour, high contrast"),
    entry(ANY, C::Help, &[Char('?')], "help", "Shows all keys"),
    entry(ANY, C::Palette, &[Char(':')], "commands", "Finds a command by its name"),
    entry(ANY, C::Quit, &[Char('q'), Ctrl('c')], "quit", "Leaves; server and prints go on"),
];

/// All that is said of a command.
#[must_use]
pub(super) fn entry_of(command: Command) -> &'static Entry {
    TABLE.iter().find(|entry| entry.command == command).expect("every command is in the table")
}

/// What a key means on a screen.
#[must_use]
pub(super) fn meant(event: KeyEvent, screen: Screen) -> Option<Command> {
    let is_here = |entry: &&Entry| entry.scope.contains(&screen);
    TABLE.iter().filter(is_here).find(|entry| entry.keys.iter().any(|key| key.is(event))).map(|e| e.command)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn on_every_screen_a_key_means_one_thing() {
        for screen in Screen::ALL {
            let mut seen = Vec::new();
            for entry in TABLE.iter().filter(|e| e.scope.contains(&screen)) {
                for key in entry.keys {
                    assert!(!seen.contains(key), "{screen:?}: {key} is {} too", entry.name);
                    seen.push(*key);
                }
            }
        }
    }

    #[test]
    fn every_command_has_a_key_a_name_and_words() {
        for entry in TABLE {
            assert!(entry.words.chars().count() <= 58, "{}: the help has 80 columns", entry.words);
            assert!(!entry.keys.is_empty() && !entry.name.is_empty() && !entry.words.is_empty());
            assert_eq!(TABLE.iter().filter(|other| other.command == entry.command).count(), 1);
            assert!(entry.keys.iter().all(|key| key.to_string() != "?" || entry.command == C::Help));
        }
    }

    #[test]
    fn ctrl_makes_another_key() {
        let key = |code, modifiers| KeyEvent::new(code, modifiers);
        let queue = |event| meant(event, Screen::Queue);
        assert_eq!(queue(key(KeyCode::Char('b'), KeyModifiers::NONE)), Some(C::ClearBed));
        assert_eq!(queue(key(KeyCode::Char('b'), KeyModifiers::CONTROL)), Some(C::PageUp));
        assert_eq!(queue(key(KeyCode::Char('K'), KeyModifiers::SHIFT)), Some(C::MoveUp));
        assert_eq!(meant(key(KeyCode::Char('h'), KeyModifiers::NONE), Screen::Dashboard), None);
    }
}
