//! A plane while its contours are fitted: what it shows, its outlines, and which of them make a body.

use super::harmonics::Circle;
use super::levels::{Equations, Levels};
use super::render::{EDGE_REACH, View};
use super::ring::{self, Outline, Ring};
use super::{Finding, Footing, LIMIT_BLURS, LIMIT_PIXELS, Residual, Scan, Start};
use crate::geom::{Contour, Point2};
use std::f64::consts::PI;

/// One plane in the making.
pub(super) struct Plane {
    pub(super) z_mm: f64,
    /// Whether its contours were drawn.
    pub(super) is_drawn: bool,
    pub(super) view: View,
    pub(super) outlines: Vec<Outline>,
    pub(super) first: Vec<Option<Vec<f64>>>,
    /// Outer contours with their holes, by index.
    pub(super) bodies: Vec<Vec<usize>>,
    pub(super) levels: Vec<Levels>,
    /// By how much the level half-way between lumen and wall was last moved, per body, HU.
    pub(super) lifted: Vec<f64>,
}

impl Plane {
    pub(super) fn new(start: &Start, around: &[Contour], scan: &Scan<'_>, circle: &Circle) -> Self {
        let ring = |contour: &Contour, footing: &Footing| match footing {
            Footing::Made => None,
            Footing::Measured | Footing::Drawn => Ring::of(contour, circle),
            // What is smaller than the blur is no detail that the image shows.
            Footing::Rough => {
                Ring::of(contour, circle).or_else(|| Ring::roughly(contour, circle, scan.optics.blur_mm))
            }
        };
        let outline = |(contour, footing): (&Contour, &Footing)| match ring(contour, footing) {
            None => Outline::Fixed(contour.clone()),
            Some(ring) if *footing == Footing::Drawn => Outline::Held(ring, contour.clone()),
            Some(ring) => Outline::Free(ring),
        };
        let outlines: Vec<Outline> = start.contours.iter().zip(&start.footing).map(outline).collect();
        let [sx, sy] = scan.volume.pixel_spacing_xy_mm;
        let margin = scan.optics.wall_mm
            + (EDGE_REACH + LIMIT_BLURS) * scan.optics.blur_mm
            + LIMIT_PIXELS * sx.max(sy);
        let view = View::of(scan.volume, start.k, scan.sign, around, margin).unwrap_or_else(View::empty);
        let bodies = bodies(&start.contours);
        let levels = vec![start.levels; bodies.len()];
        let first = outlines.iter().map(|o| o.ring().map(|r| r.radii.clone())).collect();
        let lifted = vec![0.0; bodies.len()];
        let is_drawn = start.footing.contains(&Footing::Drawn);
        Self { z_mm: start.z_mm, is_drawn, view, outlines, first, bodies, levels, lifted }
    }

    /// What a plane is asked whose image has no say: nothing moves, and nothing is told of levels and noise.
    pub(super) fn unseen(&self) -> (Finding, Residual) {
        let finding = Finding {
            moves: vec![None; self.outlines.len()],
            equations: vec![Equations::none(); self.bodies.len()],
            rough: Vec::new(),
            smooth: Vec::new(),
        };
        (finding, Residual { place: self.view.place, values: Vec::new(), is_edge: Vec::new() })
    }

    /// Radius of the circle as large as each body's outer contour.
    pub(super) fn body_radii_mm(&self) -> Vec<f64> {
        let radius = |body: &Vec<usize>| match &self.outlines[body[0]] {
            Outline::Free(ring) | Outline::Held(ring, _) => (ring.area_mm2() / PI).sqrt(),
            Outline::Fixed(contour) => (contour.signed_area_mm2().abs() / PI).sqrt(),
        };
        self.bodies.iter().map(radius).collect()
    }
}

/// Every outer contour with the holes in it.
fn bodies(contours: &[Contour]) -> Vec<Vec<usize>> {
    let outers: Vec<usize> = (0..contours.len()).filter(|&i| contours[i].is_ccw()).collect();
    let holes_of = |&o: &usize| {
        let inside = |&h: &usize| !contours[h].is_ccw() && contours[o].contains(contours[h].points[0]);
        std::iter::once(o).chain((0..contours.len()).filter(inside)).collect()
    };
    outers.iter().map(holes_of).collect()
}

/// Puts the centres of every run on a smooth line, so that the rays of neighbouring planes correspond.
pub(super) fn align_centres(planes: &mut [Plane], circle: &Circle) {
    let outlines: Vec<Vec<Outline>> = planes.iter().map(|p| p.outlines.clone()).collect();
    for run in ring::runs(&outlines, circle) {
        let centres: Vec<Point2> =
            run.iter().filter_map(|&(k, i)| Some(outlines[k][i].ring()?.centre)).collect();
        for n in 1..run.len().saturating_sub(1) {
            let (k, i) = run[n];
            let [a, b] = [n - 1, n + 1].map(|m| planes[run[m].0].z_mm);
            let t = (planes[k].z_mm - a) / (b - a);
            let between = centres[n - 1] + (centres[n + 1] - centres[n - 1]) * t;
            let centre = nalgebra::center(&centres[n], &between);
            if let Some(ring) = outlines[k][i].ring().and_then(|r| r.recentred(centre, circle)) {
                planes[k].first[i] = Some(ring.radii.clone());
                planes[k].outlines[i].set_ring(ring);
            }
        }
    }
}
