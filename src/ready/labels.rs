//! A label map to the outlines of one label.

use super::place::Grid;
use super::{Absent, Error, Label, Ready, Reference, Structure, chosen};
use crate::ct::LabelMap;
use crate::progress::{Cancelled, Task};
use crate::sections::ready::{Drawn, DrawnStack, outlines_mm};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;

/// More labels than this are no segmentation but an image.
const MOST_LABELS: usize = 1000;

/// The outlines of the chosen label, plane by plane.
pub(super) fn ready(
    path: &Path,
    map: LabelMap,
    label: Option<&Label>,
    task: &Task<'_>,
) -> Result<Ready, Error> {
    let an_image = || Error::NoLabelMap { path: path.to_owned(), most: MOST_LABELS };
    let structures = structures(&map).ok_or_else(an_image)?;
    let number = chosen(path, &structures, label)?.number;
    let [columns, rows, _] = map.dims;
    let outlined = |(&z_mm, labels): (&f64, &[u32])| {
        task.check()?;
        let inside: Vec<bool> = labels.iter().map(|&l| l == number).collect();
        let contours = outlines_mm(&inside, columns, map.origin_xy_mm, map.pixel_spacing_xy_mm);
        Ok(Drawn { z_mm, contours })
    };
    let planes: Result<Vec<Drawn>, Cancelled> =
        map.plane_z_mm.par_iter().zip(map.labels.par_chunks_exact(columns * rows)).map(outlined).collect();
    let drawn = DrawnStack {
        planes: planes?,
        patient_from_stack: map.patient_from_stack,
        pixel_mm: map.pixel_spacing_xy_mm,
        are_outlines: true,
    };
    let reference = Reference::Grid(Grid::of_labels(&map));
    Ok(Ready { number, drawn, warnings: map.warnings, reference, absent: Absent::Never })
}

/// The labels that occur, with their voxels; `None` where they are too many.
fn structures(map: &LabelMap) -> Option<Vec<Structure>> {
    let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
    // Runs of one label are long: one look-up a run.
    for run in map.labels.chunk_by(|a, b| a == b) {
        *counts.entry(run[0]).or_default() += run.len();
        // Nothing, 0, is one of the values but no label.
        if counts.len() > MOST_LABELS + 1 {
            return None;
        }
    }
    let structure = |(number, size)| Structure { number, name: None, size, unit: "voxels" };
    let structures: Vec<Structure> =
        counts.into_iter().filter(|(number, _)| *number > 0).map(structure).collect();
    (structures.len() <= MOST_LABELS).then_some(structures)
}
