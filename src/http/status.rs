//! What the server is, who asks, its keys, its news.

use super::access::{Admin, Viewer};
use super::appliance::Appliance;
use super::error::Problem;
use super::extract::{Asked, Body, Named};
use super::keys::KeysError;
use super::wire::{API, ErrorBody, Health, KeyBody, KeyList, NewKey, Status, Whoami};
use super::{printers, upload};
use crate::store::Store;
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;

/// The server at a glance.
#[utoipa::path(get, path = "/api/v1/status", tag = "server",
    responses((status = 200, body = Status), (status = "4XX", body = ErrorBody)))]
pub(super) async fn status<S: Store>(
    State(app): State<Appliance<S>>,
    _viewer: Viewer,
) -> Result<Json<Status>, Problem> {
    Ok(Json(Status {
        api: API,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        started: app.started(),
        now: app.now(),
        last_record: app.store.head().await?.seq,
        printers: printers::all(&app).await?,
    }))
}

/// Whether the server can do its work: the queue answers.
#[utoipa::path(get, path = "/api/v1/health", tag = "server",
    responses((status = 200, body = Health), (status = 503, body = ErrorBody)))]
pub(super) async fn health<S: Store>(
    State(app): State<Appliance<S>>,
    _viewer: Viewer,
) -> Result<Json<Health>, Problem> {
    app.store.head().await?;
    Ok(Json(Health { ok: true }))
}

/// Who asks, and what they may do.
#[utoipa::path(get, path = "/api/v1/whoami", tag = "server",
    responses((status = 200, body = Whoami), (status = "4XX", body = ErrorBody)))]
pub(super) async fn whoami(Viewer(caller): Viewer) -> Json<Whoami> {
    Json(Whoami { name: caller.name, access: caller.access })
}

/// Where the reader was.
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct EventsQuery {
    /// Only records behind this number; the header `Last-Event-ID` goes before it.
    after: Option<u64>,
}

/// What happens, as it happens: server-sent events `hello`, `reset`, `record`, `printer`, `task`.
#[utoipa::path(get, path = "/api/v1/events", tag = "server",
    params(("after" = Option<u64>, Query, description = "Only records behind this number; the header `Last-Event-ID` goes before it")),
    responses((status = 200, content_type = "text/event-stream", body = String), (status = "4XX", body = ErrorBody)))]
pub(super) async fn events<S: Store>(
    State(app): State<Appliance<S>>,
    _viewer: Viewer,
    headers: HeaderMap,
    Asked(query): Asked<EventsQuery>,
) -> Result<Response, Problem> {
    let last = headers.get("last-event-id").and_then(|id| id.to_str().ok()?.trim().parse().ok());
    let reader = app.events.read(app.store.clone(), last.or(query.after)).await?;
    Ok(Sse::new(reader.stream()).keep_alive(KeepAlive::new()).into_response())
}

/// Lists keys.
#[utoipa::path(get, path = "/api/v1/keys", tag = "keys",
    responses((status = 200, body = KeyList), (status = "4XX", body = ErrorBody)))]
pub(super) async fn keys<S: Store>(State(app): State<Appliance<S>>, _admin: Admin) -> Json<KeyList> {
    Json(KeyList { keys: app.keys.list() })
}

/// Makes a key; it is told this once.
#[utoipa::path(post, path = "/api/v1/keys", tag = "keys", request_body = KeyBody,
    responses((status = 201, body = NewKey), (status = "4XX", body = ErrorBody)))]
pub(super) async fn add_key<S: Store>(
    State(app): State<Appliance<S>>,
    _admin: Admin,
    Body(KeyBody { name, access }): Body<KeyBody>,
) -> Result<(StatusCode, Json<NewKey>), Problem> {
    let keys = app.keys.clone();
    let key = upload::on_disk(move || Ok(keys.add(name, access)?)).await?;
    Ok((StatusCode::CREATED, Json(key)))
}

/// Makes a key void at once.
#[utoipa::path(delete, path = "/api/v1/keys/{name}", tag = "keys",
    params(("name" = String, Path, description = "Name of the key")),
    responses((status = 204, description = "It is void"), (status = "4XX", body = ErrorBody)))]
pub(super) async fn remove_key<S: Store>(
    State(app): State<Appliance<S>>,
    _admin: Admin,
    Named(name): Named,
) -> Result<StatusCode, Problem> {
    let keys = app.keys.clone();
    upload::on_disk(move || Ok(keys.remove(&name)?)).await?;
    Ok(StatusCode::NO_CONTENT)
}

impl From<KeysError> for Problem {
    fn from(error: KeysError) -> Self {
        let message = error.to_string();
        match error {
            KeysError::Taken { .. } => Self::conflict("http.key_taken", message),
            KeysError::NoKey { .. } => Self::new(StatusCode::NOT_FOUND, "http.no_such_key", message),
            KeysError::Weak(_) => Self::new(StatusCode::UNPROCESSABLE_ENTITY, "http.weak_key", message),
            KeysError::Open { .. } | KeysError::Unreadable { .. } | KeysError::Io { .. } => {
                Self::inside("writing the keys", &message)
            }
        }
    }
}
