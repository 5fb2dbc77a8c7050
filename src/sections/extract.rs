//! Mask and grey values to smooth closed contours per CT plane.
//!
//! 1. The window's edge as an iso-line of the grey values inside the mask: the topology of every plane.
//!    Where the operator has drawn a plane's contours, these stand instead, and nothing moves or drops them.
//! 2. The topology over the planes: fragments, islands, pinholes and one-plane flicker go, and what has lost its
//!    connection to the seeds' vessel, all of which is reported.
//! 3. The contours move to the half level between lumen and wall, measured on either side of them, and are
//!    corrected for what blur does to curved edges; unless a window's edge or the half level was asked for, they go on
//!    from there to the likeliest cause of the image, smoothed along the vessel as far as the noise asks for.
//! 4. Evenly spaced points from the leftmost one, outer contours counter-clockwise, holes clockwise.
//!
//! What it does not do: the half level and the window's edge are not smoothed along the vessel; there each plane is fitted
//! for itself, only the levels and the blur are medians over more than the plane.
//!
//! Limits: a structure narrower than about twice the blur has no half level of its own; its contour keeps to
//! the window's edge by at most three pixels.

use super::consistency::{self, Loop, Origin, Plane};
use super::detached;
use super::fit::{Fitted, Stack, WindowOffset};
use super::warnings::SectionWarnings;
use super::{PlaneSections, SectionStack, base, spikes};
use crate::ct::{Volume, Warning};
use crate::geom::Point2;
use crate::progress::{Cancelled, Task};
use crate::segment::Segmentation;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// More points make no contour better, they only cost.
pub(super) const MOST_POINTS: usize = 1024;
/// A window's edge that puts contours further off than this is told, pixels.
const BIASED_PIXELS: f64 = 0.25;

/// Which grey value the boundary is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Boundary {
    /// As the window was chosen: where the operator gave one, its edge, else the model's.
    #[default]
    Auto,
    /// The likeliest cause of the image under a model of it, smoothed as far as the noise asks for.
    Model,
    /// Half-way between lumen and wall, measured along each contour, corrected for the blur of curved edges.
    HalfMaximum,
    /// Where the grey value falls most steeply, found by a closed active contour, corrected for the blur of curved edges.
    Snake,
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
        Self { chord_tolerance_mm: 1e-3, least_points: 128, boundary: Boundary::Auto }
    }
}

impl Params {
    pub(super) fn check(&self) -> Result<(), Error> {
        let tolerance = self.chord_tolerance_mm;
        if !(tolerance.is_finite() && tolerance > 0.0) {
            return Err(Error::BadTolerance(tolerance));
        }
        if !(8..=MOST_POINTS).contains(&self.least_points) {
            return Err(Error::BadPointCount { found: self.least_points, least: 8, most: MOST_POINTS });
        }
        Ok(())
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

impl Error {
    /// A stable name for programs.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::BadTolerance(_) => "sections.bad_tolerance",
            Self::BadPointCount { .. } => "sections.bad_point_count",
            Self::MaskOutsideVolume { .. } => "sections.mask_outside_volume",
            Self::TooFewPlanes { .. } => "sections.too_few_planes",
            Self::Cancelled(_) => "sections.cancelled",
        }
    }
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
    let fit = Stack { volume, segmentation, params, planes: &planes, task };
    let fitted = fit.fit()?;
    let biased = fit.window_offset().and_then(|offset| window_bias(offset, volume));
    let mut sections = Vec::with_capacity(planes.len());
    for (plane, Fitted { contours, n_crossing, n_unmodelled, n_parted }) in planes.iter().zip(fitted) {
        if n_crossing > 0 {
            warnings.not_fitted(plane.z_mm, n_crossing);
        }
        if n_unmodelled > 0 {
            warnings.not_modelled(plane.z_mm, n_unmodelled);
        }
        if n_parted > 0 {
            warnings.parted(plane.z_mm, n_parted);
        }
        sections.push(PlaneSections { z_mm: plane.z_mm, contours });
    }
    spikes::tell(&sections, &volume.patient_from_stack, &mut warnings);
    let stack = SectionStack { planes: sections, patient_from_stack: volume.patient_from_stack };
    let warnings = warnings.into_warnings().into_iter().chain(biased).collect();
    Ok(Extracted { stack, warnings })
}

/// Says where a window's edge is not the lumen's.
fn window_bias(offset: WindowOffset, volume: &Volume) -> Option<Warning> {
    let [sx, sy] = volume.pixel_spacing_xy_mm;
    let WindowOffset { edge_hu, half_hu, outside_mm } = offset;
    let side = if outside_mm > 0.0 { "outside" } else { "inside" };
    let text = format!(
        "the window ends at {edge_hu:.0} HU, while lumen and wall meet half-way at {half_hu:.0} HU: contours at the window's edge lie about {:.2} mm {side} the lumen's; --boundary model puts them on it",
        outside_mm.abs()
    );
    (outside_mm.abs() > BIASED_PIXELS * (sx * sy).sqrt()).then(|| Warning::new("sections.window_edge", text))
}

fn check(volume: &Volume, segmentation: &Segmentation, params: &Params) -> Result<(), Error> {
    params.check()?;
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
        let (contours, origin) = match segmentation.drawn.get(&k) {
            Some(drawn) => (drawn.clone(), Origin::Drawn),
            None => (base::contours(volume, segmentation, k), Origin::Image),
        };
        let loops = contours.into_iter().map(|contour| Loop { contour, origin }).collect();
        Ok(Plane { k, z_mm: volume.plane_z_mm[k], loops })
    };
    let mut planes: Vec<Plane> =
        segmentation.planes.clone().into_par_iter().map(first).collect::<Result<_, Cancelled>>()?;
    consistency::resolve(&mut planes, sx * sy, warnings);
    let place = |&[i, j, k]: &[usize; 3]| {
        let p = volume.stack_from_voxel(i as f64, j as f64, k);
        (k, Point2::new(p.x, p.y))
    };
    let seeds: Vec<detached::Seed> = segmentation.seeds.iter().map(place).collect();
    detached::drop_detached(&mut planes, &seeds, warnings);
    consistency::without_empty_ends(planes, warnings)
}
