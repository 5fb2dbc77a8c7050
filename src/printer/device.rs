//! The USB devices behind serial ports (IO: reads `/sys`).
//!
//! A printer is known by vendor, product and serial number; the name of its port changes with the order in which devices are
//! plugged in. Boards without a serial number of their own are told apart by vendor and product alone.

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
        Some(Self { vendor, product, serial: parts.next().filter(|s| !s.is_empty()).map(str::to_owned) })
    }

    /// Whether `other` may be this device: a serial number that is not asked for may be any.
    fn fits(&self, other: &Self) -> bool {
        self.vendor == other.vendor
            && self.product == other.product
            && self.serial.as_ref().is_none_or(|serial| other.serial.as_ref() == Some(serial))
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
    })
}

/// The terminal of a device, the first by name; nothing where it is not plugged in.
#[must_use]
pub fn path_of(wanted: &Device) -> Option<PathBuf> {
    let entries = fs::read_dir(CLASS).ok()?;
    let fits = |entry: fs::DirEntry| {
        of_terminal(&entry.path()).filter(|found| wanted.fits(found)).map(|_| entry.file_name())
    };
    entries.filter_map(Result::ok).filter_map(fits).min().map(|name| Path::new("/dev").join(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_is_read_as_it_is_written() {
        let device = Device { vendor: "2c99".into(), product: "0002".into(), serial: Some("CZP:X1".into()) };
        assert_eq!(Device::named(&device.to_string()), Some(device));
        assert_eq!(Device::named("usb:1A86:7523").unwrap().to_string(), "usb:1a86:7523");
        for text in ["/dev/ttyUSB0", "usb:", "usb:12:34", "usb:zzzz:0001", "usb:1a86"] {
            assert_eq!(Device::named(text), None, "{text}");
        }
    }

    #[test]
    fn a_device_is_found_in_the_tree_above_its_terminal() {
        let dir = tempfile::tempdir().unwrap();
        let usb = dir.path().join("devices/usb1/1-1");
        let port = usb.join("1-1:1.0/ttyUSB0");
        fs::create_dir_all(&port).unwrap();
        for (file, text) in [("idVendor", "1a86\n"), ("idProduct", "7523\n"), ("serial", "A5\n")] {
            fs::write(usb.join(file), text).unwrap();
        }
        let terminal = dir.path().join("class/ttyUSB0");
        fs::create_dir_all(&terminal).unwrap();
        std::os::unix::fs::symlink(&port, terminal.join("device")).unwrap();
        let device = of_terminal(&terminal).unwrap();
        assert_eq!(device.to_string(), "usb:1a86:7523:A5");
        assert!(Device::named("usb:1a86:7523").unwrap().fits(&device));
        assert!(!Device::named("usb:1a86:7523:B6").unwrap().fits(&device));
    }

    #[test]
    fn a_pseudo_terminal_is_no_usb_device() {
        assert_eq!(behind(Path::new("/dev/ptmx")), None);
        assert_eq!(behind(Path::new("/nonexistent")), None);
    }
}
