//! What is put in must be found: its kind, its stage, its place, its size, and nothing else.

use crate::ct::Voxels;
use crate::geom::{Contour, Point2, Region, Vector2};
use crate::progress::Task;
use crate::report::record::Segment;
use crate::report::testing::{
    BEAD_MM, Forked, INTERVAL_MM, LAYER_MM, RADIUS_MM, fork, inputs, print, region_of,
};
use crate::report::*;

const N_PLANES: usize = 10;
const N_LAYERS: usize = 15 * N_PLANES;

fn case() -> Forked {
    Forked::new(N_PLANES)
}

fn report(case: &Forked) -> Report {
    build(&inputs(case), &Task::quiet()).unwrap()
}

fn told(report: &Report) -> String {
    report.findings.iter().map(|f| format!("{f:?}\n")).collect()
}

/// The only finding.
fn only(report: &Report) -> Finding {
    assert_eq!(report.findings.len(), 1, "{}", told(report));
    report.findings[0].clone()
}

fn is_near(finding: &Finding, expected: f64) {
    let size = finding.size.unwrap();
    assert!((size.size - expected).abs() <= 0.1 * expected.abs(), "{expected} expected: {finding:?}");
}

/// Changes the recorded pieces of some layers.
fn spoil(case: &mut Forked, layers: std::ops::Range<usize>, change: impl Fn(usize, &mut Segment)) {
    let z_mm: Vec<f64> = case.paths.layers.iter().map(|l| l.z_mm).collect();
    for segment in &mut case.record.segments {
        let layer = z_mm.iter().position(|z| (z - segment.from.z).abs() < 0.01).unwrap();
        if layers.contains(&layer) {
            change(layer, segment);
        }
    }
}

fn moved(segment: &mut Segment, by: Vector2) {
    for p in [&mut segment.from, &mut segment.to] {
        (p.x, p.y) = (p.x + by.x, p.y + by.y);
    }
}

fn carried(segment: &mut Segment, change: impl Fn(Point2) -> Point2) {
    for p in [&mut segment.from, &mut segment.to] {
        let q = change(p.xy());
        (p.x, p.y) = (q.x, q.y);
    }
}

fn layer_of_segment(case: &Forked, s: &Segment) -> usize {
    case.paths.layers.iter().position(|l| (l.z_mm - s.from.z).abs() < 0.01).unwrap()
}

fn without(case: &mut Forked, is_lost: impl Fn(usize, &Segment) -> bool) {
    let layers: Vec<usize> = case.record.segments.iter().map(|s| layer_of_segment(case, s)).collect();
    let mut layers = layers.into_iter();
    case.record.segments.retain(|s| !is_lost(layers.next().unwrap(), s));
}

#[test]
fn on_a_clean_case_nothing_is_found() {
    let report = report(&case());
    assert!(report.findings.is_empty(), "{}", told(&report));
    assert!(report.verdict.passed, "{:?}", report.verdict);
    // The solid of the phantom is one lumen below the middle of its planes, two above.
    let [division] = &report.anatomy.divisions[..] else { panic!("{:?}", report.anatomy.divisions) };
    assert_eq!((division.trunk.as_str(), division.kind, division.planes), ("branch 1", "division", [4, 5]));
    assert!(
        (division.at_mm.unwrap()[2] - 0.5 * INTERVAL_MM * (N_PLANES - 1) as f64).abs()
            <= division.uncertainty_mm
    );
    assert!(
        division.angles.iter().all(|a| a.between_deg.is_some_and(|d| d > 1.0 && d < 30.0)),
        "{division:?}"
    );
}

#[test]
fn a_layer_shift_is_found_from_its_layer_with_its_vector() {
    let mut case = case();
    spoil(&mut case, 83..N_LAYERS, |_, s| moved(s, Vector2::new(0.24, -0.32)));
    let report = report(&case);
    let found = only(&report);
    assert_eq!(
        (found.stage, found.kind, found.place.layers),
        ("deposition", Kind::LayerShift, Some([83, 149]))
    );
    is_near(&found, 0.4);
    let [x, y] = found.vector_mm.unwrap();
    assert!((x - 0.24).abs() < 2e-3 && (y + 0.32).abs() < 2e-3);
    assert!(!report.verdict.passed && report.verdict.sentence().contains("from layer 83"));
    assert!(report.headline().iter().any(|l| l.starts_with("defect") && l.contains("0.400 mm")));
}

#[test]
fn shifts_that_end_and_shifts_upon_shifts_are_told_apart() {
    let mut case = case();
    spoil(&mut case, 40..60, |_, s| moved(s, Vector2::new(0.4, 0.0)));
    spoil(&mut case, 100..N_LAYERS, |_, s| moved(s, Vector2::new(0.0, 0.2)));
    spoil(&mut case, 120..N_LAYERS, |_, s| moved(s, Vector2::new(0.0, 0.3)));
    let report = report(&case);
    let found: Vec<_> = report.findings.iter().map(|f| (f.kind, f.place.layers.unwrap())).collect();
    let shift = Kind::LayerShift;
    assert_eq!(found, [(shift, [40, 59]), (shift, [100, 149]), (shift, [120, 149])], "{}", told(&report));
    is_near(&report.findings[1], 0.2);
    is_near(&report.findings[2], 0.3);
}

#[test]
fn a_part_that_leans_is_a_gradual_shift() {
    let mut case = case();
    spoil(&mut case, 50..N_LAYERS, |i, s| moved(s, Vector2::new(0.005 * (i as f64 - 50.0), 0.0)));
    let found = only(&report(&case));
    assert_eq!((found.stage, found.kind), ("deposition", Kind::GradualShift));
    assert!(found.place.layers.unwrap()[0].abs_diff(50) <= 2, "{found:?}");
    is_near(&found, 0.495);
}

#[test]
fn under_and_over_extrusion_are_found_by_volume_and_by_width() {
    for (flow, kind) in [(0.8, Kind::UnderExtrusion), (1.15, Kind::OverExtrusion)] {
        for (by_volume, by_width) in [(true, true), (true, false), (false, true)] {
            let mut case = case();
            spoil(&mut case, 50..100, |_, s| {
                s.volume_mm3 *= if by_volume { flow } else { 1.0 };
                s.width_mm *= if by_width { flow } else { 1.0 };
            });
            let found = only(&report(&case));
            assert_eq!((found.stage, found.kind, found.place.layers), ("deposition", kind, Some([50, 99])));
            is_near(&found, 100.0 * (flow - 1.0_f64).abs());
        }
    }
}

#[test]
fn a_clog_that_grows_is_told_with_its_worst() {
    let mut case = case();
    spoil(&mut case, 60..N_LAYERS, |i, s| {
        let left = 1.0 - 0.006 * (i as f64 - 60.0);
        s.volume_mm3 *= left;
        s.width_mm *= left;
    });
    let found = only(&report(&case));
    assert_eq!(found.kind, Kind::UnderExtrusion);
    assert!(found.place.layers.unwrap()[0].abs_diff(60) <= 2 && found.place.layers.unwrap()[1] == 149);
    is_near(&found, 100.0 * 0.006 * 89.0);
    assert!(found.text.contains("less and less"));
}

#[test]
fn a_missing_layer_a_stopped_print_and_a_missing_skin_are_named() {
    let mut missing = case();
    without(&mut missing, |layer, _| layer == 70);
    // The recorder tells the next layer's beads twice as high and half as wide.
    spoil(&mut missing, 71..72, |_, s| (s.height_mm, s.width_mm) = (2.0 * s.height_mm, 0.5 * s.width_mm));
    let found = only(&report(&missing));
    assert_eq!(
        (found.kind, found.place.layers, found.stage),
        (Kind::MissingLayers, Some([70, 70]), "deposition")
    );

    let mut stopped = case();
    without(&mut stopped, |layer, _| layer >= 120);
    let report_of_stopped = report(&stopped);
    let found = report_of_stopped.findings.iter().find(|f| f.kind == Kind::PrintStopped).unwrap();
    assert_eq!(found.place.layers, Some([120, 149]));

    let mut skinned = case();
    let circles = |layer: usize| fork(LAYER_MM * (layer as f64 - 7.0), N_PLANES);
    without(&mut skinned, |layer, s| {
        let at = Point2::new(s.from.x - 100.0, s.from.y - 90.0);
        (30..40).contains(&layer)
            && circles(layer).iter().any(|(c, r)| ((at - c).norm() - r - 0.5 * BEAD_MM).abs() < 0.01)
    });
    let found = only(&report(&skinned));
    assert_eq!((found.kind, found.place.layers), (Kind::MissingBeads, Some([30, 39])));
    assert!(found.text.contains("skin at the lumen"), "{found:?}");
}

#[test]
fn scaled_turned_and_mirrored_prints_are_named() {
    let about = Point2::new(100.0, 90.0);
    let turn = nalgebra::Rotation2::new(0.02);
    type Change<'a> = &'a dyn Fn(Point2) -> Point2;
    let cases: [(Kind, f64, Change<'_>); 4] = [
        (Kind::Scaled, 1.0, &|p| about + (p - about) * 1.01),
        (Kind::Scaled, -2.0, &|p| Point2::origin() + p.coords * 0.98),
        (Kind::Turned, 0.02_f64.to_degrees(), &|p| about + turn * (p - about)),
        (Kind::Mirrored, N_LAYERS as f64, &|p| Point2::new(200.0 - p.x, p.y)),
    ];
    for (kind, size, change) in cases {
        let mut case = case();
        spoil(&mut case, 0..N_LAYERS, |_, s| carried(s, change));
        let report = report(&case);
        let found = report.findings.iter().find(|f| f.kind == kind && f.stage == "deposition");
        let found = found.unwrap_or_else(|| panic!("{kind:?}: {}", told(&report)));
        assert_eq!(found.place.layers, Some([0, N_LAYERS - 1]));
        is_near(found, size);
        let others = report.findings.iter().filter(|f| f.kind != kind && f.kind != Kind::Plugged);
        assert_eq!(others.count(), 0, "{}", told(&report));
    }
}

#[test]
fn wrong_heights_are_found() {
    let mut scaled = case();
    scaled.record.segments.iter_mut().for_each(|s| (s.from.z, s.to.z) = (s.from.z * 1.01, s.to.z * 1.01));
    let found = only(&report(&scaled));
    assert_eq!(found.kind, Kind::WrongHeight);
    is_near(&found, 0.01 * LAYER_MM * N_LAYERS as f64);
    assert!(found.text.contains("+1.00 %"), "{found:?}");

    let mut lifted = case();
    spoil(&mut lifted, 75..N_LAYERS, |_, s| (s.from.z, s.to.z) = (s.from.z + 0.4, s.to.z + 0.4));
    let found = only(&report(&lifted));
    assert_eq!((found.kind, found.place.layers), (Kind::WrongHeight, Some([75, 149])));
    is_near(&found, 0.4);
}

#[test]
fn material_in_the_lumen_and_outside_is_found() {
    let mut strings = case();
    let z_mm = strings.paths.layers[30].z_mm;
    let (centre, radius_mm) = fork(LAYER_MM * 23.0, N_PLANES)[0];
    let at = |x: f64| crate::geom::Point3::new(100.0 + centre.x + x, 90.0 + centre.y, z_mm);
    let string = |a: f64, b: f64| Segment {
        from: at(a),
        to: at(b),
        volume_mm3: 0.02 * (b - a),
        width_mm: 0.1,
        height_mm: 0.2,
    };
    strings.record.segments.push(string(-radius_mm + 0.1, radius_mm - 0.1));
    let found = only(&report(&strings));
    assert_eq!(
        (found.kind, found.place.layers, found.stage),
        (Kind::MaterialInLumen, Some([30, 30]), "deposition")
    );
    is_near(&found, 0.02 * (2.0 * radius_mm - 0.2));

    let mut outside = case();
    outside.record.segments.push(string(radius_mm + 1.5, radius_mm + 4.5));
    let found = only(&report(&outside));
    assert_eq!((found.kind, found.place.layers), (Kind::MaterialOutside, Some([30, 30])));
}

#[test]
fn a_leak_on_all_ways_is_surplus_material_and_nothing_else() {
    let mut case = case();
    let (mut leaky, mut last) = (Vec::new(), None::<Segment>);
    for s in &case.record.segments {
        if let Some(l) = last.filter(|l| (l.to - s.from).norm() > 0.05 && (l.to.z - s.from.z).abs() < 0.01) {
            let volume_mm3 = 0.008 * (s.from - l.to).norm();
            leaky.push(Segment { from: l.to, to: s.from, volume_mm3, width_mm: 0.04, height_mm: 0.2 });
        }
        leaky.push(*s);
        last = Some(*s);
    }
    case.record.segments = leaky;
    let report = report(&case);
    assert!(!report.findings.is_empty());
    let is_surplus =
        |f: &Finding| matches!(f.kind, Kind::MaterialInLumen | Kind::MaterialInWall | Kind::MaterialOutside);
    assert!(report.findings.iter().all(is_surplus), "{}", told(&report));
}

#[test]
fn a_plugged_branch_is_found_where_it_was_plugged() {
    let branch = |k: usize| fork(INTERVAL_MM * k as f64, N_PLANES)[1];
    let open = |z_mm: f64| {
        let circles = fork(z_mm, N_PLANES);
        if (19.0..25.0).contains(&z_mm) {
            region_of(&vec![circles[0]], 0.0)
        } else {
            region_of(&circles, 0.0)
        }
    };
    assert!(branch(7).1 > 1.0);
    let expect = |case: &Forked, stage: &str| {
        let report = report(case);
        let found = report.findings.iter().find(|f| f.kind == Kind::Plugged && f.place.planes.is_some());
        let found = found.unwrap_or_else(|| panic!("{stage}: {}", told(&report)));
        assert_eq!((found.stage, found.place.planes), (stage, Some([7, 8])), "{}", told(&report));
        assert_eq!(found.place.branch.as_deref(), Some("branch 3"));
        assert!(report.findings.iter().all(|f| f.stage == stage), "{}", told(&report));
    };
    let mut solid = case();
    solid.solid.lumen = Box::new(open);
    plug_layers(&mut solid, open);
    plug_beads(&mut solid, true);
    expect(&solid, "reconstruction");
    let mut layers = case();
    plug_layers(&mut layers, open);
    plug_beads(&mut layers, true);
    expect(&layers, "slicing");
    let mut planned = case();
    plug_beads(&mut planned, true);
    expect(&planned, "toolpath");
    let mut printed = case();
    plug_beads(&mut printed, false);
    expect(&printed, "deposition");
}

fn plug_layers(case: &mut Forked, open: impl Fn(f64) -> Region) {
    for (layer, paths) in case.layers.iter_mut().zip(&mut case.paths.layers) {
        layer.lumen = open(layer.slot.z_mid_mm);
        let on_bed = |p: &Point2| Point2::new(p.x + 100.0, p.y + 90.0);
        let contour = |c: &Contour| Contour::new(c.points.iter().map(on_bed).collect());
        paths.lumen = Region::new(layer.lumen.contours.iter().map(contour).collect());
    }
}

/// Fills branch 3 between 19 and 25 mm with beads, in the plan or in the record alone.
fn plug_beads(case: &mut Forked, in_plan: bool) {
    let mut filled = case.paths.clone();
    for layer in &mut filled.layers {
        let z_mm = layer.slot.z_mid_mm;
        if !(19.0..25.0).contains(&z_mm) {
            continue;
        }
        let (centre, radius_mm) = fork(z_mm, N_PLANES)[1];
        for i in -5..=5 {
            let mut line = layer.beads[0].clone();
            let y = BEAD_MM * f64::from(i);
            let half = (radius_mm * radius_mm - y * y).max(0.0).sqrt();
            let at = |x: f64| Point2::new(100.0 + centre.x + x, 90.0 + centre.y + y);
            line.kind = crate::toolpath::BeadKind::SolidInfill;
            line.points.truncate(2);
            (line.points[0].at, line.points[1].at) = (at(-half), at(half + 1e-3));
            layer.beads.push(line);
        }
    }
    case.record = print(&filled);
    if in_plan {
        case.paths = filled;
    }
}

#[test]
fn a_boundary_moved_on_five_planes_is_an_error_of_segmentation() {
    for by_mm in [0.3, -0.3] {
        let mut case = case();
        for k in 2..7 {
            let circles = fork(INTERVAL_MM * k as f64, N_PLANES);
            case.sections.planes[k].contours =
                circles.iter().map(|(c, r)| Contour::circle(*c, r + by_mm, 128)).collect();
        }
        let found = only(&report(&case));
        assert_eq!(
            (found.stage, found.kind, found.place.planes),
            ("segmentation", Kind::BoundaryMoved, Some([2, 6]))
        );
        is_near(&found, by_mm);
    }
    let mut case = case();
    for k in 6..9 {
        case.sections.planes[k].contours[0].points.iter_mut().for_each(|p| p.x += 0.3);
    }
    let found = only(&report(&case));
    assert_eq!(
        (found.stage, found.kind, found.place.planes),
        ("segmentation", Kind::OutlineShifted, Some([6, 8]))
    );
    assert_eq!(found.place.branch.as_deref(), Some("branch 2"));
    is_near(&found, 0.3);
}

#[test]
fn a_scaled_solid_is_an_error_of_reconstruction() {
    for about in [Point2::origin(), Point2::new(-60.0, 40.0)] {
        let mut case = case();
        let scaled = move |region: Region| {
            let point = |p: &Point2| about + (p - about) * 1.01;
            Region::new(
                region.contours.iter().map(|c| Contour::new(c.points.iter().map(point).collect())).collect(),
            )
        };
        case.solid.lumen = Box::new(move |z_mm| scaled(region_of(&fork(z_mm, N_PLANES), 0.0)));
        let report = report(&case);
        let found = report
            .findings
            .iter()
            .find(|f| f.kind == Kind::Scaled)
            .unwrap_or_else(|| panic!("{}", told(&report)));
        assert_eq!(
            (found.stage, found.place.planes),
            ("reconstruction", Some([0, N_PLANES - 1])),
            "{}",
            told(&report)
        );
        is_near(found, 1.0);
        assert!(report.findings.iter().all(|f| f.stage == "reconstruction"), "{}", told(&report));
    }
}

#[test]
fn a_solid_of_wrong_heights_is_an_error_of_reconstruction() {
    // Sections and ends: the ends tell it more sharply.
    let mut high = case();
    let [low_mm, high_mm] = high.solid.z_mm;
    high.solid.z_mm = [low_mm, low_mm + 1.01 * (high_mm - low_mm)];
    high.solid.lumen = Box::new(move |z_mm| region_of(&fork(low_mm + (z_mm - low_mm) / 1.01, N_PLANES), 0.0));
    let found = only(&report(&high));
    assert_eq!((found.stage, found.kind), ("reconstruction", Kind::Stretched), "{found:?}");
    is_near(&found, 1.0);
    assert!(found.text.contains("heights of the solid") && found.text.contains("+1.00 %"), "{found:?}");

    // Ends alone: an upright tube looks the same at any height.
    let mut upright = case();
    upright
        .sections
        .planes
        .iter_mut()
        .for_each(|p| p.contours = vec![Contour::circle(Point2::origin(), RADIUS_MM, 128)]);
    upright.solid.lumen = Box::new(|_| region_of(&vec![(Point2::origin(), RADIUS_MM)], 0.0));
    upright.solid.z_mm = [low_mm, low_mm + 0.99 * (high_mm - low_mm)];
    let report_of_upright = report(&upright);
    let found = report_of_upright.findings.iter().find(|f| f.kind == Kind::Stretched);
    is_near(found.unwrap_or_else(|| panic!("{}", told(&report_of_upright))), -1.0);

    // Sections alone: the ends are cut where they are meant to be.
    for (part, about_mm) in [(1.06, 13.5), (0.94, 0.0)] {
        let mut sections = case();
        sections.solid.lumen =
            Box::new(move |z_mm| region_of(&fork(about_mm + (z_mm - about_mm) / part, N_PLANES), 0.0));
        let report = report(&sections);
        let found = report.findings.iter().find(|f| f.kind == Kind::Stretched);
        let found = found.unwrap_or_else(|| panic!("{}", told(&report)));
        assert_eq!(found.stage, "reconstruction");
        is_near(found, 100.0 * (part - 1.0));
    }
}

#[test]
fn planes_in_a_wrong_order_are_found_in_contours_and_in_images() {
    let mut contours = case();
    let planes = &mut contours.sections.planes;
    let (a, b) = (planes[1].contours.clone(), planes[3].contours.clone());
    (planes[1].contours, planes[3].contours) = (b, a);
    let report_of_contours = report(&contours);
    let order: Vec<&Finding> =
        report_of_contours.findings.iter().filter(|f| f.kind == Kind::WrongPlaneOrder).collect();
    assert!(
        order.iter().any(|f| f.stage == "segmentation" && f.text.contains("planes 1 and 3 are exchanged")),
        "{}",
        told(&report_of_contours)
    );

    // So little apart that the image still shows edges along the wrong contours.
    let mut near = case();
    let planes = &mut near.sections.planes;
    let (a, b) = (planes[2].contours.clone(), planes[3].contours.clone());
    (planes[2].contours, planes[3].contours) = (b, a);
    let found = only(&report(&near));
    assert_eq!(
        (found.stage, found.kind, found.place.planes),
        ("segmentation", Kind::WrongPlaneOrder, Some([2, 3]))
    );

    let mut images = case();
    images.volume.hu = reordered(&images.volume, |k| match k {
        1 => 3,
        3 => 1,
        k => k,
    });
    let found = only(&report(&images));
    assert_eq!(
        (found.stage, found.kind, found.place.planes),
        ("segmentation", Kind::WrongPlaneOrder, Some([1, 3]))
    );

    let mut reversed = case();
    reversed.volume.hu = reordered(&reversed.volume, |k| N_PLANES - 1 - k);
    let report_of_reversed = report(&reversed);
    let found = report_of_reversed.findings.iter().find(|f| f.kind == Kind::WrongPlaneOrder);
    assert!(found.is_some_and(|f| f.text.contains("reverse")), "{}", told(&report_of_reversed));
}

fn reordered(volume: &Volume, from: impl Fn(usize) -> usize) -> Voxels {
    let n = volume.dims[0] * volume.dims[1];
    let hu: Vec<f32> = (0..volume.dims[2]).flat_map(|k| volume.plane(from(k)).into_owned()).collect();
    Voxels::new(&hu, n)
}

#[test]
fn planes_exchanged_before_all_are_found_by_the_course_of_the_vessel() {
    let regions: Vec<Region> = (0..N_PLANES)
        .map(|k| match k {
            4 => 6,
            6 => 4,
            k => k,
        })
        .map(|k| {
            Region::new(vec![Contour::circle(
                Point2::new(0.9 * k as f64, 0.4 * (k * k) as f64 / 10.0),
                RADIUS_MM,
                90,
            )])
        })
        .collect();
    let z_mm: Vec<f64> = (0..N_PLANES).map(|k| INTERVAL_MM * k as f64).collect();
    let broken = super::broken_course(&regions, &z_mm, None).unwrap();
    let found = broken.finding;
    assert_eq!((found.stage, found.kind, found.place.planes), ("image", Kind::WrongPlaneOrder, Some([4, 6])));
    assert!(broken.is_sure && found.beyond_gate);
    // An image whose planes are most alike as they are contradicts it; one that hardly tells leaves it open.
    let follow = |a: usize, b: usize| a.abs_diff(b) as f64;
    assert_eq!(super::broken_course(&regions, &z_mm, Some(&follow)), None);
    let exchanged = |k: usize| if k == 4 || k == 6 { 10 - k } else { k };
    let exchange = |a: usize, b: usize| exchanged(a).abs_diff(exchanged(b)) as f64;
    assert!(super::broken_course(&regions, &z_mm, Some(&exchange)).unwrap().is_sure);
    let noisy = |a: usize, b: usize| 100.0 + exchange(a, b);
    assert!(!super::broken_course(&regions, &z_mm, Some(&noisy)).unwrap().is_sure);
}

#[test]
fn planes_of_the_ct_that_were_exchanged_before_the_segmentation_are_told_by_the_image() {
    let mut case = case();
    let exchanged = |k: usize| if k == 6 || k == 8 { 14 - k } else { k };
    case.volume.hu = reordered(&case.volume, exchanged);
    let planes = &case.sections.planes;
    let regions: Vec<Region> =
        (0..N_PLANES).map(|k| Region::new(planes[exchanged(k)].contours.clone())).collect();
    let volume_planes: Vec<_> = (0..N_PLANES).map(Some).collect();
    let unlike = |a: usize, b: usize| super::unlike(&case.volume, &volume_planes, &regions, [a, b]);
    let z_mm = case.sections.plane_z_mm();
    let broken = super::broken_course(&regions, &z_mm, Some(&unlike)).unwrap();
    assert!(broken.is_sure && broken.finding.place.planes == Some([6, 8]), "{broken:?}");
}

#[test]
fn a_dent_and_a_narrow_contour_are_errors_of_the_segmentation() {
    let mut dented = case();
    let (centre, radius_mm) = fork(INTERVAL_MM * 2.0, N_PLANES)[0];
    let contour = &mut dented.sections.planes[2].contours[0];
    for p in &mut contour.points {
        let along = (p.y - centre.y) / radius_mm;
        if p.x > centre.x && along.abs() < 0.5 {
            p.x -= 0.9 * (1.0 - (along / 0.5).powi(2));
        }
    }
    let report_of_dented = report(&dented);
    let found = only(&report_of_dented);
    assert_eq!((found.stage, found.kind, found.place.planes), ("segmentation", Kind::PartOff, Some([2, 2])));
    is_near(&found, -0.9);
    assert!(found.beyond_gate && !report_of_dented.verdict.passed);

    // A slit across takes a quarter of the lumen and leaves most of the outline where it is.
    let mut narrow = case();
    narrow.sections.planes[1].contours = region_of(&fork(INTERVAL_MM, N_PLANES), 0.0)
        .difference(&Region::new(vec![Contour::new(
            [(0.9, -5.0), (9.0, -5.0), (9.0, 5.0), (0.9, 5.0)].map(|(x, y)| Point2::new(x, y)).to_vec(),
        )]))
        .contours;
    let report = report(&narrow);
    let kinds: Vec<Kind> = report
        .findings
        .iter()
        .filter(|f| f.stage == "segmentation" && f.beyond_gate)
        .map(|f| f.kind)
        .collect();
    assert!(kinds.contains(&Kind::PartOff) || kinds.contains(&Kind::CalibreOff), "{}", told(&report));
    assert!(!report.verdict.passed);
}

#[test]
fn a_mirrored_image_is_found() {
    let mut case = case();
    let volume = &case.volume;
    let [n_cols, n_rows, _] = volume.dims;
    let hu: Vec<f32> = (0..N_PLANES)
        .flat_map(|k| {
            let plane = volume.plane(k).into_owned();
            (0..n_rows * n_cols).map(move |v| plane[v / n_cols * n_cols + (n_cols - 1 - v % n_cols)])
        })
        .collect();
    case.volume.hu = Voxels::new(&hu, n_cols * n_rows);
    let report = report(&case);
    let found = only(&report);
    assert_eq!((found.stage, found.kind), ("segmentation", Kind::Mirrored), "{}", told(&report));
    assert!(found.text.contains("in x"));
}

#[test]
fn a_mirrored_solid_is_found() {
    let mut case = case();
    case.solid.lumen = Box::new(|z_mm| {
        let circles = fork(z_mm, N_PLANES);
        region_of(&circles.iter().map(|(c, r)| (Point2::new(c.x, -c.y), *r)).collect(), 0.0)
    });
    let report = report(&case);
    let found = report.findings.iter().find(|f| f.kind == Kind::Mirrored);
    assert!(found.is_some_and(|f| f.stage == "reconstruction"), "{}", told(&report));
}

#[test]
fn lines_missing_on_one_side_are_found() {
    let mut case = case();
    let circles = |layer: usize| fork(LAYER_MM * (layer as f64 - 7.0), N_PLANES);
    without(&mut case, |layer, s| {
        let at = Point2::new(s.from.x - 100.0, s.from.y - 90.0);
        let (centre, radius_mm) = circles(layer)[0];
        (30..36).contains(&layer) && at.x > centre.x && (at - centre).norm() > radius_mm + 2.0 * BEAD_MM
    });
    let found = only(&report(&case));
    assert_eq!(
        (found.stage, found.kind, found.place.layers),
        ("deposition", Kind::MissingBeads, Some([30, 35]))
    );
}

#[test]
fn a_single_plane_beside_its_place_is_found() {
    let mut case = case();
    case.sections.planes[5].contours.iter_mut().flat_map(|c| &mut c.points).for_each(|p| p.y -= 0.4);
    let found = only(&report(&case));
    assert_eq!(
        (found.stage, found.kind, found.place.planes),
        ("segmentation", Kind::OutlineShifted, Some([5, 5]))
    );
    is_near(&found, 0.4);
}

#[test]
fn what_holds_for_most_planes_is_told_of_these_alone() {
    let mut shifted = case();
    for plane in &mut shifted.sections.planes[2..] {
        plane.contours.iter_mut().flat_map(|c| &mut c.points).for_each(|p| p.x += 0.3);
    }
    let found = only(&report(&shifted));
    assert_eq!((found.kind, found.place.planes), (Kind::OutlineShifted, Some([2, 9])));
    is_near(&found, 0.3);
}

#[test]
fn a_twisted_and_a_shrunken_solid_are_errors_of_reconstruction() {
    let mut twisted = case();
    twisted.solid.lumen = Box::new(|z_mm| {
        let turn = nalgebra::Rotation2::new(0.003 * z_mm);
        region_of(&fork(z_mm, N_PLANES).into_iter().map(|(c, r)| (turn * c, r)).collect(), 0.0)
    });
    let report_of_twisted = report(&twisted);
    let first = report_of_twisted.findings.first().unwrap_or_else(|| panic!("nothing found"));
    assert_eq!(first.stage, "reconstruction", "{}", told(&report_of_twisted));
    assert!(!report_of_twisted.verdict.passed);

    // Smoothing that draws narrow branches in.
    let mut shrunken = case();
    shrunken.solid.lumen = Box::new(|z_mm| {
        let circles = fork(z_mm, N_PLANES).into_iter();
        region_of(&circles.map(|(c, r)| (c, if r < 2.0 { r - 0.08 } else { r })).collect(), 0.0)
    });
    let found = only(&report(&shrunken));
    assert_eq!(
        (found.stage, found.kind, found.place.planes),
        ("reconstruction", Kind::BoundaryMoved, Some([5, 9]))
    );
    is_near(&found, -0.08);
}

#[test]
fn an_island_in_the_lumen_that_is_lost_is_found_where_it_was_lost() {
    let mut case = case();
    for k in 1..4 {
        let (centre, _) = fork(INTERVAL_MM * k as f64, N_PLANES)[0];
        case.sections.planes[k].contours.push(Contour::circle(centre, 0.8, 64).reversed());
    }
    let report = report(&case);
    let found: Vec<&Finding> = report.findings.iter().filter(|f| f.kind == Kind::IslandLost).collect();
    assert_eq!(found.len(), 1, "{}", told(&report));
    assert_eq!((found[0].stage, found[0].place.planes), ("reconstruction", Some([1, 3])));
    is_near(found[0], std::f64::consts::PI * 0.64);
}

#[test]
fn what_the_file_of_the_job_has_otherwise_is_not_the_printers() {
    let mut case = case();
    spoil(&mut case, 100..N_LAYERS, |_, s| moved(s, Vector2::new(0.4, 0.0)));
    let file = case.record.clone();
    spoil(&mut case, 50..60, |_, s| {
        s.volume_mm3 *= 0.8;
        s.width_mm *= 0.8;
    });
    let report = build(&Inputs { job_beads: Some(&file), ..inputs(&case) }, &Task::quiet()).unwrap();
    let found: Vec<_> = report.findings.iter().map(|f| (f.stage, f.kind, f.place.layers.unwrap())).collect();
    assert_eq!(
        found,
        [("toolpath", Kind::LayerShift, [100, 149]), ("deposition", Kind::UnderExtrusion, [50, 59])],
        "{}",
        told(&report)
    );
    is_near(&report.findings[0], 0.4);
    assert!(report.findings[0].text.contains("the job's file is not what was sliced"));
}
