//! Where the queue is kept (IO): jobs, claims, printers and their history, each change in one transaction.
//!
//! [`Store`] is what the appliance asks of it; [`sqlite`] keeps it in one file, with nothing to set up, [`mod@postgres`] on a server
//! for several appliances. What is decided is decided by
//! [`crate::queue::act`]; a store reads what a decision needs, asks, and writes the outcome with its records, all or
//! nothing. So all stores behave alike, and one suite of tests holds for each of them.
//!
//! A call that is given up half-way (its future dropped) may still have been done, as with any server, and so may one that a failing
//! disk refused (`store.io`), where the program ends soon after: whoever is unsure looks again.
//! Adding a ticket again is no harm, for it has its name already; everything else names the state or the claim that it
//! acts upon. Clocks are the callers': wrong ones delay, but never let a job be printed twice.

mod error;
pub mod postgres;
mod progress;
mod sql;
pub mod sqlite;
#[cfg(test)]
mod suite;
mod thread;

pub use error::Error;
pub use postgres::Postgres;
pub use progress::Progress;
pub use sqlite::Sqlite;
pub use thread::OnThread;

use crate::queue::{
    Actor, By, Claim, Claimant, Head, Job, JobId, Name, Printer, Reason, Request, Said, Sealed, Spec,
    Subject, Ticket,
};
use jiff::Timestamp;
use std::future::Future;

/// A job that an appliance has taken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Claimed {
    /// The job.
    pub job: Job,
    /// What shows that it is this appliance's.
    pub claim: Claim,
}

/// Where a job is moved to, among those of its priority.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Place {
    /// Before all others.
    First,
    /// Behind all others.
    Last,
    /// Just before this one.
    Before(JobId),
    /// Just behind this one.
    Behind(JobId),
}

/// Which jobs are listed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Which {
    /// Those that are not over, in the order of the queue.
    Live,
    /// Those that are over, the last one first.
    Over,
}

/// What the appliance asks of a store.
pub trait Store: Clone + Send + Sync + 'static {
    /// Adds a job, as a draft or in the queue at once; the same ticket again changes nothing.
    ///
    /// # Errors
    /// [`Error`]; [`crate::queue::Refusal`] where its wishes cannot be, or another job has its name.
    fn add(
        &self,
        ticket: Ticket,
        is_submitted: bool,
        by: By,
    ) -> impl Future<Output = Result<Job, Error>> + Send;

    /// Adds many jobs, all or none, in one transaction.
    ///
    /// # Errors
    /// As [`Store::add`].
    fn add_all(
        &self,
        tickets: Vec<Ticket>,
        is_submitted: bool,
        by: By,
    ) -> impl Future<Output = Result<Vec<Job>, Error>> + Send;

    /// Changes a job as somebody asks for.
    ///
    /// # Errors
    /// [`Error`]; [`crate::queue::Refusal`] where it cannot be.
    fn change(&self, job: JobId, request: Request) -> impl Future<Output = Result<Job, Error>> + Send;

    /// Moves a job among those of its priority.
    ///
    /// # Errors
    /// As [`Store::change`].
    fn place(
        &self,
        job: JobId,
        place: Place,
        actor: Actor,
        why: Reason,
        now: Timestamp,
    ) -> impl Future<Output = Result<Job, Error>> + Send;

    /// Takes the first job that this worker or printer can have. `None`: there is none.
    ///
    /// # Errors
    /// [`Error`]; [`crate::queue::Refusal`] where the printer is unknown or its bed not known to be clear.
    fn claim(
        &self,
        claimant: Claimant,
        now: Timestamp,
    ) -> impl Future<Output = Result<Option<Claimed>, Error>> + Send;

    /// Says that the holder of a claim is alive; no record is made.
    ///
    /// # Errors
    /// [`Error`]; [`crate::queue::Refusal::ClaimLost`] where the job is not its any more.
    fn renew(&self, claim: Claim, now: Timestamp) -> impl Future<Output = Result<Claim, Error>> + Send;

    /// Takes up again, under new claims, what this appliance had when it ended. Only whoever has made sure that no other process of this
    /// name lives may ask for it. A job in the middle of which one holder after the other ended has failed then, and is not given.
    ///
    /// # Errors
    /// [`Error`].
    fn adopt(&self, holder: Name, now: Timestamp)
    -> impl Future<Output = Result<Vec<Claimed>, Error>> + Send;

    /// Takes jobs from holders that have not been heard of for too long, where no material was laid. Gives those that changed.
    ///
    /// # Errors
    /// [`Error`].
    fn sweep(&self, now: Timestamp) -> impl Future<Output = Result<Vec<Job>, Error>> + Send;

    /// Says something of a printer, which is made known by it.
    ///
    /// # Errors
    /// [`Error`]; [`crate::queue::Refusal`] where it cannot be.
    fn say(&self, printer: Name, said: Said, by: By) -> impl Future<Output = Result<Printer, Error>> + Send;

    /// All printers, by name.
    ///
    /// # Errors
    /// [`Error`].
    fn printers(&self) -> impl Future<Output = Result<Vec<Printer>, Error>> + Send;

    /// A job, and who has it.
    ///
    /// # Errors
    /// [`Error`]; [`crate::queue::Refusal::NoJob`].
    fn job(&self, id: JobId) -> impl Future<Output = Result<(Job, Option<Claim>), Error>> + Send;

    /// Jobs behind one of the same listing, or from its beginning; `most` of them.
    ///
    /// # Errors
    /// [`Error`]; [`crate::queue::Refusal::NoJob`] where that one is not there.
    fn list(
        &self,
        which: Which,
        behind: Option<JobId>,
        most: u32,
    ) -> impl Future<Output = Result<Vec<Job>, Error>> + Send;

    /// The specification of a job.
    ///
    /// # Errors
    /// [`Error`]; [`crate::queue::Refusal::NoJob`].
    fn spec(&self, id: JobId) -> impl Future<Output = Result<Spec, Error>> + Send;

    /// Records behind number `after`, of one job or printer or of all; `most` of them.
    ///
    /// # Errors
    /// [`Error`].
    fn history(
        &self,
        of: Option<Subject>,
        after: u64,
        most: u32,
    ) -> impl Future<Output = Result<Vec<Sealed>, Error>> + Send;

    /// The end of the history; a copy of it elsewhere tells whether the history was written anew.
    ///
    /// # Errors
    /// [`Error`].
    fn head(&self) -> impl Future<Output = Result<Head, Error>> + Send;

    /// Whether the history is as it was written, and everything that is kept is what it comes to. Reads all there is; holds up nobody.
    ///
    /// What no record tells cannot be checked: until when a claim is believed. Whoever can write the whole file can also write it
    /// anew from the first record on; only a head that was kept elsewhere tells then ([`Progress::behind`]).
    ///
    /// # Errors
    /// [`Error::History`], the first record or thing that does not fit; [`Error::Damaged`].
    fn verify(&self) -> impl Future<Output = Result<(), Error>> + Send;

    /// A part of the same, of bounded time and memory however long the history is: some thousand records. Gives where to go on, also
    /// after other changes were made in between; `None`: all is checked.
    ///
    /// # Errors
    /// As [`Store::verify`].
    fn verify_part(&self, from: Progress) -> impl Future<Output = Result<Option<Progress>, Error>> + Send;
}
