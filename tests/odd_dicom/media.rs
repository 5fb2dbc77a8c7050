//! What is damaged or odd about directories of files (DICOMDIR) and about compressed pixels, by the faults that each codec finds.

use super::folder::*;
use dicom_core::value::{DataSetSequence, PrimitiveValue};
use dicom_core::{DataElement, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject};
use std::fs;

/// Writes a DICOMDIR that names these files.
fn directory(folder: &Folder, names: &[&str]) {
    let record = |name: &&str| {
        let mut record = InMemDicomObject::new_empty();
        let mut put = |tag, vr, text: &str| record.put(DataElement::new(tag, vr, PrimitiveValue::from(text)));
        put(tags::DIRECTORY_RECORD_TYPE, VR::CS, "IMAGE");
        put(tags::REFERENCED_FILE_ID, VR::CS, name);
        record
    };
    let mut object = InMemDicomObject::new_empty();
    for (tag, uid) in
        [(tags::SOP_CLASS_UID, uids::MEDIA_STORAGE_DIRECTORY_STORAGE), (tags::SOP_INSTANCE_UID, "2.25.3")]
    {
        object.put(DataElement::new(tag, VR::UI, PrimitiveValue::from(uid)));
    }
    let records = DataSetSequence::from(names.iter().map(record).collect::<Vec<_>>());
    object.put(DataElement::new(tags::DIRECTORY_RECORD_SEQUENCE, VR::SQ, records));
    let meta = FileMetaTableBuilder::new().transfer_syntax(uids::EXPLICIT_VR_LITTLE_ENDIAN);
    object.with_meta(meta).unwrap().write_to_file(folder.path().join("DICOMDIR")).unwrap();
}

#[test]
fn directories() {
    let rows: &[Row] = &[
        ("a sound one", |f| directory(f, &["IM0001.DCM", "IM0008.DCM"]), Ok(&[])),
        ("one that names nothing", |f| directory(f, &[]), Ok(&[])),
        (
            "one whose files are not all there",
            |f| directory(f, &["IM0001.DCM", "IM0009.DCM", "../secret"]),
            Ok(&[
                "ct.directory_incomplete: 2 of the 3 images that the DICOMDIR names are not there: planes may be missing; copy the whole medium",
            ]),
        ),
        (
            "one without any of its files",
            |f| {
                (1..=N_PLANES).for_each(|n| fs::remove_file(f.file(n)).unwrap());
                directory(f, &["A/IM0001.DCM", "A/IM0002.DCM"]);
            },
            Err(
                "ct/DICOMDIR: none of the 2 files that this DICOMDIR names is there: copy the whole medium, folders included",
            ),
        ),
        (
            "one that ends early",
            |f| {
                directory(f, &["IM0001.DCM"]);
                let path = f.path().join("DICOMDIR");
                let bytes = fs::read(&path).unwrap();
                fs::write(&path, &bytes[..bytes.len() - 9]).unwrap();
            },
            Ok(&[
                "ct.directory_damaged: a DICOMDIR cannot be read: whether all files that it names are there is not known",
            ]),
        ),
        (
            "text called one",
            |f| fs::write(f.path().join("DICOMDIR"), "no directory").unwrap(),
            Ok(&["ct.not_dicom: 1 file(s) that are not DICOM left out"]),
        ),
    ];
    check(rows, false);
}

/// All images compressed, the bytes of a sound stream changed.
fn packed(folder: &Folder, syntax: &str, name: &str, change: impl Fn(&mut Vec<u8>)) {
    let mut bytes = golden(name);
    let [columns, rows] = if name.ends_with("jls") { [29, 23] } else { [37, 33] };
    change(&mut bytes);
    folder.edit_all(|_, o| {
        put_number(o, tags::COLUMNS, columns);
        put_number(o, tags::ROWS, rows);
        compressed(o, syntax, bytes.clone());
    });
}

const JPEG_LS: &str = "1.2.840.10008.1.2.4.80";
const JPEG_2000: &str = "1.2.840.10008.1.2.4.90";

#[test]
fn compressed_pixels() {
    let rows: &[Row] = &[
        ("sound JPEG-LS", |f| packed(f, JPEG_LS, "bits12_near0.jls", |_| {}), Ok(&[])),
        ("sound JPEG 2000", |f| packed(f, JPEG_2000, "bits12_unsigned.j2k", |_| {}), Ok(&[])),
        (
            "JPEG-LS that ends early",
            |f| packed(f, JPEG_LS, "bits12_near0.jls", |b| b.truncate(b.len() / 2)),
            Err(
                "ct/IM0001.dcm: the compressed pixels end early (JPEG-LS): copy or export it again, uncompressed (explicit VR little endian) if it persists",
            ),
        ),
        (
            "JPEG-LS without its mark",
            |f| packed(f, JPEG_LS, "bits12_near0.jls", |b| b[1] = 0),
            Err(
                "ct/IM0001.dcm: the compressed pixels do not begin with the mark of an image (JPEG-LS): copy or export it again, uncompressed (explicit VR little endian) if it persists",
            ),
        ),
        (
            "JPEG-LS of another size",
            |f| {
                packed(f, JPEG_LS, "bits12_near0.jls", |_| {});
                f.edit_all(|_, o| put_number(o, tags::ROWS, 24));
            },
            Err(
                "ct/IM0001.dcm: the compressed image has 29 x 23 pixels, the header says 29 x 24 (JPEG-LS): copy or export it again, uncompressed (explicit VR little endian) if it persists",
            ),
        ),
        (
            "JPEG 2000 that ends early",
            |f| packed(f, JPEG_2000, "bits12_unsigned.j2k", |b| b.truncate(b.len() / 2)),
            Err(
                "ct/IM0001.dcm: the JPEG 2000 pixels cannot be decoded (JPEG 2000 lossless): copy or export it again, uncompressed (explicit VR little endian) if it persists",
            ),
        ),
        (
            "JPEG 2000 without a codestream",
            |f| packed(f, JPEG_2000, "bits12_unsigned.j2k", |b| b[1] = 0),
            Err(
                "ct/IM0001.dcm: the compressed pixels hold no JPEG 2000 codestream (JPEG 2000 lossless): copy or export it again, uncompressed (explicit VR little endian) if it persists",
            ),
        ),
        (
            "JPEG 2000 of another size",
            |f| {
                packed(f, JPEG_2000, "bits12_unsigned.j2k", |_| {});
                f.edit_all(|_, o| put_number(o, tags::ROWS, 24));
            },
            Err(
                "ct/IM0001.dcm: the compressed image has 37 x 33 pixels, the header says 37 x 24 (JPEG 2000 lossless): copy or export it again, uncompressed (explicit VR little endian) if it persists",
            ),
        ),
        (
            "JPEG that is none",
            |f| packed(f, "1.2.840.10008.1.2.4.70", "bits12_near0.jls", |b| b.fill(0x55)),
            Err(
                "ct/IM0001.dcm: the compressed pixels do not begin with the mark of an image (JPEG lossless, first-order): copy or export it again, uncompressed (explicit VR little endian) if it persists",
            ),
        ),
    ];
    check(rows, false);
}
