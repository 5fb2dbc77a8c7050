//! Whatever breaks a print off: the host dies, the cable is pulled, the firmware starts anew, the power fails. A sample here;
//! all of them by `cargo test --release --lib printer::session::tests::crash -- --ignored`.

use super::super::*;
use super::rig::{Laid, Rig, Setup, clean, is_same};
use crate::printer::journal::writer::Journal;
use crate::printer::journal::{Log, path_for};
use hil_sim::rng::Rng;

/// Those that number their lines, and the one that does not.
const FIRMWARES: [&str; 4] = ["marlin", "marlin1", "reprapfirmware", "klipper"];
/// Those that can be told where Z is.
const RECOVERING: [&str; 4] = ["marlin", "marlin1", "smoothie", "repetier"];

/// Layers of a quarter of a minute.
fn setup_for(firmwares: [&str; 4], n: u64) -> Setup {
    let firmware = firmwares[usize::try_from(n).unwrap() % firmwares.len()];
    Setup { seed: n + 1, ..Setup::at_speed(firmware, 4, 300, 240) }
}

/// When the first bead is begun and the last one is laid, s.
fn span(setup: &Setup) -> [f64; 2] {
    let mut rig = Rig::new(setup.clone());
    assert!(rig.run_until(|rig| !rig.laid.is_empty()));
    let first_s = rig.printer.now_s();
    assert!(matches!(rig.run(), End::Finished));
    [first_s, rig.printer.now_s()]
}

/// A moment of the print, by number.
fn moment([from_s, to_s]: [f64; 2], n: u64) -> f64 {
    let share = Rng::new(n, 77).below(100_000) as f64 / 100_000.0;
    (to_s - from_s).mul_add(share, from_s)
}

fn host_dies(n: u64) {
    let setup = setup_for(FIRMWARES, n);
    let at_s = moment(span(&setup), n);
    let mut rig = Rig::new(setup.clone());
    if !rig.run_until(|rig| rig.printer.now_s() >= at_s) {
        return;
    }
    rig.drain(3.0);
    // The journal on the disk is up to a second behind the host's death.
    rig.resume(3.0 + 0.1 * (n % 10) as f64, false);
    let end = rig.run();
    assert!(matches!(end, End::Finished), "{n}: {end:?}");
    assert!(is_same(&rig.laid, &clean(&setup)), "{n} at {at_s} s");
}

fn cable_is_pulled(n: u64) {
    let setup = setup_for(FIRMWARES, n);
    let at_s = moment(span(&setup), n);
    let mut rig = Rig::new(setup.clone().with(&format!("disconnect:at-s={at_s},for-s=30")));
    let end = rig.run();
    assert!(matches!(end, End::Finished), "{n}: {end:?}");
    assert!(is_same(&rig.laid, &clean(&setup)), "{n} at {at_s} s");
}

fn same(a: &Laid, b: &Laid) -> bool {
    is_same(std::slice::from_ref(a), std::slice::from_ref(b))
}

/// Resumed after a reset: every bead is there, and no more twice than was said.
fn is_recovered(n: u64, mut rig: Rig, expected: &[Laid], lost_s: f64) {
    let known = rig.known(lost_s);
    rig.resume(lost_s, false);
    let stated = match rig.run() {
        End::NeedsConsent(recovery) => recovery,
        End::Refused(Refusal::HeightUnknown { .. }) if changes_layer(&rig, &known) => return,
        End::Refused(Refusal::NothingPrinted { .. }) if known.progress.n_certain < 20 => return,
        // It broke off when all was done but the end script.
        End::Finished => return,
        other => panic!("{n}: {other:?} {known:?}"),
    };
    rig.resume(lost_s, true);
    let end = rig.run();
    assert!(matches!(end, End::Finished), "{n}: {end:?} after {stated:?}");
    for bead in expected {
        assert!(rig.laid.iter().any(|laid| same(laid, bead)), "{n}: {bead:?} is missing after {stated:?}");
    }
    let volume = |laid: &[Laid]| laid.iter().map(|bead| bead.2).sum::<f64>();
    let twice = volume(&rig.laid) - volume(expected);
    let most = stated.twice_mm * 0.4 * 0.2 * 1.01 + 1e-3;
    assert!(twice <= most, "{n}: {twice} mm³ twice, {most} stated: {stated:?}");
}

/// Whether the lines in doubt reach over a change of layer.
fn changes_layer(rig: &Rig, known: &Known) -> bool {
    let mut job = rig.setup.job();
    let (mut n, mut lifts) = (0, false);
    let last = known.progress.n_sent + if known.is_behind { 3000 } else { 0 };
    job.replay(last, |command| {
        n += 1;
        lifts |= n > known.progress.n_certain && command.contains('Z');
    })
    .unwrap();
    lifts
}

fn firmware_resets(n: u64) {
    let setup = setup_for(RECOVERING, n);
    let at_s = moment(span(&setup), n);
    let mut rig = Rig::new(setup.clone().with(&format!("reset:at-s={at_s}")));
    let end = rig.run();
    if matches!(end, End::Finished) {
        return;
    }
    assert!(matches!(end, End::Faulted(Fault::FirmwareReset)), "{n}: {end:?}");
    is_recovered(n, rig, &clean(&setup), 0.0);
}

fn power_fails(n: u64) {
    let setup = setup_for(RECOVERING, n);
    let at_s = moment(span(&setup), n);
    let mut rig = Rig::new(setup.clone().with(&format!("reset:at-s={at_s}")));
    if !rig.run_until(|rig| rig.printer.now_s() >= at_s) {
        return;
    }
    rig.drain(0.1);
    is_recovered(n, rig, &clean(&setup), 0.1 + 0.1 * (n % 9) as f64);
}

#[test]
fn a_host_that_dies_anywhere_is_resumed_exactly() {
    (0..8).for_each(host_dies);
}

#[test]
fn a_cable_that_is_pulled_anywhere_leaves_no_trace() {
    (0..8).for_each(cable_is_pulled);
}

#[test]
fn a_firmware_that_resets_anywhere_is_recovered_as_stated() {
    (0..8).for_each(firmware_resets);
}

#[test]
fn a_power_cut_anywhere_is_recovered_as_stated() {
    (0..8).for_each(power_fails);
}

#[test]
#[ignore = "the full set: a minute"]
fn two_hundred_deaths_of_the_host() {
    (0..200).for_each(host_dies);
}

#[test]
#[ignore = "the full set: a minute"]
fn two_hundred_pulled_cables() {
    (0..200).for_each(cable_is_pulled);
}

#[test]
#[ignore = "the full set: a minute"]
fn a_hundred_resets() {
    (0..100).for_each(firmware_resets);
}

#[test]
#[ignore = "the full set: a minute"]
fn a_hundred_power_cuts() {
    (0..100).for_each(power_fails);
}

#[test]
fn klipper_cannot_be_told_where_z_is_and_says_so() {
    let mut rig = Rig::new(Setup::new("klipper", 3, 100).with("reset:line=200"));
    let end = rig.run();
    assert!(matches!(end, End::Faulted(Fault::FirmwareReset | Fault::Halted { .. })), "{end:?}");
    rig.resume(0.0, true);
    let end = rig.run();
    assert!(matches!(end, End::Refused(Refusal::NoScript { .. })), "{end:?}");
}

#[test]
fn the_journal_on_disk_tells_the_same_as_the_session() {
    let setup = Setup::new("marlin", 3, 40);
    let dir = tempfile::tempdir().unwrap();
    let path = path_for(&dir.path().join("rings.gcode"));
    let mut rig = Rig::new(setup.with("reset:line=120"));
    assert!(matches!(rig.run(), End::Faulted(Fault::FirmwareReset)));
    let first: Vec<_> = rig.records.iter().take(2).map(|(_, record)| record.clone()).collect();
    let journal = Journal::create(&path, &first).unwrap();
    for (_, record) in rig.records.iter().skip(2) {
        assert!(journal.append(record));
        journal.flush();
    }
    drop(journal);
    assert_eq!(Known::from(&Log::read(&path).unwrap()), rig.known(0.0));
}
