//! Uploads, good and bad: what is not good leaves nothing.

use super::*;
use std::time::Duration;

const BOUNDARY: &str = "------------------------d74496d66958873e";

/// A field of a form.
fn field(name: &str, value: &str) -> String {
    format!("--{BOUNDARY}\r\nContent-Disposition: form-data; name=\"{name}\"\r\n\r\n{value}\r\n")
}

fn file(name: &str, bytes: &str) -> String {
    let disposition = format!("Content-Disposition: form-data; name=\"file\"; filename=\"{name}\"");
    format!("--{BOUNDARY}\r\n{disposition}\r\nContent-Type: application/octet-stream\r\n\r\n{bytes}\r\n")
}

/// The whole request, as curl writes it.
fn form(path: &str, parts: &str) -> String {
    let body = format!("{parts}--{BOUNDARY}--\r\n");
    format!(
        "POST {path} HTTP/1.1\r\nHost: lab\r\nUser-Agent: PrusaSlicer/2.9.0\r\nAccept: */*\r\nConnection: close\r\n\
         X-Api-Key: unused-over-the-socket\r\nContent-Length: {}\r\nContent-Type: multipart/form-data; boundary={BOUNDARY}\r\n\r\n{body}",
        body.len()
    )
}

async fn sent(site: &Site, parts: &str) -> Answer {
    site.raw(form("/api/v1/jobs/upload", parts).as_bytes()).await
}

/// Nothing may be left: neither file nor job.
async fn nothing_left(site: &Site) {
    for _ in 0..50 {
        if site.files().is_empty() {
            break;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert_eq!(site.files(), [""; 0]);
    assert_eq!(site.get("/api/v1/jobs").await.json()["jobs"], json!([]));
}

#[tokio::test]
async fn a_file_that_is_sent_becomes_a_job() {
    let site = Site::open().await;
    let wishes = field("wishes", r#"{"copies": 2, "needs": {"material": "abs"}}"#);
    let added = sent(&site, &(field("submit", "true") + &wishes + &file("MEIER.GCO", "G28\n"))).await;
    let job = added.json();
    assert_eq!((added.status, &job["state"], &job["copies"]), (201, &json!("queued"), &json!(2)));
    assert_eq!(job["needs"]["material"], "ABS");
    let id = job["id"].as_str().unwrap();
    assert_eq!(site.files(), [format!("{id}.gcode")]);
    let spec = site.app.store.spec(id.parse().unwrap()).await.unwrap();
    let spec: FileSpec = serde_json::from_slice(spec.bytes()).unwrap();
    let kept = std::fs::read(site.app.files.path(&spec).unwrap()).unwrap();
    let sum = spec.bytes.unwrap();
    assert_eq!(
        (kept.as_slice(), sum.len, sum.blake3),
        (b"G28\n".as_slice(), 4, crate::queue::Digest::of(b"G28\n"))
    );
    site.end().await;
}

#[tokio::test]
async fn exactly_what_prusaslicer_sends_is_taken() {
    let site = Site::open().await;
    let parts = field("print", "true")
        + &field("path", "")
        + &file("Shape-Box_0.2mm_PLA_MK3S_10m.gcode", "G28\nG1 X1\n");
    let told = site.raw(form("/api/files/local", &parts).as_bytes()).await;
    assert_eq!(told.status, 201, "{told:?}");
    let id = site.get("/api/v1/jobs").await.json()["jobs"][0]["id"].as_str().unwrap().to_owned();
    let name = format!("{id}.gcode");
    assert!(told.head.contains(&format!("location: http://lab/api/files/local/{name}")), "{told:?}");
    let resource = format!("http://lab/api/files/local/{name}");
    let local = json!({
        "name": name, "path": name, "type": "machinecode", "typePath": ["machinecode", "gcode"],
        "origin": "local", "refs": { "resource": resource },
    });
    let expected = json!({
        "files": { "local": local }, "done": true, "effectiveSelect": true, "effectivePrint": true,
    });
    assert_eq!(told.json(), expected);
    assert_eq!(site.get(&format!("/api/v1/jobs/{id}")).await.json()["state"], "queued");
    site.end().await;
}

#[tokio::test]
async fn a_slicer_may_wait_to_be_asked_for_the_body() {
    let site = Site::open().await;
    let whole = form("/api/files/local", &(field("print", "false") + &file("a.gcode", "G28\n")));
    let (head, body) = whole.split_once("\r\n\r\n").unwrap();
    let mut stream = UnixStream::connect(&site.socket).await.unwrap();
    stream.write_all(format!("{head}\r\nExpect: 100-continue\r\n\r\n").as_bytes()).await.unwrap();
    let mut go_on = [0; 25];
    stream.read_exact(&mut go_on).await.unwrap();
    assert_eq!(&go_on, b"HTTP/1.1 100 Continue\r\n\r\n");
    stream.write_all(body.as_bytes()).await.unwrap();
    assert_eq!(Answer::read(stream).await.status, 201);
    site.end().await;
}

#[tokio::test]
async fn bad_forms_are_refused_and_leave_nothing() {
    let site = Site::open().await;
    let good = || file("a.gcode", "G28\n");
    for (parts, expected) in [
        (field("print", "true"), no(400, "http.no_file")),
        (file("a.exe", "MZ"), no(415, "http.unknown_kind")),
        (file("../a.gcode", "G28"), no(400, "http.bad_name")),
        (file("/etc/cron.d/a.gcode", "G28"), no(400, "http.bad_name")),
        (file("a.gcode", ""), no(400, "http.empty_file")),
        (field("path", "../../etc") + &good(), no(400, "http.bad_name")),
        (good() + &field("path", "..\\.."), no(400, "http.bad_name")),
        (good() + &good(), no(400, "http.malformed")),
        (good() + &field("wishes", "{\"copies\": 0}"), no(422, "queue.copies")),
        (good() + &field("wishes", "{"), no(400, "http.malformed")),
        (good() + &field("id", "me"), no(400, "http.malformed")),
        (good() + &field("why", &"x".repeat(501)), no(422, "queue.text")),
        (good() + &field("other", &"x".repeat(20_000)), no(400, "http.malformed")),
        (good() + &field("x", "").repeat(40), no(400, "http.malformed")),
        (file("a.gcode", &"G1 X1\n".repeat(180_000)), no(413, "http.too_large")),
    ] {
        let refused = sent(&site, &parts).await;
        assert_eq!(refused.refusal(), expected, "{}", &parts[..parts.len().min(300)]);
        nothing_left(&site).await;
    }
    let no_form = site.post("/api/v1/jobs/upload", json!({})).await;
    assert_eq!(no_form.refusal(), no(400, "http.malformed"));
    site.end().await;
}

#[tokio::test]
async fn what_is_announced_too_large_is_refused_before_it_is_sent() {
    let site = Site::open().await;
    let head = format!(
        "POST /api/files/local HTTP/1.1\r\nHost: lab\r\nConnection: close\r\nContent-Length: 99999999999\r\n\
         Content-Type: multipart/form-data; boundary={BOUNDARY}\r\n\r\n"
    );
    assert_eq!(site.raw(head.as_bytes()).await.refusal(), no(413, "http.too_large"));
    nothing_left(&site).await;
    site.end().await;
}

#[tokio::test]
async fn an_upload_that_stops_is_given_up() {
    let site = Site::open().await;
    let whole = form("/api/files/local", &file("a.gcode", &"G1 X1\n".repeat(1000)));
    let mut stream = UnixStream::connect(&site.socket).await.unwrap();
    stream.write_all(&whole.as_bytes()[..2000]).await.unwrap();
    assert_eq!(Answer::read(stream).await.refusal(), no(408, "http.too_slow"));
    nothing_left(&site).await;
    site.end().await;
}

#[tokio::test]
async fn an_upload_that_drips_is_given_up() {
    let site = Site::open().await;
    let whole = form("/api/files/local", &file("a.gcode", &"G1 X1\n".repeat(10_000)));
    let stream = UnixStream::connect(&site.socket).await.unwrap();
    let (reader, mut writer) = stream.into_split();
    let drip = tokio::spawn(async move {
        for bytes in whole.as_bytes().chunks(500) {
            if writer.write_all(bytes).await.is_err() {
                break;
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    });
    assert_eq!(Answer::read(reader).await.refusal(), no(408, "http.too_slow"));
    drip.abort();
    nothing_left(&site).await;
    site.end().await;
}

#[tokio::test]
async fn an_upload_that_breaks_off_leaves_nothing() {
    let site = Site::open().await;
    let whole = form("/api/files/local", &file("a.gcode", &"G1 X1\n".repeat(1000)));
    for cut in [300, 600, 3000, whole.len() - 5] {
        let mut stream = UnixStream::connect(&site.socket).await.unwrap();
        stream.write_all(&whole.as_bytes()[..cut]).await.unwrap();
        drop(stream);
        nothing_left(&site).await;
    }
    // Less than announced, but with its end in sight: the boundary at the end is missing.
    let torn = whole.replace(&format!("--{BOUNDARY}--\r\n"), &" ".repeat(BOUNDARY.len() + 6));
    assert_eq!(site.raw(torn.as_bytes()).await.refusal(), no(400, "http.malformed"));
    nothing_left(&site).await;
    site.end().await;
}

#[tokio::test]
async fn more_uploads_than_allowed_at_once_have_to_wait() {
    let site = Site::open().await;
    let held: Vec<_> = (0..limits().at_once).map(|_| site.app.files.begin().unwrap()).collect();
    assert_eq!(sent(&site, &file("a.gcode", "G28\n")).await.refusal(), no(503, "http.too_many_uploads"));
    drop(held);
    nothing_left(&site).await;
    assert_eq!(sent(&site, &file("a.gcode", "G28\n")).await.status, 201);
    site.end().await;
}

#[tokio::test]
async fn a_form_that_never_comes_to_a_part_is_given_up() {
    // Patient, so that the bound on memory is what ends it.
    let minute = Duration::from_secs(60);
    let limits = Limits { max_bytes: 1 << 30, max_time: minute, max_silence: minute, ..limits() };
    let site = Site::limited(tempfile::tempdir().unwrap(), Edge::default(), false, limits).await;
    let mut stream = UnixStream::connect(&site.socket).await.unwrap();
    let head = format!(
        "POST /api/files/local HTTP/1.1\r\nHost: lab\r\nTransfer-Encoding: chunked\r\nConnection: close\r\n\
         Content-Type: multipart/form-data; boundary={BOUNDARY}\r\n\r\n"
    );
    stream.write_all(head.as_bytes()).await.unwrap();
    let begin = format!("--{BOUNDARY}\r\nContent-Disposition: form-data; name=\"");
    let begin = format!("{:x}\r\n{begin}\r\n", begin.len());
    stream.write_all(begin.as_bytes()).await.unwrap();
    let chunk = format!("{:x}\r\n{}\r\n", 1 << 20, "x".repeat(1 << 20));
    let (reader, mut writer) = stream.into_split();
    let sender = tokio::spawn(async move {
        let mut n_sent = 0;
        while n_sent < 200 && writer.write_all(chunk.as_bytes()).await.is_ok() {
            n_sent += 1;
        }
        n_sent
    });
    assert_eq!(Answer::read(reader).await.refusal(), no(400, "http.malformed"));
    assert!(sender.await.unwrap() < 100, "it was read on and on");
    nothing_left(&site).await;
    site.end().await;
}

#[tokio::test]
async fn files_of_which_no_job_was_made_go_at_the_next_start() {
    let site = Site::open().await;
    let id = site.added(false).await;
    let dir = site.end().await;
    let none = crate::queue::tests::id(7);
    std::fs::write(dir.path().join(format!("files/{none}.gcode")), "G28\n").unwrap();
    let site = Site::within(dir, Edge::default(), false).await;
    for _ in 0..100 {
        if site.files().len() == 1 {
            break;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert_eq!(site.files(), [format!("{id}.gcode")]);
    site.end().await;
}

/// What is logged on this thread, on which the whole server runs here.
#[derive(Clone, Default)]
struct Log(Arc<Mutex<Vec<u8>>>);

impl std::io::Write for Log {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[tokio::test]
async fn names_of_files_are_neither_logged_nor_answered_nor_kept() {
    let log = Log::default();
    let writer = log.clone();
    let subscriber =
        tracing_subscriber::fmt().with_max_level(tracing::Level::TRACE).with_writer(move || writer.clone());
    let _guard = tracing::subscriber::set_default(subscriber.finish());
    let site = Site::open().await;
    let mut answers = Vec::new();
    for name in ["MEIER.gcode", "../MEIER.gcode", "MEIER.exe"] {
        answers.push(sent(&site, &file(name, "G28\n")).await.body);
        let parts = field("path", "MEIER/1950") + &file(name, "G28\n");
        answers.push(site.raw(form("/api/files/local", &parts).as_bytes()).await.body);
        answers.push(site.get("/api/files/local/MEIER.gcode").await.body);
    }
    answers.push(site.post("/api/v1/jobs", json!({ "path": site.local_file() })).await.body);
    answers.push(site.post("/api/v1/jobs", json!({ "path": "/home/MEIER/none.gcode" })).await.body);
    answers.push(site.get("/api/v1/history").await.body);
    answers.push(site.get("/api/files").await.body);
    site.app.store.clone().close().await;
    answers.push(sent(&site, &file("MEIER.gcode", "G28\n")).await.body);
    let logged = String::from_utf8(log.0.lock().unwrap().clone()).unwrap();
    assert!(logged.contains("the store of the queue has ended"), "the log is listened to: {logged}");
    for text in answers.iter().chain([&logged]) {
        assert!(!text.contains("MEIER"), "{text}");
    }
    assert!(site.files().iter().all(|name| !name.contains("MEIER")));
    site.end().await;
}
