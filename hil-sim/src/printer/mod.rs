//! The machine: a pure state machine from bytes and simulated time to bytes and events.
//!
//! Contract. Hand in what the host wrote with [`Printer::receive`]; let time pass with [`Printer::advance_to`] (a clock
//! from outside) or [`Printer::step`] (to the next event, as fast as possible); take what the printer says from
//! [`Printer::output`] and what happened from [`Printer::take_events`]. [`Printer::pace`] tells whether there is
//! anything to wait for.
//!
//! As in the firmware, one command is executed at a time and answers `ok` when it is done; a move is done when it is in the
//! planner. While a command waits, further lines are read until the command queue is full. Commands themselves take no
//! time; moves, waits and the wire do.
//!
//! Not done: SD card, several extruders, bed levelling, firmware retraction, EEPROM.

mod clock;
mod commands;
mod faults;
mod filament;
mod idle;
mod intake;
mod judge;
mod life;
mod limits;
mod motion;
mod replies;
mod strict;
#[cfg(test)]
mod tests;

use crate::{
    deposit::{Deposit, Laid},
    dialect::{Family, Numbering},
    event::{Event, Summary},
    planner::{Block, Planner, Position},
    profile::Profile,
    receive::{self, Emergency, Received, Receiver},
    spec::{Armed, FaultSpec, Progress},
    thermal::Heater,
    wire::{Incoming, Outgoing},
};
use filament::Change;
use idle::Idle;
use judge::Judge;
use motion::Motion;
use std::collections::VecDeque;

/// The firmware looks at its heaters this often, s.
const CHECK_S: f64 = 1.0;
/// What a simulated printer is made from.
#[derive(Debug, Clone)]
pub struct Options {
    /// The machine.
    pub profile: Profile,
    /// Speed of the wire; none: flow-controlled, takes no time.
    pub baud: Option<u32>,
    /// What goes wrong.
    pub faults: Vec<FaultSpec>,
    /// Of the faults.
    pub seed: u64,
    /// Whether every command is an event (beads and faults always are).
    pub record_commands: bool,
}

/// Whether time has to pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// Nothing waits: the clock may stand still.
    Idle,
    /// A command or the wire waits: the clock may jump.
    Work,
    /// The host is to notice the time: an outage, a late line, a wait for the user.
    RealTime,
}

/// Hotend or bed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum HeaterName {
    Hotend = 0,
    Bed = 1,
}

/// What the command at the head of the queue waits for.
#[derive(Debug, Clone, PartialEq)]
enum Wait {
    /// Room in the planner for the moves it consists of.
    Moves,
    /// The end of all moves; then something else.
    Drain(After),
    /// A moment, then something else.
    Until { t_s: f64, then: After },
    /// A temperature.
    Heat(HeatWait),
    /// The user, perhaps not beyond a moment.
    User { until_s: f64 },
}

/// What comes when all moves have ended.
#[derive(Debug, Clone, Copy, PartialEq)]
enum After {
    Nothing,
    Dwell(f64),
    Home([bool; 3]),
    /// The axes are there.
    AtHome([bool; 3]),
    MotorsOff,
    User(f64),
    /// The filament is taken out, then the user is waited for.
    Unload,
    Unloaded,
}

/// A command that waits for execution.
#[derive(Debug, Clone, PartialEq, Default)]
struct Queued {
    text: Vec<u8>,
    /// Its `ok` was said when it came, or none is due.
    is_answered: bool,
}

/// M109 or M190.
#[derive(Debug, Clone, Copy, PartialEq)]
struct HeatWait {
    heater: HeaterName,
    next_tick_s: f64,
    /// Since when it has been at its target.
    reached_s: Option<f64>,
}

/// Whether the firmware lives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Life {
    Off,
    /// Without power, or in its boot loader.
    Down,
    Running,
    /// It has stopped, and says so to every command.
    Halted,
    Killed,
}

/// A simulated printer.
#[derive(Debug)]
pub struct Printer {
    profile: Profile,
    seed: u64,
    now_s: f64,
    incoming: Incoming,
    outgoing: Outgoing,
    receiver: Receiver,
    queue: VecDeque<Queued>,
    wait: Option<Wait>,
    life: Life,
    /// Why Klipper is shut down.
    halt_reason: String,
    /// A change of filament under way.
    change: Option<Change>,
    idle: Idle,
    judge: Judge,
    /// When the last bytes came from the host.
    traffic_s: f64,
    /// Since when nobody has had the port open.
    alone_s: Option<f64>,
    /// Until then it neither reads nor answers.
    silent_until_s: f64,
    /// Until then there is no port.
    unplugged_until_s: f64,
    planner: Planner,
    motion: Motion,
    heaters: [Heater; 2],
    fan: u8,
    deposit: Deposit,
    faults: Vec<Armed>,
    /// Lasting faults and when they end.
    lasting: Vec<(f64, FaultSpec)>,
    filament_out: bool,
    /// When a board that is down starts.
    boots_s: f64,
    /// By how much the next request to send again is off.
    resend_error: Option<i64>,
    report_interval_s: f64,
    next_report_s: f64,
    keepalive_s: f64,
    next_busy_s: f64,
    next_check_s: f64,
    lines_from_host: u64,
    /// The last move ended with no other behind it and no command waiting for that.
    ran_dry: bool,
    /// What M0 asks the user.
    prompt: Vec<u8>,
    record_commands: bool,
    events: Vec<Event>,
    summary: Summary,
}

impl Printer {
    /// A printer without power; [`Self::host_arrived`] turns it on.
    #[must_use]
    pub fn new(options: Options) -> Self {
        let Options { profile, baud, faults, seed, record_commands } = options;
        let armed = faults.into_iter().zip(0..).map(|(spec, index)| Armed::new(spec, seed, index)).collect();
        Self {
            now_s: 0.0,
            seed,
            incoming: Incoming::new(baud),
            outgoing: Outgoing::new(baud),
            receiver: Receiver::new(profile.rx_ring_bytes, profile.line_bytes, profile.dialect),
            queue: VecDeque::new(),
            wait: None,
            life: Life::Off,
            halt_reason: String::new(),
            change: None,
            idle: Idle::new(profile.dialect, 0.0),
            judge: Judge::default(),
            traffic_s: 0.0,
            alone_s: None,
            silent_until_s: 0.0,
            unplugged_until_s: 0.0,
            planner: Planner::new(profile.planner_blocks).with_queue_s(profile.queue_s),
            motion: Motion::new(&profile),
            heaters: profile
                .heaters
                .map(|model| Heater::new(model, profile.ambient_c).with_noise(profile.sensor_noise_c)),
            fan: 0,
            deposit: Deposit::new(&profile),
            faults: armed,
            lasting: Vec::new(),
            filament_out: false,
            boots_s: f64::INFINITY,
            resend_error: None,
            report_interval_s: 0.0,
            next_report_s: 0.0,
            keepalive_s: 2.0,
            next_busy_s: 0.0,
            next_check_s: 0.0,
            lines_from_host: 0,
            ran_dry: false,
            prompt: Vec::new(),
            record_commands,
            events: Vec::new(),
            summary: Summary::default(),
            profile,
        }
    }

    /// Simulated time, s.
    #[must_use]
    pub const fn now_s(&self) -> f64 {
        self.now_s
    }

    /// Whether there is a port for the host to open.
    #[must_use]
    pub fn is_plugged(&self) -> bool {
        self.now_s >= self.unplugged_until_s
    }

    /// Whether the port has vanished for good.
    #[must_use]
    pub const fn is_gone(&self) -> bool {
        self.unplugged_until_s == f64::INFINITY
    }

    /// Whether it does not listen: no bytes need be taken from the host.
    #[must_use]
    pub fn is_holding_back(&self) -> bool {
        self.incoming.bytes_under_way() > 4096
    }

    /// A host has opened the port: a printer that is off starts, and so does one that the port's lines reset. One that has
    /// stopped for good stays so until its power is switched.
    pub fn host_arrived(&mut self) {
        self.alone_s = None;
        self.state("host-arrived", String::new());
        if self.life == Life::Off || self.profile.resets_on_open {
            self.reset();
        }
    }

    /// Somebody switches the printer off and on.
    pub fn switch_off_and_on(&mut self) {
        self.reset();
        self.settle();
    }

    /// The host has closed the port: what it has written still arrives, what is said is lost.
    pub fn host_left(&mut self) {
        self.alone_s = Some(self.now_s);
        self.state("host-left", String::new());
        if let Some(rest) = self.incoming.take_rest() {
            self.incoming.launch(self.now_s, rest, 0.0);
        }
        self.outgoing.clear(self.now_s);
        self.settle();
    }

    /// The host has written `bytes`.
    pub fn receive(&mut self, bytes: &[u8]) {
        if self.is_plugged() && !matches!(self.life, Life::Off | Life::Down) {
            self.note_unattended();
            self.traffic_s = self.now_s;
            self.idle.heard(self.now_s);
            for line in self.incoming.take_lines(bytes) {
                self.send_line_to_printer(line);
            }
        }
        self.settle();
    }

    /// What the printer has said and the wire has carried; take away what was passed on.
    pub const fn output(&mut self) -> &mut Vec<u8> {
        self.outgoing.ready()
    }

    /// What has happened since the last call.
    pub fn take_events(&mut self) -> std::vec::Drain<'_, Event> {
        self.events.drain(..)
    }

    /// Somebody presses its button, for which it waits.
    pub fn press_button(&mut self) {
        self.emergency(Emergency::Continue);
        self.settle();
    }

    /// Whether moves are planned that nobody waits for.
    #[must_use]
    pub fn has_moves(&self) -> bool {
        self.planner.depth() > 0
    }

    fn is_silent(&self) -> bool {
        self.silent_until_s > self.now_s
    }

    fn say_busy(&mut self) {
        self.next_busy_s = self.now_s + self.keepalive_s;
        let user = matches!(self.wait, Some(Wait::User { .. }));
        let busy = self.profile.dialect.busy;
        let is_marlin = self.profile.dialect.family == Family::Marlin;
        if !busy.is_empty() {
            self.say(if user && is_marlin { "echo:busy: paused for user" } else { busy });
        }
    }

    fn start_block(&mut self) {
        let Some(block) = self.planner.start().copied() else { return };
        if let Some(layer) = self.deposit.begin(&block) {
            let z_mm = block.to[2] + self.deposit.shift_mm[2];
            self.state("layer", format!("{layer} z {z_mm:.3}"));
            self.strike_machine(false);
        }
        self.judge_start(&block);
    }

    fn finish_block(&mut self) {
        if let Some(block) = self.planner.finish() {
            self.lay(&block);
            let (depth, expected) = (self.planner.depth(), self.is_meant_to_stand());
            self.ran_dry = depth == 0 && !expected;
            self.judge.move_ended(depth, self.now_s, expected);
            if depth == 0 {
                self.idle.touch(self.now_s);
            }
        }
    }

    /// A move, or the part of it that was driven, becomes material.
    fn lay(&mut self, block: &Block) {
        self.motion.driven = block.to;
        self.summary.moves += 1;
        let Some(profile) = block.profile else { return };
        self.summary.moving_s += profile.duration_s().min(self.now_s - profile.start_s);
        // A heater is in closed form since its last change, which is rarely after the start of the move under way.
        let hotend_c = self.heaters[0].temperature_c(profile.start_s);
        match self.deposit.finish(block, profile.start_s, hotend_c) {
            Laid::Nothing => {}
            Laid::Blob(volume) => self.summary.blob_mm3 += volume,
            Laid::Bead(bead) => {
                self.summary.beads += 1;
                self.summary.deposited_mm3 += bead.volume_mm3;
                self.judge.bead(&bead);
                self.events.push(Event::Bead(bead));
            }
        }
    }

    /// Everything that can happen now happens.
    fn settle(&mut self) {
        self.outgoing.advance(self.now_s);
        loop {
            let (mut moved, order) = self.incoming.deliver(self.now_s, &mut self.receiver);
            if let Some(order) = order.filter(|order| self.profile.dialect.urgent.by_byte.contains(order)) {
                self.emergency(order);
            }
            if !self.listens() {
                self.receiver.clear();
            } else if !self.is_silent() {
                moved |= self.fetch();
                // A line may have brought a fault.
                if self.listens() && !self.is_silent() {
                    moved |= self.work();
                }
            }
            if !moved {
                return;
            }
        }
    }

    /// Goes on with the command at the head of the queue.
    fn work(&mut self) -> bool {
        let Some(front) = self.queue.front_mut() else { return false };
        let text = std::mem::take(&mut front.text);
        let outcome = match self.wait.take() {
            Some(wait) => self.go_on(wait),
            None => {
                self.next_busy_s = self.now_s + self.keepalive_s;
                if self.profile.dialect.idle.commands_count {
                    self.idle.touch(self.now_s);
                }
                self.execute(&text)
            }
        };
        // The command may have stopped or restarted the firmware.
        let Some(front) = self.queue.front_mut() else { return true };
        front.text = text;
        if let commands::Outcome::Wait(wait) = outcome {
            let over = matches!(wait, Wait::Until { t_s, .. } if t_s <= self.now_s);
            self.wait = Some(wait);
            return over;
        }
        self.end_change();
        if outcome == commands::Outcome::Done {
            self.say_ok();
        }
        self.retire();
        true
    }

    fn retire(&mut self) {
        // What took its time was no idleness.
        if self.planner.depth() == 0 && self.profile.dialect.idle.commands_count {
            self.idle.touch(self.now_s);
        }
        self.queue.pop_front();
        self.summary.commands_executed += 1;
    }

    fn emergency(&mut self, order: Emergency) {
        if self.life != Life::Running {
            return;
        }
        match order {
            Emergency::Continue => {
                if matches!(self.wait, Some(Wait::Heat(_) | Wait::User { .. })) {
                    let at_once = Wait::Until { t_s: self.now_s, then: After::Nothing };
                    self.wait = Some(self.go_on_changing().unwrap_or(at_once));
                }
            }
            Emergency::Kill => self.kill_by_order(),
            Emergency::QuickStop => self.quick_stop(),
        }
    }

    /// Stops all motion where it is; planned moves are forgotten.
    fn stop_motion(&mut self) {
        if let Some(block) = self.planner.stop(self.now_s) {
            self.lay(&block);
        }
        self.judge.pause();
        self.motion.pending.clear();
    }

    /// M410.
    fn quick_stop(&mut self) {
        self.stop_motion();
        self.motion.take_position_from_motors();
        self.state("stopped", self.position_text());
    }

    /// Whether lines are read and answered.
    const fn listens(&self) -> bool {
        matches!(self.life, Life::Running | Life::Halted)
    }

    fn state(&mut self, state: &'static str, detail: String) {
        self.events.push(Event::State { t_s: self.now_s, state, detail });
    }

    fn progress(&self) -> Progress {
        Progress {
            now_s: self.now_s,
            lines: self.summary.lines_received,
            layer: self.deposit.layers.current(),
        }
    }

    /// Where the motors are.
    fn driven(&self) -> Position {
        self.planner.position_at(self.now_s).unwrap_or(self.motion.driven)
    }
}
