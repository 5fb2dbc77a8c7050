//! Switching off what a server has left hot (IO): `lumenfab safe-off --state DIR`.
//!
//! A server that ends, or dies, may leave a print warm for the next one, and is no owner of its heaters any more. Whoever runs [`look`] then
//! switches off what no next server takes up, and what was to be off by now; whoever runs [`watch`] sees to the rest as well: a print
//! that no server takes up goes cold after the profile's `orphan_hold_s`, whether its firmware has a time-out of its own or not. Where
//! the watch itself ends, as with the machine, only firmware with a time-out is left to it.

use super::Error;
use super::heat::{self, Hot, Of, Told};
use super::place::Layout;
use crate::printer::{ask, paper, serial};
use crate::profile::{self, Profile};
use crate::progress::CancelToken;
use jiff::Timestamp;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep};

/// Between two looks, and two attempts at a printer that could not be switched off.
const LOOK: Duration = Duration::from_millis(500);
const AGAIN: Duration = Duration::from_secs(30);

/// What became of the heaters of a printer that may have been hot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct SeenTo {
    /// The printer, as the server calls it; its file, where that cannot be read.
    pub printer: String,
    /// What became of them.
    pub heaters: Heaters,
    /// In words, where it is not that they are off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
}

/// What became of heaters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Heaters {
    /// They are off, and the printer says so.
    Off,
    /// They are left on, for a while.
    Kept,
    /// They may be on: switch the printer off if it is hot.
    Unknown,
}

/// What is switched off.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Rule {
    /// What no server takes up, and what was to be off by now.
    Look,
    /// And what no server has taken up for its `orphan_hold_s`.
    Watch,
    /// And what nobody but this watch would switch off.
    Last,
}

/// Looks once.
///
/// # Errors
/// [`Error::Io`] where the state directory cannot be read.
pub async fn look(dir: &Path) -> Result<Vec<SeenTo>, Error> {
    Guard::of(dir).look(Rule::Look).await
}

/// Looks again and again until it is asked to stop; then once more. Gives what that comes to.
///
/// # Errors
/// As [`look`].
pub async fn watch(dir: &Path, cancel: &CancelToken) -> Result<Vec<SeenTo>, Error> {
    let mut guard = Guard::of(dir);
    while !cancel.is_cancelled() {
        guard.look(Rule::Watch).await?;
        sleep(LOOK).await;
    }
    guard.again.clear();
    guard.look(Rule::Last).await
}

struct Guard {
    dir: PathBuf,
    /// Since when nobody else sees to them.
    since: BTreeMap<PathBuf, Instant>,
    /// When it is tried again.
    again: BTreeMap<PathBuf, Instant>,
}

impl Guard {
    fn of(dir: &Path) -> Self {
        Self { dir: heat::folder(&Layout::of(dir)), since: BTreeMap::new(), again: BTreeMap::new() }
    }

    async fn look(&mut self, rule: Rule) -> Result<Vec<SeenTo>, Error> {
        let mut works = JoinSet::new();
        let mut seen = Vec::new();
        for path in files(&self.dir).map_err(|source| Error::Io { path: self.dir.clone(), source })? {
            match self.judge(&path, rule) {
                Found::Nothing => {}
                Found::Seen(what) => seen.push(what),
                Found::Due(due) => {
                    works.spawn(async move { (path, due.switch_off().await) });
                }
            }
        }
        // All at once: one that does not answer holds no other up.
        while let Some(done) = works.join_next().await {
            let Ok((path, what)) = done else { continue };
            if what.heaters == Heaters::Unknown {
                tracing::error!(
                    printer = what.printer,
                    "heaters: {}",
                    what.why.as_deref().unwrap_or_default()
                );
                self.again.insert(path, Instant::now() + AGAIN);
            } else {
                tracing::info!(printer = what.printer, "heaters are off");
                self.again.remove(&path);
            }
            seen.push(what);
        }
        seen.sort_by(|a, b| a.printer.cmp(&b.printer));
        Ok(seen)
    }

    fn judge(&mut self, path: &Path, rule: Rule) -> Found {
        let now = Instant::now();
        let read = heat::locked(path).and_then(|mut file| Ok((heat::read(&mut file)?, file)));
        let (told, file) = match read {
            Ok((Some(told), file)) => (told, file),
            Ok((None, _)) => return Found::Nothing,
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                self.since.remove(path);
                return Found::Nothing;
            }
            Err(error) => return Found::Seen(unreadable(path, &error)),
        };
        let Some(hot) = told.hot else { return Found::Nothing };
        let since = *self.since.entry(path.to_owned()).or_insert(now);
        if self.again.get(path).is_some_and(|at| now < *at) {
            return Found::Nothing;
        }
        let profile = match profile::load::by_name(&told.profile) {
            Ok(profile) => profile,
            Err(error) => return Found::Seen(unknown(&told, error.to_string())),
        };
        let is_due = is_due(rule, hot, &profile, since.elapsed(), Timestamp::now());
        if is_due {
            return Found::Due(Box::new(Due { told, profile, file }));
        }
        let why = Some("a print waits: the next server takes it up, or the watch switches it off".to_owned());
        Found::Seen(SeenTo { printer: told.printer.to_string(), heaters: Heaters::Kept, why })
    }
}

/// Whether heaters that nobody has seen to for so long are switched off.
fn is_due(rule: Rule, hot: Hot, profile: &Profile, unowned: Duration, now: Timestamp) -> bool {
    let is_late = hot.until.is_some_and(|until| until <= now);
    let hold = Duration::from_secs_f64(profile.firmware.orphan_hold_s);
    let is_given_up = rule != Rule::Look && unowned >= hold;
    let is_last = rule == Rule::Last && profile.orphan_gcode().is_none();
    hot.of == Of::Commands || is_late || is_given_up || is_last
}

enum Found {
    Nothing,
    Seen(SeenTo),
    Due(Box<Due>),
}

/// Heaters that are to be switched off; nobody else sees to them as long as this lives.
struct Due {
    told: Told,
    profile: Profile,
    file: File,
}

impl Due {
    async fn switch_off(mut self) -> SeenTo {
        let Told { printer, port, baud, .. } = &self.told;
        let firmware = paper::undisturbed(&self.profile);
        let off = async {
            ask::safe_off(serial::open(Path::new(port), &firmware, *baud).await?, &self.profile).await
        };
        if let Err(error) = off.await {
            // Its path may name somebody.
            return unknown(&self.told, error.to_string().replace(port.as_str(), "of the printer"));
        }
        let printer = printer.to_string();
        let cold = Told { hot: None, ..self.told };
        let why =
            heat::write(&mut self.file, &cold).err().map(|e| format!("off, but this cannot be written: {e}"));
        SeenTo { printer, heaters: Heaters::Off, why }
    }
}

fn unknown(told: &Told, why: String) -> SeenTo {
    SeenTo { printer: told.printer.to_string(), heaters: Heaters::Unknown, why: Some(why) }
}

fn unreadable(path: &Path, error: &io::Error) -> SeenTo {
    let printer = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let why = format!("the file cannot be read: {error}: switch the printer off if it is hot");
    SeenTo { printer, heaters: Heaters::Unknown, why: Some(why) }
}

fn files(dir: &Path) -> io::Result<Vec<PathBuf>> {
    let entries = match std::fs::read_dir(dir) {
        Ok(entries) => entries,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(error),
    };
    let mut paths = entries.map(|entry| Ok(entry?.path())).collect::<io::Result<Vec<_>>>()?;
    paths.retain(|path| path.extension().is_some_and(|ending| ending == "json"));
    paths.sort();
    Ok(paths)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_is_switched_off_when() {
        let guarded = profile::builtin("marlin").unwrap();
        let bare = profile::builtin("reprapfirmware").unwrap();
        let hold = Duration::from_secs_f64(bare.firmware.orphan_hold_s);
        let (now, short) = (Timestamp::UNIX_EPOCH, Duration::from_secs(1));
        let waits = |left_s| Hot::waits(now, Duration::from_secs(left_s));
        for rule in [Rule::Look, Rule::Watch, Rule::Last] {
            assert!(is_due(rule, Hot::COMMANDS, &guarded, short, now), "{rule:?}: nobody takes it up");
            assert!(is_due(rule, waits(0), &guarded, short, now), "{rule:?}: it was to be off");
            for hot in [Hot::PRINT, waits(60)] {
                assert_eq!(is_due(rule, hot, &bare, short, now), rule == Rule::Last, "{rule:?}");
                assert!(!is_due(rule, hot, &guarded, short, now), "{rule:?}");
                assert_eq!(is_due(rule, hot, &guarded, hold, now), rule != Rule::Look, "{rule:?}");
            }
        }
    }

    #[tokio::test]
    async fn a_directory_without_heat_and_a_file_that_says_nothing() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(look(dir.path()).await.unwrap(), []);
        std::fs::create_dir(dir.path().join("heat")).unwrap();
        std::fs::write(dir.path().join("heat/a.json"), "").unwrap();
        std::fs::write(dir.path().join("heat/b.json"), "{").unwrap();
        let seen = look(dir.path()).await.unwrap();
        assert_eq!((seen.len(), &*seen[0].printer, seen[0].heaters), (1, "b.json", Heaters::Unknown));
    }
}
