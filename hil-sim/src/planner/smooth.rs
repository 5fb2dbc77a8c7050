//! Klipper's look-ahead: peaks of speed are held down where the machine would accelerate only to brake again.
//!
//! Besides the plan at full acceleration there is a virtual one at a lower one, `(1 - minimum_cruise_ratio)` of it; where that
//! plan accelerates and brakes, its peak bounds the real cruising speed of all moves up to the next such place (`toolhead.py`,
//! `LookAheadQueue.flush`, up to 2024 `MoveQueue.flush` with `max_accel_to_decel`). Legend as in the planner.

use super::{Block, Cornering, Limits};

/// What the look-ahead keeps of a move; squares of speeds, mm²/s².
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Smooth {
    /// By how much it changes the square of the speed in the virtual plan.
    delta2: f64,
    /// Highest entry in the virtual plan.
    max_entry2: f64,
    /// Highest speed in the real one.
    pub(super) cruise2: f64,
}

impl Smooth {
    pub(super) fn new(length: f64, acceleration: f64, limits: &Limits) -> Self {
        let ratio = match limits.cornering {
            Cornering::SquareCorner { cruise_ratio, .. } => cruise_ratio,
            _ => 0.0,
        };
        let gentle = limits.print_acceleration * (1.0 - ratio);
        Self { delta2: 2.0 * length * gentle.min(acceleration), max_entry2: 0.0, cruise2: f64::INFINITY }
    }
}

fn delta2(block: &Block) -> f64 {
    2.0 * block.acceleration * block.length
}

/// Bounds the entries of a move by what the one before can reach from its own bounds.
pub(super) fn bound(block: &mut Block, before: Option<&Block>) {
    let Some(before) = before else {
        block.smooth.max_entry2 = 0.0;
        return;
    };
    block.max_entry2 = block.max_entry2.min(before.max_entry2 + delta2(before));
    block.smooth.max_entry2 = block.max_entry2.min(before.smooth.max_entry2 + before.smooth.delta2);
}

/// Plans what has not started, from the last move back; the entry of the first is fixed where one is under way, which
/// cruises at `under_way2`.
pub(super) fn plan(blocks: &mut [Block], first: usize, under_way2: f64) {
    let fixed2 = blocks.get(first).filter(|_| first > 0).map(|block| block.entry2);
    let (mut end2, mut smooth_end2, mut peak2) = (0.0, 0.0, 0.0);
    // The last of the moves that only brake in the virtual plan: they cruise no faster than the peak before them, which is
    // not known yet.
    let mut braking_to: Option<usize> = None;
    for index in (first..blocks.len()).rev() {
        let block = &mut blocks[index];
        let fastest2 = block.nominal.powi(2);
        let reach2 = end2 + delta2(block);
        let start2 = block.max_entry2.min(reach2);
        let smooth_reach2 = smooth_end2 + block.smooth.delta2;
        let smooth_start2 = block.smooth.max_entry2.min(smooth_reach2);
        block.entry2 = start2;
        if smooth_start2 < smooth_reach2 {
            if smooth_start2 + block.smooth.delta2 > smooth_end2 || braking_to.is_some() {
                peak2 = fastest2.min(f64::midpoint(smooth_start2, smooth_reach2));
            }
            block.smooth.cruise2 = f64::midpoint(start2, reach2).min(fastest2).min(peak2);
            block.entry2 = start2.min(block.smooth.cruise2);
            if let Some(to) = braking_to.take() {
                hold_down(&mut blocks[index + 1..=to], peak2);
            }
        } else {
            braking_to = braking_to.or(Some(index));
        }
        (end2, smooth_end2) = (start2, smooth_start2);
    }
    if let Some(to) = braking_to {
        hold_down(&mut blocks[first..=to], under_way2);
    }
    if let Some(entry2) = fixed2 {
        blocks[first].entry2 = entry2;
        blocks[first].smooth.cruise2 = blocks[first].smooth.cruise2.max(entry2);
    }
}

/// Moves that brake cruise no faster than the peak before them, nor than they begin.
fn hold_down(blocks: &mut [Block], peak2: f64) {
    for block in blocks {
        block.entry2 = block.entry2.min(peak2);
        block.smooth.cruise2 = block.entry2;
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Limits, Planner, Position};
    use super::*;

    fn limits(cruise_ratio: f64) -> Limits {
        Limits {
            max_speed: [300.0, 300.0, 15.0, 75.0],
            max_acceleration: [1e9, 1e9, 100.0, 1e9],
            travel_max_acceleration: None,
            print_acceleration: 3000.0,
            retract_acceleration: 1500.0,
            travel_acceleration: 3000.0,
            cornering: Cornering::SquareCorner { speed: 5.0, cruise_ratio },
        }
    }

    /// Time of a way through `points`, all known at once.
    fn time_s(points: &[Position], speed: f64, cruise_ratio: f64) -> f64 {
        let mut planner = Planner::new(64);
        for pair in points.windows(2) {
            planner.push(0.0, [pair[0], pair[1]], speed, &limits(cruise_ratio));
        }
        planner.release(0.0);
        while planner.depth() > 0 {
            planner.start();
            planner.finish();
        }
        planner.free_s
    }

    #[test]
    fn short_move_peaks_where_half_the_acceleration_would() {
        // 4 mm: at 3000 mm/s² the peak would be sqrt(12000) = 110 mm/s, at 1500 sqrt(6000) = 77 mm/s.
        let there = [[0.0; 4], [4.0, 0.0, 0.0, 0.0]];
        let full = 2.0 * (4.0_f64 / 3000.0).sqrt();
        assert!((time_s(&there, 300.0, 0.0) - full).abs() < 1e-9);
        let peak = 6000.0_f64.sqrt();
        // Half of the way is cruised: the other half accelerates and brakes.
        let held = peak / 3000.0 + 4.0 / peak;
        assert!((time_s(&there, 300.0, 0.5) - held).abs() < 1e-9, "{}", time_s(&there, 300.0, 0.5));
    }

    #[test]
    fn zigzag_cruises_and_a_long_move_is_as_before() {
        let zigzag: Vec<Position> =
            (0..20).map(|i| [f64::from(i) * 0.5, f64::from(i % 2) * 0.5, 0.0, 0.0]).collect();
        assert!(time_s(&zigzag, 200.0, 0.5) > time_s(&zigzag, 200.0, 0.0));
        let long = [[0.0; 4], [200.0, 0.0, 0.0, 0.0]];
        assert!((time_s(&long, 100.0, 0.5) - time_s(&long, 100.0, 0.0)).abs() < 1e-9);
        assert!((time_s(&long, 100.0, 0.5) - (2.0 + 100.0 / 3000.0)).abs() < 1e-9);
    }
}
