use crate::geom::{Contour, Point2, RigidTransform};
use crate::mesh::sound::row_by_row;
use crate::mesh::{Part, Parted, SkinChoice, Tessellation, closedness, measure, parted, self_intersections};
use crate::phantom::{Kind, Vessel};
use crate::progress::Task;
use crate::sections::{PlaneSections, SectionStack};
use crate::solid::{Body, Params, Solid, build};

fn solid(planes: Vec<PlaneSections>, body: Body) -> Solid {
    let stack = SectionStack { planes, patient_from_stack: RigidTransform::identity() };
    build(&stack, &Params::new(body), &Task::quiet()).unwrap().solid
}

fn phantom(kind: Kind, body: Body) -> Solid {
    let vessel = Vessel::new(kind);
    let plane = |k: u32| {
        let z_mm = 3.0 * f64::from(k);
        PlaneSections { z_mm, contours: vessel.region_at(z_mm, 128).contours }
    };
    solid((0..46).map(plane).collect(), body)
}

fn rows_of(solid: &Solid, skin: SkinChoice, deflection_mm: f64) -> Parted {
    row_by_row(solid, skin, deflection_mm, &Task::quiet()).unwrap().expect("a sound mesh")
}

fn assert_sound(solid: &Solid, deflection_mm: f64, name: &str) {
    let made = rows_of(solid, SkinChoice::All, deflection_mm);
    assert!(closedness(&made.mesh).is_closed(), "{name}");
    assert_eq!(self_intersections(&made.mesh, &Task::quiet()).unwrap(), []);
    let found = measure(solid, SkinChoice::All, &made.mesh, deflection_mm, &Task::quiet()).unwrap();
    assert!(found.largest_deviation_mm <= deflection_mm, "{name}: {found}");
    assert_eq!(made.deviation, None, "{name}");
}

#[test]
fn rows_of_every_phantom_are_closed_and_keep_the_deflection() {
    for kind in Kind::ALL {
        assert_sound(&phantom(kind, Body::Cast), 0.1, &format!("{kind:?}"));
    }
}

#[test]
fn rows_beside_a_crease_are_as_close_as_the_deflection_asks() {
    let walled = phantom(Kind::Carotid, Body::Wall { wall_mm: 1.0 });
    for deflection_mm in [0.2, 0.05] {
        assert_sound(&walled, deflection_mm, "carotid with its wall");
    }
}

#[test]
fn every_triangle_of_a_pipe_is_told_by_what_it_bounds() {
    let contours = vec![Contour::circle(Point2::origin(), 3.0, 128)];
    let plane = |k: u32| PlaneSections { z_mm: 2.0 * f64::from(k), contours: contours.clone() };
    let pipe = solid((0..6).map(plane).collect(), Body::Wall { wall_mm: 1.0 });
    let how = Tessellation::within(0.05, SkinChoice::All);
    let meshes = [parted(&pipe, &how, &Task::quiet()).unwrap(), rows_of(&pipe, SkinChoice::All, 0.05)];
    for Parted { mesh, parts, .. } in meshes {
        assert_eq!(mesh.triangles.len(), parts.len());
        for (t, part) in mesh.triangles.iter().zip(parts) {
            let corners = t.map(|v| mesh.vertices[v as usize]);
            let is_level = corners.iter().all(|p| (p.z - corners[0].z).abs() < 1e-9);
            let middle = (corners[0].coords + corners[1].coords + corners[2].coords) / 3.0;
            let expected = match middle.xy().norm() {
                _ if is_level => Part::Cap,
                radius if radius < 3.5 => Part::Lumen,
                _ => Part::Outer,
            };
            assert_eq!(part, expected, "{middle}");
        }
    }
}
