//! Heaters whose owner is gone.

use super::*;

/// A server that died while a job warmed up, of which nothing was laid.
async fn died_warm() -> (Simulator, TempDir, JobId) {
    // Slow enough that it heats for many seconds.
    let (printer, site) = cleared(Speed::Times(4.0), "").await;
    let id = site.add(&rings(1), WishesBody::default()).await;
    site.is_at(id, State::Printing).await;
    until("heating", async || printer.has_done("M104 S")).await;
    assert!(!site.job(id).await.is_laid, "the printer was warm already");
    let dir = site.die().await;
    // Its socket goes with it a moment later, and the print's thread sees to the heaters.
    tokio::time::sleep(Duration::from_secs(2)).await;
    (printer, dir, id)
}

/// Lines of the printer's record in which this stands.
fn places(record: &Path, command: &str) -> Vec<usize> {
    let text = std::fs::read_to_string(record.join("events.jsonl")).unwrap_or_default();
    text.lines().enumerate().filter(|(_, line)| line.contains(command)).map(|(place, _)| place).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn heaters_that_could_not_be_switched_off_are_told_and_no_job_is_taken_until_they_are() {
    let (printer, dir, id) = died_warm().await;
    printer.end();
    let site = Site::open(dir, "").await;
    site.is_at(id, State::Queued).await;
    until("it to be told", async || site.says().await.1.contains("heaters")).await;
    assert_eq!(site.says().await.0, Activity::Faulted);
    // Nothing was at the port: the bed is in doubt, until somebody has looked.
    site.clear().await;
    tokio::time::sleep(Duration::from_secs(2)).await;
    assert_eq!(site.job(id).await.state, State::Queued);
    let printer = Simulator::start(site.dir.path(), Speed::Max).await;
    site.is_at(id, State::AwaitingBedClear).await;
    let dir = site.end(OnStop::Finish).await;
    printer.end();
    let record = dir.path().join("record");
    let (off, on) = (places(&record, "M104 S0"), places(&record, "M109"));
    assert!(off[0] < on[0], "off at {off:?}, on at {on:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_printer_that_does_not_answer_is_asked_again_until_it_does() {
    let (printer, dir, id) = died_warm().await;
    printer.end();
    // Somebody listens there, and says nothing.
    let (mute, mut port) = serialport::TTYPort::pair().unwrap();
    port.set_exclusive(false).unwrap();
    let link = dir.path().join("port");
    std::os::unix::fs::symlink(serialport::SerialPort::name(&port).unwrap(), &link).unwrap();
    drop(port);
    let site = Site::open(dir, "").await;
    until("it to be told", async || site.says().await.1.contains("heaters")).await;
    site.is_at(id, State::Queued).await;
    assert_eq!(site.says().await.0, Activity::Faulted);
    std::fs::remove_file(&link).unwrap();
    drop(mute);
    let printer = Simulator::start(site.dir.path(), Speed::Max).await;
    site.is_at(id, State::AwaitingBedClear).await;
    let _dir = site.end(OnStop::Finish).await;
    assert_eq!(printer.end().len(), n_beads(1));
}

#[tokio::test(flavor = "multi_thread")]
async fn at_start_the_heaters_go_off_even_where_nothing_can_be_written() {
    let (printer, dir, id) = died_warm().await;
    let n_off = || places(&printer.record, "M104 S0").len();
    let n_before = n_off();
    let lock = locked(dir.path());
    let site = Site::open(dir, "").await;
    until("the heaters to be switched off", async || n_off() > n_before).await;
    drop(lock);
    site.is_at(id, State::AwaitingBedClear).await;
    let _dir = site.end(OnStop::Finish).await;
    assert_eq!(printer.end().len(), n_beads(1));
}
