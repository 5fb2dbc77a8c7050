//! Standing by a print: what it tells, what is asked of it, the claim, the limits.

use super::outcome::{self, Begun, Cause, Facts, Heat, Manner, Outcome, Part};
use super::port::OTHER_PROGRAM;
use super::press::{Ended, Press};
use super::station::{Station, next_wish};
use super::{Held, Shown};
use crate::appliance::config::OnStop;
use crate::http::appliance::{Unheard, Wish, Wished};
use crate::http::wire::Activity;
use crate::printer::control::Control;
use crate::printer::driver::{PrintEvent, Printed};
use crate::printer::journal::Ending;
use crate::printer::protocol::{Event, Temperatures};
use crate::printer::{Error, PortProblem, paper};
use crate::queue::{Change, Name, Reason, Refusal};
use crate::store::{self, Store};
use std::path::Path;
use std::time::Duration;
use tokio::time::{Instant, sleep_until};

/// How long a warm printer waits for the queue to record that material is laid, and between two attempts.
const LAY_PATIENCE: Duration = Duration::from_secs(if cfg!(test) { 20 } else { 60 });
const LAY_AGAIN: Duration = Duration::from_secs(2);
/// A heater may be so much hotter than it is set to, °C.
const OVERSHOOT_C: f64 = 20.0;

/// A print under way, and what is known of it.
pub(super) struct Attended<'a, S> {
    pub(super) station: &'a mut Station<S>,
    pub(super) held: &'a mut Held,
    press: Press,
    begun: Begun,
    cause: Option<Cause>,
    /// Who has asked for the pause, or for going on.
    asked_by: Option<Name>,
    /// When laying is asked for again, and until when.
    lay: Option<[Instant; 2]>,
    longest: Instant,
    /// Where it pauses for a look.
    look_at: Option<u64>,
    is_parked: bool,
    /// The job's last word leaves heaters on.
    is_left_hot: bool,
    /// Somebody has stopped the printer at once.
    is_stopped: bool,
}

impl<'a, S: Store> Attended<'a, S> {
    pub(super) fn new(station: &'a mut Station<S>, held: &'a mut Held, press: Press, begun: Begun) -> Self {
        let longest = Instant::now() + station.config.limits.longest;
        let look_at = held.n_first_layer.filter(|_| station.config.first_layer_hold && !held.is_laid);
        let (cause, asked_by, lay) = (None, None, None);
        let [is_parked, is_left_hot, is_stopped] = [false; 3];
        Self {
            station,
            held,
            press,
            begun,
            cause,
            asked_by,
            lay,
            longest,
            look_at,
            is_parked,
            is_left_hot,
            is_stopped,
        }
    }

    /// Until it has ended; `None`: it is left as it is, paused, for the next server.
    pub(super) async fn outcome(mut self) -> Option<Outcome> {
        let mut stopping = self.station.kit.stopping.clone();
        let mut kept = std::pin::pin!(self.station.kit.clone().keep(self.held.claim.clone()));
        let mut is_kept = true;
        self.heed_stop();
        loop {
            let lay_at = self.lay.map_or(self.longest, |[at, _]| at);
            tokio::select! {
                event = self.press.events.recv() => match event {
                    Some(event) => self.hear(&event).await,
                    None => break,
                },
                Some(wished) = next_wish(&mut self.station.wishes) => self.heed(wished),
                () = &mut kept, if is_kept => {
                    is_kept = false;
                    self.stop(Cause::ClaimLost);
                }
                () = sleep_until(lay_at), if self.lay.is_some() => self.lay().await,
                () = sleep_until(self.longest), if self.cause.is_none() => {
                    let hours = self.station.config.limits.longest.as_secs_f64() / 3600.0;
                    self.stop(Cause::Limit(format!("it took longer than the {hours:.1} h that are allowed without anybody near")));
                }
                Ok(()) = stopping.changed() => self.heed_stop(),
            }
            if self.is_parked {
                self.press.leave().await;
                return None;
            }
        }
        let facts = match self.press.end().await {
            Ended::With(result) => self.facts(&result),
            Ended::Panicked => {
                let said = "its thread has ended: this is a fault of lumenfab".to_owned();
                self.facts_of(Manner::Failed, said, Heat::Unknown)
            }
        };
        Some(outcome::outcome(facts))
    }

    fn facts(&mut self, result: &Result<Printed, Error>) -> Facts {
        match result {
            Ok(_) => {
                let heat = if self.is_left_hot { Heat::Unknown } else { Heat::Off };
                self.facts_of(Manner::Finished, String::new(), heat)
            }
            Err(error) => {
                if let Error::NeedsConsent { .. } = error {
                    self.held.needs_consent = true;
                }
                if let Error::Open { problem: PortProblem::Busy(_), .. } = error {
                    self.station.doubt(OTHER_PROGRAM);
                }
                let said = self.station.without_paths(error, &self.held.gcode);
                tracing::warn!(printer = %self.station.name(), job = %self.held.claim.job, code = error.code(), "print: {said}");
                if self.is_stopped {
                    self.station.stopped = Some(said.clone());
                }
                self.facts_of(Manner::of(error), said, Heat::of(error))
            }
        }
    }

    fn facts_of(&mut self, manner: Manner, said: String, heat: Heat) -> Facts {
        let is_simulated = self.station.machine.is_simulated();
        let part = match self.held.is_laid {
            false => Part::Nothing,
            true if !is_simulated && journal_of(&self.held.gcode) == Told::BrokeOff => Part::Unfinished,
            true => Part::Dead,
        };
        Facts { manner, said, cause: self.cause.take(), part, begun: self.begun, heat }
    }

    async fn hear(&mut self, event: &PrintEvent) {
        let now = self.station.kit.now();
        self.station.board.hear(event, now);
        match event {
            PrintEvent::AsksToLay => {
                let now = Instant::now();
                self.lay = Some([now, now + LAY_PATIENCE]);
                self.lay().await;
            }
            PrintEvent::Progress { n_lines_done, .. }
                if self.look_at.is_some_and(|at| *n_lines_done >= at) =>
            {
                self.look_at = None;
                self.press.controls.ask(Control::Pause);
                let says = "the first layer is done: look at it, then let the print go on";
                self.station.tell("first-layer", Some(self.held.claim.job), says);
                self.station.board.set(Activity::Pausing, Some(says.to_owned()));
            }
            PrintEvent::Session(Event::Temperatures(told)) => {
                self.station.own_heaters();
                self.check_heat(*told);
            }
            PrintEvent::Session(Event::Paused) => self.paused().await,
            PrintEvent::Session(Event::Resumed) | PrintEvent::WentOn { .. } | PrintEvent::Progress { .. }
                if self.held.is_paused =>
            {
                self.held.is_paused = false;
                self.record(Change::GoOn).await;
            }
            PrintEvent::LeftHot { .. } => self.is_left_hot = true,
            PrintEvent::PortLost { .. } => {
                self.station.tell(
                    "port-lost",
                    Some(self.held.claim.job),
                    "the port vanished in the middle of the print",
                );
            }
            _ => {}
        }
    }

    /// The printer has stopped before the first material: it goes on once the queue has recorded that some is laid.
    async fn lay(&mut self) {
        let Some([_, until]) = self.lay else { return };
        let error = match self.station.kit.change(&self.held.claim, Change::Lay, None, "").await {
            // Recorded before, and the answer was lost.
            Ok(_) | Err(store::Error::Refused(Refusal::MaterialLaid)) => {
                (self.lay, self.held.is_laid) = (None, true);
                self.press.controls.let_lay();
                return;
            }
            Err(error) => error,
        };
        tracing::warn!(printer = %self.station.name(), job = %self.held.claim.job, "print: nothing is laid yet: {error}");
        match error {
            store::Error::Refused(Refusal::ClaimLost) => self.stop(Cause::ClaimLost),
            store::Error::Refused(refusal) => self.stop(Cause::NotLet(refusal.to_string())),
            _ if Instant::now() >= until => {
                self.stop(Cause::NotLet("the queue could not record that material is laid".to_owned()));
            }
            _ => self.lay = Some([Instant::now() + LAY_AGAIN, until]),
        }
    }

    async fn paused(&mut self) {
        if !std::mem::replace(&mut self.held.is_paused, true) {
            self.record(Change::Pause).await;
        }
        if matches!(self.station.kit.stopping(), Some(OnStop::Park)) && self.cause.is_none() {
            self.is_parked = self.held.is_laid;
        }
    }

    /// What the printer does is recorded; where that fails, it is so all the same.
    async fn record(&mut self, change: Change) {
        let by = self.asked_by.take();
        let shown = if self.held.is_paused { Shown::Paused } else { Shown::Printing };
        self.held.shown = match self.station.kit.change(&self.held.claim, change, by.as_ref(), "").await {
            Ok(_) => shown,
            Err(error) => {
                tracing::warn!(printer = %self.station.name(), job = %self.held.claim.job, "print: {error}");
                Shown::Unknown
            }
        };
    }

    fn check_heat(&mut self, told: Temperatures) {
        let limits = self.station.config.limits;
        for (heater, most_c, words) in
            [(told.hotend, limits.hotend_c, "nozzle"), (told.bed, limits.bed_c, "bed")]
        {
            let Some(heater) = heater else { continue };
            if heater.actual_c > most_c + OVERSHOOT_C {
                self.stop(Cause::Limit(format!(
                    "the {words} is at {:.0} °C, above the {most_c:.0} °C that are allowed",
                    heater.actual_c
                )));
                self.press.controls.ask(Control::EmergencyStop);
            } else if heater.target_c > most_c {
                self.stop(Cause::Limit(format!(
                    "the {words} is set to {:.0} °C, above the {most_c:.0} °C that are allowed",
                    heater.target_c
                )));
            }
        }
    }

    /// Asks the print to end; the first cause counts.
    fn stop(&mut self, cause: Cause) {
        if self.cause.is_none() {
            tracing::warn!(printer = %self.station.name(), job = %self.held.claim.job, cause = cause.word(), "print: is stopped");
            self.cause = Some(cause);
            self.lay = None;
            self.station.board.set(Activity::Cancelling, None);
        }
        self.press.stop();
    }

    fn heed(&mut self, wished: Wished) {
        let answer = if wished.job.is_some_and(|job| job != self.held.claim.job) {
            Err(Unheard::NotNow("the printer has another job by now".to_owned()))
        } else {
            self.obey(wished.wish, wished.by, wished.why)
        };
        // Whoever asked may have left.
        wished.answer.send(answer).ok();
    }

    fn obey(&mut self, wish: Wish, by: Name, why: Reason) -> Result<(), Unheard> {
        let not_now = |text: &str| Err(Unheard::NotNow(text.to_owned()));
        if self.cause.is_some() && wish != Wish::EmergencyStop {
            return not_now("the print is being given up");
        }
        match wish {
            Wish::Pause => {
                self.asked_by = Some(by);
                self.station.board.set(Activity::Pausing, None);
                self.press.controls.ask(Control::Pause);
                Ok(())
            }
            Wish::GoOn => {
                self.asked_by = Some(by);
                self.press.controls.ask(Control::GoOn);
                Ok(())
            }
            Wish::Cancel => {
                self.stop(Cause::Asked { by, why });
                Ok(())
            }
            Wish::EmergencyStop => {
                // Not given up first: that would wait for what is under way.
                self.cause.get_or_insert(Cause::Asked { by, why });
                (self.lay, self.is_stopped) = (None, true);
                self.station.board.set(Activity::Cancelling, None);
                self.press.controls.ask(Control::EmergencyStop);
                Ok(())
            }
            Wish::Connect => Ok(()),
            Wish::Disconnect => not_now("it is printing: cancel the print first"),
            Wish::Commands(_) => not_now("it is printing: commands would come between the lines of the job"),
        }
    }

    /// A print of which nothing is laid yet is given back; another one is finished, paused or given up as the operator decides.
    fn heed_stop(&mut self) {
        match self.station.kit.stopping() {
            None => {}
            Some(_) if !self.held.is_laid => self.stop(Cause::Stopping),
            Some(OnStop::Finish) => {}
            Some(OnStop::Park) if self.station.board.activity() == Activity::Paused => self.is_parked = true,
            Some(OnStop::Park) => self.press.controls.ask(Control::Pause),
            Some(OnStop::Cancel) => self.stop(Cause::Stopping),
        }
    }
}

/// What the journal of a job's print tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Told {
    /// The printer has said that all is done.
    Finished,
    /// It broke off, and may be gone on with.
    BrokeOff,
    /// It was given up, or had not begun, or nothing is known.
    Nothing,
}

/// Asks the journal of a job of which material was laid: it is that of this print, for it was begun before.
pub(super) fn journal_of(gcode: &Path) -> Told {
    match paper::log_of(gcode) {
        Ok(log) if log.end == Some(Ending::Finished) => Told::Finished,
        Ok(log) if log.end != Some(Ending::Cancelled) && log.progress.n_sent > 0 => Told::BrokeOff,
        _ => Told::Nothing,
    }
}
