//! One printer of a server.

use super::Held;
use super::attend::{Attended, Told, journal_of};
use super::outcome::Outcome;
use super::press::{Ended, Machine, Press, Work};
use super::waiting::Word;
use crate::appliance::Error as ServerError;
use crate::appliance::config::{Port, PrinterConfig};
use crate::appliance::kit::{Kit, ended};
use crate::appliance::live::{Board, Lives, idle};
use crate::appliance::preparing;
use crate::appliance::survey::Survey;
use crate::http::appliance::{Unheard, Wish, Wished};
use crate::http::wire::Activity;
use crate::motion;
use crate::printer::driver::PrintEvent;
use crate::printer::laying::may_lay;
use crate::printer::{Error, PortProblem, ask};
use crate::profile;
use crate::queue::state::Kind;
use crate::queue::{Bed, By, Change, Claimant, Job, JobId, Name, Refusal, Said, Who};
use crate::store::{self, Claimed, Store};
use std::fs::File;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Mutex, mpsc};
use tokio::time::{Instant, sleep, sleep_until};
use tokio_serial::SerialStream;

/// How often a printer looks for a job.
const LOOK: Duration = Duration::from_millis(500);
/// After a port that could not be opened, at first and at most.
const REST: [Duration; 2] = [Duration::from_secs(5), Duration::from_secs(300)];

/// Where no print is under way.
pub(super) const NOTHING_SENT: &str =
    "it is not printing, nothing is sent to it: where it moves or heats all the same, use its own switch";

/// A printer of the configuration, as it is spoken to.
///
/// # Errors
/// Where its profile cannot be used.
pub(in crate::appliance) fn machine(config: &PrinterConfig, program: &Path) -> Result<Machine, ServerError> {
    let failed = |source| ServerError::Profile { printer: config.name.to_string(), source: Box::new(source) };
    let profile = profile::load::by_name(&config.profile).map_err(failed)?;
    Ok(Machine {
        profile: Arc::new(profile),
        profile_name: config.profile.clone(),
        port: config.port.clone(),
        baud: config.baud,
        program: program.to_owned(),
        turn: Arc::default(),
    })
}

/// See the module.
pub(in crate::appliance) struct Station<S> {
    pub(super) config: Arc<PrinterConfig>,
    pub(super) machine: Machine,
    pub(super) kit: Kit<S>,
    pub(super) board: Board,
    pub(super) wishes: tokio::sync::OwnedMutexGuard<mpsc::Receiver<Wished>>,
    /// Why it takes no job until somebody says so.
    halted: Option<String>,
    /// When it may look again, and how long it rests then.
    rests: Option<(Instant, Duration)>,
    /// The port, while nobody speaks to the printer: no other program gets it behind the queue's back.
    port: Option<SerialStream>,
    /// When heaters that somebody's commands have left on are switched off.
    hot_until: Option<Instant>,
}

/// What wishes come over, kept while a station is started again.
pub(in crate::appliance) type Wishes = Arc<Mutex<mpsc::Receiver<Wished>>>;

impl<S: Store> Station<S> {
    pub(in crate::appliance) async fn new(
        config: Arc<PrinterConfig>,
        machine: Machine,
        kit: Kit<S>,
        lives: Lives,
        wishes: Wishes,
    ) -> Self {
        let live = idle(config.name.clone(), machine.port_name(), config.clearing);
        let board = Board::new(live, lives);
        let wishes = wishes.lock_owned().await;
        Self { config, machine, kit, board, wishes, halted: None, rests: None, port: None, hot_until: None }
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
        self.take_up().await?;
        self.clear_what_lies_there().await?;
        let mut stopping = self.kit.stopping.clone();
        while self.kit.stopping().is_none() {
            let hot_until = self.hot_until.unwrap_or_else(Instant::now);
            tokio::select! {
                Some(wished) = self.wishes.recv() => self.heed_idle(wished).await,
                () = sleep_until(hot_until), if self.hot_until.is_some() => self.switch_off().await,
                () = sleep(LOOK) => {
                    if let Some(claimed) = self.draw().await? {
                        self.print(claimed).await?;
                    }
                }
                () = ended(&mut stopping) => {}
            }
        }
        Ok(())
    }

    /// What a server had in hand that died.
    async fn take_up(&mut self) -> Result<(), store::Error> {
        let adopted = self.kit.store.adopt(self.name().clone(), self.kit.now()).await?;
        self.kit.events.look();
        if let Some(first) = adopted.iter().find(|claimed| !claimed.job.is_laid) {
            tracing::info!(printer = %self.name(), job = %first.job.id, "print: nothing was laid yet: back into the queue");
            self.switch_off().await;
        }
        for claimed in adopted {
            let held = self.held(&claimed);
            let told = if self.machine.is_simulated() { Told::Nothing } else { journal_of(&held.gcode) };
            match told {
                _ if !claimed.job.is_laid => {
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
                    self.go_on(held, Outcome::Waits(why)).await?;
                }
                Told::Nothing => {
                    self.switch_off().await;
                    let why = "the server ended in the middle of the print, which cannot be gone on with";
                    self.settle(&held, Change::Fail { used_mm3: None }, None, why).await?;
                }
            }
        }
        Ok(())
    }

    fn held(&self, claimed: &Claimed) -> Held {
        let Claimed { job, claim } = claimed;
        Held {
            claim: claim.clone(),
            gcode: self.kit.layout.gcode(job.id),
            is_laid: job.is_laid,
            is_paused: job.state == crate::queue::State::Paused,
            needs_consent: false,
            may_be_hot: false,
            print_s: job.estimate().map_or(0, |estimate| estimate.print_s),
            n_first_layer: None,
        }
    }

    /// A job, where there is one for this printer and nothing stands in the way.
    async fn draw(&mut self) -> Result<Option<Claimed>, store::Error> {
        if self.halted.is_some() || self.rests.is_some_and(|(until, _)| Instant::now() < until) {
            return Ok(None);
        }
        if !self.machine.is_there() {
            self.board.set(Activity::Offline, Some("there is nothing at its port".to_owned()));
            return Ok(None);
        }
        if !self.has_port().await {
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

    /// Keeps the port from other programs. One that has it may lay something: the bed is not known any more.
    async fn has_port(&mut self) -> bool {
        if self.port.is_some() || self.machine.is_simulated() {
            return true;
        }
        let problem = match self.machine.stream().await {
            Ok(stream) => {
                self.port = Some(stream);
                return true;
            }
            Err(Error::Open { problem, .. }) => problem,
            Err(_) => return false,
        };
        let says = format!("its port {problem}");
        if self.board.activity() != Activity::Offline {
            self.tell("port-not-opened", None, &says);
        }
        let is_clear =
            self.find().await.is_ok_and(|found| found.is_some_and(|printer| printer.bed == Bed::Clear));
        if is_clear && matches!(problem, PortProblem::Busy(_)) {
            let doubted = self.say(Said::BedInDoubt, "another program had its port").await;
            doubted.unwrap_or_else(|error| tracing::error!(printer = %self.name(), "bed: {error}"));
        }
        self.board.set(Activity::Offline, Some(says));
        false
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
        if survey.hotend_c > limits.hotend_c || survey.bed_c > limits.bed_c {
            return Err(format!(
                "it sets the nozzle to {:.0} °C and the bed to {:.0} °C; {:.0} and {:.0} °C are allowed without anybody near",
                survey.hotend_c, survey.bed_c, limits.hotend_c, limits.bed_c
            ));
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
        let press = match Press::start(&self.machine, work, !held.is_laid).await {
            Ok(press) => press,
            Err(error) => return Some(no_thread(held, &error)),
        };
        self.board.begin(self.kit.now(), held.print_s);
        let outcome = Attended::new(self, held, press).outcome().await;
        let is_left_warm = matches!(outcome, None | Some(Outcome::Waits(_)));
        if held.may_be_hot && !is_left_warm {
            self.switch_off().await;
        }
        outcome
    }

    /// What follows from a print that has ended, until nothing is left to do for it.
    async fn go_on(&mut self, mut held: Held, mut outcome: Outcome) -> Result<(), store::Error> {
        loop {
            match outcome {
                Outcome::Change { change, by, why } => {
                    return self.settle(&held, change, by.as_ref(), &why).await;
                }
                Outcome::Lost => {
                    self.board.end(Activity::Idle, None);
                    return Ok(());
                }
                Outcome::Waits(why) => match self.wait_for_word(&mut held, &why).await {
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
        if held.is_paused && matches!(change, Change::Printed { .. }) {
            self.kit.insist(&held.claim, Change::GoOn, None, "").await.map_or_else(refused, |_| Ok(()))?;
        }
        let is_given_back = matches!(change, Change::GiveBack { .. });
        self.kit.insist(&held.claim, change, by, why).await.map_or_else(refused, |_| Ok(()))?;
        self.kit.counters.count_print(kind);
        match kind {
            Kind::Printed => {
                self.tell("printed", Some(job), "a copy is printed: take it off the bed and say so")
            }
            Kind::Fail => self.tell("failed", Some(job), told),
            Kind::Cancel => self.tell("cancelled", Some(job), told),
            _ => {}
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
            Wish::EmergencyStop => Err(not_now(NOTHING_SENT)),
            Wish::Connect => {
                (self.halted, self.rests) = (None, None);
                if self.machine.is_there() { Ok(()) } else { Err(not_now("there is nothing at its port")) }
            }
            Wish::Disconnect => {
                let why = "taken off by an operator: connect it again".to_owned();
                self.board.set(Activity::Offline, Some(why.clone()));
                self.port = None;
                self.halted = Some(why);
                Ok(())
            }
            Wish::Commands(lines) => {
                // Answered first: commands may take minutes.
                let begun = self.check_commands(&lines).await;
                let is_good = begun.is_ok();
                wished.answer.send(begun).ok();
                if is_good {
                    self.command(lines).await;
                }
                return;
            }
        };
        wished.answer.send(answer).ok();
    }

    async fn check_commands(&self, lines: &[String]) -> Result<(), Unheard> {
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

    /// Does what somebody has asked for at a printer that is not printing.
    async fn command(&mut self, lines: Vec<String>) {
        self.port = None;
        let mut press = match Press::start(&self.machine, Work::Commands(lines.join("\n")), false).await {
            Ok(press) => press,
            Err(error) => return tracing::error!(printer = %self.name(), "commands: {error}"),
        };
        while let Some(event) = press.events.recv().await {
            self.board.hear(&event, self.kit.now());
            if let PrintEvent::LeftHot { .. } = event {
                let hold = Duration::from_secs_f64(self.machine.profile.firmware.orphan_hold_s);
                self.hot_until = Some(Instant::now() + hold);
            }
        }
        if let Ended::With(result) = press.end().await
            && let Err(error) = *result
        {
            let said = self.without_paths(&error, &PathBuf::from("commands"));
            tracing::warn!(printer = %self.name(), "commands: {said}");
            self.board.set(Activity::Idle, Some(said));
        }
    }

    /// Switches heaters off that nobody owns.
    pub(super) async fn switch_off(&mut self) {
        (self.hot_until, self.port) = (None, None);
        if self.machine.is_simulated() || !self.machine.is_there() {
            return;
        }
        let _turn = Arc::clone(&self.machine.turn).lock_owned().await;
        let off = async { ask::safe_off(self.machine.open().await?, &self.machine.profile).await };
        match off.await {
            Ok(_) => tracing::info!(printer = %self.name(), "heaters are off"),
            Err(error) => {
                let said = self.without_paths(&error, Path::new("job"));
                tracing::error!(printer = %self.name(), "heaters: {said}");
                self.tell("heaters-unknown", None, &said);
                self.board.set(self.board.activity(), Some(said));
            }
        }
    }
}

fn no_thread(held: &Held, error: &io::Error) -> Outcome {
    let why = format!("the system gives no thread for the print: {error}");
    if held.is_laid {
        return Outcome::Waits(why);
    }
    Outcome::Change { change: Change::GiveBack { lost: false }, by: None, why }
}

pub(super) fn not_now(text: &str) -> Unheard {
    Unheard::NotNow(text.to_owned())
}

/// What the queue refuses is settled: somebody else has decided. What cannot be recorded at all ends the part.
fn refused(error: store::Error) -> Result<(), store::Error> {
    match error {
        store::Error::Refused(refusal @ Refusal::ClaimLost) => {
            tracing::warn!("print: {refusal}");
            Ok(())
        }
        store::Error::Refused(refusal) => {
            tracing::error!("print: {refusal}");
            Ok(())
        }
        error => Err(error),
    }
}
