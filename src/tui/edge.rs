//! The terminal, and everything that happens to it (IO). It is put back on every way out: the end, an error, a panic of any thread, a signal.

use super::link::{Follower, Starter, perform};
use super::message::{Effect, Message};
use super::state::{Beginning, State};
use super::theme::Theme;
use super::view::Hits;
use super::{update, view};
use crate::appliance::place::Layout;
use crate::client::Client;
use jiff::Timestamp;
use jiff::tz::TimeZone;
use ratatui::Terminal;
use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::cursor::{Hide, Show};
use ratatui::crossterm::event::{
    self, DisableMouseCapture, EnableMouseCapture, Event, KeyEventKind, MouseButton, MouseEvent,
    MouseEventKind,
};
use ratatui::crossterm::terminal::{
    EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode,
};
use ratatui::crossterm::{execute, terminal};
use ratatui::layout::{Position, Size};
use std::io::{self, BufWriter, IsTerminal, Stdout, stdin, stdout};
use std::panic;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep_until};

/// Between two pictures.
const FRAME: Duration = Duration::from_millis(33);
/// How often the clock is looked at where nothing happens.
const TICK: Duration = Duration::from_secs(1);
/// How long the keyboard is waited for before it is looked whether that is still wanted.
const LISTEN: Duration = Duration::from_millis(100);
/// Messages that may wait.
const MOST_WAITING: usize = 1024;
/// Rows that one step of the wheel is worth.
const WHEEL: i32 = 3;

/// Whether the terminal is as this program needs it.
static IS_OURS: AtomicBool = AtomicBool::new(false);
/// Whether a thread has panicked: the screen ends then, whichever it was.
static HAS_PANICKED: AtomicBool = AtomicBool::new(false);

/// Why there is no screen, or no more.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// It has to be one.
    #[error(
        "stdin and stdout have to be a terminal for `lumenfab tui`; for programs there is `lumenfab queue --json`"
    )]
    NoTerminal,
    /// It does not do what it should.
    #[error("the terminal: {0}")]
    Terminal(#[from] io::Error),
    /// A fault of the program; what it was is said already.
    #[error("the screen ended by a fault of lumenfab; server and prints go on")]
    Panicked,
}

impl Error {
    /// A stable name for programs.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::NoTerminal => "tui.no_terminal",
            Self::Terminal(_) => "tui.terminal",
            Self::Panicked => "tui.panicked",
        }
    }

    /// Of the process.
    #[must_use]
    pub const fn exit_code(&self) -> u8 {
        match self {
            Self::NoTerminal => 2,
            Self::Terminal(_) | Self::Panicked => 1,
        }
    }
}

/// What it is started with.
#[derive(Debug, Clone)]
pub struct Options {
    /// The server's state directory.
    pub dir: PathBuf,
    /// This program, should a server be started.
    pub program: PathBuf,
    /// How it looks at first.
    pub theme: Theme,
}

/// Shows the screen until it is left.
///
/// # Errors
/// [`Error`]; the terminal is as it was before.
pub fn run(options: Options) -> Result<(), Error> {
    if !stdin().is_terminal() || !stdout().is_terminal() {
        return Err(Error::NoTerminal);
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    restore_on_panic();
    let screen = Screen::open()?;
    let shown = runtime.block_on(show(screen, options));
    // A task that still waits for the server is not waited for.
    runtime.shutdown_background();
    shown
}

/// The terminal, ours as long as this lives.
struct Screen(Terminal<CrosstermBackend<BufWriter<Stdout>>>);

impl Screen {
    fn open() -> io::Result<Self> {
        enable_raw_mode()?;
        IS_OURS.store(true, Ordering::SeqCst);
        execute!(stdout(), EnterAlternateScreen, EnableMouseCapture, Hide).inspect_err(|_| restore())?;
        // One picture, one write.
        let writer = BufWriter::with_capacity(1 << 16, stdout());
        Terminal::new(CrosstermBackend::new(writer)).map(Self).inspect_err(|_| restore())
    }

    fn draw(&mut self, state: &State) -> io::Result<Hits> {
        let mut hits = Hits::default();
        self.0.draw(|frame| hits = view::draw(state, frame))?;
        Ok(hits)
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        restore();
    }
}

/// Puts the terminal back, once. One that is gone needs nothing.
fn restore() {
    if IS_OURS.swap(false, Ordering::SeqCst) {
        execute!(stdout(), DisableMouseCapture, LeaveAlternateScreen, Show).ok();
        disable_raw_mode().ok();
    }
}

fn restore_on_panic() {
    let before = panic::take_hook();
    panic::set_hook(Box::new(move |info| {
        restore();
        HAS_PANICKED.store(true, Ordering::SeqCst);
        before(info);
    }));
}

/// Something that wakes the screen.
enum Woken {
    By(Message),
    Clicked(Position),
    /// Asked to end.
    End,
}

async fn show(mut screen: Screen, options: Options) -> Result<(), Error> {
    let Options { dir, program, theme } = options;
    let client = Client::over_socket(Layout::of(&dir).socket());
    let (width, height) = terminal::size()?;
    let mut state = State::new(Beginning {
        now: Timestamp::now(),
        zone: TimeZone::system(),
        size: Size { width, height },
        theme,
        place: dir.display().to_string(),
    });
    let mut hits = screen.draw(&state)?;
    let (wakes, mut woken) = mpsc::channel(MOST_WAITING);
    let (messages, mut heard) = mpsc::channel(MOST_WAITING);
    let _keyboard = Keyboard::listen(wakes.clone())?;
    let signals = tokio::spawn(heed_signals(wakes));
    let outside =
        Outside { client: client.clone(), starter: Starter { program, dir }, messages: messages.clone() };
    let follower = tokio::spawn(Follower { client, messages }.run());
    let mut tick = interval(TICK);
    tick.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut is_left = false;
    while !is_left {
        let mut next = tokio::select! {
            Some(woken) = woken.recv() => Some(woken),
            Some(message) = heard.recv() => Some(Woken::By(message)),
            _ = tick.tick() => Some(Woken::By(Message::Tick(Timestamp::now()))),
        };
        update::update(&mut state, Message::Tick(Timestamp::now()));
        while let Some(woken_by) = next {
            is_left |= take(&mut state, &hits, woken_by, &outside);
            next = woken.try_recv().ok().or_else(|| Some(Woken::By(heard.try_recv().ok()?)));
        }
        if HAS_PANICKED.load(Ordering::SeqCst) {
            return Err(Error::Panicked);
        }
        let drawn = Instant::now();
        hits = screen.draw(&state)?;
        sleep_until(drawn + FRAME).await;
    }
    signals.abort();
    follower.abort();
    Ok(())
}

/// Whatever is done outside.
struct Outside {
    client: Client,
    starter: Starter,
    messages: mpsc::Sender<Message>,
}

/// Whether it is left.
fn take(state: &mut State, hits: &Hits, woken: Woken, outside: &Outside) -> bool {
    let message = match woken {
        Woken::By(message) => message,
        Woken::Clicked(at) => match hits.at(at) {
            Some(target) => Message::Click(target),
            None => return false,
        },
        Woken::End => return true,
    };
    let effects = update::update(state, message);
    effects.into_iter().any(|effect| match effect {
        Effect::Quit => true,
        Effect::Ask(request) => {
            let Outside { client, starter, messages } = outside;
            let (client, starter, messages) = (client.clone(), starter.clone(), messages.clone());
            tokio::spawn(async move {
                let answer = perform(&client, &starter, &request).await;
                // Whoever asked may have left.
                messages.send(Message::Answered(request, answer)).await.ok();
            });
            false
        }
    })
}

async fn heed_signals(wakes: mpsc::Sender<Woken>) -> io::Result<()> {
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut hangup = signal(SignalKind::hangup())?;
    tokio::select! {
        _ = terminate.recv() => {}
        _ = interrupt.recv() => {}
        _ = hangup.recv() => {}
    }
    wakes.send(Woken::End).await.ok();
    Ok(())
}

/// Keys and mouse are listened to as long as this lives.
struct Keyboard(Arc<AtomicBool>);

impl Keyboard {
    fn listen(wakes: mpsc::Sender<Woken>) -> io::Result<Self> {
        let is_over = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&is_over);
        let listen = move || {
            while !ends.load(Ordering::Relaxed) {
                match event::poll(LISTEN).and_then(|is_there| is_there.then(event::read).transpose()) {
                    Ok(None) => {}
                    Ok(Some(event)) => {
                        if let Some(woken) = meant(event)
                            && wakes.blocking_send(woken).is_err()
                        {
                            return;
                        }
                    }
                    // The terminal is gone.
                    Err(_) => return drop(wakes.blocking_send(Woken::End)),
                }
            }
        };
        thread::Builder::new().name("keyboard".into()).spawn(listen)?;
        Ok(Self(is_over))
    }
}

impl Drop for Keyboard {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// What matters of an event: that the mouse moves does not.
fn meant(event: Event) -> Option<Woken> {
    Some(Woken::By(match event {
        Event::Key(key) if key.kind != KeyEventKind::Release => Message::Key(key),
        Event::Resize(width, height) => Message::Resize(Size { width, height }),
        Event::Mouse(MouseEvent { kind, column, row, .. }) => match kind {
            MouseEventKind::Down(MouseButton::Left) => {
                return Some(Woken::Clicked(Position { x: column, y: row }));
            }
            MouseEventKind::ScrollDown => Message::Scroll(WHEEL),
            MouseEventKind::ScrollUp => Message::Scroll(-WHEEL),
            _ => return None,
        },
        _ => return None,
    }))
}
