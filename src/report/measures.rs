//! Walls, volumes and uncertainties from the work of the comparison.

use super::amounts::{Amounts, lumen_volume};
use super::course::DIVISION_MM;
use super::deviation::STEP_MM;
use super::faults::volumes_mm3;
use super::image::median;
use super::scan::{Scanned, ScannedPlane};
use super::stages::{LayerWork, Lumen, PlaneWork, SECTION_TOLERANCE_MM, STAGES, layer_lumen, layer_of};
use super::strokes;
use super::thickness::{self, WallStage};
use super::{BodyKind, Inputs, Stage, Uncertainty};
use crate::geom::Region;
use crate::slice::Layer;
use rayon::prelude::*;

/// How the further figures came about: name and text.
pub(super) const METHODS: [(&str, &str); 7] = [
    (
        "Defects",
        "Recorded beads are laid over the planned ones of their layer (lengths and moments; where these differ, a robust fit of shift, turn and scale), outlines over those of the stage before (offset and shift, robust; one similarity of all planes first). Series over layers and planes are cut where they jump. Sizes carry a standard uncertainty. Nothing of it changes the figures.",
    ),
    (
        "Largest diameter",
        "Largest distance of two points of the lumen in the CT plane; exact on the outline's polygon.",
    ),
    (
        "Centreline and tortuosity",
        "Through the centroids in the CT planes, by cubics with the slopes of the polynomial through five planes; length by Gauss's rule. Tortuosity is length over chord minus one.",
    ),
    (
        "Divisions",
        "Height at which the section of the solid falls apart, by bisection to 0.001 mm; place: the middle between the nearest points of both pieces. Angles between the straight lines that fit the first 10 mm of each centreline best.",
    ),
    (
        "Wall",
        "From places 0.1 mm apart along the lumen the exact distance to the outline of the whole part, in the plane: more than the thickness in space where the wall stands obliquely. Filled: material over all between the outlines.",
    ),
    (
        "Scan of the replica",
        "Where one was given. The bright body of the model's volume, its surface half-way between air and material (levels and blur from profiles across the outer skin), laid over the model by a rigid fit along the normals, weighted by Tukey's function: principal axes with every sign and turns about them as starts; the mirror image is tried only to be told. The scan is read at the CT planes (trilinear); what blur draws inward is undone as for the image. Scale is measured and not taken away. No other stage rests on it.",
    ),
    (
        "Volumes",
        "Lumen: areas in the CT planes integrated by cubics; its uncertainty is half of what leaving out every second plane changes. Layers: area times height. Material: cross-section of the beads times length; recorded: the record's own volumes.",
    ),
];

/// The wall of every stage that has one.
pub(super) fn walls(
    inputs: &Inputs<'_>,
    planes: &[PlaneWork],
    layers: &[LayerWork],
    scanned: Option<&Scanned>,
) -> Vec<WallStage> {
    if inputs.body == BodyKind::Cast {
        return Vec::new();
    }
    type Sides =
        for<'a> fn(&'a PlaneWork, Option<&'a Layer>, Option<&'a [Region; 2]>) -> Option<[&'a Region; 2]>;
    let sides: [(&'static str, Sides); 4] = [
        ("solid", |p, _, _| Some([&p.solid.region, &p.section.outer])),
        ("layers", |_, layer, _| layer.map(|l| [&l.lumen, &l.material])),
        ("planned", |p, _, beads| Some([&p.planned.as_ref()?.region, &beads?[0]])),
        ("recorded", |p, _, beads| Some([&p.recorded.as_ref()?.region, &beads?[1]])),
    ];
    let of = |(name, sides): &(&'static str, Sides)| {
        let plane = |p: &PlaneWork| {
            let layer = p.layer_idx.and_then(|i| layer_of(inputs, &inputs.paths.layers[i]));
            let beads = p.layer_idx.and_then(|i| layers[i].beads.as_ref());
            let [lumen, material] = sides(p, layer, beads)?;
            (!lumen.is_empty()).then(|| thickness::measured(lumen, material))
        };
        thickness::stage(name, &planes.par_iter().map(plane).collect::<Vec<_>>())
    };
    let of_scan = |s: &Scanned| {
        let plane = |(own, p): (&ScannedPlane, &PlaneWork)| {
            let near = p.section.outer.union(&p.section.lumen);
            let touches = |island: &Region| island.intersection(&near).area_mm2() > 0.0;
            let islands = own.material.islands().into_iter().filter(touches).collect::<Vec<_>>();
            (!own.lumen.is_empty()).then(|| thickness::measured(&own.lumen, &Region::union_all(&islands)))
        };
        thickness::stage("scanned", &s.planes.par_iter().zip(planes).map(plane).collect::<Vec<_>>())
    };
    let read = scanned.filter(|s| !s.planes.is_empty());
    sides.iter().map(of).chain(read.map(of_scan)).collect()
}

pub(super) fn amounts(inputs: &Inputs<'_>, planes: &[PlaneWork], scanned: Option<&Scanned>) -> Amounts {
    let z_mm = inputs.sections.plane_z_mm();
    let volume = |stage: &'static str, get: Lumen| {
        let areas = planes.iter().map(|p| get(p).filter(|r| !r.is_empty()).map(Region::area_mm2));
        lumen_volume(stage, &z_mm, &areas.collect::<Vec<_>>())
    };
    let of_scan = scanned.filter(|s| !s.planes.is_empty()).map(|s| {
        let areas = s.planes.iter().map(|p| (!p.lumen.is_empty()).then(|| p.lumen.area_mm2()));
        lumen_volume("scanned", &z_mm, &areas.collect::<Vec<_>>())
    });
    let [planned_mm3, recorded_mm3] = volumes_mm3(inputs);
    Amounts {
        lumen: STAGES.map(|(stage, get)| volume(stage, get)).into_iter().chain(of_scan).collect(),
        layers_mm3: Some(
            inputs.layers.iter().map(|l| layer_lumen(l, inputs.body).area_mm2() * l.slot.height_mm).sum(),
        ),
        planned_material_mm3: Some(planned_mm3),
        recorded_material_mm3: Some(recorded_mm3),
        job: inputs.job,
    }
}

/// The local scatter of the boundary in the image: contours that follow it are off by it, wherever they lie on average.
pub(super) fn uncertainty(planes: &[PlaneWork]) -> Uncertainty {
    let scatter =
        planes.iter().filter_map(|p| p.comparisons[Stage::Segmentation as usize].as_ref().ok()).map(|c| {
            let n = c.distances_mm.len().max(1) as f64;
            let mean = c.distances_mm.iter().sum::<f64>() / n;
            (c.distances_mm.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / n).sqrt()
        });
    Uncertainty {
        image_place: median(scatter),
        sampling: STEP_MM,
        section: SECTION_TOLERANCE_MM,
        grid: 1e-5,
        bead: strokes::ARC_MM,
        division: DIVISION_MM,
    }
}
