//! Which printers may be hot, on the disk (IO): for whoever comes after a server that has died.
//!
//! Each printer at a port has a file of its own in the folder `heat` of the state directory. What may heat is written there before
//! it is sent, and taken back once the printer has said that its heaters are off. Whoever sees to the heaters holds the file's lock: the
//! server as long as it, or the thread of a print, lives; without it the next server, or [`super::guard`]. The lock goes
//! with its process, however that ends.

use super::config::{Port, PrinterConfig};
use super::place::{self, Layout};
use crate::queue::Name;
use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use std::fs::{File, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::time::{Instant, sleep};

const FILE_MODE: u32 = 0o600;
/// How often it is looked whether somebody else still sees to the heaters, and after what time that is said.
const LOOK: Duration = Duration::from_millis(100);
const LONG: Duration = Duration::from_secs(5);

/// Whose heat it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Of {
    /// A print's, which the next server may take up.
    Print,
    /// Nobody's any more without this server: somebody's commands have left it on.
    Commands,
}

/// Heaters that may be on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Hot {
    pub(super) of: Of,
    /// When they are to be off at the latest, where that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) until: Option<Timestamp>,
}

impl Hot {
    /// Of a print under way.
    pub(super) const PRINT: Self = Self { of: Of::Print, until: None };

    /// Of a print that waits so long from now on.
    pub(super) fn waits(now: Timestamp, left: Duration) -> Self {
        let left = SignedDuration::try_from(left).unwrap_or(SignedDuration::MAX);
        Self { of: Of::Print, until: Some(now.checked_add(left).unwrap_or(Timestamp::MAX)) }
    }

    /// Of somebody's commands.
    pub(super) const COMMANDS: Self = Self { of: Of::Commands, until: None };
}

/// What a file tells.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Told {
    pub(super) printer: Name,
    /// How it is spoken to, as it was configured.
    pub(super) port: String,
    pub(super) profile: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) baud: Option<u32>,
    /// `None`: the heaters are off.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) hot: Option<Hot>,
}

/// A printer's file. Clones are the same.
#[derive(Debug, Clone)]
pub(super) struct HeatFile {
    path: PathBuf,
    told: Told,
    /// Open, and locked, from [`HeatFile::own`] on.
    file: Arc<Mutex<Option<File>>>,
}

/// The folder of all of them.
pub(super) fn folder(layout: &Layout) -> PathBuf {
    layout.dir().join("heat")
}

impl HeatFile {
    /// That of a printer; `None` for the simulated one, which lives as long as its print.
    pub(super) fn of(config: &PrinterConfig, layout: &Layout) -> Option<Self> {
        let Port::Path(port) = &config.port else { return None };
        // Names may hold what file names may not.
        let file = blake3::hash(config.name.as_str().as_bytes()).to_hex()[..16].to_owned() + ".json";
        let (printer, port, profile) = (config.name.clone(), port.clone(), config.profile.clone());
        let told = Told { printer, port, profile, baud: config.baud, hot: None };
        Some(Self { path: folder(layout).join(file), told, file: Arc::default() })
    }

    /// Waits until nobody else sees to the heaters. A file that cannot be had is said, and done without.
    pub(super) async fn own(&self) {
        let begun = Instant::now();
        let mut is_said = false;
        loop {
            match self.open() {
                Ok(()) => return,
                Err(error) if error.kind() != io::ErrorKind::WouldBlock => return self.warn(&error),
                Err(_) => sleep(LOOK).await,
            }
            if begun.elapsed() > LONG && !std::mem::replace(&mut is_said, true) {
                tracing::warn!(printer = %self.told.printer, "heaters: another process sees to them: it is waited for");
            }
        }
    }

    fn open(&self) -> io::Result<()> {
        let mut held = self.held();
        if held.is_none() {
            *held = Some(locked(&self.path)?);
        }
        Ok(())
    }

    fn held(&self) -> std::sync::MutexGuard<'_, Option<File>> {
        self.file.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What was written last, by this process or one before it.
    pub(super) fn hot(&self) -> Option<Hot> {
        let mut held = self.held();
        let told = read(held.as_mut()?);
        match told {
            Ok(told) => told?.hot,
            // Half a word: that it was written tells enough.
            Err(_) => Some(Hot::PRINT),
        }
    }

    /// Writes it down. That it cannot be written is said, and holds nothing up.
    pub(super) async fn tell(&self, hot: Option<Hot>) {
        let own = self.clone();
        let written = tokio::task::spawn_blocking(move || own.write(hot)).await;
        if let Ok(Err(error)) = written {
            self.warn(&error);
        }
    }

    fn write(&self, hot: Option<Hot>) -> io::Result<()> {
        let mut held = self.held();
        let Some(file) = held.as_mut() else { return Ok(()) };
        write(file, &Told { hot, ..self.told.clone() })
    }

    fn warn(&self, error: &io::Error) {
        tracing::warn!(printer = %self.told.printer, "heaters: that they may be on cannot be written down: {}", error.kind());
    }
}

/// Opens a file, and makes it where there is none.
///
/// # Errors
/// `WouldBlock` where another process sees to these heaters.
pub(super) fn locked(path: &Path) -> io::Result<File> {
    if let Some(dir) = path.parent() {
        place::make(dir).map_err(io::Error::other)?;
    }
    let mut options = File::options();
    let file = options.create(true).truncate(false).read(true).write(true).mode(FILE_MODE).open(path)?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(io::ErrorKind::WouldBlock.into()),
        // A file system that knows no locks is believed.
        Err(TryLockError::Error(_)) => Ok(file),
    }
}

/// `None` where nothing was written yet.
///
/// # Errors
/// What the system says; where something else than [`Told`] is written there.
pub(super) fn read(file: &mut File) -> io::Result<Option<Told>> {
    let mut text = String::new();
    file.rewind()?;
    file.read_to_string(&mut text)?;
    if text.is_empty() { Ok(None) } else { Ok(Some(serde_json::from_str(&text)?)) }
}

/// In one write, in place: a disk that is full has room for what replaces its like, and the lock is that of the file.
///
/// # Errors
/// What the system says.
pub(super) fn write(file: &mut File, told: &Told) -> io::Result<()> {
    let mut text = serde_json::to_vec(told).map_err(io::Error::other)?;
    text.push(b'\n');
    file.rewind()?;
    file.write_all(&text)?;
    file.set_len(text.len() as u64)?;
    file.sync_data()
}

#[cfg(test)]
mod tests {
    use super::super::config::Config;
    use super::*;

    fn of(dir: &Path, text: &str) -> Option<HeatFile> {
        HeatFile::of(&Config::parse(text, "config.toml").unwrap().printers[0], &Layout::of(dir))
    }

    #[tokio::test]
    async fn what_may_be_hot_is_told_to_whoever_comes_after_and_to_nobody_before() {
        let dir = tempfile::tempdir().unwrap();
        let text = "[[printer]]\nname = \"../left\"\nport = \"/dev/ttyUSB0\"\n";
        assert!(of(dir.path(), "").is_none(), "the simulated one");
        let first = of(dir.path(), text).unwrap();
        first.own().await;
        assert_eq!(first.hot(), None);
        let hot = Hot::waits(Timestamp::UNIX_EPOCH, Duration::from_secs(60));
        first.tell(Some(Hot::PRINT)).await;
        first.tell(Some(hot)).await;
        let paths: Vec<_> =
            std::fs::read_dir(dir.path().join("heat")).unwrap().map(|e| e.unwrap().path()).collect();
        assert_eq!(paths.len(), 1);
        assert_eq!(locked(&paths[0]).unwrap_err().kind(), io::ErrorKind::WouldBlock);
        let second = of(dir.path(), text).unwrap();
        let waiting = tokio::spawn(async move {
            second.own().await;
            second
        });
        drop(first);
        let second = waiting.await.unwrap();
        assert_eq!(second.hot(), Some(hot));
        second.tell(None).await;
        assert_eq!(second.hot(), None);
        std::fs::write(&paths[0], "{\"printer\"").unwrap();
        assert_eq!(second.hot(), Some(Hot::PRINT), "half a word");
    }
}
