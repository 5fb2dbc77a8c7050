//! A contour moved to where the image has the lumen's edge.
//!
//! The grey values are sampled along the contour's normals (cubic convolution: Keys, IEEE Trans. ASSP 29, 1981)
//! and averaged along the contour, which is straight in these coordinates: noise goes, the contour does not
//! shrink. On each averaged profile the boundary is where the grey value falls through the level nearest to
//! the contour; the contour moves there, smoothly, and the whole is repeated.
//!
//! Blur displaces the half level of a curved edge towards the centre of curvature by s² k / 2 (Bouma et al.,
//! "Correction for the dislocation of curved surfaces caused by the PSF in 2D and 3D CT images", IEEE Trans.
//! PAMI 27, 2005), s being the blur's standard deviation, which the sharpest edges of the stack tell.

mod snake;

pub(super) use snake::{Fall, snake};

use super::curve::{curvatures, gaussian, normals, smoothed_closed};
use super::denoise::Spectrum;
use super::edge::{Edge, Profile};
use crate::ct::Volume;
use crate::geom::{Contour, Point2, Vector2};
use std::borrow::Cow;

/// Points per pixel along the contour, samples per pixel along the normals.
const POINTS_PER_PIXEL: f64 = 2.0;
const SAMPLES_PER_PIXEL: f64 = 4.0;
/// How far the profiles reach to either side, pixels.
const REACH_PIXELS: f64 = 7.0;
/// How far the boundary may lie from the first contour, pixels.
const LIMIT_PIXELS: f64 = 3.0;
/// Beyond this many standard deviations of the blur a profile tells nothing about the edge.
const REACH_BLURS: f64 = 5.0;
/// What is smoothed away of a first contour, pixels: its steps; and at most this share of its radius, so that what is smoothed stays
/// short against its round.
const SMOOTHED: [f64; 2] = [1.5, 0.4];
/// The same of a contour that an edge is measured on: the noise that it follows too. It may lose its details, for it is not the result.
const ROUGH: [f64; 2] = [5.0, 0.5];
/// How far a boundary may move at most, as a share of its radius: farther it would meet itself.
const LIMIT_RADII: f64 = 0.35;
const LEAST_POINTS: usize = 48;
const MOST_POINTS: usize = 4096;
const N_ROUNDS: usize = 3;

/// One plane of the image, ready for smooth sampling; lumen bright.
pub(super) struct Image<'a> {
    volume: &'a Volume,
    plane: Cow<'a, [f32]>,
    sign: f64,
}

impl<'a> Image<'a> {
    pub(super) fn new(volume: &'a Volume, k: usize, sign: f64) -> Self {
        Self { volume, plane: volume.plane(k), sign }
    }

    /// Side of a square pixel of the same area, mm.
    pub(super) fn pixel_mm(&self) -> f64 {
        self.volume.pixel_mm()
    }

    /// Signed value at a point of the stack frame; beyond the border the outermost pixels go on.
    fn at(&self, p: Point2) -> f64 {
        let [sx, sy] = self.volume.pixel_spacing_xy_mm;
        let [ox, oy] = self.volume.origin_xy_mm;
        let [nx, ny, _] = self.volume.dims;
        let (i, wx) = taps((p.x - ox) / sx);
        let (j, wy) = taps((p.y - oy) / sy);
        let within = |c: i64, n: usize| usize::try_from(c - 1).ok().filter(|first| first + 4 <= n);
        let rows: [[f32; 4]; 4] = match (within(i, nx), within(j, ny)) {
            (Some(first), Some(row)) => {
                let from = &self.plane[row * nx + first..];
                std::array::from_fn(|o| {
                    *from[o * nx..].first_chunk().expect("all four pixels lie in the row")
                })
            }
            _ => [-1, 0, 1, 2].map(|o| neighbours(&self.plane[pixel(j + o, ny) * nx..][..nx], i)),
        };
        let mut sum = 0.0;
        for (w, values) in wy.into_iter().zip(rows) {
            sum += w * (0..4).map(|c| wx[c] * f64::from(values[c])).sum::<f64>();
        }
        self.sign * sum
    }
}

/// The index of the pixel, or of the border's pixel where it lies beyond.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the pixels")]
fn pixel(i: i64, n: usize) -> usize {
    i.clamp(0, n as i64 - 1) as usize
}

/// The values of pixels i - 1 .. i + 2; the border goes on outside.
fn neighbours(row: &[f32], i: i64) -> [f32; 4] {
    [-1, 0, 1, 2].map(|o| row[pixel(i + o, row.len())])
}

/// The pixel at or below a position on a line, and the weights of it, of the one before it and the two behind it.
#[expect(clippy::cast_possible_truncation, reason = "far outside any image lies the border")]
fn taps(x: f64) -> (i64, [f64; 4]) {
    let cut = x.clamp(-1e9, 1e9) as i64;
    let base = cut - i64::from(cut as f64 > x);
    let t = x - base as f64;
    let (t2, t3) = (t * t, t * t * t);
    let weights = [
        0.5 * (-t + 2.0 * t2 - t3),
        0.5 * (2.0 - 5.0 * t2 + 3.0 * t3),
        0.5 * (t + 4.0 * t2 - 3.0 * t3),
        0.5 * (t3 - t2),
    ];
    (base, weights)
}

/// A contour as evenly spaced points on the way to the boundary.
#[derive(Debug, Clone)]
pub(super) struct Curve {
    pub(super) points: Vec<Point2>,
    /// How far each point has been moved from the first contour, mm, outward positive.
    moved_mm: Vec<f64>,
    spacing_mm: f64,
    /// Radius of the circle of the same area, mm.
    radius_mm: f64,
    /// Details shorter than this are smoothed away.
    pub(super) smoothing_mm: f64,
}

impl Curve {
    /// The contour with its pixel steps smoothed away.
    pub(super) fn new(contour: &Contour, pixel_mm: f64) -> Self {
        Self::smoothed(contour, pixel_mm, SMOOTHED)
    }

    /// The contour, its rough shape only. To measure an edge: a curve that follows the noise would find the
    /// edge sharper than it is, because it crosses where the noise makes it steep.
    fn rough(contour: &Contour, pixel_mm: f64) -> Self {
        Self::smoothed(contour, pixel_mm, ROUGH)
    }

    /// `pixels` of it are smoothed away, and no more than a share of its radius.
    fn smoothed(contour: &Contour, pixel_mm: f64, [pixels, radii]: [f64; 2]) -> Self {
        let length_mm = contour.perimeter_mm();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let n = (POINTS_PER_PIXEL * length_mm / pixel_mm).ceil().clamp(0.0, 1e6) as usize;
        let n = n.clamp(LEAST_POINTS, MOST_POINTS);
        let spacing_mm = length_mm / n as f64;
        let radius_mm = (contour.signed_area_mm2().abs() / std::f64::consts::PI).sqrt();
        let smoothing_mm = (pixels * pixel_mm).min(radii * radius_mm);
        let steps: Vec<Vector2> = contour.resampled(n).points.iter().map(|p| p.coords).collect();
        let smooth = smoothed_closed(&steps, &gaussian(smoothing_mm / spacing_mm));
        let points = smooth.into_iter().map(Point2::from).collect();
        Self { points, moved_mm: vec![0.0; n], spacing_mm, radius_mm, smoothing_mm }
    }

    pub(super) fn contour(&self) -> Contour {
        Contour::new(self.points.clone())
    }

    fn kernel(&self, length_mm: f64) -> Vec<f64> {
        gaussian(length_mm / self.spacing_mm)
    }

    /// The mean of the profiles of all points, as far as the lumen reaches.
    fn mean_profile(&self, image: &Image<'_>) -> Profile {
        let pixel_mm = image.pixel_mm();
        let reach_mm = (REACH_PIXELS * pixel_mm).min(self.radius_mm.max(2.0 * pixel_mm));
        self.profiles(image, Averaging::None, reach_mm).mean()
    }

    /// Grey values along the normals up to a distance on either side.
    fn profiles(&self, image: &Image<'_>, averaging: Averaging, reach_mm: f64) -> Profiles {
        let step_mm = image.pixel_mm() / SAMPLES_PER_PIXEL;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "28 at most")]
        let half = (reach_mm / step_mm).round() as usize;
        let n_samples = 2 * half + 1;
        let normals = normals(&self.points);
        let kernel = self.kernel(self.smoothing_mm);
        let mut values = vec![0.0; n_samples * self.points.len()];
        for m in 0..n_samples {
            let d = (m as f64 - half as f64) * step_mm;
            let ring: Vec<f64> = self.points.iter().zip(&normals).map(|(p, n)| image.at(p + n * d)).collect();
            let ring = match averaging {
                Averaging::AlongContour => smoothed_closed(&ring, &kernel),
                Averaging::None => ring,
            };
            for (i, v) in ring.into_iter().enumerate() {
                values[i * n_samples + m] = v;
            }
        }
        Profiles { values, n_samples, half, step_mm }
    }
}

/// Whether profiles are averaged with their neighbours along the contour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Averaging {
    None,
    AlongContour,
}

/// One profile per point of a curve, from inside to outside.
struct Profiles {
    values: Vec<f64>,
    n_samples: usize,
    half: usize,
    step_mm: f64,
}

impl Profiles {
    fn of(&self, i: usize) -> &[f64] {
        &self.values[i * self.n_samples..(i + 1) * self.n_samples]
    }

    fn mean(&self) -> Profile {
        let n = (self.values.len() / self.n_samples) as f64;
        let column = |m: usize| self.values.iter().skip(m).step_by(self.n_samples).sum::<f64>() / n;
        Profile { values: (0..self.n_samples).map(column).collect(), step_mm: self.step_mm }
    }

    /// Where profile i falls through the level nearest to the contour, mm outward; `None` beyond the limits.
    fn crossing_mm(&self, i: usize, level: f64, limits_mm: [f64; 2]) -> Option<f64> {
        let profile = self.of(i);
        let position = |m: usize| {
            let (a, b) = (profile[m], profile[m + 1]);
            (a >= level && b < level)
                .then(|| (m as f64 - self.half as f64 + (a - level) / (a - b)) * self.step_mm)
        };
        (0..self.n_samples - 1)
            .filter_map(position)
            .filter(|d| *d >= limits_mm[0] && *d <= limits_mm[1])
            .min_by(|a, b| a.abs().total_cmp(&b.abs()))
    }
}

/// The edge of a contour: the mean of all its profiles, once the contour follows the edge, fitted by a model.
/// `None` where the model does not fit.
pub(super) fn edge_of(contour: &Contour, image: &Image<'_>) -> Option<Edge> {
    let mut curve = Curve::rough(contour, image.pixel_mm());
    let rough = curve.mean_profile(image).rough_edge()?;
    for _ in 0..N_ROUNDS {
        let offsets = smooth_offsets(&curve, image, rough.half_level());
        shift(&mut curve, &offsets);
    }
    let reach_mm = REACH_BLURS * rough.blur_mm;
    curve.mean_profile(image).within(reach_mm).edge()
}

/// What the boundary is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Target {
    /// Grey value half-way between lumen and wall; dark lumens have their sign changed.
    pub(super) level: f64,
    /// Standard deviation of the blur that displaces it where it is curved, mm.
    pub(super) blur_mm: f64,
}

/// Moves the contour to the level.
pub(super) fn fitted(contour: &Contour, image: &Image<'_>, level: f64) -> Curve {
    let mut curve = Curve::new(contour, image.pixel_mm());
    for _ in 0..N_ROUNDS {
        let offsets = smooth_offsets(&curve, image, level);
        shift(&mut curve, &offsets);
    }
    curve
}

/// The curve without the image's noise, and put where the edge was before it was blurred.
pub(super) fn cleaned(mut curve: Curve, noise_mm3: f64, blur_mm: f64) -> Curve {
    curve.points = Spectrum::of(&curve.points).filtered(noise_mm3);
    let correction = curvature_correction(&curve, blur_mm);
    shift(&mut curve, &correction);
    curve
}

/// How far each point has to move, smoothed along the contour; where no edge is in reach its neighbours decide.
fn smooth_offsets(curve: &Curve, image: &Image<'_>, level: f64) -> Vec<f64> {
    let limit = (LIMIT_PIXELS * image.pixel_mm()).min(LIMIT_RADII * curve.radius_mm);
    let profiles = curve.profiles(image, Averaging::AlongContour, limit + image.pixel_mm());
    let found: Vec<Option<f64>> = (0..curve.points.len())
        .map(|i| {
            let limits = [-limit - curve.moved_mm[i], limit - curve.moved_mm[i]];
            profiles.crossing_mm(i, level, limits)
        })
        .collect();
    smoothed_offsets(curve, &found)
}

/// Offsets smoothed along the contour; where none was found its neighbours decide.
fn smoothed_offsets(curve: &Curve, found: &[Option<f64>]) -> Vec<f64> {
    // Sum of offsets and sum of weights, side by side.
    let weighted: Vec<Vector2> =
        found.iter().map(|d| d.map_or(Vector2::zeros(), |d| Vector2::new(d, 1.0))).collect();
    let smooth = smoothed_closed(&weighted, &curve.kernel(curve.smoothing_mm));
    smooth.into_iter().map(|s| if s.y > 1e-3 { s.x / s.y } else { 0.0 }).collect()
}

fn shift(curve: &mut Curve, offsets_mm: &[f64]) {
    let normals = normals(&curve.points);
    for (i, (n, &d)) in normals.into_iter().zip(offsets_mm).enumerate() {
        curve.points[i] += n * d;
        curve.moved_mm[i] += d;
    }
}

fn curvature_correction(curve: &Curve, blur_mm: f64) -> Vec<f64> {
    // Beyond this the series that the correction is the first term of no longer converges.
    let sharpest = 0.5 / blur_mm.max(1e-6);
    let kernel = curve.kernel((2.0 * curve.smoothing_mm).min(0.5 * curve.radius_mm));
    let smooth = smoothed_closed(&curvatures(&curve.points), &kernel);
    smooth.into_iter().map(|k| 0.5 * blur_mm * blur_mm * k.clamp(-sharpest, sharpest)).collect()
}
