//! The queue: a list of which only what is seen is drawn, and all that is known of the chosen job.

use super::canvas::{Canvas, behind, below, row};
use super::{WIDE, dashboard};
use crate::http::wire::JobView;
use crate::queue::State as JobState;
use crate::tui::message::Target;
use crate::tui::state::{Listing, State};
use crate::tui::theme::Role;
use crate::tui::words;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::text::Line;

/// From this width on facts stand in two columns.
const TWO_COLUMNS: u16 = 76;
/// Rows of the border and of the columns' names.
const FRAME_ROWS: u16 = 3;

/// Columns of details beside the list.
const BESIDE: u16 = 42;
/// Rows of the list above details, at most.
const ABOVE: u16 = 8;

/// Where list and details are.
fn places(state: &State, body: Rect) -> (Rect, Option<Rect>) {
    if body.width >= WIDE {
        let beside = BESIDE.max(body.width * 2 / 5).min(body.width - 78);
        let [list, details] =
            Layout::horizontal([Constraint::Fill(1), Constraint::Length(beside)]).areas(body);
        return (list, Some(details));
    }
    if state.browsing.details {
        let [list, details] = Layout::vertical([Constraint::Length(ABOVE), Constraint::Fill(1)]).areas(body);
        return (list, Some(details));
    }
    (body, None)
}

pub(super) fn rows(state: &State, body: Rect) -> usize {
    usize::from(places(state, body).0.height.saturating_sub(FRAME_ROWS))
}

pub(super) fn draw(canvas: &mut Canvas<'_, '_>, body: Rect) {
    let (above, beside) = places(canvas.state, body);
    list(canvas, above);
    if let Some(area) = beside {
        details(canvas, area);
    }
}

fn list(canvas: &mut Canvas<'_, '_>, area: Rect) {
    let state = canvas.state;
    let jobs = state.listed();
    let (n_jobs, chosen) = (jobs.jobs.len(), state.row());
    let title = match (state.browsing.listing, jobs.more) {
        (Listing::Live, _) => format!("jobs, in the order in which they are printed: {n_jobs}"),
        (Listing::Over, false) => format!("jobs that are over, the last one first: {n_jobs}"),
        (Listing::Over, true) => {
            format!("jobs that are over, the last one first: {n_jobs}, older ones not shown")
        }
    };
    let inner = canvas.panel(area, &title);
    if n_jobs == 0 {
        let text = match state.browsing.listing {
            Listing::Live => {
                "No jobs. Add one: lumenfab queue add CASE|JOB.gcode|MODEL. v shows those that are over."
            }
            Listing::Over => "None is over yet.",
        };
        let text = vec![Line::from(canvas.span(text, Role::Dim))];
        canvas.lines(inner, text);
        return;
    }
    let head = columns(inner.width, &["job", "state", "of", "done", "prio", "printer", "takes", "ends"]);
    let head = canvas.span(head, Role::Dim);
    canvas.line(inner, head);
    let rows = below(inner, 1);
    // Whole pages: a step changes two rows, not the screen.
    let page = usize::from(rows.height).max(1);
    let first = chosen / page * page;
    for (n, at) in (0u16..rows.height).zip(first..n_jobs) {
        let place = row(rows, n);
        let role = if at == chosen { Role::Chosen } else { role_of(jobs.jobs[at].state) };
        let style = canvas.style(role);
        let text = canvas.span(cells(state, &jobs.jobs[at], inner.width), role);
        canvas.frame.buffer_mut().set_style(place, style);
        canvas.line(place, text);
        canvas.clickable(place, Target::Row(at));
    }
}

const fn role_of(state: JobState) -> Role {
    match state {
        JobState::Printing => Role::Good,
        JobState::Paused | JobState::AwaitingBedClear | JobState::AwaitingSignOff => Role::Warn,
        JobState::Failed => Role::Bad,
        JobState::Draft | JobState::Held | JobState::Cancelled => Role::Dim,
        JobState::Queued | JobState::Preparing | JobState::Finished => Role::Text,
    }
}

/// Cells under each other, as many as there is room for.
fn columns(width: u16, cells: &[&str; 8]) -> String {
    /// Widths; the last one takes what is left.
    const WIDTHS: [usize; 8] = [9, 19, 7, 6, 5, 8, 12, 16];
    let mut text = String::new();
    let mut left = usize::from(width);
    for (cell, wide) in cells.iter().zip(WIDTHS) {
        if left < wide.min(8) {
            break;
        }
        let wide = wide.min(left);
        // Between two cells there is a gap.
        let room = if wide == left { wide } else { wide - 1 };
        text += &format!("{:<wide$}", words::cut(cell, room));
        left -= wide;
    }
    text
}

fn cells(state: &State, job: &JobView, width: u16) -> String {
    let holder = job.holder.as_ref().map(ToString::to_string).unwrap_or_default();
    let takes = job.estimate.map(|estimate| words::span(estimate.print_s.into())).unwrap_or_default();
    let when = if job.state.is_over() { Some(job.changed) } else { dashboard::ends(state, job.id) };
    let when = when.map(|at| words::short_clock(at, state.now, &state.zone)).unwrap_or_default();
    columns(
        width,
        &[
            &words::short(job.id),
            words::state(job),
            words::kind(job.kind),
            &format!("{}/{}", job.n_printed, job.copies),
            &if job.priority == 0 { String::new() } else { job.priority.to_string() },
            &holder,
            &takes,
            &when,
        ],
    )
}

fn details(canvas: &mut Canvas<'_, '_>, area: Rect) {
    let state = canvas.state;
    let Some(job) = state.chosen() else {
        canvas.panel(area, "details");
        return;
    };
    let inner = canvas.panel(area, &job.id.to_string());
    let all = facts(state, job);
    let n_columns = if inner.width >= TWO_COLUMNS { 2 } else { 1 };
    let width = inner.width / n_columns;
    let mut n_rows = 0;
    for (n, (what, text)) in (0u16..).zip(all) {
        let place = behind(row(inner, n / n_columns), n % n_columns * width);
        let line = vec![
            canvas.span(format!("{what:<9}"), Role::Dim),
            canvas.span(words::cut(&text, usize::from(width).saturating_sub(10)), Role::Text),
        ];
        canvas.line(place, Line::from(line));
        n_rows = n / n_columns + 1;
    }
    history(canvas, below(inner, n_rows + 1), job);
}

fn facts(state: &State, job: &JobView) -> Vec<(&'static str, String)> {
    let clock = |at| words::clock(at, state.now, &state.zone);
    let sign = if job.sign_off { ", then sign-off" } else { "" };
    let mut facts = vec![("state", format!("{}{sign}", words::state(job)))];
    facts.push(("copies", format!("{} of {} printed", job.n_printed, job.copies)));
    if let Some(estimate) = job.estimate {
        let (span, filament) =
            (words::span(estimate.print_s.into()), words::filament(estimate.filament_mm3 as f64));
        facts.push(("takes", format!("{span}, {filament} a copy")));
    }
    let needs = &job.needs;
    let nozzle = needs.nozzle_um.map(|um| format!("{:.2} mm", f64::from(um) / 1000.0));
    let needs = [
        needs.profile.as_ref().map(ToString::to_string),
        needs.material.as_ref().map(ToString::to_string),
        nozzle,
    ];
    let needs: Vec<_> = needs.into_iter().flatten().collect();
    if !needs.is_empty() {
        facts.push(("needs", needs.join(", ")));
    }
    if let Some(at) = job.not_before {
        facts.push(("starts", format!("not before {}", clock(at))));
    }
    let unplanned = state.schedule.as_ref().and_then(|s| s.unplanned.iter().find(|one| one.job == job.id));
    match (dashboard::ends(state, job.id), unplanned) {
        (Some(ends), _) if !job.state.is_over() => facts.push(("ends", clock(ends))),
        (_, Some(unplanned)) => facts.push(("no plan", unplanned.why.clone())),
        _ => {}
    }
    facts.push(("added", clock(job.added)));
    facts
}

/// Who did what, when and why: the newest first.
fn history(canvas: &mut Canvas<'_, '_>, area: Rect, job: &JobView) {
    let state = canvas.state;
    let Some((_, records, more)) = state.browsing.history.as_ref().filter(|(of, ..)| *of == job.id) else {
        return;
    };
    let title = canvas.span(if *more { "history (its beginning)" } else { "history" }, Role::Strong);
    canvas.line(area, title);
    let mut lines = Vec::new();
    for record in records.iter().rev().take(usize::from(area.height)) {
        let why = if record.why.is_empty() { String::new() } else { format!(": {}", record.why) };
        let at = words::clock(record.at, state.now, &state.zone);
        lines.push(Line::from(vec![
            canvas.span(format!("{at} "), Role::Dim),
            canvas.span(words::what(record), Role::Text),
            canvas.span(format!(" by {}", record.who), Role::Dim),
            canvas.span(why, Role::Text),
        ]));
    }
    canvas.lines(below(area, 1), lines);
}
