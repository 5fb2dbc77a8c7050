//! How fast the machine may go round a corner: each firmware's own rule.
//!
//! | rule | firmware | source |
//! |---|---|---|
//! | junction deviation, E in the direction, small segments as arcs | Marlin 2.1 | `planner.cpp`, `JD_HANDLE_SMALL_SEGMENTS` |
//! | jerk per axis, eased where an axis turns back | Marlin 1.1, Prusa | `planner.cpp`, "classic jerk" |
//! | instant change of speed per axis, stops between kinds of moves | RepRapFirmware 3 | `DDA.cpp` |
//! | jerk of the plane, of Z and of E | Repetier 1 | `motion.cpp`, `computeMaxJunctionSpeed`, `safeSpeed` |
//! | junction deviation of X, Y, Z, blunt at both ends | Smoothieware | `Planner.cpp` |
//! | junction deviation that follows from the speed of a right angle | Klipper | `toolhead.py`, `extruder.py` |
//!
//! Junction deviation: Jeon, "Improving Grbl: cornering algorithm" (2011). Legend as in the planner.

use super::{Block, Limits};

/// A rule with its figures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cornering {
    /// So fast that a circle which leaves the corner by this, mm, could be driven at the moves' acceleration (Marlin 2).
    Deviation(f64),
    /// The same along X, Y, Z alone; nearly straight and nearly back are straight and back (Smoothieware).
    SmoothieDeviation(f64),
    /// So fast that no axis changes its speed by more than this at once, X, Y, Z, E, mm/s; an axis that turns back counts the
    /// larger of its two speeds. Runs begin and end with a jump (Marlin 1).
    ClassicJerk {
        /// X, Y, Z, E.
        axes: [f64; 4],
        /// The first axis that limits a start does so with its own jerk, and a move joins only if two were there before.
        from_prusa: bool,
    },
    /// So fast that no axis changes its speed by more than this at once, X, Y, Z, E, mm/s; moves of different kinds do not
    /// join (RepRapFirmware).
    InstantChange([f64; 4]),
    /// X and Y are measured together; the corner's speed is the slower move's, less by as much as the jump of both moves at
    /// full speed is above this, X, Y, Z, E, mm/s. Runs begin and end with a jump of half of it (Repetier).
    PlanarJerk([f64; 4]),
    /// A right angle at this speed, mm/s; others by the junction deviation that follows from it, along X, Y, Z alone, and
    /// no faster than round a circle that touches both moves within their nearer halves (Klipper).
    SquareCorner {
        /// A right angle's.
        speed: f64,
        /// Least share of a move that is cruised rather than accelerated and braked (`minimum_cruise_ratio`).
        cruise_ratio: f64,
    },
}

/// Change of the extruder's speed that Klipper allows at once, mm/s.
const KLIPPER_EXTRUDER_STEP: f64 = 1.0;
/// Marlin takes shorter moves than this, at angles above 135 degrees, for pieces of an arc, mm.
const SMALL_SEGMENT: f64 = 1.0;
/// Smoothieware's cosine of nearly straight, and of nearly back.
const SMOOTHIE_BLUNT: f64 = 0.95;

/// How two moves meet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Junction {
    /// At one speed; its square at most.
    Shared(f64),
    /// Not: each ends or begins as at rest.
    Apart,
}

/// How `next` may follow `last`, with `n_before` moves planned before it.
pub(super) fn junction(last: &Block, next: &Block, limits: &Limits, n_before: usize) -> Junction {
    let nominal2 = next.nominal.min(last.nominal).powi(2);
    let speed2 = match limits.cornering {
        Cornering::Deviation(deviation) => deviation_speed2(last, next, deviation, limits),
        Cornering::SmoothieDeviation(deviation) => smoothie_speed2(last, next, deviation),
        Cornering::ClassicJerk { from_prusa: true, .. } if n_before < 2 => next.rest2,
        Cornering::ClassicJerk { axes, .. } => classic_speed(last, next, axes).powi(2),
        Cornering::InstantChange(_) if kind(last) != kind(next) => 0.0,
        Cornering::InstantChange(axes) => instant_speed(last, next, axes).powi(2),
        Cornering::PlanarJerk(_) if !joins_in_repetier(last, next) => return Junction::Apart,
        Cornering::PlanarJerk(axes) => repetier_speed(last, next, axes).powi(2),
        Cornering::SquareCorner { speed, .. } => square_corner_speed2(last, next, speed, limits),
    };
    Junction::Shared(speed2.min(nominal2))
}

/// The speed with which a move along `direction` may begin from rest or end at it.
pub(super) fn rest_speed(direction: [f64; 4], nominal: f64, cornering: &Cornering) -> f64 {
    match *cornering {
        Cornering::ClassicJerk { axes, from_prusa } => classic_rest(direction, nominal, axes, from_prusa),
        Cornering::PlanarJerk(axes) => repetier_rest(direction, nominal, axes),
        _ => 0.0,
    }
}

fn unit<const N: usize>(direction: &[f64]) -> [f64; N] {
    let norm = direction[..N].iter().map(|d| d * d).sum::<f64>().sqrt();
    std::array::from_fn(|axis| if norm > 0.0 { direction[axis] / norm } else { 0.0 })
}

/// The cosine between the way back and the way on: -1 straight on, 1 back.
fn cosine<const N: usize>(last: &Block, next: &Block) -> f64 {
    let (from, to) = (unit::<N>(&last.direction), unit::<N>(&next.direction));
    -from.iter().zip(&to).map(|(a, b)| a * b).sum::<f64>()
}

fn moves_in_space(block: &Block) -> bool {
    block.direction[..3].iter().any(|d| *d != 0.0)
}

/// Marlin 2.1.
fn deviation_speed2(last: &Block, next: &Block, deviation: f64, limits: &Limits) -> f64 {
    let cosine = cosine::<4>(last, next);
    if cosine > 0.999_999 {
        return 0.0;
    }
    let acceleration = junction_acceleration(last, next, limits);
    let cosine = cosine.max(-0.999_999);
    let sine = (0.5 * (1.0 - cosine)).sqrt();
    let circle2 = acceleration * deviation * sine / (1.0 - sine);
    if next.length < SMALL_SEGMENT && cosine < -std::f64::consts::FRAC_1_SQRT_2 {
        let turn = (-cosine).acos();
        circle2.min(next.length * acceleration / turn)
    } else {
        circle2
    }
}

/// The new move's acceleration, no more than each axis takes along the difference of the directions.
fn junction_acceleration(last: &Block, next: &Block, limits: &Limits) -> f64 {
    let (from, to) = (unit::<4>(&last.direction), unit::<4>(&next.direction));
    let difference: [f64; 4] = std::array::from_fn(|axis| to[axis] - from[axis]);
    let along = unit::<4>(&difference);
    let shares = along.iter().zip(limits.max_acceleration).filter(|(share, _)| share.abs() > 0.0);
    shares.fold(next.acceleration, |least, (share, strongest)| least.min(strongest / share.abs()))
}

/// Smoothieware.
fn smoothie_speed2(last: &Block, next: &Block, deviation: f64) -> f64 {
    if !moves_in_space(last) || !moves_in_space(next) {
        return 0.0;
    }
    let cosine = cosine::<3>(last, next);
    if cosine >= SMOOTHIE_BLUNT {
        0.0
    } else if cosine > -SMOOTHIE_BLUNT {
        let sine = (0.5 * (1.0 - cosine)).sqrt();
        next.acceleration * deviation * sine / (1.0 - sine)
    } else {
        f64::INFINITY
    }
}

/// Marlin 1 and Prusa: from rest.
fn classic_rest(direction: [f64; 4], nominal: f64, axes: [f64; 4], from_prusa: bool) -> f64 {
    let mut safe = nominal;
    let mut limited = false;
    for (share, jerk) in direction.iter().zip(axes) {
        let speed = share.abs() * nominal;
        if speed <= jerk {
            continue;
        }
        safe = match (limited, from_prusa) {
            (false, true) => jerk,
            _ => safe.min(jerk / share.abs()),
        };
        limited = true;
    }
    safe
}

/// Marlin 1 and Prusa: the common speed of two moves. A move that is faster than the one before counts with its full speed.
fn classic_speed(last: &Block, next: &Block, axes: [f64; 4]) -> f64 {
    let slower = last.nominal.min(next.nominal);
    let mut factor = 1.0;
    for (axis, allowed) in axes.into_iter().enumerate() {
        let exit = last.direction[axis] * slower * factor;
        let entry = next.direction[axis] * next.nominal * factor;
        let jump = if exit * entry < 0.0 { exit.abs().max(entry.abs()) } else { (entry - exit).abs() };
        if jump > allowed {
            factor *= allowed / jump;
        }
    }
    let shared = slower * factor;
    // Separate jumps from and to rest may be faster.
    let safe = next.rest2.sqrt();
    let threshold = 0.99 * shared;
    if last.rest2.sqrt() > threshold && safe > threshold { safe } else { shared }
}

/// What RepRapFirmware's moves must have in common to join: printing, in the plane, extruding without printing.
fn kind(block: &Block) -> [bool; 3] {
    let in_plane = block.direction[..2].iter().any(|d| *d != 0.0);
    let prints = in_plane && block.direction[3] > 0.0;
    [prints, in_plane, block.direction[3] != 0.0 && !prints]
}

/// RepRapFirmware.
fn instant_speed(last: &Block, next: &Block, axes: [f64; 4]) -> f64 {
    let changes = last.direction.iter().zip(next.direction).map(|(from, to)| (to - from).abs());
    changes
        .zip(axes)
        .filter(|(change, _)| *change > 1e-12)
        .map(|(c, jerk)| jerk / c)
        .fold(f64::INFINITY, f64::min)
}

/// The axis with the greatest part in a move is Z.
fn is_led_by_z(block: &Block) -> bool {
    let [x, y, z, e] = block.direction.map(f64::abs);
    z > x && z > y && z > e
}

fn joins_in_repetier(last: &Block, next: &Block) -> bool {
    is_led_by_z(last) == is_led_by_z(next) && moves_in_space(last) == moves_in_space(next)
}

/// Repetier: the common speed.
fn repetier_speed(last: &Block, next: &Block, [plane, _, z, e]: [f64; 4]) -> f64 {
    let jump = |axis: usize| next.direction[axis] * next.nominal - last.direction[axis] * last.nominal;
    let slower = last.nominal.min(next.nominal);
    let in_plane = jump(0).hypot(jump(1));
    let mut factor: f64 = if in_plane > plane { (plane / in_plane).max(plane / (2.0 * slower)) } else { 1.0 };
    for (axis, allowed) in [(2, z), (3, e)] {
        if jump(axis).abs() > allowed {
            factor = factor.min(allowed / jump(axis).abs());
        }
    }
    slower * factor
}

/// Repetier: from rest, half of what corners may jump.
fn repetier_rest(direction: [f64; 4], nominal: f64, [plane, _, z, e]: [f64; 4]) -> f64 {
    let in_space = direction[..3].iter().any(|d| *d != 0.0);
    let of = |axis: usize, jerk: f64| {
        if direction[axis] != 0.0 { jerk / 2.0 / direction[axis].abs() } else { f64::INFINITY }
    };
    let [dx, dy, dz, de] = direction.map(f64::abs);
    let safe = match (in_space, dz > dx && dz > dy && dz > de) {
        (false, _) => e / 2.0,
        (true, true) => of(2, z).min(of(3, e)),
        (true, false) => (plane / 2.0).min(of(2, z)).min(of(3, e)),
    };
    safe.min(nominal)
}

/// Klipper.
fn square_corner_speed2(last: &Block, next: &Block, square_corner: f64, limits: &Limits) -> f64 {
    if !moves_in_space(last) || !moves_in_space(next) {
        return 0.0;
    }
    let cosine = cosine::<3>(last, next);
    if cosine > 0.999_999 {
        return 0.0;
    }
    let cosine = cosine.max(-0.999_999);
    let sine = (0.5 * (1.0 - cosine)).sqrt();
    let tangent = sine / (0.5 * (1.0 + cosine)).sqrt();
    // The deviation follows from the toolhead's acceleration, not the move's.
    let deviation = square_corner.powi(2) * (2.0_f64.sqrt() - 1.0) / limits.print_acceleration;
    let bound = |block: &Block| {
        let circle = sine / (1.0 - sine) * deviation * block.acceleration;
        circle.min(0.5 * block.length * tangent * block.acceleration)
    };
    let step = (next.direction[3] - last.direction[3]).abs();
    let extruder = if step > 0.0 { (KLIPPER_EXTRUDER_STEP / step).powi(2) } else { f64::INFINITY };
    bound(last).min(bound(next)).min(extruder)
}
