//! Handlers of folders, tasks and cases.

use super::super::access::{Operator, Viewer};
use super::super::appliance::Appliance;
use super::super::error::Problem;
use super::super::extract::Body;
use super::super::upload::{self, Source, Upload, on_disk};
use super::super::wire::ErrorBody;
use super::super::wire::case::{
    Begun, CaseJob, CaseList, CaseToQueue, CaseView, FolderList, FolderPath, FolderView, Handle, NewCase,
    SeriesBody, StagesBody, TaskKind, TaskList, TaskView, VolumeView,
};
use super::tasks::New;
use super::{Cases, in_use, nothing_of_this_name};
use crate::app::Stage;
use crate::app::errand::{self, Errand};
use crate::app::settings::CaseFile;
use crate::profile;
use crate::queue::Who;
use crate::store::Store;
use axum::Json;
use axum::extract::{Path, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde_json::{Value, json};
use std::path::PathBuf;

pub(super) fn cases<S: Store>(app: &Appliance<S>) -> Result<Cases, Problem> {
    let none = || Problem::new(StatusCode::NOT_FOUND, "http.no_cases", "this server works on no cases");
    app.cases.clone().ok_or_else(none)
}

pub(super) fn handle(text: &str) -> Result<Handle, Problem> {
    text.parse().map_err(|_no_handle| nothing_of_this_name())
}

/// The folders that CTs lie below. Names of folders, which may be patients', are not shown.
#[utoipa::path(get, path = "/api/v1/folders", tag = "cases",
    responses((status = 200, body = FolderList), (status = "4XX", body = ErrorBody)))]
pub(in crate::http) async fn folders<S: Store>(
    State(app): State<Appliance<S>>,
    _operator: Operator,
) -> Result<Json<FolderList>, Problem> {
    let cases = cases(&app)?;
    let folders = on_disk(move || cases.0.folders.roots()).await?;
    Ok(Json(FolderList { folders }))
}

/// A folder by its path; only over the socket, whose callers may read the disk themselves.
#[utoipa::path(post, path = "/api/v1/folders", tag = "cases", request_body = FolderPath,
    responses((status = 200, body = FolderView), (status = "4XX", body = ErrorBody)))]
pub(in crate::http) async fn find_folder<S: Store>(
    State(app): State<Appliance<S>>,
    Operator(caller): Operator,
    Body(FolderPath { path }): Body<FolderPath>,
) -> Result<Json<FolderView>, Problem> {
    if !caller.is_local {
        let message = "a path of the server is taken over its socket alone";
        return Err(Problem::new(StatusCode::FORBIDDEN, "http.local_only", message));
    }
    let cases = cases(&app)?;
    on_disk(move || cases.0.folders.find(&PathBuf::from(path))).await.map(Json)
}

/// The folders in a folder.
#[utoipa::path(get, path = "/api/v1/folders/{id}", tag = "cases", params(("id" = String, Path, description = "Name of the folder")),
    responses((status = 200, body = FolderList), (status = "4XX", body = ErrorBody)))]
pub(in crate::http) async fn folder<S: Store>(
    State(app): State<Appliance<S>>,
    _operator: Operator,
    Path(id): Path<String>,
) -> Result<Json<FolderList>, Problem> {
    let (cases, id) = (cases(&app)?, handle(&id)?);
    let folders = on_disk(move || cases.0.folders.within(&id)).await?;
    Ok(Json(FolderList { folders }))
}

/// Finds the series of a folder; the task's result is what `lumenfab inspect --json` says.
#[utoipa::path(post, path = "/api/v1/folders/{id}/inspection", tag = "cases", params(("id" = String, Path, description = "Name of the folder")),
    responses((status = 202, body = TaskView), (status = "4XX", body = ErrorBody)))]
pub(in crate::http) async fn inspect<S: Store>(
    State(app): State<Appliance<S>>,
    _operator: Operator,
    Path(id): Path<String>,
) -> Result<(StatusCode, Json<TaskView>), Problem> {
    let cases = cases(&app)?;
    let folder = folder_of(&cases, handle(&id)?).await?;
    let (kind, errand) = (TaskKind::Inspect, Errand::Inspect { folder });
    Ok(accepted(cases.0.tasks.begin(New { kind, case: None, errand, finish: Box::new(Ok) })?))
}

/// Reads a series, so that its planes can be looked at; the task's result has the volume. The last two volumes are kept.
#[utoipa::path(post, path = "/api/v1/folders/{id}/volume", tag = "cases", params(("id" = String, Path, description = "Name of the folder")),
    request_body = SeriesBody, responses((status = 202, body = TaskView), (status = "4XX", body = ErrorBody)))]
pub(in crate::http) async fn read_volume<S: Store>(
    State(app): State<Appliance<S>>,
    _operator: Operator,
    Path(id): Path<String>,
    Body(SeriesBody { series, allow_gaps }): Body<SeriesBody>,
) -> Result<(StatusCode, Json<TaskView>), Problem> {
    let cases = cases(&app)?;
    let folder = folder_of(&cases, handle(&id)?).await?;
    check_room(&app).await?;
    let (volume, to) = cases.0.kept.new_volume()?;
    let errand = Errand::Planes { folder, series, allow_gaps, to };
    let kept = cases.clone();
    let finish = Box::new(move |mut result: Value| {
        result["volume"] = json!(kept.0.kept.keep_volume(&volume)?);
        Ok(result)
    });
    Ok(accepted(cases.0.tasks.begin(New { kind: TaskKind::Planes, case: None, errand, finish })?))
}

/// The geometry of a volume.
#[utoipa::path(get, path = "/api/v1/volumes/{id}", tag = "cases", params(("id" = String, Path, description = "Name of the volume")),
    responses((status = 200, body = VolumeView), (status = "4XX", body = ErrorBody)))]
pub(in crate::http) async fn volume<S: Store>(
    State(app): State<Appliance<S>>,
    _operator: Operator,
    Path(id): Path<String>,
) -> Result<Json<VolumeView>, Problem> {
    let (cases, id) = (cases(&app)?, handle(&id)?);
    on_disk(move || cases.0.kept.volume(&id)).await.map(Json)
}

/// Tasks: those under way, and the last ones that are over.
#[utoipa::path(get, path = "/api/v1/tasks", tag = "cases",
    responses((status = 200, body = TaskList), (status = "4XX", body = ErrorBody)))]
pub(in crate::http) async fn tasks<S: Store>(
    State(app): State<Appliance<S>>,
    _viewer: Viewer,
) -> Result<Json<TaskList>, Problem> {
    Ok(Json(TaskList { tasks: cases(&app)?.0.tasks.all() }))
}

/// A task.
#[utoipa::path(get, path = "/api/v1/tasks/{id}", tag = "cases", params(("id" = String, Path, description = "Name of the task")),
    responses((status = 200, body = TaskView), (status = "4XX", body = ErrorBody)))]
pub(in crate::http) async fn task<S: Store>(
    State(app): State<Appliance<S>>,
    _viewer: Viewer,
    Path(id): Path<String>,
) -> Result<Json<TaskView>, Problem> {
    Ok(Json(cases(&app)?.0.tasks.find(&handle(&id)?)?))
}

/// Ends a task; what it has done so far of its stages stays.
#[utoipa::path(delete, path = "/api/v1/tasks/{id}", tag = "cases", params(("id" = String, Path, description = "Name of the task")),
    responses((status = 202, body = TaskView), (status = "4XX", body = ErrorBody)))]
pub(in crate::http) async fn cancel_task<S: Store>(
    State(app): State<Appliance<S>>,
    _operator: Operator,
    Path(id): Path<String>,
) -> Result<(StatusCode, Json<TaskView>), Problem> {
    Ok(accepted(cases(&app)?.0.tasks.cancel(&handle(&id)?)?))
}

/// All cases.
#[utoipa::path(get, path = "/api/v1/cases", tag = "cases",
    responses((status = 200, body = CaseList), (status = "4XX", body = ErrorBody)))]
pub(in crate::http) async fn list<S: Store>(
    State(app): State<Appliance<S>>,
    _viewer: Viewer,
) -> Result<Json<CaseList>, Problem> {
    let cases = cases(&app)?;
    let found = on_disk(move || {
        let view = |view: CaseView| CaseView { task: cases.0.tasks.of_case(&view.id), ..view };
        Ok(cases.0.kept.cases()?.into_iter().map(view).collect())
    });
    Ok(Json(CaseList { cases: found.await? }))
}

/// Begins a case: its first stages as a task. Where the first one fails, there is no case, unless there is something to be corrected.
#[utoipa::path(post, path = "/api/v1/cases", tag = "cases", request_body = NewCase,
    responses((status = 202, body = Begun), (status = "4XX", body = ErrorBody)))]
pub(in crate::http) async fn begin<S: Store>(
    State(app): State<Appliance<S>>,
    _operator: Operator,
    Body(NewCase { folder, parameters, last }): Body<NewCase>,
) -> Result<(StatusCode, Json<Begun>), Problem> {
    let cases = cases(&app)?;
    let mut parameters = checked(parameters)?;
    check_room(&app).await?;
    match folder {
        Some(folder) => parameters.ct = Some(folder_of(&cases, folder).await?),
        None if parameters.phantom.is_some() => {}
        None => {
            let message = "found neither a folder nor a phantom, expected the folder of a CT";
            return Err(Problem::bad("http.no_ct", message));
        }
    }
    let (case, dir) = cases.0.kept.new_case()?;
    let task = cases.stages(&case, dir, last, parameters)?;
    Ok((StatusCode::ACCEPTED, Json(Begun { case, task })))
}

/// A case.
#[utoipa::path(get, path = "/api/v1/cases/{id}", tag = "cases", params(("id" = String, Path, description = "Name of the case")),
    responses((status = 200, body = CaseView), (status = "4XX", body = ErrorBody)))]
pub(in crate::http) async fn show<S: Store>(
    State(app): State<Appliance<S>>,
    _viewer: Viewer,
    Path(id): Path<String>,
) -> Result<Json<CaseView>, Problem> {
    let (cases, id) = (cases(&app)?, handle(&id)?);
    let task = cases.0.tasks.of_case(&id);
    let view = on_disk(move || cases.0.kept.view(&id)).await?;
    Ok(Json(CaseView { task, ..view }))
}

/// Removes a case for good. What the queue has made of it stays; a job of it that is not prepared yet fails.
#[utoipa::path(delete, path = "/api/v1/cases/{id}", tag = "cases", params(("id" = String, Path, description = "Name of the case")),
    responses((status = 204, description = "It is gone"), (status = "4XX", body = ErrorBody)))]
pub(in crate::http) async fn remove<S: Store>(
    State(app): State<Appliance<S>>,
    _operator: Operator,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    let (cases, id) = (cases(&app)?, handle(&id)?);
    if cases.0.tasks.of_case(&id).is_some() {
        return Err(in_use());
    }
    on_disk(move || cases.0.kept.remove(&id)).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Does stages of a case, with corrections put over its parameters.
#[utoipa::path(post, path = "/api/v1/cases/{id}/stages", tag = "cases", params(("id" = String, Path, description = "Name of the case")),
    request_body = StagesBody, responses((status = 202, body = TaskView), (status = "4XX", body = ErrorBody)))]
pub(in crate::http) async fn stages<S: Store>(
    State(app): State<Appliance<S>>,
    _operator: Operator,
    Path(id): Path<String>,
    Body(StagesBody { last, parameters }): Body<StagesBody>,
) -> Result<(StatusCode, Json<TaskView>), Problem> {
    let (cases, id) = (cases(&app)?, handle(&id)?);
    let parameters = checked(parameters)?;
    check_room(&app).await?;
    let (found, case) = (cases.clone(), id.clone());
    let dir = on_disk(move || found.0.kept.case(&case)).await?;
    Ok(accepted(cases.stages(&id, dir, last, parameters)?))
}

/// A document or picture of a case: one of those that the case lists.
#[utoipa::path(get, path = "/api/v1/cases/{id}/files/{name}", tag = "cases",
    params(("id" = String, Path, description = "Name of the case"), ("name" = String, Path, description = "Name of the file")),
    responses((status = 200, body = Vec<u8>), (status = "4XX", body = ErrorBody)))]
pub(in crate::http) async fn file<S: Store>(
    State(app): State<Appliance<S>>,
    _operator: Operator,
    Path((id, name)): Path<(String, String)>,
) -> Result<Response, Problem> {
    let (cases, id) = (cases(&app)?, handle(&id)?);
    let (bytes, kind) = on_disk(move || cases.0.kept.file(&id, &name)).await?;
    Ok(([(header::CONTENT_TYPE, kind), (header::CACHE_CONTROL, "no-store")], bytes).into_response())
}

/// Adds a job of a case.
#[utoipa::path(post, path = "/api/v1/cases/{id}/jobs", tag = "cases", params(("id" = String, Path, description = "Name of the case")),
    request_body = CaseToQueue, responses((status = 201, body = CaseJob), (status = "4XX", body = ErrorBody)))]
pub(in crate::http) async fn queue<S: Store>(
    State(app): State<Appliance<S>>,
    Operator(caller): Operator,
    Path(id): Path<String>,
    Body(CaseToQueue { wishes, submit, why }): Body<CaseToQueue>,
) -> Result<(StatusCode, Json<CaseJob>), Problem> {
    let (cases, case) = (cases(&app)?, handle(&id)?);
    let id = case.clone();
    let dir = on_disk(move || cases.0.kept.case(&id)).await?;
    let upload = Upload { source: Source::Local(dir), id: None, wishes, submit, why };
    let job = upload::add(&app, upload, Who::Operator(caller.name)).await?;
    Ok((StatusCode::CREATED, Json(CaseJob { case, job: (&job).into() })))
}

impl Cases {
    fn stages(
        &self,
        case: &Handle,
        dir: PathBuf,
        last: Stage,
        parameters: CaseFile,
    ) -> Result<TaskView, Problem> {
        if last == Stage::Print {
            let message = "a case is printed by the queue: add a job of it";
            return Err(Problem::bad("http.not_a_stage", message));
        }
        let sources = self.0.kept.sources();
        let errand = Errand::Stages { case: dir, last, parameters: Box::new(parameters), sources };
        self.0.tasks.begin(New {
            kind: TaskKind::Stages,
            case: Some(case.clone()),
            errand,
            finish: Box::new(Ok),
        })
    }
}

/// Refuses what would need room that is not there.
async fn check_room<S: Store>(app: &Appliance<S>) -> Result<(), Problem> {
    let files = app.files.clone();
    on_disk(move || files.check_room(1)).await
}

async fn folder_of(cases: &Cases, folder: Handle) -> Result<PathBuf, Problem> {
    let cases = cases.clone();
    on_disk(move || cases.0.folders.path(&folder)).await
}

const fn accepted(task: TaskView) -> (StatusCode, Json<TaskView>) {
    (StatusCode::ACCEPTED, Json(task))
}

/// Keys of a case file that may be said over a network.
fn checked(parameters: Value) -> Result<CaseFile, Problem> {
    if parameters.is_null() {
        return Ok(CaseFile::default());
    }
    let wrong = |text: String| Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "http.bad_parameter", text);
    let file: CaseFile = serde_json::from_value(parameters).map_err(|e| wrong(format!("parameters: {e}")))?;
    errand::check_parameters(&file)
        .map_err(|key| wrong(format!("parameters: found {key}, which cannot be said here: leave it out")))?;
    if let Some(name) = file.profile.as_deref().filter(|name| profile::builtin(name).is_err()) {
        // What was sent may be a path.
        let text = format!(
            "parameters: profile: found {} characters that name none, expected one of `lumenfab profiles list`",
            name.len()
        );
        return Err(wrong(text));
    }
    Ok(file)
}
