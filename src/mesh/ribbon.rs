//! The strip of triangles between two rows of vertices.

use crate::geom::Point3;

/// A vertex of a row and its parameter along it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Station {
    /// Parameter along the row, in [0, 1).
    pub(super) u: f64,
    /// Parameter across the rows.
    pub(super) v: f64,
    pub(super) vertex: u32,
}

/// Least uprightness of a triangle in the parameters.
const UPRIGHT: f64 = 0.01;
/// Rows whose vertices lie within this share of their extent have them at one parameter.
const LEVEL: f64 = 1e-6;

/// Appends the triangles between two closed rows, both counter-clockwise seen from above, `upper` above `lower`;
/// their normals point outward, and in the parameters none is turned over.
pub(super) fn between_rings(
    lower: &[Station],
    upper: &[Station],
    vertices: &[Point3],
    triangles: &mut Vec<[u32; 3]>,
) {
    // Between the lower row's highest vertex and one of the upper row's lowest nothing is in the way.
    let first = (1..lower.len()).fold(0, |best, k| if lower[k].v > lower[best].v { k } else { best });
    let lower_row = unrolled(lower, first, lower[first].u);
    let offset = |s: &Station| (s.u - lower[first].u + 0.5).rem_euclid(1.0) - 0.5;
    let range = |bounds: [f64; 2], s: &Station| [bounds[0].min(s.v), bounds[1].max(s.v)];
    let [low, high] = upper.iter().fold([f64::INFINITY, f64::NEG_INFINITY], range);
    let nearest = (0..upper.len())
        .filter(|&k| upper[k].v <= low + LEVEL * (high - low))
        .min_by(|&a, &b| offset(&upper[a]).abs().total_cmp(&offset(&upper[b]).abs()))
        .unwrap_or(0);
    let upper_row = unrolled(upper, nearest, lower[first].u + offset(&upper[nearest]));
    let mut strip = by_diagonals(&lower_row, &upper_row, vertices);
    if strip.iter().any(|t| uprightness(t) < UPRIGHT) {
        strip = by_sweeping(&lower_row, &upper_row);
    }
    triangles.extend(strip.iter().map(|t| t.map(|s| s.vertex)));
}

/// The ring as an open row from its vertex `first`, whose parameter is `u`, to the same vertex one period on.
fn unrolled(ring: &[Station], first: usize, u: f64) -> Vec<Station> {
    let turned = ring[first..].iter().chain(&ring[..first]);
    let mut row: Vec<Station> =
        turned.map(|s| Station { u: u + (s.u - ring[first].u).rem_euclid(1.0), ..*s }).collect();
    row.push(Station { u: row[0].u + 1.0, ..row[0] });
    row
}

/// Twice the area of a triangle in the parameters over the product of its extents, negative where it is turned over.
fn uprightness([a, b, c]: &[Station; 3]) -> f64 {
    let (ab, ac) = ([b.u - a.u, b.v - a.v], [c.u - a.u, c.v - a.v]);
    let extents = (ab[0].abs() + ac[0].abs()) * (ab[1].abs() + ac[1].abs());
    (ab[0] * ac[1] - ab[1] * ac[0]) / extents.max(f64::MIN_POSITIVE)
}

/// The triangles between two open rows whose parameters ascend: at each step the row whose next vertex makes the
/// shorter diagonal goes on, unless the other one would fall more than a step behind.
fn by_diagonals(lower: &[Station], upper: &[Station], vertices: &[Point3]) -> Vec<[Station; 3]> {
    let mut triangles = Vec::with_capacity(lower.len() + upper.len());
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
            [lower[i - 1], lower[i], upper[j]]
        } else {
            j += 1;
            [lower[i], upper[j], upper[j - 1]]
        };
        triangles.push(triangle);
    }
    triangles
}

/// The triangles between two open rows whose parameters ascend, whatever their shape, as for every polygon that is
/// monotone in u (Garey, Johnson, Preparata and Tarjan, *Triangulating a simple polygon*, 1978).
fn by_sweeping(lower: &[Station], upper: &[Station]) -> Vec<[Station; 3]> {
    let mut order: Vec<(bool, Station)> =
        lower.iter().map(|s| (false, *s)).chain(upper.iter().map(|s| (true, *s))).collect();
    order.sort_by(|a, b| a.1.u.total_cmp(&b.1.u));
    let mut triangles = Vec::with_capacity(order.len());
    let mut stack: Vec<(bool, Station)> = Vec::new();
    let n = order.len();
    for (k, (is_upper, s)) in order.into_iter().enumerate() {
        // Two that follow each other on the upper row run the other way round.
        let triangle = |from: Station, to: Station, on_upper: bool| {
            if on_upper { [s, to, from] } else { [from, to, s] }
        };
        match stack.last().copied() {
            Some(top) if top.0 != is_upper => {
                triangles.extend(stack.windows(2).map(|p| triangle(p[0].1, p[1].1, top.0)));
                stack = vec![top];
            }
            _ => {
                while let [.., (_, from), (_, to)] = stack[..] {
                    let found = triangle(from, to, is_upper);
                    if uprightness(&found) <= 1e-9 && k + 1 < n {
                        break;
                    }
                    triangles.push(found);
                    stack.pop();
                }
            }
        }
        stack.push((is_upper, s));
    }
    triangles
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ring(shares: &[f64], lift: f64, step: f64) -> Vec<Station> {
        let whole: f64 = shares.iter().sum();
        let mut u = 0.0;
        let station = |(k, share): (usize, &f64)| {
            u += share / whole;
            let v = lift + if k % 2 == 0 { step } else { 0.0 };
            Station { u: u.rem_euclid(1.0), v, vertex: u32::try_from(k).unwrap() }
        };
        shares.iter().enumerate().map(station).collect()
    }

    proptest! {
        #[test]
        fn strips_between_rings_cover_the_parameters_once(
            a in prop::collection::vec(0.001..1.0f64, 4..40),
            b in prop::collection::vec(0.001..1.0f64, 3..20),
            upside in any::<bool>(),
        ) {
            // The second ring zigzags: an even number of vertices.
            let b: Vec<f64> = b.iter().chain(&b).copied().collect();
            let (flat, zigzag) = (ring(&a, 0.0, 0.0), ring(&b, if upside { -1.0 } else { 0.5 }, 0.5));
            let (lower, upper) = if upside { (&zigzag, &flat) } else { (&flat, &zigzag) };
            let first = (0..lower.len()).fold(0, |m, k| if lower[k].v > lower[m].v { k } else { m });
            let lowest = (0..upper.len()).fold(0, |m, k| if upper[k].v < upper[m].v { k } else { m });
            let rows = [unrolled(lower, first, 0.0), unrolled(upper, lowest, 0.0)];
            let strip = by_sweeping(&rows[0], &rows[1]);
            prop_assert_eq!(strip.len(), a.len() + b.len());
            let area = |t: &[Station; 3]| {
                0.5 * ((t[1].u - t[0].u) * (t[2].v - t[0].v) - (t[1].v - t[0].v) * (t[2].u - t[0].u))
            };
            prop_assert!(strip.iter().all(|t| area(t) >= -1e-9));
            let below = |row: &[Station]| {
                row.windows(2).map(|p| 0.5 * (p[1].u - p[0].u) * (p[0].v + p[1].v)).sum::<f64>()
            };
            let expected = below(&rows[1]) - below(&rows[0]);
            prop_assert!((strip.iter().map(area).sum::<f64>() - expected).abs() < 1e-9);
        }
    }
}
