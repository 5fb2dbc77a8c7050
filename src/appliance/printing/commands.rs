//! Lines that somebody asks for at a printer that is not printing.

use super::outcome::Heat;
use super::press::{Ended, Press, Work};
use super::station::{Station, next_wish, not_now};
use crate::appliance::heat::Hot;
use crate::appliance::survey::Survey;
use crate::http::appliance::{Unheard, Wish};
use crate::http::wire::Activity;
use crate::printer::Error;
use crate::printer::control::Control;
use crate::printer::driver::{PrintEvent, Printed};
use crate::printer::laying::may_lay;
use crate::printer::protocol::Fault;
use crate::queue::Said;
use crate::store::Store;
use std::path::Path;
use tokio::time::Instant;

impl<S: Store> Station<S> {
    pub(super) async fn check_commands(&self, lines: &[String]) -> Result<(), Unheard> {
        if self.machine.is_simulated() {
            return Err(not_now("the simulated printer lives as long as its print"));
        }
        let survey = Survey::of(lines.join("\n").as_bytes()).map_err(|e| not_now(&e.to_string()))?;
        if let Some(why) = self.config.limits.refuse_heat(survey.hotend_c, survey.bed_c) {
            return Err(not_now(&format!("{why} (max_hotend_c and max_bed_c in config.toml)")));
        }
        if lines.iter().any(|line| may_lay(line)) {
            self.say(Said::BedInDoubt, "commands that may lay material")
                .await
                .map_err(|e| not_now(&e.to_string()))?;
        }
        Ok(())
    }

    /// Does them; heat that they leave on has a deadline.
    pub(super) async fn command(&mut self, lines: Vec<String>) {
        self.port = None;
        self.machine.tell_heat(Some(Hot::COMMANDS)).await;
        let mut press = match Press::start(&self.machine, Work::Commands(lines.join("\n")), false).await {
            Ok(press) => press,
            Err(error) => return tracing::error!(printer = %self.name(), "commands: {error}"),
        };
        let stopping = self.attend_commands(&mut press).await;
        let end = press.end().await;
        match (end, stopping) {
            (Ended::With(result), began) => self.commands_ended(*result, began).await,
            (Ended::Panicked, Some(_)) => self.stop_after_all().await,
            (Ended::Panicked, None) => self.hot_until = Some(Instant::now()),
        }
        if self.hot_until.is_none() && self.heaters_unknown().is_none() {
            self.machine.tell_heat(None).await;
        }
        self.mark_watched();
        // Where it cannot be had, the next look tells.
        self.hold_port().await.ok();
    }

    /// Until they have ended; since when an emergency stop is asked for.
    async fn attend_commands(&mut self, press: &mut Press) -> Option<Instant> {
        let mut stopping = None;
        loop {
            tokio::select! {
                event = press.events.recv() => match event {
                    Some(event) => self.hear_commands(&event),
                    None => return stopping,
                },
                Some(wished) = next_wish(&mut self.wishes) => if wished.wish == Wish::EmergencyStop && wished.job.is_none() {
                    stopping.get_or_insert_with(Instant::now);
                    self.shows_stop();
                    press.controls.ask(Control::EmergencyStop);
                    wished.answer.send(Ok(())).ok();
                } else {
                    self.later.push_back(wished);
                },
            }
        }
    }

    fn hear_commands(&mut self, event: &PrintEvent) {
        self.board.hear(event, self.kit.now());
        if let PrintEvent::LeftHot { .. } = event {
            self.hot_until = Some(Instant::now() + self.hold());
        }
    }

    async fn commands_ended(&mut self, result: Result<Printed, Error>, stopping: Option<Instant>) {
        match (result, stopping) {
            (Err(Error::Fault { fault: Fault::EmergencyStop, heat, .. }), began) => {
                self.has_stopped(&heat, began.unwrap_or_else(Instant::now)).await;
            }
            // They ended before it was heard.
            (_, Some(_)) => self.stop_after_all().await,
            (Ok(_), None) => {}
            (Err(error), None) => self.commands_failed(&error),
        }
    }

    fn commands_failed(&mut self, error: &Error) {
        let said = self.without_paths(error, Path::new("commands"));
        tracing::warn!(printer = %self.name(), "commands: {said}");
        self.board.set(Activity::Idle, Some(said));
        if Heat::of(error) == Heat::Unknown {
            self.hot_until = Some(Instant::now());
        }
    }
}
