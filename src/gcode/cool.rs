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
/// Where there is no room for that, at least so far beside what has just been printed, mm.
const BESIDE_MM: f64 = 2.0;
/// Directions in which a way aside is looked for, and places that are looked at along each.
const N_WAYS: u32 = 64;
const N_PLACES: u32 = 16;
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

/// What the nozzle waits beside.
pub(super) struct Around<'a> {
    /// All that is printed in the job.
    pub(super) printed: Bounds2,
    /// What has just been printed.
    pub(super) material: &'a Region,
    /// What no way crosses.
    pub(super) lumens: [&'a Region; 2],
    /// Size of the machine, mm.
    pub(super) bed_mm: [f64; 3],
}

impl Around<'_> {
    /// Where the nozzle waits that comes from a place and has time for a way of so many millimetres: beside all that is printed, at the end
    /// of the shortest straight way that crosses no lumen; where there is no room or no time for that, on the free place farthest from what
    /// has just been printed. `None`: there is none either, and it waits where it is, lifted.
    pub(super) fn aside(&self, from: Point2, most_mm: f64) -> Option<Point2> {
        let lumens: Vec<_> = self.lumens.iter().filter_map(|l| SegmentIndex::try_new(&l.contours)).collect();
        let is_clear = |p: &Point2| lumens.iter().all(|lumen| lumen.crossings(from, *p).is_empty());
        let is_near = |p: &Point2| (p - from).norm() <= most_mm;
        let is_on_bed = |p: &Point2| [0, 1].iter().all(|&k| (0.0..=self.bed_mm[k]).contains(&p[k]));
        let is_free = |p: &Point2| is_on_bed(p) && is_near(p) && is_clear(p);
        let length = |p: &Point2| (p - from).norm();
        let outside =
            ways().map(|along| end_of_way(from, along, self.printed.grown(ASIDE_MM))).filter(is_free);
        outside
            .min_by(|a, b| length(a).total_cmp(&length(b)))
            .or_else(|| self.beside(from, most_mm, is_clear))
    }

    /// The place farthest from what has just been printed, if it is not above it.
    fn beside(&self, from: Point2, most_mm: f64, is_clear: impl Fn(&Point2) -> bool) -> Option<Point2> {
        let material = SegmentIndex::try_new(&self.material.contours)?;
        let corner = |k: usize| Point2::new(k as f64 * self.bed_mm[0], k as f64 * self.bed_mm[1]);
        let bed = Bounds2 { min: corner(0), max: corner(1) };
        let places = ways().flat_map(|along| {
            let way = end_of_way(from, along, bed) - from;
            let way = way * (most_mm / way.norm().max(1e-9)).min(1.0);
            (1..=N_PLACES).map(move |k| from + way * (f64::from(k) / f64::from(N_PLACES)))
        });
        // Inside of material the distance is negative.
        let free = places
            .map(|p| (material.signed_distance_mm(p), p))
            .filter(|(far_mm, p)| *far_mm >= BESIDE_MM && is_clear(p));
        free.reduce(|a, b| if b.0 > a.0 { b } else { a }).map(|(_, p)| p)
    }
}

/// Directions in which a way aside is looked for.
fn ways() -> impl Iterator<Item = Vector2> {
    (0..N_WAYS).map(|k| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / f64::from(N_WAYS)).sin_cos();
        Vector2::new(cos, sin)
    })
}

/// Where a straight way out of a box ends.
fn end_of_way(from: Point2, along: Vector2, out_of: Bounds2) -> Point2 {
    let length = |k: usize| {
        let wall = if along[k] > 0.0 { out_of.max[k] } else { out_of.min[k] };
        if along[k].abs() < 1e-9 { f64::INFINITY } else { (wall - from[k]) / along[k] }
    };
    from + along * length(0).min(length(1)).max(0.0)
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

    fn ring(centre: Point2, radius_mm: f64) -> Contour {
        Contour::circle(centre, radius_mm, 60)
    }

    const BED_MM: [f64; 3] = [100.0, 100.0, 100.0];

    /// The place for a nozzle with time, all that is printed being in the way.
    fn aside(from: Point2, printed: Bounds2, lumens: [&Region; 2], bed_mm: [f64; 3]) -> Option<Point2> {
        let corners = [printed.min, Point2::new(printed.max.x, printed.min.y), printed.max];
        let all = [corners[0], corners[1], corners[2], Point2::new(printed.min.x, printed.max.y)];
        let material = Region::new(vec![Contour::new(all.to_vec())]);
        Around { printed, material: &material, lumens, bed_mm }.aside(from, 1e3)
    }

    #[test]
    fn where_there_is_no_room_outside_it_waits_on_the_free_place_farthest_from_what_it_printed() {
        // Posts near the corners of the bed, and the middle is empty.
        let posts = [(7.0, 7.0), (93.0, 7.0), (93.0, 93.0), (7.0, 93.0)];
        let material = Region::new(posts.map(|(x, y)| ring(Point2::new(x, y), 2.0)).to_vec());
        let printed = Bounds2::of(material.contours.iter().flat_map(|c| c.points.iter().copied())).unwrap();
        let none = Region::default();
        let around = Around { printed, material: &material, lumens: [&none; 2], bed_mm: BED_MM };
        let from = Point2::new(92.0, 92.0);
        let clearance =
            |to: Point2| -SegmentIndex::try_new(&material.contours).unwrap().signed_distance_mm(to).min(0.0);
        let to = around.aside(from, 1e3).unwrap();
        assert!((to - Point2::new(50.0, 50.0)).norm() < 8.0 && clearance(to) == 0.0, "{to}");
        // With time for 6 mm alone it goes those.
        let to = around.aside(from, 6.0).unwrap();
        assert!(((to - from).norm() - 6.0).abs() < 1e-9, "{to}");
        // And from the middle of a plate there is no place.
        let plate = Region::new(vec![ring(Point2::new(50.0, 50.0), 45.0)]);
        let plate = Around { material: &plate, ..around };
        assert_eq!(plate.aside(Point2::new(50.0, 50.0), 20.0), None);
    }

    #[test]
    fn the_way_aside_keeps_out_of_the_lumen_and_on_the_bed() {
        let lumen = Region::new(vec![ring(Point2::new(50.0, 50.0), 3.0)]);
        let printed = Bounds2::of([Point2::new(46.0, 46.0), Point2::new(54.0, 54.0)]).unwrap();
        let is_at = |from, bed, at: Option<Point2>| match (aside(from, printed, [&lumen; 2], bed), at) {
            (Some(found), Some(at)) => (found - at).norm() < 1e-9,
            (found, at) => found == at,
        };
        assert!(is_at(Point2::new(53.5, 50.0), BED_MM, Some(Point2::new(64.0, 50.0))));
        assert!(is_at(Point2::new(50.5, 46.5), BED_MM, Some(Point2::new(50.5, 36.0))));
        // On a bed that ends beside the part it goes the longer way, but never across the lumen.
        let narrow = [58.0, 100.0, 100.0];
        assert!(is_at(Point2::new(53.5, 50.0), narrow, Some(Point2::new(53.5, 64.0))));
        // Where there is no room anywhere it stays.
        let everywhere = Bounds2::of([Point2::new(0.0, 0.0), Point2::new(58.0, 100.0)]).unwrap();
        assert_eq!(aside(Point2::new(53.5, 50.0), everywhere, [&lumen; 2], narrow), None);
    }

    #[test]
    fn the_way_aside_keeps_out_of_the_lumen_of_the_layer_to_come_too() {
        let from = Point2::new(53.5, 50.0);
        let printed = Bounds2::of([Point2::new(46.0, 46.0), Point2::new(56.0, 54.0)]).unwrap();
        let lumen = Region::new(vec![ring(Point2::new(50.0, 50.0), 3.0)]);
        let above = Region::new(vec![ring(Point2::new(55.0, 50.0), 0.5)]);
        let way = |lumens: [&Region; 2]| aside(from, printed, lumens, BED_MM).unwrap();
        let crossed = |to| SegmentIndex::try_new(&above.contours).unwrap().crossings(from, to).len();
        assert_eq!(crossed(way([&lumen; 2])), 2, "else this layer alone would do");
        assert_eq!(crossed(way([&lumen, &above])), 0);
    }

    #[test]
    fn a_way_out_is_found_between_lumens_and_through_the_mouth_of_one() {
        let five = [(0.0, 0.0), (12.0, 0.0), (-12.0, 0.0), (0.0, 12.0), (0.0, -12.0)];
        let lumen = Region::new(five.map(|(x, y)| ring(Point2::new(50.0 + x, 50.0 + y), 2.0)).to_vec());
        let printed = Bounds2::of([Point2::new(35.0, 35.0), Point2::new(65.0, 65.0)]).unwrap();
        let is_clear = |from: Point2, lumen: &Region| {
            let index = SegmentIndex::try_new(&lumen.contours).unwrap();
            aside(from, printed, [lumen; 2], BED_MM).is_some_and(|to| index.crossings(from, to).is_empty())
        };
        assert!(is_clear(Point2::new(51.77, 51.77), &lumen));
        // Open by 60 degrees towards the corner of the bed.
        let at = |radius: f64, degrees: f64| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            Point2::new(50.0 + radius * cos, 50.0 + radius * sin)
        };
        let outer = (0..=60).map(|i| at(12.0, 75.0 + 5.0 * f64::from(i)));
        let inner = (0..=60).map(|i| at(8.0, 375.0 - 5.0 * f64::from(i)));
        let arch = Region::new(vec![Contour::new(outer.chain(inner).collect())]);
        assert!(is_clear(at(7.5, 225.0), &arch));
        // From within a closed one there is none.
        assert!(
            aside(at(0.0, 0.0), printed, [&Region::new(vec![ring(at(0.0, 0.0), 9.0)]); 2], BED_MM).is_none()
        );
    }
}
