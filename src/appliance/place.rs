//! The state directory: what lies where, and that one server alone has it (IO).
//!
//! ```text
//! queue.db          the queue
//! files/            what was uploaded, under the names of jobs
//! jobs/ID/          what was made of a job: job.gcode, its journal, what the simulated printer laid down
//! lumenfab.sock     the server's socket
//! config.toml       what the operator decides, where there is one
//! keys.toml         keys for TCP
//! printers.json     which machine each printer was when its bed was known last
//! owner.lock        held as long as a server lives
//! heat/             which printers may be hot: a file for each at a port, which whoever sees to its heaters has locked
//! alive             when a server lived last, since the start of the machine: tells the next one how long nobody watched
//! ```

use super::Error;
use super::config::Config;
use crate::queue::JobId;
use std::ffi::OsString;
use std::fs::{DirBuilder, File, TryLockError};
use std::io;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Where Linux tells which run of the machine this is, and how long ago it began, s, sleep included.
const BOOT_ID: &str = "/proc/sys/kernel/random/boot_id";
const UPTIME: &str = "/proc/uptime";
/// Rights of directories and files: their owner's alone.
const DIR_MODE: u32 = 0o700;
const FILE_MODE: u32 = 0o600;
/// Bits of everybody else.
const OTHERS: u32 = 0o077;

/// Paths within a state directory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Layout(PathBuf);

impl Layout {
    /// Of a directory that need not be there.
    #[must_use]
    pub fn of(dir: impl Into<PathBuf>) -> Self {
        Self(dir.into())
    }

    /// The directory.
    #[must_use]
    pub fn dir(&self) -> &Path {
        &self.0
    }

    /// The queue.
    #[must_use]
    pub fn queue(&self) -> PathBuf {
        self.0.join("queue.db")
    }

    /// Uploaded files.
    #[must_use]
    pub fn files(&self) -> PathBuf {
        self.0.join("files")
    }

    /// The server's socket.
    #[must_use]
    pub fn socket(&self) -> PathBuf {
        self.0.join("lumenfab.sock")
    }

    /// The operator's decisions.
    #[must_use]
    pub fn config(&self) -> PathBuf {
        self.0.join("config.toml")
    }

    /// Keys for TCP.
    #[must_use]
    pub fn keys(&self) -> PathBuf {
        self.0.join("keys.toml")
    }

    /// What is made of a job.
    #[must_use]
    pub fn job(&self, id: JobId) -> PathBuf {
        self.0.join("jobs").join(id.to_string())
    }

    /// A job's G-code, once it is prepared.
    #[must_use]
    pub fn gcode(&self, id: JobId) -> PathBuf {
        self.job(id).join("job.gcode")
    }

    /// Which machine each printer was.
    #[must_use]
    pub fn printers(&self) -> PathBuf {
        self.0.join("printers.json")
    }

    /// What the operator decides: the file in the directory, else the service's own in `$CONFIGURATION_DIRECTORY`, else every default.
    ///
    /// # Errors
    /// [`Error::Config`], [`Error::Io`].
    pub fn read_config(&self, env: impl Fn(&str) -> Option<OsString>) -> Result<Config, Error> {
        let of_service = env("CONFIGURATION_DIRECTORY").map(|dir| PathBuf::from(dir).join("config.toml"));
        for path in std::iter::once(self.config()).chain(of_service) {
            match std::fs::read_to_string(&path) {
                Ok(text) => return Ok(Config::parse(&text, &path.display().to_string())?),
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Err(source) => return Err(failed(&path)(source)),
            }
        }
        Ok(Config::default())
    }

    /// Held as long as a server lives.
    pub(super) fn lock(&self) -> PathBuf {
        self.0.join("owner.lock")
    }

    fn alive(&self) -> PathBuf {
        self.0.join("alive")
    }
}

/// The directory of which nothing is said: systemd's, else the user's.
///
/// # Errors
/// [`Error::NoHome`] where the environment names none.
pub fn default_dir(env: impl Fn(&str) -> Option<OsString>) -> Result<PathBuf, Error> {
    let named = |name: &str| env(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    // systemd joins several directories by colons; the first one is the unit's own.
    let first = |dirs: PathBuf| {
        let text = dirs.to_string_lossy().into_owned();
        PathBuf::from(text.split(':').next().unwrap_or_default())
    };
    if let Some(dir) = named("STATE_DIRECTORY").map(first) {
        return Ok(dir);
    }
    let state = named("XDG_STATE_HOME").filter(|dir| dir.is_absolute());
    let state = state.or_else(|| Some(named("HOME")?.join(".local/state")));
    state.map(|dir| dir.join("lumenfab")).ok_or(Error::NoHome)
}

/// A state directory that is this process's own as long as this lives.
#[derive(Debug)]
pub struct Place {
    layout: Layout,
    _lock: File,
}

impl Place {
    /// Opens a directory, or makes it; rights of others are taken away.
    ///
    /// # Errors
    /// [`Error::InUse`] where another server has it; [`Error::Io`].
    pub fn open(dir: &Path) -> Result<Self, Error> {
        make(dir)?;
        let mode = std::fs::metadata(dir).map_err(failed(dir))?.permissions().mode();
        if mode & OTHERS != 0 {
            std::fs::set_permissions(dir, PermissionsExt::from_mode(DIR_MODE)).map_err(failed(dir))?;
        }
        make(&dir.join("jobs"))?;
        let path = Layout::of(dir).lock();
        let lock = File::options().create(true).truncate(false).write(true).mode(FILE_MODE).open(&path);
        let lock = lock.map_err(failed(&path))?;
        match lock.try_lock() {
            Ok(()) => Ok(Self { layout: Layout::of(dir), _lock: lock }),
            Err(TryLockError::WouldBlock) => Err(Error::InUse { dir: dir.to_owned() }),
            Err(TryLockError::Error(source)) => Err(failed(&path)(source)),
        }
    }

    /// What lies where.
    #[must_use]
    pub const fn layout(&self) -> &Layout {
        &self.layout
    }

    /// As [`Layout::read_config`].
    ///
    /// # Errors
    /// [`Error::Config`], [`Error::Io`].
    pub fn config(&self, env: impl Fn(&str) -> Option<OsString>) -> Result<Config, Error> {
        self.layout.read_config(env)
    }

    /// When a server was last alive here, by a clock of this run of the machine; `None` where none ever was, or in another run: nobody
    /// knows how long ago that is.
    #[must_use]
    pub fn watched_at(&self, clock: &BootClock) -> Option<Duration> {
        let text = std::fs::read_to_string(self.layout.alive()).ok()?;
        let (boot, ms) = text.trim().split_once(' ')?;
        let at = Duration::from_millis(ms.parse().ok()?);
        (clock.boot.as_deref() == Some(boot) && at <= (clock.now)()).then_some(at)
    }

    /// This server lives.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn touch(&self, clock: &BootClock) -> Result<(), Error> {
        let boot = clock.boot.as_deref().unwrap_or("?");
        replace(&self.layout.alive(), format!("{boot} {}\n", (clock.now)().as_millis()).as_bytes())
    }
}

/// A clock that nobody sets, neither an operator nor the network: it counts from the start of the machine, sleep included. Small
/// machines have no other one that is right after a power cut.
#[derive(Debug, Clone)]
pub struct BootClock {
    /// Which run of the machine this is; `None`: the system does not tell.
    pub boot: Option<String>,
    /// Time since that began.
    pub now: fn() -> Duration,
}

impl BootClock {
    /// The system's.
    #[must_use]
    pub fn of_system() -> Self {
        let boot = std::fs::read_to_string(BOOT_ID).ok();
        let boot = boot.map(|id| id.trim().to_owned()).filter(|id| !id.is_empty() && !id.contains(' '));
        Self { boot: boot.filter(|_| since_boot() > Duration::ZERO), now: since_boot }
    }
}

/// 0 where the system does not tell.
fn since_boot() -> Duration {
    let text = std::fs::read_to_string(UPTIME).unwrap_or_default();
    let seconds = text.split(' ').next().and_then(|word| word.parse().ok());
    seconds.and_then(|s: f64| Duration::try_from_secs_f64(s).ok()).unwrap_or_default()
}

/// Writes a small file that is its owner's alone, whole or not at all as far as other processes see; a power cut may lose it.
///
/// # Errors
/// [`Error::Io`].
pub(super) fn replace(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let part = path.with_extension("part");
    write(&part, bytes)?;
    std::fs::rename(&part, path).map_err(failed(path))
}

/// Writes a small file that is its owner's alone. Not atomic: whoever reads it can do without.
///
/// # Errors
/// [`Error::Io`].
pub(super) fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let file = File::options().create(true).truncate(true).write(true).mode(FILE_MODE).open(path);
    file.and_then(|mut file| io::Write::write_all(&mut file, bytes)).map_err(failed(path))
}

/// Makes a directory that is its owner's alone, and those above it.
///
/// # Errors
/// [`Error::Io`].
pub(super) fn make(dir: &Path) -> Result<(), Error> {
    DirBuilder::new().recursive(true).mode(DIR_MODE).create(dir).map_err(failed(dir))
}

fn failed(path: &Path) -> impl Fn(io::Error) -> Error {
    let path = path.to_owned();
    move |source| Error::Io { path: path.clone(), source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn systemd_goes_before_the_user_and_the_user_before_his_home() {
        let dir = |given: &[(&str, &str)]| {
            let env = |name: &str| given.iter().find(|(n, _)| *n == name).map(|(_, v)| OsString::from(v));
            default_dir(env).ok()
        };
        let (home, xdg) = (("HOME", "/home/lab"), ("XDG_STATE_HOME", "/state"));
        assert_eq!(dir(&[home]), Some("/home/lab/.local/state/lumenfab".into()));
        assert_eq!(dir(&[home, xdg]), Some("/state/lumenfab".into()));
        assert_eq!(dir(&[home, ("XDG_STATE_HOME", "odd")]), Some("/home/lab/.local/state/lumenfab".into()));
        let unit = ("STATE_DIRECTORY", "/var/lib/lumenfab:/var/lib/other");
        assert_eq!(dir(&[home, xdg, unit]), Some("/var/lib/lumenfab".into()));
        assert_eq!(dir(&[]), None);
    }

    #[test]
    fn one_server_has_a_directory_and_nobody_else_sees_it() {
        let dir = tempfile::tempdir().unwrap();
        let state = dir.path().join("a/state");
        let place = Place::open(&state).unwrap();
        let second = Place::open(&state).unwrap_err();
        assert!(matches!(second, Error::InUse { .. }), "{second}");
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
        assert_eq!(
            (mode(&state), mode(&state.join("jobs")), mode(&state.join("owner.lock"))),
            (0o700, 0o700, 0o600)
        );
        drop(place);
        std::fs::set_permissions(&state, PermissionsExt::from_mode(0o755)).unwrap();
        let _again = Place::open(&state).unwrap();
        assert_eq!(mode(&state), 0o700);
    }

    #[test]
    fn the_directory_s_own_configuration_goes_before_the_service_s() {
        let (dir, etc) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let place = Place::open(dir.path()).unwrap();
        let env = |name: &str| (name == "CONFIGURATION_DIRECTORY").then(|| etc.path().into());
        let name = || place.config(env).map(|config| config.printers[0].name.to_string());
        assert_eq!(name().unwrap(), "printer");
        std::fs::write(etc.path().join("config.toml"), "[[printer]]\nname = \"etc\"\n").unwrap();
        assert_eq!(name().unwrap(), "etc");
        std::fs::write(dir.path().join("config.toml"), "[[printer]]\nname = \"own\"\n").unwrap();
        assert_eq!(name().unwrap(), "own");
        std::fs::write(dir.path().join("config.toml"), "[[printer]]\nnames = 1\n").unwrap();
        let wrong = name().unwrap_err();
        assert_eq!((wrong.code(), wrong.exit_code()), ("serve.config", 2));
        assert!(wrong.to_string().contains("config.toml:2: printer.names"), "{wrong}");
    }

    fn clock(boot: Option<&str>, now: fn() -> Duration) -> BootClock {
        BootClock { boot: boot.map(str::to_owned), now }
    }

    #[test]
    fn how_long_nobody_watched_is_told_by_a_clock_that_nobody_sets_and_within_one_run_of_the_machine() {
        let dir = tempfile::tempdir().unwrap();
        let place = Place::open(dir.path()).unwrap();
        let (then, later) = (|| Duration::from_secs(100), || Duration::from_secs(160));
        assert_eq!(place.watched_at(&clock(Some("a"), then)), None, "no server was ever here");
        place.touch(&clock(Some("a"), then)).unwrap();
        assert_eq!(place.watched_at(&clock(Some("a"), later)), Some(Duration::from_secs(100)));
        assert_eq!(place.watched_at(&clock(Some("b"), later)), None, "another run");
        assert_eq!(place.watched_at(&clock(None, later)), None, "nobody tells which run it is");
        place.touch(&clock(Some("a"), later)).unwrap();
        assert_eq!(place.watched_at(&clock(Some("a"), then)), None, "it was not written in this run");
        place.touch(&clock(None, then)).unwrap();
        for boot in [None, Some("a")] {
            assert_eq!(place.watched_at(&clock(boot, later)), None, "nobody told which run it was");
        }
        std::fs::write(dir.path().join("alive"), "4711").unwrap();
        assert_eq!(place.watched_at(&clock(Some("a"), later)), None, "an earlier version wrote it");
    }

    #[test]
    fn the_system_s_clock_goes_and_knows_the_run() {
        let clock = BootClock::of_system();
        let first = (clock.now)();
        assert!(first > Duration::ZERO && (clock.now)() >= first);
        assert_eq!(clock.boot, BootClock::of_system().boot);
    }
}
