//! Asking a printer where it is, and what follows from its answer.

use super::super::journal::{Place, Record, Track};
use super::super::protocol::{Command, Core, Fault, Question};
use super::super::replay::Tail;
use super::super::resume::{self, Decision, Exact, Known, Recovery, Refusal, Survey, Why};
use super::super::{job, journal::recorder::Recorder};
use super::{End, Manner, PrintEvent, Session, Stage};
use std::io::{BufRead, Seek};

impl<R: BufRead + Seek> Session<R> {
    pub(super) fn survey(&mut self, known: Known, manner: Manner) {
        let beyond = known.progress.number;
        self.stage = Stage::Surveying { known: Box::new(known), survey: Survey::default(), manner };
        self.command(Command::Inquire { beyond });
    }

    pub(super) fn found(&mut self, last: Option<u64>) {
        if let Stage::Surveying { survey, .. } = &mut self.stage {
            // What it said before may be of before a reset.
            *survey = Survey { last, ..Survey::default() };
            self.command(Command::Ask(Question::Temperatures));
        }
    }

    /// Temperatures first, then the position; then it is decided.
    pub(super) fn answered(&mut self) {
        let Stage::Surveying { known, survey, manner } = &self.stage else { return };
        if survey.position.is_none() {
            self.command(Command::Ask(Question::Position));
            return;
        }
        let (manner, survey, known) = (*manner, *survey, known.clone());
        match resume::decide(&mut self.job, &self.profile, &known, &survey) {
            Ok(Decision::Exact(exact)) => self.go_on(*exact),
            Ok(Decision::Recover(recovery)) => self.recover(recovery, manner),
            Ok(Decision::Refuse(refusal)) => self.refuse(refusal, manner),
            Err(error) => self.lose_job(error),
        }
    }

    fn go_on(&mut self, exact: Exact) {
        let n_done = exact.n_done();
        if let Err(error) = self.wind_to(n_done) {
            self.lose_job(error);
            return;
        }
        let Exact { place, track, modal, tail } = exact;
        self.write_first(Record::Session(track.clone()));
        let prelude = track.prelude.clone();
        self.core.is_behind(&modal);
        self.recorder = Recorder::new(track, modal, tail, self.now);
        self.recorder.hear(self.temperatures);
        self.stage = Stage::Printing;
        self.parked = None;
        self.events.push_back(PrintEvent::WentOn { n_lines_done: n_done });
        self.command(Command::GoOn);
        if let Place::Prelude(n) = place {
            prelude.iter().skip(n).for_each(|line| self.command(Command::HostLine(line)));
        }
        if self.is_held {
            self.command(Command::Pause);
        }
    }

    fn recover(&mut self, recovery: Box<Recovery>, manner: Manner) {
        match manner {
            Manner::Reattach { .. } => self.lose_place(Some(recovery.why), recovery.why.to_string()),
            Manner::Resume { after_reset: false } => self.over(End::NeedsConsent(recovery)),
            Manner::Resume { after_reset: true } => self.begin_anew(*recovery),
        }
    }

    fn begin_anew(&mut self, recovery: Recovery) {
        let Recovery { n_done, n_twice, commands, modal, .. } = recovery;
        self.n_twice += n_twice;
        if let Err(error) = self.wind_to(n_done) {
            self.lose_job(error);
            return;
        }
        let tail = Tail::after(n_done);
        self.recorder = Recorder::new(Track::default(), modal, tail, self.now);
        self.recorder.hear(self.temperatures);
        self.stats = self.stats.plus(self.core.stats());
        self.core = Core::new(&self.profile);
        self.stage = Stage::Greeting { host_lines: commands };
        self.command(Command::Connect);
    }

    fn refuse(&mut self, refusal: Refusal, manner: Manner) {
        match manner {
            Manner::Reattach { .. } => self.lose_place(refusal.why(), refusal.to_string()),
            // No warm part waits for anything any more.
            Manner::Resume { .. } => self.switch_off(End::Refused(refusal)),
        }
    }

    /// Nobody is asked while a print runs: the printer has lost its place, and is told to switch its heaters off.
    fn lose_place(&mut self, why: Option<Why>, text: String) {
        let fault = match why {
            Some(Why::Restarted) => Fault::FirmwareReset,
            _ => Fault::LostPlace { why: text },
        };
        self.core.give_up(self.now, fault);
    }

    /// There is nothing any more that could be printed: no part is kept warm for it.
    fn lose_job(&mut self, error: job::Error) {
        self.switch_off(End::Job(error.into()));
    }

    /// Puts the job behind its first lines.
    pub(super) fn wind_to(&mut self, n_lines: u64) -> Result<(), job::Error> {
        self.job.replay(n_lines, |_| {})
    }
}
