//! Checks of a profile that need more than one key.

use super::layers::Layers;
use super::{Dialect, Error, Firmware, NUMBERING_BYTES, ObjectLabels, Profile, ResumePoint, schema};
use serde::Serialize;
use toml::Value;

/// What the firmware must know for the profile to be of use.
fn check_dialect(profile: &Profile, fail: &dyn Fn(&str, String) -> Result<(), Error>) -> Result<(), Error> {
    let Firmware { dialect, object_labels, .. } = profile.firmware;
    let cornerings = dialect.cornerings();
    if !cornerings.contains(&profile.machine.cornering) {
        let words: Vec<String> = cornerings.iter().map(|c| word(*c)).collect();
        let expected = format!("{} with firmware.dialect = {}", words.join(" or "), word(dialect));
        return fail("machine.cornering", expected);
    }
    if (object_labels == ObjectLabels::ExcludeObject) != (dialect == Dialect::Klipper)
        && object_labels != ObjectLabels::None
    {
        let known = if dialect == Dialect::Klipper { "exclude-object" } else { "m486" };
        let expected = format!("{known} or none with firmware.dialect = {}", word(dialect));
        return fail("firmware.object_labels", expected);
    }
    let one_for_all = matches!(dialect, Dialect::Klipper | Dialect::Smoothie);
    let print = profile.machine.print_acceleration_mm_s2;
    if one_for_all && profile.machine.travel_acceleration_mm_s2 != print {
        let expected = format!(
            "{print} mm/s2, that of printing moves: firmware.dialect = {} has one for all",
            word(dialect)
        );
        return fail("machine.travel_acceleration_mm_s2", expected);
    }
    Ok(())
}

/// A value of an enumeration as profiles write it.
fn word(value: impl Serialize) -> String {
    Value::try_from(value).map(|v| v.to_string()).unwrap_or_default()
}

/// Checks that need more than one key.
pub(super) fn together(profile: &Profile, layers: &Layers) -> Result<(), Error> {
    let fail = |key: &str, expected: String| {
        let (value, origin) = layers.keys.get(key).expect("the schema's check found every key");
        Err(schema::wrong(key, &value.to_string(), expected, origin))
    };
    let Profile { machine, print, scripts, .. } = profile;
    let [narrowest_mm, widest_mm] = machine.extrusion_width_mm;
    if machine.layer_height_mm[1] > machine.nozzle_mm {
        return fail(
            "machine.layer_height_mm",
            format!(
                "layers no thicker than the nozzle is wide, machine.nozzle_mm = {} mm",
                machine.nozzle_mm
            ),
        );
    }
    if !(narrowest_mm..=widest_mm).contains(&print.extrusion_width_mm) {
        return fail(
            "print.extrusion_width_mm",
            format!("a number from {narrowest_mm} to {widest_mm} mm (machine.extrusion_width_mm)"),
        );
    }
    let fastest_mm_s = machine.max_speed_mm_s[0].min(machine.max_speed_mm_s[1]);
    for (key, speed_mm_s) in [
        ("print.external_perimeter_mm_s", print.external_perimeter_mm_s),
        ("print.perimeter_mm_s", print.perimeter_mm_s),
        ("print.infill_mm_s", print.infill_mm_s),
        ("print.first_layer_mm_s", print.first_layer_mm_s),
        ("print.travel_mm_s", print.travel_mm_s),
    ] {
        if speed_mm_s > fastest_mm_s {
            return fail(key, format!("at most {fastest_mm_s} mm/s (machine.max_speed_mm_s)"));
        }
    }
    check_dialect(profile, &fail)?;
    if scripts.safe.is_empty() {
        return fail("scripts.safe", "at least the lines that switch the heaters off".to_owned());
    }
    let n_bytes = profile.firmware.line_bytes;
    let [x_mm, y_mm, z_mm] = machine.bed_mm;
    let far = ResumePoint {
        xyz_mm: [x_mm, y_mm, z_mm].map(|mm| mm - 0.001),
        nozzle_z_mm: z_mm - 0.001,
        clear_z_mm: z_mm - 0.001,
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
    for (script, lines) in filled {
        if lines.iter().any(|line| line.len() + NUMBERING_BYTES > n_bytes) {
            return fail(
                &format!("scripts.{script}"),
                format!(
                    "lines that leave room for number and checksum in {n_bytes} bytes (firmware.line_bytes)"
                ),
            );
        }
    }
    Ok(())
}
