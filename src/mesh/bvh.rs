//! A bounding-volume hierarchy over the triangles of a mesh.
//!
//! Triangles are ordered along a Morton curve through their centroids (Morton, 1966; Lauterbach et al., *Fast BVH
//! Construction on GPUs*, 2009); runs of [`LEAF`] neighbours are the leaves, and each level above pairs two boxes of
//! the one below. Nothing is balanced or split: O(n log n) for the sort, and two boxes of 24 bytes a leaf.
//!
//! Boxes hold 32-bit floats rounded outward, so that they never miss what they enclose.

use super::TriMesh;
use crate::geom::Point3;
use rayon::prelude::*;

/// Triangles a leaf.
pub(super) const LEAF: usize = 4;
/// Bits an axis of a Morton code.
const MORTON_BITS: u32 = 10;

/// An axis-parallel box, mm.
#[derive(Debug, Clone, Copy)]
pub(super) struct Box3 {
    low: [f32; 3],
    high: [f32; 3],
}

impl Box3 {
    const EMPTY: Self = Self { low: [f32::INFINITY; 3], high: [f32::NEG_INFINITY; 3] };

    fn of(corners: &[Point3; 3]) -> Self {
        let along = |k: usize| corners.map(|p| p[k]);
        let least = |k: usize| along(k).into_iter().fold(f64::INFINITY, f64::min);
        let most = |k: usize| along(k).into_iter().fold(f64::NEG_INFINITY, f64::max);
        Self { low: [0, 1, 2].map(|k| below(least(k))), high: [0, 1, 2].map(|k| above(most(k))) }
    }

    fn union(self, other: Self) -> Self {
        Self {
            low: [0, 1, 2].map(|k| self.low[k].min(other.low[k])),
            high: [0, 1, 2].map(|k| self.high[k].max(other.high[k])),
        }
    }

    /// How far a point is from the box, mm; 0 inside.
    fn distance_mm(&self, p: Point3) -> f64 {
        let beyond = |k: usize| (f64::from(self.low[k]) - p[k]).max(p[k] - f64::from(self.high[k])).max(0.0);
        (beyond(0).powi(2) + beyond(1).powi(2) + beyond(2).powi(2)).sqrt()
    }

    /// Whether the boxes have a point in common.
    pub(super) fn meets(&self, other: &Self) -> bool {
        // Without a branch an axis: most pairs of boxes that are asked for do meet on two of them.
        let apart = |k: usize| (self.low[k] > other.high[k]) | (other.low[k] > self.high[k]);
        !(apart(0) | apart(1) | apart(2))
    }
}

#[expect(clippy::cast_possible_truncation, reason = "rounded outward")]
fn below(v: f64) -> f32 {
    let single = v as f32;
    if f64::from(single) > v { single.next_down() } else { single }
}

#[expect(clippy::cast_possible_truncation, reason = "rounded outward")]
fn above(v: f64) -> f32 {
    let single = v as f32;
    if f64::from(single) < v { single.next_up() } else { single }
}

/// The hierarchy.
#[derive(Debug)]
pub(super) struct Bvh {
    /// Triangles in the order of the leaves.
    pub(super) order: Vec<u32>,
    /// Their boxes, in that order.
    pub(super) boxes: Vec<Box3>,
    /// Boxes of the leaves, of their pairs, of pairs of these, ...; the last level has one.
    levels: Vec<Vec<Box3>>,
}

impl Bvh {
    /// Over all triangles of a mesh.
    pub(super) fn of(mesh: &TriMesh) -> Self {
        let corners = |t: &[u32; 3]| t.map(|v| mesh.vertices[v as usize]);
        let unordered: Vec<Box3> = mesh.triangles.par_iter().map(|t| Box3::of(&corners(t))).collect();
        let whole = unordered.par_iter().copied().reduce(|| Box3::EMPTY, Box3::union);
        let key = |(i, b): (usize, &Box3)| u64::from(morton(b, &whole)) << 32 | i as u64;
        let mut keys: Vec<u64> = unordered.par_iter().enumerate().map(key).collect();
        keys.par_sort_unstable();
        #[expect(clippy::cast_possible_truncation, reason = "the lower half is the triangle's number")]
        let order: Vec<u32> = keys.into_iter().map(|k| k as u32).collect();
        let boxes: Vec<Box3> = order.iter().map(|&t| unordered[t as usize]).collect();
        let join = |group: &[Box3]| group.iter().copied().fold(Box3::EMPTY, Box3::union);
        let mut levels: Vec<Vec<Box3>> = vec![boxes.chunks(LEAF).map(join).collect()];
        while let Some(last) = levels.last().filter(|l| l.len() > 1) {
            let above = last.chunks(2).map(join).collect();
            levels.push(above);
        }
        Self { order, boxes, levels }
    }

    /// The lowest level of no more than this many nodes, and how many it has.
    pub(super) fn level_of(&self, n_most: usize) -> (usize, usize) {
        let level = self.levels.iter().position(|l| l.len() <= n_most).unwrap_or(self.levels.len() - 1);
        (level, self.levels[level].len())
    }

    /// Places in the order that a leaf covers.
    pub(super) fn leaf(&self, leaf: usize) -> std::ops::Range<usize> {
        leaf * LEAF..self.order.len().min((leaf + 1) * LEAF)
    }

    /// Visits the pairs of leaves under two nodes of a level whose boxes meet; under one node with itself, every leaf with
    /// itself and each pair once.
    pub(super) fn meeting(&self, level: usize, [a, b]: [usize; 2], visit: &mut impl FnMut(usize, usize)) {
        let boxes = &self.levels[level];
        if !boxes[a].meets(&boxes[b]) {
            return;
        }
        if level == 0 {
            return visit(a, b);
        }
        let n = self.levels[level - 1].len();
        let pairs = [[2 * a, 2 * b], [2 * a, 2 * b + 1], [2 * a + 1, 2 * b], [2 * a + 1, 2 * b + 1]];
        for pair in pairs.into_iter().filter(|[i, j]| i <= j && *j < n && *i < n) {
            self.meeting(level - 1, pair, visit);
        }
    }
}

/// A triangle's nearest point to another one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Nearest {
    /// Distance, mm.
    pub(super) distance_mm: f64,
    /// The triangle's number.
    pub(super) triangle: u32,
    /// The nearest point on it.
    pub(super) at: Point3,
}

impl Bvh {
    /// The point of a mesh (that the hierarchy was made of) nearest to p, unless all are `within_mm` or farther away, or there are no
    /// triangles.
    pub(super) fn nearest(&self, mesh: &TriMesh, p: Point3, within_mm: f64) -> Option<Nearest> {
        self.nearer(mesh, p, within_mm, false)
    }

    /// Whether a point of the mesh is nearer to p than this.
    pub(super) fn is_within(&self, mesh: &TriMesh, p: Point3, mm: f64) -> bool {
        self.nearer(mesh, p, mm, true).is_some()
    }

    /// The nearest point of all that are nearer than `within_mm`, or the first one found.
    fn nearer(&self, mesh: &TriMesh, p: Point3, within_mm: f64, any_will_do: bool) -> Option<Nearest> {
        let mut best = Nearest { distance_mm: within_mm, triangle: 0, at: p };
        let mut is_found = false;
        let top = self.levels.len() - 1;
        let root = self.levels[top].first()?;
        let mut stack = [(0, 0, 0.0); 64];
        stack[0] = (top, 0, root.distance_mm(p));
        let mut n = 1;
        while n > 0 && !(is_found && any_will_do) {
            n -= 1;
            let (level, node, distance_mm) = stack[n];
            if distance_mm >= best.distance_mm {
                continue;
            }
            if level == 0 {
                let found = self.nearest_in(mesh, node, p);
                if found.distance_mm < best.distance_mm {
                    (best, is_found) = (found, true);
                }
                continue;
            }
            let below = &self.levels[level - 1];
            let mut children =
                [2 * node, 2 * node + 1].map(|c| (level - 1, c, below.get(c).map(|b| b.distance_mm(p))));
            // The nearer one is taken first: it is pushed last.
            if children[0].2 < children[1].2 {
                children.swap(0, 1);
            }
            for (level, child, distance_mm) in children {
                if let Some(distance_mm) = distance_mm {
                    stack[n] = (level, child, distance_mm);
                    n += 1;
                }
            }
        }
        is_found.then_some(best)
    }

    /// The nearest point of a leaf's triangles.
    fn nearest_in(&self, mesh: &TriMesh, leaf: usize, p: Point3) -> Nearest {
        let on = |place: usize| {
            let triangle = self.order[place];
            let at = nearest_on(&mesh.triangles[triangle as usize].map(|v| mesh.vertices[v as usize]), p);
            Nearest { distance_mm: (at - p).norm(), triangle, at }
        };
        let none = Nearest { distance_mm: f64::INFINITY, triangle: 0, at: p };
        self.leaf(leaf).map(on).fold(none, |a, b| if b.distance_mm < a.distance_mm { b } else { a })
    }
}

/// The point of a triangle nearest to p (Ericson, *Real-Time Collision Detection*, 2005, 5.1.5).
fn nearest_on([a, b, c]: &[Point3; 3], p: Point3) -> Point3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return *a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return *b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return *c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let whole = va + vb + vc;
    a + ab * (vb / whole) + ac * (vc / whole)
}

/// The place of a box's middle on the Morton curve through `whole`.
fn morton(b: &Box3, whole: &Box3) -> u32 {
    let cells = (1_u32 << MORTON_BITS) as f32;
    // One scale for all axes: cells are cubes, whatever the vessel's proportions.
    let longest = (0..3).map(|k| whole.high[k] - whole.low[k]).fold(f32::MIN_POSITIVE, f32::max);
    let digit = |k: usize| {
        let middle = 0.5 * (b.low[k] + b.high[k]) - whole.low[k];
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let cell = (middle / longest * cells).clamp(0.0, cells - 1.0) as u32;
        spread(cell) << k
    };
    digit(0) | digit(1) | digit(2)
}

/// Ten bits with two zeros between each and the next.
const fn spread(v: u32) -> u32 {
    let v = (v | v << 16) & 0x0300_00ff;
    let v = (v | v << 8) & 0x0300_f00f;
    let v = (v | v << 4) & 0x030c_30c3;
    (v | v << 2) & 0x0924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_point_is_that_of_all_triangles() {
        // A wavy sheet.
        let mut mesh = TriMesh::default();
        let n = 24_u32;
        for i in 0..n * n {
            let (x, y) = (f64::from(i % n), f64::from(i / n));
            mesh.push(Point3::new(x, y, (0.7 * x).sin() + (0.4 * y).cos())).unwrap();
        }
        for i in (0..n * (n - 1)).filter(|i| i % n + 1 < n) {
            mesh.triangles.extend([[i, i + 1, i + n], [i + 1, i + n + 1, i + n]]);
        }
        let bvh = Bvh::of(&mesh);
        for i in 0..200 {
            let part = |k: f64| (f64::from(i) * k).fract();
            let p = Point3::new(30.0 * part(0.618) - 3.0, 30.0 * part(0.414) - 3.0, 6.0 * part(0.732) - 3.0);
            let corners = |t: &[u32; 3]| t.map(|v| mesh.vertices[v as usize]);
            let all = mesh.triangles.iter().map(|t| (nearest_on(&corners(t), p) - p).norm());
            let expected = all.fold(f64::INFINITY, f64::min);
            let found = bvh.nearest(&mesh, p, f64::INFINITY).unwrap();
            assert!((found.distance_mm - expected).abs() < 1e-12, "{p}");
            assert!(
                (nearest_on(&corners(&mesh.triangles[found.triangle as usize]), p) - found.at).norm() < 1e-12
            );
            assert_eq!(bvh.nearest(&mesh, p, 0.9 * expected), None);
            assert!(bvh.is_within(&mesh, p, 1.1 * expected) && !bvh.is_within(&mesh, p, 0.9 * expected));
        }
    }
}
