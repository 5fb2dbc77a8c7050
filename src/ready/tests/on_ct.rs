//! Contours brought onto a CT.

use super::*;

#[test]
fn planes_that_would_become_one_are_refused() {
    let aside = RigidTransform::translation(Vector3::y() * 2.0);
    let contours = [(&RigidTransform::identity(), 2.0), (&RigidTransform::identity(), 3.98), (&aside, 4.02)];
    let drawn = rtstruct(contours.map(|(at, z)| circle(at, 5.0, z)).to_vec()).load(None).unwrap().drawn;
    let twice = place::onto(&ct(RigidTransform::identity()), drawn, &mut Vec::new());
    assert_eq!(
        twice.unwrap_err().to_string(),
        "two planes of the segmentation lie at z = 4.000 mm of the CT: export it with one for each plane of the CT, or leave --ct out"
    );
}

#[test]
fn what_holds_no_contour_lies_nowhere() {
    let line = vec![Point3::origin(), Point3::new(5.0, 0.0, 0.0), Point3::new(10.0, 0.0, 0.0)];
    let told = rtstruct(vec![line]).error(None);
    assert_eq!(told, "FILE: its contours enclose nothing: export the structure again");
    let mut empty = drawn_at(&[2.0, 4.0]);
    empty.planes.iter_mut().for_each(|p| p.contours.clear());
    let on = place::onto(&ct(RigidTransform::identity()), empty, &mut Vec::new()).unwrap();
    assert!(on.planes.iter().all(|p| p.contours.is_empty()));
}

fn ct(patient_from_stack: RigidTransform) -> Volume {
    Volume {
        dims: [40, 40, 5],
        hu: Voxels::new(&[0.0; 40 * 40 * 5], 40 * 40),
        origin_xy_mm: [-7.0, -14.0],
        pixel_spacing_xy_mm: [0.5, 0.5],
        plane_z_mm: vec![0.0, 2.0, 4.0, 6.0, 8.0],
        slab_thickness_mm: 2.0,
        patient_from_stack,
    }
}

fn drawn_at(heights: &[f64]) -> DrawnStack {
    let contours = heights.iter().map(|&z| circle(&RigidTransform::identity(), 5.0, z)).collect();
    rtstruct(contours).load(None).unwrap().drawn
}

#[test]
fn contours_off_the_planes_of_the_ct_are_refused_and_those_on_them_take_their_height() {
    let mut warnings = Vec::new();
    let on =
        place::onto(&ct(RigidTransform::identity()), drawn_at(&[2.0, 4.01, 6.0]), &mut warnings).unwrap();
    assert_eq!(on.planes.iter().map(|p| p.z_mm).collect::<Vec<_>>(), [2.0, 4.0, 6.0]);
    let off = place::onto(&ct(RigidTransform::identity()), drawn_at(&[2.0, 5.0]), &mut warnings).unwrap_err();
    assert_eq!(
        off.to_string(),
        "a contour lies at z = 5.000 mm, 1.000 mm off the nearest plane of the CT: choose the CT it was drawn on, or leave --ct out"
    );
    let far = place::onto(
        &ct(RigidTransform::translation(Vector3::x() * 100.0)),
        drawn_at(&[2.0, 4.0]),
        &mut warnings,
    );
    assert!(matches!(far.unwrap_err(), Error::Elsewhere { .. }));
}

#[test]
fn a_ct_that_is_turned_over_turns_the_contours_with_it() {
    // Its z runs down the patient, its x and y are exchanged.
    let upside_down =
        RigidTransform::from_axes(Point3::new(0.0, 0.0, 8.0), Vector3::y(), Vector3::x(), -Vector3::z());
    let volume = Volume { origin_xy_mm: [-14.0, -7.0], ..ct(upside_down) };
    let on = place::onto(&volume, drawn_at(&[2.0, 4.0]), &mut Vec::new()).unwrap();
    assert_eq!(on.planes.iter().map(|p| p.z_mm).collect::<Vec<_>>(), [4.0, 6.0]);
    let contour = &on.planes[0].contours[0];
    assert!(contour.is_ccw() && (contour.centroid() - crate::geom::Point2::new(-4.0, 3.0)).norm() < 1e-4);
    let tilted = RigidTransform::from_axes(Point3::origin(), Vector3::y(), Vector3::z(), Vector3::x());
    let text = place::onto(&ct(tilted), drawn_at(&[2.0]), &mut Vec::new()).unwrap_err().to_string();
    assert!(text.contains("inclined by 90.00 degrees"), "{text}");
}

/// A CT whose planes lie at these heights.
fn ct_of(plane_z_mm: &[f64]) -> Volume {
    let n = plane_z_mm.len();
    Volume {
        dims: [40, 40, n],
        hu: Voxels::new(&vec![0.0; 40 * 40 * n], 40 * 40),
        plane_z_mm: plane_z_mm.to_vec(),
        ..ct(RigidTransform::identity())
    }
}

/// Heights of the planes of a segmentation on a CT once its gaps are dealt with, and what is told of them.
fn on_uneven(
    planes_mm: &[f64],
    drawn_mm: &[f64],
    absent: Absent,
    allow_gaps: bool,
) -> Result<(Vec<f64>, Vec<String>), String> {
    let (ct, mut warnings) = (ct_of(planes_mm), Vec::new());
    let on = place::onto(&ct, drawn_at(drawn_mm), &mut warnings).unwrap();
    let done = gaps::resolve(on, absent, Some(&ct), allow_gaps, &mut warnings).map_err(|e| e.to_string())?;
    let told = warnings.into_iter().map(|w| w.text).collect();
    Ok((done.planes.iter().map(|p| p.z_mm).collect(), told))
}

/// Fine planes below, coarse ones above.
const UNEVEN: [f64; 9] = [0.0, 1.0, 2.0, 3.0, 4.0, 9.0, 14.0, 19.0, 24.0];

#[test]
fn a_ct_of_uneven_planes_has_no_gap_where_it_has_no_plane() {
    let mut coarse_below: Vec<f64> = UNEVEN.iter().rev().map(|z| 24.0 - z).collect();
    for planes in [UNEVEN.to_vec(), coarse_below.clone()] {
        for absent in [Absent::Undrawn, Absent::Empty, Absent::Never] {
            assert_eq!(on_uneven(&planes, &planes, absent, false).unwrap(), (planes.clone(), vec![]));
        }
    }
    // Where its planes are usually far apart, a fine one that lacks its contour is a gap all the same.
    coarse_below.extend([25.0, 26.0, 31.0, 36.0]);
    let lacking: Vec<f64> = coarse_below.iter().copied().filter(|&z| z != 22.0).collect();
    assert_eq!(
        on_uneven(&coarse_below, &lacking, Absent::Undrawn, false).unwrap_err(),
        "the structure has no contour between z = 21.000 and 23.000 mm (1 plane): draw it there, or have it led across with --allow-gaps"
    );
}

#[test]
fn planes_of_an_uneven_ct_that_a_segmentation_lacks_are_counted_by_planes() {
    let drawn = [0.0, 1.0, 4.0, 9.0, 24.0];
    let places = "between z = 1.000 and 4.000 mm (2 planes), between z = 9.000 and 24.000 mm (2 planes)";
    assert_eq!(
        on_uneven(&UNEVEN, &drawn, Absent::Undrawn, false).unwrap_err(),
        format!(
            "the structure has no contour {places}: draw it there, or have it led across with --allow-gaps"
        )
    );
    let led = format!("the segmentation has no plane {places}: the vessel is led across");
    assert_eq!(
        on_uneven(&UNEVEN, &drawn, Absent::Undrawn, true).unwrap(),
        (drawn.to_vec(), vec![led.clone()])
    );
    // A label map has a plane wherever its grid has one.
    assert_eq!(on_uneven(&UNEVEN, &drawn, Absent::Never, false).unwrap(), (drawn.to_vec(), vec![led]));
    let (z, told) = on_uneven(&UNEVEN, &drawn, Absent::Empty, false).unwrap();
    assert_eq!(z, UNEVEN);
    assert!(told.len() == 1 && told[0].contains(places), "{told:?}");
}

#[test]
fn a_seg_of_every_second_plane_is_coarser_and_not_interrupted() {
    let planes: Vec<f64> = (0..14).map(f64::from).collect();
    let every_second: Vec<f64> = (0..7).map(|n| f64::from(2 * n)).collect();
    let (z, told) = on_uneven(&planes, &every_second, Absent::Empty, false).unwrap();
    assert_eq!(z, every_second);
    assert_eq!(
        told,
        ["the segmentation has one plane for every 2 of the CT: the vessel is led across the others"]
    );
    // Of such planes the missing ones are empty.
    let (z, told) = on_uneven(&planes, &[0.0, 2.0, 4.0, 10.0, 12.0], Absent::Empty, false).unwrap();
    assert_eq!(z, every_second);
    assert!(told[1].contains("between z = 4.000 and 10.000 mm (2 planes)"), "{told:?}");
}
