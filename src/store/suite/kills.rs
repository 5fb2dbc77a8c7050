//! Hosts that are killed at any moment, come back and are killed again.

use super::hosts::{assert_all_printed_once, laid, print_all, spawn};
use super::*;
use std::process::Child;
use std::time::Duration;

/// Kills in the default run.
const N_KILLS: u32 = 20;
const N_JOBS: u16 = 60;

pub(in crate::store) async fn a_kill_at_any_moment_loses_nothing_and_prints_nothing_twice<T: Site>(site: &T) {
    kills(site, N_KILLS).await;
}

/// What the kills met.
#[derive(Debug, Default)]
struct Met {
    n_killed: u32,
    /// While the host had a job in hand.
    n_in_hand: u32,
    /// After material was announced, before the copy was said to be printed.
    n_laid: u32,
}

impl Met {
    /// So many, and in each part of the work; where chance has missed one of them so long, it never will.
    fn is_enough(&self, n_kills: u32) -> bool {
        let has_met_all = self.n_laid > 0 && self.n_in_hand > self.n_laid;
        self.n_killed >= n_kills && (has_met_all || self.n_killed >= 10 * n_kills)
    }
}

/// A host that prints is killed, comes back, is killed again, on one queue after the other.
pub(in crate::store) async fn kills<T: Site>(site: &T, n_kills: u32) {
    let mut dice = Dice(7);
    let mut met = Met::default();
    let mut n_queues = 0;
    while !met.is_enough(n_kills) {
        n_queues += 1;
        let dir = site.dir().join(n_queues.to_string());
        std::fs::create_dir(&dir).unwrap();
        kills_of_one_queue::<T>(&dir, &mut dice, n_kills, &mut met).await;
    }
    assert!(met.n_laid > 0 && met.n_in_hand > met.n_laid, "the kills met nothing: {met:?}");
}

/// As many kills as one queue lasts for; then the rest is printed.
async fn kills_of_one_queue<T: Site>(dir: &Path, dice: &mut Dice, n_kills: u32, met: &mut Met) {
    kill_while_it_is_made::<T>(dir, dice);
    while !met.is_enough(n_kills) {
        let store = T::open(dir);
        // The same tickets again: those that are there stay as they are.
        for number in 1..=N_JOBS {
            let made = ticket(number).made.filter(|_| number % 3 != 0);
            store.add(Ticket { made, ..ticket(number) }, true, operator(0)).await.unwrap();
        }
        try_again(&store).await;
        let mut host = spawn::<T>(dir, "print left");
        // Every fourth while it begins, or opens the store, or takes up what it had.
        if dice.below(4) > 0 {
            wait_for_records(&store, &mut host, 1 + dice.below(25)).await;
        }
        wait_ms(dice.below(15));
        host.kill().unwrap();
        let status = host.wait().unwrap();
        if status.success() {
            break;
        }
        assert!(status.code().is_none(), "the host ended by itself: {status}");
        met.n_killed += 1;
        assert_whole(&store, dir, met).await;
    }
    let store = T::open(dir);
    try_again(&store).await;
    print_all(&store, dir, "left").await;
    assert_all_printed_once(&store, dir, N_JOBS, 1).await;
}

/// Somebody lets jobs be tried again that were given up, because one host after the other was killed in the middle of them.
async fn try_again(store: &impl Store) {
    for job in store.list(Which::Over, None, 1000).await.unwrap() {
        if job.state == State::Failed {
            store.change(job.id, asks(Change::Retry, State::Failed, 0)).await.unwrap();
        }
    }
}

/// The very first host, about when the first file is there.
fn kill_while_it_is_made<T: Site>(dir: &Path, dice: &mut Dice) {
    let mut host = spawn::<T>(dir, "print left");
    while std::fs::read_dir(dir).unwrap().next().is_none() && host.try_wait().unwrap().is_none() {
        wait_ms(1);
    }
    wait_ms(dice.below(15));
    host.kill().unwrap();
    host.wait().unwrap();
}

/// Whatever was met: no job is lost, none laid twice, and the history tells all.
async fn assert_whole(store: &impl Store, dir: &Path, met: &mut Met) {
    store.verify().await.unwrap();
    let jobs = [Which::Live, Which::Over].map(|which| store.list(which, None, 1000));
    let [live, over] = jobs;
    let (live, over) = (live.await.unwrap(), over.await.unwrap());
    assert_eq!(live.len() + over.len(), usize::from(N_JOBS));
    let in_hand: Vec<_> = live.iter().filter(|job| job.state.is_claimed()).collect();
    met.n_in_hand += u32::try_from(in_hand.len()).unwrap();
    met.n_laid += u32::try_from(in_hand.iter().filter(|job| job.is_laid).count()).unwrap();
    let n_printed = live.iter().chain(&over).map(|job| usize::from(job.n_printed)).sum::<usize>();
    let laid = laid(dir);
    assert!(laid.values().all(|&n| n == 1), "{laid:?}");
    // What is laid and not said yet is the one copy in hand.
    assert!((n_printed..=n_printed + 1).contains(&laid.len()), "{n_printed} are printed of {laid:?}");
}

/// Until the host has written so many records, or has ended.
async fn wait_for_records(store: &impl Store, host: &mut Child, n_records: u64) {
    let until = store.head().await.unwrap().seq + n_records;
    while store.head().await.unwrap().seq < until && host.try_wait().unwrap().is_none() {
        wait_ms(1);
    }
}

fn wait_ms(ms: u64) {
    std::thread::park_timeout(Duration::from_millis(ms));
}
