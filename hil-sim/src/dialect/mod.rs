//! What a firmware says and how it reads, word by word, as data.
//!
//! The texts of Marlin 2.1 and of Klipper's terminal are those observed from the real firmware. What is said of the others, and
//! how all of them round corners and arcs, is from knowledge of their sources; no such machine was measured. A dialect that differs in words only is another constant; one that differs in kind (no line
//! numbers, say) has another variant of one of the enums here.

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
    /// The same, but a number it already has is answered by `skip` and `ok`.
    CheckedRepeatsSkipped,
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

/// How the firmware divides an arc into chords. All limits hold at once.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArcRule {
    /// Longest chord, mm.
    pub longest_mm: f64,
    /// Shortest chord that a rule on speed or deviation may ask for, mm.
    pub shortest_mm: f64,
    /// Fewest chords of a whole circle.
    pub per_circle: f64,
    /// Chords a second, at the commanded speed; 0: no such rule.
    pub per_s: f64,
    /// Farthest from the arc, mm; 0: no such rule.
    pub deviation_mm: f64,
}

impl ArcRule {
    const fn of_length(longest_mm: f64) -> Self {
        Self { longest_mm, shortest_mm: 0.0, per_circle: 1.0, per_s: 0.0, deviation_mm: 0.0 }
    }

    /// Longest chord of an arc of `radius_mm` driven at `speed_mm_s`, mm.
    #[must_use]
    pub fn chord_mm(&self, radius_mm: f64, speed_mm_s: f64) -> f64 {
        let mut chord = self.longest_mm;
        if self.per_s > 0.0 {
            chord = chord.min((speed_mm_s / self.per_s).max(self.shortest_mm));
        }
        if self.deviation_mm > 0.0 {
            chord = chord.min((8.0 * radius_mm * self.deviation_mm).sqrt().max(self.shortest_mm));
        }
        chord.min(std::f64::consts::TAU * radius_mm / self.per_circle)
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
    /// Before the number in a request to send again.
    pub resend: &'static str,
    /// Whether `ok` follows that request.
    pub ok_after_resend: bool,
    /// Whether `ok` carries line number, free planner blocks and free command slots.
    pub advanced_ok: bool,
    /// Whether M108, M112 and M410 act when they arrive rather than when they are executed.
    pub emergency_parser: bool,
    /// Said every two seconds while a command takes its time; empty: nothing.
    pub busy: &'static str,
    /// First line of the answer to M115, without the machine's name.
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
const MARLIN_2_CODES: &[(u8, u32)] = &[(b'M', 486), (b'M', 876)];

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

    /// Whether it refuses a move that leaves the machine, rather than cutting it off at the edge.
    #[must_use]
    pub const fn refuses_moves_outside(&self) -> bool {
        matches!(self.family, Family::Klipper)
    }
}

/// Marlin 2.1 with `ADVANCED_OK`, emergency parser, host actions and prompts.
pub static MARLIN: Dialect = Dialect {
    name: "marlin",
    family: Family::Marlin,
    boot: &[
        "start",
        "PowerUp",
        "Marlin bugfix-2.1.x",
        "echo: Last Updated: 2026-01-01 | Author: (hil-sim)",
        "echo: Compiled: Jan  1 2026",
        "echo: Free Memory: 4096  PlannerBufferBytes: 1280",
    ],
    numbering: Numbering::CheckedRepeatsSilent,
    refusal: Refusal::LastLine,
    resend: "Resend: ",
    ok_after_resend: true,
    advanced_ok: true,
    emergency_parser: true,
    busy: "echo:busy: processing",
    firmware: "FIRMWARE_NAME:Marlin bugfix-2.1.x (hil-sim) SOURCE_CODE_URL:github.com/MarlinFirmware/Marlin \
               PROTOCOL_VERSION:1.0",
    capabilities: &[
        "Cap:SERIAL_XON_XOFF:0",
        "Cap:BINARY_FILE_TRANSFER:0",
        "Cap:EEPROM:0",
        "Cap:VOLUMETRIC:0",
        "Cap:AUTOREPORT_POS:0",
        "Cap:AUTOREPORT_TEMP:1",
        "Cap:PROGRESS:0",
        "Cap:PRINT_JOB:1",
        "Cap:AUTOLEVEL:0",
        "Cap:RUNOUT:1",
        "Cap:Z_PROBE:0",
        "Cap:LEVELING_DATA:0",
        "Cap:BUILD_PERCENT:1",
        "Cap:SOFTWARE_POWER:0",
        "Cap:TOGGLE_LIGHTS:0",
        "Cap:CASE_LIGHT_BRIGHTNESS:0",
        "Cap:EMERGENCY_PARSER:1",
        "Cap:HOST_ACTION_COMMANDS:1",
        "Cap:PROMPT_SUPPORT:1",
        "Cap:SDCARD:0",
        "Cap:THERMAL_PROTECTION:1",
        "Cap:MOTION_MODES:0",
        "Cap:ARCS:1",
        "Cap:BABYSTEPPING:0",
        "Cap:CHAMBER_TEMPERATURE:0",
    ],
    halted: &["Error:Printer halted. kill() called!", "//action:poweroff"],
    codes: MARLIN_2_CODES,
    words: &[],
    arcs: Some(ArcRule {
        longest_mm: 1.0,
        shortest_mm: 0.1,
        per_circle: 72.0,
        per_s: 50.0,
        deviation_mm: 0.0,
    }),
};

/// Marlin 1.1: plain `ok`, no emergency parser, repeated lines refused, arcs in chords of one length.
const MARLIN_1_WORDS: Dialect = Dialect {
    name: "marlin1",
    family: Family::Marlin,
    boot: &[
        "start",
        "echo:Marlin 1.1.9",
        "echo: Last Updated: 2018-07-31 | Author: (hil-sim)",
        "echo: Free Memory: 4096  PlannerBufferBytes: 1280",
    ],
    numbering: Numbering::CheckedRepeatsRefused,
    refusal: Refusal::LastLine,
    resend: "Resend: ",
    ok_after_resend: true,
    advanced_ok: false,
    emergency_parser: false,
    busy: "echo:busy: processing",
    firmware: "FIRMWARE_NAME:Marlin 1.1.9 (hil-sim) SOURCE_CODE_URL:https://github.com/MarlinFirmware/Marlin \
               PROTOCOL_VERSION:1.0",
    capabilities: &["Cap:EEPROM:0", "Cap:AUTOREPORT_TEMP:1", "Cap:PROGRESS:0", "Cap:EMERGENCY_PARSER:0"],
    halted: &["Error:Printer halted. kill() called!"],
    codes: &[],
    words: &[],
    arcs: Some(ArcRule::of_length(1.0)),
};

/// Marlin 1.1.
pub static MARLIN_1: Dialect = MARLIN_1_WORDS;

/// The firmware of the Prusa MK3, of the family of Marlin 1.
pub static PRUSA: Dialect = Dialect {
    name: "prusa",
    boot: &["start", "echo: 3.13.0-6853", "echo: Free Memory: 2048  PlannerBufferBytes: 1760"],
    firmware: "FIRMWARE_NAME:Prusa-Firmware 3.13.0 (hil-sim) based on Marlin \
               FIRMWARE_URL:https://github.com/prusa3d/Prusa-Firmware PROTOCOL_VERSION:1.0",
    capabilities: &["Cap:AUTOREPORT_TEMP:1", "Cap:PROGRESS:0", "Cap:EXTENDED_M20:0", "Cap:PRUSA_MMU2:0"],
    arcs: Some(ArcRule { per_circle: 20.0, ..ArcRule::of_length(1.0) }),
    ..MARLIN_1_WORDS
};

/// Klipper's terminal: no line numbers, `// ` before information, `!! ` before errors, `ok` after each.
pub static KLIPPER: Dialect = Dialect {
    name: "klipper",
    family: Family::Klipper,
    boot: &["// Klipper state: Ready"],
    numbering: Numbering::Ignored,
    refusal: Refusal::Silent,
    resend: "",
    ok_after_resend: false,
    advanced_ok: false,
    emergency_parser: false,
    busy: "",
    firmware: "FIRMWARE_VERSION:v0.12.0 (hil-sim) FIRMWARE_NAME:Klipper",
    capabilities: &[],
    halted: &["// Klipper state: Shutdown"],
    codes: &[(b'M', 73), (b'M', 118)],
    words: &[
        "SET_VELOCITY_LIMIT",
        "EXCLUDE_OBJECT_DEFINE",
        "EXCLUDE_OBJECT_START",
        "EXCLUDE_OBJECT_END",
        "FIRMWARE_RESTART",
    ],
    arcs: None,
};

/// RepRapFirmware 3.
pub static REPRAPFIRMWARE: Dialect = Dialect {
    name: "reprapfirmware",
    family: Family::RepRapFirmware,
    boot: &["RepRapFirmware for Duet 3 Mini 5+ is up and running."],
    numbering: Numbering::CheckedRepeatsRefused,
    refusal: Refusal::Silent,
    resend: "rs ",
    ok_after_resend: true,
    advanced_ok: false,
    emergency_parser: false,
    busy: "",
    firmware: "FIRMWARE_NAME: RepRapFirmware for Duet 3 Mini 5+ (hil-sim) FIRMWARE_VERSION: 3.5.1 ELECTRONICS: Duet 3",
    capabilities: &[],
    halted: &["Error: Emergency Stop! Reset the controller to continue."],
    codes: &[
        (b'M', 0),
        (b'M', 1),
        (b'M', 17),
        (b'M', 73),
        (b'M', 85),
        (b'M', 92),
        (b'M', 111),
        (b'M', 118),
        (b'M', 201),
        (b'M', 203),
        (b'M', 302),
        (b'M', 486),
        (b'M', 566),
        (b'M', 999),
    ],
    words: &[],
    arcs: Some(ArcRule {
        longest_mm: 2.0,
        shortest_mm: 0.1,
        per_circle: 1.0,
        per_s: 200.0,
        deviation_mm: 0.005,
    }),
};

/// Repetier-Firmware 1.
pub static REPETIER: Dialect = Dialect {
    name: "repetier",
    family: Family::Repetier,
    boot: &["start", "Info:PowerUp", "Free RAM:2000"],
    numbering: Numbering::CheckedRepeatsSkipped,
    refusal: Refusal::Expected,
    resend: "Resend:",
    ok_after_resend: true,
    advanced_ok: false,
    emergency_parser: false,
    busy: "busy:processing",
    firmware: "FIRMWARE_NAME:Repetier_1.0.4 (hil-sim) FIRMWARE_URL:https://github.com/repetier/Repetier-Firmware/ \
               PROTOCOL_VERSION:1.0",
    capabilities: &["Cap:PROGRESS:0", "Cap:AUTOREPORT_TEMP:1", "Cap:EEPROM:0"],
    halted: &["fatal:Printer stopped. Reset or M999 to continue."],
    codes: &[
        (b'M', 108),
        (b'M', 155),
        (b'M', 201),
        (b'M', 202),
        (b'M', 207),
        (b'M', 302),
        (b'M', 408),
        (b'M', 410),
        (b'M', 999),
    ],
    words: &[],
    arcs: Some(ArcRule::of_length(1.0)),
};

/// Smoothieware.
pub static SMOOTHIE: Dialect = Dialect {
    name: "smoothie",
    family: Family::Smoothie,
    boot: &["Smoothie", "ok"],
    numbering: Numbering::CheckedRepeatsRefused,
    refusal: Refusal::Silent,
    resend: "rs N",
    ok_after_resend: false,
    advanced_ok: false,
    emergency_parser: false,
    busy: "",
    firmware: "FIRMWARE_NAME:Smoothieware, FIRMWARE_URL:http%3A//smoothieware.org, X-SOURCE_CODE_URL:https://github.com/\
               Smoothieware/Smoothieware, FIRMWARE_VERSION:edge (hil-sim)",
    capabilities: &[],
    halted: &["!!"],
    codes: &[
        (b'M', 17),
        (b'M', 92),
        (b'M', 203),
        (b'M', 205),
        (b'M', 302),
        (b'M', 500),
        (b'M', 503),
        (b'M', 999),
    ],
    words: &[],
    arcs: Some(ArcRule { deviation_mm: 0.01, ..ArcRule::of_length(5.0) }),
};
