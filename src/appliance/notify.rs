//! Telling the operator: a line in the log, and a document to a webhook (IO).
//!
//! What is told holds generated names alone. A webhook that does not answer holds nothing up: each document is tried a few times, and
//! where too many wait the newest are left out, which the log says.

use super::config::Webhook;
use crate::queue::{JobId, Name};
use http_body_util::{BodyExt, Full};
use hyper::body::Bytes;
use hyper::client::conn::http1;
use hyper::{Request, header};
use hyper_util::rt::TokioIo;
use jiff::Timestamp;
use serde::Serialize;
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::sync::{Mutex, mpsc};
use tokio::time::{sleep, timeout};

/// Documents that may wait.
const MOST_WAITING: usize = 64;
/// Attempts for each, how long one may take, and the rest between them at first.
const ATTEMPTS: u32 = 4;
const PATIENCE: Duration = Duration::from_secs(10);
const REST: Duration = Duration::from_secs(2);

/// Something that the operator should know.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(super) struct Told {
    /// A stable name for programs.
    pub(super) event: &'static str,
    pub(super) at: Timestamp,
    pub(super) printer: Option<Name>,
    pub(super) job: Option<JobId>,
    pub(super) text: String,
}

/// Where it is told. Clones are the same.
#[derive(Debug, Clone)]
pub(super) struct News {
    clock: fn() -> Timestamp,
    hook: Option<mpsc::Sender<Told>>,
}

impl News {
    /// With what is to be run beside, where there is a webhook.
    pub(super) fn new(clock: fn() -> Timestamp, webhook: Option<Webhook>) -> (Self, Option<Postman>) {
        let Some(webhook) = webhook else { return (Self { clock, hook: None }, None) };
        let (hook, told) = mpsc::channel(MOST_WAITING);
        (Self { clock, hook: Some(hook) }, Some(Postman { webhook, told: Mutex::new(told) }))
    }

    pub(super) fn tell(&self, event: &'static str, printer: Option<&Name>, job: Option<JobId>, text: &str) {
        let (printer, text) = (printer.cloned(), text.to_owned());
        match (&printer, job) {
            (Some(printer), Some(job)) => tracing::info!(event, %printer, %job, "{text}"),
            (Some(printer), None) => tracing::info!(event, %printer, "{text}"),
            (None, Some(job)) => tracing::info!(event, %job, "{text}"),
            (None, None) => tracing::info!(event, "{text}"),
        }
        let told = Told { event, at: (self.clock)(), printer, job, text };
        if let Some(Err(_full)) = self.hook.as_ref().map(|hook| hook.try_send(told)) {
            tracing::warn!(event, "webhook: too much waits for it: this is left out");
        }
    }
}

/// Carries what is told to the webhook.
#[derive(Debug)]
pub(super) struct Postman {
    webhook: Webhook,
    /// Kept while it is started again.
    told: Mutex<mpsc::Receiver<Told>>,
}

impl Postman {
    /// Until nobody is left who could tell something.
    pub(super) async fn run(&self) {
        let mut waiting = self.told.lock().await;
        while let Some(told) = waiting.recv().await {
            self.carry(&told).await;
        }
    }

    async fn carry(&self, told: &Told) {
        let body = serde_json::to_vec(told).expect("names and texts can be written as JSON");
        let mut rest = REST;
        for attempt in 1..=ATTEMPTS {
            match timeout(PATIENCE, self.post(body.clone())).await {
                Ok(Ok(status)) if (200..300).contains(&status) => return,
                Ok(Ok(status)) => {
                    tracing::warn!(event = told.event, attempt, "webhook: it answered {status}")
                }
                Ok(Err(error)) => tracing::warn!(event = told.event, attempt, "webhook: {error}"),
                Err(_late) => tracing::warn!(event = told.event, attempt, "webhook: no answer"),
            }
            if attempt < ATTEMPTS {
                sleep(rest).await;
                rest *= 2;
            }
        }
        tracing::error!(event = told.event, "webhook: given up");
    }

    async fn post(&self, body: Vec<u8>) -> anyhow::Result<u16> {
        let Webhook { host, port, path } = &self.webhook;
        let bare = host.trim_start_matches('[').trim_end_matches(']');
        let stream = TcpStream::connect((bare, *port)).await?;
        let (mut sender, connection) = http1::handshake(TokioIo::new(stream)).await?;
        let request = Request::post(path)
            .header(header::HOST, format!("{host}:{port}"))
            .header(header::CONTENT_TYPE, "application/json")
            .body(Full::<Bytes>::from(body))?;
        let answered = async {
            let response = sender.send_request(request).await?;
            let status = response.status().as_u16();
            // An answer that is cut off was one all the same.
            response.into_body().collect().await.ok();
            Ok(status)
        };
        tokio::select! {
            answered = answered => answered,
            ended = connection => {
                ended?;
                anyhow::bail!("it closed the connection without an answer")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::TcpListener;

    /// A server that answers one request after the other with these; gives what it was sent.
    async fn server(listener: TcpListener, answers: &[&str]) -> Vec<String> {
        let mut heard = Vec::new();
        for answer in answers {
            let (mut stream, _) = listener.accept().await.unwrap();
            let mut text = String::new();
            while !text.contains("\r\n\r\n") || !text.trim_end().ends_with('}') {
                let mut bytes = [0; 4096];
                let n = stream.read(&mut bytes).await.unwrap();
                assert!(n > 0, "{text}");
                text += std::str::from_utf8(&bytes[..n]).unwrap();
            }
            heard.push(text);
            stream.write_all(answer.as_bytes()).await.unwrap();
        }
        heard
    }

    #[tokio::test]
    async fn what_happens_is_posted_and_posted_again_where_the_server_was_not_well() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        let webhook = Webhook { host: "127.0.0.1".into(), port, path: "/hook?k=1".into() };
        let (news, postman) = News::new(|| Timestamp::UNIX_EPOCH, Some(webhook));
        let carrying = tokio::spawn(async move { postman.unwrap().run().await });
        let job = JobId::at(Timestamp::UNIX_EPOCH, [7; 10]);
        news.tell("printed", Name::try_new("left").ok().as_ref(), Some(job), "done");
        let ok = "HTTP/1.1 204 No Content\r\n\r\n";
        let ill = "HTTP/1.1 503 Service Unavailable\r\ncontent-length: 0\r\n\r\n";
        let heard = server(listener, &[ill, "", ok]).await;
        drop(news);
        carrying.await.unwrap();
        for text in &heard {
            let (head, body) = text.split_once("\r\n\r\n").unwrap();
            assert!(
                head.starts_with("POST /hook?k=1 HTTP/1.1\r\n") && head.contains("application/json"),
                "{head}"
            );
            let body: serde_json::Value = serde_json::from_str(body).unwrap();
            let expected = serde_json::json!({ "event": "printed", "at": "1970-01-01T00:00:00Z", "printer": "left",
                "job": job.to_string(), "text": "done" });
            assert_eq!(body, expected);
        }
        assert_eq!(heard.len(), 3);
    }

    #[tokio::test]
    async fn telling_never_waits() {
        let webhook = Webhook { host: "127.0.0.1".into(), port: 9, path: "/".into() };
        let (news, _postman_who_sleeps) = News::new(|| Timestamp::UNIX_EPOCH, Some(webhook));
        for _ in 0..10 * MOST_WAITING {
            news.tell("printed", None, None, "done");
        }
        let (silent, none) = News::new(|| Timestamp::UNIX_EPOCH, None);
        silent.tell("printed", None, None, "done");
        assert!(none.is_none());
    }
}
