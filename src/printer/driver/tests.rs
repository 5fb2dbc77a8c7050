use super::*;
use crate::printer::link::NamedLink;
use crate::printer::protocol::Heat;
use std::io::Cursor;
use std::pin::Pin;
use std::task::{Context, Poll};
use tokio::io::{AsyncBufReadExt, BufReader, DuplexStream, ReadBuf};

/// How a printer of these tests ends.
#[derive(Clone, Copy, PartialEq)]
enum Manner {
    Proper,
    VanishesAfter(usize),
    KilledAfter(usize),
    DeadAfter(usize),
}

/// A firmware without faults of its own: numbers, refusals, `ok`. Gives back what it executed.
async fn firmware(port: DuplexStream, manner: Manner) -> Vec<String> {
    let (reader, mut writer) = tokio::io::split(port);
    let mut lines = BufReader::new(reader).lines();
    let mut executed = Vec::new();
    let mut last = 41;
    while let Ok(Some(line)) = lines.next_line().await {
        let Some(rest) = line.strip_prefix('N') else {
            if !line.is_empty() {
                executed.push(line);
                writer.write_all(b"ok\n").await.ok();
            }
            continue;
        };
        let (number, command) = rest.split_once(' ').unwrap();
        let command = command.split('*').next().unwrap();
        let number: u64 = number.parse().unwrap();
        let n_moves = executed.iter().filter(|c| c.starts_with("G1")).count();
        match manner {
            Manner::VanishesAfter(n) if n == n_moves => return executed,
            Manner::DeadAfter(n) if n == n_moves => continue,
            Manner::KilledAfter(n) if n == n_moves => {
                let text = b"Error:Heating failed, system stopped! Heater_ID: E0\nError:Printer halted. kill() called!\n";
                writer.write_all(text).await.ok();
            }
            _ => {}
        }
        if number != last + 1 && !command.starts_with("M110") {
            let text = format!(
                "Error:Line Number is not Last Line Number+1, Last Line: {last}\nResend: {}\nok\n",
                last + 1
            );
            writer.write_all(text.as_bytes()).await.ok();
            continue;
        }
        last = number;
        executed.push(command.to_owned());
        writer.write_all(b"ok\n").await.ok();
    }
    executed
}

fn job(n_lines: usize, profile: &Profile) -> Job<Cursor<Vec<u8>>> {
    let text: String = (0..n_lines).map(|i| format!("G1 X{i} ; move\n")).collect();
    Job::from_text(text, "test.gcode", &profile.firmware).unwrap()
}

async fn printed(
    manner: Manner,
    n_lines: usize,
    cancel_after: Option<Duration>,
) -> (Result<Printed, Error>, Vec<String>, Vec<PrintEvent>) {
    let mut profile = crate::profile::builtin("marlin").unwrap();
    profile.firmware.response_timeout_s = 0.1;
    profile.firmware.orphan_hold_s = 0.0;
    let (ours, theirs) = tokio::io::duplex(4096);
    let link = NamedLink::new("/dev/test", ours);
    let (sender, mut events) = mpsc::channel(16);
    let listener = tokio::spawn(async move {
        let mut heard = Vec::new();
        while let Some(event) = events.recv().await {
            heard.push(event);
        }
        heard
    });
    let cancel = CancelToken::default();
    let printer = tokio::spawn(firmware(theirs, manner));
    if let Some(after) = cancel_after {
        let cancel = cancel.clone();
        tokio::spawn(async move {
            tokio::time::sleep(after).await;
            cancel.cancel();
        });
    }
    let result = print(job(n_lines, &profile), link, &profile, &sender, &cancel).await;
    drop(sender);
    (result, printer.await.unwrap(), listener.await.unwrap())
}

#[tokio::test]
async fn every_line_is_printed_once_and_in_order() {
    let (result, executed, events) = printed(Manner::Proper, 500, None).await;
    assert_eq!(result.unwrap().n_lines, 500);
    let moves: Vec<_> = executed.iter().filter(|c| c.starts_with("G1")).cloned().collect();
    assert_eq!(moves, (0..500).map(|i| format!("G1 X{i}")).collect::<Vec<_>>());
    assert_eq!(executed.last().unwrap(), "M155 S0");
    assert!(executed.contains(&"M400".to_owned()));
    assert_eq!(events.last(), Some(&PrintEvent::Progress { n_lines_done: 500, n_lines: 500 }));
}

#[tokio::test]
async fn a_port_that_vanishes_is_named_and_heaters_are_unknown() {
    let (result, ..) = printed(Manner::VanishesAfter(20), 500, None).await;
    let error = result.unwrap_err();
    assert_eq!(error.code(), "printer.port_vanished");
    assert!(
        error.to_string().contains("port /dev/test vanished during the print; whether the heaters are on")
    );
}

#[tokio::test]
async fn a_killed_firmware_ends_the_print_with_heaters_off_sent() {
    let (result, executed, events) = printed(Manner::KilledAfter(20), 500, None).await;
    let error = result.unwrap_err();
    assert_eq!(error.code(), "printer.halted");
    assert!(
        error.to_string().starts_with("printer on /dev/test: the printer stopped: Heating failed"),
        "{error}"
    );
    assert!(executed.contains(&"M104 S0".to_owned()) && executed.contains(&"M140 S0".to_owned()));
    assert!(events.iter().any(|e| matches!(e, PrintEvent::Session(Event::Faulted(_)))));
}

#[tokio::test]
async fn a_dead_firmware_ends_the_print() {
    let (result, executed, _) = printed(Manner::DeadAfter(20), 500, None).await;
    assert_eq!(result.unwrap_err().code(), "printer.silent");
    assert!(executed.contains(&"M104 S0".to_owned()), "tried all the same");
}

#[tokio::test]
async fn a_request_to_cancel_is_followed_and_confirmed() {
    let (result, executed, events) =
        printed(Manner::DeadAfter(usize::MAX), 2_000_000, Some(Duration::ZERO)).await;
    assert!(matches!(result, Err(Error::Cancelled { heat: Heat::Obeyed })), "{result:?}");
    assert!(executed.len() < 1_000_000);
    assert!(executed.contains(&"M140 S0".to_owned()));
    assert!(events.contains(&PrintEvent::Session(Event::Cancelled)));
}

#[tokio::test]
async fn a_listener_that_left_does_not_stop_the_print() {
    let profile = crate::profile::builtin("marlin").unwrap();
    let (ours, theirs) = tokio::io::duplex(4096);
    let (sender, events) = mpsc::channel(1);
    drop(events);
    let printer = tokio::spawn(firmware(theirs, Manner::Proper));
    let link = NamedLink::new("x", ours);
    let result = print(job(100, &profile), link, &profile, &sender, &CancelToken::default()).await;
    assert_eq!(result.unwrap().n_lines, 100);
    printer.await.unwrap();
}

#[tokio::test]
async fn a_listener_that_does_not_listen_does_not_stop_the_print() {
    let profile = crate::profile::builtin("marlin").unwrap();
    let (ours, theirs) = tokio::io::duplex(4096);
    let (sender, mut events) = mpsc::channel(1);
    let printer = tokio::spawn(firmware(theirs, Manner::Proper));
    let link = NamedLink::new("x", ours);
    let result = print(job(100, &profile), link, &profile, &sender, &CancelToken::default()).await;
    assert!(result.is_ok());
    assert_eq!(events.recv().await, Some(PrintEvent::Session(Event::Connected)));
    printer.await.unwrap();
}

#[tokio::test]
async fn a_session_is_in_the_journal_before_its_first_line_is_sent() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("j.journal");
    let profile = crate::profile::builtin("marlin").unwrap();
    let (ours, theirs) = tokio::io::duplex(4096);
    let (sender, mut events) = mpsc::channel(64);
    let read = path.clone();
    // What the file said when the first move came.
    let printer = tokio::spawn(async move {
        let executed = firmware(theirs, Manner::VanishesAfter(1)).await;
        (executed, std::fs::read_to_string(read).unwrap())
    });
    let listener = tokio::spawn(async move { while events.recv().await.is_some() {} });
    let order = Order {
        job: job(50, &profile),
        start: Start::Fresh,
        journal: Some(Journal::create(&path, &[]).unwrap()),
        controls: Controls::default(),
    };
    let mut profile = profile;
    profile.firmware.orphan_hold_s = 0.0;
    let error = run(order, NamedLink::new("x", ours), &profile, &sender, &CancelToken::default()).await;
    assert_eq!(error.unwrap_err().code(), "printer.port_vanished");
    drop(sender);
    listener.await.unwrap();
    assert!(printer.await.unwrap().1.contains("\"session\""));
}

/// A port that always has something to read, for so long.
struct Flood(tokio::time::Instant);

impl AsyncRead for Flood {
    fn poll_read(
        self: Pin<&mut Self>,
        _: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<std::io::Result<()>> {
        if self.0.elapsed() < Duration::from_secs(2) {
            buffer.put_slice(b"echo:busy: processing\n");
        }
        Poll::Ready(Ok(()))
    }
}

impl AsyncWrite for Flood {
    fn poll_write(self: Pin<&mut Self>, _: &mut Context<'_>, bytes: &[u8]) -> Poll<std::io::Result<usize>> {
        Poll::Ready(Ok(bytes.len()))
    }

    fn poll_flush(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        Poll::Ready(Ok(()))
    }

    fn poll_shutdown(self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<std::io::Result<()>> {
        Poll::Ready(Ok(()))
    }
}

#[tokio::test]
async fn a_flood_of_bytes_does_not_stop_the_clock() {
    let profile = crate::profile::builtin("marlin").unwrap();
    let (sender, _events) = mpsc::channel(16);
    let cancel = CancelToken::default();
    cancel.cancel();
    let link = NamedLink::new("x", Flood(tokio::time::Instant::now()));
    let result = print(job(50, &profile), link, &profile, &sender, &cancel).await;
    assert!(matches!(result, Err(Error::Left { .. })), "{result:?}");
}
