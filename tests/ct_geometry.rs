//! Where every voxel of a series lies in the patient: images of one analytic scene, taken in every way a scanner takes them.
//!
//! The scene is a cylinder with a soft wall, its intensity a function of the place in the patient (LPS) alone. So whatever the
//! orientation, the pixel size, the order of the files, the distances of the planes or the tilt of the gantry: a voxel's
//! intensity has to be the scene's at the place that the volume claims for it.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]

use dicom_core::value::{C, PrimitiveValue};
use dicom_core::{DataElement, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject};
use lumenfab::ct::reader;
use lumenfab::ct::{Loaded, SeriesChoice, Volume};
use lumenfab::geom::{Point3, Vector3};
use lumenfab::progress::Task;
use std::path::Path;

const RADIUS_MM: f64 = 7.0;
/// Width of the wall's softness, mm: about a pixel of the tests, as sharp as a scanner's finest kernel.
const SOFTNESS_MM: f64 = 0.5;
/// Slope of the intensity in the middle of the wall.
const STEEPEST_HU_PER_MM: f64 = 150.0 / SOFTNESS_MM;
const CENTRE: Point3 = Point3::new(12.0, -40.0, 700.0);

fn axis() -> Vector3 {
    Vector3::new(0.15, -0.1, 1.0).normalize()
}

fn from_axis(p: Point3) -> f64 {
    let d = p - CENTRE;
    (d - axis() * d.dot(&axis())).norm()
}

/// Intensity at a place in the patient.
fn scene(p: Point3) -> f64 {
    40.0 + 150.0 * (1.0 - ((from_axis(p) - RADIUS_MM) / SOFTNESS_MM).tanh())
}

/// How a series is taken.
struct Series {
    row: Vector3,
    column: Vector3,
    /// First pixels of the images, in the order of the files.
    positions: Vec<Point3>,
    columns_rows: [u16; 2],
    /// Along rows, along columns.
    spacing_mm: [f64; 2],
}

impl Series {
    /// `n` planes of 90 x 80 pixels around the centre of the scene, `step` apart.
    fn new(row: Vector3, column: Vector3, step: Vector3, n: usize) -> Self {
        let (columns_rows, spacing_mm) = ([90, 80], [0.5, 0.55]);
        let half = |axis: usize| 0.5 * spacing_mm[axis] * f64::from(columns_rows[axis] - 1);
        let corner = CENTRE - row * half(0) - column * half(1);
        let positions = (0..n).map(|k| corner + step * (k as f64 - 0.5 * (n - 1) as f64)).collect();
        Self { row, column, positions, columns_rows, spacing_mm }
    }

    fn write(&self, dir: &Path) {
        for (i, &position) in self.positions.iter().enumerate() {
            let object = InMemDicomObject::from_element_iter(self.elements(i, position));
            let meta = FileMetaTableBuilder::new().transfer_syntax(uids::EXPLICIT_VR_LITTLE_ENDIAN);
            object.with_meta(meta).unwrap().write_to_file(dir.join(format!("{i:03}.dcm"))).unwrap();
        }
    }

    fn elements(&self, i: usize, position: Point3) -> Vec<DataElement<InMemDicomObject>> {
        let text = |tag: Tag, vr: VR, value: String| DataElement::new(tag, vr, PrimitiveValue::from(value));
        let numbers =
            |values: &[f64]| values.iter().map(|v| format!("{v:.9}")).collect::<Vec<_>>().join("\\");
        let word = |tag: Tag, value: u16| DataElement::new(tag, VR::US, PrimitiveValue::from(value));
        let cosines: Vec<f64> = self.row.iter().chain(self.column.iter()).copied().collect();
        let [columns, rows] = self.columns_rows;
        let pixels = (0..rows).flat_map(|r| (0..columns).map(move |c| (r, c))).map(|(r, c)| {
            let p = position
                + self.row * (self.spacing_mm[0] * f64::from(c))
                + self.column * (self.spacing_mm[1] * f64::from(r));
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "40 to 340")]
            let stored = (100.0 * scene(p)).round() as u16;
            stored
        });
        vec![
            text(tags::IMAGE_TYPE, VR::CS, "ORIGINAL\\PRIMARY\\AXIAL".into()),
            text(tags::SOP_CLASS_UID, VR::UI, uids::CT_IMAGE_STORAGE.into()),
            text(tags::SOP_INSTANCE_UID, VR::UI, format!("2.25.{}", i + 1)),
            text(tags::MODALITY, VR::CS, "CT".into()),
            text(tags::SLICE_THICKNESS, VR::DS, "2".into()),
            text(tags::SERIES_INSTANCE_UID, VR::UI, "2.25.1000".into()),
            text(tags::IMAGE_POSITION_PATIENT, VR::DS, numbers(position.coords.as_slice())),
            text(tags::IMAGE_ORIENTATION_PATIENT, VR::DS, numbers(&cosines)),
            word(tags::SAMPLES_PER_PIXEL, 1),
            text(tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "MONOCHROME2".into()),
            word(tags::ROWS, rows),
            word(tags::COLUMNS, columns),
            text(tags::PIXEL_SPACING, VR::DS, numbers(&[self.spacing_mm[1], self.spacing_mm[0]])),
            word(tags::BITS_ALLOCATED, 16),
            word(tags::BITS_STORED, 16),
            word(tags::HIGH_BIT, 15),
            word(tags::PIXEL_REPRESENTATION, 0),
            text(tags::RESCALE_INTERCEPT, VR::DS, "0".into()),
            text(tags::RESCALE_SLOPE, VR::DS, "0.01".into()),
            DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(C::from_vec(pixels.collect()))),
        ]
    }

    fn load(&self) -> Loaded {
        let dir = tempfile::tempdir().unwrap();
        self.write(dir.path());
        reader::load(dir.path(), &SeriesChoice::Only, &Task::quiet()).unwrap()
    }
}

/// Largest difference from the scene at `n_edge` pixels or more from the edges.
fn largest_fault(volume: &Volume, n_edge: usize) -> f64 {
    let [nx, ny, nz] = volume.dims;
    let mut largest = 0.0_f64;
    for k in 0..nz {
        for j in n_edge..ny - n_edge {
            for i in n_edge..nx - n_edge {
                let p = volume.patient_from_stack.apply(volume.stack_from_voxel(i as f64, j as f64, k));
                largest = largest.max((f64::from(volume.at(i, j, k)) - scene(p)).abs());
            }
        }
    }
    largest
}

fn codes(loaded: &Loaded) -> Vec<&str> {
    loaded.warnings.iter().map(|w| w.code.as_str()).collect()
}

#[test]
fn every_orientation_keeps_every_voxel_in_its_place() {
    let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
    let turned = nalgebra::Rotation3::from_euler_angles(0.4, -0.7, 1.1);
    for (name, row, column) in [
        ("transaxial", x, y),
        ("rows from right to left", -x, y),
        ("columns from back to front", x, -y),
        ("feet first, prone", -x, -y),
        ("coronal", x, -z),
        ("coronal, rows from right to left", -x, -z),
        ("sagittal", y, -z),
        ("sagittal, upside down", -y, z),
        ("oblique", turned * x, turned * y),
        ("oblique, rows reversed", turned * -x, turned * y),
    ] {
        for towards in [1.0, -1.0] {
            let series = Series::new(row, column, row.cross(&column) * (2.0 * towards), 9);
            let loaded = series.load();
            assert_eq!(codes(&loaded), [""; 0], "{name}");
            let fault = largest_fault(&loaded.volume, 0);
            assert!(fault < 0.01, "{name}: {fault} HU");
            assert!(loaded.volume.plane_z_mm.windows(2).all(|w| (w[1] - w[0] - 2.0).abs() < 1e-6), "{name}");
            let is_transaxial = name == "transaxial" || row.z == 0.0 && column.z == 0.0 && row.x.abs() == 1.0;
            assert_eq!(loaded.volume.patient_from_stack.is_identity(), is_transaxial, "{name}");
        }
    }
}

#[test]
fn planes_at_any_distance_and_in_any_order_keep_their_places() {
    let mut series = Series::new(Vector3::x(), Vector3::y(), Vector3::z() * 2.0, 9);
    for (k, shift) in [0.0, 0.3, -0.2, 0.5, 0.0, 0.6, 0.4, 0.0, 0.6].into_iter().enumerate() {
        series.positions[k].z += shift;
    }
    series.positions.swap(0, 5);
    series.positions.swap(2, 7);
    let loaded = series.load();
    assert_eq!(codes(&loaded), ["ct.irregular_spacing"]);
    assert!(largest_fault(&loaded.volume, 0) < 0.01);
    let mut expected: Vec<f64> = series.positions.iter().map(|p| p.z).collect();
    expected.sort_by(f64::total_cmp);
    let z = &loaded.volume.plane_z_mm;
    assert!(z.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-6), "{z:?}");
}

/// The middle of the bright section of plane k, patient coordinates.
fn centroid(volume: &Volume, k: usize) -> Point3 {
    let [nx, ny, _] = volume.dims;
    let (mut sum, mut at) = (0.0, [0.0; 2]);
    for j in 0..ny {
        for i in 0..nx {
            let weight = f64::from(volume.at(i, j, k)) - 40.0;
            sum += weight;
            at[0] += weight * i as f64;
            at[1] += weight * j as f64;
        }
    }
    volume.patient_from_stack.apply(volume.stack_from_voxel(at[0] / sum, at[1] / sum, k))
}

#[test]
fn a_tilted_gantry_is_undone_within_a_fiftieth_of_a_millimetre() {
    for (degrees, across) in [(5.0, false), (17.3, false), (-30.0, false), (12.0, true)] {
        let angle: f64 = f64::to_radians(degrees);
        let (row, column) = if across {
            (Vector3::new(angle.cos(), 0.0, -angle.sin()), Vector3::y())
        } else {
            (Vector3::x(), Vector3::new(0.0, angle.cos(), -angle.sin()))
        };
        // The table moves along the patient's long axis, not along the tilted planes' normal.
        let series = Series::new(row, column, Vector3::z() * 2.0, 12);
        let loaded = series.load();
        assert_eq!(codes(&loaded), ["ct.gantry_tilt"], "{degrees}");
        let volume = &loaded.volume;
        let off_axis = (0..12).map(|k| from_axis(centroid(volume, k))).fold(0.0, f64::max);
        assert!(off_axis < 0.02, "{degrees} degrees: the centreline is {off_axis} mm off");
        let steps = volume.plane_z_mm.windows(2).map(|w| w[1] - w[0]);
        assert!(
            steps.into_iter().all(|s| (s - 2.0 * angle.cos()).abs() < 1e-6),
            "distances along the normal"
        );
        // The wall's grey values, which the boundary is found by: what they are off, as far as that moves it at most.
        let moved_mm = fault_within_the_images(volume, &series) / STEEPEST_HU_PER_MM;
        assert!(moved_mm < 0.02, "{degrees} degrees: the boundary moves by {moved_mm} mm");
    }
}

/// Largest difference from the scene where the images show it, a kernel's width from their edges.
fn fault_within_the_images(volume: &Volume, series: &Series) -> f64 {
    let [nx, ny, nz] = volume.dims;
    let normal = series.row.cross(&series.column);
    let mut largest = 0.0_f64;
    for k in 0..nz {
        let height = |p: Point3| p.coords.dot(&normal);
        let at = volume.patient_from_stack.apply(volume.stack_from_voxel(0.0, 0.0, k));
        let first = *series
            .positions
            .iter()
            .min_by(|a, b| (height(**a) - height(at)).abs().total_cmp(&(height(**b) - height(at)).abs()))
            .unwrap();
        for j in 0..ny {
            for i in 0..nx {
                let p = volume.patient_from_stack.apply(volume.stack_from_voxel(i as f64, j as f64, k));
                let (c, r) = ((p - first).dot(&series.row) / 0.5, (p - first).dot(&series.column) / 0.55);
                if (9.0..80.0).contains(&c) && (9.0..70.0).contains(&r) {
                    largest = largest.max((f64::from(volume.at(i, j, k)) - scene(p)).abs());
                }
            }
        }
    }
    largest
}

#[test]
fn cosines_of_few_digits_give_the_same_shape() {
    let turned = nalgebra::Rotation3::from_euler_angles(0.3, 0.2, -0.1);
    let exact = Series::new(turned * Vector3::x(), turned * Vector3::y(), turned * Vector3::z() * 2.0, 20);
    let round = |v: Vector3| v.map(|x| (x * 1e3).round() / 1e3);
    let rounded = Series {
        row: round(exact.row),
        column: round(exact.column),
        positions: exact.positions.clone(),
        ..exact
    };
    // The pixels are where the exact axes say; only the header is rounded: at most 23 mm from the first pixel's corner.
    let volume = rounded.load().volume;
    assert_eq!(volume.dims, [90, 80, 20]);
    let off_axis = (0..20).map(|k| from_axis(centroid(&volume, k))).fold(0.0, f64::max);
    assert!(off_axis < 0.04, "{off_axis}");
}
