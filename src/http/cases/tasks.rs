//! Long work, one task after the other, each by a child process of this program (IO).

use super::super::error::Problem;
use super::super::events::Events;
use super::super::wire::Fault;
use super::super::wire::case::{Handle, Notice, TaskKind, TaskState, TaskView};
use super::{Setup, in_use, new_handle, nothing_of_this_name};
use crate::app::errand::{Errand, Told};
use rustix::process::{Pid, Signal, kill_process, setpriority_process};
use serde_json::Value;
use std::collections::VecDeque;
use std::process::Stdio;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::process::{Child, Command};
use tokio::sync::{Notify, Semaphore, watch};
use tokio::time::{Instant, sleep_until};

/// Tasks that are remembered, and that may wait.
const MOST_KNOWN: usize = 100;
const MOST_WAITING: usize = 8;
/// How often progress is told at most.
const SELDOM: Duration = Duration::from_millis(250);
/// How long a task that was cancelled has to end.
const GRACE: Duration = Duration::from_secs(10);

/// What is remembered of a task.
#[derive(Debug)]
struct Known {
    view: TaskView,
    cancelled: Arc<Notify>,
}

/// Tasks of a server.
#[derive(Debug, Clone)]
pub(super) struct Tasks {
    setup: Arc<Setup>,
    events: Events,
    /// The newest first.
    known: Arc<Mutex<VecDeque<Known>>>,
    turn: Arc<Semaphore>,
    is_ending: Arc<watch::Sender<bool>>,
}

/// What follows from a result, before the task is done: nobody sees it half.
pub(super) type Finish = Box<dyn FnOnce(Value) -> Result<Value, Problem> + Send>;

/// A task to be begun.
pub(super) struct New {
    pub(super) kind: TaskKind,
    pub(super) case: Option<Handle>,
    pub(super) errand: Errand,
    pub(super) finish: Finish,
}

impl Tasks {
    pub(super) fn new(setup: Setup, events: Events) -> Self {
        Self {
            setup: Arc::new(setup),
            events,
            known: Arc::default(),
            turn: Arc::new(Semaphore::new(1)),
            is_ending: Arc::new(watch::Sender::new(false)),
        }
    }

    /// Begins a task, once those before it are over.
    pub(super) fn begin(&self, new: New) -> Result<TaskView, Problem> {
        let New { kind, case, errand, finish } = new;
        let (id, state) = (new_handle()?, TaskState::Waiting);
        let (stage, progress, says, result, fault) = (None, None, None, None, None);
        let view =
            TaskView { id, kind, case, state, stage, progress, says, warnings: Vec::new(), result, fault };
        let cancelled = Arc::new(Notify::new());
        {
            let mut known = self.lock();
            let live = |known: &&Known| !known.view.state.is_over();
            if view.case.is_some() && known.iter().filter(live).any(|known| known.view.case == view.case) {
                return Err(in_use());
            }
            if known.iter().filter(live).count() > MOST_WAITING {
                return Err(Problem::busy("http.too_many_tasks", "too many tasks wait: cancel some", 10));
            }
            if known.len() == MOST_KNOWN {
                known.pop_back();
            }
            known.push_front(Known { view: view.clone(), cancelled: Arc::clone(&cancelled) });
        }
        let run = Running { tasks: self.clone(), view: view.clone(), cancelled, told: None };
        tokio::spawn(run.run(errand, finish));
        Ok(view)
    }

    pub(super) fn all(&self) -> Vec<TaskView> {
        self.lock().iter().map(|known| known.view.clone()).collect()
    }

    pub(super) fn find(&self, id: &Handle) -> Result<TaskView, Problem> {
        let known = self.lock();
        let found = known.iter().find(|known| known.view.id == *id);
        found.map(|known| known.view.clone()).ok_or_else(nothing_of_this_name)
    }

    /// The task that works on a case.
    pub(super) fn of_case(&self, case: &Handle) -> Option<Handle> {
        let known = self.lock();
        let mut live = known.iter().filter(|known| !known.view.state.is_over());
        live.find(|known| known.view.case.as_ref() == Some(case)).map(|known| known.view.id.clone())
    }

    pub(super) fn cancel(&self, id: &Handle) -> Result<TaskView, Problem> {
        let known = self.lock();
        let found = known.iter().find(|known| known.view.id == *id).ok_or_else(nothing_of_this_name)?;
        found.cancelled.notify_one();
        Ok(found.view.clone())
    }

    pub(super) fn set_ending(&self, is_ending: bool) {
        self.is_ending.send_replace(is_ending);
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<Known>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn publish(&self, view: &TaskView) {
        if let Some(known) = self.lock().iter_mut().find(|known| known.view.id == view.id) {
            known.view = view.clone();
        }
        self.events.task(view);
    }
}

struct Running {
    tasks: Tasks,
    view: TaskView,
    cancelled: Arc<Notify>,
    /// When progress was told last.
    told: Option<Instant>,
}

/// How a child ended.
enum End {
    Told(Told),
    Cancelled,
    /// Without a word.
    Died,
}

impl Running {
    async fn run(mut self, errand: Errand, finish: Finish) {
        let (cancelled, turn) = (Arc::clone(&self.cancelled), Arc::clone(&self.tasks.turn));
        let mut ending = self.tasks.is_ending.subscribe();
        let _turn = tokio::select! {
            turn = turn.acquire() => turn.ok(),
            () = stopped(&cancelled, &mut ending) => return self.over(End::Cancelled, finish).await,
        };
        self.view.state = TaskState::Running;
        self.tasks.publish(&self.view);
        tracing::info!(task = %self.view.id, kind = ?self.view.kind, "cases: a task begins");
        let end = match self.child(&errand).await {
            Ok(child) => self.attend(child).await,
            Err(error) => {
                tracing::error!("cases: no child can be started: {}", error.kind());
                End::Died
            }
        };
        self.over(end, finish).await;
    }

    async fn child(&self, errand: &Errand) -> std::io::Result<Child> {
        let Setup { program, threads, nice, .. } = &*self.tasks.setup;
        let mut child = Command::new(program)
            .arg("errand")
            .env("RAYON_NUM_THREADS", threads.to_string())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .kill_on_drop(true)
            .spawn()?;
        if let Some(Err(error)) = pid(&child).map(|pid| setpriority_process(Some(pid), i32::from(*nice))) {
            tracing::debug!("cases: the child's niceness: {error}");
        }
        if let Some(mut to) = child.stdin.take() {
            let mut line = serde_json::to_vec(errand)?;
            line.push(b'\n');
            to.write_all(&line).await?;
        }
        Ok(child)
    }

    /// Until its last word, or until it is to end.
    async fn attend(&mut self, mut child: Child) -> End {
        let Some(out) = child.stdout.take() else { return End::Died };
        let mut lines = BufReader::new(out).lines();
        let cancelled = Arc::clone(&self.cancelled);
        let mut ending = self.tasks.is_ending.subscribe();
        let mut ends_at = None;
        loop {
            let patience = ends_at.unwrap_or_else(Instant::now);
            let line = tokio::select! {
                line = lines.next_line() => line,
                () = stopped(&cancelled, &mut ending), if ends_at.is_none() => {
                    ends_at = Some(Instant::now() + GRACE);
                    terminate(&child);
                    continue;
                }
                () = sleep_until(patience), if ends_at.is_some() => return End::Cancelled,
            };
            let Ok(Some(line)) = line else { break };
            match serde_json::from_str(&line) {
                Ok(_any) if ends_at.is_some() => {}
                Ok(last @ (Told::Done { .. } | Told::Failed { .. })) => return End::Told(last),
                Ok(told) => self.hear(told),
                Err(error) => tracing::error!(task = %self.view.id, "cases: a line of the child: {error}"),
            }
        }
        if ends_at.is_some() { End::Cancelled } else { End::Died }
    }

    fn hear(&mut self, told: Told) {
        match told {
            Told::Started { stage } => {
                (self.view.stage, self.view.progress, self.view.says) = (Some(stage), None, None)
            }
            Told::Progress { done, total } => {
                self.view.progress = Some([done, total]);
                let now = Instant::now();
                if self.told.is_some_and(|told| now.duration_since(told) < SELDOM) {
                    return;
                }
                self.told = Some(now);
            }
            Told::Note { text } => self.view.says = Some(text),
            Told::Warned { code, text } => self.view.warnings.push(Notice { code, text }),
            Told::Done { .. } | Told::Failed { .. } => {}
        }
        self.tasks.publish(&self.view);
    }

    async fn over(mut self, end: End, finish: Finish) {
        let end = match end {
            End::Told(Told::Done { result }) => {
                let finished = tokio::task::spawn_blocking(|| finish(result)).await;
                let finished =
                    finished.unwrap_or_else(|panicked| Err(Problem::inside("ending a task", &panicked)));
                finished.map_err(|problem| Fault { code: problem.code.to_owned(), message: problem.message })
            }
            End::Told(Told::Failed { code, text }) => Err(Fault { code, message: text }),
            End::Cancelled => {
                self.view.state = TaskState::Cancelled;
                return self.tasks.publish(&self.view);
            }
            End::Told(_) | End::Died => {
                let message = "the process that worked on it has ended without a word: it may have had too little memory; try again";
                Err(Fault { code: "http.task_died".to_owned(), message: message.to_owned() })
            }
        };
        match end {
            Ok(result) => (self.view.state, self.view.result) = (TaskState::Done, Some(result)),
            Err(fault) => (self.view.state, self.view.fault) = (TaskState::Failed, Some(fault)),
        }
        let code = self.view.fault.as_ref().map(|fault| fault.code.as_str());
        tracing::info!(task = %self.view.id, state = ?self.view.state, code, "cases: a task ended");
        self.tasks.publish(&self.view);
    }
}

async fn stopped(cancelled: &Notify, ending: &mut watch::Receiver<bool>) {
    tokio::select! {
        () = cancelled.notified() => {}
        _ = ending.wait_for(|&is_ending| is_ending) => {}
    }
}

fn pid(child: &Child) -> Option<Pid> {
    child.id().and_then(|id| i32::try_from(id).ok()).and_then(Pid::from_raw)
}

/// Asks it to end: it leaves nothing half done.
fn terminate(child: &Child) {
    if let Some(Err(error)) = pid(child).map(|pid| kill_process(pid, Signal::TERM)) {
        tracing::debug!("cases: a child cannot be ended: {error}");
    }
}
