//! Asking a printer that is not printing, switching its heaters off, and stopping it at once: for `profiles detect`, `safe-off` and the
//! server.
//!
//! The first two ask without touching the firmware's line numbers, so that a print that broke off can still be resumed: exactly after
//! `detect`; after `safe-off` too, once it is warm again, where it still is in its place.

use super::Error;
use super::driver::Clock;
use super::identity::{dialect_of, profile_name};
use super::link::Link;
use super::protocol::{Command, Core, Event, Fault, Heat, LineSplitter, State, Temperatures};
use crate::profile::Profile;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};

/// How exactly time-outs are kept.
const TICK: Duration = Duration::from_millis(20);
/// The longest that an answer is waited for.
const LIMIT: Duration = Duration::from_secs(60);
/// The question, with what makes half a line before it void in every firmware.
const WHICH_FIRMWARE: &[u8] = b"99?X?\nM115\n";
/// How often it is asked, and how long an answer may take: a board that was reset by the opening is up after the second.
const N_ASKED: usize = 4;
const ANSWERED_WITHIN: Duration = Duration::from_secs(2);

/// What a printer says of itself.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Found {
    /// Its answer to M115.
    pub firmware: String,
    /// The firmware, where it is known.
    pub profile: Option<&'static str>,
}

/// Asks which firmware it is, in words that each of them understands.
///
/// # Errors
/// [`Error::Open`], [`Error::PortVanished`]; [`Error::Nobody`] where nothing answers.
pub async fn detect<L: Link>(mut link: L) -> Result<Found, Error> {
    let port = link.name().to_owned();
    let mut stream = link.open().await?;
    let mut splitter = LineSplitter::default();
    for _ in 0..N_ASKED {
        let gone = |_| Error::PortVanished { port: port.clone() };
        stream.write_all(WHICH_FIRMWARE).await.map_err(gone)?;
        let answer = firmware_told(&mut stream, &mut splitter);
        match tokio::time::timeout(ANSWERED_WITHIN, answer).await {
            Ok(Some(firmware)) => {
                let profile = dialect_of(&firmware).map(profile_name);
                return Ok(Found { firmware, profile });
            }
            Ok(None) => return Err(Error::PortVanished { port }),
            Err(_elapsed) => {}
        }
    }
    Err(Error::Nobody { port })
}

/// What it says to M115; `None` where the port goes away.
async fn firmware_told(stream: &mut (impl AsyncRead + Unpin), splitter: &mut LineSplitter) -> Option<String> {
    let mut buffer = vec![0; 4096];
    loop {
        let n = stream.read(&mut buffer).await.ok().filter(|n| *n > 0)?;
        let mut told = None;
        splitter.feed(&buffer[..n], |line| {
            // Klipper says it behind its `ok`.
            if let Some(at) = line.find("FIRMWARE_") {
                told.get_or_insert_with(|| line[at..].to_owned());
            }
        });
        if told.is_some() {
            return told;
        }
    }
}

/// Switches the heaters off: sends the profile's safe script until the printer tells twice that the targets are 0; if it tells that
/// they are not, it is stopped for good (M112).
///
/// # Errors
/// [`Error::Open`]; [`Error::Fault`] where nothing answers; [`Error::StillHeating`].
pub async fn safe_off<L: Link>(mut link: L, profile: &Profile) -> Result<Temperatures, Error> {
    let port = link.name().to_owned();
    let stream = link.open().await?;
    let mut desk = Desk::new(profile, port.clone());
    let mut heat = Heat::default();
    desk.command(Command::HeatersOff);
    desk.until_secured(stream, &mut heat).await?;
    let fault = match heat {
        Heat::Off(told) => return Ok(told),
        Heat::On(_) => return Err(Error::StillHeating { port }),
        Heat::Halted => Fault::Halted { text: "it says that it has stopped for good".to_owned() },
        Heat::Obeyed | Heat::Unknown(_) => Fault::NoAnswer { is_garbled: false },
    };
    Err(Error::Fault { port, fault, heat })
}

/// Stops a printer at once (M112), until it says that it has stopped, or that its heaters are off; what is known of these.
///
/// # Errors
/// [`Error::PortVanished`].
pub async fn stop_at_once(
    stream: impl AsyncRead + AsyncWrite + Unpin,
    port: &str,
    profile: &Profile,
) -> Result<Heat, Error> {
    let mut desk = Desk::new(profile, port.to_owned());
    let mut heat = Heat::default();
    // Goes before the rest.
    desk.command(Command::HeatersOff);
    desk.command(Command::EmergencyStop);
    desk.until_secured(stream, &mut heat).await?;
    Ok(heat)
}

struct Desk {
    core: Core,
    port: String,
    clock: Clock,
}

impl Desk {
    fn new(profile: &Profile, port: String) -> Self {
        // Unnumbered: the core then asks nothing but what it is told to.
        let mut profile = profile.clone();
        profile.firmware.line_numbers = false;
        Self { core: Core::new(&profile), port, clock: Clock::start() }
    }

    async fn until_secured(
        &mut self,
        stream: impl AsyncRead + AsyncWrite + Unpin,
        heat: &mut Heat,
    ) -> Result<(), Error> {
        let secured = |_: &mut Self, event: &Event| {
            let Event::Secured(known) = event else { return None };
            *heat = known.clone();
            Some(Ok(()))
        };
        self.converse(stream, secured).await
    }

    /// Talks until `hear` has heard enough; what is to be said then still is.
    async fn converse(
        &mut self,
        mut stream: impl AsyncRead + AsyncWrite + Unpin,
        mut hear: impl FnMut(&mut Self, &Event) -> Option<Result<(), Error>>,
    ) -> Result<(), Error> {
        let mut splitter = LineSplitter::default();
        let mut buffer = vec![0; 4096];
        loop {
            let mut end = None;
            while let Some(event) = self.core.poll_event() {
                end = end.or(hear(self, &event));
            }
            let mut out = Vec::new();
            while let Some(line) = self.core.poll_transmit() {
                out.extend_from_slice(line.bytes);
            }
            let gone = |_| Error::PortVanished { port: self.port.clone() };
            stream.write_all(&out).await.map_err(gone)?;
            if let Some(end) = end {
                return end;
            }
            tokio::select! {
                read = stream.read(&mut buffer) => match read {
                    Ok(n) if n > 0 => {
                        let (core, now) = (&mut self.core, self.clock.now());
                        splitter.feed(&buffer[..n], |line| core.handle_line(now, line));
                    }
                    _ => return Err(Error::PortVanished { port: self.port.clone() }),
                },
                () = tokio::time::sleep(TICK) => self.tick(),
            }
        }
    }

    fn tick(&mut self) {
        let now = self.clock.now();
        if now.since(super::protocol::Instant::default()) > LIMIT && *self.core.state() != State::Disconnected
        {
            self.core.give_up(now, Fault::Silent { after: LIMIT });
        } else if self.core.poll_timeout().is_some_and(|due| due <= now) {
            self.core.handle_timeout(now);
        }
    }

    /// A command whose refusal means that it is too late for it.
    fn command(&mut self, command: Command<'_>) {
        self.core.handle_command(self.clock.now(), command).ok();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile;
    use tokio::io::DuplexStream;

    /// What comes of it at a printer that says this to the first that it hears, and goes away then; and what it has heard.
    async fn stopped(says: &'static str) -> (Result<Heat, Error>, String) {
        let (ours, printers) = tokio::io::duplex(1 << 16);
        let printer = tokio::spawn(printer(printers, says));
        let heat = stop_at_once(ours, "port", &profile::builtin("marlin").unwrap()).await;
        (heat, printer.await.unwrap())
    }

    async fn printer(mut stream: DuplexStream, says: &'static str) -> String {
        let mut bytes = [0; 4096];
        let n = stream.read(&mut bytes).await.unwrap();
        stream.write_all(says.as_bytes()).await.unwrap();
        String::from_utf8_lossy(&bytes[..n]).into_owned()
    }

    #[tokio::test]
    async fn an_emergency_stop_goes_before_all_else_and_is_done_when_the_printer_says_so() {
        let (heat, heard) = stopped("Error:Printer halted. kill() called!\n").await;
        assert_eq!(heat.unwrap(), Heat::Halted);
        assert!(heard.starts_with("\nM112\n"), "{heard}");
    }

    #[tokio::test]
    async fn a_printer_that_goes_away_has_not_said_that_it_has_stopped() {
        let (heat, _heard) = stopped("ok T:200.0 /200.0\n").await;
        assert!(matches!(heat, Err(Error::PortVanished { .. })), "{heat:?}");
    }
}
