//! Closed iso-contours of a smooth field in a plane.
//!
//! Cells of sixteen steps are split into four as long as the zero may pass through them (the fields here are near to
//! signed distances: where the middle is farther from zero than the corners can be, the cell is empty), marching
//! squares on the cells of one step, then Newton steps onto the zero. A contour that leaves the cells so found is
//! followed through those beside them. Cost: a few evaluations per step of length, on every field.

use super::grid::Jet;
use super::slab::root;
use crate::geom::{Bounds2, Contour, Point2, Vector2};

/// Halvings from the coarsest cells to the finest.
const LEVELS: u32 = 4;
/// The steepest that a field usually rises, per mm: 1 for a distance, a little more where several are combined. Where a
/// contour leaves the cells that such a field vanishes in it rises more steeply somewhere, and so it may elsewhere: then
/// more cells are looked at.
const STEEPEST: [f64; 2] = [1.5, 6.0];
/// Least cosine of the angle by which the zero turns in a step along it; a value that is on it.
const STEP_TURN: f64 = 0.95;
const ON_ZERO: f64 = 1e-6;
/// A vertex nearer than this to the one before it, in steps, is left out.
const LEAST_SPACING: f64 = 0.25;
/// Steps along the longer side of what is searched, at most: memory stays bounded, and every edge has a number.
const MOST_STEPS: f64 = 4000.0;
/// How far across an edge of a curve the zero is looked for where Newton steps lead elsewhere, in lengths of it, and in how
/// many steps.
const ACROSS: f64 = 0.5;
const ACROSS_STEPS: u32 = 32;
/// A vertex projected farther than this, in steps, is looked at.
const FAR_PROJECTED: f64 = 0.3;
const NONE: u32 = u32::MAX;

struct Grid<'a> {
    field: &'a dyn Fn(Point2) -> Jet,
    origin: Point2,
    step_mm: f64,
    steepest: f64,
    /// Nodes along x.
    n_x: usize,
    /// Values at the nodes, NaN where not yet asked for.
    values: Vec<f64>,
    /// The edge to which the contour goes on from an edge. Edge 2 k runs along x from node k, 2 k + 1 along y.
    next: Vec<u32>,
    /// Edges from which the contour goes on, as found.
    starts: Vec<u32>,
    /// Whether a contour left the cells that were visited.
    has_left: bool,
}

impl Grid<'_> {
    fn point(&self, i: f64, j: f64) -> Point2 {
        self.origin + Vector2::new(i, j) * self.step_mm
    }

    fn value(&mut self, i: usize, j: usize) -> f64 {
        let k = j * self.n_x + i;
        if self.values[k].is_nan() {
            self.values[k] = (self.field)(self.point(i as f64, j as f64)).value;
        }
        self.values[k]
    }

    /// Visits the cell at (i, j) of 2^level steps.
    fn visit(&mut self, i: usize, j: usize, level: u32) {
        if level == 0 {
            self.march(i, j);
            return;
        }
        let half = (1usize << level) / 2;
        let reach = self.steepest * half as f64 * self.step_mm * std::f64::consts::SQRT_2;
        if self.value(i + half, j + half).abs() > reach {
            return;
        }
        for (di, dj) in [(0, 0), (half, 0), (0, half), (half, half)] {
            self.visit(i + di, j + dj, level - 1);
        }
    }

    /// Directed pieces of the contour in a cell, the inside (negative) to the left.
    fn march(&mut self, i: usize, j: usize) {
        let corners =
            [self.value(i, j), self.value(i + 1, j), self.value(i + 1, j + 1), self.value(i, j + 1)];
        let inside = corners.map(|v| v < 0.0);
        let node = |i: usize, j: usize| j * self.n_x + i;
        let edges = [2 * node(i, j), 2 * node(i + 1, j) + 1, 2 * node(i, j + 1), 2 * node(i, j) + 1];
        // Walking round the cell counter-clockwise, the contour leaves where it goes from inside to outside.
        let exits = |e: &usize| inside[*e] && !inside[(e + 1) % 4];
        let entry = |e: &usize| !inside[*e] && inside[(e + 1) % 4];
        let n_exits = (0..4).filter(exits).count();
        // Joined through the middle: each piece cuts off an outside corner; else an inside one.
        let middle_inside =
            n_exits == 2 && (self.field)(self.point(i as f64 + 0.5, j as f64 + 0.5)).value < 0.0;
        for exit in (0..4).filter(exits) {
            let to = match n_exits {
                1 => (0..4).find(entry).unwrap_or(exit),
                _ if middle_inside => (exit + 1) % 4,
                _ => (exit + 3) % 4,
            };
            let number =
                |edge: usize| u32::try_from(edge).expect("MOST_STEPS squared nodes have fewer edges");
            self.next[edges[exit]] = number(edges[to]);
            self.starts.push(number(edges[exit]));
        }
    }

    /// Where the field vanishes on an edge, by linear interpolation.
    fn crossing(&mut self, edge: usize) -> Point2 {
        let [(from, a), (to, b)] = self.ends(edge);
        let t = (a / (a - b)).clamp(1e-6, 1.0 - 1e-6);
        from + (to - from) * t
    }

    /// The nodes at the ends of an edge with their values.
    fn ends(&mut self, edge: usize) -> [(Point2, f64); 2] {
        let (i, j) = ((edge / 2) % self.n_x, (edge / 2) / self.n_x);
        let (k, l) = if edge.is_multiple_of(2) { (i + 1, j) } else { (i, j + 1) };
        let (a, b) = (self.value(i, j), self.value(k, l));
        [(self.point(i as f64, j as f64), a), (self.point(k as f64, l as f64), b)]
    }

    /// A point projected from where the field changes its sign on an edge, if the field rises there as it does along the
    /// edge: where walls are as near as the grid's nodes, Newton steps may lead to the one opposite. Else the zero on the
    /// edge itself.
    fn on_own_wall(&mut self, edge: usize, projected: Point2) -> Point2 {
        let [(from, a), (to, b)] = self.ends(edge);
        let outward = if a < b { to - from } else { from - to };
        if (self.field)(projected).slope.dot(&outward) > 0.0 {
            return projected;
        }
        let sign = if a < b { 1.0 } else { -1.0 };
        from + (to - from) * root(|t| sign * (self.field)(from + (to - from) * t).value, 0.0, 1.0)
    }

    /// The cell through which a contour goes on from an edge: the one on the side to whose left the edge leads outward.
    /// `None` at the border.
    fn cell_behind(&mut self, edge: usize) -> Option<[usize; 2]> {
        let [(_, a), _] = self.ends(edge);
        let (i, j) = ((edge / 2) % self.n_x, (edge / 2) / self.n_x);
        let n_y = self.values.len() / self.n_x;
        let (i, j) = match (edge.is_multiple_of(2), a < 0.0) {
            (true, true) | (false, false) => (Some(i), Some(j)),
            (true, false) => (Some(i), j.checked_sub(1)),
            (false, true) => (i.checked_sub(1), Some(j)),
        };
        let (i, j) = (i?, j?);
        (i + 1 < self.n_x && j + 1 < n_y).then_some([i, j])
    }

    /// Follows the contour from an edge until it is back; `None` where it does not come back. Empty where it is too small
    /// to be a contour.
    fn follow(&mut self, start: u32) -> Option<Contour> {
        let mut points: Vec<Point2> = Vec::new();
        let mut at = start;
        let least = LEAST_SPACING * self.step_mm;
        while at != start || points.is_empty() {
            if self.next[at as usize] == NONE {
                let [i, j] = self.cell_behind(at as usize)?;
                self.march(i, j);
                self.has_left = true;
            }
            let next = std::mem::replace(&mut self.next[at as usize], NONE);
            if next == NONE {
                return None;
            }
            let crossing = self.crossing(at as usize);
            let projected = project(self.field, crossing, self.step_mm);
            let is_far = (projected - crossing).norm() > FAR_PROJECTED * self.step_mm;
            let point = if is_far { self.on_own_wall(at as usize, projected) } else { projected };
            if points.last().is_none_or(|&q| (point - q).norm() > least) {
                points.push(point);
            }
            at = next;
        }
        while points.len() > 4 && (points[points.len() - 1] - points[0]).norm() <= least {
            points.pop();
        }
        if points.len() < 4 {
            points.clear();
        }
        Some(Contour::new(points))
    }
}

/// All closed contours on which `field` vanishes, the negative side to the left: outer ones counter-clockwise, holes
/// clockwise. The field must be positive on the border of `bounds`. The step is made coarser where the box is longer than
/// some thousand of them.
pub(super) fn contours(field: &dyn Fn(Point2) -> Jet, bounds: Bounds2, step_mm: f64) -> Vec<Contour> {
    let step_mm = step_mm.max(bounds.size().amax() / MOST_STEPS);
    let [usual, steeper] = STEEPEST;
    let (found, is_steep) = searched(field, bounds, step_mm, usual);
    if is_steep { searched(field, bounds, step_mm, steeper).0 } else { found }
}

/// The contours that pass through the cells in which a field of this steepness may vanish, and whether one left those.
fn searched(
    field: &dyn Fn(Point2) -> Jet,
    bounds: Bounds2,
    step_mm: f64,
    steepest: f64,
) -> (Vec<Contour>, bool) {
    let coarsest = 1usize << LEVELS;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "sizes of vessels over steps"
    )]
    let count = |extent: f64| (extent / (step_mm * coarsest as f64)).ceil().max(1.0) as usize;
    let (n_x, n_y) = (count(bounds.size().x), count(bounds.size().y));
    let n_nodes = (n_x * coarsest + 1) * (n_y * coarsest + 1);
    let mut grid = Grid {
        field,
        origin: bounds.min,
        step_mm,
        steepest,
        n_x: n_x * coarsest + 1,
        values: vec![f64::NAN; n_nodes],
        next: vec![NONE; 2 * n_nodes],
        starts: Vec::new(),
        has_left: false,
    };
    for j in 0..n_y {
        for i in 0..n_x {
            grid.visit(i * coarsest, j * coarsest, LEVELS);
        }
    }
    let mut found = Vec::new();
    let mut k = 0;
    // Cells beside those visited may add further ones.
    while let Some(&start) = grid.starts.get(k) {
        if grid.next[start as usize] != NONE {
            found.extend(grid.follow(start).filter(|c| !c.is_empty()));
        }
        k += 1;
    }
    (found, grid.has_left)
}

/// A point moved from `start` onto the zero of a field, if the zero runs about `along` there, with the inside to its left:
/// in a gap that is narrower than the curve's vertices are apart, Newton steps may lead to the wall opposite. Else the nearest
/// zero across the way from the start where the field rises outward; the start itself where there is none.
pub(super) fn settled(moved: Point2, start: Point2, along: Vector2, field: &dyn Fn(Point2) -> Jet) -> Point2 {
    let outward = Vector2::new(along.y, -along.x);
    if field(moved).slope.dot(&outward) > 0.0 {
        return moved;
    }
    let rises = if field(start).value < 0.0 { 1.0 } else { -1.0 };
    let value = |t: f64| rises * field(start + outward * (rises * t)).value;
    let step = ACROSS / f64::from(ACROSS_STEPS);
    let beyond = (1..=ACROSS_STEPS).map(|k| step * f64::from(k)).find(|&t| value(t) >= 0.0);
    beyond.map_or(start, |t| start + outward * (rises * root(value, t - step, t)))
}

/// Newton steps from `p` onto the zero of the field, never farther than `most_mm` in all.
pub(super) fn project(field: &dyn Fn(Point2) -> Jet, start: Point2, most_mm: f64) -> Point2 {
    let mut p = start;
    for _ in 0..5 {
        let Jet { value, slope } = field(p);
        if value.abs() < 1e-8 {
            break;
        }
        let norm2 = slope.norm_squared();
        if norm2 < 1e-6 {
            break;
        }
        let step = slope * (value / norm2);
        p -= step * (0.5 * most_mm / step.norm().max(1e-300)).min(1.0);
        if (p - start).norm() > most_mm {
            return start;
        }
    }
    p
}

/// The zero ahead of a point of it, the inside to the left, by the longest step, halved down to the least one, in which it
/// turns little; and that step. `None` where it is lost.
pub(super) fn stepped(
    field: &dyn Fn(Point2) -> Jet,
    at: Point2,
    forward: Vector2,
    [longest_mm, least_mm]: [f64; 2],
) -> Option<(Point2, f64)> {
    let halved = std::iter::successors(Some(longest_mm), |step| Some(0.5 * step));
    let mut steps = halved.take_while(|step| *step >= least_mm.min(longest_mm));
    steps.find_map(|step_mm| {
        let next = project(field, at + forward * step_mm, 0.5 * step_mm);
        let jet = field(next);
        let onward = jet.slope.try_normalize(1e-9).map(|s| Vector2::new(-s.y, s.x));
        let is_straight = onward.is_some_and(|o| o.dot(&forward) > STEP_TURN);
        let is_least = 0.5 * step_mm < least_mm;
        (jet.value.abs() <= ON_ZERO && (is_straight || is_least)).then_some((next, step_mm))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_step_is_too_fine_for_the_memory() {
        let disk = |p: Point2| Jet { value: p.coords.norm() - 1.0, slope: p.coords.normalize() };
        let bounds = Bounds2 { min: Point2::new(-1.5, -1.5), max: Point2::new(1.5, 1.5) };
        let [found] = &contours(&disk, bounds, 1e-9)[..] else { panic!("one disk") };
        assert!((found.signed_area_mm2() - std::f64::consts::PI).abs() < 1e-5);
    }

    #[test]
    fn points_stay_on_their_own_wall_of_a_slit() {
        // A slit 0.05 wide along y; the wall that faces it from the left runs upward.
        let field = |p: Point2| Jet { value: 0.025 - p.x.abs(), slope: Vector2::new(-p.x.signum(), 0.0) };
        let (opposite, own) = (Point2::new(0.025, 0.0), Point2::new(-0.025, 0.0));
        for start in [-0.2, -0.03, 0.0, 0.01] {
            let moved = settled(opposite, Point2::new(start, 0.0), Vector2::y(), &field);
            assert!((moved - own).norm() < 1e-9, "{start}: {moved}");
        }
        assert_eq!(settled(own, Point2::new(0.0, 0.0), Vector2::y(), &field), own);
    }

    #[test]
    fn a_zero_that_bends_sharply_is_followed_in_short_steps() {
        // The upper left quadrant with its corner rounded by 5 micrometres.
        let field = |p: Point2| {
            let (x, y) = (p.x, -p.y);
            let apart = (x - y).hypot(0.01);
            let slope = Vector2::new(0.5 + 0.5 * (x - y) / apart, -0.5 + 0.5 * (x - y) / apart);
            Jet { value: 0.5 * (x + y + apart), slope }
        };
        let start = project(&field, Point2::new(-1.0, 0.0), 0.1);
        let (mut at, mut n, mut length_mm) = (start, 0, 0.0);
        while at.y < 1.0 && n < 1000 {
            let slope = field(at).slope.normalize();
            let (next, step_mm) =
                stepped(&field, at, Vector2::new(-slope.y, slope.x), [0.1, 1e-5]).expect("a way on");
            assert!(field(next).value.abs() <= ON_ZERO && step_mm <= 0.1);
            length_mm += (next - at).norm();
            (at, n) = (next, n + 1);
        }
        assert!((length_mm - (at.y - start.x)).abs() < 0.02 && n < 100, "{length_mm} mm in {n} steps");
    }

    #[test]
    fn a_steep_field_costs_no_more_than_its_contour_is_long() {
        let n_asked = std::cell::Cell::new(0usize);
        let field = |p: Point2| {
            n_asked.set(n_asked.get() + 1);
            Jet { value: 20.0 * (p.coords.norm() - 1.0), slope: p.coords.normalize() * 20.0 }
        };
        let bounds = Bounds2 { min: Point2::new(-1.5, -1.5), max: Point2::new(1.5, 1.5) };
        let step_mm = 0.004;
        let [found] = &contours(&field, bounds, step_mm)[..] else { panic!("one disk") };
        assert!((found.signed_area_mm2() - std::f64::consts::PI).abs() < 1e-4);
        let steps = found.perimeter_mm() / step_mm;
        assert!((n_asked.get() as f64) < 40.0 * steps, "{} for {steps} steps", n_asked.get());
    }

    #[test]
    fn two_disks_and_a_hole_are_found_on_the_zero() {
        let disk = |p: Point2, x: f64, r: f64| {
            let d = p - Point2::new(x, 0.3);
            Jet { value: d.norm() - r, slope: d / d.norm().max(1e-12) }
        };
        let lower = |a: Jet, b: Jet| if a.value < b.value { a } else { b };
        let field = |p: Point2| {
            let hole = disk(p, 0.2, 0.8);
            let ring = [disk(p, 0.0, 2.0), Jet { value: -hole.value, slope: -hole.slope }];
            let ring = if ring[0].value > ring[1].value { ring[0] } else { ring[1] };
            lower(ring, disk(p, 4.2, 1.5))
        };
        let bounds = Bounds2 { min: Point2::new(-4.0, -4.0), max: Point2::new(8.0, 4.0) };
        let found = contours(&field, bounds, 0.11);
        assert_eq!(found.len(), 3);
        let area: f64 = found.iter().map(Contour::signed_area_mm2).sum();
        let expected = std::f64::consts::PI * (4.0 - 0.64 + 2.25);
        assert!((area - expected).abs() < 0.02, "{area} {expected}");
        assert!(found.iter().flat_map(|c| &c.points).all(|&p| field(p).value.abs() < 1e-7));
    }
}
