//! Temperatures of the last minutes, for the chart.

use crate::http::wire::{Activity, Heat, Live};
use crate::queue::Name;
use jiff::{SignedDuration, Timestamp};
use std::collections::{BTreeMap, VecDeque};

/// How far back, s.
pub(super) const SPAN_S: f64 = 600.0;
const SPAN: SignedDuration = SignedDuration::from_mins(10);
/// Between two of them.
const APART: SignedDuration = SignedDuration::from_secs(1);

/// What was measured at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Sample {
    at: Timestamp,
    hotend: Option<Heat>,
    bed: Option<Heat>,
}

/// Of each printer.
#[derive(Debug, Clone, Default)]
pub(super) struct Heats(BTreeMap<Name, VecDeque<Sample>>);

/// Which heater.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Heater {
    Hotend,
    Bed,
}

impl Heats {
    /// Takes what a printer tells now. A clock that was set back begins anew.
    pub(super) fn take(&mut self, live: &Live, now: Timestamp) {
        let samples = self.0.entry(live.name.clone()).or_default();
        if samples.back().is_some_and(|last| last.at > now) {
            samples.clear();
        }
        let is_soon = samples.back().is_some_and(|last| now.duration_since(last.at) < APART);
        if is_soon || !is_heard(live) || (live.hotend.is_none() && live.bed.is_none()) {
            return;
        }
        samples.push_back(Sample { at: now, hotend: live.hotend, bed: live.bed });
        while samples.front().is_some_and(|first| now.duration_since(first.at) > SPAN) {
            samples.pop_front();
        }
    }

    /// Points of a chart: seconds before `now`, negative; °C measured.
    pub(super) fn points(&self, printer: &Name, heater: Heater, now: Timestamp) -> Vec<(f64, f64)> {
        let samples = self.0.get(printer).into_iter().flatten();
        let point = |sample: &Sample| {
            let heat = match heater {
                Heater::Hotend => sample.hotend,
                Heater::Bed => sample.bed,
            };
            Some((sample.at.duration_since(now).as_secs_f64(), heat?.actual_c))
        };
        samples.filter_map(point).filter(|(at_s, _)| *at_s >= -SPAN_S).collect()
    }
}

/// Whether somebody speaks with the printer, so that its temperatures are those of now.
pub(super) const fn is_heard(live: &Live) -> bool {
    match live.activity {
        Activity::Printing | Activity::Pausing | Activity::Paused | Activity::Cancelling => true,
        Activity::Offline | Activity::Idle | Activity::Faulted => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_minutes_are_kept_one_a_second() {
        let name = Name::try_new("a").unwrap();
        let heat = Some(Heat { actual_c: 200.0, target_c: 210.0 });
        let live = Live { activity: Activity::Printing, hotend: heat, ..Live::offline(name.clone()) };
        let mut heats = Heats::default();
        let at = |ms: i64| Timestamp::from_millisecond(ms).unwrap();
        (0..2000).for_each(|n| heats.take(&live, at(n * 500)));
        let points = heats.points(&name, Heater::Hotend, at(999_500));
        assert_eq!((points.len(), points[0], points[599]), (600, (-599.5, 200.0), (-0.5, 200.0)));
        assert_eq!(heats.points(&name, Heater::Bed, at(999_500)), []);
        heats.take(&live, at(0));
        assert_eq!(heats.points(&name, Heater::Hotend, at(0)).len(), 1, "the clock was set back");
    }
}
