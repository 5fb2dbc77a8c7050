//! DICOM segmentations.

use super::*;

const SIDE: usize = 21; // Not a multiple of 8: frames do not begin at bytes.

/// Whether a pixel of plane k is inside segment n: disks of different radii.
fn in_disk(n: u32, i: usize, j: usize, k: usize) -> bool {
    let (x, y) = if n == 1 { (9.3, 10.1 + 0.2 * k as f64) } else { (15.0, 4.0) };
    (i as f64 - x).hypot(j as f64 - y) < if n == 1 { 6.2 } else { 2.5 }
}

pub(super) struct Seg {
    pub(super) is_fractional: bool,
    pub(super) row: Vector3,
    pub(super) column: Vector3,
    pub(super) order: [usize; 4],
}

impl Default for Seg {
    fn default() -> Self {
        let order = [2, 0, 3, 1];
        Self { is_fractional: false, row: Vector3::x(), column: Vector3::y(), order }
    }
}

impl Seg {
    /// Two segments in four planes, 3 mm apart, frames in an order of their own.
    pub(super) fn object(&self) -> InMemDicomObject {
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
fn planes_that_a_seg_leaves_out_are_empty_and_told() {
    let gap = Seg { order: [0, 1, 2, 4], ..Seg::default() }.object();
    let gap = write(gap, uids::SEGMENTATION_STORAGE, uids::EXPLICIT_VR_LITTLE_ENDIAN);
    let ready = gap.load(Some(Label::Number(1))).unwrap();
    let z = |allow_gaps| {
        let mut warnings = Vec::new();
        let drawn =
            gaps::resolve(ready.drawn.clone(), ready.absent, None, allow_gaps, &mut warnings).unwrap();
        assert_eq!(warnings[0].code, "segment.gap");
        assert!(
            warnings[0].text.contains("between z = 11.000 and 17.000 mm (1 plane)"),
            "{}",
            warnings[0].text
        );
        drawn.planes.iter().map(|p| (p.z_mm, p.contours.len())).collect::<Vec<_>>()
    };
    assert_eq!(z(true), [(5.0, 1), (8.0, 1), (11.0, 1), (17.0, 1)]);
    assert_eq!(z(false), [(5.0, 1), (8.0, 1), (11.0, 1), (14.0, 0), (17.0, 1)]);
}
