//! Vessels found by themselves beside what is none, and regions that leave the vessel.

use super::*;

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

fn leak_of(volume: &Volume) -> guard::Into {
    let seeded = params([20.0, 20.0, 8.0]);
    let window = Params { window_hu: Some([175.0, 2000.0]), ..seeded };
    let Err(Error::Leaks { plane, place, into, neck_mm, .. }) = run(volume, &window) else {
        panic!("no leak: {:?}", run(volume, &window).map(|s| s.mask.n_voxels()))
    };
    assert!(
        (9..11).contains(&plane) && (22.0..36.0).contains(&place.0.x) && (place.0.y - 20.0).abs() < 3.0,
        "{plane} {place}"
    );
    assert!(neck_mm < 4.0, "{neck_mm}");
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
    assert_eq!(leak_of(&beside(2.0, 300.0, |x, y, _| disc(x, y, 36.0, 4.0))), guard::Into::Neighbour);
}

#[test]
fn undiluted_contrast_medium_is_a_leak() {
    assert!(matches!(
        leak_of(&beside(2.0, 900.0, |x, y, _| disc(x, y, 36.0, 3.0))),
        guard::Into::Brighter(_)
    ));
}

#[test]
fn bone_is_a_leak() {
    let block = |x: f64, y: f64, _| (x - 42.0).abs() < 8.0 && (y - 20.0).abs() < 14.0;
    assert!(matches!(leak_of(&beside(2.0, 300.0, block)), guard::Into::Larger(_)));
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
fn featureless_images_have_no_vessel() {
    let noise = Scene { noise_hu: 20.0, n: [64, 56, 12], ..Scene::default() }.volume(|_, _, _| 50.0);
    let nothing = find_unattended(&noise, &Params::default(), &Task::quiet()).unwrap_err();
    assert_eq!(nothing, Error::NoCandidate { planes: 12 });
    assert!(nothing.to_string().starts_with("no vessel was found by itself in 12 planes"));
    let constant = Scene::default().volume(|_, _, _| 7.0);
    assert!(find_unattended(&constant, &Params::default(), &Task::quiet()).is_err());
}
