//! Contours brought onto a CT.

use super::*;

#[test]
fn planes_that_would_become_one_are_refused() {
    let twice = place::onto(&ct(RigidTransform::identity()), drawn_at(&[2.0, 3.98, 4.02]), &mut Vec::new());
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
