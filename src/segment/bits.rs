//! A grid of bits, row by row: an eighth of the memory of a grid of bytes, which a whole CT of them would double.

use std::ops::Range;

const WORD: usize = u64::BITS as usize;

/// Rows of bits of one length.
#[derive(Debug, Clone)]
pub(super) struct BitRows {
    words: Vec<u64>,
    words_per_row: usize,
}

impl BitRows {
    /// `n_rows` rows of `n_columns` bits, none of them set.
    #[must_use]
    pub(super) fn new(n_columns: usize, n_rows: usize) -> Self {
        let words_per_row = n_columns.div_ceil(WORD);
        Self { words: vec![0; words_per_row * n_rows], words_per_row }
    }

    /// Whether the bit is set.
    #[must_use]
    pub(super) fn get(&self, row: usize, column: usize) -> bool {
        self.words[row * self.words_per_row + column / WORD] >> (column % WORD) & 1 != 0
    }

    /// Sets all bits of a run.
    pub(super) fn set(&mut self, row: usize, run: &Range<usize>) {
        for (word, mask) in masks(run) {
            self.words[row * self.words_per_row + word] |= mask;
        }
    }

    /// Clears a bit.
    pub(super) fn clear(&mut self, row: usize, column: usize) {
        self.words[row * self.words_per_row + column / WORD] &= !(1 << (column % WORD));
    }

    /// Sets what is set in another grid of the same size.
    pub(super) fn add(&mut self, other: &Self) {
        for (own, more) in self.words.iter_mut().zip(&other.words) {
            *own |= more;
        }
    }

    /// The bits of a row that are set, from left to right.
    pub(super) fn ones(&self, row: usize, columns: &Range<usize>) -> impl Iterator<Item = usize> + use<'_> {
        let row = &self.words[row * self.words_per_row..][..self.words_per_row];
        masks(columns).flat_map(move |(word, mask)| {
            let mut left = row[word] & mask;
            std::iter::from_fn(move || {
                let bit = (left != 0).then(|| left.trailing_zeros() as usize)?;
                left &= left - 1;
                Some(word * WORD + bit)
            })
        })
    }
}

/// The words that a run touches, each with the run's bits in it.
fn masks(run: &Range<usize>) -> impl Iterator<Item = (usize, u64)> + use<> {
    let run = run.clone();
    let words = if run.is_empty() { 0..0 } else { run.start / WORD..run.end.div_ceil(WORD) };
    words.map(move |word| {
        let first = run.start.saturating_sub(word * WORD);
        let end = (run.end - word * WORD).min(WORD);
        (word, (u64::MAX << first) & (u64::MAX >> (WORD - end)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn agrees_with_a_grid_of_booleans(
            runs in prop::collection::vec((0_usize..3, 0_usize..200, 0_usize..200), 0..20),
            cleared in prop::collection::vec((0_usize..3, 0_usize..200), 0..20),
            window in (0_usize..200, 0_usize..200),
        ) {
            let mut bits = BitRows::new(200, 3);
            let mut plain = vec![[false; 200]; 3];
            for (row, a, b) in runs {
                bits.set(row, &(a..b.max(a)));
                plain[row][a..b.max(a)].fill(true);
            }
            for (row, column) in cleared {
                bits.clear(row, column);
                plain[row][column] = false;
            }
            let mut twice = BitRows::new(200, 3);
            twice.add(&bits);
            let columns = window.0.min(window.1)..window.0.max(window.1);
            for (row, plain) in plain.iter().enumerate() {
                let ones: Vec<usize> = columns.clone().filter(|&i| plain[i]).collect();
                prop_assert_eq!(twice.ones(row, &columns).collect::<Vec<_>>(), ones);
                prop_assert!((0..200).all(|i| bits.get(row, i) == plain[i]));
            }
        }
    }
}
