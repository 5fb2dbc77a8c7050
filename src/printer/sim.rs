//! The simulated printer as a process of its own, behind a real pseudo-terminal.
//!
//! The program is started with `--link PATH`, which it turns into a link to its terminal once it is ready, and `--once`, by which
//! it ends when the port is closed. What it says on stderr is kept for the error message. If this is dropped, so is the process.

use super::control::Controls;
use super::driver::{self, Order, PrintEvent, Printed};
use super::identity::profile_name;
use super::job::Job;
use super::session::Start;
use super::{Error, serial};
use crate::profile::{BeadShape, Dialect, Profile};
use crate::progress::CancelToken;
use std::collections::VecDeque;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::time::Duration;
use tempfile::TempDir;
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::{Child, ChildStderr, Command};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;

/// How long the simulator may take to start.
const START_LIMIT: Duration = Duration::from_secs(15);

/// How long it may take to write its record after the port was closed.
const END_LIMIT: Duration = Duration::from_secs(60);

/// How often its link is looked for.
const LOOK_INTERVAL: Duration = Duration::from_millis(5);

/// Lines of its stderr that are kept.
const KEPT_LINES: usize = 5;

/// A machine to simulate.
#[derive(Debug, Clone, PartialEq)]
pub enum Machine {
    /// One that the simulator knows, by its name: it has figures of its own, which nobody copied from the profile's.
    Known(String),
    /// Any other: one that it knows with the same firmware, but of this size and with these limits. What firmware says of the
    /// rest, the job sets.
    Other(Box<Profile>),
}

impl Machine {
    /// That of a profile, by the name or the file that it was asked for.
    #[must_use]
    pub fn of(profile: &Profile, named: &str) -> Self {
        if profile.name == named {
            Self::Known(named.to_owned())
        } else {
            Self::Other(Box::new(profile.clone()))
        }
    }

    fn args(&self) -> Vec<String> {
        let profile = match self {
            Self::Known(name) => return vec!["--profile".to_owned(), name.clone()],
            Self::Other(profile) => profile,
        };
        let machine = &profile.machine;
        let listed = |figures: &[f64]| figures.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
        let shape = match profile.print.bead_shape {
            BeadShape::Rectangle => "rectangle",
            BeadShape::Stadium => "stadium",
        };
        let pairs = [
            ("--profile", profile_name(profile.firmware.dialect).to_owned()),
            ("--bed-mm", listed(&machine.bed_mm)),
            ("--max-speed-mm-s", listed(&machine.max_speed_mm_s)),
            ("--max-acceleration-mm-s2", listed(&machine.max_acceleration_mm_s2)),
            ("--filament-mm", machine.filament_mm.to_string()),
            ("--bead-shape", shape.to_owned()),
        ];
        pairs.into_iter().flat_map(|(option, value)| [option.to_owned(), value]).collect()
    }
}

impl Default for Machine {
    fn default() -> Self {
        Self::Known(profile_name(Dialect::Marlin).to_owned())
    }
}

/// What to run, and how.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// The program.
    pub program: PathBuf,
    /// What comes before the simulator's own arguments (`hil-sim`, where the program is `lumenfab`).
    pub leading_args: Vec<OsString>,
    /// What it is to be.
    pub machine: Machine,
    /// Where it records what it deposits.
    pub record_dir: Option<PathBuf>,
    /// `realtime`, a factor, or `max`; `max` if none is given.
    pub speed: Option<String>,
    /// Speed of the wire; unlimited if none is given.
    pub baud: Option<u32>,
    /// Faults, as on its command line.
    pub faults: Vec<String>,
    /// Seed of the faults.
    pub seed: Option<u64>,
}

/// Bytes in flight over a link that holds the writer back by itself.
const FLOW_CONTROLLED_WINDOW_BYTES: usize = 4096;

impl Options {
    /// The profile to print with. Without a baud rate the simulator's link is flow-controlled, as USB is: nothing that is
    /// written is lost, so more lines may be in flight than its receive buffer holds.
    #[must_use]
    pub fn profile_for(&self, profile: &Profile) -> Profile {
        let mut profile = profile.clone();
        if self.baud.is_none() {
            let window_bytes = &mut profile.firmware.rx_buffer_bytes;
            *window_bytes = FLOW_CONTROLLED_WINDOW_BYTES.max(*window_bytes);
        }
        profile
    }

    fn args(&self, link: &Path) -> Vec<OsString> {
        let mut args = self.leading_args.clone();
        args.extend(self.machine.args().into_iter().map(OsString::from));
        let mut option = |name: &str, value: OsString| args.extend([name.into(), value]);
        option("--link", link.into());
        option("--speed", self.speed.clone().unwrap_or_else(|| "max".to_owned()).into());
        if let Some(dir) = &self.record_dir {
            option("--record", dir.into());
        }
        if let Some(baud) = self.baud {
            option("--baud", baud.to_string().into());
        }
        if let Some(seed) = self.seed {
            option("--seed", seed.to_string().into());
        }
        for fault in &self.faults {
            option("--fault", fault.into());
        }
        args.push("--once".into());
        args
    }
}

/// Prints a file on a simulated printer that is started for it, and ends with it: nothing of this can be gone on with, so no journal
/// is kept. Must be called within a tokio runtime.
///
/// # Errors
/// As [`driver::run`]; [`Error::Job`]; [`Error::Simulator`].
pub async fn print(
    job: &Path,
    options: &Options,
    profile: &Profile,
    controls: Controls,
    events: &mpsc::Sender<PrintEvent>,
    cancel: &CancelToken,
) -> Result<Printed, Error> {
    let job = Job::from_file(job, &profile.firmware)?;
    let simulator = Simulator::start(options).await?;
    let mut profile = options.profile_for(profile);
    // A process that has ended never comes back.
    profile.firmware.orphan_hold_s = 0.0;
    let link = serial::open(simulator.port(), &profile.firmware, options.baud).await?;
    let order = Order { job, start: Start::Fresh, journal: None, controls };
    let printed = driver::run(order, link, &profile, events, cancel).await?;
    simulator.finish().await?;
    Ok(printed)
}

/// A running simulated printer.
#[derive(Debug)]
pub struct Simulator {
    child: Child,
    said: JoinHandle<VecDeque<String>>,
    link: PathBuf,
    /// Holds the link.
    _dir: TempDir,
}

impl Simulator {
    /// Starts the process and waits until its port is there. Must be called within a tokio runtime.
    ///
    /// # Errors
    /// [`Error::Simulator`]: it cannot be started, ended at once (with what it said), or shows no port in time.
    pub async fn start(options: &Options) -> Result<Self, Error> {
        let dir = TempDir::with_prefix("lumenfab-sim-")
            .map_err(|error| failed(format!("has no place for its port: {error}")))?;
        let link = dir.path().join("port");
        let mut child = Command::new(&options.program)
            .args(options.args(&link))
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .kill_on_drop(true)
            .spawn()
            .map_err(|error| failed(format!("{} cannot be started: {error}", options.program.display())))?;
        let stderr = child.stderr.take().expect("stderr is piped");
        let said = tokio::spawn(keep_last_lines(stderr));
        let mut simulator = Self { child, said, link, _dir: dir };
        simulator.await_port().await?;
        Ok(simulator)
    }

    /// Its port.
    #[must_use]
    pub fn port(&self) -> &Path {
        &self.link
    }

    /// Waits until it has written its record and ended; call this when the port is closed.
    ///
    /// # Errors
    /// [`Error::Simulator`]: it failed, or does not end.
    pub async fn finish(mut self) -> Result<(), Error> {
        match tokio::time::timeout(END_LIMIT, self.child.wait()).await {
            Ok(Ok(status)) if status.success() => Ok(()),
            Ok(Ok(status)) => Err(self.ended(status).await),
            Ok(Err(error)) => Err(failed(format!("cannot be waited for: {error}"))),
            Err(_elapsed) => {
                Err(failed(format!("did not end within {} s of the print", END_LIMIT.as_secs())))
            }
        }
    }

    async fn await_port(&mut self) -> Result<(), Error> {
        let limit = tokio::time::Instant::now() + START_LIMIT;
        while !self.link.exists() {
            let ended = self.child.try_wait();
            if let Some(status) = ended.map_err(|e| failed(format!("cannot be waited for: {e}")))? {
                return Err(self.ended(status).await);
            }
            if tokio::time::Instant::now() > limit {
                return Err(failed(format!("shows no port after {} s", START_LIMIT.as_secs())));
            }
            tokio::time::sleep(LOOK_INTERVAL).await;
        }
        Ok(())
    }

    async fn ended(&mut self, status: ExitStatus) -> Error {
        let said = (&mut self.said).await.unwrap_or_default();
        let said = said.iter().map(String::as_str).collect::<Vec<_>>().join("; ");
        failed(format!("ended with {status}{}{said}", if said.is_empty() { "" } else { ": " }))
    }
}

fn failed(problem: String) -> Error {
    Error::Simulator { problem }
}

async fn keep_last_lines(stderr: ChildStderr) -> VecDeque<String> {
    let mut lines = BufReader::new(stderr).lines();
    let mut kept = VecDeque::new();
    while let Ok(Some(line)) = lines.next_line().await {
        if kept.len() == KEPT_LINES {
            kept.pop_front();
        }
        kept.push_back(line);
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str) -> Options {
        Options {
            program: "/bin/sh".into(),
            leading_args: vec!["-c".into(), script.into()],
            ..Options::default()
        }
    }

    #[test]
    fn all_options_reach_the_command_line() {
        let options = Options {
            record_dir: Some("/r".into()),
            baud: Some(250_000),
            faults: vec!["bit-error:rate=0.01".to_owned()],
            seed: Some(7),
            leading_args: vec!["hil-sim".into()],
            ..shell("")
        };
        let args: Vec<_> =
            options.args(Path::new("/l")).into_iter().map(|a| a.into_string().unwrap()).collect();
        assert_eq!(
            args.join(" "),
            "hil-sim --profile marlin --link /l --speed max --record /r --baud 250000 --seed 7 \
             --fault bit-error:rate=0.01 --once"
        );
    }

    #[test]
    fn a_profile_of_ones_own_is_a_machine_of_its_firmware_with_its_sizes_and_limits() {
        let mut profile = crate::profile::builtin("klipper").unwrap();
        assert_eq!(Machine::of(&profile, "klipper"), Machine::Known("klipper".to_owned()));
        profile.machine.bed_mm = [235.0, 235.5, 250.0];
        let machine = Machine::of(&profile, "lab/mine.toml");
        assert_eq!(
            machine.args().join(" "),
            "--profile klipper --bed-mm 235,235.5,250 --max-speed-mm-s 300,300,15,75 \
             --max-acceleration-mm-s2 3000,3000,100,5000 --filament-mm 1.75 --bead-shape stadium"
        );
    }

    #[test]
    fn a_throttled_wire_keeps_the_window_of_the_profile() {
        let profile = crate::profile::builtin("marlin").unwrap();
        let throttled = Options { baud: Some(115_200), ..shell("") };
        assert_eq!(throttled.profile_for(&profile), profile);
        assert!(shell("").profile_for(&profile).firmware.rx_buffer_bytes > 1000);
    }

    #[tokio::test]
    async fn a_program_that_is_not_there_is_named() {
        let options = Options { program: "/nonexistent/sim".into(), ..shell("") };
        let error = Simulator::start(&options).await.unwrap_err();
        assert!(
            error.to_string().starts_with("the simulated printer /nonexistent/sim cannot be started"),
            "{error}"
        );
    }

    #[tokio::test]
    async fn a_simulator_that_ends_at_once_is_quoted() {
        let error = Simulator::start(&shell("echo no such profile >&2; exit 2")).await.unwrap_err();
        let text = error.to_string();
        assert!(text.contains("exit status: 2: no such profile"), "{text}");
        assert_eq!(error.code(), "printer.simulator");
    }

    #[tokio::test]
    async fn the_end_is_awaited_and_a_failure_told() {
        // $4 is the path of the link: -c SCRIPT --profile NAME --link PATH makes --profile $0.
        let simulator =
            Simulator::start(&shell("touch $3; sleep 0.05; echo disk full >&2; exit 1")).await.unwrap();
        let error = simulator.finish().await.unwrap_err();
        assert!(error.to_string().contains("disk full"), "{error}");
        let simulator = Simulator::start(&shell("touch $3")).await.unwrap();
        simulator.finish().await.unwrap();
    }
}
