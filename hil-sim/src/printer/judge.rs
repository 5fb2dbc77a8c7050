//! What a judge needs besides the beads: did the planner run dry, was anything done twice, left hot or moved blindly.
//!
//! Figures that stop counting where the host wants it so: a planner that is empty because of M400, a dwell or a wait is not
//! dry. Beads are compared within the last layers only, so that memory is bounded by a layer.

use super::{Life, Printer, Wait};
use crate::{
    event::{Bead, Summary},
    planner::Block,
    thermal::Heater,
    whole,
};
use std::collections::{BTreeMap, HashSet, VecDeque};

/// Heaters that are on for longer than this without a byte from the host are unattended, s.
const UNATTENDED_S: f64 = 600.0;
/// Beads are compared in whole µm.
const MICROMETRES_PER_MM: f64 = 1000.0;
/// Layers in which beads are compared.
const LAYERS_KEPT: usize = 3;

/// Figures that take more than a counter.
#[derive(Debug, Clone, Default)]
pub(super) struct Judge {
    /// Fewest moves seen since the last one was planned; it counts only if another follows.
    seen_depth: Option<u64>,
    dry_since_s: Option<f64>,
    /// Highest number of a line whose move was planned.
    last_number: Option<i64>,
    /// Beads of the last layers, by height in µm.
    layers: VecDeque<(i64, HashSet<[i64; 4]>)>,
    pub(super) min_depth: Option<u64>,
    pub(super) dry_s: f64,
    pub(super) repeated_lines: u64,
    pub(super) repeated_beads: u64,
    pub(super) unattended_s: f64,
    pub(super) unsafe_states: BTreeMap<&'static str, u64>,
}

impl Judge {
    /// A move has ended and left `depth` others; `expected`: the host waits for the end of all.
    pub(super) fn move_ended(&mut self, depth: usize, now_s: f64, expected: bool) {
        if expected {
            return self.pause();
        }
        let depth = depth as u64;
        self.seen_depth = Some(self.seen_depth.map_or(depth, |seen| seen.min(depth)));
        if depth == 0 {
            self.dry_since_s = Some(now_s);
        }
    }

    /// The planner is empty because it is meant to be.
    pub(super) const fn pause(&mut self) {
        self.seen_depth = None;
        self.dry_since_s = None;
    }

    /// Another move is planned: what was seen before counts.
    pub(super) fn move_planned(&mut self, now_s: f64) {
        if let Some(seen) = self.seen_depth.take() {
            self.min_depth = Some(self.min_depth.map_or(seen, |least| least.min(seen)));
        }
        if let Some(since_s) = self.dry_since_s.take() {
            self.dry_s += now_s - since_s;
        }
    }

    /// A move begins that came with line `number`.
    pub(super) fn numbered_move(&mut self, number: i64) {
        self.repeated_lines += u64::from(self.last_number.is_some_and(|last| number <= last));
        self.last_number = Some(self.last_number.map_or(number, |last| last.max(number)));
    }

    /// M110, or a reset: numbers say nothing about those before.
    pub(super) const fn numbering_begins_anew(&mut self) {
        self.last_number = None;
    }

    /// A bead is laid; is there the very same one already?
    pub(super) fn bead(&mut self, bead: &Bead) {
        let um = |mm: f64| whole::to_i64(mm * MICROMETRES_PER_MM);
        let z = um(bead.to_mm[2]);
        let ends = [bead.from_mm[0], bead.from_mm[1], bead.to_mm[0], bead.to_mm[1]].map(um);
        let at = self.layers.iter().rposition(|layer| layer.0 == z).unwrap_or_else(|| {
            if self.layers.len() >= LAYERS_KEPT {
                self.layers.pop_front();
            }
            self.layers.push_back((z, HashSet::new()));
            self.layers.len() - 1
        });
        self.repeated_beads += u64::from(!self.layers[at].1.insert(ends));
    }

    pub(super) fn danger(&mut self, what: &'static str) {
        *self.unsafe_states.entry(what).or_default() += 1;
    }
}

impl Printer {
    /// A move starts: does the firmware know where the axes are?
    pub(super) fn judge_start(&mut self, block: &Block) {
        let moves = |axis: usize| (block.to[axis] - block.from[axis]).abs() > 1e-9;
        if (0..3).any(|axis| moves(axis) && !self.motion.homed[axis]) {
            let extrudes = block.to[3] > block.from[3];
            self.judge.danger(if extrudes { "extruded-unhomed" } else { "moved-unhomed" });
        }
    }

    /// An axis is homed: does it run into what is printed?
    pub(super) fn judge_homing(&mut self, axes: [bool; 3]) {
        if axes[2] && self.deposit.layers.count() > 0 {
            self.judge.danger("homed-z-onto-print");
        }
    }

    /// Looks how long heaters have been on without a byte from the host.
    pub(super) fn note_unattended(&mut self) {
        if self.heaters.iter().any(|heater| heater.target_c > 0.0) {
            let gap_s = self.now_s - self.traffic_s;
            if gap_s > UNATTENDED_S && self.judge.unattended_s <= UNATTENDED_S {
                self.judge.danger("heated-unattended");
            }
            self.judge.unattended_s = self.judge.unattended_s.max(gap_s);
        }
    }

    /// Whether no move can follow for now, so that the planner may run empty: the printer waits for its moves to end or to warm up.
    pub(super) const fn is_meant_to_stand(&self) -> bool {
        matches!(self.wait, Some(Wait::Drain(_) | Wait::Heat(_)))
    }

    /// What the run has come to so far.
    #[must_use]
    pub fn summary(&self) -> Summary {
        let temperature = |heater: &Heater| [heater.temperature_c(self.now_s), heater.target_c];
        let heaters_on = self.heaters.iter().any(|heater| heater.target_c > 0.0);
        let quiet_s = self.now_s - self.traffic_s;
        let unattended_s = self.judge.unattended_s.max(if heaters_on { quiet_s } else { 0.0 });
        Summary {
            profile: self.profile.name.to_owned(),
            seed: self.seed,
            simulated_s: self.now_s,
            overrun_bytes: self.incoming.overrun_bytes,
            layers: self.deposit.layers.count() as u64,
            filament_mm: self.deposit.net_mm,
            last_state: self.state_name().to_owned(),
            last_line: self.receiver.last_line,
            position_mm: self.motion.position,
            hotend_c: temperature(&self.heaters[0]),
            bed_c: temperature(&self.heaters[1]),
            least_planner_depth: self.judge.min_depth,
            planner_dry_s: self.judge.dry_s,
            heaters_on,
            quiet_s,
            unattended_hot_s: unattended_s,
            host_gone_s: self.alone_s.map(|since_s| self.now_s - since_s),
            repeated_move_lines: self.judge.repeated_lines,
            repeated_beads: self.judge.repeated_beads,
            unsafe_states: self.judge.unsafe_states.clone(),
            ..self.summary.clone()
        }
    }

    fn state_name(&self) -> &'static str {
        match (self.life, &self.wait) {
            (Life::Off, _) => "off",
            (Life::Down, _) => "down",
            (Life::Killed | Life::Halted, _) => "killed",
            _ if !self.is_plugged() => "unplugged",
            _ if self.is_silent() => "silent",
            (_, Some(Wait::Heat(_))) => "heating",
            (_, Some(Wait::User { .. })) if self.change.is_some() => "waiting-for-filament",
            (_, Some(Wait::User { .. })) => "waiting-for-user",
            (_, Some(_)) => "busy",
            (_, None) if self.has_moves() => "moving",
            (_, None) => "idle",
        }
    }
}
