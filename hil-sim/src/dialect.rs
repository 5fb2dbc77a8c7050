//! What a firmware says, word by word, as data.
//!
//! The texts of Marlin 2.1 are those observed from the real firmware. A dialect that differs in words only is another
//! constant; one that differs in kind (no line numbers, say) gets another variant of [`Numbering`] or another field.

/// Whether and how lines are checked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Numbering {
    /// `N` and `*` are checked where `N` opens the line; a number it already has (last, last but one) is dropped in
    /// silence.
    CheckedRepeatsSilent,
    /// The same, but a number it already has is refused like any other wrong one.
    CheckedRepeatsRefused,
}

/// The words of one firmware.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Dialect {
    /// Name in reports.
    pub name: &'static str,
    /// Lines said after power-up or reset.
    pub boot: &'static [&'static str],
    /// How lines are checked.
    pub numbering: Numbering,
    /// Whether `ok` carries line number, free planner blocks and free command slots.
    pub advanced_ok: bool,
    /// Whether M108, M112 and M410 act when they arrive rather than when they are executed.
    pub emergency_parser: bool,
    /// Before the number in a request to send again.
    pub resend: &'static str,
    /// First line of the answer to M115, without the machine's name.
    pub firmware: &'static str,
    /// Further lines of that answer.
    pub capabilities: &'static [&'static str],
    /// Said after `Error:` when it stops for good.
    pub halted: &'static [&'static str],
}

/// Marlin 2.1 with `ADVANCED_OK`, emergency parser, host actions and prompts.
pub static MARLIN: Dialect = Dialect {
    name: "marlin",
    boot: &[
        "start",
        "PowerUp",
        "Marlin bugfix-2.1.x",
        "echo: Last Updated: 2026-01-01 | Author: (hil-sim)",
        "echo: Compiled: Jan  1 2026",
        "echo: Free Memory: 4096  PlannerBufferBytes: 1280",
    ],
    numbering: Numbering::CheckedRepeatsSilent,
    advanced_ok: true,
    emergency_parser: true,
    resend: "Resend: ",
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
};

/// Marlin 1.1: plain `ok`, no emergency parser, repeated lines refused.
pub static MARLIN_1: Dialect = Dialect {
    name: "marlin1",
    boot: &[
        "start",
        "echo:Marlin 1.1.9",
        "echo: Last Updated: 2018-07-31 | Author: (hil-sim)",
        "echo: Free Memory: 4096  PlannerBufferBytes: 1280",
    ],
    numbering: Numbering::CheckedRepeatsRefused,
    advanced_ok: false,
    emergency_parser: false,
    resend: "Resend: ",
    firmware: "FIRMWARE_NAME:Marlin 1.1.9 (hil-sim) SOURCE_CODE_URL:https://github.com/MarlinFirmware/Marlin \
               PROTOCOL_VERSION:1.0",
    capabilities: &["Cap:EEPROM:0", "Cap:AUTOREPORT_TEMP:1", "Cap:PROGRESS:0", "Cap:EMERGENCY_PARSER:0"],
    halted: &["Error:Printer halted. kill() called!"],
};
