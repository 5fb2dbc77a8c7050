//! Sockets, limits, events, the end.

use super::*;
use crate::http::serve::BindError;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::{Duration, Instant};

/// A stream of events, read as it comes.
struct Stream(UnixStream, String);

impl Stream {
    async fn open(site: &Site, headers: &str) -> Self {
        let mut stream = UnixStream::connect(&site.socket).await.unwrap();
        let head = format!("GET /api/v1/events HTTP/1.1\r\nHost: lab\r\n{headers}\r\n");
        stream.write_all(head.as_bytes()).await.unwrap();
        Self(stream, String::new())
    }

    /// Reads until something has come; whether it has.
    async fn sees(&mut self, text: &str) -> bool {
        let mut bytes = [0; 4096];
        while !self.1.contains(text) {
            match tokio::time::timeout(Duration::from_secs(20), self.0.read(&mut bytes)).await {
                Ok(Ok(n_bytes)) if n_bytes > 0 => self.1 += std::str::from_utf8(&bytes[..n_bytes]).unwrap(),
                _ => return false,
            }
        }
        true
    }
}

#[tokio::test]
async fn the_socket_is_its_owners_alone_and_goes_with_the_server() {
    let site = Site::open().await;
    let socket = site.socket.clone();
    assert_eq!(std::fs::metadata(&socket).unwrap().permissions().mode() & 0o777, 0o600);
    // The folder outlives the server here, so that what is gone went by itself.
    let dir = site.end().await;
    assert!(dir.path().exists() && !socket.exists());
}

async fn bind(socket: &Path) -> Result<Listeners, BindError> {
    let dir = tempfile::tempdir().unwrap();
    let keys = Keys::open(&dir.path().join("keys.toml")).unwrap();
    Listeners::bind(&Listen { socket: Some(socket.to_owned()), tcp: vec![] }, &keys).await
}

#[tokio::test]
async fn a_dead_socket_is_replaced_and_a_living_one_is_not() {
    let dir = tempfile::tempdir().unwrap();
    let socket = dir.path().join("socket");
    drop(std::os::unix::net::UnixListener::bind(&socket).unwrap());
    assert!(socket.exists(), "a dead process leaves its socket");
    let alive = bind(&socket).await.unwrap();
    let second = bind(&socket).await.unwrap_err();
    assert!(matches!(second, BindError::InUse { .. }), "{second}");
    assert_eq!(alive.path(), Some(socket.as_path()));
    drop(alive);

    let _other_program = std::os::unix::net::UnixListener::bind(&socket).unwrap();
    assert!(matches!(bind(&socket).await.unwrap_err(), BindError::InUse { .. }));
    let file = dir.path().join("file");
    std::fs::write(&file, "precious").unwrap();
    assert!(matches!(bind(&file).await.unwrap_err(), BindError::NotASocket { .. }));
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "precious");
}

#[tokio::test]
async fn whoever_sends_no_whole_head_is_left() {
    let edge = Edge { header_time: Duration::from_millis(200), ..Edge::default() };
    let site = Site::with(edge, false).await;
    for bytes in ["", "GET /api/v1/status HTTP/1.1\r\nHost: l"] {
        let mut stream = UnixStream::connect(&site.socket).await.unwrap();
        stream.write_all(bytes.as_bytes()).await.unwrap();
        let mut rest = Vec::new();
        let closed = tokio::time::timeout(Duration::from_secs(20), stream.read_to_end(&mut rest)).await;
        assert!(closed.is_ok(), "{bytes:?} is still waited for");
    }
    site.end().await;
}

#[tokio::test]
async fn what_is_no_http_and_what_is_too_long_is_refused() {
    let site = Site::open().await;
    assert_eq!(site.raw(b"M115\r\n\r\n").await.status, 400);
    let long = format!("GET /{} HTTP/1.1\r\nHost: lab\r\n\r\n", "x".repeat(100_000));
    let refused = site.raw(long.as_bytes()).await.status;
    assert!([414, 431].contains(&refused), "{refused}");
    let large = json!({ "path": "x".repeat(200_000) });
    assert_eq!(site.post("/api/v1/jobs", large).await.refusal(), no(413, "http.too_large"));
    let text = request("POST", "/api/v1/jobs", None, "Content-Type: text/plain\r\n");
    assert_eq!(site.raw(text.as_bytes()).await.refusal(), no(415, "http.no_json"));
    site.end().await;
}

#[tokio::test]
async fn connections_beyond_the_limit_wait_for_their_turn() {
    let edge = Edge { max_connections: 2, header_time: Duration::from_millis(500), ..Edge::default() };
    let site = Site::with(edge, false).await;
    let idle =
        [UnixStream::connect(&site.socket).await.unwrap(), UnixStream::connect(&site.socket).await.unwrap()];
    // Served once the idle ones are left.
    assert_eq!(site.get("/api/v1/health").await.status, 200);
    drop(idle);
    site.end().await;
}

#[tokio::test]
async fn events_tell_what_happens_and_go_on_where_they_ended() {
    let site = Site::open().await;
    let mut stream = Stream::open(&site, "").await;
    assert!(stream.sees("event: hello").await && stream.1.contains("id: 0\n"), "{}", stream.1);
    let id = site.added(true).await;
    assert!(stream.sees("id: 2\n").await, "{}", stream.1);
    assert!(stream.1.contains(&format!("\"job\":\"{id}\"")), "{}", stream.1);
    site.lives.send_replace(vec![Live { activity: wire::Activity::Paused, ..idle() }]);
    assert!(stream.sees("\"activity\":\"paused\"").await, "{}", stream.1);
    drop(stream);
    site.added(false).await;
    let mut again = Stream::open(&site, "Last-Event-ID: 1\r\n").await;
    assert!(again.sees("id: 3\n").await, "{}", again.1);
    assert_eq!(again.1.matches("event: record").count(), 2, "{}", again.1);
    let mut reset = Stream::open(&site, "Last-Event-ID: 99\r\n").await;
    assert!(reset.sees("event: reset").await, "{}", reset.1);
    site.end().await;
}

#[tokio::test]
async fn what_other_processes_record_is_told_too() {
    let site = Site::open().await;
    let mut stream = Stream::open(&site, "").await;
    assert!(stream.sees("event: hello").await);
    let ticket = crate::queue::tests::ticket(1);
    let other = Sqlite::open(&site.dir.path().join("queue.db")).unwrap();
    other.add(ticket, false, operator(0)).await.unwrap();
    assert!(stream.sees("id: 1\n").await, "{}", stream.1);
    site.end().await;
}

#[tokio::test]
async fn a_reader_that_sleeps_is_dropped_and_nobody_waits_for_it() {
    let edge = Edge { stall_time: Duration::from_millis(500), ..Edge::default() };
    let site = Site::with(edge, false).await;
    let asleep = Stream::open(&site, "").await;
    let mut awake = Stream::open(&site, "").await;
    assert!(awake.sees("event: hello").await);
    // More than socket, server and news hold for one reader.
    let long = Live { says: Some("x".repeat(100_000)), ..idle() };
    for round in 0..20 {
        let port = Some(format!("round-{round}"));
        site.lives.send_replace(vec![Live { port, ..long.clone() }]);
        assert!(awake.sees(&format!("round-{round}\"")).await, "round {round}");
    }
    for _ in 0..100 {
        if site.app.events.n_readers() == 1 {
            break;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    assert_eq!(site.app.events.n_readers(), 1, "the one that sleeps holds its place");
    drop(asleep);
    site.end().await;
}

#[tokio::test]
async fn a_hundred_streams_hold_nobody_up_and_more_than_allowed_are_refused() {
    let site = Site::open().await;
    let mut streams = Vec::new();
    for _ in 0..100 {
        let mut stream = Stream::open(&site, "").await;
        assert!(stream.sees("event: hello").await);
        streams.push(stream);
    }
    let mut took = Vec::new();
    #[expect(clippy::disallowed_methods, reason = "measured to be told, not to be judged")]
    for _ in 0..200 {
        let begun = Instant::now();
        assert_eq!(site.get("/api/v1/jobs").await.status, 200);
        took.push(begun.elapsed());
    }
    let id = site.added(true).await;
    for stream in &mut streams {
        assert!(stream.sees(&format!("\"job\":\"{id}\"")).await);
    }
    took.sort();
    let (p50, p99) = (took[took.len() / 2], took[took.len() * 99 / 100]);
    eprintln!("GET /api/v1/jobs with 100 streams open: p50 {p50:?}, p99 {p99:?}");
    for _ in 0..28 {
        let mut stream = Stream::open(&site, "").await;
        assert!(stream.sees("event: hello").await);
        streams.push(stream);
    }
    assert_eq!(site.get("/api/v1/events").await.refusal(), no(503, "http.too_many_streams"));
    drop(streams);
    site.end().await;
}

#[tokio::test]
async fn the_end_waits_for_what_is_under_way_and_ends_streams() {
    let site = Site::open().await;
    let mut stream = Stream::open(&site, "").await;
    assert!(stream.sees("event: hello").await);
    let body = json!({ "path": site.local_file() }).to_string();
    let head = format!(
        "POST /api/v1/jobs HTTP/1.1\r\nHost: lab\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\r\n",
        body.len()
    );
    let mut under_way = UnixStream::connect(&site.socket).await.unwrap();
    under_way.write_all(head.as_bytes()).await.unwrap();
    // The server has read the head, so that the request is under way.
    assert_eq!(site.get("/api/v1/health").await.status, 200);
    tokio::time::sleep(Duration::from_millis(200)).await;
    let (socket, store) = (site.socket.clone(), site.app.store.clone());
    let finish = async {
        tokio::time::sleep(Duration::from_millis(200)).await;
        under_way.write_all(body.as_bytes()).await.unwrap();
        Answer::read(under_way).await
    };
    let (answer, streams_end, _dir) = tokio::join!(finish, async { !stream.sees("never").await }, site.end());
    assert_eq!((answer.status, streams_end), (201, true));
    assert!(UnixStream::connect(&socket).await.is_err());
    assert_eq!(store.list(crate::store::Which::Live, None, 9).await.unwrap().len(), 1);
}

#[tokio::test]
async fn faces_of_which_a_part_ends_say_so_and_can_be_started_again() {
    let mut site = Site::open().await;
    assert_eq!(site.get("/api/v1/health").await.status, 200);
    site.app.events.end();
    let ended = (&mut site.served).await.unwrap_err();
    assert!(ended.into_panic().downcast_ref::<String>().unwrap().contains("Part"));
    let site = Site::within(site.dir, Edge::default(), false).await;
    assert_eq!(site.get("/api/v1/health").await.status, 200);
    site.end().await;
}
