//! Domes: how a branch that begins or ends between two planes closes.
//!
//! The last plane shows the branch, the next one shows nothing: the tip lies between them. The equivalent radii of
//! the last sections are compared with a body of linearly changing radius that closes over a length l before its tip
//! as sqrt(1 - depth³), depth from 0 to 1 (C2 where it begins). Tip and l are weighed over a grid of both, with a
//! weak prior of 1.5 radii for l; the mean of the tip is taken, which halves the range where the sections say nothing.
//!
//! Sections then follow towards the tip, the distance to it halved from one to the next, and end in a flat cap of
//! a thousandth of the radius, so that height remains the tube's parameter.

use super::assemble::ONE_HEIGHT_MM;
use super::between::radius_mm;
use crate::geom::{Contour, Point2, Vector2};
use crate::spline::ClosedCurve;

/// Sections that tell about the tip.
const PLANES: usize = 4;
/// How well radii follow the model, as a fraction of the radius; how fast a body's radius changes, mm per mm.
const RADIUS_NOISE: f64 = 0.002;
const TAPER: f64 = 0.03;
/// Length of a dome in radii that is expected, and the spread of its logarithm.
const EXPECTED_LENGTH: f64 = 1.5;
const LENGTH_SPREAD: f64 = 0.2;
/// Places of the tip and lengths of the dome that are weighed.
const TIPS: usize = 96;
const LENGTHS: i32 = 12;
/// Halvings of the distance to the tip: the radius falls with its square root.
const HALVINGS: i32 = 20;
/// Sections added in the last full interval where the dome began there.
const INNER: [f64; 3] = [0.25, 0.5, 0.75];
const POINTS: usize = 256;

/// A body that closes in a dome; t runs outward from the last plane.
#[derive(Debug, Clone, Copy)]
struct Model {
    tip: f64,
    length: f64,
    radius: f64,
    taper: f64,
    cost: f64,
}

impl Model {
    fn depth(&self, t: f64) -> f64 {
        ((t - self.tip + self.length) / self.length).clamp(0.0, 1.0)
    }

    fn radius_at(&self, t: f64) -> f64 {
        (self.radius + self.taper * t).max(0.0) * (1.0 - self.depth(t).powi(3)).max(0.0).sqrt()
    }

    /// Body and cost for a tip and a dome of so many radii.
    fn fitted(data: &[(f64, f64)], tip: f64, radii: f64) -> Self {
        let size = data.iter().map(|d| d.1).fold(0.0, f64::max);
        let noise = RADIUS_NOISE * size;
        let mut model = Self { tip, length: radii * size, radius: size, taper: 0.0, cost: 0.0 };
        // The length depends on the body's radius at the tip, which follows from the fit.
        for _ in 0..3 {
            let mut normal = [[0.0; 2]; 2];
            let mut right = [0.0; 2];
            normal[1][1] = (1.0 / TAPER).powi(2);
            for &(t, r) in data {
                let g = (1.0 - model.depth(t).powi(3)).max(0.0).sqrt() / noise;
                let row = [g, g * t];
                for i in 0..2 {
                    right[i] += row[i] * r / noise;
                    (0..2).for_each(|j| normal[i][j] += row[i] * row[j]);
                }
            }
            let det = normal[0][0] * normal[1][1] - normal[0][1] * normal[1][0];
            if det > 0.0 {
                model.radius = (right[0] * normal[1][1] - right[1] * normal[0][1]) / det;
                model.taper = (right[1] * normal[0][0] - right[0] * normal[1][0]) / det;
            }
            model.length = radii * (model.radius + model.taper * tip).clamp(0.3 * size, 3.0 * size);
        }
        let misfit = |&(t, r): &(f64, f64)| ((model.radius_at(t) - r) / noise).powi(2);
        let prior = ((radii / EXPECTED_LENGTH).ln() / LENGTH_SPREAD).powi(2);
        model.cost = data.iter().map(misfit).sum::<f64>() + (model.taper / TAPER).powi(2) + prior;
        model
    }

    /// The tip's mean over all that agrees with the radii, and the best body for it.
    fn of(data: &[(f64, f64)], next_plane: f64) -> Self {
        let lengths: Vec<f64> = (-LENGTHS..=LENGTHS)
            .map(|k| EXPECTED_LENGTH * (3.0 * LENGTH_SPREAD * f64::from(k) / f64::from(LENGTHS)).exp())
            .collect();
        let best = |tip: f64| {
            let models = lengths.iter().map(|&l| Self::fitted(data, tip, l));
            models.min_by(|a, b| a.cost.total_cmp(&b.cost))
        };
        let tips: Vec<f64> = (0..TIPS).map(|k| next_plane * (k as f64 + 0.5) / TIPS as f64).collect();
        let all: Vec<Self> =
            tips.iter().flat_map(|&tip| lengths.iter().map(move |&l| Self::fitted(data, tip, l))).collect();
        let least = all.iter().map(|m| m.cost).fold(f64::INFINITY, f64::min);
        let weight = |m: &Self| (-0.5 * (m.cost - least)).exp();
        let whole: f64 = all.iter().map(weight).sum();
        let tip = all.iter().map(|m| weight(m) * m.tip).sum::<f64>() / whole;
        best(tip).unwrap_or(all[0])
    }
}

/// Sections from the end of a branch towards its tip, which lies before the next plane. `sections` begin with the
/// last one and lead into the branch.
pub(super) fn towards(sections: &[(f64, Contour)], next_plane_z: f64) -> Vec<(f64, Contour)> {
    let (z_end, end) = (sections[0].0, &sections[0].1);
    let outward = (next_plane_z - z_end).signum();
    let interval = (next_plane_z - z_end).abs();
    let near = spaced(sections, 0.4 * interval);
    let distance = |z: f64| (z - z_end) * outward;
    let data: Vec<(f64, f64)> = near.iter().map(|(z, c)| (distance(*z), radius_mm(c))).collect();
    let model = Model::of(&data, interval);
    let axis = Axis::through(&near, distance);
    let Some(curve) = ClosedCurve::through(end) else { return Vec::new() };
    let points = curve.resampled(POINTS, 0.0);
    let (centre, match_end) = (end.centroid(), radius_mm(end) / model.radius_at(0.0).max(1e-9));
    let section = |t: f64| {
        let scale = match_end * model.radius_at(t) / radius_mm(end);
        let shift = axis.at(t) - axis.at(0.0);
        let place = |p: &Point2| centre + shift + (p - centre) * scale;
        (z_end + outward * t, Contour::new(points.iter().map(place).collect()))
    };
    let mut added: Vec<_> = (1..=HALVINGS).map(|k| section(model.tip * (1.0 - 0.5f64.powi(k)))).collect();
    added.push(section(0.25 * model.tip));
    // Where there are sections between the last one and the next that tells about the tip, they say how the dome begins.
    let behind = sections.iter().find(|s| distance(s.0).abs() > ONE_HEIGHT_MM);
    if let [last, before, ..] = near[..]
        && behind.is_some_and(|behind| behind.0 == before.0)
    {
        added.extend(inner([last, before], &model, distance));
    }
    added
}

/// Sections in the last full interval, where the dome began in it.
fn inner(
    [last, before]: [&(f64, Contour); 2],
    model: &Model,
    distance: impl Fn(f64) -> f64,
) -> Vec<(f64, Contour)> {
    if model.depth(0.0) < 0.1 {
        return Vec::new();
    }
    let (Some(a), Some(b)) = (ClosedCurve::through(&last.1), ClosedCurve::through(&before.1)) else {
        return Vec::new();
    };
    let a = a.resampled(POINTS, 0.0);
    let b = b.resampled(POINTS, super::skin::least_twist_start(&b, &a));
    let t_before = distance(before.0);
    let ratio = |contour: &Contour, t: f64| radius_mm(contour) / model.radius_at(t).max(1e-9);
    let (ratio_a, ratio_b) = (ratio(&last.1, 0.0), ratio(&before.1, t_before));
    let section = |f: &f64| {
        let t = f * t_before;
        let mixed = Contour::new(a.iter().zip(&b).map(|(p, q)| p + (q - p) * *f).collect());
        let radius = model.radius_at(t) * (ratio_a + (ratio_b - ratio_a) * f);
        let (centre, scale) = (mixed.centroid(), radius / radius_mm(&mixed));
        let points = mixed.points.iter().map(|p| centre + (p - centre) * scale).collect();
        (last.0 + (before.0 - last.0) * f, Contour::new(points))
    };
    INNER.iter().map(section).collect()
}

/// The sections that tell about the tip: about a plane interval apart.
fn spaced(sections: &[(f64, Contour)], least: f64) -> Vec<&(f64, Contour)> {
    let mut near = vec![&sections[0]];
    for section in &sections[1..] {
        if near.len() < PLANES && (section.0 - near[near.len() - 1].0).abs() > least {
            near.push(section);
        }
    }
    near
}

/// The branch's centreline, continued as a parabola through the centroids of its last three sections.
struct Axis {
    places: Vec<(f64, Point2)>,
}

impl Axis {
    fn through(near: &[&(f64, Contour)], distance: impl Fn(f64) -> f64) -> Self {
        Self { places: near.iter().take(3).map(|(z, c)| (distance(*z), c.centroid())).collect() }
    }

    fn at(&self, t: f64) -> Vector2 {
        let weight = |j: usize| -> f64 {
            let others = self.places.iter().enumerate().filter(|(m, _)| *m != j);
            others.map(|(_, o)| (t - o.0) / (self.places[j].0 - o.0)).product()
        };
        self.places.iter().enumerate().map(|(j, p)| p.1.coords * weight(j)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sections of a body of radius 2.4 mm with its tip at `tip`, on planes `step` apart.
    fn stump(tip: f64, length: f64, step: f64) -> (Vec<(f64, Contour)>, f64) {
        let radius = |z: f64| 2.4 * (1.0 - ((z - tip + length) / length).clamp(0.0, 1.0).powi(3)).sqrt();
        let n = (tip / step).floor();
        let mut sections = Vec::new();
        let mut z = n * step;
        while z >= 0.0 {
            let centre = Point2::new(0.2 * z, 0.01 * z * z);
            sections.push((z, Contour::circle(centre, radius(z), 128)));
            z -= step;
        }
        (sections, (n + 1.0) * step)
    }

    #[test]
    fn tips_of_usual_domes_are_found() {
        for k in 0..12 {
            let tip = 20.2 + 0.25 * f64::from(k);
            let (sections, next) = stump(tip, 3.6, 3.0);
            let dome = towards(&sections, next);
            let top = dome.iter().map(|s| s.0).fold(f64::NEG_INFINITY, f64::max);
            assert!((top - tip).abs() < 0.35, "{tip}: {top}");
            let last = dome.iter().map(|s| radius_mm(&s.1)).fold(f64::INFINITY, f64::min);
            assert!(last < 0.01 && last > 1e-5, "{last}");
        }
    }

    #[test]
    fn a_tip_lies_before_the_next_plane() {
        for step in [0.5, 1.0, 3.0, 6.0] {
            for k in 0..8 {
                let (sections, next) = stump(18.1 + 0.4 * f64::from(k), 2.0 + f64::from(k), step);
                let dome = towards(&sections[..sections.len().min(2)], next);
                assert!(dome.iter().all(|s| s.0 < next));
            }
        }
    }
}
