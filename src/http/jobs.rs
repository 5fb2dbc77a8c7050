//! `/api/v1/jobs`: listing, adding, changing.

use super::access::{Caller, Operator, Viewer};
use super::appliance::{Appliance, Unheard, Wish, WishOf};
use super::error::Problem;
use super::extract::{Asked, Body, OfJob};
use super::upload::{self, Form, Source, Upload};
use super::wire::{Added, Anew, ErrorBody, HistoryPage, HistoryView, JobList, JobView, Move, Turn};
use crate::queue::{Actor, Change, Claim, Edit, Job, JobId, Name, Reason, Request, State, Subject, Who};
use crate::store::{Place, Store, Which};
use axum::Json;
use axum::extract::{self};
use axum::http::StatusCode;
use serde::Deserialize;
use std::path::PathBuf;
use utoipa::ToSchema;

/// Most entries of one answer.
pub(super) const MOST: u32 = 500;

/// Which jobs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Listed {
    /// Those that are not over, in the order of the queue.
    #[default]
    Live,
    /// Those that are over, the last one first.
    Over,
}

/// A part of a listing.
#[derive(Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct ListQuery {
    /// Which jobs: `live` or `over`.
    which: Listed,
    /// Only those behind this one.
    behind: Option<JobId>,
    /// How many at most, up to 500.
    most: u32,
}

impl Default for ListQuery {
    fn default() -> Self {
        Self { which: Listed::Live, behind: None, most: 100 }
    }
}

/// Lists jobs.
#[utoipa::path(get, path = "/api/v1/jobs", tag = "jobs",
    params(("which" = Option<String>, Query, description = "`live` (in the order of the queue) or `over` (the last one first)"),
        ("behind" = Option<String>, Query, description = "Only those behind this job of the same listing"),
        ("most" = Option<u32>, Query, description = "How many at most, up to 500")),
    responses((status = 200, body = JobList), (status = "4XX", body = ErrorBody)))]
pub(super) async fn list<S: Store>(
    extract::State(app): extract::State<Appliance<S>>,
    _viewer: Viewer,
    Asked(query): Asked<ListQuery>,
) -> Result<Json<JobList>, Problem> {
    let which = match query.which {
        Listed::Live => Which::Live,
        Listed::Over => Which::Over,
    };
    let most = query.most.clamp(1, MOST);
    let mut jobs = app.store.list(which, query.behind, most + 1).await?;
    let more = jobs.len() > most as usize;
    jobs.truncate(most as usize);
    Ok(Json(JobList { jobs: jobs.iter().map(Into::into).collect(), more }))
}

/// Shows one job.
#[utoipa::path(get, path = "/api/v1/jobs/{id}", tag = "jobs", params(("id" = String, Path, description = "Name of the job")),
    responses((status = 200, body = JobView), (status = 404, body = ErrorBody)))]
pub(super) async fn show<S: Store>(
    extract::State(app): extract::State<Appliance<S>>,
    _viewer: Viewer,
    OfJob(id): OfJob,
) -> Result<Json<JobView>, Problem> {
    let (job, _claim) = app.store.job(id).await?;
    Ok(Json((&job).into()))
}

/// Adds a job of something on the server's own disk; only over the socket.
#[utoipa::path(post, path = "/api/v1/jobs", tag = "jobs", request_body = Added,
    responses((status = 201, body = JobView), (status = "4XX", body = ErrorBody)))]
pub(super) async fn add<S: Store>(
    extract::State(app): extract::State<Appliance<S>>,
    Operator(caller): Operator,
    Body(added): Body<Added>,
) -> Result<(StatusCode, Json<JobView>), Problem> {
    if !caller.is_local {
        let message = "a path of the server is taken over its socket alone: upload the file";
        return Err(Problem::new(StatusCode::FORBIDDEN, "http.local_only", message));
    }
    let Added { path, id, wishes, submit, why } = added;
    let path = PathBuf::from(path);
    if !path.is_absolute() {
        return Err(Problem::bad("http.bad_name", "found a relative path, expected one from the root"));
    }
    let upload = Upload { source: Source::Local(path), id, wishes, submit, why };
    let job = upload::add(&app, upload, Who::Operator(caller.name)).await?;
    Ok((StatusCode::CREATED, Json((&job).into())))
}

/// A form with the file of a job.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "describes the form")]
pub(super) struct UploadForm {
    /// G-code (`.gcode`, `.gco`, `.g`) or a mesh (`.stl`, `.3mf`); of its name only the ending is looked at.
    #[schema(value_type = String, format = Binary)]
    file: Vec<u8>,
    /// `true`: into the queue at once.
    submit: Option<bool>,
    /// Wishes in JSON, as for a local file.
    wishes: Option<String>,
    /// The job's name, where the caller makes it.
    id: Option<String>,
    /// Why.
    why: Option<String>,
}

/// Adds a job of a file that is sent along.
#[utoipa::path(post, path = "/api/v1/jobs/upload", tag = "jobs",
    request_body(content = UploadForm, content_type = "multipart/form-data"),
    responses((status = 201, body = JobView), (status = "4XX", body = ErrorBody)))]
pub(super) async fn upload<S: Store>(
    extract::State(app): extract::State<Appliance<S>>,
    Operator(caller): Operator,
    form: Form,
) -> Result<(StatusCode, Json<JobView>), Problem> {
    let upload = upload::take(&app, form).await?;
    let job = upload::add(&app, upload, Who::Operator(caller.name)).await?;
    Ok((StatusCode::CREATED, Json((&job).into())))
}

/// Changes a job.
#[utoipa::path(post, path = "/api/v1/jobs/{id}/changes", tag = "jobs", request_body = Anew,
    params(("id" = String, Path, description = "Name of the job")),
    responses((status = 200, body = JobView), (status = 202, description = "The printer was asked", body = JobView),
        (status = "4XX", body = ErrorBody)))]
pub(super) async fn change<S: Store>(
    extract::State(app): extract::State<Appliance<S>>,
    Operator(caller): Operator,
    OfJob(id): OfJob,
    Body(anew): Body<Anew>,
) -> Result<(StatusCode, Json<JobView>), Problem> {
    let (status, job) = turn(&app, &caller, id, anew).await?;
    Ok((status, Json((&job).into())))
}

/// Does what is asked of a job, or has it done by the printer that has it in hand.
pub(super) async fn turn<S: Store>(
    app: &Appliance<S>,
    caller: &Caller,
    id: JobId,
    anew: Anew,
) -> Result<(StatusCode, Job), Problem> {
    let name = caller.named(anew.name.as_ref())?;
    if matches!(anew.turn, Turn::Accept | Turn::Reject) && anew.name.is_none() {
        let message = "a sign-off needs the name of the person who has looked at the report";
        return Err(Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "http.no_name", message));
    }
    let (job, claim) = app.store.job(id).await?;
    if let Some(wish) = for_printer(anew.turn, &job, claim.as_ref(), app) {
        check_seen(anew.saw, &job)?;
        ask(app, &job, wish?, name, anew.why).await?;
        return Ok((StatusCode::ACCEPTED, job));
    }
    let saw = anew.saw.unwrap_or(job.state);
    let actor = Actor::Operator { name, saw };
    let (now, why) = (app.now(), anew.why);
    let changed = match asked(anew.turn) {
        Asks::Change(change) => app.store.change(id, Request { change, actor, why, now }).await,
        Asks::Place(place) => app.store.place(id, place, actor, why, now).await,
    };
    app.events.look();
    Ok((StatusCode::OK, changed?))
}

fn check_seen(saw: Option<State>, job: &Job) -> Result<(), Problem> {
    match saw {
        Some(saw) if saw != job.state => {
            Err(crate::queue::Refusal::ChangedMeanwhile { saw, found: job.state }.into())
        }
        _ => Ok(()),
    }
}

/// What has to be asked of a printer. `Cancel` of a job whose printer is not heard of any more is for the queue; one that a printer of
/// this server has in hand is never, whatever the clock says of its claim.
fn for_printer<S: Store>(
    turn: Turn,
    job: &Job,
    claim: Option<&Claim>,
    app: &Appliance<S>,
) -> Option<Result<Wish, Problem>> {
    let is_heard_of = claim.is_some_and(|claim| !claim.has_lapsed(app.now()))
        || job.holder.as_ref().and_then(|holder| app.printers.find(holder)?.job) == Some(job.id);
    let is_in_hand = job.state.is_at_printer() && is_heard_of;
    let wish = match turn {
        Turn::Pause => Wish::Pause,
        Turn::GoOn => Wish::GoOn,
        Turn::Cancel if is_in_hand => Wish::Cancel,
        _ => return None,
    };
    let not_printing = || {
        let message = format!("the job is {}: there is nothing to pause", job.state);
        Problem::conflict("http.not_printing", message)
    };
    Some(if is_in_hand { Ok(wish) } else { Err(not_printing()) })
}

pub(super) async fn ask<S: Store>(
    app: &Appliance<S>,
    job: &Job,
    wish: Wish,
    by: Name,
    why: Reason,
) -> Result<(), Problem> {
    let no_holder = || Problem::conflict("http.not_printing", "no printer has the job");
    let printer = job.holder.clone().ok_or_else(no_holder)?;
    Ok(app.printers.ask(WishOf { printer, job: Some(job.id), wish, by, why }).await?)
}

impl From<Unheard> for Problem {
    fn from(unheard: Unheard) -> Self {
        let message = unheard.to_string();
        match unheard {
            Unheard::NoPrinter { .. } => Self::conflict("http.not_here", message),
            Unheard::NotNow(_) => Self::conflict("http.not_now", message),
            Unheard::NoAnswer => Self::busy("http.no_answer", message, 5),
        }
    }
}

/// What is asked of the store.
enum Asks {
    Change(Change),
    Place(Place),
}

fn asked(turn: Turn) -> Asks {
    Asks::Change(match turn {
        Turn::Submit => Change::Submit,
        Turn::Hold => Change::Hold,
        Turn::Release => Change::Release,
        Turn::Cancel => Change::Cancel { used_mm3: None },
        Turn::Retry => Change::Retry,
        Turn::Fail => Change::Fail { used_mm3: None },
        Turn::Pause => Change::Pause,
        Turn::GoOn => Change::GoOn,
        Turn::Accept => Change::Accept,
        Turn::Reject => Change::Reject,
        Turn::Priority(priority) => Change::Edit(Edit::Priority(priority)),
        Turn::NotBefore { at } => Change::Edit(Edit::NotBefore(at)),
        Turn::Copies(copies) => Change::Edit(Edit::Copies(copies)),
        Turn::Move(to) => return Asks::Place(place(to)),
    })
}

const fn place(to: Move) -> Place {
    match to {
        Move::First => Place::First,
        Move::Last => Place::Last,
        Move::Before(other) => Place::Before(other),
        Move::Behind(other) => Place::Behind(other),
    }
}

/// A part of the history.
#[derive(Debug, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct HistoryQuery {
    /// Only records behind this number.
    after: u64,
    /// How many at most, up to 500.
    most: u32,
}

impl Default for HistoryQuery {
    fn default() -> Self {
        Self { after: 0, most: 100 }
    }
}

/// Who did what to a job, when and why.
#[utoipa::path(get, path = "/api/v1/jobs/{id}/history", tag = "history",
    params(("id" = String, Path, description = "Name of the job"),
        ("after" = Option<u64>, Query, description = "Only records behind this number"),
        ("most" = Option<u32>, Query, description = "How many at most, up to 500")),
    responses((status = 200, body = HistoryPage), (status = "4XX", body = ErrorBody)))]
pub(super) async fn history_of<S: Store>(
    extract::State(app): extract::State<Appliance<S>>,
    _viewer: Viewer,
    OfJob(id): OfJob,
    Asked(query): Asked<HistoryQuery>,
) -> Result<Json<HistoryPage>, Problem> {
    app.store.job(id).await?;
    page(&app, Some(Subject::Job(id)), &query).await
}

/// Who did what, when and why.
#[utoipa::path(get, path = "/api/v1/history", tag = "history",
    params(("after" = Option<u64>, Query, description = "Only records behind this number"),
        ("most" = Option<u32>, Query, description = "How many at most, up to 500")),
    responses((status = 200, body = HistoryPage), (status = "4XX", body = ErrorBody)))]
pub(super) async fn history<S: Store>(
    extract::State(app): extract::State<Appliance<S>>,
    _viewer: Viewer,
    Asked(query): Asked<HistoryQuery>,
) -> Result<Json<HistoryPage>, Problem> {
    page(&app, None, &query).await
}

pub(super) async fn page<S: Store>(
    app: &Appliance<S>,
    of: Option<Subject>,
    query: &HistoryQuery,
) -> Result<Json<HistoryPage>, Problem> {
    let most = query.most.clamp(1, MOST);
    let mut found = app.store.history(of, query.after, most + 1).await?;
    let more = found.len() > most as usize;
    found.truncate(most as usize);
    let shown = found.into_iter().map(|sealed| {
        let fact = sealed.record().map_err(crate::store::Error::from)?.fact;
        Ok(HistoryView::new(sealed.seq, fact, sealed.digest))
    });
    Ok(Json(HistoryPage { records: shown.collect::<Result<_, Problem>>()?, more }))
}
