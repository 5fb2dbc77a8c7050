//! A printer as the queue knows it: what it has loaded, and whether its bed is clear.

use super::fit::Loaded;
use super::{JobId, Name, Refusal};
use serde::{Deserialize, Serialize};

/// What is known of a bed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Bed {
    /// Nothing: nothing starts.
    Unknown,
    /// Nothing lies on it.
    Clear,
    /// This job is printed on it, or what was laid of it lies there.
    Taken(JobId),
}

/// How it is known that a bed is clear.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Evidence {
    /// An operator says so.
    Word,
    /// A sensor has confirmed that the bed-clearing routine succeeded.
    Sensor,
    /// A hook program has.
    Hook,
}

/// What happens to a printer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum PrinterChange {
    /// This is what it is fitted with from now on.
    Load(Loaded),
    /// Its bed is clear.
    Clear(Evidence),
    /// Whatever was known of the bed does not hold any more.
    Doubt,
    /// A job begins on it.
    Take(JobId),
    /// The job that had begun has laid nothing: the bed is as clear as it was, unless it was doubted meanwhile.
    Free(JobId),
    /// So much filament is gone, mm³.
    Use(u64),
}

/// A printer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Printer {
    /// Its name in the queue.
    pub name: Name,
    /// What it is fitted with; `None`: nobody has said.
    pub loaded: Option<Loaded>,
    /// What is known of its bed.
    pub bed: Bed,
    /// Whether the bed was doubted since it was last said to be clear: it is not clear then whatever becomes of the job that has it.
    pub is_doubted: bool,
}

impl Printer {
    /// A printer of which nothing is known.
    #[must_use]
    pub const fn new(name: Name) -> Self {
        Self { name, loaded: None, bed: Bed::Unknown, is_doubted: false }
    }

    /// The printer after a change.
    ///
    /// # Errors
    /// [`Refusal::BedNotClear`] where a job begins on a bed that is not known to be clear; [`Refusal::BedInUse`] where another job has it.
    pub fn apply(&self, change: &PrinterChange) -> Result<Self, Refusal> {
        let mut after = self.clone();
        match change {
            PrinterChange::Load(loaded) => after.loaded = Some(loaded.clone()),
            PrinterChange::Clear(_) => (after.bed, after.is_doubted) = (Bed::Clear, false),
            PrinterChange::Doubt => after.doubt(),
            PrinterChange::Take(job) => {
                self.check_clear()?;
                after.bed = Bed::Taken(*job);
            }
            PrinterChange::Free(job) => {
                self.check_holds(*job)?;
                after.bed = if self.is_doubted { Bed::Unknown } else { Bed::Clear };
            }
            PrinterChange::Use(mm3) => after.use_up(*mm3),
        }
        Ok(after)
    }

    fn doubt(&mut self) {
        self.is_doubted = true;
        if self.bed == Bed::Clear {
            self.bed = Bed::Unknown;
        }
    }

    /// Whether a job may lay material: it has the bed, which was clear when it took it and was not doubted since.
    ///
    /// # Errors
    /// [`Refusal::BedNotClear`], [`Refusal::BedInUse`].
    pub(super) fn check_lay(&self, job: JobId) -> Result<(), Refusal> {
        self.check_holds(job)?;
        if self.is_doubted { Err(Refusal::BedNotClear { printer: self.name.clone() }) } else { Ok(()) }
    }

    fn check_clear(&self) -> Result<(), Refusal> {
        match self.bed {
            Bed::Clear => Ok(()),
            Bed::Unknown | Bed::Taken(_) => Err(Refusal::BedNotClear { printer: self.name.clone() }),
        }
    }

    fn check_holds(&self, job: JobId) -> Result<(), Refusal> {
        self.check_no_other(job)?;
        match self.bed {
            Bed::Taken(_) => Ok(()),
            Bed::Clear | Bed::Unknown => Err(Refusal::BedNotClear { printer: self.name.clone() }),
        }
    }

    /// That no other job has the bed.
    ///
    /// # Errors
    /// [`Refusal::BedInUse`].
    pub(super) fn check_no_other(&self, job: JobId) -> Result<(), Refusal> {
        match self.bed {
            Bed::Taken(found) if found != job => {
                Err(Refusal::BedInUse { printer: self.name.clone(), job: found })
            }
            Bed::Taken(_) | Bed::Clear | Bed::Unknown => Ok(()),
        }
    }

    fn use_up(&mut self, mm3: u64) {
        if let Some(left_mm3) = self.loaded.as_mut().and_then(|loaded| loaded.left_mm3.as_mut()) {
            *left_mm3 = left_mm3.saturating_sub(mm3);
        }
    }
}
