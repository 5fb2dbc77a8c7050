//! G-code to the printer: `print.json`, and `record/` where the printer is the simulated one.
//!
//! The simulated printer is this program started once more (`lumenfab hil-sim ...`), behind a real pseudo-terminal.

mod head;
mod words;

use super::slice::JOB_FILE;
use super::{read_json, to_json};
use crate::app::case::MadeFrom;
use crate::app::commanded;
use crate::app::error::Error;
use crate::app::event::{Event, Stage};
use crate::app::session::{Context, Made, Session};
use crate::app::settings::{Fault, SIMULATED_PORT, SettingError, Settings};
use crate::ct::Warning;
use crate::motion;
use crate::printer::device::{self, Device};
use crate::printer::driver;
use crate::printer::job;
use crate::printer::journal::Ending;
use crate::printer::paper::{self, Paper};
use crate::printer::protocol::Stats;
use crate::printer::sim::{self, Machine, Options};
use crate::printer::{self, PortProblem};
use crate::profile::{self, Profile};
use crate::progress::{Cancelled, Task};
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{BufReader, ErrorKind};
use std::path::Path;
use tokio::sync::mpsc;
use words::show;

/// What the simulated printer laid down.
pub(crate) const RECORD_DIR: &str = "record";
/// How the print went.
pub(crate) const PRINT_FILE: &str = "print.json";
/// Events on their way to the face; more than it can show in a tenth of a second.
const EVENT_QUEUE: usize = 256;

/// How a print went.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Printed {
    /// Whether the printer was the simulated one.
    pub simulated: bool,
    /// Lines of the job, each executed once but for the next ones.
    pub n_lines: u64,
    /// Lines that may have been executed twice, because the print went on after a reset.
    pub n_twice_at_most: u64,
    /// From the first byte to the printer's word that all is executed, s.
    pub elapsed_s: f64,
    /// What happened on the wire.
    pub wire: Stats,
}

impl std::fmt::Display for Printed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let rate = self.n_lines as f64 / self.elapsed_s.max(1e-3);
        if self.simulated {
            f.write_str("on the simulated printer: ")?;
        }
        write!(f, "{} lines, each executed once", self.n_lines)?;
        if self.n_twice_at_most > 0 {
            write!(f, " but for up to {} before the reset, perhaps twice", self.n_twice_at_most)?;
        }
        write!(f, ", {rate:.0} lines/s")?;
        if self.wire.n_resends > 0 {
            write!(f, ", {} refused on the wire and sent again", self.wire.n_resends)?;
        }
        Ok(())
    }
}

impl Printed {
    /// What the operator should look at.
    fn warnings(&self) -> Vec<Warning> {
        let (n_foreign, n_unknown) = (self.wire.n_foreign_commands, self.wire.n_unknown_commands);
        let foreign = (n_foreign > 0).then(|| {
            let text = format!(
                "{n_foreign} damaged lines were taken by the firmware for commands of their own: look at the part"
            );
            Warning::new("printer.foreign_commands", text)
        });
        let unknown = (n_unknown > 0).then(|| {
            let text = format!(
                "{n_unknown} commands are unknown to the firmware: see that the job is for this printer"
            );
            Warning::new("printer.unknown_commands", text)
        });
        foreign.into_iter().chain(unknown).collect()
    }
}

impl Session<'_> {
    /// Prints the job, unless it was printed on that port already.
    ///
    /// # Errors
    /// [`Error`] where there is no job, where the print failed, or where the case cannot be written.
    pub fn print(&mut self) -> Result<(), Error> {
        self.require(Stage::Slice)?;
        let profile = self.profile()?;
        if self.is_simulated() {
            // A process that was killed could not keep in the case that it printed on another one.
            paper::refuse_replacing(&self.case.path(JOB_FILE), self.gives_up_print)?;
        }
        self.stage(Stage::Print, |session, task| session.print_job(&profile, task))
    }

    /// Prints the job once more, where it is a real printer; asked for by name, it is never "done already".
    /// `baud` takes the place of the profile's rate; only with `anew` where the last print broke off.
    ///
    /// # Errors
    /// As [`Session::print`]; also where there cannot be such a printer.
    pub fn print_again(&mut self, baud: Option<u32>, anew: bool) -> Result<(), Error> {
        let settings = self.settings();
        check_printer(&settings.port, baud)?;
        if self.is_simulated() {
            self.give_up_broken_off_print(anew);
            return self.print();
        }
        self.require(Stage::Slice)?;
        let profile = self.profile()?;
        let made_from = self.made_from(Stage::Print)?;
        let because_of = vec!["asked for".to_owned()];
        self.redo(Stage::Print, &made_from, because_of, |session, task| {
            session.do_print(&profile, baud, Manner::FromTheBeginning { anew }, task)
        })
    }

    /// Refuses a printer that cannot be there before hours of work are put into a job for it.
    pub(crate) fn check_printer(&self) -> Result<(), Error> {
        self.profile()?;
        let known = self.case.made_from(Stage::Print).and_then(|m| m.get("port"));
        let printed_there = known == Some(&crate::app::session::hash_of(&self.settings().port));
        if printed_there && !self.is_simulated() {
            return Ok(());
        }
        check_printer(&self.settings().port, None)
    }

    pub(crate) fn print_made_from(&self) -> Result<MadeFrom, Error> {
        Ok(MadeFrom::from([
            ("job", self.case.output_hash(Stage::Slice, JOB_FILE)?),
            ("profile", crate::app::session::hash_of(&self.profile()?)),
            ("port", crate::app::session::hash_of(&self.settings().port)),
        ]))
    }

    /// Whether the printer is the simulated one, so that there is a record of what it laid down.
    #[must_use]
    pub fn is_simulated(&self) -> bool {
        self.settings().port == SIMULATED_PORT
    }

    /// How the job was last printed; where nothing is known of a print, as if it was simulated: it is not there yet.
    pub(crate) fn how_printed(&self) -> Result<How, Error> {
        let job = self.case.path(JOB_FILE);
        let extent = if job.exists() { commanded::extent(&job)? } else { None };
        let path = self.case.path(PRINT_FILE);
        let is_simulated = !path.exists() || read_json::<Kept>(&path)?.simulated;
        Ok(match extent {
            Some(extent) if extent.is_finished && !is_simulated => How::ForReal,
            // The simulated printer takes no job whose real print may go on: that print is the last one.
            Some(extent) if !path.exists() || !(extent.is_finished || extent.is_cancelled) => How::BrokenOff,
            _ => How::Simulated,
        })
    }

    /// How long the print on a real printer took, s, where it was done.
    pub(super) fn printed_s(&self) -> Result<Option<f64>, Error> {
        if self.how_printed()? != How::ForReal {
            return Ok(None);
        }
        Ok(Some(read_json::<Kept>(&self.case.path(PRINT_FILE))?.elapsed_s))
    }

    /// Goes on with the print of the job where it broke off, on the port of that print unless the case now names another real one.
    ///
    /// # Errors
    /// [`Error`] where nothing is known of a print, and as [`Session::print_again`].
    pub fn resume_print(&mut self, baud: Option<u32>, after_reset: bool) -> Result<(), Error> {
        self.require(Stage::Slice)?;
        self.recall_port();
        let profile = self.profile()?;
        let made_from = self.made_from(Stage::Print)?;
        let manner = Manner::Resume { after_reset };
        let because_of = vec!["resumed".to_owned()];
        self.redo(Stage::Print, &made_from, because_of, |session, task| {
            session.do_print(&profile, baud, manner, task)
        })
    }

    /// A process that was killed could not keep in the case where it printed; the journal has it.
    fn recall_port(&mut self) {
        let log = paper::log_of(&self.case.path(JOB_FILE));
        if let Some(log) = log.ok().filter(|_| self.is_simulated()) {
            let port = log.machine.device.unwrap_or(log.machine.port);
            self.case.set_settings(Settings { port, ..self.settings().clone() });
        }
    }

    fn print_job(&self, profile: &Profile, task: &Task<'_>) -> Result<Made, Error> {
        self.do_print(profile, None, Manner::FromTheBeginning { anew: self.gives_up_print }, task)
    }

    fn do_print(
        &self,
        profile: &Profile,
        baud: Option<u32>,
        manner: Manner,
        task: &Task<'_>,
    ) -> Result<Made, Error> {
        let staging = self.case.staging()?;
        let job = self.case.output(Stage::Slice, JOB_FILE)?;
        let record = self.is_simulated().then(|| staging.path().join(RECORD_DIR));
        let (port, profile_name) = (&self.settings().port, &self.settings().profile);
        let order = Order {
            job: &job,
            profile,
            profile_name,
            port,
            baud,
            record: record.as_deref(),
            manner,
            beyond_bed: false,
        };
        self.tell_before(&order);
        let printed = order.print(task, &self.context)?;
        staging.write(PRINT_FILE, &to_json(&printed))?;
        Ok(Made { staging, summary: printed.to_string(), warnings: printed.warnings() })
    }
}

impl Session<'_> {
    /// What the operator might not expect: a port that was remembered, a record that goes with the print that it was of.
    fn tell_before(&self, order: &Order<'_>) {
        let tell = |code, text| (self.context.events)(Event::Told { stage: Stage::Print, code, text });
        if self.is_simulated() {
            return;
        }
        tell(
            "printer.port",
            format!("prints on {} with the profile {}", paper::port_kept(order.port), order.profile.name),
        );
        tell_of_part(order, &self.context);
        if self.case.path(RECORD_DIR).exists() {
            let text =
                "what the simulated printer has laid down (record/) is removed when this print is done";
            tell("print.record", text.to_owned());
        }
    }
}

/// Nobody but the operator knows whether the part of the last print is off the bed.
fn tell_of_part(order: &Order<'_>, context: &Context<'_>) {
    let is_anew = matches!(order.manner, Manner::FromTheBeginning { .. });
    let was_printed = || paper::log_of(order.job).is_ok_and(|log| log.end == Some(Ending::Finished));
    if is_anew && order.port != SIMULATED_PORT && was_printed() {
        let text = "this job was printed before: its part must be off the bed".to_owned();
        (context.events)(Event::Told { stage: Stage::Print, code: "printer.bed", text });
    }
}

/// What is read back from `print.json`.
#[derive(Deserialize)]
struct Kept {
    simulated: bool,
    #[serde(default)]
    elapsed_s: f64,
}

/// How a job was last printed, as far as the case and its journal tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum How {
    /// On the simulated printer, which records what it lays.
    Simulated,
    /// On a real one, to its end.
    ForReal,
    /// On a real one, which has acknowledged a part of it.
    BrokenOff,
}

/// A printer, as the operator names it.
#[derive(Debug, Clone, Copy)]
pub struct Printer<'a> {
    /// A name, or the path of a profile file.
    pub profile_name: &'a str,
    /// A path, or `sim`, which is what nothing means.
    pub port: Option<&'a str>,
    /// Rate of the wire instead of the profile's, 1/s.
    pub baud: Option<u32>,
}

/// The printer for a file of G-code to be printed; what is missing is found out.
#[derive(Debug, Clone, Copy)]
pub struct FilePrinter<'a> {
    /// A name, or the path of a profile file; without it the one that the job was made for.
    pub profile_name: Option<&'a str>,
    /// A path, or `sim`, which is what nothing means.
    pub port: Option<&'a str>,
    /// Rate of the wire instead of the profile's, 1/s.
    pub baud: Option<u32>,
    /// Whether beads may lie beyond the profile's build space, as on machines whose origin is the bed's middle.
    pub beyond_bed: bool,
}

/// Prints a file of G-code that belongs to no case; only with `anew` where its last print broke off, unless the port is named
/// and simulated.
///
/// # Errors
/// [`Error`] where profile, file or port cannot be used, or where the print failed.
pub fn print_file(
    job: &Path,
    printer: FilePrinter<'_>,
    anew: bool,
    context: &Context<'_>,
) -> Result<Printed, Error> {
    let made_for = head::profile_of(job)?;
    let profile_name = &*head::profile_wanted(printer.profile_name, made_for.as_deref())?;
    let FilePrinter { port, baud, beyond_bed, .. } = printer;
    let port = match port {
        Some(port) => port,
        // It was a real printer: the simulated one is no place to begin it again by accident.
        None => paper::refuse_replacing(job, anew).map(|()| SIMULATED_PORT)?,
    };
    let profile = profile::load::by_name(profile_name)?;
    check_printer(port, baud)?;
    let events = context.events;
    let sink = move |done, total| events(Event::Progress { stage: Stage::Print, done, total });
    let task = Task::new(&sink, context.cancel.clone());
    events(Event::Started(Stage::Print));
    if let Some(text) = made_for.as_deref().and_then(|name| head::misfit(name, &profile)) {
        events(Event::Told { stage: Stage::Print, code: "printer.other_profile", text });
    }
    let manner = Manner::FromTheBeginning { anew };
    let order = Order { job, profile: &profile, profile_name, port, baud, record: None, manner, beyond_bed };
    tell_of_part(&order, context);
    order.print(&task, context).map_err(Error::or_interrupted)
}

/// Goes on with the print of a file where it broke off; what is not named is as it was then.
///
/// # Errors
/// [`Error`] where nothing is known of a print, where profile, file or port cannot be used, or where it cannot go on.
pub fn resume_file(job: &Path, printer: ResumePrinter<'_>, context: &Context<'_>) -> Result<Printed, Error> {
    let log = paper::log_of(job)?;
    let known_profile = paper::profile_of(job, &log);
    let profile_name = printer.profile_name.unwrap_or(&known_profile);
    let known_port = log.machine.device.as_deref().unwrap_or(&log.machine.port);
    let port = printer.port.unwrap_or(known_port);
    let profile = profile::load::by_name(profile_name)?;
    check_real(port)?;
    check_printer(port, printer.baud)?;
    let events = context.events;
    let sink = move |done, total| events(Event::Progress { stage: Stage::Print, done, total });
    let task = Task::new(&sink, context.cancel.clone());
    events(Event::Started(Stage::Print));
    let manner = Manner::Resume { after_reset: printer.after_reset };
    let baud = printer.baud;
    // It was looked at when it was begun.
    let beyond_bed = true;
    let order = Order { job, profile: &profile, profile_name, port, baud, record: None, manner, beyond_bed };
    order.print(&task, context).map_err(Error::or_interrupted)
}

/// One thread: what the port says is then heard without waking another one.
pub(super) fn runtime() -> Result<tokio::runtime::Runtime, Error> {
    tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(Error::Runtime)
}

/// The printer that a print is to go on with; what is missing is as it was.
#[derive(Debug, Clone, Copy)]
pub struct ResumePrinter<'a> {
    /// A name, or the path of a profile file.
    pub profile_name: Option<&'a str>,
    /// A path.
    pub port: Option<&'a str>,
    /// Rate of the wire instead of the profile's, 1/s.
    pub baud: Option<u32>,
    /// Whether it may go on after a reset, by recovery moves.
    pub after_reset: bool,
}

/// The simulated printer ends with the program that started it.
pub(super) fn check_real(port: &str) -> Result<(), SettingError> {
    if port != SIMULATED_PORT {
        return Ok(());
    }
    let expected = "the port of a real printer, or the link of a running hil-sim";
    let fault =
        Fault { found: format!("{SIMULATED_PORT}, which ends with every print"), expected: expected.into() };
    Err(SettingError { name: std::borrow::Cow::Borrowed("port"), fault })
}

/// Says early what starting the print would say late.
pub(super) fn check_printer(port: &str, baud: Option<u32>) -> Result<(), Error> {
    if port == SIMULATED_PORT {
        return check_simulated(baud).map_err(Error::from);
    }
    let problem = match Device::named(port) {
        Some(device) => device::path_of(&device).err(),
        None if Path::new(port).exists() => None,
        None if port.starts_with("usb:") => Some(PortProblem::Malformed),
        None => Some(PortProblem::Missing),
    };
    problem.map_or(Ok(()), |problem| Err(printer::Error::Open { port: port.to_owned(), problem }.into()))
}

/// The simulated printer has no wire.
fn check_simulated(baud: Option<u32>) -> Result<(), SettingError> {
    let refused = |rate| SettingError {
        name: std::borrow::Cow::Borrowed("baud"),
        fault: Fault {
            found: format!("{rate} with the simulated printer"),
            expected: "it together with the --port of a real printer".into(),
        },
    };
    baud.map_or(Ok(()), |rate| Err(refused(rate)))
}

/// How a print is begun.
#[derive(Debug, Clone, Copy)]
enum Manner {
    /// Over a print that broke off only if `anew`.
    FromTheBeginning {
        anew: bool,
    },
    Resume {
        after_reset: bool,
    },
}

/// A print to be done.
struct Order<'a> {
    job: &'a Path,
    manner: Manner,
    profile: &'a Profile,
    /// The profile as it was named.
    profile_name: &'a str,
    port: &'a str,
    /// Rate of the wire instead of the profile's.
    baud: Option<u32>,
    /// Where the simulated printer records what it lays down.
    record: Option<&'a Path>,
    /// Whether beads may lie beyond the profile's build space.
    beyond_bed: bool,
}

impl Order<'_> {
    fn print(&self, task: &Task<'_>, context: &Context<'_>) -> Result<Printed, Error> {
        if matches!(self.manner, Manner::FromTheBeginning { .. }) {
            self.check_space(context)?;
        }
        runtime()?.block_on(async {
            if self.port == SIMULATED_PORT {
                self.print_simulated(task, context).await
            } else {
                let paper = Paper {
                    job: self.job,
                    profile: self.profile,
                    profile_name: self.profile_name,
                    port: self.port,
                    baud: self.baud,
                    controls: &context.controls,
                };
                let (sender, receiver) = mpsc::channel(EVENT_QUEUE);
                let printing = async {
                    let sender = sender;
                    match self.manner {
                        Manner::FromTheBeginning { anew } => {
                            paper.print(anew, &sender, &context.cancel).await
                        }
                        Manner::Resume { after_reset } => {
                            paper.resume(after_reset, &sender, &context.cancel).await
                        }
                    }
                };
                self.printed(tokio::join!(printing, show(receiver, task, context)).0)
            }
        })
    }

    /// Refuses a job with beads beyond the build space; tells of other moves that leave it.
    fn check_space(&self, context: &Context<'_>) -> Result<(), Error> {
        let failed =
            |source| printer::Error::from(job::Error::Read { name: self.job.display().to_string(), source });
        let file = File::open(self.job).map_err(failed)?;
        let found = match motion::leaving(BufReader::new(file), self.profile.machine.bed_mm) {
            // The printing itself refuses such lines, and by their numbers.
            Err(error) if error.kind() == ErrorKind::InvalidData => None,
            found => found.map_err(failed)?,
        };
        match found {
            Some(leaving) if leaving.is_lost && !self.beyond_bed => Err(Error::BuildSpace {
                job: self.job.to_owned(),
                profile: self.profile.name.clone(),
                leaving,
            }),
            Some(leaving) => {
                let text = format!("{leaving}: a machine that reaches no further stops at its edge");
                (context.events)(Event::Told { stage: Stage::Print, code: "printer.beyond_bed", text });
                Ok(())
            }
            None => Ok(()),
        }
    }

    async fn print_simulated(&self, task: &Task<'_>, context: &Context<'_>) -> Result<Printed, Error> {
        check_resumable(self.manner)?;
        let options = Options {
            program: std::env::current_exe().map_err(Error::Runtime)?,
            leading_args: vec!["hil-sim".into()],
            machine: Machine::of(self.profile, self.profile_name),
            record_dir: self.record.map(Path::to_owned),
            ..Options::default()
        };
        let (sender, receiver) = mpsc::channel(EVENT_QUEUE);
        let printing = async {
            let sender = sender;
            let controls = context.controls.clone();
            sim::print(self.job, &options, self.profile, controls, &sender, &context.cancel).await
        };
        let printed = self.printed(tokio::join!(printing, show(receiver, task, context)).0);
        // Ctrl-C reaches the simulator too: that its port then vanishes leaves nothing hot.
        printed.map_err(|e| if task.check().is_err() { Cancelled.into() } else { e })
    }

    fn printed(&self, printed: Result<driver::Printed, printer::Error>) -> Result<Printed, Error> {
        let printed = printed?;
        Ok(Printed {
            simulated: self.port == SIMULATED_PORT,
            n_lines: printed.n_lines,
            n_twice_at_most: printed.n_twice,
            elapsed_s: printed.elapsed.as_secs_f64(),
            wire: printed.stats,
        })
    }
}

/// A print on the simulated printer that ends with the program cannot be resumed.
fn check_resumable(manner: Manner) -> Result<(), SettingError> {
    match manner {
        Manner::FromTheBeginning { .. } => Ok(()),
        Manner::Resume { .. } => check_real(SIMULATED_PORT),
    }
}
