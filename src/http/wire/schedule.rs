//! What is next, why nothing is, when each job ends.

use crate::queue::{JobId, Name};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What a printer draws next.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct NextView {
    /// The printer.
    #[schema(value_type = String)]
    pub printer: Name,
    /// The job; `null`: none.
    #[schema(value_type = Option<String>)]
    pub job: Option<JobId>,
    /// Why none, in plain words.
    pub why_not: Option<String>,
}

/// A copy in the plan.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct SlotView {
    /// The job.
    #[schema(value_type = String)]
    pub job: JobId,
    /// Which copy, from 1.
    pub copy: u16,
    /// The printer.
    #[schema(value_type = String)]
    pub printer: Name,
    /// When it begins.
    #[schema(value_type = String, format = DateTime)]
    pub starts: Timestamp,
    /// When it ends.
    #[schema(value_type = String, format = DateTime)]
    pub ends: Timestamp,
}

/// A job without a place in the plan.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct UnplannedView {
    /// The job.
    #[schema(value_type = String)]
    pub job: JobId,
    /// Why, in plain words.
    pub why: String,
}

/// The plan, as far as estimates go.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Schedule {
    /// For each printer.
    pub next: Vec<NextView>,
    /// Copies, by the time at which they begin.
    pub slots: Vec<SlotView>,
    /// Jobs without a place.
    pub unplanned: Vec<UnplannedView>,
    /// When everything is printed.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub ends: Option<Timestamp>,
    /// The same in plain words, by the server's clock.
    pub ends_words: Option<String>,
    /// Whether jobs at the end of a long queue were left out of the plan.
    pub is_cut: bool,
}
