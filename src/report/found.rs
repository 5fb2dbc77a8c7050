//! What the comparison has, handed to the detectors of defects; what they find, put into the order of the work.

use super::anatomy::StageLumina;
use super::faults::{
    Compared, Ends, Finding, Kind, Made, Seen, StagePair, broken_course, changed_islands, deposited, moved,
    odd_layers, out_of_order, plugged, unlike_image, without_echoes,
};
use super::image::ImageBoundary;
use super::stages::{PlaneWork, compensation_mm, layer_lumen};
use super::{BodyKind, Inputs, Stage};
use crate::geom::{Contour, Region};
use rayon::prelude::*;

/// Smaller deviations of the contours from the image are none, mm; or this part of a pixel.
const LEAST_IN_IMAGE_MM: f64 = 0.08;
const LEAST_IN_IMAGE_PIXEL: f64 = 0.25;
/// Contour, solid, layer: exact geometry, mm.
const LEAST_EXACT_MM: f64 = 0.02;
/// Beads have widths and corners, mm.
const LEAST_BEADS_MM: f64 = 0.06;
/// Contours farther off the boundary in the image than this, on average, do not fit it, mm.
const UNLIKE_MM: f64 = 0.4;

/// All findings.
pub(super) fn findings(
    inputs: &Inputs<'_>,
    planes: &[PlaneWork],
    lumina: &[StageLumina],
    names: &[String],
) -> Vec<Finding> {
    let z_mm = inputs.sections.plane_z_mm();
    let stages = [Stage::Segmentation, Stage::Reconstruction, Stage::Slicing, Stage::Toolpath];
    let by_stage: Vec<Vec<Finding>> = stages
        .into_par_iter()
        .map(|stage| {
            let order = match stage {
                Stage::Segmentation => out_of_order(stage, &compared(stage, planes), &z_mm)
                    .or_else(|| seen_in_image(inputs, planes, &z_mm)),
                _ => out_of_order(stage, &compared(stage, planes), &z_mm),
            };
            let pair = pair(stage, inputs, lumina);
            // An order or a mirror image explains what else is off.
            let moved = if order.is_some() { Vec::new() } else { moved(&pair, names, &z_mm) };
            order.into_iter().chain(moved).collect()
        })
        .collect();
    let regions: Vec<Region> = planes.iter().map(|p| p.contours.region.clone()).collect();
    let is_known = |f: &Finding| {
        by_stage.iter().flatten().any(|g| g.kind == Kind::WrongPlaneOrder && g.place == f.place)
    };
    let mut findings: Vec<Finding> =
        broken_course(&regions, &z_mm).filter(|f| !is_known(f)).into_iter().collect();
    findings.extend(without_echoes(by_stage));
    let made: Vec<Made<'_>> = [Stage::Reconstruction, Stage::Slicing, Stage::Toolpath, Stage::Deposition]
        .into_iter()
        .zip(&lumina[2..])
        .map(|(stage, lumina)| Made { stage, lumina: &lumina.planes })
        .collect();
    let of_beads = deposited(inputs);
    // A lumen that is not found in a layer that is missing or was moved away is not plugged: a plug is material.
    let is_filled = |f: &Finding| {
        f.stage != Stage::Deposition.name()
            || inputs.body == BodyKind::Cast
            || of_beads
                .iter()
                .any(|g| g.kind == Kind::MaterialInLumen && meet(f.place.planes, g.place.planes))
    };
    findings.extend(plugged(&lumina[1].planes, &made, names, &z_mm).into_iter().filter(is_filled));
    // What the printer leaves or lays in a lumen, its beads tell.
    let before_print = &made[..made.len() - 1];
    findings.extend(changed_islands(&lumina[1].planes, before_print, names, &z_mm));
    findings.extend(odd_layers(inputs.layers, |layer| layer_lumen(layer, inputs.body).area_mm2()));
    if of_beads.is_empty() {
        // What no bead tells may still show in the outlines.
        findings.extend(moved(&pair(Stage::Deposition, inputs, lumina), names, &z_mm));
    }
    findings.extend(of_beads);
    let place = |f: &Finding| Stage::ALL.iter().position(|s| s.name() == f.stage).map_or(0, |i| i + 1);
    findings.sort_by_key(place);
    findings
}

fn meet(one: Option<[usize; 2]>, other: Option<[usize; 2]>) -> bool {
    one.zip(other).is_some_and(|(a, b)| a[0] <= b[1] && b[0] <= a[1])
}

fn pair<'a>(stage: Stage, inputs: &Inputs<'_>, lumina: &'a [StageLumina]) -> StagePair<'a> {
    let i = stage as usize;
    let pixel_mm = inputs.image.map_or(0.0, |i| i.volume.pixel_spacing_xy_mm.into_iter().fold(0.0, f64::max));
    let (least_mm, gate_mm) = match stage {
        Stage::Segmentation => (
            LEAST_IN_IMAGE_MM.max(LEAST_IN_IMAGE_PIXEL * pixel_mm),
            inputs.gate.outline_mm.max(0.5 * pixel_mm),
        ),
        Stage::Reconstruction | Stage::Slicing => (LEAST_EXACT_MM, inputs.gate.outline_mm),
        Stage::Toolpath | Stage::Deposition | Stage::Total | Stage::Scan => {
            (LEAST_BEADS_MM, inputs.gate.outline_mm)
        }
    };
    let meant_mm = if stage == Stage::Toolpath { compensation_mm(inputs) } else { 0.0 };
    StagePair {
        stage,
        reference: &lumina[i].planes,
        tested: &lumina[i + 1].planes,
        meant_mm,
        least_mm,
        gate_mm,
        ends_mm: if stage == Stage::Reconstruction { ends(inputs) } else { None },
    }
}

/// A solid goes on half a plane interval beyond the first and the last plane that has contours.
fn ends(inputs: &Inputs<'_>) -> Option<Ends> {
    let planes = &inputs.sections.planes;
    let holds = |k: &usize| !planes[*k].contours.is_empty();
    let first = (0..planes.len()).find(holds)?;
    let last = (0..planes.len()).rev().find(holds).filter(|last| *last > first)?;
    let z = |k: usize| planes[k].z_mm;
    let meant = [z(first) - 0.5 * (z(first + 1) - z(first)), z(last) + 0.5 * (z(last) - z(last - 1))];
    Some(Ends { found: inputs.solid.z_range_mm(), meant })
}

fn compared(stage: Stage, planes: &[PlaneWork]) -> Vec<Compared<'_>> {
    planes.iter().map(|p| sides(stage, p)).collect()
}

fn sides(stage: Stage, p: &PlaneWork) -> Compared<'_> {
    let (sliced, planned) = (p.sliced.as_ref().map(|o| &o.region), p.planned.as_ref().map(|o| &o.region));
    let (reference, tested) = match stage {
        Stage::Segmentation => (p.image.as_ref().map(ImageBoundary::region), Some(&p.contours.region)),
        Stage::Reconstruction => (Some(&p.contours.region), Some(&p.solid.region)),
        Stage::Slicing => (Some(&p.solid.region), sliced),
        _ => (sliced, planned),
    };
    Compared { reference, tested }
}

fn seen_in_image(inputs: &Inputs<'_>, planes: &[PlaneWork], z_mm: &[f64]) -> Option<Finding> {
    let image = inputs.image?;
    let fits = |p: &PlaneWork| {
        let is_found = p.image.as_ref().is_some_and(|i| 2 * i.n_found >= i.n_points);
        let mean_mm = |c: &super::deviation::Comparison| {
            c.distances_mm.iter().map(|d| d.abs()).sum::<f64>() / c.distances_mm.len().max(1) as f64
        };
        is_found && p.comparisons[Stage::Segmentation as usize].as_ref().is_ok_and(|c| mean_mm(c) < UNLIKE_MM)
    };
    let contours: Vec<&[Contour]> = inputs.sections.planes.iter().map(|p| p.contours.as_slice()).collect();
    unlike_image(&Seen {
        volume: image.volume,
        polarity: image.polarity,
        volume_planes: &planes.iter().map(|p| p.volume_plane).collect::<Vec<_>>(),
        fits: &planes.iter().map(fits).collect::<Vec<_>>(),
        contours: &contours,
        z_mm,
    })
}
