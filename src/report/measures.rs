//! Walls and volumes from the work of the comparison.

use super::amounts::{Amounts, lumen_volume};
use super::faults::volumes_mm3;
use super::scan::{Scanned, ScannedPlane};
use super::stages::{LayerWork, Lumen, PlaneWork, STAGES, layer_lumen, layer_of};
use super::thickness::{self, WallStage};
use super::{BodyKind, Inputs};
use crate::geom::Region;
use crate::slice::Layer;
use rayon::prelude::*;

/// The wall of every stage that has one.
pub(super) fn walls(
    inputs: &Inputs<'_>,
    planes: &[PlaneWork],
    layers: &[LayerWork],
    scanned: Option<&Scanned<'_>>,
    place_mm: &dyn Fn(&str) -> Option<f64>,
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
        thickness::stage(name, &planes.par_iter().map(plane).collect::<Vec<_>>(), place_mm(name))
    };
    let of_scan = |s: &Scanned<'_>| {
        let plane = |(own, p): (&ScannedPlane, &PlaneWork)| {
            let near = p.section.outer.union(&p.section.lumen);
            let touches = |island: &Region| island.intersection(&near).area_mm2() > 0.0;
            let islands = own.material.islands().into_iter().filter(touches).collect::<Vec<_>>();
            (!own.lumen.is_empty()).then(|| thickness::measured(&own.lumen, &Region::union_all(&islands)))
        };
        let name = "scanned";
        thickness::stage(
            name,
            &s.planes.par_iter().zip(planes).map(plane).collect::<Vec<_>>(),
            place_mm(name),
        )
    };
    let read = scanned.filter(|s| !s.planes.is_empty());
    sides.iter().map(of).chain(read.map(of_scan)).collect()
}

pub(super) fn amounts(inputs: &Inputs<'_>, planes: &[PlaneWork], scanned: Option<&Scanned<'_>>) -> Amounts {
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
