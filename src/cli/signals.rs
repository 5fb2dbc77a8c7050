//! Ctrl-C and the signals of a service manager ask the work to stop; a second one stops it at once. SIGUSR1 pauses a print, SIGUSR2
//! lets it go on. A terminal that is gone (SIGHUP) stops nothing: a print goes on unattended.

use crate::printer::control::{Control, Controls};
use crate::progress::CancelToken;
use std::thread;
use tokio::signal::unix::{SignalKind, signal};

/// Exit code of an interrupted process.
const INTERRUPTED: i32 = 130;

/// A token that is set by the first signal to stop; what is asked of a print goes to `controls`.
///
/// Where signals cannot be watched, the system's own way of ending a process on Ctrl-C stays.
pub(super) fn cancel_on_signal(controls: &Controls) -> CancelToken {
    let token = CancelToken::default();
    let (watched, controls) = (token.clone(), controls.clone());
    let watch = move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        runtime.and_then(|r| r.block_on(watch(&watched, &controls))).unwrap_or_else(|e| warn_unwatched(&e));
    };
    let spawned = thread::Builder::new().name("signals".into()).spawn(watch);
    spawned.map_or_else(|e| warn_unwatched(&e), drop);
    token
}

fn warn_unwatched(error: &std::io::Error) {
    tracing::warn!("signals are not watched: {error}");
}

async fn watch(token: &CancelToken, controls: &Controls) -> std::io::Result<()> {
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    let mut hangup = signal(SignalKind::hangup())?;
    let mut pause = signal(SignalKind::user_defined1())?;
    let mut go_on = signal(SignalKind::user_defined2())?;
    loop {
        tokio::select! {
            _ = pause.recv() => { controls.ask(Control::Pause); continue; }
            _ = go_on.recv() => { controls.ask(Control::GoOn); continue; }
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
            _ = hangup.recv() => continue,
        }
        if token.is_cancelled() {
            super::keys::restore();
            std::process::exit(INTERRUPTED);
        }
        super::face::say("stopping; once more to stop at once");
        token.cancel();
    }
}
