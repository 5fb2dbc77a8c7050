//! Against a real server.

use super::*;
use crate::http::Edge;
use crate::http::tests::{Site, idle};
use crate::http::wire::{Access, Activity, BedView, HistoryView, Live, Move, Turn};
use crate::queue::State;
use crate::queue::tests::name;
use std::os::unix::net::UnixListener;

fn anew(turn: Turn) -> Anew {
    Anew { turn, saw: None, name: None, why: Reason::default() }
}

fn client(site: &Site) -> Client {
    Client::over_socket(&site.socket)
}

#[tokio::test]
async fn every_call_reaches_the_server() {
    let site = Site::open().await;
    let client = client(&site);
    assert_eq!(client.check_version().await.unwrap().api, API);
    assert_eq!(client.status().await.unwrap().last_record, 0);
    assert!(client.health().await.unwrap().ok);
    assert_eq!(client.whoami().await.unwrap().access, Access::Admin);
    let added = Added {
        path: site.local_file(),
        id: None,
        wishes: WishesBody { copies: 2, ..WishesBody::default() },
        submit: true,
        why: Reason::try_new("as asked").unwrap(),
    };
    let a = client.add(&added).await.unwrap();
    assert_eq!((a.state, a.copies), (State::Queued, 2));
    let b = client.upload(added.path.as_ref(), &NewJob::default()).await.unwrap();
    assert_eq!(client.job(b.id).await.unwrap(), b);
    let listed = client.jobs(Which::Live, None, 1).await.unwrap();
    assert_eq!((listed.jobs[0].id, listed.more), (a.id, true));
    assert_eq!(client.jobs(Which::Live, Some(a.id), 10).await.unwrap().jobs, std::slice::from_ref(&b));
    assert_eq!(client.jobs(Which::Over, None, 10).await.unwrap().jobs, []);
    assert_eq!(client.change(a.id, &anew(Turn::Move(Move::Last))).await.unwrap().id, a.id);
    assert_eq!(client.change(a.id, &anew(Turn::NotBefore { at: None })).await.unwrap().not_before, None);
    assert_eq!(client.history_of(a.id, 0, 10).await.unwrap().records[0].why, added.why);
    assert!(client.history(0, 2).await.unwrap().more);
    assert_eq!(client.schedule().await.unwrap().unplanned.len(), 2);
    site.end().await;
}

#[tokio::test]
async fn printers_and_keys_are_reached_too() {
    let site = Site::open().await;
    let client = client(&site);
    let odd = name("left/über 100 %");
    let loaded = LoadedBody {
        profile: name("marlin"),
        material: crate::queue::Material::try_new("PLA").unwrap(),
        nozzle_um: 400,
        left_mm3: None,
    };
    assert_eq!(client.load(&odd, &loaded).await.unwrap().loaded, Some(loaded));
    let word = BedClear { on_bed: None, name: None, why: Reason::default() };
    assert_eq!(client.clear_bed(&odd, &word).await.unwrap().bed, BedView::Clear);
    assert_eq!(client.doubt_bed(&odd, &Said::default()).await.unwrap().bed, BedView::Unknown);
    assert_eq!(client.printer(&odd).await.unwrap().name, odd);
    assert_eq!(client.printer_history(&odd, 0, 10).await.unwrap().records.len(), 3);
    assert_eq!(client.printers().await.unwrap().printers.len(), 2);
    let new = client.add_key(&KeyBody { name: odd.clone(), access: Access::View }).await.unwrap();
    assert!(!format!("{new:?}").contains(&new.key), "a key must not be logged");
    assert_eq!(client.keys().await.unwrap().keys.len(), 1);
    client.remove_key(&odd).await.unwrap();
    assert_eq!(client.keys().await.unwrap().keys, []);
    site.end().await;
}

#[tokio::test]
async fn a_large_file_is_sent_as_it_is() {
    let site = Site::open().await;
    let path = site.local_file();
    let bytes = "G1 X1.234 Y5.678 E0.1\n".repeat(40_000);
    std::fs::write(&path, &bytes).unwrap();
    let job = client(&site).upload(path.as_ref(), &NewJob::default()).await.unwrap();
    let spec: crate::http::FileSpec =
        serde_json::from_slice(crate::store::Store::spec(&site.app.store, job.id).await.unwrap().bytes())
            .unwrap();
    assert_eq!(std::fs::read_to_string(site.app.files.path(&spec).unwrap()).unwrap(), bytes);
    site.end().await;
}

#[tokio::test]
async fn refusals_keep_their_words_and_codes() {
    let site = Site::open().await;
    let client = client(&site);
    let none = "01890000-0000-7000-8000-000000000000".parse().unwrap();
    let refused = client.job(none).await.unwrap_err();
    assert_eq!((refused.code(), refused.to_string()), ("queue.no_job", format!("there is no job {none}")));
    let missing = client.upload("/nowhere/a.gcode".as_ref(), &NewJob::default()).await.unwrap_err();
    assert_eq!(missing.code(), "client.file");
    site.end().await;
}

#[tokio::test]
async fn over_tcp_it_shows_its_key() {
    let site = Site::with(Edge::default(), true).await;
    let address = site.tcp.unwrap();
    let key = client(&site).add_key(&KeyBody { name: name("me"), access: Access::View }).await.unwrap().key;
    let remote = Client::over_tcp(address, key);
    assert_eq!(remote.whoami().await.unwrap().name, name("me"));
    assert!(!format!("{remote:?}").contains("key"));
    let wrong = Client::over_tcp(address, "5D1F0E8B93A67C25B0D95E8137AC64F2").whoami().await.unwrap_err();
    assert_eq!(wrong.code(), "http.wrong_key");
    site.end().await;
}

#[tokio::test]
async fn a_server_that_is_not_there_is_told_with_what_to_do() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("socket");
    let client = Client::over_socket(&path);
    let expected = format!("no lumenfab server at {}: start it with `lumenfab serve`", path.display());
    assert!(client.status().await.unwrap_err().to_string().starts_with(&expected));
    drop(UnixListener::bind(&path).unwrap());
    assert!(client.status().await.unwrap_err().to_string().starts_with(&expected), "a dead socket");
}

/// A server that answers one thing to everything.
fn answering(path: &Path, body: &'static str) {
    let listener = UnixListener::bind(path).unwrap();
    std::thread::spawn(move || {
        use std::io::{Read, Write};
        for stream in listener.incoming() {
            let Ok(mut stream) = stream else { return };
            let mut head = [0; 1024];
            if stream.read(&mut head).is_err() {
                return;
            }
            let answer = format!("HTTP/1.1 200 OK\r\nContent-Length: {}\r\n\r\n{body}", body.len());
            stream.write_all(answer.as_bytes()).ok();
        }
    });
}

#[tokio::test]
async fn other_versions_and_other_programs_are_told() {
    let dir = tempfile::tempdir().unwrap();
    let (other, foreign) = (dir.path().join("other"), dir.path().join("foreign"));
    answering(&other, r#"{"api": 2, "brave": "new"}"#);
    let told = Client::over_socket(&other).check_version().await.unwrap_err();
    assert_eq!(
        (told.code(), matches!(told, Error::OtherVersion { found: 2 })),
        ("client.other_version", true)
    );
    answering(&foreign, "<html>");
    let told = Client::over_socket(&foreign).check_version().await.unwrap_err();
    assert_eq!(told.code(), "client.not_lumenfab");
}

/// The next record; what printers do meanwhile is passed over.
async fn record(events: &mut Events) -> HistoryView {
    loop {
        match events.next().await.unwrap() {
            Told::Record(record) => return *record,
            Told::Printers(_) => {}
            other => panic!("{other:?}"),
        }
    }
}

#[tokio::test]
async fn events_are_told_as_they_happen() {
    let site = Site::open().await;
    let client = client(&site);
    let mut events = client.events(None);
    assert_eq!(events.next().await.unwrap(), Told::Connected);
    let job = client.upload(site.local_file().as_ref(), &NewJob::default()).await.unwrap();
    let told = record(&mut events).await;
    assert_eq!((told.seq, told.job), (1, Some(job.id)));
    site.lives.send_replace(vec![Live { activity: Activity::Paused, ..idle() }]);
    while !matches!(events.next().await.unwrap(), Told::Printers(lives) if lives[0].activity == Activity::Paused)
    {
    }
    let mut late = client.events(Some(0));
    assert_eq!(late.next().await.unwrap(), Told::Connected);
    assert_eq!(record(&mut late).await.seq, 1);
    site.end().await;
    assert_eq!(events.next().await.unwrap(), Told::Interrupted);
}

#[tokio::test]
async fn nothing_is_missed_over_a_restart_of_the_server() {
    let site = Site::open().await;
    let client = client(&site);
    client.upload(site.local_file().as_ref(), &NewJob::default()).await.unwrap();
    let mut events = client.events(None);
    assert_eq!(events.next().await.unwrap(), Told::Connected);
    let dir = site.end().await;
    while events.next().await.unwrap() != Told::Interrupted {}
    let site = Site::within(dir, Edge::default(), false).await;
    client.upload(site.local_file().as_ref(), &NewJob::default()).await.unwrap();
    assert_eq!(events.next().await.unwrap(), Told::Connected);
    assert_eq!(record(&mut events).await.seq, 2);
    site.end().await;
}
