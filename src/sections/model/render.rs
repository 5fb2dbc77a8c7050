//! What a plane would show if its contours were true: covered area, averaged over the slab, blurred.

use super::harmonics::Circle;
use super::ring::{Course, Outline};
use crate::ct::Volume;
use crate::geom::raster::{Canvas, PixelGrid, Window, blurred};
use crate::geom::{Contour, Point2, Vector2};
use crate::sections::curve::normals;

/// Heights within a slab: the mean of so many differs from the slab's by a hundredth of its second-order part.
const SLAB_SAMPLES: usize = 6;
/// A blurred edge is over beyond this many standard deviations.
pub(super) const EDGE_REACH: f64 = 4.0;

/// The pixels of a view, and where they are.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lattice {
    grid: PixelGrid,
    window: Window,
}

impl Lattice {
    pub(super) fn pixel_mm2(&self) -> f64 {
        self.grid.pixel_mm[0] * self.grid.pixel_mm[1]
    }

    /// Centre of pixel p.
    pub(super) fn centre(&self, p: usize) -> Point2 {
        let ([first_x, first_y], [width, _]) = (self.window.first, self.window.size);
        let [i, j] = [first_x as f64 + (p % width) as f64, first_y as f64 + (p / width) as f64];
        let [dx, dy] = self.grid.pixel_mm;
        Point2::new(self.grid.origin.x + i * dx, self.grid.origin.y + j * dy)
    }
}

/// The image around the contours of one plane; lumen bright.
#[derive(Debug, Clone)]
pub(super) struct View {
    pub(super) place: Lattice,
    pub(super) values: Vec<f32>,
}

/// Blur of the scanner and thickness of the wall, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::sections) struct Optics {
    pub(in crate::sections) blur_mm: f64,
    pub(in crate::sections) wall_mm: f64,
}

/// Blurred shares of every pixel of a view.
#[derive(Debug, Clone)]
pub(super) struct Shares {
    /// Covered by the lumen of each body.
    pub(super) lumen: Vec<Vec<f64>>,
    /// Covered by lumen or wall.
    pub(super) vessel: Vec<f64>,
}

impl Shares {
    /// Covered by any lumen.
    pub(super) fn total(&self) -> Vec<f64> {
        let mut total = vec![0.0; self.vessel.len()];
        for body in &self.lumen {
            total.iter_mut().zip(body).for_each(|(t, b)| *t += b);
        }
        total
    }

    /// The body that shows most in every pixel.
    pub(super) fn owners(&self) -> Vec<usize> {
        let most = |p: usize| {
            let of = |b: &usize| self.lumen[*b][p];
            (0..self.lumen.len()).reduce(|a, b| if of(&b) > of(&a) { b } else { a }).unwrap_or(0)
        };
        (0..self.vessel.len()).map(most).collect()
    }
}

impl View {
    /// The pixels within `margin_mm` of the points; `None` where the image has none of them.
    pub(super) fn of(
        volume: &Volume,
        k: usize,
        sign: f64,
        contours: &[Contour],
        margin_mm: f64,
    ) -> Option<Self> {
        let bounds =
            contours.iter().filter_map(Contour::bounds).reduce(crate::geom::Bounds2::union)?.grown(margin_mm);
        let [ox, oy] = volume.origin_xy_mm;
        let grid = PixelGrid { origin: Point2::new(ox, oy), pixel_mm: volume.pixel_spacing_xy_mm };
        let (low, high) = (grid.position(bounds.min), grid.position(bounds.max));
        let [nx, ny, _] = volume.dims;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the image")]
        let range = |low: f64, high: f64, n: usize| {
            let last = (n - 1) as f64;
            low.floor().clamp(0.0, last) as usize..high.ceil().clamp(0.0, last) as usize + 1
        };
        let (columns, rows) = (range(low[0], high[0], nx), range(low[1], high[1], ny));
        let plane = volume.plane(k);
        let sign = if sign < 0.0 { -1.0_f32 } else { 1.0 };
        let mut values = Vec::with_capacity(columns.len() * rows.len());
        for j in rows.clone() {
            values.extend(plane[j * nx..][columns.clone()].iter().map(|v| sign * v));
        }
        let first = [i64::try_from(columns.start).ok()?, i64::try_from(rows.start).ok()?];
        let window = Window { first, size: [columns.len(), rows.len()] };
        Some(Self { place: Lattice { grid, window }, values })
    }

    /// Of no pixel.
    pub(super) fn empty() -> Self {
        let grid = PixelGrid { origin: Point2::origin(), pixel_mm: [1.0; 2] };
        let window = Window { first: [0; 2], size: [1; 2] };
        Self { place: Lattice { grid, window }, values: vec![f32::NAN] }
    }

    pub(super) fn pixel_mm2(&self) -> f64 {
        self.place.pixel_mm2()
    }

    /// Variance of the place within a pixel, as blur, mm²: the mean over both directions.
    pub(super) fn pixel_blur_mm2(&self) -> f64 {
        let [x, y] = self.place.grid.pixel_mm;
        (x * x + y * y) / 24.0
    }

    pub(super) fn blurred(&self, image: &[f64], blur_mm: f64) -> Vec<f64> {
        blurred(image, self.place.window.size[0], self.place.grid.pixel_mm.map(|p| blur_mm / p))
    }

    /// Slope along x and y, and sum of the second derivatives, per mm and mm².
    pub(super) fn derivatives(&self, image: &[f64]) -> (Vec<Vector2>, Vec<f64>) {
        let [w, h] = self.place.window.size;
        let [dx, dy] = self.place.grid.pixel_mm;
        let at = |i: usize, j: usize| image[j * w + i];
        let of = |p: usize| {
            let (i, j) = (p % w, p / w);
            let (l, r) = (at(i.saturating_sub(1), j), at((i + 1).min(w - 1), j));
            let (d, u) = (at(i, j.saturating_sub(1)), at(i, (j + 1).min(h - 1)));
            let slope = Vector2::new((r - l) / (2.0 * dx), (u - d) / (2.0 * dy));
            let c = at(i, j);
            (slope, (r + l - 2.0 * c) / (dx * dx) + (u + d - 2.0 * c) / (dy * dy))
        };
        (0..image.len()).map(of).unzip()
    }

    /// Bilinear interpolation of an image of the view; its border goes on outside.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the window")]
    pub(super) fn at(&self, image: &[f64], p: Point2) -> f64 {
        let [w, h] = self.place.window.size;
        let [x, y] = self.place.grid.position(p);
        let within = |v: f64, first: i64, n: usize| (v - first as f64).clamp(0.0, (n - 1) as f64);
        let (x, y) = (within(x, self.place.window.first[0], w), within(y, self.place.window.first[1], h));
        let (i, j) = (x as usize, y as usize);
        let (u, v) = (x - i as f64, y - j as f64);
        let (i1, j1) = ((i + 1).min(w - 1), (j + 1).min(h - 1));
        let row = |j: usize| image[j * w + i] * (1.0 - u) + image[j * w + i1] * u;
        row(j) * (1.0 - v) + row(j1) * v
    }

    /// Renders the plane's bodies, each a set of slabs: the same contour at several heights.
    pub(super) fn render(&self, bodies: &[Vec<Slab>], optics: Optics) -> Shares {
        let n_pixels = self.values.len();
        let n_samples = bodies.iter().flatten().map(|s| s.sections.len()).max().unwrap_or(1);
        let mut lumen = vec![vec![0.0; n_pixels]; bodies.len()];
        let mut vessel = vec![0.0; n_pixels];
        for s in 0..n_samples {
            let covers: Vec<Vec<f64>> = bodies.iter().map(|b| self.coverage(b, s, None)).collect();
            let outer: Vec<Vec<f64>> =
                bodies.iter().map(|b| self.coverage(b, s, Some(optics.wall_mm))).collect();
            // Bodies that meet within the slab are one there: nothing is covered twice.
            let (sum, outer) = (summed(&covers, n_pixels), summed(&outer, n_pixels));
            for (lumen, cover) in lumen.iter_mut().zip(&covers) {
                for ((l, c), sum) in lumen.iter_mut().zip(cover).zip(&sum) {
                    *l += 1.0 / (n_samples as f64 * sum.max(1.0)) * c;
                }
            }
            for ((vessel, outer), sum) in vessel.iter_mut().zip(outer).zip(sum) {
                *vessel += outer.max(sum).clamp(0.0, 1.0) / n_samples as f64;
            }
        }
        let lumen = lumen.iter().map(|l| self.blurred(l, optics.blur_mm)).collect();
        Shares { lumen, vessel: self.blurred(&vessel, optics.blur_mm) }
    }

    fn coverage(&self, body: &[Slab], sample: usize, grown_mm: Option<f64>) -> Vec<f64> {
        let mut canvas = Canvas::new(self.place.grid, self.place.window);
        for slab in body {
            let points = &slab.sections[sample % slab.sections.len()];
            // A hole hardly wider than the wall has no room for tissue.
            let contour = match grown_mm {
                Some(_) if slab.is_hole && slab.radius_mm < 1.5 * grown_mm.unwrap_or(0.0) => continue,
                Some(by) => {
                    let by = if slab.is_hole { -by } else { by };
                    points.iter().zip(normals(points)).map(|(p, n)| p + n * by).collect()
                }
                None => points.clone(),
            };
            let weight = if slab.is_hole { -1.0 } else { 1.0 };
            canvas.add(&[Contour::new(contour)], weight);
        }
        canvas.into_coverage()
    }
}

/// Images of so many pixels as one.
fn summed(images: &[Vec<f64>], n_pixels: usize) -> Vec<f64> {
    let mut sum = vec![0.0; n_pixels];
    for image in images {
        sum.iter_mut().zip(image).for_each(|(s, v)| *s += v);
    }
    sum
}

/// A contour at all heights within a slab, counter-clockwise.
#[derive(Debug, Clone)]
pub(super) struct Slab {
    pub(super) sections: Vec<Vec<Point2>>,
    pub(super) is_hole: bool,
    pub(super) radius_mm: f64,
}

impl Slab {
    pub(super) fn of(outline: &Outline, course: Option<&Course>, slab_mm: f64, circle: &Circle) -> Self {
        match outline {
            Outline::Fixed(contour) | Outline::Held(_, contour) => {
                let is_hole = !contour.is_ccw();
                let points = if is_hole { contour.reversed().points } else { contour.points.clone() };
                let radius_mm = (contour.signed_area_mm2().abs() / std::f64::consts::PI).sqrt();
                Self { sections: vec![points], is_hole, radius_mm }
            }
            Outline::Free(ring) => {
                let (here, radius_mm) = (ring.points(circle), ring.mean_radius_mm());
                let height = |s: usize| slab_mm * ((s as f64 + 0.5) / SLAB_SAMPLES as f64 - 0.5);
                let sections = match course {
                    Some(c) => (0..SLAB_SAMPLES).map(|s| c.at(&here, height(s), radius_mm)).collect(),
                    None => vec![here],
                };
                Self { sections, is_hole: ring.is_hole, radius_mm }
            }
        }
    }
}
