//! Claims: which appliance has a job, and until when that is believed.
//!
//! A claim is a lease. Its holder renews it every [`HEARTBEAT_S`]; one that is not renewed for [`LEASE_S`] has lapsed. A lapsed claim
//! of which no material was laid is taken away; one of which some was stays its holder's, for only that printer can go on.
//! The token of a claim is the number of the record that made it: a holder whose claim was taken away is refused by it
//! at the latest when it asks to lay material, so that two never print one copy, however wrong their clocks are.

use super::{JobId, Name};
use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};

/// How long a claim is believed, s: longer than any hiccup of disk or network, short against a print.
pub const LEASE_S: i64 = 60;
/// How often a holder renews its claims, s.
pub const HEARTBEAT_S: i64 = 20;
/// So often in a row a job may lose its holder before it is given up: whatever it does to them is not left to do it all night.
pub(super) const MOST_LOST: u8 = 3;

/// A claim.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Claim {
    /// Of this job.
    pub job: JobId,
    /// The printer or the worker.
    pub holder: Name,
    /// Which claim of the job.
    pub token: u64,
    /// When it lapses.
    pub until: Timestamp,
}

/// Who takes a job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Claimant {
    /// A worker, to prepare it.
    Worker(Name),
    /// A printer, to print a copy.
    Printer(Name),
}

impl Claimant {
    /// Its name.
    #[must_use]
    pub const fn name(&self) -> &Name {
        match self {
            Self::Worker(name) | Self::Printer(name) => name,
        }
    }
}

impl Claim {
    /// When a claim lapses that is made or renewed now.
    #[must_use]
    pub fn until(now: Timestamp) -> Timestamp {
        now.checked_add(SignedDuration::from_secs(LEASE_S)).unwrap_or(Timestamp::MAX)
    }

    /// Whether its holder has not been heard of for too long.
    #[must_use]
    pub fn has_lapsed(&self, now: Timestamp) -> bool {
        self.until <= now
    }
}
