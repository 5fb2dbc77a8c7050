//! Every cell of the table of faults, brought about in a print on the simulated printer: what is done is what the table says.

use super::super::super::control::Control;
use super::super::*;
use super::rig::{Rig, Setup, clean, is_same};

fn setup() -> Setup {
    let mut setup = Setup::new("marlin", 3, 48);
    setup.profile.firmware.orphan_hold_s = 60.0;
    setup
}

/// A print in that phase; with faults that strike from `at_s` on.
fn brought_to(phase: Phase, setup: Setup) -> Rig {
    let away = |rig: &Rig| matches!(rig.session.stage, Stage::Detached { .. });
    let mut rig = Rig::new(setup);
    if phase == Phase::Greeting {
        return rig;
    }
    assert!(rig.run_until(|rig| rig.laid.len() >= 30));
    match phase {
        Phase::Paused => {
            ask(&mut rig, Control::Pause);
            assert!(rig.run_until(|rig| *rig.session.core.state() == State::Paused));
            pass(&mut rig, 60.0);
        }
        Phase::Stopping => ask(&mut rig, Control::Stop),
        Phase::Detached | Phase::Returned => {
            rig.is_unplugged = true;
            assert!(rig.run_until(away));
            rig.drain(20.0);
            if phase == Phase::Returned {
                rig.is_unplugged = false;
                rig.reconnect();
            }
        }
        Phase::Greeting | Phase::Printing => {}
    }
    assert_eq!(rig.session.phase(), phase);
    rig
}

fn ask(rig: &mut Rig, control: Control) {
    let now = rig.now();
    rig.session.control(now, control);
}

fn pass(rig: &mut Rig, for_s: f64) {
    let until_s = rig.printer.now_s() + for_s;
    rig.run_until(|rig| rig.printer.now_s() >= until_s);
}

/// Makes that trouble happen; false where it cannot in this phase.
fn strike(rig: &mut Rig, phase: Phase, trouble: Trouble) -> bool {
    let is_away = phase == Phase::Detached;
    let now = rig.now();
    match trouble {
        // By somebody else, or by itself.
        Trouble::Halted => rig.printer.receive(b"\nM112\n"),
        Trouble::Reset => rig.printer.switch_off_and_on(),
        Trouble::Silence => rig.is_deaf = true,
        Trouble::Garbage => rig.is_garbled = true,
        Trouble::PortGone => {
            rig.is_unplugged = true;
            rig.session.handle_lost(now);
        }
        Trouble::PortBack if is_away => {
            rig.is_unplugged = false;
            rig.reconnect();
        }
        Trouble::PortBack => rig.session.handle_port(now),
        Trouble::PlaceFound => return phase == Phase::Returned,
        Trouble::PlaceLost if phase == Phase::Returned => {
            rig.printer.receive(b"\nG91\nG1 X5\n");
            rig.drain(5.0);
        }
        Trouble::PlaceLost => return false,
        Trouble::PortShared if phase == Phase::Greeting => rig.is_echo = true,
        // Another host greets the printer.
        Trouble::PortShared => rig.printer.receive(b"\nM110 N5000\n"),
        // It stands and waits for its user, unheard.
        Trouble::FilamentOut if is_away => rig.printer.receive(b"\nM600\n"),
        Trouble::FilamentOut => rig.session.handle_bytes(now, b"//action:pause filament_runout 0\n"),
        Trouble::StopRequested => ask(rig, Control::Stop),
        Trouble::EmergencyStop => ask(rig, Control::EmergencyStop),
        // A fault of the setup.
        Trouble::Stuck => {}
    }
    // In a pause nothing is sent that could be refused.
    if phase == Phase::Paused && matches!(trouble, Trouble::PortShared | Trouble::Stuck) {
        pass(rig, 10.0);
        assert_eq!(*rig.session.core.state(), State::Paused);
        ask(rig, Control::GoOn);
    }
    true
}

/// The end of a print that was given up: heaters-off was sent, and what is said of them is true.
fn assert_given_up(rig: &mut Rig, trouble: Trouble, what: &str) {
    let n_sent = rig.sent.len();
    let end = rig.run();
    let End::Faulted(fault) = end else { panic!("{what}: {end:?}") };
    let found = Trouble::of(&fault);
    // Where nothing gets through either way it is silence; another's numbers are another place.
    let also = match trouble {
        Trouble::Stuck => Trouble::Silence,
        Trouble::PortShared => Trouble::PlaceLost,
        other => other,
    };
    assert!(found == trouble || found == also, "{what}: {fault}");
    let sent = String::from_utf8_lossy(&rig.sent[n_sent..]).into_owned();
    assert!(sent.contains("M104 S0") && sent.contains("M140 S0"), "{what}: {sent}");
    assert_eq!(
        sent.contains("M112"),
        trouble == Trouble::EmergencyStop || rig.session.heat().is_on(),
        "{what}"
    );
    let is_off = rig.printer.summary().hotend_c[1] <= 0.0;
    assert!(is_off || !rig.session.heat().is_safe(), "{what}: {:?}", rig.session.heat());
    let is_deaf = matches!(trouble, Trouble::Silence | Trouble::Garbage | Trouble::Stuck) || rig.is_echo;
    assert!(is_deaf || rig.session.heat().is_safe(), "{what}: {:?}", rig.session.heat());
}

/// Nothing but the phase's own course.
fn assert_own_course(rig: &mut Rig, phase: Phase, what: &str) {
    match phase {
        Phase::Greeting | Phase::Printing | Phase::Returned => {
            let end = rig.run();
            assert!(matches!(end, End::Finished), "{what}: {end:?}");
        }
        Phase::Stopping => assert!(matches!(rig.run(), End::Cancelled), "{what}"),
        Phase::Paused => {
            pass(rig, 2.0);
            assert_eq!(rig.session.phase(), phase, "{what}");
        }
        Phase::Detached => {
            rig.drain(2.0);
            assert_eq!(rig.session.phase(), phase, "{what}");
        }
    }
}

fn check(phase: Phase, trouble: Trouble) {
    let what = format!("{phase:?} x {trouble:?}");
    let mut setup = setup();
    if trouble == Trouble::Stuck {
        // Nothing whole gets through from then on.
        let at_s = brought_to(phase, setup.clone()).printer.now_s();
        setup = setup.with(&format!("bit-error:at-s={at_s},rate=1"));
    }
    let mut rig = brought_to(phase, setup);
    let n_sent = rig.sent.len();
    if !strike(&mut rig, phase, trouble) {
        assert_eq!(policy::action(phase, trouble), Action::Nothing, "{what}");
        return;
    }
    assert_as_the_table_says(&mut rig, phase, trouble, n_sent, &what);
}

/// What is done, of all that was sent behind the first `n_sent` bytes.
fn assert_as_the_table_says(rig: &mut Rig, phase: Phase, trouble: Trouble, n_sent: usize, what: &str) {
    match policy::action(phase, trouble) {
        Action::GiveUp | Action::StopAtOnce => assert_given_up(rig, trouble, what),
        Action::Leave => {
            assert!(matches!(rig.run(), End::Left), "{what}");
            assert_eq!(rig.sent.len(), n_sent, "{what}");
        }
        Action::Await => {
            pass(rig, 1.0);
            assert!(rig.events.iter().any(|e| matches!(e, PrintEvent::PortLost { .. })), "{what}");
            assert!(matches!(rig.session.stage, Stage::Detached { .. }), "{what}");
        }
        Action::Ask => assert_eq!(rig.session.phase(), Phase::Returned, "{what}"),
        Action::GoOn => {
            assert!(matches!(rig.run(), End::Finished), "{what}");
            assert!(rig.events.iter().any(|e| matches!(e, PrintEvent::WentOn { .. })), "{what}");
            assert!(is_same(&rig.laid, &clean(&setup())), "{what}");
        }
        Action::Pause => {
            assert!(rig.run_until(|rig| *rig.session.core.state() == State::Paused), "{what}");
            assert!(rig.printer.summary().hotend_c[1] > 0.0, "{what}");
            assert!(rig.events.contains(&PrintEvent::Session(Event::Paused)), "{what}");
        }
        Action::Stop => {
            let end = rig.run();
            assert!(matches!(end, End::Cancelled), "{what}: {end:?}");
            assert!(rig.printer.summary().hotend_c[1] <= 0.0, "{what}");
        }
        Action::GiveUpUnknown => {
            let end = rig.run();
            assert!(matches!(end, End::Faulted(Fault::LinkLost)), "{what}: {end:?}");
            assert!(matches!(rig.session.heat(), Heat::Unknown(_)), "{what}");
        }
        Action::Nothing => assert_own_course(rig, phase, what),
    }
}

fn check_all(trouble: Trouble) {
    Phase::ALL.into_iter().for_each(|phase| check(phase, trouble));
}

#[test]
fn a_printer_that_has_stopped_for_good() {
    check_all(Trouble::Halted);
}

#[test]
fn a_firmware_that_starts_anew() {
    check_all(Trouble::Reset);
}

#[test]
fn a_printer_that_says_nothing_any_more() {
    check_all(Trouble::Silence);
}

#[test]
fn a_port_that_is_gone_or_back() {
    check_all(Trouble::PortGone);
    check_all(Trouble::PortBack);
}

#[test]
fn a_place_that_is_found_or_lost() {
    check_all(Trouble::PlaceFound);
    check_all(Trouble::PlaceLost);
}

#[test]
fn noise_and_another_program() {
    check_all(Trouble::Garbage);
    check_all(Trouble::PortShared);
}

#[test]
fn filament_that_has_run_out() {
    check_all(Trouble::FilamentOut);
}

#[test]
fn a_stop_that_is_asked_for() {
    check_all(Trouble::StopRequested);
    check_all(Trouble::EmergencyStop);
}

#[test]
fn a_line_that_does_not_get_through() {
    check_all(Trouble::Stuck);
}

#[test]
fn a_profile_of_another_firmware_prints_nothing() {
    let names = ["marlin", "klipper", "reprapfirmware", "repetier", "smoothie"];
    for printer in names {
        for profile in names.into_iter().chain(["marlin1"]) {
            let mut setup = Setup::new(printer, 2, 24);
            let firmware = crate::profile::builtin(profile).unwrap().firmware;
            let is_same = firmware.dialect == setup.profile.firmware.dialect;
            setup.profile.firmware = firmware;
            let mut rig = Rig::new(setup);
            let end = rig.run();
            let what = format!("{profile} on {printer}: {end:?}");
            let is_refused = matches!(&end, End::Faulted(fault) if fault.next_step().contains("profile"));
            let is_known = matches!(&end, End::Faulted(Fault::OtherFirmware { .. }));
            let fits = is_same || (profile, printer) == ("marlin1", "marlin");
            assert_eq!((matches!(end, End::Finished), is_refused), (fits, !fits), "{what}");
            assert!(!is_known || rig.session.heat().is_safe(), "{what}: {:?}", rig.session.heat());
            assert!(rig.printer.summary().hotend_c[1] <= 0.0, "{what}");
            assert_eq!(rig.laid.is_empty(), !fits, "{what}");
        }
    }
}

/// Also where the journal is waited for first, and the answer is lost.
#[test]
fn a_printer_that_does_not_say_what_it_is_is_believed_after_a_while() {
    for (disk_s, faults) in [(2.9, &[][..]), (0.0, &["lost-ok:line=3"]), (0.0, &["silent:line=3,for-s=4"])] {
        let mut setup = faults.iter().fold(Setup::new("marlin", 2, 24), |setup, fault| setup.with(fault));
        let expected = clean(&setup);
        setup.seed = 3;
        let mut rig = Rig::new(setup);
        rig.disk_s = disk_s;
        rig.ends_as(&expected, &format!("{disk_s} {faults:?}"));
    }
}
