//! Damaged and odd DICOM input: one fault a series, and exactly what is said about it.
//!
//! Every row takes a sound series of eight planes and does one thing to it. What it then says is compared word for
//! word (paths as names below the folder), by reading and by inspecting: a series that cannot be read must be unusable, and one that
//! can must not be. Nothing may panic, and no length that a header claims may be believed before it is checked.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]

use dicom_core::value::{C, DataSetSequence, PixelFragmentSequence, PrimitiveValue, Value};
use dicom_core::{DataElement, Tag, VR};
use dicom_dictionary_std::tags;
use dicom_object::{DefaultDicomObject, InMemDicomObject, open_file};
use lumenfab::ct::reader::{self, Options};
use lumenfab::ct::{SeriesChoice, Verdict};
use lumenfab::phantom::{self, Kind, Params};
use lumenfab::progress::Task;
use std::ffi::OsStr;
use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};

const N_PLANES: usize = 8;
/// Bytes of the pixels of one image.
const PIXEL_BYTES: usize = 24 * 24 * 2;

/// A folder with a sound series, to be damaged.
struct Folder {
    place: tempfile::TempDir,
}

impl Folder {
    fn new() -> Self {
        let folder = Self { place: tempfile::tempdir().unwrap() };
        let params =
            Params { kind: Kind::Tube, n_planes: N_PLANES, n_pixels: 24, pixel_mm: 0.5, ..Params::default() };
        phantom::series::write(&folder.path(), &params, &Task::quiet()).unwrap();
        folder
    }

    fn path(&self) -> PathBuf {
        self.place.path().join("ct")
    }

    fn file(&self, number: usize) -> PathBuf {
        self.path().join(format!("IM{number:04}.dcm"))
    }

    fn edit(&self, number: usize, change: impl Fn(&mut DefaultDicomObject)) {
        self.copy(number, &self.file(number), change);
    }

    fn copy(&self, number: usize, to: &Path, change: impl Fn(&mut DefaultDicomObject)) {
        let mut object = open_file(self.file(number)).unwrap();
        change(&mut object);
        object.write_to_file(to).unwrap();
    }

    fn edit_all(&self, change: impl Fn(usize, &mut DefaultDicomObject)) {
        (1..=N_PLANES).for_each(|n| self.edit(n, |o| change(n, o)));
    }

    /// The text of one attribute changed in image 2.
    fn put(&self, tag: Tag, vr: VR, value: &str) {
        self.edit(2, |o| put(o, tag, vr, value));
    }

    fn cut(&self, keep: impl Fn(usize) -> usize) {
        let bytes = fs::read(self.file(4)).unwrap();
        fs::write(self.file(4), &bytes[..keep(bytes.len())]).unwrap();
    }

    /// Bytes put before the pixel data of image 4.
    fn insert(&self, bytes: &[u8]) {
        let mut file = fs::read(self.file(4)).unwrap();
        let at = file.len() - PIXEL_BYTES - 12;
        assert_eq!(file[at..at + 4], [0xe0, 0x7f, 0x10, 0]);
        file.splice(at..at, bytes.iter().copied());
        fs::write(self.file(4), file).unwrap();
    }

    /// A second set of images at the same places, told apart by the given change.
    fn doubled(&self, change: impl Fn(&mut DefaultDicomObject)) {
        for n in 1..=N_PLANES {
            self.copy(n, &self.path().join(format!("Z{n}.dcm")), |o| {
                put(o, tags::SOP_INSTANCE_UID, VR::UI, &format!("2.25.{n}"));
                change(o);
            });
        }
    }

    /// What is said about it, paths as names below the folder: an error, or warnings.
    fn said(&self, allow_gaps: bool) -> Result<Vec<String>, String> {
        let options = Options { choice: SeriesChoice::Only, allow_gaps, ..Options::default() };
        let loaded = reader::load_with(&self.path(), &options, &Task::quiet());
        let below = |path: &Path| {
            let name = path.strip_prefix(self.place.path()).unwrap_or(path);
            name.display().to_string()
        };
        match loaded {
            Ok(loaded) => Ok(loaded.warnings.iter().map(|w| format!("{}: {}", w.code, w.text)).collect()),
            Err(error) => Err(error.text_with(below)),
        }
    }

    /// Whether an inspection finds every series usable; none where it cannot be made at all.
    fn is_usable(&self) -> Option<bool> {
        let inspection = reader::inspect(&self.path(), &Task::quiet()).ok()?;
        let text = format!("{inspection}{}", serde_json::to_string(&inspection).unwrap());
        let folder = self.place.path().display().to_string();
        assert!(!text.contains(&folder) && !text.contains("IM000"), "an inspection names no path: {text}");
        Some(inspection.series.iter().all(|s| s.verdict != Verdict::Unusable))
    }
}

fn put(object: &mut DefaultDicomObject, tag: Tag, vr: VR, value: &str) {
    object.put(DataElement::new(tag, vr, PrimitiveValue::from(value)));
}

fn put_number(object: &mut DefaultDicomObject, tag: Tag, value: u16) {
    object.put(DataElement::new(tag, VR::US, PrimitiveValue::from(value)));
}

fn put_pixels(object: &mut DefaultDicomObject, pixels: Vec<u16>) {
    object.put(DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(C::from_vec(pixels))));
}

fn place(object: &mut DefaultDicomObject, [x, y, z]: [f64; 3]) {
    put(object, tags::IMAGE_POSITION_PATIENT, VR::DS, &format!("{x}\\{y}\\{z}"));
}

/// Height of image n, from 1.
fn z(n: usize) -> f64 {
    3.0 * (n as f64 - 1.0)
}

fn compressed(object: &mut DefaultDicomObject, syntax: &str, bytes: Vec<u8>) {
    let fragments = PixelFragmentSequence::new_fragments(C::from_vec(vec![bytes]));
    object.put(DataElement::new(tags::PIXEL_DATA, VR::OB, Value::PixelSequence(fragments)));
    object.update_meta(|m| m.transfer_syntax = syntax.into());
}

/// A private sequence of undefined length as PS3.5 6.2.2 has it in a file of explicit encoding: UN, its content implicit. The one
/// element in it claims `length` bytes and has 4.
fn unknown_sequence(length: u32) -> Vec<u8> {
    let item = [&[0xfe, 0xff, 0x00, 0xe0, 0xff, 0xff, 0xff, 0xff][..], &[1, 0x70, 0x11, 0x10]].concat();
    let ends = [0xfe, 0xff, 0x0d, 0xe0, 0, 0, 0, 0, 0xfe, 0xff, 0xdd, 0xe0, 0, 0, 0, 0];
    [b"\x01\x70\x10\x10UN\0\0\xff\xff\xff\xff", &item[..], &length.to_le_bytes(), b"ABCD", &ends].concat()
}

/// One fault: its name, what does it, and what is said.
type Row = (&'static str, fn(&Folder), Result<&'static [&'static str], &'static str>);

/// The rows of `rows`, checked one by one; all that differ are told at once.
fn check(rows: &[Row], allow_gaps: bool) {
    let mut wrong = Vec::new();
    for (name, damage, expected) in rows {
        let folder = Folder::new();
        damage(&folder);
        let said = folder.said(allow_gaps);
        let expected = expected.map(|w| w.iter().map(|t| (*t).to_owned()).collect()).map_err(str::to_owned);
        if said != expected {
            wrong.push(format!("{name}\n   found    {said:?}\n   expected {expected:?}"));
        }
        let agrees = match folder.is_usable() {
            None => said.is_err(),
            // Several good series are usable, each for itself.
            Some(true) => said.as_ref().map_or_else(|e| e.contains("choose one by its number"), |_| true),
            Some(false) => said.is_err() || allow_gaps,
        };
        if !agrees {
            wrong.push(format!("{name}\n   inspection disagrees with {said:?}"));
        }
    }
    assert!(wrong.is_empty(), "{} of {} rows:\n{}", wrong.len(), rows.len(), wrong.join("\n"));
}

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
            Err("ct/IM0003.dcm: damaged DICOM file (the mark DICM is missing): copy or export it again"),
        ),
        (
            "text called DICOM",
            |f| fs::write(f.file(3), "not DICOM at all").unwrap(),
            Err("ct/IM0003.dcm: damaged DICOM file (the mark DICM is missing): copy or export it again"),
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
            Err("ct/IM0004.dcm: damaged DICOM file (the mark DICM is missing): copy or export it again"),
        ),
        (
            "ends behind its mark",
            |f| f.cut(|_| 132),
            Err("ct/IM0004.dcm: damaged DICOM file (its header cannot be parsed): copy or export it again"),
        ),
        (
            "ends within the file meta group",
            |f| f.cut(|_| 170),
            Err(
                "ct/IM0004.dcm: damaged DICOM file (an element runs beyond the end of the file): copy or export it again",
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
            "a private sequence with an element too long",
            |f| f.insert(&unknown_sequence(0xffff_fff0)),
            Err(
                "ct/IM0004.dcm: damaged DICOM file (an element runs beyond the end of the file): copy or export it again",
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
fn attributes() {
    let rows: &[Row] = &[
        (
            "no position",
            |f| {
                f.edit(2, |o| {
                    o.remove_element(tags::IMAGE_POSITION_PATIENT);
                })
            },
            Err(
                "ct/IM0002.dcm: attribute ImagePositionPatient is missing: export the series again with complete headers",
            ),
        ),
        (
            "slice locations without positions",
            |f| {
                f.edit_all(|_, o| {
                    o.remove_element(tags::IMAGE_POSITION_PATIENT);
                })
            },
            Err(
                "ct/IM0001.dcm: attribute ImagePositionPatient is missing: export the series again with complete headers",
            ),
        ),
        (
            "empty position",
            |f| f.put(tags::IMAGE_POSITION_PATIENT, VR::DS, ""),
            Err(
                "ct/IM0002.dcm: attribute ImagePositionPatient is missing: export the series again with complete headers",
            ),
        ),
        (
            "position of two numbers",
            |f| f.put(tags::IMAGE_POSITION_PATIENT, VR::DS, "1\\2"),
            Err(
                "ct/IM0002.dcm: attribute ImagePositionPatient is 2 numbers, expected the right count of finite numbers: export the series again",
            ),
        ),
        (
            "position that is no number",
            |f| f.put(tags::IMAGE_POSITION_PATIENT, VR::DS, "0\\NaN\\3"),
            Err(
                "ct/IM0002.dcm: attribute ImagePositionPatient is 3 numbers, expected the right count of finite numbers: export the series again",
            ),
        ),
        (
            "position with decimal commas",
            |f| f.put(tags::IMAGE_POSITION_PATIENT, VR::DS, "0,5\\0,5\\3,0"),
            Err(
                "ct/IM0002.dcm: damaged DICOM file (a decimal attribute holds no number): copy or export it again",
            ),
        ),
        (
            "position a million kilometres away",
            |f| f.put(tags::IMAGE_POSITION_PATIENT, VR::DS, "0\\0\\1e15"),
            Err(
                "ct/IM0002.dcm: attribute ImagePositionPatient is [0.0, 0.0, 1000000000000000.0], expected coordinates within 100 m: export the series again",
            ),
        ),
        (
            "no orientation",
            |f| {
                f.edit(2, |o| {
                    o.remove_element(tags::IMAGE_ORIENTATION_PATIENT);
                })
            },
            Err(
                "ct/IM0002.dcm: attribute ImageOrientationPatient is missing: export the series again with complete headers",
            ),
        ),
        (
            "parallel cosines",
            |f| f.put(tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "1\\0\\0\\1\\0\\0"),
            Err(
                "ct/IM0002.dcm: attribute ImageOrientationPatient is [1.0, 0.0, 0.0, 1.0, 0.0, 0.0], off by 1.0000, expected two orthogonal unit vectors within 0.01: export the series again",
            ),
        ),
        (
            "cosines that are no unit vectors",
            |f| f.put(tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "1.03\\0\\0\\0\\1\\0"),
            Err(
                "ct/IM0002.dcm: attribute ImageOrientationPatient is [1.03, 0.0, 0.0, 0.0, 1.0, 0.0], off by 0.0300, expected two orthogonal unit vectors within 0.01: export the series again",
            ),
        ),
        (
            "cosines of two decimals",
            |f| f.edit_all(|_, o| put(o, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "1\\0\\0\\0\\1.005\\0")),
            Ok(&[
                "ct.rounded_axes: direction cosines are off by 0.0050; the nearest right-angled axes were taken",
            ]),
        ),
        (
            "no pixel spacing",
            |f| {
                f.edit(2, |o| {
                    o.remove_element(tags::PIXEL_SPACING);
                })
            },
            Err(
                "ct/IM0002.dcm: attribute PixelSpacing is missing: export the series again with complete headers",
            ),
        ),
        (
            "pixels of no size",
            |f| f.put(tags::PIXEL_SPACING, VR::DS, "0\\0"),
            Err(
                "ct/IM0002.dcm: attribute PixelSpacing is [0.0, 0.0], expected 0.001 to 100 mm: export the series again",
            ),
        ),
        (
            "pixels of negative size",
            |f| f.put(tags::PIXEL_SPACING, VR::DS, "-0.5\\0.5"),
            Err(
                "ct/IM0002.dcm: attribute PixelSpacing is [-0.5, 0.5], expected 0.001 to 100 mm: export the series again",
            ),
        ),
        (
            "a name in the place of a number",
            |f| f.put(tags::PIXEL_SPACING, VR::DS, "DOE\\JOHN"),
            Err(
                "ct/IM0002.dcm: damaged DICOM file (a decimal attribute holds no number): copy or export it again",
            ),
        ),
        (
            "no rows",
            |f| f.edit(2, |o| put_number(o, tags::ROWS, 0)),
            Err("ct/IM0002.dcm: attribute Rows is 0, expected 1 to 8192: export the series again"),
        ),
        (
            "too many columns",
            |f| f.edit(2, |o| put_number(o, tags::COLUMNS, 60_000)),
            Err("ct/IM0002.dcm: attribute Columns is 60000, expected 1 to 8192: export the series again"),
        ),
        (
            "32 bits a pixel",
            |f| f.edit(2, |o| put_number(o, tags::BITS_ALLOCATED, 32)),
            Err(
                "ct/IM0002.dcm: an image of 32 bits per pixel cannot be read: export the series as single-frame monochrome images of 8 or 16 bits",
            ),
        ),
        (
            "more bits than the word has",
            |f| f.edit(2, |o| put_number(o, tags::BITS_STORED, 17)),
            Err(
                "ct/IM0002.dcm: attribute BitsStored is 17, expected 1 to BitsAllocated: export the series again",
            ),
        ),
        (
            "a high bit below the stored ones",
            |f| f.edit(2, |o| put_number(o, tags::HIGH_BIT, 3)),
            Err(
                "ct/IM0002.dcm: attribute HighBit is 3, expected BitsStored - 1 to BitsAllocated - 1: export the series again",
            ),
        ),
        (
            "colour",
            |f| f.edit(2, |o| put_number(o, tags::SAMPLES_PER_PIXEL, 3)),
            Err(
                "ct/IM0002.dcm: an image of 3 samples per pixel (colour) cannot be read: export the series as single-frame monochrome images of 8 or 16 bits",
            ),
        ),
        (
            "palette colours",
            |f| f.put(tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "PALETTE COLOR"),
            Err(
                "ct/IM0002.dcm: an image of palette colours cannot be read: export the series as single-frame monochrome images of 8 or 16 bits",
            ),
        ),
        (
            "look-up table",
            |f| {
                f.edit(2, |o| {
                    let item = InMemDicomObject::from_element_iter([DataElement::new(
                        tags::MODALITY_LUT_TYPE,
                        VR::LO,
                        PrimitiveValue::from("HU"),
                    )]);
                    o.put(DataElement::new(
                        tags::MODALITY_LUT_SEQUENCE,
                        VR::SQ,
                        DataSetSequence::from(vec![item]),
                    ));
                })
            },
            Err(
                "ct/IM0002.dcm: an image with a modality look-up table cannot be read: export the series as single-frame monochrome images of 8 or 16 bits",
            ),
        ),
        (
            "inverted display",
            |f| f.edit_all(|_, o| put(o, tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "MONOCHROME1")),
            Ok(&[
                "ct.inverted: the images are meant to be shown inverted (MONOCHROME1); their values were taken as they are",
            ]),
        ),
        (
            "slope of zero",
            |f| f.put(tags::RESCALE_SLOPE, VR::DS, "0"),
            Err(
                "ct/IM0002.dcm: attribute RescaleSlope is 0.0, expected other than 0: export the series again",
            ),
        ),
        (
            "slope beyond all bounds",
            |f| f.put(tags::RESCALE_SLOPE, VR::DS, "1e300"),
            Err(
                "ct/IM0002.dcm: attribute RescaleSlope is 1e300, expected up to 1000000: export the series again",
            ),
        ),
        (
            "intercept beyond all bounds",
            |f| f.put(tags::RESCALE_INTERCEPT, VR::DS, "-2e6"),
            Err(
                "ct/IM0002.dcm: attribute RescaleIntercept is -2000000.0, expected within 1000000: export the series again",
            ),
        ),
        (
            "values below any CT number",
            |f| f.put(tags::RESCALE_INTERCEPT, VR::DS, "-30000"),
            Ok(&[
                "ct.implausible_values: 576 pixel(s) are below -10240 or above 31000 HU, which no CT gives: PixelRepresentation, the padding value or the rescaling in the headers may be wrong",
            ]),
        ),
        (
            "no rescale",
            |f| {
                f.edit_all(|_, o| {
                    o.remove_element(tags::RESCALE_SLOPE);
                    o.remove_element(tags::RESCALE_INTERCEPT);
                })
            },
            Ok(&[
                "ct.no_rescale: images without rescale slope and intercept: stored values were taken as HU",
            ]),
        ),
        (
            "another modality",
            |f| f.edit_all(|_, o| put(o, tags::MODALITY, VR::CS, "MR")),
            Ok(&["ct.modality: modality is MR, not CT: intensities are not Hounsfield units"]),
        ),
        (
            "no slice thickness",
            |f| {
                f.edit_all(|_, o| {
                    o.remove_element(tags::SLICE_THICKNESS);
                })
            },
            Ok(&[
                "ct.no_thickness: no slice thickness in the headers; the planes' distance, 3.000 mm, was taken",
            ]),
        ),
        (
            "slices of no thickness",
            |f| f.edit_all(|_, o| put(o, tags::SLICE_THICKNESS, VR::DS, "0")),
            Ok(&[
                "ct.no_thickness: no slice thickness in the headers; the planes' distance, 3.000 mm, was taken",
            ]),
        ),
        (
            "one thicker slice",
            |f| f.put(tags::SLICE_THICKNESS, VR::DS, "5"),
            Ok(&[
                "ct.thickness_varies: slice thickness varies or is missing in some images; 2.000 mm was taken",
            ]),
        ),
        (
            "stated spacing",
            |f| f.edit_all(|_, o| put(o, tags::SPACING_BETWEEN_SLICES, VR::DS, "1.5")),
            Ok(&[
                "ct.spacing_disagrees: headers state 1.500 mm between planes, positions lie 3.000 mm apart: planes may be missing",
            ]),
        ),
        (
            "numbers in another order",
            |f| f.edit_all(|n, o| put(o, tags::INSTANCE_NUMBER, VR::IS, &((n * 3) % 8).to_string())),
            Ok(&[
                "ct.instance_order: the images' numbers do not follow their positions; the positions were used",
            ]),
        ),
        ("a number that is none", |f| f.put(tags::INSTANCE_NUMBER, VR::IS, "two"), Ok(&[])),
    ];
    check(rows, false);
}

#[test]
fn geometry() {
    let rows: &[Row] = &[
        (
            "missing plane",
            |f| fs::remove_file(f.file(4)).unwrap(),
            Err(
                "1 plane(s) missing between z = 6.000 and 12.000 mm (planes lie 3.000 mm apart): export the series again, or have the gap bridged with --allow-gaps",
            ),
        ),
        (
            "two gaps",
            |f| [3, 4, 6].into_iter().for_each(|n| fs::remove_file(f.file(n)).unwrap()),
            Err(
                "2 plane(s) missing between z = 3.000 and 12.000 mm (planes lie 3.000 mm apart; 2 such gaps): export the series again, or have the gap bridged with --allow-gaps",
            ),
        ),
        (
            "uneven distances",
            |f| f.edit_all(|n, o| place(o, [0.0, 0.0, z(n) + if n > 4 { 2.0 } else { 0.0 }])),
            Ok(&[
                "ct.irregular_spacing: 1 distance(s) between planes differ from the usual 3.000 mm; the true ones were used",
            ]),
        ),
        (
            "one plane",
            |f| (2..=N_PLANES).for_each(|n| fs::remove_file(f.file(n)).unwrap()),
            Err("the series has 1 plane, expected at least 2: name the folder of the whole series"),
        ),
        (
            "all planes at one place",
            |f| f.edit_all(|_, o| place(o, [0.0; 3])),
            Err("the series has 1 plane, expected at least 2: name the folder of the whole series"),
        ),
        ("negative distances", |f| f.edit_all(|n, o| place(o, [0.0, 0.0, -z(n)])), Ok(&[])),
        (
            "a copy of an image",
            |f| {
                fs::copy(f.file(3), f.path().join("copy.dcm")).unwrap();
            },
            Ok(&["ct.duplicate_plane: 1 image(s) occur twice; one of each was used"]),
        ),
        (
            "another image at one place",
            |f| f.copy(3, &f.path().join("other.dcm"), |o| put_pixels(o, vec![7; 576])),
            Err(
                "ct/IM0003.dcm and ct/other.dcm lie both at z = 6.000 mm but differ (several phases or reconstructions in one series?): keep one of them",
            ),
        ),
        (
            "another size",
            |f| {
                f.edit(6, |o| {
                    put_number(o, tags::ROWS, 12);
                    put_pixels(o, vec![0; 288]);
                })
            },
            Err(
                "ct/IM0006.dcm: 24 x 12 pixels of 0.5000 x 0.5000 mm, normal (0.000, 0.000, 1.000), but the other 7 images of its series have 24 x 24 pixels of 0.5000 x 0.5000 mm, normal (0.000, 0.000, 1.000): remove the file, or export the series again",
            ),
        ),
        (
            "another pixel size",
            |f| f.edit(6, |o| put(o, tags::PIXEL_SPACING, VR::DS, "0.6\\0.6")),
            Err(
                "ct/IM0006.dcm: 24 x 24 pixels of 0.6000 x 0.6000 mm, normal (0.000, 0.000, 1.000), but the other 7 images of its series have 24 x 24 pixels of 0.5000 x 0.5000 mm, normal (0.000, 0.000, 1.000): remove the file, or export the series again",
            ),
        ),
        (
            "a plane 50 mm aside",
            |f| {
                f.edit(3, |o| {
                    let p = o.element(tags::IMAGE_POSITION_PATIENT).unwrap().to_multi_float64().unwrap();
                    place(o, [p[0] + 50.0, p[1], p[2]]);
                })
            },
            Err(
                "ct/IM0003.dcm: the image lies 50.000 mm beside the line of the others: remove the file, or export the series again",
            ),
        ),
        (
            "a plane a third of a pixel aside",
            |f| f.edit_all(|n, o| place(o, [if n == 3 { 0.17 } else { 0.0 }, 0.0, z(n)])),
            Ok(&[
                "ct.plane_offset: planes lie up to 0.170 mm beside their line; each was moved to where its header says it lies",
            ]),
        ),
        (
            "tilted gantry",
            |f| f.edit_all(|n, o| place(o, [0.0, z(n) * 0.2, z(n)])),
            Ok(&[
                "ct.gantry_tilt: the gantry was tilted by 11.31 degrees; each plane was moved back to its place in the patient",
            ]),
        ),
        (
            "sheared beyond any gantry",
            |f| f.edit_all(|n, o| place(o, [0.0, z(n) * 2.0, z(n)])),
            Err(
                "the planes lie on a line 63.43 degrees off their normal, expected at most 45 (a gantry tilt): export the series again, its positions or orientation are wrong",
            ),
        ),
    ];
    check(rows, false);
    let rows: &[Row] = &[(
        "missing plane, allowed",
        |f| fs::remove_file(f.file(4)).unwrap(),
        Ok(&[
            "ct.missing_planes: 1 gap(s) in the stack, the first between z = 6.000 and 12.000 mm; the shape there is interpolated",
        ]),
    )];
    check(rows, true);
}

#[test]
fn several_series() {
    let rows: &[Row] = &[
        (
            "two series",
            |f| {
                f.edit_all(|n, o| {
                    if n > 4 {
                        put(o, tags::SERIES_INSTANCE_UID, VR::UI, "1.2.3")
                    }
                })
            },
            Err(
                "2 series in the folder (1: CT, 4 images, 24 x 24 pixels of 0.5000 x 0.5000 mm, normal (0.000, 0.000, 1.000); 2: CT, 4 images, 24 x 24 pixels of 0.5000 x 0.5000 mm, normal (0.000, 0.000, 1.000)): choose one by its number, or give each its own folder",
            ),
        ),
        (
            "two phases under one UID",
            |f| {
                f.edit_all(|_, o| put(o, tags::NOMINAL_PERCENTAGE_OF_CARDIAC_PHASE, VR::DS, "70"));
                f.doubled(|o| put(o, tags::NOMINAL_PERCENTAGE_OF_CARDIAC_PHASE, VR::DS, "30"));
            },
            Err(
                "2 series in the folder (1: CT, 8 images, 24 x 24 pixels of 0.5000 x 0.5000 mm, normal (0.000, 0.000, 1.000), cardiac phase 30 %; 2: CT, 8 images, 24 x 24 pixels of 0.5000 x 0.5000 mm, normal (0.000, 0.000, 1.000), cardiac phase 70 %): choose one by its number, or give each its own folder",
            ),
        ),
        (
            "two kernels under one UID",
            |f| {
                f.edit_all(|_, o| put(o, tags::CONVOLUTION_KERNEL, VR::SH, "B30f"));
                f.doubled(|o| put(o, tags::CONVOLUTION_KERNEL, VR::SH, "B60f"));
            },
            Err(
                "2 series in the folder (1: CT, 8 images, 24 x 24 pixels of 0.5000 x 0.5000 mm, normal (0.000, 0.000, 1.000), kernel B30f; 2: CT, 8 images, 24 x 24 pixels of 0.5000 x 0.5000 mm, normal (0.000, 0.000, 1.000), kernel B60f): choose one by its number, or give each its own folder",
            ),
        ),
        (
            "two phases that nothing tells apart",
            |f| f.doubled(|o| put_pixels(o, vec![7; 576])),
            Err(
                "ct/IM0001.dcm and ct/Z1.dcm lie both at z = 0.000 mm but differ (several phases or reconstructions in one series?): keep one of them",
            ),
        ),
        (
            "an acquisition a plane",
            |f| f.edit_all(|n, o| put(o, tags::ACQUISITION_NUMBER, VR::IS, &n.to_string())),
            Ok(&[]),
        ),
        (
            "localizer",
            |f| {
                f.copy(1, &f.path().join("scout.dcm"), |o| {
                    put(o, tags::IMAGE_TYPE, VR::CS, "ORIGINAL\\PRIMARY\\LOCALIZER")
                })
            },
            Ok(&["ct.localizer: 1 localizer image(s) left out"]),
        ),
        (
            "scout view that is not called one",
            |f| {
                f.copy(1, &f.path().join("scout.dcm"), |o| {
                    put(o, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "1\\0\\0\\0\\0\\-1");
                })
            },
            Ok(&["ct.localizer: 1 image(s) across the planes (scout views) left out"]),
        ),
        (
            "nothing but localizers",
            |f| f.edit_all(|_, o| put(o, tags::IMAGE_TYPE, VR::CS, "ORIGINAL\\PRIMARY\\LOCALIZER")),
            Err(
                "ct holds DICOM files but no image of a series of planes (localizers and reports do not count): choose another folder; a DICOM SEG or RTSTRUCT is given with --segmentation",
            ),
        ),
        (
            "picture of a screen",
            |f| {
                f.copy(1, &f.path().join("screen.dcm"), |o| {
                    put(o, tags::SOP_CLASS_UID, VR::UI, "1.2.840.10008.5.1.4.1.1.7");
                })
            },
            Ok(&["ct.secondary_capture: 1 picture(s) of a screen left out"]),
        ),
        (
            "report",
            |f| {
                f.copy(1, &f.path().join("report.dcm"), |o| {
                    put(o, tags::SOP_CLASS_UID, VR::UI, "1.2.840.10008.5.1.4.1.1.88.11");
                    o.remove_element(tags::ROWS);
                })
            },
            Ok(&["ct.not_an_image_plane: 1 DICOM object(s) that are no image planes left out"]),
        ),
        (
            "one image of another kind",
            |f| {
                f.copy(1, &f.path().join("mip.dcm"), |o| {
                    put(o, tags::IMAGE_TYPE, VR::CS, "DERIVED\\SECONDARY\\MIP");
                })
            },
            Ok(&["ct.other_kind: 1 image(s) of another kind or reconstruction in the series left out"]),
        ),
        (
            "reformatted planes",
            |f| f.edit_all(|_, o| put(o, tags::IMAGE_TYPE, VR::CS, "DERIVED\\SECONDARY\\MPR")),
            Ok(&[
                "ct.reformatted: the planes were computed from another series (MPR): prefer the original where you have it",
            ]),
        ),
        (
            "projections",
            |f| f.edit_all(|_, o| put(o, tags::IMAGE_TYPE, VR::CS, "DERIVED\\SECONDARY\\PROJECTION IMAGE")),
            Ok(&[
                "ct.projection: the images are projections or renderings, not planes: what they show has no true size",
            ]),
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
    let unmarked = "Z3.dcm: damaged DICOM file (the mark DICM is missing): copy or export it again";
    for told in told_of_two_series(|bytes| bytes[..100].to_vec()) {
        assert_eq!(told, (Err(unmarked.to_owned()), Verdict::Unusable));
    }
    // A UID that no readable file has tells nothing: it may be the damage.
    let other_uid = |bytes: Vec<u8>| {
        let at = bytes.windows(5).rposition(|w| w == b"1.2.3").unwrap();
        [&bytes[..at], b"1.2.9", &bytes[at + 5..bytes.len() - 100]].concat()
    };
    assert!(
        told_of_two_series(other_uid)
            .iter()
            .all(|(said, verdict)| said.is_err() && *verdict == Verdict::Unusable)
    );
}
