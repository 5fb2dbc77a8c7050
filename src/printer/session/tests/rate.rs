//! How much of the wire is used.

use super::rig::{Rig, Setup};
use crate::printer::session::End;

/// Reply latency, and moves that take no time: the wire alone is the limit.
fn printed(baud: u32, n_lines: usize) -> (f64, u64) {
    let mut setup = Setup::new("marlin", 1, 3).with("delay:dir=tx,rate=1,for-s=0.001");
    setup.profile.firmware.baud = baud;
    setup.baud = Some(baud);
    setup.job = "G1 X0.0000 Y0.00000 E0.00000\n".repeat(n_lines);
    let mut rig = Rig::new(setup);
    assert!(matches!(rig.run(), End::Finished));
    (rig.printer.now_s(), rig.printer.summary().bytes_received)
}

#[test]
fn of_the_wire_99_percent_are_used_at_every_rate() {
    for baud in [115_200, 250_000, 500_000, 1_000_000] {
        // Begin and end of the session are the same in both, and what is tried on the way.
        let ((short_s, few), (long_s, many)) = (printed(baud, 4_000), printed(baud, 24_000));
        let share = (many - few) as f64 * 10.0 / f64::from(baud) / (long_s - short_s);
        assert!((0.99..=1.0 + 1e-9).contains(&share), "{baud} baud: {share:.4}");
    }
}

/// Where the wire carries a vessel's lines faster than they are moved, the planner holds moves at every moment, also where a change of
/// height waits for the journal's disk.
#[test]
fn the_planner_never_runs_dry_on_a_vessel() {
    let jobs = [super::vessel::filled, super::vessel::wall];
    for (job, n_layers, disk_s) in
        [(jobs[0], 3, 0.0), (jobs[0], 3, 0.09), (jobs[1], 8, 0.02), (jobs[1], 8, 0.09)]
    {
        let mut setup = Setup::new("marlin", 1, 3).with("delay:dir=tx,rate=1,for-s=0.001");
        setup.job = job(&setup.profile, n_layers);
        setup.baud = Some(setup.profile.firmware.baud);
        let mut rig = Rig::new(setup);
        rig.disk_s = disk_s;
        assert!(matches!(rig.run(), End::Finished));
        let summary = rig.printer.summary();
        assert!(summary.moving_s > 60.0, "{disk_s} {summary:?}");
        assert_eq!((summary.planner_dry, summary.planner_dry_s), (0, 0.0), "{disk_s}");
        assert!(summary.least_planner_depth >= Some(8), "{disk_s} {:?}", summary.least_planner_depth);
    }
}

/// Also where a long wait has let questions pile up: each is answered at its end, and where they have overrun its buffer, one line is
/// asked for again.
#[test]
fn on_a_good_wire_nothing_is_asked_for_again_and_again() {
    for profile in ["marlin", "marlin1", "repetier", "smoothie", "reprapfirmware", "klipper", "prusa-mk3s"] {
        for (baud, wait) in [(None, ""), (Some(115_200), ""), (Some(250_000), "G4 S200\n")] {
            let mut setup = Setup::new(profile, 2, 3);
            setup.job = format!("{wait}{}", super::vessel::filled(&setup.profile, 2));
            setup.baud = baud;
            setup.profile.firmware.baud = baud.unwrap_or(setup.profile.firmware.baud);
            let mut rig = Rig::new(setup);
            let end = rig.run();
            let stats = rig.session.stats();
            let what = format!("{profile} {baud:?} {wait:?}: {end:?} {stats:?}");
            assert!(matches!(end, End::Finished), "{what}");
            let most_resends = u64::from(!wait.is_empty());
            assert!(stats.n_resends <= most_resends, "{what}");
            assert_eq!((stats.n_lost_oks, stats.n_foreign_commands), (0, 0), "{what}");
            assert_eq!(rig.printer.summary().repeated_move_lines, 0, "{what}");
        }
    }
}
