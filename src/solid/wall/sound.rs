//! Where an outer skin is unsound: a quick look at the places where outlines change fast, beside its events.
//!
//! A saddle must be a graph over the plane, and sections must be simple and apart: then their union has the sum of
//! their signed areas. The full test is `brep::check`'s.

use crate::geom::{Contour, Region};
use crate::solid::event::{Crotch, Slab};
use crate::solid::skin::Skin;
use crate::spline::PatchSurface;
use rayon::prelude::*;

/// Heights beyond a slab that are looked at, in t, and inside it, as shares of its height.
const BEYOND: [f64; 8] = [0.04, 0.12, 0.25, 0.4, 0.6, 0.85, 1.2, 1.8];
const INSIDE: [f64; 4] = [0.15, 0.4, 0.65, 0.9];
/// Chord tolerance of the sections, and the area that may be lost by their rounding, in t and t squared.
const CHORD: f64 = 3e-3;
const LOST_AREA: f64 = 1e-4;
/// Intervals, each way, at which a saddle is tested for folds.
const SADDLE_SAMPLES: usize = 16;

/// Heights z at which the skin folds or crosses itself, ascending by event.
pub(super) fn faults(skin: &Skin, wall_mm: f64) -> Vec<f64> {
    let beside = |slab: &Slab| -> Vec<f64> {
        let [low, high] = slab.w_mm;
        let below = BEYOND.map(|b| low - b * wall_mm);
        let above = BEYOND.map(|b| high + b * wall_mm);
        let within = INSIDE.map(|s| low + (high - low) * s);
        below.into_iter().chain(above).chain(within).map(|w| slab.z_of(w)).collect()
    };
    let mut found: Vec<f64> = skin.slabs.iter().filter(|s| folds(s)).map(|s| s.z_of(s.w_mm[1])).collect();
    let heights: Vec<f64> = skin.slabs.iter().flat_map(beside).collect();
    let crossing: Vec<f64> = heights.into_par_iter().filter(|&z| crosses(skin, z, wall_mm)).collect();
    found.extend(crossing);
    found
}

fn folds(slab: &Slab) -> bool {
    let Crotch::Saddle(saddle) = &slab.crotch else { return false };
    let areas = areas(saddle);
    let mean = areas.iter().sum::<f64>() / areas.len() as f64;
    areas.iter().any(|area| -area * mean.signum() > 1e-3 * mean.abs())
}

/// The Jacobians of a patch seen along z.
fn areas(patch: &PatchSurface) -> Vec<f64> {
    let at = |k: usize, [a, b]: [f64; 2]| a + (b - a) * k as f64 / SADDLE_SAMPLES as f64;
    let grid = (0..=SADDLE_SAMPLES).flat_map(|j| (0..=SADDLE_SAMPLES).map(move |i| (i, j)));
    grid.map(|(i, j)| {
        let jet = patch.jet(at(i, patch.u_range()), at(j, patch.v_range()));
        jet.by_u.xy().perp(&jet.by_v.xy())
    })
    .collect()
}

fn crosses(skin: &Skin, z: f64, wall_mm: f64) -> bool {
    let contours = skin.section(z, CHORD * wall_mm);
    let sum: f64 = contours.iter().map(Contour::signed_area_mm2).sum();
    let region = Region::new(contours);
    let united = Region::union_all([&region]).area_mm2();
    (united - sum).abs() > LOST_AREA * wall_mm * wall_mm
}
