//! Machines as data: what the simulated printer is.
//!
//! These are the simulator's own figures. They are written independently of the host's profile files: where the two
//! disagree, the print shows it, as it would on a real machine.

use crate::{
    Error,
    dialect::{
        Dialect, KLIPPER, MARLIN, MARLIN_1, PRUSA, REPETIER, REPRAPFIRMWARE, REPRAPFIRMWARE_SILENT, SMOOTHIE,
    },
    planner::Cornering,
};

/// How the cross-section of a bead follows from its volume, length and height.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BeadShape {
    /// width = area / height.
    Rectangle,
    /// A rectangle with round ends; below the area of a full circle, an ellipse as high as the layer.
    Stadium,
}

impl BeadShape {
    /// Width in mm of a bead of cross-section `area_mm2` pressed to `height_mm` (> 0).
    #[must_use]
    pub fn width_mm(self, area_mm2: f64, height_mm: f64) -> f64 {
        use std::f64::consts::PI;
        let circle_mm2 = PI / 4.0 * height_mm * height_mm;
        match self {
            Self::Rectangle => area_mm2 / height_mm,
            Self::Stadium if area_mm2 >= circle_mm2 => area_mm2 / height_mm + height_mm * (1.0 - PI / 4.0),
            Self::Stadium => area_mm2 / circle_mm2 * height_mm,
        }
    }
}

/// A heater with the thing it heats: first order, ideal controller.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeaterData {
    /// Name in fault messages: `E0`, `bed`.
    pub id: &'static str,
    /// Where full power would end, °C.
    pub full_power_c: f64,
    /// Time constant, s.
    pub tau_s: f64,
    /// Highest target it takes, °C.
    pub max_target_c: f64,
    /// How far below its target it may fall before the protection counts, °C.
    pub hysteresis_c: f64,
    /// How long it may stay there, s.
    pub protection_s: f64,
    /// Time in which it must have warmed by 2 °C when heating, s.
    pub watch_s: f64,
}

/// A printer with its firmware's settings.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Name it is chosen by.
    pub name: &'static str,
    /// What it says and how it reads.
    pub dialect: &'static Dialect,
    /// X, Y, Z travel, mm; all from 0.
    pub bed_mm: [f64; 3],
    /// Filament diameter, mm.
    pub filament_mm: f64,
    /// Cross-section of its beads.
    pub bead_shape: BeadShape,
    /// Fastest X, Y, Z, E, mm/s.
    pub max_speed_mm_s: [f64; 4],
    /// Strongest X, Y, Z, E, mm/s².
    pub max_acceleration_mm_s2: [f64; 4],
    /// Moves that extrude, mm/s².
    pub print_acceleration_mm_s2: f64,
    /// E alone, mm/s².
    pub retract_acceleration_mm_s2: f64,
    /// Moves that do not extrude, mm/s².
    pub travel_acceleration_mm_s2: f64,
    /// Strongest X, Y, Z, E on moves that do not extrude, where the firmware has its own, mm/s².
    pub travel_max_acceleration_mm_s2: Option<[f64; 4]>,
    /// Speeds at corners.
    pub cornering: Cornering,
    /// Steps of X, Y, Z, E per mm (for position reports only).
    pub steps_per_mm: [f64; 4],
    /// Speed of homing X, Y, Z, mm/s.
    pub homing_mm_s: [f64; 3],
    /// Nothing is extruded below this hotend temperature, °C.
    pub min_extrusion_c: f64,
    /// Room temperature, °C.
    pub ambient_c: f64,
    /// Hotend and bed.
    pub heaters: [HeaterData; 2],
    /// By how much a temperature reading may be off, °C.
    pub sensor_noise_c: f64,
    /// Bytes of the serial receive ring.
    pub rx_ring_bytes: usize,
    /// Commands that wait for execution (BUFSIZE).
    pub command_slots: usize,
    /// Blocks of the planner's ring; one of them stays empty (BLOCK_BUFFER_SIZE).
    pub planner_blocks: usize,
    /// Where moves are queued by the time that they take: how much of it, s.
    pub queue_s: Option<f64>,
    /// Longest line, bytes with the terminating zero (MAX_CMD_SIZE).
    pub line_bytes: usize,
    /// Whether opening the port resets the board (its DTR line does).
    pub resets_on_open: bool,
}

const HOTEND: HeaterData = HeaterData {
    id: "E0",
    full_power_c: 420.0,
    tau_s: 150.0,
    max_target_c: 290.0,
    hysteresis_c: 4.0,
    protection_s: 40.0,
    watch_s: 40.0,
};

const BED: HeaterData = HeaterData {
    id: "bed",
    full_power_c: 150.0,
    tau_s: 300.0,
    max_target_c: 125.0,
    hysteresis_c: 2.0,
    protection_s: 20.0,
    watch_s: 60.0,
};

const MARLIN_MACHINE: Profile = Profile {
    name: "marlin",
    dialect: &MARLIN,
    bed_mm: [220.0, 220.0, 250.0],
    filament_mm: 1.75,
    bead_shape: BeadShape::Stadium,
    max_speed_mm_s: [500.0, 500.0, 10.0, 60.0],
    max_acceleration_mm_s2: [3000.0, 3000.0, 100.0, 5000.0],
    print_acceleration_mm_s2: 1000.0,
    retract_acceleration_mm_s2: 3000.0,
    travel_acceleration_mm_s2: 1500.0,
    travel_max_acceleration_mm_s2: None,
    cornering: Cornering::Deviation(0.013),
    steps_per_mm: [80.0, 80.0, 400.0, 500.0],
    homing_mm_s: [50.0, 50.0, 10.0],
    min_extrusion_c: 170.0,
    ambient_c: 21.0,
    heaters: [HOTEND, BED],
    sensor_noise_c: 0.0,
    rx_ring_bytes: 128,
    command_slots: 4,
    planner_blocks: 16,
    queue_s: None,
    line_bytes: 96,
    resets_on_open: false,
};

const MARLIN_1_MACHINE: Profile = Profile {
    name: "marlin1",
    dialect: &MARLIN_1,
    cornering: Cornering::ClassicJerk { axes: [8.0, 8.0, 0.3, 5.0], from_prusa: false },
    ..MARLIN_MACHINE
};

const REPRAPFIRMWARE_MACHINE: Profile = Profile {
    name: "reprapfirmware",
    dialect: &REPRAPFIRMWARE,
    max_speed_mm_s: [300.0, 300.0, 15.0, 60.0],
    max_acceleration_mm_s2: [2500.0, 2500.0, 100.0, 3000.0],
    print_acceleration_mm_s2: 1500.0,
    travel_acceleration_mm_s2: 2500.0,
    cornering: Cornering::InstantChange([9.0, 9.0, 0.5, 5.0]),
    rx_ring_bytes: 1024,
    // A line is read when the one before it is done.
    command_slots: 1,
    planner_blocks: 40,
    line_bytes: 256,
    ..MARLIN_MACHINE
};

/// Every machine there is.
const PROFILES: [Profile; 10] = [
    MARLIN_MACHINE,
    MARLIN_1_MACHINE,
    Profile {
        name: "klipper",
        dialect: &KLIPPER,
        max_speed_mm_s: [300.0, 300.0, 15.0, 75.0],
        max_acceleration_mm_s2: [1e9, 1e9, 100.0, 1e9],
        print_acceleration_mm_s2: 3000.0,
        travel_acceleration_mm_s2: 3000.0,
        retract_acceleration_mm_s2: 1500.0,
        cornering: Cornering::SquareCorner { speed: 5.0, cruise_ratio: 0.5 },
        rx_ring_bytes: 4096,
        command_slots: 16,
        // BUFFER_TIME_HIGH; there is no limit in moves.
        planner_blocks: 8192,
        queue_s: Some(2.0),
        line_bytes: 4096,
        ..MARLIN_MACHINE
    },
    REPRAPFIRMWARE_MACHINE,
    Profile { name: "reprapfirmware-silent", dialect: &REPRAPFIRMWARE_SILENT, ..REPRAPFIRMWARE_MACHINE },
    Profile {
        name: "repetier",
        dialect: &REPETIER,
        bed_mm: [200.0, 200.0, 200.0],
        max_speed_mm_s: [200.0, 200.0, 5.0, 50.0],
        max_acceleration_mm_s2: [1000.0, 1000.0, 100.0, 4000.0],
        print_acceleration_mm_s2: 1e9,
        travel_acceleration_mm_s2: 1e9,
        retract_acceleration_mm_s2: 1e9,
        travel_max_acceleration_mm_s2: Some([1500.0, 1500.0, 100.0, 4000.0]),
        cornering: Cornering::PlanarJerk([20.0, 20.0, 0.3, 20.0]),
        // GCODE_BUFFER_SIZE
        command_slots: 1,
        ..MARLIN_MACHINE
    },
    Profile {
        name: "smoothie",
        dialect: &SMOOTHIE,
        bed_mm: [200.0, 200.0, 200.0],
        max_speed_mm_s: [300.0, 300.0, 8.0, 50.0],
        max_acceleration_mm_s2: [1e9, 1e9, 100.0, 3000.0],
        print_acceleration_mm_s2: 2000.0,
        travel_acceleration_mm_s2: 2000.0,
        cornering: Cornering::SmoothieDeviation(0.05),
        rx_ring_bytes: 256,
        command_slots: 1,
        planner_blocks: 32,
        ..MARLIN_MACHINE
    },
    Profile {
        name: "prusa-mk3s",
        dialect: &PRUSA,
        bed_mm: [250.0, 210.0, 210.0],
        max_speed_mm_s: [200.0, 200.0, 12.0, 120.0],
        max_acceleration_mm_s2: [1000.0, 1000.0, 200.0, 5000.0],
        print_acceleration_mm_s2: 1250.0,
        retract_acceleration_mm_s2: 1250.0,
        travel_acceleration_mm_s2: 1250.0,
        cornering: Cornering::ClassicJerk { axes: [8.0, 8.0, 0.4, 1.5], from_prusa: true },
        ..MARLIN_1_MACHINE
    },
    Profile {
        name: "reference",
        bed_mm: [200.0, 200.0, 250.0],
        bead_shape: BeadShape::Rectangle,
        ..MARLIN_MACHINE
    },
    Profile { name: "abs-enclosed", bed_mm: [254.0, 254.0, 305.0], ambient_c: 45.0, ..MARLIN_MACHINE },
];

impl Profile {
    /// The machine called `name`.
    ///
    /// # Errors
    /// [`Error::UnknownProfile`], which lists the names there are.
    pub fn by_name(name: &str) -> Result<Self, Error> {
        PROFILES.into_iter().find(|profile| profile.name == name).ok_or_else(|| Error::UnknownProfile {
            name: name.to_owned(),
            known: Self::names().collect::<Vec<_>>().join(", "),
        })
    }

    /// The names of all machines.
    pub fn names() -> impl Iterator<Item = &'static str> {
        PROFILES.into_iter().map(|profile| profile.name)
    }

    /// Cross-section of the filament, mm².
    #[must_use]
    pub fn filament_area_mm2(&self) -> f64 {
        std::f64::consts::PI / 4.0 * self.filament_mm * self.filament_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rectangle_is_area_over_height() {
        assert!((BeadShape::Rectangle.width_mm(0.08, 0.2) - 0.4).abs() < 1e-12);
    }

    #[test]
    fn stadium_has_the_area_it_was_given_and_is_continuous_at_the_circle() {
        let (width, height) = (0.45_f64, 0.2_f64);
        let area = height * (width - height) + std::f64::consts::PI / 4.0 * height * height;
        assert!((BeadShape::Stadium.width_mm(area, height) - width).abs() < 1e-12);
        let circle = std::f64::consts::PI / 4.0 * height * height;
        assert!((BeadShape::Stadium.width_mm(circle, height) - height).abs() < 1e-12);
        assert!((BeadShape::Stadium.width_mm(circle * 0.999_999, height) - height).abs() < 1e-6);
    }

    #[test]
    fn unknown_name_lists_the_known_ones() {
        let message = Profile::by_name("gutenberg").unwrap_err().to_string();
        assert!(message.contains("`gutenberg`") && message.contains("reference"), "{message}");
    }
}
