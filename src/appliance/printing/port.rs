//! The port of a printer while nobody speaks to it, and what becomes of the bed where somebody else might.

use super::station::Station;
use crate::http::wire::Activity;
use crate::printer::{Error, PortProblem};
use crate::queue::{Bed, Said};
use crate::store::{self, Store};
use std::io;
use std::path::Path;
use std::time::Duration;
use tokio_serial::SerialStream;

/// A server that looked so long ago is one that had something else to do.
const HICCUP: Duration = Duration::from_secs(10);
/// Why a bed is in doubt.
pub(super) const OTHER_PROGRAM: &str = "another program had its port";
pub(super) const TAKEN_OFF: &str = "it was taken off by an operator";
const OTHER_MACHINE: &str = "another machine was here when its bed was known last";
const UNWATCHED: &str = "nobody has watched it for a while";
const NO_SERVER: &str = "no server has watched it for a while";
const NOTHING_THERE: &str = "there is nothing at its port";

/// Why nothing can start on a printer.
pub(super) type Trouble = (Activity, String);

impl<S: Store> Station<S> {
    /// Sees to heaters that are owed, keeps the port from other programs, and doubts a bed that nobody has watched.
    ///
    /// # Errors
    /// Why nothing can start.
    pub(super) async fn look_after(&mut self) -> Result<(), Trouble> {
        if self.machine.is_simulated() {
            return Ok(());
        }
        let off = self.pay_off().await;
        let held = self.hold_port().await;
        self.watch(held.is_ok()).await;
        let trusted = self.settle_doubt().await;
        off.map_err(|says| (Activity::Faulted, says))?;
        held.map_err(|says| (Activity::Offline, says))?;
        trusted.map_err(|error| {
            (Activity::Faulted, format!("its bed is in doubt, and that cannot be recorded: {}", error.code()))
        })
    }

    /// Keeps the port from other programs. One that has it may lay something: the bed is not known any more.
    pub(super) async fn hold_port(&mut self) -> Result<(), String> {
        if self.machine.is_simulated() {
            return Ok(());
        }
        if self.is_taken_off {
            return Err(TAKEN_OFF.to_owned());
        }
        let is_there = self.machine.is_there();
        if self.port.as_mut().is_some_and(|port| !is_there || has_hung_up(port)) {
            self.port = None;
            self.tell("port-lost", None, "its port has vanished: look at the cable");
        }
        if !is_there {
            return Err(NOTHING_THERE.to_owned());
        }
        if self.port.is_some() {
            return Ok(());
        }
        match self.machine.stream().await {
            Ok(stream) => {
                (self.port, self.port_trouble) = (Some(stream), None);
                if !self.kit.identities.knows(self.name(), &self.machine.identity()) {
                    self.doubt(OTHER_MACHINE);
                }
                Ok(())
            }
            Err(error) => Err(self.not_opened(&error)),
        }
    }

    /// Told once.
    fn not_opened(&mut self, error: &Error) -> String {
        let says = match error {
            Error::Open { problem, .. } => format!("its port {problem}"),
            error => self.without_paths(error, Path::new("job")),
        };
        if let Error::Open { problem: PortProblem::Busy(_), .. } = error {
            self.doubt(OTHER_PROGRAM);
        }
        if self.port_trouble.as_ref() != Some(&says) {
            self.tell("port-not-opened", None, &says);
            self.port_trouble = Some(says.clone());
        }
        says
    }

    /// Whatever is known of the bed does not hold any more: recorded before the next job is taken.
    pub(super) fn doubt(&mut self, why: &'static str) {
        self.memory.doubt = Some(why);
    }

    /// A print, or whoever was let near, has been watched until now.
    pub(super) fn mark_watched(&mut self) {
        self.memory.watched = Some((self.kit.boot_clock.now)());
    }

    /// How long nobody has watched it.
    fn unwatched(&self) -> Duration {
        let now = (self.kit.boot_clock.now)();
        self.memory.watched.map_or(Duration::MAX, |at| now.saturating_sub(at))
    }

    /// A bed is watched as long as its port is held; one that is not clear needs no watching.
    async fn watch(&mut self, is_held: bool) {
        if self.unwatched() > self.config.bed_trusted.max(HICCUP) {
            self.doubt(UNWATCHED);
        }
        let found = if is_held { None } else { self.find().await.ok().flatten() };
        if is_held || found.is_some_and(|printer| printer.bed != Bed::Clear) {
            self.mark_watched();
        }
    }

    /// What there is to doubt at the start of a server, or of this part of it.
    pub(super) fn doubt_at_start(&mut self) {
        if !self.machine.is_simulated() && !self.machine.is_there() {
            self.doubt(NOTHING_THERE);
        } else if !self.kit.identities.knows(self.name(), &self.machine.identity()) {
            self.doubt(OTHER_MACHINE);
        } else if !self.machine.is_simulated() && self.unwatched() > self.config.bed_trusted {
            self.doubt(NO_SERVER);
        }
    }

    /// Has the queue record what is doubted, whatever the bed is: what a job leaves that laid nothing is not clear then, either.
    pub(super) async fn settle_doubt(&mut self) -> Result<(), store::Error> {
        let Some(why) = self.memory.doubt else { return Ok(()) };
        let found = self.find().await?;
        if found.is_some_and(|printer| printer.bed != Bed::Unknown && !printer.is_doubted) {
            self.say(Said::BedInDoubt, why).await?;
            self.tell("bed-in-doubt", None, &format!("{why}: look at its bed, and say what is true of it"));
        }
        self.memory.doubt = None;
        self.know();
        Ok(())
    }

    /// Its bed, whatever is known of it, is that of the machine that is there now.
    pub(super) fn know(&self) {
        let machine = self.machine.identity();
        if self.machine.is_there() && !self.kit.identities.knows(self.name(), &machine) {
            self.kit.identities.keep(self.name(), machine);
        }
    }
}

/// Whether nothing is behind an open port any more. What the printer says meanwhile is for nobody.
fn has_hung_up(port: &mut SerialStream) -> bool {
    let mut heard = [0; 1024];
    loop {
        match port.try_read(&mut heard) {
            Ok(0) => return true,
            Ok(_) => {}
            Err(error) => return error.kind() != io::ErrorKind::WouldBlock,
        }
    }
}
