//! Ctrl-C and the signals of a service manager ask the work to stop; a second one stops it at once.

use crate::progress::CancelToken;
use std::thread;
use tokio::signal::unix::{SignalKind, signal};

/// Exit code of an interrupted process.
const INTERRUPTED: i32 = 130;

/// A token that is set by the first signal.
///
/// Where signals cannot be watched, the system's own way of ending a process on Ctrl-C stays.
pub(super) fn cancel_on_signal() -> CancelToken {
    let token = CancelToken::default();
    let watched = token.clone();
    let watch = move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        runtime.and_then(|r| r.block_on(watch(&watched))).unwrap_or_else(|e| warn_unwatched(&e));
    };
    let spawned = thread::Builder::new().name("signals".into()).spawn(watch);
    spawned.map_or_else(|e| warn_unwatched(&e), drop);
    token
}

fn warn_unwatched(error: &std::io::Error) {
    tracing::warn!("signals are not watched: {error}");
}

async fn watch(token: &CancelToken) -> std::io::Result<()> {
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    let mut hangup = signal(SignalKind::hangup())?;
    loop {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
            _ = hangup.recv() => {}
        }
        if token.is_cancelled() {
            std::process::exit(INTERRUPTED);
        }
        super::face::say("stopping; once more to stop at once");
        token.cancel();
    }
}
