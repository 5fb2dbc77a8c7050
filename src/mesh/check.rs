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

/// Counts the faults of a mesh's edges. O(n): edges are sorted by their lower vertex by counting, and few share it.
#[must_use]
pub fn closedness(mesh: &TriMesh) -> Closedness {
    let sides = |&[a, b, c]: &[u32; 3]| [(a, b), (b, c), (c, a)];
    let mut found = Closedness::default();
    let mut start = vec![0_usize; mesh.vertices.len() + 1];
    for t in &mesh.triangles {
        found.degenerate += usize::from(t[0] == t[1] || t[1] == t[2] || t[2] == t[0]);
        sides(t).into_iter().for_each(|(s, e)| start[s.min(e) as usize + 1] += 1);
    }
    for v in 1..start.len() {
        start[v] += start[v - 1];
    }
    let mut free = start.clone();
    let mut edges = vec![(0, false); 3 * mesh.triangles.len()];
    for (s, e) in mesh.triangles.iter().flat_map(sides) {
        let slot = &mut free[s.min(e) as usize];
        edges[*slot] = (s.max(e), s < e);
        *slot += 1;
    }
    for range in start.windows(2) {
        let at_vertex = &mut edges[range[0]..range[1]];
        at_vertex.sort_unstable();
        at_vertex.chunk_by(|x, y| x.0 == y.0).for_each(|uses| found.count(uses));
    }
    found
}

impl Closedness {
    /// Adds the uses of one edge: the other vertex and the direction.
    fn count(&mut self, uses: &[(u32, bool)]) {
        match uses {
            [_] => self.free += 1,
            [x, y] => self.misoriented += usize::from(x.1 == y.1),
            _ => self.non_manifold += 1,
        }
    }
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
