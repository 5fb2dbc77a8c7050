//! Triangles that a file holds more than once.
//!
//! A copy does harm where the surface does not need it: along its border more triangles meet than a skin has. Where two bodies
//! share a piece of wall, both need theirs; there every edge is in balance (used as often in the one direction as in the other),
//! and would not be without the copy.
//!
//! Copies that meet at an edge in balance are a patch: both of them stay or neither. Where the edge is out of balance one of them
//! may be needed and the other one not, so no patch goes on across it. A patch is dropped where that brings more of its edges
//! into balance than out of it, or none out where it is a closed skin; then it is looked at what is left, as edges are in balance
//! now that were not. So a wall that two bodies share stays though sheets that hang on it are dropped.
//!
//! Not always found: what is surplus of a skin that meets itself (more than two of its triangles at an edge). Where the rest can be in
//! balance in several ways (five doubled sides of a cube whose sixth is shared), it is one of them, not always that of the fewest
//! triangles.
//!
//! Of one triangle no more than [`MOST_ALIKE`] copies are weighed; no more bodies share a piece of wall, and what is beyond is dropped.
//!
//! Cost: a look at each triangle where there is no copy, else O(n log k) for k copies, and O(k log k) for each time that
//! the rest is looked at: as often as sheets of copies hang on each other, plus one.

use super::edges;
use crate::mesh::TriMesh;
use std::collections::{BTreeMap, BTreeSet};

/// Copies of one triangle beyond the first that may be needed.
const MOST_ALIKE: usize = 8;

/// An edge of a copy, the lesser vertex first.
type Edge = [u32; 2];

/// A use of an edge by a copy: its number, and 1 where it runs upward, -1 where downward.
type Use = (usize, i32);

/// Drops copies that the surface does not need; gives how many. The triangles are in order, and stay so.
pub(super) fn dropped(mesh: &mut TriMesh) -> usize {
    let n_before = mesh.triangles.len();
    let all = &mesh.triangles;
    let is_copy = |&i: &usize| all[i] == all[i - 1];
    if !(1..all.len()).any(|i| is_copy(&i)) {
        return 0;
    }
    let beyond = MOST_ALIKE + 1;
    let is_weighed: Vec<bool> = (0..all.len()).map(|i| i < beyond || all[i] != all[i - beyond]).collect();
    let mut i = 0;
    mesh.triangles.retain(|_| {
        i += 1;
        is_weighed[i - 1]
    });
    let all = &mesh.triangles;
    let is_copy = |&i: &usize| all[i] == all[i - 1];
    let mut copies = Copies::of(all, (1..all.len()).filter(is_copy).collect());
    copies.drop_surplus();
    let mut left =
        copies.places.iter().zip(&copies.is_dropped).filter(|(_, d)| **d).map(|(i, _)| *i).peekable();
    let mut i = 0;
    mesh.triangles.retain(|_| {
        i += 1;
        left.next_if_eq(&(i - 1)).is_none()
    });
    n_before - mesh.triangles.len()
}

/// The edges of a triangle, and 1 where it runs along them upward, -1 where downward.
fn directed(t: &[u32; 3]) -> [(Edge, i32); 3] {
    edges(t).map(|[a, b]| if a < b { ([a, b], 1) } else { ([b, a], -1) })
}

/// Which copies a patch goes on to across an edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Across {
    /// Those that stay or go together: the edge is in balance, and two triangles meet there.
    Balanced,
    /// All.
    Any,
}

/// All triangles that are there already.
struct Copies<'a> {
    all: &'a [[u32; 3]],
    /// Where they are among all triangles.
    places: Vec<usize>,
    is_dropped: Vec<bool>,
    /// By how much more often their edges are used upward than downward, by all triangles, and by which copies.
    edges: BTreeMap<Edge, (i32, Vec<Use>)>,
}

impl<'a> Copies<'a> {
    fn of(all: &'a [[u32; 3]], places: Vec<usize>) -> Self {
        let mut edges: BTreeMap<Edge, (i32, Vec<Use>)> = BTreeMap::new();
        for (copy, &place) in places.iter().enumerate() {
            directed(&all[place])
                .iter()
                .for_each(|&(edge, by)| edges.entry(edge).or_default().1.push((copy, by)));
        }
        for (edge, by) in all.iter().flat_map(directed) {
            if let Some((balance, _)) = edges.get_mut(&edge) {
                *balance += by;
            }
        }
        Self { all, is_dropped: vec![false; places.len()], places, edges }
    }

    fn drop_surplus(&mut self) {
        for across in [Across::Balanced, Across::Any] {
            while self.drop_patches(across) {}
        }
    }

    /// Drops patches that are surplus; whether there was one.
    fn drop_patches(&mut self, across: Across) -> bool {
        let mut was_one = false;
        for patch in self.patches(across) {
            let own = self.own(&patch);
            if self.is_surplus(&own) {
                was_one = true;
                patch.iter().for_each(|&copy| self.is_dropped[copy] = true);
                for (edge, by) in own {
                    if let Some((balance, _)) = self.edges.get_mut(&edge) {
                        *balance -= by;
                    }
                }
            }
        }
        was_one
    }

    /// What is left of the copies, in patches.
    fn patches(&self, across: Across) -> Vec<Vec<usize>> {
        let mut is_seen = self.is_dropped.clone();
        let mut is_crossed = BTreeSet::new();
        let mut patches = Vec::new();
        for first in 0..self.places.len() {
            let mut open = vec![first];
            let mut patch = Vec::new();
            while let Some(copy) = open.pop() {
                if !std::mem::replace(&mut is_seen[copy], true) {
                    patch.push(copy);
                    for (edge, by) in self.edges_of(copy) {
                        match across {
                            Across::Balanced => open.extend(self.across_balanced(edge, (copy, by))),
                            Across::Any if is_crossed.insert(edge) => {
                                open.extend(self.edges[&edge].1.iter().map(|(copy, _)| *copy));
                            }
                            Across::Any => {}
                        }
                    }
                }
            }
            if !patch.is_empty() {
                patches.push(patch);
            }
        }
        patches
    }

    fn edges_of(&self, copy: usize) -> impl Iterator<Item = (Edge, i32)> {
        directed(&self.all[self.places[copy]]).into_iter()
    }

    /// The copy that stays or goes with a copy across an edge, if two triangles meet there, in balance.
    fn across_balanced(&self, edge: Edge, of: Use) -> Option<usize> {
        let (balance, uses) = &self.edges[&edge];
        // More than of two triangles.
        if *balance != 0 || uses.len() > 2 * MOST_ALIKE {
            return None;
        }
        let left = uses.iter().filter(|(copy, _)| !self.is_dropped[*copy]);
        let (same, other): (Vec<Use>, Vec<Use>) = left.partition(|(_, by)| *by == of.1);
        // The copies of one triangle are alike: each goes with one of those of the other.
        let number = same.iter().position(|use_| *use_ == of)?;
        let are_alike = self.are_of_one(&same) && self.are_of_one(&other);
        other.get(number).filter(|_| are_alike).map(|(copy, _)| *copy)
    }

    fn are_of_one(&self, uses: &[Use]) -> bool {
        let triangle = |(copy, _): &Use| self.all[self.places[*copy]];
        uses.windows(2).all(|two| triangle(&two[0]) == triangle(&two[1]))
    }

    /// How much more often the copies of a patch use its edges upward than downward.
    fn own(&self, patch: &[usize]) -> BTreeMap<Edge, i32> {
        let mut own = BTreeMap::new();
        patch
            .iter()
            .flat_map(|&copy| self.edges_of(copy))
            .for_each(|(edge, by)| *own.entry(edge).or_default() += by);
        own
    }

    /// Whether edges are nearer to balance without a patch of copies, or no edge is its border.
    fn is_surplus(&self, own: &BTreeMap<Edge, i32>) -> bool {
        let gained = |(edge, by): (&Edge, &i32)| {
            let balance = self.edges[edge].0;
            balance.abs() - (balance - by).abs()
        };
        own.values().all(|by| *by == 0) || own.iter().map(gained).sum::<i32>() > 0
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{cuboid, moved};
    use super::super::{Facet, welded};
    use super::*;
    use proptest::prelude::*;

    /// Edges that are used more often in the one direction than in the other.
    fn n_unbalanced(mesh: &TriMesh) -> usize {
        let mut sums: BTreeMap<Edge, i32> = BTreeMap::new();
        mesh.triangles.iter().flat_map(directed).for_each(|(edge, by)| *sums.entry(edge).or_default() += by);
        sums.values().filter(|sum| **sum != 0).count()
    }

    /// The triangles of a body in the plane in which a coordinate has a value.
    fn side(facets: &[Facet], axis: usize, at: f32) -> Vec<Facet> {
        facets.iter().filter(|f| f.iter().all(|corner| corner[axis] == at)).copied().collect()
    }

    #[test]
    fn a_wall_that_two_bodies_share_stays_though_doubled_sides_hang_on_it() {
        let (short, long) = (cuboid([2.0; 3]), cuboid([5.0, 2.0, 2.0]));
        let both = [short.clone(), long.clone()].concat();
        let (front, back, below) = (side(&long, 1, 0.0), side(&long, 1, 2.0), side(&long, 2, 0.0));
        let shared = side(&long, 0, 0.0);
        let surplus: [&[&Vec<Facet>]; 7] = [
            &[&front],
            &[&front, &back],
            &[&front, &below],
            &[&front, &back, &below],
            &[&shared],
            &[&shared, &front],
            &[&front, &front, &shared, &shared, &below],
        ];
        for (case, extra) in surplus.iter().enumerate() {
            let extra: Vec<Facet> = extra.iter().flat_map(|side| side.iter().copied()).collect();
            let mut mesh = welded(&[both.clone(), extra.clone()].concat()).unwrap();
            assert_eq!(dropped(&mut mesh), extra.len(), "case {case}");
            assert_eq!(mesh, welded(&both).unwrap(), "case {case}");
        }
    }

    #[test]
    fn a_triangle_a_hundred_thousand_times_more_is_dropped_as_often() {
        let cube = cuboid([2.0; 3]);
        let mut mesh = welded(&[cube.clone(), vec![cube[0]; 100_000]].concat()).unwrap();
        assert_eq!(dropped(&mut mesh), 100_000);
        assert_eq!(mesh, welded(&cube).unwrap());
    }

    #[test]
    fn pairs_of_bodies_about_one_axis_stay_whatever_their_number() {
        // Of each pair the one body holds the other, and they share a side that has the axis for an edge.
        let n = 20_000;
        let at = |k: usize| {
            let angle = std::f32::consts::TAU * k as f32 / n as f32;
            [angle.cos(), angle.sin(), 0.5]
        };
        let (low, high) = ([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
        let pair = |k: usize| {
            let (side, near) = (at(2 * k), at(2 * k + 1));
            let far = near.map(|c| 0.9 * c);
            [near, far].into_iter().flat_map(move |apex| {
                [[low, side, high], [low, apex, side], [side, apex, high], [high, apex, low]]
            })
        };
        let mut mesh = welded(&(0..n / 2).flat_map(pair).collect::<Vec<Facet>>()).unwrap();
        let before = mesh.clone();
        assert_eq!((dropped(&mut mesh), mesh == before), (0, true));
    }

    const GRID: [i32; 3] = [3, 2, 2];

    /// The skin of a body of unit cubes, by the bits of a number.
    fn body(bits: u16) -> Vec<Facet> {
        let is_in = |at: [i32; 3]| {
            let inside = (0..3).all(|k| at[k] >= 0 && at[k] < GRID[k]);
            inside && bits >> (at[0] + 3 * at[1] + 6 * at[2]) & 1 == 1
        };
        let mut facets = Vec::new();
        for (x, y, z) in (0..3).flat_map(|x| (0..2).flat_map(move |y| (0..2).map(move |z| (x, y, z)))) {
            for (axis, step) in (0..3).flat_map(|axis| [(axis, -1), (axis, 1)]) {
                let mut beside = [x, y, z];
                beside[axis] += step;
                if is_in([x, y, z]) && !is_in(beside) {
                    let unit = side(&cuboid([1.0; 3]), axis, if step > 0 { 1.0 } else { 0.0 });
                    facets.extend(moved(&unit, [x as f32, y as f32, z as f32]));
                }
            }
        }
        facets
    }

    /// Whether more than two triangles of a skin meet at an edge.
    fn meets_itself(facets: &[Facet]) -> bool {
        let mut uses: BTreeMap<Edge, usize> = BTreeMap::new();
        let all = welded(facets).unwrap().triangles;
        all.iter().flat_map(directed).for_each(|(edge, _)| *uses.entry(edge).or_default() += 1);
        uses.values().any(|n| *n != 2)
    }

    /// A body that does not meet itself.
    fn a_body() -> impl Strategy<Value = u16> {
        let all = (1_u16..4096).filter(|bits| !meets_itself(&body(*bits)));
        prop::sample::select(all.collect::<Vec<_>>())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(256))]
        #[test]
        fn bodies_that_overlap_are_in_balance_without_the_surplus_copies(
            a in a_body(), b in a_body(), again in prop::collection::vec(0_usize..200, 0..12),
        ) {
            let both = [body(a), body(b)].concat();
            let again: Vec<Facet> = again.iter().flat_map(|i| {
                let first = 2 * (i % (both.len() / 2));
                [both[first], both[first + 1]]
            }).collect();
            let mut mesh = welded(&[both.clone(), again].concat()).unwrap();
            dropped(&mut mesh);
            prop_assert_eq!(n_unbalanced(&mesh), 0);
        }
    }
}
