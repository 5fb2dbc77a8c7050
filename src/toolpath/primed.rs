//! What the start script lays down on the bed, and whether the job is printed onto it.
//!
//! A string or a lump of filament is taken as round, and as lying where the nozzle was, however high: it is as wide as it is high, and
//! no bead of a layer that begins lower may come nearer than that.

use super::LayerPaths;
use crate::ct::Warning;
use crate::geom::distance::nearest_on_segment;
use crate::geom::{Point2, SegmentIndex};
use crate::profile::{Primed, Profile};
use std::f64::consts::{FRAC_PI_4, PI};

/// Strings are looked at in steps of this, mm.
const STEP_MM: f64 = 0.5;

/// Where what the start script lays down lies in the way of the job, and by how much.
pub(super) fn in_the_way(layers: &[LayerPaths], profile: &Profile) -> Option<Warning> {
    let worst = |primed: &Primed| {
        let radius_mm = radius_mm(primed, profile);
        let low = layers.iter().take_while(|l| l.z_mm - l.slot.height_mm < 2.0 * radius_mm);
        let places = places(primed);
        let reach = low.enumerate().flat_map(|(idx, layer)| {
            reaches_mm(layer, &places, radius_mm).map(move |(at, mm)| (idx, at, mm))
        });
        reach.filter(|(_, _, mm)| *mm > 0.0).max_by(|a, b| a.2.total_cmp(&b.2).then(b.0.cmp(&a.0)))
    };
    let (primed, (idx, at, mm)) =
        profile.primed().into_iter().find_map(|p| worst(&p).map(|worst| (p, worst)))?;
    let text = format!(
        "line {} of scripts.start, `{}`, primes the nozzle at x {:.2}, y {:.2} mm of the bed, and what it lays down there reaches {mm:.2} \
         mm into layer {idx}: move that place in the profile, or print a smaller part",
        primed.line, primed.text, at.x, at.y
    );
    Some(Warning::new("toolpath.primed_under", text))
}

/// How thick what is laid down gets: a string along its way, a lump where that is shorter, mm.
fn radius_mm(primed: &Primed, profile: &Profile) -> f64 {
    let volume_mm3 = primed.filament_mm * FRAC_PI_4 * profile.machine.filament_mm.powi(2);
    let [from, to] = primed.way_mm.map(Point2::from);
    let lump_mm = (volume_mm3 / (4.0 / 3.0 * PI)).cbrt();
    (volume_mm3 / PI / (to - from).norm().max(1e-9)).sqrt().min(lump_mm)
}

fn places(primed: &Primed) -> Vec<Point2> {
    let [from, to] = primed.way_mm.map(Point2::from);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a way over the bed")]
    let n = ((to - from).norm() / STEP_MM).ceil().clamp(1.0, 1e4) as u32;
    (0..=n).map(|k| from + (to - from) * (f64::from(k) / f64::from(n))).collect()
}

/// How far what lies at places reaches into the beads of a layer, mm.
fn reaches_mm(layer: &LayerPaths, places: &[Point2], radius_mm: f64) -> impl Iterator<Item = (Point2, f64)> {
    let outline = SegmentIndex::try_new(&layer.material.contours);
    places.iter().map(move |&at| {
        let outline_mm = outline.as_ref().map_or(f64::INFINITY, |outline| outline.signed_distance_mm(at));
        let beads = layer.beads.iter().flat_map(|bead| bead.points.windows(2));
        let edge_mm = |pair: &[super::BeadPoint]| {
            (nearest_on_segment(at, pair[0].at, pair[1].at) - at).norm() - pair[0].width_mm / 2.0
        };
        let nearest_mm = beads.map(edge_mm).fold(f64::INFINITY, f64::min);
        let nearest_mm = if outline_mm < 0.0 { outline_mm } else { nearest_mm };
        (at, radius_mm - nearest_mm)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{Contour, Region};
    use crate::profile;
    use crate::progress::Task;
    use crate::slice::{Layer, LayerSlot};
    use crate::toolpath::plan;

    fn plate(half_mm: f64, n_layers: usize) -> Vec<Layer> {
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        let plate = Contour::new(corners.map(|(x, y)| Point2::new(x * half_mm, y * half_mm)).to_vec());
        let slot = |i: usize| LayerSlot { z_mid_mm: 0.2 * (i as f64 + 0.5), height_mm: 0.2, ct_plane: None };
        let layer =
            |i| Layer { slot: slot(i), material: Region::new(vec![plate.clone()]), lumen: Region::default() };
        (0..n_layers).map(layer).collect()
    }

    #[test]
    fn a_part_over_the_place_of_priming_is_told_with_line_and_depth() {
        let mut profile = profile::builtin("marlin").unwrap();
        profile.machine.bed_mm = [60.0, 60.0, 100.0];
        profile.print.skirt_loops = 0;
        let told = |half_mm: f64, profile: &Profile| {
            let warnings = plan(&plate(half_mm, 3), profile, &Task::quiet()).unwrap().warnings;
            warnings
                .into_iter()
                .filter(|w| w.code == "toolpath.primed_under")
                .map(|w| w.text)
                .collect::<Vec<_>>()
        };
        // A lump of 8 mm of filament, 1.66 mm around 5, 5; the part begins at 3, and 0.54 mm beside the lump.
        assert_eq!(told(22.8, &profile), Vec::<String>::new());
        let found = told(27.0, &profile);
        let begin = "line 12 of scripts.start, `G1 E8 F180`, primes the nozzle at x 5.00, y 5.00 mm of the bed, and what it lays \
                     down there reaches 3.66 mm into layer 0";
        assert!(found.len() == 1 && found[0].starts_with(begin), "{found:?}");
        // Its corner lies 0.71 mm from the middle of the lump.
        assert!(told(24.5, &profile)[0].contains("reaches 0.9"), "{:?}", told(24.5, &profile));
        // A skirt is in the way as well.
        (profile.print.skirt_loops, profile.print.skirt_distance_mm) = (1, 2.0);
        assert_eq!(told(22.8, &profile).len(), 1);
        profile.scripts.start.clear();
        assert_eq!(told(27.0, &profile), Vec::<String>::new());
    }
}
