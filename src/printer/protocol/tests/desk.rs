//! A core at a desk, and somebody who plays the firmware.

use super::super::*;
use super::firmware::Setup;
use super::pair::profile_for;
use std::time::Duration;

pub(super) struct Desk {
    pub(super) core: Core,
    pub(super) now: Instant,
}

/// What the core wrote since it was asked last, without line feeds and checksums.
pub(super) fn written(core: &mut Core) -> Vec<String> {
    let mut out = Vec::new();
    while let Some(line) = core.poll_transmit() {
        let text = std::str::from_utf8(line.bytes).unwrap();
        assert!(text.ends_with('\n'), "{text:?}");
        out.extend(text.lines().filter(|l| !l.is_empty()).map(without_checksum));
    }
    out
}

fn without_checksum(line: &str) -> String {
    let Some((body, sum)) = line.rsplit_once('*') else {
        assert!(!line.starts_with('N'), "{line}");
        return line.to_owned();
    };
    assert_eq!(sum.parse(), Ok(body.bytes().fold(0, |a: u8, b| a ^ b)), "{line}");
    body.to_owned()
}

impl Desk {
    pub(super) fn disconnected() -> Self {
        Self { core: Core::new(&profile_for(&Setup::default())), now: Instant::default() }
    }

    pub(super) fn command(&mut self, command: Command<'_>) -> &mut Self {
        self.core.handle_command(self.now, command).unwrap();
        self
    }

    pub(super) fn greeting() -> Self {
        let mut desk = Self::disconnected();
        desk.command(Command::Connect);
        assert_eq!(desk.written(), ["N0 M110 N0"]);
        desk
    }

    pub(super) fn idle() -> Self {
        let mut desk = Self::greeting();
        desk.hear(&["ok"]);
        assert_eq!(desk.written(), ["N1000 M105"]);
        desk.hear(&["Error:Line Number is not Last Line Number+1, Last Line: 0", "Resend: 1", "ok"]);
        assert_eq!(desk.core.state(), &State::Idle);
        assert_eq!(desk.events(), [Event::Connected]);
        desk
    }

    /// Streaming, with the first lines of so many sent.
    pub(super) fn streaming(n_lines: usize) -> Self {
        let mut desk = Self::idle();
        desk.command(Command::Begin);
        for i in 0..n_lines {
            desk.command(Command::Line(&format!("G1 X{i}")));
        }
        desk
    }

    /// All of a job of one line sent, everything acknowledged, the proof asked for.
    pub(super) fn finishing() -> Self {
        let mut desk = Self::streaming(1);
        desk.command(Command::EndOfJob);
        assert_eq!(desk.written().len(), 2);
        desk.hear(&["ok", "ok"]);
        assert_eq!(desk.written(), ["N1003 M105"]);
        desk
    }

    pub(super) fn hear(&mut self, lines: &[&str]) -> &mut Self {
        for line in lines {
            self.core.handle_line(self.now, line);
        }
        self
    }

    pub(super) fn wait(&mut self, s: f64) -> &mut Self {
        let end = self.now + Duration::from_secs_f64(s);
        let was_faulted = matches!(self.core.state(), State::Faulted(_));
        while let Some(due) = self.core.poll_timeout().filter(|due| *due <= end) {
            self.now = due;
            self.core.handle_timeout(due);
            if !was_faulted && matches!(self.core.state(), State::Faulted(_)) {
                return self;
            }
        }
        self.now = end;
        self
    }

    pub(super) fn written(&mut self) -> Vec<String> {
        written(&mut self.core)
    }

    pub(super) fn events(&mut self) -> Vec<Event> {
        std::iter::from_fn(|| self.core.poll_event()).collect()
    }

    pub(super) fn fault(&self) -> &Fault {
        match self.core.state() {
            State::Faulted(fault) => fault,
            other => panic!("not faulted but {other:?}"),
        }
    }

    /// Sent twice at once, and again until the printer has said twice that they are.
    pub(super) fn assert_heaters_off(&mut self) {
        let safe = ["M104 S0", "M140 S0", "M107"];
        assert_eq!(self.written(), [&safe[..], &safe, &["M105"]].concat());
        self.wait(1.0);
        assert_eq!(self.written(), [&["M108"], &safe[..], &["M105"]].concat());
        self.hear(&["ok T:201.00 /0.00 B:59.00 /0.00"]);
        assert_eq!(self.written(), ["M105"]);
        assert!(!self.events().iter().any(|e| matches!(e, Event::Secured(_))), "it may be of before");
        self.hear(&["ok", "ok T:200.00 /0.00 B:59.00 /0.00"]);
        let events = self.events();
        assert!(events.iter().any(|e| matches!(e, Event::Secured(Heat::Off(_)))), "{events:?}");
        assert_eq!(self.core.poll_timeout(), None);
    }

    /// What is known of the heaters in the end.
    pub(super) fn heat(&mut self) -> Heat {
        let secured = |event| if let Event::Secured(heat) = event { Some(heat) } else { None };
        let told: Vec<_> = self.events().into_iter().filter_map(secured).collect();
        assert_eq!(told.len(), 1, "told once");
        told[0].clone()
    }
}
