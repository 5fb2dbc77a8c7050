//! Real series and samples, where they are at hand.

use super::super::shared::real;
use super::*;

#[test]
fn the_aortic_bifurcation_has_its_seed_where_it_belongs() {
    let Some(path) = real("1_aortic_bifurcation_mra/dicom") else { return };
    let Loaded { volume, warnings, modality, n_files, frame: _ } =
        load(&path, &SeriesChoice::Only, &Task::quiet()).unwrap();
    assert_eq!((volume.dims, n_files, modality.as_str()), ([157, 34, 393], 393, "CT"));
    let seed = volume.stack_from_voxel(82.0, 15.0, 160);
    assert!((seed - crate::geom::Point3::new(-221.484, 22.501, 165.234)).norm() < 1e-3, "{seed}");
    assert_eq!(volume.at(82, 15, 160), 417.0);
    assert_eq!(volume.voxel_from_stack(seed), Some([82, 15, 160]));
    assert!(warnings.is_empty(), "{warnings:?}");
}

#[test]
fn the_aortic_arch_has_its_seed_where_it_belongs() {
    let Some(path) = real("2_aortic_arch_branches_cta/dicom") else { return };
    let volume = load(&path, &SeriesChoice::Only, &Task::quiet()).unwrap().volume;
    let seed = crate::geom::Point3::new(15.342, -173.158, 774.2);
    assert_eq!(volume.voxel_from_stack(seed), Some([58, 55, 156]));
    assert_eq!(volume.at(58, 55, 156), 477.0);
}

#[test]
fn a_compressed_series_is_read() {
    let Some(path) = real("5_dicom_transfer_syntaxes/series_j2k_20slices") else { return };
    let loaded = load(&path, &SeriesChoice::Only, &Task::quiet()).unwrap();
    assert_eq!(loaded.volume.dims, [512, 512, 20]);
    let steps = loaded.volume.plane_z_mm.windows(2).map(|w| w[1] - w[0]);
    assert!(steps.into_iter().all(|s| (s - 2.0).abs() < 1e-6));
    assert_eq!(loaded.volume.slab_thickness_mm, 3.0);
    let (least, most) = loaded.volume.hu.iter().fold((f32::MAX, f32::MIN), |(a, b), v| (a.min(v), b.max(v)));
    assert!((-3100.0..=-900.0).contains(&least) && (500.0..5000.0).contains(&most), "{least} {most}");
}

/// The intensities of one file of the transfer syntax samples.
fn sample(name: &str) -> Option<Result<Vec<f32>, Error>> {
    let path = real("5_dicom_transfer_syntaxes")?.join(name);
    let header::Content::Images(headers) = header::read(&path, &Task::quiet()).unwrap() else {
        panic!("{name} is an image")
    };
    let mut plane = vec![0.0; headers[0].shape.columns * headers[0].shape.rows];
    Some(pixels::read_plane(&headers[0], &Inflated::default(), [false; 2], &mut plane).map(|_| plane))
}

#[test]
fn lossless_encodings_of_one_image_agree_pixel_by_pixel() {
    for series in ["CT1", "CT2"] {
        let Some(run_length) = sample(&format!("{series}_RLE.dcm")) else { return };
        let run_length = run_length.unwrap();
        for other in ["J2KR", "JPLL", "JLSL"] {
            assert_eq!(
                sample(&format!("{series}_{other}.dcm")).unwrap().unwrap(),
                run_length,
                "{series} {other}"
            );
        }
        let lossy = sample(&format!("{series}_J2KI.dcm")).unwrap().unwrap();
        // Padding becomes air by its exact value, which lossy compression does not keep: left out.
        let differences: Vec<f64> = lossy
            .iter()
            .zip(&run_length)
            .filter(|(_, b)| **b > -1024.0)
            .map(|(a, b)| f64::from((a - b).abs()))
            .collect();
        let mean = differences.iter().sum::<f64>() / differences.len() as f64;
        assert!(mean < 40.0, "{series}: {mean} HU");
    }
}

#[test]
fn decoded_values_are_those_of_an_independent_decoder() {
    // Least, largest and summed stored value as pydicom finds them; slope 1, intercept 0.
    let Some(plane) = sample("CT2_J2KR.dcm") else { return };
    let plane = plane.unwrap();
    let (least, most) = plane.iter().fold((f32::MAX, f32::MIN), |(a, b), &v| (a.min(v), b.max(v)));
    let sum: f64 = plane.iter().map(|&v| f64::from(v)).sum();
    assert_eq!((least, most, sum), (-2048.0, 1433.0, -197_733_355.0));
}
