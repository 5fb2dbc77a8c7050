//! What a job says of its own time: in its head, and on the way as progress.

use crate::profile::{Profile, ProgressReport};
use std::fmt::Write;

/// A line, counted from 1, and the time at which it begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mark {
    /// The line.
    pub line: usize,
    /// Since the job has begun, s.
    pub elapsed_s: f64,
}

/// How long a job takes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing<'a> {
    /// In all, s.
    pub total_s: f64,
    /// Where to say how far it has come, in the order of their lines.
    pub marks: &'a [Mark],
}

/// After this line of the head comes the time.
const HEAD_LINE: &str = "; filament_g ";

/// The job with its time in its head, and with its progress told as the firmware wants it. No move is changed.
#[must_use]
pub fn timed(job: &str, timing: Timing<'_>, profile: &Profile) -> String {
    let mut text = String::with_capacity(job.len() + 64 * timing.marks.len() + 256);
    let mut marks = timing.marks.iter().peekable();
    let mut in_head = true;
    let mut told = None;
    for (idx, line) in job.split_inclusive('\n').enumerate() {
        let is_command = !line.starts_with(';') && !line.trim().is_empty();
        let begins = if is_command && told.is_none() { Some(0.0) } else { None };
        let passed = std::iter::from_fn(|| marks.next_if(|m| m.line <= idx + 1)).map(|m| m.elapsed_s);
        for elapsed_s in begins.into_iter().chain(passed) {
            let percent = percent(elapsed_s, timing.total_s);
            if told != Some(percent) {
                progress(&mut text, elapsed_s, timing.total_s, profile);
                told = Some(percent);
            }
        }
        text.push_str(line);
        if in_head && line.starts_with(HEAD_LINE) {
            in_head = false;
            head(&mut text, timing.total_s);
        }
    }
    progress(&mut text, timing.total_s, timing.total_s, profile);
    text
}

/// In our words and in those that viewers and print servers look for.
fn head(text: &mut String, total_s: f64) {
    let _infallible = writeln!(text, "; print_time_s {total_s:.1}");
    let _infallible = writeln!(text, "; estimated printing time (normal mode) = {}", duration(total_s));
}

/// `1h 2m 3s`, larger units only where they are needed.
fn duration(seconds: f64) -> String {
    let s = whole(seconds.round());
    let parts = [(s / 86_400, 'd'), (s / 3600 % 24, 'h'), (s / 60 % 60, 'm'), (s % 60, 's')];
    let first = parts.iter().position(|(n, _)| *n > 0).unwrap_or(3);
    parts[first..].iter().map(|(n, unit)| format!("{n}{unit}")).collect::<Vec<_>>().join(" ")
}

/// How much of the time has passed; all of none.
fn percent(elapsed_s: f64, total_s: f64) -> u64 {
    if elapsed_s >= total_s { 100 } else { whole((100.0 * elapsed_s / total_s).floor()) }
}

fn progress(text: &mut String, elapsed_s: f64, total_s: f64, profile: &Profile) {
    let percent = percent(elapsed_s, total_s);
    let minutes = whole(((total_s - elapsed_s) / 60.0).round());
    let _infallible = match profile.firmware.progress {
        ProgressReport::M73 => writeln!(text, "M73 P{percent} R{minutes}"),
        ProgressReport::M117 => writeln!(text, "M117 {percent}% {minutes} min left"),
        ProgressReport::None => Ok(()),
    };
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped at zero, and no print takes ages"
)]
const fn whole(value: f64) -> u64 {
    value.max(0.0) as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile;

    const JOB: &str = "; filament_g 1.00\nG28\nG1 X1\nG1 X2\n";
    const MARKS: [Mark; 2] = [Mark { line: 3, elapsed_s: 0.0 }, Mark { line: 4, elapsed_s: 3600.0 }];

    #[test]
    fn progress_is_told_before_its_line_and_the_time_in_the_head() {
        let timing = Timing { total_s: 7384.0, marks: &MARKS };
        let expected = "; filament_g 1.00\n; print_time_s 7384.0\n\
            ; estimated printing time (normal mode) = 2h 3m 4s\n\
            M73 P0 R123\nG28\nG1 X1\nM73 P48 R63\nG1 X2\nM73 P100 R0\n";
        assert_eq!(timed(JOB, timing, &profile::builtin("marlin").unwrap()), expected);
    }

    #[test]
    fn a_job_without_any_time_is_done_when_it_begins() {
        let timing = Timing { total_s: 0.0, marks: &[] };
        assert!(timed(JOB, timing, &profile::builtin("marlin").unwrap()).ends_with("M73 P100 R0\n"));
    }

    #[test]
    fn a_firmware_without_m73_gets_a_message() {
        let timing = Timing { total_s: 7200.0, marks: &MARKS };
        let text = timed(JOB, timing, &profile::builtin("smoothie").unwrap());
        assert!(text.contains("M117 50% 60 min left\nG1 X2\n") && !text.contains("M73"), "{text}");
    }
}
