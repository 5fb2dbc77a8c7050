//! What the operator asks for while a print runs, on its way from a face to the driver.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// More than this at once is a key that is stuck.
const MAX_WAITING: usize = 16;

/// Something that the operator asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Control {
    /// No more lines, heaters on, the nozzle away from the part.
    Pause,
    /// Go on; also where the printer waits for its user.
    GoOn,
    /// Give the print up: moves end, heaters off.
    Stop,
    /// Stop everything at once; the printer needs a reset afterwards (M112).
    EmergencyStop,
    /// The answer to the printer's question: one of its buttons, counted from 0.
    Answer(usize),
}

/// Wishes on their way: the faces put them in, the driver takes them out. Clones are the same.
#[derive(Debug, Clone, Default)]
pub struct Controls(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    waiting: Mutex<VecDeque<Control>>,
    is_heard: AtomicBool,
    is_laying_held: AtomicBool,
}

/// Wishes are heard as long as this lives.
#[derive(Debug)]
pub struct Hearing(Controls);

impl Drop for Hearing {
    fn drop(&mut self) {
        self.0.0.is_heard.store(false, Ordering::Relaxed);
    }
}

impl Controls {
    /// Asks for something. Beyond sixteen that wait nothing is taken, but an emergency stop always is, and goes first.
    pub fn ask(&self, control: Control) {
        let mut waiting = self.0.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        if control == Control::EmergencyStop {
            waiting.push_front(control);
        } else if waiting.len() < MAX_WAITING {
            waiting.push_back(control);
        }
        waiting.truncate(MAX_WAITING);
    }

    /// What was asked for first.
    #[must_use]
    pub fn take(&self) -> Option<Control> {
        self.0.waiting.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
    }

    /// The next print stops before the first line that may lay material, and tells so, until [`Self::let_lay`]. A print that is gone
    /// on with has laid some already, and does not.
    pub fn hold_laying(&self) {
        self.0.is_laying_held.store(true, Ordering::Release);
    }

    /// Material may be laid.
    pub fn let_lay(&self) {
        self.0.is_laying_held.store(false, Ordering::Release);
    }

    /// Whether no material may be laid yet.
    #[must_use]
    pub fn is_laying_held(&self) -> bool {
        self.0.is_laying_held.load(Ordering::Acquire)
    }

    /// A print begins: what was asked for before is not meant for it.
    #[must_use]
    pub fn hear(&self) -> Hearing {
        self.0.waiting.lock().unwrap_or_else(PoisonError::into_inner).clear();
        self.0.is_heard.store(true, Ordering::Relaxed);
        Hearing(self.clone())
    }

    /// Whether a print is under way: a printer may be hot.
    #[must_use]
    pub fn are_heard(&self) -> bool {
        self.0.is_heard.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wishes_are_heard_while_a_print_is_under_way() {
        let controls = Controls::default();
        controls.ask(Control::Stop);
        let hearing = controls.hear();
        assert_eq!((controls.take(), controls.clone().are_heard()), (None, true));
        drop(hearing);
        assert!(!controls.are_heard());
    }

    #[test]
    fn an_emergency_stop_goes_before_all_that_waits() {
        let controls = Controls::default();
        (0..40).for_each(|_| controls.clone().ask(Control::Pause));
        controls.ask(Control::EmergencyStop);
        assert_eq!(controls.take(), Some(Control::EmergencyStop));
        assert_eq!(std::iter::from_fn(|| controls.take()).count(), MAX_WAITING - 1);
    }
}
