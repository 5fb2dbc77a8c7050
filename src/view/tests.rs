use super::*;

/// A closed bar along z, from -10 to 10, of square section, 4 wide at x and 2 at y.
fn bar() -> TriMesh {
    let corner = |i: u32| {
        let pick = |bit: u32, size: f64| if i >> bit & 1 == 1 { size } else { -size };
        Point3::new(pick(0, 2.0), pick(1, 1.0), pick(2, 10.0))
    };
    let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    TriMesh {
        vertices: (0..8).map(corner).collect(),
        triangles: sides.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect(),
    }
}

fn scene(mesh: &TriMesh) -> Scene<'_> {
    let paint = Paint::Skins { is_lumen: vec![false; mesh.triangles.len()] };
    Scene { mesh, paint, patient_from_stack: RigidTransform::identity(), cut: None }
}

fn camera(mesh: &TriMesh, from: Direction) -> Camera {
    Look::of(mesh, from, &RigidTransform::identity()).camera([200.0, 400.0], 20.0)
}

/// Samples that see something, and the mean depth of these, mm.
fn covered(scene: &Scene<'_>, from: Direction) -> (f64, f64) {
    let camera = camera(scene.mesh, from);
    let seen = raster(scene, &camera, &Task::quiet()).unwrap();
    let hits: Vec<f64> =
        seen.iter().filter(|s| s.depth.is_finite()).map(|s| f64::from(s.depth) / 20.0).collect();
    (hits.len() as f64 / 400.0, hits.iter().sum::<f64>() / hits.len() as f64)
}

#[test]
fn every_direction_sees_its_side_at_its_size() {
    let bar = bar();
    for (from, area_mm2, depth_mm) in [
        (Direction::Front, 80.0, -1.0),
        (Direction::Back, 80.0, -1.0),
        (Direction::Left, 40.0, -2.0),
        (Direction::Right, 40.0, -2.0),
        (Direction::Top, 8.0, -10.0),
        (Direction::Bottom, 8.0, -10.0),
    ] {
        let (area, depth) = covered(&scene(&bar), from);
        assert!(
            (area / area_mm2 - 1.0).abs() < 0.01 && (depth - depth_mm).abs() < 1e-3,
            "{from:?} {area} {depth}"
        );
    }
}

#[test]
fn right_and_left_are_those_of_the_patient() {
    let right_of = |from: Direction| {
        let look = Look::of(&bar(), from, &RigidTransform::identity());
        (draw::side_letter(look.axes[0], ["S", "I"]), draw::side_letter(look.axes[1], ["S", "I"]))
    };
    assert_eq!(right_of(Direction::Front), ("L", "S"));
    assert_eq!(right_of(Direction::Back), ("R", "S"));
    assert_eq!(right_of(Direction::Left), ("P", "S"));
    assert_eq!(right_of(Direction::Right), ("A", "S"));
    assert_eq!(right_of(Direction::Top), ("R", "A"));
    assert_eq!(right_of(Direction::Bottom), ("L", "A"));
}

#[test]
fn a_cut_leaves_the_half_behind_the_middle() {
    let bar = bar();
    let middle = Middle { rows: vec![(-10.0, vec![Point2::origin()]), (10.0, vec![Point2::origin()])] };
    let cut = Scene { cut: Some(middle), ..scene(&bar) };
    let camera = camera(&bar, Direction::Front);
    let seen = raster(&cut, &camera, &Task::quiet()).unwrap();
    let hits: Vec<&raster::Seen> = seen.iter().filter(|s| s.depth.is_finite()).collect();
    // The front is gone: its inside is seen, the back from within.
    assert!(hits.len() > 31_000 && hits.iter().all(|s| s.is_back && s.depth >= 0.0));
}

#[test]
fn a_picture_is_the_same_on_any_number_of_threads() {
    let bar = bar();
    let picture = |n: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| {
            render(&scene(&bar), &[Direction::Front, Direction::Oblique], 300, &Task::quiet()).unwrap()
        })
    };
    let one = picture(1);
    assert!(one.starts_with(b"\x89PNG"));
    assert_eq!(one, picture(3));
}

#[test]
fn a_body_of_nothing_is_an_empty_picture() {
    let nothing = TriMesh::default();
    assert!(render(&scene(&nothing), &[Direction::Front], 300, &Task::quiet()).is_ok());
}

#[test]
fn drawing_stops_when_asked() {
    let cancel = crate::progress::CancelToken::default();
    cancel.cancel();
    let task = Task::new(&|_, _| {}, cancel);
    assert_eq!(render(&scene(&bar()), &[Direction::Front], 300, &task), Err(Error::Cancelled(Cancelled)));
}
