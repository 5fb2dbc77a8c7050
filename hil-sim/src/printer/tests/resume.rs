//! What a host that wants to go on with a print finds: after a disconnect all of it, after a reset nothing.

use super::{dialects::EACH, *};

/// Homed, hot, half a job driven.
fn half_way(profile: &str, faults: &[&str]) -> Printer {
    let mut printer = of_profile(profile, faults);
    ask(&mut printer, "G28\nM109 S200\nM140 S60\nG90\nM83\nG1 X50 Y50 Z0.2 F3000\nG1 X60 E1 F600\nM400\n");
    printer
}

#[test]
fn disconnect_leaves_everything_and_the_queue_runs_dry() {
    for profile in EACH {
        let mut printer = half_way(profile, &[]);
        let moves = printer.summary().moves;
        printer.receive(b"G1 X61 E0.1\nG1 X62 E0.1\nG1 X63 E0.1\n");
        printer.host_left();
        printer.advance_to(printer.now_s() + 10.0);
        let summary = printer.summary();
        assert_eq!(summary.moves - moves, 3, "{profile}");
        assert_eq!((summary.hotend_c[1], summary.heaters_on), (200.0, true), "{profile}");
        assert!((summary.host_gone_s.unwrap() - 10.0).abs() < 1e-9);
        printer.host_arrived();
        assert!(!said(&mut printer).iter().any(|line| line == "start"), "{profile}");
        let place = &ask(&mut printer, "M114\n");
        assert!(place.iter().any(|line| line.contains("X:63.0")), "{profile}: {place:?}");
    }
}

#[test]
fn half_a_line_of_a_host_that_died_stays_in_the_line_buffer() {
    let mut printer = half_way("marlin", &[]);
    printer.receive(b"N1 G1 X");
    printer.host_left();
    printer.host_arrived();
    let lines = ask(&mut printer, &numbered(1, "M107"));
    assert!(lines[0].starts_with("Error:"), "{lines:?}");
    assert!(ask(&mut printer, &numbered(1, "M107"))[0].starts_with("ok N1"));
}

#[test]
fn reset_leaves_nothing_but_what_lies_on_the_bed() {
    for profile in EACH {
        let mut printer = half_way(profile, &["reset:at-s=1000"]);
        let next = numbered(printer.receiver.last_line + 1, "M107");
        ask(&mut printer, &next);
        assert!(printer.now_s() < 1000.0, "{profile}");
        printer.advance_to(1000.5);
        let lines = said(&mut printer);
        if profile == "klipper" {
            // The board is gone, the rest of the firmware is not.
            assert!(lines.contains(&"// Klipper state: Shutdown".to_owned()), "{lines:?}");
            let answers = ask(&mut printer, "G28\n");
            assert!(answers.contains(&"!! MCU 'mcu' spontaneous restart".to_owned()), "{answers:?}");
            ask(&mut printer, "FIRMWARE_RESTART\n");
        } else {
            let boot = printer.profile.dialect.boot;
            assert!(
                lines.ends_with(&boot.iter().map(|line| (*line).to_owned()).collect::<Vec<_>>()),
                "{profile}: {lines:?}"
            );
        }
        let summary = printer.summary();
        assert_eq!(summary.last_line, printer.profile.dialect.first_last_line, "{profile}");
        assert_eq!([summary.hotend_c[1], summary.bed_c[1]], [0.0, 0.0], "{profile}");
        assert_eq!(printer.motion.homed, [false; 3], "{profile}");
        // Z has not moved, but the firmware takes it for 0.
        assert_eq!(summary.position_mm, [0.0; 4], "{profile}");
        assert!((printer.deposit.shift_mm[2] - 0.2).abs() < 1e-9, "{profile}");
        assert_eq!(summary.beads, 1, "{profile}");
    }
}

#[test]
fn board_that_is_reset_by_the_port_boots_for_every_host() {
    let mut printer = half_way("marlin", &[]);
    printer.host_left();
    printer.profile.resets_on_open = true;
    printer.host_arrived();
    assert_eq!(said(&mut printer)[0], "start");
    assert!(!printer.summary().heaters_on);
}

#[test]
fn homing_z_onto_a_print_is_told_to_the_judge() {
    let mut printer = half_way("marlin", &[]);
    ask(&mut printer, "G28 X Y\n");
    assert!(printer.summary().unsafe_states.is_empty());
    ask(&mut printer, "G28 Z\n");
    assert_eq!(printer.summary().unsafe_states["homed-z-onto-print"], 1);
}

/// When heaters go off with nobody there, s after the last motion; none: they stay on for 3 h.
fn orphaned_heaters_s(profile: &str, order: &str) -> Option<f64> {
    let mut printer = half_way(profile, &[]);
    ask(&mut printer, order);
    printer.host_left();
    let start_s = printer.now_s();
    while printer.now_s() < start_s + 10_800.0 {
        if !printer.summary().heaters_on {
            return Some(printer.now_s() - start_s);
        }
        printer.advance_to(printer.now_s() + 1.0);
    }
    None
}

#[test]
fn firmware_turns_orphaned_heaters_off_only_as_it_really_does() {
    for (profile, order, expected_s) in [
        ("marlin", "M105\n", None),
        ("marlin", "M85 S300\n", Some(300.0)),
        ("marlin1", "M85 S300\n", Some(300.0)),
        ("prusa-mk3s", "M105\n", Some(1800.0)),
        ("prusa-mk3s", "M86 S120\n", Some(120.0)),
        ("klipper", "M105\n", Some(600.0)),
        ("klipper", "SET_IDLE_TIMEOUT TIMEOUT=900\n", Some(900.0)),
        ("repetier", "M105\n", None),
        ("repetier", "M85 S300\n", Some(300.0)),
        // It takes M85 and does nothing.
        ("reprapfirmware", "M85 S300\n", None),
        ("smoothie", "M85 S300\n", None),
    ] {
        let off_s = orphaned_heaters_s(profile, order);
        let near = match (off_s, expected_s) {
            (Some(is), Some(wanted)) => (is - wanted).abs() <= 1.0,
            (None, None) => true,
            _ => false,
        };
        assert!(near, "{profile} {order}: {off_s:?}");
    }
}

#[test]
fn m85_kills_marlin_in_its_own_words() {
    let mut printer = half_way("marlin", &[]);
    ask(&mut printer, "M85 S60\n");
    printer.advance_to(printer.now_s() + 59.0);
    ask(&mut printer, "M105\n");
    printer.advance_to(printer.now_s() + 61.0);
    assert_eq!(
        said(&mut printer),
        [
            "Error:!! KILL caused by too much inactive time - current command: ",
            "Error:Printer halted. kill() called!",
            "//action:poweroff"
        ]
    );
}

#[test]
fn motors_that_go_off_forget_where_the_axes_are() {
    let mut printer = half_way("marlin", &[]);
    printer.advance_to(printer.now_s() + 119.0);
    assert_eq!(printer.motion.homed, [true; 3]);
    printer.advance_to(printer.now_s() + 2.0);
    assert_eq!(printer.motion.homed, [false; 3]);
    let mut printer = half_way("marlin", &[]);
    ask(&mut printer, "M84 S0\n");
    printer.advance_to(printer.now_s() + 1000.0);
    assert_eq!(printer.motion.homed, [true; 3]);
    ask(&mut printer, "M84\n");
    assert_eq!(printer.motion.homed, [false; 3]);
}

#[test]
fn unattended_heat_is_measured() {
    let mut printer = half_way("marlin", &[]);
    ask(&mut printer, "M105\n");
    printer.advance_to(printer.now_s() + 700.0);
    ask(&mut printer, "M105\n");
    let summary = printer.summary();
    assert!((summary.unattended_hot_s - 700.0).abs() < 1e-9, "{}", summary.unattended_hot_s);
    assert_eq!(summary.unsafe_states["heated-unattended"], 1);
}

#[test]
fn move_done_twice_is_counted_by_its_line_and_by_its_bead() {
    let mut printer = half_way("klipper", &[]);
    ask(&mut printer, "N1 G1 X70 E1\nG1 X60\nN1 G1 X70 E1\nM400\n");
    let summary = printer.summary();
    assert_eq!((summary.repeated_move_lines, summary.repeated_beads), (1, 1));
    ask(&mut printer, "M110 N0\nN1 G1 X80 E1\nM400\n");
    assert_eq!(printer.summary().repeated_move_lines, 1);
}

#[test]
fn planner_s_least_depth_counts_only_between_moves_that_follow() {
    let mut printer = half_way("marlin", &[]);
    assert_eq!(printer.summary().least_planner_depth, None);
    ask(&mut printer, &(0..40).map(|i| format!("G1 X{} F600\n", 60 + i % 2)).collect::<String>());
    ask(&mut printer, "M400\n");
    assert_eq!(printer.summary().least_planner_depth, Some(14));
    ask(&mut printer, "G1 X10\n");
    printer.advance_to(printer.now_s() + 20.0);
    ask(&mut printer, "G1 X20\nM400\n");
    let summary = printer.summary();
    assert_eq!(summary.least_planner_depth, Some(0));
    assert!((10.0..20.0).contains(&summary.planner_dry_s), "{}", summary.planner_dry_s);
}

// ---------------------------------------------------------------- filament

#[test]
fn filament_that_runs_out_is_changed_with_the_user_s_help() {
    let mut printer = half_way("marlin", &["filament-out:line=10"]);
    let lines = ask(&mut printer, "M107\nM107\n");
    for told in ["//action:paused filament_runout 0", "//action:prompt_begin Nozzle Parked"] {
        assert!(lines.contains(&told.to_owned()), "{lines:?}");
    }
    assert_eq!(printer.summary().last_state, "waiting-for-filament");
    // The nozzle does not stay hot for ever.
    printer.advance_to(printer.now_s() + 60.0);
    assert!(said(&mut printer).contains(&"//action:prompt_begin HeaterTimeout".to_owned()));
    assert_eq!(printer.summary().hotend_c[1], 0.0);
    let lines = ask(&mut printer, "M108\n");
    assert!(lines.contains(&"//action:resumed".to_owned()), "{lines:?}");
    assert_eq!(printer.summary().hotend_c[1], 200.0);
    let beads = printer.summary().beads;
    ask(&mut printer, "G1 X90 E2\nM400\n");
    assert_eq!(printer.summary().beads, beads + 1);
}

#[test]
fn machine_without_a_sensor_prints_on_in_the_air() {
    let mut printer = half_way("marlin1", &["filament-out:line=10"]);
    let lines = ask(&mut printer, "M107\nM107\nG1 X90 E2\nM400\n");
    assert!(lines.iter().all(|line| line == "ok" || line.starts_with("echo:busy")), "{lines:?}");
    assert_eq!(printer.summary().beads, 1);
}

#[test]
fn what_lies_behind_the_sensor_still_prints() {
    let mut printer = half_way("klipper", &["filament-out:line=10"]);
    let lines = ask(&mut printer, "M107\nM107\n");
    assert!(lines.contains(&"// action:paused".to_owned()), "{lines:?}");
    let before_mm3 = printer.summary().deposited_mm3;
    for x in [90, 120, 150, 180] {
        ask(&mut printer, &format!("G1 X{x} E20\n"));
    }
    ask(&mut printer, "M400\n");
    let laid_mm = (printer.summary().deposited_mm3 - before_mm3) / printer.profile.filament_area_mm2();
    assert!((laid_mm - 50.0).abs() < 1e-9, "{laid_mm}");
}

#[test]
fn runout_is_told_in_each_firmware_s_words() {
    for (profile, told, state) in [
        ("marlin", "//action:paused filament_runout 0", "waiting-for-filament"),
        ("prusa-mk3s", "echo:busy: processing", "waiting-for-filament"),
        ("klipper", "// action:paused", "idle"),
        ("reprapfirmware", "Error: Filament error on extruder 0: no filament", "idle"),
        ("repetier", "RequestPause:No filament detected!", "idle"),
        ("smoothie", "// Filament Detector has detected a filament jam", "idle"),
    ] {
        let mut printer = half_way(profile, &["filament-out:line=10"]);
        let lines = ask(&mut printer, "M107\nM107\n");
        assert!(lines.contains(&told.to_owned()), "{profile}: {lines:?}");
        assert_eq!(printer.summary().last_state, state, "{profile}");
    }
}
