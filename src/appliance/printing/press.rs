//! A print on a thread of its own: whatever the rest of the server does, the planner of the printer does not run dry (IO).

use crate::appliance::config::Port;
use crate::appliance::heat::{HeatFile, Hot};
use crate::printer::control::Controls;
use crate::printer::driver::{Order, PrintEvent, Printed};
use crate::printer::link::Link;
use crate::printer::paper::Paper;
use crate::printer::serial::{self, SerialLink};
use crate::printer::session::Start;
use crate::printer::sim::{self, Options};
use crate::printer::{Error, driver, job::Job, paper};
use crate::profile::Profile;
use crate::progress::CancelToken;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::sync::{Mutex, OwnedMutexGuard, mpsc, oneshot};
use tokio_serial::SerialStream;

/// Events on their way.
const EVENT_QUEUE: usize = 256;

/// A printer, as it is spoken to. Clones are the same.
#[derive(Debug, Clone)]
pub(in crate::appliance) struct Machine {
    pub(super) profile: Arc<Profile>,
    /// As it was named.
    pub(super) profile_name: String,
    pub(super) port: Port,
    pub(super) baud: Option<u32>,
    /// This program, which the simulated printer is started with.
    pub(super) program: PathBuf,
    /// Whoever has this speaks to it.
    pub(super) turn: Arc<Mutex<()>>,
    /// Where it is kept that it may be hot; nowhere for the simulated one. Its thread has a clone: it sees to the heaters to its end.
    pub(super) heat: Option<HeatFile>,
}

/// What is done.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Work {
    /// A job from its beginning.
    Print(PathBuf),
    /// A job where it broke off; after a reset only where that is allowed.
    Resume { job: PathBuf, after_reset: bool },
    /// Lines that somebody has asked for.
    Commands(String),
}

impl Machine {
    /// What the port is called in messages.
    pub(super) fn port_name(&self) -> String {
        match &self.port {
            Port::Simulated { .. } => "sim".to_owned(),
            Port::Path(path) => paper::port_kept(path),
        }
    }

    /// Diameter of its filament, mm.
    pub(in crate::appliance) fn filament_mm(&self) -> f64 {
        self.profile.machine.filament_mm
    }

    /// Held by whoever speaks to it.
    pub(in crate::appliance) fn turn(&self) -> Arc<Mutex<()>> {
        Arc::clone(&self.turn)
    }

    /// Writes down whether it may be hot.
    pub(super) async fn tell_heat(&self, hot: Option<Hot>) {
        if let Some(heat) = &self.heat {
            heat.tell(hot).await;
        }
    }

    /// Waits until nobody else sees to its heaters.
    pub(super) async fn own_heat(&self) {
        if let Some(heat) = &self.heat {
            heat.own().await;
        }
    }

    /// Whether that was written down last.
    pub(super) fn may_be_hot(&self) -> bool {
        self.heat.as_ref().and_then(HeatFile::hot).is_some()
    }

    pub(super) const fn is_simulated(&self) -> bool {
        matches!(self.port, Port::Simulated { .. })
    }

    async fn work(
        &self,
        work: &Work,
        controls: &Controls,
        events: &mpsc::Sender<PrintEvent>,
        cancel: &CancelToken,
    ) -> Result<Printed, Error> {
        match (work, &self.port) {
            (Work::Commands(lines), _) => self.commands(lines, controls, events, cancel).await,
            (Work::Print(job) | Work::Resume { job, .. }, Port::Simulated { speed }) => {
                let options = self.options(job, speed);
                sim::print(job, &options, &self.profile, controls.clone(), events, cancel).await
            }
            (Work::Print(job), Port::Path(port)) => {
                // Whether the bed is free of its last print is the queue's to know.
                self.paper(job, port, controls).print(true, events, cancel).await
            }
            (Work::Resume { job, after_reset }, Port::Path(port)) => {
                self.paper(job, port, controls).resume(*after_reset, events, cancel).await
            }
        }
    }

    fn options(&self, job: &Path, speed: &str) -> Options {
        Options {
            program: self.program.clone(),
            leading_args: vec!["hil-sim".into()],
            machine: sim::Machine::of(&self.profile, &self.profile_name),
            record_dir: Some(job.with_file_name("record")),
            speed: Some(speed.to_owned()),
            ..Options::default()
        }
    }

    fn paper<'a>(&'a self, job: &'a Path, port: &'a str, controls: &'a Controls) -> Paper<'a> {
        let Self { profile, profile_name, baud, .. } = self;
        Paper { job, profile, profile_name, port, baud: *baud, controls }
    }

    async fn commands(
        &self,
        lines: &str,
        controls: &Controls,
        events: &mpsc::Sender<PrintEvent>,
        cancel: &CancelToken,
    ) -> Result<Printed, Error> {
        let link = self.open().await?;
        let job = Job::from_text(lines, "commands", &self.profile.firmware)?;
        let order = Order { job, start: Start::Fresh, journal: None, controls: controls.clone() };
        driver::run(order, link, &self.profile, events, cancel).await
    }

    /// The port; a board is not reset by it.
    pub(super) async fn open(&self) -> Result<SerialLink, Error> {
        let firmware = paper::undisturbed(&self.profile);
        serial::open(Path::new(self.path()), &firmware, self.baud).await
    }

    /// The same, open.
    pub(super) async fn stream(&self) -> Result<SerialStream, Error> {
        self.open().await?.open().await
    }

    fn path(&self) -> &str {
        match &self.port {
            Port::Simulated { .. } => "sim",
            Port::Path(path) => path,
        }
    }

    /// Whether there is anything at the port.
    pub(super) fn is_there(&self) -> bool {
        match &self.port {
            Port::Simulated { .. } => true,
            Port::Path(path) => crate::printer::device::Device::named(path).map_or_else(
                || Path::new(path).exists(),
                |device| crate::printer::device::path_of(&device).is_ok(),
            ),
        }
    }
}

/// A print under way. Dropped before its end, it is given up, and the heaters are switched off.
#[derive(Debug)]
pub(super) struct Press {
    pub(super) events: mpsc::Receiver<PrintEvent>,
    pub(super) controls: Controls,
    cancel: CancelToken,
    ended: Option<oneshot::Receiver<Result<Printed, Error>>>,
    leave: Option<oneshot::Sender<()>>,
}

/// How a print ended.
#[derive(Debug)]
pub(super) enum Ended {
    /// With this.
    With(Box<Result<Printed, Error>>),
    /// Its thread panicked.
    Panicked,
}

impl Press {
    /// Starts the thread, once nobody else speaks to the printer. With `holds`, nothing is laid before [`Controls::let_lay`].
    pub(super) async fn start(machine: &Machine, work: Work, holds: bool) -> std::io::Result<Self> {
        let turn = Arc::clone(&machine.turn).lock_owned().await;
        let (sender, events) = mpsc::channel(EVENT_QUEUE);
        let (ending, ended) = oneshot::channel();
        let (leave, left) = oneshot::channel();
        let (controls, cancel) = (Controls::default(), CancelToken::default());
        if holds {
            controls.hold_laying();
        }
        let running = Running {
            machine: machine.clone(),
            work,
            controls: controls.clone(),
            cancel: cancel.clone(),
            turn,
        };
        let run = move || running.run(sender, left, ending);
        std::thread::Builder::new().name("print".into()).spawn(run)?;
        Ok(Self { events, controls, cancel, ended: Some(ended), leave: Some(leave) })
    }

    /// Gives the print up: moves end, heaters off.
    pub(super) fn stop(&self) {
        self.cancel.cancel();
    }

    /// How it ended; to be asked once there are no more events.
    pub(super) async fn end(&mut self) -> Ended {
        let Some(ended) = self.ended.take() else { return Ended::Panicked };
        ended.await.map_or(Ended::Panicked, |result| Ended::With(Box::new(result)))
    }

    /// Leaves the printer as it is; the journal tells how to go on. Waits until the port is closed.
    pub(super) async fn leave(mut self) {
        if let (Some(leave), Some(ended)) = (self.leave.take(), self.ended.take()) {
            // Where the thread has ended by itself, there is nothing to leave.
            leave.send(()).ok();
            ended.await.ok();
        }
    }
}

impl Drop for Press {
    fn drop(&mut self) {
        if self.ended.is_some() {
            self.cancel.cancel();
        }
    }
}

struct Running {
    machine: Machine,
    work: Work,
    controls: Controls,
    cancel: CancelToken,
    turn: OwnedMutexGuard<()>,
}

impl Running {
    fn run(
        self,
        events: mpsc::Sender<PrintEvent>,
        left: oneshot::Receiver<()>,
        ending: oneshot::Sender<Result<Printed, Error>>,
    ) {
        let runtime = match tokio::runtime::Builder::new_current_thread().enable_all().build() {
            Ok(runtime) => runtime,
            Err(error) => {
                let problem = format!("cannot be spoken to: {error}");
                ending.send(Err(Error::Simulator { problem })).ok();
                return;
            }
        };
        let printed = runtime.block_on(async {
            let leaving = async {
                // Whoever is gone without a word has asked to stop.
                if left.await.is_err() {
                    std::future::pending::<()>().await;
                }
            };
            tokio::select! {
                printed = self.machine.work(&self.work, &self.controls, &events, &self.cancel) => Some(printed),
                () = leaving => None,
            }
        });
        drop(runtime);
        drop(self.turn);
        if let Some(printed) = printed {
            // Nobody waits for it where the server ends.
            ending.send(printed).ok();
        }
    }
}
