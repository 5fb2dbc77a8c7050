//! What happens at the server, as it happens; goes on by itself after an interruption (IO).

use super::Error;
use super::sse::{Event, Parser};
use super::wire::{Way, whole};
use crate::http::wire::case::TaskView;
use crate::http::wire::{HistoryView, Live};
use http_body_util::BodyExt;
use hyper::body::{Bytes, Incoming};
use hyper::{Method, header};
use std::collections::VecDeque;
use std::time::Duration;

/// How long the server's answer to begin with is waited for.
const PATIENCE: Duration = Duration::from_secs(10);
/// Longest silence: the server says every fifteen seconds that it is there.
const SILENCE: Duration = Duration::from_secs(45);

/// Something that has happened.
#[derive(Debug, Clone, PartialEq)]
pub enum Told {
    /// The stream begins, or goes on after an interruption; nothing was missed.
    Connected,
    /// Too much was missed: look again.
    Reset,
    /// A record was made.
    Record(Box<HistoryView>),
    /// What printers are doing.
    Printers(Vec<Live>),
    /// How far a task is.
    Task(Box<TaskView>),
    /// The connection is lost; it is tried again.
    Interrupted,
}

/// The events of a server.
#[derive(Debug)]
pub struct Events {
    way: Way,
    body: Option<Incoming>,
    parser: Parser,
    waiting: VecDeque<Event>,
    last_id: Option<String>,
    retry: Duration,
}

impl Events {
    pub(super) fn new(way: Way, after: Option<u64>) -> Self {
        Self {
            way,
            body: None,
            parser: Parser::default(),
            waiting: VecDeque::new(),
            last_id: after.map(|seq| seq.to_string()),
            retry: Duration::ZERO,
        }
    }

    /// What happens next. Waits and connects again by itself where the connection is lost.
    ///
    /// # Errors
    /// [`Error`] where trying again is of no use: the server refuses, or is no lumenfab.
    pub async fn next(&mut self) -> Result<Told, Error> {
        loop {
            if let Some(event) = self.waiting.pop_front() {
                if let Some(told) = self.take(event)? {
                    return Ok(told);
                }
                continue;
            }
            if self.body.is_none() {
                self.connect().await?;
            }
            if self.read().await.is_none() {
                self.body = None;
                self.parser = Parser::default();
                return Ok(Told::Interrupted);
            }
        }
    }

    /// Once there is a connection; the first time, none is an error.
    async fn connect(&mut self) -> Result<(), Error> {
        loop {
            let is_first = self.retry.is_zero();
            tokio::time::sleep(self.retry).await;
            match self.open().await {
                Ok(body) => {
                    self.body = Some(body);
                    self.retry = self.retry.max(Duration::from_secs(1));
                    return Ok(());
                }
                Err(error) if is_first || !is_passing(&error) => return Err(error),
                Err(_passing) => {}
            }
        }
    }

    async fn open(&self) -> Result<Incoming, Error> {
        let mut request =
            self.way.request(Method::GET, "/api/v1/events").header(header::ACCEPT, "text/event-stream");
        if let Some(id) = &self.last_id {
            request = request.header("last-event-id", id);
        }
        let response = self.way.send(request.body(whole(Bytes::new())), Some(PATIENCE)).await?;
        if response.status().is_success() {
            return Ok(response.into_body());
        }
        let body = self.way.body(response).await;
        Err(body.err().unwrap_or_else(|| self.way.unreachable(&"it sends no events")))
    }

    /// `None`: the connection is lost.
    async fn read(&mut self) -> Option<()> {
        let body = self.body.as_mut()?;
        let frame = tokio::time::timeout(SILENCE, body.frame()).await.ok()??.ok()?;
        if let Some(bytes) = frame.data_ref() {
            self.waiting.extend(self.parser.feed(bytes).ok()?);
        }
        Some(())
    }

    fn take(&mut self, event: Event) -> Result<Option<Told>, Error> {
        if let Some(id) = event.id {
            self.last_id = Some(id);
        }
        if let Some(retry_ms) = event.retry_ms {
            self.retry = Duration::from_millis(retry_ms.clamp(100, 60_000));
        }
        Ok(match event.kind.as_str() {
            "hello" => Some(Told::Connected),
            "reset" => Some(Told::Reset),
            "record" => Some(Told::Record(Box::new(self.parsed(&event.data)?))),
            "printer" => Some(Told::Printers(self.parsed(&event.data)?)),
            "task" => Some(Told::Task(Box::new(self.parsed(&event.data)?))),
            _ => None,
        })
    }

    fn parsed<T: serde::de::DeserializeOwned>(&self, data: &str) -> Result<T, Error> {
        let wrong = |e: serde_json::Error| Error::NotLumenfab {
            place: self.way.place.to_string(),
            problem: e.to_string(),
        };
        serde_json::from_str(data).map_err(wrong)
    }
}

/// Whether it may be better soon.
fn is_passing(error: &Error) -> bool {
    match error {
        Error::NoServer { .. } | Error::Unreachable { .. } | Error::Late { .. } => true,
        Error::Refused { status, .. } => *status == 429 || *status >= 500,
        Error::NotYours { .. }
        | Error::OtherVersion { .. }
        | Error::NotLumenfab { .. }
        | Error::File { .. } => false,
    }
}
