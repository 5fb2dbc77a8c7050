//! Firmware and machine profiles, as data: `firmware-profiles/*.toml`.
//!
//! A profile says how a printer speaks ([`Firmware`]), what it can do ([`Machine`]), what it prints with
//! ([`Filament`]), how ([`PrintSettings`]) and what it runs before, after and between ([`Scripts`]). Profiles may inherit: the key
//! `inherits = "marlin"` names the profile whose keys are taken where this one has none.

use crate::units::Celsius;
use serde::{Deserialize, Serialize};

/// Everything that is known about a printer and how to print on it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// The name it is chosen by.
    pub name: String,
    /// One line for the operator.
    pub description: String,
    /// How it speaks.
    pub firmware: Firmware,
    /// What it can do.
    pub machine: Machine,
    /// What it prints with.
    pub filament: Filament,
    /// How it prints.
    pub print: PrintSettings,
    /// G-code that is run around a job.
    pub scripts: Scripts,
}

/// How the firmware writes a request to send a line again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ResendStyle {
    /// `Resend: 12` or `Resend:12`, followed by `ok`.
    Resend,
    /// `rs 12` or `rs N12`.
    Rs,
}

/// The firmware's side of the wire.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Firmware {
    /// `marlin`, ...: the dialect, also the simulator's.
    pub dialect: String,
    /// Default speed of the port.
    pub baud: u32,
    /// Whether lines carry numbers and checksums.
    pub line_numbers: bool,
    /// How it asks for a line again.
    pub resend_style: ResendStyle,
    /// Bytes of its serial receive buffer: never more than that unacknowledged on the wire.
    pub rx_buffer_bytes: usize,
    /// Lines that it may hold before they are executed (BUFSIZE).
    pub command_slots: usize,
    /// Moves that its planner looks ahead.
    pub planner_moves: usize,
    /// Longest line it takes, bytes without the line feed.
    pub line_bytes: usize,
    /// How long a reply may take before the host asks what is wrong, s.
    pub response_timeout_s: f64,
    /// How long commands that wait (homing, heating) may take in all, s.
    pub slow_command_timeout_s: f64,
    /// Interval of temperature reports asked for, s; 0: never ask.
    pub temperature_report_s: f64,
}

/// What the machine can do. Lengths mm, speeds mm/s, accelerations mm/s².
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Machine {
    /// Size of the build space along x, y, z, mm; its origin is the bed's front left corner.
    pub bed_mm: [f64; 3],
    /// Nozzle diameter, mm.
    pub nozzle_mm: f64,
    /// Filament diameter, mm.
    pub filament_mm: f64,
    /// Thinnest and thickest layer, mm.
    pub layer_height_mm: [f64; 2],
    /// Narrowest and widest bead, mm.
    pub extrusion_width_mm: [f64; 2],
    /// Highest speed of x, y, z, e, mm/s.
    pub max_speed_mm_s: [f64; 4],
    /// Highest acceleration of x, y, z, e, mm/s².
    pub max_acceleration_mm_s2: [f64; 4],
    /// Acceleration of printing moves, mm/s².
    pub print_acceleration_mm_s2: f64,
    /// Acceleration of travels, mm/s².
    pub travel_acceleration_mm_s2: f64,
    /// Junction deviation (how far a corner may be cut in the firmware's speed model), mm.
    pub junction_deviation_mm: f64,
}

/// The material.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Filament {
    /// `PLA`, `ABS`, ...
    pub material: String,
    /// Density, g/cm³.
    pub density_g_cm3: f64,
    /// Nozzle temperature.
    pub hotend_c: Celsius,
    /// Nozzle temperature in the first layer.
    pub first_layer_hotend_c: Celsius,
    /// Bed temperature.
    pub bed_c: Celsius,
    /// Bed temperature in the first layer.
    pub first_layer_bed_c: Celsius,
    /// Part-cooling fan, percent, from the second layer on.
    pub fan_percent: f64,
    /// Flow correction, percent; 100 is what the bead model says.
    pub flow_percent: f64,
    /// Linear shrinkage when the part cools, percent.
    pub shrinkage_percent: f64,
}

/// The cross-section that a bead is taken to have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BeadShape {
    /// Width times height.
    Rectangle,
    /// A rectangle with half-circles at its sides: (w - h) h + pi h² / 4.
    Stadium,
}

/// How to print. Speeds mm/s, lengths mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PrintSettings {
    /// The cross-section of a bead.
    pub bead_shape: BeadShape,
    /// Wanted extrusion width, mm.
    pub extrusion_width_mm: f64,
    /// Perimeters along each skin.
    pub perimeters: u32,
    /// Fill of what the perimeters leave, percent.
    pub infill_percent: f64,
    /// Speed of contours at the skins.
    pub external_perimeter_mm_s: f64,
    /// Speed of the other contours.
    pub perimeter_mm_s: f64,
    /// Speed of raster fill.
    pub infill_mm_s: f64,
    /// Speed of everything in the first layer.
    pub first_layer_mm_s: f64,
    /// Speed of travels.
    pub travel_mm_s: f64,
    /// Retracted length, mm; 0: none.
    pub retract_mm: f64,
    /// Speed of retraction.
    pub retract_mm_s: f64,
    /// Travels shorter than this are not retracted, mm.
    pub retract_min_travel_mm: f64,
    /// Lift of the nozzle while it travels retracted, mm.
    pub z_hop_mm: f64,
    /// A layer takes at least this long, s: slower where it would not.
    pub min_layer_time_s: f64,
    /// Slowest speed that the minimum layer time may ask for.
    pub min_speed_mm_s: f64,
    /// Loops of skirt around the first layer.
    pub skirt_loops: u32,
    /// Distance of the skirt from the part, mm.
    pub skirt_distance_mm: f64,
    /// Width of the brim, mm; 0: none.
    pub brim_mm: f64,
    /// Move of a contour at the lumen against hole shrinkage, mm, into the wall positive.
    pub hole_compensation_mm: f64,
    /// Move of the first layer's outline against its spread, mm, inward positive.
    pub first_layer_compensation_mm: f64,
}

/// G-code run around a job, line by line. `{hotend_c}`, `{bed_c}` stand for the filament's first-layer temperatures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scripts {
    /// Before the first layer.
    pub start: Vec<String>,
    /// After the last layer.
    pub end: Vec<String>,
    /// When a print is given up: heaters off, no moves.
    pub safe: Vec<String>,
}
