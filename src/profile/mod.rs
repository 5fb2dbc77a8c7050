//! Firmware and machine profiles, as data: `firmware-profiles/*.toml`.
//!
//! A profile says how a printer speaks ([`Firmware`]), what it can do ([`Machine`]), what it prints with
//! ([`Filament`]), how ([`PrintSettings`]) and what it runs before, after and between ([`Scripts`]), and what the report judges
//! a replica by ([`Gate`]). Profiles may inherit: the key
//! `inherits = "marlin"` names the built-in profile whose keys are taken where this one has none.
//!
//! Every file is checked in full before it is used: each key against the table in `schema` (type, unit, range), then the keys
//! against each other. A profile that was loaded can be relied on.
//!
//! ```
//! let profile = lumenfab::profile::builtin("reference")?;
//! assert_eq!(profile.machine.bed_mm, [200.0, 200.0, 250.0]);
//! # Ok::<(), lumenfab::profile::Error>(())
//! ```

mod check;
pub mod gate;
mod layers;
pub mod load;
mod primed;
mod schema;
mod scripts;
#[cfg(test)]
mod tests;

pub use gate::{Gate, Whole};
pub use load::from_file;
pub use primed::Primed;
pub use scripts::ResumePoint;

use crate::units::Celsius;
use layers::Layers;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// The profiles that come with the program: name and text.
const BUILTIN: &[(&str, &str)] = &[
    ("marlin", include_str!("../../firmware-profiles/marlin.toml")),
    ("marlin1", include_str!("../../firmware-profiles/marlin1.toml")),
    ("klipper", include_str!("../../firmware-profiles/klipper.toml")),
    ("reprapfirmware", include_str!("../../firmware-profiles/reprapfirmware.toml")),
    ("repetier", include_str!("../../firmware-profiles/repetier.toml")),
    ("smoothie", include_str!("../../firmware-profiles/smoothie.toml")),
    ("reference", include_str!("../../firmware-profiles/reference.toml")),
    ("abs-enclosed", include_str!("../../firmware-profiles/abs-enclosed.toml")),
    ("prusa-mk3s", include_str!("../../firmware-profiles/prusa-mk3s.toml")),
];

/// A chain of `inherits` longer than this is a mistake.
const MAX_INHERITANCE: usize = 8;

/// What is wrong with a profile.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// No built-in profile has this name.
    #[error("there is no profile {name:?}; built in are {}, a file is given by its path", known.join(", "))]
    UnknownName {
        /// What was asked for.
        name: String,
        /// What there is.
        known: Vec<&'static str>,
    },
    /// The file cannot be read.
    #[error("{}: the profile cannot be read: {source}{}", path.display(), if path.is_relative() { "; it is looked for from where the command is typed: name it with --profile" } else { "" })]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not TOML.
    #[error("{file}:{line}: not a profile: {message}")]
    Syntax {
        /// The file.
        file: String,
        /// The line, from 1.
        line: usize,
        /// What the TOML parser says.
        message: String,
    },
    /// A file of something else.
    #[error(
        "{file}: not a profile: none of its keys is one of a profile's (found {found}); a profile begins with `inherits = \"marlin\"`"
    )]
    Foreign {
        /// The file.
        file: String,
        /// Its first keys.
        found: String,
    },
    /// A key that no profile has.
    #[error("{file}:{line}: {key}: no profile has this key{hint}")]
    UnknownKey {
        /// The file.
        file: String,
        /// The line, from 1.
        line: usize,
        /// The key.
        key: String,
        /// What may have been meant.
        hint: String,
    },
    /// A key that every profile needs.
    #[error("{file}: {key} is missing; expected {expected} (or `inherits = \"marlin\"`)")]
    MissingKey {
        /// The file.
        file: String,
        /// The key.
        key: &'static str,
        /// What it takes.
        expected: String,
    },
    /// A value of the wrong type, out of its range, or at odds with another one.
    #[error("{file}:{line}: {key} = {found}: expected {expected}")]
    Value {
        /// The file.
        file: String,
        /// The line, from 1.
        line: usize,
        /// The key.
        key: String,
        /// The value.
        found: String,
        /// Range and unit.
        expected: String,
    },
    /// Several of these, in one file or in some.
    #[error("{}", told(.0))]
    Several(Vec<Self>),
}

/// More faults than this are not told one by one.
const MOST_FAULTS: usize = 8;

/// Faults line by line.
fn told(faults: &[Error]) -> String {
    let mut lines: Vec<String> = faults.iter().take(MOST_FAULTS).map(Error::to_string).collect();
    if faults.len() > MOST_FAULTS {
        lines.push(format!("and {} more", faults.len() - MOST_FAULTS));
    }
    lines.join("\n")
}

impl Error {
    /// Nothing, the only fault, or all of them.
    ///
    /// # Errors
    /// Where there is any.
    pub fn all_of(mut faults: Vec<Self>) -> Result<(), Self> {
        match faults.len() {
            0 => Ok(()),
            1 => Err(faults.remove(0)),
            _ => Err(Self::Several(faults)),
        }
    }
}

/// The names of the profiles that come with the program.
#[must_use]
pub fn builtin_names() -> Vec<&'static str> {
    BUILTIN.iter().map(|(name, _)| *name).collect()
}

/// A profile that comes with the program.
///
/// # Errors
/// [`Error::UnknownName`].
pub fn builtin(name: &str) -> Result<Profile, Error> {
    parse(builtin_text(name)?, &builtin_file(name))
}

fn builtin_whole(name: &str) -> Result<Whole, Error> {
    parse_whole(builtin_text(name)?, &builtin_file(name))
}

fn builtin_text(name: &str) -> Result<&'static str, Error> {
    let found = BUILTIN.iter().find(|(known, _)| *known == name);
    found
        .map(|(_, text)| *text)
        .ok_or_else(|| Error::UnknownName { name: name.to_owned(), known: builtin_names() })
}

fn builtin_file(name: &str) -> String {
    format!("firmware-profiles/{name}.toml")
}

/// Reads a profile from TOML text; `file` is what errors call it.
///
/// # Errors
/// The text is not TOML, or says something that no printer can be: every key that is wrong by itself, or, where none is, every
/// one that is at odds with others.
pub fn parse(text: &str, file: &str) -> Result<Profile, Error> {
    Ok(parse_whole(text, file)?.profile)
}

/// Reads a profile with its gate, as [`parse`] does.
///
/// # Errors
/// Those of [`parse`].
pub fn parse_whole(text: &str, file: &str) -> Result<Whole, Error> {
    let mut layers = with_bases(text, file)?;
    schema::check_kind(&layers, file)?;
    layers.inherit(usual_gate()?);
    Error::all_of(schema::check(&layers, file))?;
    let mut table = layers.table();
    let gate = table.remove(gate::TABLE).unwrap_or_else(|| toml::Table::new().into());
    let profile: Profile = typed(table.into(), file)?;
    Error::all_of(check::together(&profile, &layers))?;
    Ok(Whole { profile, gate: typed(gate, file)? })
}

/// The limits that hold where a profile names no others.
fn usual_gate() -> Result<Layers, Error> {
    let mut layers = Layers::parse(builtin_text("marlin")?, &builtin_file("marlin"))?;
    layers.keys.retain(|key, _| key.split('.').next() == Some(gate::TABLE));
    Ok(layers)
}

fn typed<T: serde::de::DeserializeOwned>(value: toml::Value, file: &str) -> Result<T, Error> {
    value.try_into().map_err(|e: toml::de::Error| Error::Syntax {
        file: file.to_owned(),
        line: 1,
        message: e.to_string().trim().replace('\n', "; "),
    })
}

/// The keys of a file over those of all it inherits from.
fn with_bases(text: &str, file: &str) -> Result<Layers, Error> {
    let mut layers = Layers::parse(text, file)?;
    let is_named = layers.keys.contains_key("name");
    for _ in 0..MAX_INHERITANCE {
        let Some((base, origin)) = layers.keys.remove("inherits") else { return Ok(layers) };
        let known = || format!("the name of a built-in profile: {}", builtin_names().join(", "));
        let Some(name) = base.as_str().filter(|name| builtin_text(name).is_ok()) else {
            return Err(schema::wrong("inherits", &base.to_string(), known(), &origin));
        };
        if !is_named {
            // It is not the one that it inherits from, and its file's name may tell of whoever it is for.
            let own = || (toml::Value::String(format!("{name}, changed")), origin.clone());
            layers.keys.entry("name".to_owned()).or_insert_with(own);
        }
        layers.inherit(Layers::parse(builtin_text(name)?, &builtin_file(name))?);
    }
    Err(Error::Syntax {
        file: file.to_owned(),
        line: 1,
        message: format!("profiles inherit from each other more than {MAX_INHERITANCE} deep"),
    })
}

/// What `N1234567 ` and `*255` add to a line.
pub(crate) const NUMBERING_BYTES: usize = 13;

/// The profile as text: all keys, inherited ones too, but for the gate.
///
/// # Panics
/// Never: every profile is a TOML table.
#[must_use]
pub fn to_toml(profile: &Profile) -> String {
    let value = toml::Value::try_from(profile).expect("a profile is a TOML table");
    toml::to_string(&value).expect("a TOML table can be written")
}

/// Everything that is known about a printer and how to print on it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// The name it is chosen by; of a file without one, that of the profile it inherits from, and that it is changed.
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

/// Which firmware it is: what commands mean, and how limits are told to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Dialect {
    /// Marlin 2.
    Marlin,
    /// Marlin 1 and what descends from it.
    Marlin1,
    /// Klipper.
    Klipper,
    /// RepRapFirmware 3.
    RepRapFirmware,
    /// Repetier-Firmware.
    Repetier,
    /// Smoothieware.
    Smoothie,
}

impl Dialect {
    /// The words for the rules of corners that the firmware knows.
    const fn cornerings(self) -> &'static [Cornering] {
        match self {
            Self::Marlin => &[Cornering::JunctionDeviation, Cornering::Jerk],
            Self::Marlin1 | Self::RepRapFirmware | Self::Repetier => &[Cornering::Jerk],
            Self::Klipper => &[Cornering::SquareCorner],
            Self::Smoothie => &[Cornering::JunctionDeviation],
        }
    }
}

/// The rule by which the firmware finds the speed at a corner.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cornering {
    /// `junction_deviation_mm`.
    JunctionDeviation,
    /// `jerk_mm_s`.
    Jerk,
    /// `square_corner_mm_s`.
    SquareCorner,
}

/// How the firmware is told how far the job has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ProgressReport {
    /// `M73 P12 R34`: percent and minutes left.
    M73,
    /// As a message on the display.
    M117,
    /// Not at all.
    None,
}

/// How the firmware is told what belongs to an object, so that it can be left out later.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ObjectLabels {
    /// `M486 S0` and `M486 S-1`.
    M486,
    /// `EXCLUDE_OBJECT_START` and `EXCLUDE_OBJECT_END`.
    ExcludeObject,
    /// Not at all.
    None,
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
    /// `marlin`, ...: which firmware it is.
    pub dialect: Dialect,
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
    /// Longest line it takes, bytes without the line feed, number and checksum included.
    pub line_bytes: usize,
    /// How long a reply may take before the host asks what is wrong, s.
    pub response_timeout_s: f64,
    /// How long commands that wait (homing, heating) may take in all, s.
    pub slow_command_timeout_s: f64,
    /// How long the board may take to speak after a reset, s.
    pub boot_timeout_s: f64,
    /// Whether opening the port shall reset the board (by DTR).
    pub reset_on_open: bool,
    /// How long the heaters of an interrupted print stay on, so that it can be continued warm, s; then they go off.
    /// 0: a print whose port vanishes is given up at once, and the firmware is told no time-out.
    pub orphan_hold_s: f64,
    /// Whether the firmware's own time-out is set to that time at the beginning of a job, where it has one.
    pub orphan_guard: bool,
    /// Interval of temperature reports asked for, s; 0: never ask.
    pub temperature_report_s: f64,
    /// Moves a second that wire and planner take without running dry.
    pub segments_per_s: f64,
    /// Whether bends are written as arcs (G2, G3).
    pub arcs: bool,
    /// Longest chord in which it drives an arc, mm.
    pub arc_segment_mm: f64,
    /// Fewest chords in which it drives a whole circle.
    pub arc_segments_per_circle: u32,
    /// Farthest that its chords leave an arc where it limits that, mm; 0: it does not.
    pub arc_deviation_mm: f64,
    /// How it is told how far the job has come.
    pub progress: ProgressReport,
    /// How it is told what belongs to the object.
    pub object_labels: ObjectLabels,
}

impl Firmware {
    /// Whether it keeps count of its lines. RepRapFirmware checks the sums of numbered lines and not their numbers: a line that comes
    /// twice is done twice, one that is lost is not missed, and no question makes it name its last.
    #[must_use]
    pub const fn counts_lines(&self) -> bool {
        self.line_numbers && !matches!(self.dialect, Dialect::RepRapFirmware)
    }

    /// The longest chord in which it drives an arc of a radius, mm.
    #[must_use]
    pub fn arc_chord_mm(&self, radius_mm: f64) -> f64 {
        let of_circle = std::f64::consts::TAU * radius_mm / f64::from(self.arc_segments_per_circle);
        let longest = self.arc_segment_mm.min(of_circle);
        if self.arc_deviation_mm > 0.0 {
            longest.min((8.0 * radius_mm * self.arc_deviation_mm).sqrt())
        } else {
            longest
        }
    }
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
    /// Acceleration of moves of the filament alone.
    pub retract_acceleration_mm_s2: f64,
    /// Which of the next three the firmware goes by.
    pub cornering: Cornering,
    /// Junction deviation (how far a corner may be cut in the firmware's speed model), mm.
    pub junction_deviation_mm: f64,
    /// Change of speed of x, y, z, e that is allowed at once, mm/s.
    pub jerk_mm_s: [f64; 4],
    /// Speed at which a right angle is taken.
    pub square_corner_mm_s: f64,
    /// How long homing all axes takes, s.
    pub homing_s: f64,
    /// How fast nozzle and bed warm up on the way to their temperatures, K/s.
    pub heating_k_s: [f64; 2],
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
    /// Part-cooling fan in short layers, percent.
    pub fan_percent: f64,
    /// Part-cooling fan in long layers, percent.
    pub fan_least_percent: f64,
    /// A layer as short as the first is short, one as long as the second is long, s; between them the fan is between.
    pub fan_layer_time_s: [f64; 2],
    /// Part-cooling fan while lines over air are laid, percent.
    pub bridge_fan_percent: f64,
    /// The first layer, counted from 0, with the fan on.
    pub fan_from_layer: u32,
    /// Flow correction, percent; 100 is what the bead model says.
    pub flow_percent: f64,
    /// Linear shrinkage when the part cools, percent.
    pub shrinkage_percent: f64,
    /// Most that the hotend melts, mm³/s: wider and higher beads are driven slower.
    pub max_flow_mm3_s: f64,
}

impl Filament {
    /// `speed_mm_s`, or what the hotend melts for a bead of this cross-section where that is slower.
    #[must_use]
    pub fn speed_within_flow_mm_s(&self, speed_mm_s: f64, area_mm2: f64) -> f64 {
        let flowing_mm2 = area_mm2 * self.flow_percent / 100.0;
        speed_mm_s.min(self.max_flow_mm3_s / flowing_mm2.max(1e-9))
    }
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

/// What holds overhangs up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SupportStyle {
    /// Nothing.
    None,
    /// Columns that break away.
    Column,
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
    /// Thickness of floors and roofs of fill that is not full, mm; 0: none.
    pub shell_mm: f64,
    /// Speed of contours at the skins.
    pub external_perimeter_mm_s: f64,
    /// Speed of the other contours.
    pub perimeter_mm_s: f64,
    /// Speed of raster fill.
    pub infill_mm_s: f64,
    /// Contours shorter than this, all around, are small features, mm; 0: none is.
    pub small_loop_mm: f64,
    /// Speed of these.
    pub small_loop_mm_s: f64,
    /// Speed of lines over air.
    pub bridge_mm_s: f64,
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
    /// A layer takes at least this long, s: driven slower where it would not.
    pub min_layer_time_s: f64,
    /// Whether what it lacks at the slowest speed is waited for, the nozzle aside where there is room.
    pub min_layer_time_wait: bool,
    /// Slowest speed that the minimum layer time may ask for.
    pub min_speed_mm_s: f64,
    /// Way that the nozzle goes back along its bead while it retracts, mm; 0: none.
    pub wipe_mm: f64,
    /// How far a written path may lie off the planned one, mm, for arcs and for fewer segments.
    pub tolerance_mm: f64,
    /// Loops of skirt around the first layer.
    pub skirt_loops: u32,
    /// Distance of the skirt from the part, mm.
    pub skirt_distance_mm: f64,
    /// Width of the brim, mm; 0: none.
    pub brim_mm: f64,
    /// A part higher than so many times the width that it stands on gets a brim, or a wider one; 0: never.
    pub brim_slenderness: f64,
    /// Layers of a raft below the part; 0: none.
    pub raft_layers: u32,
    /// How far the raft reaches beyond what stands on it, mm.
    pub raft_margin_mm: f64,
    /// Air between raft and part, mm.
    pub raft_gap_mm: f64,
    /// What holds overhangs up.
    pub support: SupportStyle,
    /// Walls that lean farther from the vertical are held up, degrees.
    pub support_overhang_deg: f64,
    /// Air between supports and part, sideways, mm.
    pub support_gap_mm: f64,
    /// Fill of supports, percent.
    pub support_percent: f64,
    /// Whether supports may stand in the lumen: they have to be taken out again.
    pub support_in_lumen: bool,
    /// Whether supports may stand on the part, where marks are left; else they stand on the bed alone.
    pub support_on_part: bool,
    /// Whether slender branches are steadied by ribs outside that break away.
    pub ribs: bool,
    /// A branch higher than so many times its width above its last joint is slender.
    pub rib_slenderness: f64,
    /// Longest bar over air that steadies one, mm.
    pub rib_span_mm: f64,
    /// Move of all outlines against what beads bulge beyond the width that their model gives them, mm, into the material
    /// positive.
    pub squeeze_compensation_mm: f64,
    /// Move of a contour at the lumen against hole shrinkage, mm, into the wall positive.
    pub hole_compensation_mm: f64,
    /// Move of the first layer's outline against its spread, mm, inward positive.
    pub first_layer_compensation_mm: f64,
}

/// G-code run around a job, line by line. `{hotend_c}`, `{bed_c}` stand for the filament's first-layer
/// temperatures, `{bed_x_mm}`, `{bed_y_mm}`, `{bed_z_mm}` for the size of the bed, `{park_z_mm}` for a height above the
/// finished part within it.
/// [`Profile::start_gcode`] and its sisters fill them in.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scripts {
    /// Before the first layer.
    pub start: Vec<String>,
    /// After the last layer.
    pub end: Vec<String>,
    /// When a print is given up: heaters off, no moves.
    pub safe: Vec<String>,
    /// When a print is paused, once what the printer had taken is done: away from the part. Empty: it stays where it is. The
    /// placeholders are those of `recovery`, for the place where the print stands; the heaters stay as they are.
    pub pause: Vec<String>,
    /// Before it goes on: back to that place. Modes, filament's place and speed are restored behind it.
    pub resume: Vec<String>,
    /// Before a print goes on after the firmware or the power failed; empty: it cannot. The printer knows nothing any more;
    /// nozzle and part are where they were. Besides the other placeholders: `{resume_x_mm}`, `{resume_y_mm}`,
    /// `{resume_z_mm}`, the place where it goes on; `{resume_nozzle_z_mm}`, the height at which the nozzle stands;
    /// `{resume_clear_z_mm}`, above all that is printed; `{resume_hotend_c}`,
    /// `{resume_bed_c}`, the temperatures there. Modes, fan, filament's place and speed are restored behind it.
    pub recovery: Vec<String>,
}
