//! Moves to trapezoids: a planner with look-ahead, as in Grbl and Marlin.
//!
//! Every move accelerates, cruises and decelerates along its straight line. At a junction the speed is bounded by the
//! firmware's own rule (`corner`). A backward pass bounds every entry speed so that the machine can stop at the end of what
//! is known, a forward pass bounds it by what can be reached; Klipper besides holds peaks down (`smooth`). A move's profile
//! is fixed when it starts.
//!
//! Legend: lengths mm, speeds mm/s (squares mm²/s²), accelerations mm/s², times s on the simulated clock.
//! Not done: jerk-limited (S-curve) ramps, quantisation to steps.

mod corner;
mod smooth;

pub use corner::Cornering;

use std::collections::VecDeque;

/// X, Y, Z, E.
pub type Position = [f64; 4];

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
    /// Where it does not meet the move before: the square of the speed at which that one ends.
    apart2: Option<f64>,
    /// Klipper's look-ahead.
    smooth: smooth::Smooth,
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
    /// Where the queue is one of time (Klipper): how much of it, at the speeds told.
    queue_s: Option<f64>,
    /// When the last finished move ended.
    free_s: f64,
    /// Before that the first move does not start.
    hold_s: f64,
    last: Option<Block>,
    /// Whether peaks are held down, and the last one driven, mm²/s².
    smoothed: bool,
    peak2: f64,
}

impl Planner {
    /// An empty one with a ring of `blocks`, one of which always stays empty.
    #[must_use]
    pub fn new(blocks: usize) -> Self {
        Self {
            blocks: VecDeque::new(),
            slots: blocks.saturating_sub(1).max(1),
            queue_s: None,
            free_s: 0.0,
            hold_s: 0.0,
            last: None,
            smoothed: false,
            peak2: f64::INFINITY,
        }
    }

    /// The same, but it takes moves as long as those in it would take less than this at the speeds told.
    #[must_use]
    pub fn with_queue_s(self, queue_s: Option<f64>) -> Self {
        Self { queue_s, ..self }
    }

    /// Moves planned.
    #[must_use]
    pub fn depth(&self) -> usize {
        self.blocks.len()
    }

    /// Moves that still find room.
    #[must_use]
    pub fn free(&self) -> usize {
        let told_s = || self.blocks.iter().map(|block| block.length / block.nominal).sum::<f64>();
        match self.queue_s {
            Some(queue_s) if told_s() >= queue_s => 0,
            _ => self.slots.saturating_sub(self.blocks.len()),
        }
    }

    /// Plans a straight move from `from` to `to` at `speed`; false if nothing moves. There must be room.
    pub fn push(&mut self, now_s: f64, ends: [Position; 2], speed: f64, limits: &Limits) -> bool {
        let Some(mut block) = shape(ends, speed, limits) else { return false };
        let before = self.last.filter(|_| !self.blocks.is_empty());
        block.follows = before.is_some();
        let junction = match &before {
            Some(before) => corner::junction(before, &block, limits, self.blocks.len()),
            None => corner::Junction::Shared(block.rest2),
        };
        (block.max_entry2, block.apart2) = match junction {
            corner::Junction::Shared(speed2) => (speed2, None),
            corner::Junction::Apart => (block.rest2, before.map(|before| before.rest2)),
        };
        self.smoothed = matches!(limits.cornering, Cornering::SquareCorner { .. });
        if self.smoothed {
            smooth::bound(&mut block, before.as_ref());
        }
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
        if self.smoothed {
            smooth::plan(self.blocks.make_contiguous(), first, self.peak2);
        } else {
            self.bound_entries(first);
        }
        for index in first..self.blocks.len().saturating_sub(1) {
            let block = &self.blocks[index];
            let reach2 = (2.0 * block.acceleration).mul_add(block.length, block.entry2);
            let next = &mut self.blocks[index + 1];
            if next.apart2.is_none() {
                next.entry2 = next.entry2.min(reach2);
            }
        }
    }

    /// So that the machine can stop at the end of what is known.
    fn bound_entries(&mut self, first: usize) {
        let mut exit2 = self.blocks.back().map_or(0.0, |last| last.rest2);
        for index in (first..self.blocks.len()).rev() {
            let block = &mut self.blocks[index];
            // The entry of a move that follows one under way is that one's exit: it is fixed.
            if index > 0 && index == first {
                break;
            }
            block.entry2 = block.max_entry2.min((2.0 * block.acceleration).mul_add(block.length, exit2));
            exit2 = block.apart2.unwrap_or(block.entry2);
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
        let exit2 = self.blocks.get(1).map(|next| next.apart2.unwrap_or(next.entry2));
        let smoothed = self.smoothed;
        let block = self.blocks.front_mut()?;
        let reach2 = (2.0 * block.acceleration).mul_add(block.length, block.entry2);
        let exit2 = exit2.unwrap_or(block.rest2).min(reach2);
        let nominal = if smoothed { block.nominal.min(block.smooth.cruise2.sqrt()) } else { block.nominal };
        let squares = [block.entry2, exit2];
        block.profile = Some(Profile::new(start_s, block.length, squares, nominal, block.acceleration));
        self.peak2 = block.smooth.cruise2;
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
    let rest2 = corner::rest_speed(direction, nominal, &limits.cornering).powi(2);
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
        apart2: None,
        smooth: smooth::Smooth::new(length, acceleration, limits),
        follows: false,
        profile: None,
    })
}

#[cfg(test)]
mod tests;
