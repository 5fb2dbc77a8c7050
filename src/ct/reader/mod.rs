//! Reads a DICOM series from a folder: the one place of this room that touches files.
//!
//! All files below the folder are looked at. What is not DICOM, localizers and objects without image planes are
//! left out with a warning; a DICOM file that cannot be read is an error, because it may be a plane of the series.
//!
//! Transfer syntaxes: uncompressed (implicit and explicit, both byte orders), deflated, RLE, JPEG baseline, extended and
//! lossless, JPEG-LS, JPEG 2000. Multi-frame objects (Enhanced CT and its like) give an image for each frame.
//!
//! Cost: one pass over all headers, one over the pixels of the chosen series; both on all cores. Memory: the volume and
//! one file per thread.

mod files;
mod header;
mod lengths;
mod pixels;
mod places;
mod stacks;
mod syntax;

pub use super::codec::is_decoding;

use super::series::{Series, group, listing};
use super::stack::{Stack, arrange};
use super::{Error, Inspection, Loaded, SeriesChoice, SeriesReport, Volume, Warning};
use crate::progress::{Cancelled, Task};
use files::{Folder, scan};
use pixels::Findings;
use rayon::prelude::*;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// How to read a folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Options {
    /// Which series.
    pub choice: SeriesChoice,
    /// Whether a stack with missing planes is used, with a warning.
    pub allow_gaps: bool,
}

/// Reads the chosen series, refusing one with missing planes.
///
/// # Errors
/// [`Error`]: nothing to read, several series, damaged files, a geometry that makes no regular stack, interruption.
pub fn load(path: &Path, choice: &SeriesChoice, task: &Task<'_>) -> Result<Loaded, Error> {
    load_with(path, &Options { choice: *choice, allow_gaps: false }, task)
}

/// Reads a series as the options say.
///
/// # Errors
/// As [`load`].
pub fn load_with(path: &Path, options: &Options, task: &Task<'_>) -> Result<Loaded, Error> {
    let folder = scan(path, task)?;
    if let Some(fault) = folder.faults.into_iter().next() {
        return Err(fault);
    }
    let mut warnings = folder.warnings;
    let all = group(folder.images);
    let series = choose(path, &all, options.choice)?;
    let mut stack = arrange(series, options.allow_gaps)?;
    warnings.append(&mut stack.warnings);
    let (volume, findings) = read_volume(series, &stack, task)?;
    warnings.append(&mut findings.warnings());
    Ok(Loaded {
        volume,
        warnings,
        modality: series.images[0].modality.clone(),
        n_files: stack.images.len() + stack.duplicates.len(),
    })
}

/// Says which series a folder holds and whether they can be used; reads all pixels to know.
///
/// # Errors
/// [`Error`] where there is nothing to report on: no folder, no file, no image; or on interruption. What is wrong with a
/// series is told in its report.
pub fn inspect(path: &Path, task: &Task<'_>) -> Result<Inspection, Error> {
    let Folder { images, n_files, warnings, faults } = scan(path, task)?;
    let all = group(images);
    if all.is_empty() {
        return Err(faults.into_iter().next().unwrap_or_else(|| Error::NoImages(path.to_owned())));
    }
    let fault = faults.first().map(Error::to_string);
    let report = |(i, series): (usize, &Series)| -> Result<SeriesReport, Error> {
        let (stack, reason) = examine(series, task)?;
        Ok(SeriesReport::new(i + 1, series, stack.as_ref(), fault.clone().or(reason)))
    };
    let series = all.iter().enumerate().map(report).collect::<Result<_, _>>()?;
    Ok(Inspection { n_files, series, warnings })
}

/// The stack of a series, where it makes one, and what stands against its use.
fn examine(series: &Series, task: &Task<'_>) -> Result<(Option<Stack>, Option<String>), Error> {
    let mut stack = match arrange(series, false) {
        Ok(stack) => stack,
        Err(fault) => return Ok((arrange(series, true).ok(), Some(fault.to_string()))),
    };
    match read_volume(series, &stack, task) {
        Ok((_, findings)) => {
            stack.warnings.append(&mut findings.warnings());
            Ok((Some(stack), None))
        }
        Err(Error::Cancelled(c)) => Err(c.into()),
        Err(fault) => Ok((Some(stack), Some(fault.to_string()))),
    }
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
    let shape = &series.images[0].shape;
    let dims = [shape.columns, shape.rows, stack.images.len()];
    let mut hu = zeroed(dims)?;
    let done = AtomicU64::new(0);
    let n_planes = stack.images.len() as u64;
    let results: Vec<Result<Findings, Error>> = hu
        .par_chunks_exact_mut(dims[0] * dims[1])
        .zip(&stack.images)
        .map(|(plane, &image)| {
            task.check()?;
            let findings = pixels::read_plane(&series.images[image], stack.reversed, plane)?;
            task.report(done.fetch_add(1, Ordering::Relaxed) + 1, n_planes);
            Ok(findings)
        })
        .collect();
    // The first error in the order of the planes, whichever thread met one first.
    let findings = results.into_iter().try_fold(Findings::default(), |sum, f| f.map(|f| sum.and(f)))?;
    let volume = Volume {
        dims,
        hu,
        origin_xy_mm: stack.origin_xy_mm,
        pixel_spacing_xy_mm: shape.spacing_xy_mm,
        plane_z_mm: stack.plane_z_mm.clone(),
        slab_thickness_mm: stack.slab_thickness_mm,
        patient_from_stack: stack.patient_from_stack,
    };
    compare_duplicates(series, stack, &volume, task)?;
    Ok((volume, findings))
}

/// The memory of a volume, asked for in a way that may fail: dimensions come from files.
fn zeroed(dims: [usize; 3]) -> Result<Vec<f32>, Error> {
    let n = dims.iter().try_fold(1_usize, |n, &d| n.checked_mul(d)).ok_or(Error::TooLarge { dims })?;
    let mut hu = Vec::new();
    hu.try_reserve_exact(n).ok().ok_or(Error::TooLarge { dims })?;
    hu.resize(n, 0.0);
    Ok(hu)
}

/// Refuses images at one place that are not the same image.
fn compare_duplicates(series: &Series, stack: &Stack, volume: &Volume, task: &Task<'_>) -> Result<(), Error> {
    let mut other_pixels = vec![0.0; volume.dims[0] * volume.dims[1]];
    for &(kept, other) in &stack.duplicates {
        task.check()?;
        let (first, second) = (&series.images[kept], &series.images[other]);
        pixels::read_plane(second, stack.reversed, &mut other_pixels)?;
        let plane = stack.images.iter().position(|&i| i == kept).expect("what is doubled was kept");
        if other_pixels != volume.plane(plane) {
            return Err(Error::ConflictingPlanes {
                first: first.path.clone(),
                second: second.path.clone(),
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
mod tests;
