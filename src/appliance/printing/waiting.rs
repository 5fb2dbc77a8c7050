//! A print that broke off, until somebody says what becomes of it.

use super::station::{LOOK, Station, next_wish};
use super::{Held, Shown};
use crate::appliance::config::OnStop;
use crate::appliance::heat::Hot;
use crate::appliance::kit::ended;
use crate::http::appliance::{Unheard, Wish, Wished};
use crate::http::wire::Activity;
use crate::printer::journal::path_for;
use crate::queue::{Change, Job, Name, Reason};
use crate::store::{self, Store};
use std::path::Path;
use std::time::Duration;
use tokio::time::{Instant, sleep_until};

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
    /// Nothing: the job is not this printer's any more.
    Lost,
}

impl<S: Store> Station<S> {
    /// Waits; the printer stays warm as long as its profile says, and is switched off then.
    pub(super) async fn wait_for_word(&mut self, held: &mut Held, why: &str) -> Word {
        let mut says = if held.needs_consent {
            format!("{why}; `go-on` once more does it, `cancel` gives it up")
        } else {
            format!(
                "{why}: look at the part, then let it go on (`queue go-on`) or give it up (`queue cancel`)"
            )
        };
        self.board.waits(held.claim.job, says.clone());
        self.tell("print-broke-off", Some(held.claim.job), &says);
        // Armed before anything is waited for: a queue that takes no record keeps no heater on.
        let left = self.hold_left(&held.gcode);
        let mut cold_at = Some(Instant::now() + left);
        let mut stopping = self.kit.stopping.clone();
        let (kit, machine, claim) = (self.kit.clone(), self.machine.clone(), held.claim.clone());
        let (hot, is_shown) = (Hot::waits(kit.now(), left), held.shown == Shown::Paused);
        let mut recording = std::pin::pin!(async {
            machine.tell_heat(Some(hot)).await;
            if is_shown {
                Shown::Paused
            } else {
                shown_after(kit.insist(&claim, Change::Pause, None, why).await)
            }
        });
        let mut kept = std::pin::pin!(self.kit.clone().keep(held.claim.clone()));
        held.is_paused = true;
        held.shown = if is_shown { Shown::Paused } else { Shown::Unknown };
        let (mut is_recorded, mut look) = (false, Instant::now());
        loop {
            tokio::select! {
                () = sleep_until(look) => {
                    look = Instant::now() + LOOK;
                    // Its bed is taken, and what is wrong with its port is told.
                    self.look_after().await.ok();
                    self.board.set(Activity::Paused, Some(self.with_heaters(&says)));
                }
                Some(wished) = next_wish(&mut self.wishes) => if wished.wish == Wish::EmergencyStop && !is_other(held, &wished) {
                    if self.stop_at_once(wished.answer).await {
                        cold_at = None;
                        says = format!("{}; {says}", self.halted.take().unwrap_or_default());
                    }
                } else if let Some(word) = heed(held, wished) {
                    if let Word::GiveUp { .. } = word {
                        self.switch_off().await;
                    }
                    return word;
                },
                shown = &mut recording, if !is_recorded => (is_recorded, held.shown) = (true, shown),
                () = &mut kept => {
                    self.switch_off().await;
                    return Word::Lost;
                }
                () = sleep_until(cold_at.unwrap_or_else(Instant::now)), if cold_at.is_some() => {
                    cold_at = None;
                    self.switch_off().await;
                }
                () = ended(&mut stopping) => {
                    if self.kit.stopping() == Some(OnStop::Cancel) {
                        self.switch_off().await;
                    }
                    return Word::Nothing;
                }
            }
        }
    }

    /// How long the heaters may stay on: counted from the last word of the print's journal.
    pub(super) fn hold_left(&self, gcode: &Path) -> Duration {
        let hold = self.hold();
        let written = std::fs::metadata(path_for(gcode)).and_then(|found| found.modified());
        // A clock that was set back does not tell: no time is left then.
        let away = written.ok().and_then(|at| at.elapsed().ok()).unwrap_or(hold);
        hold.saturating_sub(away)
    }
}

/// What the queue has the job down as, once it was asked to have it as paused.
fn shown_after(recorded: Result<Job, store::Error>) -> Shown {
    match recorded {
        Ok(_) => Shown::Paused,
        Err(error) => {
            tracing::warn!("print: {error}");
            Shown::Unknown
        }
    }
}

/// Whether it is about another job than the one that waits.
fn is_other(held: &Held, wished: &Wished) -> bool {
    wished.job.is_some_and(|job| job != held.claim.job)
}

fn heed(held: &mut Held, wished: Wished) -> Option<Word> {
    let is_other = is_other(held, &wished);
    let Wished { wish, by, why, answer, .. } = wished;
    let not_now = |text: &str| Err(Unheard::NotNow(text.to_owned()));
    let (said, word) = match wish {
        _ if is_other => (not_now("the printer has another job"), None),
        Wish::GoOn => (Ok(()), Some(Word::GoOn { after_reset: held.needs_consent })),
        Wish::Cancel => (Ok(()), Some(Word::GiveUp { by, why })),
        Wish::Pause => (not_now("it is paused"), None),
        // Seen to before.
        Wish::EmergencyStop => (Ok(()), None),
        Wish::Connect => (Ok(()), None),
        Wish::Disconnect => (not_now("a print waits on it: let it go on, or cancel it"), None),
        Wish::Commands(_) => (not_now("a print waits on it: let it go on, or cancel it"), None),
    };
    // Whoever has left believes that nothing is done, and may ask again.
    answer.send(said).ok()?;
    held.needs_consent &= !matches!(word, Some(Word::GoOn { .. }));
    word
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::sync::{mpsc, oneshot};

    fn wished(wish: Wish) -> (Wished, oneshot::Receiver<Result<(), Unheard>>) {
        let (answer, answered) = oneshot::channel();
        let (printer, by) = (Name::try_new("left").unwrap(), Name::try_new("Ada").unwrap());
        (Wished { printer, job: None, wish, by, why: Reason::default(), answer }, answered)
    }

    #[tokio::test]
    async fn a_wish_whose_answer_nobody_awaits_any_more_is_passed_over() {
        let (desk, mut wishes) = mpsc::channel(4);
        let ((left, gone), (stays, _awaited)) = (wished(Wish::GoOn), wished(Wish::Cancel));
        drop(gone);
        for wished in [left, stays] {
            desk.send(wished).await.unwrap();
        }
        drop(desk);
        assert_eq!(next_wish(&mut wishes).await.unwrap().wish, Wish::Cancel);
        assert!(next_wish(&mut wishes).await.is_none());
    }
}
