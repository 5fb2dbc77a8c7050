//! Keys while a print runs: `p` pauses, `c` goes on, `x` twice cancels, `!` stops at once, a digit answers the printer's
//! question.
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
use std::thread;
use std::time::Duration;

/// What the operator is told.
pub(super) const HELP: &str = "keys while it prints: p pause, c go on, x twice cancel for good, ! stop at once, 0 to 9 answer the printer";

/// Between two looks at a terminal that has no key, or is gone: that one answers at once, again and again.
const REST: Duration = Duration::from_millis(100);

/// How the terminal was.
static BEFORE: Mutex<Option<Termios>> = Mutex::new(None);

/// Keys are listened to as long as this lives.
#[derive(Debug)]
pub(super) struct Keys {
    is_over: Arc<AtomicBool>,
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
            let mut keyboard = Keyboard::default();
            while !ends.load(Ordering::Relaxed) {
                let Some(key) = read_key() else {
                    keyboard.idle();
                    continue;
                };
                keyboard.pressed(key).into_iter().for_each(|control| controls.ask(control));
                if keyboard.is_cancelling {
                    super::face::say("x once more within 5 seconds cancels the print for good");
                }
            }
        };
        // Without a thread there is nobody to listen, but still a terminal to put back.
        drop(thread::Builder::new().name("keys".into()).spawn(work));
        Some(Self { is_over })
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        // The thread is not waited for: where the terminal was put back meanwhile, it waits for a whole line.
        self.is_over.store(true, Ordering::Relaxed);
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
        Ok(_) | Err(_) => {
            thread::park_timeout(REST);
            None
        }
    }
}

/// What keys mean, one after the other.
#[derive(Debug, Default)]
struct Keyboard {
    /// Whether the last key was the one that cancels: pressed by mistake, it would cost the print.
    is_cancelling: bool,
    /// Looks since then that found no key.
    n_idle: u32,
}

/// Looks without a key, a tenth of a second each or more, after which a key that cancels stands alone.
const FORGOTTEN: u32 = 50;

impl Keyboard {
    /// No key was pressed.
    const fn idle(&mut self) {
        self.n_idle += 1;
        if self.n_idle >= FORGOTTEN {
            self.is_cancelling = false;
        }
    }

    fn pressed(&mut self, key: u8) -> Option<Control> {
        let is_again = std::mem::take(&mut self.is_cancelling);
        self.n_idle = 0;
        Some(match key {
            b'p' | b'P' => Control::Pause,
            b'c' | b'C' => Control::GoOn,
            b'x' | b'X' if is_again => Control::Stop,
            b'x' | b'X' => {
                self.is_cancelling = true;
                return None;
            }
            b'!' => Control::EmergencyStop,
            b'0'..=b'9' => Control::Answer((key - b'0') as usize),
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(keys: &[u8]) -> Vec<Control> {
        let mut keyboard = Keyboard::default();
        keys.iter().filter_map(|key| keyboard.pressed(*key)).collect()
    }

    #[test]
    fn keys_mean_what_the_help_says() {
        let all = [Control::Pause, Control::GoOn, Control::Stop, Control::EmergencyStop, Control::Answer(7)];
        assert_eq!(asked(b"pcxx!7\n"), all);
    }

    #[test]
    fn one_key_by_mistake_does_not_cancel() {
        assert_eq!(asked(b"x"), []);
        assert_eq!(asked(b"xpx"), [Control::Pause]);
        assert_eq!(asked(b"xxx"), [Control::Stop]);
        let mut keyboard = Keyboard::default();
        keyboard.pressed(b'x');
        (0..FORGOTTEN).for_each(|_| keyboard.idle());
        assert_eq!(keyboard.pressed(b'x'), None, "that was long ago");
        assert_eq!(keyboard.pressed(b'x'), Some(Control::Stop));
    }
}
