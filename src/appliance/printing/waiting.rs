//! A print that broke off, until somebody says what becomes of it.

use super::Held;
use super::station::{NOTHING_SENT, Station};
use crate::appliance::kit::ended;
use crate::http::appliance::{Unheard, Wish, Wished};
use crate::http::wire::Activity;
use crate::printer::journal::path_for;
use crate::queue::{Change, Name, Reason};
use crate::store::Store;
use std::path::Path;
use std::time::Duration;
use tokio::time::{Instant, sleep_until};

/// How often the queue is told that the printer is alive.
const BEAT: Duration = Duration::from_secs(20);

/// What somebody has said.
#[derive(Debug)]
pub(super) enum Word {
    /// Go on; after a reset only where that was said once it was known.
    GoOn {
        /// Whether that was known.
        after_reset: bool,
    },
    /// Give it up.
    GiveUp {
        /// Who.
        by: Name,
        /// Why.
        why: Reason,
    },
    /// Nothing: the server ends; the next one waits on.
    Nothing,
}

impl<S: Store> Station<S> {
    /// Waits; the printer stays warm as long as its profile says, and is switched off then.
    pub(super) async fn wait_for_word(&mut self, held: &mut Held, why: &str) -> Word {
        let says = if held.needs_consent {
            format!("{why}; `go-on` once more does it, `cancel` gives it up")
        } else {
            format!(
                "{why}: look at the part, then let it go on (`queue go-on`) or give it up (`queue cancel`)"
            )
        };
        self.board.end(Activity::Paused, Some(says.clone()));
        self.tell("print-broke-off", Some(held.claim.job), &says);
        if !held.is_paused {
            held.is_paused = true;
            if let Err(error) = self.kit.insist(&held.claim, Change::Pause, None, why).await {
                tracing::warn!(printer = %self.name(), job = %held.claim.job, "print: {error}");
            }
        }
        let mut stopping = self.kit.stopping.clone();
        let mut cold_at = Some(Instant::now() + self.hold_left(&held.gcode));
        let mut beat = Instant::now();
        loop {
            tokio::select! {
                Some(wished) = self.wishes.recv() => if let Some(word) = heed(held, wished) {
                    if let Word::GiveUp { .. } = word {
                        self.switch_off().await;
                    }
                    return word;
                },
                () = sleep_until(beat) => {
                    beat = Instant::now() + BEAT;
                    match self.kit.store.renew(held.claim.clone(), self.kit.now()).await {
                        Ok(claim) => held.claim = claim,
                        Err(error) => tracing::warn!(printer = %self.name(), "print: the claim was not renewed: {error}"),
                    }
                }
                () = sleep_until(cold_at.unwrap_or(beat)), if cold_at.is_some() => {
                    cold_at = None;
                    self.switch_off().await;
                }
                () = ended(&mut stopping) => return Word::Nothing,
            }
        }
    }

    /// How long the heaters may stay on: counted from the last word of the print's journal.
    fn hold_left(&self, gcode: &Path) -> Duration {
        let hold = Duration::from_secs_f64(self.machine.profile.firmware.orphan_hold_s);
        let written = std::fs::metadata(path_for(gcode)).and_then(|found| found.modified());
        // A clock that was set back does not tell: no time is left then.
        let away = written.ok().and_then(|at| at.elapsed().ok()).unwrap_or(hold);
        hold.saturating_sub(away)
    }
}

fn heed(held: &mut Held, wished: Wished) -> Option<Word> {
    let Wished { job, wish, by, why, answer, .. } = wished;
    let not_now = |text: &str| Err(Unheard::NotNow(text.to_owned()));
    let is_other = job.is_some_and(|job| job != held.claim.job);
    let (said, word) = match wish {
        _ if is_other => (not_now("the printer has another job"), None),
        Wish::GoOn => {
            let after_reset = std::mem::take(&mut held.needs_consent);
            (Ok(()), Some(Word::GoOn { after_reset }))
        }
        Wish::Cancel => (Ok(()), Some(Word::GiveUp { by, why })),
        Wish::Pause => (not_now("it is paused"), None),
        Wish::EmergencyStop => (not_now(NOTHING_SENT), None),
        Wish::Connect => (Ok(()), None),
        Wish::Disconnect => (not_now("a print waits on it: let it go on, or cancel it"), None),
        Wish::Commands(_) => (not_now("a print waits on it: let it go on, or cancel it"), None),
    };
    // Whoever asked may have left.
    answer.send(said).ok();
    word
}
