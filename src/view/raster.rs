//! What every sample of a picture sees: the nearest triangle and the place in it.
//!
//! Triangles are sorted into bands of rows; bands are independent of each other, and within one the triangles come in
//! their order, so that the result does not depend on the threads.

use super::{Middle, Scene};
use crate::geom::{Point2, Point3, Vector3};
use crate::progress::{Cancelled, Task};
use rayon::prelude::*;

/// Rows that a thread works on at once.
const BAND: u32 = 32;
/// Softens the change from one branch's middle to the next, mm.
const BLEND_MM: f64 = 0.5;

/// A parallel projection onto samples.
#[derive(Debug, Clone)]
pub(super) struct Camera {
    /// Unit vectors: right, up, away. Stack frame.
    pub(super) axes: [Vector3; 3],
    /// Seen at `centre`.
    pub(super) middle: Point3,
    pub(super) centre: [f64; 2],
    pub(super) samples_per_mm: f64,
    /// Width and height, samples.
    pub(super) size: [u32; 2],
}

impl Camera {
    /// Column, row (downward) and depth, samples.
    fn place(&self, p: Point3) -> [f64; 3] {
        let [x, y, z] = self.axes.map(|axis| (p - self.middle).dot(&axis) * self.samples_per_mm);
        [self.centre[0] + x, self.centre[1] - y, z]
    }
}

/// What a sample sees.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen {
    /// Samples, growing away from whoever looks; infinite where there is nothing.
    pub(super) depth: f32,
    pub(super) triangle: u32,
    /// Weights of the triangle's second and third corner.
    pub(super) weights: [f32; 2],
    /// The back of a triangle is seen only through a cut: material.
    pub(super) is_back: bool,
}

impl Seen {
    pub(super) const NOTHING: Self =
        Self { depth: f32::INFINITY, triangle: u32::MAX, weights: [0.0; 2], is_back: false };
}

/// Finds what every sample sees, row by row.
pub(super) fn raster(scene: &Scene<'_>, camera: &Camera, task: &Task<'_>) -> Result<Vec<Seen>, Cancelled> {
    let [width, height] = camera.size;
    let places: Vec<[f64; 3]> = scene.mesh.vertices.par_iter().map(|&p| camera.place(p)).collect();
    let mut bands: Vec<Vec<u32>> = vec![Vec::new(); height.div_ceil(BAND) as usize];
    for (i, t) in (0_u32..).zip(&scene.mesh.triangles) {
        let rows = t.map(|v| places[v as usize][1]);
        let band = |y: f64| {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
            let band = (y.clamp(0.0, f64::from(height - 1)) as u32 / BAND) as usize;
            band
        };
        let least = rows.into_iter().fold(f64::INFINITY, f64::min);
        let most = rows.into_iter().fold(f64::NEG_INFINITY, f64::max);
        bands[band(least)..=band(most)].iter_mut().for_each(|b| b.push(i));
    }
    let cut = scene.cut.as_ref().map(|middle| Cut { middle, camera });
    let mut seen = vec![Seen::NOTHING; width as usize * height as usize];
    let pieces = seen.par_chunks_mut((width * BAND) as usize).zip(&bands).enumerate();
    pieces.try_for_each(|(k, (rows, triangles))| {
        task.check()?;
        #[expect(clippy::cast_possible_truncation, reason = "fewer bands than rows")]
        let first_row = k as u32 * BAND;
        let mut band = Band { rows, first_row, width, cut: cut.as_ref() };
        for &i in triangles {
            let t = scene.mesh.triangles[i as usize];
            band.draw(i, t.map(|v| places[v as usize]), t.map(|v| scene.mesh.vertices[v as usize]));
        }
        Ok(())
    })?;
    Ok(seen)
}

struct Band<'a> {
    rows: &'a mut [Seen],
    first_row: u32,
    width: u32,
    cut: Option<&'a Cut<'a>>,
}

impl Band<'_> {
    fn draw(&mut self, triangle: u32, [a, b, c]: [[f64; 3]; 3], corners: [Point3; 3]) {
        let cross = |p: [f64; 3], q: [f64; 3], x: f64, y: f64| {
            (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
        };
        let area = cross(a, b, c[0], c[1]);
        if area.abs() < 1e-12 {
            return;
        }
        // Rows run downward: what is counter-clockwise from outside turns the other way here.
        let is_back = area > 0.0;
        if is_back && self.cut.is_none() {
            return;
        }
        let n_rows = self.rows.len() as f64 / f64::from(self.width);
        let first_row = f64::from(self.first_row);
        let columns = span([a[0], b[0], c[0]], 0.0, f64::from(self.width));
        let rows = span([a[1], b[1], c[1]], first_row, n_rows);
        for y in rows {
            for x in columns.clone() {
                let (px, py) = (x as f64 + 0.5, first_row + y as f64 + 0.5);
                let weights = [cross(c, a, px, py) / area, cross(a, b, px, py) / area];
                let first = 1.0 - weights[0] - weights[1];
                if first < 0.0 || weights[0] < 0.0 || weights[1] < 0.0 {
                    continue;
                }
                #[expect(clippy::cast_possible_truncation, reason = "depths of a picture")]
                let depth = (first * a[2] + weights[0] * b[2] + weights[1] * c[2]) as f32;
                let sample = &mut self.rows[y * self.width as usize + x];
                if depth >= sample.depth {
                    continue;
                }
                let at = || {
                    corners[0]
                        + (corners[1] - corners[0]) * weights[0]
                        + (corners[2] - corners[0]) * weights[1]
                };
                if self.cut.is_some_and(|cut| cut.removes(at())) {
                    continue;
                }
                #[expect(clippy::cast_possible_truncation, reason = "weights from 0 to 1")]
                let weights = weights.map(|w| w as f32);
                *sample = Seen { depth, triangle, weights, is_back };
            }
        }
    }
}

/// The samples, counted from `first`, whose middles lie between the least and the greatest of some places.
fn span(places: [f64; 3], first: f64, n: f64) -> std::ops::Range<usize> {
    let least = places.into_iter().fold(f64::INFINITY, f64::min) - first;
    let most = places.into_iter().fold(f64::NEG_INFINITY, f64::max) - first;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let index = |v: f64| v.clamp(0.0, n) as usize;
    index((least - 0.5).ceil())..index((most + 0.5).floor())
}

/// Leaves away what lies before the middle of the lumen.
struct Cut<'a> {
    middle: &'a Middle,
    camera: &'a Camera,
}

impl Cut<'_> {
    fn removes(&self, p: Point3) -> bool {
        let rows = &self.middle.rows;
        let (Some(first), Some(last)) = (rows.first(), rows.last()) else { return false };
        let away = self.camera.axes[2];
        let level = away.xy().norm();
        if level < 0.5 {
            // Seen from an end: the half towards whoever looks.
            return (p.z - 0.5 * (first.0 + last.0)) * away.z < 0.0;
        }
        let k = rows.partition_point(|r| r.0 <= p.z).clamp(1, rows.len()) - 1;
        let share =
            rows.get(k + 1).map_or(0.0, |next| ((p.z - rows[k].0) / (next.0 - rows[k].0)).clamp(0.0, 1.0));
        let next = if share > 0.0 { k + 1 } else { k };
        let beyond = |row: usize| self.beyond_middle(p.xy(), &rows[row].1) / level;
        beyond(k) * (1.0 - share) + beyond(next) * share < 0.0
    }

    /// How far a point lies beyond the branches' middles; the nearer a branch is sideways, the more it counts.
    fn beyond_middle(&self, p: Point2, branches: &[Point2]) -> f64 {
        let [right, _, away] = self.camera.axes;
        let mut sums = [0.0; 2];
        for m in branches {
            let from = p - m;
            let weight = (from.dot(&right.xy()).powi(2) + BLEND_MM * BLEND_MM).powi(-2);
            sums = [sums[0] + weight * from.dot(&away.xy()), sums[1] + weight];
        }
        if sums[1] > 0.0 { sums[0] / sums[1] } else { 1.0 }
    }
}
