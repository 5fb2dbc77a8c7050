//! Tests of how images are stored: transfer syntaxes against an independent decoder, multi-frame objects, media.

use super::shared::real;
use super::*;
use crate::ct::Verdict;
use crate::ct::series::Header;
use crate::phantom::{self, Kind, Params};
use dicom_core::value::{C, DataSetSequence, PixelFragmentSequence, PrimitiveValue, Value};
use dicom_core::{DataElement, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{DefaultDicomObject, InMemDicomObject, open_file};
use std::fs;
use std::path::PathBuf;
use tempfile::TempDir;

const N_PIXELS: usize = 24 * 24;

/// A folder of 8 small planes, 3 mm apart.
fn phantom_folder() -> TempDir {
    let place = tempfile::tempdir().unwrap();
    phantom::series::write(&place.path().join("case"), &params(), &Task::quiet()).unwrap();
    place
}

fn params() -> Params {
    Params { kind: Kind::Tube, n_planes: 8, n_pixels: 24, pixel_mm: 0.5, ..Params::default() }
}

fn file_of(place: &TempDir, number: usize) -> PathBuf {
    place.path().join("case").join(format!("IM{number:04}.dcm"))
}

fn load_all(path: &Path) -> Result<Loaded, Error> {
    load(path, &SeriesChoice::Only, &Task::quiet())
}

fn text(tag: Tag, vr: VR, value: &str) -> DataElement<InMemDicomObject> {
    DataElement::new(tag, vr, PrimitiveValue::from(value))
}

fn sequence(tag: Tag, items: Vec<InMemDicomObject>) -> DataElement<InMemDicomObject> {
    DataElement::new(tag, VR::SQ, DataSetSequence::from(items))
}

fn item(elements: Vec<DataElement<InMemDicomObject>>) -> InMemDicomObject {
    InMemDicomObject::from_element_iter(elements)
}

/// A group that holds one item.
fn group_of(tag: Tag, elements: Vec<DataElement<InMemDicomObject>>) -> DataElement<InMemDicomObject> {
    sequence(tag, vec![item(elements)])
}

/// The planes of the phantom as frames of one object, each with its stack, temporal position and plane.
fn enhanced(place: &TempDir, frames: &[(&str, u32, usize)]) -> DefaultDicomObject {
    let mut object = open_file(file_of(place, 1)).unwrap();
    let mut words: Vec<u16> = Vec::new();
    let mut groups = Vec::new();
    for &(stack, phase, number) in frames {
        let plane = open_file(file_of(place, number)).unwrap();
        words.extend(plane.element(tags::PIXEL_DATA).unwrap().to_multi_int::<u16>().unwrap());
        let position = plane.element(tags::IMAGE_POSITION_PATIENT).unwrap().to_str().unwrap();
        // Each frame has a rescaling of its own; the first phase is that of the phantom.
        let intercept = format!("{}", -1024 + 100 * (i64::from(phase) - 1));
        groups.push(item(vec![
            group_of(
                tags::PLANE_POSITION_SEQUENCE,
                vec![text(tags::IMAGE_POSITION_PATIENT, VR::DS, &position)],
            ),
            group_of(
                tags::PIXEL_VALUE_TRANSFORMATION_SEQUENCE,
                vec![
                    text(tags::RESCALE_SLOPE, VR::DS, "1"),
                    text(tags::RESCALE_INTERCEPT, VR::DS, &intercept),
                ],
            ),
            group_of(
                tags::FRAME_CONTENT_SEQUENCE,
                vec![
                    text(tags::STACK_ID, VR::SH, stack),
                    DataElement::new(tags::TEMPORAL_POSITION_INDEX, VR::UL, PrimitiveValue::from(phase)),
                ],
            ),
        ]));
    }
    let of_first = |tag: Tag| open_file(file_of(place, 1)).unwrap().element(tag).unwrap().clone();
    let shared = item(vec![
        group_of(tags::PLANE_ORIENTATION_SEQUENCE, vec![of_first(tags::IMAGE_ORIENTATION_PATIENT)]),
        group_of(
            tags::PIXEL_MEASURES_SEQUENCE,
            vec![of_first(tags::PIXEL_SPACING), of_first(tags::SLICE_THICKNESS)],
        ),
    ]);
    for tag in [
        tags::IMAGE_POSITION_PATIENT,
        tags::IMAGE_ORIENTATION_PATIENT,
        tags::PIXEL_SPACING,
        tags::SLICE_THICKNESS,
        tags::RESCALE_SLOPE,
        tags::RESCALE_INTERCEPT,
    ] {
        object.remove_element(tag);
    }
    object.put(text(tags::SOP_CLASS_UID, VR::UI, uids::ENHANCED_CT_IMAGE_STORAGE));
    object.put(text(tags::NUMBER_OF_FRAMES, VR::IS, &frames.len().to_string()));
    object.put(sequence(tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, vec![shared]));
    object.put(sequence(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, groups));
    object.put(DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(C::from_vec(words))));
    object.update_meta(|m| m.media_storage_sop_class_uid = uids::ENHANCED_CT_IMAGE_STORAGE.into());
    object
}

/// All planes of the phantom as one stack.
fn one_stack() -> Vec<(&'static str, u32, usize)> {
    (1..=8).map(|n| ("1", 1, n)).collect()
}

/// The same object with its frames compressed, each in so many pieces, RLE-coded without any run.
fn compressed(mut object: DefaultDicomObject, n_pieces: usize, has_table: bool) -> DefaultDicomObject {
    let words = object.element(tags::PIXEL_DATA).unwrap().to_multi_int::<u16>().unwrap();
    let (mut fragments, mut offsets, mut at) = (Vec::new(), Vec::new(), 0_u32);
    for frame in words.chunks(N_PIXELS) {
        offsets.push(at);
        let stream = run_lengths(frame);
        for piece in stream.chunks(stream.len().div_ceil(n_pieces).next_multiple_of(2)) {
            at += 8 + u32::try_from(piece.len()).unwrap();
            fragments.push(piece.to_vec());
        }
    }
    let table = if has_table { offsets } else { Vec::new() };
    let pixels = PixelFragmentSequence::new(table, fragments);
    object.put(DataElement::new(tags::PIXEL_DATA, VR::OB, Value::PixelSequence(pixels)));
    object.update_meta(|m| m.transfer_syntax = uids::RLE_LOSSLESS.into());
    object
}

fn run_lengths(words: &[u16]) -> Vec<u8> {
    let plane = |shift: u32| -> Vec<u8> {
        let bytes: Vec<u8> = words.iter().map(|w| (w >> shift).to_le_bytes()[0]).collect();
        bytes.chunks(128).flat_map(|c| [&[u8::try_from(c.len() - 1).unwrap()], c].concat()).collect()
    };
    let (high, low) = (plane(8), plane(0));
    let second = u32::try_from(64 + high.len()).unwrap();
    let mut header: Vec<u8> = [2, 64, second].into_iter().flat_map(u32::to_le_bytes).collect();
    header.resize(64, 0);
    let mut stream = [header, high, low].concat();
    stream.resize(stream.len().next_multiple_of(2), 0);
    stream
}

/// What loading the object alone gives.
fn loaded(object: &DefaultDicomObject) -> Result<Loaded, Error> {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("object.dcm");
    object.write_to_file(&path).unwrap();
    load_all(&path)
}

#[test]
fn frames_of_an_enhanced_object_are_planes() {
    let place = phantom_folder();
    let object = enhanced(&place, &one_stack());
    let found = loaded(&object).unwrap();
    assert_eq!(found.volume, phantom::volume(&params(), &Task::quiet()));
    assert!(found.warnings.is_empty(), "{:?}", found.warnings);
    for (n_pieces, has_table) in [(1, false), (1, true), (3, true)] {
        let found = loaded(&compressed(object.clone(), n_pieces, has_table)).unwrap();
        assert_eq!(found.volume, phantom::volume(&params(), &Task::quiet()), "{n_pieces} {has_table}");
    }
    let error = loaded(&compressed(object, 3, false)).unwrap_err();
    assert!(error.to_string().contains("do not go together"), "{error}");
}

/// The object with its data set deflated, all behind the group of the file itself.
fn deflated(mut object: DefaultDicomObject, path: &Path) {
    use std::io::Write as _;
    object.update_meta(|m| m.transfer_syntax = uids::EXPLICIT_VR_LITTLE_ENDIAN.into());
    object.write_to_file(path).unwrap();
    let plain = fs::read(path).unwrap();
    // Preamble, mark, and the element that says how long the group is behind it.
    let length = u32::from_le_bytes(plain[140..144].try_into().unwrap()) as usize;
    let data_set = &plain[144 + length..];
    object.update_meta(|m| m.transfer_syntax = uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN.into());
    let mut file = vec![0; 128];
    file.extend(b"DICM");
    object.meta().write(&mut file).unwrap();
    let mut deflated = flate2::write::DeflateEncoder::new(file, flate2::Compression::fast());
    deflated.write_all(data_set).unwrap();
    fs::write(path, deflated.finish().unwrap()).unwrap();
}

#[test]
fn frames_of_a_deflated_object_are_planes_too() {
    let place = phantom_folder();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("object.dcm");
    deflated(enhanced(&place, &one_stack()), &path);
    let found = load_all(&path).unwrap();
    assert_eq!(found.volume, phantom::volume(&params(), &Task::quiet()));
    // The same frame twice: both are read again, to be compared.
    let twice: Vec<_> = one_stack().into_iter().chain([("1", 1, 4)]).collect();
    deflated(enhanced(&place, &twice), &path);
    let codes: Vec<String> = load_all(&path).unwrap().warnings.into_iter().map(|w| w.code).collect();
    assert_eq!(codes, ["ct.duplicate_plane"]);
    let cancelled = crate::progress::CancelToken::default();
    cancelled.cancel();
    let task = Task::new(&|_, _| {}, cancelled);
    assert!(matches!(load(&path, &SeriesChoice::Only, &task), Err(Error::Cancelled(_))));
}

/// The object with a type for each frame.
fn with_types(mut object: DefaultDicomObject, type_of: impl Fn(usize) -> &'static str) -> DefaultDicomObject {
    let frames =
        object.element(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE).unwrap().items().unwrap().to_vec();
    let typed = frames.into_iter().enumerate().map(|(n, mut frame)| {
        let kind = text(tags::FRAME_TYPE, VR::CS, type_of(n));
        frame.put(group_of(tags::CT_IMAGE_FRAME_TYPE_SEQUENCE, vec![kind]));
        frame
    });
    object.put(sequence(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, typed.collect()));
    object
}

#[test]
fn projections_among_the_frames_are_a_series_of_their_own() {
    let place = phantom_folder();
    let frames: Vec<_> = one_stack().into_iter().chain([("1", 1, 3), ("1", 1, 4), ("1", 1, 5)]).collect();
    let types = |n: usize| {
        if n < 8 { "ORIGINAL\\PRIMARY\\VOLUME\\NONE" } else { "DERIVED\\PRIMARY\\VOLUME\\MAX_IP" }
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("object");
    with_types(enhanced(&place, &frames), types).write_to_file(&path).unwrap();
    let error = load_all(&path).unwrap_err();
    assert!(matches!(error, Error::SeveralSeries { n: 2, .. }), "{error}");
    assert!(error.to_string().contains("derived primary volume max_ip"), "{error}");
    let part = |number| load(&path, &SeriesChoice::ByNumber(number), &Task::quiet()).unwrap();
    assert_eq!(part(1).volume, phantom::volume(&params(), &Task::quiet()));
    assert!(part(1).warnings.is_empty(), "{:?}", part(1).warnings);
    assert_eq!(part(2).warnings[0].code, "ct.projection");
}

#[test]
fn extended_offset_tables_are_heeded() {
    let place = phantom_folder();
    let mut object = compressed(enhanced(&place, &one_stack()), 2, true);
    let Value::PixelSequence(pixels) = object.element(tags::PIXEL_DATA).unwrap().value().clone() else {
        panic!("it is compressed")
    };
    let offsets: Vec<u64> = pixels.offset_table().iter().map(|&o| o.into()).collect();
    object.put(DataElement::new(
        tags::EXTENDED_OFFSET_TABLE,
        VR::OV,
        PrimitiveValue::U64(C::from_vec(offsets)),
    ));
    let without = PixelFragmentSequence::new_fragments(pixels.fragments().to_vec());
    object.put(DataElement::new(tags::PIXEL_DATA, VR::OB, Value::PixelSequence(without)));
    assert_eq!(loaded(&object).unwrap().volume, phantom::volume(&params(), &Task::quiet()));
}

#[test]
fn stacks_and_phases_of_one_object_are_series_of_their_own() {
    let place = phantom_folder();
    let frames: Vec<_> = (1..=8).flat_map(|n| [("1", 1, n), ("1", 2, n)]).collect();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("object");
    enhanced(&place, &frames).write_to_file(&path).unwrap();
    assert!(matches!(load_all(&path), Err(Error::SeveralSeries { n: 2, .. })));
    let planes = |number| load(&path, &SeriesChoice::ByNumber(number), &Task::quiet()).unwrap().volume;
    let (first, second) = (planes(1), planes(2));
    assert_eq!(first, phantom::volume(&params(), &Task::quiet()));
    assert!(first.hu.iter().zip(second.hu.iter()).all(|(a, b)| a + 100.0 == b));
}

#[test]
fn frames_without_groups_and_truncated_ones_are_refused() {
    let place = phantom_folder();
    let mut object = enhanced(&place, &one_stack());
    object.put(text(tags::NUMBER_OF_FRAMES, VR::IS, "9"));
    let error = loaded(&object).unwrap_err();
    assert!(error.to_string().contains("NumberOfFrames is 9, with functional groups of 8 frames"), "{error}");
    let mut object = enhanced(&place, &one_stack());
    object.remove_element(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE);
    let error = loaded(&object).unwrap_err();
    assert!(matches!(error, Error::MissingAttribute { attribute: "PerFrameFunctionalGroupsSequence", .. }));
    let mut object = enhanced(&place, &one_stack());
    let half = PrimitiveValue::U16(C::from_vec(vec![0; 4 * N_PIXELS]));
    object.put(DataElement::new(tags::PIXEL_DATA, VR::OW, half));
    let error = loaded(&object).unwrap_err();
    assert!(matches!(error, Error::Truncated { found_bytes: 4608, expected_bytes: 9216, .. }), "{error}");
}

#[test]
fn a_damaged_frame_is_named() {
    let place = phantom_folder();
    let mut object = compressed(enhanced(&place, &one_stack()), 1, true);
    let Value::PixelSequence(pixels) = object.element(tags::PIXEL_DATA).unwrap().value().clone() else {
        panic!("it is compressed")
    };
    let mut fragments = pixels.fragments().to_vec();
    fragments[4][0] = 9;
    let damaged = PixelFragmentSequence::new_fragments(fragments);
    object.put(DataElement::new(tags::PIXEL_DATA, VR::OB, Value::PixelSequence(damaged)));
    let error = loaded(&object).unwrap_err();
    assert!(matches!(error, Error::Undecodable { frame: Some(5), syntax: "RLE", .. }), "{error}");
    assert!(error.to_string().contains(", frame 5: the run-length pixels"), "{error}");
}

/// A directory that names those files.
fn directory(names: &[&str]) -> DefaultDicomObject {
    let records = names.iter().map(|name| {
        item(vec![
            text(tags::DIRECTORY_RECORD_TYPE, VR::CS, "IMAGE"),
            DataElement::new(
                tags::REFERENCED_FILE_ID,
                VR::CS,
                PrimitiveValue::Strs(name.split('/').map(String::from).collect()),
            ),
        ])
    });
    item(vec![
        text(tags::SOP_CLASS_UID, VR::UI, uids::MEDIA_STORAGE_DIRECTORY_STORAGE),
        text(tags::SOP_INSTANCE_UID, VR::UI, "2.25.1"),
        sequence(tags::DIRECTORY_RECORD_SEQUENCE, records.collect()),
    ])
    .with_meta(
        dicom_object::FileMetaTableBuilder::new()
            .media_storage_sop_class_uid(uids::MEDIA_STORAGE_DIRECTORY_STORAGE)
            .media_storage_sop_instance_uid("2.25.1")
            .transfer_syntax(uids::EXPLICIT_VR_LITTLE_ENDIAN),
    )
    .unwrap()
}

#[test]
fn a_dicomdir_leads_to_its_files_and_those_beside_it() {
    let place = phantom_folder();
    let path = place.path().join("DICOMDIR");
    let names: Vec<String> = (1..=5).map(|n| format!("CASE/IM{n:04}.DCM")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    directory(&names).write_to_file(&path).unwrap();
    for path in [path.as_path(), place.path()] {
        let found = load_all(path).unwrap();
        assert_eq!(found.volume, phantom::volume(&params(), &Task::quiet()));
        assert!(found.warnings.is_empty(), "{:?}", found.warnings);
    }
}

#[test]
fn the_files_of_a_dicomdir_are_all_that_is_read() {
    let place = phantom_folder();
    let path = place.path().join("DICOMDIR");
    directory(&["CASE/IM0001.DCM", ".hidden/IM0002.DCM"]).write_to_file(&path).unwrap();
    let hidden = place.path().join(".hidden");
    fs::create_dir(&hidden).unwrap();
    fs::rename(file_of(&place, 2), hidden.join("IM0002.DCM")).unwrap();
    let files = files_of(&path, &Task::quiet()).unwrap();
    assert_eq!(files, files_of(place.path(), &Task::quiet()).unwrap());
    let mut expected: Vec<_> = [1, 3, 4, 5, 6, 7, 8].map(|n| file_of(&place, n)).into();
    expected.push(path.clone());
    expected.sort();
    expected.push(hidden.join("IM0002.DCM"));
    assert!(expected.iter().all(|f| files.contains(f)), "{files:?}");
    assert_eq!(load_all(&path).unwrap().volume, phantom::volume(&params(), &Task::quiet()));
}

#[test]
fn what_is_no_file_is_never_read() {
    let place = phantom_folder();
    let case = place.path().join("case");
    let before = files_of(&case, &Task::quiet()).unwrap();
    let pipe = case.join("IM0099.dcm");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    std::os::unix::fs::symlink("/dev/zero", case.join("IM0098.dcm")).unwrap();
    fs::create_dir(case.join(".Trash-0")).unwrap();
    fs::write(case.join(".Trash-0/IM0097.dcm"), "no DICOM").unwrap();
    assert_eq!(files_of(&case, &Task::quiet()).unwrap(), before);
    assert_eq!(before.len(), 9, "eight images and the truth beside them");
    assert!(load_all(&case).unwrap().warnings.is_empty());
    for path in [pipe.as_path(), Path::new("/dev/zero")] {
        assert!(matches!(files_of(path, &Task::quiet()), Err(Error::NotAFolder(_))), "{}", path.display());
        assert!(matches!(load_all(path), Err(Error::NotAFolder(_))), "{}", path.display());
    }
}

#[test]
fn files_that_a_dicomdir_names_and_are_not_there_are_told() {
    let place = phantom_folder();
    let path = place.path().join("DICOMDIR");
    directory(&["CASE/IM0001.DCM", "CASE/IM0009.DCM", "../secret"]).write_to_file(&path).unwrap();
    let warnings = load_all(&path).unwrap().warnings;
    assert_eq!(warnings[0].code, "ct.directory_incomplete");
    assert!(warnings[0].text.starts_with("2 of the 3 images"), "{}", warnings[0].text);
    fs::remove_dir_all(place.path().join("case")).unwrap();
    let error = load_all(&path).unwrap_err();
    assert!(matches!(error, Error::DirectoryWithoutFiles { n_named: 3, .. }), "{error}");
}

#[test]
fn a_damaged_dicomdir_stands_in_no_ones_way() {
    let place = phantom_folder();
    let path = place.path().join("DICOMDIR");
    directory(&["CASE/IM0001.DCM"]).write_to_file(&path).unwrap();
    let whole = fs::read(&path).unwrap();
    fs::write(&path, &whole[..whole.len() - 9]).unwrap();
    for path in [path.as_path(), place.path()] {
        let warnings = load_all(path).unwrap().warnings;
        assert_eq!(warnings[0].code, "ct.directory_damaged");
    }
}

#[test]
fn a_file_alone_is_one_image() {
    let place = phantom_folder();
    assert!(matches!(load_all(&file_of(&place, 3)), Err(Error::TooFewPlanes(1))));
    let found = inspect(&file_of(&place, 3), &Task::quiet()).unwrap();
    assert_eq!((found.n_files, found.series[0].verdict), (1, Verdict::Unusable));
}

#[test]
fn nested_pixels_and_sequences_of_unknown_meaning_are_passed_over() {
    let place = phantom_folder();
    for uid in [uids::IMPLICIT_VR_LITTLE_ENDIAN, uids::EXPLICIT_VR_LITTLE_ENDIAN] {
        for number in 1..=8 {
            let mut object = open_file(file_of(&place, number)).unwrap();
            let icon = item(vec![DataElement::new(
                tags::PIXEL_DATA,
                VR::OW,
                PrimitiveValue::U16(C::from_vec(vec![9; 16])),
            )]);
            object.put(sequence(tags::ICON_IMAGE_SEQUENCE, vec![icon]));
            object
                .put(sequence(Tag(0x0009, 0x1010), vec![item(vec![text(Tag(0x0009, 0x1011), VR::LO, "x")])]));
            object.update_meta(|m| m.transfer_syntax = uid.into());
            object.write_to_file(file_of(&place, number)).unwrap();
        }
        let found = load_all(place.path()).unwrap();
        assert_eq!(found.volume, phantom::volume(&params(), &Task::quiet()), "{uid}");
    }
}

/// The samples of the transfer syntaxes, or none with a message where they are absent.
fn samples() -> Option<PathBuf> {
    real("5_dicom_transfer_syntaxes")
}

fn header_of(path: &Path) -> Header {
    let header::Content::Images(mut headers) = header::read(path, &Task::quiet()).unwrap() else {
        panic!("it is an image")
    };
    headers.remove(0)
}

fn plane_of(path: &Path) -> Vec<f32> {
    let header = header_of(path);
    let mut plane = vec![0.0; header.shape.columns * header.shape.rows];
    pixels::read_plane(&header, &Inflated::default(), [false; 2], &mut plane).unwrap();
    plane
}

/// The file that a line of the reference table means: its name, or its number in a folder, from 1.
fn file_named(samples: &Path, name: &str) -> PathBuf {
    let Some((folder, number)) = name.split_once('/') else { return samples.join(name) };
    let mut files: Vec<PathBuf> =
        fs::read_dir(samples.join(folder)).unwrap().map(|e| e.unwrap().path()).collect();
    files.sort();
    files.remove(number.parse::<usize>().unwrap() - 1)
}

/// Compares the planes of files with a table of tests/tools/reference_planes.py; images that are coded in floating point, whose
/// last digit is each decoder's own, by their extremes and their sum.
fn compare(folder: &Path, table: &str, is_approximate: impl Fn(&str) -> bool) {
    for line in table.lines() {
        let fields: Vec<&str> = line.splitn(5, ' ').collect();
        let [hash, least, most, sum, name] = fields[..] else { panic!("{line}") };
        let plane = plane_of(&file_named(folder, name));
        let bytes: Vec<u8> = plane.iter().flat_map(|v| v.to_le_bytes()).collect();
        let (a, b) = plane.iter().fold((f32::MAX, f32::MIN), |(a, b), &v| (a.min(v), b.max(v)));
        if is_approximate(name) {
            let total: f64 = plane.iter().map(|&v| f64::from(v)).sum();
            let mean_difference = (total - sum.parse::<f64>().unwrap()).abs() / plane.len() as f64;
            // A decoder that computes cosines in integers is off by some hundredths on average, and by one here and there.
            assert!(mean_difference < 0.05, "{name}: {mean_difference}");
            assert!((a - least.parse::<f32>().unwrap()).abs() <= 1.0, "{name}: {a}, not {least}");
            assert!((b - most.parse::<f32>().unwrap()).abs() <= 1.0, "{name}: {b}, not {most}");
        } else {
            assert_eq!(
                blake3::hash(&bytes).to_hex().as_str(),
                hash,
                "{name}: {a} to {b}, not {least} to {most}"
            );
        }
    }
}

#[test]
fn every_sample_decodes_to_the_planes_of_an_independent_decoder() {
    let Some(samples) = samples() else { return };
    let table = include_str!("../../../tests/golden/transfer_syntaxes.txt");
    compare(&samples, table, |name| name.contains("J2KI"));
}

/// A folder with files and their table `planes.txt`, named in the environment: for collections that cannot be kept here.
#[test]
#[ignore = "needs a folder of files, named in LUMENFAB_REFERENCE_PLANES"]
fn a_collection_decodes_to_the_planes_of_its_table() {
    let folder = std::env::var_os("LUMENFAB_REFERENCE_PLANES").map(PathBuf::from).unwrap();
    let table = fs::read_to_string(folder.join("planes.txt")).unwrap();
    compare(&folder, &table, |name| name.contains("approximate"));
}

#[test]
fn near_lossless_samples_keep_their_promise() {
    let Some(samples) = samples() else { return };
    for series in ["CT1", "CT2"] {
        let original = plane_of(&samples.join(format!("{series}_RLE.dcm")));
        let path = samples.join(format!("{series}_JLSN.dcm"));
        let worst = plane_of(&path)
            .iter()
            .zip(&original)
            // Padding becomes air by its exact value, which lossy compression does not keep: left out.
            .filter(|(_, b)| **b > -1024.0)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max);
        let bytes = fs::read(&path).unwrap();
        let scan = bytes.windows(4).position(|w| w == [0xff, 0xda, 0, 8]).unwrap();
        let near = f32::from(bytes[scan + 7]);
        assert!(near > 0.0 && worst <= near, "{series}: {worst}, NEAR {near}");
    }
}

#[test]
fn lossy_samples_are_read_with_a_warning() {
    let Some(samples) = samples() else { return };
    for (name, is_lossy) in [("CT1_J2KI", true), ("CT1_JLSN", true), ("CT1_J2KR", false), ("CT1_RLE", false)]
    {
        let header = header_of(&samples.join(format!("{name}.dcm")));
        let codes: Vec<String> =
            crate::ct::encoding::warnings(&[header]).into_iter().map(|w| w.code).collect();
        assert_eq!(codes == ["ct.lossy"], is_lossy, "{name}: {codes:?}");
    }
}

#[test]
fn damaged_multi_frame_objects_never_panic() {
    let place = phantom_folder();
    let object = compressed(enhanced(&place, &one_stack()), 2, true);
    let path = place.path().join("object.dcm");
    object.write_to_file(&path).unwrap();
    let whole = fs::read(&path).unwrap();
    let pixels = whole.windows(4).rposition(|w| w == [0xe0, 0x7f, 0x10, 0]).unwrap();
    for at in (132..pixels + 400).step_by(3) {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x5a;
        fs::write(&path, bytes).unwrap();
        // Read or refused, whichever; in little memory.
        let _outcome = load_all(&path);
    }
}

#[test]
fn damaged_samples_never_panic() {
    let Some(samples) = samples() else { return };
    // A linear congruential generator: the same damage in every run.
    let mut state = 1_u64;
    let mut random = |n: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        usize::try_from(state >> 33).unwrap() % n
    };
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("damaged.dcm");
    for name in ["CT2_RLE", "CT2_JPLL", "CT2_JLSL", "CT2_JLSN", "CT2_J2KR", "CT2_J2KI"] {
        let whole = fs::read(samples.join(format!("{name}.dcm"))).unwrap();
        for _ in 0..25 {
            let mut bytes = whole.clone();
            for _ in 0..=random(4) {
                let at = 132 + random(bytes.len() - 132);
                bytes[at] = u8::try_from(random(256)).unwrap();
            }
            if random(3) == 0 {
                bytes.truncate(132 + random(bytes.len() - 132));
            }
            fs::write(&path, bytes).unwrap();
            let Ok(header::Content::Images(headers)) = header::read(&path, &Task::quiet()) else { continue };
            let mut plane = vec![0.0; headers[0].shape.columns * headers[0].shape.rows];
            // Read or refused, whichever.
            let _outcome = pixels::read_plane(&headers[0], &Inflated::default(), [false; 2], &mut plane);
        }
    }
    assert!(!is_decoding());
}
