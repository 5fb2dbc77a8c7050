//! The program as a host and an operator meet it: a real process behind a real pseudo-terminal.

#![expect(clippy::unwrap_used, reason = "a test that cannot do its work has failed")]

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    process::{Pid, Signal, kill_process},
};
use std::{
    fs::{self, File, OpenOptions},
    io::{BufRead, BufReader, Write},
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    time::Duration,
};

fn program() -> Command {
    Command::new(env!("CARGO_BIN_EXE_hil-sim"))
}

/// How long anything may take before its test fails.
const LIMIT: Duration = Duration::from_secs(10);

/// Waits for something, within [`LIMIT`].
fn wait_for(what: &str, mut holds: impl FnMut() -> bool) {
    let pause = Duration::from_millis(10);
    for _ in 0..LIMIT.as_millis() / pause.as_millis() {
        if holds() {
            return;
        }
        hil_sim::pty::pause(pause).unwrap();
    }
    panic!("waited in vain for {what}");
}

struct Simulator {
    process: Child,
    link: PathBuf,
    dir: tempfile::TempDir,
}

impl Simulator {
    fn start(args: &[&str]) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let link = dir.path().join("printer");
        let process = program()
            .args(if args.contains(&"--speed") { &[][..] } else { &["--speed", "max"] })
            .args(["--profile", "reference", "--json", "--link"])
            .arg(&link)
            .arg("--record")
            .arg(dir.path().join("record"))
            .args(args)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        wait_for("the link", || link.exists());
        Self { process, link, dir }
    }

    fn open(&self) -> Host {
        let port = OpenOptions::new().read(true).write(true).open(&self.link).unwrap();
        Host { answers: BufReader::new(port.try_clone().unwrap()), port }
    }

    fn record(&self, name: &str) -> String {
        fs::read_to_string(self.dir.path().join("record").join(name)).unwrap()
    }

    /// Ends it (it must end by itself within the time limit) and gives the summary it printed.
    fn end(mut self) -> (serde_json::Value, tempfile::TempDir) {
        wait_for("the end of the program", || self.process.try_wait().unwrap().is_some());
        assert!(fs::symlink_metadata(&self.link).is_err(), "the link is still there");
        let mut text = String::new();
        std::io::Read::read_to_string(self.process.stdout.as_mut().unwrap(), &mut text).unwrap();
        (serde_json::from_str(&text).unwrap(), self.dir)
    }
}

struct Host {
    port: File,
    answers: BufReader<File>,
}

impl Host {
    fn send(&mut self, text: &str) {
        self.port.write_all(text.as_bytes()).unwrap();
    }

    fn answer(&mut self) -> String {
        // The echo of a damaged line may hold any byte.
        let mut line = Vec::new();
        while line.last() != Some(&b'\n') {
            assert!(
                self.has_more(LIMIT),
                "waited in vain for an answer after {:?}",
                String::from_utf8_lossy(&line)
            );
            let heard = self.answers.fill_buf().unwrap();
            assert!(!heard.is_empty(), "the port hung up after {:?}", String::from_utf8_lossy(&line));
            let n_bytes = heard.iter().position(|&byte| byte == b'\n').map_or(heard.len(), |i| i + 1);
            line.extend_from_slice(&heard[..n_bytes]);
            self.answers.consume(n_bytes);
        }
        String::from_utf8_lossy(&line).trim_end().to_owned()
    }

    /// Answers up to and with the next `ok`.
    fn until_ok(&mut self) -> Vec<String> {
        let mut lines = Vec::new();
        while !lines.last().is_some_and(|line: &String| line.starts_with("ok")) {
            lines.push(self.answer());
        }
        lines
    }

    /// The next answer, unless none begins within a quarter of a second.
    fn answer_soon(&mut self) -> Option<String> {
        self.has_more(Duration::from_millis(250)).then(|| self.answer())
    }

    /// Whether something more is said, or the port hangs up, within a time.
    fn has_more(&self, wait: Duration) -> bool {
        let wait = Timespec::try_from(wait).unwrap();
        !self.answers.buffer().is_empty()
            || poll(&mut [PollFd::new(&self.port, PollFlags::IN)], Some(&wait)).unwrap() > 0
    }

    /// Prints a job, three lines at a time with a mark behind them, going back to what is asked for or missing.
    fn print(&mut self, commands: &[String]) {
        self.print_on(commands, 0);
    }

    /// The same from behind line `done` on.
    fn print_on(&mut self, commands: &[String], mut done: usize) {
        let lines: Vec<String> = commands.iter().zip(1..).map(|(text, n)| numbered(n, text)).collect();
        for mark in 0.. {
            if done == lines.len() {
                return;
            }
            let batch = lines[done..].iter().take(3).map(String::as_str).collect::<String>();
            self.send(&format!("{batch}M118 mark {mark}\n"));
            let end = format!("mark {mark}");
            while let Some(answer) = self.answer_soon().filter(|answer| *answer != end) {
                if let Some(wanted) = answer.strip_prefix("Resend: ") {
                    done = wanted.parse::<usize>().unwrap() - 1;
                    break;
                }
                if let Some(n) = answer.strip_prefix("ok N").and_then(|rest| rest.split(' ').next()) {
                    done = n.parse::<usize>().unwrap().max(done);
                }
            }
        }
    }
}

fn numbered(n: usize, text: &str) -> String {
    let body = format!("N{n} {text}");
    let sum = body.bytes().fold(0, |sum, b| sum ^ b);
    format!("{body}*{sum}\n")
}

fn job() -> Vec<String> {
    let mut commands: Vec<String> = ["G28", "M109 S200", "G90", "M83"].map(str::to_owned).to_vec();
    for layer in 1..=10 {
        commands.push(format!("G1 Z{:.3} F600", f64::from(layer) * 0.2));
        for i in 0..200 {
            let angle = f64::from(i) * 0.0314;
            let (x, y) = (20.0_f64.mul_add(angle.cos(), 100.0), 20.0_f64.mul_add(angle.sin(), 100.0));
            commands.push(format!("G1 X{x:.3} Y{y:.3} E0.02090 F1800"));
        }
    }
    commands.push("M400".to_owned());
    commands
}

/// `beads.csv` of the job, printed with `args`.
fn printed(args: &[&str]) -> (String, serde_json::Value) {
    let simulator = Simulator::start(&[args, &["--once"]].concat());
    let mut host = simulator.open();
    host.print(&job());
    drop(host);
    let (summary, dir) = simulator.end();
    (fs::read_to_string(dir.path().join("record/beads.csv")).unwrap(), summary)
}

/// The table without the columns that depend on time.
fn geometry(beads: &str) -> Vec<&str> {
    beads.lines().map(|row| &row[row.find(',').unwrap()..row.rfind(',').unwrap()]).collect()
}

#[test]
fn job_is_recorded_and_the_link_goes_when_the_user_leaves() {
    let (beads, summary) = printed(&[]);
    assert_eq!(beads.lines().count(), 2001);
    assert_eq!(beads.lines().next().unwrap(), hil_sim::record::BEADS_HEADER);
    assert_eq!(summary["beads"], 2000);
    assert_eq!(summary["layers"], 10);
    assert_eq!(summary["last_state"], "idle");
    let again = printed(&[]).0;
    assert_eq!(beads, again, "the same commands give the same bytes");
}

#[test]
fn damaged_lines_leave_the_deposition_unchanged() {
    let clean = printed(&[]).0;
    let (noisy, summary) = printed(&["--fault", "bit-error:rate=0.02,count=25", "--seed", "3"]);
    assert!(summary["resend_requests"].as_u64().unwrap() > 5, "{summary}");
    assert_eq!(geometry(&clean), geometry(&noisy));
}

#[test]
fn termination_ends_the_record_and_removes_the_link() {
    let simulator = Simulator::start(&[]);
    let mut host = simulator.open();
    assert_eq!(host.answer(), "start");
    host.send("G28\n");
    host.until_ok();
    kill_process(Pid::from_child(&simulator.process), Signal::TERM).unwrap();
    let (summary, dir) = simulator.end();
    assert_eq!(summary["commands_executed"], 1);
    assert!(dir.path().join("record/summary.json").exists());
}

#[test]
fn record_is_on_disk_within_a_second() {
    let simulator = Simulator::start(&["--once"]);
    let mut host = simulator.open();
    host.send("G28\nM105\n");
    host.until_ok();
    wait_for("the events", || simulator.record("events.jsonl").contains("\"M105\""));
}

#[test]
fn dwell_takes_its_time_on_the_clock() {
    let simulator = Simulator::start(&["--speed", "2", "--once"]);
    let mut host = simulator.open();
    host.send("M105\n");
    host.until_ok();
    // The simulator is in the middle of a wait when the command comes.
    hil_sim::pty::pause(Duration::from_millis(150)).unwrap();
    #[expect(clippy::disallowed_methods, reason = "the clock is what is tested")]
    let start = std::time::Instant::now();
    host.send("G4 P600\n");
    host.until_ok();
    assert!(start.elapsed() >= Duration::from_millis(300), "{:?}", start.elapsed());
}

#[test]
fn vanished_port_ends_a_simulator_that_serves_one_user() {
    let simulator = Simulator::start(&["--fault", "disconnect:line=1", "--once"]);
    let mut host = simulator.open();
    host.send("M107\n");
    assert_eq!(simulator.end().0["last_state"], "unplugged");
}

#[test]
fn disconnect_removes_the_port_and_brings_it_back() {
    let simulator = Simulator::start(&["--fault", "disconnect:line=2,for-s=0.3", "--once"]);
    let mut host = simulator.open();
    host.send(&numbered(1, "M107"));
    while !host.answer().starts_with("ok N1") {}
    host.send(&numbered(2, "M107"));
    // The port hangs up: end of file or an error.
    while host.has_more(LIMIT) && host.answers.fill_buf().is_ok_and(|rest| !rest.is_empty()) {
        host.answers.consume(host.answers.buffer().len());
    }
    wait_for("the link to go", || fs::symlink_metadata(&simulator.link).is_err());
    drop(host);
    wait_for("the link to come back", || simulator.link.exists());
    let mut host = simulator.open();
    host.send(&numbered(3, "M107"));
    assert_eq!(host.until_ok(), ["ok N3 P15 B3"]);
    drop(host);
    assert_eq!(simulator.end().0["last_line"], 3);
}

#[test]
fn host_that_comes_back_finds_the_same_printer() {
    let simulator = Simulator::start(&[]);
    let mut host = simulator.open();
    host.send(&numbered(1, "M107"));
    while !host.answer().starts_with("ok N1") {}
    drop(host);
    wait_for("the departure", || simulator.record("events.jsonl").contains("host-left"));
    let mut host = simulator.open();
    host.send(&numbered(2, "M107"));
    assert_eq!(host.until_ok(), ["ok N2 P15 B3"]);
    kill_process(Pid::from_child(&simulator.process), Signal::INT).unwrap();
    simulator.end();
}

/// A host that dies with lines under way, and another that asks for the last line and goes on behind it.
#[test]
fn host_that_dies_at_any_line_can_be_followed_by_one_that_misses_and_repeats_nothing() {
    let clean = printed(&[]).0;
    let job = job();
    for died_at in [5, 211, 1000, 2011] {
        let simulator = Simulator::start(&[]);
        let mut host = simulator.open();
        host.print(&job[..died_at]);
        let under_way: String =
            job[died_at..].iter().zip(died_at + 1..).take(3).map(|(c, n)| numbered(n, c)).collect();
        // The last line is cut off.
        host.send(&under_way[..under_way.len() - 4]);
        drop(host);
        wait_for("the departure", || simulator.record("events.jsonl").contains("host-left"));
        let mut host = simulator.open();
        // What is behind a line that is refused is forgotten with it: the question comes after the answer.
        host.send("\n");
        while host.answer_soon().is_some() {}
        host.send(&numbered(1_000_000, "M105"));
        let last = loop {
            let answer = host.answer();
            if answer.starts_with("Error:Line Number")
                && let Some(last) = answer.split("Last Line: ").nth(1)
            {
                break last.parse::<usize>().unwrap();
            }
        };
        host.until_ok();
        host.print_on(&job, last);
        kill_process(Pid::from_child(&simulator.process), Signal::TERM).unwrap();
        let (summary, dir) = simulator.end();
        assert_eq!(
            geometry(&clean),
            geometry(&fs::read_to_string(dir.path().join("record/beads.csv")).unwrap())
        );
        assert_eq!(
            (&summary["repeated_beads"], &summary["repeated_move_lines"]),
            (&0.into(), &0.into()),
            "{died_at}"
        );
    }
}

fn run(args: &[&str]) -> Output {
    program().args(args).output().unwrap()
}

#[test]
fn wrong_usage_has_code_2_and_one_clear_line() {
    let dir = tempfile::tempdir().unwrap();
    let taken = dir.path().to_str().unwrap();
    for (args, part) in [
        (&["--link", "x", "--fault", "explode"][..], "unknown kind `explode`"),
        (&["--link", "x", "--fault", "kill:rate=7"], "rate is `7`"),
        (&["--link", "x", "--profile", "nix"], "unknown profile `nix`"),
        (&["--link", taken], "already a directory"),
        (&["--link", "x", "--speed", "warp"], "--speed"),
        (&["--link", "x", "--nonsense"], "--nonsense"),
        (&["replay", taken], "--layer"),
    ] {
        let output = run(args);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{args:?}: {message}");
        assert!(message.contains(part), "{args:?}: {message}");
        assert!(output.stdout.is_empty());
    }
    assert!(!Path::new("x").exists());
    let missing = run(&["replay", taken, "--layer", "0", "--out", "x.png"]);
    assert_eq!(missing.status.code(), Some(1));
}

#[test]
fn help_names_every_fault() {
    let help = String::from_utf8(run(&["--help"]).stdout).unwrap();
    for kind in ["bit-error", "wrong-resend", "disconnect", "sensor-open", "layer-shift", "filament-out"] {
        assert!(help.contains(kind), "{kind}");
    }
}
