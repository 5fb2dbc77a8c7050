//! Asking a printer that is not printing, and switching its heaters off.

use super::print::{Printer, check_printer, check_real, runtime};
use crate::app::error::Error;
use crate::app::settings::{DEFAULT_PROFILE, SIMULATED_PORT};
use crate::printer::ask::{self, Found};
use crate::printer::protocol::Temperatures;
use crate::printer::{self, PortProblem, paper, serial};
use crate::profile;
use crate::progress::CancelToken;
use serde::Serialize;
use std::path::Path;
use std::time::Duration;

/// Between two looks whether the wait is over.
const LOOK: Duration = Duration::from_millis(200);

/// What became of the heaters.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum SafeOff {
    /// They are off, and the printer says so.
    Off(Temperatures),
    /// Another program has the port, after a wait: it looks after them.
    LeftToAnother {
        /// Always.
        in_use: bool,
    },
}

impl std::fmt::Display for SafeOff {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Off(_) => "the heaters are off",
            Self::LeftToAnother { .. } => "the port is in use again: the heaters are left to that program",
        })
    }
}

/// Switches the heaters of a printer off, after a while in which its print may be gone on with; whoever asks to stop ends the wait, not
/// the switching off. The port is not touched before.
///
/// # Errors
/// [`Error`] where profile or port cannot be used, where nothing answers, or where they stay on.
pub fn safe_off(printer: Printer<'_>, after: Duration, cancel: &CancelToken) -> Result<SafeOff, Error> {
    let profile = profile::load::by_name(printer.profile_name)?;
    let port = printer.port.unwrap_or(SIMULATED_PORT);
    check_real(port)?;
    runtime()?.block_on(async {
        wait(after, cancel).await;
        check_printer(port, printer.baud)?;
        let firmware = paper::undisturbed(&profile);
        let link = match serial::open(Path::new(port), &firmware, printer.baud).await {
            Err(printer::Error::Open { problem: PortProblem::Busy(_), .. }) if !after.is_zero() => {
                return Ok(SafeOff::LeftToAnother { in_use: true });
            }
            link => link?,
        };
        Ok(SafeOff::Off(ask::safe_off(link, &profile).await?))
    })
}

async fn wait(after: Duration, cancel: &CancelToken) {
    let stopped = async {
        while !cancel.is_cancelled() {
            tokio::time::sleep(LOOK).await;
        }
    };
    // Either way the wait is over.
    tokio::time::timeout(after, stopped).await.ok();
}

/// Asks the printer on a port which firmware it has.
///
/// # Errors
/// [`Error`] where the port cannot be used, or where nothing answers.
pub fn detect(port: &str, baud: Option<u32>) -> Result<Found, Error> {
    let profile = profile::builtin(DEFAULT_PROFILE)?;
    check_real(port)?;
    check_printer(port, baud)?;
    let rates = baud.map_or(COMMON_RATES.to_vec(), |baud| vec![baud]);
    runtime()?.block_on(async {
        let mut last = None;
        for rate in rates {
            let link = serial::open(Path::new(port), &paper::undisturbed(&profile), Some(rate)).await?;
            match ask::detect(link).await {
                Err(error @ printer::Error::Nobody { .. }) => last = Some(error),
                found => return Ok(found?),
            }
        }
        Err(last.map_or_else(|| Error::Runtime(std::io::ErrorKind::InvalidInput.into()), Error::from))
    })
}

/// Rates that boards come with.
const COMMON_RATES: [u32; 2] = [115_200, 250_000];
