//! What the server costs and how fast it answers: figures that are measured, shown and judged. As a process, on a real socket, with the
//! simulated printer at its real speed.
//!
//! `cargo test --release --test appliance_figures -- --ignored --nocapture --test-threads 1`, on a machine that does nothing else.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]
#![expect(clippy::print_stdout, reason = "what was measured is shown with --nocapture")]

#[path = "shared/rings.rs"]
mod rings;

use lumenfab::client::Client;
use lumenfab::http::wire::{Added, BedClear, BedView, WishesBody};
use lumenfab::profile;
use lumenfab::queue::{JobId, Name, Reason, State};
use rings::Rings;
use std::fs;
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::time::Duration;
use tempfile::TempDir;
use tokio::time::{Instant, sleep};

const PROFILE: &str = "reference";
const PATIENCE: Duration = Duration::from_secs(300);
/// What is promised.
const START: Duration = Duration::from_millis(300);
const IDLE_KB: u64 = 40 * 1024;
const P99: Duration = Duration::from_millis(5);
/// Readers of events, and clients that ask without a rest, while a print goes on.
const N_STREAMS: usize = 100;
const N_FLOODING: usize = 8;

/// A state directory, a printer and a server, all of them processes.
struct Bench {
    dir: TempDir,
    printer: Child,
    server: Child,
    client: Client,
    started: Duration,
}

impl Bench {
    async fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let (state, port) = (dir.path().join("state"), dir.path().join("port"));
        fs::create_dir(&state).unwrap();
        let config = format!("[[printer]]\nname = \"left\"\nprofile = {PROFILE:?}\nport = {port:?}\n");
        fs::write(state.join("config.toml"), config).unwrap();
        let printer = program(&dir)
            .args([
                "hil-sim",
                "--profile",
                PROFILE,
                "--speed",
                "realtime",
                "--link",
                "port",
                "--record",
                "record",
            ])
            .spawn()
            .unwrap();
        until("the printer", async || port.exists()).await;
        let (server, started) = started(&dir);
        let client = Client::over_socket(state.join("lumenfab.sock"));
        Self { dir, printer, server, client, started }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// A job of rings that is in print, at its first beads.
    async fn in_print(&self, n_layers: u32) -> JobId {
        let profile = profile::builtin(PROFILE).unwrap();
        let rings = Rings { n_layers, n_sides: 64, filament_mm: 0.03 };
        let text = rings::job(&profile.start_gcode(), rings, &["M400".to_owned()]);
        let path = self.path("job.gcode");
        fs::write(&path, text).unwrap();
        let word = BedClear { on_bed: None, name: None, why: Reason::default() };
        let left = Name::try_new("left").unwrap();
        if self.client.printer(&left).await.unwrap().bed != BedView::Clear {
            self.client.clear_bed(&left, &word).await.unwrap();
        }
        let path = path.to_str().unwrap().to_owned();
        let (wishes, why) = (WishesBody::default(), Reason::default());
        let id = self.client.add(&Added { path, id: None, wishes, submit: true, why }).await.unwrap().id;
        until("the first beads", async || self.client.job(id).await.unwrap().is_laid).await;
        id
    }

    /// What the printer's own record says, once all has ended.
    fn end(mut self) -> serde_json::Value {
        for child in [&mut self.server, &mut self.printer] {
            Command::new("kill").arg(child.id().to_string()).status().unwrap();
            child.wait().unwrap();
        }
        serde_json::from_str(&fs::read_to_string(self.path("record/summary.json")).unwrap()).unwrap()
    }
}

fn program(dir: &TempDir) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lumenfab"));
    command.current_dir(dir.path()).stdout(Stdio::null()).stderr(Stdio::null());
    command
}

/// A server, and the time from its start until it has told the service manager that it is ready.
fn started(dir: &TempDir) -> (Child, Duration) {
    let path = dir.path().join("notify");
    fs::remove_file(&path).ok();
    let manager = UnixDatagram::bind(&path).unwrap();
    manager.set_read_timeout(Some(PATIENCE)).unwrap();
    let start = Instant::now();
    let server =
        program(dir).args(["serve", "--state", "state"]).env("NOTIFY_SOCKET", &path).spawn().unwrap();
    while !is_ready(&manager) {}
    (server, start.elapsed())
}

/// Whether the next word says so.
fn is_ready(manager: &UnixDatagram) -> bool {
    let mut bytes = [0; 4096];
    let n_bytes = manager.recv(&mut bytes).unwrap();
    bytes[..n_bytes].starts_with(b"READY=1")
}

async fn until(what: &str, mut is_true: impl AsyncFnMut() -> bool) {
    let start = Instant::now();
    while !is_true().await {
        assert!(start.elapsed() < PATIENCE, "waited in vain for {what}");
        sleep(Duration::from_millis(5)).await;
    }
}

fn resident_kb(pid: u32) -> u64 {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.trim().trim_end_matches(" kB").parse().unwrap()
}

/// How long requests take, one after the other, the longest last.
async fn latencies(client: &Client, n_requests: usize) -> Vec<Duration> {
    let mut all = Vec::with_capacity(n_requests);
    for number in 0..n_requests {
        let start = Instant::now();
        if number % 2 == 0 {
            client.status().await.unwrap();
        } else {
            client.jobs(lumenfab::store::Which::Live, None, 100).await.unwrap();
        }
        all.push(start.elapsed());
    }
    all.sort();
    all
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "its figures are of a machine that does nothing else"]
async fn the_server_starts_soon_is_small_and_answers_soon_while_it_prints() {
    let bench = Bench::new().await;
    sleep(Duration::from_secs(5)).await;
    let idle_kb = resident_kb(bench.server.id());
    println!(
        "start to ready {:.0} ms; idle {:.1} MB",
        1e3 * bench.started.as_secs_f64(),
        idle_kb as f64 / 1024.0
    );
    bench.in_print(50).await;
    let all = latencies(&bench.client, 2000).await;
    let at = |per_cent: usize| 1e3 * all[(all.len() - 1) * per_cent / 100].as_secs_f64();
    println!(
        "while printing: p50 {:.2} ms, p99 {:.2} ms, longest {:.2} ms of {} requests",
        at(50),
        at(99),
        at(100),
        all.len()
    );
    let started = bench.started;
    bench.end();
    assert!(started <= START, "it took {started:?} to be ready, {START:?} are promised");
    assert!(idle_kb <= IDLE_KB, "{idle_kb} kB are resident, {IDLE_KB} are promised");
    assert!(at(99) <= 1e3 * P99.as_secs_f64(), "p99 is {:.2} ms, {P99:?} are promised", at(99));
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "takes minutes, at the printer's real speed"]
async fn a_hundred_streams_and_a_flood_of_requests_leave_the_print_undisturbed() {
    let bench = Bench::new().await;
    let id = bench.in_print(12).await;
    let is_over = Arc::new(AtomicBool::new(false));
    let (n_events, n_requests) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
    let mut tasks = tokio::task::JoinSet::new();
    for _ in 0..N_STREAMS {
        let (mut events, count) = (bench.client.events(None), Arc::clone(&n_events));
        tasks.spawn(async move {
            loop {
                if events.next().await.is_ok() {
                    count.fetch_add(1, Relaxed);
                }
            }
        });
    }
    for _ in 0..N_FLOODING {
        let (client, count, is_over) = (bench.client.clone(), Arc::clone(&n_requests), Arc::clone(&is_over));
        tasks.spawn(async move {
            while !is_over.load(Relaxed) {
                // What is refused counts, too: it was asked.
                client.status().await.ok();
                count.fetch_add(1, Relaxed);
            }
        });
    }
    until("the end of the print", async || {
        sleep(Duration::from_millis(500)).await;
        bench.client.job(id).await.is_ok_and(|job| job.state == State::AwaitingBedClear)
    })
    .await;
    is_over.store(true, Relaxed);
    tasks.abort_all();
    let (n_events, n_requests) = (n_events.load(Relaxed), n_requests.load(Relaxed));
    let summary = bench.end();
    let (dry, dry_s) = (&summary["planner_dry"], &summary["planner_dry_s"]);
    println!(
        "{n_events} events to {N_STREAMS} streams, {n_requests} requests; planner dry {dry} times, {dry_s} s"
    );
    assert!(n_events > N_STREAMS as u64 && n_requests > 100, "it was no flood");
    assert_eq!((dry.as_u64(), dry_s.as_f64()), (Some(0), Some(0.0)));
}
