use super::check::Corners;
use super::*;
use crate::geom::{Contour, Point2, Point3, RigidTransform};
use crate::phantom::{Kind as Vessels, Vessel};
use crate::progress::Task;
use crate::sections::{PlaneSections, SectionStack};
use crate::solid::{Body as Wanted, Params, SkinChoice, Solid, build};
use crate::spline::TubeSurface;

fn solid(planes: Vec<PlaneSections>, body: Wanted) -> Solid {
    let stack = SectionStack { planes, patient_from_stack: RigidTransform::identity() };
    build(&stack, &Params::new(body), &Task::quiet()).unwrap().solid
}

fn phantom(kind: Vessels, body: Wanted) -> Solid {
    let vessel = Vessel::new(kind);
    let plane = |k: u32| {
        let z_mm = 3.0 * f64::from(k);
        PlaneSections { z_mm, contours: vessel.region_at(z_mm, 128).contours }
    };
    solid((0..46).map(plane).collect(), body)
}

fn cylinder(body: Wanted) -> Solid {
    let contours = vec![Contour::circle(Point2::new(5.0, 7.0), 3.0, 256)];
    let plane = |k: u32| PlaneSections { z_mm: 2.0 * f64::from(k), contours: contours.clone() };
    solid((0..6).map(plane).collect(), body)
}

fn kinds(brep: &Brep) -> Vec<Kind> {
    check(brep).map_or_else(|e| e.0.iter().map(|f| f.kind).collect(), |()| Vec::new())
}

#[test]
fn cylinder_and_pipe_are_valid_and_have_the_volume_of_the_closed_form() {
    let pi = std::f64::consts::PI;
    let cast = Brep::of(&cylinder(Wanted::Cast), SkinChoice::All);
    assert_eq!((cast.vertices.len(), cast.edges.len(), cast.faces.len()), (2, 3, 3));
    assert_eq!(kinds(&cast), []);
    assert!((cast.volume_mm3() / (pi * 9.0 * 12.0) - 1.0).abs() < 1e-6, "{}", cast.volume_mm3());
    let pipe = Brep::of(&cylinder(Wanted::Wall { wall_mm: 1.0 }), SkinChoice::All);
    assert_eq!((pipe.faces.len(), pipe.bodies.len()), (4, 1));
    assert_eq!(pipe.faces.iter().filter(|f| f.loops.len() == 2).count(), 2);
    assert_eq!(kinds(&pipe), []);
    assert!((pipe.volume_mm3() / (pi * 7.0 * 12.0) - 1.0).abs() < 2e-3, "{}", pipe.volume_mm3());
}

#[test]
fn branched_lumens_are_valid() {
    for (kind, n_faces) in [(Vessels::Carotid, 9), (Vessels::Merge, 12)] {
        let brep = Brep::of(&phantom(kind, Wanted::Cast), SkinChoice::All);
        assert_eq!(kinds(&brep), [], "{kind:?}");
        assert_eq!(brep.faces.len(), n_faces);
    }
}

#[test]
fn every_lumen_is_smooth_across_seams_and_planes() {
    for kind in Vessels::ALL {
        let solid = phantom(kind, Wanted::Cast);
        // Without branches there are no seams between faces.
        let (jump, at) = Brep::of(&solid, SkinChoice::All).normal_jump_deg(201).unwrap_or_default();
        assert!(jump < 1.0, "{kind:?}: {jump} at {at}");
    }
}

#[test]
fn outer_skins_are_smooth_but_for_their_creases() {
    // All but that of the trifurcation, where creases of three branches cross each other.
    for kind in [Vessels::Carotid, Vessels::Merge, Vessels::Stenosis, Vessels::Tube] {
        let solid = phantom(kind, Wanted::Wall { wall_mm: 1.0 });
        let outer = Solid { lumen: solid.outer.expect("a wall"), outer: None };
        let (jump, at) = Brep::of(&outer, SkinChoice::All).normal_jump_deg(401).unwrap_or_default();
        assert!(jump < 1.0, "{kind:?}: {jump} at {at}");
    }
}

#[test]
fn welding_moves_patches_by_less_than_a_micrometre() {
    for kind in [Vessels::Carotid, Vessels::Merge] {
        let moved_mm = phantom(kind, Wanted::Cast).lumen.moved_mm;
        assert!(moved_mm < 1e-3, "{kind:?}: {moved_mm}");
    }
}

#[test]
fn seams_and_rings_are_one_curve_to_the_last_digits() {
    let brep = Brep::of(&phantom(Vessels::Carotid, Wanted::Cast), SkinChoice::All);
    for face in &brep.faces {
        let Some(spline) = face.surface.spline() else { continue };
        for coedge in face.loops.iter().flat_map(|l| &l.coedges) {
            let curve = &brep.edges[coedge.edge].curve;
            let [a, b] = curve.range();
            for k in 0..=200 {
                let share = f64::from(k) / 200.0;
                let [u, v] = along(coedge.trace, share);
                let gap = (spline.at(u, v) - curve.at(a + (b - a) * share)).norm();
                assert!(gap < 1e-11, "{} {gap}", face.surface.name());
            }
        }
    }
}

#[test]
fn each_fault_is_found_alone_and_in_its_place() {
    let valid = Brep::of(&cylinder(Wanted::Wall { wall_mm: 1.0 }), SkinChoice::All);
    let damaged = |damage: &dyn Fn(&mut Brep)| {
        let mut brep = valid.clone();
        damage(&mut brep);
        kinds(&brep)
    };
    assert_eq!(damaged(&|b| b.faces[2].loops.clear()), [Kind::Incomplete]);
    assert_eq!(damaged(&|b| b.edges[0].start = 99), [Kind::Incomplete]);
    assert_eq!(damaged(&|b| b.bodies[0].outer.faces.push(99)), [Kind::Incomplete]);
    // A cap that has lost one of its two rims.
    let one = damaged(&|b| b.faces[2].loops.truncate(1));
    assert_eq!(one, [Kind::EdgeUses(1), Kind::Euler { found: 1, expected: 0 }]);
    assert_eq!(damaged(&|b| b.faces[2].loops[0].coedges[0].is_forward ^= true), [Kind::Misoriented]);
    assert_eq!(damaged(&|b| b.faces[0].loops[0].coedges.swap(0, 1)), [Kind::LoopOpen; 2]);
    // A vertex at which two rings and a seam end.
    let off = damaged(&|b| b.vertices[0].point.x += 1e-3);
    assert!(off.iter().all(|k| matches!(k, Kind::OffVertex(_))) && !off.is_empty(), "{off:?}");
    let lifted = damaged(&|b| b.faces[2].surface = Surface::Plane(55.0));
    assert!(lifted.iter().all(|k| matches!(k, Kind::OffSurface(_))) && lifted.len() == 2, "{lifted:?}");
    let shrunk = damaged(&|b| {
        let edge = &mut b.edges[0];
        let start = edge.curve.ends()[0];
        edge.curve = Curve::new(edge.curve.basis().clone(), vec![start; edge.curve.control().len()]);
    });
    // An edge that has shrunk to a point is off its surface, too.
    assert!(matches!(shrunk[..], [Kind::OffSurface(_), Kind::ZeroLength]), "{shrunk:?}");
    assert_eq!(damaged(&|b| b.bodies[0].outer.faces = vec![0, 1]), [Kind::Incomplete; 2]);
    let inside_out = damaged(&|b| b.faces.iter_mut().for_each(|f| f.is_outward ^= true));
    assert!(inside_out.iter().all(|k| *k == Kind::InsideOut) && !inside_out.is_empty(), "{inside_out:?}");
    // Moves or bends the lumen's tube; its edges are then off it, too.
    let bent = |bend: &dyn Fn(Point3) -> Point3| {
        damaged(&|b| {
            let Surface::Tube(s) = &b.faces[0].surface else { panic!("a tube") };
            let [u, v] = s.bases();
            let points: Vec<Point3> = s.control().map(bend).collect();
            b.faces[0].surface = Surface::Tube(PatchSurface::with_control(u.clone(), v.clone(), &points));
        })
    };
    let beside_its_edges = |found: Vec<Kind>, kind: Kind| {
        let others: Vec<Kind> = found.into_iter().filter(|k| !matches!(k, Kind::OffSurface(_))).collect();
        assert!(!others.is_empty() && others.iter().all(|k| *k == kind), "{others:?}");
    };
    beside_its_edges(bent(&|p| Point3::new(p.x + 2.0, p.y, p.z)), Kind::Crossing);
    beside_its_edges(bent(&|p| Point3::new(p.x, p.y, p.z + 0.1 * p.x)), Kind::Folded);
    let text = check(&{
        let mut b = valid.clone();
        b.vertices[0].point.x += 1e-3;
        b
    });
    let text = text.unwrap_err().to_string();
    assert!(text.starts_with("the solid is not valid: z "), "{text}");
}

/// Two rods whose distance is g(z) where they are nearest, on planes 3 mm apart.
fn rods(gap: impl Fn(f64) -> f64) -> Brep {
    let z_mm: Vec<f64> = (-4..=5).map(|k| 3.0 * f64::from(k)).collect();
    let apart = |side: f64| {
        let plane = |z: f64| Contour::circle(Point2::new(side * (2.0 + 0.5 * gap(z)), 0.0), 2.0, 256).points;
        let sections: Vec<_> = z_mm.iter().map(|&z| plane(z)).collect();
        TubeSurface::through(&z_mm, &sections).unwrap().clamped()
    };
    let pair = |&z_mm: &f64| {
        let disk = |side: f64| Contour::circle(Point2::new(9.0 * side, 0.0), 2.0, 128);
        PlaneSections { z_mm, contours: vec![disk(-1.0), disk(1.0)] }
    };
    let mut brep = Brep::of(&solid(z_mm.iter().map(pair).collect(), Wanted::Cast), SkinChoice::All);
    let tubes = brep.faces.iter_mut().filter(|f| matches!(f.surface, Surface::Tube(_)));
    for (face, side) in tubes.zip([-1.0, 1.0]) {
        face.surface = Surface::Tube(apart(side));
    }
    brep
}

#[test]
fn walls_beside_creases_are_proved_to_be_apart_at_every_height() {
    // Notches of the outer skin retreat fast beside the apexes of its creases.
    let vessel = Vessel::new(Vessels::Trifurcation);
    for (step_mm, n_planes, wall_mm) in [(3.0, 46u32, 1.5), (2.5, 56, 0.8)] {
        let plane = |k: u32| {
            let z_mm = step_mm * f64::from(k);
            PlaneSections { z_mm, contours: vessel.region_at(z_mm, 128).contours }
        };
        let solid = solid((0..n_planes).map(plane).collect(), Wanted::Wall { wall_mm });
        assert_eq!(examined(&Brep::of(&solid, SkinChoice::All)), Ok(Vec::new()), "{wall_mm}");
    }
}

#[test]
fn tubes_that_cross_between_the_heights_that_are_looked_at_are_found() {
    // Of the sections at knots, half-way and at quarters, none crosses.
    let gap = |least: f64| move |z: f64| least + 0.4 * ((z - 1.875) / 3.0).powi(2);
    let crossings = |least: f64| {
        let brep = rods(gap(least));
        let corners = Corners::of(&brep);
        let found = clearance::crossings(&brep, &corners);
        assert!(found.iter().all(|f| matches!(f.kind, Kind::Crossing)), "{found:?}");
        let near = |place: &Fault| near::crossing_near(&brep, &corners, place);
        assert!(found.is_empty() || found.iter().any(|place| near(place).is_some()), "{found:?}");
        found
    };
    for z in [1.5, 0.75, 2.25, 0.0, 3.0] {
        assert!(gap(-0.0046)(z) > 1e-3);
    }
    let found = crossings(-0.0046);
    assert!(!found.is_empty() && found.iter().all(|f| (f.at.z - 1.875).abs() < 0.4), "{found:?}");
    assert_eq!(crossings(1e-4), []);
}

#[test]
fn two_bodies_taken_for_one_fall_apart() {
    let pair = |k: u32| {
        let disk = |x: f64| Contour::circle(Point2::new(x, 0.0), 2.0, 128);
        PlaneSections { z_mm: 2.0 * f64::from(k), contours: vec![disk(0.0), disk(9.0)] }
    };
    let mut brep = Brep::of(&solid((0..5).map(pair).collect(), Wanted::Cast), SkinChoice::All);
    assert_eq!((brep.bodies.len(), kinds(&brep)), (2, vec![]));
    let second = brep.bodies.pop().unwrap();
    brep.bodies[0].outer.faces.extend(second.outer.faces);
    brep.bodies[0].outer.faces.sort_unstable();
    assert_eq!(kinds(&brep), [Kind::Disconnected]);
}

#[test]
fn a_list_that_was_cut_says_so() {
    let fault = Fault { kind: Kind::Folded, face: None, part: "solid", at: Point3::origin() };
    let text = |n: usize| Invalid(vec![fault; n]).to_string();
    assert!(text(7).contains("; and 6 more:"), "{}", text(7));
    assert!(text(100).contains("; and at least 99 more:"), "{}", text(100));
}

#[test]
fn a_hollow_inside_the_body_is_a_void() {
    let plane = |k: u32| {
        let mut contours = vec![Contour::circle(Point2::origin(), 3.0, 128)];
        if (2..=5).contains(&k) {
            contours.push(Contour::circle(Point2::new(9.0, 0.0), 1.5, 128));
        }
        PlaneSections { z_mm: 2.0 * f64::from(k), contours }
    };
    let stump = solid((0..9).map(plane).collect(), Wanted::Wall { wall_mm: 1.0 });
    let brep = Brep::of(&stump, SkinChoice::All);
    assert_eq!((brep.bodies.len(), brep.bodies.iter().map(|b| b.voids.len()).sum::<usize>()), (2, 1));
    assert_eq!(kinds(&brep), []);
    let mut stray = brep;
    let hollow = stray.bodies.iter_mut().find_map(|b| b.voids.pop()).unwrap();
    let other = stray.bodies.iter().position(|b| !stray.holds(&b.outer, &hollow)).unwrap();
    stray.bodies[other].voids.push(hollow);
    assert_eq!(kinds(&stray), [Kind::StrayVoid]);
}
