//! How much two components of neighbouring planes share, where they are and where their branches' drift takes them.

use crate::geom::{Bounds2, Contour, Point2, Region, Vector2};

/// A connected part of a plane: lumen within an outer contour, or a hole in it.
#[derive(Debug, Clone)]
pub(super) struct Component {
    /// The contour around it first, counter-clockwise; then what is missing inside, clockwise.
    pub(super) region: Region,
    pub(super) bounds: Bounds2,
    pub(super) area_mm2: f64,
    /// Of what the contour around it encloses, so that an opening hole moves nothing.
    pub(super) centre: Point2,
}

impl Component {
    pub(super) fn new(region: Region) -> Self {
        let around = &region.contours[0];
        let bounds = around.bounds().expect("a checked contour has points");
        let (area_mm2, centre) = (region.area_mm2(), around.centroid());
        Self { region, bounds, area_mm2, centre }
    }

    /// The radius of the circle of the same area, mm.
    pub(super) fn radius_mm(&self) -> f64 {
        (self.area_mm2.max(0.0) / std::f64::consts::PI).sqrt()
    }

    /// The area shared with another component, moved by `shift` first, as a share of the smaller one.
    pub(super) fn shared(&self, shift: Vector2, other: &Self) -> f64 {
        let moved = Bounds2 { min: self.bounds.min + shift, max: self.bounds.max + shift };
        if !moved.meets(other.bounds) {
            return 0.0;
        }
        let smaller = self.area_mm2.min(other.area_mm2);
        if smaller <= 0.0 {
            return 0.0;
        }
        (overlap_mm2(&moved_by(&self.region, shift), &other.region) / smaller).clamp(0.0, 1.0)
    }

    /// The share of this component, moved by `shift`, that lies outside everything in `filled`.
    pub(super) fn share_outside(&self, shift: Vector2, filled: &Region) -> f64 {
        let inside = overlap_mm2(&moved_by(&self.region, shift), filled);
        (1.0 - inside / self.area_mm2.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0)
    }
}

fn moved_by(region: &Region, shift: Vector2) -> Region {
    let moved = |c: &Contour| Contour::new(c.points.iter().map(|p| p + shift).collect());
    Region::new(region.contours.iter().map(moved).collect())
}

pub(super) fn overlap_mm2(a: &Region, b: &Region) -> f64 {
    a.intersection(b).area_mm2()
}
