//! Image files that are no DICOM (NIfTI, MetaImage, NRRD), read from the disk: the IO around [`formats`].
//!
//! A file is taken for one of them by what it holds, whatever it is called. Several volumes in one file (time steps, channels) count
//! as several series. What these formats do not state is told: modality, thickness of the slabs.
//!
//! Memory: the file, and the values of one volume.

use super::super::formats::grid::Placed;
use super::super::formats::values::{self, GZIP_MAGIC, Packing};
use super::super::formats::{self, DataFile, Fault, Header};
use super::super::inspection::next_command;
use super::super::{
    Error, Inspection, LabelMap, Loaded, Orientation, PixelReport, SeriesChoice, SeriesMark, SeriesName,
    SeriesReport, Verdict, Warning,
};
use super::files::unreadable;
use crate::geom::Vector3;
use crate::progress::Task;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Bytes that are looked at to know what a file is: the longest header.
const START_BYTES: u64 = 1 << 20;
/// What voxels without a value become: air.
const NO_VALUE_HU: f32 = -1024.0;

/// An image file and the bytes that hold its values.
pub(super) struct ImageFile {
    path: PathBuf,
    header: Header,
    bytes: Vec<u8>,
    n_files: usize,
}

/// Reads a file where it is one of the formats; `None` where it is something else.
pub(super) fn open(path: &Path) -> Result<Option<ImageFile>, Error> {
    let Some((path, mut header, mut bytes)) = recognised(path)? else { return Ok(None) };
    let n_files = 1 + usize::from(header.place.file.is_some());
    if let Some(file) = &header.place.file {
        let is_beside = matches!(file, DataFile::Beside(_));
        let place = beside(&path, file);
        bytes = std::fs::read(&place).map_err(|e| unreadable(&place, e))?;
        if is_beside {
            // Each file of a NIfTI pair may be packed or not.
            let is_packed = bytes.starts_with(&GZIP_MAGIC);
            header.place.packing = if is_packed { Packing::Gzip } else { Packing::Raw };
        }
    }
    Ok(Some(ImageFile { path, header, bytes, n_files }))
}

/// The other file that an image's header names, where it stands alone.
///
/// # Errors
/// [`Error`] where the file cannot be read, or is an image that cannot be used.
pub fn companion(path: &Path) -> Result<Option<PathBuf>, Error> {
    let Some((path, header, _)) = recognised(path)? else { return Ok(None) };
    Ok(header.place.file.map(|file| beside(&path, &file)))
}

/// The labels of a segmentation that is a label map in one of these formats; `None` where the file is something else.
///
/// # Errors
/// [`Error`] where it cannot be read or holds something else than labels.
pub fn load_labels(path: &Path, task: &Task<'_>) -> Result<Option<LabelMap>, Error> {
    let Some(image) = open(path)? else { return Ok(None) };
    image.labels(task).map(Some)
}

/// The header of a file, and its bytes; the header's path differs where the values' file was named.
fn recognised(path: &Path) -> Result<Option<(PathBuf, Header, Vec<u8>)>, Error> {
    if !path.is_file() {
        return Ok(None);
    }
    let mut bytes = Vec::new();
    let mut file = File::open(path).map_err(|e| unreadable(path, e))?;
    file.by_ref().take(START_BYTES).read_to_end(&mut bytes).map_err(|e| unreadable(path, e))?;
    let fault = |fault| Error::Image { path: path.to_owned(), fault };
    let Some(header) = formats::recognise(&bytes).map_err(fault)? else {
        let header = path.with_extension("hdr");
        let is_image = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("img"));
        return if is_image && header.is_file() { recognised(&header) } else { Ok(None) };
    };
    file.read_to_end(&mut bytes).map_err(|e| unreadable(path, e))?;
    Ok(Some((path.to_owned(), header, bytes)))
}

fn beside(header: &Path, file: &DataFile) -> PathBuf {
    match file {
        DataFile::Named(name) => header.with_file_name("").join(name),
        DataFile::Beside(endings) => {
            let is_packed = header.extension().is_some_and(|e| e.eq_ignore_ascii_case("gz"));
            let plain = if is_packed { header.with_extension("") } else { header.to_owned() };
            let mut places = endings.iter().map(|e| plain.with_extension(e));
            let first = places.next().unwrap_or_default();
            if first.exists() { first } else { places.find(|p| p.exists()).unwrap_or(first) }
        }
    }
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
        let slab_thickness_mm = self.slab_thickness(&placed, &mut warnings);
        warnings.extend(filled(&mut read.values));
        warnings.extend(read.goes_on.then(more_values));
        Ok(Loaded {
            volume: placed.into_volume(read.values, slab_thickness_mm),
            warnings,
            modality: self.modality().to_owned(),
            n_files: self.n_files,
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
        self.header.slab_thickness_mm.unwrap_or_else(|| {
            let step_mm = placed.step_mm();
            let text = format!("the {format} file states no slice thickness; the planes' distance, {step_mm:.3} mm, was taken");
            warnings.push(Warning::new("ct.no_thickness", text));
            step_mm
        })
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
    pub(super) fn find(&self, name: &SeriesName) -> Result<SeriesMark, Error> {
        let number = match name {
            SeriesName::Number(number) => *number,
            SeriesName::Mark(mark) => mark.number,
            SeriesName::Uid(_) => return Err(Error::NoSeriesOfUid { listing: self.listing() }),
        };
        self.chosen(SeriesChoice::ByNumber(number))?;
        Ok(SeriesMark { number, check: String::new() })
    }

    pub(super) fn inspect(&self, task: &Task<'_>) -> Result<Inspection, Error> {
        let (mut series, mut faults) = (Vec::new(), Vec::new());
        for index in 0..self.header.n_volumes {
            let (report, fault) = self.report(index, task)?;
            series.push(report);
            faults.extend(fault);
        }
        Ok(Inspection { n_files: self.n_files, series, warnings: Vec::new(), faults })
    }

    /// The report on a volume, and what is wrong with it, with the path.
    fn report(&self, index: usize, task: &Task<'_>) -> Result<(SeriesReport, Option<String>), Error> {
        let (loaded, fault) = match self.volume(index, task).map_err(|f| self.fault(f)) {
            Ok(loaded) => (Some(loaded), None),
            Err(Error::Cancelled(c)) => return Err(c.into()),
            Err(fault) => (None, Some(fault)),
        };
        let grid = &self.header.grid;
        let volume = loaded.as_ref().map(|l| &l.volume);
        let warnings = loaded.as_ref().map_or_else(|| self.header.warnings.clone(), |l| l.warnings.clone());
        let verdict = match (&fault, warnings.is_empty()) {
            (Some(_), _) => Verdict::Unusable,
            (None, true) => Verdict::Usable,
            (None, false) => Verdict::UsableWithWarnings,
        };
        let normal: Vector3 = grid.axes_mm[0].cross(&grid.axes_mm[1]).normalize();
        let slab_thickness_mm = self.header.slab_thickness_mm;
        let report = SeriesReport {
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
            verdict,
            reason: fault.as_ref().map(|f| f.text_with(|_| "the file".to_owned())),
            warnings,
            next: next_command(index + 1, fault.as_ref(), self.header.n_volumes > 1),
        };
        Ok((report, fault.map(|f| f.to_string())))
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
