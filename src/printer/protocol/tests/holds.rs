//! `<state>_<event>_<result>`: pauses, questions of the printer, and giving up.

use super::super::*;
use super::desk::Desk;

#[test]
fn streaming_pause_waits_for_the_lines_in_flight() {
    let mut desk = Desk::streaming(20);
    let n_sent = desk.written().len();
    desk.command(Command::Pause);
    assert_eq!(desk.core.state(), &State::Pausing);
    assert!(!desk.core.wants_line());
    for _ in 0..n_sent {
        desk.hear(&["ok"]);
    }
    assert_eq!(desk.events(), [Event::Paused]);
    assert!(desk.written().is_empty());
    for _ in 0..10_000 {
        desk.wait(6.0).hear(&["ok T:210.00 /210.00 B:60.00 /60.00"]);
    }
    assert_eq!(desk.core.state(), &State::Paused, "never killed");
    assert!(desk.written().iter().all(|line| line == "M105"));
    desk.command(Command::Resume);
    assert!(!desk.written().is_empty());
}

#[test]
fn finishing_pause_holds_the_lines_that_are_given_but_not_sent() {
    let mut desk = Desk::streaming(20);
    desk.command(Command::EndOfJob);
    let n_sent = desk.written().len();
    desk.hear(&["//action:pause filament_runout 0"]);
    for _ in 0..n_sent {
        desk.hear(&["ok"]);
    }
    assert_eq!((desk.written().len(), desk.core.state()), (0, &State::Paused));
    desk.command(Command::Resume);
    assert_eq!(desk.core.state(), &State::Finishing);
    assert!(desk.written()[0].starts_with(&format!("N{} ", n_sent + 1)));
}

#[test]
fn any_state_emergency_stop_jumps_the_queue() {
    let mut desk = Desk::streaming(20);
    desk.command(Command::EmergencyStop);
    assert_eq!(desk.written()[0], "M112");
    assert_eq!(desk.fault(), &Fault::EmergencyStop);
    desk.events();
    // Lost on the way: said again.
    desk.wait(1.0);
    assert_eq!(desk.written()[0], "M112");
    desk.hear(&["Error:Printer halted. kill() called!"]);
    assert_eq!(desk.heat(), Heat::Halted);
    assert_eq!(desk.core.poll_timeout(), None);
}

#[test]
fn any_state_emergency_stop_stands_at_the_beginning_of_a_line() {
    for is_giving_up in [false, true] {
        let mut desk = Desk::streaming(20);
        desk.written();
        if is_giving_up {
            desk.hear(&["Error:Heating failed, system stopped! Heater_ID: E0"]);
        }
        desk.command(Command::EmergencyStop);
        let mut sent = Vec::new();
        while let Some(line) = desk.core.poll_transmit() {
            sent.extend_from_slice(line.bytes);
        }
        assert!(sent.starts_with(b"\nM112\n"), "{is_giving_up}: {:?}", String::from_utf8_lossy(&sent));
    }
}

#[test]
fn stopped_firmware_that_starts_anew_is_not_stopped_again() {
    let mut desk = Desk::streaming(20);
    desk.command(Command::EmergencyStop).written();
    desk.hear(&["start"]);
    for _ in 0..3 {
        desk.wait(1.0).hear(&["ok T:180.00 /0.00 B:50.00 /0.00"]);
    }
    assert!(!desk.written().contains(&"M112".to_owned()));
    assert!(matches!(desk.heat(), Heat::Off(_)));
}

#[test]
fn any_state_emergency_stop_without_an_answer_is_unknown() {
    let mut desk = Desk::streaming(20);
    desk.command(Command::EmergencyStop).wait(60.0);
    assert_eq!(desk.heat(), Heat::Unknown(None));
    assert_eq!(desk.core.poll_timeout(), None, "bounded");
}

#[test]
fn faulted_heaters_that_stay_on_end_in_an_emergency_stop() {
    let mut desk = Desk::streaming(5);
    desk.hear(&["start"]).written();
    desk.events();
    for _ in 0..20 {
        desk.wait(1.0).hear(&["ok T:201.00 /210.00 B:59.00 /0.00"]);
    }
    assert!(matches!(desk.heat(), Heat::On(_)));
    assert_eq!(desk.written().last().unwrap(), "M112");
}

#[test]
fn faulted_target_that_is_not_told_confirms_nothing() {
    let mut desk = Desk::streaming(5);
    desk.hear(&["start"]).written();
    desk.events();
    for _ in 0..20 {
        desk.wait(1.0).hear(&["ok T:201.00 B:59.00"]);
    }
    assert!(matches!(desk.heat(), Heat::Unknown(_)));
}

#[test]
fn paused_dead_board_is_noticed_in_time() {
    let mut desk = Desk::streaming(5);
    let n_sent = desk.written().len();
    desk.command(Command::Pause).wait(0.1);
    (0..n_sent).for_each(|_| {
        desk.hear(&["ok"]);
    });
    assert_eq!(desk.core.state(), &State::Paused);
    desk.wait(22.0);
    assert_eq!(desk.core.state(), &State::Paused);
    desk.wait(1.0);
    assert!(matches!(desk.fault(), Fault::Silent { .. }));
}

#[test]
fn paused_user_at_the_printer_is_waited_for_all_night_and_not_flooded() {
    let mut desk = Desk::streaming(5);
    let n_sent = desk.written().len();
    desk.command(Command::Pause);
    (0..n_sent).for_each(|_| {
        desk.hear(&["ok"]);
    });
    for _ in 0..15_000 {
        desk.wait(2.0).hear(&["echo:busy: paused for user"]);
    }
    assert_eq!(desk.core.state(), &State::Paused);
    assert!(desk.written().len() < 200, "it takes nothing meanwhile");
}

#[test]
fn pausing_refused_line_is_brought_to_its_end_first() {
    let mut desk = Desk::streaming(5);
    let n_sent = desk.written().len();
    assert!(n_sent > 3);
    desk.command(Command::Pause);
    desk.hear(&["ok", "Error:checksum mismatch, Last Line: 1", "Resend: 2", "ok"]);
    assert_eq!(desk.core.state(), &State::Pausing);
    let mut n_done = 1;
    while *desk.core.state() == State::Pausing {
        let lines = desk.written();
        assert!(!lines.is_empty() && lines[0].starts_with(&format!("N{} ", n_done + 1)), "{lines:?}");
        n_done += lines.len();
        lines.iter().for_each(|_| {
            desk.hear(&["ok"]);
        });
    }
    assert_eq!((n_done, desk.core.state()), (n_sent, &State::Paused));
    assert!(desk.written().is_empty());
}

#[test]
fn paused_parking_lines_take_the_numbers_of_lines_never_sent() {
    let mut desk = Desk::streaming(20);
    let n_sent = desk.written().len();
    desk.command(Command::Pause);
    (0..n_sent).for_each(|_| {
        desk.hear(&["ok"]);
    });
    desk.command(Command::Park).command(Command::HostLine("G1 Z50"));
    assert_eq!(desk.written(), [format!("N{} G1 Z50", n_sent + 1)]);
    desk.hear(&["ok"]);
    assert_eq!(desk.core.state(), &State::Paused);
    desk.command(Command::Resume).command(Command::HostLine("G1 Z1")).command(Command::Line("G1 X77"));
    assert_eq!(desk.written(), [format!("N{} G1 Z1", n_sent + 2), format!("N{} G1 X77", n_sent + 3)]);
}

#[test]
fn streaming_prompt_is_shown_and_answered() {
    let mut desk = Desk::streaming(5);
    desk.written();
    desk.hear(&["//action:prompt_begin Ready?", "//action:prompt_button Yes", "//action:prompt_button No"]);
    desk.hear(&["//action:prompt_show"]);
    assert!(
        desk.events().iter().any(|e| matches!(e, Event::Prompt(Some(prompt)) if prompt.buttons.len() == 2))
    );
    desk.command(Command::Answer(7));
    assert!(desk.written().is_empty(), "there is no such button");
    desk.command(Command::Answer(1));
    assert_eq!(desk.written(), ["M876 S1"]);
    assert_eq!(desk.events(), [Event::Prompt(None)]);
}

#[test]
fn streaming_noise_without_end_is_no_sign_of_life() {
    let mut desk = Desk::streaming(5);
    desk.written();
    for _ in 0..200 {
        desk.wait(0.5).hear(&["\u{fffd}x\u{fffd}"]);
    }
    assert!(matches!(desk.fault(), Fault::Garbled { .. }));
}

#[test]
fn faulted_nothing_but_messages_follows() {
    let mut desk = Desk::streaming(5);
    desk.hear(&["start"]).written();
    desk.events();
    desk.hear(&["ok", "Resend: 3", "start"]).wait(100.0);
    assert!(desk.written().iter().all(|line| !line.starts_with('N')), "nothing of the job");
    assert!(
        desk.events().iter().all(|e| matches!(e, Event::Message(_) | Event::Secured(Heat::Unknown(None))))
    );
    desk.wait(100.0);
    assert!(desk.written().is_empty());
    assert!(desk.core.handle_command(desk.now, Command::Resume).is_err());
}

/// Paused, on a firmware that watches over its heaters for an hour.
fn guarded() -> Desk {
    let mut profile = crate::profile::builtin("marlin").unwrap();
    profile.firmware.orphan_hold_s = 3600.0;
    let mut desk = Desk { core: Core::new(&profile), now: Instant::default() };
    desk.command(Command::Connect).hear(&["ok"]).written();
    desk.hear(&["Error:Line Number is not Last Line Number+1, Last Line: 0", "Resend: 1", "ok"]);
    desk.command(Command::Begin).command(Command::Pause);
    assert_eq!(desk.core.state(), &State::Paused);
    desk.written();
    desk
}

fn n_renewals(desk: &mut Desk) -> usize {
    desk.written().iter().filter(|line| *line == "M85 S3600").count()
}

#[test]
fn paused_guard_is_set_anew_although_an_answer_was_lost() {
    let mut desk = guarded();
    let mut n = 0;
    for i in 0..720 {
        desk.wait(5.0).hear(&["T:210.00 /210.00 B:60.00 /60.00"]);
        let renewed = n_renewals(&mut desk);
        n += renewed;
        if renewed > 0 && i > 150 {
            desk.hear(&["ok"]);
        }
    }
    assert!((4..=6).contains(&n), "{n}");
}

#[test]
fn paused_guard_does_not_overrun_a_printer_that_takes_nothing() {
    let mut desk = guarded();
    let mut n = 0;
    for _ in 0..24 * 1800 {
        desk.wait(2.0).hear(&["echo:busy: paused for user"]);
        n += n_renewals(&mut desk);
    }
    assert!((5..=14).contains(&n), "{n}");
}
