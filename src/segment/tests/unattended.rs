//! Vessels found by themselves beside what is none, and regions that leave the vessel.

use super::*;
use proptest::prelude::*;

/// A vessel of radius 3 and beside it what `other` says, joined by a neck of this width in planes 9 and 10.
fn beside(neck_mm: f64, other_hu: f64, other: impl Fn(f64, f64, usize) -> bool) -> Volume {
    let scene = Scene { n: [120, 80, 20], pixel_mm: [0.5; 2], plane_mm: 2.0, blur_mm: 0.4, noise_hu: 10.0 };
    scene.volume(|x, y, k| {
        if (x - 20.0).hypot(y - 20.0) < 3.0 {
            300.0
        } else if other(x, y, k) {
            other_hu
        } else if (9..11).contains(&k) && (20.0..34.0).contains(&x) && (y - 20.0).abs() < 0.5 * neck_mm {
            300.0
        } else {
            50.0
        }
    })
}

fn disc(x: f64, y: f64, cx: f64, r: f64) -> bool {
    (x - cx).hypot(y - 20.0) < r
}

fn leak_of(volume: &Volume) -> Beyond {
    let seeded = params([20.0, 20.0, 8.0]);
    let window = Params { window_hu: Some([175.0, 2000.0]), ..seeded };
    let Err(Error::Leaks(leak)) = run(volume, &window) else {
        panic!("no leak: {:?}", run(volume, &window).map(|s| s.mask.n_voxels()))
    };
    let (place, [i, j, plane]) = (leak.place, leak.voxel);
    let (into, neck_mm) = leak.into.expect("a passage to something");
    assert!(
        (9..11).contains(&plane) && (22.0..36.0).contains(&place.0.x) && (place.0.y - 20.0).abs() < 3.0,
        "{plane} {place}"
    );
    assert!(neck_mm < 4.0, "{neck_mm}");
    assert!(
        leak.can_be_cut && leak.to_string().contains("end the vessel there with --on-leak cut"),
        "{leak}"
    );
    assert!(leak.to_string().contains("try --window-hu=1"), "half-way between 300 and 50 HU: {leak}");
    // What is shown of it: the place, the vessel and what it leaked into.
    assert!(leak.region.contains(i, j, plane) && leak.region.contains(40, 40, plane));
    assert!(leak.region.contains(72, 40, plane) && !leak.region.contains(40, 40, plane - 1));
    // Nobody attends: it ends there, and is said.
    let cut = run(volume, &Params { on_leak: OnLeak::Cut, ..window }).unwrap();
    assert!(cut.mask.contains(40, 40, 0) && !cut.mask.contains(72, 40, 0));
    assert_eq!(cut.planes, 0..20);
    assert_eq!(cut.warnings.iter().filter(|w| w.code == "segment.leak_cut").count(), 1);
    let area = cut.mask.n_voxels() as f64 / 20.0 * 0.25;
    assert!((area / (9.0 * std::f64::consts::PI) - 1.0).abs() < 0.08, "{area}");
    into
}

#[test]
fn a_vein_that_touches_through_a_neck_is_a_leak() {
    assert_eq!(leak_of(&beside(2.0, 300.0, |x, y, _| disc(x, y, 36.0, 4.0))), Beyond::Neighbour);
}

#[test]
fn undiluted_contrast_medium_is_a_leak() {
    assert!(matches!(leak_of(&beside(2.0, 900.0, |x, y, _| disc(x, y, 36.0, 3.0))), Beyond::Brighter(_)));
}

#[test]
fn bone_is_a_leak() {
    let block = |x: f64, y: f64, _| (x - 42.0).abs() < 8.0 && (y - 20.0).abs() < 14.0;
    assert!(matches!(leak_of(&beside(2.0, 300.0, block)), Beyond::Larger(_)));
}

#[test]
fn what_a_vessel_does_is_no_leak() {
    let window = |p: Params| Params { window_hu: Some([175.0, 500.0]), ..p };
    let grown = |volume: &Volume, z: f64| run(volume, &window(params([20.0, 20.0, z]))).map(|s| s.planes);
    // A branch that leaves sideways through a narrow origin and goes up only.
    let branch = beside(2.0, 300.0, |x, y, k| k >= 9 && disc(x, y, 36.0, 2.5));
    assert_eq!(grown(&branch, 8.0).unwrap(), 0..20);
    let scene = Scene { n: [120, 80, 20], pixel_mm: [0.5; 2], plane_mm: 2.0, blur_mm: 0.4, noise_hu: 10.0 };
    let tube = |radius: fn(usize) -> f64| {
        scene.volume(move |x, y, k| if disc(x, y, 20.0, radius(k)) { 300.0 } else { 50.0 })
    };
    // A throat of a sixth of the section, an aneurysm that doubles the diameter, a loop that parts and joins.
    assert_eq!(grown(&tube(|k| if (9..11).contains(&k) { 1.2 } else { 3.0 }), 8.0).unwrap(), 0..20);
    assert_eq!(grown(&tube(|k| 3.0 + 3.5 * (-0.1 * (k as f64 - 10.0).powi(2)).exp()), 2.0).unwrap(), 0..20);
    let ring = scene.volume(|x, y, k| {
        let apart = 6.0 * (std::f64::consts::PI * k as f64 / 19.0).sin();
        if disc(x, y, 20.0 - apart, 2.5) || disc(x, y, 20.0 + apart, 2.5) { 300.0 } else { 50.0 }
    });
    assert_eq!(grown(&ring, 0.0).unwrap(), 0..20);
    // A vessel that runs within a plane for a while.
    let bent = scene.volume(|x, y, k| {
        let below = k <= 10 && disc(x, y, 10.0, 2.5);
        let across = (9..12).contains(&k) && (10.0..50.0).contains(&x) && (y - 20.0).abs() < 2.5;
        if below || across || (k >= 10 && disc(x, y, 50.0, 2.5)) { 300.0 } else { 50.0 }
    });
    assert_eq!(run(&bent, &window(params([10.0, 20.0, 2.0]))).unwrap().planes, 0..20);
}

#[test]
fn levels_follow_a_contrast_that_fades() {
    // From 400 down to 150 HU in a wall that brightens from 0 to 60: no one window holds it all.
    let scene = Scene { n: [64, 56, 26], plane_mm: 2.0, noise_hu: 8.0, ..Scene::default() };
    let levels = |k: usize| (400.0 - 10.0 * k as f64, 2.4 * k as f64);
    let volume =
        scene.volume(|x, y, k| if (x - 8.0).hypot(y - 7.0) < 3.0 { levels(k).0 } else { levels(k).1 });
    let found = run(&volume, &params([8.0, 7.0, 4.0])).unwrap();
    for k in 0..20 {
        let half = 0.5 * (levels(k).0 + levels(k).1);
        assert!((found.edge_hu_at(k) - half).abs() < 25.0, "{k}: {} for {half}", found.edge_hu_at(k));
    }
    assert!(found.planes.len() >= 20, "{:?}", found.planes);
}

#[test]
fn branches_that_part_at_once_are_the_trunks() {
    // Between the trunk and its three branches lies a plane whose section no level shows as round.
    let scene = Scene { n: [120, 100, 30], pixel_mm: [0.5; 2], plane_mm: 2.0, blur_mm: 0.4, noise_hu: 10.0 };
    let volume = scene.volume(|x, y, k| {
        let (x, y) = (x - 30.0, y - 25.0);
        let apart = 2.4 + 0.3 * k.saturating_sub(14) as f64;
        let branch = |turn: f64| (x - apart * turn.cos()).hypot(y - apart * turn.sin()) < 2.3;
        let is_in = if k < 14 { x.hypot(y) < 4.0 } else { [0.3, 2.4, 4.5].into_iter().any(branch) };
        if is_in { 300.0 } else { 50.0 }
    });
    let found = find_unattended(&volume, &Params::default(), &Task::quiet()).unwrap();
    assert_eq!(found.segmentation.planes, 0..30, "{:?}", found.candidates);
    assert!(found.candidates.len() == 1 && found.candidates[0].branches, "{:?}", found.candidates);
}

/// A tube along z of radius 2.5 that is `radius(k)` wide in its middle planes, and what was found of it by itself.
fn found_through(radius: impl Fn(usize) -> f64) -> Found {
    let scene = Scene { n: [80, 80, 36], pixel_mm: [0.5; 2], plane_mm: 2.0, blur_mm: 0.4, noise_hu: 10.0 };
    let volume = scene.volume(|x, y, k| {
        let r = if (16..20).contains(&k) { radius(k) } else { 2.5 };
        if disc(x, y, 20.0 + 0.05 * k as f64, r) { 350.0 } else { 50.0 }
    });
    find_unattended(&volume, &Params::default(), &Task::quiet()).unwrap()
}

fn codes(found: &Found) -> Vec<&str> {
    found.segmentation.warnings.iter().map(|w| w.code.as_str()).collect()
}

#[test]
fn a_vessel_goes_on_behind_a_throat_that_shows_as_no_section() {
    let found = found_through(|k| if k == 16 || k == 19 { 1.3 } else { 0.7 });
    assert_eq!(found.segmentation.planes, 0..36, "{:?}", found.segmentation.warnings);
    assert!(!codes(&found).contains(&"segment.followed"), "{:?}", found.segmentation.warnings);
}

#[test]
fn a_vessel_that_is_closed_ends_there_and_says_so() {
    let found = found_through(|_| 0.0);
    let planes = found.segmentation.planes.clone();
    assert!(planes == (0..16) || planes == (20..36), "{planes:?}");
    assert!(codes(&found).contains(&"segment.range_not_reached"), "{:?}", found.segmentation.warnings);
}

#[test]
fn specks_are_no_vessel_and_what_is_doubtful_is_told() {
    let scene = Scene { n: [80, 80, 20], pixel_mm: [1.0; 2], plane_mm: 2.0, blur_mm: 0.4, noise_hu: 5.0 };
    let found = |radius_mm: f64, hu: f64| {
        let volume = scene.volume(|x, y, _| if (x - 40.0).hypot(y - 40.0) < radius_mm { hu } else { 50.0 });
        find_unattended(&volume, &Params::default(), &Task::quiet())
    };
    assert!(found(0.8, 800.0).is_err());
    assert!(matches!(found(1.4, 800.0), Err(Error::TooFewPixels { .. })), "{:?}", found(1.4, 800.0));
    assert_eq!(codes(&found(2.2, 350.0).unwrap()), ["segment.few_pixels"]);
    assert_eq!(codes(&found(5.0, 1000.0).unwrap()), ["segment.doubtful_candidate"]);
    assert!(codes(&found(5.0, 350.0).unwrap()).is_empty());
}

#[test]
fn featureless_images_have_no_vessel() {
    let noise = Scene { noise_hu: 20.0, n: [64, 56, 12], ..Scene::default() }.volume(|_, _, _| 50.0);
    let nothing = find_unattended(&noise, &Params::default(), &Task::quiet()).unwrap_err();
    assert_eq!(nothing, Error::NoCandidate { planes: 12 });
    assert!(nothing.to_string().starts_with("no vessel was found by itself in 12 planes"));
    let constant = Scene::default().volume(|_, _, _| 7.0);
    assert!(find_unattended(&constant, &Params::default(), &Task::quiet()).is_err());
}

/// A tube whose course bends gently, among bone, a table and air.
#[derive(Debug, Clone)]
struct Tube {
    at: [f64; 2],
    bend: [f64; 2],
    radius: f64,
    contrast: f64,
    bone_at: f64,
    in_air: bool,
}

const N: [usize; 3] = [120, 100, 24];
const PIXEL_MM: f64 = 0.6;
const WALL_HU: f64 = 40.0;

fn tubes() -> impl Strategy<Value = Tube> {
    let place = [26.0..36.0_f64, 22.0..34.0_f64];
    let contrast = prop_oneof![200.0..400.0_f64, -900.0..-300.0_f64];
    (place, [-3.0..3.0_f64, -3.0..3.0_f64], 2.0..4.5_f64, contrast, 52.0..56.0_f64, any::<bool>()).prop_map(
        |(at, bend, radius, contrast, bone_at, in_air)| Tube { at, bend, radius, contrast, bone_at, in_air },
    )
}

impl Tube {
    fn middle(&self, k: usize) -> [f64; 2] {
        let t = k as f64 / (N[2] - 1) as f64 - 0.5;
        [0, 1].map(|d| self.at[d] + self.bend[d] * (3.0 * t).sin())
    }

    /// The tube, with a bone block of 9 x 14 mm, a table across the image, and air.
    fn level(&self, x: f64, y: f64, k: usize) -> f64 {
        let [cx, cy] = self.middle(k);
        let in_body = ((x - 36.0) / 30.0).hypot((y - 28.0) / 22.0) < 1.0;
        if (x - cx).hypot(y - cy) < self.radius {
            WALL_HU + self.contrast
        } else if (x - self.bone_at).abs() < 4.5 && (y - 28.0).abs() < 7.0 {
            900.0
        } else if (52.5..54.0).contains(&y) {
            150.0
        } else if in_body || !self.in_air {
            WALL_HU
        } else {
            -1000.0
        }
    }

    fn volume(&self) -> Volume {
        let scene = Scene { n: N, pixel_mm: [PIXEL_MM; 2], plane_mm: 2.0, blur_mm: 0.5, noise_hu: 20.0 };
        scene.volume(|x, y, k| self.level(x, y, k))
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 8, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_tube_is_found_beside_bone_table_and_air(tube in tubes()) {
        let volume = tube.volume();
        // A bright bone and a dark lumen compete on equal terms: which is meant has to be said.
        let polarity = if tube.contrast < 0.0 { Polarity::Dark } else { Polarity::Auto };
        let params = Params { polarity, ..Params::default() };
        let found = find_unattended(&volume, &params, &Task::quiet());
        let found = found.map_err(|e| TestCaseError::fail(e.to_string()))?;
        let mask = &found.segmentation.mask;
        prop_assert_eq!(mask.planes(), 0..N[2], "{:?}", found.candidates);
        let area = mask.n_voxels() as f64 / N[2] as f64 * PIXEL_MM * PIXEL_MM;
        let truth = std::f64::consts::PI * tube.radius.powi(2);
        prop_assert!((area / truth - 1.0).abs() < 0.15, "{} for {}: {:?}", area, truth, found.candidates);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the image")]
        let [x, y] = tube.middle(12).map(|c| (c / PIXEL_MM).round() as usize);
        prop_assert!(mask.contains(x, y, 12));
        let again = find_unattended(&volume, &params, &Task::quiet()).unwrap();
        prop_assert_eq!(again, found);
    }
}

/// Noise spoils its section in single planes, at every level that tells it from the wall.
#[test]
fn a_faint_tube_is_followed_over_planes_that_noise_has_spoilt() {
    let tube = Tube {
        at: [30.068744203316196, 27.65949795730659],
        bend: [-1.7076760990926807, -2.6676753444496617],
        radius: 2.7265723847589154,
        contrast: 200.0,
        bone_at: 52.0,
        in_air: true,
    };
    let found = find_unattended(&tube.volume(), &Params::default(), &Task::quiet()).unwrap();
    assert_eq!(found.segmentation.mask.planes(), 0..N[2], "{:?}", found.candidates);
}

#[test]
fn a_leak_that_a_misplaced_block_should_have_kept_out_says_so() {
    let volume = beside(2.0, 300.0, |x, y, _| disc(x, y, 36.0, 4.0));
    let refused = |blocks: &str| {
        let corrections = toml::from_str(blocks).unwrap();
        let params = Params { window_hu: Some([175.0, 2000.0]), corrections, ..params([20.0, 20.0, 8.0]) };
        let error = run(&volume, &params).unwrap_err();
        assert!(matches!(error.fault(), Error::Leaks(_)) && error.code() == "segment.leak", "{error}");
        assert!(picture::of_error(&volume, &error).is_some());
        error.to_string()
    };
    let plain = refused("");
    assert!(plain.contains("keep it out with [[segment.block]] in the case file, or"), "{plain}");
    assert!(!plain.contains("of the corrections"), "{plain}");
    // The signs of x and y are those of RAS.
    let mirrored = "[[block]]\nbox_mm = [[-30, -25, 16], [-24, -15, 22]]\n";
    let text = refused(mirrored);
    assert!(
        text.contains("with a [[segment.block]] in the case file that holds this place (the one that is given does not), or"),
        "{text}"
    );
    assert!(
        text.contains("; of the corrections in the case file: segment.block[1] holds no voxel of the image and keeps nothing out: check"),
        "{text}"
    );
    let beside = format!("{mirrored}[[block]]\nbox_mm = [[2, 2, 2], [3, 3, 3]]\n");
    let text = refused(&beside);
    assert!(text.contains("(none of the 2 given does)") && !text.contains("block[2]"), "{text}");
    // The right signs keep it out.
    let block = toml::from_str("[[block]]\nbox_mm = [[24, 15, 16], [30, 25, 22]]\n").unwrap();
    let params = Params { window_hu: Some([175.0, 2000.0]), corrections: block, ..params([20.0, 20.0, 8.0]) };
    assert!(run(&volume, &params).unwrap().warnings.is_empty());
}

#[test]
fn corrections_that_do_nothing_are_told_where_nothing_is_found() {
    let volume = Scene::default().volume(|_, _, _| 50.0);
    let corrections = toml::from_str("[[block]]\nz_mm = [90, 91]\n").unwrap();
    let error =
        find_unattended(&volume, &Params { corrections, ..Params::default() }, &Task::quiet()).unwrap_err();
    assert_eq!(error.code(), "segment.no_candidate");
    assert!(error.to_string().contains("segment.block[1] holds no voxel"), "{error}");
}
