//! The operator's corrections.

use super::*;
use crate::segment::corrections::{Block, Corrections, Drawn, PlaneWindow};

/// Two discs of 300 HU joined by a bridge in plane 2 that is as wide as they are.
fn joined() -> Volume {
    Scene { n: [96, 56, 5], ..Scene::default() }.volume(|x, y, k| {
        let disc = |cx: f64| (x - cx).hypot(y - 7.0) < 2.5;
        let bridge = k == 2 && (8.0..16.0).contains(&x) && (y - 7.0).abs() < 2.5;
        if disc(8.0) || disc(16.0) || bridge { 300.0 } else { 50.0 }
    })
}

fn corrected(corrections: Corrections) -> Params {
    Params { corrections, window_hu: Some([150.0, 500.0]), ..params([8.0, 7.0, 0.0]) }
}

fn reaches_other(found: &Segmentation) -> bool {
    found.mask.contains(64, 28, 0)
}

#[test]
fn boxes_half_spaces_and_planes_keep_the_region_out() {
    let volume = joined();
    assert!(reaches_other(&run(&volume, &corrected(Corrections::default())).unwrap()));
    let half_space =
        Block { point_mm: Some([12.0, 0.0, 0.0]), normal: Some([2.0, 0.0, 0.0]), ..Block::default() };
    // Corners in any order.
    let bar = Block { box_mm: Some([[13.0, 20.0, 2.5], [11.0, -5.0, 1.5]]), ..Block::default() };
    let planes = Block { z_mm: Some([2.0, 9.0]), ..Block::default() };
    for (block, n_planes) in [(half_space, 5), (bar, 5), (planes, 2)] {
        let found =
            run(&volume, &corrected(Corrections { block: vec![block], ..Default::default() })).unwrap();
        assert!(!reaches_other(&found), "{block:?}");
        assert_eq!(found.planes.len(), n_planes);
    }
}

#[test]
fn a_seed_that_a_correction_takes_away_is_told_which_one() {
    let volume = joined();
    let elsewhere = Block { z_mm: Some([4.0, 9.0]), ..Block::default() };
    let around = Block { box_mm: Some([[6.0, 5.0, -1.0], [10.0, 9.0, 1.0]]), ..Block::default() };
    let blocked = corrected(Corrections { block: vec![elsewhere, around], ..Default::default() });
    let text = error_text(&volume, &blocked);
    assert!(
        text.starts_with("seed (8.000, 7.000, 0.000) lies in what segment.block[2] keeps out: "),
        "{text}"
    );
    let beside = Drawn {
        z_mm: Some(0.0),
        points_mm: Some(vec![[14.0, 5.0], [18.0, 5.0], [18.0, 9.0], [14.0, 9.0]]),
        ..Drawn::default()
    };
    let drawn = corrected(Corrections { contour: vec![beside], ..Default::default() });
    let text = error_text(&volume, &drawn);
    assert!(text.contains("outside the contour drawn for its plane (segment.contour, z 0.000 mm)"), "{text}");
}

/// Codes and texts of what is told of corrections.
fn told(volume: &Volume, corrections: &str) -> Vec<(String, String)> {
    let corrections = toml::from_str(corrections).unwrap();
    let found = run(volume, &corrected(corrections)).unwrap();
    let of_corrections =
        |w: &&Warning| ["segment.block_outside", "segment.contour_off_plane"].contains(&&*w.code);
    found.warnings.iter().filter(of_corrections).map(|w| (w.code.clone(), w.text.clone())).collect()
}

#[test]
fn blocks_beside_the_image_are_told() {
    let mut volume = joined();
    let outside = [
        "box_mm = [[900, 900, 900], [901, 901, 901]]",
        // Between two rows, and between two planes.
        "box_mm = [[-5, 3.3, -9], [90, 3.4, 9]]",
        "box_mm = [[-5, -5, 1.1], [90, 90, 1.9]]",
        "z_mm = [5, 9]",
        "z_mm = [1.2, 1.8]",
        "point_mm = [0, 0, 4]\nnormal = [0, 0, 1]",
    ];
    let inside = [
        "box_mm = [[23.6, 13.8, 5], [23.9, 13.7, 3.5]]",
        "z_mm = [4, 4]",
        "point_mm = [0, 13.7, 0]\nnormal = [0, 1, 0]",
    ];
    let blocks: String = outside.iter().chain(&inside).map(|b| format!("[[block]]\n{b}\n")).collect();
    let found = told(&volume, &blocks);
    let named: Vec<bool> = (1..=9)
        .map(|n| {
            found.iter().any(|(_, text)| text.starts_with(&format!("segment.block[{n}] holds no voxel")))
        })
        .collect();
    assert_eq!(named, [true, true, true, true, true, true, false, false, false], "{found:?}");
    assert!(found.iter().all(|(code, _)| code == "segment.block_outside"));
    // Stack x is patient y, y is z, z is x: what lies beside the image there lies in it here.
    volume.patient_from_stack =
        RigidTransform::from_axes(Point3::origin(), Vector3::y(), Vector3::z(), Vector3::x());
    let block = "[[block]]\nbox_mm = [[3.5, 23.6, 13.8], [5, 23.9, 13.7]]\n";
    let params = Params {
        seeds_patient_mm: vec![Point3::new(0.0, 8.0, 7.0)],
        ..corrected(toml::from_str(block).unwrap())
    };
    assert!(run(&volume, &params).unwrap().warnings.iter().all(|w| w.code != "segment.block_outside"));
}

#[test]
fn a_contour_between_two_planes_is_told_with_the_plane_it_was_taken_for() {
    let at = |z: f64| {
        let points = "[[6, 5], [10, 5], [10, 9], [6, 9]]";
        told(&joined(), &format!("[[contour]]\nz_mm = {z}\npoints_mm = {points}\n"))
    };
    assert_eq!(at(1.0), []);
    assert_eq!(at(1.01), []);
    let text = "segment.contour[1] lies 0.400 mm off the nearest plane, z 1.000 mm, whose contour it was taken for: give z_mm at that height to say so, or draw it for the plane that is meant";
    assert_eq!(at(1.4), [("segment.contour_off_plane".to_owned(), text.to_owned())]);
}

#[test]
fn blocks_are_patient_coordinates() {
    let mut volume = joined();
    volume.patient_from_stack =
        RigidTransform::from_axes(Point3::new(100.0, 0.0, 0.0), Vector3::y(), Vector3::z(), Vector3::x());
    // Stack x is patient y.
    let block = Block { point_mm: Some([0.0, 12.0, 0.0]), normal: Some([0.0, 1.0, 0.0]), ..Block::default() };
    let corrections = Corrections { block: vec![block], ..Default::default() };
    let found = run(
        &volume,
        &Params { seeds_patient_mm: vec![Point3::new(100.0, 8.0, 7.0)], ..corrected(corrections) },
    );
    assert!(!reaches_other(&found.unwrap()));
}

#[test]
fn a_plane_takes_the_last_window_that_names_it() {
    // The contrast is half in plane 2.
    let volume = Scene { n: [64, 56, 5], ..Scene::default() }.volume(|x, y, k| {
        let lumen = if k == 2 { 170.0 } else { 300.0 };
        if (x - 8.0).hypot(y - 7.0) < 3.0 { lumen } else { 50.0 }
    });
    let windowed = |window: Vec<PlaneWindow>| {
        let corrections = Corrections { window, ..Default::default() };
        run(&volume, &Params { window_hu: Some([175.0, 500.0]), ..corrected(corrections) }).unwrap()
    };
    assert_eq!(windowed(vec![]).planes, 0..2);
    let all = PlaneWindow { z_mm: [0.0, 4.0], window_hu: [200.0, 500.0] };
    let found = windowed(vec![all, PlaneWindow { z_mm: [2.0, 2.0], window_hu: [110.0, 500.0] }]);
    assert_eq!((found.planes.clone(), found.edge_hu_at(2), found.edge_hu_at(3)), (0..5, 110.0, 200.0));
}

#[test]
fn a_drawn_contour_stands_for_the_planes_own_and_conducts_the_growth() {
    // Plane 2 shows nothing.
    let volume = Scene { n: [64, 56, 5], ..Scene::default() }
        .volume(|x, y, k| if (x - 8.0).hypot(y - 7.0) < 3.0 && k != 2 { 300.0 } else { 50.0 });
    let square =
        |h: f64| vec![[8.0 - h, 7.0 - h], [8.0 + h, 7.0 - h], [8.0 + h, 7.0 + h], [8.0 - h, 7.0 + h]];
    let mut hole = square(0.8);
    hole.reverse();
    let drawn =
        |points: Vec<[f64; 2]>| Drawn { z_mm: Some(2.0), points_mm: Some(points), ..Drawn::default() };
    let corrections = Corrections { contour: vec![drawn(square(2.0)), drawn(hole)], ..Default::default() };
    let found = run(&volume, &corrected(corrections)).unwrap();
    assert_eq!(found.planes, 0..5);
    assert!(
        found.mask.contains(26, 22, 2) && !found.mask.contains(32, 28, 2) && !found.mask.contains(32, 39, 2)
    );
    let areas: Vec<f64> = found.drawn[&2].iter().map(Contour::signed_area_mm2).collect();
    assert!((areas[0] - 16.0).abs() < 1e-9 && (areas[1] + 2.56).abs() < 1e-9, "{areas:?}");
    assert!(found.drawn[&2].iter().all(|c| c.len() >= 128));
    let lps = square(2.0).iter().map(|&[x, y]| [x, y, 2.1]).collect();
    let lps = Corrections {
        contour: vec![Drawn { points_lps_mm: Some(lps), ..Drawn::default() }],
        ..Default::default()
    };
    let again = run(&volume, &corrected(lps)).unwrap();
    assert_eq!(again.drawn[&2], found.drawn[&2][..1]);
}

#[test]
fn each_bad_correction_is_named_with_what_was_found_and_expected() {
    let volume = joined();
    for (text, message) in [
        (
            "[[block]]\n",
            "segment.block[1]: found none of them, expected exactly one of box_mm, z_mm, or point_mm with normal",
        ),
        (
            "[[block]]\nz_mm = [1, 2]\n[[block]]\npoint_mm = [1, 2, 3]\n",
            "segment.block[2]: found point_mm without normal, expected exactly one of box_mm, z_mm, or point_mm with normal",
        ),
        (
            "[[block]]\nz_mm = [1, 2]\nbox_mm = [[0, 0, 0], [1, 1, 1]]\n",
            "segment.block[1]: found several of them, expected exactly one of box_mm, z_mm, or point_mm with normal",
        ),
        (
            "[[block]]\nz_mm = [3, 2]\n",
            "segment.block[1].z_mm: found 3,2, expected two finite heights in mm, the first not above the second",
        ),
        (
            "[[block]]\npoint_mm = [1, 2, 3]\nnormal = [0, 0, 0]\n",
            "segment.block[1].normal: found [0.0, 0.0, 0.0], expected a direction: three finite numbers, not all 0",
        ),
        (
            "[[window]]\nz_mm = [1, 2]\nwindow_hu = [5, nan]\n",
            "segment.window[1].window_hu: found 5,NaN, expected two finite numbers in HU, the first less than the second",
        ),
        (
            "[[window]]\nz_mm = [50, 60]\nwindow_hu = [5, 6]\n",
            "segment.window[1].z_mm: found 50,60, expected heights with a plane between them; the planes reach from 0.000 to 4.000 mm",
        ),
        (
            "[[contour]]\nz_mm = 1\n",
            "segment.contour[1]: found no points, expected z_mm with points_mm (stack), or points_lps_mm alone",
        ),
        (
            "[[contour]]\nz_mm = 1\npoints_mm = [[1, 1], [2, 2]]\n",
            "segment.contour[1].points_mm: found 2 points, expected at least 3 corners",
        ),
        (
            "[[contour]]\nz_mm = 9\npoints_mm = [[4, 4], [9, 4], [9, 9]]\n",
            "segment.contour[1]: found a corner at z 9.000 mm, expected all corners within half an interval of one plane; the planes reach from 0.000 to 4.000 mm",
        ),
        (
            "[[contour]]\nz_mm = 1\npoints_mm = [[4, 4], [90, 4], [9, 9]]\n",
            "segment.contour[1]: found a corner at x 90.000, y 4.000 mm, expected corners within x 0.250 to 23.500, y 0.250 to 13.500 mm (stack)",
        ),
        (
            "[[contour]]\nz_mm = 1\npoints_mm = [[4, 4], [9, 9], [9, 4], [4, 9]]\n",
            "segment.contour[1]: found a polygon that crosses itself or has no area, expected a simple polygon",
        ),
        (
            "[[contour]]\nz_mm = 1\npoints_mm = [[4, 4], [9, 9], [9, 4]]\n",
            "segment.contour[1]: found a hole in nothing, expected a hole (clockwise seen from +z) inside an outer contour: reverse the points for an outer one",
        ),
        (
            "[[contour]]\nz_mm = 1\npoints_mm = [[4, 4], [9, 4], [9, 9]]\n[[contour]]\nz_mm = 1\npoints_mm = [[5, 4], [9, 5], [5, 9]]\n",
            "segment.contour[1]: found polygons that cross or overlap, expected polygons of a plane that neither cross nor overlap, holes clockwise inside outer ones",
        ),
    ] {
        let corrections: Corrections = toml::from_str(text).unwrap();
        assert_eq!(error_text(&volume, &corrected(corrections)), message, "{text}");
    }
    assert!(
        toml::from_str::<Corrections>("[[block]]\nboxmm = 1\n")
            .unwrap_err()
            .to_string()
            .contains("unknown field")
    );
}

/// A square of 2 mm around the axis of a tube at (8, 7).
fn square_at(z_mm: f64) -> String {
    format!("[[contour]]\nz_mm = {z_mm}\npoints_mm = [[7, 6], [9, 6], [9, 8], [7, 8]]\n")
}

/// Texts of one kind.
fn texts<'a>(found: &'a [Warning], code: &str) -> Vec<&'a str> {
    found.iter().filter(|w| w.code == code).map(|w| w.text.as_str()).collect()
}

#[test]
fn contours_and_windows_of_planes_that_are_not_used_are_told() {
    let text = format!("{}{}[[window]]\nz_mm = [3, 4]\nwindow_hu = [1, 2]\n", square_at(1.0), square_at(4.0));
    let params = Params { z_mm: Some([0.0, 2.0]), ..corrected(toml::from_str(&text).unwrap()) };
    let found = run(&joined(), &params).unwrap();
    assert_eq!(
        texts(&found.warnings, "segment.contour_unused"),
        [
            "segment.contour[2] stands in the plane at z 4.000 mm, only z 0.000 to 2.000 mm are used: widen or give --z-mm"
        ]
    );
    assert_eq!(
        texts(&found.warnings, "segment.window_unused"),
        [
            "segment.window[1] stands for z 3.000 to 4.000 mm, only z 0.000 to 2.000 mm are used: widen or give --z-mm"
        ]
    );
}

#[test]
fn the_vessel_goes_on_to_a_contour_that_is_drawn_where_it_fades() {
    let scene = Scene { n: [64, 56, 24], plane_mm: 2.0, noise_hu: 10.0, ..Scene::default() };
    let volume = scene
        .volume(|x, y, k| if (x - 8.0).hypot(y - 7.0) < 3.0 && (4..16).contains(&k) { 300.0 } else { 50.0 });
    let ends = |corrections: &str| {
        let params = Params {
            on_leak: OnLeak::Cut,
            corrections: toml::from_str(corrections).unwrap(),
            ..params([8.0, 7.0, 20.0])
        };
        let by_itself = find_unattended(&volume, &params, &Task::quiet()).unwrap().segmentation;
        let seeded = run(&volume, &params).unwrap();
        assert!(texts(&seeded.warnings, "segment.contour_unused").is_empty());
        assert!(texts(&by_itself.warnings, "segment.contour_unused").is_empty());
        [seeded, by_itself].map(|found| (found.planes.end, found.drawn.len()))
    };
    assert_eq!(ends(""), [(16, 0); 2]);
    // In the plane next to the last that shows the vessel, and far beyond what a candidate is followed in.
    assert_eq!(ends(&square_at(32.0)), [(17, 1); 2]);
    assert_eq!(ends(&square_at(46.0)), [(24, 1); 2]);
}

/// A tube around (8, 7) whose level is this in each plane, HU, in 50 HU.
fn tube(levels_hu: &'static [f64]) -> Volume {
    let scene = Scene { n: [64, 56, levels_hu.len()], plane_mm: 2.0, noise_hu: 5.0, ..Scene::default() };
    scene.volume(|x, y, k| if (x - 8.0).hypot(y - 7.0) < 3.0 { levels_hu[k] } else { 50.0 })
}

/// A contour nearly as large as the tube.
fn outline_at(z_mm: f64) -> String {
    format!("[[contour]]\nz_mm = {z_mm}\npoints_mm = [[5.8, 4.8], [10.2, 4.8], [10.2, 9.2], [5.8, 9.2]]\n")
}

/// The tube from a seed in its second plane, with these contours drawn, in windows that are found.
fn drawn_at(volume: &Volume, corrections: &str) -> Segmentation {
    let corrections = toml::from_str(corrections).unwrap();
    run(volume, &Params { corrections, ..params([8.0, 7.0, 2.0]) }).unwrap()
}

/// The planes that hold a part of the lumen.
fn filled(found: &Segmentation) -> Vec<usize> {
    found.planes.clone().filter(|&k| found.mask.n_voxels_of(k) > 0).collect()
}

#[test]
fn the_planes_beside_a_drawn_contour_grow_from_it_at_the_level_that_it_shows() {
    const LEVELS: [f64; 14] =
        [300.0, 300.0, 300.0, 300.0, 300.0, 50.0, 50.0, 160.0, 160.0, 160.0, 160.0, 160.0, 160.0, 160.0];
    let volume = tube(&LEVELS);
    assert_eq!(filled(&drawn_at(&volume, "")), [0, 1, 2, 3, 4]);
    for z_mm in [14.0, 20.0, 26.0] {
        let found = drawn_at(&volume, &outline_at(z_mm));
        assert_eq!(filled(&found), [0, 1, 2, 3, 4, 7, 8, 9, 10, 11, 12, 13], "{z_mm}");
        assert!(texts(&found.warnings, "segment.contour_alone").is_empty());
        // Half-way between its own lumen and the wall.
        assert!((found.edge_hu_at(9) - 105.0).abs() < 8.0, "{}", found.edge_hu_at(9));
        assert!((found.edge_hu_at(2) - 175.0).abs() < 8.0, "{}", found.edge_hu_at(2));
    }
}

#[test]
fn contours_drawn_through_planes_that_show_nothing_lead_on_however_many_they_are() {
    const LEVELS: [f64; 14] =
        [300.0, 300.0, 300.0, 300.0, 50.0, 50.0, 50.0, 50.0, 290.0, 275.0, 260.0, 245.0, 230.0, 215.0];
    let drawn: String = [8.0, 10.0, 12.0, 14.0].map(outline_at).concat();
    let found = drawn_at(&tube(&LEVELS), &drawn);
    assert_eq!(filled(&found), (0..14).collect::<Vec<usize>>());
    assert!((found.edge_hu_at(12) - 140.0).abs() < 12.0, "{}", found.edge_hu_at(12));
    // What is drawn may show anything: the vessel beyond is of no other level than the vessel.
    let narrow: String = [8.0, 10.0, 12.0, 14.0].map(square_at).concat();
    assert_eq!(filled(&drawn_at(&tube(&LEVELS), &narrow)), (0..14).collect::<Vec<usize>>());
}

#[test]
fn a_drawn_contour_that_nothing_grows_from_is_told() {
    const LEVELS: [f64; 12] = [300.0, 300.0, 300.0, 300.0, 50.0, 50.0, 50.0, 50.0, 50.0, 50.0, 50.0, 50.0];
    let volume = tube(&LEVELS);
    let found = drawn_at(&volume, &square_at(14.0));
    let told = texts(&found.warnings, "segment.contour_alone");
    assert!(
        told.len() == 1
            && told[0].starts_with("the contour drawn at z 14.000 mm (segment.contour) stands alone: ")
            && told[0].ends_with("draw theirs, too, or give their window (segment.window)"),
        "{told:?}"
    );
    // Two of them beside each other are as alone; one that the vessel reaches is not.
    let pair = drawn_at(&volume, &[14.0, 16.0].map(square_at).concat());
    let told = texts(&pair.warnings, "segment.contour_alone");
    assert!(
        told.len() == 1 && told[0].starts_with("the contours drawn from z 14.000 to 16.000 mm"),
        "{told:?}"
    );
    assert!(texts(&drawn_at(&volume, &square_at(8.0)).warnings, "segment.contour_alone").is_empty());
}

#[test]
fn what_grows_from_a_drawn_contour_is_looked_at_for_leaks() {
    // The vessel is lost in plane 5 and ends in bone in plane 10.
    let volume =
        Scene { n: [96, 80, 14], plane_mm: 2.0, noise_hu: 5.0, ..Scene::default() }.volume(|x, y, k| {
            let is_vessel = (x - 8.0).hypot(y - 7.0) < 2.0 && k != 5;
            let is_bone = k >= 10 && (x - 12.0).hypot(y - 10.0) < 7.0;
            if is_vessel || is_bone { 300.0 } else { 50.0 }
        });
    let corrections = toml::from_str(&square_at(14.0)).unwrap();
    let told = error_text(&volume, &Params { corrections, ..params([8.0, 7.0, 2.0]) });
    assert!(told.contains("something with"), "{told}");
}
