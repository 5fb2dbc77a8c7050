//! Analytic shapes as DICOM SEG and RTSTRUCT, written here and read back.

use super::*;
use crate::ct::{Volume, Voxels};
use crate::geom::{Contour, Point3, RigidTransform, Vector3};
use crate::sections::ready::Drawn;
use dicom_core::value::{DataSetSequence, PrimitiveValue};
use dicom_core::{DataElement, Length, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject};
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

// -- SEG --

const SIDE: usize = 21; // Not a multiple of 8: frames do not begin at bytes.

/// Whether a pixel of plane k is inside segment n: disks of different radii.
fn in_disk(n: u32, i: usize, j: usize, k: usize) -> bool {
    let (x, y) = if n == 1 { (9.3, 10.1 + 0.2 * k as f64) } else { (15.0, 4.0) };
    (i as f64 - x).hypot(j as f64 - y) < if n == 1 { 6.2 } else { 2.5 }
}

struct Seg {
    is_fractional: bool,
    row: Vector3,
    column: Vector3,
    order: [usize; 4],
}

impl Default for Seg {
    fn default() -> Self {
        let order = [2, 0, 3, 1];
        Self { is_fractional: false, row: Vector3::x(), column: Vector3::y(), order }
    }
}

impl Seg {
    /// Two segments in four planes, 3 mm apart, frames in an order of their own.
    fn object(&self) -> InMemDicomObject {
        let mut object = InMemDicomObject::new_empty();
        let side = u16::try_from(SIDE).unwrap();
        put(&mut object, tags::ROWS, VR::US, side);
        put(&mut object, tags::COLUMNS, VR::US, side);
        put(&mut object, tags::NUMBER_OF_FRAMES, VR::IS, "8");
        put(&mut object, tags::BITS_ALLOCATED, VR::US, if self.is_fractional { 8_u16 } else { 1 });
        put(
            &mut object,
            tags::SEGMENTATION_TYPE,
            VR::CS,
            if self.is_fractional { "FRACTIONAL" } else { "BINARY" },
        );
        put(&mut object, tags::MAXIMUM_FRACTIONAL_VALUE, VR::US, 200_u16);
        let segment = |n: u16, name: &'static str| {
            item(|s| {
                put(s, tags::SEGMENT_NUMBER, VR::US, n);
                put(s, tags::SEGMENT_LABEL, VR::LO, name);
            })
        };
        object
            .put(sequence(tags::SEGMENT_SEQUENCE, vec![segment(1, "Lumen of Jane Doe"), segment(2, "Vein")]));
        let spacing = item(|s| put(s, tags::PIXEL_SPACING, VR::DS, "0.75\\0.5"));
        let orientation: Vec<f64> = self.row.iter().chain(self.column.iter()).copied().collect();
        let orientation = item(|s| put(s, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, decimals(&orientation)));
        let shared = item(|s| {
            s.put(sequence(tags::PIXEL_MEASURES_SEQUENCE, vec![spacing]));
            s.put(sequence(tags::PLANE_ORIENTATION_SEQUENCE, vec![orientation]));
        });
        object.put(sequence(tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, vec![shared]));
        object.put(sequence(
            tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE,
            self.frames().map(|(n, k)| self.frame(n, k)).collect(),
        ));
        let values = self.pixels();
        if self.is_fractional {
            put(&mut object, tags::PIXEL_DATA, VR::OB, PrimitiveValue::from(values));
        } else {
            put(&mut object, tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(words(&values).into()));
        }
        object
    }

    fn frames(&self) -> impl Iterator<Item = (u32, usize)> + '_ {
        [1, 2].into_iter().flat_map(|n| self.order.iter().map(move |&k| (n, k)))
    }

    fn frame(&self, n: u32, k: usize) -> InMemDicomObject {
        let position = Vector3::new(-10.0, 20.0, 5.0) + self.row.cross(&self.column) * (3.0 * k as f64);
        let position: Vec<f64> = position.iter().copied().collect();
        let position = item(|s| put(s, tags::IMAGE_POSITION_PATIENT, VR::DS, decimals(&position)));
        let segment = item(|s| put(s, tags::REFERENCED_SEGMENT_NUMBER, VR::US, u16::try_from(n).unwrap()));
        item(|s| {
            s.put(sequence(tags::PLANE_POSITION_SEQUENCE, vec![position]));
            s.put(sequence(tags::SEGMENT_IDENTIFICATION_SEQUENCE, vec![segment]));
        })
    }

    fn pixels(&self) -> Vec<u8> {
        let inside =
            self.frames().flat_map(|(n, k)| (0..SIDE * SIDE).map(move |p| in_disk(n, p % SIDE, p / SIDE, k)));
        if self.is_fractional {
            return inside.map(|v| if v { 100 } else { 99 }).collect();
        }
        let bits: Vec<bool> = inside.collect();
        bits.chunks(8).map(|c| c.iter().enumerate().map(|(b, &v)| u8::from(v) << b).sum()).collect()
    }
}

fn words(bytes: &[u8]) -> Vec<u16> {
    bytes.chunks(2).map(|c| u16::from_le_bytes([c[0], c.get(1).copied().unwrap_or(0)])).collect()
}

/// Contours of segment 1 as they should be.
fn expected(drawn: &DrawnStack) {
    assert_eq!(drawn.planes.len(), 4);
    for (k, plane) in drawn.planes.iter().enumerate() {
        assert!((plane.z_mm - drawn.planes[0].z_mm - 3.0 * k as f64).abs() < 1e-6);
        let [contour] = plane.contours.as_slice() else { panic!("{} contours", plane.contours.len()) };
        let count = (0..SIDE * SIDE).filter(|p| in_disk(1, p % SIDE, p / SIDE, k)).count() as f64;
        assert!((contour.signed_area_mm2() - count * 0.375).abs() < 0.02, "{}", contour.signed_area_mm2());
        let centre = contour.centroid();
        let own = Point3::new(centre.x, centre.y, plane.z_mm);
        let row = drawn.patient_from_stack.apply(own) - Point3::new(-10.0, 20.0, 5.0);
        assert!(row.norm() > 1.0);
    }
}

#[test]
fn a_binary_seg_is_read_bit_by_bit_in_either_byte_order() {
    for syntax in [uids::EXPLICIT_VR_LITTLE_ENDIAN, uids::IMPLICIT_VR_LITTLE_ENDIAN, "1.2.840.10008.1.2.2"] {
        let seg = write(Seg::default().object(), uids::SEGMENTATION_STORAGE, syntax);
        let ready = seg.load(Some(Label::Number(1))).unwrap();
        expected(&ready.drawn);
        assert!(ready.drawn.patient_from_stack.is_identity());
        let centre = ready.drawn.planes[0].contours[0].centroid();
        assert!(
            (centre.x - (-10.0 + 9.3 * 0.5)).abs() < 0.1 && (centre.y - (20.0 + 10.1 * 0.75)).abs() < 0.1,
            "{centre}"
        );
    }
}

#[test]
fn a_fractional_seg_counts_from_half() {
    let seg = write(
        Seg { is_fractional: true, ..Seg::default() }.object(),
        uids::SEGMENTATION_STORAGE,
        uids::EXPLICIT_VR_LITTLE_ENDIAN,
    );
    expected(&seg.load(Some(Label::Number(1))).unwrap().drawn);
}

#[test]
fn a_seg_of_any_orientation_keeps_its_place() {
    for (row, column) in
        [(-Vector3::x(), -Vector3::y()), (Vector3::y(), -Vector3::z()), (Vector3::x(), -Vector3::y())]
    {
        let seg = write(
            Seg { row, column, ..Seg::default() }.object(),
            uids::SEGMENTATION_STORAGE,
            uids::EXPLICIT_VR_LITTLE_ENDIAN,
        );
        let drawn = seg.load(Some(Label::Number(1))).unwrap().drawn;
        let first_z = drawn.planes.iter().position(|p| {
            let c = p.contours[0].centroid();
            let at = drawn.patient_from_stack.apply(Point3::new(c.x, c.y, p.z_mm));
            let expected = Point3::new(-10.0, 20.0, 5.0) + row * (9.3 * 0.5) + column * (10.1 * 0.75);
            (at - expected).norm() < 0.15
        });
        assert!(first_z.is_some(), "plane 0 is found at its place");
    }
}

#[test]
fn segments_are_listed_and_chosen_by_number_or_name() {
    let seg = write(Seg::default().object(), uids::SEGMENTATION_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN);
    let text = seg.error(None);
    assert!(
        text.starts_with("FILE holds 2 structures: 1 \"Lumen of Jane Doe\" (")
            && text.contains("2 \"Vein\" ("),
        "{text}"
    );
    assert!(text.ends_with(" voxels): choose one with --label N"), "{text}");
    assert_eq!(seg.load(Some(Label::Name("vein".into()))).unwrap().number, 2);
    assert!(seg.error(Some(Label::Number(7))).starts_with("FILE holds no such structure: there is 1"));
}

#[test]
fn faults_of_a_seg_are_named() {
    let with = |change: &dyn Fn(&mut InMemDicomObject)| {
        let mut object = Seg::default().object();
        change(&mut object);
        write(object, uids::SEGMENTATION_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN)
            .error(Some(Label::Number(1)))
    };
    let frames = |n: &'static str| with(&move |o| put(o, tags::NUMBER_OF_FRAMES, VR::IS, n));
    assert_eq!(
        frames("9"),
        "FILE: truncated: 442 bytes of pixels, its 9 frames need 497: copy or export it again"
    );
    assert_eq!(frames("7"), "FILE: 8 frames are described, 7 are stored: export the segmentation again");
    assert_eq!(
        frames("0"),
        "FILE: attribute NumberOfFrames is 0, expected 1 to 100000: export the segmentation again"
    );
    assert_eq!(
        with(&|o| put(o, tags::SEGMENTATION_TYPE, VR::CS, "LABELMAP")),
        "FILE: SegmentationType LABELMAP with 1 bits is not read: export it as BINARY with 1 bit or FRACTIONAL with 8"
    );
    for (tag, name) in [
        (tags::ROWS, "Rows"),
        (tags::SEGMENTATION_TYPE, "SegmentationType"),
        (tags::PIXEL_DATA, "PixelData"),
        (tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, "ImageOrientationPatient"),
    ] {
        let told = with(&|o| drop(o.take(tag)));
        assert_eq!(
            told,
            format!("FILE: attribute {name} is missing or unreadable: export the segmentation again")
        );
    }
    let twice = Seg { order: [0, 0, 1, 2], ..Seg::default() }.object();
    let twice = write(twice, uids::SEGMENTATION_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN);
    assert_eq!(
        twice.error(Some(Label::Number(1))),
        "FILE: two frames of one segment lie at z = 5.000 mm: export it with one each"
    );
}

#[test]
fn planes_that_a_seg_leaves_out_are_told() {
    let gap = Seg { order: [0, 1, 2, 4], ..Seg::default() }.object();
    let gap = write(gap, uids::SEGMENTATION_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN);
    let warnings = gap.load(Some(Label::Number(1))).unwrap().warnings;
    assert_eq!(warnings[0].code, "segment.gap");
    assert!(warnings[0].text.contains("between z = 11.000 and 17.000 mm"), "{}", warnings[0].text);
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

// -- against a CT --

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
