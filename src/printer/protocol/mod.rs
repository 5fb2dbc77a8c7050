//! The conversation with a firmware of the Marlin family, as a pure state machine: no port, no clock, no thread.
//!
//! **Contract.** After every `handle_*` call, drain [`Core::poll_transmit`] and [`Core::poll_event`] until they are
//! empty; then [`Core::poll_timeout`] is the moment at which [`Core::handle_timeout`] is due. Time never runs back.
//!
//! # Method
//!
//! Lines are numbered and carry a checksum, and the firmware accepts them in order only. So each is executed exactly
//! once as long as (1) the text of a number never changes, (2) a line asked for again can be sent again, and (3) at
//! the end the firmware itself names the last number. Everything else, also which `ok` is for which line, is flow
//! control and may be wrong for a while. What makes it hard is that every answer may be lost, damaged or doubled:
//!
//! - **Refusals** come twice, as `Error:..., Last Line: N` and as `Resend: N+1`. Only where both agree does the core go back.
//!   Else it asks.
//! - **Asking (the probe)** is a numbered line far ahead, which cannot be accepted: its refusal names the last line that
//!   was. (Repeating an old line would not do: it may be answered by silence.) It is asked when nothing came for
//!   [`Firmware::response_timeout_s`](crate::profile::Firmware::response_timeout_s), after anything doubtful, and at the end as the proof.
//! - **A lost `ok`.** If the firmware has read everything but acknowledgements are missing, it may still be executing. So it is
//!   asked for its temperatures, without a number: that waits in its queue behind all the rest, and the answer, which no other
//!   line has, proves that nothing is left.
//! - **Echoes.** Lines that were on their way behind a refused one are refused too, each with its own `Resend`, and each time the
//!   receive buffer is emptied. So the refused line goes alone until it is acknowledged, with further copies on further
//!   refusals: copies too many are passed over in silence.
//! - **Foreign commands.** A line whose `N` was damaged runs as a command of its own (`Unknown command`); the `ok` that follows
//!   acknowledges no line of ours.
//!
//! # Faults
//!
//! Each path to [`State::Faulted`] sends the profile's `safe` script (heaters off), unnumbered and again and again until the firmware
//! tells that the targets are 0 ([`Event::Secured`]), except where the link is gone. What is done about which fault is the table of
//! [`super::policy`]. `start` in the middle of a job is a reset: the job is given up, never begun again.
//!
//! # Limits
//!
//! The checksum has eight bits: of damages that hit more than one bit (two lines run together, for one) one in 256
//! passes it, and the firmware then executes what it has read.
//! Firmware that counts no lines gives no proof. RepRapFirmware gets one line at a time, and in doubt is asked where it is;
//! Klipper and whatever else takes lines without numbers have many in flight, behind a link that must not damage them: a line that is
//! refused there ends the print, and those behind it may be executed.
//! Memory is bounded: a few hundred lines of history.

mod allowance;
mod alone;
mod command;
mod event;
mod fault;
mod greeting;
mod guard;
mod inquiry;
mod lines;
mod owed;
mod patience;
mod pause;
mod planner;
mod prompt;
mod recovery;
mod reply;
mod safety;
mod slow;
#[cfg(test)]
mod tests;
mod time;
mod wire;

pub use command::{Command, Refused, State};
pub use event::{Ahead, Event, Progress, Recovery, Stats};
pub use fault::Fault;
pub use greeting::Greeting;
pub use inquiry::{Inquiry, Question};
pub use lines::{LineSplitter, MAX_LINE_BYTES};
pub use planner::Held;
pub use prompt::{Button, Prompt};
pub use reply::{Acknowledgement, Heater, Position, Refusal, Reply, Temperatures, parse};
pub use safety::Heat;
pub use time::{Instant, Timer};

use super::policy::{self, Action, Trouble};
use crate::profile::{Dialect, Profile, ResendStyle};
use alone::Alone;
use guard::Guard;
use owed::Debts;
use pause::{Awaited, Pulse};
use planner::Planner;
use prompt::Prompts;
use recovery::{Late, NextOk, Probe, Rewind};
use safety::Securing;
use std::collections::VecDeque;
use std::time::Duration;
use time::Timers;
use wire::{Origin, Wire};

/// Job lines kept ready behind the one to be sent next.
const QUEUE_AHEAD: u64 = 64;

/// A firmware that is alive but executing says `busy` this often.
const BUSY_INTERVAL: Duration = Duration::from_secs(2);

/// Silence of so many response time-outs is a fault.
const SILENCE_FACTOR: u32 = 15;

/// Bytes for the port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Line<'a> {
    /// With line feed.
    pub bytes: &'a [u8],
}

/// What the profile says, ready for use.
#[derive(Debug, Clone)]
struct Config {
    firmware: crate::profile::Firmware,
    response: Duration,
    slow_command: Duration,
    boot: Duration,
    prelude: Vec<String>,
    postlude: Vec<String>,
    /// What of it takes the guard of the heaters back.
    guard_end: Vec<String>,
    safe: Vec<String>,
    /// The firmware's time-out for hosts that are gone.
    guard: Option<guard::Words>,
}

/// What is awaited first: the acknowledgement of the oldest line in flight; where there is none, the answer to a question.
#[derive(Debug, Clone, Copy)]
struct Oldest {
    /// The line's number; for a question that of the line which would come next.
    number: u64,
    since: Instant,
}

/// The state machine; see the module.
#[derive(Debug)]
pub struct Core {
    config: Config,
    state: State,
    wire: Wire,
    /// Lines that go before all others.
    urgent: VecDeque<String>,
    /// The urgent line that was given out last.
    out: String,
    events: VecDeque<Event>,
    timers: Timers,
    now: Instant,
    /// When something was heard last.
    heard: Instant,
    /// Since when the firmware owes a sign of progress.
    quiet_since: Instant,
    oldest: Option<Oldest>,
    user_awaited: Option<Awaited>,
    next_ok: NextOk,
    /// The last line, as a refusal has named it; `Resend` must agree.
    refused: Option<(Refusal, u64)>,
    rewind: Option<Rewind>,
    late: Late,
    /// The last request was for line 1, long after it.
    may_be_reset: bool,
    probe: Option<Probe>,
    /// `ok` with line numbers were seen: one without belongs to none of our lines.
    is_advanced: bool,
    owed: Debts,
    planner: Planner,
    /// Lines of noise since something was understood.
    n_garbled: u64,
    /// The only line in flight, where lines are not counted.
    alone: Alone,
    /// What the printer is asked for first: its last line, none of which was higher; nothing where it is greeted.
    inquired_beyond: Option<u64>,
    /// Lines of ours that came back.
    n_echoed: u32,
    pulse: Pulse,
    guard: Guard,
    prompts: Prompts,
    securing: Securing,
    stats: Stats,
}

/// Whether an `ok` has something behind it that is not understood: it may be the answer to a question, damaged.
fn is_odd(line: &str, ok: &Acknowledgement) -> bool {
    let rest = line.trim().strip_prefix("ok").unwrap_or_default().trim();
    // Repetier's bare number of a line.
    let is_bare = rest.bytes().all(|b| b.is_ascii_digit());
    !is_bare && ok.line.is_none() && ok.temperatures.is_none() && ok.position.is_none()
}

/// Temperature reports, the firmware's own time-out that switches the heaters off when nobody speaks to it any more, and
/// motors that hold their place as long.
fn prelude_of(profile: &Profile) -> Vec<String> {
    let every_s = profile.firmware.temperature_report_s;
    let reports = (every_s > 0.0).then(|| format!("M155 S{}", every_s.ceil()));
    reports.into_iter().chain(profile.orphan_gcode()).chain(profile.motors_gcode()).collect()
}

/// A numbered line after the last one of the job: without it a damaged number there would go unnoticed. Then what the prelude
/// has set is taken back.
fn postlude_of(profile: &Profile) -> Vec<String> {
    let reports = (profile.firmware.temperature_report_s > 0.0).then(|| "M155 S0".to_owned());
    std::iter::once("M400".to_owned()).chain(reports).chain(profile.orphan_end_gcode()).collect()
}

fn guard_of(profile: &Profile) -> Option<guard::Words> {
    let every = guard::renewal(profile.firmware.orphan_hold_s)?;
    Some(guard::Words { set: profile.orphan_gcode()?, lift: profile.orphan_end_gcode(), every })
}

impl Core {
    /// A core for a printer of this profile.
    #[must_use]
    pub fn new(profile: &Profile) -> Self {
        let firmware = profile.firmware.clone();
        let config = Config {
            response: Duration::from_secs_f64(firmware.response_timeout_s),
            slow_command: Duration::from_secs_f64(firmware.slow_command_timeout_s),
            boot: Duration::from_secs_f64(firmware.boot_timeout_s),
            prelude: prelude_of(profile),
            postlude: postlude_of(profile),
            guard_end: profile.orphan_end_gcode().into_iter().collect(),
            safe: profile.safe_gcode(),
            guard: guard_of(profile),
            firmware,
        };
        let alone = Alone::new(config.firmware.dialect);
        Self {
            state: State::Disconnected,
            wire: Wire::new(&config.firmware),
            planner: Planner::new(u32::try_from(config.firmware.planner_moves).unwrap_or(u32::MAX)),
            config,
            urgent: VecDeque::new(),
            out: String::new(),
            events: VecDeque::new(),
            timers: Timers::default(),
            now: Instant::default(),
            heard: Instant::default(),
            quiet_since: Instant::default(),
            oldest: None,
            user_awaited: None,
            next_ok: NextOk::default(),
            refused: None,
            rewind: None,
            late: Late::default(),
            may_be_reset: false,
            probe: None,
            is_advanced: false,
            owed: Debts::default(),
            n_garbled: 0,
            alone,
            inquired_beyond: None,
            n_echoed: 0,
            pulse: Pulse::default(),
            guard: Guard::default(),
            prompts: Prompts::default(),
            securing: Securing::default(),
            stats: Stats::default(),
        }
    }

    /// What the core is doing.
    #[must_use]
    pub const fn state(&self) -> &State {
        &self.state
    }

    /// What happened so far, in numbers.
    #[must_use]
    pub const fn stats(&self) -> Stats {
        self.stats
    }

    /// How far the job is.
    #[must_use]
    pub fn progress(&self) -> Progress {
        Progress {
            n_lines_done: self.wire.acked_job_lines(),
            n_sent: self.wire.highest(),
            n_acked: self.wire.acked(),
            ahead: self.ahead(),
        }
    }

    /// What the firmware may have before it of the lines acknowledged.
    fn ahead(&self) -> Ahead {
        let firmware = &self.config.firmware;
        let acked = self.wire.acked();
        // Repetier says `ok` as it takes a line, before it begins with it.
        let is_late = firmware.dialect == Dialect::Repetier;
        let taken = if is_late { firmware.command_slots as u64 + 1 } else { 0 };
        let vouched = self.planner.pending(acked);
        // An `ok` without number may be that of a damaged line, and a number may be damaged: then it is not for the line that it is
        // taken for.
        let says_ok_to_noise = firmware.dialect == Dialect::Smoothie;
        let is_noisy = self.stats.are_of_a_noisy_wire() || self.is_advanced || says_ok_to_noise;
        let is_doubtful = firmware.line_numbers && vouched.is_none() && is_noisy;
        Ahead {
            n_lines: taken + if is_doubtful { recovery::FALSE_OKS } else { 0 },
            n_moves: vouched.unwrap_or(self.planner.places()),
            held: self.planner.held(acked),
        }
    }

    /// What a session sends before the lines of the job.
    #[must_use]
    pub fn prelude(&self) -> &[String] {
        &self.config.prelude
    }

    /// Whether the next line of the job may be given.
    #[must_use]
    pub fn wants_line(&self) -> bool {
        self.state == State::Streaming && self.wire.unsent() < QUEUE_AHEAD
    }

    /// Whether lines that were given are still to be sent.
    #[must_use]
    pub fn has_unsent(&self) -> bool {
        self.wire.unsent() > 0
    }

    /// Takes one line from the firmware, without its line end.
    pub fn handle_line(&mut self, now: Instant, line: &str) {
        self.now = now;
        let reply = parse(line);
        self.listen(&reply, line);
        match self.state {
            State::Disconnected => {}
            State::Faulted(_) | State::SwitchingOff => self.securing_reply(reply, line),
            State::Handshake(greeting) => self.greeting_reply(greeting, reply, line),
            State::Asking(inquiry) => self.inquiry_reply(inquiry, reply, line),
            _ => self.session_reply(reply, line),
        }
        self.settle();
    }

    /// Takes a command of the owner.
    ///
    /// # Errors
    /// The command does not fit the state; nothing has changed.
    pub fn handle_command(&mut self, now: Instant, command: Command<'_>) -> Result<(), Refused> {
        self.now = now;
        match (command, &self.state) {
            (Command::Connect, State::Disconnected) => self.connect(),
            (Command::Inquire { beyond }, State::Disconnected) => self.inquire(beyond),
            (Command::Ask(question), State::Idle) => self.put(question, 1),
            (Command::Begin, State::Idle) => self.begin(),
            (Command::GoOn, State::Idle) => {
                self.renew_guard();
                self.tell_whether_it_asks();
                self.state = State::Streaming;
            }
            (Command::Line(text), State::Streaming) => self.wire.push(text, Origin::Job),
            (Command::HostLine(text), State::Streaming | State::Parking) => {
                self.wire.push(text, Origin::Host);
            }
            (Command::EndOfJob, State::Streaming) => self.end_job(),
            // All lines may be given long before they are sent.
            (Command::Pause, State::Streaming | State::Finishing) => self.state = State::Pausing,
            (Command::Pause, state) if state.is_paused() => {}
            (Command::Park, State::Paused) => {
                self.park();
                // The lines to be sent are given next.
                return Ok(());
            }
            (Command::Resume, state) if state.is_paused() => self.go_on(),
            // It may wait for the user without having asked for a pause (M0).
            (Command::Resume, State::Streaming | State::Finishing) => self.continue_for_user(),
            // It may wait within a line of a host that is gone.
            (Command::Resume, State::Handshake(_) | State::Asking(_)) => self.continue_for_another(),
            (Command::Cancel, State::Cancelling) => {}
            (Command::Cancel, State::Idle | State::Handshake(_) | State::Asking(_)) => {
                self.state = State::Idle;
                self.timers.stop_all();
                self.events.push_back(Event::Cancelled);
            }
            (Command::Cancel, state) if state.has_job() => self.cancel(),
            (Command::Answer(button_idx), state) if state.has_job() => self.answer(button_idx),
            (Command::HeatersOff, State::Idle | State::Handshake(_) | State::Asking(_)) => self.secure(),
            (Command::HeatersOff, State::Disconnected) => self.secure(),
            (Command::EmergencyStop, state) if *state != State::Disconnected => self.stop_at_once(),
            _ => return Err(Refused { command: command.name(), state: self.state.name() }),
        }
        self.settle();
        Ok(())
    }

    /// Does what is due.
    pub fn handle_timeout(&mut self, now: Instant) {
        self.now = now;
        while let Some(timer) = self.timers.expired(now) {
            match timer {
                Timer::Response if self.decide_in_silence() => {}
                Timer::Response => self.ask(),
                Timer::Handshake => match self.state {
                    State::Asking(inquiry) => self.inquiry_timeout(inquiry),
                    _ => self.greeting_timeout(),
                },
                Timer::Silence => self.silent(now.since(self.heard_or_sent())),
                Timer::Command => self.command_timeout(),
                Timer::Pulse => self.feel_pulse(),
                Timer::Secure => self.secure_timeout(),
            }
        }
        self.settle();
    }

    /// The port is gone.
    pub fn handle_disconnect(&mut self, now: Instant) {
        self.now = now;
        if self.state.has_job() || matches!(self.state, State::Handshake(_) | State::Asking(_)) {
            self.fail(Fault::LinkLost);
        } else if matches!(self.state, State::Faulted(_) | State::SwitchingOff) {
            self.secure_lost();
        } else {
            self.state = State::Disconnected;
            self.timers.stop_all();
        }
        self.urgent.clear();
    }

    /// Bytes for the port, if there are any.
    pub fn poll_transmit(&mut self) -> Option<Line<'_>> {
        if !self.urgent.is_empty() {
            return self.urgent_line();
        }
        let streams = match self.state {
            State::Streaming | State::Finishing | State::Parking | State::Cancelling => true,
            // What was sent once is brought to its end.
            State::Pausing => self.wire.owes_lines(),
            _ => false,
        };
        let is_alone = self.rewind.is_some_and(|rewind| self.wire.next() > rewind.from);
        if !streams || self.probe.is_some() || is_alone {
            return None;
        }
        if !self.is_guard_out_of_the_way() {
            return self.urgent_line();
        }
        let was_idle = self.wire.in_flight() == 0;
        if was_idle {
            self.quiet_since = self.now;
        }
        self.wire.send_next()?;
        self.stats.n_lines_sent += 1;
        if was_idle {
            self.track_oldest();
            self.arm();
        }
        self.wire.last_sent().map(|text| Line { bytes: text.as_bytes() })
    }

    fn urgent_line(&mut self) -> Option<Line<'_>> {
        self.out = self.urgent.pop_front()?;
        Some(Line { bytes: self.out.as_bytes() })
    }

    /// Something to tell, if there is anything.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// When [`Self::handle_timeout`] is due.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.timers.next()
    }

    fn begin(&mut self) {
        self.state = State::Streaming;
        self.tell_whether_it_asks();
        if self.is_asked_where() {
            // Late answers to the greeting are awaited: none may be taken for a line's.
            self.probe = Some(Probe::new(false));
            self.quiet_since = self.now;
        }
        for line in &self.config.prelude {
            self.wire.push(line, Origin::Host);
        }
    }

    /// It is the firmware of this profile: what switches its heaters off is said in its own words, and what was set for another one is
    /// taken back.
    pub fn speaks(&mut self, profile: &Profile) {
        self.config.firmware.dialect = profile.firmware.dialect;
        self.config.safe = profile.safe_gcode();
        self.config.safe.extend(self.config.guard_end.iter().cloned());
    }

    /// The job leaves heaters on: the firmware's own time-out for them is not taken back at its end.
    pub fn leave_guarded(&mut self) {
        let taken_back = self.config.guard_end.clone();
        self.config.postlude.retain(|line| !taken_back.contains(line));
    }

    fn end_job(&mut self) {
        self.state = State::Finishing;
        for line in &self.config.postlude {
            self.wire.push(line, Origin::Host);
        }
        self.wire.end();
    }

    fn cancel(&mut self) {
        self.state = State::Cancelling;
        // Without a checksum, so twice: one may be lost.
        ["M108", "M410", "M108"].into_iter().for_each(|word| self.say_now(word));
        self.wire.let_lines_behind_heating();
        self.wire.drop_unsent();
        // The time-out that watched over the heaters would kill a firmware that is done, half an hour later.
        for line in self.config.safe.iter().chain(self.config.postlude.iter().skip(1)) {
            self.wire.push(line, Origin::Host);
        }
    }

    /// Noise is no sign of life.
    fn listen(&mut self, reply: &Reply<'_>, line: &str) {
        let is_noise = matches!(reply, Reply::Unknown(_))
            && line.contains(|c: char| c == char::REPLACEMENT_CHARACTER || c.is_control());
        if is_noise {
            self.n_garbled += 1;
        } else {
            self.heard = self.now;
            self.n_garbled = 0;
        }
        if matches!(reply, Reply::Ok(_)) {
            self.pulse.n_unanswered = 0;
            self.guard.n_unanswered = 0;
        }
    }

    fn session_reply(&mut self, reply: Reply<'_>, line: &str) {
        match reply {
            Reply::Ok(ok) => {
                match line.find("FIRMWARE_") {
                    // Klipper says it behind its `ok`.
                    Some(at) => self.events.push_back(Event::Firmware(line[at..].to_owned())),
                    None => self.stats.n_unknown_lines += u64::from(is_odd(line, &ok)),
                }
                self.on_ok(ok);
            }
            Reply::Resend(number) => self.on_resend(number.0),
            Reply::LineRefused { reason, last } => self.on_refusal(reason, last.0),
            Reply::Busy(what) => self.on_busy(what),
            Reply::Wait => {
                if self.wire.in_flight() > 0 {
                    self.ask();
                }
            }
            Reply::Temperatures(temperatures) => {
                self.events.push_back(Event::Temperatures(temperatures));
                self.on_temperatures();
            }
            Reply::Start => match policy::action(self.state.phase(), Trouble::Reset) {
                // Also between two questions of a survey.
                Action::Nothing => match self.inquired_beyond {
                    Some(beyond) => self.inquire(beyond),
                    None => self.greet(1),
                },
                _ => self.fail(Fault::FirmwareReset),
            },
            Reply::Halted(text) => self.fail(Fault::Halted { text: text.to_owned() }),
            Reply::UnknownCommand(text) => self.on_unknown_command(text, line),
            Reply::Action(action) => self.on_action(action),
            Reply::Skipped(_) => self.next_ok = NextOk::EndsRefusal,
            Reply::Error(text) => self.on_error(text, line),
            Reply::Position(place) if self.hear_place(place) => {}
            Reply::Firmware(told) => self.events.push_back(Event::Firmware(told.to_owned())),
            Reply::Capability => {}
            Reply::Position(_) | Reply::Unknown(_) => {
                self.stats.n_unknown_lines += 1;
                self.events.push_back(Event::Message(line.to_owned()));
            }
        }
    }

    /// Without numbers a command that is refused is lost: nothing asks for it again.
    fn on_error(&mut self, text: &str, line: &str) {
        self.events.push_back(Event::Message(line.to_owned()));
        // A machine that has lost its place makes no move; the rest of the job would be laid where it does not belong.
        let is_lost = text.contains("homed") || text.contains("home axis");
        let is_refusal = !self.config.firmware.counts_lines() && line.starts_with("!!");
        if (is_refusal || is_lost) && self.wire.in_flight() > 0 {
            self.fail(Fault::CommandRefused { text: text.to_owned() });
        }
    }

    /// Draws the conclusions from what has changed.
    fn settle(&mut self) {
        if self.rewind.is_some_and(|rewind| self.wire.acked() >= rewind.from) {
            self.rewind = None;
        }
        let is_drained = self.wire.in_flight() == 0 && self.probe.is_none();
        match self.state {
            State::Pausing if is_drained && !self.wire.owes_lines() => {
                self.paused();
                self.events.push_back(Event::Paused);
            }
            State::Parking if is_drained && self.wire.unsent() == 0 => self.paused(),
            State::Finishing | State::Cancelling if is_drained && self.wire.unsent() == 0 => self.ask(),
            _ => {}
        }
        self.follow_guard();
        self.track_oldest();
        self.hear_the_user();
        self.arm();
    }
}
