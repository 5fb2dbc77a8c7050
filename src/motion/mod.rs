//! How long a job takes, by the motion model of printer firmware.
//!
//! Every move accelerates, cruises and brakes at constant rates (a trapezoid of speed over time). At a
//! corner the machine may keep the speed at which a circle that leaves the corner by the junction
//! deviation could be driven at the acceleration limit: v² = a d s / (1 - s), s the sine of half the
//! angle between the two moves (S. K. Jeon, Improving Grbl: Cornering Algorithm, 2011). The planner looks
//! ahead over as many moves as its buffer holds and must always be able to stop at the end of the last
//! one.
//!
//! Not counted: homing, heating, the wire, firmware's own overhead. Arcs (G2, G3) are refused.

use crate::gcode::reader::{self, Command};
use crate::profile::Profile;
use crate::progress::{Cancelled, Task};
use crate::units::mm_s_from_mm_min;
use serde::Serialize;
use std::f64::consts::FRAC_PI_4;

/// Time and material of a job.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Estimate {
    /// Duration of all moves and dwells, s.
    pub total_s: f64,
    /// Duration per layer, s, from one `;LAYER:` to the next.
    pub layer_s: Vec<f64>,
    /// Filament used, mm.
    pub filament_mm: f64,
    /// Filament used, g.
    pub filament_g: f64,
    /// Way with extrusion, mm.
    pub printed_mm: f64,
    /// Way without extrusion, mm.
    pub travel_mm: f64,
}

/// What keeps a job from being estimated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A line that is no G-code.
    #[error("line {line}: {source}")]
    Line {
        /// The line, counted from 1.
        line: usize,
        /// What is wrong with it.
        source: reader::Error,
    },
    /// A move that the model does not know.
    #[error("line {line}: {command} is not supported by the estimate; expected straight moves (G0, G1)")]
    Unsupported {
        /// The line, counted from 1.
        line: usize,
        /// The command.
        command: String,
    },
    /// Asked to stop.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Estimates a job's time and material on the profile's machine.
///
/// # Errors
/// A line that cannot be read, arcs, cancellation.
pub fn estimate(gcode: &str, profile: &Profile, task: &Task<'_>) -> Result<Estimate, Error> {
    let mut machine = Machine::new(profile);
    for (idx, text) in gcode.lines().enumerate() {
        if idx % 65536 == 0 {
            task.check()?;
            task.report(idx as u64, 0);
        }
        machine.read(idx + 1, text)?;
    }
    Ok(machine.estimate())
}

/// A move as the planner sees it. mm, mm/s, mm/s².
#[derive(Debug, Clone, Copy)]
struct Block {
    length: f64,
    direction: [f64; 3],
    speed: f64,
    acceleration: f64,
    layer: Option<usize>,
}

/// Reads lines, keeps the state that gives them their meaning, collects blocks.
struct Machine<'a> {
    profile: &'a Profile,
    at: [f64; 4],
    absolute_xyz: bool,
    absolute_e: bool,
    feedrate_mm_s: f64,
    layer: Option<usize>,
    n_layers: usize,
    blocks: Vec<Block>,
    /// Dwells: they also let the planner run dry. Index of the block they follow, seconds, layer.
    dwells: Vec<(usize, f64, Option<usize>)>,
    filament_mm: f64,
    most_filament_mm: f64,
    printed_mm: f64,
    travel_mm: f64,
}

impl<'a> Machine<'a> {
    fn new(profile: &'a Profile) -> Self {
        Self {
            profile,
            at: [0.0; 4],
            absolute_xyz: true,
            absolute_e: true,
            // What Marlin assumes before the first F.
            feedrate_mm_s: 25.0,
            layer: None,
            n_layers: 0,
            blocks: Vec::new(),
            dwells: Vec::new(),
            filament_mm: 0.0,
            most_filament_mm: 0.0,
            printed_mm: 0.0,
            travel_mm: 0.0,
        }
    }

    fn read(&mut self, line: usize, text: &str) -> Result<(), Error> {
        if text.starts_with(";LAYER:") {
            self.layer = Some(self.n_layers);
            self.n_layers += 1;
            return Ok(());
        }
        if text.starts_with(';') {
            return Ok(());
        }
        let parsed = reader::parse(text).map_err(|source| Error::Line { line, source })?;
        parsed.command.map_or(Ok(()), |c| self.command(line, &c))
    }

    fn command(&mut self, line: usize, c: &Command) -> Result<(), Error> {
        match (c.letter, c.code) {
            ('G', 0 | 1) => self.straight(c),
            ('G', 2 | 3 | 5) => return Err(Error::Unsupported { line, command: c.to_string() }),
            ('G', 4) => {
                let seconds = c.value('S').unwrap_or_else(|| c.value('P').unwrap_or(0.0) / 1000.0);
                self.dwells.push((self.blocks.len(), seconds.max(0.0), self.layer));
            }
            ('G', 28) => {
                let all = !['X', 'Y', 'Z'].iter().any(|&a| c.has(a));
                let homed = ['X', 'Y', 'Z'].map(|a| all || c.has(a));
                (0..3).filter(|&i| homed[i]).for_each(|i| self.at[i] = 0.0);
            }
            // As in Marlin, both also set how E is meant.
            ('G', 90 | 91) => (self.absolute_xyz, self.absolute_e) = (c.code == 90, c.code == 90),
            ('G', 92) => {
                for (i, axis) in ['X', 'Y', 'Z', 'E'].into_iter().enumerate() {
                    self.at[i] = c.value(axis).unwrap_or(self.at[i]);
                }
            }
            ('M', 82 | 83) => self.absolute_e = c.code == 82,
            _ => {}
        }
        Ok(())
    }

    fn straight(&mut self, c: &Command) {
        if let Some(feedrate) = c.value('F') {
            self.feedrate_mm_s = mm_s_from_mm_min(feedrate).max(1e-3);
        }
        let mut way = [0.0; 4];
        for (i, axis) in ['X', 'Y', 'Z', 'E'].into_iter().enumerate() {
            let Some(value) = c.value(axis) else { continue };
            let absolute = if i == 3 { self.absolute_e } else { self.absolute_xyz };
            way[i] = if absolute { value - self.at[i] } else { value };
            self.at[i] += way[i];
        }
        self.filament_mm += way[3];
        self.most_filament_mm = self.most_filament_mm.max(self.filament_mm);
        let in_space = way[0].hypot(way[1]).hypot(way[2]);
        let length = if in_space > 1e-9 { in_space } else { way[3].abs() };
        if length <= 1e-9 {
            return;
        }
        *(if way[3] > 0.0 { &mut self.printed_mm } else { &mut self.travel_mm }) += in_space;
        self.blocks.push(self.block(way, length, in_space > 1e-9));
    }

    fn block(&self, way: [f64; 4], length: f64, moves: bool) -> Block {
        let machine = &self.profile.machine;
        let wanted = match (moves, way[3] > 0.0) {
            (false, _) => f64::INFINITY,
            (true, true) => machine.print_acceleration_mm_s2,
            (true, false) => machine.travel_acceleration_mm_s2,
        };
        let mut block = Block {
            length,
            direction: [way[0] / length, way[1] / length, way[2] / length],
            speed: self.feedrate_mm_s,
            acceleration: wanted,
            layer: self.layer,
        };
        for (i, part) in way.iter().map(|w| w.abs() / length).enumerate() {
            if part > 0.0 {
                block.speed = block.speed.min(machine.max_speed_mm_s[i] / part);
                block.acceleration = block.acceleration.min(machine.max_acceleration_mm_s2[i] / part);
            }
        }
        block
    }

    fn estimate(self) -> Estimate {
        let mut layer_s = vec![0.0; self.n_layers];
        let mut total_s = 0.0;
        let mut add = |layer: Option<usize>, seconds: f64| {
            total_s += seconds;
            if let Some(layer) = layer {
                layer_s[layer] += seconds;
            }
        };
        let mut from = 0;
        for &(to, seconds, layer) in self.dwells.iter().chain([&(self.blocks.len(), 0.0, None)]) {
            let run = &self.blocks[from..to];
            let times = durations(run, self.profile);
            run.iter().zip(times).for_each(|(b, t)| add(b.layer, t));
            add(layer, seconds);
            from = to;
        }
        let volume_mm3 = self.most_filament_mm * FRAC_PI_4 * self.profile.machine.filament_mm.powi(2);
        Estimate {
            total_s,
            layer_s,
            filament_mm: self.most_filament_mm,
            filament_g: volume_mm3 * self.profile.filament.density_g_cm3 / 1000.0,
            printed_mm: self.printed_mm,
            travel_mm: self.travel_mm,
        }
    }
}

/// Duration of each block of a run that begins and ends at rest, s.
fn durations(blocks: &[Block], profile: &Profile) -> Vec<f64> {
    let deviation = profile.machine.junction_deviation_mm;
    // Square of the highest speed at which each block may begin.
    let junctions: Vec<f64> = (0..blocks.len())
        .map(|i| if i == 0 { 0.0 } else { junction_speed2(&blocks[i - 1], &blocks[i], deviation) })
        .collect();
    let window = profile.firmware.planner_moves.max(2);
    let mut entry2 = 0.0f64;
    let mut times = Vec::with_capacity(blocks.len());
    for (i, block) in blocks.iter().enumerate() {
        // The planner must be able to stop at the end of the last move that it holds.
        let last = (i + window).min(blocks.len());
        let mut exit2 = 0.0f64;
        for k in (i + 1..last).rev() {
            exit2 = junctions[k].min(exit2 + 2.0 * blocks[k].acceleration * blocks[k].length);
        }
        let reach2 = 2.0 * block.acceleration * block.length;
        entry2 = entry2.min(exit2 + reach2);
        exit2 = exit2.min(entry2 + reach2);
        times.push(trapezoid_s(block, entry2, exit2));
        entry2 = exit2;
    }
    times
}

/// Square of the speed at which the corner between two blocks may be taken.
fn junction_speed2(a: &Block, b: &Block, deviation_mm: f64) -> f64 {
    let slower = a.speed.min(b.speed);
    let along: f64 = a.direction.iter().zip(b.direction).map(|(x, y)| x * y).sum();
    // Moves of filament alone have no direction: the machine stops.
    if a.direction == [0.0; 3] || b.direction == [0.0; 3] || along < -0.999_999 {
        return 0.0;
    }
    let sine = (0.5 * (1.0 + along)).max(0.0).sqrt();
    if sine > 0.999_999 {
        return slower * slower;
    }
    let acceleration = a.acceleration.min(b.acceleration);
    (acceleration * deviation_mm * sine / (1.0 - sine)).min(slower * slower)
}

/// Duration of a block from the squares of its first and last speed, s.
fn trapezoid_s(block: &Block, entry2: f64, exit2: f64) -> f64 {
    let Block { length, speed, acceleration, .. } = *block;
    let (entry, exit) = (entry2.sqrt(), exit2.sqrt());
    let peak2 = (acceleration * length + 0.5 * (entry2 + exit2)).min(speed * speed).max(entry2).max(exit2);
    let peak = peak2.sqrt();
    let ramps = (2.0 * peak2 - entry2 - exit2) / (2.0 * acceleration);
    let cruise = (length - ramps).max(0.0) / peak.max(1e-9);
    (2.0 * peak - entry - exit) / acceleration + cruise
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile;

    fn machine() -> Profile {
        let mut profile = profile::builtin("reference").unwrap();
        profile.machine.print_acceleration_mm_s2 = 1000.0;
        profile.machine.travel_acceleration_mm_s2 = 2000.0;
        profile
    }

    fn total_s(gcode: &str) -> f64 {
        estimate(gcode, &machine(), &Task::quiet()).unwrap().total_s
    }

    #[test]
    fn single_move_is_a_trapezoid() {
        // 50 mm/s at 2000 mm/s²: 0.625 mm to speed up and as much to brake.
        let expected = 2.0 * 0.025 + (100.0 - 1.25) / 50.0;
        assert!((total_s("G0 X100 F3000") - expected).abs() < 1e-9);
    }

    #[test]
    fn short_move_is_a_triangle() {
        let expected = 2.0 * (0.5f64 / 2000.0).sqrt();
        assert!((total_s("G0 X0.5 F6000") - expected).abs() < 1e-9);
    }

    #[test]
    fn straight_line_in_pieces_takes_as_long_as_in_one() {
        let pieces: String = (1..=100).map(|i| format!("G0 X{i} F3000\n")).collect();
        assert!((total_s(&pieces) - total_s("G0 X100 F3000")).abs() < 1e-9);
    }

    #[test]
    fn planner_of_few_moves_cannot_reach_the_speed_on_tiny_ones() {
        // 15 moves of 0.01 mm ahead: it must be able to stop within 0.15 mm.
        let pieces: String = (1..=5000).map(|i| format!("G0 X{} F9000\n", f64::from(i) / 100.0)).collect();
        let top = (2.0 * 2000.0 * 0.155f64).sqrt();
        assert!(total_s(&pieces) > 50.0 / top);
    }

    #[test]
    fn right_angle_is_taken_at_the_junction_speed() {
        let profile = machine();
        let sine = 0.5f64.sqrt();
        let corner2 = 2000.0 * profile.machine.junction_deviation_mm * sine / (1.0 - sine);
        let half = {
            let corner = corner2.sqrt();
            let ramps = (2.0 * 2500.0 - corner2) / 4000.0;
            (100.0 - corner) / 2000.0 + (20.0 - ramps) / 50.0
        };
        assert!((total_s("G0 X20 F3000\nG0 Y20") - 2.0 * half).abs() < 1e-9);
    }

    #[test]
    fn filament_layers_and_dwells_are_counted() {
        let gcode = "M83\nG90\nM83\n;LAYER:0\nG1 X10 E1 F600\nG1 E-1\nG4 P500\n;LAYER:1\nG91\nM83\nG1 E1\nG1 X10 E1\nG0 Z5\n";
        let e = estimate(gcode, &machine(), &Task::quiet()).unwrap();
        assert!((e.filament_mm - 2.0).abs() < 1e-12);
        let grams = 2.0 * FRAC_PI_4 * 1.75 * 1.75 * machine().filament.density_g_cm3 / 1000.0;
        assert!((e.filament_g - grams).abs() < 1e-12);
        assert_eq!(e.layer_s.len(), 2);
        assert!(e.layer_s[0] > 1.5 && (e.layer_s.iter().sum::<f64>() - e.total_s).abs() < 1e-9);
        assert!((e.printed_mm - 20.0).abs() < 1e-12 && (e.travel_mm - 5.0).abs() < 1e-12);
    }

    #[test]
    fn arcs_and_nonsense_are_refused_with_their_line() {
        let of = |text: &str| estimate(text, &machine(), &Task::quiet()).unwrap_err().to_string();
        assert!(of("G28\nG2 X1 I1").starts_with("line 2: G2 X1 I1 is not supported"));
        assert!(of("what").starts_with("line 1: column 1"));
        let token = crate::progress::CancelToken::default();
        token.cancel();
        let stopped = estimate("G28", &machine(), &Task::new(&|_, _| {}, token));
        assert_eq!(stopped, Err(Error::Cancelled(Cancelled)));
    }
}
