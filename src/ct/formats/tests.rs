//! Analytic grids written in each format and read back.

use super::*;
use crate::ct::Volume;
use crate::geom::{Point3, Vector3};
use crate::progress::Task;
use flate2::Compression;
use flate2::write::{GzEncoder, ZlibEncoder};
use std::io::Write;

/// Small enough to be written in every type, with a place, spacings and axes of its own.
pub(crate) fn sample() -> Grid {
    Grid {
        dims: [5, 4, 3],
        origin: Point3::new(-12.5, 20.25, 7.75),
        axes_mm: [Vector3::x() * 0.5, Vector3::y() * 0.75, Vector3::z() * 3.0],
    }
}

fn rotated(by_deg: [f64; 3]) -> Grid {
    let [a, b, c] = by_deg.map(f64::to_radians);
    let rotation = nalgebra::Rotation3::from_euler_angles(a, b, c);
    let grid = sample();
    Grid { axes_mm: grid.axes_mm.map(|v| rotation * v), ..grid }
}

/// A value for every voxel, a whole number below 128.
fn value(i: usize, j: usize, k: usize) -> f64 {
    (i + 7 * j + 31 * k) as f64
}

fn values(grid: &Grid) -> Vec<f64> {
    let [nx, ny, nz] = grid.dims;
    let rows = (0..nz).flat_map(|k| (0..ny).map(move |j| (j, k)));
    rows.flat_map(|(j, k)| (0..nx).map(move |i| value(i, j, k))).collect()
}

fn packed(values: &[f64], scalar: Scalar, endian: Endian) -> Vec<u8> {
    macro_rules! bytes {
        ($($name:ident: $type:ty),*) => {
            match scalar {
                $(Scalar::$name => values.iter().flat_map(|&v| {
                    let v = v as $type;
                    if endian == Endian::Little { v.to_le_bytes().to_vec() } else { v.to_be_bytes().to_vec() }
                }).collect(),)*
            }
        };
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the values fit every type")]
    let bytes = bytes!(U8: u8, I8: i8, U16: u16, I16: i16, U32: u32, I32: i32, U64: u64, I64: i64, F32: f32, F64: f64);
    bytes
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

const SCALARS: [Scalar; 10] = [
    Scalar::U8,
    Scalar::I8,
    Scalar::U16,
    Scalar::I16,
    Scalar::U32,
    Scalar::I32,
    Scalar::U64,
    Scalar::I64,
    Scalar::F32,
    Scalar::F64,
];

fn read(bytes: &[u8], volume: usize) -> Result<(Header, Volume), Fault> {
    let header = recognise(bytes)?.expect("one of the formats");
    #[expect(clippy::cast_possible_truncation, reason = "the values fit every type")]
    let read = values::read(&header, bytes, volume, &Task::quiet(), |v, _| Ok(v as f32))?;
    assert!(!read.goes_on);
    let placed = header.grid.place()?;
    let volume = placed.into_volume(read.values, 1.0);
    Ok((header, volume))
}

/// Every voxel of the grid must be found at its place in the patient, with its value.
fn assert_is(grid: &Grid, volume: &Volume, tolerance_mm: f64) {
    let [nx, ny, nz] = grid.dims;
    let stack_from_patient = volume.patient_from_stack.inverse();
    assert!(volume.plane_z_mm.windows(2).all(|z| z[1] > z[0]));
    for (i, j, k) in (0..nz).flat_map(|k| (0..ny).flat_map(move |j| (0..nx).map(move |i| (i, j, k)))) {
        let steps = grid.axes_mm[0] * i as f64 + grid.axes_mm[1] * j as f64 + grid.axes_mm[2] * k as f64;
        let place = stack_from_patient.apply(grid.origin + steps);
        let [a, b, c] = volume.voxel_from_stack(place).expect("inside");
        let off_mm = (volume.stack_from_voxel(a as f64, b as f64, c) - place).norm();
        assert!(
            off_mm < tolerance_mm,
            "voxel {i} {j} {k} is {off_mm} mm off, more than {tolerance_mm}: {grid:?}"
        );
        assert_eq!(f64::from(volume.at(a, b, c)), value(i, j, k), "voxel {i} {j} {k}");
    }
}

/// Grids whichever way their axes run; the numbers of the first ones can be written exactly.
fn grids() -> Vec<Grid> {
    let mut grids = Vec::new();
    for signs in 0..8 {
        let sign = |axis: usize| if signs >> axis & 1 == 1 { -1.0 } else { 1.0 };
        for order in [[0, 1, 2], [1, 2, 0], [2, 0, 1], [1, 0, 2], [0, 2, 1], [2, 1, 0]] {
            let units = [Vector3::x(), Vector3::y(), Vector3::z()];
            let axes_mm = [0, 1, 2].map(|a| units[order[a]] * sign(a) * sample().axes_mm[a].norm());
            grids.push(Grid { axes_mm, ..sample() });
        }
    }
    grids
}

fn oblique() -> Vec<Grid> {
    vec![rotated([10.0, -20.0, 30.0]), rotated([90.0, 0.0, 5.0]), rotated([179.0, 1.0, 91.0])]
}

// -- writers, in the words of each format --

#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Form {
    S,
    Q,
    Both,
}

/// RAS is LPS turned about z.
fn ras(v: Vector3) -> Vector3 {
    Vector3::new(-v.x, -v.y, v.z)
}

/// The rotation of the axes in RAS, its first component not negative; a left-handed slice axis is turned round.
fn quaternion(grid: &Grid) -> nalgebra::Quaternion<f64> {
    let [a, b, c] = grid.axes_mm.map(|v| ras(v).normalize());
    let handed = if a.cross(&b).dot(&c) < 0.0 { -1.0 } else { 1.0 };
    let rotation =
        nalgebra::Rotation3::from_matrix_unchecked(nalgebra::Matrix3::from_columns(&[a, b, c * handed]));
    let q = nalgebra::UnitQuaternion::from_rotation_matrix(&rotation).into_inner();
    if q.w < 0.0 { -q } else { q }
}

/// What four-byte numbers keep of a place in the sample, mm: of the quaternion's first component, which follows from the
/// others, the less the nearer it is to a half turn.
fn narrow_mm(grid: &Grid, form: Form) -> f64 {
    let w = quaternion(grid).w;
    let noise = 3.0 * f64::from(f32::EPSILON);
    // Its square is lost among the others' where it is smaller than their rounding.
    let lost = if w * w < noise { w } else { 0.5 * noise / w };
    let lost = if form == Form::Q { lost } else { 0.0 };
    let is_upright = grid.axes_mm.iter().all(|a| a.iter().filter(|v| **v != 0.0).count() == 1);
    let rounding = if form != Form::Q && is_upright { 1e-6 } else { 1e-5 };
    rounding + 2.0 * lost * 20.0
}

/// A NIfTI file, version 1 or 2.
pub(crate) fn nifti(
    version: u8,
    grid: &Grid,
    scalar: Scalar,
    endian: Endian,
    form: Form,
    n_volumes: usize,
) -> Vec<u8> {
    let wide = version == 2;
    let mut bytes = vec![0_u8; if wide { 544 } else { 352 }];
    let order = |mut b: Vec<u8>| {
        if endian == Endian::Big {
            b.reverse();
        }
        b
    };
    let mut put = |at: usize, b: Vec<u8>| {
        let b = order(b);
        bytes[at..at + b.len()].copy_from_slice(&b);
    };
    #[expect(clippy::cast_possible_truncation, reason = "as narrow as the format")]
    let real = |v: f64| if wide { v.to_le_bytes().to_vec() } else { (v as f32).to_le_bytes().to_vec() };
    let size = |v: usize| {
        if wide {
            (v as i64).to_le_bytes().to_vec()
        } else {
            i16::try_from(v).unwrap().to_le_bytes().to_vec()
        }
    };
    let (size_at, real_at) = if wide { (8, 8) } else { (2, 4) };
    put(0, if wide { 540_i32 } else { 348 }.to_le_bytes().to_vec());
    let [nx, ny, nz] = grid.dims;
    let dim_at = if wide { 16 } else { 40 };
    for (i, n) in [if n_volumes > 1 { 4 } else { 3 }, nx, ny, nz, n_volumes].into_iter().enumerate() {
        put(dim_at + size_at * i, size(n));
    }
    let code = match scalar {
        Scalar::U8 => 2_i16,
        Scalar::I16 => 4,
        Scalar::I32 => 8,
        Scalar::F32 => 16,
        Scalar::F64 => 64,
        Scalar::I8 => 256,
        Scalar::U16 => 512,
        Scalar::U32 => 768,
        Scalar::I64 => 1024,
        Scalar::U64 => 1280,
    };
    put(if wide { 12 } else { 70 }, code.to_le_bytes().to_vec());
    put(
        if wide { 168 } else { 108 },
        if wide { 544_i64.to_le_bytes().to_vec() } else { 352_f32.to_le_bytes().to_vec() },
    );
    put(if wide { 500 } else { 123 }, if wide { 2_i32.to_le_bytes().to_vec() } else { vec![2] });
    let [a, b, c] = grid.axes_mm.map(ras);
    let handed = if a.cross(&b).dot(&c) < 0.0 { -1.0 } else { 1.0 };
    let pixdim_at = if wide { 104 } else { 76 };
    for (i, v) in [handed, a.norm(), b.norm(), c.norm()].into_iter().enumerate() {
        put(pixdim_at + real_at * i, real(v));
    }
    let [qform_at, codes] = if wide { [344, 4] } else { [252, 2] };
    let flag = |on: bool| {
        if wide { i32::from(on).to_le_bytes().to_vec() } else { i16::from(on).to_le_bytes().to_vec() }
    };
    put(qform_at, flag(matches!(form, Form::Q | Form::Both)));
    put(qform_at + codes, flag(matches!(form, Form::S | Form::Both)));
    let q = quaternion(grid);
    let o = ras(grid.origin.coords);
    for (i, v) in [q.i, q.j, q.k, o.x, o.y, o.z].into_iter().enumerate() {
        put(if wide { 352 } else { 256 } + real_at * i, real(v));
    }
    for row in 0..3 {
        for (column, v) in [a[row], b[row], c[row], o[row]].into_iter().enumerate() {
            put(if wide { 400 } else { 280 } + real_at * (4 * row + column), real(v));
        }
    }
    let magic: &[u8] = if wide { b"n+2\0\r\n\x1a\n" } else { b"n+1\0" };
    let at = if wide { 4 } else { 344 };
    bytes[at..at + magic.len()].copy_from_slice(magic);
    for v in 0..n_volumes {
        let shifted: Vec<f64> = values(grid).iter().map(|x| x + v as f64).collect();
        bytes.extend(packed(&shifted, scalar, endian));
    }
    bytes
}

fn numbers(v: impl IntoIterator<Item = f64>, by: &str) -> String {
    v.into_iter().map(|n| n.to_string()).collect::<Vec<_>>().join(by)
}

/// A MetaImage file; what the tests change comes before the last line.
fn metaimage(grid: &Grid, scalar: Scalar, endian: Endian, extra: &str, data: &[u8]) -> Vec<u8> {
    let [nx, ny, nz] = grid.dims;
    let element = match scalar {
        Scalar::U8 => "UCHAR",
        Scalar::I8 => "CHAR",
        Scalar::U16 => "USHORT",
        Scalar::I16 => "SHORT",
        Scalar::U32 => "UINT",
        Scalar::I32 => "INT",
        Scalar::U64 => "ULONG_LONG",
        Scalar::I64 => "LONG_LONG",
        Scalar::F32 => "FLOAT",
        Scalar::F64 => "DOUBLE",
    };
    let matrix =
        numbers(grid.axes_mm.iter().flat_map(|a| a.normalize().iter().copied().collect::<Vec<_>>()), " ");
    let head = format!(
        "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = {}\nTransformMatrix = {matrix}\n\
         Offset = {}\nElementSpacing = {}\nDimSize = {nx} {ny} {nz}\nElementType = MET_{element}\n{extra}ElementDataFile = LOCAL\n",
        if endian == Endian::Big { "True" } else { "False" },
        numbers(grid.origin.iter().copied(), " "),
        numbers(grid.axes_mm.map(|a| a.norm()), " "),
    );
    [head.as_bytes(), data].concat()
}

/// A NRRD file in the given space.
fn nrrd(grid: &Grid, scalar: Scalar, endian: Endian, encoding: &str, space: &str, data: &[u8]) -> Vec<u8> {
    let [nx, ny, nz] = grid.dims;
    let kind = match scalar {
        Scalar::F32 => "float",
        Scalar::F64 => "double",
        other => other.name(),
    };
    let flip = match space {
        "right-anterior-superior" => [-1.0, -1.0, 1.0],
        "left-anterior-superior" => [1.0, -1.0, 1.0],
        _ => [1.0; 3],
    };
    let vector = |v: Vector3| format!("({})", numbers((0..3).map(|i| v[i] * flip[i]), ","));
    let head = format!(
        "NRRD0004\n# a comment\ntype: {kind}\ndimension: 3\nspace: {space}\nsizes: {nx} {ny} {nz}\n\
         space directions: {} {} {}\nkinds: domain domain domain\nendian: {}\nencoding: {encoding}\n\
         space origin: {}\nkey:=value\n\n",
        vector(grid.axes_mm[0]),
        vector(grid.axes_mm[1]),
        vector(grid.axes_mm[2]),
        if endian == Endian::Big { "big" } else { "little" },
        vector(grid.origin.coords),
    );
    [head.as_bytes(), data].concat()
}

// -- every type, byte order and packing --

#[test]
fn nifti_of_every_type_reads_back_exactly() {
    for (version, scalar, endian) in combinations([1, 2]) {
        let bytes = nifti(version, &sample(), scalar, endian, Form::S, 1);
        for bytes in [gzip(&bytes), bytes] {
            let (header, volume) = read(&bytes, 0).unwrap();
            assert_is(&sample(), &volume, 1e-6);
            assert!(volume.patient_from_stack.is_identity() && header.warnings.is_empty(), "{header:?}");
        }
    }
}

fn combinations<const N: usize>(of: [u8; N]) -> impl Iterator<Item = (u8, Scalar, Endian)> {
    let types = SCALARS.into_iter().flat_map(|s| [(s, Endian::Little), (s, Endian::Big)]);
    of.into_iter().flat_map(move |v| types.clone().map(move |(s, e)| (v, s, e)))
}

#[test]
fn metaimage_of_every_type_reads_back_exactly() {
    for (_, scalar, endian) in combinations([0]) {
        let data = packed(&values(&sample()), scalar, endian);
        let compressed = "CompressedData = True\n";
        for bytes in [
            metaimage(&sample(), scalar, endian, "", &data),
            metaimage(&sample(), scalar, endian, compressed, &zlib(&data)),
            metaimage(&sample(), scalar, endian, compressed, &gzip(&data)),
            metaimage(
                &sample(),
                scalar,
                endian,
                "BinaryData = False\n",
                numbers(values(&sample()), " ").as_bytes(),
            ),
        ] {
            assert_is(&sample(), &read(&bytes, 0).unwrap().1, 1e-6);
        }
    }
}

#[test]
fn nrrd_of_every_type_reads_back_exactly() {
    for (_, scalar, endian) in combinations([0]) {
        let data = packed(&values(&sample()), scalar, endian);
        let text = numbers(values(&sample()), "\n");
        let space = "left-posterior-superior";
        for (encoding, data) in [("raw", data.clone()), ("gzip", gzip(&data)), ("ascii", text.into_bytes())] {
            let bytes = nrrd(&sample(), scalar, endian, encoding, space, &data);
            assert_is(&sample(), &read(&bytes, 0).unwrap().1, 1e-6);
        }
    }
}

// -- every orientation --

#[test]
fn every_orientation_keeps_its_place_in_the_patient() {
    for grid in grids().into_iter().chain(oblique()) {
        let data = packed(&values(&grid), Scalar::I16, Endian::Little);
        for form in [Form::S, Form::Q, Form::Both] {
            let wide = read(&nifti(2, &grid, Scalar::I16, Endian::Little, form, 1), 0).unwrap();
            assert_is(&grid, &wide.1, 1e-6);
            assert!(wide.0.warnings.is_empty(), "{:?}", wide.0.warnings);
            let narrow = read(&nifti(1, &grid, Scalar::I16, Endian::Big, form, 1), 0).unwrap();
            assert_is(&grid, &narrow.1, narrow_mm(&grid, form));
        }
        assert_is(
            &grid,
            &read(&metaimage(&grid, Scalar::I16, Endian::Little, "", &data), 0).unwrap().1,
            1e-6,
        );
        for space in ["left-posterior-superior", "right-anterior-superior", "left-anterior-superior"] {
            let bytes = nrrd(&grid, Scalar::I16, Endian::Little, "raw", space, &data);
            assert_is(&grid, &read(&bytes, 0).unwrap().1, 1e-6);
        }
    }
}

#[test]
fn a_transaxial_grid_is_the_patients_frame_whichever_way_it_is_stored() {
    for grid in grids() {
        let placed = grid.place().unwrap();
        let is_flat = grid.axes_mm[0].x != 0.0 && grid.axes_mm[1].y != 0.0;
        assert_eq!(placed.patient_from_stack.is_identity(), is_flat);
        let rotation = placed.patient_from_stack.matrix().fixed_view::<3, 3>(0, 0).determinant();
        assert!((rotation - 1.0).abs() < 1e-12, "a rotation, never a mirror");
    }
}

#[test]
fn a_sheared_grid_is_refused_and_a_little_shear_is_told() {
    let sheared = |by_mm: f64| {
        let grid = sample();
        let [x, y, z] = grid.axes_mm;
        Grid { axes_mm: [x, y, z + Vector3::y() * by_mm], ..grid }.place()
    };
    let fault = sheared(0.53).unwrap_err();
    assert!(matches!(fault, Fault::Sheared { angle_deg } if (angle_deg - 10.02).abs() < 0.01), "{fault}");
    assert_eq!(sheared(0.1).unwrap().warnings[0].code, "ct.plane_offset");
    assert!(sheared(0.01).unwrap().warnings.is_empty());
}

// -- several volumes, scaling, warnings --

#[test]
fn one_of_several_volumes_is_read() {
    let bytes = nifti(1, &sample(), Scalar::I16, Endian::Little, Form::S, 3);
    for v in 0..3 {
        let (header, volume) = read(&bytes, v).unwrap();
        assert_eq!((header.n_volumes, f64::from(volume.at(2, 1, 1))), (3, value(2, 1, 1) + v as f64));
    }
    let twice: Vec<f64> = values(&sample()).into_iter().flat_map(|v| [v, v + 50.0]).collect();
    let data = packed(&twice, Scalar::U8, Endian::Little);
    let channels = metaimage(&sample(), Scalar::U8, Endian::Little, "ElementNumberOfChannels = 2\n", &data);
    let nrrd = nrrd(&sample(), Scalar::U8, Endian::Little, "raw", "left-posterior-superior", &data);
    let nrrd = replaced(
        &nrrd,
        &[
            ("sizes: 5", "sizes: 2 5"),
            ("dimension: 3", "dimension: 4"),
            ("directions: ", "directions: none "),
        ],
    );
    for bytes in [channels, nrrd] {
        let (header, volume) = read(&bytes, 1).unwrap();
        assert_eq!((header.n_volumes, f64::from(volume.at(2, 1, 1))), (2, value(2, 1, 1) + 50.0));
    }
}

/// The file with some words of its header changed.
fn replaced(bytes: &[u8], words: &[(&str, &str)]) -> Vec<u8> {
    let mut text: Vec<u8> = bytes.to_vec();
    for (from, to) in words {
        let at = text.windows(from.len()).position(|w| w == from.as_bytes()).expect("it is there");
        text.splice(at..at + from.len(), to.bytes());
    }
    text
}

#[test]
fn slope_and_intercept_rescale_the_values() {
    let mut bytes = nifti(1, &sample(), Scalar::I16, Endian::Little, Form::S, 1);
    bytes[112..116].copy_from_slice(&2_f32.to_le_bytes());
    bytes[116..120].copy_from_slice(&(-1024_f32).to_le_bytes());
    assert_eq!(f64::from(read(&bytes, 0).unwrap().1.at(2, 1, 1)), 2.0 * value(2, 1, 1) - 1024.0);
    bytes[112..116].copy_from_slice(&1e30_f32.to_le_bytes());
    let refused = read(&bytes, 0).unwrap_err().to_string();
    assert!(refused.contains("scl_slope") && refused.contains("within 1000000"), "{refused}");
    bytes[112..116].copy_from_slice(&f32::NAN.to_le_bytes());
    let (header, volume) = read(&bytes, 0).unwrap();
    assert_eq!(
        (header.warnings[0].code.as_str(), f64::from(volume.at(2, 1, 1))),
        ("ct.no_rescale", value(2, 1, 1))
    );
}

#[test]
fn the_sform_goes_before_the_qform_and_a_disagreement_is_told() {
    let mut bytes = nifti(2, &sample(), Scalar::I16, Endian::Little, Form::Both, 1);
    bytes[376..384].copy_from_slice(&100_f64.to_le_bytes());
    let (header, volume) = read(&bytes, 0).unwrap();
    assert_is(&sample(), &volume, 1e-6);
    assert_eq!(header.warnings[0].code, "ct.transforms_disagree");
    assert!(header.warnings[0].text.contains("87.500 mm apart"), "{}", header.warnings[0].text);
}

#[test]
fn units_of_length_are_turned_into_millimetres() {
    let metres = Grid {
        origin: Point3::from(sample().origin.coords / 1000.0),
        axes_mm: sample().axes_mm.map(|a| a / 1000.0),
        ..sample()
    };
    let mut bytes = nifti(2, &metres, Scalar::I16, Endian::Little, Form::S, 1);
    bytes[500] = 1;
    assert_is(&sample(), &read(&bytes, 0).unwrap().1, 1e-6);
    let data = packed(&values(&sample()), Scalar::I16, Endian::Little);
    let bytes = nrrd(&metres, Scalar::I16, Endian::Little, "raw", "left-posterior-superior", &data);
    let bytes = replaced(&bytes, &[("key:=value", "space units: \"m\" \"m\" \"m\"")]);
    assert_is(&sample(), &read(&bytes, 0).unwrap().1, 1e-6);
}

#[test]
fn nrrd_axes_without_a_space_begin_where_their_cells_do() {
    let bytes = b"NRRD0001\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nspacings: 1 2 3\naxis mins: 10 20 30\ncenters: cell cell node\nencoding: raw\n\n\x01\x02\x03\x04\x05\x06\x07\x08";
    let (header, volume) = read(bytes, 0).unwrap();
    assert_eq!(header.warnings[0].code, "ct.no_orientation");
    assert_eq!((volume.origin_xy_mm, volume.plane_z_mm), ([10.5, 21.0], vec![30.0, 33.0]));
}

#[test]
fn nrrd_skips_lines_first_and_bytes_after_them() {
    let header = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 2 2 2\nspacings: 1 2 3\nencoding: raw\n";
    let first = |skips: &str, data: &[u8]| {
        let bytes = [header.as_bytes(), skips.as_bytes(), b"\n", data].concat();
        read(&bytes, 0).map(|(_, volume)| volume.at(0, 0, 0))
    };
    let after_both = b"ab\ncdef\nxyz\x01\x02\x03\x04\x05\x06\x07\x08";
    assert_eq!(first("line skip: 2\nbyte skip: 3\n", after_both), Ok(1.0));
    // Counted from the end, lines before the values do not matter, and a value may look like a line's end.
    assert_eq!(first("line skip: 1\nbyte skip: -1\n", b"ab\n\x0b\x0a\x0c\x0d\x0e\x0f\x10\x11"), Ok(11.0));
    assert!(matches!(first("line skip: 4\n", after_both), Err(Fault::Truncated { .. })));
}

#[test]
fn nrrd_axes_that_are_not_described_are_refused() {
    let of = |axes: &str| {
        let text = format!("NRRD0004\ntype: uint8\ndimension: 4\nsizes: 2 2 2 2\n{axes}\nencoding: raw\n\n");
        recognise(text.as_bytes()).unwrap_err().to_string()
    };
    let expected = "an entry for each of the four axes, three of space side by side";
    for axes in [
        "space directions: (1,0,0) (0,1,0)",
        "space directions:",
        "kinds: domain",
        "kinds: space space list space",
    ] {
        assert!(of(axes).contains(expected), "{axes}: {}", of(axes));
    }
}

#[test]
fn a_fault_quotes_numbers_and_keywords_and_no_other_text() {
    let of = |text: &str| text::Field { format: "NRRD", name: "type", text }.fault("a type").to_string();
    for quoted in ["4 x 2", "uint16", "(1,0,0) none none", "left-posterior", "0.70710678 -1e-3 12345"] {
        assert!(of(quoted).contains(quoted), "{}", of(quoted));
    }
    for hidden in ["Doe^Jane", "Jane Doe", "Müller", "uint8 Doe", "(Doe, Jane)"] {
        let told = of(hidden);
        assert!(told.contains("states type as some text,") && !told.contains("Doe"), "{told}");
    }
}

// -- damage --

#[test]
fn no_prefix_and_no_single_changed_byte_of_a_file_panics() {
    let data = packed(&values(&sample()), Scalar::I16, Endian::Little);
    let files = [
        nifti(1, &sample(), Scalar::I16, Endian::Little, Form::Both, 1),
        nifti(2, &sample(), Scalar::I16, Endian::Big, Form::Both, 2),
        gzip(&nifti(1, &sample(), Scalar::U8, Endian::Little, Form::Q, 1)),
        metaimage(&sample(), Scalar::I16, Endian::Little, "CompressedData = True\n", &zlib(&data)),
        nrrd(&sample(), Scalar::I16, Endian::Little, "gzip", "left-posterior-superior", &gzip(&data)),
    ];
    let survive = |bytes: &[u8]| {
        let Ok(Some(header)) = recognise(bytes) else { return };
        let _any = values::read(&header, bytes, 0, &Task::quiet(), |v, _| Ok(v)).map(|r| r.values.len());
        let _any = header.grid.place().map(|p| p.plane_z_mm.len());
    };
    for file in files {
        (0..file.len()).for_each(|n| survive(&file[..n]));
        for at in 0..file.len() {
            for change in [0x01, 0x80, 0xff] {
                let mut damaged = file.clone();
                damaged[at] ^= change;
                survive(&damaged);
            }
        }
    }
}

#[test]
fn a_header_that_declares_more_than_there_is_costs_no_memory() {
    let grid = Grid { dims: [8192, 8192, 8192], ..sample() };
    let [little, zeros] = [vec![0; 64], gzip(&vec![0; 100_000])];
    let space = "left-posterior-superior";
    for bytes in [
        metaimage(&grid, Scalar::F64, Endian::Little, "", &little),
        metaimage(&grid, Scalar::F64, Endian::Little, "CompressedData = True\n", &zeros),
        nrrd(&grid, Scalar::F64, Endian::Little, "gzip", space, &zeros),
        nrrd(&grid, Scalar::U8, Endian::Little, "ascii", space, b"1 2 3"),
    ] {
        let fault = read(&bytes, 0).unwrap_err();
        assert!(matches!(fault, Fault::Truncated { .. } | Fault::PackedTooShort { .. }), "{fault}");
    }
}
