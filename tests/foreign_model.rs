//! Models that other programs made, sliced without a case, as their users meet it.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]

use assert_cmd::Command;
use serde_json::Value;
use std::f64::consts::{FRAC_PI_4, PI, TAU};
use std::fmt::Write;
use std::fs;
use tempfile::TempDir;

type Facet = [[f64; 3]; 3];

/// An upright tube about the z axis.
fn tube(inner: f64, outer: f64, height: f64, n: u16) -> Vec<Facet> {
    let at = |radius: f64, k: u16, z: f64| {
        let angle = TAU * f64::from(k % n) / f64::from(n);
        [10.0 + radius * angle.cos(), -7.0 + radius * angle.sin(), 5.0 + z]
    };
    let mut facets = Vec::new();
    let mut quad = |a, b, c, d| facets.extend([[a, b, c], [a, c, d]]);
    for k in 0..n {
        let next = k + 1;
        quad(at(outer, k, 0.0), at(outer, next, 0.0), at(outer, next, height), at(outer, k, height));
        quad(at(inner, k, height), at(outer, k, height), at(outer, next, height), at(inner, next, height));
        quad(at(inner, next, 0.0), at(outer, next, 0.0), at(outer, k, 0.0), at(inner, k, 0.0));
        quad(at(inner, k, height), at(inner, next, height), at(inner, next, 0.0), at(inner, k, 0.0));
    }
    facets
}

fn stl(facets: &[Facet]) -> String {
    let mut text = String::from("solid tube\n");
    for facet in facets {
        text += "facet normal 0 0 0\nouter loop\n";
        for [x, y, z] in facet {
            writeln!(text, "vertex {x} {y} {z}").unwrap();
        }
        text += "endloop\nendfacet\n";
    }
    text + "endsolid tube\n"
}

fn slice(dir: &TempDir, args: &[&str]) -> (Option<i32>, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_lumenfab"))
        .arg("slice")
        .args(args)
        .current_dir(dir.path())
        .env("XDG_STATE_HOME", dir.path().join("state"))
        .output()
        .unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (output.status.code(), text(output.stdout), text(output.stderr))
}

#[test]
fn a_model_becomes_a_job_of_its_volume_only_moved_onto_the_bed() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("a.stl"), stl(&tube(3.0, 4.0, 4.0, 256))).unwrap();
    let args = ["a.stl", "--profile", "reference", "--out", "a.gcode", "--preview", "layers", "--json"];
    let (code, answer, stderr) = slice(&dir, &args);
    assert_eq!(code, Some(0), "{stderr}");
    let answer: Value = serde_json::from_str(&answer).unwrap();
    assert_eq!((answer["n_triangles"].as_u64(), answer["n_layers"].as_u64()), (Some(2048), Some(20)));
    assert_eq!(answer["warnings"].as_array().map(Vec::len), Some(0));
    // The bed of 200 x 200 mm has its middle where the tube's axis comes to lie.
    let moved: Vec<f64> =
        answer["bed_from_model_mm"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    for (found, expected) in moved.iter().zip([90.0, 107.0, -5.0]) {
        assert!((found - expected).abs() < 1e-4, "{moved:?}");
    }
    let volume = answer["filament_mm"].as_f64().unwrap() * FRAC_PI_4 * 1.75 * 1.75;
    assert!((volume / (7.0 * PI * 4.0) - 1.0).abs() < 3e-3, "{volume}");
    let job = fs::read_to_string(dir.path().join("a.gcode")).unwrap();
    assert!(job.contains("; layers 20\n; model_shift_mm 90.000") && job.matches(";LAYER:").count() == 20);
    assert_eq!(fs::read_dir(dir.path().join("layers")).unwrap().count(), 40);
    let (code, _, stderr) = slice(&dir, &args);
    assert!(code == Some(2) && stderr.contains("layers is not an empty folder"), "{stderr}");
}

#[test]
fn ten_runs_on_one_thread_and_two_with_the_triangles_in_any_order_give_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let mut facets = tube(2.0, 3.0, 2.0, 48);
    let job = |name: &str, n_threads: usize| {
        let output = Command::new(env!("CARGO_BIN_EXE_lumenfab"))
            .args(["slice", name, "--out", "a.gcode"])
            .current_dir(dir.path())
            .env("XDG_STATE_HOME", dir.path().join("state"))
            .env("RAYON_NUM_THREADS", n_threads.to_string())
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        fs::read(dir.path().join("a.gcode")).unwrap()
    };
    let mut jobs = Vec::new();
    for run in 0..10 {
        let name = format!("{run}.stl");
        fs::write(dir.path().join(&name), stl(&facets)).unwrap();
        jobs.push(job(&name, 1 + run % 2));
        // Every triangle comes elsewhere, and begins with another corner.
        facets.rotate_left(37);
        facets.swap(run, 100);
        facets.iter_mut().for_each(|f| f.rotate_left(1));
    }
    assert!(jobs.iter().all(|j| *j == jobs[0]));
}

#[test]
fn a_mesh_that_is_inside_out_or_goes_through_itself_is_printed_and_the_operator_told() {
    let dir = tempfile::tempdir().unwrap();
    let facets = tube(3.0, 4.0, 1.0, 64);
    let inverted: Vec<Facet> = facets.iter().map(|&[a, b, c]| [a, c, b]).collect();
    let beside = facets.iter().map(|f| f.map(|[x, y, z]| [x + 7.5, y, z]));
    let through: Vec<Facet> = facets.iter().copied().chain(beside).collect();
    for (name, facets, expected) in
        [("in.stl", inverted, "turned inside out"), ("through.stl", through, "was united")]
    {
        fs::write(dir.path().join(name), stl(&facets)).unwrap();
        let (code, answer, stderr) = slice(&dir, &[name, "--out", "a.gcode", "--json"]);
        assert!(code == Some(0) && stderr.contains(expected), "{name}: {stderr}");
        let answer: Value = serde_json::from_str(&answer).unwrap();
        let text = answer["warnings"][0]["text"].as_str().unwrap();
        assert!(text.contains(expected), "{text}");
    }
}

#[test]
fn what_cannot_be_printed_is_refused_in_one_line_and_nothing_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let put = |name: &str, text: &str| fs::write(dir.path().join(name), text).unwrap();
    let facets = tube(3.0, 4.0, 4.0, 64);
    put("a.stl", &stl(&facets));
    put("hole.stl", &stl(&facets[9..]));
    let large: Vec<Facet> = facets.iter().map(|f| f.map(|p| p.map(|c| 40.0 * c))).collect();
    put("large.stl", &stl(&large));
    put("thin.stl", &stl(&tube(3.9, 4.0, 1.0, 64)));
    put(
        "word.stl",
        "this is not a model of anything, but a text that is long enough to be one, as far as its bytes go",
    );
    for (args, code, expected) in [
        (vec!["a.stl"], 2, "--out: found none"),
        (vec!["a.stl", "--out", "x", "--layer-mm", "0.9"], 1, "layer height 0.9 mm is out of range"),
        (vec!["a.stl", "--out", "x", "--orient", "w,90"], 2, "AXIS,DEG: x, y or z"),
        (vec!["hole.stl", "--out", "x"], 1, "the mesh has a hole: in layer 0 at z 5.10 mm"),
        (vec!["large.stl", "--out", "x"], 1, "the part is 320 x 320 x 160 mm, the build space"),
        (vec!["thin.stl", "--out", "x"], 1, "mm thin in layer 0 at z 5.10 mm"),
        (vec!["word.stl", "--out", "x"], 1, "word.stl: it is no STL"),
        (vec!["absent.stl", "--out", "x"], 1, "cannot read absent.stl"),
    ] {
        let (found, stdout, stderr) = slice(&dir, &args);
        assert_eq!((found, stdout.as_str()), (Some(code), ""), "{args:?}: {stderr}");
        assert!(stderr.contains(expected), "{args:?}: {stderr}");
        assert!(!dir.path().join("x").exists());
    }
}
