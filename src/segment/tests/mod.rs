mod corrected;
mod unattended;

use super::testing::Scene;
use super::*;
use crate::ct::Voxels;
use crate::geom::{RigidTransform, Vector3};
use crate::progress::{CancelToken, Cancelled};

/// A bright (300) or dark (-900) disk of 3 mm at (8, 7), in a wall of 50 HU.
fn disk(lumen_hu: f64) -> Volume {
    Scene::default().volume(|x, y, _| if (x - 8.0).hypot(y - 7.0) < 3.0 { lumen_hu } else { 50.0 })
}

fn params(seed: [f64; 3]) -> Params {
    Params { seeds_patient_mm: vec![Point3::from(seed)], ..Params::default() }
}

fn windowed(lo: f64, hi: f64) -> Params {
    Params { window_hu: Some([lo, hi]), ..params([8.0, 7.0, 1.0]) }
}

fn run(volume: &Volume, params: &Params) -> Result<Segmentation, Error> {
    segment(volume, params, &Task::quiet())
}

fn error_text(volume: &Volume, params: &Params) -> String {
    let text = run(volume, params).unwrap_err().to_string();
    assert!(!text.contains('\n') && !text.ends_with('.'), "{text}");
    text
}

#[test]
fn bright_and_dark_disks_are_found_without_a_window() {
    for (lumen_hu, polarity) in [(300.0, Polarity::Bright), (-900.0, Polarity::Dark)] {
        let found = run(&disk(lumen_hu), &params([8.5, 6.5, 2.0])).unwrap();
        assert_eq!(found.polarity, polarity);
        assert_eq!(found.planes, 0..4);
        let area = found.mask.n_voxels() as f64 / 4.0 * 0.25 * 0.25;
        // Counted in pixels, a disk centred on one lacks up to 4 %.
        assert!((area / (9.0 * std::f64::consts::PI) - 1.0).abs() < 0.04, "{area}");
        let half = 0.5 * (lumen_hu + 50.0);
        assert!((found.edge_hu() - half).abs() < 0.05 * (lumen_hu - 50.0).abs(), "{:?}", found.window_hu);
        assert!(found.warnings.is_empty());
    }
}

#[test]
fn a_faint_wall_is_found_beside_air_and_bone() {
    let scene =
        Scene { n: [120, 100, 4], pixel_mm: [0.4; 2], blur_mm: 0.5, noise_hu: 12.0, ..Scene::default() };
    for (beside_hu, gap_mm) in [(-1000.0, 3.0), (-1000.0, 6.0), (1200.0, 3.0), (1200.0, 6.0)] {
        let volume = scene.volume(|x, y, _| {
            if (x - 20.0).hypot(y - 20.0) < 3.0 {
                250.0
            } else if x < 20.0 - 3.0 - gap_mm || y > 20.0 + 3.0 + gap_mm {
                beside_hu
            } else {
                50.0
            }
        });
        let levels = levels::find(&volume, &[[50, 50, 1]], Polarity::Auto).unwrap();
        let found = [levels.lumen_hu - 250.0, levels.wall_hu - 50.0];
        assert!(found.iter().all(|d| d.abs() < 20.0), "{beside_hu} at {gap_mm} mm: {levels:?}");
    }
}

#[test]
fn noise_at_the_seed_is_no_level() {
    let scene = Scene { noise_hu: 50.0, ..Scene::default() };
    let volume = scene.volume(|x, y, _| if (x - 8.0).hypot(y - 7.0) < 3.0 { 300.0 } else { 50.0 });
    for seed in [[32, 28, 0], [30, 27, 1], [34, 30, 2], [28, 31, 3]] {
        let levels = levels::find(&volume, &[seed], Polarity::Auto).unwrap();
        let found = [levels.lumen_hu - 300.0, levels.wall_hu - 50.0];
        assert!(found.iter().all(|d| d.abs() < 25.0), "{seed:?}: {levels:?}");
    }
}

#[test]
fn noise_does_not_stop_the_growth() {
    let scene = Scene { noise_hu: 25.0, ..Scene::default() };
    let volume = scene.volume(|x, y, _| if (x - 8.0).hypot(y - 7.0) < 3.0 { 300.0 } else { 50.0 });
    let found = run(&volume, &params([8.0, 7.0, 0.0])).unwrap();
    let area = found.mask.n_voxels() as f64 / 4.0 * 0.25 * 0.25;
    assert!((area / (9.0 * std::f64::consts::PI) - 1.0).abs() < 0.04, "{area}");
}

#[test]
fn polarity_of_a_given_window_follows_from_the_rim() {
    assert_eq!(run(&disk(300.0), &windowed(150.0, 500.0)).unwrap().polarity, Polarity::Bright);
    assert_eq!(run(&disk(-900.0), &windowed(-2000.0, -400.0)).unwrap().polarity, Polarity::Dark);
}

#[test]
fn regions_join_through_faces_only() {
    let scene = Scene { n: [8, 8, 2], pixel_mm: [1.0, 1.0], blur_mm: 1e-3, ..Scene::default() };
    // Two squares that touch at a corner.
    let volume = scene.volume(|x, y, _| {
        let (i, j) = (x.round(), y.round());
        let square = |a: f64| i >= a && i <= a + 1.0 && j >= a && j <= a + 1.0;
        if square(2.0) || square(4.0) { 300.0 } else { 0.0 }
    });
    let found = run(&volume, &Params { window_hu: Some([150.0, 500.0]), ..params([2.0, 2.0, 0.0]) }).unwrap();
    assert_eq!(found.mask.n_voxels(), 8);
    let both = Params {
        seeds_patient_mm: vec![Point3::new(2.0, 2.0, 0.0), Point3::new(5.0, 5.0, 1.0)],
        ..windowed(150.0, 500.0)
    };
    assert_eq!(run(&volume, &both).unwrap().mask.n_voxels(), 16);
}

#[test]
fn z_range_limits_the_planes_and_keeps_rounded_ends() {
    let found = run(&disk(300.0), &Params { z_mm: Some([0.9999, 2.0]), ..params([8.0, 7.0, 1.0]) });
    assert_eq!(found.unwrap().planes, 1..3);
}

#[test]
fn a_vessel_that_ends_early_is_reported() {
    let volume =
        Scene::default().volume(|x, y, k| if (x - 8.0).hypot(y - 7.0) < 3.0 && k < 3 { 300.0 } else { 50.0 });
    let found = run(&volume, &params([8.0, 7.0, 0.0])).unwrap();
    assert_eq!(found.planes, 0..3);
    assert_eq!(found.warnings[0].code, "segment.range_not_reached");
    assert!(found.warnings[0].text.contains("0.000 to 2.000 mm"), "{}", found.warnings[0].text);
}

#[test]
fn air_around_a_specimen_is_not_its_lumen() {
    // A block of wall in air, its dark lumen open to the air above plane 2.
    let volume = Scene { n: [64, 56, 5], ..Scene::default() }.volume(|x, y, k| {
        let lumen = (x - 8.0).hypot(y - 7.0) < 3.0;
        let block = (x - 8.0).abs() < 6.0 && (y - 7.0).abs() < 5.0 && k < 4;
        if block && !lumen { 50.0 } else { -1000.0 }
    });
    for polarity in [Polarity::Auto, Polarity::Dark] {
        for window_hu in [None, Some([-1200.0, -475.0])] {
            let params = Params { polarity, window_hu, ..params([8.0, 7.0, 1.0]) };
            let found = run(&volume, &params).unwrap();
            assert_eq!((found.planes.clone(), found.polarity), (0..4, Polarity::Dark));
            let area = found.mask.n_voxels() as f64 / 4.0 * 0.25 * 0.25;
            assert!((area / (9.0 * std::f64::consts::PI) - 1.0).abs() < 0.04, "{area}");
            assert!(found.warnings.iter().any(|w| w.code == "segment.outside_air"), "{:?}", found.warnings);
        }
    }
    let outside = Params { polarity: Polarity::Dark, ..params([1.0, 1.0, 1.0]) };
    assert!(matches!(
        run(&volume, &Params { window_hu: Some([-1200.0, -475.0]), ..outside }),
        Err(Error::Leaks(leak)) if leak.into.is_none()
    ));
}

#[test]
fn seed_outside_the_volume_names_its_extent() {
    let text = error_text(&disk(300.0), &params([80.0, 7.0, 1.0]));
    assert_eq!(
        text,
        "seed (80.000, 7.000, 1.000) lies outside the volume, whose box reaches from (-0.125, -0.125, -0.500) to (15.875, 13.875, 3.500) mm (patient LPS): give a seed inside the lumen"
    );
}

#[test]
fn extent_and_seeds_are_patient_coordinates() {
    let mut volume = disk(300.0);
    // Stack x is patient y, stack y is patient z, stack z is patient x.
    volume.patient_from_stack =
        RigidTransform::from_axes(Point3::new(100.0, 0.0, 0.0), Vector3::y(), Vector3::z(), Vector3::x());
    assert!(run(&volume, &params([101.0, 8.0, 7.0])).is_ok());
    let text = error_text(&volume, &params([8.0, 7.0, 1.0]));
    assert!(text.contains("(99.500, -0.125, -0.125) to (103.500, 15.875, 13.875)"), "{text}");
}

#[test]
fn seed_outside_the_z_range_is_told() {
    let params = Params { z_mm: Some([2.0, 3.0]), ..params([8.0, 7.0, 1.0]) };
    let text = error_text(&disk(300.0), &params);
    assert!(text.contains("at z 1.000 mm") && text.contains("2 to 3 mm"), "{text}");
}

#[test]
fn seed_outside_the_window_names_value_and_window() {
    let text = error_text(
        &disk(300.0),
        &Params { seeds_patient_mm: vec![Point3::new(1.0, 1.0, 1.0)], ..windowed(150.0, 500.0) },
    );
    assert!(text.contains("has 50 HU, outside the window 150 to 500 HU"), "{text}");
}

#[test]
fn window_that_selects_nothing_names_the_values() {
    let text = error_text(&disk(300.0), &windowed(1000.0, 2000.0));
    assert!(text.contains("selects nothing") && text.contains("from 50 to 300 HU"), "{text}");
}

#[test]
fn leak_to_the_border_names_plane_and_place() {
    let volume = Scene::default().volume(|x, y, k| {
        let slit = k == 2 && (y - 7.0).abs() < 0.5 && x > 8.0;
        if slit || (x - 8.0).hypot(y - 7.0) < 3.0 { 300.0 } else { 50.0 }
    });
    let Err(Error::Leaks(leak)) = run(&volume, &windowed(150.0, 500.0)) else { panic!("no leak") };
    let Leak { voxel, z_mm, place, into, .. } = &*leak;
    assert_eq!((voxel[2], *z_mm, *into), (2, 2.0, None));
    assert!((place.0.x - 15.75).abs() < 1e-9 && (place.0.y - 7.0).abs() < 0.6, "{place}");
    // The background is one leak.
    assert!(matches!(run(&volume, &windowed(0.0, 500.0)), Err(Error::Leaks(leak)) if leak.into.is_none()));
}

#[test]
fn empty_ranges_and_windows_are_refused() {
    let volume = disk(300.0);
    assert!(error_text(&volume, &Params::default()).contains("--seed-mm"));
    assert!(error_text(&volume, &windowed(5.0, 5.0)).contains("--window-hu"));
    assert!(matches!(run(&volume, &windowed(f64::NAN, 5.0)), Err(Error::BadWindow { .. })));
    let with_z = |lo: f64, hi: f64| Params { z_mm: Some([lo, hi]), ..params([8.0, 7.0, 1.0]) };
    assert!(matches!(run(&volume, &with_z(3.0, 1.0)), Err(Error::BadZRange { .. })));
    assert!(error_text(&volume, &with_z(100.0, 200.0)).contains("from 0.000 to 3.000 mm"));
    assert!(matches!(run(&volume, &with_z(0.9, 1.1)), Err(Error::TooFewPlanes { found: 1 })));
}

#[test]
fn flat_regions_and_featureless_images_are_refused() {
    let flat = Scene::default()
        .volume(|x, y, k| if (x - 8.0).hypot(y - 7.0) < 3.0 && k == 1 { 300.0 } else { 50.0 });
    assert!(matches!(
        run(&flat, &params([8.0, 7.0, 1.0])),
        Err(Error::RegionTooFlat { found: 1, z_mm }) if (z_mm - 1.0).abs() < 1e-9
    ));
    let blank = Scene::default().volume(|_, _, _| 7.0);
    assert!(
        error_text(&blank, &params([8.0, 7.0, 1.0]))
            .contains("no wall was found within 30 mm of seed (8.000")
    );
}

#[test]
fn a_polarity_that_the_image_contradicts_is_refused() {
    let dark = Params { polarity: Polarity::Dark, ..params([8.0, 7.0, 1.0]) };
    for params in [dark.clone(), Params { window_hu: Some([200.0, 600.0]), ..dark }] {
        let refused = run(&disk(300.0), &params).unwrap_err();
        assert!(
            matches!(refused, Error::OtherPolarity { asked: "dark", found: "brighter", .. }),
            "{refused}"
        );
    }
    let bright = Params { polarity: Polarity::Bright, ..params([8.0, 7.0, 1.0]) };
    assert!(run(&disk(300.0), &bright).is_ok());
}

#[test]
fn a_seed_beside_the_vessel_is_refused_not_grown_over_the_image() {
    // Tissue in air, a vessel in it: the tissue touches no border and is brighter than what surrounds it.
    let scene =
        Scene { n: [120, 100, 6], pixel_mm: [0.4; 2], blur_mm: 0.4, noise_hu: 10.0, ..Scene::default() };
    let volume = scene.volume(|x, y, _| {
        if (x - 20.0).hypot(y - 18.0) < 3.0 {
            300.0
        } else if (x - 23.8).hypot(y - 19.8) < 17.0 {
            50.0
        } else {
            -1000.0
        }
    });
    assert!(run(&volume, &params([20.0, 18.0, 2.0])).unwrap().warnings.is_empty());
    let text = error_text(&volume, &params([34.0, 28.0, 2.0]));
    assert!(
        text.contains("that is no vessel but what surrounds it") && text.contains("% of the image"),
        "{text}"
    );
}

#[test]
fn noise_is_told_from_anatomy_or_refused() {
    let noisy = |noise_hu: f64| {
        let scene = Scene { n: [80, 72, 12], noise_hu, ..Scene::default() };
        scene.volume(|x, y, _| if (x - 10.0).hypot(y - 9.0) < 3.0 { 300.0 } else { 60.0 })
    };
    let seeded = params([10.0, 9.0, 5.0]);
    let clear = run(&noisy(20.0), &seeded).unwrap();
    assert!(clear.smoothing_mm <= 0.0 && clear.warnings.is_empty());
    let grainy = run(&noisy(50.0), &seeded).unwrap();
    assert!(grainy.smoothing_mm > 0.0 && grainy.warnings.is_empty(), "{:?}", grainy.warnings);
    let area = grainy.mask.n_voxels() as f64 / 12.0 * 0.25 * 0.25;
    assert!((area / (9.0 * std::f64::consts::PI) - 1.0).abs() < 0.06, "{area}");
    let text = error_text(&noisy(150.0), &seeded);
    assert!(text.contains("noise"), "{text}");
}

#[test]
fn a_cancelled_task_stops() {
    let cancel = CancelToken::default();
    cancel.cancel();
    let result = segment(&disk(300.0), &params([8.0, 7.0, 1.0]), &Task::new(&|_, _| {}, cancel));
    assert_eq!(result.unwrap_err(), Error::Cancelled(Cancelled));
}

#[test]
fn values_that_are_no_numbers_are_never_lumen() {
    let mut volume = disk(300.0);
    let centre = 28 * 64 + 32;
    let mut hu: Vec<f32> = volume.hu.iter().collect();
    hu[centre] = f32::NAN;
    volume.hu = Voxels::new(&hu, volume.dims[0] * volume.dims[1]);
    let found = run(&volume, &params([7.0, 6.0, 1.0])).unwrap();
    assert!(!found.mask.contains(32, 28, 0) && found.mask.contains(32, 28, 1));
}
