//! How things are said: spans of time, clock times, names, what happened.

use crate::http::wire::{Activity, HistoryView, JobView};
use crate::queue::fact::What;
use crate::queue::printer::PrinterChange;
use crate::queue::{JobId, SpecKind, State};
use jiff::tz::TimeZone;
use jiff::{Timestamp, Zoned};

/// Letters of a job's name that are shown: its end, which is chance; the beginning is the time at which it was added.
const SHORT: usize = 8;

/// The end of a job's name, by which the commands know it, too.
pub(super) fn short(id: JobId) -> String {
    let text = id.to_string();
    text[text.len() - SHORT..].to_owned()
}

/// A span of time, s: `43 s`, `7 min`, `2 h 05 min`, `3 d 04 h`.
pub(super) fn span(seconds: u64) -> String {
    let (minutes, hours) = (seconds / 60, seconds / 3600);
    match seconds {
        0..60 => format!("{seconds} s"),
        60..3600 => format!("{minutes} min"),
        3600..86_400 => format!("{hours} h {:02} min", minutes % 60),
        _ => format!("{} d {:02} h", hours / 24, hours % 24),
    }
}

/// From one time to another one, s; 0 where that has passed.
pub(super) fn seconds_to(from: Timestamp, to: Timestamp) -> u64 {
    u64::try_from(to.duration_since(from).as_secs()).unwrap_or(0)
}

/// A time on the clock: `14:05`, `tomorrow 03:10`, `Tue 03:10`, `24 Dec 03:10`.
pub(super) fn clock(at: Timestamp, now: Timestamp, zone: &TimeZone) -> String {
    let (at, now) = (at.to_zoned(zone.clone()), now.to_zoned(zone.clone()));
    match now.date().until(at.date()).map_or(i32::MAX, |span| span.get_days()) {
        1 => at.strftime("tomorrow %H:%M").to_string(),
        -1 => at.strftime("yesterday %H:%M").to_string(),
        days => on_day(&at, days),
    }
}

/// The same in twelve letters at most, for tables.
pub(super) fn short_clock(at: Timestamp, now: Timestamp, zone: &TimeZone) -> String {
    let (at, now) = (at.to_zoned(zone.clone()), now.to_zoned(zone.clone()));
    let days = now.date().until(at.date()).map_or(i32::MAX, |span| span.get_days());
    on_day(&at, days)
}

fn on_day(at: &Zoned, days: i32) -> String {
    at.strftime(match days {
        0 => "%H:%M",
        -6..7 => "%a %H:%M",
        _ => "%-d %b %H:%M",
    })
    .to_string()
}

/// What a printer is doing.
pub(super) const fn activity(activity: Activity) -> &'static str {
    match activity {
        Activity::Offline => "not connected",
        Activity::Idle => "idle",
        Activity::Printing => "printing",
        Activity::Pausing => "about to pause",
        Activity::Paused => "paused",
        Activity::Cancelling => "giving the print up",
        Activity::Faulted => "stopped by a fault",
    }
}

/// What a job is at.
pub(super) const fn state(job: &JobView) -> &'static str {
    match job.state {
        State::Queued if !job.is_prepared => "to be prepared",
        state => state.words(),
    }
}

/// What a job was made of.
pub(super) const fn kind(kind: SpecKind) -> &'static str {
    match kind {
        SpecKind::Case => "case",
        SpecKind::Gcode => "G-code",
        SpecKind::Mesh => "model",
    }
}

/// `copy 2 of 3` of the one that is on the bed or comes next; nothing where there is only one.
pub(super) fn copies(job: &JobView) -> String {
    let is_printed =
        matches!(job.state, State::AwaitingBedClear | State::AwaitingSignOff) || job.state.is_over();
    match job.copies {
        1 => String::new(),
        copies => format!("copy {} of {copies}", (job.n_printed + u16::from(!is_printed)).min(copies)),
    }
}

/// Filament, mm³, as cm³.
pub(super) fn filament(mm3: f64) -> String {
    format!("{:.1} cm³", mm3 / 1000.0)
}

/// What a record says was done.
pub(super) fn what(record: &HistoryView) -> String {
    match &record.what {
        What::Added { .. } => "added".to_owned(),
        What::Job { change, from, to, .. } if from == to => change.kind().words().to_owned(),
        What::Job { change, to, .. } => format!("{} → {to}", change.kind()),
        What::Printer { change, .. } => printer_change(change).to_owned(),
    }
}

const fn printer_change(change: &PrinterChange) -> &'static str {
    match change {
        PrinterChange::Load(_) => "fitted",
        PrinterChange::Clear(_) => "bed clear",
        PrinterChange::Doubt => "bed in doubt",
        PrinterChange::Take(_) => "bed taken",
        PrinterChange::Free(_) => "bed as before",
        PrinterChange::Use(_) => "filament used",
    }
}

/// A text that is not longer than so many columns, cut with a mark.
pub(super) fn cut(text: &str, columns: usize) -> String {
    if text.chars().count() <= columns {
        return text.to_owned();
    }
    text.chars().take(columns.saturating_sub(1)).chain(['…']).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(text: &str) -> Timestamp {
        text.parse().unwrap()
    }

    #[test]
    fn spans_have_two_units_at_most() {
        let said = [0, 59, 60, 3599, 3600, 3900, 86_399, 90_000].map(span);
        assert_eq!(
            said,
            ["0 s", "59 s", "1 min", "59 min", "1 h 00 min", "1 h 05 min", "23 h 59 min", "1 d 01 h"]
        );
    }

    #[test]
    fn a_clock_time_names_its_day_where_that_is_not_today() {
        let now = at("2026-11-28T12:00:00Z");
        let said = |text| clock(at(text), now, &TimeZone::UTC);
        assert_eq!(said("2026-11-28T23:59:00Z"), "23:59");
        assert_eq!(said("2026-11-29T00:01:00Z"), "tomorrow 00:01");
        assert_eq!(said("2026-11-27T08:00:00Z"), "yesterday 08:00");
        assert_eq!(said("2026-12-01T08:00:00Z"), "Tue 08:00");
        assert_eq!(said("2026-12-24T08:00:00Z"), "24 Dec 08:00");
        let short = |text| short_clock(at(text), now, &TimeZone::UTC);
        assert_eq!(short("2026-11-29T00:01:00Z"), "Sun 00:01");
        assert_eq!(short("2026-11-27T23:59:00Z"), "Fri 23:59");
        assert_eq!(short("2025-12-24T08:00:00Z").len(), 12);
    }

    #[test]
    fn what_is_cut_says_so() {
        assert_eq!(
            (cut("abcd", 4), cut("abcde", 4), cut("a", 0)),
            ("abcd".into(), "abc…".into(), "…".into())
        );
    }

    #[test]
    fn a_job_is_known_by_the_end_of_its_name() {
        let id = JobId::at(Timestamp::UNIX_EPOCH, [7; 10]);
        assert!(id.to_string().ends_with(&short(id)) && short(id).len() == 8);
    }
}
