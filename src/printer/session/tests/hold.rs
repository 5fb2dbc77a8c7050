//! What the operator asks for while a print runs: pauses that leave no trace, stops that are confirmed.

use super::super::super::control::Control;
use super::super::*;
use super::rig::{Rig, Setup, clean, is_same};
use crate::profile::Dialect;
use std::sync::atomic::Ordering;

const ALL: [&str; 8] =
    ["marlin", "marlin1", "klipper", "reprapfirmware", "repetier", "smoothie", "reference", "prusa-mk3s"];

fn ask(rig: &mut Rig, control: Control) {
    let now = rig.now();
    rig.session.control(now, control);
}

/// In the middle of a print, paused, and the nozzle away from the part.
fn paused(setup: Setup, n_laid: usize) -> Rig {
    let name = setup.profile.name.clone();
    let mut rig = Rig::new(setup);
    assert!(rig.run_until(|rig| rig.laid.len() >= n_laid), "{name}");
    ask(&mut rig, Control::Pause);
    assert!(rig.run_until(|rig| *rig.session.core.state() == State::Paused), "{name}");
    wait(&mut rig, 60.0);
    rig
}

/// Klipper takes some two hundred lines before the nozzle has done the first: in a short job nothing is left to pause.
fn long(profile: &str) -> Setup {
    Setup::new(profile, if profile == "klipper" { 10 } else { 4 }, 48)
}

fn wait(rig: &mut Rig, for_s: f64) {
    let until_s = rig.printer.now_s() + for_s;
    rig.run_until(|rig| rig.printer.now_s() >= until_s);
}

/// Moves that a printer may have before it.
fn most_held(rig: &Rig) -> usize {
    let firmware = &rig.setup.profile.firmware;
    match firmware.dialect {
        // Two seconds of moves, and what its buffer takes.
        Dialect::Klipper => 300,
        _ => firmware.planner_moves + firmware.command_slots + firmware.rx_buffer_bytes / 20,
    }
}

fn is_away(rig: &Rig) -> bool {
    rig.printer.summary().position_mm[2] >= 9.0
}

#[test]
fn a_pause_parks_the_nozzle_keeps_the_heat_and_leaves_no_trace() {
    for profile in ALL {
        let setup = long(profile);
        let expected = clean(&setup);
        for n_laid in [3, 60, 100] {
            let mut rig = paused(setup.clone(), n_laid);
            let n_before = rig.laid.len();
            wait(&mut rig, 900.0);
            assert!(rig.events.contains(&PrintEvent::Session(Event::Paused)), "{profile}");
            assert!(is_away(&rig) && rig.printer.summary().hotend_c[1] > 0.0, "{profile} {n_laid}");
            assert_eq!(rig.laid.len(), n_before, "{profile}");
            ask(&mut rig, Control::GoOn);
            rig.ends_as(&expected, &format!("{profile} {n_laid}"));
            assert_eq!(rig.session.stats().n_foreign_commands, 0, "{profile} {n_laid}");
        }
    }
}

#[test]
fn pauses_one_after_the_other_leave_no_trace() {
    for profile in ALL {
        let setup = Setup::new(profile, 2, 48);
        let expected = clean(&setup);
        let mut rig = paused(setup, 5);
        for n_laid in [6, 30, 31, 70] {
            ask(&mut rig, Control::GoOn);
            // Also where the nozzle is just on its way back.
            assert!(rig.run_until(|rig| rig.laid.len() >= n_laid), "{profile}");
            ask(&mut rig, Control::Pause);
            wait(&mut rig, 0.5);
            ask(&mut rig, Control::GoOn);
            wait(&mut rig, 0.2);
            ask(&mut rig, Control::Pause);
            wait(&mut rig, 30.0);
        }
        ask(&mut rig, Control::GoOn);
        rig.ends_as(&expected, profile);
        assert_eq!(rig.session.stats().n_foreign_commands, 0, "{profile}");
    }
}

#[test]
fn a_pause_may_take_the_night_and_a_host_that_dies_in_it_leaves_no_heat() {
    for profile in ["marlin", "marlin1", "klipper", "repetier"] {
        let mut setup = long(profile);
        setup.profile.firmware.orphan_hold_s = 600.0;
        let mut rig = paused(setup, 60);
        wait(&mut rig, 8.0 * 600.0);
        assert_eq!(rig.session.core.state(), &State::Paused, "{profile}");
        assert!(rig.printer.summary().hotend_c[1] > 0.0, "{profile}: while the host lives");
        assert!(!String::from_utf8_lossy(&rig.sent).contains("M85 S0"), "{profile}");
        rig.is_dead = true;
        rig.drain(450.0);
        assert!(rig.printer.summary().hotend_c[1] > 0.0, "{profile}: not at once");
        rig.drain(200.0);
        assert!(rig.printer.summary().hotend_c[1] <= 0.0, "{profile}: the host is gone");
    }
}

#[test]
fn a_pause_longer_than_motors_hold_leaves_no_trace() {
    for profile in ALL {
        let setup = long(profile);
        let expected = clean(&setup);
        let mut rig = paused(setup, 60);
        wait(&mut rig, 3600.0);
        ask(&mut rig, Control::GoOn);
        rig.ends_as(&expected, profile);
    }
}

#[test]
fn a_cable_pulled_in_a_pause_leaves_it_paused_and_no_trace() {
    for profile in ALL {
        let setup = long(profile);
        let expected = clean(&setup);
        let mut rig = paused(setup, 60);
        let now = rig.now();
        rig.session.handle_lost(now);
        let back = now + Duration::from_secs(20);
        rig.drain(20.0);
        rig.session.handle_port(back);
        wait(&mut rig, 100.0);
        let what = format!("{profile}: {:?}", rig.session.end);
        assert_eq!(rig.session.core.state(), &State::Paused, "{what}");
        assert!(is_away(&rig), "{what}");
        ask(&mut rig, Control::GoOn);
        rig.ends_as(&expected, profile);
    }
}

#[test]
fn a_host_that_dies_in_a_pause_is_resumed_without_a_trace() {
    for profile in ALL {
        let setup = Setup::new(profile, 3, 48);
        let expected = clean(&setup);
        let mut rig = paused(setup, 60);
        rig.drain(30.0);
        rig.resume(30.0, false);
        rig.ends_as(&expected, profile);
    }
}

#[test]
fn a_pause_asked_for_while_the_port_is_away_holds_when_it_is_back() {
    for profile in ALL {
        let setup = long(profile);
        let expected = clean(&setup);
        let mut rig = Rig::new(setup.with("disconnect:line=80,for-s=20"));
        assert!(rig.run_until(|rig| matches!(rig.session.stage, Stage::Detached { .. })), "{profile}");
        ask(&mut rig, Control::Pause);
        let n_before = rig.laid.len();
        assert!(rig.run_until(|rig| *rig.session.core.state() == State::Paused), "{profile}");
        wait(&mut rig, 100.0);
        assert!(
            rig.laid.len() <= n_before + most_held(&rig) && is_away(&rig),
            "{profile}: only what the printer had"
        );
        assert!(rig.laid.len() < expected.len(), "{profile}: the job is not done");
        ask(&mut rig, Control::GoOn);
        assert!(matches!(rig.run(), End::Finished), "{profile}");
        assert!(is_same(&rig.laid, &expected), "{profile}");
    }
}

#[test]
fn a_pause_asked_for_before_the_first_line_holds() {
    let mut rig = Rig::new(Setup::new("marlin", 2, 40));
    ask(&mut rig, Control::Pause);
    wait(&mut rig, 100.0);
    assert_eq!((rig.session.core.state(), rig.laid.len()), (&State::Paused, 0), "{:?}", rig.events);
    ask(&mut rig, Control::GoOn);
    assert!(matches!(rig.run(), End::Finished));
}

#[test]
fn a_board_that_dies_in_a_pause_is_noticed() {
    for profile in ["marlin", "marlin1", "repetier"] {
        let mut rig = paused(Setup::new(profile, 3, 48), 60);
        let before_s = rig.printer.now_s();
        rig.is_deaf = true;
        let end = rig.run();
        assert!(matches!(end, End::Faulted(Fault::Silent { .. })), "{profile}: {end:?}");
        assert!(rig.gave_up_s.unwrap() - before_s < 30.0, "{profile}");
        assert!(matches!(rig.session.heat(), Heat::Unknown(_)), "{profile}");
    }
}

#[test]
fn an_emergency_stop_is_confirmed_by_what_the_printer_says() {
    for profile in ALL {
        for n_laid in [0, 60] {
            for pauses in [false, true] {
                let mut rig = if pauses && n_laid > 0 {
                    paused(Setup::new(profile, 3, 48), n_laid)
                } else {
                    let mut rig = Rig::new(Setup::new(profile, 3, 48));
                    rig.run_until(|rig| rig.laid.len() >= n_laid);
                    rig
                };
                let progress = rig.session.core.progress();
                ask(&mut rig, Control::EmergencyStop);
                let (before_s, n_before) = (rig.printer.now_s(), rig.laid.len());
                let end = rig.run();
                let what = format!("{profile} {n_laid} {pauses}: {end:?} {:?}", rig.session.heat());
                assert!(matches!(end, End::Faulted(Fault::EmergencyStop)), "{what}");
                assert!(rig.session.heat().is_safe(), "{what}");
                assert!(rig.printer.now_s() - before_s < 5.0, "{what}");
                assert!(rig.printer.summary().hotend_c[1] <= 0.0, "{what}");
                // Where the word is no emergency to the firmware's receiver, what stands before it in its queue is done first.
                let n_before_it = usize::try_from(progress.n_sent - progress.n_acked).unwrap() + 1;
                assert!(rig.laid.len() <= n_before + n_before_it, "{what}");
            }
        }
    }
}

#[test]
fn a_stop_ends_each_wait_for_a_temperature_where_the_firmware_lets_it() {
    for profile in ["marlin", "reference", "marlin1"] {
        let mut setup = Setup::new(profile, 2, 40);
        setup.job = format!("M140 S100\nM104 S210\nM190 S100\nM109 S210\n{}", setup.job);
        let mut rig = Rig::new(setup);
        let is_heating = |rig: &Rig| rig.printer.summary().hotend_c[1] > 0.0;
        assert!(rig.run_until(is_heating), "{profile}");
        wait(&mut rig, 15.0);
        ask(&mut rig, Control::Stop);
        let before_s = rig.printer.now_s();
        let end = rig.run();
        assert!(matches!(end, End::Cancelled), "{profile}: {end:?} {:?}", rig.events);
        let took_s = rig.printer.now_s() - before_s;
        assert!(took_s < 10.0, "{profile}: {took_s}");
        assert!(rig.printer.summary().hotend_c[1] <= 0.0 && rig.laid.is_empty(), "{profile}");
    }
}

/// Whatever becomes of the host then: heaters-off stands behind the wait in the firmware.
#[test]
fn a_stop_while_it_heats_switches_the_heaters_off_everywhere() {
    for profile in ALL {
        for host_dies in [false, true] {
            // The one is given one line at a time, the other acknowledges a wait as it takes it and has its buffer full of what comes
            // behind: there the firmware's own time-out or the service manager has to (`safe-off`).
            if host_dies && ["reprapfirmware", "repetier"].contains(&profile) {
                continue;
            }
            let mut setup = Setup::new(profile, 2, 40);
            setup.job = format!("M140 S60\nM104 S210\nM109 S210\n{}", setup.job);
            setup.profile.firmware.orphan_hold_s = 3600.0;
            let mut rig = Rig::new(setup);
            assert!(rig.run_until(|rig| rig.printer.summary().hotend_c[1] > 0.0), "{profile}");
            wait(&mut rig, 15.0);
            ask(&mut rig, Control::Stop);
            if host_dies {
                wait(&mut rig, 2.0);
                rig.printer.host_left();
                rig.drain(600.0);
            } else {
                let end = rig.run();
                assert!(matches!(end, End::Cancelled), "{profile}: {end:?}");
            }
            let (hotend_c, bed_c) = (rig.printer.summary().hotend_c[1], rig.printer.summary().bed_c[1]);
            assert!(hotend_c <= 0.0 && bed_c <= 0.0, "{profile} {host_dies}: {hotend_c} {bed_c}");
            assert!(rig.laid.is_empty(), "{profile} {host_dies}");
        }
    }
}

#[test]
fn a_question_of_the_printer_is_told_and_answered() {
    let mut setup = Setup::new("marlin", 2, 40);
    setup.job = setup.job.replace(";LAYER:1", "M0 Look at it");
    let expected = clean(&Setup::new("marlin", 2, 40));
    let mut rig = Rig::new(setup);
    let asks = |event: &PrintEvent| matches!(event, PrintEvent::Session(Event::Prompt(Some(_))));
    assert!(rig.run_until(|rig| rig.events.iter().any(asks)));
    wait(&mut rig, 600.0);
    ask(&mut rig, Control::Answer(0));
    assert!(matches!(rig.run(), End::Finished));
    assert!(is_same(&rig.laid, &expected));
    assert_eq!(rig.printer.summary().repeated_move_lines, 0);
    assert_eq!(rig.session.stats().n_foreign_commands, 0);
}

/// Two layers with somebody to be waited for between them.
fn with_somebody(profile: &str) -> Setup {
    let mut setup = Setup::new(profile, 2, 40);
    setup.job = setup.job.replace(";LAYER:1", "M0 Look at it");
    setup
}

#[test]
fn what_changes_nothing_is_said_to() {
    let setup = Setup::new("marlin", 2, 40);
    let mut rig = Rig::new(setup.clone());
    assert!(rig.run_until(|rig| rig.laid.len() >= 10));
    for control in [Control::GoOn, Control::Answer(3)] {
        ask(&mut rig, control);
        wait(&mut rig, 0.1);
        assert!(rig.events.contains(&PrintEvent::NothingToDo(control)), "{control:?}");
        assert!(!rig.events.contains(&PrintEvent::Asked(control)), "{control:?}");
    }
    ask(&mut rig, Control::Pause);
    assert!(rig.run_until(|rig| *rig.session.core.state() == State::Paused));
    ask(&mut rig, Control::Pause);
    ask(&mut rig, Control::GoOn);
    rig.ends_as(&clean(&setup), "as if nothing had been asked");
    assert!(rig.events.contains(&PrintEvent::NothingToDo(Control::Pause)));
    assert!(rig.events.contains(&PrintEvent::Asked(Control::GoOn)));
}

#[test]
fn the_firmware_s_time_out_is_lifted_while_it_waits_for_somebody_and_watches_before_and_behind() {
    for (profile, faults) in [("marlin", &[][..]), ("marlin1", &[]), ("marlin", &["lost-ok:rate=0.05"])] {
        let what = format!("{profile} {faults:?}");
        let mut setup = faults.iter().fold(with_somebody(profile), |setup, fault| setup.with(fault));
        setup.job = setup.job.replace("M0", "M0 S300");
        setup.profile.firmware.orphan_hold_s = 60.0;
        let mut rig = Rig::new(setup);
        assert!(rig.run_until(|rig| n_told(rig, &Event::Paused) > 0), "{what}");
        let watched_before = String::from_utf8_lossy(&rig.sent).contains("M85 S60*");
        assert!(watched_before, "{what}");
        assert!(rig.run_until(|rig| rig.laid.len() >= 60), "{what}: nobody hurried");
        rig.drain(30.0);
        assert!(rig.printer.summary().hotend_c[1] > 0.0, "{what}: there may be a resume");
        // The host has died.
        rig.drain(90.0);
        assert!(rig.printer.summary().hotend_c[1] <= 0.0, "{what}: nobody watches");
    }
}

fn n_told(rig: &Rig, event: &Event) -> usize {
    rig.events.iter().filter(|e| **e == PrintEvent::Session(event.clone())).count()
}

#[test]
fn going_on_from_the_keys_or_at_the_printer_is_heard_and_leaves_no_doubt() {
    // Marlin 1.1 as it is mostly built hears nothing while it waits.
    for (profile, by_keys) in [("marlin", true), ("marlin", false), ("marlin1", false)] {
        let what = format!("{profile} {by_keys}");
        let mut setup = with_somebody(profile);
        if !by_keys {
            // As if somebody pressed the knob then.
            setup.job = setup.job.replace("M0", "M0 S100");
        }
        let mut rig = Rig::new(setup);
        assert!(rig.run_until(|rig| n_told(rig, &Event::Paused) > 0), "{what}");
        wait(&mut rig, 60.0);
        assert_eq!(n_told(&rig, &Event::Resumed), 0, "{what}");
        if by_keys {
            ask(&mut rig, Control::GoOn);
        }
        let end = rig.run();
        assert!(matches!(end, End::Finished), "{what}: {end:?}");
        assert_eq!(n_told(&rig, &Event::Resumed), 1, "{what}");
        assert_eq!(rig.session.stats().n_foreign_commands, 0, "{what}");
        assert!(is_same(&rig.laid, &clean(&Setup::new(profile, 2, 40))), "{what}");
    }
}

#[test]
fn a_printer_that_waits_for_its_user_is_told_to_go_on_by_whoever_resumes() {
    let mut rig = Rig::new(with_somebody("marlin"));
    assert!(rig.run_until(|rig| n_told(rig, &Event::Paused) > 0));
    rig.drain(30.0);
    rig.resume(30.0, false);
    rig.events.clear();
    assert!(rig.run_until(|rig| n_told(rig, &Event::Paused) > 0), "it says so");
    wait(&mut rig, 60.0);
    assert_eq!(n_told(&rig, &Event::Paused), 1, "once");
    ask(&mut rig, Control::GoOn);
    let end = rig.run();
    assert!(matches!(end, End::Finished), "{end:?}");
    assert!(is_same(&rig.laid, &clean(&Setup::new("marlin", 2, 40))));
}

#[test]
fn a_stop_while_the_printer_is_asked_where_it_is_switches_it_off() {
    for profile in ALL {
        let mut rig = Rig::new(Setup::new(profile, 3, 48).with("disconnect:line=80,for-s=20"));
        assert!(rig.run_until(|rig| matches!(rig.session.stage, Stage::Detached { .. })), "{profile}");
        rig.drain(30.0);
        rig.reconnect();
        ask(&mut rig, Control::Stop);
        let end = rig.run();
        assert!(matches!(end, End::Cancelled), "{profile}: {end:?}");
        assert!(matches!(rig.session.heat(), Heat::Off(_)), "{profile}: {:?}", rig.session.heat());
        assert!(rig.printer.summary().hotend_c[1] <= 0.0, "{profile}");
    }
}

#[test]
fn a_stop_that_nobody_confirms_is_no_proof() {
    for goes in [false, true] {
        let mut rig = Rig::new(Setup::new("marlin", 3, 48).with("disconnect:line=80,for-s=20"));
        assert!(rig.run_until(|rig| matches!(rig.session.stage, Stage::Detached { .. })));
        rig.drain(30.0);
        rig.reconnect();
        rig.is_deaf = true;
        ask(&mut rig, Control::Stop);
        rig.is_unplugged = goes;
        let end = rig.run();
        assert!(matches!(end, End::CancelUnconfirmed), "{goes}: {end:?}");
        assert!(matches!(rig.session.heat(), Heat::Unknown(_)), "{:?}", rig.session.heat());
        let heat = rig.session.heat().clone();
        let told = crate::printer::Error::Cancelled { heat };
        assert!(!told.to_string().contains("heaters are off;"), "{told}");
        assert_eq!(told.code(), "printer.cancel_unconfirmed");
        assert!(!rig.records.iter().any(|(_, record)| matches!(record, Record::End(Ending::Cancelled))));
    }
}

#[test]
fn a_stop_of_a_print_tells_that_heaters_off_was_executed() {
    for profile in ALL {
        let mut rig = Rig::new(Setup::new(profile, 3, 48));
        assert!(rig.run_until(|rig| rig.laid.len() >= 60), "{profile}");
        ask(&mut rig, Control::Stop);
        let end = rig.run();
        assert!(matches!(end, End::Cancelled), "{profile}: {end:?} {:?}", rig.events);
        assert_eq!(rig.session.heat(), &Heat::Obeyed, "{profile}");
        assert!(rig.printer.summary().hotend_c[1] <= 0.0, "{profile}");
    }
}

#[test]
fn a_print_that_cannot_be_resumed_leaves_no_heat() {
    let mut setup = Setup::new("marlin", 3, 48);
    setup.profile.scripts.recovery.clear();
    let mut rig = Rig::new(setup.with("reset:line=80"));
    assert!(matches!(rig.run(), End::Faulted(Fault::FirmwareReset)));
    // Somebody has heated it again meanwhile.
    rig.printer.receive(b"M104 S200\n");
    rig.drain(60.0);
    rig.resume(60.0, true);
    assert!(matches!(rig.run(), End::Refused(_)));
    assert!(matches!(rig.session.heat(), Heat::Off(_)), "{:?}", rig.session.heat());
    assert!(rig.printer.summary().hotend_c[1] <= 0.0);
}

#[test]
fn a_print_that_needs_consent_says_how_warm_it_is() {
    let mut rig = Rig::new(Setup::new("marlin", 3, 48));
    assert!(rig.run_until(|rig| rig.laid.len() >= 60));
    rig.printer.receive(b"\nG91\nG1 X5\n");
    rig.drain(30.0);
    rig.resume(30.0, false);
    let end = rig.run();
    assert!(matches!(end, End::NeedsConsent(_)), "{end:?}");
    assert!(matches!(rig.session.heat(), Heat::On(_)), "{:?}", rig.session.heat());
}

#[test]
fn a_job_that_is_gone_when_the_cable_is_back_leaves_no_heat() {
    for profile in ALL {
        let mut rig = Rig::new(Setup::new(profile, 3, 48).with("disconnect:line=80,for-s=20"));
        assert!(rig.run_until(|rig| matches!(rig.session.stage, Stage::Detached { .. })), "{profile}");
        rig.is_job_gone.store(true, Ordering::Relaxed);
        let end = rig.run();
        let End::Job(lost) = &end else { panic!("{profile}: {end:?}") };
        assert!(matches!(lost.heat, Heat::Off(_)), "{profile}: {lost}");
        assert!(rig.printer.summary().hotend_c[1] <= 0.0, "{profile}");
        assert!(matches!(rig.log().end, Some(Ending::Faulted(_))), "{profile}");
    }
}

#[test]
fn a_cancel_that_does_not_end_well_stays_one() {
    for profile in ALL {
        let mut rig = paused(long(profile), 60);
        ask(&mut rig, Control::GoOn);
        assert!(rig.run_until(|rig| rig.laid.len() >= 70), "{profile}");
        ask(&mut rig, Control::Stop);
        let n_sent = rig.session.core.progress().n_sent;
        let mut out = Vec::new();
        rig.session.transmit(&mut out);
        assert!(out.windows(4).any(|word| word == b"M410"), "{profile}");
        assert!(rig.session.core.progress().n_sent > n_sent, "{profile}");
        rig.is_unplugged = true;
        let end = rig.run();
        assert!(matches!(end, End::Faulted(Fault::LinkLost)), "{profile}: {end:?}");
        let log = rig.log();
        assert_eq!(log.end, Some(Ending::Cancelled), "{profile}");
        assert!(log.progress.number <= n_sent, "{profile}: none of the lines behind the job is counted");
    }
}

#[test]
fn a_reset_in_a_pause_is_recovered_from_without_a_trace() {
    for profile in ["marlin", "reprapfirmware", "smoothie", "repetier"] {
        let setup = Setup::new(profile, 2, 120);
        let expected = clean(&setup);
        let mut rig = paused(setup, 60);
        wait(&mut rig, 300.0);
        rig.printer.switch_off_and_on();
        assert!(matches!(rig.run(), End::Faulted(Fault::FirmwareReset)), "{profile}");
        let n_before = rig.laid.len();
        rig.resume(0.0, true);
        let end = rig.run();
        assert!(matches!(end, End::Finished), "{profile}: {end:?}");
        assert!(is_same(&rig.laid[n_before..], &expected[n_before..]), "{profile} {n_before}");
    }
}

#[test]
fn a_power_cut_in_a_pause_that_takes_the_host_as_well_is_recovered_from() {
    for profile in ["marlin", "reprapfirmware", "smoothie", "repetier"] {
        for lost_s in [0.0, 0.9] {
            let setup = Setup::new(profile, 2, 120);
            let expected = clean(&setup);
            let mut rig = paused(setup, 60);
            rig.printer.switch_off_and_on();
            rig.drain(10.0);
            let n_before = rig.laid.len();
            rig.resume(10.0 + lost_s, true);
            let end = rig.run();
            assert!(matches!(end, End::Finished), "{profile}: {end:?}");
            assert!(is_same(&rig.laid[n_before..], &expected[n_before..]), "{profile} {n_before}");
        }
    }
}

#[test]
fn a_nozzle_that_waits_where_the_firmware_cannot_go_lower_is_no_place_to_go_on_from() {
    for profile in ["marlin1", "prusa-mk3s"] {
        let mut rig = paused(Setup::new(profile, 2, 120), 60);
        wait(&mut rig, 300.0);
        rig.printer.switch_off_and_on();
        assert!(matches!(rig.run(), End::Faulted(Fault::FirmwareReset)), "{profile}");
        rig.resume(0.0, true);
        let end = rig.run();
        assert!(matches!(end, End::Refused(Refusal::HeightUnknown { .. })), "{profile}: {end:?}");
    }
}

#[test]
fn only_words_about_pauses_tell_who_parks() {
    use super::super::hold::parks_itself;
    assert_eq!(parks_itself("paused filament_runout 0"), Some(true));
    assert_eq!(parks_itself("prompt_begin Ready?"), None);
    assert_eq!(parks_itself("notification 12 %"), None);
    assert_eq!(parks_itself("resumed"), Some(false));
}

#[test]
fn a_job_that_leaves_its_heaters_on_is_told_and_they_go_off_by_themselves() {
    for profile in ["marlin", "klipper"] {
        let mut setup = Setup::new(profile, 1, 3);
        setup.job = "M104 S200\nG28\nG1 X10 F3000\n".to_owned();
        let hold_s = setup.profile.firmware.orphan_hold_s;
        let mut rig = Rig::new(setup);
        assert!(matches!(rig.run(), End::Finished), "{profile}");
        let left = PrintEvent::LeftHot { hotend_c: 200.0, bed_c: 0.0 };
        assert!(rig.events.contains(&left), "{profile}: {:?}", rig.events);
        assert!(rig.printer.summary().heaters_on, "{profile}");
        rig.printer.host_left();
        rig.drain(hold_s + 60.0);
        assert!(!rig.printer.summary().heaters_on, "{profile}");
    }
}
