//! Writes the seeds of all targets below a folder: small sound files of every kind.
//!
//!     cargo run --release --bin seeds -- corpus [PATH/TO/SAMPLE.dcm]...
//!
//! Further DICOM samples, say one of every transfer syntax, become seeds of the targets `dicom` and `planes`, and the compressed
//! image in them one of its codec's.

use dicom_core::value::{DataSetSequence, PixelFragmentSequence, PrimitiveValue, Value};
use dicom_core::{DataElement, Length, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject, open_file};
use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use lumenfab::app::volume_file;
use lumenfab::ct::{Volume, Voxels};
use lumenfab::geom::RigidTransform;
use lumenfab::phantom::{self, Kind, Params};
use lumenfab::progress::Task;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

type Done = Result<(), Box<dyn std::error::Error>>;

fn main() -> Done {
    let mut args = std::env::args_os().skip(1).map(PathBuf::from);
    let root = args.next().unwrap_or_else(|| "corpus".into());
    let save = |target: &str, name: &str, bytes: &[u8]| -> Done {
        fs::create_dir_all(root.join(target))?;
        Ok(fs::write(root.join(target).join(name), bytes)?)
    };
    let values: Vec<u8> = (0..24_i16).flat_map(|v| (v % 3).to_le_bytes()).collect();
    for (name, bytes) in [("v1", nifti(&values)), ("v1.gz", gzip(&nifti(&values))?), ("v2", nifti_2(&values))]
    {
        save("nifti", name, &bytes)?;
    }
    for (name, flag, bytes) in [("raw", "False", values.clone()), ("zlib", "True", zlib(&values)?)] {
        save("metaimage", name, &[meta(flag).as_bytes(), &bytes].concat())?;
    }
    let text = " 0 1 2 1".repeat(6).into_bytes();
    for (encoding, bytes) in [("raw", values.clone()), ("gzip", gzip(&values)?), ("ascii", text)] {
        save("nrrd", encoding, &[nrrd(encoding).as_bytes(), &bytes].concat())?;
    }
    for (name, syntax) in
        [("explicit", uids::EXPLICIT_VR_LITTLE_ENDIAN), ("implicit", uids::IMPLICIT_VR_LITTLE_ENDIAN)]
    {
        save("seg", name, &dicom(seg(), uids::SEGMENTATION_STORAGE, syntax)?)?;
        save("rtstruct", name, &dicom(rtstruct(), uids::RT_STRUCTURE_SET_STORAGE, syntax)?)?;
        save("dicomdir", name, &dicom(directory(), uids::MEDIA_STORAGE_DIRECTORY_STORAGE, syntax)?)?;
        save(
            "dicom",
            &format!("enhanced-{name}"),
            &dicom(enhanced(), uids::ENHANCED_CT_IMAGE_STORAGE, syntax)?,
        )?;
    }
    save("dicom", "phantom", &phantom_image()?)?;
    save("planes", "phantom", &phantom_image()?)?;
    for target in ["dicom", "planes"] {
        // Without preamble and mark.
        save(target, "bare", &phantom_image()?[132..])?;
    }
    let deflated = uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN;
    save("dicom", "enhanced-deflated", &dicom(enhanced(), uids::ENHANCED_CT_IMAGE_STORAGE, deflated)?)?;
    for (name, syntax) in OTHER_ENCODINGS {
        let image = encoded(&phantom_image()?, syntax)?;
        save("dicom", name, &image)?;
        save("planes", name, &image)?;
    }
    save("volume", "tube", &tube())?;
    save("volume_file", "small", &volume_file::to_bytes(&small_volume()))?;
    for (n, text) in CORRECTIONS.iter().enumerate() {
        save("corrections", &n.to_string(), text.as_bytes())?;
    }
    for (target, size, stream) in streams()? {
        save(target, "stream", &[&sides(size), &stream[..]].concat())?;
        let syntax = SYNTAXES.iter().find(|s| s.1 == target).map_or(uids::RLE_LOSSLESS, |s| s.0);
        let object = dicom(packed(size, &stream), uids::ENHANCED_CT_IMAGE_STORAGE, syntax)?;
        save("dicom", &format!("enhanced-{target}"), &object)?;
    }
    for sample in args {
        let (name, bytes) = (sample.file_name().unwrap_or_default().to_string_lossy(), fs::read(&sample)?);
        save("dicom", &name, &bytes)?;
        save("planes", &name, &bytes)?;
        if let Some((target, stream)) = stream_of(&sample) {
            save(target, &name, &stream)?;
        }
    }
    save(
        "sections",
        "triangle",
        br#"{"units":"mm","frame":"LPS","planes":[{"z_mm":0.0,"contours":[[[0,0],[1,0],[0,1]]]}]}"#,
    )?;
    save("sections", "stack", br#"{"units":"mm","frame":"stack","patient_from_stack":[0,0,1,0,1,0,0,0,0,1,0,0,0,0,0,1],"planes":[]}"#)?;
    save(
        "case_file",
        "ct",
        b"ct = \"d\"\nseed_mm = [[1, 2, 3]]\nwindow_hu = [250, 650]\nz_mm = [1, 2]\nwall_mm = 1.0\n",
    )?;
    save(
        "case_file",
        "phantom",
        b"cast = true\n[phantom]\nkind = \"stenosis\"\n[[topology.drop]]\nplane = 3\ncontour = 2\n",
    )
}

fn gzip(bytes: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes)?;
    encoder.finish()
}

fn zlib(bytes: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes)?;
    encoder.finish()
}

/// 4 x 3 x 2 voxels of 16 bits.
fn nifti(values: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0; 352];
    let mut put = |at: usize, b: &[u8]| bytes[at..at + b.len()].copy_from_slice(b);
    put(0, &348_i32.to_le_bytes());
    [3, 4, 3, 2_i16].iter().enumerate().for_each(|(i, n)| put(40 + 2 * i, &n.to_le_bytes()));
    put(70, &4_i16.to_le_bytes());
    [1.0, 0.5, 0.75, 3.0_f32].iter().enumerate().for_each(|(i, v)| put(76 + 4 * i, &v.to_le_bytes()));
    put(108, &352_f32.to_le_bytes());
    put(123, &[2]);
    put(252, &[1, 0, 1, 0]);
    let rows = [-0.5, 0.0, 0.0, 10.0, 0.0, -0.75, 0.0, 20.0, 0.0, 0.0, 3.0, 30.0_f32];
    rows.iter().enumerate().for_each(|(i, v)| put(280 + 4 * i, &v.to_le_bytes()));
    put(344, b"n+1\0");
    bytes.extend(values);
    bytes
}

fn nifti_2(values: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0; 544];
    let mut put = |at: usize, b: &[u8]| bytes[at..at + b.len()].copy_from_slice(b);
    put(0, &540_i32.to_le_bytes());
    put(4, b"n+2\0\r\n\x1a\n");
    put(12, &4_i16.to_le_bytes());
    [3, 4, 3, 2_i64].iter().enumerate().for_each(|(i, n)| put(16 + 8 * i, &n.to_le_bytes()));
    [1.0, 0.5, 0.75, 3.0_f64].iter().enumerate().for_each(|(i, v)| put(104 + 8 * i, &v.to_le_bytes()));
    put(168, &544_i64.to_le_bytes());
    put(344, &[1]);
    put(500, &[2]);
    bytes.extend(values);
    bytes
}

fn meta(compressed: &str) -> String {
    format!(
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = {compressed}\n\
         TransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = 0 0 0\nElementSpacing = 0.5 0.75 3\nDimSize = 4 3 2\n\
         ElementType = MET_SHORT\nElementDataFile = LOCAL\n"
    )
}

fn nrrd(encoding: &str) -> String {
    format!(
        "NRRD0004\ntype: short\ndimension: 3\nspace: left-posterior-superior\nsizes: 4 3 2\n\
         space directions: (0.5,0,0) (0,0.75,0) (0,0,3)\nendian: little\nencoding: {encoding}\nspace origin: (0,0,0)\n\n"
    )
}

fn put(object: &mut InMemDicomObject, tag: Tag, vr: VR, value: impl Into<PrimitiveValue>) {
    object.put(DataElement::new(tag, vr, value.into()));
}

fn put_items(object: &mut InMemDicomObject, tag: Tag, items: Vec<InMemDicomObject>) {
    object.put(DataElement::new(tag, VR::SQ, DataSetSequence::new(items, Length::UNDEFINED)));
}

fn item(fill: impl FnOnce(&mut InMemDicomObject)) -> InMemDicomObject {
    let mut object = InMemDicomObject::new_empty();
    fill(&mut object);
    object
}

fn dicom(
    mut object: InMemDicomObject,
    class: &str,
    syntax: &str,
) -> Result<Vec<u8>, Box<dyn std::error::Error>> {
    put(&mut object, tags::SOP_CLASS_UID, VR::UI, class);
    put(&mut object, tags::SOP_INSTANCE_UID, VR::UI, "2.25.1");
    let place = tempfile::tempdir()?;
    let path = place.path().join("seed");
    object.with_meta(FileMetaTableBuilder::new().transfer_syntax(syntax))?.write_to_file(&path)?;
    Ok(fs::read(path)?)
}

/// What SEG and Enhanced CT share: two frames of 8 x 8 pixels, 3 mm apart.
fn frames(further: fn(&mut InMemDicomObject)) -> InMemDicomObject {
    item(|o| {
        put(o, tags::ROWS, VR::US, 8_u16);
        put(o, tags::COLUMNS, VR::US, 8_u16);
        put(o, tags::NUMBER_OF_FRAMES, VR::IS, "2");
        put(o, tags::SAMPLES_PER_PIXEL, VR::US, 1_u16);
        put(o, tags::PHOTOMETRIC_INTERPRETATION, VR::CS, "MONOCHROME2");
        let measures = item(|s| {
            put(s, tags::PIXEL_SPACING, VR::DS, "0.5\\0.5");
            put(s, tags::SLICE_THICKNESS, VR::DS, "3");
        });
        let orientation = item(|s| put(s, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "1\\0\\0\\0\\1\\0"));
        let shared = item(|s| {
            put_items(s, tags::PIXEL_MEASURES_SEQUENCE, vec![measures]);
            put_items(s, tags::PLANE_ORIENTATION_SEQUENCE, vec![orientation]);
        });
        put_items(o, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, vec![shared]);
        let frame = |z: &str| {
            item(|s| {
                let position = format!("0\\0\\{z}");
                put_items(
                    s,
                    tags::PLANE_POSITION_SEQUENCE,
                    vec![item(|p| put(p, tags::IMAGE_POSITION_PATIENT, VR::DS, position))],
                );
                further(s);
            })
        };
        put_items(o, tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, vec![frame("0"), frame("3")]);
    })
}

fn seg() -> InMemDicomObject {
    let mut o = frames(|s| {
        let segment = item(|p| put(p, tags::REFERENCED_SEGMENT_NUMBER, VR::US, 1_u16));
        put_items(s, tags::SEGMENT_IDENTIFICATION_SEQUENCE, vec![segment]);
    });
    put(&mut o, tags::BITS_ALLOCATED, VR::US, 1_u16);
    put(&mut o, tags::SEGMENTATION_TYPE, VR::CS, "BINARY");
    let plane = [0, 0x3c, 0x7e, 0x7e, 0x7e, 0x7e, 0x3c, 0_u8];
    put(&mut o, tags::PIXEL_DATA, VR::OB, PrimitiveValue::from([plane, plane].concat()));
    o
}

fn enhanced() -> InMemDicomObject {
    let mut o = frames(|_| {});
    put(&mut o, tags::MODALITY, VR::CS, "CT");
    put(&mut o, tags::SERIES_INSTANCE_UID, VR::UI, "2.25.2");
    put(&mut o, tags::FRAME_OF_REFERENCE_UID, VR::UI, "2.25.3");
    put(&mut o, tags::BITS_ALLOCATED, VR::US, 16_u16);
    put(&mut o, tags::BITS_STORED, VR::US, 12_u16);
    put(&mut o, tags::HIGH_BIT, VR::US, 11_u16);
    put(&mut o, tags::PIXEL_REPRESENTATION, VR::US, 0_u16);
    put(&mut o, tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(vec![1000; 128].into()));
    o
}

fn rtstruct() -> InMemDicomObject {
    item(|o| {
        let roi = item(|s| {
            put(s, tags::ROI_NUMBER, VR::IS, "1");
            put(s, tags::ROI_NAME, VR::LO, "Lumen");
        });
        put_items(o, tags::STRUCTURE_SET_ROI_SEQUENCE, vec![roi]);
        let contour = |z: &str| {
            item(|s| {
                put(s, tags::CONTOUR_GEOMETRIC_TYPE, VR::CS, "CLOSED_PLANAR");
                put(s, tags::NUMBER_OF_CONTOUR_POINTS, VR::IS, "4");
                let data = format!("0\\0\\{z}\\9\\0\\{z}\\9\\9\\{z}\\0\\9\\{z}");
                put(s, tags::CONTOUR_DATA, VR::DS, data);
            })
        };
        let own = item(|s| {
            put(s, tags::REFERENCED_ROI_NUMBER, VR::IS, "1");
            put_items(s, tags::CONTOUR_SEQUENCE, vec![contour("0"), contour("3")]);
        });
        put_items(o, tags::ROI_CONTOUR_SEQUENCE, vec![own]);
    })
}

fn directory() -> InMemDicomObject {
    item(|o| {
        let image = item(|s| {
            put(s, tags::DIRECTORY_RECORD_TYPE, VR::CS, "IMAGE");
            put(s, tags::REFERENCED_FILE_ID, VR::CS, "IM0001.DCM");
        });
        put_items(o, tags::DIRECTORY_RECORD_SEQUENCE, vec![image]);
    })
}

/// Transfer syntaxes, and the targets that their streams go to.
const SYNTAXES: [(&str, &str); 8] = [
    (uids::RLE_LOSSLESS, "rle"),
    (uids::JPEG_LOSSLESS_SV1, "jpeg"),
    (uids::JPEG_LOSSLESS, "jpeg"),
    (uids::JPEG_EXTENDED12_BIT, "jpeg"),
    (uids::JPEG_BASELINE8_BIT, "jpeg"),
    (uids::JPEGLS_LOSSLESS, "jpegls"),
    (uids::JPEG2000_LOSSLESS, "jpeg2000"),
    (uids::JPEG2000, "jpeg2000"),
];

/// A stream for every codec: its target, columns and rows, its bytes.
fn streams() -> Result<Vec<(&'static str, [u16; 2], Vec<u8>)>, Box<dyn std::error::Error>> {
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("../golden/codec");
    Ok(vec![
        ("rle", [8, 8], run_lengths()),
        ("jpeg", [8, 8], lossless_jpeg()),
        ("jpegls", [37, 33], fs::read(golden.join("bits12_near0.jls"))?),
        ("jpeg2000", [37, 33], fs::read(golden.join("bits12_unsigned.j2k"))?),
    ])
}

fn sides([columns, rows]: [u16; 2]) -> [u8; 4] {
    let ([a, b], [c, d]) = (columns.to_le_bytes(), rows.to_le_bytes());
    [a, b, c, d]
}

/// 8 x 8 pixels of two bytes: a segment of literals and one that is a run.
fn run_lengths() -> Vec<u8> {
    let mut stream: Vec<u8> = [2, 64, 130_u32].into_iter().flat_map(u32::to_le_bytes).collect();
    stream.resize(64, 0);
    stream.push(63);
    stream.extend(0..64);
    stream.resize(130, 0);
    stream.extend([193, 3]);
    stream
}

/// 8 x 8 pixels that are all alike: one code of one bit.
fn lossless_jpeg() -> Vec<u8> {
    let frame = [0xff, 0xd8, 0xff, 0xc3, 0, 11, 12, 0, 8, 0, 8, 1, 1, 0x11, 0];
    let table = [&[0xff, 0xc4, 0, 20, 0, 1][..], &[0; 16]].concat();
    let scan = [&[0xff, 0xda, 0, 8, 1, 1, 0, 1, 0, 0][..], &[0; 8], &[0xff, 0xd9]].concat();
    [&frame[..], &table, &scan].concat()
}

/// Two frames of one compressed image.
fn packed([columns, rows]: [u16; 2], stream: &[u8]) -> InMemDicomObject {
    let mut o = enhanced();
    put(&mut o, tags::COLUMNS, VR::US, columns);
    put(&mut o, tags::ROWS, VR::US, rows);
    let mut fragment = stream.to_vec();
    fragment.resize(fragment.len().next_multiple_of(2), 0);
    let fragments = PixelFragmentSequence::new_fragments(vec![fragment; 2]);
    o.put(DataElement::new(tags::PIXEL_DATA, VR::OB, Value::PixelSequence(fragments)));
    o
}

/// The compressed image of a sample, and the target that it is for.
fn stream_of(sample: &Path) -> Option<(&'static str, Vec<u8>)> {
    let object = open_file(sample).ok()?;
    let syntax = object.meta().transfer_syntax().trim_end_matches('\0');
    let target = SYNTAXES.iter().find(|s| s.0 == syntax)?.1;
    let side = |tag| object.get(tag)?.to_int::<u16>().ok();
    let Value::PixelSequence(pixels) = object.get(tags::PIXEL_DATA)?.value() else { return None };
    let size = [side(tags::COLUMNS)?, side(tags::ROWS)?];
    Some((target, [&sides(size)[..], &pixels.fragments().concat()].concat()))
}

/// Plain encodings besides the phantom's own.
const OTHER_ENCODINGS: [(&str, &str); 3] = [
    ("implicit", uids::IMPLICIT_VR_LITTLE_ENDIAN),
    ("big", EXPLICIT_VR_BIG_ENDIAN),
    ("deflated", uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN),
];
/// Retired, and still met.
const EXPLICIT_VR_BIG_ENDIAN: &str = "1.2.840.10008.1.2.2";

/// The same object in another encoding.
fn encoded(file: &[u8], syntax: &str) -> Result<Vec<u8>, Box<dyn std::error::Error>> {
    let object = dicom_object::from_reader(file)?.into_inner();
    let class = object.element(tags::SOP_CLASS_UID)?.to_str()?.into_owned();
    dicom(object, &class, syntax)
}

/// What an operator may correct.
const CORRECTIONS: [&str; 5] = [
    "[[block]]\nbox_mm = [[0.0, 0.0, 0.0], [4.0, 12.0, 2.0]]\n",
    "[[block]]\nz_mm = [5.0, 6.0]\n[[window]]\nz_mm = [1.0, 3.0]\nwindow_hu = [100.0, 500.0]\n",
    "[[block]]\npoint_mm = [6.0, 8.0, 3.0]\nnormal = [0.0, 1.0, 0.5]\n",
    "[[contour]]\nz_mm = 3.0\npoints_mm = [[3.0, 3.0], [8.0, 3.0], [8.0, 8.0], [3.0, 8.0]]\n",
    "[[contour]]\npoints_lps_mm = [[3.0, 3.0, 2.0], [8.0, 3.0, 2.0], [5.0, 8.0, 2.0]]\n",
];

/// A bright tube in an image of 24 x 24 x 6 voxels, for the target `volume`.
fn tube() -> Vec<u8> {
    let inside = |p: usize| ((p % 24) as f64 - 11.5).hypot((p / 24) as f64 - 11.5) < 5.0;
    let plane: Vec<u8> = (0..24 * 24).map(|p| if inside(p) { 166 } else { 128 }).collect();
    [&[23, 23, 5, 11, 11, 3, 8, 20], &plane.repeat(6)[..]].concat()
}

fn small_volume() -> Volume {
    Volume {
        dims: [5, 4, 3],
        hu: Voxels::new(&(0..60_u8).map(f32::from).collect::<Vec<f32>>(), 20),
        origin_xy_mm: [-10.0, 20.0],
        pixel_spacing_xy_mm: [0.5, 2.0],
        plane_z_mm: vec![1.0, 4.0, 7.0],
        slab_thickness_mm: 2.0,
        patient_from_stack: RigidTransform::identity(),
    }
}

/// One plane of a phantom's series.
fn phantom_image() -> Result<Vec<u8>, Box<dyn std::error::Error>> {
    let place = tempfile::tempdir()?;
    let params = Params { kind: Kind::Tube, n_planes: 2, n_pixels: 16, pixel_mm: 0.5, ..Params::default() };
    let series: &Path = &place.path().join("series");
    phantom::series::write(series, &params, &Task::quiet())?;
    Ok(fs::read(series.join("IM0001.dcm"))?)
}
