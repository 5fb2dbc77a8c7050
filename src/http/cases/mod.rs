//! Cases over the API: folders with CTs, planes of them as pictures, the stages of a case, each as a task in the background.
//!
//! - `folders`: what lies below the folders that the server was told, by names of chance;
//! - `tasks`: what is done by child processes ([`crate::app::errand`]), one after the other, nice to the prints;
//! - `kept`: cases and volumes in the state directory;
//! - `routes`, `pixels`: the handlers.
//!
//! No path and no name of a folder goes out, whatever the caller may do. Pixels need the right to operate.

mod folders;
mod kept;
pub(super) mod pixels;
pub(super) mod routes;
mod tasks;

use super::error::Problem;
use super::events::Events;
use super::wire::case::Handle;
use axum::http::StatusCode;
use folders::Folders;
use kept::Kept;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use tasks::Tasks;

/// What is decided about cases.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Setup {
    /// CTs lie below these folders, and are looked for nowhere else.
    pub ct_folders: Vec<PathBuf>,
    /// The state directory.
    pub state: PathBuf,
    /// This program.
    pub program: PathBuf,
    /// Threads of a task, and how nice it is.
    pub threads: u32,
    /// Niceness, 0 to 19.
    pub nice: u8,
}

/// Everything about cases. Clones are the same.
#[derive(Debug, Clone)]
pub struct Cases(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    folders: Folders,
    tasks: Tasks,
    kept: Kept,
}

impl Cases {
    /// Opens what is kept; volumes of an earlier process are removed.
    ///
    /// # Errors
    /// What the system says.
    pub fn open(setup: Setup, events: Events) -> io::Result<Self> {
        let kept = Kept::open(&setup.state)?;
        let folders = Folders::new(setup.ct_folders.clone());
        Ok(Self(Arc::new(Inner { folders, tasks: Tasks::new(setup, events), kept })))
    }

    /// Lets tasks begin, again after an end.
    pub(super) fn begin(&self) {
        self.0.tasks.set_ending(false);
    }

    /// Ends what is under way.
    pub(super) fn end(&self) {
        self.0.tasks.set_ending(true);
    }
}

fn new_handle() -> Result<Handle, Problem> {
    let mut chance = [0; 16];
    getrandom::fill(&mut chance).map_err(|e| Problem::inside("naming something", &e))?;
    Ok(Handle::of(chance))
}

fn in_use() -> Problem {
    Problem::conflict("http.case_in_use", "a task works on this case: wait for its end, or cancel it")
}

fn nothing_of_this_name() -> Problem {
    let message = "there is nothing of this name, or not any more: look again";
    Problem::new(StatusCode::NOT_FOUND, "http.not_found", message)
}
