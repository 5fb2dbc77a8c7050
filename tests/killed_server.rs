//! The server is killed (`kill -9`) at moments that nobody chose, again and again, while it prepares, starts, prints and ends: as
//! processes, on a real pseudo-terminal and a real disk. No job is lost, none is printed twice, the history holds.

#![expect(clippy::unwrap_used, reason = "what fails in a test's own preparations fails the test")]
#![expect(clippy::print_stdout, reason = "what was measured is shown with --nocapture")]

#[path = "shared/rings.rs"]
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

/// Rings, one on the other. Its end leaves the filament where it is, so that the next job on this printer begins at once.
fn job_text() -> String {
    let profile = profile::builtin(PROFILE).unwrap();
    let end = ["M400", "M104 S0", "M140 S0"].map(str::to_owned);
    rings::job(
        &profile.start_gcode(),
        Rings { n_layers: N_LAYERS, n_sides: N_SIDES, filament_mm: 0.06 },
        &end,
    )
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
        fs::write(dir.path().join("job.gcode"), job_text()).unwrap();
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
        Command::new(env!("CARGO_BIN_EXE_lumenfab"))
            .args(["serve", "--state", "state"])
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
        let path = self.path("job.gcode").to_str().unwrap().to_owned();
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

    fn n_beads(&mut self) -> usize {
        Command::new("kill").arg(self.printer.id().to_string()).status().unwrap();
        self.printer.wait().unwrap();
        fs::read_to_string(self.path("record/beads.csv")).unwrap().lines().count() - 1
    }

    fn log(&self) -> String {
        fs::read_to_string(self.path("log")).unwrap_or_default()
    }
}

/// What became of the jobs, by the history, which has to hold.
async fn check(bench: &mut Bench, ids: &[JobId]) -> (usize, usize) {
    let store = Sqlite::open(&bench.path("state/queue.db")).unwrap();
    store.verify().await.unwrap();
    let (mut n_finished, mut n_laid) = (0, 0);
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
        assert!(n("\"change\":\"lay\"") <= 1, "{id} was laid twice: {texts:#?}");
        n_laid += n("\"change\":\"lay\"");
        n_finished += usize::from(job.state == State::Finished);
        if job.state == State::Failed {
            println!("{id}: {}", records.last().unwrap().record().unwrap().fact.why);
        }
        assert_eq!(n("\"printed\""), usize::from(job.state == State::Finished), "{texts:#?}");
    }
    store.close().await;
    let n_beads = bench.n_beads();
    let possible = n_finished * N_BEADS..=n_laid * N_BEADS;
    assert!(possible.contains(&n_beads), "{n_beads} beads, expected {possible:?}");
    (n_finished, n_laid)
}

async fn dies(n_deaths: usize, n_jobs: usize, seed: u64) {
    let mut bench = Bench::new(seed).await;
    let id = |n: usize| {
        let [.., a, b] = n.to_be_bytes();
        JobId::at(jiff::Timestamp::UNIX_EPOCH, [0, 0, 0, 0, 0, 0, 0, 0, a, b])
    };
    let ids: Vec<_> = (0..n_jobs).map(id).collect();
    assert_eq!(ids.iter().collect::<BTreeSet<_>>().len(), n_jobs);
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
    assert!(bench.operate_until(&ids, Instant::now() + PATIENCE).await, "{}", bench.log());
    Command::new("kill").arg(server.id().to_string()).status().unwrap();
    let ended = timeout(PATIENCE, async {
        loop {
            if let Some(status) = server.try_wait().unwrap() {
                return status;
            }
            sleep(Duration::from_millis(20)).await;
        }
    });
    assert!(ended.await.unwrap().success(), "{}", bench.log());
    let (n_finished, n_laid) = check(&mut bench, &ids).await;
    println!(
        "{n_killed} deaths, {n_jobs} jobs: {n_finished} printed, {} begun and given up, {} never begun",
        n_laid - n_finished,
        n_jobs - n_laid
    );
    assert!(n_killed >= n_deaths.min(3), "the jobs ended before the server could be killed");
    assert!(n_finished > 0);
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
