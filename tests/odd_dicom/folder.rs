//! A sound series in a folder of its own, what may be done to it, and the check of a table's rows.

use dicom_core::value::{C, PixelFragmentSequence, PrimitiveValue, Value};
use dicom_core::{DataElement, Tag, VR};
use dicom_dictionary_std::tags;
use dicom_object::{DefaultDicomObject, open_file};
use lumenfab::ct::reader::{self, Options};
use lumenfab::ct::{SeriesChoice, Verdict};
use lumenfab::phantom::{self, Kind, Params};
use lumenfab::progress::Task;
use std::fs;
use std::path::{Path, PathBuf};

pub(crate) const N_PLANES: usize = 8;
/// A number that may be a date, or that of a record.
pub(crate) const DATE: &str = "19330717";
/// Bytes of the pixels of one image.
pub(crate) const PIXEL_BYTES: usize = 24 * 24 * 2;

/// A folder with a sound series, to be damaged.
pub(crate) struct Folder {
    place: tempfile::TempDir,
}

impl Folder {
    pub(crate) fn new() -> Self {
        let folder = Self { place: tempfile::tempdir().unwrap() };
        let params =
            Params { kind: Kind::Tube, n_planes: N_PLANES, n_pixels: 24, pixel_mm: 0.5, ..Params::default() };
        phantom::series::write(&folder.path(), &params, &Task::quiet()).unwrap();
        folder
    }

    pub(crate) fn path(&self) -> PathBuf {
        self.place.path().join("ct")
    }

    pub(crate) fn file(&self, number: usize) -> PathBuf {
        self.path().join(format!("IM{number:04}.dcm"))
    }

    pub(crate) fn edit(&self, number: usize, change: impl Fn(&mut DefaultDicomObject)) {
        self.copy(number, &self.file(number), change);
    }

    pub(crate) fn copy(&self, number: usize, to: &Path, change: impl Fn(&mut DefaultDicomObject)) {
        let mut object = open_file(self.file(number)).unwrap();
        change(&mut object);
        object.write_to_file(to).unwrap();
    }

    pub(crate) fn edit_all(&self, change: impl Fn(usize, &mut DefaultDicomObject)) {
        (1..=N_PLANES).for_each(|n| self.edit(n, |o| change(n, o)));
    }

    /// The text of one attribute changed in image 2.
    pub(crate) fn put(&self, tag: Tag, vr: VR, value: &str) {
        self.edit(2, |o| put(o, tag, vr, value));
    }

    pub(crate) fn cut(&self, keep: impl Fn(usize) -> usize) {
        let bytes = fs::read(self.file(4)).unwrap();
        fs::write(self.file(4), &bytes[..keep(bytes.len())]).unwrap();
    }

    /// Bytes put before the pixel data of image 4.
    pub(crate) fn insert(&self, bytes: &[u8]) {
        let mut file = fs::read(self.file(4)).unwrap();
        let at = file.len() - PIXEL_BYTES - 12;
        assert_eq!(file[at..at + 4], [0xe0, 0x7f, 0x10, 0]);
        file.splice(at..at, bytes.iter().copied());
        fs::write(self.file(4), file).unwrap();
    }

    /// A second set of images at the same places, told apart by the given change.
    pub(crate) fn doubled(&self, change: impl Fn(&mut DefaultDicomObject)) {
        for n in 1..=N_PLANES {
            self.copy(n, &self.path().join(format!("Z{n}.dcm")), |o| {
                put(o, tags::SOP_INSTANCE_UID, VR::UI, &format!("2.25.{n}"));
                change(o);
            });
        }
    }

    /// What is said about it, paths as names below the folder: an error, or warnings.
    pub(crate) fn said(&self, allow_gaps: bool) -> Result<Vec<String>, String> {
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
    pub(crate) fn is_usable(&self) -> Option<bool> {
        let inspection = reader::inspect(&self.path(), &Task::quiet()).ok()?;
        let text = format!("{inspection}{}", serde_json::to_string(&inspection).unwrap());
        let folder = self.place.path().display().to_string();
        assert!(!text.contains(&folder) && !text.contains("IM000"), "an inspection names no path: {text}");
        assert!(!text.contains(DATE), "an inspection quotes what may be a date: {text}");
        Some(inspection.series.iter().all(|s| s.verdict != Verdict::Unusable))
    }
}

pub(crate) fn put(object: &mut DefaultDicomObject, tag: Tag, vr: VR, value: &str) {
    object.put(DataElement::new(tag, vr, PrimitiveValue::from(value)));
}

pub(crate) fn put_number(object: &mut DefaultDicomObject, tag: Tag, value: u16) {
    object.put(DataElement::new(tag, VR::US, PrimitiveValue::from(value)));
}

pub(crate) fn put_pixels(object: &mut DefaultDicomObject, pixels: Vec<u16>) {
    object.put(DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(C::from_vec(pixels))));
}

pub(crate) fn place(object: &mut DefaultDicomObject, [x, y, z]: [f64; 3]) {
    put(object, tags::IMAGE_POSITION_PATIENT, VR::DS, &format!("{x}\\{y}\\{z}"));
}

/// Height of image n, from 1.
pub(crate) fn z(n: usize) -> f64 {
    3.0 * (n as f64 - 1.0)
}

pub(crate) fn compressed(object: &mut DefaultDicomObject, syntax: &str, bytes: Vec<u8>) {
    let fragments = PixelFragmentSequence::new_fragments(C::from_vec(vec![bytes]));
    object.put(DataElement::new(tags::PIXEL_DATA, VR::OB, Value::PixelSequence(fragments)));
    object.update_meta(|m| m.transfer_syntax = syntax.into());
}

/// A private sequence of undefined length as PS3.5 6.2.2 has it in a file of explicit encoding: UN, its content implicit. The one
/// element in it claims `length` bytes and has 4.
pub(crate) fn unknown_sequence(length: u32) -> Vec<u8> {
    let item = [&[0xfe, 0xff, 0x00, 0xe0, 0xff, 0xff, 0xff, 0xff][..], &[1, 0x70, 0x11, 0x10]].concat();
    let ends = [0xfe, 0xff, 0x0d, 0xe0, 0, 0, 0, 0, 0xfe, 0xff, 0xdd, 0xe0, 0, 0, 0, 0];
    [b"\x01\x70\x10\x10UN\0\0\xff\xff\xff\xff", &item[..], &length.to_le_bytes(), b"ABCD", &ends].concat()
}

/// A compressed image: JPEG-LS of 29 x 23 pixels, JPEG 2000 of 37 x 33.
pub(crate) fn golden(name: &str) -> Vec<u8> {
    fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/codec").join(name)).unwrap()
}

/// One fault: its name, what does it, and what is said.
pub(crate) type Row = (&'static str, fn(&Folder), Result<&'static [&'static str], &'static str>);

/// The rows of `rows`, checked one by one; all that differ are told at once.
pub(crate) fn check(rows: &[Row], allow_gaps: bool) {
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
            Some(true) => said.as_ref().map_or_else(|e| e.contains("choose one with --series N"), |_| true),
            Some(false) => said.is_err() || allow_gaps,
        };
        if !agrees {
            wrong.push(format!("{name}\n   inspection disagrees with {said:?}"));
        }
    }
    assert!(wrong.is_empty(), "{} of {} rows:\n{}", wrong.len(), rows.len(), wrong.join("\n"));
}
