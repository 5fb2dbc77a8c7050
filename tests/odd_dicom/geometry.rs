//! What is odd about where planes lie, and about several series.

use super::folder::*;
use dicom_core::VR;
use dicom_dictionary_std::tags;
use std::fs;

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
            "more pixels than rows",
            |f| f.edit_all(|_, o| put_number(o, tags::ROWS, 22)),
            Ok(&[
                "ct.more_pixels: 8 image(s) hold more pixels than Rows, Columns and NumberOfFrames say: what is left over was not read; one of these may be wrong",
            ]),
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
            "ct.missing_planes: 1 plane(s) missing in 1 gap(s) in the stack, the first between z = 6.000 and 12.000 mm; the shape there is interpolated",
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
                "2 series in the folder (1: CT, 4 images, 24 x 24 pixels of 0.5000 x 0.5000 mm, normal (0.000, 0.000, 1.000); 2: CT, 4 images, 24 x 24 pixels of 0.5000 x 0.5000 mm, normal (0.000, 0.000, 1.000)): choose one with --series N or its SeriesInstanceUID, or give each its own folder",
            ),
        ),
        (
            "two phases under one UID",
            |f| {
                f.edit_all(|_, o| put(o, tags::NOMINAL_PERCENTAGE_OF_CARDIAC_PHASE, VR::DS, "70"));
                f.doubled(|o| put(o, tags::NOMINAL_PERCENTAGE_OF_CARDIAC_PHASE, VR::DS, "30"));
            },
            Err(
                "2 series in the folder (1: CT, 8 images, 24 x 24 pixels of 0.5000 x 0.5000 mm, normal (0.000, 0.000, 1.000), cardiac phase 30 %; 2: CT, 8 images, 24 x 24 pixels of 0.5000 x 0.5000 mm, normal (0.000, 0.000, 1.000), cardiac phase 70 %): choose one with --series N or its SeriesInstanceUID, or give each its own folder",
            ),
        ),
        (
            "two kernels under one UID",
            |f| {
                f.edit_all(|_, o| put(o, tags::CONVOLUTION_KERNEL, VR::SH, "B30f"));
                f.doubled(|o| put(o, tags::CONVOLUTION_KERNEL, VR::SH, "B60f"));
            },
            Err(
                "2 series in the folder (1: CT, 8 images, 24 x 24 pixels of 0.5000 x 0.5000 mm, normal (0.000, 0.000, 1.000), kernel B30f; 2: CT, 8 images, 24 x 24 pixels of 0.5000 x 0.5000 mm, normal (0.000, 0.000, 1.000), kernel B60f): choose one with --series N or its SeriesInstanceUID, or give each its own folder",
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
