//! Checks of a profile that need more than one key.

use super::layers::Layers;
use super::{Dialect, Error, Firmware, NUMBERING_BYTES, ObjectLabels, Profile, ResumePoint, schema};
use serde::Serialize;
use toml::Value;

/// So far beside the bed a script may go, to wipe or to purge, mm.
const BESIDE_MM: f64 = 30.0;

/// A key at odds with others, and what it should say.
type Fault = (String, String);

/// Every key that is at odds with another one.
pub(super) fn together(profile: &Profile, layers: &Layers) -> Vec<Error> {
    let checks = [sizes, speeds, corners, labels, accelerations, scripts];
    let wrong = |(key, expected): Fault| {
        let (value, origin) = layers.keys.get(&key).expect("the schema's check found every key");
        schema::wrong(&key, &value.to_string(), expected, origin)
    };
    checks.iter().flat_map(|check| check(profile)).map(wrong).collect()
}

fn fault(key: &str, expected: String) -> Fault {
    (key.to_owned(), expected)
}

/// A value of an enumeration as profiles write it.
fn word(value: impl Serialize) -> String {
    Value::try_from(value).map(|v| v.to_string()).unwrap_or_default()
}

fn sizes(profile: &Profile) -> Vec<Fault> {
    let Profile { machine, print, .. } = profile;
    let [narrowest_mm, widest_mm] = machine.extrusion_width_mm;
    let nozzle_mm = machine.nozzle_mm;
    let too_thick = (machine.layer_height_mm[1] > nozzle_mm).then(|| {
        let expected =
            format!("layers no thicker than the nozzle is wide, machine.nozzle_mm = {nozzle_mm} mm");
        fault("machine.layer_height_mm", expected)
    });
    let other_width = (!(narrowest_mm..=widest_mm).contains(&print.extrusion_width_mm)).then(|| {
        let expected = format!("a number from {narrowest_mm} to {widest_mm} mm (machine.extrusion_width_mm)");
        fault("print.extrusion_width_mm", expected)
    });
    too_thick.into_iter().chain(other_width).collect()
}

fn speeds(profile: &Profile) -> Vec<Fault> {
    let Profile { machine, print, .. } = profile;
    let fastest_mm_s = machine.max_speed_mm_s[0].min(machine.max_speed_mm_s[1]);
    let wanted = [
        ("print.external_perimeter_mm_s", print.external_perimeter_mm_s),
        ("print.perimeter_mm_s", print.perimeter_mm_s),
        ("print.infill_mm_s", print.infill_mm_s),
        ("print.small_loop_mm_s", print.small_loop_mm_s),
        ("print.bridge_mm_s", print.bridge_mm_s),
        ("print.first_layer_mm_s", print.first_layer_mm_s),
        ("print.travel_mm_s", print.travel_mm_s),
    ];
    let too_fast = wanted.into_iter().filter(|(_, speed_mm_s)| *speed_mm_s > fastest_mm_s);
    too_fast
        .map(|(key, _)| fault(key, format!("at most {fastest_mm_s} mm/s (machine.max_speed_mm_s)")))
        .collect()
}

/// The firmware must know the rule of corners.
fn corners(profile: &Profile) -> Vec<Fault> {
    let dialect = profile.firmware.dialect;
    let known = dialect.cornerings();
    if known.contains(&profile.machine.cornering) {
        return Vec::new();
    }
    let words: Vec<String> = known.iter().map(|c| word(*c)).collect();
    let expected = format!("{} with firmware.dialect = {}", words.join(" or "), word(dialect));
    vec![fault("machine.cornering", expected)]
}

/// It must know how objects are named.
fn labels(profile: &Profile) -> Vec<Fault> {
    let Firmware { dialect, object_labels, .. } = profile.firmware;
    let is_klipper = dialect == Dialect::Klipper;
    let is_known = (object_labels == ObjectLabels::ExcludeObject) == is_klipper;
    if is_known || object_labels == ObjectLabels::None {
        return Vec::new();
    }
    let known = if is_klipper { "exclude-object" } else { "m486" };
    let expected = format!("{known} or none with firmware.dialect = {}", word(dialect));
    vec![fault("firmware.object_labels", expected)]
}

/// Some firmwares have one acceleration for all moves.
fn accelerations(profile: &Profile) -> Vec<Fault> {
    let dialect = profile.firmware.dialect;
    let print = profile.machine.print_acceleration_mm_s2;
    let one_for_all = matches!(dialect, Dialect::Klipper | Dialect::Smoothie);
    if !one_for_all || profile.machine.travel_acceleration_mm_s2 == print {
        return Vec::new();
    }
    let expected = format!(
        "{print} mm/s2, that of printing moves: firmware.dialect = {} has one for all",
        word(dialect)
    );
    vec![fault("machine.travel_acceleration_mm_s2", expected)]
}

/// A print that is given up must leave the heaters off, and the firmware must be able to read every line.
fn scripts(profile: &Profile) -> Vec<Fault> {
    let n_bytes = profile.firmware.line_bytes;
    let far = ResumePoint {
        xyz_mm: profile.machine.bed_mm.map(|mm| mm - 0.001),
        nozzle_z_mm: profile.machine.bed_mm[2] - 0.001,
        clear_z_mm: profile.machine.bed_mm[2] - 0.001,
        hotend_c: profile.filament.hotend_c.0,
        bed_c: profile.filament.bed_c.0,
    };
    let filled = [
        ("start", profile.start_gcode()),
        ("end", profile.end_gcode(0.0)),
        ("safe", profile.safe_gcode()),
        ("pause", profile.pause_gcode(&far)),
        ("resume", profile.resume_gcode(&far)),
        ("recovery", profile.recovery_gcode(&far)),
    ];
    let too_long = |lines: &[String]| lines.iter().any(|line| line.len() + NUMBERING_BYTES > n_bytes);
    let long = filled.iter().filter(|(_, lines)| too_long(lines)).map(|(script, _)| {
        let expected =
            format!("lines that leave room for number and checksum in {n_bytes} bytes (firmware.line_bytes)");
        fault(&format!("scripts.{script}"), expected)
    });
    let unsafe_end = profile
        .scripts
        .safe
        .is_empty()
        .then(|| fault("scripts.safe", "at least the lines that switch the heaters off".to_owned()));
    let harmful = filled.iter().filter_map(|(script, lines)| {
        let (line, why) = harmful(script, lines, profile.machine.bed_mm)?;
        Some(fault(&format!("scripts.{script}"), format!("no line like `{line}`: {why}")))
    });
    unsafe_end.into_iter().chain(long).chain(harmful).collect()
}

/// The first line of a script that cannot be meant, and why.
fn harmful<'a>(script: &str, lines: &'a [String], bed_mm: [f64; 3]) -> Option<(&'a str, String)> {
    let mut is_absolute = true;
    lines.iter().find_map(|line| {
        let mut words = line.split_ascii_whitespace();
        let why = match words.next()? {
            "G90" => {
                is_absolute = true;
                None
            }
            "G91" => {
                is_absolute = false;
                None
            }
            "M112" if script != "safe" => Some("it stops the printer, and the print with it".to_owned()),
            "G0" | "G1" | "G2" | "G3" | "G28" if script == "safe" => {
                Some("it moves where nobody knows what stands in the way".to_owned())
            }
            "G0" | "G1" if is_absolute && words.any(|word| is_far(word, bed_mm)) => {
                let [x, y, z] = bed_mm;
                Some(format!("it leaves the machine, machine.bed_mm = {x} x {y} x {z} mm"))
            }
            _ => None,
        };
        why.map(|why| (line.as_str(), why))
    })
}

/// Whether a word names a place beyond the bed, and beyond what may lie beside it.
fn is_far(word: &str, bed_mm: [f64; 3]) -> bool {
    let limit_mm = match word.get(..1) {
        Some("X") => bed_mm[0],
        Some("Y") => bed_mm[1],
        Some("Z") => bed_mm[2],
        _ => return false,
    };
    let place_mm: Option<f64> = word[1..].parse().ok();
    place_mm.is_some_and(|mm| !(-BESIDE_MM..=limit_mm + BESIDE_MM).contains(&mm))
}
