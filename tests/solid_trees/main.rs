//! Random vessel trees: splits, merges, loops, births, deaths and holes. What is built is right: it meets the contours of its planes
//! and lies near the exact field between them, its wall is as thick as asked, its mesh sound and, but for few, within the deflection. What is not
//! built is refused with its place named, and what contradicts itself with its plane.
//!
//! `cargo test --release --test solid_trees` tries a sample; `LUMENFAB_TREES=1000 cargo test --release --test solid_trees --
//! --nocapture` tries a thousand and lists what was refused, `LUMENFAB_TREES=200..300` some of them; with
//! `LUMENFAB_TREES_DIR=DIR` the contours of refused trees are written there as `treeN.json`. `PROPTEST_RNG_SEED=N` draws
//! other trees. With `-- --ignored` the first tree that is refused is shrunk to a small one; without a seed those are
//! drawn anew every time.

mod field;

use field::{Branch, Course, Hole, Tree};
use lumenfab::brep::{self, Brep};
use lumenfab::geom::{Contour, Point2, RigidTransform, SegmentIndex, Vector2};
use lumenfab::mesh::{self, SkinChoice, Tessellation, fit_for_files, tessellate};
use lumenfab::progress::Task;
use lumenfab::sections::format::to_json;
use lumenfab::sections::{PlaneSections, SectionStack};
use lumenfab::solid::{Body, Built, Params, Sectioned, Solid, Thickness, build};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::{RngSeed, TestRunner};

/// What is put into a tree that no solid can satisfy.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Contradiction {
    /// A contour crosses itself.
    Bow,
    /// Two contours of a plane cross each other.
    Crossing,
    /// A coordinate is not a number.
    NotANumber,
    /// A plane lies a second time in the stack, with other contours.
    RepeatedPlane,
    /// A plane in the middle has lost its contours.
    EmptyPlane,
}

#[derive(Debug, Clone)]
struct Case {
    tree: Tree,
    wall: bool,
    contradiction: Option<Contradiction>,
}

impl Case {
    /// How the message that refuses the contradiction begins: with the plane's number and height.
    fn place(&self, stack: &SectionStack) -> String {
        let middle = stack.planes.len() / 2;
        let z_mm = stack.planes[middle].z_mm;
        let plane = format!("plane {middle} (z {z_mm} mm)");
        match self.contradiction {
            None => String::new(),
            Some(Contradiction::Bow) => format!("{plane}, contour 0: it crosses itself near x"),
            Some(Contradiction::Crossing) => format!("{plane}: contours 0 and "),
            Some(Contradiction::NotANumber) => format!("{plane}, contour 0: point 7 is not a finite"),
            Some(Contradiction::RepeatedPlane) => {
                format!("planes {} and {middle} lie at one height, z {z_mm} mm", middle - 1)
            }
            Some(Contradiction::EmptyPlane) => format!("{plane} has no contour"),
        }
    }
}

fn branch() -> impl Strategy<Value = Branch> {
    let course = prop_oneof![
        4 => Just(Course::Split),
        3 => Just(Course::Merge),
        2 => Just(Course::Loop),
        1 => Just(Course::Birth),
        1 => Just(Course::Death),
    ];
    (course, 0.25..0.75f64, 0.3..1.2f64, 0.45..0.85f64, -1.0..1.0f64)
        .prop_map(|(course, at, slope, radius, turn)| Branch { course, at, slope, radius, turn })
}

fn tree() -> impl Strategy<Value = Tree> {
    let shape = (12..24usize, 1.0..2.5f64, prop::collection::vec(-1.0..1.0f64, 24), 2.0..4.5f64);
    let look = (-2.0..2.0f64, -2.0..2.0f64, 0.0..0.08f64, 0.4..1.2f64, 0.0..6.3f64);
    let hole = prop::option::weighted(
        0.15,
        (0.3..0.7f64, 1.2..3.0f64, 0.3..0.5f64).prop_map(|(at, half_steps, radius)| Hole {
            at,
            half_steps,
            radius,
        }),
    );
    (shape, look, prop::collection::vec(branch(), 0..4), hole).prop_map(
        |(
            (n_planes, step_mm, jitter, trunk_radius_mm),
            (x, y, oval, blend_mm, direction_rad),
            branches,
            hole,
        )| Tree {
            n_planes,
            step_mm,
            jitter,
            trunk_radius_mm,
            wobble_mm: [x, y],
            oval,
            blend_mm,
            direction_rad,
            branches,
            hole,
        },
    )
}

fn case() -> impl Strategy<Value = Case> {
    let contradiction = prop_oneof![
        Just(Contradiction::Bow),
        Just(Contradiction::Crossing),
        Just(Contradiction::NotANumber),
        Just(Contradiction::RepeatedPlane),
        Just(Contradiction::EmptyPlane),
    ];
    let planted = prop::option::weighted(0.01, contradiction);
    (tree(), any::<bool>(), planted).prop_map(|(tree, wall, contradiction)| Case {
        tree,
        wall,
        contradiction,
    })
}

fn stack_of(case: &Case) -> SectionStack {
    let plane = |z_mm: f64| PlaneSections { z_mm, contours: case.tree.contours(z_mm) };
    let mut planes: Vec<PlaneSections> = case.tree.plane_z_mm().into_iter().map(plane).collect();
    let middle = planes.len() / 2;
    let contours = &mut planes[middle].contours;
    match case.contradiction {
        None => {}
        Some(Contradiction::Bow) => {
            let n = contours[0].len();
            contours[0].points.swap(n / 4, 3 * n / 4);
        }
        Some(Contradiction::Crossing) => {
            let moved = contours[0].points.iter().map(|p| p + Vector2::new(1.0, 0.3)).collect();
            contours.push(Contour::new(moved));
        }
        Some(Contradiction::NotANumber) => contours[0].points[7] = Point2::new(f64::NAN, 0.0),
        Some(Contradiction::RepeatedPlane) => {
            let z_mm = planes[middle - 1].z_mm;
            planes[middle].z_mm = z_mm;
        }
        Some(Contradiction::EmptyPlane) => contours.clear(),
    }
    SectionStack { planes, patient_from_stack: RigidTransform::identity() }
}

/// Every given contour lies on the solid's section at its plane, which has as many contours: all but holes of one plane
/// alone, of which it is told that they were filled.
fn check_interpolation(stack: &SectionStack, built: &Built) -> Result<(), TestCaseError> {
    let solid = &built.solid;
    for (k, plane) in stack.planes.iter().enumerate() {
        let place = format!("plane {k} (");
        let is_filled =
            built.warnings.iter().any(|w| w.code == "topology.hole_filled" && w.text.starts_with(&place));
        let given: Vec<&Contour> = plane.contours.iter().filter(|c| c.is_ccw() || !is_filled).collect();
        let cut = solid.section(plane.z_mm, 1e-4);
        let lumen = if solid.outer.is_some() { cut.lumen } else { cut.outer };
        prop_assert_eq!(lumen.contours.len(), given.len(), "contours at z {}", plane.z_mm);
        let index = SegmentIndex::try_new(&lumen.contours).expect("a plane has contours");
        for p in given.iter().flat_map(|c| &c.points) {
            let distance_mm = index.nearest(*p).distance_mm;
            prop_assert!(distance_mm < 1e-3, "{} mm off at z {}", distance_mm, plane.z_mm);
        }
    }
    Ok(())
}

/// Heights in each interval between two planes at which the lumen is compared with the exact field, as shares of it.
const SHARES_BETWEEN: [f64; 5] = [0.1, 0.3, 0.5, 0.7, 0.9];
/// How far the lumen may lie off it there, mm.
const MOST_OFF_MM: f64 = 0.3;
/// Wall that is asked for, mm, and within which part of it that must be as built.
const WALL_MM: f64 = 1.0;
const THICKNESS: std::ops::RangeInclusive<f64> = 0.9..=1.1;

/// What became of a tree.
#[derive(Debug, Clone, PartialEq)]
enum Outcome {
    Valid,
    /// Refused, with the message.
    Refused(String),
    /// Built, but not as asked.
    Off(String),
}

fn solid_of(case: &Case, stack: &SectionStack) -> Result<Built, String> {
    let body = if case.wall { Body::Wall { wall_mm: WALL_MM } } else { Body::Cast };
    let built = build(stack, &Params::new(body), &Task::quiet()).map_err(|e| e.to_string())?;
    brep::check(&Brep::of(&built.solid, SkinChoice::All)).map_err(|e| e.to_string())?;
    Ok(built)
}

/// Whether a message begins by telling where: a plane or a height with its number.
fn names_a_place(message: &str) -> bool {
    let begun = ["the solid is not valid: ", "outer skin of the wall, ", "the branch from "];
    let about = begun.into_iter().fold(message, |text, start| text.strip_prefix(start).unwrap_or(text));
    let number =
        ["plane ", "planes ", "between planes ", "z "].into_iter().find_map(|p| about.strip_prefix(p));
    let is_numeric = |c: char| c.is_ascii_digit() || c == '-';
    number.is_some_and(|n| n.starts_with(is_numeric))
}

/// A mesh as a file holds it must be closed and meet itself nowhere; gives what is said where none keeps the deflection, as
/// `export` then says.
fn mesh_fault(solid: &Solid) -> Result<Option<String>, TestCaseError> {
    let how = Tessellation::within(0.05, SkinChoice::All);
    let mesh = tessellate(solid, &how, &Task::quiet());
    match mesh.and_then(|mesh| fit_for_files(&mesh, &Task::quiet())) {
        Ok(_) => Ok(None),
        Err(fault @ mesh::Error::Deviates { .. }) => Ok(Some(fault.to_string())),
        Err(fault) => Err(TestCaseError::fail(format!("valid surfaces without a mesh: {fault}"))),
    }
}

/// How far the lumen's sections between planes lie off the tree's own field, mm, at most, and at which height.
fn farthest_off(case: &Case, stack: &SectionStack, solid: &Solid) -> (f64, f64) {
    let off = |z_mm: f64| {
        let cut = solid.section(z_mm, 1e-3);
        let lumen = if solid.outer.is_some() { cut.lumen } else { cut.outer };
        let points = lumen.contours.iter().flat_map(|c| &c.points);
        (points.map(|p| case.tree.value(*p, z_mm).abs()).fold(0.0, f64::max), z_mm)
    };
    let between = |pair: &[PlaneSections]| {
        let [low, high] = [pair[0].z_mm, pair[1].z_mm];
        SHARES_BETWEEN.map(|share| low + share * (high - low))
    };
    let heights = stack.planes.windows(2).flat_map(between);
    heights.map(off).fold((0.0, 0.0), |most, one| if one.0 > most.0 { one } else { most })
}

/// What is not as it was asked for in a solid that is valid.
fn fault(case: &Case, stack: &SectionStack, built: &Built) -> Option<String> {
    if case.wall {
        let Some(Thickness { least_mm, most_mm, .. }) = built.thickness else {
            return Some("a wall whose thickness is not told".into());
        };
        if ![least_mm, most_mm].iter().all(|mm| THICKNESS.contains(&(mm / WALL_MM))) {
            return Some(format!("the wall is {least_mm:.3} to {most_mm:.3} mm thick"));
        }
    }
    let (off_mm, z_mm) = farthest_off(case, stack, &built.solid);
    (off_mm > MOST_OFF_MM).then(|| format!("the lumen is {off_mm:.3} mm off at z {z_mm:.2} mm"))
}

/// Builds a tree. What is built must be right: its planes' contours met, its mesh sound; a contradiction must be
/// refused, naming the plane, and whatever else is refused must name a place.
fn tried(case: &Case) -> Result<Outcome, TestCaseError> {
    let stack = stack_of(case);
    let built = match solid_of(case, &stack) {
        Ok(built) => built,
        Err(message) if case.contradiction.is_none() => {
            prop_assert!(names_a_place(&message), "no place is named: {}", message);
            return Ok(Outcome::Refused(message));
        }
        Err(message) => {
            let place = case.place(&stack);
            prop_assert!(message.starts_with(&place), "{}: expected {}", message, place);
            return Ok(Outcome::Valid);
        }
    };
    prop_assert!(case.contradiction.is_none(), "{:?} was not noticed", case.contradiction);
    check_interpolation(&stack, &built)?;
    let fault = mesh_fault(&built.solid)?.or_else(|| fault(case, &stack, &built));
    Ok(fault.map_or(Outcome::Valid, Outcome::Off))
}

/// Writes the sections of a refused tree, where a directory for them is named.
fn keep(tree: u32, stack: &SectionStack) {
    if let Some(dir) = std::env::var_os("LUMENFAB_TREES_DIR") {
        let text = to_json(stack).expect("numbers");
        std::fs::write(std::path::Path::new(&dir).join(format!("tree{tree}.json")), text)
            .expect("a directory");
    }
}

/// Trees that are tried: `N` stands for the first N of the sequence, `FROM..TO` for a part of it.
fn parsed(asked: &str) -> Option<std::ops::Range<u32>> {
    let (from, to) = asked.split_once("..").unwrap_or(("0", asked));
    let range = from.parse().ok()?..to.parse().ok()?;
    (!range.is_empty()).then_some(range)
}

/// Those that `LUMENFAB_TREES` asks for.
fn trees() -> std::ops::Range<u32> {
    let Some(asked) = std::env::var_os("LUMENFAB_TREES") else { return 0..40 };
    let range = asked.to_str().and_then(parsed);
    range.unwrap_or_else(|| panic!("LUMENFAB_TREES is {asked:?}: it must be a number of trees, or FROM..TO"))
}

/// Of twenty trees, or a part of twenty, one may be no valid solid as it was asked for. The aim is one of a hundred; of the sample of 40
/// that cargo's seed draws 38 are: of one a patch of a loop crosses itself, and the mesh of another one is 0.053 mm off where 0.05 was asked.
const PER_EXCEPTION: usize = 20;

/// Draws always the same trees, or those of the seed that `PROPTEST_RNG_SEED` names.
fn runner(config: ProptestConfig) -> TestRunner {
    match config.rng_seed {
        RngSeed::Random => TestRunner::deterministic(),
        RngSeed::Fixed(_) => TestRunner::new(config),
    }
}

/// The first tree that is drawn.
fn first_tree(seed: RngSeed) -> String {
    let mut runner = runner(ProptestConfig { rng_seed: seed, ..ProptestConfig::default() });
    format!("{:?}", case().new_tree(&mut runner).expect("nothing is filtered out").current())
}

#[test]
fn a_seed_draws_other_trees_and_always_the_same() {
    let [usual, one, two] = [RngSeed::Random, RngSeed::Fixed(1), RngSeed::Fixed(2)].map(first_tree);
    assert!(usual != one && one != two && usual != two);
    assert_eq!([RngSeed::Random, RngSeed::Fixed(1)].map(first_tree), [usual, one]);
}

#[test]
fn trees_become_valid_solids_or_are_refused_by_name() {
    let mut runner = runner(ProptestConfig::default());
    let mut refused: Vec<String> = Vec::new();
    let asked = trees();
    for i in 0..asked.end {
        let case = case().new_tree(&mut runner).unwrap().current();
        if i < asked.start {
            continue;
        }
        let outcome = tried(&case).unwrap_or_else(|e| {
            keep(i, &stack_of(&case));
            panic!("tree {i}: {e}")
        });
        if let Outcome::Refused(message) | Outcome::Off(message) = outcome {
            let courses: Vec<Course> = case.tree.branches.iter().map(|b| b.course).collect();
            refused.push(format!("tree {i}, wall {}, {courses:?}: {message}", case.wall));
            eprintln!("{}", refused[refused.len() - 1]);
            keep(i, &stack_of(&case));
        }
    }
    let n_valid = asked.len() - refused.len();
    eprintln!("{n_valid} of {} trees are valid solids; the others: {refused:#?}", asked.len());
    assert!(refused.len() <= asked.len().div_ceil(PER_EXCEPTION), "{refused:#?}");
}

#[test]
fn what_asks_for_no_trees_is_refused() {
    assert_eq!([parsed("40"), parsed("200..300")], [Some(0..40), Some(200..300)]);
    for text in ["", "0", "1e3", "200..100", "7..7", "a..b", "..5", "-3", "1..2..3"] {
        assert_eq!(parsed(text), None, "{text}");
    }
}

#[test]
fn a_place_is_a_plane_or_a_height_with_its_number() {
    for text in [
        "plane 3 (z 9 mm), contour 0: it crosses itself",
        "planes 2 and 3 lie at one height",
        "between planes 3 and 4 (z 1.00 to 2.00 mm): what is there",
        "the branch from z -1.50 to 3.00 mm: it folds",
        "outer skin of the wall, z 1.00 to 2.00 mm: it folds",
        "outer skin of the wall, the branch from z 1.00 to 2.00 mm: it folds",
        "the solid is not valid: z 7.50 mm, x 1.00, y 2.00 (tube): it crosses",
        "z 7.50 mm, x 1.00, y 2.00: the wall would be 0.10 mm thick",
    ] {
        assert!(names_a_place(text), "{text}");
    }
    for text in ["cannot", "the solid is not valid", "the lumen has no surface", "plane of the image"] {
        assert!(!names_a_place(text), "{text}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: trees().end, failure_persistence: None, max_shrink_iters: 100, ..ProptestConfig::default() })]

    /// Shrinks the first tree that is refused to the smallest such tree.
    #[test]
    #[ignore = "finds what is still refused; the test above counts"]
    fn every_tree_becomes_a_valid_solid(case in case()) {
        prop_assert_eq!(tried(&case)?, Outcome::Valid);
    }
}

#[test]
fn every_contradiction_is_refused_with_its_place() {
    let tree = Tree {
        n_planes: 12,
        step_mm: 2.0,
        jitter: vec![0.0],
        trunk_radius_mm: 3.0,
        wobble_mm: [1.0, 0.5],
        oval: 0.03,
        blend_mm: 0.8,
        direction_rad: 0.4,
        branches: Vec::new(),
        hole: None,
    };
    let all = [
        Contradiction::Bow,
        Contradiction::Crossing,
        Contradiction::NotANumber,
        Contradiction::RepeatedPlane,
        Contradiction::EmptyPlane,
    ];
    for contradiction in all {
        let case = Case { tree: tree.clone(), wall: false, contradiction: Some(contradiction) };
        assert_eq!(tried(&case).unwrap(), Outcome::Valid, "{contradiction:?}");
    }
}
