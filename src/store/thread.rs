//! A database and the thread that has it: calls reach it over a bounded channel, so that nothing that waits for a disk or a server holds
//! up the task that talks to a printer.

use super::sql::{self, Sql};
use super::{Claimed, Error, Place, Progress, Store, Which};
use crate::queue::{
    Actor, By, Claim, Claimant, Head, Job, JobId, Name, Printer, Reason, Refusal, Request, Said, Sealed,
    Spec, Subject, Ticket,
};
use jiff::Timestamp;
use std::path::Path;
use tokio::sync::{mpsc, oneshot};

/// Calls that may wait for the thread.
const MOST_WAITING: usize = 64;

/// How another connection is made.
pub(super) type Again<D> = Box<dyn FnOnce() -> Result<D, Error> + Send>;

/// A connection that does one thing after the other.
pub trait Database: Send + Sized + 'static {
    /// Looks at one moment of the database.
    ///
    /// # Errors
    /// [`Error`]; what was looked for is not there, or cannot be read.
    fn read<T>(&mut self, look: impl FnOnce(&dyn Sql) -> Result<T, sql::Error>) -> Result<T, Error>;

    /// Does something as a whole or not at all, while nobody else writes; it is kept whatever happens when this returns.
    ///
    /// # Errors
    /// [`Error`]; nothing is changed then.
    fn write<T>(&mut self, work: impl FnOnce(&dyn Sql) -> Result<T, sql::Error>) -> Result<T, Error>;

    /// How another connection is made that only reads.
    fn again(&self) -> Again<Self>;

    /// That what the history is kept in is sound, as far as the database itself can tell.
    ///
    /// # Errors
    /// [`Error::Damaged`].
    fn check_sound(&mut self) -> Result<(), Error>;
}

type Work<D> = Box<dyn FnOnce(&mut D) + Send>;

/// What the thread is told.
enum Message<D> {
    Work(Work<D>),
    Close(oneshot::Sender<()>),
}

/// A queue in a database. Clones are the same; the connection is closed when the last one is dropped.
#[derive(Debug)]
pub struct OnThread<D> {
    messages: mpsc::Sender<Message<D>>,
}

impl<D> Clone for OnThread<D> {
    fn clone(&self) -> Self {
        Self { messages: self.messages.clone() }
    }
}

impl<D: Database> OnThread<D> {
    /// Starts the thread, which makes the connection and keeps it; waits until it has. `place`: as errors name it.
    pub(super) fn start(
        place: &Path,
        open: impl FnOnce() -> Result<D, Error> + Send + 'static,
    ) -> Result<Self, Error> {
        let (messages, inbox) = mpsc::channel(MOST_WAITING);
        let (told, opened) = std::sync::mpsc::channel();
        let work = move || match open() {
            Ok(db) => {
                told.send(Ok(())).ok();
                serve(db, inbox);
            }
            Err(error) => drop(told.send(Err(error))),
        };
        let failed = |e: std::io::Error| Error::Io { path: place.to_owned(), problem: e.to_string() };
        std::thread::Builder::new().name("queue".into()).spawn(work).map_err(failed)?;
        opened.recv().map_err(|_panicked| Error::Gone)??;
        Ok(Self { messages })
    }

    /// Ends the thread once everything that was asked for is done, and closes the connection. Other clones are refused from then on.
    pub async fn close(self) {
        let (done, closed) = oneshot::channel();
        if self.messages.send(Message::Close(done)).await.is_ok() {
            // Where the thread is gone already, the connection is closed, too.
            closed.await.ok();
        }
    }

    /// Does something on the thread.
    pub(super) async fn on_thread<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut D) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        let (answer, answered) = oneshot::channel();
        // Whoever asked may have left: what was done is done.
        let work: Work<D> = Box::new(move |db| drop(answer.send(work(db))));
        self.messages.send(Message::Work(work)).await.map_err(|_closed| Error::Gone)?;
        answered.await.map_err(|_ended| Error::Gone)?
    }

    async fn write<T: Send + 'static>(
        &self,
        work: impl FnOnce(&dyn Sql) -> Result<T, sql::Error> + Send + 'static,
    ) -> Result<T, Error> {
        self.on_thread(|db| db.write(work)).await
    }

    async fn read<T: Send + 'static>(
        &self,
        look: impl FnOnce(&dyn Sql) -> Result<T, sql::Error> + Send + 'static,
    ) -> Result<T, Error> {
        self.on_thread(|db| db.read(look)).await
    }

    /// Reads over a connection of its own, so that it may take long.
    async fn apart<T: Send + 'static>(
        &self,
        look: impl FnOnce(&mut D) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        let open = self.on_thread(|db| Ok(db.again())).await?;
        let (answer, answered) = oneshot::channel();
        let looked = move || drop(answer.send(open().and_then(|mut db| look(&mut db))));
        std::thread::Builder::new().name("queue-check".into()).spawn(looked).map_err(|_none| Error::Gone)?;
        answered.await.map_err(|_panicked| Error::Gone)?
    }
}

/// The thread: one thing after the other, until nobody is left who could ask.
fn serve<D: Database>(mut db: D, mut inbox: mpsc::Receiver<Message<D>>) {
    while let Some(message) = inbox.blocking_recv() {
        match message {
            Message::Work(work) => work(&mut db),
            Message::Close(done) => {
                drop(db);
                done.send(()).ok();
                return;
            }
        }
    }
}

impl<D: Database> Store for OnThread<D> {
    async fn add(&self, ticket: Ticket, is_submitted: bool, by: By) -> Result<Job, Error> {
        self.write(move |db| sql::add(db, &ticket, is_submitted, &at_its_time(db, by)?)).await
    }

    async fn add_all(&self, tickets: Vec<Ticket>, is_submitted: bool, by: By) -> Result<Vec<Job>, Error> {
        self.write(move |db| {
            let by = at_its_time(db, by)?;
            tickets.iter().map(|ticket| sql::add(db, ticket, is_submitted, &by)).collect()
        })
        .await
    }

    async fn change(&self, job: JobId, request: Request) -> Result<Job, Error> {
        self.write(move |db| {
            let now = db.now(request.now)?;
            sql::change(db, job, &Request { now, ..request })
        })
        .await
    }

    async fn place(
        &self,
        job: JobId,
        place: Place,
        actor: Actor,
        why: Reason,
        now: Timestamp,
    ) -> Result<Job, Error> {
        self.write(move |db| sql::place(db, job, place, actor, why, db.now(now)?)).await
    }

    async fn claim(&self, claimant: Claimant, now: Timestamp) -> Result<Option<Claimed>, Error> {
        self.write(move |db| sql::take(db, &claimant, db.now(now)?)).await
    }

    async fn renew(&self, claim: Claim, now: Timestamp) -> Result<Claim, Error> {
        self.write(move |db| sql::renew(db, &claim, db.now(now)?)).await
    }

    async fn adopt(&self, holder: Name, now: Timestamp) -> Result<Vec<Claimed>, Error> {
        self.write(move |db| sql::adopt(db, &holder, db.now(now)?)).await
    }

    async fn sweep(&self, now: Timestamp) -> Result<Vec<Job>, Error> {
        self.write(move |db| sql::sweep(db, db.now(now)?)).await
    }

    async fn say(&self, printer: Name, said: Said, by: By) -> Result<Printer, Error> {
        self.write(move |db| sql::say(db, &printer, &said, &at_its_time(db, by)?)).await
    }

    async fn printers(&self) -> Result<Vec<Printer>, Error> {
        self.read(|db| sql::printers(db)).await
    }

    async fn job(&self, id: JobId) -> Result<(Job, Option<Claim>), Error> {
        self.read(move |db| Ok((sql::job(db, id)?, sql::claim(db, id)?))).await
    }

    async fn list(&self, which: Which, behind: Option<JobId>, most: u32) -> Result<Vec<Job>, Error> {
        self.read(move |db| sql::list(db, which, behind, most)).await
    }

    async fn spec(&self, id: JobId) -> Result<Spec, Error> {
        self.read(move |db| Ok(sql::spec(db, id)?.ok_or(Refusal::NoJob { id })?)).await
    }

    async fn history(&self, of: Option<Subject>, after: u64, most: u32) -> Result<Vec<Sealed>, Error> {
        self.read(move |db| sql::history(db, of.as_ref(), after, most)).await
    }

    async fn head(&self) -> Result<Head, Error> {
        self.read(|db| sql::head(db)).await
    }

    async fn verify(&self) -> Result<(), Error> {
        self.apart(|db| {
            db.check_sound()?;
            let mut next = Some(Progress::default());
            while let Some(from) = next {
                next = db.read(|tx| sql::part(tx, from))?;
            }
            Ok(())
        })
        .await
    }

    async fn verify_part(&self, from: Progress) -> Result<Option<Progress>, Error> {
        self.apart(|db| db.read(|tx| sql::part(tx, from))).await
    }
}

/// When it is said, by the database's clock where that counts.
fn at_its_time(db: &dyn Sql, by: By) -> Result<By, sql::Error> {
    Ok(By { now: db.now(by.now)?, ..by })
}
