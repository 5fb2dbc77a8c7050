//! The USB devices behind serial ports (IO: reads `/sys`).
//!
//! A printer is known by vendor, product and serial number; the name of its port changes with the order in which devices are
//! plugged in. Boards without a serial number of their own are known by the socket that they are plugged into.

use super::error::PortProblem;
use serde::Serialize;
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

/// Where Linux lists terminals.
const CLASS: &str = "/sys/class/tty";
/// How far above a terminal its USB device stands.
const MAX_DEPTH: usize = 6;

/// A USB device.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Device {
    /// Vendor, four hexadecimal digits.
    pub vendor: String,
    /// Product, four hexadecimal digits.
    pub product: String,
    /// Serial number, where it has one.
    pub serial: Option<String>,
    /// Bus and sockets that it is plugged into (`1-1.2`), where it was seen.
    #[serde(skip)]
    pub socket: Option<String>,
}

impl fmt::Display for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "usb:{}:{}", self.vendor, self.product)?;
        self.serial.as_ref().map_or(Ok(()), |serial| write!(f, ":{serial}"))
    }
}

impl Device {
    /// `usb:VENDOR:PRODUCT[:SERIAL]`, as [`fmt::Display`] writes it.
    #[must_use]
    pub fn named(text: &str) -> Option<Self> {
        let mut parts = text.strip_prefix("usb:")?.splitn(3, ':');
        let mut id = || parts.next().filter(|id| id.len() == 4 && id.bytes().all(|b| b.is_ascii_hexdigit()));
        let (vendor, product) = (id()?.to_ascii_lowercase(), id()?.to_ascii_lowercase());
        let serial = parts.next().filter(|s| !s.is_empty()).map(str::to_owned);
        Some(Self { vendor, product, serial, socket: None })
    }

    /// Whether `other` may be this device. One that was seen is known by its serial number, without one by its socket; one that is
    /// named without either may be any.
    fn fits(&self, other: &Self) -> bool {
        let is_same = match (&self.serial, &self.socket) {
            (Some(_), _) => self.serial == other.serial,
            (None, Some(_)) => other.serial.is_none() && self.socket == other.socket,
            (None, None) => true,
        };
        self.vendor == other.vendor && self.product == other.product && is_same
    }
}

/// The USB device behind the terminal at `path`; nothing for other terminals.
#[must_use]
pub fn behind(path: &Path) -> Option<Device> {
    let name = fs::canonicalize(path).ok()?;
    of_terminal(&Path::new(CLASS).join(name.file_name()?))
}

fn of_terminal(terminal: &Path) -> Option<Device> {
    let start = fs::canonicalize(terminal.join("device")).ok()?;
    let usb = start.ancestors().take(MAX_DEPTH).find(|dir| dir.join("idVendor").is_file())?;
    let read = |file: &str| fs::read_to_string(usb.join(file)).ok().map(|text| text.trim().to_owned());
    Some(Device {
        vendor: read("idVendor")?.to_ascii_lowercase(),
        product: read("idProduct")?.to_ascii_lowercase(),
        serial: read("serial").filter(|serial| !serial.is_empty()),
        socket: usb.file_name().map(|name| name.to_string_lossy().into_owned()),
    })
}

/// The terminal of a device.
///
/// # Errors
/// [`PortProblem::Missing`] where it is not plugged in, [`PortProblem::Ambiguous`] where several are that it may be.
pub fn path_of(wanted: &Device) -> Result<PathBuf, PortProblem> {
    path_within(Path::new(CLASS), wanted)
}

fn path_within(class: &Path, wanted: &Device) -> Result<PathBuf, PortProblem> {
    let Ok(entries) = fs::read_dir(class) else { return Err(PortProblem::Missing) };
    let fits = |entry: fs::DirEntry| {
        let found = of_terminal(&entry.path()).filter(|found| wanted.fits(found))?;
        Some((found, Path::new("/dev").join(entry.file_name())))
    };
    let mut found: Vec<(Device, PathBuf)> = entries.filter_map(Result::ok).filter_map(fits).collect();
    // A board may have several terminals; the first speaks to the firmware.
    found.sort_by(|a, b| (&a.0.socket, &a.1).cmp(&(&b.0.socket, &b.1)));
    found.dedup_by(|a, b| a.0.socket == b.0.socket);
    match found.as_slice() {
        [] => Err(PortProblem::Missing),
        [(_, path)] => Ok(path.clone()),
        several => Err(PortProblem::Ambiguous(several.len())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_is_read_as_it_is_written() {
        let device = Device {
            vendor: "2c99".into(),
            product: "0002".into(),
            serial: Some("CZP:X1".into()),
            socket: None,
        };
        assert_eq!(Device::named(&device.to_string()), Some(device));
        assert_eq!(Device::named("usb:1A86:7523").unwrap().to_string(), "usb:1a86:7523");
        for text in ["/dev/ttyUSB0", "usb:", "usb:12:34", "usb:zzzz:0001", "usb:1a86"] {
            assert_eq!(Device::named(text), None, "{text}");
        }
    }

    /// Plugs a board into a made-up machine.
    fn plug(machine: &Path, socket: &str, terminal: &str, serial: Option<&str>) {
        let usb = machine.join("devices/usb1").join(socket);
        let port = usb.join("1.0").join(terminal);
        fs::create_dir_all(&port).unwrap();
        let files = [("idVendor", Some("1a86\n")), ("idProduct", Some("7523\n")), ("serial", serial)];
        for (file, text) in files.into_iter().filter_map(|(file, text)| Some((file, text?))) {
            fs::write(usb.join(file), text).unwrap();
        }
        let class = machine.join("class").join(terminal);
        fs::create_dir_all(&class).unwrap();
        std::os::unix::fs::symlink(&port, class.join("device")).unwrap();
    }

    #[test]
    fn a_device_is_found_in_the_tree_above_its_terminal() {
        let dir = tempfile::tempdir().unwrap();
        plug(dir.path(), "1-1", "ttyUSB0", Some("A5\n"));
        let device = of_terminal(&dir.path().join("class/ttyUSB0")).unwrap();
        assert_eq!(
            (device.to_string().as_str(), device.socket.as_deref()),
            ("usb:1a86:7523:A5", Some("1-1"))
        );
        assert!(Device::named("usb:1a86:7523").unwrap().fits(&device));
        assert!(!Device::named("usb:1a86:7523:B6").unwrap().fits(&device));
    }

    #[test]
    fn boards_without_a_serial_number_are_known_by_their_sockets() {
        let dir = tempfile::tempdir().unwrap();
        let class = dir.path().join("class");
        let any = Device::named("usb:1a86:7523").unwrap();
        plug(dir.path(), "1-1", "ttyUSB0", None);
        plug(dir.path(), "1-1", "ttyUSB3", None);
        let first = of_terminal(&class.join("ttyUSB0")).unwrap();
        assert_eq!(path_within(&class, &any).unwrap(), Path::new("/dev/ttyUSB0"), "one board, two terminals");
        plug(dir.path(), "1-2", "ttyUSB1", None);
        assert!(matches!(path_within(&class, &any), Err(PortProblem::Ambiguous(2))));
        assert_eq!(path_within(&class, &first).unwrap(), Path::new("/dev/ttyUSB0"));
        fs::remove_dir_all(class.join("ttyUSB0")).unwrap();
        fs::remove_dir_all(class.join("ttyUSB3")).unwrap();
        assert!(matches!(path_within(&class, &first), Err(PortProblem::Missing)), "the other one is not it");
    }

    #[test]
    fn a_pseudo_terminal_is_no_usb_device() {
        assert_eq!(behind(Path::new("/dev/ptmx")), None);
        assert_eq!(behind(Path::new("/nonexistent")), None);
    }
}
