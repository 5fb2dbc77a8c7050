//! The profile's limits of motion in the firmware's words, so that the machine moves as the estimate has it.

use crate::profile::{Cornering, Dialect, Machine, Profile};
use crate::units::mm_min_from_mm_s;

/// The commands that set them.
pub(super) fn lines(profile: &Profile) -> Vec<String> {
    let m = &profile.machine;
    match profile.firmware.dialect {
        Dialect::Marlin | Dialect::Marlin1 => {
            let mut lines = axis_limits(m, mm_s);
            lines.push(format!(
                "M204 P{} R{} T{}",
                m.print_acceleration_mm_s2, m.retract_acceleration_mm_s2, m.travel_acceleration_mm_s2
            ));
            lines.push(if m.cornering == Cornering::Jerk {
                axes("M205", m.jerk_mm_s, mm_s)
            } else {
                format!("M205 J{}", m.junction_deviation_mm)
            });
            lines
        }
        Dialect::RepRapFirmware => {
            let mut lines = axis_limits(m, mm_min_from_mm_s);
            lines.push(format!("M204 P{} T{}", m.print_acceleration_mm_s2, m.travel_acceleration_mm_s2));
            lines.push(axes("M566", m.jerk_mm_s, mm_min_from_mm_s));
            lines
        }
        Dialect::Klipper => vec![format!(
            "SET_VELOCITY_LIMIT VELOCITY={} ACCEL={} SQUARE_CORNER_VELOCITY={}",
            m.max_speed_mm_s[0].min(m.max_speed_mm_s[1]),
            m.print_acceleration_mm_s2,
            m.square_corner_mm_s
        )],
        Dialect::Repetier => {
            let [x, _, z, e] = m.jerk_mm_s;
            vec![
                axes("M201", in_plane(m, m.print_acceleration_mm_s2), mm_s),
                axes("M202", in_plane(m, m.travel_acceleration_mm_s2), mm_s),
                format!("M207 X{x} Z{z} E{e}"),
            ]
        }
        Dialect::Smoothie => {
            let [x, y, z, _] = m.max_speed_mm_s;
            vec![
                format!("M203 X{x} Y{y} Z{z}"),
                format!("M204 S{} Z{}", m.print_acceleration_mm_s2, m.max_acceleration_mm_s2[2]),
                format!("M205 X{}", m.junction_deviation_mm),
            ]
        }
    }
}

/// Highest accelerations and speeds of the axes, the speeds in the firmware's unit.
fn axis_limits(machine: &Machine, speed: fn(f64) -> f64) -> Vec<String> {
    vec![axes("M201", machine.max_acceleration_mm_s2, mm_s), axes("M203", machine.max_speed_mm_s, speed)]
}

/// The unit of most firmwares is ours.
const fn mm_s(value: f64) -> f64 {
    value
}

/// The accelerations of the axes where those of the plane are also those of the move.
fn in_plane(machine: &Machine, acceleration_mm_s2: f64) -> [f64; 4] {
    let [x, y, z, e] = machine.max_acceleration_mm_s2;
    [acceleration_mm_s2.min(x), acceleration_mm_s2.min(y), z, e]
}

/// To a thousandth: a product may have a tail of digits.
fn axes(command: &str, values: [f64; 4], unit: fn(f64) -> f64) -> String {
    let [x, y, z, e] = values.map(|v| (1e3 * unit(v)).round() / 1e3);
    format!("{command} X{x} Y{y} Z{z} E{e}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile;

    #[test]
    fn each_firmware_is_told_in_its_own_words() {
        for (name, expected) in [
            ("marlin", "M204 P1000 R3000 T1500\nM205 J0.013"),
            ("marlin1", "M205 X8 Y8 Z0.3 E5"),
            ("reprapfirmware", "M203 X18000 Y18000 Z900 E3600\nM204 P1500 T2500\nM566 X540 Y540 Z30 E300"),
            ("klipper", "SET_VELOCITY_LIMIT VELOCITY=300 ACCEL=3000 SQUARE_CORNER_VELOCITY=5"),
            ("repetier", "M201 X1000 Y1000 Z100 E4000\nM202 X1500 Y1500 Z100 E4000\nM207 X20 Z0.3 E20"),
            ("smoothie", "M203 X300 Y300 Z8\nM204 S2000 Z100\nM205 X0.05"),
        ] {
            let lines = lines(&profile::builtin(name).unwrap()).join("\n");
            assert!(lines.contains(expected), "{name}: {lines}");
        }
    }
}
