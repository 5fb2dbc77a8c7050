//! The deviation around the vessel and along it, cut open and laid flat: one map a branch.
//!
//! A place on the boundary of a CT plane goes to the branch whose centre is nearest to that of its contour, and there to the
//! angle around the branch's centre, seen as the pictures show the plane. Along the vessel the centres are joined by
//! straight lines. Cells without a place are not known.

use super::super::plate::{Plate, Sample};
use super::super::{Branch, Report};
use super::colour::Range;
use super::embed;
use crate::draw;
use crate::geom::Point2;
use serde::Serialize;

/// Cells around the vessel.
const N_ANGLES: usize = 72;
/// Width of a map and pixels a mm of its height, page pixels.
const WIDTH: f64 = 216.0;
const PX_PER_MM: f64 = 3.0;
const HEIGHT_LEAST: f64 = 40.0;
const HEIGHT_MOST: f64 = 420.0;

/// The map of a branch, the plane of greatest z on top.
#[derive(Serialize)]
pub(in super::super) struct Map {
    pub(in super::super) name: String,
    description: String,
    picture: String,
    pub(in super::super) width: f64,
    pub(in super::super) height: f64,
    rows: Vec<Row>,
    pub(in super::super) sides: [&'static str; 5],
    pub(in super::super) length: String,
    /// The picture's pixels, three bytes each, and how many stand in a row.
    #[serde(skip)]
    pub(in super::super) pixels: Vec<u8>,
    #[serde(skip)]
    pub(in super::super) n_cols: usize,
}

/// The stripe of one plane.
#[derive(Serialize)]
struct Row {
    plane: usize,
    y: f64,
    height: f64,
    along: String,
}

struct Strip {
    plane: usize,
    along_mm: f64,
    cells: [Option<f64>; N_ANGLES],
}

/// Which deviation of a plane is shown.
pub(super) type RingOf = fn(&Plate) -> &[Sample];

/// Maps of all branches that lie in two planes or more.
///
/// # Errors
/// Where a picture cannot be encoded.
pub(super) fn maps(report: &Report, range: Range, ring: RingOf) -> Result<Vec<Map>, png::EncodingError> {
    let branches = &report.anatomy.branches;
    let strips = branches.iter().map(|branch| (branch, strips(report, branch, ring)));
    strips.filter(|(_, strips)| strips.len() > 1).map(|(branch, s)| map(report, branch, &s, range)).collect()
}

/// Where a branch runs through a plane.
fn centre(branch: &Branch, plane: usize) -> Option<Point2> {
    let contours = branch.stages.iter().find(|s| s.stage == "contours")?;
    contours.planes.iter().find(|p| p.plane == plane).map(|p| p.centre_xy_mm.into())
}

fn strips(report: &Report, branch: &Branch, ring: RingOf) -> Vec<Strip> {
    let mut strips: Vec<Strip> = Vec::new();
    let mut before: Option<(Point2, f64, f64)> = None;
    for picture in &report.pictures {
        let Some(at) = centre(branch, picture.plane) else { continue };
        let z_mm = report.plane_z_mm[picture.plane];
        let along_mm = before.map_or(0.0, |(p, z, along)| along + (at - p).norm().hypot(z_mm - z));
        before = Some((at, z_mm, along_mm));
        strips.push(Strip {
            plane: picture.plane,
            along_mm,
            cells: cells(report, (branch, picture.plane), ring(&picture.plate), at),
        });
    }
    strips
}

fn cells(
    report: &Report,
    (branch, plane): (&Branch, usize),
    ring: &[Sample],
    at: Point2,
) -> [Option<f64>; N_ANGLES] {
    let centres: Vec<Point2> = report.anatomy.branches.iter().filter_map(|b| centre(b, plane)).collect();
    let mut sums = [(0.0, 0usize); N_ANGLES];
    for samples in ring.chunk_by(|a, b| a.contour_idx == b.contour_idx) {
        let own = middle(samples);
        let nearest = centres.iter().map(|c| (c - own).norm()).fold(f64::INFINITY, f64::min);
        if centre(branch, plane).is_none_or(|c| (c - own).norm() > nearest) {
            continue;
        }
        for (sample, off_mm) in samples.iter().filter_map(|s| Some((s, s.off_mm?))) {
            let cell = &mut sums[angle_cell(sample.at, at)];
            *cell = (cell.0 + off_mm, cell.1 + 1);
        }
    }
    sums.map(|(sum, n)| (n > 0).then(|| sum / n as f64))
}

fn middle(samples: &[Sample]) -> Point2 {
    let sum = samples.iter().fold(crate::geom::Vector2::zeros(), |sum, s| sum + s.at.coords);
    (sum / samples.len() as f64).into()
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a part of a turn")]
fn angle_cell(at: Point2, centre: Point2) -> usize {
    let d = at - centre;
    let turn = d.y.atan2(d.x).rem_euclid(std::f64::consts::TAU) / std::f64::consts::TAU;
    ((turn * N_ANGLES as f64) as usize).min(N_ANGLES - 1)
}

fn map(report: &Report, branch: &Branch, strips: &[Strip], range: Range) -> Result<Map, png::EncodingError> {
    let length_mm = strips.last().map_or(0.0, |s| s.along_mm);
    let height = (length_mm * PX_PER_MM).clamp(HEIGHT_LEAST, HEIGHT_MOST).round();
    let y_of = |along_mm: f64| height * (1.0 - along_mm / length_mm.max(1e-9));
    let edge = |i: usize| -> f64 {
        match i {
            0 => height,
            i if i == strips.len() => 0.0,
            i => y_of(0.5 * (strips[i - 1].along_mm + strips[i].along_mm)),
        }
    };
    let row = |(i, strip): (usize, &Strip)| Row {
        plane: strip.plane,
        y: (edge(i + 1) * 10.0).round() / 10.0,
        height: ((edge(i) - edge(i + 1)) * 10.0).round() / 10.0,
        along: format!("{:.1}", strip.along_mm),
    };
    let rows: Vec<Row> = strips.iter().enumerate().map(row).collect();
    let worst = strips.iter().flat_map(|s| s.cells.iter().flatten()).map(|c| c.abs()).fold(0.0, f64::max);
    let pixels = pixels(strips, &rows, height, range);
    Ok(Map {
        name: branch.name.clone(),
        description: format!(
            "Deviation of {} around the vessel (left to right) and along it (upward), planes {} to {}; at most {worst:.2} mm",
            branch.name, branch.planes[0], branch.planes[1]
        ),
        picture: embed::png(&draw::encode_bytes(&pixels, N_ANGLES, png::ColorType::Rgb)?),
        width: WIDTH,
        height,
        rows,
        sides: report.pictures.first().map_or([""; 5], |p| around(p.plate.sides)),
        length: format!("{length_mm:.1}"),
        pixels,
        n_cols: N_ANGLES,
    })
}

/// Letters at 0, 90, 180, 270 and 360 degrees.
const fn around([left, right, top, bottom, ..]: [&'static str; 6]) -> [&'static str; 5] {
    [right, bottom, left, top, right]
}

fn pixels(strips: &[Strip], rows: &[Row], height: f64, range: Range) -> Vec<u8> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few hundred")]
    let n_rows = height as usize;
    let mut pixels = Vec::with_capacity(n_rows * N_ANGLES * 3);
    for j in 0..n_rows {
        let y = j as f64 + 0.5;
        let i = rows.iter().position(|r| r.y <= y).unwrap_or(strips.len() - 1);
        pixels.extend(strips[i].cells.iter().flat_map(|&cell| range.colour(cell)));
    }
    pixels
}

#[cfg(test)]
mod tests {
    use super::super::super::testing::{Case, print};
    use super::super::super::{build, testing::inputs};
    use super::*;
    use crate::progress::Task;

    #[test]
    fn a_shifted_lumen_is_wide_on_one_side_and_narrow_on_the_other() {
        let mut case = Case::new(5);
        case.record = print(&case.paths);
        for s in &mut case.record.segments {
            s.from.x += 0.3;
            s.to.x += 0.3;
        }
        let report = build(&inputs(&case), &Task::quiet()).unwrap();
        let strips = strips(&report, &report.anatomy.branches[0], |p| &p.ring);
        assert_eq!(strips.len(), 5);
        assert!((strips[4].along_mm - 12.0).abs() < 0.01);
        for strip in &strips {
            let at = |degrees: usize| strip.cells[degrees * N_ANGLES / 360].unwrap();
            assert!((at(2) - 0.3).abs() < 0.03 && (at(180) + 0.3).abs() < 0.03, "{}", strip.plane);
            assert!(at(90).abs() < 0.04 && at(270).abs() < 0.04);
        }
    }

    #[test]
    fn the_rows_of_a_map_lie_on_one_another_the_highest_plane_on_top() {
        let report = build(&inputs(&Case::new(4)), &Task::quiet()).unwrap();
        let maps = maps(&report, Range { most_mm: 0.1 }, |p| &p.ring).unwrap();
        let rows = &maps[0].rows;
        assert!(rows[3].y.abs() < 1e-9 && (rows[0].y + rows[0].height - maps[0].height).abs() < 0.11);
        assert!(rows.windows(2).all(|r| (r[1].y + r[1].height - r[0].y).abs() < 0.21));
        assert!(maps[0].picture.starts_with("data:image/png;base64,"));
    }
}
