//! The intensities of lumen and wall around a seed.
//!
//! From the seed, rays run outward in its plane. On each, the first lasting departure from the lumen's level is
//! the wall; the wall's level is where the fall (or rise) flattens out behind it. Medians over all rays make it
//! insensitive to a few rays that meet calcifications, side branches or neighbouring vessels.
//!
//! What it does not do: it does not look along the vessel. Where the contrast fades along it, give a window.

use super::Polarity;
use super::grow::Voxel;
use crate::ct::Volume;

/// How far the rays run, mm: more than the radius of any vessel that is printed here.
pub const REACH_MM: f64 = 30.0;
const N_RAYS: usize = 64;
/// Ray samples per pixel.
const SAMPLES_PER_PIXEL: f64 = 2.0;
/// A departure counts from this many standard deviations of the noise on.
const NOISE_FACTOR: f64 = 4.0;
/// And from this part of the range of all values met on.
const RANGE_FACTOR: f64 = 0.2;
/// The edge is passed where the slope has fallen to this part of the steepest.
const FLAT_FACTOR: f64 = 0.5;

/// What lumen and wall measure, HU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Levels {
    /// Level inside the lumen.
    pub lumen_hu: f64,
    /// Level of what surrounds it.
    pub wall_hu: f64,
}

impl Levels {
    /// Brighter or darker than the wall.
    #[must_use]
    pub fn polarity(self) -> Polarity {
        if self.lumen_hu < self.wall_hu { Polarity::Dark } else { Polarity::Bright }
    }

    /// From half-way to the wall to as far on the other side of the lumen's level as the wall lies on this.
    #[must_use]
    pub fn window_hu(self) -> [f64; 2] {
        let half = 0.5 * (self.lumen_hu + self.wall_hu);
        let far = 2.0 * self.lumen_hu - self.wall_hu;
        [half.min(far), half.max(far)]
    }
}

/// Finds the levels around the seeds; `None` where fewer than a quarter of the rays meet a wall.
#[must_use]
pub fn find(volume: &Volume, seeds: &[Voxel], polarity: Polarity) -> Option<Levels> {
    let rays: Vec<Vec<f64>> = seeds.iter().flat_map(|&seed| rays_from(volume, seed)).collect();
    let lumen = median(seeds.iter().flat_map(|&s| neighbourhood(volume, s)).collect())?;
    let all: Vec<f64> = rays.iter().flatten().copied().collect();
    let range = quantile(all.clone(), 0.98)? - quantile(all, 0.02)?;
    let noise = median(seeds.iter().map(|&s| noise_hu(volume, s)).collect())?;
    let least = (NOISE_FACTOR * noise).max(RANGE_FACTOR * range);
    let found: Vec<Edge> = rays.iter().filter_map(|ray| first_edge(ray, lumen, least)).collect();
    let n_dark = found.iter().filter(|e| e.wall > lumen).count();
    let dark = match polarity {
        Polarity::Dark => true,
        Polarity::Bright => false,
        Polarity::Auto => 2 * n_dark > found.len(),
    };
    let agreeing: Vec<Edge> = found.into_iter().filter(|e| (e.wall > lumen) == dark).collect();
    if 4 * agreeing.len() < rays.len() || agreeing.is_empty() {
        return None;
    }
    let wall_hu = median(agreeing.iter().map(|e| e.wall).collect())?;
    Some(Levels { lumen_hu: lumen, wall_hu })
}

#[derive(Debug, Clone, Copy)]
struct Edge {
    wall: f64,
}

/// The first lasting departure from the lumen's level by at least `least`.
fn first_edge(ray: &[f64], lumen: f64, least: f64) -> Option<Edge> {
    let at = (0..ray.len().saturating_sub(1)).find(|&i| {
        let (here, next) = (ray[i] - lumen, ray[i + 1] - lumen);
        here.abs() > least && next.abs() > least && here * next > 0.0
    })?;
    let sign = (ray[at] - lumen).signum();
    // Slopes over a whole pixel: shorter ones are noise.
    let lag = 2;
    let slope = |i: usize| sign * (ray[(i + lag).min(ray.len() - 1)] - ray[i]);
    let steepest = (at.saturating_sub(2 * lag)..=at).map(slope).fold(0.0, f64::max);
    let mut peak = steepest;
    let past = (at..ray.len() - 1).find(|&i| {
        peak = peak.max(slope(i));
        slope(i) < FLAT_FACTOR * peak
    })?;
    // From there the slope runs out, until it is nothing or the next structure begins.
    let end = (past..ray.len() - 1).find(|&i| slope(i) < 0.05 * peak || slope(i + 1) > slope(i))?;
    Some(Edge { wall: ray[(end + 1).min(ray.len() - 1)] })
}

/// Smoothed samples outward from the seed, up to the reach or the border of the image.
fn rays_from(volume: &Volume, [i, j, k]: Voxel) -> Vec<Vec<f64>> {
    let [sx, sy] = volume.pixel_spacing_xy_mm;
    let step_mm = sx.min(sy) / SAMPLES_PER_PIXEL;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few hundred samples")]
    let n = (REACH_MM / step_mm).clamp(8.0, 4096.0) as usize;
    let ray = |r: usize| {
        let (sin, cos) = (std::f64::consts::TAU * r as f64 / N_RAYS as f64).sin_cos();
        let at = |s: usize| {
            let d = step_mm * s as f64;
            bilinear(volume, i as f64 + d * cos / sx, j as f64 + d * sin / sy, k)
        };
        smoothed(&(0..n).map_while(at).collect::<Vec<f64>>())
    };
    (0..N_RAYS).map(ray).collect()
}

/// Binomial smoothing over about one pixel.
fn smoothed(ray: &[f64]) -> Vec<f64> {
    let mut values = ray.to_vec();
    for _ in 0..2 {
        let before = values.clone();
        for (i, w) in before.windows(3).enumerate() {
            values[i + 1] = 0.25 * w[0] + 0.5 * w[1] + 0.25 * w[2];
        }
    }
    values
}

fn bilinear(volume: &Volume, x: f64, y: f64, k: usize) -> Option<f64> {
    let [nx, ny, _] = volume.dims;
    let inside = x >= 0.0 && y >= 0.0 && x < nx as f64 - 1.0 && y < ny as f64 - 1.0;
    if !inside {
        return None;
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "range checked above")]
    let (i, j) = (x as usize, y as usize);
    let (u, v) = (x - i as f64, y - j as f64);
    let at = |i, j| f64::from(volume.at(i, j, k));
    let below = at(i, j) * (1.0 - u) + at(i + 1, j) * u;
    let above = at(i, j + 1) * (1.0 - u) + at(i + 1, j + 1) * u;
    Some(below * (1.0 - v) + above * v)
}

/// The 3 x 3 pixels around the seed.
fn neighbourhood(volume: &Volume, [i, j, k]: Voxel) -> Vec<f64> {
    let [nx, ny, _] = volume.dims;
    let around = |c: usize, n: usize| c.saturating_sub(1)..(c + 2).min(n);
    around(j, ny).flat_map(|j| around(i, nx).map(move |i| f64::from(volume.at(i, j, k)))).collect()
}

/// Standard deviation of the noise around the seed, from differences between pixels: the median makes edges
/// harmless. Three pixels apart they are independent in a CT's correlated noise; structures coarser than the
/// pixels would count as noise there, which the difference of neighbours bounds.
fn noise_hu(volume: &Volume, [i, j, k]: Voxel) -> f64 {
    let [nx, ny, _] = volume.dims;
    let half = 24;
    let columns = i.saturating_sub(half)..(i + half).min(nx);
    let rows = j.saturating_sub(half)..(j + half).min(ny);
    let spread = |lag: usize| {
        let last = columns.end.saturating_sub(lag);
        let difference = |i: usize, j: usize| f64::from(volume.at(i + lag, j, k) - volume.at(i, j, k)).abs();
        let pairs = rows.clone().flat_map(|j| (columns.start..last).map(move |i| (i, j)));
        // 1.4826 turns a median of absolute deviations into a standard deviation; two pixels carry noise.
        1.4826 / std::f64::consts::SQRT_2
            * median(pairs.map(|(i, j)| difference(i, j)).collect()).unwrap_or(0.0)
    };
    spread(3).min(2.5 * spread(1))
}

fn median(values: Vec<f64>) -> Option<f64> {
    quantile(values, 0.5)
}

fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    values.retain(|v| v.is_finite());
    if values.is_empty() {
        return None;
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index into the values")]
    let at = ((values.len() - 1) as f64 * share).round() as usize;
    Some(*values.select_nth_unstable_by(at, f64::total_cmp).1)
}
