//! Giving up: heaters off, said again and again until the firmware itself tells that they are.
//!
//! What is sent may be lost, stand behind a wait, or meet a firmware that is just booting. So the profile's `safe` script goes out
//! unnumbered, the temperatures are asked for, and that is repeated until the answer has come twice that all targets are 0 (the
//! first may have been on its way before), or the firmware has said that it has stopped for good, or for at most
//! [`MAX_TRIES`] seconds. A firmware that answers, and is still heating then, is stopped for good (M112).

use super::{Acknowledgement, Core, Event, Fault, Reply, State, Temperatures, Timer};
use crate::printer::policy::{self, Action, Trouble};
use crate::profile::Dialect;
use std::fmt;
use std::time::Duration;

/// Between two attempts.
const RETRY: Duration = Duration::from_secs(1);

/// Attempts in all.
const MAX_TRIES: u32 = 8;

/// Attempts where nothing else is to be done: what is under way may take a while.
const PATIENT_TRIES: u32 = 30;

/// Attempts where nothing was ever heard, or where the firmware has said itself that it has stopped.
const FEW_TRIES: u32 = 3;

/// Answers of targets 0 that prove it.
const PROOF: u32 = 2;

/// What is known of the heaters where a print was given up.
#[derive(Debug, Clone, PartialEq)]
pub enum Heat {
    /// The firmware tells that their targets are 0.
    Off(Temperatures),
    /// It has executed heaters-off, line by line, and named the last of these lines.
    Obeyed,
    /// It has said that it has stopped for good, and switches them off then.
    Halted,
    /// It tells that they are on.
    On(Temperatures),
    /// Nothing that it says tells; what was heard last.
    Unknown(Option<Temperatures>),
}

impl Default for Heat {
    fn default() -> Self {
        Self::Unknown(None)
    }
}

impl Heat {
    /// What temperatures tell by themselves.
    #[must_use]
    pub fn told(temperatures: Temperatures) -> Self {
        match temperatures.are_off() {
            Some(true) => Self::Off(temperatures),
            Some(false) => Self::On(temperatures),
            None if temperatures.hotend.is_none() && temperatures.bed.is_none() => Self::Unknown(None),
            None => Self::Unknown(Some(temperatures)),
        }
    }

    /// Whether they are known to be on.
    #[must_use]
    pub const fn is_on(&self) -> bool {
        matches!(self, Self::On(_))
    }

    /// Whether nobody has to see to it.
    #[must_use]
    pub const fn is_safe(&self) -> bool {
        matches!(self, Self::Off(_) | Self::Obeyed | Self::Halted)
    }
}

impl fmt::Display for Heat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Off(told) => write!(f, "the heaters are off, and the printer says so ({told})"),
            Self::Obeyed => write!(f, "the printer has executed heaters-off"),
            Self::Halted => write!(f, "a printer that has stopped switches its heaters off by itself"),
            Self::On(told) => write!(f, "the heaters are on ({told})"),
            Self::Unknown(Some(told)) => {
                write!(f, "whether the heaters are off was not confirmed ({told} when last heard)")
            }
            Self::Unknown(None) => write!(f, "whether the heaters are off was not confirmed"),
        }
    }
}

/// Heaters-off under way.
#[derive(Debug, Clone, Default)]
pub(super) struct Securing {
    n_tries: u32,
    n_off: u32,
    told: Option<Temperatures>,
    is_halted: bool,
    stops: bool,
    is_over: bool,
}

impl Core {
    /// Gives the job up, as the table says.
    pub(super) fn fail(&mut self, fault: Fault) {
        if matches!(self.state, State::Faulted(_)) {
            return;
        }
        let action = policy::action(self.state.phase(), Trouble::of(&fault));
        self.give_up_by(action, fault);
    }

    /// Gives up for a reason that the owner has found; heaters-off follows as for any fault.
    pub fn give_up(&mut self, now: super::Instant, fault: Fault) {
        self.now = now;
        if !matches!(self.state, State::Faulted(_)) {
            self.give_up_by(Action::GiveUp, fault);
        }
    }

    fn give_up_by(&mut self, action: Action, fault: Fault) {
        self.events.push_back(Event::Faulted(fault.clone()));
        let (waits, is_halted) = (self.wire.oldest_waits_for_heat(), matches!(fault, Fault::Halted { .. }));
        self.state = State::Faulted(fault);
        let stops = action == Action::StopAtOnce;
        if stops || action == Action::GiveUp {
            self.switch_off(Securing { is_halted, stops, ..Securing::default() }, waits);
        } else {
            self.urgent.clear();
            self.timers.stop_all();
            self.securing = Securing { is_over: true, ..Securing::default() };
            self.events.push_back(Event::Secured(Heat::default()));
        }
    }

    /// Switches the heaters off without a fault: [`super::Command::HeatersOff`].
    pub(super) fn secure(&mut self) {
        self.state = State::SwitchingOff;
        self.switch_off(Securing::default(), true);
    }

    fn switch_off(&mut self, securing: Securing, ends_waits: bool) {
        self.urgent.clear();
        self.timers.stop_all();
        self.securing = securing;
        self.say_off(ends_waits);
        self.say_off_again();
        self.urgent.push_back("M105\n".to_owned());
        self.timers.set(Timer::Secure, self.now + RETRY);
    }

    /// The line feed ends whatever half line the firmware may hold.
    fn say_off(&mut self, ends_waits: bool) {
        self.urgent.push_back("\n".to_owned());
        if self.securing.stops && !self.securing.is_halted {
            self.urgent.push_back("M112\n".to_owned());
        }
        if ends_waits {
            // Else heaters-off stands behind a wait that may never end.
            self.urgent.push_back("M108\n".to_owned());
        }
        self.say_off_again();
    }

    fn say_off_again(&mut self) {
        self.urgent.extend(self.config.safe.iter().map(|line| format!("{line}\n")));
    }

    /// The time for an answer is over.
    pub(super) fn secure_timeout(&mut self) {
        self.securing.n_tries += 1;
        let max_tries = match &self.state {
            State::Faulted(Fault::NoAnswer { .. } | Fault::Echo) => FEW_TRIES,
            _ if self.securing.is_halted => FEW_TRIES,
            State::SwitchingOff => PATIENT_TRIES,
            _ => MAX_TRIES,
        };
        if self.securing.n_tries >= max_tries {
            self.secured();
            return;
        }
        self.say_off(true);
        self.urgent.push_back("M105\n".to_owned());
        self.timers.set(Timer::Secure, self.now + RETRY);
    }

    pub(super) fn securing_reply(&mut self, reply: Reply<'_>, line: &str) {
        match reply {
            Reply::Halted(_) => self.securing.is_halted = true,
            // Repetier obeys by starting anew; the next word would stop it again before it can say anything.
            Reply::Start => self.securing.stops = false,
            // What comes unasked for may tell of before; Repetier's answer has no other form.
            Reply::Temperatures(told) => {
                let is_answer = self.config.firmware.dialect == Dialect::Repetier;
                self.heat_told(told, is_answer);
            }
            Reply::Ok(Acknowledgement { temperatures: Some(told), .. }) => self.heat_told(told, true),
            _ => {}
        }
        self.events.push_back(Event::Message(line.to_owned()));
        if self.securing.stops && self.securing.is_halted {
            self.secured();
        }
    }

    fn heat_told(&mut self, told: Temperatures, is_answer: bool) {
        self.events.push_back(Event::Temperatures(told));
        self.securing.told = Some(told);
        if self.securing.is_over || !is_answer {
            return;
        }
        self.securing.n_off = if told.are_off() == Some(true) { self.securing.n_off + 1 } else { 0 };
        match self.securing.n_off {
            0 => {}
            // The first may have been on its way before.
            n if n < PROOF => self.urgent.push_back("M105\n".to_owned()),
            _ => self.secured(),
        }
    }

    fn secured(&mut self) {
        if self.securing.is_over {
            return;
        }
        self.securing.is_over = true;
        self.timers.stop_all();
        let Securing { n_off, told, is_halted, .. } = self.securing;
        let heat = match told {
            Some(told) if n_off >= PROOF => Heat::Off(told),
            _ if is_halted => Heat::Halted,
            Some(told) => match Heat::told(told) {
                // One answer is none.
                Heat::Off(told) => Heat::Unknown(Some(told)),
                heat => heat,
            },
            None => Heat::default(),
        };
        if matches!(heat, Heat::On(_)) {
            self.urgent.push_back("\nM112\n".to_owned());
        }
        self.events.push_back(Event::Secured(heat));
    }

    /// Nobody is there any more to be told.
    pub(super) fn secure_lost(&mut self) {
        if matches!(self.state, State::Faulted(_) | State::SwitchingOff) {
            self.securing.n_off = 0;
            self.secured();
        }
    }

    /// The operator wants it to stop at once. While heaters-off is under way already, the word goes before the rest.
    pub(super) fn stop_at_once(&mut self) {
        if matches!(self.state, State::Faulted(_) | State::SwitchingOff) {
            self.securing.stops = true;
            self.urgent.push_front("\nM112\n".to_owned());
        } else {
            self.fail(Fault::EmergencyStop);
        }
    }
}
