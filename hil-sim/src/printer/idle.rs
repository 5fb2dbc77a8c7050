//! What a firmware does by itself when nothing is asked of it: motors off, heaters off, a kill (M85), `wait`.
//!
//! Times are those of the dialect unless a command set others: M84 S and M18 S for the motors, M85 S for the kill, M86 S for
//! Prusa's safety timer, `SET_IDLE_TIMEOUT` for Klipper's. Motors that are off forget where the axes are: they are not home
//! any more, and X has given way to whatever pulls at it. A command under way that takes its time (heating, dwelling, homing) is no idleness; waiting for the user is, but
//! for Marlin's change of filament (`pause.cpp` waits without sleep; `M0` does not).

use super::{Life, Printer, Wait, clock::Due, life::Cause};
use crate::{
    dialect::{Dialect, Family},
    gcode::Command,
};

/// Repetier asks again for what it waits for after this long without a byte, s.
const NAG_S: f64 = 0.2;
/// It says that it waits this often, s.
const WAIT_S: f64 = 1.0;

/// How far X gives way when its motor lets go by itself, mm.
const SLACK_MM: f64 = 1.0;

/// Time-outs and since when they run, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Idle {
    since_s: f64,
    motors_s: f64,
    heaters_s: f64,
    kill_s: f64,
    motors_off: bool,
    heaters_off: bool,
    /// When the last byte came, or something was said for want of any.
    quiet_since_s: f64,
}

/// Which time-out it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    Motors,
    Heaters,
    Kill,
}

impl Idle {
    pub(super) const fn new(dialect: &Dialect, now_s: f64) -> Self {
        Self {
            since_s: now_s,
            motors_s: dialect.idle.motors_s,
            heaters_s: dialect.idle.heaters_s,
            kill_s: 0.0,
            motors_off: false,
            heaters_off: false,
            quiet_since_s: now_s,
        }
    }

    /// Something was done: all time-outs begin anew.
    pub(super) const fn touch(&mut self, now_s: f64) {
        self.since_s = now_s;
        self.motors_off = false;
        self.heaters_off = false;
    }

    /// Bytes came in.
    pub(super) const fn heard(&mut self, now_s: f64) {
        self.quiet_since_s = now_s;
    }

    fn next(&self) -> Option<(f64, End)> {
        let ends = [
            (self.kill_s, false, End::Kill),
            (self.heaters_s, self.heaters_off, End::Heaters),
            (self.motors_s, self.motors_off, End::Motors),
        ];
        ends.into_iter()
            .filter(|&(after_s, over, _)| after_s > 0.0 && !over)
            .map(|(after_s, _, end)| (self.since_s + after_s, end))
            .reduce(|first, other| if other.0 < first.0 { other } else { first })
    }
}

impl Printer {
    /// When the firmware does something because nothing happens, and what.
    pub(super) fn quiet_due(&self) -> Option<(f64, Due)> {
        if self.life != Life::Running || self.is_silent() {
            return None;
        }
        let idle = self.idle_s().map(|t| (t, Due::Idle));
        let nag = self.nag_s().map(|t| (t, Due::Nag));
        idle.into_iter().chain(nag).reduce(|first, other| if other.0 < first.0 { other } else { first })
    }

    fn idle_s(&self) -> Option<f64> {
        let changes = self.change.is_some() && self.profile.dialect.family == Family::Marlin;
        let at_rest =
            self.planner.depth() == 0 && !changes && matches!(self.wait, None | Some(Wait::User { .. }));
        self.idle.next().filter(|_| at_rest).map(|next| next.0.max(self.now_s))
    }

    /// When Repetier says something because nothing comes.
    fn nag_s(&self) -> Option<f64> {
        let waits = !self.profile.dialect.wait.is_empty() && self.queue.is_empty();
        let after_s = if self.receiver.is_waiting_for_more() { NAG_S } else { WAIT_S };
        waits.then_some(self.idle.quiet_since_s + after_s)
    }

    /// Nothing has come for a while.
    pub(super) fn nag(&mut self) {
        self.idle.quiet_since_s = self.now_s;
        if self.receiver.is_waiting_for_more() {
            self.receiver.drop_line();
            self.request_resend();
        } else {
            self.say(self.profile.dialect.wait);
        }
    }

    /// A time-out is over.
    pub(super) fn idle_ends(&mut self) {
        let Some((_, end)) = self.idle.next() else { return };
        match end {
            End::Motors => {
                self.idle.motors_off = true;
                self.motors_off("idle");
            }
            End::Heaters => {
                self.idle.heaters_off = true;
                self.idle_heaters_off();
            }
            End::Kill if self.profile.dialect.family == Family::Marlin => {
                self.say("Error:!! KILL caused by too much inactive time - current command: ");
                self.kill(Cause::Idle);
            }
            End::Kill => {
                self.idle.kill_s = 0.0;
                self.idle_heaters_off();
                self.motors_off("idle");
            }
        }
    }

    fn idle_heaters_off(&mut self) {
        let rule = self.profile.dialect.idle;
        if self.heaters.iter().any(|heater| heater.target_c > 0.0) {
            self.heaters_off();
            self.state("heaters-off", "idle".to_owned());
            self.say_all(rule.heaters_text);
        }
        if rule.heaters_take_motors {
            self.motors_off("idle");
        }
    }

    /// M18, M84, or a time-out.
    pub(super) fn motors_off(&mut self, why: &str) {
        if why == "idle" && self.motion.homed[0] {
            self.deposit.shift_mm[0] += SLACK_MM;
        }
        self.motion.homed = [false; 3];
        self.state("motors-off", why.to_owned());
    }

    /// M84 S, M85, M86: a time-out in seconds; 0 is none.
    pub(super) fn set_idle(&mut self, code: u32, seconds: f64) {
        let seconds = seconds.max(0.0);
        match code {
            85 => self.idle.kill_s = seconds,
            86 => self.idle.heaters_s = seconds,
            _ => self.idle.motors_s = seconds,
        }
    }

    /// Whether `command` sets a time-out instead of acting.
    pub(super) fn sets_idle(&mut self, command: &Command<'_>) -> bool {
        let Some(seconds) = command.value(b'S') else { return command.code == 85 || command.code == 86 };
        self.set_idle(command.code, seconds);
        true
    }

    /// `SET_IDLE_TIMEOUT TIMEOUT=600`
    pub(super) fn set_idle_timeout(&mut self, text: &[u8]) {
        const KEY: &[u8] = b"TIMEOUT=";
        let at = text.windows(KEY.len()).position(|word| word == KEY);
        if let Some((seconds, _)) = at.and_then(|at| crate::gcode::decimal(&text[at + KEY.len()..])) {
            self.idle.heaters_s = seconds.max(0.0);
            // Klipper looks again so long after this (`idle_timeout.py`).
            self.idle.touch(self.now_s);
            self.say(&format!("// idle_timeout: Timeout set to {seconds:.2} s"));
        }
    }
}
