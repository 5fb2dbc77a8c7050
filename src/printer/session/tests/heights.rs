//! No line that changes the height is sent before the journal's disk has the record that lets it.

use super::rig::{Rig, Setup};
use super::vessel;
use crate::printer::journal::Record;
use crate::printer::replay::Modal;
use crate::printer::session::End;

/// Lines of the job that change the height, counted from 1.
fn rising(setup: &Setup) -> Vec<u64> {
    let mut modal = Modal::new(setup.profile.firmware.dialect);
    let (mut n, mut found) = (0, Vec::new());
    let mut job = setup.job();
    let n_lines = job.n_lines();
    job.replay(n_lines, |command| {
        n += 1;
        if modal.is_at_other_height_after(command) {
            found.push(n);
        }
        modal.apply(command);
    })
    .unwrap();
    found
}

/// Prints; how many records let the height change.
fn watch(setup: Setup, disk_s: f64) -> usize {
    let rising = rising(&setup);
    assert!(rising.len() > 10, "{rising:?}");
    let what = format!("{} {:?} {disk_s}", setup.profile.name, setup.baud);
    let mut rig = Rig::new(setup);
    rig.disk_s = disk_s;
    let (mut n_sent, mut n_seen) = (0, 0);
    rig.run_until(|rig| {
        let progress = rig.session.recorder.progress(rig.now(), rig.session.core.progress());
        if progress.n_sent == n_sent {
            return false;
        }
        let let_to = on_disk(rig, disk_s);
        for n in rising.iter().filter(|n| (n_sent + 1..=progress.n_sent).contains(*n)) {
            n_seen += 1;
            assert!(*n <= let_to, "{what}: {n} sent, {let_to} let");
        }
        n_sent = progress.n_sent;
        false
    });
    assert!(matches!(rig.session.take_end(), Some(End::Finished)), "{what}");
    assert_eq!(n_seen, rising.len(), "{what}");
    let mut lets: Vec<_> = rig.records.iter().filter_map(|(_, record)| heights_to(record)).collect();
    lets.dedup();
    lets.len()
}

fn heights_to(record: &Record) -> Option<u64> {
    match record {
        Record::Progress(progress) => progress.heights_to,
        _ => None,
    }
}

/// Up to which line the height may change by what has reached the disk.
fn on_disk(rig: &Rig, disk_s: f64) -> u64 {
    let until_s = rig.printer.now_s() - disk_s + 1e-5;
    let written = rig.records.iter().filter(|(at_s, _)| *at_s <= until_s);
    written.filter_map(|(_, record)| heights_to(record)).max().unwrap_or(0)
}

#[test]
fn it_changes_when_the_disk_knows() {
    for firmware in ["marlin", "marlin1", "klipper"] {
        for (baud, disk_s) in [(None, 0.0), (None, 0.2), (Some(115_200), 0.05)] {
            let profile = crate::profile::builtin(firmware).unwrap();
            let job = vessel::wall(&profile, 8);
            watch(Setup { job, profile, faults: Vec::new(), baud, seed: 1 }, disk_s);
        }
    }
}

/// A wall of one bead, whose every line rises.
#[test]
fn a_spiral_costs_a_record_for_some_dozens_of_lines() {
    let mut setup = Setup::new("marlin", 1, 3);
    let rise = |i: u32| {
        format!("G1 X{}.{:02} Z{:.3} E0.01\n", 100 + i % 2, i % 97, 0.001_f64.mul_add(f64::from(i), 0.2))
    };
    setup.job = "G28\nM83\n".to_owned() + &(0..640).map(rise).collect::<String>();
    let n_lets = watch(setup, 0.01);
    assert!((20..=24).contains(&n_lets), "{n_lets}");
}

#[test]
fn a_slow_disk_is_waited_for_once() {
    let profile = crate::profile::builtin("marlin").unwrap();
    let job = vessel::wall(&profile, 8);
    let mut rig = Rig::new(Setup { job, profile, faults: Vec::new(), baud: None, seed: 1 });
    assert!(rig.run_until(|rig| rig.laid.len() > 100));
    rig.session.disk_is_slow();
    let n_before = rig.records.len();
    assert!(matches!(rig.run(), End::Finished));
    let mut behind =
        rig.records[n_before..].iter().filter(|(_, record)| matches!(record, Record::Progress(_)));
    assert!(behind.next().is_some());
    assert!(behind.all(|(_, record)| heights_to(record).is_none()), "no promise is made any more");
}
