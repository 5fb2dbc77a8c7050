//! How the material inside the perimeters is filled: solid behind floors and roofs, along the span over air, sparse elsewhere.
//!
//! - A place is solid where less than the profile's shell of material lies over or under it: some layer within that distance
//!   does not cover it. What is solid reaches a bead's pitch into the sparse fill, so that the two hold together.
//! - A place over air that is wide enough to sag is a bridge: its lines run in the direction in which most of them end on
//!   material on both sides, and of these the one with the shortest lines; they reach [`ANCHOR_MM`] onto that material.
//!   Where less than half of them would, it is no bridge but an overhang, and filled like the rest.
//!
//! What supports hold up is no bridge. A layer of sparse fill counts as material: a roof lies on its lines. Where the fill is 0 %
//! there are none, and a roof spans from wall to wall.
//! Cost: where anything is left to fill, a boolean operation for each layer within the shell.

use super::fill::{FillParams, Path};
use super::supports::{AIR_LAYERS, Support};
use super::{BeadKind, raster};
use crate::geom::{Contour, Point2, Region};
use crate::profile::Profile;
use crate::slice::Layer;
use std::f64::consts::PI;

/// Chord tolerance of the borders between the kinds of fill, mm.
const TOLERANCE_MM: f64 = 0.01;
/// How far the lines of a bridge reach onto what carries them, mm.
const ANCHOR_MM: f64 = 1.0;
/// Directions that a bridge may take.
const N_DIRECTIONS: u32 = 24;
/// Distance of the lines along which a direction is tried, mm.
const PROBE_MM: f64 = 0.5;
/// A line is carried where so far beyond its end there is material, mm.
const BEYOND_MM: f64 = 0.3;
/// Fewer lines than this share that end on material on both sides make no bridge.
const LEAST_CARRIED: f64 = 0.5;

/// Side of the smallest piece that is filled sparsely between solid ones, in widths of a bead.
const SMALLEST_SPARSE: f64 = 4.0;

/// All layers, as far as a layer's fill depends on those above and below.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stack<'a> {
    pub(super) layers: &'a [Layer],
    /// Material and lumen of each on the bed.
    pub(super) placed: &'a [(Region, Region)],
    /// Supports of each; empty where there are none at all.
    pub(super) columns: &'a [Support],
}

/// What the perimeters leave, by how it is filled.
#[derive(Debug, Default)]
pub(super) struct Interior {
    /// Each with the direction of its lines, rad.
    bridges: Vec<(Region, f64)>,
    solid: Region,
    sparse: Region,
}

impl Interior {
    /// Divides the rest of a layer. `rest_below` plans the walls of the layer below and gives what they leave: it is asked only where
    /// that matters.
    pub(super) fn of(
        rest: Region,
        idx: usize,
        stack: &Stack<'_>,
        rest_below: impl FnOnce() -> Region,
        params: &FillParams,
        profile: &Profile,
    ) -> Self {
        if rest.is_empty() {
            return Self::default();
        }
        let print = &profile.print;
        let is_open = print.infill_percent <= 0.0;
        let (rest, hollow) = if is_open {
            let open = stack.sparse(idx, &rest, params, print.shell_mm);
            let closed = rest.difference(&open);
            if closed.is_empty() {
                return Self::default();
            }
            (closed, stack.hollow_below(idx, rest_below, params, print.shell_mm))
        } else {
            (rest, Region::default())
        };
        let bridges = stack.bridges(idx, &rest, &hollow, params);
        let rest = bridges.iter().fold(rest, |rest, (bridge, _)| rest.difference(bridge));
        let sparse = if is_open || raster::is_solid(print.infill_percent) {
            Region::default()
        } else {
            stack.sparse(idx, &rest, params, print.shell_mm)
        };
        let solid = if sparse.is_empty() { rest } else { rest.difference(&sparse) };
        Self { bridges, solid, sparse }
    }

    /// The lines, bridges first; `angle_rad`: of all that are none.
    pub(super) fn paths(&self, params: &FillParams, percent: f64, angle_rad: f64) -> Vec<Path> {
        let bridge = |(region, angle): &(Region, f64)| {
            let paths = raster::raster(region, params, 100.0, *angle);
            paths.into_iter().map(|path| Path { kind: BeadKind::Bridge, ..path })
        };
        let solid = raster::raster(&self.solid, params, 100.0, angle_rad);
        let sparse = raster::raster(&self.sparse, params, percent, angle_rad);
        self.bridges.iter().flat_map(bridge).chain(solid).chain(sparse).collect()
    }
}

impl Stack<'_> {
    /// What of a layer's rest lies so deep that it is filled sparsely.
    fn sparse(&self, idx: usize, rest: &Region, params: &FillParams, shell_mm: f64) -> Region {
        let Some(exposed) = self.exposed(idx, rest, shell_mm) else { return Region::default() };
        let noise_mm = params.width_mm / 4.0;
        let core = exposed.offset(-noise_mm, TOLERANCE_MM);
        if core.is_empty() {
            return rest.clone();
        }
        let solid = core.offset(noise_mm + params.pitch_mm(), TOLERANCE_MM).intersection(rest);
        // What is left beside it in pieces too small for any line of sparse fill is solid, too.
        let mut left = rest.difference(&solid).islands();
        left.retain(|piece| piece.area_mm2() > (SMALLEST_SPARSE * params.width_mm).powi(2));
        Region::new(left.into_iter().flat_map(|piece| piece.contours).collect())
    }

    /// What the layer below leaves empty where nothing is filled sparsely. Its bridges are no matter: what spans air is no part
    /// of its depth.
    fn hollow_below(
        &self,
        idx: usize,
        rest_below: impl FnOnce() -> Region,
        params: &FillParams,
        shell_mm: f64,
    ) -> Region {
        let below = idx.checked_sub(1).filter(|&below| !self.is_near_an_end(below, shell_mm));
        below.map(|below| self.sparse(below, &rest_below(), params, shell_mm)).unwrap_or_default()
    }

    /// What of a layer has less than `shell_mm` of material over or under it; none: all of it, near an end of the part.
    fn exposed(&self, idx: usize, rest: &Region, shell_mm: f64) -> Option<Region> {
        if self.is_near_an_end(idx, shell_mm) {
            return None;
        }
        let z_mm = self.layers[idx].slot.z_mid_mm;
        let within = |j: usize| (self.layers[j].slot.z_mid_mm - z_mm).abs() <= shell_mm + 1e-9;
        let over = (idx + 1..self.layers.len()).take_while(|&j| within(j));
        let under = (0..idx).rev().take_while(|&j| within(j));
        let covered =
            over.chain(under).fold(rest.clone(), |covered, j| covered.intersection(&self.placed[j].0));
        Some(rest.difference(&covered))
    }

    /// Whether an end of the part is within `shell_mm` of a layer. Beyond its ends the part has no material: as if another layer
    /// lay there.
    fn is_near_an_end(&self, idx: usize, shell_mm: f64) -> bool {
        let z_mm = self.layers[idx].slot.z_mid_mm;
        let (first, last) = (&self.layers[0].slot, &self.layers[self.layers.len() - 1].slot);
        let (over_mm, under_mm) =
            (last.z_mid_mm + last.height_mm - z_mm, z_mm - first.z_mid_mm + first.height_mm);
        over_mm.min(under_mm) <= shell_mm + 1e-9
    }

    /// What of a layer spans air, with the direction of each span; `hollow` is empty, though it lies in the layer below.
    fn bridges(&self, idx: usize, rest: &Region, hollow: &Region, params: &FillParams) -> Vec<(Region, f64)> {
        let Some(below) = idx.checked_sub(1).map(|j| &self.placed[j].0) else { return Vec::new() };
        let below = &if hollow.is_empty() { below.clone() } else { below.difference(hollow) };
        let air = rest.difference(below);
        let held = idx.checked_sub(1 + AIR_LAYERS).and_then(|j| self.columns.get(j)).map(Support::area);
        let air = held.map_or(air.clone(), |held| air.difference(&held));
        // Narrower than two beads it does not sag.
        let wide = air.offset(-params.width_mm, TOLERANCE_MM).offset(params.width_mm, TOLERANCE_MM);
        let bridge = |span: Region| {
            let angle = direction(&span, below)?;
            Some((span.offset(ANCHOR_MM, TOLERANCE_MM).intersection(rest), angle))
        };
        wide.islands().into_iter().filter_map(bridge).collect()
    }
}

/// The direction in which lines across `span` are best carried by what is below, rad; none where too few are.
fn direction(span: &Region, below: &Region) -> Option<f64> {
    let tried = (0..N_DIRECTIONS).map(|k| {
        let angle = PI * f64::from(k) / f64::from(N_DIRECTIONS);
        let (carried, longest_mm) = carried(span, below, angle);
        (carried, longest_mm, angle)
    });
    // In steps, so that a hair more of carried lines does not win over much shorter ones.
    let key = |&(carried, longest_mm, _): &(f64, f64, f64)| (-(20.0 * carried).round(), longest_mm);
    let best = tried.min_by(|a, b| {
        let (a, b) = (key(a), key(b));
        a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1))
    })?;
    (best.0 >= LEAST_CARRIED).then_some(best.2)
}

/// Which share of the lines across `span` in a direction ends on material on both sides; the longest line, mm.
fn carried(span: &Region, below: &Region, angle_rad: f64) -> (f64, f64) {
    let turn = nalgebra::Rotation2::new(-angle_rad);
    let turned = Region::new(
        span.contours.iter().map(|c| Contour::new(c.points.iter().map(|p| turn * p).collect())).collect(),
    );
    let Some(bounds) = turned.bounds() else { return (0.0, 0.0) };
    let on_material = |x: f64, y: f64| below.contains(turn.inverse() * Point2::new(x, y));
    let (mut all, mut held, mut longest_mm) = (0.0, 0.0, 0.0f64);
    let mut y = bounds.min.y + PROBE_MM / 2.0;
    while y < bounds.max.y {
        for line in raster::spans(&turned, y) {
            let length = line.to - line.from;
            all += length;
            longest_mm = longest_mm.max(length);
            if on_material(line.from - BEYOND_MM, y) && on_material(line.to + BEYOND_MM, y) {
                held += length;
            }
        }
        y += PROBE_MM;
    }
    if all > 0.0 { (held / all, longest_mm) } else { (0.0, 0.0) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile;
    use crate::progress::Task;
    use crate::slice::LayerSlot;
    use crate::toolpath::{LayerPaths, plan};

    const HEIGHT_MM: f64 = 0.2;

    fn rectangle(x: [f64; 2], y: [f64; 2]) -> Region {
        let corners = [(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])];
        Region::new(vec![Contour::new(corners.map(|(x, y)| Point2::new(x, y)).to_vec())])
    }

    /// A stack of layers of these materials, filled by a share.
    fn printed(materials: Vec<Region>, infill_percent: f64) -> Vec<LayerPaths> {
        let slot = |i: usize| LayerSlot {
            z_mid_mm: HEIGHT_MM * (i as f64 + 0.5),
            height_mm: HEIGHT_MM,
            ct_plane: None,
        };
        let layer = |(i, material)| Layer { slot: slot(i), material, lumen: Region::default() };
        let layers: Vec<Layer> = materials.into_iter().enumerate().map(layer).collect();
        let mut profile = profile::builtin("reference").unwrap();
        profile.print.infill_percent = infill_percent;
        profile.print.perimeters = 1;
        profile.print.shell_mm = 0.8;
        plan(&layers, &profile, &Task::quiet()).unwrap().paths.layers
    }

    /// The area that the beads of a kind are to cover.
    fn area_mm2(layer: &LayerPaths, kind: BeadKind) -> f64 {
        let beads = layer.beads.iter().filter(|b| b.kind == kind);
        let segments = beads.flat_map(|b| b.points.windows(2));
        segments.map(|p| (p[1].at - p[0].at).norm() * p[0].width_mm).sum()
    }

    #[test]
    fn sparse_fill_is_closed_by_a_floor_and_a_roof_as_thick_as_the_shell() {
        let layers = printed(vec![rectangle([0.0, 24.0], [0.0, 18.0]); 20], 20.0);
        // Within one perimeter of 0.4 mm.
        let inside = 23.2 * 17.2;
        for (i, layer) in layers.iter().enumerate() {
            let [solid, sparse] =
                [BeadKind::SolidInfill, BeadKind::InternalInfill].map(|k| area_mm2(layer, k));
            if (4..16).contains(&i) {
                assert!(
                    solid == 0.0 && (0.19..0.25).contains(&(sparse / inside)),
                    "layer {i}: {solid} {sparse}"
                );
            } else {
                assert!(sparse == 0.0 && (solid / inside - 1.0).abs() < 0.02, "layer {i}: {solid} {sparse}");
            }
        }
    }

    #[test]
    fn a_roof_over_no_fill_spans_from_wall_to_wall() {
        let layers = printed(vec![rectangle([0.0, 24.0], [0.0, 18.0]); 20], 0.0);
        for (i, layer) in layers.iter().enumerate() {
            let [bridge, solid, sparse] = [BeadKind::Bridge, BeadKind::SolidInfill, BeadKind::InternalInfill]
                .map(|kind| area_mm2(layer, kind));
            // Within one perimeter of 0.4 mm; the lowest layer of the roof is a bridge, with its anchors all of it.
            let inside = 23.2 * 17.2;
            let is_roof = |filled: f64| (filled / inside - 1.0).abs() < 0.02;
            match i {
                4..16 => assert!(bridge + solid + sparse == 0.0, "layer {i}: {bridge} {solid} {sparse}"),
                16 => assert!(is_roof(bridge) && solid < 0.02 * inside, "layer {i}: {bridge} {solid}"),
                _ => assert!(bridge == 0.0 && is_roof(solid), "layer {i}: {bridge} {solid}"),
            }
        }
        // Across the shorter side.
        let lines = layers[16].beads.iter().filter(|b| b.kind == BeadKind::Bridge);
        let longest = lines.flat_map(|b| b.points.windows(2)).map(|p| p[1].at - p[0].at);
        assert!(longest.filter(|way| way.norm() > 1.0).all(|way| way.x.abs() < 1e-6 && way.y.abs() > 16.0));
    }

    #[test]
    fn the_walls_below_are_planned_again_only_under_a_roof_over_no_fill() {
        let slot = |i: usize| LayerSlot {
            z_mid_mm: HEIGHT_MM * (i as f64 + 0.5),
            height_mm: HEIGHT_MM,
            ct_plane: None,
        };
        let material = rectangle([0.0, 24.0], [0.0, 18.0]);
        let layers: Vec<Layer> = (0..20)
            .map(|i| Layer { slot: slot(i), material: material.clone(), lumen: Region::default() })
            .collect();
        let placed: Vec<(Region, Region)> = vec![(material, Region::default()); 20];
        let stack = Stack { layers: &layers, placed: &placed, columns: &[] };
        let mut profile = profile::builtin("reference").unwrap();
        (profile.print.infill_percent, profile.print.shell_mm) = (0.0, 0.8);
        let params = crate::toolpath::fill_params(&profile, HEIGHT_MM);
        let rest = rectangle([0.4, 23.6], [0.4, 17.6]);
        let asked = |idx: usize| {
            let asked = std::cell::Cell::new(false);
            let below = || {
                asked.set(true);
                rest.clone()
            };
            Interior::of(rest.clone(), idx, &stack, below, &params, &profile);
            asked.get()
        };
        assert_eq!((0..20).filter(|idx| asked(*idx)).collect::<Vec<_>>(), [16]);
    }

    #[test]
    fn a_ledge_has_a_roof_of_its_own_area() {
        let (wide, narrow) = (rectangle([0.0, 30.0], [0.0, 20.0]), rectangle([0.0, 20.0], [0.0, 20.0]));
        let layers = printed([vec![wide; 12], vec![narrow; 12]].concat(), 25.0);
        for (i, layer) in layers.iter().enumerate().take(12).skip(8) {
            // From the step at 20 mm, and a pitch beyond it, to the perimeter.
            let (roof, beside) = ((29.6 - 20.0 + 0.4) * 19.2, (20.0 - 0.4 - 0.4) * 19.2);
            let solid = area_mm2(layer, BeadKind::SolidInfill);
            let sparse = area_mm2(layer, BeadKind::InternalInfill);
            assert!((solid / roof - 1.0).abs() < 0.02, "layer {i}: {solid} of {roof}");
            // The lines and what joins them at their ends.
            assert!((0.24..0.3).contains(&(sparse / beside)), "layer {i}: {sparse} of {beside}");
        }
        let within = &layers[6];
        assert!(area_mm2(within, BeadKind::SolidInfill) == 0.0);
    }

    #[test]
    fn a_span_over_air_is_bridged_from_side_to_side() {
        // Two piers 12 mm apart, a slab upon them; across, and turned by a right angle.
        for turned in [false, true] {
            let at = |x: [f64; 2], y: [f64; 2]| if turned { rectangle(y, x) } else { rectangle(x, y) };
            let piers = at([0.0, 6.0], [0.0, 20.0]).union(&at([18.0, 24.0], [0.0, 20.0]));
            let slab = at([0.0, 24.0], [0.0, 20.0]);
            let layers = printed([vec![piers; 6], vec![slab; 3]].concat(), 100.0);
            assert!(
                layers.iter().enumerate().all(|(i, l)| (area_mm2(l, BeadKind::Bridge) > 0.0) == (i == 6))
            );
            // The span and its anchors on both sides, within one perimeter.
            let expected = (12.0 + 2.0 * ANCHOR_MM) * 19.2;
            let bridge = area_mm2(&layers[6], BeadKind::Bridge);
            assert!((bridge / expected - 1.0).abs() < 0.03, "{bridge} of {expected}");
            let beads = layers[6].beads.iter().filter(|b| b.kind == BeadKind::Bridge);
            for pair in beads.flat_map(|b| b.points.windows(2)) {
                let along = pair[1].at - pair[0].at;
                let (across, aside) = if turned { (along.y, along.x) } else { (along.x, along.y) };
                let is_joint = across.abs() < 0.1 && aside.abs() < 0.5;
                assert!(is_joint || (across.abs() > 13.0 && aside.abs() < 2e-3), "{along:?}");
            }
        }
    }

    #[test]
    fn an_overhang_that_nothing_carries_on_its_other_side_is_no_bridge() {
        let (narrow, wide) = (rectangle([0.0, 10.0], [0.0, 20.0]), rectangle([0.0, 16.0], [0.0, 20.0]));
        let layers = printed([vec![narrow; 6], vec![wide; 3]].concat(), 100.0);
        assert!(layers.iter().all(|l| area_mm2(l, BeadKind::Bridge) == 0.0));
    }
}
