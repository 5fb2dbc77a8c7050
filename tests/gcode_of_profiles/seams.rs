//! The printed outline of the lumen at each seam against its neighbourhood, as planned and as the simulator records it.
//!
//! Along the lumen's outline the edge of the printed material is sought along the normal: how far it lies from the outline, into
//! the wall positive. At a seam that may be no deeper (a notch) and no higher (a blob) than beside it.

use super::{Run, carotid, run};
use lumenfab::gcode;
use lumenfab::geom::{Contour, Point2, SegmentIndex, Vector2};
use lumenfab::phantom::{Kind, Vessel};
use lumenfab::profile::{self, Profile};
use lumenfab::progress::Task;
use lumenfab::slice::{Layer, LayerSlot};
use lumenfab::toolpath::{self, Bead, BeadKind, LayerPaths};
use std::f64::consts::TAU;

/// So far from a seam it is the seam, mm of the outline to either side.
const SEAM_MM: f64 = 0.8;
/// So far it is its neighbourhood.
const BESIDE_MM: f64 = 2.5;
/// Step along the outline, mm.
const STEP_MM: f64 = 0.05;
/// An edge is sought so far to either side of the outline, mm.
const REACH_MM: f64 = 0.3;
/// What the outline at a seam may differ by, mm.
const ALLOWED_MM: f64 = 0.02;

/// A printed segment: its ends and its half width.
type Laid = (Point2, Point2, f64);

/// How far the edge of what is printed lies from a point of the outline, into the wall.
fn edge_mm(at: Point2, into_wall: Vector2, laid: &[Laid]) -> f64 {
    let outside = |p: Point2| {
        let distance = |(a, b, radius): &Laid| super::distance_mm(p, *a, *b) - radius;
        laid.iter().map(distance).fold(f64::INFINITY, f64::min)
    };
    let mut depth_mm = -REACH_MM;
    while depth_mm < REACH_MM {
        let free_mm = outside(at + into_wall * depth_mm);
        if free_mm < 1e-4 {
            break;
        }
        depth_mm += free_mm;
    }
    depth_mm.min(REACH_MM)
}

/// The outline of a lumen in steps: places, and normals into the wall.
fn walked(outline: &Contour) -> Vec<(Point2, Vector2)> {
    let mut places = Vec::new();
    let mut passed = 0.0;
    for (a, b) in outline.edges() {
        let along = (b - a).normalize();
        while passed < (b - a).norm() {
            places.push((a + along * passed, Vector2::new(along.y, -along.x)));
            passed += STEP_MM;
        }
        passed -= (b - a).norm();
    }
    places
}

/// The worst step of the printed outline at the seam near `seam`.
fn step_mm(seam: Point2, layer: &LayerPaths, laid: &[Laid]) -> Option<f64> {
    let near = |c: &&Contour| {
        SegmentIndex::try_new(std::slice::from_ref(*c)).unwrap().nearest(seam).distance_mm < 0.6
    };
    let outline = layer.lumen.contours.iter().find(near)?;
    let places = walked(outline);
    let n = places.len();
    let at = (0..n).min_by(|&a, &b| (places[a].0 - seam).norm().total_cmp(&(places[b].0 - seam).norm()))?;
    let laid: Vec<Laid> =
        laid.iter().filter(|(a, ..)| (a - seam).norm() < BESIDE_MM + 2.0).copied().collect();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few dozen steps")]
    let steps = |mm: f64| (mm / STEP_MM) as usize;
    let window = steps(BESIDE_MM).min(n / 2);
    let edges: Vec<f64> = (0..2 * window)
        .map(|i| {
            let (at, into_wall) = places[(at + n + i - window) % n];
            edge_mm(at, into_wall, &laid)
        })
        .collect();
    let is_seam = |i: usize| i.abs_diff(window) <= steps(SEAM_MM);
    let mut beside: Vec<f64> = (0..edges.len()).filter(|&i| !is_seam(i)).map(|i| edges[i]).collect();
    beside.sort_by(f64::total_cmp);
    let usual = *beside.get(beside.len() / 2)?;
    let worst = (0..edges.len()).filter(|&i| is_seam(i)).map(|i| edges[i] - usual);
    worst.max_by(|a, b| a.abs().total_cmp(&b.abs()))
}

/// Where the beads along the lumen end in a layer, or leave its line for the wall; with the beads.
fn ends(layer: &LayerPaths) -> Vec<(&Bead, Point2)> {
    let skin: Vec<_> = layer.lumen.contours.clone();
    let Some(index) = SegmentIndex::try_new(&skin) else { return Vec::new() };
    let external = layer.beads.iter().filter(|b| b.kind == BeadKind::ExternalPerimeter);
    let ends = external.filter_map(|b| {
        let near_mm = 0.6 * b.points.iter().map(|p| p.width_mm).fold(0.0, f64::max);
        let last_two = b.points.iter().rev().take(2).map(|p| p.at);
        Some((b, last_two.into_iter().find(|at| index.nearest(*at).distance_mm < near_mm)?))
    });
    ends.collect()
}

/// Their places.
fn seams(layer: &LayerPaths) -> Vec<Point2> {
    ends(layer).into_iter().map(|(_, at)| at).collect()
}

/// Those of them that close a loop: a bead along a thin wall has two ends whose places the wall decides.
fn closings(layer: &LayerPaths) -> Vec<Point2> {
    let is_loop = |(bead, _): &(&Bead, Point2)| {
        let (first, last) = (bead.points[0], bead.points[bead.points.len() - 1]);
        (first.at - last.at).norm() < first.width_mm
    };
    ends(layer).into_iter().filter(is_loop).map(|(_, at)| at).collect()
}

/// The worst seam of a job: as planned, and as the simulated printer records it; how many there are.
fn worst_seams(layers: &[Layer], profile: &Profile) -> (f64, f64, usize) {
    let planned = toolpath::plan(layers, profile, &Task::quiet()).unwrap().paths;
    let text = gcode::write(&planned, profile, &gcode::Header::default());
    let Run { beads, complaints, .. } = run(&text, profile);
    assert!(complaints.is_empty(), "{:?}", complaints.first());
    let (mut as_planned, mut as_recorded, mut n_seams) = (0.0f64, 0.0f64, 0);
    for layer in &planned.layers {
        let own = layer.beads.iter().flat_map(|b| b.points.windows(2));
        let planned: Vec<Laid> = own.map(|p| (p[0].at, p[1].at, p[0].width_mm / 2.0)).collect();
        let own = beads.iter().filter(|b| (b.to_mm[2] - layer.z_mm).abs() < 2e-3);
        let at = |mm: [f64; 3]| Point2::new(mm[0], mm[1]);
        let recorded: Vec<Laid> = own.map(|b| (at(b.from_mm), at(b.to_mm), b.width_mm / 2.0)).collect();
        for seam in seams(layer) {
            n_seams += 1;
            let step = |laid: &[Laid]| step_mm(seam, layer, laid).unwrap_or(f64::INFINITY).abs();
            as_planned = as_planned.max(step(&planned));
            as_recorded = as_recorded.max(step(&recorded));
        }
    }
    (as_planned, as_recorded, n_seams)
}

#[test]
fn the_lumen_s_outline_at_each_seam_is_as_beside_it() {
    let carotid: Vec<Layer> = carotid().into_iter().step_by(6).collect();
    // Around the place where one lumen becomes three: corners, and walls whose thickness changes along a fraction of a millimetre.
    let parting = parting_in_three();
    for (name, layers) in
        [("reference", &carotid), ("marlin", &carotid), ("klipper", &carotid), ("prusa-mk3s", &parting)]
    {
        let profile = profile::builtin(name).unwrap();
        let (as_planned, as_recorded, n_seams) = worst_seams(&stacked(layers), &profile);
        println!("{name}: {n_seams} seams, planned {as_planned:.4} mm, recorded {as_recorded:.4} mm");
        assert!(n_seams > layers.len(), "{name}: {n_seams} seams in {} layers", layers.len());
        assert!(as_planned <= ALLOWED_MM && as_recorded <= ALLOWED_MM, "{name}: {as_planned} {as_recorded}");
    }
}

/// Layers around a place where one vessel becomes three.
fn parting_in_three() -> Vec<Layer> {
    let vessel = Vessel::new(Kind::Trifurcation);
    let layer = |i: u32| {
        let z_mid_mm = 0.2 * (f64::from(i) + 0.5);
        let lumen = vessel.region_at(z_mid_mm, 128);
        let slot = LayerSlot { z_mid_mm, height_mm: 0.2, ct_plane: None };
        Layer { slot, material: lumen.offset(1.0, 0.002).difference(&lumen), lumen }
    };
    (330..370).map(layer).collect()
}

#[test]
fn seams_are_spread_over_the_lumen_and_never_stacked() {
    let layers = carotid();
    let profile = profile::builtin("reference").unwrap();
    let planned = toolpath::plan(&layers, &profile, &Task::quiet()).unwrap().paths;
    let places: Vec<Vec<Point2>> = planned.layers.iter().map(closings).collect();
    let nearest =
        |p: &Point2, others: &[Point2]| others.iter().map(|o| (o - p).norm()).fold(f64::INFINITY, f64::min);
    let apart = places.windows(2).flat_map(|p| p[1].iter().map(|seam| nearest(seam, &p[0])));
    let least_mm = apart.fold(f64::INFINITY, f64::min);
    assert!(least_mm > 1.0, "two seams upon each other are {least_mm} mm apart");
    // In the common carotid, by the direction from the middle of the lumen: how many in each twelfth.
    let mut hits = [0u32; 12];
    for (layer, places) in planned.layers.iter().zip(&places).take(160) {
        let [lumen] = layer.lumen.contours.as_slice() else { panic!("more than one lumen") };
        let bounds = lumen.bounds().unwrap();
        let centre = nalgebra::center(&bounds.min, &bounds.max);
        let angle = (places[0].y - centre.y).atan2(places[0].x - centre.x).rem_euclid(TAU);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 11")]
        let twelfth = (12.0 * angle / TAU) as usize % 12;
        hits[twelfth] += 1;
    }
    assert!(hits.iter().all(|n| (10..=17).contains(n)), "{hits:?}");
}

/// The layers upon each other without what was left out between them.
fn stacked(layers: &[Layer]) -> Vec<Layer> {
    let lowered = |(i, layer): (usize, &Layer)| {
        let mut layer = layer.clone();
        layer.slot.z_mid_mm = layer.slot.height_mm * (i as f64 + 0.5);
        layer
    };
    layers.iter().enumerate().map(lowered).collect()
}

#[test]
fn a_notch_at_a_seam_would_be_found() {
    let profile = profile::builtin("reference").unwrap();
    let layers = stacked(&carotid()[100..102]);
    let planned = toolpath::plan(&layers, &profile, &Task::quiet()).unwrap().paths;
    let layer = &planned.layers[0];
    let seam = seams(layer)[0];
    let segments = layer.beads.iter().flat_map(|b| b.points.windows(2));
    let laid: Vec<Laid> = segments.map(|p| (p[0].at, p[1].at, p[0].width_mm / 2.0)).collect();
    let far = |(a, b, _): &Laid| super::distance_mm(seam, *a, *b) > 0.4;
    let notched: Vec<Laid> = laid.iter().filter(|l| far(l)).copied().collect();
    assert!(step_mm(seam, layer, &laid).unwrap().abs() <= ALLOWED_MM);
    assert!(step_mm(seam, layer, &notched).unwrap() > 0.1);
}
