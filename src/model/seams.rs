//! Open edges of a welded mesh, and the corners there that all but coincide: programs that round each triangle for itself
//! leave every edge open by less than a printer can tell.
//!
//! Closed meshes cost one pass: of each edge the two directions cancel in a sum of hashes. Others: O(n log n) in the edges,
//! and a grid of cells as wide as the tolerance for the corners of open ones.

use super::{edges, from_least, has_area};
use crate::mesh::TriMesh;
use rayon::prelude::*;
use std::collections::HashMap;

/// Corners of open edges are joined where they lie no farther apart, mm: what is smaller, no printer makes.
const JOIN_MM: f64 = 0.01;

/// What was done about open edges.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Seams {
    /// Corners that were joined with another one.
    pub(super) n_joined: usize,
    /// Edges with a triangle on one side only, after that.
    pub(super) n_open: usize,
    /// Edges beside which triangles face different ways.
    pub(super) n_torn: usize,
}

/// The mesh with corners of open edges joined where they all but coincide.
pub(super) fn joined(mesh: &mut TriMesh) -> Seams {
    if is_closed(mesh) {
        return Seams::default();
    }
    let odd = odd_edges(mesh);
    let loose = loose_corners(&odd.open);
    let leaders = clusters(mesh, &loose);
    let n_joined = loose.iter().filter(|&&v| leaders[&v] != v).count();
    if n_joined == 0 {
        return Seams { n_joined, n_open: odd.open.len(), n_torn: odd.n_torn };
    }
    let leader = |v: u32| leaders.get(&v).copied().unwrap_or(v);
    let moved = mesh.triangles.par_iter().map(|t| from_least(t.map(leader))).filter(has_area);
    mesh.triangles = moved.collect();
    mesh.triangles.par_sort_unstable();
    let odd = odd_edges(mesh);
    Seams { n_joined, n_open: odd.open.len(), n_torn: odd.n_torn }
}

/// Edges of a mesh that is not closed.
struct OddEdges {
    /// Used by an odd number of triangles, the lesser vertex first, ascending.
    open: Vec<[u32; 2]>,
    /// Number of those that an even number of triangles use, but not as often in one direction as in the other.
    n_torn: usize,
}

/// Whether every edge is used as often in one direction as in the other; of open meshes one in 2^64 is taken for closed.
fn is_closed(mesh: &TriMesh) -> bool {
    let signed = |[a, b]: [u32; 2]| {
        let mixed = mixed(u64::from(a.min(b)) << 32 | u64::from(a.max(b)));
        if a < b { mixed } else { mixed.wrapping_neg() }
    };
    let of = |t: &[u32; 3]| edges(t).into_iter().map(signed).fold(0, u64::wrapping_add);
    mesh.triangles.par_iter().map(of).reduce(|| 0, u64::wrapping_add) == 0
}

/// A hash of 64 bits (the finalizer of Steele, Lea and Flood, *Fast Splittable Pseudorandom Number Generators*, 2014).
const fn mixed(key: u64) -> u64 {
    let z = key.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

fn odd_edges(mesh: &TriMesh) -> OddEdges {
    let directed = |[a, b]: [u32; 2]| ([a.min(b), a.max(b)], a < b);
    let mut all: Vec<([u32; 2], bool)> =
        mesh.triangles.par_iter().flat_map_iter(|t| edges(t).into_iter().map(directed)).collect();
    all.par_sort_unstable();
    let mut odd = OddEdges { open: Vec::new(), n_torn: 0 };
    for same in all.chunk_by(|a, b| a.0 == b.0) {
        if same.len() % 2 == 1 {
            odd.open.push(same[0].0);
        } else if 2 * same.iter().filter(|e| e.1).count() != same.len() {
            odd.n_torn += 1;
        }
    }
    odd
}

fn loose_corners(open: &[[u32; 2]]) -> Vec<u32> {
    let mut loose = open.as_flattened().to_vec();
    loose.sort_unstable();
    loose.dedup();
    loose
}

/// For each of the corners the first one of those that are joined with it.
fn clusters(mesh: &TriMesh, corners: &[u32]) -> HashMap<u32, u32> {
    #[expect(clippy::cast_possible_truncation, reason = "coordinates are bounded")]
    let cell = |v: u32| mesh.vertices[v as usize].coords.map(|c| (c / JOIN_MM).floor() as i64);
    let mut cells: HashMap<[i64; 3], Vec<u32>> = HashMap::new();
    for &v in corners {
        cells.entry(cell(v).into()).or_default().push(v);
    }
    let mut leaders: HashMap<u32, u32> = corners.iter().map(|&v| (v, v)).collect();
    for &v in corners {
        let [x, y, z] = cell(v).into();
        let around =
            (-1..=1).flat_map(|i| (-1..=1).flat_map(move |j| (-1..=1).map(move |k| [x + i, y + j, z + k])));
        let near =
            |w: &u32| *w < v && (mesh.vertices[*w as usize] - mesh.vertices[v as usize]).norm() <= JOIN_MM;
        for &w in around.filter_map(|c| cells.get(&c)).flatten().filter(|w| near(w)) {
            let (a, b) = (leader(&leaders, v), leader(&leaders, w));
            leaders.insert(a.max(b), a.min(b));
        }
    }
    corners.iter().map(|&v| (v, leader(&leaders, v))).collect()
}

/// The first corner of a cluster: each knows an earlier one, and the first itself.
fn leader(leaders: &HashMap<u32, u32>, mut v: u32) -> u32 {
    while leaders[&v] != v {
        v = leaders[&v];
    }
    v
}
