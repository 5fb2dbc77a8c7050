//! Prints on the simulated printer: a process of its own behind a real pseudo-terminal.

#![expect(clippy::unwrap_used, reason = "a test fails where something is wrong")]
#![expect(clippy::print_stdout, reason = "what was measured is shown with --nocapture")]

use lumenfab::printer::driver::{self, PrintEvent, Printed};
use lumenfab::printer::job::Job;
use lumenfab::printer::sim::{Machine, Options, Simulator};
use lumenfab::printer::{Error, serial};
use lumenfab::profile::{self, Profile};
use lumenfab::progress::CancelToken;
use std::fmt::Write as _;
use std::path::Path;
use std::time::Duration;
use tokio::sync::mpsc;

const PROFILE: &str = "reference";

/// Rings, one on the other, with a travel between: start and end scripts around them.
fn job_text(profile: &Profile, n_layers: u32, n_sides: u32) -> String {
    let mut text = profile.start_gcode().join("\n");
    for layer in 0..n_layers {
        let z_mm = 0.2 * f64::from(layer + 1);
        write!(text, "\n;LAYER:{layer}\nG1 Z{z_mm:.3} F600\nG0 X110.000 Y100.000 F9000\nG1 F1800").unwrap();
        for side in 1..=n_sides {
            let angle = std::f64::consts::TAU * f64::from(side) / f64::from(n_sides);
            let (x_mm, y_mm) = (10.0_f64.mul_add(angle.cos(), 100.0), 10.0_f64.mul_add(angle.sin(), 100.0));
            let length_mm = 20.0 * (std::f64::consts::PI / f64::from(n_sides)).sin();
            // Flow of a bead of 0.4 x 0.2 mm through 1.75 mm filament.
            let e_mm = length_mm * 0.4 * 0.2 / (std::f64::consts::PI * 0.875 * 0.875);
            write!(text, "\nG1 X{x_mm:.3} Y{y_mm:.3} E{e_mm:.5}").unwrap();
        }
    }
    text.push('\n');
    text + &profile.end_gcode(0.2 * f64::from(n_layers)).join("\n")
}

/// Not a test: this very program, started by the tests as the simulator (what stands behind `--` is for it).
#[test]
fn simulator_process() {
    let mut args = std::env::args_os().skip_while(|arg| arg != "--");
    if args.next().is_some() {
        let name = std::ffi::OsString::from("hil-sim");
        let code = hil_sim::cli::main_from(std::iter::once(name).chain(args));
        std::process::exit(i32::from(code != std::process::ExitCode::SUCCESS));
    }
}

struct Case {
    profile: &'static str,
    n_layers: u32,
    faults: Vec<String>,
    baud: Option<u32>,
    /// No more in flight than a receive buffer on a serial wire holds.
    narrow: bool,
}

impl Case {
    fn with(fault: &str) -> Self {
        Self { profile: PROFILE, n_layers: 40, faults: vec![fault.to_owned()], baud: None, narrow: false }
    }

    fn clean() -> Self {
        Self { profile: PROFILE, n_layers: 40, faults: Vec::new(), baud: None, narrow: false }
    }

    /// Prints; what came of it, and the record of deposition.
    async fn print(self) -> (Result<Printed, Error>, Vec<PrintEvent>, String) {
        let mut profile = profile::builtin(self.profile).unwrap();
        // What is pulled out for good is not waited for longer than this.
        profile.firmware.orphan_hold_s = 4.0;
        let job =
            Job::from_text(job_text(&profile, self.n_layers, 64), "ring.gcode", &profile.firmware).unwrap();
        let record = tempfile::tempdir().unwrap();
        let options = Options {
            program: std::env::current_exe().unwrap(),
            leading_args: ["simulator_process", "--exact", "--nocapture", "--"].map(Into::into).to_vec(),
            machine: Machine::Known(self.profile.to_owned()),
            record_dir: Some(record.path().to_owned()),
            faults: self.faults.clone(),
            baud: self.baud,
            seed: Some(1),
            ..Options::default()
        };
        let simulator = Simulator::start(&options).await.unwrap();
        let (sender, mut events) = mpsc::channel(64);
        let listener = tokio::spawn(async move {
            let mut heard = Vec::new();
            while let Some(event) = events.recv().await {
                heard.push(event);
            }
            heard
        });
        let profile = if self.narrow { profile } else { options.profile_for(&profile) };
        let link = serial::open(simulator.port(), &profile.firmware, None).await.unwrap();
        let limit = Duration::from_secs(120);
        let cancel = CancelToken::default();
        let print = driver::print(job, link, &profile, &sender, &cancel);
        let result = tokio::time::timeout(limit, print).await.expect("the print hangs");
        drop(sender);
        // After a fault the simulator may wait for a cable that nobody plugs in: it goes when it is dropped.
        if result.is_ok() {
            simulator.finish().await.unwrap();
        }
        let beads = read(&record.path().join("beads.csv"));
        (result, listener.await.unwrap(), beads)
    }
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_default()
}

/// The record without the columns that depend on when something happened.
fn without_time(beads: &str) -> Vec<Vec<&str>> {
    let columns: Vec<&str> = beads.lines().next().unwrap_or_default().split(',').collect();
    let is_kept = |i: usize| !matches!(columns[i], "t_s" | "hotend_c");
    beads
        .lines()
        .map(|line| line.split(',').enumerate().filter(|(i, _)| is_kept(*i)).map(|(_, v)| v).collect())
        .collect()
}

#[track_caller]
fn assert_same_deposition(clean: &str, noisy: &str) {
    let (clean, noisy) = (without_time(clean), without_time(noisy));
    let differs = clean.iter().zip(&noisy).position(|(a, b)| a != b);
    if let Some(row) = differs {
        panic!("row {row}: {:?} instead of {:?}", noisy[row], clean[row]);
    }
    assert_eq!(clean.len(), noisy.len());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_clean_print_deposits_every_segment_once() {
    let (result, _, beads) = Case::clean().print().await;
    let printed = result.unwrap();
    assert_eq!(beads.lines().count(), 1 + 40 * 64);
    assert_eq!((printed.stats.n_resends, printed.stats.n_lost_oks), (0, 0), "{:?}", printed.stats);
}

#[tokio::test(flavor = "multi_thread")]
async fn every_firmware_is_known_by_its_answer() {
    for profile in profile::builtin_names() {
        let options = Options {
            program: std::env::current_exe().unwrap(),
            leading_args: ["simulator_process", "--exact", "--nocapture", "--"].map(Into::into).to_vec(),
            machine: Machine::Known(profile.to_owned()),
            ..Options::default()
        };
        let simulator = Simulator::start(&options).await.unwrap();
        let firmware = profile::builtin(profile).unwrap().firmware;
        let link = serial::open(simulator.port(), &firmware, None).await.unwrap();
        let found = lumenfab::printer::ask::detect(link).await.unwrap();
        let known = found.profile.map(|name| profile::builtin(name).unwrap().firmware.dialect);
        assert_eq!(known, Some(firmware.dialect), "{profile}: {}", found.firmware);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_profile_is_printed_over_a_port_on_its_own_firmware() {
    for profile in profile::builtin_names() {
        let (result, _, beads) = Case { profile, n_layers: 3, ..Case::clean() }.print().await;
        let printed = result.unwrap_or_else(|e| panic!("{profile}: {e}"));
        println!("{profile}: {:?}", printed.stats);
        assert_eq!(beads.lines().count(), 1 + 3 * 64, "{profile}");
        assert_eq!(printed.stats.n_resends, 0, "{profile}: {:?}", printed.stats);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn how_many_lines_are_in_flight_leaves_no_trace_in_the_record() {
    let (result, _, wide) = Case::clean().print().await;
    result.unwrap();
    let (result, _, narrow) = Case { narrow: true, ..Case::clean() }.print().await;
    result.unwrap();
    assert!(wide == narrow, "beads.csv differs, maybe in its times only");
}

#[tokio::test(flavor = "multi_thread")]
async fn faults_of_the_wire_leave_no_trace_in_the_deposition() {
    let (result, _, clean) = Case::clean().print().await;
    result.unwrap();
    for fault in [
        "bit-error:rate=0.01",
        "bit-error:rate=0.01,dir=tx",
        "lost-byte:rate=0.01",
        "doubled-byte:rate=0.01",
        // Half a line runs together with the next one, and one time in 256 the sum of both is right by chance, which no
        // host can see: a few such lines at known places, not many at random ones.
        "half-line:line=300",
        "lost-ok:rate=0.003",
        "spurious-resend:rate=0.003",
        "wrong-resend:rate=0.01",
        "garbage:rate=0.01",
        "delay:rate=0.0005",
    ] {
        for narrow in [true, false] {
            let (result, _, noisy) = Case { narrow, ..Case::with(fault) }.print().await;
            let printed = result.unwrap_or_else(|error| panic!("{fault}: {error}"));
            println!("{fault}: {:.2} s, {:?}", printed.elapsed.as_secs_f64(), printed.stats);
            assert_same_deposition(&clean, &noisy);
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_throttled_wire_is_printed_over_just_as_well() {
    let (result, _, clean) = Case { n_layers: 4, ..Case::clean() }.print().await;
    result.unwrap();
    let slow = Case {
        profile: PROFILE,
        n_layers: 4,
        baud: Some(115_200),
        faults: vec!["bit-error:rate=0.02".to_owned()],
        narrow: true,
    };
    let (result, _, beads) = slow.print().await;
    println!("115200 baud: {:?}", result.unwrap());
    assert_same_deposition(&clean, &beads);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_port_that_vanishes_is_named_and_the_print_fails() {
    let (result, _, beads) = Case::with("disconnect:line=1000").print().await;
    let error = result.unwrap_err();
    assert_eq!(error.code(), "printer.port_vanished");
    let text = error.to_string();
    assert!(
        text.contains("/port vanished during the print; whether the heaters are on is unknown"),
        "{text}"
    );
    assert!(beads.lines().count() < 1000);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_stops_the_printer_stops_the_print_with_its_reason() {
    for (fault, code) in [
        ("kill:line=1000", "printer.halted"),
        ("runaway:line=1000", "printer.halted"),
        ("reset:line=1000", "printer.firmware_reset"),
    ] {
        let (result, ..) = Case::with(fault).print().await;
        let error = result.unwrap_err();
        println!("{fault}: {error}");
        assert_eq!(error.code(), code, "{fault}: {error}");
    }
}
