//! Every fault on every dialect does what it says, where and as often as it is told to.

use super::{dialects::EACH, *};

/// What a fault left: the answers after the boot texts, and the summary.
fn struck(profile: &str, fault: &str, text: &str) -> (Vec<String>, Summary) {
    let mut printer = of_profile(profile, &[fault]);
    let mut lines = ask(&mut printer, text);
    // Outages, late lines and waits for the user end by the clock.
    printer.advance_to(printer.now_s() + 100.0);
    lines.extend(said(&mut printer));
    (lines, printer.summary())
}

fn has(lines: &[String], part: &str) -> bool {
    lines.iter().any(|line| line.contains(part))
}

/// Six lines, numbered as the dialect's first line is; the fourth is a dwell.
fn lines(profile: &str) -> String {
    let first = Profile::by_name(profile).unwrap().dialect.first_last_line + 1;
    ["M107", "M107", "M107", "G4 P1000", "M107", "M107"]
        .iter()
        .zip(first..)
        .map(|(text, n)| numbered(n, text))
        .collect()
}

#[test]
fn damaged_line_is_asked_for_again_where_lines_are_checked() {
    for profile in EACH {
        for fault in ["bit-error", "lost-byte", "doubled-byte", "wrong-resend"] {
            let (lines, summary) = struck(profile, &format!("{fault}:line=3"), &lines(profile));
            assert_eq!(summary.faults[fault], 1, "{profile} {fault}");
            if profile == "klipper" {
                assert_eq!(summary.resend_requests, 0, "{profile} {fault}");
            } else {
                // A damaged line end or number shows one line later; RepRapFirmware may miss the line altogether.
                let missed = 6 - summary.commands_executed.min(6);
                let noticed = summary.resend_requests + if profile == "reprapfirmware" { missed } else { 0 };
                assert!(noticed >= 1, "{profile} {fault}: {lines:?}");
            }
        }
    }
}

#[test]
fn half_line_runs_together_with_the_next() {
    for profile in EACH {
        let (lines, summary) = struck(profile, "half-line:line=3", &lines(profile));
        assert_eq!(summary.faults["half-line"], 1, "{profile}");
        assert!(summary.lines_received <= 6, "{profile}");
        assert!(profile == "klipper" || summary.resend_requests > 0, "{profile}: {lines:?}");
    }
}

#[test]
fn garbage_comes_before_a_line() {
    for profile in EACH {
        let (lines, summary) = struck(profile, "garbage:line=3", &lines(profile));
        assert_eq!(summary.faults["garbage"], 1, "{profile}");
        let noticed = summary.resend_requests + summary.unknown_commands;
        let silent = ["smoothie", "reprapfirmware"].contains(&profile);
        assert!(noticed > 0 || silent, "{profile}: {lines:?}");
    }
}

#[test]
fn ok_is_lost_once() {
    for profile in EACH {
        let count = |fault| {
            let (lines, _) = struck(profile, fault, &lines(profile));
            lines.iter().filter(|line| line.starts_with("ok")).count()
        };
        assert_eq!((count("lost-ok:line=3"), count("lost-ok:line=3,count=2")), (5, 4), "{profile}");
    }
}

#[test]
fn line_is_asked_for_that_nobody_misses() {
    for profile in EACH {
        let (lines, summary) = struck(profile, "spurious-resend:line=3", &lines(profile));
        let dialect = Profile::by_name(profile).unwrap().dialect;
        let wanted = format!("{}{}", dialect.resend, dialect.first_last_line + 4);
        // Klipper has no such words.
        let asked = lines.contains(&wanted);
        assert_eq!(
            (asked, summary.resend_requests),
            (profile != "klipper", u64::from(asked)),
            "{profile}: {lines:?}"
        );
    }
}

#[test]
fn line_and_answer_are_late_by_what_was_said() {
    for profile in EACH {
        for direction in ["rx", "tx"] {
            let mut printer = of_profile(profile, &[&format!("delay:line=3,for-s=7,dir={direction}")]);
            printer.receive(lines(profile).as_bytes());
            printer.advance_to(6.9);
            let early = said(&mut printer).iter().filter(|line| line.starts_with("ok")).count();
            printer.advance_to(9.0);
            let all = early + said(&mut printer).iter().filter(|line| line.starts_with("ok")).count();
            assert!(early <= 3 && all == 6, "{profile} {direction}: {early} {all}");
        }
    }
}

#[test]
fn bits_flip_in_answers_too() {
    for profile in EACH {
        let (clean, _) = struck(profile, "lost-ok:line=99", &lines(profile));
        let (noisy, summary) = struck(profile, "bit-error:line=3,dir=tx", &lines(profile));
        assert_eq!(summary.faults["bit-error"], 1, "{profile}");
        assert_ne!(clean, noisy, "{profile}");
        assert_eq!(summary.commands_executed, 6, "{profile}");
    }
}

#[test]
fn port_vanishes_and_comes_back_with_the_firmware_alive() {
    for profile in EACH {
        let mut printer = of_profile(profile, &["disconnect:line=3,for-s=5"]);
        printer.receive(lines(profile).as_bytes());
        assert!(!printer.is_plugged(), "{profile}");
        printer.advance_to(4.9);
        assert!(
            !printer.is_plugged()
                && said(&mut printer).iter().all(|line| line == "ok" || line.starts_with("ok "))
        );
        printer.advance_to(5.0);
        assert!(printer.is_plugged(), "{profile}");
        assert_eq!(printer.life, Life::Running, "{profile}");
        assert!(has(&ask(&mut printer, "M105\n"), "/0"), "{profile}");
    }
}

#[test]
fn board_that_is_down_hears_nothing_and_then_boots() {
    for profile in EACH {
        for kind in ["reset", "power-cut"] {
            let mut printer = of_profile(profile, &[&format!("{kind}:line=3,for-s=2")]);
            ask(&mut printer, "M104 S200\nM140 S60\n");
            said(&mut printer);
            let down_s = printer.now_s();
            ask(&mut printer, "M107\nM107\n");
            said(&mut printer);
            printer.advance_to(down_s + 1.9);
            assert!(ask(&mut printer, "M105\n").is_empty(), "{profile} {kind}");
            printer.advance_to(down_s + 2.0);
            let boot = match profile {
                "klipper" => "// Klipper state: Shutdown",
                _ => printer.profile.dialect.boot[0],
            };
            assert!(has(&said(&mut printer), boot), "{profile} {kind}");
            assert!(!printer.summary().heaters_on, "{profile} {kind}");
        }
    }
}

#[test]
fn power_cut_cools_the_bed_by_its_time_constant() {
    let mut printer = of_profile("marlin", &["power-cut:at-s=1000,for-s=600"]);
    ask(&mut printer, "M140 S60\n");
    printer.advance_to(1600.0);
    let expected = 21.0 + 39.0 * (-2.0_f64).exp();
    assert!((printer.summary().bed_c[0] - expected).abs() < 1e-9, "{:?}", printer.summary().bed_c);
}

#[test]
fn kill_stops_motion_and_heat() {
    for (profile, told) in [
        ("marlin", "Error:Printer halted. kill() called!"),
        ("marlin1", "Error:Printer halted. kill() called!"),
        ("prusa-mk3s", "Error:Printer halted. kill() called!"),
        ("klipper", "// Klipper state: Shutdown"),
        ("reprapfirmware", "Emergency Stop! Reset the controller to continue."),
        ("repetier", "fatal:"),
        ("smoothie", "ALARM: Kill button pressed"),
    ] {
        let (lines, summary) = struck(profile, "kill:at-s=150", "G28\nM104 S200\nG4 S400\nM105\n");
        assert!(has(&lines, told), "{profile}: {lines:?}");
        assert!(!summary.heaters_on && summary.last_state == "killed", "{profile}");
        assert_eq!(summary.position_mm[0], 0.0);
    }
}

#[test]
fn heaters_that_fail_are_found_in_every_state() {
    for (fault, order, words) in [
        // Before anything, in the middle of M109, and while it holds.
        ("runaway", "M109 S200\n", "Heating failed"),
        ("runaway:at-s=30", "M109 S200\n", "Heating failed"),
        ("runaway:at-s=200", "M109 S200\nG4 S400\n", "Thermal Runaway"),
        ("sensor-open:at-s=30", "M109 S200\n", "MINTEMP"),
        ("sensor-open:at-s=200", "M109 S200\nG4 S400\n", "MINTEMP"),
    ] {
        for profile in EACH {
            let (lines, summary) = struck(profile, fault, order);
            assert!(!summary.heaters_on, "{profile} {fault}: {lines:?}");
            match profile {
                "marlin" | "marlin1" | "prusa-mk3s" => {
                    assert!(has(&lines, words), "{profile} {fault}: {lines:?}")
                }
                "klipper" => assert!(has(&lines, "// Klipper state: Shutdown")),
                "reprapfirmware" => {
                    assert!(has(&lines, "fault on heater 1"), "{lines:?}");
                    assert_ne!(summary.last_state, "killed");
                }
                "repetier" => assert!(has(&lines, "fatal:"), "{lines:?}"),
                _ => assert!(has(&lines, "HALT asserted") || has(&lines, "MINTEMP"), "{lines:?}"),
            }
        }
    }
}

#[test]
fn silence_is_silent_and_ends() {
    for profile in EACH {
        let mut printer = of_profile(profile, &["silent:line=3,for-s=5"]);
        let before = ask(&mut printer, &lines(profile)).len();
        assert!(before <= 3, "{profile}");
        printer.advance_to(4.9);
        assert!(said(&mut printer).is_empty(), "{profile}");
        printer.advance_to(8.0);
        assert_eq!(printer.summary().commands_executed, 6, "{profile}");
    }
}

/// Ten layers of one bead each: its place and its cross-section, layer by layer.
fn tower(profile: &str, faults: &[&str]) -> (Vec<crate::event::Bead>, Summary) {
    let mut printer = of_profile(profile, faults);
    ask(&mut printer, "G28\nM109 S200\nG90\nM83\n");
    for layer in 1..=10 {
        let z = f64::from(layer) * 0.2;
        ask(&mut printer, &format!("G1 X50 Y50 Z{z:.3} F6000\nG1 X60 E0.4 F600\nG1 X50 Y60\n"));
    }
    ask(&mut printer, "M400\n");
    (beads(&mut printer), printer.summary())
}

#[test]
fn faults_of_the_print_begin_at_their_layer_and_end_after_their_time() {
    for profile in EACH {
        let clean = tower(profile, &[]).0;
        assert_eq!(clean.len(), 10, "{profile}");
        let (shifted, _) = tower(profile, &["layer-shift:layer=3,axis=y,mm=0.4"]);
        let (clogged, _) = tower(profile, &["clog:layer=2,percent=20"]);
        let (leaking, _) = tower(profile, &["leak:layer=4,percent=25"]);
        for (layer, bead) in clean.iter().enumerate() {
            let dy = shifted[layer].to_mm[1] - bead.to_mm[1];
            assert!((dy - if layer >= 3 { 0.4 } else { 0.0 }).abs() < 1e-9, "{profile} {layer}");
            let share = clogged[layer].volume_mm3 / bead.volume_mm3;
            assert!((share - if layer >= 2 { 0.8 } else { 1.0 }).abs() < 1e-9, "{profile} {layer}");
        }
        // Travels drip from the layer after on: 6 layers with one travel each, and the way back between.
        assert!(leaking.len() > clean.len() + 5, "{profile}: {}", leaking.len());
        // Each layer takes about two seconds.
        let (short, summary) = tower(profile, &["clog:layer=2,percent=20,for-s=3"]);
        assert_eq!(summary.faults["clog"], 1);
        assert!((short[9].volume_mm3 / clean[9].volume_mm3 - 1.0).abs() < 1e-9, "{profile}");
    }
}

#[test]
fn overlapping_faults_add_up_and_end_each_by_itself() {
    let clean = tower("marlin", &[]).0;
    let both = tower(
        "marlin",
        &[
            "layer-shift:layer=2,mm=1",
            "layer-shift:layer=4,mm=0.5",
            "clog:layer=3,percent=50",
            "clog:layer=6,percent=20",
        ],
    )
    .0;
    for (layer, bead) in clean.iter().enumerate() {
        let dx = if layer >= 2 { 1.0 } else { 0.0 } + if layer >= 4 { 0.5 } else { 0.0 };
        assert!((both[layer].to_mm[0] - bead.to_mm[0] - dx).abs() < 1e-9, "{layer}");
        let share = if layer >= 3 { 0.5 } else { 1.0 } * if layer >= 6 { 0.8 } else { 1.0 };
        assert!((both[layer].volume_mm3 / bead.volume_mm3 - share).abs() < 1e-9, "{layer}");
    }
    // A second silence within the first does not end it.
    let mut printer = of_profile("marlin", &["silent:at-s=1,for-s=10", "silent:at-s=2,for-s=1"]);
    printer.advance_to(9.0);
    assert!(ask(&mut printer, "M105\n").is_empty());
    printer.advance_to(11.5);
    assert!(!said(&mut printer).is_empty());
}

#[test]
fn same_fault_strikes_as_often_as_it_is_asked_to() {
    let (lines, summary) = struck("marlin", "lost-ok:line=2,count=3", &lines("marlin"));
    assert_eq!((summary.faults["lost-ok"], lines.iter().filter(|l| l.starts_with("ok")).count()), (3, 3));
    let (_, summary) = tower("marlin", &["reset:line=5,count=2"]);
    assert_eq!(summary.faults["reset"], 2);
    // At the last line, and before anything is homed.
    let (_, summary) = tower("marlin", &["layer-shift:line=1,mm=2", "kill:line=35"]);
    assert_eq!((summary.faults["layer-shift"], summary.faults["kill"]), (1, 1));
    assert_eq!(summary.last_state, "killed");
}

#[test]
fn homing_takes_a_shift_back() {
    let mut printer = of_profile("marlin", &["layer-shift:line=1,axis=x,mm=3"]);
    ask(&mut printer, "M107\nG28\nM109 S200\nM83\nG1 Z0.2\nG1 X10 E1\nM400\n");
    assert_eq!(beads(&mut printer)[0].to_mm[0], 10.0);
}
