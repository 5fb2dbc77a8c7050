//! Keys while a print runs: `p` pauses, `c` goes on, `x` cancels, `!` stops at once, a digit answers the printer's question.
//!
//! Only where stdin is a terminal and this program is in its foreground. The terminal gives each key as it is pressed and shows
//! none; Ctrl-C stays what it is; what would stop or end the program without a word to the printer (Ctrl-Z, Ctrl-\\) does nothing
//! meanwhile. The terminal is put back on every way out: when [`Keys`] is dropped, by the panic hook, and before a second Ctrl-C ends
//! the process ([`restore`]).

use crate::printer::control::{Control, Controls};
use rustix::termios::{
    LocalModes, OptionalActions, SpecialCodeIndex, Termios, tcgetattr, tcgetpgrp, tcsetattr,
};
use std::io::{IsTerminal, stdin};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};

/// What the operator is told.
pub(super) const HELP: &str = "keys: p pause, c go on, x cancel, ! stop at once, 0 to 9 answer the printer";

/// How the terminal was.
static BEFORE: Mutex<Option<Termios>> = Mutex::new(None);

/// Keys are listened to as long as this lives.
#[derive(Debug)]
pub(super) struct Keys {
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Keys {
    /// Listens, where there is a terminal to listen to.
    pub(super) fn listen(controls: &Controls) -> Option<Self> {
        let in_front = tcgetpgrp(stdin()).is_ok_and(|group| group == rustix::process::getpgrp());
        if !stdin().is_terminal() || !in_front {
            return None;
        }
        key_by_key()?;
        let is_over = Arc::new(AtomicBool::new(false));
        let (ends, controls) = (Arc::clone(&is_over), controls.clone());
        let work = move || {
            while !ends.load(Ordering::Relaxed) {
                read_key().and_then(meaning).into_iter().for_each(|control| controls.ask(control));
            }
        };
        let thread = thread::Builder::new().name("keys".into()).spawn(work).ok();
        // Without a thread there is nobody to listen, but still a terminal to put back.
        Some(Self { is_over, thread })
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // It has no word of its own to say.
            thread.join().ok();
        }
        restore();
    }
}

/// Puts the terminal back as it was, if it was changed.
pub(super) fn restore() {
    if let Some(before) = BEFORE.lock().unwrap_or_else(PoisonError::into_inner).take() {
        // A terminal that is gone needs nothing.
        tcsetattr(stdin(), OptionalActions::Now, &before).ok();
    }
}

fn key_by_key() -> Option<()> {
    let before = tcgetattr(stdin()).ok()?;
    let mut now = before.clone();
    now.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
    // A read that waits for a tenth of a second, so that the thread sees when it is over.
    now.special_codes[SpecialCodeIndex::VMIN] = 0;
    now.special_codes[SpecialCodeIndex::VTIME] = 1;
    now.special_codes[SpecialCodeIndex::VSUSP] = 0;
    now.special_codes[SpecialCodeIndex::VQUIT] = 0;
    *BEFORE.lock().unwrap_or_else(PoisonError::into_inner) = Some(before);
    tcsetattr(stdin(), OptionalActions::Now, &now).ok()
}

fn read_key() -> Option<u8> {
    let mut key = [0];
    match rustix::io::read(stdin(), &mut key) {
        Ok(1) => Some(key[0]),
        Ok(_) => None,
        // A terminal that is gone answers at once, again and again.
        Err(_) => {
            thread::park_timeout(std::time::Duration::from_millis(100));
            None
        }
    }
}

const fn meaning(key: u8) -> Option<Control> {
    Some(match key {
        b'p' | b'P' => Control::Pause,
        b'c' | b'C' => Control::GoOn,
        b'x' | b'X' => Control::Stop,
        b'!' => Control::EmergencyStop,
        b'0'..=b'9' => Control::Answer((key - b'0') as usize),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_mean_what_the_help_says() {
        assert_eq!(
            b"pcx!".map(|key| meaning(key).unwrap()),
            [Control::Pause, Control::GoOn, Control::Stop, Control::EmergencyStop]
        );
        assert_eq!(meaning(b'7'), Some(Control::Answer(7)));
        assert_eq!(meaning(b'\n'), None);
    }
}
