//! Damaged and odd segmentations: a sound structure set (RTSTRUCT) or segmentation (SEG), one thing done to it, and exactly what is
//! said, by the reader and by what brings it into a stack.

use dicom_core::value::{C, DataSetSequence, PrimitiveValue};
use dicom_core::{DataElement, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject};
use lumenfab::progress::Task;
use lumenfab::ready;

type Change = fn(&mut InMemDicomObject);
/// One fault: its name, what does it, and what is said.
type Row = (&'static str, Change, Result<&'static [&'static str], &'static str>);

fn put(object: &mut InMemDicomObject, tag: Tag, vr: VR, value: impl Into<PrimitiveValue>) {
    object.put(DataElement::new(tag, vr, value.into()));
}

fn put_items(object: &mut InMemDicomObject, tag: Tag, items: Vec<InMemDicomObject>) {
    object.put(DataElement::new(tag, VR::SQ, DataSetSequence::from(items)));
}

fn item(fill: impl FnOnce(&mut InMemDicomObject)) -> InMemDicomObject {
    let mut object = InMemDicomObject::new_empty();
    fill(&mut object);
    object
}

/// What is said of an object: an error, or warnings; the file called FILE.
fn said(mut object: InMemDicomObject, class: &str) -> Result<Vec<String>, String> {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("made.dcm");
    put(&mut object, tags::SOP_CLASS_UID, VR::UI, class);
    put(&mut object, tags::SOP_INSTANCE_UID, VR::UI, "2.25.1");
    let meta = FileMetaTableBuilder::new().transfer_syntax(uids::EXPLICIT_VR_LITTLE_ENDIAN);
    object.with_meta(meta).unwrap().write_to_file(&path).unwrap();
    let used = || {
        let ready = ready::load(&path, None, &Task::quiet())?;
        let mut warnings = ready.warnings;
        ready::gaps::resolve(ready.drawn, ready.absent, None, false, &mut warnings)?;
        Ok(warnings.iter().map(|w| format!("{}: {}", w.code, w.text)).collect())
    };
    used().map_err(|e: ready::Error| e.to_string().replace(&path.display().to_string(), "FILE"))
}

fn check(rows: &[Row], sound: fn() -> InMemDicomObject, class: &str) {
    let mut wrong = Vec::new();
    for (name, change, expected) in rows {
        let mut object = sound();
        change(&mut object);
        let said = said(object, class);
        let expected = expected.map(|w| w.iter().map(|t| (*t).to_owned()).collect()).map_err(str::to_owned);
        if said != expected {
            wrong.push(format!("{name}\n   found    {said:?}\n   expected {expected:?}"));
        }
    }
    assert!(wrong.is_empty(), "{} of {} rows:\n{}", wrong.len(), rows.len(), wrong.join("\n"));
}

// -- RTSTRUCT --

/// A square of 10 mm at a height, from the corner (x, 0).
fn square(x: f64, z: f64) -> InMemDicomObject {
    let corners = [[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]];
    let data: Vec<String> = corners.iter().map(|[a, b]| format!("{}\\{b}\\{z}", x + a)).collect();
    item(|o| {
        put(o, tags::CONTOUR_GEOMETRIC_TYPE, VR::CS, "CLOSED_PLANAR");
        put(o, tags::NUMBER_OF_CONTOUR_POINTS, VR::IS, "4");
        put(o, tags::CONTOUR_DATA, VR::DS, data.join("\\"));
    })
}

fn structure_set(contours: Vec<InMemDicomObject>) -> InMemDicomObject {
    item(|o| {
        let roi = item(|s| {
            put(s, tags::ROI_NUMBER, VR::IS, "5");
            put(s, tags::ROI_NAME, VR::LO, "Lumen");
        });
        put_items(o, tags::STRUCTURE_SET_ROI_SEQUENCE, vec![roi]);
        let own = item(|s| {
            put(s, tags::REFERENCED_ROI_NUMBER, VR::IS, "5");
            put_items(s, tags::CONTOUR_SEQUENCE, contours);
        });
        put_items(o, tags::ROI_CONTOUR_SEQUENCE, vec![own]);
    })
}

fn squares() -> Vec<InMemDicomObject> {
    (0..6).map(|k| square(0.0, f64::from(k))).collect()
}

/// The sound structure with its contours changed.
fn redrawn(object: &mut InMemDicomObject, change: impl FnOnce(&mut Vec<InMemDicomObject>)) {
    let mut contours = squares();
    change(&mut contours);
    *object = structure_set(contours);
}

#[test]
fn structure_sets() {
    let rows: &[Row] = &[
        ("sound", |_| {}, Ok(&[])),
        (
            "no structure",
            |o| *o = item(|_| {}),
            Err("FILE holds no structure: every voxel is 0, or there is no closed contour"),
        ),
        (
            "two structures",
            |o| {
                let mut all = o.element(tags::ROI_CONTOUR_SEQUENCE).unwrap().items().unwrap().to_vec();
                all.push(item(|s| {
                    put(s, tags::REFERENCED_ROI_NUMBER, VR::IS, "6");
                    put_items(s, tags::CONTOUR_SEQUENCE, squares());
                }));
                put_items(o, tags::ROI_CONTOUR_SEQUENCE, all);
            },
            Err(
                "FILE holds 2 structures: 5 \"Lumen\" (6 contours), 6 (6 contours): choose one with --label N",
            ),
        ),
        (
            "one structure in two items",
            |o| {
                let part = |contours| {
                    item(|s| {
                        put(s, tags::REFERENCED_ROI_NUMBER, VR::IS, "5");
                        put_items(s, tags::CONTOUR_SEQUENCE, contours);
                    })
                };
                let mut lower = squares();
                let upper = lower.split_off(3);
                put_items(o, tags::ROI_CONTOUR_SEQUENCE, vec![part(lower), part(upper)]);
            },
            Ok(&[]),
        ),
        (
            "contours missing",
            |o| redrawn(o, |c| drop(c.drain(2..4))),
            Err(
                "the structure has no contour between z = 1.000 and 4.000 mm (2 planes): draw it there, or have it led across with --allow-gaps",
            ),
        ),
        (
            "an open contour and a point",
            |o| {
                redrawn(o, |c| {
                    for (n, kind) in [(5, "OPEN_PLANAR"), (4, "POINT")] {
                        put(&mut c[n], tags::CONTOUR_GEOMETRIC_TYPE, VR::CS, kind);
                    }
                });
            },
            Ok(&[
                "ready.open_contours: 2 contour(s) of the structure are open, or points, and were left out at z = 4.000, 5.000 mm: close them where the structure was drawn",
            ]),
        ),
        (
            "a contour twice",
            |o| redrawn(o, |c| c.push(square(0.0, 3.0))),
            Ok(&[
                "ready.doubled_contours: 1 contour(s) of the structure are stored twice at z = 3.000 mm: each was taken once",
            ]),
        ),
        (
            "contours that cross",
            |o| redrawn(o, |c| c.push(square(5.0, 3.0))),
            Ok(&[
                "ready.crossing_contours: contours of the structure cross at z = 3.000 mm: what lies in two of them is outside (even-odd rule); look at the contours before they are used",
            ]),
        ),
        ("contours beside each other", |o| redrawn(o, |c| c.push(square(10.0, 3.0))), Ok(&[])),
        (
            "a contour without coordinates",
            |o| redrawn(o, |c| drop(c[1].take(tags::CONTOUR_DATA))),
            Err("FILE: attribute ContourData is missing or unreadable: export the segmentation again"),
        ),
        (
            "fewer points than it says",
            |o| redrawn(o, |c| put(&mut c[1], tags::NUMBER_OF_CONTOUR_POINTS, VR::IS, "5")),
            Err(
                "FILE: a contour has 12 coordinates, expected three for each of its 5 points: export the structure again",
            ),
        ),
        (
            "a number of points that may be a date",
            |o| redrawn(o, |c| put(&mut c[1], tags::NUMBER_OF_CONTOUR_POINTS, VR::IS, "19330717")),
            Err(
                "FILE: a contour has 12 coordinates, expected three for each of its (a large number) points: export the structure again",
            ),
        ),
        (
            "a contour of two points",
            |o| {
                redrawn(o, |c| {
                    put(&mut c[1], tags::NUMBER_OF_CONTOUR_POINTS, VR::IS, "2");
                    put(&mut c[1], tags::CONTOUR_DATA, VR::DS, "0\\0\\1\\5\\5\\1");
                });
            },
            Err("FILE: a closed contour has 2 points, expected three at least: export the structure again"),
        ),
        (
            "a contour off its plane",
            |o| {
                redrawn(o, |c| {
                    put(&mut c[1], tags::CONTOUR_DATA, VR::DS, "0\\0\\1\\9\\0\\1.6\\9\\9\\1\\0\\9\\1.6")
                })
            },
            Err("FILE: a contour near z = 1.300 mm is 0.300 mm off its plane: export the structure again"),
        ),
        (
            "a contour kilometres away",
            |o| {
                redrawn(o, |c| {
                    put(&mut c[1], tags::CONTOUR_DATA, VR::DS, "0\\0\\1\\9\\0\\1\\193307\\9\\1\\0\\9\\1")
                })
            },
            Err(
                "FILE: a contour has the coordinate (a large number) mm, expected up to 5000 mm: export the structure again",
            ),
        ),
    ];
    check(rows, || structure_set(squares()), uids::RT_STRUCTURE_SET_STORAGE);
}

// -- SEG --

/// Frames of 8 x 8 pixels, 1 mm apart, at these heights; a square of 4 x 4 in each.
fn segmentation(heights_mm: &[f64]) -> InMemDicomObject {
    let frame = |z: &f64| {
        item(|f| {
            let position = item(|g| put(g, tags::IMAGE_POSITION_PATIENT, VR::DS, format!("0\\0\\{z}")));
            put_items(f, tags::PLANE_POSITION_SEQUENCE, vec![position]);
            let segment = item(|g| put(g, tags::REFERENCED_SEGMENT_NUMBER, VR::US, 1_u16));
            put_items(f, tags::SEGMENT_IDENTIFICATION_SEQUENCE, vec![segment]);
        })
    };
    item(|o| {
        let shared = item(|s| {
            let axes = item(|g| put(g, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "1\\0\\0\\0\\1\\0"));
            put_items(s, tags::PLANE_ORIENTATION_SEQUENCE, vec![axes]);
            let pixels = item(|g| put(g, tags::PIXEL_SPACING, VR::DS, "1\\1"));
            put_items(s, tags::PIXEL_MEASURES_SEQUENCE, vec![pixels]);
        });
        put_items(o, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, vec![shared]);
        put_items(o, tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, heights_mm.iter().map(frame).collect());
        put(o, tags::NUMBER_OF_FRAMES, VR::IS, heights_mm.len().to_string());
        for (tag, n) in [(tags::ROWS, 8_u16), (tags::COLUMNS, 8), (tags::BITS_ALLOCATED, 1)] {
            put(o, tag, VR::US, n);
        }
        put(o, tags::SEGMENTATION_TYPE, VR::CS, "BINARY");
        let bits = heights_mm.iter().flat_map(|_| [0, 0, 0x3c, 0x3c, 0x3c, 0x3c, 0, 0]).collect();
        o.put(DataElement::new(tags::PIXEL_DATA, VR::OB, PrimitiveValue::U8(C::from_vec(bits))));
    })
}

#[test]
fn segmentation_objects() {
    let rows: &[Row] = &[
        ("sound", |_| {}, Ok(&[])),
        (
            "planes left out",
            |o| *o = segmentation(&[0.0, 1.0, 2.0, 5.0, 6.0]),
            Ok(&[
                "segment.gap: the segmentation has no plane between z = 2.000 and 5.000 mm (2 planes): a SEG leaves planes without the structure out, so that the vessel is interrupted there (led across with --allow-gaps)",
            ]),
        ),
        (
            "another kind",
            |o| put(o, tags::SEGMENTATION_TYPE, VR::CS, "DOE^JANE"),
            Err(
                "FILE: SegmentationType of another kind with 1 bits is not read: export it as BINARY with 1 bit or FRACTIONAL with 8",
            ),
        ),
        (
            "labels",
            |o| put(o, tags::SEGMENTATION_TYPE, VR::CS, "LABELMAP"),
            Err(
                "FILE: SegmentationType LABELMAP with 1 bits is not read: export it as BINARY with 1 bit or FRACTIONAL with 8",
            ),
        ),
        (
            "rows that may be a date",
            |o| put(o, tags::ROWS, VR::IS, "19330717"),
            Err(
                "FILE: attribute Rows is (a large number), expected 1 to 8192: export the segmentation again",
            ),
        ),
        (
            "frames that may be a date",
            |o| put(o, tags::NUMBER_OF_FRAMES, VR::IS, "19330717"),
            Err(
                "FILE: attribute NumberOfFrames is (a large number), expected 1 to 100000: export the segmentation again",
            ),
        ),
        (
            "fewer groups than frames",
            |o| put(o, tags::NUMBER_OF_FRAMES, VR::IS, "4"),
            Err("FILE: 5 frames are described, 4 are stored: export the segmentation again"),
        ),
        (
            "pixels that end early",
            |o| {
                let few = PrimitiveValue::U8(C::from_vec(vec![0x3c; 30]));
                o.put(DataElement::new(tags::PIXEL_DATA, VR::OB, few));
            },
            Err("FILE: truncated: 30 bytes of pixels, its 5 frames need 40: copy or export it again"),
        ),
        (
            "nothing segmented",
            |o| {
                let none = PrimitiveValue::U8(C::from_vec(vec![0; 40]));
                o.put(DataElement::new(tags::PIXEL_DATA, VR::OB, none));
            },
            Err("FILE holds no structure: every voxel is 0, or there is no closed contour"),
        ),
        (
            "two frames at one height",
            |o| *o = segmentation(&[0.0, 1.0, 1.0, 2.0]),
            Err("FILE: two frames of one segment lie at z = 1.000 mm: export it with one each"),
        ),
    ];
    check(rows, || segmentation(&[0.0, 1.0, 2.0, 3.0, 4.0]), uids::SEGMENTATION_STORAGE);
}
