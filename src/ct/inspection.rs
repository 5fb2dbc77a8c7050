//! What a folder holds and whether it can be used, for the operator.

use super::Warning;
use super::series::Series;
use super::stack::Stack;
use crate::geom::Vector3;
use serde::Serialize;
use std::fmt;

/// The series of a folder.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Inspection {
    /// Files found.
    pub n_files: usize,
    /// The series, numbered from 1 in the order of the folder's files.
    pub series: Vec<SeriesReport>,
    /// What was odd about the folder as a whole.
    pub warnings: Vec<Warning>,
}

/// One series.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SeriesReport {
    /// Its number, from 1: what [`super::SeriesChoice::ByNumber`] takes.
    pub number: usize,
    /// DICOM modality.
    pub modality: String,
    /// Images in it.
    pub n_images: usize,
    /// Columns and rows.
    pub columns_rows: [usize; 2],
    /// Distance of columns and of rows, mm.
    pub pixel_spacing_xy_mm: [f64; 2],
    /// Thickness of the slab of the first image, mm.
    pub slab_thickness_mm: Option<f64>,
    /// Least and largest distance between neighbouring planes, mm; `null` where the planes make no stack.
    pub plane_step_mm: Option<[f64; 2]>,
    /// First and last plane along the normal, mm; `null` where the planes make no stack.
    pub z_range_mm: Option<[f64; 2]>,
    /// How the planes lie.
    pub orientation: Orientation,
    /// Transfer syntax, by name.
    pub encoding: String,
    /// Whether it can be used.
    pub verdict: Verdict,
    /// Why it cannot be used, and what to do.
    pub reason: Option<String>,
    /// What was odd about it.
    pub warnings: Vec<Warning>,
}

/// How planes lie in the patient.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Orientation {
    /// Across the long axis of the body.
    Transaxial,
    /// Seen from the front.
    Coronal,
    /// Seen from the side.
    Sagittal,
    /// None of these within half a degree.
    Oblique,
}

impl Orientation {
    /// The orientation of planes with that normal.
    pub(super) fn of(normal: Vector3) -> Self {
        let is = |v: f64| v.abs() > 0.5_f64.to_radians().cos();
        match (is(normal.x), is(normal.y), is(normal.z)) {
            (true, ..) => Self::Sagittal,
            (_, true, _) => Self::Coronal,
            (.., true) => Self::Transaxial,
            _ => Self::Oblique,
        }
    }
}

impl fmt::Display for Orientation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Transaxial => "transaxial",
            Self::Coronal => "coronal",
            Self::Sagittal => "sagittal",
            Self::Oblique => "oblique",
        })
    }
}

/// Whether a series can be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Yes.
    Usable,
    /// Yes, after a look at the warnings.
    UsableWithWarnings,
    /// No.
    Unusable,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Usable => "usable",
            Self::UsableWithWarnings => "usable with warnings",
            Self::Unusable => "unusable",
        })
    }
}

impl SeriesReport {
    /// The report of a series, its stack where it makes one, and the reason why it cannot be used, if any.
    pub(super) fn new(number: usize, series: &Series, stack: Option<&Stack>, reason: Option<String>) -> Self {
        let first = &series.images[0];
        let warnings = stack.map(|s| s.warnings.clone()).unwrap_or_default();
        let verdict = match (&reason, warnings.is_empty()) {
            (Some(_), _) => Verdict::Unusable,
            (None, true) => Verdict::Usable,
            (None, false) => Verdict::UsableWithWarnings,
        };
        Self {
            number,
            modality: first.modality.clone(),
            n_images: series.images.len() + series.odd.len(),
            columns_rows: [first.shape.columns, first.shape.rows],
            pixel_spacing_xy_mm: first.shape.spacing_xy_mm,
            slab_thickness_mm: first.slab_thickness_mm,
            plane_step_mm: stack.map(|s| extremes(s.plane_z_mm.windows(2).map(|w| w[1] - w[0]))),
            z_range_mm: stack.map(|s| extremes(s.plane_z_mm.iter().copied())),
            orientation: Orientation::of(first.shape.axes[0].cross(&first.shape.axes[1])),
            encoding: first.syntax.name.to_owned(),
            verdict,
            reason,
            warnings,
        }
    }

    fn row(&self) -> [String; 10] {
        let range = |r: Option<[f64; 2]>, between: &str| match r {
            Some([a, b]) if format!("{a:.3}") == format!("{b:.3}") => format!("{a:.3}"),
            Some([a, b]) => format!("{a:.3}{between}{b:.3}"),
            None => "-".into(),
        };
        let [columns, rows] = self.columns_rows;
        let [dx, dy] = self.pixel_spacing_xy_mm;
        [
            self.number.to_string(),
            self.modality.clone(),
            self.n_images.to_string(),
            format!("{columns} x {rows}"),
            format!("{dx:.4} x {dy:.4}"),
            range(self.plane_step_mm, "..."),
            self.slab_thickness_mm.map_or("-".into(), |t| format!("{t:.3}")),
            range(self.z_range_mm, " ... "),
            self.orientation.to_string(),
            self.verdict.to_string(),
        ]
    }
}

fn extremes(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], v| [a.min(v), b.max(v)])
}

const HEAD: [&str; 10] =
    ["no", "kind", "images", "pixels", "pixel mm", "step mm", "slab mm", "z mm", "orientation", "verdict"];

impl fmt::Display for Inspection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut rows = vec![HEAD.map(String::from)];
        rows.extend(self.series.iter().map(SeriesReport::row));
        let widths: [usize; 10] =
            std::array::from_fn(|c| rows.iter().map(|r| r[c].chars().count()).max().unwrap_or(0));
        writeln!(f, "{} files, {} series", self.n_files, self.series.len())?;
        for (i, row) in rows.iter().enumerate() {
            let cells: Vec<String> = row.iter().zip(widths).map(|(c, w)| format!("{c:<w$}")).collect();
            writeln!(f, "{}", cells.join("  ").trim_end())?;
            let Some(report) = i.checked_sub(1).map(|n| &self.series[n]) else { continue };
            for warning in &report.warnings {
                writeln!(f, "    {}: {}", warning.code, warning.text)?;
            }
            if let Some(reason) = &report.reason {
                writeln!(f, "    {reason}")?;
            }
        }
        self.warnings.iter().try_for_each(|w| writeln!(f, "{}: {}", w.code, w.text))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn orientation_is_named_within_half_a_degree() {
        let tilted = |deg: f64| Vector3::new(0.0, -deg.to_radians().sin(), deg.to_radians().cos());
        assert_eq!(Orientation::of(tilted(0.3)), Orientation::Transaxial);
        assert_eq!(Orientation::of(tilted(2.0)), Orientation::Oblique);
        assert_eq!(Orientation::of(tilted(90.0)), Orientation::Coronal);
        assert_eq!(Orientation::of(-Vector3::x()), Orientation::Sagittal);
    }
}
