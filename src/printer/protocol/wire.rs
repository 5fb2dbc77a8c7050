//! The lines of a session: numbered, kept until they are certainly not asked for again, and sent no faster
//! than the firmware can take them.
//!
//! A line that the firmware has not read lies in its serial receive buffer, and what does not fit there is
//! lost. So the bytes that may lie there never exceed its size. With plain `ok` a line counts as read when it is
//! acknowledged; ADVANCED_OK also tells how many lines the command queue holds, and those have left the buffer
//! too. Room for one probe is always kept.
//!
//! Where ADVANCED_OK says that the planner has room for the moves in flight, so that the firmware waits at none of them, a
//! little more may be under way: see [`Allowance`]. A damaged line takes that back for good.
//!
//! Where lines are acknowledged faster than any serial wire carries them, the link is not one (a pseudo-terminal, USB): it holds
//! the writer back by itself, and more may be in flight. A damaged line takes that back for good.

use super::allowance::Allowance;
use super::slow::{dwell, is_move, is_slow, waits_for_heat, waits_for_user};
use super::time::Instant;
use crate::profile::Firmware;
use std::collections::VecDeque;
use std::fmt::{Display, Write as _};
use std::time::Duration;

/// Lines kept after their acknowledgement: an `ok` may have been taken for the wrong line, by a few.
const HISTORY: u64 = 256;

/// Numbers of probes lie this far ahead, so that no firmware can take them for the next line.
const PROBE_AHEAD: u64 = 1000;

/// Bytes of a probe with a seven-digit number, and of the line feed before it.
const PROBE_BYTES: usize = 20;

/// Behind a half line: without a checksum it would be obeyed, with a wrong one it is refused. A whole line that lacks its line feed has
/// its own checksum, and what follows that is not looked at (RepRapFirmware). Standing alone it is refused by this number.
pub(super) const VOID: &str = "N4000000000 *999\n";

/// See [`VOID`].
pub(super) const VOID_NUMBER: u64 = 4_000_000_000;

/// Bytes in flight on a link that holds the writer back by itself.
const FLOW_CONTROLLED_BYTES: u64 = 4096;

/// Bytes acknowledged over which the speed of the link is measured.
const MEASURED_BYTES: u64 = 1 << 16;

/// Faster than twice the fastest rate of common boards, bytes/s: no serial wire.
const NO_WIRE_BYTES_S: f64 = 200_000.0;

/// Why a line is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Origin {
    Job,
    Host,
}

#[derive(Debug)]
struct Line {
    /// As on the wire, with line feed.
    text: String,
    /// Bytes of all lines up to and with this one.
    end: u64,
    origin: Origin,
    is_slow: bool,
    /// A straight move: it takes one place of the planner, and no time where there is one.
    is_move: bool,
    waits_for_user: bool,
    waits_for_heat: bool,
}

/// See the module. Numbers count from 1, after `M110 N0`.
#[derive(Debug)]
pub(super) struct Wire {
    numbered: bool,
    /// Whether a line goes only when the one before is acknowledged: a damaged one would else be done behind the next ones.
    one_by_one: bool,
    rx_bytes: u64,
    /// What the profile says of it.
    profile_rx_bytes: u64,
    /// Where and when the speed of the link began to be measured; nothing once it is known.
    measured: Option<(u64, Instant)>,
    command_slots: u64,
    allowance: Allowance,
    /// Last line at which the firmware does not wait: the planner has room for all moves up to it.
    flowing: u64,
    /// The last line sent that waits for a temperature (M109, M190): none goes behind it before it is acknowledged.
    heating: u64,
    lines: VecDeque<Line>,
    /// Number of the first of `lines`.
    base: u64,
    /// `end` of the line before `base`.
    base_end: u64,
    /// Last line acknowledged.
    acked: u64,
    /// Last line that has certainly left the receive buffer.
    read: u64,
    /// The line to be sent next.
    next: u64,
    /// The highest line that was ever sent.
    highest: u64,
    /// Job lines up to `base - 1` and up to `acked`.
    base_job_lines: u64,
    acked_job_lines: u64,
    spare: Vec<String>,
    /// Nothing more will be appended.
    is_whole: bool,
}

impl Wire {
    pub(super) fn new(firmware: &Firmware) -> Self {
        Self {
            numbered: firmware.line_numbers,
            one_by_one: firmware.line_numbers && !firmware.counts_lines(),
            rx_bytes: (firmware.rx_buffer_bytes.saturating_sub(PROBE_BYTES)) as u64,
            profile_rx_bytes: (firmware.rx_buffer_bytes.saturating_sub(PROBE_BYTES)) as u64,
            measured: Some((0, Instant::default())),
            command_slots: firmware.command_slots as u64,
            allowance: Allowance::new(firmware),
            flowing: 0,
            heating: 0,
            lines: VecDeque::new(),
            base: 1,
            base_end: 0,
            acked: 0,
            read: 0,
            next: 1,
            highest: 0,
            base_job_lines: 0,
            acked_job_lines: 0,
            spare: Vec::new(),
            is_whole: false,
        }
    }

    /// Nothing more will be appended.
    pub(super) fn end(&mut self) {
        self.is_whole = true;
    }

    /// More will be appended after all.
    pub(super) fn reopen(&mut self) {
        self.is_whole = false;
    }

    /// Whether lines that were sent once are to be sent again.
    pub(super) fn owes_lines(&self) -> bool {
        self.next <= self.highest
    }

    pub(super) fn is_whole(&self) -> bool {
        self.is_whole
    }

    /// The firmware's last line is `number`: the next one appended is the one after it.
    pub(super) fn begin_after(&mut self, number: u64) {
        self.lines.clear();
        (self.base, self.next) = (number + 1, number + 1);
        (self.acked, self.read, self.highest) = (number, number, number);
        (self.base_end, self.base_job_lines, self.acked_job_lines, self.heating) = (0, 0, 0, 0);
    }

    /// Appends a command.
    pub(super) fn push(&mut self, command: &str, origin: Origin) {
        let mut text = self.spare.pop().unwrap_or_default();
        text.clear();
        if self.one_by_one {
            // Such firmware takes a line that has lost its asterisk: its checksum must not become digits of the last number.
            write_numbered(&mut text, self.queued() + 1, format_args!("{command} "));
        } else if self.numbered {
            write_numbered(&mut text, self.queued() + 1, command);
        } else {
            text.push_str(command);
            text.push('\n');
        }
        let end = self.end_of(self.queued()) + text.len() as u64;
        let (is_slow, is_move) = (is_slow(command), is_move(command));
        let (waits_for_user, waits_for_heat) = (waits_for_user(command), waits_for_heat(command));
        self.lines.push_back(Line { text, end, origin, is_slow, is_move, waits_for_user, waits_for_heat });
    }

    /// The last line appended.
    pub(super) fn queued(&self) -> u64 {
        self.base + self.lines.len() as u64 - 1
    }

    /// The next line to be sent.
    pub(super) fn next(&self) -> u64 {
        self.next
    }

    /// The last line acknowledged.
    pub(super) fn acked(&self) -> u64 {
        self.acked
    }

    /// Lines sent and not acknowledged.
    pub(super) fn in_flight(&self) -> u64 {
        self.next - 1 - self.acked
    }

    /// Lines appended and not sent.
    pub(super) fn unsent(&self) -> u64 {
        self.queued() + 1 - self.next
    }

    /// The highest line that was ever sent.
    pub(super) fn highest(&self) -> u64 {
        self.highest
    }

    pub(super) fn acked_job_lines(&self) -> u64 {
        self.acked_job_lines
    }

    /// The oldest line that can still be sent again.
    pub(super) fn oldest(&self) -> u64 {
        self.base
    }

    /// The next line, if there is one and the firmware has room for it; it counts as sent.
    pub(super) fn send_next(&mut self) -> Option<&str> {
        let number = self.next;
        if self.one_by_one && self.in_flight() > 0 {
            return None;
        }
        // So a stop is heard while it heats, and what stands behind is not begun.
        if number > self.heating && self.acked < self.heating {
            return None;
        }
        let line = self.lines.get(self.index(number)?)?;
        let read = self.read.max(self.acked).min(number - 1);
        let unread_bytes = line.end - self.end_of(read);
        let is_alone = read == number - 1;
        let extra_bytes = if number <= self.flowing { self.allowance.bytes() } else { 0 };
        if !is_alone && unread_bytes > self.rx_bytes + extra_bytes {
            return None;
        }
        if line.waits_for_heat {
            self.heating = number;
        }
        self.next += 1;
        self.highest = self.highest.max(number);
        Some(&self.lines[self.index(number)?].text)
    }

    /// Whether the next line to be sent waits for somebody.
    pub(super) fn next_waits_for_user(&self) -> bool {
        self.index(self.next).is_some_and(|i| self.lines[i].waits_for_user)
    }

    /// The line that was sent last.
    pub(super) fn last_sent(&self) -> Option<&str> {
        self.index(self.next - 1).map(|i| self.lines[i].text.as_str())
    }

    /// An `ok` for the oldest line in flight. False if there is none.
    pub(super) fn ack_oldest(&mut self) -> bool {
        if self.in_flight() == 0 {
            return false;
        }
        self.ack_to(self.acked + 1);
        true
    }

    /// An `ok` for line `number`, and how many slots of the command queue are free. False if it is not in flight.
    pub(super) fn ack_through(&mut self, number: u64, slots_free: Option<u32>) -> bool {
        if number <= self.acked || number >= self.next {
            return false;
        }
        self.ack_to(number);
        if let Some(free) = slots_free {
            // The queue still holds the line that is acknowledged; the others in it come after.
            let waiting = self.command_slots.saturating_sub(u64::from(free)).saturating_sub(1);
            self.read = self.read.max((number + waiting).min(self.next - 1));
        }
        true
    }

    /// With the answer to the last line acknowledged the planner had room for so many moves.
    pub(super) fn planner_has_room(&mut self, now: Instant, n_moves: u32) {
        let number = self.acked;
        let ahead = number + 1..=number + u64::from(n_moves);
        let is_move = |n: &u64| self.index(*n).is_some_and(|i| self.lines[i].is_move);
        self.flowing = number + ahead.take_while(is_move).count() as u64;
        let flows = self.flowing > number;
        self.allowance.acknowledged(now, self.end_of(number), flows);
    }

    fn ack_to(&mut self, number: u64) {
        for n in self.acked + 1..=number {
            let is_job = self.index(n).is_some_and(|i| self.lines[i].origin == Origin::Job);
            self.acked_job_lines += u64::from(is_job);
        }
        self.acked = number;
        while self.base + HISTORY <= self.acked {
            let Some(line) = self.lines.pop_front() else { break };
            self.base += 1;
            self.base_end = line.end;
            self.base_job_lines += u64::from(line.origin == Origin::Job);
            self.spare.push(line.text);
        }
    }

    /// The firmware has accepted everything before `number` and nothing else: goes on there.
    pub(super) fn rewind(&mut self, number: u64) {
        self.next = number;
        self.read = number - 1;
        if self.acked > number - 1 {
            self.acked = number - 1;
            let n_before = self.index(number).unwrap_or(self.lines.len());
            let jobs = self.lines.iter().take(n_before).filter(|line| line.origin == Origin::Job);
            self.acked_job_lines = self.base_job_lines + jobs.count() as u64;
        }
    }

    /// The firmware has accepted everything before `number`, which was sent before the core went back too far.
    pub(super) fn skip_to(&mut self, number: u64) {
        self.next = self.next.max(number.min(self.highest + 1));
    }

    /// Lines were acknowledged: looks, now and then, how fast the link is.
    pub(super) fn measure(&mut self, now: Instant) {
        let Some((from, since)) = self.measured else { return };
        let to = self.end_of(self.acked);
        let Some(n_bytes) = to.checked_sub(from).filter(|n| *n >= MEASURED_BYTES) else { return };
        self.measured = Some((to, now));
        if now.since(since).as_secs_f64() * NO_WIRE_BYTES_S < n_bytes as f64 {
            self.rx_bytes = self.rx_bytes.max(FLOW_CONTROLLED_BYTES);
            self.measured = None;
        }
    }

    /// A line was damaged, perhaps because there was no room for it: no more in flight than the profile allows.
    pub(super) fn narrow(&mut self) {
        self.allowance.withdraw();
        if self.rx_bytes > self.profile_rx_bytes {
            self.rx_bytes = self.profile_rx_bytes;
            self.measured = None;
        }
    }

    /// The firmware has read every line sent.
    pub(super) fn all_read(&mut self) {
        self.read = self.next - 1;
    }

    /// The firmware has executed every line sent.
    pub(super) fn all_acked(&mut self) {
        if self.in_flight() > 0 {
            self.ack_to(self.next - 1);
        }
    }

    /// The wait is given up: what switches the heaters off shall stand behind it in the firmware, whatever becomes of the host.
    pub(super) fn let_lines_behind_heating(&mut self) {
        self.heating = 0;
    }

    /// Drops the lines that were never sent. Those that were, even if they are to be sent again, keep their numbers
    /// and texts: the firmware may have some of them already.
    pub(super) fn drop_unsent(&mut self) {
        let keep = self.index(self.highest + 1).unwrap_or(self.lines.len());
        self.lines.truncate(keep);
    }

    /// The command of the oldest line in flight.
    pub(super) fn oldest_command(&self) -> Option<&str> {
        (self.in_flight() > 0).then(|| self.command(self.acked + 1)).flatten()
    }

    /// Whether the oldest line in flight may take minutes.
    pub(super) fn oldest_is_slow(&self) -> bool {
        self.in_flight() > 0 && self.index(self.acked + 1).is_some_and(|i| self.lines[i].is_slow)
    }

    /// How long the oldest line in flight takes by its own word.
    pub(super) fn oldest_dwell(&self) -> Duration {
        self.oldest_command().map_or(Duration::ZERO, dwell)
    }

    /// How many of the last `n_lines` acknowledged may take minutes, and how long all of them take by their own word.
    pub(super) fn slow_before_question(&self, n_lines: u64) -> (u32, Duration) {
        let numbers = self.acked.saturating_sub(n_lines) + 1..=self.acked;
        let slow = numbers.filter(|&n| self.index(n).is_some_and(|i| self.lines[i].is_slow));
        slow.fold((0, Duration::ZERO), |(n_slow, sum), number| {
            (n_slow + 1, sum + self.command(number).map_or(Duration::ZERO, dwell))
        })
    }

    /// Whether the oldest line in flight ends when something is warm.
    pub(super) fn oldest_waits_for_heat(&self) -> bool {
        self.oldest_command().is_some_and(waits_for_heat)
    }

    /// Whether the oldest waits for a temperature or for somebody, so that M108 ends it.
    pub(super) fn oldest_waits(&self) -> bool {
        self.oldest_command().is_some_and(|c| waits_for_heat(c) || waits_for_user(c))
    }

    /// Whose command in flight `text` is, as the firmware may repeat it.
    pub(super) fn origin_in_flight(&self, text: &str) -> Option<Origin> {
        let number = (self.acked + 1..self.next).find(|&n| {
            let whole = self.index(n).map(|i| self.lines[i].text.trim_end());
            let command = self.command(n);
            // Klipper repeats the first word alone.
            let word = command.and_then(|c| c.split_ascii_whitespace().next()).filter(|_| !self.numbered);
            command == Some(text) || whole == Some(text) || word == Some(text)
        })?;
        Some(self.lines[self.index(number)?].origin)
    }

    /// Whether `text`, which a firmware did not understand, is the only line in flight with noise before it, or but for a byte or two,
    /// where lines go one by one. It may have left the checksum out.
    pub(super) fn is_damaged_copy(&self, text: &str) -> bool {
        let number = self.acked + 1;
        if !self.one_by_one || self.in_flight() != 1 {
            return false;
        }
        let (Some(i), Some(command)) = (self.index(number), self.command(number)) else { return false };
        let whole = self.lines[i].text.trim_end();
        let body = whole.rsplit_once('*').map_or(whole, |(body, _)| body);
        text.contains(command) || is_like(text, whole) || is_like(text, body)
    }

    fn command(&self, number: u64) -> Option<&str> {
        let text = self.lines.get(self.index(number)?)?.text.trim_end();
        if !self.numbered {
            return Some(text);
        }
        let (command, _) = text.rsplit_once('*')?;
        command.split_once(' ').map(|(_, command)| command.trim_end())
    }

    /// A numbered line that the firmware cannot accept: its refusal tells the last one that it did.
    pub(super) fn write_probe(&self, out: &mut String) {
        if self.numbered {
            self.write_far(out, "M105");
        } else {
            out.push_str("M105\n");
        }
    }

    /// A command with a number that is none of our lines'.
    pub(super) fn write_far(&self, out: &mut String, command: &str) {
        write_numbered(out, self.far(), command);
    }

    /// The number of a probe.
    pub(super) fn far(&self) -> u64 {
        self.next.max(self.highest) + PROBE_AHEAD
    }

    fn index(&self, number: u64) -> Option<usize> {
        usize::try_from(number.checked_sub(self.base)?).ok().filter(|&i| i < self.lines.len())
    }

    fn end_of(&self, number: u64) -> u64 {
        self.index(number).map_or(self.base_end, |i| self.lines[i].end)
    }
}

/// Whether two texts are the same but for two bytes in one place.
fn is_like(a: &str, b: &str) -> bool {
    let n_front = a.bytes().zip(b.bytes()).take_while(|(a, b)| a == b).count();
    let n_back = a.bytes().rev().zip(b.bytes().rev()).take_while(|(a, b)| a == b).count();
    n_front + n_back + 2 >= a.len().max(b.len())
}

/// Appends `N12 G1 X5*33` and a line feed: the checksum is the exclusive or of all bytes before the asterisk.
pub(super) fn write_numbered(out: &mut String, number: u64, command: impl Display) {
    let start = out.len();
    write!(out, "N{number} {command}").expect("writing to a string cannot fail");
    let checksum = out.as_bytes()[start..].iter().fold(0, |sum, byte| sum ^ byte);
    writeln!(out, "*{checksum}").expect("writing to a string cannot fail");
}

#[cfg(test)]
mod tests;
