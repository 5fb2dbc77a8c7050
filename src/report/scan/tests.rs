//! Replicas that are voxelised as a scanner would see them, turned and moved: found again, and what is wrong with them told.

#![expect(
    clippy::cast_possible_truncation,
    reason = "voxels of a made-up scan: some hundred along an axis, values of a CT"
)]

use super::*;
use crate::ct::Voxels;
use crate::geom::{Point3, Vector3};
use crate::progress::Task;
use crate::report::testing::{self, Forked, WALL_MM, fork};
use crate::report::{Error, Finding, Kind, Report, Stage, build};
use nalgebra::{Rotation3, Unit};

const N_PLANES: usize = 10;
const VOXEL_MM: f64 = 0.3;
const BLUR_MM: f64 = 0.3;
const AIR_HU: f64 = -1000.0;
const MATERIAL_HU: f64 = 150.0;

/// Where the replica lies in the scanner, and what is different about it.
struct Replica {
    turn: Rotation3<f64>,
    shift: Vector3,
    scale: f64,
    is_mirrored: bool,
    /// Sides of a voxel, mm; planes are as thick as they are apart.
    voxel_mm: [f64; 3],
    /// What the image shows around the part, mm.
    margin_mm: f64,
    noise_hu: f64,
    /// Whether there is material, by place in the model's frame.
    is_material: Box<dyn Fn(Point3) -> bool>,
}

impl Replica {
    fn new(is_material: impl Fn(Point3) -> bool + 'static) -> Self {
        let axis = Unit::new_normalize(Vector3::new(0.3, 0.9, 0.5));
        Self {
            turn: Rotation3::from_axis_angle(&axis, 1.9),
            shift: Vector3::new(31.4, -22.7, 140.9),
            scale: 1.0,
            is_mirrored: false,
            voxel_mm: [VOXEL_MM; 3],
            margin_mm: 2.0,
            noise_hu: 40.0,
            is_material: Box::new(is_material),
        }
    }

    /// The right replica.
    fn right() -> Self {
        Self::new(is_printed)
    }

    fn to_scan(&self, p: Point3) -> Point3 {
        let p = if self.is_mirrored { Point3::new(-p.x, p.y, p.z) } else { p };
        self.turn * (p * self.scale) + self.shift
    }

    fn model_of(&self, p: Point3) -> Point3 {
        let p = (self.turn.inverse() * (p - self.shift)) / self.scale;
        if self.is_mirrored { Point3::new(-p.x, p.y, p.z) } else { p }
    }

    /// A scan of it: coverage by 2 x 2 x 2 places a voxel, blur, noise.
    fn scanned(&self) -> Volume {
        let range = z_range_mm();
        let corner = |i: usize| {
            let side = |bit: usize| if i >> bit & 1 == 0 { -9.0 } else { 9.0 };
            self.to_scan(Point3::new(side(0), side(1), range[i >> 2]))
        };
        let corners: Vec<Point3> = (0..8).map(corner).collect();
        let least =
            |axis: usize| corners.iter().map(|c| c[axis]).fold(f64::INFINITY, f64::min) - self.margin_mm;
        let most =
            |axis: usize| corners.iter().map(|c| c[axis]).fold(f64::NEG_INFINITY, f64::max) + self.margin_mm;
        let side = self.voxel_mm;
        let dims = [0, 1, 2].map(|a| ((most(a) - least(a)) / side[a]).ceil() as usize);
        let origin = [0, 1, 2].map(least);
        let covered = |x: usize, y: usize, z: usize| {
            let inside = (0..8).filter(|s| {
                let at = |bit: usize, i: usize| {
                    origin[bit] + side[bit] * (i as f64 + if s >> bit & 1 == 0 { -0.25 } else { 0.25 })
                };
                (self.is_material)(self.model_of(Point3::new(at(0, x), at(1, y), at(2, z))))
            });
            inside.count() as f64 / 8.0
        };
        let n = dims[0] * dims[1];
        let mut values: Vec<f64> =
            (0..n * dims[2]).map(|v| covered(v % dims[0], v % n / dims[0], v / n)).collect();
        for (axis, stride) in [1, dims[0], n].into_iter().enumerate() {
            values = blurred(&values, stride, dims[axis], BLUR_MM / side[axis]);
        }
        let mut seed = 0x9e37_79b9_7f4a_7c15_u64;
        let mut noise = || {
            // The sum of four even ones is near enough to normal.
            let even = (0..4).map(|_| {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (seed >> 33) as f64 / f64::from(1u32 << 31) - 0.5
            });
            self.noise_hu * even.sum::<f64>() * 3f64.sqrt()
        };
        let hu: Vec<f32> =
            values.iter().map(|v| (AIR_HU + (MATERIAL_HU - AIR_HU) * v + noise()) as f32).collect();
        Volume {
            dims,
            hu: Voxels::new(&hu, n),
            origin_xy_mm: [origin[0], origin[1]],
            pixel_spacing_xy_mm: [side[0], side[1]],
            plane_z_mm: (0..dims[2]).map(|k| origin[2] + side[2] * k as f64).collect(),
            slab_thickness_mm: side[2],
            patient_from_stack: RigidTransform::identity(),
        }
    }
}

fn blurred(values: &[f64], stride: usize, length: usize, sigma: f64) -> Vec<f64> {
    let reach = (4.0 * sigma).ceil() as usize;
    let weights: Vec<f64> = (0..=reach).map(|d| (-0.5 * (d as f64 / sigma).powi(2)).exp()).collect();
    let sum = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
    (0..values.len())
        .map(|v| {
            let at = v / stride % length;
            let mut total = weights[0] * values[v];
            for (d, w) in weights.iter().enumerate().skip(1) {
                total += w * if at >= d { values[v - d * stride] } else { 0.0 };
                total += w * if at + d < length { values[v + d * stride] } else { 0.0 };
            }
            total / sum
        })
        .collect()
}

fn z_range_mm() -> [f64; 2] {
    [-1.5, 3.0 * (N_PLANES - 1) as f64 + 1.5]
}

/// Whether the forked vessel's wall is there.
fn is_printed(p: Point3) -> bool {
    let [low, high] = z_range_mm();
    if p.z < low || p.z > high {
        return false;
    }
    let within = |wider_mm: f64| fork(p.z, N_PLANES).iter().any(|(c, r)| (p.xy() - c).norm() <= r + wider_mm);
    within(WALL_MM) && !within(0.0)
}

fn inputs<'a>(case: &'a Forked, scan: Option<&'a Volume>) -> Inputs<'a> {
    Inputs { scan, ..testing::inputs(case) }
}

fn reported(volume: &Volume) -> Result<Report, Error> {
    build(&inputs(&Forked::new(N_PLANES), Some(volume)), &Task::quiet())
}

fn report(replica: &Replica) -> Report {
    reported(&replica.scanned()).unwrap()
}

/// What the scan shows to be wrong, in words.
fn told(report: &Report) -> String {
    format!(
        "{:#?}\n{:#?}\n{:#?}",
        report.findings,
        report.verdict.failures,
        report.scan.as_ref().map(|s| (&s.registration, s.uncertainty_mm, s.levels, s.block.overall))
    )
}

fn of_scan(report: &Report) -> Vec<&Finding> {
    report.findings.iter().filter(|f| f.stage == "scan").collect()
}

#[test]
fn a_right_replica_is_found_where_it_lies_and_nothing_is_wrong_with_it() {
    let replica = Replica::right();
    let report = report(&replica);
    let scan = report.scan.as_ref().unwrap();
    let found = scan.registration.model_from_scan.unwrap();
    let corners = [[-6.0, -4.0, -1.5], [6.0, 4.0, 28.5], [-6.0, 4.0, 28.5], [6.0, -4.0, -1.5]];
    for corner in corners {
        let p = Point3::from(corner);
        let off = (found.apply(replica.to_scan(p)) - p).norm();
        assert!(off < 0.02, "{off} at {p}: {}", told(&report));
    }
    for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
        let turned = found.rotate(replica.turn * axis);
        assert!(turned.angle(&axis).to_degrees() < 0.1);
    }
    assert!(of_scan(&report).is_empty() && report.verdict.passed, "{}", told(&report));
    let f = scan.block.overall.unwrap().figures;
    assert!(f.mean_mm.unwrap() < 0.03 && f.bias_mm.unwrap().abs() < 0.015, "{}", told(&report));
    assert!(scan.registration.scale_percent.unwrap().abs() < 0.1, "{}", told(&report));
    // In all that is written, the stage has its name.
    assert_eq!(crate::report::schema::tests::broken(&report), [""; 0]);
    let json: serde_json::Value = serde_json::from_str(&report.to_json().unwrap()).unwrap();
    let table = crate::report::csv(&report);
    let column = table.lines().next().unwrap().split(',').position(|n| n == "scan_mean_mm").unwrap();
    for (k, row) in table.lines().skip(1).enumerate() {
        let mean = json["scan"]["planes"][k]["mean_mm"].as_f64().unwrap();
        assert_eq!(row.split(',').nth(column).unwrap().parse::<f64>().unwrap(), mean);
    }
    let of_stage =
        |list: &serde_json::Value| list.as_array().unwrap().iter().any(|s| s["stage"] == "scanned");
    assert!(of_stage(&json["walls"]) && of_stage(&json["amounts"]["lumen"]));
    assert!(of_stage(&json["anatomy"]["branches"][0]["stages"]));
    let page = crate::report::html(&report).unwrap();
    assert!(page.contains(Stage::Scan.meaning()) && page.contains("report.scan"));
    let view = crate::report::page::view(&report).unwrap();
    assert!(!crate::report::pdf::document(&report, &view).unwrap().is_empty());
}

#[test]
fn a_replica_one_percent_too_large_is_told_with_its_scale() {
    let report = report(&Replica { scale: 1.01, ..Replica::right() });
    let found = of_scan(&report);
    assert!(found.len() == 1 && found[0].kind == Kind::Scaled, "{}", told(&report));
    assert!((found[0].size.unwrap().size - 1.0).abs() < 0.1, "{}", told(&report));
    assert!(found[0].beyond_gate && !report.verdict.passed);
}

#[test]
fn a_plugged_branch_is_told_with_its_planes() {
    // The right one of the two branches is closed over the height of planes 6 and 7.
    let plug = |p: Point3| {
        let (centre, radius_mm) = fork(p.z, N_PLANES).pop().unwrap();
        (17.0..22.5).contains(&p.z) && (p.xy() - centre).norm() <= radius_mm
    };
    let report = report(&Replica::new(move |p| is_printed(p) || plug(p)));
    let found = of_scan(&report);
    assert!(found.len() == 1 && found[0].kind == Kind::Plugged, "{}", told(&report));
    assert_eq!(found[0].place.planes, Some([6, 7]));
    assert!(found[0].place.branch.is_some() && !report.verdict.passed);
}

#[test]
fn layers_beside_their_place_are_told_from_where_on_and_how_far() {
    let report = report(&Replica::new(|p| {
        let by = if p.z > 16.5 { Vector3::new(0.32, -0.24, 0.0) } else { Vector3::zeros() };
        is_printed(p - by)
    }));
    let found = of_scan(&report);
    assert!(!found.is_empty() && found.iter().all(|f| f.kind == Kind::OutlineShifted), "{}", told(&report));
    // The pose follows one of the two parts: the other one lies beside its place.
    let planes = found[0].place.planes.unwrap();
    assert!(planes == [6, 9] || planes == [0, 5], "{}", told(&report));
    assert!((found[0].size.unwrap().size - 0.4).abs() < 0.04, "{}", told(&report));
    assert!(!report.verdict.passed);
}

#[test]
fn a_mirrored_replica_is_told_and_not_laid_over_the_model() {
    let report = report(&Replica { is_mirrored: true, ..Replica::right() });
    let scan = report.scan.as_ref().unwrap();
    assert!(scan.registration.mirrored && scan.registration.model_from_scan.is_none());
    assert!(scan.block.overall.is_none() && scan.block.reason.is_some());
    let found = of_scan(&report);
    assert!(found.len() == 1 && found[0].kind == Kind::Mirrored, "{}", told(&report));
    // Levels are read at the model's skin, where a mirror image does not lie.
    assert!(scan.levels.air_hu.is_none() && scan.levels.blur_mm.is_none());
    assert!(!report.verdict.passed);
}

#[test]
fn a_scan_changes_no_other_stage() {
    let replica = Replica { scale: 1.01, ..Replica::right() };
    let with = report(&replica);
    let case = Forked::new(N_PLANES);
    let without = build(&inputs(&case, None), &Task::quiet()).unwrap();
    for stage in Stage::ALL {
        assert_eq!(with.block(stage), without.block(stage));
    }
    assert!(without.scan.is_none() && without.verdict.passed);
}

#[test]
fn what_shows_no_replica_is_refused_with_words() {
    let refused = |replica: &Replica| match reported(&replica.scanned()) {
        Err(Error::Scan(refusal)) => refusal,
        other => panic!("{:?}", other.map(|r| told(&r))),
    };
    let ball = refused(&Replica::new(|p| (p - Point3::new(0.0, 0.0, 10.0)).norm() < 2.0));
    assert!(matches!(ball, Refusal::NoBody { .. }) && ball.to_string().contains("mm³"), "{ball}");
    let block = refused(&Replica::new(|p| p.x.abs() < 4.0 && p.y.abs() < 4.0 && (3.0..21.0).contains(&p.z)));
    assert!(matches!(block, Refusal::NoFit { .. }), "{block}");
}

#[test]
fn a_straight_tube_does_not_tell_how_it_lies() {
    let case = testing::Case::new(4);
    let replica =
        Replica::new(|p| (3.0..=4.2).contains(&p.xy().coords.norm()) && (-1.5..10.5).contains(&p.z));
    let inputs = Inputs { scan: Some(&replica.scanned()), ..testing::inputs(&case) };
    let refused = build(&inputs, &Task::quiet()).unwrap_err();
    assert!(matches!(&refused, Error::Scan(Refusal::Ambiguous { .. } | Refusal::Loose { .. })), "{refused}");
}

/// Volume of what is there by one description and not by the other, mm³.
fn volume_mm3(is_there: impl Fn(Point3) -> bool) -> f64 {
    let step = 0.15;
    let places = |n: i32| (-n..n).map(move |i| step * (f64::from(i) + 0.5));
    let inside = places(60).flat_map(|x| places(60).map(move |y| (x, y)));
    let planes = (0..210).map(|i| -1.75 + step * f64::from(i));
    let n =
        inside.flat_map(|(x, y)| planes.clone().map(move |z| Point3::new(x, y, z))).filter(|p| is_there(*p));
    n.count() as f64 * step.powi(3)
}

/// The only finding of the scan, of this kind, with its size within 10 %.
fn only(report: &Report, kind: Kind, expected_mm3: f64) -> Finding {
    let found = of_scan(report);
    assert!(found.len() == 1 && found[0].kind == kind, "{expected_mm3}: {}", told(report));
    let size = found[0].size.unwrap();
    assert!(
        size.unit == "mm3" && (size.size - expected_mm3).abs() < 0.1 * expected_mm3,
        "{expected_mm3}: {}",
        told(report)
    );
    assert!(found[0].beyond_gate && !report.verdict.passed, "{}", told(report));
    found[0].clone()
}

/// Whether a place is in the wall of the right one of the two branches alone.
fn in_right_wall(p: Point3) -> bool {
    let circles = fork(p.z, N_PLANES);
    let off = |i: usize| (p.xy() - circles[i].0).norm() - circles[i].1;
    circles.len() == 2 && is_printed(p) && off(1) <= WALL_MM && off(0) > WALL_MM
}

#[test]
fn a_branch_that_is_not_there_is_missing_with_its_name_and_size() {
    let gone = |p: Point3| p.z > 21.0 && in_right_wall(p);
    let report = report(&Replica::new(move |p| is_printed(p) && !gone(p)));
    let found = only(&report, Kind::MissingMaterial, volume_mm3(gone));
    assert_eq!(found.place.branch.as_deref(), Some("branch 3"), "{}", told(&report));
    assert_eq!(found.place.planes, Some([7, 9]));
    let [low, high] = found.place.z_mm.unwrap();
    assert!((low - 21.0).abs() < 0.5 && (high - 28.5).abs() < 0.6, "{found:?}");
    assert!(found.text.contains("branch 3 is missing from z") && report.verdict.failures[0] == found.text);
    // What the wall would have enclosed is no lumen.
    let scanned = report.anatomy.branches[2].stages.iter().find(|s| s.stage == "scanned").unwrap();
    assert!(scanned.planes.iter().all(|p| p.plane < 8), "{scanned:?}");
}

#[test]
fn a_hole_in_the_wall_between_the_planes_is_found_with_its_size() {
    let (centre, radius_mm) = fork(7.5, N_PLANES)[0];
    let at = Point3::new(centre.x + radius_mm + 0.5 * WALL_MM, centre.y, 7.5);
    let hole = move |p: Point3| (p - at).norm() < 1.2;
    let report = report(&Replica::new(move |p| is_printed(p) && !hole(p)));
    let found = only(&report, Kind::MissingMaterial, volume_mm3(|p| is_printed(p) && hole(p)));
    let [low, high] = found.place.z_mm.unwrap();
    assert!((low - 6.3).abs() < 0.5 && (high - 8.7).abs() < 0.5, "{found:?}");
    assert!(!found.text.contains("is missing from"), "{found:?}");
}

#[test]
fn a_hole_is_found_where_the_outlines_lie_beside_their_place() {
    let by = |p: Point3| if p.z > 16.5 { Vector3::new(0.28, -0.21, 0.0) } else { Vector3::zeros() };
    for z_mm in [7.5, 22.5] {
        let (centre, radius_mm) = fork(z_mm, N_PLANES)[0];
        let at = Point3::new(centre.x - radius_mm - 0.5 * WALL_MM, centre.y, z_mm);
        let hole = move |p: Point3| (p - at).norm() < 1.3;
        let report = report(&Replica::new(move |p| is_printed(p - by(p)) && !hole(p - by(p))));
        let found = of_scan(&report);
        let holes: Vec<_> = found.iter().filter(|f| f.kind == Kind::MissingMaterial).collect();
        assert!(holes.len() == 1 && found.len() > 1, "{}", told(&report));
        let expected = volume_mm3(|p| is_printed(p) && hole(p));
        let size = holes[0].size.unwrap().size;
        assert!((size - expected).abs() < 0.15 * expected, "{expected}: {}", told(&report));
        let [low, high] = holes[0].place.z_mm.unwrap();
        assert!(low < z_mm && z_mm < high && high - low < 3.5, "{:?}", holes[0]);
    }
}

#[test]
fn a_strand_and_a_lump_in_the_lumen_are_found_with_their_size() {
    let (centre, radius_mm) = fork(7.0, N_PLANES)[0];
    let is_lumen = move |p: Point3| fork(p.z, N_PLANES).iter().any(|(c, r)| (p.xy() - c).norm() <= *r);
    let strand = move |p: Point3| is_lumen(p) && (p.y - centre.y).hypot(p.z - 7.0) < 0.6;
    let lump =
        move |p: Point3| is_lumen(p) && (p - Point3::new(centre.x - radius_mm, centre.y, 7.0)).norm() < 1.6;
    let report_of_strand = report(&Replica::new(move |p| is_printed(p) || strand(p)));
    let [found] = of_scan(&report_of_strand)[..] else { panic!("{}", told(&report_of_strand)) };
    assert_eq!((found.kind, found.place.branch.as_deref()), (Kind::MaterialInLumen, Some("branch 1")));
    // Of a strand hardly thicker than the blur, half-way between the levels shows less than there is.
    let part = found.size.unwrap().size / volume_mm3(strand);
    assert!((0.7..1.05).contains(&part) && found.beyond_gate, "{part}: {}", told(&report_of_strand));
    only(&report(&Replica::new(move |p| is_printed(p) || lump(p))), Kind::MaterialInLumen, volume_mm3(lump));
}

#[test]
fn a_lump_on_the_skin_is_found_with_its_size() {
    let (centre, radius_mm) = fork(8.0, N_PLANES)[0];
    let at = Point3::new(centre.x, centre.y + radius_mm + WALL_MM, 8.0);
    let lump = move |p: Point3| {
        let is_within = fork(p.z, N_PLANES).iter().any(|(c, r)| (p.xy() - c).norm() <= r + WALL_MM);
        (p - at).norm() < 1.7 && !is_within
    };
    only(&report(&Replica::new(move |p| is_printed(p) || lump(p))), Kind::MaterialOutside, volume_mm3(lump));
}

#[test]
fn a_wall_that_is_too_thin_fails() {
    let thin = |p: Point3| {
        let circles = fork(p.z, N_PLANES);
        let off = circles.iter().map(|(c, r)| (p.xy() - c).norm() - r).fold(f64::INFINITY, f64::min);
        is_printed(p) && off < 0.7
    };
    let report = report(&Replica::new(thin));
    let found = of_scan(&report);
    let missing: f64 =
        found.iter().filter(|f| f.kind == Kind::MissingMaterial).filter_map(|f| f.size).map(|s| s.size).sum();
    let expected = volume_mm3(|p| is_printed(p) && !thin(p));
    // A wall hardly thicker than the blur shows its level nowhere: its thickness is told as what it is, its volume roughly.
    assert!((0.5..1.2).contains(&(missing / expected)), "{missing} of {expected}: {}", told(&report));
    assert!(!report.verdict.passed && found.iter().all(|f| f.kind != Kind::Scaled), "{}", told(&report));
}

#[test]
fn heights_that_are_too_large_are_told_as_stretched() {
    let [low, high] = z_range_mm();
    let middle = 0.5 * (low + high);
    let report =
        report(&Replica::new(move |p| is_printed(Point3::new(p.x, p.y, middle + (p.z - middle) / 1.02))));
    let found = of_scan(&report);
    assert!(found.len() == 1 && found[0].kind == Kind::Stretched, "{}", told(&report));
    assert!((found[0].size.unwrap().size - 2.0).abs() < 0.2, "{}", told(&report));
    assert!(found[0].beyond_gate && !report.verdict.passed, "{}", told(&report));
}

#[test]
fn layers_that_are_missing_lower_the_upper_end() {
    // Four layers from z = 16 mm on: what is above stands 0.8 mm lower.
    let report =
        report(&Replica::new(|p| is_printed(if p.z > 16.0 { p + Vector3::new(0.0, 0.0, 0.8) } else { p })));
    let found = of_scan(&report);
    let end =
        found.iter().find(|f| f.kind == Kind::WrongHeight).unwrap_or_else(|| panic!("{}", told(&report)));
    assert!((end.size.unwrap().size.abs() - 0.8).abs() < 0.08, "{}", told(&report));
    assert!(end.beyond_gate && !report.verdict.passed && found.iter().all(|f| f.kind != Kind::Scaled));
}

#[test]
fn a_scan_with_voxels_larger_than_half_the_wall_is_not_judged() {
    let coarse = report(&Replica { voxel_mm: [0.4, 0.4, 0.8], noise_hu: 10.0, ..Replica::right() });
    assert!(!coarse.verdict.passed && coarse.verdict.failures.is_empty(), "{}", told(&coarse));
    assert!(
        coarse.verdict.sentence().starts_with("Not judged: scan: voxels of 0.80 mm"),
        "{:?}",
        coarse.verdict
    );
    assert_eq!(crate::report::schema::tests::broken(&coarse), [""; 0]);
    // Nor are its figures failures, however far off they are.
    let large = Replica { voxel_mm: [0.4, 0.4, 0.8], noise_hu: 10.0, scale: 1.04, ..Replica::right() };
    let large = report(&large).verdict;
    assert!(large.failures.iter().all(|text| !text.starts_with("scan: ")), "{large:?}");
    assert!(!large.passed && large.not_judged.len() > 1, "{large:?}");
    // Voxels that are not cubes are no reason, as long as they are small.
    let fine = report(&Replica { voxel_mm: [0.25, 0.3, 0.5], ..Replica::right() });
    assert!(fine.verdict.passed && of_scan(&fine).is_empty(), "{}", told(&fine));
}

#[test]
fn the_limits_are_those_of_the_profile() {
    let volume = Replica::right().scanned();
    let case = Forked::new(N_PLANES);
    let mut strict = inputs(&case, Some(&volume));
    strict.gate.total_p95_mm = 0.01;
    let verdict = build(&strict, &Task::quiet()).unwrap().verdict;
    assert!(
        !verdict.passed && verdict.not_judged.iter().any(|t| t.starts_with("scan: the 95th")),
        "{verdict:?}"
    );
    let limit = verdict.limits.iter().find(|l| l.stage == "scan" && l.figure == "total_p95_mm").unwrap();
    assert!(limit.asked_mm == 0.01 && (limit.used_mm - VOXEL_MM).abs() < 1e-9, "{limit:?}");
}

#[test]
fn a_shape_that_is_its_own_mirror_image_tells_so() {
    let shape = |p: Point3| {
        let [low, high] = z_range_mm();
        let within =
            |mm: f64| testing::flat_fork(p.z, N_PLANES).iter().any(|(c, r)| (p.xy() - c).norm() <= r + mm);
        (low..=high).contains(&p.z) && within(WALL_MM) && !within(0.0)
    };
    let case = Forked::of(N_PLANES, testing::flat_fork);
    let volume = Replica::new(shape).scanned();
    let report = build(&inputs(&case, Some(&volume)), &Task::quiet()).unwrap();
    assert!(!report.scan.as_ref().unwrap().registration.mirror_is_told, "{}", told(&report));
    assert!(report.notes.iter().any(|n| n.code == "report.scan_mirror"));
    assert!(of_scan(&report).is_empty() && report.verdict.passed, "{}", told(&report));
}

#[test]
fn a_scan_that_is_cropped_closely_has_its_levels() {
    let report = report(&Replica { margin_mm: 0.9, ..Replica::right() });
    let levels = report.scan.as_ref().unwrap().levels;
    let near = |value: Option<f64>, expected: f64| (value.unwrap() - expected).abs() < 40.0;
    assert!(near(levels.air_hu, AIR_HU) && near(levels.material_hu, MATERIAL_HU), "{}", told(&report));
    assert!(report.verdict.passed, "{}", told(&report));
}

#[test]
fn page_and_pictures_show_the_scan_under_its_own_name() {
    let report = report(&Replica { scale: 1.01, ..Replica::right() });
    assert!(!of_scan(&report).is_empty());
    let page = crate::report::html(&report).unwrap();
    let (table, _) =
        page.split_once("<table id=\"defect-table\">").unwrap().1.split_once("</table>").unwrap();
    assert!(table.contains("<td class=\"text\">Scan</td>") && !table.contains(">Image<"), "{table}");
    for text in
        ["data-layer=\"scan\"", "class=\"scan\" d=\"M", "The scanned lumen against the solid", "scan_off_um"]
    {
        assert!(page.contains(text), "{text}");
    }
    // Its bars, its histogram and its curve.
    assert!(page.matches(">Scan</text>").count() == 2 && page.contains(">scanned</text>"));
    let off: Vec<f64> = report.pictures[4].plate.scan_ring.iter().filter_map(|s| s.off_mm).collect();
    let mean_mm = off.iter().sum::<f64>() / off.len() as f64;
    assert!(!report.pictures[4].plate.scan.is_empty() && (0.0..0.1).contains(&mean_mm), "{mean_mm}");
    let branches = &report.scan.as_ref().unwrap().block.branches;
    assert!(branches.len() == 3 && branches.iter().all(|b| b.figures.uncertainty.mean_mm > Some(0.0)));
    assert_eq!(crate::report::schema::tests::broken(&report), [""; 0]);
}
