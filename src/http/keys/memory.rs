//! Keys that were good, under a keyed hash: neither the keys themselves nor anything that another process could look up.

use crate::http::wire::Access;
use crate::queue::Name;
use std::collections::VecDeque;

/// A bounded number of them, the oldest forgotten first.
pub(super) struct Memory {
    seed: [u8; 32],
    most: usize,
    known: VecDeque<(blake3::Hash, (Name, Access))>,
}

impl Memory {
    pub(super) const fn new(seed: [u8; 32], most: usize) -> Self {
        Self { seed, most, known: VecDeque::new() }
    }

    fn sum(&self, key: &str) -> blake3::Hash {
        blake3::keyed_hash(&self.seed, key.as_bytes())
    }

    /// Sums are compared in constant time.
    pub(super) fn find(&self, key: &str) -> Option<(Name, Access)> {
        let sum = self.sum(key);
        self.known.iter().find(|(known, _)| *known == sum).map(|(_, whose)| whose.clone())
    }

    pub(super) fn remember(&mut self, key: &str, whose: (Name, Access)) {
        let sum = self.sum(key);
        self.known.retain(|(known, _)| *known != sum);
        if self.known.len() == self.most {
            self.known.pop_front();
        }
        self.known.push_back((sum, whose));
    }

    pub(super) fn forget(&mut self) {
        self.known.clear();
    }
}

impl std::fmt::Debug for Memory {
    /// Without the seed.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Memory").field("n_known", &self.known.len()).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::queue::tests::name;

    #[test]
    fn as_many_are_remembered_as_there_is_room_for() {
        let mut memory = Memory::new([7; 32], 2);
        for key in ["a", "b", "b", "c"] {
            memory.remember(key, (name(key), Access::View));
        }
        assert_eq!(memory.find("a"), None);
        assert_eq!(memory.find("c"), Some((name("c"), Access::View)));
        assert_eq!(memory.find("b"), Some((name("b"), Access::View)));
        memory.forget();
        assert_eq!(memory.find("b"), None);
    }
}
