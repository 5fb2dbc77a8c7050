//! Printers: what is loaded, what lies on the bed, what they are doing.

use crate::queue::{Bed, JobId, Loaded, Material, Name, Printer, Reason};
use jiff::Timestamp;
use serde::{Deserialize, Deserializer, Serialize};
use utoipa::ToSchema;

/// A temperature and where it is going.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Heat {
    /// Measured, °C.
    pub actual_c: f64,
    /// Asked for, °C; 0: off.
    pub target_c: f64,
}

/// What a printer is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Activity {
    /// Not connected.
    Offline,
    /// Connected, and doing nothing.
    Idle,
    /// Printing.
    Printing,
    /// About to stop for a while.
    Pausing,
    /// Stopped for a while.
    Paused,
    /// About to give up what it prints.
    Cancelling,
    /// Stopped by a fault.
    Faulted,
}

/// A printer at this moment, as the part of the program knows it that talks to it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Live {
    /// Its name.
    #[schema(value_type = String)]
    pub name: Name,
    /// What it is doing.
    pub activity: Activity,
    /// The job that it has in hand.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>)]
    pub job: Option<JobId>,
    /// Where it is connected.
    pub port: Option<String>,
    /// Speed of the wire, baud.
    pub baud: Option<u32>,
    /// Part of the print that is done, 0 .. 1.
    pub done: Option<f64>,
    /// Time it has printed, s.
    pub printed_s: Option<u64>,
    /// When what it prints ends.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub ends: Option<Timestamp>,
    /// The nozzle.
    pub hotend: Option<Heat>,
    /// The bed.
    pub bed: Option<Heat>,
    /// The fault that stopped it, or what it waits for, in plain words.
    pub says: Option<String>,
    /// How long it usually takes until somebody has cleared its bed, s.
    pub clearing_s: u32,
    /// Hottest that its nozzle may be set to, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_hotend_c: Option<f64>,
    /// Hottest that its bed may be set to, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_bed_c: Option<f64>,
}

impl Live {
    /// One of which nothing is heard.
    #[must_use]
    pub const fn offline(name: Name) -> Self {
        Self {
            name,
            activity: Activity::Offline,
            job: None,
            port: None,
            baud: None,
            done: None,
            printed_s: None,
            ends: None,
            hotend: None,
            bed: None,
            says: None,
            clearing_s: 0,
            max_hotend_c: None,
            max_bed_c: None,
        }
    }
}

/// What is known of a bed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum BedView {
    /// Nothing: nothing starts.
    Unknown,
    /// Nothing lies on it.
    Clear,
    /// This job is printed on it, or what was laid of it lies there.
    Taken(JobId),
}

impl From<Bed> for BedView {
    fn from(bed: Bed) -> Self {
        match bed {
            Bed::Unknown => Self::Unknown,
            Bed::Clear => Self::Clear,
            Bed::Taken(job) => Self::Taken(job),
        }
    }
}

/// What a printer is fitted with.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LoadedBody {
    /// Its profile.
    #[schema(value_type = String)]
    pub profile: Name,
    /// The material.
    #[schema(value_type = String)]
    pub material: Material,
    /// Diameter of the nozzle, µm.
    pub nozzle_um: u32,
    /// Filament left on the spool, mm³; `null`: nobody keeps track.
    #[serde(default)]
    pub left_mm3: Option<u64>,
}

impl From<LoadedBody> for Loaded {
    fn from(LoadedBody { profile, material, nozzle_um, left_mm3 }: LoadedBody) -> Self {
        Self { profile, material, nozzle_um, left_mm3 }
    }
}

impl From<Loaded> for LoadedBody {
    fn from(Loaded { profile, material, nozzle_um, left_mm3 }: Loaded) -> Self {
        Self { profile, material, nozzle_um, left_mm3 }
    }
}

/// A printer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PrinterView {
    /// Its name in the queue.
    #[schema(value_type = String)]
    pub name: Name,
    /// What it is fitted with; `null`: nobody has said.
    pub loaded: Option<LoadedBody>,
    /// What is known of its bed.
    pub bed: BedView,
    /// What it is doing; `null`: it is not this server's.
    pub live: Option<Live>,
}

impl PrinterView {
    /// What the queue knows, and what is heard of it.
    #[must_use]
    pub fn new(printer: &Printer, live: Option<&Live>) -> Self {
        let loaded = printer.loaded.clone().map(Into::into);
        Self { name: printer.name.clone(), loaded, bed: printer.bed.into(), live: live.cloned() }
    }
}

/// All printers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PrinterList {
    /// By name.
    pub printers: Vec<PrinterView>,
}

/// Somebody has looked: nothing lies on the bed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct BedClear {
    /// The job that was taken off: has to be the one that the server knows to be on the bed; `null` where it knows of none. Never
    /// left out, so that the word is not given by accident.
    #[serde(deserialize_with = "is_said")]
    #[schema(value_type = Option<String>, required = true)]
    pub on_bed: Option<JobId>,
    /// The person who has looked, where that is not whoever has the key.
    #[serde(default)]
    #[schema(value_type = Option<String>)]
    pub name: Option<Name>,
    /// What there is to say about it.
    #[serde(default)]
    #[schema(value_type = String)]
    pub why: Reason,
}

/// A field that may be `null`, but not left out.
fn is_said<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<JobId>, D::Error> {
    Option::deserialize(deserializer)
}

/// Whoever says something, and why.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Said {
    /// The person, where that is not whoever has the key.
    #[serde(default)]
    #[schema(value_type = Option<String>)]
    pub name: Option<Name>,
    /// Why.
    #[serde(default)]
    #[schema(value_type = String)]
    pub why: Reason,
}

/// What is asked of a printer itself.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    /// Stop everything at once, in the middle of a print; the printer has to be reset afterwards.
    EmergencyStop,
    /// Open its port, and take jobs.
    Connect,
    /// Close its port, and take none.
    Disconnect,
    /// Lines of G-code, each one command, as they are: not while it prints; for those who know what they do (role `admin`).
    Commands(Vec<String>),
}

/// An order, who gives it, and why.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Ordered {
    /// What.
    pub order: Order,
    /// The person, where that is not whoever has the key.
    #[serde(default)]
    #[schema(value_type = Option<String>)]
    pub name: Option<Name>,
    /// Why.
    #[serde(default)]
    #[schema(value_type = String)]
    pub why: Reason,
}
