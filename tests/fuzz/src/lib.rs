//! What the fuzz targets share: bytes as files, and everything that reads them.

use lumenfab::app::settings::{CaseFile, Settings};
use lumenfab::app::volume_file;
use lumenfab::ct::codec::{Codec, Size};
use lumenfab::ct::reader::{self, Options};
use lumenfab::ct::{FrameOfReference, SeriesChoice, Volume, Voxels};
use lumenfab::geom::{Point3, RigidTransform};
use lumenfab::progress::Task;
use lumenfab::segment::{self, Corrections, OnLeak, Polarity};
use lumenfab::{ready, sections};
use std::path::{Path, PathBuf};
use std::sync::{Once, OnceLock};
use tempfile::TempDir;

/// A directory of this process in memory, where the system has one.
fn place() -> &'static Path {
    static PLACE: OnceLock<TempDir> = OnceLock::new();
    let made = || {
        tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).expect("a directory can be made")
    };
    PLACE.get_or_init(made).path()
}

fn written(folder: &str, name: &str, bytes: &[u8]) -> PathBuf {
    let folder = place().join(folder);
    std::fs::create_dir_all(&folder).expect("a folder can be made");
    std::fs::write(folder.join(name), bytes).expect("a file can be written");
    folder
}

/// The JPEG 2000 library panics on some damaged streams, which its caller takes for damage: the fuzzer's hook, which ends the
/// process, must not hear of that.
fn pass_over_caught_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let hook = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            if !reader::is_decoding() {
                hook(info);
            }
        }));
    });
}

/// Reads the bytes as a CT in a folder and as a file of its own.
pub fn as_ct(name: &str, bytes: &[u8]) {
    pass_over_caught_panics();
    let folder = written("ct", name, bytes);
    for path in [folder.join(name), folder] {
        let options = Options { choice: SeriesChoice::ByNumber(1), allow_gaps: true, ..Options::default() };
        let _ = reader::load_with(&path, &options, &Task::quiet());
        let _ = reader::inspect(&path, &Task::quiet()).map(|i| i.to_string());
    }
}

/// Takes the bytes for what a printer says in the middle of a job; each zero byte lets a second pass. The first one chooses the firmware.
pub fn as_replies(bytes: &[u8]) {
    use lumenfab::printer::protocol::{Command, Core, Instant, LineSplitter, State};
    use std::time::Duration;
    static PROFILES: std::sync::OnceLock<Vec<lumenfab::profile::Profile>> = std::sync::OnceLock::new();
    let builtin = |name| lumenfab::profile::builtin(name).expect("built in");
    let profiles =
        PROFILES.get_or_init(|| lumenfab::profile::builtin_names().into_iter().map(builtin).collect());
    let Some((first, bytes)) = bytes.split_first() else { return };
    let profile = &profiles[usize::from(*first) % profiles.len()];
    let mut core = Core::new(profile);
    let (mut splitter, mut now) = (LineSplitter::default(), Instant::default());
    let _ = core.handle_command(now, Command::Connect);
    for said in bytes.split_inclusive(|byte| *byte == 0) {
        splitter.feed(said, |line| core.handle_line(now, line));
        if *core.state() == State::Idle {
            let _ = core.handle_command(now, Command::Begin);
        }
        while core.wants_line() {
            let _ = core.handle_command(now, Command::Line("G1 X1 Y2 E3"));
        }
        while core.poll_transmit().is_some() {}
        while core.poll_event().is_some() {}
        now = now + Duration::from_secs(1);
        core.handle_timeout(now);
    }
}

/// Reads the bytes as the two planes of a series: the second copy lies a little further, so that pixels are decoded.
pub fn as_two_planes(bytes: &[u8]) {
    pass_over_caught_panics();
    let folder = written("planes", "IM0001.dcm", bytes);
    written("planes", "IM0002.dcm", &moved(bytes));
    let options = Options { choice: SeriesChoice::ByNumber(1), allow_gaps: true, ..Options::default() };
    let _ = reader::load_with(&folder, &options, &Task::quiet());
}

/// ImagePositionPatient, as it stands before its value's length: explicit, implicit, big-endian; the bytes of that length, and
/// whether they are big-endian.
const POSITIONS: [(&[u8], usize, bool); 3] =
    [(b"\x20\x00\x32\x00DS", 2, false), (b"\x00\x20\x00\x32DS", 2, true), (b"\x20\x00\x32\x00", 4, false)];

/// Most bytes of a deflated data set that is looked into.
const MOST_INFLATED: u64 = 1 << 20;

/// The file with its image at another place, deflated or not.
fn moved(bytes: &[u8]) -> Vec<u8> {
    use std::io::{Read, Write};
    let (meta, data_set) = bytes.split_at(end_of_meta(bytes));
    let is_deflated = meta.windows(DEFLATED.len()).any(|w| w == DEFLATED);
    if !is_deflated {
        let mut other = bytes.to_vec();
        move_image(&mut other);
        return other;
    }
    let mut inflated = Vec::new();
    // What cannot be inflated is damaged, which is what it is to be.
    let _ = flate2::bufread::DeflateDecoder::new(data_set).take(MOST_INFLATED).read_to_end(&mut inflated);
    move_image(&mut inflated);
    let mut file = flate2::write::DeflateEncoder::new(meta.to_vec(), flate2::Compression::fast());
    file.write_all(&inflated).and_then(|()| file.finish()).unwrap_or_else(|_| bytes.to_vec())
}

const DEFLATED: &[u8] = b"1.2.840.10008.1.2.1.99";

/// Where the file meta group ends by its own length, which its first element states.
fn end_of_meta(bytes: &[u8]) -> usize {
    let length = bytes.get(140..144).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    (144 + length as usize).min(bytes.len())
}

/// Changes the last digit of ImagePositionPatient, where it stands in bytes that are not deflated.
fn move_image(bytes: &mut [u8]) {
    let place = |(tag, n, is_big): &(&[u8], usize, bool)| {
        let at = bytes.windows(tag.len()).position(|w| w == *tag)? + tag.len();
        let start = at + n;
        let length = bytes.get(at..start)?.iter().copied();
        let add = |sum: usize, byte: u8| sum << 8 | usize::from(byte);
        let length = if *is_big { length.fold(0, add) } else { length.rev().fold(0, add) };
        Some(start..start.checked_add(length)?)
    };
    let Some(value) = POSITIONS.iter().find_map(place).and_then(|range| bytes.get_mut(range)) else { return };
    if let Some(digit) = value.iter_mut().rev().find(|b| b.is_ascii_digit()) {
        *digit = b'0' + (*digit - b'0' + 3) % 10;
    }
}

/// Decodes what follows two words for the image's columns and rows.
pub fn as_pixels(codec: Codec, bytes: &[u8]) {
    pass_over_caught_panics();
    let [a, b, c, d, stream @ ..] = bytes else { return };
    let side = |low: &u8, high: &u8| usize::from(u16::from_le_bytes([*low, *high])).clamp(1, 1024);
    let size = Size { columns: side(a, b), rows: side(c, d) };
    if let Ok(samples) = codec.decode(stream, size) {
        assert_eq!(samples.words.len(), size.n_pixels());
    }
}

/// Run lengths, of one byte a pixel or two.
pub fn as_run_lengths(bytes: &[u8]) {
    for bytes_per_pixel in [1, 2] {
        as_pixels(Codec::Rle { bytes_per_pixel }, bytes);
    }
}

/// Reads the bytes as an image file, and as a label map to contours.
pub fn as_image(bytes: &[u8]) {
    let path = written("image", "input", bytes).join("input");
    let options = Options { choice: SeriesChoice::ByNumber(1), allow_gaps: true, ..Options::default() };
    let _ = reader::load_with(&path, &options, &Task::quiet());
    as_ready(bytes);
}

/// Reads the bytes as a ready segmentation, up to its contours, and brings them onto a CT.
pub fn as_ready(bytes: &[u8]) {
    let path = written("ready", "input", bytes).join("input");
    for label in [None, Some(ready::Label::Number(1))] {
        let Ok(ready) = ready::load(&path, label.as_ref(), &Task::quiet()) else { continue };
        let (ct, mut warnings) = (tube(), Vec::new());
        let _ = ready::place::check_reference(
            &ct,
            &FrameOfReference::new("2.25.3"),
            &ready.reference,
            &mut warnings,
        );
        let placed = ready::place::onto(&ct, ready.drawn.clone(), &mut warnings);
        for drawn in [Some(ready.drawn), placed.ok()].into_iter().flatten() {
            let _ = sections::ready::from_drawn(drawn, &sections::Params::default(), &Task::quiet());
        }
    }
}

/// Pixels of 0.5 mm, planes 1 mm apart.
fn volume(dims: [usize; 3], hu: &[f32]) -> Volume {
    Volume {
        dims,
        hu: Voxels::new(hu, dims[0] * dims[1]),
        origin_xy_mm: [0.0, 0.0],
        pixel_spacing_xy_mm: [0.5, 0.5],
        plane_z_mm: (0..dims[2]).map(|k| k as f64).collect(),
        slab_thickness_mm: 1.0,
        patient_from_stack: RigidTransform::identity(),
    }
}

/// A bright upright tube of 5 mm, 24 x 24 x 8 voxels.
fn tube() -> Volume {
    let inside = |p: usize| ((p % 24) as f64 - 11.5).hypot((p / 24) as f64 - 11.5) < 5.0;
    let plane: Vec<f32> = (0..24 * 24).map(|p| if inside(p) { 300.0 } else { 0.0 }).collect();
    volume([24, 24, 8], &plane.repeat(8))
}

/// What a byte of a [hostile volume](as_volume) stands for, HU: steps of 8 from -1024 on, and what no scanner makes.
fn hu_of(byte: u8) -> f32 {
    match byte {
        255 => f32::NAN,
        254 => f32::INFINITY,
        253 => f32::NEG_INFINITY,
        252 => f32::MAX,
        _ => 8.0 * (f32::from(byte) - 128.0),
    }
}

/// Looks for a vessel in a small image of the bytes, behind eight that say how: by itself and from a seed, up to the contours.
pub fn as_volume(bytes: &[u8]) {
    let [nx, ny, nz, i, j, k, how, width, hu @ ..] = bytes else { return };
    let side = |n: &u8, most: usize| 1 + usize::from(*n) % most;
    let dims = [side(nx, 32), side(ny, 32), side(nz, 12)];
    let mut values: Vec<f32> = hu.iter().map(|b| hu_of(*b)).collect();
    values.resize(dims.iter().product(), -1000.0);
    let image = volume(dims, &values);
    let polarity = [Polarity::Auto, Polarity::Bright, Polarity::Dark, Polarity::Auto][usize::from(how & 3)];
    let seed = Point3::new(0.5 * f64::from(i % 33), 0.5 * f64::from(j % 33), f64::from(k % 13));
    let params = segment::Params {
        seeds_patient_mm: vec![seed],
        polarity,
        window_hu: (how & 4 > 0).then(|| [200.0 - 8.0 * f64::from(*width), 200.0 + 8.0 * f64::from(*width)]),
        on_leak: if how & 8 > 0 { OnLeak::Cut } else { OnLeak::Refuse },
        ..Default::default()
    };
    // The model costs a hundred times what the others do: it has its turn.
    let boundary = match how >> 4 & 7 {
        0 => sections::Boundary::Auto,
        1 => sections::Boundary::Snake,
        2 | 3 => sections::Boundary::HalfMaximum,
        _ => sections::Boundary::WindowEdge,
    };
    let drawing = sections::Params { boundary, ..Default::default() };
    let by_itself = segment::find_unattended(&image, &params, &Task::quiet()).ok().map(|f| f.segmentation);
    let from_seed = segment::segment(&image, &params, &Task::quiet()).ok();
    for found in [by_itself, from_seed].into_iter().flatten() {
        let _ = sections::extract(&image, &found, &drawing, &Task::quiet());
    }
}

/// Reads the bytes as what an operator has corrected, in the words of a case file, and follows it.
pub fn as_corrections(bytes: &[u8]) {
    let Some(corrections) =
        std::str::from_utf8(bytes).ok().and_then(|t| toml::from_str::<Corrections>(t).ok())
    else {
        return;
    };
    let _ = corrections.check();
    let image = tube();
    let params = segment::Params {
        seeds_patient_mm: vec![Point3::new(5.5, 5.5, 3.0)],
        corrections,
        on_leak: OnLeak::Cut,
        ..Default::default()
    };
    if let Ok(found) = segment::segment(&image, &params, &Task::quiet()) {
        let _ = sections::extract(&image, &found, &sections::Params::default(), &Task::quiet());
    }
}

/// Reads the bytes as the CT that a case keeps; what is read is written as it was, and can be used.
pub fn as_volume_file(bytes: &[u8]) {
    let Ok(image) = volume_file::from_bytes(bytes) else { return };
    let again = volume_file::from_bytes(&volume_file::to_bytes(&image)).expect("what is written can be read");
    assert_eq!(again.dims, image.dims);
    let [nx, ny, nz] = image.dims.map(|n| n as f64 - 1.0);
    let _ = image.voxel_from_stack(image.stack_from_voxel(0.5 * nx, 0.5 * ny, (0.5 * nz) as usize));
    let bounds = lumenfab::geom::Bounds2 { min: [0.0, 0.0].into(), max: [2.0, 2.0].into() };
    let _ = volume_file::crop(&image, bounds, 0..image.dims[2]);
    let _ = segment::find_unattended(&image, &segment::Params::default(), &Task::quiet());
}

/// Reads the bytes as `sections.json`, repairs the contours, and writes them again.
pub fn as_sections(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    if let Ok(stack) = lumenfab::sections::format::from_json(text) {
        let _ = lumenfab::sections::format::to_json(&stack);
        let (repaired, _) = lumenfab::topology::repaired(stack);
        let _ = lumenfab::sections::format::to_json(&repaired);
    }
}

/// Reads the bytes as a case file; what is written of it must read back as the same.
pub fn as_case_file(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let Some(mut file) = CaseFile::from_toml(text).ok() else { return };
    // The name of a structure may be a patient's: it is not kept.
    if matches!(file.label, Some(lumenfab::ready::Label::Name(_))) {
        file.label = None;
    }
    let Ok(settings) = Settings::try_from(file) else { return };
    let copy = CaseFile::of_case("id", &settings).to_toml();
    let back = CaseFile::from_toml(&copy).expect("what is written can be read");
    assert_eq!(Settings::try_from(back).expect("and used"), settings);
}

/// All targets by name.
pub const TARGETS: [(&str, fn(&[u8])); 18] = [
    ("dicom", |bytes| as_ct("IM0001.dcm", bytes)),
    ("planes", as_two_planes),
    ("replies", as_replies),
    ("rle", as_run_lengths),
    ("jpeg", |bytes| as_pixels(Codec::Jpeg, bytes)),
    ("jpegls", |bytes| as_pixels(Codec::JpegLs, bytes)),
    ("jpeg2000", |bytes| as_pixels(Codec::Jpeg2000, bytes)),
    ("dicomdir", |bytes| as_ct("DICOMDIR", bytes)),
    ("nifti", as_image),
    ("metaimage", as_image),
    ("nrrd", as_image),
    ("seg", as_ready),
    ("rtstruct", as_ready),
    ("volume", as_volume),
    ("corrections", as_corrections),
    ("volume_file", as_volume_file),
    ("sections", as_sections),
    ("case_file", as_case_file),
];
