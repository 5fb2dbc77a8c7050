//! A firmware that counts no lines, played by hand: in doubt it is asked where it is.

use super::super::*;
use std::time::Duration;

const FAR: &str = "X:90.000 Y:20.000 Z:1.000 E:7.000 E0:7.0 Count 0 0 0 Machine 0 0 0 Bed comp 0.000";
const THERE: &str = "X:10.000 Y:20.000 Z:1.000 E:7.000 E0:7.0 Count 0 0 0 Machine 0 0 0 Bed comp 0.000";
const WARM: &str = "ok T:200.0 /200.0 B:60.0 /60.0";

/// Each with a checksum.
fn is_question(text: &str) -> bool {
    text.lines().filter(|line| line.contains(" M114*") || line.contains(" M105*")).count() == 2
}

struct Desk {
    core: Core,
    now: Instant,
}

impl Desk {
    /// Printing on a printer that is at [`FAR`], with one line under way.
    fn doing(line: &str, asks_again: bool) -> Self {
        let mut profile = crate::profile::builtin("reprapfirmware").unwrap();
        profile.firmware.temperature_report_s = 0.0;
        profile.firmware.orphan_hold_s = 0.0;
        let mut desk = Self { core: Core::new(&profile), now: Instant::default() };
        desk.core.handle_command(desk.now, Command::Connect).unwrap();
        assert!(is_question(&desk.written()));
        let asked: &[&str] = if asks_again { &["rs 4000000000"] } else { &[] };
        desk.hear(asked).hear(&[FAR, "ok", WARM]);
        desk.core.handle_command(desk.now, Command::Begin).unwrap();
        desk.core.handle_command(desk.now, Command::Line(line)).unwrap();
        assert!(desk.written().contains(line));
        desk
    }

    fn hear(&mut self, lines: &[&str]) -> &mut Self {
        lines.iter().for_each(|line| self.core.handle_line(self.now, line));
        self
    }

    fn written(&mut self) -> String {
        let mut out = String::new();
        while let Some(line) = self.core.poll_transmit() {
            out.push_str(std::str::from_utf8(line.bytes).unwrap());
        }
        out
    }

    /// No answer comes, until the printer is asked where it is.
    fn in_doubt(mut self) -> Self {
        self.now = self.core.poll_timeout().unwrap();
        self.core.handle_timeout(self.now);
        assert!(is_question(&self.written()));
        self
    }

    fn is_done(&self) -> bool {
        self.core.progress().n_acked == 1
    }
}

#[test]
fn doubt_at_the_place_before_a_move_sends_it_again() {
    let mut desk = Desk::doing("G1 X10", true).in_doubt();
    desk.hear(&[FAR, "ok", WARM]);
    assert!(!desk.is_done() && desk.written().contains("N1 G1 X10 *"));
    assert_eq!(desk.core.stats().n_lost_oks, 0);
}

#[test]
fn doubt_at_the_place_behind_a_move_goes_on() {
    let mut desk = Desk::doing("G1 X10", false).in_doubt();
    desk.hear(&[THERE, "ok", WARM]);
    assert!(desk.is_done() && desk.written().is_empty());
    assert_eq!(desk.core.stats().n_lost_oks, 1);
}

#[test]
fn doubt_believes_the_place_more_than_a_request_to_send_again() {
    let mut desk = Desk::doing("G1 X10", true).in_doubt();
    desk.hear(&["rs 1", THERE, "ok", WARM]);
    assert!(desk.is_done() && desk.written().is_empty());
}

#[test]
fn an_answer_that_was_only_late_is_no_lost_one() {
    let mut desk = Desk::doing("G1 X10", true).in_doubt();
    desk.hear(&["ok", THERE, "ok", WARM]);
    assert!(desk.is_done());
    assert_eq!(desk.core.stats().n_lost_oks, 0);
}

#[test]
fn nothing_is_decided_before_all_questions_are_answered() {
    let mut desk = Desk::doing("G1 X10", true).in_doubt().in_doubt();
    desk.hear(&[FAR, "ok", WARM]);
    assert!(desk.written().is_empty(), "an `ok` is still under way");
    desk.hear(&[FAR, "ok", WARM]);
    assert!(!desk.is_done() && desk.written().contains("N1 G1 X10 *"));
}

#[test]
fn an_answer_that_never_comes_is_not_waited_for() {
    let mut desk = Desk::doing("G1 X10", true).in_doubt().in_doubt();
    desk.hear(&[FAR, "ok", WARM]);
    desk.now = desk.core.poll_timeout().unwrap();
    desk.core.handle_timeout(desk.now);
    assert!(!desk.is_done() && desk.written().contains("N1 G1 X10 *"));
}

#[test]
fn what_leaves_no_trace_is_sent_again_where_that_does_no_harm() {
    for line in ["M106 S255", "G28", "M109 S210"] {
        let mut desk = Desk::doing(line, false).in_doubt();
        desk.hear(&[FAR, "ok", WARM]);
        assert!(desk.written().contains(&format!("N1 {line} *")));
    }
}

#[test]
fn a_macro_is_never_run_twice() {
    let mut desk = Desk::doing("M98 P\"a.g\"", true).in_doubt();
    desk.hear(&[FAR, "ok", WARM]);
    assert!(desk.is_done(), "it would have been asked for");
    let mut desk = Desk::doing("M98 P\"a.g\"", false).in_doubt();
    desk.hear(&[FAR, "ok", WARM]);
    assert!(
        matches!(desk.core.state(), State::Faulted(Fault::Unsure { command }) if command.contains("M98"))
    );
}

#[test]
fn a_slow_line_that_ends_after_all_is_not_repeated() {
    let mut desk = Desk::doing("G28", true).in_doubt();
    desk.hear(&["ok", THERE, "ok", WARM]);
    assert!(desk.is_done() && desk.written().is_empty());
}

#[test]
fn a_place_that_is_neither_ends_the_print() {
    let mut desk = Desk::doing("G1 X10", true).in_doubt();
    for _ in 0..2 {
        desk.hear(&["X:50.000 Y:20.000 Z:1.000 E:7.000", "ok", WARM]);
        assert!(is_question(&desk.written()), "the answer may be damaged");
    }
    desk.hear(&["X:50.000 Y:20.000 Z:1.000 E:7.000", "ok", WARM]);
    let fault = desk.core.state().clone();
    assert!(matches!(fault, State::Faulted(Fault::Unsure { .. })), "{fault:?}");
}

#[test]
fn filament_alone_is_told_by_its_place() {
    let mut desk = Desk::doing("G1 E6.2 F2100", false).in_doubt();
    desk.hear(&["X:90.000 Y:20.000 Z:1.000 E:6.200", "ok", WARM]);
    assert!(desk.is_done());
}

#[test]
fn a_firmware_that_asks_for_nothing_again_is_told_of() {
    for asks_again in [false, true] {
        let mut desk = Desk::doing("G1 X10", asks_again);
        let told = std::iter::from_fn(|| desk.core.poll_event()).any(|event| event == Event::NeverAsksAgain);
        assert_eq!(told, !asks_again);
    }
}

#[test]
fn late_answers_to_the_greeting_are_no_answers_to_lines() {
    let profile = crate::profile::builtin("reprapfirmware").unwrap();
    let mut desk = Desk { core: Core::new(&profile), now: Instant::default() };
    desk.core.handle_command(desk.now, Command::Connect).unwrap();
    desk.now = desk.now + Duration::from_secs(2);
    desk.core.handle_timeout(desk.now);
    desk.hear(&[FAR, "ok", WARM]);
    desk.core.handle_command(desk.now, Command::Begin).unwrap();
    desk.core.handle_command(desk.now, Command::Line("G1 X10")).unwrap();
    assert!(!desk.written().contains("G1 X10"));
    desk.hear(&[FAR, "ok", WARM]);
    assert!(desk.written().starts_with('N'));
    assert_eq!(desk.core.progress().n_acked, 0);
}
