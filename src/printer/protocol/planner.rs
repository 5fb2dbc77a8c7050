//! How many of the moves acknowledged a firmware still has before it, as far as it tells by itself (ADVANCED_OK).
//!
//! `P` of an `ok` holds for the line that this `ok` is of. It has no checksum: so two answers one after the other must vouch for
//! what is concluded, and what was heard before lines that were acknowledged in another way says nothing any more.

use super::Instant;

/// What one `ok` said.
#[derive(Debug, Clone, Copy)]
struct Heard {
    free: u32,
    /// The line that it acknowledged.
    line: u64,
    at: Instant,
}

/// The last two answers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Planner {
    /// Places in its ring, one more than it can hold.
    places: u32,
    last: Option<[Heard; 2]>,
    newest: Option<Heard>,
    /// Free places that two answers in a row have told of: it can hold as many.
    most_free: u32,
}

/// What was surely in the planner, and since when that is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Held {
    /// Moves.
    pub n_moves: u32,
    /// When it was so.
    pub at: Instant,
}

impl Planner {
    /// One of a ring with so many places, by the profile.
    pub(super) const fn new(places: u32) -> Self {
        Self { places, last: None, newest: None, most_free: 0 }
    }

    /// An `ok` for `line` came with so many free places.
    pub(super) fn heard(&mut self, free: u32, line: u64, at: Instant) {
        self.places = self.places.max(free.saturating_add(1));
        let now = Heard { free, line, at };
        self.last = self.newest.filter(|before| before.line < line).map(|before| [before, now]);
        self.newest = Some(now);
        if let Some(pair) = self.last {
            self.most_free = self.most_free.max(pair.map(|heard| heard.free).into_iter().min().unwrap_or(0));
        }
    }

    /// Lines were acknowledged, or taken back, without an answer of their own.
    pub(super) const fn forget(&mut self) {
        (self.last, self.newest) = (None, None);
    }

    /// Moves among the lines up to `acked` that may not be executed, at most; `None` where nothing vouches for that. They may be
    /// more than it holds: the newest answer may name a line that is only on its way.
    pub(super) fn pending(&self, acked: u64) -> Option<u32> {
        let all = self.places - 1;
        let pair = self.last.filter(|[_, now]| now.line == acked)?;
        let at_most = |heard: Heard| {
            let since = u32::try_from(acked.saturating_sub(heard.line)).unwrap_or(u32::MAX);
            (all - heard.free.min(all)).saturating_add(since)
        };
        pair.map(at_most).into_iter().max()
    }

    /// Places in its ring.
    pub(super) const fn places(&self) -> u32 {
        self.places
    }

    /// Moves among the lines up to `acked` that were surely in it.
    pub(super) fn held(&self, acked: u64) -> Option<Held> {
        let pair = self.last.filter(|[_, now]| now.line == acked)?;
        let n_moves = pair.map(|heard| self.most_free.saturating_sub(heard.free)).into_iter().min()?;
        Some(Held { n_moves, at: pair[0].at })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn at(ms: u64) -> Instant {
        Instant::after(Duration::from_millis(ms))
    }

    #[test]
    fn two_answers_vouch_for_what_is_in_it() {
        let mut planner = Planner::new(16);
        assert_eq!((planner.pending(0), planner.held(0)), (None, None));
        planner.heard(15, 1, at(0));
        assert_eq!(planner.pending(1), None, "one is not enough");
        planner.heard(15, 2, at(10));
        assert_eq!((planner.pending(2), planner.held(2)), (Some(1), Some(Held { n_moves: 0, at: at(0) })));
        planner.heard(5, 3, at(20));
        assert_eq!((planner.pending(3), planner.held(3).map(|held| held.n_moves)), (Some(10), Some(0)));
        planner.heard(4, 4, at(30));
        assert_eq!((planner.pending(4), planner.held(4)), (Some(11), Some(Held { n_moves: 10, at: at(20) })));
        // Another line was acknowledged since, in some other way.
        assert_eq!((planner.pending(5), planner.held(5)), (None, None));
        planner.forget();
        assert_eq!(planner.pending(4), None);
    }

    #[test]
    fn one_damaged_answer_makes_nothing_more_certain() {
        let mut planner = Planner::new(16);
        (1..5).for_each(|line| planner.heard(1, line, at(line)));
        planner.heard(11, 5, at(5));
        assert_eq!((planner.pending(5), planner.most_free), (Some(15), 1));
        // A line that is only on its way, by a damaged number.
        planner.heard(1, 9, at(6));
        assert_eq!(planner.pending(9), Some(14));
        planner.heard(1, 12, at(7));
        assert_eq!(planner.pending(12), Some(14 + 3));
    }
}
