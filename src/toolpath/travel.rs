//! Ways for the nozzle inside the material (combing).
//!
//! The net has a node under every sample of the skins, linked along each skin and across each wall to the
//! far side of the ball that touches both; a hole with no wall near it is linked with what lies beside it. A travel takes
//! the straight way where that stays inside, else the shorter of two, pulled taut: the shortest way through the net
//! (Dijkstra), and the straight one that walks along each outline across which it would leave and enter again.
//! Between islands it leaves and enters where they are nearest, and walks along the skin of any island between.
//!
//! Neither is the shortest way of all; none crosses a hole within an island, or the hole of an island between.
//! Cost: O(log n) for what lies in sight, else O(n log n) of the nodes of the islands at both ends.

use super::skin::{Contact, Skins};
use crate::geom::{Bounds2, Contour, Point2, SegmentIndex, Vector2};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};
use std::ops::Range;

/// Deepest a node lies under its skin, mm.
const NODE_DEPTH_MM: f64 = 0.4;
/// So far before an outline a straight way turns to walk along it, mm.
const BEFORE_MM: f64 = 0.01;

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
    /// The edge of its contour that begins at or before it.
    edge_idx: usize,
    links: [Option<usize>; 3],
}

/// An outer contour with the holes in it.
#[derive(Debug)]
pub(super) struct Island {
    /// Indices of its contours, the outer one first.
    pub(super) contours: Vec<usize>,
    nodes: Range<usize>,
}

/// Where a nozzle may travel in one layer.
#[derive(Debug)]
pub(super) struct Net {
    /// By islands.
    nodes: Vec<Node>,
    /// The nodes of each contour, in its order.
    loops: Vec<Range<usize>>,
    islands: Vec<Island>,
    /// Links between skins that no wall joins.
    bridges: BTreeMap<usize, Vec<usize>>,
    outlines: SegmentIndex,
    /// Of the nodes; none where there is no node.
    places: Option<SegmentIndex>,
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
        let mut net = Self {
            nodes: Vec::new(),
            loops: vec![0..0; skins.contours.len()],
            islands: Vec::new(),
            bridges: BTreeMap::new(),
            outlines: skins.index.clone(),
            places: None,
        };
        for contours in islands(&skins.contours) {
            net.add_island(contours, skins);
        }
        net.link_across(skins);
        net.places = SegmentIndex::of_points(net.nodes.iter().map(|n| n.at));
        net.bridge_holes();
        net
    }

    /// Adds the nodes of an island, linked along its skins.
    fn add_island(&mut self, contours: Vec<usize>, skins: &Skins) {
        let begin = self.nodes.len();
        for &c in &contours {
            let samples = &skins.skins[c].samples;
            let (first, n) = (self.nodes.len(), samples.len());
            self.loops[c] = first..first + n;
            self.nodes.extend(samples.iter().enumerate().map(|(i, s)| Node {
                at: s.at + s.inward * (0.6 * s.depth_mm).min(NODE_DEPTH_MM),
                island: self.islands.len(),
                edge_idx: s.edge_idx,
                links: [Some(first + (i + 1) % n), Some(first + (i + n - 1) % n), None],
            }));
        }
        self.islands.push(Island { contours, nodes: begin..self.nodes.len() });
    }

    /// Links the nodes on both sides of each wall.
    fn link_across(&mut self, skins: &Skins) {
        for (skin, nodes) in skins.skins.iter().zip(self.loops.clone()) {
            for (node, sample) in nodes.zip(&skin.samples) {
                if let Contact::Wall { contour_idx, edge_idx, at } = sample.contact {
                    self.nodes[node].links[2] = self.node_at(contour_idx, edge_idx, at);
                }
            }
        }
    }

    /// Links every hole with what lies to the right, left, above and below of it. To the right of its rightmost place lies
    /// another outline of its island that reaches farther right: so from every hole a way leads to the outer skin.
    fn bridge_holes(&mut self) {
        let holes = self.islands.iter().flat_map(|i| i.contours.iter().skip(1));
        let towards = [Vector2::x(), -Vector2::x(), Vector2::y(), -Vector2::y()];
        let all = holes.flat_map(|&hole| towards.map(|along| (hole, along)));
        let bridges: Vec<_> = all.filter_map(|(hole, along)| self.bridge(hole, along)).collect();
        for (from, to) in bridges {
            self.bridges.entry(from).or_default().push(to);
            self.bridges.entry(to).or_default().push(from);
        }
    }

    fn bridge(&self, hole: usize, along: Vector2) -> Option<(usize, usize)> {
        let reach = |node: usize| self.nodes[node].at.coords.dot(&along);
        let from = self.loops[hole].clone().max_by(|&a, &b| reach(a).total_cmp(&reach(b)))?;
        let island = self.nodes[from].island;
        let outer = self.loops[self.islands[island].contours[0]].clone();
        // A little beyond the outer skin's nodes, which lie within it.
        let beyond = outer.map(reach).fold(reach(from), f64::max) + 2.0 * NODE_DEPTH_MM - reach(from);
        let (at, end) = (self.nodes[from].at, self.nodes[from].at + along * beyond);
        let hit = *self.outlines.crossings(at, end).first()?;
        let to = self.node_at(hit.contour_idx, hit.edge_idx, at + (end - at) * hit.along)?;
        self.sees(at, self.nodes[to].at).then_some((from, to))
    }

    pub(super) fn islands(&self) -> &[Island] {
        &self.islands
    }

    /// Some places in the material of an island, off its skins.
    pub(super) fn places_in(&self, island: &Island) -> impl Iterator<Item = Point2> {
        self.nodes[island.nodes.clone()].iter().map(|n| n.at)
    }

    /// The island whose net is nearest to a point.
    pub(super) fn island_near(&self, p: Point2) -> usize {
        self.nearest(p).map_or(0, |n| self.nodes[n].island)
    }

    fn nearest(&self, p: Point2) -> Option<usize> {
        Some(self.places.as_ref()?.nearest(p).contour_idx)
    }

    /// The node nearest to a place on an edge. Nodes ascend in their edges.
    fn node_at(&self, contour_idx: usize, edge_idx: usize, at: Point2) -> Option<usize> {
        let all = self.loops[contour_idx].clone();
        let nodes = &self.nodes[all.clone()];
        let after = nodes.partition_point(|n| n.edge_idx <= edge_idx);
        let first = nodes.partition_point(|n| n.edge_idx < edge_idx).saturating_sub(1);
        let nearby = (first..=after).map(|i| i % nodes.len().max(1)).filter(|&i| i < nodes.len());
        let distance2 = |i: usize| (nodes[i].at - at).norm_squared();
        nearby.min_by(|&a, &b| distance2(a).total_cmp(&distance2(b))).map(|i| all.start + i)
    }

    /// The node at which a way from or to a point joins the net: the nearest, or, where that is hidden, the one under the nearest
    /// skin.
    fn joint(&self, p: Point2) -> Option<usize> {
        let nearest = self.nearest(p)?;
        if self.sees(p, self.nodes[nearest].at) {
            return Some(nearest);
        }
        let foot = self.outlines.nearest(p);
        let under = self.node_at(foot.contour_idx, foot.edge_idx, foot.point);
        under.filter(|&n| self.sees(p, self.nodes[n].at)).or(Some(nearest))
    }

    /// The way from `a` to `b`.
    pub(super) fn travel(&self, a: Point2, b: Point2) -> Travel {
        if self.sees(a, b) {
            return Travel::default();
        }
        let (Some(from), Some(to)) = (self.joint(a), self.joint(b)) else {
            return Travel { via: Vec::new(), leaves_material: true };
        };
        let (start, end) = (self.nodes[from].island, self.nodes[to].island);
        let way = if start == end {
            self.within([a, b], [from, to])
        } else {
            let (exit, entry) = self.gap(start, end);
            let (leaves, enters) = (self.nodes[exit].at, self.nodes[entry].at);
            let mut way = self.within([a, leaves], [from, exit]);
            way.extend(self.walked(leaves, enters));
            way.extend(self.within([enters, b], [entry, to]));
            way
        };
        let way = self.taut(&way);
        let leaves_material = way.windows(2).any(|p| !self.sees(p[0], p[1]));
        Travel { via: way[1..way.len() - 1].to_vec(), leaves_material }
    }

    /// A way between two places of an island, given the nodes at which it may join the net; both ends included.
    fn within(&self, [a, b]: [Point2; 2], [from, to]: [usize; 2]) -> Vec<Point2> {
        let with_ends = |bends: Vec<Point2>| [vec![a], bends, vec![b]].concat();
        let walked = with_ends(self.walked(a, b));
        let Some(nodes) = self.shortest(from, to) else { return walked };
        let through = with_ends(nodes.into_iter().map(|n| self.nodes[n].at).collect());
        let cost = |way: &[Point2]| {
            let taut = self.taut(way);
            let pairs = || taut.windows(2);
            let n_crossings: usize = pairs().map(|p| self.outlines.crossings(p[0], p[1]).len()).sum();
            (n_crossings, pairs().map(|p| (p[1] - p[0]).norm()).sum::<f64>())
        };
        if cost(&walked) < cost(&through) { walked } else { through }
    }

    /// The bends of the straight way that walks along each outline which it crosses more than once, from the first crossing
    /// to the last.
    fn walked(&self, a: Point2, b: Point2) -> Vec<Point2> {
        let crossings = self.outlines.crossings(a, b);
        let before = BEFORE_MM / (b - a).norm().max(BEFORE_MM);
        let at = |along: f64| a + (b - a) * along;
        let mut bends = Vec::new();
        let mut i = 0;
        while let Some(first) = crossings.get(i) {
            let last = crossings.iter().rposition(|c| c.contour_idx == first.contour_idx).unwrap_or(i);
            if last > i {
                let node = |k: usize| {
                    let c = crossings[k];
                    self.node_at(c.contour_idx, c.edge_idx, at(c.along))
                };
                bends.push(at((first.along - before).max(0.0)));
                if let (Some(from), Some(to)) = (node(i), node(last)) {
                    bends.extend(self.along(first.contour_idx, from, to).map(|n| self.nodes[n].at));
                }
                bends.push(at((crossings[last].along + before).min(1.0)));
            }
            i = last + 1;
        }
        bends
    }

    /// The nodes of a contour from one to another, the shorter way.
    fn along(&self, contour_idx: usize, from: usize, to: usize) -> impl Iterator<Item = usize> {
        let nodes = self.loops[contour_idx].clone();
        let (first, n) = (nodes.start, nodes.len());
        let node = move |i: usize| first + i % n;
        let step_mm = |i: usize| (self.nodes[node(i + 1)].at - self.nodes[node(i)].at).norm();
        let (from, to) = (from - first, to - first);
        let n_forward = (to + n - from) % n;
        let forward_mm: f64 = (from..from + n_forward).map(step_mm).sum();
        let all_mm: f64 = (0..n).map(step_mm).sum();
        let is_forward = 2.0 * forward_mm <= all_mm;
        let n_steps = if is_forward { n_forward } else { n - n_forward };
        (0..=n_steps).map(move |k| if is_forward { node(from + k) } else { node(from + n - k) })
    }

    /// The nearest pair of nodes on the outer skins of two islands.
    fn gap(&self, start: usize, end: usize) -> (usize, usize) {
        let outer = |island: usize| self.loops[self.islands[island].contours[0]].clone();
        let (here, there) = (outer(start), outer(end));
        let index = SegmentIndex::of_points(self.nodes[there.clone()].iter().map(|n| n.at));
        let pairs = index.iter().flat_map(|index| {
            here.clone().map(|i| {
                let nearest = index.nearest(self.nodes[i].at);
                (i, there.start + nearest.contour_idx, nearest.distance_mm)
            })
        });
        let nearest = pairs.min_by(|a, b| a.2.total_cmp(&b.2));
        nearest.map_or((here.start, there.start), |(exit, entry, _)| (exit, entry))
    }

    /// Dijkstra's shortest way through the net of an island, both ends included; `None` where there is none.
    fn shortest(&self, from: usize, to: usize) -> Option<Vec<usize>> {
        let Range { start: first, end } = self.islands[self.nodes[from].island].nodes;
        let mut distance = vec![f64::INFINITY; end - first];
        let mut before = vec![usize::MAX; end - first];
        let mut open = BinaryHeap::from([Reverse((Distance(0.0), from))]);
        distance[from - first] = 0.0;
        while let Some(Reverse((Distance(d), node))) = open.pop() {
            if node == to {
                break;
            }
            if d > distance[node - first] {
                continue;
            }
            for next in self.linked(node).filter(|next| (first..end).contains(next)) {
                let longer = d + (self.nodes[next].at - self.nodes[node].at).norm();
                if longer < distance[next - first] {
                    (distance[next - first], before[next - first]) = (longer, node);
                    open.push(Reverse((Distance(longer), next)));
                }
            }
        }
        if !(first..end).contains(&to) || distance[to - first].is_infinite() {
            return None;
        }
        let mut way = vec![to];
        while let Some(&last) = way.last()
            && last != from
        {
            way.push(before[last - first]);
        }
        way.reverse();
        Some(way)
    }

    fn linked(&self, node: usize) -> impl Iterator<Item = usize> {
        let bridges = self.bridges.get(&node).into_iter().flatten().copied();
        self.nodes[node].links.into_iter().flatten().chain(bridges)
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
        !self.outlines.crosses(a, b)
    }
}

/// The contours by islands: each outer one with the holes of which it is the smallest contour around.
fn islands(contours: &[Contour]) -> Vec<Vec<usize>> {
    let outer = |(c, contour): (usize, &Contour)| {
        let area = contour.signed_area_mm2();
        Some((c, area, contour.bounds()?)).filter(|_| area > 0.0)
    };
    let outers: Vec<(usize, f64, Bounds2)> = contours.iter().enumerate().filter_map(outer).collect();
    let mut islands: BTreeMap<usize, Vec<usize>> = outers.iter().map(|o| (o.0, vec![o.0])).collect();
    for (c, contour) in contours.iter().enumerate() {
        if islands.contains_key(&c) {
            continue;
        }
        let Some(&at) = contour.points.first() else { continue };
        let around = outers.iter().filter(|(o, _, bounds)| bounds.contains(at) && contours[*o].contains(at));
        // A hole outside of everything is an island by itself.
        let owner = around.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(c, |o| o.0);
        islands.entry(owner).or_default().push(c);
    }
    islands.into_values().collect()
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

    fn way(net: &Net, a: Point2, b: Point2) -> Vec<Point2> {
        [a].into_iter().chain(net.travel(a, b).via).chain([b]).collect()
    }

    /// A way between all pairs of places on a grid that lie in the material, and off its skins.
    fn pairs(region: &Region, step_mm: f64) -> Vec<(Point2, Point2)> {
        let bounds = region.bounds().unwrap();
        let index = SegmentIndex::try_new(&region.contours).unwrap();
        let on = |from: f64, to: f64| {
            (0..).map(move |i| from + step_mm * f64::from(i)).take_while(move |&c| c < to)
        };
        let all = on(bounds.min.y, bounds.max.y)
            .flat_map(|y| on(bounds.min.x, bounds.max.x).map(move |x| Point2::new(x, y)));
        let places: Vec<Point2> = all.filter(|&p| index.signed_distance_mm(p) < -0.2).collect();
        let pair = |i: usize| (0..i).map(move |k| (i, k));
        (0..places.len()).flat_map(pair).map(|(i, k)| (places[i], places[k])).collect()
    }

    #[test]
    fn no_travel_within_thick_material_crosses_a_hole() {
        let hole = |x: f64, y: f64, radius: f64| Contour::circle(Point2::new(x, y), radius, 90).reversed();
        let corners = [(0., 0.), (40., 0.), (40., 40.), (0., 40.)].map(|(x, y)| Point2::new(x, y));
        let block = Region::new(vec![
            Contour::new(corners.to_vec()),
            hole(10.0, 12.0, 3.0),
            hole(28.0, 12.0, 4.0),
            hole(20.0, 29.0, 5.0),
        ]);
        let thick = Region::new(vec![
            Contour::circle(Point2::origin(), 8.0, 160),
            Contour::circle(Point2::origin(), 3.0, 100).reversed(),
        ]);
        for region in [block, thick] {
            let net = net(&region);
            let pairs = pairs(&region, region.bounds().unwrap().size().x / 9.3);
            assert!(pairs.len() > 800);
            for (a, b) in pairs {
                assert!(!net.travel(a, b).leaves_material, "from {a} to {b}");
                let way = way(&net, a, b);
                assert!(way.windows(2).all(|p| net.sees(p[0], p[1])), "from {a} to {b}: {way:?}");
                let length: f64 = way.windows(2).map(|p| (p[1] - p[0]).norm()).sum();
                // Half a turn instead of the diameter.
                let longest = std::f64::consts::FRAC_PI_2 * (b - a).norm() + 1.0;
                assert!(length < longest, "from {a} to {b}: {length} mm");
            }
        }
    }

    #[test]
    fn no_travel_between_islands_crosses_the_lumen_of_a_third() {
        let tube = |x: f64, y: f64| {
            let circle = |radius: f64, n: usize| Contour::circle(Point2::new(x, y), radius, n);
            [circle(3.0, 90), circle(2.0, 70).reversed()]
        };
        let row = [9.0, 0.0, 18.0].map(|x| tube(x, 0.3));
        let plate = (0..12).map(|i| tube(8.0 * f64::from(i % 4), 8.0 * f64::from(i / 4)));
        for tubes in [row.to_vec(), plate.collect()] {
            let region = Region::new(tubes.concat());
            let net = net(&region);
            let lumens: Vec<Contour> = region.contours.iter().filter(|c| !c.is_ccw()).cloned().collect();
            let lumens = SegmentIndex::try_new(&lumens).unwrap();
            let pairs = pairs(&region, 0.9);
            assert!(pairs.len() > 300);
            for (a, b) in pairs {
                let way = way(&net, a, b);
                let crosses = way.windows(2).any(|p| lumens.crosses(p[0], p[1]));
                assert!(!crosses, "from {a} to {b}: {way:?}");
            }
        }
    }

    #[test]
    fn a_way_past_an_island_in_a_hole_keeps_to_its_own() {
        let inner = Region::new(vec![
            Contour::circle(Point2::new(1.0, 0.0), 3.0, 90),
            Contour::circle(Point2::new(1.0, 0.0), 2.0, 70).reversed(),
        ]);
        let outer = Region::new(vec![
            Contour::circle(Point2::origin(), 10.0, 200),
            Contour::circle(Point2::origin(), 8.0, 180).reversed(),
        ]);
        let both = Region::new([inner.contours, outer.contours].concat());
        let net = net(&both);
        assert_eq!(net.islands().len(), 2);
        let travel = net.travel(Point2::new(9.0, 0.5), Point2::new(-9.0, 0.5));
        assert!(!travel.leaves_material, "{travel:?}");
    }
}
