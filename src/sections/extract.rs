//! Mask and grey values to smooth closed contours per CT plane.
//!
//! 1. The window's edge as an iso-line of the grey values inside the mask: the topology of every plane.
//! 2. The topology over the planes: fragments, islands, pinholes and one-plane flicker go, and are reported.
//! 3. The contours move to the half level between lumen and wall, measured on either side of them, and are
//!    corrected for what blur does to curved edges.
//! 4. Evenly spaced points from the leftmost one, outer contours counter-clockwise, holes clockwise.
//!
//! What it does not do: it does not smooth along the vessel; each plane is fitted for itself, only the levels
//! and the blur are medians over more than the plane.
//!
//! Limits: a structure narrower than about twice the blur has no half level of its own; its contour keeps to
//! the window's edge by at most three pixels.

use super::consistency::{self, Loop, Origin, Plane};
use super::curve::{evenly_spaced, n_points_for};
use super::refine::{self, Curve, EdgeSample, Image, Target};
use super::warnings::SectionWarnings;
use super::{PlaneSections, SectionStack, base};
use crate::ct::{Volume, Warning};
use crate::geom::{Contour, Region};
use crate::progress::{Cancelled, Task};
use crate::segment::{Levels, Segmentation};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicU64, Ordering};

/// More points make no contour better, they only cost.
const MOST_POINTS: usize = 2048;
/// Fewer edges than this tell nothing about a plane's levels.
const LEAST_EDGES: usize = 12;

/// Which grey value the boundary is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Boundary {
    /// Half-way between lumen and wall, measured along each contour.
    #[default]
    HalfLevel,
    /// The end of the window that faces the wall.
    WindowEdge,
}

/// How contours are made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Params {
    /// Most distance of a chord from the smooth contour, mm; decides the number of points.
    pub chord_tolerance_mm: f64,
    /// Fewest points per contour.
    pub least_points: usize,
    /// Which grey value the boundary is.
    pub boundary: Boundary,
}

impl Default for Params {
    fn default() -> Self {
        Self { chord_tolerance_mm: 1e-3, least_points: 128, boundary: Boundary::HalfLevel }
    }
}

/// The contours and what was odd about them.
#[derive(Debug, Clone, PartialEq)]
pub struct Extracted {
    /// Contours of all planes, ascending in z, each plane with at least one unless the vessel is interrupted.
    pub stack: SectionStack,
    /// What was dropped, bridged, split or filled, and where.
    pub warnings: Vec<Warning>,
}

/// Why there are no contours.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The tolerance is no length.
    #[error("chord tolerance {0} mm is no positive length: give one like 0.001")]
    BadTolerance(f64),
    /// Too few points make no contour.
    #[error("{found} points per contour are asked for, give {least} to {most}")]
    BadPointCount {
        /// What was asked.
        found: usize,
        /// Fewest.
        least: usize,
        /// Most.
        most: usize,
    },
    /// The mask belongs to another volume.
    #[error(
        "the mask reaches to voxel {mask:?}, the volume has {volume:?} and needs one more around the mask: segment this volume again"
    )]
    MaskOutsideVolume {
        /// One beyond the mask's last column, row and plane.
        mask: [usize; 3],
        /// Columns, rows and planes of the volume.
        volume: [usize; 3],
    },
    /// Nothing was left to build a body from.
    #[error(
        "contours were left in {found} planes only, at least 2 are needed ({dropped} fragments or islands were dropped): widen the window or the z range"
    )]
    TooFewPlanes {
        /// Planes with a contour.
        found: usize,
        /// How many warnings there were.
        dropped: usize,
    },
    /// Interrupted on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Extracts the contours of all planes of the segmentation.
///
/// Accuracy: on an edge blurred by a Gaussian, far below a tenth of a pixel without noise; noise of a tenth of
/// the contrast costs about a fifth of a pixel. The result does not depend on the number of threads.
///
/// # Errors
/// [`Error`]: parameters out of range, a mask of another volume, fewer than two planes left, cancellation.
pub fn extract(
    volume: &Volume,
    segmentation: &Segmentation,
    params: &Params,
    task: &Task<'_>,
) -> Result<Extracted, Error> {
    check(volume, segmentation, params)?;
    let mut warnings = SectionWarnings::default();
    let planes = topology(volume, segmentation, task, &mut warnings)?;
    let fitted = fit(volume, segmentation, params, &planes, task)?;
    let mut sections = Vec::with_capacity(planes.len());
    for (plane, Fitted { contours, n_crossing }) in planes.iter().zip(fitted) {
        if n_crossing > 0 {
            warnings.not_fitted(plane.z_mm, n_crossing);
        }
        sections.push(PlaneSections { z_mm: plane.z_mm, contours });
    }
    let stack = SectionStack { planes: sections, patient_from_stack: volume.patient_from_stack };
    Ok(Extracted { stack, warnings: warnings.into_warnings() })
}

fn check(volume: &Volume, segmentation: &Segmentation, params: &Params) -> Result<(), Error> {
    let tolerance = params.chord_tolerance_mm;
    if !(tolerance.is_finite() && tolerance > 0.0) {
        return Err(Error::BadTolerance(tolerance));
    }
    if !(8..=MOST_POINTS).contains(&params.least_points) {
        return Err(Error::BadPointCount { found: params.least_points, least: 8, most: MOST_POINTS });
    }
    let mask = &segmentation.mask;
    let (columns, rows, planes) = (mask.columns(), mask.rows(), mask.planes());
    let [nx, ny, nz] = volume.dims;
    let within = columns.start > 0 && rows.start > 0 && columns.end < nx && rows.end < ny && planes.end <= nz;
    if !within {
        return Err(Error::MaskOutsideVolume {
            mask: [columns.end, rows.end, planes.end],
            volume: volume.dims,
        });
    }
    Ok(())
}

/// The first contours of all planes with their topology resolved; empty planes at both ends cut off.
fn topology(
    volume: &Volume,
    segmentation: &Segmentation,
    task: &Task<'_>,
    warnings: &mut SectionWarnings,
) -> Result<Vec<Plane>, Error> {
    let [sx, sy] = volume.pixel_spacing_xy_mm;
    let first = |k: usize| {
        task.check()?;
        let contours = base::contours(volume, segmentation, k);
        let loops = contours.into_iter().map(|contour| Loop { contour, origin: Origin::Image }).collect();
        Ok(Plane { k, z_mm: volume.plane_z_mm[k], loops })
    };
    let mut planes: Vec<Plane> =
        segmentation.planes.clone().into_par_iter().map(first).collect::<Result<_, Cancelled>>()?;
    consistency::resolve(&mut planes, sx * sy, warnings);
    let found = planes.iter().filter(|p| !p.loops.is_empty()).count();
    if found < 2 {
        return Err(Error::TooFewPlanes { found, dropped: warnings.len() });
    }
    let start = planes.iter().position(|p| !p.loops.is_empty()).unwrap_or(0);
    let end = planes.iter().rposition(|p| !p.loops.is_empty()).map_or(0, |k| k + 1);
    let planes = planes.drain(start..end).collect::<Vec<Plane>>();
    for gap in planes.iter().filter(|p| p.loops.is_empty()) {
        warnings.gap(gap.z_mm);
    }
    Ok(planes)
}

struct Fitted {
    contours: Vec<Contour>,
    n_crossing: usize,
}

/// Runs `work` over all planes in parallel; the order of the results is that of the planes.
fn over_planes<P: Sync, T: Send>(
    planes: &[P],
    task: &Task<'_>,
    [from, to]: [u64; 2],
    work: impl Fn(&P) -> T + Sync,
) -> Result<Vec<T>, Cancelled> {
    let done = AtomicU64::new(0);
    let n = planes.len() as u64;
    let one = |plane: &P| {
        task.check()?;
        let result = work(plane);
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        task.report(from + (to - from) * done / n, 100);
        Ok(result)
    };
    planes.par_iter().map(one).collect()
}

fn fit(
    volume: &Volume,
    segmentation: &Segmentation,
    params: &Params,
    planes: &[Plane],
    task: &Task<'_>,
) -> Result<Vec<Fitted>, Cancelled> {
    let image = |plane: &Plane| Image::new(volume, plane.k, segmentation.sign());
    let edges = over_planes(planes, task, [10, 40], |plane| plane_edges(plane, &image(plane)))?;
    let stack = Pooled::of(edges.iter().flatten().flatten());
    let target = |edges: &[EdgeSample]| {
        let own = (edges.len() >= LEAST_EDGES).then(|| Pooled::of(edges.iter())).flatten();
        let pooled = own.or(stack)?;
        Some(Target { levels: pooled.levels, blur_mm: stack?.blur_mm })
    };
    let jobs: Vec<(&Plane, &Vec<Vec<EdgeSample>>)> = planes.iter().zip(&edges).collect();
    over_planes(&jobs, task, [40, 100], |&(plane, edges)| {
        let targets: Vec<Option<Target>> = match params.boundary {
            Boundary::HalfLevel => edges.iter().map(|e| target(e)).collect(),
            Boundary::WindowEdge => vec![None; edges.len()],
        };
        fit_plane(plane, &image(plane), &targets, params)
    })
}

fn plane_edges(plane: &Plane, image: &Image<'_>) -> Vec<Vec<EdgeSample>> {
    let of = |l: &Loop| refine::edge_samples(&Curve::new(&l.contour, image.pixel_mm()), image);
    plane.loops.iter().map(of).collect()
}

/// Robust summary of many edges.
#[derive(Debug, Clone, Copy)]
struct Pooled {
    levels: Levels,
    blur_mm: f64,
}

impl Pooled {
    fn of<'a>(edges: impl Iterator<Item = &'a EdgeSample> + Clone) -> Option<Self> {
        let pick =
            |value: fn(&EdgeSample) -> f64, share: f64| quantile(edges.clone().map(value).collect(), share);
        Some(Self {
            levels: Levels { lumen_hu: pick(|e| e.lumen, 0.5)?, wall_hu: pick(|e| e.wall, 0.5)? },
            // Oblique walls are smeared by the slab as well: the sharper edges show the blur in the plane.
            blur_mm: pick(|e| e.blur_mm, 0.25)?,
        })
    }
}

fn quantile(mut values: Vec<f64>, share: f64) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index into the values")]
    let at = ((values.len() - 1) as f64 * share).round() as usize;
    Some(*values.select_nth_unstable_by(at, f64::total_cmp).1)
}

fn fit_plane(plane: &Plane, image: &Image<'_>, targets: &[Option<Target>], params: &Params) -> Fitted {
    let first = |l: &Loop| Curve::new(&l.contour, image.pixel_mm());
    let fitted = |(l, target): (&Loop, &Option<Target>)| match target {
        Some(target) if l.origin != Origin::Made => refine::fitted(first(l), image, *target),
        _ => first(l),
    };
    let fitted: Vec<Contour> =
        plane.loops.iter().zip(targets).map(|pair| finished(&fitted(pair), params)).collect();
    if are_simple(&fitted) {
        return Fitted { contours: ordered(fitted), n_crossing: 0 };
    }
    let smooth: Vec<Contour> = plane.loops.iter().map(|l| finished(&first(l), params)).collect();
    let raw = || plane.loops.iter().map(|l| unsmoothed(&l.contour, params)).collect();
    let contours = if are_simple(&smooth) { smooth } else { raw() };
    Fitted { contours: ordered(contours), n_crossing: plane.loops.len() }
}

fn finished(curve: &Curve, params: &Params) -> Contour {
    let n = n_points_for(&curve.points, params.chord_tolerance_mm, params.least_points, MOST_POINTS);
    evenly_spaced(&curve.points, n)
}

/// The iso-line itself, its points spread evenly: never crosses another.
fn unsmoothed(contour: &Contour, params: &Params) -> Contour {
    let n = contour.len().clamp(params.least_points, MOST_POINTS);
    let leftmost = (0..contour.len()).min_by(|&a, &b| contour.points[a].x.total_cmp(&contour.points[b].x));
    let mut points = contour.points.clone();
    points.rotate_left(leftmost.unwrap_or(0));
    Contour::new(points).resampled(n)
}

/// Whether no contour crosses itself or another: then their even-odd region has just these contours.
fn are_simple(contours: &[Contour]) -> bool {
    let region = Region::from_even_odd(contours);
    let area: f64 = contours.iter().map(Contour::signed_area_mm2).sum();
    let length: f64 = contours.iter().map(Contour::perimeter_mm).sum();
    // The grid of the boolean operations moves each point by up to 10 nm.
    region.contours.len() == contours.len() && (region.area_mm2() - area).abs() < 2e-5 * length + 1e-9
}

/// Outer contours and holes from left to right.
fn ordered(mut contours: Vec<Contour>) -> Vec<Contour> {
    let key = |c: &Contour| c.points.first().map_or((0.0, 0.0), |p| (p.x, p.y));
    contours.sort_by(|a, b| key(a).0.total_cmp(&key(b).0).then(key(a).1.total_cmp(&key(b).1)));
    contours
}
