//! Serial ports, also pseudo-terminals.
//!
//! Opening a terminal raises DTR and the last close drops it (HUPCL), on which many boards reset. So HUPCL is cleared before
//! the port is used: neither the end of this program nor its death resets a printer. DTR is pulsed only if the
//! profile wants a reset, and only the first time. The port is opened for this program alone. A port that was lost is opened again
//! where the same device is: the one of the same vendor, product and serial number, under whatever name the system gives
//! it; where it is no USB device, the same path.

use super::device::{self, Device};
use super::holder;
use super::link::Link;
use super::{Error, PortProblem};
use crate::profile::Firmware;
use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::termios::{ControlModes, OptionalActions, tcgetattr, tcsetattr};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio_serial::{SerialPort, SerialPortBuilderExt, SerialStream};

/// How long DTR is dropped to reset a board.
const RESET_PULSE: Duration = Duration::from_millis(100);

/// A link over a serial port.
#[derive(Debug)]
pub struct SerialLink {
    name: String,
    path: PathBuf,
    baud: u32,
    device: Option<Device>,
    /// Opened, and not yet given to the driver.
    first: Option<SerialStream>,
}

impl SerialLink {
    /// The USB device behind it, where it is one.
    #[must_use]
    pub const fn device(&self) -> Option<&Device> {
        self.device.as_ref()
    }

    fn fail(&self, problem: PortProblem) -> Error {
        Error::Open { port: self.name.clone(), problem }
    }

    fn open_at(&self, path: &Path) -> Result<SerialStream, Error> {
        let guard = open_without_hangup(path).map_err(|errno| self.fail(problem_of(errno)))?;
        let opened = tokio_serial::new(path.display().to_string(), self.baud).open_native_async();
        let stream = opened.map_err(|error| self.fail(problem_of_opening(&error)))?;
        drop(guard);
        Ok(stream)
    }
}

impl Link for SerialLink {
    type Stream = SerialStream;

    fn name(&self) -> &str {
        &self.name
    }

    async fn open(&mut self) -> Result<SerialStream, Error> {
        if let Some(stream) = self.first.take() {
            return Ok(stream);
        }
        let path = match &self.device {
            Some(device) => device::path_of(device).map_err(|problem| self.fail(problem))?,
            None => self.path.clone(),
        };
        self.open_at(&path)
    }
}

/// Opens the port at `path`, or the one of a USB device (`usb:VENDOR:PRODUCT[:SERIAL]`), at the profile's rate or at `baud`.
/// Must be called within a tokio runtime.
///
/// # Errors
/// [`Error::Open`], with the reason told apart as far as the system tells it.
pub async fn open(path: &Path, firmware: &Firmware, baud: Option<u32>) -> Result<SerialLink, Error> {
    let name = path.display().to_string();
    let fail = |problem| Error::Open { port: name.clone(), problem };
    let path = match Device::named(&name) {
        Some(wanted) => device::path_of(&wanted).map_err(fail)?,
        None => path.to_owned(),
    };
    let device = device::behind(&path);
    let mut link =
        SerialLink { name: name.clone(), path, baud: baud.unwrap_or(firmware.baud), device, first: None };
    let mut stream = link.open_at(&link.path).map_err(|error| with_holder(error, &link.path))?;
    if firmware.reset_on_open {
        reset(&mut stream).await.map_err(|error| link.fail(PortProblem::Other(error.to_string())))?;
    }
    link.first = Some(stream);
    Ok(link)
}

/// Opens the port beside the one that will be used, and clears HUPCL. As long as this one is open, no close is the last.
fn open_without_hangup(path: &Path) -> Result<OwnedFd, Errno> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let port = rustix::fs::open(path, flags, Mode::empty())?;
    let mut settings = tcgetattr(&port)?;
    settings.control_modes.remove(ControlModes::HUPCL);
    tcsetattr(&port, OptionalActions::Now, &settings)?;
    Ok(port)
}

async fn reset(stream: &mut SerialStream) -> tokio_serial::Result<()> {
    stream.write_data_terminal_ready(false)?;
    tokio::time::sleep(RESET_PULSE).await;
    stream.write_data_terminal_ready(true)
}

/// Names the program that has the port. Looked for once, not at each try to open a port that was lost: nobody is told these.
fn with_holder(error: Error, path: &Path) -> Error {
    match error {
        Error::Open { port, problem: PortProblem::Busy(None) } => {
            Error::Open { port, problem: PortProblem::Busy(holder::of(path)) }
        }
        error => error,
    }
}

fn problem_of(errno: Errno) -> PortProblem {
    match errno {
        Errno::NOENT | Errno::NOTDIR | Errno::NODEV | Errno::NXIO => PortProblem::Missing,
        Errno::ACCESS | Errno::PERM => PortProblem::NoRights,
        Errno::BUSY => PortProblem::Busy(None),
        Errno::NOTTY | Errno::ISDIR | Errno::INVAL => PortProblem::NotAPort,
        other => PortProblem::Other(std::io::Error::from(other).to_string()),
    }
}

/// The port exists and is a terminal: what is left is mostly that somebody else has it.
fn problem_of_opening(error: &tokio_serial::Error) -> PortProblem {
    let text = error.to_string();
    if text.contains("lock") || text.contains("busy") {
        return PortProblem::Busy(None);
    }
    match error.kind() {
        tokio_serial::ErrorKind::Io(std::io::ErrorKind::PermissionDenied) => PortProblem::NoRights,
        tokio_serial::ErrorKind::Io(std::io::ErrorKind::NotFound) => PortProblem::Missing,
        _ => PortProblem::Other(text),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn firmware() -> Firmware {
        crate::profile::builtin("marlin").unwrap().firmware
    }

    async fn error_of(path: &Path) -> Error {
        open(path, &firmware(), None).await.unwrap_err()
    }

    #[tokio::test]
    async fn a_port_that_does_not_exist_is_named() {
        let error = error_of(Path::new("/dev/no-such-port")).await;
        assert_eq!(
            error.to_string(),
            "port /dev/no-such-port does not exist; check that the printer is on and connected, and the name of its port"
        );
        assert_eq!(error.code(), "printer.port_missing");
    }

    #[tokio::test]
    async fn a_file_and_a_folder_are_no_ports() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("x");
        std::fs::write(&file, "x").unwrap();
        for path in [file.as_path(), dir.path(), Path::new("/dev/null")] {
            let error = error_of(path).await;
            assert_eq!(error.code(), "printer.not_a_port", "{error}");
        }
    }

    #[tokio::test]
    async fn a_port_in_use_is_told_apart() {
        let (_master, slave) = serialport::TTYPort::pair().unwrap();
        let path = SerialPort::name(&slave).unwrap();
        let _other_program = tokio_serial::new(&*path, 115_200).open_native_async().unwrap();
        let error = error_of(Path::new(&path)).await;
        assert_eq!(error.code(), "printer.port_busy", "{error}");
    }

    #[tokio::test]
    async fn a_port_s_holder_is_named_once() {
        let (_master, slave) = serialport::TTYPort::pair().unwrap();
        let path = SerialPort::name(&slave).unwrap();
        let held = std::fs::File::options().read(true).write(true).open(&path).unwrap();
        let mut child = std::process::Command::new("sleep").arg("60").stdin(held).spawn().unwrap();
        let _locked = tokio_serial::new(&*path, 115_200).open_native_async().unwrap();
        let at_first = error_of(Path::new(&path)).await;
        let lost =
            SerialLink { name: path.clone(), path: path.into(), baud: 115_200, device: None, first: None };
        let later = lost.open_at(&lost.path).unwrap_err();
        child.kill().unwrap();
        child.wait().unwrap();
        let holder = Some(format!("sleep, process {}", child.id()));
        assert!(matches!(&at_first, Error::Open { problem: PortProblem::Busy(told), .. } if *told == holder));
        assert!(matches!(later, Error::Open { problem: PortProblem::Busy(None), .. }), "{later}");
    }

    #[tokio::test]
    async fn an_opened_port_keeps_dtr_when_it_is_closed() {
        let (_master, mut slave) = serialport::TTYPort::pair().unwrap();
        slave.set_exclusive(false).unwrap();
        let path = SerialPort::name(&slave).unwrap();
        drop(open_without_hangup(Path::new(&path)).unwrap());
        let port = open_without_hangup(Path::new(&path)).unwrap();
        assert!(!tcgetattr(&port).unwrap().control_modes.contains(ControlModes::HUPCL));
    }
}
