//! Fewer vertices for the same line: Douglas and Peucker's method, for outlines and for paths with a width.

use crate::geom::{Contour, Point2, Vector3};

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
    fn circle_keeps_its_shape() {
        let circle = Contour::circle(Point2::origin(), 3.0, 2000);
        let fewer = contour(&circle, 1e-3);
        assert!(fewer.len() < 200);
        assert!((fewer.signed_area_mm2() / circle.signed_area_mm2() - 1.0).abs() < 1e-3);
    }
}
