//! What a job's G-code tells before it is printed: how long it takes, how much filament, how hot, where its first layer ends.
//!
//! Slicers write what they reckon into comments, at the head or at the end; where they do not, the moves are summed up: filament
//! exactly, time as the moves at their feedrates with nothing for accelerations, and so too little.

use crate::gcode::{profile_in_head, reader};
use std::f64::consts::FRAC_PI_4;
use std::io::{self, BufRead};
use std::ops::ControlFlow;

/// Lines of a head in which a profile is named.
const HEAD_LINES: usize = 16;
/// Comments with which slicers begin a layer: our own and Cura's, PrusaSlicer's, Simplify3D's.
const LAYER: [&str; 3] = ["LAYER:", "LAYER_CHANGE", " layer "];

/// What a job tells.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Survey {
    /// Commands.
    pub(super) n_commands: u64,
    /// Profile that it was made for, where this program made it.
    pub(super) profile: Option<String>,
    /// How long it takes, s.
    pub(super) print_s: f64,
    /// Filament, mm.
    pub(super) filament_mm: f64,
    /// Hottest that the nozzle is set to, °C.
    pub(super) hotend_c: f64,
    /// Hottest that the bed is set to, °C.
    pub(super) bed_c: f64,
    /// Layers that are marked.
    pub(super) n_layers: usize,
    /// Commands before the second of them.
    pub(super) n_first_layer: Option<u64>,
}

impl Survey {
    /// Reads a job to its end.
    ///
    /// # Errors
    /// What the system says; a line that is too long for G-code.
    pub(super) fn of(job: impl BufRead) -> io::Result<Self> {
        let mut reading = Reading::default();
        reader::each_line(job, |_number, line| {
            reading.take(line);
            ControlFlow::Continue(())
        })?;
        Ok(reading.end())
    }

    /// Filament as a volume, mm³; of a filament of this diameter, mm.
    #[must_use]
    pub(super) fn filament_mm3(&self, diameter_mm: f64) -> f64 {
        self.filament_mm * FRAC_PI_4 * diameter_mm.powi(2)
    }
}

#[derive(Debug, Default)]
struct Reading {
    survey: Survey,
    head: String,
    n_lines: usize,
    told_s: Option<f64>,
    told_mm: Option<f64>,
    meter: Meter,
}

impl Reading {
    fn take(&mut self, line: &str) {
        if self.n_lines < HEAD_LINES {
            self.head.push_str(line);
        }
        self.n_lines += 1;
        let (code, comment) = reader::split_comment(line);
        if let Some(comment) = comment {
            self.comment(comment);
        }
        if code.trim().is_empty() {
            return;
        }
        self.survey.n_commands += 1;
        // Words that cannot be read move nothing that is reckoned with here.
        if let Ok(reader::Line { command: Some(command), .. }) = reader::parse(code) {
            self.heat(&command);
            self.meter.take(&command);
        }
    }

    fn comment(&mut self, comment: &str) {
        if LAYER.iter().any(|mark| comment.starts_with(mark)) {
            self.survey.n_layers += 1;
            if self.survey.n_layers == 2 {
                self.survey.n_first_layer = Some(self.survey.n_commands);
            }
        }
        let (key, value) = comment.split_once(['=', ':']).unwrap_or((comment, ""));
        let (key, value) = (key.trim(), value.trim());
        match key {
            "TIME" => self.told_s = value.parse().ok().or(self.told_s),
            "Filament used" => self.told_mm = metres(value).or(self.told_mm),
            "filament used [mm]" => self.told_mm = millimetres(value).or(self.told_mm),
            "estimated printing time (normal mode)" => self.told_s = seconds(value).or(self.told_s),
            _ => {
                let ours = comment.trim().strip_prefix("print_time_s ");
                self.told_s = ours.and_then(|s| s.parse().ok()).or(self.told_s);
            }
        }
    }

    fn heat(&mut self, command: &reader::Command) {
        let set_c = command.value('S').into_iter().chain(command.value('R')).fold(0.0, f64::max);
        // Tuning heats, too: the bed as heater -1.
        let is_bed_tuned = command.value('E').is_some_and(|heater| heater < 0.0);
        let heater = match (command.letter, command.code) {
            ('M', 303) if is_bed_tuned => &mut self.survey.bed_c,
            ('M', 104 | 109 | 303 | 568) | ('G', 10) => &mut self.survey.hotend_c,
            ('M', 140 | 190) => &mut self.survey.bed_c,
            _ => return,
        };
        *heater = heater.max(set_c);
    }

    fn end(self) -> Survey {
        let is_good = |told: &f64| told.is_finite() && *told > 0.0;
        Survey {
            profile: profile_in_head(&self.head).map(str::to_owned),
            print_s: self.told_s.filter(is_good).unwrap_or(self.meter.moved_s),
            filament_mm: self.told_mm.filter(is_good).unwrap_or(self.meter.used_mm()),
            ..self.survey
        }
    }
}

/// `12.3, 4.5`: of several tools the sum.
fn millimetres(text: &str) -> Option<f64> {
    text.split(',').map(|mm| mm.trim().parse::<f64>()).sum::<Result<_, _>>().ok()
}

/// `1.23m`, `1.2m, 0.4m`.
fn metres(text: &str) -> Option<f64> {
    let metres = text.split(',').map(|m| m.trim().strip_suffix('m')?.parse::<f64>().ok());
    metres.sum::<Option<f64>>().map(|metres| 1000.0 * metres)
}

/// `1d 2h 3m 4s`.
fn seconds(text: &str) -> Option<f64> {
    let part = |part: &str| {
        let (number, unit) = part.split_at(part.len().checked_sub(1)?);
        let unit_s = match unit {
            "d" => 86_400.0,
            "h" => 3600.0,
            "m" => 60.0,
            "s" => 1.0,
            _ => return None,
        };
        Some(number.parse::<f64>().ok()? * unit_s)
    };
    text.split_ascii_whitespace().map(part).sum()
}

/// Sums up moves.
#[derive(Debug, Default)]
struct Meter {
    at_mm: [f64; 4],
    is_relative: bool,
    is_filament_relative: bool,
    feedrate_mm_min: f64,
    /// Filament that has gone forward less what came back, and the most that this ever was.
    fed_mm: f64,
    most_fed_mm: f64,
    moved_s: f64,
}

const AXES: [char; 4] = ['X', 'Y', 'Z', 'E'];

impl Meter {
    fn take(&mut self, command: &reader::Command) {
        match (command.letter, command.code) {
            ('G', 0..=3) => self.go(command),
            ('G', 4) => {
                self.moved_s +=
                    command.value('S').unwrap_or_else(|| command.value('P').unwrap_or(0.0) / 1000.0)
            }
            ('G', 90 | 91) => {
                self.is_relative = command.code == 91;
                self.is_filament_relative = self.is_relative;
            }
            ('G', 92) => self.set(command),
            ('M', 82 | 83) => self.is_filament_relative = command.code == 83,
            _ => {}
        }
    }

    fn set(&mut self, command: &reader::Command) {
        for (at, axis) in self.at_mm.iter_mut().zip(AXES) {
            *at = command.value(axis).unwrap_or(*at);
        }
    }

    fn go(&mut self, command: &reader::Command) {
        self.feedrate_mm_min = command.value('F').unwrap_or(self.feedrate_mm_min);
        let is_relative = [self.is_relative, self.is_relative, self.is_relative, self.is_filament_relative];
        let mut by_mm = [0.0; 4];
        for (axis, by) in by_mm.iter_mut().enumerate() {
            if let Some(value) = command.value(AXES[axis]) {
                *by = if is_relative[axis] { value } else { value - self.at_mm[axis] };
                self.at_mm[axis] += *by;
            }
        }
        let [x, y, z, e] = by_mm;
        self.fed_mm += e;
        self.most_fed_mm = self.most_fed_mm.max(self.fed_mm);
        let along_mm = x.hypot(y).hypot(z).max(if x == 0.0 && y == 0.0 && z == 0.0 { e.abs() } else { 0.0 });
        if self.feedrate_mm_min > 0.0 {
            self.moved_s += 60.0 * along_mm / self.feedrate_mm_min;
        }
    }

    const fn used_mm(&self) -> f64 {
        self.most_fed_mm
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Survey {
        Survey::of(text.as_bytes()).unwrap()
    }

    #[test]
    fn what_slicers_reckon_is_taken_from_their_comments() {
        let ours = of(
            "; generated by lumenfab 0.1.0\n; profile klipper, PLA\n; print_time_s 90.5\n; filament used [mm] = 12.5\nG28\n",
        );
        assert_eq!((ours.profile.as_deref(), ours.print_s, ours.filament_mm), (Some("klipper"), 90.5, 12.5));
        let prusa = of(
            "G1 X1 E1\n; filament used [mm] = 1200.5, 10\n; estimated printing time (normal mode) = 1d 2h 3m 4s\n",
        );
        assert_eq!((prusa.print_s, prusa.filament_mm), (93_784.0, 1210.5));
        let cura = of(";TIME:361\n;Filament used: 1.5m\nG28\n");
        assert_eq!((cura.print_s, cura.filament_mm), (361.0, 1500.0));
    }

    #[test]
    fn whatever_heats_counts() {
        let hot = |text| (of(text).hotend_c, of(text).bed_c);
        assert_eq!(hot("M104 S200\nM109 R210\nM190 S60\nM140 S0\n"), (210.0, 60.0));
        assert_eq!(hot("M303 E0 S240 C8\nM303 E-1 S90\n"), (240.0, 90.0));
        assert_eq!((hot("G10 P0 S215 R150\n"), hot("M568 P0 S220\n")), ((215.0, 0.0), (220.0, 0.0)));
    }

    #[test]
    fn without_comments_the_moves_are_summed_up() {
        let absolute =
            of("G90\nM82\nG92 E0\nG1 X30 Y40 F600 E5\nG1 E3\nG1 E5\nG1 X0 Y0 E9\nG92 E0\nG1 X3 Y4 E1\n");
        assert_eq!(absolute.filament_mm, 10.0);
        assert!((absolute.print_s - (5.0 + 0.2 + 0.2 + 5.0 + 0.5)).abs() < 1e-9, "{absolute:?}");
        let relative = of("M83\nG1 X10 F600 E5\nG1 E-2\nG1 E2\nG1 X20 E5\nG4 P500\n");
        assert_eq!(relative.filament_mm, 10.0);
        assert!((relative.print_s - (1.0 + 0.2 + 0.2 + 1.0 + 0.5)).abs() < 1e-9, "{relative:?}");
    }

    #[test]
    fn the_hottest_and_the_end_of_the_first_layer_are_told() {
        let job = of(
            "M140 S60\nM104 S200\nM109 R215\nM190 S55\n;LAYER:0\nG1 X1 E1 F60\n;LAYER:1\nG1 X2 E1\nM104 S0\n",
        );
        assert_eq!((job.hotend_c, job.bed_c, job.n_first_layer, job.n_commands), (215.0, 60.0, Some(5), 7));
        let layers = |text: &str| (of(text).n_layers, of(text).n_first_layer);
        assert_eq!((layers("G1 X1 E1\n"), layers(";LAYER:0\nG1 X1 E1\n")), ((0, None), (1, None)));
    }

    #[test]
    fn a_line_without_end_is_no_g_code() {
        let endless = vec![b'x'; 1 << 17];
        assert_eq!(Survey::of(&endless[..]).unwrap_err().kind(), io::ErrorKind::InvalidData);
    }
}
