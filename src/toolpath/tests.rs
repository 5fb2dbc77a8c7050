//! Beads against the material they are to fill, on bodies with closed forms.

mod seams;

use super::*;
use crate::gcode;
use crate::geom::Contour;
use crate::profile;
use crate::progress::CancelToken;
use crate::slice::analytic::{Tube, Tubes};
use crate::slice::{GridParams, grid, slice_solid};
use crate::solid::Sectioned;
use proptest::prelude::*;

/// Grid step of the comparison, mm.
const STEP_MM: f64 = 0.02;

fn reference() -> Profile {
    profile::builtin("reference").unwrap()
}

fn layers_of(body: &dyn Sectioned) -> Vec<Layer> {
    let params = GridParams { layer_mm: 0.2, height_limits_mm: [0.05, 0.32] };
    let [low, high] = body.z_range_mm();
    let planes: Vec<f64> = (0..).map(|k| low + 1.5 + 3.0 * f64::from(k)).take_while(|&z| z < high).collect();
    let grid = grid(&planes, [low, high], &params).unwrap();
    slice_solid(body, &grid, 1e-3, &Task::quiet()).unwrap()
}

fn planned(body: &dyn Sectioned, profile: &Profile) -> Planned {
    plan(&layers_of(body), profile, &Task::quiet()).unwrap()
}

/// How a layer's beads cover its material.
#[derive(Debug)]
struct Cover {
    iou: f64,
    overlap: f64,
    gap: f64,
    volume_ratio: f64,
}

#[expect(clippy::cast_possible_truncation, reason = "cells of a small grid")]
fn cell(steps: f64) -> usize {
    steps.max(0.0) as usize
}

/// Rasterises capsules of each segment's width, as the outside check does.
fn cover(layer: &LayerPaths, profile: &Profile) -> Cover {
    let bounds = layer.material.bounds().unwrap().grown(0.3);
    let size = bounds.size() / STEP_MM;
    let (n_cols, n_rows) = (cell(size.x) + 1, cell(size.y) + 1);
    let centre = |col: usize, row: usize| {
        bounds.min + nalgebra::Vector2::new(col as f64 + 0.5, row as f64 + 0.5) * STEP_MM
    };
    let mut count = vec![0u8; n_cols * n_rows];
    for bead in layer.beads.iter().filter(|b| b.kind != BeadKind::SkirtBrim) {
        let mut own = vec![false; n_cols * n_rows];
        for pair in bead.points.windows(2) {
            let (a, b, radius) = (pair[0].at, pair[1].at, pair[0].width_mm / 2.0);
            let low = (a.coords.inf(&b.coords) - bounds.min.coords).add_scalar(-radius) / STEP_MM;
            let high = (a.coords.sup(&b.coords) - bounds.min.coords).add_scalar(radius) / STEP_MM;
            for row in cell(low.y)..=cell(high.y).min(n_rows - 1) {
                for col in cell(low.x)..=cell(high.x).min(n_cols - 1) {
                    let p = centre(col, row);
                    let foot = crate::geom::distance::nearest_on_segment(p, a, b);
                    own[row * n_cols + col] |= (foot - p).norm() <= radius;
                }
            }
        }
        count.iter_mut().zip(own).for_each(|(c, o)| *c += u8::from(o));
    }
    let index = crate::geom::SegmentIndex::try_new(&layer.material.contours).unwrap();
    let (mut both, mut either, mut covered, mut wanted, mut twice) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for row in 0..n_rows {
        for col in 0..n_cols {
            let (c, m) = (count[row * n_cols + col], index.contains(centre(col, row)));
            both += f64::from(u8::from(c > 0 && m));
            either += f64::from(u8::from(c > 0 || m));
            covered += f64::from(u8::from(c > 0));
            wanted += f64::from(u8::from(m));
            twice += f64::from(u8::from(c > 1));
        }
    }
    let volume = gcode::volume_mm3(layer, profile);
    // Beads of rounded sides leave half of their overlap at a skin.
    let perimeter_mm: f64 = layer.material.contours.iter().map(Contour::perimeter_mm).sum();
    let model = BeadModel::new(profile.print.bead_shape, layer.slot.height_mm);
    let filled_mm2 = layer.material.area_mm2() - perimeter_mm * model.overlap_mm() / 2.0;
    Cover {
        iou: both / either,
        overlap: twice / covered,
        gap: 1.0 - both / wanted,
        volume_ratio: volume / (filled_mm2 * layer.slot.height_mm),
    }
}

#[test]
fn ring_is_filled_without_gap_and_overlap() {
    let profile = reference();
    let planned = planned(&Tubes::new(vec![Tube::upright(0.0, 3.0)], 1.0, [0.0, 1.0]), &profile);
    assert!(planned.warnings.is_empty(), "{:?}", planned.warnings);
    for layer in &planned.paths.layers {
        let cover = cover(layer, &profile);
        assert!(cover.iou > 0.997 && cover.overlap < 0.005 && cover.gap < 0.002, "{cover:?}");
        assert!((cover.volume_ratio - 1.0).abs() < 0.003, "{cover:?}");
    }
}

#[test]
fn slanted_wall_of_varying_thickness_is_filled() {
    let profile = reference();
    let tubes = vec![Tube { slope: [0.8, 0.0], ..Tube::upright(0.0, 3.0) }];
    let mut layers = layers_of(&Tubes::new(tubes, 1.0, [0.0, 1.0]));
    // The lumen moved off the centre: 0.7 to 1.5 mm.
    for layer in &mut layers {
        let outer = Contour::circle(Point2::new(0.4, 0.0), 4.1, 150);
        let inner = Contour::circle(Point2::new(0.0, 0.0), 3.0, 130);
        layer.material = Region::new(vec![outer, inner.reversed()]);
        layer.lumen = Region::new(vec![inner]);
    }
    let planned = plan(&layers, &profile, &Task::quiet()).unwrap();
    for layer in &planned.paths.layers {
        let cover = cover(layer, &profile);
        assert!(cover.iou > 0.997 && cover.overlap < 0.005 && cover.gap < 0.002, "{cover:?}");
        assert!((cover.volume_ratio - 1.0).abs() < 0.003, "{cover:?}");
    }
}

#[test]
fn merging_tubes_are_filled_at_every_height() {
    let profile = reference();
    let planned = planned(&Tubes::merging([0.0, 20.0]), &profile);
    let covers: Vec<Cover> = planned.paths.layers.iter().step_by(4).map(|l| cover(l, &profile)).collect();
    let mean = covers.iter().map(|c| c.iou).sum::<f64>() / covers.len() as f64;
    let worst = covers.iter().map(|c| c.iou).fold(1.0, f64::min);
    assert!(mean > 0.99 && worst > 0.97, "mean {mean}, worst {worst}");
}

#[test]
fn cast_is_filled_by_perimeters_and_raster() {
    let profile = reference();
    let planned = planned(&Tubes::new(vec![Tube::upright(0.0, 4.0)], 0.0, [0.0, 1.0]), &profile);
    for layer in &planned.paths.layers {
        let cover = cover(layer, &profile);
        assert!(cover.iou > 0.985 && cover.gap < 0.015 && cover.overlap < 0.006, "{cover:?}");
        assert!((cover.volume_ratio - 1.0).abs() < 0.001, "{cover:?}");
        assert!(layer.beads.iter().any(|b| b.kind == BeadKind::SolidInfill));
    }
    let angle = |l: &LayerPaths| {
        let raster = l.beads.iter().find(|b| b.kind == BeadKind::SolidInfill).unwrap();
        let along = raster.points[3].at - raster.points[2].at;
        along.x * along.y > 0.0
    };
    assert_ne!(angle(&planned.paths.layers[0]), angle(&planned.paths.layers[1]));
}

#[test]
fn rings_are_filled_where_the_number_of_beads_changes() {
    for (inner, wall, shift_mm) in
        [(3.0, 1.0, 0.25), (3.0, 1.0, 0.35), (3.0, 1.6, 0.8), (3.0, 2.2, 0.5), (3.0, 2.5, 0.6)]
    {
        let cover = ring_cover(inner, wall, shift_mm / wall);
        let found = format!("{inner} {wall} {shift_mm}: {cover:?}");
        assert!(cover.iou > 0.997 && cover.overlap < 0.005 && cover.gap < 0.002, "{found}");
        assert!((cover.volume_ratio - 1.0).abs() < 0.003, "{found}");
    }
}

#[test]
fn thin_wall_gets_one_bead_in_its_middle() {
    let profile = reference();
    let planned = planned(&Tubes::new(vec![Tube::upright(0.0, 3.0)], 0.5, [0.0, 0.6]), &profile);
    for layer in &planned.paths.layers {
        assert_eq!(layer.beads.len(), 1);
        let cover = cover(layer, &profile);
        assert!(cover.iou > 0.993 && (cover.volume_ratio - 1.0).abs() < 0.005, "{cover:?}");
    }
}

#[test]
fn stadium_beads_reach_both_skins() {
    let mut profile = reference();
    profile.print.bead_shape = BeadShape::Stadium;
    let planned = planned(&Tubes::new(vec![Tube::upright(0.0, 3.0)], 1.0, [0.0, 0.4]), &profile);
    for layer in &planned.paths.layers {
        let cover = cover(layer, &profile);
        assert!(cover.iou > 0.997 && cover.gap < 0.002, "{cover:?}");
        assert!((cover.volume_ratio - 1.0).abs() < 0.003, "{cover:?}");
    }
}

#[test]
fn part_is_only_moved_centred_and_stands_on_the_bed() {
    let body = Tubes::new(vec![Tube { slope: [0.3, 0.1], ..Tube::upright(50.0, 3.0) }], 1.0, [-7.0, 5.0]);
    let layers = layers_of(&body);
    let planned = plan(&layers, &reference(), &Task::quiet()).unwrap();
    let all = planned.paths.layers.iter().filter_map(|l| l.material.bounds()).reduce(Bounds2::union).unwrap();
    assert!((nalgebra::center(&all.min, &all.max) - Point2::new(100.0, 100.0)).norm() < 1e-9);
    let moved = planned.paths.bed_from_stack.apply(crate::geom::Point3::new(0.0, 0.0, -7.0));
    assert!(moved.z.abs() < 1e-9);
    for (layer, paths) in layers.iter().zip(&planned.paths.layers) {
        let top = layer.slot.z_mid_mm + layer.slot.height_mm / 2.0 + 7.0;
        assert!((paths.z_mm - top).abs() < 1e-9);
        let p = layer.material.contours[0].points[0];
        let on_bed = planned.paths.bed_from_stack.apply(crate::geom::Point3::new(p.x, p.y, 0.0)).xy();
        assert!((paths.material.contours[0].points[0] - on_bed).norm() < 1e-9);
    }
}

use crate::geom::Bounds2;

fn all_points(planned: &Planned) -> impl Iterator<Item = Point2> + '_ {
    planned.paths.layers.iter().flat_map(|l| {
        let beads = l.beads.iter().flat_map(|b| b.points.iter().map(|p| p.at));
        beads.chain(l.travels.iter().flat_map(|t| t.via.iter().copied()))
    })
}

#[test]
fn everything_stays_inside_the_bed_and_skirt_that_would_not_is_left_out() {
    let mut profile = profile::builtin("marlin").unwrap();
    let body = Tubes::merging([0.0, 4.0]);
    let inside = |planned: &Planned, profile: &Profile| {
        let [x, y, _] = profile.machine.bed_mm;
        all_points(planned).all(|p| p.x >= 0.2 && p.y >= 0.2 && p.x <= x - 0.2 && p.y <= y - 0.2)
    };
    let with_skirt = planned(&body, &profile);
    assert!(inside(&with_skirt, &profile) && with_skirt.warnings.is_empty());
    let skirts =
        |p: &Planned| p.paths.layers[0].beads.iter().filter(|b| b.kind == BeadKind::SkirtBrim).count();
    assert!(skirts(&with_skirt) >= 2);
    let size =
        layers_of(&body).iter().filter_map(|l| l.material.bounds()).reduce(Bounds2::union).unwrap().size();
    (profile.machine.bed_mm[0], profile.machine.bed_mm[1]) = (size.x + 1.0, size.y + 1.0);
    let tight = planned(&body, &profile);
    assert!(inside(&tight, &profile));
    assert_eq!(skirts(&tight), 0);
    assert_eq!(tight.warnings[0].code, "toolpath.adhesion_outside_bed");
}

#[test]
fn brim_surrounds_the_first_layer_only() {
    let mut profile = reference();
    profile.print.brim_mm = 2.0;
    let planned = planned(&Tubes::new(vec![Tube::upright(0.0, 3.0)], 1.0, [0.0, 1.0]), &profile);
    let brim = |l: &LayerPaths| l.beads.iter().filter(|b| b.kind == BeadKind::SkirtBrim).count();
    assert_eq!(brim(&planned.paths.layers[0]), 5);
    assert!(planned.paths.layers[1..].iter().all(|l| brim(l) == 0));
}

#[test]
fn travels_stay_in_the_wall_of_a_single_tube() {
    let tube = Tube { slope: [0.4, 0.0], ..Tube::upright(0.0, 3.0) };
    let planned = planned(&Tubes::new(vec![tube], 1.0, [0.0, 12.0]), &reference());
    assert!(planned.paths.layers.iter().flat_map(|l| &l.travels).all(|t| !t.leaves_material));
}

#[test]
fn travels_leave_the_material_only_between_islands() {
    let planned = planned(&Tubes::merging([0.0, 20.0]), &reference());
    for layer in &planned.paths.layers {
        let leaving = layer.travels.iter().filter(|t| t.leaves_material).count();
        assert!(leaving < layer.material.islands().len(), "z {}: {leaving}", layer.z_mm);
    }
    assert!(planned.paths.layers.iter().any(|l| l.material.islands().len() == 2));
}

#[test]
fn compensations_move_the_outline_by_what_they_say() {
    let body = Tubes::new(vec![Tube::upright(0.0, 3.0)], 1.0, [0.0, 0.4]);
    let lumen_radius = |profile: &Profile, layer: usize| {
        let planned = planned(&body, profile);
        let hole =
            planned.paths.layers[layer].material.contours.iter().find(|c| !c.is_ccw()).unwrap().clone();
        (-hole.signed_area_mm2() / std::f64::consts::PI).sqrt()
    };
    let outer_radius = |profile: &Profile, layer: usize| {
        let planned = planned(&body, profile);
        let outer =
            planned.paths.layers[layer].material.contours.iter().find(|c| c.is_ccw()).unwrap().clone();
        (outer.signed_area_mm2() / std::f64::consts::PI).sqrt()
    };
    let plain = reference();
    let with = |change: &dyn Fn(&mut Profile)| {
        let mut changed = plain.clone();
        change(&mut changed);
        changed
    };
    let moved = |changed: &Profile, layer: usize| {
        let by = |radius: &dyn Fn(&Profile, usize) -> f64| radius(changed, layer) - radius(&plain, layer);
        [by(&lumen_radius), by(&outer_radius)]
    };
    let assert_moved = |changed: &Profile, layer: usize, expected: [f64; 2]| {
        let found = moved(changed, layer);
        let off = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 2e-3, "layer {layer}: {found:?}, expected {expected:?}");
    };
    for by in [0.1, -0.07] {
        let holes = with(&|p| p.print.hole_compensation_mm = by);
        assert_moved(&holes, 0, [by, 0.0]);
        assert_moved(&holes, 1, [by, 0.0]);
        let first = with(&|p| p.print.first_layer_compensation_mm = by);
        assert_moved(&first, 0, [by, -by]);
        assert_eq!(moved(&first, 1), [0.0, 0.0]);
        let squeezed = with(&|p| p.print.squeeze_compensation_mm = by);
        assert_moved(&squeezed, 0, [by, -by]);
        assert_moved(&squeezed, 1, [by, -by]);
        let both = with(&|p| {
            p.print.squeeze_compensation_mm = by;
            p.print.first_layer_compensation_mm = 0.05;
        });
        assert_moved(&both, 0, [by + 0.05, -by - 0.05]);
        assert_moved(&both, 1, [by, -by]);
    }
    let shrinking = with(&|p| p.filament.shrinkage_percent = 2.0);
    for radius in [&lumen_radius as &dyn Fn(&Profile, usize) -> f64, &outer_radius] {
        assert!((radius(&shrinking, 1) * 0.98 - radius(&plain, 1)).abs() < 1e-6);
    }
}

/// Where the printed edges of the lumen and of the outer skin lie in a layer of an upright tube on the middle of the bed.
fn printed_radii(layer: &LayerPaths) -> [f64; 2] {
    let beads = layer.beads.iter().filter(|b| b.kind == BeadKind::ExternalPerimeter);
    // Without the leads and what is beside them.
    let inner = |b: &Bead| b.points[3..b.points.len() - 3].to_vec();
    let points: Vec<BeadPoint> = beads.flat_map(inner).collect();
    let at = |p: &BeadPoint| (p.at - Point2::new(100.0, 100.0)).norm();
    [
        points.iter().map(|p| at(p) - p.width_mm / 2.0).fold(f64::INFINITY, f64::min),
        points.iter().map(|p| at(p) + p.width_mm / 2.0).fold(0.0, f64::max),
    ]
}

#[test]
fn compensations_move_the_printed_edges_as_they_move_the_outlines() {
    let body = Tubes::new(vec![Tube::upright(0.0, 3.0)], 1.0, [0.0, 0.4]);
    let printed = |change: &dyn Fn(&mut Profile), layer: usize| {
        let mut profile = reference();
        change(&mut profile);
        printed_radii(&planned(&body, &profile).paths.layers[layer])
    };
    for (change, layer, expected) in [
        (&(|_: &mut Profile| ()) as &dyn Fn(&mut Profile), 1, [3.0, 4.0]),
        (&|p| p.print.hole_compensation_mm = 0.1, 1, [3.1, 4.0]),
        (&|p| p.print.squeeze_compensation_mm = 0.03, 1, [3.03, 3.97]),
        (&|p| p.print.first_layer_compensation_mm = 0.1, 0, [3.1, 3.9]),
        (&|p| p.print.first_layer_compensation_mm = 0.1, 1, [3.0, 4.0]),
        (&|p| p.filament.shrinkage_percent = 2.0, 1, [3.0 / 0.98, 4.0 / 0.98]),
    ] {
        let found = printed(change, layer);
        let off = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 4e-3, "{found:?}, expected {expected:?}");
    }
}

/// A tube of flat facets as a mesh's layer cuts it: near the lowest corner of each facet its diagonal is met, too.
fn faceted(share: f64) -> Layer {
    let outline = |radius: f64| {
        let at = |k: u32| {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k % 128) / 128.0).sin_cos();
            Point2::new(radius * cos, radius * sin)
        };
        let facet = |k: u32| [at(k), at(k) + (at(k + 1) - at(k)) * share];
        Contour::new((0..128).flat_map(facet).collect())
    };
    let lumen = Region::new(vec![outline(3.0)]);
    let material = Region::new(vec![outline(4.0), outline(3.0).reversed()]);
    Layer { slot: LayerSlot { z_mid_mm: 0.1, height_mm: 0.2, ct_plane: None }, material, lumen }
}

#[test]
fn compensated_outlines_are_filled_whatever_points_they_have() {
    for name in ["reference", "marlin"] {
        for (squeeze_mm, hole_mm) in [(0.05, 0.0), (-0.1, 0.0), (0.0, -0.3), (0.0, 0.1)] {
            let mut profile = profile::builtin(name).unwrap();
            profile.print.skirt_loops = 0;
            (profile.print.squeeze_compensation_mm, profile.print.hole_compensation_mm) =
                (squeeze_mm, hole_mm);
            let volume = |share: f64| {
                let planned = plan(&[faceted(share)], &profile, &Task::quiet()).unwrap();
                gcode::volume_mm3(&planned.paths.layers[0], &profile)
            };
            let expected = volume(0.5);
            for share in [1e-4, 5e-4, 0.002, 0.005, 0.015, 0.1, 0.995, 0.999] {
                let found = volume(share);
                assert!(
                    (found / expected - 1.0).abs() < 0.01,
                    "{name}, {squeeze_mm} and {hole_mm} mm: {found} mm3 of {expected} with points at {share}"
                );
            }
        }
    }
}

#[test]
fn same_input_gives_the_same_bytes_on_any_number_of_threads() {
    let layers = layers_of(&Tubes::merging([0.0, 6.0]));
    let profile = profile::builtin("marlin").unwrap();
    let job = || {
        let planned = plan(&layers, &profile, &Task::quiet()).unwrap();
        gcode::write(&planned.paths, &profile, &gcode::Header::default())
    };
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap().install(job);
    let three = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap().install(job);
    assert!(one == three && one == job());
}

#[test]
fn what_begins_in_the_air_is_told_unless_it_is_held_up() {
    let layers_from = |x: f64, z: [f64; 2]| layers_of(&Tubes::new(vec![Tube::upright(x, 3.0)], 1.0, z));
    let low = layers_from(0.0, [0.0, 6.0]);
    // A second tube beside the first one from the eleventh layer on.
    let both = |(k, layer): (usize, &Layer)| {
        let other = layers_from(20.0, [0.0, 6.0])[k].material.clone();
        let material = if k < 10 { layer.material.clone() } else { layer.material.union(&other) };
        Layer { material, ..layer.clone() }
    };
    let layers: Vec<Layer> = low.iter().enumerate().map(both).collect();
    let codes = |profile: &Profile, layers: &[Layer]| -> Vec<String> {
        plan(layers, profile, &Task::quiet()).unwrap().warnings.into_iter().map(|w| w.code).collect()
    };
    assert_eq!(codes(&reference(), &low), Vec::<String>::new());
    assert_eq!(codes(&reference(), &layers), ["toolpath.in_the_air"]);
    let mut held = reference();
    held.print.support = SupportStyle::Column;
    assert_eq!(codes(&held, &layers), Vec::<String>::new());
}

#[test]
fn each_fault_is_named() {
    let layers = layers_of(&Tubes::new(vec![Tube::upright(0.0, 3.0)], 1.0, [0.0, 1.0]));
    let fault = |profile: &Profile| plan(&layers, profile, &Task::quiet()).unwrap_err();
    assert_eq!(plan(&[], &reference(), &Task::quiet()), Err(Error::Empty));
    let mut small = reference();
    small.machine.bed_mm = [5.0, 200.0, 250.0];
    let text = fault(&small).to_string();
    assert!(text.contains("the part is 8 x 8") && text.contains("5 x 200 x 250 mm"), "{text}");
    let thin = layers_of(&Tubes::new(vec![Tube::upright(0.0, 3.0)], 0.12, [0.0, 1.0]));
    let text = plan(&thin, &reference(), &Task::quiet()).unwrap_err().to_string();
    assert!(text.contains("0.119 mm thin in layer 0 at z 0.10"), "{text}");
    // The place is the model's: on its skins, though it is printed elsewhere.
    let Err(Error::WallTooThin { x_mm, y_mm, .. }) = plan(&thin, &reference(), &Task::quiet()) else {
        panic!("no thin wall")
    };
    assert!((x_mm.hypot(y_mm) - 3.06).abs() < 0.07, "{x_mm} {y_mm}");
    // One thin layer of many is told.
    let wide = layers_of(&Tubes::new(vec![Tube::upright(0.0, 3.0)], 1.0, [0.0, 6.0]));
    let layers: Vec<Layer> = thin.iter().take(1).chain(&wide[1..]).cloned().collect();
    let told = plan(&layers, &reference(), &Task::quiet()).unwrap().warnings;
    assert_eq!(told[0].code, "toolpath.thin_wall");
    let token = CancelToken::default();
    token.cancel();
    let stopped = plan(&layers, &reference(), &Task::new(&|_, _| {}, token));
    assert_eq!(stopped, Err(Error::Cancelled(Cancelled)));
}

/// The least and the greatest of every range that a profile may have and a plan depends on.
#[test]
fn whatever_a_profile_may_say_can_be_planned() {
    let layers = layers_of(&Tubes::new(vec![Tube::upright(0.0, 3.0)], 1.0, [0.0, 1.0]));
    for keys in [
        "[filament]\nshrinkage_percent = -2",
        "[filament]\nshrinkage_percent = 5",
        "[machine]\nextrusion_width_mm = [0.05, 6]\n[print]\nextrusion_width_mm = 0.05",
        "[machine]\nextrusion_width_mm = [0.05, 6]\n[print]\nextrusion_width_mm = 6",
    ] {
        let profile = profile::parse(&format!("inherits = \"marlin\"\n{keys}\n"), "x.toml").unwrap();
        let planned = plan(&layers, &profile, &Task::quiet()).unwrap_or_else(|e| panic!("{keys}: {e}"));
        let part = planned.paths.layers.iter().flat_map(|l| &l.beads).filter(|b| b.kind.is_part());
        assert!(part.count() >= layers.len(), "{keys}");
    }
}

#[test]
fn specks_are_left_out_and_reported() {
    let mut layers = layers_of(&Tubes::new(vec![Tube::upright(0.0, 3.0)], 1.0, [0.0, 1.0]));
    layers[2].material.contours.push(Contour::circle(Point2::new(8.0, 0.0), 0.03, 12));
    let planned = plan(&layers, &reference(), &Task::quiet()).unwrap();
    assert!(planned.warnings.iter().any(|w| w.code == "toolpath.lost_feature"), "{:?}", planned.warnings);
}

#[test]
fn both_skins_agree_where_one_bead_fills_the_wall() {
    // Eccentric so that half of the ring is too thin for two beads.
    for (inner, wall, shift) in [
        (0.8, 0.629_150_095_450_770_9, 0.051_119_931),
        (3.0, 0.63, 0.08),
        (5.0, 0.66, 0.2),
        (1.473_309_853, 2.547_810_376, 0.228_964_361),
        (4.13, 2.53, 0.2416),
    ] {
        let cover = ring_cover(inner, wall, shift);
        assert!(
            cover.iou > 0.96 && (cover.volume_ratio - 1.0).abs() < 0.03,
            "{inner} {wall} {shift}: {cover:?}"
        );
    }
}

/// How well a ring is filled whose lumen lies off its middle by a share of the wall.
fn ring_cover(inner: f64, wall: f64, shift: f64) -> Cover {
    ring_cover_with(BeadShape::Rectangle, inner, wall, shift)
}

fn ring_cover_with(shape: BeadShape, inner: f64, wall: f64, shift: f64) -> Cover {
    let mut profile = reference();
    profile.print.bead_shape = shape;
    let mut layers = layers_of(&Tubes::new(vec![Tube::upright(0.0, 3.0)], 1.0, [0.0, 0.2]));
    let lumen = Contour::circle(Point2::new(shift * wall, 0.0), inner, 140);
    let outer = Contour::circle(Point2::origin(), inner + wall, 160);
    layers[0].material = Region::new(vec![outer, lumen.reversed()]);
    layers[0].lumen = Region::new(vec![lumen]);
    let planned = plan(&layers, &profile, &Task::quiet()).unwrap();
    cover(&planned.paths.layers[0], &profile)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn any_ring_is_filled_near_its_volume(inner in 0.8..6.0f64, wall in 0.62..2.6f64, shift in 0.0..0.3f64) {
        // A bead that begins in the wall of a narrow tube leaves the most.
        let most = if inner < 2.0 && wall < 0.85 { 0.03 } else { 0.015 };
        for shape in [BeadShape::Rectangle, BeadShape::Stadium] {
            let cover = ring_cover_with(shape, inner, wall, shift);
            prop_assert!(cover.iou > 0.987, "{shape:?}: {cover:?}");
            prop_assert!(cover.gap < 0.012, "{shape:?}: {cover:?}");
            prop_assert!((cover.volume_ratio - 1.0).abs() < most, "{shape:?}: {cover:?}");
        }
    }

    #[test]
    fn ragged_outlines_never_make_it_panic(radii in prop::collection::vec(0.2..5.0f64, 3..60), hole in 0.0..0.9f64) {
        let n = radii.len() as f64;
        let star = |share: f64| {
            let at = |(i, r): (usize, &f64)| {
                let (sin, cos) = (std::f64::consts::TAU * i as f64 / n).sin_cos();
                Point2::new(r * share * cos, r * share * sin)
            };
            Contour::new(radii.iter().enumerate().map(at).collect())
        };
        let mut layers = layers_of(&Tubes::new(vec![Tube::upright(0.0, 3.0)], 1.0, [0.0, 0.2]));
        let mut contours = vec![star(1.0)];
        if hole > 0.2 {
            contours.push(star(hole).reversed());
        }
        layers[0].material = Region::new(contours);
        layers[0].lumen = Region::default();
        let planned = plan(&layers, &reference(), &Task::quiet());
        if let Ok(planned) = planned {
            for bead in planned.paths.layers.iter().flat_map(|l| &l.beads) {
                prop_assert!(bead.points.len() >= 2);
                prop_assert!(bead.points.iter().all(|p| p.at.x.is_finite() && p.width_mm > 0.0 && p.width_mm < 2.0));
            }
        }
    }
}

#[test]
fn a_wall_that_beads_fill_needs_no_raster() {
    for (wall, n_beads) in [(2.5, 6), (3.0, 8), (3.4, 8)] {
        let profile = reference();
        let planned = planned(&Tubes::new(vec![Tube::upright(0.0, 3.0)], wall, [0.0, 0.4]), &profile);
        for layer in &planned.paths.layers {
            assert_eq!(layer.beads.len(), n_beads, "{wall} mm");
            let cover = cover(layer, &profile);
            assert!(cover.iou > 0.997 && cover.overlap < 0.005 && cover.gap < 0.003, "{wall} mm: {cover:?}");
            assert!((cover.volume_ratio - 1.0).abs() < 0.003, "{wall} mm: {cover:?}");
        }
    }
}

#[test]
fn a_tube_in_a_tube_outlives_the_compensation_of_holes() {
    let disc = |radius: f64| Region::new(vec![Contour::circle(Point2::origin(), radius, 180)]);
    let ring = |inner: f64, outer: f64| disc(outer).difference(&disc(inner));
    // Another program's model: its lumen is all that a hole's outline encloses.
    let slot = LayerSlot { z_mid_mm: 0.1, height_mm: 0.2, ct_plane: None };
    let layers = [Layer { slot, material: ring(8.0, 10.0).union(&ring(3.0, 4.0)), lumen: disc(8.0) }];
    for by in [0.05, -0.05] {
        let mut profile = reference();
        profile.print.hole_compensation_mm = by;
        let layer = &plan(&layers, &profile, &Task::quiet()).unwrap().paths.layers[0];
        let expected = ring(8.0 + by, 10.0).area_mm2() + ring(3.0, 4.0).area_mm2();
        assert!((layer.material.area_mm2() / expected - 1.0).abs() < 1e-3, "{by} mm: {expected}");
    }
}

#[test]
fn compensations_that_leave_nothing_are_told() {
    let layers = layers_of(&Tubes::new(vec![Tube::upright(0.0, 3.0)], 1.0, [0.0, 2.0]));
    let mut profile = reference();
    profile.print.squeeze_compensation_mm = 0.5;
    let text = plan(&layers, &profile, &Task::quiet()).unwrap_err().to_string();
    assert!(text.starts_with("no bead has room in any layer") && text.contains("squeeze"), "{text}");
    let mut profile = reference();
    profile.print.first_layer_compensation_mm = 0.6;
    let warnings = plan(&layers, &profile, &Task::quiet()).unwrap().warnings;
    let bare = warnings.iter().find(|w| w.code == "toolpath.bare_layer").unwrap();
    assert!(bare.text.starts_with("1 layer(s)") && bare.text.contains("z 0.10 mm"), "{}", bare.text);
}

/// A layer of 0.2 mm above so many others.
fn slab(idx: usize, material: Region) -> Layer {
    let slot = LayerSlot { z_mid_mm: 0.2 * idx as f64 + 0.1, height_mm: 0.2, ct_plane: None };
    Layer { slot, material, lumen: Region::default() }
}

fn disc(x: f64, radius: f64) -> Region {
    Region::new(vec![Contour::circle(Point2::new(x, 0.0), radius, 360)])
}

fn told(layers: &[Layer], profile: &Profile) -> Vec<(String, String)> {
    let warnings = plan(layers, profile, &Task::quiet()).unwrap().warnings;
    warnings.into_iter().map(|w| (w.code, w.text)).collect()
}

#[test]
fn what_is_printed_begins_on_the_bed() {
    // Below a disc, a speck that no bead can print.
    let at = |idx| slab(idx, disc(if idx < 2 { 3.0 } else { 0.0 }, if idx < 2 { 0.05 } else { 5.0 }));
    let layers: Vec<Layer> = (0..12).map(at).collect();
    let planned = plan(&layers, &reference(), &Task::quiet()).unwrap();
    assert_eq!(planned.paths.layers.len(), 10);
    let first = &planned.paths.layers[0];
    assert!((first.z_mm - 0.2).abs() < 1e-9 && first.beads.iter().any(|b| b.kind.is_part()));
    let foot = planned.paths.bed_from_stack.apply(crate::geom::Point3::new(0.0, 0.0, 0.4));
    assert!(foot.z.abs() < 1e-9, "{foot}");
    assert_eq!(planned.warnings.len(), 1);
    let expected = "nothing in the lowest 2 layers is large enough for a bead, the first at z 0.10 mm (x 3.05, y 0.00 in the \
                    model): left out, and the rest set down by 0.40 mm, onto the bed";
    assert_eq!(
        (planned.warnings[0].code.as_str(), planned.warnings[0].text.as_str()),
        ("toolpath.bare_foot", expected)
    );
    // What has a bead stays, and so does a part without any, as which it is refused.
    assert_eq!(plan(&layers[2..], &reference(), &Task::quiet()).unwrap().paths.layers.len(), 10);
    let thin = |idx| slab(idx, disc(0.0, 3.0).difference(&disc(0.0, 2.95)));
    let thin: Vec<Layer> = (0..10).map(thin).collect();
    assert!(matches!(plan(&thin, &reference(), &Task::quiet()), Err(Error::WallTooThin { layer: 0, .. })));
    // Half of a part is not left out in silence either.
    let half: Vec<Layer> = thin.into_iter().chain((10..20).map(at)).collect();
    assert!(matches!(plan(&half, &reference(), &Task::quiet()), Err(Error::WallTooThin { layer: 0, .. })));
}

#[test]
fn an_island_rests_on_what_it_covers_wherever_its_outline_begins() {
    let corners = [(-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-5.0, 5.0)].map(|(x, y)| Point2::new(x, y));
    for first in 0..4 {
        let mut corners = corners.to_vec();
        corners.rotate_left(first);
        let square = Region::new(vec![Contour::new(corners)]);
        let layers: Vec<Layer> = (0..5).map(|idx| slab(idx, square.clone())).collect();
        assert_eq!(told(&layers, &reference()), [], "{first}");
    }
    // A ring around what stands does not rest on it.
    let post = |idx| {
        slab(
            idx,
            if idx < 5 {
                disc(0.0, 3.0)
            } else {
                disc(0.0, 3.0).union(&disc(0.0, 6.0).difference(&disc(0.0, 5.0)))
            },
        )
    };
    let found = told(&(0..10).map(post).collect::<Vec<_>>(), &reference());
    assert!(found.len() == 1 && found[0].0 == "toolpath.in_the_air", "{found:?}");
    assert!(found[0].1.starts_with("1 island begins in the air, the first at z 1.10 mm (x "), "{found:?}");
}

#[test]
fn overhangs_that_nothing_holds_are_told_once_with_their_width() {
    let mushroom: Vec<Layer> =
        (0..15).map(|idx| slab(idx, disc(0.0, if idx < 10 { 4.0 } else { 15.0 }))).collect();
    let mut profile = reference();
    profile.print.support_overhang_deg = 50.0;
    let found = told(&mushroom, &profile);
    assert!(found.len() == 1 && found[0].0 == "toolpath.overhang", "{found:?}");
    let begin =
        "nothing holds overhangs beyond 50 degrees in 1 layer, the widest of 11.00 mm at z 2.10 mm (x ";
    assert!(found[0].1.starts_with(begin) && found[0].1.contains("print.support = \"column\""), "{found:?}");
    let cone = |deg: f64| -> Vec<Layer> {
        (0..20).map(|idx| slab(idx, disc(0.0, 4.0 + 0.2 * deg.to_radians().tan() * idx as f64))).collect()
    };
    assert_eq!(told(&cone(48.0), &profile), []);
    let steep = told(&cone(60.0), &profile);
    assert!(steep.len() == 1 && steep[0].1.contains("in 19 layers, the widest of 0.35 mm"), "{steep:?}");
    profile.print.support = SupportStyle::Column;
    assert_eq!(told(&mushroom, &profile), []);
}

#[test]
fn a_part_far_higher_than_its_foot_is_wide_is_told_unless_it_is_steadied() {
    let rod: Vec<Layer> = (0..300).map(|idx| slab(idx, disc(0.0, 1.0))).collect();
    let found = told(&rod, &reference());
    assert!(found.len() == 1 && found[0].0 == "toolpath.slender", "{found:?}");
    let begin = "a part is 60 mm high by itself and stands on 2.0 mm: ";
    assert!(found[0].1.starts_with(begin), "{found:?}");
    // Each of three, however wide they stand together; and where columns are allowed but none stands.
    let three = Region::new(
        [disc(0.0, 1.0), disc(20.0, 1.0), disc(40.0, 1.0)].into_iter().flat_map(|d| d.contours).collect(),
    );
    let three: Vec<Layer> = (0..300).map(|idx| slab(idx, three.clone())).collect();
    let mut columns = reference();
    columns.print.support = SupportStyle::Column;
    for found in [told(&three, &reference()), told(&rod, &columns)] {
        assert!(found.len() == 1 && found[0].1.starts_with(begin), "{found:?}");
    }
    let mut profile = reference();
    profile.print.brim_slenderness = 12.0;
    assert_eq!(told(&rod, &profile), []);
    assert_eq!(told(&rod[..200], &reference()), []);
}

#[test]
fn a_roof_that_spans_far_over_nothing_is_told() {
    let box_of = |side_mm: f64| -> Vec<Layer> {
        let corners = [(0.0, 0.0), (side_mm, 0.0), (side_mm, side_mm), (0.0, side_mm)];
        let square = Region::new(vec![Contour::new(corners.map(|(x, y)| Point2::new(x, y)).to_vec())]);
        (0..20).map(|idx| slab(idx, square.clone())).collect()
    };
    let mut profile = reference();
    profile.print.infill_percent = 0.0;
    let found = told(&box_of(40.0), &profile);
    let expected = "lines span up to 38 mm over air, the longest at z ";
    assert!(
        found.len() == 1 && found[0].0 == "toolpath.long_bridge" && found[0].1.starts_with(expected),
        "{found:?}"
    );
    assert_eq!(told(&box_of(18.0), &profile), []);
    profile.print.infill_percent = 20.0;
    assert_eq!(told(&box_of(40.0), &profile), []);
}

#[test]
fn a_wall_that_compensations_have_thinned_is_told_with_them() {
    let mut profile = reference();
    let ring = disc(0.0, 4.0).difference(&disc(0.0, 3.4));
    let layers: Vec<Layer> =
        (0..3).map(|idx| Layer { lumen: disc(0.0, 3.4), ..slab(idx, ring.clone()) }).collect();
    profile.print.hole_compensation_mm = 0.5;
    let words = plan(&layers, &profile, &Task::quiet()).unwrap_err().to_string();
    assert!(words.contains("mm thin after what print.hole_compensation_mm takes in layer 0"), "{words}");
    // What thickens is not blamed; what thins the layer on the bed alone is.
    (profile.print.hole_compensation_mm, profile.print.first_layer_compensation_mm) = (-0.1, 0.32);
    let words = plan(&layers, &profile, &Task::quiet()).unwrap_err().to_string();
    assert!(
        words.contains("mm thin after what print.first_layer_compensation_mm takes in layer 0"),
        "{words}"
    );
}

#[test]
fn a_part_that_hardly_touches_the_bed_is_told_unless_it_is_held_down() {
    let ball = |idx: usize| {
        let z = 0.2 * idx as f64 + 0.1;
        slab(idx, disc(0.0, (z * (20.0 - z)).sqrt()))
    };
    let ball: Vec<Layer> = (0..100).map(ball).collect();
    let mut profile = reference();
    profile.print.support_overhang_deg = 85.0;
    let found = told(&ball, &profile);
    assert!(found.len() == 1 && found[0].0 == "toolpath.footing", "{found:?}");
    let begin =
        "only 6.3 mm2 of the part lie on the bed, at z 0.10 mm (x 0.00, y 0.00 in the model), under 65.3 mm2";
    assert!(found[0].1.starts_with(begin) && found[0].1.contains("print.brim_mm"), "{found:?}");
    profile.print.brim_mm = 5.0;
    assert_eq!(told(&ball, &profile), []);
}

/// How far the beads of a layer reach into its lumen, mm.
fn intrusion_mm(layer: &LayerPaths) -> f64 {
    let lumen = crate::geom::SegmentIndex::try_new(&layer.lumen.contours).unwrap();
    let reach = |pair: &[BeadPoint]| {
        let way = pair[1].at - pair[0].at;
        let at = (0..=20).map(|k| pair[0].at + way * (f64::from(k) / 20.0));
        at.map(|at| pair[0].width_mm / 2.0 - lumen.signed_distance_mm(at)).fold(f64::NEG_INFINITY, f64::max)
    };
    layer.beads.iter().flat_map(|b| b.points.windows(2)).map(reach).fold(f64::NEG_INFINITY, f64::max)
}

/// A ring of 1 mm, and of `least_mm` around one place over some length, where one of its skins is dented.
fn dented(least_mm: f64, length_mm: f64, is_lumen: bool) -> Layer {
    let outline = |radius: f64, dent_mm: f64| {
        let at = |k: u32| {
            let angle = std::f64::consts::TAU * f64::from(k) / 720.0;
            let off = (angle - std::f64::consts::PI) * 3.5 / (length_mm / 2.0);
            let radius = radius + dent_mm * (1.0 - off * off).max(0.0).powi(2);
            Point2::new(radius * angle.cos(), radius * angle.sin())
        };
        Contour::new((0..720).map(at).collect())
    };
    let by_mm = 1.0 - least_mm;
    let inner = outline(3.0, if is_lumen { by_mm } else { 0.0 });
    let outer = outline(4.0, if is_lumen { 0.0 } else { -by_mm });
    let slot = LayerSlot { z_mid_mm: 0.1, height_mm: 0.2, ct_plane: None };
    Layer {
        slot,
        material: Region::new(vec![outer, inner.clone().reversed()]),
        lumen: Region::new(vec![inner]),
    }
}

#[test]
fn the_lumen_keeps_its_outline_where_the_wall_is_thinner_than_the_thinnest_bead() {
    for shape in [BeadShape::Rectangle, BeadShape::Stadium] {
        let mut profile = reference();
        profile.print.bead_shape = shape;
        for is_lumen in [false, true] {
            // Over less than a bead's turn, two beads may meet in the thin place.
            for (length_mm, most_mm) in [(1.0, 0.07), (2.0, 0.05), (4.0, 0.015), (8.0, 0.015)] {
                for least_mm in [0.25, 0.2, 0.17, 0.1, 0.05] {
                    let planned =
                        plan(&[dented(least_mm, length_mm, is_lumen)], &profile, &Task::quiet()).unwrap();
                    let reach_mm = intrusion_mm(&planned.paths.layers[0]);
                    let case = format!("{shape:?}, lumen {is_lumen}: {least_mm} mm over {length_mm} mm");
                    assert!(reach_mm < most_mm, "{case}: {reach_mm}");
                    let told: Vec<_> =
                        planned.warnings.iter().filter(|w| w.code == "toolpath.thin_wall").collect();
                    let expected = "too thick there, on the outside: the lumen keeps its outline";
                    assert!(told.len() == 1 && told[0].text.ends_with(expected), "{case}: {told:?}");
                }
            }
        }
    }
    let warnings = plan(&[dented(0.1, 4.0, false)], &reference(), &Task::quiet()).unwrap().warnings;
    let expected = "material thinner than the thinnest bead in 1 layer, worst 0.100 mm at z 0.10 mm (x -3.00, y 0.00 in the model): \
                    printed 0.200 mm too thick there, on the outside: the lumen keeps its outline";
    assert_eq!(warnings[0].text, expected);
}
