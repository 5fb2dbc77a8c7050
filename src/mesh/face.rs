//! The triangles of one face, with the operations that change them: flip, split, insert, move.
//!
//! Every triangle knows its neighbours. Vertices carry their parameters on the face's surface; in the parameters
//! all triangles run counter-clockwise and cover the face once, and no operation is done that would break this. Edges
//! on the border are shared with other faces and never change.

use super::chart::Chart;
use crate::geom::{Point2, Point3, Vector3};
use robust::Coord;

/// No triangle on the other side.
const BORDER: u32 = u32::MAX;
/// Flips happen only where the cotangents of the opposite angles sum up to less than this: a flip and its return are
/// never both done for rounding's sake.
const FLIP_BELOW: f64 = -1e-6;

/// Least area of a triangle in the parameters over the product of its extents there.
const UPRIGHT: f64 = 1e-3;

/// A vertex of a face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Corner {
    /// Parameters on the surface.
    pub(super) param: Point2,
    /// Place.
    pub(super) point: Point3,
    /// Whether the first parameter means nothing here: the tip of a dome.
    pub(super) is_pole: bool,
    /// Its number in the whole mesh, where it is shared.
    pub(super) shared: Option<u32>,
}

/// One face's triangles.
#[derive(Debug)]
pub(super) struct Face<'a> {
    pub(super) chart: &'a Chart,
    pub(super) corners: Vec<Corner>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Across the edge opposite to each corner.
    neighbours: Vec<[u32; 3]>,
    /// A triangle at each vertex.
    incident: Vec<u32>,
    is_border: Vec<bool>,
    /// Triangles that changed since [`Face::take_changed`].
    changed: Vec<u32>,
    /// Whether edges may be flipped.
    pub(super) may_flip: bool,
    /// Lengths of a unit of either parameter: where given, triangles are judged in the plane of the parameters.
    pub(super) plane: Option<[f64; 2]>,
}

const fn next(i: usize) -> usize {
    (i + 1) % 3
}

const fn previous(i: usize) -> usize {
    (i + 2) % 3
}

impl<'a> Face<'a> {
    /// A face of triangles that run counter-clockwise in the parameters.
    pub(super) fn new(chart: &'a Chart, corners: Vec<Corner>, triangles: Vec<[u32; 3]>) -> Self {
        let neighbours = adjacency(&triangles);
        let mut incident = vec![0; corners.len()];
        let mut is_border = vec![false; corners.len()];
        for (t, (triangle, across)) in (0..).zip(triangles.iter().zip(&neighbours)) {
            for i in 0..3 {
                incident[triangle[i] as usize] = t;
                if across[i] == BORDER {
                    is_border[triangle[next(i)] as usize] = true;
                    is_border[triangle[previous(i)] as usize] = true;
                }
            }
        }
        Self {
            chart,
            corners,
            triangles,
            neighbours,
            incident,
            is_border,
            changed: Vec::new(),
            may_flip: true,
            plane: None,
        }
    }

    /// Whether a vertex lies on the face's border.
    pub(super) fn is_border(&self, v: u32) -> bool {
        self.is_border[v as usize]
    }

    /// The triangle across the edge opposite to corner i, if any.
    pub(super) fn across(&self, t: u32, i: usize) -> Option<u32> {
        let o = self.neighbours[t as usize][i];
        (o != BORDER).then_some(o)
    }

    /// Triangles that changed since the last call, ascending.
    pub(super) fn take_changed(&mut self) -> Vec<u32> {
        let mut changed = std::mem::take(&mut self.changed);
        changed.sort_unstable();
        changed.dedup();
        changed
    }

    /// Places of a triangle's corners.
    pub(super) fn places(&self, t: u32) -> [Point3; 3] {
        self.triangles[t as usize].map(|v| self.corners[v as usize].point)
    }

    /// Parameters of a triangle's corners, in one period.
    pub(super) fn params(&self, t: u32) -> [Point2; 3] {
        self.unrolled(self.triangles[t as usize])
    }

    /// Parameters of three vertices, in one period; a pole gets the mean of the others.
    fn unrolled(&self, vertices: [u32; 3]) -> [Point2; 3] {
        let corners = vertices.map(|v| self.corners[v as usize]);
        let mut params = corners.map(|c| c.param);
        if !self.chart.is_periodic() {
            return params;
        }
        let pole = corners.iter().position(|c| c.is_pole);
        let origin = params[pole.map_or(0, next)].x;
        for p in &mut params {
            p.x = origin + (p.x - origin + 0.5).rem_euclid(1.0) - 0.5;
        }
        if let Some(i) = pole {
            params[i].x = 0.5 * (params[next(i)].x + params[previous(i)].x);
        }
        params
    }

    /// Whether three vertices run counter-clockwise in the parameters and are not nearly on one line there: such a
    /// triangle may hide much of a bent surface.
    fn is_upright(&self, vertices: [u32; 3]) -> bool {
        let [a, b, c] = self.unrolled(vertices);
        let (ab, ac) = (b - a, c - a);
        let area = ab.perp(&ac);
        area > UPRIGHT * (ab.x.abs() + ac.x.abs()) * (ab.y.abs() + ac.y.abs())
    }

    /// The corner of `t` that lies opposite to its edge with `vertices[b]`, `vertices[c]`.
    fn corner_apart(&self, t: u32, b: u32, c: u32) -> usize {
        let triangle = self.triangles[t as usize];
        (0..3).find(|&j| triangle[j] != b && triangle[j] != c).unwrap_or(0)
    }

    fn relink(&mut self, t: u32, from: u32, to: u32) {
        if t != BORDER
            && let Some(slot) = self.neighbours[t as usize].iter_mut().find(|n| **n == from)
        {
            *slot = to;
        }
    }

    fn set(&mut self, t: u32, triangle: [u32; 3], across: [u32; 3]) {
        let i = t as usize;
        if i == self.triangles.len() {
            self.triangles.push(triangle);
            self.neighbours.push(across);
        } else {
            self.triangles[i] = triangle;
            self.neighbours[i] = across;
        }
        for v in triangle {
            self.incident[v as usize] = t;
        }
        self.changed.push(t);
    }

    fn add(&mut self, corner: Corner) -> u32 {
        self.corners.push(corner);
        self.incident.push(0);
        self.is_border.push(false);
        self.n_vertices() - 1
    }

    fn n_vertices(&self) -> u32 {
        u32::try_from(self.corners.len()).unwrap_or(u32::MAX)
    }

    fn n_triangles(&self) -> u32 {
        u32::try_from(self.triangles.len()).unwrap_or(u32::MAX)
    }

    /// Both triangles at the edge opposite to corner i of t: (a, b, c) and (d, c, b), with the index of d.
    fn pair(&self, t: u32, i: usize) -> Option<(u32, usize, [u32; 4])> {
        let o = self.across(t, i)?;
        let triangle = self.triangles[t as usize];
        let (a, b, c) = (triangle[i], triangle[next(i)], triangle[previous(i)]);
        let j = self.corner_apart(o, b, c);
        Some((o, j, [a, b, c, self.triangles[o as usize][j]]))
    }

    /// Replaces the edge opposite to corner i by the other diagonal where that makes better triangles (the angles
    /// opposite to the edge sum up to more than 180 degrees: the Delaunay criterion on the triangles in space).
    fn flip_if_better(&mut self, t: u32, i: usize) -> bool {
        let Some((o, j, [a, b, c, d])) = self.pair(t, i) else { return false };
        if let Some(scale) = self.plane {
            if !self.is_better_in_plane([a, b, c, d], scale) {
                return false;
            }
            self.turn([t, o], [i, j], [a, b, c, d]);
            return true;
        }
        let [pa, pb, pc, pd] = [a, b, c, d].map(|v| self.corners[v as usize].point);
        let poles = [a, b, c, d].iter().filter(|&&v| self.corners[v as usize].is_pole).count();
        let old = [(pb - pa).cross(&(pc - pa)), (pc - pd).cross(&(pb - pd))];
        let new = [(pb - pa).cross(&(pd - pa)), (pd - pa).cross(&(pc - pa))];
        let is_delaunay = || cotangent(pa, pb, pc) + cotangent(pd, pc, pb) >= FLIP_BELOW;
        let is_flat = old[0].dot(&old[1]) > 0.0;
        if is_flat && is_delaunay() {
            return false;
        }
        if a == d || poles > 0 && self.corners[b as usize].is_pole | self.corners[c as usize].is_pole {
            return false;
        }
        let both = old[0] + old[1];
        if (!is_flat || new.iter().any(|n| n.dot(&both) <= 0.0))
            && !self.is_unfolding([a, b, c, d], old, new, &is_delaunay)
        {
            return false;
        }
        if !self.is_upright([a, b, d]) || !self.is_upright([a, d, c]) || self.ring(a).contains(&d) {
            return false;
        }
        self.turn([t, o], [i, j], [a, b, c, d]);
        true
    }

    /// Replaces the edge b-c between two triangles by the edge a-d; i and j are the places of a and d.
    fn turn(&mut self, [t, o]: [u32; 2], [i, j]: [usize; 2], [a, b, c, d]: [u32; 4]) {
        let (nt, no) = (self.neighbours[t as usize], self.neighbours[o as usize]);
        self.set(t, [a, b, d], [no[next(j)], o, nt[previous(i)]]);
        self.set(o, [a, d, c], [no[previous(j)], nt[next(i)], t]);
        self.relink(no[next(j)], o, t);
        self.relink(nt[next(i)], t, o);
    }

    /// Whether two triangles, a-b-c and d-c-b, of which one is turned over against the surface, or two triangles that
    /// bend sharply, had better be a-b-d and a-d-c.
    fn is_unfolding(
        &self,
        vertices: [u32; 4],
        old: [Vector3; 2],
        new: [Vector3; 2],
        is_delaunay: &dyn Fn() -> bool,
    ) -> bool {
        let [_, b, c, _] = vertices;
        let [_, from, to] = self.unrolled([vertices[0], b, c]);
        let [du, dv] = self.chart.tangents(nalgebra::center(&from, &to));
        let normal = du.cross(&dv);
        let least = |two: [Vector3; 2]| {
            two.iter().map(|n| n.dot(&normal) / n.norm().max(f64::MIN_POSITIVE)).fold(f64::INFINITY, f64::min)
        };
        let (before, after) = (least(old), least(new));
        if before > 0.0 { after > 0.0 && !is_delaunay() } else { after > before + 0.01 * normal.norm() }
    }

    /// Whether the edge b-c of a face with a border all round is not Delaunay in its parameters.
    fn is_better_in_plane(&self, vertices: [u32; 4], [u, v]: [f64; 2]) -> bool {
        let [a, b, c, d] =
            vertices.map(|w| self.corners[w as usize].param).map(|p| Coord { x: p.x * u, y: p.y * v });
        robust::orient2d(a, b, d) > 0.0
            && robust::orient2d(a, d, c) > 0.0
            && robust::incircle(a, b, c, d) > 0.0
    }

    /// Vertices joined to v by an edge.
    fn ring(&self, v: u32) -> Vec<u32> {
        let mut ring = Vec::with_capacity(8);
        for t in self.star(v) {
            for w in self.triangles[t as usize] {
                if w != v && !ring.contains(&w) {
                    ring.push(w);
                }
            }
        }
        ring
    }

    /// The triangles that share a corner with t, t among them, ascending.
    pub(super) fn around(&self, t: u32) -> Vec<u32> {
        let mut around: Vec<u32> = self.triangles[t as usize].iter().flat_map(|&v| self.star(v)).collect();
        around.sort_unstable();
        around.dedup();
        around
    }

    /// Triangles at v, in turn.
    pub(super) fn star(&self, v: u32) -> Vec<u32> {
        let start = self.incident[v as usize];
        let mut star = Vec::with_capacity(8);
        star.push(start);
        let place = |t: u32| self.triangles[t as usize].iter().position(|&w| w == v).unwrap_or(0);
        for turn in [next as fn(usize) -> usize, previous] {
            let mut t = start;
            loop {
                match self.across(t, turn(place(t))) {
                    Some(o) if o == start => return star,
                    Some(o) => {
                        star.push(o);
                        t = o;
                    }
                    None => break,
                }
            }
        }
        star
    }

    /// Flips edges until none gets better by it, beginning at those of the given triangles.
    pub(super) fn flip_all(&mut self, from: impl IntoIterator<Item = u32>) {
        let mut stack: Vec<u32> = from.into_iter().collect();
        // Each flip makes angles better; the bound holds where triangles far from flat would go in circles.
        let mut left = if self.may_flip { 20 * stack.len() + 100 } else { 0 };
        while let Some(t) = stack.pop() {
            for i in 0..3 {
                let other = self.across(t, i);
                if left > 0 && self.flip_if_better(t, i) {
                    left -= 1;
                    stack.push(t);
                    stack.extend(other);
                    break;
                }
            }
        }
    }

    /// Flips edges of the whole face.
    pub(super) fn flip_everywhere(&mut self) {
        self.flip_all((0..self.n_triangles()).rev());
    }

    /// A vertex on the surface at the given parameters.
    fn corner_at(&self, param: Point2) -> Corner {
        let param =
            if self.chart.is_periodic() { Point2::new(param.x.rem_euclid(1.0), param.y) } else { param };
        Corner { param, point: self.chart.at(param), is_pole: false, shared: None }
    }

    /// Splits the edge opposite to corner i of t in the middle of its parameters; `false` on the border.
    pub(super) fn split(&mut self, t: u32, i: usize) -> bool {
        let Some((o, j, [a, b, c, d])) = self.pair(t, i) else { return false };
        let params = self.params(t);
        let middle = nalgebra::center(&params[next(i)], &params[previous(i)]);
        let m = self.add(self.corner_at(middle));
        let (nt, no) = (self.neighbours[t as usize], self.neighbours[o as usize]);
        let t2 = self.n_triangles();
        let o2 = t2 + 1;
        self.set(t, [a, b, m], [o2, t2, nt[previous(i)]]);
        self.set(t2, [a, m, c], [o, nt[next(i)], t]);
        self.set(o2, [d, m, b], [t, no[next(j)], o]);
        self.set(o, [d, c, m], [t2, o2, no[previous(j)]]);
        self.relink(nt[next(i)], t, t2);
        self.relink(no[next(j)], o, o2);
        self.flip_all([t, t2, o, o2]);
        true
    }

    /// Puts a vertex into the middle of a triangle's parameters.
    pub(super) fn insert(&mut self, t: u32) {
        let [a, b, c] = self.triangles[t as usize];
        let params = self.params(t);
        let middle = (params[0].coords + params[1].coords + params[2].coords) / 3.0;
        let m = self.add(self.corner_at(middle.into()));
        let [na, nb, nc] = self.neighbours[t as usize];
        let t2 = self.n_triangles();
        let t3 = t2 + 1;
        self.set(t, [a, b, m], [t2, t3, nc]);
        self.set(t2, [b, c, m], [t3, t, na]);
        self.set(t3, [c, a, m], [t, t2, nb]);
        self.relink(na, t, t2);
        self.relink(nb, t, t3);
        self.flip_all([t, t2, t3]);
    }

    /// Moves an inner vertex towards the middle of its neighbours where this makes the least of the angles round
    /// it larger.
    pub(super) fn smooth(&mut self, v: u32) -> bool {
        let corner = self.corners[v as usize];
        if self.is_border(v) || corner.is_pole {
            return false;
        }
        let star = self.star(v);
        let ring = self.ring(v);
        let sum: Vector3 = ring.iter().map(|&w| self.corners[w as usize].point - corner.point).sum();
        let [du, dv] = self.chart.tangents(corner.param);
        let Some(step) = solved(du, dv, sum / ring.len() as f64) else { return false };
        let before = self.least_sine_of(&star);
        for share in [1.0, 0.5] {
            let moved = self.corner_at(corner.param + step * share);
            self.corners[v as usize] = moved;
            let stands = star.iter().all(|&t| self.is_upright(self.triangles[t as usize]));
            if stands && self.least_sine_of(&star) > before + 1e-4 {
                self.changed.extend(star);
                return true;
            }
        }
        self.corners[v as usize] = corner;
        false
    }

    /// The least sine of an angle of the triangles.
    fn least_sine_of(&self, triangles: &[u32]) -> f64 {
        triangles.iter().map(|&t| least_sine(self.places(t))).fold(f64::INFINITY, f64::min)
    }

    /// The least sine of a triangle's angles.
    pub(super) fn least_sine(&self, t: u32) -> f64 {
        least_sine(self.places(t))
    }
}

/// The sine of the smallest angle: twice the area over the product of the two longer sides.
fn least_sine([a, b, c]: [Point3; 3]) -> f64 {
    let sides = [(b - a).norm(), (c - b).norm(), (a - c).norm()];
    let product = sides[0] * sides[1] * sides[2] / sides.into_iter().fold(f64::INFINITY, f64::min);
    (b - a).cross(&(c - a)).norm() / product.max(f64::MIN_POSITIVE)
}

/// Cotangent of the angle at a.
fn cotangent(a: Point3, b: Point3, c: Point3) -> f64 {
    let (ab, ac) = (b - a, c - a);
    ab.dot(&ac) / ab.cross(&ac).norm().max(1e-300)
}

/// The parameters' step whose image is nearest to `target`; `None` where the surface is degenerate.
fn solved(du: Vector3, dv: Vector3, target: Vector3) -> Option<nalgebra::Vector2<f64>> {
    let (e, f, g) = (du.norm_squared(), du.dot(&dv), dv.norm_squared());
    let determinant = e * g - f * f;
    if determinant <= 1e-6 * e * g {
        return None;
    }
    let (s, t) = (du.dot(&target), dv.dot(&target));
    Some(nalgebra::Vector2::new((g * s - f * t) / determinant, (e * t - f * s) / determinant))
}

/// Across the edge opposite to each corner.
fn adjacency(triangles: &[[u32; 3]]) -> Vec<[u32; 3]> {
    let mut edges: Vec<(u64, u32, u8)> = Vec::with_capacity(3 * triangles.len());
    for (t, triangle) in (0..).zip(triangles) {
        for i in 0..3u8 {
            let (a, b) = (triangle[next(usize::from(i))], triangle[previous(usize::from(i))]);
            edges.push(((u64::from(a.min(b)) << 32) | u64::from(a.max(b)), t, i));
        }
    }
    edges.sort_unstable();
    let mut neighbours = vec![[BORDER; 3]; triangles.len()];
    for pair in edges.windows(2).filter(|p| p[0].0 == p[1].0) {
        let [(_, t, i), (_, o, j)] = [pair[0], pair[1]];
        neighbours[t as usize][usize::from(i)] = o;
        neighbours[o as usize][usize::from(j)] = t;
    }
    neighbours
}
