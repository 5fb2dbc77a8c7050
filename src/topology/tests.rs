use super::*;
use crate::geom::{Point2, RigidTransform};
use crate::sections::PlaneSections;

fn stack(planes: Vec<Vec<Contour>>) -> SectionStack {
    let planes = planes
        .into_iter()
        .enumerate()
        .map(|(i, contours)| PlaneSections { z_mm: 3.0 * i as f64, contours })
        .collect();
    SectionStack { planes, patient_from_stack: RigidTransform::identity() }
}

fn disk(x: f64, radius_mm: f64) -> Contour {
    Contour::circle(Point2::new(x, 0.0), radius_mm, 64)
}

#[test]
fn a_split_is_one_star() {
    let graph = graph(&stack(vec![vec![disk(0.0, 4.0)], vec![disk(-2.5, 2.0), disk(2.5, 2.0)]])).unwrap();
    assert_eq!(graph.stars, vec![Star { interval: 0, lower: vec![0], upper: vec![1, 2] }]);
}

#[test]
fn a_steep_branch_is_followed_by_its_drift() {
    let graph =
        graph(&stack(vec![vec![disk(0.0, 2.0)], vec![disk(3.5, 2.0)], vec![disk(7.6, 2.0)]])).unwrap();
    assert_eq!(graph.stars.len(), 2);
    assert!(graph.warnings.is_empty());
}

#[test]
fn an_island_is_left_out_and_reported() {
    let planes = vec![vec![disk(0.0, 2.0)], vec![disk(0.1, 2.0), disk(20.0, 1.0)], vec![disk(0.2, 2.0)]];
    let graph = graph(&stack(planes)).unwrap();
    assert_eq!(graph.nodes.len(), 3);
    assert_eq!(graph.warnings[0].code, "topology.island_dropped");
}

#[test]
fn several_to_several_become_stars() {
    let planes = vec![vec![disk(-2.0, 2.0), disk(2.5, 2.0)], vec![disk(-1.0, 2.0), disk(3.5, 2.0)]];
    let graph = graph(&stack(planes)).unwrap();
    assert_eq!(graph.stars.len(), 2);
    assert_eq!(graph.warnings[0].code, "topology.link_dropped");
}

#[test]
fn bad_contours_are_named() {
    let crossed =
        Contour::new([(0., 0.), (4., 4.), (4., 0.), (0., 4.)].map(|(x, y)| Point2::new(x, y)).to_vec());
    let error = graph(&stack(vec![vec![disk(0.0, 2.0)], vec![crossed]])).unwrap_err();
    assert_eq!(error.to_string(), "plane 1 (z 3 mm), contour 0: it crosses itself: redraw or remove it");
    let mut nan = disk(0.0, 2.0);
    nan.points[7].x = f64::NAN;
    let error = graph(&stack(vec![vec![nan], vec![disk(0.0, 2.0)]])).unwrap_err();
    assert!(matches!(error, Error::Contour { fault: ContourFault::NotFinite(7), .. }));
    let three = Contour::circle(Point2::origin(), 1.0, 3);
    let error = graph(&stack(vec![vec![three], vec![disk(0.0, 2.0)]])).unwrap_err();
    assert!(matches!(error, Error::Contour { fault: ContourFault::TooFewPoints(3), .. }));
    let error = graph(&stack(vec![vec![disk(0.0, 2.0), disk(3.0, 2.0)], vec![disk(0.0, 2.0)]])).unwrap_err();
    assert!(matches!(error, Error::Crossing { plane: 0, first: 0, second: 1, .. }));
}

#[test]
fn planes_out_of_order_are_named() {
    let mut unsorted = stack(vec![vec![disk(0.0, 2.0)]; 3]);
    unsorted.planes[2].z_mm = 1.0;
    assert!(matches!(graph(&unsorted), Err(Error::PlaneOrder { plane: 2, .. })));
    assert_eq!(graph(&stack(vec![vec![disk(0.0, 2.0)], vec![]])), Err(Error::TooFewPlanes { found: 1 }));
    let gap = stack(vec![vec![disk(0.0, 2.0)], vec![], vec![disk(0.0, 2.0)]]);
    assert_eq!(graph(&gap), Err(Error::EmptyPlane { plane: 1, z_mm: 3.0 }));
    let apart = stack(vec![vec![disk(0.0, 2.0)], vec![disk(9.0, 2.0)]]);
    assert_eq!(graph(&apart), Err(Error::NothingContinues));
}
