//! What the operator asks for while a print runs, on its way from a face to the driver.

use std::collections::VecDeque;
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
pub struct Controls(Arc<Mutex<VecDeque<Control>>>);

impl Controls {
    /// Asks for something. Beyond sixteen that wait nothing is taken, but an emergency stop always is, and goes first.
    pub fn ask(&self, control: Control) {
        let mut waiting = self.0.lock().unwrap_or_else(PoisonError::into_inner);
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
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
    }

    /// What was asked for before a print began is not meant for it.
    pub fn clear(&self) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_emergency_stop_goes_before_all_that_waits() {
        let controls = Controls::default();
        (0..40).for_each(|_| controls.clone().ask(Control::Pause));
        controls.ask(Control::EmergencyStop);
        assert_eq!(controls.take(), Some(Control::EmergencyStop));
        assert_eq!(std::iter::from_fn(|| controls.take()).count(), MAX_WAITING - 1);
    }
}
