//! The state directory: what lies where, and that one server alone has it (IO).
//!
//! ```text
//! queue.db          the queue
//! files/            what was uploaded, under the names of jobs
//! jobs/ID/          what was made of a job: job.gcode, its journal, what the simulated printer laid down
//! lumenfab.sock     the server's socket
//! config.toml       what the operator decides, where there is one
//! keys.toml         keys for TCP
//! owner.lock        held as long as a server lives
//! heat/             which printers may be hot: a file for each at a port, which whoever sees to its heaters has locked
//! alive             touched while a server lives: tells the next one how long nobody watched
//! ```

use super::Error;
use super::config::Config;
use crate::queue::JobId;
use std::ffi::OsString;
use std::fs::{DirBuilder, File, TryLockError};
use std::io;
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

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
        let path = dir.join("owner.lock");
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

    /// What the operator decides: the file in the directory, else the service's own in `$CONFIGURATION_DIRECTORY`, else every default.
    ///
    /// # Errors
    /// [`Error::Config`], [`Error::Io`].
    pub fn config(&self, env: impl Fn(&str) -> Option<OsString>) -> Result<Config, Error> {
        let of_service = env("CONFIGURATION_DIRECTORY").map(|dir| PathBuf::from(dir).join("config.toml"));
        for path in std::iter::once(self.layout.config()).chain(of_service) {
            match std::fs::read_to_string(&path) {
                Ok(text) => return Ok(Config::parse(&text, &path.display().to_string())?),
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Err(source) => return Err(failed(&path)(source)),
            }
        }
        Ok(Config::default())
    }

    /// How long no server has lived here, s: without end where none ever did, or where the clock was set back meanwhile.
    #[must_use]
    pub fn unwatched_s(&self) -> f64 {
        let touched = std::fs::metadata(self.layout.alive()).and_then(|found| found.modified());
        touched.ok().and_then(|at| at.elapsed().ok()).map_or(f64::INFINITY, |away| away.as_secs_f64())
    }

    /// This server lives.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn touch(&self) -> Result<(), Error> {
        // What is in it does not matter; that it was written does.
        write(&self.layout.alive(), std::process::id().to_string().as_bytes())
    }
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

    #[test]
    fn how_long_nobody_watched_is_told_from_the_last_touch() {
        let dir = tempfile::tempdir().unwrap();
        let place = Place::open(dir.path()).unwrap();
        assert!(place.unwatched_s().is_infinite());
        place.touch().unwrap();
        assert!(place.unwatched_s() < 60.0);
        let later = std::time::UNIX_EPOCH + std::time::Duration::from_secs(1 << 40);
        File::options().write(true).open(dir.path().join("alive")).unwrap().set_modified(later).unwrap();
        assert!(place.unwatched_s().is_infinite(), "the clock was set back");
    }
}
