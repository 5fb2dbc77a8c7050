//! The report of a real printer: what its journal says was commanded, against what the simulated printer behind the same port
//! recorded. As processes, on a real pseudo-terminal.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]

use lumenfab::app::commanded;
use lumenfab::gcode::reader;
use lumenfab::geom::Point3;
use lumenfab::profile;
use lumenfab::report::Record;
use lumenfab::report::record::{self, Way};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;
use tempfile::TempDir;

const PROFILE: &str = "reference";
/// Coordinates have three decimals in G-code, filament five: places and widths of beads may differ by so much, mm.
const PLACE_MM: f64 = 2e-3;
const WIDTH_MM: f64 = 2e-3;

/// A sliced case of a short tube, and a simulated printer on `port` beside it.
struct Bench {
    dir: TempDir,
    printer: Child,
}

impl Bench {
    fn new(faults: &[&str]) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let ring = |z_mm: f64| {
            let points: Vec<Value> = (0..64)
                .map(|i| {
                    let angle = std::f64::consts::TAU * f64::from(i) / 64.0;
                    serde_json::json!([3.0 * angle.cos(), 3.0 * angle.sin()])
                })
                .collect();
            serde_json::json!({"z_mm": z_mm, "contours": [points]})
        };
        let planes: Vec<Value> = [0.0, 2.0, 4.0].map(ring).into();
        let sections = serde_json::json!({"units": "mm", "frame": "LPS", "planes": planes});
        fs::write(dir.path().join("sections.json"), sections.to_string()).unwrap();
        let mut printer = Command::new(env!("CARGO_BIN_EXE_lumenfab"));
        printer.args(["hil-sim", "--profile", PROFILE, "--speed", "max", "--link", "port"]);
        printer.args(["--record", "record"]);
        faults.iter().for_each(|fault| {
            printer.args(["--fault", fault]);
        });
        let printer =
            printer.current_dir(dir.path()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let bench = Self { dir, printer };
        bench.done(&["solid", "--sections", "sections.json", "--out", "case"]);
        bench.done(&["slice", "case", "--profile", PROFILE]);
        // A minute at most.
        let waited = (0..N_WAITS).take_while(|_| !bench.path("port").exists()).inspect(|_| wait()).count();
        assert!(waited < N_WAITS, "no printer");
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn run(&self, args: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_lumenfab"))
            .args(args)
            .current_dir(self.dir.path())
            .env("XDG_STATE_HOME", self.path("state"))
            .output()
            .unwrap()
    }

    #[track_caller]
    fn done(&self, args: &[&str]) {
        let output = self.run(args);
        assert_eq!(output.status.code(), Some(0), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    }

    /// The record of the simulator, once it has ended.
    fn recorded(&mut self) -> Record {
        Command::new("kill").arg(self.printer.id().to_string()).status().unwrap();
        self.printer.wait().unwrap();
        record::parse(&fs::read_to_string(self.path("record/beads.csv")).unwrap()).unwrap()
    }

    /// What the journal says was commanded.
    fn commanded(&self) -> Record {
        let profile = profile::builtin(PROFILE).unwrap();
        let commanded = commanded::read(&self.path("case/job.gcode"), &profile.firmware).unwrap();
        let area_mm2 = std::f64::consts::FRAC_PI_4 * profile.machine.filament_mm.powi(2);
        let ways = commanded.pushes.iter().map(|p| Way {
            from: Point3::from(p.from_mm),
            to: Point3::from(p.to_mm),
            volume_mm3: p.filament_mm * area_mm2,
        });
        Record::commanded(ways, profile.print.bead_shape)
    }
}

/// A minute of waiting.
const N_WAITS: usize = 30_000;

#[expect(clippy::disallowed_methods, reason = "the test waits for another process")]
fn wait() {
    std::thread::sleep(Duration::from_millis(2));
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

/// Bead by bead, the first `n` of them.
#[track_caller]
fn assert_alike(commanded: &Record, recorded: &Record, n: usize) {
    for (i, (a, b)) in commanded.segments.iter().zip(&recorded.segments).take(n).enumerate() {
        let off = (a.from - b.from).norm().max((a.to - b.to).norm());
        assert!(off < PLACE_MM, "bead {i}: {a:?} against {b:?}");
        assert!((a.height_mm - b.height_mm).abs() < 1e-3, "bead {i}: {a:?} against {b:?}");
        // Of a bead as short as a rounding step nothing but its place is sure.
        let is_long = (a.to - a.from).norm() > 0.1;
        assert!(!is_long || (a.width_mm - b.width_mm).abs() < WIDTH_MM, "bead {i}: {a:?} against {b:?}");
    }
}

#[test]
fn what_was_commanded_is_what_the_simulated_printer_recorded() {
    let mut bench = Bench::new(&[]);
    bench.done(&["print", "case", "--port", "port", "--profile", PROFILE]);
    bench.done(&["report", "case"]);
    let (recorded, commanded) = (bench.recorded(), bench.commanded());
    assert!(recorded.segments.len() > 100);
    assert_eq!(commanded.segments.len(), recorded.segments.len());
    assert_alike(&commanded, &recorded, usize::MAX);
    let volume = |r: &Record| r.segments.iter().map(|s| s.volume_mm3).sum::<f64>();
    assert!((volume(&commanded) / volume(&recorded) - 1.0).abs() < 1e-4);

    let report = json(&bench.path("case/report/report.json"));
    assert_eq!(report["deposited"], "commanded, not measured");
    assert_eq!(report["findings"], serde_json::json!([]));
    let overall = &report["deposition"]["overall"];
    assert!(
        overall["mean_mm"].as_f64().unwrap() < 0.005 && overall["iou_min"].as_f64().unwrap() > 0.99,
        "{overall}"
    );
    let page = fs::read_to_string(bench.path("case/report/index.html")).unwrap();
    assert!(page.contains("commanded, not measured"));
    // A bare "Passed" is for what was watched.
    assert_eq!(report["verdict"]["rests_on"], "commanded, not measured");
    let told = String::from_utf8_lossy(&bench.run(&["report", "case"]).stdout).into_owned();
    assert!(told.contains("Passed as commanded, the print itself was not measured"), "{told}");

    // What the report was made from is as sealed as the report.
    bench.done(&["verify", "case"]);
    let journal = bench.path("case/job.gcode.journal");
    let mut bytes = fs::read(&journal).unwrap();
    bytes.truncate(bytes.len() - 1);
    fs::write(&journal, bytes).unwrap();
    let verified = bench.run(&["verify", "case"]);
    let told = String::from_utf8_lossy(&verified.stdout).into_owned();
    assert!(verified.status.code() == Some(1) && told.contains("job.gcode.journal"), "{told}");
}

#[test]
fn after_a_print_that_broke_off_only_what_was_acknowledged_counts() {
    let mut bench = Bench::new(&["kill:line=700"]);
    let printed = bench.run(&["print", "case", "--port", "port", "--profile", PROFILE]);
    assert_eq!(printed.status.code(), Some(1));
    let reported = bench.run(&["report", "case"]);
    assert_eq!(reported.status.code(), Some(3), "{}", String::from_utf8_lossy(&reported.stderr));
    let (recorded, commanded) = (bench.recorded(), bench.commanded());
    let job = fs::read_to_string(bench.path("case/job.gcode")).unwrap();
    let n_lines = job.lines().filter(|l| reader::parse(l).is_ok_and(|l| l.command.is_some())).count();
    let n = commanded.segments.len();
    assert!(n > 100 && n < n_lines, "{n} beads, {n_lines} lines");
    // What is acknowledged waits in the planner for a moment: the printer that died has driven nearly all of it.
    assert!(
        recorded.segments.len() <= n && n - recorded.segments.len() < 64,
        "{} {n}",
        recorded.segments.len()
    );
    assert_alike(&commanded, &recorded, recorded.segments.len() - 1);
    let report = json(&bench.path("case/report/report.json"));
    assert_eq!(report["deposited"], "commanded, not measured");
    let notes = report["notes"].to_string();
    assert!(notes.contains("report.print_not_finished") && notes.contains("report.commanded"), "{notes}");
}
