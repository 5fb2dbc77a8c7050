//! What a print tells, in the operator's words.

use crate::app::event::{Event, Stage};
use crate::app::session::Context;
use crate::printer::control::Control;
use crate::printer::driver::PrintEvent;
use crate::printer::protocol;
use crate::progress::Task;
use tokio::sync::mpsc;

/// Marlin's word for that.
const HEATER_TIMEOUT: &str = "HeaterTimeout";

/// Passes on what the printer tells, until the print has ended.
pub(super) async fn show(mut events: mpsc::Receiver<PrintEvent>, task: &Task<'_>, context: &Context<'_>) {
    let stage = Stage::Print;
    let mut is_paused = false;
    while let Some(event) = events.recv().await {
        match &event {
            PrintEvent::Session(protocol::Event::Paused) => is_paused = true,
            PrintEvent::Session(protocol::Event::Resumed) => is_paused = false,
            // A firmware in a pause says that it is busy; what is told of it stays.
            PrintEvent::Session(protocol::Event::Busy(_)) if is_paused => continue,
            _ => {}
        }
        if let PrintEvent::Progress { n_lines_done, n_lines } = event {
            task.report(n_lines_done, n_lines);
        } else if let Some((code, text)) = told(&event) {
            (context.events)(Event::Told { stage, code, text });
        } else if let Some(text) = noted(&event) {
            (context.events)(Event::Note { stage, text });
        } else {
            tracing::debug!("printer: {event:?}");
        }
    }
}

/// What the operator should not miss, with a stable name.
fn told(event: &PrintEvent) -> Option<(&'static str, String)> {
    use protocol::Event as Said;
    let session = match event {
        PrintEvent::PortLost { hold } => {
            let text = format!(
                "the port vanished: check the cable; the print goes on by itself within {} s, the heaters may be on",
                hold.as_secs()
            );
            return Some(("printer.port_lost", text));
        }
        PrintEvent::WentOn { n_lines_done } => {
            return Some(("printer.went_on", format!("goes on exactly behind line {n_lines_done}")));
        }
        PrintEvent::JournalFailed(why) => {
            let text =
                format!("the journal cannot be written ({why}): the print goes on, but could not be resumed");
            return Some(("printer.journal_failed", text));
        }
        PrintEvent::JournalWorks => {
            return Some(("printer.journal_works", "the journal can be written again".to_owned()));
        }
        PrintEvent::LeftHot { hotend_c, bed_c } => {
            let text = format!(
                "the job ends with its heaters on (nozzle {hotend_c:.0} °C, bed {bed_c:.0} °C): `lumenfab safe-off` switches them off; \
                 firmware with a time-out of its own does so when nothing has moved for the profile's orphan_hold_s"
            );
            return Some(("printer.left_hot", text));
        }
        PrintEvent::Asked(control) => return Some(("printer.asked", asked(*control))),
        PrintEvent::NothingToDo(control) => {
            return Some(("printer.nothing_to_do", nothing_to_do(*control).to_owned()));
        }
        PrintEvent::StillPausing => {
            let text =
                "it pauses as soon as the printer has done what it has: heating and homing too end first";
            return Some(("printer.still_pausing", text.to_owned()));
        }
        PrintEvent::Session(session) => session,
        PrintEvent::AsksToLay | PrintEvent::Progress { .. } => return None,
    };
    Some(match session {
        Said::NoAnswerYet => (
            "printer.no_answer_yet",
            "the printer has not answered as it should yet; it is asked for up to a minute: is it on, and not stopped for good?".to_owned(),
        ),
        Said::Paused => ("printer.paused", "paused, the heaters stay on".to_owned()),
        Said::Resumed => ("printer.resumed", "goes on".to_owned()),
        Said::Prompt(Some(prompt)) if prompt.text.contains(HEATER_TIMEOUT) => (
            "printer.cooled",
            format!(
                "the printer has let its nozzle go cold while it waits, and heats it again when told: {prompt}"
            ),
        ),
        Said::Prompt(Some(prompt)) => ("printer.prompt", format!("the printer asks: {prompt}")),
        Said::Prompt(None) => ("printer.prompt_over", "the printer's question is answered".to_owned()),
        // Nobody is there to be told.
        Said::Faulted(fault @ protocol::Fault::LinkLost) => {
            ("printer.given_up", format!("given up: {fault}"))
        }
        Said::Faulted(fault) => {
            ("printer.given_up", format!("given up: {fault}; the heaters are being switched off"))
        }
        Said::Secured(heat) => ("printer.heat", heat.to_string()),
        _ => return None,
    })
}

/// What the operator has asked for, to show that it was understood.
fn asked(control: Control) -> String {
    match control {
        Control::Pause => "asked to pause".to_owned(),
        Control::GoOn => "asked to go on".to_owned(),
        Control::Stop => "asked to stop".to_owned(),
        Control::EmergencyStop => "asked to stop at once".to_owned(),
        Control::Answer(button_idx) => format!("answered with [{button_idx}]"),
    }
}

/// Why what the operator has asked for changes nothing.
const fn nothing_to_do(control: Control) -> &'static str {
    match control {
        Control::Pause => "it is paused already",
        Control::GoOn => "nothing waits: it prints",
        Control::Answer(_) => "the printer asks nothing that could be answered so",
        Control::Stop | Control::EmergencyStop => "it is being stopped already",
    }
}

/// What is worth a glance.
fn noted(event: &PrintEvent) -> Option<String> {
    use protocol::Event as Said;
    let PrintEvent::Session(session) = event else { return None };
    Some(match session {
        Said::Busy(what) => format!("printer: {what}"),
        Said::Action(what) => format!("printer asks: {what}"),
        Said::Message(what) => format!("printer: {what}"),
        Said::NeverAsksAgain => {
            "the printer does not ask for damaged lines: each is missed when no answer comes, and found by its place"
                .to_owned()
        }
        Said::Recovered(protocol::Recovery::Resent { line }) => {
            format!("line {line} was damaged, sent again")
        }
        Said::Recovered(protocol::Recovery::LostOk { count }) => {
            format!("{count} answers were lost, made up for")
        }
        _ => return None,
    })
}
