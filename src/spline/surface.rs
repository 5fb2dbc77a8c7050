//! The two kinds of B-spline surfaces of a vessel. In both z depends on v alone where it matters: a section at
//! any height of a tube or a lateral patch is an iso-curve.

use super::{Basis, Span, SplineError, periodic_control_points};
use crate::geom::{Point2, Point3, Vector3};
use serde::{Deserialize, Serialize};

/// A tube: periodic cubic in u (uniform, u in [0, 1)), cubic in v, and v is z in mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TubeSurface {
    n_u: usize,
    z: Basis,
    /// Control rows in v; each row holds the curve's points at u = i / n_u as x, y.
    rows: Vec<f64>,
}

impl TubeSurface {
    /// Skins a tube through sections given at ascending heights, each of the same number of points evenly spaced
    /// in u and already aligned with its neighbours.
    ///
    /// # Errors
    /// Fewer than two sections, or heights that do not ascend.
    ///
    /// # Panics
    /// Where the sections differ in their number of points.
    pub fn through(z_mm: &[f64], sections: &[Vec<Point2>]) -> Result<Self, SplineError> {
        let z = Basis::not_a_knot(z_mm)?;
        let n_u = sections[0].len();
        assert!(sections.iter().all(|s| s.len() == n_u), "sections of a tube have equally many points");
        let data: Vec<f64> = sections.iter().flatten().flat_map(|p| [p.x, p.y]).collect();
        let rows = z.interpolate(&data, 2 * n_u);
        Ok(Self { n_u, z, rows })
    }

    /// Lowest and highest z, mm.
    #[must_use]
    pub fn z_range_mm(&self) -> [f64; 2] {
        self.z.range()
    }

    /// Heights of the sections it runs through, mm.
    #[must_use]
    pub fn section_z_mm(&self) -> &[f64] {
        self.z.sites()
    }

    /// The iso-curve at height z.
    #[must_use]
    pub fn section(&self, z_mm: f64) -> SectionCurve {
        self.row(self.z.at(z_mm))
    }

    /// The derivative of the iso-curve with respect to z: how the surface leans.
    #[must_use]
    pub fn section_slope(&self, z_mm: f64) -> SectionCurve {
        self.row(self.z.derivative_at(z_mm))
    }

    /// The control points in both directions, for evaluation at single points.
    #[must_use]
    pub fn net(&self) -> TubeNet<'_> {
        let rows = self.rows.chunks_exact(2 * self.n_u);
        let control = rows.flat_map(|row| periodic_control_points(row, 2)).collect();
        TubeNet { n_u: self.n_u, z: &self.z, control }
    }

    fn row(&self, span: Span) -> SectionCurve {
        let mut values = Vec::new();
        Basis::combine(span, &self.rows, 2 * self.n_u, &mut values);
        SectionCurve::through(values)
    }
}

/// The control net of a tube: points and derivatives without solving for each section anew.
#[derive(Debug, Clone)]
pub struct TubeNet<'a> {
    n_u: usize,
    z: &'a Basis,
    /// Control rows in v, each of the periodic control points x, y in u.
    control: Vec<f64>,
}

impl TubeNet<'_> {
    /// Pieces round the tube.
    #[must_use]
    pub const fn n_u(&self) -> usize {
        self.n_u
    }

    /// Lowest and highest z, mm.
    #[must_use]
    pub fn z_range_mm(&self) -> [f64; 2] {
        self.z.range()
    }

    /// Heights of the sections, mm.
    #[must_use]
    pub fn section_z_mm(&self) -> &[f64] {
        self.z.sites()
    }

    /// The point at (u, z); u is periodic in 1.
    #[must_use]
    pub fn at(&self, u: f64, z_mm: f64) -> Point3 {
        let span = self.z.at(z_mm);
        let (i, t) = piece(u, self.n_u);
        let weights = uniform_weights(t);
        let columns = [(i + self.n_u - 1) % self.n_u, i, (i + 1) % self.n_u, (i + 2) % self.n_u];
        let mut point = Point3::new(0.0, 0.0, z_mm);
        for (k, wz) in span.weights.iter().enumerate().take(self.z.degree() + 1) {
            let row = &self.control[2 * (span.first + k) * self.n_u..2 * (span.first + k + 1) * self.n_u];
            for (column, wu) in columns.iter().zip(&weights) {
                point.x += wz * wu * row[2 * column];
                point.y += wz * wu * row[2 * column + 1];
            }
        }
        point
    }

    /// The section at height z with its first two derivatives along z. The second one is the difference quotient of
    /// the first over `step_mm`.
    #[must_use]
    pub fn ring(&self, z_mm: f64, step_mm: f64) -> TubeRing {
        let combined = |span: Span| {
            let mut row = Vec::new();
            Basis::combine(span, &self.control, 2 * self.n_u, &mut row);
            row
        };
        let [low, high] = self.z.range();
        let (below, above) = ((z_mm - step_mm).max(low), (z_mm + step_mm).min(high));
        let (before, after) = (combined(self.z.derivative_at(below)), combined(self.z.derivative_at(above)));
        let span_mm = (above - below).max(f64::MIN_POSITIVE);
        let second = before.iter().zip(&after).map(|(b, a)| (a - b) / span_mm).collect();
        let along_z = [combined(self.z.at(z_mm)), combined(self.z.derivative_at(z_mm)), second];
        TubeRing { n_u: self.n_u, z_mm, along_z }
    }
}

/// A section of a tube with its derivatives along z.
#[derive(Debug, Clone)]
pub struct TubeRing {
    n_u: usize,
    z_mm: f64,
    /// Control points of the section, of its first and of its second derivative.
    along_z: [Vec<f64>; 3],
}

/// A point of a tube with its derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TubeJet {
    /// The point.
    pub at: Point3,
    /// First derivative along u.
    pub du: Vector3,
    /// Second derivative along u.
    pub duu: Vector3,
    /// First derivative along z.
    pub dz: Vector3,
    /// Mixed derivative.
    pub duz: Vector3,
    /// Second derivative along z.
    pub dzz: Vector3,
}

impl TubeRing {
    /// The point at u with its derivatives.
    #[must_use]
    pub fn jet(&self, u: f64) -> TubeJet {
        let n = self.n_u;
        let (i, t) = piece(u, n);
        let scale = n as f64;
        let s = 1.0 - t;
        let first = [-0.5 * s * s, (1.5 * t - 2.0) * t, (2.0 - 1.5 * s) * s, 0.5 * t * t].map(|w| w * scale);
        let second = [s, 3.0 * t - 2.0, 3.0 * s - 2.0, t].map(|w| w * scale * scale);
        let columns = [(i + n - 1) % n, i, (i + 1) % n, (i + 2) % n];
        let sum = |row: &[f64], weights: &[f64; 4], z: f64| {
            let mut sum = Vector3::new(0.0, 0.0, z);
            for (column, w) in columns.iter().zip(weights) {
                sum.x += w * row[2 * column];
                sum.y += w * row[2 * column + 1];
            }
            sum
        };
        let value = uniform_weights(t);
        let [here, slope, bend] = &self.along_z;
        TubeJet {
            at: sum(here, &value, self.z_mm).into(),
            du: sum(here, &first, 0.0),
            duu: sum(here, &second, 0.0),
            dz: sum(slope, &value, 1.0),
            duz: sum(slope, &first, 0.0),
            dzz: sum(bend, &value, 0.0),
        }
    }
}

/// The piece of a uniform closed spline in which u lies, and the fraction of it.
fn piece(u: f64, n: usize) -> (usize, f64) {
    let scaled = u.rem_euclid(1.0) * n as f64;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "in 0..n")]
    let i = (scaled.floor() as usize).min(n - 1);
    (i, scaled - i as f64)
}

/// Weights of the uniform cubic B-spline at a fraction of a piece.
fn uniform_weights(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    [
        s * s * s / 6.0,
        (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
        (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0,
        t * t * t / 6.0,
    ]
}

/// A horizontal section of a tube: a uniform periodic cubic B-spline in u.
#[derive(Debug, Clone, PartialEq)]
pub struct SectionCurve {
    values: Vec<f64>,
    control: Vec<f64>,
}

impl SectionCurve {
    fn through(values: Vec<f64>) -> Self {
        let control = periodic_control_points(&values, 2);
        Self { values, control }
    }

    /// The curve through points evenly spaced in u.
    #[must_use]
    pub fn through_points(points: &[Point2]) -> Self {
        Self::through(points.iter().flat_map(|p| [p.x, p.y]).collect())
    }

    /// Number of points it was made through.
    #[must_use]
    pub fn len(&self) -> usize {
        self.values.len() / 2
    }

    /// Never true: a section has at least three points.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// The points at u = i / n.
    #[must_use]
    pub fn points(&self) -> Vec<Point2> {
        self.values.chunks_exact(2).map(|p| Point2::new(p[0], p[1])).collect()
    }

    /// Largest second derivative with respect to u, mm: the second derivative of a cubic spline is linear between
    /// its knots, so it is largest at one of them.
    #[must_use]
    pub fn bend_mm(&self) -> f64 {
        let n = self.len();
        let control = |i: usize, k: usize| self.control[2 * (i % n) + k];
        let second = |i: usize, k: usize| control(i + n - 1, k) - 2.0 * control(i, k) + control(i + 1, k);
        let largest = (0..n).map(|i| second(i, 0).hypot(second(i, 1))).fold(0.0, f64::max);
        largest * (n * n) as f64
    }

    /// The point at u (periodic in 1).
    #[must_use]
    pub fn at(&self, u: f64) -> Point2 {
        let n = self.len();
        let (i, t) = piece(u, n);
        let weights = uniform_weights(t);
        let mut point = Point2::origin();
        for (k, w) in weights.iter().enumerate() {
            let j = (i + n - 1 + k) % n;
            point.x += w * self.control[2 * j];
            point.y += w * self.control[2 * j + 1];
        }
        point
    }
}

/// A patch with four sides: cubic in both directions through a grid of points in space.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PatchSurface {
    u: Basis,
    v: Basis,
    /// Control rows in v, each of as many points (x, y, z) as u has sites.
    control: Vec<f64>,
}

impl PatchSurface {
    /// The patch through `grid[row][column]` at the parameters `v[row]`, `u[column]`.
    ///
    /// # Errors
    /// Fewer than two parameters, or parameters that do not ascend.
    ///
    /// # Panics
    /// Where the grid does not fit the parameters.
    pub fn through(u: &[f64], v: &[f64], grid: &[Vec<Point3>]) -> Result<Self, SplineError> {
        let (u, v) = (Basis::not_a_knot(u)?, Basis::not_a_knot(v)?);
        assert!(grid.len() == v.sites().len(), "one row of points for each v");
        let mut rows = Vec::new();
        for row in grid {
            assert!(row.len() == u.sites().len(), "one point for each u");
            let values: Vec<f64> = row.iter().flat_map(|p| [p.x, p.y, p.z]).collect();
            rows.extend(u.interpolate(&values, 3));
        }
        let control = v.interpolate(&rows, 3 * u.sites().len());
        Ok(Self { u, v, control })
    }

    /// First and last u.
    #[must_use]
    pub fn u_range(&self) -> [f64; 2] {
        self.u.range()
    }

    /// First and last v.
    #[must_use]
    pub fn v_range(&self) -> [f64; 2] {
        self.v.range()
    }

    /// Number of points along u and along v that it was made through.
    #[must_use]
    pub fn n_sites(&self) -> [usize; 2] {
        [self.u.sites().len(), self.v.sites().len()]
    }

    /// The iso-curve at v, ready for evaluation in u.
    #[must_use]
    pub fn row(&self, v: f64) -> PatchRow<'_> {
        let mut control = Vec::new();
        Basis::combine(self.v.at(v), &self.control, 3 * self.u.sites().len(), &mut control);
        PatchRow { basis: &self.u, control }
    }

    /// The point at (u, v).
    #[must_use]
    pub fn at(&self, u: f64, v: f64) -> Point3 {
        let (su, sv) = (self.u.at(u), self.v.at(v));
        let width = 3 * self.u.sites().len();
        let mut point = Point3::origin();
        for (k, wv) in sv.weights.iter().enumerate().take(self.v.degree() + 1) {
            for (m, wu) in su.weights.iter().enumerate().take(self.u.degree() + 1) {
                let at = (sv.first + k) * width + 3 * (su.first + m);
                let w = wu * wv;
                point.x += w * self.control[at];
                point.y += w * self.control[at + 1];
                point.z += w * self.control[at + 2];
            }
        }
        point
    }
}

/// An iso-curve of a patch.
#[derive(Debug, Clone)]
pub struct PatchRow<'a> {
    basis: &'a Basis,
    control: Vec<f64>,
}

impl PatchRow<'_> {
    /// The point at u.
    #[must_use]
    pub fn at(&self, u: f64) -> Point3 {
        let mut point = Vec::new();
        Basis::combine(self.basis.at(u), &self.control, 3, &mut point);
        Point3::new(point[0], point[1], point[2])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Contour;

    #[test]
    fn a_cone_is_lofted_exactly_along_z() {
        let z: Vec<f64> = (0..9).map(f64::from).collect();
        let radius = |z: f64| 2.0 + 0.25 * z;
        let sections: Vec<_> =
            z.iter().map(|&z| Contour::circle(Point2::new(z, 0.0), radius(z), 64).points).collect();
        let tube = TubeSurface::through(&z, &sections).unwrap();
        let curve = tube.section(3.3);
        for i in 0..500 {
            let p = curve.at(f64::from(i) / 500.0);
            assert!(((p - Point2::new(3.3, 0.0)).norm() - radius(3.3)).abs() < 1e-6);
        }
        let slope = tube.section_slope(3.3).at(0.0);
        assert!((slope - Point2::new(1.25, 0.0)).norm() < 1e-9);
    }

    #[test]
    fn the_net_of_a_tube_agrees_with_its_sections_and_their_difference_quotients() {
        let z: Vec<f64> = (0..9).map(f64::from).collect();
        let section = |z: f64| Contour::circle(Point2::new(0.3 * z * z, z.sin()), 2.0 + 0.1 * z, 64).points;
        let sections: Vec<_> = z.iter().map(|&z| section(z)).collect();
        let tube = TubeSurface::through(&z, &sections).unwrap();
        let net = tube.net();
        for (u, z) in [(0.0, 0.0), (0.31, 3.3), (0.999, 8.0), (-0.2, 5.5)] {
            let p = net.at(u, z);
            assert!((p.xy() - tube.section(z).at(u)).norm() < 1e-12);
            let jet = net.ring(z, 1e-4).jet(u);
            assert!((jet.at - p).norm() < 1e-12);
            let h = 1e-4;
            let inside = z.clamp(h, 8.0 - h);
            let jet = net.ring(inside, h).jet(u);
            let at = |i: f64, k: f64| net.at(u + i * h, inside + k * h).coords;
            let near = |a: Vector3, b: Vector3| (a - b).norm() < 1e-3 * (1.0 + b.norm());
            assert!(near(jet.du, (at(1.0, 0.0) - at(-1.0, 0.0)) / (2.0 * h)));
            assert!(near(jet.duu, (at(1.0, 0.0) - 2.0 * at(0.0, 0.0) + at(-1.0, 0.0)) / (h * h)));
            assert!(near(jet.dz, (at(0.0, 1.0) - at(0.0, -1.0)) / (2.0 * h)));
            assert!(near(jet.dzz, (at(0.0, 1.0) - 2.0 * at(0.0, 0.0) + at(0.0, -1.0)) / (h * h)));
            let mixed = (at(1.0, 1.0) - at(-1.0, 1.0) - at(1.0, -1.0) + at(-1.0, -1.0)) / (4.0 * h * h);
            assert!(near(jet.duz, mixed));
        }
    }

    #[test]
    fn a_patch_reproduces_a_bicubic() {
        let f = |u: f64, v: f64| Point3::new(u, v, 1.0 + u * v - u * u * v + 0.3 * v * v * v);
        let u = [0.0, 0.1, 0.4, 0.8, 1.0];
        let v = [-1.0, 0.0, 0.7, 1.1, 2.0, 2.5];
        let grid: Vec<Vec<Point3>> = v.iter().map(|&v| u.iter().map(|&u| f(u, v)).collect()).collect();
        let patch = PatchSurface::through(&u, &v, &grid).unwrap();
        for (s, t) in [(0.05, -0.5), (0.5, 0.3), (0.93, 2.4), (1.0, 2.5), (0.0, -1.0)] {
            assert!((patch.at(s, t) - f(s, t)).norm() < 1e-10);
            assert!((patch.row(t).at(s) - f(s, t)).norm() < 1e-10);
        }
    }
}
