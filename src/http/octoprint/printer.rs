//! `/api/printer`, `/api/connection`: the printer and its port.

use super::{operational, state_text, the_printer};
use crate::http::access::{Admin, Operator, Viewer};
use crate::http::appliance::{Appliance, Wish, WishOf};
use crate::http::error::Problem;
use crate::http::extract::Body;
use crate::http::printers::commands;
use crate::http::wire::{Activity, Heat, Live};
use crate::queue::{Name, Reason};
use crate::store::Store;
use axum::Json;
use axum::extract::State as App;
use axum::http::StatusCode;
use serde::Deserialize;
use serde_json::{Value, json};

pub(super) async fn show<S: Store>(
    App(app): App<Appliance<S>>,
    _viewer: Viewer,
) -> Result<Json<Value>, Problem> {
    let live = operational(&app)?;
    let mut temperature = serde_json::Map::new();
    let heats = [("tool0", live.hotend), ("bed", live.bed)];
    temperature.extend(heats.into_iter().filter_map(|(part, heat)| Some((part.to_owned(), shown(heat?)))));
    let state = json!({ "text": state_text(live.activity), "flags": flags(live.activity) });
    Ok(Json(json!({ "temperature": temperature, "sd": { "ready": false }, "state": state })))
}

fn shown(heat: Heat) -> Value {
    json!({ "actual": heat.actual_c, "target": heat.target_c, "offset": 0 })
}

fn flags(activity: Activity) -> Value {
    use Activity as A;
    let is = |all: &[Activity]| all.contains(&activity);
    json!({
        "operational": !is(&[A::Offline, A::Faulted]),
        "printing": is(&[A::Printing, A::Pausing, A::Cancelling]),
        "pausing": is(&[A::Pausing]),
        "paused": is(&[A::Paused]),
        "cancelling": is(&[A::Cancelling]),
        "resuming": false,
        "finishing": false,
        "sdReady": false,
        "error": is(&[A::Faulted]),
        "ready": is(&[A::Idle]),
        "closedOrError": is(&[A::Offline, A::Faulted]),
    })
}

/// Lines for the printer, one or several.
#[derive(Debug, Deserialize)]
pub(super) struct Commands {
    #[serde(default)]
    command: Option<String>,
    #[serde(default)]
    commands: Vec<String>,
}

/// Lines go to the printer as they are: for those who know what they do, and not while it prints.
pub(super) async fn command<S: Store>(
    App(app): App<Appliance<S>>,
    Admin(caller): Admin,
    Body(Commands { command, commands: several }): Body<Commands>,
) -> Result<StatusCode, Problem> {
    let lines: Vec<_> = command.into_iter().chain(several).collect();
    let wish = commands(lines)?;
    let live = operational(&app)?;
    if live.activity != Activity::Idle {
        let message = "the printer is printing: commands have to wait until it is idle";
        return Err(Problem::conflict("http.in_print", message));
    }
    ask(&app, live.name, wish, caller.name).await
}

async fn ask<S: Store>(
    app: &Appliance<S>,
    printer: Name,
    wish: Wish,
    by: Name,
) -> Result<StatusCode, Problem> {
    app.printers.ask(WishOf { printer, job: None, wish, by, why: Reason::default() }).await?;
    Ok(StatusCode::NO_CONTENT)
}

pub(super) async fn connection<S: Store>(App(app): App<Appliance<S>>, _viewer: Viewer) -> Json<Value> {
    let live = the_printer(&app).ok();
    let port = live.as_ref().and_then(|live| live.port.as_deref());
    let baud = live.as_ref().and_then(|live| live.baud);
    let state = state_text(live.as_ref().map_or(Activity::Offline, |live: &Live| live.activity));
    Json(json!({
        "current": { "state": state, "port": port, "baudrate": baud, "printerProfile": "_default" },
        "options": {
            "ports": port.as_slice(),
            "baudrates": baud.as_slice(),
            "printerProfiles": [{ "id": "_default", "name": "lumenfab" }],
            "portPreference": port,
            "baudratePreference": baud,
            "printerProfilePreference": "_default",
            "autoconnect": true,
        },
    }))
}

/// A command to the connection; port and speed are the server's own setting.
#[derive(Debug, Deserialize)]
#[serde(tag = "command", rename_all = "snake_case")]
pub(super) enum ConnectionCommand {
    /// Open the port.
    Connect,
    /// Close it.
    Disconnect,
    /// Pretend that the printer has answered.
    FakeAck,
}

pub(super) async fn connect<S: Store>(
    App(app): App<Appliance<S>>,
    Operator(caller): Operator,
    Body(command): Body<ConnectionCommand>,
) -> Result<StatusCode, Problem> {
    let wish = match command {
        ConnectionCommand::Connect => Wish::Connect,
        ConnectionCommand::Disconnect => Wish::Disconnect,
        ConnectionCommand::FakeAck => {
            let message = "an answer is never made up: lost ones are found out by lumenfab itself";
            return Err(Problem::bad("http.no_fake_ack", message));
        }
    };
    ask(&app, the_printer(&app)?.name, wish, caller.name).await
}

pub(super) async fn profiles(_viewer: Viewer) -> Json<Value> {
    let profile = json!({
        "id": "_default",
        "name": "lumenfab",
        "model": "lumenfab",
        "default": true,
        "current": true,
        "heatedBed": true,
        "heatedChamber": false,
        "extruder": { "count": 1, "offsets": [[0.0, 0.0]], "sharedNozzle": false },
    });
    Json(json!({ "profiles": { "_default": profile } }))
}
