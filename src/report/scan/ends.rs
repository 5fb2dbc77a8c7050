//! The heights at which the scanned replica ends.
//!
//! Along upright lines through the wall at an end of the model the scan is read; the median of all lines falls from the material's
//! level to air. The wall is hardly thicker than the blur, so that half-way is taken from the level that the lines reach.

use super::compare::Planes;
use super::registration::Pose;
use crate::geom::{Point2, Point3};
use crate::report::BodyKind;
use crate::report::image::median;

/// An end is looked for so far above and below its place, mm.
const REACH_MM: f64 = 4.0;
/// Distance of the values along a line, mm.
const STEP_MM: f64 = 0.05;
/// Fewer lines show nothing.
const LEAST_LINES: usize = 12;
/// Distance of the lines along the middle of the wall, mm.
const APART_MM: f64 = 0.5;
/// The section at an end is taken so far within, mm.
const WITHIN_MM: f64 = 1e-3;
/// Chord error of section and offset, mm.
const TOLERANCE_MM: f64 = 5e-3;
/// The least that the lines reach of the step from air to material.
const LEAST_LEVEL: f64 = 0.4;

/// Where the replica ends below and above; `None` where the scan does not show both.
pub(super) fn ends(planes: &Planes<'_>, pose: &Pose) -> Option<[f64; 2]> {
    let [low, high] = planes.inputs.solid.z_range_mm();
    Some([end(planes, pose, low, -1.0)?, end(planes, pose, high, 1.0)?])
}

/// The height of the end near `z_mm`; `out` is 1 where air is above, -1 where it is below.
fn end(planes: &Planes<'_>, pose: &Pose, z_mm: f64, out: f64) -> Option<f64> {
    let lines = lines(planes, z_mm - WITHIN_MM * out);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few millimetres")]
    let n = (REACH_MM / STEP_MM) as usize;
    let off_mm = |i: usize| (i as f64 - n as f64) * STEP_MM;
    // Beyond the image nothing is known.
    let at = |i: usize| {
        let values = lines
            .iter()
            .filter_map(|p| planes.sampler.at(pose.back(Point3::new(p.x, p.y, z_mm + out * off_mm(i)))));
        let values: Vec<f64> = values.collect();
        (values.len() >= LEAST_LINES).then(|| median(values.into_iter())).flatten()
    };
    let profile: Vec<Option<f64>> = (0..=2 * n).map(at).collect();
    let (top, level) = profile
        .iter()
        .enumerate()
        .filter_map(|(i, v)| Some((i, (*v)?)))
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    let air = planes.levels.air;
    if level - air < LEAST_LEVEL * (planes.levels.material - air) {
        return None;
    }
    // The level of the lines: what they have about their highest value, which noise makes too high.
    let reached = profile[top.saturating_sub(6)..=(top + 6).min(2 * n)].iter().flatten().copied();
    let half = 0.5 * (air + median(reached)?);
    let falls = (top..2 * n).find_map(|i| {
        let (a, b) = (profile[i]?, profile[i + 1]?);
        (a >= half && b < half).then(|| off_mm(i) + STEP_MM * (a - half) / (a - b))
    })?;
    Some(z_mm + out * falls)
}

/// Places in the middle of the wall; all over a cast.
fn lines(planes: &Planes<'_>, z_mm: f64) -> Vec<Point2> {
    let section = planes.inputs.solid.section(z_mm, TOLERANCE_MM);
    let (material, inset_mm) = match planes.inputs.body {
        BodyKind::Cast => (section.outer, 0.6),
        BodyKind::Wall => (section.material(), 0.4 * planes.wall_mm.unwrap_or(1.0)),
    };
    let middle = material.offset(-inset_mm, TOLERANCE_MM);
    let along = |c: &crate::geom::Contour| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "the length of an outline"
        )]
        let n = (c.perimeter_mm() / APART_MM).ceil().max(3.0) as usize;
        c.resampled(n).points
    };
    middle.contours.iter().filter(|c| c.len() > 2).flat_map(along).collect()
}
