use super::*;
use crate::geom::{Contour, Point2, RigidTransform};
use crate::phantom::{Kind, Vessel};
use crate::progress::Task;
use crate::sections::{PlaneSections, SectionStack};
use crate::solid::{Body, Params, Sectioned, Solid, build};

fn phantom(kind: Kind, body: Body) -> Solid {
    let vessel = Vessel::new(kind);
    let plane = |k: u32| {
        let z_mm = 3.0 * f64::from(k);
        PlaneSections { z_mm, contours: vessel.region_at(z_mm, 128).contours }
    };
    solid((0..46).map(plane).collect(), body)
}

fn solid(planes: Vec<PlaneSections>, body: Body) -> Solid {
    let stack = SectionStack { planes, patient_from_stack: RigidTransform::identity() };
    build(&stack, &Params::new(body), &Task::quiet()).unwrap().solid
}

fn cylinder(body: Body) -> Solid {
    let contours = vec![Contour::circle(Point2::new(5.0, 7.0), 3.0, 256)];
    solid(
        (0..6).map(|k| PlaneSections { z_mm: 2.0 * f64::from(k), contours: contours.clone() }).collect(),
        body,
    )
}

fn fine(skin: SkinChoice, deflection_mm: f64) -> Tessellation {
    Tessellation { skin, deflection: Deflection::Absolute { mm: deflection_mm } }
}

#[test]
fn every_phantom_is_closed_in_every_skin_and_deflection() {
    for kind in Kind::ALL {
        let solid = phantom(kind, Body::Wall { wall_mm: 1.0 });
        for skin in [SkinChoice::All, SkinChoice::Lumen] {
            for deflection_mm in [0.1, 0.02] {
                let mesh = tessellate(&solid, &fine(skin, deflection_mm), &Task::quiet()).unwrap();
                assert!(closedness(&mesh).is_closed(), "{kind:?} {skin:?} {deflection_mm}");
                assert!(mesh.volume_mm3() > 0.0);
            }
        }
    }
}

#[test]
fn volumes_of_a_cylinder_and_its_wall_are_those_of_the_closed_form() {
    let pi = std::f64::consts::PI;
    let lumen = tessellate(&cylinder(Body::Cast), &fine(SkinChoice::All, 0.001), &Task::quiet())
        .unwrap()
        .volume_mm3();
    assert!((lumen / (pi * 9.0 * 12.0) - 1.0).abs() < 1e-3, "{lumen}");
    let hollow = cylinder(Body::Wall { wall_mm: 1.0 });
    let wall = tessellate(&hollow, &fine(SkinChoice::All, 0.001), &Task::quiet()).unwrap().volume_mm3();
    assert!((wall / (pi * 7.0 * 12.0) - 1.0).abs() < 2e-3, "{wall}");
    // The lumen alone is the same, wall or not.
    let inside = tessellate(&hollow, &fine(SkinChoice::Lumen, 0.001), &Task::quiet()).unwrap().volume_mm3();
    assert!((inside - lumen).abs() < 1e-6);
}

#[test]
fn the_mesh_encloses_the_area_of_the_sections() {
    let solid = phantom(Kind::Carotid, Body::Cast);
    let mesh = tessellate(&solid, &fine(SkinChoice::All, 0.005), &Task::quiet()).unwrap();
    let [low, high] = solid.z_range_mm();
    let n = 1380;
    let step = (high - low) / f64::from(n);
    let area = |k: i32| solid.section(low + (f64::from(k) + 0.5) * step, 1e-4).outer.area_mm2();
    let volume: f64 = (0..n).map(area).sum::<f64>() * step;
    assert!((mesh.volume_mm3() / volume - 1.0).abs() < 2e-3, "{} {volume}", mesh.volume_mm3());
}

#[test]
fn a_smaller_deflection_needs_more_triangles() {
    let solid = cylinder(Body::Cast);
    let count =
        |d: f64| tessellate(&solid, &fine(SkinChoice::All, d), &Task::quiet()).unwrap().triangles.len();
    assert!(count(0.1) < count(0.02) && count(0.02) < count(0.005));
}

#[test]
fn a_deflection_out_of_range_is_refused() {
    for deflection_mm in [0.0, -1.0, f64::NAN, 9.0] {
        let refused =
            tessellate(&cylinder(Body::Cast), &fine(SkinChoice::All, deflection_mm), &Task::quiet());
        assert!(matches!(refused, Err(Error::Deflection(_))));
    }
}

#[test]
fn an_stl_file_is_read_back_as_the_closed_mesh_it_was() {
    let mesh = tessellate(&phantom(Kind::Carotid, Body::Cast), &fine(SkinChoice::All, 0.05), &Task::quiet())
        .unwrap();
    let bytes = stl::to_bytes(&mesh).unwrap();
    assert_eq!(bytes.len(), 84 + 50 * mesh.triangles.len());
    assert!(bytes.starts_with(b"lumenfab ") && bytes[..80].windows(9).any(|w| w == b"units: mm"));
    let read = stl_io::read_stl(&mut std::io::Cursor::new(&bytes)).unwrap();
    assert_eq!((read.faces.len(), read.vertices.len()), (mesh.triangles.len(), mesh.vertices.len()));
    read.validate().unwrap();
}

/// A trunk through all planes and beside it, at `x`, a branch of radius 1.5 mm in planes 2 to 5 of 9 only.
fn trunk_and_stump(x: f64, body: Body) -> Solid {
    let plane = |k: u32| {
        let mut contours = vec![Contour::circle(Point2::origin(), 3.0, 128)];
        if (2..=5).contains(&k) {
            contours.push(Contour::circle(Point2::new(x, 0.0), 1.5, 128));
        }
        PlaneSections { z_mm: 2.0 * f64::from(k), contours }
    };
    solid((0..9).map(plane).collect(), body)
}

#[test]
fn a_branch_that_ends_inside_the_stack_is_closed() {
    let pi = std::f64::consts::PI;
    let cast =
        tessellate(&trunk_and_stump(9.0, Body::Cast), &fine(SkinChoice::All, 0.002), &Task::quiet()).unwrap();
    // Its domes reach into the next plane intervals and no farther.
    let least = pi * 9.0 * 18.0 + pi * 2.25 * 6.0;
    let most = least + 2.0 * pi * 2.25 * 2.0;
    assert!((least..most).contains(&cast.volume_mm3()), "{} {least}", cast.volume_mm3());
    // Apart from the trunk: its own closed body with a closed void in it. Grown into it: one body.
    for x in [9.0, 5.6] {
        let hollow = trunk_and_stump(x, Body::Wall { wall_mm: 1.0 });
        for skin in [SkinChoice::All, SkinChoice::Lumen] {
            let mesh = tessellate(&hollow, &fine(skin, 0.02), &Task::quiet()).unwrap();
            assert!(mesh.volume_mm3() > 0.0, "x {x} {skin:?}");
        }
        // Beyond the stump's tip, which lies before the next plane, the wall closes over it: within its thickness where it
        // stands alone, within a millimetre more where it ends in a ledge on the trunk's wall.
        let outer = |z: f64| hollow.section(z, 1e-3).outer.contains(Point2::new(x + 0.3, 0.0));
        let past = if x > 8.0 { 0.1 } else { 1.0 };
        assert!(outer(10.9) && !outer(13.0 + past) && outer(3.1) && !outer(1.0 - past), "x {x}");
    }
}

#[test]
fn straight_sides_are_capped_vertex_by_vertex() {
    // A rounded bar whose long sides run along x, exactly.
    let bar = |n: u32| {
        let bottom = (0..n).map(|i| Point2::new(f64::from(i) * 6.0 / f64::from(n - 1), 0.0));
        let right = (1..40)
            .map(|i| (f64::from(i) * std::f64::consts::PI / 40.0).sin_cos())
            .map(|(s, c)| Point2::new(6.0 + s, 1.0 - c));
        let top = (0..n).map(|i| Point2::new(6.0 - f64::from(i) * 6.0 / f64::from(n - 1), 2.0));
        let left = (1..40)
            .map(|i| (f64::from(i) * std::f64::consts::PI / 40.0).sin_cos())
            .map(|(s, c)| Point2::new(-s, 1.0 + c));
        Contour::new(bottom.chain(right).chain(top).chain(left).collect())
    };
    let planes =
        (0..4).map(|k| PlaneSections { z_mm: 2.0 * f64::from(k), contours: vec![bar(80)] }).collect();
    let mesh =
        tessellate(&solid(planes, Body::Wall { wall_mm: 0.5 }), &fine(SkinChoice::All, 0.01), &Task::quiet())
            .unwrap();
    assert!(mesh.volume_mm3() > 0.0);
}

#[test]
fn vertices_that_fall_together_in_the_file_are_noticed() {
    let mut mesh = tessellate(&cylinder(Body::Cast), &fine(SkinChoice::All, 0.05), &Task::quiet()).unwrap();
    let moved = mesh.vertices[1] + (mesh.vertices[0] - mesh.vertices[1]) * (1.0 - 1e-9);
    mesh.vertices[1] = moved;
    assert!(closedness(&mesh).is_closed());
    assert!(!closedness(&mesh.in_single_precision()).is_closed());
}

#[test]
fn two_lumens_in_one_wall_share_its_caps() {
    let disk = |x: f64| Contour::circle(Point2::new(x, 0.0), 2.0, 128);
    let plane = |k: u32| PlaneSections { z_mm: 2.0 * f64::from(k), contours: vec![disk(0.0), disk(5.0)] };
    let pair = solid((0..5).map(plane).collect(), Body::Wall { wall_mm: 1.0 });
    let mesh = tessellate(&pair, &fine(SkinChoice::All, 0.002), &Task::quiet()).unwrap();
    // Two disks of 3 mm, 5 mm apart, overlap in a lens.
    let half_angle = (2.5f64 / 3.0).acos();
    let lens = 2.0 * 9.0 * (half_angle - half_angle.sin() * half_angle.cos());
    let expected = (2.0 * std::f64::consts::PI * (9.0 - 4.0) - lens) * 10.0;
    assert!((mesh.volume_mm3() / expected - 1.0).abs() < 4e-3, "{} {expected}", mesh.volume_mm3());
}

#[test]
fn meshing_stops_when_asked() {
    let cancel = crate::progress::CancelToken::default();
    cancel.cancel();
    let task = Task::new(&|_, _| {}, cancel);
    let stopped = tessellate(&cylinder(Body::Cast), &fine(SkinChoice::All, 0.01), &task);
    assert_eq!(stopped, Err(Error::Cancelled(Cancelled)));
}

/// Farthest that the surfaces lie from the triangles, and the triangles' middles from a much finer mesh, mm.
fn both_ways(solid: &Solid, skin: SkinChoice, deflection_mm: f64) -> [f64; 2] {
    let mesh = tessellate(solid, &fine(skin, deflection_mm), &Task::quiet()).unwrap();
    let there = measure(solid, skin, &mesh, deflection_mm, &Task::quiet()).unwrap().largest_deviation_mm;
    let finer = tessellate(solid, &fine(skin, deflection_mm / 8.0), &Task::quiet()).unwrap();
    let bvh = bvh::Bvh::of(&finer);
    let off = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| mesh.vertices[v as usize].coords);
        let middle = ((a + b + c) / 3.0).into();
        bvh.nearest(&finer, middle, f64::INFINITY).map_or(f64::INFINITY, |n| n.distance_mm)
    };
    [there, mesh.triangles.iter().map(off).fold(0.0, f64::max)]
}

#[test]
fn the_deflection_is_kept_both_ways_on_tubes_patches_domes_and_creases() {
    let solids = [
        phantom(Kind::Carotid, Body::Wall { wall_mm: 1.0 }),
        phantom(Kind::Merge, Body::Cast),
        trunk_and_stump(9.0, Body::Wall { wall_mm: 1.0 }),
        trunk_and_stump(5.6, Body::Wall { wall_mm: 1.0 }),
    ];
    for (k, solid) in solids.iter().enumerate() {
        for deflection_mm in [0.1, 0.03] {
            let [there, back] = both_ways(solid, SkinChoice::All, deflection_mm);
            assert!(there <= deflection_mm, "solid {k}, {deflection_mm}: {there}");
            // The finer mesh is off itself by an eighth.
            assert!(back <= 1.125 * deflection_mm, "solid {k}, {deflection_mm}: {back}");
        }
    }
}

#[test]
fn no_sample_of_any_phantom_is_farther_off_than_the_deflection() {
    // Where rings of patches meet tubes and where sections lie close together, few points say little of a triangle.
    for kind in Kind::ALL {
        let solid = phantom(kind, Body::Cast);
        for deflection_mm in [0.01, 0.002] {
            let mesh = tessellate(&solid, &fine(SkinChoice::All, deflection_mm), &Task::quiet()).unwrap();
            let found = measure(&solid, SkinChoice::All, &mesh, deflection_mm, &Task::quiet()).unwrap();
            assert!(found.largest_deviation_mm <= deflection_mm, "{kind:?}: {found}");
        }
    }
}

#[test]
fn triangles_are_few_and_their_angles_good() {
    for (body, most_triangles) in [(Body::Cast, 34_000), (Body::Wall { wall_mm: 1.0 }, 70_000)] {
        let solid = phantom(Kind::Carotid, body);
        let mesh = tessellate(&solid, &fine(SkinChoice::All, 0.01), &Task::quiet()).unwrap();
        let found = measure(&solid, SkinChoice::All, &mesh, 0.01, &Task::quiet()).unwrap();
        assert!(found.min_angle_p5_deg >= 38.0 && found.n_triangles <= most_triangles, "{body:?}: {found}");
    }
}

#[test]
fn a_relative_deflection_follows_the_size() {
    let solid = phantom(Kind::Carotid, Body::Cast);
    let relative = |fraction: f64| {
        let how = Tessellation { skin: SkinChoice::All, deflection: Deflection::Relative { fraction } };
        tessellate(&solid, &how, &Task::quiet())
    };
    assert!(relative(0.03).unwrap().triangles.len() < relative(0.003).unwrap().triangles.len());
    assert!(matches!(relative(0.0), Err(Error::Fraction(_))));
}

#[test]
fn the_mesh_is_the_same_on_any_number_of_threads() {
    let solid = phantom(Kind::Carotid, Body::Wall { wall_mm: 1.0 });
    let on = |n: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| tessellate(&solid, &fine(SkinChoice::All, 0.02), &Task::quiet()).unwrap())
    };
    assert!(on(1) == on(2));
}

#[test]
fn a_mesh_that_does_not_keep_the_deflection_is_refused_with_its_place() {
    let found = Deviation { mm: 0.015, at: Point3::new(1.0, 2.0, 73.11) };
    let off = Parted { deviation: Some(found), ..Parted::default() };
    let asked = Deflection::Absolute { mm: 0.01 };
    let message = off.kept(asked).unwrap_err().to_string();
    assert!(
        message.starts_with("the surface at x 1.000 y 2.000 z 73.110 mm is 0.01500 mm from"),
        "{message}"
    );
    assert!(message.contains("more than the deflection of 0.01 mm"), "{message}");
    assert!(Parted::default().kept(asked).is_ok());
}
