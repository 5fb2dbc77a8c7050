//! Nothing that identifies a patient leaves the other kinds of input either: image files, multi-frame CT, segmentations.
//!
//! Every free text that a format has, and every identifying attribute of the DICOM objects, carries a planted word. Each file is
//! used as it is meant to be and damaged, with all logging on; then everything that was said or written is searched. The
//! series of single images has a test of its own, with the rule about paths.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]

use dicom_core::value::{DataSetSequence, PrimitiveValue};
use dicom_core::{DataElement, Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{DefaultDicomObject, FileMetaTableBuilder, InMemDicomObject, open_file};
use lumenfab::ct::Volume;
use lumenfab::ct::reader;
use lumenfab::phantom::{self, Kind, Params};
use lumenfab::progress::Task;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

/// What every planted text begins with.
const WORD: &str = "ZQX";
/// A planted date.
const DATE: &str = "19330717";
/// What every planted UID begins with.
const UID: &str = "1.2.826.0.1.7700";
/// The folder that the inputs lie in; the program is told of it by a path from its own working directory.
const FOLDER: &str = "inputs";

struct Place {
    dir: TempDir,
    seed: String,
    volume: Volume,
}

impl Place {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let params =
            Params { kind: Kind::Tube, n_planes: 4, n_pixels: 128, pixel_mm: 0.4, ..Params::default() };
        let seed = phantom::default_seed(&params);
        fs::create_dir_all(dir.path().join(FOLDER)).unwrap();
        fs::create_dir(dir.path().join("tmp")).unwrap();
        let series = dir.path().join(FOLDER).join("series");
        phantom::series::write(&series, &params, &Task::quiet()).unwrap();
        let volume = reader::load(&series, &Default::default(), &Task::quiet()).unwrap().volume;
        Self { dir, seed: format!("--seed-mm={},{},{}", seed.x, seed.y, seed.z), volume }
    }

    fn input(&self, name: &str) -> PathBuf {
        self.dir.path().join(FOLDER).join(name)
    }

    fn put(&self, name: &str, bytes: &[u8]) -> String {
        fs::write(self.input(name), bytes).unwrap();
        format!("{FOLDER}/{name}")
    }

    fn put_object(&self, name: &str, mut object: InMemDicomObject, class: &str) -> String {
        plant(&mut object);
        let text = |o: &mut InMemDicomObject, tag, value: &str| {
            o.put(DataElement::new(tag, VR::UI, PrimitiveValue::from(value)));
        };
        text(&mut object, tags::SOP_CLASS_UID, class);
        text(&mut object, tags::SOP_INSTANCE_UID, &format!("{UID}3.1"));
        let meta = FileMetaTableBuilder::new().transfer_syntax(uids::EXPLICIT_VR_LITTLE_ENDIAN);
        object.with_meta(meta).unwrap().write_to_file(self.input(name)).unwrap();
        format!("{FOLDER}/{name}")
    }

    fn run(&self, args: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_lumenfab"))
            .args(args)
            .current_dir(self.dir.path())
            .env("XDG_STATE_HOME", self.dir.path().join("state"))
            .env("TMPDIR", self.dir.path().join("tmp"))
            .env("LUMENFAB_LOG", "trace")
            .output()
            .unwrap()
    }

    /// Runs a command with all logging on and searches what it says.
    fn says_nothing(&self, args: &[&str]) -> Option<i32> {
        let output = self.run(args);
        assert_clean(&output.stdout, &format!("stdout of {args:?}"));
        assert_clean(&output.stderr, &format!("stderr of {args:?}"));
        output.status.code()
    }

    /// Uses an input in every way that there is, whole and cut off; all that is done with the whole one must succeed.
    fn is_silent_about(&self, name: &str, uses: &[&[&str]]) {
        for args in uses {
            let code = self.says_nothing(args);
            assert_eq!(code, Some(0), "{name}: {args:?}");
        }
        let bytes = fs::read(self.input(name)).unwrap();
        for part in [2, 3] {
            fs::write(self.input(name), &bytes[..bytes.len() - bytes.len() / part]).unwrap();
            for args in uses {
                let again: Vec<String> = args.iter().map(|a| a.replace("case-", "cut-")).collect();
                self.says_nothing(&again.iter().map(String::as_str).collect::<Vec<_>>());
            }
        }
        self.wrote_nothing();
    }

    /// Searches everything that was written, apart from the inputs and the private file of where they lie.
    fn wrote_nothing(&self) {
        let is_own = |p: &Path| {
            !p.starts_with(self.dir.path().join(FOLDER)) && !p.starts_with(self.dir.path().join("state"))
        };
        for file in files(self.dir.path()).into_iter().filter(|p| is_own(p)) {
            assert_clean(&fs::read(&file).unwrap(), &file.display().to_string());
        }
    }
}

fn files(dir: &Path) -> Vec<PathBuf> {
    let all = fs::read_dir(dir).unwrap().map(|e| e.unwrap().path());
    all.flat_map(|p| if p.is_dir() { files(&p) } else { vec![p] }).collect()
}

fn assert_clean(bytes: &[u8], place: &str) {
    for secret in [WORD, DATE, UID] {
        let found = bytes.windows(secret.len()).position(|w| w == secret.as_bytes());
        let around =
            found.map(|at| String::from_utf8_lossy(&bytes[at..(at + 60).min(bytes.len())]).into_owned());
        assert_eq!(around, None, "{secret} in {place}");
    }
}

/// Puts planted words into every attribute that may name somebody.
fn plant(object: &mut InMemDicomObject) {
    let texts = [
        (tags::PATIENT_NAME, VR::PN),
        (tags::PATIENT_ID, VR::LO),
        (tags::OTHER_PATIENT_NAMES, VR::PN),
        (tags::PATIENT_ADDRESS, VR::LO),
        (tags::PATIENT_COMMENTS, VR::LT),
        (tags::ACCESSION_NUMBER, VR::SH),
        (tags::STUDY_ID, VR::SH),
        (tags::STUDY_DESCRIPTION, VR::LO),
        (tags::SERIES_DESCRIPTION, VR::LO),
        (tags::INSTITUTION_NAME, VR::LO),
        (tags::STATION_NAME, VR::SH),
        (tags::MANUFACTURER, VR::LO),
        (tags::DEVICE_SERIAL_NUMBER, VR::LO),
        (tags::REFERRING_PHYSICIAN_NAME, VR::PN),
        (tags::OPERATORS_NAME, VR::PN),
        (tags::CONTENT_CREATOR_NAME, VR::PN),
        (tags::CONTENT_LABEL, VR::CS),
        (tags::CONTENT_DESCRIPTION, VR::LO),
        (tags::STRUCTURE_SET_LABEL, VR::SH),
        (tags::STRUCTURE_SET_NAME, VR::LO),
        (tags::STRUCTURE_SET_DESCRIPTION, VR::ST),
        (tags::IMAGE_COMMENTS, VR::LT),
        (Tag(0x0009, 0x0010), VR::LO),
        (Tag(0x0009, 0x1001), VR::LO),
    ];
    for (i, (tag, vr)) in texts.into_iter().enumerate() {
        object.put(DataElement::new(tag, vr, PrimitiveValue::from(format!("{WORD}{i} JANE"))));
    }
    for (tag, n) in
        [(tags::STUDY_INSTANCE_UID, 1), (tags::SERIES_INSTANCE_UID, 2), (tags::FRAME_OF_REFERENCE_UID, 4)]
    {
        object.put(DataElement::new(tag, VR::UI, PrimitiveValue::from(format!("{UID}{n}"))));
    }
}

fn values(volume: &Volume) -> Vec<u8> {
    #[expect(clippy::cast_possible_truncation, reason = "a phantom's whole HU")]
    let bytes = volume.hu.iter().flat_map(|v| (v as i16).to_le_bytes()).collect();
    bytes
}

fn nifti(volume: &Volume) -> Vec<u8> {
    let mut bytes = vec![0; 352];
    let mut put = |at: usize, b: &[u8]| bytes[at..at + b.len()].copy_from_slice(b);
    put(0, &348_i32.to_le_bytes());
    put(4, b"ZQX data");
    put(14, b"ZQX database JANE");
    for (i, n) in [3, volume.dims[0], volume.dims[1], volume.dims[2], 1, 1, 1, 1].into_iter().enumerate() {
        put(40 + 2 * i, &i16::try_from(n).unwrap().to_le_bytes());
    }
    put(70, &4_i16.to_le_bytes());
    put(72, &16_i16.to_le_bytes());
    let ([dx, dy], dz) = (volume.pixel_spacing_xy_mm, volume.plane_z_mm[1] - volume.plane_z_mm[0]);
    #[expect(clippy::cast_possible_truncation, reason = "the format's own precision")]
    let single = |v: f64| (v as f32).to_le_bytes();
    for (i, v) in [1.0, dx, dy, dz].into_iter().enumerate() {
        put(76 + 4 * i, &single(v));
    }
    put(108, &352_f32.to_le_bytes());
    put(123, &[2]);
    put(148, b"ZQX^JANE born 1933-07-17, description");
    put(228, b"ZQX^JANE.aux");
    put(254, &1_i16.to_le_bytes());
    let [ox, oy] = volume.origin_xy_mm;
    // The format's axes run right and to the front where those of DICOM run left and to the back.
    let rows = [-dx, 0.0, 0.0, -ox, 0.0, -dy, 0.0, -oy, 0.0, 0.0, dz, volume.plane_z_mm[0]];
    for (i, v) in rows.into_iter().enumerate() {
        put(280 + 4 * i, &single(v));
    }
    put(328, b"ZQX JANE intent");
    put(344, b"n+1\0");
    bytes.extend(values(volume));
    bytes
}

fn nrrd(volume: &Volume, kind: &str, bytes: &[u8]) -> Vec<u8> {
    let ([nx, ny, nz], [dx, dy]) = (volume.dims, volume.pixel_spacing_xy_mm);
    let (dz, [ox, oy], oz) =
        (volume.plane_z_mm[1] - volume.plane_z_mm[0], volume.origin_xy_mm, volume.plane_z_mm[0]);
    let mut header = format!("NRRD0005\n# ZQX^JANE comment\ntype: {kind}\ndimension: 3\ncontent: ZQX^JANE\n");
    writeln!(header, "space: left-posterior-superior\nsizes: {nx} {ny} {nz}\nendian: little\nencoding: raw")
        .unwrap();
    writeln!(header, "space directions: ({dx},0,0) (0,{dy},0) (0,0,{dz})\nspace origin: ({ox},{oy},{oz})")
        .unwrap();
    header += "PatientName:=ZQX^JANE\nSegment1_Name:=ZQX lumen\n\n";
    [header.into_bytes(), bytes.to_vec()].concat()
}

fn metaimage(volume: &Volume) -> Vec<u8> {
    let ([nx, ny, nz], [dx, dy]) = (volume.dims, volume.pixel_spacing_xy_mm);
    let (dz, [ox, oy], oz) =
        (volume.plane_z_mm[1] - volume.plane_z_mm[0], volume.origin_xy_mm, volume.plane_z_mm[0]);
    let header = format!(
        "ObjectType = Image\nComment = ZQX^JANE\nName = ZQX^JANE\nID = 77\nNDims = 3\nBinaryData = True\n\
         BinaryDataByteOrderMSB = False\nCompressedData = False\nTransformMatrix = 1 0 0 0 1 0 0 0 1\n\
         Offset = {ox} {oy} {oz}\nElementSpacing = {dx} {dy} {dz}\nDimSize = {nx} {ny} {nz}\n\
         Modality = MET_MOD_CT\nElementType = MET_SHORT\nElementDataFile = LOCAL\n"
    );
    [header.into_bytes(), values(volume)].concat()
}

/// Whether a pixel lies in the structure that is drawn.
fn is_drawn(p: usize, volume: &Volume) -> bool {
    let [nx, ny, _] = volume.dims;
    ((p % nx) as f64 - 60.3).hypot((p / nx % ny) as f64 - 64.8) < 12.0
}

fn sequence(tag: Tag, items: Vec<InMemDicomObject>) -> DataElement<InMemDicomObject> {
    DataElement::new(tag, VR::SQ, DataSetSequence::from(items))
}

fn item(elements: Vec<DataElement<InMemDicomObject>>) -> InMemDicomObject {
    InMemDicomObject::from_element_iter(elements)
}

fn text(tag: Tag, vr: VR, value: impl Into<String>) -> DataElement<InMemDicomObject> {
    DataElement::new(tag, vr, PrimitiveValue::from(value.into()))
}

fn word(tag: Tag, value: usize) -> DataElement<InMemDicomObject> {
    DataElement::new(tag, VR::US, PrimitiveValue::from(u16::try_from(value).unwrap()))
}

/// The functional groups that all frames share, and the place of one plane.
fn groups(
    volume: &Volume,
) -> (DataElement<InMemDicomObject>, impl Fn(usize) -> DataElement<InMemDicomObject>) {
    let [dx, dy] = volume.pixel_spacing_xy_mm;
    let measures = vec![
        text(tags::PIXEL_SPACING, VR::DS, format!("{dy}\\{dx}")),
        text(tags::SLICE_THICKNESS, VR::DS, volume.slab_thickness_mm.to_string()),
    ];
    let shared = item(vec![
        sequence(tags::PIXEL_MEASURES_SEQUENCE, vec![item(measures)]),
        sequence(
            tags::PLANE_ORIENTATION_SEQUENCE,
            vec![item(vec![text(tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "1\\0\\0\\0\\1\\0")])],
        ),
    ]);
    let ([x, y], z) = (volume.origin_xy_mm, volume.plane_z_mm.clone());
    let place = move |k: usize| {
        let at = text(tags::IMAGE_POSITION_PATIENT, VR::DS, format!("{x}\\{y}\\{}", z[k]));
        sequence(tags::PLANE_POSITION_SEQUENCE, vec![item(vec![at])])
    };
    (sequence(tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, vec![shared]), place)
}

fn segmentation(volume: &Volume) -> InMemDicomObject {
    let ([nx, ny, nz], (shared, place)) = (volume.dims, groups(volume));
    let mut bits = vec![0_u8; (nx * ny * nz).div_ceil(8)];
    (0..nx * ny * nz).filter(|&p| is_drawn(p, volume)).for_each(|p| bits[p / 8] |= 1 << (p % 8));
    let frame = |k: usize| {
        let which = item(vec![word(tags::REFERENCED_SEGMENT_NUMBER, 1)]);
        item(vec![place(k), sequence(tags::SEGMENT_IDENTIFICATION_SEQUENCE, vec![which])])
    };
    let segment = vec![
        word(tags::SEGMENT_NUMBER, 1),
        text(tags::SEGMENT_LABEL, VR::LO, "ZQX lumen of JANE"),
        text(tags::SEGMENT_DESCRIPTION, VR::ST, "ZQX drawn by JOHN"),
    ];
    item(vec![
        text(tags::MODALITY, VR::CS, "SEG"),
        word(tags::ROWS, ny),
        word(tags::COLUMNS, nx),
        text(tags::NUMBER_OF_FRAMES, VR::IS, nz.to_string()),
        word(tags::BITS_ALLOCATED, 1),
        text(tags::SEGMENTATION_TYPE, VR::CS, "BINARY"),
        sequence(tags::SEGMENT_SEQUENCE, vec![item(segment)]),
        shared,
        sequence(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, (0..nz).map(frame).collect()),
        DataElement::new(tags::PIXEL_DATA, VR::OB, PrimitiveValue::from(bits)),
    ])
}

fn structure_set(volume: &Volume) -> InMemDicomObject {
    let middle =
        [0, 1].map(|a| volume.origin_xy_mm[a] + 0.5 * volume.dims[a] as f64 * volume.pixel_spacing_xy_mm[a]);
    let circle = |z: f64| {
        let point = |n: u32| {
            let (sin, cos) = (f64::from(n) * std::f64::consts::TAU / 40.0).sin_cos();
            format!("{:.4}\\{:.4}\\{z:.4}", middle[0] + 4.0 * cos, middle[1] + 4.0 * sin)
        };
        let points: Vec<String> = (0..40).map(point).collect();
        item(vec![
            text(tags::CONTOUR_GEOMETRIC_TYPE, VR::CS, "CLOSED_PLANAR"),
            text(tags::NUMBER_OF_CONTOUR_POINTS, VR::IS, "40"),
            text(tags::CONTOUR_DATA, VR::DS, points.join("\\")),
        ])
    };
    let roi = vec![
        text(tags::ROI_NUMBER, VR::IS, "5"),
        text(tags::ROI_NAME, VR::LO, "ZQX lumen of JANE"),
        text(tags::ROI_DESCRIPTION, VR::ST, "ZQX drawn by JOHN"),
    ];
    let contours = volume.plane_z_mm.iter().map(|&z| circle(z)).collect();
    let own =
        vec![text(tags::REFERENCED_ROI_NUMBER, VR::IS, "5"), sequence(tags::CONTOUR_SEQUENCE, contours)];
    item(vec![
        text(tags::MODALITY, VR::CS, "RTSTRUCT"),
        sequence(tags::STRUCTURE_SET_ROI_SEQUENCE, vec![item(roi)]),
        sequence(tags::ROI_CONTOUR_SEQUENCE, vec![item(own)]),
    ])
}

/// The series as one multi-frame object.
fn enhanced(place: &Place) -> InMemDicomObject {
    let volume = &place.volume;
    let (shared, at) = groups(volume);
    let mut paths = files(&place.input("series"));
    paths.retain(|p| p.extension().is_some_and(|e| e == "dcm"));
    let mut images: Vec<_> = paths.iter().map(|p| open_file(p).unwrap()).collect();
    let height = |o: &DefaultDicomObject| {
        o.element(tags::IMAGE_POSITION_PATIENT).unwrap().to_multi_float64().unwrap()[2]
    };
    images.sort_by(|a, b| height(a).total_cmp(&height(b)));
    let words = |o: &DefaultDicomObject| o.element(tags::PIXEL_DATA).unwrap().to_multi_int::<u16>().unwrap();
    let pixels: Vec<u16> = images.iter().flat_map(words).collect();
    let frame = |k: usize| {
        let rescale = vec![
            text(tags::RESCALE_SLOPE, VR::DS, "1"),
            text(
                tags::RESCALE_INTERCEPT,
                VR::DS,
                images[k].element(tags::RESCALE_INTERCEPT).unwrap().to_str().unwrap().into_owned(),
            ),
        ];
        let content =
            vec![text(tags::STACK_ID, VR::SH, "1"), text(tags::FRAME_COMMENTS, VR::LT, "ZQX frame")];
        item(vec![
            at(k),
            sequence(tags::PIXEL_VALUE_TRANSFORMATION_SEQUENCE, vec![item(rescale)]),
            sequence(tags::FRAME_CONTENT_SEQUENCE, vec![item(content)]),
        ])
    };
    let n = volume.dims[2];
    let mut object: InMemDicomObject = images[0].clone().into_inner();
    for tag in [
        tags::IMAGE_POSITION_PATIENT,
        tags::IMAGE_ORIENTATION_PATIENT,
        tags::PIXEL_SPACING,
        tags::SLICE_THICKNESS,
        tags::RESCALE_SLOPE,
        tags::RESCALE_INTERCEPT,
    ] {
        object.remove_element(tag);
    }
    object.put(text(tags::NUMBER_OF_FRAMES, VR::IS, n.to_string()));
    object.put(shared);
    object.put(sequence(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, (0..n).map(frame).collect()));
    object.put(DataElement::new(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16(pixels.into())));
    object
}

#[test]
fn image_files_tell_nothing() {
    let place = Place::new();
    let volume = &place.volume;
    let inputs = [
        ("a.nii", nifti(volume)),
        ("a.nrrd", nrrd(volume, "short", &values(volume))),
        ("a.mha", metaimage(volume)),
    ];
    for (name, bytes) in inputs {
        let path = place.put(name, &bytes);
        let case = format!("case-{name}");
        let leak = format!("leak-{name}");
        let args =
            ["segment", "--ct", &path, &place.seed, "--window-hu=-2000,6000", "--out", &leak, "--json"];
        assert_eq!(place.says_nothing(&args), Some(1), "{name}");
        assert!(place.dir.path().join(&leak).join("leak.png").is_file(), "{name}");
        place.is_silent_about(
            name,
            &[
                &["inspect", &path],
                &["inspect", &path, "--json"],
                &["segment", "--ct", &path, &place.seed, "--out", &case, "--json"],
            ],
        );
    }
}

#[test]
fn a_multi_frame_ct_tells_nothing() {
    let place = Place::new();
    let path = place.put_object("a.dcm", enhanced(&place), uids::ENHANCED_CT_IMAGE_STORAGE);
    place.is_silent_about(
        "a.dcm",
        &[&["inspect", &path, "--json"], &["segment", "--ct", &path, &place.seed, "--out", "case-e"]],
    );
}

#[test]
fn segmentations_tell_nothing() {
    let place = Place::new();
    let volume = &place.volume;
    let n: usize = volume.dims.iter().product();
    let labels: Vec<u8> = (0..n).map(|p| u8::from(is_drawn(p, volume))).collect();
    let map = place.put("labels.nrrd", &nrrd(volume, "uint8", &labels));
    let seg = place.put_object("seg.dcm", segmentation(volume), uids::SEGMENTATION_STORAGE);
    let rt = place.put_object("rt.dcm", structure_set(volume), uids::RT_STRUCTURE_SET_STORAGE);
    for (name, path) in [("labels.nrrd", map), ("seg.dcm", seg), ("rt.dcm", rt)] {
        let case = format!("case-{name}");
        place.is_silent_about(name, &[&["segment", "--segmentation", &path, "--out", &case, "--json"]]);
    }
}

#[test]
fn segmentations_beside_their_ct_tell_nothing() {
    let place = Place::new();
    let volume = &place.volume;
    // The frame of reference that the objects state.
    for path in
        files(&place.input("series")).into_iter().filter(|p| p.extension().is_some_and(|e| e == "dcm"))
    {
        let mut object = open_file(&path).unwrap();
        object.put(text(tags::FRAME_OF_REFERENCE_UID, VR::UI, format!("{UID}4")));
        object.write_to_file(&path).unwrap();
    }
    let labels: Vec<u8> =
        (0..volume.dims.iter().product::<usize>()).map(|p| u8::from(is_drawn(p, volume))).collect();
    let map = place.put("labels.nrrd", &nrrd(volume, "uint8", &labels));
    let seg = place.put_object("seg.dcm", segmentation(volume), uids::SEGMENTATION_STORAGE);
    let rt = place.put_object("rt.dcm", structure_set(volume), uids::RT_STRUCTURE_SET_STORAGE);
    let ct = format!("{FOLDER}/series");
    for (name, path) in [("labels.nrrd", &map), ("seg.dcm", &seg), ("rt.dcm", &rt)] {
        let case = format!("case-{name}");
        let args = ["segment", "--ct", &ct, "--segmentation", path, "--out", &case, "--json"];
        let said = place.run(&args);
        let told = String::from_utf8_lossy(&said.stdout).into_owned();
        assert!(said.status.success() && !told.contains("segment.frame_unknown"), "{name}: {told}");
        assert!(place.dir.path().join(&case).join("volume.bin").exists(), "{name}");
        place.is_silent_about(name, &[&args]);
    }
    // Another patient's CT, as far as the frames of reference tell, is refused without naming either.
    let place = Place::new();
    let seg = place.put_object("seg.dcm", segmentation(&place.volume), uids::SEGMENTATION_STORAGE);
    assert_eq!(
        place.says_nothing(&["segment", "--ct", &ct, "--segmentation", &seg, "--out", "no", "--json"]),
        Some(1)
    );
}

#[test]
fn fields_that_hold_a_name_or_a_date_are_not_quoted() {
    let place = Place::new();
    let volume = &place.volume;
    let [nx, ny, nz] = volume.dims;
    let whole = |bytes: &[u8], from: &str, to: &str| {
        let text = String::from_utf8_lossy(&bytes[..bytes.len() - 2 * nx * ny * nz]);
        assert!(text.contains(from), "{from}");
        [text.replace(from, to).into_bytes(), values(volume)].concat()
    };
    let (nrrd, meta) = (nrrd(volume, "short", &values(volume)), metaimage(volume));
    let sizes = format!("{nx} {ny} {nz}");
    for (n, (bytes, from, to)) in [
        (&nrrd, "left-posterior-superior", "ZQX_JANE"),
        (&nrrd, "encoding: raw", "encoding: ZQX"),
        (&nrrd, "type: short", "type: ZQX-JANE"),
        (&nrrd, sizes.as_str(), "19330717 512 40"),
        (&meta, "MET_SHORT", "ZQX"),
        (&meta, sizes.as_str(), "19330717 512 40"),
    ]
    .into_iter()
    .enumerate()
    {
        let path = place.put(&format!("{n}"), &whole(bytes, from, to));
        for args in
            [&["inspect", &path, "--json"][..], &["segment", "--ct", &path, "--seed-mm=auto", "--out", "no"]]
        {
            assert_ne!(place.says_nothing(args), Some(0), "{to}");
        }
    }
    let mut bytes = nifti(volume);
    bytes[42..44].copy_from_slice(&30717_i16.to_le_bytes());
    place.says_nothing(&["inspect", &place.put("dated.nii", &bytes), "--json"]);
    place.wrote_nothing();
}

#[test]
fn a_series_is_not_told_by_what_may_be_a_record() {
    let place = Place::new();
    let series = place.input("series");
    for path in files(&series).into_iter().filter(|p| p.extension().is_some_and(|e| e == "dcm")) {
        let mut object = open_file(&path).unwrap();
        object.put(text(tags::ACQUISITION_NUMBER, VR::IS, "1"));
        object.write_to_file(&path).unwrap();
        for (tag, vr, value) in [
            (tags::ACQUISITION_NUMBER, VR::IS, "1933071"),
            (tags::CONVOLUTION_KERNEL, VR::SH, "ZQ717"),
            (tags::SOP_INSTANCE_UID, VR::UI, "2.25.7"),
        ] {
            object.put(text(tag, vr, value));
        }
        object.write_to_file(path.with_extension("again.dcm")).unwrap();
    }
    let said = place.run(&["inspect", &format!("{FOLDER}/series"), "--json"]);
    let told = String::from_utf8_lossy(&said.stdout);
    assert!(told.contains("\"number\":2") && !told.contains("1933071") && !told.contains("ZQ717"), "{told}");
}

/// Attributes that are read, or told of a series, and that must not be quoted whatever stands in them; and whether a case is made
/// although a word stands there, so that what is written is searched too.
const READ: [(Tag, VR, bool); 38] = [
    (tags::SPECIFIC_CHARACTER_SET, VR::CS, true),
    (tags::IMAGE_TYPE, VR::CS, true),
    (tags::SOP_CLASS_UID, VR::UI, true),
    (tags::MODALITY, VR::CS, true),
    (tags::BODY_PART_EXAMINED, VR::CS, true),
    (tags::SLICE_THICKNESS, VR::DS, false),
    (tags::KVP, VR::DS, true),
    (tags::SPACING_BETWEEN_SLICES, VR::DS, false),
    (tags::GANTRY_DETECTOR_TILT, VR::DS, true),
    (tags::CONVOLUTION_KERNEL, VR::SH, true),
    (tags::PATIENT_POSITION, VR::CS, true),
    (tags::ECHO_TIME, VR::DS, true),
    (tags::TRIGGER_TIME, VR::DS, true),
    (tags::NOMINAL_PERCENTAGE_OF_CARDIAC_PHASE, VR::DS, true),
    (tags::SERIES_NUMBER, VR::IS, true),
    (tags::ACQUISITION_NUMBER, VR::IS, true),
    (tags::INSTANCE_NUMBER, VR::IS, true),
    (tags::IMAGE_POSITION_PATIENT, VR::DS, false),
    (tags::IMAGE_ORIENTATION_PATIENT, VR::DS, false),
    (tags::TEMPORAL_POSITION_IDENTIFIER, VR::IS, true),
    (tags::SLICE_LOCATION, VR::DS, true),
    (tags::SAMPLES_PER_PIXEL, VR::LO, false),
    (tags::PHOTOMETRIC_INTERPRETATION, VR::CS, true),
    (tags::NUMBER_OF_FRAMES, VR::IS, false),
    (tags::ROWS, VR::LO, false),
    (tags::COLUMNS, VR::LO, false),
    (tags::PIXEL_SPACING, VR::DS, false),
    (tags::BITS_ALLOCATED, VR::LO, false),
    (tags::BITS_STORED, VR::LO, false),
    (tags::HIGH_BIT, VR::LO, false),
    (tags::PIXEL_REPRESENTATION, VR::LO, false),
    (tags::PIXEL_PADDING_VALUE, VR::LO, false),
    (tags::RESCALE_INTERCEPT, VR::DS, false),
    (tags::RESCALE_SLOPE, VR::DS, false),
    (tags::RESCALE_TYPE, VR::LO, true),
    (tags::LOSSY_IMAGE_COMPRESSION, VR::CS, true),
    (tags::ACQUISITION_TIME, VR::TM, true),
    (tags::STACK_ID, VR::SH, true),
];

/// The series of a place, to be changed again and again.
struct Series<'a> {
    place: &'a Place,
    sound: Vec<(PathBuf, DefaultDicomObject)>,
    path: String,
}

impl<'a> Series<'a> {
    fn of(place: &'a Place) -> Self {
        let mut sound: Vec<PathBuf> = files(&place.input("series"));
        sound.retain(|p| p.extension().is_some_and(|e| e == "dcm"));
        let sound = sound.into_iter().map(|p| (p.clone(), open_file(p).unwrap())).collect();
        Self { place, sound, path: format!("{FOLDER}/series") }
    }

    /// The sound images with an attribute changed.
    fn put(&self, tag: Tag, vr: VR, value: &str) {
        for (path, object) in &self.sound {
            let mut object = object.clone();
            object.put(text(tag, vr, value));
            object.write_to_file(path).unwrap();
        }
    }

    /// Whether a case is made of it; nothing is told either way.
    fn makes_case(&self, what: &str) -> bool {
        let told = self.place.says_nothing(&["inspect", &self.path, "--json"]);
        assert!(told.is_some_and(|code| code < 2), "{what}: {told:?}");
        let args = ["segment", "--ct", &self.path, &self.place.seed, "--out", "case", "--json"];
        let made = self.place.says_nothing(&args);
        assert!(made.is_some_and(|code| code < 3), "{what}: {made:?}");
        self.place.wrote_nothing();
        fs::remove_dir_all(self.place.dir.path().join("case")).ok();
        made == Some(0)
    }
}

#[test]
fn attributes_that_hold_a_name_are_not_quoted() {
    let place = Place::new();
    let series = Series::of(&place);
    let mut odd = Vec::new();
    for (tag, vr, is_used) in READ {
        let value = if vr == VR::UI { format!("{UID}9") } else { format!("{WORD}^JANE") };
        series.put(tag, vr, &value);
        if series.makes_case(&tag.to_string()) != is_used {
            odd.push((tag, is_used));
        }
    }
    assert!(odd.is_empty(), "used or refused otherwise than it is said: {odd:?}");
    for (path, object) in &series.sound {
        object.write_to_file(path).unwrap();
        // The transfer syntax: the words of an unknown one have as many letters.
        let mut bytes = fs::read(path).unwrap();
        let known = uids::EXPLICIT_VR_LITTLE_ENDIAN.as_bytes();
        let at = bytes.windows(known.len()).position(|w| w == known).unwrap();
        bytes[at..at + known.len()].copy_from_slice(b"ZQX^JANE^19330717.1");
        fs::write(path, bytes).unwrap();
    }
    assert!(!series.makes_case("transfer syntax"));
}

#[test]
fn attributes_that_hold_a_date_are_not_quoted() {
    let place = Place::new();
    let series = Series::of(&place);
    for (tag, vr, _) in READ {
        let vr = if vr == VR::LO { VR::IS } else { vr };
        series.put(tag, vr, DATE);
        series.makes_case(&tag.to_string());
    }
    // As one of several numbers.
    for (tag, others) in [
        (tags::PIXEL_SPACING, "\\1"),
        (tags::IMAGE_POSITION_PATIENT, "\\0\\0"),
        (tags::IMAGE_ORIENTATION_PATIENT, "\\0\\0\\0\\1\\0"),
    ] {
        series.put(tag, VR::DS, &format!("{DATE}{others}"));
        assert!(!series.makes_case(&tag.to_string()));
    }
    // What warns of it and goes on.
    for tag in [tags::SLICE_THICKNESS, tags::SPACING_BETWEEN_SLICES] {
        series.put(tag, VR::DS, DATE);
        assert!(series.makes_case(&tag.to_string()));
    }
}

#[test]
fn a_directory_of_files_tells_nothing() {
    let place = Place::new();
    let mut named: Vec<PathBuf> = files(&place.input("series"));
    named.retain(|p| p.extension().is_some_and(|e| e == "dcm"));
    let record = |path: &PathBuf| {
        let name = path.file_name().unwrap().to_str().unwrap();
        let mut record = item(vec![
            text(tags::DIRECTORY_RECORD_TYPE, VR::CS, "IMAGE"),
            text(tags::REFERENCED_FILE_ID, VR::CS, format!("series\\{name}")),
        ]);
        plant(&mut record);
        record
    };
    let mut patient = item(vec![text(tags::DIRECTORY_RECORD_TYPE, VR::CS, "PATIENT")]);
    plant(&mut patient);
    let records = std::iter::once(patient).chain(named.iter().map(record)).collect();
    let directory = item(vec![
        text(tags::FILE_SET_ID, VR::CS, format!("{WORD}_JANE")),
        sequence(tags::DIRECTORY_RECORD_SEQUENCE, records),
    ]);
    let path = place.put_object("DICOMDIR", directory, uids::MEDIA_STORAGE_DIRECTORY_STORAGE);
    place.is_silent_about(
        "DICOMDIR",
        &[
            &["inspect", &path, "--json"],
            &["segment", "--ct", &path, &place.seed, "--out", "case-d", "--json"],
        ],
    );
}
