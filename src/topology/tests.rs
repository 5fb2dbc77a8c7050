use super::*;
use crate::geom::{Contour, Point2, RigidTransform, Vector2};
use crate::phantom::{Kind, Vessel};
use crate::sections::{PlaneSections, SectionStack};

pub(super) fn stack_at(planes: Vec<(f64, Vec<Contour>)>) -> SectionStack {
    let planes = planes.into_iter().map(|(z_mm, contours)| PlaneSections { z_mm, contours }).collect();
    SectionStack { planes, patient_from_stack: RigidTransform::identity() }
}

pub(super) fn stack(planes: Vec<Vec<Contour>>) -> SectionStack {
    stack_at(planes.into_iter().enumerate().map(|(i, contours)| (3.0 * i as f64, contours)).collect())
}

pub(super) fn disk(x: f64, radius_mm: f64) -> Contour {
    Contour::circle(Point2::new(x, 0.0), radius_mm, 64)
}

fn hole(x: f64, radius_mm: f64) -> Contour {
    disk(x, radius_mm).reversed()
}

/// A ring of 2..4 mm, open towards +x over a quarter of the turn.
fn c_shape() -> Contour {
    let arc = |radius: f64, from: f64, to: f64| {
        (0..40).map(move |i| {
            let angle = (from + (to - from) * f64::from(i) / 39.0).to_radians();
            Point2::new(radius * angle.cos(), radius * angle.sin())
        })
    };
    Contour::new(arc(4.0, 45.0, 315.0).chain(arc(2.0, 315.0, 45.0)).collect())
}

fn ask(stack: &SectionStack) -> Result<Graph, Error> {
    graph_decided_by(stack, &Decisions::default())
}

/// Stars as the numbers of their contours.
fn events(graph: &Graph) -> Vec<(usize, usize)> {
    graph.stars.iter().map(|s| (s.lower.len(), s.upper.len())).collect()
}

#[test]
fn a_split_is_one_star() {
    let graph = ask(&stack(vec![vec![disk(0.0, 4.0)], vec![disk(-2.5, 2.0), disk(2.5, 2.0)]])).unwrap();
    assert_eq!(graph.stars, vec![Star { interval: 0, lower: vec![0], upper: vec![1, 2] }]);
    assert_eq!(graph.branches().len(), 3);
}

#[test]
fn a_steep_branch_is_followed_by_its_drift() {
    let graph = ask(&stack(vec![vec![disk(0.0, 2.0)], vec![disk(3.5, 2.0)], vec![disk(7.6, 2.0)]])).unwrap();
    assert_eq!(graph.stars.len(), 2);
    assert!(graph.warnings.is_empty());
}

#[test]
fn a_branch_that_never_overlaps_itself_is_followed_by_its_course() {
    let steep = (0..5).map(|k| vec![disk(5.2 * f64::from(k), 2.0)]).collect();
    let graph = ask(&stack(steep)).unwrap();
    assert_eq!(events(&graph), [(1, 1); 4]);
    assert!(graph.links.iter().all(|l| matches!(l.reason, Reason::Drift | Reason::Course)));
}

#[test]
fn a_branch_that_leaves_the_trunk_steeply_is_linked_to_it() {
    // Sixty degrees off the axis, a third of the trunk's radius.
    let planes = (0..6).map(|k| {
        let trunk = disk(0.0, 3.0);
        if k < 2 { vec![trunk] } else { vec![trunk, disk(2.0 + 5.2 * f64::from(k - 1), 1.2)] }
    });
    let graph = ask(&stack(planes.collect())).unwrap();
    assert_eq!(events(&graph).iter().filter(|e| **e == (1, 2)).count(), 1);
    assert_eq!(graph.branches().len(), 3);
}

#[test]
fn a_branch_born_beside_the_trunk_is_not_linked_by_a_sliver() {
    // The trunk leans away; what is born behind it lies where the trunk was on the plane before.
    let planes = (0..6).map(|k| {
        let x = 1.5 * f64::from(k);
        let trunk = disk(x, 3.0);
        if k < 3 { vec![trunk] } else { vec![trunk, disk(x - 4.2, 1.0)] }
    });
    let graph = ask(&stack(planes.collect())).unwrap();
    assert_eq!(events(&graph), [(1, 1); 7]);
    assert!(graph.links.iter().any(|l| !l.joined && l.reason == Reason::Sliver));
}

#[test]
fn branches_that_lean_over_each_others_place_are_not_crossed() {
    let planes = (0..6).map(|k| {
        let x = 1.2 * f64::from(k);
        vec![disk(x, 2.0), disk(x + 4.2, 2.0)]
    });
    let graph = ask(&stack(planes.collect())).unwrap();
    assert_eq!(events(&graph), [(1, 1); 10]);
    assert_eq!(graph.branches().len(), 2);
}

#[test]
fn an_island_is_left_out_and_reported() {
    let planes = vec![vec![disk(0.0, 2.0)], vec![disk(0.1, 2.0), disk(20.0, 1.0)], vec![disk(0.2, 2.0)]];
    let graph = ask(&stack(planes)).unwrap();
    assert_eq!(graph.nodes.len(), 3);
    assert_eq!(graph.warnings[0].code, "topology.island_dropped");
}

#[test]
fn holes_go_on_inside_the_lumen() {
    let ring = || vec![disk(0.0, 4.0), hole(0.2, 1.5)];
    let graph = ask(&stack(vec![vec![disk(0.0, 4.0)], ring(), ring(), vec![disk(0.0, 4.0)]])).unwrap();
    assert_eq!(graph.nodes.iter().filter(|n| n.is_hole()).count(), 2);
    assert_eq!(events(&graph), [(1, 1); 4]);
    // The hole begins and ends inside: nothing is below and above it.
    let (above, below) = (graph.stars_above(), graph.stars_below());
    let ends = graph
        .nodes
        .iter()
        .enumerate()
        .filter(|(i, n)| n.is_hole() && (above[*i].is_none() || below[*i].is_none()));
    assert_eq!(ends.count(), 2);
}

#[test]
fn a_hole_that_opens_is_a_star_of_the_c_the_ring_and_the_hole() {
    let ring = || vec![disk(0.0, 4.0), hole(0.0, 2.0)];
    let graph = ask(&stack(vec![vec![c_shape()], vec![c_shape()], ring(), ring(), vec![c_shape()]])).unwrap();
    assert_eq!(events(&graph), [(1, 1), (1, 2), (1, 1), (1, 1), (2, 1)]);
    let opening = &graph.stars[1];
    assert!(!graph.nodes[opening.upper[0]].is_hole() && graph.nodes[opening.upper[1]].is_hole());
    assert!(graph.links.iter().any(|l| l.reason == Reason::HoleOpens));
}

#[test]
fn an_island_in_a_hole_is_a_branch_of_its_own() {
    let planes = vec![vec![disk(0.0, 6.0), hole(0.0, 4.0), disk(0.0, 1.0)]; 3];
    let graph = ask(&stack(planes)).unwrap();
    assert_eq!(events(&graph), [(1, 1); 6]);
}

#[test]
fn every_plane_of_the_phantoms_is_linked_without_asking() {
    for kind in Kind::ALL {
        let vessel = Vessel::new(kind);
        let plane = |k: u32| (3.0 * f64::from(k), vessel.region_at(3.0 * f64::from(k), 128).contours);
        let graph = ask(&stack_at((0..46).map(plane).collect())).unwrap();
        let n_ends = graph.stars_above().iter().filter(|s| s.is_none()).count();
        let on_top = graph.nodes.iter().filter(|n| n.plane == 45).count();
        assert_eq!(n_ends, on_top, "{kind:?}");
        assert!(graph.warnings.is_empty(), "{kind:?} {:?}", graph.warnings);
    }
}

#[test]
fn bad_contours_are_named() {
    let with = |bad: Contour| ask(&stack(vec![vec![disk(0.0, 2.0)], vec![bad]])).unwrap_err();
    let polygon =
        |points: &[(f64, f64)]| Contour::new(points.iter().map(|&(x, y)| Point2::new(x, y)).collect());
    assert_eq!(
        with(polygon(&[(0., 0.), (4., 4.), (4., 0.), (0., 4.)])).to_string(),
        "plane 1 (z 3 mm), contour 0: it crosses itself near x 2.000, y 2.000 mm: redraw or remove it"
    );
    let mut nan = disk(0.0, 2.0);
    nan.points[7].x = f64::NAN;
    assert!(matches!(with(nan), Error::Contour { fault: ContourFault::NotFinite(7), .. }));
    let mut far = disk(0.0, 2.0);
    far.points[3].y = 1e7;
    assert!(matches!(with(far), Error::Contour { fault: ContourFault::NotFinite(3), .. }));
    let three = Contour::circle(Point2::origin(), 1.0, 3);
    assert!(matches!(with(three), Error::Contour { fault: ContourFault::TooFewPoints(3), .. }));
    let line = polygon(&[(0., 0.), (1., 0.), (2., 0.), (3., 0.), (1.5, 0.)]);
    assert!(matches!(with(line), Error::Contour { fault: ContourFault::NoArea, .. }));
    let empty = Contour::new(Vec::new());
    assert!(matches!(with(empty), Error::Contour { fault: ContourFault::TooFewPoints(0), .. }));
}

#[test]
fn contours_that_cross_or_repeat_each_other_are_named() {
    let plane = |contours| ask(&stack(vec![contours, vec![disk(0.0, 2.0)]])).unwrap_err();
    let crossing = plane(vec![disk(9.0, 1.0), disk(0.0, 2.0), disk(3.0, 2.0)]);
    assert!(matches!(crossing, Error::Crossing { plane: 0, first: 1, second: 2, .. }), "{crossing}");
    let hole_through = plane(vec![disk(0.0, 2.0), hole(1.5, 1.0)]);
    assert!(matches!(hole_through, Error::Crossing { plane: 0, first: 0, second: 1, .. }));
    let twice = plane(vec![disk(0.0, 2.0), disk(0.0, 2.0)]);
    assert!(matches!(twice, Error::RepeatedContour { plane: 0, first: 0, second: 1, .. }), "{twice}");
}

#[test]
fn harmless_faults_are_repaired_and_told() {
    let told = |bad: Contour| {
        let graph = ask(&stack(vec![vec![disk(0.0, 2.0)], vec![bad], vec![disk(0.0, 2.0)]])).unwrap();
        let codes: Vec<String> = graph.warnings.iter().map(|w| w.code.clone()).collect();
        (graph.nodes[1].contour.clone(), codes)
    };
    let mut closed = disk(0.0, 2.0);
    closed.points.push(closed.points[0]);
    assert_eq!(told(closed), (disk(0.0, 2.0), vec![]));
    let mut repeated = disk(0.0, 2.0);
    repeated.points.insert(5, repeated.points[5]);
    assert_eq!(told(repeated), (disk(0.0, 2.0), vec!["topology.repeated_points".into()]));
    let mut spiked = disk(0.0, 2.0);
    let (foot, tip) = (spiked.points[9], spiked.points[9] + Vector2::new(3.0, 2.0));
    spiked.points.splice(9..10, [foot, tip, foot]);
    assert_eq!(told(spiked), (disk(0.0, 2.0), vec!["topology.spikes".into()]));
    assert_eq!(told(hole(0.0, 2.0)), (disk(0.0, 2.0), vec!["topology.turned_round".into()]));
    let mut open = disk(0.0, 2.0);
    open.points.truncate(50);
    assert_eq!(told(open.clone()), (open, vec!["topology.open_contour".into()]));
}

#[test]
fn nested_contours_of_any_direction_become_outlines_and_holes() {
    let wrong = vec![hole(0.0, 4.0), disk(0.0, 2.0)];
    let graph = ask(&stack(vec![wrong.clone(), wrong])).unwrap();
    assert_eq!(graph.nodes.iter().map(Node::is_hole).collect::<Vec<_>>(), [false, true, false, true]);
    assert_eq!(graph.warnings[0].code, "topology.turned_round");
    assert!(graph.warnings[0].text.starts_with("4 contour(s)"), "{}", graph.warnings[0].text);
}

#[test]
fn planes_are_sorted_and_told_and_repeated_ones_are_named() {
    let mut unsorted = stack(vec![vec![disk(0.0, 2.0)]; 3]);
    unsorted.planes[2].z_mm = 1.0;
    let graph = ask(&unsorted).unwrap();
    assert_eq!((graph.z_mm, graph.given), (vec![0.0, 1.0, 3.0], vec![Some(0), Some(2), Some(1)]));
    assert_eq!(graph.warnings[0].code, "topology.planes_sorted");
    unsorted.planes[2].z_mm = 0.0;
    assert_eq!(ask(&unsorted), Err(Error::RepeatedPlane { first: 0, second: 2, z_mm: 0.0 }));
    unsorted.planes[2].z_mm = f64::NAN;
    assert!(matches!(ask(&unsorted), Err(Error::PlaneHeight { plane: 2, .. })));
}

#[test]
fn stacks_that_are_no_vessel_are_refused() {
    assert_eq!(ask(&stack(vec![])), Err(Error::TooFewPlanes { found: 0 }));
    assert_eq!(ask(&stack(vec![vec![disk(0.0, 2.0)]])), Err(Error::TooFewPlanes { found: 1 }));
    assert_eq!(ask(&stack(vec![vec![disk(0.0, 2.0)], vec![]])), Err(Error::TooFewPlanes { found: 1 }));
    let gap = stack(vec![vec![disk(0.0, 2.0)], vec![], vec![disk(0.0, 2.0)]]);
    assert_eq!(ask(&gap), Err(Error::EmptyPlane { plane: 1, z_mm: 3.0 }));
    let apart = stack(vec![vec![disk(0.0, 2.0)], vec![disk(90.0, 2.0)]]);
    assert_eq!(ask(&apart), Err(Error::NothingContinues));
}

#[test]
fn empty_planes_beyond_the_vessel_do_no_harm() {
    let graph = ask(&stack(vec![vec![], vec![disk(0.0, 2.0)], vec![disk(0.0, 2.0)], vec![]])).unwrap();
    assert_eq!(graph.stars.len(), 1);
}

#[test]
#[ignore = "a measurement"]
fn cost_of_long_stacks() {
    let vessel = Vessel::new(Kind::Carotid);
    for n in [46u32, 460, 4600] {
        let plane = |k: u32| {
            let z = 135.0 * f64::from(k) / f64::from(n - 1);
            (z, vessel.region_at(z, 128).contours)
        };
        let stack = stack_at((0..n).map(plane).collect());
        let best = (0..5).map(|_| {
            let clock = std::time::Instant::now();
            graph(&stack).unwrap();
            clock.elapsed().as_secs_f64() * 1e3
        });
        eprintln!("{n} planes: {:.2} ms", best.fold(f64::INFINITY, f64::min));
    }
}
