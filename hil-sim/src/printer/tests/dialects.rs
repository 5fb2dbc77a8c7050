//! What each firmware says, and what its commands mean.

use super::*;

/// One profile of each dialect.
pub(super) const EACH: [&str; 7] =
    ["marlin", "marlin1", "prusa-mk3s", "klipper", "reprapfirmware", "repetier", "smoothie"];

#[test]
fn klipper_ignores_numbers_and_checksums_and_marks_what_it_says() {
    let mut printer = printer_of("klipper");
    assert_eq!(ask(&mut printer, "N7 M107*1\n"), ["ok"]);
    assert_eq!(ask(&mut printer, "M105\n"), ["ok B:21.0 /0.0 T0:21.0 /0.0"]);
    assert_eq!(ask(&mut printer, "M155 S2\n"), ["// Unknown command:\"M155\"", "ok"]);
    ask(&mut printer, "G28\n");
    assert_eq!(
        ask(&mut printer, "G1 X9999 Y50 Z5\n"),
        ["!! Move out of range: 9999.000 50.000 5.000 [0.000]", "ok"]
    );
    assert_eq!(ask(&mut printer, "G91\nG1 E1\n"), ["ok", "!! Extrude below minimum temp", "ok"]);
    assert_eq!(ask(&mut printer, "SET_VELOCITY_LIMIT ACCEL=1000\n"), ["ok"]);
}

#[test]
fn klipper_in_shutdown_gives_its_reason_until_it_is_restarted() {
    let mut printer = printer_of("klipper");
    ask(&mut printer, "G28\nM104 S200\n");
    assert_eq!(ask(&mut printer, "M112\n"), ["// Klipper state: Shutdown"]);
    let answers = ask(&mut printer, "G28\n");
    assert_eq!(answers[0], "// Shutdown due to M112 command");
    assert_eq!(answers[answers.len() - 2..], ["!! Shutdown due to M112 command", "ok"]);
    // What only asks is answered.
    assert!(ask(&mut printer, "M105\n")[0].starts_with("ok B:"));
    assert_eq!(
        ask(&mut printer, "FIRMWARE_RESTART\n"),
        ["// Klipper state: Disconnect", "// Klipper state: Ready"]
    );
    assert_eq!(printer.summary().hotend_c[1], 0.0);
    assert!(ask(&mut printer, "G1 X10\n")[0].starts_with("!! Must home axis first"));
}

#[test]
fn repetier_takes_lines_before_it_does_them_and_skips_what_it_has() {
    let mut printer = printer_of("repetier");
    assert_eq!(ask(&mut printer, &numbered(1, "M105")), ["ok 1", "T:21.00 /0 B:21.00 /0 B@:0 @:0"]);
    assert_eq!(ask(&mut printer, &numbered(1, "M107")), ["skip 1", "ok"]);
    assert_eq!(
        ask(&mut printer, &numbered(4, "M107")),
        ["Error:expected line 2 got 4", "", "Resend:2", "ok"]
    );
    // What was under way is passed over, not asked for again.
    assert_eq!(ask(&mut printer, &numbered(5, "M107")), ["skip 5", "ok"]);
    assert_eq!(ask(&mut printer, &numbered(2, "M107")), ["ok 2"]);
    assert_eq!(ask(&mut printer, "M73 P1\n"), ["ok 2", "Unknown command:M73 P1"]);
}

#[test]
fn repetier_says_wait_and_asks_again_for_what_does_not_come() {
    let mut printer = printer_of("repetier");
    printer.advance_to(2.5);
    assert_eq!(said(&mut printer), ["wait"; 2]);
    ask(&mut printer, &numbered(4, "M107"));
    printer.advance_to(2.8);
    assert_eq!(said(&mut printer), ["", "Resend:1", "ok"]);
}

#[test]
fn smoothie_and_reprapfirmware_ask_with_rs() {
    // Smoothieware counts from 0 unless it is told.
    assert_eq!(ask(&mut printer_of("smoothie"), &numbered(1, "M107")), ["rs N0"]);
    assert_eq!(ask(&mut printer_of("smoothie"), &(numbered(0, "M110 N0") + "N1 M107*1\n")), ["ok", "rs N1"]);
    // RepRapFirmware names the damaged line, whatever came before.
    assert_eq!(ask(&mut printer_of("reprapfirmware"), "N12 M107*1\n"), ["rs 12"]);
}

#[test]
fn reprapfirmware_does_a_line_that_comes_twice_twice() {
    let mut printer = printer_of("reprapfirmware");
    ask(&mut printer, "G28\nM109 S200\nG91\n");
    let line = numbered(5, "G1 X10 F6000");
    assert_eq!(ask(&mut printer, &line), ["ok"]);
    assert_eq!(ask(&mut printer, &line), ["ok"]);
    assert_eq!(ask(&mut printer, &numbered(99, "M400")), ["ok"]);
    assert_eq!((printer.summary().position_mm[0], printer.summary().repeated_move_lines), (20.0, 1));
}

#[test]
fn smoothie_halts_with_exclamation_marks_until_m999() {
    let mut printer = printer_of("smoothie");
    assert_eq!(
        ask(&mut printer, "G28\nM112\nG28\n"),
        ["ok", "ok Emergency Stop Requested - reset or M999 required to exit HALT state", "!!"]
    );
    assert!(ask(&mut printer, "M105\n")[0].starts_with("ok T:"));
    assert_eq!(
        ask(&mut printer, "M999\n"),
        ["WARNING: After HALT you should HOME as position is currently unknown", "ok"]
    );
    assert_eq!(ask(&mut printer, "G1 X1 F6000\n"), ["ok"]);
}

#[test]
fn each_firmware_knows_its_own_words_for_limits() {
    for (profile, known, unknown) in [
        ("marlin", "M205 J0.02", "M566 X600"),
        ("marlin1", "M205 X8", "M486 S0"),
        ("reprapfirmware", "M566 X600", "M205 J0.02"),
        ("repetier", "M207 X10", "M205 J0.02"),
        ("smoothie", "M205 X0.05", "M566 X600"),
        ("klipper", "EXCLUDE_OBJECT_START NAME=part", "M205 J0.02"),
    ] {
        let mut printer = printer_of(profile);
        ask(&mut printer, &format!("{known}\n"));
        assert_eq!(printer.summary().unknown_commands, 0, "{profile}: {known}");
        ask(&mut printer, &format!("{unknown}\n"));
        assert_eq!(printer.summary().unknown_commands, 1, "{profile}: {unknown}");
    }
}

#[test]
fn m115_names_the_firmware_in_its_own_form() {
    for (profile, head, last) in [
        ("marlin", "FIRMWARE_NAME:Marlin bugfix-2.1.x ", "ok P15 B3"),
        ("marlin1", "FIRMWARE_NAME:Marlin 1.1.9 ", "ok"),
        ("prusa-mk3s", "FIRMWARE_NAME:Prusa-Firmware 3.13.0 ", "ok"),
        (
            "klipper",
            "ok FIRMWARE_NAME:Klipper FIRMWARE_VERSION:",
            "ok FIRMWARE_NAME:Klipper FIRMWARE_VERSION:",
        ),
        ("reprapfirmware", "FIRMWARE_NAME: RepRapFirmware for Duet 3 Mini 5+ FIRMWARE_VERSION: 3.", "ok"),
        ("repetier", "FIRMWARE_NAME:Repetier_1.", "Cap:EEPROM:0"),
        ("smoothie", "FIRMWARE_NAME:Smoothieware, FIRMWARE_URL:http%3A//smoothieware.org", "ok"),
    ] {
        let lines = ask(&mut printer_of(profile), "M115\n");
        let first = lines.iter().find(|line| line.contains("FIRMWARE_NAME")).unwrap();
        assert!(first.starts_with(head), "{profile}: {first}");
        assert!(lines.last().unwrap().starts_with(last), "{profile}: {lines:?}");
    }
}

#[test]
fn m114_has_the_form_of_its_firmware() {
    for (profile, expected) in [
        ("marlin", "X:50.00 Y:40.00 Z:5.00 E:1.00 Count X:4000 Y:3200 Z:2000"),
        ("marlin1", "X:50.00 Y:40.00 Z:5.00 E:1.00 Count X:4000 Y:3200 Z:2000"),
        ("prusa-mk3s", "X:50.00 Y:40.00 Z:5.00 E:1.00 Count X: 50.00 Y:40.00 Z:5.00 E:0.00"),
        ("klipper", "X:50.000 Y:40.000 Z:5.000 E:1.000"),
        (
            "reprapfirmware",
            "X:50.000 Y:40.000 Z:5.000 E:1.000 E0:1.0 Count 4000 3200 2000 Machine 50.000 40.000 5.000 Bed comp 0.000",
        ),
        ("repetier", "X:50.00 Y:40.00 Z:5.000 E:1.0000"),
        ("smoothie", "ok C: X:50.0000 Y:40.0000 Z:5.0000 E:1.0000"),
    ] {
        let mut printer = printer_of(profile);
        ask(&mut printer, "G28\nG1 X50 Y40 Z5 F3000\nG92 E1\nM400\n");
        assert!(ask(&mut printer, "M114\n").contains(&expected.to_owned()), "{profile}");
    }
}

/// `G91`, then `G90`, with M82 in force: is E relative?
#[test]
fn relative_positions_mean_the_extruder_where_the_firmware_says_so() {
    for (profile, after_g91, after_m83_g90) in [
        ("marlin", true, false),
        ("smoothie", true, false),
        ("marlin1", true, true),
        ("klipper", true, true),
        ("repetier", true, true),
        ("reprapfirmware", false, true),
        ("prusa-mk3s", false, true),
    ] {
        for (modes, expected) in [("M82\nG91\n", after_g91), ("G91\nM83\nG90\n", after_m83_g90)] {
            let mut printer = printer_of(profile);
            ask(&mut printer, &format!("G28\nM109 S200\nG92 E10\n{modes}G1 E11 F60\nM400\n"));
            let is_relative = (printer.summary().filament_mm - 11.0).abs() < 1e-9;
            assert_eq!(is_relative, expected, "{profile}: {modes}");
            assert!(is_relative || (printer.summary().filament_mm - 1.0).abs() < 1e-9);
        }
    }
}

/// What one command brings: how far the axis went.
#[test]
fn moves_before_homing_are_refused_where_the_firmware_refuses_them() {
    for (profile, refusal) in [
        ("marlin", None),
        ("marlin1", None),
        ("prusa-mk3s", None),
        ("repetier", None),
        ("smoothie", None),
        ("klipper", Some("!! Must home axis first: 10.000 0.000 0.000 [0.000]")),
        ("reprapfirmware", Some("Error: G0/G1: insufficient axes homed")),
    ] {
        let mut printer = printer_of(profile);
        let lines = ask(&mut printer, "G1 X10 F600\nM400\n");
        let summary = printer.summary();
        match refusal {
            Some(text) => {
                assert!(lines.contains(&text.to_owned()), "{profile}: {lines:?}");
                assert_eq!((summary.moves, summary.unhomed_refusals), (0, 1), "{profile}");
                assert!(summary.unsafe_states.is_empty());
            }
            None => {
                assert_eq!(summary.moves, 1, "{profile}");
                assert_eq!(summary.unsafe_states["moved-unhomed"], 1, "{profile}");
            }
        }
    }
}

#[test]
fn a_place_that_is_told_homes_the_axis_where_the_firmware_says_so() {
    for (profile, is_refused) in [("reprapfirmware", false), ("klipper", true)] {
        let mut printer = printer_of(profile);
        ask(&mut printer, "G92 Z5\nG1 Z6 F600\nM400\n");
        let summary = printer.summary();
        assert_eq!(
            (summary.moves == 0, summary.unhomed_refusals == 1),
            (is_refused, is_refused),
            "{profile}"
        );
        assert!(summary.unsafe_states.is_empty(), "{profile}: {:?}", summary.unsafe_states);
    }
}

#[test]
fn urgent_orders_pass_the_queue_where_the_firmware_lets_them() {
    for (profile, is_stopped) in [
        ("marlin", true),
        ("marlin1", true),
        ("prusa-mk3s", true),
        ("klipper", true),
        ("reprapfirmware", true),
        // The line before is under way, and there is no room for another.
        ("repetier", false),
        ("smoothie", false),
    ] {
        let mut printer = printer_of(profile);
        printer.receive(b"M104 S200\nG4 P10000\n");
        printer.receive(b"M112\n");
        printer.advance_to(1.0);
        assert_eq!(printer.summary().hotend_c[1] == 0.0, is_stopped, "{profile}");
        printer.advance_to(20.0);
        assert_eq!(printer.summary().hotend_c[1], 0.0, "{profile}");
    }
}

#[test]
fn warming_up_is_over_when_the_temperature_has_held_as_long_as_the_firmware_wants() {
    let heated_s = |profile: &str| {
        let mut printer = printer_of(profile);
        ask(&mut printer, "M109 S200\n");
        printer.now_s()
    };
    let at_once_s = heated_s("klipper");
    for (profile, residency_s) in
        [("marlin", 10.0), ("marlin1", 10.0), ("prusa-mk3s", 3.0), ("repetier", 1.0), ("smoothie", 0.0)]
    {
        assert!((heated_s(profile) - at_once_s - residency_s).abs() < 1e-9, "{profile}");
    }
}
