//! The model as a surface to be registered to: its sections at close heights, and between them what is linear in height.
//!
//! The distance of a place from a skin is that in the plane, interpolated between the sections below and above, over the length of
//! its gradient (1 along the normal in the plane, its change with height across it). So a wall that stands obliquely has its true
//! distance and its true normal, to first order. The flat ends count as well.

use super::body::Moments;
use crate::geom::{Contour, Point2, Point3, Region, SegmentIndex, Vector2, Vector3};
use crate::report::BodyKind;
use crate::report::image::{curvature_per_mm, drawn_inward_mm, outward};
use crate::solid::{CrossSection, Sectioned};
use nalgebra::Matrix3;
use rayon::prelude::*;

/// Distance of the sections, mm.
const STEP_MM: f64 = 0.4;
/// Chord error of the sections, mm.
const TOLERANCE_MM: f64 = 2e-3;
/// Distance of the vertices of a skin, mm.
const VERTEX_MM: f64 = 0.2;
/// A distance that changes faster with height than this belongs to no skin: there the lumen divides or ends.
const STEEPEST: f64 = 3.0;
/// Least cosine between the normal in the scan and that of the skin it may lie on.
const SAME_SIDE: f64 = 0.4;
/// The section at an end is taken so far within, mm.
const WITHIN_MM: f64 = 1e-3;

/// A place's distance from the model and the normal there.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hit {
    /// Outside positive, mm.
    pub(super) distance_mm: f64,
    /// Unit length, out of the material.
    pub(super) normal: Vector3,
    /// 1 for the skin that it lies on: the outer one, the lumen's; an end is neither.
    pub(super) on_skin: [f64; 2],
}

/// The outlines of one skin at one height.
#[derive(Debug)]
struct Skin {
    contours: Vec<Contour>,
    index: SegmentIndex,
    /// 1 where the region is the material's outside, -1 where it is the lumen in it.
    sign: f64,
}

#[derive(Debug)]
struct Slice {
    skins: [Option<Skin>; 2],
}

/// The model.
#[derive(Debug)]
pub(super) struct Model {
    slices: Vec<Slice>,
    z_mm: [f64; 2],
    step_mm: f64,
    pub(super) moments: Moments,
}

/// What a place is given: the skin's distance in the plane and its normal.
type InPlane = (f64, Vector2);

impl Model {
    /// The skins of a solid as a scanner with this blur shows them (standard deviation, mm): convex parts a little within,
    /// concave ones a little without.
    pub(super) fn of(solid: &dyn Sectioned, body: BodyKind, blur_mm: f64) -> Self {
        let [low, high] = solid.z_range_mm();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the height of a part")]
        let n = ((high - low) / STEP_MM).ceil().max(2.0) as usize;
        let step_mm = (high - low) / n as f64;
        let sections: Vec<CrossSection> = (0..=n)
            .into_par_iter()
            .map(|i| {
                let z_mm = (low + step_mm * i as f64).clamp(low + WITHIN_MM, high - WITHIN_MM);
                solid.section(z_mm, TOLERANCE_MM)
            })
            .collect();
        let mut moments = Moments::default();
        for (i, section) in sections.iter().enumerate() {
            let share = if i == 0 || i == n { 0.5 * step_mm } else { step_mm };
            let material = if body == BodyKind::Cast { section.outer.clone() } else { section.material() };
            add_moments(&mut moments, &material, low + step_mm * i as f64, share);
        }
        let slice = |section: &CrossSection| {
            let lumen = (body == BodyKind::Wall).then_some(&section.lumen);
            Slice {
                skins: [
                    Skin::of(&section.outer, 1.0, blur_mm),
                    lumen.and_then(|l| Skin::of(l, -1.0, blur_mm)),
                ],
            }
        };
        let slices = sections.par_iter().map(slice).collect();
        Self { slices, z_mm: [low, high], step_mm, moments }
    }

    /// Corners of the box around it, mm.
    pub(super) fn corners(&self) -> Vec<Point3> {
        let points = self.slices.iter().flat_map(|s| s.skins.iter().flatten()).flat_map(|s| &s.contours);
        let Some(bounds) = points.filter_map(Contour::bounds).reduce(crate::geom::Bounds2::union) else {
            return Vec::new();
        };
        let xs = [bounds.min.x, bounds.max.x];
        let ys = [bounds.min.y, bounds.max.y];
        let at = |i: usize| Point3::new(xs[i & 1], ys[i >> 1 & 1], self.z_mm[i >> 2]);
        (0..8).map(at).collect()
    }

    /// Places on the outer skin with their normals, so many a section, at every `every`-th section.
    pub(super) fn outer_places(&self, every: usize, n_each: usize) -> Vec<(Point3, Vector3)> {
        let n = self.slices.len();
        let inner = (1..n.saturating_sub(1)).step_by(every.max(1));
        let of_slice = |i: usize| {
            let z_mm = self.z_mm[0] + self.step_mm * i as f64;
            let contours = self.slices[i].skins[0].iter().flat_map(|s| &s.contours);
            let places = contours.flat_map(|c| c.resampled(n_each).points);
            places.filter_map(move |p| {
                let p = Point3::new(p.x, p.y, z_mm);
                Some((p, self.skin(0, p)?.normal))
            })
        };
        inner.flat_map(of_slice).collect()
    }

    /// The thickness of the wall at a place of the outer skin along its normal, mm; `None` without a lumen near.
    pub(super) fn wall_mm(&self, (p, normal): (Point3, Vector3)) -> Option<f64> {
        // The lumen's skin has the opposite normal: its distance, seen from outside, is the wall.
        let hit = self.skin(1, p)?;
        (hit.normal.dot(&normal) < -0.8).then_some(-hit.distance_mm)
    }

    /// The skin or end whose normal agrees with `normal` and that is nearest.
    pub(super) fn near(&self, q: Point3, normal: Vector3) -> Option<Hit> {
        let hits = [self.skin(0, q), self.skin(1, q), self.end(q, 0), self.end(q, 1)];
        let fits = hits.into_iter().flatten().filter(|h| h.normal.dot(&normal) > SAME_SIDE);
        fits.min_by(|a, b| a.distance_mm.abs().total_cmp(&b.distance_mm.abs()))
    }

    fn skin(&self, which: usize, q: Point3) -> Option<Hit> {
        let at = ((q.z - self.z_mm[0]) / self.step_mm).clamp(0.0, (self.slices.len() - 1) as f64);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the slices")]
        let below = (at as usize).min(self.slices.len() - 2);
        let part = at - below as f64;
        let in_plane = |i: usize| self.slices[i].skins[which].as_ref().map(|s| s.at(q.xy()));
        let ((d0, n0), (d1, n1)) = (in_plane(below)?, in_plane(below + 1)?);
        let beyond = q.z < self.z_mm[0] || q.z > self.z_mm[1];
        let slope = if beyond { 0.0 } else { (d1 - d0) / self.step_mm };
        if slope.abs() > STEEPEST {
            return None;
        }
        let flat = n0 * (1.0 - part) + n1 * part;
        let length = flat.norm();
        if length < 0.5 {
            return None;
        }
        let steep = (1.0 + slope * slope).sqrt();
        let normal = Vector3::new(flat.x / length, flat.y / length, slope) / steep;
        let on_skin = if which == 0 { [1.0, 0.0] } else { [0.0, 1.0] };
        Some(Hit { distance_mm: (d0 + (d1 - d0) * part) / steep, normal, on_skin })
    }

    /// The flat end below (0) or above (1), where the place lies over the part.
    fn end(&self, q: Point3, which: usize) -> Option<Hit> {
        let sign = if which == 0 { -1.0 } else { 1.0 };
        let slice = if which == 0 { self.slices.first() } else { self.slices.last() }?;
        let is_within = slice.skins.iter().flatten().all(|s| s.at(q.xy()).0 < 0.0);
        (is_within && slice.skins[0].is_some()).then(|| Hit {
            distance_mm: sign * (q.z - self.z_mm[which]),
            normal: Vector3::z() * sign,
            on_skin: [0.0; 2],
        })
    }
}

impl Skin {
    fn of(region: &Region, sign: f64, blur_mm: f64) -> Option<Self> {
        let seen = |c: &Contour| {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "the length of an outline"
            )]
            let n = (c.perimeter_mm() / VERTEX_MM).ceil().max(12.0) as usize;
            let points = c.resampled(n).points;
            let moved = |i: usize| {
                let by_mm = drawn_inward_mm(blur_mm, curvature_per_mm(&points, i, 4));
                points[i] - outward(&points, i, 1) * by_mm
            };
            Contour::new((0..n).map(moved).collect())
        };
        let contours: Vec<Contour> = region.contours.iter().filter(|c| c.len() > 2).map(seen).collect();
        let index = SegmentIndex::try_new(&contours)?;
        Some(Self { contours, index, sign })
    }

    /// Signed distance in the plane, positive out of the material, and the normal.
    fn at(&self, p: Point2) -> InPlane {
        let foot = self.index.nearest(p);
        let points = &self.contours[foot.contour_idx].points;
        let (a, b) = (points[foot.edge_idx], points[(foot.edge_idx + 1) % points.len()]);
        let along = b - a;
        let right = Vector2::new(along.y, -along.x) / along.norm().max(f64::MIN_POSITIVE);
        let signed = if self.index.contains(p) { -foot.distance_mm } else { foot.distance_mm };
        (self.sign * signed, right * self.sign)
    }
}

/// Adds a slab of a region, `height_mm` thick about `z_mm`, by the integrals over polygons (Green's theorem).
fn add_moments(moments: &mut Moments, region: &Region, z_mm: f64, height_mm: f64) {
    let (mut area, mut first, mut second) = (0.0, Vector2::zeros(), [0.0; 3]);
    for (a, b) in region.contours.iter().flat_map(Contour::edges) {
        let cross = a.coords.perp(&b.coords);
        area += cross / 2.0;
        first += (a.coords + b.coords) * (cross / 6.0);
        second[0] += cross * (a.x * a.x + a.x * b.x + b.x * b.x) / 12.0;
        second[1] += cross * (a.y * a.y + a.y * b.y + b.y * b.y) / 12.0;
        second[2] += cross * (a.x * b.y + 2.0 * a.x * a.y + 2.0 * b.x * b.y + b.x * a.y) / 24.0;
    }
    let [xx, yy, xy] = second;
    let (xz, yz, zz) = (first.x * z_mm, first.y * z_mm, area * z_mm * z_mm);
    let matrix = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    let all = Vector3::new(first.x, first.y, area * z_mm);
    moments.add(area * height_mm, all * height_mm, matrix * height_mm);
}
