//! A closed polyline in a plane and what can be asked of it.

use super::{Point2, Vector2};
use serde::{Deserialize, Serialize};

/// An axis-parallel box in a plane, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds2 {
    /// The corner with the smallest coordinates.
    pub min: Point2,
    /// The corner with the largest coordinates.
    pub max: Point2,
}

impl Bounds2 {
    /// The smallest box around the points; `None` where there are none.
    #[must_use]
    pub fn of(points: impl IntoIterator<Item = Point2>) -> Option<Self> {
        let mut points = points.into_iter();
        let first = points.next()?;
        Some(points.fold(Self { min: first, max: first }, |b, p| Self {
            min: b.min.coords.inf(&p.coords).into(),
            max: b.max.coords.sup(&p.coords).into(),
        }))
    }

    /// The smallest box around both.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self {
            min: self.min.coords.inf(&other.min.coords).into(),
            max: self.max.coords.sup(&other.max.coords).into(),
        }
    }

    /// The box grown by `margin_mm` on every side.
    #[must_use]
    pub fn grown(self, margin_mm: f64) -> Self {
        let m = Vector2::repeat(margin_mm);
        Self { min: self.min - m, max: self.max + m }
    }

    /// Width and height, mm.
    #[must_use]
    pub fn size(self) -> Vector2 {
        self.max - self.min
    }

    /// Whether the boxes share a point.
    #[must_use]
    pub fn meets(self, other: Self) -> bool {
        self.min.x <= other.max.x
            && other.min.x <= self.max.x
            && self.min.y <= other.max.y
            && other.min.y <= self.max.y
    }

    /// Whether the point lies in the box or on its border.
    #[must_use]
    pub fn contains(self, p: Point2) -> bool {
        p.x >= self.min.x && p.x <= self.max.x && p.y >= self.min.y && p.y <= self.max.y
    }
}

/// A closed polyline; the last point is joined to the first and not repeated. mm.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Contour {
    /// The vertices in order.
    pub points: Vec<Point2>,
}

impl Contour {
    /// The contour through the points in the given order.
    #[must_use]
    pub const fn new(points: Vec<Point2>) -> Self {
        Self { points }
    }

    /// The regular polygon of `n_points` vertices inscribed in a circle, counter-clockwise.
    #[must_use]
    pub fn circle(centre: Point2, radius_mm: f64, n_points: usize) -> Self {
        let step = std::f64::consts::TAU / n_points as f64;
        let on_circle = |i: usize| {
            let (sin, cos) = (step * i as f64).sin_cos();
            centre + radius_mm * Vector2::new(cos, sin)
        };
        Self::new((0..n_points).map(on_circle).collect())
    }

    /// Number of vertices.
    #[must_use]
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is no vertex.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// The edges as pairs of end points, the closing edge last.
    pub fn edges(&self) -> impl Iterator<Item = (Point2, Point2)> + '_ {
        let n = self.points.len();
        (0..n).map(move |i| (self.points[i], self.points[(i + 1) % n]))
    }

    /// Signed area, mm²: positive where the contour runs counter-clockwise.
    #[must_use]
    pub fn signed_area_mm2(&self) -> f64 {
        let Some(&origin) = self.points.first() else { return 0.0 };
        // Relative to the first vertex: the cancellation of large coordinates would cost digits.
        0.5 * self.edges().map(|(a, b)| (a - origin).perp(&(b - origin))).sum::<f64>()
    }

    /// Length of the closed polyline, mm.
    #[must_use]
    pub fn perimeter_mm(&self) -> f64 {
        self.edges().map(|(a, b)| (b - a).norm()).sum()
    }

    /// Centroid of the enclosed area; the mean of the vertices where that area vanishes.
    ///
    /// # Panics
    /// Where the contour has no vertex.
    #[must_use]
    pub fn centroid(&self) -> Point2 {
        let origin = self.points[0];
        let mut sum = Vector2::zeros();
        let mut doubled_area = 0.0;
        for (a, b) in self.edges() {
            let (a, b) = (a - origin, b - origin);
            let cross = a.perp(&b);
            doubled_area += cross;
            sum += (a + b) * cross;
        }
        if doubled_area.abs() < 1e-12 {
            let mean = self.points.iter().map(|p| p.coords).sum::<Vector2>() / self.len() as f64;
            return mean.into();
        }
        origin + sum / (3.0 * doubled_area)
    }

    /// Whether the contour runs counter-clockwise.
    #[must_use]
    pub fn is_ccw(&self) -> bool {
        self.signed_area_mm2() > 0.0
    }

    /// The same contour run the other way, from the same first vertex.
    #[must_use]
    pub fn reversed(&self) -> Self {
        let mut points = self.points.clone();
        if let Some(rest) = points.get_mut(1..) {
            rest.reverse();
        }
        Self::new(points)
    }

    /// Whether the point lies inside (crossing rule; a point on the contour may go either way).
    #[must_use]
    pub fn contains(&self, p: Point2) -> bool {
        self.edges().fold(false, |inside, (a, b)| {
            let crosses = (a.y > p.y) != (b.y > p.y) && p.x < (b.x - a.x) * (p.y - a.y) / (b.y - a.y) + a.x;
            inside != crosses
        })
    }

    /// The smallest box around the contour; `None` where it has no vertex.
    #[must_use]
    pub fn bounds(&self) -> Option<Bounds2> {
        Bounds2::of(self.points.iter().copied())
    }

    /// `n_points` points evenly spaced by arc length along the polyline, the first one kept.
    ///
    /// # Panics
    /// Where the contour has no vertex.
    #[must_use]
    pub fn resampled(&self, n_points: usize) -> Self {
        let step = self.perimeter_mm() / n_points as f64;
        let mut points = Vec::with_capacity(n_points);
        let mut passed = 0.0;
        for (a, b) in self.edges() {
            let length = (b - a).norm();
            while points.len() < n_points {
                let target = step * points.len() as f64;
                if target > passed + length || length <= 0.0 {
                    break;
                }
                points.push(a + (b - a) * ((target - passed) / length));
            }
            passed += length;
        }
        // Rounding may leave the last target a hair beyond the closing edge.
        points.resize(n_points, self.points[0]);
        Self::new(points)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn circle_has_area_and_centroid_of_its_polygon() {
        let circle = Contour::circle(Point2::new(1000.0, -5.0), 2.0, 360);
        let expected = 0.5 * 360.0 * 4.0 * (std::f64::consts::TAU / 360.0).sin();
        assert!((circle.signed_area_mm2() - expected).abs() < 1e-9);
        assert!((circle.centroid() - Point2::new(1000.0, -5.0)).norm() < 1e-9);
        assert!(circle.is_ccw() && !circle.reversed().is_ccw());
        assert_eq!(circle.reversed().points[0], circle.points[0]);
    }

    #[test]
    fn resampling_spaces_points_evenly() {
        let square =
            Contour::new([(0., 0.), (4., 0.), (4., 4.), (0., 4.)].map(|(x, y)| Point2::new(x, y)).to_vec());
        let fine = square.resampled(32);
        assert_eq!(fine.len(), 32);
        assert!(fine.edges().all(|(a, b)| ((b - a).norm() - 0.5).abs() < 1e-12));
        assert!(fine.contains(Point2::new(3.9, 0.1)) && !fine.contains(Point2::new(4.1, 0.1)));
    }
}
