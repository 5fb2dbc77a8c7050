//! Hosts that are killed at any moment, come back and are killed again.

use super::hosts::{assert_all_printed_once, begun, laid, print_all, spawn};
use super::*;
use std::process::Child;
use std::time::Duration;

/// Kills in the default run.
const N_KILLS: u32 = 20;
const N_JOBS: u16 = 150;

pub(in crate::store) async fn a_kill_at_any_moment_loses_nothing_and_prints_nothing_twice<T: Site>(site: &T) {
    kills(site, N_KILLS).await;
}

/// A host that prints is killed, comes back, is killed again; the first ones before there is any file.
pub(in crate::store) async fn kills<T: Site>(site: &T, n_kills: u32) {
    let mut dice = Dice(7);
    let mut n_killed = 0;
    let mut n_rounds = 0;
    while n_killed < n_kills {
        n_rounds += 1;
        let dir = site.dir().join(n_rounds.to_string());
        std::fs::create_dir(&dir).unwrap();
        n_killed += kills_of_one_queue::<T>(&dir, &mut dice, n_kills - n_killed).await;
    }
}

/// As many kills as one queue lasts for, at most so many.
async fn kills_of_one_queue<T: Site>(dir: &Path, dice: &mut Dice, most: u32) -> u32 {
    let mut n_killed = 0;
    let mut is_filled = false;
    while n_killed < most {
        let mut child = spawn::<T>(dir, "print left");
        wait_for_begin(dir, &mut child);
        // Every fourth while it opens the store or takes up what it had.
        wait_ms(if dice.below(4) == 0 { dice.below(15) } else { dice.below(250) });
        child.kill().unwrap();
        let status = child.wait().unwrap();
        if status.success() && is_filled {
            break;
        }
        assert!(status.success() || status.code().is_none(), "the host ended by itself: {status}");
        n_killed += u32::from(!status.success());
        let store = T::open(dir);
        store.verify().await.unwrap();
        assert!(laid(dir).values().all(|&n| n == 1), "{:?}", laid(dir));
        is_filled = true;
        // The same tickets again: those that are there stay as they are.
        for number in 1..=N_JOBS {
            let made = ticket(number).made.filter(|_| number % 3 != 0);
            store.add(Ticket { made, ..ticket(number) }, true, operator(0)).await.unwrap();
        }
    }
    assert!(most < 10 || laid(dir).len() > 10, "the hosts did not print");
    let store = T::open(dir);
    print_all(&store, dir, "left").await;
    assert_all_printed_once(&store, dir, N_JOBS, 1).await;
    n_killed
}

fn wait_for_begin(dir: &Path, host: &mut Child) {
    while std::fs::remove_file(begun(dir)).is_err() && host.try_wait().unwrap().is_none() {
        wait_ms(1);
    }
}

fn wait_ms(ms: u64) {
    std::thread::park_timeout(Duration::from_millis(ms));
}
