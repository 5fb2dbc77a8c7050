//! A closed mesh to its bodies: each an outer shell with the closed voids inside it.
//!
//! Triangles that share vertices make a shell. A shell that encloses a negative volume faces inward, so it bounds a void;
//! it belongs to the smallest outer shell round it, found by the winding number of one of its vertices (van Oosterom
//! and Strackee, *The Solid Angle of a Plane Triangle*, 1983).

use super::TriMesh;
use crate::geom::Point3;

/// Splits a closed mesh into bodies, in the order of their first triangles; vertices that no triangle uses are left out.
#[must_use]
pub fn bodies(mesh: &TriMesh) -> Vec<TriMesh> {
    let shells = shells(mesh);
    let volume: Vec<f64> = shells.iter().map(TriMesh::volume_mm3).collect();
    let is_outer = |k: &usize| volume[*k] >= 0.0;
    // Which body a shell is part of, by the number of the body's outer shell.
    let owner: Vec<usize> = (0..shells.len())
        .map(|k| {
            if is_outer(&k) {
                return k;
            }
            let inside = |&j: &usize| is_outer(&j) && contains(&shells[j], shells[k].vertices[0]);
            let round = (0..shells.len()).filter(inside).min_by(|&a, &b| volume[a].total_cmp(&volume[b]));
            // Inside nothing it would be a body turned inside out: it is kept for itself, and for others to refuse.
            round.unwrap_or(k)
        })
        .collect();
    (0..shells.len()).filter(|&k| owner[k] == k).map(|k| joined(&shells, &owner, k)).collect()
}

/// All shells of a body as one mesh.
fn joined(shells: &[TriMesh], owner: &[usize], body: usize) -> TriMesh {
    let mut mesh = TriMesh::default();
    for (shell, _) in shells.iter().zip(owner).filter(|(_, o)| **o == body) {
        #[expect(
            clippy::cast_possible_truncation,
            reason = "together as many vertices as the mesh they come from"
        )]
        let offset = mesh.vertices.len() as u32;
        mesh.vertices.extend_from_slice(&shell.vertices);
        mesh.triangles.extend(shell.triangles.iter().map(|t| t.map(|v| v + offset)));
    }
    mesh
}

/// Triangles that hang together, each group with its own vertices.
fn shells(mesh: &TriMesh) -> Vec<TriMesh> {
    const NONE: u32 = u32::MAX;
    let mut parent: Vec<u32> = (0..).take(mesh.vertices.len()).collect();
    for &[a, b, c] in &mesh.triangles {
        let root = find(&mut parent, a);
        for other in [b, c] {
            let other = find(&mut parent, other);
            parent[other as usize] = root;
        }
    }
    let mut shell_of = vec![usize::MAX; mesh.vertices.len()];
    let mut place = vec![NONE; mesh.vertices.len()];
    let mut shells: Vec<TriMesh> = Vec::new();
    for t in &mesh.triangles {
        let root = find(&mut parent, t[0]) as usize;
        if shell_of[root] == usize::MAX {
            shell_of[root] = shells.len();
            shells.push(TriMesh::default());
        }
        let shell = &mut shells[shell_of[root]];
        let corners = t.map(|v| {
            if place[v as usize] == NONE {
                #[expect(clippy::cast_possible_truncation, reason = "no more vertices than the whole mesh")]
                let next = shell.vertices.len() as u32;
                place[v as usize] = next;
                shell.vertices.push(mesh.vertices[v as usize]);
            }
            place[v as usize]
        });
        shell.triangles.push(corners);
    }
    shells
}

/// The representative of a vertex; the path to it is halved on the way.
fn find(parent: &mut [u32], mut v: u32) -> u32 {
    while parent[v as usize] != v {
        parent[v as usize] = parent[parent[v as usize] as usize];
        v = parent[v as usize];
    }
    v
}

/// Whether a point lies inside a closed shell.
fn contains(shell: &TriMesh, p: Point3) -> bool {
    let angle = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| shell.vertices[v as usize] - p);
        let (la, lb, lc) = (a.norm(), b.norm(), c.norm());
        let below = la * lb * lc + a.dot(&b) * lc + b.dot(&c) * la + c.dot(&a) * lb;
        2.0 * a.dot(&b.cross(&c)).atan2(below)
    };
    shell.triangles.iter().map(angle).sum::<f64>() > std::f64::consts::TAU
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tetrahedron, turned inside out where it bounds a void.
    fn tetrahedron(mesh: &mut TriMesh, at: f64, size: f64, is_void: bool) {
        let corner = |x: f64, y: f64, z: f64| Point3::new(at + size * x, size * y, size * z);
        let [a, b, c, d] =
            [corner(-1., -1., -1.), corner(3., -1., -1.), corner(-1., 3., -1.), corner(-1., -1., 3.)]
                .map(|p| mesh.push(p).unwrap());
        for t in [[a, c, b], [a, b, d], [b, c, d], [c, a, d]] {
            mesh.triangles.push(if is_void { [t[0], t[2], t[1]] } else { t });
        }
    }

    #[test]
    fn voids_go_with_the_smallest_body_round_them() {
        let mut mesh = TriMesh::default();
        tetrahedron(&mut mesh, 0.0, 0.1, true);
        tetrahedron(&mut mesh, 0.0, 5.0, false);
        tetrahedron(&mut mesh, 0.0, 3.0, true);
        tetrahedron(&mut mesh, 0.0, 1.0, false);
        tetrahedron(&mut mesh, 100.0, 1.0, false);
        mesh.vertices.push(Point3::origin());
        let found: Vec<(usize, usize)> =
            bodies(&mesh).iter().map(|b| (b.vertices.len(), b.triangles.len())).collect();
        assert_eq!(found, [(8, 8), (8, 8), (4, 4)]);
        let whole: f64 = bodies(&mesh).iter().map(TriMesh::volume_mm3).sum();
        assert!((whole - mesh.volume_mm3()).abs() < 1e-9);
        assert!(bodies(&TriMesh::default()).is_empty());
    }
}
