//! Klipper's look-ahead: a move may speed up only as far as a gentler machine could brake again.
//!
//! Beside the speeds that the acceleration allows, the firmware keeps those of a machine with a part of it only
//! (`1 - minimum_cruise_ratio`). Where the gentler machine stops to speed up, the real one may reach the mean of the two
//! squares there and no more until the run slows down again: zigzags of short moves are driven evenly instead of in jolts
//! (Klipper, *Kinematics*, "Smoothed look-ahead"). It looks ahead as far as it takes to stop.

use super::Block;
use super::corner::Rule;

/// `minimum_cruise_ratio` where no configuration says otherwise.
const CRUISE_RATIO: f64 = 0.5;

/// Squares of speeds of a move, (mm/s)².
#[derive(Debug, Clone, Copy)]
struct Speeds {
    start2: f64,
    cruise2: f64,
    end2: f64,
}

/// The highest squares of speed at which each move may begin: for the machine, and for the gentler one.
struct Starts {
    real2: Vec<f64>,
    gentle2: Vec<f64>,
}

/// Duration of each block of a run that begins and ends at rest, s; `acceleration` is the machine's own, mm/s².
pub(super) fn durations(blocks: &[Block], rule: Rule, acceleration: f64) -> Vec<f64> {
    let speeds = planned(blocks, &starts(blocks, rule, acceleration), acceleration);
    blocks.iter().zip(speeds).map(|(block, speeds)| seconds(block, speeds)).collect()
}

/// By how much the square of the speed can change along a block, for the machine and the gentler one. Moves that the
/// machine cannot accelerate so fast are not made gentler still.
fn changes2(block: &Block, acceleration: f64) -> [f64; 2] {
    let gentle = acceleration * (1.0 - CRUISE_RATIO);
    [block.acceleration, gentle.min(block.acceleration)].map(|a| 2.0 * a * block.length)
}

fn starts(blocks: &[Block], rule: Rule, acceleration: f64) -> Starts {
    let mut starts = Starts { real2: Vec::new(), gentle2: Vec::new() };
    let mut reach = [0.0, 0.0];
    for (i, block) in blocks.iter().enumerate() {
        let corner2 = if i == 0 { 0.0 } else { rule.speed2(&blocks[i - 1], block) };
        let real2 = corner2.min(reach[0]);
        let gentle2 = real2.min(reach[1]);
        let [real, gentle] = changes2(block, acceleration);
        reach = [real2 + real, gentle2 + gentle];
        starts.real2.push(real2);
        starts.gentle2.push(gentle2);
    }
    starts
}

/// The speeds of each block, from the last to the first: how fast a block may be depends on what comes after it.
fn planned(blocks: &[Block], starts: &Starts, acceleration: f64) -> Vec<Speeds> {
    let mut speeds = vec![Speeds { start2: 0.0, cruise2: 0.0, end2: 0.0 }; blocks.len()];
    let (mut end2, mut gentle_end2, mut peak2) = (0.0_f64, 0.0_f64, 0.0_f64);
    // The blocks from here on up to this one brake for both machines: they take the peak of the block before them.
    let mut braking = blocks.len();
    for (i, block) in blocks.iter().enumerate().rev() {
        let [change2, gentle_change2] = changes2(block, acceleration);
        let start2 = starts.real2[i].min(end2 + change2);
        let gentle_reach2 = gentle_end2 + gentle_change2;
        let gentle2 = starts.gentle2[i].min(gentle_reach2);
        speeds[i] = Speeds { start2, cruise2: 0.5 * (start2 + end2 + change2), end2 };
        if gentle2 < gentle_reach2 {
            let waits = braking > i + 1;
            if waits || gentle2 + gentle_change2 > gentle_end2 {
                peak2 = (0.5 * (gentle2 + gentle_reach2)).min(block.speed * block.speed);
                brake(&mut speeds[i + 1..braking.max(i + 1)], peak2);
            }
            speeds[i] = cruising(speeds[i], peak2.min(block.speed * block.speed));
            braking = i;
        }
        (end2, gentle_end2) = (start2, gentle2);
    }
    speeds
}

/// No faster than the peak.
fn cruising(Speeds { start2, cruise2, end2 }: Speeds, most2: f64) -> Speeds {
    let cruise2 = cruise2.min(most2);
    Speeds { start2: start2.min(cruise2), cruise2, end2: end2.min(cruise2) }
}

/// Blocks that only brake: none is faster than it begins, nor than the peak before them.
fn brake(blocks: &mut [Speeds], peak2: f64) {
    let mut most2 = peak2;
    for block in blocks {
        most2 = most2.min(block.start2);
        *block = Speeds { start2: most2, cruise2: most2, end2: block.end2.min(most2) };
    }
}

fn seconds(block: &Block, Speeds { start2, cruise2, end2 }: Speeds) -> f64 {
    let [start, cruise, end] = [start2, cruise2, end2].map(f64::sqrt);
    let ramps = (2.0 * cruise2 - start2 - end2) / (2.0 * block.acceleration);
    (2.0 * cruise - start - end) / block.acceleration + (block.length - ramps).max(0.0) / cruise.max(1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ACCELERATION: f64 = 3000.0;

    fn block(length: f64, direction: [f64; 4]) -> Block {
        Block { length, direction, speed: 100.0, acceleration: ACCELERATION, layer: None, line: 1 }
    }

    fn total_s(blocks: &[Block]) -> f64 {
        durations(blocks, Rule::SquareCorner { mm_s: 5.0, acceleration: ACCELERATION }, ACCELERATION)
            .iter()
            .sum()
    }

    const EAST: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

    #[test]
    fn a_long_move_is_a_trapezoid() {
        let expected = 2.0 * 100.0 / ACCELERATION + (50.0 - 1e4 / ACCELERATION) / 100.0;
        assert!((total_s(&[block(50.0, EAST)]) - expected).abs() < 1e-12);
    }

    #[test]
    fn half_of_a_short_move_is_driven_evenly() {
        // Half the acceleration reaches the middle at v² = a l / 2, which a quarter of the way speeds up to.
        let peak = (0.5 * ACCELERATION * 1.0_f64).sqrt();
        let expected = 2.0 * peak / ACCELERATION + 0.5 / peak;
        assert!((total_s(&[block(1.0, EAST)]) - expected).abs() < 1e-12);
    }

    #[test]
    fn a_straight_line_in_pieces_takes_as_long_as_in_one() {
        for length in [0.5, 2.0, 40.0] {
            let pieces: Vec<Block> = (0..50).map(|_| block(length / 50.0, EAST)).collect();
            let (pieces, whole) = (total_s(&pieces), total_s(&[block(length, EAST)]));
            assert!((pieces / whole - 1.0).abs() < 0.02, "{length}: {pieces} {whole}");
        }
    }

    #[test]
    fn blocks_fill_their_length_and_join_at_one_speed() {
        let turn = |i: usize| [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.6, 0.8]][i % 4];
        let blocks: Vec<Block> = (0..200)
            .map(|i| {
                let [x, y] = turn(i * i % 7);
                block(0.05 + (i * 37 % 101) as f64 / 50.0, [x, y, 0.0, 0.0])
            })
            .collect();
        let rule = Rule::SquareCorner { mm_s: 5.0, acceleration: ACCELERATION };
        let starts = starts(&blocks, rule, ACCELERATION);
        let speeds = planned(&blocks, &starts, ACCELERATION);
        for (i, (s, b)) in speeds.iter().zip(&blocks).enumerate() {
            let ramps = (2.0 * s.cruise2 - s.start2 - s.end2) / (2.0 * b.acceleration);
            assert!(ramps <= b.length + 1e-9 && s.cruise2 <= b.speed * b.speed + 1e-9, "{i}: {s:?}");
            assert!(s.start2 <= s.cruise2 && s.end2 <= s.cruise2 && s.start2 <= starts.real2[i] + 1e-9);
            let next = speeds.get(i + 1).map_or(0.0, |n| n.start2);
            assert!((s.end2 - next).abs() < 1e-9, "{i}: {s:?} then {next}");
        }
    }
}
