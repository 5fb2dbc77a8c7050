//! `/api/v1/printers`, and the plan: `/api/v1/schedule`.

use super::access::{Operator, Viewer};
use super::appliance::{Appliance, Wish, WishOf};
use super::error::Problem;
use super::extract::{Asked, Body, Named};
use super::jobs::{HistoryQuery, page};
use super::wire::{
    Access, BedClear, ErrorBody, HistoryPage, LoadedBody, NextView, Order, Ordered, PrinterList, PrinterView,
    Said, Schedule, SlotView, UnplannedView,
};
use crate::queue::schedule::{self, Lane, Plan};
use crate::queue::{
    Bed, By, Evidence, Job, JobId, Name, Printer, Reason, Refusal, Said as Word, Subject, Who,
};
use crate::store::{Store, Which};
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use jiff::Timestamp;
use jiff::tz::TimeZone;

/// Jobs that are planned at most.
const MOST_PLANNED: u32 = 500;
/// Copies that are planned at most.
const MOST_COPIES: usize = 2000;

/// Lists printers.
#[utoipa::path(get, path = "/api/v1/printers", tag = "printers",
    responses((status = 200, body = PrinterList), (status = "4XX", body = ErrorBody)))]
pub(super) async fn list<S: Store>(
    State(app): State<Appliance<S>>,
    _viewer: Viewer,
) -> Result<Json<PrinterList>, Problem> {
    Ok(Json(PrinterList { printers: all(&app).await? }))
}

/// What the queue knows of printers, and those of this server of which it knows nothing yet.
pub(super) async fn all<S: Store>(app: &Appliance<S>) -> Result<Vec<PrinterView>, Problem> {
    let known = app.store.printers().await?;
    let lives = app.printers.all();
    let live = |name: &Name| lives.iter().find(|live| live.name == *name);
    let mut views: Vec<_> = known.iter().map(|p| PrinterView::new(p, live(&p.name))).collect();
    let unknown = lives.iter().filter(|live| known.iter().all(|printer| printer.name != live.name));
    views.extend(unknown.map(|live| PrinterView::new(&Printer::new(live.name.clone()), Some(live))));
    views.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(views)
}

async fn one<S: Store>(app: &Appliance<S>, name: &Name) -> Result<PrinterView, Problem> {
    let found = all(app).await?.into_iter().find(|view| view.name == *name);
    found.ok_or_else(|| Refusal::NoPrinter { printer: name.clone() }.into())
}

/// Shows one printer.
#[utoipa::path(get, path = "/api/v1/printers/{name}", tag = "printers",
    params(("name" = String, Path, description = "Name of the printer")),
    responses((status = 200, body = PrinterView), (status = 404, body = ErrorBody)))]
pub(super) async fn show<S: Store>(
    State(app): State<Appliance<S>>,
    _viewer: Viewer,
    Named(name): Named,
) -> Result<Json<PrinterView>, Problem> {
    one(&app, &name).await.map(Json)
}

/// Who did what to a printer, when and why.
#[utoipa::path(get, path = "/api/v1/printers/{name}/history", tag = "history",
    params(("name" = String, Path, description = "Name of the printer"),
        ("after" = Option<u64>, Query, description = "Only records behind this number"),
        ("most" = Option<u32>, Query, description = "How many at most, up to 500")),
    responses((status = 200, body = HistoryPage), (status = "4XX", body = ErrorBody)))]
pub(super) async fn history<S: Store>(
    State(app): State<Appliance<S>>,
    _viewer: Viewer,
    Named(name): Named,
    Asked(query): Asked<HistoryQuery>,
) -> Result<Json<HistoryPage>, Problem> {
    page(&app, Some(Subject::Printer(name)), &query).await
}

/// Says what a printer is fitted with: makes it known to the queue.
#[utoipa::path(put, path = "/api/v1/printers/{name}/loaded", tag = "printers", request_body = LoadedBody,
    params(("name" = String, Path, description = "Name of the printer")),
    responses((status = 200, body = PrinterView), (status = "4XX", body = ErrorBody)))]
pub(super) async fn load<S: Store>(
    State(app): State<Appliance<S>>,
    Operator(caller): Operator,
    Named(name): Named,
    Body(loaded): Body<LoadedBody>,
) -> Result<Json<PrinterView>, Problem> {
    say(&app, name, Word::Loaded(loaded.into()), caller.name, Reason::default()).await
}

/// Somebody has looked: the bed is clear. The job that was taken off has to be named.
#[utoipa::path(post, path = "/api/v1/printers/{name}/bed-clear", tag = "printers", request_body = BedClear,
    params(("name" = String, Path, description = "Name of the printer")),
    responses((status = 200, body = PrinterView), (status = "4XX", body = ErrorBody)))]
pub(super) async fn clear_bed<S: Store>(
    State(app): State<Appliance<S>>,
    Operator(caller): Operator,
    Named(name): Named,
    Body(said): Body<BedClear>,
) -> Result<Json<PrinterView>, Problem> {
    let found = app.store.printers().await?.into_iter().find(|printer| printer.name == name);
    let printer = found.ok_or_else(|| Refusal::NoPrinter { printer: name.clone() })?;
    check_bed(&printer, said.on_bed)?;
    let who = caller.named(said.name.as_ref())?;
    let word =
        said.on_bed.map_or(Word::BedClear(Evidence::Word), |job| Word::BedClearOf(job, Evidence::Word));
    say(&app, name, word, who, said.why).await
}

fn check_bed(printer: &Printer, said: Option<JobId>) -> Result<(), Problem> {
    let known = match printer.bed {
        Bed::Taken(job) => Some(job),
        Bed::Clear | Bed::Unknown => None,
    };
    if said == known {
        return Ok(());
    }
    let lies = known.map_or_else(|| "no job is known to lie".to_owned(), |job| format!("job {job} lies"));
    let message = format!("{lies} on the bed of {}: look at it, then name what was taken off", printer.name);
    Err(Problem::conflict("http.other_bed", message))
}

/// Whether the bed is clear is not known any more: nothing starts.
#[utoipa::path(post, path = "/api/v1/printers/{name}/bed-in-doubt", tag = "printers", request_body = Said,
    params(("name" = String, Path, description = "Name of the printer")),
    responses((status = 200, body = PrinterView), (status = "4XX", body = ErrorBody)))]
pub(super) async fn doubt_bed<S: Store>(
    State(app): State<Appliance<S>>,
    Operator(caller): Operator,
    Named(name): Named,
    Body(said): Body<Said>,
) -> Result<Json<PrinterView>, Problem> {
    one(&app, &name).await?;
    let who = caller.named(said.name.as_ref())?;
    say(&app, name, Word::BedInDoubt, who, said.why).await
}

/// Most lines of G-code in one request.
const MOST_COMMANDS: usize = 64;
/// Longest line, bytes: what firmware takes.
const MAX_COMMAND: usize = 96;

/// Asks the printer itself for something; answered once it is understood, not once it is done.
#[utoipa::path(post, path = "/api/v1/printers/{name}/orders", tag = "printers", request_body = Ordered,
    params(("name" = String, Path, description = "Name of the printer")),
    responses((status = 202, description = "The printer was asked", body = PrinterView), (status = "4XX", body = ErrorBody)))]
pub(super) async fn order<S: Store>(
    State(app): State<Appliance<S>>,
    Operator(caller): Operator,
    Named(name): Named,
    Body(ordered): Body<Ordered>,
) -> Result<(StatusCode, Json<PrinterView>), Problem> {
    let view = one(&app, &name).await?;
    let wish = match ordered.order {
        Order::EmergencyStop => Wish::EmergencyStop,
        Order::Connect => Wish::Connect,
        Order::Disconnect => Wish::Disconnect,
        Order::Commands(lines) => {
            caller.check(Access::Admin)?;
            commands(lines)?
        }
    };
    let by = caller.named(ordered.name.as_ref())?;
    app.printers.ask(WishOf { printer: name, job: None, wish, by, why: ordered.why }).await?;
    Ok((StatusCode::ACCEPTED, Json(view)))
}

/// Lines that can be sent to a printer.
pub(super) fn commands(lines: Vec<String>) -> Result<Wish, Problem> {
    let is_good =
        |line: &String| line.len() <= MAX_COMMAND && line.bytes().all(|b| (b' '..=b'~').contains(&b));
    if lines.is_empty() || lines.len() > MOST_COMMANDS || !lines.iter().all(is_good) {
        let message = format!(
            "expected 1 to {MOST_COMMANDS} lines of G-code of at most {MAX_COMMAND} ASCII characters"
        );
        return Err(Problem::bad("http.bad_command", message));
    }
    Ok(Wish::Commands(lines))
}

async fn say<S: Store>(
    app: &Appliance<S>,
    name: Name,
    word: Word,
    who: Name,
    why: Reason,
) -> Result<Json<PrinterView>, Problem> {
    let by = By { who: Who::Operator(who), why, now: app.now() };
    let printer = app.store.say(name, word, by).await?;
    app.events.look();
    Ok(Json(PrinterView::new(&printer, app.printers.find(&printer.name).as_ref())))
}

/// What is next, why nothing is, when each job ends.
#[utoipa::path(get, path = "/api/v1/schedule", tag = "schedule",
    responses((status = 200, body = Schedule), (status = "4XX", body = ErrorBody)))]
pub(super) async fn plan<S: Store>(
    State(app): State<Appliance<S>>,
    _viewer: Viewer,
) -> Result<Json<Schedule>, Problem> {
    let printers = app.store.printers().await?;
    let jobs = app.store.list(Which::Live, None, MOST_PLANNED + 1).await?;
    let lanes: Vec<_> = printers.into_iter().map(|printer| lane(&app, printer)).collect();
    let now = app.now();
    // Long queues take a while to plan: not on the threads that serve others.
    let made = tokio::task::spawn_blocking(move || schedule_of(&lanes, &jobs, now)).await;
    made.map(Json).map_err(|panicked| Problem::inside("planning", &panicked))
}

fn lane<S: Store>(app: &Appliance<S>, printer: Printer) -> Lane {
    let live = app.printers.find(&printer.name);
    let (ends, clearing_s) = live.map_or((None, 0), |live| (live.ends, live.clearing_s));
    Lane { printer, ends, clearing_s }
}

fn schedule_of(lanes: &[Lane], jobs: &[Job], now: Timestamp) -> Schedule {
    let next = lanes.iter().map(|lane| next_of(&lane.printer, jobs, now)).collect();
    let planned = &jobs[..n_planned(jobs)];
    let plan = schedule::plan(lanes, planned, now);
    let (ends, ends_words) = (plan.end(), plan.end_words(now, &TimeZone::system()));
    let Plan { slots, unplanned } = plan;
    let slots = slots.into_iter().map(|slot| SlotView {
        job: slot.job,
        copy: slot.copy,
        printer: slot.printer,
        starts: slot.starts,
        ends: slot.ends,
    });
    let unplanned = unplanned.into_iter().map(|(job, why)| UnplannedView { job, why: why.to_string() });
    Schedule {
        next,
        slots: slots.collect(),
        unplanned: unplanned.collect(),
        ends,
        ends_words,
        is_cut: planned.len() < jobs.len(),
    }
}

/// Jobs from the front whose copies are not too many.
fn n_planned(jobs: &[Job]) -> usize {
    let mut n_copies = 0;
    let fits = |job: &&Job| {
        n_copies += usize::from(job.n_left());
        n_copies <= MOST_COPIES
    };
    jobs.iter().take(MOST_PLANNED as usize).take_while(fits).count()
}

fn next_of(printer: &Printer, jobs: &[Job], now: Timestamp) -> NextView {
    let (job, why_not) = match schedule::next(printer, jobs, now) {
        Ok(job) => (Some(job.id), None),
        Err(why) => (None, Some(why.to_string())),
    };
    NextView { printer: printer.name.clone(), job, why_not }
}
