//! Contours of a segmentation made elsewhere, through the same door as those found in an image.
//!
//! A label map becomes curves between its pixels (`outline`); contours are taken as they are drawn. Neither is ever moved by grey
//! values. The topology over the planes is resolved by the rules of `consistency`, each change reported, and points are spaced
//! evenly, as for every other contour.

use super::consistency::{self, Loop, Origin, Plane};
use super::curve::{evenly_spaced, n_points_for, smoothed_closed};
use super::extract::{Error, Extracted, MOST_POINTS, Params};
use super::fit::{are_simple, ordered};
use super::outline::outlines;
use super::warnings::SectionWarnings;
use super::{PlaneSections, SectionStack};
use crate::geom::{Contour, Point2, RigidTransform};
use crate::progress::{Cancelled, Task};
use rayon::prelude::*;
use std::ops::Range;

/// Points per pixel of a curve between pixels while it is rounded.
const POINTS_PER_PIXEL: f64 = 3.0;
/// Standard deviation of the last rounding, pixels: it takes the corners off, not more.
const ROUNDING_PIXELS: f64 = 0.5;

/// The contours of one plane before the topology is resolved.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawn {
    /// Height of the plane in the stack frame, mm.
    pub z_mm: f64,
    /// Outer contours counter-clockwise, holes clockwise, none crossing; mm.
    pub contours: Vec<Contour>,
}

/// A stack of them.
#[derive(Debug, Clone, PartialEq)]
pub struct DrawnStack {
    /// Planes in ascending order of z.
    pub planes: Vec<Drawn>,
    /// Where the stack lies in the patient.
    pub patient_from_stack: RigidTransform,
    /// What a pixel of it is: smaller things are no structures, mm.
    pub pixel_mm: [f64; 2],
    /// Whether the contours are curves between pixels, which have no corners of their own.
    pub are_outlines: bool,
}

/// The curves around the true pixels of a plane, x fastest; cost and memory are those of the box around them. Mm in the frame in which the first pixel's centre is `origin_mm`.
#[must_use]
pub fn outlines_mm(inside: &[bool], n_cols: usize, origin_mm: [f64; 2], pixel_mm: [f64; 2]) -> Vec<Contour> {
    let Some([cols, rows]) = boxed(inside, n_cols) else { return Vec::new() };
    // A frame of one pixel closes all curves.
    let (width, height) = (cols.len() + 2, rows.len() + 2);
    let mut framed = vec![false; width * height];
    for (j, row) in rows.clone().enumerate() {
        framed[(j + 1) * width + 1..][..cols.len()].copy_from_slice(&inside[row * n_cols..][cols.clone()]);
    }
    let first = [cols.start as f64 - 1.0, rows.start as f64 - 1.0];
    let to_mm = |p: [f64; 2]| {
        let [x, y] = [0, 1].map(|axis| origin_mm[axis] + (first[axis] + p[axis]) * pixel_mm[axis]);
        Point2::new(x, y)
    };
    let loops = outlines(&framed, width, height);
    loops.into_iter().map(|l| Contour::new(l.into_iter().map(to_mm).collect())).collect()
}

/// Columns and rows from the first to the last true pixel; `None` where there is none.
fn boxed(inside: &[bool], n_cols: usize) -> Option<[Range<usize>; 2]> {
    let mut found: Option<[Range<usize>; 2]> = None;
    for (j, row) in inside.chunks_exact(n_cols.max(1)).enumerate() {
        let Some(first) = row.iter().position(|&v| v) else { continue };
        let end = row.iter().rposition(|&v| v).map_or(first, |last| last) + 1;
        found = Some(match found {
            None => [first..end, j..j + 1],
            Some([cols, rows]) => [cols.start.min(first)..cols.end.max(end), rows.start..j + 1],
        });
    }
    found
}

/// Resolves the topology over the planes and spaces the points evenly.
///
/// # Errors
/// [`Error`]: parameters out of range, fewer than two planes left, cancellation.
pub fn from_drawn(drawn: DrawnStack, params: &Params, task: &Task<'_>) -> Result<Extracted, Error> {
    params.check()?;
    let mut warnings = SectionWarnings::default();
    let [sx, sy] = drawn.pixel_mm;
    let mut planes: Vec<Plane> = drawn.planes.into_iter().enumerate().map(plane).collect();
    consistency::resolve(&mut planes, sx * sy, &mut warnings);
    let planes = consistency::without_empty_ends(planes, &mut warnings)?;
    let finish = Finish { params, pixel_mm: sx.min(sy), are_outlines: drawn.are_outlines };
    let finished = |plane: &Plane| {
        task.check()?;
        Ok(PlaneSections { z_mm: plane.z_mm, contours: finish.plane(plane) })
    };
    let sections: Result<Vec<PlaneSections>, Cancelled> = planes.par_iter().map(finished).collect();
    let stack = SectionStack { planes: sections?, patient_from_stack: drawn.patient_from_stack };
    Ok(Extracted { stack, warnings: warnings.into_warnings() })
}

fn plane((k, drawn): (usize, Drawn)) -> Plane {
    let loops = drawn.contours.into_iter().map(|contour| Loop { contour, origin: Origin::Image });
    Plane { k, z_mm: drawn.z_mm, loops: loops.collect() }
}

/// The last step: evenly spaced points.
struct Finish<'a> {
    params: &'a Params,
    pixel_mm: f64,
    are_outlines: bool,
}

impl Finish<'_> {
    fn plane(&self, plane: &Plane) -> Vec<Contour> {
        let rounded: Vec<Contour> = plane.loops.iter().map(|l| self.rounded(l)).collect();
        if are_simple(&rounded) {
            return ordered(rounded);
        }
        ordered(plane.loops.iter().map(|l| self.as_drawn(&l.contour)).collect())
    }

    fn rounded(&self, l: &Loop) -> Contour {
        if !self.are_outlines || l.origin == Origin::Made {
            return self.as_drawn(&l.contour);
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let n = (l.contour.perimeter_mm() / self.pixel_mm * POINTS_PER_PIXEL).clamp(64.0, 4096.0) as usize;
        let dense = l.contour.resampled(n);
        let area = dense.signed_area_mm2();
        let coords: Vec<_> = dense.points.iter().map(|p| p.coords).collect();
        let step_mm = dense.perimeter_mm() / n as f64;
        let kernel = super::curve::gaussian(ROUNDING_PIXELS * self.pixel_mm / step_mm);
        let smooth = Contour::new(smoothed_closed(&coords, &kernel).into_iter().map(Point2::from).collect());
        // Rounding a closed curve shrinks it a little: the area is given back.
        let scale = (area / smooth.signed_area_mm2()).abs().sqrt();
        let middle = smooth.centroid();
        let points: Vec<Point2> = smooth.points.iter().map(|p| middle + (p - middle) * scale).collect();
        let Params { chord_tolerance_mm, least_points, .. } = *self.params;
        evenly_spaced(&points, n_points_for(&points, chord_tolerance_mm, least_points, MOST_POINTS))
    }

    /// The polygon itself, from its leftmost vertex.
    fn as_drawn(&self, contour: &Contour) -> Contour {
        let mut points = contour.points.clone();
        let leftmost = (0..points.len())
            .min_by(|&a, &b| points[a].x.total_cmp(&points[b].x).then(points[a].y.total_cmp(&points[b].y)));
        points.rotate_left(leftmost.unwrap_or(0));
        // Corners between two points are cut by less than a quarter of their distance.
        let n = (4 * points.len()).clamp(self.params.least_points, MOST_POINTS);
        Contour::new(points).resampled(n)
    }
}
