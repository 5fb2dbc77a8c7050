//! Prints that broke off: what becomes of them, and of their heaters.

use super::*;
use crate::profile::Profile;
use crate::queue::{Actor, Change, Request};
use std::io::Read;
use tokio_serial::{SerialPort, SerialStream};

/// The configuration of a printer at the port of a directory whose profile is changed so.
fn configured(dir: &Path, change: impl FnOnce(&mut Profile)) -> String {
    let mut own = profile::builtin(PROFILE).unwrap();
    change(&mut own);
    let (port, path) = (dir.join("port"), dir.join("own.toml"));
    std::fs::write(&path, profile::to_toml(&own)).unwrap();
    format!("[[printer]]\nname = \"left\"\nprofile = {path:?}\nport = {port:?}\nbed_trusted_s = 3600\n")
}

/// A server with such a printer, which knows its bed to be clear, and its configuration.
pub(super) async fn with_profile(
    speed: Speed,
    change: impl FnOnce(&mut Profile),
) -> (Simulator, Site, String) {
    let dir = tempfile::tempdir().unwrap();
    let printer = Simulator::start(dir.path(), speed).await;
    let config = configured(dir.path(), change);
    let site = Site::with(dir, &config, "/nonexistent/lumenfab".into()).await;
    site.clear().await;
    (printer, site, config)
}

/// A print that a server has parked, its printer, and the next server, which waits for a word.
pub(super) async fn parked(change: impl FnOnce(&mut Profile)) -> (Simulator, Site, JobId) {
    let (printer, site, config) = with_profile(Speed::Times(100.0), change).await;
    let id = site.add(&rings(60), WishesBody::default()).await;
    until("the first beads", async || printer.beads().len() > N_SIDES as usize).await;
    let dir = site.end(OnStop::Park).await;
    let site = Site::with(dir, &config, "/nonexistent/lumenfab".into()).await;
    until("it to be told", async || site.says().await.1.contains("let it go on")).await;
    (printer, site, id)
}

/// Firmware without a time-out of its own: the simulated one would count a hundred seconds for one.
pub(super) const fn unguarded(profile: &mut Profile) {
    profile.firmware.orphan_guard = false;
}

#[tokio::test(flavor = "multi_thread")]
async fn go_on_without_a_port_loses_nothing() {
    let (printer, site, id) = parked(unguarded).await;
    let (port, away) = (site.dir.path().join("port"), site.dir.path().join("away"));
    std::fs::rename(&port, &away).unwrap();
    site.ask(id, Turn::GoOn).await;
    until("the port to be missed", async || site.says().await.1.contains("does not exist")).await;
    site.is_at(id, State::Paused).await;
    std::fs::rename(&away, &port).unwrap();
    site.ask(id, Turn::GoOn).await;
    site.is_at(id, State::AwaitingBedClear).await;
    let _dir = site.end(OnStop::Finish).await;
    assert_eq!(printer.end().len(), n_beads(60));
}

/// A printer that hears everything and answers nothing, at the port of the directory.
pub(super) struct Deaf {
    pub(super) stream: SerialStream,
    port: PathBuf,
}

impl Deaf {
    pub(super) fn at(port: &Path) -> Self {
        let (stream, other) = SerialStream::pair().unwrap();
        std::os::unix::fs::symlink(other.name().unwrap(), port).unwrap();
        Self { stream, port: port.to_owned() }
    }

    /// What it hears, until it has heard this.
    async fn hears(&mut self, words: &str) {
        let mut heard = String::new();
        until(words, async || {
            let mut bytes = [0; 4096];
            if let Ok(n) = self.stream.read(&mut bytes) {
                heard += &String::from_utf8_lossy(&bytes[..n]);
            }
            heard.contains(words)
        })
        .await;
    }
}

impl Drop for Deaf {
    /// The next terminal of the system may have the same name, and is another test's.
    fn drop(&mut self) {
        std::fs::remove_file(&self.port).unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_print_that_is_cancelled_while_it_is_asked_where_it_is_is_switched_off() {
    let (printer, site, id) = parked(unguarded).await;
    printer.end();
    let mut deaf = Deaf::at(&site.dir.path().join("port"));
    site.ask(id, Turn::GoOn).await;
    deaf.hears("?").await;
    site.ask(id, Turn::Cancel).await;
    deaf.hears("M104 S0").await;
    // An answer is not waited for where nobody is.
    drop(deaf);
    site.is_at(id, State::Cancelled).await;
    let _dir = site.end(OnStop::Finish).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_print_that_is_cancelled_while_its_port_is_away_is_cancelled() {
    let (printer, site) = cleared(Speed::Times(100.0), "").await;
    let id = site.add(&rings(60), WishesBody::default()).await;
    until("the first beads", async || printer.beads().len() > N_SIDES as usize).await;
    printer.end();
    until("the port to be missed", async || site.says().await.1.contains("the port vanished")).await;
    site.ask(id, Turn::Cancel).await;
    site.is_at(id, State::Cancelled).await;
    let _dir = site.end(OnStop::Finish).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_print_that_broke_off_goes_cold_and_hears_although_the_queue_takes_no_record() {
    let (printer, site, _config) = with_profile(Speed::Times(100.0), |profile| {
        (profile.firmware.orphan_hold_s, profile.firmware.orphan_guard) = (20.0, false);
    })
    .await;
    let id = site.add(&rings(200), WishesBody::default()).await;
    until("the first beads", async || printer.beads().len() > N_SIDES as usize).await;
    let lock = locked(site.dir.path());
    printer.end();
    until("it to be told", async || site.says().await.1.contains("let it go on")).await;
    let mut deaf = Deaf::at(&site.dir.path().join("port"));
    deaf.hears("M104 S0").await;
    // An answer is not waited for where nobody is.
    drop(deaf);
    until("an answer", async || {
        let cancel = Anew { turn: Turn::Cancel, saw: None, name: None, why: Reason::default() };
        site.client.change(id, &cancel).await.is_ok()
    })
    .await;
    drop(lock);
    site.is_at(id, State::Cancelled).await;
    let _dir = site.end(OnStop::Finish).await;
}

/// Somebody whose clock is an hour ahead, and who believes that the printer is not heard of any more.
async fn cancel_elsewhere(site: &Site, id: JobId) {
    let other = Sqlite::open(&site.dir.path().join("state/queue.db")).unwrap();
    let (saw, now) = (site.job(id).await.state, Timestamp::now() + SignedDuration::from_hours(1));
    let (change, actor) = (Change::Cancel { used_mm3: None }, Actor::Operator { name: name("Eve"), saw });
    let done = other.change(id, Request { change, actor, why: Reason::default(), now }).await.unwrap();
    assert_eq!(done.state, State::Cancelled);
    other.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_print_whose_job_was_ended_elsewhere_stops_and_its_bed_is_not_believed_to_be_clear() {
    let (printer, site) = cleared(Speed::Times(5.0), "").await;
    let id = site.add(&rings(400), WishesBody::default()).await;
    until("the first beads", async || !printer.beads().is_empty()).await;
    cancel_elsewhere(&site, id).await;
    site.clear().await;
    until("its end", async || printer.has_done("M104 S0") && site.says().await.0 == Activity::Idle).await;
    let bed = async || site.client.printer(&name("left")).await.unwrap().bed;
    until("the doubt", async || bed().await == BedView::Unknown).await;
    let _dir = site.end(OnStop::Finish).await;
    assert!(printer.end().len() < n_beads(400));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_print_that_waits_and_whose_job_was_ended_elsewhere_is_switched_off() {
    let (printer, site, id) = parked(unguarded).await;
    assert!(!printer.has_done("M104 S0"));
    cancel_elsewhere(&site, id).await;
    until("its end", async || printer.has_done("M104 S0") && site.says().await.0 == Activity::Idle).await;
    let _dir = site.end(OnStop::Finish).await;
    printer.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_leaves_its_heaters_on_has_them_switched_off() {
    let (printer, site) = cleared(Speed::Max, "").await;
    let start = profile::builtin(PROFILE).unwrap().start_gcode();
    let job = rings::job(&start, Rings { n_layers: 1, n_sides: N_SIDES, filament_mm: 0.06 }, &[]);
    let id = site.add(&job, WishesBody::default()).await;
    site.is_at(id, State::AwaitingBedClear).await;
    until("the heaters", async || printer.has_done("M104 S0")).await;
    let _dir = site.end(OnStop::Finish).await;
    printer.end();
}
