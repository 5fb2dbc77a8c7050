//! A set of points of a plane bounded by closed contours, with boolean operations and offsets.
//!
//! Operations run on an integer grid of 10 nm through `i_overlay`: one fixed grid for all, because a grid that
//! is derived from the bounding box would give other digits as soon as something unrelated lies in the plane.
//! The 32-bit engine holds 10 m either side of the origin; what lies farther out is moved to that border, so
//! input is checked for size before it comes here.

use super::offset::Offset;
use super::{Bounds2, Contour, Point2, SegmentIndex};
use geo::ConvexHull;
use i_overlay::core::fill_rule::FillRule;
use i_overlay::core::overlay_rule::OverlayRule;
use i_overlay::core::single::SingleIntOverlay;
use i_overlay::i_float::int::point::IntPoint;

/// Grid steps per millimetre: 10 nm a step.
const STEPS_PER_MM: f64 = 1e5;

type IntContour = Vec<IntPoint<i32>>;

/// A region of a plane: outer contours counter-clockwise, holes clockwise, none crossing. mm.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Region {
    /// The boundary.
    pub contours: Vec<Contour>,
}

impl Region {
    /// The region bounded by contours that are already oriented and do not cross.
    #[must_use]
    pub const fn new(contours: Vec<Contour>) -> Self {
        Self { contours }
    }

    /// The region that contours of any direction enclose by the even-odd rule.
    #[must_use]
    pub fn from_even_odd(contours: &[Contour]) -> Self {
        combine(contours, &[], OverlayRule::Subject, FillRule::EvenOdd)
    }

    /// The region around which directed contours wind more often counter-clockwise than clockwise: where a hole reaches
    /// beyond the contour around it, nothing is left, and nothing is added outside.
    #[must_use]
    pub fn from_winding(contours: &[Contour]) -> Self {
        combine(contours, &[], OverlayRule::Subject, FillRule::Positive)
    }

    /// Whether the region holds no point.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.contours.is_empty()
    }

    /// Area, mm².
    #[must_use]
    pub fn area_mm2(&self) -> f64 {
        self.contours.iter().map(Contour::signed_area_mm2).sum()
    }

    /// The smallest box around the region.
    #[must_use]
    pub fn bounds(&self) -> Option<Bounds2> {
        self.contours.iter().filter_map(Contour::bounds).reduce(Bounds2::union)
    }

    /// Whether the point lies inside.
    #[must_use]
    pub fn contains(&self, p: Point2) -> bool {
        self.contours.iter().filter(|c| c.contains(p)).count() % 2 == 1
    }

    /// All points of either region.
    #[must_use]
    pub fn union(&self, other: &Self) -> Self {
        combine(&self.contours, &other.contours, OverlayRule::Union, FillRule::NonZero)
    }

    /// All points of both regions.
    #[must_use]
    pub fn intersection(&self, other: &Self) -> Self {
        combine(&self.contours, &other.contours, OverlayRule::Intersect, FillRule::NonZero)
    }

    /// All points of this region that are not in the other.
    #[must_use]
    pub fn difference(&self, other: &Self) -> Self {
        combine(&self.contours, &other.contours, OverlayRule::Difference, FillRule::NonZero)
    }

    /// The union of many regions in one pass.
    #[must_use]
    pub fn union_all<'a>(regions: impl IntoIterator<Item = &'a Self>) -> Self {
        let all: Vec<Contour> = regions.into_iter().flat_map(|r| r.contours.iter().cloned()).collect();
        combine(&all, &[], OverlayRule::Subject, FillRule::NonZero)
    }

    /// The region grown (positive) or shrunk (negative) by `distance_mm`, convex corners rounded.
    ///
    /// `tolerance_mm` bounds the chord error of the rounded corners.
    #[must_use]
    pub fn offset(&self, distance_mm: f64, tolerance_mm: f64) -> Self {
        if distance_mm.abs() * STEPS_PER_MM < 0.5 {
            return self.clone();
        }
        let Some(index) = SegmentIndex::try_new(&self.contours) else { return Self::default() };
        let offset = Offset { distance_mm, tolerance_mm };
        let trimmed: Vec<Contour> = self.contours.iter().filter_map(|c| offset.trimmed(c, &index)).collect();
        let mut cleaned = cleaned(&trimmed);
        // A loop between two trimmed runs may keep a positive winding; none of its vertices has the distance.
        cleaned.contours.retain(|c| c.points.iter().any(|&p| offset.admits(&index, p)));
        cleaned
    }

    /// The region with all that it encloses; what lies in a hole of it is part of that.
    #[must_use]
    pub fn without_holes(&self) -> Self {
        let outers: Vec<Contour> = self.contours.iter().filter(|c| c.is_ccw()).cloned().collect();
        match outers.len() {
            0 | 1 => Self::new(outers),
            // An outline in a hole of another one is not counted twice.
            _ => combine(&outers, &[], OverlayRule::Subject, FillRule::NonZero),
        }
    }

    /// The smallest convex region around it; empty where it has no area.
    #[must_use]
    pub fn convex_hull(&self) -> Self {
        let points = self.contours.iter().flat_map(|c| &c.points).map(|p| geo::Coord { x: p.x, y: p.y });
        let hull = geo::LineString::from(points.collect::<Vec<_>>()).convex_hull();
        let mut corners: Vec<Point2> = hull.exterior().coords().map(|c| Point2::new(c.x, c.y)).collect();
        // A ring repeats its first corner.
        corners.pop();
        let contour = Contour::new(corners);
        if contour.signed_area_mm2() > 0.0 { Self::new(vec![contour]) } else { Self::default() }
    }

    /// The least distance of two parallel lines that have the region between them, mm: one of them then lies on an edge of
    /// the convex hull. Infinite where there is no area.
    #[must_use]
    pub fn least_width_mm(&self) -> f64 {
        let hull = self.convex_hull();
        let edges = hull.contours.iter().flat_map(Contour::edges).filter(|(a, b)| a != b);
        let width = |(a, b): (Point2, Point2)| {
            let along = b - a;
            let off = |p: &Point2| along.perp(&(p - a)).abs() / along.norm();
            hull.contours.iter().flat_map(|c| &c.points).map(off).fold(0.0, f64::max)
        };
        edges.map(width).fold(f64::INFINITY, f64::min)
    }

    /// The union of regions, each grown by its own positive distance, in one boolean pass. Every region comes with
    /// the index of its contours.
    ///
    /// `tolerance_mm` bounds the chord error of the rounded corners.
    #[must_use]
    pub fn union_of_grown<'a>(
        parts: impl IntoIterator<Item = (&'a Self, &'a SegmentIndex, f64)>,
        tolerance_mm: f64,
    ) -> Self {
        let grown: Vec<Contour> = parts
            .into_iter()
            .flat_map(|(region, index, distance_mm)| {
                let offset = Offset { distance_mm, tolerance_mm };
                region.contours.iter().filter_map(move |c| offset.trimmed(c, index))
            })
            .collect();
        cleaned(&grown)
    }

    /// The outer contours, each with the holes that lie in it.
    #[must_use]
    pub fn islands(&self) -> Vec<Self> {
        let (outers, holes): (Vec<_>, Vec<_>) = self.contours.iter().partition(|c| c.is_ccw());
        let mut islands: Vec<Self> = outers.into_iter().map(|c| Self::new(vec![c.clone()])).collect();
        for hole in holes {
            let Some(&inside) = hole.points.first() else { continue };
            let area = |i: &&mut Self| i.contours[0].signed_area_mm2();
            let owner = islands.iter_mut().filter(|i| i.contours[0].contains(inside));
            if let Some(owner) = owner.min_by(|a, b| area(a).total_cmp(&area(b))) {
                owner.contours.push(hole.clone());
            }
        }
        islands
    }
}

/// What raw offsets enclose. Where an edge is shorter than what its two ends lose, it runs back, and beside a corner that hardly turns it
/// lies on the next edge: rounded to the grid, that may enclose a sliver, and be left as a spike.
fn cleaned(raw: &[Contour]) -> Region {
    let mut region = combine(raw, &[], OverlayRule::Subject, FillRule::Positive);
    region.contours.iter_mut().for_each(without_spikes);
    region.contours.retain(|contour| contour.len() >= 3);
    region
}

/// Takes out vertices at which a contour turns back upon itself.
fn without_spikes(contour: &mut Contour) {
    let mut kept: Vec<Point2> = Vec::with_capacity(contour.len());
    for &p in &contour.points {
        while let [.., a, b] = kept[..]
            && is_spike(a, b, p)
        {
            kept.pop();
        }
        kept.push(p);
    }
    while let [first, second, .., a, b] = kept[..] {
        if is_spike(a, b, first) {
            kept.pop();
        } else if is_spike(b, first, second) {
            kept.remove(0);
        } else {
            break;
        }
    }
    contour.points = kept;
}

/// Whether the way from `a` over `b` to `c` comes back within what rounding to the grid moves.
fn is_spike(a: Point2, b: Point2, c: Point2) -> bool {
    let (there, back) = (b - a, c - b);
    let longer_mm = there.norm().max(back.norm());
    there.dot(&back) < 0.0 && there.perp(&back).abs() <= SPIKE_MM * longer_mm
}

/// Wider spikes are features, mm: two steps of the grid.
const SPIKE_MM: f64 = 2.0 / STEPS_PER_MM;

/// The border of the 32-bit engine's coordinates.
const MOST_STEPS: f64 = 1_073_741_823.0;

#[expect(
    clippy::cast_possible_truncation,
    reason = "rounded to the grid and clamped to its border on purpose"
)]
fn steps(mm: f64) -> i32 {
    (mm * STEPS_PER_MM).round().clamp(-MOST_STEPS, MOST_STEPS) as i32
}

fn to_grid(contour: &Contour) -> IntContour {
    contour.points.iter().map(|p| IntPoint::new(steps(p.x), steps(p.y))).collect()
}

fn from_grid(shapes: Vec<Vec<IntContour>>) -> Region {
    let point = |p: IntPoint<i32>| Point2::new(f64::from(p.x), f64::from(p.y)) / STEPS_PER_MM;
    let contour = |c: IntContour| Contour::new(c.into_iter().map(point).collect());
    Region::new(shapes.into_iter().flatten().map(contour).collect())
}

fn combine(subject: &[Contour], clip: &[Contour], rule: OverlayRule, fill: FillRule) -> Region {
    let grid = |contours: &[Contour]| contours.iter().map(to_grid).collect::<Vec<IntContour>>();
    from_grid(grid(subject).overlay(&grid(clip), rule, fill))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Vector2;

    fn disk(x: f64, radius_mm: f64) -> Region {
        Region::new(vec![Contour::circle(Point2::new(x, 0.0), radius_mm, 720)])
    }

    #[test]
    fn areas_of_union_and_intersection_add_up() {
        let (a, b) = (disk(0.0, 2.0), disk(1.5, 1.0));
        let sum = a.union(&b).area_mm2() + a.intersection(&b).area_mm2();
        assert!((sum - a.area_mm2() - b.area_mm2()).abs() < 1e-4);
        assert!((a.difference(&b).area_mm2() - a.area_mm2() + a.intersection(&b).area_mm2()).abs() < 1e-4);
    }

    #[test]
    fn a_hole_that_reaches_beyond_its_contour_adds_nothing() {
        let hole = |x: f64, radius_mm: f64| disk(x, radius_mm).contours[0].reversed();
        let outer = || disk(0.0, 2.0).contours[0].clone();
        let crescent = Region::from_winding(&[outer(), hole(1.5, 1.0)]);
        assert!((crescent.area_mm2() - disk(0.0, 2.0).difference(&disk(1.5, 1.0)).area_mm2()).abs() < 1e-4);
        assert!(Region::from_winding(&[outer(), hole(0.0, 2.001)]).is_empty());
        // A body in the hole is another one.
        let nested = Region::from_winding(&[outer(), hole(0.0, 1.5), disk(0.0, 0.5).contours[0].clone()]);
        assert_eq!((nested.contours.len(), nested.islands().len()), (3, 2));
    }

    #[test]
    fn offset_of_a_disk_is_a_disk() {
        for d in [-0.7, 0.45, 1.0] {
            let grown = disk(3.0, 2.0).offset(d, 1e-4);
            let radius = (grown.area_mm2() / std::f64::consts::PI).sqrt();
            assert!((radius - 2.0 - d).abs() < 2e-4, "offset {d}: radius {radius}");
        }
        assert!(disk(0.0, 2.0).offset(-2.1, 1e-3).is_empty());
    }

    #[test]
    fn rounded_corners_shrink_beyond_their_radius_to_sharp_ones() {
        let square = |half: f64| {
            let corners = [(-half, -half), (half, -half), (half, half), (-half, half)];
            Region::new(vec![Contour::new(corners.map(|(x, y)| Point2::new(x, y)).to_vec())])
        };
        for tolerance_mm in [1e-4, 1e-3, 1e-2] {
            // No vertex of the rounded corners' raw offset lies on the result, the middles of the sides do.
            let rounded = square(9.0).offset(0.2, tolerance_mm);
            for by in [0.5, 1.0, 9.0] {
                let shrunk = rounded.offset(-by, 1e-3);
                let expected = (18.4 - 2.0 * by) * (18.4 - 2.0 * by);
                assert!((shrunk.area_mm2() - expected).abs() < 1e-3, "{by} mm: {}", shrunk.area_mm2());
            }
        }
    }

    #[test]
    fn steps_back_of_a_hair_grow_no_spikes() {
        // As a mesh is cut: some vertices twice, a hair apart, now and then the wrong way round.
        let circle = Contour::circle(Point2::origin(), 3.0, 120).points;
        for hair_mm in [1e-6, 1e-5, 1e-4, 3e-4] {
            let twice = circle.iter().enumerate().flat_map(|(i, &p)| {
                let angle = 2.4 * i as f64;
                let other = p + Vector2::new(angle.cos(), angle.sin()) * hair_mm;
                [p, if i % 3 == 0 { other } else { p }]
            });
            let outline = Region::new(vec![Contour::new(twice.collect())]);
            for d in [-0.3, -0.1, -0.05, 0.05, 0.1, 0.3] {
                let moved = outline.offset(d, 1e-3);
                assert_eq!(moved.contours.len(), 1);
                let off = moved.contours[0].points.iter().map(|p| (p.coords.norm() - 3.0 - d).abs());
                let worst = off.fold(0.0, f64::max);
                // The circle's chords and those of the arcs are 0.001 mm off.
                assert!(worst < 5e-3, "hair {hair_mm} mm, moved by {d} mm: {worst} mm off");
            }
        }
    }

    #[test]
    fn an_offset_has_no_spike_beside_a_vertex_that_hardly_turns() {
        // Facets of a circle, each with a vertex near its begin: inward, what lies between the two is less than it loses.
        for share in [1e-5, 1e-4, 1e-3, 5e-3, 0.5, 0.995, 0.9999] {
            let circle = Contour::circle(Point2::origin(), 4.0, 128);
            let facet = |(a, b): (Point2, Point2)| [a, a + (b - a) * share];
            let outline = Contour::new(circle.edges().flat_map(facet).collect());
            for (contour, distance_mm) in
                [(outline.clone(), -0.05), (outline.clone(), 0.1), (outline.reversed(), 0.3)]
            {
                let around = Contour::circle(Point2::origin(), 9.0, 64);
                let contours = if contour.is_ccw() { vec![contour] } else { vec![around, contour] };
                let offset = Region::new(contours).offset(distance_mm, 1e-3);
                for c in &offset.contours {
                    let n = c.len();
                    let turn = |i: usize| {
                        let [a, b, c] = [0, 1, 2].map(|k| c.points[(i + k) % n]);
                        (b - a).angle(&(c - b))
                    };
                    let sharpest = (0..n).map(turn).fold(0.0, f64::max);
                    assert!(sharpest < 1.6, "{share}, {distance_mm} mm: a corner turns by {sharpest} rad");
                }
            }
        }
    }

    #[test]
    fn the_hull_of_disks_is_their_stadium() {
        let hull = disk(0.0, 2.0).union(&disk(5.0, 2.0)).convex_hull();
        let expected = 4.0 * std::f64::consts::PI + 20.0;
        assert!(hull.contours.len() == 1 && (hull.area_mm2() / expected - 1.0).abs() < 1e-3);
        assert!(Region::default().convex_hull().is_empty());
    }

    #[test]
    fn shrinking_parts_what_hangs_together_by_a_neck() {
        let dumbbell = disk(0.0, 2.0).union(&disk(3.0, 2.0));
        let parts = dumbbell.offset(-1.5, 1e-4);
        assert_eq!(parts.contours.len(), 2);
        // The waist is 2 sqrt(4 - 1.5^2) wide: offset by less than half of it, one part remains.
        assert_eq!(dumbbell.offset(-1.3, 1e-4).contours.len(), 1);
        let index = SegmentIndex::try_new(&dumbbell.contours).unwrap();
        let deep = (0..500 * 300).filter(|i| {
            let p = Point2::new(f64::from(i % 500) * 0.01 - 1.0, f64::from(i / 500) * 0.01 - 1.5);
            index.signed_distance_mm(p) <= -1.5
        });
        assert!((parts.area_mm2() - deep.count() as f64 * 1e-4).abs() < 0.01);
    }

    #[test]
    fn growing_joins_and_fills() {
        let ring = disk(0.0, 3.0).difference(&disk(0.0, 0.5));
        assert_eq!(ring.offset(0.6, 1e-4).contours.len(), 1);
        let joined = disk(0.0, 1.0).union(&disk(3.0, 1.0)).offset(0.7, 1e-4);
        let expected = disk(0.0, 1.7).union(&disk(3.0, 1.7));
        assert!((joined.area_mm2() - expected.area_mm2()).abs() < 2e-3);
        let square = Region::new(vec![Contour::new(
            [(0., 0.), (4., 0.), (4., 4.), (0., 4.)].map(|(x, y)| Point2::new(x, y)).to_vec(),
        )]);
        assert!((square.offset(1.0, 1e-5).area_mm2() - 32.0 - std::f64::consts::PI).abs() < 1e-3);
    }

    #[test]
    fn sharp_corners_shrink_to_sharp_corners() {
        let polygon = |corners: &[(f64, f64)]| {
            Region::new(vec![Contour::new(corners.iter().map(|&(x, y)| Point2::new(x, y)).collect())])
        };
        let square = polygon(&[(0., 0.), (4., 0.), (4., 4.), (0., 4.)]);
        assert!((square.offset(-1.0, 1e-4).area_mm2() - 4.0).abs() < 1e-3);
        assert!(square.offset(-2.1, 1e-4).is_empty());
        // A slender triangle: similar to itself, its inradius less by the distance.
        let triangle = polygon(&[(0., 0.), (40., 0.), (0., 3.)]);
        let inradius = 120.0 / (43.0 + 40f64.hypot(3.0));
        let expected = 60.0 * (1.0 - 0.5 / inradius).powi(2);
        assert!((triangle.offset(-0.5, 1e-4).area_mm2() - expected).abs() < 1e-2);
    }

    #[test]
    fn without_holes_what_lies_in_them_is_filled_once() {
        let ring = disk(0.0, 3.0).difference(&disk(0.0, 2.0));
        let both = ring.union(&disk(0.0, 1.0)).union(&disk(10.0, 1.0));
        let filled = both.without_holes();
        assert!(filled.contours.len() == 2 && filled.contains(Point2::new(0.5, 0.0)));
        let expected = disk(0.0, 3.0).area_mm2() + disk(10.0, 1.0).area_mm2();
        assert!((filled.area_mm2() - expected).abs() < 1e-3);
        assert!((ring.without_holes().area_mm2() - disk(0.0, 3.0).area_mm2()).abs() < 1e-3);
        assert!(Region::default().without_holes().is_empty());
    }

    #[test]
    fn islands_keep_their_holes() {
        let ring = disk(0.0, 3.0).difference(&disk(0.0, 2.0));
        let two = ring.union(&disk(10.0, 1.0)).union(&disk(0.0, 1.0));
        let islands = two.islands();
        assert_eq!(islands.len(), 3);
        assert!(
            islands.iter().any(|i| i.contours.len() == 2 && (i.area_mm2() - ring.area_mm2()).abs() < 1e-4)
        );
        assert!(two.contains(Point2::new(0.0, 0.0)) && !two.contains(Point2::new(1.5, 0.0)));
    }
}
