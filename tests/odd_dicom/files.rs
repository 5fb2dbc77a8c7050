//! What is damaged or odd about files and folders.

use super::folder::*;
use dicom_core::VR;
use dicom_dictionary_std::tags;
use lumenfab::ct::reader::{self, Options};
use lumenfab::ct::{SeriesChoice, Verdict};
use lumenfab::progress::Task;
use std::ffi::OsStr;
use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;

#[test]
fn files() {
    let rows: &[Row] = &[
        ("sound", |_| {}, Ok(&[])),
        (
            "empty folder",
            |f| {
                fs::remove_dir_all(f.path()).unwrap();
                fs::create_dir(f.path()).unwrap();
            },
            Err("ct holds no file: name the folder that holds the DICOM files of the series"),
        ),
        (
            "no folder",
            |f| fs::remove_dir_all(f.path()).unwrap(),
            Err(
                "cannot read ct: No such file or directory (os error 2): check that it exists and may be read",
            ),
        ),
        (
            "text files only",
            |f| {
                (1..=N_PLANES).for_each(|n| fs::remove_file(f.file(n)).unwrap());
                fs::write(f.path().join("note.txt"), "no image").unwrap();
            },
            Err(
                "ct holds no DICOM file among its 2: name the folder of a series as the scanner or archive exports it",
            ),
        ),
        (
            "empty file called DICOM",
            |f| fs::write(f.file(3), "").unwrap(),
            Err(
                "ct/IM0003.dcm: damaged DICOM file (the mark DICM is missing): copy or export it again; it names no series that could be read here: if it is none of the planes that are wanted, take it out of the folder",
            ),
        ),
        (
            "text called DICOM",
            |f| fs::write(f.file(3), "not DICOM at all").unwrap(),
            Err(
                "ct/IM0003.dcm: damaged DICOM file (the mark DICM is missing): copy or export it again; it names no series that could be read here: if it is none of the planes that are wanted, take it out of the folder",
            ),
        ),
        (
            "no preamble and mark",
            |f| {
                let bytes = fs::read(f.file(3)).unwrap();
                fs::write(f.file(3), &bytes[132..]).unwrap();
            },
            Ok(&[
                "ct.no_preamble: 1 file(s) begin without the preamble and mark of DICOM: they were taken for what their first elements say",
            ]),
        ),
        (
            "empty file with another name",
            |f| fs::write(f.path().join("VERSION"), "").unwrap(),
            Ok(&["ct.not_dicom: 1 file(s) that are not DICOM left out"]),
        ),
        ("hidden file", |f| fs::write(f.path().join(".DS_Store"), "x").unwrap(), Ok(&[])),
        ("folder called as a file", |f| fs::create_dir(f.path().join("IM0009.dcm")).unwrap(), Ok(&[])),
        (
            "link that leads round in a circle",
            |f| symlink(f.path(), f.path().join("again")).unwrap(),
            Ok(&[]),
        ),
        ("link that leads to itself", |f| symlink("self", f.path().join("self")).unwrap(), Ok(&[])),
        ("link to nowhere", |f| symlink("/nowhere", f.path().join("gone.dcm")).unwrap(), Ok(&[])),
        (
            "file names that are no UTF-8",
            |f| {
                let name = OsStr::from_bytes(b"\xff\xfe image.dcm");
                fs::rename(f.file(2), f.path().join(name)).unwrap();
            },
            Ok(&[]),
        ),
        (
            "images in folders of their own",
            |f| {
                for n in 1..=N_PLANES {
                    fs::create_dir(f.path().join(n.to_string())).unwrap();
                    fs::rename(f.file(n), f.path().join(format!("{n}/image"))).unwrap();
                }
            },
            Ok(&[]),
        ),
    ];
    check(rows, false);
}

#[test]
fn truncated_and_damaged() {
    let rows: &[Row] = &[
        (
            "ends within its preamble",
            |f| f.cut(|_| 100),
            Err(
                "ct/IM0004.dcm: damaged DICOM file (the mark DICM is missing): copy or export it again; it names no series that could be read here: if it is none of the planes that are wanted, take it out of the folder",
            ),
        ),
        (
            "ends behind its mark",
            |f| f.cut(|_| 132),
            Err(
                "ct/IM0004.dcm: damaged DICOM file (its header cannot be parsed): copy or export it again; it names no series that could be read here: if it is none of the planes that are wanted, take it out of the folder",
            ),
        ),
        (
            "ends within the file meta group",
            |f| f.cut(|_| 170),
            Err(
                "ct/IM0004.dcm: damaged DICOM file (an element runs beyond the end of the file): copy or export it again; it names no series that could be read here: if it is none of the planes that are wanted, take it out of the folder",
            ),
        ),
        (
            "ends within an element of its header",
            |f| f.cut(|n| n - PIXEL_BYTES - 40),
            Err("ct/IM0004.dcm: damaged DICOM file (it ends within its header): copy or export it again"),
        ),
        (
            "ends before its pixels",
            |f| f.cut(|n| n - PIXEL_BYTES),
            Err("ct/IM0004.dcm: truncated: 0 bytes, its pixels need 1152: copy or export it again"),
        ),
        (
            "ends in the middle of its pixels",
            |f| f.cut(|n| n - PIXEL_BYTES / 2),
            Err("ct/IM0004.dcm: truncated: 576 bytes, its pixels need 1152: copy or export it again"),
        ),
        (
            "lacks its last byte",
            |f| f.cut(|n| n - 1),
            Err("ct/IM0004.dcm: truncated: 1151 bytes, its pixels need 1152: copy or export it again"),
        ),
        (
            "fewer pixels than rows and columns",
            |f| f.edit(2, |o| put_pixels(o, vec![0; 100])),
            Err("ct/IM0002.dcm: truncated: 200 bytes, its pixels need 1152: copy or export it again"),
        ),
        (
            "no pixels at all",
            |f| {
                f.edit(2, |o| {
                    o.remove_element(tags::PIXEL_DATA);
                })
            },
            Err("ct/IM0002.dcm: damaged DICOM file (it holds no pixels): copy or export it again"),
        ),
        (
            "claims 67 million pixels",
            |f| {
                f.edit_all(|_, o| {
                    put_number(o, tags::ROWS, 8192);
                    put_number(o, tags::COLUMNS, 8192);
                })
            },
            Err("ct/IM0001.dcm: truncated: 1152 bytes, its pixels need 134217728: copy or export it again"),
        ),
        (
            "claims 67 million compressed pixels",
            |f| {
                f.edit_all(|_, o| {
                    put_number(o, tags::ROWS, 8192);
                    put_number(o, tags::COLUMNS, 8192);
                    compressed(o, "1.2.840.10008.1.2.5", vec![0; 64]);
                })
            },
            Err("ct/IM0001.dcm: truncated: 64 bytes, its pixels need 2097216: copy or export it again"),
        ),
        (
            "claims an element of 4 GB",
            |f| {
                let mut bytes = fs::read(f.file(4)).unwrap();
                let n = bytes.len() - PIXEL_BYTES;
                bytes[n - 4..n].copy_from_slice(&0xffff_fff0_u32.to_le_bytes());
                fs::write(f.file(4), bytes).unwrap();
            },
            Err("ct/IM0004.dcm: truncated: 1152 bytes, its pixels need 4294967280: copy or export it again"),
        ),
        (
            "compressed as a film",
            |f| f.edit_all(|_, o| compressed(o, "1.2.840.10008.1.2.4.100", vec![1; 64])),
            Err(
                "ct/IM0001.dcm: compressed as an unknown transfer syntax, which is not supported: export the series uncompressed (explicit VR little endian)",
            ),
        ),
        ("a private sequence in implicit encoding", |f| f.insert(&unknown_sequence(4)), Ok(&[])),
        (
            "two private sequences in implicit encoding, side by side",
            |f| f.insert(&[unknown_sequence(4), unknown_sequence(4)].concat()),
            Ok(&[]),
        ),
        (
            "the second of two private sequences with an element too long",
            |f| f.insert(&[unknown_sequence(4), unknown_sequence(0xffff_fff0)].concat()),
            Err(
                "ct/IM0004.dcm: damaged DICOM file (an element runs beyond the end of the file): copy or export it again",
            ),
        ),
        (
            "a private sequence with an element too long",
            |f| f.insert(&unknown_sequence(0xffff_fff0)),
            Err(
                "ct/IM0004.dcm: damaged DICOM file (an element runs beyond the end of the file): copy or export it again",
            ),
        ),
        (
            "a quarter of a number",
            |f| f.insert(b"\x01\x70\x12\x10FD\x02\0\x01\0"),
            Err(
                "ct/IM0004.dcm: damaged DICOM file (the length of an element is no whole number of its values): copy or export it again",
            ),
        ),
        (
            "a private sequence without an end",
            |f| f.insert(&unknown_sequence(4)[..36]),
            Err(
                "ct/IM0004.dcm: damaged DICOM file (something stands between the items of a sequence): copy or export it again",
            ),
        ),
        (
            "an item outside of a sequence, of 2 GB",
            |f| f.insert(&[0xfe, 0xff, 0x00, 0xe0, 0xff, 0xff, 0xff, 0x7f]),
            Err(
                "ct/IM0004.dcm: damaged DICOM file (an item stands outside of a sequence): copy or export it again",
            ),
        ),
        (
            "a mark of items that there is not, of no stated length",
            |f| f.insert(&[0xfe, 0xff, 0xf1, 0x1f, 0xff, 0xff, 0xff, 0xff]),
            Err(
                "ct/IM0004.dcm: damaged DICOM file (a mark of items is none that there is): copy or export it again",
            ),
        ),
        (
            "an element between the items of a sequence",
            |f| f.insert(b"\x01\x70\x10\x10SQ\0\0\xff\xff\xff\xff\x01\x70\x11\x10UN\0\0\xf0\xff\xff\xff"),
            Err(
                "ct/IM0004.dcm: damaged DICOM file (something stands between the items of a sequence): copy or export it again",
            ),
        ),
        (
            "run lengths that lead nowhere",
            |f| f.edit_all(|_, o| compressed(o, "1.2.840.10008.1.2.5", vec![0xff; 200])),
            Err(
                "ct/IM0001.dcm: the run-length pixels have another number of segments than bytes per pixel (RLE): copy or export it again, uncompressed (explicit VR little endian) if it persists",
            ),
        ),
    ];
    check(rows, false);
}

#[test]
fn a_file_that_may_not_be_read_is_named() {
    let folder = Folder::new();
    fs::set_permissions(folder.file(3), fs::Permissions::from_mode(0o000)).unwrap();
    if fs::read(folder.file(3)).is_ok() {
        eprintln!("skipped: the system lets this user (root?) read every file");
        return;
    }
    let expected =
        "cannot read ct/IM0003.dcm: Permission denied (os error 13): check that it exists and may be read";
    assert_eq!(folder.said(false).unwrap_err(), expected);
}

/// Two series of eight planes each; what is told of each when image 3 of the second is what `damage` makes of it.
fn told_of_two_series(damage: fn(Vec<u8>) -> Vec<u8>) -> [(Result<Vec<String>, String>, Verdict); 2] {
    let folder = Folder::new();
    folder.doubled(|o| put(o, tags::SERIES_INSTANCE_UID, VR::UI, "1.2.3"));
    let file = folder.path().join("Z3.dcm");
    fs::write(&file, damage(fs::read(&file).unwrap())).unwrap();
    let inspection = reader::inspect(&folder.path(), &Task::quiet()).unwrap();
    [1, 2].map(|number| {
        let options = Options { choice: SeriesChoice::ByNumber(number), ..Options::default() };
        let loaded = reader::load_with(&folder.path(), &options, &Task::quiet());
        let texts =
            loaded.map(|l| l.warnings.into_iter().map(|w| format!("{}: {}", w.code, w.text)).collect());
        let name = |p: &Path| p.strip_prefix(folder.path()).unwrap_or(p).display().to_string();
        (texts.map_err(|e| e.text_with(name)), inspection.series[number - 1].verdict)
    })
}

#[test]
fn a_damaged_file_spoils_the_series_that_it_names_and_all_where_it_names_none() {
    let [first, second] = told_of_two_series(|bytes| bytes[..bytes.len() - 100].to_vec());
    let told = vec!["ct.damaged_elsewhere: 1 damaged file(s) of other series left out".to_owned()];
    assert_eq!(first, (Ok(told), Verdict::Usable));
    let truncated = "Z3.dcm: truncated: 1052 bytes, its pixels need 1152: copy or export it again".to_owned();
    assert_eq!(second, (Err(truncated), Verdict::Unusable));
    let unmarked = "Z3.dcm: damaged DICOM file (the mark DICM is missing): copy or export it again; it names no series that could be read here: if it is none of the planes that are wanted, take it out of the folder";
    for told in told_of_two_series(|bytes| bytes[..100].to_vec()) {
        assert_eq!(told, (Err(unmarked.to_owned()), Verdict::Unusable));
    }
    // A UID that no readable file has tells nothing: it may be the damage.
    let other_uid = |bytes: Vec<u8>| {
        let at = bytes.windows(5).rposition(|w| w == b"1.2.3").unwrap();
        [&bytes[..at], b"1.2.9", &bytes[at + 5..bytes.len() - 100]].concat()
    };
    let unknown = "Z3.dcm: truncated: 1052 bytes, its pixels need 1152: copy or export it again; it names no series that could be read here: if it is none of the planes that are wanted, take it out of the folder";
    for told in told_of_two_series(other_uid) {
        assert_eq!(told, (Err(unknown.to_owned()), Verdict::Unusable));
    }
}

#[test]
fn a_damaged_report_beside_one_series_says_that_it_may_be_taken_out() {
    let folder = Folder::new();
    folder.copy(3, &folder.path().join("report.dcm"), |o| put(o, tags::SERIES_INSTANCE_UID, VR::UI, "1.2.9"));
    let file = folder.path().join("report.dcm");
    let bytes = fs::read(&file).unwrap();
    fs::write(&file, &bytes[..bytes.len() - 100]).unwrap();
    let way_out = "truncated: 1052 bytes, its pixels need 1152: copy or export it again; it names no series that could be read here: if it is none of the planes that are wanted, take it out of the folder";
    assert_eq!(folder.said(false).unwrap_err(), format!("ct/report.dcm: {way_out}"));
    let inspection = reader::inspect(&folder.path(), &Task::quiet()).unwrap();
    assert_eq!(inspection.series[0].reason.as_deref(), Some(&*format!("a file of the folder: {way_out}")));
}
