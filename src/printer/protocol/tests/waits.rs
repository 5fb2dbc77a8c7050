//! `<state>_<event>_<result>`: lines that take their minutes on firmware that says nothing meanwhile, and questions behind what never
//! ends.

use super::super::*;
use super::desk::Desk;

/// A core for that firmware in the middle of a job whose only line is `line`.
fn at_work(profile: &str, line: &str) -> Desk {
    let profile = crate::profile::builtin(profile).unwrap();
    let mut desk = Desk { core: Core::new(&profile), now: Instant::default() };
    desk.command(Command::Inquire { beyond: 0 }).written();
    desk.hear(&["ok T:20.0 /0.0 B:20.0 /0.0"]);
    desk.command(Command::GoOn).command(Command::Line(line));
    while desk.written().iter().all(|sent| !sent.contains(line)) {
        desk.hear(&["ok"]);
    }
    desk
}

#[test]
fn streaming_macro_of_a_firmware_without_busy_takes_its_minutes() {
    for line in ["START_PRINT BED=60", "QUAD_GANTRY_LEVEL", "G32"] {
        let mut desk = at_work("klipper", line);
        desk.wait(5.0).hear(&["// probe at 10,10 is z=0.1"]).wait(600.0);
        assert_eq!(desk.core.state(), &State::Streaming, "{line}");
    }
}

#[test]
fn streaming_dwell_is_given_its_own_time() {
    let mut desk = at_work("klipper", "G4 P3600000");
    desk.wait(3700.0);
    assert_eq!(desk.core.state(), &State::Streaming);
    desk.wait(1800.0);
    assert!(matches!(desk.core.state(), State::Faulted(_)), "but not more");
}

/// Everything acknowledged, the last question asked; the firmware says `what` for so long.
fn asked_last(what: &str, for_s: u32) -> Desk {
    let mut desk = Desk::finishing();
    desk.events();
    for _ in 0..for_s / 2 {
        desk.hear(&[what]).wait(2.0);
        if matches!(desk.core.state(), State::Faulted(_)) {
            break;
        }
    }
    desk
}

#[test]
fn finishing_question_that_is_never_answered_comes_to_an_end() {
    let mut desk = asked_last("echo:busy: processing", 4000);
    let Fault::CommandTimeout { command, after } = desk.fault() else { panic!("{:?}", desk.fault()) };
    assert_eq!((command.as_str(), after.as_secs()), ("M105", 1800));
    desk.assert_heaters_off();
}

#[test]
fn finishing_question_behind_what_takes_its_time_is_waited_for() {
    let mut desk = asked_last("echo:busy: processing", 1700);
    desk.hear(&["Error:Line Number is not Last Line Number+1, Last Line: 2", "Resend: 3", "ok"]);
    assert!(desk.events().contains(&Event::Finished));
}

/// Noise can make a wait for the user of a question: `M1 5` of `M105`.
#[test]
fn finishing_user_awaited_by_no_line_of_the_job_is_told_and_waited_for() {
    let mut desk = asked_last("echo:busy: paused for user", 30_000);
    let n_paused = desk.events().iter().filter(|event| **event == Event::Paused).count();
    assert_eq!((desk.core.state(), n_paused), (&State::Finishing, 1), "told once");
    desk.written();
    assert!(desk.core.is_user_awaited());
    desk.command(Command::Resume);
    assert_eq!(desk.written(), ["M108"]);
    desk.hear(&["ok", "Error:Line Number is not Last Line Number+1, Last Line: 2", "Resend: 3", "ok"]);
    assert!(desk.events().contains(&Event::Finished));
}

/// Repetier says `ok` as it takes a line: what is acknowledged may still be to come.
fn repetier(line: &str) -> Desk {
    let mut profile = crate::profile::builtin("repetier").unwrap();
    (profile.firmware.orphan_hold_s, profile.firmware.temperature_report_s) = (0.0, 0.0);
    let mut desk = Desk { core: Core::new(&profile), now: Instant::default() };
    desk.command(Command::Connect).hear(&["ok 0"]).written();
    desk.hear(&["Error:expected line 1 got 1000", "Resend:1", "ok"]);
    desk.command(Command::Begin).command(Command::Line(line));
    desk
}

/// Takes all lines, but answers no question; is busy for so long.
fn take_all(desk: &mut Desk, for_s: u32) {
    while !desk.written().is_empty() {
        while desk.core.progress().n_acked < desk.core.progress().n_sent {
            desk.hear(&[&format!("ok {}", desk.core.progress().n_acked + 1)]);
        }
    }
    for _ in 0..for_s / 2 {
        desk.hear(&["busy:processing"]).wait(2.0);
    }
}

#[test]
fn finishing_question_behind_lines_that_were_taken_is_given_their_time() {
    let mut desk = repetier("G4 S3600");
    desk.command(Command::EndOfJob);
    take_all(&mut desk, 5000);
    assert_eq!(desk.core.state(), &State::Finishing);
    take_all(&mut desk, 5000);
    assert!(matches!(desk.core.state(), State::Faulted(_)), "but not more");
}

#[test]
fn cancelling_question_behind_heating_is_given_its_time() {
    let mut desk = repetier("M190 S60");
    take_all(&mut desk, 0);
    desk.command(Command::Cancel);
    take_all(&mut desk, 1500);
    assert_eq!(desk.core.state(), &State::Cancelling);
}

#[test]
fn cancelling_wait_for_the_user_is_ended() {
    let mut desk = Desk::streaming(0);
    desk.command(Command::Line("M600")).written();
    desk.hear(&["echo:busy: paused for user"]).command(Command::Cancel).written();
    desk.hear(&["echo:busy: paused for user"]);
    assert_eq!(desk.written(), ["M108"], "the first may have come too early");
    for _ in 0..100 {
        desk.hear(&["echo:busy: paused for user"]).wait(2.0);
    }
    assert!(matches!(desk.core.state(), State::Faulted(_)), "heaters-off does not stand behind it for ever");
}
