//! `lumenfab serve`: the appliance as a process.

use super::args::queue::{BackupArgs, ServeArgs, StateArgs};
use super::{Answer, Failure, signals};
use crate::appliance::config::OnStop;
use crate::appliance::doctor::{self, Condition, Finding};
use crate::appliance::guard::{self, Heaters, SeenTo};
use crate::appliance::place::{self, BootClock, Layout, Place};
use crate::appliance::{self, Error, Restored, Setup};
use crate::client::Client;
use crate::printer::control::Controls;
use jiff::Timestamp;
use serde_json::json;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;

/// Threads of the server; prints have their own.
const THREADS: usize = 2;
/// How long the end waits for reading and writing that is under way.
const LAST_IO: Duration = Duration::from_secs(10);

/// Serves until a signal asks it to stop.
pub(super) fn run(args: &ServeArgs) -> Result<Answer, Failure> {
    let place = Place::open(&state_dir(&args.state)?)?;
    let config = place.config(env)?;
    let program = std::env::current_exe().map_err(Error::Runtime)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(THREADS).enable_all().build();
    let runtime = runtime.map_err(Error::Runtime)?;
    let first = config.on_stop;
    let served = runtime.block_on(async {
        let (stop, stopping) = watch::channel(None);
        let signals = tokio::spawn(heed_signals(first, stop));
        let boot_clock = BootClock::of_system();
        let setup = Setup { place, config, program, clock: Timestamp::now, boot_clock };
        let served = appliance::serve(setup, stopping).await;
        signals.abort();
        served
    });
    // What waits for a share that does not answer is left behind.
    runtime.shutdown_timeout(LAST_IO);
    served?;
    Ok(Answer { document: json!({ "ended": "asked to stop" }), text: String::new() })
}

fn env(name: &str) -> Option<OsString> {
    std::env::var_os(name)
}

fn state_dir(args: &StateArgs) -> Result<PathBuf, Error> {
    match &args.state {
        Some(dir) => std::path::absolute(dir).map_err(|source| Error::Io { path: dir.clone(), source }),
        None => place::default_dir(env),
    }
}

/// Writes a backup.
pub(super) fn backup(args: &BackupArgs) -> Result<Answer, Failure> {
    let saved = appliance::backup(&state_dir(&args.state)?, &args.file, Timestamp::now())?;
    let (file, mb) = (args.file.display(), saved.bytes as f64 / 1e6);
    let text = format!("backup  {} files, {mb:.1} MB: {file}", saved.n_files);
    Ok(Answer { document: json!(saved), text })
}

/// Switches off what a server has left hot.
pub(super) fn safe_off(dir: &Path, watch: bool) -> Result<Answer, Failure> {
    let cancel = signals::cancel_on_signal(&Controls::default());
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(Error::Runtime)?;
    let seen = runtime
        .block_on(async { if watch { guard::watch(dir, &cancel).await } else { guard::look(dir).await } })?;
    let line = |seen: &SeenTo| match &seen.why {
        Some(why) => format!("{}: {why}", seen.printer),
        None => format!("{}: its heaters are off", seen.printer),
    };
    let unknown: Vec<_> = seen.iter().filter(|seen| seen.heaters == Heaters::Unknown).map(line).collect();
    if !unknown.is_empty() {
        let text = format!("{}; switch it off if it is hot", unknown.join("; "));
        return Err(Failure { text, code: "serve.heaters_unknown".to_owned(), exit_code: 1 });
    }
    let text = seen.iter().map(line).collect::<Vec<_>>().join("\n");
    Ok(Answer { document: json!({ "printers": seen }), text })
}

/// Makes a state directory from a backup.
pub(super) fn restore(args: &BackupArgs) -> Result<Answer, Failure> {
    let dir = state_dir(&args.state)?;
    let runtime = tokio::runtime::Builder::new_current_thread().build().map_err(Error::Runtime)?;
    let restored = runtime.block_on(appliance::restore(&args.file, &dir, Timestamp::now()))?;
    let Restored { made_at, n_files, n_held } = &restored;
    let text = format!(
        "restored  {n_files} files of {made_at} to {}\nheld      {n_held} jobs: they may have been printed since; `lumenfab queue \
         release JOB` lets one go",
        dir.display()
    );
    Ok(Answer { document: json!(restored), text })
}

/// Looks at an installation; whether all of it works.
pub(super) fn doctor(args: &ServeArgs) -> Result<(Answer, bool), Failure> {
    let layout = Layout::of(state_dir(&args.state)?);
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(Error::Runtime)?;
    let findings = runtime.block_on(async {
        let mut findings = doctor::examine(&layout, env).await;
        findings.push(server(&layout).await);
        findings
    });
    let text = findings.iter().map(line).collect();
    let is_well = !findings.iter().any(Finding::is_wrong);
    Ok((Answer { document: json!({ "is_well": is_well, "findings": findings }), text }, is_well))
}

async fn server(layout: &Layout) -> Finding {
    const PART: &str = "server";
    if !doctor::is_served(layout) {
        let fix = "`systemctl start lumenfab`, or `lumenfab serve`";
        return Finding::doubtful(PART, "none runs here", fix);
    }
    match Client::over_socket(layout.socket()).health().await {
        Ok(_) => Finding::good(PART, "runs, and answers on its socket"),
        Err(error) => Finding::wrong(
            PART,
            format!("runs, but does not answer: {error}"),
            "look into its log (`journalctl -u lumenfab`), then start it again",
        ),
    }
}

fn line(finding: &Finding) -> String {
    let Finding { part, found, condition } = finding;
    let (word, fix) = match condition {
        Condition::Good => ("good ", None),
        Condition::Doubtful { fix } => ("look ", Some(fix)),
        Condition::Wrong { fix } => ("WRONG", Some(fix)),
    };
    let fix = fix.map_or_else(String::new, |fix| format!("       {fix}\n"));
    format!("{word}  {part}: {found}\n{fix}")
}

/// The first signal ends the server as configured, each further one more strictly. A terminal that is gone ends nothing.
async fn heed_signals(first: OnStop, stop: watch::Sender<Option<OnStop>>) -> std::io::Result<()> {
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    let mut hangup = signal(SignalKind::hangup())?;
    loop {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
            _ = hangup.recv() => continue,
        }
        let wish = next(*stop.borrow(), first);
        tracing::info!(?wish, "server: asked to stop");
        stop.send_replace(Some(wish));
    }
}

const fn next(now: Option<OnStop>, first: OnStop) -> OnStop {
    match now {
        None => first,
        Some(OnStop::Finish) => OnStop::Park,
        Some(OnStop::Park | OnStop::Cancel) => OnStop::Cancel,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_signal_is_stricter_than_the_one_before() {
        let wishes = |first| {
            let mut now = None;
            std::array::from_fn::<_, 4, _>(|_| {
                now = Some(next(now, first));
                now.unwrap()
            })
        };
        assert_eq!(wishes(OnStop::Finish), [OnStop::Finish, OnStop::Park, OnStop::Cancel, OnStop::Cancel]);
        assert_eq!(wishes(OnStop::Cancel), [OnStop::Cancel; 4]);
    }
}
