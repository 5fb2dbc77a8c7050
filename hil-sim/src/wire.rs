//! The link: baud rate and line faults, both ways.
//!
//! Lines, not bytes, are what faults strike, so the host's bytes are held until a line is complete. Without a baud rate the
//! link is flow-controlled and delivers a line when the receive ring has room for the whole of it; with one, each byte takes
//! ten bit times each way and a byte that finds the ring full is lost. Times are simulated seconds.

use crate::{
    receive::{Emergency, Receiver},
    rng::Rng,
    spec::Kind,
    whole,
};
use std::collections::VecDeque;

/// Start bit, eight data bits, stop bit.
const BITS_PER_BYTE: f64 = 10.0;
/// A host that sends this much without a line end is not held back any longer.
const LONGEST_HELD_LINE: usize = 4096;

/// Does to `line` (with its line end) what `kind` says; what it did, for the record.
pub fn damage(kind: Kind, line: &mut Vec<u8>, rng: &mut Rng) -> String {
    let at = rng.below(line.len());
    match kind {
        Kind::BitError if !line.is_empty() => {
            let bit = rng.below(8);
            line[at] ^= 1 << bit;
            format!("byte {at}, bit {bit}")
        }
        Kind::LostByte if !line.is_empty() => format!("byte {at}: {:#04x}", line.remove(at)),
        Kind::DoubledByte if !line.is_empty() => {
            line.insert(at, line[at]);
            format!("byte {at}: {:#04x}", line[at])
        }
        Kind::HalfLine => {
            line.truncate(at);
            format!("{at} bytes left")
        }
        Kind::Garbage => {
            let n = 4 + rng.below(29);
            let noise: Vec<u8> = (0..n).map(|_| (rng.next_u64() & 0xFF) as u8).collect();
            line.splice(0..0, noise);
            format!("{n} bytes")
        }
        Kind::WrongResend => spoil_checksum(line),
        _ => String::new(),
    }
}

/// Makes the checksum of a numbered line wrong.
fn spoil_checksum(line: &mut [u8]) -> String {
    match line.iter().rposition(u8::is_ascii_digit) {
        Some(at) => {
            line[at] = if line[at] == b'9' { b'8' } else { line[at] + 1 };
            format!("byte {at}")
        }
        None => String::new(),
    }
}

/// A line under way to the printer.
#[derive(Debug, Clone)]
struct InFlight {
    /// When its first bit leaves the host.
    start_s: f64,
    bytes: Vec<u8>,
    /// Bytes that have arrived.
    arrived: usize,
}

/// The way from the host.
#[derive(Debug, Clone)]
pub struct Incoming {
    byte_s: f64,
    held: Vec<u8>,
    flying: VecDeque<InFlight>,
    free_s: f64,
    /// Bytes that found the ring full.
    pub overrun_bytes: u64,
}

impl Incoming {
    /// At `baud`, or flow-controlled.
    #[must_use]
    pub fn new(baud: Option<u32>) -> Self {
        Self {
            byte_s: byte_s(baud),
            held: Vec::new(),
            flying: VecDeque::new(),
            free_s: 0.0,
            overrun_bytes: 0,
        }
    }

    /// The host has written `bytes`: the lines that are now complete, each of which has to be [`Self::launch`]ed.
    pub fn take_lines(&mut self, bytes: &[u8]) -> Vec<Vec<u8>> {
        let mut lines = Vec::new();
        let mut rest = bytes;
        while let Some(end) = rest.iter().position(|&b| b == b'\n') {
            let mut line = std::mem::take(&mut self.held);
            line.extend_from_slice(&rest[..=end]);
            rest = &rest[end + 1..];
            lines.push(line);
        }
        self.held.extend_from_slice(rest);
        if self.held.len() > LONGEST_HELD_LINE {
            lines.push(std::mem::take(&mut self.held));
        }
        lines
    }

    /// Sends a line on its way, `delay_s` late.
    pub fn launch(&mut self, now_s: f64, bytes: Vec<u8>, delay_s: f64) {
        let start_s = self.free_s.max(now_s + delay_s);
        self.free_s = (bytes.len() as f64).mul_add(self.byte_s, start_s);
        self.flying.push_back(InFlight { start_s, bytes, arrived: 0 });
    }

    /// Moves what has arrived into the ring; false if nothing did. Stops after an order that acts at once.
    pub fn deliver(&mut self, now_s: f64, into: &mut Receiver) -> (bool, Option<Emergency>) {
        let mut moved = false;
        while let Some(line) = self.flying.front_mut() {
            let (due, order) = if self.byte_s > 0.0 {
                line.arrive_by(now_s, self.byte_s, into, &mut self.overrun_bytes)
            } else {
                line.arrive_whole(now_s, into)
            };
            moved |= due > 0;
            let complete = line.arrived == line.bytes.len();
            if complete {
                self.flying.pop_front();
            }
            if order.is_some() || !complete {
                return (moved, order);
            }
        }
        (moved, None)
    }

    /// When the next line will have arrived, if one is under way.
    #[must_use]
    pub fn next_s(&self) -> Option<f64> {
        self.flying.front().map(|line| (line.bytes.len() as f64).mul_add(self.byte_s, line.start_s))
    }

    /// Bytes and lines under way are lost, and what the host had begun.
    pub fn clear(&mut self, now_s: f64) {
        self.held.clear();
        self.flying.clear();
        self.free_s = now_s;
    }

    /// The end of the host's writing: what it has begun goes on its way as it is.
    pub fn take_rest(&mut self) -> Option<Vec<u8>> {
        Some(std::mem::take(&mut self.held)).filter(|rest| !rest.is_empty())
    }

    /// Bytes that have not arrived yet.
    #[must_use]
    pub fn bytes_under_way(&self) -> usize {
        self.flying.iter().map(|line| line.bytes.len() - line.arrived).sum()
    }
}

impl InFlight {
    /// Bytes whose time has come; those that find the ring full are lost.
    fn arrive_by(
        &mut self,
        now_s: f64,
        byte_s: f64,
        into: &mut Receiver,
        overrun: &mut u64,
    ) -> (usize, Option<Emergency>) {
        // The thousandth of a byte allows for rounding of times that are sums of byte times.
        let due = whole::floor_to_usize((now_s - self.start_s) / byte_s + 1e-3);
        let before = self.arrived;
        while self.arrived < due.min(self.bytes.len()) {
            let byte = self.bytes[self.arrived];
            self.arrived += 1;
            if into.room() == 0 {
                *overrun += 1;
            } else if let Some(order) = into.push(byte) {
                return (self.arrived - before, Some(order));
            }
        }
        (self.arrived - before, None)
    }

    /// All of it, if the ring has room for all (a longer one waits for the empty ring).
    fn arrive_whole(&mut self, now_s: f64, into: &mut Receiver) -> (usize, Option<Emergency>) {
        let fits = self.bytes.len() <= into.room() || into.is_empty();
        if self.start_s > now_s || !fits {
            return (0, None);
        }
        self.arrived = self.bytes.len();
        let order = self.bytes.iter().fold(None, |order, &byte| into.push(byte).or(order));
        // An empty line (all of it was lost) has arrived too.
        (self.arrived.max(1), order)
    }
}

/// The way to the host.
#[derive(Debug, Clone)]
pub struct Outgoing {
    byte_s: f64,
    free_s: f64,
    pending: VecDeque<(f64, Vec<u8>)>,
    ready: Vec<u8>,
}

impl Outgoing {
    /// At `baud`, or at once.
    #[must_use]
    pub fn new(baud: Option<u32>) -> Self {
        Self { byte_s: byte_s(baud), free_s: 0.0, pending: VecDeque::new(), ready: Vec::new() }
    }

    /// The printer says `bytes`, `delay_s` late; what it says later waits for it.
    pub fn send(&mut self, now_s: f64, bytes: &[u8], delay_s: f64) {
        self.free_s = (bytes.len() as f64).mul_add(self.byte_s, self.free_s.max(now_s + delay_s));
        if self.free_s <= now_s && self.pending.is_empty() {
            self.ready.extend_from_slice(bytes);
        } else {
            self.pending.push_back((self.free_s, bytes.to_vec()));
        }
    }

    /// When the next line will have left.
    #[must_use]
    pub fn next_s(&self) -> Option<f64> {
        self.pending.front().map(|line| line.0)
    }

    /// Lets go what has left by `now_s`.
    pub fn advance(&mut self, now_s: f64) {
        while self.pending.front().is_some_and(|line| line.0 <= now_s) {
            self.ready.extend(self.pending.pop_front().into_iter().flat_map(|line| line.1));
        }
    }

    /// What has left and was not taken yet.
    pub const fn ready(&mut self) -> &mut Vec<u8> {
        &mut self.ready
    }

    /// What was said is lost.
    pub fn clear(&mut self, now_s: f64) {
        self.pending.clear();
        self.ready.clear();
        self.free_s = now_s;
    }
}

fn byte_s(baud: Option<u32>) -> f64 {
    baud.map_or(0.0, |baud| BITS_PER_BYTE / f64::from(baud.max(1)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dialect::MARLIN;

    fn receiver() -> Receiver {
        Receiver::new(128, 96, &MARLIN)
    }

    fn launch_all(wire: &mut Incoming, text: &[u8]) {
        for line in wire.take_lines(text) {
            wire.launch(0.0, line, 0.0);
        }
    }

    #[test]
    fn bytes_take_ten_bit_times() {
        let mut wire = Incoming::new(Some(115_200));
        launch_all(&mut wire, b"G28\nM105\n");
        assert!((wire.next_s().unwrap() - 40.0 / 115_200.0).abs() < 1e-15);
        let mut ring = receiver();
        wire.deliver(20.0 / 115_200.0, &mut ring);
        assert_eq!(ring.room(), 126);
        wire.deliver(90.0 / 115_200.0, &mut ring);
        assert_eq!(ring.room(), 119);
        assert_eq!(wire.next_s(), None);
    }

    #[test]
    fn full_ring_loses_bytes_of_a_uart_and_holds_back_usb() {
        let text = b"0123456789012345678\n".repeat(10);
        let mut uart = Incoming::new(Some(1_000_000));
        launch_all(&mut uart, &text);
        uart.deliver(1.0, &mut receiver());
        assert_eq!(uart.overrun_bytes, 72);
        let mut usb = Incoming::new(None);
        launch_all(&mut usb, &text);
        let mut ring = receiver();
        usb.deliver(0.0, &mut ring);
        assert_eq!((usb.overrun_bytes, ring.room(), usb.bytes_under_way()), (0, 8, 80));
    }

    #[test]
    fn cut_of_the_host_s_writes_does_not_matter() {
        let text = b"G1 X1\nG1 X2\nG1";
        let whole = Incoming::new(None).take_lines(text);
        let mut wire = Incoming::new(None);
        let pieces: Vec<Vec<u8>> = text.iter().flat_map(|&byte| wire.take_lines(&[byte])).collect();
        assert_eq!(whole, pieces);
        assert_eq!(whole.len(), 2);
    }

    #[test]
    fn damage_does_what_its_name_says() {
        let clean = b"N7 G1 X1*12\n".to_vec();
        let mut rng = Rng::new(5, 1);
        for _ in 0..200 {
            let mut after = |kind| {
                let mut line = clean.clone();
                damage(kind, &mut line, &mut rng);
                line
            };
            let flipped: u32 =
                after(Kind::BitError).iter().zip(&clean).map(|(a, b)| (a ^ b).count_ones()).sum();
            assert_eq!(flipped, 1);
            assert_eq!(after(Kind::LostByte).len(), clean.len() - 1);
            assert_eq!(after(Kind::DoubledByte).len(), clean.len() + 1);
            let half = after(Kind::HalfLine);
            assert!(clean.starts_with(&half) && half.len() < clean.len());
            assert!(after(Kind::Garbage).ends_with(&clean));
            assert_eq!(after(Kind::WrongResend), b"N7 G1 X1*13\n");
        }
    }

    #[test]
    fn replies_keep_their_order_when_one_is_late() {
        let mut out = Outgoing::new(None);
        out.send(0.0, b"ok\n", 2.0);
        out.send(1.0, b"wait\n", 0.0);
        out.advance(1.9);
        assert!(out.ready().is_empty());
        out.advance(2.0);
        assert_eq!(out.ready(), b"ok\nwait\n");
    }
}
