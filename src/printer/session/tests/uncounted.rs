//! Firmware that counts no lines, on a bad wire: every bead is laid once, whatever is lost.
//!
//! Bits that flip on the way there are not among it: one that makes `;` of a byte takes the checksum away (see `protocol::alone`).

use super::rig::{Rig, Setup, clean};

const BAD_WIRES: [&[&str]; 4] = [
    &["lost-byte:rate=0.05", "bit-error:rate=0.05,dir=tx"],
    &["lost-byte:rate=0.05", "lost-ok:rate=0.05"],
    &["doubled-byte:rate=0.05", "garbage:rate=0.05,dir=tx", "delay:rate=0.02,dir=tx"],
    &["half-line:line=70", "lost-byte:rate=0.05,dir=tx", "spurious-resend:rate=0.05"],
];

#[test]
fn a_wire_that_is_bad_both_ways_loses_no_bead() {
    for name in ["reprapfirmware", "reprapfirmware-silent"] {
        let expected = clean(&Setup::new(name, 2, 40));
        for (wire, seed) in BAD_WIRES.iter().flat_map(|wire| (1..=8).map(move |seed| (wire, seed))) {
            let setup = wire.iter().fold(Setup::new(name, 2, 40), |setup, fault| setup.with(fault));
            let mut rig = Rig::new(Setup { seed, ..setup });
            rig.ends_as(&expected, &format!("{name} {wire:?} {seed}"));
        }
    }
}
