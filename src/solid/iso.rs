//! Closed iso-contours of a smooth field in a plane.
//!
//! Marching squares on a grid of step `h`, visited only where a coarse grid of step 4 h says that the zero may
//! lie (the fields here are near to signed distances, so a cell whose corners are all farther than its size is
//! empty), then Newton steps onto the zero. Cost: the area / (16 h²) coarse cells and the contour's length / h
//! fine ones.

use crate::geom::{Bounds2, Contour, Point2, Vector2};
use std::collections::BTreeMap;

/// Fine cells in a coarse one.
const REFINEMENT: usize = 4;

/// An edge of the grid: its lower or left node, and whether it runs along x.
type EdgeKey = (usize, usize, bool);

struct Grid<'a> {
    field: &'a dyn Fn(Point2) -> f64,
    origin: Point2,
    step_mm: f64,
    values: BTreeMap<(usize, usize), f64>,
}

impl Grid<'_> {
    fn point(&self, i: usize, j: usize) -> Point2 {
        self.origin + Vector2::new(i as f64, j as f64) * self.step_mm
    }

    fn value(&mut self, i: usize, j: usize) -> f64 {
        if let Some(&v) = self.values.get(&(i, j)) {
            return v;
        }
        let v = (self.field)(self.point(i, j));
        self.values.insert((i, j), v);
        v
    }

    /// Where the field vanishes on an edge, by linear interpolation.
    fn crossing(&mut self, (i, j, along_x): EdgeKey) -> Point2 {
        let (k, l) = if along_x { (i + 1, j) } else { (i, j + 1) };
        let (a, b) = (self.value(i, j), self.value(k, l));
        let t = (a / (a - b)).clamp(1e-6, 1.0 - 1e-6);
        let start = self.point(i, j);
        start + (self.point(k, l) - start) * t
    }

    /// Directed pieces of the contour in a cell, the inside (negative) to the left.
    fn pieces(&mut self, i: usize, j: usize, out: &mut BTreeMap<EdgeKey, EdgeKey>) {
        let corners =
            [self.value(i, j), self.value(i + 1, j), self.value(i + 1, j + 1), self.value(i, j + 1)];
        let inside = corners.map(|v| v < 0.0);
        let edges: [EdgeKey; 4] = [(i, j, true), (i + 1, j, false), (i, j + 1, true), (i, j, false)];
        // Walking round the cell counter-clockwise, the contour leaves where it goes from inside to outside.
        let exits: Vec<usize> = (0..4).filter(|&e| inside[e] && !inside[(e + 1) % 4]).collect();
        let entries: Vec<usize> = (0..4).filter(|&e| !inside[e] && inside[(e + 1) % 4]).collect();
        match exits.len() {
            1 => {
                out.insert(edges[exits[0]], edges[entries[0]]);
            }
            2 => {
                let middle = (self.field)(self.point(i, j) + Vector2::repeat(0.5 * self.step_mm));
                for &exit in &exits {
                    // Joined through the middle: each piece cuts off an outside corner; else an inside one.
                    let step = if middle < 0.0 { 1 } else { 3 };
                    out.insert(edges[exit], edges[(exit + step) % 4]);
                }
            }
            _ => {}
        }
    }
}

/// All closed contours on which `field` vanishes, the negative side inside: outer ones counter-clockwise, holes
/// clockwise. The field must be positive on the border of `bounds`.
pub(super) fn contours(field: &dyn Fn(Point2) -> f64, bounds: Bounds2, step_mm: f64) -> Vec<Contour> {
    let mut grid = Grid { field, origin: bounds.min, step_mm, values: BTreeMap::new() };
    let mut links = BTreeMap::new();
    for (ci, cj) in active_cells(&mut grid, bounds) {
        for i in ci..ci + REFINEMENT {
            for j in cj..cj + REFINEMENT {
                grid.pieces(i, j, &mut links);
            }
        }
    }
    let mut found = Vec::new();
    while let Some((&start, _)) = links.iter().next() {
        let mut points = Vec::new();
        let mut at = start;
        while let Some(next) = links.remove(&at) {
            points.push(project(field, grid.crossing(at), step_mm));
            at = next;
        }
        if at == start && points.len() >= 4 {
            found.push(Contour::new(points));
        }
    }
    found
}

/// Lower left fine indices of the coarse cells that the zero may pass through.
fn active_cells(grid: &mut Grid<'_>, bounds: Bounds2) -> Vec<(usize, usize)> {
    let coarse_mm = grid.step_mm * REFINEMENT as f64;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "sizes of vessels over steps"
    )]
    let count = |extent: f64| (extent / coarse_mm).ceil().max(1.0) as usize;
    let (nx, ny) = (count(bounds.size().x), count(bounds.size().y));
    let mut active = Vec::new();
    for ci in 0..nx {
        for cj in 0..ny {
            let (i, j) = (ci * REFINEMENT, cj * REFINEMENT);
            let corners =
                [(i, j), (i + REFINEMENT, j), (i, j + REFINEMENT), (i + REFINEMENT, j + REFINEMENT)];
            let nearest =
                corners.map(|(a, b)| grid.value(a, b).abs()).into_iter().fold(f64::INFINITY, f64::min);
            if nearest <= 1.2 * coarse_mm {
                active.push((i, j));
            }
        }
    }
    active
}

/// Central differences of a field. The step is far above rounding and far below the vessel.
pub(super) fn gradient(field: &dyn Fn(Point2) -> f64, p: Point2) -> Vector2 {
    const H: f64 = 1e-4;
    let along = |d: Vector2| (field(p + d) - field(p - d)) / (2.0 * H);
    Vector2::new(along(Vector2::new(H, 0.0)), along(Vector2::new(0.0, H)))
}

/// Newton steps from `p` onto the zero of the field, never farther than `most_mm` in all.
pub(super) fn project(field: &dyn Fn(Point2) -> f64, start: Point2, most_mm: f64) -> Point2 {
    let mut p = start;
    for _ in 0..4 {
        let value = field(p);
        if value.abs() < 1e-9 {
            break;
        }
        let slope = gradient(field, p);
        let norm2 = slope.norm_squared();
        if norm2 < 1e-6 {
            break;
        }
        let step = slope * (value / norm2);
        p -= step * (0.5 * most_mm / step.norm().max(1e-300)).min(1.0);
        if (p - start).norm() > most_mm {
            return start;
        }
    }
    p
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_disks_and_a_hole_are_found_on_the_zero() {
        let disk = |p: Point2, x: f64, r: f64| (p - Point2::new(x, 0.3)).norm() - r;
        let field = |p: Point2| disk(p, 0.0, 2.0).max(-disk(p, 0.2, 0.8)).min(disk(p, 4.2, 1.5));
        let bounds = Bounds2 { min: Point2::new(-4.0, -4.0), max: Point2::new(8.0, 4.0) };
        let found = contours(&field, bounds, 0.11);
        assert_eq!(found.len(), 3);
        let area: f64 = found.iter().map(Contour::signed_area_mm2).sum();
        let expected = std::f64::consts::PI * (4.0 - 0.64 + 2.25);
        assert!((area - expected).abs() < 0.02, "{area} {expected}");
        assert!(found.iter().flat_map(|c| &c.points).all(|&p| field(p).abs() < 1e-8));
    }
}
