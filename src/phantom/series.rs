//! The phantom as files: a DICOM CT series and its truth.
//!
//! The directory holds `IM0001.dcm` and so on (CT Image Storage, explicit little endian, 12 bits with intercept -1024)
//! and [`TRUTH_FILE`], one JSON object in the manner of `sections.json`, so that it can be read as such:
//!
//! | field | meaning |
//! |---|---|
//! | `units`, `frame` | `"mm"`, `"LPS"`; of tilted planes `"stack"`, with `patient_from_stack` |
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
use super::image::pixels;
use super::{Error, Params, Vessel, contours, default_seed};
use crate::ct::PHANTOM_TRUTH_FILE;
use crate::geom::{Contour, Point2, Point3, RigidTransform, Vector3};
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
    let scan = Scan::new(params, pixels(params, task)?);
    let parent = dir.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(parent).map_err(|e| failed(parent, e))?;
    let beside =
        tempfile::Builder::new().prefix(".phantom-").tempdir_in(parent).map_err(|e| failed(parent, e))?;
    // A directory within: the outer one is private to its owner, the result is not.
    let making = beside.path().join("series");
    fs::create_dir(&making).map_err(|e| failed(&making, e))?;
    write_truth(&making.join(TRUTH_FILE), params, task)?;
    write_images(&making, &scan, task)?;
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

/// What is written.
struct Scan<'a> {
    params: &'a Params,
    hu: Vec<f32>,
    /// First pixel, along the plane, as if it were not tilted.
    origin: Point2,
    planes: Planes,
}

impl<'a> Scan<'a> {
    fn new(params: &'a Params, (hu, origin): (Vec<f32>, Point2)) -> Self {
        Self { params, hu, origin, planes: Planes::of(params) }
    }

    fn plane(&self, k: usize) -> &[f32] {
        let n = self.params.n_pixels * self.params.n_pixels;
        &self.hu[k * n..(k + 1) * n]
    }
}

/// Where the planes of a scan lie: all through the line of the vessel's middle, tilted about it.
struct Planes {
    middle_y: f64,
    sin: f64,
    cos: f64,
}

impl Planes {
    fn of(params: &Params) -> Self {
        let (sin, cos) = params.tilt_deg.to_radians().sin_cos();
        Self { middle_y: Vessel::new(params.kind).middle.y, sin, cos }
    }

    fn is_tilted(&self) -> bool {
        self.sin.abs() > 0.0
    }

    /// Patient coordinates of a point of the plane at height z.
    fn patient(&self, p: Point2, z: f64) -> Point3 {
        let along = p.y - self.middle_y;
        Point3::new(p.x, self.middle_y + along * self.cos, z + along * self.sin)
    }

    /// The planes' axes, through the patient's origin.
    fn patient_from_stack(&self) -> RigidTransform {
        let (y, z) = (Vector3::new(0.0, self.cos, self.sin), Vector3::new(0.0, -self.sin, self.cos));
        RigidTransform::from_axes(Point3::origin(), Vector3::x(), y, z)
    }

    /// Stack coordinates of a point of the plane at height z.
    fn stack(&self, p: Point2, z: f64) -> Point3 {
        if self.is_tilted() {
            self.patient_from_stack().inverse().apply(self.patient(p, z))
        } else {
            Point3::new(p.x, p.y, z)
        }
    }
}

#[derive(Serialize)]
struct Truth<'a> {
    units: &'static str,
    frame: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    patient_from_stack: Option<RigidTransform>,
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
    let (vessel, place) = (Vessel::new(params.kind), Planes::of(params));
    let planes = truth_heights(params).into_par_iter().map(|(z, ct_plane)| {
        task.check()?;
        let exact = if place.is_tilted() {
            let plane = vessel.oblique(z, params.tilt_deg.to_radians());
            contours::trace(&plane.raised(0.0), 0.0, contours::EXACT_STEP_MM, TRUTH_POINTS)
        } else {
            vessel.region_at(z, TRUTH_POINTS).contours
        };
        let in_stack = |c: &Contour| rounded(c.points.iter().map(|&p| place.stack(p, z).xy()));
        let z_mm = place.stack(Point2::new(0.0, place.middle_y), z).z;
        Ok(TruthPlane { z_mm, ct_plane, contours: exact.iter().map(in_stack).collect() })
    });
    let truth = Truth {
        units: "mm",
        frame: if place.is_tilted() { "stack" } else { "LPS" },
        patient_from_stack: place.is_tilted().then(|| place.patient_from_stack()),
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

fn rounded(points: impl Iterator<Item = Point2>) -> Contour {
    let round = |v: f64| (v * 1e9).round() / 1e9;
    Contour::new(points.map(|p| Point2::new(round(p.x), round(p.y))).collect())
}

fn write_images(dir: &Path, scan: &Scan<'_>, task: &Task<'_>) -> Result<(), Error> {
    let stored: Vec<Vec<u16>> =
        (0..scan.params.n_planes).into_par_iter().map(|k| stored_plane(scan.plane(k))).collect();
    let uids = Uids::of(scan.params, &stored);
    let pixels = stored.into_par_iter().enumerate();
    pixels.try_for_each(|(k, pixels)| {
        task.check()?;
        let path = dir.join(format!("IM{:04}.dcm", k + 1));
        let bytes = dicom_bytes(scan, &uids, k, pixels).map_err(|e| failed(&path, e))?;
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
fn dicom_bytes(scan: &Scan<'_>, uids: &Uids, k: usize, pixels: Vec<u16>) -> io::Result<Vec<u8>> {
    let elements =
        identity(uids, k).into_iter().chain(geometry(scan, k)).chain(image(scan.params.n_pixels, pixels));
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

fn geometry(scan: &Scan<'_>, k: usize) -> Vec<InMemElement> {
    let Scan { params, planes, origin, .. } = scan;
    let z = params.plane_z_mm()[k];
    let place =
        if planes.is_tilted() { planes.patient(*origin, z) } else { Point3::new(origin.x, origin.y, z) };
    let tilt = planes.is_tilted().then(|| decimals(tags::GANTRY_DETECTOR_TILT, &[params.tilt_deg]));
    let distance = if params.n_planes > 1 { params.plane_step_mm * planes.cos } else { params.slab_mm };
    let mut elements = vec![
        decimals(tags::SLICE_THICKNESS, &[params.slab_mm]),
        decimals(tags::SPACING_BETWEEN_SLICES, &[distance]),
        decimals(tags::IMAGE_POSITION_PATIENT, &[place.x, place.y, place.z]),
        decimals(tags::IMAGE_ORIENTATION_PATIENT, &[1.0, 0.0, 0.0, 0.0, planes.cos, planes.sin]),
        decimals(tags::SLICE_LOCATION, &[z]),
        decimals(tags::PIXEL_SPACING, &[params.pixel_mm; 2]),
    ];
    elements.extend(tilt);
    elements
}

fn image(n_pixels: usize, pixels: Vec<u16>) -> Vec<InMemElement> {
    let side = u16::try_from(n_pixels).expect("parameters are checked: 2048 at most");
    vec![
        number(tags::SAMPLES_PER_PIXEL, 1),
        text(tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "MONOCHROME2"),
        number(tags::ROWS, side),
        number(tags::COLUMNS, side),
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
