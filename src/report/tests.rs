//! The whole room on synthetic cases: what is put in must be found, in the right stage, in the right plane, of the
//! right size, and nothing else.

use super::testing::{BEAD_MM, Case, Forked, INTERVAL_MM, LAYER_MM, RADIUS_MM, WALL_MM, disk, inputs, print};
use super::*;
use crate::ct::Voxels;
use crate::geom::Point3;
use crate::geom::{Contour, Point2, RigidTransform, Vector3};
use crate::progress::{CancelToken, Task};
use crate::slice::LayerSlot;

fn report(case: &Case) -> Report {
    build(&inputs(case), &Task::quiet()).unwrap()
}

fn overall(report: &Report, stage: Stage) -> Figures {
    report.block(stage).overall.unwrap().figures
}

fn plane(report: &Report, stage: Stage, k: usize) -> Figures {
    report.block(stage).planes[k].figures
}

fn near(value: Option<f64>, expected: f64, tolerance: f64) -> bool {
    value.is_some_and(|v| (v - expected).abs() <= tolerance)
}

#[test]
fn a_clean_case_shows_nothing_and_passes() {
    let report = report(&Case::new(5));
    for stage in Stage::ALL {
        let f = overall(&report, stage);
        assert!(f.mean_mm.unwrap() < 0.012 && f.bias_mm.unwrap().abs() < 0.012, "{}: {f:?}", stage.name());
        assert!(f.dice.unwrap() > 0.995, "{}: {f:?}", stage.name());
    }
    assert!(report.verdict.passed, "{:?}", report.verdict);
    let deposition = report.block(Stage::Deposition).overall.unwrap();
    assert!(near(deposition.iou_min, 1.0, 1e-9) && near(deposition.iou_mean, 1.0, 1e-9));
    assert_eq!(report.layers.len(), 75);
    assert!(report.notes.iter().any(|n| n.code == "report.extrapolated_ends" && n.text.contains("1.50 mm")));
}

#[test]
fn a_straight_tube_has_its_course_its_wall_and_its_volumes() {
    let job = Job { planned_s: Some(100.0), recorded_s: Some(101.0), ..Job::default() };
    let case = Case::new(5);
    let report = build(&Inputs { job, ..inputs(&case) }, &Task::quiet()).unwrap();
    let length_mm = 4.0 * INTERVAL_MM;
    let volume_mm3 = std::f64::consts::PI * RADIUS_MM * RADIUS_MM * length_mm;
    for stage in &report.anatomy.branches[0].stages {
        let line = &stage.centreline;
        assert!(near(line.length_mm, length_mm, 2e-3) && near(line.tortuosity, 0.0, 1e-4), "{stage:?}");
        assert!(near(stage.maximum_diameter_mm, 2.0 * RADIUS_MM, 0.03), "{stage:?}");
    }
    for wall in &report.walls {
        let all = wall.overall.unwrap();
        for thickness in [all.mean_mm, all.min_mm, all.max_mm] {
            assert!(near(thickness, WALL_MM, 5e-3), "{}: {all:?}", wall.stage);
        }
        assert!(near(all.filled_percent, 100.0, 0.2), "{}: {all:?}", wall.stage);
    }
    assert_eq!(report.walls.len(), 4);
    for lumen in &report.amounts.lumen {
        assert!(near(lumen.volume_mm3, volume_mm3, 0.01 * volume_mm3), "{lumen:?}");
    }
    let (planned, recorded) = (report.amounts.planned_material_mm3, report.amounts.recorded_material_mm3);
    assert!(near(planned, recorded.unwrap(), 1e-9) && report.amounts.job == job);
    let json: serde_json::Value = serde_json::from_str(&report.to_json().unwrap()).unwrap();
    assert!(json["findings"].as_array().unwrap().is_empty() && json["not_seen"].is_array());
    assert!(json["amounts"]["planned_s"] == 100.0 && json["uncertainty_mm"]["image_place"].is_number());
}

#[test]
fn a_contour_moved_outward_is_an_error_of_segmentation_on_its_planes() {
    let mut case = Case::new(6);
    for k in [2, 3] {
        case.sections.planes[k].contours = vec![Contour::circle(Point2::origin(), RADIUS_MM + 0.3, 128)];
    }
    let report = report(&case);
    for k in 0..6 {
        let expected = if k == 2 || k == 3 { 0.3 } else { 0.0 };
        let f = plane(&report, Stage::Segmentation, k);
        assert!(near(f.bias_mm, expected, 0.015), "plane {k}: {f:?}");
        assert!(near(plane(&report, Stage::Reconstruction, k).bias_mm, -expected, 0.003));
        assert!(near(plane(&report, Stage::Total, k).bias_mm, 0.0, 0.015));
    }
    assert!(near(overall(&report, Stage::Segmentation).bias_mm, 0.1, 0.015));
}

#[test]
fn a_scaled_solid_is_an_error_of_reconstruction() {
    let mut case = Case::new(4);
    case.solid.radius_mm *= 1.01;
    let report = report(&case);
    assert!(near(overall(&report, Stage::Reconstruction).bias_mm, 0.03, 0.001));
    assert!(near(overall(&report, Stage::Reconstruction).area_error_percent, 2.01, 0.06));
    assert!(near(overall(&report, Stage::Slicing).bias_mm, -0.03, 0.001));
}

#[test]
fn a_layer_shift_is_found_where_it_begins() {
    let mut case = Case::new(6);
    let from_mm = case.paths.layers[45].z_mm - 0.01;
    for s in case.record.segments.iter_mut().filter(|s| s.from.z > from_mm) {
        s.from.x += 0.4;
        s.to.x += 0.4;
    }
    let report = report(&case);
    for k in 0..6 {
        let f = plane(&report, Stage::Deposition, k);
        let expected = if k < 3 { 0.0 } else { 0.4 };
        // The closed form of a shifted circle: maximum d, mean 2 d / pi to first order.
        assert!(near(f.max_mm, expected, 0.005), "plane {k}: {f:?}");
        assert!(near(f.mean_mm, expected * 2.0 / std::f64::consts::PI, 0.005));
    }
    let shifted: Vec<usize> = report.layers.iter().filter(|l| l.iou < Some(0.97)).map(|l| l.layer).collect();
    assert_eq!(shifted, (45..90).collect::<Vec<_>>());
    assert!(!report.verdict.passed && report.verdict.failures.iter().any(|f| f.contains("IoU")));
}

#[test]
fn thin_beads_widen_the_lumen_by_half_of_what_they_lack() {
    let mut case = Case::new(4);
    for s in &mut case.record.segments {
        s.width_mm *= 0.8;
    }
    let report = report(&case);
    assert!(near(overall(&report, Stage::Deposition).bias_mm, 0.1 * BEAD_MM, 0.002));
    assert!(near(overall(&report, Stage::Deposition).area_error_percent, -20.0, 0.2));
    assert!(near(overall(&report, Stage::Total).bias_mm, 0.1 * BEAD_MM, 0.015));
}

#[test]
fn a_missing_layer_is_named() {
    let mut case = Case::new(4);
    let z_mm = case.paths.layers[20].z_mm;
    case.record.segments.retain(|s| (s.from.z - z_mm).abs() > 0.01);
    let report = report(&case);
    assert!(near(report.layers[20].iou, 0.0, 1e-12));
    let note = report.notes.iter().find(|n| n.code == "report.layers_not_deposited").unwrap();
    assert!(note.text.contains("1 of 60") && note.text.contains("layer 20"), "{}", note.text);
}

#[test]
fn a_missing_layer_at_a_ct_plane_leaves_null_with_the_reason() {
    let mut case = Case::new(4);
    let z_mm = case.paths.layers[22].z_mm;
    case.record.segments.retain(|s| (s.from.z - z_mm).abs() > 0.01);
    let report = report(&case);
    let entry = &report.block(Stage::Deposition).planes[1];
    assert!(entry.figures.mean_mm.is_none() && entry.reason.as_ref().unwrap().contains("deposited"));
    assert!(report.verdict.failures.iter().any(|f| f.contains("planes 1")));
}

#[test]
fn prime_lines_and_stray_pieces_are_said_and_not_counted() {
    let mut case = Case::new(3);
    let mut prime = case.record.segments[0];
    (prime.from.x, prime.from.y, prime.to.x, prime.to.y) = (5.0, 5.0, 5.0, 60.0);
    let mut stray = case.record.segments[0];
    (stray.from.z, stray.to.z) = (3.1, 3.1);
    case.record.segments.splice(0..0, [prime, stray]);
    let report = report(&case);
    assert!(near(report.block(Stage::Deposition).overall.unwrap().iou_min, 1.0, 1e-9));
    for code in ["report.deposited_elsewhere", "report.deposited_between_layers"] {
        assert!(report.notes.iter().any(|n| n.code == code && n.text.starts_with("1 piece")), "{code}");
    }
}

#[test]
fn without_a_ct_the_image_stages_are_null_with_the_reason() {
    let case = Case::new(3);
    let report = build(&Inputs { image: None, ..inputs(&case) }, &Task::quiet()).unwrap();
    let json: serde_json::Value = serde_json::from_str(&report.to_json().unwrap()).unwrap();
    for stage in ["segmentation", "total"] {
        assert!(json[stage]["overall"].is_null() && json[stage]["reason"].is_string());
    }
    assert!(json["deposition"]["overall"]["mean_mm"].is_number());
    assert!(html(&report).unwrap().contains("ready contours"));
    assert_eq!(report.pictures.len(), 3);
}

#[test]
fn a_cropped_volume_measures_the_planes_that_it_has() {
    let mut case = Case::new(4);
    let n = case.volume.dims[0] * case.volume.dims[1];
    let rest: Vec<f32> = case.volume.hu.iter().skip(n).collect();
    case.volume.hu = Voxels::new(&rest, n);
    case.volume.plane_z_mm.remove(0);
    case.volume.dims[2] = 3;
    let report = report(&case);
    assert!(report.block(Stage::Total).planes[0].reason.is_some());
    assert_eq!(report.block(Stage::Total).overall.unwrap().n_planes, 3);
    assert!(report.notes.iter().any(|n| n.code == "report.planes_without_image"));
}

#[test]
fn a_cast_is_measured_by_what_is_filled() {
    let mut case = Case::new(3);
    // The same beads are the cast of a ring-shaped lumen.
    let (outer, inner) =
        (disk(RADIUS_MM + WALL_MM).contours[0].clone(), disk(RADIUS_MM).contours[0].reversed());
    let ring = crate::geom::Region::new(vec![outer.clone(), inner.clone()]);
    for layer in &mut case.layers {
        layer.material = ring.clone();
    }
    for plane in &mut case.sections.planes {
        plane.contours = vec![outer.clone(), inner.clone()];
    }
    #[derive(Debug)]
    struct Ring(crate::geom::Region);
    impl Sectioned for Ring {
        fn z_range_mm(&self) -> [f64; 2] {
            [-1.5, 7.5]
        }
        fn section(&self, _: f64, _: f64) -> crate::solid::CrossSection {
            crate::solid::CrossSection { outer: self.0.clone(), lumen: crate::geom::Region::default() }
        }
    }
    let solid = Ring(ring);
    let cast = Inputs { image: None, solid: &solid, body: BodyKind::Cast, ..inputs(&case) };
    let report = build(&cast, &Task::quiet()).unwrap();
    for stage in &Stage::ALL[1..5] {
        let f = overall(&report, *stage);
        assert!(f.mean_mm.unwrap() < 0.004 && f.dice.unwrap() > 0.998, "{}: {f:?}", stage.name());
    }
}

/// The case as the planner plans it and a perfect printer prints it.
fn planned(mut case: Case, change: impl Fn(&mut crate::profile::PrintSettings)) -> Case {
    let mut profile = crate::profile::builtin("reference").unwrap();
    profile.filament.shrinkage_percent = 5.0;
    change(&mut profile.print);
    case.paths = crate::toolpath::plan(&case.layers, &profile, &Task::quiet()).unwrap().paths;
    case.record = print(&case.paths);
    case
}

#[test]
fn holes_compensated_in_a_part_that_shrinks_are_measured_as_they_are_when_cold() {
    let case = planned(Case::new(3), |print| print.hole_compensation_mm = 0.5);
    let report = report(&case);
    // The part is enlarged, then its lumen's outline moved on the bed; all of it shrinks.
    let cold_mm = 0.5 * 0.95;
    for stage in [Stage::Toolpath, Stage::Total] {
        assert!(near(overall(&report, stage).bias_mm, cold_mm, 0.015), "{:?}", overall(&report, stage));
    }
    assert!(near(overall(&report, Stage::Deposition).bias_mm, 0.0, 1e-6));
    let note = report.notes.iter().find(|n| n.code == "report.compensated").unwrap();
    assert!(note.text.contains("+0.475 mm"), "{}", note.text);
}

#[test]
fn a_cast_that_is_squeezed_and_shrinks_is_measured_as_it_is_when_cold() {
    let mut case = Case::new(3);
    for layer in &mut case.layers {
        (layer.material, layer.lumen) = (disk(RADIUS_MM), crate::geom::Region::default());
    }
    let case = planned(case, |print| print.squeeze_compensation_mm = 0.4);
    #[derive(Debug)]
    struct Rod;
    impl Sectioned for Rod {
        fn z_range_mm(&self) -> [f64; 2] {
            [-1.5, 7.5]
        }
        fn section(&self, _: f64, _: f64) -> crate::solid::CrossSection {
            crate::solid::CrossSection { outer: disk(RADIUS_MM), lumen: crate::geom::Region::default() }
        }
    }
    let cast = Inputs { image: None, solid: &Rod, body: BodyKind::Cast, ..inputs(&case) };
    let report = build(&cast, &Task::quiet()).unwrap();
    assert!(near(overall(&report, Stage::Toolpath).bias_mm, -0.4 * 0.95, 0.015));
    let note = report.notes.iter().find(|n| n.code == "report.compensated").unwrap();
    assert!(note.text.contains("-0.380 mm"), "{}", note.text);
}

#[test]
fn what_does_not_belong_together_is_refused() {
    let mut case = Case::new(3);
    let inner = case.paths.bed_from_stack;
    case.paths.bed_from_stack = RigidTransform::translation(Vector3::new(0.02, 0.0, 0.0)).after(&inner);
    let error = build(&inputs(&case), &Task::quiet()).unwrap_err();
    assert!(matches!(error, Error::Registration { off_mm, .. } if (off_mm - 0.02).abs() < 1e-3));
    assert!(error.to_string().contains("slice the case again"));

    case.paths.bed_from_stack =
        RigidTransform::from_axes(Point3::origin(), Vector3::x(), Vector3::z(), -Vector3::y());
    assert!(
        matches!(build(&inputs(&case), &Task::quiet()), Err(Error::Tilted { tilt_deg }) if (tilt_deg - 90.0).abs() < 1e-6)
    );

    let mut case = Case::new(3);
    case.paths.layers.clear();
    assert!(matches!(build(&inputs(&case), &Task::quiet()), Err(Error::NoLayers)));
    case.sections.planes.clear();
    assert!(matches!(build(&inputs(&case), &Task::quiet()), Err(Error::NoPlanes)));
}

#[test]
fn an_interrupted_report_stops() {
    let cancel = CancelToken::default();
    cancel.cancel();
    let task = Task::new(&|_, _| {}, cancel);
    assert!(matches!(build(&inputs(&Case::new(2)), &task), Err(Error::Cancelled(_))));
}

#[test]
fn the_same_case_gives_the_same_bytes_on_any_number_of_threads() {
    let case = Case::new(4);
    let on = |n: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        let report = pool.install(|| report(&case));
        (report.to_json().unwrap(), html(&report).unwrap(), report.pictures)
    };
    assert!(on(1) == on(3));
}

#[test]
fn an_empty_record_gives_a_report_that_fails() {
    let mut case = Case::new(2);
    case.record = Record::default();
    let report = report(&case);
    assert!(!report.verdict.passed);
    assert!(html(&report).unwrap().contains("verdict failed"));
}

#[test]
fn json_has_the_blocks_and_fields_of_the_contract() {
    let json: serde_json::Value = serde_json::from_str(&report(&Case::new(3)).to_json().unwrap()).unwrap();
    for stage in Stage::ALL {
        let block = &json[stage.name()];
        for entry in [&block["overall"], &block["planes"][2]] {
            for field in ["mean_mm", "rms_mm", "p95_mm", "max_mm", "bias_mm", "dice", "area_error_percent"] {
                assert!(entry[field].is_number(), "{} {field}", stage.name());
            }
        }
        assert_eq!(block["planes"][2]["plane"], 2);
        assert_eq!(block["planes"][2]["z_mm"], 2.0 * INTERVAL_MM);
    }
    assert!(json["anatomy"]["branches"][0]["stages"][0]["lumen_area_mm2"].is_number());
}

#[test]
fn text_of_others_is_escaped() {
    let case = Case::new(2);
    let hostile = [Warning { code: "ct.x".into(), text: "<script>alert(1)</script> & \"quoted\"".into() }];
    let report = build(&Inputs { warnings: &hostile, ..inputs(&case) }, &Task::quiet()).unwrap();
    let page = html(&report).unwrap();
    assert!(!page.contains("<script>alert") && page.contains("&lt;script&gt;alert"));
    assert!(!page.contains("http://") && !page.contains("https://"));
    // What it shows it holds: nothing is fetched, from the network or from beside it.
    assert!(
        !page.contains(" src=") && page.matches("href=").count() == page.matches("href=\"data:").count() + 1
    );
}

#[test]
fn writing_replaces_an_older_report_and_leaves_nothing_else() {
    let report = report(&Case::new(2));
    let parent = tempfile::tempdir().unwrap();
    let dir = parent.path().join("case/report");
    std::fs::create_dir_all(&dir).unwrap();
    std::fs::write(dir.join("old.txt"), "old").unwrap();
    write(&report, &dir, &Task::quiet()).unwrap();
    let names = |dir: &std::path::Path| {
        let mut names: Vec<String> =
            std::fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    };
    assert_eq!(
        names(&dir),
        [
            "index.html",
            "plane-000.png",
            "plane-001.png",
            "planes.csv",
            "report.json",
            "report.pdf",
            "report.schema.json"
        ]
    );
    assert_eq!(names(&parent.path().join("case")), ["report"]);
    let in_the_way = parent.path().join("file");
    std::fs::write(&in_the_way, "").unwrap();
    let refused = write(&report, &in_the_way.join("report"), &Task::quiet());
    assert!(matches!(&refused, Err(Error::Io { .. })));
    assert!(refused.unwrap_err().to_string().contains("may be written"));
}

#[test]
fn a_skirt_is_planned_material_but_no_part_of_the_lumen() {
    let mut case = Case::new(2);
    for layer in &mut case.paths.layers {
        let mut skirt = layer.beads[2].clone();
        skirt.kind = crate::toolpath::BeadKind::SkirtBrim;
        let centre = Point2::new(100.0, 90.0);
        for p in &mut skirt.points {
            p.at = centre + (p.at - centre) * 2.0;
        }
        layer.beads.push(skirt);
    }
    case.record = print(&case.paths);
    let report = report(&case);
    assert!(near(report.block(Stage::Deposition).overall.unwrap().iou_min, 1.0, 1e-9));
    assert!(overall(&report, Stage::Total).mean_mm.unwrap() < 0.012);
}

#[test]
fn planes_without_a_layer_are_said() {
    let mut case = Case::new(3);
    let slot = LayerSlot { ct_plane: None, ..case.layers[22].slot };
    assert!((slot.height_mm - LAYER_MM).abs() < 1e-12);
    case.layers[22].slot = slot;
    case.paths.layers[22].slot = slot;
    let report = report(&case);
    assert!(report.block(Stage::Slicing).planes[1].reason.as_ref().unwrap().contains("no layer"));
    assert!(report.notes.iter().any(|n| n.code == "report.planes_without_layer"));
}

#[test]
fn each_branch_has_the_figures_of_its_own_contours() {
    let mut case = Forked::new(8);
    // The second branch is segmented 0.3 mm too wide; it is the one with the least x beyond the division.
    for plane in &mut case.sections.planes {
        if let [first, _] = &mut plane.contours[..] {
            let (centre, n) = (first.centroid(), first.len());
            let radius_mm = (first.points[0] - centre).norm();
            *first = Contour::circle(centre, radius_mm + 0.3, n);
        }
    }
    let report = build(&inputs(&case), &Task::quiet()).unwrap();
    let block = report.block(Stage::Segmentation);
    let names: Vec<&str> = block.branches.iter().map(|b| b.branch.as_str()).collect();
    assert_eq!(names, ["branch 1", "branch 2", "branch 3"]);
    let bias = |i: usize| block.branches[i].figures.bias_mm.unwrap();
    assert!(bias(0).abs() < 0.02 && (bias(1) - 0.3).abs() < 0.02 && bias(2).abs() < 0.02, "{block:?}");
    let dice = |i: usize| block.branches[i].figures.dice.unwrap();
    assert!(dice(1) < 0.95 && dice(2) > 0.99, "{} {}", dice(1), dice(2));
    // Every sample belongs to one branch.
    let most = block.branches.iter().filter_map(|b| b.figures.max_mm).fold(0.0, f64::max);
    assert!(near(block.overall.unwrap().figures.max_mm, most, 1e-12));
    let n_planes = |i: usize| block.branches[i].n_planes;
    assert_eq!([n_planes(0) + n_planes(1), n_planes(1)], [8, n_planes(2)]);
    for stage in Stage::ALL {
        for branch in &report.block(stage).branches {
            let off = branch.figures.uncertainty;
            assert!(off.mean_mm > Some(0.0) && off.dice > Some(0.0) && off.max_mm > Some(0.0), "{off:?}");
        }
    }
}

#[test]
fn what_was_only_commanded_is_called_so_everywhere() {
    let mut case = Case::new(5);
    case.record.origin = Origin::Commanded;
    let report = build(&inputs(&case), &Task::quiet()).unwrap();
    let page = html(&report).unwrap();
    // All that is shown before the methods, which speak of both kinds.
    let (shown, _) = page.split_once("<h2 id=\"methods\">").unwrap();
    let (head, limits) = shown.split_once("What this comparison cannot see").unwrap();
    let (_, rest) = limits.split_once("</ul>").unwrap();
    for text in [head, rest] {
        for word in ["deposited", "recorded", "Recorded"] {
            let at =
                text.find(word).map(|i| text[i.saturating_sub(80)..].chars().take(160).collect::<String>());
            assert_eq!(at, None, "{word}");
        }
    }
    assert!(
        shown.contains("verdict unmeasured")
            && shown.contains("Passed as commanded, the print itself was not measured")
    );
    let lines = report.headline().join("\n");
    assert!(lines.contains("commanded against planned") && !lines.contains("\nPassed:"), "{lines}");
    let json: serde_json::Value = serde_json::from_str(&report.to_json().unwrap()).unwrap();
    assert_eq!(json["verdict"]["rests_on"], "commanded, not measured");
    assert_eq!(schema::tests::broken(&report), [""; 0]);
    let recorded = html(&self::report(&Case::new(2))).unwrap();
    assert!(recorded.contains("deposited material as recorded") && !recorded.contains("not measured"));
}

#[test]
fn page_and_figures_say_what_they_are_of() {
    let about = about::tests::example();
    let case = Case::new(2);
    let report = build(&Inputs { about: &about, ..inputs(&case) }, &Task::quiet()).unwrap();
    let page = html(&report).unwrap();
    for text in [
        "<dd>0192-case</dd>",
        "<dd>2026-05-06 07:08 UTC</dd>",
        "<dd>Marlin &lt;b&gt;</dd>",
        "<dd>abababababababab</dd>",
    ] {
        assert!(page.contains(text), "{text}");
    }
    // On every sheet of paper, too.
    assert!(page.contains("content: \"case 0192-case, made 2026-05-06 07:08 UTC, lumenfab "));
    let json: serde_json::Value = serde_json::from_str(&report.to_json().unwrap()).unwrap();
    assert_eq!(json["about"]["job_blake3"], "ab".repeat(32));
    assert_eq!(json["about"]["program"], concat!("lumenfab ", env!("CARGO_PKG_VERSION")));
}

#[test]
fn every_reason_for_a_refusal_stands_in_the_red_list() {
    let mut case = Case::new(6);
    let top_mm = case.paths.layers[45].z_mm;
    for s in case.record.segments.iter_mut().filter(|s| s.from.z > top_mm) {
        s.from.x += 0.4;
        s.to.x += 0.4;
    }
    let report = report(&case);
    assert!(report.findings.iter().any(|f| f.beyond_gate));
    let page = html(&report).unwrap();
    let (list, _) = page.split_once("class=\"failures\"").unwrap().1.split_once("</ul>").unwrap();
    for failure in &report.verdict.failures {
        assert!(list.contains(&failure.replace('\'', "&#x27;")), "{failure}");
    }
}
