//! A job from a file on a port, with what is kept beside the file (IO): the journal, and a picture of the layer in which a print
//! that broke off will go on.

use super::control::Controls;
use super::device::Device;
use super::driver::{self, Order, PrintEvent, Printed};
use super::job::Job;
use super::journal::writer::Journal;
use super::journal::{JobId, Log, Machine, Record, path_for};
use super::resume::Known;
use super::serial::SerialLink;
use super::session::Start;
use super::{Error, job, journal, picture, serial};
use crate::profile::{self, Firmware, Profile};
use crate::progress::CancelToken;
use std::ffi::OsString;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use tokio::sync::mpsc;

/// A job, and the printer for it.
#[derive(Debug, Clone, Copy)]
pub struct Paper<'a> {
    /// The file of G-code.
    pub job: &'a Path,
    /// How to speak to the printer.
    pub profile: &'a Profile,
    /// The profile as the operator named it.
    pub profile_name: &'a str,
    /// A path, or `usb:VENDOR:PRODUCT[:SERIAL]`.
    pub port: &'a str,
    /// Rate of the wire instead of the profile's, 1/s.
    pub baud: Option<u32>,
    /// What the operator asks for meanwhile.
    pub controls: &'a Controls,
}

/// Events on their way to the listener.
const EVENT_QUEUE: usize = 256;

/// The firmware, not to be reset when its port is opened: what it knows is what can be gone on with.
#[must_use]
pub fn undisturbed(profile: &Profile) -> Firmware {
    Firmware { reset_on_open: false, ..profile.firmware.clone() }
}

/// The journal of a job's last print.
///
/// # Errors
/// [`Error::Journal`].
pub fn log_of(job: &Path) -> Result<Log, Error> {
    Ok(Log::read(&path_for(job))?)
}

/// Refuses to put another job in the place of `job`: while it is printed, and, but with `anew`, where its print broke off and may be
/// gone on with.
///
/// # Errors
/// [`Error::BeingPrinted`], [`Error::Unfinished`]; [`Error::Journal`] where the journal cannot be read.
pub fn refuse_replacing(job: &Path, anew: bool) -> Result<(), Error> {
    if !job.exists() {
        return Ok(());
    }
    lock(job)?;
    match unfinished(job) {
        // Nothing of ours, and nothing that a new job would touch.
        Err(Error::Journal(journal::Error::Foreign(_))) => Ok(()),
        Ok(None) => Ok(()),
        Ok(Some(_)) | Err(_) if anew => Ok(()),
        // It was replaced already: there is nothing left to spare.
        Ok(Some(log)) if hash_of(job)? != log.job.hash => Ok(()),
        Ok(Some(log)) => Err(broke_off(job, &log)),
        Err(error) => Err(error),
    }
}

/// The journal of a job's last print, where that broke off.
fn unfinished(job: &Path) -> Result<Option<Log>, Error> {
    let log = match log_of(job) {
        Ok(log) => log,
        Err(Error::Journal(journal::Error::Missing(_) | journal::Error::NotBegun(_))) => return Ok(None),
        Err(error) => return Err(error),
    };
    let is_over = matches!(log.end, Some(journal::Ending::Finished | journal::Ending::Cancelled));
    Ok((!is_over && log.progress.n_sent > 0).then_some(log))
}

fn broke_off(job: &Path, log: &Log) -> Error {
    let (n_done, n_lines) = (log.progress.n_certain, log.job.n_lines);
    Error::Unfinished { job: job.display().to_string(), n_done, n_lines }
}

/// BLAKE3 of a job's bytes.
fn hash_of(job: &Path) -> Result<String, Error> {
    let unreadable = |source| job::Error::Read { name: job.display().to_string(), source };
    let mut hasher = blake3::Hasher::new();
    let mut file = File::open(job).map_err(unreadable)?;
    std::io::copy(&mut file, &mut hasher).map_err(unreadable)?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// The job is this process's own as long as this lives: two prints of one job would write one journal. A file system that knows no
/// locks is believed.
fn lock(job: &Path) -> Result<Option<File>, Error> {
    let Ok(file) = File::open(job) else { return Ok(None) };
    match file.try_lock() {
        Err(std::fs::TryLockError::WouldBlock) => Err(Error::BeingPrinted { job: job.display().to_string() }),
        Ok(()) | Err(std::fs::TryLockError::Error(_)) => Ok(Some(file)),
    }
}

/// The profile that a journal names, as it is loaded: a built-in one, or a file beside the job.
#[must_use]
pub fn profile_of(job: &Path, log: &Log) -> String {
    let name = &log.machine.profile;
    let beside = job.with_file_name(name);
    if beside.is_file() { beside.display().to_string() } else { name.clone() }
}

/// The name of a profile's file alone: its path may name somebody.
fn without_folders(profile_name: &str) -> String {
    Path::new(profile_name).file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// What is kept of a port: a device's name whole, of any other path its last part, for its folders may name somebody.
#[must_use]
pub fn port_kept(port: &str) -> String {
    let is_device = port.starts_with("/dev/") || Device::named(port).is_some();
    if is_device { port.to_owned() } else { without_folders(port) }
}

/// Refuses another printer, and a profile that has changed: its numbers are what the place was reckoned with.
fn check_machine(now: &Machine, before: &Machine) -> Result<(), Error> {
    if now.profile_hash != before.profile_hash {
        let found = format!("the profile {}", now.profile);
        let expected = if now.profile == before.profile {
            format!("the profile {}, which has changed since", before.profile)
        } else {
            format!("the profile {}", before.profile)
        };
        return Err(Error::OtherMachine { found, expected });
    }
    match (&now.device, &before.device) {
        (Some(found), Some(expected)) if found != expected => {
            Err(Error::OtherMachine { found: found.clone(), expected: expected.clone() })
        }
        _ => Ok(()),
    }
}

/// How long a print has been away: since its journal was written last, s. Without end where the clock does not know, because it was
/// set back or has not been set yet: then the motors may have let go long ago.
fn away_s(job: &Path) -> f64 {
    let written = std::fs::metadata(path_for(job)).and_then(|data| data.modified());
    written.ok().and_then(|at| at.elapsed().ok()).map_or(f64::INFINITY, |away| away.as_secs_f64())
}

/// Where the picture of a job is.
#[must_use]
pub fn picture_path(job: &Path) -> PathBuf {
    let mut name: OsString = job.as_os_str().to_owned();
    name.push(".resume.svg");
    name.into()
}

/// The journal of the last print, put aside until the next one has begun: where no printer answers, nothing is lost.
struct Aside {
    place: PathBuf,
    aside: PathBuf,
}

impl Aside {
    /// Nothing where there is none, or where it cannot be moved.
    fn of(place: PathBuf) -> Option<Self> {
        let mut name = place.as_os_str().to_owned();
        name.push(".before");
        let aside = PathBuf::from(name);
        std::fs::rename(&place, &aside).ok()?;
        Some(Self { place, aside })
    }

    /// Puts it back unless another print has begun.
    fn settle(self, has_begun: bool) {
        let settled = if has_begun {
            std::fs::remove_file(&self.aside)
        } else {
            std::fs::rename(&self.aside, &self.place)
        };
        if let Err(error) = settled {
            tracing::debug!(%error, "the last journal stays aside");
        }
    }
}

impl Paper<'_> {
    /// Prints from the beginning, with a journal beside the job; over a print that broke off only if `anew`. Must be called within a
    /// tokio runtime.
    ///
    /// # Errors
    /// As [`driver::run`]; [`Error::Unfinished`]; also where the journal cannot be begun.
    pub async fn print(
        &self,
        anew: bool,
        events: &mpsc::Sender<PrintEvent>,
        cancel: &CancelToken,
    ) -> Result<Printed, Error> {
        let _lock = lock(self.job)?;
        self.refuse_unfinished(anew)?;
        let job = self.open_job()?;
        let link = self.open_port(&self.profile.firmware).await?;
        let records = [Record::Job(self.job_id(&job)?), Record::Machine(self.machine(&link))];
        let before = Aside::of(path_for(self.job));
        let printed = match Journal::create(&path_for(self.job), &records) {
            Ok(journal) => {
                let (start, controls) = (Start::Fresh, self.controls.clone());
                let order = Order { job, start, journal: Some(journal), controls };
                driver::run(order, link, &self.profile_at_rate(), events, cancel).await
            }
            Err(error) => Err(error.into()),
        };
        if let Some(before) = before {
            before.settle(log_of(self.job).is_ok_and(|log| log.progress.n_sent > 0));
        }
        if matches!(printed, Err(Error::PortVanished { .. } | Error::Fault { .. })) {
            self.draw_last();
        }
        printed
    }

    /// Goes on where the last print of the job broke off: exactly, where the printer still lives; after a reset only
    /// with `after_reset`. Must be called within a tokio runtime.
    ///
    /// # Errors
    /// As [`driver::run`]; [`Error::Journal`], [`Error::OtherJob`].
    pub async fn resume(
        &self,
        after_reset: bool,
        events: &mpsc::Sender<PrintEvent>,
        cancel: &CancelToken,
    ) -> Result<Printed, Error> {
        let _lock = lock(self.job)?;
        let (log, away_s) = (log_of(self.job)?, away_s(self.job));
        let job = self.open_job()?;
        self.check_same(&job, &log)?;
        match log.end {
            Some(journal::Ending::Finished) => return Err(super::resume::Refusal::Finished.into()),
            Some(journal::Ending::Cancelled) => return Err(super::resume::Refusal::Cancelled.into()),
            Some(journal::Ending::Faulted(_)) | None => {}
        }
        self.draw_last();
        let link = self.open_port(&undisturbed(self.profile)).await?;
        check_machine(&self.machine(&link), &log.machine)?;
        let journal = Journal::append_to(&path_for(self.job))?;
        let known = Box::new(Known { away_s: Some(away_s), ..Known::from(&log) });
        let order = Order {
            job,
            start: Start::Resume { known, after_reset },
            journal: Some(journal),
            controls: self.controls.clone(),
        };
        let mut printed = self.run_drawn(order, link, events, cancel).await;
        if let Err(Error::NeedsConsent { recovery, .. }) = &mut printed
            && self.draw(recovery.n_done, recovery.n_twice)
        {
            recovery.picture = Some(picture_path(self.job).display().to_string());
        }
        printed
    }

    /// Runs; where it goes on exactly, the picture shows that place. It is drawn on another thread: the job may be long.
    async fn run_drawn(
        &self,
        order: Order<BufReader<File>>,
        link: SerialLink,
        events: &mpsc::Sender<PrintEvent>,
        cancel: &CancelToken,
    ) -> Result<Printed, Error> {
        let (sender, mut heard) = mpsc::channel(EVENT_QUEUE);
        let running = async {
            let sender = sender;
            driver::run(order, link, &self.profile_at_rate(), &sender, cancel).await
        };
        let passing = async {
            while let Some(event) = heard.recv().await {
                if let PrintEvent::WentOn { n_lines_done } = event {
                    let (job, profile) = (self.job.to_owned(), self.profile.clone());
                    tokio::task::spawn_blocking(move || draw(&job, &profile, n_lines_done, 0));
                }
                // A listener that is gone changes nothing about the print.
                events.send(event).await.ok();
            }
        };
        tokio::join!(running, passing).0
    }

    /// The way back to a print that broke off must not be lost by accident, nor a print begun on its part: neither where its journal
    /// cannot be read, unless `anew`. Something else of this name is never replaced.
    fn refuse_unfinished(&self, anew: bool) -> Result<(), Error> {
        match unfinished(self.job) {
            Ok(None) => Ok(()),
            Err(error @ Error::Journal(journal::Error::Foreign(_))) => Err(error),
            Ok(Some(_)) | Err(_) if anew => Ok(()),
            Ok(Some(log)) if hash_of(self.job)? != log.job.hash => {
                let journal = path_for(self.job).display().to_string();
                Err(Error::OtherJob { job: self.job.display().to_string(), journal })
            }
            Ok(Some(log)) => Err(broke_off(self.job, &log)),
            Err(error) => Err(error),
        }
    }

    fn open_job(&self) -> Result<Job<BufReader<File>>, Error> {
        Ok(Job::from_file(self.job, &self.profile.firmware)?)
    }

    async fn open_port(&self, firmware: &Firmware) -> Result<SerialLink, Error> {
        serial::open(Path::new(self.port), firmware, self.baud).await
    }

    /// The profile with the rate that the wire really has: how much may be in flight depends on it.
    fn profile_at_rate(&self) -> Profile {
        let mut profile = self.profile.clone();
        profile.firmware.baud = self.baud.unwrap_or(profile.firmware.baud);
        profile
    }

    fn machine(&self, link: &SerialLink) -> Machine {
        Machine {
            profile: without_folders(self.profile_name),
            profile_hash: blake3::hash(profile::to_toml(self.profile).as_bytes()).to_hex().to_string(),
            port: port_kept(self.port),
            device: link.device().map(ToString::to_string),
        }
    }

    fn job_id(&self, job: &Job<BufReader<File>>) -> Result<JobId, Error> {
        Ok(JobId { hash: hash_of(self.job)?, n_lines: job.n_lines() })
    }

    fn check_same(&self, job: &Job<BufReader<File>>, log: &Log) -> Result<(), Error> {
        if hash_of(self.job)? == log.job.hash && job.n_lines() == log.job.n_lines {
            return Ok(());
        }
        let journal = path_for(self.job).display().to_string();
        Err(Error::OtherJob { job: self.job.display().to_string(), journal })
    }

    /// Draws what the journal says.
    fn draw_last(&self) {
        if let Ok(log) = log_of(self.job) {
            let n_done = log.progress.n_certain;
            self.draw(n_done, log.progress.n_sent.saturating_sub(n_done));
        }
    }

    fn draw(&self, n_done: u64, n_doubt: u64) -> bool {
        draw(self.job, self.profile, n_done, n_doubt)
    }
}

/// Draws the layer behind `n_done` lines; whether it could. A picture is a help: a print does not fail for want of one.
fn draw(job: &Path, profile: &Profile, n_done: u64, n_doubt: u64) -> bool {
    let drawn = Job::from_file(job, &profile.firmware)
        .and_then(|mut job| picture::svg(&mut job, profile, n_done, n_doubt))
        .map(|svg| write_private(&picture_path(job), svg.as_bytes()));
    let is_there = matches!(drawn, Ok(Ok(())));
    if !is_there {
        tracing::warn!("the picture of where the print will go on could not be written");
    }
    is_there
}

/// Whole or not at all; readable by its owner alone.
fn write_private(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    use std::io::Write;
    let dir = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut file = tempfile::Builder::new().prefix(".lumenfab-").tempfile_in(dir)?;
    file.write_all(bytes)?;
    file.persist(path)?;
    Ok(())
}

#[cfg(test)]
mod tests;
