//! The terminal UI as a process, in a real pseudo-terminal, against a real server with its simulated printer: keyboard only.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]
#![expect(
    clippy::disallowed_methods,
    reason = "the other end of a terminal: it waits for processes by the clock on the wall"
)]
#![expect(clippy::print_stdout, reason = "what was measured is shown with --nocapture")]

#[path = "shared/rings.rs"]
mod rings;

use portable_pty::{Child, CommandBuilder, MasterPty, PtySize, native_pty_system};
use rings::Rings;
use std::fs;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};
use tempfile::TempDir;

const PATIENCE: Duration = Duration::from_secs(120);
const PROGRAM: &str = env!("CARGO_BIN_EXE_lumenfab");

/// A terminal with a program in it.
struct Screen {
    parser: Arc<Mutex<vt100::Parser>>,
    n_bytes: Arc<AtomicUsize>,
    keys: Box<dyn Write + Send>,
    master: Box<dyn MasterPty + Send>,
    child: Box<dyn Child + Send + Sync>,
    begun: Instant,
}

impl Screen {
    fn open(dir: &Path, size: (u16, u16), args: &[&str]) -> Self {
        let (cols, rows) = size;
        let pair =
            native_pty_system().openpty(PtySize { rows, cols, pixel_width: 0, pixel_height: 0 }).unwrap();
        let mut command = CommandBuilder::new(PROGRAM);
        command.args(["tui", "--state", "state"]);
        command.args(args);
        command.cwd(dir);
        command.env("TERM", "xterm-256color");
        command.env("TZ", "UTC");
        command.env_remove("NO_COLOR");
        let begun = Instant::now();
        let child = pair.slave.spawn_command(command).unwrap();
        drop(pair.slave);
        let parser = Arc::new(Mutex::new(vt100::Parser::new(rows, cols, 0)));
        let n_bytes = Arc::new(AtomicUsize::new(0));
        let mut reader = pair.master.try_clone_reader().unwrap();
        let (seen, counted) = (Arc::clone(&parser), Arc::clone(&n_bytes));
        thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok(n @ 1..) = reader.read(&mut buffer) {
                counted.fetch_add(n, Ordering::Relaxed);
                seen.lock().unwrap().process(&buffer[..n]);
            }
        });
        let keys = pair.master.take_writer().unwrap();
        Self { parser, n_bytes, keys, master: pair.master, child, begun }
    }

    fn text(&self) -> String {
        self.parser.lock().unwrap().screen().contents()
    }

    fn press(&mut self, keys: &str) {
        self.keys.write_all(keys.as_bytes()).unwrap();
        self.keys.flush().unwrap();
        if keys.ends_with('\u{1b}') {
            // What follows at once would be one key with it.
            thread::sleep(Duration::from_millis(300));
        }
    }

    /// Waits until the screen holds a text.
    fn sees(&self, text: &str) {
        self.waits(text, |screen| screen.contains(text));
    }

    fn sees_no(&self, text: &str) {
        self.waits(text, |screen| !screen.contains(text));
    }

    fn waits(&self, what: &str, is_so: impl Fn(&str) -> bool) {
        let start = Instant::now();
        while !is_so(&self.text()) {
            assert!(start.elapsed() < PATIENCE, "{what:?} on\n{}", self.text());
            thread::sleep(Duration::from_millis(5));
        }
    }

    fn resize(&self, cols: u16, rows: u16) {
        self.parser.lock().unwrap().screen_mut().set_size(rows, cols);
        self.master.resize(PtySize { rows, cols, pixel_width: 0, pixel_height: 0 }).unwrap();
    }

    /// Waits until it has ended, and how; the terminal is as it was then.
    fn ended(&mut self) -> u32 {
        let start = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                // What it wrote last is read by the other thread.
                thread::sleep(Duration::from_millis(100));
                let parser = self.parser.lock().unwrap();
                let screen = parser.screen();
                assert!(!screen.alternate_screen() && !screen.hide_cursor(), "the terminal is put back");
                assert_eq!(screen.mouse_protocol_mode(), vt100::MouseProtocolMode::None);
                return status.exit_code();
            }
            assert!(start.elapsed() < PATIENCE, "it does not end:\n{}", self.text());
            thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        self.child.kill().ok();
    }
}

/// A state directory, and what runs there.
struct Bench {
    dir: TempDir,
    server: Option<std::process::Child>,
    /// Whether a screen has started one that outlives it.
    has_orphan: bool,
}

impl Bench {
    /// With a simulated printer that is so fast.
    fn new(speed: &str) -> Self {
        Self::with(|_dir| format!("port = \"sim\"\nsim_speed = {speed:?}"))
    }

    /// With a printer of this configuration, in its directory.
    fn with(printer: impl Fn(&Path) -> String) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let state = dir.path().join("state");
        fs::create_dir(&state).unwrap();
        let printer = printer(dir.path());
        let config = format!("[[printer]]\nname = \"left\"\nprofile = \"reference\"\n{printer}\n");
        fs::write(state.join("config.toml"), config).unwrap();
        Self { dir, server: None, has_orphan: false }
    }

    fn path(&self) -> &Path {
        self.dir.path()
    }

    fn serve(&mut self) {
        let log = fs::File::options().create(true).append(true).open(self.path().join("log")).unwrap();
        let child = Command::new(PROGRAM)
            .args(["serve", "--state", "state"])
            .current_dir(self.path())
            .stdout(Stdio::null())
            .stderr(log)
            .spawn();
        self.server = Some(child.unwrap());
        self.until_served();
    }

    fn until_served(&self) {
        let start = Instant::now();
        while !self.queue(&["list"]).0 {
            assert!(start.elapsed() < PATIENCE, "the server does not start");
            thread::sleep(Duration::from_millis(20));
        }
    }

    fn end_server(&mut self) {
        if let Some(mut server) = self.server.take() {
            server.kill().unwrap();
            server.wait().unwrap();
        }
    }

    /// Ends the server that a screen has started; whether there was one.
    fn end_orphan(&mut self) -> bool {
        let state = self.path().join("state");
        let serves = |pid: &String| {
            let words = fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            let mut words = words.split(|byte| *byte == 0);
            let is_here = fs::canonicalize(format!("/proc/{pid}/cwd")).is_ok_and(|dir| dir == self.path());
            words.clone().any(|word| word == b"serve")
                && (is_here || words.any(|word| word == state.as_os_str().as_encoded_bytes()))
        };
        let names = fs::read_dir("/proc").unwrap().map(|entry| entry.unwrap().file_name());
        let found = names.filter_map(|name| name.into_string().ok()).find(serves);
        std::mem::take(&mut self.has_orphan)
            && found.is_some_and(|pid| Command::new("kill").arg(pid).status().is_ok_and(|s| s.success()))
    }

    /// `lumenfab queue`: whether it worked, and what it said.
    fn queue(&self, args: &[&str]) -> (bool, String) {
        let out = Command::new(PROGRAM)
            .args(["queue", "--state", "state"])
            .args(args)
            .current_dir(self.path())
            .output()
            .unwrap();
        (out.status.success(), String::from_utf8_lossy(&out.stdout).into_owned())
    }

    /// A job of so many layers.
    fn gcode(&self, n_layers: u32) -> PathBuf {
        let profile = lumenfab::profile::builtin("reference").unwrap();
        let end = ["M400", "M104 S0", "M140 S0"].map(str::to_owned);
        let rings = Rings { n_layers, n_sides: 32, filament_mm: 0.06 };
        let path = self.path().join("job.gcode");
        fs::write(&path, rings::job(&profile.start_gcode(), rings, &end)).unwrap();
        path
    }

    fn add(&self, more: &[&str]) {
        let args: Vec<_> = ["add", "job.gcode"].into_iter().chain(more.iter().copied()).collect();
        let (is_added, said) = self.queue(&args);
        assert!(is_added, "{said}");
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.end_orphan();
        if let Some(server) = &mut self.server {
            server.kill().ok();
            server.wait().ok();
        }
    }
}

#[test]
fn from_no_server_to_a_finished_print_by_keyboard_alone() {
    let mut bench = Bench::new("max");
    bench.gcode(20);
    let mut screen = Screen::open(bench.path(), (100, 30), &[]);
    screen.sees("No lumenfab server runs at");
    println!("first words after {:.0} ms", screen.begun.elapsed().as_secs_f64() * 1000.0);
    bench.has_orphan = true;
    screen.press("S");
    screen.sees("● connected");
    screen.sees("Idle");
    screen.sees("Nothing awaits you.");
    bench.add(&["--copies", "2", "--sign-off"]);
    // It is prepared and printed by itself; then somebody has to look at the bed.
    screen.sees("is printed: take it off the bed, then say so");
    // By accident it is not said: Enter alone, or any word, does nothing.
    screen.press("b\r\r");
    screen.sees("type the word clear");
    screen.press("\u{1b}");
    screen.sees_no("type the word clear");
    for copy in ["copy 1 of 2, is printed", "copy 2 of 2, is printed"] {
        screen.sees(copy);
        screen.press("bclear\r\r");
        screen.sees("the bed of left is clear");
    }
    screen.sees("read its report, then accept or reject it");
    screen.press("saccept\rAda\rall planes within the gate\r");
    screen.sees("Nothing awaits you.");
    screen.press("2v");
    screen.sees("finished");
    screen.press("\r");
    screen.sees("all planes within the gate");
    screen.press("q");
    assert_eq!(screen.ended(), 0);
    // What was started goes on without the screen.
    let (is_there, history) = bench.queue(&["history"]);
    assert!(is_there && history.contains("accept") && history.contains("Ada"), "{history}");
    assert!(bench.end_orphan());
}

#[test]
fn a_server_that_dies_and_comes_back_is_said_and_followed() {
    let mut bench = Bench::new("max");
    bench.serve();
    let mut screen = Screen::open(bench.path(), (80, 24), &["--theme", "high-contrast"]);
    screen.sees("● connected");
    bench.end_server();
    screen.sees("no connection since");
    screen.press("p");
    screen.sees("there is no connection to the server");
    bench.serve();
    screen.sees("● connected");
    screen.sees("connected again");
    screen.press("\u{3}");
    assert_eq!(screen.ended(), 0);
}

#[test]
fn a_terminal_of_any_size_is_served_and_given_back_on_a_signal() {
    let mut bench = Bench::new("max");
    bench.serve();
    let mut screen = Screen::open(bench.path(), (80, 24), &[]);
    screen.sees("● connected");
    screen.resize(20, 5);
    screen.sees("20x5: lumenfab");
    screen.resize(200, 60);
    screen.sees("lately");
    let pid = screen.child.process_id().unwrap().to_string();
    assert!(Command::new("kill").args(["-TERM", &pid]).status().unwrap().success());
    assert_eq!(screen.ended(), 0);
}

/// All that simulated printers have recorded below a directory.
fn recorded(dir: &Path) -> String {
    let mut text = String::new();
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            text += &recorded(&path);
        } else if path.ends_with("events.jsonl") {
            text += &fs::read_to_string(path).unwrap();
        }
    }
    text
}

fn until(what: &str, is_so: impl Fn() -> bool) {
    let start = Instant::now();
    while !is_so() {
        assert!(start.elapsed() < PATIENCE, "{what}");
        thread::sleep(Duration::from_millis(20));
    }
}

/// A simulated printer of its own at a port of the bench.
struct Printer(std::process::Child);

impl Printer {
    fn start(bench: &Bench, speed: &str) -> Self {
        let child = Command::new(PROGRAM)
            .args([
                "hil-sim",
                "--profile",
                "reference",
                "--speed",
                speed,
                "--link",
                "port",
                "--record",
                "record",
            ])
            .current_dir(bench.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn();
        let printer = Self(child.unwrap());
        until("the printer's port", || bench.path().join("port").exists());
        printer
    }
}

impl Drop for Printer {
    fn drop(&mut self) {
        self.0.kill().ok();
        self.0.wait().ok();
    }
}

fn at_port(dir: &Path) -> String {
    format!("port = {:?}", dir.join("port"))
}

#[test]
fn one_key_stops_a_print_at_once_and_the_printer_has_the_last_word() {
    let mut bench = Bench::with(at_port);
    let _printer = Printer::start(&bench, "60");
    bench.gcode(400);
    bench.serve();
    bench.add(&[]);
    let mut screen = Screen::open(bench.path(), (80, 24), &[]);
    screen.sees("look whether its bed is clear");
    screen.press("bclear\r\r");
    screen.sees("the bed of left is clear");
    screen.sees("Printing");
    until("the first beads", || recorded(bench.path()).contains("G1 X"));
    // Even while something else is being written.
    screen.press("2x!");
    screen.sees("left has stopped (emergency stop");
    // The printer's own words: that it was asked is not enough.
    screen.press("\u{1b}");
    screen.sees_no("Call job");
    screen.press("1");
    screen.sees("emergency stop by the operator");
    screen.sees("stopped switches its heaters off");
    until("the printer's own record of it", || recorded(bench.path()).contains("order"));
    screen.press("\u{1b}");
    screen.sees_no("has stopped (emergency stop");
    screen.press("q");
    assert_eq!(screen.ended(), 0);
}

#[test]
fn a_printer_is_moved_by_hand() {
    let mut bench = Bench::with(at_port);
    let _printer = Printer::start(&bench, "max");
    bench.serve();
    let mut screen = Screen::open(bench.path(), (100, 30), &[]);
    screen.sees("Idle");
    screen.press("3H");
    screen.sees("G28  taken");
    until("homing", || recorded(bench.path()).contains("G28"));
    screen.press("gM106 S128\r\u{1b}");
    screen.sees("M106 S128  taken");
    until("the fan", || recorded(bench.path()).contains("M106 S128"));
    // Nothing is printing: it is stopped all the same.
    screen.press("!");
    screen.sees("left has stopped (emergency stop");
    screen.press("q");
    assert_eq!(screen.ended(), 0);
}

/// Time that a process has had, s.
fn cpu_s(pid: u32) -> f64 {
    /// Ticks a second of every Linux that is met.
    const TICKS: f64 = 100.0;
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap();
    let fields: Vec<_> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
    (fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap()) / TICKS
}

#[test]
#[ignore = "measures, and adds ten thousand jobs for it: minutes"]
fn what_the_screen_costs() {
    let mut bench = Bench::new("10");
    bench.gcode(1000);
    bench.serve();
    bench.add(&[]);
    let mut screen = Screen::open(bench.path(), (200, 60), &[]);
    screen.sees("Printing");
    let pid = screen.child.process_id().unwrap();
    let mut measured = |what: &str, keys: &str| {
        const SPAN: Duration = Duration::from_secs(20);
        let (bytes, cpu, start) = (screen.n_bytes.load(Ordering::Relaxed), cpu_s(pid), Instant::now());
        let mut n_keys = 0;
        while start.elapsed() < SPAN {
            if let Some(key) = keys.chars().nth(n_keys % keys.len().max(1)) {
                screen.press(&key.to_string());
                n_keys += 1;
            }
            thread::sleep(Duration::from_millis(33));
        }
        let span_s = start.elapsed().as_secs_f64();
        let bytes = (screen.n_bytes.load(Ordering::Relaxed) - bytes) as f64;
        println!(
            "{what}: {:.2} kB/s, {:.1} % of a core, {:.1} keys/s",
            bytes / span_s / 1000.0,
            100.0 * (cpu_s(pid) - cpu) / span_s,
            n_keys as f64 / span_s
        );
    };
    measured("dashboard, a print running", "");
    measured("queue, a key 30 times a second", "2jjjjkkkk");
    let client = lumenfab::client::Client::over_socket(bench.path().join("state/lumenfab.sock"));
    let path = bench.path().join("job.gcode").to_str().unwrap().to_owned();
    fs::write(&path, "G28\nG1 X1 E1\n").unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let start = Instant::now();
    runtime.block_on(async {
        for _ in 0..10_000 {
            let added = lumenfab::http::wire::Added {
                path: path.clone(),
                id: None,
                wishes: Default::default(),
                submit: false,
                why: Default::default(),
            };
            client.add(&added).await.unwrap();
        }
    });
    println!("ten thousand jobs added in {:.0} s", start.elapsed().as_secs_f64());
    measured("queue of 10 000, a key 30 times a second", "2jjjjGgkkkk");
    measured("queue of 10 000, nothing pressed", "");
    screen.sees("10001 jobs");
}
