//! Where a contour reaches far beyond those below and above it: the lumen has most likely run into something beside it there.
//!
//! A vessel that leans, bends or branches changes from plane to plane by little: its contour lies within the convex hull of those
//! near it in the planes below and above, give or take what it bulges. A horn into a vein lies outside by a good part of the
//! vessel's width, in one plane. It is told, not cut: only the operator knows.
//!
//! What it does not do: what lasts over several planes, and the first and the last plane, are not judged.

use super::PlaneSections;
use super::warnings::SectionWarnings;
use crate::geom::distance::SegmentIndex;
use crate::geom::{Contour, Point2, Point3, Region, RigidTransform};

/// A contour may reach beyond the hull by this part of its own diameter.
const BULGE: f64 = 0.35;
/// Contours within this many of its diameters are near it.
const NEAR_DIAMETERS: f64 = 1.0;

/// Tells every contour that reaches too far.
pub(super) fn tell(
    planes: &[PlaneSections],
    patient_from_stack: &RigidTransform,
    warnings: &mut SectionWarnings,
) {
    for three in planes.windows(3) {
        let beside = [&three[0], &three[2]].map(|plane| outers(plane).collect::<Vec<&Contour>>());
        for (reach_mm, at) in outers(&three[1]).filter_map(|c| spike(c, &beside)) {
            let z_mm = three[1].z_mm;
            let p = patient_from_stack.apply(Point3::new(at.x, at.y, z_mm));
            warnings.sudden(z_mm, reach_mm, p);
        }
    }
}

fn outers(plane: &PlaneSections) -> impl Iterator<Item = &Contour> {
    plane.contours.iter().filter(|c| c.is_ccw())
}

/// How far a contour reaches beyond those beside it, mm, and where, if that is too far.
fn spike(contour: &Contour, beside: &[Vec<&Contour>; 2]) -> Option<(f64, Point2)> {
    let diameter_mm = 2.0 * (contour.signed_area_mm2() / std::f64::consts::PI).sqrt();
    let around = contour.bounds()?.grown(NEAR_DIAMETERS * diameter_mm);
    let is_near = |c: &&&Contour| c.bounds().is_some_and(|b| b.meets(around));
    // Where it ends, or leans too far to be followed, there is nothing to compare with.
    if beside.iter().any(|plane| !plane.iter().any(|c| is_near(&c))) {
        return None;
    }
    let near = beside.iter().flatten().filter(is_near);
    let hull = Region::new(near.map(|c| (*c).clone()).collect()).convex_hull();
    let index = SegmentIndex::try_new(&hull.contours)?;
    let reach = |p: &Point2| (index.signed_distance_mm(*p), *p);
    let farthest = contour.points.iter().map(reach).max_by(|a, b| a.0.total_cmp(&b.0))?;
    (farthest.0 > BULGE * diameter_mm).then_some(farthest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn stack(contours: impl Fn(usize) -> Vec<Contour>) -> Vec<PlaneSections> {
        (0..7).map(|k| PlaneSections { z_mm: 3.0 * k as f64, contours: contours(k) }).collect()
    }

    fn told(planes: &[PlaneSections]) -> Vec<String> {
        let mut warnings = SectionWarnings::default();
        tell(planes, &RigidTransform::identity(), &mut warnings);
        warnings.into_warnings().into_iter().map(|w| format!("{}: {}", w.code, w.text)).collect()
    }

    fn circle(x: f64, radius_mm: f64) -> Contour {
        Contour::circle(Point2::new(x, 0.0), radius_mm, 128)
    }

    #[test]
    fn a_horn_in_one_plane_is_named_with_its_place() {
        let with_horn = |k: usize| {
            let mut contour = circle(0.0, 3.0);
            if k == 3 {
                // Points near +x are drawn out to 6 mm.
                contour.points.iter_mut().filter(|p| p.x > 2.9).for_each(|p| p.x += 3.0);
            }
            vec![contour, circle(40.0, 3.0)]
        };
        let told = told(&stack(with_horn));
        assert_eq!(told.len(), 1, "{told:?}");
        assert!(
            told[0].starts_with("sections.sudden_change: ") && told[0].contains("[[segment.block]]"),
            "{told:?}"
        );
        assert!(told[0].contains("z 9.000 mm (3.00 mm, at (6.000, "), "{told:?}");
    }

    proptest! {
        #[test]
        fn what_vessels_do_is_nothing_sudden(
            lean_diameters in -0.4..0.4_f64,
            radius_mm in 1.0..5.0_f64,
            widening in 0.7..1.4_f64,
            parts_at in 1_usize..6,
        ) {
            // A tube that leans and widens, and parts into two.
            let contours = |k: usize| {
                let r = radius_mm * widening.powi(i32::try_from(k).unwrap()).clamp(0.5, 2.0);
                // Up to 0.8 of the diameter that is left where it narrows.
                let x = 2.0 * lean_diameters * radius_mm * k as f64;
                if k < parts_at {
                    vec![circle(x, r)]
                } else {
                    let apart = 0.8 * r * (1.0 + 0.5 * (k - parts_at) as f64);
                    vec![circle(x - apart, 0.7 * r), circle(x + apart, 0.7 * r)]
                }
            };
            let told = told(&stack(contours));
            prop_assert!(told.is_empty(), "{told:?}");
        }
    }
}
