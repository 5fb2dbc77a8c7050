//! Bytes that may be on the way to the firmware besides those that its receive buffer holds.
//!
//! With 128 bytes of buffer and a millisecond until an answer, 1,000,000 baud carry less than half of what they could: the
//! wire stands still while an answer is on its way. Where the firmware waits at no line it reads as fast as lines come, so a little more
//! may be sent ahead. Whether it does is not known beforehand, a late answer looks like a slow firmware; so it is tried: a line
//! more each time the wire is not full, for good where that carries more, and taken back where it does not.
//!
//! Limits: a try may overrun the buffer of a firmware that is slow after all. Its sums then find the damage, with the eight bits that
//! they have, and nothing is tried again. At 115,200 baud, where the buffer alone keeps the wire full, nothing is tried at all.

use super::time::Instant;
use crate::profile::Firmware;

/// How long an answer takes at most before a wire is used in full, s.
const ANSWER_S: f64 = 0.002;
/// Start bit, eight data bits, stop bit.
const BITS_PER_BYTE: f64 = 10.0;
/// Bytes over which a rate is measured.
const SAMPLE_BYTES: u64 = 1 << 14;
/// What is tried at once: a line.
const STEP_BYTES: u64 = 48;
/// A wire is full from this part of its rate on.
const FULL: f64 = 0.98;
/// A try has to bring so much.
const LEAST_GAIN: f64 = 1.05;

/// See the module.
#[derive(Debug)]
pub(super) struct Allowance {
    bytes: u64,
    most: u64,
    wire_bytes_s: f64,
    /// The rate before the last try, bytes/s.
    before: Option<f64>,
    /// Where and when the present measurement began.
    from: Option<(u64, Instant)>,
    is_settled: bool,
}

impl Allowance {
    pub(super) fn new(firmware: &Firmware) -> Self {
        let wire_bytes_s = f64::from(firmware.baud) / BITS_PER_BYTE;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few kilobytes")]
        let in_an_answer = (wire_bytes_s * ANSWER_S) as u64;
        let most = in_an_answer.min(firmware.rx_buffer_bytes as u64);
        Self { bytes: 0, most, wire_bytes_s, before: None, from: None, is_settled: most < STEP_BYTES }
    }

    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// A line was damaged, perhaps because there was no room for it.
    pub(super) fn withdraw(&mut self) {
        self.bytes = 0;
        self.is_settled = true;
    }

    /// So many bytes are acknowledged in all; `flows` says whether the firmware waits at no line meanwhile.
    pub(super) fn acknowledged(&mut self, now: Instant, n_bytes: u64, flows: bool) {
        if self.is_settled {
            return;
        }
        if !flows {
            // What comes behind a wait is another part of the job, and another rate: a try that was not weighed is taken back.
            self.from = None;
            if self.before.take().is_some() {
                self.bytes = self.bytes.saturating_sub(STEP_BYTES);
            }
            return;
        }
        let (first, since) = *self.from.get_or_insert((n_bytes, now));
        let n_measured = n_bytes.saturating_sub(first);
        if n_measured >= SAMPLE_BYTES {
            self.from = Some((n_bytes, now));
            self.measured(n_measured as f64 / now.since(since).as_secs_f64());
        }
    }

    fn measured(&mut self, bytes_s: f64) {
        let is_full = bytes_s >= FULL * self.wire_bytes_s;
        match self.before {
            _ if is_full => self.before = None,
            Some(before) if bytes_s < LEAST_GAIN * before => {
                self.bytes = self.bytes.saturating_sub(STEP_BYTES);
                self.is_settled = true;
            }
            _ => {
                self.is_settled = self.bytes + STEP_BYTES > self.most;
                if !self.is_settled {
                    self.before = Some(bytes_s);
                    self.bytes += STEP_BYTES;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    /// What is allowed after a megabyte at the rate that an allowance brings.
    fn after(baud: u32, bytes_s: impl Fn(u64) -> f64) -> u64 {
        let mut firmware = crate::profile::builtin("marlin").unwrap().firmware;
        firmware.baud = baud;
        let mut allowance = Allowance::new(&firmware);
        let (mut now, mut n_bytes) = (Instant::default(), 0);
        while n_bytes < 1_000_000 {
            n_bytes += 43;
            now = now + Duration::from_secs_f64(43.0 / bytes_s(allowance.bytes()));
            allowance.acknowledged(now, n_bytes, true);
        }
        allowance.bytes()
    }

    #[test]
    fn a_late_answer_is_made_up_for() {
        let late = |allowed| f64::min(100_000.0, (108 + allowed) as f64 / 0.0016);
        assert_eq!(after(1_000_000, late), 96);
    }

    #[test]
    fn a_slow_firmware_is_given_no_more() {
        assert_eq!(after(1_000_000, |_| 40_000.0), 0);
    }

    #[test]
    fn a_try_that_a_wait_interrupts_is_taken_back() {
        let mut firmware = crate::profile::builtin("marlin").unwrap().firmware;
        firmware.baud = 1_000_000;
        let mut allowance = Allowance::new(&firmware);
        let mut now = Instant::default();
        for n_bytes in [0, SAMPLE_BYTES] {
            now = now + Duration::from_secs(1);
            allowance.acknowledged(now, n_bytes, true);
        }
        assert_eq!(allowance.bytes(), STEP_BYTES);
        allowance.acknowledged(now, SAMPLE_BYTES + 43, false);
        assert_eq!(allowance.bytes(), 0);
    }

    #[test]
    fn a_full_wire_needs_none() {
        assert_eq!(after(115_200, |_| 11_520.0), 0);
        assert_eq!(after(250_000, |_| 25_000.0), 0);
    }
}
