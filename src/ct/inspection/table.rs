//! An inspection as text: one row a series, and below it what there is to say about it.

use super::{Inspection, PixelReport, SeriesReport};
use std::fmt;

const N_COLUMNS: usize = 10;
const HEAD: [&str; N_COLUMNS] =
    ["no", "kind", "images", "pixels", "pixel mm", "step mm", "slab mm", "z mm", "orientation", "verdict"];

impl fmt::Display for Inspection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut rows = vec![HEAD.map(String::from)];
        rows.extend(self.series.iter().map(row));
        let width = |c: usize| rows.iter().map(|r| r[c].chars().count()).max().unwrap_or(0);
        let widths: [usize; N_COLUMNS] = std::array::from_fn(width);
        writeln!(f, "{} files, {} series", self.n_files, self.series.len())?;
        for (i, row) in rows.iter().enumerate() {
            let cells: Vec<String> = row.iter().zip(widths).map(|(c, w)| format!("{c:<w$}")).collect();
            writeln!(f, "{}", cells.join("  ").trim_end())?;
            let Some(report) = i.checked_sub(1).map(|n| &self.series[n]) else { continue };
            for (title, text) in details(report) {
                writeln!(f, "    {title:<9} {text}")?;
            }
        }
        self.warnings.iter().try_for_each(|w| writeln!(f, "folder: {} ({})", w.text, w.code))
    }
}

fn row(report: &SeriesReport) -> [String; N_COLUMNS] {
    let range = |r: Option<[f64; 2]>, between: &str| match r {
        Some([a, b]) if format!("{a:.3}") == format!("{b:.3}") => format!("{a:.3}"),
        Some([a, b]) => format!("{a:.3}{between}{b:.3}"),
        None => "-".into(),
    };
    let [columns, rows] = report.columns_rows;
    let [dx, dy] = report.pixel_spacing_xy_mm;
    [
        report.number.to_string(),
        report.modality.clone(),
        report.n_images.to_string(),
        format!("{columns} x {rows}"),
        format!("{dx:.4} x {dy:.4}"),
        range(report.plane_step_mm, "..."),
        report.slab_thickness_mm.map_or("-".into(), |t| format!("{t:.3}")),
        range(report.z_range_mm, " ... "),
        report.orientation.to_string(),
        report.verdict.to_string(),
    ]
}

/// What there is to say about a series, each under its title.
fn details(report: &SeriesReport) -> Vec<(&'static str, String)> {
    let mut lines = Vec::new();
    if !report.distinction.is_empty() {
        lines.push(("is", report.distinction.clone()));
    }
    lines.push(("stored", format!("{}; {}", stored(&report.pixels), report.encoding)));
    lines.extend(report.slab_gap_mm.and_then(slabs).map(|text| ("slabs", text)));
    if report.orientation != super::Orientation::Transaxial {
        let [x, y, z] = report.normal_lps;
        lines.push(("normal", format!("({x:.4}, {y:.4}, {z:.4}) in the patient (LPS); z runs along it")));
    }
    lines.extend(report.gantry_tilt_deg.map(|deg| ("tilt", format!("{deg:.2} degrees"))));
    lines.extend(report.warnings.iter().map(|w| ("warning", format!("{} ({})", w.text, w.code))));
    lines.extend(report.reason.iter().map(|reason| ("unusable", reason.clone())));
    lines.extend(report.next.iter().map(|command| ("next", command.clone())));
    lines
}

fn stored(pixels: &PixelReport) -> String {
    let sign = if pixels.signed { "signed" } else { "unsigned" };
    let mut text = format!("{} of {} bits, {sign}", pixels.bits_stored, pixels.bits_allocated);
    if let Some([slope, intercept]) = pixels.rescale {
        let side = if intercept < 0.0 { '-' } else { '+' };
        text += &format!("; intensity = {slope} x stored {side} {}", intercept.abs());
    }
    match pixels.padding {
        Some([a, b]) if a == b => text += &format!("; {a} is padding"),
        Some([a, b]) => text += &format!("; {a} to {b} are padding"),
        None => {}
    }
    text
}

/// What slabs leave unseen or see twice; nothing where they touch.
fn slabs(gap_mm: f64) -> Option<String> {
    if gap_mm.abs() < 0.005 {
        return None;
    }
    Some(if gap_mm > 0.0 {
        format!("{gap_mm:.3} mm between neighbouring slabs are not seen")
    } else {
        format!("neighbouring slabs overlap by {:.3} mm", -gap_mm)
    })
}
