//! Holes of a ring-shaped lumen that the outer skin passes over.
//!
//! The outer skin has outlines only, no holes: what a ring of lumen encloses is all wall. That is right where no point of it
//! is farther than t from the lumen. Where one is, the hole should stay open; the place is told.

use super::lumen::is_hole;
use crate::ct::Warning;
use crate::geom::{Bounds2, Contour, Point2, SegmentIndex, Vector2};
use crate::solid::skin::{Skin, Tube};

/// Heights of a hole at which it is looked at, and points across it, each way.
const HEIGHTS: u32 = 32;
const ACROSS: u32 = 16;
/// How much farther than t a point must be from the lumen, in t, to be told: below it is rounding.
const SLACK: f64 = 0.01;

/// A warning for each hole that is wider than twice the wall and yet filled.
pub(super) fn filled(lumen: &Skin, wall_mm: f64) -> Vec<Warning> {
    let holes = lumen.tubes.iter().filter(|tube| is_hole(tube));
    let widest = holes.filter_map(|hole| Some((hole, Layers::of(hole).middle()?)));
    let told = widest.filter(|(_, middle)| middle.distance_mm > (1.0 + SLACK) * wall_mm);
    told.map(|(hole, middle)| warning(hole, middle, wall_mm)).collect()
}

fn warning(hole: &Tube, Middle { at, z_mm, distance_mm }: Middle, wall_mm: f64) -> Warning {
    let [low, high] = hole.surface.z_range_mm();
    let text = format!(
        "outer skin of the wall: the hole of the lumen from z {low:.2} to {high:.2} mm is filled although its middle (x {:.2}, \
         y {:.2}, z {z_mm:.2}) is {distance_mm:.2} mm from the lumen and the wall {wall_mm} mm thick: the wall there is \
         thicker than asked for",
        at.x, at.y
    );
    Warning { code: "solid.hole_filled".into(), text }
}

/// The point of a hole that is farthest from the lumen.
struct Middle {
    at: Point2,
    z_mm: f64,
    distance_mm: f64,
}

/// Sections of a hole.
struct Layers(Vec<(f64, Bounds2, SegmentIndex)>);

impl Layers {
    fn of(hole: &Tube) -> Self {
        let [low, high] = hole.surface.z_range_mm();
        let layer = |k: u32| {
            let z_mm = low + (high - low) * (f64::from(k) + 0.5) / f64::from(HEIGHTS);
            let contour = Contour::new(hole.surface.section(z_mm).points()).reversed();
            Some((z_mm, contour.bounds()?, SegmentIndex::try_new(&[contour])?))
        };
        Self((0..HEIGHTS).filter_map(layer).collect())
    }

    /// Distance from the lumen: in the sections above and below, too, where the hole may be closed.
    fn distance_mm(&self, p: Point2, z_mm: f64) -> f64 {
        let to = |(z, _, outline): &(f64, Bounds2, SegmentIndex)| {
            (-outline.signed_distance_mm(p)).max(0.0).hypot(z - z_mm)
        };
        self.0.iter().map(to).fold(f64::INFINITY, f64::min)
    }

    fn middle(&self) -> Option<Middle> {
        let share = |k: u32| (f64::from(k) + 0.5) / f64::from(ACROSS);
        let grid = |bounds: Bounds2| {
            let place =
                move |i, j| bounds.min + bounds.size().component_mul(&Vector2::new(share(i), share(j)));
            (0..ACROSS).flat_map(move |i| (0..ACROSS).map(move |j| place(i, j)))
        };
        let points = self.0.iter().flat_map(|(z_mm, bounds, _)| grid(*bounds).map(|at| (*z_mm, at)));
        let all = points.map(|(z_mm, at)| Middle { at, z_mm, distance_mm: self.distance_mm(at, z_mm) });
        all.max_by(|a, b| a.distance_mm.total_cmp(&b.distance_mm))
    }
}
