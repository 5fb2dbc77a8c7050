//! Preparing: jobs to G-code, beside the prints (IO).
//!
//! A case or a mesh is worked on by a child process of this program: what ends it ends no print, and its memory is given back. It is
//! nice to the rest of the machine, has few threads, and is ended when it takes too long. What comes of it lies in the job's own folder.

use super::config::Prepare;
use super::keeping::has_room;
use super::kit::{Kit, can_be_mended, ended, on_disk};
use super::place;
use super::survey::Survey;
use crate::http::files::{FileSpec, Files};
use crate::profile;
use crate::queue::{Change, Claimant, Digest, Estimate, Job, Made, Name, Needs, SpecKind};
use crate::store::{self, Claimed, Store};
use rustix::process::{Pid, setpriority_process};
use std::ffi::OsString;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;
use tokio::io::AsyncReadExt;
use tokio::process::Command;
use tokio::time::{Instant, sleep, sleep_until, timeout};

/// How often a worker looks for a job.
const LOOK: Duration = Duration::from_millis(500);
/// After a queue that could not be written.
const AGAIN: Duration = Duration::from_secs(10);
/// How often the queue is told that a worker lives.
const BEAT: Duration = Duration::from_secs(20);
/// Longest result of a child that is read, bytes.
const MAX_RESULT: u64 = 1 << 20;
/// The child's word that an earlier stage of a case is not done.
const STALE: &str = "case.stale";

/// One worker.
pub(super) struct Worker<S> {
    pub(super) name: Name,
    pub(super) kit: Kit<S>,
    pub(super) files: Files,
    pub(super) prepare: Prepare,
    /// Profile of jobs that name none.
    pub(super) profile: String,
    /// Diameter of its filament, mm.
    pub(super) filament_mm: f64,
}

/// Why a job cannot be prepared, in words without paths.
type Why = String;

impl<S: Store> Worker<S> {
    /// Until the server ends.
    ///
    /// # Errors
    /// [`store::Error::Gone`] and what else of the queue cannot be mended by trying again.
    pub(super) async fn run(&self) -> Result<(), store::Error> {
        let mut stopping = self.kit.stopping.clone();
        for claimed in self.adopt().await? {
            self.work(claimed).await?;
        }
        while self.kit.stopping().is_none() {
            // What cannot be written is not begun: it would fail.
            if has_room(&self.files).await {
                match self.kit.store.claim(Claimant::Worker(self.name.clone()), self.kit.now()).await {
                    Ok(Some(claimed)) => self.work(claimed).await?,
                    Err(store::Error::Gone) => return Err(store::Error::Gone),
                    Ok(None) => {}
                    Err(error) => tracing::debug!(worker = %self.name, "prepare: no job: {error}"),
                }
            }
            tokio::select! {
                () = sleep(LOOK) => {}
                () = ended(&mut stopping) => {}
            }
        }
        Ok(())
    }

    /// What it had when a server ended, as soon as the queue can be written.
    async fn adopt(&self) -> Result<Vec<Claimed>, store::Error> {
        let mut stopping = self.kit.stopping.clone();
        loop {
            match self.kit.store.adopt(self.name.clone(), self.kit.now()).await {
                Err(error) if can_be_mended(&error) => {
                    tracing::error!(worker = %self.name, "queue: {error}; it is tried again");
                }
                done => return done,
            }
            tokio::select! {
                () = sleep(AGAIN) => {}
                () = ended(&mut stopping) => return Ok(Vec::new()),
            }
        }
    }

    async fn work(&self, claimed: Claimed) -> Result<(), store::Error> {
        let (job, mut claim) = (claimed.job, claimed.claim);
        tracing::info!(worker = %self.name, job = %job.id, "prepare: begins");
        self.kit.events.look();
        let mut stopping = self.kit.stopping.clone();
        let mut making = std::pin::pin!(timeout(self.prepare.longest, self.make(&job)));
        let mut beat = Instant::now() + BEAT;
        let made = loop {
            tokio::select! {
                made = &mut making => break made.unwrap_or_else(|_late| Err(self.too_long())),
                () = sleep_until(beat) => {
                    beat = Instant::now() + BEAT;
                    match self.kit.store.renew(claim.clone(), self.kit.now()).await {
                        Ok(renewed) => claim = renewed,
                        Err(store::Error::Refused(refusal)) => {
                            tracing::info!(worker = %self.name, job = %job.id, "prepare: {refusal}");
                            return Ok(());
                        }
                        Err(error) => tracing::warn!(worker = %self.name, "prepare: the claim was not renewed: {error}"),
                    }
                }
                () = ended(&mut stopping) => {
                    let given = self.kit.insist(&claim, Change::GiveBack { lost: false }, None, "the server ends").await;
                    return settled(given);
                }
            }
        };
        let (change, why) = match made {
            Ok(made) => (Change::Prepared(made), String::new()),
            Err(why) => (Change::Fail { used_mm3: Some(0) }, why),
        };
        tracing::info!(worker = %self.name, job = %job.id, end = %change.kind(), why, "prepare: ended");
        self.kit.counters.count_prepared(change.kind());
        if matches!(change, Change::Fail { .. }) {
            self.kit.news.tell("not-prepared", None, Some(job.id), &why);
        }
        settled(self.kit.insist(&claim, change, None, &why).await)
    }

    fn too_long(&self) -> Why {
        format!("it took longer than the {} s that a preparation may take", self.prepare.longest.as_secs())
    }

    async fn make(&self, job: &Job) -> Result<Made, Why> {
        let spec = self.kit.store.spec(job.id).await.map_err(|error| error.to_string())?;
        let file: FileSpec = serde_json::from_slice(spec.bytes())
            .map_err(|_other| "its specification is of another version")?;
        let source = self.files.path(&file).ok_or("its specification names no file of this server")?;
        let dir = self.kit.layout.job(job.id);
        let made = on_disk(move || place::make(&dir).map_err(io::Error::other)).await;
        made.map_err(|_no_room| "its folder cannot be made: look at the disk")?;
        let gcode = self.kit.layout.gcode(job.id);
        match spec.kind() {
            SpecKind::Gcode => {
                let to = gcode.clone();
                on_disk(move || take_over(&source, &to)).await.map_err(|e| lost_file(&e))?;
            }
            SpecKind::Mesh => self.child(&source, self.slice(&source, &gcode, job)).await?,
            SpecKind::Case => {
                let case = on_disk(move || std::fs::read_link(source)).await.map_err(|e| lost_file(&e))?;
                self.case(&case, &gcode).await?;
            }
        }
        let (sum, survey) = examined(gcode).await?;
        if spec.kind() == SpecKind::Gcode && file.bytes.is_some_and(|known| known.blake3 != sum) {
            return Err("its file is not what was sent: it was changed on the disk".to_owned());
        }
        self.made(job, sum, &survey)
    }

    /// The stages that are not done yet, then the last one.
    async fn case(&self, case: &Path, gcode: &Path) -> Result<(), Why> {
        let stage = |name: &str| vec![name.into(), "--json".into(), case.into()];
        let mut slice: Vec<OsString> = stage("slice");
        slice.extend(["--out".into(), gcode.into()]);
        for before in [&[][..], &["solid"], &["segment", "solid"]] {
            let mut done = Ok(());
            for name in before {
                done = self.run_child(stage(name)).await;
                if done.is_err() {
                    break;
                }
            }
            if done.is_ok() {
                done = self.run_child(slice.clone()).await;
            }
            match done {
                Err(failed) if failed.code == STALE => {}
                done => return done.map_err(|failed| failed.said(case)),
            }
        }
        Err("its stages are not done: run `lumenfab run` on the case".to_owned())
    }

    fn slice(&self, mesh: &Path, gcode: &Path, job: &Job) -> Vec<OsString> {
        let profile = job.wishes.needs.profile.as_ref().map_or(self.profile.as_str(), Name::as_str);
        let args: [OsString; 7] = [
            "slice".into(),
            "--json".into(),
            mesh.into(),
            "--out".into(),
            gcode.into(),
            "--profile".into(),
            profile.into(),
        ];
        args.into_iter().chain(["--anew".into()]).collect()
    }

    async fn child(&self, source: &Path, args: Vec<OsString>) -> Result<(), Why> {
        self.run_child(args).await.map_err(|failed| failed.said(source))
    }

    async fn run_child(&self, args: Vec<OsString>) -> Result<(), Failed> {
        let mut command = Command::new(&self.kit.program);
        command
            .args(args)
            .env("RAYON_NUM_THREADS", self.prepare.threads.to_string())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .kill_on_drop(true);
        let mut child = command.spawn().map_err(|error| Failed::plain(&error.kind().to_string()))?;
        be_nice(child.id(), self.prepare.nice);
        let mut result = Vec::new();
        if let Some(out) = child.stdout.take() {
            // Where it cannot be read, the exit code still tells.
            out.take(MAX_RESULT).read_to_end(&mut result).await.ok();
        }
        match child.wait().await {
            Ok(status) if status.success() => Ok(()),
            Ok(status) => Err(Failed::of(&result, &status.to_string())),
            Err(error) => Err(Failed::plain(&error.kind().to_string())),
        }
    }

    fn made(&self, job: &Job, gcode: Digest, survey: &Survey) -> Result<Made, Why> {
        let needs = needs(job, survey);
        #[expect(clippy::cast_possible_truncation, reason = "saturates")]
        let (print_s, filament_mm3) =
            (survey.print_s.ceil() as u32, survey.filament_mm3(self.filament_mm).ceil() as u64);
        if survey.n_commands == 0 {
            return Err("its G-code has no commands".to_owned());
        }
        Ok(Made { gcode, estimate: Estimate { print_s, filament_mm3 }, needs })
    }
}

/// What the operator asked for, else what the job was made for.
fn needs(job: &Job, survey: &Survey) -> Needs {
    let wished = job.wishes.needs.clone();
    let profile = wished.profile.or_else(|| Name::try_new(survey.profile.as_deref()?).ok());
    let known = profile.as_ref().and_then(|name| profile::builtin(name.as_str()).ok());
    #[expect(clippy::cast_possible_truncation, reason = "a nozzle has some hundred micrometres")]
    let nozzle_um = known.map(|profile| (1000.0 * profile.machine.nozzle_mm).round() as u32);
    Needs { profile, material: wished.material, nozzle_um: wished.nozzle_um.or(nozzle_um) }
}

fn settled(done: Result<Job, store::Error>) -> Result<(), store::Error> {
    match done {
        Err(store::Error::Refused(refusal)) => {
            tracing::info!("prepare: {refusal}");
            Ok(())
        }
        done => done.map(drop),
    }
}

/// Why a child failed.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Failed {
    text: String,
    code: String,
}

impl Failed {
    fn plain(problem: &str) -> Self {
        Self { text: format!("it cannot be prepared: {problem}"), code: String::new() }
    }

    /// Of its document; what ended it where there is none.
    fn of(result: &[u8], status: &str) -> Self {
        let document: serde_json::Value = serde_json::from_slice(result).unwrap_or_default();
        let word = |key: &str| document.get(key).and_then(serde_json::Value::as_str).map(str::to_owned);
        match word("error") {
            Some(text) => Self { text, code: word("code").unwrap_or_default() },
            None => Self::plain(&format!("it ended with {status}")),
        }
    }

    /// Its words, without the path that the child was given, and up to any other: nobody knows where that one ends.
    fn said(&self, source: &Path) -> Why {
        let text = self.text.replace(&source.display().to_string(), "it");
        let mut said: Vec<_> = text.split(' ').take_while(|word| !word.contains('/')).collect();
        if said.len() < text.split(' ').count() {
            said.push("(a path)");
        }
        said.join(" ")
    }
}

fn lost_file(error: &io::Error) -> Why {
    format!("its file cannot be read: {}", error.kind())
}

/// The same file under the job's own name; a copy where the file system knows no links.
fn take_over(source: &Path, gcode: &Path) -> io::Result<()> {
    let part = gcode.with_extension("part");
    for leftover in [&part] {
        match std::fs::remove_file(leftover) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
    }
    if std::fs::hard_link(source, &part).is_err() {
        std::fs::copy(source, &part)?;
    }
    std::fs::rename(part, gcode)
}

/// Sum and survey of a job's G-code, on another thread.
async fn examined(gcode: PathBuf) -> Result<(Digest, Survey), Why> {
    let done = tokio::task::spawn_blocking(move || examine(&gcode)).await;
    done.map_err(|_panicked| "its G-code cannot be read".to_owned())?.map_err(|error| lost_file(&error))
}

/// Reads a job's G-code once. Blocks.
pub(super) fn examine(gcode: &Path) -> io::Result<(Digest, Survey)> {
    let mut summed = Summed { file: File::open(gcode)?, hasher: blake3::Hasher::new() };
    let survey = Survey::of(BufReader::with_capacity(1 << 18, &mut summed))?;
    Ok((Digest::from(*summed.hasher.finalize().as_bytes()), survey))
}

/// A file, summed up as it is read.
struct Summed {
    file: File,
    hasher: blake3::Hasher,
}

impl Read for Summed {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let n_bytes = self.file.read(into)?;
        self.hasher.update(&into[..n_bytes]);
        Ok(n_bytes)
    }
}

/// The system may refuse; it is a courtesy.
fn be_nice(id: Option<u32>, nice: u8) {
    let pid = id.and_then(|id| i32::try_from(id).ok()).and_then(Pid::from_raw);
    if let Some(Err(error)) = pid.map(|pid| setpriority_process(Some(pid), i32::from(nice))) {
        tracing::debug!("prepare: the child's niceness: {error}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_child_s_words_hold_no_path() {
        let result = br#"{"error":"/srv/MEIER/case: the solid is open; see /srv/MEIER JOSEF/x.png","code":"solid.open","exit_code":1}"#;
        let failed = Failed::of(result, "exit status: 1");
        assert_eq!(failed.code, "solid.open");
        assert_eq!(failed.said(Path::new("/srv/MEIER/case")), "it: the solid is open; see (a path)");
        let killed = Failed::of(b"", "signal: 9 (SIGKILL)").said(Path::new("/x"));
        assert_eq!(killed, "it cannot be prepared: it ended with signal: 9 (SIGKILL)");
    }

    #[test]
    fn what_was_uploaded_is_taken_over_as_it_is() {
        let dir = tempfile::tempdir().unwrap();
        let (source, gcode) = (dir.path().join("a.gcode"), dir.path().join("job.gcode"));
        std::fs::write(&source, "G28\nG1 X1 E1 F60\n").unwrap();
        std::fs::write(gcode.with_extension("part"), "half").unwrap();
        for _ in 0..2 {
            take_over(&source, &gcode).unwrap();
        }
        let (sum, survey) = examine(&gcode).unwrap();
        assert_eq!(sum, Digest::from(*blake3::hash(b"G28\nG1 X1 E1 F60\n").as_bytes()));
        assert_eq!((survey.n_commands, survey.filament_mm), (2, 1.0));
    }
}
