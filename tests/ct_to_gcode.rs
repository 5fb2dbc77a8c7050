//! From the intensities of a CT to a print job, stage by stage: what has to hold between the stages.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]

use lumenfab::geom::{Bounds2, Point2};
use lumenfab::phantom::{self, Contrast, Kind, Params};
use lumenfab::profile::{self, Profile};
use lumenfab::progress::Task;
use lumenfab::sections::SectionStack;
use lumenfab::slice::{GridParams, Layer};
use lumenfab::solid::{Body, Sectioned};
use lumenfab::toolpath::Toolpaths;
use lumenfab::{gcode, sections, segment, slice, solid, toolpath};

/// What the stages made of a phantom.
struct Way {
    stack: SectionStack,
    layers: Vec<Layer>,
    paths: Toolpaths,
    job: String,
    profile: Profile,
}

fn way(params: &Params, body: Body, profile: &str) -> Way {
    let task = Task::quiet();
    let profile = profile::builtin(profile).unwrap();
    let volume = phantom::volume(params, &task);
    let seeds_patient_mm = vec![phantom::default_seed(params)];
    let wanted = segment::Params { seeds_patient_mm, ..segment::Params::default() };
    let found = segment::segment(&volume, &wanted, &task).unwrap();
    let stack = sections::extract(&volume, &found, &sections::Params::default(), &task).unwrap().stack;
    let solid = solid::build(&stack, &solid::Params::new(body), &task).unwrap().solid;
    let grid = GridParams { layer_mm: 0.25, height_limits_mm: profile.machine.layer_height_mm };
    let grid = slice::grid(&stack.plane_z_mm(), solid.z_range_mm(), &grid).unwrap();
    let layers = slice::slice_solid(&solid, &grid, 0.005, &task).unwrap();
    let paths = toolpath::plan(&layers, &profile, &task).unwrap().paths;
    let job = gcode::write(&paths, &profile, &gcode::Header::default());
    Way { stack, layers, paths, job, profile }
}

/// A few planes on both sides of the split of the carotid.
fn split(polarity: Contrast) -> Params {
    Params {
        polarity,
        n_planes: 8,
        first_plane_z_mm: 54.0,
        n_pixels: 192,
        pixel_mm: 0.3,
        ..Params::default()
    }
}

const WALL: Body = Body::Wall { wall_mm: 1.0 };

/// Where the job extrudes: end points of moves on the bed, mm.
fn extruded_points(job: &str) -> Vec<[f64; 3]> {
    let mut at = [0.0; 3];
    let mut points = Vec::new();
    for line in job.lines() {
        let Some(command) = gcode::reader::parse(line).unwrap().command else { continue };
        // Arcs end where their words say, as lines do.
        if !(0..=3).any(|number| command.is('G', number)) {
            continue;
        }
        for (coordinate, letter) in at.iter_mut().zip(['X', 'Y', 'Z']) {
            *coordinate = command.value(letter).unwrap_or(*coordinate);
        }
        let moves = command.value('X').is_some() || command.value('Y').is_some();
        if moves && command.value('E').is_some_and(|e| e > 0.0) {
            points.push(at);
        }
    }
    points
}

#[test]
fn every_ct_plane_is_the_middle_of_a_layer_and_layers_lie_without_gaps() {
    for body in [WALL, Body::Cast] {
        let way = way(&split(Contrast::Bright), body, "marlin");
        let middles: Vec<(usize, f64)> =
            way.layers.iter().filter_map(|l| Some((l.slot.ct_plane?, l.slot.z_mid_mm))).collect();
        let planes: Vec<(usize, f64)> = way.stack.plane_z_mm().into_iter().enumerate().collect();
        assert_eq!(middles.len(), planes.len());
        for ((found, z), (expected, plane_z)) in middles.into_iter().zip(planes) {
            assert!(
                found == expected && (z - plane_z).abs() < 1e-9,
                "plane {expected}: {z} against {plane_z}"
            );
        }
        for pair in way.layers.windows(2) {
            let top = pair[0].slot.z_mid_mm + 0.5 * pair[0].slot.height_mm;
            let bottom = pair[1].slot.z_mid_mm - 0.5 * pair[1].slot.height_mm;
            assert!((top - bottom).abs() < 1e-9);
        }
    }
}

#[test]
fn the_vessel_splits_in_the_layers_as_it_does_in_the_ct() {
    let way = way(&split(Contrast::Bright), WALL, "marlin");
    let n_contours = |p: &sections::PlaneSections| p.contours.len();
    assert_eq!((n_contours(&way.stack.planes[0]), n_contours(&way.stack.planes[7])), (1, 2));
    for layer in &way.layers {
        let Some(plane) = layer.slot.ct_plane else { continue };
        let section = way.stack.planes[plane].region();
        assert_eq!(layer.lumen.islands().len(), section.islands().len(), "plane {plane}");
        let off = (layer.lumen.area_mm2() / section.area_mm2() - 1.0).abs();
        assert!(off < 0.01, "plane {plane}: area off by {off}");
    }
}

#[test]
fn every_bead_of_the_job_lies_on_the_bed_and_inside_its_layer() {
    for name in profile::builtin_names() {
        let way = way(&split(Contrast::Bright), WALL, name);
        let [x, y, z] = way.profile.machine.bed_mm;
        let bed = Bounds2 { min: Point2::origin(), max: Point2::new(x, y) };
        let points = extruded_points(&way.job);
        assert!(points.len() > 1000, "{name}: {} moves", points.len());
        let off_bed =
            points.iter().find(|p| !bed.contains(Point2::new(p[0], p[1])) || !(0.0..=z).contains(&p[2]));
        assert_eq!(off_bed, None, "{name}");
        let top = |z: f64| way.paths.layers.iter().find(|l| (l.z_mm - z).abs() < 1e-3);
        assert!(points.iter().all(|p| top(p[2]).is_some()), "{name}: a bead between the layers");
        // Above the first layer, which may have a skirt, no bead's middle lies outside the material.
        for p in points.iter().filter(|p| p[2] > way.paths.layers[0].z_mm + 0.01).step_by(17) {
            let layer = top(p[2]).unwrap();
            assert!(layer.material.contains(Point2::new(p[0], p[1])), "{name}: {p:?} outside the wall");
        }
    }
}

#[test]
fn bright_and_dark_lumens_give_the_same_body() {
    let area = |polarity| {
        let way = way(&split(polarity), Body::Cast, "reference");
        way.layers.iter().map(|l| l.material.area_mm2() * l.slot.height_mm).sum::<f64>()
    };
    let (bright, dark) = (area(Contrast::Bright), area(Contrast::Dark));
    assert!((bright / dark - 1.0).abs() < 0.02, "{bright} against {dark} mm3");
}

#[test]
fn the_same_ct_gives_the_same_bytes_on_any_number_of_threads() {
    let params = Params { kind: Kind::Merge, n_planes: 6, n_pixels: 160, pixel_mm: 0.4, ..Params::default() };
    let on = |n_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        pool.install(|| way(&params, WALL, "marlin").job)
    };
    let job = on(1);
    assert!(job == on(3), "the job differs between 1 and 3 threads");
    assert!(job == on(1), "the job differs between two runs");
}
