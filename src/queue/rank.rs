//! Places in a queue: between any two there is another one, so that moving a job never touches a second.
//!
//! A rank is text that sorts byte by byte: sixteen hexadecimal digits of an integer, then, where a job was put between two
//! neighbours, digits of a fraction that never end in 0. New jobs take the next integer. Each move into the very same gap
//! costs a quarter of a digit.

use serde::{Deserialize, Serialize};

/// Digits of the integer.
const DIGITS: usize = 16;
/// The first job's: as many places before it as behind it.
const MIDDLE: u64 = 1 << 63;

/// A place in the queue; less is earlier.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Rank(String);

/// Something else was found where a rank was expected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("found no place in a queue, expected 16 hexadecimal digits, perhaps more that do not end in 0")]
pub struct NoRank;

impl Rank {
    fn of(integer: u64, fraction: &[u8]) -> Self {
        let mut text = format!("{integer:016x}");
        text.extend(fraction.iter().filter_map(|&digit| char::from_digit(digit.into(), 16)));
        Self(text)
    }

    fn integer(&self) -> u64 {
        u64::from_str_radix(&self.0[..DIGITS], 16).expect("checked when it was made")
    }

    fn fraction(&self) -> Vec<u8> {
        self.0.bytes().skip(DIGITS).map(digit_of).collect()
    }

    /// Between two neighbours; `None`: there is no neighbour on that side. The first must be less than the second.
    #[must_use]
    pub fn between(before: Option<&Self>, after: Option<&Self>) -> Self {
        match (before, after) {
            (None, None) => Self::of(MIDDLE, &[]),
            (Some(before), None) => match before.integer().checked_add(1) {
                Some(next) => Self::of(next, &[]),
                None => Self::of(u64::MAX, &middle(&before.fraction(), None)),
            },
            (None, Some(after)) => match after.integer().checked_sub(1) {
                Some(last) => Self::of(last, &[]),
                None => Self::of(0, &middle(&[], Some(&after.fraction()))),
            },
            (Some(before), Some(after)) => Self::inside(before, after),
        }
    }

    fn inside(before: &Self, after: &Self) -> Self {
        let (low, high) = (before.integer(), after.integer());
        match high.saturating_sub(low) {
            0 => Self::of(low, &middle(&before.fraction(), Some(&after.fraction()))),
            1 => Self::of(low, &middle(&before.fraction(), None)),
            gap => Self::of(low + gap / 2, &[]),
        }
    }

    /// As it is kept: sorts byte by byte.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

fn digit_of(byte: u8) -> u8 {
    // A digit of base 16 is below 16.
    char::from(byte).to_digit(16).and_then(|digit| u8::try_from(digit).ok()).unwrap_or(0)
}

/// Digits of a fraction strictly between two others, 1 where there is no upper one; never ends in 0.
fn middle(low: &[u8], high: Option<&[u8]>) -> Vec<u8> {
    let mut digits = Vec::new();
    let mut high = high;
    for idx in 0.. {
        let from = low.get(idx).copied().unwrap_or(0);
        let to = high.map_or(16, |digits| digits.get(idx).copied().unwrap_or(0));
        if to > from + 1 {
            digits.push(from.midpoint(to));
            return digits;
        }
        digits.push(from);
        if to == from + 1 {
            // Below the upper one from here on, whatever follows.
            high = None;
        }
    }
    digits
}

impl TryFrom<String> for Rank {
    type Error = NoRank;

    fn try_from(text: String) -> Result<Self, NoRank> {
        let is_good = text.len() >= DIGITS
            && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'))
            && (text.len() == DIGITS || !text.ends_with('0'));
        if is_good { Ok(Self(text)) } else { Err(NoRank) }
    }
}

impl From<Rank> for String {
    fn from(rank: Rank) -> Self {
        rank.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn new_jobs_go_behind_and_stay_short() {
        let first = Rank::between(None, None);
        let second = Rank::between(Some(&first), None);
        assert!(first < second && second.as_str().len() == DIGITS);
        assert!(Rank::between(None, Some(&first)) < first);
    }

    #[test]
    fn the_ends_of_all_integers_still_have_room() {
        let (last, first) = (Rank::of(u64::MAX, &[]), Rank::of(0, &[8]));
        assert!(Rank::between(Some(&last), None) > last);
        assert!(Rank::between(None, Some(&first)) < first);
    }

    #[test]
    fn a_thousand_moves_into_one_gap_cost_few_digits() {
        let (low, mut high) =
            (Rank::between(None, None), Rank::between(Some(&Rank::between(None, None)), None));
        for _ in 0..1000 {
            high = Rank::between(Some(&low), Some(&high));
        }
        assert!(high.as_str().len() <= DIGITS + 251, "{}", high.as_str().len());
    }

    proptest! {
        #[test]
        fn between_any_two_there_is_another(moves in prop::collection::vec(any::<prop::sample::Index>(), 1..200)) {
            let mut ranks: Vec<Rank> = Vec::new();
            for at in moves {
                let at = at.index(ranks.len() + 1);
                let rank = Rank::between(at.checked_sub(1).map(|i| &ranks[i]), ranks.get(at));
                prop_assert_eq!(Rank::try_from(String::from(rank.clone())), Ok(rank.clone()));
                ranks.insert(at, rank);
            }
            prop_assert!(ranks.is_sorted_by(|a, b| a < b));
        }
    }
}
