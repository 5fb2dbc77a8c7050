//! Cases: folders with CTs, volumes to look at, tasks, stages.

use super::{Fault, JobView};
use crate::app::Stage;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::fmt;
use std::str::FromStr;
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

/// Digits of a handle: 128 bits of chance.
const N_DIGITS: usize = 32;

/// The name of a folder, a volume, a case or a task: chance, so that it tells nothing and cannot be guessed.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Handle(String);

impl Handle {
    /// Of so many bits of chance.
    #[must_use]
    pub fn of(chance: [u8; 16]) -> Self {
        Self(chance.iter().map(|byte| format!("{byte:02x}")).collect())
    }
}

/// It is no handle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("found no name that is given here, expected 32 hexadecimal digits")]
pub struct NoHandle;

impl FromStr for Handle {
    type Err = NoHandle;

    fn from_str(text: &str) -> Result<Self, NoHandle> {
        let is_digit = |b: u8| b.is_ascii_digit() || (b'a'..=b'f').contains(&b);
        let is_handle = text.len() == N_DIGITS && text.bytes().all(is_digit);
        if is_handle { Ok(Self(text.to_owned())) } else { Err(NoHandle) }
    }
}

impl TryFrom<String> for Handle {
    type Error = NoHandle;

    fn try_from(text: String) -> Result<Self, NoHandle> {
        text.parse()
    }
}

impl From<Handle> for String {
    fn from(handle: Handle) -> Self {
        handle.0
    }
}

impl fmt::Display for Handle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl PartialSchema for Handle {
    fn schema() -> RefOr<Schema> {
        String::schema()
    }
}

impl ToSchema for Handle {
    fn name() -> std::borrow::Cow<'static, str> {
        "Handle".into()
    }
}

/// A folder below those that the server was told. Its name, which may be a patient's, is not shown: whoever knows the path, asks for it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct FolderView {
    /// What it is asked for by, as long as this server lives.
    pub id: Handle,
    /// Files in it.
    pub n_files: u64,
    /// Folders in it.
    pub n_folders: u64,
    /// When something in it was added or taken away last.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub changed: Option<jiff::Timestamp>,
}

/// Folders.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct FolderList {
    /// The one that changed last first.
    pub folders: Vec<FolderView>,
}

/// A folder by its path.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FolderPath {
    /// From the root, below one of the folders that the server was told.
    pub path: String,
}

/// Which series of a folder.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SeriesBody {
    /// Its number in the inspection; `null`: the only one.
    pub series: Option<usize>,
    /// Whether a stack with missing planes is used.
    pub allow_gaps: bool,
}

/// A CT to look at.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct VolumeView {
    /// What it is asked for by.
    pub id: Handle,
    /// Columns, rows, planes.
    pub dims: [usize; 3],
    /// Distance of columns and of rows, mm.
    pub pixel_spacing_xy_mm: [f64; 2],
    /// Heights of the planes along their normal, mm.
    pub plane_z_mm: Vec<f64>,
    /// Where the centre of the first pixel of a plane lies, stack frame, mm.
    pub origin_xy_mm: [f64; 2],
    /// From the stack's frame to the patient's (LPS): what makes a seed of a pixel.
    #[schema(value_type = Object)]
    pub patient_from_stack: Value,
}

/// What a task does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum TaskKind {
    /// Finds the series of a folder; its result is what `lumenfab inspect --json` says.
    Inspect,
    /// Reads a series; its result has the volume.
    Planes,
    /// Does stages of a case; its result has their summaries.
    Stages,
}

/// How far a task is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum TaskState {
    /// Others are before it.
    Waiting,
    /// It is under way.
    Running,
    /// It has its result.
    Done,
    /// It could not be done.
    Failed,
    /// Somebody has ended it.
    Cancelled,
}

impl TaskState {
    /// Whether nothing follows.
    #[must_use]
    pub const fn is_over(self) -> bool {
        matches!(self, Self::Done | Self::Failed | Self::Cancelled)
    }
}

/// Something odd.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Notice {
    /// A stable name for programs.
    pub code: String,
    /// In plain words.
    pub text: String,
}

/// A task: long work in the background. Events `task` tell how far it is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TaskView {
    /// What it is asked for by.
    pub id: Handle,
    /// What it does.
    pub kind: TaskKind,
    /// The case, where it works on one.
    pub case: Option<Handle>,
    /// How far it is.
    pub state: TaskState,
    /// The stage that it is at.
    #[schema(value_type = Option<String>)]
    pub stage: Option<Stage>,
    /// Units of work done, and in all; 0 where nobody knows.
    pub progress: Option<[u64; 2]>,
    /// What it is at, in plain words.
    pub says: Option<String>,
    /// What was odd.
    pub warnings: Vec<Notice>,
    /// What came of it.
    #[schema(value_type = Option<Object>)]
    pub result: Option<Value>,
    /// Why it could not be done.
    pub fault: Option<Fault>,
}

/// Tasks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TaskList {
    /// The newest first.
    pub tasks: Vec<TaskView>,
}

/// A case to be begun.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewCase {
    /// The folder of its CT; `null`: the parameters have a phantom.
    #[serde(default)]
    pub folder: Option<Handle>,
    /// Keys of a case file, but for paths, ports and UIDs.
    #[serde(default)]
    #[schema(value_type = Object)]
    pub parameters: Value,
    /// The last stage that is done at once: `segment`, `solid` or `slice`.
    #[serde(default = "first")]
    #[schema(value_type = String)]
    pub last: Stage,
}

const fn first() -> Stage {
    Stage::Segment
}

/// Stages to be done, with corrections.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct StagesBody {
    /// The last stage: `segment`, `solid`, `slice` or `report`. What is up to date is not done again.
    #[schema(value_type = String)]
    pub last: Stage,
    /// Keys of a case file, put over the case's own: seeds, windows, blocks, contours that are drawn, wall, layers, profile.
    #[serde(default)]
    #[schema(value_type = Object)]
    pub parameters: Value,
}

/// A stage that is done.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct StageView {
    /// Which.
    #[schema(value_type = String)]
    pub stage: Stage,
    /// What came out.
    pub summary: String,
    /// What was odd.
    pub warnings: Vec<Notice>,
}

/// What the case's job takes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CaseEstimate {
    /// Print time, s.
    pub print_time_s: f64,
    /// Filament, mm.
    pub filament_mm: f64,
    /// Filament, g.
    pub filament_g: f64,
}

/// A case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CaseView {
    /// What it is asked for by; for good.
    pub id: Handle,
    /// Its parameters, defaults filled in: those that may be said again.
    #[schema(value_type = Object)]
    pub parameters: Value,
    /// Stages that were done, in order. Whether they are up to date, the next task finds out.
    pub stages: Vec<StageView>,
    /// What its job takes, once it is sliced.
    pub estimate: Option<CaseEstimate>,
    /// Documents and pictures that can be asked for.
    pub files: Vec<String>,
    /// The task that works on it now.
    pub task: Option<Handle>,
}

/// Cases.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CaseList {
    /// By their names.
    pub cases: Vec<CaseView>,
}

/// A case into the queue.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CaseToQueue {
    /// What is decided about the job.
    pub wishes: super::WishesBody,
    /// Whether it goes into the queue at once.
    pub submit: bool,
    /// Why.
    #[schema(value_type = String)]
    pub why: crate::queue::Reason,
}

/// A case that was begun.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Begun {
    /// The case.
    pub case: Handle,
    /// What works on it.
    pub task: TaskView,
}

/// A job of a case.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct CaseJob {
    /// The case.
    pub case: Handle,
    /// The job.
    pub job: JobView,
}
