//! How fast a corner may be taken, by the rules of the firmwares.
//!
//! - Junction deviation: the speed at which a circle that leaves the corner by the deviation could be driven at the
//!   acceleration limit, v² = a d s / (1 - s), s the sine of half the angle between the two moves (S. K. Jeon, Improving
//!   Grbl: Cornering Algorithm, 2011). Filament counts as a fourth axis. Marlin takes a short move that turns by less than an
//!   eighth of a circle for a piece of an arc, whose radius is its length over the turn, and lets no axis feel more than its own limit.
//!   Smoothieware knows no filament here, stops for sharp corners and goes through blunt ones.
//! - Jerk: no axis changes its speed by more than so much at once. Marlin 1 begins and ends runs with such a jump,
//!   counts the larger of two speeds where an axis turns back, and takes the way on at its full speed; RepRapFirmware stops
//!   wherever printing begins or ends; Repetier measures x and y together, at full speeds, and begins at half.
//! - Square corner (Klipper): a junction deviation for which a right angle is taken at the given speed; in space alone, and
//!   bounded by a circle that touches both moves within half their lengths. The extruder's speed has a limit of its own.

use super::Block;
use crate::profile::{Cornering, Dialect, Profile};
use std::f64::consts::SQRT_2;

/// By how much Klipper lets the extruder's speed change at once, mm/s (`instantaneous_corner_velocity`).
const EXTRUDER_STEP_MM_S: f64 = 1.0;
/// Smoothieware's cosine of the turns that it takes for straight, or for a way back.
const BLUNT_COSINE: f64 = 0.95;
/// Sines of half the angle above this are a straight line.
const STRAIGHT: f64 = 0.999_999_7;

/// A firmware's rule with the machine's numbers.
#[derive(Debug, Clone, Copy)]
pub(super) enum Rule {
    /// `marlin` has the axes' accelerations where the firmware is Marlin, mm/s².
    Deviation {
        mm: f64,
        marlin: Option<[f64; 4]>,
    },
    /// Smoothieware's junction deviation.
    Blunt {
        mm: f64,
    },
    Jerk {
        mm_s: [f64; 4],
        dialect: Dialect,
    },
    /// `acceleration` is the machine's, mm/s²: the speed is one at that.
    SquareCorner {
        mm_s: f64,
        acceleration: f64,
    },
}

impl Rule {
    pub(super) fn of(profile: &Profile) -> Self {
        let machine = &profile.machine;
        match machine.cornering {
            Cornering::JunctionDeviation if profile.firmware.dialect == Dialect::Smoothie => {
                Self::Blunt { mm: machine.junction_deviation_mm }
            }
            Cornering::JunctionDeviation => {
                let is_marlin = profile.firmware.dialect == Dialect::Marlin;
                let marlin = is_marlin.then_some(machine.max_acceleration_mm_s2);
                Self::Deviation { mm: machine.junction_deviation_mm, marlin }
            }
            Cornering::Jerk => Self::Jerk { mm_s: machine.jerk_mm_s, dialect: profile.firmware.dialect },
            Cornering::SquareCorner => Self::SquareCorner {
                mm_s: machine.square_corner_mm_s,
                acceleration: machine.print_acceleration_mm_s2,
            },
        }
    }

    /// Square of the speed at which a block may begin or end where nothing is before or after it.
    pub(super) fn rest2(self, block: &Block) -> f64 {
        let Self::Jerk { mm_s, dialect } = self else { return 0.0 };
        let share = match dialect {
            Dialect::RepRapFirmware => return 0.0,
            Dialect::Repetier => 0.5,
            _ => 1.0,
        };
        let jump = share * jump_speed([0.0; 4], block.direction, mm_s, dialect);
        jump.min(block.speed).powi(2)
    }

    /// Square of the speed at which one block may follow another.
    pub(super) fn speed2(self, a: &Block, b: &Block) -> f64 {
        let slower = a.speed.min(b.speed);
        let limit2 = match self {
            Self::Deviation { mm, marlin: None } => deviation_speed2(a, b, mm, b.acceleration),
            Self::Deviation { mm, marlin: Some(most) } => marlin_speed2(a, b, mm, most),
            Self::Blunt { mm } => blunt_speed2(a, b, mm),
            Self::Jerk { mm_s, dialect: Dialect::Marlin1 } => self.joined_speed2(a, b, mm_s),
            Self::Jerk { dialect: Dialect::RepRapFirmware, .. } if kind(a) != kind(b) => 0.0,
            Self::Jerk { mm_s, dialect: Dialect::Repetier } => self.repetier_speed2(a, b, mm_s),
            Self::Jerk { mm_s, dialect } => jump_speed(a.direction, b.direction, mm_s, dialect).powi(2),
            Self::SquareCorner { mm_s, acceleration } => square_corner_speed2(a, b, mm_s, acceleration),
        };
        limit2.min(slower * slower)
    }
}

impl Rule {
    /// Marlin 1: the way on is taken at its full speed, the way here at the slower of both; each axis that jumps too far slows
    /// down all that come after it. Where both could begin from rest as fast, the second does.
    fn joined_speed2(self, a: &Block, b: &Block, mm_s: [f64; 4]) -> f64 {
        let slower = a.speed.min(b.speed);
        let mut factor = 1.0;
        for (i, most) in mm_s.into_iter().enumerate() {
            let (exit, entry) = (factor * a.direction[i] * slower, factor * b.direction[i] * b.speed);
            let turns_back = exit * entry < 0.0;
            let jump = if turns_back { exit.abs().max(entry.abs()) } else { (entry - exit).abs() };
            if jump > most {
                factor *= most / jump;
            }
        }
        let joined2 = (slower * factor).powi(2);
        let (rest_a2, rest_b2) = (self.rest2(a), self.rest2(b));
        // 0.99 of the speed.
        let enough = |rest2: f64| rest2 > 0.99 * 0.99 * joined2;
        if enough(rest_a2) && enough(rest_b2) { rest_b2 } else { joined2 }
    }

    /// Repetier: moves in the plane meet at a share of the slower speed; others at what both may begin with.
    fn repetier_speed2(self, a: &Block, b: &Block, mm_s: [f64; 4]) -> f64 {
        let leads = |m: &Block| m.direction[0].hypot(m.direction[1]) >= m.direction[2].abs().max(1e-12);
        if !leads(a) || !leads(b) {
            return self.rest2(a).min(self.rest2(b));
        }
        let change = |i: usize| b.direction[i] * b.speed - a.direction[i] * a.speed;
        let [most, _, most_z, most_e] = mm_s;
        let slower = a.speed.min(b.speed);
        let share = |most: f64, jump: f64| if jump > most { most / jump } else { 1.0 };
        let jump = change(0).hypot(change(1));
        let in_plane = if jump > most { share(most, jump).max(0.5 * most / slower) } else { 1.0 };
        let others = share(most_z, change(2).abs()).min(share(most_e, change(3).abs()));
        (slower * in_plane.min(others)).powi(2)
    }
}

/// Whether a move prints, and whether it moves filament without printing: RepRapFirmware tells these apart.
fn kind(block: &Block) -> [bool; 3] {
    let [x, y, _, e] = block.direction;
    let in_plane = x != 0.0 || y != 0.0;
    let prints = in_plane && e > 0.0;
    [prints, in_plane, e != 0.0 && !prints]
}

/// Smoothieware: a stop where the turn is sharper than 162 degrees, no limit where it is less than 18.
fn blunt_speed2(a: &Block, b: &Block, mm: f64) -> f64 {
    let moves = |block: &Block| block.direction[..3] != [0.0; 3];
    let along = along::<3>(a, b);
    if !moves(a) || !moves(b) || along <= -BLUNT_COSINE {
        0.0
    } else if along >= BLUNT_COSINE {
        f64::INFINITY
    } else {
        let sine = (0.5 * (1.0 + along)).sqrt();
        b.acceleration * mm * sine / (1.0 - sine)
    }
}

/// The cosine of the turn from one direction to the other.
fn along<const N: usize>(a: &Block, b: &Block) -> f64 {
    let dot = |u: &[f64; 4], v: &[f64; 4]| -> f64 { (0..N).map(|i| u[i] * v[i]).sum() };
    let (u, v) = (&a.direction, &b.direction);
    let norm = (dot(u, u) * dot(v, v)).sqrt();
    if norm > 0.0 { dot(u, v) / norm } else { 0.0 }
}

/// Marlin's turns of less than this, rad, are arcs, where the move is shorter than so much.
const ARC_TURN: f64 = std::f64::consts::FRAC_PI_4;
const ARC_LENGTH_MM: f64 = 1.0;

fn marlin_speed2(a: &Block, b: &Block, mm: f64, most: [f64; 4]) -> f64 {
    let change = [0, 1, 2, 3].map(|i| b.direction[i] - a.direction[i]);
    let norm = change.iter().map(|c| c * c).sum::<f64>().sqrt();
    let felt = |(c, most): (&f64, f64)| if c.abs() > 1e-12 { most * norm / c.abs() } else { f64::INFINITY };
    let acceleration = change.iter().zip(most).map(felt).fold(b.acceleration, f64::min);
    let limit2 = deviation_speed2(a, b, mm, acceleration);
    let turn = along::<4>(a, b).clamp(-1.0, 1.0).acos();
    if b.length < ARC_LENGTH_MM && turn > 0.0 && turn < ARC_TURN {
        limit2.min(acceleration * b.length / turn)
    } else {
        limit2
    }
}

fn deviation_speed2(a: &Block, b: &Block, mm: f64, acceleration: f64) -> f64 {
    let along = along::<4>(a, b);
    if along < -0.999_999 {
        return 0.0;
    }
    let sine = (0.5 * (1.0 + along)).max(0.0).sqrt();
    if sine > STRAIGHT { f64::INFINITY } else { acceleration * mm * sine / (1.0 - sine) }
}

/// The speed along both directions at which no axis changes its own by more than it may.
fn jump_speed(a: [f64; 4], b: [f64; 4], mm_s: [f64; 4], dialect: Dialect) -> f64 {
    let step = |i: usize| {
        let turns_back = a[i] * b[i] < 0.0;
        let eased = turns_back && dialect == Dialect::Marlin;
        if eased { a[i].abs().max(b[i].abs()) } else { (b[i] - a[i]).abs() }
    };
    let mut steps = [0, 1, 2, 3].map(step);
    if dialect == Dialect::Repetier {
        (steps[0], steps[1]) = (steps[0].hypot(steps[1]), 0.0);
    }
    let limit = |i: usize| if steps[i] > 1e-12 { mm_s[i] / steps[i] } else { f64::INFINITY };
    (0..4).map(limit).fold(f64::INFINITY, f64::min)
}

fn square_corner_speed2(a: &Block, b: &Block, mm_s: f64, acceleration: f64) -> f64 {
    let moves = |block: &Block| block.direction[..3] != [0.0; 3];
    let along = along::<3>(a, b);
    if !moves(a) || !moves(b) || along < -0.999_999 {
        return 0.0;
    }
    let sine = (0.5 * (1.0 + along.min(0.999_999))).sqrt();
    let tangent = sine / (0.5 * (1.0 - along.min(0.999_999))).sqrt();
    let deviation_mm = mm_s * mm_s * (SQRT_2 - 1.0) / acceleration;
    let round = sine / (1.0 - sine) * deviation_mm * a.acceleration.min(b.acceleration);
    let halves = |block: &Block| 0.5 * block.length * tangent * block.acceleration;
    let step = (b.direction[3] - a.direction[3]).abs().max(1e-12);
    round.min(halves(a)).min(halves(b)).min((EXTRUDER_STEP_MM_S / step).powi(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(direction: [f64; 4]) -> Block {
        Block { length: 10.0, direction, speed: 100.0, acceleration: 1000.0, layer: None, line: 1 }
    }

    const EAST: [f64; 4] = [1.0, 0.0, 0.0, 0.0];
    const NORTH: [f64; 4] = [0.0, 1.0, 0.0, 0.0];
    const WEST: [f64; 4] = [-1.0, 0.0, 0.0, 0.0];

    fn speed(rule: Rule, a: [f64; 4], b: [f64; 4]) -> f64 {
        rule.speed2(&block(a), &block(b)).sqrt()
    }

    #[test]
    fn right_angle_is_taken_at_each_rule_s_speed() {
        let jerk = |dialect| Rule::Jerk { mm_s: [8.0, 8.0, 0.3, 5.0], dialect };
        assert!((speed(jerk(Dialect::Marlin1), EAST, NORTH) - 8.0).abs() < 1e-9);
        assert!((speed(jerk(Dialect::RepRapFirmware), EAST, NORTH) - 8.0).abs() < 1e-9);
        assert!((speed(jerk(Dialect::Repetier), EAST, NORTH) - 8.0 / SQRT_2).abs() < 1e-9);
        assert!(
            (speed(Rule::SquareCorner { mm_s: 5.0, acceleration: 1000.0 }, EAST, NORTH) - 5.0).abs() < 1e-9
        );
    }

    #[test]
    fn turning_back_stops_or_jumps() {
        let jerk = |dialect| Rule::Jerk { mm_s: [8.0, 8.0, 0.3, 5.0], dialect };
        assert!((speed(jerk(Dialect::Marlin1), EAST, WEST) - 8.0).abs() < 1e-9);
        assert!((speed(jerk(Dialect::RepRapFirmware), EAST, WEST) - 4.0).abs() < 1e-9);
        assert!(speed(Rule::SquareCorner { mm_s: 5.0, acceleration: 1000.0 }, EAST, WEST) < 1e-9);
        assert!(speed(Rule::Deviation { mm: 0.013, marlin: None }, EAST, WEST) < 1e-9);
    }

    #[test]
    fn marlin_drives_short_moves_as_pieces_of_an_arc() {
        let rule = Rule::Deviation { mm: 0.013, marlin: Some([3000.0, 3000.0, 100.0, 5000.0]) };
        // A circle of radius 2 mm in pieces of 0.1 mm: the speed at which it is felt as the acceleration.
        let turn = 0.05_f64;
        let piece = |at: f64| Block { length: 0.1, ..block([at.cos(), at.sin(), 0.0, 0.0]) };
        assert!((rule.speed2(&piece(0.0), &piece(turn)).sqrt() - (1000.0 * 2.0_f64).sqrt()).abs() < 1e-6);
        // Longer ones by the deviation alone.
        let long = |at: f64| Block { length: 2.0, ..piece(at) };
        let sine = (0.5 * (1.0 + turn.cos())).sqrt();
        let expected = (1000.0 * 0.013 * sine / (1.0 - sine)).sqrt().min(100.0);
        assert!((rule.speed2(&long(0.0), &long(turn)).sqrt() - expected).abs() < 1e-6);
        // Up from a level move: the z axis feels the corner.
        let up = rule.speed2(&block(EAST), &block([0.0, 0.0, 1.0, 0.0]));
        let half = 0.5_f64.sqrt();
        assert!((up - 100.0 / half * 0.013 * half / (1.0 - half)).abs() < 1e-9);
    }

    #[test]
    fn straight_on_is_taken_at_full_speed_by_all() {
        for rule in [
            Rule::Deviation { mm: 0.013, marlin: None },
            Rule::Jerk { mm_s: [8.0; 4], dialect: Dialect::Repetier },
            Rule::SquareCorner { mm_s: 5.0, acceleration: 1000.0 },
        ] {
            assert!((speed(rule, EAST, EAST) - 100.0).abs() < 1e-9, "{rule:?}");
        }
    }
}
