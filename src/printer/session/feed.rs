//! The job's lines on their way to the core, and which of them wait for the journal.

use super::super::identity;
use super::super::laying::may_lay;
use super::super::protocol::{Command, Fault, Instant};
use super::{Laying, NAME_PATIENCE, Name, PrintEvent, Session, Stage};
use crate::profile;
use std::io::{BufRead, Seek};
use std::time::Duration;

impl<R: BufRead + Seek> Session<R> {
    /// Gives the core the next lines of the job; false if it wants none, or may not have any yet.
    pub(super) fn feed(&mut self) -> bool {
        if self.awaits_name() || self.laying == Laying::Asked {
            return false;
        }
        let mut was_given = false;
        while self.core.wants_line() && self.give() {
            was_given = true;
        }
        self.note_cancel();
        was_given
    }

    /// The job stops before its first line that may lay material ([`PrintEvent::AsksToLay`]) until [`Self::let_lay`]: the session does
    /// not know what has to be written down elsewhere first.
    pub fn hold_laying(&mut self) {
        self.laying = Laying::Held;
    }

    /// It goes on, and lays what it likes.
    pub fn let_lay(&mut self) {
        self.laying = Laying::Free;
    }

    /// Whether it has stopped before such a line.
    #[must_use]
    pub const fn asks_to_lay(&self) -> bool {
        matches!(self.laying, Laying::Asked)
    }

    /// The time for the answer begins when the question is sent: before it, the journal may be waited for.
    fn awaits_name(&mut self) -> bool {
        let n_own = self.recorder.track().prelude.len() as u64;
        if self.name == Name::ToBeAsked && self.core.progress().n_sent >= n_own {
            let patience = Duration::from_secs_f64(self.profile.firmware.response_timeout_s) * NAME_PATIENCE;
            self.name = Name::Asked(self.now + patience);
        }
        self.name != Name::Known
    }

    pub(super) const fn name_due(&self) -> Option<Instant> {
        match self.name {
            Name::Asked(due) => Some(due),
            Name::ToBeAsked | Name::Known => None,
        }
    }

    /// One that does not say what it is is believed.
    pub(super) fn name_timeout(&mut self) {
        if self.name_due().is_some_and(|due| due <= self.now) {
            self.name = Name::Known;
        }
    }

    /// A profile of another firmware prints nothing: it may leave out line numbers, or wait for answers that never come.
    pub(super) fn hear_name(&mut self, told: &str) {
        self.name = Name::Known;
        let expected = self.profile.firmware.dialect;
        let Some(found) = identity::dialect_of(told) else { return };
        if matches!(self.stage, Stage::Printing) && identity::is_another(found, expected) {
            let [found, expected] = [found, expected].map(identity::profile_name);
            if let Ok(profile) = profile::builtin(found) {
                self.core.speaks(&profile);
            }
            self.core.give_up(self.now, Fault::OtherFirmware { found, expected });
        }
    }

    /// Gives the core the next line of the job. One that changes the height is written down first, as late as can be: when all before
    /// it is sent.
    fn give(&mut self) -> bool {
        self.guard_z();
        let given = match self.job.next_command() {
            Ok(Some(line)) if self.laying == Laying::Held && may_lay(line) => {
                self.job.put_back();
                self.laying = Laying::Asked;
                self.events.push_back(PrintEvent::AsksToLay);
                return false;
            }
            Ok(Some(line)) if self.recorder.needs_leave(line) => {
                self.job.put_back();
                if !self.core.has_unsent() {
                    let record = self.recorder.allow_z(self.now, self.core.progress());
                    self.write_first(record);
                }
                return false;
            }
            Ok(Some(line)) => {
                self.recorder.feed(line);
                self.core.handle_command(self.now, Command::Line(line))
            }
            Ok(None) => {
                self.see_heat_left();
                self.core.handle_command(self.now, Command::EndOfJob)
            }
            Err(error) => {
                self.job_error = Some(error);
                self.core.handle_command(self.now, Command::Cancel)
            }
        };
        given.expect("a core that wants lines takes these commands");
        true
    }

    /// A job that ends without switching its heaters off leaves them to the firmware's own time-out, and the operator is told.
    fn see_heat_left(&mut self) {
        let modal = self.recorder.modal();
        let [hotend_c, bed_c] = [modal.hotend_c, modal.bed_c].map(|c| c.unwrap_or(0.0));
        if hotend_c > 0.0 || bed_c > 0.0 {
            self.core.leave_guarded();
            self.events.push_back(PrintEvent::LeftHot { hotend_c, bed_c });
        }
    }
}
