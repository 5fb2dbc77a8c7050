//! What happens while a case is worked on, for whoever shows it.

use crate::ct::Warning;
use serde::{Deserialize, Serialize};

/// A stage of the way from CT to report, in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// CT to contours.
    Segment,
    /// Contours to the solid.
    Solid,
    /// Solid to layers, toolpaths and G-code.
    Slice,
    /// G-code to the printer.
    Print,
    /// Everything to the report.
    Report,
}

impl Stage {
    /// All stages in order.
    pub const ALL: [Self; 5] = [Self::Segment, Self::Solid, Self::Slice, Self::Print, Self::Report];

    /// The stage's name, which is also its command.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Segment => "segment",
            Self::Solid => "solid",
            Self::Slice => "slice",
            Self::Print => "print",
            Self::Report => "report",
        }
    }
}

impl std::fmt::Display for Stage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// Work on a stage began.
    Started(Stage),
    /// A stage is so far: units done, units in all.
    Progress {
        /// The stage.
        stage: Stage,
        /// Units of work done.
        done: u64,
        /// Units of work in all.
        total: u64,
    },
    /// Something was odd but could be used.
    Warned {
        /// The stage that found it.
        stage: Stage,
        /// What it found.
        warning: Warning,
    },
    /// Something worth telling while a stage goes on.
    Note {
        /// The stage.
        stage: Stage,
        /// One line for the operator.
        text: String,
    },
    /// Something that the operator should not miss while a stage goes on.
    Told {
        /// The stage.
        stage: Stage,
        /// A stable name for programs.
        code: &'static str,
        /// One line for the operator.
        text: String,
    },
    /// A stage ended well, or there was nothing to do.
    Ended(StageOutcome),
}

/// Where events go.
pub type EventSink<'a> = dyn Fn(Event) + Sync + 'a;

/// How a stage ended.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StageOutcome {
    /// The stage.
    pub stage: Stage,
    /// False where nothing it is made from had changed, so that it was not done again.
    pub done: bool,
    /// Why it was done: which of the things it is made from were new or had changed.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub because_of: Vec<String>,
    /// How long it took, s.
    pub elapsed_s: f64,
    /// What came out, one line; where the stage was kept, what came out when it was done.
    pub summary: String,
    /// What was odd.
    pub warnings: Vec<Warning>,
}
