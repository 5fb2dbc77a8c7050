//! Simulated time against the closed form, within 0.1 %: moves, corners, heating, the wire.

use super::*;

/// The reference machine's figures, mm/s and mm/s².
const TRAVEL: f64 = 1500.0;
const PRINT: f64 = 1000.0;
const DEVIATION: f64 = 0.013;

fn near(is: f64, expected: f64, what: &str) {
    assert!((is / expected - 1.0).abs() < 1e-3, "{what}: {is} s, expected {expected} s");
}

/// How long a homed and hot printer takes for `text`.
fn time_s(text: &str) -> f64 {
    let mut printer = ready(&[]);
    ask(&mut printer, "G1 X100 Y100 Z10 F6000\nM400\n");
    let start_s = printer.now_s();
    ask(&mut printer, &format!("{text}M400\n"));
    printer.now_s() - start_s
}

/// From rest to rest along `s` at `v` with `a`: a trapezoid, or a triangle where it is too short.
fn rest_to_rest(s: f64, v: f64, a: f64) -> f64 {
    if s > v * v / a { s / v + v / a } else { 2.0 * (s / a).sqrt() }
}

#[test]
fn moves_from_rest_to_rest() {
    for (text, expected, what) in [
        ("G1 X180 F6000\n", rest_to_rest(80.0, 100.0, TRAVEL), "trapezoid"),
        ("G1 X101 F6000\n", rest_to_rest(1.0, 100.0, TRAVEL), "triangle"),
        ("G1 X130 Y140 F6000\n", rest_to_rest(50.0, 100.0, TRAVEL), "slant"),
        ("G1 X150 E2 F3000\n", rest_to_rest(50.0, 50.0, PRINT), "print"),
        ("G1 E-5 F2100\n", rest_to_rest(5.0, 35.0, 3000.0), "retraction"),
        // 60 mm/s for the filament: 50 mm with 10 mm of it go no faster than 300 mm/s.
        ("G1 X150 E10 F30000\n", rest_to_rest(50.0, 300.0, PRINT), "extruder-limited speed"),
        // Z takes 10 mm/s and 100 mm/s²; it is 0.6 of the way.
        ("G1 X108 Z16 F6000\n", rest_to_rest(10.0, 10.0 / 0.6, 100.0 / 0.6), "z-limited"),
        ("G1 Z11 F6000\n", rest_to_rest(1.0, 10.0, 100.0), "z alone"),
        ("G4 P1234\n", 1.234, "dwell"),
    ] {
        near(time_s(text), expected, what);
    }
}

#[test]
fn two_moves_round_a_corner() {
    for turn_deg in [30.0_f64, 60.0, 90.0, 120.0, 150.0] {
        let (s, v) = (50.0, 100.0);
        let (dx, dy) = (s * turn_deg.to_radians().cos(), s * turn_deg.to_radians().sin());
        let text = format!("G1 X150 F6000\nG1 X{:.6} Y{:.6}\n", 150.0 + dx, 100.0 + dy);
        // Half the angle between the legs.
        let sine = ((180.0 - turn_deg) / 2.0).to_radians().sin();
        let corner2: f64 = (TRAVEL * DEVIATION * sine / (1.0 - sine)).min(v * v);
        let leg = |c2: f64| (2.0 * v - c2.sqrt()) / TRAVEL + (s - (2.0 * v * v - c2) / (2.0 * TRAVEL)) / v;
        near(time_s(&text), 2.0 * leg(corner2), &format!("{turn_deg} degrees"));
    }
}

#[test]
fn straight_line_in_pieces_and_with_two_speeds() {
    let pieces: String =
        (1..=160).map(|i| format!("G1 X{:.2} F6000\n", 100.0 + f64::from(i) * 0.5)).collect();
    near(time_s(&pieces), rest_to_rest(80.0, 100.0, TRAVEL), "pieces");
    // 40 mm at 100 mm/s, then 40 mm at 40 mm/s: it slows down within the first.
    let (fast, slow) = (100.0, 40.0);
    let first = fast / TRAVEL
        + (fast - slow) / TRAVEL
        + (40.0 - (2.0 * fast * fast - slow * slow) / (2.0 * TRAVEL)) / fast;
    let second = slow / TRAVEL + (40.0 - slow * slow / (2.0 * TRAVEL)) / slow;
    near(time_s("G1 X140 F6000\nG1 X180 F2400\n"), first + second, "two speeds");
}

#[test]
fn circle_in_chords_takes_the_way_of_its_chords() {
    // A whole circle of 20 mm radius at 30 mm/s: slow enough that no chord slows it.
    let time = time_s("G1 F1800\nG2 X100 Y100 I-20 J0\n");
    near(time, rest_to_rest(std::f64::consts::TAU * 20.0, 30.0, TRAVEL), "circle");
}

#[test]
fn heating_takes_the_time_of_the_first_order_model() {
    for (target_c, order, [full_c, tau_s]) in
        [(200.0, "M109 S200\n", [420.0, 150.0]), (60.0, "M190 S60\n", [150.0, 300.0])]
    {
        let mut printer = printer();
        ask(&mut printer, order);
        // Within a degree it counts ten seconds; it looks each second.
        let reached_s = -tau_s * ((full_c - (target_c - 1.0)) / (full_c - 21.0_f64)).ln();
        let expected = reached_s.ceil() + 10.0;
        near(printer.now_s(), expected, order);
    }
}

#[test]
fn wire_takes_ten_bits_a_byte_both_ways() {
    for baud in [9600, 115_200, 250_000, 1_000_000] {
        let mut printer = printer_with(&[], Some(baud));
        let start_s = printer.now_s();
        // One after the other: there and back.
        let mut n_bytes = 0;
        for _ in 0..50 {
            let line = "G92 X1 Y2 Z3 E4\n";
            printer.receive(line.as_bytes());
            run(&mut printer);
            n_bytes += line.len() + printer.output().len();
            printer.output().clear();
        }
        let expected = n_bytes as f64 * 10.0 / f64::from(baud);
        assert!((printer.now_s() - start_s - expected).abs() < 1e-9, "{baud}: {}", printer.now_s() - start_s);
        // All at once, no more than the ring holds: the way there only, but for the last answer.
        let start_s = printer.now_s();
        let text = "M107\n".repeat(4);
        let bytes = text.len() as f64;
        printer.receive(text.as_bytes());
        run(&mut printer);
        let back = printer.output().len() as f64 / 4.0;
        let expected = (bytes + back).max(5.0 + 4.0 * back) * 10.0 / f64::from(baud);
        assert!((printer.now_s() - start_s - expected).abs() < 1e-9, "{baud}");
    }
}
