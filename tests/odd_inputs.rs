//! Image files with one fault or oddity each, and the exact words about it.
//!
//! What is wrong with DICOM files has a table of its own.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]

use lumenfab::ct::SeriesChoice;
use lumenfab::ct::reader::{self, Options};
use lumenfab::progress::Task;
use lumenfab::ready;
use std::fs;
use std::io::Write;
use std::path::Path;

const DIMS: [usize; 3] = [4, 3, 2];

fn values() -> Vec<u8> {
    (0..24_i16).flat_map(i16::to_le_bytes).collect()
}

/// A sound NIfTI-1 file: 4 x 3 x 2 voxels of 0.5 x 0.75 x 3 mm, 16-bit integers.
fn nifti() -> Vec<u8> {
    let mut bytes = vec![0; 352];
    let mut put = |at: usize, b: &[u8]| bytes[at..at + b.len()].copy_from_slice(b);
    put(0, &348_i32.to_le_bytes());
    for (i, n) in [3, 4, 3, 2, 1, 1, 1, 1_i16].into_iter().enumerate() {
        put(40 + 2 * i, &n.to_le_bytes());
    }
    put(70, &4_i16.to_le_bytes());
    for (i, v) in [1.0, 0.5, 0.75, 3.0_f32].into_iter().enumerate() {
        put(76 + 4 * i, &v.to_le_bytes());
    }
    put(108, &352_f32.to_le_bytes());
    put(123, &[2]);
    put(254, &1_i16.to_le_bytes());
    for (i, v) in
        [-0.5, 0.0, 0.0, 10.0, 0.0, -0.75, 0.0, 20.0, 0.0, 0.0, 3.0, 30.0_f32].into_iter().enumerate()
    {
        put(280 + 4 * i, &v.to_le_bytes());
    }
    put(344, b"n+1\0");
    bytes.extend(values());
    bytes
}

/// That file with some bytes of its header changed.
fn nifti_with(changes: &[(usize, &[u8])]) -> Vec<u8> {
    let mut bytes = nifti();
    for (at, b) in changes {
        bytes[*at..*at + b.len()].copy_from_slice(b);
    }
    bytes
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn cut(mut bytes: Vec<u8>, by: usize) -> Vec<u8> {
    bytes.truncate(bytes.len() - by);
    bytes
}

const META: &str = "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\n\
TransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = 0 0 0\nElementSpacing = 0.5 0.75 3\nElementSize = 0.5 0.75 2\nDimSize = 4 3 2\n\
Modality = MET_MOD_CT\nElementType = MET_SHORT\nElementDataFile = LOCAL\n";
const NRRD: &str = "NRRD0004\ntype: short\ndimension: 3\nspace: left-posterior-superior\nsizes: 4 3 2\n\
space directions: (0.5,0,0) (0,0.75,0) (0,0,3)\nthicknesses: nan nan 2\nendian: little\nencoding: raw\nspace origin: (0,0,0)\n\n";

/// A text header with some words changed, and the values.
fn headed(header: &str, from: &str, to: &str) -> Vec<u8> {
    assert!(header.contains(from), "{from}");
    [header.replacen(from, to, 1).into_bytes(), values()].concat()
}

fn meta(from: &str, to: &str) -> Vec<u8> {
    headed(META, from, to)
}

fn nrrd(from: &str, to: &str) -> Vec<u8> {
    headed(NRRD, from, to)
}

/// Writes a file under a name that says nothing and gives it to `f`; paths in texts become FILE and DIR.
fn with_file<T>(bytes: &[u8], f: impl Fn(&Path) -> T, text: impl Fn(T) -> String) -> String {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("input");
    fs::write(&path, bytes).unwrap();
    let told = text(f(&path));
    told.replace(path.to_str().unwrap(), "FILE").replace(place.path().to_str().unwrap(), "DIR")
}

fn error(bytes: &[u8]) -> String {
    let load = |path: &Path| reader::load_with(path, &Options::default(), &Task::quiet());
    with_file(bytes, load, |loaded| loaded.map(|_| ()).unwrap_err().to_string())
}

fn warnings(bytes: &[u8]) -> Vec<String> {
    let load = |path: &Path| reader::load_with(path, &Options::default(), &Task::quiet());
    let text = with_file(bytes, load, |loaded| {
        let loaded = loaded.unwrap();
        assert_eq!(loaded.volume.dims, DIMS);
        loaded.warnings.iter().map(|w| format!("{}: {}", w.code, w.text)).collect::<Vec<_>>().join("\n")
    });
    text.lines().map(str::to_owned).collect()
}

#[test]
fn each_fault_of_a_nifti_file_is_named() {
    let packed = gzip(&nifti());
    let mut wrong_sum = packed.clone();
    let at = wrong_sum.len() - 8;
    wrong_sum[at] ^= 1;
    let int = |v: i16| v.to_le_bytes();
    let cases: Vec<(Vec<u8>, &str)> = vec![
        (
            nifti()[..300].to_vec(),
            "FILE: its NIfTI-1 header breaks off after 300 bytes: copy or export the file again",
        ),
        (
            nifti_with(&[(344, b"\0\0\0\0")]),
            "FILE: ANALYZE 7.5 with no mark of NIfTI is not read: convert it to NIfTI, which states its orientation",
        ),
        (
            nifti_with(&[(40, &int(9))]),
            "FILE: its NIfTI-1 header states dim[0] as 9, expected 1 to 7 dimensions: write the file again",
        ),
        (
            nifti_with(&[(40, &int(2))]),
            "FILE: its NIfTI-1 header states dim as 4 3, expected three sizes at least: a volume of planes: write the file again",
        ),
        (
            nifti_with(&[(46, &int(1))]),
            "FILE: its NIfTI-1 header states dim as 4 3 1, expected two planes at least: write the file again",
        ),
        (
            nifti_with(&[(42, &int(-4))]),
            "FILE: its NIfTI-1 header states dim as -4 3 2, expected sizes from 1: write the file again",
        ),
        (
            nifti_with(&[(42, &int(9000))]),
            "FILE: its NIfTI-1 header states dim as 9000 3 2, expected sides up to 8192 voxels: write the file again",
        ),
        (
            nifti_with(&[(70, &int(128))]),
            "FILE: NIfTI-1 with data type 128 (bits, colours, complex or 128-bit numbers) is not read: convert it to integers or floats",
        ),
        (
            nifti_with(&[(70, &int(77))]),
            "FILE: its NIfTI-1 header states datatype as 77, expected a code of the standard: write the file again",
        ),
        (
            nifti_with(&[(108, &100_f32.to_le_bytes())]),
            "FILE: its NIfTI-1 header states vox_offset as 100, expected a place behind the header: write the file again",
        ),
        (
            nifti_with(&[(123, &[5])]),
            "FILE: its NIfTI-1 header states xyzt_units as 5, expected metres, millimetres or micrometres: write the file again",
        ),
        (
            nifti_with(&[(280, &f32::NAN.to_le_bytes())]),
            "FILE: its NIfTI-1 header states its transform as numbers that span no volume, expected three axes in mm: write the file again",
        ),
        (
            nifti_with(&[(304, &0.6_f32.to_le_bytes())]),
            "FILE: its axes are 11.31 degrees off right angles, a sheared grid (gantry tilt?): resample it to right angles",
        ),
        (
            cut(nifti(), 1),
            "FILE: truncated: its header declares 48 bytes of values, there are 47: copy or export the file again",
        ),
        (
            nifti_with(&[(42, &int(8000)), (44, &int(8000)), (46, &int(8000))]),
            "FILE: truncated: its header declares 1024000000000 bytes of values, there are 48: copy or export the file again",
        ),
        (
            gzip(&nifti_with(&[(42, &int(8000)), (44, &int(8000)), (46, &int(8000))])),
            "FILE: truncated: its header declares 1024000000000 bytes of values, more than PACKED gzip bytes can hold: copy or export the file again",
        ),
        (wrong_sum, "FILE: damaged: its gzip values cannot be unpacked: copy or export the file again"),
        (cut(packed, 20), "FILE: damaged: its gzip values cannot be unpacked: copy or export the file again"),
        (
            [nifti_with(&[(40, &int(4)), (48, &int(2))]), values()].concat(),
            "FILE holds 2 volumes (1 to 2: unknown, 2 planes of 4 x 3 pixels of 0.5000 x 0.7500 mm): choose one of them with --series N",
        ),
    ];
    for (bytes, message) in cases {
        let expected = message.replace("PACKED", &bytes.len().to_string());
        assert_eq!(error(&bytes), expected);
    }
}

#[test]
fn each_fault_of_a_metaimage_file_is_named() {
    let state = |field: &str, found: &str, expected: &str| {
        format!(
            "FILE: its MetaImage header states {field} as {found}, expected {expected}: write the file again"
        )
    };
    let missing =
        |field: &str| format!("FILE: its MetaImage header does not state {field}: write the file again");
    let cases: Vec<(Vec<u8>, String)> = vec![
        (META.split("ElementDataFile").next().unwrap().into(), missing("ElementDataFile")),
        (meta("DimSize = 4 3 2\n", ""), missing("DimSize")),
        (meta("ElementType = MET_SHORT\n", ""), missing("ElementType")),
        (meta("DimSize = 4 3 2", "DimSize = 4 3"), state("DimSize", "4 3", "three sizes at least: a volume of planes")),
        (meta("DimSize = 4 3 2", "DimSize = 4 x 2"), state("DimSize", "\"4 x 2\"", "whole numbers")),
        (meta("MET_SHORT", "MET_OTHER"), state("ElementType", "\"MET_OTHER\"", "MET_CHAR to MET_DOUBLE")),
        (meta("= 1 0 0 0 1 0 0 0 1", "= 1 0 0 1"), state("TransformMatrix", "\"1 0 0 1\"", "as many rows of as many numbers as there are dimensions")),
        (meta("= 1 0 0 0 1 0 0 0 1", "= 1 0 0 1 0 0 0 0 1"), state("its axes", "numbers that span no volume", "directions and distances of three axes")),
        (meta("0.5 0.75 3", "0.5 inf 3"), state("ElementSpacing", "\"0.5 inf 3\"", "finite numbers")),
        (meta("Offset = 0 0 0", "Offset = 0 0"), state("Offset", "\"0 0\"", "three numbers")),
        (meta("NDims", "DistanceUnits = inch\nNDims"), state("DistanceUnits", "\"inch\"", "um, mm or cm")),
        (meta("= LOCAL", "= slice%03d.raw 1 2 1"), "FILE: MetaImage with its values in several files is not read: write them into one file".into()),
        (meta("= LOCAL", "= none.raw"), "cannot read DIR/none.raw: No such file or directory (os error 2): check that it exists and may be read".into()),
        (meta("CompressedData = False", "CompressedData = True"), "FILE: damaged: its zlib values cannot be unpacked: copy or export the file again".into()),
        (cut(meta("NDims", "NDims"), 5), "FILE: truncated: its header declares 48 bytes of values, there are 43: copy or export the file again".into()),
        (meta("BinaryData = True", "BinaryData = False"), "FILE: damaged: value number 0 is no number: write the file again".into()),
    ];
    for (bytes, message) in cases {
        assert_eq!(error(&bytes), message);
    }
}

#[test]
fn each_fault_of_a_nrrd_file_is_named() {
    let state = |field: &str, found: &str, expected: &str| {
        format!("FILE: its NRRD header states {field} as {found}, expected {expected}: write the file again")
    };
    let missing = |field: &str| format!("FILE: its NRRD header does not state {field}: write the file again");
    let cases: Vec<(Vec<u8>, String)> = vec![
        (nrrd("type: short\n", ""), missing("type")),
        (nrrd("sizes: 4 3 2\n", ""), missing("sizes")),
        (nrrd("encoding: raw\n", ""), missing("encoding")),
        (nrrd("endian: little\n", ""), missing("endian")),
        (nrrd("type: short", "type: block"), state("type", "\"block\"", "an integer or floating-point type")),
        (nrrd("sizes: 4 3 2", "sizes: 4 3 2 1 1"), state("sizes", "\"4 3 2 1 1\"", "three or four sizes")),
        (nrrd("left-posterior-superior", "left-posterior"), state("space", "\"left-posterior\"", "a space of the format")),
        (nrrd("left-posterior-superior", "3D-left-handed"), state("space", "\"3D-left-handed\"", "a right-handed space (left-posterior-superior, right-anterior-superior, 3D-right-handed): a left-handed one shows the vessel mirrored")),
        (nrrd("(0,0,3)", "(0,3)"), state("space directions", "\"(0.5,0,0) (0,0.75,0) (0,3)\"", "vectors (x,y,z) of finite numbers")),
        (nrrd("(0,0,3)", ""), state("space directions", "\"(0.5,0,0) (0,0.75,0)\"", "a direction for each axis")),
        (nrrd("(0,0,3)", "(0,1,3)"), "FILE: its axes are 18.43 degrees off right angles, a sheared grid (gantry tilt?): resample it to right angles".into()),
        (nrrd("encoding: raw", "encoding: bzip2"), "FILE: NRRD with encoding bzip2 is not read: write it raw or gzip".into()),
        (nrrd("encoding: raw", "encoding: zip"), state("encoding", "\"zip\"", "raw, gzip or ascii")),
        (nrrd("encoding: raw", "encoding: gzip"), "FILE: damaged: its gzip values cannot be unpacked: copy or export the file again".into()),
        (nrrd("encoding: raw", "data file: LIST\nencoding: raw"), "FILE: NRRD with its values in several files is not read: write them into one file".into()),
        (nrrd("encoding: raw", "encoding: raw\nspace units: \"ft\" \"ft\" \"ft\""), state("space units", "\"\\\"ft\\\" \\\"ft\\\" \\\"ft\\\"\"", "um, mm, cm or m, the same for all axes")),
        (cut(nrrd("type", "type"), 2), "FILE: truncated: its header declares 48 bytes of values, there are 46: copy or export the file again".into()),
    ];
    for (bytes, message) in cases {
        assert_eq!(error(&bytes), message);
    }
}

#[test]
fn each_oddity_that_can_be_used_is_told() {
    let bare = |format: &str| {
        [
            format!("ct.modality: the {format} file states no modality: intensities were taken as HU"),
            format!(
                "ct.no_thickness: the {format} file states no slice thickness; the planes' distance, 3.000 mm, was taken"
            ),
        ]
    };
    let before = |first: &str| [&[first.to_owned()][..], &bare("NIfTI-1")].concat();
    assert_eq!(warnings(&nifti()), bare("NIfTI-1"));
    let no_unit = nifti_with(&[(123, &[0])]);
    assert_eq!(
        warnings(&no_unit),
        before("ct.no_unit: the file does not state its unit of length; mm was taken")
    );
    let plain = nifti_with(&[(254, &[0, 0])]);
    assert_eq!(
        warnings(&plain),
        before(
            "ct.no_orientation: the file does not state how the volume lies in the patient; columns were taken to run right, rows to the front, planes up"
        )
    );
    // A qform of zeros puts the first voxel at the origin, the sform at (10, 20, 30).
    let two = nifti_with(&[(252, &[1, 0])]);
    assert_eq!(
        warnings(&two),
        before(
            "ct.transforms_disagree: sform and qform place voxels up to 37.417 mm apart; the sform was used"
        )
    );
    let slope = nifti_with(&[(112, &f32::INFINITY.to_le_bytes())]);
    assert_eq!(
        warnings(&slope),
        before(
            "ct.no_rescale: slope and intercept of the values are no numbers: the values were taken as they stand"
        )
    );
    let lean = nifti_with(&[(304, &0.2_f32.to_le_bytes())]);
    assert_eq!(
        warnings(&lean),
        before("ct.plane_offset: planes lie up to 0.200 mm beside each other; this was ignored")
    );
    let longer = [nifti(), vec![0; 3]].concat();
    let more =
        "ct.more_values: the file goes on after the values that its header declares; the rest was left out";
    assert_eq!(warnings(&longer), [&bare("NIfTI-1")[..], &[more.to_owned()]].concat());
    assert_eq!(warnings(&meta("NDims", "NDims")), Vec::<String>::new());
    assert_eq!(
        warnings(&meta("MET_MOD_CT", "MET_MOD_MR")),
        ["ct.modality: modality is MR, not CT: intensities are not Hounsfield units"]
    );
    let placeless = "ct.no_orientation: the file does not state how the volume lies in the patient; columns were taken to run left, rows to the back, planes up";
    assert_eq!(warnings(&meta("TransformMatrix = 1 0 0 0 1 0 0 0 1\n", "")), [placeless]);
    let text = NRRD.replace("short", "float").replace("raw", "ascii") + "nan inf" + &" 1".repeat(22);
    let filled = "ct.no_value: 2 voxel(s) without a value (NaN or infinite) were taken as air, -1024 HU";
    assert_eq!(warnings(text.as_bytes()), [&bare("NRRD")[0], filled]);
}

#[test]
fn a_volume_that_is_not_there_is_refused_by_its_number() {
    let options = Options { choice: SeriesChoice::ByNumber(2), ..Options::default() };
    let load = |path: &Path| reader::load_with(path, &options, &Task::quiet());
    let text = with_file(&nifti(), load, |loaded| loaded.map(|_| ()).unwrap_err().to_string());
    assert_eq!(
        text,
        "there is no series number 2 (1: unknown, 2 planes of 4 x 3 pixels of 0.5000 x 0.7500 mm): choose one of these with --series N"
    );
}

#[test]
fn each_fault_of_a_label_map_is_named() {
    let map = |values: &[i16]| {
        let mut bytes = nifti();
        bytes.truncate(352);
        bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        bytes
    };
    let error = |bytes: &[u8], label: Option<u32>| {
        let label = label.map(ready::Label::Number);
        let load = |path: &Path| ready::load(path, label.as_ref(), &Task::quiet());
        with_file(bytes, load, |loaded| loaded.map(|_| ()).unwrap_err().to_string())
    };
    let mut two = [0; 24];
    two[5..8].fill(3);
    two[9] = 7;
    let mut negative = [0; 24];
    negative[4] = -1;
    for (bytes, label, message) in [
        (map(&[0; 24]), None, "FILE holds no structure: every voxel is 0, or there is no closed contour"),
        (map(&two), None, "FILE holds 2 structures: 3 (3 voxels), 7 (1 voxels): choose one with --label N"),
        (
            map(&two),
            Some(4),
            "FILE holds no such structure: there is 3 (3 voxels), 7 (1 voxels): choose one of these with --label N",
        ),
        (
            map(&negative),
            None,
            "FILE: voxel 4 has the value -1, expected a whole number from 0 to 4294967295: a label map is needed, not an image",
        ),
        (
            b"not an image at all".to_vec(),
            None,
            "FILE is no segmentation: expected a label map (NIfTI, MetaImage, NRRD), a DICOM SEG or an RTSTRUCT",
        ),
    ] {
        assert_eq!(error(&bytes, label), message);
    }
}
