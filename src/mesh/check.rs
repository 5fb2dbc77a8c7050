//! Whether a mesh is closed: every edge is used once in each direction.

use super::TriMesh;

/// Faults of a mesh's edges.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Closedness {
    /// Edges used by one triangle only.
    pub free: usize,
    /// Edges used by more than two triangles.
    pub non_manifold: usize,
    /// Edges that two triangles use in the same direction.
    pub misoriented: usize,
    /// Triangles that use a vertex twice.
    pub degenerate: usize,
}

impl Closedness {
    /// Whether there is no fault.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        *self == Self::default()
    }
}

impl std::fmt::Display for Closedness {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} free, {} non-manifold, {} misoriented edges, {} degenerate triangles",
            self.free, self.non_manifold, self.misoriented, self.degenerate
        )
    }
}

/// Counts the faults of a mesh's edges. O(n log n).
#[must_use]
pub fn closedness(mesh: &TriMesh) -> Closedness {
    let mut found = Closedness::default();
    let mut edges: Vec<(u32, u32, bool)> = Vec::with_capacity(3 * mesh.triangles.len());
    for &[a, b, c] in &mesh.triangles {
        found.degenerate += usize::from(a == b || b == c || c == a);
        edges.extend([(a, b), (b, c), (c, a)].map(|(s, e)| (s.min(e), s.max(e), s < e)));
    }
    edges.sort_unstable();
    for uses in edges.chunk_by(|x, y| (x.0, x.1) == (y.0, y.1)) {
        match uses {
            [_] => found.free += 1,
            [x, y] => found.misoriented += usize::from(x.2 == y.2),
            _ => found.non_manifold += 1,
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Point3;

    fn tetrahedron() -> TriMesh {
        TriMesh {
            vertices: vec![
                Point3::origin(),
                Point3::new(1., 0., 0.),
                Point3::new(0., 1., 0.),
                Point3::new(0., 0., 1.),
            ],
            triangles: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
        }
    }

    #[test]
    fn a_tetrahedron_is_closed_and_each_fault_is_counted() {
        let closed = tetrahedron();
        assert!(closedness(&closed).is_closed());
        assert!((closed.volume_mm3() - 1.0 / 6.0).abs() < 1e-12);
        let mut open = tetrahedron();
        open.triangles.pop();
        assert_eq!(closedness(&open).free, 3);
        let mut turned = tetrahedron();
        turned.triangles[1].swap(0, 1);
        assert_eq!(closedness(&turned).misoriented, 3);
        let mut doubled = tetrahedron();
        doubled.triangles.push([0, 2, 1]);
        assert_eq!(closedness(&doubled).non_manifold, 3);
    }
}
