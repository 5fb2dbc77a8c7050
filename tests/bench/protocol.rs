//! The protocol core: how many lines it brings across in a second, by window and dialect, without a wire.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use lumenfab::printer::protocol::{Command, Core, Instant, State};
use std::hint::black_box;

const N_LINES: u64 = 10_000;

/// An answer to each line that the core sends.
struct Peer {
    last: u64,
    advanced: bool,
    said: Vec<String>,
}

impl Peer {
    fn hear(&mut self, bytes: &[u8]) {
        for line in std::str::from_utf8(bytes).expect("a job is text").lines().filter(|l| !l.is_empty()) {
            let number: u64 = line[1..].split(' ').next().and_then(|n| n.parse().ok()).expect("a number");
            if number == self.last + 1 || line.contains("M110") {
                self.last = number;
                self.said.push(if self.advanced { format!("ok N{number} P15 B3") } else { "ok".to_owned() });
            } else {
                let last = self.last;
                self.said.push(format!("Error:Line Number is not Last Line Number+1, Last Line: {last}"));
                self.said.push(format!("Resend: {}", last + 1));
                self.said.push("ok".to_owned());
            }
        }
    }
}

fn print(rx_bytes: usize, advanced: bool, lines: &[String]) -> u64 {
    let mut profile = lumenfab::profile::builtin("marlin").expect("built in");
    profile.firmware.rx_buffer_bytes = rx_bytes;
    let mut core = Core::new(&profile);
    let mut peer = Peer { last: 7, advanced, said: Vec::new() };
    let now = Instant::default();
    core.handle_command(now, Command::Connect).expect("not connected yet");
    let mut lines = lines.iter();
    let mut begun = false;
    loop {
        while core.wants_line() {
            let command = lines.next().map_or(Command::EndOfJob, |line| Command::Line(line));
            core.handle_command(now, command).expect("it wants lines");
        }
        while let Some(line) = core.poll_transmit() {
            peer.hear(line.bytes);
        }
        for line in std::mem::take(&mut peer.said) {
            core.handle_line(now, &line);
        }
        while core.poll_event().is_some() {}
        if *core.state() == State::Idle {
            if begun {
                return core.progress().n_lines_done;
            }
            begun = true;
            core.handle_command(now, Command::Begin).expect("idle");
        }
    }
}

fn lines_per_second(criterion: &mut Criterion) {
    let lines: Vec<_> =
        (0..N_LINES).map(|i| format!("G1 X{}.123 Y{}.456 E0.04567", i % 200, i % 190)).collect();
    let mut group = criterion.benchmark_group("protocol");
    group.throughput(Throughput::Elements(N_LINES));
    for advanced in [false, true] {
        for rx_bytes in [64, 128, 1024, 8192] {
            let name = if advanced { "advanced_ok" } else { "plain_ok" };
            group.bench_with_input(BenchmarkId::new(name, rx_bytes), &rx_bytes, |b, &rx_bytes| {
                b.iter(|| assert_eq!(print(rx_bytes, advanced, black_box(&lines)), N_LINES));
            });
        }
    }
    group.finish();
}

criterion_group!(benches, lines_per_second);
criterion_main!(benches);
