//! One printer of a server.

use super::attend::{Attended, Told};
use super::heaters::Owed;
use super::outcome::{self, Begun, Heaters, Outcome};
use super::port::TAKEN_OFF;
use super::press::{Machine, Press, Work};
use super::waiting::Word;
use super::{Held, Shown};
use crate::appliance::Error as ServerError;
use crate::appliance::config::{Port, PrinterConfig};
use crate::appliance::heat::{HeatFile, Hot};
use crate::appliance::kit::{Kit, can_be_mended, ended};
use crate::appliance::live::{Board, Lives, idle};
use crate::appliance::place::Layout;
use crate::appliance::preparing;
use crate::appliance::survey::Survey;
use crate::http::appliance::{Unheard, Wish, Wished};
use crate::http::wire::{Activity, Live};
use crate::motion;
use crate::printer::Error;
use crate::profile;
use crate::queue::state::Kind;
use crate::queue::{Bed, By, Change, Claimant, Job, JobId, Name, Refusal, Said, Who};
use crate::store::{self, Claimed, Store};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, BufReader};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Mutex, OwnedMutexGuard, mpsc};
use tokio::time::{Instant, sleep, sleep_until};
use tokio_serial::SerialStream;

/// How often a printer looks for a job.
pub(super) const LOOK: Duration = Duration::from_millis(500);
/// Between two attempts to take up what a server left, at first and at most.
const AGAIN: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(30)];
/// After a port that could not be opened, at first and at most.
const REST: [Duration; 2] = [Duration::from_secs(5), Duration::from_secs(300)];

/// A printer of the configuration, as it is spoken to.
///
/// # Errors
/// Where its profile cannot be used.
pub(in crate::appliance) fn machine(
    config: &PrinterConfig,
    program: &Path,
    layout: &Layout,
) -> Result<Machine, ServerError> {
    let failed = |source| ServerError::Profile { printer: config.name.to_string(), source: Box::new(source) };
    let profile = profile::load::by_name(&config.profile).map_err(failed)?;
    Ok(Machine {
        profile: Arc::new(profile),
        profile_name: config.profile.clone(),
        port: config.port.clone(),
        baud: config.baud,
        program: program.to_owned(),
        turn: Arc::default(),
        heat: HeatFile::of(config, layout),
    })
}

/// See the module.
pub(in crate::appliance) struct Station<S> {
    pub(super) config: Arc<PrinterConfig>,
    pub(super) machine: Machine,
    pub(super) kit: Kit<S>,
    pub(super) board: Board,
    pub(super) wishes: OwnedMutexGuard<mpsc::Receiver<Wished>>,
    /// Wishes that came while somebody's lines were under way.
    pub(super) later: VecDeque<Wished>,
    /// Why it takes no job until somebody says so.
    pub(super) halted: Option<String>,
    /// What a printer has said whose print was stopped at once.
    pub(super) stopped: Option<String>,
    /// When it may look again, and how long it rests then.
    rests: Option<(Instant, Duration)>,
    /// The port, while nobody speaks to the printer: no other program gets it behind the queue's back.
    pub(super) port: Option<SerialStream>,
    /// Why it could not be opened, as it was told last.
    pub(super) port_trouble: Option<String>,
    /// An operator has taken the printer off: its port is anybody's.
    pub(super) is_taken_off: bool,
    /// When heaters that somebody's commands, or a server that died, have left on are switched off.
    pub(super) hot_until: Option<Instant>,
    pub(super) memory: OwnedMutexGuard<Memory>,
}

/// What is known of a printer whatever becomes of its station.
#[derive(Debug, Default)]
pub(in crate::appliance) struct Memory {
    /// When its bed was watched last, since the start of the machine; `None`: nobody knows.
    pub(super) watched: Option<Duration>,
    /// Why its bed is in doubt, where the queue has not recorded that yet.
    pub(super) doubt: Option<&'static str>,
    /// Heaters that could not be switched off.
    pub(super) owes_off: Option<Owed>,
}

impl Memory {
    /// Of a printer whose bed was watched last then, since the start of the machine; `None`: nobody knows.
    pub(in crate::appliance) fn of(watched: Option<Duration>) -> Self {
        Self { watched, ..Self::default() }
    }
}

/// What is kept while a station is started again. Clones are the same.
#[derive(Debug, Clone)]
pub(in crate::appliance) struct Kept {
    /// What wishes come over.
    pub(in crate::appliance) wishes: Arc<Mutex<mpsc::Receiver<Wished>>>,
    pub(in crate::appliance) memory: Arc<Mutex<Memory>>,
}

impl<S: Store> Station<S> {
    pub(in crate::appliance) async fn new(
        config: Arc<PrinterConfig>,
        machine: Machine,
        kit: Kit<S>,
        lives: Lives,
        kept: Kept,
    ) -> Self {
        let live = Live {
            max_hotend_c: Some(config.limits.hotend_c),
            max_bed_c: Some(config.limits.bed_c),
            ..idle(config.name.clone(), machine.port_name(), config.clearing)
        };
        let board = Board::new(live, lives);
        let (wishes, memory) = (kept.wishes.lock_owned().await, kept.memory.lock_owned().await);
        Self {
            config,
            machine,
            kit,
            board,
            wishes,
            later: VecDeque::new(),
            halted: None,
            stopped: None,
            rests: None,
            port: None,
            port_trouble: None,
            is_taken_off: false,
            hot_until: None,
            memory,
        }
    }

    pub(super) const fn name(&self) -> &Name {
        self.board.name()
    }

    pub(super) async fn find(&self) -> Result<Option<crate::queue::Printer>, store::Error> {
        Ok(self.kit.store.printers().await?.into_iter().find(|printer| printer.name == *self.name()))
    }

    pub(super) async fn say(&self, said: Said, why: &str) -> Result<(), store::Error> {
        let who = Who::Appliance(self.name().clone());
        let by = By { who, why: crate::appliance::kit::reason(why), now: self.kit.now() };
        let said = self.kit.store.say(self.name().clone(), said, by).await;
        self.kit.events.look();
        said.map(drop)
    }

    /// Tells the operator, wherever he is.
    pub(super) fn tell(&self, event: &'static str, job: Option<JobId>, text: &str) {
        self.kit.news.tell(event, Some(self.name()), job, text);
    }

    /// An error's words without the paths of job and port.
    pub(super) fn without_paths(&self, error: &Error, gcode: &Path) -> String {
        let text = error.to_string().replace(&gcode.display().to_string(), "the job");
        match &self.machine.port {
            Port::Path(port) => text.replace(port.as_str(), "of the printer"),
            Port::Simulated { .. } => text,
        }
    }

    /// Until the server ends.
    ///
    /// # Errors
    /// [`store::Error::Gone`] and what else of the queue cannot be mended by trying again.
    pub(in crate::appliance) async fn run(&mut self) -> Result<(), store::Error> {
        self.machine.own_heat().await;
        self.take_up().await?;
        // Left by a server that died, and no print's that could go on.
        let is_seen_to = self.heaters_unknown().is_some() || self.kit.stopping().is_some();
        if self.machine.may_be_hot() && !is_seen_to {
            self.switch_off().await;
        }
        self.clear_what_lies_there().await?;
        self.mark_watched();
        let mut stopping = self.kit.stopping.clone();
        while self.kit.stopping().is_none() {
            let hot_until = self.hot_until.unwrap_or_else(Instant::now);
            tokio::select! {
                Some(wished) = next_wish(&mut self.wishes) => {
                    self.heed_idle(wished).await;
                    while let Some(wished) = self.later.pop_front() {
                        // Whoever has left believes that nothing is done, and may ask again.
                        if !wished.answer.is_closed() {
                            self.heed_idle(wished).await;
                        }
                    }
                }
                () = sleep_until(hot_until), if self.hot_until.is_some() => self.switch_off().await,
                () = sleep(LOOK) => {
                    if let Some(claimed) = self.draw().await? {
                        self.print(claimed).await?;
                        self.mark_watched();
                    }
                }
                () = ended(&mut stopping) => {}
            }
        }
        if self.hot_until.is_some() {
            self.switch_off().await;
        }
        Ok(())
    }

    /// What a server had in hand that died: its heaters first.
    async fn take_up(&mut self) -> Result<(), store::Error> {
        self.secure().await?;
        for claimed in self.adopt().await? {
            let held = self.held(&claimed);
            match self.told(claimed.job.is_laid, &held.gcode) {
                _ if !claimed.job.is_laid => {
                    tracing::info!(printer = %self.name(), job = %claimed.job.id, "print: nothing was laid yet: back into the queue");
                    let why = "the server ended before anything was laid";
                    let given =
                        self.kit.insist(&held.claim, Change::GiveBack { lost: false }, None, why).await;
                    given.map_or_else(refused, |_| Ok(()))?;
                }
                Told::Finished => {
                    let why = "the server ended before it was recorded";
                    self.settle(&held, Change::Printed { used_mm3: None }, None, why).await?;
                }
                Told::BrokeOff => {
                    let why = "the server ended in the middle of the print".to_owned();
                    self.hot_until = None;
                    self.go_on(held, Outcome::waits(why)).await?;
                }
                Told::Nothing => {
                    let why = "the server ended in the middle of the print, which cannot be gone on with";
                    self.settle(&held, Change::Fail { used_mm3: None }, None, why).await?;
                }
            }
        }
        Ok(())
    }

    /// Takes it up in the queue, as soon as that can be written; heaters are seen to meanwhile.
    async fn adopt(&mut self) -> Result<Vec<Claimed>, store::Error> {
        let [mut rest, longest] = AGAIN;
        let mut stopping = self.kit.stopping.clone();
        loop {
            let error = match self.enter().await {
                Err(error) if can_be_mended(&error) => error,
                done => return done,
            };
            tracing::error!(printer = %self.name(), "queue: {error}; it is tried again");
            let says = format!("nothing can be printed: the queue cannot be written ({})", error.code());
            self.board.set(Activity::Faulted, Some(self.with_heaters(&says)));
            let hot_until = self.hot_until.unwrap_or_else(Instant::now);
            tokio::select! {
                () = sleep(rest) => {}
                () = sleep_until(hot_until), if self.hot_until.is_some() => self.switch_off().await,
                () = ended(&mut stopping) => {
                    // What could go on stays warm for the next server.
                    self.hot_until = None;
                    return Ok(Vec::new());
                }
            }
            // What is owed stands on the board.
            self.pay_off().await.ok();
            rest = (2 * rest).min(longest);
        }
    }

    async fn enter(&mut self) -> Result<Vec<Claimed>, store::Error> {
        self.introduce().await?;
        let adopted = self.kit.store.adopt(self.name().clone(), self.kit.now()).await?;
        self.kit.events.look();
        Ok(adopted)
    }

    fn held(&self, claimed: &Claimed) -> Held {
        let Claimed { job, claim } = claimed;
        let is_paused = job.state == crate::queue::State::Paused;
        Held {
            claim: claim.clone(),
            gcode: self.kit.layout.gcode(job.id),
            is_laid: job.is_laid,
            is_paused,
            shown: if is_paused { Shown::Paused } else { Shown::Printing },
            needs_consent: false,
            print_s: job.estimate().map_or(0, |estimate| estimate.print_s),
            n_first_layer: None,
        }
    }

    /// A job, where there is one for this printer and nothing stands in the way.
    async fn draw(&mut self) -> Result<Option<Claimed>, store::Error> {
        let tended = self.look_after().await;
        if let Some(why) = self.halted.clone() {
            let activity = if self.is_taken_off { Activity::Offline } else { Activity::Faulted };
            self.board.set(activity, Some(self.with_heaters(&why)));
            return Ok(None);
        }
        if self.rests.is_some_and(|(until, _)| Instant::now() < until) {
            return Ok(None);
        }
        if let Err((activity, says)) = tended {
            self.board.set(activity, Some(says));
            return Ok(None);
        }
        if self.board.activity() != Activity::Idle {
            self.board.set(Activity::Idle, None);
        }
        let is_ready =
            self.find().await.is_ok_and(|found| found.is_some_and(|printer| printer.bed == Bed::Clear));
        if !is_ready {
            return Ok(None);
        }
        match self.kit.store.claim(Claimant::Printer(self.name().clone()), self.kit.now()).await {
            Ok(claimed) => Ok(claimed),
            Err(store::Error::Gone) => Err(store::Error::Gone),
            Err(error) => {
                tracing::debug!(printer = %self.name(), "print: no job: {error}");
                Ok(None)
            }
        }
    }

    async fn print(&mut self, claimed: Claimed) -> Result<(), store::Error> {
        self.kit.events.look();
        let mut held = self.held(&claimed);
        tracing::info!(printer = %self.name(), job = %held.claim.job, "print: begins");
        match self.check(&claimed.job, &held).await {
            Ok(survey) => held.n_first_layer = survey.n_first_layer,
            Err(why) => return self.settle(&held, Change::Fail { used_mm3: Some(0) }, None, &why).await,
        }
        let work = Work::Print(held.gcode.clone());
        match self.attempt(&mut held, work).await {
            Some(outcome) => self.go_on(held, outcome).await,
            None => Ok(()),
        }
    }

    /// That what is to be printed is what was prepared, and within the limits.
    async fn check(&self, job: &Job, held: &Held) -> Result<Survey, String> {
        let (gcode, limits) = (held.gcode.clone(), self.config.limits);
        let bed_mm = self.machine.profile.machine.bed_mm;
        let found = tokio::task::spawn_blocking(move || {
            let (digest, survey) = preparing::examine(&gcode)?;
            Ok((digest, survey, motion::leaving(BufReader::new(File::open(&gcode)?), bed_mm)?))
        });
        let found = found.await.map_err(|_panicked| "the job's G-code cannot be read".to_owned())?;
        let (digest, survey, leaving) =
            found.map_err(|error: io::Error| format!("the job's G-code cannot be read: {}", error.kind()))?;
        if job.made.as_ref().is_none_or(|made| made.gcode != digest) {
            return Err("the job's G-code is not what was prepared: it was changed".to_owned());
        }
        if let Some(leaving) = leaving.filter(|leaving| leaving.is_lost) {
            return Err(format!("it was made for another printer: {leaving}"));
        }
        if let Some(why) = limits.refuse_heat(survey.hotend_c, survey.bed_c) {
            return Err(format!("{why} without anybody near"));
        }
        if self.config.first_layer_hold && survey.n_layers == 0 {
            return Err(
                "it does not mark its layers, so that first_layer_hold cannot pause behind the first one: \
                        have the slicer write layer comments, or take first_layer_hold out"
                    .to_owned(),
            );
        }
        let hours = |s: f64| s / 3600.0;
        if survey.print_s > limits.longest.as_secs_f64() {
            let (found, most) = (hours(survey.print_s), hours(limits.longest.as_secs_f64()));
            return Err(format!("it takes {found:.1} h; {most:.1} h are allowed without anybody near"));
        }
        Ok(survey)
    }

    /// Prints, or goes on; `None`: it is left paused for the next server.
    pub(super) async fn attempt(&mut self, held: &mut Held, work: Work) -> Option<Outcome> {
        self.port = None;
        self.machine.tell_heat(Some(Hot::PRINT)).await;
        let begun = if matches!(work, Work::Resume { .. }) { Begun::Again } else { Begun::Anew };
        let press = match Press::start(&self.machine, work, !held.is_laid).await {
            Ok(press) => press,
            Err(error) => return Some(no_thread(held, &error)),
        };
        self.board.begin(self.kit.now(), held.claim.job, held.print_s);
        let outcome = Attended::new(self, held, press, begun).outcome().await;
        match outcome.as_ref().map(|outcome| outcome.heaters) {
            Some(Heaters::SwitchOff) => self.switch_off().await,
            Some(Heaters::Off) => self.machine.tell_heat(None).await,
            Some(Heaters::Keep) => {}
            None => self.machine.tell_heat(Some(Hot::waits(self.kit.now(), self.hold()))).await,
        }
        self.mark_watched();
        if outcome.is_some() {
            // Where it cannot be had, the next look tells.
            self.hold_port().await.ok();
        }
        outcome
    }

    /// What follows from a print that has ended, until nothing is left to do for it.
    async fn go_on(&mut self, mut held: Held, mut outcome: Outcome) -> Result<(), store::Error> {
        loop {
            match outcome.job {
                outcome::Job::Change { change, by, why } => {
                    return self.settle(&held, change, by.as_ref(), &why).await;
                }
                outcome::Job::Lost => {
                    self.lose(&held);
                    return Ok(());
                }
                outcome::Job::Waits(why) => match self.wait_for_word(&mut held, &why).await {
                    Word::GoOn { after_reset } => {
                        let work = Work::Resume { job: held.gcode.clone(), after_reset };
                        match self.attempt(&mut held, work).await {
                            Some(next) => outcome = next,
                            None => return Ok(()),
                        }
                    }
                    Word::GiveUp { by, why } => {
                        return self
                            .settle(&held, Change::Cancel { used_mm3: None }, Some(&by), why.as_str())
                            .await;
                    }
                    Word::Lost => {
                        self.lose(&held);
                        return Ok(());
                    }
                    Word::Nothing => return Ok(()),
                },
            }
        }
    }

    /// Has the end recorded, and does what follows from it.
    async fn settle(
        &mut self,
        held: &Held,
        change: Change,
        by: Option<&Name>,
        why: &str,
    ) -> Result<(), store::Error> {
        let (job, kind) = (held.claim.job, change.kind());
        // What people write may name somebody, and stays in the queue.
        let told = if by.is_some() { "somebody has asked for it" } else { why };
        tracing::info!(printer = %self.name(), %job, end = %kind, why = told, "print: ended");
        if held.shown != Shown::Printing && matches!(change, Change::Printed { .. }) {
            self.kit.insist(&held.claim, Change::GoOn, None, "").await.map_or_else(refused, |_| Ok(()))?;
        }
        let mut kind = kind;
        let mut recorded = self.kit.insist(&held.claim, change, by, why).await;
        if kind == Kind::GiveBack && matches!(recorded, Err(store::Error::Refused(Refusal::MaterialLaid))) {
            // That it may lay was recorded after all, and the answer was lost: it has not.
            let failed = Change::Fail { used_mm3: Some(0) };
            (kind, recorded) = (Kind::Fail, self.kit.insist(&held.claim, failed, by, why).await);
        }
        if matches!(recorded, Err(store::Error::Refused(Refusal::ClaimLost))) {
            self.lose(held);
            return Ok(());
        }
        recorded.map_or_else(refused, |_| Ok(()))?;
        let is_given_back = kind == Kind::GiveBack;
        self.kit.counters.count_print(kind);
        match kind {
            Kind::Printed => {
                self.tell("printed", Some(job), "a copy is printed: take it off the bed and say so")
            }
            Kind::Fail => self.tell("failed", Some(job), told),
            Kind::Cancel => self.tell("cancelled", Some(job), told),
            _ => {}
        }
        if let Some(said) = self.stopped.take() {
            self.board.end(Activity::Faulted, None);
            self.halt(&format!("emergency stop: {said}"));
            return Ok(());
        }
        if !is_given_back {
            self.board.end(Activity::Idle, None);
            if kind == Kind::Printed {
                self.rests = None;
                return self.clear_bed(job).await;
            }
            return Ok(());
        }
        if self.kit.stopping().is_none() {
            self.rest(why);
        }
        Ok(())
    }

    /// The job is not this printer's any more. What was laid of it lies there, whatever was said of the bed meanwhile.
    fn lose(&mut self, held: &Held) {
        let job = held.claim.job;
        tracing::warn!(printer = %self.name(), %job, "print: the job is not this printer's any more");
        self.board.end(Activity::Idle, None);
        if !held.is_laid {
            return;
        }
        self.tell(
            "claim-lost",
            Some(job),
            "the job was ended elsewhere in the middle of its print: look at the bed",
        );
        self.doubt("its print was ended elsewhere");
    }

    /// A job that came back by itself: the printer is looked after before it takes the next one.
    fn rest(&mut self, why: &str) {
        let [first, most] = REST;
        let rest = self.rests.map_or(first, |(_, rest)| (2 * rest).min(most));
        self.rests = Some((Instant::now() + rest, rest));
        self.board.end(Activity::Faulted, Some(why.to_owned()));
        if rest == most {
            self.halted = Some(why.to_owned());
            self.tell("printer-halted", None, why);
        }
    }

    async fn heed_idle(&mut self, wished: Wished) {
        let answer = match wished.wish {
            _ if wished.job.is_some() => Err(not_now("the printer does not have this job")),
            Wish::Pause | Wish::GoOn | Wish::Cancel => Err(not_now("it is not printing")),
            Wish::EmergencyStop => {
                self.stop_at_once(wished.answer).await;
                return;
            }
            Wish::Connect => {
                (self.halted, self.rests, self.is_taken_off) = (None, None, false);
                if self.machine.is_there() { Ok(()) } else { Err(not_now("there is nothing at its port")) }
            }
            Wish::Disconnect => {
                let why = "taken off by an operator: connect it again".to_owned();
                self.board.set(Activity::Offline, Some(why.clone()));
                (self.port, self.is_taken_off) = (None, true);
                self.doubt(TAKEN_OFF);
                self.halted = Some(why);
                Ok(())
            }
            Wish::Commands(lines) => {
                // Answered first: commands may take minutes.
                let begun = self.check_commands(&lines).await;
                let is_good = begun.is_ok();
                // Whoever has left believes that nothing is done, and may ask again.
                if wished.answer.send(begun).is_ok() && is_good {
                    self.command(lines).await;
                }
                return;
            }
        };
        wished.answer.send(answer).ok();
    }

    /// How long heaters may be on that nobody needs.
    pub(super) fn hold(&self) -> Duration {
        Duration::from_secs_f64(self.machine.profile.firmware.orphan_hold_s)
    }
}

fn no_thread(held: &Held, error: &io::Error) -> Outcome {
    let why = format!("the system gives no thread for the print: {error}");
    if held.is_laid {
        return Outcome::waits(why);
    }
    let job = outcome::Job::Change { change: Change::GiveBack { lost: false }, by: None, why };
    Outcome { job, heaters: Heaters::Off }
}

/// The next wish whose answer is still awaited: whoever has left believes that nothing is done, and may ask again.
pub(super) async fn next_wish(wishes: &mut mpsc::Receiver<Wished>) -> Option<Wished> {
    loop {
        let wished = wishes.recv().await?;
        if !wished.answer.is_closed() {
            return Some(wished);
        }
        tracing::warn!(printer = %wished.printer, "a wish was passed over: nobody waits for it any more");
    }
}

pub(super) fn not_now(text: &str) -> Unheard {
    Unheard::NotNow(text.to_owned())
}

/// What the queue refuses is settled: somebody else has decided. What cannot be recorded at all ends the part.
fn refused(error: store::Error) -> Result<(), store::Error> {
    match error {
        store::Error::Refused(refusal) => {
            tracing::error!("print: {refusal}");
            Ok(())
        }
        error => Err(error),
    }
}
