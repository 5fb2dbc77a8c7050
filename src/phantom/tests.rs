use super::*;
use crate::geom::Point2;
use crate::progress::{CancelToken, Task};
use std::f64::consts::PI;

fn small(kind: Kind) -> Params {
    Params { kind, noise_hu: 0.0, n_planes: 6, n_pixels: 160, ..Params::default() }
}

fn counts(kind: Kind) -> Vec<usize> {
    let vessel = Vessel::new(kind);
    Params::default().plane_z_mm().iter().map(|&z| vessel.region_at(z, 64).contours.len()).collect()
}

fn runs(kind: Kind) -> Vec<usize> {
    let mut counts = counts(kind);
    counts.dedup();
    counts
}

/// Area enclosed by a smooth curve through evenly spaced points: the polygon's, corrected for its chords by
/// Richardson extrapolation over half the points.
fn smooth_area_mm2(region: &crate::geom::Region) -> f64 {
    let coarse = |c: &crate::geom::Contour| {
        crate::geom::Contour::new(c.points.iter().step_by(2).copied().collect()).signed_area_mm2()
    };
    region.contours.iter().map(|c| (4.0 * c.signed_area_mm2() - coarse(c)) / 3.0).sum()
}

#[test]
fn the_seed_lies_in_the_lumen_of_the_image_or_the_image_is_refused() {
    for kind in Kind::ALL {
        let inside = |params: &Params| {
            let seed = default_seed(params);
            let on_plane = params.plane_z_mm().iter().any(|z| (z - seed.z).abs() < 1e-6);
            on_plane && lies_in_image(params, seed) && Vessel::new(kind).value(seed) < 0.0
        };
        let usual = Params { kind, ..Params::default() };
        assert!(inside(&usual) && default_seed(&usual).z == 33.0, "{kind:?}");
        let sparse = Params { plane_step_mm: 50.0, n_planes: 100, ..usual.clone() };
        assert!(inside(&sparse) && sparse.check_vessel().is_ok(), "{kind:?}: {:?}", default_seed(&sparse));
        let beyond = Params { first_plane_z_mm: 200.0, ..usual };
        let refused = beyond.check_vessel().unwrap_err().to_string();
        assert!(
            refused.contains("from z 200 to 335 mm and 102.4 mm wide, show nothing of the vessel"),
            "{refused}"
        );
    }
    let narrow = Params { n_pixels: 8, ..Params::default() };
    assert!(narrow.check_vessel().is_ok() == lies_in_image(&narrow, default_seed(&narrow)));
}

#[test]
fn tube_sections_are_circles_of_the_given_radius() {
    let vessel = Vessel::new(Kind::Tube);
    for z in [-1.5, 0.0, 17.3, 50.0, 90.0, 138.0] {
        let region = vessel.region_at(z, 256);
        let (centre, radius) = (vessel.inner_point_at(z).xy(), vessel.tubes[0].radius_at(z));
        assert_eq!(region.contours.len(), 1);
        let polygon = 128.0 * radius * radius * (PI / 128.0).sin();
        assert!((region.area_mm2() - polygon).abs() < 1e-5, "area at {z}");
        assert!(region.contours[0].points.iter().all(|p| ((p - centre).norm() - radius).abs() < 1e-9));
    }
    assert_eq!(vessel.tubes[0].radius_at(50.0), 2.4);
}

#[test]
fn contours_lie_on_the_zero_set_evenly_spaced_and_oriented() {
    for kind in Kind::ALL {
        let vessel = Vessel::new(kind);
        for z in (-1..=69).map(|i| f64::from(2 * i)) {
            for contour in vessel.region_at(z, 128).contours {
                assert!(contour.is_ccw() && contour.len() == 128);
                let value = |p: &Point2| vessel.value(Point3::new(p.x, p.y, z)).abs();
                assert!(contour.points.iter().all(|p| value(p) < 1e-9), "{kind:?} at {z}");
                // In a sharp crotch a chord is shorter than its arc; everywhere else the spacing is even.
                let mean = contour.perimeter_mm() / 128.0;
                let is_even = |(a, b): (Point2, Point2)| ((b - a).norm() - mean).abs() < 0.05 * mean;
                assert!(contour.edges().filter(|&e| is_even(e)).count() >= 122, "{kind:?} at {z}");
            }
        }
    }
}

#[test]
fn each_kind_splits_and_merges_as_its_name_says() {
    assert_eq!(runs(Kind::Carotid), [1, 2]);
    assert_eq!(runs(Kind::Stenosis), [1, 2]);
    assert_eq!(runs(Kind::Trifurcation), [1, 3]);
    assert_eq!(runs(Kind::Merge), [1, 2, 1]);
    assert_eq!(runs(Kind::Tube), [1]);
}

#[test]
fn branches_do_not_show_before_they_leave_their_parent() {
    for (kind, z) in [(Kind::Carotid, 20.0), (Kind::Trifurcation, 20.0), (Kind::Merge, 120.0)] {
        let vessel = Vessel::new(kind);
        let trunk = Vessel { tubes: vec![vessel.tubes[0].clone()], ..vessel.clone() };
        let [whole, alone] = [&vessel, &trunk].map(|v| v.region_at(z, 64));
        assert_eq!(whole.contours.len(), alone.contours.len());
        let pairs =
            whole.contours.iter().zip(&alone.contours).flat_map(|(a, b)| a.points.iter().zip(&b.points));
        assert!(pairs.into_iter().all(|(a, b)| (a - b).norm() < 1e-9), "{kind:?}");
    }
}

#[test]
fn carotid_has_the_calibres_of_a_carotid() {
    let vessel = Vessel::new(Kind::Carotid);
    let diameter = |z: f64, i: usize| {
        let area = vessel.region_at(z, 256).contours[i].signed_area_mm2();
        2.0 * (area / PI).sqrt()
    };
    assert!((5.5..7.0).contains(&diameter(20.0, 0)), "common");
    // Sorted by mean x: the external artery is the medial one, of smaller x.
    assert!((3.0..4.2).contains(&diameter(110.0, 0)), "external");
    assert!((4.0..5.2).contains(&diameter(110.0, 1)), "internal");
    assert!(diameter(78.0, 1) > 1.2 * diameter(110.0, 1), "bulb");
}

#[test]
fn stenosis_has_the_stated_degree() {
    let vessel = Vessel::new(Kind::Stenosis);
    let [throat, distal] = anatomy::STENOSIS_Z_MM;
    let diameter = |z: f64| {
        smooth_area_mm2(&crate::geom::Region::new(vec![vessel.region_at(z, 256).contours[1].clone()])).sqrt()
    };
    let degree = 1.0 - diameter(throat) / diameter(distal);
    assert!((degree - anatomy::STENOSIS_DEGREE).abs() < 1e-4, "{degree}");
}

#[test]
fn image_holds_the_volume_of_the_tube() {
    let params = Params { slab_mm: 3.0, ..small(Kind::Tube) };
    let volume = volume(&params, &Task::quiet());
    let Tissue { lumen_hu, around_hu, .. } = params.polarity.tissue();
    let share: f64 = volume.hu.iter().map(|v| (f64::from(v) - around_hu) / (lumen_hu - around_hu)).sum();
    let measured = share * params.pixel_mm * params.pixel_mm * params.plane_step_mm;
    let tube = &Vessel::new(Kind::Tube).tubes[0];
    let n = 1800;
    let dz = 18.0 / f64::from(n);
    let exact: f64 = (0..n).map(|i| PI * tube.radius_at(-1.5 + (f64::from(i) + 0.5) * dz).powi(2) * dz).sum();
    assert!((measured / exact - 1.0).abs() < 1e-3, "{measured} mm3 against {exact} mm3");
}

#[test]
fn half_way_intensity_lies_on_the_boundary_of_a_straight_part() {
    let params = Params { slab_mm: 0.0, ..small(Kind::Tube) };
    let volume = volume(&params, &Task::quiet());
    let vessel = Vessel::new(Kind::Tube);
    let centre = volume.voxel_from_stack(vessel.inner_point_at(3.0)).unwrap();
    let row: Vec<f64> = (centre[0]..volume.dims[0]).map(|i| f64::from(volume.at(i, centre[1], 1))).collect();
    let at = row.iter().position(|&v| v < 200.0).unwrap();
    let crossing = centre[0] as f64 + at as f64 - 1.0 + (row[at - 1] - 200.0) / (row[at - 1] - row[at]);
    let p = volume.stack_from_voxel(crossing, centre[1] as f64, 1);
    // A blurred disc crosses half way a little inside its edge: by about sigma^2 / (2 r).
    let expected = -params.psf_sigma_mm.powi(2) / (2.0 * vessel.tubes[0].radius_at(3.0));
    assert!((vessel.value(p) - expected).abs() < 0.01, "{} against {expected}", vessel.value(p));
}

#[test]
fn seeds_lie_in_the_lumen_of_a_plane() {
    for kind in Kind::ALL {
        let params = small(kind);
        let seed = default_seed(&params);
        assert!(Vessel::new(kind).value(seed) < -1.0);
        assert!(params.plane_z_mm().contains(&seed.z));
        let volume = volume(&params, &Task::quiet());
        let [i, j, k] = volume.voxel_from_stack(seed).unwrap();
        assert!((volume.at(i, j, k) - 350.0).abs() < 2.0, "{kind:?}");
    }
}

#[test]
fn dark_lumen_lies_in_a_brighter_wall() {
    let params = Params { polarity: Contrast::Dark, ..small(Kind::Tube) };
    let volume = volume(&params, &Task::quiet());
    let [i, j, k] = volume.voxel_from_stack(default_seed(&params)).unwrap();
    let along: Vec<f32> = (i..volume.dims[0]).map(|i| volume.at(i, j, k)).collect();
    assert!(along[0] < -940.0);
    assert!(along.iter().any(|&v| v > 30.0));
    assert!(along[along.len() - 1].abs() < 1.0);
}

#[test]
fn noise_has_its_spread_and_its_seed() {
    let params = Params { noise_hu: 20.0, n_planes: 2, ..Params::default() };
    let noisy = volume(&params, &Task::quiet());
    let clean = volume(&Params { noise_hu: 0.0, ..params.clone() }, &Task::quiet());
    let inside = |v: &&(f32, f32)| v.1 > -900.0;
    let pairs: Vec<(f32, f32)> = noisy.hu.iter().zip(clean.hu.iter()).collect();
    let differences: Vec<f64> = pairs.iter().filter(inside).map(|(a, b)| f64::from(a - b)).collect();
    let n = differences.len() as f64;
    let mean = differences.iter().sum::<f64>() / n;
    let deviation = (differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / n).sqrt();
    assert!(mean.abs() < 0.2 && (deviation - 20.0).abs() < 0.2, "{mean} {deviation}");
    assert_eq!(noisy, volume(&params, &Task::quiet()));
    assert_ne!(noisy, volume(&Params { seed: 2, ..params }, &Task::quiet()));
}

#[test]
fn one_thread_gives_the_same_bytes() {
    let params = Params { n_planes: 8, n_pixels: 128, ..Params::default() };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let single = pool.install(|| volume(&params, &Task::quiet()));
    assert_eq!(single, volume(&params, &Task::quiet()));
}

#[test]
fn air_surrounds_the_body_in_the_full_image() {
    let volume = volume(&Params { n_planes: 1, noise_hu: 0.0, ..Params::default() }, &Task::quiet());
    for (i, j) in [(0, 0), (511, 0), (0, 511), (511, 511), (0, 256), (256, 0)] {
        assert!((volume.at(i, j, 0) + 1000.0).abs() < 0.5);
    }
    assert!((volume.at(100, 256, 0) - 50.0).abs() < 0.5);
}

#[test]
fn every_field_is_checked() {
    let bad = [
        Params { noise_hu: f64::NAN, ..Params::default() },
        Params { n_planes: 0, ..Params::default() },
        Params { first_plane_z_mm: f64::INFINITY, ..Params::default() },
        Params { plane_step_mm: 0.0, ..Params::default() },
        Params { slab_mm: -1.0, ..Params::default() },
        Params { pixel_mm: 0.0, ..Params::default() },
        Params { n_pixels: 100_000, ..Params::default() },
        Params { psf_sigma_mm: 9.0, ..Params::default() },
        Params { wall_mm: -0.1, ..Params::default() },
    ];
    for params in bad {
        assert!(matches!(try_volume(&params, &Task::quiet()), Err(Error::OutOfRange { .. })), "{params:?}");
    }
    let text = Params { n_planes: 0, ..Params::default() }.check().unwrap_err().to_string();
    assert_eq!(text, "phantom parameter n_planes is 0: choose a value from 1 to 2000");
}

#[test]
fn cancelled_work_stops() {
    let cancel = CancelToken::default();
    cancel.cancel();
    let result = try_volume(&Params::default(), &Task::new(&|_, _| {}, cancel));
    assert!(matches!(result, Err(Error::Cancelled(_))));
}

#[test]
fn names_of_kinds_are_read_back() {
    assert!(Kind::ALL.into_iter().all(|k| k.name().parse::<Kind>().unwrap() == k));
    assert!(matches!("aorta".parse::<Kind>(), Err(Error::UnknownKind(_))));
}

#[test]
fn more_voxels_than_memory_should_hold_are_refused_before_any_is_made() {
    let params = Params { n_pixels: 2048, n_planes: 2000, ..Params::default() };
    let refused = params.check().unwrap_err();
    assert!(matches!(refused, Error::TooLarge { n_voxels: 8_388_608_000, .. }), "{refused}");
    assert!(Params { n_pixels: 512, n_planes: 2000, ..Params::default() }.check().is_ok());
}
