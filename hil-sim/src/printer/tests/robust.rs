//! Whatever strikes whenever: the printer comes to rest in a state with a name, and goes on counting.

use super::{dialects::EACH, *};
use crate::spec::{FaultSpec, Kind};

/// Commands that wait for something, and some that do not.
const COMMANDS: [&str; 18] = [
    "G28",
    "G28 X Y",
    "M109 S200",
    "M190 S60",
    "M104 S0",
    "G4 P700",
    "G1 X50 Y50 Z0.2 F6000",
    "G1 X60 E1 F600",
    "G1 E-2 F2100",
    "G2 X50 Y50 I-5 J0 E1",
    "M400",
    "M600",
    "M0 S3",
    "M108",
    "M410",
    "M112",
    "M84",
    "M110 N7",
];

const KINDS: [&str; 20] = [
    "bit-error",
    "lost-byte",
    "doubled-byte",
    "half-line",
    "lost-ok",
    "spurious-resend",
    "wrong-resend",
    "delay",
    "garbage",
    "disconnect",
    "reset",
    "power-cut",
    "kill",
    "runaway",
    "sensor-open",
    "silent",
    "layer-shift",
    "clog",
    "leak",
    "filament-out",
];

/// Lets an hour go by, with a host that opens the port again and says a little each minute.
fn outlast(printer: &mut Printer) {
    for _ in 0..60 {
        printer.advance_to(printer.now_s() + 60.0);
        if printer.is_plugged() {
            printer.receive(b"\nM108\nM105\n");
        }
        printer.output().clear();
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]
    #[test]
    fn any_faults_at_any_time_leave_a_named_state(
        profile in 0..EACH.len(),
        faults in proptest::collection::vec((0..KINDS.len(), 0_u8..30, 0.0_f64..400.0, 0.0_f64..20.0, any::<bool>()), 0..5),
        commands in proptest::collection::vec((0..COMMANDS.len(), any::<bool>()), 1..25),
    ) {
        let faults: Vec<String> = faults
            .iter()
            .map(|&(kind, line, at_s, for_s, by_line)| {
                let when = if by_line { format!("line={line}") } else { format!("at-s={at_s:.1}") };
                format!("{}:{when},for-s={for_s:.1},count=2", KINDS[kind])
            })
            .collect();
        let mut printer = of_profile(EACH[profile], &faults.iter().map(String::as_str).collect::<Vec<_>>());
        let mut n = printer.receiver.last_line;
        for (command, is_numbered) in commands {
            n += i64::from(is_numbered);
            let text = COMMANDS[command];
            let line = if is_numbered { numbered(n, text) } else { format!("{text}\n") };
            printer.receive(line.as_bytes());
            printer.advance_to(printer.now_s() + 5.0);
        }
        outlast(&mut printer);
        let summary = printer.summary();
        prop_assert!(!summary.last_state.is_empty());
        prop_assert!(summary.simulated_s >= 3600.0);
        prop_assert!(summary.deposited_mm3.is_finite() && summary.hotend_c.iter().all(|c| c.is_finite()));
        // A firmware that has stopped for good heats nothing.
        if summary.last_state == "killed" {
            prop_assert!(!summary.heaters_on, "{faults:?}");
        }
        prop_assert!(printer.queue.len() <= printer.profile.command_slots + 2);
    }
}

#[test]
fn kinds_are_all_there_are() {
    for kind in KINDS {
        assert_eq!(FaultSpec::of_kind(kind).unwrap().kind.name(), kind);
    }
    assert_eq!(FaultSpec::of_kind("filament-out").unwrap().kind, Kind::FilamentOut);
    let message = FaultSpec::of_kind("").unwrap_err();
    assert_eq!(message.split("the kinds are ").nth(1).unwrap().split(", ").count(), KINDS.len());
}
