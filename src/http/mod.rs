//! The faces of the queue over HTTP/1.1: its own API under `/api/v1`, and the part of OctoPrint's that slicers and apps use.
//!
//! - [`wire`]: the types that go over the wire;
//! - [`appliance`]: what the faces are given by whoever starts them: queue, printers, files, keys, events;
//! - [`access`], [`keys`]: who asks, and what they may do;
//! - [`cases`]: CTs, their planes as pictures, cases and their stages as tasks in the background;
//! - [`files`]: uploads, under generated names;
//! - [`events`]: what happens, as server-sent events;
//! - `octoprint`: the OctoPrint part; `openapi`: the description of the rest;
//! - [`metrics`]: what the server does, in numbers;
//! - [`mod@serve`]: sockets, limits, a graceful end.
//!
//! A handler asks the queue and answers; what is decided is decided by [`crate::queue`]. Errors have one shape,
//! `{"error": {"code", "message"}}`, with the stable codes of queue and store, and `http.*` for those of this module.
//!
//! It knows no meshes (what is done about cases, child processes do), talks to no printer, and neither keeps, shows nor logs the name of an uploaded file or a path that was sent.

pub mod access;
pub mod appliance;
pub mod cases;
mod error;
pub mod events;
mod extract;
pub mod files;
mod jobs;
pub mod keys;
pub mod metrics;
mod octoprint;
mod openapi;
mod printers;
pub mod serve;
mod status;
#[cfg(test)]
pub(crate) mod tests;
mod upload;
pub mod wire;

pub use appliance::{Appliance, PrinterDesk, Printers};
pub use error::Problem;
pub use files::{FileSpec, Files, Limits};
pub use keys::Keys;
pub use serve::{Edge, Listen, serve};

use crate::store::Store;
use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::StatusCode;
use axum::middleware::from_fn_with_state;
use axum::routing::{MethodRouter, delete, get, post, put};

/// Longest body that is no upload, bytes.
const MAX_BODY: usize = 1 << 17;

/// The whole interface; every request has to bring its [`access::Peer`].
fn router<S: Store>(app: Appliance<S>) -> Router {
    let own = routes().into_iter().fold(Router::new(), |router, (path, methods)| router.route(path, methods));
    own.merge(octoprint::router())
        .route("/metrics", get(metrics::metrics::<S>))
        .fallback(nothing_here)
        .method_not_allowed_fallback(not_so)
        .layer(DefaultBodyLimit::max(MAX_BODY))
        .layer(from_fn_with_state(app.clone(), access::identify::<S>))
        .with_state(app)
}

/// The own API; [`openapi`] describes each of them.
fn routes<S: Store>() -> Vec<(&'static str, MethodRouter<Appliance<S>>)> {
    vec![
        ("/api/v1/jobs", get(jobs::list::<S>).post(jobs::add::<S>)),
        ("/api/v1/jobs/upload", post(jobs::upload::<S>).layer(DefaultBodyLimit::disable())),
        ("/api/v1/jobs/{id}", get(jobs::show::<S>)),
        ("/api/v1/jobs/{id}/changes", post(jobs::change::<S>)),
        ("/api/v1/jobs/{id}/history", get(jobs::history_of::<S>)),
        ("/api/v1/history", get(jobs::history::<S>)),
        ("/api/v1/printers", get(printers::list::<S>)),
        ("/api/v1/printers/{name}", get(printers::show::<S>)),
        ("/api/v1/printers/{name}/history", get(printers::history::<S>)),
        ("/api/v1/printers/{name}/loaded", put(printers::load::<S>)),
        ("/api/v1/printers/{name}/bed-clear", post(printers::clear_bed::<S>)),
        ("/api/v1/printers/{name}/bed-in-doubt", post(printers::doubt_bed::<S>)),
        ("/api/v1/printers/{name}/orders", post(printers::order::<S>)),
        ("/api/v1/schedule", get(printers::plan::<S>)),
        ("/api/v1/status", get(status::status::<S>)),
        ("/api/v1/health", get(status::health::<S>)),
        ("/api/v1/whoami", get(status::whoami)),
        ("/api/v1/events", get(status::events::<S>)),
        ("/api/v1/keys", get(status::keys::<S>).post(status::add_key::<S>)),
        ("/api/v1/keys/{name}", delete(status::remove_key::<S>)),
        ("/api/v1/folders", get(cases::routes::folders::<S>).post(cases::routes::find_folder::<S>)),
        ("/api/v1/folders/{id}", get(cases::routes::folder::<S>)),
        ("/api/v1/folders/{id}/inspection", post(cases::routes::inspect::<S>)),
        ("/api/v1/folders/{id}/volume", post(cases::routes::read_volume::<S>)),
        ("/api/v1/volumes/{id}", get(cases::routes::volume::<S>)),
        ("/api/v1/volumes/{id}/planes/{index}", get(cases::pixels::plane::<S>)),
        ("/api/v1/tasks", get(cases::routes::tasks::<S>)),
        ("/api/v1/tasks/{id}", get(cases::routes::task::<S>).delete(cases::routes::cancel_task::<S>)),
        ("/api/v1/cases", get(cases::routes::list::<S>).post(cases::routes::begin::<S>)),
        ("/api/v1/cases/{id}", get(cases::routes::show::<S>).delete(cases::routes::remove::<S>)),
        ("/api/v1/cases/{id}/stages", post(cases::routes::stages::<S>)),
        ("/api/v1/cases/{id}/files/{name}", get(cases::routes::file::<S>)),
        ("/api/v1/cases/{id}/jobs", post(cases::routes::queue::<S>)),
        ("/api/v1/openapi.json", get(openapi::document)),
    ]
}

async fn nothing_here() -> Problem {
    Problem::new(StatusCode::NOT_FOUND, "http.not_found", "there is nothing at this address")
}

async fn not_so() -> Problem {
    let message = "this address does not take this method";
    Problem::new(StatusCode::METHOD_NOT_ALLOWED, "http.no_method", message)
}
