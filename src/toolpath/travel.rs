//! Ways for the nozzle inside the material (combing).
//!
//! The net has a node under every sample of the skins, linked along each skin and across each wall to the
//! far side of the ball that touches both; all these links stay in the material. A travel takes the
//! straight way where that stays inside, else the shortest way through the net (Dijkstra), pulled taut.
//! Between islands it leaves and enters where they are nearest.
//!
//! The way is the shortest through the net, not of all; a way from island to island may cross a third one.

use super::skin::{Contact, Skins};
use crate::geom::{Contour, Point2};
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Deepest a node lies under its skin, mm.
const NODE_DEPTH_MM: f64 = 0.4;

/// A way without extrusion.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Travel {
    /// The bends between its two ends.
    pub via: Vec<Point2>,
    /// Whether it leaves the material, so that the nozzle should be retracted.
    pub leaves_material: bool,
}

#[derive(Debug, Clone)]
struct Node {
    at: Point2,
    island: usize,
    links: [Option<usize>; 3],
    on_hole: bool,
}

/// Where a nozzle may travel in one layer.
#[derive(Debug)]
pub(super) struct Net {
    nodes: Vec<Node>,
    contours: Vec<Contour>,
}

/// A distance for the priority queue. Distances are finite, so the order is total.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Distance(f64);

impl Eq for Distance {}

impl Ord for Distance {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}

impl PartialOrd for Distance {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Net {
    pub(super) fn new(skins: &Skins) -> Self {
        let islands = island_of(&skins.contours);
        let mut nodes: Vec<Node> = Vec::new();
        let firsts: Vec<usize> = skins
            .skins
            .iter()
            .scan(0, |first, s| Some(std::mem::replace(first, *first + s.samples.len())))
            .collect();
        for (c, skin) in skins.skins.iter().enumerate() {
            let (first, n) = (firsts[c], skin.samples.len());
            for (i, s) in skin.samples.iter().enumerate() {
                let across = match s.contact {
                    Contact::Wall { contour_idx, edge_idx, at } => {
                        nearest_sample(&skins.skins[contour_idx].samples, edge_idx, at)
                            .map(|k| firsts[contour_idx] + k)
                    }
                    _ => None,
                };
                nodes.push(Node {
                    at: s.at + s.inward * (0.6 * s.depth_mm).min(NODE_DEPTH_MM),
                    island: islands[c],
                    links: [Some(first + (i + 1) % n), Some(first + (i + n - 1) % n), across],
                    on_hole: skin.is_hole,
                });
            }
        }
        Self { nodes, contours: skins.contours.clone() }
    }

    /// The island whose net is nearest to a point.
    pub(super) fn island_near(&self, p: Point2) -> usize {
        self.nearest(p, |_| true).map_or(0, |n| self.nodes[n].island)
    }

    fn nearest(&self, p: Point2, wanted: impl Fn(&Node) -> bool) -> Option<usize> {
        let candidates = (0..self.nodes.len()).filter(|&i| wanted(&self.nodes[i]));
        candidates.min_by(|&a, &b| {
            let d = |i: usize| (self.nodes[i].at - p).norm_squared();
            d(a).total_cmp(&d(b))
        })
    }

    /// The way from `a` to `b`.
    pub(super) fn travel(&self, a: Point2, b: Point2) -> Travel {
        if self.sees(a, b) {
            return Travel::default();
        }
        let (Some(from), Some(to)) = (self.nearest(a, |_| true), self.nearest(b, |_| true)) else {
            return Travel { via: Vec::new(), leaves_material: true };
        };
        let (start, end) = (self.nodes[from].island, self.nodes[to].island);
        let mut way = vec![a];
        if start == end {
            way.extend(self.shortest(from, to).into_iter().map(|n| self.nodes[n].at));
        } else {
            let (exit, entry) = self.gap(start, end);
            for (from, to) in [(from, exit), (entry, to)] {
                way.extend(self.shortest(from, to).into_iter().map(|n| self.nodes[n].at));
            }
        }
        way.push(b);
        let way = self.taut(&way);
        let leaves_material = way.windows(2).any(|p| !self.sees(p[0], p[1]));
        Travel { via: way[1..way.len() - 1].to_vec(), leaves_material }
    }

    /// The nearest pair of nodes on the outer skins of two islands.
    fn gap(&self, start: usize, end: usize) -> (usize, usize) {
        let on = |island: usize| -> Vec<(usize, Point2)> {
            let all = self.nodes.iter().enumerate();
            all.filter(|(_, n)| n.island == island && !n.on_hole).map(|(i, n)| (i, n.at)).collect()
        };
        let there = on(end);
        let mut best = (0, 0, f64::INFINITY);
        for (i, from) in on(start) {
            for &(k, to) in &there {
                let d2 = (from - to).norm_squared();
                if d2 < best.2 {
                    best = (i, k, d2);
                }
            }
        }
        (best.0, best.1)
    }

    /// Dijkstra's shortest way through the net, both ends included; only the ends where there is none.
    fn shortest(&self, from: usize, to: usize) -> Vec<usize> {
        let mut distance = vec![f64::INFINITY; self.nodes.len()];
        let mut before = vec![usize::MAX; self.nodes.len()];
        let mut open = BinaryHeap::from([Reverse((Distance(0.0), from))]);
        distance[from] = 0.0;
        while let Some(Reverse((Distance(d), node))) = open.pop() {
            if node == to {
                break;
            }
            if d > distance[node] {
                continue;
            }
            for next in self.nodes[node].links.into_iter().flatten() {
                let longer = d + (self.nodes[next].at - self.nodes[node].at).norm();
                if longer < distance[next] {
                    (distance[next], before[next]) = (longer, node);
                    open.push(Reverse((Distance(longer), next)));
                }
            }
        }
        if distance[to].is_infinite() {
            return vec![from, to];
        }
        let mut way = vec![to];
        while let Some(&last) = way.last()
            && last != from
        {
            way.push(before[last]);
        }
        way.reverse();
        way
    }

    /// The way with every bend left out that the material does not ask for (found by doubling, then
    /// bisection).
    fn taut(&self, way: &[Point2]) -> Vec<Point2> {
        let mut taut = vec![way[0]];
        let mut i = 0;
        while i + 1 < way.len() {
            let sees = |k: usize| k == i + 1 || self.sees(way[i], way[k]);
            let last = way.len() - 1;
            let (mut seen, mut step) = (i + 1, 2);
            let mut hidden = last + 1;
            while seen < last {
                let k = (i + step).min(last);
                if !sees(k) {
                    hidden = k;
                    break;
                }
                (seen, step) = (k, 2 * step);
            }
            while hidden - seen > 1 && hidden <= last {
                let middle = usize::midpoint(seen, hidden);
                if sees(middle) { seen = middle } else { hidden = middle }
            }
            taut.push(way[seen]);
            i = seen;
        }
        taut
    }

    /// Whether the straight way from `a` to `b` crosses no outline. Both lie in the material.
    fn sees(&self, a: Point2, b: Point2) -> bool {
        let (low, high) = (a.coords.inf(&b.coords), a.coords.sup(&b.coords));
        let apart = |p: Point2, q: Point2| {
            p.x.max(q.x) < low.x || p.x.min(q.x) > high.x || p.y.max(q.y) < low.y || p.y.min(q.y) > high.y
        };
        !self.contours.iter().flat_map(Contour::edges).any(|(p, q)| !apart(p, q) && cross(a, b, p, q))
    }
}

/// Whether two segments cross.
fn cross(a: Point2, b: Point2, p: Point2, q: Point2) -> bool {
    let side = |u: Point2, v: Point2, w: Point2| (v - u).perp(&(w - u));
    (side(a, b, p) > 0.0) != (side(a, b, q) > 0.0) && (side(p, q, a) > 0.0) != (side(p, q, b) > 0.0)
}

/// The sample nearest to a place on an edge. Samples ascend in their edges.
fn nearest_sample(samples: &[super::skin::Sample], edge_idx: usize, at: Point2) -> Option<usize> {
    let after = samples.partition_point(|s| s.edge_idx <= edge_idx);
    let first = samples.partition_point(|s| s.edge_idx < edge_idx).saturating_sub(1);
    let nearby = (first..=after).map(|i| i % samples.len().max(1));
    nearby.filter(|&i| i < samples.len()).min_by(|&a, &b| {
        let d = |i: usize| (samples[i].at - at).norm_squared();
        d(a).total_cmp(&d(b))
    })
}

/// Per contour the index of the smallest outer contour around it.
fn island_of(contours: &[Contour]) -> Vec<usize> {
    let area: Vec<f64> = contours.iter().map(Contour::signed_area_mm2).collect();
    let owner = |c: usize| {
        let outers =
            (0..contours.len()).filter(|&o| area[o] > 0.0 && contours[o].contains(contours[c].points[0]));
        outers.min_by(|&a, &b| area[a].total_cmp(&area[b])).unwrap_or(c)
    };
    (0..contours.len()).map(|c| if area[c] > 0.0 { c } else { owner(c) }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Region;

    /// Length of `a`..`b` that lies in a region, mm.
    fn length_inside(region: &Region, a: Point2, b: Point2) -> f64 {
        const N: u32 = 400;
        let at = |i: u32| a + (b - a) * ((f64::from(i) + 0.5) / f64::from(N));
        let inside = (0..N).filter(|&i| region.contains(at(i))).count();
        (b - a).norm() * inside as f64 / f64::from(N)
    }

    fn net(region: &Region) -> Net {
        Net::new(&Skins::try_new(region, 1.5, 1e-4).unwrap())
    }

    fn ring(x: f64) -> Region {
        let centre = Point2::new(x, 0.0);
        Region::new(vec![Contour::circle(centre, 4.0, 120), Contour::circle(centre, 3.0, 100).reversed()])
    }

    #[test]
    fn travel_goes_around_the_lumen() {
        let ring = ring(0.0);
        let (a, b) = (Point2::new(3.6, 0.3), Point2::new(-3.3, 0.2));
        let travel = net(&ring).travel(a, b);
        assert!(!travel.leaves_material);
        let way: Vec<Point2> = [a].into_iter().chain(travel.via).chain([b]).collect();
        assert!(way.len() > 3);
        let outside: f64 =
            way.windows(2).map(|p| (p[1] - p[0]).norm() - length_inside(&ring, p[0], p[1])).sum();
        assert!(outside < 1e-9, "{outside} mm outside");
        let length: f64 = way.windows(2).map(|p| (p[1] - p[0]).norm()).sum();
        assert!(length < 11.5, "{length} mm for half a turn");
    }

    #[test]
    fn travel_within_sight_is_straight() {
        let travel = net(&ring(0.0)).travel(Point2::new(3.2, 0.0), Point2::new(3.8, 0.4));
        assert_eq!(travel, Travel::default());
    }

    #[test]
    fn travel_between_islands_crosses_no_lumen() {
        let two = Region::new([ring(0.0).contours, ring(9.0).contours].concat());
        let (a, b) = (Point2::new(-3.5, 0.0), Point2::new(12.5, 0.0));
        let travel = net(&two).travel(a, b);
        assert!(travel.leaves_material);
        let way: Vec<Point2> = [a].into_iter().chain(travel.via).chain([b]).collect();
        let lumens = Region::new(vec![
            Contour::circle(Point2::origin(), 3.0, 100),
            Contour::circle(Point2::new(9.0, 0.0), 3.0, 100),
        ]);
        let inside: f64 = way.windows(2).map(|p| length_inside(&lumens, p[0], p[1])).sum();
        assert!(inside < 1e-9, "{inside} mm across a lumen");
    }
}
