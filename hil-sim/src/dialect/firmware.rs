//! The firmwares, each a constant of [`Dialect`].

use super::{
    ArcRule, Dialect, ExtruderMode, Family, Halt, IdleRule, MARLIN_2_CODES, Numbering, PositionForm, Refusal,
    Urgent,
};
use crate::receive::Emergency::{Continue, Kill, QuickStop};

const ALL_ORDERS: &[crate::receive::Emergency] = &[Continue, Kill, QuickStop];

/// Marlin's two minutes (`DEFAULT_STEPPER_DEACTIVE_TIME`); heaters stay as they are unless M85 was sent.
const MARLIN_IDLE: IdleRule = IdleRule {
    motors_s: 120.0,
    heaters_s: 0.0,
    heaters_take_motors: false,
    heaters_text: &[],
    commands_count: true,
};

/// Nothing by itself.
const NEVER_IDLE: IdleRule = IdleRule { motors_s: 0.0, ..MARLIN_IDLE };

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
    first_last_line: 0,
    clears_on_refusal: true,
    m110_takes_second: true,
    advanced_ok: true,
    ok_when_taken: false,
    wait: "",
    urgent: Urgent { by_byte: ALL_ORDERS, by_line: &[] },
    kill_order: &["echo:M112 Shutdown"],
    halt: Halt::Silent,
    position: PositionForm::MarlinSteps,
    extruder_mode: ExtruderMode::WithAxes,
    moves_unhomed: true,
    place_homes: false,
    endstops_unhomed: false,
    // TEMP_RESIDENCY_TIME
    residency_s: 10.0,
    idle: MARLIN_IDLE,
    runout: &[
        "//action:prompt_begin FilamentRunout T0",
        "//action:prompt_show",
        "//action:paused filament_runout 0",
    ],
    runout_changes: true,
    prompts: true,
    busy: "echo:busy: processing",
    firmware: "FIRMWARE_NAME:Marlin bugfix-2.1.x (hil-sim) SOURCE_CODE_URL:github.com/MarlinFirmware/Marlin \
               PROTOCOL_VERSION:1.0 MACHINE_TYPE:{machine} EXTRUDER_COUNT:1 \
               UUID:cede2a2f-41a2-4748-9b12-c55c62f367ff",
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
    arcs: Some(ArcRule::Marlin2),
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
    first_last_line: 0,
    clears_on_refusal: true,
    m110_takes_second: true,
    advanced_ok: false,
    ok_when_taken: false,
    wait: "",
    urgent: Urgent { by_byte: &[], by_line: ALL_ORDERS },
    kill_order: &[],
    halt: Halt::Silent,
    position: PositionForm::MarlinSteps,
    extruder_mode: ExtruderMode::RelativeIfEither,
    moves_unhomed: true,
    place_homes: false,
    endstops_unhomed: true,
    residency_s: 10.0,
    idle: MARLIN_IDLE,
    runout: &[],
    runout_changes: false,
    prompts: false,
    busy: "echo:busy: processing",
    firmware: "FIRMWARE_NAME:Marlin 1.1.9 (hil-sim) SOURCE_CODE_URL:https://github.com/MarlinFirmware/Marlin \
               PROTOCOL_VERSION:1.0 MACHINE_TYPE:{machine} EXTRUDER_COUNT:1 \
               UUID:cede2a2f-41a2-4748-9b12-c55c62f367ff",
    capabilities: &["Cap:EEPROM:0", "Cap:AUTOREPORT_TEMP:1", "Cap:PROGRESS:0", "Cap:EMERGENCY_PARSER:0"],
    halted: &["Error:Printer halted. kill() called!"],
    codes: &[],
    words: &[],
    arcs: Some(ArcRule::Marlin1),
};

/// Marlin 1.1.
pub static MARLIN_1: Dialect = MARLIN_1_WORDS;

/// The firmware of the Prusa MK3, of the family of Marlin 1.
pub static PRUSA: Dialect = Dialect {
    name: "prusa",
    // `cmdqueue.cpp` looks for M112 alone as a line comes in.
    urgent: Urgent { by_byte: &[], by_line: &[Kill] },
    boot: &["start", "echo: 3.13.0-6853", "echo: Free Memory: 2048  PlannerBufferBytes: 1760"],
    firmware: "FIRMWARE_NAME:Prusa-Firmware 3.13.0 (hil-sim) based on Marlin \
               FIRMWARE_URL:https://github.com/prusa3d/Prusa-Firmware PROTOCOL_VERSION:1.0 MACHINE_TYPE:{machine} \
               EXTRUDER_COUNT:1 UUID:00000000-0000-0000-0000-000000000000",
    position: PositionForm::MarlinPlaces,
    extruder_mode: ExtruderMode::Own,
    residency_s: 3.0,
    idle: IdleRule {
        motors_s: 60.0,
        heaters_s: 1800.0,
        heaters_text: &["echo:Heating disabled by safety timer."],
        ..MARLIN_IDLE
    },
    runout_changes: true,
    prompts: false,
    codes: &[(b'M', 86), (b'M', 600)],
    capabilities: &["Cap:AUTOREPORT_TEMP:1", "Cap:PROGRESS:0", "Cap:EXTENDED_M20:0", "Cap:PRUSA_MMU2:0"],
    arcs: Some(ArcRule::Prusa),
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
    first_last_line: 0,
    clears_on_refusal: false,
    m110_takes_second: false,
    advanced_ok: false,
    ok_when_taken: false,
    wait: "",
    urgent: Urgent { by_byte: &[], by_line: &[Kill] },
    kill_order: &[],
    halt: Halt::Klipper,
    position: PositionForm::Klipper,
    extruder_mode: ExtruderMode::RelativeIfEither,
    moves_unhomed: false,
    place_homes: false,
    endstops_unhomed: true,
    residency_s: 0.0,
    idle: IdleRule {
        motors_s: 0.0,
        heaters_s: 600.0,
        heaters_take_motors: true,
        heaters_text: &[],
        commands_count: false,
    },
    runout: &["// action:paused"],
    runout_changes: false,
    prompts: false,
    busy: "",
    firmware: "FIRMWARE_NAME:Klipper FIRMWARE_VERSION:v0.12.0-hil-sim",
    capabilities: &[],
    halted: &["// Klipper state: Shutdown"],
    codes: &[(b'M', 73), (b'M', 118)],
    words: &[
        "SET_VELOCITY_LIMIT",
        "EXCLUDE_OBJECT_DEFINE",
        "EXCLUDE_OBJECT_START",
        "EXCLUDE_OBJECT_END",
        "FIRMWARE_RESTART",
        "RESTART",
        "GET_POSITION",
        "STATUS",
        "SET_IDLE_TIMEOUT",
        "TURN_OFF_HEATERS",
    ],
    arcs: None,
};

/// RepRapFirmware 3.
pub static REPRAPFIRMWARE: Dialect = REPRAPFIRMWARE_WORDS;

const REPRAPFIRMWARE_WORDS: Dialect = Dialect {
    name: "reprapfirmware",
    family: Family::RepRapFirmware,
    boot: &["RepRapFirmware for Duet 3 Mini 5+ is up and running."],
    numbering: Numbering::SumOnly,
    refusal: Refusal::Silent,
    resend: "rs ",
    ok_after_resend: false,
    first_last_line: 0,
    clears_on_refusal: false,
    m110_takes_second: true,
    advanced_ok: false,
    ok_when_taken: false,
    wait: "",
    urgent: Urgent { by_byte: &[Kill], by_line: &[] },
    kill_order: &[],
    halt: Halt::SilentUntilM999,
    position: PositionForm::RepRapFirmware,
    extruder_mode: ExtruderMode::Own,
    moves_unhomed: false,
    place_homes: true,
    endstops_unhomed: false,
    residency_s: 0.0,
    idle: NEVER_IDLE,
    runout: &["Error: Filament error on extruder 0: no filament"],
    runout_changes: false,
    prompts: false,
    busy: "",
    firmware: "FIRMWARE_NAME: RepRapFirmware for Duet 3 Mini 5+ FIRMWARE_VERSION: 3.5.1 (hil-sim) ELECTRONICS: Duet 3 \
               Mini5plus WiFi FIRMWARE_DATE: 2024-04-19 14:40:46",
    capabilities: &[],
    halted: &["Emergency Stop! Reset the controller to continue."],
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
        (b'M', 564),
        (b'M', 566),
        (b'M', 999),
    ],
    words: &[],
    arcs: Some(ArcRule::RepRapFirmware),
};

/// RepRapFirmware as it is from 3.6 on, as far as damaged lines go: it says nothing of them.
pub static REPRAPFIRMWARE_SILENT: Dialect =
    Dialect { name: "reprapfirmware-silent", resend: "", ..REPRAPFIRMWARE_WORDS };

/// Repetier-Firmware 1.
pub static REPETIER: Dialect = Dialect {
    name: "repetier",
    family: Family::Repetier,
    boot: &["start", "Info:PowerUp", "Free RAM:2000"],
    numbering: Numbering::CheckedRepeatsSkipped,
    refusal: Refusal::Expected,
    resend: "Resend:",
    ok_after_resend: true,
    first_last_line: 0,
    clears_on_refusal: false,
    m110_takes_second: false,
    advanced_ok: false,
    ok_when_taken: true,
    wait: "wait",
    urgent: Urgent { by_byte: &[], by_line: &[Kill] },
    kill_order: &[],
    halt: Halt::RepeatsError,
    position: PositionForm::Repetier,
    extruder_mode: ExtruderMode::RelativeIfEither,
    moves_unhomed: true,
    place_homes: false,
    endstops_unhomed: false,
    // EXT0_WATCHPERIOD
    residency_s: 1.0,
    idle: IdleRule { motors_s: 360.0, ..MARLIN_IDLE },
    runout: &["RequestPause:No filament detected!"],
    runout_changes: false,
    prompts: false,
    busy: "busy:processing",
    firmware: "FIRMWARE_NAME:Repetier_1.0.4 (hil-sim) COMPILED:Jan  1 2020 \
               FIRMWARE_URL:https://github.com/repetier/Repetier-Firmware/ PROTOCOL_VERSION:1.0 MACHINE_TYPE:{machine} \
               EXTRUDER_COUNT:1 REPETIER_PROTOCOL:3",
    capabilities: &["Cap:PROGRESS:1", "Cap:AUTOREPORT_TEMP:1", "Cap:EEPROM:0"],
    halted: &[
        "fatal:Heater/sensor error Printer stopped and heaters disabled due to this error. Fix error and restart with M999.",
    ],
    codes: &[
        (b'M', 85),
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
    arcs: Some(ArcRule::Repetier),
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
    first_last_line: -1,
    clears_on_refusal: false,
    m110_takes_second: false,
    advanced_ok: false,
    ok_when_taken: false,
    wait: "",
    urgent: Urgent { by_byte: &[], by_line: &[] },
    kill_order: &[],
    halt: Halt::Alarm,
    position: PositionForm::Smoothie,
    extruder_mode: ExtruderMode::WithAxes,
    moves_unhomed: true,
    place_homes: false,
    endstops_unhomed: false,
    residency_s: 0.0,
    idle: NEVER_IDLE,
    runout: &["// Filament Detector has detected a filament jam"],
    runout_changes: false,
    prompts: false,
    busy: "",
    firmware: "FIRMWARE_NAME:Smoothieware, FIRMWARE_URL:http%3A//smoothieware.org, X-SOURCE_CODE_URL:https://github.com/\
               Smoothieware/Smoothieware, FIRMWARE_VERSION:edge (hil-sim), X-FIRMWARE_BUILD_DATE:Jan  1 2020 00:00:00, \
               X-SYSTEM_CLOCK:120MHz, X-AXES:4, X-GRBL_MODE:0, X-ARCS:1, X-CNC:0, X-MSD:1",
    capabilities: &[],
    halted: &["ok Emergency Stop Requested - reset or M999 required to exit HALT state"],
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
    arcs: Some(ArcRule::Smoothie),
};
