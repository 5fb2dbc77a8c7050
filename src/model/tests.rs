use super::testing::{cuboid, inverted, miswound, moved, tube};
use super::*;
use crate::mesh::stl as writer;

fn as_text(facets: &[Facet]) -> String {
    let one = |f: &Facet| {
        let vertices = f.map(|[x, y, z]| format!("   vertex {x} {y} {z:e}\n")).concat();
        format!(" facet normal 0 0 0\n  outer loop\n{vertices}  endloop\n endfacet\n")
    };
    format!("solid a\n{}endsolid a\n", facets.iter().map(one).collect::<Vec<_>>().concat())
}

#[test]
fn the_order_of_triangles_and_corners_does_not_matter() {
    let facets = cuboid([1.0, 2.0, 3.0]);
    let model = Model::of(&facets).unwrap();
    assert_eq!((model.mesh.vertices.len(), model.mesh.triangles.len()), (8, 12));
    assert!((model.mesh.volume_mm3() - 6.0).abs() < 1e-12 && model.warnings.is_empty());
    let mut shuffled: Vec<Facet> = facets.iter().rev().map(|&[a, b, c]| [c, a, b]).collect();
    shuffled.swap(1, 7);
    assert_eq!(Model::of(&shuffled).unwrap(), model);
}

#[test]
fn both_forms_of_a_file_are_read() {
    let facets = cuboid([1.5, 2.0, 3.25]);
    let model = Model::of(&facets).unwrap();
    let mut binary = writer::to_bytes(&model.mesh).unwrap();
    assert_eq!(Model::of(&stl::read(&binary).unwrap()).unwrap(), model);
    // Whatever a heading says, the length decides.
    binary[..5].copy_from_slice(b"solid");
    assert_eq!(Model::of(&stl::read(&binary).unwrap()).unwrap(), model);
    assert_eq!(stl::read(as_text(&facets).as_bytes()).unwrap(), facets);
}

#[test]
fn an_inverted_mesh_is_turned_and_told() {
    let facets: Vec<Facet> = cuboid([1.0; 3]).into_iter().map(|[a, b, c]| [a, c, b]).collect();
    let model = Model::of(&facets).unwrap();
    assert!((model.mesh.volume_mm3() - 1.0).abs() < 1e-12);
    assert_eq!(model.warnings[0].code, "model.inverted");
    assert_eq!(model.mesh, Model::of(&cuboid([1.0; 3])).unwrap().mesh);
}

#[test]
fn a_quarter_turn_about_x_lays_a_column_down() {
    let model = Model::of(&cuboid([1.0, 2.0, 3.0])).unwrap().turned(Axis::X, 90.0);
    let range = |k: usize| {
        let all = model.mesh.vertices.iter().map(|p| p[k]);
        [all.clone().fold(f64::INFINITY, f64::min), all.fold(f64::NEG_INFINITY, f64::max)]
    };
    for (k, expected) in [[0.0, 1.0], [-3.0, 0.0], [0.0, 2.0]].into_iter().enumerate() {
        assert!(range(k).iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{k}: {:?}", range(k));
    }
}

#[test]
fn what_is_no_model_is_refused_with_what_was_found() {
    let cut = &writer::to_bytes(&Model::of(&cuboid([1.0; 3])).unwrap().mesh).unwrap()[..200];
    let refused = |bytes: &[u8]| stl::read(bytes).unwrap_err().to_string();
    assert!(refused(cut).contains("684 bytes that a binary file of 12 triangles has (found 200)"));
    assert_eq!(refused(b"hello"), "it is no STL: it has only 5 bytes: export the model again as STL");
    let bad = refused(b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0\n");
    assert!(bad.starts_with("line 4: found \"vertex 0 0\", expected `vertex` and three numbers"), "{bad}");
    assert_eq!(Model::of(&[]).unwrap_err(), Error::Empty);
    let mut far = cuboid([1.0; 3]);
    far[3][1][2] = f32::NAN;
    assert!(matches!(Model::of(&far).unwrap_err(), Error::Coordinate { facet: 3, .. }));
    let flat = [[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]];
    assert_eq!(Model::of(&flat).unwrap_err(), Error::Flat);
}

/// Each corner of each facet moved by a part of this length of its own.
fn rattled(facets: &[Facet], by_mm: f32) -> Vec<Facet> {
    let mut k = 0_u16;
    let mut next = || {
        k += 1;
        by_mm * ((f32::from(k) * 0.618_034).fract() - 0.5)
    };
    facets.iter().map(|f| f.map(|corner| corner.map(|c| c + next()))).collect()
}

#[test]
fn corners_of_triangles_that_were_rounded_each_for_itself_are_joined_and_told() {
    let model = Model::of(&rattled(&cuboid([10.0, 20.0, 30.0]), 0.004)).unwrap();
    assert_eq!(model.mesh.triangles.len(), 12);
    assert!((model.mesh.volume_mm3() / 6000.0 - 1.0).abs() < 1e-3);
    let codes: Vec<&str> = model.warnings.iter().map(|w| w.code.as_str()).collect();
    assert_eq!(codes, ["model.corners_joined"]);
    // A step of this height is part of the model.
    let apart = Model::of(&rattled(&cuboid([10.0, 20.0, 30.0]), 0.4)).unwrap();
    assert_eq!(apart.warnings[0].code, "model.open");
}

#[test]
fn a_missing_triangle_is_told() {
    let model = Model::of(&cuboid([1.0; 3])[1..]).unwrap();
    assert!(model.warnings[0].text.starts_with("the surface is open: 3 edge(s)"), "{:?}", model.warnings);
}

#[test]
fn triangles_that_face_the_other_way_than_their_neighbours_are_turned_and_counted() {
    let bored = tube(3.0, 4.0, 20.0, 32);
    let sound = Model::of(&bored).unwrap().mesh;
    for (is_turned, n_turned) in [
        (&(|k: usize| k.is_multiple_of(2)) as &dyn Fn(usize) -> bool, 128),
        (&|k: usize| k % 7 != 3, 219),
        (&|k: usize| k == 200, 1),
    ] {
        let mut facets = miswound(&bored, is_turned);
        let model = Model::of(&facets).unwrap();
        assert_eq!(model.mesh, sound);
        let expected =
            format!("{n_turned} of 256 triangles faced the other way than their neighbours and were turned");
        assert_eq!(model.warnings, [Warning::new("model.turned", expected)]);
        facets.reverse();
        facets.rotate_left(77);
        assert_eq!(Model::of(&facets).unwrap(), model);
    }
}

#[test]
fn a_cavity_stays_one_whichever_way_its_triangles_face() {
    let part = |size: f32, at: f32| moved(&cuboid([size; 3]), [at; 3]);
    // A body in a cavity of a body, and one beside them that overlaps the first, none of which may become a cavity.
    let beside = moved(&part(10.0, 0.0), [9.0, 0.5, 0.5]);
    let sound = [part(10.0, 0.0), inverted(&part(8.0, 1.0)), part(2.0, 4.0), beside].concat();
    let model = Model::of(&miswound(&sound, |k| k % 3 == 0)).unwrap();
    assert_eq!(model.mesh, Model::of(&sound).unwrap().mesh);
    // What agrees with itself keeps its direction.
    let mixed = [miswound(&part(10.0, 0.0), |k| k < 5), part(8.0, 1.0)].concat();
    let model = Model::of(&mixed).unwrap();
    assert!((model.mesh.volume_mm3() - 1512.0).abs() < 1e-9 && model.warnings.len() == 1);
}

#[test]
fn an_open_surface_that_faces_both_ways_is_turned_and_still_told_to_be_open() {
    let model = Model::of(&miswound(&cuboid([1.0; 3])[1..], |k| k % 2 == 0)).unwrap();
    assert_eq!(model.mesh, Model::of(&cuboid([1.0; 3])[1..]).unwrap().mesh);
    let codes: Vec<&str> = model.warnings.iter().map(|w| w.code.as_str()).collect();
    assert_eq!(codes, ["model.open", "model.turned"]);
    assert!(model.warnings[0].text.starts_with("the surface is open: 3 edge(s)"), "{:?}", model.warnings);
}

#[test]
fn a_surface_with_one_side_is_told_and_not_turned() {
    let n = 24_u16;
    let at = |k: u16, out: f32| {
        let (turn, flip) =
            (std::f32::consts::TAU * f32::from(k % n) / f32::from(n), if k == n { -out } else { out });
        let half = turn / 2.0;
        let radius = 10.0 + flip * half.cos();
        [radius * turn.cos(), radius * turn.sin(), flip * half.sin()]
    };
    let strip =
        |k: u16| [[at(k, -1.0), at(k, 1.0), at(k + 1, 1.0)], [at(k, -1.0), at(k + 1, 1.0), at(k + 1, -1.0)]];
    let facets: Vec<Facet> = (0..n).flat_map(strip).collect();
    let told = Model::of(&facets).unwrap().warnings;
    assert!(
        told.iter().any(|w| w.code == "model.one_sided" && w.text.starts_with("at 1 edge(s)")),
        "{told:?}"
    );
    assert!(told.iter().all(|w| w.code != "model.turned"), "{told:?}");
}

#[test]
fn all_surfaces_are_said_to_face_inward_only_where_they_do() {
    let told = |facets: &[Facet]| Model::of(facets).unwrap().warnings[0].text.clone();
    let (large, small) = (inverted(&cuboid([2.0; 3])), moved(&cuboid([1.0; 3]), [5.0; 3]));
    assert_eq!(told(&large), "all surfaces faced inward: the model was turned inside out");
    let most = told(&[large, small].concat());
    assert_eq!(most, "most of the surface faced inward: the model was turned inside out");
}

#[test]
fn triangles_that_the_file_holds_twice_are_dropped_and_told() {
    let facets = tube(3.0, 4.0, 20.0, 64);
    let once = Model::of(&facets).unwrap();
    let mut doubled = facets.clone();
    // Some twice, one three times, one of them with its corners in another order.
    doubled.extend(facets.iter().skip(3).step_by(13));
    doubled.extend([facets[3], [facets[5][1], facets[5][2], facets[5][0]]]);
    let model = Model::of(&doubled).unwrap();
    assert_eq!(model.mesh, once.mesh);
    let n = doubled.len() - facets.len();
    let told: Vec<_> = model.warnings.iter().map(|w| (w.code.as_str(), w.text.clone())).collect();
    assert_eq!(
        told,
        [("model.doubled", format!("{n} triangles that the file holds more than once were dropped"))]
    );
}

#[test]
fn a_body_that_the_file_holds_twice_is_one_body() {
    let cube = cuboid([2.0; 3]);
    let twice = [cube.clone(), cube.clone()].concat();
    assert_eq!(Model::of(&twice).unwrap().mesh, Model::of(&cube).unwrap().mesh);
    // A wall that two bodies share is no double: both have its triangles, facing one way.
    let longer = cuboid([2.0, 2.0, 5.0]);
    let both = Model::of(&[cube.clone(), longer].concat()).unwrap();
    assert!(both.warnings.is_empty() && both.mesh.triangles.len() == 24, "{:?}", both.warnings);
    // Back to back they enclose nothing between them, and are no double.
    let lidded = [cube.clone(), inverted(&cube)].concat();
    assert_eq!(Model::of(&lidded), Err(Error::Flat));
}
