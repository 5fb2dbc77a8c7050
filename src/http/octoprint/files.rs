//! `/api/files`: jobs as files.

use super::the_printer;
use crate::http::access::{Caller, Operator, Viewer};
use crate::http::appliance::Appliance;
use crate::http::error::Problem;
use crate::http::extract::Body;
use crate::http::files::{FileSpec, FileSum};
use crate::http::jobs::{MOST, turn};
use crate::http::upload::{self, Form};
use crate::http::wire::{Anew, Turn};
use crate::queue::{Job, JobId, Reason, SpecKind, State, Who};
use crate::store::{Store, Which};
use axum::Json;
use axum::extract::{Path, State as App};
use axum::http::{HeaderMap, HeaderName, StatusCode, header};
use serde::Deserialize;
use serde_json::{Value, json};

/// The name that a job has as a file.
pub(super) fn name_of(job: &Job) -> String {
    let ending = match job.spec.kind {
        SpecKind::Gcode => "gcode",
        SpecKind::Mesh => "stl",
        SpecKind::Case => "case",
    };
    format!("{}.{ending}", job.id)
}

/// The job that is meant by a name.
fn job_of(name: &str) -> Result<JobId, Problem> {
    let stem = name.split_once('.').map_or(name, |(stem, _)| stem);
    let nothing = || Problem::new(StatusCode::NOT_FOUND, "http.not_found", "there is no file of this name");
    stem.parse().map_err(|_no_id| nothing())
}

/// Where the server is, as the caller sees it.
fn base(headers: &HeaderMap) -> String {
    let host = headers.get(header::HOST).and_then(|host| host.to_str().ok());
    format!("http://{}", host.filter(|host| !host.is_empty()).unwrap_or("localhost"))
}

fn resource(headers: &HeaderMap, name: &str) -> String {
    format!("{}/api/files/local/{name}", base(headers))
}

/// A whole entry of a listing.
async fn entry<S: Store>(app: &Appliance<S>, headers: &HeaderMap, job: &Job) -> Result<Value, Problem> {
    let name = name_of(job);
    let mut entry = described(headers, job);
    if let Some(FileSum { blake3, len }) = sum(app, job.id).await? {
        entry["hash"] = json!(blake3);
        entry["size"] = json!(len);
    }
    entry["date"] = json!(job.added.as_second());
    entry["display"] = json!(name);
    if let Some(estimate) = job.estimate() {
        entry["gcodeAnalysis"] = json!({
            "estimatedPrintTime": estimate.print_s,
            "filament": { "tool0": filament(estimate.filament_mm3) },
        });
    }
    if job.n_printed > 0 || job.state == State::Failed {
        let is_good = job.state != State::Failed;
        entry["print"] = json!({
            "success": job.n_printed,
            "failure": u8::from(!is_good),
            "last": { "date": job.changed.as_second(), "success": is_good },
        });
    }
    Ok(entry)
}

/// Length (of 1.75 mm) and volume, mm and cm³.
pub(super) fn filament(mm3: u64) -> Value {
    let mm3 = i32::try_from(mm3).map_or(f64::MAX, f64::from);
    let section_mm2 = std::f64::consts::PI * (1.75_f64 / 2.0).powi(2);
    json!({ "length": mm3 / section_mm2, "volume": mm3 / 1000.0 })
}

fn described(headers: &HeaderMap, job: &Job) -> Value {
    let name = name_of(job);
    let kind = match job.spec.kind {
        SpecKind::Gcode => ["machinecode", "gcode"],
        SpecKind::Mesh => ["model", "stl"],
        SpecKind::Case => ["model", "case"],
    };
    json!({
        "name": name,
        "path": name,
        "type": kind[0],
        "typePath": kind,
        "origin": "local",
        "refs": { "resource": resource(headers, &name) },
    })
}

pub(super) async fn sum<S: Store>(app: &Appliance<S>, id: JobId) -> Result<Option<FileSum>, Problem> {
    let spec = app.store.spec(id).await?;
    let file = serde_json::from_slice::<FileSpec>(spec.bytes()).ok();
    Ok(file.and_then(|file| file.bytes))
}

pub(super) async fn list<S: Store>(
    App(app): App<Appliance<S>>,
    viewer: Viewer,
    headers: HeaderMap,
) -> Result<Json<Value>, Problem> {
    list_local(App(app), viewer, headers).await
}

/// Jobs that are not over: what is over can be found in the history.
pub(super) async fn list_local<S: Store>(
    App(app): App<Appliance<S>>,
    _viewer: Viewer,
    headers: HeaderMap,
) -> Result<Json<Value>, Problem> {
    let jobs = app.store.list(Which::Live, None, MOST).await?;
    let mut files = Vec::with_capacity(jobs.len());
    for job in &jobs {
        files.push(entry(&app, &headers, job).await?);
    }
    let kept = app.files.clone();
    let free =
        upload::on_disk(move || kept.free_bytes().map_err(|e| Problem::inside("measuring the disk", &e)));
    let free = free.await?;
    Ok(Json(json!({ "files": files, "free": free })))
}

pub(super) async fn show<S: Store>(
    App(app): App<Appliance<S>>,
    _viewer: Viewer,
    Path(name): Path<String>,
    headers: HeaderMap,
) -> Result<Json<Value>, Problem> {
    let (job, _claim) = app.store.job(job_of(&name)?).await?;
    entry(&app, &headers, &job).await.map(Json)
}

/// What a slicer sends.
pub(super) async fn upload<S: Store>(
    App(app): App<Appliance<S>>,
    Operator(caller): Operator,
    headers: HeaderMap,
    form: Form,
) -> Result<(StatusCode, [(HeaderName, String); 1], Json<Value>), Problem> {
    let taken = upload::take(&app, form).await?;
    let job = upload::add(&app, taken, Who::Operator(caller.name)).await?;
    app.select(Some(job.id));
    let is_queued = job.state != State::Draft;
    let told = json!({
        "files": { "local": described(&headers, &job) },
        "done": true,
        "effectiveSelect": true,
        "effectivePrint": is_queued,
    });
    let location = resource(&headers, &name_of(&job));
    Ok((StatusCode::CREATED, [(header::LOCATION, location)], Json(told)))
}

/// A command to a file.
#[derive(Debug, Deserialize)]
#[serde(tag = "command", rename_all = "lowercase")]
pub(super) enum FileCommand {
    /// The job commands mean this one.
    Select {
        /// And it is to be printed.
        #[serde(default)]
        print: bool,
    },
    /// Back to none.
    Unselect,
}

pub(super) async fn command<S: Store>(
    App(app): App<Appliance<S>>,
    Operator(caller): Operator,
    Path(name): Path<String>,
    Body(command): Body<FileCommand>,
) -> Result<StatusCode, Problem> {
    let (job, _claim) = app.store.job(job_of(&name)?).await?;
    match command {
        FileCommand::Unselect => app.select(None),
        FileCommand::Select { print } => {
            app.select(Some(job.id));
            if print {
                queue(&app, &caller, job.id).await?;
            }
        }
    }
    Ok(StatusCode::NO_CONTENT)
}

/// A job is to be printed: into the queue with it, where it is not there yet.
pub(super) async fn queue<S: Store>(app: &Appliance<S>, caller: &Caller, id: JobId) -> Result<(), Problem> {
    let (job, _claim) = app.store.job(id).await?;
    let asked = match job.state {
        State::Draft => Turn::Submit,
        State::Held => Turn::Release,
        State::Failed | State::Cancelled => Turn::Retry,
        State::Queued | State::Preparing => return Ok(()),
        State::Printing
        | State::Paused
        | State::AwaitingBedClear
        | State::AwaitingSignOff
        | State::Finished => {
            let message = format!("the job is {}: it is not printed again", job.state);
            return Err(Problem::conflict("queue.not_in_state", message));
        }
    };
    let anew = Anew { turn: asked, saw: Some(job.state), name: None, why: Reason::default() };
    turn(app, caller, id, anew).await.map(drop)
}

/// A file that is deleted is a job that is called off; what is being printed is not.
pub(super) async fn delete<S: Store>(
    App(app): App<Appliance<S>>,
    Operator(caller): Operator,
    Path(name): Path<String>,
) -> Result<StatusCode, Problem> {
    let (job, _claim) = app.store.job(job_of(&name)?).await?;
    if job.state.is_at_printer() {
        let printer =
            the_printer(&app).map_or_else(|_none| "a printer".to_owned(), |live| live.name.to_string());
        let message = format!("{printer} is printing it: cancel the print first");
        return Err(Problem::conflict("http.in_print", message));
    }
    if !job.state.is_over() {
        let anew = Anew { turn: Turn::Cancel, saw: Some(job.state), name: None, why: Reason::default() };
        turn(&app, &caller, job.id, anew).await?;
    }
    Ok(StatusCode::NO_CONTENT)
}
