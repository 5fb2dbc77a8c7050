//! Polylines that enclose what their curves do.
//!
//! A polyline through points of a smooth curve lies on the inner side of every bend: a chord over the length L of a curve
//! of curvature k cuts off k L³ / 12, and a loop shrinks by k L² / 12 all around. Each vertex moves outward by what its
//! two chords cut off, per length of the two: by two thirds of the sagitta in an even bend. The chords then lie as much on
//! the one side as on the other, the area is kept to the order of L⁴, and nothing is farther off than before.
//!
//! The curvature is that of the polyline: its turn at a vertex over the mean length of the two chords there.

use crate::geom::{Contour, Vector2};

/// A vertex that turns by more than this is a corner of the curve, rad (30 degrees): it stays, and says nothing of the
/// bends beside it.
const SHARP_RAD: f64 = 0.52;

/// Moves the vertices of a polyline whose chords are within `tolerance_mm` of a curve so that it encloses the same area.
pub(super) fn kept(contour: &Contour, tolerance_mm: f64) -> Contour {
    let n = contour.len();
    let along: Vec<Vector2> = contour.edges().map(|(a, b)| b - a).collect();
    let length: Vec<f64> = along.iter().map(Vector2::norm).collect();
    let before = |i: usize| if i == 0 { n - 1 } else { i - 1 };
    let curvature = |i: usize| {
        let (a, b) = (along[before(i)], along[i]);
        let turn = a.perp(&b).atan2(a.dot(&b));
        (turn.abs() < SHARP_RAD).then(|| 2.0 * turn / (length[before(i)] + length[i]).max(f64::MIN_POSITIVE))
    };
    let curvature: Vec<Option<f64>> = (0..n).map(curvature).collect();
    let cut_mm2 = |i: usize| {
        let ends = [curvature[i], curvature[if i + 1 == n { 0 } else { i + 1 }]];
        let known = ends.iter().flatten();
        let mean = known.clone().sum::<f64>() / known.count().max(1) as f64;
        mean * length[i].powi(3) / 12.0
    };
    let cut_mm2: Vec<f64> = (0..n).map(cut_mm2).collect();
    let moved = |i: usize| {
        let at = contour.points[i];
        let (p, span) = (before(i), length[before(i)] + length[i]);
        let across = along[p] + along[i];
        if curvature[i].is_none() || span <= 0.0 {
            return at;
        }
        let outward_mm = ((cut_mm2[p] + cut_mm2[i]) / span).clamp(-tolerance_mm, tolerance_mm);
        at + Vector2::new(across.y, -across.x) * (outward_mm / across.norm().max(f64::MIN_POSITIVE))
    };
    Contour::new((0..n).map(moved).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Point2;
    use std::f64::consts::{PI, TAU};

    /// An ellipse with its points at uneven distances.
    fn ellipse(a: f64, b: f64, n: u32) -> Contour {
        let at = |k: u32| {
            let t = TAU * f64::from(k) / f64::from(n);
            let t = t + 0.3 * (2.0 * t).sin() / 2.0;
            Point2::new(7.0 + a * t.cos(), b * t.sin() - 2.0)
        };
        Contour::new((0..n).map(at).collect())
    }

    #[test]
    fn a_loop_encloses_what_its_curve_does() {
        for (a, b) in [(3.0, 3.0), (4.0, 2.5)] {
            let area = PI * a * b;
            for contour in [ellipse(a, b, 100), ellipse(a, b, 100).reversed()] {
                let lost = (contour.signed_area_mm2().abs() / area - 1.0).abs();
                let kept = kept(&contour, 0.01);
                let left = (kept.signed_area_mm2().abs() / area - 1.0).abs();
                assert!(lost > 5e-4 && left < 0.02 * lost, "{lost} {left}");
            }
        }
    }

    #[test]
    fn nothing_is_farther_off_than_before() {
        let (radius, n) = (3.0, 80);
        let circle = Contour::circle(Point2::origin(), radius, n);
        let sagitta = radius * (1.0 - (PI / n as f64).cos());
        let kept = kept(&circle, sagitta);
        let off = |p: &Point2| p.coords.norm() - radius;
        let middles = kept.edges().map(|(a, b)| nalgebra::center(&a, &b));
        assert!(kept.points.iter().all(|p| (off(p) / sagitta - 2.0 / 3.0).abs() < 0.01));
        assert!(middles.into_iter().all(|p| (off(&p) / sagitta + 1.0 / 3.0).abs() < 0.01));
    }

    #[test]
    fn straight_sides_and_corners_stay() {
        let square = [(0., 0.), (4., 0.), (4., 4.), (0., 4.)].map(|(x, y)| Point2::new(x, y));
        let square = Contour::new(square.to_vec()).resampled(64);
        assert_eq!(kept(&square, 0.01), square);
    }

    #[test]
    fn points_that_coincide_do_no_harm() {
        let mut circle = Contour::circle(Point2::origin(), 3.0, 100);
        circle.points.insert(40, circle.points[40]);
        circle.points.insert(70, circle.points[70] + Vector2::new(1e-9, -1e-9));
        let kept = kept(&circle, 1e-3);
        let off = |p: &Point2| (p.coords.norm() - 3.0).abs();
        assert!(kept.points.iter().all(|p| off(p) < 1.1e-3));
    }
}
