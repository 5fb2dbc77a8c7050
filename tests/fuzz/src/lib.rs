//! What the fuzz targets share: bytes as files, and everything that reads them.

use lumenfab::app::settings::{CaseFile, Settings};
use lumenfab::ct::SeriesChoice;
use lumenfab::ct::codec::{Codec, Size};
use lumenfab::ct::reader::{self, Options};
use lumenfab::progress::Task;
use lumenfab::ready;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
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

/// Reads the bytes as a CT in a folder and as a file of its own.
pub fn as_ct(name: &str, bytes: &[u8]) {
    let folder = written("ct", name, bytes);
    for path in [folder.join(name), folder] {
        let options =
        Options { choice: SeriesChoice::ByNumber(1), allow_gaps: true, ..Options::default() };
        let _ = reader::load_with(&path, &options, &Task::quiet());
        let _ = reader::inspect(&path, &Task::quiet()).map(|i| i.to_string());
    }
}

/// Takes the bytes for what a printer says in the middle of a job; each zero byte lets a second pass. The first one chooses the firmware.
pub fn as_replies(bytes: &[u8]) {
    use lumenfab::printer::protocol::{Command, Core, Instant, LineSplitter, State};
    use std::time::Duration;
    let names = lumenfab::profile::builtin_names();
    let Some((first, bytes)) = bytes.split_first() else { return };
    let profile = lumenfab::profile::builtin(names[usize::from(*first) % names.len()]).expect("built in");
    let mut core = Core::new(&profile);
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
    let folder = written("planes", "IM0001.dcm", bytes);
    let mut other = bytes.to_vec();
    move_image(&mut other);
    written("planes", "IM0002.dcm", &other);
    let options =
        Options { choice: SeriesChoice::ByNumber(1), allow_gaps: true, ..Options::default() };
    let _ = reader::load_with(&folder, &options, &Task::quiet());
}

/// Changes the last digit of ImagePositionPatient, where it stands in an explicit little-endian file.
fn move_image(bytes: &mut [u8]) {
    const POSITION: &[u8] = b"\x20\x00\x32\x00DS";
    let Some(at) = bytes.windows(POSITION.len()).position(|w| w == POSITION).map(|at| at + POSITION.len()) else {
        return;
    };
    let Some(length) = bytes.get(at..at + 2).map(|l| usize::from(u16::from_le_bytes([l[0], l[1]]))) else { return };
    let Some(value) = bytes.get_mut(at + 2..at + 2 + length) else { return };
    if let Some(digit) = value.iter_mut().rev().find(|b| b.is_ascii_digit()) {
        *digit = b'0' + (*digit - b'0' + 3) % 10;
    }
}

/// Decodes what follows two words for the image's columns and rows.
pub fn as_pixels(codec: Codec, bytes: &[u8]) {
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
    let options =
        Options { choice: SeriesChoice::ByNumber(1), allow_gaps: true, ..Options::default() };
    let _ = reader::load_with(&path, &options, &Task::quiet());
    as_ready(bytes);
}

/// Reads the bytes as a ready segmentation, up to its contours.
pub fn as_ready(bytes: &[u8]) {
    let path = written("ready", "input", bytes).join("input");
    for label in [None, Some(ready::Label::Number(1))] {
        let Ok(ready) = ready::load(&path, label.as_ref(), &Task::quiet()) else { continue };
        let params = lumenfab::sections::Params::default();
        let _ = lumenfab::sections::ready::from_drawn(ready.drawn, &params, &Task::quiet());
    }
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
pub const TARGETS: [(&str, fn(&[u8])); 14] = [
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
    ("sections", as_sections),
    ("case_file", as_case_file),
];
