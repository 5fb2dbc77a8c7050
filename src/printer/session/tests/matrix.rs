//! The fault matrix: every fault of the simulator, every firmware, three windows, on one made-up clock.
//!
//! (`reprapfirmware-silent` asks for no line again, as RepRapFirmware does from 3.6 on.)
//!
//! `cargo test --release --lib fault_matrix -- --nocapture` prints it; with `UPDATE_GOLDEN=1` it is written anew into
//! `tests/golden/fault_matrix.txt`.

use super::super::*;
use super::rig::{Laid, Rig, Setup, clean, is_same};
use std::fmt::Write as _;

const FIRMWARES: [&str; 8] = [
    "marlin",
    "marlin1",
    "prusa-mk3s",
    "repetier",
    "reprapfirmware",
    "reprapfirmware-silent",
    "smoothie",
    "klipper",
];

/// Faults that must leave no trace.
const OF_THE_WIRE: [&str; 19] = [
    "bit-error:rate=0.02",
    "bit-error:rate=0.02,dir=tx",
    "lost-byte:rate=0.02",
    "lost-byte:rate=0.02,dir=tx",
    "doubled-byte:rate=0.02",
    "doubled-byte:rate=0.02,dir=tx",
    "half-line:line=70",
    "half-line:line=70,dir=tx",
    "lost-ok:rate=0.02",
    "spurious-resend:rate=0.02",
    "wrong-resend:rate=0.02",
    "delay:rate=0.01",
    "delay:rate=0.01,dir=tx",
    "garbage:rate=0.02",
    "garbage:rate=0.02,dir=tx",
    "bit-error:rate=0.02 + lost-ok:rate=0.02",
    "bit-error:rate=0.02 + bit-error:rate=0.02,dir=tx",
    "lost-byte:rate=0.02 + delay:rate=0.01,dir=tx",
    "delay:rate=0.01 + half-line:line=70,dir=tx",
];

/// Faults that must end in a named state, or in going on exactly.
const OF_THE_MACHINE: [&str; 15] = [
    "disconnect:line=70,for-s=10",
    "disconnect:line=70",
    "reset:line=70",
    "kill:line=70",
    "runaway:line=10",
    "sensor-open:line=70",
    "silent:line=70,for-s=5",
    "silent:line=70",
    "filament-out:line=70",
    "disconnect:line=70,for-s=10 + reset:line=72",
    "silent:line=70,for-s=5 + kill:line=75",
    "host: wrong baud",
    "host: an echo",
    "host: another host greets",
    "host: asked to stop",
];

/// How long the port is waited for here, s.
const HOLD_S: f64 = 40.0;
/// The protocol's own time-out for silence, s.
const SILENCE_S: f64 = 22.5;

const LEGEND: &str = "\
Each cell: no more than one line in flight, the profile's window at 250,000 baud, unlimited.
=   every move once, the deposition of the clean print
>   the same, after going on by itself where the port came back
~   printed to the end, but not the same, which nothing told the host: firmware that executes what has no checksum, no filament sensor
P   paused, the heaters on, the operator told (p: every line was with the printer already)
G   the port did not come back in time: given up, the heaters left to the firmware's own time-out, the operator told
R H S C  given up with heaters off: reset, halted, silent, a command refused by firmware without line numbers
L   given up with heaters off: the port is back, but the printer is not where the print was
N E U    given up: nothing but noise, an echo, lines of another host
X   stopped as asked, the heaters off
";

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Window {
    One,
    Profile,
    Unlimited,
}

fn setup_for(firmware: &str, window: Window, fault: &str) -> Setup {
    let mut setup = Setup::new(firmware, 2, 40);
    if !fault.starts_with("host: ") {
        setup = fault.split(" + ").fold(setup, Setup::with);
    }
    setup.profile.firmware.orphan_hold_s = HOLD_S;
    match window {
        Window::One => setup.profile.firmware.rx_buffer_bytes = 32,
        // Klipper's terminal is no wire.
        Window::Profile if firmware == "klipper" => {}
        Window::Profile => setup.baud = Some(250_000),
        Window::Unlimited => setup.profile.firmware.rx_buffer_bytes = 1 << 20,
    }
    setup
}

/// What became of the print, as one sign; everything that must hold of it is asserted.
fn outcome(setup: Setup, fault: &str, expected: &[Laid]) -> char {
    let what = format!("{} {fault} {:?}", setup.profile.name, setup.profile.firmware.rx_buffer_bytes);
    let must_leave_no_trace = OF_THE_WIRE.contains(&fault) && setup.profile.firmware.line_numbers;
    let mut rig = Rig::new(setup);
    befall(&mut rig, fault);
    let is_paused = |event: &PrintEvent| *event == PrintEvent::Session(Event::Paused);
    if rig.run_until(|rig| rig.events.iter().any(is_paused)) {
        return paused(&rig, &what);
    }
    match rig.run() {
        End::Finished => finished(&rig, must_leave_no_trace, expected, &what),
        End::Cancelled => {
            assert!(rig.printer.summary().hotend_c[1] <= 0.0, "{what}: still hot");
            'X'
        }
        End::Faulted(end) => {
            assert!(!must_leave_no_trace, "{what}: {end}");
            given_up(&mut rig, &end, OF_THE_WIRE.contains(&fault), &what)
        }
        end => panic!("{what}: {end:?}"),
    }
}

fn paused(rig: &Rig, what: &str) -> char {
    let PrintEvent::Progress { n_lines_done, n_lines } = rig.session.progress() else { unreachable!() };
    if n_lines_done == n_lines {
        return 'p';
    }
    assert!(rig.printer.summary().hotend_c[1] > 0.0, "{what}: a pause keeps the heat");
    'P'
}

fn finished(rig: &Rig, must_leave_no_trace: bool, expected: &[Laid], what: &str) -> char {
    let same = is_same(&rig.laid, expected);
    let n_twice = rig.printer.summary().repeated_move_lines;
    assert!(n_twice == 0 || !same, "{what}: {n_twice} moves were taken twice");
    assert!(same || !must_leave_no_trace, "{what}: another deposition");
    let went_on = rig.events.iter().any(|event| matches!(event, PrintEvent::WentOn { .. }));
    match (same, went_on) {
        (false, _) => '~',
        (true, true) => '>',
        (true, false) => '=',
    }
}

fn given_up(rig: &mut Rig, fault: &Fault, is_of_the_wire: bool, what: &str) -> char {
    assert_no_move_twice(rig, what);
    // Damage that no checksum finds shows when the firmware cannot do what has become of the line.
    if !is_of_the_wire {
        let decided_s = rig.gave_up_s.unwrap_or(rig.printer.now_s());
        assert_decided_in_time(rig, fault, decided_s, what);
    }
    assert_heaters(rig, fault, what);
    match fault {
        Fault::LinkLost => 'G',
        Fault::FirmwareReset => 'R',
        Fault::Halted { .. } => 'H',
        Fault::Silent { .. } => 'S',
        Fault::NoAnswer { is_garbled: true } => 'N',
        Fault::CommandRefused { .. } => 'C',
        Fault::Echo => 'E',
        Fault::LostPlace { .. } => 'L',
        Fault::LineUnavailable { .. } => 'U',
        other => panic!("{what}: {other}"),
    }
}

/// What is no fault of the simulated printer's.
fn befall(rig: &mut Rig, fault: &str) {
    match fault {
        "host: wrong baud" => rig.is_garbled = true,
        "host: an echo" => rig.is_echo = true,
        "host: another host greets" => {
            assert!(rig.run_until(|rig| rig.laid.len() >= 10));
            rig.printer.receive(b"\nM110 N5000\n");
        }
        "host: asked to stop" => {
            assert!(rig.run_until(|rig| rig.laid.len() >= 10));
            let now = rig.now();
            rig.session.cancel(now);
        }
        _ => {}
    }
}

/// No bead is laid a second time.
fn assert_no_move_twice(rig: &Rig, what: &str) {
    let twice = rig.laid.iter().enumerate().find(|(i, bead)| {
        rig.laid[..*i].iter().any(|other| is_same(std::slice::from_ref(*bead), std::slice::from_ref(other)))
    });
    assert!(twice.is_none(), "{what}: {twice:?} is laid twice");
}

/// Within two seconds of the time-out that is due, counted from the fault.
fn assert_decided_in_time(rig: &Rig, fault: &Fault, decided_s: f64, what: &str) {
    let kinds = rig.setup.faults.iter().map(|fault| fault.split(':').next().unwrap());
    // The firmware's own protection looks for a while before it strikes: then that counts.
    let last = |wanted: &str| rig.states.iter().rev().find(|(_, name)| name == wanted).map(|(at_s, _)| *at_s);
    let struck = last("killed").or_else(|| last("heater-fault"));
    let struck = struck.or_else(|| kinds.filter_map(last).reduce(f64::max));
    let Some(struck_s) = struck else { return };
    let due_s = match fault {
        Fault::LinkLost => HOLD_S,
        Fault::Silent { .. } => SILENCE_S,
        // What happens while the port is away shows when it is back.
        _ if rig.setup.faults.iter().any(|fault| fault.starts_with("disconnect")) => 10.0,
        _ => 0.0,
    };
    assert!(decided_s - struck_s <= due_s + 2.0, "{what}: {fault} after {:.1} s", decided_s - struck_s);
}

/// Off wherever somebody is there to be told, and what the operator reads of it is true.
fn assert_heaters(rig: &mut Rig, fault: &Fault, what: &str) {
    let is_off = rig.printer.summary().hotend_c[1] <= 0.0;
    let heat = rig.session.heat();
    match (fault, heat) {
        (Fault::LinkLost, Heat::Unknown(_)) => {}
        // It neither hears nor says anything.
        (Fault::Silent { .. } | Fault::NoAnswer { .. } | Fault::Echo, Heat::Unknown(_)) => {}
        (_, Heat::Off(_)) | (Fault::Halted { .. }, Heat::Halted) => assert!(is_off, "{what}: still hot"),
        _ => panic!("{what}: {fault}: {heat:?}"),
    }
}

fn row(fault: &str, expected: &[Vec<Laid>]) -> String {
    let mut text = format!("{fault:<49}");
    for (firmware, expected) in FIRMWARES.iter().zip(expected) {
        let cell: String = [Window::One, Window::Profile, Window::Unlimited]
            .map(|window| outcome(setup_for(firmware, window, fault), fault, expected))
            .iter()
            .collect();
        write!(text, " {cell:<21}").unwrap();
    }
    text.trim_end().to_owned()
}

#[test]
#[expect(clippy::print_stdout, reason = "the table is what the command is for")]
fn fault_matrix() {
    let expected: Vec<_> = FIRMWARES.iter().map(|firmware| clean(&Setup::new(firmware, 2, 40))).collect();
    let mut text = format!("{LEGEND}\n{:<49}", "");
    for firmware in FIRMWARES {
        write!(text, " {firmware:<21}").unwrap();
    }
    text = text.trim_end().to_owned() + "\n";
    for fault in OF_THE_WIRE.into_iter().chain(OF_THE_MACHINE) {
        text += &row(fault, &expected);
        text.push('\n');
    }
    println!("{text}");
    let golden = "tests/golden/fault_matrix.txt";
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        // From src/printer/session/tests to the package.
        let root = std::path::Path::new(file!()).ancestors().nth(5).unwrap();
        std::fs::write(root.join(golden), &text).unwrap();
        return;
    }
    assert_eq!(text, include_str!("../../../../tests/golden/fault_matrix.txt"), "see the head of this file");
}
