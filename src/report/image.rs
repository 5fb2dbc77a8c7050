//! Grey values to the boundary of the lumen in the image, found without the segmentation's help: its contours say
//! only where to look.
//!
//! Along the normal of each contour point the grey values are read (bilinear), averaged over about a pixel along
//! the contour, and the steepest fall from lumen to surroundings is sought. From there the profile is followed
//! to both sides until it stops rising or falling; the means of what is then level are the plateaus, and the
//! boundary is where the profile passes half-way between them (full width at half maximum, the usual measure of
//! vessel width in CT). Blur s draws that place inward by s² k / 2 where the boundary has the curvature k (the
//! first-order effect of a Gaussian on a curved edge); s follows from the steepness of the edges, k from the contour,
//! and the place is moved back. A point is skipped and counted where the fall is much weaker or
//! stronger than usual, runs out of the searched range or stands out among its neighbours.
//!
//! A wall that is hardly thicker than the blur shows no level of its own ([`wall`](super::wall)): the profiles of a contour,
//! laid over one another at their crossings, say together how high it is, and the boundary is where the profile is
//! half-way to it.
//!
//! Limits: a vessel narrower than three times the blur shows no plateau and is measured too wide; noise moves a point by
//! about noise / slope.

use super::Image;
use super::deviation::Outline;
use super::wall::{Behind, Wall};
use crate::ct::Volume;
use crate::geom::{Contour, Point2, Region, Vector2};
use rayon::prelude::*;
use std::borrow::Cow;

/// Whether the lumen is brighter or darker than its surroundings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Polarity {
    /// Contrast agent in the lumen.
    Bright,
    /// A phantom or specimen whose wall is brighter.
    Dark,
}

/// What the image shows of the lumen's boundary in one plane.
#[derive(Debug, Clone, Default)]
pub(super) struct ImageBoundary {
    /// The boundary; vertices that were not found bridge the gap between their neighbours.
    pub(super) outline: Outline,
    /// Places searched.
    pub(super) n_points: usize,
    /// Places where a boundary was found.
    pub(super) n_found: usize,
    /// Grey values inside and outside of the boundary, where it was found.
    pub(super) levels_hu: Vec<[f64; 2]>,
    /// What each contour shows of its wall.
    pub(super) walls: Vec<Behind>,
}

/// Where the profile of one contour point crosses, relative to the contour, and its plateaus.
#[derive(Debug, Clone, Copy)]
pub(super) struct Edge {
    pub(super) offset_mm: f64,
    /// Levels of the lumen and of what surrounds it; those of a dark lumen have their sign changed.
    pub(super) top: f64,
    pub(super) bottom: f64,
    /// Standard deviation of the blur that makes an edge this steep, mm.
    pub(super) blur_mm: f64,
}

/// Grey values along a normal, from inside to outside, as far as they belong to the contour; lumen bright.
#[derive(Debug, Clone)]
pub(super) struct Scan {
    values: Vec<f64>,
    /// The index of the contour.
    centre: usize,
    step_mm: f64,
}

impl Scan {
    /// The value at a distance outward of the contour, linear between the samples; `None` beyond them.
    pub(super) fn at(&self, d_mm: f64) -> Option<f64> {
        let x = d_mm / self.step_mm + self.centre as f64;
        if x < 0.0 {
            return None;
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "not below zero")]
        let j = x as usize;
        let (a, b) = (self.values.get(j)?, self.values.get(j + 1)?);
        Some(a + (b - a) * x.fract())
    }

    /// Where the falling values pass `level`, nearest to `from_mm`, mm outward of the contour.
    pub(super) fn crossing_mm(&self, from_mm: f64, level: f64) -> Option<f64> {
        let from = from_mm / self.step_mm + self.centre as f64;
        let passes = |j: &usize| self.values[*j] >= level && self.values[j + 1] < level;
        let within = |j: usize| (self.values[j] - level) / (self.values[j] - self.values[j + 1]);
        let places = (0..self.values.len() - 1).filter(passes).map(|j| j as f64 + within(j));
        let nearest = places.min_by(|a, b| (a - from).abs().total_cmp(&(b - from).abs()))?;
        Some((nearest - self.centre as f64) * self.step_mm)
    }
}

/// A plane of the volume, where it has one, and the contours there.
pub(super) type Searched<'a> = (Option<usize>, &'a [Contour]);

/// Finds the boundary near the contours of all planes.
pub(super) fn boundaries(image: Image<'_>, planes: &[Searched<'_>]) -> Vec<Option<ImageBoundary>> {
    let of = |&(plane, contours): &Searched<'_>, usual| Some(boundary(image, plane?, contours, usual));
    let found: Vec<Option<ImageBoundary>> = planes.par_iter().map(|plane| of(plane, None)).collect();
    let Some(usual) = Wall::usual(found.iter().flatten().flat_map(|f| &f.walls)) else { return found };
    let is_hidden = |found: &ImageBoundary| found.walls.iter().any(|behind| usual.is_hidden(behind));
    let again = |(found, plane): (Option<ImageBoundary>, &Searched<'_>)| {
        if found.as_ref().is_some_and(is_hidden) { of(plane, Some(usual)) } else { found }
    };
    found.into_par_iter().zip(planes).map(again).collect()
}

/// Finds the boundary near the contours of plane `k` of the volume; `usual` is the wall of the others.
pub(super) fn boundary(
    image: Image<'_>,
    k: usize,
    contours: &[Contour],
    usual: Option<Wall>,
) -> ImageBoundary {
    let search = Search::new(image, k, contours, usual);
    let mut found = ImageBoundary::default();
    let mut measured = Vec::new();
    for contour in contours.iter().filter(|c| c.len() >= 3 && c.perimeter_mm() > 0.0) {
        let Traced { boundary, flags, edges, behind } = search.contour(contour);
        found.n_points += flags.len();
        found.n_found += edges.len();
        found.levels_hu.extend(edges.iter().map(|e| [search.sign * e.top, search.sign * e.bottom]));
        found.walls.extend(behind);
        // A contour of which next to nothing is seen gives no outline at all.
        if 4 * edges.len() >= flags.len() {
            found.outline.region.contours.push(boundary);
            measured.push(flags);
        }
    }
    found.outline.measured = Some(measured);
    found
}

/// The boundary along one contour, which of its points were found, and what was found there.
struct Traced {
    boundary: Contour,
    flags: Vec<bool>,
    edges: Vec<Edge>,
    behind: Option<Behind>,
}

struct Search<'a> {
    plane: Plane<'a>,
    contours: &'a [Contour],
    sign: f64,
    pixel_mm: f64,
    step_mm: f64,
    /// Steps to each side of the contour within which the boundary is sought.
    reach: usize,
    /// Steps to each side that are read: a plateau may lie beyond the reach.
    half: usize,
    /// The wall of the other contours.
    usual: Option<Wall>,
}

impl<'a> Search<'a> {
    fn new(image: Image<'a>, k: usize, contours: &'a [Contour], usual: Option<Wall>) -> Self {
        let Image { volume, polarity } = image;
        let [sx, sy] = volume.pixel_spacing_xy_mm;
        let pixel_mm = 0.5 * (sx + sy);
        let step_mm = sx.min(sy) / 5.0;
        // Far enough for a contour that is three pixels or a millimetre off.
        let reach_mm = (3.5 * pixel_mm).max(1.2);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few dozen steps")]
        let reach = (reach_mm / step_mm).ceil().min(200.0) as usize;
        let sign = if polarity == Polarity::Bright { 1.0 } else { -1.0 };
        Self {
            plane: Plane::new(volume, k),
            contours,
            sign,
            pixel_mm,
            step_mm,
            reach,
            half: 2 * reach,
            usual,
        }
    }

    fn contour(&self, contour: &Contour) -> Traced {
        let spacing_mm = (0.5 * self.pixel_mm).clamp(0.05, 0.5);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let n = (contour.perimeter_mm() / spacing_mm).ceil().clamp(12.0, 4096.0) as usize;
        let points = contour.resampled(n).points;
        let spacing_mm = contour.perimeter_mm() / n as f64;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few points")]
        let pixel_points = ((self.pixel_mm / spacing_mm).round() as usize).clamp(1, n / 4);
        let normals: Vec<Vector2> = (0..n).map(|i| outward(&points, i, pixel_points)).collect();
        let profiles: Vec<Vec<f64>> =
            points.iter().zip(&normals).map(|(&p, &normal)| self.profile(p, normal)).collect();
        let smoothed = averaged_round(&profiles, pixel_points);
        let scans: Vec<Option<Scan>> =
            (0..n).map(|i| self.scan(&smoothed[i], self.limits(points[i], normals[i]))).collect();
        let edges: Vec<Option<Edge>> = scans.iter().map(|s| s.as_ref().and_then(|s| self.edge(s))).collect();
        let edges = without_outliers(&edges, 3 * pixel_points, self.pixel_mm);
        let behind = median(edges.iter().flatten().map(|e| e.bottom))
            .map(|seen| Behind { seen, wall: Wall::behind(&scans, &edges, self.step_mm) });
        let usual = self.usual.filter(|usual| behind.is_some_and(|b| usual.is_hidden(&b)));
        let edges = match behind.and_then(|b| b.wall).or(usual) {
            Some(wall) => wall.edges(&scans, &edges),
            None => edges,
        };
        let blur_mm = median(edges.iter().flatten().map(|e| e.blur_mm)).unwrap_or(0.0);
        let offsets = bridged(&edges);
        let moved = (0..n).map(|i| {
            let back = drawn_inward_mm(blur_mm, curvature_per_mm(&points, i, 3 * pixel_points));
            points[i] + normals[i] * (offsets[i] + back)
        });
        let moved = moved.collect();
        let flags = edges.iter().map(Option::is_some).collect();
        Traced { boundary: Contour::new(moved), flags, edges: edges.into_iter().flatten().collect(), behind }
    }

    fn profile(&self, p: Point2, normal: Vector2) -> Vec<f64> {
        let at = |j: usize| (j as f64 - self.half as f64) * self.step_mm;
        (0..=2 * self.half).map(|j| self.plane.bilinear(p + normal * at(j))).collect()
    }

    /// How many steps may be gone inward and outward: to half-way across the lumen, or to the next contour.
    fn limits(&self, p: Point2, normal: Vector2) -> [usize; 2] {
        let most = self.half as f64 * self.step_mm;
        let steps = |direction: Vector2| {
            let free = first_crossing(self.contours, p, direction).map_or(most, |d| 0.5 * d);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most half")]
            let n = (free.min(most) / self.step_mm) as usize;
            n
        };
        [steps(-normal), steps(normal)]
    }

    /// The part of a profile of which `limits` steps to each side may be used; where the image ends, it does.
    fn scan(&self, hu: &[f64], limits: [usize; 2]) -> Option<Scan> {
        let (lo, hi) = (self.half - limits[0].min(self.half), self.half + limits[1].min(self.half));
        let lo = (lo..=self.half).rev().take_while(|&j| !hu[j].is_nan()).last()?;
        let hi = (self.half..=hi).take_while(|&j| !hu[j].is_nan()).last()?;
        let values = hu[lo..=hi].iter().map(|v| self.sign * v).collect();
        Some(Scan { values, centre: self.half - lo, step_mm: self.step_mm })
    }

    /// The crossing of one profile.
    fn edge(&self, scan: &Scan) -> Option<Edge> {
        let g = &scan.values;
        let steepest = self.steepest(g, scan.centre)?;
        let inward: Vec<f64> = g[..=steepest].iter().rev().copied().collect();
        let outward: Vec<f64> = g[steepest..].iter().map(|v| -v).collect();
        let (top, bottom) = (plateau(&inward)?, -plateau(&outward)?);
        let steepest_mm = (steepest as f64 - scan.centre as f64) * self.step_mm;
        let offset_mm = scan.crossing_mm(steepest_mm, 0.5 * (top + bottom))?;
        let slope = (g[steepest - 1] - g[steepest + 1]) / (2.0 * self.step_mm);
        // The edge of a Gaussian blur falls steepest with contrast / (s sqrt(2 pi)).
        let blur_mm = (top - bottom) / (slope * std::f64::consts::TAU.sqrt());
        Some(Edge { offset_mm, top, bottom, blur_mm })
    }

    /// The step of the steepest fall, near ones preferred; `None` where nothing falls.
    fn steepest(&self, g: &[f64], centre: usize) -> Option<usize> {
        let fall = |j: usize| {
            let away = 2.0 * j.abs_diff(centre) as f64 / self.reach as f64;
            (g[j - 1] - g[j + 1]) / (1.0 + away * away)
        };
        let within =
            centre.saturating_sub(self.reach).max(1)..(centre + self.reach + 1).min(g.len().max(1) - 1);
        within.max_by(|&a, &b| fall(a).total_cmp(&fall(b))).filter(|&j| fall(j) > 0.0)
    }
}

/// Bilinear grey values of a plane; NaN outside.
pub(super) struct Plane<'a> {
    hu: Cow<'a, [f32]>,
    n_cols: usize,
    n_rows: usize,
    origin: Point2,
    pixel_mm: [f64; 2],
}

impl<'a> Plane<'a> {
    pub(super) fn new(volume: &'a Volume, k: usize) -> Self {
        let [x, y] = volume.origin_xy_mm;
        Self {
            hu: volume.plane(k),
            n_cols: volume.dims[0],
            n_rows: volume.dims[1],
            origin: Point2::new(x, y),
            pixel_mm: volume.pixel_spacing_xy_mm,
        }
    }

    /// Columns and rows whose pixels lie in a box, and one more to each side.
    pub(super) fn pixels_within(&self, min: Point2, size_mm: [f64; 2]) -> [std::ops::Range<usize>; 2] {
        let range = |from_mm: f64, length_mm: f64, pixel_mm: f64, n: usize| {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "clamped to the image"
            )]
            let clamped = |x: f64| x.clamp(0.0, n as f64) as usize;
            clamped((from_mm / pixel_mm - 0.5).floor())
                ..clamped(((from_mm + length_mm) / pixel_mm).ceil() + 2.0)
        };
        let from = min - self.origin;
        [
            range(from.x, size_mm[0], self.pixel_mm[0], self.n_cols),
            range(from.y, size_mm[1], self.pixel_mm[1], self.n_rows),
        ]
    }

    /// Where a pixel begins, stack frame.
    pub(super) fn pixel_corner(&self, col: usize, row: usize) -> Point2 {
        let [dx, dy] = self.pixel_mm;
        self.origin + Vector2::new((col as f64 - 0.5) * dx, (row as f64 - 0.5) * dy)
    }

    /// Distances of neighbouring columns and rows, mm.
    pub(super) const fn pixel_mm(&self) -> [f64; 2] {
        self.pixel_mm
    }

    /// A pixel's value.
    pub(super) fn at(&self, col: usize, row: usize) -> f64 {
        f64::from(self.hu[row * self.n_cols + col])
    }

    pub(super) fn bilinear(&self, p: Point2) -> f64 {
        match (self.column(p.x), self.row(p.y)) {
            (Some(column), Some(row)) => self.value(column, row),
            _ => f64::NAN,
        }
    }

    /// The columns beside a place; `None` outside.
    pub(super) fn column(&self, x_mm: f64) -> Option<Between> {
        Between::of((x_mm - self.origin.x) / self.pixel_mm[0], self.n_cols)
    }

    /// The rows beside a place; `None` outside.
    pub(super) fn row(&self, y_mm: f64) -> Option<Between> {
        Between::of((y_mm - self.origin.y) / self.pixel_mm[1], self.n_rows)
    }

    /// Linear between the four pixels.
    pub(super) fn value(&self, column: Between, row: Between) -> f64 {
        let along = |j: usize| {
            let at = |i: usize| f64::from(self.hu[j * self.n_cols + i]);
            at(column.low) * (1.0 - column.part) + at(column.high) * column.part
        };
        along(row.low) * (1.0 - row.part) + along(row.high) * row.part
    }
}

/// A place between two neighbours of a row of pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Between {
    low: usize,
    high: usize,
    /// How far it lies from `low` to `high`, 0 to 1.
    part: f64,
}

impl Between {
    fn of(place: f64, n: usize) -> Option<Self> {
        if !(place >= 0.0 && place <= (n - 1) as f64) {
            return None;
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside the grid")]
        let low = place as usize;
        Some(Self { low, high: (low + 1).min(n - 1), part: place - low as f64 })
    }
}

/// The unit normal that points out of the lumen: to the right of the contour, whether outer or hole.
pub(super) fn outward(points: &[Point2], i: usize, span: usize) -> Vector2 {
    let n = points.len();
    let along = points[(i + span) % n] - points[(i + n - span) % n];
    let right = Vector2::new(along.y, -along.x);
    let length = right.norm();
    if length > 0.0 { right / length } else { Vector2::zeros() }
}

/// Curvature of the contour over `span` points to each side, 1/mm: positive where the lumen is convex.
pub(super) fn curvature_per_mm(points: &[Point2], i: usize, span: usize) -> f64 {
    let n = points.len();
    let span = span.min(n / 6).max(1);
    let (before, at, after) = (points[(i + n - span) % n], points[i], points[(i + span) % n]);
    let (a, b) = (at - before, after - at);
    let length = 0.5 * (a.norm() + b.norm());
    if length > 0.0 { a.perp(&b).atan2(a.dot(&b)) / length } else { 0.0 }
}

/// How far blur draws the half-way place of a curved edge toward the centre of curvature, mm; the first-order formula
/// is trusted up to a quarter of the blur.
pub(super) fn drawn_inward_mm(blur_mm: f64, curvature_per_mm: f64) -> f64 {
    (0.5 * blur_mm * blur_mm * curvature_per_mm).clamp(-0.25 * blur_mm, 0.25 * blur_mm)
}

/// Distance to the first contour that a ray meets after a tenth of a millimetre.
fn first_crossing(contours: &[Contour], p: Point2, direction: Vector2) -> Option<f64> {
    let hit = |(a, b): (Point2, Point2)| {
        let edge = b - a;
        let turn = direction.perp(&edge);
        if turn.abs() < 1e-12 {
            return None;
        }
        let along = (a - p).perp(&edge) / turn;
        let on_edge = (a - p).perp(&direction) / turn;
        (along > 0.1 && (0.0..=1.0).contains(&on_edge)).then_some(along)
    };
    contours.iter().flat_map(Contour::edges).filter_map(hit).min_by(f64::total_cmp)
}

/// Means of every profile with its neighbours round the closed contour, `n` to each side.
fn averaged_round(profiles: &[Vec<f64>], n: usize) -> Vec<Vec<f64>> {
    let len = profiles.len();
    let mean = |i: usize, j: usize| {
        let sum: f64 = (0..=2 * n).map(|d| profiles[(i + len + d - n) % len][j]).sum();
        sum / (2 * n + 1) as f64
    };
    (0..len).map(|i| (0..profiles[i].len()).map(|j| mean(i, j)).collect()).collect()
}

/// The level that values climb to before they fall again; `None` where they do not climb.
///
/// The climb goes on over dips of less than a tenth of what was climbed (noise); the level is the mean of the
/// visited values little below the top, so that it is neither the peak of the noise nor what lies beyond a thin wall.
fn plateau(values: &[f64]) -> Option<f64> {
    let start = values[0];
    let mut top = start;
    let mut end = 0;
    for (i, &v) in values.iter().enumerate() {
        top = top.max(v);
        if v < top - 0.1 * (top - start) - f64::EPSILON {
            break;
        }
        end = i;
    }
    let level: Vec<f64> =
        values[..=end].iter().copied().filter(|&v| v >= top - 0.03 * (top - start)).collect();
    (top > start).then(|| level.iter().sum::<f64>() / level.len() as f64)
}

/// Drops edges that are much weaker than usual, much stronger (a thin layer of tissue before air or bone), or stand out
/// from the median of their neighbours, `n` to each side.
fn without_outliers(edges: &[Option<Edge>], n: usize, pixel_mm: f64) -> Vec<Option<Edge>> {
    let contrast = |e: &Edge| e.top - e.bottom;
    let Some(usual) = median(edges.iter().flatten().map(contrast)) else { return edges.to_vec() };
    let strong: Vec<Option<Edge>> =
        edges.iter().map(|e| e.filter(|e| (0.35 * usual..=1.6 * usual).contains(&contrast(e)))).collect();
    let len = edges.len();
    (0..len)
        .map(|i| {
            let around = (0..=2 * n).filter_map(|d| strong[(i + len * (1 + n / len) + d - n) % len]);
            let middle = median(around.map(|e| e.offset_mm))?;
            strong[i].filter(|e| (e.offset_mm - middle).abs() <= 0.75 * pixel_mm)
        })
        .collect()
}

/// Offsets of all points: those that were not found lie on the line between their found neighbours.
fn bridged(edges: &[Option<Edge>]) -> Vec<f64> {
    let n = edges.len();
    let found = |i: usize| edges[i % n].map(|e| e.offset_mm);
    (0..n)
        .map(|i| {
            let after = (0..n).find_map(|d| found(i + d).map(|o| (d as f64, o)));
            let before = (0..n).find_map(|d| found(i + n - d).map(|o| (d as f64, o)));
            match (before, after) {
                (Some((0.0, o)), _) | (Some((_, o)), None) | (None, Some((_, o))) => o,
                (Some((db, ob)), Some((da, oa))) => (ob * da + oa * db) / (da + db),
                (None, None) => 0.0,
            }
        })
        .collect()
}

/// The median; `None` of nothing.
pub(super) fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    (!values.is_empty()).then(|| super::deviation::quantile(&values, 0.5))
}

/// The region that the found boundary encloses, for areas and pictures.
impl ImageBoundary {
    /// The outline as a region; empty where nothing was found.
    pub(super) fn region(&self) -> &Region {
        &self.outline.region
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ct::Voxels;
    use crate::report::deviation::{Figures, compare};
    use crate::report::testing::blurred_cylinder;

    fn bias(volume: &Volume, contour_radius: f64, polarity: Polarity) -> (Figures, ImageBoundary) {
        let contours = vec![Contour::circle(Point2::origin(), contour_radius, 128)];
        let found = boundary(Image { volume, polarity }, 0, &contours, None);
        let contours: Outline = Region::new(contours).into();
        (Figures::of(std::iter::once(&compare(&found.outline, &contours).unwrap())), found)
    }

    #[test]
    fn the_boundary_of_a_blurred_cylinder_is_found_wherever_the_contour_lies() {
        for polarity in [Polarity::Bright, Polarity::Dark] {
            let volume = blurred_cylinder(polarity, 3.0, 1, 0.0);
            for off in [-0.5, -0.3, 0.0, 0.3, 0.5] {
                let (f, found) = bias(&volume, 3.0 + off, polarity);
                assert_eq!(found.n_found, found.n_points);
                assert!((f.bias_mm.unwrap() - off).abs() < 0.012, "{polarity:?} {off}: {f:?}");
            }
        }
    }

    #[test]
    fn noise_moves_it_little() {
        let volume = blurred_cylinder(Polarity::Bright, 3.0, 1, 20.0);
        let (f, found) = bias(&volume, 3.2, Polarity::Bright);
        assert!(found.n_found * 10 >= found.n_points * 9);
        assert!((f.bias_mm.unwrap() - 0.2).abs() < 0.03 && f.p95_mm.unwrap() < 0.3, "{f:?}");
    }

    /// Changes the pixels of the first plane by their places.
    fn change(volume: &mut Volume, by: impl Fn(Point2, &mut f32)) {
        let n = volume.dims[0];
        let mut hu: Vec<f32> = volume.hu.iter().collect();
        for (at, hu) in hu.iter_mut().enumerate().take(n * volume.dims[1]) {
            by(volume.stack_from_voxel((at % n) as f64, (at / n) as f64, 0).xy(), hu);
        }
        volume.hu = Voxels::new(&hu, n * volume.dims[1]);
    }

    #[test]
    fn where_no_edge_is_nothing_is_found() {
        let mut volume = blurred_cylinder(Polarity::Bright, 3.0, 1, 0.0);
        change(&mut volume, |_, hu| *hu = 40.0);
        let contours = [Contour::circle(Point2::origin(), 3.0, 64)];
        let found = boundary(Image { volume: &volume, polarity: Polarity::Bright }, 0, &contours, None);
        assert!(found.n_found == 0 && found.n_points > 0 && found.outline.region.is_empty());
    }

    #[test]
    fn air_behind_a_thin_layer_of_tissue_is_not_taken_for_the_boundary() {
        let mut volume = blurred_cylinder(Polarity::Bright, 3.0, 1, 0.0);
        change(&mut volume, |p, hu| {
            if p.x > 3.7 {
                *hu = -800.0;
            }
        });
        let (f, found) = bias(&volume, 3.0, Polarity::Bright);
        assert!(found.n_found < found.n_points && f.max_mm.unwrap() < 0.1, "{f:?}");
    }

    #[test]
    fn a_missing_stretch_is_skipped_and_bridged() {
        let mut volume = blurred_cylinder(Polarity::Bright, 3.0, 1, 0.0);
        change(&mut volume, |p, hu| {
            // Something as bright as the lumen lies against it over 40 degrees.
            if p.x > 0.0 && p.y.atan2(p.x).abs() < 0.35 && p.x < 8.0 {
                *hu = 300.0;
            }
        });
        let (f, found) = bias(&volume, 3.0, Polarity::Bright);
        assert!(found.n_found < found.n_points && found.n_found * 10 > found.n_points * 8);
        assert!(f.p95_mm.unwrap() < 0.1, "{f:?}");
    }
}
