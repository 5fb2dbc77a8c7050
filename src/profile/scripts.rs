//! The placeholders of a profile's scripts.

use super::Profile;

/// The names that may stand in braces.
pub(super) const PLACEHOLDERS: &[&str] =
    &["hotend_c", "bed_c", "bed_x_mm", "bed_y_mm", "bed_z_mm", "park_z_mm"];

/// How far above the part the nozzle is parked, mm.
const PARK_ABOVE_MM: f64 = 5.0;

/// The first name in braces that is none of [`PLACEHOLDERS`]; an unclosed brace counts as one.
pub(super) fn unknown_placeholder(line: &str) -> Option<&str> {
    line.split('{').skip(1).find_map(|rest| {
        let name = rest.split('}').next().unwrap_or(rest);
        let known = rest.contains('}') && PLACEHOLDERS.contains(&name);
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
