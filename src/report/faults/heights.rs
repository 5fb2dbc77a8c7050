//! Recorded segments to the layers that they print, by height; where heights are off, by the order of the layers.
//!
//! Normally a segment belongs to the layer at whose height it lies. Where much lies at no layer's height, or layers seem to be
//! missing though as many were printed as planned (the axis lost steps, or its scale is wrong), the recorded heights
//! are matched to the layers in their order, and what they rise too much is told layer by layer.

use super::super::record::{Record, Segment};
use crate::geom::Bounds2;
use crate::toolpath::{LayerPaths, Toolpaths};
use std::collections::BTreeMap;

/// Segments farther than this from the whole job are no part of it, mm.
const ELSEWHERE_MM: f64 = 10.0;
/// Heights are told apart in steps of this, mm.
const STEP_MM: f64 = 0.01;
/// A height with less than this part of a usual layer's material is no layer.
const LEAST_LAYER: f64 = 0.05;
/// Up to this part of the material may lie between the layers before heights are doubted.
const MOST_STRAY: f64 = 0.01;

/// Recorded segments, layer by layer.
#[derive(Debug, Default)]
pub(super) struct Aligned<'a> {
    pub(super) of_layer: Vec<Vec<&'a Segment>>,
    /// How much higher than planned each layer lies, mm; `None` where nothing was recorded.
    pub(super) rise_mm: Vec<Option<f64>>,
    /// Material at heights of no layer, mm³.
    pub(super) stray_mm3: f64,
}

/// Gives every segment near the job to a layer.
pub(super) fn align<'a>(paths: &Toolpaths, record: &'a Record) -> Aligned<'a> {
    let near = near_segments(paths, record);
    let levels = levels(&near);
    let own = |level: i64| layer_at(&paths.layers, level as f64 * STEP_MM);
    let direct: BTreeMap<i64, usize> = levels.keys().filter_map(|&l| Some((l, own(l)?))).collect();
    let volume: f64 = levels.values().sum();
    let stray: f64 = levels.iter().filter(|(l, _)| !direct.contains_key(l)).map(|(_, v)| v).sum();
    let printed = strong(&levels);
    let planned: Vec<usize> =
        (0..paths.layers.len()).filter(|&i| !paths.layers[i].beads.is_empty()).collect();
    let is_missing = |i: &usize| !printed.iter().any(|l| direct.get(l) == Some(i));
    let layer_of = if stray > MOST_STRAY * volume
        || (printed.len() == planned.len() && planned.iter().any(is_missing))
    {
        in_order(&paths.layers, &planned, &printed)
    } else {
        direct
    };
    collect(paths, &near, &layer_of)
}

pub(super) fn near_segments<'a>(paths: &Toolpaths, record: &'a Record) -> Vec<&'a Segment> {
    let points = paths.layers.iter().flat_map(|l| &l.beads).flat_map(|b| b.points.iter().map(|p| p.at));
    let Some(around) = Bounds2::of(points).map(|b| b.grown(ELSEWHERE_MM)) else { return Vec::new() };
    let is_near = |s: &&Segment| around.contains(s.from.xy()) || around.contains(s.to.xy());
    record.segments.iter().filter(is_near).collect()
}

fn level(segment: &Segment) -> i64 {
    #[expect(clippy::cast_possible_truncation, reason = "coordinates of a record are below 10 m")]
    let level = (0.5 * (segment.from.z + segment.to.z) / STEP_MM).round() as i64;
    level
}

/// Material at each height, mm³.
fn levels(segments: &[&Segment]) -> BTreeMap<i64, f64> {
    let mut levels = BTreeMap::new();
    for segment in segments {
        *levels.entry(level(segment)).or_insert(0.0) += segment.volume_mm3;
    }
    levels
}

/// The heights that hold a layer's worth of material, upward.
fn strong(levels: &BTreeMap<i64, f64>) -> Vec<i64> {
    let usual = super::super::image::median(levels.values().copied()).unwrap_or(0.0);
    levels.iter().filter(|(_, v)| **v >= LEAST_LAYER * usual).map(|(l, _)| *l).collect()
}

/// The layer whose nozzle height is nearest, within a quarter of its height.
fn layer_at(layers: &[LayerPaths], z_mm: f64) -> Option<usize> {
    let nearest = nearest(layers, z_mm)?;
    let off_mm = (layers[nearest].z_mm - z_mm).abs();
    (off_mm <= 0.25 * layers[nearest].slot.height_mm + STEP_MM).then_some(nearest)
}

fn nearest(layers: &[LayerPaths], z_mm: f64) -> Option<usize> {
    let above = layers.partition_point(|l| l.z_mm < z_mm);
    let off_mm = |i: usize| (layers[i].z_mm - z_mm).abs();
    (above.saturating_sub(1)..(above + 1).min(layers.len())).min_by(|&a, &b| off_mm(a).total_cmp(&off_mm(b)))
}

/// Heights to layers in their order: one by one where there are as many, else each to the layer nearest to where
/// the one before it leads to expect it.
fn in_order(layers: &[LayerPaths], planned: &[usize], printed: &[i64]) -> BTreeMap<i64, usize> {
    if planned.len() == printed.len() {
        return printed.iter().copied().zip(planned.iter().copied()).collect();
    }
    let mut rise_mm = 0.0;
    let mut next = 0;
    let mut layer_of = BTreeMap::new();
    for &level in printed {
        let z_mm = level as f64 * STEP_MM;
        let Some(layer) = nearest(layers, z_mm - rise_mm).filter(|&l| l >= next) else { continue };
        (rise_mm, next) = (z_mm - layers[layer].z_mm, layer + 1);
        layer_of.insert(level, layer);
    }
    layer_of
}

fn collect<'a>(paths: &Toolpaths, near: &[&'a Segment], layer_of: &BTreeMap<i64, usize>) -> Aligned<'a> {
    let n = paths.layers.len();
    let mut aligned = Aligned { of_layer: vec![Vec::new(); n], rise_mm: vec![None; n], stray_mm3: 0.0 };
    for segment in near {
        match layer_of.get(&level(segment)) {
            Some(&layer) => aligned.of_layer[layer].push(segment),
            None => aligned.stray_mm3 += segment.volume_mm3,
        }
    }
    for (i, own) in aligned.of_layer.iter().enumerate() {
        let length: f64 = own.iter().map(|s| s.volume_mm3).sum();
        let height: f64 = own.iter().map(|s| s.volume_mm3 * 0.5 * (s.from.z + s.to.z)).sum();
        aligned.rise_mm[i] = (length > 0.0).then(|| height / length - paths.layers[i].z_mm);
    }
    aligned
}
