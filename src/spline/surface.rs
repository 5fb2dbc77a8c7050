//! The two kinds of B-spline surfaces of a vessel. In both z depends on v alone where it matters: a section at
//! any height of a tube or a lateral patch is an iso-curve.

use super::{Basis, Curve, Malformed, Span, SplineError, periodic_control_points};
use crate::geom::{Point2, Point3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// A tube: periodic cubic in u (uniform, u in [0, 1)), cubic in v, and v is z in mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawTube")]
pub struct TubeSurface {
    n_u: usize,
    /// Heights of the sections it was made through.
    z_mm: Vec<f64>,
    z: Basis,
    /// Control rows in v; each row holds x, y of the periodic control points, the i-th one centred on u = i / n_u.
    control: Vec<f64>,
}

/// A tube as it was read.
#[derive(Deserialize)]
struct RawTube {
    n_u: usize,
    z_mm: Vec<f64>,
    z: Basis,
    control: Vec<f64>,
}

impl TryFrom<RawTube> for TubeSurface {
    type Error = Malformed;

    fn try_from(RawTube { n_u, z_mm, z, control }: RawTube) -> Result<Self, Malformed> {
        let [low, high] = z.range();
        let is_inside = |h: &f64| (low..=high).contains(h);
        if z_mm.len() < 2 || !z_mm.is_sorted() || !z_mm.iter().all(is_inside) {
            return Err(Malformed("the heights of a tube's sections do not ascend inside it"));
        }
        if n_u < 3 {
            return Err(Malformed("a tube's section has fewer than three points"));
        }
        is_full(&control, [2, n_u, z.len()])?;
        Ok(Self { n_u, z_mm, z, control })
    }
}

/// Whether there are as many control numbers as the product says, all finite.
fn is_full(control: &[f64], [width, n_u, n_v]: [usize; 3]) -> Result<(), Malformed> {
    let n = n_u.checked_mul(n_v).and_then(|n| n.checked_mul(width));
    if n != Some(control.len()) {
        return Err(Malformed("the control points of a surface do not fit its bases"));
    }
    if control.iter().all(|c| c.is_finite()) {
        Ok(())
    } else {
        Err(Malformed("a control point is no number"))
    }
}

impl TubeSurface {
    /// Skins a tube through sections given at ascending heights, each of the same number of points evenly spaced
    /// in u and already aligned with its neighbours.
    ///
    /// # Errors
    /// Fewer than two sections, or heights that do not ascend.
    ///
    /// # Panics
    /// Where the sections differ in their number of points, or have fewer than three.
    pub fn through(z_mm: &[f64], sections: &[Vec<Point2>]) -> Result<Self, SplineError> {
        Self::sloped(z_mm, sections, [None, None])
    }

    /// As [`TubeSurface::through`], with the derivatives by z of the points of the first and of the last section where
    /// they are given.
    ///
    /// # Errors
    /// Fewer than two sections, or heights that do not ascend.
    ///
    /// # Panics
    /// Where the sections or derivatives differ in their number of points, or have fewer than three.
    pub fn sloped(
        z_mm: &[f64],
        sections: &[Vec<Point2>],
        slopes: [Option<&[Vector2]>; 2],
    ) -> Result<Self, SplineError> {
        let z = Basis::for_sites(z_mm, slopes.map(|s| s.is_some()))?;
        let n_u = sections[0].len();
        assert!(sections.iter().all(|s| s.len() == n_u), "sections of a tube have equally many points");
        let round = |s: &Vec<Point2>| -> Vec<f64> {
            let values: Vec<f64> = s.iter().flat_map(|p| [p.x, p.y]).collect();
            periodic_control_points(&values, 2)
        };
        let data: Vec<f64> = sections.iter().flat_map(round).collect();
        let slopes = slopes.map(|s| s.map(|s| round(&s.iter().map(|v| Point2::from(*v)).collect())));
        let control = z.interpolate_sloped(z_mm, &data, slopes.each_ref().map(Option::as_deref), 2 * n_u);
        Ok(Self { n_u, z_mm: z_mm.to_vec(), z, control })
    }

    /// Lowest and highest z, mm.
    #[must_use]
    pub fn z_range_mm(&self) -> [f64; 2] {
        self.z.range()
    }

    /// Heights of the sections it runs through, mm.
    #[must_use]
    pub fn section_z_mm(&self) -> &[f64] {
        &self.z_mm
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
        TubeNet { n_u: self.n_u, z_mm: &self.z_mm, z: &self.z, control: &self.control }
    }

    /// The same surface with u counted from u = `steps` / n, n the number of points round a section.
    #[must_use]
    pub fn turned(mut self, steps: usize) -> Self {
        let width = 2 * self.n_u;
        self.control.chunks_exact_mut(width).for_each(|row| row.rotate_left(2 * (steps % self.n_u)));
        self
    }

    /// Moves the end section so that its point at u moves by `by`, by the least change of its control points; sections
    /// farther off than the next knot intervals in z stay.
    pub fn pull_end(&mut self, end: Side, u: f64, by: Vector2) {
        let n = self.n_u;
        let row = if end == Side::First { 0 } else { self.z.len() - 1 };
        let span = Basis::uniform(n, n).at(u);
        let squares: f64 = span.weights.iter().map(|w| w * w).sum();
        for (k, w) in span.weights.iter().enumerate() {
            let at = 2 * (row * n + (span.first + k + n - 1) % n);
            self.control[at] += by.x * w / squares;
            self.control[at + 1] += by.y * w / squares;
        }
    }

    /// The same surface with u clamped to [0, 1] and z as third coordinate.
    #[must_use]
    pub fn clamped(&self) -> PatchSurface {
        let (base, clamped) = (Basis::uniform(self.n_u, self.n_u), clamped_round(self.n_u));
        let spans = base.refinement(&clamped);
        let mut control = Vec::with_capacity(3 * clamped.len() * self.z.len());
        for (row, z) in self.control.chunks_exact(2 * self.n_u).zip(self.z.greville()) {
            for span in &spans {
                let p = weighted(row, span);
                control.extend([p.x, p.y, z]);
            }
        }
        PatchSurface { u: clamped, v: self.z.clone(), control }
    }

    fn row(&self, span: Span) -> SectionCurve {
        let mut control = Vec::new();
        Basis::combine(span, &self.control, 2 * self.n_u, &mut control);
        SectionCurve { control }
    }
}

/// The clamped basis of a curve once round with n uniform pieces, u from 0 to 1.
fn clamped_round(n: usize) -> Basis {
    let inner: Vec<f64> = (1..n).map(|k| k as f64 / n as f64).collect();
    Basis::clamped(3, [0.0, 1.0], &inner)
}

/// The weighted sum of periodic control points, counted from the one centred on -1 / n.
fn weighted(control: &[f64], span: &Span) -> Point2 {
    let n = control.len() / 2;
    let term = |(k, w): (usize, &f64)| {
        let j = (span.first + k + n - 1) % n;
        Vector2::new(control[2 * j], control[2 * j + 1]) * *w
    };
    span.weights.iter().enumerate().map(term).sum::<Vector2>().into()
}

/// The control net of a tube: points and derivatives without solving for each section anew.
#[derive(Debug, Clone)]
pub struct TubeNet<'a> {
    n_u: usize,
    z_mm: &'a [f64],
    z: &'a Basis,
    /// Control rows in v, each of the periodic control points x, y in u.
    control: &'a [f64],
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
    pub const fn section_z_mm(&self) -> &[f64] {
        self.z_mm
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
            Basis::combine(span, self.control, 2 * self.n_u, &mut row);
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
    /// x, y of the control points, the i-th one centred on u = i / n.
    control: Vec<f64>,
}

impl SectionCurve {
    /// The curve through points evenly spaced in u.
    ///
    /// # Panics
    /// Where there are fewer than three points.
    #[must_use]
    pub fn through_points(points: &[Point2]) -> Self {
        let values: Vec<f64> = points.iter().flat_map(|p| [p.x, p.y]).collect();
        Self { control: periodic_control_points(&values, 2) }
    }

    /// Number of points it was made through.
    #[must_use]
    pub fn len(&self) -> usize {
        self.control.len() / 2
    }

    /// Never true: a section has at least three points.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.control.is_empty()
    }

    /// The points at u = i / n.
    #[must_use]
    pub fn points(&self) -> Vec<Point2> {
        let n = self.len();
        let at = |i: usize, k: usize| self.control[2 * (i % n) + k];
        let coordinate = |i: usize, k: usize| (at(i + n - 1, k) + 4.0 * at(i, k) + at(i + 1, k)) / 6.0;
        (0..n).map(|i| Point2::new(coordinate(i, 0), coordinate(i, 1))).collect()
    }

    /// The part from u = a to u = b at height z, exactly, over the range [a, b]; a in [0, 1), a < b <= a + 1.
    #[must_use]
    pub fn arc(&self, [a, b]: [f64; 2], z_mm: f64) -> Curve {
        let n = self.len();
        let inner = (1..2 * n).map(|k| k as f64 / n as f64).filter(|t| *t > a && *t < b).collect::<Vec<_>>();
        let basis = Basis::clamped(3, [a, b], &inner);
        let point = |span: Span| {
            let p = weighted(&self.control, &span);
            Point3::new(p.x, p.y, z_mm)
        };
        let control = Basis::uniform(n, 2 * n).refinement(&basis).into_iter().map(point).collect();
        Curve::new(basis, control)
    }

    /// The u in [0, 1) at which the curve is nearest to a point, for a point near the curve.
    #[must_use]
    pub fn nearest(&self, p: Point2) -> f64 {
        let n = self.len();
        let points = self.points();
        let distance = |i: &usize| (points[*i] - p).norm_squared();
        let start = (0..n).min_by(|i, j| distance(i).total_cmp(&distance(j))).unwrap_or(0);
        let u = self.foot(p, start as f64 / n as f64, 1e-15).rem_euclid(1.0);
        if u < 1.0 { u } else { 0.0 }
    }

    /// The distance of a point from the curve near u, mm.
    #[must_use]
    pub fn distance_mm(&self, p: Point2, u: f64) -> f64 {
        (p - self.at(self.foot(p, u, 1e-3 / self.len() as f64))).norm()
    }

    /// The parameter near `start` at which the curve is nearest to a point, by steps down to the least one.
    fn foot(&self, p: Point2, start: f64, least_step: f64) -> f64 {
        let (mut u, step) = (start, 1.0 / self.len() as f64);
        for _ in 0..20 {
            let (off, along) = (p - self.at(u), self.derivative_at(u));
            let by = (off.dot(&along) / along.norm_squared().max(1e-300)).clamp(-step, step);
            u += by;
            if by.abs() < least_step {
                break;
            }
        }
        u
    }

    /// Largest second derivative with respect to u, mm: the second derivative of a cubic spline is linear between
    /// its knots, so it is largest at one of them.
    #[must_use]
    pub fn bend_mm(&self) -> f64 {
        (0..self.len()).map(|i| self.bend_at_knot_mm(i)).fold(0.0, f64::max)
    }

    /// The same of each piece between two knots, from u = 0 on.
    pub fn bends_mm(&self) -> impl Iterator<Item = f64> {
        (0..self.len()).map(|i| self.bend_at_knot_mm(i).max(self.bend_at_knot_mm(i + 1)))
    }

    /// The second derivative with respect to u at the i-th knot, mm.
    fn bend_at_knot_mm(&self, i: usize) -> f64 {
        let n = self.len();
        let control = |i: usize, k: usize| self.control[2 * (i % n) + k];
        let second = |k: usize| control(i + n - 1, k) - 2.0 * control(i, k) + control(i + 1, k);
        second(0).hypot(second(1)) * (n * n) as f64
    }

    /// The point at u (periodic in 1).
    #[must_use]
    pub fn at(&self, u: f64) -> Point2 {
        let (i, t) = self.piece(u);
        let s = 1.0 - t;
        let weights = [
            s * s * s / 6.0,
            (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0,
            (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0,
            t * t * t / 6.0,
        ];
        weighted(&self.control, &Span { first: i, weights })
    }

    /// The derivative with respect to u, mm.
    #[must_use]
    pub fn derivative_at(&self, u: f64) -> Vector2 {
        let (i, t) = self.piece(u);
        let s = 1.0 - t;
        let weights = [-0.5 * s * s, 1.5 * t * t - 2.0 * t, 2.0 * s - 1.5 * s * s, 0.5 * t * t];
        weighted(&self.control, &Span { first: i, weights }).coords * self.len() as f64
    }

    /// The piece in which u lies and how far in it.
    fn piece(&self, u: f64) -> (usize, f64) {
        let n = self.len();
        let scaled = u.rem_euclid(1.0) * n as f64;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "in 0..n")]
        let i = (scaled.floor() as usize).min(n - 1);
        (i, scaled - i as f64)
    }
}

/// A patch with four sides: a B-spline surface on clamped bases in both directions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawPatch")]
pub struct PatchSurface {
    u: Basis,
    v: Basis,
    /// Control rows in v, each of as many points (x, y, z) as u has functions.
    control: Vec<f64>,
}

/// A patch as it was read.
#[derive(Deserialize)]
struct RawPatch {
    u: Basis,
    v: Basis,
    control: Vec<f64>,
}

impl TryFrom<RawPatch> for PatchSurface {
    type Error = Malformed;

    fn try_from(RawPatch { u, v, control }: RawPatch) -> Result<Self, Malformed> {
        is_full(&control, [3, u.len(), v.len()])?;
        Ok(Self { u, v, control })
    }
}

/// A side of a patch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The first row or column.
    First,
    /// The last one.
    Last,
}

/// A point of a surface with its first derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jet {
    /// The point, mm.
    pub point: Point3,
    /// Derivative with respect to u.
    pub by_u: Vector3,
    /// Derivative with respect to v.
    pub by_v: Vector3,
}

impl PatchSurface {
    /// The patch through `grid[row][column]` at the parameters `v[row]`, `u[column]`: cubic in both directions.
    ///
    /// # Errors
    /// Fewer than two parameters, or parameters that do not ascend.
    ///
    /// # Panics
    /// Where the grid does not fit the parameters.
    pub fn through(u: &[f64], v: &[f64], grid: &[Vec<Point3>]) -> Result<Self, SplineError> {
        let (u_basis, v_basis) = (Basis::not_a_knot(u)?, Basis::not_a_knot(v)?);
        assert!(grid.len() == v.len(), "one row of points for each v");
        let mut rows = Vec::new();
        for row in grid {
            assert!(row.len() == u.len(), "one point for each u");
            let values: Vec<f64> = row.iter().flat_map(|p| [p.x, p.y, p.z]).collect();
            rows.extend(u_basis.interpolate(u, &values, 3));
        }
        let control = v_basis.interpolate(v, &rows, 3 * u.len());
        Ok(Self { u: u_basis, v: v_basis, control })
    }

    /// The patch that takes the given points, row by row, at the Greville abscissae of both bases.
    ///
    /// # Panics
    /// Where the number of points does not fit the bases.
    #[must_use]
    pub fn interpolating(u: Basis, v: Basis, points: &[Point3]) -> Self {
        assert_eq!(points.len(), u.len() * v.len(), "one point for each pair of functions");
        let columns = u.greville();
        let row = |row: &[Point3]| {
            let values: Vec<f64> = row.iter().flat_map(|p| [p.x, p.y, p.z]).collect();
            u.interpolate(&columns, &values, 3)
        };
        let rows: Vec<f64> = points.chunks_exact(u.len()).flat_map(row).collect();
        let control = v.interpolate(&v.greville(), &rows, 3 * u.len());
        Self { u, v, control }
    }

    /// The patch with the given control points, row by row.
    ///
    /// # Panics
    /// Where their number does not fit the bases.
    #[must_use]
    pub fn with_control(u: Basis, v: Basis, points: &[Point3]) -> Self {
        assert_eq!(points.len(), u.len() * v.len(), "one control point for each pair of functions");
        Self { u, v, control: points.iter().flat_map(|p| [p.x, p.y, p.z]).collect() }
    }

    /// The bases in u and v.
    #[must_use]
    pub const fn bases(&self) -> [&Basis; 2] {
        [&self.u, &self.v]
    }

    /// Its control points, row by row, mm.
    pub fn control(&self) -> impl Iterator<Item = Point3> {
        self.control.chunks_exact(3).map(|p| Point3::new(p[0], p[1], p[2]))
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

    /// The border at the first or last v, over u.
    #[must_use]
    pub fn border_row(&self, side: Side) -> Curve {
        let row = if side == Side::First { 0 } else { self.v.len() - 1 };
        let n = self.u.len();
        Curve::new(self.u.clone(), self.control().skip(row * n).take(n).collect())
    }

    /// The border at the first or last u, over v.
    #[must_use]
    pub fn border_column(&self, side: Side) -> Curve {
        let n = self.u.len();
        let column = if side == Side::First { 0 } else { n - 1 };
        Curve::new(self.v.clone(), self.control().skip(column).step_by(n).collect())
    }

    /// The same surface on bases that hold all knots of its own ([`Basis::refinement`]).
    #[must_use]
    pub fn refined(&self, u: &Basis, v: &Basis) -> Self {
        let mut rows = Vec::with_capacity(3 * u.len() * self.v.len());
        let (spans, mut out) = (self.u.refinement(u), Vec::new());
        for row in self.control.chunks_exact(3 * self.u.len()) {
            for &span in &spans {
                Basis::combine(span, row, 3, &mut out);
                rows.extend_from_slice(&out);
            }
        }
        let mut control = Vec::with_capacity(3 * u.len() * v.len());
        for span in self.v.refinement(v) {
            Basis::combine(span, &rows, 3 * u.len(), &mut out);
            control.extend_from_slice(&out);
        }
        Self { u: u.clone(), v: v.clone(), control }
    }

    /// Number of control points along u and along v.
    #[must_use]
    pub fn n_functions(&self) -> [usize; 2] {
        [self.u.len(), self.v.len()]
    }

    /// The iso-curve at v, ready for evaluation in u.
    #[must_use]
    pub fn row(&self, v: f64) -> PatchRow<'_> {
        self.combined(self.v.at(v))
    }

    /// The derivative of the iso-curve with respect to v.
    #[must_use]
    pub fn row_slope(&self, v: f64) -> PatchRow<'_> {
        self.combined(self.v.derivative_at(v))
    }

    fn combined(&self, span: Span) -> PatchRow<'_> {
        let mut control = Vec::new();
        Basis::combine(span, &self.control, 3 * self.u.len(), &mut control);
        PatchRow { basis: &self.u, control }
    }

    /// The point at (u, v).
    #[must_use]
    pub fn at(&self, u: f64, v: f64) -> Point3 {
        self.weighted(self.u.at(u), self.v.at(v)).into()
    }

    /// The point at (u, v) with its derivatives.
    #[must_use]
    pub fn jet(&self, u: f64, v: f64) -> Jet {
        let (at_u, at_v) = (self.u.at(u), self.v.at(v));
        Jet {
            point: self.weighted(at_u, at_v).into(),
            by_u: self.weighted(self.u.derivative_at(u), at_v),
            by_v: self.weighted(at_u, self.v.derivative_at(v)),
        }
    }

    fn weighted(&self, su: Span, sv: Span) -> Vector3 {
        let width = 3 * self.u.len();
        let mut sum = Vector3::zeros();
        for (k, wv) in sv.weights.iter().enumerate().take(self.v.degree() + 1) {
            let row = &self.control[(sv.first + k) * width + 3 * su.first..];
            for (wu, p) in su.weights.iter().zip(row.chunks_exact(3)).take(self.u.degree() + 1) {
                sum += Vector3::new(p[0], p[1], p[2]) * (wu * wv);
            }
        }
        sum
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
        self.weighted(self.basis.at(u)).into()
    }

    /// The derivative with respect to u.
    #[must_use]
    pub fn derivative_at(&self, u: f64) -> Vector3 {
        self.weighted(self.basis.derivative_at(u))
    }

    /// First and last u.
    #[must_use]
    pub fn range(&self) -> [f64; 2] {
        self.basis.range()
    }

    /// Its pieces between knots, each with the largest length of the second derivative on it. That derivative is at most
    /// linear there: it is largest at an end.
    #[must_use]
    pub fn bends(&self) -> Vec<([f64; 2], f64)> {
        let (p, knots) = (self.basis.degree(), self.basis.knots());
        let point = |i: usize| Vector3::from_column_slice(&self.control[3 * i..3 * i + 3]);
        let first = |i: usize| (point(i + 1) - point(i)) * (p as f64 / (knots[i + p + 1] - knots[i + 1]));
        let second =
            |i: usize| (first(i + 1) - first(i)) * ((p - 1) as f64 / (knots[i + p + 1] - knots[i + 2]));
        let bend = |j: usize| (j - p..j + 1 - p.min(2)).map(|i| second(i).norm()).fold(0.0, f64::max);
        let pieces = (p..self.basis.len()).filter(|&j| knots[j] < knots[j + 1]);
        pieces.map(|j| ([knots[j], knots[j + 1]], if p < 2 { 0.0 } else { bend(j) })).collect()
    }

    /// Its control points, x, y, z one after the other.
    #[must_use]
    pub fn control(&self) -> &[f64] {
        &self.control
    }

    /// The control points weighted by a span of its basis.
    #[must_use]
    pub fn weighted(&self, span: Span) -> Vector3 {
        let terms = span.weights.iter().zip(self.control[3 * span.first..].chunks_exact(3));
        terms.map(|(w, p)| Vector3::new(p[0], p[1], p[2]) * *w).sum()
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

    fn bent_tube() -> TubeSurface {
        let z: Vec<f64> = (0..6).map(|k| 1.5 * f64::from(k)).collect();
        let circle = |z: f64| Contour::circle(Point2::new(0.1 * z * z, 0.3 * z), 2.0 + 0.1 * z, 32).points;
        TubeSurface::through(&z, &z.iter().map(|&z| circle(z)).collect::<Vec<_>>()).unwrap()
    }

    #[test]
    fn a_clamped_tube_is_the_tube_and_its_arcs_lie_on_it() {
        let tube = bent_tube();
        let patch = tube.clamped();
        for (u, z) in [(0.0, 0.0), (0.3, 1.1), (0.999, 4.0), (1.0, 7.5)] {
            let (p, q) = (tube.section(z).at(u), patch.at(u, z));
            assert!((p - q.xy()).norm() < 1e-13 && (q.z - z).abs() < 1e-13);
            let h = 1e-5;
            let by_u = (tube.section(z).at(u + h) - tube.section(z).at(u - h)) / (2.0 * h);
            assert!((tube.section(z).derivative_at(u) - by_u).norm() < 1e-6);
            assert!((patch.jet(u, z).by_u.xy() - by_u).norm() < 1e-6);
        }
        let end = tube.section(7.5);
        for [a, b] in [[0.0, 1.0], [0.21, 0.7], [0.9, 1.6], [0.5, 1.5], [0.25, 0.26]] {
            let arc = end.arc([a, b], 7.5);
            for k in 0..=20 {
                let u = a + (b - a) * f64::from(k) / 20.0;
                assert!((arc.at(u).xy() - end.at(u)).norm() < 1e-13, "{a} {b} {u}");
            }
        }
        assert!((end.nearest(end.at(0.777)) - 0.777).abs() < 1e-12);
        let mut pulled = tube.clone();
        pulled.pull_end(Side::Last, 0.43, Vector2::new(0.01, 0.02));
        let moved = pulled.section(7.5).at(0.43) - end.at(0.43);
        assert!((moved - Vector2::new(0.01, 0.02)).norm() < 1e-14);
        assert!((pulled.section(7.5).at(0.9) - end.at(0.9)).norm() < 1e-14);
        let turned = tube.clone().turned(5).section(2.0).at(0.1);
        assert!((turned - tube.section(2.0).at(0.1 + 5.0 / 32.0)).norm() < 1e-13);
    }

    #[test]
    fn a_surface_that_was_read_has_the_numbers_it_needs() {
        let (tube, patch) = (bent_tube(), bent_tube().clamped());
        let damaged = |text: &str, what: &dyn Fn(&mut serde_json::Value)| {
            let mut value: serde_json::Value = serde_json::from_str(text).unwrap();
            what(&mut value);
            value
        };
        let text = serde_json::to_string(&tube).unwrap();
        let of_tube = |what: &dyn Fn(&mut serde_json::Value)| {
            serde_json::from_value::<TubeSurface>(damaged(&text, what)).map_err(|e| e.to_string())
        };
        assert!(of_tube(&|_| {}).is_ok());
        assert!(of_tube(&|v| v["n_u"] = 0.into()).is_err_and(|e| e.contains("three points")));
        assert!(of_tube(&|v| v["n_u"] = u64::MAX.into()).is_err_and(|e| e.contains("do not fit")));
        assert!(of_tube(&|v| v["z_mm"] = serde_json::json!([])).is_err_and(|e| e.contains("heights")));
        assert!(
            of_tube(&|v| v["control"].as_array_mut().unwrap().truncate(7))
                .is_err_and(|e| e.contains("do not fit"))
        );
        let text = serde_json::to_string(&patch).unwrap();
        let of_patch = |what: &dyn Fn(&mut serde_json::Value)| {
            serde_json::from_value::<PatchSurface>(damaged(&text, what)).map_err(|e| e.to_string())
        };
        assert!(of_patch(&|_| {}).is_ok());
        assert!(
            of_patch(&|v| v["control"] = serde_json::json!([1.0])).is_err_and(|e| e.contains("do not fit"))
        );
    }

    #[test]
    fn a_refined_patch_is_the_same_surface() {
        let patch = bent_tube().clamped();
        let [u, v] = patch.bases();
        let with = |basis: &Basis, extra: f64| {
            let mut inner = basis.inner_knots().to_vec();
            inner.insert(inner.partition_point(|k| *k < extra), extra);
            Basis::clamped(3, basis.range(), &inner)
        };
        let finer = patch.refined(&with(u, 0.123), &with(v, 3.3));
        for (u, v) in [(0.0, 0.0), (0.12, 3.2), (0.6, 6.0), (1.0, 7.5)] {
            assert!((patch.at(u, v) - finer.at(u, v)).norm() < 1e-13);
        }
        let (columns, rows) = (u.greville(), v.greville());
        let points: Vec<Point3> = rows
            .iter()
            .flat_map(|&v| columns.iter().map(move |&u| (u, v)))
            .map(|(u, v)| patch.at(u, v))
            .collect();
        let again = PatchSurface::interpolating(u.clone(), v.clone(), &points);
        assert!((again.at(0.37, 2.9) - patch.at(0.37, 2.9)).norm() < 1e-12);
        assert!((patch.border_column(Side::Last).at(2.2) - patch.at(1.0, 2.2)).norm() < 1e-13);
        assert!((patch.border_row(Side::First).at(0.4) - patch.at(0.4, 0.0)).norm() < 1e-13);
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
