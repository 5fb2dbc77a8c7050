//! Normals, curvature and colours of a mesh's vertices.
//!
//! Curvature is taken from the triangles (Rusinkiewicz, *Estimating Curvatures and Their Derivatives on Triangle Meshes*,
//! 2004): over each triangle the change of the normals along its edges gives a curvature tensor; a vertex gets the mean of
//! those around it, weighted by area. It needs nothing but triangles, so foreign meshes have it too. At edges of the body
//! (rims of caps, creases), where the normal jumps, every side keeps its own normals and the fold itself does not count.

use super::TriMesh;
use super::threemf::Colour;
use crate::geom::Vector3;
use rayon::prelude::*;

/// Neighbouring triangles whose normals turn by more are the two sides of an edge of the body: the cosine of 40 degrees.
const CREASE_COSINE: f64 = 0.766;

/// Normals at the corners of every triangle, smooth across all but the body's edges: means of those of the triangles around,
/// weighted by their angles (Thürrner and Wüthrich, *Computing Vertex Normals from Polygonal Facets*, 1998).
#[must_use]
pub fn corner_normals(mesh: &TriMesh) -> Vec<[Vector3; 3]> {
    let faces: Vec<Vector3> = mesh.triangles.par_iter().map(|t| face_normal(mesh, t)).collect();
    let around = Around::of(mesh);
    let of = |(i, t): (usize, &[u32; 3])| {
        t.map(|v| {
            let near = around.vertex(v).iter().map(|&j| j as usize);
            let smooth = near.filter(|&j| faces[j].dot(&faces[i]) >= CREASE_COSINE);
            let sum: Vector3 = smooth.map(|j| faces[j] * angle_at(mesh, j, v)).sum();
            sum.try_normalize(0.0).unwrap_or(faces[i])
        })
    };
    mesh.triangles.par_iter().enumerate().map(of).collect()
}

fn face_normal(mesh: &TriMesh, t: &[u32; 3]) -> Vector3 {
    let [a, b, c] = t.map(|v| mesh.vertices[v as usize]);
    (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_default()
}

/// Angle of triangle j at one of its vertices.
fn angle_at(mesh: &TriMesh, j: usize, v: u32) -> f64 {
    let t = mesh.triangles[j];
    let k = t.iter().position(|&w| w == v).unwrap_or(0);
    let [at, next, last] = [0, 1, 2].map(|m| mesh.vertices[t[(k + m) % 3] as usize]);
    (next - at).angle(&(last - at))
}

/// The triangles at each vertex.
struct Around {
    start: Vec<u32>,
    triangles: Vec<u32>,
}

impl Around {
    fn of(mesh: &TriMesh) -> Self {
        let mut start = vec![0_u32; mesh.vertices.len() + 1];
        mesh.triangles.iter().flatten().for_each(|&v| start[v as usize + 1] += 1);
        for i in 1..start.len() {
            start[i] += start[i - 1];
        }
        let mut next = start.clone();
        let mut triangles = vec![0; 3 * mesh.triangles.len()];
        for (i, t) in (0_u32..).zip(&mesh.triangles) {
            for &v in t {
                triangles[next[v as usize] as usize] = i;
                next[v as usize] += 1;
            }
        }
        Self { start, triangles }
    }

    fn vertex(&self, v: u32) -> &[u32] {
        &self.triangles[self.start[v as usize] as usize..self.start[v as usize + 1] as usize]
    }
}

/// Mean curvature at the vertices, 1/mm: half the sum of the principal curvatures, positive where the body bulges (a tube of
/// radius r: 1 / 2r; the inside of a wall is negative).
#[must_use]
pub fn mean_curvature(mesh: &TriMesh) -> Vec<f64> {
    let normals = corner_normals(mesh);
    let of = |(t, n): (&[u32; 3], &[Vector3; 3])| triangle_curvature(mesh, t, n);
    let faces: Vec<(f64, f64)> = mesh.triangles.par_iter().zip(&normals).map(of).collect();
    let mut sums = vec![(0.0, 0.0); mesh.vertices.len()];
    for (t, (curvature, area)) in mesh.triangles.iter().zip(faces) {
        for &v in t {
            let sum = &mut sums[v as usize];
            *sum = (sum.0 + area * curvature, sum.1 + area);
        }
    }
    sums.into_iter().map(|(sum, area)| if area > 0.0 { sum / area } else { 0.0 }).collect()
}

/// Mean curvature of a triangle by least squares over its edges, and its area.
fn triangle_curvature(mesh: &TriMesh, t: &[u32; 3], normals: &[Vector3; 3]) -> (f64, f64) {
    let p = t.map(|v| mesh.vertices[v as usize]);
    let doubled_area = (p[1] - p[0]).cross(&(p[2] - p[0]));
    let Some(face) = doubled_area.try_normalize(0.0) else { return (0.0, 0.0) };
    let Some(u) = (p[1] - p[0]).try_normalize(0.0) else { return (0.0, 0.0) };
    let v = face.cross(&u);
    // Along an edge e the normal changes by II e: two equations an edge for the three entries of II.
    let mut normal_matrix = nalgebra::Matrix3::<f64>::zeros();
    let mut right = Vector3::zeros();
    for [i, j] in [[0, 1], [1, 2], [2, 0]] {
        let (e, dn) = (p[j] - p[i], normals[j] - normals[i]);
        let (eu, ev) = (e.dot(&u), e.dot(&v));
        for (row, value) in [(Vector3::new(eu, ev, 0.0), dn.dot(&u)), (Vector3::new(0.0, eu, ev), dn.dot(&v))]
        {
            normal_matrix += row * row.transpose();
            right += row * value;
        }
    }
    let tensor = normal_matrix.cholesky().map(|c| c.solve(&right)).unwrap_or_default();
    (0.5 * (tensor.x + tensor.z), 0.5 * doubled_area.norm())
}

/// A scale of colours: viridis, in which equal steps of the value are equal steps to the eye, colour-blind or not.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColourScale {
    /// Values with the first and the last colour; values beyond have the same.
    pub range: [f64; 2],
}

/// Viridis (van der Walt and Smith, 2015) at equal steps.
const VIRIDIS: [Colour; 10] = [
    [0x44, 0x01, 0x54],
    [0x48, 0x28, 0x78],
    [0x3e, 0x49, 0x89],
    [0x31, 0x68, 0x8e],
    [0x26, 0x82, 0x8e],
    [0x1f, 0x9e, 0x89],
    [0x35, 0xb7, 0x79],
    [0x6e, 0xce, 0x58],
    [0xb5, 0xde, 0x2b],
    [0xfd, 0xe7, 0x25],
];
/// Steps of the scale: more would not be told apart, and a file lists each.
const STEPS: f64 = 64.0;

impl ColourScale {
    /// A scale over nearly all values: a hundredth at either end is left out, so that a spot does not dim all the rest. Its
    /// ends have two digits.
    #[must_use]
    pub fn over(values: &[f64]) -> Self {
        let mut sorted: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let Some(last) = sorted.len().checked_sub(1) else { return Self { range: [0.0, 1.0] } };
        let (low, high) = (sorted[last / 100], sorted[last - last / 100]);
        // A round step, of which the whole range has ten to a hundred.
        let step = 10_f64.powf(((high - low).max(1e-9).log10() - 1.0).floor());
        Self { range: [(low / step).floor() * step, (high / step).ceil() * step] }
    }

    /// The colour of a value.
    #[must_use]
    pub fn colour(&self, value: f64) -> Colour {
        let [low, high] = self.range;
        let part = ((value - low) / (high - low)).clamp(0.0, 1.0);
        let part = if part.is_finite() { (part * STEPS).round() / STEPS } else { 0.0 };
        let scaled = part * (VIRIDIS.len() - 1) as f64;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let i = (scaled as usize).min(VIRIDIS.len() - 2);
        let share = scaled - i as f64;
        [0, 1, 2].map(|k| {
            let mixed = f64::from(VIRIDIS[i][k]) * (1.0 - share) + f64::from(VIRIDIS[i + 1][k]) * share;
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between two bytes")]
            let byte = mixed.round() as u8;
            byte
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Point3;

    /// An open tube of radius r round z, or a ball's zone.
    fn revolved(n: u32, rows: u32, profile: impl Fn(f64) -> (f64, f64)) -> TriMesh {
        let mut mesh = TriMesh::default();
        for j in 0..=rows {
            let (r, z) = profile(f64::from(j) / f64::from(rows));
            for i in 0..n {
                let (s, c) =
                    ((f64::from(i) + 0.5 * f64::from(j)) * std::f64::consts::TAU / f64::from(n)).sin_cos();
                mesh.push(Point3::new(r * c, r * s, z)).unwrap();
            }
        }
        for j in 0..rows {
            for i in 0..n {
                let at = |i: u32, j: u32| j * n + i % n;
                mesh.triangles.extend([
                    [at(i, j), at(i + 1, j), at(i, j + 1)],
                    [at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)],
                ]);
            }
        }
        mesh
    }

    fn inner(mesh: &TriMesh, n: u32, rows: u32) -> std::ops::Range<usize> {
        assert_eq!(mesh.vertices.len(), (n * (rows + 1)) as usize);
        2 * n as usize..(n * (rows - 1)) as usize
    }

    #[test]
    fn a_tube_and_a_ball_have_the_curvature_of_their_radius() {
        let tube = revolved(64, 40, |t| (3.0, 12.0 * t));
        for &h in &mean_curvature(&tube)[inner(&tube, 64, 40)] {
            assert!((h - 1.0 / 6.0).abs() < 2e-3, "{h}");
        }
        let ball = revolved(96, 60, |t| (5.0 * (2.0 * t - 1.0).cos(), 5.0 * (2.0 * t - 1.0).sin()));
        for &h in &mean_curvature(&ball)[inner(&ball, 96, 60)] {
            assert!((h - 0.2).abs() < 4e-3, "{h}");
        }
    }

    #[test]
    fn an_inside_is_hollow_and_a_fold_does_not_count() {
        let mut tube = revolved(64, 20, |t| (3.0, 6.0 * t));
        tube.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        assert!(mean_curvature(&tube)[640..700].iter().all(|h| *h < -0.16));
        // A roof of two planes.
        let p = |x: f64, y: f64, z: f64| Point3::new(x, y, z);
        let roof = TriMesh {
            vertices: vec![
                p(0., 0., 0.),
                p(0., 1., 0.),
                p(1., 0., -2.),
                p(1., 1., -2.),
                p(-1., 0., -2.),
                p(-1., 1., -2.),
            ],
            triangles: vec![[0, 2, 1], [2, 3, 1], [0, 1, 4], [1, 5, 4]],
        };
        assert!(mean_curvature(&roof).iter().all(|h| h.abs() < 1e-12));
        let normals = corner_normals(&roof);
        assert!((normals[0][0].x - 2.0 / 5.0_f64.sqrt()).abs() < 1e-12, "{:?}", normals[0]);
    }

    #[test]
    fn a_scale_goes_from_dark_to_bright_and_has_round_ends() {
        let values: Vec<f64> = (0..1000).map(|i| 0.031 + 0.0004 * f64::from(i)).chain([99.0]).collect();
        let scale = ColourScale::over(&values);
        assert!((scale.range[0] - 0.03).abs() < 1e-12 && (scale.range[1] - 0.43).abs() < 1e-12, "{scale:?}");
        assert_eq!((scale.colour(-1.0), scale.colour(1.0)), (VIRIDIS[0], VIRIDIS[9]));
        let sum = |v: f64| scale.colour(v).iter().map(|&c| u32::from(c)).sum::<u32>();
        assert!(sum(0.1) < sum(0.25) && sum(0.25) < sum(0.4));
        assert_eq!(ColourScale::over(&[]).colour(f64::NAN), VIRIDIS[0]);
        assert!(ColourScale::over(&[2.0; 5]).colour(2.0).len() == 3);
    }
}
