//! How long a job takes, by the motion model of printer firmware.
//!
//! Every move accelerates, cruises and brakes at constant rates (a trapezoid of speed over time); how fast a corner may be
//! taken is the firmware's own rule (`corner`). The planner looks ahead over as many moves as its buffer holds and must
//! always be able to stop at the end of the last one. Arcs are the chords in which the firmware drives them. Homing and
//! warming up take the times that the profile states.
//!
//! Not counted: the wire, the firmware's own overhead, limits that the job itself changes.
//!
//! And whether a job keeps within the build space (`space`), which is looked at before it is sent.

mod arc;
mod corner;
mod heat;
mod smooth;
mod space;

use crate::gcode::reader::{self, Command};
use crate::gcode::{Mark, Timing};
use crate::profile::{Dialect, Profile};
use crate::progress::{Cancelled, Task};
use crate::units::mm_s_from_mm_min;
use heat::Heaters;
use rayon::prelude::*;
use serde::Serialize;
pub use space::{Leaving, leaving};
use std::f64::consts::FRAC_PI_4;

/// Time and material of a job.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Estimate {
    /// Duration of all moves and waits, s.
    pub total_s: f64,
    /// Of it homing, warming up and waiting, s.
    pub waiting_s: f64,
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
    /// Lines at which the next percent of the time begins.
    #[serde(skip)]
    pub marks: Vec<Mark>,
}

impl Estimate {
    /// What is written into the job.
    #[must_use]
    pub fn timing(&self) -> Timing<'_> {
        Timing { total_s: self.total_s, marks: &self.marks }
    }
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
    #[error(
        "line {line}: {command} is not supported by the estimate; expected straight moves (G0, G1) or arcs (G2, G3)"
    )]
    Unsupported {
        /// The line, counted from 1.
        line: usize,
        /// The command.
        command: String,
    },
    /// An arc without a centre.
    #[error(
        "line {line}: {command} has no centre; expected I, J or both, or a radius R that reaches the end"
    )]
    Arc {
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
/// A line that cannot be read, arcs without a centre, splines, cancellation.
pub fn estimate(gcode: &str, profile: &Profile, task: &Task<'_>) -> Result<Estimate, Error> {
    let mut machine = Machine::new(profile);
    let mut lines = gcode.lines();
    let mut read: Vec<Read> = Vec::new();
    loop {
        task.check()?;
        task.report(machine.line as u64, 0);
        let next: Vec<&str> = lines.by_ref().take(LINES_AT_ONCE).collect();
        // The machine takes what was read while the next lines are.
        let follow = || next.par_iter().map(|text| said(text)).collect::<Vec<Read>>();
        let (driven, following) = rayon::join(|| machine.take(read), follow);
        driven?;
        read = following;
        if read.is_empty() {
            return Ok(machine.estimate());
        }
    }
}

/// Lines that are read while the machine takes those before them: enough for any number of threads, few in memory.
const LINES_AT_ONCE: usize = 1 << 14;

/// What a line says to the machine.
enum Said {
    Layer,
    Command(Command),
    Nothing,
}

type Read = Result<Said, reader::Error>;

fn said(text: &str) -> Read {
    if text.starts_with(";LAYER:") {
        return Ok(Said::Layer);
    }
    if text.starts_with(';') {
        return Ok(Said::Nothing);
    }
    Ok(reader::parse(text)?.command.map_or(Said::Nothing, Said::Command))
}

/// A move as the planner sees it. mm, mm/s, mm/s².
#[derive(Debug, Clone, Copy)]
struct Block {
    length: f64,
    /// Change of x, y, z, e along a millimetre of length.
    direction: [f64; 4],
    speed: f64,
    acceleration: f64,
    layer: Option<usize>,
    line: usize,
}

/// Time in which nothing moves; it also lets the planner run dry.
#[derive(Debug, Clone, Copy)]
struct Pause {
    /// The block that it comes before.
    before: usize,
    seconds: f64,
    layer: Option<usize>,
}

/// Reads lines, keeps the state that gives them their meaning, collects blocks.
struct Machine<'a> {
    profile: &'a Profile,
    at: [f64; 4],
    absolute_xyz: bool,
    absolute_e: bool,
    feedrate_mm_s: f64,
    line: usize,
    layer: Option<usize>,
    n_layers: usize,
    blocks: Vec<Block>,
    pauses: Vec<Pause>,
    heaters: Heaters,
    filament_mm: f64,
    most_filament_mm: f64,
    printed_mm: f64,
    travel_mm: f64,
}

const AXES: [char; 4] = ['X', 'Y', 'Z', 'E'];

impl<'a> Machine<'a> {
    fn new(profile: &'a Profile) -> Self {
        Self {
            profile,
            at: [0.0; 4],
            absolute_xyz: true,
            absolute_e: true,
            // What Marlin assumes before the first F.
            feedrate_mm_s: 25.0,
            line: 0,
            layer: None,
            n_layers: 0,
            blocks: Vec::new(),
            pauses: Vec::new(),
            heaters: Heaters::new(profile.machine.heating_k_s, profile.firmware.dialect),
            filament_mm: 0.0,
            most_filament_mm: 0.0,
            printed_mm: 0.0,
            travel_mm: 0.0,
        }
    }

    /// Takes the next lines.
    fn take(&mut self, lines: Vec<Read>) -> Result<(), Error> {
        for read in lines {
            self.line += 1;
            match read.map_err(|source| Error::Line { line: self.line, source })? {
                Said::Layer => {
                    self.layer = Some(self.n_layers);
                    self.n_layers += 1;
                }
                Said::Command(command) => self.command(&command)?,
                Said::Nothing => {}
            }
        }
        Ok(())
    }

    fn command(&mut self, c: &Command) -> Result<(), Error> {
        match (c.letter, c.code) {
            ('G', 0 | 1) => self.straight(c),
            ('G', 2 | 3) => return self.arc(c),
            ('G', 5) => return Err(Error::Unsupported { line: self.line, command: c.to_string() }),
            ('G', 4) => {
                let seconds = c.value('S').unwrap_or_else(|| c.value('P').unwrap_or(0.0) / 1000.0);
                self.pause(seconds.max(0.0));
            }
            ('G', 28) => self.home(c),
            ('G', 90 | 91) => self.set_absolute(c.code == 90),
            ('G', 92) => {
                for (i, axis) in AXES.into_iter().enumerate() {
                    self.at[i] = c.value(axis).unwrap_or(self.at[i]);
                }
            }
            ('M', 82 | 83) => self.absolute_e = c.code == 82,
            ('M', code) => {
                let wait_s = self.heaters.command(code, c.value('S').or_else(|| c.value('R')));
                self.pause(wait_s);
            }
            _ => {}
        }
        Ok(())
    }

    /// Marlin and Smoothieware take both words for filament too, the others have words of its own for that.
    fn set_absolute(&mut self, absolute: bool) {
        self.absolute_xyz = absolute;
        if matches!(self.profile.firmware.dialect, Dialect::Marlin | Dialect::Smoothie) {
            self.absolute_e = absolute;
        }
    }

    /// Marlin 1, Klipper and Repetier move filament by steps where either word says so.
    fn is_absolute(&self, axis: usize) -> bool {
        let by_either =
            matches!(self.profile.firmware.dialect, Dialect::Marlin1 | Dialect::Klipper | Dialect::Repetier);
        match axis {
            3 => self.absolute_e && (self.absolute_xyz || !by_either),
            _ => self.absolute_xyz,
        }
    }

    fn pause(&mut self, seconds: f64) {
        if seconds > 0.0 {
            self.heaters.pass(seconds);
            self.pauses.push(Pause { before: self.blocks.len(), seconds, layer: self.layer });
        }
    }

    fn home(&mut self, c: &Command) {
        let all = !['X', 'Y', 'Z'].iter().any(|&a| c.has(a));
        let homed = ['X', 'Y', 'Z'].map(|a| all || c.has(a));
        (0..3).filter(|&i| homed[i]).for_each(|i| self.at[i] = 0.0);
        let share = homed.iter().filter(|h| **h).count() as f64 / 3.0;
        self.pause(self.profile.machine.homing_s * share);
    }

    /// Takes the feedrate; gives how far each axis is to go.
    fn way(&mut self, c: &Command) -> [f64; 4] {
        if let Some(feedrate) = c.value('F') {
            self.feedrate_mm_s = mm_s_from_mm_min(feedrate).max(1e-3);
        }
        let mut way = [0.0; 4];
        for (i, axis) in AXES.into_iter().enumerate() {
            let Some(value) = c.value(axis) else { continue };
            way[i] = if self.is_absolute(i) { value - self.at[i] } else { value };
        }
        way
    }

    fn straight(&mut self, c: &Command) {
        let way = self.way(c);
        self.go(way);
    }

    fn arc(&mut self, c: &Command) -> Result<(), Error> {
        let way = self.way(c);
        let arc = arc::Arc::of(c, [way[0], way[1]], self.feedrate_mm_s, &self.profile.firmware)
            .ok_or_else(|| Error::Arc { line: self.line, command: c.to_string() })?;
        let share = arc.share();
        for [x, y] in arc.chords() {
            self.go([x, y, way[2] * share, way[3] * share]);
        }
        Ok(())
    }

    fn go(&mut self, way: [f64; 4]) {
        (0..4).for_each(|i| self.at[i] += way[i]);
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
        // Only what pushes no filament at all is a travel; a wipe is none.
        let extrudes = way[3] != 0.0;
        let wanted = match (moves, extrudes) {
            (false, _) => machine.retract_acceleration_mm_s2,
            (true, true) => machine.print_acceleration_mm_s2,
            (true, false) => machine.travel_acceleration_mm_s2,
        };
        // Repetier has the acceleration of a move axis by axis.
        let by_axis = moves && self.profile.firmware.dialect == Dialect::Repetier;
        let mut block = Block {
            length,
            direction: way.map(|w| w / length),
            speed: self.feedrate_mm_s,
            acceleration: if by_axis { f64::INFINITY } else { wanted },
            layer: self.layer,
            line: self.line,
        };
        for (i, part) in block.direction.map(f64::abs).into_iter().enumerate() {
            if part > 0.0 {
                let strongest = machine.max_acceleration_mm_s2[i];
                let strongest = if by_axis && i < 2 { wanted.min(strongest) } else { strongest };
                block.speed = block.speed.min(machine.max_speed_mm_s[i] / part);
                block.acceleration = block.acceleration.min(strongest / part);
            }
        }
        block
    }

    fn estimate(self) -> Estimate {
        let mut clock = Clock { layer_s: vec![0.0; self.n_layers], ..Clock::default() };
        let mut waiting_s = 0.0;
        let mut from = 0;
        let end = Pause { before: self.blocks.len(), seconds: 0.0, layer: None };
        for pause in self.pauses.iter().chain([&end]) {
            let run = &self.blocks[from..pause.before];
            for (block, seconds) in run.iter().zip(durations(run, self.profile)) {
                clock.begin(block.line);
                clock.add(block.layer, seconds);
            }
            clock.add(pause.layer, pause.seconds);
            waiting_s += pause.seconds;
            from = pause.before;
        }
        let volume_mm3 = self.most_filament_mm * FRAC_PI_4 * self.profile.machine.filament_mm.powi(2);
        Estimate {
            marks: clock.marks(),
            total_s: clock.total_s,
            waiting_s,
            layer_s: clock.layer_s,
            filament_mm: self.most_filament_mm,
            filament_g: volume_mm3 * self.profile.filament.density_g_cm3 / 1000.0,
            printed_mm: self.printed_mm,
            travel_mm: self.travel_mm,
        }
    }
}

/// Adds up the times of blocks and pauses.
#[derive(Default)]
struct Clock {
    total_s: f64,
    layer_s: Vec<f64>,
    /// Lines and the time at which they begin, ascending.
    begins: Vec<(usize, f64)>,
}

impl Clock {
    fn begin(&mut self, line: usize) {
        if self.begins.last().is_none_or(|(last, _)| *last != line) {
            self.begins.push((line, self.total_s));
        }
    }

    fn add(&mut self, layer: Option<usize>, seconds: f64) {
        self.total_s += seconds;
        if let Some(layer) = layer {
            self.layer_s[layer] += seconds;
        }
    }

    /// The first line of each percent.
    fn marks(&self) -> Vec<Mark> {
        let percent = |t: f64| (100.0 * t / self.total_s.max(1e-9)).floor().min(99.0);
        let mut marks: Vec<Mark> = Vec::new();
        for &(line, elapsed_s) in &self.begins {
            if marks.last().is_none_or(|last| percent(elapsed_s) > percent(last.elapsed_s)) {
                marks.push(Mark { line, elapsed_s });
            }
        }
        marks
    }
}

/// Duration of each block of a run that begins and ends at rest, s.
fn durations(blocks: &[Block], profile: &Profile) -> Vec<f64> {
    let rule = corner::Rule::of(profile);
    if let corner::Rule::SquareCorner { acceleration, .. } = rule {
        return smooth::durations(blocks, rule, acceleration);
    }
    // Square of the highest speed at which each block may begin.
    let junctions: Vec<f64> = (0..blocks.len())
        .map(|i| if i == 0 { rule.rest2(&blocks[0]) } else { rule.speed2(&blocks[i - 1], &blocks[i]) })
        .collect();
    // One place of the firmware's ring stays empty.
    let window = profile.firmware.planner_moves.saturating_sub(1).max(2);
    let mut entry2 = junctions.first().copied().unwrap_or(0.0);
    let mut times = Vec::with_capacity(blocks.len());
    for (i, block) in blocks.iter().enumerate() {
        // The planner must be able to stop at the end of the last move that it holds.
        let last = (i + window).min(blocks.len());
        let mut exit2 = rule.rest2(&blocks[last - 1]);
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
    fn what_g90_and_g91_say_of_filament_is_each_firmware_s_own() {
        let used = |name: &str, text: &str| {
            let profile = profile::builtin(name).unwrap();
            estimate(text, &profile, &Task::quiet()).unwrap().filament_mm
        };
        // By steps; then G90; two equal words are two steps or none.
        let steps = "M83\nG90\nG1 E1 F600\nG1 E1";
        let absolute = "M82\nG92 E0\nG91\nG1 E1 F600\nG1 E1";
        for (name, of_steps, of_absolute) in [
            ("marlin", 1.0, 2.0),
            ("marlin1", 2.0, 2.0),
            ("klipper", 2.0, 2.0),
            ("repetier", 2.0, 2.0),
            ("reprapfirmware", 2.0, 1.0),
            ("smoothie", 1.0, 2.0),
        ] {
            assert!((used(name, steps) - of_steps).abs() < 1e-12, "{name}");
            assert!((used(name, absolute) - of_absolute).abs() < 1e-12, "{name}");
        }
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
    fn homing_and_warming_up_take_what_the_profile_says() {
        let profile = machine();
        let e =
            estimate("M140 S60\nM104 S200\nG28\nM190 S60\nM109 S200\nM109 S200", &profile, &Task::quiet());
        let warm_s = |to: f64, rate: f64| (to - heat::ROOM_C) / rate + 10.0;
        let slower = warm_s(60.0, profile.machine.heating_k_s[1]);
        assert!(slower > warm_s(200.0, profile.machine.heating_k_s[0]));
        assert!((e.unwrap().waiting_s - slower).abs() < 1e-9);
    }

    #[test]
    fn a_percent_begins_at_its_line() {
        let text: String = (1..=200).map(|i| format!("G0 X{}\nG0 X0\n", 1 + i % 2)).collect();
        let e = estimate(&text, &machine(), &Task::quiet()).unwrap();
        assert_eq!(e.marks.len(), 100);
        assert_eq!((e.marks[0].line, e.marks[0].elapsed_s), (1, 0.0));
        let wrong = e
            .marks
            .iter()
            .zip(0u8..)
            .find(|(m, n)| (m.elapsed_s / e.total_s * 100.0).floor() != f64::from(*n));
        assert_eq!(wrong, None);
    }

    #[test]
    fn an_arc_takes_as_long_as_its_way_and_uses_all_its_filament() {
        let gcode = "G90\nM83\nG0 X110 Y100 F6000\nG4 S0.001\nG3 X90 Y100 I-10 E2 F1200";
        let e = estimate(gcode, &machine(), &Task::quiet()).unwrap();
        let straight =
            estimate("G90\nM83\nG0 X110 Y100 F6000\nG4 S0.001\n", &machine(), &Task::quiet()).unwrap();
        let expected = std::f64::consts::PI * 10.0 / 20.0;
        let took = e.total_s - straight.total_s;
        assert!((took / expected - 1.0).abs() < 0.02, "{took} {expected}");
        assert!((e.filament_mm - 2.0).abs() < 1e-12);
    }

    #[test]
    fn splines_and_nonsense_are_refused_with_their_line() {
        let of = |text: &str| estimate(text, &machine(), &Task::quiet()).unwrap_err().to_string();
        assert!(of("G28\nG5 X1 I1").starts_with("line 2: G5 X1 I1 is not supported"));
        assert!(of("G2 X1 Y1").starts_with("line 1: G2 X1 Y1 has no centre"));
        assert!(of("what").starts_with("line 1: column 1"));
        let token = crate::progress::CancelToken::default();
        token.cancel();
        let stopped = estimate("G28", &machine(), &Task::new(&|_, _| {}, token));
        assert_eq!(stopped, Err(Error::Cancelled(Cancelled)));
    }
}
