//! The lines acknowledged last, and what of them is certainly executed: a firmware has taken moves that it has not made.

use super::Effect;
use crate::printer::protocol::Ahead;
use crate::profile::Dialect;

/// The lines acknowledged last, and which of them take a place in the planner: from it follows what is certainly executed.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Tail {
    effects: std::collections::VecDeque<Effect>,
    /// Lines of the job before `effects`.
    n_before: u64,
}

/// Lines kept: more than any window and planner hold.
const KEPT: usize = 8192;

impl Tail {
    /// A tail of a job of which `n_before` lines are done.
    #[must_use]
    pub fn after(n_before: u64) -> Self {
        Self { n_before, ..Self::default() }
    }

    /// Lines of the job up to its end.
    #[must_use]
    pub fn n_lines(&self) -> u64 {
        self.n_before + self.effects.len() as u64
    }

    /// The next line of the job.
    pub fn push(&mut self, effect: Effect) {
        self.effects.push_back(effect);
        if self.effects.len() > KEPT {
            self.effects.pop_front();
            self.n_before += 1;
        }
    }

    /// Lines that are certainly executed when `n_acked` are acknowledged and this may be before the firmware.
    #[must_use]
    pub fn n_certain(&self, n_acked: u64, ahead: Queue) -> u64 {
        let mut left = ahead;
        let mut certain = n_acked;
        for effect in self.back_from(n_acked) {
            if left.n_lines > 0 {
                left.n_lines -= 1;
            } else if *effect == Effect::Drains || left.is_full() {
                return certain;
            } else {
                left.take(*effect);
            }
            certain -= 1;
        }
        certain
    }

    /// Lines that may have been begun when `n_acked` are acknowledged and the planner surely held so many moves: all up to the
    /// first of those, which may be under way.
    #[must_use]
    pub fn n_begun(&self, n_acked: u64, n_held: u32) -> u64 {
        let mut left = n_held;
        let mut begun = n_acked;
        for effect in self.back_from(n_acked) {
            match effect {
                _ if left == 0 => break,
                // All that is left may be of this one.
                Effect::Arc { .. } | Effect::Drains => return begun,
                Effect::Block { .. } | Effect::Short { .. } => left -= 1,
                Effect::Other => {}
            }
            begun -= 1;
        }
        (begun + 1).min(n_acked.max(begun))
    }

    /// What the lines known did, from the last one acknowledged back.
    fn back_from(&self, n_acked: u64) -> impl Iterator<Item = &Effect> {
        let known = usize::try_from(n_acked.saturating_sub(self.n_before)).unwrap_or(usize::MAX);
        self.effects.iter().take(known).rev()
    }
}

/// What a firmware may have before it, at most.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Queue {
    /// Lines that it has taken, whatever they are; the next two count before these.
    pub n_lines: u64,
    /// Moves.
    pub n_moves: u32,
    /// Time that its moves take at the speeds told, s.
    pub time_s: f64,
}

/// What Klipper has before it: two seconds by its print time (`BUFFER_TIME_HIGH`), checked each 0.1 s, and behind these what its
/// look-ahead has not handed over (0.25 s); half as much again for a speed that somebody has turned up, s.
const KLIPPER_QUEUE_S: f64 = 3.6;

impl Queue {
    /// What `ahead` means for this firmware.
    #[must_use]
    pub const fn of(dialect: Dialect, ahead: Ahead) -> Self {
        let Ahead { n_lines, n_moves, .. } = ahead;
        match dialect {
            // It counts time, not moves.
            Dialect::Klipper => Self { n_lines, n_moves: u32::MAX, time_s: KLIPPER_QUEUE_S },
            _ => Self { n_lines, n_moves, time_s: f64::INFINITY },
        }
    }

    /// Whether it is full with what lies behind a line: the line itself is then executed.
    fn is_full(&self) -> bool {
        self.n_moves == 0 || self.time_s <= 0.0
    }

    fn take(&mut self, effect: Effect) {
        if matches!(effect, Effect::Block { .. } | Effect::Arc { .. }) {
            self.n_moves = self.n_moves.saturating_sub(1);
        }
        self.time_s -= effect.least_s();
    }
}

#[cfg(test)]
mod tests {
    use super::super::Modal;
    use super::*;

    fn moves(n_moves: u32) -> Queue {
        Queue { n_lines: 0, n_moves, time_s: f64::INFINITY }
    }

    fn tail(lines: &[&str]) -> Tail {
        let mut modal = Modal::new(Dialect::Marlin);
        let mut tail = Tail::default();
        for line in lines {
            tail.push(modal.apply(line));
        }
        tail
    }

    #[test]
    fn moves_in_the_planner_are_not_certain() {
        let tail = tail(&["G28", "G1 X1", "G1 X2", "M106 S1", "G1 X3", "G1 X4"]);
        assert_eq!(tail.n_certain(6, moves(2)), 4);
        assert_eq!(tail.n_certain(6, moves(3)), 2);
        assert_eq!(tail.n_certain(6, moves(0)), 6);
        assert_eq!(tail.n_certain(3, moves(16)), 1);
        assert_eq!(tail.n_certain(0, moves(16)), 0);
    }

    #[test]
    fn what_drains_the_planner_makes_all_before_it_certain() {
        assert_eq!(tail(&["G1 X1", "G1 X2", "M400"]).n_certain(3, moves(16)), 3);
        assert_eq!(tail(&["G1 X1", "G1 X2", "M400", "G1 X3"]).n_certain(4, moves(16)), 3);
    }

    #[test]
    fn a_queue_of_time_holds_what_takes_as_long() {
        // 60 mm/s: a sixth of a second each.
        let lines: Vec<_> = (1..=60).map(|i| format!("G1 X{} F3600", 10 * i)).collect();
        let lines: Vec<_> = std::iter::once("G28").chain(lines.iter().map(String::as_str)).collect();
        let mut modal = Modal::new(Dialect::Klipper);
        let mut known = Tail::default();
        lines.iter().for_each(|line| known.push(modal.apply(line)));
        let queue = Queue::of(Dialect::Klipper, Ahead { n_lines: 0, n_moves: 64, held: None });
        // 3.6 s are 22 of them, and the one that begins before.
        assert_eq!(known.n_certain(61, queue), 61 - 22);
        assert_eq!(known.n_certain(10, queue), 1);
        let mut modal = Modal::new(Dialect::Klipper);
        assert_eq!(modal.apply("G4 P500"), Effect::Other, "a dwell is queued");
    }

    #[test]
    fn lines_that_were_only_taken_are_not_begun() {
        let tail = tail(&["G28", "G1 X1", "G1 X2", "M400", "G1 X4"]);
        assert_eq!(tail.n_certain(5, Queue { n_lines: 3, ..moves(1) }), 1);
        assert_eq!(tail.n_certain(5, Queue { n_lines: 9, ..moves(1) }), 0);
    }

    #[test]
    fn behind_moves_that_the_planner_held_nothing_is_begun() {
        let known = tail(&["G28", "G1 X1", "G1 X2", "M106 S9", "G1 X3", "G1 X3.05", "G1 X4"]);
        assert_eq!(known.n_begun(7, 0), 7);
        assert_eq!(known.n_begun(7, 1), 7, "it may be under way");
        assert_eq!(known.n_begun(7, 3), 5);
        assert_eq!(known.n_begun(7, 4), 3);
        let arcs = tail(&["G28", "G1 X1", "G2 X2 I1", "G1 X3"]);
        assert_eq!(arcs.n_begun(4, 5), 3);
    }

    #[test]
    fn lines_that_may_take_no_place_are_not_counted_as_places() {
        assert_eq!(tail(&["G1 X1", "G1 X2", "G1 F300", "G1 X2.001", "G1 X3"]).n_certain(5, moves(2)), 1);
    }

    proptest::proptest! {
        #[test]
        fn certain_lines_grow_with_acknowledgements(kinds in proptest::collection::vec(0..3_u8, 1..60), n in 0..20_u32) {
            let mut tail = Tail::default();
            for kind in &kinds {
                tail.push([Effect::Block { least_s: 0.1 }, Effect::Drains, Effect::Other][usize::from(*kind)]);
            }
            let certain: Vec<_> = (0..=kinds.len() as u64).map(|acked| tail.n_certain(acked, moves(n))).collect();
            proptest::prop_assert!(certain.is_sorted());
            proptest::prop_assert!(certain.iter().zip(0..).all(|(c, acked)| *c <= acked));
        }
    }
}
