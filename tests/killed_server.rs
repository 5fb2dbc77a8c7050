//! The server is killed (`kill -9`) at moments that nobody chose, again and again, while it prepares, starts, prints and ends; or it may
//! write nothing for a while, or another program keeps the queue to itself: as processes, on a real pseudo-terminal and a real disk. No job
//! is lost, none is printed twice, the history holds.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]
#![expect(clippy::print_stdout, reason = "what was measured is shown with --nocapture")]

#[path = "shared/rings.rs"]
#[allow(dead_code, reason = "other tests lay their rings in the middle")]
mod rings;

use lumenfab::client::Client;
use lumenfab::http::wire::{Added, Anew, BedClear, BedView, JobView, Turn, WishesBody};
use lumenfab::profile;
use lumenfab::queue::{JobId, Name, Reason, State, Subject};
use lumenfab::store::{Sqlite, Store, Which};
use rings::Rings;
use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use tempfile::TempDir;
use tokio::time::{Instant, sleep, timeout};

const PROFILE: &str = "reference";
const N_LAYERS: u32 = 20;
const N_SIDES: u32 = 32;
/// Beads of a job that was printed.
const N_BEADS: usize = (N_LAYERS * N_SIDES) as usize;
const PATIENCE: Duration = Duration::from_secs(120);
/// The same for each of many jobs.
const A_JOB: Duration = Duration::from_secs(20);

/// Each job has a cell of the bed for itself, so that its beads are told from those of all others, mm; the first one is here.
const CELL_MM: f64 = 6.0;
const FIRST_MM: f64 = 20.0;
const CELLS_IN_A_ROW: usize = 26;
const RADIUS_MM: f64 = 2.0;

/// Rings, one on the other, in the cell of a job. Its end leaves the filament where it is, so that the next job on this printer
/// begins at once.
fn job_text(number: usize) -> String {
    let profile = profile::builtin(PROFILE).unwrap();
    let end = ["M400", "M104 S0", "M140 S0"].map(str::to_owned);
    let middle = |cell: usize| (cell as f64 + 0.5).mul_add(CELL_MM, FIRST_MM);
    let rings = Rings { n_layers: N_LAYERS, n_sides: N_SIDES, filament_mm: 0.012 };
    let centre_mm = [middle(number % CELLS_IN_A_ROW), middle(number / CELLS_IN_A_ROW)];
    rings::job_around(centre_mm, RADIUS_MM, &profile.start_gcode(), rings, &end)
}

/// Whose cell the end of a bead lies in.
fn job_of(line: &str) -> usize {
    let place: Vec<f64> = line.split(',').skip(4).take(2).map(|number| number.parse().unwrap()).collect();
    let cell = |mm: f64| (0..).find(|n| mm < CELL_MM.mul_add(f64::from(n + 1), FIRST_MM)).unwrap_or(0_u16);
    assert!(place[0] >= FIRST_MM && place[1] >= FIRST_MM, "{line}");
    usize::from(cell(place[1])) * CELLS_IN_A_ROW + usize::from(cell(place[0]))
}

/// A state directory with a printer that outlives every server.
struct Bench {
    dir: TempDir,
    printer: Child,
    client: Client,
    random: u64,
    n_added: usize,
}

impl Bench {
    async fn new(seed: u64) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let (state, port) = (dir.path().join("state"), dir.path().join("port"));
        fs::create_dir(&state).unwrap();
        let config = format!(
            "[[printer]]\nname = \"left\"\nprofile = {PROFILE:?}\nport = {port:?}\nbed_trusted_s = 3600\n"
        );
        fs::write(state.join("config.toml"), config).unwrap();
        let printer = Command::new(env!("CARGO_BIN_EXE_lumenfab"))
            .args(["hil-sim", "--profile", PROFILE, "--speed", "max", "--link", "port", "--record", "record"])
            .current_dir(dir.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let start = Instant::now();
        while !port.exists() {
            assert!(start.elapsed() < PATIENCE, "the printer does not start");
            sleep(Duration::from_millis(5)).await;
        }
        let client = Client::over_socket(state.join("lumenfab.sock"));
        Self { dir, printer, client, random: seed, n_added: 0 }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn server(&self) -> Child {
        // A write beyond the limit is an error to it, not its end.
        let start = "trap '' XFSZ; exec \"$0\" serve --state state";
        Command::new("sh")
            .args(["-c", start, env!("CARGO_BIN_EXE_lumenfab")])
            .current_dir(self.dir.path())
            .stdout(Stdio::null())
            .stderr(fs::File::options().create(true).append(true).open(self.path("log")).unwrap())
            .spawn()
            .unwrap()
    }

    fn random_ms(&mut self, most: u64) -> Duration {
        self.random =
            self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        Duration::from_millis((self.random >> 33) % most)
    }

    /// Adds the next job, once more where it is not known to be done: its id is the caller's, so that it is added once.
    async fn add(&mut self, ids: &[JobId]) {
        let Some(id) = ids.get(self.n_added) else { return };
        let path = self.path(&format!("job{}.gcode", self.n_added));
        fs::write(&path, job_text(self.n_added)).unwrap();
        let path = path.to_str().unwrap().to_owned();
        let (wishes, why) = (WishesBody::default(), Reason::default());
        let added = self.client.add(&Added { path, id: Some(*id), wishes, submit: true, why }).await;
        self.n_added += usize::from(added.is_ok());
    }

    /// What an operator does: takes parts off, lets prints go on that broke off. Gives the jobs that are not over; `None` where the server is gone.
    async fn operate(&self) -> Option<Vec<JobView>> {
        let left = self.client.printer(&Name::try_new("left").unwrap()).await.ok()?;
        let jobs = self.client.jobs(Which::Live, None, 500).await.ok()?.jobs;
        let is_at_printer = jobs.iter().any(|job| matches!(job.state, State::Printing | State::Paused));
        if left.bed != BedView::Clear && !is_at_printer {
            let on_bed = match left.bed {
                BedView::Taken(job) => Some(job),
                BedView::Clear | BedView::Unknown => None,
            };
            let word = BedClear { on_bed, name: None, why: Reason::default() };
            // Refused where something has changed in between: it is looked at again.
            self.client.clear_bed(&left.name, &word).await.ok();
        }
        for job in jobs.iter().filter(|job| job.state == State::Paused) {
            let go_on = Anew { turn: Turn::GoOn, saw: None, name: None, why: Reason::default() };
            self.client.change(job.id, &go_on).await.ok();
        }
        Some(jobs)
    }

    /// Adds and operates until no job is left, or until the time is over; whether none is left.
    async fn operate_until(&mut self, ids: &[JobId], end: Instant) -> bool {
        while Instant::now() < end {
            self.add(ids).await;
            let jobs = self.operate().await;
            if self.n_added == ids.len() && jobs.is_some_and(|jobs| jobs.is_empty()) {
                return true;
            }
            sleep(Duration::from_millis(20)).await;
        }
        false
    }

    /// Lets all jobs come to their end, and the server after them.
    async fn work_off(&mut self, ids: &[JobId], server: &mut Child) {
        let longest = PATIENCE.max(A_JOB * u32::try_from(ids.len()).unwrap());
        assert!(self.operate_until(ids, Instant::now() + longest).await, "{}", self.log());
        Command::new("kill").arg(server.id().to_string()).status().unwrap();
        let ended = timeout(PATIENCE, async {
            loop {
                if let Some(status) = server.try_wait().unwrap() {
                    return status;
                }
                sleep(Duration::from_millis(20)).await;
            }
        });
        assert!(ended.await.unwrap().success(), "{}", self.log());
    }

    /// How many beads each job has laid.
    fn beads(&mut self, n_jobs: usize) -> Vec<usize> {
        Command::new("kill").arg(self.printer.id().to_string()).status().unwrap();
        self.printer.wait().unwrap();
        let mut n_beads = vec![0; n_jobs];
        for line in fs::read_to_string(self.path("record/beads.csv")).unwrap().lines().skip(1) {
            n_beads[job_of(line)] += 1;
        }
        n_beads
    }

    fn log(&self) -> String {
        fs::read_to_string(self.path("log")).unwrap_or_default()
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        // It has ended already where all went well.
        self.printer.kill().ok();
    }
}

/// What became of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    Printed,
    /// Begun, and given up.
    Broken,
    /// Failed before anything was laid.
    Unlaid,
}

/// What became of the jobs, by the history, which has to hold; each has laid what that says, and nothing twice.
async fn check(bench: &mut Bench, ids: &[JobId]) -> Vec<End> {
    let store = Sqlite::open(&bench.path("state/queue.db")).unwrap();
    store.verify().await.unwrap();
    let mut ends = Vec::new();
    for id in ids {
        let (job, _) = store.job(*id).await.unwrap();
        assert!(
            matches!(job.state, State::Finished | State::Failed),
            "{id} is {}\n{}",
            job.state,
            bench.log()
        );
        let records = store.history(Some(Subject::Job(*id)), 0, 1000).await.unwrap();
        let texts: Vec<_> =
            records.iter().map(|r| serde_json::to_string(&r.record().unwrap().fact.what).unwrap()).collect();
        let n = |change: &str| texts.iter().filter(|text| text.contains(change)).count();
        let is_finished = job.state == State::Finished;
        assert!(n("\"change\":\"lay\"") <= 1, "{id} was laid twice: {texts:#?}");
        assert_eq!(n("\"printed\""), usize::from(is_finished), "{texts:#?}");
        if !is_finished {
            println!("{id}: {}", records.last().unwrap().record().unwrap().fact.why);
        }
        ends.push(match n("\"change\":\"lay\"") {
            _ if is_finished => End::Printed,
            0 => End::Unlaid,
            _ => End::Broken,
        });
    }
    store.close().await;
    for ((end, n_beads), id) in ends.iter().zip(bench.beads(ids.len())).zip(ids) {
        let possible = match end {
            End::Printed => N_BEADS..=N_BEADS,
            End::Broken => 0..=N_BEADS,
            End::Unlaid => 0..=0,
        };
        assert!(possible.contains(&n_beads), "{id} ({end:?}) has {n_beads} beads, expected {possible:?}");
    }
    ends
}

fn ids(n_jobs: usize) -> Vec<JobId> {
    let id = |n: usize| {
        let [.., a, b] = n.to_be_bytes();
        JobId::at(jiff::Timestamp::UNIX_EPOCH, [0, 0, 0, 0, 0, 0, 0, 0, a, b])
    };
    let ids: Vec<_> = (0..n_jobs).map(id).collect();
    assert_eq!(ids.iter().collect::<BTreeSet<_>>().len(), n_jobs);
    ids
}

/// What is said of the ends of jobs.
fn told(ends: &[End]) -> String {
    let n = |end: End| ends.iter().filter(|found| **found == end).count();
    let (n_printed, n_broken, n_unlaid) = (n(End::Printed), n(End::Broken), n(End::Unlaid));
    format!("{} jobs: {n_printed} printed, {n_broken} begun and given up, {n_unlaid} never begun", ends.len())
}

async fn dies(n_deaths: usize, n_jobs: usize, seed: u64) {
    let mut bench = Bench::new(seed).await;
    let ids = ids(n_jobs);
    let mut n_killed = 0;
    while n_killed < n_deaths {
        let mut server = bench.server();
        let life = bench.random_ms(1500);
        let is_done = bench.operate_until(&ids, Instant::now() + life).await;
        server.kill().unwrap();
        server.wait().unwrap();
        if is_done {
            break;
        }
        n_killed += 1;
    }
    let mut server = bench.server();
    bench.work_off(&ids, &mut server).await;
    let ends = check(&mut bench, &ids).await;
    println!("{n_killed} deaths, {}", told(&ends));
    let n_printed = ends.iter().filter(|end| **end == End::Printed).count();
    assert!(n_killed >= n_deaths.min(3), "the jobs ended before the server could be killed");
    // Deaths may cost jobs: whose holders died in the middle of it again and again, and what cannot be gone on with.
    assert!(2 * n_printed >= n_jobs, "{ends:?}");
}

#[tokio::test]
async fn a_killed_server_loses_no_job_and_prints_none_twice() {
    dies(8, 8, 1).await;
}

/// `cargo test --release --test killed_server -- --ignored --nocapture`
#[tokio::test]
#[ignore = "takes half an hour; the sample above is always run"]
async fn five_hundred_deaths() {
    dies(500, 500, 2).await;
}

/// The server may write nothing, as on a disk that is full or for reading alone; or so it is no more.
fn limit_writes(server: &Child, to: &str) {
    let (pid, limit) = (server.id().to_string(), format!("--fsize={to}:unlimited"));
    assert!(Command::new("prlimit").args(["--pid", &pid, &limit]).status().unwrap().success());
}

async fn starves(n_troubles: usize, n_jobs: usize, seed: u64) {
    let mut bench = Bench::new(seed).await;
    let ids = ids(n_jobs);
    let mut server = bench.server();
    let start = Instant::now();
    while bench.client.health().await.is_err() {
        assert!(start.elapsed() < PATIENCE, "{}", bench.log());
        sleep(Duration::from_millis(20)).await;
    }
    let mut n_done = 0;
    while n_done < n_troubles {
        let between = bench.random_ms(1500);
        if bench.operate_until(&ids, Instant::now() + between).await {
            break;
        }
        let long = bench.random_ms(7000);
        if n_done.is_multiple_of(2) {
            limit_writes(&server, "0");
            bench.operate_until(&ids, Instant::now() + long).await;
            limit_writes(&server, "unlimited");
        } else if let Ok(db) = rusqlite::Connection::open(bench.path("state/queue.db"))
            && db.execute_batch("BEGIN IMMEDIATE").is_ok()
        {
            bench.operate_until(&ids, Instant::now() + long).await;
        }
        n_done += 1;
        assert_eq!(server.try_wait().unwrap(), None, "{}", bench.log());
    }
    bench.work_off(&ids, &mut server).await;
    let ends = check(&mut bench, &ids).await;
    println!("{n_done} troubles, {}", told(&ends));
    assert!(n_done >= n_troubles.min(3), "the jobs ended before there could be trouble");
    assert_eq!(ends, vec![End::Printed; n_jobs], "{}", bench.log());
}

#[tokio::test]
async fn a_server_that_may_not_write_for_a_while_loses_no_job_and_prints_none_twice() {
    starves(6, 6, 3).await;
}
