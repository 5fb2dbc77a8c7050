#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "numbers of slices from heights of a few vessels"
)]

use super::super::{Body, Crotch, Params, Sectioned, Solid, build};
use super::*;
use crate::geom::{Point3, Region, Vector3};
use crate::phantom::{Kind, Vessel};

fn stack(planes: Vec<PlaneSections>) -> SectionStack {
    SectionStack { planes, patient_from_stack: RigidTransform::identity() }
}

fn phantom(kind: Kind) -> SectionStack {
    let vessel = Vessel::new(kind);
    let plane = |k: u32| {
        let z_mm = 3.0 * f64::from(k);
        PlaneSections { z_mm, contours: vessel.region_at(z_mm, 128).contours }
    };
    stack((0..46).map(plane).collect())
}

fn plane_of(z_mm: f64, contour: Contour) -> PlaneSections {
    PlaneSections { z_mm, contours: vec![contour] }
}

fn disk(x: f64, radius_mm: f64) -> Contour {
    Contour::circle(Point2::new(x, 0.0), radius_mm, 128)
}

/// Two tubes that bend towards each other half-way up; their walls of 1 mm fuse there.
fn near_touching() -> SectionStack {
    let plane = |k: u32| {
        let z_mm = 2.0 * f64::from(k);
        let gap = 0.5 + 0.012 * (z_mm - 20.0).powi(2);
        PlaneSections { z_mm, contours: vec![disk(-2.5 - 0.5 * gap, 2.5), disk(2.2 + 0.5 * gap, 2.2)] }
    };
    stack((0..21).map(plane).collect())
}

fn with_wall(stack: &SectionStack, wall_mm: f64) -> Solid {
    build(stack, &Params::new(Body::Wall { wall_mm }), &Task::quiet()).unwrap().solid
}

/// The lumen cut at close heights: distances in space without the feet that the outer skin was made with.
struct Slices {
    low: f64,
    slices: Vec<Option<SegmentIndex>>,
}

impl Slices {
    const STEP_MM: f64 = 0.02;

    fn of(solid: &Solid, [low, high]: [f64; 2]) -> Self {
        let n = ((high - low) / Self::STEP_MM).ceil() as usize;
        let cut = |k: usize| {
            let region = Region::new(solid.lumen.section(low + Self::STEP_MM * k as f64, 2e-4));
            SegmentIndex::try_new(&region.contours)
        };
        Self { low, slices: (0..=n).into_par_iter().map(cut).collect() }
    }

    /// Distance of a point outside the lumen from it, mm.
    fn distance_mm(&self, p: Point2, z_mm: f64, reach_mm: f64) -> f64 {
        let first = ((z_mm - reach_mm - self.low) / Self::STEP_MM).max(0.0) as usize;
        let n = (2.0 * reach_mm / Self::STEP_MM) as usize + 1;
        let near = self.slices.iter().enumerate().skip(first).take(n);
        let distance = |(k, index): (usize, &Option<SegmentIndex>)| {
            let dz = self.low + Self::STEP_MM * k as f64 - z_mm;
            Some(index.as_ref()?.signed_distance_mm(p).max(0.0).hypot(dz))
        };
        near.filter_map(distance).fold(f64::INFINITY, f64::min)
    }
}

/// Least and greatest thickness over the outer skin's sections between two heights.
fn thickness(solid: &Solid, wall_mm: f64, [low, high]: [f64; 2]) -> [f64; 2] {
    let slices = Slices::of(solid, [low - 1.3 * wall_mm, high + 1.3 * wall_mm]);
    let n = ((high - low) / 0.23) as usize;
    let heights: Vec<f64> = (0..n).map(|k| low + 0.23 * k as f64).collect();
    let range = |&z: &f64| {
        let outer = solid.section(z, 1e-3).outer;
        let points = outer.contours.iter().flat_map(|c| c.points.iter().step_by(2));
        points
            .map(|&p| slices.distance_mm(p, z, 1.2 * wall_mm))
            .fold([f64::INFINITY, 0.0f64], |[a, b], t| [a.min(t), b.max(t)])
    };
    let ranges: Vec<[f64; 2]> = heights.par_iter().map(range).collect();
    ranges.iter().fold([f64::INFINITY, 0.0], |[a, b], r| [a.min(r[0]), b.max(r[1])])
}

fn assert_thickness(stack: &SectionStack, wall_mm: f64, range_mm: [f64; 2], name: &str) {
    let [least, most] = thickness(&with_wall(stack, wall_mm), wall_mm, range_mm);
    assert!(least > wall_mm - 0.02 && most < wall_mm + 0.02, "{name}, {wall_mm} mm: {least} .. {most}");
}

#[test]
fn the_wall_is_as_thick_as_asked_across_a_split() {
    for wall_mm in [0.6, 1.0, 2.0] {
        assert_thickness(&phantom(Kind::Carotid), wall_mm, [58.0, 74.0], "carotid");
    }
}

#[test]
fn the_wall_is_as_thick_as_asked_across_a_merge() {
    assert_thickness(&phantom(Kind::Merge), 1.0, [40.0, 110.0], "merge");
}

#[test]
fn the_wall_is_as_thick_as_asked_elsewhere() {
    assert_thickness(&phantom(Kind::Stenosis), 1.0, [55.0, 90.0], "stenosis");
    assert_thickness(&phantom(Kind::Tube), 1.0, [30.0, 50.0], "tube");
}

/// A tube of which one contour juts out on one side, by more than planes are apart.
fn with_a_fin(out_mm: f64) -> SectionStack {
    let radius = |k: u32, phi: f64| if k == 8 { 6.0 + out_mm * (-(phi / 0.35).powi(2)).exp() } else { 6.0 };
    let contour = |k: u32| {
        let phi = |i: u32| std::f64::consts::TAU * (f64::from(i) / 128.0 - 0.5);
        let at = |phi: f64| Point2::new(radius(k, phi) * phi.cos(), radius(k, phi) * phi.sin());
        Contour::new((0..128).map(|i| at(phi(i))).collect())
    };
    stack((0..17).map(|k| PlaneSections { z_mm: 0.88 * f64::from(k), contours: vec![contour(k)] }).collect())
}

#[test]
fn the_outer_skin_goes_round_what_juts_out_on_one_plane() {
    for out_mm in [1.3, 2.0] {
        let params = Params::new(Body::Wall { wall_mm: 1.0 });
        let built = build(&with_a_fin(out_mm), &params, &Task::quiet()).unwrap();
        assert_eq!(built.solid.outer.as_ref().unwrap().tubes.len(), 1, "{out_mm} mm");
        let told = built.thickness.unwrap();
        assert!(told.least_mm > 0.97 && told.most_mm < 1.03, "{out_mm} mm: {told:?}");
        let [least, most] = thickness(&built.solid, 1.0, [4.0, 10.0]);
        assert!(least > 0.97 && most < 1.03, "{out_mm} mm: {least} .. {most}");
    }
}

#[test]
fn walls_of_branches_that_nearly_touch_fuse_and_part_again() {
    let solid = with_wall(&near_touching(), 1.0);
    let n_outer = |z: f64| solid.section(z, 1e-2).outer.contours.len();
    assert_eq!([n_outer(2.0), n_outer(20.0), n_outer(38.0)], [2, 1, 2]);
    assert_thickness(&near_touching(), 1.0, [3.0, 37.0], "near");
}

#[test]
fn branches_part_in_a_crease_of_the_outer_skin() {
    let solid = with_wall(&phantom(Kind::Carotid), 1.0);
    let [slab] = &solid.outer.as_ref().unwrap().slabs[..] else { panic!("one slab") };
    assert_eq!(slab.crotch, Crotch::Crease);
    let [first, second] = &slab.laterals;
    for v in [0.0, 0.3, 0.7, 1.0] {
        // One edge, met by both patches at both of its ends.
        assert!((first.at(0.0, v) - second.at(1.0, v)).norm() < 1e-9);
        assert!((first.at(1.0, v) - second.at(0.0, v)).norm() < 1e-9);
    }
    assert!((first.at(0.0, 1.0) - first.at(1.0, 1.0)).norm() < 1e-9, "front and back meet in the apex");
}

#[test]
fn an_end_inside_the_stack_is_closed_at_the_walls_thickness() {
    let planes = (0..12).map(|k| PlaneSections {
        z_mm: 2.0 * f64::from(k),
        contours: if k < 6 { vec![disk(-3.0, 2.0), disk(6.0, 1.5)] } else { vec![disk(-3.0, 2.0)] },
    });
    let stack = stack(planes.collect());
    let solid = with_wall(&stack, 1.0);
    let lumen = &solid.lumen;
    let wall = Wall::around(lumen, 1.0, &Task::quiet()).unwrap().unwrap();
    let (end, _) = wall.branches.iter().flat_map(|b| &b.inner_ends).copied().next().unwrap();
    assert_eq!(solid.section(end + 0.5, 1e-3).outer.contours.len(), 2);
    assert_eq!(solid.section(end + 1.5, 1e-3).outer.contours.len(), 1);
}

#[test]
fn what_the_union_makes_agrees_with_what_is_followed() {
    let solid = with_wall(&phantom(Kind::Carotid), 1.0);
    let wall = Wall::around(&solid.lumen, 1.0, &Task::quiet()).unwrap().unwrap();
    for z in [30.0, 62.3, 67.1, 90.4] {
        let followed = wall.followed(z).unwrap();
        let united = union::outlines(&solid.lumen, 1.0, z);
        assert_eq!(followed.len(), united.len(), "z {z}");
        let index = SegmentIndex::try_new(&united).unwrap();
        let off = followed.iter().flat_map(|c| &c.points).map(|&p| index.nearest(p).distance_mm);
        let farthest = off.fold(0.0, f64::max);
        assert!(farthest < 0.02, "z {z}: {farthest}");
    }
}

#[test]
fn the_thickness_that_is_told_is_what_cutting_the_lumen_tells() {
    let stack = phantom(Kind::Carotid);
    let built = build(&stack, &Params::new(Body::Wall { wall_mm: 1.0 }), &Task::quiet()).unwrap();
    let told = built.thickness.unwrap();
    let [least, most] = thickness(&built.solid, 1.0, [58.0, 74.0]);
    assert!((told.least_mm - least).abs() < 5e-3, "{} {least}", told.least_mm);
    assert!((told.most_mm - most).abs() < 5e-3, "{} {most}", told.most_mm);
    assert!(told.is_as_asked() && told.warning().is_none());
    assert!(told.least_mm <= told.p5_mm && told.p5_mm <= told.p95_mm);
}

#[test]
fn a_wall_that_is_not_as_thick_as_asked_is_noticed_where_it_is() {
    let mut planes = phantom(Kind::Tube).planes;
    planes.truncate(8);
    let solid = with_wall(&stack(planes), 1.0);
    let wall = Wall::around(&solid.lumen, 1.2, &Task::quiet()).unwrap().unwrap();
    let outer = solid.outer.unwrap();
    let off = thickness::measure(&outer, &solid.lumen, &wall.feet, 1.2, &Task::quiet()).unwrap().unwrap();
    assert!(!off.thickness.is_as_asked());
    assert!((off.thickness.least_mm - 1.0).abs() < 1e-3 && off.thickness.within_percent < 1e-9);
    let warning = off.thickness.warning().unwrap();
    assert!(warning.code == "solid.wall_thickness" && warning.text.contains("z "), "{}", warning.text);
    // All of the skin is 0.2 mm too near, less the slack.
    let [low, high] = outer.z_range_mm();
    let section = outer.section(0.5 * (low + high), 1e-4);
    let skin_mm2 = section[0].perimeter_mm() * (high - low);
    assert!((off.excess_mm3 / (skin_mm2 * 0.188) - 1.0).abs() < 0.2, "{} {skin_mm2}", off.excess_mm3);
}

#[test]
fn a_wall_of_less_than_half_of_what_was_asked_is_refused_with_its_place() {
    let mut planes = phantom(Kind::Tube).planes;
    planes.truncate(8);
    let solid = with_wall(&stack(planes), 1.0);
    let wall = Wall::around(&solid.lumen, 1.0, &Task::quiet()).unwrap().unwrap();
    let outer = solid.outer.unwrap();
    let measured = |asked_mm: f64| {
        let found = thickness::measure(&outer, &solid.lumen, &wall.feet, asked_mm, &Task::quiet());
        found.unwrap().unwrap().thickness
    };
    assert!(measured(1.9).check().is_ok());
    let refused = measured(2.1).check().unwrap_err().to_string();
    for part in
        ["z ", "x ", "y ", "1.00 mm thick where 2.10 mm", "choose another wall thickness", "add planes"]
    {
        assert!(refused.contains(part), "{refused}");
    }
    // The lumen's own skin taken for the outer one of a larger lumen lies inside it.
    let inside = thickness::measure(
        &solid.lumen,
        &outer,
        &Wall::around(&outer, 1.0, &Task::quiet()).unwrap().unwrap().feet,
        1.0,
        &Task::quiet(),
    );
    let refused = inside.unwrap().unwrap().thickness.check().unwrap_err().to_string();
    assert!(refused.contains("inside the lumen") && refused.contains("-1.0"), "{refused}");
}

#[test]
fn distances_found_on_the_surfaces_are_those_of_the_closed_form_and_of_dense_sections() {
    let pipe = with_wall(&stack((0..8).map(|k| plane_of(2.0 * f64::from(k), disk(0.0, 3.0))).collect()), 1.0);
    for k in 0..40 {
        let (sin, cos) = (0.41 * f64::from(k)).sin_cos();
        let off_mm = 0.4 + 0.03 * f64::from(k);
        let at = Point3::new((3.0 + off_mm) * cos, (3.0 + off_mm) * sin, 4.0 + 0.1 * f64::from(k));
        let found = verify::distance_mm(&pipe.lumen, at, 1.1 * off_mm);
        assert!((found - off_mm).abs() < 2e-5, "{found} {off_mm}");
    }
    let carotid = with_wall(&phantom(Kind::Carotid), 1.0);
    let outer = carotid.outer.as_ref().unwrap();
    let slices = Slices::of(&carotid, [64.0, 80.0]);
    for z in [66.1, 68.03, 70.4, 72.9, 73.3, 74.2, 77.7] {
        for point in outer.section(z, 1e-3).iter().flat_map(|c| c.points.iter().step_by(9)) {
            let found = verify::distance_mm(&carotid.lumen, at_height(*point, z), 1.1);
            let dense = slices.distance_mm(*point, z, 1.2);
            assert!((found - dense).abs() < 1e-3, "{z} {point}: {found} {dense}");
        }
    }
}

#[test]
fn a_wall_that_the_feet_take_for_thicker_than_it_is_is_told() {
    let pipe =
        |radius_mm: f64| stack((0..12).map(|k| plane_of(2.0 * f64::from(k), disk(0.0, radius_mm))).collect());
    let (solid, thinner) = (with_wall(&pipe(3.0), 1.0), with_wall(&pipe(2.95), 1.0));
    let measured = |lumen: &Skin| {
        let feet = Wall::around(lumen, 1.0, &Task::quiet()).unwrap().unwrap().feet;
        let outer = solid.outer.as_ref().unwrap();
        thickness::measure(outer, &solid.lumen, &feet, 1.0, &Task::quiet()).unwrap().unwrap().thickness
    };
    let right = measured(&solid.lumen);
    assert!(right.off_mm < 2e-4 && right.warning().is_none() && right.n_again > 60, "{right:?}");
    let wrong = measured(&thinner.lumen);
    assert!((wrong.off_mm - 0.05).abs() < 1e-3 && wrong.least_mm < 1.001, "{wrong:?}");
    let text = wrong.warning().expect("5 % off").text;
    assert!(text.contains("measured again in") && text.contains("0.050 mm off"), "{text}");
}

/// A level sheet of samples 0.3 mm apart.
fn sheet(z: f64, up: f64, shift: f64) -> Vec<Vec<feet::Sample>> {
    let row = |j: u32| {
        let at = |i: u32| Point3::new(0.3 * f64::from(i) + shift, 0.3 * f64::from(j) + shift, z);
        (0..12).map(|i| (at(i), Vector3::z() * up)).collect::<Vec<_>>()
    };
    let rows: Vec<_> = (0..12).map(row).collect();
    feet::grid_samples(&rows, false)
}

#[test]
fn a_foot_is_on_the_nearer_sheet_wherever_its_samples_lie() {
    let samples = [sheet(0.0, 1.0, 0.0), sheet(2.005, -1.0, 0.15)].concat();
    let feet = Feet::try_new(&samples).unwrap();
    // In the middle between samples of the lower sheet, right below one of the upper sheet.
    let foot = feet.foot(Point3::new(1.65, 1.65, 1.0));
    assert!((foot.distance_mm - 1.0).abs() < 1e-9 && foot.at.z.abs() < 1e-9, "{foot:?}");
}

#[test]
fn a_foot_is_on_the_surface_where_samples_are_much_closer_one_way_than_the_other() {
    // A groove of 0.1 mm between two walls that go on upward, 0.6 mm from sample to sample along it, 0.005 mm across.
    let groove = |k: u32| {
        let angle = std::f64::consts::PI * f64::from(k) / 60.0;
        let inward = Vector3::new(angle.cos(), 0.0, angle.sin());
        (Point3::new(0.0, 0.0, 0.0) - inward * 0.1, inward)
    };
    let row = |(at, normal): (Point3, Vector3)| -> Vec<feet::Oriented> {
        (0..12).map(|i| (at + Vector3::y() * (0.6 * f64::from(i)), normal)).collect()
    };
    let rows: Vec<_> = (0..=60).map(|k| row(groove(k))).collect();
    let feet = Feet::try_new(&feet::grid_samples(&rows, false)).unwrap();
    for (x, z) in [(0.0, 1.0), (0.03, 0.6), (-0.05, 1.4)] {
        let at = Point3::new(x, 3.3, z);
        let truth = (0..=60).map(|k| (at.xz() - groove(k).0.xz()).norm()).fold(f64::INFINITY, f64::min);
        let foot = feet.foot(at);
        assert!((foot.distance_mm.abs() - truth).abs() < 0.01, "{x} {z}: {} {truth}", foot.distance_mm);
    }
}

#[test]
fn the_wall_round_a_steep_ledge_is_followed_exactly() {
    // The branch widens by 2 mm over 1 mm of height.
    let radius = |k: u32| if k < 10 { 2.5 } else { 4.5 };
    let plane = |k: u32| PlaneSections { z_mm: f64::from(k), contours: vec![disk(0.0, radius(k))] };
    let solid = with_wall(&stack((0..20).map(plane).collect()), 1.0);
    let wall = Wall::around(&solid.lumen, 1.0, &Task::quiet()).unwrap().unwrap();
    for z in [8.2, 8.7, 9.1, 9.6, 10.2] {
        let united = union::outlines(&solid.lumen, 1.0, z);
        let off =
            united.iter().flat_map(|c| &c.points).map(|&p| wall.feet.foot(at_height(p, z)).distance_mm - 1.0);
        let farthest = off.map(f64::abs).fold(0.0, f64::max);
        assert!(farthest < 0.02, "z {z}: {farthest}");
    }
}

fn is_valid(solid: &Solid) -> bool {
    crate::brep::check(&crate::brep::Brep::of(solid, crate::mesh::SkinChoice::All)).is_ok()
}

#[test]
fn the_wall_round_a_trifurcation_is_a_valid_solid() {
    assert!(is_valid(&with_wall(&phantom(Kind::Trifurcation), 1.0)));
}

#[test]
fn a_wall_thicker_than_the_vessel_is_as_thick_as_asked() {
    let solid = with_wall(&phantom(Kind::Carotid), 4.0);
    assert!(is_valid(&solid));
    let [least, most] = thickness(&solid, 4.0, [58.0, 74.0]);
    assert!(least > 3.92 && most < 4.08, "{least} .. {most}");
}

/// A skin of a wall of 1 mm that is so thin somewhere, and so much off in all.
fn attempt(n_faults: usize, least_mm: f64, excess_mm3: f64) -> Attempt {
    let at = [0.0; 3];
    let thickness = Thickness {
        asked_mm: 1.0,
        least_mm,
        least_at_mm: at,
        p5_mm: 1.0,
        mean_mm: 1.0,
        p95_mm: 1.0,
        most_mm: 1.0,
        most_at_mm: at,
        within_percent: 99.0,
        n_samples: 1000,
        n_again: 96,
        off_mm: 0.0,
    };
    let measured = Measured { thickness, excess_mm3, off_z_mm: Vec::new() };
    Attempt { lofted: Lofted::default(), planes: Vec::new(), n_faults, measured }
}

#[test]
fn a_sound_wall_comes_before_an_accepted_one_and_that_before_an_even_one() {
    // From the best to the worst.
    let all = [
        attempt(0, 0.95, 0.1),
        attempt(0, 0.9, 0.2),
        attempt(0, 0.45, 0.108),
        attempt(1, 0.99, 0.0),
        attempt(2, 0.99, 0.0),
    ];
    for (i, a) in all.iter().enumerate() {
        for (j, b) in all.iter().enumerate() {
            assert_eq!(a.is_better_than(b), i < j, "{i} {j}");
        }
    }
    assert!(all[1].is_valid() && !all[2].is_valid() && !all[3].is_valid());
}

#[test]
fn a_wall_whose_thickness_is_no_number_is_refused() {
    for (least_mm, most_mm) in [(f64::NAN, 1.0), (0.9, f64::NAN), (0.9, f64::INFINITY)] {
        let mut thickness = attempt(0, least_mm, 0.0).measured.thickness;
        thickness.most_mm = most_mm;
        assert!(thickness.check().is_err(), "{least_mm} {most_mm}");
    }
}
