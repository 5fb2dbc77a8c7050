//! Whether a job keeps within the build space.
//!
//! Firmware stops at its software end stops without a word, or ends the job: what was to lie beyond is laid along the edge, or not
//! at all. So a job is looked through before its first line is sent. A bead beyond is a job for another machine; a move without
//! filament (to park, to wipe, to a dock) is only told: stopped at the edge it does no harm.
//!
//! Positions are followed through absolute and relative moves, inches, arcs in the bed's plane (all of the arc, not its ends alone),
//! `G28` and `G92`. What cannot be known from the job is not judged: relative moves from the place of homing, and behind what moves
//! the nozzle by itself (probing, a change of tools, splines); coordinates set while the place was unknown; other workspaces than the
//! first.

use super::arc::Arc;
use crate::gcode::reader::{self, Command};
use std::fmt;
use std::io::{self, BufRead};
use std::ops::ControlFlow;

/// Machines reach a little beyond their beds, and slicers prime there: beads so far beside it are only told, mm.
const BESIDE_MM: f64 = 5.0;
/// As much below the bed is an offset of the first layer, mm.
const BELOW_MM: f64 = 0.5;
/// What rounding makes of a place at the edge, mm.
const ROUNDING_MM: f64 = 1e-3;
const MM_PER_INCH: f64 = 25.4;
const AXES: [char; 3] = ['X', 'Y', 'Z'];

/// Where a job leaves the build space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Leaving {
    /// Line of the file, from 1.
    pub line: u64,
    /// `X`, `Y` or `Z`.
    pub axis: char,
    /// Where the line goes, mm.
    pub to_mm: f64,
    /// Size of the build space along this axis, from 0, mm.
    pub size_mm: f64,
    /// Whether a bead is to lie there, farther than machines reach beside their beds.
    pub is_lost: bool,
}

impl Leaving {
    /// How far beyond the build space, mm.
    #[must_use]
    pub fn beyond_mm(&self) -> f64 {
        (-self.to_mm).max(self.to_mm - self.size_mm)
    }
}

impl fmt::Display for Leaving {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { line, axis, to_mm, size_mm, .. } = self;
        let beyond_mm = self.beyond_mm();
        write!(
            f,
            "line {line} goes to {axis} {to_mm:.3}, {beyond_mm:.1} mm beyond the build space of 0 to {size_mm} mm"
        )
    }
}

/// The first line of a job that lays a bead beyond a build space of this size (mm, from the bed's front left corner), farther than
/// machines reach beside their beds; where there is none, the first that leaves it at all.
///
/// # Errors
/// What the system says; a line that is too long for G-code.
///
/// ```
/// # use lumenfab::motion::leaving;
/// let job = "G28\nG1 X10 Y10 F3000\nG1 X230 E2\n";
/// let leaving = leaving(job.as_bytes(), [200.0, 200.0, 250.0])?.unwrap();
/// assert_eq!((leaving.line, leaving.axis, leaving.beyond_mm()), (3, 'X', 30.0));
/// # Ok::<(), std::io::Error>(())
/// ```
pub fn leaving(job: impl BufRead, size_mm: [f64; 3]) -> io::Result<Option<Leaving>> {
    let mut nozzle = Nozzle::default();
    let (mut lost, mut left) = (None, None);
    reader::each_line(job, |line, text| {
        // What cannot be read as a command moves nothing.
        if let Ok(reader::Line { command: Some(command), .. }) = reader::parse(text) {
            let reached = nozzle.take(&command);
            let place = |k: usize| reached.along_mm[k].and_then(|along| beyond(along, k, size_mm[k]));
            for (axis, to_mm, beyond_mm) in (0..3).filter_map(place) {
                let is_lost = reached.is_laying && beyond_mm > reach_mm(axis, to_mm);
                let leaving = Leaving { line, axis: AXES[axis], to_mm, size_mm: size_mm[axis], is_lost };
                let first = if is_lost { &mut lost } else { &mut left };
                first.get_or_insert(leaving);
            }
        }
        if lost.is_some() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    Ok(lost.or(left))
}

/// The farthest place beyond either end of an axis, and how far it is.
fn beyond([low, high]: [f64; 2], axis: usize, size_mm: f64) -> Option<(usize, f64, f64)> {
    let (to_mm, beyond_mm) = if -low > high - size_mm { (low, -low) } else { (high, high - size_mm) };
    (beyond_mm > ROUNDING_MM).then_some((axis, to_mm, beyond_mm))
}

/// A way along an axis with a place more.
fn widened(along: Option<[f64; 2]>, place: Option<f64>) -> Option<[f64; 2]> {
    let Some(place) = place else { return along };
    let [low, high] = along.unwrap_or([place; 2]);
    Some([low.min(place), high.max(place)])
}

/// How far beyond its bed a machine may reach there.
fn reach_mm(axis: usize, to_mm: f64) -> f64 {
    ROUNDING_MM
        + match (axis, to_mm < 0.0) {
            (2, true) => BELOW_MM,
            (2, false) => 0.0,
            _ => BESIDE_MM,
        }
}

/// What a command reaches.
#[derive(Debug, Default)]
struct Reached {
    /// Least and greatest place along each axis, mm, where it is known, and the command names the axis, bends the way or lays a bead.
    along_mm: [Option<[f64; 2]>; 3],
    /// Whether filament goes forward meanwhile.
    is_laying: bool,
}

/// Where the nozzle is, as far as the job tells.
#[derive(Debug)]
struct Nozzle {
    /// Place in the machine, mm.
    at_mm: [Option<f64>; 3],
    /// What a coordinate of the job lacks to that of the machine, mm.
    offset_mm: [Option<f64>; 3],
    /// Filament, in the job's coordinate.
    filament: f64,
    is_relative: bool,
    is_filament_relative: bool,
    /// Whether arcs lie in the bed's plane.
    is_flat: bool,
    unit_mm: f64,
}

impl Default for Nozzle {
    fn default() -> Self {
        Self {
            at_mm: [None; 3],
            offset_mm: [Some(0.0); 3],
            filament: 0.0,
            is_relative: false,
            is_filament_relative: false,
            is_flat: true,
            unit_mm: 1.0,
        }
    }
}

impl Nozzle {
    /// Obeys a command.
    fn take(&mut self, command: &Command) -> Reached {
        match (command.letter, command.code, command.subcode) {
            ('G', 0..=3, None) => return self.moved(command),
            ('G', 17..=19, None) => self.is_flat = command.code == 17,
            ('G', 20, None) => self.unit_mm = MM_PER_INCH,
            ('G', 21, None) => self.unit_mm = 1.0,
            ('G', 28, None) => self.home(command),
            ('G', 54, None) => self.offset_mm = [Some(0.0); 3],
            ('G', 55..=59, _) => self.offset_mm = [None; 3],
            ('G', 90 | 91, None) => {
                self.is_relative = command.code == 91;
                self.is_filament_relative = self.is_relative;
            }
            ('M', 82 | 83, None) => self.is_filament_relative = command.code == 83,
            ('G', 92, None) => self.set(command),
            ('G', 92, Some(_)) => self.offset_mm = [Some(0.0); 3],
            // Splines, docking, probing, tools: where the nozzle is then the job does not tell.
            ('G', 5 | 27 | 29..=39, _) | ('T', ..) => self.at_mm = [None; 3],
            _ => {}
        }
        Reached::default()
    }

    fn moved(&mut self, command: &Command) -> Reached {
        let from = self.at_mm;
        let mut along_mm = self.go(command).map(|to| to.map(|to| [to; 2]));
        if command.code > 1 && self.is_flat {
            self.bend(command, from, &mut along_mm);
        }
        let is_laying = self.feed(command);
        if is_laying {
            // A bead lies where it begins, too, and along axes that are not named.
            for (along, from) in along_mm.iter_mut().zip(from) {
                *along = widened(*along, from);
            }
        }
        Reached { along_mm, is_laying }
    }

    /// Where a move goes along the axes that it names.
    fn go(&mut self, command: &Command) -> [Option<f64>; 3] {
        std::array::from_fn(|k| {
            let value_mm = self.unit_mm * command.value(AXES[k])?;
            let from_mm = if self.is_relative { self.at_mm[k] } else { self.offset_mm[k] };
            self.at_mm[k] = from_mm.map(|from_mm| from_mm + value_mm);
            self.at_mm[k]
        })
    }

    /// Widens a move to all of its arc.
    fn bend(&self, command: &Command, from: [Option<f64>; 3], along_mm: &mut [Option<[f64; 2]>; 3]) {
        let ([Some(x0), Some(y0), _], [Some(x1), Some(y1), _]) = (from, self.at_mm) else { return };
        let words = command.words.iter().map(|&(letter, value)| (letter, value.map(|v| self.unit_mm * v)));
        let in_mm = Command { words: words.collect(), ..command.clone() };
        if let Some(arc) = Arc::turning(&in_mm, [x1 - x0, y1 - y0]) {
            let [x, y] = arc.extent();
            along_mm[0] = Some(x.map(|mm| x0 + mm));
            along_mm[1] = Some(y.map(|mm| y0 + mm));
        }
    }

    /// Whether filament goes forward.
    fn feed(&mut self, command: &Command) -> bool {
        let Some(value) = command.value('E') else { return false };
        let forward = if self.is_filament_relative { value } else { value - self.filament };
        self.filament += forward;
        forward > 0.0
    }

    fn home(&mut self, command: &Command) {
        let is_all = !AXES.iter().any(|&axis| command.has(axis));
        for k in (0..3).filter(|&k| is_all || command.has(AXES[k])) {
            // At which end of the axis the machine homes the job does not tell.
            (self.at_mm[k], self.offset_mm[k]) = (None, Some(0.0));
        }
    }

    fn set(&mut self, command: &Command) {
        self.filament = command.value('E').unwrap_or(self.filament);
        for (k, axis) in AXES.into_iter().enumerate() {
            if let Some(value) = command.value(axis) {
                self.offset_mm[k] = self.at_mm[k].map(|at_mm| at_mm - self.unit_mm * value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE_MM: [f64; 3] = [200.0, 180.0, 150.0];

    /// Line, axis, how far beyond; whether a bead is lost there.
    fn found(job: &str) -> Option<(u64, char, f64, bool)> {
        let leaving = leaving(job.as_bytes(), SIZE_MM).unwrap();
        leaving.map(|l| (l.line, l.axis, (1e6 * l.beyond_mm()).round() / 1e6, l.is_lost))
    }

    /// The same where every line lays something.
    fn laid(job: &str) -> Option<(u64, char, f64, bool)> {
        found(&format!("M83\n{}", job.replace('\n', " E1\n") + " E1"))
            .map(|(line, axis, mm, is)| (line - 1, axis, mm, is))
    }

    #[test]
    fn the_first_bead_beyond_each_wall_is_found() {
        assert_eq!(laid("G28\nG1 X200 Y180 Z150\nG1 X0 Y0 Z0\nG1 X100"), None);
        assert_eq!(found("G1 X10\n; note\nG1 X231 E1\nG1 X300 E2"), Some((3, 'X', 31.0, true)));
        assert_eq!(laid("G1 Y-7.25"), Some((1, 'Y', 7.25, true)));
        assert_eq!(laid("G1 X1\n\nG1 Z150.2"), Some((3, 'Z', 0.2, true)));
        assert_eq!(found("G0 X231\nG1 Y5 E1"), Some((2, 'X', 31.0, true)), "it begins there");
        assert_eq!(laid("G1 Z-0.8"), Some((1, 'Z', 0.8, true)));
    }

    #[test]
    fn a_little_beside_the_bed_is_told_apart_and_the_first_lost_bead_comes_before_it() {
        assert_eq!(laid("G1 Y-3\nG1 X60"), Some((1, 'Y', 3.0, false)));
        assert_eq!(laid("G1 Z-0.2"), Some((1, 'Z', 0.2, false)));
        assert_eq!(laid("G1 Y-3\nG1 X60\nG1 X206"), Some((3, 'X', 6.0, true)));
    }

    #[test]
    fn what_lays_nothing_loses_nothing() {
        assert_eq!(found("G1 X190 Y5 Z145 E1\nG91\nG1 Z10\nG1 X-20 Y-20"), Some((3, 'Z', 5.0, false)));
        assert_eq!(found("M82\nG1 X190 E5\nG1 X300 E4"), Some((3, 'X', 100.0, false)), "drawn back");
        assert_eq!(found("M82\nG1 X190 E5\nG92 E0\nG1 X300 E4"), Some((4, 'X', 100.0, true)));
    }

    #[test]
    fn relative_moves_inches_and_set_coordinates_are_followed() {
        assert_eq!(laid("G1 X190\nG91\nG1 X5\nG1 X5\nG1 X8"), Some((5, 'X', 8.0, true)));
        assert_eq!(laid("G20\nG1 X8"), Some((2, 'X', 3.2, false)));
        assert_eq!(laid("G1 X100\nG92 X0\nG1 X99\nG1 X107"), Some((4, 'X', 7.0, true)));
        assert_eq!(laid("G1 X100\nG92 X0\nG28 X\nG1 X107"), None, "homing takes the offset back");
        assert_eq!(laid("G28\nG1 X100\nG91.1\nG1 X150"), None, "of the centres of arcs alone");
    }

    #[test]
    fn what_the_job_does_not_tell_is_not_judged() {
        assert_eq!(laid("G28\nG91\nG1 Z-5\nG1 X-50"), None, "it may home at the far end");
        assert_eq!(laid("G28\nG92 X0\nG1 X900"), None);
        assert_eq!(laid("G55\nG1 X900\nG54\nG1 X900"), Some((4, 'X', 700.0, true)));
        assert_eq!(laid("G1 X190\nG29\nG91\nG1 X50"), None);
        assert_eq!(laid("G1 X190\nT1\nG91\nG1 X50"), None);
        assert_eq!(found("M117 X900\nG4 X900\nnonsense"), None);
    }

    #[test]
    fn an_arc_is_looked_at_as_a_whole() {
        // Half a circle of 20 mm round (190, 90), by way of x = 210; the other half by way of x = 170.
        assert_eq!(laid("G1 X190 Y70\nG3 X190 Y110 I0 J20"), Some((2, 'X', 10.0, true)));
        assert_eq!(laid("G1 X190 Y70\nG2 X190 Y110 I0 J20"), None);
        assert_eq!(laid("G1 X190 Y70\nG3 X190 Y110 R20"), Some((2, 'X', 10.0, true)));
        assert_eq!(laid("G1 X195 Y90\nG2 I-1 J0"), None, "a whole turn");
        assert_eq!(laid("G1 X195 Y90\nG2 I10 J0"), Some((2, 'X', 15.0, true)));
        assert_eq!(laid("G18\nG1 X190 Y70\nG3 X190 Y110 I0 K20"), None, "in another plane");
    }

    #[test]
    fn a_line_without_end_is_no_job() {
        let long = format!("G1 X{}", "0".repeat(70_000));
        assert!(leaving(long.as_bytes(), SIZE_MM).unwrap_err().to_string().contains("too long"));
    }
}
