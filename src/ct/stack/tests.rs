use super::super::series::tests::header;
use super::super::traits::{Trait, Traits};
use super::*;

fn series(heights: &[f64]) -> Series {
    let images = heights.iter().enumerate().map(|(i, &z)| header(&format!("im{i}"), z)).collect();
    Series {
        images,
        odd: Vec::new(),
        n_across: 0,
        n_other_kind: 0,
        distinction: String::new(),
        key: Vec::new(),
    }
}

fn codes(stack: &Stack) -> Vec<&str> {
    stack.warnings.iter().map(|w| w.code.as_str()).collect()
}

#[test]
fn planes_are_sorted_by_position() {
    let stack = arrange(&series(&[6.0, 0.0, 3.0]), false).unwrap();
    assert_eq!((stack.images, stack.plane_z_mm), (vec![1, 2, 0], vec![0.0, 3.0, 6.0]));
    assert_eq!((stack.origin_xy_mm, stack.slab_thickness_mm), ([-10.0, 20.0], 2.0));
    assert!(stack.patient_from_stack.is_identity() && stack.warnings.is_empty());
}

#[test]
fn a_gap_is_located_and_may_be_allowed() {
    let gapped = series(&[0.0, 3.0, 6.0, 15.0, 18.0, 21.0]);
    let error = arrange(&gapped, false).unwrap_err();
    let Error::MissingPlanes { below_mm, above_mm, n_missing, n_gaps, .. } = error else { panic!("{error}") };
    assert_eq!((below_mm, above_mm, n_missing, n_gaps), (6.0, 15.0, 2, 1));
    assert_eq!(codes(&arrange(&gapped, true).unwrap()), ["ct.missing_planes"]);
}

#[test]
fn uneven_steps_are_used_with_a_warning() {
    let stack = arrange(&series(&[0.0, 3.0, 6.4, 9.0]), false).unwrap();
    assert_eq!(codes(&stack), ["ct.irregular_spacing"]);
    let mut rounded_to_tenths = series(&[0.0, 0.6, 1.2, 1.9, 2.5]);
    rounded_to_tenths.images.iter_mut().for_each(|h| h.slab_thickness_mm = Some(0.6));
    assert!(arrange(&rounded_to_tenths, false).unwrap().warnings.is_empty());
}

#[test]
fn duplicates_are_set_aside() {
    let stack = arrange(&series(&[0.0, 3.0, 3.0, 6.0]), false).unwrap();
    assert_eq!(
        (stack.images.as_slice(), stack.duplicates.as_slice()),
        ([0, 1, 3].as_slice(), [(1, 2)].as_slice())
    );
    assert_eq!(codes(&stack), ["ct.duplicate_plane"]);
}

#[test]
fn images_turned_against_each_other_are_told_by_what_it_does_at_their_edges() {
    let turned = |angle: f64| {
        let mut series = series(&[0.0, 3.0, 6.0]);
        for header in &mut series.images {
            (header.shape.columns, header.shape.rows) = (513, 513);
        }
        let (sin, cos) = angle.sin_cos();
        series.images[1].shape.axes = [Vector3::new(cos, sin, 0.0), Vector3::new(-sin, cos, 0.0)];
        arrange(&series, false).unwrap().warnings
    };
    assert!(turned(1e-5).is_empty());
    // 512 columns of 0.5 mm and as many rows of 0.8 mm, off by half a thousandth each.
    let told = turned(5e-4);
    assert_eq!(told[0].code, "ct.turned");
    assert!(told[0].text.contains("by up to 0.333 mm at their far edges"), "{}", told[0].text);
}

#[test]
fn one_plane_is_no_volume() {
    assert!(matches!(arrange(&series(&[1.0]), false), Err(Error::TooFewPlanes(1))));
    assert!(matches!(arrange(&series(&[1.0, 1.0]), false), Err(Error::TooFewPlanes(1))));
}

#[test]
fn an_odd_image_is_named() {
    let mut odd = series(&[0.0, 3.0]);
    odd.odd.push(header("stray", 6.0));
    let text = arrange(&odd, false).unwrap_err().to_string();
    assert!(text.starts_with("stray: 4 x 3 pixels"), "{text}");
}

#[test]
fn a_gantry_tilt_is_undone() {
    let mut tilted = series(&[0.0, 3.0, 6.0, 9.0]);
    let angle = 10_f64.to_radians();
    for header in &mut tilted.images {
        header.shape.axes = [Vector3::x(), Vector3::new(0.0, angle.cos(), -angle.sin())];
    }
    let stack = arrange(&tilted, false).unwrap();
    assert_eq!(codes(&stack), ["ct.gantry_tilt"]);
    assert!((stack.tilt_deg.unwrap() - 10.0).abs() < 1e-9);
    // Planes 3 mm apart along the patient lie nearer along their normal, and 1.56 mm of rows are added.
    assert!(stack.plane_z_mm.windows(2).all(|w| (w[1] - w[0] - 3.0 * angle.cos()).abs() < 1e-9));
    assert_eq!((stack.size, stack.shifts.len()), ([4, 3 + 2], 4));
    // Pixel (0, 0) of the lowest plane, at row from[1] of the common grid, is where its header says.
    let first = series(&[0.0]).images[0].position;
    let [x, y] = stack.origin_xy_mm;
    let lowest = Point3::new(x, y, stack.plane_z_mm[0]);
    let offset = stack.patient_from_stack.inverse().apply(first) - lowest;
    assert!(offset.x.abs() < 1e-9 && offset.z.abs() < 1e-9, "{offset}");
    assert!((offset.y - 9.0 * angle.sin()).abs() < 1e-9, "{offset}");
    assert_eq!(stack.shifts[3], Shift::new([0.0, 0.0]), "the highest plane stays");
}

#[test]
fn a_shifted_plane_is_named() {
    let mut shifted = series(&[0.0, 3.0, 6.0, 9.0]);
    shifted.images[1].position.x += 0.2;
    let stack = arrange(&shifted, false).unwrap();
    assert_eq!((codes(&stack), stack.size, stack.tilt_deg), (vec!["ct.plane_offset"], [5, 3], None));
    shifted.images[1].position.x += 4.8;
    let error = arrange(&shifted, false).unwrap_err();
    assert!(
        matches!(&error, Error::ShiftedPlane { path, offset_mm }
        if path.ends_with("im1") && (offset_mm - 5.0).abs() < 1e-9),
        "{error}"
    );
}

#[test]
fn cosines_that_were_rounded_are_turned_onto_the_line_of_the_planes() {
    let mut rounded = series(&[0.0, 30.0, 60.0, 90.0, 120.0]);
    for header in &mut rounded.images {
        header.shape.axes = [Vector3::x(), Vector3::new(0.0, 1.0, 0.0015).normalize()];
    }
    let stack = arrange(&rounded, false).unwrap();
    assert!(stack.warnings.is_empty() && stack.shifts.is_empty() && stack.tilt_deg.is_none());
    let normal = stack.patient_from_stack.rotate(Vector3::z());
    assert!((normal - Vector3::z()).norm() < 1e-9, "{normal}");
}

#[test]
fn numbers_against_positions_are_told() {
    let mut numbered = series(&[0.0, 3.0, 6.0]);
    for (header, number) in numbered.images.iter_mut().zip([3, 2, 1]) {
        header.number = Some(number);
    }
    assert!(arrange(&numbered, false).unwrap().warnings.is_empty());
    numbered.images[0].number = Some(2);
    numbered.images[1].number = Some(3);
    let stack = arrange(&numbered, false).unwrap();
    assert_eq!((codes(&stack), stack.images.as_slice()), (vec!["ct.instance_order"], [0, 1, 2].as_slice()));
}

#[test]
fn doubtful_images_are_told() {
    let mut doubtful = series(&[0.0, 3.0, 6.0]);
    (doubtful.n_across, doubtful.n_other_kind) = (1, 2);
    for header in &mut doubtful.images {
        (header.axes_fault, header.is_inverted) = (0.005, true);
        header.traits = Traits::default();
        header.traits.0[Trait::ImageType as usize] = "DERIVED\\SECONDARY\\MPR".into();
    }
    let stack = arrange(&doubtful, false).unwrap();
    let expected = ["ct.rounded_axes", "ct.inverted", "ct.reformatted", "ct.localizer", "ct.other_kind"];
    assert_eq!(codes(&stack), expected);
}

#[test]
fn reversed_transaxial_images_are_turned_over() {
    let mut prone = series(&[0.0, 3.0]);
    for header in &mut prone.images {
        header.shape.axes = [-Vector3::x(), -Vector3::y()];
    }
    let stack = arrange(&prone, false).unwrap();
    assert!(stack.patient_from_stack.is_identity());
    assert_eq!((stack.reversed, stack.origin_xy_mm), ([true, true], [-11.5, 18.4]));
}

#[test]
fn an_oblique_stack_keeps_its_place_in_the_patient() {
    let mut oblique = series(&[0.0, 0.0, 0.0]);
    let (row, column) = (Vector3::y(), Vector3::new(0.6, 0.0, -0.8));
    let normal = row.cross(&column);
    for (i, header) in oblique.images.iter_mut().enumerate() {
        header.shape.axes = [row, column];
        header.position = Point3::new(1.0, 2.0, 3.0) - normal * (2.0 * i as f64);
    }
    let stack = arrange(&oblique, false).unwrap();
    assert_eq!(stack.images, [2, 1, 0]);
    let [x, y] = stack.origin_xy_mm;
    let back = stack.patient_from_stack.apply(Point3::new(x, y, stack.plane_z_mm[2]));
    assert!((back - Point3::new(1.0, 2.0, 3.0)).norm() < 1e-12);
}

#[test]
fn doubtful_headers_are_told() {
    let mut doubtful = series(&[0.0, 3.0, 6.0]);
    for header in &mut doubtful.images {
        header.rescale = None;
        header.slab_thickness_mm = None;
        header.spacing_between_mm = Some(1.5);
    }
    let stack = arrange(&doubtful, false).unwrap();
    assert_eq!(codes(&stack), ["ct.no_rescale", "ct.spacing_disagrees", "ct.no_thickness"]);
    assert_eq!(stack.slab_thickness_mm, 3.0);
    doubtful.images[0].modality = "MR".into();
    doubtful.images[0].slab_thickness_mm = Some(2.0);
    let stack = arrange(&doubtful, false).unwrap();
    assert_eq!(codes(&stack), ["ct.modality", "ct.spacing_disagrees", "ct.thickness_varies"]);
}
