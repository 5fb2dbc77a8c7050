//! Where the firmware thinks it is, and how moves become blocks.
//!
//! Commanded positions are logical (`G92` shifts them); planned ones are native, from home. E is planned as filament
//! really moved: differences of the commanded E times the flow factor. All mm, mm/s.

use super::{Printer, Wait, commands::Outcome};
use crate::{
    dialect::{ExtruderMode, Family},
    gcode::Command,
    planner::{Limits, Position},
    profile::Profile,
};
use std::collections::VecDeque;

/// More at once is taken for a mistake, mm of filament.
const LONGEST_EXTRUSION_MM: f64 = 200.0;

/// A move that has not found room in the planner yet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pending {
    ends: [Position; 2],
    speed: f64,
}

/// Position and modes.
#[derive(Debug, Clone)]
pub(super) struct Motion {
    /// Commanded, logical.
    pub(super) position: Position,
    /// Logical minus native, X, Y, Z.
    offset: [f64; 3],
    /// Where the moves planned or pending end, native, E in filament.
    planned: Position,
    /// Where the motors were after the last finished move.
    pub(super) driven: Position,
    pub(super) homed: [bool; 3],
    /// Whether axes that are not home may move all the same (M564 H0).
    pub(super) moves_unhomed: bool,
    pub(super) relative: [bool; 3],
    /// M82 and M83.
    pub(super) relative_e: bool,
    /// Whether G91 makes the extruder relative as well, whatever M82 says.
    either: bool,
    pub(super) feedrate: f64,
    pub(super) feedrate_percent: f64,
    pub(super) flow_percent: f64,
    pub(super) soft_endstops: bool,
    pub(super) min_extrusion_c: f64,
    pub(super) limits: Limits,
    pub(super) steps_per_mm: [f64; 4],
    pub(super) pending: VecDeque<Pending>,
}

impl Motion {
    pub(super) fn new(profile: &Profile) -> Self {
        Self {
            position: [0.0; 4],
            offset: [0.0; 3],
            planned: [0.0; 4],
            driven: [0.0; 4],
            homed: [false; 3],
            moves_unhomed: profile.dialect.moves_unhomed,
            relative: [false; 3],
            relative_e: false,
            either: profile.dialect.extruder_mode == ExtruderMode::RelativeIfEither,
            feedrate: 25.0,
            feedrate_percent: 100.0,
            flow_percent: 100.0,
            soft_endstops: true,
            min_extrusion_c: profile.min_extrusion_c,
            limits: Limits {
                max_speed: profile.max_speed_mm_s,
                max_acceleration: profile.max_acceleration_mm_s2,
                print_acceleration: profile.print_acceleration_mm_s2,
                retract_acceleration: profile.retract_acceleration_mm_s2,
                travel_acceleration: profile.travel_acceleration_mm_s2,
                travel_max_acceleration: profile.travel_max_acceleration_mm_s2,
                cornering: profile.cornering,
            },
            steps_per_mm: profile.steps_per_mm,
            pending: VecDeque::new(),
        }
    }

    /// After a stop: what is commanded is where the motors are.
    pub(super) fn take_position_from_motors(&mut self) {
        let not_pushed = (self.planned[3] - self.driven[3]) / (self.flow_percent / 100.0).max(1e-6);
        self.position[3] -= not_pushed;
        self.planned = self.driven;
        for axis in 0..3 {
            self.position[axis] = self.planned[axis] + self.offset[axis];
        }
    }

    /// G90, G91.
    pub(super) fn set_relative(&mut self, relative: bool, extruder: ExtruderMode) {
        self.relative = [relative; 3];
        if extruder == ExtruderMode::WithAxes {
            self.relative_e = relative;
        }
    }

    const fn is_relative(&self, axis: usize) -> bool {
        match axis {
            3 => self.relative_e || self.either && self.relative[0],
            axis => self.relative[axis],
        }
    }

    /// Where the parameters of a move lead, logical.
    pub(super) fn target(&self, command: &Command<'_>) -> Position {
        let mut target = self.position;
        for (axis, letter) in [b'X', b'Y', b'Z', b'E'].into_iter().enumerate() {
            if let Some(value) = command.value(letter) {
                target[axis] = if self.is_relative(axis) { target[axis] + value } else { value };
            }
        }
        target
    }

    /// G92.
    pub(super) fn set_position(&mut self, command: &Command<'_>) {
        for (axis, letter) in [b'X', b'Y', b'Z'].into_iter().enumerate() {
            if let Some(value) = command.value(letter) {
                self.offset[axis] += value - self.position[axis];
                self.position[axis] = value;
            }
        }
        if let Some(value) = command.value(b'E') {
            self.position[3] = value;
        }
    }

    /// The axes that are home are at 0, wherever they were thought to be.
    pub(super) fn arrive_home(&mut self, axes: [bool; 3]) {
        for axis in (0..3).filter(|&axis| axes[axis]) {
            self.position[axis] = 0.0;
            self.offset[axis] = 0.0;
            self.planned[axis] = 0.0;
            self.homed[axis] = true;
        }
        self.driven = self.planned;
    }

    /// Where X, Y, Z are, native.
    pub(super) const fn native(&self) -> Position {
        self.planned
    }
}

impl Printer {
    /// G92. Where that homes, an axis that was nowhere (so nothing that moves it is under way) is there from now on.
    pub(super) fn set_place(&mut self, command: &Command<'_>) {
        for (axis, letter) in [b'X', b'Y', b'Z'].into_iter().enumerate() {
            let motion = &mut self.motion;
            let homes = self.profile.dialect.place_homes && !motion.homed[axis];
            let Some(value) = command.value(letter).filter(|_| homes) else { continue };
            self.deposit.shift_mm[axis] += motion.planned[axis] - value;
            (motion.planned[axis], motion.driven[axis]) = (value, value);
            (motion.position[axis], motion.offset[axis]) = (value, 0.0);
            motion.homed[axis] = true;
        }
        self.motion.set_position(command);
    }

    /// G0, G1.
    pub(super) fn linear_move(&mut self, command: &Command<'_>) -> Outcome {
        self.take_feedrate(command);
        let target = self.motion.target(command);
        if let Some(refusal) = self.refusal_of_place(target) {
            self.say(&refusal);
            return Outcome::Done;
        }
        self.note_numbered_move(command);
        self.plan(target);
        Outcome::Wait(Wait::Moves)
    }

    /// A move that came with a line number is executed.
    fn note_numbered_move(&mut self, command: &Command<'_>) {
        if let Some(number) = command.number {
            self.judge.numbered_move(number);
        }
    }

    fn take_feedrate(&mut self, command: &Command<'_>) {
        if let Some(mm_min) = command.value(b'F').filter(|&f| f > 0.0) {
            self.motion.feedrate = mm_min / 60.0;
        }
    }

    /// Why a firmware refuses to go there at all.
    fn refusal_of_place(&mut self, target: Position) -> Option<String> {
        let dialect = self.profile.dialect;
        let native = |axis: usize| target[axis] - self.motion.offset[axis];
        let moves = |axis: usize| (native(axis) - self.motion.planned[axis]).abs() > 1e-9;
        let outside = |axis: usize| !(-1e-9..=self.profile.bed_mm[axis] + 1e-9).contains(&native(axis));
        let unhomed =
            !self.motion.moves_unhomed && (0..3).any(|axis| moves(axis) && !self.motion.homed[axis]);
        let refused = unhomed || dialect.refuses_moves_outside() && (0..3).any(outside);
        if !refused {
            return None;
        }
        let [x, y, z] = [0, 1, 2].map(native);
        let pulled = target[3] - self.motion.position[3];
        self.summary.soft_endstop_hits += u64::from(!unhomed);
        self.summary.unhomed_refusals += u64::from(unhomed);
        if dialect.family == Family::RepRapFirmware {
            return Some("Error: G0/G1: insufficient axes homed".to_owned());
        }
        let why = if unhomed { "!! Must home axis first:" } else { "!! Move out of range:" };
        Some(format!("{why} {x:.3} {y:.3} {z:.3} [{pulled:.3}]"))
    }

    /// A straight move to `target` (logical) is to be planned.
    fn plan(&mut self, target: Position) {
        let pulled = self.allowed_extrusion(target[3] - self.motion.position[3]);
        let before = self.motion.planned;
        let mut native = before;
        for axis in 0..3 {
            native[axis] = self.clamp(axis, target[axis] - self.motion.offset[axis]);
            self.motion.position[axis] = native[axis] + self.motion.offset[axis];
        }
        native[3] += pulled * self.motion.flow_percent / 100.0;
        self.motion.position[3] = target[3];
        self.motion.planned = native;
        let speed = self.motion.feedrate * self.motion.feedrate_percent / 100.0;
        self.motion.pending.push_back(Pending { ends: [before, native], speed });
    }

    /// The filament that the firmware agrees to move.
    fn allowed_extrusion(&mut self, wanted_mm: f64) -> f64 {
        if wanted_mm == 0.0 {
            return 0.0;
        }
        if self.heaters[0].reading_c(self.now_s) < self.motion.min_extrusion_c {
            self.summary.cold_extrusions += 1;
            self.say(self.profile.dialect.cold_extrusion());
            return 0.0;
        }
        if wanted_mm.abs() > LONGEST_EXTRUSION_MM {
            self.say("echo: too long extrusion prevented");
            return 0.0;
        }
        wanted_mm
    }

    fn clamp(&mut self, axis: usize, native_mm: f64) -> f64 {
        let known = self.motion.homed[axis] || self.profile.dialect.endstops_unhomed;
        if !self.motion.soft_endstops || !known {
            return native_mm;
        }
        let inside = native_mm.clamp(0.0, self.profile.bed_mm[axis]);
        if (inside - native_mm).abs() > 1e-9 {
            self.summary.soft_endstop_hits += 1;
            self.state("soft-endstop", format!("axis {axis} {native_mm:.3}"));
        }
        inside
    }

    /// Plans what there is room for; true when all is planned.
    pub(super) fn plan_pending(&mut self) -> bool {
        while let Some(&Pending { ends, speed }) = self.motion.pending.front() {
            if self.planner.free() == 0 {
                return false;
            }
            self.summary.planner_dry += u64::from(std::mem::take(&mut self.ran_dry));
            self.judge.move_planned(self.now_s);
            self.planner.push(self.now_s, ends, speed, &self.motion.limits);
            self.motion.pending.pop_front();
            self.summary.peak_planner_depth =
                self.summary.peak_planner_depth.max(self.planner.depth() as u64);
        }
        true
    }

    /// G2, G3.
    pub(super) fn arc_move(&mut self, command: &Command<'_>, clockwise: bool) -> Outcome {
        self.take_feedrate(command);
        let from = self.motion.position;
        let target = self.motion.target(command);
        let Some(centre) = arc_centre(command, from, target, clockwise) else {
            self.say("Error:G2/G3 bad parameters");
            return Outcome::Done;
        };
        if let Some(refusal) = self.refusal_of_place(target) {
            self.say(&refusal);
            return Outcome::Done;
        }
        self.note_numbered_move(command);
        let radius = (from[0] - centre[0]).hypot(from[1] - centre[1]);
        let rule = self.profile.dialect.arcs.expect("arcs are known to a dialect that has a rule for them");
        let turn = arc_turn(from, target, centre, clockwise);
        let n_chords = rule.n_chords(radius, turn, target[2] - from[2], self.motion.feedrate);
        for point in arc_points([from, target], centre, if clockwise { -turn } else { turn }, n_chords) {
            self.plan(point);
        }
        Outcome::Wait(Wait::Moves)
    }
}

/// Centre of an arc given by `I`, `J` (from the start) or `R` (negative: the longer way).
fn arc_centre(command: &Command<'_>, from: Position, to: Position, clockwise: bool) -> Option<[f64; 2]> {
    if let Some(radius) = command.value(b'R') {
        let half = [(to[0] - from[0]) / 2.0, (to[1] - from[1]) / 2.0];
        let h = half[0].hypot(half[1]);
        if h < 1e-9 || radius.abs() < h - 1e-6 {
            return None;
        }
        let aside = (radius * radius - h * h).max(0.0).sqrt() / h;
        let side = if clockwise == (radius > 0.0) { -aside } else { aside };
        return Some([(-half[1]).mul_add(side, from[0] + half[0]), half[0].mul_add(side, from[1] + half[1])]);
    }
    let [i, j] = [command.value(b'I').unwrap_or(0.0), command.value(b'J').unwrap_or(0.0)];
    (i.hypot(j) > 1e-9).then_some([from[0] + i, from[1] + j])
}

/// The angle that an arc goes through, more than 0 and a whole turn at most.
fn arc_turn(from: Position, to: Position, centre: [f64; 2], clockwise: bool) -> f64 {
    use std::f64::consts::TAU;
    let start = (from[1] - centre[1]).atan2(from[0] - centre[0]);
    let end = (to[1] - centre[1]).atan2(to[0] - centre[0]);
    let turn = if clockwise { (start - end).rem_euclid(TAU) } else { (end - start).rem_euclid(TAU) };
    if turn < 1e-9 { TAU } else { turn }
}

/// The ends of the `n` chords of an arc through `turn` (positive: counter-clockwise), the last one exactly `to`.
fn arc_points([from, to]: [Position; 2], centre: [f64; 2], turn: f64, n: usize) -> Vec<Position> {
    let start = (from[1] - centre[1]).atan2(from[0] - centre[0]);
    let radius = (from[0] - centre[0]).hypot(from[1] - centre[1]);
    let mut points: Vec<Position> = (1..n)
        .map(|k| {
            let share = k as f64 / n as f64;
            let angle = turn.mul_add(share, start);
            let along = |axis: usize| (to[axis] - from[axis]).mul_add(share, from[axis]);
            [
                radius.mul_add(angle.cos(), centre[0]),
                radius.mul_add(angle.sin(), centre[1]),
                along(2),
                along(3),
            ]
        })
        .collect();
    points.push(to);
    points
}
