//! What an event is built from: the contours around it and the implicit surface through them.
//!
//! Everything is seen along w, the height rising towards the daughters: w = z for a split, w = -z for a merge.
//! An [`EventSource`] is the implicit surface around the event. The saddle point of its field is the apex of the
//! crotch; in a thin slab round it the published three patches are built on the field ([`super::slab`]).

use super::grid::Jet;
use crate::geom::{Bounds2, Contour, Point2, Vector2};
use crate::spline::SplineError;

pub use super::slab::{Crotch, Slab};

/// How much finer grids are tried where contours are missed.
const FINER_GRIDS: [f64; 2] = [3.0, 9.0];

/// The contours of one plane that take part in an event, and its height rising towards the daughters.
#[derive(Debug, Clone)]
pub(super) struct Plane {
    pub(super) w: f64,
    pub(super) contours: Vec<Contour>,
}

/// The planes around an event.
#[derive(Debug, Clone)]
pub(super) struct EventPlanes {
    /// The parent's planes, the nearest to the event first; one contour each.
    pub(super) parents: Vec<Plane>,
    /// The daughters' planes, the nearest first; one contour a daughter, always in the same order.
    pub(super) daughters: Vec<Plane>,
    /// What the daughters part into right behind their nearest plane.
    pub(super) beyond: Option<Beyond>,
    /// Planes behind the daughters' next event, the nearest first, where all of them have joined again in one contour.
    pub(super) rejoined: Vec<Plane>,
}

/// Planes behind the next events, the nearest first.
#[derive(Debug, Clone)]
pub(super) struct Beyond {
    /// One contour a branch, always in the same order.
    pub(super) planes: Vec<Plane>,
    /// The daughter that each of them comes from.
    pub(super) daughter_of: Vec<usize>,
}

impl EventPlanes {
    /// Mean radius of the daughters by area, on their nearest plane.
    pub(super) fn mean_radius_mm(&self) -> f64 {
        let contours = &self.daughters[0].contours;
        let radius = |c: &Contour| (c.signed_area_mm2().abs() / std::f64::consts::PI).sqrt();
        contours.iter().map(radius).sum::<f64>() / contours.len() as f64
    }

    /// The box around all contours.
    pub(super) fn bounds(&self) -> Option<Bounds2> {
        let all = self.parents.iter().chain(&self.daughters).flat_map(|p| &p.contours);
        all.filter_map(Contour::bounds).reduce(Bounds2::union)
    }
}

/// The part of the plane in which a field is looked at.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    /// The field is positive on its border.
    pub(super) bounds: Bounds2,
    /// Fine enough for the smallest branch and for the gap at the apex.
    pub(super) step_mm: f64,
}

/// The implicit surface around an event: negative inside.
pub(super) trait EventSource: Sync {
    /// The field, near to a signed distance, mm.
    fn value(&self, p: Point2, w: f64) -> f64;
    /// The field with its gradient in the plane.
    fn jet(&self, p: Point2, w: f64) -> Jet {
        const H: f64 = 1e-4;
        let along = |d: Vector2| (self.value(p + d, w) - self.value(p - d, w)) / (2.0 * H);
        let slope = Vector2::new(along(Vector2::new(H, 0.0)), along(Vector2::new(0.0, H)));
        Jet { value: self.value(p, w), slope }
    }
    /// The field in the plane at height w, with what depends on the height alone computed once.
    fn slice(&self, w: f64) -> Box<dyn Fn(Point2) -> Jet + '_> {
        Box::new(move |p| self.jet(p, w))
    }
    /// Where the field is known well enough to be searched for every critical point; `None` where it is too costly.
    fn frame(&self) -> Option<Frame> {
        None
    }
    /// Its closed zero contours at height w, the inside to the left; where they are looked for on a grid, on one so many
    /// times as fine as usual.
    fn contours_on(&self, w: f64, finer: f64) -> Vec<Contour>;
    /// Its closed zero contours at height w, the inside to the left.
    fn contours(&self, w: f64) -> Vec<Contour> {
        self.contours_on(w, 1.0)
    }
    /// Moves a point that is nearly on the zero at height w onto it.
    fn refine(&self, p: Point2, w: f64) -> Point2;
    /// A point inside daughter i at height w.
    fn anchor(&self, i: usize, w: f64) -> Point2;
}

/// The contours of a source at a height of which there should be `n`. A neck or a gap narrower than the grid on which they
/// are looked for is not seen on it: where there are more or fewer, finer ones are tried.
pub(super) fn contours_expected(source: &dyn EventSource, w: f64, n: impl Fn(usize) -> bool) -> Vec<Contour> {
    let usual = source.contours(w);
    if n(usual.len()) || source.frame().is_none() {
        return usual;
    }
    contours_finer(source, w, n).unwrap_or(usual)
}

/// The contours on the first finer grid that shows as many as there should be.
pub(super) fn contours_finer(
    source: &dyn EventSource,
    w: f64,
    n: impl Fn(usize) -> bool,
) -> Option<Vec<Contour>> {
    FINER_GRIDS.iter().map(|finer| source.contours_on(w, *finer)).find(|found| n(found.len()))
}

/// Why an event could not be built.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum EventFault {
    /// The apex is not where the sections say it must be.
    #[error("the crotch cannot be located between the planes")]
    NoApex,
    /// A contour was lost between the planes.
    #[error("a contour cannot be followed between the planes at z {z_mm:.3} mm")]
    Lost {
        /// Where.
        z_mm: f64,
    },
    /// Three or more branches part at one height.
    #[error(
        "more than two branches part at the same height: move one of the contours a little, or add a plane"
    )]
    Simultaneous,
    /// The sections beside the apex do not have the expected number of contours.
    #[error("{found} contours where {expected} were expected beside the crotch")]
    Components {
        /// Contours found.
        found: usize,
        /// Contours expected.
        expected: usize,
    },
    /// The plane through the crotch does not cut the parent's contour on both sides.
    #[error("the contour beside the crotch does not pass it on both sides")]
    NoWaist,
    /// Surfaces cannot be interpolated.
    #[error(transparent)]
    Spline(#[from] SplineError),
}

#[cfg(test)]
mod tests {
    use super::super::iso;
    use super::*;

    /// A disk of 2 mm radius, cut in two by a slit 0.03 mm wide between the nodes of the usual grid.
    struct Cut;

    impl EventSource for Cut {
        fn value(&self, p: Point2, _w: f64) -> f64 {
            (p.coords.norm() - 2.0).max(0.015 - (p.x - 0.03).abs())
        }

        fn frame(&self) -> Option<Frame> {
            let bounds = Bounds2 { min: Point2::new(-2.4, -2.4), max: Point2::new(2.4, 2.4) };
            Some(Frame { bounds, step_mm: 0.2 })
        }

        fn contours_on(&self, w: f64, finer: f64) -> Vec<Contour> {
            let Frame { bounds, step_mm } = self.frame().expect("a grid");
            iso::contours(&*self.slice(w), bounds, step_mm / finer)
        }

        fn refine(&self, p: Point2, _w: f64) -> Point2 {
            p
        }

        fn anchor(&self, _i: usize, _w: f64) -> Point2 {
            Point2::origin()
        }
    }

    #[test]
    fn a_gap_narrower_than_the_grid_is_found_where_two_contours_are_expected() {
        assert_eq!(Cut.contours(0.0).len(), 1);
        assert_eq!(contours_expected(&Cut, 0.0, |n| n == 2).len(), 2);
        assert_eq!(contours_expected(&Cut, 0.0, |n| n == 1).len(), 1);
        // Where no grid shows what is expected the usual one counts.
        assert_eq!(contours_expected(&Cut, 0.0, |n| n == 5).len(), 1);
    }
}
