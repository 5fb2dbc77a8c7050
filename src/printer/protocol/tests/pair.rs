//! Core and firmware on one made-up clock.

use super::super::*;
use super::firmware::{Firmware, Setup};

pub(super) struct Pair {
    pub(super) core: Core,
    pub(super) firmware: Firmware,
    pub(super) now: Instant,
    pub(super) events: Vec<Event>,
    job: std::vec::IntoIter<String>,
    is_given: bool,
}

pub(super) fn profile_for(setup: &Setup) -> Profile {
    let mut profile = crate::profile::builtin("marlin").unwrap();
    profile.firmware.rx_buffer_bytes = setup.rx_bytes;
    profile.firmware.command_slots = setup.slots;
    profile.firmware.temperature_report_s = 0.0;
    profile.firmware.orphan_hold_s = 0.0;
    profile
}

impl Pair {
    pub(super) fn new(setup: Setup, job: Vec<String>) -> Self {
        let mut core = Core::new(&profile_for(&setup));
        core.handle_command(Instant::default(), Command::Connect).unwrap();
        Self {
            core,
            firmware: Firmware::new(setup),
            now: Instant::default(),
            events: Vec::new(),
            job: job.into_iter(),
            is_given: false,
        }
    }

    fn feed(&mut self) {
        if *self.core.state() == State::Idle && !self.is_given {
            self.core.handle_command(self.now, Command::Begin).unwrap();
        }
        while self.core.wants_line() && !self.is_given {
            match self.job.next() {
                Some(line) => self.core.handle_command(self.now, Command::Line(&line)).unwrap(),
                None => {
                    self.is_given = true;
                    self.core.handle_command(self.now, Command::EndOfJob).unwrap();
                }
            }
        }
    }

    fn drain(&mut self) {
        while let Some(line) = self.core.poll_transmit() {
            self.firmware.receive(line.bytes);
        }
        while let Some(event) = self.core.poll_event() {
            self.events.push(event);
        }
    }

    pub(super) fn is_over(&self) -> bool {
        self.end().is_some()
    }

    /// How the job ended.
    pub(super) fn end(&self) -> Option<&Event> {
        self.events.iter().find(|e| matches!(e, Event::Finished | Event::Cancelled | Event::Faulted(_)))
    }

    /// Everything that happens at this moment, then on to the next one. False when nothing will ever happen.
    pub(super) fn step(&mut self) -> bool {
        loop {
            self.feed();
            self.drain();
            self.firmware.run(self.now);
            let Some(line) = self.firmware.said.pop_front() else { break };
            self.core.handle_line(self.now, &line);
        }
        let next = [self.core.poll_timeout(), self.firmware.next_event()].into_iter().flatten().min();
        let Some(next) = next else { return false };
        self.now = self.now.max(next);
        if self.core.poll_timeout().is_some_and(|due| due <= self.now) {
            self.core.handle_timeout(self.now);
        }
        true
    }

    /// Runs until the job is over, one way or the other.
    pub(super) fn run(&mut self) {
        for _ in 0..5_000_000 {
            if self.is_over() || !self.step() {
                return;
            }
        }
        panic!("hangs at {:?} in {:?}", self.now, self.core);
    }

    pub(super) fn moves(&self) -> Vec<&str> {
        self.firmware.executed.iter().map(String::as_str).filter(|c| c.starts_with("G1")).collect()
    }
}

pub(super) fn job(n: usize) -> Vec<String> {
    (0..n).map(|i| format!("G1 X{}.{:03} Y{} E0.{:05}", i % 200, i % 1000, i % 150, i)).collect()
}
