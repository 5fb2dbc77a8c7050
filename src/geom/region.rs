//! A set of points of a plane bounded by closed contours, with boolean operations and offsets.
//!
//! Operations run on an integer grid of 10 nm through `i_overlay`: one fixed grid for all, because a grid that
//! is derived from the bounding box would give other digits as soon as something unrelated lies in the plane.
//! The 64-bit engine is used, so the size of the plane is no limit in practice (4.6e10 mm).

use super::{Bounds2, Contour, Point2};
use i_overlay::core::fill_rule::FillRule;
use i_overlay::core::overlay_rule::OverlayRule;
use i_overlay::core::single::SingleIntOverlay;
use i_overlay::i_float::int::angle::Angle;
use i_overlay::i_float::int::point::IntPoint;
use i_overlay::mesh::int::arc::ArcOptions;
use i_overlay::mesh::int::outline::offset::IntOutlineOffset;
use i_overlay::mesh::int::style::{IntLineJoin, IntOutlineStyle};

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
        let mut style = IntOutlineStyle::<i32>::new(steps(distance_mm));
        style.join = IntLineJoin::Round(ArcOptions {
            max_step: arc_step(distance_mm, tolerance_mm),
            rotation_precision: 12,
        });
        let contours: Vec<IntContour> = self.contours.iter().map(to_grid).collect();
        let shapes = contours.outline(&style).unwrap_or_default();
        from_grid(shapes)
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

/// The angle whose chord on a circle of the given radius stays within the tolerance.
fn arc_step(distance_mm: f64, tolerance_mm: f64) -> Angle {
    let ratio = (1.0 - tolerance_mm / distance_mm.abs().max(tolerance_mm)).clamp(-1.0, 1.0);
    let turns = 2.0 * ratio.acos() / std::f64::consts::TAU;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "an eighth of a turn at most: it fits"
    )]
    let bits = (turns.clamp(1.0 / 1024.0, 0.125) * 2f64.powi(32)) as u32;
    Angle::from_bits(bits)
}

#[expect(clippy::cast_possible_truncation, reason = "rounded to the grid on purpose; a float cast saturates")]
fn steps(mm: f64) -> i32 {
    (mm * STEPS_PER_MM).round() as i32
}

fn to_grid(contour: &Contour) -> IntContour {
    contour.points.iter().map(|p| IntPoint::new(steps(p.x), steps(p.y))).collect()
}

#[expect(clippy::cast_precision_loss, reason = "coordinates are far below 2^53 grid steps")]
fn from_grid(shapes: Vec<Vec<IntContour>>) -> Region {
    let point = |p: IntPoint<i32>| Point2::new(p.x as f64 / STEPS_PER_MM, p.y as f64 / STEPS_PER_MM);
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
    fn offset_of_a_disk_is_a_disk() {
        for d in [-0.7, 0.45, 1.0] {
            let grown = disk(3.0, 2.0).offset(d, 1e-4);
            let radius = (grown.area_mm2() / std::f64::consts::PI).sqrt();
            assert!((radius - 2.0 - d).abs() < 2e-4, "offset {d}: radius {radius}");
        }
        assert!(disk(0.0, 2.0).offset(-2.1, 1e-3).is_empty());
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
