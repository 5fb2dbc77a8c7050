//! The grey levels of air and material in a scan, and its blur, from profiles across the outer skin of the model.
//!
//! A wall hardly thicker than the blur shows nowhere its material's own level, so that half-way to its peak is not its boundary.
//! The median of all profiles, each laid at its own crossing, is fitted by a blurred slab of about the wall's thickness
//! (`air + step (F((d + w) / s) - F(d / s))`, F the normal distribution): the level is solved for, blur and thickness are searched.

use super::model::Model;
use super::registration::Pose;
use super::sampler::Sampler;
use crate::geom::{Point3, Vector3};
use crate::report::image::median;
use crate::sections::edge::normal_cdf;
use rayon::prelude::*;

/// Most places.
const N_PLACES: usize = 4000;
/// Fewer places show nothing.
const LEAST_PLACES: usize = 50;
/// Profiles begin so far outside, mm; farther in than this nothing is looked at.
const OUTSIDE_MM: f64 = 2.5;
const MOST_INSIDE_MM: f64 = 2.5;
/// Blur that is believed, mm.
const BLUR_MM: [f64; 2] = [0.02, 2.0];
/// How much the wall may be thicker or thinner than the model's, as a factor.
const WALL: f64 = 1.3;

/// What was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Levels {
    pub(super) air: f64,
    pub(super) material: f64,
    /// Standard deviation of the blur, mm.
    pub(super) blur_mm: f64,
}

impl Levels {
    /// The value at a boundary.
    pub(super) fn half(&self) -> f64 {
        0.5 * (self.air + self.material)
    }
}

/// Reads the levels at the outer skin; `None` where too few places show an edge. `level` is about half-way.
pub(super) fn measured(model: &Model, sampler: &Sampler<'_>, pose: &Pose, level: f64) -> Option<Levels> {
    let step_mm = 0.25 * sampler.voxel_mm();
    let places = places(model);
    let wall_mm = wall_mm(model);
    let inside_mm = wall_mm.map_or(MOST_INSIDE_MM, |w| (0.9 * w).min(MOST_INSIDE_MM));
    let (n_in, n_out) = (steps(inside_mm / step_mm), steps(OUTSIDE_MM / step_mm));
    let profiles: Vec<Vec<Option<f64>>> = places
        .par_iter()
        .filter_map(|&(p, n)| {
            let (p, n) = (pose.back(p), pose.back_direction(n));
            let crossing = crossing_mm(sampler, p, n, level, step_mm)?;
            let at = |i: usize| (i as f64 - n_in as f64) * step_mm + crossing;
            // Beyond the image nothing is known: there the others tell.
            Some((0..=n_in + n_out).map(|i| sampler.at(p + n * at(i))).collect())
        })
        .collect();
    if profiles.len() < LEAST_PLACES {
        return None;
    }
    // The median of many places is that of the skin: some look at another wall, or at something beside the replica.
    let at = |i: usize| {
        let known = || profiles.iter().filter_map(|p| p[i]);
        let value = median(known()).filter(|_| known().count() >= LEAST_PLACES)?;
        Some(((i as f64 - n_in as f64) * step_mm, value))
    };
    let mean: Vec<(f64, f64)> = (0..=n_in + n_out).filter_map(at).collect();
    fitted(&mean, wall_mm)
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few millimetres")]
fn steps(n: f64) -> usize {
    n.clamp(4.0, 400.0) as usize
}

/// The usual thickness of the model's wall, mm; `None` for a cast.
pub(super) fn wall_mm(model: &Model) -> Option<f64> {
    median(places(model).iter().filter_map(|p| model.wall_mm(*p)))
}

fn places(model: &Model) -> Vec<(Point3, Vector3)> {
    let all = model.outer_places(4, 48);
    let every = all.len().div_ceil(N_PLACES).max(1);
    all.into_iter().step_by(every).collect()
}

/// Where a profile passes the level on its way out, nearest to the place, mm.
fn crossing_mm(sampler: &Sampler<'_>, p: Point3, n: Vector3, level: f64, step_mm: f64) -> Option<f64> {
    let reach = steps(1.0 / step_mm);
    let at = |i: usize| (i as f64 - reach as f64) * step_mm;
    let values: Vec<Option<f64>> = (0..=2 * reach).map(|i| sampler.at(p + n * at(i))).collect();
    let place = |i: usize| {
        let (inner, outer) = values[i].zip(values[i + 1])?;
        (inner > level && outer <= level).then(|| at(i) + step_mm * (inner - level) / (inner - outer))
    };
    (0..2 * reach).filter_map(place).min_by(|a, b| a.abs().total_cmp(&b.abs()))
}

/// The slab that fits the mean profile (distance outward, value) best.
fn fitted(mean: &[(f64, f64)], wall_mm: Option<f64>) -> Option<Levels> {
    let start = [0.0, 0.3, wall_mm.unwrap_or(f64::INFINITY)];
    let allowed = |[_, blur, wall]: [f64; 3]| {
        let thick = wall_mm.is_none_or(|w| (w / WALL..=w * WALL).contains(&wall));
        (BLUR_MM[0]..=BLUR_MM[1]).contains(&blur) && thick
    };
    let mut best = (start, levels_of(mean, start)?);
    let mut step = 0.1;
    while step > 1e-3 {
        let around = (0..6).map(|i| {
            let mut shape = best.0;
            shape[i / 2] += if i % 2 == 0 { step } else { -step };
            shape
        });
        let fits = around.filter(|s| allowed(*s)).filter_map(|s| Some((s, levels_of(mean, s)?)));
        match fits.min_by(|a, b| a.1.2.total_cmp(&b.1.2)).filter(|f| f.1.2 < best.1.2) {
            Some(better) => best = better,
            None => step *= 0.5,
        }
    }
    let ([_, blur_mm, _], (air, material, _)) = best;
    (material > air).then_some(Levels { air, material, blur_mm })
}

/// Levels of air and material for a place, a blur and a thickness, and the misfit with them.
fn levels_of(mean: &[(f64, f64)], [at, blur, wall]: [f64; 3]) -> Option<(f64, f64, f64)> {
    let share = |d: f64| {
        let inner = if wall.is_finite() { normal_cdf((d - at + wall) / blur) } else { 1.0 };
        inner - normal_cdf((d - at) / blur)
    };
    let n = mean.len() as f64;
    let (mut x, mut y, mut xx, mut xy) = (0.0, 0.0, 0.0, 0.0);
    for (d, value) in mean {
        let s = share(*d);
        (x, y, xx, xy) = (x + s, y + value, xx + s * s, xy + s * value);
    }
    let spread = n * xx - x * x;
    if spread <= 1e-9 {
        return None;
    }
    let step = (n * xy - x * y) / spread;
    let air = (y - step * x) / n;
    let misfit = mean.iter().map(|(d, value)| (air + step * share(*d) - value).powi(2)).sum();
    Some((air, air + step, misfit))
}
