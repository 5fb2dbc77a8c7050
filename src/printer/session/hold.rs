//! What the operator asks for while a print runs: pauses, going on, stopping.
//!
//! In a pause the nozzle waits away from the part, where the profile says how (`scripts.pause`). The lines that bring it there, and back
//! (`scripts.resume`, then the modes, the filament's place and the speed of the job), are a track of their own in the journal, behind
//! the last line of the job that the printer has taken: so a pause, too, can be gone on with after a cable was pulled or the host
//! died. That it goes on is in the journal before the first line back is sent: until then the nozzle certainly waits where it is.
//! The job's lines that were given to the core and never sent are read again when it goes on.

use super::super::control::Control;
use super::super::job;
use super::super::journal::recorder::Recorder;
use super::super::journal::{Place, Record, Track};
use super::super::policy::{self, Action, Phase, Trouble};
use super::super::protocol::{Command, Core, Fault, Heater, Instant, State, Temperatures};
use super::super::replay::{Modal, Tail};
use super::super::resume::warming;
use super::{End, PrintEvent, Session, Stage};
use crate::profile::ResumePoint;
use std::io::{BufRead, Seek};

/// How far above the part the nozzle waits, mm.
const CLEARANCE_MM: f64 = 10.0;

impl<R: BufRead + Seek> Session<R> {
    /// The operator asks for something. What has no meaning now is passed over, and said to be.
    pub fn control(&mut self, now: Instant, control: Control) {
        if !self.has_meaning(control) {
            self.events.push_back(self.why_nothing(control));
            return;
        }
        self.events.push_back(PrintEvent::Asked(control));
        match control {
            Control::Pause => self.pause(now, true),
            Control::GoOn => self.pause(now, false),
            Control::Stop => self.cancel(now),
            Control::EmergencyStop => self.stop_at_once(now),
            Control::Answer(button_idx) => {
                self.now = now;
                self.command(Command::Answer(button_idx));
                self.settle();
            }
        }
    }

    /// Whether it would change anything.
    fn has_meaning(&self, control: Control) -> bool {
        let is_paused = self.is_held || self.core.state().is_paused();
        match control {
            Control::Pause | Control::GoOn | Control::Answer(_) if self.phase() == Phase::Stopping => false,
            Control::Pause => !is_paused,
            Control::GoOn => is_paused || self.core.is_user_awaited(),
            Control::Answer(button_idx) => self.core.is_asking(button_idx),
            Control::Stop => !matches!(self.phase(), Phase::Stopping),
            Control::EmergencyStop => true,
        }
    }

    fn why_nothing(&self, control: Control) -> PrintEvent {
        match (control, self.core.state()) {
            _ if self.phase() == Phase::Stopping => PrintEvent::NothingToDo(Control::Stop),
            (Control::Pause, State::Pausing | State::Parking) => PrintEvent::StillPausing,
            _ => PrintEvent::NothingToDo(control),
        }
    }

    /// The operator asks to stop.
    pub fn cancel(&mut self, now: Instant) {
        self.now = now;
        match policy::action(self.phase(), Trouble::StopRequested) {
            Action::Stop if matches!(self.stage, Stage::Printing) => self.command(Command::Cancel),
            Action::Stop => self.switch_off(End::Cancelled),
            Action::Leave => {
                // What it was about to be asked stays unasked.
                self.core = Core::new(&self.profile);
                self.over(End::Left);
            }
            Action::GiveUpUnknown => self.over(End::Faulted(Fault::LinkLost)),
            _ => {}
        }
        self.settle();
    }

    /// The operator asks to pause, or to go on; while the port is away, for when it is back.
    pub fn pause(&mut self, now: Instant, pauses: bool) {
        self.now = now;
        self.is_held = pauses;
        self.command(if pauses { Command::Pause } else { Command::Resume });
        self.settle();
    }

    /// The operator wants it to stop at once.
    fn stop_at_once(&mut self, now: Instant) {
        self.now = now;
        match policy::action(self.phase(), Trouble::EmergencyStop) {
            Action::StopAtOnce if !matches!(self.stage, Stage::Over) => self.command(Command::EmergencyStop),
            Action::GiveUpUnknown => self.over(End::Faulted(Fault::LinkLost)),
            _ => {}
        }
        self.settle();
    }

    /// Nothing more is on its way, or the printer waits for the user within a line.
    pub(super) fn paused(&mut self) {
        if *self.core.state() != State::Paused || !matches!(self.stage, Stage::Printing) {
            return;
        }
        self.is_held = true;
        if self.parks_itself || self.profile.scripts.pause.is_empty() {
            return;
        }
        if let Err(error) = self.park() {
            self.job_error = Some(error);
            self.command(Command::Cancel);
        }
    }

    /// Sends the nozzle away from the part. In the middle of the host's own lines, before anything is printed and after the end it
    /// stays where it is.
    fn park(&mut self) -> Result<(), job::Error> {
        let n_acked = self.core.progress().n_acked;
        let Some(Place::Job(n_done)) = self.recorder.track().place(n_acked) else { return Ok(()) };
        let n_given = self.job.n_given();
        if n_done >= self.job.n_lines() {
            return Ok(());
        }
        let mut modal = Modal::new(self.profile.firmware.dialect);
        let mut tail = Tail::default();
        self.job.replay(n_done, |command| tail.push(modal.apply(command)))?;
        let Some(at) = place_of(&modal) else { return self.wind_to(n_given) };
        let away = self.away_gcode(&at);
        let mut back: Vec<_> = self.profile.orphan_gcode().into_iter().collect();
        back.extend(self.profile.resume_gcode(&at));
        back.extend(self.profile.motors_gcode());
        back.extend(modes_of(&modal));
        let (first_number, n_twice) = (n_acked + 1, self.n_twice);
        let track =
            Track { first_number, prelude: away.clone(), n_before: n_done, n_twice, back: back.clone() };
        self.write_first(Record::Session(track.clone()));
        self.recorder = Recorder::new(track, modal, tail, self.now);
        self.recorder.hear(self.temperatures);
        self.command(Command::Park);
        away.iter().for_each(|line| self.command(Command::HostLine(line)));
        self.parked = Some(back);
        Ok(())
    }

    /// The script, with the motors on for as long as it takes, and then lines of which the first ends only when the nozzle is
    /// there, and as many more as may be acknowledged before they are executed: then it certainly is, whatever happens in the pause.
    fn away_gcode(&self, at: &ResumePoint) -> Vec<String> {
        let n_doubtful = usize::try_from(self.core.progress().ahead.n_lines).unwrap_or(0);
        let waits = std::iter::repeat_n("M400".to_owned(), 1 + n_doubtful);
        let motors = self.profile.motors_pause_gcode();
        self.profile.pause_gcode(at).into_iter().chain(motors).chain(waits).collect()
    }

    /// Back to the part first; and before that, warm again, where the printer's own time-out has switched its heaters off.
    pub(super) fn resumed(&mut self) {
        self.is_held = false;
        let Some(back) = self.parked.take() else { return };
        let back: Vec<_> = self.warming().into_iter().chain(back).collect();
        let track = Track { back: back.clone(), ..self.recorder.track().clone() }.gone_on();
        self.write_first(Record::Session(track.clone()));
        self.recorder.follow(track, self.now);
        back.iter().for_each(|line| self.command(Command::HostLine(line)));
    }

    /// What heats nozzle and bed again, where one of them is off that the job wants warm.
    fn warming(&self) -> Vec<String> {
        let modal = self.recorder.modal();
        let is_off = |wanted_c: Option<f64>, heater: Option<Heater>| {
            wanted_c.is_some_and(|c| c > 0.0) && heater.is_some_and(|heater| heater.target_c <= 0.0)
        };
        let Temperatures { hotend, bed } = self.temperatures;
        let is_cold = is_off(modal.hotend_c, hotend) || is_off(modal.bed_c, bed);
        if is_cold { warming(modal) } else { Vec::new() }
    }
}

/// Whether a printer that tells of a pause, or of its end, moves by itself in it; other words say nothing about that.
pub(super) fn parks_itself(action: &str) -> Option<bool> {
    match action.split_ascii_whitespace().next().unwrap_or_default() {
        "paused" => Some(true),
        "pause" | "resume" | "resumed" | "cancel" => Some(false),
        _ => None,
    }
}

/// Where a print stands, if it is known and something is printed already.
fn place_of(modal: &Modal) -> Option<ResumePoint> {
    let [Some(x_mm), Some(y_mm), Some(z_mm), Some(_)] = modal.at_mm else { return None };
    let hotend_c = modal.hotend_c.filter(|c| *c > 0.0)?;
    let clear_z_mm = modal.top_mm?.max(z_mm) + CLEARANCE_MM;
    let xyz_mm = [x_mm, y_mm, z_mm];
    Some(ResumePoint { xyz_mm, nozzle_z_mm: z_mm, clear_z_mm, hotend_c, bed_c: modal.bed_c.unwrap_or(0.0) })
}

/// What the scripts of a pause may have changed, as the job left it.
fn modes_of(modal: &Modal) -> Vec<String> {
    let rounded = |value: f64| (value * 1e5).round() / 1e5;
    let mut lines = vec![if modal.absolute_xyz { "G90" } else { "G91" }.to_owned()];
    lines.push(if modal.absolute_e { "M82" } else { "M83" }.to_owned());
    lines.extend(modal.at_mm[3].map(|e_mm| format!("G92 E{}", rounded(e_mm))));
    lines.extend(modal.feedrate_mm_min.map(|feedrate| format!("G1 F{}", rounded(feedrate))));
    lines
}
