//! Enclosed volume by the divergence theorem: the integral of x over the projection onto the yz plane.
//!
//! Horizontal planes contribute nothing; the integrand of a spline face is a polynomial on every knot span, for which
//! Gauss quadrature of enough points is exact. Cost: linear in the number of control points.

use super::{Brep, Face, Surface};
use crate::spline::{Basis, PatchSurface, Span};
use rayon::prelude::*;

/// Nodes and weights of Gauss quadrature on [-1, 1], exact for polynomials of degree 7 and 9.
const GAUSS_4: [(f64, f64); 4] = [
    (-0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
    (-0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
    (0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
    (0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
];
const GAUSS_5: [(f64, f64); 5] = [
    (-0.906_179_845_938_664, 0.236_926_885_056_189_08),
    (-0.538_469_310_105_683_1, 0.478_628_670_499_366_47),
    (0.0, 0.568_888_888_888_888_9),
    (0.538_469_310_105_683_1, 0.478_628_670_499_366_47),
    (0.906_179_845_938_664, 0.236_926_885_056_189_08),
];

/// Nodes with weights over all knot spans of a basis.
fn nodes(basis: &Basis, rule: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let wide = basis.knots().windows(2).filter(|k| k[0] < k[1]);
    let on = |k: &[f64]| {
        let (middle, half) = (0.5 * (k[0] + k[1]), 0.5 * (k[1] - k[0]));
        rule.iter().map(|&(x, w)| (middle + half * x, half * w)).collect::<Vec<_>>()
    };
    wide.flat_map(on).collect()
}

/// A sum over nodes, in their order on any number of threads.
fn summed(nodes: Vec<(f64, f64)>, term: impl Fn((f64, f64)) -> f64 + Send + Sync) -> f64 {
    nodes.into_par_iter().map(term).collect::<Vec<f64>>().into_iter().sum()
}

impl Brep {
    /// The volume of the material, mm³, exact to rounding.
    #[must_use]
    pub fn volume_mm3(&self) -> f64 {
        self.shells().map(|shell| self.volume_of_mm3(&shell.faces)).sum()
    }

    /// The volume that a closed set of faces encloses, mm³; negative for a hollow.
    pub(super) fn volume_of_mm3(&self, faces: &[usize]) -> f64 {
        // Relative to a point of the body: large coordinates would cost digits.
        let x_0 = self.vertices.first().map_or(0.0, |v| v.point.x);
        faces.iter().map(|&i| flux(&self.faces[i], x_0)).sum()
    }
}

/// The integral of x - x_0 over a face's projection along x.
fn flux(face: &Face, x_0: f64) -> f64 {
    let sign = if face.is_outward { 1.0 } else { -1.0 };
    match &face.surface {
        Surface::Plane(_) => 0.0,
        Surface::Tube(s) => sign * level_flux(s, x_0),
        Surface::Lateral(s) | Surface::Saddle(s) => sign * patch_flux(s, x_0),
    }
}

/// The flux of a surface with v = z: the areas of its sections, whose integrals over u are a fixed quadratic form of the
/// control points.
fn level_flux(surface: &PatchSurface, x_0: f64) -> f64 {
    let [u, v] = surface.bases();
    let mut form = vec![[0.0; 7]; u.len()];
    for (t, weight) in nodes(u, &GAUSS_4) {
        let (value, slope) = (u.at(t), u.derivative_at(t));
        for (i, a) in value.weights.iter().enumerate() {
            for (j, b) in slope.weights.iter().enumerate() {
                let Some(row) = form.get_mut(value.first + i) else { continue };
                row[3 + j - i] += weight * a * b;
            }
        }
    }
    let section = |z: f64| -> f64 {
        let row = surface.row(z);
        let control = row.control();
        let term = |(i, entries): (usize, &[f64; 7])| -> f64 {
            let y = |k: usize| (i + k).checked_sub(3).and_then(|j| control.get(3 * j + 1)).copied();
            let sum: f64 = entries.iter().enumerate().filter_map(|(k, m)| Some(m * y(k)?)).sum();
            (control[3 * i] - x_0) * sum
        };
        form.iter().enumerate().map(term).sum()
    };
    summed(nodes(v, &GAUSS_4), |(z, weight)| weight * section(z))
}

fn patch_flux(surface: &PatchSurface, x_0: f64) -> f64 {
    let [u, v] = surface.bases();
    let at_u: Vec<(Span, Span, f64)> =
        nodes(u, &GAUSS_5).into_iter().map(|(t, w)| (u.at(t), u.derivative_at(t), w)).collect();
    let row = |(t, weight): (f64, f64)| {
        let (row, slope) = (surface.row(t), surface.row_slope(t));
        let term = |(value, derivative, w): &(Span, Span, f64)| {
            let (by_u, by_v) = (row.weighted(*derivative), slope.weighted(*value));
            w * (row.weighted(*value).x - x_0) * (by_u.y * by_v.z - by_u.z * by_v.y)
        };
        weight * at_u.iter().map(term).sum::<f64>()
    };
    summed(nodes(v, &GAUSS_5), row)
}
