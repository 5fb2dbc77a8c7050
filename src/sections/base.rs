//! The first contours: the window's edge as an iso-line of the grey values, restricted to the mask.
//!
//! What lies in the window's range but not in the mask (a neighbouring vessel, bone, calcification above the
//! window) is pushed below the level, so that it is never joined: the line then runs half-way between the
//! mask's pixel and the foreign one.

use super::march::Grid;
use crate::ct::Volume;
use crate::geom::{Contour, Point2, raster};
use crate::segment::Segmentation;
use std::ops::Range;

/// Contours of plane k in the stack frame, mm: outer ones counter-clockwise, holes clockwise.
pub(super) fn contours(volume: &Volume, segmentation: &Segmentation, k: usize) -> Vec<Contour> {
    let Some((columns, rows)) = segmentation.mask.plane_box(k) else { return Vec::new() };
    let (sign, edge_hu) = (segmentation.sign(), segmentation.edge_hu_at(k));
    let patch = Patch::of(volume, segmentation.smoothing_mm, [&columns, &rows], k);
    let above = |i: usize, j: usize| sign * (patch.at(i, j) - edge_hu);
    let inside = |i: usize, j: usize| segmentation.mask.contains(i, j, k);
    let depth = typical_depth(
        columns.clone().flat_map(|i| rows.clone().filter(move |&j| inside(i, j)).map(move |j| above(i, j))),
    );
    let value = |i: usize, j: usize| match (inside(i, j), above(i, j)) {
        // A value exactly at the edge belongs to the mask; zero would not.
        (true, v) => v.max(1e-6 * depth),
        (false, v) if v >= 0.0 => -depth,
        // A gap in the values must not become a gap in the contour.
        (false, v) if v.is_finite() => v,
        (false, _) => -depth,
    };
    // A frame of one pixel closes all loops. The mask keeps off the border of the image, so it exists.
    let grid = Grid {
        n_cols: columns.len() + 2,
        n_rows: rows.len() + 2,
        values: (rows.start - 1..=rows.end)
            .flat_map(|j| (columns.start - 1..=columns.end).map(move |i| (i, j)))
            .map(|(i, j)| value(i, j))
            .collect(),
    };
    let to_mm = |[x, y]: [f64; 2]| {
        let p = volume.stack_from_voxel((columns.start - 1) as f64 + x, (rows.start - 1) as f64 + y, k);
        Point2::new(p.x, p.y)
    };
    grid.loops().into_iter().map(|l| Contour::new(l.into_iter().map(to_mm).collect())).collect()
}

/// The values around a box and one pixel beyond it, as the region was grown in them.
struct Patch {
    first: [usize; 2],
    width: usize,
    values: Vec<f64>,
}

impl Patch {
    fn of(volume: &Volume, smoothing_mm: f64, [columns, rows]: [&Range<usize>; 2], k: usize) -> Self {
        let [nx, ny, _] = volume.dims;
        let pixel_mm = volume.pixel_spacing_xy_mm;
        let grown = |r: &Range<usize>, d: usize, n: usize| {
            let reach = raster::blur_reach(smoothing_mm, pixel_mm[d]) + 1;
            r.start.saturating_sub(reach)..(r.end + reach).min(n)
        };
        let (columns, rows) = (grown(columns, 0, nx), grown(rows, 1, ny));
        let pixels = rows.clone().flat_map(|j| columns.clone().map(move |i| (i, j)));
        let values: Vec<f64> = pixels.map(|(i, j)| f64::from(volume.at(i, j, k))).collect();
        let values = if smoothing_mm > 0.0 {
            raster::blurred_within(&values, columns.len(), pixel_mm.map(|p| smoothing_mm / p))
        } else {
            values
        };
        Self { first: [columns.start, rows.start], width: columns.len(), values }
    }

    fn at(&self, i: usize, j: usize) -> f64 {
        self.values[(j - self.first[1]) * self.width + i - self.first[0]]
    }
}

/// Mean height of the mask's pixels above the level, never zero.
fn typical_depth(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = values.fold((0.0, 0.0), |(sum, n), v| (sum + v, n + 1.0));
    if n > 0.0 { (sum / n).max(1e-3) } else { 1.0 }
}
