//! Parallel lines through what the perimeters leave, joined to zigzags.
//!
//! Rows are spaced so that a whole number of them fills each piece of the rest; neighbouring rows are
//! joined along the border where all of the joint stays inside, so that a piece is one path where its shape
//! allows. The direction alternates from layer to layer. A solid piece holds its volume: what the ends of its rows take of the
//! strip along the border, the joints there are the narrower by.
//!
//! What is filled how, is said by the module `interior`.

use super::BeadKind;
use super::fill::{FillParams, Path, Role, Vertex};
use crate::geom::{Contour, Point2, Region, SegmentIndex};

/// Shortest line worth printing, mm.
const SHORTEST_MM: f64 = 0.1;
/// Distance of the lines' ends from the border, in pitches. Half a pitch would leave the corners beside
/// the round ends empty; nearer, the ends and the joints along the border hold too much, which the joints give up.
const END_INSET: f64 = 0.4;
/// How far the pitch of a piece's rows may be changed to give it its volume: where that is not enough, its shape has places
/// that no line reaches, and what is missing there is not to be put elsewhere.
const MOST_CHANGE: f64 = 0.1;
/// Longest joint of two rows, in pitches of beads or, if that is longer, in those of rows.
const MOST_BEADS: f64 = 3.0;
const MOST_ROWS: f64 = 2.0;
/// A joint may run so far outside of the piece, mm: as a chord of its border does,
const OUTSIDE_MM: f64 = 0.05;
/// and is looked at in steps of this, mm: no cleft between pieces is as narrow, for the ends of rows keep off both its sides.
const PROBE_MM: f64 = 0.2;
/// Chord tolerance of the inset border, mm.
const TOLERANCE_MM: f64 = 2e-3;

/// The raster of a layer: `percent` of the rest, in the direction `angle_rad`.
pub(super) fn raster(rest: &Region, params: &FillParams, percent: f64, angle_rad: f64) -> Vec<Path> {
    if rest.is_empty() || percent <= 0.0 {
        return Vec::new();
    }
    let pitch = params.pitch_mm();
    let inset = rest.offset(-END_INSET * pitch, TOLERANCE_MM);
    let is_solid = is_solid(percent);
    let rows = Rows { params, pitch_mm: pitch * 100.0 / percent.min(100.0), is_solid, angle_rad };
    inset.islands().iter().flat_map(|piece| rows.fill(piece)).collect()
}

/// Whether a fill leaves nothing open.
pub(super) fn is_solid(percent: f64) -> bool {
    percent >= 99.9
}

struct Rows<'a> {
    params: &'a FillParams,
    pitch_mm: f64,
    is_solid: bool,
    angle_rad: f64,
}

/// The part of a row inside the piece.
#[derive(Debug, Clone, Copy)]
pub(super) struct Span {
    pub(super) from: f64,
    pub(super) to: f64,
    used: bool,
}

impl Rows<'_> {
    fn fill(&self, piece: &Region) -> Vec<Path> {
        let turn = nalgebra::Rotation2::new(-self.angle_rad);
        let turned = Region::new(
            piece
                .contours
                .iter()
                .map(|c| Contour::new(c.points.iter().map(|p| turn * p).collect()))
                .collect(),
        );
        let Some(bounds) = turned.bounds() else { return Vec::new() };
        // The outermost rows keep half a pitch from the border, as far as the piece is high enough.
        let margin = ((0.5 - END_INSET) * self.params.pitch_mm()).min(0.45 * bounds.size().y);
        let (low, high) = (bounds.min.y + margin, bounds.max.y - margin);
        let n_gaps = ((high - low) / self.pitch_mm).round();
        let pitch = if self.is_solid && n_gaps >= 1.0 { (high - low) / n_gaps } else { self.pitch_mm };
        // Sparse rows lie on one grid for all layers, so that they stand on each other.
        let start = if self.is_solid { low } else { (low / pitch).ceil() * pitch };
        let mut rows = Vec::new();
        let mut y = start;
        while y <= high + 1e-9 {
            rows.push((y, spans(&turned, y)));
            y += pitch;
        }
        let longest_mm = (MOST_BEADS * self.params.pitch_mm()).max(MOST_ROWS * pitch);
        let Some(border) = SegmentIndex::try_new(&turned.contours) else { return Vec::new() };
        let may_join = |a: Point2, b: Point2| (b - a).norm() < longest_mm && stays_inside(&border, a, b);
        let zigzags = join(&mut rows, may_join);
        let widths = if self.is_solid {
            self.widths(&zigzags, self.around_mm2(piece), pitch)
        } else {
            Widths { row_mm: self.params.width_mm, joint_mm: self.params.width_mm }
        };
        let back = turn.inverse();
        let path = |points: Vec<Point2>| Path {
            kind: if self.is_solid { BeadKind::SolidInfill } else { BeadKind::InternalInfill },
            role: Role::Raster,
            closed: false,
            vertices: widths.vertices(points.into_iter().map(|p| back * p)),
        };
        zigzags.into_iter().map(path).collect()
    }

    /// The area of which a piece is what its border leaves: grown by what that takes (Steiner's formula, which needs no more
    /// than area, perimeter and number of holes).
    fn around_mm2(&self, piece: &Region) -> f64 {
        let by_mm = END_INSET * self.params.pitch_mm();
        let perimeter_mm: f64 = piece.contours.iter().map(Contour::perimeter_mm).sum();
        let euler: f64 = piece.contours.iter().map(|c| if c.is_ccw() { 1.0 } else { -1.0 }).sum();
        piece.area_mm2() + perimeter_mm * by_mm + euler * std::f64::consts::PI * by_mm * by_mm
    }

    /// Widths with which rows of a pitch, and their joints, fill an area.
    fn widths(&self, zigzags: &[Vec<Point2>], area_mm2: f64, pitch: f64) -> Widths {
        let length = |first: usize| -> f64 {
            let steps = zigzags.iter().flat_map(|z| z[first..].chunks_exact(2));
            steps.map(|p| (p[1] - p[0]).norm()).sum()
        };
        let (rows_mm, joints_mm) = (length(0), length(1));
        let pitch = pitch.min(1.5 * self.params.pitch_mm());
        let overlap_mm = self.params.model.overlap_mm();
        let narrowest = (self.params.limits_mm[0] - overlap_mm).min(pitch);
        let joint = ((area_mm2 - pitch * rows_mm) / joints_mm.max(1e-9)).clamp(narrowest, pitch);
        let row = (area_mm2 - joint * joints_mm) / rows_mm.max(1e-9);
        let row = row.clamp((1.0 - MOST_CHANGE) * pitch, (1.0 + MOST_CHANGE) * pitch);
        Widths { row_mm: row + overlap_mm, joint_mm: joint + overlap_mm }
    }
}

/// Widths of the beads of a zigzag.
#[derive(Debug, Clone, Copy)]
struct Widths {
    row_mm: f64,
    joint_mm: f64,
}

impl Widths {
    /// The vertices of a zigzag, which begins and ends with a row; where the width changes there are two in one place.
    fn vertices(self, points: impl Iterator<Item = Point2>) -> Vec<Vertex> {
        let points: Vec<Point2> = points.collect();
        let vertex = |at, width_mm| Vertex { at, width_mm, room_mm: 0.0 };
        let row = |p: &[Point2]| [vertex(p[0], self.row_mm), vertex(p[1], self.row_mm)];
        if self.row_mm == self.joint_mm {
            return points.chunks_exact(2).flat_map(row).collect();
        }
        let joint = |p: &[Point2]| [vertex(p[0], self.joint_mm), vertex(p[1], self.joint_mm)];
        let rows = points.chunks_exact(2).map(row);
        let joints = points[1..].chunks_exact(2).map(|p| Some(joint(p))).chain([None]);
        rows.zip(joints).flat_map(|(row, joint)| row.into_iter().chain(joint.into_iter().flatten())).collect()
    }
}

/// The parts of the horizontal line at `y` that lie inside.
pub(super) fn spans(region: &Region, y: f64) -> Vec<Span> {
    let crosses = |(a, b): (Point2, Point2)| {
        ((a.y > y) != (b.y > y)).then(|| a.x + (b.x - a.x) * (y - a.y) / (b.y - a.y))
    };
    let mut x: Vec<f64> = region.contours.iter().flat_map(Contour::edges).filter_map(crosses).collect();
    x.sort_by(f64::total_cmp);
    let pairs = x.chunks_exact(2).filter(|p| p[1] - p[0] > SHORTEST_MM);
    pairs.map(|p| Span { from: p[0], to: p[1], used: false }).collect()
}

/// Walks the rows to and fro, from one span to one above it that overlaps and may be joined to it, until there is none.
fn join(rows: &mut [(f64, Vec<Span>)], may_join: impl Fn(Point2, Point2) -> bool) -> Vec<Vec<Point2>> {
    let mut paths = Vec::new();
    for first in 0..rows.len() {
        while let Some(idx) = rows[first].1.iter().position(|s| !s.used) {
            let mut path = Vec::new();
            let mut at = Some((first, idx));
            let mut forward = true;
            while let Some((row, idx)) = at {
                let (y, span) = (rows[row].0, &mut rows[row].1[idx]);
                span.used = true;
                let (from, to) = if forward { (span.from, span.to) } else { (span.to, span.from) };
                path.extend([Point2::new(from, y), Point2::new(to, y)]);
                let (low, high) = (span.from, span.to);
                forward = !forward;
                at = rows.get(row + 1).and_then(|(y_next, spans)| {
                    let next = spans.iter().position(|s| {
                        let start = Point2::new(if forward { s.from } else { s.to }, *y_next);
                        let end = Point2::new(to, y);
                        !s.used && s.from < high && s.to > low && may_join(end, start)
                    });
                    next.map(|i| (row + 1, i))
                });
            }
            paths.push(path);
        }
    }
    paths
}

/// Whether a joint lies inside all along, or at most a hair outside.
fn stays_inside(border: &SegmentIndex, a: Point2, b: Point2) -> bool {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a joint is a few rows long")]
    let n = ((b - a).norm() / PROBE_MM).ceil().max(2.0) as u32;
    let at = |i: u32| a + (b - a) * (f64::from(i) / f64::from(n));
    (1..n).map(at).all(|p| border.contains(p) || border.nearest_within(p, OUTSIDE_MM).is_some())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::BeadShape;
    use crate::toolpath::flow::BeadModel;

    const PARAMS: FillParams = FillParams {
        model: BeadModel::new(BeadShape::Rectangle, 0.2),
        width_mm: 0.45,
        limits_mm: [0.3, 0.8],
        perimeters: 1,
    };

    fn length(paths: &[Path]) -> f64 {
        let steps = |p: &Path| p.vertices.windows(2).map(|v| (v[1].at - v[0].at).norm()).sum::<f64>();
        paths.iter().map(steps).sum()
    }

    #[test]
    fn solid_square_is_one_zigzag_of_its_volume() {
        let square = [(0., 0.), (9., 0.), (9., 9.), (0., 9.)].map(|(x, y)| Point2::new(x, y));
        let square = Region::new(vec![Contour::new(square.to_vec()).resampled(60)]);
        for angle in [0.0, std::f64::consts::FRAC_PI_2] {
            let paths = raster(&square, &PARAMS, 100.0, angle);
            assert_eq!(paths.len(), 1);
            let volume = length(&paths) * paths[0].vertices[0].width_mm;
            assert!((volume / 81.0 - 1.0).abs() < 0.03, "{volume}");
        }
    }

    #[test]
    fn sparse_fill_takes_its_share() {
        let disk = Region::new(vec![Contour::circle(Point2::new(50.0, 50.0), 10.0, 200)]);
        let solid = length(&raster(&disk, &PARAMS, 100.0, 0.3));
        let sparse = raster(&disk, &PARAMS, 20.0, 0.3);
        assert!(sparse.iter().all(|p| p.kind == BeadKind::InternalInfill));
        let share = length(&sparse) / solid;
        assert!((0.17..0.32).contains(&share), "{share}");
        assert!(raster(&disk, &PARAMS, 0.0, 0.3).is_empty());
    }

    #[test]
    fn no_line_runs_across_a_slot() {
        // A comb of seven slots of 1.6 mm, as two perimeters leave it.
        let teeth = (0..7).flat_map(|k| {
            let x = 35.0 - 5.0 * f64::from(k);
            [(x + 0.8, 40.0), (x + 0.8, 5.0), (x - 0.8, 5.0), (x - 0.8, 40.0)]
        });
        let corners = [(0.0, 0.0), (40.0, 0.0), (40.0, 40.0)].into_iter().chain(teeth).chain([(0.0, 40.0)]);
        let comb = Region::new(vec![Contour::new(corners.map(|(x, y)| Point2::new(x, y)).collect())]);
        let rest = comb.offset(-0.45, 1e-3);
        let border = SegmentIndex::try_new(&rest.contours).unwrap();
        for percent in [5.0, 10.0, 20.0, 50.0, 100.0] {
            for angle in [std::f64::consts::FRAC_PI_4, -std::f64::consts::FRAC_PI_4, 0.0, 1.2] {
                let paths = raster(&rest, &PARAMS, percent, angle);
                assert!(!paths.is_empty());
                for pair in paths.iter().flat_map(|p| p.vertices.windows(2)) {
                    assert!(!border.crosses(pair[0].at, pair[1].at), "{percent} % at {angle}: {pair:?}");
                }
            }
        }
    }
}
