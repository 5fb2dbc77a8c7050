//! Small synthetic volumes with known boundaries, for the tests of this stage and the next.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "intensities are single precision; a kernel has a few samples"
)]

use crate::ct::{Volume, Voxels};
use crate::geom::RigidTransform;

/// Sub-pixels per pixel and direction.
const FINE: usize = 5;

/// An image to be made: levels by place, blurred, with noise.
#[derive(Clone)]
pub(crate) struct Scene {
    pub(crate) n: [usize; 3],
    pub(crate) pixel_mm: [f64; 2],
    pub(crate) plane_mm: f64,
    pub(crate) blur_mm: f64,
    pub(crate) noise_hu: f64,
}

impl Default for Scene {
    fn default() -> Self {
        Self { n: [64, 56, 4], pixel_mm: [0.25, 0.25], plane_mm: 1.0, blur_mm: 0.3, noise_hu: 0.0 }
    }
}

impl Scene {
    /// Renders `level(x, y, k)`, HU at stack coordinates x, y of plane k; pixel (0, 0) is at the origin.
    pub(crate) fn volume(&self, level: impl Fn(f64, f64, usize) -> f64) -> Volume {
        let hu: Vec<f32> = (0..self.n[2]).flat_map(|k| self.plane(|x, y| level(x, y, k), k)).collect();
        Volume {
            dims: self.n,
            hu: Voxels::new(&hu, self.n[0] * self.n[1]),
            origin_xy_mm: [0.0, 0.0],
            pixel_spacing_xy_mm: self.pixel_mm,
            plane_z_mm: (0..self.n[2]).map(|k| self.plane_mm * k as f64).collect(),
            slab_thickness_mm: self.plane_mm,
            patient_from_stack: RigidTransform::identity(),
        }
    }

    fn plane(&self, level: impl Fn(f64, f64) -> f64, k: usize) -> Vec<f32> {
        let [nx, ny, _] = self.n;
        let step = self.pixel_mm.map(|p| p / FINE as f64);
        let at = |s: usize, d: usize| (s as f64 - (FINE / 2) as f64) * step[d];
        let (fx, fy) = (nx * FINE, ny * FINE);
        let fine: Vec<f64> = (0..fx * fy).map(|p| level(at(p % fx, 0), at(p / fx, 1))).collect();
        let rows = blurred(&fine, fx, 1, fx, fy, self.blur_mm / step[0]);
        let both = blurred(&rows, 1, fx, fy, fx, self.blur_mm / step[1]);
        let mut random = Random(k as u64 + 1);
        (0..nx * ny)
            .map(|p| {
                let (i, j) = ((p % nx) * FINE + FINE / 2, (p / nx) * FINE + FINE / 2);
                (both[j * fx + i] + self.noise_hu * random.normal()) as f32
            })
            .collect()
    }
}

/// Gaussian along one direction: `n_lines` lines `line` apart, of `n` values `step` apart.
fn blurred(values: &[f64], line: usize, step: usize, n: usize, n_lines: usize, sigma: f64) -> Vec<f64> {
    let half = (4.0 * sigma).ceil() as usize;
    let kernel: Vec<f64> =
        (0..=2 * half).map(|m| (-0.5 * ((m as f64 - half as f64) / sigma.max(1e-9)).powi(2)).exp()).collect();
    let sum: f64 = kernel.iter().sum();
    let mut out = vec![0.0; values.len()];
    for l in 0..n_lines {
        for i in 0..n {
            let tap = |m: usize| values[l * line + (i + m).saturating_sub(half).min(n - 1) * step];
            out[l * line + i * step] = kernel.iter().enumerate().map(|(m, w)| w * tap(m)).sum::<f64>() / sum;
        }
    }
    out
}

struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}
