//! `<state>_<event>_<result>`.

use super::super::*;
use super::desk::Desk;
use super::firmware::{Firmware, Setup};
use super::pair::{Pair, job, profile_for};
use std::time::Duration;

const REFUSED_0: [&str; 3] = ["Error:Line Number is not Last Line Number+1, Last Line: 0", "Resend: 1", "ok"];

#[test]
fn disconnected_line_is_refused_and_nothing_changes() {
    let mut desk = Desk::disconnected();
    let refused = desk.core.handle_command(desk.now, Command::Line("G1")).unwrap_err();
    assert_eq!(refused.to_string(), "sending a line is not possible while disconnected");
    assert!(desk.core.handle_command(desk.now, Command::EmergencyStop).is_err());
    assert_eq!((desk.written().len(), desk.core.state()), (0, &State::Disconnected));
}

#[test]
fn handshake_start_greets_again() {
    let mut desk = Desk::greeting();
    desk.hear(&["start", "Marlin 2.1"]);
    assert_eq!(desk.written(), ["N0 M110 N0"]);
}

#[test]
fn handshake_wrong_last_line_greets_again() {
    let mut desk = Desk::greeting();
    desk.hear(&["ok"]).written();
    desk.hear(&["Error:Line Number is not Last Line Number+1, Last Line: 77", "Resend: 78", "ok"]);
    assert_eq!(desk.written(), ["N0 M110 N0"]);
}

#[test]
fn handshake_silence_faults_no_answer() {
    let mut desk = Desk::greeting();
    desk.wait(60.0);
    assert_eq!(desk.fault(), &Fault::NoAnswer { is_garbled: false });
    assert!(desk.now.since(Instant::default()) < Duration::from_secs(20));
    desk.written();
}

#[test]
fn handshake_noise_faults_with_the_baud_rate_in_mind() {
    let mut desk = Desk::greeting();
    desk.hear(&["\u{fffd}\u{fffd}x"]).wait(60.0);
    assert_eq!(desk.fault(), &Fault::NoAnswer { is_garbled: true });
    assert!(desk.fault().next_step().contains("baud"));
}

#[test]
fn handshake_unchecked_numbers_fault() {
    let mut desk = Desk::greeting();
    for _ in 0..100 {
        desk.hear(&["ok"]).written();
        desk.wait(1.6);
        if matches!(desk.core.state(), State::Faulted(_)) {
            break;
        }
    }
    assert_eq!(desk.fault(), &Fault::NoLineNumbers);
}

#[test]
fn handshake_busy_waits_on() {
    let mut desk = Desk::greeting();
    for _ in 0..60 {
        desk.hear(&["echo:busy: processing"]).wait(2.0);
    }
    assert!(matches!(desk.core.state(), State::Handshake(_)));
}

#[test]
fn handshake_reset_on_open_awaits_start() {
    let mut profile = profile_for(&Setup::default());
    profile.firmware.reset_on_open = true;
    let mut desk = Desk { core: Core::new(&profile), now: Instant::default() };
    desk.command(Command::Connect);
    assert!(desk.written().is_empty());
    desk.hear(&["start"]);
    assert_eq!(desk.written(), ["N0 M110 N0"]);
}

#[test]
fn handshake_cancel_ends_idle() {
    let mut desk = Desk::greeting();
    desk.command(Command::Cancel);
    assert_eq!(desk.events(), [Event::Cancelled]);
}

#[test]
fn idle_begin_asks_for_temperature_reports() {
    let mut profile = profile_for(&Setup::default());
    profile.firmware.temperature_report_s = 1.5;
    let mut desk = Desk { core: Core::new(&profile), now: Instant::default() };
    desk.command(Command::Connect).hear(&["ok"]).hear(&REFUSED_0);
    desk.written();
    desk.command(Command::Begin);
    assert_eq!(desk.written(), ["N1 M155 S2"]);
}

#[test]
fn streaming_ok_sends_the_next_line() {
    let mut desk = Desk::streaming(20);
    let first = desk.written();
    assert!(first[0].eq("N1 G1 X0") && first.iter().map(|l| l.len() + 1).sum::<usize>() <= 108);
    desk.hear(&["ok"]);
    assert_eq!(desk.written().len(), 1);
    assert_eq!(desk.core.progress().n_lines_done, 1);
}

#[test]
fn streaming_resend_rewinds_to_line() {
    let mut desk = Desk::streaming(20);
    desk.written();
    desk.hear(&["ok", "Error:checksum mismatch, Last Line: 1", "Resend: 2", "ok"]);
    let again = desk.written();
    assert_eq!(again.len(), 1, "alone until it is acknowledged: {again:?}");
    assert!(again[0].eq("N2 G1 X1"));
    desk.hear(&["ok"]);
    assert!(desk.written()[0].eq("N3 G1 X2"));
    assert_eq!(desk.core.stats().n_resends, 1);
}

#[test]
fn streaming_ok_after_a_resend_acknowledges_nothing() {
    let mut desk = Desk::streaming(20);
    desk.written();
    desk.hear(&["Error:checksum mismatch, Last Line: 0", "Resend: 1", " T:20.0 /0.0", "ok"]);
    assert_eq!(desk.core.progress().n_lines_done, 0);
}

#[test]
fn streaming_oks_of_accepted_lines_come_after_a_resend() {
    let mut desk = Desk::streaming(20);
    desk.written();
    // Lines 1 and 2 are in the queue when 3 is refused.
    desk.hear(&["Error:checksum mismatch, Last Line: 2", "Resend: 3", "ok"]);
    assert!(desk.written()[0].starts_with("N3 "));
    desk.hear(&["ok", "ok"]);
    assert_eq!((desk.core.progress().n_lines_done, desk.written().len()), (2, 0));
    desk.hear(&["ok"]);
    assert!(desk.written()[0].starts_with("N4 "));
}

#[test]
fn streaming_echo_of_a_resend_sends_the_line_once_more() {
    let mut desk = Desk::streaming(20);
    desk.written();
    desk.hear(&["Error:checksum mismatch, Last Line: 0", "Resend: 1", "ok"]);
    assert_eq!(desk.written().len(), 1);
    desk.hear(&REFUSED_0);
    assert!(desk.written()[0].starts_with("N1 "));
    assert_eq!((desk.core.stats().n_resends, desk.core.stats().n_echoes), (1, 1));
}

#[test]
fn streaming_resend_that_nothing_vouches_for_asks() {
    let mut desk = Desk::streaming(20);
    desk.written();
    desk.hear(&["ok", "ok", "Resend: 1", "ok"]);
    assert!(desk.written()[0].ends_with(" M105"), "asks, and sends no lines");
    desk.hear(&["Error:Line Number is not Last Line Number+1, Last Line: 7", "Resend: 3", "ok"]);
    assert_eq!(desk.core.stats().n_doubtful_resends, 2);
}

#[test]
fn streaming_refusal_without_resend_asks() {
    let mut desk = Desk::streaming(20);
    desk.written();
    desk.hear(&["Error:checksum mismatch, Last Line: 0", "ok"]);
    assert_eq!(desk.core.progress().n_lines_done, 0);
    assert!(desk.written()[0].ends_with(" M105"));
}

#[test]
fn streaming_foreign_command_acknowledges_nothing_and_asks() {
    let mut desk = Desk::streaming(20);
    desk.written();
    desk.hear(&["echo:Unknown command: \"O1 G1 X0*98\"", "ok"]);
    assert_eq!(desk.core.progress().n_lines_done, 0);
    assert!(desk.written()[0].ends_with(" M105"));
}

#[test]
fn streaming_unknown_command_of_the_job_is_acknowledged() {
    let mut desk = Desk::streaming(0);
    desk.command(Command::Line("FOO")).written();
    desk.hear(&["echo:Unknown command: \"FOO\"", "ok"]);
    assert_eq!(desk.core.progress().n_lines_done, 1);
}

#[test]
fn streaming_advanced_ok_without_number_is_not_ours() {
    let mut desk = Desk::streaming(20);
    desk.written();
    desk.hear(&["ok N1 P15 B3"]);
    assert_eq!(desk.core.progress().n_lines_done, 1);
    desk.hear(&["ok P15 B3"]);
    assert_eq!(desk.core.progress().n_lines_done, 1);
    assert!(desk.written().last().unwrap().ends_with(" M105"));
}

#[test]
fn streaming_advanced_ok_makes_up_for_lost_ones() {
    let mut desk = Desk::streaming(20);
    assert!(desk.written().len() >= 3);
    desk.hear(&["ok N3 P15 B3"]);
    assert_eq!(desk.core.progress().n_lines_done, 3);
    desk.hear(&["ok N3 P15 B3", "ok N900 P15 B3"]);
    assert_eq!(desk.core.progress().n_lines_done, 3);
}

#[test]
fn streaming_lost_oks_are_found_within_two_seconds() {
    let mut desk = Desk::streaming(20);
    let n_sent = desk.written().len();
    desk.wait(1.6);
    assert!(desk.written()[0].ends_with(" M105"));
    let last = format!("Error:Line Number is not Last Line Number+1, Last Line: {n_sent}");
    desk.hear(&[&last, &format!("Resend: {}", n_sent + 1), "ok"]).wait(0.01);
    assert_eq!(desk.written(), ["M105"], "it has all lines, but may still be at them");
    assert_eq!(desk.core.progress().n_lines_done, 0);
    desk.hear(&["ok T:20.00 /0.00 B:20.00 /0.00 @:0 B@:0"]);
    assert_eq!(desk.core.progress().n_lines_done, n_sent as u64);
    assert!(desk.events().contains(&Event::Recovered(Recovery::LostOk { count: n_sent as u64 })));
    assert!(!desk.written().is_empty(), "goes on");
    assert!(desk.now.since(Instant::default()) < Duration::from_secs(2));
}

#[test]
fn streaming_wait_asks_at_once() {
    let mut desk = Desk::streaming(20);
    desk.written();
    desk.hear(&["wait"]);
    assert!(desk.written()[0].ends_with(" M105"));
}

#[test]
fn streaming_silence_faults() {
    let mut desk = Desk::streaming(20);
    desk.written();
    desk.wait(100.0);
    assert_eq!(desk.fault(), &Fault::Silent { after: Duration::from_secs_f64(22.5) });
}

#[test]
fn streaming_slow_command_is_not_taken_for_silence() {
    let mut desk = Desk::streaming(0);
    desk.command(Command::Line("M109 S210")).written();
    desk.wait(600.0);
    assert_eq!(desk.core.state(), &State::Streaming);
    desk.wait(1300.0);
    assert!(matches!(desk.fault(), Fault::Silent { .. } | Fault::CommandTimeout { .. }));
}

#[test]
fn streaming_silence_after_busy_is_found_out_in_a_slow_command() {
    let mut desk = Desk::streaming(0);
    desk.command(Command::Line("G28")).written();
    desk.wait(1.0).hear(&["echo:busy: processing"]).wait(100.0);
    assert!(matches!(desk.fault(), Fault::Silent { .. }));
}

#[test]
fn streaming_busy_for_ever_faults_with_the_command_named() {
    let mut desk = Desk::streaming(0);
    desk.command(Command::Line("G28")).written();
    for _ in 0..1000 {
        desk.hear(&["echo:busy: processing"]).wait(2.0);
        if matches!(desk.core.state(), State::Faulted(_)) {
            break;
        }
    }
    let Fault::CommandTimeout { command, after } = desk.fault() else { panic!("{:?}", desk.fault()) };
    assert_eq!((command.as_str(), after.as_secs()), ("G28", 1800));
}

#[test]
fn streaming_waiting_for_the_user_never_faults() {
    let mut desk = Desk::streaming(0);
    desk.command(Command::Line("M600")).written();
    for _ in 0..20_000 {
        desk.hear(&["echo:busy: paused for user"]).wait(2.0);
    }
    assert_eq!(desk.core.state(), &State::Streaming);
}

#[test]
fn streaming_start_is_a_reset_and_faults() {
    let mut desk = Desk::streaming(5);
    desk.written();
    desk.hear(&["start"]);
    assert_eq!(desk.fault(), &Fault::FirmwareReset);
    assert!(desk.events().contains(&Event::Faulted(Fault::FirmwareReset)));
    desk.assert_heaters_off();
}

#[test]
fn streaming_thermal_fault_faults() {
    let mut desk = Desk::streaming(5);
    desk.written();
    desk.hear(&[
        "Error:Thermal Runaway, system stopped! Heater_ID: 0",
        "Error:Printer halted. kill() called!",
    ]);
    assert!(desk.fault().to_string().contains("Thermal Runaway"));
    desk.assert_heaters_off();
}

#[test]
fn streaming_disconnect_faults_and_writes_nothing() {
    let mut desk = Desk::streaming(5);
    desk.written();
    desk.core.handle_disconnect(desk.now);
    assert_eq!(desk.fault(), &Fault::LinkLost);
    assert!(desk.written().is_empty());
    assert!(desk.fault().to_string().contains("heaters are on is unknown"));
}

#[test]
fn streaming_endless_refusal_faults() {
    let mut desk = Desk::streaming(5);
    desk.written();
    for _ in 0..100 {
        desk.hear(&["Error:checksum mismatch, Last Line: 0", "Resend: 1", "ok"]).written();
    }
    assert!(matches!(desk.fault(), Fault::ResendLimit { line: 1, .. }));
    desk.written();
}

#[test]
fn streaming_line_never_sent_asked_for_faults_after_asking_again() {
    let mut desk = Desk::streaming(5);
    desk.written();
    for n_asked in 1.. {
        desk.hear(&["Error:checksum mismatch, Last Line: 499", "Resend: 500", "ok"]).written();
        if let State::Faulted(fault) = desk.core.state() {
            assert!(matches!(fault, Fault::LineUnavailable { asked: 500, .. }) && n_asked > 2);
            return;
        }
        assert!(n_asked < 10);
    }
}

#[test]
fn streaming_actions_of_the_printer_pause_resume_and_cancel() {
    let mut desk = Desk::streaming(20);
    desk.written();
    desk.hear(&["//action:pause"]);
    assert_eq!(desk.core.state(), &State::Pausing);
    desk.hear(&["//action:resume"]);
    assert_eq!(desk.core.state(), &State::Streaming);
    desk.hear(&["//action:cancel"]);
    assert_eq!(desk.core.state(), &State::Cancelling);
    desk.hear(&["//action:poweroff"]);
    assert!(desk.events().contains(&Event::Action("poweroff".to_owned())));
}

#[test]
fn streaming_cancel_stops_and_brings_heaters_off_across() {
    let mut pair = Pair::new(Setup { command_time: Duration::from_millis(50), ..Setup::default() }, job(500));
    while pair.moves().len() < 20 {
        assert!(pair.step());
    }
    pair.core.handle_command(pair.now, Command::Cancel).unwrap();
    pair.run();
    assert_eq!(pair.end(), Some(&Event::Cancelled));
    assert!(pair.moves().len() < 40, "only what the firmware held was still executed");
    for line in ["M410", "M104 S0", "M140 S0"] {
        assert!(pair.firmware.executed.iter().any(|c| c == line), "{line} {:?}", pair.firmware.executed);
    }
}

#[test]
fn streaming_cancel_while_heating_ends_the_heating() {
    let mut pair = Pair::new(Setup::default(), vec!["M109 S1500".to_owned()]);
    for _ in 0..20 {
        pair.step();
    }
    let before = pair.now;
    pair.core.handle_command(pair.now, Command::Cancel).unwrap();
    pair.run();
    assert_eq!(pair.end(), Some(&Event::Cancelled));
    assert!(pair.now.since(before) < Duration::from_secs(10));
}

#[test]
fn cancelling_dead_firmware_faults_in_time() {
    let mut pair = Pair::new(Setup::default(), job(5000));
    while pair.moves().len() < 20 {
        assert!(pair.step());
    }
    pair.firmware.is_dead = true;
    pair.core.handle_command(pair.now, Command::Cancel).unwrap();
    let before = pair.now;
    pair.run();
    assert!(matches!(pair.end(), Some(Event::Faulted(Fault::Silent { .. }))));
    assert!(pair.now.since(before) < Duration::from_secs(30));
}

#[test]
fn finishing_last_job_line_is_followed_by_a_numbered_one() {
    let mut desk = Desk::streaming(1);
    desk.command(Command::EndOfJob);
    let lines = desk.written();
    assert!(lines[0].eq("N1 G1 X0") && lines[1].eq("N2 M400"), "{lines:?}");
}

#[test]
fn finishing_is_over_when_the_firmware_names_the_last_line() {
    let mut desk = Desk::finishing();
    assert!(!desk.events().contains(&Event::Finished));
    desk.hear(&["Error:Line Number is not Last Line Number+1, Last Line: 2", "Resend: 3", "ok"]);
    assert_eq!(desk.events(), [Event::Finished]);
    assert_eq!(desk.core.state(), &State::Idle);
}

#[test]
fn finishing_lines_lost_at_the_end_are_sent_again() {
    let mut desk = Desk::finishing();
    desk.hear(&["Error:Line Number is not Last Line Number+1, Last Line: 0", "Resend: 1", "ok"]);
    assert!(desk.written()[0].eq("N1 G1 X0"));
    assert_eq!(desk.core.state(), &State::Finishing);
}

#[test]
fn finishing_waits_for_the_last_moves() {
    let setup = Setup { command_time: Duration::from_secs(20), ..Setup::default() };
    let mut pair = Pair::new(setup, job(10));
    pair.run();
    assert_eq!(pair.end(), Some(&Event::Finished));
    let executed = &pair.firmware.executed;
    let end = executed.iter().position(|command| command == "M400").unwrap();
    assert!(executed[end + 1..].iter().all(|command| command == "M105"), "only questions behind it");
}

#[test]
fn streaming_dead_firmware_is_found_out() {
    let mut pair = Pair::new(Setup::default(), job(5000));
    while pair.moves().len() < 20 {
        assert!(pair.step());
    }
    pair.firmware.is_dead = true;
    pair.run();
    assert!(matches!(pair.end(), Some(Event::Faulted(Fault::Silent { .. }))));
}

#[test]
fn unnumbered_firmware_survives_lost_oks() {
    let mut profile = profile_for(&Setup::default());
    profile.firmware.line_numbers = false;
    // One line at a time.
    profile.firmware.rx_buffer_bytes = 20;
    let mut desk = Desk { core: Core::new(&profile), now: Instant::default() };
    desk.command(Command::Connect).hear(&["ok T:20.0 /0.0 B:20.0 /0.0"]);
    desk.written();
    desk.command(Command::Begin).command(Command::Line("G1 X1")).command(Command::Line("G1 X2"));
    assert_eq!(desk.written(), ["G1 X1"]);
    desk.hear(&["ok"]);
    assert_eq!(desk.written(), ["G1 X2"]);
    desk.wait(1.6);
    assert_eq!(desk.written(), ["M105"]);
    desk.hear(&["ok T:20.0 /0.0 B:20.0 /0.0"]);
    assert_eq!(desk.core.progress().n_lines_done, 2);
    desk.command(Command::EndOfJob);
    assert_eq!(desk.written(), ["M400"]);
    desk.hear(&["ok"]);
    assert_eq!(desk.written(), ["M105"]);
    desk.hear(&["ok T:20.0 /0.0 B:20.0 /0.0"]);
    assert!(desk.events().contains(&Event::Finished));
}

#[test]
fn every_fault_has_a_code_and_a_next_step() {
    let faults = [
        Fault::LinkLost,
        Fault::NoAnswer { is_garbled: true },
        Fault::Echo,
        Fault::NoLineNumbers,
        Fault::LostPlace { why: "x".to_owned() },
        Fault::EmergencyStop,
        Fault::Garbled { after: Duration::from_secs(3) },
        Fault::FirmwareReset,
        Fault::Halted { text: "x".to_owned() },
        Fault::CommandRefused { text: "x".to_owned() },
        Fault::Silent { after: Duration::from_secs(3) },
        Fault::CommandTimeout { command: "G28".to_owned(), after: Duration::from_secs(3) },
        Fault::ResendLimit { line: 3, tries: 4 },
        Fault::LineUnavailable { asked: 3, oldest: 4, newest: 5 },
    ];
    let mut codes: Vec<_> = faults.iter().map(Fault::code).collect();
    codes.sort_unstable();
    codes.dedup();
    assert_eq!(codes.len(), faults.len());
    for fault in &faults {
        assert!(fault.code().starts_with("printer."));
        assert!(!fault.next_step().is_empty() && !fault.to_string().ends_with('.'));
    }
}

/// A firmware that says anything at all.
fn any_line() -> impl proptest::strategy::Strategy<Value = String> {
    use proptest::prelude::*;
    prop_oneof![
        Just("ok".to_owned()),
        (0..40_u64, 0..9_u32).prop_map(|(n, b)| format!("ok N{n} P15 B{b}")),
        (0..40_u64).prop_map(|n| format!("Resend: {n}")),
        (0..40_u64).prop_map(|n| format!("Error:checksum mismatch, Last Line: {n}")),
        (0..40_u64).prop_map(|n| format!(
            "Error:Line Number is not Last Line Number+1, Last Line: {n}\nResend: {}\nok",
            n + 1
        )),
        Just("Error:x Last Line: 18446744073709551615\nResend: 18446744073709551615".to_owned()),
        Just("echo:busy: processing".to_owned()),
        Just("wait".to_owned()),
        Just("echo:Unknown command: \"G1\"\nok".to_owned()),
        Just("//action:cancel".to_owned()),
        Just("//action:pause".to_owned()),
        Just("//action:resume".to_owned()),
        "\\PC{0,30}",
    ]
}

proptest::proptest! {
    #[test]
    fn any_answers_leave_the_core_sound(
        answers in proptest::collection::vec((any_line(), 0..4000_u64), 0..120),
        numbered in proptest::bool::ANY,
    ) {
        let mut profile = profile_for(&Setup::default());
        profile.firmware.line_numbers = numbered;
        let mut core = Core::new(&profile);
        let mut now = Instant::default();
        core.handle_command(now, Command::Connect).unwrap();
        for (answer, wait_ms) in answers {
            for line in answer.lines() {
                core.handle_line(now, line);
                while core.poll_transmit().is_some() {}
                while core.poll_event().is_some() {}
            }
            if *core.state() == State::Idle {
                core.handle_command(now, Command::Begin).unwrap();
            }
            while core.wants_line() {
                core.handle_command(now, Command::Line("G1 X1 Y2 E3")).unwrap();
            }
            while core.poll_transmit().is_some() {}
            now = now + Duration::from_millis(wait_ms);
            core.handle_timeout(now);
            while core.poll_transmit().is_some() {}
        }
    }

    #[test]
    fn any_bytes_leave_the_core_sound(chunks in proptest::collection::vec(proptest::collection::vec(0_u8.., 0..60), 0..40)) {
        let mut desk = Desk::streaming(60);
        let mut splitter = LineSplitter::default();
        for chunk in chunks {
            splitter.feed(&chunk, |line| desk.core.handle_line(desk.now, line));
            desk.written();
            desk.wait(0.3);
        }
    }

    #[test]
    fn any_bytes_in_the_middle_of_a_job_do_no_harm(seed in 0..1000_u64, noise in "[a-zA-Z:0-9 ]{0,30}") {
        let mut pair = Pair::new(Setup { seed, ..Setup::default() }, job(60));
        while pair.moves().len() < 20 {
            pair.step();
        }
        // Words that are no words of the protocol.
        pair.core.handle_line(pair.now, &format!("x{noise}"));
        pair.run();
        proptest::prop_assert_eq!(pair.moves(), job(60));
    }
}

#[test]
fn the_test_firmware_overflows_when_it_is_overrun() {
    let mut firmware = Firmware::new(Setup::default());
    firmware.receive(&[b'x'; 200]);
    assert_eq!(firmware.n_overflows, 1);
}
