//! What is believed of beds: by whom they were watched, and of which machine.

use super::*;
use std::sync::atomic::AtomicU64;

/// Whether a program has the port.
fn is_taken(port: &str) -> bool {
    tokio_serial::SerialStream::open(&tokio_serial::new(port, 115_200)).is_err()
}

/// Nobody knows how long no server lived.
fn forget(dir: &TempDir) {
    std::fs::remove_file(dir.path().join("state/alive")).unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bed_that_nobody_has_watched_is_doubted() {
    let (printer, site) = cleared(Speed::Max, "").await;
    let dir = site.end(OnStop::Finish).await;
    let site = Site::open(dir, "").await;
    assert_eq!(site.bed().await, BedView::Clear, "only for a moment");
    let dir = site.end(OnStop::Finish).await;
    forget(&dir);
    let site = Site::open(dir, "").await;
    until("the doubt", async || site.bed().await == BedView::Unknown).await;
    let _dir = site.end(OnStop::Finish).await;
    printer.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn absence_and_sleep_are_told_by_a_clock_that_counts_from_the_start_of_the_machine() {
    static NOW_S: AtomicU64 = AtomicU64::new(1000);
    let clock = |boot: &str| BootClock {
        boot: Some(boot.to_owned()),
        now: || Duration::from_secs(NOW_S.load(Ordering::Relaxed)),
    };
    let dir = tempfile::tempdir().unwrap();
    let printer = Simulator::start(dir.path(), Speed::Max).await;
    let port = dir.path().join("port").display().to_string();
    let config = format!(
        "[[printer]]\nname = \"left\"\nprofile = {PROFILE:?}\nport = {port:?}\nbed_trusted_s = 3600\n"
    );
    let open = async |dir, boot| {
        let config = Config::parse(&config, "config.toml").unwrap();
        Site::by(dir, config, "/nonexistent/lumenfab".into(), (Timestamp::now, clock(boot))).await
    };
    let pass = |seconds| NOW_S.fetch_add(seconds, Ordering::Relaxed);
    let site = open(dir, "a").await;
    site.clear().await;
    let dir = site.end(OnStop::Finish).await;
    pass(3500);
    let site = open(dir, "a").await;
    assert_eq!(site.bed().await, BedView::Clear, "not away for longer than is allowed");
    let dir = site.end(OnStop::Finish).await;
    pass(3700);
    let site = open(dir, "a").await;
    assert_eq!(site.bed().await, BedView::Unknown, "away for too long");
    site.clear().await;
    // A second look, so that it is not the first one that finds it.
    tokio::time::sleep(Duration::from_secs(2)).await;
    assert_eq!(site.bed().await, BedView::Clear);
    pass(3700);
    until("the doubt", async || site.bed().await == BedView::Unknown).await;
    site.clear().await;
    let dir = site.end(OnStop::Finish).await;
    pass(10);
    let site = open(dir, "b").await;
    assert_eq!(site.bed().await, BedView::Unknown, "the machine was off in between, nobody knows how long");
    let _dir = site.end(OnStop::Finish).await;
    printer.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_is_given_back_after_a_long_absence_leaves_its_bed_in_doubt() {
    // Slow enough that it heats for seconds.
    let (printer, site) = cleared(Speed::Times(20.0), "").await;
    let id = site.add(&rings(1), WishesBody::default()).await;
    site.is_at(id, State::Printing).await;
    assert!(!site.job(id).await.is_laid, "the printer was warm already");
    let dir = site.die().await;
    // Its socket goes with it a moment later.
    tokio::time::sleep(Duration::from_secs(1)).await;
    forget(&dir);
    let site = Site::open(dir, "").await;
    site.is_at(id, State::Queued).await;
    assert_eq!(site.bed().await, BedView::Unknown);
    tokio::time::sleep(Duration::from_secs(2)).await;
    assert_eq!((site.job(id).await.state, printer.beads().len()), (State::Queued, 0));
    site.clear().await;
    site.is_at(id, State::AwaitingBedClear).await;
    let _dir = site.end(OnStop::Finish).await;
    assert_eq!(printer.end().len(), n_beads(1));
}

#[tokio::test(flavor = "multi_thread")]
async fn no_other_program_gets_the_port_and_one_that_has_it_makes_the_bed_doubtful() {
    let dir = tempfile::tempdir().unwrap();
    let printer = Simulator::start(dir.path(), Speed::Max).await;
    let port = dir.path().join("port").display().to_string();
    let other = || tokio_serial::SerialStream::open(&tokio_serial::new(&port, 115_200));
    let site = Site::open(dir, "").await;
    site.clear().await;
    until("the server to take the port", async || other().is_err()).await;
    let dir = site.end(OnStop::Finish).await;
    let taken = other().unwrap();
    let site = Site::open(dir, "").await;
    until("the doubt", async || site.bed().await == BedView::Unknown).await;
    until("its reason", async || site.says().await.1.contains("in use by another program")).await;
    drop(taken);
    until("the port", async || site.says().await.0 == Activity::Idle).await;
    assert_eq!(site.bed().await, BedView::Unknown, "somebody has to look");
    let _dir = site.end(OnStop::Finish).await;
    printer.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_bed_of_a_machine_is_not_believed_to_be_another_one_s() {
    let dir = tempfile::tempdir().unwrap();
    let printer = Simulator::start(dir.path(), Speed::Max).await;
    let config = |port: &str| {
        let table = format!("[[printer]]\nname = \"left\"\nprofile = {PROFILE:?}\nport = {port:?}\n");
        format!("{table}bed_trusted_s = 3600\n")
    };
    let port = dir.path().join("port").display().to_string();
    let site = Site::with(dir, &config("sim"), "/nonexistent/lumenfab".into()).await;
    assert_eq!(site.bed().await, BedView::Clear, "a simulated bed is made anew with each print");
    let dir = site.end(OnStop::Finish).await;
    let site = Site::with(dir, &config("sim"), "/nonexistent/lumenfab".into()).await;
    assert_eq!(site.bed().await, BedView::Clear, "it is the same one still");
    let dir = site.end(OnStop::Finish).await;
    let site = Site::with(dir, &config(&port), "/nonexistent/lumenfab".into()).await;
    assert_eq!(site.bed().await, BedView::Unknown, "it was the simulated one's");
    let id = site.add(&rings(1), WishesBody::default()).await;
    until("its preparation", async || site.job(id).await.is_prepared).await;
    tokio::time::sleep(Duration::from_secs(2)).await;
    assert_eq!((site.job(id).await.state, printer.has_done("M109")), (State::Queued, false));
    site.clear().await;
    site.is_at(id, State::AwaitingBedClear).await;
    site.clear().await;
    let dir = site.end(OnStop::Finish).await;
    let other = dir.path().join("other");
    std::fs::create_dir(&other).unwrap();
    let (second, other) = (Simulator::start(&other, Speed::Max).await, other.join("port"));
    std::fs::rename(&other, dir.path().join("right")).unwrap();
    let right = dir.path().join("right").display().to_string();
    let site = Site::with(dir, &config(&right), "/nonexistent/lumenfab".into()).await;
    assert_eq!(site.bed().await, BedView::Unknown, "it was the one's at the other port");
    let _dir = site.end(OnStop::Finish).await;
    printer.end();
    second.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_port_that_vanished_for_too_long_leaves_the_bed_in_doubt() {
    let dir = tempfile::tempdir().unwrap();
    let printer = Simulator::start(dir.path(), Speed::Max).await;
    let port = dir.path().join("port").display().to_string();
    let config =
        format!("[[printer]]\nname = \"left\"\nprofile = {PROFILE:?}\nport = {port:?}\nbed_trusted_s = 0\n");
    let site = Site::with(dir, &config, "/nonexistent/lumenfab".into()).await;
    site.clear().await;
    until("the port", async || is_taken(&port)).await;
    printer.end();
    until("its end", async || site.says().await.0 == Activity::Offline).await;
    tokio::time::sleep(Duration::from_secs(12)).await;
    let printer = Simulator::start(site.dir.path(), Speed::Max).await;
    until("the port again", async || site.says().await.0 == Activity::Idle).await;
    assert!(is_taken(&port), "another program gets the new port");
    assert_eq!(site.bed().await, BedView::Unknown);
    let _dir = site.end(OnStop::Finish).await;
    printer.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_port_that_was_gone_for_a_moment_is_the_server_s_again() {
    let (printer, site) = cleared(Speed::Max, "").await;
    let port = site.dir.path().join("port").display().to_string();
    until("the port", async || is_taken(&port)).await;
    printer.end();
    // Sooner than it is looked at again, and under the same name.
    let printer = Simulator::start(site.dir.path(), Speed::Max).await;
    until("the new port", async || is_taken(&port)).await;
    assert_eq!(site.bed().await, BedView::Clear);
    let _dir = site.end(OnStop::Finish).await;
    printer.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn the_port_is_the_server_s_while_it_waits_for_a_word_and_while_the_printer_rests() {
    let (printer, site) = cleared(Speed::Times(100.0), "").await;
    let port = site.dir.path().join("port").display().to_string();
    let id = site.add(&rings(60), WishesBody::default()).await;
    until("the first beads", async || printer.beads().len() > N_SIDES as usize).await;
    let dir = site.end(OnStop::Park).await;
    assert!(!is_taken(&port));
    let site = Site::open(dir, "").await;
    until("it to be told", async || site.says().await.1.contains("let it go on")).await;
    until("the port", async || is_taken(&port)).await;
    site.ask(id, Turn::GoOn).await;
    site.is_at(id, State::AwaitingBedClear).await;
    until("the port after the print", async || is_taken(&port)).await;
    let _dir = site.end(OnStop::Finish).await;
    assert_eq!(printer.end().len(), n_beads(60));
}
