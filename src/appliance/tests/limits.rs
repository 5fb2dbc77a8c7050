//! What stops a print that nobody stands by: time, temperatures, a queue that cannot record.

use super::broken::Deaf;
use super::*;
use std::sync::Mutex;
use std::sync::atomic::AtomicI64;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

/// A printer that does whatever it is told at once, and says so; how warm it is, it says now and then.
struct Obedient {
    port: Deaf,
    /// `T:301.0 /200.0`, until its heaters are switched off.
    warmth: [&'static str; 2],
    n_lines: u32,
    /// Number of the last line.
    last: u32,
    heard: Arc<Mutex<String>>,
}

impl Obedient {
    async fn obey(mut self) {
        let (mut bytes, mut line) = ([0; 4096], Vec::new());
        loop {
            let Ok(n) = self.port.stream.read(&mut bytes).await else {
                // Nobody has opened it.
                tokio::time::sleep(LOOK).await;
                continue;
            };
            for byte in &bytes[..n] {
                line.push(*byte);
                if *byte == b'\n' {
                    let answer = self.answer(&String::from_utf8_lossy(&std::mem::take(&mut line)));
                    // Not so fast that the job is done before it is told.
                    tokio::time::sleep(Duration::from_millis(1)).await;
                    self.port.stream.write_all(answer.as_bytes()).await.unwrap();
                }
            }
        }
    }

    fn answer(&mut self, line: &str) -> String {
        self.heard.lock().unwrap().push_str(line);
        self.n_lines += 1;
        let number = line.strip_prefix('N').and_then(|rest| rest.split(' ').next()?.parse::<u32>().ok());
        match number {
            Some(number) if line.contains("M110") => self.last = number,
            Some(number) if number == self.last + 1 => self.last = number,
            Some(_) => {
                let last = self.last;
                let wrong = format!("Error:Line Number is not Last Line Number+1, Last Line: {last}");
                return format!("{wrong}\nResend: {}\nok\n", last + 1);
            }
            None => {}
        }
        let [nozzle, bed] = self.warmth;
        if line.contains("M104 S0") {
            self.warmth = ["T:200.00 /0.00", "B:60.00 /0.00"];
        }
        match self.n_lines % 20 {
            _ if line.contains("M105") => format!("ok {nozzle} {bed} @:0 B@:0\n"),
            _ if line.contains("M115") => "FIRMWARE_NAME:Marlin 2.1.2\nok\n".to_owned(),
            0 => format!("ok\n {nozzle} {bed} @:0 B@:0\n"),
            _ => "ok\n".to_owned(),
        }
    }
}

/// What becomes of a print on such a printer, and what that has heard.
async fn printed_at(warmth: [&'static str; 2]) -> (String, String) {
    let dir = tempfile::tempdir().unwrap();
    let heard = Arc::default();
    let port = Deaf::at(&dir.path().join("port"));
    let printer = Obedient { port, warmth, n_lines: 0, last: 0, heard: Arc::clone(&heard) };
    let obeying = tokio::spawn(printer.obey());
    let site = Site::open(dir, "").await;
    site.clear().await;
    let id = site.add(&rings(1200), WishesBody::default()).await;
    site.is_at(id, State::Failed).await;
    let told = site.told(id).await.pop().unwrap();
    let _dir = site.end(OnStop::Finish).await;
    obeying.abort();
    obeying.await.unwrap_err();
    let heard = heard.lock().unwrap().clone();
    (told, heard)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_nozzle_that_is_far_too_hot_is_stopped_for_good() {
    let (told, heard) = printed_at(["T:301.00 /200.00", "B:60.00 /60.00"]).await;
    assert_eq!(told, "fail: the nozzle is at 301 °C, above the 280 °C that are allowed");
    assert!(heard.contains("M112"), "{heard}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bed_that_is_set_too_hot_stops_the_print() {
    let (told, heard) = printed_at(["T:200.00 /200.00", "B:60.00 /130.00"]).await;
    assert_eq!(told, "fail: the bed is set to 130 °C, above the 120 °C that are allowed");
    assert!(heard.contains("M140 S0") && !heard.contains("M112"), "{heard}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_print_that_takes_too_long_is_given_up() {
    let dir = tempfile::tempdir().unwrap();
    let printer = Simulator::start(dir.path(), Speed::Times(5.0)).await;
    let text = format!(
        "[[printer]]\nname = \"left\"\nprofile = {PROFILE:?}\nport = {:?}\n",
        dir.path().join("port")
    );
    let mut config = Config::parse(&text, "config.toml").unwrap();
    config.printers[0].limits.longest = Duration::from_secs(3);
    let site =
        Site::by(dir, config, "/nonexistent/lumenfab".into(), (Timestamp::now, BootClock::of_system())).await;
    site.clear().await;
    // As a slicer has it that reckons too little.
    let id = site.add(&format!("; print_time_s 1\n{}", rings(400)), WishesBody::default()).await;
    site.is_at(id, State::Failed).await;
    let told = site.told(id).await.pop().unwrap();
    assert!(told.starts_with("fail: it took longer than the 0.0 h that are allowed"), "{told}");
    until("the heaters", async || printer.has_done("M104 S0")).await;
    let _dir = site.end(OnStop::Finish).await;
    printer.end();
}

/// A print that may not lay: it is warm, and the queue takes no record until it is given up.
async fn given_up_warm() -> (Simulator, Site, JobId, rusqlite::Connection) {
    let (printer, site) = cleared(Speed::Times(8.0), "").await;
    let id = site.add(&rings(1), WishesBody::default()).await;
    site.is_at(id, State::Printing).await;
    let lock = locked(site.dir.path());
    assert!(!site.job(id).await.is_laid, "the printer was warm before the queue was locked");
    until("it to be given up", async || site.says().await.0 == Activity::Cancelling).await;
    (printer, site, id, lock)
}

const NOT_RECORDED: &str = "the queue could not record that material is laid";

#[tokio::test(flavor = "multi_thread")]
async fn a_print_that_may_not_lay_for_long_goes_back_and_is_printed_once() {
    let (printer, site, id, lock) = given_up_warm().await;
    drop(lock);
    site.is_at(id, State::AwaitingBedClear).await;
    let told = site.told(id).await;
    assert!(told.contains(&format!("give-back: {NOT_RECORDED}")), "{told:?}");
    let _dir = site.end(OnStop::Finish).await;
    assert_eq!(printer.end().len(), n_beads(1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_print_whose_laying_was_recorded_after_all_fails_and_does_not_stay_in_print() {
    let (printer, site, id, lock) = given_up_warm().await;
    // Its last attempt was done, and the answer lost.
    let laid = "UPDATE jobs SET body = json_set(body, '$.is_laid', json('true'))";
    assert_eq!(lock.execute(laid, []).unwrap(), 1);
    lock.execute_batch("COMMIT").unwrap();
    site.is_at(id, State::Failed).await;
    let told = site.told(id).await.pop().unwrap();
    assert_eq!(told, format!("fail: {NOT_RECORDED}"));
    let bed = site.client.printer(&name("left")).await.unwrap().bed;
    assert_eq!(bed, BedView::Taken(id), "somebody looks at it");
    let _dir = site.end(OnStop::Finish).await;
    assert_eq!(printer.end(), Vec::<String>::new());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_first_layer_that_is_not_marked_cannot_be_held_for_a_look_and_the_job_is_refused() {
    let (printer, site) = cleared(Speed::Max, "first_layer_hold = true\n").await;
    let unmarked = rings(2).lines().filter(|line| !line.starts_with(";LAYER")).collect::<Vec<_>>().join("\n");
    let id = site.add(&unmarked, WishesBody::default()).await;
    site.is_at(id, State::Failed).await;
    let told = site.told(id).await.pop().unwrap();
    assert!(told.contains("first_layer_hold"), "{told}");
    assert!(!printer.has_done("M109"));
    let id = site.add(&rings(1), WishesBody::default()).await;
    site.is_at(id, State::AwaitingBedClear).await;
    let _dir = site.end(OnStop::Finish).await;
    printer.end();
}

/// How far a clock is wrong, s.
static AHEAD_S: AtomicI64 = AtomicI64::new(0);

fn wrong_clock() -> Timestamp {
    Timestamp::now() + SignedDuration::from_secs(AHEAD_S.load(Ordering::Relaxed))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_clock_that_is_set_back_or_forward_in_a_print_prints_each_copy_once() {
    let dir = tempfile::tempdir().unwrap();
    let printer = Simulator::start(dir.path(), Speed::Times(100.0)).await;
    let port = dir.path().join("port");
    let config = format!("[[printer]]\nname = \"left\"\nprofile = {PROFILE:?}\nport = {port:?}\n");
    let config = Config::parse(&config, "config.toml").unwrap();
    let site =
        Site::by(dir, config, "/nonexistent/lumenfab".into(), (wrong_clock, BootClock::of_system())).await;
    let id = site.add(&rings(30), WishesBody { copies: 3, ..WishesBody::default() }).await;
    for (n_printed, ahead_s) in [(1, -3600), (2, 3600), (3, -3600)] {
        site.clear().await;
        until("the print", async || site.job(id).await.state == State::Printing).await;
        AHEAD_S.store(ahead_s, Ordering::Relaxed);
        site.is_at(id, State::AwaitingBedClear).await;
        assert_eq!(site.job(id).await.n_printed, n_printed);
    }
    site.clear().await;
    site.is_at(id, State::Finished).await;
    assert_eq!(site.told(id).await.iter().filter(|change| *change == "lay").count(), 3);
    let _dir = site.end(OnStop::Finish).await;
    // The end of a print draws filament back, which the next one misses: a ring and a bead.
    let n_laid = printer.end().len();
    let n_missed = 2 * (N_SIDES as usize + 1);
    assert!((3 * n_beads(30) - n_missed..=3 * n_beads(30)).contains(&n_laid), "{n_laid}");
}
