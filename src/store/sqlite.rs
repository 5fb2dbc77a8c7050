//! The queue in one SQLite file: nothing to set up, safe against whatever ends the program.
//!
//! A thread of its own has the connection; calls reach it over a bounded channel, so that nothing that waits for a disk holds up
//! the task that talks to a printer. Write-ahead log, flushed at every commit: what a call has answered survives a power cut. Other
//! processes may use the same file (`lumenfab work`, backups); whoever writes waits for the others, five seconds at most.
//!
//! Cost: one transaction a change. Taking, listing and changing jobs goes by indices, so that none depends on the length of
//! the queue or on how much is over; only jobs that need more filament than the spool has are passed over one by one, within the index.
//! Opening checks the end of the history and, in a file of up to 8 MiB, all pages; [`Store::verify`] reads everything however
//! much it is, over a connection of its own that holds up nobody: pages and indices in one go, then records and rows some thousand
//! at a time, each time at another moment of the file, so that the log can be taken in between. A face asks for it from time to time.

mod open;
#[cfg(test)]
mod tests;
mod tx;

use super::{Claimed, Error, Place, Progress, Store, Which, sql};
use crate::queue::{
    Actor, By, Claim, Claimant, Head, Job, JobId, Name, Printer, Reason, Refusal, Request, Said, Sealed,
    Spec, Subject, Ticket,
};
use jiff::Timestamp;
use open::Db;
use std::path::{Path, PathBuf};
use tokio::sync::{mpsc, oneshot};
use tx::Tx;

/// Calls that may wait for the thread.
const MOST_WAITING: usize = 64;

type Work = Box<dyn FnOnce(&mut Db) + Send>;

/// What the thread is told.
enum Message {
    Work(Work),
    Close(oneshot::Sender<()>),
}

/// The queue in a SQLite file. Clones are the same; the file is closed when the last one is dropped.
#[derive(Debug, Clone)]
pub struct Sqlite {
    messages: mpsc::Sender<Message>,
    path: PathBuf,
}

impl Sqlite {
    /// Opens the file, or makes it; brings it to the newest format. Blocks as long as that takes.
    ///
    /// # Errors
    /// [`Error`]: it cannot be opened or written, is another program's, a later version's, or damaged.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let db = Db::open(path, open::STEPS)?;
        let (messages, inbox) = mpsc::channel(MOST_WAITING);
        let failed = |e: std::io::Error| Error::Io { path: path.to_owned(), problem: e.to_string() };
        std::thread::Builder::new().name("queue".into()).spawn(move || serve(db, inbox)).map_err(failed)?;
        Ok(Self { messages, path: path.to_owned() })
    }

    /// Ends the thread once everything that was asked for is done, and closes the file. Other clones are refused from then on.
    pub async fn close(self) {
        let (done, closed) = oneshot::channel();
        if self.messages.send(Message::Close(done)).await.is_ok() {
            // Where the thread is gone already, the file is closed, too.
            closed.await.ok();
        }
    }

    /// Does something on the thread.
    async fn on_thread<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Db) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        let (answer, answered) = oneshot::channel();
        // Whoever asked may have left: what was done is done.
        let work: Work = Box::new(move |db| drop(answer.send(work(db))));
        self.messages.send(Message::Work(work)).await.map_err(|_closed| Error::Gone)?;
        answered.await.map_err(|_ended| Error::Gone)?
    }

    async fn write<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Tx<'_>) -> Result<T, sql::Error> + Send + 'static,
    ) -> Result<T, Error> {
        self.on_thread(|db| db.write(work)).await
    }

    /// Reads over a connection of its own, so that it may take long.
    async fn apart<T: Send + 'static>(
        &self,
        look: impl FnOnce(&mut Db) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        let path = self.path.clone();
        let looked = tokio::task::spawn_blocking(move || look(&mut Db::open_to_read(&path)?));
        looked.await.map_err(|_panicked| Error::Gone)?
    }

    async fn read<T: Send + 'static>(
        &self,
        look: impl FnOnce(&Tx<'_>) -> Result<T, sql::Error> + Send + 'static,
    ) -> Result<T, Error> {
        self.on_thread(|db| db.read(look)).await
    }
}

/// The thread: one thing after the other, until nobody is left who could ask.
fn serve(mut db: Db, mut inbox: mpsc::Receiver<Message>) {
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

impl Store for Sqlite {
    async fn add(&self, ticket: Ticket, is_submitted: bool, by: By) -> Result<Job, Error> {
        self.write(move |db| sql::add(db, &ticket, is_submitted, &by)).await
    }

    async fn add_all(&self, tickets: Vec<Ticket>, is_submitted: bool, by: By) -> Result<Vec<Job>, Error> {
        self.write(move |db| tickets.iter().map(|ticket| sql::add(db, ticket, is_submitted, &by)).collect())
            .await
    }

    async fn change(&self, job: JobId, request: Request) -> Result<Job, Error> {
        self.write(move |db| sql::change(db, job, &request)).await
    }

    async fn place(
        &self,
        job: JobId,
        place: Place,
        actor: Actor,
        why: Reason,
        now: Timestamp,
    ) -> Result<Job, Error> {
        self.write(move |db| sql::place(db, job, place, actor, why, now)).await
    }

    async fn claim(&self, claimant: Claimant, now: Timestamp) -> Result<Option<Claimed>, Error> {
        self.write(move |db| sql::take(db, &claimant, now)).await
    }

    async fn renew(&self, claim: Claim, now: Timestamp) -> Result<Claim, Error> {
        self.write(move |db| sql::renew(db, &claim, now)).await
    }

    async fn adopt(&self, holder: Name, now: Timestamp) -> Result<Vec<Claimed>, Error> {
        self.write(move |db| sql::adopt(db, &holder, now)).await
    }

    async fn sweep(&self, now: Timestamp) -> Result<Vec<Job>, Error> {
        self.write(move |db| sql::sweep(db, now)).await
    }

    async fn say(&self, printer: Name, said: Said, by: By) -> Result<Printer, Error> {
        self.write(move |db| sql::say(db, &printer, &said, &by)).await
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
            db.check_pages("integrity_check")?;
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
