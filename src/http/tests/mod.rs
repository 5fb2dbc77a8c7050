//! Through real sockets, with a real server and a queue in a file.

mod access;
mod cases;
mod edge;
mod flow;
mod octoprint;
mod openapi;
mod uploads;

use super::serve::Listeners;
use super::wire::Live;
use super::*;
use crate::queue::tests::{loaded, name, operator};
use crate::queue::{Change, Claimant, Evidence, JobId, Request, Said};
use crate::store::{Claimed, Sqlite};
use jiff::Timestamp;
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpStream, UnixStream};
use tokio::sync::{mpsc, oneshot, watch};
use tokio::task::JoinHandle;

/// A server in a folder of its own, with one printer, `left`, that does as it is told.
pub(crate) struct Site {
    pub(crate) app: Appliance<Sqlite>,
    pub(crate) socket: PathBuf,
    pub(crate) tcp: Option<SocketAddr>,
    /// What the printers are doing.
    pub(crate) lives: watch::Sender<Vec<Live>>,
    /// What the printer was asked for.
    pub(crate) asked: Arc<Mutex<Vec<String>>>,
    end: Option<oneshot::Sender<()>>,
    served: JoinHandle<()>,
    dir: tempfile::TempDir,
}

pub(crate) fn limits() -> Limits {
    Limits {
        max_bytes: 1 << 20,
        max_time: std::time::Duration::from_secs(5),
        max_silence: std::time::Duration::from_millis(300),
        at_once: 4,
        reserve_bytes: 0,
    }
}

pub(crate) fn idle() -> Live {
    let heat = wire::Heat { actual_c: 21.5, target_c: 0.0 };
    Live {
        activity: wire::Activity::Idle,
        port: Some("/dev/ttyACM0".into()),
        baud: Some(250_000),
        hotend: Some(heat),
        bed: Some(heat),
        ..Live::offline(name("left"))
    }
}

impl Site {
    pub(crate) async fn open() -> Self {
        Self::with(Edge::default(), false).await
    }

    pub(crate) async fn with(edge: Edge, is_tcp: bool) -> Self {
        Self::within(tempfile::tempdir().unwrap(), edge, is_tcp).await
    }

    /// Where one was before.
    pub(crate) async fn within(dir: tempfile::TempDir, edge: Edge, is_tcp: bool) -> Self {
        Self::limited(dir, edge, is_tcp, limits()).await
    }

    async fn limited(dir: tempfile::TempDir, edge: Edge, is_tcp: bool, limits: Limits) -> Self {
        let store = Sqlite::open(&dir.path().join("queue.db")).unwrap();
        let files = Files::open(&dir.path().join("files"), limits).unwrap();
        let keys = Keys::open(&dir.path().join("keys.toml")).unwrap();
        if is_tcp {
            keys.add_given(name("slicer"), wire::Access::Operate, access::OPERATE).unwrap();
        }
        let (printers, desk) = Printers::channel();
        let mut app = Appliance::new(store, printers, files, keys);
        let setup = crate::http::cases::Setup {
            ct_folders: vec![dir.path().join("ct")],
            state: dir.path().to_owned(),
            program: dir.path().join("program"),
            threads: 1,
            nice: 0,
        };
        app.cases = Some(crate::http::cases::Cases::open(setup, app.events.clone()).unwrap());
        let socket = dir.path().join("socket");
        let tcp = if is_tcp { vec!["127.0.0.1:0".parse().unwrap()] } else { Vec::new() };
        let listen = Listen { socket: Some(socket.clone()), tcp };
        let listeners = Listeners::bind(&listen, &app.keys).await.unwrap();
        let tcp = listeners.addresses().first().copied();
        let (end, ended) = oneshot::channel::<()>();
        let served = app.clone();
        let served = tokio::spawn(async move {
            serve(listeners, served, edge, async { drop(ended.await) }).await.unwrap();
        });
        let asked = Arc::new(Mutex::new(Vec::new()));
        let PrinterDesk { lives, wishes } = desk;
        lives.send_replace(vec![idle()]);
        tokio::spawn(obey(wishes, Arc::clone(&asked)));
        Self { app, socket, tcp, lives, asked, end: Some(end), served, dir }
    }

    /// Ends it, and waits until it has; its folder is left.
    pub(crate) async fn end(mut self) -> tempfile::TempDir {
        drop(self.end.take());
        self.served.await.unwrap();
        self.dir
    }

    /// Everything that lies in the folder of files.
    fn files(&self) -> Vec<String> {
        let found = std::fs::read_dir(self.dir.path().join("files")).unwrap();
        let mut names: Vec<_> =
            found.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    /// Sends bytes as they are; the answer until the server closes.
    async fn raw(&self, bytes: &[u8]) -> Answer {
        let mut stream = UnixStream::connect(&self.socket).await.unwrap();
        // A server that refuses early may have closed before all is sent.
        stream.write_all(bytes).await.ok();
        Answer::read(stream).await
    }

    pub(crate) async fn ask(&self, method: &str, path: &str, body: Option<Value>) -> Answer {
        self.raw(request(method, path, body, "").as_bytes()).await
    }

    async fn get(&self, path: &str) -> Answer {
        self.ask("GET", path, None).await
    }

    async fn post(&self, path: &str, body: Value) -> Answer {
        self.ask("POST", path, Some(body)).await
    }

    async fn tcp(&self, bytes: &[u8]) -> Answer {
        let mut stream = TcpStream::connect(self.tcp.unwrap()).await.unwrap();
        stream.write_all(bytes).await.unwrap();
        Answer::read(stream).await
    }

    /// A file of G-code that the server can read, under a name that nobody may see.
    pub(crate) fn local_file(&self) -> String {
        let path = self.dir.path().join("MEIER_JOSEF_1950.gcode");
        std::fs::write(&path, "G28\nG1 X1 E1\n").unwrap();
        path.to_str().unwrap().to_owned()
    }

    /// A job of it.
    pub(crate) async fn added(&self, is_submitted: bool) -> JobId {
        self.added_with(is_submitted, json!({})).await
    }

    async fn added_with(&self, is_submitted: bool, wishes: Value) -> JobId {
        let body = json!({ "path": self.local_file(), "submit": is_submitted, "wishes": wishes });
        let added = self.post("/api/v1/jobs", body).await;
        assert_eq!(added.status, 201, "{added:?}");
        added.json()["id"].as_str().unwrap().parse().unwrap()
    }

    /// A job that is in the printer's hands, on a bed that was clear.
    async fn in_print(&self) -> (JobId, Claimed) {
        self.in_print_with(json!({})).await
    }

    async fn in_print_with(&self, wishes: Value) -> (JobId, Claimed) {
        let id = self.added_with(true, wishes).await;
        let store = &self.app.store;
        let worker = Claimant::Worker(name("worker"));
        let by = |claim, change| Request {
            change,
            actor: crate::queue::Actor::Holder { claim, asked_by: None },
            why: Default::default(),
            now: Timestamp::now(),
        };
        let prepared = store.claim(worker, Timestamp::now()).await.unwrap().unwrap();
        let made = crate::queue::tests::made();
        store.change(id, by(prepared.claim, Change::Prepared(made))).await.unwrap();
        store.say(name("left"), Said::Loaded(loaded()), operator(0)).await.unwrap();
        store.say(name("left"), Said::BedClear(Evidence::Word), operator(0)).await.unwrap();
        let printer = Claimant::Printer(name("left"));
        let claimed = store.claim(printer, Timestamp::now()).await.unwrap().unwrap();
        store.change(id, by(claimed.claim.clone(), Change::Lay)).await.unwrap();
        (id, claimed)
    }

    /// The copy in print is printed.
    async fn printed(&self, id: JobId, claimed: Claimed) {
        let actor = crate::queue::Actor::Holder { claim: claimed.claim, asked_by: None };
        let change = Change::Printed { used_mm3: None };
        let request = Request { change, actor, why: Default::default(), now: Timestamp::now() };
        self.app.store.change(id, request).await.unwrap();
    }
}

/// A printer that says yes to everything.
async fn obey(mut wishes: mpsc::Receiver<appliance::Wished>, asked: Arc<Mutex<Vec<String>>>) {
    while let Some(wished) = wishes.recv().await {
        asked.lock().unwrap().push(format!("{:?} by {}", wished.wish, wished.by));
        wished.answer.send(Ok(())).ok();
    }
}

fn request(method: &str, path: &str, body: Option<Value>, headers: &str) -> String {
    let body = body.map(|body| body.to_string()).unwrap_or_default();
    let (n_bytes, close) = (body.len(), "Connection: close\r\n");
    let kind = if body.is_empty() { "" } else { "Content-Type: application/json\r\n" };
    format!(
        "{method} {path} HTTP/1.1\r\nHost: lab\r\n{close}{kind}{headers}Content-Length: {n_bytes}\r\n\r\n{body}"
    )
}

/// What a server has answered.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) status: u16,
    head: String,
    body: String,
}

impl Answer {
    async fn read(mut stream: impl tokio::io::AsyncRead + Unpin) -> Self {
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).await.ok();
        let text = String::from_utf8(bytes).unwrap();
        let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
        let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0);
        Self { status, head: head.to_ascii_lowercase(), body: body.to_owned() }
    }

    #[track_caller]
    pub(crate) fn json(&self) -> Value {
        serde_json::from_str(&self.body).unwrap_or_else(|e| panic!("{e}: {self:?}"))
    }

    /// Status and code of a refusal, in the one shape.
    #[track_caller]
    fn refusal(&self) -> (u16, String) {
        let body = self.json();
        let error = body["error"].as_object().unwrap();
        assert_eq!(error.keys().collect::<Vec<_>>(), ["code", "message"]);
        assert!(!error["message"].as_str().unwrap().is_empty());
        (self.status, error["code"].as_str().unwrap().to_owned())
    }
}

/// What a refusal is to be.
fn no(status: u16, code: &str) -> (u16, String) {
    (status, code.to_owned())
}
