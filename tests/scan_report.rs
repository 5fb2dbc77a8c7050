//! A replica that was printed and scanned, through the program: the scan is accepted, judged, kept nowhere, and vouches for that print
//! alone. As processes, on a real pseudo-terminal.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]
#![expect(clippy::cast_possible_truncation, reason = "voxels of a made-up scan")]

use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;
use tempfile::TempDir;

const PROFILE: &str = "reference";
const N_PLANES: usize = 12;
const INTERVAL_MM: f64 = 2.0;
const VOXEL_MM: f64 = 0.3;
/// What must not be found in the case: it stands in the scan's header and in its path.
const SECRETS: [&str; 2] = ["Lovelace", "19521210"];

/// Middle and radius of the lumen at a height: no plane is like another.
fn lumen(z_mm: f64) -> ([f64; 2], f64) {
    let part = z_mm / (INTERVAL_MM * (N_PLANES - 1) as f64);
    ([3.0 * (2.3 * part).sin(), 2.5 * part * part], 2.4 + 0.6 * (1.0 - part) * part.cos())
}

/// What is there of the replica, by place: its wall of 1 mm, in the plane.
fn is_printed([x, y, z]: [f64; 3]) -> bool {
    let half = 0.5 * INTERVAL_MM;
    let top = INTERVAL_MM * (N_PLANES - 1) as f64;
    let ([cx, cy], radius_mm) = lumen(z.clamp(0.0, top));
    let off = (x - cx).hypot(y - cy);
    (-half..=top + half).contains(&z) && (radius_mm..=radius_mm + 1.0).contains(&off)
}

/// A scan as an NRRD file: a part of every voxel is covered, which is all the blur there is.
fn scan(is_there: impl Fn([f64; 3]) -> bool, to: &Path) {
    let (low, high) = ([-6.5, -6.5, -4.0], [9.0, 8.5, 26.0]);
    let dims = [0, 1, 2].map(|a: usize| ((high[a] - low[a]) / VOXEL_MM).ceil() as usize);
    let mut bytes = format!(
        "NRRD0004\n# {}, born {}\ntype: short\ndimension: 3\nspace: left-posterior-superior\nsizes: {} {} {}\nspace directions: ({VOXEL_MM},0,0) (0,{VOXEL_MM},0) (0,0,{VOXEL_MM})\nspace origin: (100,-40,30)\nkinds: domain domain domain\nendian: little\nencoding: raw\n\n",
        SECRETS[0], SECRETS[1], dims[0], dims[1], dims[2]
    )
    .into_bytes();
    for v in 0..dims[0] * dims[1] * dims[2] {
        let index = [v % dims[0], v / dims[0] % dims[1], v / (dims[0] * dims[1])];
        let covered = (0..64).filter(|s| {
            let at =
                |a: usize| low[a] + VOXEL_MM * (index[a] as f64 + 0.25 * (f64::from(s >> (2 * a) & 3) - 1.5));
            is_there([at(0), at(1), at(2)])
        });
        let value = -1000.0 + 1100.0 * covered.count() as f64 / 64.0;
        bytes.extend((value as i16).to_le_bytes());
    }
    fs::create_dir_all(to.parent().unwrap()).unwrap();
    fs::write(to, bytes).unwrap();
}

/// A sliced case, and a simulated printer on `port` beside it that the program takes for a real one.
struct Bench {
    dir: TempDir,
    printer: Child,
}

impl Drop for Bench {
    fn drop(&mut self) {
        let _ended = (self.printer.kill(), self.printer.wait());
    }
}

impl Bench {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let ring = |k: usize| {
            let z_mm = INTERVAL_MM * k as f64;
            let ([cx, cy], radius_mm) = lumen(z_mm);
            let points: Vec<Value> = (0..128)
                .map(|i| {
                    let angle = std::f64::consts::TAU * f64::from(i) / 128.0;
                    serde_json::json!([cx + radius_mm * angle.cos(), cy + radius_mm * angle.sin()])
                })
                .collect();
            serde_json::json!({"z_mm": z_mm, "contours": [points]})
        };
        let planes: Vec<Value> = (0..N_PLANES).map(ring).collect();
        let sections = serde_json::json!({"units": "mm", "frame": "LPS", "planes": planes});
        fs::write(dir.path().join("sections.json"), sections.to_string()).unwrap();
        let printer = Command::new(env!("CARGO_BIN_EXE_lumenfab"))
            .args(["hil-sim", "--profile", PROFILE, "--speed", "max", "--link", "port"])
            .current_dir(dir.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let bench = Self { dir, printer };
        bench.run(0, &["solid", "--sections", "sections.json", "--out", "case"]);
        bench.run(0, &["slice", "case", "--profile", PROFILE]);
        // A minute at most.
        assert!((0..30_000).any(|_| bench.path("port").exists() || wait()), "no printer");
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    #[track_caller]
    fn run(&self, code: i32, args: &[&str]) -> Output {
        let output = Command::new(env!("CARGO_BIN_EXE_lumenfab"))
            .args(args)
            .current_dir(self.dir.path())
            .env("XDG_STATE_HOME", self.path("state"))
            .output()
            .unwrap();
        let told = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{args:?}: {told}");
        output
    }

    fn report(&self) -> Value {
        serde_json::from_str(&fs::read_to_string(self.path("case/report/report.json")).unwrap()).unwrap()
    }
}

/// Waits a moment; nothing has come of it yet.
#[expect(clippy::disallowed_methods, reason = "the test waits for another process")]
fn wait() -> bool {
    std::thread::sleep(Duration::from_millis(2));
    false
}

/// Every file under a folder.
fn files(dir: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(dir).unwrap().map(|e| e.unwrap().path());
    entries.flat_map(|p| if p.is_dir() { files(&p) } else { vec![p] }).collect()
}

#[test]
fn a_scan_is_judged_tells_nothing_and_vouches_for_its_own_print_alone() {
    let bench = Bench::new();
    let print = ["print", "case", "--port", "port", "--profile", PROFILE];
    bench.run(0, &print);
    let good = "scans/Lovelace/19521210.nrrd";
    scan(is_printed, &bench.path(good));
    let told = bench.run(0, &["report", "case", "--scan", good, "--json"]);
    let report = bench.report();
    assert_eq!(report["verdict"]["passed"], true, "{}", report["verdict"]);
    let overall = &report["scan"]["overall"];
    assert!(overall["mean_mm"].as_f64().unwrap() < 0.06 && overall["n_planes"] == N_PLANES, "{overall}");
    assert!(report["findings"].as_array().unwrap().is_empty(), "{}", report["findings"]);
    // Neither the case nor what was told has the scan's header or path.
    let written = files(&bench.path("case")).into_iter().map(|p| fs::read(p).unwrap());
    for bytes in written.chain([told.stdout, told.stderr]) {
        for secret in SECRETS {
            let is_there = bytes.windows(secret.len()).any(|w| w == secret.as_bytes());
            assert!(!is_there, "{secret}");
        }
    }

    // A replica that lacks half of its wall over 4 mm does not pass, and says where.
    let open = "scans/open.nrrd";
    let is_open = |p: [f64; 3]| (10.0..14.0).contains(&p[2]) && p[0] > lumen(p[2]).0[0];
    scan(|p| is_printed(p) && !is_open(p), &bench.path(open));
    bench.run(3, &["report", "case", "--scan", open]);
    let report = bench.report();
    let found = report["findings"].as_array().unwrap().iter().find(|f| f["kind"] == "missing_material");
    let found = found.unwrap_or_else(|| panic!("{}", report["findings"]));
    let z_mm = [0, 1].map(|i| found["z_mm"][i].as_f64().unwrap());
    assert!(found["stage"] == "scan" && (9.0..11.5).contains(&z_mm[0]), "{found}");
    assert!((12.5..15.0).contains(&z_mm[1]), "{found}");

    // The same job once more is another replica: what was scanned is not it.
    bench.run(0, &["report", "case", "--scan", good]);
    bench.run(0, &["report", "case"]);
    assert!(bench.report()["scan"].is_object(), "nothing has changed");
    bench.run(0, &print);
    let told = bench.run(0, &["report", "case"]);
    assert!(bench.report().get("scan").is_none());
    assert!(bench.report()["notes"].to_string().contains("report.scan_left_out"));
    assert!(String::from_utf8_lossy(&told.stderr).contains("the scan is left out"));
}
