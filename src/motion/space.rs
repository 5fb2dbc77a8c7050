//! Whether a job keeps within the build space.
//!
//! Firmware stops at its software end stops without a word, or ends the job: what was to lie beyond is laid along the edge, or not
//! at all. So a job is looked through before its first line is sent. Positions are followed through absolute and relative moves,
//! inches, arcs (all of the arc, not its ends alone), `G28` and `G92`. What cannot be known from the job is not judged: relative
//! moves from the place of homing, coordinates set while the place was unknown, other workspaces than the first.

use super::arc::Arc;
use crate::gcode::reader::{self, Command};
use std::fmt;
use std::io::{self, BufRead};

/// Machines reach a little beyond their beds, and slicers wipe and prime there: so far in x and y it is only told, mm.
const BESIDE_MM: f64 = 5.0;
/// As much below the bed is an offset of the first layer, mm.
const BELOW_MM: f64 = 0.5;
/// What rounding makes of a place at the edge, mm.
const ROUNDING_MM: f64 = 1e-3;
/// A longer line is no G-code, bytes.
const MAX_LINE: u64 = 1 << 16;
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
    /// Whether it is farther than machines reach beside their beds.
    pub is_far: bool,
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

/// The first line of a job that leaves a build space of this size (mm, from the bed's front left corner) by more than machines
/// reach beside their beds; where there is none, the first that leaves it at all.
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
pub fn leaving(mut job: impl BufRead, size_mm: [f64; 3]) -> io::Result<Option<Leaving>> {
    let mut nozzle = Nozzle::default();
    let mut near = None;
    let mut raw = Vec::new();
    for line in 1.. {
        raw.clear();
        let n_bytes = io::Read::take(&mut job, MAX_LINE).read_until(b'\n', &mut raw)? as u64;
        if n_bytes == 0 {
            break;
        }
        if n_bytes == MAX_LINE {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "a line is too long for G-code"));
        }
        // What cannot be read as a command moves nothing.
        let Ok(reader::Line { command: Some(command), .. }) = reader::parse(&String::from_utf8_lossy(&raw))
        else {
            continue;
        };
        let reached = nozzle.take(&command);
        let outside = (0..3).filter_map(|k| left(line, k, reached[k]?, size_mm[k]));
        for leaving in outside {
            if leaving.is_far {
                return Ok(Some(leaving));
            }
            near.get_or_insert(leaving);
        }
    }
    Ok(near)
}

fn left(line: u64, axis: usize, [low, high]: [f64; 2], size_mm: f64) -> Option<Leaving> {
    let to_mm = if -low > high - size_mm { low } else { high };
    let is_vertical = axis == 2;
    let most_mm = match (is_vertical, to_mm < 0.0) {
        (false, _) => BESIDE_MM,
        (true, true) => BELOW_MM,
        (true, false) => 0.0,
    };
    let leaving = Leaving { line, axis: AXES[axis], to_mm, size_mm, is_far: false };
    let beyond_mm = leaving.beyond_mm();
    (beyond_mm > ROUNDING_MM).then_some(Leaving { is_far: beyond_mm > most_mm + ROUNDING_MM, ..leaving })
}

/// Where the nozzle is, as far as the job tells.
#[derive(Debug)]
struct Nozzle {
    /// Place in the machine, mm.
    at_mm: [Option<f64>; 3],
    /// What a coordinate of the job lacks to that of the machine, mm.
    offset_mm: [Option<f64>; 3],
    is_relative: bool,
    unit_mm: f64,
}

impl Default for Nozzle {
    fn default() -> Self {
        Self { at_mm: [None; 3], offset_mm: [Some(0.0); 3], is_relative: false, unit_mm: 1.0 }
    }
}

impl Nozzle {
    /// Obeys a command; least and greatest place on its way along each axis, mm, where it is known and the command names the axis
    /// or bends the way.
    fn take(&mut self, command: &Command) -> [Option<[f64; 2]>; 3] {
        match (command.letter, command.code) {
            ('G', 0 | 1) => return self.go(command).map(|to| to.map(|to| [to; 2])),
            ('G', 2 | 3) => return self.bend(command),
            ('G', 20) => self.unit_mm = MM_PER_INCH,
            ('G', 21) => self.unit_mm = 1.0,
            ('G', 28) => self.home(command),
            ('G', 54) => self.offset_mm = [Some(0.0); 3],
            ('G', 55..=59) => self.offset_mm = [None; 3],
            ('G', 90 | 91) => self.is_relative = command.code == 91,
            ('G', 92) => self.set(command),
            _ => {}
        }
        [None; 3]
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

    fn bend(&mut self, command: &Command) -> [Option<[f64; 2]>; 3] {
        let from = self.at_mm;
        let mut reached = self.go(command).map(|to| to.map(|to| [to; 2]));
        if let ([Some(x0), Some(y0), _], [Some(x1), Some(y1), _]) = (from, self.at_mm) {
            let scaled = Command {
                words: command.words.iter().map(|&(c, v)| (c, v.map(|v| self.unit_mm * v))).collect(),
                ..command.clone()
            };
            if let Some(arc) = Arc::turning(&scaled, [x1 - x0, y1 - y0]) {
                let [x, y] = arc.extent();
                reached[0] = Some(x.map(|mm| x0 + mm));
                reached[1] = Some(y.map(|mm| y0 + mm));
            }
        }
        reached
    }

    fn home(&mut self, command: &Command) {
        let is_all = !AXES.iter().any(|&axis| command.has(axis));
        for k in (0..3).filter(|&k| is_all || command.has(AXES[k])) {
            // At which end of the axis the machine homes the job does not tell.
            (self.at_mm[k], self.offset_mm[k]) = (None, Some(0.0));
        }
    }

    fn set(&mut self, command: &Command) {
        if command.subcode.is_some() {
            self.offset_mm = [Some(0.0); 3];
            return;
        }
        for k in 0..3 {
            if let Some(value) = command.value(AXES[k]) {
                self.offset_mm[k] = self.at_mm[k].map(|at_mm| at_mm - self.unit_mm * value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE_MM: [f64; 3] = [200.0, 180.0, 150.0];

    /// Line, axis, how far beyond; whether that is far.
    fn found(job: &str) -> Option<(u64, char, f64, bool)> {
        let leaving = leaving(job.as_bytes(), SIZE_MM).unwrap();
        leaving.map(|l| (l.line, l.axis, (1e6 * l.beyond_mm()).round() / 1e6, l.is_far))
    }

    #[test]
    fn the_first_line_beyond_each_wall_is_found() {
        assert_eq!(found("G28\nG1 X200 Y180 Z150\nG1 X0 Y0 Z0\nG1 X100"), None);
        assert_eq!(found("G1 X10\n; note\nG1 X231 E1\nG1 X300"), Some((3, 'X', 31.0, true)));
        assert_eq!(found("G0 Y-7.25"), Some((1, 'Y', 7.25, true)));
        assert_eq!(found("G1 X1\n\nG1 Z150.2 F300"), Some((3, 'Z', 0.2, true)));
        assert_eq!(found("G1 Z-0.8"), Some((1, 'Z', 0.8, true)));
    }

    #[test]
    fn a_little_beside_the_bed_is_told_apart_and_the_first_far_one_comes_before_it() {
        assert_eq!(found("G1 Y-3\nG1 X60 E9"), Some((1, 'Y', 3.0, false)));
        assert_eq!(found("G1 Z-0.2"), Some((1, 'Z', 0.2, false)));
        assert_eq!(found("G1 Y-3\nG1 X60 E9\nG1 X206"), Some((3, 'X', 6.0, true)));
    }

    #[test]
    fn relative_moves_inches_and_set_coordinates_are_followed() {
        assert_eq!(found("G1 X190\nG91\nG1 X5\nG1 X5\nG1 X8"), Some((5, 'X', 8.0, true)));
        assert_eq!(found("G20\nG1 X8"), Some((2, 'X', 3.2, false)));
        assert_eq!(found("G1 X100\nG92 X0\nG1 X99\nG1 X107"), Some((4, 'X', 7.0, true)));
        assert_eq!(found("G1 X100\nG92 X0\nG28 X\nG1 X107"), None, "homing takes the offset back");
    }

    #[test]
    fn what_the_job_does_not_tell_is_not_judged() {
        assert_eq!(found("G28\nG91\nG1 Z-5\nG1 X-50"), None, "it may home at the far end");
        assert_eq!(found("G28\nG92 X0\nG1 X900"), None);
        assert_eq!(found("G55\nG1 X900\nG54\nG1 X900"), Some((4, 'X', 700.0, true)));
        assert_eq!(found("M117 X900\nG4 X900\nnonsense"), None);
    }

    #[test]
    fn an_arc_is_looked_at_as_a_whole() {
        // Half a circle of 20 mm round (190, 90), by way of x = 210; the other half by way of x = 170.
        assert_eq!(found("G1 X190 Y70\nG3 X190 Y110 I0 J20 E1"), Some((2, 'X', 10.0, true)));
        assert_eq!(found("G1 X190 Y70\nG2 X190 Y110 I0 J20 E1"), None);
        assert_eq!(found("G1 X190 Y70\nG3 X190 Y110 R20"), Some((2, 'X', 10.0, true)));
        assert_eq!(found("G1 X195 Y90\nG2 I-1 J0"), None, "a whole turn");
        assert_eq!(found("G1 X195 Y90\nG2 I10 J0"), Some((2, 'X', 15.0, true)));
    }

    #[test]
    fn a_line_without_end_is_no_job() {
        let long = format!("G1 X{}", "0".repeat(70_000));
        assert!(leaving(long.as_bytes(), SIZE_MM).unwrap_err().to_string().contains("too long"));
    }
}
