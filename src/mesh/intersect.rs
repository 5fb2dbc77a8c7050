//! Where a triangle mesh meets itself.
//!
//! Pairs of triangles whose boxes meet (a tree of boxes) are tested by signs of determinants alone, after Guigue and
//! Devillers (*Fast and Robust Triangle-Triangle Overlap Test Using Orientation Predicates*, 2003). The signs are exact
//! (Shewchuk, *Adaptive Precision Floating-Point Arithmetic*, 1997), so that no tolerance decides what is a crossing:
//!
//! - triangles without a common vertex must have no point in common: crossing and touching are both faults;
//! - triangles with one common vertex must have nothing but it in common;
//! - triangles with a common edge must not be folded onto each other; two on the same three vertices always are.
//!
//! Vertices are one where their index is. Triangles without area are tested by their edges, and those that use a vertex
//! twice are passed over: [`super::closedness`] tells of them. Coordinates have to be finite, or what they belong to may be
//! missed.
//!
//! Nearly all pairs whose boxes meet have a vertex in common. Where the mesh is closed and the triangles at a vertex can be
//! seen from one side without one hiding another, none of these pairs has more in common, and they are not looked at.
//!
//! Cost O(n log n) for surfaces.

use super::bvh::Bvh;
use super::{TriMesh, closedness, plain};
use crate::geom::Point3;
use crate::progress::{Cancelled, Task};
use rayon::prelude::*;
use robust::{Coord, Coord3D, orient2d, orient3d};

/// Two triangles that have more in common than the vertices they share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intersection {
    /// The triangles' numbers, ascending.
    pub triangles: [u32; 2],
    /// A point that both have, to rounding, mm.
    pub at: Point3,
}

/// How many intersections are looked for before the search ends: a mesh with more is wrong everywhere, and their number may
/// grow with the square of the triangles'.
pub const MOST_INTERSECTIONS: usize = 10_000;
/// Most parts into which triangles are grouped for the search, and how many are searched between two looks at whether the
/// work was cancelled or enough was found.
const MOST_PARTS: usize = 256;
const BLOCK: usize = 32;

/// Finds where a mesh meets itself, sorted by triangles; at most [`MOST_INTERSECTIONS`].
///
/// # Errors
/// [`Cancelled`].
pub fn self_intersections(mesh: &TriMesh, task: &Task<'_>) -> Result<Vec<Intersection>, Cancelled> {
    task.check()?;
    // In what is not closed, the triangles at a vertex may wind round it more than once.
    let is_plain = if closedness(mesh).is_closed() { plain::vertices(mesh) } else { Vec::new() };
    of_all(mesh, &is_plain, task)
}

/// The same for a mesh that is known to be closed.
pub(super) fn of_closed(mesh: &TriMesh, task: &Task<'_>) -> Result<Vec<Intersection>, Cancelled> {
    of_all(mesh, &plain::vertices(mesh), task)
}

fn of_all(mesh: &TriMesh, is_plain: &[bool], task: &Task<'_>) -> Result<Vec<Intersection>, Cancelled> {
    let mut found = Vec::new();
    if mesh.triangles.is_empty() {
        return Ok(found);
    }
    let bvh = Bvh::of(mesh);
    let (level, n_parts) = bvh.level_of(MOST_PARTS);
    let parts: Vec<usize> = (0..n_parts).collect();
    for block in parts.chunks(BLOCK) {
        task.check()?;
        let of_part = |&part: &usize| of_part(mesh, is_plain, &bvh, level, part..n_parts);
        // Collected in the order of the parts: the same on any number of threads.
        let pieces: Vec<Vec<Intersection>> = block.par_iter().map(of_part).collect();
        found.extend(pieces.into_iter().flatten());
        if found.len() >= MOST_INTERSECTIONS {
            found.truncate(MOST_INTERSECTIONS);
            break;
        }
    }
    found.sort_unstable_by_key(|i| i.triangles);
    Ok(found)
}

/// Those between the triangles of the first part and its own or those of the others.
fn of_part(
    mesh: &TriMesh,
    is_plain: &[bool],
    bvh: &Bvh,
    level: usize,
    parts: std::ops::Range<usize>,
) -> Vec<Intersection> {
    let mut found = Vec::new();
    let mut visit = |one: usize, other: usize| {
        for i in bvh.leaf(one) {
            for j in bvh.leaf(other) {
                if (one != other || j > i)
                    && found.len() < MOST_INTERSECTIONS
                    && bvh.boxes[i].meets(&bvh.boxes[j])
                {
                    let (s, t) = (bvh.order[i], bvh.order[j]);
                    found.extend(of_pair(mesh, is_plain, s.min(t), s.max(t)));
                }
            }
        }
    };
    let first = parts.start;
    parts.for_each(|part| bvh.meeting(level, [first, part], &mut visit));
    found
}

/// What two triangles have in common beyond their shared vertices.
fn of_pair(mesh: &TriMesh, is_plain: &[bool], i: u32, j: u32) -> Option<Intersection> {
    let (s, t) = (mesh.triangles[i as usize], mesh.triangles[j as usize]);
    if !is_plain.is_empty() && s.iter().any(|v| t.contains(v) && is_plain[*v as usize]) {
        return None;
    }
    let is_repeating = |[a, b, c]: [u32; 3]| a == b || b == c || c == a;
    if is_repeating(s) || is_repeating(t) {
        return None;
    }
    let triangle = |t: [u32; 3]| t.map(|v| mesh.vertices[v as usize]);
    let shared = s.map(|v| t.iter().position(|&w| w == v));
    let at = match shared {
        [None, None, None] => of_separate(&triangle(s), &triangle(t)),
        [Some(k), None, None] => of_fan(&triangle(s), &turned(triangle(t), k)),
        [None, Some(k), None] => of_fan(&turned(triangle(s), 1), &turned(triangle(t), k)),
        [None, None, Some(k)] => of_fan(&turned(triangle(s), 2), &turned(triangle(t), k)),
        [Some(k), Some(m), None] => of_hinge(&triangle(s), mesh.vertices[t[3 - k - m] as usize]),
        [None, Some(k), Some(m)] => of_hinge(&turned(triangle(s), 1), mesh.vertices[t[3 - k - m] as usize]),
        [Some(m), None, Some(k)] => of_hinge(&turned(triangle(s), 2), mesh.vertices[t[3 - k - m] as usize]),
        [Some(_), Some(_), Some(_)] => Some(middle(&triangle(s))),
    };
    at.map(|at| Intersection { triangles: [i, j], at })
}

type Triangle = [Point3; 3];

/// The triangle with its vertex k first.
fn turned(t: Triangle, k: usize) -> Triangle {
    [t[k], t[(k + 1) % 3], t[(k + 2) % 3]]
}

fn middle(t: &Triangle) -> Point3 {
    ((t[0].coords + t[1].coords + t[2].coords) / 3.0).into()
}

/// On which side of the plane through a triangle a point lies; exact in its sign.
fn side(t: &Triangle, p: Point3) -> f64 {
    let c = |p: Point3| Coord3D { x: p.x, y: p.y, z: p.z };
    orient3d(c(t[0]), c(t[1]), c(t[2]), c(p))
}

/// Whether all points lie on one side of the plane through a triangle, none on it.
fn is_beside(t: &Triangle, points: &[Point3]) -> bool {
    let above = side(t, points[0]) > 0.0;
    points.iter().all(|&p| if above { side(t, p) > 0.0 } else { side(t, p) < 0.0 })
}

/// Triangles without a common vertex: an edge of one passes through the other, or both lie in one plane and overlap.
fn of_separate(s: &Triangle, t: &Triangle) -> Option<Point3> {
    if is_beside(s, t) || is_beside(t, s) {
        return None;
    }
    let edges = |t: &Triangle| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
    let through = |edges: [[Point3; 2]; 3], t: &Triangle| edges.into_iter().find_map(|e| of_segment(e, t));
    through(edges(s), t).or_else(|| through(edges(t), s))
}

/// Triangles whose first vertices are one. From there both run along the line in which their planes meet, or not; where
/// both do, the one that ends first does so with its far edge, and that end lies in the other.
fn of_fan(s: &Triangle, t: &Triangle) -> Option<Point3> {
    if is_beside(s, &t[1..]) || is_beside(t, &s[1..]) {
        return None;
    }
    of_segment([s[1], s[2]], t).or_else(|| of_segment([t[1], t[2]], s))
}

/// A triangle and the far vertex of a neighbour across its first edge: folded where all lie in one plane, both far
/// vertices on one side of the edge.
fn of_hinge(s: &Triangle, far: Point3) -> Option<Point3> {
    // The comparison is exact: what is compared is a sign.
    if side(s, far).to_bits() << 1 != 0 {
        return None;
    }
    let axis = flat_axis(s)?;
    let [own, other] = [s[2], far].map(|p| turn(axis, s[0], s[1], p));
    ((own > 0.0 && other > 0.0) || (own < 0.0 && other < 0.0)).then(|| nalgebra::center(&s[0], &s[1]))
}

/// Where a segment has a point in common with a triangle, borders included.
fn of_segment([p, q]: [Point3; 2], t: &Triangle) -> Option<Point3> {
    let (above, below) = (side(t, p), side(t, q));
    if (above > 0.0 && below > 0.0) || (above < 0.0 && below < 0.0) {
        return None;
    }
    if (above - below).to_bits() << 1 == 0 {
        return in_plane([p, q], t);
    }
    // The line passes all three edges on the same side.
    let passes = [[0, 1], [1, 2], [2, 0]].map(|[a, b]| side(&[p, q, t[a]], t[b]));
    let inside = passes.iter().all(|&v| v >= 0.0) || passes.iter().all(|&v| v <= 0.0);
    inside.then(|| p + (q - p) * (above / (above - below)))
}

/// Where a segment in the plane of a triangle has a point in common with it.
fn in_plane([p, q]: [Point3; 2], t: &Triangle) -> Option<Point3> {
    let axis = flat_axis(t)?;
    let contains = |p: Point3| {
        let turns = [[0, 1], [1, 2], [2, 0]].map(|[a, b]| turn(axis, t[a], t[b], p));
        turns.iter().all(|&v| v >= 0.0) || turns.iter().all(|&v| v <= 0.0)
    };
    let crosses = |a: Point3, b: Point3| {
        let opposite = |u: f64, v: f64| (u <= 0.0 && v >= 0.0) || (u >= 0.0 && v <= 0.0);
        let (pa, pb) = (turn(axis, p, q, a), turn(axis, p, q, b));
        let (ap, aq) = (turn(axis, a, b, p), turn(axis, a, b, q));
        (opposite(pa, pb) && opposite(ap, aq)).then(|| p + (q - p) * (ap / (ap - aq)))
    };
    if contains(p) {
        Some(p)
    } else if contains(q) {
        Some(q)
    } else {
        // Both ends outside: the segment enters through an edge that it truly crosses.
        [[0, 1], [1, 2], [2, 0]]
            .into_iter()
            .find_map(|[a, b]| crosses(t[a], t[b]).filter(|p| p.x.is_finite()))
    }
}

/// An axis along which the triangle can be seen; `None` where it has no area.
fn flat_axis(t: &Triangle) -> Option<usize> {
    (0..3).find(|&axis| turn(axis, t[0], t[1], t[2]).to_bits() << 1 != 0)
}

/// Whether a path turns left or right, seen along an axis; exact in its sign.
fn turn(axis: usize, a: Point3, b: Point3, c: Point3) -> f64 {
    let seen = |p: Point3| Coord { x: p[(axis + 1) % 3], y: p[(axis + 2) % 3] };
    orient2d(seen(a), seen(b), seen(c))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn found(mesh: &TriMesh) -> Vec<[u32; 2]> {
        self_intersections(mesh, &Task::quiet()).unwrap().iter().map(|i| i.triangles).collect()
    }

    fn mesh(vertices: &[[f64; 3]], triangles: &[[u32; 3]]) -> TriMesh {
        TriMesh { vertices: vertices.iter().map(|&p| p.into()).collect(), triangles: triangles.to_vec() }
    }

    /// Separate triangles.
    fn soup(triangles: &[[[i64; 3]; 3]]) -> TriMesh {
        let mut soup = TriMesh::default();
        for corners in triangles {
            let indices =
                corners.map(|[x, y, z]| soup.push(Point3::new(x as f64, y as f64, z as f64)).unwrap());
            soup.triangles.push(indices);
        }
        soup
    }

    /// Whether two triangles have no point in common, in whole numbers: a plane lies strictly between them, parallel to
    /// one of them or to an edge of each, or, for two in one plane, upright on it along an edge.
    fn are_apart(s: &[[i64; 3]; 3], t: &[[i64; 3]; 3]) -> bool {
        type V = [i64; 3];
        let minus = |a: V, b: V| [0, 1, 2].map(|k| a[k] - b[k]);
        let cross =
            |a: V, b: V| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
        let dot = |a: V, b: V| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let edges = |t: &[V; 3]| [minus(t[1], t[0]), minus(t[2], t[1]), minus(t[0], t[2])];
        let normal = |t: &[V; 3]| cross(minus(t[1], t[0]), minus(t[2], t[0]));
        let mut axes = vec![normal(s), normal(t)];
        for a in edges(s) {
            axes.extend(edges(t).map(|b| cross(a, b)));
            axes.push(cross(normal(s), a));
        }
        axes.extend(edges(t).map(|b| cross(normal(t), b)));
        axes.into_iter().any(|axis| {
            let (s, t) = (s.map(|p| dot(axis, p)), t.map(|p| dot(axis, p)));
            let range = |v: [i64; 3]| (*v.iter().min().unwrap(), *v.iter().max().unwrap());
            range(s).1 < range(t).0 || range(t).1 < range(s).0
        })
    }

    fn has_area(t: &[[i64; 3]; 3]) -> bool {
        flat_axis(&t.map(|[x, y, z]| Point3::new(x as f64, y as f64, z as f64))).is_some()
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(200) })]

        /// On a coarse grid touching, common planes and collinear edges are frequent.
        #[test]
        fn a_soup_meets_itself_where_no_plane_parts_its_triangles(
            mut triangles in prop::collection::vec(prop::array::uniform3(prop::array::uniform3(0_i64..6)), 2..24)
        ) {
            triangles.retain(has_area);
            let pairs = (0..triangles.len()).flat_map(|i| (i + 1..triangles.len()).map(move |j| [i, j]));
            let expected: Vec<[u32; 2]> = pairs
                .filter(|&[i, j]| !are_apart(&triangles[i], &triangles[j]))
                .map(|pair| pair.map(|i| u32::try_from(i).unwrap()))
                .collect();
            prop_assert_eq!(found(&soup(&triangles)), expected);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(24) })]

        #[test]
        fn every_pair_of_a_large_soup_is_found_by_the_hierarchy(seed in 0_u32..1000, spread in 2.0..40.0_f64) {
            let value = |i: u32| f64::from(((i + 1).wrapping_mul(2_654_435_761).wrapping_mul(seed + 1) >> 8) & 0xffff) / 65536.0;
            let mut soup = TriMesh::default();
            for i in 0..300_u32 {
                let middle = [0, 1, 2].map(|k| spread * value(97 * i + k));
                let corner = |c: u32| Point3::new(
                    middle[0] + value(97 * i + 10 + c), middle[1] + value(97 * i + 20 + c), middle[2] + value(97 * i + 30 + c));
                let t = [0, 1, 2].map(|c| soup.push(corner(c)).unwrap());
                soup.triangles.push(t);
            }
            let all = (0..300).flat_map(|i| (i + 1..300).map(move |j| (i, j)));
            let expected: Vec<[u32; 2]> =
                all.filter_map(|(i, j)| of_pair(&soup, &[], i, j)).map(|i| i.triangles).collect();
            prop_assert_eq!(found(&soup), expected);
        }
    }

    #[test]
    fn a_closed_body_does_not_meet_itself() {
        let vertices = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]];
        assert!(found(&mesh(&vertices, &[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])).is_empty());
        assert!(found(&TriMesh::default()).is_empty());
    }

    #[test]
    fn a_crossing_is_placed_where_it_is() {
        let vertices = [[0., 0., 0.], [4., 0., 0.], [0., 4., 0.], [1., 1., -1.], [1., 1., 1.], [9., 9., 0.5]];
        let crossing = mesh(&vertices, &[[0, 1, 2], [3, 4, 5]]);
        let all = self_intersections(&crossing, &Task::quiet()).unwrap();
        assert_eq!(all.len(), 1);
        let at = all[0].at;
        assert!((at.x - at.y).abs() + at.z.abs() < 1e-12 && (1.0..=2.0).contains(&at.x), "{at}");
    }

    #[test]
    fn neighbours_across_an_edge_are_folded_only_where_they_lie_on_each_other() {
        for (far, folded) in [
            ([0.5, -1.0, 0.0], false),
            ([0.5, 0.7, 0.0], true),
            ([0.5, 0.7, 1e-12], false),
            ([0.5, 0.0, 0.0], false),
        ] {
            let hinge = mesh(&[[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], far], &[[0, 1, 2], [1, 0, 3]]);
            assert_eq!(found(&hinge), if folded { vec![[0, 1]] } else { vec![] }, "{far:?}");
        }
        let doubled = mesh(&[[0., 0., 0.], [1., 0., 0.], [0., 1., 0.]], &[[0, 1, 2], [1, 0, 2]]);
        assert_eq!(found(&doubled), [[0, 1]]);
    }

    #[test]
    fn neighbours_at_a_vertex_may_have_that_vertex_only_in_common() {
        let fan = |a: [f64; 3], b: [f64; 3]| {
            found(&mesh(&[[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], a, b], &[[0, 1, 2], [3, 0, 4]]))
        };
        assert!(fan([-1., 0., 0.], [0., -1., 0.]).is_empty());
        assert!(fan([-1., 0., 1.], [0., -1., -1.]).is_empty());
        assert!(fan([1., 1., 1.], [2., 1., 3.]).is_empty());
        // Through the triangle, and beyond its far edge.
        assert_eq!(fan([0.2, 0.2, 1.], [0.2, 0.2, -1.]), [[0, 1]]);
        assert_eq!(fan([2., 2., 1.], [2., 2., -1.]), [[0, 1]]);
        // In its plane: inside it, over it, along its edge.
        assert_eq!(fan([0.2, 0.1, 0.], [0.1, 0.2, 0.]), [[0, 1]]);
        assert_eq!(fan([3., -1., 0.], [-1., 3., 0.]), [[0, 1]]);
        assert_eq!(fan([0.5, 0., 0.], [0., -1., 0.]), [[0, 1]]);
    }

    #[test]
    fn triangles_that_use_a_vertex_twice_are_passed_over() {
        let vertices = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.]];
        assert!(found(&mesh(&vertices, &[[0, 0, 1], [0, 1, 2], [2, 2, 2]])).is_empty());
    }

    #[test]
    fn a_mesh_that_meets_itself_everywhere_ends_the_search() {
        let flat = [[[0, 0, 0], [5, 0, 0], [0, 5, 0]]; 400];
        assert_eq!(found(&soup(&flat)).len(), MOST_INTERSECTIONS);
    }

    #[test]
    fn the_search_stops_when_asked() {
        let cancel = crate::progress::CancelToken::default();
        cancel.cancel();
        let task = Task::new(&|_, _| {}, cancel);
        assert!(self_intersections(&soup(&[[[0, 0, 0], [5, 0, 0], [0, 5, 0]]]), &task).is_err());
    }
}
