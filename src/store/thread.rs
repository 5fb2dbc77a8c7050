//! A database and the threads that have it: calls reach them over bounded channels, so that nothing that waits for a disk or a server
//! holds up the task that talks to a printer. One thread writes; another one reads over a connection of its own, so that whoever only
//! looks does not wait behind changes that cannot be made just now.

use super::sql::{self, Sql};
use super::{Claimed, Error, Place, Progress, Store, Which};
use crate::queue::{
    Actor, By, Claim, Claimant, Head, Job, JobId, Name, Printer, Reason, Refusal, Request, Said, Sealed,
    Spec, Subject, Ticket,
};
use jiff::Timestamp;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use tokio::sync::{mpsc, oneshot};

/// Calls that may wait for a thread.
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

/// One thread and its connection.
#[derive(Debug)]
struct Hand<D>(mpsc::Sender<Message<D>>);

impl<D> Clone for Hand<D> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<D: Database> Hand<D> {
    /// Starts the thread, which makes the connection and keeps it; waits until it has, and gives what `opened` makes of it. `place`: as
    /// errors name it.
    fn start<T: Send + 'static>(
        name: &str,
        place: &Path,
        open: impl FnOnce() -> Result<D, Error> + Send + 'static,
        opened: impl FnOnce(&D) -> T + Send + 'static,
    ) -> Result<(Self, T), Error> {
        let (messages, inbox) = mpsc::channel(MOST_WAITING);
        let (tell, told) = std::sync::mpsc::channel();
        let work = move || match open() {
            Ok(db) => {
                tell.send(Ok(opened(&db))).ok();
                serve(db, inbox);
            }
            Err(error) => drop(tell.send(Err(error))),
        };
        let failed = |e: std::io::Error| Error::Io { path: place.to_owned(), problem: e.to_string() };
        std::thread::Builder::new().name(name.into()).spawn(work).map_err(failed)?;
        let made = told.recv().map_err(|_panicked| Error::Gone)??;
        Ok((Self(messages), made))
    }

    async fn close(self) {
        let (done, closed) = oneshot::channel();
        if self.0.send(Message::Close(done)).await.is_ok() {
            // Where the thread is gone already, the connection is closed, too.
            closed.await.ok();
        }
    }

    async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut D) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        let (answer, answered) = oneshot::channel();
        let work: Work<D> = Box::new(move |db| {
            // What panics is rolled back, and the queue lives on: prints are attended by whoever else asks it.
            let done = catch_unwind(AssertUnwindSafe(|| work(db))).unwrap_or(Err(Error::Panicked));
            // Whoever asked may have left: what was done is done.
            drop(answer.send(done));
        });
        self.0.send(Message::Work(work)).await.map_err(|_closed| Error::Gone)?;
        answered.await.map_err(|_ended| Error::Gone)?
    }
}

/// A queue in a database. Clones are the same; the connections are closed when the last one is dropped.
#[derive(Debug)]
pub struct OnThread<D> {
    writer: Hand<D>,
    reader: Hand<D>,
}

impl<D> Clone for OnThread<D> {
    fn clone(&self) -> Self {
        Self { writer: self.writer.clone(), reader: self.reader.clone() }
    }
}

impl<D: Database> OnThread<D> {
    /// Starts the threads, which make the connections and keep them; waits until they have. `place`: as errors name it.
    pub(super) fn start(
        place: &Path,
        open: impl FnOnce() -> Result<D, Error> + Send + 'static,
    ) -> Result<Self, Error> {
        let (writer, again) = Hand::start("queue", place, open, D::again)?;
        let (reader, ()) = Hand::start("queue-read", place, again, |_db| ())?;
        Ok(Self { writer, reader })
    }

    /// Ends the threads once everything that was asked for is done, and closes the connections. Other clones are refused from then on.
    pub async fn close(self) {
        // The writer last: of SQLite it is the one that may clear up behind itself.
        self.reader.close().await;
        self.writer.close().await;
    }

    /// Does something on the thread that writes.
    pub(super) async fn on_thread<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut D) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        self.writer.run(work).await
    }

    /// Does something on the thread that reads.
    pub(super) async fn on_reader<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut D) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        self.reader.run(work).await
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
        self.on_reader(|db| db.read(look)).await
    }

    /// Reads over a connection of its own, so that it may take long.
    async fn apart<T: Send + 'static>(
        &self,
        look: impl FnOnce(&mut D) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        let open = self.on_reader(|db| Ok(db.again())).await?;
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
