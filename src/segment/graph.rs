//! A grown region as a graph: the lobes of every plane, what joins them, and the parts they form.
//!
//! Two lobes of neighbouring planes are joined widely where they cover half of the smaller one and differ by no
//! more than a factor in area; within a plane only necks join them. Lobes joined widely form a part: a vessel with
//! its branches is one part, a vein that touches it through a neck is another.

use super::grow::{Grown, Slab, Voxel};
use super::lobes::{self, Lobes, NO_LOBE};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;

/// Sections of one vessel in neighbouring planes do not differ by more than twice the diameter.
pub(super) const JUMP: f64 = 4.0;
/// Lobes that cover this part of the smaller one are joined widely.
const WIDE: f64 = 0.5;
/// The inner part of a lobe, where blur does not reach, lies deeper than this part of its radius.
const INNER: f64 = 0.6;

/// The lobes of one plane, over the box of the region.
#[derive(Debug, Clone)]
pub(super) struct PlaneLobes {
    pub(super) k: usize,
    pub(super) columns: Range<usize>,
    pub(super) rows: Range<usize>,
    pub(super) found: Lobes,
    /// Number of the first lobe among all nodes.
    pub(super) first: usize,
}

impl PlaneLobes {
    pub(super) fn voxel(&self, p: usize) -> Voxel {
        let width = self.columns.len();
        [self.columns.start + p % width, self.rows.start + p / width, self.k]
    }

    fn index(&self, [i, j, _]: Voxel) -> Option<usize> {
        let within = self.columns.contains(&i) && self.rows.contains(&j);
        within.then(|| (j - self.rows.start) * self.columns.len() + (i - self.columns.start))
    }

    /// The node that a voxel of this plane belongs to.
    pub(super) fn node(&self, voxel: Voxel) -> Option<usize> {
        let label = self.found.labels[self.index(voxel)?];
        (label != NO_LOBE).then(|| self.first + label as usize)
    }
}

/// A lobe.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    pub(super) k: usize,
    pub(super) area_mm2: f64,
    pub(super) radius_mm: f64,
    /// Mean of its inner part, HU.
    pub(super) level_hu: f64,
    /// A voxel of it at the border of the image.
    pub(super) border: Option<Voxel>,
}

/// What joins two lobes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Link {
    pub(super) nodes: [usize; 2],
    pub(super) width_mm: f64,
    pub(super) at: Voxel,
    is_wide: bool,
}

/// Lobes that are joined widely.
#[derive(Debug, Clone, Default)]
pub(super) struct Part {
    pub(super) nodes: Vec<usize>,
    /// Links to lobes of other parts.
    pub(super) links: Vec<usize>,
}

#[derive(Debug, Clone)]
pub(super) struct Graph {
    pub(super) planes: Vec<PlaneLobes>,
    pub(super) nodes: Vec<Node>,
    pub(super) links: Vec<Link>,
    pub(super) parts: Vec<Part>,
    /// The part of every node.
    pub(super) part_of: Vec<usize>,
}

impl Graph {
    pub(super) fn of(slab: &Slab<'_>, grown: &Grown) -> Self {
        let [columns, rows, planes] = grown.extent();
        let cut = |k: usize| plane_lobes(slab, grown, k, &columns, &rows);
        let mut planes: Vec<PlaneLobes> = planes.into_par_iter().map(cut).collect();
        let mut n = 0;
        for plane in &mut planes {
            plane.first = n;
            n += plane.found.lobes.len();
        }
        let nodes: Vec<Node> = planes.par_iter().flat_map_iter(|p| nodes_of(slab, p)).collect();
        let necks = planes.iter().flat_map(necks_of);
        let between: Vec<Vec<Link>> =
            planes.par_windows(2).map(|w| overlaps(slab, &w[0], &w[1], &nodes)).collect();
        let links: Vec<Link> = necks.chain(between.into_iter().flatten()).collect();
        let (parts, part_of) = parts(nodes.len(), &links);
        Self { planes, nodes, links, parts, part_of }
    }

    /// The lobes of plane k; the planes follow each other.
    pub(super) fn plane(&self, k: usize) -> Option<&PlaneLobes> {
        self.planes.get(k.checked_sub(self.planes.first()?.k)?)
    }

    /// The node that holds a voxel.
    pub(super) fn node_at(&self, voxel: Voxel) -> Option<usize> {
        self.plane(voxel[2])?.node(voxel)
    }
}

fn plane_lobes(
    slab: &Slab<'_>,
    grown: &Grown,
    k: usize,
    columns: &Range<usize>,
    rows: &Range<usize>,
) -> PlaneLobes {
    let (columns, rows) = grown.plane_box(slab, k, columns, rows);
    let all = rows.clone().flat_map(|j| columns.clone().map(move |i| [i, j, k]));
    let inside: Vec<bool> = all.map(|v| grown.holds(slab, v)).collect();
    let found = lobes::find(&inside, columns.len(), slab.volume.pixel_spacing_xy_mm);
    PlaneLobes { k, columns, rows, found, first: 0 }
}

fn nodes_of(slab: &Slab<'_>, plane: &PlaneLobes) -> Vec<Node> {
    let [nx, ny, _] = slab.volume.dims;
    let [sx, sy] = slab.volume.pixel_spacing_xy_mm;
    let found = &plane.found;
    let mut sums = vec![(0.0_f64, 0.0_f64, None); found.lobes.len()];
    for (p, &label) in found.labels.iter().enumerate().filter(|(_, l)| **l != NO_LOBE) {
        let (sum, voxel) = (&mut sums[label as usize], plane.voxel(p));
        if f64::from(found.depth_mm[p]) >= INNER * found.lobes[label as usize].radius_mm {
            *sum = (sum.0 + slab.hu(voxel), sum.1 + 1.0, sum.2);
        }
        let [i, j, _] = voxel;
        if i == 0 || j == 0 || i + 1 == nx || j + 1 == ny {
            sum.2 = sum.2.or(Some(voxel));
        }
    }
    let node = |(lobe, (sum, n, border)): (&lobes::Lobe, (f64, f64, Option<Voxel>))| Node {
        k: plane.k,
        area_mm2: lobe.n_pixels as f64 * sx * sy,
        radius_mm: lobe.radius_mm,
        level_hu: sum / n,
        border,
    };
    found.lobes.iter().zip(sums).map(node).collect()
}

fn necks_of(plane: &PlaneLobes) -> impl Iterator<Item = Link> + '_ {
    plane.found.necks.iter().map(|neck| Link {
        nodes: neck.lobes.map(|l| plane.first + l as usize),
        width_mm: neck.width_mm,
        at: plane.voxel(neck.at),
        is_wide: false,
    })
}

fn overlaps(slab: &Slab<'_>, below: &PlaneLobes, above: &PlaneLobes, nodes: &[Node]) -> Vec<Link> {
    let mut shared: BTreeMap<[usize; 2], (usize, Voxel)> = BTreeMap::new();
    for (p, &label) in below.found.labels.iter().enumerate().filter(|(_, l)| **l != NO_LOBE) {
        let [i, j, _] = below.voxel(p);
        if let Some(node) = above.node([i, j, above.k]) {
            shared.entry([below.first + label as usize, node]).or_insert((0, [i, j, above.k])).0 += 1;
        }
    }
    let [sx, sy] = slab.volume.pixel_spacing_xy_mm;
    let link = |(pair, (n, at)): ([usize; 2], (usize, Voxel))| {
        let shared_mm2 = n as f64 * sx * sy;
        let [a, b] = pair.map(|node| nodes[node].area_mm2);
        let is_wide = shared_mm2 >= WIDE * a.min(b) && a.max(b) <= JUMP * a.min(b);
        Link { nodes: pair, width_mm: 2.0 * (shared_mm2 / std::f64::consts::PI).sqrt(), at, is_wide }
    };
    shared.into_iter().map(link).collect()
}

fn parts(n_nodes: usize, links: &[Link]) -> (Vec<Part>, Vec<usize>) {
    let mut above: Vec<usize> = (0..n_nodes).collect();
    for link in links.iter().filter(|l| l.is_wide) {
        let [a, b] = link.nodes.map(|n| root(&mut above, n));
        above[a.max(b)] = a.min(b);
    }
    let mut number = vec![usize::MAX; n_nodes];
    let mut parts: Vec<Part> = Vec::new();
    let mut part_of = Vec::with_capacity(n_nodes);
    for node in 0..n_nodes {
        let root = root(&mut above, node);
        if number[root] == usize::MAX {
            number[root] = parts.len();
            parts.push(Part::default());
        }
        part_of.push(number[root]);
        parts[number[root]].nodes.push(node);
    }
    for (l, link) in links.iter().enumerate() {
        let [a, b] = link.nodes.map(|n| part_of[n]);
        if a != b {
            parts[a].links.push(l);
            parts[b].links.push(l);
        }
    }
    (parts, part_of)
}

pub(super) fn root(above: &mut [usize], mut node: usize) -> usize {
    while above[node] != node {
        above[node] = above[above[node]];
        node = above[node];
    }
    node
}
