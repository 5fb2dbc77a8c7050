//! Files without their preamble, and what one damaged file stands in the way of.

use super::*;
use dicom_dictionary_std::uids;

/// Takes the first bytes of every file away: the preamble and its mark; the meta group as well.
fn without_beginning(case: &Case, syntax: &str, has_meta: bool) {
    for number in 1..=8 {
        let path = case.file(number);
        let mut object = open_file(&path).unwrap();
        object.update_meta(|meta| meta.transfer_syntax = syntax.into());
        object.write_to_file(&path).unwrap();
        let bytes = fs::read(&path).unwrap();
        // The group's length counts from behind its own element, which is 12 bytes long.
        let group = u32::from_le_bytes(bytes[140..144].try_into().unwrap());
        let start = if has_meta { 132 } else { 144 + group as usize };
        fs::write(&path, &bytes[start..]).unwrap();
    }
}

#[test]
fn files_without_preamble_are_read_as_they_are_with_it() {
    let whole = Case::new().load().unwrap();
    for (syntax, has_meta) in [
        (uids::EXPLICIT_VR_LITTLE_ENDIAN, true),
        (uids::EXPLICIT_VR_LITTLE_ENDIAN, false),
        (uids::IMPLICIT_VR_LITTLE_ENDIAN, true),
        (uids::IMPLICIT_VR_LITTLE_ENDIAN, false),
        (uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN, true),
    ] {
        let case = Case::new();
        without_beginning(&case, syntax, has_meta);
        let bare = case.load().unwrap();
        assert_eq!(bare.volume, whole.volume, "{syntax} {has_meta}");
        let told: Vec<String> = bare.warnings.iter().map(|w| format!("{}: {}", w.code, w.text)).collect();
        assert_eq!(
            told,
            [
                "ct.no_preamble: 8 file(s) begin without the preamble and mark of DICOM: they were taken for what their first elements say"
            ]
        );
        // One that ends early is told as any other.
        let bytes = fs::read(case.file(3)).unwrap();
        fs::write(case.file(3), &bytes[..bytes.len() - 9]).unwrap();
        let error = case.error().to_string();
        assert!(error.contains("IM0003.dcm"), "{error}");
    }
}

/// Two series in folders of their own, `a` and `b`.
fn two_folders() -> Case {
    let case = Case::of(&params(), "a");
    phantom::series::write(&case.dir().join("b"), &Params { seed: 2, ..params() }, &Task::quiet()).unwrap();
    for entry in fs::read_dir(case.dir().join("b")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "dcm") {
            let mut object = open_file(&path).unwrap();
            put(&mut object, tags::SERIES_INSTANCE_UID, VR::UI, "2.25.77");
            object.write_to_file(&path).unwrap();
        }
    }
    case
}

#[test]
fn a_damaged_file_that_names_no_series_stands_in_the_way_of_its_own_folder_alone() {
    let case = two_folders();
    fs::write(case.dir().join("b/IM0009.dcm"), "no DICOM at all").unwrap();
    let chosen = |number| load(&case.dir(), &SeriesChoice::ByNumber(number), &Task::quiet());
    let (first, second) = (chosen(1), chosen(2));
    assert!(first.is_ok() != second.is_ok(), "{first:?} {second:?}");
    let (sound, error) = if let Ok(sound) = first {
        (sound, second.unwrap_err())
    } else {
        (second.unwrap(), first.unwrap_err())
    };
    let text = error.to_string();
    assert!(text.contains("b/IM0009.dcm: damaged DICOM file"), "{text}");
    assert!(
        text.ends_with("if it is none of the planes that are wanted, take it out of the folder"),
        "{text}"
    );
    assert_eq!(error.code(), "ct.damaged");
    assert!(sound.warnings.iter().any(|w| w.code == "ct.damaged_elsewhere"), "{:?}", sound.warnings);
    // Beside no image it may be a plane of any.
    fs::rename(case.dir().join("b/IM0009.dcm"), case.dir().join("IM0009.dcm")).unwrap();
    assert!(chosen(1).is_err() && chosen(2).is_err());
}
