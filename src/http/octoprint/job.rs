//! `/api/job`: what is being printed.

use super::files::{filament, name_of, queue, sum};
use super::{state_text, the_printer};
use crate::http::access::{Operator, Viewer};
use crate::http::appliance::{Appliance, Wish};
use crate::http::error::Problem;
use crate::http::extract::Body;
use crate::http::jobs::ask;
use crate::http::wire::Live;
use crate::queue::{Bed, Job, Reason, State};
use crate::store::Store;
use axum::Json;
use axum::extract::State as App;
use axum::http::StatusCode;
use serde::Deserialize;
use serde_json::{Value, json};

/// The job that the printer is printing.
async fn in_print<S: Store>(app: &Appliance<S>, live: &Live) -> Result<Option<Job>, Problem> {
    let printers = app.store.printers().await?;
    let Some(Bed::Taken(id)) = printers.iter().find(|p| p.name == live.name).map(|p| p.bed) else {
        return Ok(None);
    };
    let (job, _claim) = app.store.job(id).await?;
    Ok(Some(job).filter(|job| job.state.is_at_printer()))
}

pub(super) async fn show<S: Store>(
    App(app): App<Appliance<S>>,
    _viewer: Viewer,
) -> Result<Json<Value>, Problem> {
    let Ok(live) = the_printer(&app) else {
        return Ok(Json(json!({ "job": none(), "progress": progress(None, &app), "state": "Offline" })));
    };
    let job = match in_print(&app, &live).await? {
        Some(job) => described(&app, &job).await?,
        None => none(),
    };
    let state = state_text(live.activity);
    Ok(Json(json!({ "job": job, "progress": progress(Some(&live), &app), "state": state })))
}

fn none() -> Value {
    json!({
        "file": { "name": null, "path": null, "display": null, "origin": null, "size": null, "date": null },
        "estimatedPrintTime": null,
        "lastPrintTime": null,
        "filament": null,
        "user": null,
    })
}

async fn described<S: Store>(app: &Appliance<S>, job: &Job) -> Result<Value, Problem> {
    let name = name_of(job);
    let size = sum(app, job.id).await?.map(|sum| sum.len);
    let estimate = job.estimate();
    Ok(json!({
        "file": {
            "name": name,
            "path": name,
            "display": name,
            "origin": "local",
            "size": size,
            "date": job.added.as_second(),
        },
        "estimatedPrintTime": estimate.map(|estimate| estimate.print_s),
        "lastPrintTime": null,
        "filament": estimate.map(|estimate| json!({ "tool0": filament(estimate.filament_mm3) })),
        "user": null,
    }))
}

fn progress<S: Store>(live: Option<&Live>, app: &Appliance<S>) -> Value {
    let left_s = live.and_then(|live| live.ends).map(|ends| ends.duration_since(app.now()).as_secs().max(0));
    json!({
        "completion": live.and_then(|live| live.done).map(|done| done * 100.0),
        "filepos": null,
        "printTime": live.and_then(|live| live.printed_s),
        "printTimeLeft": left_s,
        "printTimeLeftOrigin": left_s.map(|_| "estimate"),
    })
}

/// A command to the job.
#[derive(Debug, Deserialize)]
#[serde(tag = "command", rename_all = "lowercase")]
pub(super) enum JobCommand {
    /// Print the selected file.
    Start,
    /// Give up.
    Cancel,
    /// From the beginning.
    Restart,
    /// Stop for a while, or go on.
    Pause {
        /// Which of them.
        #[serde(default)]
        action: PauseAction,
    },
}

/// Stop for a while, or go on.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum PauseAction {
    /// Stop, where it prints.
    Pause,
    /// Go on, where it is paused.
    Resume,
    /// The other of the two.
    #[default]
    Toggle,
}

pub(super) async fn command<S: Store>(
    App(app): App<Appliance<S>>,
    Operator(caller): Operator,
    Body(command): Body<JobCommand>,
) -> Result<StatusCode, Problem> {
    let wish = match command {
        JobCommand::Start => {
            let none = || Problem::conflict("http.nothing_selected", "no file is selected: select one first");
            queue(&app, &caller, app.selected().ok_or_else(none)?).await?;
            return Ok(StatusCode::NO_CONTENT);
        }
        JobCommand::Restart => {
            let message = "a print is not begun anew onto what lies on the bed: cancel it, clear the bed, retry the job";
            return Err(Problem::conflict("http.no_restart", message));
        }
        JobCommand::Cancel => None,
        JobCommand::Pause { action } => Some(action),
    };
    let not_printing = || Problem::conflict("http.not_printing", "no job is being printed");
    let job = in_print(&app, &the_printer(&app)?).await?.ok_or_else(not_printing)?;
    let wish = match (wish, job.state) {
        (None, _) => Wish::Cancel,
        (Some(PauseAction::Pause | PauseAction::Toggle), State::Printing) => Wish::Pause,
        (Some(PauseAction::Resume | PauseAction::Toggle), State::Paused) => Wish::GoOn,
        // It is so already.
        (Some(_), _) => return Ok(StatusCode::NO_CONTENT),
    };
    ask(&app, &job, wish, caller.name, Reason::default()).await?;
    Ok(StatusCode::NO_CONTENT)
}
