//! The server as a whole: its parts, what becomes of one that ends, the end of all.

use super::Error;
use super::config::{Config, OnStop, PrinterConfig};
use super::kit::{Kit, ended};
use super::live::Lives;
use super::notify::News;
use super::place::{BootClock, Place};
use super::preparing::Worker;
use super::printing::{self, Identities, Kept, Memory, Station};
use super::system::System;
use super::watch;
use crate::http::appliance::{PrinterDesk, Unheard, Wished};
use crate::http::files::{Files, Limits};
use crate::http::keys::Keys;
use crate::http::serve::Listeners;
use crate::http::{self, Appliance, Edge, Listen, Printers};
use crate::queue::Name;
use crate::store::{self, Sqlite, Store};
use jiff::Timestamp;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Mutex, mpsc, watch as channel};
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep};

/// Wishes that may wait for one printer.
const MOST_WISHES: usize = 16;
/// How often holders that are not heard of are looked for, and the directory is touched.
const SWEEP: Duration = Duration::from_secs(15);
/// A part that ended is started again after so long, longer each time; one that lived so long starts from the beginning.
const REST: [Duration; 2] = [Duration::from_millis(200), Duration::from_secs(30)];
const LONG_LIFE: Duration = Duration::from_secs(60);
/// How long the end waits for a print that is given up, and for the webhook.
const LAST_PRINT: Duration = Duration::from_secs(120);
const LAST_NEWS: Duration = Duration::from_secs(5);
/// So often in a row; then the server ends, and whoever started it starts it anew: a few times, see `StartLimitBurst=` of the unit.
const MOST_RESTARTS: u32 = 10;

/// What a server is started with.
#[derive(Debug)]
pub struct Setup {
    /// Its state directory.
    pub place: Place,
    /// What the operator decides.
    pub config: Config,
    /// This program, for the simulated printer and for preparation.
    pub program: PathBuf,
    /// The clock.
    pub clock: fn() -> Timestamp,
    /// What tells how long nobody watched.
    pub boot_clock: BootClock,
}

/// Serves until it is asked to stop; a second wish may be stricter than the first.
///
/// # Errors
/// [`Error`]: it could not be started, or a part of it ended too often.
pub async fn serve(setup: Setup, stopping: channel::Receiver<Option<OnStop>>) -> Result<(), Error> {
    let Setup { place, config, program, clock, boot_clock } = setup;
    let layout = Arc::new(place.layout().clone());
    let machines: Result<Vec<_>, _> =
        config.printers.iter().map(|p| printing::machine(p, &program, &layout)).collect();
    let machines = machines?;
    let limits = Limits { max_bytes: config.http.max_upload_bytes, ..Limits::default() };
    let failed = |path: PathBuf| move |source| Error::Io { path, source };
    let files = Files::open(&layout.files(), limits).map_err(failed(layout.files()))?;
    let keys = Keys::open(&layout.keys())?;
    let queue = layout.queue();
    let store = tokio::task::spawn_blocking(move || Sqlite::open(&queue)).await;
    let store = store.map_err(|panicked| Error::Runtime(std::io::Error::other(panicked)))??;
    let (printers, PrinterDesk { lives, wishes }) = Printers::channel();
    let mut app = Appliance::new(store.clone(), printers, files.clone(), keys);
    app.clock = clock;
    let listen = Listen { socket: Some(layout.socket()), tcp: addresses(&config, &app.keys) };
    let listeners = Listeners::bind(&listen, &app.keys).await?;
    let (news, postman) = News::new(clock, config.webhook.clone());
    let kit = Kit {
        store: store.clone(),
        identities: Identities::open(layout.printers()),
        layout,
        clock,
        boot_clock,
        program,
        stopping,
        events: app.events.clone(),
        counters: app.counters.clone(),
        news,
    };
    let mut parts = Parts { kit: kit.clone(), lives: Arc::new(lives), files, works: JoinSet::new() };
    let turns: Vec<_> = machines.iter().map(printing::Machine::turn).collect();
    // Before anybody can ask for them.
    parts.begin(&config, machines, wishes, place.watched_at(&parts.kit.boot_clock)).await?;
    let postman = postman.map(|postman| tokio::spawn(postman.run()));
    let (end_faces, faces_end) = tokio::sync::oneshot::channel::<()>();
    let faces = tokio::spawn(http::serve(listeners, app, Edge::default(), async {
        // Dropped or sent: the faces end.
        faces_end.await.ok();
    }));
    let served = parts.watch_over(&place).await;
    drop(parts);
    // A print whose part has ended is being given up: its heaters go off first.
    for turn in turns {
        tokio::time::timeout(LAST_PRINT, turn.lock()).await.ok();
    }
    end_faces.send(()).ok();
    if let Err(panicked) = faces.await {
        tracing::error!("server: {panicked}");
    }
    // The last clone of the news goes with the kit; then the webhook has all there is.
    drop(kit);
    if let Some(postman) = postman {
        tokio::time::timeout(LAST_NEWS, postman).await.ok();
    }
    store.close().await;
    served
}

/// Without keys nobody could be let in; they are made over the socket.
fn addresses(config: &Config, keys: &Keys) -> Vec<SocketAddr> {
    if keys.is_empty() && !config.http.tcp.is_empty() {
        tracing::warn!(
            "server: TCP is not served: there are no keys; make one (POST /api/v1/keys on the socket) and start again"
        );
        return Vec::new();
    }
    config.http.tcp.clone()
}

struct Parts {
    kit: Kit<Sqlite>,
    lives: Lives,
    files: Files,
    works: JoinSet<Result<(), Error>>,
}

impl Parts {
    /// Makes the printers known, then starts everything.
    async fn begin(
        &mut self,
        config: &Config,
        machines: Vec<printing::Machine>,
        wishes: mpsc::Receiver<Wished>,
        watched: Option<Duration>,
    ) -> Result<(), Error> {
        let (mut desks, mut free) = (BTreeMap::new(), Vec::new());
        let filament_mm = machines.first().map_or(1.75, printing::Machine::filament_mm);
        for (printer, machine) in config.printers.iter().zip(machines) {
            let (desk, wishes) = mpsc::channel(MOST_WISHES);
            desks.insert(printer.name.clone(), desk);
            let berth = Berth {
                config: Arc::new(printer.clone()),
                machine,
                kit: self.kit.clone(),
                lives: Arc::clone(&self.lives),
                kept: Kept {
                    wishes: Arc::new(Mutex::new(wishes)),
                    memory: Arc::new(Mutex::new(Memory::of(watched))),
                },
            };
            // What may be hot does not wait for anything that is written for others.
            match berth.station().await.in_hand().await? {
                Some(_) => self.printer(berth),
                None => free.push(berth),
            }
        }
        for berth in free {
            if let Err(error) = berth.station().await.introduce().await {
                tracing::error!(printer = %berth.config.name, "queue: {error}; it is tried again");
            }
            self.printer(berth);
        }
        self.workers(config, filament_mm);
        if let Some(watch) = config.watch.clone() {
            let kit = self.kit.clone();
            self.works.spawn(async move {
                watch::run(watch, kit).await;
                Ok(())
            });
        }
        tokio::spawn(pass_on(wishes, desks));
        Ok(())
    }

    fn printer(&mut self, berth: Berth) {
        let guarded =
            Guarded { part: "a printer's part", kit: self.kit.clone(), patience: Patience::default() };
        self.works.spawn(guarded.run(move || {
            let berth = berth.clone();
            async move { berth.station().await.run().await }
        }));
    }

    fn workers(&mut self, config: &Config, filament_mm: f64) {
        for number in 1..=config.prepare.workers {
            let name = Name::try_new(&format!("worker {number}")).expect("a name that is written here");
            let profile = config
                .printers
                .first()
                .map_or_else(|| "marlin".to_owned(), |printer| printer.profile.clone());
            let (kit, files, prepare) = (self.kit.clone(), self.files.clone(), config.prepare);
            let guarded = Guarded { part: "a worker", kit: kit.clone(), patience: Patience::default() };
            let start = move || {
                let (name, profile) = (name.clone(), profile.clone());
                let worker =
                    Worker { name, kit: kit.clone(), files: files.clone(), prepare, profile, filament_mm };
                async move { worker.run().await }
            };
            self.works.spawn(guarded.run(start));
        }
    }

    /// Until all parts have ended by themselves, or one for good.
    async fn watch_over(&mut self, place: &Place) -> Result<(), Error> {
        let system = System::default();
        let mut sweep = tokio::time::interval(SWEEP);
        let mut watchdog = tokio::time::interval(system.watchdog_interval());
        let mut stopping = self.kit.stopping.clone();
        let mut is_stopping = false;
        system.ready();
        tracing::info!("server: ready");
        loop {
            tokio::select! {
                part = self.works.join_next() => match part {
                    None => return Ok(()),
                    Some(Ok(Ok(()))) => {}
                    // Whoever started this server starts it anew: what prints is taken up then.
                    Some(Ok(Err(error))) => return Err(error),
                    Some(Err(panicked)) => {
                        tracing::error!("server: {panicked}");
                        return Err(Error::GaveUp { part: "a part" });
                    }
                },
                _ = sweep.tick() => self.sweep(place).await,
                // The queue answers, and so does this loop.
                _ = watchdog.tick() => if self.kit.store.head().await.is_ok() {
                    system.alive(&self.status());
                },
                () = ended(&mut stopping), if !is_stopping => {
                    is_stopping = true;
                    system.stopping();
                }
            }
        }
    }

    async fn sweep(&self, place: &Place) {
        if let Err(error) = place.touch(&self.kit.boot_clock) {
            tracing::warn!("server: {error}");
        }
        match self.kit.store.sweep(self.kit.now()).await {
            Ok(lost) => {
                for job in lost {
                    self.kit.news.tell(
                        "holder-lost",
                        job.holder.as_ref(),
                        Some(job.id),
                        "its holder was not heard of any more",
                    );
                }
            }
            Err(error) => tracing::warn!("queue: {error}"),
        }
    }

    /// One line for the service manager.
    fn status(&self) -> String {
        let lives = self.lives.borrow();
        let words = lives.iter().map(|live| match live.done {
            Some(done) => format!("{}: {:.0} %", live.name, 100.0 * done),
            None => format!("{}: {:?}", live.name, live.activity).to_lowercase(),
        });
        words.collect::<Vec<_>>().join(", ")
    }
}

/// What a printer's part is started with, as often as it has to be.
#[derive(Clone)]
struct Berth {
    config: Arc<PrinterConfig>,
    machine: printing::Machine,
    kit: Kit<Sqlite>,
    lives: Lives,
    kept: Kept,
}

impl Berth {
    async fn station(&self) -> Station<Sqlite> {
        let Self { config, machine, kit, lives, kept } = self.clone();
        Station::new(config, machine, kit, lives, kept).await
    }
}

/// A part that is started again when it fails.
struct Guarded {
    part: &'static str,
    kit: Kit<Sqlite>,
    patience: Patience,
}

/// How long a part that fails rests before it is started again, and how often it is.
#[derive(Debug, Clone, Copy)]
struct Patience {
    rest: Duration,
    n_left: u32,
}

impl Default for Patience {
    fn default() -> Self {
        let [rest, _] = REST;
        Self { rest, n_left: MOST_RESTARTS }
    }
}

impl Patience {
    /// How long a part rests that lived so long; `None`: it is given up.
    fn rest_after(&mut self, lived: Duration) -> Option<Duration> {
        if lived > LONG_LIFE {
            *self = Self::default();
        }
        self.n_left = self.n_left.checked_sub(1)?;
        let [_, longest] = REST;
        let rest = self.rest;
        self.rest = (2 * rest).min(longest);
        Some(rest)
    }
}

impl Guarded {
    async fn run<F>(mut self, mut start: impl FnMut() -> F + Send) -> Result<(), Error>
    where
        F: Future<Output = Result<(), store::Error>> + Send + 'static,
    {
        loop {
            let began = Instant::now();
            // A task of its own: a panic ends it alone.
            let mut part = AbortOnDrop(tokio::spawn(start()));
            match (&mut part.0).await {
                Ok(Ok(())) => return Ok(()),
                Ok(Err(error @ store::Error::Gone)) => return Err(error.into()),
                Ok(Err(error)) => tracing::error!("server: {} ended: {error}", self.part),
                Err(panicked) => tracing::error!("server: {} ended: {panicked}", self.part),
            }
            self.kit.counters.count_restart();
            let gave_up = Error::GaveUp { part: self.part };
            let rest = self.patience.rest_after(began.elapsed()).ok_or(gave_up)?;
            let mut stopping = self.kit.stopping.clone();
            tokio::select! {
                () = sleep(rest) => {}
                () = ended(&mut stopping) => return Ok(()),
            }
        }
    }
}

/// A task that ends with whoever waits for it.
struct AbortOnDrop(tokio::task::JoinHandle<Result<(), store::Error>>);

impl Drop for AbortOnDrop {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// Gives each wish to its printer.
async fn pass_on(mut wishes: mpsc::Receiver<Wished>, desks: BTreeMap<Name, mpsc::Sender<Wished>>) {
    while let Some(wished) = wishes.recv().await {
        let Some(desk) = desks.get(&wished.printer) else {
            let printer = wished.printer.clone();
            wished.answer.send(Err(Unheard::NoPrinter { printer })).ok();
            continue;
        };
        if let Err(mpsc::error::TrySendError::Full(wished) | mpsc::error::TrySendError::Closed(wished)) =
            desk.try_send(wished)
        {
            wished.answer.send(Err(Unheard::NoAnswer)).ok();
        }
    }
}

#[cfg(test)]
mod tests;
