//! Commands that set the limits of motion, as each firmware means them.

use super::Printer;
use crate::{
    dialect::Family,
    gcode::Command,
    planner::{Cornering, Limits},
};

/// Seconds in the minute that RepRapFirmware counts speeds in.
const S_PER_MIN: f64 = 60.0;

impl Printer {
    /// M201 to M207 and M566.
    pub(super) fn set_limits(&mut self, command: &Command<'_>) {
        let limits = &mut self.motion.limits;
        match (self.profile.dialect.family, command.code) {
            (Family::Repetier, 201) => set_axes(command, &mut limits.max_acceleration),
            (Family::Repetier, 202) => {
                let mut travel = limits.travel_max_acceleration.unwrap_or(limits.max_acceleration);
                set_axes(command, &mut travel);
                limits.travel_max_acceleration = Some(travel);
            }
            (Family::Repetier, 207) => set_jerk(command, limits, 1.0),
            (Family::Repetier, _) => {}
            (Family::RepRapFirmware, 566) => set_jerk(command, limits, 1.0 / S_PER_MIN),
            (Family::RepRapFirmware, 203) => {
                let mut per_minute = limits.max_speed.map(|v| v * S_PER_MIN);
                set_axes(command, &mut per_minute);
                limits.max_speed = per_minute.map(|v| v / S_PER_MIN);
            }
            (Family::Klipper, 204) => {
                let both = command.value(b'P').zip(command.value(b'T')).map(|(p, t)| p.min(t));
                if let Some(accel) = command.value(b'S').or(both).filter(|&a| a > 0.0) {
                    (limits.print_acceleration, limits.travel_acceleration) = (accel, accel);
                }
            }
            (Family::Smoothie, 204) => {
                set_accelerations(command, limits);
                let z = command.value(b'Z').filter(|&a| a > 0.0);
                limits.max_acceleration[2] = z.unwrap_or(limits.max_acceleration[2]);
            }
            (Family::Smoothie, 205) => set_deviation(command.value(b'X'), limits),
            (_, 201) => set_axes(command, &mut limits.max_acceleration),
            (_, 203) => set_axes(command, &mut limits.max_speed),
            (_, 204) => set_accelerations(command, limits),
            (_, 205) => {
                set_deviation(command.value(b'J'), limits);
                set_jerk(command, limits, 1.0);
            }
            _ => {}
        }
    }

    /// Klipper's `SET_VELOCITY_LIMIT`: `KEY=VALUE` words.
    pub(super) fn set_velocity_limit(&mut self, text: &[u8]) {
        let limits = &mut self.motion.limits;
        for word in text.split(|&b| b == b' ').skip(1) {
            let Some(equals) = word.iter().position(|&b| b == b'=') else { continue };
            let Some((value, _)) = crate::gcode::decimal(&word[equals + 1..]).filter(|v| v.0 > 0.0) else {
                continue;
            };
            match &word[..equals] {
                b"VELOCITY" => (limits.max_speed[0], limits.max_speed[1]) = (value, value),
                b"ACCEL" => {
                    (limits.print_acceleration, limits.travel_acceleration) = (value, value);
                }
                b"SQUARE_CORNER_VELOCITY" => {
                    if let Cornering::SquareCorner { speed, .. } = &mut limits.cornering {
                        *speed = value;
                    }
                }
                b"MINIMUM_CRUISE_RATIO" => {
                    if let Cornering::SquareCorner { cruise_ratio, .. } = &mut limits.cornering {
                        *cruise_ratio = value.min(1.0);
                    }
                }
                _ => {}
            }
        }
    }
}

pub(super) fn set_axes(command: &Command<'_>, values: &mut [f64; 4]) {
    for (axis, letter) in [b'X', b'Y', b'Z', b'E'].into_iter().enumerate() {
        if let Some(value) = command.value(letter).filter(|&value| value > 0.0) {
            values[axis] = value;
        }
    }
}

/// Per axis, in `unit` mm/s; Repetier's X holds for both axes of the plane. Of no effect where corners are taken otherwise.
fn set_jerk(command: &Command<'_>, limits: &mut Limits, unit: f64) {
    if let Cornering::ClassicJerk { axes, .. }
    | Cornering::InstantChange(axes)
    | Cornering::PlanarJerk(axes) = &mut limits.cornering
    {
        let mut given = axes.map(|v| v / unit);
        set_axes(command, &mut given);
        *axes = given.map(|v| v * unit);
        if command.code == 207 {
            axes[1] = axes[0];
        }
    }
}

fn set_deviation(value: Option<f64>, limits: &mut Limits) {
    if let (Some(mm), Cornering::Deviation(deviation) | Cornering::SmoothieDeviation(deviation)) =
        (value.filter(|&mm| mm > 0.0), &mut limits.cornering)
    {
        *deviation = mm;
    }
}

fn set_accelerations(command: &Command<'_>, limits: &mut Limits) {
    let positive = |letter| command.value(letter).filter(|&a| a > 0.0);
    let both = positive(b'S');
    limits.print_acceleration = positive(b'P').or(both).unwrap_or(limits.print_acceleration);
    limits.travel_acceleration = positive(b'T').or(both).unwrap_or(limits.travel_acceleration);
    limits.retract_acceleration = positive(b'R').unwrap_or(limits.retract_acceleration);
}
