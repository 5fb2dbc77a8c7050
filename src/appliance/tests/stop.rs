//! Orders to a printer that is not printing: emergency stop, lines within the limits.

use super::broken::{parked, unguarded};
use super::*;
use crate::client;
use crate::http::wire::{Order, Ordered};

async fn order(site: &Site, order: Order) -> Result<(), client::Error> {
    let ordered = Ordered { order, name: None, why: Reason::default() };
    site.client.order(&name("left"), &ordered).await.map(drop)
}

async fn has_stopped(site: &Site) {
    until("the printer's word", async || {
        site.says().await.1.contains("the printer says that it has stopped")
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_idle_printer_is_stopped_and_takes_no_job_until_it_is_connected() {
    let (printer, site) = cleared(Speed::Max, "").await;
    until("the port", async || site.says().await.0 == Activity::Idle).await;
    order(&site, Order::EmergencyStop).await.unwrap();
    has_stopped(&site).await;
    assert_eq!(site.says().await.0, Activity::Faulted);
    let id = site.add(&rings(1), WishesBody::default()).await;
    until("its preparation", async || site.job(id).await.is_prepared).await;
    tokio::time::sleep(Duration::from_secs(2)).await;
    assert_eq!(site.job(id).await.state, State::Queued);
    // Switched off and on.
    printer.end();
    let printer = Simulator::start(site.dir.path(), Speed::Max).await;
    site.clear().await;
    order(&site, Order::Connect).await.unwrap();
    site.is_at(id, State::AwaitingBedClear).await;
    let _dir = site.end(OnStop::Finish).await;
    printer.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn lines_that_somebody_sent_are_stopped_in_the_middle() {
    let (printer, site) = cleared(Speed::Times(1.0), "").await;
    let lines = ["M109 S200", "M104 S201"].map(str::to_owned);
    order(&site, Order::Commands(lines.into())).await.unwrap();
    until("heating", async || printer.has_done("M109 S200")).await;
    order(&site, Order::EmergencyStop).await.unwrap();
    has_stopped(&site).await;
    assert_eq!(site.says().await.0, Activity::Faulted);
    let _dir = site.end(OnStop::Finish).await;
    assert!(!printer.has_done("M104 S201"));
    printer.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_print_that_waits_is_stopped_and_waits_on() {
    let (printer, site, id) = parked(unguarded).await;
    order(&site, Order::EmergencyStop).await.unwrap();
    has_stopped(&site).await;
    until("its word", async || site.says().await.0 == Activity::Paused).await;
    let (_, says) = site.says().await;
    assert!(says.contains("has stopped") && says.contains("go-on"), "{says}");
    assert_eq!(site.job(id).await.state, State::Paused);
    site.ask(id, Turn::Cancel).await;
    site.is_at(id, State::Cancelled).await;
    let _dir = site.end(OnStop::Finish).await;
    printer.end();
}

#[tokio::test(flavor = "multi_thread")]
async fn where_nothing_is_at_the_port_it_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let site = Site::open(dir, "").await;
    let refused = order(&site, Order::EmergencyStop).await.unwrap_err().to_string();
    assert!(refused.contains("nothing at its port") && refused.contains("own switch"), "{refused}");
    let _dir = site.end(OnStop::Finish).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn lines_that_heat_beyond_the_limits_are_refused_and_the_limits_can_be_seen() {
    let (printer, site) = cleared(Speed::Max, "max_hotend_c = 230\nmax_bed_c = 70").await;
    let live = site.client.printer(&name("left")).await.unwrap().live.unwrap();
    assert_eq!((live.max_hotend_c, live.max_bed_c), (Some(230.0), Some(70.0)));
    for line in ["M104 S231", "M109 R231", "M140 S71", "M303 E0 S231"] {
        let lines = Order::Commands(vec!["M105".to_owned(), line.to_owned()]);
        let refused = order(&site, lines).await.unwrap_err().to_string();
        assert!(refused.contains("230 and 70 °C are allowed"), "{line}: {refused}");
    }
    order(&site, Order::Commands(vec!["M104 S230".to_owned()])).await.unwrap();
    until("the nozzle to be set", async || printer.has_done("M104 S230")).await;
    assert!(!printer.has_done("231") && !printer.has_done("M140 S71"));
    let _dir = site.end(OnStop::Finish).await;
    printer.end();
}
