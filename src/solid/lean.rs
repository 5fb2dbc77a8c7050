//! How a tube leans where it leaves the patches of a slab.
//!
//! A spline through a branch's sections alone leans at its end as those nearest to it say. Beside a crotch they follow
//! each other within hundredths of a millimetre, and what they miss of one field by micrometres turns the end by
//! degrees. The patches interpolate the field; across its end section the tube therefore takes the slope of the field
//! itself, -F_z / |grad F| along its gradient in the plane. Along the section, where a slope only moves points on the
//! surface, it takes that of a parabola through its first sections.
//!
//! At a crease, whose sides are horizontal at the apex, tubes keep the slope of their sections.

use super::event::EventSource;
use super::skin::End;
use crate::geom::{Contour, Point2, SegmentIndex, Vector2};
use crate::spline::SectionCurve;

/// Pieces of a border's chord, at whose ends the field is asked.
const PIECES: usize = 4;
/// Sections that tell how points move along the end.
const SECTIONS: usize = 3;
/// A field flatter than this has no direction to lean in.
const LEAST_GRADIENT: f64 = 1e-6;

/// How the field leans along the border of a slab.
#[derive(Debug)]
pub(super) struct Lean {
    polyline: Contour,
    index: SegmentIndex,
    /// Derivatives by z at the polyline's points, across it.
    slopes: Vec<Vector2>,
}

/// Along the waist and along either leg; `None` where the sections of the tube say it.
pub(super) type Leans = [Option<Lean>; 3];

impl Lean {
    /// Along a zero of the field at height w; its derivative by w is taken over `2 step_w`, and `sign` is that of z
    /// along w.
    pub(super) fn of(
        source: &dyn EventSource,
        border: &Contour,
        w: f64,
        step_w: f64,
        sign: f64,
    ) -> Option<Self> {
        let shares = (0..PIECES).map(|k| k as f64 / PIECES as f64);
        let pieces = border.edges().flat_map(|(a, b)| shares.clone().map(move |s| a + (b - a) * s));
        let polyline = Contour::new(pieces.map(|p| source.refine(p, w)).collect());
        let index = SegmentIndex::try_new(std::slice::from_ref(&polyline))?;
        let [here, below, above] = [w, w - step_w, w + step_w].map(|w| source.slice(w));
        let slope = |p: &Point2| {
            let gradient = here(*p).slope;
            let by_w = (above(*p).value - below(*p).value) / (2.0 * step_w);
            (gradient.norm() > LEAST_GRADIENT).then(|| gradient * (-sign * by_w / gradient.norm_squared()))
        };
        let slopes = polyline.points.iter().map(slope).collect::<Option<_>>()?;
        Some(Self { polyline, index, slopes })
    }

    /// The derivative by z near a point of the border.
    fn at(&self, p: Point2) -> Vector2 {
        let foot = self.index.nearest(p);
        let next = (foot.edge_idx + 1) % self.polyline.len();
        let [from, to] = [foot.edge_idx, next].map(|k| self.polyline.points[k]);
        let share = ((foot.point - from).norm() / (to - from).norm().max(1e-300)).min(1.0);
        self.slopes[foot.edge_idx] * (1.0 - share) + self.slopes[next] * share
    }
}

/// The derivatives by z of the points of a tube's end section; `None` where its sections alone say them. `sections`
/// begin at the end: height z and points.
pub(super) fn end_slopes(end: End, leans: &[Leans], sections: &[(f64, &[Point2])]) -> Option<Vec<Vector2>> {
    let lean = match end {
        End::Cap => None,
        End::Waist { slab } => leans[slab][0].as_ref(),
        End::Daughter { slab, side } => leans[slab][1 + side].as_ref(),
    }?;
    let (_, points) = *sections.first()?;
    let curve = SectionCurve::through_points(points);
    let weights = end_derivative(&sections.iter().take(SECTIONS).map(|s| s.0).collect::<Vec<_>>());
    let n = points.len();
    let slope = |i: usize| {
        let own: Vector2 = weights.iter().zip(sections).map(|(w, s)| s.1[i].coords * *w).sum();
        let along = curve.derivative_at(i as f64 / n as f64).try_normalize(1e-12)?;
        let normal = Vector2::new(along.y, -along.x);
        Some(along * own.dot(&along) + normal * lean.at(points[i]).dot(&normal))
    };
    (0..n).map(slope).collect()
}

/// Weights of values at sites in the derivative, at the first one, of the polynomial through them.
fn end_derivative(sites: &[f64]) -> Vec<f64> {
    let first = sites[0];
    let others = |j: usize| sites.iter().enumerate().skip(1).filter(move |(m, _)| *m != j).map(|(_, s)| *s);
    let weight = |j: usize| {
        let share: f64 = others(j).map(|s| (first - s) / (sites[j] - s)).product();
        share / (sites[j] - first)
    };
    let behind: Vec<f64> = (1..sites.len()).map(weight).collect();
    std::iter::once(-behind.iter().sum::<f64>()).chain(behind).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_derivative_of_a_parabola_at_the_end_is_exact() {
        let parabola = |z: f64| 3.0 - 2.0 * z + 0.7 * z * z;
        for sites in [[1.0, 1.2, 2.0], [1.0, 0.4, -3.0]] {
            let weights = end_derivative(&sites);
            let found: f64 = weights.iter().zip(sites).map(|(w, z)| w * parabola(z)).sum();
            assert!((found - (-2.0 + 1.4)).abs() < 1e-12, "{found}");
        }
        assert_eq!(end_derivative(&[1.0, 3.0]), [-0.5, 0.5]);
    }

    /// A cone about a leaning axis.
    struct Cone;

    impl EventSource for Cone {
        fn value(&self, p: Point2, w: f64) -> f64 {
            (p - Point2::new(0.5 * w, 0.0)).norm() - (2.0 + 0.3 * w)
        }

        fn contours_on(&self, w: f64, _finer: f64) -> Vec<Contour> {
            vec![Contour::circle(Point2::new(0.5 * w, 0.0), 2.0 + 0.3 * w, 64)]
        }

        fn refine(&self, p: Point2, w: f64) -> Point2 {
            let centre = Point2::new(0.5 * w, 0.0);
            centre + (p - centre).normalize() * (2.0 + 0.3 * w)
        }

        fn anchor(&self, _i: usize, w: f64) -> Point2 {
            Point2::new(0.5 * w, 0.0)
        }
    }

    #[test]
    fn a_tube_leans_as_the_field_does_across_its_end() {
        for sign in [1.0, -1.0] {
            let lean = Lean::of(&Cone, &Cone.contours(1.0)[0], 1.0, 1e-3, sign).expect("a cone");
            for k in 0..50 {
                let (sin, cos) = (0.13 * f64::from(k)).sin_cos();
                let normal = Vector2::new(cos, sin);
                let slope = lean.at(Point2::new(0.5, 0.0) + normal * 2.3);
                assert!((slope.dot(&normal) - sign * (0.3 + 0.5 * cos)).abs() < 1e-4);
                assert!(slope.perp(&normal).abs() < 1e-3);
            }
        }
    }
}
