//! What goes over the wire, both ways: the types of requests and answers under `/api/v1`, in JSON.
//!
//! Lengths, times and amounts carry their units in their names; times are RFC 3339 in UTC. Unknown fields of requests are refused, so that a
//! misspelt wish is not lost; unknown fields of answers are passed over, so that an older client goes on with a newer server.

pub mod case;
mod job;
mod printer;
mod schedule;

pub use job::{
    Added, Anew, EstimateView, HistoryPage, HistoryView, JobList, JobView, Move, NeedsView, Turn, WishesBody,
};
pub use printer::{
    Activity, BedClear, BedView, Heat, Live, LoadedBody, Order, Ordered, PrinterList, PrinterView, Said,
};
pub use schedule::{NextView, Schedule, SlotView, UnplannedView};

use crate::queue::{JobId, Name};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

/// Version of this interface: a client of another one refuses to go on.
pub const API: u32 = 1;

impl PartialSchema for JobId {
    fn schema() -> RefOr<Schema> {
        String::schema()
    }
}

impl ToSchema for JobId {
    fn name() -> Cow<'static, str> {
        "JobId".into()
    }
}

/// The one shape of errors.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ErrorBody {
    /// What is wrong.
    pub error: Fault,
}

/// What is wrong.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Fault {
    /// Stable name for programs, such as `queue.bed_not_clear`.
    pub code: String,
    /// In plain words, with what to do.
    pub message: String,
}

/// What a caller may do; each includes the one before.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Access {
    /// Look at everything.
    View,
    /// Run queue and printers.
    Operate,
    /// Give keys, send commands to printers.
    Admin,
}

impl Access {
    /// In plain words.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::View => "view",
            Self::Operate => "operate",
            Self::Admin => "admin",
        }
    }
}

/// Who asks.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Whoami {
    /// As it stands in the history.
    #[schema(value_type = String)]
    pub name: Name,
    /// What this caller may do.
    pub access: Access,
}

/// The server at a glance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Status {
    /// Version of the interface.
    pub api: u32,
    /// Version of the program.
    pub version: String,
    /// When the server started.
    #[schema(value_type = String, format = DateTime)]
    pub started: Timestamp,
    /// The server's clock.
    #[schema(value_type = String, format = DateTime)]
    pub now: Timestamp,
    /// Number of the last record of the history.
    pub last_record: u64,
    /// Printers.
    pub printers: Vec<PrinterView>,
}

/// Whether the server can do its work.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Health {
    /// It can.
    pub ok: bool,
}

/// A key as it is listed: never the key itself.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct KeyView {
    /// Its name, which stands in the history.
    #[schema(value_type = String)]
    pub name: Name,
    /// What it allows.
    pub access: Access,
}

/// All keys.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct KeyList {
    /// By name.
    pub keys: Vec<KeyView>,
}

/// A key to be made.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct KeyBody {
    /// Its name: of a person or a program.
    #[schema(value_type = String)]
    pub name: Name,
    /// What it allows.
    pub access: Access,
}

/// A new key, told this once.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct NewKey {
    /// Its name.
    #[schema(value_type = String)]
    pub name: Name,
    /// The key: for the header `X-Api-Key`.
    pub key: String,
}

impl std::fmt::Debug for NewKey {
    /// Without the key, which no log may show.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("NewKey").field("name", &self.name).finish_non_exhaustive()
    }
}
