//! Beads to the area they cover: each segment of a path is a rectangle of the bead's width, joints and free
//! ends are round (a nozzle is), and what overlaps counts once.
//!
//! A path becomes one polygon (a loop becomes two) whose winding number is the number of rectangles and joint
//! wedges over a point: on the inner side of a turn the outline passes through the joint, which makes the polygon
//! the exact sum of its positive parts, so that the non-zero rule gives their union. Where a turn is gentle the
//! mitre point stands for the whole joint; that costs two edges a segment and errs by less than [`MITRE_MM`]. Widths that
//! change by less than [`EVEN_MM`] change along the segments instead of in the joint, which errs by no more than half of it.

use crate::geom::{Contour, Point2, Region, Vector2};

/// Chord error of round joints and ends, mm: far below what a nozzle can do.
pub(super) const ARC_MM: f64 = 2e-3;
/// How far a mitre may stand beyond the round joint that it replaces, mm.
const MITRE_MM: f64 = 5e-4;
/// Change of the half width that is no step, mm: recorded widths follow from rounded flows.
const EVEN_MM: f64 = 2e-3;
/// Ends nearer than this are one point, mm: recorded coordinates are rounded to a micrometre or so.
const SAME_MM: f64 = 2e-3;

/// A centre line with the width of every segment, mm.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Stroke {
    /// Vertices of the centre line.
    pub(super) points: Vec<Point2>,
    /// Width between vertex i and i + 1; a lone point has one width.
    pub(super) widths_mm: Vec<f64>,
}

#[derive(Debug, Clone, Copy)]
struct Leg {
    from: Point2,
    to: Point2,
    along: Vector2,
    length_mm: f64,
    radius_mm: f64,
}

impl Leg {
    fn reversed(self) -> Self {
        Self { from: self.to, to: self.from, along: -self.along, ..self }
    }

    /// Unit vector to the right of the direction of travel.
    fn right(self) -> Vector2 {
        Vector2::new(self.along.y, -self.along.x)
    }
}

/// The area that the strokes cover together.
pub(super) fn union<'a>(strokes: impl IntoIterator<Item = &'a Stroke>) -> Region {
    let mut contours = Vec::new();
    strokes.into_iter().for_each(|stroke| outline(stroke, &mut contours));
    Region::union_all([&Region::new(contours)])
}

/// Appends the outline of one stroke.
fn outline(stroke: &Stroke, contours: &mut Vec<Contour>) {
    let legs = legs_of(stroke);
    let (Some(first), Some(last)) = (legs.first(), legs.last()) else {
        if let (Some(&at), Some(&width)) = (stroke.points.first(), stroke.widths_mm.first()) {
            contours.push(Contour::circle(at, 0.5 * width, 24));
        }
        return;
    };
    let back: Vec<Leg> = legs.iter().rev().map(|leg| leg.reversed()).collect();
    if legs.len() > 2 && (last.to - first.from).norm() <= SAME_MM {
        contours.push(loop_side(&legs));
        contours.push(loop_side(&back));
        return;
    }
    let mut points = Vec::with_capacity(2 * legs.len() + 32);
    for side in [&legs, &back] {
        open_side(side, &mut points);
    }
    contours.push(Contour::new(points));
}

fn legs_of(stroke: &Stroke) -> Vec<Leg> {
    let mut from = match stroke.points.first() {
        Some(&p) => p,
        None => return Vec::new(),
    };
    let mut legs = Vec::with_capacity(stroke.widths_mm.len());
    for (&to, &width_mm) in stroke.points.iter().skip(1).zip(&stroke.widths_mm) {
        let step = to - from;
        let length_mm = step.norm();
        // Shorter than the grid can tell: the next leg begins where this one did.
        if length_mm > 1e-4 {
            legs.push(Leg { from, to, along: step / length_mm, length_mm, radius_mm: 0.5 * width_mm });
            from = to;
        }
    }
    legs
}

/// The right side of a closed path.
fn loop_side(legs: &[Leg]) -> Contour {
    let mut points = Vec::with_capacity(legs.len() + 16);
    for (i, &leg) in legs.iter().enumerate() {
        joint(leg, legs[(i + 1) % legs.len()], &mut points);
    }
    Contour::new(points)
}

/// The right side of an open path from its begin to its end, and the round end there.
fn open_side(legs: &[Leg], points: &mut Vec<Point2>) {
    let Some(&last) = legs.last() else { return };
    points.push(legs[0].from + legs[0].right() * legs[0].radius_mm);
    for pair in legs.windows(2) {
        joint(pair[0], pair[1], points);
    }
    arc(last.to, last.right() * last.radius_mm, std::f64::consts::PI, 0.0, points);
}

/// The right side of the joint between two legs.
fn joint(a: Leg, b: Leg, points: &mut Vec<Point2>) {
    let (at, ra, rb) = (a.to, a.radius_mm, b.radius_mm);
    let turn = a.along.perp(&b.along).atan2(a.along.dot(&b.along));
    let even = (ra - rb).abs() < EVEN_MM;
    let radius_mm = 0.5 * (ra + rb);
    let reach = radius_mm * (0.5 * turn.abs()).tan();
    let gentle = if turn >= 0.0 {
        radius_mm / (0.5 * turn).cos() - radius_mm <= MITRE_MM
    } else {
        reach <= 0.5 * a.length_mm.min(b.length_mm)
    };
    if even && gentle && turn.abs() < 3.0 {
        let mitre = (a.right() + b.right()) / (1.0 + a.right().dot(&b.right()));
        points.push(at + mitre * radius_mm);
    } else if turn >= 0.0 {
        arc(at, a.right() * ra, turn, rb - ra, points);
        points.push(at + b.right() * rb);
    } else {
        points.extend([at + a.right() * ra, at, at + b.right() * rb]);
    }
}

/// Points on the arc from `at + start`, counter-clockwise by `turn`, the radius growing by `growth_mm`.
fn arc(at: Point2, start: Vector2, turn: f64, growth_mm: f64, points: &mut Vec<Point2>) {
    let radius_mm = start.norm().max(1e-6);
    let step = 2.0 * (1.0 - (ARC_MM / radius_mm).min(1.0)).acos();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 64 steps")]
    let n = (turn / step).ceil().clamp(1.0, 64.0) as u32;
    for i in 0..=n {
        let part = f64::from(i) / f64::from(n);
        let turned = nalgebra::Rotation2::new(turn * part) * start;
        points.push(at + turned * (1.0 + growth_mm * part / radius_mm));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn stroke(points: &[(f64, f64)], width_mm: f64) -> Stroke {
        Stroke {
            points: points.iter().map(|&(x, y)| Point2::new(x, y)).collect(),
            widths_mm: vec![width_mm; points.len().max(2) - 1],
        }
    }

    fn area(strokes: &[Stroke]) -> f64 {
        union(strokes).area_mm2()
    }

    #[test]
    fn a_straight_bead_is_a_stadium() {
        let expected = 10.0 * 0.4 + PI * 0.04;
        assert!((area(&[stroke(&[(0., 0.), (10., 0.)], 0.4)]) - expected).abs() < 2e-3);
        assert!((area(&[stroke(&[(0., 0.), (4., 0.), (4., 0.), (10., 0.)], 0.4)]) - expected).abs() < 2e-3);
    }

    #[test]
    fn a_dot_is_a_disk() {
        assert!((area(&[stroke(&[(1., 1.)], 0.4)]) - PI * 0.04).abs() < 2e-3);
    }

    #[test]
    fn a_loop_is_a_ring_and_keeps_its_hole() {
        let mut points = Contour::circle(Point2::new(5.0, 5.0), 3.0, 360).points;
        points.push(points[0]);
        let widths_mm = vec![0.4; 360];
        let ring = union(&[Stroke { points, widths_mm }]);
        assert_eq!(ring.contours.len(), 2);
        assert!((ring.area_mm2() - PI * (3.2 * 3.2 - 2.8 * 2.8)).abs() < 2e-3);
    }

    #[test]
    fn sharp_turns_and_crossings_count_once() {
        // A right angle: two legs and their round outer corner, the overlap counted once.
        let right_angle = area(&[stroke(&[(0., 0.), (5., 0.), (5., 5.)], 0.4)]);
        assert!((right_angle - (10.0 * 0.4 - 0.04 + PI * 0.04 * 1.25)).abs() < 2e-3, "{right_angle}");
        // There and back on the same line.
        let back = area(&[stroke(&[(0., 0.), (10., 0.), (0., 0.)], 0.4)]);
        assert!((back - (4.0 + PI * 0.04)).abs() < 4e-3, "{back}");
        // Two crossing beads.
        let cross = area(&[stroke(&[(-5., 0.), (5., 0.)], 0.4), stroke(&[(0., -5.), (0., 5.)], 0.4)]);
        assert!((cross - (8.0 - 0.16 + 2.0 * PI * 0.04)).abs() < 4e-3, "{cross}");
    }

    #[test]
    fn a_tight_zigzag_agrees_with_its_separate_legs() {
        let points: Vec<(f64, f64)> =
            (0..60).map(|i| (0.1 * f64::from(i), if i % 2 == 0 { 0.0 } else { 0.3 })).collect();
        let legs: Vec<Stroke> = points.windows(2).map(|pair| stroke(pair, 0.5)).collect();
        let (one, many) = (area(&[stroke(&points, 0.5)]), area(&legs));
        // Sixty round corners, whose chords lie differently.
        assert!((one - many).abs() < 0.01, "{one} against {many}");
    }

    #[test]
    fn a_loop_of_uneven_widths_has_one_vertex_a_joint_and_the_area_of_its_legs() {
        let mut points = Contour::circle(Point2::new(5.0, 5.0), 3.0, 90).points;
        points.push(points[0]);
        let widths_mm: Vec<f64> = (0..90).map(|i| 0.5 + 0.003 * f64::from(i % 2)).collect();
        let legs: Vec<Stroke> = points
            .windows(2)
            .zip(&widths_mm)
            .map(|(pair, &width_mm)| Stroke { points: pair.to_vec(), widths_mm: vec![width_mm] })
            .collect();
        let whole = Stroke { points, widths_mm };
        let mut contours = Vec::new();
        outline(&whole, &mut contours);
        assert!(contours.iter().all(|c| c.len() == 90), "{:?}", contours.iter().map(Contour::len));
        // Half of a half width's change, along all of both outlines.
        let most = 0.5 * 0.0015 * 2.0 * 2.0 * PI * 3.0;
        let (one, many) = (area(&[whole]), area(&legs));
        assert!((one - many).abs() < most, "{one} against {many}");
    }

    #[test]
    fn a_change_of_width_keeps_both_widths() {
        let two = Stroke {
            points: [(0., 0.), (5., 0.), (10., 0.)].map(|(x, y)| Point2::new(x, y)).to_vec(),
            widths_mm: vec![0.4, 0.8],
        };
        assert!((area(&[two]) - (2.0 + 4.0 + 0.5 * PI * (0.04 + 0.16))).abs() < 5e-3);
    }
}
