//! The printer as a host sees it, on a made-up clock.

mod closed_form;
mod dialects;
mod faults;
mod matrix;
mod resume;
mod robust;

use super::*;
use proptest::prelude::*;

/// A printer with somebody at the port.
fn printer_with(faults: &[&str], baud: Option<u32>) -> Printer {
    let mut printer = Printer::new(Options {
        profile: Profile::by_name("reference").unwrap(),
        baud,
        faults: faults.iter().map(|spec| spec.parse().unwrap()).collect(),
        seed: 1,
        record_commands: true,
    });
    printer.host_arrived();
    run(&mut printer);
    printer.output().clear();
    printer
}

fn printer() -> Printer {
    printer_with(&[], None)
}

fn printer_of(profile: &str) -> Printer {
    of_profile(profile, &[])
}

/// A printer that has said its greeting.
fn of_profile(profile: &str, faults: &[&str]) -> Printer {
    let mut printer = Printer::new(Options {
        profile: Profile::by_name(profile).unwrap(),
        baud: None,
        faults: faults.iter().map(|spec| spec.parse().unwrap()).collect(),
        seed: 1,
        record_commands: false,
    });
    printer.host_arrived();
    said(&mut printer);
    printer
}

/// Lets time pass while something waits.
fn run(printer: &mut Printer) {
    let mut steps = 0;
    while printer.pace() == Pace::Work && printer.step() {
        steps += 1;
        assert!(steps < 1_000_000, "the printer never comes to rest");
    }
}

/// What is answered by the time nothing waits any more.
fn ask(printer: &mut Printer, text: &str) -> Vec<String> {
    printer.receive(text.as_bytes());
    run(printer);
    said(printer)
}

fn said(printer: &mut Printer) -> Vec<String> {
    let bytes = std::mem::take(printer.output());
    String::from_utf8_lossy(&bytes).lines().map(str::to_owned).collect()
}

fn numbered(n: i64, text: &str) -> String {
    let body = format!("N{n} {text}");
    let sum = body.bytes().fold(0, |sum, b| sum ^ b);
    format!("{body}*{sum}\n")
}

fn beads(printer: &mut Printer) -> Vec<crate::event::Bead> {
    let pick = |event| if let Event::Bead(bead) = event { Some(bead) } else { None };
    printer.take_events().filter_map(pick).collect()
}

/// Hot, homed, absolute axes, relative E.
fn ready(faults: &[&str]) -> Printer {
    let mut printer = printer_with(faults, None);
    ask(&mut printer, "G28\nM109 S200\nG90\nM83\n");
    printer.take_events();
    printer
}

/// Chords are as long as the firmware makes them: an arc of 4 mm radius through half a turn.
#[test]
fn arcs_are_driven_in_the_firmware_s_own_chords() {
    for (profile, n_chords) in [
        ("marlin", 36),
        ("marlin1", 12),
        ("prusa-mk3s", 13),
        // At 100 mm/s: 1.666 mm.
        ("repetier", 7),
        // sqrt(8 r 0.005) = 0.4 mm, 31.4 + 0.8.
        ("reprapfirmware", 32),
        // 2 sqrt(0.01 (8 - 0.01)) = 0.5653 mm.
        ("smoothie", 22),
    ] {
        let mut printer = printer_of(profile);
        ask(&mut printer, "G28\nG90\nG1 X100 Y100 F6000\nM400\n");
        let before = printer.summary().moves;
        ask(&mut printer, "G3 X92 Y100 I-4 F6000\nM400\n");
        assert_eq!(printer.summary().moves - before, n_chords, "{profile}");
    }
}

// ---------------------------------------------------------------- texts

#[test]
fn boot_says_start_first() {
    let mut printer = Printer::new(Options {
        profile: Profile::by_name("marlin").unwrap(),
        baud: None,
        faults: Vec::new(),
        seed: 0,
        record_commands: false,
    });
    printer.host_arrived();
    let lines = said(&mut printer);
    assert_eq!(lines[..2], ["start", "PowerUp"]);
    assert!(lines[2].starts_with("Marlin ") && lines[3].starts_with("echo:"), "{lines:?}");
}

#[test]
fn ok_tells_line_planner_and_slots() {
    let mut printer = printer();
    ask(&mut printer, &numbered(1, "M110 N1"));
    assert_eq!(ask(&mut printer, &numbered(2, "M107")), ["ok N2 P15 B3"]);
    assert_eq!(ask(&mut printer, "M107\n"), ["ok P15 B3"]);
    let mut plain = Printer::new(Options {
        profile: Profile::by_name("marlin1").unwrap(),
        baud: None,
        faults: Vec::new(),
        seed: 0,
        record_commands: false,
    });
    plain.host_arrived();
    said(&mut plain);
    assert_eq!(ask(&mut plain, &numbered(1, "M107")), ["ok"]);
}

#[test]
fn wrong_lines_are_answered_as_seen() {
    let mut printer = printer();
    ask(&mut printer, &numbered(1, "M107"));
    ask(&mut printer, &numbered(2, "M107"));
    assert_eq!(
        ask(&mut printer, "N3 M107*1\n"),
        ["Error:checksum mismatch, Last Line: 2", "Resend: 3", "ok"]
    );
    ask(&mut printer, &numbered(3, "M107"));
    assert_eq!(
        ask(&mut printer, &numbered(7, "M107")),
        ["Error:Line Number is not Last Line Number+1, Last Line: 3", "Resend: 4", "ok"]
    );
    assert_eq!(
        ask(&mut printer, "N4 M107\n"),
        ["Error:No Checksum with line number, Last Line: 3", "Resend: 4", "ok"]
    );
    assert!(ask(&mut printer, &numbered(3, "M107")).is_empty());
    assert!(ask(&mut printer, &numbered(2, "M107")).is_empty());
    assert_eq!(ask(&mut printer, &numbered(4, "M110 N3")), ["ok N4 P15 B3"]);
    assert_eq!(printer.summary().last_line, 3);
}

#[test]
fn damaged_n_is_unknown_and_the_next_line_is_refused() {
    let mut printer = printer();
    let damaged = numbered(1, "G1 X5").replacen('N', "F", 1);
    assert_eq!(ask(&mut printer, &damaged), ["echo:Unknown command: \"F1 G1 X5\"", "ok P15 B3"]);
    assert_eq!(ask(&mut printer, &numbered(2, "M400"))[1], "Resend: 1");
}

#[test]
fn unknown_command_is_echoed() {
    assert_eq!(ask(&mut printer(), "FOO\n"), ["echo:Unknown command: \"FOO\"", "ok P15 B3"]);
}

#[test]
fn temperatures_have_the_form_seen() {
    let mut printer = printer();
    assert_eq!(ask(&mut printer, "M105\n"), ["ok T:21.00 /0.00 B:21.00 /0.00 @:0 B@:0"]);
    ask(&mut printer, "M155 S1\n");
    printer.advance_to(2.5);
    assert_eq!(said(&mut printer), [" T:21.00 /0.00 B:21.00 /0.00 @:0 B@:0"; 2]);
}

#[test]
fn heating_reports_each_second_then_counts_down() {
    let mut printer = printer();
    let lines = ask(&mut printer, "M109 S200\n");
    assert!(lines[0].starts_with(" T:") && lines[0].ends_with(" W:?"), "{}", lines[0]);
    assert!(lines.iter().any(|line| line == "echo:busy: processing"));
    let waits: Vec<&str> = lines.iter().filter_map(|line| line.split(" W:").nth(1)).collect();
    assert_eq!(waits[waits.len() - 10..], ["9", "8", "7", "6", "5", "4", "3", "2", "1", "0"]);
    assert_eq!(lines.last().unwrap(), "ok P15 B3");
    let hot_s = -150.0 * ((420.0_f64 - 199.0) / 399.0).ln();
    assert!((printer.now_s() - hot_s.ceil() - 10.0).abs() < 1.01, "{}", printer.now_s());
    // Already hot: no wait.
    assert_eq!(ask(&mut printer, "M109 S180\n"), ["ok P15 B3"]);
}

#[test]
fn position_has_the_form_seen() {
    let mut printer = printer();
    ask(&mut printer, "G28\nG1 X50 Y50 Z5 F3000\nM400\n");
    assert_eq!(
        ask(&mut printer, "M114\n"),
        ["X:50.00 Y:50.00 Z:5.00 E:0.00 Count X:4000 Y:4000 Z:2000", "ok P15 B3"]
    );
}

#[test]
fn firmware_tells_its_capabilities() {
    let lines = ask(&mut printer(), "M115\n");
    assert!(lines[0].starts_with("FIRMWARE_NAME:Marlin "), "{}", lines[0]);
    assert!(lines.contains(&"Cap:EMERGENCY_PARSER:1".to_owned()));
    assert_eq!(lines.last().unwrap(), "ok P15 B3");
}

#[test]
fn homing_takes_10_to_30_seconds_and_says_busy() {
    let mut printer = printer();
    let lines = ask(&mut printer, "G28\n");
    assert!((10.0..30.0).contains(&printer.now_s()), "{}", printer.now_s());
    assert!(lines.iter().filter(|line| *line == "echo:busy: processing").count() >= 5);
}

#[test]
fn pause_prompts_and_is_released_by_m108() {
    let mut printer = printer();
    let lines = ask(&mut printer, "M0 wait\n");
    assert_eq!(
        lines,
        [
            "echo:wait",
            "//action:prompt_begin wait",
            "//action:prompt_button Continue",
            "//action:prompt_show"
        ]
    );
    assert_eq!(printer.pace(), Pace::RealTime);
    printer.advance_to(printer.now_s() + 4.5);
    assert_eq!(said(&mut printer), ["echo:busy: paused for user"; 2]);
    assert_eq!(ask(&mut printer, "M108\n").len(), 2);
    assert_eq!(printer.pace(), Pace::Idle);
}

#[test]
fn pause_of_a_firmware_without_m108_is_released_by_the_button() {
    let mut printer = printer_of("prusa-mk3s");
    printer.receive(b"M1 5\n");
    printer.advance_to(5.0);
    printer.receive(b"M108\n");
    assert!(said(&mut printer).iter().all(|line| line.starts_with("echo:")));
    printer.press_button();
    assert_eq!(said(&mut printer).first().map(String::as_str), Some("ok"));
}

#[test]
fn m108_ends_heating() {
    let mut printer = printer();
    printer.receive(b"M109 S200\n");
    printer.advance_to(5.0);
    said(&mut printer);
    assert_eq!(ask(&mut printer, "M108\n"), ["ok P15 B2", "ok P15 B3"]);
    assert!(printer.now_s() < 5.1);
}

#[test]
fn m112_kills_until_power_comes_back() {
    let mut printer = ready(&[]);
    printer.receive(b"G1 X100 F600\nM400\n");
    printer.advance_to(printer.now_s() + 1.0);
    said(&mut printer);
    assert_eq!(
        ask(&mut printer, "M112\n"),
        ["echo:M112 Shutdown", "Error:Printer halted. kill() called!", "//action:poweroff"]
    );
    assert!(ask(&mut printer, "M105\nG28\n").is_empty());
    let summary = printer.summary();
    assert_eq!((summary.last_state.as_str(), summary.hotend_c[1]), ("killed", 0.0));
    // Opening the port anew does not help, power does.
    printer.host_left();
    printer.host_arrived();
    assert!(ask(&mut printer, "M105\n").is_empty());
    printer.switch_off_and_on();
    assert_eq!(said(&mut printer)[0], "start");
    assert!(ask(&mut printer, "M105\n")[0].starts_with("ok T:"));
}

#[test]
fn m410_stops_where_it_is() {
    let mut printer = ready(&[]);
    let start_s = printer.now_s();
    printer.receive(b"G1 X100 F600\nG1 Y100\nM400\n");
    printer.advance_to(start_s + 5.1);
    said(&mut printer);
    ask(&mut printer, "M410\n");
    let position = &ask(&mut printer, "M114\n")[0];
    assert!(position.starts_with("X:50.") || position.starts_with("X:49."), "{position}");
    assert!(position.contains("Y:0.00"), "{position}");
}

// ---------------------------------------------------------------- motion and material

#[test]
fn simple_move_takes_the_time_of_its_trapezoid() {
    let mut printer = ready(&[]);
    let start_s = printer.now_s();
    ask(&mut printer, "G1 X100 F6000\nM400\n");
    let expected = 1.0 + 100.0 / 1500.0;
    assert!(((printer.now_s() - start_s) / expected - 1.0).abs() < 1e-3);
}

#[test]
fn dwell_takes_its_time() {
    let mut printer = printer();
    assert_eq!(ask(&mut printer, "G4 P2500\n"), ["echo:busy: processing", "ok P15 B3"]);
    assert!((printer.now_s() - 2.5).abs() < 1e-9);
}

#[test]
fn bead_is_as_wide_as_its_flow_says() {
    let mut printer = ready(&[]);
    let e = 0.4 * 0.2 * 20.0 / Profile::by_name("reference").unwrap().filament_area_mm2();
    ask(&mut printer, &format!("G1 X10 Y10 Z0.2 F3000\nG1 X30 E{e:.5}\nM400\n"));
    let beads = beads(&mut printer);
    assert_eq!(beads.len(), 1);
    assert!((beads[0].width_mm - 0.4).abs() < 1e-3 && (beads[0].hotend_c - 200.0).abs() < 1e-9, "{beads:?}");
    assert_eq!((beads[0].from_mm, beads[0].to_mm), ([10.0, 10.0, 0.2], [30.0, 10.0, 0.2]));
}

#[test]
fn flow_factor_scales_the_volume() {
    let volume = |flow: &str| {
        let mut printer = ready(&[]);
        ask(&mut printer, &format!("M221 S{flow}\nG1 Z0.2\nG1 X30 E1\nM400\n"));
        beads(&mut printer)[0].volume_mm3
    };
    assert!((volume("90") / volume("100") - 0.9).abs() < 1e-9);
}

#[test]
fn absolute_and_relative_e_lay_the_same() {
    let lay = |text: &str| {
        let mut printer = ready(&[]);
        ask(&mut printer, text);
        beads(&mut printer).iter().map(|bead| (bead.to_mm, bead.volume_mm3)).collect::<Vec<_>>()
    };
    let relative = lay("G1 Z0.2\nG1 X30 E1\nG1 E-2\nG1 X50\nG1 E2\nG1 Y30 E1\nM400\n");
    let absolute = lay("M82\nG92 E5\nG1 Z0.2\nG1 X30 E6\nG1 E4\nG1 X50\nG1 E6\nG92 E0\nG1 Y30 E1\nM400\n");
    assert_eq!(relative, absolute);
    assert_eq!(relative.len(), 2);
}

#[test]
fn cold_hotend_extrudes_nothing() {
    let mut printer = printer();
    let lines = ask(&mut printer, "G28\nM83\nG1 Z0.2\nG1 X10 E1\nM400\n");
    assert!(lines.contains(&"echo: cold extrusion prevented".to_owned()));
    assert!(beads(&mut printer).is_empty());
    assert_eq!(printer.summary().cold_extrusions, 1);
}

#[test]
fn moves_end_at_the_bed_s_edge_once_homed() {
    let mut printer = ready(&[]);
    ask(&mut printer, "G1 X999 Y-5 F6000\n");
    assert_eq!(printer.summary().position_mm[..2], [200.0, 0.0]);
    assert_eq!(printer.summary().soft_endstop_hits, 2);
    ask(&mut printer, "M211 S0\nG1 X201\n");
    assert_eq!(printer.summary().position_mm[0], 201.0);
}

#[test]
fn g92_shifts_coordinates_but_not_the_bed() {
    let mut printer = ready(&[]);
    ask(&mut printer, "G1 X10 Z0.2\nG92 X110\nG1 X130 E1\nM400\n");
    let bead = beads(&mut printer)[0];
    assert_eq!((bead.from_mm[0], bead.to_mm[0]), (10.0, 30.0));
}

#[test]
fn arc_lays_its_length() {
    for arc in ["G3 X20 Y0 I-10 J0 E1\n", "G2 X20 Y0 I-10 J0 E1\n"] {
        let mut printer = ready(&[]);
        ask(&mut printer, &format!("G1 X20 Y0 Z0.2\nM211 S0\n{arc}M400\n"));
        let beads = beads(&mut printer);
        let length: f64 =
            beads.iter().map(|b| (b.to_mm[0] - b.from_mm[0]).hypot(b.to_mm[1] - b.from_mm[1])).sum();
        assert!((length / (20.0 * std::f64::consts::PI) - 1.0).abs() < 1e-3, "{length}");
        assert_eq!(beads.last().unwrap().to_mm[0], 20.0);
    }
    let mut printer = ready(&[]);
    ask(&mut printer, "G1 X20 Y20 Z0.2\nG2 X30 Y30 R10 E1\nM400\n");
    let middle = beads(&mut printer).iter().map(|bead| bead.to_mm).nth(7).unwrap();
    // Clockwise about (30, 20): over the upper left.
    assert!((middle[0] - 30.0).hypot(middle[1] - 20.0) - 10.0 < 1e-9 && middle[1] > middle[0], "{middle:?}");
    assert!(ask(&mut printer, "G2 X5 R1\n")[0].starts_with("Error:"));
}

#[test]
fn clock_stands_still_while_only_unawaited_moves_remain() {
    let mut printer = ready(&[]);
    let before_s = printer.now_s();
    ask(&mut printer, "G1 X10 F600\nG1 X20\n");
    assert_eq!((printer.pace(), printer.now_s(), printer.has_moves()), (Pace::Idle, before_s, true));
}

#[test]
fn planner_that_runs_dry_between_moves_is_counted() {
    let mut printer = ready(&[]);
    let dry = |printer: &Printer| printer.summary().planner_dry;
    ask(&mut printer, "G1 X10\nM400\nG1 X20\n");
    assert_eq!(dry(&printer), 0);
    printer.advance_to(printer.now_s() + 10.0);
    ask(&mut printer, "G1 X30\n");
    assert_eq!(dry(&printer), 1);
}

#[test]
fn a_planner_that_is_empty_while_the_printer_warms_up_is_not_dry() {
    let mut printer = ready(&[]);
    ask(&mut printer, "G1 X10\nM190 S60\n");
    while printer.summary().bed_c[0] < 60.0 {
        printer.advance_to(printer.now_s() + 10.0);
    }
    ask(&mut printer, "G1 X20\n");
    let summary = printer.summary();
    assert_eq!((summary.planner_dry, summary.planner_dry_s), (0, 0.0));
}

#[test]
fn full_planner_lets_time_pass_by_whole_moves() {
    let mut printer = ready(&[]);
    let text: String = (1..=40).map(|i| format!("G1 X{i} F600\n")).collect();
    let answers = ask(&mut printer, &text);
    assert_eq!(answers.len(), 40);
    assert_eq!(printer.summary().peak_planner_depth, 15);
    assert_eq!(printer.summary().moves, 25);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn record_depends_on_the_commands_not_on_how_they_were_cut(cuts in proptest::collection::vec(1_usize..200, 1..40)) {
        let text: String = std::iter::once("G1 Z0.2 F3000\n".to_owned())
            .chain((0..60).map(|i| format!("G1 X{} Y{} E0.1\n", 50 + i % 7 * 5, 60 + i % 11 * 3)))
            .chain(std::iter::once("M400\n".to_owned()))
            .collect();
        let mut whole = ready(&[]);
        ask(&mut whole, &text);
        let mut pieces = ready(&[]);
        let mut rest = text.as_str();
        for cut in cuts.iter().cycle() {
            let (now, later) = rest.split_at((*cut).min(rest.len()));
            ask(&mut pieces, now);
            rest = later;
            if rest.is_empty() {
                break;
            }
        }
        prop_assert_eq!(beads(&mut whole), beads(&mut pieces));
    }

    #[test]
    fn any_bytes_leave_the_printer_answering(bytes in proptest::collection::vec(any::<u8>(), 0..600)) {
        let mut printer = printer();
        printer.receive(&bytes);
        run(&mut printer);
        printer.receive(b"\n");
        run(&mut printer);
        said(&mut printer);
        let answers = ask(&mut printer, "M105\n");
        let killed = printer.summary().last_state == "killed";
        prop_assert!(killed || answers.iter().any(|line| line.starts_with("ok T:")), "{:?}", answers);
    }
}
