//! Plane regions and blur on a pixel grid, by exact area coverage.
//!
//! Method: signed area accumulation, as font rasterisers do it: each edge of a polygon adds, in the pixels it
//! passes, the area to its right; a running sum along the row then gives every pixel's covered share exactly. The sum is
//! linear, so any number of polygons with weights go into one canvas. The blur is a separable Gaussian, cut off at
//! four standard deviations and normalised.

use super::{Contour, Point2};

/// Where the pixels of an image lie, mm. Pixel (0, 0) is centred on `origin`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PixelGrid {
    pub(crate) origin: Point2,
    /// Size of a pixel along x and y.
    pub(crate) pixel_mm: [f64; 2],
}

impl PixelGrid {
    /// Column and row of a point, whole numbers at the pixels' centres.
    pub(crate) fn position(&self, p: Point2) -> [f64; 2] {
        [(p.x - self.origin.x) / self.pixel_mm[0], (p.y - self.origin.y) / self.pixel_mm[1]]
    }
}

/// A rectangle of pixels: first column, first row, columns, rows; may reach beyond the image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Window {
    pub(crate) first: [i64; 2],
    pub(crate) size: [usize; 2],
}

/// Weighted area coverage, in the making.
#[derive(Debug)]
pub(crate) struct Canvas {
    window: Window,
    grid: PixelGrid,
    /// Per row one column more than the window: what lies beyond its right border goes there.
    sums: Vec<f64>,
}

impl Canvas {
    pub(crate) fn new(grid: PixelGrid, window: Window) -> Self {
        Self { window, grid, sums: vec![0.0; (window.size[0] + 2) * window.size[1]] }
    }

    /// Adds `weight` times the share of each pixel that the contours enclose (holes run clockwise).
    pub(crate) fn add(&mut self, contours: &[Contour], weight: f64) {
        for contour in contours {
            for (a, b) in contour.edges() {
                let (a, b) = (self.pixel(a), self.pixel(b));
                self.add_edge(a, b, weight);
            }
        }
    }

    /// Position on the canvas in pixels, 0 at the window's outer corner.
    fn pixel(&self, p: Point2) -> Point2 {
        let [x, y] = self.grid.position(p);
        Point2::new(x + 0.5 - self.window.first[0] as f64, y + 0.5 - self.window.first[1] as f64)
    }

    fn add_edge(&mut self, a: Point2, b: Point2, weight: f64) {
        let (low, high, sign) = if a.y < b.y { (a, b, -weight) } else { (b, a, weight) };
        let height = self.window.size[1] as f64;
        let (y0, y1) = (low.y.max(0.0), high.y.min(height));
        if y0 >= y1 {
            return;
        }
        let x_at = |y: f64| low.x + (high.x - low.x) * ((y - low.y) / (high.y - low.y));
        let mut y = y0;
        while y < y1 {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "within the window's rows"
            )]
            let row = y as usize;
            let next = (row as f64 + 1.0).min(y1);
            self.add_in_row(row, [x_at(y), x_at(next)], sign * (next - y));
            y = next;
        }
    }

    /// Adds a piece of an edge within one row, running from one x to another over `cover` of the row's height.
    fn add_in_row(&mut self, row: usize, x: [f64; 2], cover: f64) {
        let stride = self.window.size[0] + 2;
        let width = self.window.size[0] as f64;
        let sums = &mut self.sums[row * stride..(row + 1) * stride];
        let (left, right) = (x[0].min(x[1]), x[0].max(x[1]));
        let share =
            |from: f64, to: f64| if right > left { cover * (to - from) / (right - left) } else { cover };
        // What lies left of the window covers its first pixel wholly, what lies right of it covers nothing.
        if left < 0.0 {
            sums[0] += share(left, right.min(0.0));
        }
        if right <= 0.0 && left < 0.0 {
            return;
        }
        let end = right.min(width);
        let mut at = left.max(0.0);
        loop {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0..=width")]
            let column = (at as usize).min(self.window.size[0]);
            let next = (column as f64 + 1.0).min(end);
            let part = if right > left { share(at, next.max(at)) } else { cover };
            let in_pixel = 0.5 * (at + next.max(at)) - column as f64;
            sums[column] += part * (1.0 - in_pixel).max(0.0);
            sums[column + 1] += part * in_pixel.min(1.0);
            if next >= end {
                return;
            }
            at = next;
        }
    }

    /// The window's image without blur, row by row.
    pub(crate) fn into_coverage(self) -> Vec<f64> {
        let [width, height] = self.window.size;
        let mut image = Vec::with_capacity(width * height);
        for row in self.sums.chunks_exact(width + 2) {
            let mut sum = 0.0;
            image.extend(row[..width].iter().map(|d| {
                sum += d;
                sum
            }));
        }
        image
    }

    /// The blurred image of the window, row by row.
    pub(crate) fn into_image(self, blur_sigma_mm: f64) -> Vec<f64> {
        let (width, pixel_mm) = (self.window.size[0], self.grid.pixel_mm);
        blurred(&self.into_coverage(), width, pixel_mm.map(|p| blur_sigma_mm / p))
    }
}

/// An image under a Gaussian with the given standard deviations along x and y, pixels; black beyond its border.
pub(crate) fn blurred(image: &[f64], width: usize, sigma_pixels: [f64; 2]) -> Vec<f64> {
    let [kx, ky] = sigma_pixels.map(gaussian);
    blur_columns(&blur_rows(image, width, &kx), width, &ky)
}

/// The same, where what lies beyond the border or is no number does not count; what is no number stays so.
pub(crate) fn blurred_within(image: &[f64], width: usize, sigma_pixels: [f64; 2]) -> Vec<f64> {
    let known = |of: fn(f64) -> f64| -> Vec<f64> {
        let value = |v: &f64| if v.is_finite() { of(*v) } else { 0.0 };
        blurred(&image.iter().map(value).collect::<Vec<f64>>(), width, sigma_pixels)
    };
    let (sums, weights) = (known(|v| v), known(|_| 1.0));
    let mean = |((s, w), v): ((f64, f64), &f64)| if v.is_finite() { s / w } else { *v };
    sums.into_iter().zip(weights).zip(image).map(mean).collect()
}

/// Pixels that the blur reaches beyond an edge.
pub(crate) fn blur_reach(blur_sigma_mm: f64, pixel_mm: f64) -> usize {
    gaussian(blur_sigma_mm / pixel_mm).len() / 2
}

fn gaussian(sigma_pixels: f64) -> Vec<f64> {
    #[expect(clippy::cast_possible_truncation, reason = "parameters are checked: some hundred at most")]
    let reach = (4.0 * sigma_pixels).ceil() as i32;
    if reach == 0 {
        return vec![1.0];
    }
    let raw: Vec<f64> =
        (-reach..=reach).map(|i| (-0.5 * (f64::from(i) / sigma_pixels).powi(2)).exp()).collect();
    let sum: f64 = raw.iter().sum();
    raw.into_iter().map(|v| v / sum).collect()
}

fn blur_rows(image: &[f64], width: usize, kernel: &[f64]) -> Vec<f64> {
    let reach = kernel.len() / 2;
    let mut out = vec![0.0; image.len()];
    for (row, out) in image.chunks_exact(width).zip(out.chunks_exact_mut(width)) {
        for (tap, w) in kernel.iter().enumerate() {
            // Value i + tap - reach goes to i, as far as both are in the row.
            let (to, from) = (reach.saturating_sub(tap), tap.saturating_sub(reach));
            let n = width.saturating_sub(to + from);
            if n > 0 {
                out[to..to + n].iter_mut().zip(&row[from..from + n]).for_each(|(o, v)| *o += v * w);
            }
        }
    }
    out
}

fn blur_columns(image: &[f64], width: usize, kernel: &[f64]) -> Vec<f64> {
    let height = image.len() / width.max(1);
    let reach = kernel.len() / 2;
    let mut out = vec![0.0; image.len()];
    for (j, out) in out.chunks_exact_mut(width).enumerate() {
        let first = j.saturating_sub(reach);
        let last = (j + reach + 1).min(height);
        for (r, w) in (first..last).zip(&kernel[first + reach - j..]) {
            let row = &image[r * width..(r + 1) * width];
            out.iter_mut().zip(row).for_each(|(o, v)| *o += v * w);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn canvas(size: [usize; 2]) -> Canvas {
        let grid = PixelGrid { origin: Point2::new(0.5, 0.5), pixel_mm: [1.0; 2] };
        Canvas::new(grid, Window { first: [0, 0], size })
    }

    fn square(x0: f64, y0: f64, side: f64) -> Contour {
        let corners = [(x0, y0), (x0 + side, y0), (x0 + side, y0 + side), (x0, y0 + side)];
        Contour::new(corners.map(|(x, y)| Point2::new(x, y)).to_vec())
    }

    #[test]
    fn a_square_covers_its_pixels_by_their_share() {
        let mut c = canvas([4, 3]);
        c.add(&[square(0.5, 0.25, 2.0)], 10.0);
        let rows = [[3.75, 7.5, 3.75, 0.0], [5.0, 10.0, 5.0, 0.0], [1.25, 2.5, 1.25, 0.0]];
        let image = c.into_image(0.0);
        assert!(image.iter().zip(rows.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-12), "{image:?}");
    }

    #[test]
    fn what_lies_beyond_the_window_is_cut_off() {
        let mut c = canvas([3, 3]);
        c.add(&[square(-5.0, -5.0, 7.5)], 1.0);
        let row = [1.0, 1.0, 0.5];
        let expected: Vec<f64> = [1.0, 1.0, 0.5].iter().flat_map(|y| row.map(|x| x * y)).collect();
        let image = c.into_image(0.0);
        assert!(image.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-12), "{image:?}");
    }

    #[test]
    fn holes_are_left_out() {
        let mut c = canvas([6, 6]);
        c.add(&[square(0.0, 0.0, 6.0), square(2.0, 2.0, 2.0).reversed()], 1.0);
        let image = c.into_image(0.0);
        assert!((image.iter().sum::<f64>() - 32.0).abs() < 1e-12);
        assert!(image[2 * 6 + 3].abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn coverage_sums_to_the_area_and_blur_keeps_it(
            x in 9.0..11.0, y in 9.0..11.0, r in 0.05..4.0, n in 3usize..60, sigma in 0.0..1.2,
        ) {
            let circle = Contour::circle(Point2::new(x, y), r, n);
            let mut c = canvas([20, 20]);
            c.add(std::slice::from_ref(&circle), 1.0);
            let image = c.into_image(sigma);
            prop_assert!((image.iter().sum::<f64>() - circle.signed_area_mm2()).abs() < 1e-9 + 1e-3 * f64::from(sigma > 0.0));
            prop_assert!(image.iter().all(|&v| v > -1e-9 && v < 1.0 + 1e-9));
        }
    }
}
