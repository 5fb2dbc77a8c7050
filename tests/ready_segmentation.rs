//! A segmentation made elsewhere as its users meet it: with and without the CT, chosen by its label, done again and kept.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]

use assert_cmd::Command;
use lumenfab::phantom::{self, Kind, Params};
use lumenfab::progress::Task;
use lumenfab::sections::format::from_json;
use serde_json::Value;
use std::fmt::Write;
use std::fs;
use std::path::PathBuf;
use tempfile::TempDir;

struct Place(TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn run(&self, args: &[&str]) -> (i32, String, String) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_lumenfab"));
        command.args(args).arg("--json").current_dir(self.0.path()).env("XDG_STATE_HOME", self.path("state"));
        let output = command.output().unwrap();
        let text = |b: &[u8]| String::from_utf8(b.to_vec()).unwrap();
        (output.status.code().unwrap(), text(&output.stdout), text(&output.stderr))
    }

    fn done(&self, args: &[&str]) -> Value {
        let (code, stdout, stderr) = self.run(args);
        assert_eq!(code, 0, "{args:?}: {stderr}");
        serde_json::from_str(&stdout).unwrap()
    }

    fn refused(&self, code: i32, args: &[&str]) -> String {
        let (found, _, stderr) = self.run(args);
        assert_eq!(found, code, "{args:?}: {stderr}");
        let line = stderr.lines().find_map(|l| l.strip_prefix("error: ")).unwrap().to_owned();
        line.replace(self.0.path().to_str().unwrap(), "")
    }
}

/// The CT: a small tube.
fn ct() -> Params {
    Params { kind: Kind::Tube, n_planes: 4, n_pixels: 128, pixel_mm: 0.4, ..Params::default() }
}

/// A label map on the grid of the CT, as a NRRD: a disk of 12 pixels, labelled 2, and a small one, labelled 5.
fn label_map(place: &Place, name: &str) {
    label_map_off(place, name, 0.0);
}

/// The same, so far beside the CT.
fn label_map_off(place: &Place, name: &str, off_mm: f64) {
    let loaded = lumenfab::ct::reader::load(&place.path("ct"), &Default::default(), &Task::quiet()).unwrap();
    let v = &loaded.volume;
    let [nx, ny, nz] = v.dims;
    let step = v.plane_z_mm[1] - v.plane_z_mm[0];
    let mut header =
        String::from("NRRD0004\ntype: uint8\ndimension: 3\nspace: left-posterior-superior\nencoding: raw\n");
    let [dx, dy] = v.pixel_spacing_xy_mm;
    writeln!(header, "sizes: {nx} {ny} {nz}\nspace directions: ({dx},0,0) (0,{dy},0) (0,0,{step})").unwrap();
    writeln!(
        header,
        "space origin: ({},{},{})\n",
        v.origin_xy_mm[0] + off_mm,
        v.origin_xy_mm[1],
        v.plane_z_mm[0]
    )
    .unwrap();
    let disk = |p: usize| {
        let (x, y) = ((p % nx) as f64, (p / nx % ny) as f64);
        if (x - 60.3).hypot(y - 64.8) < 12.0 {
            2
        } else if (x - 100.0).hypot(y - 30.0) < 4.0 {
            5
        } else {
            0_u8
        }
    };
    fs::write(place.path(name), [header.into_bytes(), (0..nx * ny * nz).map(disk).collect()].concat())
        .unwrap();
}

fn prepared() -> Place {
    let place = Place::new();
    phantom::series::write(&place.path("ct"), &ct(), &Task::quiet()).unwrap();
    label_map(&place, "doe-jane.seg");
    place
}

fn area_of(place: &Place, case: &str) -> Vec<f64> {
    let text = fs::read_to_string(place.path(case).join("sections.json")).unwrap();
    from_json(&text).unwrap().planes.iter().map(|p| p.region().area_mm2()).collect()
}

#[test]
fn a_label_map_becomes_a_case_with_its_ct_or_without() {
    let place = prepared();
    let disk = std::f64::consts::PI * 12.0 * 12.0 * 0.16;
    for (case, ct) in [("with", &["--ct", "ct"][..]), ("alone", &[])] {
        let args =
            [&["segment", "--segmentation", "doe-jane.seg", "--label", "2", "--out", case][..], ct].concat();
        assert_eq!(place.done(&args)["stages"][0]["done"], true);
        let areas = area_of(&place, case);
        assert_eq!(areas.len(), 4);
        assert!(areas.iter().all(|a| (a / disk - 1.0).abs() < 0.02), "{areas:?} {disk}");
        assert_eq!(place.path(case).join("volume.bin").exists(), !ct.is_empty());
        assert_eq!(place.done(&["segment", case])["stages"][0]["done"], false, "nothing is done again");
        for file in ["case.toml", "stages.toml", "segmentation.json", "sections.json"] {
            let text = fs::read_to_string(place.path(case).join(file)).unwrap();
            assert!(!text.contains("doe-jane"), "{file}: {text}");
        }
    }
}

#[test]
fn a_case_file_names_a_segmentation_and_nothing_more() {
    let place = prepared();
    for (file, ct) in [("with.toml", "ct = \"ct\"\n"), ("alone.toml", "")] {
        let text = format!("{ct}segmentation = \"doe-jane.seg\"\nlabel = 2\n");
        fs::write(place.path(file), text).unwrap();
        assert_eq!(place.done(&["segment", file])["stages"][0]["done"], true);
    }
}

#[test]
fn labels_are_listed_and_another_file_is_another_case() {
    let place = prepared();
    let args = ["segment", "--segmentation", "doe-jane.seg", "--out", "case"];
    let text = place.refused(2, &args);
    assert!(
        text.starts_with("doe-jane.seg holds 2 structures: 2 (")
            && text.ends_with("choose one with --label N"),
        "{text}"
    );
    assert!(!place.path("case").exists());
    place.done(&[&args[..], &["--label", "5"]].concat());
    let toml = fs::read_to_string(place.path("case/case.toml")).unwrap();
    assert!(toml.contains("source = \"segmentation\"") && toml.contains("label = 5"), "{toml}");
    // Another label is another result of the same case; another file is another case.
    assert_eq!(place.done(&["segment", "case", "--label", "2"])["stages"][0]["done"], true);
    let mut bytes = fs::read(place.path("doe-jane.seg")).unwrap();
    let last = bytes.len() - 1;
    bytes[last] = 2;
    fs::write(place.path("other.seg"), bytes).unwrap();
    let text = place.refused(2, &["segment", "--segmentation", "other.seg", "--out", "case"]);
    assert!(text.contains("is a case already, made from another source"), "{text}");
}

#[test]
fn what_cannot_be_a_segmentation_is_refused() {
    let place = prepared();
    fs::write(place.path("note"), "no segmentation").unwrap();
    for (code, file, words) in [
        (
            2,
            "nothing",
            "--segmentation: found nothing at nothing, expected a label map, a DICOM SEG or an RTSTRUCT",
        ),
        (
            1,
            "note",
            "note is no segmentation: expected a label map (NIfTI, MetaImage, NRRD), a DICOM SEG or an RTSTRUCT",
        ),
    ] {
        assert_eq!(place.refused(code, &["segment", "--segmentation", file, "--out", "case"]), words);
    }
    assert_eq!(
        place.refused(2, &["segment", "case", "--label", ""]),
        "--label: found \"\", expected the number or the name of a structure"
    );
}

#[test]
fn a_label_map_on_another_grid_than_the_cts_is_told() {
    let place = prepared();
    label_map_off(&place, "off.seg", 0.2);
    let unknown = |segmentation: &str, case: &str| {
        let args = ["segment", "--segmentation", segmentation, "--ct", "ct", "--label", "2", "--out", case];
        let answer = place.done(&args);
        let warnings = answer["stages"][0]["warnings"].as_array().unwrap().clone();
        warnings.iter().filter(|w| w["code"] == "segment.frame_unknown").count()
    };
    assert_eq!(unknown("doe-jane.seg", "same"), 0);
    assert_eq!(unknown("off.seg", "off"), 1);
}
