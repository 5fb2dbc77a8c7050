//! Analytic vessels: generalised tubes along z, joined by a smooth minimum.
//!
//! A tube is a graph over z: centreline (x(z), y(z)) and radius(z), measured in the horizontal plane, with
//! angular ripples that make its sections less than perfectly round. Its field is rho - R, the signed radial
//! coordinate. Tubes are joined in order by the quadratic smooth minimum (I. Quilez)
//! min(a, b) - max(k - |a - b|, 0)^2 / (4 k), which rounds the crotch of a split. Inside is F < 0.
//!
//! F is no distance: it grows by about one per mm beside a tube, less in a crotch. Patient frame (LPS), mm.

use super::spline::NaturalSpline;
use super::{Kind, anatomy, contours};
use crate::geom::{Bounds2, Point2, Point3, Region, Vector2};

/// A wave of the radius around the tube: radius * (1 + amplitude * cos(order * angle - phase - twist * z)).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ripple {
    pub(super) order: i32,
    pub(super) amplitude: f64,
    pub(super) phase_rad: f64,
    pub(super) twist_rad_per_mm: f64,
}

/// A local narrowing: radius * (1 - depth * exp(-((z - z_mm) / width_mm)^2)).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Narrowing {
    pub(super) z_mm: f64,
    pub(super) width_mm: f64,
    pub(super) depth: f64,
}

/// One tube.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tube {
    pub(super) x: NaturalSpline,
    pub(super) y: NaturalSpline,
    pub(super) radius: NaturalSpline,
    pub(super) narrowing: Option<Narrowing>,
    pub(super) ripples: &'static [Ripple],
}

impl Tube {
    /// Mean radius at height z, mm.
    pub(super) fn radius_at(&self, z: f64) -> f64 {
        let narrowed =
            self.narrowing.map_or(1.0, |n| 1.0 - n.depth * (-((z - n.z_mm) / n.width_mm).powi(2)).exp());
        // Far beyond the table the straight continuation could reach zero.
        (self.radius.at(z) * narrowed).max(0.05)
    }

    fn section(&self, z: f64) -> TubeSection {
        let wave = |r: &Ripple| {
            let (sin, cos) = (r.phase_rad + r.twist_rad_per_mm * z).sin_cos();
            Wave { order: r.order, cos: r.amplitude * cos, sin: r.amplitude * sin }
        };
        TubeSection {
            centre: Point2::new(self.x.at(z), self.y.at(z)),
            radius: self.radius_at(z),
            waves: self.ripples.iter().map(wave).collect(),
        }
    }
}

/// An analytic vessel lumen.
#[derive(Debug, Clone, PartialEq)]
pub struct Vessel {
    pub(super) tubes: Vec<Tube>,
    /// k of the smooth minimum, mm.
    pub(super) blend_radius_mm: f64,
    /// Where the middle of a synthetic image is put, mm.
    pub(super) middle: Point2,
}

impl Vessel {
    /// The vessel of the given kind, 0..138 mm in z and continued straight beyond.
    #[must_use]
    pub fn new(kind: Kind) -> Self {
        anatomy::vessel(kind)
    }

    /// The implicit function: negative in the lumen, about 1 per mm beside it.
    #[must_use]
    pub fn value(&self, p: Point3) -> f64 {
        self.section(p.z).value(Point2::new(p.x, p.y))
    }

    /// The exact lumen at height `z_mm`: contours of `n_points` vertices (at least 3) that lie on F = 0 within 1e-9 mm,
    /// evenly spaced by arc length from the one of least x; outer contours counter-clockwise, holes clockwise,
    /// sorted by mean x. Parts and gaps narrower than 0.05 mm may be missed.
    #[must_use]
    pub fn region_at(&self, z_mm: f64, n_points: usize) -> Region {
        Region::new(contours::trace(&self.section(z_mm), 0.0, contours::EXACT_STEP_MM, n_points))
    }

    /// Centre of the vessel's first tube at height `z_mm`: always in the lumen.
    #[must_use]
    pub fn inner_point_at(&self, z_mm: f64) -> Point3 {
        let trunk = &self.tubes[0];
        Point3::new(trunk.x.at(z_mm), trunk.y.at(z_mm), z_mm)
    }

    /// The vessel cut by a plane that is tilted about the x axis, through y of the middle at height `z`.
    pub(super) fn oblique(&self, z: f64, tilt_rad: f64) -> Oblique<'_> {
        let (sin, cos) = tilt_rad.sin_cos();
        Oblique { vessel: self, z, sin, cos }
    }

    /// The vessel cut at a height.
    pub(super) fn section(&self, z: f64) -> Section {
        Section { tubes: self.tubes.iter().map(|t| t.section(z)).collect(), blend: self.blend_radius_mm }
    }
}

#[derive(Debug, Clone)]
struct Wave {
    order: i32,
    cos: f64,
    sin: f64,
}

#[derive(Debug, Clone)]
struct TubeSection {
    centre: Point2,
    radius: f64,
    waves: Vec<Wave>,
}

impl TubeSection {
    /// Field and its gradient in the plane.
    fn jet(&self, p: Point2) -> (f64, Vector2) {
        let d = p - self.centre;
        // On the axis itself any direction will do: the field is far below zero there.
        let rho = d.norm().max(1e-12);
        let unit = d / rho;
        let (mut share, mut share_slope) = (0.0, 0.0);
        for wave in &self.waves {
            let (cos, sin) = multiple_angle(unit, wave.order);
            share += wave.cos * cos + wave.sin * sin;
            share_slope += f64::from(wave.order) * (wave.sin * cos - wave.cos * sin);
        }
        let around = Vector2::new(-unit.y, unit.x);
        let gradient = unit - around * (self.radius * share_slope / rho);
        (rho - self.radius * (1.0 + share), gradient)
    }

    fn reach(&self) -> f64 {
        self.radius * (1.0 + self.waves.iter().map(|w| w.cos.hypot(w.sin)).sum::<f64>())
    }
}

/// Cosine and sine of `order` times the angle of a unit vector, without leaving algebra.
fn multiple_angle(unit: Vector2, order: i32) -> (f64, f64) {
    (0..order).fold((1.0, 0.0), |(c, s), _| (c * unit.x - s * unit.y, c * unit.y + s * unit.x))
}

/// A vessel cut at one height.
#[derive(Debug, Clone)]
pub(super) struct Section {
    tubes: Vec<TubeSection>,
    blend: f64,
}

/// The implicit function in a plane.
pub(super) trait Field {
    /// F at a point of the plane.
    fn value(&self, p: Point2) -> f64;
    /// F and its gradient in the plane.
    fn jet(&self, p: Point2) -> (f64, Vector2);
    /// A box outside of which F exceeds `level`.
    fn bounds(&self, level: f64) -> Bounds2;
}

/// A vessel cut by a tilted plane; its second coordinate runs along the plane and is y where the plane has height z.
#[derive(Debug, Clone)]
pub(super) struct Oblique<'a> {
    vessel: &'a Vessel,
    z: f64,
    sin: f64,
    cos: f64,
}

/// How far from its middle a tilted plane is looked at, mm.
const OBLIQUE_REACH_MM: f64 = 60.0;

impl Oblique<'_> {
    /// The same plane, `h` further along its normal.
    pub(super) fn raised(&self, h: f64) -> RaisedOblique<'_> {
        RaisedOblique { plane: self, h }
    }
}

/// A tilted plane's neighbour at a distance.
#[derive(Debug, Clone)]
pub(super) struct RaisedOblique<'a> {
    plane: &'a Oblique<'a>,
    h: f64,
}

impl RaisedOblique<'_> {
    /// Patient coordinates of a point of the plane.
    fn place(&self, p: Point2) -> Point3 {
        let (Oblique { vessel, z, sin, cos }, middle) = (self.plane, self.plane.vessel.middle.y);
        let along = p.y - vessel.middle.y;
        Point3::new(p.x, middle + along * cos - self.h * sin, z + along * sin + self.h * cos)
    }
}

impl Field for RaisedOblique<'_> {
    fn value(&self, p: Point2) -> f64 {
        self.plane.vessel.value(self.place(p))
    }

    fn jet(&self, p: Point2) -> (f64, Vector2) {
        const STEP_MM: f64 = 1e-5;
        let slope = |d: Vector2| (self.value(p + d) - self.value(p - d)) / (2.0 * STEP_MM);
        (self.value(p), Vector2::new(slope(Vector2::x() * STEP_MM), slope(Vector2::y() * STEP_MM)))
    }

    fn bounds(&self, level: f64) -> Bounds2 {
        let middle = self.plane.vessel.middle.y;
        let stretched = |y: f64| middle + (y - middle + self.h * self.plane.sin) / self.plane.cos;
        let heights = (-20..=20).map(|i| {
            self.plane.z + self.h * self.plane.cos + f64::from(i) / 20.0 * OBLIQUE_REACH_MM * self.plane.sin
        });
        let boxes = heights.map(|z| self.plane.vessel.section(z).bounds(level));
        let all = boxes.reduce(Bounds2::union).expect("there are heights").grown(0.5);
        Bounds2 {
            min: Point2::new(all.min.x, stretched(all.min.y)),
            max: Point2::new(all.max.x, stretched(all.max.y)),
        }
    }
}

impl Field for Section {
    fn value(&self, p: Point2) -> f64 {
        self.jet(p).0
    }

    fn jet(&self, p: Point2) -> (f64, Vector2) {
        let fields = self.tubes.iter().map(|t| t.jet(p));
        fields.reduce(|a, b| smooth_min(a, b, self.blend)).expect("a vessel has at least one tube")
    }

    fn bounds(&self, level: f64) -> Bounds2 {
        // Each join lowers F by k/4 at most, so its zero set moves outwards by hardly more; twice that is safe.
        let margin = level.max(0.0) + 0.5 * self.blend * self.tubes.len() as f64 + 0.1;
        let of_tube = |t: &TubeSection| Bounds2 { min: t.centre, max: t.centre }.grown(t.reach() + margin);
        self.tubes.iter().map(of_tube).reduce(Bounds2::union).expect("a vessel has at least one tube")
    }
}

/// Quadratic smooth minimum of two fields with their gradients.
fn smooth_min(a: (f64, Vector2), b: (f64, Vector2), k: f64) -> (f64, Vector2) {
    let (low, high) = if a.0 <= b.0 { (a, b) } else { (b, a) };
    let h = ((k - (high.0 - low.0)) / k).max(0.0);
    (low.0 - h * h * k * 0.25, low.1 * (1.0 - 0.5 * h) + high.1 * (0.5 * h))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradient_equals_the_difference_quotient() {
        let e = 1e-6;
        for kind in Kind::ALL {
            let vessel = Vessel::new(kind);
            for (i, z) in [3.0, 61.0, 70.5, 74.0, 120.0].into_iter().enumerate() {
                let section = vessel.section(z);
                let p = vessel.middle + Vector2::new(1.7 - i as f64, 0.6 + 0.9 * i as f64);
                let g = section.jet(p).1;
                let quotient = |d: Vector2| (section.value(p + d) - section.value(p - d)) / (2.0 * e);
                assert!((g.x - quotient(Vector2::x() * e)).abs() < 1e-6, "{kind:?} at {z}");
                assert!((g.y - quotient(Vector2::y() * e)).abs() < 1e-6, "{kind:?} at {z}");
            }
        }
    }

    #[test]
    fn the_field_is_positive_outside_its_bounds() {
        for kind in Kind::ALL {
            let vessel = Vessel::new(kind);
            for z in (0..=138).map(f64::from) {
                let section = vessel.section(z);
                let b = section.bounds(1.0);
                for i in 0..=40 {
                    let at = f64::from(i) / 40.0;
                    let along = b.min + b.size() * at;
                    let border =
                        [(along.x, b.min.y), (along.x, b.max.y), (b.min.x, along.y), (b.max.x, along.y)];
                    assert!(
                        border.iter().all(|&(x, y)| section.value(Point2::new(x, y)) > 1.0),
                        "{kind:?} {z}"
                    );
                }
            }
        }
    }
}
