//! A [`Volume`] to the [`Mask`] of the vessel's lumen.
//!
//! Region growing: every voxel inside an intensity window that is connected through voxel faces (6-neighbours)
//! to a seed, between two heights along the stack's normal. Where no window is given, every plane gets its own,
//! half-way between the level of the lumen and that of the wall around it, followed along the vessel from the seed
//! (`levels`, `follow`). A lumen may be brighter or darker than its wall; for a dark one the air around the
//! specimen is kept out (`grow`). What was grown is looked at before it counts as lumen: where it leaves the vessel,
//! it is refused with the place named, or, where nobody attends or the operator asks for it, cut off there with a warning (`guard`, `lumen`). The
//! operator's corrections are data ([`corrections`]). Without any seed, vessels are looked for ([`candidates`]).
//!
//! What it does not do: it does not close gaps in a wall.
//!
//! Cost: some visits per voxel of the region, plus three bits per voxel of the planes between the heights.
//!
//! ```
//! use lumenfab::{ct::{Volume, Voxels}, geom::{Point3, RigidTransform}, progress::Task, segment};
//! let disk = |i: usize, j: usize| if (i as f64 - 16.0).hypot(j as f64 - 16.0) < 6.0 { 300.0 } else { 0.0 };
//! let plane: Vec<f32> = (0..32 * 32).map(|p| disk(p % 32, p / 32)).collect();
//! let volume = Volume {
//!     dims: [32, 32, 3], hu: Voxels::new(&plane.repeat(3), 32 * 32),
//!     origin_xy_mm: [0.0, 0.0], pixel_spacing_xy_mm: [0.5, 0.5],
//!     plane_z_mm: vec![0.0, 1.0, 2.0], slab_thickness_mm: 1.0, patient_from_stack: RigidTransform::identity(),
//! };
//! let params = segment::Params { seeds_patient_mm: vec![Point3::new(8.0, 8.0, 1.0)], ..Default::default() };
//! let found = segment::segment(&volume, &params, &Task::quiet()).unwrap();
//! assert_eq!(found.polarity, segment::Polarity::Bright);
//! assert!(found.mask.contains(16, 16, 0) && !found.mask.contains(25, 16, 0));
//! ```

mod bits;
pub mod candidates;
pub mod corrections;
mod error;
mod follow;
mod graph;
mod grow;
mod guard;
mod levels;
mod lobes;
mod lumen;
pub mod mask;
mod noise;
pub mod picture;
mod plausible;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
mod windows;

pub use candidates::{Candidate, Found, find_unattended};
pub use corrections::Corrections;
pub use error::{Error, Leak, Place};
pub use guard::Beyond;
pub use levels::Levels;
pub use mask::Mask;

use crate::ct::{Volume, Warning};
use crate::geom::{Contour, Point3};
use crate::progress::Task;
use corrections::{Rules, doubts};
use grow::{Slab, Voxel};
use lumen::{Growth, Lumen};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::Range;
use windows::Chosen;

/// Whether the lumen is brighter or darker than its wall.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Polarity {
    /// The lumen is filled with contrast medium.
    Bright,
    /// The lumen is filled with air or an emptied specimen's medium.
    Dark,
    /// To be found out from the image.
    #[default]
    Auto,
}

/// What to segment.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Params {
    /// Points inside the lumen, patient frame (LPS), mm. At least one.
    pub seeds_patient_mm: Vec<Point3>,
    /// Lowest and highest intensity of the lumen, HU; `None`: found around the seeds.
    pub window_hu: Option<[f64; 2]>,
    /// Brighter or darker than the wall.
    pub polarity: Polarity,
    /// Lowest and highest plane along the stack's normal, mm, both included; `None`: all planes.
    pub z_mm: Option<[f64; 2]>,
    /// What the operator has corrected.
    pub corrections: Corrections,
    /// What is done where the region leaves the vessel.
    pub on_leak: OnLeak,
}

/// What is done where the region leaves the vessel or the vessel fades.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OnLeak {
    /// It is an error: the operator corrects it.
    #[default]
    Refuse,
    /// The vessel ends there, with a warning: nobody attends.
    Cut,
}

impl OnLeak {
    /// Whether it is what happens where nothing is said.
    #[must_use]
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// Where the window came from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum WindowSource {
    /// The operator gave it.
    Given,
    /// Found around the seeds, from these levels.
    Found(Levels),
}

/// The lumen as voxels.
#[derive(Debug, Clone, PartialEq)]
pub struct Segmentation {
    /// The voxels of the lumen.
    pub mask: Mask,
    /// The window at the first seed's plane, HU, both ends included.
    pub window_hu: [f64; 2],
    /// The window of each of the planes in which the lumen was found, HU.
    pub plane_windows_hu: Vec<[f64; 2]>,
    /// Where that window came from.
    pub window_source: WindowSource,
    /// By how much the planes were smoothed before the region was grown: standard deviation of a Gaussian, mm; 0 unless
    /// noise asked for it.
    pub smoothing_mm: f64,
    /// [`Polarity::Bright`] or [`Polarity::Dark`], never `Auto`.
    pub polarity: Polarity,
    /// What it was grown from: the seeds, and the pixels in every contour that the operator has drawn.
    pub seeds: Vec<Voxel>,
    /// The planes in which the lumen was found.
    pub planes: Range<usize>,
    /// Contours that the operator has drawn, by plane: they stand for what would be found there.
    pub drawn: BTreeMap<usize, Vec<Contour>>,
    /// What was odd but could be dealt with.
    pub warnings: Vec<Warning>,
}

impl Segmentation {
    /// +1 where the lumen is brighter than its wall, -1 where it is darker.
    #[must_use]
    pub fn sign(&self) -> f64 {
        if self.polarity == Polarity::Dark { -1.0 } else { 1.0 }
    }

    /// The end of the window that faces the wall, HU, at the first seed's plane: where the lumen ends.
    #[must_use]
    pub fn edge_hu(&self) -> f64 {
        self.edge_of(self.window_hu)
    }

    /// The same at plane k.
    #[must_use]
    pub fn edge_hu_at(&self, k: usize) -> f64 {
        let own = k.checked_sub(self.planes.start).and_then(|n| self.plane_windows_hu.get(n));
        self.edge_of(own.copied().unwrap_or(self.window_hu))
    }

    const fn edge_of(&self, [lo, hi]: [f64; 2]) -> f64 {
        if matches!(self.polarity, Polarity::Dark) { hi } else { lo }
    }
}

/// Grows the lumen from its seeds.
///
/// # Errors
/// [`Error`]: seeds or z range outside the volume, a window that selects nothing or not the seed, a correction that
/// does not fit the volume, a region that leaves the vessel (where that is refused) or covers fewer than two planes,
/// cancellation.
pub fn segment(volume: &Volume, params: &Params, task: &Task<'_>) -> Result<Segmentation, Error> {
    check_ranges(params)?;
    segment_in(volume, params, planes_in_range(volume, params.z_mm)?, task)
}

/// The same in these planes.
fn segment_in(
    volume: &Volume,
    params: &Params,
    asked: Range<usize>,
    task: &Task<'_>,
) -> Result<Segmentation, Error> {
    let rules = params.corrections.resolve(volume)?;
    let doubts = doubts::warnings(volume, &params.corrections);
    match grown(volume, params, rules, &asked, task) {
        Ok(mut found) => {
            found.warnings.extend(doubts);
            Ok(found)
        }
        Err(fault) => {
            let unused = doubts::unused(volume, &params.corrections, &asked);
            Err(fault.beside(doubts.into_iter().chain(unused).collect()))
        }
    }
}

/// The same under corrections that fit the volume.
fn grown(
    volume: &Volume,
    params: &Params,
    rules: Rules,
    asked: &Range<usize>,
    task: &Task<'_>,
) -> Result<Segmentation, Error> {
    let seeds = seed_voxels(volume, params, asked)?;
    refuse_corrected_seeds(volume, params, &rules, &seeds)?;
    task.report(0, 4);
    let Chosen { windows_hu, planes, source, smooth, mut warnings } =
        windows::choose(volume, params, &rules, asked, &seeds, task)?;
    let image = smooth.as_ref().map_or(volume, |s| &s.image);
    let slab = Slab { volume: image, planes, windows_hu, rules: &rules };
    let seeds = lumen::checked_seeds(&slab, params, &seeds, source)?;
    task.report(1, 4);
    let Lumen { grown, polarity, warnings: told } =
        Growth { slab: &slab, params, seeds: &seeds, source }.lumen(task)?;
    warnings.extend(told);
    warnings.extend(doubts::unused(volume, &params.corrections, &slab.planes));
    let mask = grown.into_mask(volume.dims);
    let covered = mask.planes();
    if covered.len() < 2 {
        let z_mm = volume.plane_z_mm[covered.start];
        return Err(Error::RegionTooFlat { found: covered.len(), z_mm });
    }
    warnings.extend(doubts::alone(&slab, &mask));
    warnings.extend(plausible::check(volume, &mask, params)?);
    warnings.extend(range_not_reached(volume, asked, &covered));
    task.report(4, 4);
    Ok(Segmentation {
        window_hu: slab.window_hu(seeds[0][2]),
        plane_windows_hu: covered.clone().map(|k| slab.window_hu(k)).collect(),
        mask,
        window_source: source,
        smoothing_mm: smooth.as_ref().map_or(0.0, |s| s.sigma_mm),
        polarity,
        seeds: [seeds, slab.drawn()].concat(),
        drawn: rules
            .drawn
            .into_iter()
            .filter(|(k, _)| covered.contains(k))
            .map(|(k, d)| (k, d.contours))
            .collect(),
        planes: covered,
        warnings,
    })
}

fn check_ranges(params: &Params) -> Result<(), Error> {
    if params.seeds_patient_mm.is_empty() {
        return Err(Error::NoSeed);
    }
    check_windows(params)
}

fn check_windows(params: &Params) -> Result<(), Error> {
    if let Some([lo, hi]) = params.window_hu.filter(is_empty) {
        return Err(Error::BadWindow { lo, hi });
    }
    if let Some([lo, hi]) = params.z_mm.filter(is_empty) {
        return Err(Error::BadZRange { lo, hi });
    }
    Ok(())
}

/// Whether no number lies between the ends; one that is no number leaves none.
fn is_empty(range: &[f64; 2]) -> bool {
    range[0].partial_cmp(&range[1]) != Some(std::cmp::Ordering::Less)
}

fn planes_in_range(volume: &Volume, z_mm: Option<[f64; 2]>) -> Result<Range<usize>, Error> {
    let z = &volume.plane_z_mm;
    let [lo, hi] = z_mm.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
    let planes = volume.planes_between([lo, hi]);
    match (z.first(), z.last()) {
        (Some(&first), Some(&last)) if planes.is_empty() => {
            Err(Error::NoPlaneInRange { lo, hi, first, last })
        }
        _ if planes.len() < 2 => Err(Error::TooFewPlanes { found: planes.len() }),
        _ => Ok(planes),
    }
}

fn seed_voxels(volume: &Volume, params: &Params, planes: &Range<usize>) -> Result<Vec<Voxel>, Error> {
    let stack_from_patient = volume.patient_from_stack.inverse();
    let voxel = |&seed: &Point3| {
        let in_stack = stack_from_patient.apply(seed);
        let Some(voxel) = volume.voxel_from_stack(in_stack) else {
            let (lo, hi) = extent_patient(volume);
            return Err(Error::SeedOutsideVolume { seed: Place(seed), lo: Place(lo), hi: Place(hi) });
        };
        if planes.contains(&voxel[2]) {
            return Ok(voxel);
        }
        let [lo, hi] = params.z_mm.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
        Err(Error::SeedOutsideZRange { seed: Place(seed), z_mm: in_stack.z, lo, hi })
    };
    params.seeds_patient_mm.iter().map(voxel).collect()
}

/// Refuses seeds that the operator's own corrections take away.
fn refuse_corrected_seeds(
    volume: &Volume,
    params: &Params,
    rules: &Rules,
    seeds: &[Voxel],
) -> Result<(), Error> {
    for (&[i, j, k], &place) in seeds.iter().zip(&params.seeds_patient_mm) {
        let (seed, z_mm) = (Place(place), volume.plane_z_mm[k]);
        match rules.drawn.get(&k) {
            Some(drawn) if drawn.mask.contains(i, j, k) => {}
            Some(_) => return Err(Error::SeedOutsideDrawn { seed, z_mm }),
            None => {
                if let Some(n) = rules.block_at(volume, [i, j, k]) {
                    return Err(Error::SeedBlocked { seed, block: n + 1 });
                }
            }
        }
    }
    Ok(())
}

/// The smallest LPS box around all voxels, their halves included.
fn extent_patient(volume: &Volume) -> (Point3, Point3) {
    let [nx, ny, nz] = volume.dims;
    let last = |n: usize| n as f64 - 0.5;
    let mut lo = Point3::new(f64::INFINITY, f64::INFINITY, f64::INFINITY);
    let mut hi = -lo;
    for corner in 0..8 {
        let pick = |bit: usize, n: usize| if corner & bit == 0 { -0.5 } else { last(n) };
        let k = if corner & 4 == 0 { 0 } else { nz - 1 };
        let mut p = volume.stack_from_voxel(pick(1, nx), pick(2, ny), k);
        p.z += if k == 0 { -0.5 } else { 0.5 } * volume.plane_interval_mm(k);
        let p = volume.patient_from_stack.apply(p);
        lo = lo.coords.inf(&p.coords).into();
        hi = hi.coords.sup(&p.coords).into();
    }
    (lo, hi)
}

fn range_not_reached(volume: &Volume, asked: &Range<usize>, covered: &Range<usize>) -> Option<Warning> {
    if asked == covered {
        return None;
    }
    let z = |planes: &Range<usize>| (volume.plane_z_mm[planes.start], volume.plane_z_mm[planes.end - 1]);
    let ((a, b), (c, d)) = (z(asked), z(covered));
    let text = format!("the lumen was found from z {c:.3} to {d:.3} mm only, {a:.3} to {b:.3} mm was asked");
    Some(Warning { code: "segment.range_not_reached".into(), text })
}
