use super::*;
use crate::ct::Volume;
use crate::geom::distance::SegmentIndex;
use crate::geom::{Point2, Point3};
use crate::progress::{CancelToken, Task};
use crate::segment::testing::Scene;
use crate::segment::{self, Polarity, Segmentation};

const CENTRE: [f64; 2] = [8.03, 7.11];

fn segmented(volume: &Volume, seed: [f64; 3], window_hu: Option<[f64; 2]>) -> Segmentation {
    let params =
        segment::Params { seeds_patient_mm: vec![Point3::from(seed)], window_hu, ..Default::default() };
    segment::segment(volume, &params, &Task::quiet()).unwrap()
}

fn extracted(volume: &Volume, seed: [f64; 3]) -> Extracted {
    extract(volume, &segmented(volume, seed, None), &Params::default(), &Task::quiet()).unwrap()
}

fn from_centre(x: f64, y: f64) -> f64 {
    (x - CENTRE[0]).hypot(y - CENTRE[1])
}

fn codes(extracted: &Extracted) -> Vec<&str> {
    extracted.warnings.iter().map(|w| w.code.as_str()).collect()
}

fn counts(extracted: &Extracted) -> Vec<usize> {
    extracted.stack.planes.iter().map(|p| p.contours.len()).collect()
}

/// Signed distances of the vertices from a circle: mean, and largest absolute.
fn errors(contour: &Contour, radius_mm: f64) -> (f64, f64) {
    let error = |p: &Point2| from_centre(p.x, p.y) - radius_mm;
    let n = contour.len() as f64;
    let mean = contour.points.iter().map(error).sum::<f64>() / n;
    (mean, contour.points.iter().map(|p| error(p).abs()).fold(0.0, f64::max))
}

fn check_form(contour: &Contour) {
    let first = contour.points[0];
    assert!(contour.len() >= 128);
    assert!(contour.points.iter().all(|p| p.x >= first.x), "the first point is the leftmost");
    let spacing = contour.perimeter_mm() / contour.len() as f64;
    assert!(contour.edges().all(|(a, b)| ((b - a).norm() / spacing - 1.0).abs() < 0.02), "evenly spaced");
}

#[test]
fn disks_of_any_size_and_polarity_have_their_true_radius() {
    for (lumen, wall) in [(300.0, 50.0), (-950.0, 40.0)] {
        for radius in [1.2, 2.0, 3.0, 4.5] {
            let volume =
                Scene::default().volume(|x, y, _| if from_centre(x, y) < radius { lumen } else { wall });
            let extracted = extracted(&volume, [CENTRE[0], CENTRE[1], 1.0]);
            assert_eq!(counts(&extracted), [1, 1, 1, 1]);
            let contour = &extracted.stack.planes[1].contours[0];
            check_form(contour);
            assert!(contour.is_ccw());
            let (mean, worst) = errors(contour, radius);
            assert!(mean.abs() < 0.004 && worst < 0.012, "{lumen} {radius}: {mean:.4} {worst:.4}");
        }
    }
}

#[test]
fn pixels_need_not_be_square() {
    let scene = Scene { pixel_mm: [0.2, 0.35], n: [80, 44, 3], ..Scene::default() };
    let volume = scene.volume(|x, y, _| if from_centre(x, y) < 3.0 { 300.0 } else { 50.0 });
    let (mean, worst) = errors(&extracted(&volume, [8.0, 7.0, 1.0]).stack.planes[0].contours[0], 3.0);
    assert!(mean.abs() < 0.006 && worst < 0.02, "{mean:.4} {worst:.4}");
}

#[test]
fn a_wall_as_thin_as_the_blur_does_not_move_the_boundary() {
    let volume = Scene::default().volume(|x, y, _| match from_centre(x, y) {
        r if r < 3.0 => 300.0,
        r if r < 4.0 => 60.0,
        _ => -60.0,
    });
    let (mean, worst) = errors(&extracted(&volume, [8.0, 7.0, 1.0]).stack.planes[0].contours[0], 3.0);
    assert!(mean.abs() < 0.01 && worst < 0.02, "{mean:.4} {worst:.4}");
}

#[test]
fn noise_of_a_tenth_of_the_contrast_costs_little() {
    let scene = Scene { noise_hu: 25.0, n: [64, 56, 12], ..Scene::default() };
    let volume = scene.volume(|x, y, _| if from_centre(x, y) < 3.0 { 300.0 } else { 50.0 });
    let extracted = extracted(&volume, [8.0, 7.0, 1.0]);
    assert_eq!(counts(&extracted), [1; 12]);
    let all: Vec<(f64, f64)> = extracted.stack.planes.iter().map(|p| errors(&p.contours[0], 3.0)).collect();
    let bias = all.iter().map(|e| e.0).sum::<f64>() / 12.0;
    let worst = all.iter().map(|e| e.1).fold(0.0, f64::max);
    assert!(bias.abs() < 0.01 && worst < 0.12, "{bias:.4} {worst:.4}");
}

#[test]
fn an_ellipse_keeps_its_axes() {
    let inside = |x: f64, y: f64| ((x - CENTRE[0]) / 4.0).hypot((y - CENTRE[1]) / 2.5) < 1.0;
    let volume = Scene::default().volume(|x, y, _| if inside(x, y) { 300.0 } else { 50.0 });
    let contour = &extracted(&volume, [8.0, 7.0, 1.0]).stack.planes[2].contours[0];
    check_form(contour);
    let size = contour.bounds().unwrap().size();
    assert!((size.x - 8.0).abs() < 0.03 && (size.y - 5.0).abs() < 0.02, "{size}");
    assert!((contour.signed_area_mm2() / (std::f64::consts::PI * 10.0) - 1.0).abs() < 0.003);
}

#[test]
fn an_annulus_has_a_clockwise_hole() {
    let volume = Scene::default().volume(|x, y, _| match from_centre(x, y) {
        r if (1.5..4.5).contains(&r) => 300.0,
        _ => 50.0,
    });
    let extracted = extracted(&volume, [CENTRE[0] + 3.0, CENTRE[1], 1.0]);
    assert_eq!(counts(&extracted), [2; 4]);
    let [outer, hole] = extracted.stack.planes[0].contours.as_slice() else { panic!() };
    assert!(outer.is_ccw() && !hole.is_ccw());
    check_form(hole);
    assert!(errors(outer, 4.5).1 < 0.015, "{:?}", errors(outer, 4.5));
    assert!(errors(hole, 1.5).1 < 0.015, "{:?}", errors(hole, 1.5));
}

#[test]
fn a_given_window_is_the_boundary() {
    let volume = Scene::default().volume(|x, y, _| if from_centre(x, y) < 3.0 { 300.0 } else { 50.0 });
    let segmentation = segmented(&volume, [8.0, 7.0, 1.0], Some([237.5, 500.0]));
    let edge = extract(&volume, &segmentation, &Params::default(), &Task::quiet()).unwrap();
    // Three quarters of the way up a Gaussian edge: 0.674 standard deviations inward, and the blur's own shift.
    let (mean, _) = errors(&edge.stack.planes[0].contours[0], 3.0 - 0.674 * 0.3);
    assert!(mean.abs() < 0.03, "{mean}");
    let params = Params { boundary: Boundary::HalfMaximum, ..Params::default() };
    let half = extract(&volume, &segmentation, &params, &Task::quiet()).unwrap();
    let (mean, worst) = errors(&half.stack.planes[0].contours[0], 3.0);
    assert!(mean.abs() < 0.01 && worst < 0.02, "{mean} {worst}");
}

#[test]
fn a_neighbour_outside_the_mask_is_not_joined() {
    // A vessel of the same brightness, 0.7 mm away, and a bone beyond the window on the other side.
    let volume = Scene::default().volume(|x, y, _| match from_centre(x, y) {
        r if r < 2.5 => 300.0,
        _ if from_centre(x - 5.2, y) < 2.0 => 300.0,
        _ if from_centre(x + 5.5, y) < 1.5 => 1500.0,
        _ => 50.0,
    });
    let segmentation = segmented(&volume, [8.0, 7.0, 1.0], Some([175.0, 400.0]));
    let extracted = extract(&volume, &segmentation, &Params::default(), &Task::quiet()).unwrap();
    assert_eq!(counts(&extracted), [1; 4]);
    let size = extracted.stack.planes[0].contours[0].bounds().unwrap().size();
    assert!((size.x - 5.0).abs() < 0.15 && (size.y - 5.0).abs() < 0.1, "{size}");
}

#[test]
fn a_window_whose_edge_is_not_the_lumens_is_told() {
    let volume = Scene::default().volume(|x, y, _| if from_centre(x, y) < 3.0 { 300.0 } else { 50.0 });
    let at = |lo: f64| {
        let segmentation = segmented(&volume, [CENTRE[0], CENTRE[1], 1.0], Some([lo, 500.0]));
        extract(&volume, &segmentation, &Params::default(), &Task::quiet()).unwrap()
    };
    assert!(at(175.0).warnings.is_empty(), "{:?}", at(175.0).warnings);
    let wide = at(100.0);
    assert_eq!(codes(&wide), ["sections.window_edge"]);
    let (mean, _) = errors(&wide.stack.planes[1].contours[0], 3.0);
    let told = format!("about {mean:.1}");
    assert!(wide.warnings[0].text.contains(&told), "{mean}: {}", wide.warnings[0].text);
}

/// Disks of 2 mm at y = 7 with the given x in each plane, bridged where they overlap.
fn disks(planes: &[&[f64]]) -> Volume {
    let scene = Scene { n: [80, 56, planes.len()], ..Scene::default() };
    scene.volume(|x, y, k| {
        let inside = planes[k].iter().any(|c| (x - c).hypot(y - 7.0) < 2.0);
        if inside { 300.0 } else { 50.0 }
    })
}

#[test]
fn splits_and_merges_that_last_are_kept() {
    let (one, two): (&[f64], &[f64]) = (&[8.0, 10.5], &[7.3, 12.0]);
    let extracted = extracted(&disks(&[one, one, two, two, one]), [8.0, 7.0, 0.0]);
    assert_eq!(counts(&extracted), [1, 1, 2, 2, 1]);
    assert!(extracted.warnings.is_empty(), "{:?}", extracted.warnings);
    let [left, right] = extracted.stack.planes[2].contours.as_slice() else { panic!() };
    assert!(left.points[0].x < right.points[0].x);
}

#[test]
fn one_two_one_is_bridged() {
    let (one, two): (&[f64], &[f64]) = (&[8.0, 10.5], &[7.5, 12.0]);
    let extracted = extracted(&disks(&[one, one, two, one]), [8.0, 7.0, 0.0]);
    assert_eq!(counts(&extracted), [1; 4]);
    assert_eq!(codes(&extracted), ["sections.bridged"]);
    assert!(extracted.warnings[0].text.contains("z 2.000 mm"), "{}", extracted.warnings[0].text);
}

#[test]
fn two_one_two_is_split_at_the_neck() {
    let (one, two): (&[f64], &[f64]) = (&[7.6, 11.3], &[7.2, 12.0]);
    let extracted = extracted(&disks(&[two, two, one, two, two]), [7.2, 7.0, 0.0]);
    assert_eq!(counts(&extracted), [2; 5]);
    assert_eq!(codes(&extracted), ["sections.split"]);
}

#[test]
fn a_side_branch_of_one_plane_is_dropped_and_a_lasting_one_kept() {
    // The wide plane above is where the branch is connected.
    let (main, wide, branch): (&[f64], &[f64], &[f64]) = (&[7.0], &[7.0, 9.0, 11.0], &[7.0, 12.5]);
    let single = extracted(&disks(&[main, main, branch, wide, wide]), [7.0, 7.0, 0.0]);
    assert_eq!((counts(&single), codes(&single)), (vec![1; 5], vec!["sections.stub"]));
    let lasting = extracted(&disks(&[main, branch, branch, wide, wide]), [7.0, 7.0, 0.0]);
    assert_eq!((counts(&lasting), codes(&lasting)), (vec![1, 2, 2, 1, 1], vec![]));
}

#[test]
fn an_interrupted_vessel_keeps_its_parts_under_every_boundary() {
    let scene = Scene { n: [64, 56, 14], ..Scene::default() };
    let volume =
        scene.volume(|x, y, k| if from_centre(x, y) < 3.0 && !(5..9).contains(&k) { 300.0 } else { 50.0 });
    let seeds_patient_mm = [1.0, 11.0].map(|z| Point3::new(CENTRE[0], CENTRE[1], z)).to_vec();
    let params = segment::Params { seeds_patient_mm, ..Default::default() };
    let found = segment::segment(&volume, &params, &Task::quiet()).unwrap();
    for boundary in [Boundary::Model, Boundary::HalfMaximum, Boundary::Snake] {
        let params = Params { boundary, ..Params::default() };
        let extracted = extract(&volume, &found, &params, &Task::quiet()).unwrap();
        assert_eq!(counts(&extracted), [1, 1, 1, 1, 1, 0, 0, 0, 0, 1, 1, 1, 1, 1], "{boundary:?}");
        let worst = extracted.stack.planes.iter().flat_map(|p| &p.contours).map(|c| errors(c, 3.0).1);
        assert!(worst.fold(0.0, f64::max) < 0.1, "{boundary:?}");
    }
}

#[test]
fn fragments_are_dropped_and_told() {
    // A thread of 0.35 mm that leaves the vessel and comes back to the image plane 1 as a dot.
    let volume = Scene { blur_mm: 0.05, ..Scene::default() }.volume(|x, y, k| {
        let dot = k == 1 && (x - 12.5).hypot(y - 7.0) < 0.28;
        let arm = k == 2 && (y - 7.0).abs() < 0.6 && x > 8.0 && x < 13.0;
        if from_centre(x, y) < 3.0 || dot || arm { 300.0 } else { 50.0 }
    });
    let extracted = extracted(&volume, [8.0, 7.0, 1.0]);
    assert_eq!(counts(&extracted), [1; 4]);
    // No centre sees the arm whole.
    assert_eq!(codes(&extracted), ["sections.fragment", "sections.not_modelled"]);
}

#[test]
fn a_passing_hole_is_filled_and_a_lasting_one_kept() {
    let holed = |planes: std::ops::Range<usize>| {
        let volume = Scene { n: [64, 56, 6], ..Scene::default() }.volume(|x, y, k| match from_centre(x, y) {
            r if r < 1.2 && planes.contains(&k) => 50.0,
            r if r < 4.5 => 300.0,
            _ => 50.0,
        });
        extracted(&volume, [CENTRE[0] + 3.0, CENTRE[1], 1.0])
    };
    let passing = holed(2..4);
    assert_eq!((counts(&passing), codes(&passing)), (vec![1; 6], vec!["sections.passing_hole"]));
    assert_eq!(counts(&holed(1..4)), [1, 2, 2, 2, 1, 1]);
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let scene = Scene { noise_hu: 20.0, n: [64, 56, 6], ..Scene::default() };
    let volume = scene.volume(|x, y, _| if from_centre(x, y) < 3.0 { 300.0 } else { 50.0 });
    let with = |n: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        let extracted = pool.install(|| extracted(&volume, [8.0, 7.0, 1.0]));
        format::to_json(&extracted.stack).unwrap()
    };
    assert_eq!(with(1), with(4));
}

#[test]
fn parameters_and_masks_out_of_range_are_refused() {
    let volume = Scene::default().volume(|x, y, _| if from_centre(x, y) < 3.0 { 300.0 } else { 50.0 });
    let segmentation = segmented(&volume, [8.0, 7.0, 1.0], None);
    let run =
        |params: Params| extract(&volume, &segmentation, &params, &Task::quiet()).unwrap_err().to_string();
    for chord_tolerance_mm in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(run(Params { chord_tolerance_mm, ..Params::default() }).contains("chord tolerance"));
    }
    assert!(run(Params { least_points: 3, ..Params::default() }).contains("give 8 to 1024"));
    let small = Scene { n: [20, 20, 4], ..Scene::default() }.volume(|_, _, _| 0.0);
    let other = extract(&small, &segmentation, &Params::default(), &Task::quiet());
    assert!(matches!(other, Err(Error::MaskOutsideVolume { .. })), "{other:?}");
}

#[test]
fn a_mask_of_dots_leaves_nothing() {
    let volume = Scene { blur_mm: 0.05, ..Scene::default() }
        .volume(|x, y, _| if (x - 8.0).hypot(y - 7.0) < 0.3 { 300.0 } else { 50.0 });
    let segmentation = segmented(&volume, [8.0, 7.0, 1.0], Some([175.0, 500.0]));
    let result = extract(&volume, &segmentation, &Params::default(), &Task::quiet());
    assert!(matches!(result, Err(Error::TooFewPlanes { found: 0, .. })), "{result:?}");
}

#[test]
fn a_cancelled_task_stops() {
    let volume = Scene::default().volume(|x, y, _| if from_centre(x, y) < 3.0 { 300.0 } else { 50.0 });
    let segmentation = segmented(&volume, [8.0, 7.0, 1.0], None);
    assert_eq!(segmentation.polarity, Polarity::Bright);
    let cancel = CancelToken::default();
    cancel.cancel();
    let result = extract(&volume, &segmentation, &Params::default(), &Task::new(&|_, _| {}, cancel));
    assert!(matches!(result, Err(Error::Cancelled(_))));
}

/// A tube of 3 mm, its axis a bow, in planes 1 mm apart; plane 4 shows what `there` says.
fn bowed(there: impl Fn(f64, f64) -> Option<f64>) -> Volume {
    let scene = Scene { n: [72, 56, 12], noise_hu: 15.0, ..Scene::default() };
    scene.volume(|x, y, k| {
        let axis = CENTRE[0] + 0.02 * (k as f64 - 5.0).powi(2);
        let tube = if (x - axis).hypot(y - CENTRE[1]) < 3.0 { 300.0 } else { 50.0 };
        if k == 4 { there(x, y).unwrap_or(tube) } else { tube }
    })
}

/// Plane 4 of it drawn as it is, 0.1 mm too far out.
fn drawn_by_hand() -> segment::Corrections {
    let point = |i: i32| {
        let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 48.0).sin_cos();
        format!("[{},{}]", CENTRE[0] + 0.02 + 3.1 * cos, CENTRE[1] + 3.1 * sin)
    };
    let points: Vec<String> = (0..48).map(point).collect();
    toml::from_str(&format!("[[contour]]\nz_mm = 4\npoints_mm = [{}]\n", points.join(","))).unwrap()
}

#[test]
fn a_drawn_plane_stands_as_drawn_and_its_neighbours_as_if_it_showed_the_vessel() {
    let of = |volume: &Volume, corrections: segment::Corrections| {
        let params = segment::Params {
            seeds_patient_mm: vec![Point3::new(CENTRE[0], CENTRE[1], 1.0)],
            corrections,
            ..Default::default()
        };
        let found = segment::segment(volume, &params, &Task::quiet()).unwrap();
        (extract(volume, &found, &Params::default(), &Task::quiet()).unwrap(), found)
    };
    let (whole, _) = of(&bowed(|_, _| None), segment::Corrections::default());
    // The plane shows nothing; bone; a vessel beside the true one.
    let others: [fn(f64, f64) -> Option<f64>; 3] = [
        |_, _| Some(50.0),
        |_, _| Some(900.0),
        |x, y| Some(if (x - 10.0).hypot(y - CENTRE[1]) < 3.0 { 300.0 } else { 50.0 }),
    ];
    for there in others {
        let (drawn, found) = of(&bowed(there), drawn_by_hand());
        assert_eq!(codes(&drawn), codes(&whole), "{:?}", drawn.warnings);
        assert_eq!(drawn.stack.planes[4].contours, found.drawn[&4]);
        for k in [2, 3, 5, 6] {
            let truth = SegmentIndex::try_new(&whole.stack.planes[k].contours).unwrap();
            let points = drawn.stack.planes[k].contours.iter().flat_map(|c| &c.points);
            let off = points.map(|p| truth.signed_distance_mm(*p).abs()).fold(0.0, f64::max);
            assert!(off < 0.03, "plane {k}: {off:.4}");
        }
    }
}

#[test]
fn a_contour_that_no_centre_sees_whole_is_told_with_what_was_kept() {
    // Three quarters of a ring in planes 4 to 6, a disk beyond.
    let scene = Scene { n: [80, 72, 10], ..Scene::default() };
    let volume = scene.volume(|x, y, k| {
        let (dx, dy) = (x - 10.0, y - 9.0);
        let r = dx.hypot(dy);
        let crescent = (2.5..5.5).contains(&r) && !(dx > 0.0 && dy.abs() < dx);
        let is_lumen = if (4..7).contains(&k) { crescent } else { r < 5.5 };
        if is_lumen { 300.0 } else { 50.0 }
    });
    let found = extracted(&volume, [6.0, 9.0, 1.0]);
    let told: Vec<&str> = found
        .warnings
        .iter()
        .filter(|w| w.code == "sections.not_modelled")
        .map(|w| w.text.as_str())
        .collect();
    assert_eq!(
        told,
        [
            "contours that no centre sees whole (crescents, two lobes), or that crossed under the model of the image: the level between lumen and wall was kept there: z 4.000 mm (1 contour), z 5.000 mm (1 contour), z 6.000 mm (1 contour)"
        ]
    );
    assert!(!codes(&found).contains(&"sections.not_fitted"), "{:?}", found.warnings);
}
