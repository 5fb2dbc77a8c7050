//! The connection to the server: looked for again and again, followed while it is there (IO).
//!
//! What is fetched follows from the records that come in: a job that changed alone, the whole listing only where its order may have changed, and
//! that not oftener than every other second however much happens.

use super::message::{Answer, LinkNews, Message, News, Request};
use crate::client::{Client, Error, Told};
use crate::http::wire::{HistoryView, Status, Whoami};
use crate::queue::{Change, Edit, JobId, What};
use crate::store::Which;
use std::collections::BTreeSet;
use std::fs::DirBuilder;
use std::io;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::PathBuf;
use std::process::Stdio;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::{Instant, interval, sleep, sleep_until};

/// Between two attempts to find a server.
const AGAIN: Duration = Duration::from_secs(1);
/// Things that happen together are fetched together.
const TOGETHER: Duration = Duration::from_millis(150);
/// Between two fetches of whole listings and plans.
const APART: Duration = Duration::from_secs(2);
/// How often the plan is looked at where nothing happens: it moves with the clock.
const PLAN: Duration = Duration::from_secs(30);
/// Jobs of one answer: what the server gives at most.
const PAGE: u32 = 500;
/// Jobs in the queue that are followed; more are not shown.
const MOST_JOBS: usize = 50_000;
/// Jobs that are fetched one by one; where more have changed, all are fetched.
const MOST_SINGLE: usize = 20;
/// Records that are shown at first.
const MOST_RECORDS: u32 = 50;
/// Records of one job.
const MOST_OF_JOB: u32 = 500;
/// A server that ends so soon was not able to start.
const STARTS: Duration = Duration::from_secs(10);

/// Nobody listens to messages any more: the screen was left.
struct Left;

impl From<mpsc::error::SendError<Message>> for Left {
    fn from(_closed: mpsc::error::SendError<Message>) -> Self {
        Self
    }
}

/// A server, and whoever is told about it.
#[derive(Debug, Clone)]
pub(super) struct Follower {
    pub(super) client: Client,
    pub(super) messages: mpsc::Sender<Message>,
}

impl Follower {
    /// Until nobody listens any more.
    pub(super) async fn run(self) {
        while self.once().await.is_ok() {
            sleep(AGAIN).await;
        }
    }

    /// Finds it, and follows it until it is lost.
    async fn once(&self) -> Result<(), Left> {
        let news = match self.follow().await? {
            Ok(()) => LinkNews::Lost("the server has ended or the connection broke".to_owned()),
            Err(Error::NoServer { .. }) => LinkNews::NoServer,
            Err(Error::OtherVersion { found }) => LinkNews::OtherVersion(found),
            Err(error) => LinkNews::Lost(error.to_string()),
        };
        Ok(self.messages.send(Message::Link(news)).await?)
    }

    async fn tell(&self, news: News) -> Result<(), Left> {
        Ok(self.messages.send(Message::News(news)).await?)
    }

    /// What goes wrong at the server is within, that nobody listens outside.
    async fn follow(&self) -> Result<Result<(), Error>, Left> {
        let (status, me) = match self.greet().await {
            Ok(found) => found,
            Err(error) => return Ok(Err(error)),
        };
        let last = status.last_record;
        self.messages.send(Message::Link(LinkNews::Up(Box::new(status), me))).await?;
        for record in match self.client.history(last.saturating_sub(MOST_RECORDS.into()), MOST_RECORDS).await
        {
            Ok(page) => page.records,
            Err(error) => return Ok(Err(error)),
        } {
            self.tell(News::Record(Box::new(record))).await?;
        }
        let mut due = Due::everything(Instant::now());
        let mut events = self.client.events(Some(last));
        let mut plan = interval(PLAN);
        loop {
            let told = tokio::select! {
                told = events.next() => told,
                () = sleep_until(due.at.unwrap_or_else(Instant::now)), if due.at.is_some() => {
                    if let Err(error) = self.fetch(due.take(Instant::now())).await? {
                        return Ok(Err(error));
                    }
                    continue;
                }
                _ = plan.tick() => {
                    due.plan(Instant::now());
                    continue;
                }
            };
            match told {
                // It starts no tasks and shows none.
                Ok(Told::Connected | Told::Task(_)) => {}
                Ok(Told::Reset) => due = Due::everything(Instant::now()),
                Ok(Told::Printers(lives)) => self.tell(News::Lives(lives)).await?,
                Ok(Told::Record(record)) => {
                    due.follow(&record, Instant::now());
                    self.tell(News::Record(record)).await?;
                }
                Ok(Told::Interrupted) => return Ok(Ok(())),
                Err(error) => return Ok(Err(error)),
            }
        }
    }

    async fn greet(&self) -> Result<(Status, Whoami), Error> {
        Ok((self.client.check_version().await?, self.client.whoami().await?))
    }

    async fn fetch(&self, parts: Parts) -> Result<Result<(), Error>, Left> {
        let fetched = async {
            let mut news = Vec::new();
            if parts.all {
                let (jobs, more) = self.all_live().await?;
                news.push(News::Jobs(Which::Live, jobs, more));
                let over = self.client.jobs(Which::Over, None, PAGE).await?;
                news.push(News::Jobs(Which::Over, over.jobs, over.more));
            }
            let mut changed = Vec::new();
            for id in parts.jobs {
                changed.push(self.client.job(id).await?);
            }
            if !changed.is_empty() {
                news.push(News::Changed(changed));
            }
            if parts.printers {
                news.push(News::Printers(self.client.printers().await?.printers));
            }
            if parts.plan {
                news.push(News::Schedule(Box::new(self.client.schedule().await?)));
            }
            Ok(news)
        };
        match fetched.await {
            Ok(news) => {
                for one in news {
                    self.tell(one).await?;
                }
                Ok(Ok(()))
            }
            Err(error) => Ok(Err(error)),
        }
    }

    async fn all_live(&self) -> Result<(Vec<crate::http::wire::JobView>, bool), Error> {
        let mut all = Vec::new();
        loop {
            let behind = all.last().map(|job: &crate::http::wire::JobView| job.id);
            let page = self.client.jobs(Which::Live, behind, PAGE).await?;
            all.extend(page.jobs);
            if !page.more || all.len() >= MOST_JOBS {
                return Ok((all, page.more));
            }
        }
    }
}

/// What is to be fetched.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
struct Parts {
    jobs: BTreeSet<JobId>,
    all: bool,
    printers: bool,
    plan: bool,
}

/// The same, and when.
#[derive(Debug, Clone)]
struct Due {
    parts: Parts,
    at: Option<Instant>,
    /// When listings and plans were fetched last.
    fetched: Option<Instant>,
}

impl Due {
    fn everything(now: Instant) -> Self {
        let parts = Parts { all: true, printers: true, plan: true, ..Parts::default() };
        Self { parts, at: Some(now), fetched: None }
    }

    /// What a record may have changed.
    fn follow(&mut self, record: &HistoryView, now: Instant) {
        match &record.what {
            What::Printer { .. } => self.parts.printers = true,
            What::Job { change: Change::Edit(Edit::Priority(_) | Edit::Rank(_)) | Change::Retry, .. }
            | What::Added { .. } => self.parts.all = true,
            What::Job { id, .. } => drop(self.parts.jobs.insert(*id)),
        }
        self.plan(now);
    }

    fn plan(&mut self, now: Instant) {
        self.parts.plan = true;
        if self.parts.jobs.len() > MOST_SINGLE {
            self.parts.all = true;
        }
        self.at = self.at.or(Some(now + TOGETHER));
    }

    /// What is fetched now: single jobs and printers at once, the rest once it is time.
    fn take(&mut self, now: Instant) -> Parts {
        let again = self.fetched.map(|at| at + APART).filter(|again| now < *again);
        let mut parts = std::mem::take(&mut self.parts);
        self.at = again.filter(|_| parts.all || parts.plan);
        if again.is_some() {
            self.parts = Parts { all: parts.all, plan: parts.plan, ..Parts::default() };
            (parts.all, parts.plan) = (false, false);
            return parts;
        }
        if parts.all {
            parts.jobs.clear();
        }
        self.fetched = Some(now);
        parts
    }
}

/// Where a server is started.
#[derive(Debug, Clone)]
pub(super) struct Starter {
    pub(super) program: PathBuf,
    pub(super) dir: PathBuf,
}

/// Asks the server.
pub(super) async fn perform(client: &Client, starter: &Starter, request: &Request) -> Result<Answer, String> {
    let done = |_view| Answer::Done;
    let answer = match request {
        Request::Change(job, anew, _) => client.change(*job, anew).await.map(|_| Answer::Done),
        Request::ClearBed(printer, word) => client.clear_bed(printer, word).await.map(done),
        Request::DoubtBed(printer, said) => client.doubt_bed(printer, said).await.map(done),
        Request::Order(printer, ordered) => client.order(printer, ordered).await.map(done),
        Request::History(job) => client.history_of(*job, 0, MOST_OF_JOB).await.map(Answer::History),
        Request::Start => return starter.start().await,
    };
    answer.map_err(|error| error.to_string())
}

impl Starter {
    /// Starts a server that outlives this screen; what it says goes into `serve.log` in its directory.
    async fn start(&self) -> Result<Answer, String> {
        let failed = |error: io::Error| format!("the server could not be started: {error}");
        DirBuilder::new().recursive(true).mode(0o700).create(&self.dir).map_err(failed)?;
        let path = self.dir.join("serve.log");
        let log =
            std::fs::File::options().create(true).append(true).mode(0o600).open(&path).map_err(failed)?;
        let mut server = tokio::process::Command::new(&self.program)
            .args(["serve", "--state"])
            .arg(&self.dir)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            // Ctrl-C on this terminal is not meant for it.
            .process_group(0)
            .spawn()
            .map_err(failed)?;
        match tokio::time::timeout(STARTS, server.wait()).await {
            // It lives; whether it answers is seen by the follower.
            Err(_still_there) => Ok(Answer::Done),
            Ok(ended) => {
                let status = ended.map_err(failed)?;
                Err(format!("the server ended at once ({status}): look into {}", path.display()))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::queue::{Digest, Name, PrinterChange, Reason, State};

    fn record(what: What) -> HistoryView {
        HistoryView {
            seq: 1,
            at: jiff::Timestamp::UNIX_EPOCH,
            who: "Ada".into(),
            why: Reason::default(),
            job: None,
            printer: None,
            what,
            digest: Digest::of(b""),
        }
    }

    fn changed(id: JobId, change: Change) -> HistoryView {
        record(What::Job { id, change, from: State::Queued, to: State::Queued })
    }

    fn id(n: u8) -> JobId {
        JobId::at(jiff::Timestamp::UNIX_EPOCH, [n; 10])
    }

    #[test]
    fn one_job_is_fetched_alone_and_all_where_their_order_may_have_changed() {
        let start = Instant::now();
        let mut due = Due::everything(start);
        assert!(due.take(start).all);
        let later = start + APART;
        due.follow(&changed(id(1), Change::Pause), later);
        assert_eq!(due.at, Some(later + TOGETHER));
        let parts = due.take(later);
        assert_eq!((parts.jobs.len(), parts.all, parts.printers, parts.plan), (1, false, false, true));
        due.follow(&changed(id(1), Change::Edit(Edit::Priority(3))), later + APART);
        assert!(due.take(later + APART).all);
        let doubt = What::Printer { name: Name::try_new("a").unwrap(), change: PrinterChange::Doubt };
        due.follow(&record(doubt), later + APART * 2);
        assert!(due.take(later + APART * 2).printers);
        assert_eq!(due.at, None);
    }

    #[test]
    fn whole_listings_are_fetched_every_other_second_at_most_and_not_forgotten() {
        let start = Instant::now();
        let mut due = Due::everything(start);
        due.take(start);
        for n in 0..40 {
            due.follow(&changed(id(n), Change::Hold), start);
        }
        let parts = due.take(start + TOGETHER);
        assert_eq!((parts.jobs.len(), parts.all, parts.plan), (40, false, false));
        assert_eq!(due.at, Some(start + APART));
        let parts = due.take(start + APART);
        assert_eq!((parts.jobs.len(), parts.all, parts.plan, due.at), (0, true, true, None));
    }
}
