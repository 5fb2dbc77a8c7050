//! The whole server: a real socket, a real queue, real pseudo-terminals with the simulated printer behind them.

mod beds;
mod broken;
mod heat;
mod heaters;
mod limits;
#[path = "../../tests/shared/rings.rs"]
mod rings;
mod stop;

use super::config::{Config, OnStop};
use super::place::{BootClock, Place};
use super::{Error, Setup, serve};
use crate::client::Client;
use crate::http::wire::{Activity, Added, Anew, BedClear, BedView, JobView, Turn, WishesBody};
use crate::profile;
use crate::queue::{JobId, Name, Reason, State};
use crate::store::{Sqlite, Store, Which};
use hil_sim::driver::Config as Simulation;
use hil_sim::printer::Options;
use hil_sim::profile::Profile as Machine;
use hil_sim::scenario::Speed;
use jiff::{SignedDuration, Timestamp};
use rings::Rings;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tempfile::TempDir;
use tokio::sync::watch;
use tokio::task::JoinHandle;

const PROFILE: &str = "reference";
const N_SIDES: u32 = 32;
/// How long a test waits for something, and how often it looks.
const PATIENCE: Duration = Duration::from_secs(120);
const LOOK: Duration = Duration::from_millis(10);

/// Rings, one on the other; each has [`N_SIDES`] beads.
fn rings(n_layers: u32) -> String {
    let profile = profile::builtin(PROFILE).unwrap();
    let end = profile.end_gcode(0.2 * f64::from(n_layers));
    rings::job(&profile.start_gcode(), Rings { n_layers, n_sides: N_SIDES, filament_mm: 0.06 }, &end)
}

/// A simulated printer, on a thread.
struct Simulator {
    stop: Arc<AtomicBool>,
    thread: std::thread::JoinHandle<()>,
    record: PathBuf,
}

impl Simulator {
    async fn start(dir: &Path, speed: Speed) -> Self {
        let (link, record) = (dir.join("port"), dir.join("record"));
        let options = Options {
            profile: Machine::by_name(PROFILE).unwrap(),
            baud: None,
            faults: Vec::new(),
            seed: 0,
            record_commands: true,
        };
        let config =
            Simulation { options, link: link.clone(), record: Some(record.clone()), speed, once: false };
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let run = move || drop(hil_sim::driver::run(config, &stopped, |_pty| {}).unwrap());
        let thread = std::thread::spawn(run);
        until("the printer's port", async || link.exists()).await;
        Self { stop, thread, record }
    }

    /// Rows of beads that it has laid so far, as far as they are written.
    fn beads(&self) -> Vec<String> {
        let text = std::fs::read_to_string(self.record.join("beads.csv")).unwrap_or_default();
        text.lines().skip(1).map(str::to_owned).collect()
    }

    fn has_done(&self, command: &str) -> bool {
        std::fs::read_to_string(self.record.join("events.jsonl")).unwrap_or_default().contains(command)
    }

    /// All beads that it has laid, where they are and how much: without times and temperatures.
    fn end(self) -> Vec<String> {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap();
        let text = std::fs::read_to_string(self.record.join("beads.csv")).unwrap();
        let row = |line: &str| line.split(',').skip(1).take(9).collect::<Vec<_>>().join(",");
        text.lines().skip(1).map(row).collect()
    }
}

/// A state directory, and the server that lives there.
struct Site {
    dir: TempDir,
    stop: watch::Sender<Option<OnStop>>,
    served: JoinHandle<Result<(), Error>>,
    client: Client,
}

impl Site {
    /// A server with a printer at the port in its directory.
    async fn open(dir: TempDir, more: &str) -> Self {
        let port = dir.path().join("port");
        let config = format!(
            "[[printer]]\nname = \"left\"\nprofile = {PROFILE:?}\nport = {port:?}\nbed_trusted_s = 3600\n{more}\n"
        );
        Self::with(dir, &config, "/nonexistent/lumenfab".into()).await
    }

    async fn with(dir: TempDir, config: &str, program: PathBuf) -> Self {
        let config = Config::parse(config, "config.toml").unwrap();
        Self::by(dir, config, program, (Timestamp::now, BootClock::of_system())).await
    }

    async fn by(
        dir: TempDir,
        config: Config,
        program: PathBuf,
        (clock, boot_clock): (fn() -> Timestamp, BootClock),
    ) -> Self {
        let state = dir.path().join("state");
        let place = Place::open(&state).unwrap();
        let client = Client::over_socket(place.layout().socket());
        let (stop, stopping) = watch::channel(None);
        let setup = Setup { place, config, program, clock, boot_clock };
        let served = tokio::spawn(serve(setup, stopping));
        until("the server", async || client.health().await.is_ok() || served.is_finished()).await;
        Self { dir, stop, served, client }
    }

    async fn add(&self, gcode: &str, wishes: WishesBody) -> JobId {
        let path = self.dir.path().join("MEIER.gcode");
        std::fs::write(&path, gcode).unwrap();
        self.add_file(&path, wishes).await
    }

    async fn add_file(&self, path: &Path, wishes: WishesBody) -> JobId {
        let path = path.to_str().unwrap().to_owned();
        let added = Added { path, id: None, wishes, submit: true, why: Reason::default() };
        self.client.add(&added).await.unwrap().id
    }

    async fn job(&self, id: JobId) -> JobView {
        self.client.job(id).await.unwrap()
    }

    async fn is_at(&self, id: JobId, state: State) {
        until(&format!("{state} of the job"), async || {
            let found = self.job(id).await.state;
            let is_hopeless = matches!(found, State::Failed | State::Cancelled) && found != state;
            assert!(!is_hopeless, "the job is {found}: {:?}", self.told(id).await);
            found == state
        })
        .await;
    }

    async fn ask(&self, id: JobId, turn: Turn) {
        let name = Name::try_new("Ada").ok();
        self.client.change(id, &Anew { turn, saw: None, name, why: Reason::default() }).await.unwrap();
    }

    /// The bed is clear, whatever the queue knows to lie there.
    async fn clear(&self) {
        let printer = self.client.printer(&name("left")).await.unwrap();
        let on_bed = match printer.bed {
            BedView::Taken(job) => Some(job),
            BedView::Clear | BedView::Unknown => None,
        };
        let word = BedClear { on_bed, name: None, why: Reason::default() };
        self.client.clear_bed(&printer.name, &word).await.unwrap();
    }

    async fn bed(&self) -> BedView {
        self.client.printer(&name("left")).await.unwrap().bed
    }

    async fn says(&self) -> (Activity, String) {
        let live = self.client.printer(&name("left")).await.unwrap().live.unwrap();
        (live.activity, live.says.unwrap_or_default())
    }

    /// Changes of a job with their reasons, in order.
    async fn told(&self, id: JobId) -> Vec<String> {
        let records = self.client.history_of(id, 0, 500).await.unwrap().records;
        let word = |what: serde_json::Value| match &what["job"]["change"] {
            serde_json::Value::String(word) => word.clone(),
            serde_json::Value::Object(change) => change.keys().next().cloned().unwrap_or_default(),
            _ => "added".to_owned(),
        };
        let line = |why: &Reason| if why.is_empty() { String::new() } else { format!(": {why}") };
        records
            .into_iter()
            .map(|r| format!("{}{}", word(serde_json::to_value(&r.what).unwrap()), line(&r.why)))
            .collect()
    }

    /// The changes alone.
    async fn changes(&self, id: JobId) -> String {
        let told = self.told(id).await;
        told.iter().map(|line| line.split(':').next().unwrap()).collect::<Vec<_>>().join(" ")
    }

    /// Ends it so, and waits until it has; its directory is left.
    async fn end(self, how: OnStop) -> TempDir {
        self.stop.send_replace(Some(how));
        tokio::time::timeout(PATIENCE, self.served).await.unwrap().unwrap().unwrap();
        self.dir
    }

    /// All at once, as a signal that cannot be caught would, but for the thread of the print: it sees to the heaters.
    async fn die(self) -> TempDir {
        self.served.abort();
        self.served.await.unwrap_err();
        self.dir
    }
}

fn name(text: &str) -> Name {
    Name::try_new(text).unwrap()
}

async fn until(what: &str, mut is_true: impl AsyncFnMut() -> bool) {
    let waited = async {
        while !is_true().await {
            tokio::time::sleep(LOOK).await;
        }
    };
    assert!(tokio::time::timeout(PATIENCE, waited).await.is_ok(), "waited in vain for {what}");
}

/// A printer, and a server that knows its bed to be clear.
async fn cleared(speed: Speed, more: &str) -> (Simulator, Site) {
    let dir = tempfile::tempdir().unwrap();
    let printer = Simulator::start(dir.path(), speed).await;
    let site = Site::open(dir, more).await;
    site.clear().await;
    (printer, site)
}

fn n_beads(n_layers: u32) -> usize {
    (n_layers * N_SIDES) as usize
}

#[tokio::test(flavor = "multi_thread")]
async fn nothing_starts_on_a_bed_that_nobody_has_cleared_and_each_copy_waits_for_it() {
    let dir = tempfile::tempdir().unwrap();
    let printer = Simulator::start(dir.path(), Speed::Max).await;
    let site = Site::open(dir, "").await;
    let id = site.add(&rings(3), WishesBody { copies: 2, ..WishesBody::default() }).await;
    until("its preparation", async || site.job(id).await.is_prepared).await;
    let next = async || site.client.schedule().await.unwrap().next[0].why_not.clone().unwrap_or_default();
    assert!(next().await.contains("whether the bed of left is clear is not known"), "{}", next().await);
    tokio::time::sleep(Duration::from_secs(2)).await;
    assert_eq!((site.job(id).await.state, printer.has_done("M109")), (State::Queued, false));
    for n_printed in 1..=2 {
        site.clear().await;
        site.is_at(id, State::AwaitingBedClear).await;
        assert_eq!(site.job(id).await.n_printed, n_printed);
    }
    assert!(next().await.contains("take the part off"), "{}", next().await);
    site.clear().await;
    site.is_at(id, State::Finished).await;
    let expected = "added submit prepare prepared start lay printed next-copy start lay printed complete";
    assert_eq!(site.changes(id).await, expected);
    let metrics = site.client.status().await.unwrap();
    assert_eq!(metrics.printers[0].bed, BedView::Clear);
    let _dir = site.end(OnStop::Finish).await;
    // The end of a print draws filament back; this profile has no prime line that would push it forward again before the next one.
    let n_laid = printer.end().len();
    assert!((n_beads(3) + n_beads(2) - 1..=2 * n_beads(3)).contains(&n_laid), "{n_laid}");
}

/// Another program that keeps the queue to itself, so that nothing can be recorded.
fn locked(dir: &Path) -> rusqlite::Connection {
    let db = rusqlite::Connection::open(dir.join("state/queue.db")).unwrap();
    db.busy_timeout(PATIENCE).unwrap();
    db.execute_batch("BEGIN IMMEDIATE").unwrap();
    db
}

#[tokio::test(flavor = "multi_thread")]
async fn no_bead_is_laid_before_the_queue_has_recorded_it() {
    let dir = tempfile::tempdir().unwrap();
    // Slow enough that it heats for seconds.
    let printer = Simulator::start(dir.path(), Speed::Times(20.0)).await;
    let site = Site::open(dir, "").await;
    site.clear().await;
    let id = site.add(&rings(1), WishesBody::default()).await;
    site.is_at(id, State::Printing).await;
    let lock = locked(site.dir.path());
    assert!(!site.job(id).await.is_laid, "the printer was warm before the queue was locked");
    until("heating", async || printer.has_done("M109")).await;
    tokio::time::sleep(Duration::from_secs(12)).await;
    assert_eq!(printer.beads(), Vec::<String>::new());
    drop(lock);
    site.is_at(id, State::AwaitingBedClear).await;
    let changes = site.changes(id).await;
    assert!(changes.ends_with("start lay printed"), "{changes}");
    let _dir = site.end(OnStop::Finish).await;
    assert_eq!(printer.end().len(), n_beads(1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_print_whose_claim_was_lost_before_it_began_stops_and_is_printed_once() {
    let (printer, site) = cleared(Speed::Times(20.0), "").await;
    let id = site.add(&rings(1), WishesBody::default()).await;
    site.is_at(id, State::Printing).await;
    // Another appliance with a clock ahead, which takes it from one that it has not heard of for too long.
    let other = Sqlite::open(&site.dir.path().join("state/queue.db")).unwrap();
    let ahead = Timestamp::now() + SignedDuration::from_hours(1);
    assert_eq!(other.sweep(ahead).await.unwrap().len(), 1);
    site.is_at(id, State::AwaitingBedClear).await;
    let told = site.told(id).await;
    assert_eq!(told.iter().filter(|change| *change == "lay").count(), 1, "{told:?}");
    assert!(told.iter().any(|change| change.starts_with("give-back")), "{told:?}");
    other.close().await;
    let _dir = site.end(OnStop::Finish).await;
    assert_eq!(printer.end().len(), n_beads(1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_print_pauses_goes_on_and_is_cancelled_as_operators_ask() {
    let (printer, site) = cleared(Speed::Times(60.0), "").await;
    let id = site.add(&rings(400), WishesBody::default()).await;
    until("the first beads", async || printer.beads().len() > N_SIDES as usize).await;
    site.ask(id, Turn::Pause).await;
    site.is_at(id, State::Paused).await;
    until("the printer to say so", async || site.says().await.0 == Activity::Paused).await;
    site.ask(id, Turn::GoOn).await;
    site.is_at(id, State::Printing).await;
    site.ask(id, Turn::Cancel).await;
    site.is_at(id, State::Cancelled).await;
    until("its end", async || site.says().await.0 == Activity::Idle).await;
    assert_eq!(
        site.client.printer(&name("left")).await.unwrap().bed,
        BedView::Taken(id),
        "its remains lie there"
    );
    let user = site.client.whoami().await.unwrap().name;
    let by: Vec<_> =
        site.client.history_of(id, 0, 500).await.unwrap().records.into_iter().map(|r| r.who).collect();
    assert_eq!(by[by.len() - 3..], std::array::from_fn::<_, 3, _>(|_| format!("Ada (by {user})")));
    let _dir = site.end(OnStop::Finish).await;
    let beads = printer.end().len();
    assert!(beads < n_beads(400), "{beads}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_ends_finishes_its_print_first() {
    let (printer, site) = cleared(Speed::Times(100.0), "").await;
    let id = site.add(&rings(30), WishesBody::default()).await;
    until("the first beads", async || !printer.beads().is_empty()).await;
    let dir = site.end(OnStop::Finish).await;
    let site = Site::open(dir, "").await;
    assert_eq!(site.job(id).await.state, State::AwaitingBedClear);
    let _dir = site.end(OnStop::Finish).await;
    assert_eq!(printer.end().len(), n_beads(30));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_parked_print_goes_on_under_the_next_server_where_somebody_says_so() {
    let (printer, site) = cleared(Speed::Times(100.0), "").await;
    let id = site.add(&rings(60), WishesBody::default()).await;
    until("the first beads", async || printer.beads().len() > N_SIDES as usize).await;
    let dir = site.end(OnStop::Park).await;
    // Until its record is written.
    tokio::time::sleep(Duration::from_secs(1)).await;
    let n_before = printer.beads().len();
    let site = Site::open(dir, "").await;
    until("it to be told", async || site.says().await.1.contains("let it go on")).await;
    assert_eq!(site.job(id).await.state, State::Paused);
    tokio::time::sleep(Duration::from_secs(1)).await;
    assert_eq!(printer.beads().len(), n_before, "it went on by itself");
    site.ask(id, Turn::GoOn).await;
    site.is_at(id, State::AwaitingBedClear).await;
    let _dir = site.end(OnStop::Finish).await;
    let beads = printer.end();
    assert_eq!(beads.len(), n_beads(60));
    let alone = tempfile::tempdir().unwrap();
    let clean = Simulator::start(alone.path(), Speed::Max).await;
    let site = Site::open(alone, "").await;
    site.clear().await;
    let id = site.add(&rings(60), WishesBody::default()).await;
    site.is_at(id, State::AwaitingBedClear).await;
    let _dir = site.end(OnStop::Finish).await;
    assert_eq!(clean.end(), beads, "each bead as in a print without a break");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_printing_part_that_dies_leaves_no_heater_on_and_nothing_is_printed_again() {
    let (printer, site) = cleared(Speed::Times(100.0), "").await;
    let id = site.add(&rings(200), WishesBody::default()).await;
    until("the first beads", async || printer.beads().len() > N_SIDES as usize).await;
    let dir = site.die().await;
    // Its socket goes with it a moment later.
    tokio::time::sleep(Duration::from_secs(1)).await;
    let site = Site::open(dir, "").await;
    site.is_at(id, State::Failed).await;
    let told = site.told(id).await;
    assert!(told.last().unwrap().contains("the server ended in the middle of the print"), "{told:?}");
    until("the heaters", async || printer.has_done("M104 S0")).await;
    assert_eq!(site.client.printer(&name("left")).await.unwrap().bed, BedView::Taken(id));
    tokio::time::sleep(Duration::from_secs(1)).await;
    let n_before = printer.beads().len();
    tokio::time::sleep(Duration::from_secs(2)).await;
    assert_eq!(printer.beads().len(), n_before);
    let _dir = site.end(OnStop::Finish).await;
    assert!(printer.end().len() < n_beads(200));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_goes_beyond_the_limits_is_refused_before_the_printer_is_warm() {
    let (printer, site) = cleared(Speed::Max, "max_hotend_c = 150\n").await;
    let id = site.add(&rings(1), WishesBody::default()).await;
    site.is_at(id, State::Failed).await;
    let told = site.told(id).await.pop().unwrap();
    assert!(told.contains("150 and 120 °C are allowed without anybody near"), "{told}");
    let id = site.add(&rings(1).replace("X110.000", "X910.000"), WishesBody::default()).await;
    site.is_at(id, State::Failed).await;
    let told = site.told(id).await.pop().unwrap();
    assert!(
        told.contains("it was made for another printer: ") && told.contains("goes to X 910.000"),
        "{told}"
    );
    let bed = site.client.printer(&name("left")).await.unwrap().bed;
    assert_eq!((bed, printer.has_done("M109")), (BedView::Clear, false));
    let _dir = site.end(OnStop::Finish).await;
    printer.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_first_layer_is_held_for_a_look_and_a_program_clears_the_bed() {
    let dir = tempfile::tempdir().unwrap();
    let printer = Simulator::start(dir.path(), Speed::Times(100.0)).await;
    let more = "first_layer_hold = true\nbed_clear_program = [\"/bin/false\"]\n";
    let site = Site::open(dir, more).await;
    site.clear().await;
    let id = site.add(&rings(20), WishesBody::default()).await;
    site.is_at(id, State::Paused).await;
    let n_laid = printer.beads().len();
    assert!(n_laid < n_beads(10), "{n_laid}");
    site.ask(id, Turn::GoOn).await;
    site.is_at(id, State::AwaitingBedClear).await;
    let dir = site.end(OnStop::Finish).await;
    // The next server has a program for it, and nobody has to come.
    let site =
        Site::open(dir, "bed_clear_program = [\"/bin/true\"]\n[http]\ntcp = [\"127.0.0.1:0\"]\n").await;
    site.is_at(id, State::Finished).await;
    let changes = site.changes(id).await;
    assert!(changes.ends_with("lay pause go-on printed complete"), "{changes}");
    let _dir = site.end(OnStop::Finish).await;
    assert_eq!(printer.end().len(), n_beads(20));
}

/// A program that stands in for this one when it is asked to slice.
fn slicer(dir: &Path, script: &str) -> PathBuf {
    let path = dir.join("slicer");
    std::fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
    std::fs::set_permissions(&path, PermissionsExt::from_mode(0o755)).unwrap();
    path
}

#[tokio::test(flavor = "multi_thread")]
async fn a_model_is_prepared_by_a_child_and_one_that_fails_says_why_without_paths() {
    let dir = tempfile::tempdir().unwrap();
    let script = "if [ -e \"$0.fail\" ]; then echo '{\"error\": \"'$3': the mesh of /srv/MEIER is open\", \"code\": \"x\"}'; exit 1; fi\n\
                  printf '; generated by lumenfab 0\\n; profile reference, PLA\\n; print_time_s 77\\nG28\\nG1 X1 E5 F60\\n' > \"$5\"";
    let program = slicer(dir.path(), script);
    let model = dir.path().join("MEIER.stl");
    std::fs::write(&model, "solid x\nendsolid x\n").unwrap();
    let config = "[[printer]]\nname = \"left\"\nprofile = \"reference\"\nport = \"/nonexistent/port\"\n";
    let site = Site::with(dir, config, program.clone()).await;
    let good = site.add_file(&model, WishesBody::default()).await;
    until("its preparation", async || site.job(good).await.is_prepared).await;
    let view = site.job(good).await;
    assert_eq!((view.estimate.unwrap().print_s, view.needs.profile), (77, Some(name("reference"))));
    std::fs::write(program.with_extension("fail"), "").unwrap();
    let bad = site.add_file(&model, WishesBody::default()).await;
    site.is_at(bad, State::Failed).await;
    assert_eq!(site.told(bad).await.pop().unwrap(), "fail: it: the mesh of (a path)");
    until("the port to be missed", async || site.says().await.0 == Activity::Offline).await;
    let over = site.client.jobs(Which::Over, None, 10).await.unwrap().jobs;
    assert_eq!(over.iter().map(|job| job.id).collect::<Vec<_>>(), [bad]);
    site.end(OnStop::Finish).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn one_directory_has_one_server() {
    let site = Site::with(tempfile::tempdir().unwrap(), "", "/nonexistent/lumenfab".into()).await;
    let second = Place::open(&site.dir.path().join("state")).unwrap_err();
    assert_eq!(second.code(), "serve.in_use");
    let dir = site.end(OnStop::Finish).await;
    Place::open(&dir.path().join("state")).unwrap();
}

/// What lies in a folder.
fn names(dir: &Path) -> Vec<String> {
    let Ok(found) = std::fs::read_dir(dir) else { return Vec::new() };
    found.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_of_the_watched_folder_is_one_job_even_where_it_cannot_be_moved_away() {
    let dir = tempfile::tempdir().unwrap();
    let inbox = dir.path().join("inbox");
    std::fs::create_dir(&inbox).unwrap();
    let config = format!("[watch]\nfolder = {inbox:?}\nsubmit = true\nstill_s = 0\n");
    let site = Site::with(dir, &config, "/nonexistent/lumenfab".into()).await;
    std::fs::write(inbox.join("MEIER.gcode"), rings(1)).unwrap();
    until("the file to be moved", async || !names(&inbox.join("taken")).is_empty()).await;
    let id: JobId = names(&inbox.join("taken"))[0].trim_end_matches(".gcode").parse().unwrap();
    assert_eq!(site.job(id).await.id, id);
    // No folder can be made where there is a file of its name.
    std::fs::remove_dir_all(inbox.join("taken")).unwrap();
    std::fs::write(inbox.join("taken"), "").unwrap();
    std::fs::write(inbox.join("HUBER.gcode"), rings(2)).unwrap();
    let all = async || {
        let [live, over] = [Which::Live, Which::Over].map(|which| site.client.jobs(which, None, 100));
        [live.await.unwrap().jobs, over.await.unwrap().jobs].concat()
    };
    until("the second job", async || all().await.len() == 2).await;
    let second = all().await.into_iter().find(|job| job.id != id).unwrap().id;
    until("its file to be taken over", async || site.job(second).await.is_prepared).await;
    // What is copied again comes back.
    let file = site.dir.path().join(format!("state/files/{second}.gcode"));
    std::fs::remove_file(&file).unwrap();
    tokio::time::sleep(Duration::from_secs(7)).await;
    assert!(!file.exists(), "the file was copied again");
    assert!(inbox.join("HUBER.gcode").exists());
    assert_eq!(all().await.len(), 2);
    std::fs::remove_file(inbox.join("taken")).unwrap();
    until("the second file to be moved", async || names(&inbox.join("taken")).len() == 1).await;
    site.end(OnStop::Cancel).await;
}

/// In two months.
fn later() -> Timestamp {
    Timestamp::now() + SignedDuration::from_hours(60 * 24)
}

#[tokio::test(flavor = "multi_thread")]
async fn what_belongs_to_a_job_goes_some_time_after_its_end_and_nothing_else_does() {
    let config = "[[printer]]\nname = \"left\"\nprofile = \"reference\"\nport = \"/nonexistent/port\"\n";
    let site = Site::with(tempfile::tempdir().unwrap(), config, "/nonexistent/lumenfab".into()).await;
    let over = site.add(&rings(1), WishesBody::default()).await;
    let live = site.add(&rings(2), WishesBody::default()).await;
    until("their preparation", async || site.job(over).await.is_prepared && site.job(live).await.is_prepared)
        .await;
    site.ask(over, Turn::Cancel).await;
    let dir = site.end(OnStop::Finish).await;
    let kept = |id: JobId| {
        let state = dir.path().join("state");
        [format!("files/{id}.gcode"), format!("jobs/{id}/job.gcode")].map(|file| state.join(file).exists())
    };
    assert_eq!((kept(over), kept(live)), ([true; 2], [true; 2]));
    let place = Place::open(&dir.path().join("state")).unwrap();
    let client = Client::over_socket(place.layout().socket());
    let (stop, stopping) = watch::channel(None);
    let config = Config::parse(config, "config.toml").unwrap();
    let program = "/nonexistent/lumenfab".into();
    let setup = Setup { place, config, program, clock: later, boot_clock: BootClock::of_system() };
    let served = tokio::spawn(serve(setup, stopping));
    until("what is over to go", async || kept(over) == [false; 2]).await;
    assert_eq!(kept(live), [true; 2]);
    assert_eq!(client.job(over).await.unwrap().state, State::Cancelled);
    assert!(!client.history_of(over, 0, 10).await.unwrap().records.is_empty());
    stop.send_replace(Some(OnStop::Finish));
    served.await.unwrap().unwrap();
}
