//! What the start script lays down before a job begins.
//!
//! Read are the moves (`G0`, `G1`) and the modes that they depend on (`G90`, `G91`, `M82`, `M83`, `G92`). Where homing leaves the nozzle
//! is the firmware's, and what its macros do is not known: what they lay down is not told.

use super::Profile;

/// Filament that a line of the start script pays out.
#[derive(Debug, Clone, PartialEq)]
pub struct Primed {
    /// The line, counted from 1, and its text.
    pub line: usize,
    /// See `line`.
    pub text: String,
    /// The way on the bed, from and to, mm: one place twice where the nozzle stands.
    pub way_mm: [[f64; 2]; 2],
    /// Filament, mm.
    pub filament_mm: f64,
}

/// What the script has done so far.
#[derive(Debug, Default)]
struct Nozzle {
    at: [Option<f64>; 2],
    filament_mm: f64,
    most_filament_mm: f64,
    /// The filament's place, as `G92` and absolute moves count it, mm.
    place_mm: f64,
    is_relative: bool,
    is_filament_relative: bool,
    primed: Vec<Primed>,
}

impl Profile {
    /// What the start script lays down at places that it names.
    #[must_use]
    pub fn primed(&self) -> Vec<Primed> {
        self.after_start().primed
    }

    /// What the start script needs of the filament, mm.
    #[must_use]
    pub fn primed_filament_mm(&self) -> f64 {
        self.after_start().most_filament_mm
    }

    fn after_start(&self) -> Nozzle {
        let mut nozzle = Nozzle::default();
        self.start_gcode().iter().enumerate().for_each(|(i, line)| nozzle.run(i + 1, line));
        nozzle
    }
}

impl Nozzle {
    fn run(&mut self, line: usize, text: &str) {
        let mut words = text.split(';').next().unwrap_or_default().split_ascii_whitespace();
        let command = words.next().unwrap_or_default();
        let value = |letter: char| {
            words.clone().find_map(|word| word.strip_prefix(letter)).and_then(|mm| mm.parse::<f64>().ok())
        };
        match command {
            "G90" => (self.is_relative, self.is_filament_relative) = (false, false),
            "G91" => (self.is_relative, self.is_filament_relative) = (true, true),
            "M82" => self.is_filament_relative = false,
            "M83" => self.is_filament_relative = true,
            "G28" => self.at = [None; 2],
            "G92" => self.place_mm = value('E').unwrap_or(self.place_mm),
            "G0" | "G1" => {
                let to = [value('X'), value('Y')];
                self.go(line, text, to, value('E'));
            }
            _ => {}
        }
    }

    fn go(&mut self, line: usize, text: &str, to: [Option<f64>; 2], filament: Option<f64>) {
        let from = self.at;
        for (at, to) in self.at.iter_mut().zip(to) {
            let moved = |mm: f64| if self.is_relative { at.map(|at| at + mm) } else { Some(mm) };
            *at = to.map_or(*at, moved);
        }
        let Some(filament) = filament else { return };
        let filament_mm = if self.is_filament_relative { filament } else { filament - self.place_mm };
        self.place_mm += filament_mm;
        self.filament_mm += filament_mm;
        self.most_filament_mm = self.most_filament_mm.max(self.filament_mm);
        let ([Some(x), Some(y)], true) = (self.at, filament_mm > 0.0) else { return };
        let from = [from[0].unwrap_or(x), from[1].unwrap_or(y)];
        self.primed.push(Primed { line, text: text.to_owned(), way_mm: [from, [x, y]], filament_mm });
    }
}

#[cfg(test)]
mod tests {
    use crate::profile::{self, Profile};

    fn with_start(lines: &[&str]) -> Profile {
        let mut profile = profile::builtin("reference").unwrap();
        profile.scripts.start = lines.iter().map(|line| (*line).to_owned()).collect();
        profile
    }

    #[test]
    fn the_place_and_the_filament_of_priming_are_read() {
        let marlin = profile::builtin("marlin").unwrap();
        let primed = marlin.primed();
        assert_eq!((primed.len(), primed[0].text.as_str(), primed[0].line), (1, "G1 E8 F180", 12));
        assert_eq!((primed[0].way_mm, primed[0].filament_mm), ([[5.0; 2]; 2], 8.0));
        assert_eq!(marlin.primed_filament_mm(), 8.0);
        let reference = profile::builtin("reference").unwrap();
        assert!(reference.primed().is_empty() && reference.primed_filament_mm() == 0.0);
    }

    #[test]
    fn modes_and_homing_count() {
        // As many slicers begin: absolute filament, a line along the bed's edge and back beside it, and a retraction.
        let lines = [
            "G90",
            "M82",
            "G28",
            "G92 E0",
            "G1 Z0.3 F1500",
            "G1 E3 F200",
            "G1 X2 Y20 ; aside",
            "G1 Y200 E18",
            "G91",
            "G1 X0.5",
            "G1 Y-100 E10",
            "G90",
            "G92 E0",
            "M83",
            "G1 E-1",
        ];
        let profile = with_start(&lines);
        let primed = profile.primed();
        let ways: Vec<_> = primed.iter().map(|p| (p.line, p.way_mm, p.filament_mm)).collect();
        // What is pushed out where homing left the nozzle is counted, but nobody knows where it is.
        assert_eq!(ways, [(8, [[2.0, 20.0], [2.0, 200.0]], 15.0), (11, [[2.5, 200.0], [2.5, 100.0]], 10.0)]);
        assert_eq!(profile.primed_filament_mm(), 28.0);
    }
}
