//! Whether the patches of an event are sound by themselves: the rows of its laterals must neither cross themselves nor
//! each other.
//!
//! Where the field of an event has finer features beside its saddle than its slab is thick, rows trace different curves
//! from height to height, and what is interpolated through them crosses. The full test is `brep::check`'s.

use super::event::Slab;
use super::sweep::Swept;
use crate::geom::{Contour, Point2};
use crate::spline::PatchSurface;
use crate::topology::{meet, meets_itself};
use rayon::prelude::*;

/// Shares of a slab's height at which it is looked at.
const SHARES: [f64; 7] = [0.03, 0.12, 0.3, 0.5, 0.7, 0.88, 0.97];
/// Points of a row.
const ROW_POINTS: u32 = 256;

/// Whether all slabs of an event are sound.
pub(super) fn is_sound(swept: &Swept) -> bool {
    let rows = |slab| SHARES.map(|share| (slab, share));
    let all: Vec<(&Slab, f64)> = swept.joints.iter().flat_map(|joint| rows(&joint.slab)).collect();
    !all.into_par_iter().any(|(slab, share)| crosses(slab, share))
}

/// Whether the laterals cross at a share of their height.
fn crosses(slab: &Slab, share: f64) -> bool {
    let [low, high] = slab.w_mm;
    let v = slab.v_of(low + share * (high - low));
    let [first, second] = slab.laterals.each_ref().map(|lateral| outline(lateral, v));
    meets_itself(&first) || meets_itself(&second) || meet(&first, &second)
}

/// A row, closed by the chord between its ends; its points are closer beside them.
fn outline(lateral: &PatchSurface, v: f64) -> Contour {
    let row = lateral.row(v);
    let at = |k: u32| {
        let angle = std::f64::consts::PI * f64::from(k) / f64::from(ROW_POINTS);
        let p = row.at(0.5 * (1.0 - angle.cos()));
        Point2::new(p.x, p.y)
    };
    Contour::new((0..=ROW_POINTS).map(at).collect())
}

#[cfg(test)]
mod tests {
    use super::super::event::Crotch;
    use super::*;
    use crate::geom::Point3;

    /// Two cylinders of 1 mm radius side by side, open where they face each other; the middle row of the first one leans by so much.
    fn slab(lean_mm: f64) -> Slab {
        let (us, vs) = ([0, 1, 2, 3, 4, 5, 6, 7, 8].map(|k| f64::from(k) / 8.0), [0.0, 0.25, 0.5, 0.75, 1.0]);
        let lateral = |side: f64| {
            let point = |u: f64, v: f64| {
                let angle = std::f64::consts::TAU * (0.05 + 0.9 * u);
                let lean = if side < 0.0 && v == 0.5 { lean_mm } else { 0.0 };
                Point3::new(side * (1.2 - angle.cos()) + lean, -side * angle.sin(), v)
            };
            let rows: Vec<Vec<Point3>> =
                vs.iter().map(|&v| us.iter().map(|&u| point(u, v)).collect()).collect();
            PatchSurface::through(&us, &vs, &rows).expect("a patch")
        };
        let laterals = [lateral(-1.0), lateral(1.0)];
        Slab { upward: true, w_mm: [0.0, 1.0], crotch: Crotch::Saddle(laterals[0].clone()), laterals }
    }

    #[test]
    fn laterals_that_cross_each_other_are_seen() {
        let is_crossed = |lean_mm| SHARES.iter().any(|&share| crosses(&slab(lean_mm), share));
        assert!(!is_crossed(0.0));
        assert!(is_crossed(0.8));
    }
}
