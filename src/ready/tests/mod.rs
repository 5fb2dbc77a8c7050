//! Analytic shapes as DICOM SEG and RTSTRUCT, written here and read back.

mod objects;
mod on_ct;

use super::*;
use crate::ct::{Volume, Voxels};
use crate::geom::{Contour, Point3, RigidTransform, Vector3};
use crate::sections::ready::Drawn;
use dicom_core::value::{DataSetSequence, PrimitiveValue};
use dicom_core::{DataElement, Length, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject};
use objects::Seg;
use std::path::PathBuf;
use tempfile::TempDir;

fn put(object: &mut InMemDicomObject, tag: Tag, vr: VR, value: impl Into<PrimitiveValue>) {
    object.put(DataElement::new(tag, vr, value.into()));
}

fn sequence(tag: Tag, items: Vec<InMemDicomObject>) -> DataElement<InMemDicomObject> {
    DataElement::new(tag, VR::SQ, DataSetSequence::new(items, Length::UNDEFINED))
}

fn item(fill: impl FnOnce(&mut InMemDicomObject)) -> InMemDicomObject {
    let mut object = InMemDicomObject::new_empty();
    fill(&mut object);
    object
}

fn decimals(values: &[f64]) -> String {
    values.iter().map(|v| format!("{v:.9}")).collect::<Vec<_>>().join("\\")
}

struct Written {
    _place: TempDir,
    path: PathBuf,
}

fn write(mut object: InMemDicomObject, class: &str, syntax: &str) -> Written {
    put(&mut object, tags::SOP_CLASS_UID, VR::UI, class);
    put(&mut object, tags::SOP_INSTANCE_UID, VR::UI, "2.25.1");
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("made.dcm");
    let meta = FileMetaTableBuilder::new().transfer_syntax(syntax);
    object.with_meta(meta).unwrap().write_to_file(&path).unwrap();
    Written { _place: place, path }
}

impl Written {
    fn load(&self, label: Option<Label>) -> Result<Ready, Error> {
        load(&self.path, label.as_ref(), &Task::quiet())
    }

    fn error(&self, label: Option<Label>) -> String {
        let text = self.load(label).unwrap_err().to_string();
        text.replace(&self.path.display().to_string(), "FILE")
    }
}

// -- RTSTRUCT --

fn contour_item(points: &[Point3]) -> InMemDicomObject {
    let data: Vec<f64> = points.iter().flat_map(|p| [p.x, p.y, p.z]).collect();
    item(|s| {
        put(s, tags::CONTOUR_GEOMETRIC_TYPE, VR::CS, "CLOSED_PLANAR");
        put(s, tags::NUMBER_OF_CONTOUR_POINTS, VR::IS, points.len().to_string());
        put(s, tags::CONTOUR_DATA, VR::DS, decimals(&data));
    })
}

fn rtstruct(contours: Vec<Vec<Point3>>) -> Written {
    write(structure_set(contours), uids::RT_STRUCTURE_SET_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN)
}

fn structure_set(contours: Vec<Vec<Point3>>) -> InMemDicomObject {
    let mut object = InMemDicomObject::new_empty();
    let roi = item(|s| {
        put(s, tags::ROI_NUMBER, VR::IS, "5");
        put(s, tags::ROI_NAME, VR::LO, "Lumen");
    });
    object.put(sequence(tags::STRUCTURE_SET_ROI_SEQUENCE, vec![roi]));
    let own = item(|s| {
        put(s, tags::REFERENCED_ROI_NUMBER, VR::IS, "5");
        s.put(sequence(tags::CONTOUR_SEQUENCE, contours.iter().map(|c| contour_item(c)).collect()));
    });
    object.put(sequence(tags::ROI_CONTOUR_SEQUENCE, vec![own]));
    object
}

fn circle(frame: &RigidTransform, radius: f64, z: f64) -> Vec<Point3> {
    let at = |i: usize| {
        let a = std::f64::consts::TAU * i as f64 / 90.0;
        frame.apply(Point3::new(3.0 + radius * a.cos(), -4.0 + radius * a.sin(), z))
    };
    (0..90).map(at).collect()
}

fn area(plane: &Drawn) -> f64 {
    plane.contours.iter().map(Contour::signed_area_mm2).sum()
}

const POLYGON: f64 = 0.5 * 90.0; // Times r² sin(2 pi / 90): the area of the polygon.

fn polygon_area(radius: f64) -> f64 {
    POLYGON * radius * radius * (std::f64::consts::TAU / 90.0).sin()
}

#[test]
fn contours_within_others_and_keyholes_are_holes() {
    let flat = RigidTransform::identity();
    let keyhole = |z: f64| {
        let (outer, inner) = (circle(&flat, 6.0, z), circle(&flat, 2.0, z));
        let back = inner.iter().rev().copied();
        [outer.clone(), vec![outer[0], inner[0]], back.collect(), vec![outer[0]]].concat()
    };
    let nested = |z: f64| [circle(&flat, 6.0, z), circle(&flat, 2.0, z)];
    let contours = [nested(0.0).to_vec(), vec![keyhole(2.0)], nested(4.0).to_vec()].concat();
    let ready = rtstruct(contours).load(None).unwrap();
    assert_eq!((ready.number, ready.drawn.planes.len()), (5, 3));
    for plane in &ready.drawn.planes {
        assert_eq!(plane.contours.len(), 2, "z {}", plane.z_mm);
        assert!((area(plane) - polygon_area(6.0) + polygon_area(2.0)).abs() < 1e-3);
    }
}

#[test]
fn holes_that_rounding_moved_off_their_plane_are_holes_and_outlines_stay_outlines() {
    let flat = RigidTransform::identity();
    for off_mm in [-0.02, 0.02, 0.05] {
        let nested = |z: f64| [circle(&flat, 6.0, z), circle(&flat, 2.0, z + off_mm)];
        let drawn = rtstruct([0.0, 2.0, 4.0, 6.0].map(nested).concat()).load(None).unwrap().drawn;
        let z: Vec<f64> = drawn.planes.iter().map(|p| p.z_mm).collect();
        assert_eq!(z, [0.0, 2.0, 4.0, 6.0], "{off_mm}");
        for plane in &drawn.planes {
            assert!((area(plane) - polygon_area(6.0) + polygon_area(2.0)).abs() < 1e-3, "{off_mm}");
        }
    }
    let areas = |contours: Vec<Vec<Point3>>| {
        let drawn = rtstruct(contours).load(None).unwrap().drawn;
        drawn.planes.iter().map(area).collect::<Vec<f64>>()
    };
    // Planes that lie that near each other, a smaller outline far from the larger one's plane.
    let dense = (0..6).map(|k| circle(&flat, 5.0 - 0.1 * f64::from(k), 0.03 * f64::from(k))).collect();
    assert_eq!(areas(dense).len(), 6);
    let apart = areas(vec![circle(&flat, 5.0, 0.0), circle(&flat, 2.0, 0.2), circle(&flat, 5.0, 3.0)]);
    assert!(apart.len() == 3 && apart.iter().all(|a| *a > 0.0), "{apart:?}");
}

#[test]
fn contours_that_are_not_transaxial_use_their_own_normal() {
    let normal = Vector3::new(0.3, -0.9, 0.2).normalize();
    let row = normal.cross(&Vector3::z()).normalize();
    let tilted = RigidTransform::from_axes(Point3::new(5.0, 6.0, 7.0), row, normal.cross(&row), normal);
    let contours = (0..4).map(|k| circle(&tilted, 5.0, 2.0 * f64::from(k))).collect();
    let drawn = rtstruct(contours).load(None).unwrap().drawn;
    let own = drawn.patient_from_stack.rotate(Vector3::z());
    assert!(own.cross(&normal).norm() < 1e-6);
    for plane in &drawn.planes {
        assert!((area(plane) - polygon_area(5.0)).abs() < 1e-3);
        let middle = plane.contours[0].centroid();
        let place = tilted
            .inverse()
            .apply(drawn.patient_from_stack.apply(Point3::new(middle.x, middle.y, plane.z_mm)));
        assert!((place.xy() - Point3::new(3.0, -4.0, 0.0).xy()).norm() < 1e-4, "{place}");
    }
}

#[test]
fn faults_of_contours_are_named() {
    let flat = RigidTransform::identity();
    let good = || circle(&flat, 5.0, 0.0);
    let mut bent = good();
    bent[10].z += 1.0;
    let two = good()[..2].to_vec();
    let upright = circle(&flat, 3.0, 0.0).into_iter().map(|p| Point3::new(p.x, 0.0, p.y)).collect();
    for (contours, message) in [
        (
            vec![bent, circle(&flat, 40.0, 2.0), circle(&flat, 40.0, 4.0)],
            "FILE: a contour near z = 0.011 mm is 0.989 mm off its plane: export the structure again",
        ),
        (
            vec![two],
            "FILE: a closed contour has 2 points, expected three at least: export the structure again",
        ),
        (
            vec![good(), upright],
            "FILE: its contours lie in planes inclined by 90.00 degrees against each other: draw them on one stack of planes",
        ),
        (vec![], "FILE holds no structure: every voxel is 0, or there is no closed contour"),
    ] {
        assert_eq!(rtstruct(contours).error(None), message);
    }
}

/// An open contour, or a point, at a height.
fn open_item(kind: &str, z: f64) -> InMemDicomObject {
    let mut item = contour_item(&circle(&RigidTransform::identity(), 5.0, z)[..2]);
    put(&mut item, tags::CONTOUR_GEOMETRIC_TYPE, VR::CS, kind);
    item
}

fn told(ready: &Ready) -> Vec<String> {
    ready.warnings.iter().map(|w| format!("{}: {}", w.code, w.text)).collect()
}

#[test]
fn contours_that_are_not_closed_are_left_out_and_told() {
    let flat = RigidTransform::identity();
    let mut object = structure_set(Vec::new());
    let closed = [0.0, 2.0, 6.0].map(|z| contour_item(&circle(&flat, 5.0, z)));
    let open = [open_item("OPEN_PLANAR", 4.0), open_item("POINT", 3.0)];
    let own = item(|s| {
        put(s, tags::REFERENCED_ROI_NUMBER, VR::IS, "5");
        s.put(sequence(tags::CONTOUR_SEQUENCE, closed.into_iter().chain(open).collect()));
    });
    object.put(sequence(tags::ROI_CONTOUR_SEQUENCE, vec![own]));
    let ready =
        write(object, uids::RT_STRUCTURE_SET_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN).load(None).unwrap();
    assert_eq!(
        told(&ready),
        [
            "ready.open_contours: 2 contour(s) of the structure are open, or points, and were left out at z = 3.000, 4.000 mm: close them where the structure was drawn"
        ]
    );
    assert_eq!((ready.drawn.planes.len(), ready.absent), (3, Absent::Undrawn));
}

#[test]
fn contours_that_are_stored_twice_count_once() {
    let flat = RigidTransform::identity();
    let mut turned = circle(&flat, 5.0, 2.0);
    turned.reverse();
    turned.rotate_left(17);
    let twice = [0.0, 2.0, 4.0].map(|z| circle(&flat, 5.0, z)).into_iter();
    let all: Vec<Vec<Point3>> =
        twice.chain([circle(&flat, 5.0, 0.0), turned, circle(&flat, 5.0, 4.0)]).collect();
    let told_of_all = "ready.doubled_contours: 3 contour(s) of the structure are stored twice at z = 0.000, 2.000, 4.000 mm: each was taken once";
    let ready = rtstruct(all.clone()).load(None).unwrap();
    assert_eq!(told(&ready), [told_of_all]);
    assert!(ready.drawn.planes.iter().all(|p| (area(p) - polygon_area(5.0)).abs() < 1e-3));
    // The same in two items of one structure's number.
    let mut object = structure_set(Vec::new());
    let part = |contours: &[Vec<Point3>]| {
        item(|s| {
            put(s, tags::REFERENCED_ROI_NUMBER, VR::IS, "5");
            s.put(sequence(tags::CONTOUR_SEQUENCE, contours.iter().map(|c| contour_item(c)).collect()));
        })
    };
    object.put(sequence(tags::ROI_CONTOUR_SEQUENCE, vec![part(&all[..3]), part(&all[3..])]));
    let written = write(object, uids::RT_STRUCTURE_SET_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN);
    for label in [None, Some(Label::Number(5))] {
        assert_eq!(told(&written.load(label).unwrap()), [told_of_all]);
    }
}

/// A contour as it is written with few decimals, from another point on and the other way round.
fn rewritten(contour: &[Point3], decimals: i32) -> Vec<Point3> {
    let unit = 10_f64.powi(decimals);
    let rounded = |v: f64| (v * unit).round() / unit;
    let mut points: Vec<Point3> =
        contour.iter().map(|p| Point3::new(rounded(p.x), rounded(p.y), p.z)).collect();
    points.reverse();
    points.rotate_left(31);
    points
}

#[test]
fn copies_that_differ_by_rounding_are_told_as_doubled_and_count_once() {
    let aside = RigidTransform::translation(Vector3::new(0.037, 0.041, 0.0));
    for (radius, decimals) in [(1.0, 2), (2.0, 1), (2.0, 2), (5.0, 1), (5.0, 2), (40.0, 1), (40.0, 3)] {
        let drawn = [0.0, 3.0, 6.0].map(|z| circle(&aside, radius, z));
        let all = drawn.iter().cloned().chain(drawn.iter().map(|c| rewritten(c, decimals))).collect();
        let ready = rtstruct(all).load(None).unwrap();
        assert_eq!(
            told(&ready),
            [
                "ready.doubled_contours: 3 contour(s) of the structure are stored twice at z = 0.000, 3.000, 6.000 mm: each was taken once"
            ],
            "radius {radius}, {decimals} decimals"
        );
        for plane in &ready.drawn.planes {
            assert!((area(plane) - polygon_area(radius)).abs() < 1e-3, "{}", area(plane));
        }
    }
}

#[test]
fn copies_whose_height_is_rounded_too_are_of_one_plane() {
    let flat = RigidTransform::identity();
    let nested = |z: f64| [circle(&flat, 5.0, z), circle(&flat, 2.0, z)];
    let once = [0.0, 3.0, 6.0].map(nested).concat();
    let again = [0.02, 6.04].map(|z| nested(z).map(|c| rewritten(&c, 1))).concat();
    let ready = rtstruct([once, again].concat()).load(None).unwrap();
    assert_eq!(ready.drawn.planes.iter().map(|p| p.z_mm).collect::<Vec<_>>(), [0.0, 3.0, 6.0]);
    assert!(told(&ready)[0].starts_with("ready.doubled_contours: 4 contour(s)"), "{:?}", told(&ready));
    let ring = polygon_area(5.0) - polygon_area(2.0);
    assert!(ready.drawn.planes.iter().all(|p| (area(p) - ring).abs() < 1e-3));
}

#[test]
fn a_large_contour_that_is_drawn_again_a_little_beside_itself_crosses_it() {
    let flat = RigidTransform::identity();
    let aside = RigidTransform::translation(Vector3::new(0.3, 0.0, 0.0));
    let contours = [0.0, 3.0].map(|z| [circle(&flat, 50.0, z), circle(&aside, 50.0, z)]).concat();
    let told = told(&rtstruct(contours).load(None).unwrap());
    assert!(told.len() == 1 && told[0].starts_with("ready.crossing_contours: "), "{told:?}");
    // What touches another one within rounding does not.
    let beside = RigidTransform::translation(Vector3::new(6.99, 0.0, 0.0));
    let touching = [0.0, 3.0].map(|z| [circle(&flat, 5.0, z), circle(&beside, 2.0, z)]).concat();
    assert!(rtstruct(touching).load(None).unwrap().warnings.is_empty());
}

#[test]
fn contours_that_cross_are_told() {
    let flat = RigidTransform::identity();
    let aside = RigidTransform::translation(Vector3::new(6.0, 0.0, 0.0));
    let crossing = vec![
        circle(&flat, 5.0, 0.0),
        circle(&aside, 5.0, 0.0),
        circle(&flat, 5.0, 2.0),
        circle(&flat, 2.0, 2.0),
    ];
    assert_eq!(
        told(&rtstruct(crossing).load(None).unwrap()),
        [
            "ready.crossing_contours: contours of the structure cross at z = 0.000 mm: what lies in two of them is outside (even-odd rule); look at the contours before they are used"
        ]
    );
}

#[test]
fn what_stands_in_the_attributes_of_a_structure_is_not_quoted() {
    const WORDS: [&str; 3] = ["DOE^JANE", "19330717", "Doe"];
    let flat = RigidTransform::identity();
    let with = |tag: Tag, vr: VR, value: &str| {
        let mut contour = contour_item(&circle(&flat, 5.0, 0.0));
        put(&mut contour, tag, vr, value);
        let mut object = structure_set(Vec::new());
        let own = item(|s| {
            put(s, tags::REFERENCED_ROI_NUMBER, VR::IS, "5");
            s.put(sequence(tags::CONTOUR_SEQUENCE, vec![contour]));
        });
        object.put(sequence(tags::ROI_CONTOUR_SEQUENCE, vec![own]));
        write(object, uids::RT_STRUCTURE_SET_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN)
    };
    let of_seg = |tag: Tag, vr: VR, value: &str| {
        let mut object = Seg::default().object();
        put(&mut object, tag, vr, value);
        write(object, uids::SEGMENTATION_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN)
    };
    for value in &WORDS[..2] {
        for (tag, vr) in [
            (tags::CONTOUR_GEOMETRIC_TYPE, VR::CS),
            (tags::NUMBER_OF_CONTOUR_POINTS, VR::IS),
            (tags::CONTOUR_DATA, VR::DS),
        ] {
            let said = with(tag, vr, value).load(None).map(|r| format!("{:?}", r.warnings));
            let said = said.unwrap_or_else(|e| e.text_without_path());
            assert!(WORDS.iter().all(|w| !said.contains(w)), "{tag}: {said}");
        }
        for (tag, vr) in [
            (tags::SEGMENTATION_TYPE, VR::CS),
            (tags::NUMBER_OF_FRAMES, VR::IS),
            (tags::ROWS, VR::IS),
            (tags::COLUMNS, VR::IS),
            (tags::BITS_ALLOCATED, VR::IS),
            (tags::MAXIMUM_FRACTIONAL_VALUE, VR::IS),
        ] {
            let said =
                of_seg(tag, vr, value).load(Some(Label::Number(1))).map(|r| format!("{:?}", r.warnings));
            let said = said.unwrap_or_else(|e| e.text_without_path());
            assert!(WORDS.iter().all(|w| !said.contains(w)), "{tag}: {said}");
        }
    }
}

// -- names, frames, labels --

#[test]
fn names_of_structures_are_for_the_operators_eyes_alone() {
    let seg = write(Seg::default().object(), uids::SEGMENTATION_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN);
    for label in [None, Some(Label::Number(7))] {
        let told = seg.load(label).unwrap_err();
        assert!(told.to_string().contains("Jane Doe") && told.to_string().contains("Vein"));
        let sent = told.text_without_path();
        assert!(!sent.contains("Doe") && !sent.contains("Vein"), "{sent}");
        assert!(!sent.contains(seg.path.to_str().unwrap()) && sent.contains("1 ("), "{sent}");
    }
}

/// A UID that leads to a patient.
const FRAME_UID: &str = "1.2.826.0.1.77.4711";

#[test]
fn the_frame_of_reference_is_read_and_never_shown() {
    let mut object = Seg::default().object();
    put(&mut object, tags::FRAME_OF_REFERENCE_UID, VR::UI, FRAME_UID);
    let seg = write(object, uids::SEGMENTATION_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN);
    let ready = seg.load(Some(Label::Number(1))).unwrap();
    assert_eq!(ready.reference, Reference::Frame(FrameOfReference::new(FRAME_UID)));
    assert!(!format!("{ready:?}").contains("4711"));
}

#[test]
fn a_structures_own_frame_goes_before_that_of_its_set() {
    let frame = |change: &dyn Fn(&mut InMemDicomObject)| {
        let mut object = structure_set(vec![circle(&RigidTransform::identity(), 5.0, 0.0)]);
        change(&mut object);
        let written = write(object, uids::RT_STRUCTURE_SET_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN);
        match written.load(None).unwrap().reference {
            Reference::Frame(frame) => frame,
            Reference::Grid(_) => panic!("a DICOM object has a frame"),
        }
    };
    let of_set = |o: &mut InMemDicomObject| {
        let own = item(|s| put(s, tags::FRAME_OF_REFERENCE_UID, VR::UI, "1.2.3"));
        o.put(sequence(tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE, vec![own]));
    };
    let own = |o: &mut InMemDicomObject| {
        let roi = item(|s| {
            put(s, tags::ROI_NUMBER, VR::IS, "5");
            put(s, tags::REFERENCED_FRAME_OF_REFERENCE_UID, VR::UI, FRAME_UID);
        });
        o.put(sequence(tags::STRUCTURE_SET_ROI_SEQUENCE, vec![roi]));
    };
    assert!(!frame(&|_| ()).is_known());
    assert_eq!(frame(&of_set), FrameOfReference::new("1.2.3"));
    assert_eq!(frame(&|o| [of_set(o), own(o)].into_iter().for_each(drop)), FrameOfReference::new(FRAME_UID));
}

#[test]
fn another_frame_of_reference_is_refused_and_an_unknown_one_told() {
    let check = |ct: &str, own: &str| {
        let mut warnings = Vec::new();
        let checked =
            place::check_frame(&FrameOfReference::new(ct), &FrameOfReference::new(own), &mut warnings);
        checked.map(|()| warnings.into_iter().map(|w| w.text).collect::<Vec<_>>())
    };
    assert_eq!(check(FRAME_UID, &format!("{FRAME_UID}\0")).unwrap(), [""; 0]);
    let told = check(FRAME_UID, "1.2.3").unwrap_err().to_string();
    assert!(
        told.starts_with("the segmentation's FrameOfReferenceUID is not the CT's") && !told.contains("4711")
    );
    for (ct, own, start) in [
        (FRAME_UID, "", "the segmentation does not state"),
        ("", FRAME_UID, "the CT does not state"),
        ("", "", "neither the CT nor the segmentation states"),
    ] {
        assert!(check(ct, own).unwrap()[0].starts_with(start));
    }
}

#[test]
fn axes_of_few_decimals_are_made_orthonormal_and_others_refused_with_their_fault() {
    let with = |row: Vector3, column: Vector3| {
        let object = Seg { row, column, ..Seg::default() }.object();
        write(object, uids::SEGMENTATION_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN)
    };
    // Of two decimals: farther than 1e-3 from orthonormal, within what a CT may be.
    let two_decimals = with(Vector3::new(0.71, 0.71, 0.0), Vector3::new(-0.71, 0.71, 0.0));
    assert_eq!(two_decimals.load(Some(Label::Number(1))).unwrap().drawn.planes.len(), 4);
    assert_eq!(
        with(Vector3::x(), Vector3::new(0.05, 1.0, 0.0)).error(Some(Label::Number(1))),
        "FILE: attribute ImageOrientationPatient is 0.0500 off two orthogonal unit vectors, expected 0.01 at most: export the segmentation again"
    );
}

#[test]
fn an_image_is_no_label_map() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("image.nrrd");
    let load = |n_values: u16| {
        let header =
            "NRRD0004\ntype: uint16\nsizes: 10 20 10\nspacings: 1 1 1\nendian: little\nencoding: raw\n\n";
        let values = (0..2000).flat_map(|v: u16| (v % n_values).to_le_bytes());
        std::fs::write(&path, header.bytes().chain(values).collect::<Vec<u8>>()).unwrap();
        load(&path, None, &Task::quiet()).unwrap_err()
    };
    assert!(matches!(load(1001), Error::SeveralLabels { found, .. } if found.len() == 1000));
    let told = load(1002).text_without_path();
    assert_eq!(
        told,
        "the segmentation holds more than 1000 different values: a label map is needed, not an image: export the segmentation as labels"
    );
    assert!(matches!(load(1), Error::Nothing(_)));
}

#[test]
fn a_file_of_another_kind_is_refused() {
    let other = write(InMemDicomObject::new_empty(), uids::CT_IMAGE_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN);
    let text = other.error(None);
    assert_eq!(
        text,
        "FILE is no segmentation: expected a label map (NIfTI, MetaImage, NRRD), a DICOM SEG or an RTSTRUCT"
    );
}

/// Elements of unknown tag and undefined length are sequences, whose bytes may claim anything.
#[test]
fn a_huge_length_within_an_unknown_element_is_not_believed() {
    for class in [uids::SEGMENTATION_STORAGE, uids::RT_STRUCTURE_SET_STORAGE] {
        let written = write(InMemDicomObject::new_empty(), class, uids::IMPLICIT_VR_LITTLE_ENDIAN);
        let mut bytes = std::fs::read(&written.path).unwrap();
        // An item of wrong length, then an element of almost 4 GB.
        bytes.extend(
            b"\x06\x20\x39\x00\xff\xff\xff\xff\xfe\xff\x00\xe0\xff\xff\xab\xff\xff\x06\x30\x40\0\xff\xff\xfe",
        );
        std::fs::write(&written.path, bytes).unwrap();
        let said = written.error(None);
        assert!(said.contains("an element runs beyond the end of the file"), "{said}");
    }
}
