//! Image files that are no DICOM (NIfTI, MetaImage, NRRD), read from the disk: the IO around [`formats`].
//!
//! A file is taken for one of them by what it holds, whatever it is called. Several volumes in one file (time steps, channels) count
//! as several series. What these formats do not state is told: modality, thickness of the slabs.
//!
//! Memory: the file, and the values of one volume.

use super::super::formats::grid::Placed;
use super::super::formats::values::{self, GZIP_MAGIC, Packing};
use super::super::formats::{self, DataFile, Fault, Header, Skip};
use super::super::inspection::next_command;
use super::super::slabs;
use super::super::{
    Error, FrameOfReference, Inspection, LabelMap, Loaded, Orientation, PixelReport, SeriesChoice,
    SeriesMark, SeriesName, SeriesReport, Verdict, Warning,
};
use super::files::unreadable;
use crate::geom::Vector3;
use crate::progress::Task;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Component, Path, PathBuf};

/// Bytes that are looked at to know what a file is: the longest header.
const START_BYTES: u64 = 1 << 20;
/// Labels that are still few.
const MOST_LABEL: f32 = 255.0;
/// The most pairs of neighbours in a row that differ in a label map, of all and of those that both have a label.
const LABEL_STEPS: f64 = 0.1;
/// What voxels without a value become: air.
const NO_VALUE_HU: f32 = -1024.0;

/// An image file and the bytes that hold its values.
pub(super) struct ImageFile {
    path: PathBuf,
    header: Header,
    bytes: Vec<u8>,
    n_files: usize,
}

/// A file that is one of the formats, its header read and nothing more.
struct Recognised {
    /// The header's file; another one where that of the values was named.
    path: PathBuf,
    header: Header,
    /// The file's first bytes, and the file behind them.
    start: Vec<u8>,
    rest: File,
}

/// Reads a file where it is one of the formats; `None` where it is something else.
pub(super) fn open(path: &Path) -> Result<Option<ImageFile>, Error> {
    recognised(path)?.map(Recognised::with_values).transpose()
}

/// The volume that a name means, found by the header alone; `None` where the file is something else.
pub(super) fn find(path: &Path, name: &SeriesName) -> Result<Option<SeriesMark>, Error> {
    let Some(Recognised { path, header, .. }) = recognised(path)? else { return Ok(None) };
    let n_files = 1 + usize::from(header.place.file.is_some());
    ImageFile { path, header, bytes: Vec::new(), n_files }.find(name).map(Some)
}

/// The files of an image, its header first and then that of its values where they stand in another one, whichever of the two was
/// named; `None` where the file is something else.
///
/// # Errors
/// [`Error`] where the file cannot be read, or is an image that cannot be used.
pub fn image_files(path: &Path) -> Result<Option<Vec<PathBuf>>, Error> {
    let Some(Recognised { path, header, .. }) = recognised(path)? else { return Ok(None) };
    let values = header.place.file.as_ref().map(|file| beside(&path, header.format, file)).transpose()?;
    Ok(Some(std::iter::once(path).chain(values).collect()))
}

/// The labels of a segmentation that is a label map in one of these formats; `None` where the file is something else.
///
/// # Errors
/// [`Error`] where it cannot be read or holds something else than labels.
pub fn load_labels(path: &Path, task: &Task<'_>) -> Result<Option<LabelMap>, Error> {
    let Some(image) = open(path)? else { return Ok(None) };
    image.labels(task).map(Some)
}

/// The largest value where they are those of a label map: few whole numbers from 0, in patches. Within an image of anything
/// neighbours differ, by noise if nothing else, however much black lies around it; `width` is the length of a row.
fn largest_label(values: &[f32], width: usize) -> Option<f32> {
    let most = values.iter().copied().fold(0.0, f32::max);
    let is_label = |v: &f32| *v >= 0.0 && *v <= MOST_LABEL && v.fract() == 0.0;
    let has_patches = |of: fn(&[f32]) -> bool| {
        let pairs = || values.chunks_exact(width.max(1)).flat_map(|row| row.windows(2)).filter(|w| of(w));
        let n_steps = pairs().filter(|w| w[0].total_cmp(&w[1]).is_ne()).count();
        n_steps as f64 <= LABEL_STEPS * pairs().count() as f64
    };
    let are_patches = || has_patches(|_| true) && has_patches(|w| w[0] > 0.0 && w[1] > 0.0);
    let has_background = || values.iter().any(|v| *v <= 0.0);
    (most >= 1.0 && values.iter().all(is_label) && has_background() && are_patches()).then_some(most)
}

/// Whether a file is one of these formats, usable or not.
pub(super) fn is_one(path: &Path) -> bool {
    !matches!(recognised(path), Ok(None) | Err(Error::Read { .. }))
}

/// The header of a file.
fn recognised(path: &Path) -> Result<Option<Recognised>, Error> {
    if !path.is_file() {
        return Ok(None);
    }
    let (start, rest) = opened(path)?;
    let fault = |fault| Error::Image { path: path.to_owned(), fault };
    let Some(header) = formats::recognise(&start).map_err(fault)? else {
        let header = path.with_extension("hdr");
        let is_image = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("img"));
        return if is_image && header.is_file() { recognised(&header) } else { Ok(None) };
    };
    Ok(Some(Recognised { path: path.to_owned(), header, start, rest }))
}

/// A file's first bytes, and the file behind them.
fn opened(path: &Path) -> Result<(Vec<u8>, File), Error> {
    let mut start = Vec::new();
    let mut rest = File::open(path).map_err(|e| unreadable(path, e))?;
    rest.by_ref().take(START_BYTES).read_to_end(&mut start).map_err(|e| unreadable(path, e))?;
    Ok((start, rest))
}

impl Recognised {
    fn with_values(self) -> Result<ImageFile, Error> {
        let Self { path, mut header, start, rest } = self;
        let n_files = 1 + usize::from(header.place.file.is_some());
        let bytes = match header.place.file.clone() {
            None => value_bytes(&mut header, &path, start, rest)?,
            Some(file) => {
                let place = beside(&path, header.format, &file)?;
                let (start, rest) = opened(&place)?;
                if matches!(file, DataFile::Beside(_)) {
                    // Each file of a NIfTI pair may be packed or not.
                    let is_packed = start.starts_with(&GZIP_MAGIC);
                    header.place.packing = if is_packed { Packing::Gzip } else { Packing::Raw };
                }
                value_bytes(&mut header, &place, start, rest)?
            }
        };
        Ok(ImageFile { path, header, bytes, n_files })
    }
}

/// The bytes of a file up to the end of the values that its header declares, and one more where it goes on; where the header says that
/// they are the last ones of the file, these alone. However long the file is, no more is read than the header declares.
fn value_bytes(
    header: &mut Header,
    path: &Path,
    mut bytes: Vec<u8>,
    mut rest: File,
) -> Result<Vec<u8>, Error> {
    let unreadable = |e| unreadable(path, e);
    let length = rest.metadata().map_err(unreadable)?.len();
    if header.place.skip == Skip::AllButValues {
        let first = length.saturating_sub(values::n_declared(header));
        rest.seek(SeekFrom::Start(first)).map_err(unreadable)?;
        (bytes, header.place.skip) = (Vec::new(), Skip::File(0));
    }
    let wanted = values::most_bytes(header, &bytes).min(length).saturating_sub(bytes.len() as u64);
    let too_large =
        || Error::Image { path: path.to_owned(), fault: Fault::TooLarge { dims: header.grid.dims } };
    let n = usize::try_from(wanted).map_err(|_beyond| too_large())?;
    bytes.try_reserve_exact(n).map_err(|_refused| too_large())?;
    rest.take(wanted).read_to_end(&mut bytes).map_err(unreadable)?;
    Ok(bytes)
}

/// The file of the values: the header's folder or one below holds it, whatever the header says, and it is a file with an end.
fn beside(header: &Path, format: &'static str, file: &DataFile) -> Result<PathBuf, Error> {
    let is_plain = |c: Component<'_>| matches!(c, Component::Normal(_) | Component::CurDir);
    let place = match file {
        DataFile::Named(name) if Path::new(name).components().all(is_plain) => {
            Some(header.with_file_name("").join(name))
        }
        DataFile::Named(_) => None,
        DataFile::Beside(endings) => Some(with_an_ending(header, endings)),
    };
    let elsewhere = Error::Image { path: header.to_owned(), fault: Fault::ValuesElsewhere { format } };
    place.filter(|p| p.is_file() || !p.exists()).ok_or(elsewhere)
}

/// The header's path with the first ending under which there is something.
fn with_an_ending(header: &Path, endings: &[&str]) -> PathBuf {
    let is_packed = header.extension().is_some_and(|e| e.eq_ignore_ascii_case("gz"));
    let plain = if is_packed { header.with_extension("") } else { header.to_owned() };
    let mut places = endings.iter().map(|e| plain.with_extension(e));
    let first = places.next().unwrap_or_default();
    if first.exists() { first } else { places.find(|p| p.exists()).unwrap_or(first) }
}

impl ImageFile {
    fn fault(&self, fault: Fault) -> Error {
        match fault {
            Fault::Cancelled(cancelled) => cancelled.into(),
            fault => Error::Image { path: self.path.clone(), fault },
        }
    }

    pub(super) fn load(&self, choice: SeriesChoice, task: &Task<'_>) -> Result<Loaded, Error> {
        self.volume(self.chosen(choice)?, task).map_err(|f| self.fault(f))
    }

    fn chosen(&self, choice: SeriesChoice) -> Result<usize, Error> {
        match (choice, self.header.n_volumes) {
            (SeriesChoice::Only, 1) => Ok(0),
            (SeriesChoice::Only, n) => {
                Err(Error::SeveralVolumes { path: self.path.clone(), n, listing: self.listing() })
            }
            (SeriesChoice::ByNumber(number), n) if (1..=n).contains(&number) => Ok(number - 1),
            (SeriesChoice::ByNumber(number), _) => {
                Err(Error::NoSuchSeries { number, listing: self.listing() })
            }
        }
    }

    /// The volumes in one line: they share their grid.
    fn listing(&self) -> String {
        let Header { grid, n_volumes, .. } = &self.header;
        let [columns, rows, planes] = grid.dims;
        let [dx, dy, _] = grid.axes_mm.map(|a| a.norm());
        let numbers = if *n_volumes == 1 { "1".into() } else { format!("1 to {n_volumes}") };
        format!(
            "{numbers}: {}, {planes} planes of {columns} x {rows} pixels of {dx:.4} x {dy:.4} mm",
            self.modality()
        )
    }

    fn modality(&self) -> &'static str {
        self.header.modality.unwrap_or("unknown")
    }

    /// Volume number `index`, from 0.
    fn volume(&self, index: usize, task: &Task<'_>) -> Result<Loaded, Fault> {
        let placed = self.header.grid.place()?;
        let mut warnings = self.header.warnings.iter().chain(&placed.warnings).cloned().collect();
        #[expect(clippy::cast_possible_truncation, reason = "24 bits hold every intensity of a CT")]
        let mut read = values::read(&self.header, &self.bytes, index, task, |v, _| Ok(v as f32))?;
        if let Some(most) = largest_label(&read.values, placed.dims[0]) {
            return Err(Fault::LabelMap { most });
        }
        let slab_thickness_mm = self.slab_thickness(&placed, &mut warnings);
        warnings.extend(filled(&mut read.values));
        warnings.extend(read.goes_on.then(more_values));
        Ok(Loaded {
            volume: placed.into_volume(read.values, slab_thickness_mm),
            warnings,
            modality: self.modality().to_owned(),
            n_files: self.n_files,
            frame: FrameOfReference::default(),
        })
    }

    /// The stated thickness, else the planes' distance; says what the file does not state.
    fn slab_thickness(&self, placed: &Placed, warnings: &mut Vec<Warning>) -> f64 {
        let format = self.header.format;
        match self.header.modality {
            Some("CT") => {}
            Some(other) => {
                let text = format!("modality is {other}, not CT: intensities are not Hounsfield units");
                warnings.push(Warning::new("ct.modality", text));
            }
            None => {
                let text = format!("the {format} file states no modality: intensities were taken as HU");
                warnings.push(Warning::new("ct.modality", text));
            }
        }
        let step_mm = placed.step_mm();
        match self.header.slab_thickness_mm {
            Some(stated) if slabs::is_believed(stated) => {
                warnings.extend(slabs::overlap(stated, step_mm));
                stated
            }
            Some(_) => {
                warnings.push(slabs::not_believed(step_mm));
                step_mm
            }
            None => {
                let text = format!(
                    "the {format} file states no slice thickness; the planes' distance, {step_mm:.3} mm, was taken"
                );
                warnings.push(Warning::new("ct.no_thickness", text));
                step_mm
            }
        }
    }

    fn labels(&self, task: &Task<'_>) -> Result<LabelMap, Error> {
        let label_map = || {
            if self.header.n_volumes > 1 {
                let (format, what) = (self.header.format, "several label maps in one file".into());
                return Err(Fault::Unsupported { format, what, instead: "write each into its own file" });
            }
            let placed = self.header.grid.place()?;
            let mut read = values::read(&self.header, &self.bytes, 0, task, label)?;
            placed.turn(&mut read.values);
            let mut warnings: Vec<Warning> =
                self.header.warnings.iter().chain(&placed.warnings).cloned().collect();
            warnings.extend(read.goes_on.then(more_values));
            Ok(LabelMap {
                dims: placed.dims,
                labels: read.values,
                origin_xy_mm: placed.origin_xy_mm,
                pixel_spacing_xy_mm: placed.pixel_spacing_xy_mm,
                plane_z_mm: placed.plane_z_mm,
                patient_from_stack: placed.patient_from_stack,
                warnings,
            })
        };
        label_map().map_err(|f| self.fault(f))
    }

    /// The volume that a name means; its number says all there is to keep, for the file itself is the case's source.
    fn find(&self, name: &SeriesName) -> Result<SeriesMark, Error> {
        let number = match name {
            SeriesName::Number(number) => *number,
            SeriesName::Mark(mark) => mark.number,
            SeriesName::Uid(_) => return Err(Error::NoSeriesOfUid { listing: self.listing() }),
        };
        self.chosen(SeriesChoice::ByNumber(number))?;
        Ok(SeriesMark { number, check: String::new() })
    }

    pub(super) fn inspect(&self, task: &Task<'_>) -> Result<Inspection, Error> {
        // All volumes share the grid and the file: one pass over the values, kept of the middle one, tells what there is to tell.
        let looked_at = self.look_at(self.header.n_volumes / 2, task)?;
        let series = (0..self.header.n_volumes).map(|index| self.report(index, &looked_at)).collect();
        let faults = looked_at.err().iter().map(Error::to_string).collect();
        Ok(Inspection { n_files: self.n_files, series, warnings: Vec::new(), faults })
    }

    /// A volume, or what is wrong with it.
    fn look_at(&self, index: usize, task: &Task<'_>) -> Result<Result<Loaded, Error>, Error> {
        match self.volume(index, task).map_err(|f| self.fault(f)) {
            Err(Error::Cancelled(c)) => Err(c.into()),
            looked_at => Ok(looked_at),
        }
    }

    /// The report on a volume.
    fn report(&self, index: usize, looked_at: &Result<Loaded, Error>) -> SeriesReport {
        let (loaded, fault) = (looked_at.as_ref().ok(), looked_at.as_ref().err());
        let grid = &self.header.grid;
        let volume = loaded.map(|l| &l.volume);
        let warnings = loaded.map_or_else(|| self.header.warnings.clone(), |l| l.warnings.clone());
        let normal: Vector3 = grid.axes_mm[0].cross(&grid.axes_mm[1]).normalize();
        let slab_thickness_mm = self.header.slab_thickness_mm.filter(|t| slabs::is_believed(*t));
        SeriesReport {
            number: index + 1,
            modality: self.modality().to_owned(),
            distinction: String::new(),
            n_images: grid.dims[2],
            n_planes: volume.map(|v| v.dims[2]),
            columns_rows: [grid.dims[0], grid.dims[1]],
            pixel_spacing_xy_mm: [grid.axes_mm[0].norm(), grid.axes_mm[1].norm()],
            slab_thickness_mm,
            slab_gap_mm: volume.zip(slab_thickness_mm).map(|(v, t)| v.plane_interval_mm(0) - t),
            plane_step_mm: volume.map(|v| [v.plane_interval_mm(0); 2]),
            z_range_mm: volume.map(|v| [v.plane_z_mm[0], v.plane_z_mm[v.dims[2] - 1]]),
            orientation: Orientation::of(normal),
            normal_lps: normal.into(),
            gantry_tilt_deg: None,
            pixels: self.pixels(),
            encoding: self.header.encoding(),
            verdict: Verdict::of(fault, &warnings),
            reason: fault.map(|f| f.text_with(|_| "the file".to_owned())),
            warnings,
            next: next_command(index + 1, fault, self.header.n_volumes > 1),
        }
    }

    fn pixels(&self) -> PixelReport {
        let bits = u16::try_from(8 * self.header.scalar.n_bytes()).unwrap_or(u16::MAX);
        let rescale = Some(self.header.rescale);
        PixelReport {
            bits_allocated: bits,
            bits_stored: bits,
            signed: self.header.scalar.is_signed(),
            rescale,
            padding: None,
        }
    }
}

/// A whole number that can be a label.
fn label(value: f64, index: usize) -> Result<u32, Fault> {
    if value.fract() != 0.0 || !(0.0..=f64::from(u32::MAX)).contains(&value) {
        return Err(Fault::NotALabel { index, found: value });
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked just now")]
    Ok(value as u32)
}

/// Puts air where there is no value.
fn filled(values: &mut [f32]) -> Option<Warning> {
    let mut n = 0;
    for value in values.iter_mut().filter(|v| !v.is_finite()) {
        *value = NO_VALUE_HU;
        n += 1;
    }
    let text = format!("{n} voxel(s) without a value (NaN or infinite) were taken as air, {NO_VALUE_HU} HU");
    (n > 0).then(|| Warning::new("ct.no_value", text))
}

fn more_values() -> Warning {
    Warning::new(
        "ct.more_values",
        "the file goes on after the values that its header declares; the rest was left out",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ct::reader;
    use std::fs;
    use tempfile::TempDir;

    const NRRD: &str = "NRRD0004\ntype: uint8\nsizes: 2 2 2\nspacings: 1 1 1\nencoding: raw\n";

    /// A header that names its values, a file of values beside it, below it and outside.
    fn place(data_file: &str) -> (TempDir, PathBuf) {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("folder");
        fs::create_dir_all(folder.join("below")).unwrap();
        for values in ["outside.raw", "folder/beside.raw", "folder/below/values.raw"] {
            fs::write(place.path().join(values), [7; 8]).unwrap();
        }
        std::os::unix::fs::symlink("/dev/zero", folder.join("endless.raw")).unwrap();
        let header = folder.join("header.nhdr");
        let data_file = data_file.replace("PLACE", place.path().to_str().unwrap());
        fs::write(&header, format!("{NRRD}data file: {data_file}\n\n")).unwrap();
        (place, header)
    }

    #[test]
    fn values_are_read_from_the_headers_folder_and_from_nowhere_else() {
        for inside in ["beside.raw", "./beside.raw", "below/values.raw"] {
            let (_place, header) = place(inside);
            let loaded = reader::load(&header, &SeriesChoice::Only, &Task::quiet()).unwrap();
            assert_eq!((loaded.volume.at(0, 0, 0), loaded.n_files), (7.0, 2), "{inside}");
            let files = image_files(&header).unwrap().unwrap();
            assert_eq!(
                (&files[0], files[1].ends_with(inside.trim_start_matches("./"))),
                (&header, true),
                "{inside}"
            );
        }
        for outside in [
            "../outside.raw",
            "PLACE/outside.raw",
            "/dev/zero",
            "endless.raw",
            "below/../beside.raw",
            "below",
        ] {
            let (_place, header) = place(outside);
            let refused = |e: Error| matches!(e, Error::Image { fault: Fault::ValuesElsewhere { .. }, .. });
            assert!(
                refused(reader::load(&header, &SeriesChoice::Only, &Task::quiet()).unwrap_err()),
                "{outside}"
            );
            assert!(refused(image_files(&header).unwrap_err()), "{outside}");
        }
    }

    #[test]
    fn labels_are_told_from_intensities() {
        let patch = |inside: f32| -> Vec<f32> {
            let is_in = |p: usize| (8..20).contains(&(p % 32)) && (4..14).contains(&(p / 32));
            (0..32 * 20).map(|p| if is_in(p) { inside } else { 0.0 }).collect()
        };
        assert_eq!(largest_label(&patch(1.0), 32), Some(1.0));
        assert_eq!(largest_label(&patch(117.0), 32), Some(117.0));
        // An image's contrast, values below 0 or between whole numbers, noise, nothing at all.
        assert_eq!(largest_label(&patch(300.0), 32), None);
        assert_eq!(largest_label(&patch(-3.0), 32), None);
        assert_eq!(largest_label(&patch(0.5), 32), None);
        assert_eq!(largest_label(&patch(0.0), 32), None);
        // Few grey values in much black: an image, for within what is seen neighbours differ.
        let textured: Vec<f32> =
            (0_u16..640).zip(patch(1.0)).map(|(p, inside)| inside * f32::from(1 + p * 7 % 5)).collect();
        let n_steps = textured.windows(2).filter(|w| w[0].total_cmp(&w[1]).is_ne()).count();
        assert!(n_steps < 180, "{n_steps}");
        assert_eq!(largest_label(&[vec![0.0; 3200], textured].concat(), 32), None);
        let noisy: Vec<f32> = (0_u16..640).map(|p| f32::from(p * 7 % 23)).collect();
        assert_eq!(largest_label(&noisy, 32), None);
    }

    #[test]
    fn a_header_is_looked_at_without_the_values_behind_it() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("large.nrrd");
        fs::write(&path, format!("{NRRD}\n")).unwrap();
        // A hole that no machine's memory holds.
        File::options().append(true).open(&path).unwrap().set_len(1 << 42).unwrap();
        assert_eq!(image_files(&path).unwrap(), Some(vec![path.clone()]));
        assert_eq!(reader::find(&path, &SeriesName::Number(1), "", &Task::quiet()).unwrap().number, 1);
    }

    #[test]
    fn no_more_is_read_than_a_header_declares() {
        let place = tempfile::tempdir().unwrap();
        // Eight values, each with a hole behind them or before them that no machine's memory holds.
        let own = place.path().join("own.nrrd");
        fs::write(&own, [NRRD.as_bytes(), b"\n", &[7; 8]].concat()).unwrap();
        let header = place.path().join("header.nhdr");
        fs::write(&header, format!("{NRRD}byte skip: -1\ndata file: values.raw\n\n")).unwrap();
        let values = place.path().join("values.raw");
        for (path, enlarged) in [(&own, &own), (&header, &values)] {
            File::options().create(true).append(true).open(enlarged).unwrap().set_len(1 << 42).unwrap();
            let loaded = reader::load(path, &SeriesChoice::Only, &Task::quiet());
            let codes = loaded.unwrap().warnings.into_iter().map(|w| w.code).collect::<Vec<_>>();
            assert_eq!(codes.contains(&"ct.more_values".to_owned()), path == &own, "{codes:?}");
        }
    }

    #[test]
    fn volumes_of_one_file_are_reported_each() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("series.nrrd");
        let header =
            NRRD.replace("sizes: 2 2 2", "sizes: 2 2 2 3").replace("spacings: 1 1 1", "spacings: 1 1 1 1");
        let with = |n: usize| {
            fs::write(&path, [format!("{header}\n").into_bytes(), vec![1; n]].concat()).unwrap();
            reader::inspect(&path, &Task::quiet()).unwrap()
        };
        let whole = with(24);
        assert_eq!(whole.series.iter().map(|s| s.number).collect::<Vec<_>>(), [1, 2, 3]);
        assert!(whole.faults.is_empty() && whole.series.iter().all(|s| s.n_planes == Some(2)));
        let cut = with(23);
        assert_eq!(cut.faults.len(), 1, "one file has one fault: {:?}", cut.faults);
        assert!(cut.series.iter().all(|s| s.verdict == Verdict::Unusable));
    }
}
