//! Whether a grown region has left the vessel, and where.
//!
//! The region is a graph of lobes in parts (`graph`). From the parts that hold a seed, neighbouring parts
//! are judged one by one, through the widest passage first. A passage leads out of the vessel where behind it lies
//!
//! - something much larger than the vessel: the heart, bone, the background;
//! - something clearly beyond the lumen's level: a vein full of undiluted contrast medium, bone, metal;
//! - something that passes by: it goes on to both sides of a narrow passage, as the vessel does on this side. A
//!   branch begins at its passage, a stenosis lies between two ends; only a neighbour passes by;
//! - so much that the vessel's sections would add up to several times what they are, over a length that no bend
//!   explains: spongy bone, a web of small vessels;
//!
//! or where a section of the vessel, or a side branch much thinner than it, reaches the border of the image. All measures are relative to the vessel's own
//! size and contrast. What a vessel may do passes: branches of any number and size below its own, bulbs and
//! aneurysms that widen over some planes, throats, loops, sections of any length where it runs within a plane.

use super::graph::{Graph, JUMP, Link, Part};
use super::grow::{Grown, Slab, Voxel};
use super::lobes;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};
use std::fmt;

/// Beyond the lumen's level by this part of its contrast: something else.
const BRIGHTER: f64 = 0.5;
/// What is thinner than this part of the vessel's area is no neighbour of it but a branch or a bit of noise.
const NEIGHBOUR: f64 = 0.3;
/// The sections' sum over that of the vessel at the seeds.
const BULK: f64 = 6.0;
/// A neighbour goes on for this many of its diameters to both sides.
const PASSES_DIAMETERS: f64 = 1.0;

/// What a region ran into.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Beyond {
    /// The border of the image.
    Border,
    /// Something whose section is so many times that of the vessel.
    Larger(f64),
    /// Something of another level, HU.
    Brighter(f64),
    /// A neighbour that passes by.
    Neighbour,
    /// Much that is no vessel.
    Bulk,
}

impl fmt::Display for Beyond {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Border => f.write_str("the image border"),
            Self::Larger(times) => write!(f, "something with {times:.0} times the vessel's section"),
            Self::Brighter(hu) => write!(f, "something of another level ({hu:.0} HU)"),
            Self::Neighbour => f.write_str("a neighbour that passes by"),
            Self::Bulk => f.write_str("a mass of small structures"),
        }
    }
}

/// A place where a region leaves the vessel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Site {
    /// The voxel in the passage.
    pub(super) at: Voxel,
    /// What lies behind it.
    pub(super) into: Beyond,
    /// How wide the passage is, mm.
    pub(super) neck_mm: f64,
}

/// A region that was looked at.
pub(super) struct Inspected {
    /// Where it leaves the vessel, the lowest plane first.
    pub(super) leaks: Vec<Site>,
    /// The voxels that do not belong to the vessel.
    pub(super) removed: Grown,
}

/// Looks at a region; `sign` is +1 for a bright lumen, -1 for a dark one.
pub(super) fn inspect(slab: &Slab<'_>, grown: &Grown, seeds: &[Voxel], sign: f64) -> Inspected {
    let graph = Graph::of(slab, grown);
    let mut seeds: BTreeSet<usize> = seeds.iter().filter_map(|&s| graph.node_at(s)).collect();
    seeds.extend(slab.drawn().into_iter().filter_map(|v| graph.node_at(v)));
    let mut judge = Judge::new(slab, &graph, &seeds, sign);
    judge.walk();
    let Judge { accepted, mut leaks, .. } = judge;
    let (borders, kept_at_border) = at_border(slab, &graph, &accepted);
    leaks.extend(borders);
    leaks.sort_by_key(|l| (l.at[2], l.at[1], l.at[0]));
    let mut removed = grown.clone();
    removed.retain(slab, |v| {
        let node = graph.node_at(v);
        !node.is_some_and(|n| {
            accepted[graph.part_of[n]] && kept_at_border.get(&n).is_none_or(|k| k.contains(&v))
        })
    });
    Inspected { leaks, removed }
}

struct Judge<'a> {
    slab: &'a Slab<'a>,
    graph: &'a Graph,
    sign: f64,
    /// By part.
    accepted: Vec<bool>,
    rejected: Vec<bool>,
    /// Largest disc in the vessel's sections at the seeds, mm2.
    size_mm2: f64,
    /// Sum of the accepted sections, by plane.
    sum_mm2: BTreeMap<usize, f64>,
    /// The most they may be.
    most_mm2: f64,
    /// Level of the lumen, by plane.
    lumen_hu: BTreeMap<usize, f64>,
    leaks: Vec<Site>,
}

fn disc_mm2(radius_mm: f64) -> f64 {
    std::f64::consts::PI * radius_mm * radius_mm
}

/// Of nothing, nothing.
fn quantile(values: Vec<f64>, share: f64) -> f64 {
    super::levels::quantile(values, share).unwrap_or(0.0)
}

impl<'a> Judge<'a> {
    fn new(slab: &'a Slab<'a>, graph: &'a Graph, seeds: &BTreeSet<usize>, sign: f64) -> Self {
        let n = graph.parts.len();
        let mut judge = Self {
            slab,
            graph,
            sign,
            accepted: vec![false; n],
            rejected: vec![false; n],
            size_mm2: 0.0,
            sum_mm2: BTreeMap::new(),
            most_mm2: f64::INFINITY,
            lumen_hu: BTreeMap::new(),
            leaks: Vec::new(),
        };
        for part in seeds.iter().map(|&s| graph.part_of[s]).collect::<BTreeSet<usize>>() {
            judge.accept(part);
            let sizes = judge.nodes(part).map(|n| disc_mm2(n.radius_mm)).collect();
            judge.size_mm2 = judge.size_mm2.max(quantile(sizes, 0.95));
        }
        let sums: Vec<f64> = judge.sum_mm2.values().copied().collect();
        judge.most_mm2 = BULK * quantile(sums, 0.75).max(judge.size_mm2);
        judge
    }

    fn nodes(&self, part: usize) -> impl Iterator<Item = &'a super::graph::Node> + use<'a> {
        let graph = self.graph;
        graph.parts[part].nodes.iter().map(|&n| &graph.nodes[n])
    }

    /// What a drawn contour encloses may look like anything: it tells no level.
    fn tells_level(&self, node: &super::graph::Node) -> bool {
        !self.slab.rules.drawn.contains_key(&node.k)
    }

    fn accept(&mut self, part: usize) {
        self.accepted[part] = true;
        for node in self.nodes(part) {
            *self.sum_mm2.entry(node.k).or_default() += node.area_mm2;
            if !self.tells_level(node) {
                continue;
            }
            // The level of the largest section.
            if disc_mm2(node.radius_mm) >= NEIGHBOUR * self.size_mm2 || !self.lumen_hu.contains_key(&node.k) {
                self.lumen_hu.insert(node.k, node.level_hu);
            }
        }
    }

    /// Judges all parts that can be reached, through the widest passage first.
    fn walk(&mut self) {
        let mut open: BinaryHeap<(u64, usize)> = BinaryHeap::new();
        let key = |l: &Link| (l.width_mm * 1e6).round();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "nanometres")]
        let push = |open: &mut BinaryHeap<(u64, usize)>, part: &Part, links: &[Link]| {
            open.extend(part.links.iter().map(|&l| (key(&links[l]) as u64, l)));
        };
        for part in (0..self.accepted.len()).filter(|&p| self.accepted[p]) {
            push(&mut open, &self.graph.parts[part], &self.graph.links);
        }
        while let Some((_, l)) = open.pop() {
            let link = self.graph.links[l];
            let behind = link.nodes.map(|n| self.graph.part_of[n]).into_iter().find(|&p| !self.accepted[p]);
            let Some(part) = behind.filter(|&p| !self.rejected[p]) else { continue };
            match self.leak_into(part) {
                Some(into) => {
                    self.rejected[part] = true;
                    self.leaks.push(Site { at: link.at, into, neck_mm: link.width_mm });
                }
                None => {
                    self.accept(part);
                    push(&mut open, &self.graph.parts[part], &self.graph.links);
                }
            }
        }
    }

    fn leak_into(&self, part: usize) -> Option<Beyond> {
        let nodes: Vec<_> = self.nodes(part).collect();
        let sizes: Vec<f64> = nodes.iter().map(|n| disc_mm2(n.radius_mm)).collect();
        let times = quantile(sizes.clone(), 0.9) / self.size_mm2;
        if times > JUMP {
            return Some(Beyond::Larger(times));
        }
        if quantile(sizes.clone(), 0.9) < NEIGHBOUR * self.size_mm2
            && nodes.iter().any(|n| n.border.is_some())
        {
            return Some(Beyond::Border);
        }
        if quantile(sizes, 0.5) >= NEIGHBOUR * self.size_mm2 {
            if let Some(hu) = self.other_level(part) {
                return Some(Beyond::Brighter(hu));
            }
            if self.passes_by(part) {
                return Some(Beyond::Neighbour);
            }
        }
        self.is_bulk(part).then_some(Beyond::Bulk)
    }

    /// The part's level where it lies clearly beyond the lumen's.
    fn other_level(&self, part: usize) -> Option<f64> {
        let beyond = |n: &super::graph::Node| {
            let lumen = *nearest(&self.lumen_hu, n.k)?;
            let [lo, hi] = self.slab.window_hu(n.k);
            let edge = if self.sign > 0.0 { lo } else { hi };
            Some(self.sign * (n.level_hu - lumen) / (2.0 * (lumen - edge).abs()).max(1e-9))
        };
        let nodes = self.nodes(part).filter(|n| self.tells_level(n));
        let excess = quantile(nodes.filter_map(beyond).collect(), 0.5);
        (excess > BRIGHTER).then(|| quantile(self.nodes(part).map(|n| n.level_hu).collect(), 0.5))
    }

    /// Whether both the part and the vessel go on to both sides of all that joins them, which is narrow.
    fn passes_by(&self, part: usize) -> bool {
        let graph = self.graph;
        let joins = graph.parts[part].links.iter().map(|&l| graph.links[l]);
        let joins: Vec<Link> =
            joins.filter(|l| l.nodes.iter().any(|&n| self.accepted[graph.part_of[n]])).collect();
        let planes = joins.iter().flat_map(|l| l.nodes.map(|n| graph.nodes[n].k));
        let (Some(first), Some(last)) = (planes.clone().min(), planes.max()) else { return false };
        let others: BTreeSet<usize> = joins.iter().flat_map(|l| l.nodes.map(|n| graph.part_of[n])).collect();
        let goes_on = |p: usize| {
            let radius_mm = quantile(self.nodes(p).map(|n| n.radius_mm).collect(), 0.5);
            let own = || self.nodes(p).map(|n| n.k);
            let (Some(low), Some(high)) = (own().min(), own().max()) else { return false };
            let z = &self.slab.volume.plane_z_mm;
            let least_mm = PASSES_DIAMETERS * 2.0 * radius_mm;
            let far = |a: usize, b: usize| b > a + 1 && z[b] - z[a] >= least_mm;
            far(low, first) && far(last, high)
        };
        goes_on(part) && others.into_iter().filter(|&p| p != part && self.accepted[p]).any(goes_on)
    }

    /// Whether the sections would add up to too much over more than two diameters of the vessel.
    fn is_bulk(&self, part: usize) -> bool {
        let mut sums = self.sum_mm2.clone();
        for node in self.nodes(part) {
            *sums.entry(node.k).or_default() += node.area_mm2;
        }
        let own: BTreeSet<usize> = self.nodes(part).map(|n| n.k).collect();
        let over = |k: &usize| own.contains(k) && sums.get(k).is_some_and(|&s| s > self.most_mm2);
        if !own.iter().any(over) {
            return false;
        }
        let z = &self.slab.volume.plane_z_mm;
        let longest_mm = 4.0 * (self.size_mm2 / std::f64::consts::PI).sqrt();
        let all_over: Vec<usize> =
            sums.iter().filter(|(_, s)| **s > self.most_mm2).map(|(k, _)| *k).collect();
        let runs = all_over.chunk_by(|a, b| b - a == 1);
        runs.filter(|run| run.iter().any(|k| own.contains(k)))
            .any(|run| z[run[run.len() - 1]] - z[run[0]] > longest_mm)
    }
}

fn nearest(by_plane: &BTreeMap<usize, f64>, k: usize) -> Option<&f64> {
    let below = by_plane.range(..=k).next_back();
    let above = by_plane.range(k..).next();
    match (below, above) {
        (Some((a, v)), Some((b, w))) => Some(if k - a <= b - k { v } else { w }),
        (one, other) => one.or(other).map(|(_, v)| v),
    }
}

type KeptAtBorder = BTreeMap<usize, BTreeSet<Voxel>>;

/// Accepted lobes that reach the border of the image, and what of each can be kept: nothing, or the round body of
/// a vessel whose thin side branch ran out.
fn at_border(slab: &Slab<'_>, graph: &Graph, accepted: &[bool]) -> (Vec<Site>, KeptAtBorder) {
    let mut sites = Vec::new();
    let mut kept = KeptAtBorder::new();
    for (n, node) in graph.nodes.iter().enumerate().filter(|(n, _)| accepted[graph.part_of[*n]]) {
        let Some(at) = node.border else { continue };
        let Some(plane) = graph.plane(node.k) else { continue };
        let (body, neck_mm) = body_of(slab, plane, n);
        sites.push(Site { at, into: Beyond::Border, neck_mm });
        kept.insert(n, body);
    }
    (sites, kept)
}

/// A lobe without what is thinner than half of it: its morphological opening; and the width of what was cut off.
/// Nothing is left where that reaches the border still.
fn body_of(slab: &Slab<'_>, plane: &super::graph::PlaneLobes, node: usize) -> (BTreeSet<Voxel>, f64) {
    let label = u32::try_from(node - plane.first).unwrap_or(lobes::NO_LOBE);
    let half_mm = 0.5 * plane.found.lobes[node - plane.first].radius_mm;
    let (labels, depth) = (&plane.found.labels, &plane.found.depth_mm);
    let is_core = |p: usize| labels[p] == label && f64::from(depth[p]) >= half_mm;
    let outside_core: Vec<bool> = (0..labels.len()).map(|p| !is_core(p)).collect();
    let width = plane.columns.len();
    let [sx, sy] = slab.volume.pixel_spacing_xy_mm;
    let to_core = lobes::depth(&outside_core, width, [sx, sy], lobes::Rim::Nothing);
    let own = || (0..labels.len()).filter(|&p| labels[p] == label);
    let is_body = |p: usize| is_core(p) || f64::from(to_core[p]) <= half_mm;
    let [nx, ny, _] = slab.volume.dims;
    let cut_mm = own().filter(|&p| !is_body(p)).map(|p| f64::from(depth[p])).fold(0.0, f64::max);
    let body: BTreeSet<Voxel> = own().filter(|&p| is_body(p)).map(|p| plane.voxel(p)).collect();
    let reaches = body.iter().any(|&[i, j, _]| i == 0 || j == 0 || i + 1 == nx || j + 1 == ny);
    if reaches { (BTreeSet::new(), 2.0 * half_mm) } else { (body, 2.0 * cut_mm) }
}
