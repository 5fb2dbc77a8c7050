//! What a firmware says, parsed. Nothing here fails: what is not understood is [`Reply::Unknown`].

use crate::units::LineNumber;
use serde::Serialize;

/// One line from the firmware.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reply<'a> {
    /// A command is done (`ok`), with what the firmware adds to it.
    Ok(Acknowledgement),
    /// It wants this line again, and all after it.
    Resend(LineNumber),
    /// A numbered line was refused; the last one that was accepted.
    LineRefused {
        /// Why.
        reason: Refusal,
        /// The number of the last line accepted.
        last: LineNumber,
    },
    /// A command takes its time.
    Busy(&'a str),
    /// It has nothing to do.
    Wait,
    /// Temperatures, unasked for or while heating.
    Temperatures(Temperatures),
    /// It has just started.
    Start,
    /// It has stopped for good.
    Halted(&'a str),
    /// An error that does not stop it.
    Error(&'a str),
    /// It did not know this command.
    UnknownCommand(&'a str),
    /// `//action:`, a wish of the printer's own buttons or sensors.
    Action(&'a str),
    /// A numbered line that it had already was passed over; the `ok` that follows is for that.
    Skipped(LineNumber),
    /// Where it is (the answer to M114).
    Position(Position),
    /// Which firmware it is (the answer to M115).
    Firmware(&'a str),
    /// One of the lines behind it.
    Capability,
    /// Anything else.
    Unknown(&'a str),
}

/// Why a numbered line was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// Its number is not the one after the last.
    WrongNumber,
    /// It was damaged: wrong or missing checksum.
    Damaged,
}

/// What comes with `ok`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Acknowledgement {
    /// The line it is for (`N`, ADVANCED_OK).
    pub line: Option<LineNumber>,
    /// Moves that the planner has room for (`P`).
    pub planner_free: Option<u32>,
    /// Lines that the command queue has room for (`B`).
    pub slots_free: Option<u32>,
    /// Temperatures (the answer to M105).
    pub temperatures: Option<Temperatures>,
    /// Where it is (the answer to M114 of some).
    pub position: Option<Position>,
}

/// Where a firmware says that the moves which it has taken end, mm, in the job's coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Position {
    /// X, Y, Z.
    pub xyz_mm: [f64; 3],
    /// The filament's.
    pub e_mm: Option<f64>,
    /// The last place of the numbers as they were told, mm.
    pub step_mm: f64,
}

/// An actual and a target temperature, °C.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Heater {
    /// What is measured, °C.
    pub actual_c: f64,
    /// What is asked for, °C; 0: off.
    pub target_c: f64,
}

/// The heaters of a printer, those whose targets are told.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Temperatures {
    /// The nozzle.
    pub hotend: Option<Heater>,
    /// The bed.
    pub bed: Option<Heater>,
}

impl Temperatures {
    /// Whether all targets are 0; nothing where the nozzle's is not told.
    #[must_use]
    pub fn are_off(&self) -> Option<bool> {
        let is_off = |heater: Heater| heater.target_c <= 0.0;
        self.hotend.map(|hotend| is_off(hotend) && self.bed.is_none_or(is_off))
    }
}

impl std::fmt::Display for Temperatures {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let heaters = [("nozzle", self.hotend), ("bed", self.bed)];
        let known = heaters.into_iter().filter_map(|(name, heater)| heater.map(|heater| (name, heater)));
        for (i, (name, Heater { actual_c, target_c })) in known.enumerate() {
            let comma = if i > 0 { ", " } else { "" };
            write!(f, "{comma}{name} {actual_c:.0} °C")?;
            if target_c > 0.0 {
                write!(f, " of {target_c:.0} °C")?;
            }
        }
        Ok(())
    }
}

/// Parses one line, without its line end.
#[must_use]
pub fn parse(line: &str) -> Reply<'_> {
    if let Some(rest) = line.strip_prefix("ok") {
        if rest.is_empty() || rest.starts_with(' ') {
            return Reply::Ok(acknowledgement(rest));
        }
        return Reply::Unknown(line);
    }
    filament(line).or_else(|| resend(line)).or_else(|| error(line)).unwrap_or_else(|| other(line))
}

/// Firmwares that say in words of their own that the filament has run out, and want the host to pause: Repetier,
/// RepRapFirmware, Smoothieware.
fn filament(line: &str) -> Option<Reply<'_>> {
    let starts = ["RequestPause:", "Error: Filament error", "// Filament Detector has detected"];
    starts.iter().any(|start| line.starts_with(start)).then_some(Reply::Action("pause"))
}

/// What follows the name in an answer to M115: Marlin's, and Repetier's usage.
const BEHIND_NAME: [&str; 3] = ["Cap:", "area:{", "Printed filament:"];

fn other(line: &str) -> Reply<'_> {
    let text = line.strip_prefix("echo:").unwrap_or(line).trim_start();
    if let Some(rest) = text.strip_prefix("busy:") {
        return Reply::Busy(rest.trim());
    }
    if let Some(rest) = text.strip_prefix("Unknown command:") {
        return Reply::UnknownCommand(rest.trim().trim_matches('"'));
    }
    if let Some(rest) = line.strip_prefix("//action:").or_else(|| line.strip_prefix("// action:")) {
        return Reply::Action(rest.trim());
    }
    if let Some(rest) = line.strip_prefix("// ") {
        return klipper(rest, line);
    }
    match line {
        "start" | "Smoothie" => Reply::Start,
        "wait" => Reply::Wait,
        _ if line.ends_with("is up and running.") => Reply::Start,
        _ if line.starts_with("FIRMWARE_") => Reply::Firmware(line),
        _ if BEHIND_NAME.iter().any(|start| line.starts_with(start)) => Reply::Capability,
        // RepRapFirmware's, which is no error to it.
        _ if line.starts_with("Emergency Stop") => Reply::Halted(line),
        _ => skipped(line)
            .or_else(|| position(line).map(Reply::Position))
            .or_else(|| temperatures(line).map(Reply::Temperatures))
            .unwrap_or(Reply::Unknown(line)),
    }
}

/// What stands behind `// `: Klipper's information lines.
fn klipper<'a>(text: &'a str, line: &'a str) -> Reply<'a> {
    match text.strip_prefix("Klipper state:").map(str::trim) {
        Some("Ready") => Reply::Start,
        Some("Shutdown" | "Disconnect") => Reply::Halted(text),
        _ => match text.strip_prefix("Unknown command:") {
            Some(rest) => Reply::UnknownCommand(rest.trim().trim_matches('"')),
            None => Reply::Unknown(line),
        },
    }
}

fn skipped(line: &str) -> Option<Reply<'_>> {
    line.strip_prefix("skip ")?.trim().parse().ok().map(|n| Reply::Skipped(LineNumber(n)))
}

fn resend(line: &str) -> Option<Reply<'_>> {
    let rest = line.strip_prefix("Resend:").or_else(|| line.strip_prefix("rs "))?;
    let digits = rest.trim();
    let number = digits.strip_prefix('N').unwrap_or(digits).parse().ok()?;
    Some(Reply::Resend(LineNumber(number)))
}

fn error(line: &str) -> Option<Reply<'_>> {
    if let Some(rest) = line.strip_prefix("fatal:") {
        return Some(Reply::Halted(rest.trim()));
    }
    if let Some(rest) = line.strip_prefix("!!") {
        return Some(if is_halt(line) { Reply::Halted(line) } else { Reply::Error(rest.trim()) });
    }
    let prefixes = ["Error:", "error:", "ERROR:"];
    let text = prefixes.iter().find_map(|prefix| line.strip_prefix(prefix))?.trim();
    if is_halt(text) {
        return Some(Reply::Halted(text));
    }
    // RepRapFirmware's.
    let unknown = text.strip_prefix("Bad command:").map(|command| Reply::UnknownCommand(command.trim()));
    Some(refusal(text).or(unknown).unwrap_or(Reply::Error(text)))
}

/// Whether an error is the last word of a firmware: Marlin's, RepRapFirmware's, Smoothieware's (whose bare `!!` answers
/// every command from then on) and Klipper's.
fn is_halt(text: &str) -> bool {
    // RepRapFirmware's words for a heater have changed from version to version.
    let is_heater_fault = text.contains("eater") && text.contains("fault");
    const WORDS: [&str; 9] = [
        "halted",
        "kill()",
        "system stopped",
        "Emergency Stop",
        "HALT",
        "Alarm lock",
        "hutdown",
        "not heating at expected rate",
        "Lost communication",
    ];
    text == "!!" || is_heater_fault || WORDS.iter().any(|word| text.contains(word))
}

fn refusal(text: &str) -> Option<Reply<'static>> {
    // Repetier names the number that it wants: `expected line 12 got 14`.
    if let Some(rest) = text.strip_prefix("expected line ") {
        let wanted: u64 = rest.split_ascii_whitespace().next()?.parse().ok()?;
        let last = LineNumber(wanted.checked_sub(1)?);
        return Some(Reply::LineRefused { reason: Refusal::WrongNumber, last });
    }
    let (why, last) = text.split_once("Last Line:")?;
    let last = LineNumber(last.trim().parse().ok()?);
    let why = why.to_ascii_lowercase();
    let reason = if why.contains("checksum") { Refusal::Damaged } else { Refusal::WrongNumber };
    Some(Reply::LineRefused { reason, last })
}

fn acknowledgement(rest: &str) -> Acknowledgement {
    let mut ok = Acknowledgement::default();
    if rest.contains(':') {
        ok.position = position(rest);
        ok.temperatures = temperatures(rest);
        return ok;
    }
    for word in rest.split_ascii_whitespace() {
        let (letter, digits) = word.split_at(usize::from(word.is_char_boundary(1)));
        match letter {
            "N" => ok.line = digits.parse().ok().map(LineNumber),
            "P" => ok.planner_free = digits.parse().ok(),
            "B" => ok.slots_free = digits.parse().ok(),
            _ => {}
        }
    }
    ok
}

/// `X:50.00 Y:50.00 Z:5.00 E:0.00 Count X:4000 ...`; behind `C:` in Smoothieware's words. The first of each counts.
fn position(line: &str) -> Option<Position> {
    let line = line.trim_start();
    let line = line.strip_prefix("C:").unwrap_or(line).trim_start();
    if !line.starts_with("X:") {
        return None;
    }
    let value = |name: &str| {
        let of_name = |word: &str| word.strip_prefix(name).and_then(finite);
        line.split_ascii_whitespace().find_map(of_name)
    };
    let x = line.split_ascii_whitespace().next().unwrap_or_default();
    let n_places = x.split_once('.').map_or(0, |(_, places)| places.len());
    let step_mm = [1.0, 0.1, 0.01, 0.001].get(n_places).copied().unwrap_or(0.0001);
    Some(Position { xyz_mm: [value("X:")?, value("Y:")?, value("Z:")?], e_mm: value("E:"), step_mm })
}

/// `T:19.38 /0.00 B:19.38 /0.00 @:0`: the first `T` or `T0` is the nozzle. Also `T:200 /200 W:?` while heating.
fn temperatures(line: &str) -> Option<Temperatures> {
    let line = line.trim_start();
    if !line.starts_with(['T', 'B']) {
        return None;
    }
    let mut out = Temperatures::default();
    let mut is_told = false;
    let mut words = line.split_ascii_whitespace().peekable();
    while let Some(word) = words.next() {
        let Some((name, actual)) = word.split_once(':') else { continue };
        let Some(actual_c) = finite(actual) else { continue };
        is_told |= matches!(name, "T" | "T0" | "B");
        // A heater whose target is not told is not known to be off.
        let target = words.next_if(|next| next.starts_with('/'));
        let heater = target.and_then(|t| finite(&t[1..])).map(|target_c| Heater { actual_c, target_c });
        match name {
            "T" => out.hotend = heater.or(out.hotend),
            "T0" => out.hotend = out.hotend.or(heater),
            "B" => out.bed = heater.or(out.bed),
            _ => {}
        }
    }
    is_told.then_some(out)
}

fn finite(text: &str) -> Option<f64> {
    text.parse().ok().filter(|value: &f64| value.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heater(actual_c: f64, target_c: f64) -> Option<Heater> {
        Some(Heater { actual_c, target_c })
    }

    #[test]
    fn ok_comes_plain_advanced_or_with_temperatures() {
        assert_eq!(parse("ok"), Reply::Ok(Acknowledgement::default()));
        let advanced = Acknowledgement {
            line: Some(LineNumber(2)),
            planner_free: Some(15),
            slots_free: Some(3),
            temperatures: None,
            position: None,
        };
        assert_eq!(parse("ok N2 P15 B3"), Reply::Ok(advanced));
        assert_eq!(parse("ok P15 B3"), Reply::Ok(Acknowledgement { line: None, ..advanced }));
        let Reply::Ok(ok) = parse("ok T:19.38 /0.00 B:20.00 /60.00 @:0 B@:0") else { panic!() };
        let t = ok.temperatures.unwrap();
        assert_eq!((t.hotend, t.bed), (heater(19.38, 0.0), heater(20.0, 60.0)));
    }

    #[test]
    fn a_damaged_ok_is_not_one() {
        for line in ["okN2", "oj", "o k", "kok", "ok\u{fffd}"] {
            assert!(matches!(parse(line), Reply::Unknown(_)), "{line}");
        }
    }

    #[test]
    fn resend_is_understood_in_all_spellings() {
        for line in ["Resend: 12", "Resend:12", "rs 12", "rs N12"] {
            assert_eq!(parse(line), Reply::Resend(LineNumber(12)), "{line}");
        }
        assert!(matches!(parse("Resend: twelve"), Reply::Unknown(_)));
        assert!(matches!(parse("Resend: 99999999999999999999999"), Reply::Unknown(_)));
    }

    #[test]
    fn refusals_tell_the_last_line_and_the_reason() {
        for (line, reason) in [
            ("Error:checksum mismatch, Last Line: 2", Refusal::Damaged),
            ("Error:No Checksum with line number, Last Line: 2", Refusal::Damaged),
            ("Error:Line Number is not Last Line Number+1, Last Line: 2", Refusal::WrongNumber),
            ("Error:expected line 3 got 14", Refusal::WrongNumber),
        ] {
            assert_eq!(parse(line), Reply::LineRefused { reason, last: LineNumber(2) });
        }
    }

    #[test]
    fn everything_that_stops_the_firmware_is_a_halt() {
        for line in [
            "Error:Printer halted. kill() called!",
            "Error:Heating failed, system stopped! Heater_ID: E0",
            "Error:Thermal Runaway, system stopped! Heater_ID: bed",
            "Error:MAXTEMP triggered, system stopped! Heater_ID: 0",
            "fatal:heater",
        ] {
            assert!(matches!(parse(line), Reply::Halted(_)), "{line}");
        }
        assert!(matches!(parse("Error:cold extrusion prevented"), Reply::Error(_)));
    }

    #[test]
    fn what_the_firmware_says_of_itself_is_told_apart() {
        assert_eq!(parse("start"), Reply::Start);
        assert_eq!(parse("wait"), Reply::Wait);
        assert_eq!(parse("echo:busy: processing"), Reply::Busy("processing"));
        assert_eq!(parse("busy:heating"), Reply::Busy("heating"));
        assert_eq!(parse("echo:Unknown command: \"FOO\""), Reply::UnknownCommand("FOO"));
        assert_eq!(parse("//action:pause"), Reply::Action("pause"));
        assert_eq!(parse("// action:paused"), Reply::Action("paused"));
        for line in [
            "RequestPause:No filament detected!",
            "Error: Filament error on extruder 0: no filament",
            "// Filament Detector has detected a filament jam",
        ] {
            assert_eq!(parse(line), Reply::Action("pause"), "{line}");
        }
        assert_eq!(parse("echo:wait"), Reply::Unknown("echo:wait"));
        let Reply::Temperatures(t) = parse("T:180.10 /210.00 B:60.00 /60.00 @:127 B@:0 W:?") else {
            panic!()
        };
        assert_eq!(t.hotend, heater(180.1, 210.0));
        assert_eq!(parse("X:50.00 Y:50.00"), Reply::Unknown("X:50.00 Y:50.00"));
    }

    #[test]
    fn every_firmware_tells_where_and_who_it_is_and_that_it_stopped() {
        let there = Position { xyz_mm: [50.0, 60.5, 5.0], e_mm: Some(1.25), step_mm: 0.001 };
        let coarse = "X:50.00 Y:60.50 Z:5.00 E:1.25 Count X:4000 Y:4840 Z:2000";
        assert_eq!(parse(coarse), Reply::Position(Position { step_mm: 0.01, ..there }));
        for line in [
            "X:50.000 Y:60.500 Z:5.000 E:1.250",
            "X:50.000 Y:60.500 Z:5.000 E:1.250 E0:1.2 Count 4000 4840 2000 Machine 50.000 60.500 5.000",
        ] {
            assert_eq!(parse(line), Reply::Position(there), "{line}");
        }
        let Reply::Ok(ok) = parse("ok C: X:50.0000 Y:60.5000 Z:5.0000 E:1.2500") else { panic!() };
        assert_eq!((ok.position, ok.temperatures), (Some(Position { step_mm: 0.0001, ..there }), None));
        assert!(matches!(parse("FIRMWARE_NAME:Marlin 2.1"), Reply::Firmware(_)));
        for line in [
            "// Klipper state: Shutdown",
            "!! Shutdown due to M112 command",
            "!!",
            "error:Alarm lock",
            "Error: Heater fault on heater 1: runaway",
            "Error: Heater 1 fault: temperature excursion exceeded 15.0\u{b0}C",
            "Error: Heating fault on heater 0, temperature rising much more slowly than the expected 1.2\u{b0}C/sec",
            "Error: Temperature reading fault on heater 1: sensor open circuit",
            "Emergency Stop! Reset the controller to continue.",
            "ERROR: runaway on T0, HALT asserted",
            "fatal:Heater E0 error",
        ] {
            assert!(matches!(parse(line), Reply::Halted(_)), "{line}");
        }
        let refused = "!! Move out of range: 9999.000 50.000 5.000 [0.000]";
        assert_eq!(parse(refused), Reply::Error(&refused[3..]));
        for line in
            ["start", "Smoothie", "// Klipper state: Ready", "RepRapFirmware for Duet 3 is up and running."]
        {
            assert_eq!(parse(line), Reply::Start, "{line}");
        }
        assert_eq!(parse("skip 12"), Reply::Skipped(LineNumber(12)));
        assert_eq!(parse("// Unknown command:\"M155\""), Reply::UnknownCommand("M155"));
    }

    proptest::proptest! {
        #[test]
        fn any_text_parses(text in "\\PC{0,80}") {
            let reply = parse(&text);
            proptest::prop_assert_eq!(reply, reply);
        }

        #[test]
        fn any_text_behind_a_known_word_parses(
            head in "(ok|Resend:|rs|Error:|echo:|T:|B:|//action:|Error:x Last Line:)( )?",
            tail in "[\\PC]{0,40}",
        ) {
            let line = format!("{head}{tail}");
            let reply = parse(&line);
            proptest::prop_assert_eq!(reply, reply);
        }
    }
}
