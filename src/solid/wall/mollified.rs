//! The distance to the lumen, smoothed: for events of the outer skin that no crease describes.
//!
//! Where three or more branches part within t of each other, creases meet, run beside each other or end in the open. The
//! exact distance has a ridge in all of them, on which no saddle point lies. Sampled on a grid in space and taken as
//! the control net of a tricubic B-spline, it is C2 and has one: creases are rounded over two steps, outward, so
//! that the wall is too thick in them; elsewhere it is thinner by the distance's Laplacian times a sixth of the squared
//! step, 2e-3 mm for a branch of 3 mm.
//!
//! Cost: one distance a node; far from the skin one for sixteen of them.

use crate::geom::{Bounds2, Contour, Point2, Vector2};
use crate::solid::distance::beyond;
use crate::solid::event::{EventPlanes, EventSource, Frame};
use crate::solid::grid::{Jet, SmoothGrid, bounded_step_mm, weights};
use crate::solid::iso;
use rayon::prelude::*;

/// Steps of the grid to the smallest radius, and to the largest one at most.
const STEPS: f64 = 16.0;
const MOST_STEPS: f64 = 60.0;
/// Layers at most.
const MOST_LAYERS: f64 = 48.0;
/// Nodes of a coarse cell along each direction; how far from zero, in its size, a cell must lie to be sampled once.
const COARSE: f64 = 4.0;
const FAR: f64 = 3.0;

/// The smoothed distance round an event.
#[derive(Debug)]
pub(super) struct Mollified {
    layers: Vec<SmoothGrid>,
    /// Height of the first layer, and from one to the next.
    first_w: f64,
    step_w: f64,
    frame: Frame,
    anchors: Vec<Point2>,
    /// The contours of the event's planes, by which those of its branches are told from others.
    own: Vec<Contour>,
}

impl Mollified {
    /// The field of `distance` (point, height w), zero on the skin, between the event's planes and as far as its
    /// second ones; `None` where it has no contours.
    pub(super) fn around(planes: &EventPlanes, distance: impl Fn(Point2, f64) -> f64 + Sync) -> Option<Self> {
        let radius = |c: &Contour| (c.signed_area_mm2().abs() / std::f64::consts::PI).sqrt();
        let near = planes.parents.iter().take(2).chain(planes.daughters.iter().take(2));
        let radii = near.clone().flat_map(|p| p.contours.iter().map(radius));
        let [least, most] = radii.fold([f64::INFINITY, 0.0f64], |[a, b], r| [a.min(r), b.max(r)]);
        let heights = near
            .clone()
            .map(|p| p.w)
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], w| [a.min(w), b.max(w)]);
        let bounds = planes.bounds()?.grown(0.4 * most);
        let step_mm = bounded_step_mm(bounds, (least / STEPS).max(most / MOST_STEPS));
        let step_w = step_mm.max((heights[1] - heights[0]) / MOST_LAYERS);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded above")]
        let n_layers = ((heights[1] - heights[0]) / step_w).ceil() as usize + 4;
        // The spline at the ends of the range needs a layer beyond it.
        let first_w = heights[0] - 1.5 * step_w;
        let layer = |k: usize| {
            let w = first_w + k as f64 * step_w;
            let far = Coarse::sampled(bounds.grown(8.0 * step_mm), COARSE * step_mm, |p| distance(p, w));
            SmoothGrid::smoothed(bounds.grown(step_mm), step_mm, |p| {
                far.told(p).unwrap_or_else(|| distance(p, w))
            })
        };
        let layers = (0..n_layers).into_par_iter().map(layer).collect();
        let anchors = planes.daughters[0].contours.iter().map(Contour::centroid).collect();
        let own = near.flat_map(|p| p.contours.iter().cloned()).collect();
        Some(Self { layers, first_w, step_w, frame: Frame { bounds, step_mm: 0.8 * step_mm }, anchors, own })
    }

    /// Whether a contour belongs to the event: branches beside it have some in its frame, too.
    fn is_own(&self, contour: &Contour) -> bool {
        let centre = contour.centroid();
        self.own.iter().any(|own| own.contains(centre) || contour.contains(own.centroid()))
    }
}

/// Values at the middles of coarse cells.
struct Coarse {
    min: Point2,
    step_mm: f64,
    n_x: usize,
    values: Vec<f64>,
}

impl Coarse {
    fn sampled(bounds: Bounds2, step_mm: f64, f: impl Fn(Point2) -> f64) -> Self {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a size over a step")]
        let [n_x, n_y] = [0, 1].map(|k| (bounds.size()[k] / step_mm).ceil() as usize);
        let middle =
            |k: usize| bounds.min + Vector2::new((k % n_x) as f64 + 0.5, (k / n_x) as f64 + 0.5) * step_mm;
        Self { min: bounds.min, step_mm, n_x, values: (0..n_x * n_y).map(|k| f(middle(k))).collect() }
    }

    /// The value of a point's cell, where that is so far from zero that nothing more is asked of it.
    fn told(&self, p: Point2) -> Option<f64> {
        let at = (p - self.min) / self.step_mm;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let [i, j] = [at.x, at.y].map(|t| t.max(0.0) as usize);
        let value = *self.values.get(j * self.n_x + i.min(self.n_x - 1))?;
        (value.abs() > FAR * self.step_mm).then_some(value)
    }
}

impl EventSource for Mollified {
    fn value(&self, p: Point2, w: f64) -> f64 {
        self.jet(p, w).value
    }

    fn jet(&self, p: Point2, w: f64) -> Jet {
        self.slice(w)(p)
    }

    fn slice(&self, w: f64) -> Box<dyn Fn(Point2) -> Jet + '_> {
        let last = self.layers.len() as f64 - 3.0;
        let at = ((w - self.first_w) / self.step_w).clamp(1.0, last + 1.0);
        let below = at.floor().min(last);
        let (weights, _) = weights(at - below);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
        let first = below as usize - 1;
        Box::new(move |p| {
            let mut sum = Jet { value: 0.0, slope: Vector2::zeros() };
            for (layer, weight) in self.layers[first..first + 4].iter().zip(weights) {
                let Some(jet) = layer.jet(p) else { return beyond(self.frame.bounds, p) };
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
        let all = iso::contours(&*self.slice(w), self.frame.bounds, self.frame.step_mm / finer);
        all.into_iter().filter(|c| self.is_own(c)).collect()
    }

    fn refine(&self, p: Point2, w: f64) -> Point2 {
        iso::project(&*self.slice(w), p, self.frame.step_mm)
    }

    fn anchor(&self, i: usize, _w: f64) -> Point2 {
        self.anchors[i]
    }
}
