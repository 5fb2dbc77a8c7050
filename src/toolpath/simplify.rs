//! Fewer vertices for the same line: Douglas and Peucker's method, for outlines and for paths with a width.

use crate::geom::{Contour, Point2, Vector2, Vector3};

/// A corner that turns by more than this is one, and no bend, rad (20 degrees).
const SHARP_RAD: f64 = 0.35;

/// The contour with as few of its vertices as keep it within `tolerance_mm`.
pub(super) fn contour(contour: &Contour, tolerance_mm: f64) -> Contour {
    let mut points: Vec<Vector3> = contour.points.iter().map(|p| Vector3::new(p.x, p.y, 0.0)).collect();
    let Some(&first) = points.first() else { return contour.clone() };
    points.push(first);
    let mut kept = keep(&points, tolerance_mm);
    kept.pop();
    Contour::new(kept.into_iter().map(|i| Point2::new(points[i].x, points[i].y)).collect())
}

/// Indices of the vertices to keep, first and last among them. The line may be closed (first = last).
pub(super) fn keep(points: &[Vector3], tolerance: f64) -> Vec<usize> {
    let mut kept = vec![false; points.len()];
    let Some(last) = points.len().checked_sub(1) else { return Vec::new() };
    (kept[0], kept[last]) = (true, true);
    let mut open = vec![(0, last)];
    while let Some((from, to)) = open.pop() {
        let farthest = (from + 1..to)
            .map(|i| (i, distance_squared(points[i], points[from], points[to])))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((i, d2)) = farthest
            && d2 > tolerance * tolerance
        {
            kept[i] = true;
            open.extend([(from, i), (i, to)]);
        }
    }
    (0..points.len()).filter(|&i| kept[i]).collect()
}

/// How far each kept vertex has to move so that the shorter line encloses what the longer one did.
///
/// Chords of a bend lie on its inner side, all of them: a loop would shrink by two thirds of the tolerance. Every
/// vertex takes half of what its two chords cut off. Sharp corners and ends stay. `is_closed`: the last vertex is the first.
pub(super) fn area_keeping(points: &[Vector3], kept: &[usize], is_closed: bool) -> Vec<Vector2> {
    let chords: Vec<Chord> = kept.windows(2).map(|k| Chord::of(&points[k[0]..=k[1]])).collect();
    let n = chords.len();
    let at = |k: usize| {
        let before = k.checked_sub(1).or(is_closed.then(|| n.wrapping_sub(1)));
        let after = if k < n { Some(k) } else { is_closed.then_some(0) };
        let (before, after) = (chords.get(before?)?, chords.get(after?)?);
        let turn = before.along.angle(&after.along);
        let length = before.along.norm() + after.along.norm();
        (turn < SHARP_RAD && length > 0.0).then(|| {
            let along = (before.along + after.along) / length;
            Vector2::new(along.y, -along.x) * ((before.cut_mm2 + after.cut_mm2) / length)
        })
    };
    (0..kept.len()).map(|k| at(k).unwrap_or_default()).collect()
}

/// A straight piece in place of a run of vertices.
struct Chord {
    along: Vector2,
    /// The area between the two, positive where the run lies to the chord's right, mm².
    cut_mm2: f64,
}

impl Chord {
    fn of(run: &[Vector3]) -> Self {
        let from = run[0].xy();
        let cross = |p: &[Vector3]| (p[0].xy() - from).perp(&(p[1].xy() - from));
        Self { along: run[run.len() - 1].xy() - from, cut_mm2: 0.5 * run.windows(2).map(cross).sum::<f64>() }
    }
}

fn distance_squared(p: Vector3, a: Vector3, b: Vector3) -> f64 {
    let along = b - a;
    let t = ((p - a).dot(&along) / along.norm_squared().max(1e-18)).clamp(0.0, 1.0);
    (p - a - along * t).norm_squared()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn straight_runs_lose_their_inner_vertices() {
        let square =
            Contour::new([(0., 0.), (4., 0.), (4., 4.), (0., 4.)].map(|(x, y)| Point2::new(x, y)).into());
        assert_eq!(contour(&square.resampled(64), 1e-6).len(), 4);
    }

    #[test]
    fn a_loop_keeps_its_area_and_its_corners() {
        let closed = |contour: &Contour| -> Vec<Vector3> {
            let around = contour.points.iter().chain(contour.points.first());
            around.map(|p| Vector3::new(p.x, p.y, 0.0)).collect()
        };
        let area =
            |points: &[Vector3]| 0.5 * points.windows(2).map(|p| p[0].xy().perp(&p[1].xy())).sum::<f64>();
        let shorter = |points: &[Vector3], tolerance: f64| -> (Vec<usize>, Vec<Vector3>) {
            let kept = keep(points, tolerance);
            let shifts = area_keeping(points, &kept, true);
            let moved = kept.iter().zip(&shifts).map(|(&k, s)| points[k] + Vector3::new(s.x, s.y, 0.0));
            (kept.clone(), moved.collect())
        };
        let circle = closed(&Contour::circle(Point2::new(1.0, 2.0), 3.0, 2000));
        for circle in [circle.clone(), circle.into_iter().rev().collect()] {
            let (kept, moved) = shorter(&circle, 2e-3);
            assert!(kept.len() < 200 && moved.first() == moved.last());
            assert!((area(&moved) / area(&circle) - 1.0).abs() < 2e-6, "{}", area(&moved) / area(&circle));
            let off = |p: &Vector3| ((p.xy() - Vector2::new(1.0, 2.0)).norm() - 3.0).abs();
            assert!(moved.iter().map(off).fold(0.0, f64::max) < 2e-3);
        }
        let square =
            Contour::new([(0., 0.), (4., 0.), (4., 4.), (0., 4.)].map(|(x, y)| Point2::new(x, y)).into());
        let square = closed(&square.resampled(64));
        let (kept, moved) = shorter(&square, 1e-6);
        assert!(kept.iter().zip(&moved).all(|(&k, p)| square[k] == *p));
    }

    #[test]
    fn circle_keeps_its_shape() {
        let circle = Contour::circle(Point2::origin(), 3.0, 2000);
        let fewer = contour(&circle, 1e-3);
        assert!(fewer.len() < 200);
        assert!((fewer.signed_area_mm2() / circle.signed_area_mm2() - 1.0).abs() < 1e-3);
    }
}
