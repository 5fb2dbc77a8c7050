//! What is damaged or odd in attributes and pixels.

use super::folder::*;
use dicom_core::value::{DataSetSequence, PrimitiveValue};
use dicom_core::{DataElement, VR};
use dicom_dictionary_std::tags;
use dicom_object::InMemDicomObject;

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
                "ct/IM0002.dcm: attribute ImagePositionPatient is [0.0, 0.0, (a large number)], expected coordinates within 100 m: export the series again",
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
                "ct/IM0002.dcm: attribute RescaleSlope is (a large number), expected up to 1000000: export the series again",
            ),
        ),
        (
            "intercept beyond all bounds",
            |f| f.put(tags::RESCALE_INTERCEPT, VR::DS, "-2e6"),
            Err(
                "ct/IM0002.dcm: attribute RescaleIntercept is -(a large number), expected within 1000000: export the series again",
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
            "slices thicker than any scanner makes",
            |f| f.edit_all(|_, o| put(o, tags::SLICE_THICKNESS, VR::DS, "1e300")),
            Ok(&[
                "ct.thickness_not_believed: headers state a slice thickness of more than 20 mm, which no scanner makes; the planes' distance, 3.000 mm, was taken",
            ]),
        ),
        (
            "one slice thicker than any scanner makes",
            |f| f.put(tags::SLICE_THICKNESS, VR::DS, "19330717"),
            Ok(&[
                "ct.thickness_not_believed: headers state a slice thickness of more than 20 mm, which no scanner makes; the planes' distance, 3.000 mm, was taken",
                "ct.thickness_varies: slice thickness varies or is missing in some images; 2.000 mm was taken",
            ]),
        ),
        (
            "slices of a centimetre or two, 3 mm apart",
            |f| f.edit_all(|_, o| put(o, tags::SLICE_THICKNESS, VR::DS, "20")),
            Ok(&[
                "ct.slabs_overlap: headers state slices 20.000 mm thick, 3.000 mm apart: planes that were resampled may keep the thickness of their original; it is taken into account where the vessel is slanted (--boundary half-maximum does without it)",
            ]),
        ),
        (
            "slices half a slab apart",
            |f| f.edit_all(|_, o| put(o, tags::SLICE_THICKNESS, VR::DS, "6")),
            Ok(&[]),
        ),
        (
            "a missing plane under overlapping slabs",
            |f| {
                f.edit_all(|_, o| put(o, tags::SLICE_THICKNESS, VR::DS, "15"));
                std::fs::remove_file(f.file(4)).unwrap();
            },
            Err(
                "1 plane(s) missing between z = 6.000 and 12.000 mm (planes lie 3.000 mm apart): export the series again, or have the gap bridged with --allow-gaps",
            ),
        ),
        (
            "stated spacing that may be a date",
            |f| f.edit_all(|_, o| put(o, tags::SPACING_BETWEEN_SLICES, VR::DS, "19330717")),
            Ok(&[
                "ct.spacing_disagrees: headers state (a large number) mm between planes, positions lie 3.000 mm apart: planes may be missing",
            ]),
        ),
        (
            "rows that may be a date",
            |f| f.put(tags::ROWS, VR::IS, "19330717"),
            Err(
                "ct/IM0002.dcm: attribute Rows is (a large number), expected 1 to 8192: export the series again",
            ),
        ),
        (
            "pixels compressed with loss that the header denies",
            |f| {
                f.edit_all(|_, o| {
                    put_number(o, tags::COLUMNS, 29);
                    put_number(o, tags::ROWS, 23);
                    put(o, tags::LOSSY_IMAGE_COMPRESSION, VR::CS, "00");
                    compressed(o, "1.2.840.10008.1.2.4.81", golden("bits12_near5.jls"));
                });
            },
            Ok(&[
                "ct.lossy: 8 image(s) are compressed with loss although their headers say that they are not: values at the lumen's edge may be altered, so that its boundary is less certain; use the original where there is one",
            ]),
        ),
        (
            "pixels compressed without loss in a syntax that allows it",
            |f| {
                f.edit_all(|_, o| {
                    put_number(o, tags::COLUMNS, 29);
                    put_number(o, tags::ROWS, 23);
                    put(o, tags::LOSSY_IMAGE_COMPRESSION, VR::CS, "00");
                    compressed(o, "1.2.840.10008.1.2.4.81", golden("bits12_near0.jls"));
                });
            },
            Ok(&[]),
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
fn no_number_is_quoted_that_may_be_a_date() {
    let numbers = [
        (tags::SLICE_THICKNESS, VR::DS),
        (tags::SPACING_BETWEEN_SLICES, VR::DS),
        (tags::KVP, VR::DS),
        (tags::ECHO_TIME, VR::DS),
        (tags::TRIGGER_TIME, VR::DS),
        (tags::NOMINAL_PERCENTAGE_OF_CARDIAC_PHASE, VR::DS),
        (tags::ACQUISITION_NUMBER, VR::IS),
        (tags::INSTANCE_NUMBER, VR::IS),
        (tags::TEMPORAL_POSITION_IDENTIFIER, VR::IS),
        (tags::IMAGE_POSITION_PATIENT, VR::DS),
        (tags::IMAGE_ORIENTATION_PATIENT, VR::DS),
        (tags::PIXEL_SPACING, VR::DS),
        (tags::SAMPLES_PER_PIXEL, VR::IS),
        (tags::NUMBER_OF_FRAMES, VR::IS),
        (tags::ROWS, VR::IS),
        (tags::COLUMNS, VR::IS),
        (tags::BITS_ALLOCATED, VR::IS),
        (tags::BITS_STORED, VR::IS),
        (tags::HIGH_BIT, VR::IS),
        (tags::PIXEL_REPRESENTATION, VR::IS),
        (tags::PIXEL_PADDING_VALUE, VR::IS),
        (tags::PIXEL_PADDING_RANGE_LIMIT, VR::IS),
        (tags::RESCALE_SLOPE, VR::DS),
        (tags::RESCALE_INTERCEPT, VR::DS),
    ];
    let several = [
        (tags::PIXEL_SPACING, format!("{DATE}\\1")),
        (tags::IMAGE_POSITION_PATIENT, format!("0\\0\\{DATE}")),
        (tags::IMAGE_ORIENTATION_PATIENT, format!("{DATE}\\0\\0\\0\\1\\0")),
    ];
    let alone = numbers.into_iter().map(|(tag, vr)| (tag, vr, DATE.to_owned()));
    let all = alone.chain(several.into_iter().map(|(tag, value)| (tag, VR::DS, value)));
    for (tag, vr, value) in all {
        let folder = Folder::new();
        folder.edit_all(|_, o| {
            put(o, tags::PIXEL_PADDING_VALUE, VR::IS, "-2000");
            put(o, tag, vr, &value);
        });
        let said = format!("{:?}", folder.said(true));
        assert!(!said.contains(DATE), "{tag}: {said}");
        folder.is_usable();
    }
}
