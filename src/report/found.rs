//! What the comparison has, handed to the detectors of defects; what they find, put into the order of the work.

use super::anatomy::StageLumina;
use super::faults::{
    Allowed, BrokenCourse, Compared, Ends, Finding, Kind, Made, Seen, StagePair, broken_course, calibres,
    changed_islands, deposited, moved, odd_layers, out_of_order, plugged, stretches, unlike, unlike_image,
    without_echoes,
};
use super::image::ImageBoundary;
use super::stages::{PlaneWork, compensation_mm, layer_lumen};
use super::{BodyKind, Inputs, Stage};
use crate::ct::Warning;
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

/// All findings, and what must be looked at because it is not sure.
pub(super) fn findings(
    inputs: &Inputs<'_>,
    planes: &[PlaneWork],
    lumina: &[StageLumina],
    names: &[String],
) -> (Vec<Finding>, Option<Warning>) {
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
    let broken = broken(inputs, planes, &regions, &z_mm).filter(|b| !is_known(&b.finding));
    let (mut findings, unsure) = match broken {
        Some(BrokenCourse { finding, is_sure: true }) => (vec![finding], None),
        Some(BrokenCourse { finding, .. }) => (Vec::new(), Some(to_look_at(&finding))),
        None => (Vec::new(), None),
    };
    let mut echoed: Vec<Vec<Finding>> = by_stage.clone();
    findings.extend(without_echoes(by_stage));
    let made: Vec<Made<'_>> = [Stage::Reconstruction, Stage::Slicing, Stage::Toolpath, Stage::Deposition]
        .into_iter()
        .zip(&lumina[2..])
        .map(|(stage, lumina)| Made { stage, lumina: &lumina.planes })
        .collect();
    let of_job = changed_job(inputs);
    let is_of_job =
        |f: &Finding| of_job.iter().any(|g| g.kind == f.kind && meet(f.place.layers, g.place.layers));
    let of_beads: Vec<Finding> = deposited(inputs).into_iter().filter(|f| !is_of_job(f)).collect();
    // A lumen that is not found in a layer that is missing or was moved away is not plugged: a plug is material.
    let is_filled = |f: &Finding| {
        f.stage != Stage::Deposition.name()
            || inputs.body == BodyKind::Cast
            || of_beads
                .iter()
                .any(|g| g.kind == Kind::MaterialInLumen && meet(f.place.planes, g.place.planes))
    };
    let mut of_lumina: Vec<Finding> =
        plugged(&lumina[1].planes, &made, names, &z_mm).into_iter().filter(is_filled).collect();
    // What the printer leaves or lays in a lumen, its beads tell.
    let before_print = &made[..made.len() - 1];
    of_lumina.extend(changed_islands(&lumina[1].planes, before_print, names, &z_mm));
    for (known, stage) in echoed.iter_mut().zip(stages) {
        known.extend(of_lumina.iter().filter(|f| f.stage == stage.name()).cloned());
        *known = local(&pair(stage, inputs, lumina), inputs, planes, names, known);
    }
    findings.extend(without_echoes(echoed));
    findings.extend(of_lumina);
    findings.extend(odd_layers(inputs.layers, |layer| layer_lumen(layer, inputs.body).area_mm2()));
    if of_beads.is_empty() && of_job.is_empty() {
        // What no bead tells may still show in the outlines.
        findings.extend(moved(&pair(Stage::Deposition, inputs, lumina), names, &z_mm));
    }
    findings.extend(of_job);
    findings.extend(of_beads);
    let place = |f: &Finding| Stage::ALL.iter().position(|s| s.name() == f.stage).map_or(0, |i| i + 1);
    findings.sort_by_key(place);
    (findings, unsure)
}

/// What the job's file has otherwise than the plan that it was written from.
fn changed_job(inputs: &Inputs<'_>) -> Vec<Finding> {
    let Some(beads) = inputs.job_beads else { return Vec::new() };
    let of_file = |f: Finding| Finding {
        stage: Stage::Toolpath.name(),
        text: format!(
            "toolpath: the job's file is not what was sliced, the printer only followed it: {}",
            f.text
        ),
        ..f
    };
    deposited(&Inputs { record: beads, ..*inputs }).into_iter().map(of_file).collect()
}

/// Where the vessel's course breaks; the image, where there is one, has a say.
fn broken(
    inputs: &Inputs<'_>,
    planes: &[PlaneWork],
    regions: &[Region],
    z_mm: &[f64],
) -> Option<BrokenCourse> {
    let volume_planes: Vec<Option<usize>> = planes.iter().map(|p| p.volume_plane).collect();
    match inputs.image {
        Some(image) => {
            let of_image = |a: usize, b: usize| unlike(image.volume, &volume_planes, regions, [a, b]);
            broken_course(regions, z_mm, Some(&of_image))
        }
        None => broken_course(regions, z_mm, None),
    }
}

fn to_look_at(finding: &Finding) -> Warning {
    let text = format!(
        "It is not sure, and no defect of the verdict: look at the order of the planes. {}.",
        finding.text
    );
    Warning { code: "report.plane_order".into(), text }
}

/// What a part of an outline tells, and the calibre; `known` is what else was found in the stage.
fn local(
    pair: &StagePair<'_>,
    inputs: &Inputs<'_>,
    planes: &[PlaneWork],
    names: &[String],
    known: &[Finding],
) -> Vec<Finding> {
    let of_image = pair.stage == Stage::Segmentation;
    let allowed = Allowed {
        outline_mm: inputs.gate.outline_mm,
        diameter_percent: inputs.gate.diameter_percent,
        pixel_mm: if of_image { pixel_mm(inputs) } else { 0.0 },
    };
    let z_mm = inputs.sections.plane_z_mm();
    let compared: Vec<_> = planes.iter().map(|p| p.comparisons[pair.stage as usize].as_ref().ok()).collect();
    let mut found = stretches(pair, &compared, &z_mm, allowed, known);
    found.extend(calibres(pair, names, &compared, &z_mm, allowed, known));
    found
}

fn pixel_mm(inputs: &Inputs<'_>) -> f64 {
    inputs.image.map_or(0.0, |i| i.volume.pixel_spacing_xy_mm.into_iter().fold(0.0, f64::max))
}

fn meet(one: Option<[usize; 2]>, other: Option<[usize; 2]>) -> bool {
    one.zip(other).is_some_and(|(a, b)| a[0] <= b[1] && b[0] <= a[1])
}

fn pair<'a>(stage: Stage, inputs: &Inputs<'_>, lumina: &'a [StageLumina]) -> StagePair<'a> {
    let i = stage as usize;
    let pixel_mm = pixel_mm(inputs);
    let (least_mm, told_mm) = match stage {
        Stage::Segmentation => (LEAST_IN_IMAGE_MM.max(LEAST_IN_IMAGE_PIXEL * pixel_mm), 0.5 * pixel_mm),
        Stage::Reconstruction | Stage::Slicing => (LEAST_EXACT_MM, 0.0),
        Stage::Toolpath | Stage::Deposition | Stage::Total | Stage::Scan => (LEAST_BEADS_MM, 0.0),
    };
    let meant_mm = if stage == Stage::Toolpath { compensation_mm(inputs) } else { 0.0 };
    StagePair {
        stage,
        reference: &lumina[i].planes,
        tested: &lumina[i + 1].planes,
        meant_mm,
        least_mm,
        gate_mm: inputs.gate.outline_mm,
        gate_percent: None,
        told_mm,
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
