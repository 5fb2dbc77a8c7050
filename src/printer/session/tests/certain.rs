//! What is certain is true: at every moment of prints on wires that lose, damage and double, what the session calls certainly
//! executed was executed, and what it says cannot have been begun was not.

use super::super::*;
use super::rig::{Rig, Setup};
use super::vessel;
use crate::profile::Dialect;

/// Beads of the job's first lines: entry `n` is how many lines among the first `n` lay one.
fn beads_before(setup: &Setup) -> Vec<usize> {
    let mut job = setup.job();
    let mut counts = vec![0];
    let n_lines = job.n_lines();
    job.replay(n_lines, |command| {
        let lays = command.starts_with("G1 X") && command.contains(" E");
        counts.push(counts.last().unwrap() + usize::from(lays));
    })
    .unwrap();
    counts
}

/// Looks at every step; how often there was something to look at.
fn watch(setup: Setup) -> u32 {
    let what = format!("{} {:?} {:?} {}", setup.profile.name, setup.faults, setup.baud, setup.seed);
    let counts = beads_before(&setup);
    // The others execute what noise has made of a line.
    let demands_checksums = matches!(setup.profile.firmware.dialect, Dialect::Marlin | Dialect::Marlin1);
    let beads = |n: u64| counts[usize::try_from(n).unwrap().min(counts.len() - 1)];
    let mut rig = Rig::new(setup);
    // Noise makes `M1 5` of `M105`: then the printer waits for its user.
    rig.is_attended = true;
    let mut n_looks = 0;
    rig.run_until(|rig| {
        if !matches!(rig.session.stage, Stage::Printing) || rig.states.iter().any(|s| s.1 == "reset") {
            return false;
        }
        let now = rig.now();
        let progress = rig.session.recorder.progress(now, rig.session.core.progress());
        let n_laid = rig.laid.len();
        n_looks += u32::from(progress.n_certain > 20 && progress.n_certain < progress.n_sent);
        assert!(beads(progress.n_certain) <= n_laid, "{what}: {n_laid} beads laid at {progress:?}");
        if progress.begun_s == 0.0 && demands_checksums {
            assert!(beads(progress.n_begun) >= n_laid, "{what}: {n_laid} beads laid at {progress:?}");
        }
        false
    });
    n_looks
}

const FIRMWARES: [&str; 7] =
    ["marlin", "marlin1", "prusa-mk3s", "repetier", "reprapfirmware", "smoothie", "klipper"];
const FAULTS: [&[&str]; 5] = [
    &[],
    &["lost-ok:rate=0.05"],
    &["bit-error:rate=0.02", "bit-error:rate=0.02,dir=tx"],
    &["lost-byte:rate=0.01,dir=tx", "lost-ok:rate=0.03", "garbage:rate=0.01"],
    &["doubled-byte:rate=0.02,dir=tx", "spurious-resend:rate=0.02", "delay:rate=0.01,dir=tx"],
];

fn every(seeds: std::ops::Range<u64>) {
    let mut n_looks = 0;
    for seed in seeds {
        for (firmware, faults) in FIRMWARES.into_iter().flat_map(|f| FAULTS.map(|faults| (f, faults))) {
            let profile = crate::profile::builtin(firmware).unwrap();
            // Klipper's terminal is no wire; RepRapFirmware executes what noise has made of a line, and says `ok` to it.
            let is_wire = profile.firmware.line_numbers;
            let is_checked = !matches!(profile.firmware.dialect, Dialect::Klipper | Dialect::RepRapFirmware);
            let faults = faults.iter().filter(|_| is_checked || faults.len() < 2);
            let faults = faults.map(|fault| (*fault).to_owned()).collect();
            let baud = (is_wire && seed % 2 == 1).then_some(250_000);
            n_looks += watch(Setup { job: vessel::filled(&profile, 1), profile, faults, baud, seed });
        }
    }
    assert!(n_looks > 10_000, "{n_looks}");
}

#[test]
fn certainly_executed_lines_are_executed() {
    every(1..3);
}

#[test]
#[ignore = "the full set: minutes"]
fn certainly_executed_lines_are_executed_under_many_seeds() {
    every(10..60);
}
