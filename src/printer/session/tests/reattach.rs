//! Exact going on: nothing twice, nothing missing.

use super::super::*;
use super::rig::{Rig, Setup, clean, is_same};
use crate::printer::resume::Why;

const ALL: [&str; 8] =
    ["marlin", "marlin1", "klipper", "reprapfirmware", "repetier", "smoothie", "reference", "prusa-mk3s"];

#[test]
fn every_firmware_prints_a_job_once() {
    for profile in ALL {
        let setup = Setup::new(profile, 3, 48);
        let mut rig = Rig::new(setup);
        let end = rig.run();
        assert!(matches!(end, End::Finished), "{profile}: {end:?}");
        assert_eq!(rig.laid.len(), 3 * 48, "{profile}");
        let stats = rig.session.stats();
        assert_eq!((stats.n_resends, stats.n_lost_oks), (0, 0), "{profile}: {stats:?}");
    }
}

#[test]
fn a_cable_that_was_out_leaves_no_trace() {
    for profile in ALL {
        let setup = Setup::new(profile, 3, 48);
        let expected = clean(&setup);
        for line in [30, 80, 133] {
            let mut rig = Rig::new(setup.clone().with(&format!("disconnect:line={line},for-s=20")));
            rig.ends_as(&expected, &format!("{profile} {line}"));
            assert!(rig.events.iter().any(|e| matches!(e, PrintEvent::WentOn { .. })), "{profile} {line}");
        }
    }
}

#[test]
fn a_cable_that_slips_twice_leaves_no_trace() {
    for profile in ALL {
        let setup = Setup::new(profile, 3, 48);
        let expected = clean(&setup);
        let mut rig = Rig::new(setup.with("disconnect:line=80,for-s=20"));
        assert!(rig.run_until(|rig| matches!(rig.session.stage, Stage::Detached { .. })), "{profile}");
        // There for a moment, too short for an answer.
        let now = rig.now();
        rig.session.handle_port(now);
        rig.session.handle_lost(now);
        rig.ends_as(&expected, profile);
    }
}

#[test]
fn a_host_that_died_is_resumed_without_a_trace() {
    for profile in ALL {
        let setup = Setup::new(profile, 3, 48);
        let expected = clean(&setup);
        for n_laid in [1, 50, 100, 143] {
            for lost_s in [0.0, 0.9] {
                let mut rig = Rig::new(setup.clone());
                assert!(rig.run_until(|rig| rig.laid.len() >= n_laid));
                rig.drain(7.0);
                rig.resume(7.0 + lost_s, false);
                rig.ends_as(&expected, &format!("{profile} {n_laid} {lost_s}"));
            }
        }
    }
}

#[test]
fn filament_that_runs_out_pauses_and_the_print_goes_on_when_told_to() {
    let mut rig = Rig::new(Setup::new("marlin", 3, 48).with("filament-out:line=80,for-s=600"));
    let is_paused = |rig: &Rig| rig.events.contains(&PrintEvent::Session(Event::Paused));
    assert!(rig.run_until(is_paused), "{:?}", rig.events);
    // The firmware waits for the user, who takes his time.
    let until_s = rig.printer.now_s() + 700.0;
    assert!(rig.run_until(|rig| rig.printer.now_s() >= until_s));
    rig.session.pause(rig.now(), false);
    let end = rig.run();
    assert!(matches!(end, End::Finished), "{end:?}");
    assert_eq!(rig.session.stats().n_foreign_commands, 0);
}

#[test]
fn a_reset_is_recovered_from_by_every_firmware_that_can() {
    for profile in ["marlin", "marlin1", "reprapfirmware", "repetier", "smoothie"] {
        let setup = Setup::new(profile, 2, 120);
        let expected = clean(&setup);
        let mut whole = Rig::new(setup.clone());
        assert!(matches!(whole.run(), End::Finished), "{profile}");
        let mut rig = Rig::new(setup);
        assert!(rig.run_until(|rig| rig.laid.len() >= 60), "{profile}");
        rig.printer.switch_off_and_on();
        assert!(matches!(rig.run(), End::Faulted(Fault::FirmwareReset)), "{profile}");
        let n_before = rig.laid.len();
        rig.resume(0.0, true);
        let end = rig.run();
        assert!(matches!(end, End::Finished), "{profile}: {end:?}");
        // What lies behind the reset is the rest, nothing left out.
        let again = &rig.laid[n_before..];
        let from = expected.len() - again.len();
        assert!(
            from <= n_before && is_same(&again[1..], &expected[from + 1..]),
            "{profile}: {from} {n_before}"
        );
        // The filament is at the tip: what was primed aside is all that the script takes.
        let primed_mm = unlaid_mm(&rig) - unlaid_mm(&whole);
        assert!((primed_mm - PRIMED_MM).abs() < 0.5, "{profile}: {primed_mm} mm primed");
    }
}

/// What the recovery of the built-in profiles primes aside, mm.
const PRIMED_MM: f64 = 8.0;

/// Filament that was pulled in and is in no bead, mm.
fn unlaid_mm(rig: &Rig) -> f64 {
    let laid_mm3: f64 = rig.laid.iter().map(|bead| bead.2).sum();
    let radius_mm = rig.setup.profile.machine.filament_mm / 2.0;
    rig.printer.summary().filament_mm - laid_mm3 / (std::f64::consts::PI * radius_mm * radius_mm)
}

#[test]
fn heaters_that_somebody_has_switched_off_are_heated_again_by_his_word_alone() {
    for profile in ["marlin", "marlin1", "prusa-mk3s", "repetier"] {
        for order in ["M104 S0\n", "M140 S0\n"] {
            let setup = Setup::new(profile, 3, 48);
            let expected = clean(&setup);
            let mut rig = Rig::new(setup.with("disconnect:line=80,for-s=20"));
            assert!(rig.run_until(|rig| matches!(rig.session.stage, Stage::Detached { .. })), "{profile}");
            rig.drain(30.0);
            rig.printer.receive(format!("\n{order}").as_bytes());
            rig.drain(5.0);
            rig.reconnect();
            let end = rig.run();
            assert!(matches!(end, End::Faulted(Fault::LostPlace { .. })), "{profile}: {end:?}");
            assert!(rig.printer.summary().hotend_c[1] <= 0.0, "{profile}");
            let known = Known { away_s: Some(30.0), ..rig.known(0.0) };
            rig.resume_by(known, false);
            rig.ends_as(&expected, &format!("{profile} {order}"));
        }
    }
}

#[test]
fn a_place_is_not_believed_after_the_motors_have_let_go() {
    let mut rig = Rig::new(Setup::new("reprapfirmware", 2, 120));
    assert!(rig.run_until(|rig| rig.laid.len() >= 60));
    rig.is_dead = true;
    rig.drain(7200.0);
    let known = Known { away_s: Some(7200.0), ..rig.known(7200.0) };
    rig.resume_by(known.clone(), false);
    let end = rig.run();
    let End::NeedsConsent(recovery) = &end else { panic!("{end:?}") };
    assert_eq!(recovery.why, Why::MotorsOff);
    let n_before = rig.laid.len();
    let expected = clean(&rig.setup);
    rig.resume_by(known, true);
    assert!(matches!(rig.run(), End::Finished));
    let again = &rig.laid[n_before..];
    let from = expected.len() - again.len();
    assert!(from <= n_before && is_same(&again[1..], &expected[from + 1..]), "{from} {n_before}");
}
