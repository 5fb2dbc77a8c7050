//! The dashboard: is it well, what is next.

use super::canvas::{Canvas, behind, below, row};
use crate::http::wire::{Activity, BedView, Heat, JobView, Live, PrinterView, Schedule};
use crate::queue::{JobId, Name, State as JobState};
use crate::tui::command::Command;
use crate::tui::heats::{Heater, SPAN_S, is_heard};
use crate::tui::message::Target;
use crate::tui::state::State;
use crate::tui::theme::Role;
use crate::tui::words;
use jiff::Timestamp;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Chart, Dataset, GraphType, LineGauge};

/// From this width on there is a third column: what happened lately.
const THREE_COLUMNS: u16 = 150;
/// From this height on what happened lately stands below the queue.
const TALL: u16 = 24;
/// Rows of the printer's panel, with its border.
pub(super) const PRINTER_ROWS: u16 = 11;

pub(super) fn draw(canvas: &mut Canvas<'_, '_>, body: Rect) {
    let columns = if body.width >= THREE_COLUMNS {
        vec![Constraint::Fill(3), Constraint::Fill(2), Constraint::Fill(3)]
    } else {
        vec![Constraint::Fill(5), Constraint::Fill(4)]
    };
    let columns = Layout::horizontal(columns).split(body);
    let [top, chart] =
        Layout::vertical([Constraint::Length(PRINTER_ROWS), Constraint::Fill(1)]).areas(columns[0]);
    printer(canvas, top);
    temperatures(canvas, chart);
    match columns.get(2) {
        Some(news) => {
            queue(canvas, columns[1]);
            lately(canvas, *news);
        }
        None if body.height >= TALL => {
            let [jobs, news] = Layout::vertical([Constraint::Fill(3), Constraint::Fill(2)]).areas(columns[1]);
            queue(canvas, jobs);
            lately(canvas, news);
        }
        None => queue(canvas, columns[1]),
    }
}

pub(super) fn printer(canvas: &mut Canvas<'_, '_>, area: Rect) {
    let state = canvas.state;
    let Some(printer) = state.printer() else {
        let inner = canvas.panel(area, "printer");
        let line = canvas.span("This server has no printer.", Role::Dim);
        canvas.line(inner, line);
        return;
    };
    let title = match state.printers.len() {
        0 | 1 => printer.name.to_string(),
        n => {
            let at = state.printers.iter().position(|other| other.name == printer.name).unwrap_or(0);
            format!("{} ({} of {n}, [ and ] for others)", printer.name, at + 1)
        }
    };
    let inner = canvas.panel(area, &title);
    let Some(live) = &printer.live else {
        let line = canvas.span("It belongs to another server.", Role::Dim);
        canvas.line(inner, line);
        return;
    };
    doing(canvas, inner, printer, live);
    let is_heard = is_heard(live);
    heat(canvas, row(inner, 2), ("nozzle", Role::Hotend), live.hotend, is_heard);
    heat(canvas, row(inner, 3), ("bed", Role::Bed), live.bed, is_heard);
    match &live.says {
        // In full, where it does not fit into its line and nothing is printed.
        Some(says) if live.done.is_none() && says.chars().count() > usize::from(inner.width) => {
            let text = vec![Line::from(canvas.span(says.clone(), Role::Warn))];
            canvas.lines(Rect { height: inner.height.min(4), ..below(inner, 4) }, text);
        }
        _ => progress(canvas, below(inner, 4), printer, live),
    }
    fitted(canvas, row(inner, 8), printer);
}

const fn role_of(activity: Activity) -> Role {
    match activity {
        Activity::Offline | Activity::Faulted => Role::Bad,
        Activity::Idle => Role::Strong,
        Activity::Printing => Role::Good,
        Activity::Pausing | Activity::Paused | Activity::Cancelling => Role::Warn,
    }
}

/// Its state in words, and what it says.
fn doing(canvas: &mut Canvas<'_, '_>, area: Rect, printer: &PrinterView, live: &Live) {
    let state = canvas.state;
    let job = state.in_print().map(|job| {
        let copies = words::copies(job);
        let gap = if copies.is_empty() { "" } else { ", " };
        format!("  job {}{gap}{copies}", words::short(job.id))
    });
    let activity = words::activity(live.activity);
    let first = activity.chars().next().map(|c| c.to_uppercase().to_string()).unwrap_or_default();
    let line = vec![
        canvas.span(first + &activity[1..], role_of(live.activity)),
        canvas.span(job.unwrap_or_default(), Role::Text),
    ];
    canvas.line(area, Line::from(line));
    let (says, role) = match (&live.says, printer.bed) {
        (Some(says), _) => (says.clone(), Role::Warn),
        (None, BedView::Clear) if live.activity == Activity::Idle => why_idle(state, printer),
        (None, BedView::Unknown) => ("nobody knows whether its bed is clear".to_owned(), Role::Warn),
        (None, BedView::Taken(_)) if live.activity == Activity::Idle => {
            ("waits for its bed to be cleared".to_owned(), Role::Warn)
        }
        _ => (String::new(), Role::Dim),
    };
    let line = canvas.span(words::cut(&says, usize::from(area.width)), role);
    canvas.line(row(area, 1), line);
}

/// Why nothing is printed on a clear bed.
fn why_idle(state: &State, printer: &PrinterView) -> (String, Role) {
    let next = state.schedule.as_ref().and_then(|s| s.next.iter().find(|next| next.printer == printer.name));
    let why = next.and_then(|next| next.why_not.clone());
    (why.unwrap_or_else(|| "its bed is clear".to_owned()), Role::Dim)
}

/// A printer tells its temperatures while somebody speaks with it: what it told before may be long past.
fn heat(
    canvas: &mut Canvas<'_, '_>,
    area: Rect,
    (what, role): (&str, Role),
    heat: Option<Heat>,
    is_heard: bool,
) {
    let (measured, target) = match heat {
        Some(Heat { actual_c, .. }) if !is_heard => (format!("{actual_c:6.1} °C"), "  heard last".to_owned()),
        Some(Heat { actual_c, target_c }) if target_c > 0.0 => {
            (format!("{actual_c:6.1} °C"), format!(" → {target_c:.0} °C"))
        }
        Some(Heat { actual_c, .. }) => (format!("{actual_c:6.1} °C"), "   off".to_owned()),
        None => ("     –".to_owned(), String::new()),
    };
    let line = vec![
        canvas.span(format!("{what:<8}"), role),
        canvas.span(measured, if is_heard { Role::Strong } else { Role::Dim }),
        canvas.span(target, Role::Dim),
    ];
    canvas.line(area, Line::from(line));
}

/// By lines, by time, by filament; when it ends.
fn progress(canvas: &mut Canvas<'_, '_>, area: Rect, printer: &PrinterView, live: &Live) {
    let state = canvas.state;
    let (Some(done), Some(printed_s)) = (live.done, live.printed_s) else { return };
    let gauge = LineGauge::default()
        .ratio(done.clamp(0.0, 1.0))
        .label(canvas.span(format!("{:3.0} %  ", 100.0 * done), Role::Strong))
        .filled_symbol("█")
        .unfilled_symbol("░")
        .filled_style(canvas.style(Role::Good))
        .unfilled_style(canvas.style(Role::Border));
    canvas.draw(gauge, row(area, 0));
    let left_s = live.ends.map(|ends| words::seconds_to(state.now, ends));
    let left = left_s.map(|left| format!(", {} left", words::span(left))).unwrap_or_default();
    fact(canvas, row(area, 1), "time", &format!("{}{left}", words::span(printed_s)));
    if let Some(ends) = live.ends {
        fact(canvas, row(area, 2), "ends", &words::clock(ends, state.now, &state.zone));
    }
    if let Some(estimate) = state.job_on(printer).and_then(|job| job.estimate) {
        let all = estimate.filament_mm3 as f64;
        let text = format!("about {} of {}", words::filament(done * all), words::filament(all));
        fact(canvas, row(area, 3), "filament", &text);
    }
}

fn fact(canvas: &mut Canvas<'_, '_>, area: Rect, what: &str, text: &str) {
    let line = vec![canvas.span(format!("{what:<9}"), Role::Dim), canvas.span(text, Role::Text)];
    canvas.line(area, Line::from(line));
}

fn fitted(canvas: &mut Canvas<'_, '_>, area: Rect, printer: &PrinterView) {
    let Some(loaded) = &printer.loaded else { return };
    let left = loaded.left_mm3.map(|mm3| format!(", {} left", words::filament(mm3 as f64)));
    let nozzle_mm = f64::from(loaded.nozzle_um) / 1000.0;
    let text =
        format!("{}, {nozzle_mm:.2} mm{}, {}", loaded.material, left.unwrap_or_default(), loaded.profile);
    let text = words::cut(&text, usize::from(area.width).saturating_sub(9));
    fact(canvas, area, "fitted", &text);
}

/// A chart of the last ten minutes, both heaters.
pub(super) fn temperatures(canvas: &mut Canvas<'_, '_>, area: Rect) {
    let state = canvas.state;
    let title = format!("temperature, last {:.0} min", SPAN_S / 60.0);
    let inner = canvas.panel(area, &title);
    let Some(printer) = state.printer() else { return };
    let of = |heater| state.heats.points(&printer.name, heater, state.now);
    let (hotend, bed) = (of(Heater::Hotend), of(Heater::Bed));
    if hotend.is_empty() && bed.is_empty() {
        let line = canvas.span("Nothing was measured yet.", Role::Dim);
        canvas.line(inner, line);
        return;
    }
    let heard = state.doing().filter(|live| is_heard(live));
    let targets = [heard.and_then(|live| live.hotend), heard.and_then(|live| live.bed)];
    let targets = targets.into_iter().flatten().map(|heat| heat.target_c);
    let highest = hotend.iter().chain(&bed).map(|(_, c)| *c).chain(targets.clone()).fold(50.0, f64::max);
    let top = (highest / 50.0).ceil() * 50.0;
    let lines: Vec<_> = targets.filter(|c| *c > 0.0).map(|c| vec![(-SPAN_S, c), (0.0, c)]).collect();
    let set = |points, role, marker| {
        Dataset::default().data(points).graph_type(GraphType::Line).marker(marker).style(canvas.style(role))
    };
    let mut sets: Vec<_> = lines.iter().map(|line| set(line, Role::Dim, Marker::Dot)).collect();
    sets.push(set(&bed, Role::Bed, Marker::Braille));
    sets.push(set(&hotend, Role::Hotend, Marker::Braille));
    let style = canvas.style(Role::Dim);
    let labels = [0.0, top / 2.0, top].map(|c| Span::styled(format!("{c:3.0}"), style));
    let chart = Chart::new(sets)
        .style(canvas.style(Role::Text))
        .legend_position(None)
        .x_axis(Axis::default().bounds([-SPAN_S, 0.0]).style(style))
        .y_axis(Axis::default().bounds([0.0, top]).labels(labels).style(style));
    canvas.draw(chart, inner);
}

/// What is next, as far as there is room.
fn queue(canvas: &mut Canvas<'_, '_>, area: Rect) {
    let state = canvas.state;
    let inner = canvas.panel(area, "queue");
    let jobs: Vec<&JobView> = state.live.jobs.iter().take(usize::from(inner.height)).collect();
    if jobs.is_empty() {
        let text = vec![
            Line::from(canvas.span("No jobs.", Role::Dim)),
            Line::from(canvas.span("Add one: lumenfab queue add CASE|JOB.gcode|MODEL", Role::Dim)),
        ];
        canvas.lines(inner, text);
        return;
    }
    for (n, job) in (0u16..).zip(jobs) {
        let place = row(inner, n);
        let role = match job.state {
            JobState::Printing => Role::Good,
            JobState::Held | JobState::Draft => Role::Dim,
            _ => Role::Text,
        };
        let line = vec![
            canvas.span(format!("{}  ", words::short(job.id)), Role::Strong),
            canvas.span(format!("{:<18}", words::cut(words::state(job), 18)), role),
        ];
        canvas.line(place, Line::from(line));
        let when = ends(state, job.id).map(|ends| words::short_clock(ends, state.now, &state.zone));
        let when = canvas.span(when.unwrap_or_default(), Role::Dim);
        canvas.line_right(behind(place, 29), Line::from(when));
        canvas.clickable(place, Target::Command(Command::Queue));
    }
}

/// When all copies of a job are printed, as planned.
pub(super) fn ends(state: &State, job: JobId) -> Option<Timestamp> {
    let in_print = state.printers.iter().find(|printer| printer.bed == BedView::Taken(job));
    let planned = state.schedule.as_ref().and_then(|schedule| planned_end(schedule, job));
    planned.or_else(|| in_print?.live.as_ref()?.ends)
}

fn planned_end(schedule: &Schedule, job: JobId) -> Option<Timestamp> {
    schedule.slots.iter().filter(|slot| slot.job == job).map(|slot| slot.ends).max()
}

/// What happened, the newest first.
fn lately(canvas: &mut Canvas<'_, '_>, area: Rect) {
    let state = canvas.state;
    let inner = canvas.panel(area, "lately");
    for (n, record) in (0u16..inner.height).zip(&state.news) {
        let of = match (&record.job, &record.printer) {
            (Some(job), _) => words::short(*job),
            (None, Some(printer)) => Name::as_str(printer).to_owned(),
            (None, None) => String::new(),
        };
        let why = if record.why.is_empty() { String::new() } else { format!(": {}", record.why) };
        let at = words::clock(record.at, state.now, &state.zone);
        let text = format!("{} by {}{why}", words::what(record), record.who);
        let room = usize::from(inner.width).saturating_sub(at.chars().count() + 11);
        let line = vec![
            canvas.span(format!("{at} "), Role::Dim),
            canvas.span(format!("{:<8}  ", words::cut(&of, 8)), Role::Strong),
            canvas.span(words::cut(&text, room), Role::Text),
        ];
        canvas.line(row(inner, n), Line::from(line));
    }
}
