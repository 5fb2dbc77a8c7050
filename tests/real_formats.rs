//! Real volumes in the formats they were published in, against the DICOM series made of the same data.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]

mod shared;

use lumenfab::ct::reader::load_labels;
use lumenfab::ct::{SeriesChoice, Volume, reader};
use lumenfab::progress::Task;
use shared::real;
use std::path::Path;

fn load(path: &Path) -> Volume {
    reader::load(path, &SeriesChoice::Only, &Task::quiet()).unwrap().volume
}

/// Corner voxels of both must lie at the same place.
fn assert_same_place(
    a: &Volume,
    dims: [usize; 3],
    at: impl Fn([usize; 3]) -> lumenfab::geom::Point3,
    tolerance_mm: f64,
) {
    assert_eq!(a.dims, dims);
    for corner in 0..8 {
        let index = [0, 1, 2].map(|axis| if corner >> axis & 1 == 1 { dims[axis] - 1 } else { 0 });
        let own = a.patient_from_stack.apply(a.stack_from_voxel(index[0] as f64, index[1] as f64, index[2]));
        assert!((own - at(index)).norm() < tolerance_mm, "{index:?}: {own} {}", at(index));
    }
}

fn places(v: &Volume) -> impl Fn([usize; 3]) -> lumenfab::geom::Point3 + '_ {
    |[i, j, k]| v.patient_from_stack.apply(v.stack_from_voxel(i as f64, j as f64, k))
}

#[test]
fn the_aortic_arch_as_nifti_is_its_dicom_series() {
    let (Some(nifti), Some(dicom)) = (
        real("2_aortic_arch_branches_cta/original_ct_cropped.nii.gz"),
        real("2_aortic_arch_branches_cta/dicom"),
    ) else {
        return;
    };
    let (nifti, dicom) = (load(&nifti), load(&dicom));
    assert_eq!(nifti.hu, dicom.hu);
    // The header's numbers have four bytes, the series' six decimals.
    assert_same_place(&nifti, dicom.dims, places(&dicom), 2e-5);
}

#[test]
fn the_aortic_bifurcation_as_metaimage_is_its_dicom_series_turned() {
    let (Some(meta), Some(dicom)) =
        (real("1_aortic_bifurcation_mra/original_aorta.mha"), real("1_aortic_bifurcation_mra/dicom"))
    else {
        return;
    };
    let (meta, dicom) = (load(&meta), load(&dicom));
    let [nx, ny, nz] = dicom.dims;
    assert_eq!(meta.dims, [nx, nz, ny]);
    assert!(meta.patient_from_stack.is_identity());
    // The series was made by a quarter turn and 0.25 v - 50, rounded.
    for k in 0..nz {
        for j in 0..ny {
            for i in 0..nx {
                let made = 0.25 * meta.at(i, nz - 1 - k, j) - 50.0;
                assert!((made - dicom.at(i, j, k)).abs() <= 0.501, "{i} {j} {k}");
            }
        }
    }
}

#[test]
fn published_labels_lie_on_the_planes_of_their_series() {
    for case in ["1_aortic_bifurcation_mra", "2_aortic_arch_branches_cta"] {
        let (Some(labels), Some(dicom)) =
            (real(&format!("{case}/reference_label.nii.gz")), real(&format!("{case}/dicom")))
        else {
            continue;
        };
        let (labels, dicom) = (load_labels(&labels, &Task::quiet()).unwrap().unwrap(), load(&dicom));
        assert_eq!(labels.dims, dicom.dims);
        let of_labels = |[i, j, k]: [usize; 3]| {
            let [x, y] =
                [0, 1].map(|a| labels.origin_xy_mm[a] + [i, j][a] as f64 * labels.pixel_spacing_xy_mm[a]);
            labels.patient_from_stack.apply(lumenfab::geom::Point3::new(x, y, labels.plane_z_mm[k]))
        };
        assert_same_place(&dicom, labels.dims, of_labels, 1e-4);
    }
}
