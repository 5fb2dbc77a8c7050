//! The server as a whole: its parts, and the end of all.

use super::Error;
use super::config::{Config, OnStop, PrinterConfig};
use super::keeping::Keeper;
use super::kit::{Kit, ended, on_disk};
use super::live::Lives;
use super::notify::{News, Postman};
use super::place::{BootClock, Place};
use super::preparing::Worker;
use super::printing::{self, Identities, Kept, Memory, Station};
use super::system::System;
use super::watch;
use super::watchman::{self, Guarded, Watchman};
use crate::http::appliance::{PrinterDesk, Unheard, Wished};
use crate::http::cases::{self, Cases};
use crate::http::files::{Files, Limits};
use crate::http::keys::Keys;
use crate::http::serve::Listeners;
use crate::http::{self, Appliance, Edge, Listen, Printers};
use crate::queue::Name;
use crate::store::{Sqlite, Store};
use jiff::Timestamp;
use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Mutex, mpsc, watch as channel};
use tokio::time::interval;

/// Wishes that may wait for one printer.
const MOST_WISHES: usize = 16;
/// How often holders that are not heard of are looked for, and the directory is touched.
const SWEEP: Duration = Duration::from_secs(15);
/// How long the end waits for a print that is given up, and for faces and webhook.
const LAST_PRINT: Duration = Duration::from_secs(120);
const LAST_NEWS: Duration = Duration::from_secs(15);

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
/// [`Error`]: it could not be started, or a part of it ended too often; its prints have ended as `on_stop` says then.
pub async fn serve(setup: Setup, asked: channel::Receiver<Option<OnStop>>) -> Result<(), Error> {
    let Setup { place, config, program, clock, boot_clock } = setup;
    let layout = Arc::new(place.layout().clone());
    let machines: Result<Vec<_>, _> =
        config.printers.iter().map(|p| printing::machine(p, &program, &layout)).collect();
    let machines = machines?;
    let (max_bytes, reserve_bytes) = (config.http.max_upload_bytes, config.disk.reserve_bytes);
    let limits = Limits { max_bytes, reserve_bytes, ..Limits::default() };
    let failed = |path: PathBuf| move |source| Error::Io { path, source };
    let files = Files::open(&layout.files(), limits).map_err(failed(layout.files()))?;
    let keys = Keys::open(&layout.keys())?;
    let queue = layout.queue();
    let store = tokio::task::spawn_blocking(move || Sqlite::open(&queue)).await;
    let store = store.map_err(|panicked| Error::Runtime(io::Error::other(panicked)))??;
    let (printers, PrinterDesk { lives, wishes }) = Printers::channel();
    let mut app = Appliance::new(store.clone(), printers, files.clone(), keys);
    app.clock = clock;
    let (threads, nice) = (config.prepare.threads, config.prepare.nice);
    let of_cases = cases::Setup {
        ct_folders: config.ct_folders.clone(),
        state: layout.dir().to_owned(),
        program: program.clone(),
        threads,
        nice,
    };
    let cases = Cases::open(of_cases, app.events.clone()).map_err(failed(layout.dir().to_owned()))?;
    app.cases = Some(cases);
    let listen = Listen { socket: Some(layout.socket()), tcp: addresses(&config, &app.keys) };
    let listeners = Listeners::bind(&listen, &app.keys).await?;
    let (news, postman) = News::new(clock, config.webhook.clone());
    let (end, stopping) = channel::channel(None);
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
    let lives = Arc::new(lives);
    let turns: Vec<_> = machines.iter().map(printing::Machine::turn).collect();
    let mut parts =
        Parts { kit: kit.clone(), lives: Arc::clone(&lives), files, works: watchman::Parts::new() };
    // Before anybody can ask for them.
    parts.begin(&config, machines, wishes, place.watched_at(&kit.boot_clock)).await?;
    let (over, is_over) = channel::channel(None);
    let mut servants = Servants { kit, is_over, servants: watchman::Parts::new() };
    servants.faces(app, listen, listeners);
    servants.sweeper(place);
    servants.postman(postman);
    let Servants { kit, servants, .. } = servants;
    let Parts { works, .. } = parts;
    let on_stop = config.on_stop;
    let mut watchman = Watchman { system: System::default(), works, servants, asked, end, on_stop };
    let served = watchman.run(|| status(&lives)).await;
    // A print whose part has ended is being given up: its heaters go off first.
    for turn in turns {
        tokio::time::timeout(LAST_PRINT, turn.lock()).await.ok();
    }
    over.send_replace(Some(on_stop));
    // The last clone of the news goes with the kit; then the webhook has all there is.
    drop(kit);
    let all_ended = async { while watchman.servants.join_next().await.is_some() {} };
    tokio::time::timeout(LAST_NEWS, all_ended).await.ok();
    store.close().await;
    served
}

/// One line for the service manager.
fn status(lives: &Lives) -> String {
    let lives = lives.borrow();
    let words = lives.iter().map(|live| match live.done {
        Some(done) => format!("{}: {:.0} %", live.name, 100.0 * done),
        None => format!("{}: {:?}", live.name, live.activity).to_lowercase(),
    });
    words.collect::<Vec<_>>().join(", ")
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
    works: watchman::Parts,
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
            let start = move || watch::run(watch.clone(), kit.clone());
            self.works.spawn(self.guarded("the watch folder").run(start));
        }
        let keeper = Arc::new(Keeper { kit: self.kit.clone(), files: self.files.clone(), disk: config.disk });
        self.works.spawn(self.guarded("what tidies the disk").run(move || {
            let keeper = Arc::clone(&keeper);
            async move { keeper.run().await }
        }));
        tokio::spawn(pass_on(wishes, desks));
        Ok(())
    }

    fn guarded(&self, part: &'static str) -> Guarded {
        Guarded::new(part, self.kit.counters.clone(), self.kit.stopping.clone())
    }

    fn printer(&mut self, berth: Berth) {
        self.works.spawn(self.guarded("a printer's part").run(move || {
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
            let guarded = self.guarded("a worker");
            let start = move || {
                let (name, profile) = (name.clone(), profile.clone());
                let worker =
                    Worker { name, kit: kit.clone(), files: files.clone(), prepare, profile, filament_mm };
                async move { worker.run().await }
            };
            self.works.spawn(guarded.run(start));
        }
    }
}

/// What is there until all prints have ended, and everything else.
struct Servants {
    kit: Kit<Sqlite>,
    is_over: watchman::End,
    servants: watchman::Parts,
}

impl Servants {
    fn guarded(&self, part: &'static str) -> Guarded {
        Guarded::new(part, self.kit.counters.clone(), self.is_over.clone())
    }

    /// The faces, on what is open already; started again, they open it anew.
    fn faces(&mut self, app: Appliance<Sqlite>, listen: Listen, listeners: Listeners) {
        let (mut first, is_over) = (Some(listeners), self.is_over.clone());
        let start = move || {
            let (app, listen, mut is_over) = (app.clone(), listen.clone(), is_over.clone());
            let listeners = first.take();
            async move {
                let listeners = match listeners {
                    Some(listeners) => listeners,
                    None => Listeners::bind(&listen, &app.keys).await?,
                };
                http::serve(listeners, app, Edge::default(), async { ended(&mut is_over).await }).await?;
                Ok::<_, Error>(())
            }
        };
        self.servants.spawn(self.guarded("the API").run(start));
    }

    /// What says that this server lives, and looks for holders that do not.
    fn sweeper(&mut self, place: Place) {
        let (kit, place, is_over) = (self.kit.clone(), Arc::new(place), self.is_over.clone());
        let start = move || {
            let sweeper = Sweeper { kit: kit.clone(), place: Arc::clone(&place), is_written: true };
            sweeper.run(is_over.clone())
        };
        self.servants.spawn(self.guarded("what looks for lost holders").run(start));
    }

    fn postman(&mut self, postman: Option<Postman>) {
        if let Some(postman) = postman {
            let postman = Arc::new(postman);
            self.servants.spawn(self.guarded("the webhook").run(move || {
                let postman = Arc::clone(&postman);
                async move {
                    postman.run().await;
                    Ok::<_, Error>(())
                }
            }));
        }
    }
}

/// See [`Servants::sweeper`].
struct Sweeper {
    kit: Kit<Sqlite>,
    place: Arc<Place>,
    /// Whether the queue could be written the last time.
    is_written: bool,
}

impl Sweeper {
    async fn run(mut self, mut is_over: watchman::End) -> Result<(), Error> {
        let mut sweep = interval(SWEEP);
        loop {
            tokio::select! {
                _ = sweep.tick() => self.sweep().await,
                () = ended(&mut is_over) => return Ok(()),
            }
        }
    }

    async fn sweep(&mut self) {
        let (place, clock) = (Arc::clone(&self.place), self.kit.boot_clock.clone());
        if let Err(error) = on_disk(move || place.touch(&clock).map_err(io::Error::other)).await {
            tracing::warn!("server: {error}");
        }
        let swept = self.kit.store.sweep(self.kit.now()).await;
        let was_written = std::mem::replace(&mut self.is_written, swept.is_ok());
        match swept {
            Ok(lost) => {
                if !was_written {
                    self.kit.news.tell("queue-written", None, None, "the queue can be written again");
                }
                for job in lost {
                    let why = "its holder was not heard of any more";
                    self.kit.news.tell("holder-lost", job.holder.as_ref(), Some(job.id), why);
                }
            }
            Err(error) => {
                tracing::warn!("queue: {error}");
                if was_written {
                    // Its words name the database's path.
                    let text = format!("the queue cannot be written ({}): look into the log", error.code());
                    self.kit.news.tell("queue-not-written", None, None, &text);
                }
            }
        }
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
