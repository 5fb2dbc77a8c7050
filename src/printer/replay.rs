//! What a job has brought about after some of its lines: the state that a firmware which has executed them is in.
//!
//! Commands go in one by one, as [`super::job::Job`] gives them; place, modes, speed, fan and temperatures come out.
//! What cannot be known from the job (where an axis is after homing, until the next absolute move) is `None`, never guessed.
//!
//! Lengths mm in the job's own coordinates (after its `G92`), feedrates mm/min, temperatures °C. Arcs end where they say;
//! the way between is not followed. Offsets that the operator has set at the printer are not known here.

mod tail;

pub use tail::{Queue, Tail};

use crate::gcode::reader::{self, Command};
use crate::profile::Dialect;
use crate::units::mm_s_from_mm_min;
use serde::Serialize;

/// A shorter move may be merged into the next one by the firmware instead of taking a place in its planner, mm.
const SURE_BLOCK_MM: f64 = 0.1;

/// What a command does to the planner. Times are the least that it takes: a machine moves no faster than it is told, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Effect {
    /// It takes a place of its own.
    Block {
        /// See above.
        least_s: f64,
    },
    /// It takes several, nobody knows how many.
    Arc {
        /// See above.
        least_s: f64,
    },
    /// It may take one, or be merged into the next move.
    Short {
        /// See above.
        least_s: f64,
    },
    /// It ends only when all moves before it have ended.
    Drains,
    /// It moves nothing.
    Other,
}

impl Effect {
    /// The least that it takes, s.
    #[must_use]
    pub const fn least_s(self) -> f64 {
        match self {
            Self::Block { least_s } | Self::Arc { least_s } | Self::Short { least_s } => least_s,
            Self::Drains | Self::Other => 0.0,
        }
    }
}

/// Which commands change how the filament's numbers are meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Filament {
    /// G90 and G91 set it along with the axes; M82 and M83 set it alone (Marlin 2, Smoothieware).
    SetByBoth,
    /// It is relative while either is (Marlin 1, Klipper, Repetier).
    RelativeByEither,
    /// M82 and M83 alone (RepRapFirmware).
    Apart,
}

impl Filament {
    const fn of(dialect: Dialect) -> Self {
        match dialect {
            Dialect::Marlin | Dialect::Smoothie => Self::SetByBoth,
            Dialect::Marlin1 | Dialect::Klipper | Dialect::Repetier => Self::RelativeByEither,
            Dialect::RepRapFirmware => Self::Apart,
        }
    }
}

/// The state after some lines of a job.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Modal {
    /// X, Y, Z, E; `None` where the job has not said it.
    pub at_mm: [Option<f64>; 4],
    /// G90 or G91.
    pub absolute_xyz: bool,
    /// M82 or M83, and whatever else the firmware counts as such.
    pub absolute_e: bool,
    /// The last F.
    pub feedrate_mm_min: Option<f64>,
    /// The last S of M106; 0 after M107.
    pub fan: Option<f64>,
    /// Nozzle as it was last set.
    pub hotend_c: Option<f64>,
    /// Bed as it was last set.
    pub bed_c: Option<f64>,
    /// Whether all axes were homed.
    pub is_homed: bool,
    /// The highest place at which filament was pushed while moving, mm.
    pub top_mm: Option<f64>,
    /// How far the filament is drawn back, mm.
    pub drawn_mm: f64,
    /// The last of each line that sets a limit, a factor, a fan or heater by number, and so on: a reset forgets it.
    pub settings: Vec<Setting>,
    /// What a recovery could not bring about again, if the job has done any of that.
    pub beyond: Option<Beyond>,
    /// M220: moves are so many times as fast as they are told.
    #[serde(skip)]
    speed_factor: f64,
    #[serde(skip)]
    filament: Filament,
    #[serde(skip)]
    dialect: Dialect,
}

/// A line that sets something which lasts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Setting {
    /// Lines of one kind set the same.
    #[serde(skip)]
    kind: String,
    /// As it stands in the job.
    pub line: String,
}

/// Speeds, accelerations, corners, factors, filament, chamber, pressure advance: M codes of all firmwares.
const LASTING: [u32; 16] = [92, 141, 191, 200, 201, 202, 203, 204, 205, 207, 220, 221, 566, 572, 593, 900];

/// Klipper's words for the same.
const LASTING_WORDS: [&str; 4] =
    ["SET_VELOCITY_LIMIT", "SET_PRESSURE_ADVANCE", "SET_FAN_SPEED", "SET_HEATER_TEMPERATURE"];

impl Setting {
    /// What a line sets: its command, and the parameters that say of what (axes, a number of fan or tool); `None` if nothing
    /// that lasts.
    fn kind_of(command: &str, parsed: Option<&Command>) -> Option<String> {
        let word = command.split_ascii_whitespace().next()?;
        let Some(c) = parsed.filter(|c| matches!(c.letter, 'G' | 'M' | 'T')) else {
            let keys = command.split_ascii_whitespace().skip(1).filter_map(|w| w.split('=').next());
            return LASTING_WORDS
                .contains(&word)
                .then(|| format!("{word} {}", keys.collect::<Vec<_>>().join(" ")));
        };
        let numbered = |letter: char| c.value(letter).map_or(String::new(), |n| format!("{letter}{n}"));
        match (c.letter, c.code) {
            ('T', _) => Some("T".to_owned()),
            ('M', 106 | 107) if c.value('P').is_some_and(|p| p > 0.0) => {
                Some(format!("fan {}", numbered('P')))
            }
            ('M', code) if LASTING.contains(&code) => {
                let axes: String = ('A'..='Z').filter(|&letter| c.has(letter)).collect();
                Some(format!("{word} {axes} {}", numbered('T')))
            }
            _ => None,
        }
    }
}

/// What a job has done that a recovery cannot bring about again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum Beyond {
    /// G20.
    #[error("gives its lengths in inches (G20)")]
    Inches,
    /// G92 of an axis after homing, M206, M290, M428.
    #[error("has shifted its axes (G92, M206, M290)")]
    Offset,
    /// G29, G32, G80, M420.
    #[error("was levelled by the bed's mesh, which a reset forgets: Z would be another one (G29, G80, M420)")]
    Levelled,
    /// T1 and on.
    #[error("uses several tools")]
    Tools,
}

const AXES: [char; 4] = ['X', 'Y', 'Z', 'E'];

impl Modal {
    /// Before the first line, on a firmware that has just started.
    #[must_use]
    pub const fn new(dialect: Dialect) -> Self {
        Self {
            at_mm: [None, None, None, Some(0.0)],
            absolute_xyz: true,
            absolute_e: true,
            feedrate_mm_min: None,
            fan: None,
            hotend_c: None,
            bed_c: None,
            is_homed: false,
            top_mm: None,
            drawn_mm: 0.0,
            settings: Vec::new(),
            beyond: None,
            speed_factor: 1.0,
            filament: Filament::of(dialect),
            dialect,
        }
    }

    /// Whose firmware it is.
    #[must_use]
    pub const fn dialect(&self) -> Dialect {
        self.dialect
    }

    /// Takes the next command of the job. One that is no G-code changes nothing.
    pub fn apply(&mut self, command: &str) -> Effect {
        // Nearly all lines of a job.
        let is_move = command.starts_with("G0 ") || command.starts_with("G1 ");
        match reader::parse(command) {
            Ok(reader::Line { command: Some(c), .. }) => {
                if !is_move {
                    self.keep(command, Some(&c));
                }
                self.command(&c)
            }
            _ => {
                self.keep(command, None);
                Effect::Other
            }
        }
    }

    /// Whether a command would bring the nozzle to another height.
    #[must_use]
    pub fn changes_height(&self, command: &str) -> bool {
        // Nearly all lines of a job.
        if !command.contains('Z') && !command.contains("G28") && !command.contains("G92") {
            return false;
        }
        let mut after = self.clone();
        after.apply(command);
        after.at_mm[2] != self.at_mm[2]
    }

    fn command(&mut self, c: &Command) -> Effect {
        if matches!((c.letter, c.code), ('G', 29 | 32 | 80) | ('M', 420)) {
            self.beyond = Some(Beyond::Levelled);
        }
        match (c.letter, c.code) {
            ('G', 0..=3) => return self.go(c),
            // Klipper queues a dwell and lets motors go as it queues a move; what waits for somebody is a macro.
            ('G', 4) | ('M', 0 | 1 | 18 | 84 | 600) if self.dialect == Dialect::Klipper => {}
            ('G', 4 | 29) | ('M', 0 | 1 | 18 | 84 | 400 | 600) => return Effect::Drains,
            ('G', 28) => {
                self.home(c);
                return Effect::Drains;
            }
            ('G', 90 | 91) => {
                self.absolute_xyz = c.code == 90;
                if self.filament == Filament::SetByBoth {
                    self.absolute_e = self.absolute_xyz;
                }
            }
            ('G', 92) => {
                if AXES[..3].iter().any(|&axis| c.has(axis)) {
                    self.beyond = Some(Beyond::Offset);
                }
                self.set_place(c);
            }
            ('G', 20) => self.beyond = Some(Beyond::Inches),
            ('G', 21) if self.beyond == Some(Beyond::Inches) => self.beyond = None,
            ('M', 206 | 290 | 428) => self.beyond = Some(Beyond::Offset),
            ('T', tool) if tool > 0 => self.beyond = Some(Beyond::Tools),
            ('M', 106 | 107) if c.value('P').is_some_and(|p| p > 0.0) => {}
            ('M', 220) => self.speed_factor = c.value('S').map_or(self.speed_factor, |s| s / 100.0),
            ('M', 82 | 83) => self.absolute_e = c.code == 82,
            ('M', 106) => self.fan = c.value('S').or(Some(255.0)),
            ('M', 107) => self.fan = Some(0.0),
            ('M', 104 | 109) => self.hotend_c = c.value('S').or_else(|| c.value('R')).or(self.hotend_c),
            ('M', 140 | 190) => self.bed_c = c.value('S').or_else(|| c.value('R')).or(self.bed_c),
            _ => {}
        }
        Effect::Other
    }

    fn home(&mut self, c: &Command) {
        let all = !AXES[..3].iter().any(|&axis| c.has(axis));
        for (at, axis) in self.at_mm.iter_mut().zip(AXES).take(3) {
            if all || c.has(axis) {
                *at = None;
            }
        }
        self.is_homed |= all;
        if all && self.beyond == Some(Beyond::Offset) {
            self.beyond = None;
        }
    }

    /// Keeps what sets something that a reset forgets.
    fn keep(&mut self, command: &str, parsed: Option<&Command>) {
        let Some(kind) = Setting::kind_of(command, parsed) else { return };
        self.settings.retain(|setting| setting.kind != kind);
        self.settings.push(Setting { kind, line: command.to_owned() });
    }

    fn set_place(&mut self, c: &Command) {
        let all = !AXES.iter().any(|&axis| c.has(axis));
        for (at, axis) in self.at_mm.iter_mut().zip(AXES) {
            *at = if all { Some(0.0) } else { c.value(axis).or(*at) };
        }
    }

    fn is_absolute(&self, axis: usize) -> bool {
        match (axis, self.filament) {
            (3, Filament::RelativeByEither) => self.absolute_e && self.absolute_xyz,
            (3, _) => self.absolute_e,
            _ => self.absolute_xyz,
        }
    }

    fn go(&mut self, c: &Command) -> Effect {
        self.feedrate_mm_min = c.value('F').or(self.feedrate_mm_min);
        let before = self.at_mm;
        let mut longest_mm: f64 = 0.0;
        for (axis, letter) in AXES.into_iter().enumerate() {
            let Some(value) = c.value(letter) else { continue };
            let (to, way) = match (self.is_absolute(axis), before[axis]) {
                (true, from) => (Some(value), from.map_or(0.0, |from| value - from)),
                (false, from) => (from.map(|from| from + value), value),
            };
            self.at_mm[axis] = to;
            longest_mm = longest_mm.max(way.abs());
        }
        if let Some(way) = self.at_mm[3].zip(before[3]).map(|(to, from)| to - from) {
            self.drawn_mm = (self.drawn_mm - way).max(0.0);
        }
        let pushes = c.has('E') && (c.has('X') || c.has('Y')) && self.at_mm[3] > before[3];
        if let Some(z_mm) = self.at_mm[2].filter(|_| pushes) {
            self.top_mm = Some(self.top_mm.map_or(z_mm, |top| top.max(z_mm)));
        }
        let mm_min = self.feedrate_mm_min.unwrap_or(f64::INFINITY).max(1.0);
        let least_s = longest_mm / mm_s_from_mm_min(mm_min) / self.speed_factor.max(0.01);
        match c.code {
            // The way round is longer than the longest axis of the way straight.
            2 | 3 => Effect::Arc { least_s },
            _ if longest_mm >= SURE_BLOCK_MM => Effect::Block { least_s },
            _ if longest_mm > 0.0 => Effect::Short { least_s },
            _ => Effect::Other,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(dialect: Dialect, lines: &[&str]) -> Modal {
        let mut modal = Modal::new(dialect);
        for line in lines {
            modal.apply(line);
        }
        modal
    }

    #[test]
    fn what_changes_the_height_is_seen_before_it_is_done() {
        let modal = after(Dialect::Marlin, &["G28", "G90", "G1 X1 Y1 Z0.2"]);
        for line in ["G0 Z0.4", "G1 X5 Z1 E2", "G28", "G28 Z", "G92 Z0", "G92", "G2 X3 Y1 I1 J0 Z0.5"] {
            assert!(modal.changes_height(line), "{line}");
        }
        for line in ["G1 X5 E1", "G1 X2 Z0.2", "G28 X Y", "G92 E0", "M104 S200", ";Z:3", "G90"] {
            assert!(!modal.changes_height(line), "{line}");
        }
        assert!(after(Dialect::Marlin, &["G1 Z1", "G91"]).changes_height("G1 Z1"));
    }

    #[test]
    fn place_modes_and_heat_follow_the_job() {
        let lines = [
            "G28",
            "M104 S210",
            "M190 S60",
            "G90",
            "M83",
            "G1 X10 Y20 Z0.2 F1800",
            "G1 X12 E0.5",
            "M106 S128",
        ];
        let modal = after(Dialect::Marlin, &lines);
        assert_eq!(modal.at_mm, [Some(12.0), Some(20.0), Some(0.2), Some(0.5)]);
        assert_eq!((modal.hotend_c, modal.bed_c, modal.fan), (Some(210.0), Some(60.0), Some(128.0)));
        assert_eq!((modal.feedrate_mm_min, modal.top_mm, modal.is_homed), (Some(1800.0), Some(0.2), true));
        assert!(modal.absolute_xyz && !modal.absolute_e);
    }

    #[test]
    fn where_an_axis_is_after_homing_is_not_guessed() {
        let modal = after(Dialect::Marlin, &["G90", "G1 X10 Y20 Z3", "G28 X Y"]);
        assert_eq!(modal.at_mm[..3], [None, None, Some(3.0)]);
        let modal = after(Dialect::Marlin, &["G28", "G91", "G1 Z5"]);
        assert_eq!(modal.at_mm[2], None);
    }

    #[test]
    fn filament_is_relative_as_each_firmware_means_it() {
        let lines = ["M82", "G92 E5", "G91", "G1 E1", "G90", "G1 E9"];
        assert_eq!(after(Dialect::Marlin, &lines).at_mm[3], Some(9.0));
        let lines = ["M83", "G90", "G1 X1 E1", "G1 X2 E1"];
        // G90 takes M83 back in Marlin 2 alone.
        assert_eq!(after(Dialect::Marlin, &lines).at_mm[3], Some(1.0));
        assert_eq!(after(Dialect::Klipper, &lines).at_mm[3], Some(2.0));
        assert_eq!(after(Dialect::RepRapFirmware, &["G91", "M82", "G1 E4", "G1 E5"]).at_mm[3], Some(5.0));
        assert_eq!(after(Dialect::Marlin1, &["G91", "M82", "G1 E4", "G1 E5"]).at_mm[3], Some(9.0));
    }

    #[test]
    fn the_last_of_each_line_that_sets_something_is_kept() {
        let lines = [
            "M201 X500 Y500",
            "M201 Z50",
            "T0",
            "M204 P900 T1300",
            "M106 P2 S99",
            "M220 S90",
            "G1 X1 F600",
            "M201 X700 Y700",
            "M106 P2 S50",
            "M106 S255",
            "M117 M220 S5",
            "SET_VELOCITY_LIMIT ACCEL=900",
            "M191 S45",
        ];
        let modal = after(Dialect::Marlin, &lines);
        let kept: Vec<_> = modal.settings.iter().map(|setting| setting.line.as_str()).collect();
        assert_eq!(
            kept,
            [
                "M201 Z50",
                "T0",
                "M204 P900 T1300",
                "M220 S90",
                "M201 X700 Y700",
                "M106 P2 S50",
                "SET_VELOCITY_LIMIT ACCEL=900",
                "M191 S45"
            ]
        );
        assert_eq!((modal.fan, modal.beyond), (Some(255.0), None));
    }

    #[test]
    fn what_a_reset_takes_away_for_good_is_noted() {
        let beyond = |lines: &[&str]| after(Dialect::Marlin, lines).beyond;
        assert_eq!(beyond(&["G20", "G1 X1"]), Some(Beyond::Inches));
        assert_eq!(beyond(&["G20", "G21"]), None);
        assert_eq!(beyond(&["G28", "G92 Z0.1"]), Some(Beyond::Offset));
        assert_eq!(beyond(&["G92 X0 Y0 Z0", "G28"]), None, "homing takes it back");
        assert_eq!(beyond(&["G28", "G29", "G92 E0"]), Some(Beyond::Levelled));
        assert_eq!(beyond(&["T0", "T1"]), Some(Beyond::Tools));
    }

    #[test]
    fn drawn_back_filament_is_followed_in_either_mode() {
        let drawn = |lines: &[&str]| after(Dialect::Marlin, lines).drawn_mm;
        assert!((drawn(&["M83", "G1 X1 E5", "G1 E-0.8"]) - 0.8).abs() < 1e-9);
        assert!(drawn(&["M83", "G1 X1 E5", "G1 E-0.8", "G1 E0.8"]).abs() < 1e-9);
        assert!((drawn(&["M82", "G1 X1 E5", "G1 E4.2", "G92 E0", "G1 E0.3"]) - 0.5).abs() < 1e-9);
    }

    #[test]
    fn what_is_no_gcode_changes_nothing() {
        let modal = after(Dialect::Marlin, &["what", "EXCLUDE_OBJECT_START NAME=a", "", "G1 X"]);
        assert_eq!(modal, Modal::new(Dialect::Marlin));
    }
}
