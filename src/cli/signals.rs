//! Ctrl-C and the signals of a service manager ask the work to stop; a second one ends it at once. A print is never left hot by that:
//! its second one is an emergency stop of the printer, and only a third one leaves it as it is. SIGUSR1 pauses a print, SIGUSR2
//! lets it go on. A terminal that is gone (SIGHUP) stops nothing: a print goes on unattended.

use crate::printer::control::{Control, Controls};
use crate::progress::CancelToken;
use std::thread;
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};
use tokio::time::Instant;

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

/// Signals that follow sooner are one and the same wish: a group is signalled together with its leader.
const SAME_WISH: Duration = Duration::from_secs(1);

/// How often it was asked to stop.
#[derive(Debug, Default)]
struct Stops {
    n: u32,
    last: Option<Instant>,
}

impl Stops {
    /// Asked once more; false where that is no new wish.
    fn ask(&mut self, now: Instant) -> bool {
        let is_new = self.last.is_none_or(|last| now - last >= SAME_WISH);
        if is_new {
            (self.n, self.last) = (self.n + 1, Some(now));
        }
        is_new
    }
}

/// Does what the operator asks for.
fn stop(n: u32, token: &CancelToken, controls: &Controls) {
    match (n, controls.are_heard()) {
        (1, true) => super::face::say(
            "stopping: the printer ends its command (heating may take minutes), then its heaters go off; once more for an emergency stop",
        ),
        (1, false) => super::face::say("stopping; once more to stop at once"),
        (2, true) => {
            super::face::say(
                "emergency stop: the printer must be reset afterwards; once more to leave it as it is",
            );
            controls.ask(Control::EmergencyStop);
        }
        (_, is_printing) => {
            super::keys::restore();
            if is_printing {
                super::face::say(
                    "left at once: the printer's heaters may be on; `lumenfab safe-off` switches them off, or its own switch",
                );
            }
            std::process::exit(INTERRUPTED);
        }
    }
    token.cancel();
}

async fn watch(token: &CancelToken, controls: &Controls) -> std::io::Result<()> {
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    let mut hangup = signal(SignalKind::hangup())?;
    let mut pause = signal(SignalKind::user_defined1())?;
    let mut go_on = signal(SignalKind::user_defined2())?;
    let mut stops = Stops::default();
    loop {
        tokio::select! {
            _ = pause.recv() => { controls.ask(Control::Pause); continue; }
            _ = go_on.recv() => { controls.ask(Control::GoOn); continue; }
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
            _ = hangup.recv() => continue,
        }
        if stops.ask(Instant::now()) {
            stop(stops.n, token, controls);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signals_at_once_are_one_wish() {
        let start = Instant::now();
        let at = |ms: u64| start + Duration::from_millis(ms);
        let mut stops = Stops::default();
        let asked = [0, 1, 300, 1000, 1400, 2500].map(|ms| stops.ask(at(ms)));
        assert_eq!((asked, stops.n), ([true, false, false, true, false, true], 3));
    }

    #[test]
    fn the_second_wish_stops_the_printer_and_leaves_nothing_hot() {
        let (token, controls) = (CancelToken::default(), Controls::default());
        let _hearing = controls.hear();
        stop(1, &token, &controls);
        assert_eq!((token.is_cancelled(), controls.take()), (true, None));
        stop(2, &token, &controls);
        assert_eq!(controls.take(), Some(Control::EmergencyStop));
    }
}
