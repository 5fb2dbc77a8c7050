//! `<state>_<event>_<result>`: answers that come late, and numbers that look like a reset.

use super::super::*;
use super::desk::Desk;

/// Smoothieware in the middle of a job: so many lines are done, the next is under way.
fn smoothie(n_done: usize) -> Desk {
    let mut profile = crate::profile::builtin("smoothie").unwrap();
    profile.firmware.orphan_hold_s = 0.0;
    let mut desk = Desk { core: Core::new(&profile), now: Instant::default() };
    desk.command(Command::Connect).hear(&["ok", "rs N1"]).command(Command::Begin).written();
    for i in 1..=n_done {
        desk.command(Command::Line(&format!("G1 X{i}")));
        assert_eq!(desk.written(), [format!("N{i} G1 X{i}")]);
        desk.hear(&["ok"]);
    }
    desk.command(Command::Line("G1 X500"));
    assert_eq!(desk.written(), [format!("N{} G1 X500", n_done + 1)]);
    desk
}

/// Nothing is heard until it was asked so often.
fn ask_in_silence(desk: &mut Desk, n_questions: usize) {
    let mut n_asked = 0;
    while n_asked < n_questions {
        desk.now = desk.core.poll_timeout().unwrap();
        desk.core.handle_timeout(desk.now);
        n_asked += questions(desk);
    }
}

fn questions(desk: &mut Desk) -> usize {
    let mut n_asked = 0;
    while let Some(line) = desk.core.poll_transmit() {
        n_asked += usize::from(std::str::from_utf8(line.bytes).unwrap().contains(" M105*"));
    }
    n_asked
}

#[test]
fn streaming_refusals_of_questions_that_come_late_send_the_line_once() {
    let mut desk = smoothie(2);
    ask_in_silence(&mut desk, 3);
    // Of each question and of the void line before it.
    let sent: Vec<_> = (0..6).flat_map(|_| desk.hear(&["rs N3"]).written()).collect();
    assert_eq!(sent, ["N3 G1 X500"]);
    desk.hear(&["ok"]).command(Command::Line("G1 X600"));
    assert_eq!((desk.core.progress().n_acked, desk.written()), (3, vec!["N4 G1 X600".to_owned()]));
}

#[test]
fn streaming_refusal_of_another_line_is_no_late_one() {
    let mut desk = smoothie(2);
    ask_in_silence(&mut desk, 3);
    desk.hear(&["rs N3", "rs N3"]);
    assert_eq!(desk.written(), ["N3 G1 X500"]);
    desk.command(Command::Line("G1 X600"));
    assert!(desk.written().is_empty(), "the first goes alone");
    // It was accepted, and its `ok` lost.
    desk.hear(&["rs N4"]);
    assert_eq!(desk.written(), ["N4 G1 X600"]);
}

#[test]
fn streaming_first_line_asked_for_by_one_word_is_asked_about() {
    for (answer, is_reset) in [("rs N21", false), ("rs N1", true)] {
        let mut desk = smoothie(20);
        // Of `rs N21`, where there is noise.
        desk.hear(&["rs N1"]);
        assert_eq!((questions(&mut desk), desk.core.state()), (1, &State::Streaming));
        desk.hear(&[answer]);
        if is_reset {
            assert_eq!(desk.fault(), &Fault::FirmwareReset);
        } else {
            assert_eq!(desk.written(), ["N21 G1 X500"]);
        }
    }
}

/// Marlin, with so many lines done and more of them under way.
fn marlin(n_done: usize) -> Desk {
    let mut desk = Desk::streaming(30);
    for _ in 0..n_done {
        desk.written();
        desk.hear(&["ok"]);
    }
    desk.written();
    desk
}

const WRONG: &str = "Error:Line Number is not Last Line Number+1, Last Line: ";

#[test]
fn streaming_first_line_asked_for_by_both_words_is_a_reset() {
    let mut desk = marlin(20);
    desk.hear(&[&format!("{WRONG}0"), "Resend: 1", "ok"]);
    assert_eq!(desk.fault(), &Fault::FirmwareReset);
}

#[test]
fn streaming_first_line_asked_for_by_one_word_of_two_is_asked_about() {
    for (last, wanted) in [("0", "21"), ("20", "1"), ("2", "1")] {
        let mut desk = marlin(20);
        desk.hear(&[&format!("{WRONG}{last}"), &format!("Resend: {wanted}"), "ok"]);
        assert_eq!((questions(&mut desk), desk.core.state()), (1, &State::Streaming), "{last} {wanted}");
        desk.hear(&[&format!("{WRONG}20"), "Resend: 21", "ok"]);
        assert_eq!(desk.written(), ["N21 G1 X20"], "{last} {wanted}");
    }
}

/// `ok` of damaged lines may have been taken for those of the first ones.
#[test]
fn streaming_first_line_asked_for_soon_after_it_is_sent_again() {
    let mut desk = marlin(5);
    desk.hear(&[&format!("{WRONG}0"), "Resend: 1", "ok"]);
    assert_eq!(desk.written(), ["N1 G1 X0"]);
}
