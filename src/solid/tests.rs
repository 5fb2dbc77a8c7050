use super::*;
use crate::geom::{Contour, Point2, RigidTransform, SegmentIndex};
use crate::phantom::{Kind, Vessel};
use crate::sections::PlaneSections;

mod events;
mod irregular;

pub(super) fn phantom_stack(kind: Kind) -> SectionStack {
    let vessel = Vessel::new(kind);
    let plane = |k: u32| {
        let z_mm = 3.0 * f64::from(k);
        PlaneSections { z_mm, contours: vessel.region_at(z_mm, 128).contours }
    };
    stack((0..46).map(plane).collect())
}

pub(super) fn stack(planes: Vec<PlaneSections>) -> SectionStack {
    SectionStack { planes, patient_from_stack: RigidTransform::identity() }
}

fn cylinder(radius_mm: f64, n_planes: u32) -> SectionStack {
    let contours = vec![Contour::circle(Point2::new(5.0, 7.0), radius_mm, 128)];
    stack(
        (0..n_planes)
            .map(|k| PlaneSections { z_mm: 2.0 * f64::from(k), contours: contours.clone() })
            .collect(),
    )
}

pub(super) fn cast(stack: &SectionStack) -> Solid {
    build(stack, &Params::new(Body::Cast), &Task::quiet()).unwrap().solid
}

fn wall(stack: &SectionStack, wall_mm: f64) -> Solid {
    build(stack, &Params::new(Body::Wall { wall_mm }), &Task::quiet()).unwrap().solid
}

/// Farthest distance of the contours' vertices from the others' boundary, mm.
fn farthest(from: &Region, to: &Region) -> f64 {
    let index = SegmentIndex::try_new(&to.contours).unwrap();
    let points = from.contours.iter().flat_map(|c| &c.points);
    points.map(|&p| index.nearest(p).distance_mm).fold(0.0, f64::max)
}

#[test]
fn sections_at_the_planes_are_the_given_contours() {
    for kind in [Kind::Carotid, Kind::Merge, Kind::Stenosis, Kind::Tube] {
        let stack = phantom_stack(kind);
        let solid = cast(&stack);
        for plane in &stack.planes {
            let section = solid.section(plane.z_mm, 1e-4).outer;
            assert_eq!(section.contours.len(), plane.contours.len(), "{kind:?} z {}", plane.z_mm);
            assert!(farthest(&plane.region(), &section) < 1e-3, "{kind:?} z {}", plane.z_mm);
        }
    }
}

#[test]
fn sections_between_the_planes_are_near_the_truth() {
    for kind in [Kind::Carotid, Kind::Stenosis, Kind::Tube] {
        let solid = cast(&phantom_stack(kind));
        let vessel = Vessel::new(kind);
        let mut volumes = [0.0; 2];
        for k in 0..540 {
            let z_mm = 0.125 + 0.25 * f64::from(k);
            let (made, truth) = (solid.section(z_mm, 1e-3).outer, vessel.region_at(z_mm, 256));
            assert_eq!(made.contours.len(), truth.contours.len(), "{kind:?} z {z_mm}");
            let off = farthest(&made, &truth).max(farthest(&truth, &made));
            // In the plane, which where the surface slopes is longer than in space.
            assert!(off < 0.035, "{kind:?} z {z_mm}: {off}");
            volumes[0] += made.area_mm2();
            volumes[1] += truth.area_mm2();
        }
        assert!((volumes[0] / volumes[1] - 1.0).abs() < 1e-3, "{kind:?} {volumes:?}");
    }
}

#[test]
fn a_split_has_three_tubes_and_one_slab() {
    let solid = cast(&phantom_stack(Kind::Carotid));
    assert_eq!((solid.lumen.tubes.len(), solid.lumen.slabs.len()), (3, 1));
    assert!(solid.lumen.slabs[0].upward);
    // Across the slab the area changes without a jump.
    let slab = &solid.lumen.slabs[0];
    let area = |w: f64| solid.section(w, 1e-4).outer.area_mm2();
    let steps: Vec<f64> = (0..=40).map(|i| slab.w_mm[0] - 0.2 + 0.02 * f64::from(i)).map(area).collect();
    assert!(steps.windows(2).all(|s| (s[1] - s[0]).abs() < 0.3), "{steps:?}");
}

#[test]
fn a_merge_is_a_split_read_downward() {
    // The vessel splits and joins again.
    let solid = cast(&phantom_stack(Kind::Merge));
    assert_eq!(solid.lumen.tubes.len(), 4);
    let upward: Vec<bool> = solid.lumen.slabs.iter().map(|s| s.upward).collect();
    assert!(upward.len() == 2 && upward.contains(&true) && upward.contains(&false), "{upward:?}");
}

#[test]
fn three_daughters_part_one_after_the_other() {
    let solid = cast(&phantom_stack(Kind::Trifurcation));
    assert_eq!((solid.lumen.tubes.len(), solid.lumen.slabs.len()), (5, 2));
}

#[test]
fn chords_keep_the_tolerance_on_a_flat_lumen() {
    let flat = |k: u32| {
        let points = Contour::circle(Point2::origin(), 1.0, 256).points;
        let squeezed = points.iter().map(|p| Point2::new(6.0 * p.x, 0.5 * p.y + 0.1 * f64::from(k)));
        PlaneSections { z_mm: 2.0 * f64::from(k), contours: vec![Contour::new(squeezed.collect())] }
    };
    let solid = cast(&stack((0..5).map(flat).collect()));
    for tolerance_mm in [0.02, 0.005, 0.001] {
        let coarse = solid.section(3.1, tolerance_mm).outer;
        let fine = solid.section(3.1, 1e-6).outer;
        assert!(farthest(&fine, &coarse) <= tolerance_mm, "{tolerance_mm}: {}", farthest(&fine, &coarse));
    }
}

#[test]
fn the_body_goes_on_half_a_plane_interval_beyond_its_ends() {
    assert_eq!(cast(&cylinder(2.0, 5)).z_range_mm(), [-1.0, 9.0]);
    assert_eq!(wall(&cylinder(2.0, 5), 1.0).z_range_mm(), [-1.0, 9.0]);
}

#[test]
fn the_wall_of_a_cylinder_is_a_cylinder() {
    let solid = wall(&cylinder(3.0, 8), 0.8);
    for z_mm in [-0.9, 0.0, 5.3, 14.9] {
        let section = solid.section(z_mm, 1e-4);
        let radius = |r: &Region| (r.area_mm2() / std::f64::consts::PI).sqrt();
        assert!((radius(&section.lumen) - 3.0).abs() < 2e-3);
        assert!((radius(&section.outer) - 3.8).abs() < 3e-3, "z {z_mm}: {}", radius(&section.outer));
        assert!(
            (section.material().area_mm2() - section.outer.area_mm2() + section.lumen.area_mm2()).abs()
                < 1e-3
        );
    }
}

#[test]
fn every_phantom_gets_a_wall_of_any_usual_thickness() {
    for kind in [Kind::Merge, Kind::Trifurcation] {
        let stack = phantom_stack(kind);
        for wall_mm in [0.5, 1.0, 2.0] {
            let built = build(&stack, &Params::new(Body::Wall { wall_mm }), &Task::quiet());
            let built = built.unwrap_or_else(|e| panic!("{kind:?} {wall_mm}: {e}"));
            let thickness = built.thickness.expect("a wall is measured");
            let told = built.warnings.iter().any(|w| w.code == "solid.wall_thickness");
            assert_eq!(told, !thickness.is_as_asked(), "{kind:?} {wall_mm}");
        }
    }
}

#[test]
fn branches_that_would_meet_beyond_the_stack_go_on_straight_and_that_is_told() {
    // Two tubes that lean towards each other: half an interval above the last plane they would overlap.
    let plane = |k: u32| {
        let x = 2.2 + 0.35 * f64::from(7 - k);
        let tube = |side: f64| Contour::circle(Point2::new(side * x, 0.0), 2.1, 64);
        PlaneSections { z_mm: 2.0 * f64::from(k), contours: vec![tube(1.0), tube(-1.0)] }
    };
    let built = |n: u32| build(&stack((0..n).map(plane).collect()), &Params::new(Body::Cast), &Task::quiet());
    let leaning = built(8).unwrap();
    let told: Vec<&Warning> = leaning.warnings.iter().filter(|w| w.code == "solid.straight_ends").collect();
    assert_eq!(told.len(), 1, "{:?}", leaning.warnings);
    assert!(told[0].text.starts_with("plane 7 (z 14.00 mm), contours 0, 1: "), "{}", told[0].text);
    assert_eq!(leaning.solid.section(14.9, 1e-3).outer.contours.len(), 2);
    // Farther apart they lean on.
    assert_eq!(built(5).unwrap().warnings, []);
}

#[test]
fn a_hole_that_the_wall_fills_is_told_where_it_is_wider_than_the_wall() {
    let ring = |hole_mm: f64| {
        let outer = Contour::circle(Point2::new(1.0, 2.0), 8.0, 128);
        let inner = Contour::circle(Point2::new(1.0, 2.0), hole_mm, 128).reversed();
        let plane =
            |k: u32| PlaneSections { z_mm: 2.0 * f64::from(k), contours: vec![outer.clone(), inner.clone()] };
        build(&stack((0..5).map(plane).collect()), &Params::new(Body::Wall { wall_mm: 1.0 }), &Task::quiet())
            .unwrap()
    };
    let filled = |built: &Built| -> Vec<Warning> {
        built.warnings.iter().filter(|w| w.code == "solid.hole_filled").cloned().collect()
    };
    let [warning] = &filled(&ring(4.0))[..] else { panic!("one hole is filled") };
    assert!(
        warning.text.contains("from z -1.00 to 9.00 mm") && warning.text.contains("is 3."),
        "{}",
        warning.text
    );
    assert_eq!(filled(&ring(0.9)), []);
}

#[test]
fn a_solid_is_read_back_as_it_was_written() {
    let solid = wall(&cylinder(3.0, 4), 1.0);
    let text = serde_json::to_string(&solid).unwrap();
    let back: Solid = serde_json::from_str(&text).unwrap();
    assert!(
        (back.section(2.2, 1e-3).outer.area_mm2() - solid.section(2.2, 1e-3).outer.area_mm2()).abs() < 1e-9
    );
}

#[test]
fn what_cannot_be_built_is_refused() {
    let params = Params::new(Body::Wall { wall_mm: 0.0 });
    let error = build(&cylinder(3.0, 4), &params, &Task::quiet()).unwrap_err();
    assert_eq!(error.to_string(), "wall thickness is 0 mm: it must lie between 0.1 and 20 mm");
    let one = stack(vec![cylinder(3.0, 1).planes[0].clone()]);
    let error = build(&one, &Params::new(Body::Cast), &Task::quiet()).unwrap_err();
    assert!(matches!(error, Error::Topology(topology::Error::TooFewPlanes { found: 1 })));
}

#[test]
fn work_stops_when_asked() {
    let cancel = crate::progress::CancelToken::default();
    cancel.cancel();
    let task = Task::new(&|_, _| {}, cancel);
    let error = build(&phantom_stack(Kind::Carotid), &Params::new(Body::Cast), &task).unwrap_err();
    assert_eq!(error, Error::Cancelled(Cancelled));
}
