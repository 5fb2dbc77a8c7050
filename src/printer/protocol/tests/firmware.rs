//! A firmware of the Marlin kind, written for these tests from what real ones were seen to answer, on a made-up
//! clock: a receive buffer that overflows, a command queue, commands that take time, and a line full of noise.

use super::super::Instant;
use std::collections::{HashSet, VecDeque};
use std::time::Duration;

/// xorshift64*: the tests' only source of chance.
#[derive(Debug)]
pub(super) struct Rng(u64);

impl Rng {
    pub(super) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    pub(super) fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11
    }

    pub(super) fn chance(&mut self, rate: f64) -> bool {
        rate > 0.0 && (self.next() as f64) < rate * (1_u64 << 53) as f64
    }

    pub(super) fn below(&mut self, n: usize) -> usize {
        usize::try_from(self.next() % n as u64).unwrap()
    }
}

/// How often things go wrong, per line.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Noise {
    pub(super) bit_error: f64,
    pub(super) reply_bit_error: f64,
    pub(super) lost_byte: f64,
    pub(super) doubled_byte: f64,
    pub(super) half_line: f64,
    pub(super) lost_ok: f64,
    pub(super) spurious_resend: f64,
    pub(super) wrong_resend: f64,
    pub(super) garbage: f64,
}

#[derive(Debug, Clone)]
pub(super) struct Setup {
    pub(super) rx_bytes: usize,
    pub(super) slots: usize,
    pub(super) advanced_ok: bool,
    pub(super) command_time: Duration,
    pub(super) noise: Noise,
    pub(super) seed: u64,
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            rx_bytes: 128,
            slots: 4,
            advanced_ok: false,
            command_time: Duration::from_millis(2),
            noise: Noise::default(),
            seed: 1,
        }
    }
}

#[derive(Debug)]
struct Running {
    number: Option<u64>,
    command: String,
    until: Instant,
    next_busy: Instant,
}

#[derive(Debug)]
pub(super) struct Firmware {
    setup: Setup,
    rng: Rng,
    rx: Vec<u8>,
    line: Vec<u8>,
    slots: VecDeque<(Option<u64>, String)>,
    running: Option<Running>,
    last: u64,
    /// Lines for the host.
    pub(super) said: VecDeque<String>,
    /// Commands executed, in order.
    pub(super) executed: Vec<String>,
    pub(super) n_overflows: usize,
    /// Lines as the host sent them. Damage that the eight bits of the checksum miss (one in 256, where more than one bit
    /// is hit) is beyond any host: here it is found, so that the tests judge the host alone.
    sent: HashSet<String>,
    pub(super) is_dead: bool,
}

impl Firmware {
    pub(super) fn new(setup: Setup) -> Self {
        Self {
            rng: Rng::new(setup.seed),
            setup,
            rx: Vec::new(),
            line: Vec::new(),
            slots: VecDeque::new(),
            running: None,
            last: 77,
            said: VecDeque::new(),
            executed: Vec::new(),
            n_overflows: 0,
            sent: HashSet::new(),
            is_dead: false,
        }
    }

    /// Bytes arrive, one line of the host at a time.
    pub(super) fn receive(&mut self, bytes: &[u8]) {
        if self.is_dead {
            return;
        }
        let mut bytes = bytes.to_vec();
        self.sent.insert(String::from_utf8_lossy(&bytes).trim().to_owned());
        self.damage(&mut bytes);
        if bytes.ends_with(b"M410\n") || bytes == b"M108\n" {
            // The emergency parser acts before the queue does.
            if let Some(running) = &mut self.running {
                running.until = Instant::default();
            }
        }
        let room = self.setup.rx_bytes.saturating_sub(self.rx.len());
        self.n_overflows += usize::from(bytes.len() > room);
        bytes.truncate(room);
        self.rx.extend(bytes);
    }

    fn damage(&mut self, bytes: &mut Vec<u8>) {
        let noise = self.setup.noise;
        if self.rng.chance(noise.bit_error) {
            let at = self.rng.below(bytes.len());
            bytes[at] ^= 1 << self.rng.below(7);
        }
        if self.rng.chance(noise.lost_byte) {
            let at = self.rng.below(bytes.len());
            bytes.remove(at);
        }
        if self.rng.chance(noise.doubled_byte) {
            let at = self.rng.below(bytes.len());
            bytes.insert(at, bytes[at]);
        }
        if self.rng.chance(noise.half_line) {
            let keep = self.rng.below(bytes.len());
            bytes.truncate(keep);
        }
    }

    fn say(&mut self, line: impl Into<String>) {
        let mut line: String = line.into();
        let noise = self.setup.noise;
        if line.starts_with("ok") && self.rng.chance(noise.lost_ok) {
            return;
        }
        if self.rng.chance(noise.garbage) {
            self.said.push_back("\u{fffd}x#\u{fffd}".to_owned());
        }
        if line.is_ascii() && self.rng.chance(noise.reply_bit_error) {
            let at = self.rng.below(line.len());
            let mut bytes = line.into_bytes();
            bytes[at] ^= 1 << self.rng.below(6);
            line = String::from_utf8_lossy(&bytes).into_owned();
        }
        self.said.push_back(line);
    }

    fn say_ok(&mut self, number: Option<u64>) {
        let free = self.setup.slots - self.slots.len() - 1;
        let text = match (self.setup.advanced_ok, number) {
            (false, _) => "ok".to_owned(),
            (true, Some(n)) => format!("ok N{n} P15 B{free}"),
            (true, None) => format!("ok P15 B{free}"),
        };
        self.say(text);
    }

    fn refuse(&mut self, why: &str) {
        self.rx.clear();
        self.say(format!("Error:{why}, Last Line: {}", self.last));
        let asked = if self.rng.chance(self.setup.noise.wrong_resend) {
            (self.last + 1 + self.rng.next() % 5).saturating_sub(2)
        } else {
            self.last + 1
        };
        self.say(format!("Resend: {asked}"));
        let oldest = self.slots.front().and_then(|(n, _)| *n);
        self.say_ok(oldest.filter(|_| self.slots.len() < self.setup.slots));
    }

    /// When something will happen without the host.
    pub(super) fn next_event(&self) -> Option<Instant> {
        self.running.as_ref().filter(|_| !self.is_dead).map(|r| r.until.min(r.next_busy))
    }

    /// Lives on until `now`.
    pub(super) fn run(&mut self, now: Instant) {
        while !self.is_dead {
            if let Some(running) = &mut self.running {
                if running.until > now {
                    if running.next_busy <= now {
                        running.next_busy = now + Duration::from_secs(2);
                        self.say("echo:busy: processing");
                    }
                    return;
                }
                self.finish();
            }
            self.read();
            let Some((number, command)) = self.slots.pop_front() else { return };
            let takes = self.time_of(&command);
            let next_busy = now + Duration::from_secs(2);
            self.running = Some(Running { number, command, until: now + takes, next_busy });
        }
    }

    fn time_of(&self, command: &str) -> Duration {
        match command.split_once(" S") {
            Some(("M109" | "G28" | "G4", s)) => Duration::from_secs(s.parse().unwrap_or(0)),
            _ if command.starts_with("G1") => self.setup.command_time,
            _ => Duration::from_millis(1),
        }
    }

    fn finish(&mut self) {
        let Some(done) = self.running.take() else { return };
        if !done.command.starts_with(['G', 'M', 'T']) {
            self.say(format!("echo:Unknown command: \"{}\"", done.command));
        }
        match done.command.as_str() {
            "M105" => self.say("ok T:20.00 /0.00 B:20.00 /0.00 @:0 B@:0"),
            _ => self.say_ok(done.number),
        }
        self.executed.push(done.command);
        if self.rng.chance(self.setup.noise.spurious_resend) {
            let asked = self.last + 1 - self.rng.next() % 2;
            self.say(format!("Resend: {asked}"));
            self.say_ok(done.number);
        }
    }

    /// Bytes from the buffer to the line, lines to the queue, as far as there is room in it.
    fn read(&mut self) {
        while self.slots.len() < self.setup.slots && !self.rx.is_empty() {
            let byte = self.rx.remove(0);
            if byte != b'\n' {
                if self.line.len() < 95 {
                    self.line.push(byte);
                }
                continue;
            }
            let line = String::from_utf8_lossy(&std::mem::take(&mut self.line)).trim().to_owned();
            if !line.is_empty() {
                self.accept(&line);
            }
        }
    }

    fn accept(&mut self, line: &str) {
        let Some(rest) = line.strip_prefix('N') else {
            self.slots.push_back((None, line.to_owned()));
            return;
        };
        let number: u64 = rest.split(|c: char| !c.is_ascii_digit()).next().unwrap().parse().unwrap_or(0);
        let Some((body, sum)) = line.rsplit_once('*') else {
            return self.refuse("No Checksum with line number");
        };
        if sum.parse() != Ok(body.bytes().fold(0, |a: u8, b| a ^ b)) || !self.sent.contains(line) {
            return self.refuse("checksum mismatch");
        }
        let command = body.split_once(' ').map_or("", |(_, c)| c);
        if !command.starts_with("M110") {
            if number == self.last || number + 1 == self.last {
                return;
            }
            if number != self.last + 1 {
                return self.refuse("Line Number is not Last Line Number+1");
            }
        }
        self.last = number;
        self.slots.push_back((Some(number), command.to_owned()));
    }
}
