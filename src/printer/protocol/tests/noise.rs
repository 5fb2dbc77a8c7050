//! Every fault of the wire, at several rates, windows and dialects: each move is executed exactly once.

use super::super::*;
use super::firmware::{Noise, Setup};
use super::pair::{Pair, job};
use std::time::Duration;

/// Prints the job through this noise and says what it cost.
fn prints_exactly_once(setup: &Setup, n_lines: usize) -> (Stats, Duration) {
    let mut pair = Pair::new(setup.clone(), job(n_lines));
    pair.run();
    assert_eq!(pair.end(), Some(&Event::Finished), "{setup:?} {:?}", pair.core);
    let wanted = job(n_lines);
    let (moves, n) = (pair.moves(), wanted.len());
    let differs = moves.iter().zip(&wanted).position(|(got, want)| got != want).unwrap_or(n.min(moves.len()));
    assert!(moves.len() == n && differs == n, "move {differs}: {:?} {setup:?}", moves.get(differs));
    assert_eq!(pair.core.progress().n_lines_done, n_lines as u64);
    (pair.core.stats(), pair.now.since(Instant::default()))
}

fn grid(noise: impl Fn(f64) -> Noise) {
    for rate in [0.01, 0.05, 0.2] {
        for (rx_bytes, slots) in [(64, 1), (128, 4), (1024, 16), (4096, 4)] {
            for advanced_ok in [false, true] {
                for seed in 1..=3 {
                    let noise = noise(rate);
                    let setup = Setup { rx_bytes, slots, advanced_ok, noise, seed, ..Setup::default() };
                    prints_exactly_once(&setup, 300);
                }
            }
        }
    }
}

#[test]
fn a_clean_wire_needs_no_recovery() {
    for advanced_ok in [false, true] {
        for (rx_bytes, slots) in [(64, 1), (128, 4), (1024, 16), (4096, 4)] {
            let setup = Setup { rx_bytes, slots, advanced_ok, ..Setup::default() };
            let mut pair = Pair::new(setup, job(2000));
            pair.run();
            assert_eq!(pair.firmware.n_overflows, 0);
            let stats = pair.core.stats();
            assert_eq!((stats.n_resends, stats.n_lost_oks, stats.n_probes), (0, 0, 1), "{stats:?}");
            assert_eq!(pair.moves(), job(2000));
        }
    }
}

#[test]
fn slow_moves_are_waited_for_without_overflow() {
    for advanced_ok in [false, true] {
        for ms in [1600, 3000, 30_000] {
            let command_time = Duration::from_millis(ms);
            let setup = Setup { advanced_ok, command_time, ..Setup::default() };
            let mut pair = Pair::new(setup, job(60));
            pair.run();
            assert_eq!(pair.end(), Some(&Event::Finished));
            assert_eq!(pair.moves(), job(60));
            assert_eq!(pair.firmware.n_overflows, 0);
            assert_eq!(pair.core.stats().n_lost_oks, 0, "{advanced_ok} {ms}");
        }
    }
}

#[test]
fn bit_errors() {
    grid(|bit_error| Noise { bit_error, ..Noise::default() });
}

#[test]
fn bit_errors_in_the_answers() {
    grid(|reply_bit_error| Noise { reply_bit_error, ..Noise::default() });
}

#[test]
fn lost_and_doubled_bytes() {
    grid(|rate| Noise { lost_byte: rate / 2.0, doubled_byte: rate / 2.0, ..Noise::default() });
}

#[test]
fn half_lines() {
    grid(|half_line| Noise { half_line, ..Noise::default() });
}

#[test]
fn lost_oks() {
    grid(|lost_ok| Noise { lost_ok, ..Noise::default() });
}

#[test]
fn spurious_and_wrong_resends() {
    grid(|rate| Noise { spurious_resend: rate, wrong_resend: rate, bit_error: rate, ..Noise::default() });
}

#[test]
fn garbage_between_the_answers() {
    grid(|garbage| Noise { garbage, ..Noise::default() });
}

#[test]
fn everything_at_once() {
    grid(|rate| Noise {
        bit_error: rate / 4.0,
        reply_bit_error: rate / 4.0,
        lost_byte: rate / 4.0,
        doubled_byte: rate / 4.0,
        half_line: rate / 4.0,
        lost_ok: rate / 4.0,
        spurious_resend: rate / 4.0,
        wrong_resend: rate / 4.0,
        garbage: rate / 4.0,
    });
}

#[test]
fn one_line_in_a_hundred_damaged_costs_little_time() {
    for advanced_ok in [false, true] {
        let noise = Noise { bit_error: 0.01, ..Noise::default() };
        let setup = Setup { noise, advanced_ok, ..Setup::default() };
        let (_, clean) = prints_exactly_once(&Setup { advanced_ok, ..Setup::default() }, 3000);
        let (stats, noisy) = prints_exactly_once(&setup, 3000);
        assert!(stats.n_resends >= 20 && stats.n_resends < 60, "{stats:?}");
        assert!(noisy < clean * 2, "{advanced_ok}: {clean:?} {noisy:?} {stats:?}");
    }
}
