//! Triangles that a file holds more than once.
//!
//! A copy does harm where the surface does not need it: along its border more triangles meet than a skin has. Where two bodies
//! share a piece of wall, both need theirs; there every edge is in balance (used as often in the one direction as in the other),
//! and would not be without the copy. So copies that hang together by edges are dropped where that brings edges into balance, and
//! where they are a closed skin of their own.
//!
//! Cost: a look at each triangle where there is no copy, else O(n log k) for k copies.

use super::edges;
use crate::mesh::TriMesh;
use std::collections::BTreeMap;

/// An edge of a copy, the lesser vertex first.
type Edge = [u32; 2];

/// Drops copies that the surface does not need; gives how many. The triangles are in order, and stay so.
pub(super) fn dropped(mesh: &mut TriMesh) -> usize {
    let all = &mesh.triangles;
    let copies: Vec<usize> = (1..all.len()).filter(|&i| all[i] == all[i - 1]).collect();
    if copies.is_empty() {
        return 0;
    }
    let balance = balance(all, &copies);
    let mut is_dropped = vec![false; all.len()];
    for patch in patches(all, &copies) {
        if is_surplus(all, &patch, &balance) {
            patch.iter().for_each(|&i| is_dropped[i] = true);
        }
    }
    let mut dropped = is_dropped.iter();
    mesh.triangles.retain(|_| dropped.next() == Some(&false));
    is_dropped.iter().filter(|d| **d).count()
}

/// The edges of a triangle, and 1 where it runs along them upward, -1 where downward.
fn directed(t: &[u32; 3]) -> [(Edge, i32); 3] {
    edges(t).map(|[a, b]| if a < b { ([a, b], 1) } else { ([b, a], -1) })
}

/// How much more often the edges of copies are used upward than downward, by all triangles.
fn balance(all: &[[u32; 3]], copies: &[usize]) -> BTreeMap<Edge, i32> {
    let mut balance: BTreeMap<Edge, i32> =
        copies.iter().flat_map(|&i| directed(&all[i])).map(|(edge, _)| (edge, 0)).collect();
    for (edge, by) in all.iter().flat_map(directed) {
        if let Some(sum) = balance.get_mut(&edge) {
            *sum += by;
        }
    }
    balance
}

/// Copies that hang together by edges.
fn patches(all: &[[u32; 3]], copies: &[usize]) -> Vec<Vec<usize>> {
    let mut beside: BTreeMap<Edge, Vec<usize>> = BTreeMap::new();
    for (number, &i) in copies.iter().enumerate() {
        directed(&all[i]).iter().for_each(|(edge, _)| beside.entry(*edge).or_default().push(number));
    }
    let mut is_seen = vec![false; copies.len()];
    let mut patches = Vec::new();
    for first in 0..copies.len() {
        let mut open = vec![first];
        let mut patch = Vec::new();
        while let Some(number) = open.pop() {
            if !std::mem::replace(&mut is_seen[number], true) {
                patch.push(copies[number]);
                open.extend(directed(&all[copies[number]]).iter().flat_map(|(edge, _)| &beside[edge]));
            }
        }
        if !patch.is_empty() {
            patches.push(patch);
        }
    }
    patches
}

/// Whether edges are nearer to balance without a patch of copies, or no edge is its border.
fn is_surplus(all: &[[u32; 3]], patch: &[usize], balance: &BTreeMap<Edge, i32>) -> bool {
    let mut own: BTreeMap<Edge, i32> = BTreeMap::new();
    patch.iter().flat_map(|&i| directed(&all[i])).for_each(|(edge, by)| *own.entry(edge).or_default() += by);
    let gained = |(edge, by): (&Edge, &i32)| balance[edge].abs() - (balance[edge] - by).abs();
    own.values().all(|by| *by == 0) || own.iter().map(gained).sum::<i32>() > 0
}
