//! Tubes looked at from near by, where they are not proved to keep clear of themselves and each other.
//!
//! Round the place their sections at some heights are cut into chords of a hundred-thousandth of the way round: what crosses
//! by a micrometre is seen.

use super::check::{Chord, Corners, cross};
use super::patch::TOUCH_MM;
use super::{Brep, Fault, Kind, Surface};
use crate::geom::{Point2, Point3};
use crate::spline::PatchSurface;

/// Heights on either side of the place; the farthest of them, mm: closer together near the place.
const HEIGHTS: i32 = 10;
const REACH_Z_MM: f64 = 0.1;
/// Farthest that a chord lies from the place, mm.
const REACH_MM: f64 = 0.05;
/// Chords once round, and into how many those near the place are divided.
const CHORDS: usize = 4000;
const FINER: usize = 50;

/// Where tubes cross near a place.
pub(super) fn crossing_near(brep: &Brep, corners: &Corners, place: &Fault) -> Option<Fault> {
    (-HEIGHTS..=HEIGHTS).find_map(|k| {
        let share = f64::from(k) / f64::from(HEIGHTS);
        let z_mm = place.at.z + REACH_Z_MM * share * share.abs();
        let at = Look { brep, corners, place: place.at.xy(), z_mm }.crossing()?;
        Some(Fault { at: Point3::new(at.x, at.y, z_mm), kind: Kind::Crossing, ..*place })
    })
}

/// A height at which a place is looked at.
struct Look<'a> {
    brep: &'a Brep,
    corners: &'a Corners,
    place: Point2,
    z_mm: f64,
}

impl Look<'_> {
    fn crossing(&self) -> Option<Point2> {
        let mut chords: Vec<Chord> = Vec::new();
        for (face, of) in self.brep.faces.iter().enumerate() {
            let Surface::Tube(surface) = &of.surface else { continue };
            let [low, high] = surface.v_range();
            if low < self.z_mm && self.z_mm < high {
                self.cut(surface, face, &mut chords);
            }
        }
        chords.sort_by(|a, b| a.from.x.min(a.to.x).total_cmp(&b.from.x.min(b.to.x)));
        chords.iter().enumerate().find_map(|(i, a)| {
            let right = a.from.x.max(a.to.x);
            let reached = chords[i + 1..].iter().take_while(|b| b.from.x.min(b.to.x) <= right);
            reached
                .filter(|b| !follows(a, b))
                .find_map(|b| cross(a, b).filter(|at| !self.is_shared(a, b, *at)))
        })
    }

    /// The chords of a tube near the place.
    fn cut(&self, surface: &PatchSurface, face: usize, chords: &mut Vec<Chord>) {
        let row = surface.row(self.z_mm);
        let [first, last] = surface.u_range();
        let at = |k: usize| {
            let share = k as f64 / (CHORDS * FINER) as f64;
            row.at(first + (last - first) * share).xy()
        };
        let coarse: Vec<Point2> = (0..=CHORDS).map(|k| at(FINER * k)).collect();
        for (k, ends) in coarse.windows(2).enumerate() {
            let length_mm = (ends[1] - ends[0]).norm();
            if (ends[0] - self.place).norm() > REACH_MM + length_mm {
                continue;
            }
            let one = |index: usize| Chord { from: at(index), to: at(index + 1), piece: face, index };
            chords.extend((FINER * k..FINER * (k + 1)).map(one));
        }
    }

    /// Whether the faces of two chords have a vertex in common there.
    fn is_shared(&self, a: &Chord, b: &Chord, at: Point2) -> bool {
        let at = Point3::new(at.x, at.y, self.z_mm);
        let mut vertices = self.corners.common(a.piece, b.piece);
        a.piece != b.piece && vertices.any(|v| (self.brep.vertices[v].point - at).norm() < TOUCH_MM)
    }
}

/// Whether chords are one or neighbours on a curve.
fn follows(a: &Chord, b: &Chord) -> bool {
    let apart = a.index.abs_diff(b.index);
    a.piece == b.piece && (apart <= 1 || apart + 1 == CHORDS * FINER)
}
