//! What happens next, and when: simulated time goes from event to event.

use super::{Life, Pace, Printer, Wait};
use crate::thermal::Heater;

/// Above this, what the wire waits for is a delay that the host is to notice, s.
const NOTICEABLE_S: f64 = 0.25;

/// What happens next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Due {
    BlockEnd,
    Wire,
    Wait,
    Fault,
    Check,
    Report,
    Busy,
    /// A time-out of an idle firmware.
    Idle,
    /// Repetier's words when nothing comes.
    Nag,
    BlockStart,
}

impl Printer {
    /// Whether time has to pass.
    #[must_use]
    pub fn pace(&self) -> Pace {
        let outage = [self.silent_until_s, self.unplugged_until_s, self.boots_s];
        if outage.iter().any(|&until| until > self.now_s && until.is_finite()) {
            return Pace::RealTime;
        }
        let wire_s = self.wire_s();
        let late = wire_s.is_some_and(|t| t - self.now_s > NOTICEABLE_S);
        match self.wait {
            _ if self.is_silent() => Pace::Idle,
            Some(Wait::User { .. }) => Pace::RealTime,
            Some(_) => Pace::Work,
            None if late => Pace::RealTime,
            None if wire_s.is_some() => Pace::Work,
            None => Pace::Idle,
        }
    }

    /// Lets time pass to the next event and deals with it; false if there is none.
    pub fn step(&mut self) -> bool {
        let Some((t_s, due)) = self.next_due() else { return false };
        self.now_s = self.now_s.max(t_s);
        self.deal_with(due);
        true
    }

    /// Lets time pass to `t_s`.
    pub fn advance_to(&mut self, t_s: f64) {
        while let Some((event_s, due)) = self.next_due() {
            // A move that starts only now may still be followed by one that is received now.
            if event_s > t_s || (event_s >= t_s && due == Due::BlockStart) {
                break;
            }
            self.now_s = self.now_s.max(event_s);
            self.deal_with(due);
        }
        self.now_s = self.now_s.max(t_s);
        self.settle();
    }

    /// When the next event comes, where one does without anything received.
    #[must_use]
    pub fn next_event_s(&self) -> Option<f64> {
        self.next_due().map(|due| due.0)
    }

    /// When the wire has something to deliver. What the full ring holds back is nothing to wait for.
    pub(super) fn wire_s(&self) -> Option<f64> {
        let incoming = self.incoming.next_s().filter(|&t| t > self.now_s);
        [incoming, self.outgoing.next_s()].into_iter().flatten().min_by(f64::total_cmp)
    }

    pub(super) fn next_due(&self) -> Option<(f64, Due)> {
        let alive = self.life == Life::Running && !self.is_silent();
        let timers = [
            (self.planner.next_end_s(), Due::BlockEnd),
            (self.wire_s(), Due::Wire),
            (self.wait_s().filter(|_| alive), Due::Wait),
            (self.fault_s(), Due::Fault),
            (
                Some(self.next_check_s).filter(|_| alive && self.heaters.iter().any(Heater::is_guarded)),
                Due::Check,
            ),
            (Some(self.next_report_s).filter(|_| alive && self.report_interval_s > 0.0), Due::Report),
            (
                Some(self.next_busy_s).filter(|_| alive && self.wait.is_some() && self.keepalive_s > 0.0),
                Due::Busy,
            ),
            (self.planner.next_start_s(), Due::BlockStart),
        ];
        timers
            .into_iter()
            .filter_map(|(time, due)| Some((time?, due)))
            .chain(self.quiet_due())
            .reduce(|first, other| if other.0 < first.0 { other } else { first })
    }

    /// When what the command waits for comes by itself.
    pub(super) fn wait_s(&self) -> Option<f64> {
        match self.wait.as_ref()? {
            Wait::Until { t_s, .. } => Some(*t_s),
            Wait::Heat(heat) => Some(heat.next_tick_s),
            Wait::User { until_s } => {
                let cold_s = self.change.map_or(f64::INFINITY, |change| change.cold_s);
                Some(until_s.min(cold_s)).filter(|t| t.is_finite())
            }
            Wait::Moves | Wait::Drain(_) => None,
        }
    }

    pub(super) fn deal_with(&mut self, due: Due) {
        match due {
            Due::BlockEnd => self.finish_block(),
            Due::BlockStart => self.start_block(),
            Due::Wire | Due::Wait => {}
            Due::Fault => {
                self.end_lasting();
                self.strike_machine(false);
            }
            Due::Check => self.check_heaters(),
            Due::Report => {
                self.next_report_s = self.now_s + self.report_interval_s;
                let text = self.temperatures();
                self.say(&text);
            }
            Due::Busy => self.say_busy(),
            Due::Idle => self.idle_ends(),
            Due::Nag => self.nag(),
        }
        self.settle();
    }
}
