//! Files that come over the wire: multipart, written as they come, bounded in size, time and silence.

use super::appliance::Appliance;
use super::error::Problem;
use super::files::{FileKind, Files, Kept, Part, too_large};
use super::wire::WishesBody;
use crate::queue::{By, Job, JobId, Reason, Refusal, Ticket, Who};
use crate::store::{self, Store};
use axum::body::{Body, Bytes};
use axum::extract::multipart::{Field, Multipart, MultipartError, MultipartRejection};
use axum::extract::{FromRequest, Request};
use axum::http::{StatusCode, header};
use futures_util::StreamExt;
use std::convert::Infallible;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::time::Duration;
use tokio::time::timeout;

/// Longest field beside the file, bytes.
const MAX_FIELD: usize = 1 << 14;
/// Most fields.
const MAX_FIELDS: usize = 32;
/// What surrounds the file in a request, bytes at most.
const ENVELOPE: u64 = 1 << 16;
/// Bytes that are read at most before a part of the form shows in them.
const MAX_AHEAD: usize = 1 << 24;
/// Bytes that are gathered before they are written.
const CHUNK: usize = 1 << 18;

/// Where the file of a job is.
#[derive(Debug)]
pub(super) enum Source {
    /// It has come over the wire.
    Sent(Part, FileKind),
    /// A file or a case directory of this machine.
    Local(PathBuf),
}

impl Source {
    /// Blocks.
    fn keep(self, files: &Files, id: JobId) -> Result<Kept, Problem> {
        match self {
            Self::Sent(part, kind) => part.keep(id, kind),
            Self::Local(path) if path.is_dir() => files.link(&path, id),
            Self::Local(path) => files.copy(&path, id),
        }
    }
}

/// A job to be added.
#[derive(Debug)]
pub(super) struct Upload {
    pub(super) source: Source,
    /// Its name, where the caller makes it.
    pub(super) id: Option<JobId>,
    pub(super) wishes: WishesBody,
    /// Whether it goes into the queue at once.
    pub(super) submit: bool,
    pub(super) why: Reason,
}

/// Fields beside the file.
#[derive(Debug, Default)]
struct Fields {
    id: Option<JobId>,
    wishes: WishesBody,
    submit: bool,
    why: Reason,
}

/// A form, read as it comes.
#[derive(Debug)]
pub(super) struct Form {
    parts: Result<Multipart, MultipartRejection>,
    n_announced: Option<u64>,
    /// Bytes that were read since a part of the form was understood.
    n_ahead: Arc<AtomicUsize>,
}

impl<S: Send + Sync> FromRequest<S> for Form {
    type Rejection = Infallible;

    async fn from_request(request: Request, app: &S) -> Result<Self, Infallible> {
        let announced = request.headers().get(header::CONTENT_LENGTH);
        let n_announced = announced.and_then(|value| value.to_str().ok()?.parse().ok());
        let n_ahead = Arc::new(AtomicUsize::new(0));
        let counter = Arc::clone(&n_ahead);
        let bounded = request.map(|body| {
            Body::from_stream(body.into_data_stream().map(move |bytes| bounded(bytes, &counter)))
        });
        Ok(Self { parts: Multipart::from_request(bounded, app).await, n_announced, n_ahead })
    }
}

/// Whoever sends what is never understood as a part must not fill the memory.
fn bounded(bytes: Result<Bytes, axum::Error>, n_ahead: &AtomicUsize) -> Result<Bytes, axum::Error> {
    let bytes = bytes?;
    if n_ahead.fetch_add(bytes.len(), Relaxed) > MAX_AHEAD {
        return Err(axum::Error::new("no part of the form ends"));
    }
    Ok(bytes)
}

/// Takes a whole upload. Where anything is wrong with it, nothing is left.
pub(super) async fn take<S: Store>(app: &Appliance<S>, form: Form) -> Result<Upload, Problem> {
    let limits = app.files.limits();
    if form.n_announced.is_some_and(|n_bytes| n_bytes > limits.max_bytes.saturating_add(ENVELOPE)) {
        return Err(too_large(limits.max_bytes));
    }
    let (files, n_bytes) = (app.files.clone(), form.n_announced.unwrap_or(1).saturating_sub(ENVELOPE));
    on_disk(move || files.check_room(n_bytes)).await?;
    let parts = form.parts.map_err(|e| malformed(&e.body_text()))?;
    let reader = Reader { parts, n_ahead: form.n_ahead, patience: limits.max_silence };
    timeout(limits.max_time, reader.read(&app.files)).await.map_err(|_late| too_slow())?
}

/// Makes a job of it. A caller that leaves meanwhile breaks nothing off half-way.
pub(super) async fn add<S: Store>(app: &Appliance<S>, upload: Upload, who: Who) -> Result<Job, Problem> {
    let app = app.clone();
    let added = tokio::spawn(async move { added(&app, upload, who).await });
    added.await.map_err(|panicked| Problem::inside("adding a job", &panicked))?
}

async fn added<S: Store>(app: &Appliance<S>, upload: Upload, who: Who) -> Result<Job, Problem> {
    let Upload { source, id, wishes, submit, why } = upload;
    let id = match id {
        Some(id) => id,
        None => app.new_id().map_err(|e| Problem::inside("naming a job", &e))?,
    };
    let files = app.files.clone();
    let kept = on_disk(move || source.keep(&files, id)).await?;
    let by = By { who, why, now: app.now() };
    let added = match kept.spec() {
        Ok(spec) => {
            let ticket = Ticket { id, spec, wishes: wishes.into(), made: None };
            app.store.add(ticket, submit, by).await.map_err(Problem::from)
        }
        Err(problem) => Err(problem),
    };
    // Where the queue has a job of this name all the same, the file is that job's.
    if added.is_err() && is_unknown(app.store.job(id).await) {
        on_disk(move || {
            kept.discard();
            Ok(())
        })
        .await?;
    }
    app.events.look();
    added
}

fn is_unknown<T>(found: Result<T, store::Error>) -> bool {
    matches!(found, Err(store::Error::Refused(Refusal::NoJob { .. })))
}

/// Does something that waits for the disk beside the async tasks.
pub(super) async fn on_disk<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    let done = tokio::task::spawn_blocking(work).await;
    done.map_err(|panicked| Problem::inside("writing a file", &panicked))?
}

/// Reads a form, part by part.
struct Reader {
    parts: Multipart,
    n_ahead: Arc<AtomicUsize>,
    patience: Duration,
}

impl Reader {
    async fn read(mut self, files: &Files) -> Result<Upload, Problem> {
        let mut fields = Fields::default();
        let mut source = None;
        let Self { parts, n_ahead, patience } = &mut self;
        for _ in 0..MAX_FIELDS {
            let next = timeout(*patience, parts.next_field()).await.map_err(|_late| too_slow())?;
            let Some(field) = next.map_err(|e| broken(&e))? else {
                let Fields { id, wishes, submit, why } = fields;
                let source = source.ok_or_else(no_file)?;
                return Ok(Upload { source, id, wishes, submit, why });
            };
            let mut part = FormPart { field, n_ahead, patience: *patience };
            match part.field.name().unwrap_or_default() {
                "file" if source.is_some() => return Err(malformed("more than one file")),
                "file" => source = Some(part.file(files).await?),
                name => {
                    let name = name.to_owned();
                    fields.take(&name, &part.text().await?)?;
                }
            }
        }
        Err(malformed("too many fields"))
    }
}

impl Fields {
    /// Fields that nobody knows are passed over: slicers send some of their own.
    fn take(&mut self, name: &str, text: &str) -> Result<(), Problem> {
        match name {
            "id" => self.id = Some(text.parse().map_err(|_no_id| malformed("the field id is no UUID"))?),
            "wishes" => {
                let wrong = |e: serde_json::Error| malformed(&format!("the field wishes: {e}"));
                self.wishes = serde_json::from_str(text).map_err(wrong)?;
            }
            "print" | "submit" => self.submit = text.eq_ignore_ascii_case("true") || text == "1",
            "why" => self.why = Reason::try_new(text)?,
            // A folder of its own is not made, for its name may tell of a patient.
            "path" | "foldername" if is_outside(text) => {
                return Err(Problem::bad(
                    "http.bad_name",
                    "found a path that leads out of the folder of files",
                ));
            }
            _ => {}
        }
        Ok(())
    }
}

fn is_outside(path: &str) -> bool {
    path.starts_with("//") || path.contains(['\\', '\0']) || path.split('/').any(|part| part == "..")
}

/// One part of a form.
struct FormPart<'a> {
    field: Field<'a>,
    n_ahead: &'a AtomicUsize,
    patience: Duration,
}

impl FormPart<'_> {
    async fn bytes(&mut self) -> Result<Option<Bytes>, Problem> {
        let bytes = timeout(self.patience, self.field.chunk()).await.map_err(|_late| too_slow())?;
        self.n_ahead.store(0, Relaxed);
        bytes.map_err(|e| broken(&e))
    }

    async fn file(&mut self, files: &Files) -> Result<Source, Problem> {
        let kind = FileKind::of(self.field.file_name().ok_or_else(no_file)?)?;
        let files = files.clone();
        let mut part = on_disk(move || files.begin()).await?;
        let mut waiting: Vec<Bytes> = Vec::new();
        let mut n_waiting = 0;
        while let Some(bytes) = self.bytes().await? {
            n_waiting += bytes.len();
            waiting.push(bytes);
            if n_waiting >= CHUNK {
                part = written(part, std::mem::take(&mut waiting)).await?;
                n_waiting = 0;
            }
        }
        Ok(Source::Sent(written(part, waiting).await?, kind))
    }

    async fn text(&mut self) -> Result<String, Problem> {
        let mut text = Vec::new();
        while let Some(bytes) = self.bytes().await? {
            text.extend_from_slice(&bytes);
            if text.len() > MAX_FIELD {
                return Err(malformed("a field is too long"));
            }
        }
        String::from_utf8(text).map_err(|_not_utf8| malformed("a field is not UTF-8"))
    }
}

async fn written(mut part: Part, waiting: Vec<Bytes>) -> Result<Part, Problem> {
    on_disk(move || {
        waiting.iter().try_for_each(|bytes| part.write(bytes))?;
        Ok(part)
    })
    .await
}

fn no_file() -> Problem {
    Problem::bad("http.no_file", "found no file, expected a form with the field \"file\" and its filename")
}

fn malformed(what: &str) -> Problem {
    Problem::bad("http.malformed", format!("the upload cannot be read: {what}"))
}

/// The request ended or went wrong within its body.
fn broken(error: &MultipartError) -> Problem {
    if error.status() == StatusCode::PAYLOAD_TOO_LARGE {
        return Problem::new(StatusCode::PAYLOAD_TOO_LARGE, "http.too_large", "the upload is too large");
    }
    malformed("it is cut off, or its parts do not fit its boundary")
}

fn too_slow() -> Problem {
    let message = "the upload took too long, or stopped: check the connection, then send it again";
    Problem::new(StatusCode::REQUEST_TIMEOUT, "http.too_slow", message)
}
