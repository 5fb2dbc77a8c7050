//! Streams of anything at all into splitter, parser and core: nothing panics, memory stays bounded, what is written stays whole.
//! A sample here; a million by `cargo test --release --lib a_million_streams -- --ignored`.

use super::super::*;
use super::firmware::Rng;
use std::time::Duration;

/// Pieces of what firmwares say.
const WORDS: [&str; 28] = [
    "ok",
    "ok N",
    "ok P15 B3",
    "ok T:200.1 /210.0 B:60 /60",
    "Resend: ",
    "Resend:",
    "rs ",
    "rs N",
    "skip ",
    "Error:checksum mismatch, Last Line: ",
    "Error:Line Number is not Last Line Number+1, Last Line: ",
    "Error:expected line ",
    "echo:busy: processing",
    "echo:busy: paused for user",
    "wait",
    "start",
    "Smoothie",
    "//action:pause",
    "//action:resume",
    "//action:cancel",
    "// Klipper state: Ready",
    "!! Move out of range",
    "!!",
    "fatal:",
    "Error:Printer halted. kill() called!",
    "X:1.00 Y:2.00 Z:3.00 E:4.00",
    " T:20 /0 W:?",
    "echo:Unknown command: \"G1 X\"",
];

fn stream(rng: &mut Rng) -> Vec<u8> {
    let mut bytes = Vec::new();
    for _ in 0..rng.below(24) {
        match rng.below(6) {
            0 => bytes.extend((0..rng.below(12)).map(|_| u8::try_from(rng.below(256)).unwrap())),
            1 => bytes.extend(rng.below(60).to_string().bytes()),
            2 => bytes.extend(rng.next().to_string().bytes()),
            _ => bytes.extend(WORDS[rng.below(WORDS.len())].bytes()),
        }
        if rng.chance(0.7) {
            bytes.push(b'\n');
        }
    }
    bytes
}

fn profiles() -> Vec<Profile> {
    let names = ["marlin", "klipper", "reprapfirmware", "repetier", "smoothie"];
    names.into_iter().map(|name| crate::profile::builtin(name).unwrap()).collect()
}

/// What is written is lines, whole and bounded.
fn drain(core: &mut Core) {
    let mut n_bytes = 0;
    while let Some(line) = core.poll_transmit() {
        assert!(line.bytes.ends_with(b"\n") && line.bytes.is_ascii());
        n_bytes += line.bytes.len();
    }
    assert!(n_bytes < 1 << 16, "{n_bytes} bytes at once");
    let n_events = std::iter::from_fn(|| core.poll_event()).count();
    assert!(n_events < 256, "{n_events} events at once");
}

fn take(rng: &mut Rng, profile: &Profile) {
    let mut core = Core::new(profile);
    let mut now = Instant::default();
    let begin = if rng.chance(0.3) { Command::Inquire { beyond: 40 } } else { Command::Connect };
    core.handle_command(now, begin).unwrap();
    let mut splitter = LineSplitter::default();
    for piece in stream(rng).chunks(1 + rng.below(40)) {
        splitter.feed(piece, |line| core.handle_line(now, line));
        let next = [Command::Begin, Command::GoOn, Command::Ask(Question::Position)][rng.below(3)];
        core.handle_command(now, next).ok();
        while core.wants_line() {
            core.handle_command(now, Command::Line("G1 X1 Y2 E3")).unwrap();
        }
        drain(&mut core);
        now = now + Duration::from_millis(rng.next() % 3000);
        core.handle_timeout(now);
        drain(&mut core);
        let progress = core.progress();
        assert!(progress.n_acked <= progress.n_sent, "{progress:?}");
    }
}

fn streams(n: u64) {
    let profiles = profiles();
    for seed in 0..n {
        let mut rng = Rng::new(seed + 1);
        let profile = &profiles[rng.below(profiles.len())];
        take(&mut rng, profile);
    }
}

#[test]
fn random_streams_leave_the_core_sound() {
    streams(5_000);
}

#[test]
#[ignore = "the full set: minutes"]
fn a_million_streams() {
    streams(1_000_000);
}
