//! The report of a phantom as others read it: its page in a headless browser, its DICOM object with the tools of dcmtk and
//! dicom3tools, its figures measured again with code of others. What is not installed is said, and skipped.
//!
//! How fast planes follow one another is judged by a command of its own, on a machine that does nothing else:
//! `tests/tools/report_browser.py CASE/report --planes-per-s 30`. `--golden tests/golden/report --keep` keeps new pictures.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]

mod shared;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

struct Place(TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    #[track_caller]
    fn run(&self, args: &[&str]) {
        let output = Command::new(env!("CARGO_BIN_EXE_lumenfab"))
            .args(args)
            .current_dir(self.0.path())
            .env("XDG_STATE_HOME", self.path("state"))
            .output()
            .unwrap();
        assert!(output.status.success(), "{args:?}: {}", text(&output));
    }

    /// A small CT of the built-in vessel, all the way to its report.
    fn reported() -> Self {
        let place = Self::new();
        place.run(&["phantom", "--out", "ct", "--pixels", "256"]);
        place.run(&["run", "--ct", "ct", "--seed-mm", "auto", "--out", "case"]);
        place
    }
}

fn text(output: &Output) -> String {
    let [out, err] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes));
    format!("{out}{err}")
}

fn own(below: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(below)
}

/// What a program prints; `None`, and why, where it is not there.
fn printed(program: &str, args: &[&str]) -> Option<Output> {
    let output = Command::new(program).args(args).output();
    if output.is_err() {
        eprintln!("skipped: {program} is not installed");
    }
    output.ok()
}

fn utf8(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn the_page_is_read_clicked_and_printed_in_a_browser() {
    let place = Place::reported();
    let (script, golden) = (own("tests/tools/report_browser.py"), own("tests/golden/report"));
    let report = place.path("case/report");
    let Some(output) = printed("python3", &[utf8(&script), utf8(&report), "--golden", utf8(&golden)]) else {
        return;
    };
    let told = text(&output);
    eprintln!("{told}");
    assert!(output.status.success() && !told.contains("FAIL"), "{told}");
}

#[test]
fn the_document_in_the_patients_study_is_what_dicom_asks_for() {
    let place = Place::reported();
    place.run(&["report", "case", "--dicom", "dicom", "--source", "ct"]);
    let object = std::fs::read_dir(place.path("dicom")).unwrap().next().unwrap().unwrap().path();
    if let Some(output) =
        printed("dcmdump", &["+P", "0008,0016", "+P", "0042,0012", "+P", "0020,000d", utf8(&object)])
    {
        let told = text(&output);
        assert!(output.status.success(), "{told}");
        for expected in ["EncapsulatedPDFStorage", "[application/pdf]", "StudyInstanceUID"] {
            assert!(told.contains(expected), "{expected}: {told}");
        }
        let of_ct =
            text(&printed("dcmdump", &["+P", "0020,000d", utf8(&place.path("ct/IM0001.dcm"))]).unwrap());
        assert!(told.contains(of_ct.trim()), "not the study of the CT: {told}{of_ct}");
    }
    if let Some(output) = printed("dciodvfy", &[utf8(&object)]) {
        let told = text(&output);
        assert!(told.contains("EncapsulatedPDF") && !told.contains("Error"), "{told}");
    }
}

#[test]
fn figures_agree_with_those_of_other_code() {
    let Some(tools) = shared::beside("tools") else { return };
    let Some(sections) = shared::beside("data/truth/carotid46.sections.json") else { return };
    let python = std::env::var("LUMENFAB_PYTHON").unwrap_or_else(|_| "python3".into());
    let place = Place::new();
    let (script, coarse) = (own("tests/tools/shared_figures.py"), place.path("coarse.json"));
    let args = [utf8(&script), utf8(&tools), "coarse", utf8(&sections), utf8(&coarse)];
    let Some(output) = printed(&python, &args) else { return };
    assert!(output.status.success(), "{}", text(&output));
    if text(&output).contains("skipped") {
        eprintln!("{}", text(&output));
        return;
    }
    place.run(&["solid", "--sections", "coarse.json", "--out", "case"]);
    for stage in ["slice", "print", "report"] {
        // The gate is none of this test's: the lumen is measured, not judged.
        let output = Command::new(env!("CARGO_BIN_EXE_lumenfab"))
            .args([stage, "case"])
            .current_dir(place.0.path())
            .env("XDG_STATE_HOME", place.path("state"))
            .output()
            .unwrap();
        assert!(matches!(output.status.code(), Some(0 | 3)), "{stage}: {}", text(&output));
    }
    place.run(&["export", "case", "--skin", "lumen", "--deflection-mm", "0.0005", "--stl", "lumen.stl"]);
    let args =
        [utf8(&script), utf8(&tools), "compare", utf8(&place.path("case")), utf8(&place.path("lumen.stl"))]
            .map(str::to_owned);
    let output = printed(&python, &args.each_ref().map(String::as_str)).unwrap();
    eprintln!("{}", text(&output));
    assert!(output.status.success(), "{}", text(&output));
}
