//! The placeholders of a profile's scripts.

use super::{Dialect, Profile};

/// The names that may stand in braces.
const PLACEHOLDERS: &[&str] = &["hotend_c", "bed_c", "bed_x_mm", "bed_y_mm", "bed_z_mm", "park_z_mm"];

/// The names that may stand in braces where a print goes on.
const RESUME_PLACEHOLDERS: &[&str] = &[
    "bed_x_mm",
    "bed_y_mm",
    "bed_z_mm",
    "resume_x_mm",
    "resume_y_mm",
    "resume_z_mm",
    "resume_nozzle_z_mm",
    "resume_clear_z_mm",
    "resume_hotend_c",
    "resume_bed_c",
];

/// Where and how warm a print goes on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ResumePoint {
    /// Where it goes on, mm.
    pub xyz_mm: [f64; 3],
    /// The height at which the nozzle stands now, mm.
    pub nozzle_z_mm: f64,
    /// A height above all that is printed, mm.
    pub clear_z_mm: f64,
    /// Nozzle, °C.
    pub hotend_c: f64,
    /// Bed, °C.
    pub bed_c: f64,
}

/// The names that may stand in braces in a script.
pub(super) fn placeholders(key: &str) -> &'static [&'static str] {
    match key {
        "scripts.recovery" | "scripts.pause" | "scripts.resume" => RESUME_PLACEHOLDERS,
        _ => PLACEHOLDERS,
    }
}

/// How far above the part the nozzle is parked, mm.
const PARK_ABOVE_MM: f64 = 5.0;

/// No pause is longer, s: a week. 0 has another meaning to some firmwares.
const PAUSE_S: u32 = 604_800;

/// The first name in braces that is none of [`placeholders`]; an unclosed brace counts as one.
pub(super) fn unknown_placeholder<'a>(key: &str, line: &'a str) -> Option<&'a str> {
    line.split('{').skip(1).find_map(|rest| {
        let name = rest.split('}').next().unwrap_or(rest);
        let known = rest.contains('}') && placeholders(key).contains(&name);
        (!known).then_some(name)
    })
}

impl Profile {
    /// The start script with its placeholders filled in.
    #[must_use]
    pub fn start_gcode(&self) -> Vec<String> {
        self.fill(&self.scripts.start, 0.0)
    }

    /// The end script with its placeholders filled in, for a part that is `top_mm` high.
    #[must_use]
    pub fn end_gcode(&self, top_mm: f64) -> Vec<String> {
        self.fill(&self.scripts.end, top_mm)
    }

    /// The script for a print that is given up, with its placeholders filled in.
    #[must_use]
    pub fn safe_gcode(&self) -> Vec<String> {
        self.fill(&self.scripts.safe, 0.0)
    }

    /// The script before a print goes on after a reset, with its placeholders filled in.
    #[must_use]
    pub fn recovery_gcode(&self, at: &ResumePoint) -> Vec<String> {
        self.fill_at(&self.scripts.recovery, at)
    }

    /// The script of a pause of a print that stands there, with its placeholders filled in.
    #[must_use]
    pub fn pause_gcode(&self, at: &ResumePoint) -> Vec<String> {
        self.fill_at(&self.scripts.pause, at)
    }

    /// The script before it goes on there, with its placeholders filled in.
    #[must_use]
    pub fn resume_gcode(&self, at: &ResumePoint) -> Vec<String> {
        self.fill_at(&self.scripts.resume, at)
    }

    fn fill_at(&self, script: &[String], at: &ResumePoint) -> Vec<String> {
        let rounded = |mm: f64| ((mm * 1e3).round() / 1e3).to_string();
        let [bed_x_mm, bed_y_mm, bed_z_mm] = self.machine.bed_mm;
        let values = [
            ("{bed_x_mm}", bed_x_mm.to_string()),
            ("{bed_y_mm}", bed_y_mm.to_string()),
            ("{bed_z_mm}", bed_z_mm.to_string()),
            ("{resume_x_mm}", rounded(at.xyz_mm[0])),
            ("{resume_y_mm}", rounded(at.xyz_mm[1])),
            ("{resume_z_mm}", rounded(at.xyz_mm[2])),
            ("{resume_nozzle_z_mm}", rounded(at.nozzle_z_mm)),
            ("{resume_clear_z_mm}", rounded(at.clear_z_mm.min(bed_z_mm))),
            ("{resume_hotend_c}", at.hotend_c.to_string()),
            ("{resume_bed_c}", at.bed_c.to_string()),
        ];
        let filled = |line: &String| {
            values.iter().fold(line.trim().to_owned(), |line, (name, value)| line.replace(name, value))
        };
        script.iter().map(filled).collect()
    }

    /// What makes the firmware itself switch the heaters off when nothing has moved, and this was not said, for `orphan_hold_s`;
    /// nothing where it has no such time-out: there a watch beside the host has to (`lumenfab safe-off`).
    #[must_use]
    pub fn orphan_gcode(&self) -> Option<String> {
        let hold_s = self.firmware.orphan_hold_s.ceil();
        match self.firmware.dialect {
            _ if hold_s <= 0.0 || !self.firmware.orphan_guard => None,
            Dialect::Marlin | Dialect::Marlin1 | Dialect::Repetier => Some(format!("M85 S{hold_s}")),
            Dialect::Klipper => Some(format!("SET_IDLE_TIMEOUT TIMEOUT={hold_s}")),
            Dialect::RepRapFirmware | Dialect::Smoothie => None,
        }
    }

    /// What keeps the motors on, and with them the printer's place, as long as a print may be gone on with: most firmwares let
    /// them go after a minute or two without moves. Nothing where they have no such time-out, or one for all.
    #[must_use]
    pub fn motors_gcode(&self) -> Option<String> {
        let hold_s = self.firmware.orphan_hold_s.ceil();
        match self.firmware.dialect {
            _ if hold_s <= 0.0 => None,
            Dialect::Marlin | Dialect::Marlin1 | Dialect::Repetier | Dialect::RepRapFirmware => {
                Some(format!("M84 S{hold_s}"))
            }
            Dialect::Klipper | Dialect::Smoothie => None,
        }
    }

    /// What keeps them on in a pause, however long: nobody moves an axis on which a print is waited for.
    #[must_use]
    pub fn motors_pause_gcode(&self) -> Option<String> {
        self.motors_gcode().map(|_| format!("M84 S{PAUSE_S}"))
    }

    /// What takes [`Self::orphan_gcode`] back at the end of a job.
    #[must_use]
    pub fn orphan_end_gcode(&self) -> Option<String> {
        self.orphan_gcode()?;
        // Klipper's own time-out stays: a printer that is done goes off as well.
        (self.firmware.dialect != Dialect::Klipper).then(|| "M85 S0".to_owned())
    }

    fn fill(&self, script: &[String], top_mm: f64) -> Vec<String> {
        let [x_mm, y_mm, z_mm] = self.machine.bed_mm;
        let values = [
            ("{hotend_c}", self.filament.first_layer_hotend_c.0),
            ("{bed_c}", self.filament.first_layer_bed_c.0),
            ("{bed_x_mm}", x_mm),
            ("{bed_y_mm}", y_mm),
            ("{bed_z_mm}", z_mm),
            ("{park_z_mm}", ((top_mm + PARK_ABOVE_MM) * 1e3).round().min(z_mm * 1e3) / 1e3),
        ];
        let filled = |line: &String| {
            values
                .iter()
                .fold(line.trim().to_owned(), |line, (name, value)| line.replace(name, &value.to_string()))
        };
        script.iter().map(filled).collect()
    }
}
