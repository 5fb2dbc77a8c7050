use super::*;
use crate::geom::{Contour, Point2, RigidTransform};
use crate::mesh::SkinChoice;
use crate::progress::Task;
use crate::sections::{PlaneSections, SectionStack};
use crate::solid::{Body, Params, build};

fn pipe() -> Brep {
    let contours = vec![Contour::circle(Point2::new(5.0, 7.0), 3.0, 64)];
    let plane = |k: u32| PlaneSections { z_mm: 2.0 * f64::from(k), contours: contours.clone() };
    let stack =
        SectionStack { planes: (0..4).map(plane).collect(), patient_from_stack: RigidTransform::identity() };
    let body = Body::Wall { wall_mm: 1.0 };
    Brep::of(&build(&stack, &Params::new(body), &Task::quiet()).unwrap().solid, SkinChoice::All)
}

#[test]
fn a_pipe_is_one_solid_of_two_tubes_and_two_planes_and_the_bytes_repeat() {
    let text = to_step(&pipe());
    let count = |what: &str| text.matches(what).count();
    assert_eq!(count("=MANIFOLD_SOLID_BREP("), 1);
    assert_eq!(count("=B_SPLINE_SURFACE_WITH_KNOTS("), 2);
    assert_eq!(count("=PLANE("), 2);
    assert_eq!((count("=EDGE_CURVE("), count("=ORIENTED_EDGE(")), (6, 12));
    assert_eq!((count("=FACE_OUTER_BOUND("), count("=FACE_BOUND(")), (4, 2));
    assert!(text.contains("SI_UNIT(.MILLI.,.METRE.)") && text.ends_with("END-ISO-10303-21;\n"));
    assert_eq!(text, to_step(&pipe()));
}

#[test]
fn every_reference_names_an_entity_before_it() {
    for line in to_step(&pipe()).lines().filter(|l| l.starts_with('#')) {
        let mut numbers = line.split('#').skip(1).map(|part| {
            let digits: String = part.chars().take_while(char::is_ascii_digit).collect();
            digits.parse::<usize>().unwrap()
        });
        let own = numbers.next().unwrap();
        assert!(numbers.all(|n| n < own), "{line}");
    }
}
