//! The printer by hand: emergency stop, port, moves, heaters, filament, lines of G-code.

use super::does::{ask, connected};
use crate::http::wire::{Access, Activity, Order, Ordered};
use crate::queue::Reason;
use crate::tui::awaits::to_stop;
use crate::tui::command::Command;
use crate::tui::form::{About, BED, Field, Form, LENGTH, NOZZLE, Takes, order};
use crate::tui::message::{Effect, Request};
use crate::tui::state::{Came, Overlay, STEPS_MM, Sent, State, Stop, works};

/// What may be set by hand, °C: what the server's own limits are where the configuration says nothing else.
const MOST_HOTEND_C: i32 = 280;
const MOST_BED_C: i32 = 120;
/// Below that, filament does not flow, °C.
const LEAST_FLOW_C: i32 = 170;
/// Filament that is moved at once, mm.
const MOST_FILAMENT_MM: i32 = 100;
/// Speed of moves in the plane and along Z, mm/min.
const FEEDRATES_MM_MIN: [u32; 2] = [3000, 300];
/// Orders that are kept to be shown.
const MOST_SENT: usize = 100;

/// Sends it, or says that it cannot be sent: with or without a connection something is said.
pub(super) fn emergency_stop(state: &mut State) -> Vec<Effect> {
    let found = to_stop(state).map(|printer| (printer.name.clone(), printer.live.clone()));
    let Some((printer, live)) = found else {
        state.say("emergency stop: no printer is known: use the printer's own switch", true);
        return Vec::new();
    };
    let (asked, came) = (state.now, Came::Nothing);
    let before = live.filter(|live| !works(live.activity)).map(|live| (live.activity, live.says));
    state.stop = Some(Stop { printer: printer.clone(), asked, came, before });
    if let Err(why) = connected(state) {
        came_of_stop(state, Came::Refused(format!("{why}: use the printer's own switch")));
        return Vec::new();
    }
    let why = Reason::try_new("emergency stop").unwrap_or_default();
    let ordered = Ordered { order: Order::EmergencyStop, name: None, why };
    vec![Effect::Ask(Request::Order(printer, ordered))]
}

fn came_of_stop(state: &mut State, came: Came) {
    if let Some(stop) = &mut state.stop {
        stop.came = came;
    }
    state.look_after_stop();
}

/// What the server said to an order.
pub(in crate::tui) fn ordered(state: &mut State, order: &Order, answer: Result<(), String>) {
    match order {
        Order::EmergencyStop => came_of_stop(state, answer.map_or_else(Came::Refused, |()| Came::Sent)),
        Order::Commands(lines) => {
            let open = |sent: &&mut Sent| sent.answer.is_none() && sent.lines == *lines;
            if let Some(sent) = state.by_hand.sent.iter_mut().rev().find(open) {
                sent.answer = Some(answer);
            }
        }
        Order::Connect | Order::Disconnect => {}
    }
}

/// Whether the printer takes lines now.
pub(super) fn may_move(state: &State) -> Result<(), String> {
    connected(state)?;
    let live = state.doing().ok_or_else(|| "there is no printer".to_owned())?;
    let is_admin = state.me.as_ref().is_some_and(|me| me.access == Access::Admin);
    match live.activity {
        _ if !is_admin => Err("your key does not allow it (role admin)".to_owned()),
        _ if live.port.as_deref() == Some("sim") => {
            Err("the simulated printer lives only as long as its print".to_owned())
        }
        Activity::Idle => Ok(()),
        Activity::Offline => Err("it is not connected".to_owned()),
        Activity::Faulted => Err("it has stopped by a fault".to_owned()),
        _ => Err("it is printing".to_owned()),
    }
}

pub(super) fn may_connect(state: &State, command: Command) -> Result<(), String> {
    connected(state)?;
    let live = state.doing().ok_or_else(|| "there is no printer".to_owned())?;
    match (command, live.activity) {
        (Command::Connect, Activity::Idle) => Err("it is connected".to_owned()),
        (Command::Disconnect, Activity::Offline) => Err("it is not connected".to_owned()),
        (_, Activity::Idle | Activity::Offline | Activity::Faulted) => Ok(()),
        _ => Err("it is printing".to_owned()),
    }
}

pub(super) fn it(state: &mut State, command: Command) -> Vec<Effect> {
    let step = STEPS_MM[state.by_hand.step];
    match command {
        Command::Home => command_lines(state, vec!["G28".to_owned()]),
        Command::Left => step_along(state, &format!("X-{step}"), 0),
        Command::Right => step_along(state, &format!("X{step}"), 0),
        Command::Forth => step_along(state, &format!("Y-{step}"), 0),
        Command::Back => step_along(state, &format!("Y{step}"), 0),
        Command::Lower => step_along(state, &format!("Z-{step}"), 1),
        Command::Raise => step_along(state, &format!("Z{step}"), 1),
        Command::HeatersOff => command_lines(state, vec!["M104 S0".to_owned(), "M140 S0".to_owned()]),
        Command::Connect => connection(state, Order::Connect),
        Command::Disconnect => connection(state, Order::Disconnect),
        Command::LongerStep => {
            state.by_hand.step = (state.by_hand.step + 1).min(STEPS_MM.len() - 1);
            Vec::new()
        }
        Command::ShorterStep => {
            state.by_hand.step = state.by_hand.step.saturating_sub(1);
            Vec::new()
        }
        Command::Heat => opened(state, heat),
        Command::Extrude => opened(state, extrude),
        Command::Console => {
            state.overlay = Some(Overlay::Console(String::new(), 0));
            Vec::new()
        }
        _ => Vec::new(),
    }
}

fn step_along(state: &mut State, word: &str, feedrate: usize) -> Vec<Effect> {
    let feedrate = FEEDRATES_MM_MIN[feedrate];
    command_lines(state, vec!["G91".to_owned(), format!("G0 {word} F{feedrate}"), "G90".to_owned()])
}

fn connection(state: &mut State, order: Order) -> Vec<Effect> {
    let Some(printer) = state.printer().map(|printer| printer.name.clone()) else { return Vec::new() };
    ask(state, Request::Order(printer, Ordered { order, name: None, why: Reason::default() }))
}

/// Sends lines to the printer that is shown.
pub(in crate::tui) fn command_lines(state: &mut State, lines: Vec<String>) -> Vec<Effect> {
    if let Err(why) = may_move(state) {
        state.say(why, true);
        return Vec::new();
    }
    let Some(printer) = state.printer().map(|printer| printer.name.clone()) else { return Vec::new() };
    let request = order(&printer, lines);
    note(state, &request);
    ask(state, request)
}

/// Keeps what is sent to be shown.
pub(super) fn note(state: &mut State, request: &Request) {
    if let Request::Order(_, Ordered { order: Order::Commands(lines), .. }) = request {
        state.by_hand.sent.push_front(Sent { at: state.now, lines: lines.clone(), answer: None });
        state.by_hand.sent.truncate(MOST_SENT);
    }
}

fn opened(state: &mut State, form: fn(&State) -> Option<Form>) -> Vec<Effect> {
    state.overlay = form(state).map(|form| Overlay::Form(Box::new(form)));
    Vec::new()
}

fn heat(state: &State) -> Option<Form> {
    let name = &state.printer()?.name;
    let says = vec!["What is left empty stays as it is; 0 is off.".to_owned(), SWITCHED_OFF.to_owned()];
    let fields = vec![
        Field::new(NOZZLE, Takes::NumberOrNone(0, MOST_HOTEND_C)),
        Field::new(BED, Takes::NumberOrNone(0, MOST_BED_C)),
    ];
    Some(Form::new(About::Heat(name.clone()), format!("Heat {name}"), says, fields))
}

/// Said wherever heaters go on by hand.
const SWITCHED_OFF: &str = "The server switches heaters off by itself where no print follows.";

fn extrude(state: &State) -> Option<Form> {
    let name = &state.printer()?.name;
    let says = vec![
        "The nozzle is heated first, which may take minutes. Below 0 mm filament is drawn back.".to_owned(),
        "Material may come out: the bed is in doubt then, until somebody says that it is clear.".to_owned(),
        SWITCHED_OFF.to_owned(),
    ];
    let fields = vec![
        Field::new(NOZZLE, Takes::Number(LEAST_FLOW_C, MOST_HOTEND_C)),
        Field::new(LENGTH, Takes::Number(-MOST_FILAMENT_MM, MOST_FILAMENT_MM)),
    ];
    Some(Form::new(About::Extrude(name.clone()), format!("Move filament of {name}"), says, fields))
}
