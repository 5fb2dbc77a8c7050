//! What the service manager is told (IO): ready, alive, stopping. Without one nothing happens.

use sd_notify::NotifyState;
use std::time::Duration;

/// How often it is told that the server lives, where nothing is said about that.
const OFTEN: Duration = Duration::from_secs(10);

/// The service manager.
#[derive(Debug)]
pub(super) struct System {
    watchdog: Option<Duration>,
}

impl Default for System {
    fn default() -> Self {
        Self { watchdog: sd_notify::watchdog_enabled() }
    }
}

impl System {
    pub(super) fn ready(&self) {
        tell(&[NotifyState::Ready]);
    }

    pub(super) fn stopping(&self) {
        tell(&[NotifyState::Stopping]);
    }

    /// Twice as often as it has to be.
    pub(super) fn watchdog_interval(&self) -> Duration {
        self.watchdog.map_or(OFTEN, |longest| (longest / 2).clamp(Duration::from_millis(100), OFTEN))
    }

    pub(super) fn alive(&self, status: &str) {
        tell(&[NotifyState::Watchdog, NotifyState::Status(status)]);
    }
}

fn tell(state: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(state) {
        tracing::debug!("service manager: {error}");
    }
}
