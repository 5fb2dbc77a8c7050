//! What is wrong with an installation, and how it is mended (IO). Reads only: a server may live there, and keeps its ports.

use super::config::{Config, Hook, Port, PrinterConfig};
use super::place::{BootClock, Layout};
use super::printing;
use crate::http::keys::Keys;
use crate::printer::device::{self, Device};
use crate::store::{Sqlite, Store};
use rustix::fs::{Access, access, statvfs};
use rustix::process::geteuid;
use serde::Serialize;
use std::ffi::OsString;
use std::fs::{File, TryLockError};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// With less room on the disk the queue may not be written soon, and with less than the second not at all, bytes.
const LITTLE_ROOM: u64 = 2 << 30;
const NO_ROOM: u64 = 100 << 20;
/// Ports of which the system gives the names in the order in which devices are plugged in.
const UNSTABLE: [&str; 2] = ["/dev/ttyUSB", "/dev/ttyACM"];

/// How something is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case", tag = "is")]
pub enum Condition {
    /// As it should be.
    Good,
    /// It works, but something should be known of it.
    Doubtful {
        /// What to do about it.
        fix: String,
    },
    /// It does not work.
    Wrong {
        /// What to do about it.
        fix: String,
    },
}

/// Something that was looked at.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// What.
    pub part: String,
    /// What was found.
    pub found: String,
    /// How it is.
    #[serde(flatten)]
    pub condition: Condition,
}

impl Finding {
    /// Something that is as it should be.
    pub(crate) fn good(part: &str, found: impl Into<String>) -> Self {
        Self { part: part.to_owned(), found: found.into(), condition: Condition::Good }
    }

    /// Something that works, but should be known.
    pub(crate) fn doubtful(part: &str, found: impl Into<String>, fix: impl Into<String>) -> Self {
        let condition = Condition::Doubtful { fix: fix.into() };
        Self { part: part.to_owned(), found: found.into(), condition }
    }

    /// Something that does not work.
    pub(crate) fn wrong(part: &str, found: impl Into<String>, fix: impl Into<String>) -> Self {
        let condition = Condition::Wrong { fix: fix.into() };
        Self { part: part.to_owned(), found: found.into(), condition }
    }

    /// Whether it does not work.
    #[must_use]
    pub const fn is_wrong(&self) -> bool {
        matches!(self.condition, Condition::Wrong { .. })
    }
}

/// Looks at all of a state directory, its configuration and its printers.
pub async fn examine(layout: &Layout, env: impl Fn(&str) -> Option<OsString>) -> Vec<Finding> {
    let mut findings = vec![directory(layout.dir())];
    // What is not there, or somebody else's, is not touched.
    if findings.iter().any(Finding::is_wrong) {
        return findings;
    }
    findings.extend([room(layout.dir()), clock(&BootClock::of_system()), queue(layout).await]);
    match layout.read_config(env) {
        Ok(config) => {
            findings.push(Finding::good("configuration", names_of(&config)));
            findings.extend(parts_of(&config, layout));
        }
        Err(error) => findings.push(Finding::wrong(
            "configuration",
            error.to_string(),
            "mend these lines; deploy/config.toml explains every key",
        )),
    }
    findings
}

fn names_of(config: &Config) -> String {
    let names: Vec<_> = config.printers.iter().map(|printer| printer.name.as_str()).collect();
    format!("printers: {}", names.join(", "))
}

/// Whether a server has the directory.
#[must_use]
pub fn is_served(layout: &Layout) -> bool {
    let lock = File::open(layout.lock());
    lock.is_ok_and(|lock| matches!(lock.try_lock_shared(), Err(TryLockError::WouldBlock)))
}

fn directory(dir: &Path) -> Finding {
    const PART: &str = "state directory";
    let shown = dir.display();
    let Ok(found) = std::fs::metadata(dir) else {
        return Finding::wrong(
            PART,
            format!("{shown} is not there"),
            "start `lumenfab serve`, which makes it, or name another one with --state",
        );
    };
    if found.uid() != geteuid().as_raw() {
        return Finding::wrong(
            PART,
            format!("{shown} belongs to user {}, and this is user {}", found.uid(), geteuid().as_raw()),
            "ask as its user: `sudo -u lumenfab lumenfab doctor --state DIR`",
        );
    }
    if access(dir, Access::WRITE_OK).is_err() {
        let fix = "mount its disk for writing, and give its owner all rights: `chmod 700`";
        return Finding::wrong(PART, format!("{shown} cannot be written"), fix);
    }
    if found.mode() & 0o077 != 0 {
        let text = format!("{shown} is open to others ({:o})", found.mode() & 0o777);
        return Finding::doubtful(PART, text, "`chmod 700` it; the next start does so, too");
    }
    Finding::good(PART, shown.to_string())
}

fn room(dir: &Path) -> Finding {
    const PART: &str = "disk";
    let Ok(disk) = statvfs(dir) else {
        return Finding::wrong(PART, "the system does not tell its room", "look at the disk: `dmesg`, `df`");
    };
    let free = disk.f_bavail.saturating_mul(disk.f_frsize);
    let found = format!("{:.1} GB free", free as f64 / 1e9);
    let fix = "make room: nothing can be recorded, and so nothing printed, on a full disk";
    match free {
        0..NO_ROOM => Finding::wrong(PART, found, fix),
        NO_ROOM..LITTLE_ROOM => Finding::doubtful(PART, found, fix),
        _ => Finding::good(PART, found),
    }
}

fn clock(clock: &BootClock) -> Finding {
    const PART: &str = "clock";
    match clock.boot {
        Some(_) => Finding::good(PART, "the system tells when the machine was started"),
        None => Finding::doubtful(
            PART,
            "the system does not tell which run of the machine this is: every start asks for a look at every bed",
            "let the server read /proc/sys/kernel/random/boot_id and /proc/uptime and /proc/uptime (no ProcSubset=pid in its unit)",
        ),
    }
}

/// Of a copy: what is examined is not touched.
async fn queue(layout: &Layout) -> Finding {
    const PART: &str = "queue";
    if !layout.queue().is_file() {
        return Finding::doubtful(PART, "there is none yet", "start `lumenfab serve`, which makes it");
    }
    let checked = async {
        let scratch = tempfile::tempdir().map_err(|error| error.to_string())?;
        let copy = scratch.path().join("queue.db");
        Sqlite::snapshot(&layout.queue(), &copy).map_err(|error| error.to_string())?;
        let store = Sqlite::open(&copy).map_err(|error| error.to_string())?;
        let verified = store.verify().await;
        store.close().await;
        verified.map_err(|error| error.to_string())
    };
    match checked.await {
        Ok(()) => Finding::good(PART, "sound, with all of its history"),
        Err(says) => {
            Finding::wrong(PART, says, "keep a copy of the directory, then `lumenfab restore` a backup")
        }
    }
}

fn parts_of(config: &Config, layout: &Layout) -> Vec<Finding> {
    let mut findings = vec![keys(config, layout)];
    if let Some(watch) = &config.watch {
        findings.push(folder(&watch.folder));
    }
    for printer in &config.printers {
        findings.push(profile(printer, layout));
        findings.push(port(printer));
        findings.extend(printer.bed_clear.as_ref().map(|hook| program(printer, hook)));
    }
    findings
}

fn keys(config: &Config, layout: &Layout) -> Finding {
    const PART: &str = "keys";
    match Keys::open(&layout.keys()) {
        Err(error) => {
            Finding::wrong(PART, error.to_string(), "the server does not start before that is mended")
        }
        Ok(keys) if keys.is_empty() && !config.http.tcp.is_empty() => Finding::doubtful(
            PART,
            "there are none, so TCP is not served",
            "make one (POST /api/v1/keys on the socket) and start the server again",
        ),
        Ok(_) => {
            Finding::good(PART, if layout.keys().exists() { "readable, its owner's alone" } else { "none" })
        }
    }
}

fn folder(path: &Path) -> Finding {
    const PART: &str = "watched folder";
    let shown = path.display();
    if !path.is_dir() {
        return Finding::wrong(
            PART,
            format!("{shown} is no folder"),
            "make it, or name another one as watch.folder",
        );
    }
    if access(path, Access::READ_OK | Access::WRITE_OK).is_err() {
        let fix = "give the server's user the right to read and write it: files are moved within it";
        return Finding::wrong(PART, format!("{shown} cannot be read and written"), fix);
    }
    Finding::good(PART, shown.to_string())
}

fn profile(printer: &PrinterConfig, layout: &Layout) -> Finding {
    let part = format!("profile of {}", printer.name);
    match printing::machine(printer, Path::new("lumenfab"), layout) {
        Ok(_) => Finding::good(&part, printer.profile.clone()),
        Err(error) => {
            Finding::wrong(&part, error.to_string(), "`lumenfab profiles list` names those that are built in")
        }
    }
}

fn port(printer: &PrinterConfig) -> Finding {
    let part = format!("port of {}", printer.name);
    let Port::Path(name) = &printer.port else {
        let fix = "for a real one set `port` of this [[printer]] in config.toml";
        return Finding::doubtful(&part, "it is the simulated printer", fix);
    };
    let path = match Device::named(name).map(|wanted| device::path_of(&wanted)) {
        Some(Err(problem)) => return Finding::wrong(&part, format!("{name} {problem}"), MISSING),
        Some(Ok(path)) => path,
        None => PathBuf::from(name),
    };
    let Ok(found) = std::fs::metadata(&path) else {
        return Finding::wrong(&part, format!("{name} does not exist"), MISSING);
    };
    if access(&path, Access::READ_OK | Access::WRITE_OK).is_err() {
        let fix = format!(
            "add the user to the group of the port (`usermod -aG {} USER`; on Debian that is dialout) and log in again",
            found.gid()
        );
        return Finding::wrong(&part, format!("{name} may not be opened by this user"), fix);
    }
    if UNSTABLE.iter().any(|unstable| name.starts_with(unstable)) {
        let stable =
            device::behind(&path).map_or_else(|| "/dev/serial/by-id/...".to_owned(), |d| d.to_string());
        let fix = format!("name it by what it is: port = \"{stable}\"");
        return Finding::doubtful(&part, format!("{name} is another device after the next plugging"), fix);
    }
    Finding::good(&part, name.clone())
}

const MISSING: &str =
    "switch the printer on, look at its cable, and at the port's name: `ls -l /dev/serial/by-id`";

fn program(printer: &PrinterConfig, hook: &Hook) -> Finding {
    let part = format!("bed-clearing program of {}", printer.name);
    let path = hook.program.first().map(String::as_str).unwrap_or_default();
    if Path::new(path).is_file() && access(path, Access::EXEC_OK).is_ok() {
        return Finding::good(&part, path);
    }
    let fix = "install it, `chmod 755` it, or take bed_clear_program out of config.toml: until then somebody clears the bed";
    Finding::wrong(&part, format!("{path} is no program that this user may run"), fix)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::appliance::place::Place;
    use std::os::unix::fs::PermissionsExt;

    /// A state directory with this configuration.
    fn state(config: &str) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        std::fs::set_permissions(dir.path(), PermissionsExt::from_mode(0o700)).unwrap();
        std::fs::write(dir.path().join("config.toml"), config).unwrap();
        dir
    }

    async fn findings(dir: &Path) -> Vec<Finding> {
        examine(&Layout::of(dir), |_| None).await
    }

    fn of<'a>(findings: &'a [Finding], part: &str) -> &'a Finding {
        findings.iter().find(|finding| finding.part == part).unwrap_or_else(|| panic!("{part}: {findings:?}"))
    }

    #[tokio::test]
    async fn an_installation_that_is_in_order_has_nothing_wrong() {
        let dir = state("");
        let store = Sqlite::open(&dir.path().join("queue.db")).unwrap();
        store.close().await;
        let found = findings(dir.path()).await;
        assert!(found.iter().all(|finding| !finding.is_wrong()), "{found:?}");
        assert_eq!(of(&found, "queue").condition, Condition::Good);
        assert!(of(&found, "port of printer").found.contains("simulated"));
        let names: Vec<_> = std::fs::read_dir(dir.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        // SQLite leaves files of its own beside a queue that was read.
        let is_old =
            |name: &OsString| name == "config.toml" || name.to_string_lossy().starts_with("queue.db");
        assert!(names.iter().all(is_old), "nothing else is made: {names:?}");
    }

    #[tokio::test]
    async fn each_fault_is_found_with_what_to_do() {
        let config = "[watch]\nfolder = \"/nonexistent/inbox\"\n[http]\ntcp = [\"127.0.0.1:0\"]\n\
                      [[printer]]\nname = \"left\"\nprofile = \"marlim\"\nport = \"/dev/no-such-port\"\n\
                      bed_clear_program = [\"/nonexistent/hook\"]\n[[printer]]\nname = \"right\"\nport = \"usb:ffff:ffff:none\"\n";
        let dir = state(config);
        std::fs::write(dir.path().join("queue.db"), "no database at all, and long enough to be looked at")
            .unwrap();
        std::fs::write(dir.path().join("keys.toml"), "").unwrap();
        std::fs::set_permissions(dir.path().join("keys.toml"), PermissionsExt::from_mode(0o644)).unwrap();
        let found = findings(dir.path()).await;
        let parts = [
            ("queue", "no SQLite database", "restore"),
            ("keys", "644", "mended"),
            ("watched folder", "/nonexistent/inbox is no folder", "make it"),
            ("profile of left", "marlim", "profiles list"),
            ("port of left", "/dev/no-such-port does not exist", "cable"),
            ("bed-clearing program of left", "/nonexistent/hook", "chmod 755"),
            ("port of right", "usb:ffff:ffff:none does not exist", "cable"),
        ];
        for (part, says, fix) in parts {
            let Finding { found, condition, .. } = of(&found, part);
            let Condition::Wrong { fix: told } = condition else { panic!("{part}: {condition:?}") };
            assert!(found.contains(says) && told.contains(fix), "{part}: {found}: {told}");
        }
    }

    #[tokio::test]
    async fn a_configuration_that_cannot_be_read_and_a_directory_that_is_not_there_are_told() {
        let dir = state("[printer]\nnames = 1\n");
        let found = findings(dir.path()).await;
        assert!(of(&found, "configuration").is_wrong());
        assert!(of(&found, "configuration").found.contains("config.toml:2"), "{found:?}");
        let missing = findings(&dir.path().join("none")).await;
        assert_eq!(missing.len(), 1);
        assert!(missing[0].is_wrong() && missing[0].found.contains("is not there"), "{missing:?}");
    }

    #[test]
    fn a_directory_that_others_can_read_is_told() {
        let dir = state("");
        std::fs::set_permissions(dir.path(), PermissionsExt::from_mode(0o755)).unwrap();
        assert!(matches!(directory(dir.path()).condition, Condition::Doubtful { .. }));
    }

    #[test]
    fn whether_a_server_has_the_directory_is_seen_without_disturbing_it() {
        let dir = state("");
        let layout = Layout::of(dir.path());
        assert!(!is_served(&layout));
        let place = Place::open(dir.path()).unwrap();
        assert!(is_served(&layout));
        drop(place);
        assert!(!is_served(&layout));
        Place::open(dir.path()).unwrap();
    }

    #[test]
    fn a_clock_that_does_not_tell_the_run_is_told() {
        let blind = BootClock { boot: None, now: || std::time::Duration::ZERO };
        assert!(matches!(clock(&blind).condition, Condition::Doubtful { .. }));
    }
}
