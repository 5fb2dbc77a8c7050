//! The whole job as a small shaded picture (PNG), for displays and lists of jobs.
//!
//! Parallel projection from obliquely above. Every layer is a slice of the picture's depth: in a row of pixels a layer's
//! outline, filled even-odd, lies at one depth, and the nearest counts. Light falls by the slope of the depth. Each pixel is
//! the mean of four. Same job, same bytes.

use super::Error;
use crate::draw;
use crate::geom::Point2;
use crate::progress::Task;
use crate::toolpath::{LayerPaths, Toolpaths};
use tiny_skia::{Pixmap, PremultipliedColorU8};

/// The way the camera is turned about the vertical, rad.
const YAW_RAD: f64 = 0.6;
/// How far it looks down, rad.
const PITCH_RAD: f64 = 0.45;
/// Finer pixels a pixel, along each side.
const FINER: usize = 2;
/// Share of the picture's side that stays free around the part.
const MARGIN_SHARE: f64 = 0.06;
/// Heights at which a layer is drawn lie no farther apart than this, finer pixels.
const STEP_PX: f64 = 0.5;
/// The part's colour in full light.
const COLOUR: [f64; 3] = [226.0, 106.0, 86.0];
const GROUND: [f64; 3] = [244.0, 245.0, 247.0];
/// Light from everywhere, and from the upper left of whoever looks.
const AMBIENT: f64 = 0.35;
const LIGHT: [f64; 3] = [-0.45, 0.55, -0.70];

/// Draws the job as a square of `side_px` pixels.
///
/// # Errors
/// [`Error`]: the picture cannot be encoded, or the work was interrupted.
pub fn portrait(paths: &Toolpaths, side_px: u32, task: &Task<'_>) -> Result<Vec<u8>, Error> {
    let mut scene = Scene::of(&paths.layers, side_px.clamp(8, 2048) as usize * FINER);
    for layer in &paths.layers {
        task.check()?;
        scene.draw(layer);
    }
    let canvas = scene.canvas();
    draw::encode(&canvas).map_err(|source| Error::Picture { layer: 0, source })
}

/// Depths of the nearest thing at each finer pixel, mm; infinite where there is nothing.
struct Scene {
    n: usize,
    px_per_mm: f64,
    /// The middle of what is shown: to the right and upward, mm.
    middle: [f64; 2],
    depth: Vec<f64>,
}

/// To the right, and away from whoever looks, both level.
fn turned(p: Point2) -> [f64; 2] {
    let (sin, cos) = YAW_RAD.sin_cos();
    [p.x * cos + p.y * sin, p.y * cos - p.x * sin]
}

impl Scene {
    fn of(layers: &[LayerPaths], n: usize) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for layer in layers {
            for p in layer.material.contours.iter().flat_map(|c| &c.points) {
                let [right, away] = turned(*p);
                for z in [layer.z_mm - layer.slot.height_mm, layer.z_mm] {
                    let at = [right, raised(away, z)];
                    low = [0, 1].map(|i| low[i].min(at[i]));
                    high = [0, 1].map(|i| high[i].max(at[i]));
                }
            }
        }
        let size = (high[0] - low[0]).max(high[1] - low[1]);
        let is_something = size.is_finite() && size > 0.0;
        let px_per_mm = if is_something { n as f64 * (1.0 - 2.0 * MARGIN_SHARE) / size } else { 1.0 };
        let middle = if is_something { [0, 1].map(|i| (low[i] + high[i]) / 2.0) } else { [0.0; 2] };
        Self { n, px_per_mm, middle, depth: vec![f64::INFINITY; n * n] }
    }

    fn draw(&mut self, layer: &LayerPaths) {
        let outline: Vec<Vec<[f64; 2]>> = layer
            .material
            .contours
            .iter()
            .map(|c| thinned(c.points.iter().map(|p| turned(*p)), 0.5 / self.px_per_mm))
            .collect();
        let height = layer.slot.height_mm;
        let n_steps = whole((height * self.px_per_mm / STEP_PX).ceil()).max(1);
        for k in 1..=n_steps {
            self.fill(&outline, layer.z_mm - height + height * k as f64 / n_steps as f64);
        }
    }

    /// Fills an outline at a height, row by row.
    fn fill(&mut self, outline: &[Vec<[f64; 2]>], z_mm: f64) {
        let away = outline.iter().flatten().map(|p| p[1]);
        let (near, far) =
            (away.clone().fold(f64::INFINITY, f64::min), away.fold(f64::NEG_INFINITY, f64::max));
        if !near.is_finite() {
            return;
        }
        // Rows run downward.
        let (first, last) = (self.row(raised(far, z_mm)), self.row(raised(near, z_mm)));
        let mut crossings = Vec::new();
        for row in whole(first.floor())..(whole(last.ceil()) + 1).min(self.n) {
            let up = self.middle[1] + (self.n as f64 / 2.0 - row as f64 - 0.5) / self.px_per_mm;
            let away = (up - z_mm * PITCH_RAD.cos()) / PITCH_RAD.sin();
            let depth = away * PITCH_RAD.cos() - z_mm * PITCH_RAD.sin();
            crossings.clear();
            for contour in outline {
                let ends = contour.iter().zip(contour.iter().cycle().skip(1));
                crossings.extend(
                    ends.filter(|(a, b)| (a[1] > away) != (b[1] > away))
                        .map(|(a, b)| a[0] + (b[0] - a[0]) * (away - a[1]) / (b[1] - a[1])),
                );
            }
            crossings.sort_by(f64::total_cmp);
            for span in crossings.chunks_exact(2) {
                let column = |right: f64| (right - self.middle[0]) * self.px_per_mm + self.n as f64 / 2.0;
                let (from, to) = (whole(column(span[0]).round()), whole(column(span[1]).round()).min(self.n));
                for pixel in self
                    .depth
                    .get_mut(row * self.n + from.min(self.n)..row * self.n + to)
                    .into_iter()
                    .flatten()
                {
                    *pixel = pixel.min(depth);
                }
            }
        }
    }

    fn row(&self, up: f64) -> f64 {
        self.n as f64 / 2.0 - (up - self.middle[1]) * self.px_per_mm
    }

    /// The lit picture at its own size.
    fn canvas(&self) -> Pixmap {
        let side = self.n / FINER;
        let pixels = u32::try_from(side).expect("at most 2048 pixels");
        let mut canvas = Pixmap::new(pixels, pixels).expect("8 to 2048 pixels");
        for (i, pixel) in canvas.pixels_mut().iter_mut().enumerate() {
            let (row, column) = (i / side * FINER, i % side * FINER);
            let lights: Vec<f64> =
                (0..FINER * FINER).filter_map(|k| self.light(row + k / FINER, column + k % FINER)).collect();
            let share = 1.0 / (FINER * FINER) as f64;
            let light: f64 = lights.iter().sum::<f64>() * share;
            let free = 1.0 - lights.len() as f64 * share;
            let [r, g, b] = [0, 1, 2].map(|i| byte(COLOUR[i] * light + GROUND[i] * free));
            *pixel = PremultipliedColorU8::from_rgba(r, g, b, 255).expect("opaque");
        }
        canvas
    }

    /// How bright a finer pixel is; none where there is nothing.
    fn light(&self, row: usize, column: usize) -> Option<f64> {
        let here = self.at(row, column).filter(|d| d.is_finite())?;
        let slope = |before: Option<f64>, after: Option<f64>| {
            let steps = [before.map(|d| here - d), after.map(|d| d - here)];
            // The gentler one: the other may be an edge.
            let gentler = steps
                .into_iter()
                .flatten()
                .filter(|s| s.is_finite())
                .min_by(|a, b| a.abs().total_cmp(&b.abs()));
            gentler.unwrap_or(0.0) * self.px_per_mm / REACH as f64
        };
        let beside = |by: usize, sign: bool| if sign { Some(column + by) } else { column.checked_sub(by) };
        let above = |by: usize, sign: bool| if sign { Some(row + by) } else { row.checked_sub(by) };
        let across = slope(
            beside(REACH, false).and_then(|c| self.at(row, c)),
            beside(REACH, true).and_then(|c| self.at(row, c)),
        );
        // Downward in the picture is against the direction of up.
        let upward = -slope(
            above(REACH, false).and_then(|r| self.at(r, column)),
            above(REACH, true).and_then(|r| self.at(r, column)),
        );
        let normal = [across, upward, -1.0];
        let norm = normal.iter().map(|n| n * n).sum::<f64>().sqrt();
        let length = LIGHT.iter().map(|l| l * l).sum::<f64>().sqrt();
        let cosine = normal.iter().zip(LIGHT).map(|(n, l)| n * l).sum::<f64>() / (norm * length);
        Some(AMBIENT + (1.0 - AMBIENT) * cosine.max(0.0))
    }

    fn at(&self, row: usize, column: usize) -> Option<f64> {
        (row < self.n && column < self.n).then(|| self.depth[row * self.n + column])
    }
}

/// Finer pixels over which a slope is taken: the steps of layers lie below.
const REACH: usize = 3;

/// How high in the picture, mm.
fn raised(away: f64, z_mm: f64) -> f64 {
    away * PITCH_RAD.sin() + z_mm * PITCH_RAD.cos()
}

/// The points that are farther than `step` from the one before.
fn thinned(points: impl Iterator<Item = [f64; 2]>, step: f64) -> Vec<[f64; 2]> {
    let mut kept: Vec<[f64; 2]> = Vec::new();
    for p in points {
        if kept.last().is_none_or(|k| (k[0] - p[0]).hypot(k[1] - p[1]) >= step) {
            kept.push(p);
        }
    }
    kept
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "negative and huge values go to the ends"
)]
const fn whole(value: f64) -> usize {
    value as usize
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
fn byte(value: f64) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}
