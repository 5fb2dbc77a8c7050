//! Arguments of the appliance and of its clients.

use crate::queue::{JobId, Material, Name, Reason};
use crate::tui::Theme;
use clap::{ArgGroup, Args, Subcommand};
use jiff::Timestamp;
use std::path::PathBuf;

/// Where the server lives.
#[derive(Debug, Args, Default)]
pub(crate) struct StateArgs {
    /// State directory: queue, files, socket, configuration [default: $STATE_DIRECTORY, else lumenfab in the user's state
    /// directory]
    #[arg(long, value_name = "DIR", global = true)]
    pub(crate) state: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub(crate) struct ServeArgs {
    #[command(flatten)]
    pub(crate) state: StateArgs,
}

#[derive(Debug, Args)]
pub(crate) struct TuiArgs {
    #[command(flatten)]
    pub(crate) state: StateArgs,
    /// How it looks: dark, light, no-colour or high-contrast [default: dark; no-colour where NO_COLOR is set]
    #[arg(long, value_name = "NAME", value_parser = theme)]
    pub(crate) theme: Option<Theme>,
}

fn theme(name: &str) -> Result<Theme, String> {
    let names = || Theme::ALL.map(Theme::name).join(", ");
    Theme::named(name).ok_or_else(|| format!("expected one of {}", names()))
}

#[derive(Debug, Args)]
pub(crate) struct BackupArgs {
    #[command(flatten)]
    pub(crate) state: StateArgs,
    /// The backup, a ZIP archive
    #[arg(value_name = "FILE")]
    pub(crate) file: PathBuf,
}

#[derive(Debug, Args)]
pub(crate) struct QueueArgs {
    #[command(flatten)]
    pub(crate) state: StateArgs,
    #[command(subcommand)]
    pub(crate) command: QueueCommand,
}

#[derive(Debug, Subcommand)]
pub(crate) enum QueueCommand {
    /// Add a job: a case directory, a file of G-code, or a model
    Add(AddArgs),
    /// Jobs that are not over, in the order in which they are printed
    List {
        /// Those that are over instead, the last one first
        #[arg(long)]
        over: bool,
        /// How many at most
        #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=500))]
        most: u32,
    },
    /// One job
    Show(JobArgs),
    /// Put a draft into the queue
    Submit(SaidArgs),
    /// Keep a job back
    Hold(SaidArgs),
    /// Let a job go that was kept back
    Release(SaidArgs),
    /// Give a job up; what is in print is stopped, its heaters are switched off
    Cancel(SaidArgs),
    /// Pause a print, heaters on
    Pause(SaidArgs),
    /// Let a paused print go on, or one that broke off
    GoOn(SaidArgs),
    /// Print a job again that failed or was given up: only where nothing of it lies on a bed
    Retry(SaidArgs),
    /// Move a job among those of its priority
    Move(MoveArgs),
    /// Change priority, copies or time of a job that is not being printed
    Edit(EditArgs),
    /// Sign off a finished case: I have looked at its report, and it is good
    Accept(SignOffArgs),
    /// Sign off a finished case: I have looked at its report, and it is not good
    Reject(SignOffArgs),
    /// Say what a printer has loaded, and how much is left
    Spool(SpoolArgs),
    /// What is printed next, when each job ends, and why others wait
    Plan,
    /// Say that a bed is clear: I have looked, and taken off what lay there
    ClearBed(BedArgs),
    /// Who did what, when and why
    History {
        /// Of this job alone: its name, or the beginning or end of it
        #[arg(value_name = "JOB")]
        job: Option<String>,
        /// How many records at most
        #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=500))]
        most: u32,
    },
}

#[derive(Debug, Args)]
pub(crate) struct AddArgs {
    /// What is to be printed
    #[arg(value_name = "CASE|JOB.gcode|MODEL")]
    pub(crate) what: PathBuf,
    /// How often
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) copies: u16,
    /// Higher goes first, -128 to 127
    #[arg(long, value_name = "P", default_value_t = 0, allow_hyphen_values = true)]
    pub(crate) priority: i8,
    /// Not before this time, such as 2026-12-24T18:00:00Z
    #[arg(long, value_name = "TIME")]
    pub(crate) not_before: Option<Timestamp>,
    /// Profile that the printer has to have
    #[arg(long, value_name = "NAME", value_parser = |text: &str| Name::try_new(text))]
    pub(crate) profile: Option<Name>,
    /// Material that has to be loaded
    #[arg(long, value_name = "NAME", value_parser = |text: &str| Material::try_new(text))]
    pub(crate) material: Option<Material>,
    /// Somebody signs off at the end
    #[arg(long)]
    pub(crate) sign_off: bool,
    /// Only a draft, to be submitted later
    #[arg(long)]
    pub(crate) draft: bool,
    /// Why
    #[arg(long, value_name = "TEXT", default_value = "", value_parser = |text: &str| Reason::try_new(text), hide_default_value = true)]
    pub(crate) why: Reason,
}

#[derive(Debug, Args)]
pub(crate) struct JobArgs {
    /// Its name, or the beginning or end of it, where that is the only one
    #[arg(value_name = "JOB")]
    pub(crate) job: String,
}

#[derive(Debug, Args)]
pub(crate) struct SaidArgs {
    #[command(flatten)]
    pub(crate) job: JobArgs,
    /// Why
    #[arg(long, value_name = "TEXT", default_value = "", value_parser = |text: &str| Reason::try_new(text), hide_default_value = true)]
    pub(crate) why: Reason,
}

#[derive(Debug, Args)]
#[command(group = ArgGroup::new("place").required(true).args(["first", "last", "before", "behind"]))]
pub(crate) struct MoveArgs {
    #[command(flatten)]
    pub(crate) said: SaidArgs,
    /// Before all others
    #[arg(long)]
    pub(crate) first: bool,
    /// Behind all others
    #[arg(long)]
    pub(crate) last: bool,
    /// Just before this one
    #[arg(long, value_name = "JOB")]
    pub(crate) before: Option<JobId>,
    /// Just behind this one
    #[arg(long, value_name = "JOB")]
    pub(crate) behind: Option<JobId>,
}

#[derive(Debug, Args)]
pub(crate) struct BedArgs {
    /// Of which printer [default: the only one whose bed is not clear]
    #[arg(long, value_name = "NAME", value_parser = |text: &str| Name::try_new(text))]
    pub(crate) printer: Option<Name>,
    /// Why
    #[arg(long, value_name = "TEXT", default_value = "", value_parser = |text: &str| Reason::try_new(text), hide_default_value = true)]
    pub(crate) why: Reason,
}

#[derive(Debug, Args)]
#[command(group = ArgGroup::new("edit").required(true).multiple(true).args(["priority", "copies", "not_before", "any_time"]))]
pub(crate) struct EditArgs {
    #[command(flatten)]
    pub(crate) said: SaidArgs,
    /// Higher goes first, -128 to 127
    #[arg(long, value_name = "P", allow_hyphen_values = true)]
    pub(crate) priority: Option<i8>,
    /// How often it is printed, those included that are printed already
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) copies: Option<u16>,
    /// Not before this time, such as 2026-12-24T18:00:00Z
    #[arg(long, value_name = "TIME", conflicts_with = "any_time")]
    pub(crate) not_before: Option<Timestamp>,
    /// As soon as its turn comes
    #[arg(long)]
    pub(crate) any_time: bool,
}

#[derive(Debug, Args)]
pub(crate) struct SignOffArgs {
    #[command(flatten)]
    pub(crate) job: JobArgs,
    /// Who has looked at the report
    #[arg(long, value_name = "NAME", value_parser = |text: &str| Name::try_new(text))]
    pub(crate) name: Name,
    /// Why
    #[arg(long, value_name = "TEXT", value_parser = |text: &str| Reason::try_new(text))]
    pub(crate) why: Reason,
}

#[derive(Debug, Args)]
#[command(group = ArgGroup::new("spool").required(true).multiple(true).args(["material", "left_cm3", "untracked", "nozzle_um", "profile"]))]
pub(crate) struct SpoolArgs {
    /// Of which printer [default: the only one]
    #[arg(long, value_name = "NAME", value_parser = |text: &str| Name::try_new(text))]
    pub(crate) printer: Option<Name>,
    /// The material, such as PLA
    #[arg(long, value_name = "NAME", value_parser = |text: &str| Material::try_new(text))]
    pub(crate) material: Option<Material>,
    /// Filament left on the spool, cm³: a full one of 1 kg of PLA has about 800
    #[arg(long, value_name = "V", conflicts_with = "untracked", value_parser = clap::value_parser!(u32).range(..=1_000_000))]
    pub(crate) left_cm3: Option<u32>,
    /// Nobody keeps track of how much is left
    #[arg(long)]
    pub(crate) untracked: bool,
    /// Diameter of the nozzle, µm
    #[arg(long, value_name = "UM", value_parser = clap::value_parser!(u32).range(50..=5000))]
    pub(crate) nozzle_um: Option<u32>,
    /// The profile that its jobs are made for
    #[arg(long, value_name = "NAME", value_parser = |text: &str| Name::try_new(text))]
    pub(crate) profile: Option<Name>,
}
