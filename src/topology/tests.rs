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
fn an_end_beside_a_beginning_is_asked_about() {
    // Three disks, and three beside them: overlapping by a sliver of 1 %, and half a millimetre apart.
    for x in [7.5, 8.5] {
        let planes = stack((0..6).map(|k| vec![disk(if k < 3 { 0.0 } else { x }, 4.0)]).collect());
        let asked = ask(&planes).unwrap_err();
        assert!(matches!(asked, Error::Undecided { lower_plane: 2, upper_plane: 3, lower: 0, upper: 0, .. }));
        for (join, branches) in [(true, 1), (false, 2)] {
            let link = LinkDecision { plane: 2, lower: Pick::Number(0), upper: Pick::Number(0), join };
            let decided = Decisions { link: vec![link], ..Decisions::default() };
            let graph = graph_decided_by(&planes, &decided).unwrap();
            assert_eq!(graph.branches().len(), branches);
            let told = graph.warnings.iter().any(|w| w.code == "topology.interrupted");
            assert_eq!(told, !join);
        }
    }
    let far = stack((0..6).map(|k| vec![disk(if k < 3 { 0.0 } else { 30.0 }, 4.0)]).collect());
    let graph = ask(&far).unwrap();
    assert_eq!((graph.branches().len(), graph.warnings.len()), (2, 1));
    assert_eq!(graph.warnings[0].code, "topology.interrupted");
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
fn a_ring_that_begins_at_once_is_told() {
    let ring = || vec![disk(20.0, 4.0), hole(20.0, 2.0)];
    let with = |more: Vec<Contour>| [vec![disk(0.0, 3.0)], more].concat();
    let planes = vec![with(vec![]), with(ring()), with(ring()), with(vec![])];
    let graph = ask(&stack(planes)).unwrap();
    let told: Vec<&str> = graph.warnings.iter().map(|w| w.code.as_str()).collect();
    assert_eq!(told, ["topology.ring_end"; 2]);
    assert_eq!(events(&graph), [(1, 1); 5]);
}

#[test]
fn an_island_in_a_hole_is_a_branch_of_its_own() {
    let planes = vec![vec![disk(0.0, 6.0), hole(0.0, 4.0), disk(0.0, 1.0)]; 3];
    let graph = ask(&stack(planes)).unwrap();
    assert_eq!(events(&graph), [(1, 1); 6]);
}

fn is_elementary(graph: &Graph) -> bool {
    let mut below = vec![0; graph.nodes.len()];
    let mut above = below.clone();
    for star in &graph.stars {
        star.lower.iter().for_each(|&n| above[n] += 1);
        star.upper.iter().for_each(|&n| below[n] += 1);
        let flat =
            |nodes: &[usize]| nodes.iter().all(|&n| graph.nodes[n].plane == graph.nodes[nodes[0]].plane);
        if (star.is_event() && star.lower.len() > 1 && star.upper.len() > 1)
            || !flat(&star.lower)
            || !flat(&star.upper)
        {
            return false;
        }
    }
    graph.nodes.windows(2).all(|n| n[0].plane <= n[1].plane)
        && graph.z_mm.windows(2).all(|z| z[0] < z[1])
        && below.iter().chain(&above).all(|n| *n <= 1)
}

#[test]
fn two_contours_that_meet_two_others_are_parted_by_a_virtual_plane() {
    let across = |c: Contour| Contour::new(c.points.iter().map(|p| Point2::new(-p.y, p.x)).collect());
    let (low, high) =
        (vec![disk(-2.0, 1.9), disk(2.0, 1.9)], vec![across(disk(-2.0, 1.9)), across(disk(2.0, 1.9))]);
    // Another branch far away keeps its own planes.
    let with_other = |mut plane: Vec<Contour>| {
        plane.push(disk(30.0, 3.0));
        plane
    };
    let planes = vec![low.clone(), low, high.clone(), high].into_iter().map(with_other);
    let graph = ask(&stack(planes.collect())).unwrap();
    assert!(is_elementary(&graph), "{:?}", graph.stars);
    let virtual_planes: Vec<usize> = (0..graph.z_mm.len()).filter(|&p| graph.is_virtual(p)).collect();
    assert!(!virtual_planes.is_empty());
    assert!(graph.z_mm[virtual_planes[0]] > 3.0 && graph.z_mm[virtual_planes[0]] < 6.0);
    assert_eq!(graph.warnings[0].code, "topology.virtual_plane");
    let other =
        graph.branches().into_iter().find(|b| graph.nodes[b.nodes[0]].contour.centroid().x > 20.0).unwrap();
    assert_eq!(other.nodes.len(), 4);
    assert!(graph.branches().len() >= 6);
}

#[test]
fn branches_that_swap_partners_in_one_interval_are_parted() {
    // Three below, two above, each of these over two of those.
    let planes =
        vec![vec![disk(-4.0, 1.5), disk(0.0, 1.5), disk(4.0, 1.5)], vec![disk(-2.0, 1.8), disk(2.0, 1.8)]];
    let graph = graph(&stack(planes)).unwrap();
    assert!(is_elementary(&graph), "{:?}", graph.stars);
}

#[test]
fn holes_that_meet_holes_are_parted_inside_out() {
    let across = |c: Contour| Contour::new(c.points.iter().map(|p| Point2::new(-p.y, p.x)).collect());
    let low = || vec![disk(0.0, 8.0), hole(-2.0, 1.9), hole(2.0, 1.9)];
    let high = || vec![disk(0.0, 8.0), across(hole(-2.0, 1.9)), across(hole(2.0, 1.9))];
    let graph = ask(&stack(vec![low(), low(), high(), high()])).unwrap();
    assert!(is_elementary(&graph), "{:?}", graph.stars);
    let on_virtual = graph.nodes.iter().filter(|n| graph.is_virtual(n.plane));
    assert!(on_virtual.clone().count() > 0 && on_virtual.clone().all(Node::is_hole));
}

#[test]
fn two_halves_that_close_to_a_ring_are_parted() {
    let half = |turn: f64| {
        let arc = |radius: f64, from: f64, to: f64| {
            (0..40).map(move |i| {
                let angle = (from + (to - from) * f64::from(i) / 39.0 + turn).to_radians();
                Point2::new(radius * angle.cos(), radius * angle.sin())
            })
        };
        Contour::new(arc(4.0, -75.0, 75.0).chain(arc(2.0, 75.0, -75.0)).collect())
    };
    let ring = || vec![disk(0.0, 4.0), hole(0.0, 2.0)];
    let halves = || vec![half(0.0), half(180.0)];
    let graph = ask(&stack(vec![halves(), halves(), ring(), ring()])).unwrap();
    assert!(is_elementary(&graph), "{:?}", graph.stars);
    assert!(graph.warnings.iter().any(|w| w.code == "topology.virtual_plane"), "{:?}", graph.warnings);
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

/// Two planes, the second one at a height and with contours as given, and what they are refused with.
#[test]
fn every_bad_stack_says_where_and_what_to_do() {
    let good = || disk(0.0, 2.0);
    let refused = |z_mm: f64, contours: Vec<Contour>| {
        let mut bad = stack(vec![vec![good()], contours, vec![good()]]);
        bad.planes[1].z_mm = z_mm;
        ask(&bad).unwrap_err().to_string()
    };
    let mut nan = good();
    nan.points[7].x = f64::NAN;
    let three = Contour::circle(Point2::origin(), 1.0, 3);
    let cases = [
        (
            refused(3.0, vec![nan]),
            "plane 1 (z 3 mm), contour 0: point 7 is not a finite coordinate within 5 m: redraw or remove it",
        ),
        (
            refused(3.0, vec![good(), three]),
            "plane 1 (z 3 mm), contour 1: it has 3 different points, at least 4 are needed: redraw or remove it",
        ),
        (
            refused(3.0, vec![good(), disk(3.0, 2.0)]),
            "plane 1 (z 3 mm): contours 0 and 1 cross: join them or move them apart",
        ),
        (
            refused(3.0, vec![good(), good()]),
            "plane 1 (z 3 mm): contours 0 and 1 are the same curve: remove one of them",
        ),
        (
            refused(3.0, vec![]),
            "plane 1 (z 3 mm) has no contour, but planes below and above it have: draw one, or take the plane out of the stack",
        ),
        (
            refused(6.0, vec![good()]),
            "planes 1 and 2 lie at one height, z 6 mm: drop one of them, or correct z_mm",
        ),
        (
            refused(f64::NAN, vec![good()]),
            "plane 1: its height is NaN mm, expected a number between -100000 and 100000: correct z_mm",
        ),
        (
            refused(3.0, vec![disk(0.0, 2.0); 1001]),
            "plane 1 (z 3 mm) has 1001 contours, expected at most 1000: remove those that are not the vessel's",
        ),
        (
            refused(3.0, vec![Contour::circle(Point2::origin(), 2.0, 50_001)]),
            "plane 1 (z 3 mm), contour 0: it has 50001 points, at most 50000 are expected: redraw or remove it",
        ),
        (
            ask(&stack(vec![vec![good()]; 20_001])).unwrap_err().to_string(),
            "the stack has 20001 planes, expected at most 20000: leave planes out",
        ),
        (
            ask(&stack(vec![vec![good()]])).unwrap_err().to_string(),
            "a solid needs contours on at least two planes; found 1: add planes, or widen the z range",
        ),
        (
            refused(3.0, vec![disk(90.0, 2.0)]),
            "no contour overlaps one of the next plane: the planes lie too far apart, or in the wrong order",
        ),
    ];
    for (found, expected) in cases {
        assert_eq!(found, expected);
    }
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
fn the_operator_decides_what_is_joined_and_what_is_left_out() {
    let planes = || stack(vec![vec![disk(0.0, 4.0)], vec![disk(-2.5, 2.0), disk(2.5, 2.0)]]);
    let apart = |upper| Decisions {
        link: vec![LinkDecision { plane: 0, lower: Pick::Number(0), upper, join: false }],
        ..Decisions::default()
    };
    for upper in [Pick::Number(1), Pick::Point([3.0, 0.5])] {
        let graph = graph_decided_by(&planes(), &apart(upper)).unwrap();
        assert_eq!(events(&graph), [(1, 1)]);
        assert!(graph.warnings.iter().any(|w| w.code == "topology.island_dropped"));
    }
    let drop = DropDecision { plane: 1, contour: Pick::Number(0) };
    let graph = graph_decided_by(&planes(), &Decisions { drop: vec![drop], ..Decisions::default() }).unwrap();
    assert_eq!((events(&graph), graph.nodes[1].number), (vec![(1, 1)], Some(1)));
    let far = stack(vec![vec![disk(0.0, 2.0)], vec![disk(9.0, 2.0)]]);
    let join = LinkDecision { plane: 0, lower: Pick::Number(0), upper: Pick::Number(0), join: true };
    let graph = graph_decided_by(&far, &Decisions { link: vec![join], ..Decisions::default() }).unwrap();
    assert_eq!((events(&graph), graph.links[0].reason), (vec![(1, 1)], Reason::Decided));
}

#[test]
fn a_decision_about_what_is_not_there_is_refused_with_its_place() {
    let planes = stack(vec![vec![disk(0.0, 2.0)]; 2]);
    let refused = |decisions: Decisions| graph_decided_by(&planes, &decisions).unwrap_err().to_string();
    let drop =
        |plane, contour| Decisions { drop: vec![DropDecision { plane, contour }], ..Decisions::default() };
    let link = |plane| Decisions {
        link: vec![LinkDecision { plane, lower: Pick::Number(0), upper: Pick::Number(0), join: true }],
        ..Decisions::default()
    };
    for (decisions, message) in [
        (
            drop(7, Pick::Number(0)),
            "topology.drop 0 in case.toml: there is no plane 7, the planes are 0 to 1",
        ),
        (drop(1, Pick::Number(2)), "topology.drop 0 in case.toml: 2 is no contour of plane 1, which has 1"),
        (
            drop(1, Pick::Point([9.0, 0.0])),
            "topology.drop 0 in case.toml: the point [9, 0] is no contour of plane 1, which has 1",
        ),
        (
            link(1),
            "topology.link 0 in case.toml: plane 1 is the uppermost: name the lower one of the two planes",
        ),
    ] {
        assert_eq!(refused(decisions), message);
    }
}

#[test]
fn what_overlap_and_drift_do_not_decide_is_asked_and_can_be_answered() {
    // On the last plane a contour appears that lies over the trunk's edge by an eighth: nothing says whether it parts.
    let planes = stack(vec![
        vec![disk(0.0, 3.0)],
        vec![disk(0.0, 3.0)],
        vec![disk(0.0, 3.0)],
        vec![disk(-0.4, 2.6), disk(3.6, 1.0)],
    ]);
    let error = ask(&planes).unwrap_err();
    let text = error.to_string();
    assert!(
        text.starts_with(
            "planes 2 and 3: whether contour 0 continues in contour 1 cannot be decided (they hardly overlap"
        ) && text.ends_with("[[topology.link]] plane = 2, lower = 0, upper = 1, join = true or false"),
        "{text}"
    );
    for (join, stars) in [(true, vec![(1, 1), (1, 1), (1, 2)]), (false, vec![(1, 1); 3])] {
        let link = LinkDecision { plane: 2, lower: Pick::Number(0), upper: Pick::Number(1), join };
        let decisions = Decisions { link: vec![link], ..Decisions::default() };
        assert_eq!(events(&graph_decided_by(&planes, &decisions).unwrap()), stars);
    }
    let by_rule = graph(&planes).unwrap();
    assert!(by_rule.warnings.iter().any(|w| w.code == "topology.decided_by_rule"));
}

#[test]
fn the_matching_names_events_and_is_drawn() {
    let ring = || vec![disk(0.0, 4.0), hole(0.0, 2.0)];
    let planes = vec![
        vec![c_shape(), disk(20.0, 3.0)],
        vec![c_shape(), disk(20.0, 3.0)],
        [ring(), vec![disk(18.5, 1.3), disk(21.5, 1.3)]].concat(),
        [ring(), vec![disk(18.5, 1.3), disk(21.5, 1.3)]].concat(),
        vec![disk(0.0, 4.0), disk(18.5, 1.3)],
    ];
    let graph = ask(&stack(planes)).unwrap();
    let matching = Matching::of(&graph);
    let expected = Summary { branches: 5, splits: 1, deaths: 1, holes: 1, ..Summary::default() };
    assert_eq!(matching.summary, expected, "{:?}", matching.events);
    let words: Vec<&str> = matching.events.iter().map(|e| e.kind.words()).collect();
    assert_eq!(words, ["hole closes off", "split", "hole ends", "death"]);
    let split = matching.events.iter().find(|e| e.kind == matching::EventKind::Split).unwrap();
    assert_eq!(
        split.text,
        "split: plane 1 (z 3.00 mm) contour 1 below, plane 2 (z 6.00 mm) contours 2, 3 above"
    );
    assert!(matching.links.iter().all(|l| !l.text.is_empty()));
    let text = serde_json::to_string(&matching).unwrap();
    assert_eq!(serde_json::from_str::<Matching>(&text).unwrap(), matching);
    let svg = drawing::svg(&matching);
    assert!(svg.starts_with("<svg ") && svg.ends_with("</svg>\n"));
    assert_eq!(svg.matches("<circle").count(), graph.nodes.len());
    assert!(svg.contains("plane 4, z 12.00 mm") && svg.contains(">hole closes off: "));
}

#[test]
fn what_is_repaired_before_a_case_is_made_needs_no_repair_afterwards() {
    let mut given = stack(vec![vec![hole(0.0, 3.0)], vec![disk(0.0, 3.0), disk(0.0, 1.0)]]);
    given.planes.swap(0, 1);
    let (mended, warnings) = repaired(given);
    assert_eq!(warnings.len(), 2, "{warnings:?}");
    assert_eq!(mended.plane_z_mm(), [0.0, 3.0]);
    assert!(mended.planes[0].contours[0].is_ccw() && !mended.planes[1].contours[1].is_ccw());
    assert_eq!(repaired(mended.clone()), (mended, vec![]));
    let hopeless = stack(vec![vec![disk(0.0, 2.0), disk(1.0, 2.0)]]);
    assert_eq!(repaired(hopeless.clone()), (hopeless, vec![]));
}

/// Trees of leaning tubes, their contours united plane by plane: splits, merges, births and deaths where they meet and
/// end.
#[derive(Debug, Clone)]
struct Tubes {
    tubes: Vec<Tube>,
    gaps_mm: Vec<f64>,
}

/// Place at z 0 and lean (mm, mm/mm), radius, first and last plane.
type Tube = ([f64; 2], [f64; 2], f64, usize, usize);

impl Tubes {
    fn stack(&self) -> SectionStack {
        let mut z_mm = 0.0;
        let mut planes = Vec::new();
        for (k, gap) in self.gaps_mm.iter().enumerate() {
            z_mm += gap;
            let alive = self.tubes.iter().filter(|t| (t.3..=t.4).contains(&k));
            let disk = |([x, y], [sx, sy], r, ..): &Tube| {
                let centre = Point2::new(sx.mul_add(z_mm, *x), sy.mul_add(z_mm, *y));
                crate::geom::Region::new(vec![Contour::circle(centre, *r, 48)])
            };
            let disks: Vec<_> = alive.map(disk).collect();
            planes.push((z_mm, crate::geom::Region::union_all(&disks).contours));
        }
        stack_at(planes)
    }
}

fn tubes() -> impl proptest::strategy::Strategy<Value = Tubes> {
    use proptest::prelude::*;
    let place = || [-6.0..6.0f64, -6.0..6.0f64];
    let lean = || [-0.7..0.7f64, -0.7..0.7f64];
    let tube = (place(), lean(), 1.0..3.0f64, 0usize..4, 4usize..9);
    let trunk = (place(), lean(), 2.0..4.0f64, Just(0usize), Just(8usize));
    let gaps = prop::collection::vec(1.0..3.5f64, 9);
    (trunk, prop::collection::vec(tube, 0..4), gaps).prop_map(|(trunk, mut tubes, gaps_mm)| {
        tubes.push(trunk);
        Tubes { tubes, gaps_mm }
    })
}

/// The graph without its numbers: every given contour by plane height and area, tied to its partners.
fn shape(graph: &Graph, turn: f64) -> Vec<String> {
    let name = |n: &usize| {
        let node = &graph.nodes[*n];
        format!("{:.3}:{:.3}", turn * graph.z_mm[node.plane], node.contour.signed_area_mm2())
    };
    let side = |nodes: &[usize]| {
        let mut names: Vec<String> = nodes.iter().map(name).collect();
        names.sort();
        names.join("+")
    };
    let given = |s: &&Star| s.lower.iter().chain(&s.upper).all(|&n| !graph.is_virtual(graph.nodes[n].plane));
    let mut stars: Vec<String> = graph
        .stars
        .iter()
        .filter(given)
        .map(|s| {
            let (lower, upper) = if turn > 0.0 { (&s.lower, &s.upper) } else { (&s.upper, &s.lower) };
            format!("{} -> {}", side(lower), side(upper))
        })
        .collect();
    stars.sort();
    stars
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig { rng_seed: proptest::test_runner::RngSeed::Fixed(7), ..proptest::prelude::ProptestConfig::with_cases(96) })]

    #[test]
    fn a_stack_turned_over_gives_the_graph_turned_over(tubes in tubes()) {
        let stack = tubes.stack();
        let mut over = stack.clone();
        over.planes.reverse();
        over.planes.iter_mut().for_each(|p| p.z_mm = -p.z_mm);
        match (graph(&stack), graph(&over)) {
            (Ok(a), Ok(b)) => proptest::prop_assert_eq!(shape(&a, 1.0), shape(&b, -1.0)),
            (a, b) => proptest::prop_assert_eq!(a.is_ok(), b.is_ok()),
        }
    }

    #[test]
    fn numbers_of_contours_do_not_matter(tubes in tubes()) {
        let stack = tubes.stack();
        let mut renumbered = stack.clone();
        renumbered.planes.iter_mut().for_each(|p| p.contours.reverse());
        match (graph(&stack), graph(&renumbered)) {
            (Ok(a), Ok(b)) => proptest::prop_assert_eq!(shape(&a, 1.0), shape(&b, 1.0)),
            (a, b) => proptest::prop_assert_eq!(a.is_ok(), b.is_ok()),
        }
    }

    #[test]
    fn only_elementary_events_are_left(tubes in tubes()) {
        let stack = tubes.stack();
        if let Ok(graph) = graph(&stack) {
            proptest::prop_assert!(is_elementary(&graph));
        }
    }
}
