//! Emergency stop where no print is under way.

use super::station::{Station, not_now};
use crate::http::appliance::Unheard;
use crate::http::wire::Activity;
use crate::printer::ask;
use crate::printer::protocol::Heat;
use crate::store::Store;
use std::path::Path;
use std::sync::Arc;
use tokio::sync::oneshot;
use tokio::time::Instant;
use tokio_serial::SerialStream;

/// Until the printer has said something.
const NO_WORD: &str = "emergency stop: no word from the printer yet";
/// What is to be done after it.
const RESET: &str = "look at the printer, reset it, then connect it again";

impl<S: Store> Station<S> {
    /// Stops whatever the printer does (M112), by the port that is held; answered once that is open. Whether it was sent.
    pub(super) async fn stop_at_once(&mut self, answer: oneshot::Sender<Result<(), Unheard>>) -> bool {
        let opened = self.port_for_stop().await;
        let is_open = opened.is_ok();
        if is_open {
            // Seen before the answer is: nobody takes what was shown before for the end of it.
            self.board.set(Activity::Cancelling, Some(NO_WORD.to_owned()));
        }
        // Whoever has left wants it all the same.
        match opened {
            Ok(port) => {
                answer.send(Ok(())).ok();
                self.stop_by(port).await;
            }
            Err(why) => {
                answer.send(Err(not_now(&format!("{why}: use the printer's own switch")))).ok();
            }
        }
        is_open
    }

    /// Somebody has asked for it while lines were under way, which ended meanwhile.
    pub(super) async fn stop_after_all(&mut self) {
        match self.port_for_stop().await {
            Ok(port) => self.stop_by(port).await,
            Err(why) => {
                self.halt(&format!("emergency stop was not sent: {why}: use the printer's own switch"))
            }
        }
    }

    /// Lines are under way: the driver stops the printer.
    pub(super) fn shows_stop(&mut self) {
        self.board.set(Activity::Cancelling, Some(NO_WORD.to_owned()));
    }

    async fn port_for_stop(&mut self) -> Result<SerialStream, String> {
        if self.machine.is_simulated() {
            return Err("the simulated printer lives as long as its print".to_owned());
        }
        if !self.is_taken_off {
            self.hold_port().await?;
        }
        match self.port.take() {
            Some(port) => Ok(port),
            None => self.machine.stream().await.map_err(|error| self.without_paths(&error, Path::new("job"))),
        }
    }

    async fn stop_by(&mut self, mut port: SerialStream) {
        tracing::warn!(printer = %self.name(), "emergency stop");
        let turn = Arc::clone(&self.machine.turn).lock_owned().await;
        let began = Instant::now();
        let heat = ask::stop_at_once(&mut port, &self.machine.port_name(), &self.machine.profile).await;
        drop(turn);
        match heat {
            Ok(heat) => {
                self.port = Some(port).filter(|_| !self.is_taken_off);
                self.has_stopped(&heat, began).await;
            }
            Err(error) => {
                let said = self.without_paths(&error, Path::new("job"));
                self.owe_off(&said, began.elapsed());
                self.halt(&format!("emergency stop: {said}: use the printer's own switch"));
            }
        }
        self.mark_watched();
    }

    /// What the printer has said to it, and what follows from that.
    pub(super) async fn has_stopped(&mut self, heat: &Heat, began: Instant) {
        self.hot_until = None;
        if heat.is_safe() {
            self.own_heaters();
            self.machine.tell_heat(None).await;
        } else {
            self.owe_off(&heat.to_string(), began.elapsed());
        }
        let says = match heat {
            Heat::Halted => format!("emergency stop: the printer says that it has stopped: {RESET}"),
            heat if heat.is_safe() => format!("emergency stop: {heat}: {RESET}"),
            heat => format!(
                "emergency stop was sent, and the printer does not say that it has stopped ({heat}): use its own switch"
            ),
        };
        self.halt(&says);
    }

    /// It takes no job until somebody connects it.
    pub(super) fn halt(&mut self, why: &str) {
        self.tell("emergency-stop", None, why);
        self.board.set(Activity::Faulted, Some(self.with_heaters(why)));
        self.halted = Some(why.to_owned());
    }
}
