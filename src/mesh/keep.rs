//! The promise of the deflection: every triangle is measured against its surface and split where it is too far off.
//!
//! The surface over a triangle is the image of the triangle in the parameters; together they cover the face. It is sampled
//! on a grid, and the largest distance of a sample from the triangle's plane is raised by what a parabola through
//! its neighbours rises above it. To second order the distance is 4 (a l2 l3 + b l3 l1 + c l1 l2) in barycentric
//! coordinates, with a, b, c the distances in the middles of the edges: where it is, a coarse grid is enough; where it is
//! not, the grid is as fine as the pieces of the spline. Samples that lie beside the triangle, where the parameters
//! run unevenly, are measured to the triangles around it too.

use super::chart::Allowed;
use super::face::Face;
use super::remesh;
use crate::geom::{Point2, Point3, Vector3};
use crate::progress::{Cancelled, Task};
use rayon::prelude::*;

/// Intervals of the coarse grid along a triangle's side, and the fewest where that is not enough.
const COARSE: usize = 4;
const FINE: usize = 8;
/// Pieces of a spline that a triangle may span and still be judged by the coarse grid, where its heights and what they
/// depart from a quadratic function by do not use up the deflection together.
const FEW_PIECES: f64 = 8.0;
/// Share of the deflection that samples may use up: between them it may be a little more.
const SAMPLE_SHARE: f64 = 0.985;
/// Most intervals along a side, and those where other triangles lie nearer to some samples.
const MOST_SAMPLES: usize = 16;
const SAMPLES_BESIDE: usize = 12;
/// Samples of the finest grid.
const GRID: usize = (MOST_SAMPLES + 1) * (MOST_SAMPLES + 2) / 2;
/// Feet may lie so far outside a triangle, as a share of the deflection, and still be taken as inside: the distance grows by
/// half the square of it.
const BESIDE_SHARE: f64 = 0.05;
/// Triangles that a thread measures at once.
const BLOCK: usize = 512;
/// Rounds of moving vertices where triangles were split.
const SMOOTHING_ROUNDS: usize = 2;
/// Passes after which triangles are only halved at their longest edges, which ends on every surface.
const FLIPPING_PASSES: usize = 24;
/// Edges shorter than this share of a triangle's longest are not split.
const LONG: f64 = 0.6;
/// A triangle whose edges are shorter than this share of the deflection keeps it.
const SMALL: f64 = 0.5;
/// Splitting ends where a face gets more than this many times its first triangles and some more: its surface folds.
const MOST_GROWTH: usize = 16;
const SPARE_TRIANGLES: usize = 100_000;
/// Passes over the triangles that changed; each halves the edges that are too far off.
const MOST_PASSES: usize = 60;

/// Splits triangles until every one keeps the deflection, and makes those that changed better again; `false` where the
/// deflection could not be reached.
pub(super) fn keep(face: &mut Face<'_>, allowed: &Allowed<'_>, task: &Task<'_>) -> Result<bool, Cancelled> {
    face.take_changed();
    let all = (0..).take(face.triangles.len()).collect();
    let Some(changed) = keep_from(face, all, allowed, task)? else { return Ok(false) };
    remesh::smooth(face, changed, SMOOTHING_ROUNDS);
    let moved = face.take_changed();
    let open = with_neighbours(face, moved);
    Ok(keep_from(face, open, allowed, task)?.is_some())
}

/// Splits those of the given triangles that do not keep the deflection, and what comes of them; returns what changed.
fn keep_from(
    face: &mut Face<'_>,
    mut open: Vec<u32>,
    allowed: &Allowed<'_>,
    task: &Task<'_>,
) -> Result<Option<Vec<u32>>, Cancelled> {
    let n_most = MOST_GROWTH * face.triangles.len() + SPARE_TRIANGLES;
    let mut all_changed = Vec::new();
    for pass in 0..MOST_PASSES {
        // On a surface that folds, a flip may undo what a split has done.
        face.may_flip = pass < FLIPPING_PASSES;
        let faults = faults(face, &open, allowed, task)?;
        if faults.is_empty() {
            face.may_flip = true;
            all_changed.sort_unstable();
            all_changed.dedup();
            return Ok(Some(all_changed));
        }
        if face.triangles.len() > n_most {
            return Ok(None);
        }
        let changed = divided(face, faults);
        all_changed.extend_from_slice(&changed);
        open = with_neighbours(face, changed);
    }
    Ok(None)
}

/// The triangles that are too far off, each with the edge to split if splitting one helps.
fn faults(
    face: &Face<'_>,
    open: &[u32],
    allowed: &Allowed<'_>,
    task: &Task<'_>,
) -> Result<Vec<(u32, Option<usize>)>, Cancelled> {
    let of_block = |block: &[u32]| {
        task.check()?;
        Ok(block.iter().filter_map(|&t| Some((t, fault(face, t, allowed)?))).collect())
    };
    // Collected in the order of the blocks: the same on any number of threads.
    let blocks: Vec<Result<Vec<_>, Cancelled>> = open.par_chunks(BLOCK).map(of_block).collect();
    Ok(blocks.into_iter().collect::<Result<Vec<_>, _>>()?.concat())
}

/// Splits triangles; returns those that changed.
fn divided(face: &mut Face<'_>, faults: Vec<(u32, Option<usize>)>) -> Vec<u32> {
    let mut touched = vec![false; face.triangles.len()];
    let mut all_changed = Vec::new();
    for (t, edge) in faults {
        // A triangle that was changed in this pass is measured anew in the next one.
        if touched[t as usize] {
            continue;
        }
        if !edge.is_some_and(|i| face.split(t, i)) {
            face.insert(t);
        }
        let changed = face.take_changed();
        touched.resize(face.triangles.len(), false);
        changed.iter().for_each(|&c| touched[c as usize] = true);
        all_changed.extend(changed);
    }
    all_changed
}

/// Triangles and those across their edges, ascending: beside a changed one they may have been measured to what is no
/// longer there.
fn with_neighbours(face: &Face<'_>, mut triangles: Vec<u32>) -> Vec<u32> {
    for k in 0..triangles.len() {
        let t = triangles[k];
        triangles.extend((0..3).filter_map(|i| face.across(t, i)));
    }
    triangles.sort_unstable();
    triangles.dedup();
    triangles
}

/// Whether a triangle is too far off: `Some` with the edge to split, if splitting one helps.
#[expect(clippy::option_option, reason = "no fault, a fault inside, a fault at an edge")]
fn fault(face: &Face<'_>, t: u32, allowed: &Allowed<'_>) -> Option<Option<usize>> {
    let places = face.places(t);
    let params = face.params(t);
    let [a, b, c] = places;
    let longest = (0..3).map(|i| (places[(i + 1) % 3] - places[i]).norm()).fold(0.0, f64::max);
    let allowed_mm = allowed.at(((a.coords + b.coords + c.coords) / 3.0).into());
    // No point over a triangle this small is farther from its corners.
    if longest <= SMALL * allowed_mm {
        return None;
    }
    let limit_mm = SAMPLE_SHARE * allowed_mm;
    let n_pieces = (0..3).map(|i| face.chart.n_pieces(params[i], params[(i + 1) % 3])).fold(0.0, f64::max);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    let n = (n_pieces.ceil() as usize).clamp(COARSE, MOST_SAMPLES);
    let mut found = measured(face, t, if n_pieces <= FEW_PIECES { COARSE } else { n }, limit_mm);
    if let Measured::Near { farthest_mm, rough_mm, is_leaning } = found
        && (is_leaning || farthest_mm + rough_mm > limit_mm)
    {
        // Beside a triangle, the distance changes fast from sample to sample.
        found = measured(face, t, n.max(if is_leaning { SAMPLES_BESIDE } else { FINE }), limit_mm);
    }
    let is_kept = match found {
        Measured::Near { farthest_mm, .. } => farthest_mm <= limit_mm,
        Measured::Off => false,
        Measured::Beside => is_near_others(face, t, n, limit_mm),
    };
    if is_kept {
        return None;
    }
    // The edge that is farthest off, among those that are not short already; at the border there may be none.
    let plane = Plane::through(places);
    let height = |i: usize| {
        let middle = nalgebra::center(&params[(i + 1) % 3], &params[(i + 2) % 3]);
        plane.height(face.chart.at(middle)).abs()
    };
    let length = |i: usize| (places[(i + 1) % 3] - places[(i + 2) % 3]).norm();
    let share = if face.may_flip { LONG } else { 1.0 - 1e-9 };
    let divisible = (0..3).filter(|&i| face.across(t, i).is_some() && length(i) > share * longest);
    Some(divisible.max_by(|&i, &j| height(i).total_cmp(&height(j))))
}

/// What samples of the surface over a triangle show.
enum Measured {
    /// All lie over the triangle or near a neighbour: the farthest point over it, how far heights are from the quadratic
    /// function through those in the middles of the edges, where the grid is coarse, and whether a neighbour was needed.
    Near { farthest_mm: f64, rough_mm: f64, is_leaning: bool },
    /// One is farther off than the limit.
    Off,
    /// Some lie beside the triangle, over others.
    Beside,
}

/// Samples the surface over a triangle, n intervals a side.
fn measured(face: &Face<'_>, t: u32, n: usize, limit_mm: f64) -> Measured {
    let plane = Plane::through(face.places(t));
    let mut heights = [0.0; GRID];
    let (mut is_beside, mut is_leaning) = (false, false);
    // Of the samples, the first, the last one and the last one of the first row are the corners, which lie on the surface.
    let is_corner = |k: usize| k == 0 || k == n || k + 1 == (n + 1) * (n + 2) / 2;
    let inner = heights.iter_mut().zip(grid(face, t, n)).enumerate().filter(|(k, _)| !is_corner(*k));
    let mut near = face.chart.piece(face.params(t)[0]);
    for (_, (height, at)) in inner {
        let p = face.chart.at_near(at, &mut near);
        *height = plane.height(p);
        let (outside_mm, side) = plane.outside(p);
        if outside_mm <= BESIDE_SHARE * limit_mm {
            if height.abs() > limit_mm {
                return Measured::Off;
            }
        } else if to_triangle_mm(p, plane.corners) > limit_mm {
            // The side runs from corner `side` to the next one: opposite to the one before.
            let neighbour = face.across(t, (side + 2) % 3);
            is_leaning = true;
            is_beside |= neighbour.is_none_or(|o| to_triangle_mm(p, face.places(o)) > limit_mm);
        }
    }
    if is_beside {
        return Measured::Beside;
    }
    let rough_mm = if n == COARSE { roughness(&heights) } else { 0.0 };
    Measured::Near { farthest_mm: risen(&heights, n), rough_mm, is_leaning }
}

/// Place of a sample in a grid of n intervals a side.
const fn place(n: usize, i: usize, j: usize) -> usize {
    i * (2 * n + 3 - i) / 2 + j
}

/// How far samples on the coarse grid are from the quadratic function through those in the middles of the sides.
fn roughness(heights: &[f64; GRID]) -> f64 {
    const HALF: usize = COARSE / 2;
    let [a, b, c] = [(HALF, HALF), (0, HALF), (HALF, 0)].map(|(i, j)| heights[place(COARSE, i, j)]);
    let off = |(i, j): (usize, usize)| {
        let [l, m, n] = [COARSE - i - j, i, j].map(|k| k as f64 / COARSE as f64);
        (heights[place(COARSE, i, j)] - 4.0 * (a * m * n + b * n * l + c * l * m)).abs()
    };
    (0..=COARSE).flat_map(|i| (0..=COARSE - i).map(move |j| (i, j))).map(off).fold(0.0, f64::max)
}

/// The same where the surface over a triangle lies beside it, over others, and the distance changes fast from sample to
/// sample.
fn is_near_others(face: &Face<'_>, t: u32, n: usize, limit_mm: f64) -> bool {
    let others: Vec<[Point3; 3]> = face.around(t).into_iter().map(|o| face.places(o)).collect();
    let is_off = |p: Point3| others.iter().all(|o| to_triangle_mm(p, *o) > limit_mm);
    !samples(face, t, n.max(SAMPLES_BESIDE)).any(is_off)
}

/// Points of the surface over a triangle, row by row.
fn samples<'f>(face: &'f Face<'_>, t: u32, n: usize) -> impl Iterator<Item = Point3> + 'f {
    let mut near = face.chart.piece(face.params(t)[0]);
    grid(face, t, n).map(move |at| face.chart.at_near(at, &mut near))
}

/// Parameters over a triangle on a grid of n intervals a side, row by row.
fn grid(face: &Face<'_>, t: u32, n: usize) -> impl Iterator<Item = Point2> + use<> {
    let [a, b, c] = face.params(t);
    let (along, across) = ((b - a) / n as f64, (c - a) / n as f64);
    let rows = (0..=n).flat_map(move |i| (0..=n - i).map(move |j| (i, j)));
    rows.map(move |(i, j)| a + along * i as f64 + across * j as f64)
}

/// The largest magnitude of a function of which samples on a triangle's grid are known, by the parabola through the largest of
/// them and those around it.
fn risen(heights: &[f64; GRID], n: usize) -> f64 {
    let at = |i: usize, j: usize| heights[place(n, i, j)];
    let (mut largest, mut top) = (0.0, (0, 0));
    for i in 0..=n {
        for j in 0..=n - i {
            if at(i, j).abs() > largest {
                (largest, top) = (at(i, j).abs(), (i, j));
            }
        }
    }
    let (i, j) = top;
    let sign = at(i, j).signum();
    // Differences along a line of the grid where it goes on either way.
    let along = |is_inside: bool, before: &dyn Fn() -> f64, after: &dyn Fn() -> f64| {
        is_inside.then(|| {
            let (b, a) = (sign * before(), sign * after());
            (0.5 * (a - b), a + b - 2.0 * largest)
        })
    };
    let k = n - i - j;
    let lines = [
        along(i > 0 && k > 0, &|| at(i - 1, j), &|| at(i + 1, j)),
        along(j > 0 && k > 0, &|| at(i, j - 1), &|| at(i, j + 1)),
        along(i > 0 && j > 0, &|| at(i - 1, j + 1), &|| at(i + 1, j - 1)),
    ];
    largest + rise(lines)
}

/// By how much the parabola rises above its middle sample: along one line at a side, over the plane inside.
fn rise(lines: [Option<(f64, f64)>; 3]) -> f64 {
    let along = |(slope, bend): (f64, f64)| if bend < 0.0 { -0.5 * slope * slope / bend } else { 0.0 };
    let single = lines.iter().flatten().map(|&l| along(l)).fold(0.0, f64::max);
    let [Some((x, xx)), Some((y, yy)), Some((_, zz))] = lines else { return single };
    let xy = 0.5 * (xx + yy - zz);
    let determinant = xx * yy - xy * xy;
    if determinant <= 0.0 {
        return single;
    }
    single.max(-0.5 * (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant)
}

/// The plane of a triangle.
struct Plane {
    corners: [Point3; 3],
    normal: Vector3,
    /// Square to each side in the plane, outward, of length 1.
    outward: [Vector3; 3],
}

impl Plane {
    fn through(corners: [Point3; 3]) -> Self {
        let [a, b, c] = corners;
        let normal = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_default();
        let outward =
            [b - a, c - b, a - c].map(|side| side.cross(&normal).try_normalize(0.0).unwrap_or_default());
        Self { corners, normal, outward }
    }

    fn height(&self, p: Point3) -> f64 {
        (p - self.corners[0]).dot(&self.normal)
    }

    /// How far the foot of p lies outside the triangle's sides, mm (negative inside), and of which; side i begins at
    /// corner i.
    fn outside(&self, p: Point3) -> (f64, usize) {
        let beyond = [0, 1, 2].map(|i| ((p - self.corners[i]).dot(&self.outward[i]), i));
        beyond.into_iter().fold(beyond[0], |most, one| if one.0 > most.0 { one } else { most })
    }
}

/// Largest magnitude over a triangle of the quadratic function that vanishes at its corners and is h\[i\] in the
/// middle of the edge opposite to corner i.
pub(super) fn peak([a, b, c]: [f64; 3]) -> f64 {
    let edges = a.abs().max(b.abs()).max(c.abs());
    let weights = [a * (b + c - a), b * (c + a - b), c * (a + b - c)];
    let sum: f64 = weights.iter().sum();
    let [l, m, n] = weights.map(|w| w / sum);
    // The stationary point, where it lies inside.
    if l > 0.0 && m > 0.0 && n > 0.0 {
        edges.max((4.0 * (a * m * n + b * n * l + c * l * m)).abs())
    } else {
        edges
    }
}

/// Distance of a point from a triangle (Ericson, *Real-Time Collision Detection*, 2005, 5.1.5).
pub(super) fn to_triangle_mm(p: Point3, [a, b, c]: [Point3; 3]) -> f64 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return ap.norm();
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return bp.norm();
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return cp.norm();
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return (ap - ab * (d1 / (d1 - d3).max(f64::MIN_POSITIVE))).norm();
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return (ap - ac * (d2 / (d2 - d6).max(f64::MIN_POSITIVE))).norm();
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let share = (d4 - d3) / ((d4 - d3) + (d5 - d6)).max(f64::MIN_POSITIVE);
        return (bp - (c - b) * share).norm();
    }
    let normal = ab.cross(&ac);
    (ap.dot(&normal) / normal.norm().max(f64::MIN_POSITIVE)).abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_peak_is_the_largest_sample(h in prop::array::uniform3(-1.0..1.0f64)) {
            let mut largest = 0.0f64;
            for i in 0..=60 {
                for j in 0..=60 - i {
                    let (l, m) = (f64::from(i) / 60.0, f64::from(j) / 60.0);
                    let n = 1.0 - l - m;
                    largest = largest.max((4.0 * (h[0] * m * n + h[1] * n * l + h[2] * l * m)).abs());
                }
            }
            let peak = peak(h);
            prop_assert!(peak >= largest - 1e-12 && peak <= largest + 2e-3, "{peak} {largest}");
        }

        #[test]
        fn the_distance_from_a_triangle_is_the_least_of_its_points(
            t in prop::array::uniform9(-1.0..1.0f64), p in prop::array::uniform3(-2.0..2.0f64),
        ) {
            let corner = |i: usize| Point3::new(t[3 * i], t[3 * i + 1], t[3 * i + 2]);
            let [a, b, c] = [corner(0), corner(1), corner(2)];
            let p = Point3::from(p);
            let mut least = f64::INFINITY;
            for i in 0..=80 {
                for j in 0..=80 - i {
                    let q = a + (b - a) * (f64::from(i) / 80.0) + (c - a) * (f64::from(j) / 80.0);
                    least = least.min((p - q).norm());
                }
            }
            let distance = to_triangle_mm(p, [a, b, c]);
            prop_assert!(distance <= least + 1e-12 && distance >= least - 0.05, "{distance} {least}");
        }
    }
}
