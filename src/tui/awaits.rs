//! What awaits the operator, the most urgent first, in plain words and with the command that does it.

use super::command::Command;
use super::heats::is_heard;
use super::state::{Came, Link, State, Stop};
use super::words;
use crate::http::wire::{Activity, BedView, JobView, PrinterView};
use crate::queue::State as JobState;

/// Something that awaits the operator.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Awaited {
    /// What, in plain words, without the key.
    pub(super) text: String,
    /// The command that does it; `None`: it is done at the printer.
    pub(super) command: Option<Command>,
    /// Whether something is wrong.
    pub(super) is_bad: bool,
}

/// All of it.
pub(super) fn awaited(state: &State) -> Vec<Awaited> {
    let faults = state.printers.iter().filter_map(fault);
    let paused = state.printers.iter().filter_map(|printer| {
        let job = state.job_on(printer)?;
        is_paused(printer, job).then(|| paused(printer, job))
    });
    let beds = state.printers.iter().filter(|printer| wants_clearing(state, printer));
    let beds = beds.filter_map(|printer| bed(state, printer));
    let reports = state.in_state(JobState::AwaitingSignOff).map(|job| Awaited {
        text: format!("job {} is printed: read its report, then accept or reject it", words::short(job.id)),
        command: Some(Command::SignOff),
        is_bad: false,
    });
    stop(state)
        .into_iter()
        .chain(connection(state))
        .chain(faults)
        .chain(paused)
        .chain(beds)
        .chain(reports)
        .chain(failed(state))
        .collect()
}

fn stop(state: &State) -> Option<Awaited> {
    let Stop { printer, asked, came, .. } = state.stop.as_ref()?;
    let asked = words::clock(*asked, state.now, &state.zone);
    let (text, command) = match came {
        Came::Nothing | Came::Sent => (
            format!(
                "EMERGENCY STOP of {printer}, {asked}: no word from the printer yet; be ready at its switch"
            ),
            None,
        ),
        Came::Stopped(Some(says)) => {
            (format!("{printer} has stopped (emergency stop, {asked}): {says}"), Some(Command::Seen))
        }
        Came::Stopped(None) => (
            format!(
                "{printer} does not print any more (emergency stop, {asked}), but says nothing: look at it"
            ),
            Some(Command::Seen),
        ),
        Came::Refused(why) => {
            (format!("EMERGENCY STOP of {printer} was NOT done, {asked}: {why}"), Some(Command::Seen))
        }
    };
    Some(Awaited { text, command, is_bad: true })
}

/// Jobs that have failed: nothing more happens to them unless somebody decides.
fn failed(state: &State) -> impl Iterator<Item = Awaited> {
    state.failed.iter().map(|(id, why)| Awaited {
        text: format!("job {} has failed: {why} (in the queue, v, R prints it again)", words::short(*id)),
        command: Some(Command::Seen),
        is_bad: true,
    })
}

/// The printer that an emergency stop means: the one that is shown, where it works or no other does.
pub(super) fn to_stop(state: &State) -> Option<&PrinterView> {
    let works = |printer: &&PrinterView| printer.live.as_ref().is_some_and(is_heard);
    state.printer().filter(works).or_else(|| state.printers.iter().find(works)).or_else(|| state.printer())
}

fn connection(state: &State) -> Option<Awaited> {
    let Link::Lost { since, why } = &state.link else { return None };
    let since = words::clock(*since, state.now, &state.zone);
    let text =
        format!("no connection since {since}, what you see is as it was then: {why}; it is tried again");
    Some(Awaited { text, command: None, is_bad: true })
}

fn fault(printer: &PrinterView) -> Option<Awaited> {
    let live = printer.live.as_ref()?;
    let text = match live.activity {
        Activity::Faulted => "stopped by a fault",
        Activity::Offline => "not connected",
        _ => return None,
    };
    let says = live.says.as_deref().unwrap_or("look at it");
    Some(Awaited { text: format!("{}: {text}: {says}", printer.name), command: None, is_bad: true })
}

const fn is_paused(printer: &PrinterView, job: &JobView) -> bool {
    let is_live = match &printer.live {
        Some(live) => matches!(live.activity, Activity::Paused),
        None => false,
    };
    is_live && job.state.is_at_printer()
}

fn paused(printer: &PrinterView, job: &JobView) -> Awaited {
    let says = printer.live.as_ref().and_then(|live| live.says.as_deref());
    let text = match says {
        Some(says) => format!("{}: {says}", printer.name),
        None => format!("{}: job {} is paused", printer.name, words::short(job.id)),
    };
    Awaited { text, command: Some(Command::GoOn), is_bad: says.is_some() }
}

fn bed(state: &State, printer: &PrinterView) -> Option<Awaited> {
    let name = &printer.name;
    let text = match printer.bed {
        BedView::Clear => return None,
        BedView::Unknown => {
            format!("{name}: look whether its bed is clear: nothing starts before you say so")
        }
        BedView::Taken(id) => {
            let job = state.job(id);
            let copy = job.map(words::copies).filter(|copy| !copy.is_empty());
            let copy = copy.map(|copy| format!(", {copy},")).unwrap_or_default();
            let what = match job.map(|job| job.state) {
                Some(JobState::AwaitingBedClear) => "is printed",
                Some(JobState::Failed | JobState::Cancelled) => "broke off",
                _ => "lies there",
            };
            format!("{name}: job {}{copy} {what}: take it off the bed, then say so", words::short(id))
        }
    };
    Some(Awaited { text, command: Some(Command::ClearBed), is_bad: false })
}

/// Whether its bed is to be looked at: what is in print is left alone.
pub(super) fn wants_clearing(state: &State, printer: &PrinterView) -> bool {
    let is_at_work = printer.live.as_ref().is_some_and(|live| {
        matches!(
            live.activity,
            Activity::Printing | Activity::Pausing | Activity::Paused | Activity::Cancelling
        )
    });
    match printer.bed {
        BedView::Clear => false,
        BedView::Unknown => !is_at_work,
        BedView::Taken(id) => !state.job(id).map_or(is_at_work, |job| {
            job.state.is_at_printer() && job.holder.as_ref() == Some(&printer.name)
        }),
    }
}

/// The printer whose bed is meant: the one that is shown, else the first one that wants it.
pub(super) fn bed_to_clear(state: &State) -> Option<&PrinterView> {
    let wants = |printer: &&PrinterView| wants_clearing(state, printer);
    state.printer().filter(wants).or_else(|| state.printers.iter().find(wants))
}

/// The paused job that is meant: that of the printer that is shown, else the first one.
pub(super) fn paused_job(state: &State) -> Option<&JobView> {
    let of = |printer: &PrinterView| {
        let job = state.printers.iter().find(|other| other.name == printer.name);
        job.and_then(|printer| state.job_on(printer)).filter(|job| is_paused(printer, job))
    };
    state.printer().and_then(of).or_else(|| state.printers.iter().find_map(of))
}
