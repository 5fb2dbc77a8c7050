//! What a firmware says and how it reads, word by word, as data.
//!
//! The texts of Marlin 2.1 and of Klipper's terminal are those observed from the real firmware. What is said of the others, and
//! how all of them round corners and arcs, is from knowledge of their sources; no such machine was measured. A dialect that
//! differs in words only is another constant; one that differs in kind (no line numbers, say)
//! has another variant of one of the enums here.
//!
//! Sources: Marlin 2.1 and 1.1.9 (`queue.cpp`, `M114.cpp`, `M115.cpp`, `manage_inactivity`), Prusa-Firmware 3.13
//! (`Marlin_main.cpp`), Klipper (`klippy/gcode.py`, `gcode_move.py`, `idle_timeout.py`, `mcu.py`), RepRapFirmware 3
//! (`StringParser.cpp`, `GCodes2.cpp`), Repetier-Firmware 1 (`gcode.cpp`, `Commands.cpp`), Smoothieware
//! (`GcodeDispatch.cpp`, `Robot.cpp`).

mod firmware;

pub use firmware::{
    KLIPPER, MARLIN, MARLIN_1, PRUSA, REPETIER, REPRAPFIRMWARE, REPRAPFIRMWARE_SILENT, SMOOTHIE,
};

use crate::receive::Emergency;

/// Which firmware it is: what its commands mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Family {
    /// Marlin and what descends from it.
    Marlin,
    /// Klipper's G-code terminal.
    Klipper,
    /// RepRapFirmware in its Marlin-compatible mode of answering.
    RepRapFirmware,
    /// Repetier-Firmware.
    Repetier,
    /// Smoothieware.
    Smoothie,
}

/// Whether and how lines are checked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Numbering {
    /// `N` and `*` are checked where `N` opens the line; a number it already has (last, last but one) is dropped in
    /// silence.
    CheckedRepeatsSilent,
    /// The same, but a number it already has is refused like any other wrong one.
    CheckedRepeatsRefused,
    /// The same, but one of the last forty numbers it has is answered by `skip` and `ok`, and so are wrong numbers after a
    /// request to send again, fourteen at most.
    CheckedRepeatsSkipped,
    /// The checksum of a numbered line is checked, if it has one, but not its number: a line that comes twice is done twice,
    /// and one that does not come is not missed. What is asked for again is the damaged line's own number (RepRapFirmware,
    /// `StringParser::LineFinished`; where there is no word for that, the line is dropped in silence, as from 3.6 on).
    SumOnly,
    /// Numbers and checksums are read over.
    Ignored,
}

/// What is said when a line is refused, before the request to send it again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// `Error:checksum mismatch, Last Line: 2`
    LastLine,
    /// `Error:expected line 12 got 14`, `Error:Wrong checksum`
    Expected,
    /// Nothing.
    Silent,
}

/// What relative positions (G91) mean for the extruder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExtruderMode {
    /// G90 and G91 set its mode too, until M82 or M83.
    WithAxes,
    /// It is relative after G91 or M83, whichever holds.
    RelativeIfEither,
    /// M82 and M83 alone.
    Own,
}

/// Orders that do not wait for their turn in the queue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Urgent {
    /// Obeyed as their bytes arrive.
    pub by_byte: &'static [Emergency],
    /// Obeyed when their line is read into the command queue.
    pub by_line: &'static [Emergency],
}

/// How the position is told (M114).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PositionForm {
    /// `X:50.00 Y:50.00 Z:5.00 E:0.00 Count X:4000 Y:4000 Z:2000`: the end of the last command, then the motors' steps now.
    MarlinSteps,
    /// The same, the motors' places in mm: `Count X: 50.00 Y:50.00 Z:5.00 E:0.00`.
    MarlinPlaces,
    /// `X:50.000 Y:50.000 Z:5.000 E:0.000`
    Klipper,
    /// `X:50.000 Y:50.000 Z:5.000 E:0.000 E0:0.0 Count 4000 4000 2000 Machine 50.000 50.000 5.000 Bed comp 0.000`: the motors
    /// after the last whole move.
    RepRapFirmware,
    /// `X:50.00 Y:50.00 Z:5.000 E:0.0000`
    Repetier,
    /// `ok C: X:50.0000 Y:50.0000 Z:5.0000 E:0.0000`
    Smoothie,
}

/// What a firmware does by itself when nobody asks anything of it; 0: never. All s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdleRule {
    /// After this long the motors are off, and where the axes are is no longer known.
    pub motors_s: f64,
    /// After this long the heaters are off.
    pub heaters_s: f64,
    /// Whether that also means the motors.
    pub heaters_take_motors: bool,
    /// What is said then.
    pub heaters_text: &'static [&'static str],
    /// Whether any command keeps it awake; if not, only motion does.
    pub commands_count: bool,
}

/// What M112, a fault or a reset of the board leaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Halt {
    /// Silence until a reset.
    Silent,
    /// Silence, but M999 is obeyed.
    SilentUntilM999,
    /// Every command is refused with the reason, but for those that only ask; `FIRMWARE_RESTART` starts it anew.
    Klipper,
    /// Every command repeats the error; M999 ends it, and nothing is forgotten.
    RepeatsError,
    /// `!!` to every command until M999.
    Alarm,
}

/// How the firmware divides an arc into chords.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ArcRule {
    /// As many whole ones of 1 mm as go in, 72 a circle at least, none longer than 1 mm or shorter than 0.1 mm (Marlin 2.1:
    /// `MAX_ARC_SEGMENT_MM`, `MIN_CIRCLE_SEGMENTS`).
    Marlin2,
    /// As many whole ones of 1 mm as go in, along the climb too (Marlin 1.1: `MM_PER_ARC_SEGMENT`).
    Marlin1,
    /// 1 mm at most, 20 a circle at least (Prusa).
    Prusa,
    /// 0.005 mm off the arc, 200 a second at most, 0.1 to 1 mm long; four fifths of one count as one (RepRapFirmware 3).
    RepRapFirmware,
    /// As many whole ones of 1 mm as go in; above 60 mm/s, of a sixtieth of a second, 3 mm at most (Repetier).
    Repetier,
    /// As many whole ones as go in that leave the arc by 0.01 mm (Smoothieware).
    Smoothie,
}

impl ArcRule {
    /// Number of chords of an arc of `radius_mm` through `turn` (> 0, radians) that climbs by `rise_mm`, commanded at
    /// `speed_mm_s`.
    #[must_use]
    pub fn n_chords(self, radius_mm: f64, turn: f64, rise_mm: f64, speed_mm_s: f64) -> usize {
        use std::f64::consts::TAU;
        let flat = radius_mm * turn;
        let n = match self {
            Self::Marlin2 => {
                let n = flat.floor().max((72.0 * turn / TAU).ceil());
                if flat / n > 1.0 {
                    flat.ceil()
                } else if flat / n < 0.1 {
                    (flat / 0.1).floor()
                } else {
                    n
                }
            }
            Self::Marlin1 => flat.hypot(rise_mm).floor(),
            Self::Prusa => (flat.hypot(rise_mm) / (TAU * radius_mm / 20.0).min(1.0)).ceil(),
            Self::RepRapFirmware => {
                let chord = (8.0 * radius_mm * 0.005).sqrt().min(speed_mm_s / 200.0).clamp(0.1, 1.0);
                (flat / chord + 0.8).floor()
            }
            Self::Repetier if speed_mm_s > 60.0 => (flat / (speed_mm_s * 0.016_66).min(3.0)).floor(),
            Self::Repetier => flat.floor(),
            Self::Smoothie => {
                let error = 0.01;
                let chord = if 2.0 * radius_mm > error {
                    2.0 * (error * 2.0_f64.mul_add(radius_mm, -error)).sqrt()
                } else {
                    0.5
                };
                (flat.hypot(rise_mm) / chord).floor()
            }
        };
        crate::whole::floor_to_usize(n).clamp(1, 10_000)
    }
}

/// The words of one firmware.
#[derive(Debug, Clone, PartialEq)]
pub struct Dialect {
    /// Name in reports.
    pub name: &'static str,
    /// What its commands mean.
    pub family: Family,
    /// Lines said after power-up or reset.
    pub boot: &'static [&'static str],
    /// How lines are checked.
    pub numbering: Numbering,
    /// What is said about a line that is refused.
    pub refusal: Refusal,
    /// Before the number in a request to send again; empty: there is none.
    pub resend: &'static str,
    /// Whether `ok` follows that request.
    pub ok_after_resend: bool,
    /// Number of the line before the first.
    pub first_last_line: i64,
    /// Whether a refusal empties the receive ring.
    pub clears_on_refusal: bool,
    /// Whether the second `N` of `N4 M110 N3` counts.
    pub m110_takes_second: bool,
    /// Whether `ok` carries line number, free planner blocks and free command slots.
    pub advanced_ok: bool,
    /// Whether `ok` (with the number of the last numbered line) is said when a line is taken into the queue, not when it is
    /// done.
    pub ok_when_taken: bool,
    /// Said each second while there is nothing to do; empty: nothing.
    pub wait: &'static str,
    /// What does not wait for its turn.
    pub urgent: Urgent,
    /// Said first when M112 is obeyed.
    pub kill_order: &'static [&'static str],
    /// What a stop for good looks like.
    pub halt: Halt,
    /// How M114 is answered.
    pub position: PositionForm,
    /// What relative positions mean for the extruder.
    pub extruder_mode: ExtruderMode,
    /// Whether an axis that is not home may be moved.
    pub moves_unhomed: bool,
    /// Whether an axis that is told its place (G92) counts as home.
    pub place_homes: bool,
    /// Whether the soft endstops hold for an axis that is not home.
    pub endstops_unhomed: bool,
    /// How long a temperature must hold before M109 and M190 are done, s.
    pub residency_s: f64,
    /// What it does by itself.
    pub idle: IdleRule,
    /// Said when the filament has run out.
    pub runout: &'static [&'static str],
    /// Whether it then changes the filament (M600) by itself.
    pub runout_changes: bool,
    /// Whether what it asks the user is told to the host (`//action:prompt_begin` and so on).
    pub prompts: bool,
    /// Said every two seconds while a command takes its time; empty: nothing.
    pub busy: &'static str,
    /// First line of the answer to M115; `{machine}` is the machine's name.
    pub firmware: &'static str,
    /// Further lines of that answer.
    pub capabilities: &'static [&'static str],
    /// Said when it stops for good.
    pub halted: &'static [&'static str],
    /// G- and M-codes besides those that every firmware here has.
    pub codes: &'static [(u8, u32)],
    /// Commands that are words.
    pub words: &'static [&'static str],
    /// How arcs are driven; none: G2 and G3 are unknown.
    pub arcs: Option<ArcRule>,
}

/// Codes that every firmware here has, G2 and G3 aside.
const COMMON: &[(u8, u32)] = &[
    (b'G', 0),
    (b'G', 1),
    (b'G', 4),
    (b'G', 21),
    (b'G', 28),
    (b'G', 90),
    (b'G', 91),
    (b'G', 92),
    (b'M', 18),
    (b'M', 82),
    (b'M', 83),
    (b'M', 84),
    (b'M', 104),
    (b'M', 105),
    (b'M', 106),
    (b'M', 107),
    (b'M', 109),
    (b'M', 110),
    (b'M', 112),
    (b'M', 114),
    (b'M', 115),
    (b'M', 117),
    (b'M', 119),
    (b'M', 140),
    (b'M', 190),
    (b'M', 204),
    (b'M', 220),
    (b'M', 221),
    (b'M', 400),
];

/// What Marlin 1 has besides.
const MARLIN_1_CODES: &[(u8, u32)] = &[
    (b'M', 0),
    (b'M', 1),
    (b'M', 17),
    (b'M', 31),
    (b'M', 73),
    (b'M', 75),
    (b'M', 76),
    (b'M', 77),
    (b'M', 85),
    (b'M', 92),
    (b'M', 108),
    (b'M', 111),
    (b'M', 113),
    (b'M', 118),
    (b'M', 155),
    (b'M', 201),
    (b'M', 203),
    (b'M', 205),
    (b'M', 211),
    (b'M', 300),
    (b'M', 301),
    (b'M', 302),
    (b'M', 304),
    (b'M', 410),
    (b'M', 500),
    (b'M', 501),
    (b'M', 502),
    (b'M', 503),
    (b'M', 999),
];

/// What Marlin 2 has besides that.
const MARLIN_2_CODES: &[(u8, u32)] = &[(b'M', 486), (b'M', 600), (b'M', 876)];

impl Dialect {
    /// Whether there is such a command.
    #[must_use]
    pub fn knows(&self, letter: u8, code: u32) -> bool {
        let is_arc = letter == b'G' && matches!(code, 2 | 3);
        let is_marlin = self.family == Family::Marlin;
        is_arc && self.arcs.is_some()
            || COMMON.contains(&(letter, code))
            || is_marlin && MARLIN_1_CODES.contains(&(letter, code))
            || self.codes.contains(&(letter, code))
    }

    /// What is said of a command that there is not; nothing where it is passed over in silence.
    #[must_use]
    pub fn unknown(&self, text: &[u8]) -> Option<Vec<u8>> {
        let (before, after): (&[u8], &[u8]) = match self.family {
            Family::Marlin => (b"echo:Unknown command: \"", b"\""),
            Family::Repetier => (b"Unknown command:", b""),
            Family::Klipper => (b"// Unknown command:\"", b"\""),
            Family::RepRapFirmware => (b"Error: Bad command: ", b""),
            Family::Smoothie => return None,
        };
        // Klipper names the command alone.
        let end = text.iter().position(|&b| b == b' ').filter(|_| self.family == Family::Klipper);
        Some([before, &text[..end.unwrap_or(text.len())], after].concat())
    }

    /// What is said when a cold hotend is asked to extrude.
    #[must_use]
    pub const fn cold_extrusion(&self) -> &'static str {
        match self.family {
            Family::Marlin | Family::Repetier => "echo: cold extrusion prevented",
            Family::Klipper => "!! Extrude below minimum temp",
            Family::RepRapFirmware => {
                "Warning: Tool 0 was not driven because its heater temperatures were not high enough"
            }
            Family::Smoothie => "error: extruder is too cold",
        }
    }

    /// Whether a line with a number must have a checksum.
    #[must_use]
    pub const fn demands_checksum(&self) -> bool {
        matches!(self.family, Family::Marlin)
    }

    /// Whether it says `ok` and the answer in one line (M115).
    #[must_use]
    pub const fn answers_after_ok(&self) -> bool {
        matches!(self.family, Family::Klipper)
    }

    /// Whether it refuses a move that leaves the machine, rather than cutting it off at the edge.
    #[must_use]
    pub const fn refuses_moves_outside(&self) -> bool {
        matches!(self.family, Family::Klipper)
    }
}
