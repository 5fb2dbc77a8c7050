//! The host is killed (`kill -9`) in the middle of a print, again and again, and goes on by its journal: as processes, on a real
//! pseudo-terminal and a real disk.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]
#![expect(clippy::print_stdout, reason = "what was measured is shown with --nocapture")]

#[path = "shared/rings.rs"]
mod rings;

use lumenfab::profile;
use rings::Rings;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const PROFILE: &str = "reference";
const N_LAYERS: u32 = 150;
const N_SIDES: u32 = 64;
/// Commands of the host that are killed before one may end by itself.
const KILLS: usize = 5;

/// Rings, one on the other.
fn job_text() -> String {
    let profile = profile::builtin(PROFILE).unwrap();
    let end = profile.end_gcode(0.2 * f64::from(N_LAYERS));
    rings::job(
        &profile.start_gcode(),
        Rings { n_layers: N_LAYERS, n_sides: N_SIDES, filament_mm: 0.03266 },
        &end,
    )
}

/// A folder with the job, and a simulated printer on `port` in it.
struct Bench {
    dir: TempDir,
    printer: Child,
}

impl Bench {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("job.gcode"), job_text()).unwrap();
        let printer = Command::new(env!("CARGO_BIN_EXE_lumenfab"))
            .args(["hil-sim", "--profile", PROFILE, "--speed", "max", "--link", "port", "--record", "record"])
            .current_dir(dir.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let bench = Self { dir, printer };
        until(|| bench.path("port").exists());
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn host(&self, verb: &str) -> Child {
        Command::new(env!("CARGO_BIN_EXE_lumenfab"))
            .args([verb, "job.gcode", "--port", "port", "--profile", PROFILE])
            .current_dir(self.dir.path())
            .env("XDG_STATE_HOME", self.path("state"))
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    }

    /// Waits for the host to end; it must have done its work, or its predecessor had, that died on its way out.
    #[track_caller]
    fn ends_well(host: Child) {
        let output = host.wait_with_output().unwrap();
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() || error.contains("the print was finished"), "{error}");
    }

    /// The record, without the columns that depend on when something happened.
    fn beads(mut self) -> Vec<Vec<String>> {
        Command::new("kill").arg(self.printer.id().to_string()).status().unwrap();
        self.printer.wait().unwrap();
        let text = fs::read_to_string(self.path("record/beads.csv")).unwrap();
        let header: Vec<&str> = text.lines().next().unwrap().split(',').collect();
        let is_kept = |i: usize| !matches!(header[i], "t_s" | "hotend_c");
        let row = |line: &str| {
            let cells = line.split(',').enumerate().filter(|(i, _)| is_kept(*i));
            cells.map(|(_, cell)| cell.to_owned()).collect()
        };
        text.lines().map(row).collect()
    }
}

#[expect(clippy::disallowed_methods, reason = "the test waits for another process")]
fn until(is_true: impl Fn() -> bool) {
    let start = Instant::now();
    while !is_true() {
        assert!(start.elapsed() < Duration::from_secs(60), "waited in vain");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// Size of a file; nothing where there is none.
fn n_bytes(path: &Path) -> u64 {
    fs::metadata(path).map_or(0, |m| m.len())
}

/// Prints; kills the host so many times, each so long after it began; the record, and how often it was killed before it ended.
#[expect(clippy::disallowed_methods, reason = "the moment of death")]
fn printed_with_deaths(moments_ms: &[u64]) -> (Vec<Vec<String>>, usize) {
    let bench = Bench::new();
    let mut n_killed = 0;
    let mut verb = "print";
    for &ms in moments_ms {
        let mut host = bench.host(verb);
        // A print that has not begun leaves nothing to resume.
        until(|| n_bytes(&bench.path("record/beads.csv")) > 200 || verb == "resume");
        std::thread::sleep(Duration::from_millis(ms));
        if host.try_wait().unwrap().is_some() {
            Bench::ends_well(host);
            return (bench.beads(), n_killed);
        }
        host.kill().unwrap();
        host.wait().unwrap();
        n_killed += 1;
        verb = "resume";
    }
    Bench::ends_well(bench.host(verb));
    (bench.beads(), n_killed)
}

/// Deaths at moments of this seed, until there were so many; every print must be the clean one.
fn dies(n_deaths: usize, seed: u64) {
    let (clean, _) = printed_with_deaths(&[]);
    assert_eq!(clean.len(), 1 + (N_LAYERS * N_SIDES) as usize);
    let mut random = seed;
    let mut moment_ms = || {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (random >> 33) % 250
    };
    let (mut n_killed, mut n_prints) = (0, 0);
    while n_killed < n_deaths {
        let moments: Vec<u64> = (0..KILLS).map(|_| moment_ms()).collect();
        let (beads, n) = printed_with_deaths(&moments);
        let differs = clean.iter().zip(&beads).position(|(a, b)| a != b);
        assert_eq!((differs, beads.len()), (None, clean.len()), "moments {moments:?} ms");
        (n_killed, n_prints) = (n_killed + n, n_prints + 1);
        assert!(n_prints <= 4 * n_deaths, "the prints end before they can be broken off");
    }
    println!("{n_killed} deaths in {n_prints} prints: every bead once, as in the clean print");
}

#[test]
fn a_killed_host_goes_on_and_lays_every_bead_once() {
    dies(5, 1);
}

/// `cargo test --release --test killed_host -- --ignored --nocapture`
#[test]
#[ignore = "takes minutes; the sample above is always run"]
fn two_hundred_deaths() {
    dies(200, 2);
}
