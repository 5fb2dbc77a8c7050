//! The height at which two sheets of the outer skin part, however nearly parallel they are.
//!
//! At every height the common distance to both sheets, along the line on which they are equally far, is least in the
//! neck; the apex of the crease is where that is t. Nested roots: across the gap, along it, in height.

use super::crease::CreaseBuilder;
use super::feet::Foot;
use super::trace::at_height;
use crate::geom::{Point2, Point3, Vector2};
use crate::solid::event::EventPlanes;
use crate::solid::slab::root;
use std::cell::Cell;

/// Steps towards equal distances.
const MOST_STEPS: usize = 8;
/// How far to either side the neck is looked for, in radii.
const REACH: f64 = 0.35;

/// A point between two sheets.
#[derive(Debug, Clone, Copy)]
pub(super) struct Neck {
    pub(super) at: Point3,
    pub(super) feet: [Foot; 2],
    /// Horizontal direction from the first sheet to the second.
    pub(super) across: Vector2,
}

impl Neck {
    /// The distance to both sheets, mm.
    fn distance_mm(&self) -> f64 {
        0.5 * (self.feet[0].distance_mm + self.feet[1].distance_mm)
    }

    /// How the common distance changes along the gap.
    fn slope(&self) -> f64 {
        let left = Vector2::new(-self.across.y, self.across.x);
        let [a, b] = self.feet.map(|f| f.normal.xy());
        let apart = (a - b).dot(&self.across);
        let shift = if apart.abs() > 1e-9 { -(a - b).dot(&left) / apart } else { 0.0 };
        a.dot(&left) + a.dot(&self.across) * shift
    }
}

/// The point near `p` at height z that is equally far from both sheets, looked for across the gap.
fn equalised(crease: &CreaseBuilder<'_>, p: Point2, z: f64, from: &Neck) -> Neck {
    let mut neck = Neck { at: at_height(p, z), ..*from };
    for _ in 0..MOST_STEPS {
        neck.feet = neck.feet.map(|f| crease.feet().foot_beside(neck.at, f.at));
        let [a, b] = neck.feet;
        let error = a.distance_mm - b.distance_mm;
        let slope = (a.normal - b.normal).xy().dot(&neck.across);
        if error.abs() < 1e-9 || slope < 0.05 {
            break;
        }
        let most = 0.5 * crease.tracer.wall_mm;
        let step = neck.across * (-error / slope).clamp(-most, most);
        neck.at = at_height(neck.at.xy() + step, z);
    }
    neck
}

/// The neck at a height.
fn at_level(crease: &CreaseBuilder<'_>, w: f64, from: &Neck, reach_mm: f64) -> Neck {
    let z = crease.sign * w;
    let left = Vector2::new(-from.across.y, from.across.x);
    let origin = equalised(crease, from.at.xy(), z, from);
    let last = Cell::new(origin);
    let slope = |y: f64| {
        last.set(equalised(crease, origin.at.xy() + left * y, z, &origin));
        last.get().slope()
    };
    let y = root(slope, -reach_mm, reach_mm);
    equalised(crease, origin.at.xy() + left * y, z, &origin)
}

/// The apex with both feet; `None` where the branches do not part between the planes.
pub(super) fn apex(
    crease: &CreaseBuilder<'_>,
    planes: &EventPlanes,
    start: Neck,
    radius_mm: f64,
) -> Option<(Point3, [Foot; 2])> {
    let wall_mm = crease.tracer.wall_mm;
    let reach_mm = REACH * radius_mm;
    let gap = |neck: &Neck| neck.distance_mm() - wall_mm;
    let mut above = None;
    let mut from = start;
    for plane in &planes.daughters {
        from = at_level(crease, plane.w, &from, reach_mm);
        if gap(&from) > 0.0 {
            above = Some((plane.w, from));
            break;
        }
    }
    let (high, mut from) = above?;
    let open = from;
    let mut below = None;
    for plane in planes.parents.iter().filter(|p| p.w < high) {
        from = at_level(crease, plane.w, &from, reach_mm);
        if gap(&from) < 0.0 {
            below = Some(plane.w);
            break;
        }
    }
    let last = Cell::new(open);
    let value = |w: f64| {
        let neck = at_level(crease, w, &last.get(), reach_mm);
        last.set(neck);
        gap(&neck)
    };
    let w = root(value, below?, high);
    let neck = at_level(crease, w, &last.get(), reach_mm);
    (gap(&neck).abs() < 1e-4 * wall_mm).then_some((neck.at, neck.feet))
}
