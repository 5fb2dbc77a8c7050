//! Lumina that one stage has and the next has not: where a branch was closed, and where an island in it was lost or added.

use super::outlines::{Lumina, plane_runs};
use super::{Finding, Kind, Place, Size, told};
use crate::geom::Region;
use crate::report::Stage;
use crate::slice::Layer;

/// A lumen with less than this part of the area it had is closed.
const LEAST_OPEN: f64 = 0.5;

/// Smaller islands in a lumen are none, mm².
const LEAST_ISLAND_MM2: f64 = 0.05;
/// An island is lost where the next stage has less than this part of it.
const LEAST_KEPT: f64 = 0.5;

/// One stage's lumina and the stage that made them.
#[derive(Debug, Clone, Copy)]
pub(in crate::report) struct Made<'a> {
    pub(in crate::report) stage: Stage,
    pub(in crate::report) lumina: &'a [Lumina],
}

/// Branches that are closed in planes where the stage before has them open: `first` and what was made of it in order.
pub(in crate::report) fn plugged(
    first: &[Lumina],
    made: &[Made<'_>],
    names: &[String],
    z_mm: &[f64],
) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (branch, name) in names.iter().enumerate() {
        let area = |lumina: &[Lumina], k: usize| lumina[k][branch].as_ref().map_or(0.0, Region::area_mm2);
        for (i, own) in made.iter().enumerate() {
            let before = if i == 0 { first } else { made[i - 1].lumina };
            let closed: Vec<usize> = (0..z_mm.len())
                .filter(|&k| area(before, k) > 0.0 && area(own.lumina, k) < LEAST_OPEN * area(before, k))
                .collect();
            findings.extend(plane_runs(&closed).into_iter().map(|[first, last]| {
                let open: f64 = (first..=last).map(|k| area(before, k)).sum();
                let left: f64 = (first..=last).map(|k| area(own.lumina, k)).sum();
                closed_at(own.stage, name, Place::of_planes(z_mm, first, last), 100.0 * (1.0 - left / open))
            }));
        }
    }
    findings
}

/// What lies within a lumen and is no part of it.
fn islands(lumen: &Region) -> Region {
    if lumen.contours.len() < 2 { Region::default() } else { lumen.without_holes().difference(lumen) }
}

/// Islands within the lumen (a wall between two channels, a flap) that a stage lost or added.
pub(in crate::report) fn changed_islands(
    first: &[Lumina],
    made: &[Made<'_>],
    names: &[String],
    z_mm: &[f64],
) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (branch, name) in names.iter().enumerate() {
        for (i, own) in made.iter().enumerate() {
            let before = if i == 0 { first } else { made[i - 1].lumina };
            for (kind, from, to) in
                [(Kind::IslandLost, before, own.lumina), (Kind::IslandAdded, own.lumina, before)]
            {
                let gone = |k: usize| gone_mm2(from[k][branch].as_ref()?, to[k][branch].as_ref()?);
                let areas: Vec<Option<f64>> = (0..z_mm.len()).map(gone).collect();
                let planes: Vec<usize> = (0..z_mm.len()).filter(|&k| areas[k].is_some()).collect();
                findings.extend(plane_runs(&planes).into_iter().map(|[first, last]| {
                    let most = areas[first..=last].iter().flatten().copied().fold(0.0, f64::max);
                    let place = Place { branch: Some(name.clone()), ..Place::of_planes(z_mm, first, last) };
                    island(own.stage, kind, place, most)
                }));
            }
        }
    }
    findings
}

/// The area of the islands of a lumen that another one does not have, mm²; `None` where it has them.
fn gone_mm2(lumen: &Region, other: &Region) -> Option<f64> {
    let islands = islands(lumen);
    let (all, gone) = (islands.area_mm2(), islands.intersection(other).area_mm2());
    (all > LEAST_ISLAND_MM2 && gone > (1.0 - LEAST_KEPT) * all).then_some(gone)
}

fn island(stage: Stage, kind: Kind, place: Place, area_mm2: f64) -> Finding {
    let [before, own] = stage.sides();
    let (has, has_not) = if kind == Kind::IslandLost { (before, own) } else { (own, before) };
    let text = format!(
        "{}: {has} has an island of {area_mm2:.2} mm\u{b2} within the lumen that {has_not} has not, {}, {}",
        stage.name(),
        told("plane", place.planes.unwrap_or_default()),
        place.branch.as_deref().unwrap_or_default()
    );
    Finding {
        stage: stage.name(),
        kind,
        place,
        size: Some(Size { size: area_mm2, unit: "mm2", uncertainty: 0.02 * area_mm2 }),
        vector_mm: None,
        beyond_gate: true,
        judged: true,
        text,
    }
}

fn closed_at(stage: Stage, name: &str, place: Place, percent: f64) -> Finding {
    let [before, own] = stage.sides();
    let range = place.planes.unwrap_or_default();
    let text = format!(
        "{}: {name} is plugged: {percent:.0} % of its lumen is closed in {}; {before} has it open, {own} has not",
        stage.name(),
        told("plane", range)
    );
    Finding {
        stage: stage.name(),
        kind: Kind::Plugged,
        place: Place { branch: Some(name.to_owned()), ..place },
        size: Some(Size { size: percent, unit: "percent", uncertainty: 1.0 }),
        vector_mm: None,
        beyond_gate: true,
        judged: true,
        text,
    }
}

/// Layers between CT planes whose lumen is closed or widened though both neighbours at CT planes are as the solid has them.
pub(in crate::report) fn odd_layers(layers: &[Layer], area_mm2: impl Fn(&Layer) -> f64) -> Vec<Finding> {
    let areas: Vec<f64> = layers.iter().map(&area_mm2).collect();
    let slots: Vec<_> = layers.iter().map(|l| l.slot).collect();
    let at_planes: Vec<usize> = (0..layers.len()).filter(|&i| slots[i].ct_plane.is_some()).collect();
    let expected = |i: usize| {
        let above = at_planes.partition_point(|&p| p < i);
        let (a, b) = (*at_planes.get(above.checked_sub(1)?)?, *at_planes.get(above)?);
        Some(areas[a].min(areas[b]))
    };
    let closed = |i: usize| expected(i).is_some_and(|e| e > 0.0 && areas[i] < LEAST_OPEN * e);
    let runs = super::deposition::runs(layers.len(), 1, closed);
    let finding = |[first, last]: [usize; 2]| {
        let percent = 100.0 * (1.0 - areas[first] / expected(first).unwrap_or(f64::INFINITY));
        Finding {
            stage: Stage::Slicing.name(),
            kind: Kind::Plugged,
            place: Place::of_layers(&slots, first, last),
            size: Some(Size { size: percent, unit: "percent", uncertainty: 5.0 }),
            vector_mm: None,
            beyond_gate: true,
            judged: true,
            text: format!(
                "slicing: {percent:.0} % of the lumen is closed in {}",
                told("layer", [first, last])
            ),
        }
    };
    runs.into_iter().map(finding).collect()
}
