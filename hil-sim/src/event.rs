//! What is recorded: beads, commands, faults, changes of state.

/// One stretch of deposited material, bed frame, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bead {
    /// Simulated time at which it begins, s.
    pub t_s: f64,
    /// Where it begins.
    pub from_mm: [f64; 3],
    /// Where it ends.
    pub to_mm: [f64; 3],
    /// Its volume.
    pub volume_mm3: f64,
    /// Its width by the machine's bead model.
    pub width_mm: f64,
    /// Its height above what lies below.
    pub height_mm: f64,
    /// Hotend temperature when it begins, °C.
    pub hotend_c: f64,
}

/// What happened, with the simulated time in seconds.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// Material was laid down.
    Bead(Bead),
    /// A line was accepted into the command queue.
    Command {
        /// When.
        t_s: f64,
        /// As received, without the line end.
        text: Vec<u8>,
    },
    /// A line was refused.
    Refused {
        /// When.
        t_s: f64,
        /// As received, without the line end.
        text: Vec<u8>,
        /// Why, as the firmware words it; `repeated` for one dropped in silence.
        reason: &'static str,
    },
    /// A fault was injected.
    Fault {
        /// When.
        t_s: f64,
        /// Its kind, as in the SPEC.
        kind: &'static str,
        /// What it did.
        detail: String,
    },
    /// The printer went into another state.
    State {
        /// When.
        t_s: f64,
        /// Which, in one word: `booted`, `homed`, `layer`, `killed`, ...
        state: &'static str,
        /// What it holds.
        detail: String,
    },
}

/// What the whole run came to.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize)]
pub struct Summary {
    /// Profile of the machine.
    pub profile: String,
    /// Seed of the faults.
    pub seed: u64,
    /// Simulated time, s.
    pub simulated_s: f64,
    /// Time in which axes moved, s.
    pub moving_s: f64,
    /// Bytes received, after the faults of the wire.
    pub bytes_received: u64,
    /// Lines received, after the faults of the wire.
    pub lines_received: u64,
    /// Commands executed.
    pub commands_executed: u64,
    /// Commands nobody knows.
    pub unknown_commands: u64,
    /// Requests to send a line again.
    pub resend_requests: u64,
    /// Lines dropped because they were there already.
    pub repeated_lines: u64,
    /// Bytes lost because the receive ring was full.
    pub overrun_bytes: u64,
    /// Moves executed.
    pub moves: u64,
    /// Rows of `beads.csv`.
    pub beads: u64,
    /// Layers found.
    pub layers: u64,
    /// Deposited in rows, mm³.
    pub deposited_mm3: f64,
    /// Extruded on the spot (no row in `beads.csv`), mm³.
    pub blob_mm3: f64,
    /// Net filament pulled in, mm.
    pub filament_mm: f64,
    /// Most moves that the planner held.
    pub peak_planner_depth: u64,
    /// How often the planner ran dry between two moves.
    pub planner_dry: u64,
    /// Moves cut off at the machine's limits.
    pub soft_endstop_hits: u64,
    /// Moves refused because an axis was not home.
    pub unhomed_refusals: u64,
    /// Extrusions refused because the hotend was cold.
    pub cold_extrusions: u64,
    /// Faults injected, by kind.
    pub faults: std::collections::BTreeMap<&'static str, u64>,
    /// State at the end.
    pub last_state: String,
    /// Number of the last numbered line accepted.
    pub last_line: i64,
    /// Commanded position at the end, X, Y, Z, E.
    pub position_mm: [f64; 4],
    /// Hotend at the end, °C, and its target.
    pub hotend_c: [f64; 2],
    /// Bed at the end, °C, and its target.
    pub bed_c: [f64; 2],
    /// Fewest moves that were left in the planner when one ended and another followed, unless the host waited for the end of
    /// all; none without such a moment.
    pub least_planner_depth: Option<u64>,
    /// Time in which the planner was dry between two moves, s.
    pub planner_dry_s: f64,
    /// Whether a heater has a target at the end.
    pub heaters_on: bool,
    /// Time since the last byte from the host, s.
    pub quiet_s: f64,
    /// Longest time for which a heater was on without a byte from the host, s.
    pub unattended_hot_s: f64,
    /// For how long nobody has had the port open at the end, s; none if somebody has.
    pub host_gone_s: Option<f64>,
    /// Moves of numbered lines whose number was not above that of an earlier move (since the last M110 or reset).
    pub repeated_move_lines: u64,
    /// Beads laid exactly where there was one already, in the last layers.
    pub repeated_beads: u64,
    /// What was unsafe, and how often: `moved-unhomed`, `extruded-unhomed` (moves while an axis was not home),
    /// `homed-z-onto-print` (Z was homed with something on the bed), `heated-unattended` (for ten minutes without a byte).
    pub unsafe_states: std::collections::BTreeMap<&'static str, u64>,
}
