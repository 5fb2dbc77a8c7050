//! The strip of triangles between two rows of vertices.

use crate::geom::Point3;

/// A vertex of a row and its parameter along it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Station {
    /// Parameter along the row, in [0, 1).
    pub(super) u: f64,
    pub(super) vertex: u32,
}

/// Appends the triangles between two closed rows, both counter-clockwise seen from above, `upper` above `lower`;
/// their normals point outward.
pub(super) fn between_rings(
    lower: &[Station],
    upper: &[Station],
    vertices: &[Point3],
    triangles: &mut Vec<[u32; 3]>,
) {
    // Both rings begin near the parameter of the lower ring's first vertex; parameters are made to ascend from there.
    let origin = lower[0].u;
    let offset = |s: &Station| (s.u - origin).rem_euclid(1.0);
    let lower_row: Vec<Station> = unrolled(lower, |s| offset(s));
    let centred = |s: &Station| {
        let o = offset(s);
        if o > 0.5 { o - 1.0 } else { o }
    };
    let nearest = (0..upper.len())
        .min_by(|&a, &b| centred(&upper[a]).abs().total_cmp(&centred(&upper[b]).abs()))
        .unwrap_or(0);
    let first = centred(&upper[nearest]);
    let turned: Vec<Station> = upper[nearest..].iter().chain(&upper[..nearest]).copied().collect();
    let upper_row = unrolled(&turned, |s| first + (s.u - turned[0].u).rem_euclid(1.0));
    between_rows(&lower_row, &upper_row, vertices, false, triangles);
}

/// The ring as an open row that ends in its first vertex again, one period on.
fn unrolled(ring: &[Station], u: impl Fn(&Station) -> f64) -> Vec<Station> {
    let mut row: Vec<Station> = ring.iter().map(|s| Station { u: u(s), vertex: s.vertex }).collect();
    row.push(Station { u: row[0].u + 1.0, vertex: row[0].vertex });
    row
}

/// Appends the triangles between two open rows whose parameters ascend: at each step the row whose next vertex
/// makes the shorter diagonal goes on, unless the other one would fall more than a step behind. Normals point to the
/// right of the rows' direction with `upper` upward, with `flip` to the left.
pub(super) fn between_rows(
    lower: &[Station],
    upper: &[Station],
    vertices: &[Point3],
    flip: bool,
    triangles: &mut Vec<[u32; 3]>,
) {
    let place = |s: &Station| vertices[s.vertex as usize];
    let (mut i, mut j) = (0, 0);
    while i + 1 < lower.len() || j + 1 < upper.len() {
        let advance_lower = match (lower.get(i + 1), upper.get(j + 1)) {
            (Some(_), None) => true,
            (None, _) => false,
            (Some(l), Some(u)) => {
                let by_lower = (place(l) - place(&upper[j])).norm();
                let by_upper = (place(u) - place(&lower[i])).norm();
                let behind = l.u + (l.u - lower[i].u) < u.u;
                let ahead = u.u + (u.u - upper[j].u) < l.u;
                behind || (!ahead && by_lower <= by_upper)
            }
        };
        let triangle = if advance_lower {
            i += 1;
            [lower[i - 1].vertex, lower[i].vertex, upper[j].vertex]
        } else {
            j += 1;
            [lower[i].vertex, upper[j].vertex, upper[j - 1].vertex]
        };
        // Rows that meet in a point (the corners of a slab) leave triangles without area.
        if triangle[0] != triangle[1] && triangle[1] != triangle[2] && triangle[2] != triangle[0] {
            triangles.push(if flip { [triangle[0], triangle[2], triangle[1]] } else { triangle });
        }
    }
}
