//! The part of OctoPrint's REST API that slicers and monitoring apps use, on top of the queue.
//!
//! A file there is a job here: uploaded, it is a draft, or in the queue where it is to be printed. It is shown under the job's generated name; the
//! name and folder that it came with are not kept. "The printer" is the first one, by name, that this server talks to. What differs
//! by design: `print` queues the job, and it starts when its turn has come and the bed is clear; commands to the printer need the
//! role `admin`; files are not given out again; `restart` and `fake_ack` are refused.
//!
//! What a slicer sends, by hand:
//!
//! ```text
//! curl -H "X-Api-Key: KEY" http://127.0.0.1:PORT/api/version
//! curl -H "X-Api-Key: KEY" -F print=true -F path= -F file=@job.gcode http://127.0.0.1:PORT/api/files/local
//! ```
//!
//! Shapes and status codes follow OctoPrint's documentation of its REST API (`docs.octoprint.org`, "REST API").

mod files;
mod job;
mod printer;

use super::access::{Caller, Viewer};
use super::appliance::Appliance;
use super::error::Problem;
use super::wire::{Access, Activity, Live};
use crate::store::Store;
use axum::Json;
use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::StatusCode;
use axum::routing::{get, post};
use serde_json::{Value, json};

/// Version of OctoPrint's interface that this follows.
const API: &str = "0.1";
/// Version of OctoPrint whose documentation this follows: some clients ask for at least 1.1.0.
const SERVER: &str = "1.10.0";

pub(super) fn router<S: Store>() -> Router<Appliance<S>> {
    let local = post(files::upload::<S>).get(files::list_local::<S>).layer(DefaultBodyLimit::disable());
    let file = get(files::show::<S>).post(files::command::<S>).delete(files::delete::<S>);
    Router::new()
        .route("/api/version", get(version))
        .route("/api/server", get(server))
        .route("/api/login", post(login))
        .route("/api/logout", post(logout))
        .route("/api/currentuser", get(current_user))
        .route("/api/settings", get(settings))
        .route("/api/files", get(files::list::<S>))
        .route("/api/files/local", local)
        .route("/api/files/local/{name}", file)
        .route("/api/job", get(job::show::<S>).post(job::command::<S>))
        .route("/api/connection", get(printer::connection::<S>).post(printer::connect::<S>))
        .route("/api/printer", get(printer::show::<S>))
        .route("/api/printer/command", post(printer::command::<S>))
        .route("/api/printerprofiles", get(printer::profiles))
}

/// The printer that these clients mean.
fn the_printer<S: Store>(app: &Appliance<S>) -> Result<Live, Problem> {
    let mut lives = app.printers.all();
    lives.sort_by(|a, b| a.name.cmp(&b.name));
    let none = || Problem::conflict("http.no_printer", "this server talks to no printer");
    lives.into_iter().next().ok_or_else(none)
}

/// The same, where it is connected.
fn operational<S: Store>(app: &Appliance<S>) -> Result<Live, Problem> {
    let live = the_printer(app)?;
    if matches!(live.activity, Activity::Offline | Activity::Faulted) {
        return Err(Problem::conflict("http.not_operational", "the printer is not operational"));
    }
    Ok(live)
}

/// In OctoPrint's words.
const fn state_text(activity: Activity) -> &'static str {
    match activity {
        Activity::Offline => "Offline",
        Activity::Idle => "Operational",
        Activity::Printing => "Printing",
        Activity::Pausing => "Pausing",
        Activity::Paused => "Paused",
        Activity::Cancelling => "Cancelling",
        Activity::Faulted => "Error",
    }
}

async fn version(_viewer: Viewer) -> Json<Value> {
    let text = format!("OctoPrint {SERVER} (lumenfab {})", env!("CARGO_PKG_VERSION"));
    Json(json!({ "api": API, "server": SERVER, "text": text }))
}

async fn server(_viewer: Viewer) -> Json<Value> {
    Json(json!({ "version": SERVER, "safemode": null }))
}

/// Permissions as OctoPrint calls them.
fn permissions(access: Access) -> Vec<&'static str> {
    let mut all = vec!["STATUS", "CONNECTION_STATUS", "FILES_LIST", "SETTINGS_READ"];
    if access >= Access::Operate {
        all.extend(["FILES_UPLOAD", "FILES_SELECT", "FILES_DELETE", "PRINT", "CONNECTION"]);
    }
    if access >= Access::Admin {
        all.extend(["CONTROL", "ADMIN"]);
    }
    all
}

fn groups(access: Access) -> &'static [&'static str] {
    match access {
        Access::View => &["readonly"],
        Access::Operate => &["users"],
        Access::Admin => &["users", "admins"],
    }
}

/// Whoever has a key is logged in by it; there is no session to begin.
async fn login(Viewer(Caller { name, access, .. }): Viewer) -> Json<Value> {
    Json(json!({
        "_is_external_client": true,
        "_login_mechanism": "apikey",
        "name": name,
        "active": true,
        "user": access >= Access::Operate,
        "admin": access == Access::Admin,
        "apikey": null,
        "settings": {},
        "session": "",
        "permissions": permissions(access),
        "groups": groups(access),
        "needs": { "group": groups(access), "role": [] },
    }))
}

async fn logout(_viewer: Viewer) -> StatusCode {
    StatusCode::NO_CONTENT
}

async fn current_user(Viewer(Caller { name, access, .. }): Viewer) -> Json<Value> {
    Json(json!({ "name": name, "permissions": permissions(access), "groups": groups(access) }))
}

/// What apps look at before they show anything.
async fn settings(_viewer: Viewer) -> Json<Value> {
    Json(json!({
        "api": { "allowCrossOrigin": false, "key": null },
        "appearance": { "name": "lumenfab", "color": "default" },
        "feature": { "sdSupport": false, "temperatureGraph": true, "modelSizeDetection": false },
        "folder": {},
        "plugins": {},
        "printer": { "defaultExtrusionLength": 5 },
        "serial": { "autoconnect": true },
        "server": { "commands": {} },
        "temperature": { "profiles": [], "cutoff": 30 },
        "terminalFilters": [],
        "webcam": { "webcamEnabled": false, "streamUrl": "", "snapshotUrl": "" },
    }))
}
