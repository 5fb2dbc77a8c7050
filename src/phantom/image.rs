//! A vessel to the intensities of a synthetic CT.

use super::vessel::Field;
use super::{Error, Params, Tissue, Vessel, contours, to_nanometre};
use crate::ct::{Volume, Voxels};
use crate::geom::raster::{Canvas, PixelGrid, Window, blur_reach};
use crate::geom::{Bounds2, Contour, Point2, RigidTransform, Vector2};
use crate::progress::{Cancelled, Task};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Air around the body, HU.
const AIR_HU: f64 = -1000.0;
/// What 12 bits with an intercept of -1024 can hold, HU.
pub(super) const STORED_HU: [f64; 2] = [-1024.0, 3071.0];
/// Half axes of the body's elliptic section, mm.
const BODY_HALF_AXES_MM: [f64; 2] = [46.0, 41.0];
/// Most that two neighbouring sections of a slab lie apart, mm: their step is a tenth of a pixel where a branch leaves
/// its parent at 45 degrees.
const SLAB_STEP_MM: f64 = 0.25;
/// Vertices per contour: a chord of a 4 mm vessel then lies within 0.001 mm of its arc.
const CONTOUR_POINTS: usize = 192;

/// [`try_volume`] for parameters that are known to be good.
///
/// # Panics
/// Where [`try_volume`] fails.
#[must_use]
pub fn volume(params: &Params, task: &Task<'_>) -> Volume {
    try_volume(params, task).expect("the phantom's parameters are in range and the task is not interrupted")
}

/// The synthetic CT in whole HU; its stack is the patient's frame.
///
/// # Errors
/// [`Error::OutOfRange`] where a parameter is outside its range, [`Error::Cancelled`] on request.
pub fn try_volume(params: &Params, task: &Task<'_>) -> Result<Volume, Error> {
    if params.tilt_deg.abs() > 0.0 {
        return Err(Error::Tilted(params.tilt_deg));
    }
    let (hu, origin) = pixels(params, task)?;
    let n = params.n_pixels;
    Ok(Volume {
        dims: [n, n, params.n_planes],
        hu: Voxels::new(&hu, n * n),
        origin_xy_mm: [origin.x, origin.y],
        pixel_spacing_xy_mm: [params.pixel_mm; 2],
        plane_z_mm: params.plane_z_mm(),
        slab_thickness_mm: params.slab_mm,
        patient_from_stack: RigidTransform::identity(),
    })
}

/// The pixels of all planes in whole HU, and the place of the first pixel: along the plane, as if it were not tilted.
pub(super) fn pixels(params: &Params, task: &Task<'_>) -> Result<(Vec<f32>, Point2), Error> {
    params.check()?;
    let scan = Scan::new(params);
    let n = params.n_pixels;
    let plane_z_mm = params.plane_z_mm();
    let n_voxels = n * n * params.n_planes;
    let mut hu: Vec<f32> = Vec::new();
    hu.try_reserve_exact(n_voxels).map_err(|_refused| Error::NoMemory { n_voxels })?;
    hu.resize(n_voxels, 0.0);
    let done = AtomicU64::new(0);
    hu.par_chunks_exact_mut(n * n).zip(&plane_z_mm).enumerate().try_for_each(|(k, (plane, &z))| {
        task.check()?;
        scan.render(k, z, plane);
        task.report(done.fetch_add(1, Ordering::Relaxed) + 1, params.n_planes as u64);
        Ok::<(), Cancelled>(())
    })?;
    Ok((hu, scan.grid.origin))
}

/// What all planes of a scan share.
struct Scan<'a> {
    params: &'a Params,
    vessel: Vessel,
    tissue: Tissue,
    grid: PixelGrid,
    /// The image without the vessel, blurred, without noise.
    body: Vec<f64>,
}

impl<'a> Scan<'a> {
    fn new(params: &'a Params) -> Self {
        let vessel = Vessel::new(params.kind);
        let tissue = params.polarity.tissue();
        let corner = vessel.middle - Vector2::repeat(0.5 * (params.n_pixels - 1) as f64 * params.pixel_mm);
        let origin = Point2::new(to_nanometre(corner.x), to_nanometre(corner.y));
        let grid = PixelGrid { origin, pixel_mm: [params.pixel_mm; 2] };
        let body = body_image(params, grid, vessel.middle, tissue.around_hu);
        Self { params, vessel, tissue, grid, body }
    }

    fn render(&self, k: usize, z: f64, plane: &mut [f32]) {
        let mut clean = self.body.clone();
        self.add_vessel(z, &mut clean);
        let [least, most] = STORED_HU;
        let noise = Noise::new(self.params.seed, k);
        let in_pairs = plane.chunks_mut(2).zip(clean.chunks(2));
        for (pair, (pixels, clean)) in (0..).zip(in_pairs) {
            for ((pixel, clean), deviate) in pixels.iter_mut().zip(clean).zip(noise.pair(pair)) {
                // Adding zero turns -0 into 0: what is stored as an integer has no signed zero.
                let hu = (clean + self.params.noise_hu * deviate).round().clamp(least, most) + 0.0;
                #[expect(clippy::cast_possible_truncation, reason = "whole numbers of 12 bits are exact")]
                let stored = hu as f32;
                *pixel = stored;
            }
        }
    }

    /// Adds what the vessel changes in the image of the plane at height z.
    fn add_vessel(&self, z: f64, image: &mut [f64]) {
        let heights = self.slab_heights();
        if self.params.tilt_deg.abs() > 0.0 {
            let plane = self.vessel.oblique(z, self.params.tilt_deg.to_radians());
            self.add_sections(&heights.iter().map(|&h| plane.raised(h)).collect::<Vec<_>>(), image);
        } else {
            self.add_sections(
                &heights.iter().map(|&h| self.vessel.section(z + h)).collect::<Vec<_>>(),
                image,
            );
        }
    }

    fn add_sections(&self, sections: &[impl Field], image: &mut [f64]) {
        let wall = self.params.wall_mm;
        let reach = sections.iter().map(|s| s.bounds(wall)).reduce(Bounds2::union);
        let Some(window) = reach.and_then(|b| self.window(b)) else { return };
        let mut canvas = Canvas::new(self.grid, window);
        let share = 1.0 / sections.len() as f64;
        let Tissue { lumen_hu, wall_hu, around_hu } = self.tissue;
        let mut add = |level: f64, step_hu: f64| {
            for section in sections {
                let lines = contours::trace(section, level, contours::IMAGE_STEP_MM, CONTOUR_POINTS);
                canvas.add(&lines, step_hu * share);
            }
        };
        add(0.0, lumen_hu - wall_hu);
        #[expect(clippy::float_cmp, reason = "constants of the table: the wall shows or does not")]
        if wall_hu != around_hu {
            add(wall, wall_hu - around_hu);
        }
        let patch = canvas.into_image(self.params.psf_sigma_mm);
        add_patch(image, self.params.n_pixels, &patch, window);
    }

    /// The middles of equal parts of the slab, above the plane.
    fn slab_heights(&self) -> Vec<f64> {
        let slab = self.params.slab_mm;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "80 at most")]
        let n = ((slab / SLAB_STEP_MM).ceil() as usize).max(1);
        (0..n).map(|i| slab * ((i as f64 + 0.5) / n as f64 - 0.5)).collect()
    }

    /// The pixels that something within the bounds can reach through the blur; `None` where the image holds none.
    fn window(&self, bounds: Bounds2) -> Option<Window> {
        let reach = blur_reach(self.params.psf_sigma_mm, self.params.pixel_mm) as f64 + 1.0;
        let limit = self.params.n_pixels as f64 + reach;
        let (low, high) = (self.grid.position(bounds.min), self.grid.position(bounds.max));
        #[expect(clippy::cast_possible_truncation, reason = "clamped to the image and the blur's reach")]
        let first = low.map(|v| (v.floor() - reach).clamp(-reach, limit) as i64);
        #[expect(clippy::cast_possible_truncation, reason = "clamped to the image and the blur's reach")]
        let end = high.map(|v| (v.ceil() + reach).clamp(-reach, limit) as i64);
        let size = [0, 1].map(|a| usize::try_from(end[a] - first[a]).unwrap_or(0));
        (size[0] > 0 && size[1] > 0).then_some(Window { first, size })
    }
}

/// Tissue in air, blurred.
fn body_image(params: &Params, grid: PixelGrid, middle: Point2, tissue_hu: f64) -> Vec<f64> {
    let reach = blur_reach(params.psf_sigma_mm, params.pixel_mm);
    let margin = i64::try_from(reach).expect("some hundred pixels");
    let window = Window { first: [-margin; 2], size: [params.n_pixels + 2 * reach; 2] };
    let mut canvas = Canvas::new(grid, window);
    let unit = Contour::circle(Point2::origin(), 1.0, 2048);
    let [a, b] = BODY_HALF_AXES_MM;
    // A cylinder along z, longer where a tilted plane cuts it.
    let b = b / params.tilt_deg.to_radians().cos();
    let ellipse = unit.points.iter().map(|p| middle + Vector2::new(a * p.x, b * p.y)).collect();
    canvas.add(&[Contour::new(ellipse)], tissue_hu - AIR_HU);
    let mut image = vec![AIR_HU; params.n_pixels * params.n_pixels];
    add_patch(&mut image, params.n_pixels, &canvas.into_image(params.psf_sigma_mm), window);
    image
}

/// Adds the part of a patch that lies on the image.
fn add_patch(image: &mut [f64], n_pixels: usize, patch: &[f64], window: Window) {
    let [first_i, first_j] = window.first;
    for (j, row) in (first_j..).zip(patch.chunks_exact(window.size[0])) {
        let Some(j) = usize::try_from(j).ok().filter(|&j| j < n_pixels) else { continue };
        for (i, value) in (first_i..).zip(row) {
            if let Some(i) = usize::try_from(i).ok().filter(|&i| i < n_pixels) {
                image[j * n_pixels + i] += value;
            }
        }
    }
}

/// Standard normal deviates for the pixels of one plane, each from its position alone.
///
/// Uniform bits are SplitMix64 (Steele, Lea, Flood 2014) of seed, plane and pair of pixels; normal deviates come from
/// them in pairs after Box and Muller (1958).
struct Noise {
    key: u64,
}

impl Noise {
    fn new(seed: u64, plane: usize) -> Self {
        Self { key: split_mix(seed ^ split_mix(plane as u64 + 1)) }
    }

    fn pair(&self, pair: u64) -> [f64; 2] {
        let bits = split_mix(self.key.wrapping_add(pair));
        const STEP: f64 = 1.0 / 4_294_967_296.0;
        // Half a step up keeps the logarithm finite.
        let radial = ((bits >> 32) as f64 + 0.5) * STEP;
        let turn = (bits & 0xffff_ffff) as f64 * STEP;
        let radius = (-2.0 * radial.ln()).sqrt();
        let (sin, cos) = (turn * std::f64::consts::TAU).sin_cos();
        [radius * cos, radius * sin]
    }
}

fn split_mix(state: u64) -> u64 {
    let mut z = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
