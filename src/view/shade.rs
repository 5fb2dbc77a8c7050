//! What samples see to colours: linear light, clamped and encoded as sRGB at the end.

use super::raster::{Camera, Seen};
use super::{Paint, Scene};
use crate::geom::Vector3;
use rayon::prelude::*;

/// Materials, linear light: the outer wall, the lumen, cut material.
const WALL: [f32; 3] = [0.80, 0.71, 0.60];
const LUMEN: [f32; 3] = [0.62, 0.13, 0.10];
const CUT: [f32; 3] = [0.86, 0.52, 0.40];
/// Background, top and bottom.
const SKY: [[f32; 3]; 2] = [[0.96, 0.97, 0.98], [0.80, 0.83, 0.87]];
/// Towards the lights, in the frame of whoever looks: right, up, towards them.
const KEY: [f64; 3] = [-0.45, 0.55, 0.70];
const FILL: [f64; 3] = [0.75, -0.10, 0.55];
/// How far around a surface others keep light away, mm, and samples in one ring of directions.
const REACH_MM: [f64; 2] = [0.9, 2.6];
const DIRECTIONS: usize = 8;
/// A step in depth, mm, at which an edge is drawn.
const EDGE_MM: f32 = 0.8;

/// Colours of all samples.
pub(super) fn shade(
    scene: &Scene<'_>,
    normals: &[[Vector3; 3]],
    camera: &Camera,
    seen: &[Seen],
) -> Vec<[f32; 3]> {
    let width = camera.size[0] as usize;
    let shader = Shader { scene, normals, camera, seen, width, lights: [KEY, FILL].map(unit) };
    seen.par_iter().enumerate().map(|(i, s)| shader.colour(i, s)).collect()
}

/// A linear value as a byte of sRGB (IEC 61966-2-1).
pub(super) fn byte(linear: f32) -> u8 {
    let v = linear.clamp(0.0, 1.0);
    let encoded = if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let byte = (encoded * 255.0).round() as u8;
    byte
}

fn linear(byte: u8) -> f32 {
    let v = f32::from(byte) / 255.0;
    if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

fn unit(v: [f64; 3]) -> Vector3 {
    Vector3::from(v).try_normalize(0.0).unwrap_or_default()
}

struct Shader<'a> {
    scene: &'a Scene<'a>,
    normals: &'a [[Vector3; 3]],
    camera: &'a Camera,
    seen: &'a [Seen],
    width: usize,
    lights: [Vector3; 2],
}

impl Shader<'_> {
    fn colour(&self, i: usize, seen: &Seen) -> [f32; 3] {
        let row = (i / self.width) as f32 / self.camera.size[1] as f32;
        let behind = mix(SKY[0], SKY[1], row);
        if seen.triangle == u32::MAX {
            return behind;
        }
        let normal = self.normal(seen);
        let lit = if seen.is_back {
            // The cut's own plane, towards whoever looks.
            CUT.map(|c| 0.9 * c)
        } else {
            self.lit(self.base(seen), normal, self.openness(i, seen, normal))
        };
        lit.map(|c| c * self.edge(i, seen))
    }

    /// The normal in the frame of whoever looks, turned towards them.
    fn normal(&self, seen: &Seen) -> Vector3 {
        let corners = &self.normals[seen.triangle as usize];
        let [w1, w2] = seen.weights.map(f64::from);
        let n = corners[0] * (1.0 - w1 - w2) + corners[1] * w1 + corners[2] * w2;
        let [right, up, away] = self.camera.axes;
        let n = unit([n.dot(&right), n.dot(&up), -n.dot(&away)]);
        if n.z < 0.0 { -n } else { n }
    }

    fn base(&self, seen: &Seen) -> [f32; 3] {
        match &self.scene.paint {
            Paint::Skins { is_lumen } => {
                if is_lumen[seen.triangle as usize] {
                    LUMEN
                } else {
                    WALL
                }
            }
            Paint::Values { values, scale, .. } => {
                let t = self.scene.mesh.triangles[seen.triangle as usize];
                let [w1, w2] = seen.weights.map(f64::from);
                let [a, b, c] = t.map(|v| values[v as usize]);
                scale.colour(a * (1.0 - w1 - w2) + b * w1 + c * w2).map(linear)
            }
        }
    }

    fn lit(&self, base: [f32; 3], n: Vector3, open: f32) -> [f32; 3] {
        let [key, fill] = self.lights;
        // Light that wraps a little round the form: a shadow's border is soft.
        let wrapped = |l: Vector3| ((n.dot(&l) + 0.12) / 1.12).max(0.0);
        let from_above = 0.5 + 0.5 * n.y;
        let ambient = narrow(0.20 + 0.14 * from_above) * open;
        let diffuse = narrow(0.76 * wrapped(key) + 0.18 * wrapped(fill)) * (0.4 + 0.6 * open);
        let half = unit([key.x, key.y, key.z + 1.0]);
        let gloss = 0.10 * narrow(n.dot(&half).max(0.0).powi(36)) * open;
        // Surfaces that turn away are darker: the form is read from its rim.
        let rim = narrow((n.z / 0.45).min(1.0));
        let rim = 0.62 + 0.38 * rim * (2.0 - rim);
        base.map(|c| (c * (ambient + diffuse) + gloss) * rim)
    }

    /// The part of the light from everywhere that near surfaces let through (after Shanmugam and Arikan, *Hardware Accelerated
    /// Ambient Occlusion Techniques on GPUs*, 2007).
    fn openness(&self, i: usize, seen: &Seen, n: Vector3) -> f32 {
        let (col, row) = (i % self.width, i / self.width);
        // Neighbouring samples look in other directions; their mean looks in all.
        let turn = ((col % 2) + 2 * (row % 2)) as f64 / 4.0;
        let mut hidden = 0.0;
        for (ring, reach_mm) in REACH_MM.into_iter().enumerate() {
            for k in 0..DIRECTIONS {
                let angle = std::f64::consts::TAU * (k as f64 + turn + 0.5 * ring as f64) / DIRECTIONS as f64;
                hidden += self.hidden_by(col, row, seen, n, angle, reach_mm);
            }
        }
        let mean = hidden / (REACH_MM.len() * DIRECTIONS) as f64;
        narrow((1.0 - 1.5 * mean).clamp(0.15, 1.0))
    }

    /// How much the surface that is seen at some distance in the picture stands in the light.
    fn hidden_by(&self, col: usize, row: usize, seen: &Seen, n: Vector3, angle: f64, reach_mm: f64) -> f64 {
        let reach = reach_mm * self.camera.samples_per_mm;
        let (sin, cos) = angle.sin_cos();
        let [x, y] = [col as f64 + reach * cos, row as f64 - reach * sin];
        if x < 0.0 || y < 0.0 {
            return 0.0;
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "not negative")]
        let (x, y) = (x as usize, y as usize);
        if x >= self.width {
            return 0.0;
        }
        let Some(other) = self.seen.get(y * self.width + x).filter(|s| s.depth.is_finite()) else {
            return 0.0;
        };
        let towards = Vector3::new(reach * cos, reach * sin, f64::from(seen.depth - other.depth));
        let distance = towards.norm();
        let lean = (n.dot(&towards) / distance - 0.08).max(0.0);
        // What stands far before it casts no shadow that one would expect.
        lean * (2.0 - distance / (2.0 * reach)).clamp(0.0, 1.0)
    }

    /// Darker where something nearer or farther begins.
    fn edge(&self, i: usize, seen: &Seen) -> f32 {
        let (col, row) = (i % self.width, i / self.width);
        #[expect(clippy::cast_possible_truncation, reason = "a small number")]
        let step = EDGE_MM * self.camera.samples_per_mm as f32;
        let around = [(-1_isize, 0_isize), (1, 0), (0, -1), (0, 1)];
        let is_edge = around.into_iter().any(|(dx, dy)| {
            let place = col.checked_add_signed(dx).zip(row.checked_add_signed(dy));
            let inside = place.filter(|&(x, y)| x < self.width && y * self.width < self.seen.len());
            // Only on the nearer side: the line is one sample wide.
            inside.is_some_and(|(x, y)| self.seen[y * self.width + x].depth - seen.depth > step)
        });
        if is_edge { 0.35 } else { 1.0 }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "light")]
fn narrow(v: f64) -> f32 {
    v as f32
}

fn mix(a: [f32; 3], b: [f32; 3], share: f32) -> [f32; 3] {
    [0, 1, 2].map(|k| a[k] * (1.0 - share) + b[k] * share)
}
