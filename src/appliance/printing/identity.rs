//! Which machine a printer was when its bed was known last (IO): a name in the configuration may be given to another one.

use super::press::Machine;
use crate::appliance::config::Port;
use crate::appliance::place;
use crate::printer::device::{self, Device};
use crate::queue::Name;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// A machine, as far as it is told from others.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Identity {
    port: String,
    profile: String,
    /// The USB device behind the port, where it is one.
    device: Option<String>,
}

impl Machine {
    /// What is at its port now.
    pub(super) fn identity(&self) -> Identity {
        let device = match &self.port {
            Port::Simulated { .. } => None,
            Port::Path(path) => behind(path),
        };
        Identity { port: self.port_name(), profile: self.profile_name.clone(), device: device.map(told) }
    }
}

fn behind(port: &str) -> Option<Device> {
    match Device::named(port) {
        Some(wanted) => device::behind(&device::path_of(&wanted).ok()?),
        None => device::behind(Path::new(port)),
    }
}

/// A board without a serial number of its own is known by its socket.
fn told(device: Device) -> String {
    match &device.socket {
        Some(socket) if device.serial.is_none() => format!("{device} at {socket}"),
        _ => device.to_string(),
    }
}

/// What all printers of a state directory were. Clones are the same.
#[derive(Debug, Clone)]
pub(in crate::appliance) struct Identities(Arc<Mutex<Known>>);

#[derive(Debug)]
struct Known {
    path: PathBuf,
    machines: BTreeMap<Name, Identity>,
}

impl Identities {
    /// As a file has them; one that cannot be read knows nothing, and what is not known is doubted.
    pub(in crate::appliance) fn open(path: PathBuf) -> Self {
        let text = std::fs::read(&path).unwrap_or_default();
        let machines = serde_json::from_slice(&text).unwrap_or_default();
        Self(Arc::new(Mutex::new(Known { path, machines })))
    }

    /// Whether the printer was this machine.
    pub(super) fn knows(&self, printer: &Name, machine: &Identity) -> bool {
        self.known().machines.get(printer) == Some(machine)
    }

    /// The printer is this machine from now on. Where that cannot be written, the next server doubts it.
    pub(super) fn keep(&self, printer: &Name, machine: Identity) {
        let mut known = self.known();
        known.machines.insert(printer.clone(), machine);
        let text =
            serde_json::to_vec_pretty(&known.machines).expect("names and texts can be written as JSON");
        if let Err(error) = place::replace(&known.path, &text) {
            tracing::warn!(%printer, "bed: {error}");
        }
    }

    fn known(&self) -> std::sync::MutexGuard<'_, Known> {
        // Nothing is left half-done where a thread panicked.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(text: &str) -> Name {
        Name::try_new(text).unwrap()
    }

    fn machine(port: &str, device: Option<&str>) -> Identity {
        Identity { port: port.into(), profile: "marlin".into(), device: device.map(str::to_owned) }
    }

    #[test]
    fn a_machine_is_known_again_by_port_profile_and_device_under_its_printer_s_name() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("printers.json");
        let known = Identities::open(path.clone());
        let left = machine("/dev/ttyUSB0", Some("usb:1a86:7523 at 1-1"));
        assert!(!known.knows(&name("left"), &left));
        known.keep(&name("left"), left.clone());
        known.keep(&name("right"), machine("sim", None));
        let known = Identities::open(path.clone());
        assert!(known.knows(&name("left"), &left) && !known.knows(&name("right"), &left));
        let others = [
            machine("/dev/ttyUSB1", left.device.as_deref()),
            machine("/dev/ttyUSB0", Some("usb:1a86:7523 at 1-2")),
            machine("/dev/ttyUSB0", None),
            Identity { profile: "klipper".into(), ..left.clone() },
        ];
        for other in others {
            assert!(!known.knows(&name("left"), &other), "{other:?}");
        }
        std::fs::write(&path, "{").unwrap();
        assert!(!Identities::open(path).knows(&name("left"), &left));
    }

    #[test]
    fn boards_without_a_serial_number_are_told_apart_by_their_sockets() {
        let board = |serial: Option<&str>, socket: &str| Device {
            vendor: "1a86".into(),
            product: "7523".into(),
            serial: serial.map(str::to_owned),
            socket: Some(socket.into()),
        };
        assert_eq!(told(board(None, "1-1.2")), "usb:1a86:7523 at 1-1.2");
        assert_eq!(told(board(Some("X1"), "1-1.2")), told(board(Some("X1"), "1-3")));
    }
}
