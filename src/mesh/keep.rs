//! The promise of the deflection: every triangle is measured against its surface and split where it is too far off.
//!
//! The surface over a triangle is the image of the triangle in the parameters; together they cover the face. Its
//! distance from the triangle's plane vanishes at the corners; to second order it is 4 (a l2 l3 + b l3 l1 + c l1 l2)
//! in barycentric coordinates, with a, b, c the distances in the middles of the edges, so that its largest value
//! inside is known in closed form ([`peak`]). What the centre shows beyond that is added. Where this is not clearly
//! enough, or a triangle spans many pieces of its spline, its points are sampled closely and measured to the
//! triangle and those around it.

use super::chart::Allowed;
use super::face::Face;
use crate::geom::{Point2, Point3};
use crate::progress::{Cancelled, Task};

/// Pieces of a spline that a triangle may span and still be judged by four points.
const FEW_PIECES: f64 = 8.0;
/// Pieces that have no more than one bend, and the share of the deflection that the estimate may use up where there are
/// more.
const ONE_BEND: f64 = 6.5;
const BENDS_SHARE: f64 = 0.85;
/// Samples along a triangle's side where other triangles lie nearer to some of them.
const MANY: u32 = 12;
/// Shares of the allowed deflection that estimate and samples may use up: between samples it may be a little more.
const ESTIMATE_SHARE: f64 = 0.97;
const SAMPLE_SHARE: f64 = 0.985;
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

/// Splits triangles until every one keeps the deflection; `false` where it could not be reached.
pub(super) fn keep(face: &mut Face<'_>, allowed: &Allowed<'_>, task: &Task<'_>) -> Result<bool, Cancelled> {
    face.take_changed();
    let n_most = MOST_GROWTH * face.triangles.len() + SPARE_TRIANGLES;
    let mut open: Vec<u32> = (0..).take(face.triangles.len()).collect();
    for pass in 0..MOST_PASSES {
        task.check()?;
        // On a surface that folds, a flip may undo what a split has done.
        face.may_flip = pass < FLIPPING_PASSES;
        let mut faults = Vec::new();
        for (k, &t) in open.iter().enumerate() {
            if k % 1024 == 0 {
                task.check()?;
            }
            if let Some(fault) = fault(face, t, allowed) {
                faults.push((t, fault));
            }
        }
        if faults.is_empty() {
            face.may_flip = true;
            return Ok(true);
        }
        if face.triangles.len() > n_most {
            return Ok(false);
        }
        let mut touched = vec![false; face.triangles.len()];
        let mut all_changed = Vec::new();
        for (t, fault) in faults {
            // A triangle that was changed in this pass is measured anew in the next one.
            if touched[t as usize] {
                continue;
            }
            if !fault.is_some_and(|i| face.split(t, i)) {
                face.insert(t);
            }
            let changed = face.take_changed();
            touched.resize(face.triangles.len(), false);
            changed.iter().for_each(|&c| touched[c as usize] = true);
            all_changed.extend(changed);
        }
        // Triangles beside a changed one may have been measured to what is no longer there.
        let mut again = all_changed.clone();
        for &t in &all_changed {
            again.extend((0..3).filter_map(|i| face.across(t, i)));
        }
        again.sort_unstable();
        again.dedup();
        open = again;
    }
    Ok(false)
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
    let chart = face.chart;
    let off = Plane::through(places);
    let mut heights = [0.0; 3];
    let mut outside = 0.0f64;
    for (i, height) in heights.iter_mut().enumerate() {
        let middle = nalgebra::center(&params[(i + 1) % 3], &params[(i + 2) % 3]);
        let p = chart.at(middle);
        *height = off.height(p);
        outside = outside.max(off.outside(p));
    }
    let centre = chart.at(((params[0].coords + params[1].coords + params[2].coords) / 3.0).into());
    let beyond = (off.height(centre) - 4.0 / 9.0 * heights.iter().sum::<f64>()).abs();
    let estimate = peak(heights) + 1.5 * beyond;
    let n_pieces = (0..3).map(|i| chart.n_pieces(params[(i + 1) % 3] - params[i])).fold(0.0, f64::max);
    let share = if n_pieces <= ONE_BEND { ESTIMATE_SHARE } else { BENDS_SHARE };
    if estimate <= share * allowed_mm && outside <= 0.25 * allowed_mm && n_pieces <= FEW_PIECES {
        return None;
    }
    let n = if n_pieces <= FEW_PIECES { 6 } else { 12 };
    if is_near(face, t, n, SAMPLE_SHARE * allowed_mm) {
        return None;
    }
    // The edge that is farthest off, among those that are not short already; at the border there may be none.
    let length = |i: usize| (places[(i + 1) % 3] - places[(i + 2) % 3]).norm();
    let share = if face.may_flip { LONG } else { 1.0 - 1e-9 };
    let divisible = (0..3).filter(|&i| face.across(t, i).is_some() && length(i) > share * longest);

    Some(divisible.max_by(|&i, &j| heights[i].abs().total_cmp(&heights[j].abs())))
}

/// Whether sampled points of the surface over a triangle lie within the limit of it or of the triangles around it.
fn is_near(face: &Face<'_>, t: u32, n: u32, limit_mm: f64) -> bool {
    let places = face.places(t);
    // Where the parameters run unevenly the surface over a triangle lies beside it, over others.
    let around = std::cell::OnceCell::new();
    let others = || -> Vec<[Point3; 3]> { face.around(t).into_iter().map(|o| face.places(o)).collect() };
    let is_off = |p: Point3| {
        to_triangle_mm(p, places) > limit_mm
            && around.get_or_init(others).iter().all(|o| to_triangle_mm(p, *o) > limit_mm)
    };
    // Beside it, the distance changes fast from sample to sample.
    !samples(face, t, n).any(is_off) && (around.get().is_none() || !samples(face, t, n.max(MANY)).any(is_off))
}

/// Points of the surface over a triangle.
fn samples<'f>(face: &'f Face<'_>, t: u32, n: u32) -> impl Iterator<Item = Point3> + 'f {
    let params = face.params(t);
    let place = move |i: u32, j: u32| {
        let (s, r) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
        let at: Point2 = params[0] + (params[1] - params[0]) * s + (params[2] - params[0]) * r;
        face.chart.at(at)
    };
    (0..=n).flat_map(move |i| (0..=n - i).map(move |j| place(i, j)))
}

/// The plane of a triangle.
struct Plane {
    corners: [Point3; 3],
    normal: crate::geom::Vector3,
}

impl Plane {
    fn through(corners: [Point3; 3]) -> Self {
        let [a, b, c] = corners;
        Self { corners, normal: (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_default() }
    }

    fn height(&self, p: Point3) -> f64 {
        (p - self.corners[0]).dot(&self.normal)
    }

    /// How far the foot of p lies outside the triangle, mm.
    fn outside(&self, p: Point3) -> f64 {
        (0..3)
            .map(|i| {
                let (s, e) = (self.corners[i], self.corners[(i + 1) % 3]);
                let inward = self.normal.cross(&(e - s));
                -(p - s).dot(&inward) / inward.norm().max(f64::MIN_POSITIVE)
            })
            .fold(0.0, f64::max)
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
