//! The intensities of lumen and wall around a seed.
//!
//! From the seed, rays run outward in its plane. On each, the first lasting departure from the lumen's level is
//! the wall, where it stands out of the noise and of what lies near it on the same ray: ripples in the lumen before
//! a steep edge are none, and air or bone farther away hide no faint wall. Aligned at their departures, the rays'
//! median is one profile of the edge, whose noise is a fraction of a single ray's; the wall's level is that of
//! the plateau behind its fall (or rise). Medians over all rays make it insensitive to a few rays that meet
//! calcifications, side branches or neighbouring vessels.
//!
//! What it does not do: it does not look along the vessel. Where the contrast fades along it, give a window.

use super::Polarity;
use super::grow::Voxel;
use crate::ct::Volume;

/// How far the rays run, mm: more than the radius of any vessel that is printed here.
pub(super) const REACH_MM: f64 = 30.0;
const N_RAYS: usize = 64;
/// Ray samples per pixel.
const SAMPLES_PER_PIXEL: f64 = 2.0;
/// A departure counts from this many standard deviations of the pixels' noise on: five of a smoothed ray's.
const NOISE_FACTOR: f64 = 3.0;
/// And from this part of the range of values on its ray, up to twice as far away
const RANGE_FACTOR: f64 = 0.2;
/// and this much farther, mm: small lumens have a blurred edge too.
const NEAR_MM: f64 = 1.0;
/// Slopes are taken over so many samples, a pixel: shorter ones are noise.
const LAG: usize = 2;
/// The profile of the edge begins so many samples before the departure.
const BEFORE: usize = 2 * LAG;
/// And goes on for so many after it: no blurred edge is wider.
const BEHIND: usize = 48;
/// The edge is passed where the slope has fallen to this part of the steepest.
const PASSED: f64 = 0.5;
/// And runs out where it has fallen to this part.
const RUN_OUT: f64 = 0.1;
/// What falls by less than this part of the steepest within a pixel falls no further: behind a thin wall, or between
/// two structures, no slope runs out.
const STALLED: f64 = 0.05;
/// The plateau behind an edge ends where it departs by this part of the step.
const UNEVEN: f64 = 0.1;

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

/// How far the lumen reaches around the seeds, mm: the median distance to where rays leave it.
pub(super) fn radius_mm(volume: &Volume, seeds: &[Voxel], levels: Levels) -> Option<f64> {
    let rays: Vec<Vec<f64>> = seeds.iter().flat_map(|&seed| rays_from(volume, seed)).collect();
    let least = 0.5 * (levels.lumen_hu - levels.wall_hu).abs();
    let reached = |ray: &Vec<f64>| ray.iter().position(|v| (v - levels.lumen_hu).abs() > least);
    median(rays.iter().filter_map(reached).map(|at| at as f64 * step_mm(volume)).collect())
}

/// What a wall has to stand out by around the seeds, HU.
pub(super) fn least_step_hu(volume: &Volume, seeds: &[Voxel]) -> f64 {
    NOISE_FACTOR * median(seeds.iter().map(|&s| noise_hu(volume, s)).collect()).unwrap_or(0.0)
}

/// Finds the levels around the seeds; `None` where fewer than a quarter of the rays meet a wall.
#[must_use]
pub(super) fn find(volume: &Volume, seeds: &[Voxel], polarity: Polarity) -> Option<Levels> {
    let rays: Vec<Vec<f64>> = seeds.iter().flat_map(|&seed| rays_from(volume, seed)).collect();
    let lumen = median(seeds.iter().flat_map(|&s| neighbourhood(volume, s)).collect())?;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few samples")]
    let near = (NEAR_MM / step_mm(volume)).ceil() as usize;
    let least = least_step_hu(volume, seeds);
    // Noise at the seed is no level: what lies half-way to the departures tells the lumen's, and with it better ones.
    let first = agreeing(&rays, lumen, least, near, polarity)?;
    let lumen = inner_level(&first)?;
    let edges = agreeing(&rays, lumen, least, near, polarity)?;
    let lumen_hu = inner_level(&edges)?;
    let dark = edges.first()?.rises;
    let sign = if dark { 1.0 } else { -1.0 };
    let profile: Vec<f64> = profile(&edges).into_iter().map(|v| sign * (v - lumen_hu)).collect();
    let step_hu = plateau(&profile)?;
    (step_hu > 0.0).then_some(Levels { lumen_hu, wall_hu: lumen_hu + sign * step_hu })
}

/// The departures of the polarity that is asked for, or of the more frequent one; `None` if too few rays meet any.
fn agreeing(
    rays: &[Vec<f64>],
    lumen: f64,
    least: f64,
    near: usize,
    polarity: Polarity,
) -> Option<Vec<Edge<'_>>> {
    let mut found: Vec<Edge<'_>> =
        rays.iter().filter_map(|ray| first_edge(ray, lumen, least, near)).collect();
    let n_dark = found.iter().filter(|e| e.rises).count();
    let dark = match polarity {
        Polarity::Dark => true,
        Polarity::Bright => false,
        Polarity::Auto => 2 * n_dark > found.len(),
    };
    found.retain(|e| e.rises == dark);
    (!found.is_empty() && 4 * found.len() >= rays.len()).then_some(found)
}

/// The median from the seed half-way to the departures: beyond is their blur.
fn inner_level(edges: &[Edge<'_>]) -> Option<f64> {
    median(edges.iter().flat_map(|e| &e.ray[..=e.at / 2]).copied().collect())
}

/// Where a ray leaves the lumen.
#[derive(Debug, Clone, Copy)]
struct Edge<'a> {
    ray: &'a [f64],
    /// The first sample that has left.
    at: usize,
    /// Whether the wall is brighter than the lumen.
    rises: bool,
}

/// The first lasting departure from the lumen's level by at least `least` and a part of the range nearby.
fn first_edge(ray: &[f64], lumen: f64, least: f64, near: usize) -> Option<Edge<'_>> {
    let (mut lo, mut hi, mut seen) = (lumen, lumen, 0);
    let at = (0..ray.len().saturating_sub(1)).find(|&i| {
        let until = (2 * i + near + 1).min(ray.len());
        for v in &ray[seen..until.max(seen)] {
            (lo, hi) = (lo.min(*v), hi.max(*v));
        }
        seen = until.max(seen);
        let least = least.max(RANGE_FACTOR * (hi - lo));
        let (here, next) = (ray[i] - lumen, ray[i + 1] - lumen);
        here.abs() > least && next.abs() > least && here * next > 0.0
    })?;
    Some(Edge { ray, at, rises: ray[at] > lumen })
}

/// The median of the rays by their distance from where they leave the lumen, as far as half of them reach.
fn profile(edges: &[Edge<'_>]) -> Vec<f64> {
    let at = |o: usize| -> Vec<f64> {
        let place = |e: &Edge<'_>| (e.at + o).checked_sub(BEFORE);
        edges.iter().filter_map(|e| e.ray.get(place(e).unwrap_or(0)).copied()).collect()
    };
    let all = (0..BEFORE + BEHIND).map(at);
    all.take_while(|values| 2 * values.len() >= edges.len()).filter_map(median).collect()
}

/// The level of the plateau behind the rise of a profile.
fn plateau(profile: &[f64]) -> Option<f64> {
    let n = profile.len().checked_sub(LAG).filter(|&n| n > BEFORE)?;
    let slope = |i: usize| profile[i + LAG] - profile[i];
    let mut peak = (0..BEFORE).map(slope).fold(0.0, f64::max);
    let passed = (BEFORE..n).find(|&i| {
        peak = peak.max(slope(i));
        slope(i) < PASSED * peak
    })?;
    // Where the slope has run out the plateau is reached; where it falls no further, the next structure begins.
    let end = (passed..n).find(|&i| {
        let next = slope((i + LAG).min(n - 1));
        slope(i) < RUN_OUT * peak || slope(i) - next < STALLED * peak
    })?;
    if slope(end) < RUN_OUT * peak {
        level_from(profile, end + 1)
    } else {
        profile.get(end + LAG / 2).copied()
    }
}

/// The median of a plateau, over as much as the edge before it is wide: a ripple is averaged out.
fn level_from(profile: &[f64], start: usize) -> Option<f64> {
    let first = *profile.get(start)?;
    let even = |v: &&f64| (**v - first).abs() <= UNEVEN * first.abs();
    let width = start.saturating_sub(BEFORE).max(LAG);
    median(profile[start..].iter().take(width).take_while(even).copied().collect())
}

/// Smoothed samples outward from the seed, up to the reach or the border of the image.
fn rays_from(volume: &Volume, [i, j, k]: Voxel) -> Vec<Vec<f64>> {
    let [sx, sy] = volume.pixel_spacing_xy_mm;
    let step_mm = step_mm(volume);
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

/// Between two samples of a ray.
fn step_mm(volume: &Volume) -> f64 {
    let [sx, sy] = volume.pixel_spacing_xy_mm;
    sx.min(sy) / SAMPLES_PER_PIXEL
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

/// Standard deviation of the noise around the seed, HU. Three pixels apart it is independent in a CT's correlated noise;
/// structures coarser than the pixels would count as noise there, which the difference of neighbours bounds.
pub(super) fn noise_hu(volume: &Volume, seed: Voxel) -> f64 {
    difference_hu(volume, seed, 3).min(2.5 * difference_hu(volume, seed, 1))
}

/// Standard deviation of differences between pixels so many columns apart around the seed, per pixel, HU: the median makes
/// edges harmless.
pub(super) fn difference_hu(volume: &Volume, [i, j, k]: Voxel, lag: usize) -> f64 {
    let [nx, ny, _] = volume.dims;
    let half = 24;
    let columns = i.saturating_sub(half)..(i + half).min(nx);
    let rows = j.saturating_sub(half)..(j + half).min(ny);
    let last = columns.end.saturating_sub(lag);
    let difference = |i: usize, j: usize| f64::from(volume.at(i + lag, j, k) - volume.at(i, j, k)).abs();
    let pairs = rows.flat_map(|j| (columns.start..last).map(move |i| (i, j)));
    let typical = median(pairs.map(|(i, j)| difference(i, j)).collect()).unwrap_or(0.0);
    // 1.4826 turns a median of absolute deviations into a standard deviation; two pixels carry noise.
    1.4826 / std::f64::consts::SQRT_2 * typical
}

pub(super) fn median(values: Vec<f64>) -> Option<f64> {
    quantile(values, 0.5)
}

/// The value below which that share of the finite ones lies, the nearest of them; `None` of none.
pub(super) fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    values.retain(|v| v.is_finite());
    if values.is_empty() {
        return None;
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index into the values")]
    let at = ((values.len() - 1) as f64 * share).round() as usize;
    Some(*values.select_nth_unstable_by(at, f64::total_cmp).1)
}
