//! Whatever breaks a print off: the host dies, the cable is pulled, the firmware starts anew, the power fails. A sample here;
//! all of them by `cargo test --release --lib printer::session::tests::crash -- --ignored --nocapture`, which tells the figures.
//!
//! The job is of the slicer's kind ([`super::vessel`]). What lies on the bed at the end is compared with a clean print on every
//! way out; what is refused is counted, by its reason, and bounded.

use super::super::*;
use super::deposit::{least_iou, volumes};
use super::rig::{Laid, Rig, Setup, clean, is_same};
use super::vessel::{self, LAYER_MM, WIDTH_MM};
use crate::printer::journal::writer::Journal;
use crate::printer::journal::{self, Log, encode, header, path_for};
use hil_sim::rng::Rng;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};

/// Those that number their lines, and the one that does not.
const FIRMWARES: [&str; 5] = ["marlin", "marlin1", "repetier", "prusa-mk3s", "klipper"];
/// Those that can be told where Z is.
const RECOVERING: [&str; 4] = ["marlin", "marlin1", "smoothie", "repetier"];

/// What is printed: [`vessel::filled`] or [`vessel::wall`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Shape {
    Filled,
    Wall,
}

impl Shape {
    fn job(self, profile: &Profile) -> String {
        match self {
            Self::Filled => vessel::filled(profile, 4),
            Self::Wall => vessel::wall(profile, 12),
        }
    }
}

/// How an interruption came out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Outcome {
    /// It came when all was done.
    Finished,
    Exact,
    Recovered,
    Refused(&'static str),
}

/// Every second one on the profile's wire, the others on a link that takes no time.
fn setup_for(shape: Shape, firmwares: &[&str], n: u64) -> Setup {
    let n_of = firmwares.len() as u64;
    let firmware = firmwares[usize::try_from(n % n_of).unwrap()];
    let profile = crate::profile::builtin(firmware).unwrap();
    let baud = (n / n_of % 2 == 1).then_some(profile.firmware.baud);
    Setup { job: shape.job(&profile), profile, faults: Vec::new(), baud, seed: n + 1 }
}

/// A print without faults, and when its first bead is begun and its last one laid, s.
#[derive(Debug)]
struct Clean {
    laid: Vec<Laid>,
    span_s: [f64; 2],
}

/// Clean prints by shape, firmware and link.
type CleanPrints = BTreeMap<(Shape, String, Option<u32>), Arc<Clean>>;

/// One for each of them.
fn clean_of(shape: Shape, setup: &Setup) -> Arc<Clean> {
    static KNOWN: Mutex<CleanPrints> = Mutex::new(BTreeMap::new());
    let mut known = KNOWN.lock().unwrap();
    let made = known.entry((shape, setup.profile.name.clone(), setup.baud)).or_insert_with(|| {
        let mut rig = Rig::new(Setup { seed: 1, ..setup.clone() });
        assert!(rig.run_until(|rig| !rig.laid.is_empty()));
        let first_s = rig.printer.now_s();
        assert!(matches!(rig.run(), End::Finished));
        let span_s = [first_s, rig.printer.now_s()];
        Arc::new(Clean { laid: rig.laid, span_s })
    });
    Arc::clone(made)
}

/// A share by number, for one of several purposes.
fn share(n: u64, of: u64) -> f64 {
    Rng::new(n, of).below(100_000) as f64 / 100_000.0
}

/// A moment of the print, by number.
fn moment(clean: &Clean, n: u64) -> f64 {
    let [from_s, to_s] = clean.span_s;
    (to_s - from_s).mul_add(share(n, 77), from_s)
}

/// What the disk holds when the host is gone.
#[derive(Debug, Clone, Copy)]
enum Disk {
    /// All but the last `lost_s`.
    Behind { lost_s: f64 },
    /// The same, and half of the next record.
    Torn { lost_s: f64 },
    /// Nothing of the last `full_s`, in which it had no room, but a first half.
    Full { full_s: f64 },
}

impl Disk {
    /// The journal of a host that died `ago_s` ago.
    fn known(self, rig: &Rig, ago_s: f64) -> Known {
        let (Self::Behind { lost_s } | Self::Torn { lost_s } | Self::Full { full_s: lost_s }) = self;
        let until_s = rig.printer.now_s() - ago_s - lost_s;
        let mut bytes = header();
        let mut is_torn = matches!(self, Self::Behind { .. });
        for (at_s, record) in &rig.records {
            if *at_s <= until_s || !matches!(record, Record::Progress(_) | Record::End(_)) {
                bytes.extend(encode(&measured(record, lost_s)));
            } else if !is_torn {
                let record = encode(record);
                bytes.extend(&record[..record.len() / 2]);
                is_torn = true;
            }
        }
        Known::from(&Log::parse(&bytes, Path::new("vessel.gcode.journal")).unwrap())
    }
}

/// A record that tells how long the disk takes.
fn measured(record: &Record, delay_s: f64) -> Record {
    match record {
        Record::Progress(progress) => {
            Record::Progress(journal::Progress { delay_s: delay_s.max(0.005), ..*progress })
        }
        other => other.clone(),
    }
}

fn host_dies(shape: Shape, n: u64) -> Outcome {
    let setup = setup_for(shape, &FIRMWARES, n);
    let clean = clean_of(shape, &setup);
    let at_s = moment(&clean, n);
    let mut rig = Rig::new(setup);
    assert!(rig.run_until(|rig| rig.printer.now_s() >= at_s));
    rig.dies_at = Some(share(n, 78));
    if !rig.run_until(|rig| rig.is_dead) {
        return finished(n, rig, &clean);
    }
    rig.printer.host_left();
    let ago_s = 3.0;
    rig.drain(ago_s);
    let lost_s = 0.1 * (n % 10) as f64;
    let disk = match n % 3 {
        0 => Disk::Behind { lost_s },
        1 => Disk::Torn { lost_s },
        _ => Disk::Full { full_s: 5.0 },
    };
    let known = disk.known(&rig, ago_s);
    rig.resume_by(known, false);
    match rig.run() {
        End::Finished => {}
        End::Refused(refusal) => return Outcome::Refused(refusal.code()),
        end => panic!("{n}: {end:?} {}", rig.setup.profile.name),
    }
    assert!(is_same(&rig.laid, &clean.laid), "{n} {} at {at_s} s", rig.setup.profile.name);
    Outcome::Exact
}

/// It came too late to break anything off.
fn finished(n: u64, mut rig: Rig, clean: &Clean) -> Outcome {
    let end = rig.run();
    assert!(matches!(end, End::Finished), "{n}: {end:?}");
    assert!(is_same(&rig.laid, &clean.laid), "{n}");
    Outcome::Finished
}

fn cable_is_pulled(shape: Shape, n: u64) -> Outcome {
    let setup = setup_for(shape, &FIRMWARES, n);
    let clean = clean_of(shape, &setup);
    let at_s = moment(&clean, n);
    let mut rig = Rig::new(setup.with(&format!("disconnect:at-s={at_s},for-s=30")));
    let end = rig.run();
    assert!(matches!(end, End::Finished), "{n} {}: {end:?}", rig.setup.profile.name);
    assert!(is_same(&rig.laid, &clean.laid), "{n} {} at {at_s} s", rig.setup.profile.name);
    Outcome::Exact
}

/// Resumed after a reset: each layer is that of the clean print, but for what was said.
fn is_recovered(n: u64, mut rig: Rig, clean: &Clean, disk: Disk) -> Outcome {
    let known = disk.known(&rig, 0.0);
    rig.resume_by(known.clone(), false);
    let stated = match rig.run() {
        End::NeedsConsent(recovery) => recovery,
        End::Refused(refusal) => return Outcome::Refused(refusal.code()),
        // It broke off when all was done but the end script.
        End::Finished => {
            assert!(is_same(&rig.laid, &clean.laid), "{n}");
            return Outcome::Finished;
        }
        other => panic!("{n}: {other:?} {known:?}"),
    };
    rig.resume_by(known, true);
    let end = rig.run();
    assert!(matches!(end, End::Finished), "{n}: {end:?} after {stated:?}");
    let (found, expected) = (volumes(&rig.laid), volumes(&clean.laid));
    let stated_mm3 = stated.twice_mm * WIDTH_MM * LAYER_MM * 1.01;
    assert!(found.keys().eq(expected.keys()), "{n}: {found:?} {expected:?} after {stated:?}");
    let mut twice_mm3 = 0.0;
    for (z_um, &mm3) in &expected {
        let ratio = found[z_um] / mm3;
        let most = 1.01 + stated_mm3 / mm3;
        assert!((0.99..=most).contains(&ratio), "{n}: {ratio} of Z {z_um} µm after {stated:?}");
        twice_mm3 += (found[z_um] - mm3).max(0.0);
    }
    assert!(twice_mm3 <= stated_mm3 + 0.01, "{n}: {twice_mm3} mm³ twice, {stated_mm3} stated: {stated:?}");
    let iou = least_iou(&rig.laid, &clean.laid);
    assert!(iou >= 0.995, "{n}: {iou} after {stated:?}");
    Outcome::Recovered
}

fn firmware_resets(shape: Shape, n: u64) -> Outcome {
    let setup = setup_for(shape, &RECOVERING, n);
    let clean = clean_of(shape, &setup);
    let at_s = moment(&clean, n);
    let mut rig = Rig::new(setup.with(&format!("reset:at-s={at_s}")));
    match rig.run() {
        End::Finished => {
            assert!(is_same(&rig.laid, &clean.laid), "{n}");
            return Outcome::Finished;
        }
        End::Faulted(Fault::FirmwareReset) => {}
        end => panic!("{n}: {end:?}"),
    }
    is_recovered(n, rig, &clean, Disk::Behind { lost_s: 0.0 })
}

fn power_fails(shape: Shape, n: u64) -> Outcome {
    power_fails_on(0.01 * (n % 10) as f64, shape, n)
}

/// No change of height waits for it.
fn power_fails_on_a_slow_disk(shape: Shape, n: u64) -> Outcome {
    power_fails_on(0.05_f64.mul_add((n % 10) as f64, 0.15), shape, n)
}

fn power_fails_on(lost_s: f64, shape: Shape, n: u64) -> Outcome {
    let setup = setup_for(shape, &RECOVERING, n);
    let clean = clean_of(shape, &setup);
    let at_s = moment(&clean, n);
    let mut rig = Rig::new(setup.with(&format!("reset:at-s={at_s}")));
    rig.disk_s = lost_s;
    if !rig.run_until(|rig| rig.printer.now_s() >= at_s) {
        return finished(n, rig, &clean);
    }
    let disk = if n.is_multiple_of(2) { Disk::Behind { lost_s } } else { Disk::Torn { lost_s } };
    is_recovered(n, rig, &clean, disk)
}

/// A set of interruptions of one kind.
struct Set {
    what: &'static str,
    firmwares: &'static [&'static str],
    interrupt: fn(Shape, u64) -> Outcome,
}

const DEATHS: Set = Set { what: "deaths of the host", firmwares: &FIRMWARES, interrupt: host_dies };
const CABLES: Set = Set { what: "pulled cables", firmwares: &FIRMWARES, interrupt: cable_is_pulled };
const RESETS: Set = Set { what: "resets", firmwares: &RECOVERING, interrupt: firmware_resets };
const SLOW_POWER: Set =
    Set { what: "power cuts, slow disk", firmwares: &RECOVERING, interrupt: power_fails_on_a_slow_disk };
const POWER: Set = Set { what: "power cuts", firmwares: &RECOVERING, interrupt: power_fails };

impl Set {
    /// The first `n` of them; no more than this share may be refused.
    #[expect(clippy::print_stdout, reason = "the figures of the full set, with --nocapture")]
    fn run(&self, shape: Shape, n: u64, most_refused: f64) {
        let mut counts: BTreeMap<Outcome, u32> = BTreeMap::new();
        let mut by_firmware: BTreeMap<(&str, Outcome), u32> = BTreeMap::new();
        for i in 0..n {
            let outcome = (self.interrupt)(shape, i);
            *counts.entry(outcome).or_default() += 1;
            let firmware = self.firmwares[usize::try_from(i).unwrap() % self.firmwares.len()];
            *by_firmware.entry((firmware, outcome)).or_default() += 1;
        }
        println!("{n} {}, {shape:?}: {counts:?}\n{by_firmware:?}", self.what);
        let is_refusal = |outcome: &Outcome| matches!(outcome, Outcome::Refused(_));
        let n_refused: u32 = counts.iter().filter(|(outcome, _)| is_refusal(outcome)).map(|(_, n)| n).sum();
        assert!(f64::from(n_refused) <= most_refused * n as f64, "{n} {}: {counts:?}", self.what);
    }
}

#[test]
fn a_host_that_dies_anywhere_is_resumed_exactly() {
    DEATHS.run(Shape::Filled, 15, 0.0);
    DEATHS.run(Shape::Wall, 10, 0.0);
}

#[test]
fn a_cable_that_is_pulled_anywhere_leaves_no_trace() {
    CABLES.run(Shape::Filled, 10, 0.0);
}

#[test]
fn a_firmware_that_resets_anywhere_is_recovered_as_stated() {
    RESETS.run(Shape::Filled, 12, 0.75);
    RESETS.run(Shape::Wall, 12, 0.34);
}

#[test]
fn a_power_cut_anywhere_is_recovered_as_stated() {
    POWER.run(Shape::Filled, 48, 0.72);
    POWER.run(Shape::Wall, 12, 0.5);
    SLOW_POWER.run(Shape::Wall, 12, 0.9);
}

#[test]
#[ignore = "the full set: minutes"]
fn two_hundred_deaths_of_the_host() {
    DEATHS.run(Shape::Filled, 200, 0.0);
}

#[test]
#[ignore = "the full set: minutes"]
fn two_hundred_pulled_cables() {
    CABLES.run(Shape::Filled, 200, 0.0);
}

#[test]
#[ignore = "the full set: minutes"]
fn a_hundred_resets() {
    RESETS.run(Shape::Filled, 100, 0.65);
    RESETS.run(Shape::Wall, 100, 0.16);
}

#[test]
#[ignore = "the full set: minutes"]
fn a_hundred_power_cuts() {
    POWER.run(Shape::Filled, 100, 0.68);
    POWER.run(Shape::Wall, 100, 0.24);
    SLOW_POWER.run(Shape::Wall, 100, 0.75);
}

#[test]
fn klipper_cannot_be_told_where_z_is_and_says_so() {
    let mut rig = Rig::new(Setup::new("klipper", 3, 100).with("reset:line=290"));
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
    let mut known = Known::from(&Log::read(&path).unwrap());
    // How long this disk took.
    known.progress.delay_s = 0.0;
    assert_eq!(known, rig.known(0.0));
}

#[test]
fn a_printer_that_was_switched_off_is_warmed_up_and_goes_on_without_a_trace() {
    for firmware in ["marlin", "marlin1", "repetier"] {
        let profile = crate::profile::builtin(firmware).unwrap();
        let job = vessel::filled(&profile, 2);
        let setup = Setup { job, profile, faults: Vec::new(), baud: None, seed: 1 };
        let expected = clean(&setup);
        let mut rig = Rig::new(setup);
        assert!(rig.run_until(|rig| rig.laid.len() >= 200));
        rig.drain(20.0);
        rig.printer.receive(b"M104 S0\nM107\n");
        rig.drain(60.0);
        let known = Known { away_s: Some(80.0), ..rig.known(80.0) };
        rig.resume_by(known, false);
        let end = rig.run();
        assert!(matches!(end, End::Finished), "{firmware}: {end:?}");
        assert!(is_same(&rig.laid, &expected), "{firmware}");
        assert_eq!(rig.printer.summary().cold_extrusions, 0, "{firmware}");
    }
}
