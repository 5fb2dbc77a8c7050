//! Distance of points from contours, through a tree of boxes.
//!
//! Edges that follow each other on a contour lie near each other, so the tree is built over them in order, four a
//! leaf, without sorting: O(n). A query visits the nearer child first and leaves out boxes that lie farther than
//! the best edge so far: O(log n) but for points that are nearly equally far from everything. Inside or outside is
//! decided by the crossing rule over the boxes that a ray towards +x meets.

use super::{Contour, Point2};

/// The foot point of a query on the indexed contours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foot {
    /// The nearest point of the contours.
    pub point: Point2,
    /// Its distance, mm, unsigned.
    pub distance_mm: f64,
    /// Which contour it lies on.
    pub contour_idx: usize,
    /// Which edge of that contour.
    pub edge_idx: usize,
}

#[derive(Debug, Clone, Copy)]
struct Segment {
    a: Point2,
    b: Point2,
    contour_idx: u32,
    edge_idx: u32,
}

/// Where a straight way crosses the indexed contours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crossing {
    /// Share of the way that lies before it.
    pub along: f64,
    /// Which contour is crossed.
    pub contour_idx: usize,
    /// Which edge of that contour.
    pub edge_idx: usize,
}

/// A straight way and the box around it.
#[derive(Debug, Clone, Copy)]
struct Way {
    a: Point2,
    b: Point2,
    bounds: Box2,
}

impl Way {
    fn new(a: Point2, b: Point2) -> Self {
        let bounds = Box2 { min: a, max: a }.joined(Box2 { min: b, max: b });
        Self { a, b, bounds }
    }

    /// Whether it may cross something in a box; never for the empty one.
    fn may_meet(&self, other: &Box2) -> bool {
        if !self.bounds.meets(other) {
            return false;
        }
        // All of the box may lie on one side of the way; a hair more than the box, against rounding.
        let (along, half) = (self.b - self.a, (other.max - other.min) / 2.0);
        let aside = along.perp(&(nalgebra::center(&other.min, &other.max) - self.a)).abs();
        aside <= (along.x.abs() * half.y + along.y.abs() * half.x) * (1.0 + 1e-9) + 1e-9
    }

    /// Whether it crosses a segment. An end on the line of the other counts as lying on one of its sides, always the same.
    fn crosses(&self, s: &Segment) -> bool {
        let side = |u: Point2, v: Point2, w: Point2| (v - u).perp(&(w - u)) > 0.0;
        self.bounds.meets(&Box2 { min: s.a, max: s.a }.joined(Box2 { min: s.b, max: s.b }))
            && side(self.a, self.b, s.a) != side(self.a, self.b, s.b)
            && side(s.a, s.b, self.a) != side(s.a, s.b, self.b)
    }

    /// Where it crosses a segment that it does cross.
    fn crossing(&self, s: &Segment) -> Crossing {
        let edge = s.b - s.a;
        let (from, to) = (edge.perp(&(self.a - s.a)), edge.perp(&(self.b - s.a)));
        Crossing {
            along: (from / (from - to)).clamp(0.0, 1.0),
            contour_idx: s.contour_idx as usize,
            edge_idx: s.edge_idx as usize,
        }
    }
}

/// Edges in a leaf: few enough to test all, enough to keep the tree small.
const LEAF: usize = 4;

/// A box of the tree; empty where the minimum lies above the maximum.
#[derive(Debug, Clone, Copy)]
struct Box2 {
    min: Point2,
    max: Point2,
}

impl Box2 {
    const EMPTY: Self = Self {
        min: Point2::new(f64::INFINITY, f64::INFINITY),
        max: Point2::new(f64::NEG_INFINITY, f64::NEG_INFINITY),
    };

    fn joined(self, other: Self) -> Self {
        Self {
            min: self.min.coords.inf(&other.min.coords).into(),
            max: self.max.coords.sup(&other.max.coords).into(),
        }
    }

    fn meets(&self, other: &Self) -> bool {
        self.min.x <= other.max.x
            && self.max.x >= other.min.x
            && self.min.y <= other.max.y
            && self.max.y >= other.min.y
    }

    /// Squared distance of a point from the box; infinite for the empty one.
    #[inline]
    fn distance2(&self, p: Point2) -> f64 {
        let dx = (self.min.x - p.x).max(p.x - self.max.x).max(0.0);
        let dy = (self.min.y - p.y).max(p.y - self.max.y).max(0.0);
        dx * dx + dy * dy
    }
}

/// The edges of a set of contours, arranged for distance queries.
#[derive(Debug, Clone)]
pub struct SegmentIndex {
    segments: Vec<Segment>,
    /// A complete binary tree: node i has the children 2 i and 2 i + 1, the root is 1, the leaves come last.
    boxes: Vec<Box2>,
    n_leaves: usize,
}

impl SegmentIndex {
    /// Indexes all edges of the contours; `None` where there is no edge.
    #[must_use]
    pub fn try_new(contours: &[Contour]) -> Option<Self> {
        let number = |i: usize| u32::try_from(i).unwrap_or(u32::MAX);
        let segments: Vec<Segment> = contours
            .iter()
            .enumerate()
            .flat_map(|(c, contour)| {
                let segment = move |(e, (a, b)): (usize, (Point2, Point2))| Segment {
                    a,
                    b,
                    contour_idx: number(c),
                    edge_idx: number(e),
                };
                contour.edges().enumerate().map(segment)
            })
            .collect();
        Self::of(segments)
    }

    /// Indexes points: each is a contour of its own.
    #[must_use]
    pub fn of_points(points: impl Iterator<Item = Point2>) -> Option<Self> {
        let number = |i: usize| u32::try_from(i).unwrap_or(u32::MAX);
        let point = |(i, p)| Segment { a: p, b: p, contour_idx: number(i), edge_idx: 0 };
        Self::of(points.enumerate().map(point).collect())
    }

    fn of(segments: Vec<Segment>) -> Option<Self> {
        if segments.is_empty() {
            return None;
        }
        let n_leaves = segments.len().div_ceil(LEAF).next_power_of_two();
        let mut boxes = vec![Box2::EMPTY; 2 * n_leaves];
        for (leaf, edges) in segments.chunks(LEAF).enumerate() {
            let ends = edges.iter().flat_map(|s| [s.a, s.b]);
            boxes[n_leaves + leaf] = ends.fold(Box2::EMPTY, |b, p| b.joined(Box2 { min: p, max: p }));
        }
        for node in (1..n_leaves).rev() {
            boxes[node] = boxes[2 * node].joined(boxes[2 * node + 1]);
        }
        Some(Self { segments, boxes, n_leaves })
    }

    fn leaf(&self, node: usize) -> &[Segment] {
        let first = (node - self.n_leaves) * LEAF;
        &self.segments[first.min(self.segments.len())..(first + LEAF).min(self.segments.len())]
    }

    /// The nearest point of the contours.
    #[must_use]
    pub fn nearest(&self, p: Point2) -> Foot {
        let first = self.segments[0];
        self.nearest_within(p, f64::INFINITY).unwrap_or(Foot {
            point: first.a,
            distance_mm: f64::INFINITY,
            contour_idx: first.contour_idx as usize,
            edge_idx: first.edge_idx as usize,
        })
    }

    /// The nearest point of the contours if it is nearer than `most_mm`: the nearer, the cheaper.
    #[must_use]
    pub fn nearest_within(&self, p: Point2, most_mm: f64) -> Option<Foot> {
        let mut best2 = most_mm * most_mm;
        let mut found = None;
        // The farther siblings of the nodes on the way down, where they matter: one a level of the tree of 2^32 edges at most.
        let mut put_off = [(0usize, 0.0f64); 32];
        let mut n_put_off = 0;
        let (mut node, mut distance2) = (1, self.boxes[1].distance2(p));
        loop {
            while node < self.n_leaves && distance2 < best2 {
                let (one, other) = (2 * node, 2 * node + 1);
                let (to_one2, to_other2) = (self.boxes[one].distance2(p), self.boxes[other].distance2(p));
                let (nearer, farther) = if to_one2 <= to_other2 {
                    ((one, to_one2), (other, to_other2))
                } else {
                    ((other, to_other2), (one, to_one2))
                };
                if farther.1 < best2 {
                    put_off[n_put_off] = farther;
                    n_put_off += 1;
                }
                (node, distance2) = nearer;
            }
            if distance2 < best2 {
                for s in self.leaf(node) {
                    let foot = nearest_on_segment(p, s.a, s.b);
                    let d2 = (foot - p).norm_squared();
                    if d2 < best2 {
                        best2 = d2;
                        found = Some((s, foot));
                    }
                }
            }
            let Some(next) = n_put_off.checked_sub(1) else { break };
            n_put_off = next;
            (node, distance2) = put_off[next];
        }
        found.map(|(segment, point)| Foot {
            point,
            distance_mm: best2.sqrt(),
            contour_idx: segment.contour_idx as usize,
            edge_idx: segment.edge_idx as usize,
        })
    }

    /// Whether the straight way from `a` to `b` crosses an edge.
    #[must_use]
    pub fn crosses(&self, a: Point2, b: Point2) -> bool {
        self.visit(1, &Way::new(a, b), &mut |_| true)
    }

    /// Where the straight way from `a` to `b` crosses edges, in its order.
    #[must_use]
    pub fn crossings(&self, a: Point2, b: Point2) -> Vec<Crossing> {
        let way = Way::new(a, b);
        let mut crossings = Vec::new();
        self.visit(1, &way, &mut |segment| {
            crossings.push(way.crossing(segment));
            false
        });
        crossings.sort_by(|a, b| a.along.total_cmp(&b.along));
        crossings
    }

    /// Visits the edges below a node that the way crosses until one is found to be enough; whether one was.
    fn visit(&self, node: usize, way: &Way, is_enough: &mut impl FnMut(&Segment) -> bool) -> bool {
        if !way.may_meet(&self.boxes[node]) {
            return false;
        }
        if node < self.n_leaves {
            return self.visit(2 * node, way, is_enough) || self.visit(2 * node + 1, way, is_enough);
        }
        self.leaf(node).iter().any(|s| way.crosses(s) && is_enough(s))
    }

    /// Distance to the nearest contour, mm: negative inside, positive outside (crossing rule over all contours).
    #[must_use]
    pub fn signed_distance_mm(&self, p: Point2) -> f64 {
        let distance = self.nearest(p).distance_mm;
        if self.contains(p) { -distance } else { distance }
    }

    /// Whether the point is enclosed by an odd number of contours.
    #[must_use]
    pub fn contains(&self, p: Point2) -> bool {
        self.ray_crossings(1, p) % 2 == 1
    }

    /// How many edges below a node a ray from the point towards +x crosses.
    fn ray_crossings(&self, node: usize, p: Point2) -> usize {
        let b = &self.boxes[node];
        if p.y < b.min.y || p.y > b.max.y || p.x > b.max.x {
            return 0;
        }
        if node < self.n_leaves {
            return self.ray_crossings(2 * node, p) + self.ray_crossings(2 * node + 1, p);
        }
        let crosses = |s: &&Segment| {
            (s.a.y > p.y) != (s.b.y > p.y) && p.x < (s.b.x - s.a.x) * (p.y - s.a.y) / (s.b.y - s.a.y) + s.a.x
        };
        self.leaf(node).iter().filter(crosses).count()
    }
}

/// The point of the segment `a`..`b` nearest to `p`.
#[inline]
#[must_use]
pub fn nearest_on_segment(p: Point2, a: Point2, b: Point2) -> Point2 {
    let along = b - a;
    let length2 = along.norm_squared();
    if length2 <= 0.0 {
        return a;
    }
    a + along * ((p - a).dot(&along) / length2).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn brute_force(contours: &[Contour], p: Point2) -> f64 {
        let edges = contours.iter().flat_map(Contour::edges);
        let nearest =
            edges.map(|(a, b)| (nearest_on_segment(p, a, b) - p).norm()).fold(f64::INFINITY, f64::min);
        let inside = contours.iter().filter(|c| c.contains(p)).count() % 2 == 1;
        if inside { -nearest } else { nearest }
    }

    proptest! {
        #[test]
        fn agrees_with_brute_force(x in -12.0..12.0f64, y in -12.0..12.0f64, n in 3usize..80, r in 0.5..4.0f64) {
            let contours = [
                Contour::circle(Point2::new(0.3, 0.1), r, n),
                Contour::circle(Point2::new(5.5, -1.0), 1.2, 7),
            ];
            let index = SegmentIndex::try_new(&contours).unwrap();
            let p = Point2::new(x, y);
            prop_assert!((index.signed_distance_mm(p) - brute_force(&contours, p)).abs() < 1e-9);
            let nearest = index.nearest(p);
            prop_assert_eq!(index.nearest_within(p, nearest.distance_mm + 1e-9), Some(nearest));
            prop_assert_eq!(index.nearest_within(p, nearest.distance_mm - 1e-9), None);
        }

        #[test]
        fn crossings_change_from_inside_to_outside(
            x in -12.0..12.0f64, y in -12.0..12.0f64, to_x in -12.0..12.0f64, to_y in -12.0..12.0f64, n in 3usize..80
        ) {
            let contours = [
                Contour::circle(Point2::new(0.3, 0.1), 4.0, n),
                Contour::circle(Point2::new(5.5, -1.0), 1.1, 7),
            ];
            let index = SegmentIndex::try_new(&contours).unwrap();
            let (a, b) = (Point2::new(x, y), Point2::new(to_x, to_y));
            let crossings = index.crossings(a, b);
            prop_assert_eq!(index.crosses(a, b), !crossings.is_empty());
            let ends = [0.0].into_iter().chain(crossings.iter().map(|c| c.along)).chain([1.0]);
            let mut inside = index.contains(a);
            for pair in ends.collect::<Vec<_>>().windows(2) {
                prop_assert!(pair[0] <= pair[1]);
                // A stretch as short as rounding says nothing.
                let middle = a + (b - a) * (0.5 * (pair[0] + pair[1]));
                prop_assert!(pair[1] - pair[0] < 1e-9 || index.contains(middle) == inside);
                inside = !inside;
            }
            for c in &crossings {
                let (p, q) = contours[c.contour_idx].edges().nth(c.edge_idx).unwrap();
                let at = a + (b - a) * c.along;
                prop_assert!((nearest_on_segment(at, p, q) - at).norm() < 1e-9);
            }
        }
    }
}
