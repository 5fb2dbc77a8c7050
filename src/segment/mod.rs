//! A [`Volume`] to the [`Mask`] of the vessel's lumen.
//!
//! Region growing: every voxel inside an intensity window that is connected through voxel faces (6-neighbours)
//! to a seed, between two heights along the stack's normal. Where no window is given, one is put half-way
//! between the lumen's level around the seed and the level of the wall around it ([`levels`]). A lumen may be
//! brighter or darker than its wall; for a dark one the air around the specimen is kept out ([`grow`]).
//!
//! What it does not do: it does not close gaps in a wall. A region that runs out to the border of the image is
//! refused with the place named, because such a mask is never a lumen.
//!
//! Cost: one visit per voxel of the region, plus one byte per voxel of the planes between the heights.
//!
//! ```
//! use lumenfab::{ct::Volume, geom::{Point3, RigidTransform}, progress::Task, segment};
//! let disk = |i: usize, j: usize| if (i as f64 - 16.0).hypot(j as f64 - 16.0) < 6.0 { 300.0 } else { 0.0 };
//! let plane: Vec<f32> = (0..32 * 32).map(|p| disk(p % 32, p / 32)).collect();
//! let volume = Volume {
//!     dims: [32, 32, 3], hu: plane.repeat(3), origin_xy_mm: [0.0, 0.0], pixel_spacing_xy_mm: [0.5, 0.5],
//!     plane_z_mm: vec![0.0, 1.0, 2.0], slab_thickness_mm: 1.0, patient_from_stack: RigidTransform::identity(),
//! };
//! let params = segment::Params { seeds_patient_mm: vec![Point3::new(8.0, 8.0, 1.0)], ..Default::default() };
//! let found = segment::segment(&volume, &params, &Task::quiet()).unwrap();
//! assert_eq!(found.polarity, segment::Polarity::Bright);
//! assert!(found.mask.contains(16, 16, 0) && !found.mask.contains(25, 16, 0));
//! ```

pub mod grow;
pub mod levels;
pub mod mask;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;

pub use levels::Levels;
pub use mask::Mask;

use crate::ct::{Volume, Warning};
use crate::geom::Point3;
use crate::progress::{Cancelled, Task};
use grow::{Grown, Leak, Slab, Voxel};
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Heights that are written with three decimals still meet their plane.
const HEIGHT_SLACK_MM: f64 = 1e-3;

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
    /// The window that was used, HU, both ends included.
    pub window_hu: [f64; 2],
    /// Where that window came from.
    pub window_source: WindowSource,
    /// [`Polarity::Bright`] or [`Polarity::Dark`], never `Auto`.
    pub polarity: Polarity,
    /// The planes in which the lumen was found.
    pub planes: Range<usize>,
    /// What was odd but could be dealt with.
    pub warnings: Vec<Warning>,
}

impl Segmentation {
    /// +1 where the lumen is brighter than its wall, -1 where it is darker.
    #[must_use]
    pub fn sign(&self) -> f64 {
        if self.polarity == Polarity::Dark { -1.0 } else { 1.0 }
    }

    /// The end of the window that faces the wall, HU: where the lumen ends.
    #[must_use]
    pub fn edge_hu(&self) -> f64 {
        if self.polarity == Polarity::Dark { self.window_hu[1] } else { self.window_hu[0] }
    }
}

/// Why there is no mask. Coordinates are patient LPS, mm, unless they say otherwise.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// No seed at all.
    #[error("no seed was given: give a point inside the lumen with --seed-mm X,Y,Z (patient LPS, mm)")]
    NoSeed,
    /// The window is empty or not a number.
    #[error("window {lo} to {hi} HU is empty: give --window-hu LOW,HIGH with LOW below HIGH")]
    BadWindow {
        /// Lower end.
        lo: f64,
        /// Upper end.
        hi: f64,
    },
    /// The z range is empty or not a number.
    #[error("z range {lo} to {hi} mm is empty: give --z-mm LOW,HIGH with LOW below HIGH")]
    BadZRange {
        /// Lower end.
        lo: f64,
        /// Upper end.
        hi: f64,
    },
    /// The seed is not in the image.
    #[error(
        "seed {seed} lies outside the volume, which extends from {lo} to {hi} mm (patient LPS): give a seed inside the lumen"
    )]
    SeedOutsideVolume {
        /// The seed.
        seed: Place,
        /// Smallest coordinates of the volume's box.
        lo: Place,
        /// Largest coordinates of the volume's box.
        hi: Place,
    },
    /// The seed's plane is not between the heights.
    #[error(
        "seed {seed} lies at z {z_mm:.3} mm along the stack, outside the z range {lo} to {hi} mm: move the seed or widen --z-mm"
    )]
    SeedOutsideZRange {
        /// The seed.
        seed: Place,
        /// Its height in the stack frame, mm.
        z_mm: f64,
        /// Lower end of the range, mm.
        lo: f64,
        /// Upper end of the range, mm.
        hi: f64,
    },
    /// The seed is not lumen by the window.
    #[error(
        "seed {seed} has {hu:.0} HU, outside the window {lo:.0} to {hi:.0} HU: put the seed inside the lumen or widen --window-hu"
    )]
    SeedOutsideWindow {
        /// The seed.
        seed: Place,
        /// Value of its voxel, HU.
        hu: f64,
        /// Lower end of the window.
        lo: f64,
        /// Upper end of the window.
        hi: f64,
    },
    /// No voxel of the planes lies in the window.
    #[error(
        "window {lo:.0} to {hi:.0} HU selects nothing: the planes hold values from {least:.0} to {most:.0} HU, change --window-hu"
    )]
    WindowSelectsNothing {
        /// Lower end of the window.
        lo: f64,
        /// Upper end of the window.
        hi: f64,
        /// Smallest value of the planes, HU.
        least: f64,
        /// Largest value of the planes, HU.
        most: f64,
    },
    /// No window was given and none could be found.
    #[error(
        "no wall was found within {reach_mm:.0} mm of seed {seed}: put the seed inside the lumen or give --window-hu LOW,HIGH"
    )]
    NoContrast {
        /// The first seed.
        seed: Place,
        /// How far was searched, mm.
        reach_mm: f64,
    },
    /// The region runs out of the image.
    #[error(
        "the region leaks to the image border in plane {plane} (z {z_mm:.3} mm) at {place} (window {lo:.0} to {hi:.0} HU): narrow --window-hu or --z-mm, or move the seed"
    )]
    LeaksToBorder {
        /// Index of the plane, from 0.
        plane: usize,
        /// Height of the plane in the stack frame, mm.
        z_mm: f64,
        /// The voxel at the border.
        place: Place,
        /// Lower end of the window.
        lo: f64,
        /// Upper end of the window.
        hi: f64,
    },
    /// The z range misses every plane.
    #[error(
        "no plane lies between z {lo} and {hi} mm: the planes reach from {first:.3} to {last:.3} mm, change --z-mm"
    )]
    NoPlaneInRange {
        /// Lower end of the range, mm.
        lo: f64,
        /// Upper end of the range, mm.
        hi: f64,
        /// Lowest plane, mm.
        first: f64,
        /// Highest plane, mm.
        last: f64,
    },
    /// The z range holds one plane only.
    #[error("only {found} plane lies in the z range, at least 2 are needed: widen --z-mm")]
    TooFewPlanes {
        /// How many were found.
        found: usize,
    },
    /// The region does not leave the seed's plane.
    #[error(
        "the region covers only {found} plane (z {z_mm:.3} mm), at least 2 are needed: widen --window-hu or move the seed"
    )]
    RegionTooFlat {
        /// How many planes it covers.
        found: usize,
        /// Height of the lowest of them, mm.
        z_mm: f64,
    },
    /// Interrupted on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// A point in patient coordinates (LPS, mm), printed with one micrometre's digits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place(pub Point3);

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "({:.3}, {:.3}, {:.3})", self.0.x, self.0.y, self.0.z)
    }
}

/// Grows the lumen from its seeds.
///
/// # Errors
/// [`Error`]: seeds or z range outside the volume, a window that selects nothing or not the seed, a region that
/// leaks to the border of the image or covers fewer than two planes, cancellation.
pub fn segment(volume: &Volume, params: &Params, task: &Task<'_>) -> Result<Segmentation, Error> {
    check_ranges(params)?;
    let planes = planes_in_range(volume, params.z_mm)?;
    let seeds = seed_voxels(volume, params, &planes)?;
    task.report(0, 3);
    let chosen = choose_window(volume, params, &seeds)?;
    let slab = Slab { volume, planes: planes.clone(), window_hu: chosen.window_hu };
    let seeds = checked_seeds(&slab, params, &seeds, chosen.source)?;
    task.report(1, 3);
    let (grown, polarity, mut warnings) = grow_lumen(&slab, params, &seeds, &chosen, task)?;
    task.report(2, 3);
    let mask = grown.into_mask(volume.dims);
    let covered = mask.planes();
    if covered.len() < 2 {
        let z_mm = volume.plane_z_mm[covered.start];
        return Err(Error::RegionTooFlat { found: covered.len(), z_mm });
    }
    warnings.extend(range_not_reached(volume, &planes, &covered));
    task.report(3, 3);
    Ok(Segmentation {
        mask,
        window_hu: chosen.window_hu,
        window_source: chosen.source,
        polarity,
        planes: covered,
        warnings,
    })
}

fn check_ranges(params: &Params) -> Result<(), Error> {
    if params.seeds_patient_mm.is_empty() {
        return Err(Error::NoSeed);
    }
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
    let start = z.partition_point(|&p| p < lo - HEIGHT_SLACK_MM);
    let end = z.partition_point(|&p| p <= hi + HEIGHT_SLACK_MM);
    match (z.first(), z.last()) {
        (Some(&first), Some(&last)) if start >= end => Err(Error::NoPlaneInRange { lo, hi, first, last }),
        _ if end - start < 2 => Err(Error::TooFewPlanes { found: end - start }),
        _ => Ok(start..end),
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

struct Chosen {
    window_hu: [f64; 2],
    source: WindowSource,
}

fn choose_window(volume: &Volume, params: &Params, seeds: &[Voxel]) -> Result<Chosen, Error> {
    if let Some(window_hu) = params.window_hu {
        return Ok(Chosen { window_hu, source: WindowSource::Given });
    }
    let levels = levels::find(volume, seeds, params.polarity)
        .ok_or(Error::NoContrast { seed: Place(params.seeds_patient_mm[0]), reach_mm: levels::REACH_MM })?;
    Ok(Chosen { window_hu: levels.window_hu(), source: WindowSource::Found(levels) })
}

/// The seeds as voxels inside the window. With a found window a neighbour may stand in for a seed that noise
/// has thrown out of it; a given window is taken at its word.
fn checked_seeds(
    slab: &Slab<'_>,
    params: &Params,
    seeds: &[Voxel],
    source: WindowSource,
) -> Result<Vec<Voxel>, Error> {
    let stand_in = |&seed: &Voxel| match source {
        WindowSource::Given => slab.selects(seed).then_some(seed),
        WindowSource::Found(_) => slab.selected_near(seed),
    };
    let [lo, hi] = slab.window_hu;
    let checked = |(seed, &place): (&Voxel, &Point3)| {
        stand_in(seed).ok_or_else(|| match slab.value_range_unless_selected() {
            Some([least, most]) => Error::WindowSelectsNothing { lo, hi, least, most },
            None => Error::SeedOutsideWindow { seed: Place(place), hu: slab.hu(*seed), lo, hi },
        })
    };
    seeds.iter().zip(&params.seeds_patient_mm).map(checked).collect()
}

fn grow_lumen(
    slab: &Slab<'_>,
    params: &Params,
    seeds: &[Voxel],
    chosen: &Chosen,
    task: &Task<'_>,
) -> Result<(Grown, Polarity, Vec<Warning>), Error> {
    let known = match (params.polarity, chosen.source) {
        (Polarity::Auto, WindowSource::Found(levels)) => levels.polarity(),
        (polarity, _) => polarity,
    };
    let leak = match grow::grow(slab, seeds, None, task)? {
        Ok(grown) => {
            let polarity = if known == Polarity::Auto { grow::polarity_at_rim(slab, &grown) } else { known };
            return Ok((grown, polarity, Vec::new()));
        }
        Err(leak) => leak,
    };
    let around_seed = || levels::find(slab.volume, seeds, Polarity::Auto).map(Levels::polarity);
    let polarity = if known == Polarity::Auto { around_seed().unwrap_or(known) } else { known };
    if polarity != Polarity::Dark {
        return Err(leak_error(slab, leak));
    }
    let air = grow::outside_air(slab, task)?;
    if seeds.iter().any(|&s| air.holds(slab, s)) {
        return Err(leak_error(slab, leak));
    }
    let grown = grow::grow(slab, seeds, Some(&air), task)?.map_err(|leak| leak_error(slab, leak))?;
    let text = format!(
        "the lumen is open to the air around the specimen (reached in plane {}, z {:.3} mm); what is connected to the image border within its plane was taken as outside",
        leak.0[2], slab.volume.plane_z_mm[leak.0[2]]
    );
    Ok((grown, polarity, vec![Warning { code: "segment.outside_air".into(), text }]))
}

fn leak_error(slab: &Slab<'_>, Leak([i, j, k]): Leak) -> Error {
    let in_stack = slab.volume.stack_from_voxel(i as f64, j as f64, k);
    let [lo, hi] = slab.window_hu;
    let place = Place(slab.volume.patient_from_stack.apply(in_stack));
    Error::LeaksToBorder { plane: k, z_mm: in_stack.z, place, lo, hi }
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
