//! The record of what a printer deposited: `beads.csv`, or what it was commanded, to segments; bed frame, mm.
//!
//! One row an extruding segment: `t_s,x0_mm,y0_mm,z0_mm,x1_mm,y1_mm,z1_mm,volume_mm3,width_mm,height_mm,hotend_c`.
//! Columns are found by name, in any order; columns that are not needed may be missing. A row that cannot be
//! read (a print that was cut off, a damaged file) is left out and counted.
//!
//! ```
//! let text = "x0_mm,y0_mm,z0_mm,x1_mm,y1_mm,z1_mm,volume_mm3,width_mm,height_mm\n0,0,0.2,10,0,0.2,0.8,0.4,0.2\n";
//! let record = lumenfab::report::record::parse(text).unwrap();
//! assert_eq!(record.segments.len(), 1);
//! ```

use crate::ct::Warning;
use crate::geom::Point3;
use crate::profile::BeadShape;
use crate::toolpath::BeadModel;

/// A straight piece of deposited material. Bed frame, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Where the nozzle began.
    pub from: Point3,
    /// Where it ended; the same place for a blob.
    pub to: Point3,
    /// Material, mm³.
    pub volume_mm3: f64,
    /// Width of the bead, mm.
    pub width_mm: f64,
    /// Height of the bead, mm.
    pub height_mm: f64,
}

/// Where what is known of a deposition comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub enum Origin {
    /// Recorded by what watched the nozzle.
    #[default]
    #[serde(rename = "recorded")]
    Recorded,
    /// From the lines that the printer has acknowledged: what it was told, not what it did.
    #[serde(rename = "commanded, not measured")]
    Commanded,
}

impl Origin {
    /// What all that the print has laid is called: `deposited lumen`, `commanded lumen`.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Recorded => "deposited",
            Self::Commanded => "commanded",
        }
    }

    /// How it is known, for the reader.
    #[must_use]
    pub const fn known(self) -> &'static str {
        match self {
            Self::Recorded => "as recorded",
            Self::Commanded => "commanded, not measured",
        }
    }

    /// What the stage `recorded` of `report.json` is called before a reader.
    #[must_use]
    pub const fn step(self) -> &'static str {
        match self {
            Self::Recorded => "recorded",
            Self::Commanded => "commanded",
        }
    }
}

/// All that was deposited, in the order of time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Record {
    /// The pieces.
    pub segments: Vec<Segment>,
    /// Where they are known from.
    pub origin: Origin,
    /// What was odd about the file.
    pub warnings: Vec<Warning>,
}

/// The text is no record.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RecordError {
    /// No line with column names.
    #[error(
        "the record of deposition is empty: expected a header line with column names; print the job again with recording on"
    )]
    Empty,
    /// A column that is needed is not there.
    #[error(
        "the record of deposition has no column {column:?}: its header is {header:?}; use the beads.csv that hil-sim --record writes"
    )]
    Column {
        /// The missing column.
        column: &'static str,
        /// What the file has instead, shortened.
        header: String,
    },
    /// There are rows, and none can be read.
    #[error(
        "none of the {n_rows} rows of the record of deposition can be read, the first bad one in line {line}: print the job again with recording on"
    )]
    NoRow {
        /// Rows found.
        n_rows: usize,
        /// Line number of the first one, from 1.
        line: usize,
    },
}

/// A straight way along which material is laid. Bed frame, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Way {
    /// Where the nozzle begins.
    pub from: Point3,
    /// Where it ends.
    pub to: Point3,
    /// Material, mm³.
    pub volume_mm3: f64,
}

impl Record {
    /// The beads that lie along commanded ways: a layer is a height at which beads are laid, as high as it is above the next lower
    /// one (the bed below the first); widths follow from volume, length and height by the bead model. What is pushed on the spot is
    /// no bead.
    #[must_use]
    pub fn commanded(ways: impl IntoIterator<Item = Way>, shape: BeadShape) -> Self {
        let mut heights: Vec<f64> = Vec::new();
        let bead = |way: Way| {
            let length_mm = (way.to - way.from).norm();
            let is_level = (way.to.z - way.from.z).abs() < SAME_HEIGHT_MM;
            if is_level && (way.to - way.from).xy().norm() > 0.0 {
                heights.retain(|z| *z < way.to.z - SAME_HEIGHT_MM);
                heights.push(way.to.z);
            }
            let (&top, below) = heights.split_last()?;
            let height_mm = top - below.last().copied().unwrap_or(0.0);
            if length_mm < 1e-9 || height_mm <= 0.0 {
                return None;
            }
            let width_mm = width_mm(shape, height_mm, way.volume_mm3 / length_mm);
            Some(Segment { from: way.from, to: way.to, volume_mm3: way.volume_mm3, width_mm, height_mm })
        };
        let segments = ways.into_iter().filter_map(bead).collect();
        Self { segments, origin: Origin::Commanded, warnings: Vec::new() }
    }
}

/// The width of a bead of this cross-section: its area over its height is the pitch of the bead model; narrower than it is high, it
/// is a round thread.
fn width_mm(shape: BeadShape, height_mm: f64, area_mm2: f64) -> f64 {
    let wide_mm = area_mm2 / height_mm + BeadModel::new(shape, height_mm).overlap_mm();
    match shape {
        BeadShape::Stadium if wide_mm < height_mm => 2.0 * (area_mm2 / std::f64::consts::PI).sqrt(),
        BeadShape::Stadium | BeadShape::Rectangle => wide_mm,
    }
}

/// Heights that differ by less are the same, mm.
const SAME_HEIGHT_MM: f64 = 5e-4;

const COLUMNS: [&str; 9] =
    ["x0_mm", "y0_mm", "z0_mm", "x1_mm", "y1_mm", "z1_mm", "volume_mm3", "width_mm", "height_mm"];

/// Reads a record.
///
/// # Errors
/// [`RecordError`] where no header, not all columns or no readable row is found. A record of a header alone is
/// a print that deposited nothing: no error.
pub fn parse(text: &str) -> Result<Record, RecordError> {
    let mut lines = text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty() && !l.starts_with('#'));
    let (_, header) = lines.next().ok_or(RecordError::Empty)?;
    let place_of_field = fields(header)?;
    let mut record = Record::default();
    let mut bad: Vec<usize> = Vec::new();
    let mut n_empty = 0;
    for (i, line) in lines {
        match segment(line, &place_of_field) {
            Some(s) if s.width_mm > 0.0 && s.volume_mm3 > 0.0 => record.segments.push(s),
            Some(_) => n_empty += 1,
            None => bad.push(i + 1),
        }
    }
    if let (Some(&line), true) = (bad.first(), record.segments.is_empty() && n_empty == 0) {
        return Err(RecordError::NoRow { n_rows: bad.len(), line });
    }
    record.warnings = warnings(&bad, n_empty);
    Ok(record)
}

/// For every field of a line which of [`COLUMNS`] it holds.
fn fields(header: &str) -> Result<Vec<Option<usize>>, RecordError> {
    let header = header.trim_start_matches('\u{feff}');
    let names: Vec<&str> = header.split(',').map(|n| n.trim().trim_matches('"')).collect();
    if let Some(column) = COLUMNS.into_iter().find(|c| !names.contains(c)) {
        return Err(RecordError::Column { column, header: header.chars().take(120).collect() });
    }
    Ok(names.iter().map(|n| COLUMNS.iter().position(|c| c == n)).collect())
}

fn segment(line: &str, place_of_field: &[Option<usize>]) -> Option<Segment> {
    let mut values = [f64::NAN; COLUMNS.len()];
    for (text, place) in line.split(',').zip(place_of_field) {
        if let Some(place) = place {
            values[*place] = text.trim().parse().ok()?;
        }
    }
    // Beyond 100 m the coordinates are damage, and the integer grid of regions ends.
    if !values.iter().all(|v| v.abs() < 1e4) {
        return None;
    }
    let [x0, y0, z0, x1, y1, z1, volume_mm3, width_mm, height_mm] = values;
    Some(Segment {
        from: Point3::new(x0, y0, z0),
        to: Point3::new(x1, y1, z1),
        volume_mm3,
        width_mm,
        height_mm,
    })
}

fn warnings(bad: &[usize], n_empty: usize) -> Vec<Warning> {
    let mut warnings = Vec::new();
    if let Some(first) = bad.first() {
        warnings.push(Warning {
            code: "report.record_bad_rows".into(),
            text: format!(
                "{} rows of the record of deposition could not be read and were left out, the first in line {first}",
                bad.len()
            ),
        });
    }
    if n_empty > 0 {
        warnings.push(Warning {
            code: "report.record_empty_rows".into(),
            text: format!("{n_empty} rows of the record of deposition hold no material and were left out"),
        });
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "t_s,x0_mm,y0_mm,z0_mm,x1_mm,y1_mm,z1_mm,volume_mm3,width_mm,height_mm,hotend_c";

    #[test]
    fn columns_are_found_by_name() {
        let shuffled = "width_mm,x0_mm,y0_mm,z0_mm,x1_mm,y1_mm,z1_mm,height_mm,volume_mm3,note\r\n0.4,1,2,3,4,5,3,0.2,0.5,hello\r\n";
        let record = parse(shuffled).unwrap();
        assert_eq!(record.segments[0].to, Point3::new(4.0, 5.0, 3.0));
        assert!((record.segments[0].width_mm - 0.4).abs() < 1e-12 && record.warnings.is_empty());
    }

    #[test]
    fn a_row_cut_off_is_left_out_and_said() {
        let text = format!("{HEADER}\n0,0,0,0.2,1,0,0.2,0.08,0.4,0.2,200\n1,1,0,0.2,2,0,0.2,0.0");
        let record = parse(&text).unwrap();
        assert_eq!(record.segments.len(), 1);
        assert!(record.warnings[0].text.contains("line 3"));
    }

    #[test]
    fn numbers_that_are_none_are_refused() {
        let text = format!(
            "{HEADER}\n0,nan,0,0.2,1,0,0.2,0.08,0.4,0.2,200\n0,1e300,0,0.2,1,0,0.2,0.08,0.4,0.2,200\n"
        );
        assert_eq!(parse(&text), Err(RecordError::NoRow { n_rows: 2, line: 2 }));
    }

    #[test]
    fn empty_and_foreign_files_are_refused_a_header_alone_is_not() {
        assert_eq!(parse(""), Err(RecordError::Empty));
        let foreign = parse("a,b,c\n1,2,3\n").unwrap_err();
        assert!(matches!(&foreign, RecordError::Column { column: "x0_mm", .. }));
        assert!(foreign.to_string().contains("hil-sim --record"));
        assert!(parse(HEADER).unwrap().segments.is_empty());
    }

    #[test]
    fn rows_without_material_are_counted() {
        let text = format!("{HEADER}\n0,0,0,0.2,1,0,0.2,0,0,0.2,200\n");
        let record = parse(&text).unwrap();
        assert!(record.segments.is_empty() && record.warnings[0].code == "report.record_empty_rows");
    }

    #[test]
    fn commanded_ways_are_beads_as_high_as_their_layers() {
        let way = |x0: f64, x1: f64, z: f64, volume_mm3: f64| Way {
            from: Point3::new(x0, 0.0, z),
            to: Point3::new(x1, 0.0, z),
            volume_mm3,
        };
        let ways = [
            way(0.0, 10.0, 0.3, 1.2),
            way(10.0, 20.0, 0.5, 0.8),
            way(20.0, 20.0, 0.5, 0.1),
            way(20.0, 0.0, 0.5, 1.6),
        ];
        let record = Record::commanded(ways, BeadShape::Rectangle);
        let near = |a: f64, b: f64| (a - b).abs() < 1e-9;
        let shapes: Vec<[f64; 2]> = record.segments.iter().map(|s| [s.width_mm, s.height_mm]).collect();
        assert!(shapes.len() == 3 && shapes.iter().all(|s| near(s[0], 0.4)), "{shapes:?}");
        assert!(near(shapes[0][1], 0.3) && near(shapes[1][1], 0.2) && near(shapes[2][1], 0.2), "{shapes:?}");
        assert_eq!(record.origin, Origin::Commanded);
    }
}
