//! What gives a layer its time to cool: how much slower its beads are driven, how fast the fan turns, and where the nozzle waits
//! for what is missing then.
//!
//! A bead is slowed down no further than the profile allows; what others can take over of that they do. What a layer still lacks
//! then is waited for, where the profile wants that. Accelerations are left out: layers take longer than is reckoned here.

use crate::geom::{Bounds2, Point2, Region, SegmentIndex, Vector2};
use crate::profile::{PrintSettings, Profile};
use crate::toolpath::{Bead, BeadModel, LayerPaths};

/// The nozzle waits so far beside all that is printed, mm: its heat and what oozes from it stay off the part.
const ASIDE_MM: f64 = 10.0;
/// What a layer lacks less of than this is worth no way aside, s.
const SHORTEST_WAIT_S: f64 = 0.1;

/// The factor on speeds by which a layer takes its least time, as far as the slowest speed lets it.
pub(super) fn slow_down(layer: &LayerPaths, profile: &Profile, speed: impl Fn(&Bead) -> f64) -> f64 {
    let model = BeadModel::new(profile.print.bead_shape, layer.slot.height_mm);
    // Length and speed of each segment, as fast as profile and hotend allow.
    let segments = || {
        layer.beads.iter().flat_map(|bead| {
            let fastest_mm_s = speed(bead);
            bead.points.windows(2).map(move |p| {
                let area_mm2 = model.area_mm2(p[0].width_mm);
                let speed_mm_s = profile.filament.speed_within_flow_mm_s(fastest_mm_s, area_mm2);
                ((p[1].at - p[0].at).norm(), speed_mm_s)
            })
        })
    };
    let wanted_s = profile.print.min_layer_time_s.max(1e-9);
    let mut factor = (segments().map(|(mm, mm_s)| mm / mm_s).sum::<f64>() / wanted_s).min(1.0);
    // What is at its slowest leaves more to the others; each time round that is true of more of them.
    while factor < 1.0 {
        let (mut slowest_s, mut free_s) = (0.0, 0.0);
        for (mm, mm_s) in segments() {
            let least_mm_s = profile.print.min_speed_mm_s.min(mm_s);
            let is_slowest = factor * mm_s <= least_mm_s;
            *(if is_slowest { &mut slowest_s } else { &mut free_s }) +=
                mm / if is_slowest { least_mm_s } else { mm_s };
        }
        let next = free_s / (wanted_s - slowest_s);
        if free_s <= 0.0 || factor - next < 1e-9 {
            break;
        }
        factor = next;
    }
    factor
}

/// Time of a layer with what is waited for, s; of the one whose beads and ways take so long.
pub(super) fn layer_time_s(driven_s: f64, is_last: bool, profile: &Profile) -> f64 {
    let print = &profile.print;
    if !is_last && is_too_short(driven_s, print) { print.min_layer_time_s } else { driven_s }
}

/// Whether a layer that took so long is waited for.
pub(super) fn is_too_short(time_s: f64, print: &PrintSettings) -> bool {
    print.min_layer_time_wait && print.min_layer_time_s - time_s >= SHORTEST_WAIT_S
}

/// Where the nozzle waits: straight beside all that is printed, on the side towards which the way crosses the lumen least, of
/// these where there is room on the bed, of these the nearest.
pub(super) fn aside(from: Point2, printed: Bounds2, lumen: &Region, bed_mm: [f64; 3]) -> Point2 {
    let sides = [
        Point2::new(printed.min.x - ASIDE_MM, from.y),
        Point2::new(printed.max.x + ASIDE_MM, from.y),
        Point2::new(from.x, printed.min.y - ASIDE_MM),
        Point2::new(from.x, printed.max.y + ASIDE_MM),
    ];
    let lumen = SegmentIndex::try_new(&lumen.contours);
    let on_bed =
        |p: Point2| Point2::from(p.coords.sup(&Vector2::zeros()).inf(&Vector2::new(bed_mm[0], bed_mm[1])));
    let rated = sides.map(|side| {
        let to = on_bed(side);
        let n_crossings = lumen.as_ref().map_or(0, |lumen| lumen.crossings(from, to).len());
        (n_crossings, (side - to).norm(), (to - from).norm(), to)
    });
    let order = |a: &(usize, f64, f64, Point2), b: &(usize, f64, f64, Point2)| {
        a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.total_cmp(&b.2))
    };
    rated.into_iter().min_by(order).map_or(from, |best| best.3)
}

/// The fan for a layer of a duration: most in short ones, least in long ones, in proportion between.
pub(super) fn fan_percent(idx: usize, time_s: f64, profile: &Profile) -> f64 {
    let filament = &profile.filament;
    if idx < filament.fan_from_layer as usize {
        return 0.0;
    }
    let [short, long] = filament.fan_layer_time_s;
    let share = ((time_s - short) / (long - short).max(1e-9)).clamp(0.0, 1.0);
    filament.fan_percent + (filament.fan_least_percent - filament.fan_percent) * share
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Contour;

    #[test]
    fn the_way_aside_keeps_out_of_the_lumen_and_on_the_bed() {
        let circle = Contour::circle(Point2::new(50.0, 50.0), 3.0, 60);
        let lumen = Region::new(vec![circle]);
        let printed = Bounds2::of([Point2::new(46.0, 46.0), Point2::new(54.0, 54.0)]).unwrap();
        let bed = [100.0, 100.0, 100.0];
        let nearest = |from| aside(from, printed, &lumen, bed);
        assert_eq!(nearest(Point2::new(53.5, 50.0)), Point2::new(64.0, 50.0));
        assert_eq!(nearest(Point2::new(50.5, 46.5)), Point2::new(50.5, 36.0));
        // On a bed that ends beside the part it goes the longer way, but never across the lumen.
        let narrow = [58.0, 100.0, 100.0];
        assert_eq!(aside(Point2::new(53.0, 53.5), printed, &lumen, narrow), Point2::new(53.0, 64.0));
        assert_eq!(aside(Point2::new(53.5, 50.0), printed, &lumen, narrow), Point2::new(53.5, 36.0));
        let beside = Point2::new(53.9, 50.0);
        let tight = Bounds2 { min: Point2::new(0.0, 0.0), max: Point2::new(58.0, 100.0) };
        assert_eq!(aside(beside, tight, &lumen, narrow), Point2::new(58.0, 50.0));
    }
}
