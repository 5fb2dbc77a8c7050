//! The field between planes by interpolating signed distances: for outlines that close round holes, whose shapes no
//! moving lobes describe, and where the lobe field does not fit.
//!
//! On each of the (two to four) planes around the interval the signed distance to all its contours is sampled on a
//! grid; between them it is interpolated in w by Lagrange's polynomial (G. T. Herman et al., "Shape-based
//! interpolation", 1992; cubic where there are four planes). Creases of the distances are rounded, so that saddles there
//! can be found; sections of the planes are met within a thousandth of the smallest radius.

use super::event::{EventPlanes, EventSource, Frame, Plane};
use super::grid::{Jet, SmoothGrid, bounded_step_mm};
use super::iso;
use crate::geom::{Bounds2, Contour, Point2, SegmentIndex, Vector2};
use crate::spline::ClosedCurve;
use rayon::prelude::*;

/// Steps of the grid to the smallest radius.
const STEPS: f64 = 14.0;
/// Planes on either side that take part.
const PLANES: usize = 2;
/// Vertices of the polygons whose distance is taken.
const POLYGON_POINTS: usize = 400;

#[derive(Debug)]
struct Layer {
    w: f64,
    distance: SmoothGrid,
}

/// Interpolated signed distances as an event's source.
#[derive(Debug)]
pub(super) struct DistanceSource {
    layers: Vec<Layer>,
    frame: Frame,
    anchors: Vec<Point2>,
}

impl DistanceSource {
    /// `None` where a contour is degenerate.
    pub(super) fn through(planes: &EventPlanes) -> Option<Self> {
        let near: Vec<&Plane> =
            planes.parents.iter().take(PLANES).chain(planes.daughters.iter().take(PLANES)).collect();
        let radius = |c: &Contour| (c.signed_area_mm2().abs() / std::f64::consts::PI).sqrt();
        let radii = near.iter().flat_map(|p| p.contours.iter().map(radius));
        let [least, most] = radii.fold([f64::INFINITY, 0.0f64], |[a, b], r| [a.min(r), b.max(r)]);
        // A tiny hole in a large vessel must not cost millions of nodes.
        let bounds = planes.bounds()?.grown(0.4 * most);
        let step = bounded_step_mm(bounds, least.max(0.15 * most) / STEPS);
        let mut layers: Vec<Layer> = near
            .par_iter()
            .map(|plane| {
                let index = index(plane)?;
                let distance =
                    SmoothGrid::smoothed(bounds.grown(step), step, |p| index.signed_distance_mm(p));
                Some(Layer { w: plane.w, distance })
            })
            .collect::<Option<_>>()?;
        layers.sort_by(|a, b| a.w.total_cmp(&b.w));
        let anchors = planes.daughters[0].contours.iter().map(Contour::centroid).collect();
        let frame = Frame { bounds, step_mm: bounded_step_mm(bounds, least.max(0.1 * most) / 16.0) };
        Some(Self { layers, frame, anchors })
    }

    /// Lagrange weights of the layers.
    fn weights(&self, w: f64) -> Vec<f64> {
        let others = |j: usize| self.layers.iter().enumerate().filter(move |(m, _)| *m != j);
        (0..self.layers.len())
            .map(|j| others(j).map(|(_, o)| (w - o.w) / (self.layers[j].w - o.w)).product())
            .collect()
    }
}

fn index(plane: &Plane) -> Option<SegmentIndex> {
    let fine =
        |c: &Contour| ClosedCurve::through(c).map(|curve| Contour::new(curve.resampled(POLYGON_POINTS, 0.0)));
    SegmentIndex::try_new(&plane.contours.iter().map(fine).collect::<Option<Vec<_>>>()?)
}

/// The bounds of a source's own grids are wider than its frame; beyond them all is outside.
pub(super) fn beyond(bounds: Bounds2, p: Point2) -> Jet {
    let inside = Point2::from(p.coords.sup(&bounds.min.coords).inf(&bounds.max.coords));
    let away = p - inside;
    Jet {
        value: bounds.size().norm() + away.norm(),
        slope: away.try_normalize(1e-12).unwrap_or_else(Vector2::x),
    }
}

impl EventSource for DistanceSource {
    fn value(&self, p: Point2, w: f64) -> f64 {
        self.jet(p, w).value
    }

    fn jet(&self, p: Point2, w: f64) -> Jet {
        self.slice(w)(p)
    }

    fn slice(&self, w: f64) -> Box<dyn Fn(Point2) -> Jet + '_> {
        let weights = self.weights(w);
        Box::new(move |p| {
            let mut sum = Jet { value: 0.0, slope: Vector2::zeros() };
            for (layer, &weight) in self.layers.iter().zip(&weights) {
                let Some(jet) = layer.distance.jet(p) else { return beyond(self.frame.bounds, p) };
                sum.value += weight * jet.value;
                sum.slope += jet.slope * weight;
            }
            sum
        })
    }

    fn frame(&self) -> Option<Frame> {
        Some(self.frame)
    }

    fn contours_on(&self, w: f64, finer: f64) -> Vec<Contour> {
        iso::contours(&*self.slice(w), self.frame.bounds, self.frame.step_mm / finer)
    }

    fn refine(&self, p: Point2, w: f64) -> Point2 {
        iso::project(&*self.slice(w), p, self.frame.step_mm)
    }

    fn anchor(&self, i: usize, _w: f64) -> Point2 {
        self.anchors[i]
    }
}

/// A source seen with inside and outside exchanged.
pub(super) struct Inverse<S>(pub(super) S);

fn inverted(jet: Jet) -> Jet {
    Jet { value: -jet.value, slope: -jet.slope }
}

impl<S: EventSource> EventSource for Inverse<S> {
    fn value(&self, p: Point2, w: f64) -> f64 {
        -self.0.value(p, w)
    }

    fn jet(&self, p: Point2, w: f64) -> Jet {
        inverted(self.0.jet(p, w))
    }

    fn slice(&self, w: f64) -> Box<dyn Fn(Point2) -> Jet + '_> {
        let inner = self.0.slice(w);
        Box::new(move |p| inverted(inner(p)))
    }

    fn frame(&self) -> Option<Frame> {
        self.0.frame()
    }

    fn contours_on(&self, w: f64, finer: f64) -> Vec<Contour> {
        self.0.contours_on(w, finer).iter().map(Contour::reversed).collect()
    }

    fn refine(&self, p: Point2, w: f64) -> Point2 {
        self.0.refine(p, w)
    }

    fn anchor(&self, i: usize, w: f64) -> Point2 {
        self.0.anchor(i, w)
    }
}
