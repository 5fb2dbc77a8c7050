//! A [`Volume`] to the [`Mask`] of the vessel's lumen.
//!
//! Region growing: every voxel inside an intensity window that is connected through voxel faces (6-neighbours)
//! to a seed, between two heights along the stack's normal. Where no window is given, every plane gets its own,
//! half-way between the level of the lumen and that of the wall around it, followed along the vessel from the seed
//! (`levels`, `follow`). A lumen may be brighter or darker than its wall; for a dark one the air around the
//! specimen is kept out (`grow`). What was grown is looked at before it counts as lumen: where it leaves the vessel,
//! it is refused with the place named, or, where nobody attends, cut off there with a warning (`guard`). The
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
pub mod mask;
mod noise;
pub mod picture;
mod plausible;
#[cfg(test)]
pub(crate) mod testing;
#[cfg(test)]
mod tests;

pub use candidates::{Candidate, Found, find_unattended};
pub use corrections::Corrections;
pub use error::{Error, Leak, Place};
pub use guard::Beyond;
pub use levels::Levels;
pub use mask::Mask;

use crate::ct::{Volume, Warning};
use crate::geom::{Contour, Point3};
use crate::progress::Task;
use corrections::Rules;
use grow::{Grown, Slab, Voxel};
use guard::Site;
use noise::Noise;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::Range;

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
    let seeds = seed_voxels(volume, params, &asked)?;
    refuse_corrected_seeds(volume, params, &rules, &seeds)?;
    task.report(0, 4);
    let Chosen { windows_hu, planes, source, smooth, mut warnings } =
        choose_windows(volume, params, &rules, &asked, &seeds, task)?;
    let image = smooth.as_ref().map_or(volume, |s| &s.image);
    let slab = Slab { volume: image, planes, windows_hu, rules: &rules };
    let seeds = checked_seeds(&slab, params, &seeds, source)?;
    task.report(1, 4);
    let mut lumen = grow_lumen(&slab, params, &seeds, source, task)?;
    task.report(2, 4);
    warnings.append(&mut lumen.warnings);
    let (grown, cut) =
        without_leaks(&slab, params, &seeds, lumen.grown, lumen.air.as_ref(), lumen.polarity, task)?;
    warnings.extend(cut);
    let mask = grown.into_mask(volume.dims);
    let covered = mask.planes();
    if covered.len() < 2 {
        let z_mm = volume.plane_z_mm[covered.start];
        return Err(Error::RegionTooFlat { found: covered.len(), z_mm });
    }
    warnings.extend(plausible::check(volume, &mask, params.seeds_patient_mm[0])?);
    warnings.extend(range_not_reached(volume, &asked, &covered));
    task.report(4, 4);
    Ok(Segmentation {
        window_hu: slab.window_hu(seeds[0][2]),
        plane_windows_hu: covered.clone().map(|k| slab.window_hu(k)).collect(),
        mask,
        window_source: source,
        smoothing_mm: smooth.as_ref().map_or(0.0, |s| s.sigma_mm),
        polarity: lumen.polarity,
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

struct Chosen {
    windows_hu: Vec<[f64; 2]>,
    /// The planes that are used.
    planes: Range<usize>,
    source: WindowSource,
    /// What the region is grown in, where the image is too noisy.
    smooth: Option<Smooth>,
    warnings: Vec<Warning>,
}

/// A smoothed copy of the image.
struct Smooth {
    image: Volume,
    sigma_mm: f64,
}

impl Smooth {
    fn of(volume: &Volume, sigma_mm: f64, task: &Task<'_>) -> Result<Option<Self>, Error> {
        if sigma_mm <= 0.0 {
            return Ok(None);
        }
        Ok(Some(Self { image: noise::smoothed(volume, sigma_mm, task)?, sigma_mm }))
    }
}

fn choose_windows(
    volume: &Volume,
    params: &Params,
    rules: &Rules,
    asked: &Range<usize>,
    seeds: &[Voxel],
    task: &Task<'_>,
) -> Result<Chosen, Error> {
    let corrected = |k: usize, found: [f64; 2]| rules.window_hu(k).unwrap_or(found);
    check_polarity(volume, params, seeds)?;
    if let Some(window_hu) = params.window_hu {
        let windows_hu = asked.clone().map(|k| corrected(k, window_hu)).collect();
        return Ok(Chosen {
            windows_hu,
            planes: asked.clone(),
            source: WindowSource::Given,
            smooth: None,
            warnings: Vec::new(),
        });
    }
    let seed = params.seeds_patient_mm[0];
    let levels = levels::find(volume, seeds, params.polarity).ok_or_else(|| Error::NoContrast {
        seed: Place(seed),
        reach_mm: levels::REACH_MM,
        least_hu: levels::least_step_hu(volume, seeds),
    })?;
    let noise = Noise::around(volume, seeds, levels).looked_at_closer(volume, seeds[0], params.polarity);
    let mut warnings: Vec<Warning> = noise.check(seed)?.into_iter().collect();
    let smooth = Smooth::of(volume, noise.smoothing_mm(volume, seeds), task)?;
    let image = smooth.as_ref().map_or(volume, |s| &s.image);
    let followed = follow::follow(image, asked, rules, seeds, levels, task)?;
    // Where somebody attends, or has said which planes, the lumen is looked for in all of them.
    let may_shorten = params.on_leak == OnLeak::Cut && params.z_mm.is_none() && followed.clear.len() > 1;
    let planes = if may_shorten { followed.clear.clone() } else { asked.clone() };
    let windows_hu =
        planes.clone().map(|k| corrected(k, followed.levels[k - asked.start].window_hu())).collect();
    warnings.extend(faded(volume, asked, &planes));
    Ok(Chosen { windows_hu, planes, source: WindowSource::Found(levels), smooth, warnings })
}

/// Refuses a polarity that the image around the seeds contradicts: no wall of the kind, and one of the other.
fn check_polarity(volume: &Volume, params: &Params, seeds: &[Voxel]) -> Result<(), Error> {
    let (asked, other, found) = match params.polarity {
        Polarity::Auto => return Ok(()),
        Polarity::Bright => ("bright", Polarity::Dark, "darker"),
        Polarity::Dark => ("dark", Polarity::Bright, "brighter"),
    };
    if levels::find(volume, seeds, params.polarity).is_some() {
        return Ok(());
    }
    levels::find(volume, seeds, other).map_or(Ok(()), |Levels { lumen_hu, wall_hu }| {
        Err(Error::OtherPolarity { seed: Place(params.seeds_patient_mm[0]), asked, found, lumen_hu, wall_hu })
    })
}

/// Says where the vessel has faded.
fn faded(volume: &Volume, asked: &Range<usize>, used: &Range<usize>) -> Option<Warning> {
    let z = |k: usize| format!("z {:.3} mm", volume.plane_z_mm[k]);
    let below = (used.start > asked.start).then(|| format!("below {}", z(used.start)));
    let above = (used.end < asked.end).then(|| format!("above {}", z(used.end - 1)));
    let places: Vec<String> = below.into_iter().chain(above).collect();
    let text = format!("the vessel's contrast fades {}: it ends there", places.join(" and "));
    (!places.is_empty()).then(|| Warning::new("segment.faded", text))
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
    let checked = |(seed, &place): (&Voxel, &Point3)| {
        let [lo, hi] = slab.window_hu(seed[2]);
        stand_in(seed).ok_or_else(|| match slab.value_range_unless_selected() {
            Some([least, most]) => Error::WindowSelectsNothing { lo, hi, least, most },
            None => Error::SeedOutsideWindow { seed: Place(place), hu: slab.hu(*seed), lo, hi },
        })
    };
    seeds.iter().zip(&params.seeds_patient_mm).map(checked).collect()
}

/// A grown region before it was looked at.
struct Lumen {
    grown: Grown,
    /// The air around a specimen.
    air: Option<Grown>,
    polarity: Polarity,
    warnings: Vec<Warning>,
}

fn grow_lumen(
    slab: &Slab<'_>,
    params: &Params,
    seeds: &[Voxel],
    source: WindowSource,
    task: &Task<'_>,
) -> Result<Lumen, Error> {
    let known = match (params.polarity, source) {
        (Polarity::Auto, WindowSource::Found(levels)) => levels.polarity(),
        (polarity, _) => polarity,
    };
    let from = [seeds, &slab.drawn()].concat();
    let grown = grow::grow(slab, &from, None, task)?;
    let Some(leak) = grown.leak else {
        let polarity = if known == Polarity::Auto { grow::polarity_at_rim(slab, &grown) } else { known };
        return Ok(Lumen { grown, air: None, polarity, warnings: Vec::new() });
    };
    let around_seed = || levels::find(slab.volume, seeds, Polarity::Auto).map(Levels::polarity);
    let polarity = if known == Polarity::Auto { around_seed().unwrap_or(known) } else { known };
    if polarity != Polarity::Dark {
        // A lumen that is neither brighter nor darker than anything is the background; for a bright one the way to
        // the border is looked for.
        return if polarity == Polarity::Bright {
            Ok(Lumen { grown, air: None, polarity, warnings: Vec::new() })
        } else {
            Err(border_error(slab, &grown, leak))
        };
    }
    let air = grow::outside_air(slab, task)?;
    if seeds.iter().any(|&s| air.holds(slab, s)) {
        return Err(border_error(slab, &grown, leak));
    }
    let grown = grow::grow(slab, &from, Some(&air), task)?;
    if let Some(leak) = grown.leak {
        return Err(border_error(slab, &grown, leak));
    }
    let text = format!(
        "the lumen is open to the air around the specimen (reached in plane {}, z {:.3} mm); what is connected to the image border within its plane was taken as outside",
        leak[2], slab.volume.plane_z_mm[leak[2]]
    );
    Ok(Lumen { grown, air: Some(air), polarity, warnings: vec![Warning::new("segment.outside_air", text)] })
}

/// Refuses a region that leaves the vessel, or cuts off what lies beyond.
fn without_leaks(
    slab: &Slab<'_>,
    params: &Params,
    seeds: &[Voxel],
    grown: Grown,
    air: Option<&Grown>,
    polarity: Polarity,
    task: &Task<'_>,
) -> Result<(Grown, Option<Warning>), Error> {
    let sign = if polarity == Polarity::Dark { -1.0 } else { 1.0 };
    let guard::Inspected { leaks, mut removed } = guard::inspect(slab, &grown, seeds, sign);
    task.check()?;
    // What lies behind a passage tells more than the border that is reached through it.
    let tells = |l: &Site| l.into != Beyond::Border;
    let widest = leaks.iter().max_by(|a, b| tells(a).cmp(&tells(b)).then(a.neck_mm.total_cmp(&b.neck_mm)));
    let Some(widest) = widest else {
        return match grown.leak {
            Some(at) => Err(border_error(slab, &grown, at)),
            None => Ok((grown, None)),
        };
    };
    if params.on_leak == OnLeak::Refuse || seeds.iter().any(|&s| removed.holds(slab, s)) {
        return Err(leak_error(slab, &grown, widest));
    }
    if let Some(air) = air {
        removed.add(air);
    }
    let kept = grow::grow(slab, &[seeds, &slab.drawn()].concat(), Some(&removed), task)?;
    if let Some(leak) = kept.leak {
        return Err(border_error(slab, &kept, leak));
    }
    Ok((kept, Some(cut_off(slab, &leaks))))
}

/// Of many leaks so many are named.
const NAMED_LEAKS: usize = 6;

fn cut_off(slab: &Slab<'_>, leaks: &[Site]) -> Warning {
    let place = |leak: &Site| {
        let (z_mm, place) = place_of(slab, leak.at);
        format!(
            "plane {} (z {z_mm:.3} mm) at {place} into {}, {:.1} mm wide",
            leak.at[2], leak.into, leak.neck_mm
        )
    };
    let mut by_width: Vec<&Site> = leaks.iter().collect();
    by_width.sort_by(|a, b| b.neck_mm.total_cmp(&a.neck_mm));
    let mut named: Vec<String> = by_width.iter().take(NAMED_LEAKS).map(|l| place(l)).collect();
    if leaks.len() > NAMED_LEAKS {
        named.push(format!("and {} narrower ones", leaks.len() - NAMED_LEAKS));
    }
    Warning::new(
        "segment.leak_cut",
        format!("the region was cut off where it left the vessel: {}", named.join("; ")),
    )
}

fn place_of(slab: &Slab<'_>, [i, j, k]: Voxel) -> (f64, Place) {
    let in_stack = slab.volume.stack_from_voxel(i as f64, j as f64, k);
    (in_stack.z, Place(slab.volume.patient_from_stack.apply(in_stack)))
}

fn leak_error(slab: &Slab<'_>, grown: &Grown, site: &Site) -> Error {
    let (z_mm, place) = place_of(slab, site.at);
    let [_, _, k] = site.at;
    let into = (site.into != Beyond::Border).then_some((site.into, site.neck_mm));
    let region = grown.mask_of_plane(slab, k);
    let leak = Leak { voxel: site.at, z_mm, place, window_hu: slab.window_hu(k), into, region };
    Error::Leaks(Box::new(leak))
}

fn border_error(slab: &Slab<'_>, grown: &Grown, at: Voxel) -> Error {
    leak_error(slab, grown, &Site { at, into: Beyond::Border, neck_mm: 0.0 })
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
