//! Heaters that a server leaves on: whoever comes after it, and whoever watches where nobody comes, switches them off.

use super::broken::{parked, unguarded, with_profile};
use super::*;
use crate::appliance::guard::{self, Heaters, SeenTo};
use crate::progress::CancelToken;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::UnixStream;

fn state(site: &Site) -> PathBuf {
    site.dir.path().join("state")
}

/// An operator sets the nozzle to a temperature.
async fn heated() -> (Simulator, Site) {
    let (printer, site) = cleared(Speed::Max, "").await;
    let mut stream = UnixStream::connect(state(&site).join("lumenfab.sock")).await.unwrap();
    let body = "{\"command\": \"M104 S200\"}";
    let head = "POST /api/printer/command HTTP/1.1\r\nhost: left\r\nconnection: close\r\ncontent-type: application/json";
    let request = format!("{head}\r\ncontent-length: {}\r\n\r\n{body}", body.len());
    stream.write_all(request.as_bytes()).await.unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).await.unwrap();
    assert!(answer.starts_with("HTTP/1.1 204"), "{answer}");
    until("the nozzle to be set", async || printer.has_done("M104 S200")).await;
    assert!(!printer.has_done("M104 S0"));
    (printer, site)
}

async fn look(dir: &Path) -> Vec<Heaters> {
    guard::look(dir).await.unwrap().into_iter().map(|seen: SeenTo| seen.heaters).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_ends_leaves_no_heat_of_commands() {
    let (printer, site) = heated().await;
    let dir = site.end(OnStop::Finish).await;
    until("the heaters", async || printer.has_done("M104 S0")).await;
    assert_eq!(look(&dir.path().join("state")).await, []);
    printer.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn heat_of_commands_that_a_dead_server_left_is_switched_off_without_another_one() {
    let (printer, site) = heated().await;
    let state = state(&site);
    assert_eq!(look(&state).await, [], "the server sees to it");
    let _dir = site.die().await;
    until("the server to be gone", async || look(&state).await == [Heaters::Off]).await;
    until("the heaters", async || printer.has_done("M104 S0")).await;
    assert_eq!(look(&state).await, []);
    printer.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn heat_of_commands_that_a_dead_server_left_is_switched_off_by_the_next_one() {
    let (printer, site) = heated().await;
    let site = Site::open(site.die().await, "").await;
    until("the heaters", async || printer.has_done("M104 S0")).await;
    let _dir = site.end(OnStop::Finish).await;
    printer.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_parked_print_is_kept_warm_for_the_next_server_and_no_longer_than_its_time() {
    let (printer, site, _config) = with_profile(Speed::Times(100.0), |profile| {
        // As firmware that has no time-out of its own.
        (profile.firmware.orphan_hold_s, profile.firmware.orphan_guard) = (5.0, false);
    })
    .await;
    let id = site.add(&rings(60), WishesBody::default()).await;
    until("the first beads", async || printer.beads().len() > N_SIDES as usize).await;
    let dir = site.end(OnStop::Park).await;
    let state = dir.path().join("state");
    assert!(!printer.has_done("M104 S0"));
    let cancel = CancelToken::default();
    let watching = tokio::spawn({
        let (state, cancel) = (state.clone(), cancel.clone());
        async move { guard::watch(&state, &cancel).await }
    });
    until("the heaters", async || printer.has_done("M104 S0")).await;
    cancel.cancel();
    assert_eq!(watching.await.unwrap().unwrap(), []);
    let (job, _claim) = Sqlite::open(&state.join("queue.db")).unwrap().job(id).await.unwrap();
    assert_eq!(job.state, State::Paused, "it can be gone on with");
    printer.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_watch_that_ends_leaves_a_parked_print_to_firmware_with_a_time_out_alone() {
    let (printer, site, _id) = parked(|profile| profile.firmware.orphan_hold_s = 86_400.0).await;
    let dir = site.end(OnStop::Park).await;
    let state = dir.path().join("state");
    assert_eq!(look(&state).await, [Heaters::Kept]);
    let cancel = CancelToken::default();
    cancel.cancel();
    let last = async || guard::watch(&state, &cancel).await.unwrap().pop().unwrap().heaters;
    assert_eq!((last().await, printer.has_done("M104 S0")), (Heaters::Kept, false));
    // The same printer, had its firmware none.
    let mut own = profile::builtin(PROFILE).unwrap();
    unguarded(&mut own);
    own.firmware.orphan_hold_s = 86_400.0;
    std::fs::write(dir.path().join("own.toml"), profile::to_toml(&own)).unwrap();
    assert_eq!(last().await, Heaters::Off);
    until("the heaters", async || printer.has_done("M104 S0")).await;
    printer.end();
}
