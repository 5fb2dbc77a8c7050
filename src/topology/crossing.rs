//! Where polylines meet: a sweep over their edges, sorted by least x.
//!
//! Edges that only touch count as meeting: whether that is a crossing is decided by areas, which costs a boolean
//! operation and is asked for only then. The sweep is O(n log n) for outlines of anatomy, where few edges share an
//! x range.

use crate::geom::{Contour, Point2};

#[derive(Debug, Clone, Copy)]
struct Edge {
    a: Point2,
    b: Point2,
    contour: usize,
    number: usize,
}

impl Edge {
    fn x_range(&self) -> [f64; 2] {
        [self.a.x.min(self.b.x), self.a.x.max(self.b.x)]
    }

    fn y_apart(&self, other: &Self) -> bool {
        self.a.y.max(self.b.y) < other.a.y.min(other.b.y) || other.a.y.max(other.b.y) < self.a.y.min(self.b.y)
    }

    /// The point where the edges meet or touch.
    fn meets(&self, other: &Self) -> Option<Point2> {
        let side = |e: &Self, p: Point2| (e.b - e.a).perp(&(p - e.a));
        let (c, d) = (side(self, other.a), side(self, other.b));
        let (a, b) = (side(other, self.a), side(other, self.b));
        let parted = |p: f64, q: f64| (p > 0.0 && q > 0.0) || (p < 0.0 && q < 0.0);
        if parted(a, b) || parted(c, d) {
            return None;
        }
        let span = c - d;
        let t = if span.abs() > 0.0 { (c / span).clamp(0.0, 1.0) } else { 0.0 };
        let met = other.a + (other.b - other.a) * t;
        // Edges on one line share only what lies between their ends.
        (span.abs() > 0.0 || between(self, other)).then_some(met)
    }
}

fn between(e: &Edge, f: &Edge) -> bool {
    let along = e.b - e.a;
    let at = |p: Point2| (p - e.a).dot(&along);
    let (c, d, end) = (at(f.a), at(f.b), along.norm_squared());
    c.max(d) >= 0.0 && c.min(d) <= end
}

fn edges(contour: &Contour, which: usize) -> impl Iterator<Item = Edge> + '_ {
    contour.edges().enumerate().map(move |(number, (a, b))| Edge { a, b, contour: which, number })
}

fn first_meeting(mut edges: Vec<Edge>, counts: impl Fn(&Edge, &Edge) -> bool) -> Option<Point2> {
    edges.sort_by(|e, f| e.x_range()[0].total_cmp(&f.x_range()[0]));
    edges.iter().enumerate().find_map(|(i, e)| {
        let reach = e.x_range()[1];
        let near = edges[i + 1..].iter().take_while(|f| f.x_range()[0] <= reach);
        near.filter(|f| !e.y_apart(f) && counts(e, f)).find_map(|f| e.meets(f))
    })
}

/// A point where a contour meets itself other than in the joints of neighbouring edges.
pub(super) fn within(contour: &Contour) -> Option<Point2> {
    let n = contour.len();
    let neighbours = |e: &Edge, f: &Edge| (e.number + 1) % n == f.number || (f.number + 1) % n == e.number;
    first_meeting(edges(contour, 0).collect(), |e, f| !neighbours(e, f))
}

/// A point where two contours meet.
pub(super) fn of_two(a: &Contour, b: &Contour) -> Option<Point2> {
    let (bounds_a, bounds_b) = (a.bounds()?, b.bounds()?);
    let low = bounds_a.min.coords.sup(&bounds_b.min.coords);
    let high = bounds_a.max.coords.inf(&bounds_b.max.coords);
    let near = |e: &Edge| {
        let (min, max) = (e.a.coords.inf(&e.b.coords), e.a.coords.sup(&e.b.coords));
        min.x <= high.x && min.y <= high.y && max.x >= low.x && max.y >= low.y
    };
    let both = edges(a, 0).chain(edges(b, 1)).filter(near).collect();
    first_meeting(both, |e, f| e.contour != f.contour)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn polygon(points: &[(f64, f64)]) -> Contour {
        Contour::new(points.iter().map(|&(x, y)| Point2::new(x, y)).collect())
    }

    #[test]
    fn a_figure_of_eight_meets_itself_in_its_middle() {
        let eight = polygon(&[(0., 0.), (4., 4.), (4., 0.), (0., 4.)]);
        assert_eq!(within(&eight), Some(Point2::new(2.0, 2.0)));
        assert_eq!(within(&Contour::circle(Point2::origin(), 2.0, 128)), None);
    }

    #[test]
    fn two_disks_meet_where_they_overlap_or_touch_but_not_when_nested() {
        let disk = |x: f64, r: f64| Contour::circle(Point2::new(x, 0.0), r, 64);
        assert!(of_two(&disk(0.0, 2.0), &disk(3.0, 2.0)).is_some());
        assert!(of_two(&disk(0.0, 2.0), &disk(0.0, 2.0)).is_some());
        assert!(of_two(&disk(0.0, 2.0), &disk(0.3, 1.0)).is_none());
        assert!(of_two(&disk(0.0, 2.0), &disk(9.0, 1.0)).is_none());
    }
}
