//! The loop between terminal, clock and record.
//!
//! The only part of the simulator that reads a clock. At a given speed, simulated time follows the clock. At the
//! fastest, time jumps from event to event while a command or the wire waits, follows the clock while the host is to
//! notice it (an outage, a late line, a wait for the user), and stands still otherwise; moves that nobody waits for are
//! finished when the host has been quiet for half a second, or leaves. What a host has written before it leaves still
//! arrives and is done, as behind a real port.

use crate::{
    Error,
    event::Summary,
    printer::{Options, Pace, Printer},
    pty::{Pty, Read, Ready, pause},
    record::Recorder,
    scenario::Speed,
};
use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

/// While nobody has the port open, it is looked at this often.
const ABSENT: Duration = Duration::from_millis(10);
/// Longest wait for anything.
const LONGEST_WAIT: Duration = Duration::from_millis(100);
/// After this long without a byte from the host, moves that nobody waits for are finished.
const QUIET: Duration = Duration::from_millis(500);
/// The record is handed to the operating system this often.
const FLUSH: Duration = Duration::from_millis(500);
/// Events dealt with before the terminal is looked at again.
const EVENTS_AT_ONCE: usize = 256;
/// A pseudo-terminal gives at most a little more than this at a time, bytes.
const PIECE: usize = 4000;
/// A host that leaves this much unread is not served until it reads, bytes.
const UNREAD: usize = 1 << 16;

/// What to run.
#[derive(Debug)]
pub struct Config {
    /// The printer.
    pub options: Options,
    /// Where the link goes.
    pub link: PathBuf,
    /// Where the record goes.
    pub record: Option<PathBuf>,
    /// How fast time passes.
    pub speed: Speed,
    /// Whether to end when the user leaves.
    pub once: bool,
}

/// Runs until told to stop, or with `once` until the user has left. `ready` is told the terminal's device each time
/// there is one.
///
/// # Errors
/// [`Error::LinkTaken`], or [`Error::Io`] from terminal and record. The record then ends without a summary.
pub fn run(config: Config, stop: &Arc<AtomicBool>, ready: impl FnMut(&Pty)) -> Result<Summary, Error> {
    let recorder = config.record.as_deref().map(Recorder::create).transpose()?;
    let mut session = Session {
        printer: Printer::new(config.options),
        recorder,
        pty: None,
        present: false,
        left: false,
        last_input: wall(),
        last_flush: wall(),
        buffer: vec![0; 1 << 16],
        speed: config.speed,
        link: config.link,
    };
    session.serve(config.once, stop, ready)?;
    session.end()
}

#[expect(clippy::disallowed_methods, reason = "the driver is where simulated time meets the clock")]
fn wall() -> Instant {
    Instant::now()
}

struct Session {
    printer: Printer,
    recorder: Option<Recorder>,
    pty: Option<Pty>,
    /// A host has the port open.
    present: bool,
    /// A host had the port open and closed it.
    left: bool,
    last_input: Instant,
    last_flush: Instant,
    buffer: Vec<u8>,
    speed: Speed,
    link: PathBuf,
}

impl Session {
    fn serve(&mut self, once: bool, stop: &AtomicBool, mut ready: impl FnMut(&Pty)) -> Result<(), Error> {
        let parent = rustix::process::getppid();
        let mut last = wall();
        while !(stop.load(Ordering::Relaxed) || once && self.is_over()) {
            self.plug(&mut ready)?;
            let seen = self.wait().map_err(|error| Error::io("wait for", &self.link, error))?;
            // What has come while waiting came now, not when the waiting began.
            let now = wall();
            self.pass_time(now.duration_since(last));
            last = now;
            self.exchange(seen).map_err(|error| Error::io("read", &self.link, error))?;
            if self.speed == Speed::Max {
                self.jump();
            }
            self.flush_output().map_err(|error| Error::io("write", &self.link, error))?;
            self.write_record(now)?;
            // A simulator that serves one program has nothing to wait for when that is gone.
            if once && rustix::process::getppid() != parent {
                break;
            }
        }
        Ok(())
    }

    /// Whether the user has left, other than because the cable is out for a while, or can never come back.
    fn is_over(&self) -> bool {
        self.left && self.printer.is_plugged() || self.printer.is_gone()
    }

    /// Port and link come and go with the printer's cable.
    fn plug(&mut self, ready: &mut impl FnMut(&Pty)) -> Result<(), Error> {
        if !self.printer.is_plugged() {
            self.pty = None;
            self.present = false;
        } else if self.pty.is_none() {
            let pty = Pty::open(&self.link)?;
            ready(&pty);
            self.pty = Some(pty);
        }
        Ok(())
    }

    /// Waits for bytes, room to write, or time to pass.
    fn wait(&mut self) -> std::io::Result<Ready> {
        let timeout = self.timeout();
        let unsent = !self.printer.output().is_empty();
        let nobody = Ready { readable: false, hung_up: true };
        let Some(pty) = &self.pty else { return pause(timeout).map(|()| nobody) };
        let seen = pty.wait(unsent && self.present, if self.present { timeout } else { Duration::ZERO })?;
        if seen.hung_up && !seen.readable && !self.present {
            pause(timeout)?;
        }
        Ok(seen)
    }

    /// Notices hosts that come and go, and reads.
    fn exchange(&mut self, seen: Ready) -> std::io::Result<()> {
        if self.pty.is_none() {
            return Ok(());
        }
        if !self.present {
            if seen.hung_up && !seen.readable {
                self.printer.output().clear();
                return Ok(());
            }
            // The host may still be setting up its side.
            pause(ABSENT)?;
            self.present = true;
            self.left = false;
            self.printer.host_arrived();
        }
        let room = self.printer.output().len() < UNREAD && !self.printer.is_holding_back();
        if seen.hung_up || seen.readable && room { self.read(seen.hung_up) } else { Ok(()) }
    }

    /// Reads what is there; to the end if the host has left.
    fn read(&mut self, to_the_end: bool) -> std::io::Result<()> {
        let mut n = 0;
        let mut gone = false;
        while let (Some(pty), false, true) = (&self.pty, gone, n < self.buffer.len()) {
            match pty.read(&mut self.buffer[n..])? {
                Read::Bytes(more) => {
                    n += more;
                    // A piece that is not full was all there was; asking again would only cost time.
                    if more < PIECE && !to_the_end {
                        break;
                    }
                }
                Read::Nothing => break,
                Read::HungUp => gone = true,
            }
        }
        if n > 0 {
            self.last_input = wall();
            self.printer.receive(&self.buffer[..n]);
        }
        if gone {
            self.host_left();
        }
        Ok(())
    }

    fn host_left(&mut self) {
        self.printer.host_left();
        // What it has written is still done; what takes the user is not waited for.
        if self.speed == Speed::Max {
            while self.printer.pace() == Pace::Work && self.printer.step() {}
        }
        self.flush_moves();
        self.present = false;
        self.left = true;
    }

    fn flush_output(&mut self) -> std::io::Result<()> {
        let output = self.printer.output();
        if let (Some(pty), false) = (&self.pty, output.is_empty()) {
            let written = pty.write(output)?;
            output.drain(..written);
        }
        Ok(())
    }

    fn timeout(&self) -> Duration {
        let wait = match self.speed {
            _ if self.pty.is_none() || !self.present => ABSENT,
            Speed::Max if self.printer.pace() == Pace::Work => Duration::ZERO,
            Speed::Max if self.printer.pace() == Pace::RealTime => self.until_next_event(1.0),
            Speed::Max => LONGEST_WAIT,
            Speed::Times(factor) => self.until_next_event(factor),
        };
        wait.min(LONGEST_WAIT)
    }

    fn until_next_event(&self, factor: f64) -> Duration {
        let wait_s = self.printer.next_event_s().map_or(1.0, |t| (t - self.printer.now_s()) / factor);
        Duration::from_secs_f64(wait_s.clamp(0.000_05, 1.0))
    }

    /// Lets simulated time follow the clock, where it does.
    fn pass_time(&mut self, elapsed: Duration) {
        let factor = match self.speed {
            Speed::Times(factor) => factor,
            Speed::Max if self.printer.pace() == Pace::RealTime => 1.0,
            Speed::Max => return,
        };
        self.printer.advance_to(elapsed.as_secs_f64().mul_add(factor, self.printer.now_s()));
    }

    /// Lets simulated time jump from event to event while something waits.
    fn jump(&mut self) {
        for _ in 0..EVENTS_AT_ONCE {
            if self.printer.pace() != Pace::Work
                || self.printer.output().len() > UNREAD
                || !self.printer.step()
            {
                break;
            }
        }
        let quiet = self.last_input.elapsed() > QUIET;
        if quiet && self.printer.pace() == Pace::Idle && self.printer.has_moves() {
            self.flush_moves();
        }
    }

    /// Finishes moves that nobody waits for.
    fn flush_moves(&mut self) {
        while self.printer.has_moves() && self.printer.step() {}
    }

    fn write_record(&mut self, now: Instant) -> Result<(), Error> {
        match &mut self.recorder {
            Some(recorder) => {
                for event in self.printer.take_events() {
                    recorder.write(&event)?;
                }
                if now.duration_since(self.last_flush) > FLUSH {
                    recorder.flush()?;
                    self.last_flush = now;
                }
            }
            None => drop(self.printer.take_events()),
        }
        Ok(())
    }

    fn end(mut self) -> Result<Summary, Error> {
        self.flush_moves();
        self.write_record(wall())?;
        let summary = self.printer.summary();
        if let Some(recorder) = self.recorder {
            recorder.finish(&summary)?;
        }
        Ok(summary)
    }
}
