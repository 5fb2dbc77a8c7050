//! Lines that somebody asks for at a printer that is not printing.

use super::outcome::Heat;
use super::press::{Ended, Press, Work};
use super::station::{Station, not_now};
use crate::appliance::heat::Hot;
use crate::http::appliance::Unheard;
use crate::http::wire::Activity;
use crate::printer::driver::PrintEvent;
use crate::printer::laying::may_lay;
use crate::queue::Said;
use crate::store::Store;
use std::path::Path;
use tokio::time::Instant;

impl<S: Store> Station<S> {
    pub(super) async fn check_commands(&self, lines: &[String]) -> Result<(), Unheard> {
        if self.machine.is_simulated() {
            return Err(not_now("the simulated printer lives as long as its print"));
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
        while let Some(event) = press.events.recv().await {
            self.board.hear(&event, self.kit.now());
            if let PrintEvent::LeftHot { .. } = event {
                self.hot_until = Some(Instant::now() + self.hold());
            }
        }
        if let Ended::With(result) = press.end().await
            && let Err(error) = *result
        {
            let said = self.without_paths(&error, Path::new("commands"));
            tracing::warn!(printer = %self.name(), "commands: {said}");
            self.board.set(Activity::Idle, Some(said));
            if Heat::of(&error) == Heat::Unknown {
                self.hot_until = Some(Instant::now());
            }
        }
        if self.hot_until.is_none() {
            self.machine.tell_heat(None).await;
        }
        self.mark_watched();
        // Where it cannot be had, the next look tells.
        self.hold_port().await.ok();
    }
}
