//! Moves to trapezoids: a planner with look-ahead, as in Grbl and Marlin.
//!
//! Every move accelerates, cruises and decelerates along its straight line. At a junction the speed is bounded so that a
//! circle which touches both moves and leaves the corner by the junction deviation could be driven at the moves'
//! acceleration (Jeon, "Improving Grbl: cornering algorithm", 2011). A backward pass bounds every entry speed so that the
//! machine can stop at the end of what is known, a forward pass bounds it by what can be reached. A move's profile is
//! fixed when it starts; E takes part in the direction, so that a retraction is a corner.
//!
//! Legend: lengths mm, speeds mm/s (squares mm²/s²), accelerations mm/s², times s on the simulated clock.
//! Not done: jerk-limited (S-curve) ramps, quantisation to steps.

use std::collections::VecDeque;

/// X, Y, Z, E.
pub type Position = [f64; 4];

/// How fast the machine may go round a corner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cornering {
    /// So fast that a circle which leaves the corner by this, mm, could be driven at the moves' acceleration; every run
    /// begins and ends at rest.
    Deviation(f64),
    /// So fast that no axis changes its speed by more than this at once, mm/s.
    Jerk {
        /// X, Y, Z, E.
        axes: [f64; 4],
        /// An axis that turns back counts the larger of its two speeds, not their sum.
        eased: bool,
        /// X and Y are measured together, as one vector.
        planar: bool,
        /// Share of it by which a run may begin and end with a jump.
        rest_share: f64,
    },
    /// A right angle at this speed, mm/s; others by the junction deviation that follows from it, along X, Y, Z alone, and
    /// no faster than round a circle that touches both moves within their nearer halves (Klipper).
    SquareCorner(f64),
}

/// Change of the extruder's speed that Klipper allows at once, mm/s.
const KLIPPER_EXTRUDER_STEP: f64 = 1.0;

/// Limits of the machine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Fastest per axis.
    pub max_speed: [f64; 4],
    /// Strongest per axis.
    pub max_acceleration: [f64; 4],
    /// The same for moves that do not extrude, where the firmware has its own.
    pub travel_max_acceleration: Option<[f64; 4]>,
    /// Moves that extrude.
    pub print_acceleration: f64,
    /// E alone.
    pub retract_acceleration: f64,
    /// Moves that do not extrude.
    pub travel_acceleration: f64,
    /// Corners.
    pub cornering: Cornering,
}

/// A move between two points with the speeds at which it is driven.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Profile {
    /// When it starts.
    pub start_s: f64,
    entry: f64,
    peak: f64,
    accelerate_s: f64,
    cruise_s: f64,
    decelerate_s: f64,
    acceleration: f64,
}

impl Profile {
    /// The fastest way along `length` from the square of the entry speed to that of the exit speed.
    #[must_use]
    pub fn new(start_s: f64, length: f64, squares: [f64; 2], nominal: f64, acceleration: f64) -> Self {
        let [entry2, exit2] = squares;
        let reach2 = acceleration.mul_add(length, (entry2 + exit2) / 2.0);
        let peak = nominal.min(reach2.sqrt()).max(entry2.max(exit2).sqrt());
        let (entry, exit) = (entry2.sqrt(), exit2.sqrt());
        let ramps = (2.0 * peak).mul_add(peak, -entry2 - exit2) / (2.0 * acceleration);
        Self {
            start_s,
            entry,
            peak,
            accelerate_s: (peak - entry) / acceleration,
            cruise_s: ((length - ramps) / peak).max(0.0),
            decelerate_s: (peak - exit) / acceleration,
            acceleration,
        }
    }

    /// How long it takes.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.accelerate_s + self.cruise_s + self.decelerate_s
    }

    /// When it ends.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.start_s + self.duration_s()
    }

    /// How far it has come at time `t_s`.
    #[must_use]
    pub fn travelled(&self, t_s: f64) -> f64 {
        let t = (t_s - self.start_s).clamp(0.0, self.duration_s());
        let up = t.min(self.accelerate_s);
        let level = (t - self.accelerate_s).clamp(0.0, self.cruise_s);
        let down = (t - self.accelerate_s - self.cruise_s).max(0.0);
        let half = self.acceleration / 2.0;
        self.entry * up + half * up * up + self.peak * level + self.peak * down - half * down * down
    }
}

/// A planned move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Block {
    /// Where it begins.
    pub from: Position,
    /// Where it ends.
    pub to: Position,
    /// Its length: along X, Y, Z, or along E where nothing else moves.
    pub length: f64,
    /// Change of each axis along a unit of length.
    direction: [f64; 4],
    nominal: f64,
    acceleration: f64,
    max_entry2: f64,
    entry2: f64,
    /// Square of the speed at which it may begin or end at rest.
    rest2: f64,
    /// Whether another was planned when it was.
    follows: bool,
    /// Once it has started.
    pub profile: Option<Profile>,
}

impl Block {
    /// Where it is after `share` (0..1) of its length.
    #[must_use]
    pub fn at(&self, share: f64) -> Position {
        std::array::from_fn(|axis| (self.to[axis] - self.from[axis]).mul_add(share, self.from[axis]))
    }

    fn share_at(&self, t_s: f64) -> f64 {
        self.profile.map_or(0.0, |profile| (profile.travelled(t_s) / self.length).clamp(0.0, 1.0))
    }
}

/// How long the first move of an empty planner waits for company, s (Marlin: `BLOCK_DELAY_FOR_1ST_MOVE`).
const FIRST_MOVE_DELAY_S: f64 = 0.1;
/// With this many moves it does not wait.
const COMPANY: usize = 3;

/// The moves that are known, the first of them perhaps under way.
#[derive(Debug, Clone)]
pub struct Planner {
    blocks: VecDeque<Block>,
    slots: usize,
    /// When the last finished move ended.
    free_s: f64,
    /// Before that the first move does not start.
    hold_s: f64,
    last: Option<Block>,
}

impl Planner {
    /// An empty one with a ring of `blocks`, one of which always stays empty.
    #[must_use]
    pub fn new(blocks: usize) -> Self {
        Self {
            blocks: VecDeque::with_capacity(blocks),
            slots: blocks.saturating_sub(1).max(1),
            free_s: 0.0,
            hold_s: 0.0,
            last: None,
        }
    }

    /// Moves planned.
    #[must_use]
    pub fn depth(&self) -> usize {
        self.blocks.len()
    }

    /// Moves that still find room.
    #[must_use]
    pub fn free(&self) -> usize {
        self.slots.saturating_sub(self.blocks.len())
    }

    /// Plans a straight move from `from` to `to` at `speed`; false if nothing moves. There must be room.
    pub fn push(&mut self, now_s: f64, ends: [Position; 2], speed: f64, limits: &Limits) -> bool {
        let Some(mut block) = shape(ends, speed, limits) else { return false };
        let before = self.last.filter(|_| !self.blocks.is_empty());
        block.follows = before.is_some();
        block.max_entry2 = before.map_or(block.rest2, |before| junction2(&before, &block, limits));
        if before.is_none() {
            self.hold_s = now_s + FIRST_MOVE_DELAY_S;
        }
        self.last = Some(block);
        self.blocks.push_back(block);
        if self.blocks.len() >= COMPANY {
            self.release(now_s);
        }
        self.recalculate();
        true
    }

    /// Lets the first move start without waiting for company.
    pub fn release(&mut self, now_s: f64) {
        self.hold_s = self.hold_s.min(now_s);
    }

    /// Both passes over what has not started.
    fn recalculate(&mut self) {
        let first = usize::from(self.blocks.front().is_some_and(|block| block.profile.is_some()));
        let mut exit2 = self.blocks.back().map_or(0.0, |last| last.rest2);
        for index in (first..self.blocks.len()).rev() {
            let block = &mut self.blocks[index];
            // The entry of a move that follows one under way is that one's exit: it is fixed.
            if index > 0 && index == first {
                break;
            }
            block.entry2 = block.max_entry2.min((2.0 * block.acceleration).mul_add(block.length, exit2));
            exit2 = block.entry2;
        }
        for index in first..self.blocks.len().saturating_sub(1) {
            let block = &self.blocks[index];
            let reach2 = (2.0 * block.acceleration).mul_add(block.length, block.entry2);
            let next = &mut self.blocks[index + 1];
            next.entry2 = next.entry2.min(reach2);
        }
    }

    /// When the first move starts, where it has not yet.
    #[must_use]
    pub fn next_start_s(&self) -> Option<f64> {
        let first = self.blocks.front().filter(|block| block.profile.is_none())?;
        // A move that follows another closely does not wait.
        Some(if first.follows { self.free_s } else { self.free_s.max(self.hold_s) })
    }

    /// When the move under way ends.
    #[must_use]
    pub fn next_end_s(&self) -> Option<f64> {
        Some(self.blocks.front()?.profile?.end_s())
    }

    /// Starts the first move: its profile is fixed now.
    pub fn start(&mut self) -> Option<&Block> {
        let start_s = self.next_start_s()?;
        let exit2 = self.blocks.get(1).map(|next| next.entry2);
        let block = self.blocks.front_mut()?;
        let reach2 = (2.0 * block.acceleration).mul_add(block.length, block.entry2);
        let exit2 = exit2.unwrap_or_else(|| block.rest2.min(reach2));
        block.profile = Some(Profile::new(
            start_s,
            block.length,
            [block.entry2, exit2],
            block.nominal,
            block.acceleration,
        ));
        Some(block)
    }

    /// Takes away the move under way, which has ended.
    pub fn finish(&mut self) -> Option<Block> {
        self.free_s = self.next_end_s()?;
        let block = self.blocks.pop_front()?;
        // What follows enters at the speed at which this one left, whatever becomes known until it starts.
        if let Some(next) = self.blocks.front_mut() {
            next.max_entry2 = next.entry2;
        }
        Some(block)
    }

    /// Where the tool is at `t_s`, where a move is under way.
    #[must_use]
    pub fn position_at(&self, t_s: f64) -> Option<Position> {
        let block = self.blocks.front()?;
        Some(block.at(block.share_at(t_s)))
    }

    /// Stops at once; gives the move under way, cut to what was driven of it.
    pub fn stop(&mut self, now_s: f64) -> Option<Block> {
        let first = self.blocks.pop_front();
        self.blocks.clear();
        self.free_s = now_s;
        let mut block = first.filter(|block| block.profile.is_some())?;
        let share = block.share_at(now_s);
        block.to = block.at(share);
        block.length *= share;
        Some(block)
    }
}

/// The square of the highest speed at which `next` may follow `last`.
fn junction2(last: &Block, next: &Block, limits: &Limits) -> f64 {
    let nominal = next.nominal.min(last.nominal);
    match limits.cornering {
        Cornering::Deviation(deviation) => deviation_speed2(last, next, deviation).min(nominal * nominal),
        Cornering::Jerk { .. } => jerk_speed(last.direction, next.direction, limits).min(nominal).powi(2),
        Cornering::SquareCorner(speed) => square_corner_speed2(last, next, speed).min(nominal * nominal),
    }
}

fn unit<const N: usize>(direction: &[f64]) -> [f64; N] {
    let norm = direction[..N].iter().map(|d| d * d).sum::<f64>().sqrt();
    std::array::from_fn(|axis| if norm > 0.0 { direction[axis] / norm } else { 0.0 })
}

/// Half the sine that the junction formula is in, of the angle between two directions; none where they turn back.
fn half_sine<const N: usize>(last: &Block, next: &Block) -> Option<f64> {
    let (from, to) = (unit::<N>(&last.direction), unit::<N>(&next.direction));
    let cosine: f64 = -from.iter().zip(&to).map(|(a, b)| a * b).sum::<f64>();
    (cosine <= 0.999_999).then(|| (0.5 * (1.0 - cosine.max(-1.0))).sqrt())
}

/// Grbl's and Marlin's junction deviation; E takes part in the direction.
fn deviation_speed2(last: &Block, next: &Block, deviation: f64) -> f64 {
    match half_sine::<4>(last, next) {
        None => 0.0,
        Some(sine) if sine > 0.999_999_7 => f64::INFINITY,
        Some(sine) => next.acceleration * deviation * sine / (1.0 - sine),
    }
}

/// The speed at which no axis changes its own by more than it may between two directions.
fn jerk_speed(from: [f64; 4], to: [f64; 4], limits: &Limits) -> f64 {
    let Cornering::Jerk { axes, eased, planar, .. } = limits.cornering else { return 0.0 };
    let change = |axis: usize| {
        let (a, b) = (from[axis], to[axis]);
        if eased && a * b < 0.0 { a.abs().max(b.abs()) } else { (b - a).abs() }
    };
    let mut changes: [f64; 4] = std::array::from_fn(change);
    if planar {
        changes = [changes[0].hypot(changes[1]), 0.0, changes[2], changes[3]];
    }
    let speeds = changes.iter().zip(axes).filter(|(change, _)| **change > 1e-12).map(|(c, jerk)| jerk / c);
    speeds.fold(f64::INFINITY, f64::min)
}

/// Klipper's rule.
fn square_corner_speed2(last: &Block, next: &Block, square_corner: f64) -> f64 {
    let moves = |block: &Block| block.direction[..3].iter().any(|d| *d != 0.0);
    if !moves(last) || !moves(next) {
        return 0.0;
    }
    let Some(sine) = half_sine::<3>(last, next) else { return 0.0 };
    let sine = sine.min(0.999_999_75);
    let deviation = |block: &Block| square_corner.powi(2) * (2.0_f64.sqrt() - 1.0) / block.acceleration;
    let tangent = sine / (1.0 - sine * sine).sqrt();
    let bound = |block: &Block| {
        let circle = sine / (1.0 - sine) * deviation(block) * block.acceleration;
        circle.min(0.5 * block.length * tangent * block.acceleration)
    };
    let step = (next.direction[3] - last.direction[3]).abs();
    let extruder = if step > 0.0 { (KLIPPER_EXTRUDER_STEP / step).powi(2) } else { f64::INFINITY };
    bound(last).min(bound(next)).min(extruder)
}

/// A move by itself: direction, speed and acceleration within the limits; none if nothing moves.
fn shape([from, to]: [Position; 2], speed: f64, limits: &Limits) -> Option<Block> {
    let delta: [f64; 4] = std::array::from_fn(|axis| to[axis] - from[axis]);
    let path = delta[..3].iter().map(|d| d * d).sum::<f64>().sqrt();
    let (length, wanted) = if path > 1e-9 {
        let extrudes = delta[3].abs() > 1e-12;
        (path, if extrudes { limits.print_acceleration } else { limits.travel_acceleration })
    } else {
        (delta[3].abs(), limits.retract_acceleration)
    };
    if length < 1e-9 {
        return None;
    }
    let (mut nominal, mut acceleration) = (speed, wanted);
    let travels = delta[3].abs() <= 1e-12;
    let strongest = limits.travel_max_acceleration.filter(|_| travels).unwrap_or(limits.max_acceleration);
    for ((d, max_speed), max_acceleration) in delta.iter().zip(limits.max_speed).zip(strongest) {
        let share = d.abs() / length;
        if share > 0.0 {
            nominal = nominal.min(max_speed / share);
            acceleration = acceleration.min(max_acceleration / share);
        }
    }
    let direction = delta.map(|d| d / length);
    let rest2 = match limits.cornering {
        Cornering::Jerk { rest_share, .. } => {
            (jerk_speed([0.0; 4], direction, limits) * rest_share).min(nominal).powi(2)
        }
        _ => 0.0,
    };
    Some(Block {
        from,
        to,
        length,
        direction,
        nominal,
        acceleration,
        max_entry2: 0.0,
        entry2: 0.0,
        rest2,
        follows: false,
        profile: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LIMITS: Limits = Limits {
        max_speed: [500.0, 500.0, 10.0, 60.0],
        max_acceleration: [3000.0, 3000.0, 100.0, 5000.0],
        print_acceleration: 1000.0,
        retract_acceleration: 3000.0,
        travel_acceleration: 1500.0,
        travel_max_acceleration: None,
        cornering: Cornering::Deviation(0.013),
    };

    /// Drives through all points as one queue, at most 15 moves known; the total time and the finished moves.
    fn drive(points: &[Position], speed: f64) -> (f64, Vec<Block>) {
        let mut planner = Planner::new(16);
        let mut done = Vec::new();
        let mut finish = |planner: &mut Planner| {
            planner.release(0.0);
            if planner.next_end_s().is_none() {
                planner.start();
            }
            done.extend(planner.finish());
        };
        for pair in points.windows(2) {
            while planner.free() == 0 {
                finish(&mut planner);
            }
            planner.push(0.0, [pair[0], pair[1]], speed, &LIMITS);
        }
        while planner.depth() > 0 {
            finish(&mut planner);
        }
        (planner.free_s, done)
    }

    #[test]
    fn one_move_takes_the_time_of_its_trapezoid() {
        // 100 mm at 100 mm/s and 1500 mm/s²: s/v + v/a.
        let (time, _) = drive(&[[0.0; 4], [100.0, 0.0, 0.0, 0.0]], 100.0);
        assert!((time - (1.0 + 100.0 / 1500.0)).abs() < 1e-9, "{time}");
        // 2 mm are too short for 100 mm/s: 2 sqrt(s/a).
        let (time, _) = drive(&[[0.0; 4], [2.0, 0.0, 0.0, 0.0]], 100.0);
        assert!((time - 2.0 * (2.0_f64 / 1500.0).sqrt()).abs() < 1e-9, "{time}");
    }

    #[test]
    fn straight_line_in_pieces_takes_the_time_of_one() {
        let points: Vec<Position> =
            (0..=200).map(|i| [f64::from(i) * 0.5, 0.0, 0.0, f64::from(i) * 0.02]).collect();
        let (time, _) = drive(&points, 60.0);
        // 15 moves of 0.5 mm are enough to stop from 60 mm/s at 1000 mm/s² (1.8 mm).
        assert!((time / (100.0 / 60.0 + 60.0 / 1000.0) - 1.0).abs() < 1e-9, "{time}");
    }

    #[test]
    fn right_angle_is_taken_at_the_junction_speed() {
        let corner = [[0.0; 4], [50.0, 0.0, 0.0, 0.0], [50.0, 50.0, 0.0, 0.0]];
        let (time, done) = drive(&corner, 100.0);
        let half_sine = 0.5_f64.sqrt();
        let v2 = 1500.0 * 0.013 * half_sine / (1.0 - half_sine);
        let ramp = |from2: f64| 100.0_f64.mul_add(100.0, -from2) / 3000.0;
        let expected =
            2.0 * ((100.0 - v2.sqrt()) / 1500.0 + 100.0 / 1500.0 + (50.0 - ramp(v2) - ramp(0.0)) / 100.0);
        assert!((time / expected - 1.0).abs() < 1e-9, "{time} {expected}");
        assert_eq!(done.len(), 2);
    }

    /// Time of two moves of 50 mm with a right angle between them, taken at `corner` mm/s, begun and ended at `rest`.
    fn right_angle_s(cornering: Cornering) -> f64 {
        let limits = Limits { cornering, ..LIMITS };
        let mut planner = Planner::new(16);
        planner.push(0.0, [[0.0; 4], [50.0, 0.0, 0.0, 0.0]], 100.0, &limits);
        planner.push(0.0, [[50.0, 0.0, 0.0, 0.0], [50.0, 50.0, 0.0, 0.0]], 100.0, &limits);
        planner.release(0.0);
        while planner.depth() > 0 {
            planner.start();
            planner.finish();
        }
        planner.free_s
    }

    fn expected_s(rest: f64, corner: f64) -> f64 {
        let (v, a) = (100.0_f64, LIMITS.travel_acceleration);
        let ramps = 2.0f64.mul_add(v * v, -rest * rest - corner * corner) / (2.0 * a);
        2.0 * ((2.0 * v - rest - corner) / a + (50.0 - ramps) / v)
    }

    #[test]
    fn every_rule_of_corners_takes_a_right_angle_at_its_own_speed() {
        let jerk = |planar, rest_share| Cornering::Jerk { axes: [8.0; 4], eased: true, planar, rest_share };
        for (cornering, rest, corner) in [
            (jerk(false, 1.0), 8.0, 8.0),
            (jerk(false, 0.0), 0.0, 8.0),
            (jerk(true, 0.5), 4.0, 8.0 / 2.0_f64.sqrt()),
            (Cornering::SquareCorner(5.0), 0.0, 5.0),
        ] {
            let (time, expected) = (right_angle_s(cornering), expected_s(rest, corner));
            assert!((time / expected - 1.0).abs() < 1e-9, "{cornering:?}: {time} {expected}");
        }
    }

    #[test]
    fn reversal_stops() {
        let there_and_back = [[0.0; 4], [30.0, 0.0, 0.0, 0.0], [0.0; 4]];
        let (time, _) = drive(&there_and_back, 100.0);
        assert!((time - 2.0 * (0.3 + 100.0 / 1500.0)).abs() < 1e-9, "{time}");
    }

    #[test]
    fn axis_limits_slow_the_whole_move() {
        let (time, _) = drive(&[[0.0; 4], [0.0, 0.0, 10.0, 0.0]], 100.0);
        assert!((time - (1.0 + 10.0 / 100.0)).abs() < 1e-9, "{time}");
        let (time, _) = drive(&[[0.0; 4], [0.0, 0.0, 0.0, 5.0]], 35.0);
        assert!((time - (5.0 / 35.0 + 35.0 / 3000.0)).abs() < 1e-9, "{time}");
    }

    #[test]
    fn stop_leaves_what_was_driven() {
        let mut planner = Planner::new(16);
        planner.push(0.0, [[0.0; 4], [100.0, 0.0, 0.0, 4.0]], 50.0, &LIMITS);
        planner.release(0.0);
        planner.start();
        let block = planner.stop(1.025).unwrap();
        // 1.25 mm in the first 0.05 s, then 50 mm/s.
        assert!((block.to[0] - 50.0).abs() < 1e-9, "{:?}", block.to);
        assert!((block.to[3] - 2.0).abs() < 1e-9);
        assert_eq!(planner.depth(), 0);
    }

    #[test]
    fn lone_move_waits_for_company() {
        let mut planner = Planner::new(16);
        planner.push(5.0, [[0.0; 4], [1.0, 0.0, 0.0, 0.0]], 50.0, &LIMITS);
        assert_eq!(planner.next_start_s(), Some(5.1));
        for i in 1..3 {
            let x = f64::from(i);
            planner.push(5.01, [[x, 0.0, 0.0, 0.0], [x + 1.0, 0.0, 0.0, 0.0]], 50.0, &LIMITS);
        }
        assert_eq!(planner.next_start_s(), Some(5.01));
    }

    proptest! {
        #[test]
        fn speeds_are_continuous_and_within_limits(
            steps in proptest::collection::vec((-5.0_f64..5.0, -5.0_f64..5.0, 0.0_f64..0.2), 1..60),
            speed in 5.0_f64..200.0,
        ) {
            let mut at = [100.0, 100.0, 0.2, 0.0];
            let mut points = vec![at];
            for (dx, dy, de) in steps {
                at = [at[0] + dx, at[1] + dy, at[2], at[3] + de];
                points.push(at);
            }
            let (_, done) = drive(&points, speed);
            let mut exit: Option<(f64, f64)> = None;
            for block in &done {
                let profile = block.profile.unwrap();
                if let Some((speed, end_s)) = exit {
                    prop_assert!((profile.entry - speed).abs() < 1e-6);
                    prop_assert!((profile.start_s - end_s).abs() < 1e-9);
                }
                prop_assert!(profile.peak <= speed + 1e-6);
                prop_assert!((profile.travelled(profile.end_s()) - block.length).abs() < 1e-6 * block.length.max(1.0));
                exit = Some((profile.acceleration.mul_add(-profile.decelerate_s, profile.peak), profile.end_s()));
            }
            prop_assert!(exit.is_none_or(|(speed, _)| speed.abs() < 1e-6));
        }
    }
}
