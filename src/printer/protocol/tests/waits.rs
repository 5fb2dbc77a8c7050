//! `<state>_<event>_<result>`: lines that take their minutes, on firmware that says nothing meanwhile.

use super::super::*;
use super::desk::Desk;

/// A core for that firmware in the middle of a job whose only line is `line`.
fn at_work(profile: &str, line: &str) -> Desk {
    let profile = crate::profile::builtin(profile).unwrap();
    let mut desk = Desk { core: Core::new(&profile), now: Instant::default() };
    desk.command(Command::Inquire { beyond: 0 }).written();
    desk.hear(&["ok T:20.0 /0.0 B:20.0 /0.0"]);
    desk.command(Command::GoOn).command(Command::Line(line));
    while desk.written().iter().all(|sent| !sent.contains(line)) {
        desk.hear(&["ok"]);
    }
    desk
}

#[test]
fn streaming_macro_of_a_firmware_without_busy_takes_its_minutes() {
    for line in ["START_PRINT BED=60", "QUAD_GANTRY_LEVEL", "G32"] {
        let mut desk = at_work("klipper", line);
        desk.wait(5.0).hear(&["// probe at 10,10 is z=0.1"]).wait(600.0);
        assert_eq!(desk.core.state(), &State::Streaming, "{line}");
    }
}

#[test]
fn streaming_dwell_is_given_its_own_time() {
    let mut desk = at_work("klipper", "G4 P3600000");
    desk.wait(3700.0);
    assert_eq!(desk.core.state(), &State::Streaming);
    desk.wait(1800.0);
    assert!(matches!(desk.core.state(), State::Faulted(_)), "but not more");
}
