//! What every key of a profile may hold: type, unit, range.
//!
//! One table is the whole truth; the check, the error messages and the list of known keys derive from it.
//! Ranges are wide: they catch a wrong unit or a slip of a digit, not an unusual machine.

use super::Error;
use super::layers::{Layers, Origin};
use super::scripts;
use crate::nearest::nearest;
use toml::Value;

/// The kind of value that a key takes.
#[derive(Debug, Clone, Copy)]
pub(super) enum Kind {
    /// Any text that is not empty.
    Text,
    /// One of these words.
    Choice(&'static [&'static str]),
    /// `true` or `false`.
    Flag,
    /// A whole number.
    Whole { min: u32, max: u32 },
    /// A number.
    Number { min: f64, max: f64 },
    /// So many numbers, each in the range.
    Numbers { n: usize, min: f64, max: f64 },
    /// Two numbers in the range, the first not above the second.
    Span { min: f64, max: f64 },
    /// Lines of G-code.
    Script,
}

/// One key.
#[derive(Debug, Clone, Copy)]
pub(super) struct Field {
    pub(super) key: &'static str,
    pub(super) unit: &'static str,
    pub(super) kind: Kind,
}

const fn field(key: &'static str, unit: &'static str, kind: Kind) -> Field {
    Field { key, unit, kind }
}

const fn number(min: f64, max: f64) -> Kind {
    Kind::Number { min, max }
}

const fn whole(min: u32, max: u32) -> Kind {
    Kind::Whole { min, max }
}

/// Every key of a profile.
pub(super) const FIELDS: &[Field] = &[
    field("name", "", Kind::Text),
    field("description", "", Kind::Text),
    field(
        "firmware.dialect",
        "",
        Kind::Choice(&["marlin", "marlin1", "klipper", "reprapfirmware", "repetier", "smoothie"]),
    ),
    field("firmware.baud", "baud", whole(1200, 4_000_000)),
    field("firmware.line_numbers", "", Kind::Flag),
    field("firmware.resend_style", "", Kind::Choice(&["resend", "rs"])),
    field("firmware.rx_buffer_bytes", "bytes", whole(32, 1_048_576)),
    field("firmware.command_slots", "lines", whole(1, 1024)),
    field("firmware.planner_moves", "moves", whole(1, 4096)),
    field("firmware.line_bytes", "bytes", whole(40, 4096)),
    field("firmware.response_timeout_s", "s", number(0.1, 60.0)),
    field("firmware.slow_command_timeout_s", "s", number(10.0, 86_400.0)),
    field("firmware.boot_timeout_s", "s", number(0.1, 60.0)),
    field("firmware.reset_on_open", "", Kind::Flag),
    field("firmware.orphan_hold_s", "s", number(0.0, 86_400.0)),
    field("firmware.orphan_guard", "", Kind::Flag),
    field("firmware.temperature_report_s", "s", number(0.0, 60.0)),
    field("firmware.segments_per_s", "moves/s", number(10.0, 100_000.0)),
    field("firmware.arcs", "", Kind::Flag),
    field("firmware.arc_segment_mm", "mm", number(0.01, 100.0)),
    field("firmware.arc_segments_per_circle", "chords", whole(1, 10_000)),
    field("firmware.arc_deviation_mm", "mm", number(0.0, 1.0)),
    field("firmware.progress", "", Kind::Choice(&["m73", "m117", "none"])),
    field("firmware.object_labels", "", Kind::Choice(&["m486", "exclude-object", "none"])),
    field("machine.bed_mm", "mm", Kind::Numbers { n: 3, min: 10.0, max: 5000.0 }),
    field("machine.nozzle_mm", "mm", number(0.05, 3.0)),
    field("machine.filament_mm", "mm", number(0.5, 5.0)),
    field("machine.layer_height_mm", "mm", Kind::Span { min: 0.01, max: 3.0 }),
    field("machine.extrusion_width_mm", "mm", Kind::Span { min: 0.05, max: 6.0 }),
    field("machine.max_speed_mm_s", "mm/s", Kind::Numbers { n: 4, min: 0.1, max: 5000.0 }),
    field("machine.max_acceleration_mm_s2", "mm/s2", Kind::Numbers { n: 4, min: 1.0, max: 500_000.0 }),
    field("machine.print_acceleration_mm_s2", "mm/s2", number(1.0, 500_000.0)),
    field("machine.travel_acceleration_mm_s2", "mm/s2", number(1.0, 500_000.0)),
    field("machine.retract_acceleration_mm_s2", "mm/s2", number(1.0, 500_000.0)),
    field("machine.cornering", "", Kind::Choice(&["junction-deviation", "jerk", "square-corner"])),
    field("machine.junction_deviation_mm", "mm", number(0.001, 1.0)),
    field("machine.jerk_mm_s", "mm/s", Kind::Numbers { n: 4, min: 0.01, max: 500.0 }),
    field("machine.square_corner_mm_s", "mm/s", number(0.1, 500.0)),
    field("machine.homing_s", "s", number(0.0, 3600.0)),
    field("machine.heating_k_s", "K/s", Kind::Numbers { n: 2, min: 0.01, max: 100.0 }),
    field("filament.material", "", Kind::Text),
    field("filament.density_g_cm3", "g/cm3", number(0.1, 25.0)),
    field("filament.hotend_c", "degrees Celsius", number(0.0, 500.0)),
    field("filament.first_layer_hotend_c", "degrees Celsius", number(0.0, 500.0)),
    field("filament.bed_c", "degrees Celsius", number(0.0, 200.0)),
    field("filament.first_layer_bed_c", "degrees Celsius", number(0.0, 200.0)),
    field("filament.fan_percent", "percent", number(0.0, 100.0)),
    field("filament.fan_least_percent", "percent", number(0.0, 100.0)),
    field("filament.fan_layer_time_s", "s", Kind::Span { min: 0.0, max: 3600.0 }),
    field("filament.bridge_fan_percent", "percent", number(0.0, 100.0)),
    field("filament.fan_from_layer", "layers", whole(0, 10_000)),
    field("filament.flow_percent", "percent", number(50.0, 150.0)),
    field("filament.shrinkage_percent", "percent", number(-2.0, 5.0)),
    field("filament.max_flow_mm3_s", "mm3/s", number(0.1, 1000.0)),
    field("print.bead_shape", "", Kind::Choice(&["rectangle", "stadium"])),
    field("print.extrusion_width_mm", "mm", number(0.05, 6.0)),
    field("print.perimeters", "loops", whole(1, 100)),
    field("print.infill_percent", "percent", number(0.0, 100.0)),
    field("print.shell_mm", "mm", number(0.0, 100.0)),
    field("print.external_perimeter_mm_s", "mm/s", number(0.5, 1000.0)),
    field("print.perimeter_mm_s", "mm/s", number(0.5, 1000.0)),
    field("print.infill_mm_s", "mm/s", number(0.5, 1000.0)),
    field("print.small_loop_mm", "mm", number(0.0, 1000.0)),
    field("print.small_loop_mm_s", "mm/s", number(0.5, 1000.0)),
    field("print.bridge_mm_s", "mm/s", number(0.5, 1000.0)),
    field("print.first_layer_mm_s", "mm/s", number(0.5, 1000.0)),
    field("print.travel_mm_s", "mm/s", number(0.5, 2000.0)),
    field("print.retract_mm", "mm", number(0.0, 20.0)),
    field("print.retract_mm_s", "mm/s", number(0.5, 200.0)),
    field("print.retract_min_travel_mm", "mm", number(0.0, 100.0)),
    field("print.z_hop_mm", "mm", number(0.0, 10.0)),
    field("print.min_layer_time_s", "s", number(0.0, 600.0)),
    field("print.min_layer_time_wait", "", Kind::Flag),
    field("print.min_speed_mm_s", "mm/s", number(0.5, 200.0)),
    field("print.wipe_mm", "mm", number(0.0, 20.0)),
    field("print.tolerance_mm", "mm", number(0.0005, 0.1)),
    field("print.skirt_loops", "loops", whole(0, 100)),
    field("print.skirt_distance_mm", "mm", number(0.0, 100.0)),
    field("print.brim_mm", "mm", number(0.0, 100.0)),
    field("print.brim_slenderness", "", number(0.0, 1000.0)),
    field("print.raft_layers", "layers", whole(0, 100)),
    field("print.raft_margin_mm", "mm", number(0.0, 100.0)),
    field("print.raft_gap_mm", "mm", number(0.0, 2.0)),
    field("print.support", "", Kind::Choice(&["none", "column"])),
    field("print.support_overhang_deg", "degrees", number(1.0, 85.0)),
    field("print.support_gap_mm", "mm", number(0.0, 5.0)),
    field("print.support_percent", "percent", number(1.0, 100.0)),
    field("print.support_in_lumen", "", Kind::Flag),
    field("print.support_on_part", "", Kind::Flag),
    field("print.ribs", "", Kind::Flag),
    field("print.rib_slenderness", "", number(1.0, 1000.0)),
    field("print.rib_span_mm", "mm", number(2.0, 50.0)),
    field("print.squeeze_compensation_mm", "mm", number(-1.0, 1.0)),
    field("print.hole_compensation_mm", "mm", number(-1.0, 1.0)),
    field("print.first_layer_compensation_mm", "mm", number(-1.0, 1.0)),
    field("gate.total_p95_mm", "mm", number(0.001, 10.0)),
    field("gate.stage_mean_mm", "mm", number(0.001, 10.0)),
    field("gate.total_dice", "", number(0.0, 1.0)),
    field("gate.layer_iou", "", number(0.0, 1.0)),
    field("gate.outline_mm", "mm", number(0.001, 10.0)),
    field("gate.lumen_volume_percent", "percent", number(0.01, 100.0)),
    field("gate.diameter_percent", "percent", number(0.01, 100.0)),
    field("gate.stenosis_points", "percentage points", number(0.01, 100.0)),
    field("gate.wall_percent", "percent", number(0.0, 100.0)),
    field("gate.layer_shift_mm", "mm", number(0.001, 10.0)),
    field("gate.flow_percent", "percent", number(0.01, 100.0)),
    field("gate.extra_mm3", "mm3", number(0.0, 1000.0)),
    field("scripts.start", "", Kind::Script),
    field("scripts.end", "", Kind::Script),
    field("scripts.safe", "", Kind::Script),
    field("scripts.pause", "", Kind::Script),
    field("scripts.resume", "", Kind::Script),
    field("scripts.recovery", "", Kind::Script),
];

/// Refuses a file of which no key is a profile's: one of something else, in which every key would be a fault.
pub(super) fn check_kind(layers: &Layers, file: &str) -> Result<(), Error> {
    let is_known = |key: &String| FIELDS.iter().any(|f| f.key == key);
    if layers.keys.is_empty() || layers.keys.keys().any(is_known) {
        return Ok(());
    }
    let found = layers.keys.keys().take(3).map(String::as_str).collect::<Vec<_>>().join(", ");
    Err(Error::Foreign { file: file.to_owned(), found })
}

/// Checks every key by itself: all there, none unknown, each of its type and in its range. Every fault is told.
pub(super) fn check(layers: &Layers, file: &str) -> Vec<Error> {
    let is_known = |key: &str| FIELDS.iter().any(|f| f.key == key);
    let unknown = layers.keys.iter().filter(|(key, _)| !is_known(key));
    let unknown = unknown.map(|(key, (_, origin))| unknown_key(key, origin));
    unknown.chain(FIELDS.iter().filter_map(|field| field.fault(layers, file))).collect()
}

/// An error at a key.
pub(super) fn wrong(key: &str, found: &str, expected: String, origin: &Origin) -> Error {
    Error::Value {
        file: origin.file.clone(),
        line: origin.line,
        key: key.to_owned(),
        found: found.to_owned(),
        expected,
    }
}

fn script_fault(key: &str, value: &Value, origin: &Origin) -> Option<Error> {
    let mut lines = value.as_array().into_iter().flatten().filter_map(Value::as_str);
    let (line, name) =
        lines.find_map(|line| scripts::unknown_placeholder(key, line).map(|name| (line, name)))?;
    let expected = format!("one of {{{}}}", scripts::placeholders(key).join("}, {"));
    Some(wrong(key, &format!("{{{name}}} in {line:?}"), expected, origin))
}

fn unknown_key(key: &str, origin: &Origin) -> Error {
    let near = nearest(key, FIELDS.iter().map(|field| field.key));
    Error::UnknownKey {
        file: origin.file.clone(),
        line: origin.line,
        key: key.to_owned(),
        hint: near.map_or_else(String::new, |k| format!(" (did you mean {k}?)")),
    }
}

/// A value as the operator wrote it, shortened.
fn shown(value: &Value) -> String {
    // In one line: TOML writes texts with line breaks over several.
    let text = value.as_str().map_or_else(|| value.to_string(), |text| format!("{text:?}"));
    if text.chars().count() <= 60 {
        return text;
    }
    text.chars().take(57).chain("...".chars()).collect()
}

impl Field {
    /// What is wrong with this key, if anything is.
    fn fault(&self, layers: &Layers, file: &str) -> Option<Error> {
        let Some((value, origin)) = layers.keys.get(self.key) else {
            let (file, expected) = (file.to_owned(), self.expected());
            return Some(Error::MissingKey { file, key: self.key, expected });
        };
        if !self.kind.accepts(value) {
            return Some(wrong(self.key, &shown(value), self.expected(), origin));
        }
        matches!(self.kind, Kind::Script).then(|| script_fault(self.key, value, origin)).flatten()
    }

    /// What the key takes, in words.
    pub(super) fn expected(&self) -> String {
        let unit = if self.unit.is_empty() { String::new() } else { format!(" {}", self.unit) };
        match self.kind {
            Kind::Text => "a text of one line that is not empty".to_owned(),
            Kind::Choice(words) => format!("one of {}", words.join(", ")),
            Kind::Flag => "true or false".to_owned(),
            Kind::Whole { min, max } => format!("a whole number from {min} to {max}{unit}"),
            Kind::Number { min, max } => format!("a number from {min} to {max}{unit}"),
            Kind::Numbers { n, min, max } => format!("{n} numbers from {min} to {max}{unit}"),
            Kind::Span { min, max } => {
                format!("two numbers from {min} to {max}{unit}, the smaller one first")
            }
            Kind::Script => "a list of G-code lines without line breaks or comments".to_owned(),
        }
    }
}

impl Kind {
    fn accepts(self, value: &Value) -> bool {
        match self {
            // A line break would begin a command where the text stands in a comment.
            Self::Text => {
                value.as_str().is_some_and(|s| !s.trim().is_empty() && !s.contains(char::is_control))
            }
            Self::Choice(words) => value.as_str().is_some_and(|s| words.contains(&s)),
            Self::Flag => value.is_bool(),
            Self::Whole { min, max } => {
                value.as_integer().is_some_and(|i| (i64::from(min)..=i64::from(max)).contains(&i))
            }
            Self::Number { min, max } => in_range(value, min, max),
            Self::Numbers { n, min, max } => numbers_in_range(value, n, min, max),
            Self::Span { min, max } => {
                numbers_in_range(value, 2, min, max)
                    && value.as_array().is_some_and(|a| as_number(&a[0]) <= as_number(&a[1]))
            }
            Self::Script => value.as_array().is_some_and(|a| a.iter().all(is_script_line)),
        }
    }
}

fn as_number(value: &Value) -> Option<f64> {
    match *value {
        Value::Float(number) => Some(number),
        // TOML integers beyond 2^53 lie outside every range here, so the rounding does no harm.
        Value::Integer(whole) => Some(whole as f64),
        _ => None,
    }
}

fn in_range(value: &Value, min: f64, max: f64) -> bool {
    as_number(value).is_some_and(|number| (min..=max).contains(&number))
}

fn numbers_in_range(value: &Value, n: usize, min: f64, max: f64) -> bool {
    value.as_array().is_some_and(|a| a.len() == n && a.iter().all(|v| in_range(v, min, max)))
}

fn is_script_line(value: &Value) -> bool {
    value.as_str().is_some_and(|line| {
        !line.trim().is_empty() && line.bytes().all(|b| (b' '..0x7f).contains(&b) && b != b';' && b != b'*')
    })
}
