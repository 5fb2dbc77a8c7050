mod damages;
mod real;

use super::*;
use crate::ct::{Orientation, Verdict};
use crate::phantom::{self, Kind, Params};
use crate::progress::CancelToken;
use dicom_core::value::{C, PrimitiveValue};
use dicom_core::{DataElement, Tag, VR};
use dicom_dictionary_std::tags;
use dicom_object::{DefaultDicomObject, open_file};
use std::fs;
use std::path::PathBuf;
use tempfile::TempDir;

/// A phantom series of 8 small planes, 3 mm apart.
fn params() -> Params {
    Params { kind: Kind::Tube, n_planes: 8, n_pixels: 24, pixel_mm: 0.5, ..Params::default() }
}

/// A folder with that series, to be damaged.
struct Case {
    place: TempDir,
}

impl Case {
    fn new() -> Self {
        Self::of(&params(), "")
    }

    fn of(params: &Params, below: &str) -> Self {
        let case = Self { place: tempfile::tempdir().unwrap() };
        phantom::series::write(&case.dir().join(below), params, &Task::quiet()).unwrap();
        case
    }

    fn dir(&self) -> PathBuf {
        self.place.path().join("case")
    }

    fn file(&self, number: usize) -> PathBuf {
        self.dir().join(format!("IM{number:04}.dcm"))
    }

    fn edit(&self, number: usize, change: impl Fn(&mut DefaultDicomObject)) {
        let path = self.file(number);
        let mut object = open_file(&path).unwrap();
        change(&mut object);
        object.write_to_file(&path).unwrap();
    }

    fn edit_all(&self, change: impl Fn(&mut DefaultDicomObject)) {
        (1..=8).for_each(|n| self.edit(n, &change));
    }

    fn load(&self) -> Result<Loaded, Error> {
        load(&self.dir(), &SeriesChoice::Only, &Task::quiet())
    }

    /// The error of loading; checks that it is one line that names no identifier.
    fn error(&self) -> Error {
        let error = self.load().unwrap_err();
        let text = error.to_string();
        assert!(!text.contains('\n') && !text.contains("2.25.") && !text.contains("PHANTOM"), "{text}");
        assert!(text.contains(':'), "it says what to do: {text}");
        error
    }

    fn codes(&self) -> Vec<String> {
        self.load().unwrap().warnings.into_iter().map(|w| w.code).collect()
    }

    fn inspect(&self) -> Inspection {
        inspect(&self.dir(), &Task::quiet()).unwrap()
    }
}

fn put(object: &mut DefaultDicomObject, tag: Tag, vr: VR, text: &str) {
    object.put(DataElement::new(tag, vr, PrimitiveValue::from(text)));
}

fn put_number(object: &mut DefaultDicomObject, tag: Tag, value: u16) {
    object.put(DataElement::new(tag, VR::US, PrimitiveValue::from(value)));
}

#[test]
fn a_written_phantom_reads_back_as_it_was() {
    for (kind, below) in [(Kind::Carotid, ""), (Kind::Merge, "a/b")] {
        let params = Params {
            kind,
            n_planes: 5,
            n_pixels: 96,
            first_plane_z_mm: -7.3,
            plane_step_mm: 0.7,
            slab_mm: 1.0,
            ..Params::default()
        };
        let loaded = Case::of(&params, below).load().unwrap();
        assert_eq!(loaded.volume, phantom::volume(&params, &Task::quiet()));
        assert_eq!((loaded.warnings, loaded.modality.as_str(), loaded.n_files), (vec![], "CT", 5));
    }
}

#[test]
fn same_volume_on_one_thread() {
    let case = Case::new();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(pool.install(|| case.load().unwrap()), case.load().unwrap());
}

#[test]
fn a_folder_without_files_or_dicom_is_refused() {
    let place = tempfile::tempdir().unwrap();
    let try_load = |path: &Path| load(path, &SeriesChoice::Only, &Task::quiet()).unwrap_err();
    assert!(matches!(try_load(place.path()), Error::Empty(_)));
    assert!(matches!(try_load(&place.path().join("none")), Error::Read { .. }));
    let note = place.path().join("note.txt");
    fs::write(&note, "no image").unwrap();
    assert!(matches!(try_load(place.path()), Error::NoDicom { n_files: 1, .. }));
    assert!(matches!(try_load(&note), Error::NotAFolder(_)));
    assert!(matches!(inspect(place.path(), &Task::quiet()), Err(Error::NoDicom { .. })));
}

#[test]
fn foreign_files_are_left_out_with_a_warning() {
    let case = Case::new();
    fs::write(case.dir().join("readme.txt"), "hello").unwrap();
    fs::write(case.dir().join(".hidden"), "hello").unwrap();
    assert_eq!(case.codes(), ["ct.not_dicom"]);
}

/// What is wrong with a damaged file, without the way out.
fn fault_of(error: Error) -> Error {
    match error {
        Error::DamagedBeside { fault } => *fault,
        other => other,
    }
}

#[test]
fn a_damaged_file_is_named() {
    for junk in [&b""[..], b"not dicom at all", &[0; 400]] {
        let case = Case::new();
        fs::write(case.file(3), junk).unwrap();
        let error = fault_of(case.error());
        assert!(matches!(&error, Error::Damaged { path, .. } if *path == case.file(3)), "{error}");
    }
}

#[test]
fn a_truncated_slice_is_named_wherever_it_ends() {
    let whole = fs::read(Case::new().file(4)).unwrap();
    let n_header = whole.len() - 24 * 24 * 2;
    for length in [133, 140, 300, 600, n_header - 12, n_header - 4, n_header, n_header + 1, whole.len() - 1] {
        let case = Case::new();
        fs::write(case.file(4), &whole[..length]).unwrap();
        let error = fault_of(case.error());
        match &error {
            Error::Truncated { path, found_bytes, expected_bytes: 1152 } => {
                assert!(*path == case.file(4) && *found_bytes == length - n_header, "{error}");
            }
            Error::Damaged { path, .. } => assert!(*path == case.file(4) && length < n_header, "{error}"),
            _ => panic!("{length} bytes: {error}"),
        }
        assert_eq!(case.inspect().series[0].verdict, Verdict::Unusable, "{length} bytes");
    }
}

#[test]
fn pixels_that_are_fewer_than_the_header_says_are_truncated() {
    let case = Case::new();
    case.edit(2, |o| {
        o.put(DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(C::from_vec(vec![0; 100]))));
    });
    let error = case.error();
    assert!(matches!(error, Error::Truncated { found_bytes: 200, expected_bytes: 1152, .. }), "{error}");
}

#[test]
fn any_single_damaged_byte_of_a_header_is_survived() {
    let case = Case::new();
    let whole = fs::read(case.file(5)).unwrap();
    let n_header = whole.len() - 24 * 24 * 2;
    for at in 132..n_header {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x5a;
        fs::write(case.file(5), bytes).unwrap();
        // Whether it is read or refused: it must neither panic nor ask for the gigabytes that a length may claim.
        let _outcome = case.load();
    }
}

#[test]
fn element_lengths_are_checked_in_every_encoding() {
    use dicom_object::InMemDicomObject;
    let case = Case::new();
    for uid in ["1.2.840.10008.1.2", "1.2.840.10008.1.2.1", "1.2.840.10008.1.2.2", "1.2.840.10008.1.2.1.99"] {
        case.edit_all(|o| {
            let item = InMemDicomObject::from_element_iter([DataElement::new(
                tags::CODE_VALUE,
                VR::SH,
                PrimitiveValue::from("T-1"),
            )]);
            let sequence = dicom_core::value::DataSetSequence::from(vec![item]);
            o.put(DataElement::new(tags::ANATOMIC_REGION_SEQUENCE, VR::SQ, sequence));
            o.update_meta(|m| m.transfer_syntax = uid.into());
        });
        let whole = fs::read(case.file(2)).unwrap();
        assert_eq!(case.load().unwrap().volume, phantom::volume(&params(), &Task::quiet()), "{uid}");
        fs::write(case.file(2), &whole[..whole.len() - 10]).unwrap();
        let error = case.error();
        assert!(matches!(error, Error::Truncated { .. } | Error::Damaged { .. }), "{uid}: {error}");
        fs::write(case.file(2), whole).unwrap();
    }
}

#[test]
fn several_series_are_listed_and_chosen_by_number() {
    let case = Case::new();
    for number in 5..=8 {
        case.edit(number, |o| put(o, tags::SERIES_INSTANCE_UID, VR::UI, "1.2.3"));
    }
    let error = case.error();
    let text = error.to_string();
    assert!(matches!(error, Error::SeveralSeries { n: 2, .. }), "{error}");
    assert!(
        text.contains("1: CT, 4 images, 24 x 24")
            && text.contains("2: CT, 4 images")
            && !text.contains("1.2.3")
    );
    let chosen = |number| load(&case.dir(), &SeriesChoice::ByNumber(number), &Task::quiet());
    assert_eq!(chosen(2).unwrap().volume.plane_z_mm, [12.0, 15.0, 18.0, 21.0]);
    assert!(matches!(chosen(0), Err(Error::NoSuchSeries { number: 0, .. })));
    assert!(matches!(chosen(3), Err(Error::NoSuchSeries { number: 3, .. })));
    assert_eq!(case.inspect().series.len(), 2);
}

#[test]
fn a_missing_slice_is_located() {
    let case = Case::new();
    fs::remove_file(case.file(4)).unwrap();
    let error = case.error();
    assert!(
        matches!(error, Error::MissingPlanes { below_mm: 6.0, above_mm: 12.0, n_missing: 1, .. }),
        "{error}"
    );
    let options = Options { allow_gaps: true, ..Options::default() };
    let loaded = load_with(&case.dir(), &options, &Task::quiet()).unwrap();
    assert_eq!((loaded.volume.dims[2], loaded.warnings[0].code.as_str()), (7, "ct.missing_planes"));
    let report = &case.inspect().series[0];
    assert_eq!(report.verdict, Verdict::Unusable);
    assert!(report.reason.as_ref().unwrap().contains("between z = 6.000 and 12.000 mm"));
}

#[test]
fn a_copy_of_a_slice_is_ignored_and_another_image_at_its_place_is_not() {
    let case = Case::new();
    fs::copy(case.file(3), case.dir().join("copy.dcm")).unwrap();
    let loaded = case.load().unwrap();
    assert_eq!((loaded.volume.dims[2], loaded.n_files), (8, 9));
    assert_eq!(case.codes(), ["ct.duplicate_plane"]);
    assert_eq!(case.inspect().series[0].verdict, Verdict::UsableWithWarnings);
    let mut other = open_file(case.file(3)).unwrap();
    other.put(DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(C::from_vec(vec![7; 576]))));
    other.write_to_file(case.dir().join("copy.dcm")).unwrap();
    let error = case.error();
    assert!(matches!(error, Error::ConflictingPlanes { z_mm: 6.0, .. }), "{error}");
}

#[test]
fn a_slice_of_another_size_is_named() {
    let case = Case::new();
    case.edit(6, |o| {
        put_number(o, tags::ROWS, 12);
        o.put(DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(C::from_vec(vec![0; 288]))));
    });
    let error = case.error();
    assert!(matches!(&error, Error::OddImage { path, n_others: 7, .. } if *path == case.file(6)), "{error}");
    assert!(error.to_string().contains("24 x 12 pixels of"), "{error}");
}

#[test]
fn a_single_plane_is_refused() {
    let case = Case::new();
    (2..=8).for_each(|n| fs::remove_file(case.file(n)).unwrap());
    assert!(matches!(case.error(), Error::TooFewPlanes(1)));
}

#[test]
fn localizers_and_reports_are_left_out() {
    let case = Case::new();
    case.edit(1, |o| put(o, tags::IMAGE_TYPE, VR::CS, "ORIGINAL\\PRIMARY\\LOCALIZER"));
    case.edit(8, |o| {
        put(o, tags::SOP_CLASS_UID, VR::UI, "1.2.840.10008.5.1.4.1.1.88.11");
        o.remove_element(tags::ROWS);
    });
    assert_eq!(case.codes(), ["ct.localizer", "ct.not_an_image_plane"]);
    case.edit_all(|o| put(o, tags::IMAGE_TYPE, VR::CS, "ORIGINAL\\PRIMARY\\LOCALIZER"));
    assert!(matches!(case.error(), Error::NoImages(_)));
    assert!(matches!(inspect(&case.dir(), &Task::quiet()), Err(Error::NoImages(_))));
}

#[test]
fn missing_attributes_are_named() {
    let needed = [
        (tags::IMAGE_POSITION_PATIENT, "ImagePositionPatient"),
        (tags::IMAGE_ORIENTATION_PATIENT, "ImageOrientationPatient"),
        (tags::PIXEL_SPACING, "PixelSpacing"),
        (tags::ROWS, "Rows"),
        (tags::COLUMNS, "Columns"),
        (tags::BITS_ALLOCATED, "BitsAllocated"),
        (tags::BITS_STORED, "BitsStored"),
        (tags::PIXEL_REPRESENTATION, "PixelRepresentation"),
    ];
    for (tag, name) in needed {
        let case = Case::new();
        case.edit(2, |o| {
            o.remove_element(tag);
        });
        let error = case.error();
        assert!(matches!(&error, Error::MissingAttribute { attribute, .. } if *attribute == name), "{error}");
    }
}

#[test]
fn senseless_attributes_are_named() {
    let senseless = [
        (tags::IMAGE_POSITION_PATIENT, VR::DS, "1\\2", "ImagePositionPatient"),
        (tags::IMAGE_POSITION_PATIENT, VR::DS, "1\\2\\1e9", "ImagePositionPatient"),
        (tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "1\\0\\0\\1\\0\\0", "ImageOrientationPatient"),
        (tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "0\\0\\0\\0\\0\\0", "ImageOrientationPatient"),
        (tags::PIXEL_SPACING, VR::DS, "0\\0", "PixelSpacing"),
        (tags::PIXEL_SPACING, VR::DS, "-1\\1", "PixelSpacing"),
        (tags::RESCALE_SLOPE, VR::DS, "0", "RescaleSlope"),
    ];
    for (tag, vr, value, name) in senseless {
        let case = Case::new();
        case.edit(2, |o| put(o, tag, vr, value));
        let error = case.error();
        assert!(matches!(&error, Error::BadAttribute { attribute, .. } if *attribute == name), "{error}");
    }
    for (tag, value, name) in [
        (tags::ROWS, 0, "Rows"),
        (tags::COLUMNS, 60_000, "Columns"),
        (tags::BITS_STORED, 17, "BitsStored"),
        (tags::HIGH_BIT, 3, "HighBit"),
    ] {
        let case = Case::new();
        case.edit(2, |o| put_number(o, tag, value));
        let error = case.error();
        assert!(matches!(&error, Error::BadAttribute { attribute, .. } if *attribute == name), "{error}");
    }
    let case = Case::new();
    case.edit(2, |o| put(o, tags::PIXEL_SPACING, VR::DS, "DOE\\JOHN"));
    let error = case.error();
    assert!(matches!(error, Error::Damaged { .. }) && !error.to_string().contains("DOE"), "{error}");
}

#[test]
fn kinds_of_image_that_are_not_read_are_refused() {
    let case = Case::new();
    case.edit(1, |o| put(o, tags::NUMBER_OF_FRAMES, VR::IS, "30"));
    assert!(case.error().to_string().contains("multi-frame image (30 frames)"));
    let case = Case::new();
    case.edit(1, |o| put_number(o, tags::SAMPLES_PER_PIXEL, 3));
    assert!(matches!(case.error(), Error::UnsupportedImage { .. }));
    let case = Case::new();
    case.edit(1, |o| put_number(o, tags::BITS_ALLOCATED, 32));
    assert!(matches!(case.error(), Error::UnsupportedImage { .. }));
}

#[test]
fn gantry_tilt_and_shifted_planes_are_told_apart() {
    let case = Case::new();
    for number in 1..=8 {
        let z = 3.0 * (number - 1) as f64;
        case.edit(number, |o| put(o, tags::IMAGE_POSITION_PATIENT, VR::DS, &format!("0\\{}\\{z}", 0.2 * z)));
    }
    assert_eq!(case.codes(), ["ct.gantry_tilt"]);
    let report = &case.inspect().series[0];
    assert!((report.gantry_tilt_deg.unwrap() - 11.31).abs() < 0.01);
    // 4.2 mm of rows of 0.5 mm are added, so that nothing is cut off.
    assert_eq!(case.load().unwrap().volume.dims, [24, 24 + 9, 8]);
    let case = Case::new();
    case.edit(3, |o| put(o, tags::IMAGE_POSITION_PATIENT, VR::DS, "50\\50\\6"));
    assert!(matches!(case.error(), Error::ShiftedPlane { path, .. } if path == case.file(3)));
    let reason = case.inspect().series[0].reason.clone().unwrap();
    assert!(reason.starts_with("image 3 of 8 (by file name): the image lies"), "{reason}");
}

#[test]
fn pixel_spacing_is_rows_first() {
    let case = Case::new();
    case.edit_all(|o| put(o, tags::PIXEL_SPACING, VR::DS, "0.75\\0.5"));
    let volume = case.load().unwrap().volume;
    assert_eq!(volume.pixel_spacing_xy_mm, [0.5, 0.75]);
    let [x, y] = volume.origin_xy_mm;
    assert_eq!(volume.stack_from_voxel(2.0, 2.0, 0).coords.xy(), nalgebra::Vector2::new(x + 1.0, y + 1.5));
}

#[test]
fn signed_pixels_and_slopes_are_rescaled() {
    let case = Case::new();
    let values: Vec<i16> = (0..576).map(|i| i - 300).collect();
    case.edit_all(|o| {
        put_number(o, tags::BITS_STORED, 16);
        put_number(o, tags::HIGH_BIT, 15);
        put_number(o, tags::PIXEL_REPRESENTATION, 1);
        put(o, tags::RESCALE_SLOPE, VR::DS, "0.5");
        put(o, tags::RESCALE_INTERCEPT, VR::DS, "-10");
        o.put(DataElement::new(tags::PIXEL_PADDING_VALUE, VR::SS, PrimitiveValue::from(-300_i16)));
        let words = values.iter().map(|v| v.cast_unsigned()).collect();
        o.put(DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(C::from_vec(words))));
    });
    let volume = case.load().unwrap().volume;
    assert_eq!((volume.at(0, 0, 2), volume.at(1, 0, 2), volume.at(23, 23, 2)), (-1024.0, -159.5, 127.5));
}

#[test]
fn images_from_right_to_left_give_the_same_volume() {
    let case = Case::new();
    let straight = case.load().unwrap().volume;
    case.edit_all(|o| {
        let position = o.element(tags::IMAGE_POSITION_PATIENT).unwrap().to_multi_float64().unwrap();
        let far = |v: f64| v + 23.0 * 0.5;
        let moved = format!("{}\\{}\\{}", far(position[0]), far(position[1]), position[2]);
        put(o, tags::IMAGE_POSITION_PATIENT, VR::DS, &moved);
        put(o, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "-1\\0\\0\\0\\-1\\0");
        let mut words = o.element(tags::PIXEL_DATA).unwrap().to_multi_int::<u16>().unwrap();
        words.reverse();
        o.put(DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(C::from_vec(words))));
    });
    let turned = case.load().unwrap().volume;
    assert_eq!((turned.hu, turned.dims), (straight.hu, straight.dims));
    assert!((turned.origin_xy_mm[0] - straight.origin_xy_mm[0]).abs() < 1e-9);
    assert!(turned.patient_from_stack.is_identity());
}

#[test]
fn a_coronal_series_keeps_its_place_in_the_patient() {
    let case = Case::new();
    for number in 1..=8 {
        let y = 100.0 - 3.0 * number as f64;
        case.edit(number, |o| {
            put(o, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "1\\0\\0\\0\\0\\-1");
            put(o, tags::IMAGE_POSITION_PATIENT, VR::DS, &format!("-7\\{y}\\300"));
        });
    }
    let volume = case.load().unwrap().volume;
    // The normal of x and -z is +y: the highest number lies lowest.
    let place = volume.patient_from_stack.apply(volume.stack_from_voxel(2.0, 4.0, 7));
    assert!((place - crate::geom::Point3::new(-6.0, 97.0, 298.0)).norm() < 1e-9, "{place}");
    assert_eq!(case.inspect().series[0].orientation, Orientation::Coronal);
}

#[test]
fn damaged_compressed_pixels_are_an_error() {
    for uid in ["1.2.840.10008.1.2.4.90", "1.2.840.10008.1.2.4.70", "1.2.840.10008.1.2.5"] {
        let case = Case::new();
        case.edit_all(|o| {
            let fragments = C::from_vec(vec![vec![0xff_u8; 60]]);
            let pixels = dicom_core::value::PixelFragmentSequence::new_fragments(fragments);
            o.put(DataElement::new(
                tags::PIXEL_DATA,
                VR::OB,
                dicom_core::value::Value::PixelSequence(pixels),
            ));
            o.update_meta(|m| m.transfer_syntax = uid.into());
        });
        assert!(matches!(case.error(), Error::Undecodable { .. } | Error::Truncated { .. }), "{uid}");
    }
}

#[test]
fn interruption_stops_the_reading() {
    let case = Case::new();
    let cancel = CancelToken::default();
    cancel.cancel();
    let task = Task::new(&|_, _| {}, cancel);
    assert!(matches!(load(&case.dir(), &SeriesChoice::Only, &task), Err(Error::Cancelled(_))));
    assert!(matches!(inspect(&case.dir(), &task), Err(Error::Cancelled(_))));
}

#[test]
fn volumes_beyond_memory_are_refused() {
    assert!(matches!(check_size([usize::MAX, 2, 2]), Err(Error::TooLarge { .. })));
    assert!(matches!(check_size([1 << 30, 1 << 30, 1]), Err(Error::TooLarge { .. })));
}

#[test]
fn an_inspection_prints_as_a_table_without_identifiers() {
    let case = Case::new();
    let text = case.inspect().to_string();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines[0], "9 files, 1 series");
    assert!(lines[1].starts_with("no  kind  images  pixels"));
    assert!(
        lines[2]
            .contains("24 x 24  0.5000 x 0.5000  3.000    2.000    0.000 ... 21.000  transaxial   usable"),
        "{text}"
    );
    let json = serde_json::to_string(&case.inspect()).unwrap();
    assert!(![text, json].iter().any(|t| t.contains("2.25.") || t.contains("PHANTOM")));
}

/// Group, element, kind of value, its length as it is said, value.
type Element<'a> = (u16, u16, &'a [u8; 2], u32, &'a [u8]);

/// Writes a deflated file of elements whose values are zeros, or what is given.
fn deflated_file(place: &Path, elements: &[Element<'_>]) -> PathBuf {
    use std::io::{Read as _, Write as _};
    let syntax = b"1.2.840.10008.1.2.1.99";
    let mut file = vec![0; 128];
    file.extend(b"DICM\x02\x00\x00\x00UL\x04\x00");
    file.extend((8 + u32::try_from(syntax.len()).unwrap()).to_le_bytes());
    file.extend(b"\x02\x00\x10\x00UI\x16\x00");
    file.extend(syntax);
    let mut deflated = flate2::write::DeflateEncoder::new(file, flate2::Compression::fast());
    for (group, number, vr, length, value) in elements {
        deflated.write_all(&[&group.to_le_bytes()[..], &number.to_le_bytes(), *vr].concat()).unwrap();
        match *vr {
            b"OB" | b"SQ" => deflated.write_all(&[&[0, 0], &length.to_le_bytes()[..]].concat()).unwrap(),
            _ => deflated.write_all(&u16::try_from(*length).unwrap().to_le_bytes()).unwrap(),
        }
        deflated.write_all(value).unwrap();
        // Of no stated length: there is what is given, and no more.
        let rest = if *length == u32::MAX { 0 } else { u64::from(*length) - value.len() as u64 };
        std::io::copy(&mut std::io::repeat(0).take(rest), &mut deflated).unwrap();
    }
    let path = place.join("bomb.dcm");
    fs::write(&path, deflated.finish().unwrap()).unwrap();
    path
}

#[test]
fn a_deflated_file_may_not_inflate_to_any_size() {
    let place = tempfile::tempdir().unwrap();
    // Each within what an element may have, all together not within what a header may.
    let elements: Vec<_> = (0x1001..0x1005).map(|n| (0x0009, n, b"OB", 90 << 20, &[][..])).collect();
    let refused = lengths::check(&deflated_file(place.path(), &elements)).unwrap_err().to_string();
    assert!(refused.contains("its deflated elements inflate beyond any header's length"), "{refused}");
}

#[test]
fn deflated_pixels_have_no_more_bytes_than_rows_and_columns_may_have() {
    let place = tempfile::tempdir().unwrap();
    let of = |rows: u8, length: u32| {
        let elements = [
            (0x0028, 0x0008, b"IS", 2, &b"2 "[..]),
            (0x0028, 0x0010, b"US", 2, &[rows, 0][..]),
            (0x0028, 0x0011, b"US", 2, &[64, 0][..]),
            (0x7fe0, 0x0010, b"OB", length, &[][..]),
        ];
        lengths::check(&deflated_file(place.path(), &elements))
    };
    assert!(of(64, 2 * 64 * 64 * 12).is_ok());
    let refused = of(64, 2 * 64 * 64 * 12 + 2).unwrap_err().to_string();
    assert!(refused.contains("its pixels have more bytes than its rows and columns may have"), "{refused}");
    assert!(of(0, 2).is_err());
}

#[test]
fn deflated_pixels_of_an_icon_and_in_pieces_are_bounded() {
    let place = tempfile::tempdir().unwrap();
    let most: u32 = 1 << 28;
    let of = |elements: &[Element<'_>]| lengths::check(&deflated_file(place.path(), elements)).map(drop);
    // Pixels of one bit: an image of 64 x 64, and 4 GiB.
    let size = [(0x0028, 0x0010, b"US", 2, &[64, 0][..]), (0x0028, 0x0011, b"US", 2, &[64, 0][..])];
    let bits = (0x0028, 0x0100, b"US", 2, &[1, 0][..]);
    let pixels = |length| [size[0], size[1], bits, (0x7fe0, 0x0010, b"OB", length, &[][..])];
    assert!(of(&pixels(64 * 64 / 8)).is_ok() && of(&pixels(64 * 64)).is_err());
    // Within a sequence, and as a piece: items have no VR, so that the length stands where it does.
    let icon = |length: u32| {
        let inner =
            [&b"\xfe\xff\x00\xe0\xff\xff\xff\xff\xe0\x7f\x10\x00OB\0\0"[..], &length.to_le_bytes()].concat();
        let path = deflated_file(place.path(), &[(0x0088, 0x0200, b"SQ", u32::MAX, &inner)]);
        lengths::check(&path).unwrap_err().to_string()
    };
    assert!(icon(most + 2).contains("its pixels have more bytes"), "{}", icon(most + 2));
    let piece = |length: u32| {
        let table = [&b"\xfe\xff\x00\xe0\0\0\0\0\xfe\xff\x00\xe0"[..], &length.to_le_bytes()].concat();
        let path = deflated_file(place.path(), &[(0x7fe0, 0x0010, b"OB", u32::MAX, &table)]);
        lengths::check(&path).unwrap_err().to_string()
    };
    assert!(piece(most + 2).contains("its pixels have more bytes"), "{}", piece(most + 2));
}

#[test]
fn marks_of_items_that_there_are_not_are_refused() {
    let refused = |mark: [u8; 4]| {
        let mut bytes = vec![0; 128];
        bytes.extend(b"DICM\x02\x00\x00\x00UL\x04\x00\x1c\x00\x00\x00");
        bytes.extend(b"\x02\x00\x10\x00UI\x14\x001.2.840.10008.1.2.1\x00");
        // A sequence, an item, an element, the mark, the end of a sequence: all of no stated length.
        bytes.extend(b"\x06\x30\x20\x00SQ\x00\x00\xff\xff\xff\xff\xfe\xff\x00\xe0\xff\xff\xff\xff");
        bytes.extend(b"\x06\x30\x22\x00IS\x02\x001 ");
        bytes.extend([&mark[..], &[0xff; 4]].concat());
        bytes.extend(b"\xfe\xff\xdd\xe0\x00\x00\x00\x00");
        bytes.extend(b"\xfe\xff\x0d\xe0\x00\x00\x00\x00\xfe\xff\xdd\xe0\x00\x00\x00\x00");
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("marks.dcm");
        fs::write(&path, bytes).unwrap();
        lengths::check(&path).unwrap_err().to_string()
    };
    for number in [[0xf1, 0x1f], [0x00, 0x00], [0x0e, 0xe0]] {
        let text = refused([0xfe, 0xff, number[0], number[1]]);
        assert!(text.contains("a mark of items is none that there is"), "{text}");
    }
}
