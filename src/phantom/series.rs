//! The phantom as files: a DICOM CT series and its truth.
//!
//! The directory holds `IM0001.dcm` and so on (CT Image Storage, explicit little endian, 12 bits with intercept -1024)
//! and [`TRUTH_FILE`], one JSON object in the manner of `sections.json`, so that it can be read as such:
//!
//! | field | meaning |
//! |---|---|
//! | `units`, `frame` | `"mm"`, `"LPS"` |
//! | `kind` | the vessel: `carotid`, `trifurcation`, `merge`, `stenosis`, `tube` |
//! | `params` | the fields of [`Params`] |
//! | `seed_mm` | [`default_seed`]: a point in the lumen |
//! | `planes` | ascending in z: every CT plane, and the height half-way between each two |
//! | `planes[].z_mm` | height |
//! | `planes[].ct_plane` | index of the CT plane from 0; `null` half-way between two |
//! | `planes[].contours` | the exact lumen without blur or slab: 256 points each, counter-clockwise, rounded to 1e-9 mm |
//!
//! The patient is called PHANTOM. UIDs are 2.25 and 128 bits of a hash of the pixels and parameters: the same parameters
//! give the same files, byte for byte.

use super::image::STORED_HU;
use super::{Error, Params, Vessel, default_seed, try_volume};
use crate::ct::{PHANTOM_TRUTH_FILE, Volume};
use crate::geom::{Contour, Point2};
use crate::progress::{Cancelled, Task};
use dicom_core::value::{C, PrimitiveValue};
use dicom_core::{DataElement, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::mem::InMemElement;
use dicom_object::{FileMetaTableBuilder, InMemDicomObject};
use rayon::prelude::*;
use serde::Serialize;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Name of the file with the exact contours.
pub const TRUTH_FILE: &str = PHANTOM_TRUTH_FILE;
/// Vertices per contour in the truth.
const TRUTH_POINTS: usize = 256;

/// Writes the series and its truth into `dir`, which must not exist or be empty. All or nothing: the files are made in a
/// directory beside it that is renamed at the end.
///
/// # Errors
/// [`Error::OutOfRange`] for a parameter, [`Error::NotEmpty`] where `dir` holds something, [`Error::Write`] where the
/// system refuses, [`Error::Cancelled`] on request.
pub fn write(dir: &Path, params: &Params, task: &Task<'_>) -> Result<(), Error> {
    params.check()?;
    let dir = free_place(dir)?;
    let volume = try_volume(params, task)?;
    let parent = dir.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(parent).map_err(|e| failed(parent, e))?;
    let beside =
        tempfile::Builder::new().prefix(".phantom-").tempdir_in(parent).map_err(|e| failed(parent, e))?;
    // A directory within: the outer one is private to its owner, the result is not.
    let making = beside.path().join("series");
    fs::create_dir(&making).map_err(|e| failed(&making, e))?;
    write_truth(&making.join(TRUTH_FILE), params, task)?;
    write_images(&making, params, &volume, task)?;
    fs::rename(&making, &dir).map_err(|e| match e.kind() {
        io::ErrorKind::DirectoryNotEmpty => Error::NotEmpty(dir.clone()),
        _ => failed(&dir, e),
    })
}

fn failed(path: &Path, source: io::Error) -> Error {
    Error::Write { path: path.to_owned(), source }
}

/// The place to write to, in full where it exists, so that `.` has a name and a parent.
fn free_place(dir: &Path) -> Result<PathBuf, Error> {
    match fs::read_dir(dir) {
        Ok(mut entries) => match entries.next() {
            Some(_) => Err(Error::NotEmpty(dir.to_owned())),
            None => dir.canonicalize().map_err(|e| failed(dir, e)),
        },
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(Path::new(".").join(dir)),
        Err(e) => Err(failed(dir, e)),
    }
}

#[derive(Serialize)]
struct Truth<'a> {
    units: &'static str,
    frame: &'static str,
    kind: &'static str,
    params: &'a Params,
    seed_mm: [f64; 3],
    planes: Vec<TruthPlane>,
}

#[derive(Serialize)]
struct TruthPlane {
    z_mm: f64,
    ct_plane: Option<usize>,
    contours: Vec<Contour>,
}

fn write_truth(path: &Path, params: &Params, task: &Task<'_>) -> Result<(), Error> {
    let vessel = Vessel::new(params.kind);
    let planes = truth_heights(params).into_par_iter().map(|(z_mm, ct_plane)| {
        task.check()?;
        let contours = vessel.region_at(z_mm, TRUTH_POINTS).contours.iter().map(rounded).collect();
        Ok(TruthPlane { z_mm, ct_plane, contours })
    });
    let truth = Truth {
        units: "mm",
        frame: "LPS",
        kind: params.kind.name(),
        params,
        seed_mm: default_seed(params).coords.into(),
        planes: planes.collect::<Result<_, Cancelled>>()?,
    };
    let text = serde_json::to_vec(&truth).map_err(|e| failed(path, e.into()))?;
    fs::write(path, text).map_err(|e| failed(path, e))
}

/// Every plane with its index, and the heights half-way between, ascending.
fn truth_heights(params: &Params) -> Vec<(f64, Option<usize>)> {
    let planes = params.plane_z_mm();
    let half_way = planes.windows(2).map(|w| (0.5 * (w[0] + w[1]), None));
    let mut heights: Vec<_> = planes.iter().enumerate().map(|(k, &z)| (z, Some(k))).chain(half_way).collect();
    heights.sort_by(|a, b| a.0.total_cmp(&b.0));
    heights
}

fn rounded(contour: &Contour) -> Contour {
    let round = |v: f64| (v * 1e9).round() / 1e9;
    Contour::new(contour.points.iter().map(|p| Point2::new(round(p.x), round(p.y))).collect())
}

fn write_images(dir: &Path, params: &Params, volume: &Volume, task: &Task<'_>) -> Result<(), Error> {
    let stored: Vec<Vec<u16>> =
        (0..volume.dims[2]).into_par_iter().map(|k| stored_plane(volume.plane(k))).collect();
    let uids = Uids::of(params, &stored);
    let pixels = stored.into_par_iter().enumerate();
    pixels.try_for_each(|(k, pixels)| {
        task.check()?;
        let path = dir.join(format!("IM{:04}.dcm", k + 1));
        let bytes = dicom_bytes(volume, &uids, k, pixels).map_err(|e| failed(&path, e))?;
        fs::write(&path, bytes).map_err(|e| failed(&path, e))
    })
}

fn stored_plane(hu: &[f32]) -> Vec<u16> {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "whole HU of 12 bits by construction"
    )]
    hu.iter().map(|&v| (f64::from(v) - STORED_HU[0]) as u16).collect()
}

/// Generated identifiers of the series.
struct Uids {
    hash: blake3::Hash,
}

impl Uids {
    fn of(params: &Params, stored: &[Vec<u16>]) -> Self {
        let mut hasher = blake3::Hasher::new();
        hasher.update(format!("{params:?}").as_bytes());
        let of_plane = |plane: &Vec<u16>| {
            let bytes: Vec<u8> = plane.iter().flat_map(|v| v.to_le_bytes()).collect();
            blake3::hash(&bytes)
        };
        let planes: Vec<blake3::Hash> = stored.par_iter().map(of_plane).collect();
        planes.iter().for_each(|h| {
            hasher.update(h.as_bytes());
        });
        Self { hash: hasher.finalize() }
    }

    /// The UID of one role within the series (PS3.5 B.2: a 128-bit integer under 2.25).
    fn get(&self, role: &str) -> String {
        let mut hasher = blake3::Hasher::new();
        hasher.update(self.hash.as_bytes()).update(role.as_bytes());
        let hash = hasher.finalize();
        let bytes: [u8; 16] = std::array::from_fn(|i| hash.as_bytes()[i]);
        format!("2.25.{}", u128::from_be_bytes(bytes))
    }
}

/// One image as a DICOM file.
fn dicom_bytes(volume: &Volume, uids: &Uids, k: usize, pixels: Vec<u16>) -> io::Result<Vec<u8>> {
    let elements = identity(uids, k).into_iter().chain(geometry(volume, k)).chain(image(volume, pixels));
    let meta = FileMetaTableBuilder::new().transfer_syntax(uids::EXPLICIT_VR_LITTLE_ENDIAN);
    let object = InMemDicomObject::from_element_iter(elements).with_meta(meta).map_err(io::Error::other)?;
    let mut bytes = Vec::new();
    object.write_all(&mut bytes).map_err(io::Error::other)?;
    Ok(bytes)
}

fn text(tag: Tag, vr: VR, value: impl Into<String>) -> InMemElement {
    DataElement::new(tag, vr, PrimitiveValue::from(value.into()))
}

fn number(tag: Tag, value: u16) -> InMemElement {
    DataElement::new(tag, VR::US, PrimitiveValue::from(value))
}

fn decimals(tag: Tag, values: &[f64]) -> InMemElement {
    let strings: Vec<String> = values.iter().map(|&v| decimal_string(v)).collect();
    text(tag, VR::DS, strings.join("\\"))
}

/// The longest decimal string of at most 16 characters (PS3.5 6.2, DS).
fn decimal_string(value: f64) -> String {
    let shortest = value.to_string();
    if shortest.len() <= 16 {
        return shortest;
    }
    let fits = (0..=14).rev().map(|digits| format!("{value:.digits$}")).find(|s| s.len() <= 16);
    fits.unwrap_or_else(|| format!("{value:.8e}"))
}

fn identity(uids: &Uids, k: usize) -> Vec<InMemElement> {
    let index = (k + 1).to_string();
    vec![
        text(tags::IMAGE_TYPE, VR::CS, "DERIVED\\PRIMARY\\AXIAL"),
        text(tags::SOP_CLASS_UID, VR::UI, uids::CT_IMAGE_STORAGE),
        text(tags::SOP_INSTANCE_UID, VR::UI, uids.get(&format!("image {index}"))),
        text(tags::STUDY_DATE, VR::DA, ""),
        text(tags::STUDY_TIME, VR::TM, ""),
        text(tags::ACCESSION_NUMBER, VR::SH, ""),
        text(tags::MODALITY, VR::CS, "CT"),
        text(tags::MANUFACTURER, VR::LO, ""),
        text(tags::REFERRING_PHYSICIAN_NAME, VR::PN, ""),
        text(tags::PATIENT_NAME, VR::PN, "PHANTOM"),
        text(tags::PATIENT_ID, VR::LO, "PHANTOM"),
        text(tags::PATIENT_BIRTH_DATE, VR::DA, ""),
        text(tags::PATIENT_SEX, VR::CS, ""),
        text(tags::PATIENT_POSITION, VR::CS, "HFS"),
        text(tags::STUDY_INSTANCE_UID, VR::UI, uids.get("study")),
        text(tags::SERIES_INSTANCE_UID, VR::UI, uids.get("series")),
        text(tags::FRAME_OF_REFERENCE_UID, VR::UI, uids.get("frame")),
        text(tags::POSITION_REFERENCE_INDICATOR, VR::LO, ""),
        text(tags::STUDY_ID, VR::SH, "1"),
        text(tags::SERIES_NUMBER, VR::IS, "1"),
        text(tags::ACQUISITION_NUMBER, VR::IS, "1"),
        text(tags::INSTANCE_NUMBER, VR::IS, index),
        text(tags::KVP, VR::DS, ""),
    ]
}

fn geometry(volume: &Volume, k: usize) -> Vec<InMemElement> {
    let [x, y] = volume.origin_xy_mm;
    let [dx, dy] = volume.pixel_spacing_xy_mm;
    let z = volume.plane_z_mm[k];
    vec![
        decimals(tags::SLICE_THICKNESS, &[volume.slab_thickness_mm]),
        decimals(tags::SPACING_BETWEEN_SLICES, &[volume.plane_interval_mm(k)]),
        decimals(tags::IMAGE_POSITION_PATIENT, &[x, y, z]),
        decimals(tags::IMAGE_ORIENTATION_PATIENT, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0]),
        decimals(tags::SLICE_LOCATION, &[z]),
        // Row spacing first: the distance along y.
        decimals(tags::PIXEL_SPACING, &[dy, dx]),
    ]
}

fn image(volume: &Volume, pixels: Vec<u16>) -> Vec<InMemElement> {
    let side = |n: usize| u16::try_from(n).expect("parameters are checked: 2048 at most");
    vec![
        number(tags::SAMPLES_PER_PIXEL, 1),
        text(tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "MONOCHROME2"),
        number(tags::ROWS, side(volume.dims[1])),
        number(tags::COLUMNS, side(volume.dims[0])),
        number(tags::BITS_ALLOCATED, 16),
        number(tags::BITS_STORED, 12),
        number(tags::HIGH_BIT, 11),
        number(tags::PIXEL_REPRESENTATION, 0),
        decimals(tags::RESCALE_INTERCEPT, &[STORED_HU[0]]),
        decimals(tags::RESCALE_SLOPE, &[1.0]),
        text(tags::RESCALE_TYPE, VR::LO, "HU"),
        DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(C::from_vec(pixels))),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phantom::Kind;
    use crate::progress::CancelToken;
    use crate::sections::format;

    fn small() -> Params {
        Params {
            kind: Kind::Carotid,
            n_planes: 5,
            first_plane_z_mm: 60.0,
            n_pixels: 64,
            pixel_mm: 0.4,
            ..Params::default()
        }
    }

    fn names(dir: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn same_parameters_give_the_same_files() {
        let place = tempfile::tempdir().unwrap();
        let [a, b] = ["a", "deep/er/b"].map(|n| place.path().join(n));
        for dir in [&a, &b] {
            write(dir, &small(), &Task::quiet()).unwrap();
        }
        assert_eq!(
            names(&a),
            ["IM0001.dcm", "IM0002.dcm", "IM0003.dcm", "IM0004.dcm", "IM0005.dcm", "truth.json"]
        );
        assert!(names(&a).iter().all(|n| fs::read(a.join(n)).unwrap() == fs::read(b.join(n)).unwrap()));
        assert_eq!(names(place.path()), ["a", "deep"]);
    }

    #[test]
    fn truth_reads_as_sections_at_and_between_planes() {
        let place = tempfile::tempdir().unwrap();
        let dir = place.path().join("series");
        write(&dir, &small(), &Task::quiet()).unwrap();
        let text = fs::read_to_string(dir.join(TRUTH_FILE)).unwrap();
        let stack = format::from_json(&text).unwrap();
        assert_eq!(stack.plane_z_mm(), [60.0, 61.5, 63.0, 64.5, 66.0, 67.5, 69.0, 70.5, 72.0]);
        let counts: Vec<usize> = stack.planes.iter().map(|p| p.contours.len()).collect();
        assert_eq!(counts, [1, 1, 1, 1, 1, 1, 1, 1, 2]);
        let vessel = Vessel::new(Kind::Carotid);
        let exact = vessel.region_at(64.5, TRUTH_POINTS).area_mm2();
        assert!((stack.planes[3].region().area_mm2() - exact).abs() < 1e-7);
        let document: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(document["planes"][2]["ct_plane"], 1);
        assert!(document["planes"][1]["ct_plane"].is_null());
        assert_eq!(serde_json::from_value::<Params>(document["params"].clone()).unwrap(), small());
        let seed: [f64; 3] = serde_json::from_value(document["seed_mm"].clone()).unwrap();
        assert!(vessel.value(seed.into()) < -1.0);
    }

    #[test]
    fn a_directory_that_holds_something_is_left_alone() {
        let place = tempfile::tempdir().unwrap();
        fs::write(place.path().join("mine.txt"), "keep").unwrap();
        let error = write(place.path(), &small(), &Task::quiet()).unwrap_err();
        assert!(matches!(error, Error::NotEmpty(_)), "{error}");
        assert_eq!(names(place.path()), ["mine.txt"]);
    }

    #[test]
    fn an_empty_directory_is_filled() {
        let place = tempfile::tempdir().unwrap();
        let dir = place.path().join("empty");
        fs::create_dir(&dir).unwrap();
        write(&dir, &small(), &Task::quiet()).unwrap();
        assert_eq!(names(&dir).len(), 6);
    }

    #[test]
    fn a_file_in_the_way_is_an_error() {
        let place = tempfile::tempdir().unwrap();
        let file = place.path().join("file");
        fs::write(&file, "").unwrap();
        for dir in [file.clone(), file.join("below")] {
            assert!(matches!(write(&dir, &small(), &Task::quiet()), Err(Error::Write { .. })));
        }
    }

    #[test]
    fn interrupted_work_leaves_nothing() {
        let place = tempfile::tempdir().unwrap();
        let cancel = CancelToken::default();
        let stopper = cancel.clone();
        let sink = move |done: u64, _: u64| {
            if done > 3 {
                stopper.cancel();
            }
        };
        let result = write(&place.path().join("series"), &small(), &Task::new(&sink, cancel));
        assert!(matches!(result, Err(Error::Cancelled(_))));
        assert!(names(place.path()).is_empty());
    }

    #[test]
    fn decimal_strings_keep_to_sixteen_characters() {
        for value in [0.2, -30.6, 1.0 / 3.0, -1.0 / 3.0, 1e-7 / 3.0, -12_345.678_901_234_567, 138.0] {
            let text = decimal_string(value);
            assert!(text.len() <= 16);
            assert!(
                (text.parse::<f64>().unwrap() - value).abs() <= 1e-10_f64.max(1e-12 * value.abs()),
                "{text}"
            );
        }
    }
}
