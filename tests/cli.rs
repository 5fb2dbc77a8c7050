//! The command line as its users meet it: exit codes, one-line messages, JSON, what is done again and what is kept.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]

use assert_cmd::Command;
use dicom_core::value::{DataSetSequence, PrimitiveValue};
use dicom_core::{DataElement, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{FileMetaTableBuilder, InMemDicomObject};
use lumenfab::phantom::{self, Kind, Params};
use lumenfab::printer::journal::writer::Journal;
use lumenfab::printer::journal::{JobId, Machine, Progress, Record, Track, path_for};
use lumenfab::progress::Task;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// A place for a test's files, with a state directory of its own.
struct Place(TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_lumenfab"));
        command.args(args).current_dir(self.0.path()).env("XDG_STATE_HOME", self.path("state"));
        command
    }

    fn run(&self, args: &[&str]) -> Output {
        self.command(args).output().unwrap()
    }

    /// The document of a command that ends with `code`.
    fn json(&self, code: i32, args: &[&str]) -> Value {
        let output = self.run(&[args, &["--json"]].concat());
        assert_eq!(output.status.code(), Some(code), "{args:?}: {}", text(&output.stderr));
        serde_json::from_slice(&output.stdout)
            .unwrap_or_else(|e| panic!("{args:?}: {e}: {}", text(&output.stdout)))
    }

    /// The one line of error of a command that ends with `code`.
    fn refused(&self, code: i32, args: &[&str]) -> String {
        let output = self.run(args);
        let stderr = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{args:?}: {stderr}");
        assert_eq!(text(&output.stdout), "", "{args:?}");
        let mut errors = stderr.lines().filter_map(|l| l.strip_prefix("error: "));
        let error = errors.next().unwrap_or_else(|| panic!("{args:?}: no error in {stderr}")).to_owned();
        assert_eq!(errors.next(), None, "{args:?}");
        assert!(!stderr.contains("panicked") && !stderr.contains("internal error"), "{args:?}: {stderr}");
        error.replace(self.0.path().to_str().unwrap(), "")
    }

    /// A small synthetic CT; its seed as a flag.
    fn phantom(&self, name: &str, params: &Params) -> String {
        phantom::series::write(&self.path(name), params, &Task::quiet()).unwrap();
        let seed = phantom::default_seed(params);
        format!("--seed-mm={},{},{}", seed.x, seed.y, seed.z)
    }

    fn has_only(&self, names: &[&str]) {
        let mut found: Vec<String> = fs::read_dir(self.0.path())
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .filter(|n| n != "state")
            .collect();
        found.sort();
        assert_eq!(found, names, "left behind");
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// Waits until a process has made something.
#[expect(clippy::disallowed_methods, reason = "the test waits for another process")]
fn wait_for(path: &Path, process: &mut std::process::Child) {
    let start = Instant::now();
    while !path.exists() {
        assert!(process.try_wait().unwrap().is_none(), "the process ended before it made {}", path.display());
        assert!(start.elapsed() < Duration::from_secs(120), "{} is still not there", path.display());
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// A tube small enough that a whole run takes a second or two.
fn small() -> Params {
    Params { kind: Kind::Tube, n_planes: 4, n_pixels: 128, pixel_mm: 0.4, ..Params::default() }
}

/// The stages of an answer that were done, and those that were kept.
fn done_and_kept(case: &Value) -> (Vec<&str>, Vec<&str>) {
    let stages = case["stages"].as_array().unwrap();
    let (done, kept): (Vec<&Value>, Vec<&Value>) = stages.iter().partition(|s| s["done"] == true);
    let names = |stages: Vec<&'_ Value>| -> Vec<String> {
        stages.iter().map(|s| s["stage"].as_str().unwrap().to_owned()).collect()
    };
    let leak = |names: Vec<String>| names.into_iter().map(|n| &*n.leak()).collect();
    (leak(names(done)), leak(names(kept)))
}

const STAGES: [&str; 5] = ["segment", "solid", "slice", "print", "report"];

#[test]
fn a_run_ends_with_a_report_and_a_second_one_does_nothing_again() {
    let place = Place::new();
    let seed = place.phantom("ct", &small());
    let answer = place.json(0, &["run", "--ct", "ct", &seed, "--out", "case"]);
    let case = &answer["cases"][0];
    assert_eq!(done_and_kept(case), (STAGES.to_vec(), vec![]));
    assert!(
        case["report"]["passed"] == true && case["report"]["total"]["p95_mm"].as_f64().unwrap() <= 0.3,
        "{case}"
    );
    for file in ["case.toml", "sections.json", "solid.bin", "job.gcode", "layers.json", "print.json"] {
        assert!(place.path("case").join(file).is_file(), "{file}");
    }
    for file in ["beads.csv", "events.jsonl", "summary.json"] {
        assert!(place.path("case/record").join(file).is_file(), "{file}");
    }
    for file in ["index.html", "report.json", "headline.txt"] {
        assert!(place.path("case/report").join(file).is_file(), "{file}");
    }

    let again = place.json(0, &["run", "case"]);
    assert_eq!(done_and_kept(&again["cases"][0]), (vec![], STAGES.to_vec()));
    assert_eq!(again["cases"][0]["report"], case["report"]);

    let thicker = place.json(0, &["run", "case", "--wall-mm", "1.6"]);
    assert_eq!(done_and_kept(&thicker["cases"][0]), (STAGES[1..].to_vec(), vec!["segment"]));
    assert_eq!(thicker["cases"][0]["stages"][1]["because_of"], serde_json::json!(["parameters"]));

    let finer = place.json(0, &["run", "case", "--layer-mm", "0.25"]);
    assert_eq!(done_and_kept(&finer["cases"][0]), (STAGES[2..].to_vec(), STAGES[..2].to_vec()));

    fs::remove_file(place.path("case/report/index.html")).unwrap();
    let mended = place.json(0, &["run", "case"]);
    assert_eq!(done_and_kept(&mended["cases"][0]), (vec!["report"], STAGES[..4].to_vec()));
}

#[test]
fn a_stricter_gate_fails_the_report_with_3_and_makes_nothing_else_again() {
    let place = Place::new();
    let seed = place.phantom("ct", &small());
    let profile = |gate: &str| {
        fs::write(place.path("lab.toml"), format!("inherits = \"reference\"\nname = \"lab\"\n{gate}"))
            .unwrap();
    };
    profile("");
    let run = ["run", "--ct", "ct", &seed, "--profile", "lab.toml", "--out", "case"];
    assert_eq!(place.json(0, &run)["cases"][0]["report"]["passed"], true);

    profile("[gate]\ntotal_dice = 1.0\n");
    let strict = &place.json(3, &["run", "case"])["cases"][0];
    assert_eq!(done_and_kept(strict), (vec!["report"], STAGES[..4].to_vec()));
    assert_eq!(strict["stages"][4]["because_of"], serde_json::json!(["gate"]));
    let report: Value =
        serde_json::from_slice(&fs::read(place.path("case/report/report.json")).unwrap()).unwrap();
    assert_eq!(report["verdict"]["gate"]["total_dice"], 1.0);
    let failures = report["verdict"]["failures"].as_array().unwrap();
    assert!(failures.len() == 1 && failures[0].as_str().unwrap().contains("by Dice"), "{failures:?}");

    profile("[gate]\ntotal_dice = 2.0\n");
    let error = place.refused(2, &["report", "case"]);
    assert!(error.contains("lab.toml:4") && error.contains("gate.total_dice"), "{error}");
}

#[test]
fn whatever_is_changed_in_a_case_is_found() {
    let place = Place::new();
    let seed = place.phantom("ct", &small());
    assert!(place.run(&["segment", "--ct", "ct", &seed, "--out", "case"]).status.success());
    let unchanged = place.json(0, &["verify", "case"]);
    assert_eq!((&unchanged["passed"], &unchanged["unknown"]), (&Value::Bool(true), &serde_json::json!([])));
    let key = unchanged["key"].as_str().unwrap();

    let sections = fs::read_to_string(place.path("case/sections.json")).unwrap();
    fs::write(place.path("case/sections.json"), sections + " ").unwrap();
    let changed = place.json(1, &["verify", "case", "--key", key]);
    assert_eq!(changed["findings"], serde_json::json!([{ "file": "sections.json", "problem": "changed" }]));
    assert_eq!(
        place.json(1, &["verify", "case", "--key", &"0".repeat(64)])["findings"][0]["problem"],
        "other-key"
    );
    assert!(place.refused(2, &["verify", "ct"]).contains("is no case directory"));
}

#[test]
fn the_case_holds_no_path_and_its_ct_is_found_again_through_the_state_directory() {
    let place = Place::new();
    let seed = place.phantom("DOE_JANE", &small());
    place.json(0, &["segment", "--ct", "DOE_JANE", &seed, "--out", "case"]);
    place.json(0, &["solid", "case"]);
    place.json(0, &["slice", "case"]);
    for file in fs::read_dir(place.path("case")).unwrap() {
        let bytes = fs::read(file.unwrap().path()).unwrap();
        assert!(!String::from_utf8_lossy(&bytes).contains("DOE_JANE"));
    }
    let other_window = place.json(0, &["segment", "case", "--window-hu", "150,700"]);
    assert_eq!(done_and_kept(&other_window), (vec!["segment"], vec![]));

    // On a machine that does not know the CT, what is there is kept, and a new segmentation asks for it.
    fs::remove_dir_all(place.path("state")).unwrap();
    assert_eq!(done_and_kept(&place.json(0, &["segment", "case"])), (vec![], vec!["segment"]));
    let error = place.refused(2, &["segment", "case", "--window-hu", "160,700"]);
    assert_eq!(error, "where the CT of case lies is not known on this machine: name it with --ct");
}

#[test]
fn a_stage_does_not_go_on_from_what_is_missing_or_outdated() {
    let place = Place::new();
    let seed = place.phantom("ct", &small());
    place.json(0, &["segment", "--ct", "ct", &seed, "--out", "case"]);
    let error = place.refused(2, &["slice", "case"]);
    assert_eq!(
        error,
        "the output of solid in case is missing: run `lumenfab solid case` first, or `lumenfab run case`"
    );
    place.json(0, &["solid", "case"]);
    place.json(0, &["segment", "case", "--z-mm", "-1,7"]);
    let error = place.refused(2, &["slice", "case"]);
    assert_eq!(
        error,
        "the output of solid in case is out of date (sections changed): run `lumenfab solid case` first, or \
         `lumenfab run case`"
    );
}

#[test]
fn a_case_keeps_to_the_patient_it_was_made_from() {
    let place = Place::new();
    let seed = place.phantom("a", &small());
    place.phantom("b", &Params { seed: 5, ..small() });
    place.json(0, &["segment", "--ct", "a", &seed, "--out", "case"]);
    let before = fs::read(place.path("case/case.toml")).unwrap();
    let refusal =
        "case is a case already, made from another source: choose another --out, or delete that directory";
    assert_eq!(place.refused(2, &["run", "--ct", "b", &seed, "--out", "case"]), refusal);
    assert_eq!(place.refused(2, &["segment", "case", "--ct", "b"]), refusal);
    assert_eq!(fs::read(place.path("case/case.toml")).unwrap(), before);
    let again = place.json(0, &["segment", "--ct", "a", &seed, "--out", "case"]);
    assert_eq!(done_and_kept(&again), (vec![], vec!["segment"]));

    let sections = place.path("case/sections.json");
    let document = fs::read_to_string(&sections).unwrap();
    fs::write(place.path("s.json"), &document).unwrap();
    fs::write(place.path("t.json"), format!("{document} ")).unwrap();
    place.json(0, &["solid", "--sections", "s.json", "--out", "ready"]);
    let refusal = refusal.replace("case is a", "ready is a");
    assert_eq!(place.refused(2, &["solid", "--sections", "t.json", "--out", "ready"]), refusal);

    // Contours that were lost are asked for, and taken in again.
    fs::remove_file(place.path("ready/sections.json")).unwrap();
    let error = place.refused(2, &["solid", "ready"]);
    assert!(error.ends_with("run `lumenfab solid --sections FILE --out ready` with them"), "{error}");
    place.json(0, &["solid", "--sections", "s.json", "--out", "ready"]);

    // What was corrected by hand is neither lost nor taken for what was made.
    for case in ["case", "ready"] {
        let sections = place.path(case).join("sections.json");
        fs::write(&sections, format!("{document} ")).unwrap();
        for command in ["run", "solid"] {
            let error = place.refused(2, &[command, case]);
            let advice = format!("run `lumenfab solid --sections {case}/sections.json --out NEW`");
            assert!(error.contains("was changed by hand") && error.contains(&advice), "{error}");
        }
        assert_eq!(fs::read_to_string(&sections).unwrap(), format!("{document} "));
    }
    place.json(0, &["solid", "--sections", "case/sections.json", "--out", "corrected"]);
}

#[test]
fn a_printer_that_cannot_be_is_refused_first_and_not_remembered() {
    let place = Place::new();
    let seed = place.phantom("ct", &small());
    fs::write(place.path("job.gcode"), "G28\n").unwrap();
    fs::write(place.path("tube.stl"), "solid tube\nendsolid tube\n").unwrap();
    let error = place.refused(2, &["print", "tube.stl"]);
    assert!(
        error.contains("found the model tube.stl") && error.contains("lumenfab slice tube.stl"),
        "{error}"
    );
    let error = place.refused(2, &["slice", "tube.stl", "--out", "job.gcode", "--perimeters", "-1"]);
    assert!(error.contains("-1 is not in 1..=100"), "{error}");
    let error = place.refused(2, &["print", "job.gcode", "--baud", "115200"]);
    assert!(error.starts_with("--baud: found 115200 with the simulated printer"), "{error}");

    place.json(0, &["run", "--ct", "ct", &seed, "--out", "case"]);
    for command in ["run", "print"] {
        place.refused(1, &[command, "case", "--port", "nowhere"]);
    }
    place.refused(2, &["slice", "case", "--profile", "ender9"]);
    assert_eq!(done_and_kept(&place.json(0, &["report", "case"])), (vec![], vec!["report"]));
    let again = place.json(0, &["run", "case"]);
    assert_eq!(done_and_kept(&again["cases"][0]), (vec![], STAGES.to_vec()));
}

#[test]
fn a_job_of_a_profile_of_ones_own_is_tried_on_its_machine() {
    let place = Place::new();
    let seed = place.phantom("ct", &small());
    // In the middle of this bed the part lies where Klipper's own machine refuses to go.
    let own = "inherits = \"klipper\"\nname = \"wide\"\n[machine]\nbed_mm = [480, 480, 300]\n";
    fs::write(place.path("own.toml"), own).unwrap();
    place.json(0, &["run", "--ct", "ct", &seed, "--profile", "own.toml", "--out", "case"]);
    fs::copy(place.path("case/job.gcode"), place.path("job.gcode")).unwrap();
    place.json(0, &["print", "job.gcode", "--profile", "own.toml", "--port", "sim"]);
    // On a bed that it leaves it is refused before anything is sent, to the simulated machine, too.
    let error = place.refused(1, &["print", "job.gcode", "--profile", "reference", "--port", "sim"]);
    assert!(error.contains("mm beyond the build space of 0 to 200 mm of the profile reference"), "{error}");
    // What machines reach beside their beds is told, and what is wanted so goes there.
    let said = |x_mm: u32, more: &[&str]| {
        fs::write(place.path("bead.gcode"), format!("G28\nM83\nG1 X{x_mm} Y10 Z1 F600\nG1 Y20 E1\n"))
            .unwrap();
        let out =
            place.run(&[&["print", "bead.gcode", "--profile", "reference", "--port", "sim"], more].concat());
        (out.status.success(), String::from_utf8(out.stderr).unwrap())
    };
    let (done, words) = said(203, &[]);
    assert!(done && words.contains("line 3 goes to X 203.000, 3.0 mm beyond"), "{words}");
    assert!(!said(209, &[]).0);
    let (done, words) = said(209, &["--beyond-bed"]);
    assert!(done && words.contains("9.0 mm beyond"), "{words}");
}

#[test]
fn missing_planes_are_passed_over_only_where_that_is_asked_for() {
    let place = Place::new();
    let seed = place.phantom("ct", &Params { n_planes: 6, ..small() });
    fs::remove_file(place.path("ct/IM0004.dcm")).unwrap();
    place.refused(1, &["segment", "--ct", "ct", &seed, "--out", "case"]);
    let answer = place.json(0, &["segment", "--ct", "ct", &seed, "--allow-gaps", "--out", "case"]);
    let warnings = answer["stages"][0]["warnings"].as_array().unwrap();
    assert!(warnings.iter().any(|w| w["code"] == "ct.missing_planes"), "{answer}");
    // What is kept tells what it told.
    let kept = place.json(0, &["segment", "case"]);
    assert_eq!(done_and_kept(&kept), (vec![], vec!["segment"]));
    for key in ["summary", "warnings"] {
        assert_eq!(kept["stages"][0][key], answer["stages"][0][key], "{kept}");
    }
}

#[test]
fn unusable_ct_folders_are_refused_with_one_line_and_leave_nothing_behind() {
    let place = Place::new();
    let params = Params { n_planes: 6, ..small() };
    let seed = place.phantom("good", &params);
    let copy = |name: &str| {
        fs::create_dir(place.path(name)).unwrap();
        for entry in fs::read_dir(place.path("good")).unwrap() {
            let entry = entry.unwrap();
            fs::copy(entry.path(), place.path(name).join(entry.file_name())).unwrap();
        }
    };
    fs::create_dir(place.path("empty")).unwrap();
    fs::create_dir(place.path("text")).unwrap();
    fs::write(place.path("text/notes.txt"), "not DICOM").unwrap();
    copy("truncated");
    let slice = fs::read(place.path("truncated/IM0003.dcm")).unwrap();
    fs::write(place.path("truncated/IM0003.dcm"), &slice[..slice.len() / 2]).unwrap();
    copy("missing");
    fs::remove_file(place.path("missing/IM0004.dcm")).unwrap();
    copy("mixed");
    place.phantom("other", &Params { kind: Kind::Carotid, n_pixels: 96, ..params });
    for entry in fs::read_dir(place.path("other")).unwrap() {
        let entry = entry.unwrap();
        let name = format!("B{}", entry.file_name().to_string_lossy());
        fs::copy(entry.path(), place.path("mixed").join(name)).unwrap();
    }
    fs::write(place.path("file"), "x").unwrap();

    for (code, folder, parts) in [
        (1, "empty", ["empty holds no file", "name the folder"]),
        (1, "text", ["text holds no DICOM file", "name the folder"]),
        (1, "file", ["file is no folder", "name the folder"]),
        (1, "truncated", ["truncated/IM0003.dcm", "export it again"]),
        (1, "missing", ["1 plane(s) missing between z = ", "export the series again"]),
        (2, "mixed", ["2 series in the folder", "choose one"]),
    ] {
        let error = place.refused(code, &["run", "--ct", folder, &seed, "--out", "case"]);
        assert!(parts.iter().all(|p| error.contains(p)), "{folder}: {error}");
    }
    let error = place.refused(2, &["run", "--ct", "nothing", &seed, "--out", "case"]);
    assert_eq!(error, "--ct: found nothing at nothing, expected a folder with the DICOM files of a series");
    place.has_only(&["empty", "file", "good", "missing", "mixed", "other", "text", "truncated"]);

    // Chosen by its number, one of several series is used.
    let answer = place.json(0, &["inspect", "mixed"]);
    assert_eq!(answer["series"].as_array().unwrap().len(), 2);
    let columns_of = |n: usize| answer["series"][n]["columns_rows"][0].as_u64().unwrap();
    let number = if columns_of(0) == 128 { "1" } else { "2" };
    place.json(0, &["segment", "--ct", "mixed", "--series", number, &seed, "--out", "case"]);
}

#[test]
fn a_lumen_that_cannot_be_found_is_refused_with_one_line_and_leaves_nothing_behind() {
    let place = Place::new();
    let seed = place.phantom("ct", &small());
    // What was asked for lies elsewhere: wrong usage. What the grey values are decides the rest.
    for (code, flags, part) in [
        (2, vec!["--seed-mm=900,0,3"], "lies outside the volume"),
        (2, vec![seed.as_str(), "--z-mm=700,800"], "700"),
        (1, vec!["--seed-mm=-20,-20,3", "--window-hu", "200,600"], "HU, outside the window 200 to 600 HU"),
        (1, vec![seed.as_str(), "--window-hu", "5000,6000"], "window 5000 to 6000 HU selects nothing"),
    ] {
        let error = place.refused(code, &[&["run", "--ct", "ct", "--out", "case"], &*flags].concat());
        assert!(error.contains(part), "{flags:?}: {error}");
    }
    place.has_only(&["ct"]);
}

#[test]
fn a_case_file_starts_the_segmentation_that_it_corrects() {
    let place = Place::new();
    let seed = place.phantom("ct", &small());
    let seed = seed.trim_start_matches("--seed-mm=");
    let file = |window: &str| {
        let text = format!("ct = \"ct\"\nseed_mm = [[{seed}]]\n{window}");
        fs::write(place.path("corrected.toml"), text).unwrap();
    };
    file("window_hu = [-2000, 6000]\n");
    let leak = place.refused(1, &["segment", "corrected.toml"]);
    assert!(leak.contains("leaks to the image border in plane "), "{leak}");
    assert!(leak.trim_end().ends_with("leak.png shows it"), "{leak}");
    place.has_only(&["corrected", "corrected.toml", "ct"]);
    file("");
    for done in [true, false] {
        let case = place.json(0, &["segment", "corrected.toml"]);
        assert_eq!(case["stages"][0]["done"], done, "{case}");
    }
    assert!(place.path("corrected/sections.json").is_file());
    assert!(!place.path("corrected/leak.png").exists(), "the region leaks no more");
    let both = place.refused(2, &["segment", "corrected", "--out", "other"]);
    assert!(both.starts_with("--out: found it together with the case "), "{both}");
}

#[test]
fn a_leak_leaves_a_case_to_correct_and_a_picture_of_the_place() {
    let place = Place::new();
    let seed = place.phantom("ct", &small());
    let leak = place.refused(1, &["segment", "--ct", "ct", &seed, "--window-hu=-2000,6000", "--out", "case"]);
    assert!(
        leak.contains("leaks to the image border in plane ") && leak.contains("leak.png shows it"),
        "{leak}"
    );
    let picture = fs::read(place.path("case/leak.png")).unwrap();
    assert!(picture.starts_with(b"\x89PNG"));
    let none = place.refused(2, &["solid", "case"]);
    assert!(none.contains("lumenfab segment"), "{none}");
    let refused = place.json(1, &["segment", "case"]);
    assert_eq!(refused["code"], "segment.leak", "{refused}");
    // The case is this patient's already.
    place.phantom("other", &Params { seed: 9, noise_hu: 30.0, ..small() });
    let other = place.refused(2, &["segment", "case", "--ct", "other", "--out", "case"]);
    assert!(!other.contains("leak"), "{other}");
    let other = place.refused(2, &["segment", "--ct", "other", &seed, "--out", "case"]);
    assert!(other.contains("another"), "{other}");
    let case = fs::read_to_string(place.path("case/case.toml")).unwrap();
    let corrected: String =
        case.lines().filter(|l| !l.starts_with("window_hu")).map(|l| format!("{l}\n")).collect();
    assert_ne!(case, corrected);
    fs::write(place.path("case/case.toml"), corrected).unwrap();
    let done = place.json(0, &["segment", "case"]);
    assert_eq!(done["stages"][0]["done"], true, "{done}");
    assert!(place.path("case/sections.json").is_file() && !place.path("case/leak.png").exists());
}

#[test]
fn ports_that_do_not_exist_or_vanish_are_said_so() {
    let place = Place::new();
    let error = place.refused(1, &["run", "--port", "nowhere", "--out", "case"]);
    assert_eq!(
        error,
        "port nowhere does not exist; check that the printer is on and connected, and the name of its port"
    );
    place.has_only(&[]);

    let mut job = String::from("G28\nM109 S200\n");
    (0..20_000).for_each(|i| job += &format!("G1 X{} Y{} F3000\n", 10 + i % 100, 10 + i % 7));
    fs::write(place.path("job.gcode"), job).unwrap();
    let mut simulator = std::process::Command::new(env!("CARGO_BIN_EXE_lumenfab"))
        .args([
            "hil-sim",
            "--profile",
            "marlin",
            "--speed",
            "max",
            "--once",
            "--fault",
            "disconnect:line=5000",
        ])
        .args(["--link", &place.text("port")])
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    wait_for(&place.path("port"), &mut simulator);
    // Nobody waits half an hour for the port to come back.
    let impatient = "inherits = \"marlin\"\nname = \"impatient\"\n\n[firmware]\norphan_hold_s = 2\n";
    fs::write(place.path("impatient.toml"), impatient).unwrap();
    let error = place.refused(1, &["print", "job.gcode", "--port", "port", "--profile", "impatient.toml"]);
    simulator.kill().ok();
    simulator.wait().unwrap();
    assert!(
        error.starts_with("port port vanished during the print; whether the heaters are on is unknown"),
        "{error}"
    );
    let journal = fs::read_to_string(place.path("job.gcode.journal")).unwrap();
    assert!(!journal.contains("job.gcode") && journal.len() < 20_000, "{journal}");
    // Its part is on the bed; and what is no port is no matter yet.
    let again = ["print", "job.gcode", "--port", "job.gcode", "--profile", "impatient.toml"];
    let error = place.refused(1, &again);
    assert!(error.contains("broke off behind line") && error.contains("--anew"), "{error}");
    let error = place.refused(1, &[&again[..], &["--anew"]].concat());
    assert!(error.contains("is not a serial port"), "{error}");
    // Nor does another job take its place, or the simulated printer print it by accident.
    fs::write(place.path("model.stl"), "solid nothing\nendsolid nothing\n").unwrap();
    let job = fs::read(place.path("job.gcode")).unwrap();
    for args in [&["slice", "model.stl", "--out", "job.gcode"][..], &["print", "job.gcode"]] {
        let error = place.refused(1, args);
        assert!(error.contains("broke off behind line") && error.contains("--anew"), "{error}");
    }
    assert!(fs::read(place.path("job.gcode")).unwrap() == job);
}

/// A journal as a print leaves it whose host was killed in the middle.
fn break_off(job: &Path) {
    let hash = blake3::hash(&fs::read(job).unwrap()).to_hex().to_string();
    let id = JobId { hash, n_lines: 6 };
    let machine = Machine {
        profile: "marlin".into(),
        profile_hash: String::new(),
        port: "/dev/nowhere".into(),
        device: None,
    };
    let journal = Journal::create(&path_for(job), &[Record::Job(id), Record::Machine(machine)]).unwrap();
    let progress = Progress { n_sent: 5, n_acked: 4, ..Progress::default() };
    for record in [Record::Session(Track::default()), Record::Progress(progress)] {
        assert!(journal.append(&record));
        journal.flush();
    }
}

#[test]
fn the_job_of_a_print_that_broke_off_stays_until_it_is_given_up() {
    let place = Place::new();
    let seed = place.phantom("ct", &small());
    assert!(place.run(&["run", "--ct", "ct", &seed, "--out", "case"]).status.success());
    let job = place.path("case/job.gcode");
    break_off(&job);
    let before = fs::read(&job).unwrap();
    assert!(place.run(&["slice", "case"]).status.success(), "nothing is made anew");
    for args in [
        &["run", "case", "--wall-mm", "1.4"][..],
        &["slice", "case", "--layer-mm", "0.25"],
        &["solid", "case", "--wall-mm", "1.4"],
        // Where it was printed the case could not keep; the simulated printer is no place to begin it again.
        &["print", "case"],
    ] {
        let error = place.refused(1, args);
        assert!(error.contains("broke off behind line") && error.contains("--anew"), "{error}");
    }
    assert!(fs::read(&job).unwrap() == before);
    let kept = place.json(0, &["slice", "case"]);
    assert_eq!(done_and_kept(&kept), (vec![], vec!["slice"]), "the refused parameters were not kept");
    assert!(place.run(&["slice", "case", "--layer-mm", "0.25", "--anew"]).status.success());
    assert!(fs::read(&job).unwrap() != before);
    assert!(place.run(&["slice", "case", "--layer-mm", "0.2"]).status.success(), "it was given up for good");
}

#[test]
fn wrong_usage_is_one_line_with_found_and_expected() {
    let place = Place::new();
    fs::create_dir(place.path("thesis")).unwrap();
    fs::write(place.path("thesis/chapter1.tex"), "").unwrap();
    fs::create_dir(place.path("none")).unwrap();
    for dir in ["a", "b"] {
        fs::create_dir(place.path(dir)).unwrap();
        fs::write(place.path(dir).join("x.toml"), "[phantom]\n").unwrap();
    }
    fs::write(place.path("bad.toml"), "seed_mm = [[1, 2, 3]]\nwall = 1\n").unwrap();
    for (args, line) in [
        (
            vec!["run", "--seed-mm", "1,nan,3"],
            "--seed-mm: found \"1,nan,3\", expected X,Y,Z: three numbers in mm (LPS) separated by commas; or auto",
        ),
        (vec!["run", "--wall-mm", "0"], "--wall-mm: found 0, expected a number from 0.1 to 20 mm"),
        (vec!["run", "--layer-mm", "nan"], "--layer-mm: found NaN, expected a number from 0.02 to 1 mm"),
        (
            vec!["run", "--window-hu", "650,250"],
            "--window-hu: found 650,250, expected LO,HI: two numbers in HU separated by a comma, LO less than HI",
        ),
        (
            vec!["segment", "--ct", "."],
            "--out: found neither it nor a case, expected --out CASE to start a case, or a case directory",
        ),
        (
            vec!["segment", "--ct", ".", "--out", "case"],
            "--seed-mm: found none, expected X,Y,Z: three numbers in mm (LPS) separated by commas; or auto",
        ),
        (
            vec!["run", "--seed-mm", "1,2,3", "--out", "case"],
            "--ct: found none beside seed_mm, expected the CT that it is said of",
        ),
        (
            vec!["run", "a/x.toml", "b/x.toml", "--out", "cases"],
            "--out: found cases/x for two cases, expected a directory of its own for each",
        ),
        (vec!["run", "--profile", "ender9"], "there is no profile \"ender9\""),
        (vec!["run", "bad.toml"], "bad.toml: line 2: unknown field `wall`"),
        (
            vec!["run", "absent.toml"],
            "absent.toml: not found: expected a case directory or a case file (TOML)",
        ),
        (vec!["run", "none"], "none: is a folder without a case file (*.toml): name a case file"),
        (vec!["run", "thesis"], "thesis: is a folder without a case file (*.toml): name a case file"),
        (
            vec!["run", "--out", "thesis"],
            "thesis exists, is not empty and is no case: name a new or empty directory",
        ),
        (
            vec!["slice", "thesis"],
            "thesis is no case directory (it has no case.toml): name another one; to start a case from a CT",
        ),
        (vec!["report", "nowhere"], "no case at nowhere: start one with `lumenfab run`"),
        (vec!["slyce"], "unrecognized subcommand 'slyce'"),
        (
            vec!["export", "nowhere"],
            "the following required arguments were not provided: <--stl <F>|--3mf <F>|--step <F>|--sweep <F.csv>>",
        ),
    ] {
        let error = place.refused(2, &args);
        assert!(error.starts_with(line), "{args:?}: {error}");
    }
    place.has_only(&["a", "b", "bad.toml", "none", "thesis"]);
}

#[test]
fn every_command_answers_with_one_json_document() {
    let place = Place::new();
    let answer = place.json(0, &["phantom", "--out", "ct", "--kind", "tube", "--noise-hu", "0"]);
    assert_eq!(answer["n_planes"], 46);
    assert_eq!(place.json(0, &["inspect", "ct"])["series"][0]["verdict"], "usable");
    assert_eq!(place.json(0, &["profiles", "list"])["profiles"][0]["name"], "marlin");
    assert_eq!(place.json(0, &["profiles", "show", "reference"])["machine"]["bed_mm"][2], 250.0);
    assert_eq!(place.json(0, &["profiles", "check", "marlin"])["valid"], true);
    let refused = place.json(2, &["run", "--wall-mm", "0"]);
    assert_eq!(refused["error"], "--wall-mm: found 0, expected a number from 0.1 to 20 mm");
    assert_eq!(place.json(2, &["slice", "nowhere"])["exit_code"], 2);
}

#[test]
fn case_files_are_run_one_after_the_other_and_each_is_answered_for() {
    let place = Place::new();
    let tube = "[phantom]\nkind = \"tube\"\nn_planes = 3\nn_pixels = 128\npixel_mm = 0.4\n";
    fs::write(place.path("a.toml"), tube).unwrap();
    fs::write(place.path("b.toml"), "ct = \"nothing\"\nseed_mm = [[0, 0, 0]]\n").unwrap();
    let answer = place.json(2, &["run", "a.toml", "b.toml", "--out", "cases"]);
    assert_eq!(answer["cases"][0]["report"]["passed"], true, "{answer}");
    assert!(answer["cases"][1]["error"].as_str().unwrap().starts_with("--ct: found nothing"), "{answer}");
    assert!(place.path("cases/a/report/index.html").is_file() && !place.path("cases/b").exists());
}

#[test]
fn a_folder_of_case_files_is_run_whole_and_ends_with_a_table() {
    let place = Place::new();
    fs::create_dir(place.path("cases")).unwrap();
    let tube = "[phantom]\nkind = \"tube\"\nn_planes = 3\nn_pixels = 128\npixel_mm = 0.4\n";
    fs::write(place.path("cases/a.toml"), "ct = \"nothing\"\nseed_mm = \"auto\"\n").unwrap();
    fs::write(place.path("cases/b.toml"), tube).unwrap();
    fs::write(place.path("cases/c.toml"), "wall_mm = 1.5\n").unwrap();
    let answer = place.json(2, &["run", "cases"]);
    assert!(answer["cases"][0]["error"].as_str().unwrap().starts_with("--ct: found nothing"), "{answer}");
    assert_eq!(answer["cases"][0]["case"], "cases/a.toml");
    assert_eq!(answer["cases"][1]["report"]["passed"], true, "{answer}");
    assert!(place.path("cases/b/report/index.html").is_file() && !place.path("cases/a").exists());
    let of_c = "the case file: names no image: expected ct = PATH, segmentation = PATH or a [phantom] table";
    assert_eq!(answer["cases"][2]["error"], of_c);
}

#[test]
fn a_vessel_is_found_without_a_seed_and_again_the_same() {
    let place = Place::new();
    place.json(0, &["phantom", "--out", "ct", "--kind", "tube"]);
    let first = place.json(0, &["segment", "--ct", "ct", "--seed-mm", "auto", "--out", "one"]);
    assert_eq!(first["candidates"][0]["polarity"], "bright", "{first}");
    place.json(0, &["segment", "--ct", "ct", "--seed-mm", "auto", "--out", "two"]);
    for file in ["sections.json", "segmentation.json"] {
        assert_eq!(
            fs::read(place.path("one").join(file)).unwrap(),
            fs::read(place.path("two").join(file)).unwrap()
        );
    }
    let parameters = fs::read_to_string(place.path("one/case.toml")).unwrap();
    assert!(parameters.contains("seed_mm = \"auto\""), "{parameters}");
    // A correction does the stage again; the same one does not.
    let blocked = format!("{parameters}\n[[segment.block]]\nz_mm = [100.0, 200.0]\n");
    fs::write(place.path("one/case.toml"), blocked).unwrap();
    let again = place.json(0, &["segment", "one"]);
    assert_eq!(again["stages"][0]["done"], true, "{again}");
    let kept = place.json(0, &["segment", "one"]);
    assert_eq!((&kept["stages"][0]["done"], &kept["candidates"]), (&false.into(), &again["candidates"]));
}

#[test]
fn ready_contours_become_closed_meshes_of_their_volume() {
    let place = Place::new();
    let circle: Vec<[f64; 2]> = (0..256)
        .map(|i| f64::from(i) / 256.0 * std::f64::consts::TAU)
        .map(|a| [5.0 * a.cos(), 5.0 * a.sin()])
        .collect();
    let planes: Vec<Value> =
        (0..5).map(|k| serde_json::json!({"z_mm": 2.0 * f64::from(k), "contours": [circle]})).collect();
    let document = serde_json::json!({"units": "mm", "frame": "LPS", "planes": planes});
    fs::write(place.path("s.json"), document.to_string()).unwrap();
    place.json(0, &["solid", "--sections", "s.json", "--out", "case"]);
    let lumen = place.json(0, &["export", "case", "--stl", "l.stl", "--skin", "lumen"]);
    let wall = place.json(0, &["export", "case", "--stl", "w.stl"]);
    let volume = |r: f64| std::f64::consts::PI * r * r * 10.0;
    let close = |answer: &Value, expected: f64| {
        let found = answer["volume_mm3"].as_f64().unwrap();
        assert!((found / expected - 1.0).abs() < 5e-3, "{found} against {expected}");
    };
    close(&lumen, volume(5.0));
    close(&wall, volume(6.0) - volume(5.0));
    let both =
        place.json(0, &["export", "case", "--stl", "b.stl", "--3mf", "b.3mf", "--colour", "curvature"]);
    assert_eq!((&both["3mf"], &both["deflection_mm"]), (&"b.3mf".into(), &0.01.into()));
    assert_eq!(fs::read(place.path("b.stl")).unwrap(), fs::read(place.path("w.stl")).unwrap());
    let relative = place.json(0, &["export", "case", "--3mf", "r.3mf", "--deflection-relative", "0.02"]);
    assert!(relative["n_triangles"].as_u64() < both["n_triangles"].as_u64(), "{relative}");
    let coloured = ["--3mf", "c.3mf", "--deflection-relative", "0.02", "--colour", "curvature"];
    assert_eq!(
        place.json(0, &[&["export", "case"], &coloured[..]].concat())["n_triangles"],
        relative["n_triangles"]
    );
    let exact = place.json(0, &["export", "case", "--step", "x.step", "--skin", "lumen"]);
    close(&serde_json::json!({"volume_mm3": exact["brep_volume_mm3"]}), volume(5.0));
    fs::create_dir(place.path("dir")).unwrap();
    fs::create_dir(place.path("case/kept")).unwrap();
    for (code, args, line) in [
        (1, vec!["--stl", "n.stl", "--3mf", "none/n.3mf"], "cannot create a file in none: no such file"),
        (1, vec!["--stl", "dir"], "cannot write dir: is a directory"),
        (
            2,
            vec!["--stl", "n.stl", "--3mf", "n.stl"],
            "--3mf: found n.stl, expected another file than for --stl",
        ),
        (2, vec!["--stl", "n.stl", "--deflection-relative", "7"], "--deflection-relative: found 7, expected"),
        // Neither the input nor what the case keeps is replaced.
        (2, vec!["--stl", "s.json"], "--stl: found s.json, expected a new file, or one that ends in .stl"),
        (2, vec!["--step", "case/solid.bin"], "--step: found case/solid.bin, expected a new file, or one"),
        (
            2,
            vec!["--sweep", "case/kept/beads.csv"],
            "--sweep: found case/kept/beads.csv, expected a file outside",
        ),
    ] {
        let error = place.refused(code, &[&["export", "case"], &args[..]].concat());
        assert!(error.starts_with(line), "{args:?}: {error}");
        assert!(!place.path("n.stl").exists(), "{args:?}");
    }
    let kept = place.refused(2, &["solid", "case", "--view", "s.json"]);
    assert!(kept.starts_with("--view: found s.json, expected a new file"), "{kept}");
    let viewed = place.json(0, &["solid", "case", "--view", "v.png", "--cut", "--size-px", "300"]);
    assert_eq!(viewed["view"], "v.png");
    assert!(fs::read(place.path("v.png")).unwrap().starts_with(b"\x89PNG"));
    fs::write(place.path("case/solid.bin"), "lumenfab solid 1\nrubbish").unwrap();
    let damaged = place.refused(2, &["export", "case", "--stl", "n.stl"]);
    assert!(damaged.contains("solid.bin was changed by hand since it was made"), "{damaged}");
    fs::write(place.path("broken.json"), &document.to_string()[..100]).unwrap();
    let error = place.refused(1, &["solid", "--sections", "broken.json", "--out", "other"]);
    assert!(error.starts_with("broken.json: not a sections document: EOF while parsing"), "{error}");
    assert!(!place.path("other").exists());
}

#[test]
fn a_reader_that_goes_away_is_no_fault() {
    let place = Place::new();
    for args in ["--help", "profiles show marlin"] {
        let script = format!("{} {args} | true; exit ${{PIPESTATUS[0]}}", env!("CARGO_BIN_EXE_lumenfab"));
        let output = Command::new("bash").args(["-c", &script]).output().unwrap();
        assert_eq!((output.status.code(), text(&output.stderr)), (Some(0), String::new()), "{args}");
    }
    drop(place);
}

#[test]
fn an_interrupted_run_ends_with_130_and_leaves_no_half_case() {
    let place = Place::new();
    let mut run = std::process::Command::new(env!("CARGO_BIN_EXE_lumenfab"))
        .args(["run", "--out", &place.text("case")])
        .env("XDG_STATE_HOME", place.path("state"))
        .stderr(std::process::Stdio::piped())
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    // As soon as the first stage is through, the case is there.
    wait_for(&place.path("case"), &mut run);
    let interrupted =
        std::process::Command::new("kill").args(["-INT", &run.id().to_string()]).status().unwrap();
    assert!(interrupted.success());
    let output = run.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{}", text(&output.stderr));
    let hidden = |dir: &Path| {
        let names = fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
        names.filter(|n| n.starts_with('.')).collect::<Vec<_>>()
    };
    assert_eq!(hidden(&place.path("case")), Vec::<String>::new());
    assert_eq!(hidden(place.0.path()), Vec::<String>::new());
}

#[test]
fn a_chosen_series_is_taken_again_whatever_its_number_has_become_and_missed_when_it_is_gone() {
    let place = Place::new();
    let seed = place.phantom("ct", &small());
    let add = |prefix: &str, noise_hu: f64| {
        place.phantom(prefix, &Params { noise_hu, n_pixels: 96, ..small() });
        for n in 1..=4 {
            let to = place.path("ct").join(format!("{prefix}{n}.dcm"));
            fs::copy(place.path(prefix).join(format!("IM000{n}.dcm")), to).unwrap();
        }
    };
    add("J", 3.0);
    place.json(0, &["segment", "--ct", "ct", "--series", "1", &seed, "--out", "case"]);
    let sections = fs::read(place.path("case/sections.json")).unwrap();
    let note: Value =
        serde_json::from_slice(&fs::read(place.path("case/segmentation.json")).unwrap()).unwrap();
    assert_eq!((&note["series"]["number"], note["series"]["check"].as_str().unwrap().len()), (&1.into(), 32));
    // Another series comes before it: the number now names that one, the case still means its own.
    add("A", 5.0);
    let again = place.json(0, &["segment", "case"]);
    assert_eq!(again["stages"][0]["because_of"], serde_json::json!(["ct"]));
    assert_eq!(fs::read(place.path("case/sections.json")).unwrap(), sections);
    (1..=4).for_each(|n| fs::remove_file(place.path(&format!("ct/IM000{n}.dcm"))).unwrap());
    let error = place.refused(1, &["segment", "case"]);
    assert!(
        error.starts_with("the folder no longer holds the series that the case was made from"),
        "{error}"
    );
    assert!(error.ends_with("start a new case with another --out"), "{error}");
}

#[test]
fn what_is_one_patients_is_refused_for_several_cases() {
    let place = Place::new();
    for name in ["a.toml", "b.toml"] {
        fs::write(place.path(name), "ct = \"ct\"\nseed_mm = \"auto\"\n").unwrap();
    }
    for flags in [
        ["--ct", "ct"],
        ["--segmentation", "labels.nrrd"],
        ["--label", "2"],
        ["--series", "1"],
        ["--seed-mm", "1,2,3"],
    ] {
        let error = place.refused(2, &[&["run", "a.toml", "b.toml"], &flags[..]].concat());
        assert_eq!(error, format!("{}: found several cases, expected one", flags[0]));
    }
    // What is no one's is for all of them: the next thing that is missed is the CT.
    let answer = place.json(2, &["run", "a.toml", "b.toml", "--seed-mm", "auto", "--wall-mm", "2"]);
    let errors: Vec<&str> =
        answer["cases"].as_array().unwrap().iter().map(|c| c["error"].as_str().unwrap()).collect();
    assert!(errors.iter().all(|e| e.starts_with("--ct: found nothing there")), "{errors:?}");
}

/// A DICOMDIR that names those files.
fn directory(names: &[&str]) -> InMemDicomObject {
    let text = |tag, vr, value: PrimitiveValue| DataElement::new(tag, vr, value);
    let record = |name: &&str| {
        let components: Vec<String> = name.split('/').map(String::from).collect();
        InMemDicomObject::from_element_iter([
            text(tags::DIRECTORY_RECORD_TYPE, VR::CS, "IMAGE".into()),
            text(tags::REFERENCED_FILE_ID, VR::CS, PrimitiveValue::Strs(components.into())),
        ])
    };
    let records = DataSetSequence::from(names.iter().map(record).collect::<Vec<_>>());
    InMemDicomObject::from_element_iter([
        text(tags::SOP_CLASS_UID, VR::UI, uids::MEDIA_STORAGE_DIRECTORY_STORAGE.into()),
        text(tags::SOP_INSTANCE_UID, VR::UI, "2.25.1".into()),
        DataElement::new(tags::DIRECTORY_RECORD_SEQUENCE, VR::SQ, records),
    ])
}

#[test]
fn a_dicomdir_is_a_ct_whose_images_are_watched() {
    let place = Place::new();
    let seed = place.phantom("medium", &small());
    let names = ["IM0001.DCM", "IM0002.DCM", "IM0003.DCM", "IM0004.DCM"];
    let meta = FileMetaTableBuilder::new().transfer_syntax(uids::EXPLICIT_VR_LITTLE_ENDIAN);
    let directory = directory(&names).with_meta(meta).unwrap();
    directory.write_to_file(place.path("medium/DICOMDIR")).unwrap();
    let args = ["segment", "--ct", "medium/DICOMDIR", &seed, "--out", "case"];
    assert_eq!(place.json(0, &args)["stages"][0]["done"], true);
    assert_eq!(place.json(0, &["segment", "case"])["stages"][0]["done"], false);
    // One pixel of an image that the DICOMDIR names: another CT.
    let mut image = fs::read(place.path("medium/IM0003.dcm")).unwrap();
    let last_word = image.len() - 2;
    image[last_word] ^= 1;
    fs::write(place.path("medium/IM0003.dcm"), image).unwrap();
    assert_eq!(
        place.refused(2, &args),
        "case is a case already, made from another source: choose another --out, or delete that directory"
    );
    assert_eq!(place.json(0, &["segment", "case"])["stages"][0]["because_of"], serde_json::json!(["ct"]));
}

#[test]
fn the_record_of_a_ct_is_of_no_use_outside_its_case() {
    let place = Place::new();
    let seed = place.phantom("ct", &small());
    let record = |case: &str| {
        place.json(0, &["segment", "--ct", "ct", &seed, "--out", case]);
        let text = fs::read_to_string(place.path(case).join("stages.toml")).unwrap();
        text.lines().find(|l| l.starts_with("ct = ")).unwrap().to_owned()
    };
    assert_ne!(record("one"), record("another"));
}

#[test]
fn gaps_that_were_allowed_can_be_refused_again() {
    let place = Place::new();
    let seed = place.phantom("ct", &Params { n_planes: 6, ..small() });
    fs::remove_file(place.path("ct/IM0004.dcm")).unwrap();
    place.json(0, &["segment", "--ct", "ct", &seed, "--allow-gaps", "--out", "case"]);
    assert!(fs::read_to_string(place.path("case/case.toml")).unwrap().contains("allow_gaps = true"));
    let error = place.refused(1, &["segment", "case", "--allow-gaps=false"]);
    assert!(error.starts_with("1 plane(s) missing between"), "{error}");
}

#[test]
fn an_installation_is_examined_and_its_faults_are_told_with_the_fix() {
    let place = Place::new();
    let missing = place.json(1, &["doctor", "--state", "none"]);
    assert_eq!(missing["is_well"], false);
    assert_eq!(missing["findings"][0]["is"], "wrong", "{missing}");
    assert!(missing["findings"][0]["fix"].as_str().unwrap().contains("lumenfab serve"), "{missing}");
    fs::create_dir(place.path("lab")).unwrap();
    let well = place.json(0, &["doctor", "--state", "lab"]);
    assert_eq!(well["is_well"], true);
    fs::write(place.path("lab/config.toml"), "on_stop = \"drop\"\n").unwrap();
    let output = place.run(&["doctor", "--state", "lab"]);
    assert_eq!(output.status.code(), Some(1));
    let shown = text(&output.stdout);
    assert!(shown.contains("config.toml:1: on_stop: found \"drop\""), "{shown}");
}
