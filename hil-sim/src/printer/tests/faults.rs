//! Faults of the wire, of the machine and of what is laid down, one by one.

use super::*;

/// A simple host: numbered lines one at a time, resends on request, probes after silence.
fn print(printer: &mut Printer, commands: &[String]) {
    let mut next = 1;
    let mut tries = 0;
    while next <= commands.len() {
        tries += 1;
        assert!(tries < 20 * commands.len() + 1000, "the host gets nowhere at line {next}");
        let n = i64::try_from(next).unwrap();
        printer.receive(numbered(n, &commands[next - 1]).as_bytes());
        run(printer);
        // Late answers are waited for.
        while printer.pace() == Pace::RealTime {
            printer.step();
            run(printer);
        }
        let answers = said(printer);
        let resend =
            answers.iter().rev().find_map(|line| line.strip_prefix("Resend: ")?.parse::<usize>().ok());
        let accepted = answers.iter().any(|line| line.starts_with(&format!("ok N{next} ")));
        match resend {
            Some(wanted) => next = wanted.clamp(1, next + 1),
            None if accepted => next += 1,
            // Silence, or nonsense: a line that cannot be accepted makes the printer tell its last one.
            None => {
                printer.receive(b"\n");
                printer.receive(numbered(n + 1_000_000, "M105").as_bytes());
                run(printer);
                let told = said(printer);
                let last = told
                    .iter()
                    .rev()
                    .find_map(|line| line.split("Last Line: ").nth(1)?.parse::<usize>().ok());
                next = last.map_or(next, |last| last + 1);
            }
        }
    }
}

fn job() -> Vec<String> {
    let mut commands: Vec<String> = ["G28", "M109 S200", "G90", "M83"].map(str::to_owned).to_vec();
    for layer in 1..=5 {
        commands.push(format!("G1 Z{:.3} F600", f64::from(layer) * 0.2));
        for i in 0..80 {
            let angle = f64::from(i) * 0.08;
            let (x, y) = (20.0_f64.mul_add(angle.cos(), 100.0), 20.0_f64.mul_add(angle.sin(), 100.0));
            commands.push(format!("G1 X{x:.3} Y{y:.3} E0.05321 F1800"));
        }
        commands.push("G1 E-0.8 F2100".to_owned());
        commands.push("G1 E0.8".to_owned());
    }
    commands.push("M400".to_owned());
    commands
}

/// From, to, width.
type Row = ([f64; 3], [f64; 3], f64);

fn deposited(faults: &[&str]) -> (Vec<Row>, Summary) {
    let mut printer = printer_with(faults, None);
    print(&mut printer, &job());
    let beads = beads(&mut printer);
    (beads.iter().map(|b| (b.from_mm, b.to_mm, b.width_mm)).collect(), printer.summary())
}

#[test]
fn faults_of_the_wire_leave_the_deposition_unchanged() {
    let clean = deposited(&[]).0;
    assert_eq!(clean.len(), 400);
    for fault in [
        "bit-error:rate=0.05",
        "lost-byte:rate=0.05",
        "doubled-byte:rate=0.05",
        "half-line:rate=0.03",
        "lost-ok:rate=0.03",
        "spurious-resend:rate=0.05",
        "wrong-resend:rate=0.05",
        "delay:rate=0.02,for-s=2",
        "garbage:rate=0.03",
        "bit-error:rate=0.05,dir=tx",
        "lost-byte:rate=0.05,dir=tx",
        "half-line:rate=0.03,dir=tx",
        "delay:rate=0.02,dir=tx",
    ] {
        let (beads, summary) = deposited(&[fault]);
        let struck: u64 = summary.faults.values().sum();
        assert!(struck >= 3, "{fault}: {struck}");
        assert_eq!(beads, clean, "{fault}");
    }
}

#[test]
fn faults_follow_from_their_seed() {
    let run = || deposited(&["bit-error:rate=0.05", "lost-ok:rate=0.02"]).1;
    assert_eq!(run(), run());
}

// ---------------------------------------------------------------- faults of the machine

#[test]
fn reset_starts_anew_at_the_given_line() {
    let mut printer = printer_with(&["reset:line=3"], None);
    ask(&mut printer, &numbered(1, "M107"));
    ask(&mut printer, &numbered(2, "M107"));
    let lines = ask(&mut printer, &numbered(3, "M107"));
    assert_eq!(lines[0], "start");
    assert!(!lines.iter().any(|line| line.starts_with("ok")));
    assert_eq!(printer.summary().last_line, 0);
}

#[test]
fn reset_in_mid_air_keeps_the_bed_frame() {
    let mut printer = ready(&["reset:line=8"]);
    ask(&mut printer, "G1 X50 Y50 Z0.2 F3000\nM400\n");
    ask(&mut printer, "M105\nM105\n");
    ask(&mut printer, "M302 P1\nG91\nG1 X10 E1\nM400\n");
    let bead = beads(&mut printer)[0];
    assert_eq!((bead.from_mm, bead.to_mm), ([50.0, 50.0, 0.2], [60.0, 50.0, 0.2]));
}

#[test]
fn kill_fault_says_so_and_stops() {
    let mut printer = ready(&["kill:at-s=150"]);
    let lines = ask(&mut printer, "G4 S600\n");
    assert_eq!(lines[lines.len() - 2..], ["Error:Printer halted. kill() called!", "//action:poweroff"]);
    assert!((printer.now_s() - 150.0).abs() < 1e-9);
}

#[test]
fn dead_heater_is_a_thermal_runaway() {
    let mut printer = ready(&["runaway:at-s=150"]);
    let lines = ask(&mut printer, "G4 S600\n");
    let tail = &lines[lines.len() - 3..];
    assert_eq!(tail[0], "Error:Thermal Runaway, system stopped! Heater_ID: E0");
    assert_eq!(tail[1], "Error:Printer halted. kill() called!");
    assert!(printer.now_s() < 200.0);
}

#[test]
fn open_sensor_is_a_mintemp() {
    let mut printer = ready(&["sensor-open:at-s=150"]);
    let lines = ask(&mut printer, "G4 S600\n");
    assert!(lines.contains(&"Error:MINTEMP triggered, system stopped! Heater_ID: E0".to_owned()));
}

#[test]
fn silence_ends_and_nothing_is_lost() {
    let mut printer = printer_with(&["silent:line=2,for-s=5"], None);
    ask(&mut printer, &numbered(1, "M107"));
    assert!(ask(&mut printer, &numbered(2, "M107")).is_empty());
    assert!(ask(&mut printer, &numbered(3, "M107")).is_empty());
    assert_eq!(printer.pace(), Pace::RealTime);
    printer.advance_to(5.0);
    assert_eq!(said(&mut printer), ["ok N2 P15 B2", "ok N3 P15 B3"]);
}

#[test]
fn disconnect_takes_the_port_away_for_its_time() {
    let mut printer = printer_with(&["disconnect:line=2,for-s=3"], None);
    ask(&mut printer, &numbered(1, "M107"));
    ask(&mut printer, &numbered(2, "M107"));
    assert!(!printer.is_plugged());
    assert_eq!(printer.pace(), Pace::RealTime);
    printer.advance_to(3.0);
    assert!(printer.is_plugged());
    // The firmware has lived on.
    assert_eq!(ask(&mut printer, &numbered(3, "M107")), ["ok N3 P15 B3"]);
}

#[test]
fn faults_of_the_print_show_in_the_beads_of_their_layers() {
    let clean = deposited(&[]).0;
    let shifted = deposited(&["layer-shift:layer=3,axis=y,mm=0.4"]).0;
    let clogged = deposited(&["clog:layer=2,percent=20"]).0;
    for (index, bead) in clean.iter().enumerate() {
        let layer = index / 80;
        let dy = shifted[index].1[1] - bead.1[1];
        assert!((dy - if layer >= 3 { 0.4 } else { 0.0 }).abs() < 1e-9, "{index}");
        let share = clogged[index].2 / bead.2;
        assert!((share - if layer >= 2 { 0.8 } else { 1.0 }).abs() < 1e-9, "{index}");
    }
}

// ---------------------------------------------------------------- the wire

#[test]
fn wire_s_time_counts() {
    let mut printer = printer_with(&[], Some(115_200));
    let start_s = printer.now_s();
    ask(&mut printer, "M107\n");
    // 5 bytes there, "ok P15 B3\n" back.
    assert!((printer.now_s() - start_s - 15.0 * 10.0 / 115_200.0).abs() < 1e-9);
}

#[test]
fn flooded_uart_loses_bytes_and_recovers() {
    let mut printer = printer_with(&[], Some(115_200));
    let text: String = (1..=40).map(|n| numbered(n, "G4 P10")).collect();
    let lines = ask(&mut printer, &text);
    assert!(printer.summary().overrun_bytes > 0);
    assert!(lines.iter().any(|line| line.starts_with("Resend: ")));
}
