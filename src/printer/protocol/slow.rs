//! Which commands may take minutes, as far as their text tells.
//!
//! A firmware that says `busy` shows by that whether it is alive. The others say nothing while they home, level or heat, and what
//! they do then must not be taken for death. Too patient is only late; too impatient loses a print.

use std::time::Duration;

/// Commands that may take minutes: homing, levelling, calibrating, cleaning, heating, waiting, changing tools or filament, running
/// what is stored in the printer, and whatever asks the operator.
const SLOW: &[&str] = &[
    "G4", "G12", "G26", "G27", "G28", "G29", "G30", "G32", "G33", "G34", "G35", "G76", "G80", "G425", "M0",
    "M1", "M24", "M25", "M32", "M48", "M98", "M109", "M116", "M125", "M190", "M191", "M192", "M193", "M226",
    "M291", "M303", "M306", "M400", "M600", "M601", "M701", "M702",
];

/// Longer than that no command may take by its own word.
const MAX_DWELL_S: f64 = 86_400.0;

/// Whether a command may take minutes.
pub(super) fn is_slow(command: &str) -> bool {
    let word = command.split_ascii_whitespace().next().unwrap_or_default();
    // The words of nearly all lines of a job.
    !is_move(command) && (SLOW.contains(&word) || !is_code(word))
}

/// Commands within which a firmware waits for somebody.
const WAITS_FOR_USER: [&str; 5] = ["M0", "M1", "M25", "M226", "M600"];

/// Whether a command waits for somebody at the printer.
pub(super) fn waits_for_user(command: &str) -> bool {
    command.starts_with('M')
        && command.split_ascii_whitespace().next().is_some_and(|word| WAITS_FOR_USER.contains(&word))
}

/// Whether a command waits for a temperature.
pub(super) fn waits_for_heat(command: &str) -> bool {
    ["M109", "M190"].iter().any(|word| command.starts_with(word))
}

/// Whether a command is a straight move.
pub(super) fn is_move(command: &str) -> bool {
    matches!(command.as_bytes(), [b'G', b'0' | b'1'] | [b'G', b'0' | b'1', b' ', ..])
}

/// A letter and a number, but for changes of the tool: anything else is a macro, which may do whatever somebody wrote into it.
fn is_code(word: &str) -> bool {
    matches!(word.as_bytes(), [b'G' | b'M', digit, ..] if digit.is_ascii_digit())
}

/// How long a command takes by its own word: that of a dwell, or of a wait for the user that ends by itself.
pub(super) fn dwell(command: &str) -> Duration {
    let mut words = command.split_ascii_whitespace();
    if !matches!(words.next(), Some("G4" | "M0" | "M1")) {
        return Duration::ZERO;
    }
    let longest_s = words.filter_map(seconds).fold(0.0, f64::max).min(MAX_DWELL_S);
    Duration::try_from_secs_f64(longest_s).unwrap_or_default()
}

/// `S` in seconds, `P` in milliseconds.
fn seconds(word: &str) -> Option<f64> {
    match word.split_at_checked(1)? {
        ("S", s) => s.parse().ok(),
        ("P", ms) => ms.parse::<f64>().ok().map(|ms| ms * 1e-3),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_nobody_knows_is_slow_and_moves_are_not() {
        for command in
            ["START_PRINT BED=60", "BED_MESH_CALIBRATE", "TEMPERATURE_WAIT", "G32", "M98 P\"x\"", "T1"]
        {
            assert!(is_slow(command), "{command}");
        }
        for command in ["G1 X1", "G0", "G92 E0", "M104 S200", "M106", "G2 X1 Y1 I1 J0"] {
            assert!(!is_slow(command), "{command}");
        }
    }

    #[test]
    fn a_dwell_takes_what_it_says() {
        assert_eq!(dwell("G4 S3600"), Duration::from_secs(3600));
        assert_eq!(dwell("G4 P1500"), Duration::from_millis(1500));
        assert_eq!(dwell("M0 S5 Look"), Duration::from_secs(5));
        assert_eq!(dwell("M104 S200"), Duration::ZERO);
        assert_eq!(dwell("G4 S-1"), Duration::ZERO);
        assert_eq!(dwell("G4 Sinf PNaN"), Duration::from_secs(86_400));
    }
}
