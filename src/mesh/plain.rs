//! Vertices at which triangles cannot meet each other but in the vertex and edges they share.
//!
//! In a closed mesh the triangles round a vertex make one or more closed fans. Seen against the mean of their normals, if all
//! face the viewer, each fan covers every direction from the vertex at least once; if some direction is covered by one triangle
//! only, there is one fan and it goes round once. Then no triangle hides another, and none meets another.
//!
//! What it does not do: say anything of vertices at which some triangle is seen nearly edge on, or of open meshes.

use super::TriMesh;
use crate::geom::Vector3;
use rayon::prelude::*;

/// Least cosine between a triangle's normal and the mean: far above rounding.
const FACING: f64 = 0.1;
/// Least sine of an angle of a triangle whose normal is believed.
const LEAST_SINE: f64 = 1e-6;

/// What is known of a vertex.
#[derive(Debug, Clone, Copy)]
struct Star {
    /// Sum of the unit normals.
    normal: Vector3,
    /// Square to it; zero where a triangle turned out not to face the viewer.
    across: Vector3,
    /// Triangles that cover the direction square to both.
    n_covering: u32,
}

/// Which vertices of a closed mesh are plain.
pub(super) fn vertices(mesh: &TriMesh) -> Vec<bool> {
    let normals: Vec<Option<Vector3>> = mesh.triangles.par_iter().map(|t| normal(mesh, t)).collect();
    let none = Star { normal: Vector3::zeros(), across: Vector3::zeros(), n_covering: 0 };
    let mut stars = vec![none; mesh.vertices.len()];
    for (t, normal) in mesh.triangles.iter().zip(&normals) {
        t.iter().for_each(|&v| stars[v as usize].normal += normal.unwrap_or_default());
    }
    stars.par_iter_mut().for_each(|star| {
        let normal = star.normal.try_normalize(0.0).unwrap_or_default();
        // Square to the normal, and far from parallel to the axis it is made with.
        let axis = if normal.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
        (star.normal, star.across) = (normal, normal.cross(&axis));
    });
    for (t, normal) in mesh.triangles.iter().zip(&normals) {
        let places = t.map(|v| mesh.vertices[v as usize]);
        for k in 0..3 {
            let star = &mut stars[t[k] as usize];
            let [first, last] = [(k + 1) % 3, (k + 2) % 3].map(|i| (places[i] - places[k]).dot(&star.across));
            star.n_covering += u32::from(first <= 0.0 && last > 0.0);
            if normal.is_none_or(|n| n.dot(&star.normal) < FACING) {
                // Counted twice, it is never plain.
                star.n_covering += 2;
            }
        }
    }
    stars.into_iter().map(|star| star.n_covering == 1).collect()
}

/// Unit normal of a triangle; `None` of a needle.
fn normal(mesh: &TriMesh, t: &[u32; 3]) -> Option<Vector3> {
    let [a, b, c] = t.map(|v| mesh.vertices[v as usize]);
    let (ab, ac) = (b - a, c - a);
    let longest_squared = ab.norm_squared().max(ac.norm_squared()).max((c - b).norm_squared());
    ab.cross(&ac).try_normalize(LEAST_SINE * longest_squared)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Point3;

    /// A double cone over a ring of points round the z axis that goes round `turns` times.
    fn double_cone(n: u32, turns: f64, height: f64) -> TriMesh {
        let mut mesh = TriMesh::default();
        for k in 0..n {
            let (s, c) = (std::f64::consts::TAU * turns * f64::from(k) / f64::from(n)).sin_cos();
            mesh.push(Point3::new(c, s, 0.02 * f64::from(k % 2))).unwrap();
        }
        let (top, bottom) = (n, n + 1);
        mesh.push(Point3::new(0.0, 0.0, height)).unwrap();
        mesh.push(Point3::new(0.0, 0.0, -height)).unwrap();
        for k in 0..n {
            let next = (k + 1) % n;
            mesh.triangles.extend([[top, k, next], [bottom, next, k]]);
        }
        mesh
    }

    #[test]
    fn the_tip_of_a_cone_is_plain_unless_the_cone_is_sharp_or_goes_round_twice() {
        let tip = |turns: f64, height: f64| vertices(&double_cone(14, turns, height))[14];
        assert!(tip(1.0, 0.5));
        assert!(!tip(1.0, 50.0));
        assert!(!tip(2.0, 0.5));
    }

    #[test]
    fn a_triangle_that_is_folded_over_makes_its_corners_not_plain() {
        let mut mesh = double_cone(14, 1.0, 0.5);
        // Over the tip to the other side.
        mesh.vertices[0] = Point3::new(-1.5, 0.0, 0.0);
        assert!(!vertices(&mesh)[14]);
    }
}
