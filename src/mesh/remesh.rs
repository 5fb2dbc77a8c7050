//! Better triangles inside a border that stays: splits of long edges, flips, and moves of inner vertices.
//!
//! Botsch and Kobbelt, *A remeshing approach to multiresolution modeling*, 2004, without collapses: it starts with
//! no inner vertices at all.

use super::face::Face;
use crate::geom::Point3;
use crate::progress::{Cancelled, Task};

/// Edges longer than this many local sizes are split: the halves are then nearer to the size than the whole was.
const SPLIT_ABOVE: f64 = 1.4;
/// How fast the size grows with the distance from the border.
const GROWTH: f64 = 0.35;
/// While edges are longer than this many sizes, a triangle may hide a bend of the surface: its shape is judged in the
/// parameters.
const UNBENT: f64 = 4.0;
/// Rounds of splitting; each halves the longest edges.
const MOST_ROUNDS: usize = 12;
/// Sine of the smallest angle below which the vertices of a triangle are moved (42 degrees).
const GOOD_SINE: f64 = 0.669;

/// The size of triangles inside a border: near it its own edges, growing with the distance from them.
pub(super) struct Size {
    /// Middles and lengths of the border's edges.
    edges: Vec<(Point3, f64)>,
}

impl Size {
    /// From the border of a face.
    pub(super) fn of_border(face: &Face<'_>) -> Self {
        let mut edges = Vec::new();
        for t in (0..).take(face.triangles.len()) {
            let places = face.places(t);
            for i in (0..3).filter(|&i| face.across(t, i).is_none()) {
                let (a, b) = (places[(i + 1) % 3], places[(i + 2) % 3]);
                edges.push((nalgebra::center(&a, &b), (b - a).norm()));
            }
        }
        Self { edges }
    }

    fn at(&self, p: Point3) -> f64 {
        self.edges.iter().map(|(m, l)| l + GROWTH * (p - m).norm()).fold(f64::INFINITY, f64::min)
    }
}

/// Fills a face that has only border vertices with triangles of the given size.
pub(super) fn fill(face: &mut Face<'_>, size: &Size, task: &Task<'_>) -> Result<(), Cancelled> {
    face.plane = face.chart.unit_lengths();
    face.flip_everywhere();
    for _ in 0..MOST_ROUNDS {
        task.check()?;
        let mut long = Vec::new();
        for t in (0..).take(face.triangles.len()) {
            let places = face.places(t);
            for i in 0..3 {
                let (a, b) = (places[(i + 1) % 3], places[(i + 2) % 3]);
                if face.across(t, i).is_some_and(|o| o > t) {
                    let ratio = (b - a).norm() / size.at(nalgebra::center(&a, &b));
                    if ratio > SPLIT_ABOVE {
                        long.push((ratio, t, i));
                    }
                }
            }
        }
        if long.is_empty() {
            break;
        }
        let longest = long.iter().map(|l| l.0).fold(0.0, f64::max);
        face.plane = face.plane.filter(|_| longest > UNBENT);
        long.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut touched = vec![false; face.triangles.len()];
        for (_, t, i) in long {
            if touched[t as usize] {
                continue;
            }
            face.take_changed();
            face.split(t, i);
            touched.resize(face.triangles.len(), false);
            face.take_changed().iter().for_each(|&c| touched[c as usize] = true);
        }
        if face.plane.is_none() {
            smooth_everywhere(face, 2);
        }
    }
    face.plane = None;
    face.flip_everywhere();
    smooth_everywhere(face, 4);
    Ok(())
}

/// Moves the inner vertices of triangles with small angles, all over the face, and flips edges, some times over.
pub(super) fn smooth_everywhere(face: &mut Face<'_>, rounds: usize) {
    smooth(face, (0..).take(face.triangles.len()).collect(), rounds);
}

/// The same for some triangles, and those round what was moved.
pub(super) fn smooth(face: &mut Face<'_>, mut triangles: Vec<u32>, rounds: usize) {
    for _ in 0..rounds {
        let poor = triangles.iter().filter(|&&t| face.least_sine(t) < GOOD_SINE);
        let mut vertices: Vec<u32> = poor.flat_map(|&t| face.triangles[t as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        triangles.clear();
        for v in vertices {
            if face.smooth(v) {
                let star = face.star(v);
                face.flip_all(star.iter().copied());
                triangles.extend(star);
            }
        }
        if triangles.is_empty() {
            return;
        }
        triangles.sort_unstable();
        triangles.dedup();
    }
}
