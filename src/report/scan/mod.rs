//! A scan of the printed replica against the model: what was really made, not what was recorded.
//!
//! The replica is the bright body in air whose volume is nearest to the model's ([`body`](self)). Its surface, half-way between air
//! and material, is laid over the model by a rigid transform ([`registration`](self)); levels and blur are then measured across the
//! outer skin ([`levels`](self)) and the surface is taken anew. The scan is read at the CT planes (trilinear), the half-way
//! outlines there, moved back by what blur draws a curved boundary inward, are compared with the solid's as in every other stage
//! ([`compare`](self)).
//!
//! This is the only stage that is registered by a fit: a scan has no other place. The fit is rigid, follows the part that fits, and
//! corrects nothing else: no figure of another stage rests on it.
//!
//! Material is laid over material between the planes, too ([`material`](self)), and the ends are sought ([`ends`](self)): outlines of lumina do
//! not tell what is missing.
//!
//! Limits: voxels larger than half the wall judge nothing; a shape that fits in several ways (a straight tube) is refused; inhomogeneous material
//! (beam hardening, metal) moves the half-way surface.

mod body;
mod compare;
mod ends;
mod findings;
mod levels;
mod material;
mod model;
mod registration;
mod sampler;
#[cfg(test)]
mod tests;

pub use registration::Refusal;

pub(super) use compare::{NO_MODEL, ScannedPlane};

use super::deviation::rounded;
use super::uncertainty::Sides;
use super::{Block, Error, Inputs};
use crate::ct::Volume;
use crate::geom::RigidTransform;
use crate::progress::{Cancelled, Task};
use crate::solid::CrossSection;
use body::{Body, bodies};
use compare::Planes;
use levels::Levels;
use model::Model;
use registration::{Pose, Registered, again, register};
use sampler::Sampler;
use serde::Serialize;

/// A body is taken for the replica if its volume is that of the model up to this factor.
const MOST_VOLUME: f64 = 2.5;
/// At most so many bodies are tried.
const N_TRIED: usize = 3;
/// Places of the surface for the search and for the pose.
const N_SEARCH: usize = 6000;
const N_FINAL: usize = 20_000;
/// Values that are looked at to find a first level, at most.
const N_SAMPLED: usize = 2_000_000;
/// A place lies on the model if it is off by less than this, mm, or a voxel.
const ON_MODEL_MM: f64 = 0.5;

/// The limits of this stage, as the profile asks them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ScanGate {
    /// 95th percentile against the model, mm.
    pub p95_mm: f64,
    /// Farthest that an outline may lie off the model on any plane, mm.
    pub outline_mm: f64,
    /// Most that the replica may be larger or smaller, all of it or its heights, percent.
    pub scale_percent: f64,
}

/// Where the scan lies on the model.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Registration {
    /// From the scan's stack frame to the model's; `null` for a mirror image, which is not laid over the model.
    pub model_from_scan: Option<RigidTransform>,
    /// Root mean square distance of the surface from the model where it fits, mm.
    #[serde(serialize_with = "rounded")]
    pub rms_mm: Option<f64>,
    /// Part of the surface that the fit rests on, 0 to 1.
    #[serde(serialize_with = "rounded")]
    pub fitted_part: Option<f64>,
    /// By how much the replica is larger than the model, percent; measured, not taken away.
    #[serde(serialize_with = "rounded")]
    pub scale_percent: Option<f64>,
    /// Standard uncertainty of that, percent.
    #[serde(serialize_with = "rounded")]
    pub scale_uncertainty_percent: Option<f64>,
    /// Whether the scan is a mirror image of the model.
    pub mirrored: bool,
    /// Whether the shape tells it from its mirror image.
    pub mirror_is_told: bool,
}

/// Grey values of the scan, in the unit of its file (HU for a calibrated CT).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ScanLevels {
    /// Around the replica.
    #[serde(serialize_with = "rounded")]
    pub air_hu: Option<f64>,
    /// Of its material.
    #[serde(serialize_with = "rounded")]
    pub material_hu: Option<f64>,
    /// Standard deviation of the blur across its skin, mm.
    #[serde(serialize_with = "rounded")]
    pub blur_mm: Option<f64>,
}

/// Standard uncertainties of this stage's lengths, mm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ScanUncertainty {
    /// Largest side of a voxel.
    #[serde(serialize_with = "rounded")]
    pub voxel: Option<f64>,
    /// Scatter of the surface about the model where it fits (robust): noise and roughness of print and scan.
    #[serde(serialize_with = "rounded")]
    pub scatter: Option<f64>,
    /// What that leaves uncertain of the pose, at the farthest corner of the part.
    #[serde(serialize_with = "rounded")]
    pub pose: Option<f64>,
    /// A place of the outline: the pose, and a voxel of even probability (its side over the root of 12).
    #[serde(serialize_with = "rounded")]
    pub place: Option<f64>,
}

impl ScanUncertainty {
    /// How well the outlines of the stage are known.
    pub(super) fn sides(&self) -> Option<Sides> {
        let local_mm = self.voxel? / 12f64.sqrt();
        Some(Sides { common_mm: self.pose?, local_mm })
    }
}

/// The stage `scan`: the solid against the scanned replica.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Scan {
    /// Its figures.
    #[serde(flatten)]
    pub block: Block,
    /// Where the scan lies.
    pub registration: Registration,
    /// What the scan shows.
    pub levels: ScanLevels,
    /// How well lengths are known.
    pub uncertainty_mm: ScanUncertainty,
    /// Its limits.
    pub gate: ScanGate,
    /// Why nothing is judged by it: its voxels are too large.
    pub not_judged: Option<String>,
}

/// A scan laid over the model and read at its planes.
pub(super) struct Scanned<'a> {
    registered: Registered,
    reader: Planes<'a>,
    /// As measured across the skin; `None` where too little of it was seen.
    levels: Option<Levels>,
    is_cut: bool,
    /// As it is; nothing for a mirror image.
    pub(super) planes: Vec<ScannedPlane>,
    /// With its scale taken away, to see what else is off; `None` where it has the model's size.
    unscaled: Option<Vec<ScannedPlane>>,
}

impl Scanned<'_> {
    /// The pose in which what else is off is looked for: with the scale, where there is one.
    const fn pose(&self) -> &Pose {
        if self.unscaled.is_some() { &self.registered.similar } else { &self.registered.pose }
    }
}

/// Finds the replica in the scan, lays it over the model and reads it at the planes of `sections` (height and section).
///
/// # Errors
/// [`Error::Scan`] where there is no replica or it cannot be laid over the model, [`Error::Cancelled`].
pub(super) fn measured<'a>(
    inputs: &'a Inputs<'a>,
    volume: &'a Volume,
    sections: &'a [(f64, &'a CrossSection)],
    task: &Task<'_>,
) -> Result<Scanned<'a>, Error> {
    let sampler = Sampler::new(volume);
    let on_model_mm = ON_MODEL_MM.max(sampler.largest_mm());
    let rough = Model::of(inputs.solid, inputs.body, 0.0);
    let (level, body, first) = replica(volume, &rough, on_model_mm, task)?;
    // A mirror image does not lie on the model's skin.
    let seen =
        if first.is_mirrored() { None } else { levels::measured(&rough, &sampler, &first.similar, level) };
    task.check()?;
    let registered = match &seen {
        None => first,
        Some(levels) => {
            let body = at_level(volume, &body, levels.half(), task)?;
            let points = body.surface(volume, levels.half(), N_FINAL);
            let model = Model::of(inputs.solid, inputs.body, levels.blur_mm);
            again(&model, &points, &first, on_model_mm, task)?
        }
    };
    let levels = seen.unwrap_or(Levels { air: level, material: level, blur_mm: 0.0 });
    let reader = Planes { inputs, sampler, levels, sections, wall_mm: levels::wall_mm(&rough) };
    let (planes, unscaled) = if registered.is_mirrored() {
        (Vec::new(), None)
    } else {
        let is_scaled = registered.scaled_percent().is_some();
        (reader.read(&registered.pose, task)?, is_scaled.then(|| reader.read(&registered.similar, task)))
    };
    let unscaled = unscaled.transpose()?;
    Ok(Scanned { registered, reader, levels: seen, is_cut: body.is_cut, planes, unscaled })
}

/// The body that fits the model, the level it was found at, and how it lies.
fn replica(
    volume: &Volume,
    model: &Model,
    on_model_mm: f64,
    task: &Task<'_>,
) -> Result<(f64, Body, Registered), Error> {
    let model_mm3 = model.moments.volume_mm3;
    let mut best: Option<(f64, Vec<Body>)> = None;
    let off = |body: &Body| (body.moments.volume_mm3 / model_mm3).ln().abs();
    let mut largest_mm3: f64 = 0.0;
    for level in first_levels(volume, model_mm3) {
        task.check()?;
        // A level that lies in the noise has no bodies.
        let Some(mut found) = bodies(volume, level, model_mm3 / MOST_VOLUME, task)? else { continue };
        largest_mm3 = found.first().map_or(largest_mm3, |b| largest_mm3.max(b.moments.volume_mm3));
        found.retain(|b| off(b) < MOST_VOLUME.ln());
        found.sort_by(|a, b| off(a).total_cmp(&off(b)));
        let is_better = |(_, known): &(f64, Vec<Body>)| {
            found.first().is_some_and(|b| off(b) < known.first().map_or(f64::INFINITY, off))
        };
        if !found.is_empty() && best.as_ref().is_none_or(is_better) {
            best = Some((level, found));
        }
    }
    let Some((level, bodies)) = best else {
        let found = if largest_mm3 > 0.0 {
            format!("that of the largest bright body is {largest_mm3:.0} mm³")
        } else {
            "nothing bright is that large".into()
        };
        return Err(Refusal::NoBody { model_mm3, found }.into());
    };
    fitting(volume, model, (level, bodies), on_model_mm, task)
}

/// The same body at another level: the one whose middle is nearest.
fn at_level(volume: &Volume, body: &Body, level: f64, task: &Task<'_>) -> Result<Body, Cancelled> {
    let least_mm3 = body.moments.volume_mm3 / MOST_VOLUME;
    let off = |b: &Body| (b.moments.centre() - body.moments.centre()).norm();
    let found = bodies(volume, level, least_mm3, task)?.unwrap_or_default().into_iter();
    Ok(found.min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or_else(|| body.clone()))
}

/// The one body among several that fits.
fn fitting(
    volume: &Volume,
    model: &Model,
    (level, mut bodies): (f64, Vec<Body>),
    on_model_mm: f64,
    task: &Task<'_>,
) -> Result<(f64, Body, Registered), Error> {
    bodies.truncate(N_TRIED);
    let mut fits: Vec<(Body, Registered)> = Vec::new();
    let mut refusal = None;
    for body in bodies {
        let points = body.surface(volume, level, N_SEARCH);
        match register(model, &points, &body.moments, on_model_mm, task)? {
            Ok(registered) => fits.push((body, registered)),
            Err(error) => refusal = refusal.or(Some(error)),
        }
    }
    fits.sort_by(|a, b| a.1.off_mm.total_cmp(&b.1.off_mm));
    let is_second_good = fits.get(1).is_some_and(|f| f.1.off_mm < 2.0 * fits[0].1.off_mm + 0.05);
    match (fits.into_iter().next(), refusal) {
        (Some(_), _) if is_second_good => Err(Refusal::SeveralBodies.into()),
        (Some((body, registered)), _) => Ok((level, body, registered)),
        (None, Some(refusal)) => Err(refusal.into()),
        (None, None) => unreachable!("there is at least one body, and it fits or is refused"),
    }
}

/// Levels that may lie half-way between air and material: between the median, which is air, and the values that a replica of about
/// this volume (or something brighter beside it) reaches.
fn first_levels(volume: &Volume, model_mm3: f64) -> Vec<f64> {
    let [n_cols, n_rows, n_planes] = volume.dims;
    let n = n_cols * n_rows * n_planes;
    let every = n.div_ceil(N_SAMPLED).max(1);
    let mut values: Vec<f64> = Vec::with_capacity(n / every + 1);
    let mut next = every / 2;
    for k in 0..n_planes {
        let plane = volume.plane(k);
        while next < plane.len() {
            values.push(f64::from(plane[next]));
            next += every;
        }
        next -= plane.len();
    }
    values.retain(|v| v.is_finite());
    values.sort_by(f64::total_cmp);
    let (Some(first), Some(last)) = (volume.plane_z_mm.first(), volume.plane_z_mm.last()) else {
        return Vec::new();
    };
    let [dx, dy] = volume.pixel_spacing_xy_mm;
    let height_mm =
        (last - first).max(volume.slab_thickness_mm) * n_planes as f64 / (n_planes.max(2) - 1) as f64;
    let all_mm3 = dx * dy * (n_cols * n_rows) as f64 * height_mm;
    let part = (model_mm3 / all_mm3).min(0.5);
    let quantile = |part: f64| super::deviation::quantile(&values, part.clamp(0.0, 1.0));
    if values.is_empty() {
        return Vec::new();
    }
    let air = quantile(0.5);
    let mut levels: Vec<f64> = [0.2, 0.5, 1.5, 5.0].map(|of| 0.5 * (air + quantile(1.0 - of * part))).into();
    levels.dedup();
    levels
}
