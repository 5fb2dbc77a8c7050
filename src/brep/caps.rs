//! Flat ends: the regions between the rims at one height.

use super::build::Ring;
use super::{Brep, Coedge, Face, Loop, Surface};
use crate::geom::Contour;

/// Rims at heights nearer than this lie in one plane, mm.
const SAME_HEIGHT_MM: f64 = 1e-9;
/// Points of a rim by which it is told what lies inside it.
const OUTLINE_POINTS: usize = 64;

/// An open end of a tube that a plane closes.
#[derive(Debug, Clone)]
pub(super) struct Rim {
    pub(super) ring: Ring,
    /// Whether it is the tube's upper end.
    pub(super) is_top: bool,
    /// Whether the tube is turned inside out.
    pub(super) is_reversed: bool,
}

impl Rim {
    /// Its loop as a cap uses it: against the tube.
    fn cap_loop(&self) -> Loop {
        // An upright tube runs along its lower ring and against its upper one.
        let is_forward = self.is_top != self.is_reversed;
        let coedge = |(edge, _)| Coedge { edge, is_forward, trace: [[0.0; 2]; 2] };
        let mut coedges: Vec<Coedge> = self.ring.all().into_iter().map(coedge).collect();
        if !is_forward {
            coedges.reverse();
        }
        Loop { coedges }
    }

    fn outline(&self, brep: &Brep) -> Contour {
        let pieces = self.ring.all();
        let at = |k: usize| {
            let u = k as f64 / OUTLINE_POINTS as f64;
            let piece = pieces.iter().rev().find(|(_, [from, _])| *from <= u).unwrap_or(&pieces[0]);
            brep.edges[piece.0].curve.at(u).xy()
        };
        Contour::new((0..OUTLINE_POINTS).map(at).collect())
    }
}

/// The faces that close all rims: at one height a rim inside an odd number of others is a hole of the innermost of
/// them, and every other one is the outer border of a face.
pub(super) fn caps(brep: &Brep, rims: &[Rim]) -> Vec<Face> {
    let outlines: Vec<Contour> = rims.iter().map(|r| r.outline(brep)).collect();
    let area = |i: usize| outlines[i].signed_area_mm2().abs();
    let around = |i: usize| -> Vec<usize> {
        let holds = |j: &usize| {
            let level = (rims[*j].ring.z_mm - rims[i].ring.z_mm).abs() < SAME_HEIGHT_MM;
            level && area(*j) > area(i) && outlines[*j].contains(outlines[i].points[0])
        };
        (0..rims.len()).filter(|&j| j != i).filter(holds).collect()
    };
    let nests: Vec<Vec<usize>> = (0..rims.len()).map(around).collect();
    let face = |i: usize| {
        let inner = |j: &usize| {
            let odd = nests[*j].len() % 2 == 1;
            let parent = nests[*j].iter().copied().min_by(|&a, &b| area(a).total_cmp(&area(b)));
            odd && parent == Some(i)
        };
        let outer = rims[i].cap_loop();
        // Seen from above the loop runs counter-clockwise where the cap faces up.
        let is_ccw = outlines[i].is_ccw() == outer.coedges[0].is_forward;
        let holes = (0..rims.len()).filter(inner).map(|j| rims[j].cap_loop());
        let loops = std::iter::once(outer).chain(holes).collect();
        Face { surface: Surface::Plane(rims[i].ring.z_mm), is_outward: is_ccw, loops }
    };
    (0..rims.len()).filter(|&i| nests[i].len().is_multiple_of(2)).map(face).collect()
}
