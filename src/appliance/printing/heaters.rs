//! Heaters that nobody owns.

use super::attend::{Told, journal_of};
use super::station::Station;
use crate::http::wire::Activity;
use crate::printer::ask;
use crate::queue::{Bed, Job};
use crate::store::{self, Store};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// A printer that has not said that its heaters are off is asked again after so long, or after so many times what asking took: nobody
/// is heard meanwhile.
const AGAIN: Duration = Duration::from_secs(5);
const LONGER: u32 = 3;

/// Heaters that could not be switched off.
#[derive(Debug, Clone)]
pub(super) struct Owed {
    /// What is known of them, and what to do.
    says: String,
    /// When it is tried again.
    again: Instant,
}

impl<S: Store> Station<S> {
    /// Switches heaters off that nobody owns; where the printer does not say that they are, it is owed, and no job is taken meanwhile.
    pub(super) async fn switch_off(&mut self) {
        (self.hot_until, self.port) = (None, None);
        if self.machine.is_simulated() {
            return;
        }
        let began = Instant::now();
        match self.off().await {
            Ok(()) => {
                self.machine.tell_heat(None).await;
                tracing::info!(printer = %self.name(), "heaters are off");
                if self.memory.owes_off.take().is_some() {
                    self.tell("heaters-off", None, "the printer says that its heaters are off");
                }
            }
            Err(said) => self.owe_off(&said, began.elapsed()),
        }
    }

    async fn off(&self) -> Result<(), String> {
        if !self.machine.is_there() {
            return Err("there is nothing at its port".to_owned());
        }
        let _turn = Arc::clone(&self.machine.turn).lock_owned().await;
        let off = async { ask::safe_off(self.machine.open().await?, &self.machine.profile).await };
        off.await.map(drop).map_err(|error| self.without_paths(&error, Path::new("job")))
    }

    /// They may be on, and nobody can say more: it is tried again after a while.
    pub(super) fn owe_off(&mut self, said: &str, took: Duration) {
        let says = format!(
            "its heaters could not be switched off, and may be on ({said}): it is tried again; if nobody is to wait for that, switch the \
             printer off"
        );
        // Told once, and again where something else is in the way.
        if self.heaters_unknown() != Some(says.as_str()) {
            tracing::error!(printer = %self.name(), "heaters: {said}");
            self.tell("heaters-unknown", None, &says);
            let activity = match self.board.activity() {
                Activity::Idle | Activity::Offline => Activity::Faulted,
                busy => busy,
            };
            self.board.set(activity, Some(says.clone()));
        }
        self.memory.owes_off = Some(Owed { says, again: Instant::now() + AGAIN.max(LONGER * took) });
    }

    /// What is said of heaters that are owed.
    pub(super) fn heaters_unknown(&self) -> Option<&str> {
        self.memory.owes_off.as_ref().map(|owed| owed.says.as_str())
    }

    /// The same before other words.
    pub(super) fn with_heaters(&self, says: &str) -> String {
        self.heaters_unknown().map_or_else(|| says.to_owned(), |heaters| format!("{heaters}; {says}"))
    }

    /// Tries once more what is owed, where there is anything at the port.
    ///
    /// # Errors
    /// What is said of them, where they may still be on.
    pub(super) async fn pay_off(&mut self) -> Result<(), String> {
        let is_due = self.memory.owes_off.as_ref().is_some_and(|owed| Instant::now() >= owed.again);
        if is_due && !self.is_taken_off && self.machine.is_there() {
            self.switch_off().await;
        }
        self.heaters_unknown().map_or(Ok(()), |says| Err(says.to_owned()))
    }

    /// Somebody speaks to the printer: the heaters are its.
    pub(super) fn own_heaters(&mut self) {
        self.memory.owes_off = None;
    }

    /// What the printer has in hand, or had when a server died.
    pub(in crate::appliance) async fn in_hand(&self) -> Result<Option<Job>, store::Error> {
        let Some(Bed::Taken(job)) = self.find().await?.map(|printer| printer.bed) else { return Ok(None) };
        let (found, _) = self.kit.store.job(job).await?;
        Ok(Some(found).filter(|job| job.state.is_at_printer() && job.is_on(self.name())))
    }

    /// Sees to the heaters of what a server had in hand that died, before anything is written: what can be gone on with stays warm for
    /// as long as its profile says.
    pub(super) async fn secure(&mut self) -> Result<(), store::Error> {
        let Some(job) = self.in_hand().await? else {
            // Somebody's commands have left them on.
            if self.machine.may_be_hot() {
                self.switch_off().await;
            }
            return Ok(());
        };
        let gcode = self.kit.layout.gcode(job.id);
        match self.told(job.is_laid, &gcode) {
            Told::Finished => {}
            Told::BrokeOff => self.hot_until = Some(Instant::now() + self.hold_left(&gcode)),
            Told::Nothing => self.switch_off().await,
        }
        Ok(())
    }

    /// What the journal tells of a print that a server left.
    pub(super) fn told(&self, is_laid: bool, gcode: &Path) -> Told {
        // Before anything is laid the journal may be that of an earlier print.
        if !is_laid || self.machine.is_simulated() { Told::Nothing } else { journal_of(gcode) }
    }
}
