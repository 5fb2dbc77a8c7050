//! No line that changes the height is sent before the journal's disk has the record that lets it.

use super::deposit::volumes;
use super::rig::{Rig, Setup};
use super::vessel;
use crate::printer::journal::Record;
use crate::printer::protocol::{Event, Fault};
use crate::printer::replay::Modal;
use crate::printer::session::{End, PrintEvent};

/// Lines of the job that change the height, counted from 1.
fn rising(setup: &Setup) -> Vec<u64> {
    let mut modal = Modal::new(setup.profile.firmware.dialect);
    let (mut n, mut found) = (0, Vec::new());
    let mut job = setup.job();
    let n_lines = job.n_lines();
    job.replay(n_lines, |command| {
        n += 1;
        if modal.changes_height(command) {
            found.push(n);
        }
        modal.apply(command);
    })
    .unwrap();
    found
}

/// Prints; how many records allow the height to change, and how long it takes, s.
fn watch(setup: Setup, disk_s: f64) -> (usize, f64) {
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
    let mut lets: Vec<_> = rig.records.iter().filter_map(|(_, record)| z_allowed_to(record)).collect();
    lets.dedup();
    (lets.len(), rig.printer.now_s())
}

fn z_allowed_to(record: &Record) -> Option<u64> {
    match record {
        Record::Progress(progress) => progress.z_allowed_to,
        _ => None,
    }
}

/// Up to which line the height may change by what has reached the disk.
fn on_disk(rig: &Rig, disk_s: f64) -> u64 {
    let until_s = rig.printer.now_s() - disk_s + 1e-5;
    let written = rig.records.iter().filter(|(at_s, _)| *at_s <= until_s);
    written.filter_map(|(_, record)| z_allowed_to(record)).max().unwrap_or(0)
}

#[test]
fn it_changes_when_the_disk_knows() {
    for firmware in ["marlin", "marlin1", "repetier", "smoothie"] {
        for (baud, disk_s) in [(None, 0.0), (None, 0.09), (Some(115_200), 0.05)] {
            let profile = crate::profile::builtin(firmware).unwrap();
            let job = vessel::wall(&profile, 8);
            watch(Setup { job, profile, faults: Vec::new(), baud, seed: 1 }, disk_s);
        }
    }
}

/// A wall of one bead, whose every line rises: the records lie apart by half a second in the end.
#[test]
fn a_spiral_costs_few_records() {
    let mut setup = Setup::new("marlin", 1, 3);
    let rise = |i: u32| {
        format!("G1 X{}.{:02} Z{:.3} E0.01\n", 100 + i % 2, i % 97, 0.001_f64.mul_add(f64::from(i), 0.2))
    };
    setup.job = "G28\nM83\nG1 F6000\n".to_owned() + &(0..4000).map(rise).collect::<String>();
    let (n_records, took_s) = watch(setup, 0.01);
    assert!(took_s > 100.0 && (n_records as f64) < took_s * 2.0, "{n_records} in {took_s} s");
}

fn wall() -> Setup {
    let profile = crate::profile::builtin("marlin").unwrap();
    Setup { job: vessel::wall(&profile, 8), profile, faults: Vec::new(), baud: None, seed: 1 }
}

/// How long nothing is sent for the disk, and what the records promise from then on.
fn after(disk_s: f64) -> (Vec<PrintEvent>, Vec<Option<u64>>) {
    let mut rig = Rig::new(wall());
    assert!(rig.run_until(|rig| rig.laid.len() > 300));
    rig.disk_s = disk_s;
    let (n_events, n_records) = (rig.events.len(), rig.records.len());
    assert!(matches!(rig.run(), End::Finished));
    let is_progress = |record: &Record| matches!(record, Record::Progress(_));
    let behind = rig.records[n_records..].iter().filter(|(_, record)| is_progress(record));
    let promises = behind.map(|(_, record)| z_allowed_to(record)).collect();
    (rig.events.split_off(n_events), promises)
}

#[test]
fn a_slow_disk_is_waited_for_once() {
    let (events, promises) = after(0.3);
    let first = promises.iter().position(Option::is_none).expect("the promise is taken back");
    assert!(promises[first..].iter().all(Option::is_none), "{promises:?}");
    assert!(!events.iter().any(|event| matches!(event, PrintEvent::JournalFailed(_))), "it works");
}

#[test]
fn a_disk_that_does_not_answer_is_told_and_no_longer_waited_for() {
    let (events, promises) = after(1e6);
    let n_told = events.iter().filter(|event| matches!(event, PrintEvent::JournalFailed(_))).count();
    assert_eq!(n_told, 1, "{events:?}");
    assert_eq!(promises.last(), Some(&None));
}

/// The cable was out, or the host died; later the printer is reset: behind the lifts since then it is known how high it is.
#[test]
fn a_print_that_has_gone_on_is_recovered_from_like_any_other() {
    let mut rig = Rig::new(wall());
    assert!(rig.run_until(|rig| rig.laid.len() > 900));
    let from_s = rig.printer.now_s() + 6.0;
    assert!(matches!(rig.run(), End::Finished));
    let expected = volumes(&rig.laid);
    let mut n_recovered = 0;
    for i in 0..6 {
        let reset_s = 3.0_f64.mul_add(f64::from(i), from_s);
        let mut rig = Rig::new(wall().with(&format!("reset:at-s={reset_s}")));
        rig.disk_s = 0.02;
        assert!(rig.run_until(|rig| rig.laid.len() > 400));
        if i % 2 == 0 {
            rig.is_unplugged = true;
            assert!(rig.run_until(|rig| rig.session.wants_port()));
            rig.is_unplugged = false;
        } else {
            rig.drain(2.0);
            rig.resume(0.3, false);
        }
        let end = rig.run();
        assert!(matches!(end, End::Faulted(Fault::FirmwareReset)), "{i}: {end:?}");
        rig.resume(0.0, true);
        match rig.run() {
            End::Finished => {
                n_recovered += 1;
                assert!(volumes(&rig.laid).keys().eq(expected.keys()), "{i}");
            }
            // In the middle of a lift.
            End::Refused(refusal) => assert_eq!(refusal.code(), "printer.resume_height_unknown", "{i}"),
            end => panic!("{i}: {end:?}"),
        }
    }
    assert!(n_recovered >= 3, "{n_recovered} of 6");
}

/// Where a firmware parks in the middle of a line nobody knows how high it is.
#[test]
fn a_printer_that_waits_for_somebody_is_not_at_the_part() {
    let mut setup = wall();
    let n = setup.job.len() / 2;
    let n = n + setup.job[n..].find('\n').unwrap() + 1;
    setup.job.insert_str(n, "M600\n");
    let waits =
        |rig: &Rig| rig.events.iter().any(|event| matches!(event, PrintEvent::Session(Event::Paused)));
    let mut rig = Rig::new(setup.clone());
    assert!(rig.run_until(waits));
    let reset_s = rig.printer.now_s() + 30.0;
    let mut rig = Rig::new(setup.with(&format!("reset:at-s={reset_s}")));
    let end = rig.run();
    assert!(matches!(end, End::Faulted(Fault::FirmwareReset)), "{end:?}");
    assert!(waits(&rig));
    rig.resume(0.0, true);
    match rig.run() {
        End::Refused(refusal) => assert_eq!(refusal.code(), "printer.resume_height_unknown", "{refusal}"),
        end => panic!("{end:?}"),
    }
}
