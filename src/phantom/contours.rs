//! The level lines of a vessel's section: exact closed contours, however many there are.
//!
//! Method: marching squares (Lorensen and Cline 1987 in two dimensions; ambiguous cells are decided by the field at
//! the cell's centre) on those blocks of a fine grid that the line can reach, the segments linked through the grid edges
//! they share, then every vertex moved onto the line by Newton steps along the gradient.
//!
//! Cost: about 4000 evaluations of the field a contour at the coarse step, 15 000 at the fine one.

use super::vessel::Field;
use crate::geom::{Contour, Point2};
use std::collections::BTreeMap;

/// Grid step for truth: what is narrower may be missed.
pub(super) const EXACT_STEP_MM: f64 = 0.05;
/// Grid step for images, far below what their blur leaves visible.
pub(super) const IMAGE_STEP_MM: f64 = 0.1;
/// Cells along the side of a block that is skipped or searched as a whole.
const BLOCK_CELLS: i32 = 4;
/// Fastest growth of a section's field per mm: 1 beside a round tube; ripples add a few percent, blending none.
const MAX_SLOPE: f64 = 1.3;
/// Loops of fewer grid edges are smaller than a cell and come from rounding at an extremum.
const MIN_LOOP_EDGES: usize = 4;

/// A grid edge: its lower left node and whether it runs along y.
type EdgeId = (i32, i32, bool);

/// All closed lines of `level`, `n_points` vertices each; lower values lie on the left.
pub(super) fn trace(section: &impl Field, level: f64, step_mm: f64, n_points: usize) -> Vec<Contour> {
    let grid = Grid::new(section, level, step_mm);
    let mut contours: Vec<Contour> = link(grid.segments())
        .into_iter()
        .filter(|raw| raw.len() >= MIN_LOOP_EDGES)
        .map(|raw| spaced(section, level, &raw, n_points.max(3)))
        .collect();
    contours.sort_by(|a, b| mean_x(a).total_cmp(&mean_x(b)));
    contours
}

fn mean_x(contour: &Contour) -> f64 {
    contour.points.iter().map(|p| p.x).sum::<f64>() / contour.len() as f64
}

/// The line through raw crossings as evenly spaced exact points, from the one of least x.
fn spaced(section: &impl Field, level: f64, raw: &[Point2], n_points: usize) -> Contour {
    let mut exact: Vec<Point2> = raw.iter().map(|&p| snap(section, level, p)).collect();
    let least_x = (0..exact.len()).min_by(|&a, &b| exact[a].x.total_cmp(&exact[b].x)).unwrap_or(0);
    exact.rotate_left(least_x);
    let even = Contour::new(exact).resampled(n_points);
    Contour::new(even.points.into_iter().map(|p| snap(section, level, p)).collect())
}

/// Moves a point onto the line.
fn snap(section: &impl Field, level: f64, mut p: Point2) -> Point2 {
    // A step of more than a cell would mean that the gradient vanishes nearby: creep then.
    const MAX_STEP_MM: f64 = 0.05;
    for _ in 0..20 {
        let (value, gradient) = section.jet(p);
        let step = gradient * ((value - level) / gradient.norm_squared().max(1e-9));
        p -= if step.norm() > MAX_STEP_MM { step * (MAX_STEP_MM / step.norm()) } else { step };
        if step.norm() < 1e-11 {
            break;
        }
    }
    p
}

/// A directed piece of the line within one cell, lower values on its left.
struct Segment {
    from: EdgeId,
    to: EdgeId,
    /// Where the line crosses `from`.
    start: Point2,
}

/// Joins segments end to start into closed loops of crossings.
fn link(segments: Vec<Segment>) -> Vec<Vec<Point2>> {
    let mut open: BTreeMap<EdgeId, (EdgeId, Point2)> =
        segments.into_iter().map(|s| (s.from, (s.to, s.start))).collect();
    let mut loops = Vec::new();
    while let Some((&first, _)) = open.first_key_value() {
        let mut points = Vec::new();
        let mut edge = first;
        while let Some((next, start)) = open.remove(&edge) {
            points.push(start);
            edge = next;
        }
        if edge == first {
            loops.push(points);
        }
    }
    loops
}

struct Grid<'a, F> {
    section: &'a F,
    level: f64,
    step: f64,
    origin: Point2,
    n_blocks: [i32; 2],
}

impl<'a, F: Field> Grid<'a, F> {
    fn new(section: &'a F, level: f64, step: f64) -> Self {
        let bounds = section.bounds(level);
        #[expect(clippy::cast_possible_truncation, reason = "some hundred blocks; a float cast saturates")]
        let blocks = |size: f64| (size / (step * f64::from(BLOCK_CELLS))).ceil() as i32;
        let size = bounds.size();
        Self { section, level, step, origin: bounds.min, n_blocks: [blocks(size.x), blocks(size.y)] }
    }

    /// Node (i, j), always by the same arithmetic so that neighbouring blocks agree bit for bit.
    fn node(&self, i: f64, j: f64) -> Point2 {
        Point2::new(self.origin.x + i * self.step, self.origin.y + j * self.step)
    }

    fn value(&self, p: Point2) -> f64 {
        self.section.value(p) - self.level
    }

    fn segments(&self) -> Vec<Segment> {
        let mut found = Vec::new();
        for block_j in 0..self.n_blocks[1] {
            for block_i in 0..self.n_blocks[0] {
                let (i, j) = (block_i * BLOCK_CELLS, block_j * BLOCK_CELLS);
                if self.may_hold_line(i, j) {
                    self.search_block(i, j, &mut found);
                }
            }
        }
        found
    }

    fn may_hold_line(&self, i: i32, j: i32) -> bool {
        let half = 0.5 * f64::from(BLOCK_CELLS);
        let centre = self.node(f64::from(i) + half, f64::from(j) + half);
        let reach = half * self.step * std::f64::consts::SQRT_2;
        self.value(centre).abs() <= MAX_SLOPE * reach
    }

    fn search_block(&self, i0: i32, j0: i32, found: &mut Vec<Segment>) {
        const SIDE: usize = BLOCK_CELLS as usize + 1;
        let mut values = [[0.0; SIDE]; SIDE];
        for (j, row) in (j0..).zip(&mut values) {
            for (i, value) in (i0..).zip(row) {
                *value = self.value(self.node(f64::from(i), f64::from(j)));
            }
        }
        for (j, rows) in (j0..).zip(values.windows(2)) {
            for (i, c) in (i0..).zip(0..SIDE - 1) {
                let corners = [rows[0][c], rows[0][c + 1], rows[1][c + 1], rows[1][c]];
                self.search_cell(i, j, corners, found);
            }
        }
    }

    /// Adds the segments of cell (i, j); corners and edges are numbered counter-clockwise from the lower left,
    /// edge e from corner e to the next. A segment starts where an edge leaves the lower side and ends where one
    /// enters it.
    fn search_cell(&self, i: i32, j: i32, corners: [f64; 4], found: &mut Vec<Segment>) {
        let inside = corners.map(|v| v < 0.0);
        let is_leaving = |e: usize| inside[e] && !inside[(e + 1) % 4];
        let is_entering = |e: usize| !inside[e] && inside[(e + 1) % 4];
        let n_leaving = (0..4).filter(|&e| is_leaving(e)).count();
        for e in (0..4).filter(|&e| is_leaving(e)) {
            let end = match n_leaving {
                1 => (0..4).find(|&o| is_entering(o)).expect("what leaves must enter"),
                _ if self.is_inside_at_centre(i, j) => (e + 1) % 4,
                _ => (e + 3) % 4,
            };
            let start = self.crossing(i, j, e, corners[e], corners[(e + 1) % 4]);
            found.push(Segment { from: edge_id(i, j, e), to: edge_id(i, j, end), start });
        }
    }

    fn is_inside_at_centre(&self, i: i32, j: i32) -> bool {
        self.value(self.node(f64::from(i) + 0.5, f64::from(j) + 0.5)) < 0.0
    }

    fn crossing(&self, i: i32, j: i32, edge: usize, from: f64, to: f64) -> Point2 {
        let corner = |c: usize| {
            let (di, dj) = [(0, 0), (1, 0), (1, 1), (0, 1)][c % 4];
            self.node(f64::from(i + di), f64::from(j + dj))
        };
        let (a, b) = (corner(edge), corner(edge + 1));
        a + (b - a) * (from / (from - to))
    }
}

fn edge_id(i: i32, j: i32, edge: usize) -> EdgeId {
    [(i, j, false), (i + 1, j, true), (i, j + 1, false), (i, j, true)][edge]
}
