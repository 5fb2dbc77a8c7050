//! Reads a DICOM series from a folder, a DICOMDIR or a file, or a volume from an image file: the one place of this room that
//! touches files.
//!
//! All files below a folder are looked at. What is not DICOM, localizers and objects without image planes are
//! left out with a warning; a DICOM file that cannot be read is an error, because it may be a plane of the series, unless what
//! can be read of it names another series of the folder. A file that is no DICOM is told by its first bytes.
//!
//! Transfer syntaxes: uncompressed (implicit and explicit, both byte orders), deflated, RLE, JPEG baseline, extended and
//! lossless, JPEG-LS, JPEG 2000. Multi-frame objects (Enhanced CT and its like) give an image for each frame.
//!
//! Cost: one pass over all headers, one over the pixels of the chosen series; both on all cores. Memory: the volume and
//! one image per thread.

mod beginning;
mod files;
mod header;
mod image;
mod lengths;
mod open;
mod pixels;
mod places;
mod stacks;
mod syntax;

pub use super::codec::is_decoding;
pub(crate) use files::is_dicom;
pub use image::{image_files, load_labels};

use super::grouping::group;
use super::series::{Header, Series, Shape, listing};
use super::stack::{Gaps, Stack, arrange};
use super::{
    Error, FrameOfReference, Inspection, Loaded, SeriesChoice, SeriesMark, SeriesName, SeriesReport, Volume,
    Voxels, Warning,
};
use crate::progress::{Cancelled, Task};
use dicom_object::DefaultDicomObject;
use files::{Folder, scan};
use pixels::{Findings, Inflated};
use rayon::prelude::*;
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// How to read a folder.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Options {
    /// Which series.
    pub choice: SeriesChoice,
    /// Whether a stack with missing planes is used, with a warning.
    pub allow_gaps: bool,
    /// Heights along the stack's normal that will be used, mm: outside them missing planes do no harm; `None`: all.
    pub z_mm: Option<[f64; 2]>,
}

impl Options {
    fn gaps(&self) -> Gaps {
        match self.z_mm {
            Some(used) if !self.allow_gaps => Gaps::RefusedWithin(used),
            _ => self.allow_gaps.into(),
        }
    }
}

/// Reads the chosen series, refusing one with missing planes.
///
/// # Errors
/// [`Error`]: nothing to read, several series, damaged files, a geometry that makes no regular stack, interruption.
pub fn load(path: &Path, choice: &SeriesChoice, task: &Task<'_>) -> Result<Loaded, Error> {
    load_with(path, &Options { choice: *choice, ..Options::default() }, task)
}

/// Reads a series as the options say.
///
/// # Errors
/// As [`load`].
pub fn load_with(path: &Path, options: &Options, task: &Task<'_>) -> Result<Loaded, Error> {
    if let Some(image) = image::open(path)? {
        return image.load(options.choice, task);
    }
    let Folder { images, mut warnings, damages, .. } = scan(path, task)?;
    let all = group(images);
    let (own, elsewhere): (Vec<_>, Vec<_>) = match choose(path, &all, options.choice) {
        Ok(series) => damages.into_iter().partition(|d| d.concerns(series, &all)),
        // A damaged file may be why there is nothing to choose.
        Err(_) => damages.into_iter().partition(|d| !d.is_of_one_of(&all)),
    };
    if let Some(damage) = own.into_iter().next() {
        return Err(damage.beside(&all).fault);
    }
    let series = choose(path, &all, options.choice)?;
    warnings.extend(left_out("ct.damaged_elsewhere", elsewhere.len(), "damaged file(s) of other series"));
    let mut stack = arrange(series, options.gaps())?;
    warnings.append(&mut stack.warnings);
    let (volume, findings) = read_volume(series, &stack, task)?;
    warnings.append(&mut findings.warnings());
    Ok(Loaded {
        volume,
        warnings,
        modality: series.images[0].modality.clone(),
        n_files: stack.images.len() + stack.duplicates.len(),
        frame: FrameOfReference::new(&series.images[0].identity[1]),
    })
}

/// Finds a series among those of a folder and says what to keep of it. `salt` is the case's own, so that what is kept in two
/// cases cannot be compared. Reads headers only.
///
/// # Errors
/// [`Error::NoSuchSeries`], [`Error::NoSeriesOfUid`] or [`Error::SeriesGone`] where it is not there; as [`load`] for the folder.
pub fn find(path: &Path, name: &SeriesName, salt: &str, task: &Task<'_>) -> Result<SeriesMark, Error> {
    if let Some(mark) = image::find(path, name)? {
        return Ok(mark);
    }
    let all = group(scan(path, task)?.images);
    let position = match name {
        SeriesName::Number(number) => number.checked_sub(1).filter(|&i| i < all.len()),
        SeriesName::Uid(uid) => all.iter().position(|s| s.has_uid(uid)),
        SeriesName::Mark(mark) => all.iter().position(|s| s.check(salt) == mark.check),
    };
    let missing = || {
        let listing = listing(&all);
        match name {
            SeriesName::Number(number) => Error::NoSuchSeries { number: *number, listing },
            SeriesName::Uid(_) => Error::NoSeriesOfUid { listing },
            SeriesName::Mark(mark) => Error::SeriesGone { number: mark.number, listing },
        }
    };
    let i = position.ok_or_else(missing)?;
    if let SeriesName::Uid(uid) = name
        && all.iter().filter(|s| s.has_uid(uid)).count() > 1
    {
        // One UID, several phases or reconstructions: only the number tells them apart.
        return Err(Error::SeveralSeries { n: all.len(), listing: listing(&all) });
    }
    Ok(SeriesMark { number: i + 1, check: all[i].check(salt) })
}

/// The files that [`load`] looks at: those below a folder and those that a DICOMDIR names, or an image's header and its values.
/// Whoever wants to know whether a source has changed compares these and no others. Reads headers only.
///
/// # Errors
/// [`Error`] as [`load`], for what the path means and for the system; a damaged file is none.
pub fn files_of(path: &Path, task: &Task<'_>) -> Result<Vec<PathBuf>, Error> {
    match image_files(path)? {
        Some(files) => Ok(files),
        None => Ok(scan(path, task)?.files),
    }
}

/// Says which series a folder holds and whether they can be used. Headers are read and the sizes of all pixels checked; only the
/// middle image of each series and images at the same place are decoded.
///
/// # Errors
/// [`Error`] where there is nothing to report on: no folder, no file, no image; or on interruption. What is wrong with a
/// series is told in its report.
pub fn inspect(path: &Path, task: &Task<'_>) -> Result<Inspection, Error> {
    if let Some(image) = image::open(path)? {
        return image.inspect(task);
    }
    let Folder { images, files, warnings, damages } = scan(path, task)?;
    let all = group(images);
    if all.is_empty() {
        let damage = damages.into_iter().next();
        return Err(damage.map_or_else(|| Error::NoImages(path.to_owned()), |d| d.fault));
    }
    let damages: Vec<_> = damages.into_iter().map(|d| d.beside(&all)).collect();
    let mut texts: Vec<String> = damages.iter().map(|d| d.fault.to_string()).collect();
    let mut reports = Vec::with_capacity(all.len());
    for (i, series) in all.iter().enumerate() {
        let (stack, fault) = examine(series, task)?;
        let damage = damages.iter().find(|d| d.concerns(series, &all));
        // A damaged file is why its plane is missing.
        texts.extend(fault.as_ref().filter(|_| damage.is_none()).map(Error::to_string));
        let fault = damage.map(|d| &d.fault).or(fault.as_ref());
        reports.push(SeriesReport::new(i + 1, series, stack.as_ref(), fault, all.len() > 1));
    }
    Ok(Inspection { n_files: files.len(), series: reports, warnings, faults: texts })
}

/// Reads a whole DICOM file, whatever it holds, once every element is known to lie within it.
pub(crate) fn open_whole(path: &Path) -> Result<DefaultDicomObject, Error> {
    open::open(path, None).map(|(object, _)| object)
}

/// The stack of a series, where it makes one, and what stands against its use.
fn examine(series: &Series, task: &Task<'_>) -> Result<(Option<Stack>, Option<Error>), Error> {
    let mut stack = match arrange(series, false) {
        Ok(stack) => stack,
        Err(fault) => return Ok((arrange(series, true).ok(), Some(fault))),
    };
    match check_pixels(series, &stack, task) {
        Ok(findings) => {
            stack.warnings.append(&mut findings.warnings());
            Ok((Some(stack), None))
        }
        Err(Error::Cancelled(c)) => Err(c.into()),
        Err(fault) => Ok((Some(stack), Some(fault))),
    }
}

/// Checks that the pixels can be read: those of the middle image, and those that must not differ. That each file holds as many as
/// it must was seen with its header.
fn check_pixels(series: &Series, stack: &Stack, task: &Task<'_>) -> Result<Findings, Error> {
    let middle = &series.images[stack.images[stack.images.len() / 2]];
    let (_, findings) = stored_plane(middle, stack, &Inflated::default())?;
    compare_duplicates(series, stack, |_| None, task)?;
    Ok(findings)
}

fn choose<'a>(path: &Path, all: &'a [Series], choice: SeriesChoice) -> Result<&'a Series, Error> {
    match (all, choice) {
        ([], _) => Err(Error::NoImages(path.to_owned())),
        ([only], SeriesChoice::Only) => Ok(only),
        (_, SeriesChoice::Only) => Err(Error::SeveralSeries { n: all.len(), listing: listing(all) }),
        (_, SeriesChoice::ByNumber(number)) => number
            .checked_sub(1)
            .and_then(|i| all.get(i))
            .ok_or_else(|| Error::NoSuchSeries { number, listing: listing(all) }),
    }
}

fn read_volume(series: &Series, stack: &Stack, task: &Task<'_>) -> Result<(Volume, Findings), Error> {
    let [columns, rows] = stack.size;
    let dims = [columns, rows, stack.images.len()];
    check_size(dims)?;
    let inflated = Inflated::of(stack.images.iter().map(|&i| &series.images[i]), task)?;
    let done = AtomicU64::new(0);
    let n_planes = stack.images.len() as u64;
    let (hu, findings) = Voxels::by_plane(stack.images.len(), |k| {
        task.check()?;
        let mut plane = blank(columns * rows, dims)?;
        let findings = read_plane(series, stack, k, &inflated, &mut plane)?;
        task.report(done.fetch_add(1, Ordering::Relaxed) + 1, n_planes);
        Ok::<_, Error>((plane, findings))
    })?;
    let findings = findings.into_iter().fold(Findings::default(), Findings::and);
    drop(inflated);
    // Planes that were moved onto the grid are not what their files hold.
    let is_as_stored = stack.shifts.is_empty();
    let read = |image| stack.images.iter().position(|&i| is_as_stored && i == image).map(|k| hu.plane(k));
    compare_duplicates(series, stack, read, task)?;
    let volume = Volume {
        dims,
        hu,
        origin_xy_mm: stack.origin_xy_mm,
        pixel_spacing_xy_mm: series.images[0].shape.spacing_xy_mm,
        plane_z_mm: stack.plane_z_mm.clone(),
        slab_thickness_mm: stack.slab_thickness_mm,
        patient_from_stack: stack.patient_from_stack,
    };
    Ok((volume, findings))
}

/// Reads plane k onto the grid of the stack.
fn read_plane(
    series: &Series,
    stack: &Stack,
    k: usize,
    inflated: &Inflated<'_>,
    plane: &mut [f32],
) -> Result<Findings, Error> {
    let header = &series.images[stack.images[k]];
    let Some(shift) = stack.shifts.get(k) else {
        return pixels::read_plane(header, inflated, stack.reversed, plane);
    };
    let (stored, findings) = stored_plane(header, stack, inflated)?;
    let darkest = stored.iter().copied().fold(f32::INFINITY, f32::min);
    shift.apply(&stored, [header.shape.columns, header.shape.rows], plane, stack.size, darkest);
    Ok(findings)
}

/// The pixels of an image, turned over as the stack asks.
fn stored_plane(
    header: &Header,
    stack: &Stack,
    inflated: &Inflated<'_>,
) -> Result<(Vec<f32>, Findings), Error> {
    let Shape { columns, rows, .. } = header.shape;
    let mut plane = blank(header.shape.n_pixels(), [columns, rows, 1])?;
    let findings = pixels::read_plane(header, inflated, stack.reversed, &mut plane)?;
    Ok((plane, findings))
}

/// Refuses what no memory holds before the first plane is read: dimensions come from files. Planes of whole numbers take two
/// bytes a voxel; how many are others shows only as they are read.
fn check_size(dims: [usize; 3]) -> Result<(), Error> {
    let n = dims.iter().try_fold(1_usize, |n, &d| n.checked_mul(d)).ok_or(Error::TooLarge { dims })?;
    Vec::<i16>::new().try_reserve_exact(n).map_err(|_refused| Error::TooLarge { dims })
}

/// A plane of zeros, asked for in a way that may fail.
fn blank(n_pixels: usize, dims: [usize; 3]) -> Result<Vec<f32>, Error> {
    let mut plane = Vec::new();
    plane.try_reserve_exact(n_pixels).map_err(|_refused| Error::TooLarge { dims })?;
    plane.resize(n_pixels, 0.0);
    Ok(plane)
}

/// Refuses images at one place that are not the same image. `read` gives the pixels of an image that was read already.
fn compare_duplicates<'a>(
    series: &Series,
    stack: &Stack,
    read: impl Fn(usize) -> Option<Cow<'a, [f32]>> + Sync,
    task: &Task<'_>,
) -> Result<(), Error> {
    let both = stack.duplicates.iter().flat_map(|&(kept, other)| [kept, other]);
    let inflated = Inflated::of(both.map(|i| &series.images[i]), task)?;
    let pixels = |image: usize| stored_plane(&series.images[image], stack, &inflated).map(|(plane, _)| plane);
    let differ = |&(kept, other): &(usize, usize)| {
        task.check()?;
        let kept = read(kept).map_or_else(|| pixels(kept).map(Cow::Owned), Ok)?;
        Ok::<_, Error>(kept.as_ref() != pixels(other)?)
    };
    let found: Vec<Result<bool, Error>> = stack.duplicates.par_iter().map(differ).collect();
    for (&(kept, other), differ) in stack.duplicates.iter().zip(found) {
        if differ? {
            let plane = stack.images.iter().position(|&i| i == kept).expect("what is doubled was kept");
            return Err(Error::ConflictingPlanes {
                first: series.images[kept].path.clone(),
                second: series.images[other].path.clone(),
                z_mm: stack.plane_z_mm[plane],
            });
        }
    }
    Ok(())
}

/// Applies a fallible function to all items in parallel, results in the order of the items.
fn in_parallel<T: Sync, R: Send>(
    items: &[T],
    task: &Task<'_>,
    f: impl Fn(&T) -> R + Sync,
) -> Result<Vec<R>, Cancelled> {
    items
        .par_iter()
        .map(|item| {
            task.check()?;
            Ok(f(item))
        })
        .collect()
}

/// A warning about files that were left out, unless there are none.
fn left_out(code: &str, n: usize, what: &str) -> Option<Warning> {
    (n > 0).then(|| Warning::new(code, format!("{n} {what} left out")))
}

#[cfg(test)]
mod encodings;
#[cfg(test)]
#[path = "../../../tests/shared/mod.rs"]
mod shared;
#[cfg(test)]
mod tests;
